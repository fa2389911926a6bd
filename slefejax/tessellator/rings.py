"""Which triangles a tessellator really makes, and levels that keep all of them in bounds (docs/certified.md).

OpenGL leaves open how the ring of triangles between a patch's inner grid and its subdivided edges is made, and drivers
place the points of a grid of n cells with 16 bits, so that some cells are wider than 1/n. A ``Pattern`` says how far
triangles reach. The one that comes with the package is Direct3D 11's [D3D11], which drivers follow; ``slefejax doctor``
compares the driver with it, and ``slefejax.gpu.measure_pattern`` measures another one.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache, cached_property

import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax.errors import InputError
from slefejax.tessellator.direct3d11 import ONE, places, ragged, rings
from slefejax.tessellator.levels import GRID, HIGHEST_LEVEL, OWN_AXIS, pieces_along, shares, with_pieces

Pairs = Int[np.ndarray, "patches 2"]
Edges = Int[np.ndarray, "patches 4"]


@dataclass(frozen=True, eq=False)
class Pattern:
    """How far the triangles of a tessellator reach in the domain 0 ... 1.

    points : ``(65, 65)``, where the lines of an inner grid with n cells are, index (n, 0 ... n); 1 from there on
    reach  : ``(65, 65)``, the longest extent along an edge of the triangles between it and the inner grid, for the
             inner level n along the edge (1 acts as 2) and the edge's own level m, index (n, m)
    known  : whether these triangles are those of Direct3D 11, so that they can be looked at one by one
    """

    points: Float[np.ndarray, "n lines"]
    reach: Float[np.ndarray, "n m"]
    known: bool = False

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

    def lines(self, in_pieces: bool) -> Float[np.ndarray, "n lines"]:
        """``points``, or in a picture with patches in pieces k/n with 24 bits."""
        return _fine_lines() if in_pieces else self.points

    def ring_triangles(
        self, side: Int[np.ndarray, "n"], inner: Pairs, edge: Int[np.ndarray, "n"], in_pieces: bool
    ) -> tuple[Int[np.ndarray, "triangles"], Float[np.ndarray, "triangles 3 2"]]:
        """The triangles between grids and edges of patches up to 64: whose they are, and the parameters of corners.

        >>> own, corners = direct3d11().ring_triangles(np.array([1]), np.array([[2, 2]]), np.array([1]), False)
        >>> own.tolist(), corners.tolist()
        ([0], [[[0.0, 0.0], [1.0, 0.0], [0.5, 0.5]]])
        """
        lines, axis, row = self.lines(in_pieces), OWN_AXIS[side], np.arange(len(side))
        acting = np.maximum(inner, 2)
        pairs, which = np.unique(acting[row, axis] * (2 * ONE) + edge, return_inverse=True)
        pair, corner = rings(*np.divmod(pairs, 2 * ONE))
        length = np.bincount(pair, minlength=len(pairs))
        own, place = ragged(length[which])
        corner = corner[(np.cumsum(length) - length)[which[own]] + place]
        on_edge, across = corner >= 0, acting[own, 1 - axis[own]]
        level = np.where(on_edge, edge[own, None], acting[own, axis[own]][:, None])
        # counter-clockwise around the patch: along u at v = 0, along v at u = 1, then back
        index = np.where(np.isin(side[own], (1, 2))[:, None], np.abs(corner), level - np.abs(corner))
        along, beside = lines[level, index], np.where(on_edge, 0.0, lines[across, 1][:, None])
        beside = np.where(side[own, None] >= 2, 1.0 - beside, beside)
        flat = axis[own, None] == 0
        return own, np.stack([np.where(flat, along, beside), np.where(flat, beside, along)], axis=2)

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
    return Pattern(points, reach, known=True)


@cache
def _fine_lines() -> Float[np.ndarray, "n lines"]:
    """As ``Pattern.points``, placed with 24 bits."""
    n = np.arange(HIGHEST_LEVEL + 1)
    return shares(np.minimum(n, n[:, None]), n[:, None]) * GRID


def ringed_sides(
    inner: Pairs, edges: Edges, patch: Int[np.ndarray, "n"], side: Int[np.ndarray, "n"]
) -> tuple[Bool[np.ndarray, "n"], Int[np.ndarray, "n"], Int[np.ndarray, "n"], Int[np.ndarray, "n"]]:
    """Of sides of patches: is there a ring, the levels of the rim and the edge of each of its pieces, their number."""
    axis, along = OWN_AXIS[side], pieces_along(inner[patch], edges[patch])
    own, rim = inner[patch] // along, edges[patch] // along[:, OWN_AXIS]
    row = np.arange(len(patch))
    ringed = np.any(own > 1, axis=1) | np.any(rim > 1, axis=1)
    return ringed, np.maximum(own[row, axis], 2), rim[row, side], along[row, axis]


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
