"""Which triangles a tessellator really makes, and levels that keep all of them in bounds (docs/certified.md).

OpenGL leaves open how the ring of triangles between a patch's inner grid and its subdivided edges is made, and drivers
place the points of a grid of n cells with 16 bits, so that some cells are wider than 1/n. A ``Pattern`` says how far
triangles reach. The one that comes with the package is Direct3D 11's [D3D11], which drivers follow; ``slefejax doctor``
compares the driver with it, and ``slefejax.gpu.measure_pattern`` measures another one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Bool, Float, Int, UInt64

from slefejax.errors import InputError
from slefejax.tessellator.direct3d11 import ONE, places, rings
from slefejax.tessellator.levels import GRID, HIGHEST_LEVEL, OWN_AXIS, pieces_along, with_pieces

Pairs = Int[np.ndarray, "patches 2"]
Edges = Int[np.ndarray, "patches 4"]
# (patches, sides, inner levels across these sides) -> how long triangles may be that lie in the outermost row of cells
# along a side, in the domain 0 ... 1; sides in OpenGL's order
Longest = Callable[[np.ndarray, np.ndarray, np.ndarray], Float[np.ndarray, "n"]]


@dataclass(frozen=True, eq=False)
class Pattern:
    """How far the triangles of a tessellator reach in the domain 0 ... 1.

    points : ``(65, 65)``, where the lines of an inner grid with n cells are, index (n, 0 ... n); 1 from there on
    reach  : ``(65, 65)``, the longest extent along an edge of the triangles between it and the inner grid, for the
             inner level n along the edge (1 acts as 2) and the edge's own level m, index (n, m)
    """

    points: Float[np.ndarray, "n lines"]
    reach: Float[np.ndarray, "n m"]

    def __post_init__(self) -> None:
        """Raises InputError for tables of other sizes."""
        size = (HIGHEST_LEVEL + 1, HIGHEST_LEVEL + 1)
        for name in ("points", "reach"):
            if np.shape(getattr(self, name)) != size:
                raise InputError(f"the {name} of a pattern must be {size}, not {np.shape(getattr(self, name))}")

    @cached_property
    def cell(self) -> Float[np.ndarray, "n"]:
        """The widest cell of the grids with n or more cells, index n: a level that is raised never widens cells."""
        widest = np.diff(self.points, axis=1).max(axis=1)
        return np.maximum.accumulate(widest[::-1])[::-1]

    @cached_property
    def evenness(self) -> Float[np.ndarray, "n"]:
        """The narrowest cell of a grid with n cells over ``cell``, index n."""
        widths = np.diff(self.points, axis=1)
        return np.where(widths > 0, widths, 1.0).min(axis=1) / self.cell

    @cached_property
    def fine_reach(self) -> Float[np.ndarray, "n m"]:
        """As ``reach``, in a picture with patches in pieces: vertices lie at k/n, whatever the lines' own rounding.

        Lines of n cells are up to some units of 2^-16 beside k/n, vertices of an edge of m likewise.
        """
        n = np.arange(HIGHEST_LEVEL + 1)
        beside = np.abs(self.points - np.minimum(n, n[:, None]) / np.maximum(n, 1)[:, None])
        apart = np.where(n <= n[:, None], beside, 0.0).max(axis=1)
        return self.reach + apart[:, None] + apart

    def cells(self, levels: Int[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """The widest cell for levels; past 64, where patches are cut and lines are placed with 24 bits, about 1/n."""
        drawn = self.cell[np.minimum(levels, HIGHEST_LEVEL)]
        return np.where(levels <= HIGHEST_LEVEL, drawn, 1.0 / np.maximum(levels, 1) + GRID)

    def narrowest(self, levels: Int[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
        """The narrowest cell over the widest one."""
        beyond = 1.0 - 2.0 * GRID * levels
        return np.where(levels <= HIGHEST_LEVEL, self.evenness[np.minimum(levels, HIGHEST_LEVEL)], beyond)

    def levels_for(self, factors: Float[np.ndarray, "*shape"]) -> Int[np.ndarray, "*shape"]:
        """The smallest levels whose cells are no wider than 1/factor."""
        levels = np.ceil(factors).astype(np.int64)
        while True:
            wide = (levels > 0) & (self.cells(levels) * factors > 1.0)
            if not wide.any():
                return levels
            levels = levels + wide

    def edge_levels(
        self, inner: Int[np.ndarray, "*shape"], longest: Float[np.ndarray, "*shape"]
    ) -> UInt64[np.ndarray, "*shape"]:
        """The levels m of an edge with which no triangle of its ring is too long, as bits m - 1.

        With the level of the grid itself the ring is part of the grid: that one is always among them.
        """
        own, keys, sets = self._sets
        # a little less: in a picture with patches in pieces all vertices are placed better than the pattern says
        place = np.searchsorted(keys, inner + 0.5 * (longest - 2.0 / ONE), side="right")
        return sets[place] | own[inner]

    @cached_property
    def _sets(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Bits of n; n + half the reach of every (n, m), in order; the bits of those of this n up to there."""
        bits = np.uint64(1) << np.arange(HIGHEST_LEVEL, dtype=np.uint64)
        keys, sets = [], [np.zeros(1, np.uint64)]
        for n in range(1, HIGHEST_LEVEL + 1):
            order = np.argsort(self.reach[n, 1:], kind="stable")
            # reaches are at most 1, so that half of one never gets to the next n
            keys += [[n - 0.25], n + 0.5 * self.reach[n, 1:][order]]
            sets += [np.zeros(1, np.uint64), np.bitwise_or.accumulate(bits[order])]
        return np.concatenate([np.zeros(2, np.uint64), bits[1:]]), np.concatenate(keys), np.concatenate(sets)


