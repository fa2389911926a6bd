"""The nodes of a glTF file: where each stands at rest, which of them are drawn, and how often."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from slefejax.io.gltf.extensions import extension_of
from slefejax.io.gltf.file import GltfFile
from slefejax.late import one_at_a_time
from slefejax.model.rig import transform_of, transform_parts

_MOST_NODES = 20_000
_MOST_COPIES = 10**5


@dataclass
class Node:
    """A node: where it is in its parent's coordinates, at rest, and what hangs on it."""

    name: str
    parent: int
    translation: np.ndarray
    rotation: np.ndarray  # w, x, y, z
    scale: np.ndarray
    mesh: int | None
    skin: int | None
    weights: Any

    @property
    def local(self) -> np.ndarray:
        """``(4, 4)``, from its own coordinates to its parent's."""
        return transform_of(self.translation, self.rotation, self.scale)


def read_nodes(file: GltfFile) -> list[Node]:
    """All nodes. Raises InputError for what is no forest, and for transforms that are none."""
    count = len(file.content.get("nodes", []))
    if count > _MOST_NODES:
        raise file.fail(f"there are {count:,} nodes, more than {_MOST_NODES:,}")
    parents = np.full(count, -1)
    for number in range(count):
        for child in file.item("nodes", number).get("children", []):
            file.item("nodes", child)
            if parents[child] >= 0:
                raise file.fail(f"node {child} has two parents, {parents[child]} and {number}")
            parents[child] = number
    return [_node(file, number, int(parents[number])) for number in range(count)]


def _node(file: GltfFile, number: int, parent: int) -> Node:
    given = file.item("nodes", number)
    if "matrix" in given:
        matrix = np.array(given["matrix"], np.float64).reshape(4, 4).T
        parts = transform_parts(matrix)
        if not np.allclose(transform_of(*parts), matrix, rtol=0, atol=1e-5 * np.abs(matrix).max()):
            raise file.fail(f"the matrix of node {number} is no scale, rotation and translation (it has a shear)")
    else:
        x, y, z, w = (float(v) for v in given.get("rotation", (0, 0, 0, 1)))
        turn = np.array([w, x, y, z]) / (np.linalg.norm([w, x, y, z]) or 1.0)
        parts = (_three(given.get("translation", (0, 0, 0))), turn, _three(given.get("scale", (1, 1, 1))))
    if not all(np.isfinite(part).all() for part in parts):
        raise file.fail(f"node {number} has a transform that is not finite")
    name = str(given.get("name", f"node {number}"))
    return Node(name, parent, *parts, given.get("mesh"), given.get("skin"), given.get("weights"))


def _three(values: Any) -> np.ndarray:
    x, y, z = (float(v) for v in values)
    return np.array([x, y, z])


def world_transforms(file: GltfFile, nodes: list[Node]) -> np.ndarray:
    """``(nodes, 4, 4)`` from each node's coordinates to the world's, at rest."""
    world: list[np.ndarray | None] = [None] * len(nodes)
    children: dict[int, list[int]] = {}
    for k, node in enumerate(nodes):
        children.setdefault(node.parent, []).append(k)
    waiting = list(children.get(-1, []))
    while waiting:
        k = waiting.pop()
        above = world[nodes[k].parent] if nodes[k].parent >= 0 else None
        world[k] = nodes[k].local if above is None else above @ nodes[k].local
        waiting += children.get(k, [])
    lost = [k for k, matrix in enumerate(world) if matrix is None]
    if lost:
        raise file.fail(f"node {lost[0]} is its own ancestor")
    return np.array(world).reshape(-1, 4, 4)


def shown_nodes(file: GltfFile, nodes: list[Node], notes: list[str]) -> list[int]:
    """Nodes of the file's scene that are visible, of all scenes if it names none; the others are noted."""
    scenes = file.content.get("scenes")
    waiting = [(k, True) for k, node in enumerate(nodes) if node.parent < 0]
    if scenes:
        own = file.content.get("scene", 0)
        waiting = [(k, True) for k in file.item("scenes", own).get("nodes", [])]
        if len(scenes) > 1:
            notes.append(f"scene {own} of {len(scenes)} (counted from 0) was taken")
    found: dict[int, bool] = {}
    while waiting:
        node, visible = waiting.pop()
        given = file.item("nodes", node)
        if node in found:
            raise file.fail(f"node {node} is its own ancestor, or twice in the scene")
        found[node] = visible and (extension_of(given, "KHR_node_visibility") or {}).get("visible", True) is not False
        waiting += [(child, found[node]) for child in given.get("children", [])]
    hidden = [k for k, visible in sorted(found.items()) if not visible and nodes[k].mesh is not None]
    if hidden:
        notes.append(
            f"{len(hidden)} meshes are invisible and were left out (the first at node {nodes[hidden[0]].name!r})"
        )
    return sorted(k for k, visible in found.items() if visible)


def placements(file: GltfFile, number: int, notes: list[str]) -> np.ndarray | None:
    """``(copies, 4, 4)``, where copies of a node's mesh stand in its coordinates; None for the one mesh.

    Raises InputError for places that are none.
    """
    given = extension_of(file.item("nodes", number), "EXT_mesh_gpu_instancing")
    attributes = (given or {}).get("attributes") or {}
    what = f"the copies of node {number}"
    parts = {
        name: np.asarray(file.array(attributes[name], size, f"{what}: {name.lower()}"), np.float64)
        for name, size in (("TRANSLATION", 3), ("ROTATION", 4), ("SCALE", 3))
        if name in attributes
    }
    if not parts:
        return None
    count = len(next(iter(parts.values())))
    if any(len(values) != count for values in parts.values()):
        counts = ", ".join(f"{len(values)} {name.lower()}s" for name, values in parts.items())
        raise file.fail(f"{what} have {counts}: there must be as many of each")
    if count > _MOST_COPIES:
        raise file.fail(f"{what} are {count:,}, more than {_MOST_COPIES:,}")
    found = np.tile(np.eye(4), (count, 1, 1))
    if "ROTATION" in parts:
        lengths = np.linalg.norm(parts["ROTATION"], axis=1)
        if not np.all(lengths > 0):
            raise file.fail(f"{what}: rotation {np.flatnonzero(~(lengths > 0))[0]} is a quaternion of no length")
        with one_at_a_time:
            from scipy.spatial.transform import Rotation  # slow to import

        found[:, :3, :3] = Rotation.from_quat(parts["ROTATION"]).as_matrix()
    found[:, :3, :3] *= parts.get("SCALE", np.ones((count, 3)))[:, None]
    found[:, :3, 3] = parts.get("TRANSLATION", 0.0)
    notes.append(f"node {file.item('nodes', number).get('name', number)!r}: its mesh stands there {count:,} times")
    return found
