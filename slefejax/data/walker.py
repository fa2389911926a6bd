"""A character that walks: quads with some triangles, 20 bones, 6 shape keys, one cycle of 24 frames.

Made by this script: cells of a lattice in the shape of a figure with its arms out, one step of subdivision of their
surface, evened out; influences by the distance to the bones; angles that go round like sines. It faces -y and is 1.8
units high, z up.
"""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np

from slefejax.conversion.catmull_clark import refine
from slefejax.io.content import Content
from slefejax.late import one_at_a_time
from slefejax.model.mesh import Mesh
from slefejax.model.rig import Motion, Rig, Skeleton
from slefejax.model.skinning import Influences, Key, ShapeKeys

FRAMES = 24
_CELL = 0.078
_DEPTH = 1.3  # of a cell along y, in units of the others
_MOST = 4  # bones a vertex
_ROUNDS, _OUTWARDS = 8, 0.5  # how much the figure is evened out, and then widened, in cells

# Boxes of cells, (from, to) along x, y, z; those with x > 0 only are mirrored.
_BOXES = (
    ((-3, 3), (-1, 1), (11, 18)),
    ((-1, 1), (-1, 1), (18, 19)),
    ((-2, 2), (-2, 2), (19, 23)),
    ((-1, 1), (-3, -2), (20, 21)),
    ((1, 3), (-1, 1), (1, 11)),
    ((1, 3), (-3, 1), (0, 1)),
    ((3, 11), (-1, 1), (16, 18)),
    ((9, 10), (-2, -1), (16, 17)),
)
# name, parent, head and tail in cells; those that end in .L are mirrored to .R
_BONES = (
    ("hips", None, (0, 0, 11.5), (0, 0, 14)),
    ("spine", "hips", (0, 0, 14), (0, 0, 16)),
    ("chest", "spine", (0, 0, 16), (0, 0, 18.5)),
    ("head", "chest", (0, 0, 18.5), (0, 0, 23)),
    ("shoulder.L", "chest", (1.5, 0, 17), (3, 0, 17)),
    ("arm.L", "shoulder.L", (3, 0, 17), (6, 0, 17)),
    ("forearm.L", "arm.L", (6, 0, 17), (9, 0, 17)),
    ("hand.L", "forearm.L", (9, 0, 17), (11, 0, 17)),
    ("thigh.L", "hips", (2, 0, 11), (2, 0, 6)),
    ("shin.L", "thigh.L", (2, 0, 6), (2, 0, 1)),
    ("foot.L", "shin.L", (2, 0, 1), (2, -1.5, 0.5)),
    ("toes.L", "foot.L", (2, -1.5, 0.5), (2, -3, 0.5)),
)
# name, where (cells, mirrored), how far it reaches (cells), which way it moves (cells)
_KEYS = (
    ("smile", (1.1, -2, 19.9), 0.8, (0.25, 0.0, 0.35)),
    ("brows", (0.9, -2, 21.9), 0.8, (0.0, -0.15, 0.35)),
    ("cheeks", (1.6, -1.6, 20.4), 1.0, (0.4, -0.25, 0.0)),
    ("breath", (1.2, -1, 16), 1.8, (0.15, -0.45, 0.1)),
    ("belly", (0.8, -1, 12.8), 1.8, (0.1, -0.7, 0.0)),
    ("biceps", (4.5, 0, 17.8), 1.3, (0.0, -0.1, 0.35)),
)


def walker() -> Content:
    """The control mesh and the rig.

    >>> content = walker()
    >>> content.mesh is not None, content.rig is not None
    (True, True)
    """
    mesh = _with_triangles(_figure())
    names, parents, heads, tails = _bones()
    bind = np.tile(np.eye(4), (len(names), 1, 1))
    bind[:, :3, 3] = heads
    skeleton = Skeleton.of(names, parents, bind)
    rig = Rig(
        skeleton,
        _influences(mesh, parents, heads, tails),
        ShapeKeys.of([_key(mesh.vertices, *key) for key in _KEYS], mesh.vertex_count),
        _walk(names, parents, heads),
        rate=24.0,
    )
    return Content(mesh, rig=rig)


def _world(cells: Any) -> np.ndarray:
    return np.asarray(cells, float) * (_CELL, _CELL * _DEPTH, _CELL)


