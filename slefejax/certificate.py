"""What can be asked of certified factors: boxes of any shape, pairs of levels, longest triangles of strips."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax import layout
from slefejax.certified import certified_factor
from slefejax.estimate import Projection
from slefejax.rings import Pattern
from slefejax.tessellator import HIGHEST_LEVEL

_RATIOS = 2.0 ** (np.arange(-20, 21) / 4.0)  # of n_u to n_v that are tried
_SMALLER_STEPS = 4  # how often a level is made smaller by one, where that is still allowed
_WORSE = 1.4  # pairs with at most so many times the fewest cells are made smaller
_STEPS = 6  # towards the longest triangle
_JUST_BELOW = 0.995  # where a step aims: a length that is not quite allowed is worth nothing
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
        self, nets: Float[np.ndarray, "n nu nv dim"], extents: Float[np.ndarray, "n 2"]
    ) -> Float[np.ndarray, "n"]:
        """Certified factors of control nets for halves of boxes of sides extent/n; 0 for an unseen patch."""
        return self._in_batches(_boxes_jit, nets, extents, self.tiles)

    def keeps(self, nets: Float[np.ndarray, "n nu nv dim"], sides: Float[np.ndarray, "n 2"]) -> Bool[np.ndarray, "n"]:
        """Whether all halves of boxes with such sides in the domain keep the tolerance."""
        size = np.sqrt(sides[:, 0] * sides[:, 1])
        return self.factors(nets, sides / size[:, None]) * size * self.scale <= 1.0

    def longest(
        self,
        nets: Float[np.ndarray, "n nu nv dim"],
        along: Int[np.ndarray, "n"],
        shortest: Float[np.ndarray, "n"],
        longest: Float[np.ndarray, "n"],
    ) -> Float[np.ndarray, "n"]:
        """How long triangles of any shape may be along an axis of a net, between two lengths; 0 if never so short."""
        numbers = np.stack([along, shortest, longest], axis=1)
        return self._in_batches(_longest_jit, nets, numbers, self.scale, self.tiles)

    @cached_property
    def swept(self) -> Int[np.ndarray, "patches ratios 2"]:
        """Levels along u and v that keep the tolerance, for a row of ratios between them; 0 for an unseen patch."""
        found = []
        for ratio in _RATIOS:
            extents = np.array([ratio**-0.5, ratio**0.5])
            factor = self.scale * self.factors(self.patches, np.broadcast_to(extents, (len(self.patches), 2)))
            found.append(self.pattern.levels_for(np.maximum(factor[:, None] / extents, factor[:, None] > 0)))
        return np.stack(found, axis=1)

    def pairs(self) -> Float[np.ndarray, "patches 2"]:
        """Real factors along u and v for the fewest triangles of a grid; 0 for an unseen patch.

        The best pair of whole levels that were swept is made smaller, one level at a time, while that is allowed.
        """
        best = self.swept[np.arange(len(self.patches)), np.argmin(self.swept.prod(axis=2), axis=1)]
        for axis in (0, 1) * _SMALLER_STEPS:
            smaller = best - np.eye(2, dtype=np.int64)[axis]
            patch = np.flatnonzero(smaller[:, axis] >= 1)
            fine = patch[self.keeps(self.patches[patch], self.pattern.cells(smaller[patch]))]
            best[fine] = smaller[fine]
        return np.where(best > 0, 1.0 / self.pattern.cells(np.maximum(best, 1)), 0.0)

    def smallest(self, known: Int[np.ndarray, "patches 2"]) -> Int[np.ndarray, "patches n"]:
        """For every level along u up to 64 the smallest one along v that is known to do; 65 if there is none.

        known : levels that do
        """
        every = np.concatenate([self.swept, known[:, None]], axis=1)
        patch = np.broadcast_to(np.arange(len(every))[:, None], every.shape[:2])
        drawn = np.all((every > 0) & (every <= HIGHEST_LEVEL), axis=2)
        least = np.full((len(every), HIGHEST_LEVEL + 1), HIGHEST_LEVEL + 1)
        np.minimum.at(least, (patch[drawn], every[drawn, 0]), every[drawn, 1])
        level = np.arange(HIGHEST_LEVEL + 1)
        for _ in range(_SMALLER_STEPS):
            least = np.minimum.accumulate(least, axis=1)
            cells = np.where(least <= HIGHEST_LEVEL, level * least, np.inf)
            cells[:, 0] = np.inf
            near = (cells <= _WORSE * cells.min(axis=1, keepdims=True)) & (least > 1) & np.isfinite(cells)
            patch, u = np.nonzero(near)
            v = least[patch, u] - 1
            fine = self.keeps(self.patches[patch], self.pattern.cells(np.stack([u, v], axis=1)))
            least[patch[fine], u[fine]] = v[fine]
        return np.minimum.accumulate(least, axis=1)

    def _in_batches(
        self, jitted: Callable[..., Any], nets: np.ndarray, numbers: np.ndarray, *static: Any
    ) -> np.ndarray:
        dtype, found = self.patches.dtype, []
        for at in range(0, len(nets), _BATCH):
            own = [np.asarray(x[at : at + _BATCH], dtype) for x in (nets, numbers)]
            # whole chunks, so that few shapes are compiled
            filled = [np.pad(x, [(0, -len(x) % layout.LANES)] + [(0, 0)] * (x.ndim - 1), mode="edge") for x in own]
            packed = [jnp.asarray(layout.pack(x)) for x in filled]
            chunks = jitted(*packed, self.projection, self.tolerances, *static)
            found.append(np.asarray(layout.unpack(chunks, len(own[0])), np.float64))
        return np.concatenate(found) if found else np.zeros(0)


@partial(jax.jit, static_argnums=4)
def _boxes_jit(packed: Any, extents: Any, projection: Projection, tolerances: tuple[Any, Any], tiles: int) -> Any:
    def kernel(both: tuple[Any, Any]) -> Any:
        control, extent = both
        return certified_factor(control, projection, *tolerances, (extent[0], extent[1]), tiles=tiles)

    return jax.lax.map(kernel, (packed, extents))


@partial(jax.jit, static_argnums=5)
def _longest_jit(
    packed: Any, numbers: Any, projection: Projection, tolerances: tuple[Any, Any], scale: Any, tiles: int
) -> Any:
    def kernel(both: tuple[Any, Any]) -> Any:
        control, (along, shortest, longest) = both

        def closer(_: Any, known: tuple[Any, ...]) -> tuple[Any, ...]:
            found, length, before, value_before = known
            size = jnp.sqrt(length)
            extent = (jnp.where(along == 0, size, 1.0 / size), jnp.where(along == 0, 1.0 / size, size))
            factor = certified_factor(control, projection, *tolerances, extent, tiles=tiles, any_triangle=True)
            value = jnp.maximum(factor * size * scale, 1e-3)
            found = jnp.where(value <= 1.0, jnp.maximum(found, length), found)
            # value is about a power of the length, of an exponent up to 1
            rise = jnp.log(value / value_before) / jnp.log(length / before)
            power = jnp.where((rise > 0.3) & (rise < 1.0), rise, 1.0)
            aim = jnp.clip(_JUST_BELOW * length * value ** (-1.0 / power), shortest, longest)
            return found, jnp.where(aim == length, _JUST_BELOW * aim, aim), length, value

        guess = jnp.sqrt(shortest * longest)
        start = (jnp.zeros_like(shortest), guess, 2.0 * guess, jnp.ones_like(guess))
        return jax.lax.fori_loop(0, _STEPS, closer, start)[0]

    return jax.lax.map(kernel, (packed, numbers))
