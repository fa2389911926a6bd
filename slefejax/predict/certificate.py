"""What can be asked of certified factors: boxes of any shape, grids as a tessellator draws them, longest triangles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax.bounds.triangles import AnyTriangle, HalfCells
from slefejax.geometry.evaluate import as_control
from slefejax.geometry.projection import Projection
from slefejax.lanes import layout, loops, passes
from slefejax.lanes.memory import Memory
from slefejax.lanes.tuning import TUNING
from slefejax.predict.cells import Pictures, grid_errors, triangle_errors
from slefejax.predict.certified import certified_factor
from slefejax.predict.normals.claim import NormalClaim, shape_of
from slefejax.tessellator.levels import HIGHEST_LEVEL
from slefejax.tessellator.rings import Pattern

_FEW_CELLS = 1024
_LARGE_CELLS = 9  # of a patch


@dataclass(frozen=True, eq=False)
class Certificate:
    """The patches, view and tolerances that certified factors are computed from.

    given      : makes ``(patches, du+1, dv+1, dim)``, concrete, relative to the projection's origin, and the projection
    tolerances : in pixels, and of depth or None
    tiles      : along each side of a patch
    pattern    : of the tessellator
    factor     : ``(patches,)``, what they are, from which on the theorem holds on even grids
    pictures   : the same patches, for cells and triangles that are looked at one by one (``slefejax.predict.cells``)
    memory     : what is known of cells and triangles of the same patches in the same view
    closer     : cells just above the tolerance are looked at part by part, of large grids too
    loose      : bounds of few large cells and triangles are loose: of those parts are looked at in any case
    normals    : an angle that interpolated normals have to keep too
    scale      : that of ``Factors.scaled``: what is proved for n is taken for scale times n, and errors of 1/scale^2
                 times the tolerance are allowed
    """

    given: Callable[[], tuple[Any, Projection]]
    tolerances: tuple[Any, Any]
    tiles: int
    pattern: Pattern
    factor: Float[np.ndarray, "patches"]
    pictures: Pictures
    memory: Memory
    closer: bool = False
    loose: bool = False
    normals: NormalClaim | None = None
    scale: float = 1.0

    @cached_property
    def _given(self) -> tuple[Any, Projection]:
        return self.given()

    @property
    def patches(self) -> Any:
        """Control points relative to the projection's origin, or ``GregoryPatches``."""
        return self._given[0]

    @property
    def projection(self) -> Projection:
        """For them."""
        return self._given[1]

    def scaled(self, scale: float) -> Certificate:
        """The same for levels of so many times the fineness."""
        return replace(self, scale=self.scale * scale)

    def factors(self, nets: Any, extents: Float[np.ndarray, "n 2"], evenness: Any = 1.0) -> Float[np.ndarray, "n"]:
        """Certified factors of control nets for halves of boxes of sides extent/n; 0 for an unseen patch.

        evenness : of boxes with sides from so many times that on, ``(n,)`` or a number; 0: of all smaller boxes
        """
        numbers = np.column_stack([extents, np.broadcast_to(evenness, len(nets))])
        return self.scale * self._through(_boxes_pass, nets, numbers, self.tiles)

    def factors_of(
        self, patch: Int[np.ndarray, "n"], extents: Float[np.ndarray, "n 2"], evenness: Any
    ) -> Float[np.ndarray, "n"]:
        """The same of whole patches, for their normals too."""
        found = self.factors(self.patches[patch], extents, evenness)
        if self.normals is None:
            return found
        return np.where(found > 0, np.maximum(found, self.scale * self.normals.boxes(patch, extents, evenness)), 0.0)

    def grids_keep(
        self, patch: Int[np.ndarray, "n"], levels: Int[np.ndarray, "n 2"], in_pieces: bool = False
    ) -> Bool[np.ndarray, "n"]:
        """Whether patches keep the tolerance on grids of that many cells along u and v, as they are drawn.

        in_pieces : in a picture with patches in pieces, whose lines lie elsewhere

        Small grids are looked at cell by cell, large ones where the theorem does not cover them.
        """
        error = np.full(len(patch), np.inf)
        whole = np.all(levels <= HIGHEST_LEVEL, axis=1)
        small = whole & (levels.prod(axis=1) <= _FEW_CELLS)
        own = np.flatnonzero(small)
        error[own] = self.grid_errors(patch[own], levels[own], in_pieces)
        # those at the eye's plane, too, are left to the theorem
        own = np.flatnonzero(~np.isfinite(error))
        own = own[self._boxes_keep(patch[own], levels[own])]
        error[own] = 1.0
        own = np.flatnonzero(~np.isfinite(error) & whole & ~small)
        error[own] = self.grid_errors(patch[own], levels[own], in_pieces)
        return error <= 1.0

    def _boxes_keep(self, patch: np.ndarray, levels: np.ndarray) -> Bool[np.ndarray, "n"]:
        sides = self.pattern.cells(levels)
        size = np.sqrt(sides[:, 0] * sides[:, 1])
        evenness = self.pattern.narrowest(levels).min(axis=1)
        return self.factors_of(patch, sides / size[:, None], evenness) * size <= 1.0

    def grid_errors(
        self, patch: Int[np.ndarray, "n"], levels: Int[np.ndarray, "n 2"], in_pieces: bool = False
    ) -> Float[np.ndarray, "n"]:
        """At most how far visible points of grids with up to 64 lines err, over what is allowed."""
        lines = self.pattern.lines(in_pieces)
        given = [*levels.T, np.full(len(patch), in_pieces)]
        closer = self.closer | (self.loose & (levels.prod(axis=1) <= _LARGE_CELLS))

        def find(own: np.ndarray) -> np.ndarray:
            return self._worst(
                lambda pictures, at: grid_errors(pictures, patch[at], levels[at], lines, closer[at]), own, patch
            )

        return self.scale**2 * self.memory.recall("grids", patch, given, find)

    def _worst(
        self, errors: Callable[[Pictures, np.ndarray], np.ndarray], own: np.ndarray, patch: np.ndarray
    ) -> np.ndarray:
        """Errors of positions, and of normals where there is a claim, something is seen and positions are right."""
        found = errors(self.pictures, own)
        if self.normals is None:
            return found
        again = np.flatnonzero((found > 0) & (found <= 1.0) & self.normals.claimed[patch[own]])
        found[again] = np.maximum(found[again], errors(self.normals.pictures, own[again]))
        return found

    def even_errors(self, patch: np.ndarray, levels: Int[np.ndarray, "n 2"], lines: np.ndarray) -> np.ndarray:
        """As ``grid_errors``, with lines at equal steps, and part by part."""
        every = np.arange(len(patch))
        return self._worst(lambda pictures, at: grid_errors(pictures, patch[at], levels[at], lines, True), every, patch)

    def ring_errors(
        self, patch: np.ndarray, side: np.ndarray, inner: Int[np.ndarray, "n 2"], edge: np.ndarray, in_pieces: bool
    ) -> Float[np.ndarray, "n"]:
        """The same of the triangles between grids and edges, of patches that are drawn whole."""

        def find(ring: np.ndarray) -> np.ndarray:
            own, corners = self.pattern.ring_triangles(side[ring], inner[ring], edge[ring], in_pieces)
            worst, whose = np.zeros(len(ring)), patch[ring][own]
            closer = (self.loose & (inner[ring].prod(axis=1) <= _LARGE_CELLS))[own]
            every = np.arange(len(own))
            errors = lambda pictures, at: triangle_errors(pictures, whose[at], corners[at], closer[at])  # noqa: E731
            np.maximum.at(worst, own, self._worst(errors, every, whose))
            return worst

        given = [side, *inner.T, edge, np.full(len(patch), in_pieces)]
        return self.scale**2 * self.memory.recall("rings", patch, given, find)

    def triangles_keep(
        self, nets: Any, along: Int[np.ndarray, "n"], length: Float[np.ndarray, "n"], width: Any = 1.0
    ) -> Bool[np.ndarray, "n"]:
        """Whether triangles of any shape, of a length along an axis of a net and a width, keep the tolerance."""
        # what is tried is not shorter, whatever rounding does to it
        length = length * (1.0 + 8.0 * np.finfo(self.patches.dtype).eps)
        size, extents = shape_of(along, length, width)
        return self.scale * size * self._through(_triangles_pass, nets, extents, self.tiles) <= 1.0

    @cached_property
    def even(self) -> Int[np.ndarray, "patches"]:
        """The lowest levels, the same along u and v, of which the factors tell that grids as they are drawn hold.

        By (5'), that cells are not quite even raises sigma by at most the square of what is missing.
        """
        factor = np.asarray(self.factor, np.float64) * self.scale
        levels = np.ceil(factor).astype(np.int64)
        while True:
            unevenness = 2.0 - self.pattern.narrowest(levels) ** 2
            wide = (levels > 0) & (self.pattern.cells(levels) ** 2 * factor**2 * unevenness > 1.0)
            if not wide.any():
                return levels
            levels = levels + wide

    def for_all_boxes(self, patch: Int[np.ndarray, "n"], levels: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, "n 2"]:
        """Levels in the ratio of those given from which on all grids keep the tolerance, raised along u, v or both."""
        u, v = np.maximum(levels, 1).T
        extents = np.stack([np.sqrt(v / u), np.sqrt(u / v)], axis=1)
        factor = self.factors_of(patch, extents, 0.0)[:, None]
        return self.pattern.levels_for(np.maximum(factor / extents, factor > 0))

    def _through(self, compiled: Callable[..., Any], nets: Any, numbers: np.ndarray, *more: Any) -> np.ndarray:
        if not len(nets):
            return np.zeros(0)
        # unrolled they run six times as fast, and compile three times as long
        unrolled = None if len(nets) >= TUNING.many_nets else False

        def run(packed: Any) -> Any:
            return compiled(packed, self.projection, self.tolerances, *more, unrolled)

        return layout.through(run, (as_control(nets), numbers), self.patches.dtype).astype(np.float64)