def _cells() -> set[tuple[int, int, int]]:
    filled = set()
    for box in _BOXES:
        for x, y, z in product(*(range(*side) for side in box)):
            filled |= {(x, y, z), (-1 - x, y, z)}
    return filled


def _figure() -> Mesh:
    """The surface of the cells, once subdivided."""
    filled = _cells()
    numbers: dict[tuple[int, ...], int] = {}
    faces = []
    for cell in sorted(filled):
        for axis, side in product(range(3), (0, 1)):
            step = np.eye(3, dtype=int)[axis]
            if tuple(np.add(cell, step if side else -step).tolist()) in filled:
                continue
            u, v = np.eye(3, dtype=int)[(axis + 1) % 3], np.eye(3, dtype=int)[(axis + 2) % 3]
            origin = np.add(cell, side * step)
            corners = [origin, origin + u, origin + u + v, origin + v]
            ordered = corners if side else corners[::-1]
            faces.append([numbers.setdefault(tuple(c.tolist()), len(numbers)) for c in ordered])
    coarse = Mesh.of(_world(np.array(list(numbers))), faces)
    finer, table, _ = refine(coarse)
    finer = Mesh.packed(table.on_host(coarse.vertices), finer.corners, finer.sizes)
    return replace(finer, vertices=_rounded(finer))


def _rounded(mesh: Mesh) -> np.ndarray:
    """Positions evened out between neighbours, and moved outwards by about what that took away."""
    places = mesh.vertices
    for _ in range(_ROUNDS):
        places = 0.5 * places + 0.5 * _around(mesh, places)
    corners = places[mesh.corners.reshape(-1, 4)]
    across = np.cross(corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1])
    normal = np.zeros_like(places)
    np.add.at(normal, mesh.corners, np.repeat(across, 4, axis=0))
    return places + _OUTWARDS * _CELL * normal / np.linalg.norm(normal, axis=1, keepdims=True)


def _around(mesh: Mesh, values: np.ndarray) -> np.ndarray:
    """The mean of the values of a vertex's neighbours."""
    a, b = mesh.edge_vertices.T
    total = np.zeros_like(values)
    np.add.at(total, a, values[b])
    np.add.at(total, b, values[a])
    return total / mesh.valence[:, None]


def _with_triangles(mesh: Mesh) -> Mesh:
    """The quads at the crown of the head and at the tips of hands and feet are cut in two."""
    middle = mesh.vertices[mesh.corners].reshape(-1, 4, 3).mean(axis=1) / _world(np.ones(3))
    cut = (middle[:, 2] > 22.5) | (np.abs(middle[:, 0]) > 10.5) | (middle[:, 1] < -2.5) & (middle[:, 2] < 5)
    quads = mesh.corners.reshape(-1, 4)
    faces = [tuple(quad) for quad in quads[~cut]]
    for a, b, c, d in quads[cut]:
        faces += [(a, b, c), (a, c, d)]
    return Mesh.of(mesh.vertices, faces)


def _bones() -> tuple[list[str], list[int], np.ndarray, np.ndarray]:
    """Names, parents, heads and tails of all bones."""
    every: list[Any] = list(_BONES)
    for name, parent, head, tail in _BONES:
        if name.endswith(".L"):
            mirrored = [(-end[0], *end[1:]) for end in (head, tail)]
            every.append((name[:-1] + "R", (parent or "").replace(".L", ".R"), mirrored[0], mirrored[1]))
    names = [bone[0] for bone in every]
    parents = [-1 if bone[1] is None else names.index(bone[1]) for bone in every]
    return names, parents, _world([bone[2] for bone in every]), _world([bone[3] for bone in every])


