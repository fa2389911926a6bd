"""glTF 2.0 (.gltf, .glb): triangles as a control mesh, skins, morph targets, one of the animations.

Exporters split vertices where texture coordinates or normals differ. Here those are one vertex that agree bit for bit
in place, influences and morph targets. All nodes are joints, so that what hangs on a node moves with it; a skinned mesh
stands at rest where its own positions are.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from slefejax.errors import InputError
from slefejax.io.content import Y_UP, Content
from slefejax.io.gltf_file import GltfFile
from slefejax.io.gltf_motion import chosen_animation, motion_of
from slefejax.mesh import Mesh
from slefejax.rig import Rig, Skeleton, transform_of, transform_parts
from slefejax.skinning import Influences, Key, ShapeKeys

_MOST_NODES = 20_000


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


@dataclass
class _Part:
    """The mesh of one node, welded: one row a vertex."""

    node: int
    places: np.ndarray
    triangles: np.ndarray
    joints: np.ndarray
    weights: np.ndarray
    offsets: list[np.ndarray]
    names: list[str]


@dataclass
class _Joints:
    """Joints in the making: nodes first, then those of nodes that have two bind transforms."""

    nodes: list[Node]
    world: np.ndarray
    binds: dict[int, np.ndarray] = field(default_factory=dict)
    more: list[tuple[int, np.ndarray]] = field(default_factory=list)

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
        names = [node.name for node in self.nodes] + [self.nodes[owner].name for owner, _ in self.more]
        parents = [node.parent for node in self.nodes] + [owner for owner, _ in self.more]
        usable = [np.abs(np.linalg.det(matrix[:3, :3])) > 0 for matrix in self.world]
        own = [self.binds.get(k, self.world[k] if usable[k] else np.eye(4)) for k in range(len(self.nodes))]
        return Skeleton.of(names, parents, np.array(own + [bind for _, bind in self.more]))


def read_gltf(path: Path, animation: Any = None) -> Content:
    """The triangles of a file's scene with what moves them.

    animation : the name or the number of one of the file's; the first if not given

    Raises InputError for what is no such file or is not whole, naming the part.
    """
    file = GltfFile.of(path)
    try:
        return _content(file, animation)
    except InputError:
        raise
    except (KeyError, TypeError, IndexError, AttributeError, ValueError, OverflowError, MemoryError) as error:
        raise file.fail(f"it is not glTF as it should be ({type(error).__name__}: {error})") from None


def _content(file: GltfFile, animation: Any) -> Content:
    nodes, shown = _nodes(file), _shown(file)
    joints = _Joints(nodes, _world(file, nodes))
    notes: list[str] = []
    parts = [part for k in shown if nodes[k].mesh is not None for part in [_part(file, joints, k, notes)] if part]
    if not parts:
        raise file.fail("there are no triangles in it")
    mesh = _joined(parts)
    chosen = chosen_animation(file, animation, notes)
    skinned = any(nodes[part.node].skin is not None for part in parts)
    moved = {
        channel["target"].get("node")
        for channel in (chosen or {}).get("channels", [])
        if channel["target"].get("path") != "weights"
    }
    bones = skinned or bool(moved)
    keys, owners = _keys(parts)
    try:
        skeleton = joints.skeleton() if bones else None
        influences = _influences(parts, len(skeleton.names)) if skeleton is not None else None
        shapes = ShapeKeys.of(keys, mesh.vertex_count) if keys else None
    except InputError as error:
        raise file.fail(str(error)) from None
    if skeleton is None and shapes is None:
        return Content(mesh, up=Y_UP, notes=tuple(notes))
    motion = motion_of(file, chosen, nodes, len(joints.more) if bones else None, owners)
    return Content(mesh, up=Y_UP, notes=tuple(notes), rig=Rig(skeleton, influences, shapes, motion, rate=1.0))


def _nodes(file: GltfFile) -> list[Node]:
    count = len(file.content.get("nodes", []))
    if count > _MOST_NODES:
        raise file.fail(f"there are {count:,} nodes, more than {_MOST_NODES:,}")
    parents = np.full(count, -1)
    nodes = []
    for number in range(count):
        for child in file.item("nodes", number).get("children", []):
            file.item("nodes", child)
            if parents[child] >= 0:
                raise file.fail(f"node {child} has two parents, {parents[child]} and {number}")
            parents[child] = number
    for number in range(count):
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
        nodes.append(
            Node(name, int(parents[number]), *parts, given.get("mesh"), given.get("skin"), given.get("weights"))
        )
    return nodes


def _three(values: Any) -> np.ndarray:
    x, y, z = (float(v) for v in values)
    return np.array([x, y, z])


def _shown(file: GltfFile) -> list[int]:
    """Nodes of the file's scene, or all if it names none."""
    scenes = file.content.get("scenes")
    if not scenes:
        return list(range(len(file.content.get("nodes", []))))
    found, waiting = set(), list(file.item("scenes", file.content.get("scene", 0)).get("nodes", []))
    while waiting:
        node = waiting.pop()
        children = file.item("nodes", node).get("children", [])
        if node in found:
            raise file.fail(f"node {node} is its own ancestor, or twice in the scene")
        found.add(node)
        waiting += children
    return sorted(found)


