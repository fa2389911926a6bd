"""Direct3D 11's tessellator of a quad, on the host: which points and triangles it makes of a patch's levels.

OpenGL leaves the pattern open; drivers follow Direct3D 11's, which is fixed to the last bit [D3D11]. Along an axis or
an edge of n segments points are numbered 0 ... n and placed with 16 bits (``places``). Inside lies a grid, and along
each side a *ring* of triangles joins its rim to the edge:

        1-----2-----3-----4      the rim of a grid with n = 5 along this side: its points 1 ... n-1
       / \\   / \\   /|\\   / \\
      /   \\ /   \\ / | \\ /   \\
     0-----1-----2--3--4-----5   an edge of m = 5 segments, counter-clockwise around the patch

The halves of an edge are cut by points that come one after the other as the level rises: 1/2, then 1/4 and 3/4, then
the eighths. A ring takes the points of its rim and its edge in the order that these have on an edge of 64, from both
ends towards the middle.

Vertices of a patch are numbered around it first, from (0, 0) along v=0, u=1, v=1 and u=0 back, then the points of the
grid, those with the same u one after the other.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Real

from slefejax.tessellator.levels import OWN_AXIS
from slefejax.tessellator.levels import segments as segments_of

ONE = 2**16  # fixed-point 1
AROUND = (1, 2, 3, 0)  # sides v=0, u=1, v=1, u=0: counter-clockwise from (0, 0)
_SLOTS = 32  # segments of half an edge of 64

Whole = Int[np.ndarray, "*shape"]
Ring = Int[np.ndarray, "triangles 3"]


def places(levels: Real[np.ndarray, "*shape"], segments: Whole, index: Whole) -> Whole:
    """Where points lie along an axis, in 1/65536 of it.

    levels   : that are at work; whole numbers and equal to the segments with equal spacing
    segments : that they make (``slefejax.tessellator.levels.segments``)
    index    : of the points, 0 ... segments

    Points are placed from both ends. With fractional spacing one moves from its place among two segments less to that
    among all of them, in proportion to the level; the two new segments begin without length.

    >>> places(np.array(3), np.array(3), np.arange(4)).tolist()
    [0, 21845, 43691, 65536]
    """
    near = np.minimum(index, segments - index)
    fixed = np.rint(np.float64(np.float32(levels)) * ONE).astype(np.int64)
    share = (fixed - (segments - 2) * ONE + 1) >> 1
    before = (near - (near > _newest(segments))) * _reciprocal(np.maximum(segments - 2, 1))
    found = (before * (ONE - share) + near * _reciprocal(segments) * share + ONE // 2) >> 16
    return np.where(2 * index == segments, ONE // 2, np.where(2 * index < segments, found, ONE - found))


def _reciprocal(segments: Whole) -> Whole:
    return np.rint(ONE / np.maximum(segments, 1)).astype(np.int64)


def _newest(segments: Whole) -> Whole:
    """The point of the first half behind which the newest segment lies."""
    before = (segments - segments % 2) // 2 - 1
    highest_bit = np.int64(1) << (np.frexp(np.maximum(before, 1))[1].astype(np.int64) - 1)
    return np.where(before > 0, 2 * (before - highest_bit) + 1, 0)


def rings(n: Int[np.ndarray, "pairs"], m: Int[np.ndarray, "pairs"]) -> tuple[Whole, Ring]:
    """The triangles between rims of levels n (at least 2) and edges of levels m: whose they are, and their corners.

    They come pair after pair, and as they lie along the edge. A corner k >= 0 is the point k of the edge, a corner
    -j < 0 the point j of the rim (module docstring).

    >>> rings(np.array([2, 3]), np.array([1, 2]))[1].tolist()
    [[0, 1, -1], [0, 1, -1], [-1, 1, -2], [1, 2, -2]]
    """
    order = _order_of_points()
    rim, edge = (order < count[:, None] // 2 for count in (n, m))
    rim[:, 0] = False  # it has no point at the patch's corner
    half = np.stack([rim, edge], axis=2).reshape(len(n), 2 * len(order))
    steps = np.concatenate([half, np.stack([n, m], axis=1) % 2 == 1, half[:, ::-1]], axis=1)
    on_edge = np.tile([False, True], len(order) + 1)
    on_edge = np.concatenate([on_edge, on_edge[:-2][::-1]])
    of_edge, of_rim = steps & on_edge, steps & ~on_edge
    pair, step = np.nonzero(steps)
    k = (np.cumsum(of_edge, axis=1) - of_edge)[pair, step]
    j = (np.cumsum(of_rim, axis=1) - of_rim)[pair, step] + 1
    corners = np.where(on_edge[step], [k, k + 1, -j], [-j, k, -j - 1])
    return pair, corners.T


def _order_of_points() -> Int[np.ndarray, "33"]:
    """As which point of half an edge of 64 each place is taken when levels rise.

    First its end, then the places in the middle: of the half, of its halves, and so on.
    """
    place = np.arange(1, _SLOTS)
    power = place & -place
    return np.concatenate([[0, _SLOTS], (_SLOTS // 2 + place // 2) // power])


class Tessellation(NamedTuple):
    """What the tessellator makes of patches (module docstring).

    patch     : whose a vertex is, patch after patch
    point     : which point it is along u and along v
    segments  : of how many along each of them; of one across an edge
    levels    : that make these segments
    triangles : numbers of vertices, counter-clockwise, patch after patch
    """

    patch: Int[np.ndarray, "vertices"]
    point: Int[np.ndarray, "vertices 2"]
    segments: Int[np.ndarray, "vertices 2"]
    levels: Real[np.ndarray, "vertices 2"]
    triangles: Int[np.ndarray, "triangles 3"]

    def parameters(self) -> Float[np.ndarray, "vertices 2"]:
        """(u, v) where the tessellator places vertices, multiples of 2^-16."""
        return places(self.levels, self.segments, self.point) / ONE


def tessellate(inner: Real[np.ndarray, "n 2"], outer: Real[np.ndarray, "n 4"], spacing: str = "equal") -> Tessellation:
    """Vertices and triangles of patches with levels up to 64; those with an outer level of 0 have none.

    >>> tessellate(np.array([[1, 1]]), np.array([[1, 1, 1, 2]])).triangles.tolist()
    [[0, 1, 5], [1, 2, 5], [2, 3, 5], [3, 4, 5], [4, 0, 5]]
    """
    cut = _Cut.of(np.asarray(inner), np.asarray(outer), spacing)
    patch = np.repeat(np.arange(len(inner)), cut.around + cut.grid)
    point, segments = np.zeros((len(patch), 2), np.int64), np.ones((len(patch), 2), np.int64)
    levels = np.ones((len(patch), 2))
    for side in AROUND:
        own, k = ragged(cut.edge[:, side])
        at, axis = cut.offset[own, side] + k, OWN_AXIS[side]
        segments[at, axis], levels[at, axis] = cut.edge[own, side], cut.outer[own, side]
        point[at, axis] = k if side in (1, 2) else cut.edge[own, side] - k
        point[at, 1 - axis] = side >= 2
    own, k = ragged(cut.grid)
    at = cut.offset[own, 4] + k
    segments[at], levels[at] = cut.along[own], cut.inner[own]
    point[at] = np.stack(np.divmod(k, cut.along[own, 1] - 1), axis=1) + 1
    parts = [_pairs_of_triangles(cut), *(_rings(cut, side) for side in AROUND), _cells(cut)]
    owner, triangles = (np.concatenate(x) for x in zip(*parts, strict=True))
    return Tessellation(patch, point, segments, levels, triangles[np.argsort(owner, kind="stable")])


class _Cut(NamedTuple):
    """Segments of patches, the levels at work that make them, and where their vertices are."""

    inner: Real[np.ndarray, "n 2"]
    outer: Real[np.ndarray, "n 4"]
    along: Int[np.ndarray, "n 2"]  # segments inside
    edge: Int[np.ndarray, "n 4"]  # and on the edges
    around: Int[np.ndarray, "n"]  # vertices on all edges
    grid: Int[np.ndarray, "n"]  # and of the grid
    offset: Int[np.ndarray, "n 5"]  # the first vertex of each edge, and of the grid

    @staticmethod
    def of(inner: Real[np.ndarray, "n 2"], outer: Real[np.ndarray, "n 4"], spacing: str) -> _Cut:
        lowest = 2.0 if spacing == "fractional-even" else 1.0
        drawn = np.all(outer > 0, axis=1)[:, None]
        inner, outer = (np.where(drawn, np.maximum(x, lowest), 0) for x in (inner, outer))
        along, edge = (segments_of(x, spacing) for x in (inner, outer))
        # inside, 1 acts as the next number of segments, unless everything is 1
        acting = (along == 1) & (np.any(along > 1, axis=1) | np.any(edge > 1, axis=1))[:, None]
        if spacing == "equal":
            inner = np.where(acting, 2, inner)
        along = np.where(acting, 3 if spacing == "fractional-odd" else 2, along)
        around, grid = edge.sum(axis=1), np.maximum(along - 1, 0).prod(axis=1)
        first = np.cumsum(around + grid) - around - grid
        offset = np.empty((len(inner), 5), np.int64)
        for side in (*AROUND, 4):
            offset[:, side] = first
            first = first + (edge[:, side] if side < 4 else 0)
        return _Cut(inner, outer, along, edge, around, grid, offset)

    def point(self, patch: Whole, i: Whole | int, j: Whole | int) -> Whole:
        """The vertex of the grid's point i along u and j along v."""
        return self.offset[patch, 4] + (i - 1) * (self.along[patch, 1] - 1) + j - 1

    def on_rim(self, patch: Whole, side: int, k: Whole) -> Whole:
        """The vertex k along a side of the grid's rim, counter-clockwise."""
        n_u, n_v = np.moveaxis(self.along[patch], -1, 0)
        i, j = ((1, n_v - k), (k, 1), (n_u - 1, k), (n_u - k, n_v - 1))[side]
        return self.point(patch, i, j)

    def on_edge(self, patch: Whole, side: int, k: Whole) -> Whole:
        """The vertex k along an edge, counter-clockwise; the last one is the next edge's first."""
        last_of_all = (self.offset[patch, side] + k) == self.offset[patch, 4]
        return np.where(last_of_all, self.offset[patch, AROUND[0]], self.offset[patch, side] + k)