def _influences(mesh: Mesh, parents: list[int], heads: np.ndarray, tails: np.ndarray) -> Influences:
    """The nearest bone, its parent and its children, the nearer the more; then evened out between neighbours."""
    along = tails - heads
    offset = mesh.vertices[:, None] - heads
    share = np.clip(np.sum(offset * along, axis=2) / np.sum(along**2, axis=1), 0.0, 1.0)
    distance = np.linalg.norm(offset - share[..., None] * along, axis=2)
    related = np.eye(len(heads), dtype=bool)
    for bone, parent in enumerate(parents):
        if parent >= 0:
            related[bone, parent] = related[parent, bone] = True
    weights = np.where(related[distance.argmin(axis=1)], (distance / _CELL + 0.3) ** -4.0, 0.0)
    for _ in range(3):
        weights = weights / weights.sum(axis=1, keepdims=True)
        weights = 0.5 * weights + 0.5 * _around(mesh, weights)
    strongest = np.argsort(-weights, axis=1, kind="stable")[:, :_MOST]
    kept = np.take_along_axis(weights, strongest, axis=1)
    return Influences.of(strongest, np.where(kept > 1e-3, kept, 0.0), len(heads))


def _key(vertices: np.ndarray, name: str, place: tuple, reach: float, way: tuple) -> Key:
    """A bump on both sides; offsets beyond thrice its reach are none."""
    offsets = np.zeros_like(vertices)
    for side in (1.0, -1.0):
        apart = np.linalg.norm((vertices - _world(np.array(place) * (side, 1, 1))) / _CELL, axis=1) / reach
        bump = np.where(apart < 3.0, np.exp(-(apart**2)) - np.exp(-9.0), 0.0)
        offsets += bump[:, None] * _world(np.array(way) * (side, 1, 1))
    moved = np.flatnonzero(np.any(offsets != 0, axis=1))
    return Key(name, ((moved, offsets[moved]),))


def _walk(names: list[str], parents: list[int], heads: np.ndarray) -> Motion:
    """One cycle; the last sample is the first one again."""
    times = np.arange(FRAMES + 1.0)
    phase = 2.0 * np.pi * times / FRAMES
    turns = {name: np.zeros((len(times), 3)) for name in names}  # degrees about x, y, z, in this order
    for side, start in (("L", 0.0), ("R", np.pi)):
        sign = 1.0 if side == "L" else -1.0
        own = phase + start
        thigh, knee = 26.0 * np.sin(own), 8.0 + 45.0 * np.maximum(np.cos(own), 0.0) ** 2
        turns[f"thigh.{side}"][:, 0] = -thigh
        turns[f"shin.{side}"][:, 0] = knee
        turns[f"foot.{side}"][:, 0] = 0.5 * thigh - 0.35 * knee
        turns[f"toes.{side}"][:, 0] = -25.0 * np.maximum(-np.sin(own), 0.0) ** 2
        turns[f"shoulder.{side}"][:, 1] = 8.0 * sign
        turns[f"arm.{side}"][:, 0] = 24.0 * np.sin(own)
        turns[f"arm.{side}"][:, 1] = 64.0 * sign
        turns[f"forearm.{side}"][:, 2] = -sign * (25.0 - 12.0 * np.sin(own))
        turns[f"hand.{side}"][:, 2] = -10.0 * sign
    turns["hips"][:, 2] = -6.0 * np.sin(phase)
    turns["spine"][:, 2] = 5.0 * np.sin(phase)
    turns["chest"][:, 2] = 7.0 * np.sin(phase)
    turns["head"][:, 2] = -6.0 * np.sin(phase)
    turns["head"][:, 0] = 2.0 * np.cos(2.0 * phase)
    with one_at_a_time:
        from scipy.spatial.transform import Rotation  # slow to import

    rotations = np.stack([Rotation.from_euler("XYZ", turns[n], degrees=True).as_quat() for n in names], axis=1)
    offsets = heads - np.where(np.array(parents)[:, None] >= 0, heads[parents], 0.0)
    translations = np.repeat(offsets[None], len(times), axis=0)
    translations[:, 0, 2] += _CELL * (0.25 * np.cos(2.0 * phase) - 0.45)
    return Motion(times, translations, rotations[..., [3, 0, 1, 2]], keys=_weights(phase))


def _weights(phase: np.ndarray) -> np.ndarray:
    """``(samples, keys)``: it smiles once a cycle, breathes twice, and its arms tighten as they swing."""
    slow, fast = 0.5 - 0.5 * np.cos(phase), 0.5 - 0.5 * np.cos(2.0 * phase)
    return np.stack([slow, 0.6 * slow, 0.3 * fast, fast, 0.5 * (1.0 - fast), fast], axis=1)
