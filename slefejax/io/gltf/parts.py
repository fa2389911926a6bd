"""The triangles that hang on a node of a glTF file, with what moves their vertices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from slefejax.io.gltf.extensions import DRACO, extension_of
from slefejax.io.gltf.file import GltfFile
from slefejax.io.gltf.nodes import placements
from slefejax.io.gltf.rig import Joints, Part, read_skin
from slefejax.io.welding import welded_soundly
from slefejax.model.mesh import Mesh
from slefejax.model.texture import together


def read_part(file: GltfFile, joints: Joints, number: int, bones: bool, notes: list[str]) -> Part | None:
    """The mesh of a node, as often as it stands there, in the world or as its skin has it; None without triangles.

    bones : whether joints move anything in this file
    """
    node = joints.nodes[number]
    mesh = file.item("meshes", node.mesh)
    name = f"mesh {mesh.get('name', node.mesh)!r}"
    primitives = _Primitives(file, joints, number, name, notes)
    for primitive in mesh["primitives"]:
        primitives.read(primitive)
    if not primitives.places:
        return None
    given = (mesh.get("extras") or {}).get("targetNames") or []
    part = primitives.welded([str(given[k]) if k < len(given) else f"target {k}" for k in range(primitives.keys or 0)])
    if part is None:
        return None
    copies = placements(file, number, notes)
    if node.skin is not None:
        if copies is not None:
            notes.append(f"node {node.name!r} has a skin: copies of such meshes are not read, one was taken")
        joints.away = True
        return _turned(part) if joints.mirrored(part.joints, part.weights) else part
    if copies is not None:
        file.allow(3 * len(part.places) * len(copies), f"the copies of node {number}")
        file.allow(part.triangles.size * len(copies), f"the copies of node {number}")
    return _placed(joints, part, np.eye(4)[None] if copies is None else copies, bones, notes)


def _placed(joints: Joints, part: Part, copies: np.ndarray, bones: bool, notes: list[str]) -> Part | None:
    """A part that hangs on its node, at places ``(copies, 4, 4)`` of it."""
    own, name = joints.world[part.node], joints.nodes[part.node].name
    matrix = own
    if not np.abs(np.linalg.det(own[:3, :3])) > 0:
        if not bones and np.linalg.matrix_rank(own[:3, :3]) < 2:
            notes.append(f"node {name!r} is scaled to nothing: its mesh was left out")
            return None
        # a node that flattens what hangs on it has no place to bind it to
        matrix = np.eye(4) if bones else own
        joints.away |= bones
    joints.binds.setdefault(part.node, matrix)
    found = [_moved(part, matrix @ copy, bool(np.linalg.det((own @ copy)[:3, :3]) < 0)) for copy in copies]
    if not found:
        return None
    starts = len(part.places) * np.arange(len(found))
    return replace(
        part,
        places=np.concatenate([p.places for p in found]),
        triangles=np.concatenate([p.triangles + start for p, start in zip(found, starts, strict=True)]),
        joints=np.tile(part.joints, (len(found), 1)),
        weights=np.tile(part.weights, (len(found), 1)),
        texture=together([p.texture for p in found], [p.triangles.size for p in found]),
        offsets=[np.concatenate([p.offsets[k] for p in found]) for k in range(len(part.offsets))],
    )


def _moved(part: Part, matrix: np.ndarray, mirrored: bool) -> Part:
    places = part.places @ matrix[:3, :3].T + matrix[:3, 3]
    moved = replace(part, places=places, offsets=[offset @ matrix[:3, :3].T for offset in part.offsets])
    return _turned(moved) if mirrored else moved


def _turned(part: Part) -> Part:
    """With its other side as the front: what a mirror makes of it."""
    texture = None if part.texture is None else part.texture.reshape(-1, 3, 2)[:, [0, 2, 1]].reshape(-1, 2)
    return replace(part, triangles=part.triangles[:, [0, 2, 1]], texture=texture)


class _Primitives:
    """The primitives of the mesh of one node, as they are read one after the other."""

    def __init__(self, file: GltfFile, joints: Joints, number: int, name: str, notes: list[str]) -> None:
        self.file, self.joints, self.number, self.name, self.notes = file, joints, number, name, notes
        skin = joints.nodes[number].skin
        self.skin = None if skin is None else read_skin(file, joints, skin)
        self.keys: int | None = None
        self.places: list[np.ndarray] = []  # with offsets beside them
        self.bound: list[tuple[np.ndarray, np.ndarray]] = []
        self.triangles: list[np.ndarray] = []
        self.texture: list[np.ndarray | None] = []  # of vertices
        self.count = 0

    def read(self, primitive: dict) -> None:
        """Take one more. Raises InputError for what is not whole."""
        if primitive.get("mode", 4) not in (4, 5, 6):
            self.notes.append(f"{self.name}: points and lines were left out")
            return
        position = self.file.item("accessors", primitive["attributes"]["POSITION"])
        if extension_of(primitive, DRACO) and "bufferView" not in position:
            raise self.file.fail(
                f"{self.name} is compressed with Draco ({DRACO}), which is not read, and there is no plain copy of it:"
                " export without compression"
            )
        places = self.file.array(primitive["attributes"]["POSITION"], 3, f"{self.name}: positions")
        offsets = self._offsets(primitive, len(places))
        if self.keys is not None and len(offsets) != self.keys:
            raise self.file.fail(f"{self.name}: its primitives have {self.keys} and {len(offsets)} morph targets")
        self.keys = len(offsets)
        self.triangles.append(self.count + self._corners(primitive, len(places)))
        self.bound.append(self._bound(primitive, len(places)))
        self.texture.append(self._texture(primitive, len(places)))
        self.places.append(np.concatenate([np.asarray(places, np.float64), *offsets], axis=1))
        self.count += len(places)

    def _texture(self, primitive: dict, count: int) -> np.ndarray | None:
        """Coordinates ``(vertices, 2)`` of the first set, the second one up: the file has it down."""
        if "TEXCOORD_0" not in primitive["attributes"]:
            return None
        what = f"{self.name}: TEXCOORD_0"
        found = np.asarray(self.file.array(primitive["attributes"]["TEXCOORD_0"], 2, what), np.float64)
        if len(found) != count:
            raise self.file.fail(f"{what} has {len(found)} rows for {count} vertices")
        return found * [1.0, -1.0] + [0.0, 1.0]

    def _offsets(self, primitive: dict, count: int) -> list[np.ndarray]:
        """``(vertices, 3)`` of every morph target."""
        found = []
        for k, target in enumerate(primitive.get("targets", [])):
            offsets = np.zeros((count, 3))
            if "POSITION" in target:
                offsets = self.file.array(target["POSITION"], 3, f"{self.name}: morph target {k}")
            if len(offsets) != count:
                raise self.file.fail(f"{self.name}: morph target {k} has {len(offsets)} offsets for {count} vertices")
            found.append(np.asarray(offsets, np.float64))
        return found

    def _bound(self, primitive: dict, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Joints and weights of every vertex: -1 and 0 that fill up, then joints in order; without a skin, the node."""
        if self.skin is None:
            return np.full((count, 1), self.number), np.ones((count, 1))
        index, weight = self._influences(primitive, count)
        beyond = (weight != 0) & (index >= len(self.skin))
        if beyond.any():
            vertex, joint = np.flatnonzero(beyond.any(axis=1))[0], index[beyond][0]
            raise self.file.fail(
                f"{self.name}: vertex {vertex} has a weight for joint {joint}, but there are {len(self.skin)}"
            )
        index = np.where(weight != 0, self.skin[np.where(weight != 0, index, 0)], -1)
        loose = ~np.any(weight != 0, axis=1)
        if loose.any():
            index[loose, 0], weight[loose, 0] = self.joints.number(self.number, np.eye(4)), 1.0
            self.notes.append(
                f"{self.name}: all weights of {loose.sum()} vertices are 0 (the first is {np.flatnonzero(loose)[0]},"
                f" counted from 0): they follow node {self.joints.nodes[self.number].name!r} and no joint"
            )
        order = np.argsort(index, axis=1, kind="stable")
        return np.take_along_axis(index, order, 1), np.take_along_axis(weight, order, 1)

    def _influences(self, primitive: dict, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Numbers of the skin's joints and weights, ``(vertices, 4 k)``."""
        joints, weights = [], []
        while f"JOINTS_{len(joints)}" in primitive["attributes"]:
            for kind, into in (("JOINTS", joints), ("WEIGHTS", weights)):
                what = f"{self.name}: {kind}_{len(into)}"
                number = primitive["attributes"].get(f"{kind}_{len(into)}")
                into.append(np.asarray(self.file.array(number, 4, what, whole=kind == "JOINTS")))
                if len(into[-1]) != count:
                    raise self.file.fail(f"{what} has {len(into[-1])} rows for {count} vertices")
        if not joints:
            raise self.file.fail(f"{self.name} has a skin, but its vertices have no JOINTS_0")
        return np.concatenate(joints, axis=1).astype(np.int64), np.concatenate(weights, axis=1).astype(np.float64)

    def _corners(self, primitive: dict, count: int) -> np.ndarray:
        """``(triangles, 3)`` vertex numbers; strips and fans taken apart."""
        if "indices" in primitive:
            index = self.file.array(primitive["indices"], 1, f"{self.name}: indices", whole=True)
            index = index.ravel().astype(np.int64)
        else:
            index = np.arange(count)
        if index.size and index.max() >= count:
            raise self.file.fail(f"{self.name} has a triangle with vertex {index.max()}, but there are {count}")
        mode = primitive.get("mode", 4)
        if mode == 4:
            if len(index) % 3:
                raise self.file.fail(f"{self.name} has {len(index)} corners, which make no whole number of triangles")
            return index.reshape(-1, 3)
        k = np.arange(max(0, len(index) - 2))
        if mode == 6:
            return np.stack([np.full(len(k), index[0] if len(index) else 0), index[k + 1], index[k + 2]], axis=1)
        odd = k % 2
        return np.stack([index[k], index[k + 1 + odd], index[k + 2 - odd]], axis=1)

    def welded(self, names: list[str]) -> Part | None:
        """Vertices that agree in all that counts made one where that is sound; triangles without a size are dropped."""
        width = max(joints.shape[1] for joints, _ in self.bound)
        fill = [[(0, 0), (width - joints.shape[1], 0)] for joints, _ in self.bound]
        joints = np.concatenate([np.pad(b[0], f, constant_values=-1) for b, f in zip(self.bound, fill, strict=True)])
        weights = np.concatenate([np.pad(b[1], f) for b, f in zip(self.bound, fill, strict=True)])
        # + 0.0: no two kinds of zero
        every, inverse = np.unique(
            np.concatenate([np.concatenate(self.places), joints, weights], axis=1) + 0.0, axis=0, return_inverse=True
        )
        own = np.concatenate(self.triangles)
        triangles = inverse.ravel()[own]
        whole = np.all(triangles != np.roll(triangles, 1, axis=1), axis=1)
        node = f"node {self.joints.nodes[self.number].name!r}"
        if not whole.all():
            self.notes.append(f"{node}: {np.sum(~whole)} triangles of no size were dropped")
        if not whole.any():
            return None
        used, compact = np.unique(triangles[whole], return_inverse=True)
        mesh = Mesh.packed(every[used, :3], compact.ravel(), np.full(int(whole.sum()), 3))
        vertex, corners, apart = welded_soundly(mesh, own[whole].ravel())
        if apart:
            self.notes.append(f"{node}: in {apart} places surfaces only touch: their vertices there were kept apart")
        rows, keys = every[used[vertex]], self.keys or 0
        start = 3 + 3 * keys
        texture = together(self.texture, [len(places) for places in self.places])
        return Part(
            self.number,
            rows[:, :3],
            corners.reshape(-1, 3),
            rows[:, start : start + width].astype(np.int64),
            rows[:, start + width :],
            [rows[:, 3 + 3 * k : 6 + 3 * k] for k in range(keys)],
            names,
            None if texture is None else texture[own[whole].ravel()],
        )
