"""The published estimate of a factor from projected slefe boxes ([YBP12], section 5; [YBP14], section 3).

Kernels run with the patches along the last axis (``slefejax.lanes.layout``): control points ``(du+1, dv+1, 3, lanes)``.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
from jax.lax import select
from jaxtyping import Array, Float

from slefejax.arguments import Number
from slefejax.bounds.screen import projected_widths, visible_widths, widest
from slefejax.bounds.slefe import box_at, enclose_patch
from slefejax.geometry.projection import Projection, harmless, relative, unless_bad
from slefejax.geometry.volume import inside_of_tiles
from slefejax.lanes import loops, passes
from slefejax.lanes.maxima import EXACT, Maxima, largest


class Scales(NamedTuple):
    """What widths are divided by: tolerances in pixels and in window depth or None, and k_m.

    >>> Scales(0.5, None, 1.0).depth is None
    True
    """

    pixels: Number
    depth: Number | None
    k: Number


@loops.chunked
def slefe_factor(
    control: Float[Array, "nu nv dim lanes"],
    projection: Projection,
    scales: Scales,
    maxima: Maxima,
    *,
    segments: tuple[int, int],
) -> Float[Array, "lanes"]:
    """max(tau_xy, tau_z) ([YBP12], (10)) of control points in the world; called with all chunks.

    At least 1 where a tile is on the screen, 0 elsewhere; NaN for harmful patches.
    """

    def kernel(control: Any, projection: Projection) -> Any:
        boxes = enclose_patch(control, segments, maxima)
        return factor_of_boxes(boxes, control, projection, scales, maxima, segments)

    return unless_bad(kernel)(control, projection)


@partial(loops.chunked, apart=True)
def slefe_factors(
    control: Float[Array, "nu nv 3 lanes"], projection: Projection, scales: Scales, *, segments: tuple[int, int]
) -> tuple[Any, list[Any]]:
    """The same of polynomial patches, without soft maxima; called with all chunks that is the factor alone.

    And the numbers of the widest box and, if there is a depth tolerance, of the deepest: derivatives look at these
    alone, as the others have no part in the largest width.
    """
    lower, upper = enclose_patch(projection.relative(control), segments)
    factor = factor_of_boxes((lower, upper), None, projection, scales, EXACT, segments)
    inside = inside_of_tiles(lower, upper, projection.frustum)
    widths = projected_widths(lower, upper, projection, scales.depth is not None)
    good = harmless(control, projection)
    places = [jnp.where(good, widest(width, inside), -1) for width in widths if width is not None]
    return jnp.where(good, factor, jnp.nan), places


@slefe_factors.slopes
def _factor_there(
    control: Any, found: tuple[Any, list[Any]], projection: Projection, scales: Scales, *, segments: tuple[int, int]
) -> Any:
    """tau of these boxes alone; of patches that are off the screen a constant."""
    factor, places = found
    control = projection.relative(control)
    demands = []
    for which, place in enumerate(places):
        low, high = box_at(control, divmod(place, segments[1] + 1), segments)
        width: Any = projected_widths(low[None, None], high[None, None], projection, scales.depth is not None)[which]
        demands.append(width[0, 0] / scales[which])
    return select(places[0] >= 0, tau(largest(demands), scales.k, max(segments)), factor)


class Boxes(NamedTuple):
    """Slefe boxes of patches in the layout of the kernels, as rounding leaves them, relative to an origin."""

    lower: Any
    upper: Any
    origin: Any

    @staticmethod
    def of(packed: Any, origin: Any, segments: tuple[int, int], maxima: Maxima = EXACT) -> Boxes:
        """From control points in the world."""
        lower, upper = boxes_pass(packed, origin, maxima, segments)
        return Boxes(lower, upper, origin)


@passes.as_pass(3)
def boxes_pass(packed: Any, origin: Any, maxima: Maxima, segments: tuple[int, int]) -> tuple[Any, Any]:
    """What ``Boxes`` are made of."""
    return _boxes(packed, origin, maxima, segments=segments)


@loops.chunked
def _boxes(control: Any, origin: Any, maxima: Maxima, *, segments: tuple[int, int]) -> tuple[Any, Any]:
    return enclose_patch(jnp.asarray(relative(control, origin)), segments, maxima)


def factor_of_boxes(
    boxes: tuple[Array, Array],
    control: Array | None,
    projection: Projection,
    scales: Scales,
    maxima: Maxima,
    segments: tuple[int, int],
) -> Float[Array, "lanes"]:
    """The same from slefe boxes that are there already; of control points only rational ones are looked at.

    Whether a tile is on the screen is a yes or no with soft maxima too.
    """
    width, depth, seen = visible_widths(boxes, control, projection, maxima, segments, scales.depth is not None)
    demand = width / scales.pixels
    if depth is not None and scales.depth is not None:
        demand = maxima.largest([demand, depth / scales.depth])
    factor = tau(demand, scales.k, max(segments), maxima)
    return select(seen, factor, jnp.zeros_like(factor))


def tau(demand: Array, k: Number, m: int, maxima: Maxima = EXACT) -> Array:
    """tau = k_m m sqrt(w / tolerance) ([YBP12], (9); [YBP14], (7)), but at least 1.

    Below 1 it is constant, so its gradient there is 0, and finite at w = 0.

    >>> tau(jnp.array(16.0), 1.0, 3).item(), tau(jnp.array(0.0), 1.0, 3).item()
    (12.0, 1.0)
    """
    square = jnp.asarray((k * m) ** 2 * demand)
    return jnp.sqrt(maxima.largest([square, jnp.ones_like(square)]))
