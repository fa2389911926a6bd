"""What can be asked of certified factors: boxes of any shape, grids as a tessellator draws them, longest triangles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax.bounds.triangles import AnyTriangle, HalfCells
from slefejax.geometry.projection import Projection
from slefejax.lanes import layout, loops, passes
from slefejax.lanes.tuning import TUNING
from slefejax.predict.certified import certified_factor
from slefejax.tessellator.levels import HIGHEST_LEVEL
from slefejax.tessellator.rings import Pattern

_RATIOS = 2.0 ** (np.arange(-20, 21) / 4.0)  # of n_u to n_v that are tried
_SMALLER_STEPS = 4  # how often each of a pair is made smaller by one, where that is still allowed
_STEPS = 6  # towards the longest triangle
_JUST_BELOW = 0.995  # where a step aims: a length that is not quite allowed is worth nothing


@dataclass(frozen=True, eq=False)
class Certificate:
    """The patches, view and tolerances that certified factors are computed from.

    patches    : ``(patches, du+1, dv+1, dim)``, concrete, relative to the projection's origin
    tolerances : in pixels, and of depth or None
    tiles      : along each side of a patch
    pattern    : of the tessellator
    proof      : tells of patches (their numbers, levels, whether the picture has patches in pieces) whether they can be
                 proved cell by cell to keep the tolerance on the tessellator's grids; None: that is not tried
    scale      : that of ``Factors.scaled``: with 0.9, levels are what the certificate asks for, times 0.9
    """

    patches: Float[np.ndarray, "patches nu nv dim"]
    projection: Projection
    tolerances: tuple[Any, Any]
    tiles: int
    pattern: Pattern
    proof: Callable[[np.ndarray, np.ndarray, bool], np.ndarray] | None = None
    scale: float = 1.0

    def scaled(self, scale: float) -> Certificate:
        """The same for levels of so many times the fineness: what is proved for n is taken for scale times n."""
        proof = self.proof

        def coarser(patch: np.ndarray, levels: np.ndarray, in_pieces: bool) -> np.ndarray:
            assert proof is not None
            # a little more, so that 0.9 times 10 stands for 10
            return proof(patch, np.maximum(np.floor(levels / scale + 1e-9).astype(np.int64), 1), in_pieces)

        return replace(self, scale=self.scale * scale, proof=None if proof is None else coarser)

    def factors(
        self, nets: Float[np.ndarray, "n nu nv dim"], extents: Float[np.ndarray, "n 2"], evenness: Any = 1.0
    ) -> Float[np.ndarray, "n"]:
        """Certified factors of control nets for halves of boxes of sides extent/n; 0 for an unseen patch.

        evenness : of boxes with sides from so many times that on, ``(n,)`` or a number; 0: of all smaller boxes
        """
        numbers = np.column_stack([extents, np.broadcast_to(evenness, len(nets))])
        return self.scale * self._through(_boxes_pass, nets, numbers, self.tiles)

    def grids_keep(
        self, patch: Int[np.ndarray, "n"], levels: Int[np.ndarray, "n 2"], in_pieces: bool = False
    ) -> Bool[np.ndarray, "n"]:
        """Whether patches keep the tolerance on grids of that many cells along u and v, even and as they are drawn.

        in_pieces : in a picture with patches in pieces. Only proofs cell by cell need to know
        """
        sides = self.pattern.cells(levels)
        size = np.sqrt(sides[:, 0] * sides[:, 1])
        evenness = self.pattern.narrowest(levels).min(axis=1)
        fine = self.factors(self.patches[patch], sides / size[:, None], evenness) * size <= 1.0
        if self.proof is not None:
            open_ones = np.flatnonzero(~fine)
            fine[open_ones] = self.proof(patch[open_ones], levels[open_ones], in_pieces)
        return fine

    def longest(
        self,
        nets: Float[np.ndarray, "n nu nv dim"],
        along: Int[np.ndarray, "n"],
        shortest: Float[np.ndarray, "n"],
        longest: Float[np.ndarray, "n"],
    ) -> Float[np.ndarray, "n"]:
        """How long triangles of any shape may be along an axis of a net, between two lengths; 0 if never so short."""
        numbers = np.stack([along, shortest, longest], axis=1)
        return self._through(_longest_pass, nets, numbers, (self.scale, _STEPS), self.tiles)

    def triangles_keep(
        self, nets: Float[np.ndarray, "n nu nv dim"], along: Int[np.ndarray, "n"], length: Float[np.ndarray, "n"]
    ) -> Bool[np.ndarray, "n"]:
        """Whether triangles of any shape, of a length along an axis of a net, keep the tolerance."""
        # what is tried is not shorter, whatever rounding does to it
        length = length * (1.0 + 8.0 * np.finfo(self.patches.dtype).eps)
        numbers = np.stack([along, length, length], axis=1)
        return self._through(_longest_pass, nets, numbers, (self.scale, 1), self.tiles) > 0

    def for_all_boxes(self, patch: Int[np.ndarray, "n"], levels: Int[np.ndarray, "n 2"]) -> Int[np.ndarray, "n 2"]:
        """Levels in the ratio of those given from which on all grids keep the tolerance, raised along u, v or both."""
        u, v = np.maximum(levels, 1).T
        extents = np.stack([np.sqrt(v / u), np.sqrt(u / v)], axis=1)
        factor = self.factors(self.patches[patch], extents, 0.0)[:, None]
        return self.pattern.levels_for(np.maximum(factor / extents, factor > 0))

    def start(self, levels: Int[np.ndarray, "patches 2"]) -> Int[np.ndarray, "patches 2"]:
        """``for_all_boxes`` of all patches, or the highest that is drawn whole where that one is enough.

        That one may not be raised along one axis alone: ``slefejax.predict.proved`` looks at what is drawn in the end.
        """
        found = self.for_all_boxes(np.arange(len(levels)), levels)
        high = np.flatnonzero(np.any(found > HIGHEST_LEVEL, axis=1))
        fine = high[self.grids_keep(high, np.full((len(high), 2), HIGHEST_LEVEL))]
        found[fine] = HIGHEST_LEVEL
        return found

    @cached_property
    def swept(self) -> Int[np.ndarray, "patches ratios 2"]:
        """Levels along u and v of about the fineness that is needed, for a row of ratios; 0 for an unseen patch."""
        found = []
        for ratio in _RATIOS:
            extents = np.array([ratio**-0.5, ratio**0.5])
            factor = self.factors(self.patches, np.broadcast_to(extents, (len(self.patches), 2)))
            found.append(self.pattern.levels_for(np.maximum(factor[:, None] / extents, factor[:, None] > 0)))
        return np.stack(found, axis=1)

    def pairs(self) -> Int[np.ndarray, "patches 2"]:
        """Levels along u and v with the fewest cells that were found to keep the tolerance; 0 for an unseen patch.

        The best pair that was swept is made smaller, one level at a time, while that is allowed.
        """
        best = self.start(np.ones((len(self.patches), 2), np.int64))
        open_ones = np.flatnonzero(best[:, 0] > 0)
        rank = np.argsort(self.swept.prod(axis=2), axis=1, kind="stable")
        for place in range(len(_RATIOS)):
            pair = self.swept[open_ones, rank[open_ones, place]]
            open_ones, pair = (x[pair.prod(axis=1) < best[open_ones].prod(axis=1)] for x in (open_ones, pair))
            fine = self.grids_keep(open_ones, pair)
            best[open_ones[fine]] = pair[fine]
            open_ones = open_ones[~fine]
        for axis in (0, 1) * _SMALLER_STEPS:
            smaller = best - np.eye(2, dtype=np.int64)[axis]
            patch = np.flatnonzero(smaller[:, axis] >= 1)
            fine = patch[self.grids_keep(patch, smaller[patch])]
            best[fine] = smaller[fine]
        return best

    def _through(self, compiled: Callable[..., Any], nets: np.ndarray, numbers: np.ndarray, *more: Any) -> np.ndarray:
        if not len(nets):
            return np.zeros(0)
        # unrolled they run six times as fast, and compile three times as long
        unrolled = None if len(nets) >= TUNING.many_nets else False

        def run(packed: Any) -> Any:
            return compiled(packed, self.projection, self.tolerances, *more, unrolled)

        return layout.through(run, (nets, numbers), self.patches.dtype).astype(np.float64)


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


@passes.as_pass(4, 5)
def _longest_pass(
    packed: Any, projection: Projection, tolerances: tuple[Any, Any], search: Any, tiles: int, unrolled: bool | None
) -> Any:
    return _of_lengths(packed, projection, tolerances, search, tiles=tiles, unrolled=unrolled)


@loops.chunked
def _of_lengths(
    both: Any, projection: Projection, tolerances: Any, search: Any, *, tiles: int, unrolled: bool | None
) -> Any:
    control, (along, shortest, longest) = both
    scale, steps = search

    def needed(length: Any) -> Any:
        size = jnp.sqrt(length)
        triangles = AnyTriangle((jnp.where(along == 0, size, 1.0 / size), jnp.where(along == 0, 1.0 / size, size)))
        factor = certified_factor(control, projection, tolerances, triangles, tiles=tiles, unrolled=unrolled)
        return jnp.maximum(factor * size * scale, 1e-3)

    def closer(_: Any, known: tuple[Any, ...]) -> tuple[Any, ...]:
        found, length, before, value_before = known
        value = needed(length)
        found = jnp.where(value <= 1.0, jnp.maximum(found, length), found)
        # value is about a power of the length, of an exponent up to 1
        rise = jnp.log(value / value_before) / jnp.log(length / before)
        power = jnp.where((rise > 0.3) & (rise < 1.0), rise, 1.0)
        aim = jnp.clip(_JUST_BELOW * length * value ** (-1.0 / power), shortest, longest)
        return found, jnp.where(aim == length, _JUST_BELOW * aim, aim), length, value

    guess = jnp.sqrt(shortest * longest)
    start = (jnp.zeros_like(shortest), guess, 2.0 * guess, jnp.ones_like(guess))
    return jax.lax.fori_loop(0, steps, closer, start)[0]