@passes.as_pass(3, 4)
def _boxes_pass(
    packed: Any, projection: Projection, tolerances: tuple[Any, Any], tiles: int, unrolled: bool | None
) -> Any:
    return _of_boxes(packed, projection, tolerances, tiles=tiles, unrolled=unrolled)


@loops.chunked
def _of_boxes(both: Any, projection: Projection, tolerances: Any, *, tiles: int, unrolled: bool | None) -> Any:
    control, (e_u, e_v, evenness) = both
    triangles = HalfCells((e_u, e_v), evenness)
    return certified_factor(control, projection, tolerances, triangles, tiles=tiles, unrolled=unrolled)


@passes.as_pass(3, 4)
def _triangles_pass(
    packed: Any, projection: Projection, tolerances: tuple[Any, Any], tiles: int, unrolled: bool | None
) -> Any:
    return _of_triangles(packed, projection, tolerances, tiles=tiles, unrolled=unrolled)


@loops.chunked
def _of_triangles(both: Any, projection: Projection, tolerances: Any, *, tiles: int, unrolled: bool | None) -> Any:
    control, (e_u, e_v) = both
    triangles = AnyTriangle((e_u, e_v))
    return certified_factor(control, projection, tolerances, triangles, tiles=tiles, unrolled=unrolled)