def _world(file: GltfFile, nodes: list[Node]) -> np.ndarray:
    """World transforms of all nodes at rest."""
    own = [transform_of(node.translation, node.rotation, node.scale) for node in nodes]
    world: list[np.ndarray | None] = [None] * len(nodes)
    children: dict[int, list[int]] = {}
    for k, node in enumerate(nodes):
        children.setdefault(node.parent, []).append(k)
    waiting = list(children.get(-1, []))
    while waiting:
        k = waiting.pop()
        above = world[nodes[k].parent] if nodes[k].parent >= 0 else None
        world[k] = own[k] if above is None else above @ own[k]
        waiting += children.get(k, [])
    lost = [k for k, matrix in enumerate(world) if matrix is None]
    if lost:
        raise file.fail(f"node {lost[0]} is its own ancestor")
    return np.array(world).reshape(-1, 4, 4)


def _part(file: GltfFile, joints: _Joints, number: int, notes: list[str]) -> _Part | None:
    """The triangles of a node; None if it has none."""
    node = joints.nodes[number]
    mesh = file.item("meshes", node.mesh)
    name = f"mesh {mesh.get('name', node.mesh)!r}"
    rows, triangles, start, keys = [], [], 0, None
    skin = None if node.skin is None else _skin(file, joints, node.skin)
    for primitive in mesh["primitives"]:
        if primitive.get("mode", 4) not in (4, 5, 6):
            notes.append(f"{name}: points and lines were left out")
            continue
        places = np.asarray(file.array(primitive["attributes"]["POSITION"], 3, f"{name}: positions"), np.float64)
        offsets = _offsets(file, primitive, len(places), name)
        if keys is not None and len(offsets) != keys:
            raise file.fail(f"{name}: its primitives have {keys} and {len(offsets)} morph targets")
        keys = len(offsets)
        moved, weights = _bound(file, primitive, skin, number, len(places), name)
        rows.append(np.concatenate([places, *offsets, moved, weights], axis=1))
        triangles.append(start + _corners(file, primitive, len(places), name))
        start += len(places)
    if not rows:
        return None
    return _welded(file, joints, number, rows, np.concatenate(triangles), keys or 0, notes)


def _skin(file: GltfFile, joints: _Joints, number: int) -> np.ndarray:
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


def _offsets(file: GltfFile, primitive: dict, count: int, name: str) -> list[np.ndarray]:
    """``(vertices, 3)`` of every morph target."""
    found = []
    for k, target in enumerate(primitive.get("targets", [])):
        offsets = np.zeros((count, 3))
        if "POSITION" in target:
            offsets = np.asarray(file.array(target["POSITION"], 3, f"{name}: morph target {k}"), np.float64)
        if len(offsets) != count:
            raise file.fail(f"{name}: morph target {k} has {len(offsets)} offsets for {count} vertices")
        found.append(offsets)
    return found


def _bound(
    file: GltfFile, primitive: dict, skin: np.ndarray | None, node: int, count: int, name: str
) -> tuple[np.ndarray, np.ndarray]:
    """Joints and weights of every vertex, the joint with the lowest number first; of one that has no skin, its node."""
    if skin is None:
        return np.full((count, 1), float(node)), np.ones((count, 1))
    joints, weights = [], []
    while f"JOINTS_{len(joints)}" in primitive["attributes"]:
        for kind, into in (("JOINTS", joints), ("WEIGHTS", weights)):
            what = f"{name}: {kind}_{len(into)}"
            number = primitive["attributes"].get(f"{kind}_{len(into)}")
            into.append(np.asarray(file.array(number, 4, what, whole=kind == "JOINTS")))
            if len(into[-1]) != count:
                raise file.fail(f"{what} has {len(into[-1])} rows for {count} vertices")
    if not joints:
        raise file.fail(f"{name} has a skin, but its vertices have no JOINTS_0")
    index, weight = np.concatenate(joints, axis=1).astype(np.int64), np.concatenate(weights, axis=1).astype(np.float64)
    beyond = (weight != 0) & (index >= len(skin))
    if beyond.any():
        vertex = np.flatnonzero(beyond.any(axis=1))[0]
        raise file.fail(f"{name}: vertex {vertex} has a weight for joint {index[beyond][0]}, but there are {len(skin)}")
    index = np.where(weight != 0, skin[np.where(weight != 0, index, 0)], -1)
    order = np.argsort(index, axis=1, kind="stable")
    return np.take_along_axis(index, order, 1).astype(float), np.take_along_axis(weight, order, 1)