@cache
def direct3d11() -> Pattern:
    """The pattern of Direct3D 11's tessellator (``slefejax.tessellator.direct3d11``).

    >>> direct3d11().reach.shape
    (65, 65)
    """
    levels = np.arange(HIGHEST_LEVEL + 1)
    points = places(levels[:, None], levels[:, None], np.minimum(levels, levels[:, None])) / ONE
    points[0] = levels > 0
    n, m = (x.ravel() for x in np.meshgrid(levels[2:], levels[1:], indexing="ij"))
    pair, corners = rings(n, m)
    level = np.where(corners >= 0, m[pair, None], n[pair, None])
    reach = np.zeros((HIGHEST_LEVEL + 1, HIGHEST_LEVEL + 1))
    np.maximum.at(reach, (n[pair], m[pair]), np.ptp(points[level, np.abs(corners)], axis=1))
    reach[1] = reach[2]
    return Pattern(points, reach)


def safe_levels(inner: Pairs, numbers: Edges, pattern: Pattern, longest: Longest) -> tuple[Pairs, Edges]:
    """Inner and outer levels, no smaller than ``inner``, with which no triangle of the pattern is too long.

    inner   : levels whose grids, with cells as wide as the pattern's, keep the tolerance; 0 for a patch off-screen
    numbers : equal for shared edges (``slefejax.tessellator.edges``)

    An edge starts at the larger of its neighbours' levels. Where a ring reaches too far, a patch with fewer cells
    than its edge has pieces gets more cells, and an edge with fewer pieces than the patch has cells gets more pieces.
    Where both are equal the ring is part of the grid, so this ends. Levels beyond 64 are what pieces of the patch can
    have (``slefejax.tessellator.levels``), each of them with a ring like that of a patch.
    """
    levels = np.zeros(numbers.max() + 1, np.int64)
    np.maximum.at(levels, numbers.ravel(), inner[:, OWN_AXIS].ravel())
    drawn = np.all(inner > 0, axis=1)
    inner, edges = with_pieces(inner, np.where(drawn[:, None], levels[numbers], 0), numbers)
    changed = drawn
    while changed.any():
        patch, side = np.nonzero(np.broadcast_to(changed[:, None], numbers.shape))
        failing = _failing(inner, edges, patch, side, pattern, longest)
        raised = with_better_rings(inner, edges, numbers, patch[failing], side[failing], pattern)
        changed = np.any(raised[0] != inner, axis=1) | np.any(raised[1] != edges, axis=1)
        inner, edges = raised
    return inner, edges


def ringed_sides(
    inner: Pairs, edges: Edges, patch: Int[np.ndarray, "n"], side: Int[np.ndarray, "n"]
) -> tuple[Bool[np.ndarray, "n"], Int[np.ndarray, "n"], Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """Of sides of patches: is there a ring, the levels of the rim and the edge of each of its pieces, their number."""
    axis, along = OWN_AXIS[side], pieces_along(inner[patch], edges[patch])
    own, rim = inner[patch] // along, edges[patch] // along[:, OWN_AXIS]
    row = np.arange(len(patch))
    ringed = np.any(own > 1, axis=1) | np.any(rim > 1, axis=1)
    return ringed, np.maximum(own[row, axis], 2), rim[row, side], along[row, axis]


def _failing(
    inner: Pairs, edges: Edges, patch: np.ndarray, side: np.ndarray, pattern: Pattern, longest: Longest
) -> Bool[np.ndarray, "sides"]:
    """Which rings hold a triangle that is too long."""
    ringed, n, m, along = ringed_sides(inner, edges, patch, side)
    across = np.maximum(inner[patch, 1 - OWN_AXIS[side]], 2)
    sets = pattern.edge_levels(n, longest(patch, side, across) * along)
    return ringed & (sets >> (m - 1).astype(np.uint64) & np.uint64(1) == 0)


def with_better_rings(
    inner: Pairs, edges: Edges, numbers: Edges, patch: np.ndarray, side: np.ndarray, pattern: Pattern
) -> tuple[Pairs, Edges]:
    """More cells, or more pieces of an edge, on sides where a ring reaches too far."""
    if not len(patch):
        return inner, edges
    axis = OWN_AXIS[side]
    along = pieces_along(inner[patch], edges[patch])[np.arange(len(patch)), axis]
    n, m = inner[patch, axis] // along, edges[patch, side] // along
    more_cells = (n < m) | (n == 1)
    inner, levels = inner.copy(), np.zeros(numbers.max() + 1, np.int64)
    np.maximum.at(levels, numbers.ravel(), edges.ravel())
    np.maximum.at(inner, (patch[more_cells], axis[more_cells]), (_next_inner(n, m, pattern) * along)[more_cells])
    np.maximum.at(levels, numbers[patch, side][~more_cells], (n * along)[~more_cells])
    return with_pieces(inner, np.where(edges > 0, levels[numbers], 0), numbers)


def _next_inner(n: np.ndarray, m: np.ndarray, pattern: Pattern) -> np.ndarray:
    """The next larger n whose ring reaches less far, at most m; at least 2, which is what 1 acts as."""
    chosen = np.maximum(m, 2)
    for k in range(len(n)):
        shorter = np.flatnonzero(pattern.reach[n[k] + 1 : m[k], m[k]] < pattern.reach[n[k], m[k]])
        if shorter.size:
            chosen[k] = n[k] + 1 + shorter[0]
    return chosen
