"""Topology of polygon meshes, on the host: half-edges, fans of faces around vertices, boundaries, creases, defects.

Every face is a run of corners; corner c stands for the half-edge from its vertex to the next one of its face:

              prev_corner(c)
        X ------------------ .        start(c) = V    end(c) = W     face f on the left (counter-clockwise)
        |                    |        twin(c)  : the half-edge W -> V of the neighbouring face, -1 at a boundary
        |  f                 |        turn(c)  : the next corner at V, counter-clockwise: that of the half-edge V -> X
        |                    |                   in the neighbour across V X, -1 at a boundary
        V ------------------ W
          half-edge c

A *fan* is a run of corners around a vertex, each the turn of the one before: closed around an interior vertex, open at
a boundary. ``Fans`` may be made to end elsewhere, so that a sharp crease divides its vertices as a boundary would.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.sparse import coo_array

from slefejax.arguments import real_numbers, whole_numbers
from slefejax.errors import InputError
from slefejax.late import one_at_a_time


@dataclass(frozen=True, eq=False)
class Fans:
    """Corners around vertices, in order.

    fan      : ``(corners,)``, number of the fan of every corner
    position : ``(corners,)``, its place in the fan, from 0, counter-clockwise
    size     : ``(fans,)``, number of corners (faces)
    closed   : ``(fans,)``, whether the last is followed by the first
    vertex   : ``(fans,)``
    """

    fan: Int[np.ndarray, "corners"]
    position: Int[np.ndarray, "corners"]
    size: Int[np.ndarray, "fans"]
    closed: Bool[np.ndarray, "fans"]
    vertex: Int[np.ndarray, "fans"]


@dataclass(frozen=True, eq=False)
class Mesh:
    """A control mesh: positions, polygons, and how sharp its edges and vertices are. Build it with ``Mesh.of``.

    vertices  : ``(vertices, 3)`` float64
    corners   : ``(corners,)``, vertex numbers, face after face, counter-clockwise seen from outside
    offsets   : ``(faces + 1,)``, where each face begins in ``corners``
    creases   : ``(creases, 2)``, pairs of vertices joined by an edge, and ``crease_sharpness``: steps of subdivision
                for which the edge stays sharp
    points    : ``(points,)``, vertices that stay sharp, and ``point_sharpness``
    numbers   : ``(faces,)``, the number that each face has in its file
    covariances : ``(vertices, 3, 3)``, of a covariance mesh (``slefejax.model.gaussians``); None of others
    texture   : ``(corners, 2)``, texture coordinates of every corner, the second one up; NaN where a file has none,
                None where it has none at all

    >>> Mesh.of([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2, 3]]).sizes.tolist()
    [4]
    """

    vertices: Float[np.ndarray, "vertices 3"]
    corners: Int[np.ndarray, "corners"]
    offsets: Int[np.ndarray, "faces_and_one"]
    numbers: Int[np.ndarray, "faces"]
    creases: Int[np.ndarray, "creases 2"] = field(default_factory=lambda: np.zeros((0, 2), np.int64))
    crease_sharpness: Float[np.ndarray, "creases"] = field(default_factory=lambda: np.zeros(0))
    points: Int[np.ndarray, "points"] = field(default_factory=lambda: np.zeros(0, np.int64))
    point_sharpness: Float[np.ndarray, "points"] = field(default_factory=lambda: np.zeros(0))
    covariances: Float[np.ndarray, "vertices 3 3"] | None = None
    texture: Float[np.ndarray, "corners 2"] | None = None

    @staticmethod
    def of(vertices: Any, faces: Iterable[Any]) -> Mesh:
        """A mesh from positions ``(vertices, 3)`` and faces, each a sequence of vertex numbers from 0.

        Raises InputError for positions that are not finite, faces with fewer than three corners, and vertex numbers
        that do not exist. Whether it is manifold is another question: ``defects``.

        >>> cube = Mesh.of(np.eye(4, 3), [(0, 1, 2), (0, 2, 3)])
        >>> cube.face_count, cube.valence.tolist()
        (2, [3, 2, 3, 2])
        """
        try:
            lists = [list(face) for face in faces]
        except TypeError:
            raise InputError("faces must be sequences of vertex numbers, one for each face") from None
        sizes = np.array([len(face) for face in lists], np.int64)
        few = np.flatnonzero(sizes < 3)
        if few.size:
            raise InputError(f"face {few[0]} (counted from 0) has {sizes[few[0]]} vertices: it needs three")
        corners = [v for face in lists for v in face]
        if not all(isinstance(v, (int, np.integer)) for v in corners):
            raise InputError("faces must name vertices by whole numbers, from 0 on")
        return Mesh.packed(vertices, corners, sizes)

    @staticmethod
    def packed(vertices: Any, corners: Any, sizes: Any, numbers: Any = None, texture: Any = None, **sharp: Any) -> Mesh:
        """The same from all corners in one array and the number of corners of every face; checked likewise.

        Faces of fewer than three corners, which files have, are taken: they are a defect (``defects``) that is told or
        dropped with the others.

        numbers : of the faces in their file, if those are not 0, 1, 2 …
        texture : coordinates of every corner, if there are any
        sharp   : ``creases``, ``crease_sharpness``, ``points``, ``point_sharpness``
        """
        vertices, corners = real_numbers(vertices, "vertices"), whole_numbers(corners, "vertex numbers of faces")
        sizes = whole_numbers(sizes, "sizes of faces")
        numbers = np.arange(len(sizes)) if numbers is None else np.asarray(numbers, np.int64)
        if vertices.ndim != 2 or vertices.shape[1] != 3:
            raise InputError(f"vertices must be an array (vertices, 3), not {vertices.shape}")
        if len(sizes) == 0:
            raise InputError("a mesh needs at least one face")
        bad = np.flatnonzero(~np.isfinite(vertices).all(axis=1))
        if bad.size:
            raise InputError(f"vertex {bad[0]} (counted from 0) is not at a finite place: {vertices[bad[0]].tolist()}")
        if np.any(sizes < 0):
            raise InputError("a face has a negative number of vertices")
        offsets = np.concatenate([[0], np.cumsum(sizes)])
        wrong = np.flatnonzero((corners < 0) | (corners >= len(vertices)))
        if wrong.size:
            face = int(np.searchsorted(offsets, wrong[0], side="right")) - 1
            raise InputError(
                f"face {numbers[face]} (counted from 0) has a vertex {corners[wrong[0]]}, but there are {len(vertices)}"
            )
        for name, at, sharpness in (
            ("crease", "creases", "crease_sharpness"),
            ("sharp vertex", "points", "point_sharpness"),
        ):
            if at in sharp or sharpness in sharp:
                _check_sharp(name, np.asarray(sharp[at]), np.asarray(sharp[sharpness]), len(vertices))
        texture = None if texture is None else _checked_texture(texture, len(corners))
        return Mesh(vertices, corners, offsets, numbers, texture=texture, **sharp)

    def turned(self) -> Mesh:
        """The same with its other side as the front: every face the other way round from the same vertex on."""
        start, size = self.offsets[:-1][self.face], self.sizes[self.face]
        place = np.arange(len(self.corners)) - start
        order = start + (size - place) % size
        return replace(self, corners=self.corners[order], texture=None if self.texture is None else self.texture[order])

    @property
    def face_count(self) -> int:
        """How many faces there are."""
        return len(self.offsets) - 1

    @property
    def vertex_count(self) -> int:
        """How many vertices there are, used or not."""
        return len(self.vertices)

    @cached_property
    def sizes(self) -> Int[np.ndarray, "faces"]:
        """The number of corners of every face."""
        return np.diff(self.offsets)

    @cached_property
    def face(self) -> Int[np.ndarray, "corners"]:
        """The face of every corner."""
        return np.repeat(np.arange(self.face_count), self.sizes)

    @cached_property
    def next_corner(self) -> Int[np.ndarray, "corners"]:
        """The corner that follows in the face."""
        following = np.arange(1, len(self.corners) + 1)
        some = self.sizes > 0
        following[self.offsets[1:][some] - 1] = self.offsets[:-1][some]
        return following

    @cached_property
    def prev_corner(self) -> Int[np.ndarray, "corners"]:
        """The corner before in the face."""
        before = np.arange(-1, len(self.corners) - 1)
        some = self.sizes > 0
        before[self.offsets[:-1][some]] = self.offsets[1:][some] - 1
        return before

    @cached_property
    def ends(self) -> Int[np.ndarray, "corners"]:
        """The vertex at the end of every half-edge."""
        return self.corners[self.next_corner]

    @cached_property
    def _keys(self) -> Int[np.ndarray, "corners"]:
        return self._pair_keys(np.stack([self.corners, self.ends], axis=1))

    def _pair_keys(self, pairs: Int[np.ndarray, "pairs 2"]) -> Int[np.ndarray, "pairs"]:
        return pairs.min(axis=1) * self.vertex_count + pairs.max(axis=1)

    @cached_property
    def _edge_numbering(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        return np.unique(self._keys, return_inverse=True, return_counts=True)

    @cached_property
    def edge(self) -> Int[np.ndarray, "corners"]:
        """The number of the undirected edge of every half-edge."""
        return self._edge_numbering[1].ravel()

    @property
    def edge_count(self) -> int:
        """How many undirected edges there are."""
        return len(self._edge_numbering[0])

    @cached_property
    def edge_vertices(self) -> Int[np.ndarray, "edges 2"]:
        """The two vertices of every edge, the lower number first."""
        return np.stack(np.divmod(self._edge_numbering[0], self.vertex_count), axis=1)

    def edge_between(self, pairs: Int[np.ndarray, "pairs 2"]) -> Int[np.ndarray, "pairs"]:
        """The number of the edge between two vertices that exist, -1 where there is none."""
        keys, wanted = self._edge_numbering[0], self._pair_keys(pairs)
        place = np.minimum(np.searchsorted(keys, wanted), len(keys) - 1)
        return np.where(keys[place] == wanted, place, -1)

    @cached_property
    def edge_faces(self) -> Int[np.ndarray, "edges"]:
        """How many faces meet in every edge."""
        return self._edge_numbering[2]

    @cached_property
    def twin(self) -> Int[np.ndarray, "corners"]:
        """The half-edge of the neighbouring face, -1 at a boundary or where an edge has no two opposite sides."""
        order = np.argsort(self.edge, kind="stable")
        first = np.searchsorted(self.edge[order], np.arange(self.edge_count))
        pairs = np.flatnonzero(self.edge_faces == 2)
        one, other = order[first[pairs]], order[first[pairs] + 1]
        opposite = self.corners[one] == self.ends[other]
        one, other = one[opposite], other[opposite]
        twin = np.full(len(self.corners), -1)
        twin[one], twin[other] = other, one
        return twin

    @cached_property
    def boundary(self) -> Bool[np.ndarray, "edges"]:
        """Whether an edge has one face only."""
        return self.edge_faces == 1

    @cached_property
    def valence(self) -> Int[np.ndarray, "vertices"]:
        """The number of edges at every vertex; 0 if it is not used."""
        return np.bincount(self.edge_vertices.ravel(), minlength=self.vertex_count)

    @cached_property
    def edge_sharpness(self) -> Float[np.ndarray, "edges"]:
        """For how many steps of subdivision every edge stays sharp; infinite at a boundary.

        Raises InputError for a crease between vertices that no edge joins.
        """
        sharpness, edge = np.where(self.boundary, np.inf, 0.0), self.edge_between(self.creases)
        missing = np.flatnonzero(edge < 0)
        if missing.size:
            a, b = self.creases[missing[0]].tolist()
            raise InputError(f"crease {missing[0]} joins vertices {a} and {b} (counted from 0), but no edge does")
        np.maximum.at(sharpness, edge, self.crease_sharpness)
        return sharpness

    @cached_property
    def vertex_sharpness(self) -> Float[np.ndarray, "vertices"]:
        """For how many steps every vertex itself stays sharp (not counting what its edges do)."""
        sharpness = np.zeros(self.vertex_count)
        np.maximum.at(sharpness, self.points, self.point_sharpness)
        return sharpness

    def fans(self, last: Bool[np.ndarray, "corners"] | None = None) -> Fans:
        """The fans around vertices; they end at boundaries and at the corners that ``last`` names."""
        turn = self.twin[self.prev_corner]
        return _ordered(turn if last is None else np.where(last, -1, turn), self.corners)

    @cached_property
    def components(self) -> tuple[int, Int[np.ndarray, "faces"]]:
        """How many pieces hang together by vertices, and the piece of every face."""
        count, faces = self.vertex_count, self.face_count
        _, labels = connected(faces + count, self.face, faces + self.corners)
        pieces, piece = np.unique(labels[:faces], return_inverse=True)
        return len(pieces), piece.ravel()

    def one_ring(self, vertex: int) -> Int[np.ndarray, "neighbours"]:
        """The neighbours of a vertex, counter-clockwise, from one boundary to the other if it lies on one.

        Raises InputError where several fans of faces touch.
        """
        fans = self.fans()
        own = np.flatnonzero(fans.vertex == vertex)
        if len(own) != 1:
            raise InputError(f"vertex {vertex} has {len(own)} fans of faces, so it has no one-ring")
        around = np.flatnonzero(fans.fan == own[0])
        around = around[np.argsort(fans.position[around])]
        spokes = self.ends[around]
        return spokes if fans.closed[own[0]] else np.append(spokes, self.corners[self.prev_corner[around[-1]]])

    def keep(self, faces: Bool[np.ndarray, "faces"]) -> Mesh:
        """The mesh of some of its faces; vertices keep their numbers, creases that are no edges any more are gone."""
        own = faces[self.face]
        offsets = np.concatenate([[0], np.cumsum(self.sizes[faces])])
        texture = None if self.texture is None else self.texture[own]
        smaller = replace(
            self, corners=self.corners[own], offsets=offsets, numbers=self.numbers[faces], texture=texture
        )
        held = np.isin(self._pair_keys(self.creases), smaller._edge_numbering[0])
        return replace(smaller, creases=self.creases[held], crease_sharpness=self.crease_sharpness[held])


def _checked_texture(texture: Any, corners: int) -> Float[np.ndarray, "corners 2"]:
    found = real_numbers(texture, "texture coordinates")
    if found.shape != (corners, 2):
        raise InputError(
            f"texture coordinates must be an array ({corners}, 2), one for every corner, not {found.shape}"
        )
    if np.isinf(found).any():
        raise InputError("texture coordinates must be finite, or NaN where there are none")
    return found


def _check_sharp(name: str, at: np.ndarray, sharpness: np.ndarray, count: int) -> None:
    """Raise InputError for creases or sharp vertices that name no vertex, or whose sharpness is none."""
    if len(at) != len(sharpness):
        raise InputError(f"every {name} needs a sharpness: there are {len(at)} and {len(sharpness)}")
    pairs = at if at.ndim == 2 else at[:, None]
    bad = np.flatnonzero(np.any((pairs < 0) | (pairs >= count), axis=1))
    if bad.size:
        named = pairs[bad[0]]
        vertex = named[(named < 0) | (named >= count)][0]
        raise InputError(f"{name} {bad[0]} (counted from 0) names vertex {vertex}, but there are {count}")
    bad = np.flatnonzero(~(sharpness >= 0))
    if bad.size:
        raise InputError(
            f"{name} {bad[0]} (counted from 0) has the sharpness {sharpness[bad[0]]:g}: it must not be negative"
        )


def connected(
    count: int, one: Int[np.ndarray, "pairs"], other: Int[np.ndarray, "pairs"]
) -> tuple[int, Int[np.ndarray, "things"]]:
    """How many groups so many things make of which these pairs belong together, and the group of each.

    >>> count, number = connected(4, np.array([0]), np.array([2]))
    >>> count, number.tolist()
    (3, [0, 1, 0, 2])
    """
    with one_at_a_time:
        from scipy.sparse.csgraph import connected_components  # slow to import

    graph = coo_array((np.ones(len(one), bool), (one, other)), (count, count))
    return connected_components(graph, directed=False)


def _ordered(turn: np.ndarray, vertex: np.ndarray) -> Fans:
    """Fans from the map of every corner to the next one."""
    linked = np.flatnonzero(turn >= 0)
    count, fan = connected(len(turn), linked, turn[linked])
    first = np.full(count, len(turn))
    np.minimum.at(first, fan, np.arange(len(turn)))
    entered = np.zeros(len(turn), bool)
    entered[turn[linked]] = True
    closed = np.ones(count, bool)
    opening = np.flatnonzero(~entered)
    closed[fan[opening]], first[fan[opening]] = False, opening
    position = np.zeros(len(turn), np.int64)
    at, place = first, 0
    while at.size:  # as often as the highest valence says
        position[at] = place
        place += 1
        at = turn[at]
        at = at[at >= 0]
        at = at[at != first[fan[at]]]
    return Fans(fan, position, np.bincount(fan, minlength=count), closed, vertex[first])
