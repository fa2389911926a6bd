"""What can be asked of certified factors: boxes of any shape, pairs of levels, levels with their transition rings."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax import layout
from slefejax.bezier import restrict
from slefejax.certified import certified_factor
from slefejax.estimate import Projection
from slefejax.rings import Pattern, safe_levels

_RATIOS = 2.0 ** (np.arange(-20, 21) / 4.0)  # of n_u to n_v that are tried
_SMALLER_STEPS = 4  # how often each of a pair is made smaller by one, where that is still allowed
_BATCH = 2**16


@dataclass(frozen=True, eq=False)
class Certificate:
    """The patches, view and tolerances that certified factors are computed from.

    patches    : ``(patches, du+1, dv+1, dim)``, concrete
    tolerances : in pixels, and of depth or None
    tiles      : along each side of a patch
    pattern    : of the tessellator
    scale      : that of ``Factors.scaled``: with 0.9, levels are what the certificate asks for, times 0.9
    """

    patches: Float[np.ndarray, "patches nu nv dim"]
    projection: Projection
    tolerances: tuple[Any, Any]
    tiles: int
    pattern: Pattern
    scale: float = 1.0

    def factors(
        self, nets: Float[np.ndarray, "n nu nv dim"], extents: Float[np.ndarray, "n 2"], any_triangle: bool = False
    ) -> Float[np.ndarray, "n"]:
        """Certified factors of control nets for triangles in boxes of sides extent/n; 0 for an unseen patch."""
        dtype, found = self.patches.dtype, []
        for at in range(0, len(nets), _BATCH):
            own = [np.asarray(x[at : at + _BATCH], dtype) for x in (nets, extents)]
            # whole chunks, so that few shapes are compiled
            filled = [np.pad(x, [(0, -len(x) % layout.LANES)] + [(0, 0)] * (x.ndim - 1), mode="edge") for x in own]
            packed = [jnp.asarray(layout.pack(x)) for x in filled]
            chunks = _boxes_jit(*packed, self.projection, self.tolerances, self.tiles, any_triangle)
            found.append(np.asarray(layout.unpack(chunks, len(own[0])), np.float64))
        return np.concatenate(found) if found else np.zeros(0)

    def keeps(
        self, nets: Float[np.ndarray, "n nu nv dim"], sides: Float[np.ndarray, "n 2"], any_triangle: bool
    ) -> Bool[np.ndarray, "n"]:
        """Whether all triangles in boxes with such sides in the domain keep the tolerance."""
        size = np.sqrt(sides[:, 0] * sides[:, 1])
        return self.factors(nets, sides / size[:, None], any_triangle) * size * self.scale <= 1.0

    def ring_keeps(
        self,
        patch: Int[np.ndarray, "n"],
        side: Int[np.ndarray, "n"],
        width: Float[np.ndarray, "n"],
        length: Float[np.ndarray, "n"],
    ) -> Bool[np.ndarray, "n"]:
        """Whether triangles of any shape keep the tolerance in a strip along a side (``slefejax.rings.Allowed``).

        The strip is a patch of its own, so what its neighbourhood needs does not matter to it.
        """
        fine = np.zeros(len(patch), bool)
        for number in range(4):
            own = np.flatnonzero(side == number)
            across = number % 2  # the axis across the strip: u for the sides u=0 and u=1
            nets = np.moveaxis(np.asarray(self.patches[patch[own]], np.float64), (1 + across, 0), (0, -1))
            w = width[own]
            start, end = (np.zeros_like(w), w) if number < 2 else (1.0 - w, np.ones_like(w))
            strips = np.moveaxis(restrict(nets, start, end), (0, -1), (1 + across, 0))
            boxes = np.ones((len(own), 2))
            boxes[:, 1 - across] = length[own]
            fine[own] = self.keeps(strips, boxes, any_triangle=True)
        return fine

    def levels(
        self, factors: Float[np.ndarray, "patches 2"], numbers: Int[np.ndarray, "patches 4"]
    ) -> tuple[np.ndarray, np.ndarray]:
        """Inner and outer levels for real factors along u and v, transition rings included."""
        return safe_levels(self.pattern.levels_for(factors), numbers, self.pattern, self.ring_keeps)

    def pairs(self) -> Float[np.ndarray, "patches 2"]:
        """Real factors along u and v for the fewest triangles; 0 for an unseen patch.

        For a row of ratios the factor is computed in one go; the best pair of whole levels is then made smaller, one
        level at a time, as long as that is still certified.
        """
        count = len(self.patches)
        best = np.zeros((count, 2), np.int64)
        fewest = np.full(count, np.inf)
        for ratio in _RATIOS:
            extents = np.array([ratio**-0.5, ratio**0.5])
            factor = self.factors(self.patches, np.broadcast_to(extents, (count, 2)))
            levels = self.pattern.levels_for(np.maximum(factor[:, None] / extents, factor[:, None] > 0))
            product = levels[:, 0] * levels[:, 1]
            better = product < fewest
            best[better], fewest[better] = levels[better], product[better]
        for axis in (0, 1) * _SMALLER_STEPS:
            smaller = best - np.eye(2, dtype=np.int64)[axis]
            patch = np.flatnonzero(smaller[:, axis] >= 1)
            fine = patch[self.keeps(self.patches[patch], self.pattern.cells(smaller[patch]), any_triangle=False)]
            best[fine] = smaller[fine]
        return np.where(best > 0, 1.0 / self.pattern.cells(np.maximum(best, 1)), 0.0)


@partial(jax.jit, static_argnums=(4, 5))
def _boxes_jit(
    packed: Any, extents: Any, projection: Projection, tolerances: tuple[Any, Any], tiles: int, any_triangle: bool
) -> Any:
    def kernel(both: tuple[Any, Any]) -> Any:
        control, extent = both
        box = (extent[0], extent[1])
        return certified_factor(control, projection, *tolerances, box, tiles=tiles, any_triangle=any_triangle)

    return jax.lax.map(kernel, (packed, extents))