def _corners(file: GltfFile, primitive: dict, count: int, name: str) -> np.ndarray:
    """``(triangles, 3)`` vertex numbers; strips and fans taken apart."""
    if "indices" in primitive:
        index = file.array(primitive["indices"], 1, f"{name}: indices", whole=True).ravel().astype(np.int64)
    else:
        index = np.arange(count)
    if index.size and index.max() >= count:
        raise file.fail(f"{name} has a triangle with vertex {index.max()}, but there are {count}")
    mode = primitive.get("mode", 4)
    if mode == 4:
        if len(index) % 3:
            raise file.fail(f"{name} has {len(index)} corners, which make no whole number of triangles")
        return index.reshape(-1, 3)
    k = np.arange(max(0, len(index) - 2))
    if mode == 6:
        return np.stack([np.full(len(k), index[0] if len(index) else 0), index[k + 1], index[k + 2]], axis=1)
    odd = k % 2
    return np.stack([index[k], index[k + 1 + odd], index[k + 2 - odd]], axis=1)


def _welded(
    file: GltfFile, joints: _Joints, number: int, rows: list, triangles: np.ndarray, keys: int, notes: list[str]
) -> _Part:
    """Vertices that agree in all that counts made one; triangles that have two equal corners then are dropped."""
    width = max(row.shape[1] for row in rows)
    pad = [np.pad(row, [(0, 0), (0, 0)]) for row in rows]
    if any(row.shape[1] != width for row in rows):
        raise file.fail(f"node {number}: the primitives of its mesh have different numbers of influences")
    every, inverse = np.unique(np.concatenate(pad) + 0.0, axis=0, return_inverse=True)
    triangles = inverse.ravel()[triangles]
    whole = np.all(triangles != np.roll(triangles, 1, axis=1), axis=1)
    if not whole.all():
        notes.append(f"node {joints.nodes[number].name!r}: {np.sum(~whole)} triangles of no size were dropped")
    used, compact = np.unique(triangles[whole], return_inverse=True)
    every, triangles = every[used], compact.reshape(-1, 3)
    bound = every[:, 3 + 3 * keys :]
    half = bound.shape[1] // 2
    offsets = [every[:, 3 + 3 * k : 6 + 3 * k] for k in range(keys)]
    places = every[:, :3]
    if joints.nodes[number].skin is None:
        # a node of no size, which hides what hangs on it, has no place to bind it to
        own = joints.world[number]
        matrix = own if np.abs(np.linalg.det(own[:3, :3])) > 0 else np.eye(4)
        places = places @ matrix[:3, :3].T + matrix[:3, 3]
        offsets = [offset @ matrix[:3, :3].T for offset in offsets]
        joints.binds.setdefault(number, matrix)
    mesh = file.item("meshes", joints.nodes[number].mesh)
    given = (mesh.get("extras") or {}).get("targetNames") or []
    names = [str(given[k]) if k < len(given) else f"target {k}" for k in range(keys)]
    return _Part(number, places, triangles, bound[:, :half].astype(np.int64), bound[:, half:], offsets, names)


def _joined(parts: list[_Part]) -> Mesh:
    starts = np.cumsum([0, *(len(part.places) for part in parts[:-1])])
    corners = np.concatenate([(part.triangles + start).ravel() for part, start in zip(parts, starts, strict=True)])
    return Mesh.packed(np.concatenate([p.places for p in parts]), corners, np.full(len(corners) // 3, 3))


def _influences(parts: list[_Part], joints: int) -> Influences:
    width = max(part.joints.shape[1] for part in parts)
    filled = [[np.pad(x, [(0, 0), (0, width - x.shape[1])]) for x in (part.joints, part.weights)] for part in parts]
    index, weight = (np.concatenate(column) for column in zip(*filled, strict=True))
    return Influences.of(np.where(weight != 0, index, 0), weight, joints)


def _keys(parts: list[_Part]) -> tuple[list[Key], list[tuple[int, int]]]:
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