def ragged(counts: Whole) -> tuple[Whole, Whole]:
    """(whose, which of its own) for so many things each.

    >>> [x.tolist() for x in ragged(np.array([2, 1]))]
    [[0, 0, 1], [0, 1, 0]]
    """
    owner = np.repeat(np.arange(len(counts)), counts)
    return owner, np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)


def _pairs_of_triangles(cut: _Cut) -> tuple[Whole, Ring]:
    """Of patches that nothing cuts."""
    patch = np.flatnonzero(cut.along[:, 0] == 1)
    first = cut.offset[patch, AROUND[0], None]
    return np.repeat(patch, 2), (first[:, None] + np.array([[0, 1, 3], [1, 2, 3]])).reshape(-1, 3)


def _rings(cut: _Cut, side: int) -> tuple[Whole, Ring]:
    """Triangles along one side of all patches."""
    patch = np.flatnonzero(cut.along[:, 0] > 1)
    levels = cut.along[patch, OWN_AXIS[side]] * 2 * ONE + cut.edge[patch, side]
    levels, which = np.unique(levels, return_inverse=True)
    pair, corners = rings(*np.divmod(levels, 2 * ONE))
    length = np.bincount(pair, minlength=len(levels))
    own, k = ragged(length[which])
    corner = corners[(np.cumsum(length) - length)[which[own]] + k]
    patch = patch[own]
    edge, rim = (at(patch[:, None], side, np.abs(corner)) for at in (cut.on_edge, cut.on_rim))
    return patch, np.where(corner >= 0, edge, rim)


def _cells(cut: _Cut) -> tuple[Whole, Ring]:
    """Both triangles of the cells between the grid's own points.

    Diagonals go from the middle outwards, clockwise or counter-clockwise, so that quarters of a patch are mirrored.
    """
    inside = np.maximum(cut.along - 2, 0)
    patch, k = ragged(inside.prod(axis=1))
    i, j = np.divmod(k, np.maximum(inside[patch, 1], 1))
    i, j, (n_u, n_v) = i + 1, j + 1, cut.along[patch].T
    rising = np.where(2 * j + 1 < n_v, 2 * i < n_u, 2 * i + 1 >= n_u) & (2 * j + 1 != n_v)
    a, b, c, d = (cut.point(patch, i + x, j + y) for x, y in ((0, 0), (1, 0), (1, 1), (0, 1)))
    first = np.where(rising[:, None], np.stack([a, b, c], axis=1), np.stack([a, b, d], axis=1))
    second = np.where(rising[:, None], np.stack([a, c, d], axis=1), np.stack([b, c, d], axis=1))
    return np.repeat(patch, 2), np.stack([first, second], axis=1).reshape(-1, 3)
