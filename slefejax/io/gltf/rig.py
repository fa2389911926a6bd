"""Joints, influences and shape keys of the meshes of a glTF file.

All nodes are joints, so that what hangs on a node moves with it. A node that two skins bind in different ways has one
joint more for each, which stands in it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from slefejax.io.gltf.file import GltfFile
from slefejax.io.gltf.nodes import Node
from slefejax.model.rig import Skeleton
from slefejax.model.skinning import Influences, Key


@dataclass
class Part:
    """The mesh of one node: one row a vertex.

    joints, weights : ``(vertices, k)`` of those that move it, padded with weights of 0
    offsets, names  : ``(vertices, 3)`` of every morph target, and what it is called
    """

    node: int
    places: np.ndarray
    triangles: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    offsets: list[np.ndarray]
    names: list[str]
    texture: np.ndarray | None = None


@dataclass
class Joints:
    """Joints in the making: nodes first, then those of nodes that have two bind transforms.

    world : ``(nodes, 4, 4)`` at rest
    away  : whether something stands elsewhere at rest than its vertices say
    """

    nodes: list[Node]
    world: np.ndarray
    binds: dict[int, np.ndarray] = field(default_factory=dict)
    more: list[tuple[int, np.ndarray]] = field(default_factory=list)
    away: bool = False

    def number(self, node: int, bind: np.ndarray) -> int:
        """Of the joint of a node with that bind transform."""
        if np.array_equal(self.binds.setdefault(node, bind), bind):
            return node
        for k, (owner, other) in enumerate(self.more):
            if owner == node and np.array_equal(other, bind):
                return len(self.nodes) + k
        self.more.append((node, bind))
        return len(self.nodes) + len(self.more) - 1

    def skeleton(self) -> Skeleton:
        """All of them as a tree."""
        names = [node.name for node in self.nodes] + [self.nodes[owner].name for owner, _ in self.more]
        parents = [node.parent for node in self.nodes] + [owner for owner, _ in self.more]
        usable = [np.abs(np.linalg.det(matrix[:3, :3])) > 0 for matrix in self.world]
        own = [self.binds.get(k, self.world[k] if usable[k] else np.eye(4)) for k in range(len(self.nodes))]
        return Skeleton.of(names, parents, np.array(own + [bind for _, bind in self.more]))

    def rest(self) -> np.ndarray | None:
        """Local transforms at rest, None if all stands where its vertices are."""
        if not self.away:
            return None
        return np.array([node.local for node in self.nodes] + [np.eye(4)] * len(self.more))

    def mirrored(self, index: np.ndarray, weight: np.ndarray) -> bool:
        """Whether joints turn most of what hangs on them inside out at rest."""
        total = 0.0
        for joint in np.unique(index[weight > 0]).tolist():
            owner, bind = (joint, self.binds[joint]) if joint < len(self.nodes) else self.more[joint - len(self.nodes)]
            sign = np.sign(np.linalg.det(self.world[owner][:3, :3])) * np.sign(np.linalg.det(bind[:3, :3]))
            total += float(sign * weight[index == joint].sum())
        return total < 0


def read_skin(file: GltfFile, joints: Joints, number: Any) -> np.ndarray:
    """The number of the joint of each of a skin's."""
    skin = file.item("skins", number)
    nodes = skin["joints"]
    inverse = np.tile(np.eye(4), (len(nodes), 1, 1))
    if "inverseBindMatrices" in skin:
        given = file.array(skin["inverseBindMatrices"], 16, f"inverse bind matrices of skin {number}")
        if len(given) < len(nodes):
            raise file.fail(f"skin {number} has {len(nodes)} joints but {len(given)} inverse bind matrices")
        inverse = given[: len(nodes)].reshape(-1, 4, 4).swapaxes(1, 2)
    for k, node in enumerate(nodes):
        file.item("nodes", node)
        if not np.abs(np.linalg.det(inverse[k, :3, :3])) > 0:
            raise file.fail(f"the inverse bind matrix of joint {k} of skin {number} cannot be inverted")
    return np.array([joints.number(node, np.linalg.inv(inverse[k])) for k, node in enumerate(nodes)])


def influences_of(parts: list[Part], joints: int) -> Influences:
    """Of all parts, one after the other."""
    width = max(part.joints.shape[1] for part in parts)
    filled = [[np.pad(x, [(0, 0), (0, width - x.shape[1])]) for x in (part.joints, part.weights)] for part in parts]
    index, weight = (np.concatenate(column) for column in zip(*filled, strict=True))
    return Influences.of(np.where(weight != 0, index, 0), weight, joints)


def keys_of(parts: list[Part]) -> tuple[list[Key], list[tuple[int, int]]]:
    """Shape keys of all parts, and the (node, number of the target) that each belongs to."""
    keys, owners, start = [], [], 0
    taken: set[str] = set()
    for part in parts:
        for k, (name, offsets) in enumerate(zip(part.names, part.offsets, strict=True)):
            free = name if name not in taken else f"{name} ({part.node})"
            taken.add(free)
            moved = np.flatnonzero(np.any(offsets != 0, axis=1))
            keys.append(Key(free, ((moved + start, offsets[moved]),)))
            owners.append((part.node, k))
        start += len(part.places)
    return keys, owners


def key_weights(file: GltfFile, nodes: list[Node], owners: list[tuple[int, int]]) -> np.ndarray:
    """Weights of the shape keys at rest: the node's own, or else its mesh's."""
    found = np.zeros(len(owners))
    for k, (node, target) in enumerate(owners):
        given = nodes[node].weights or file.item("meshes", nodes[node].mesh).get("weights") or []
        found[k] = float(given[target]) if target < len(given) else 0.0
    if not np.isfinite(found).all():
        raise file.fail("it has weights of morph targets that are not finite")
    return found
