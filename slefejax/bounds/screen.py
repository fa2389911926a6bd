"""Slefe boxes on the screen: their widths in pixels and in window depth ([YBP12], section 5; docs/math.md, 3 and 6).

Kernels run with the patches along the last axis (``slefejax.lanes.layout``): boxes ``(m_u+1, m_v+1, 3, lanes)``.
"""

from __future__ import annotations

from itertools import product
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.lax import select
from jaxtyping import Array, Float

from slefejax.bounds.slefe import Signs, enclose_at
from slefejax.geometry.bezier import bernstein
from slefejax.geometry.projection import Projection, numbers
from slefejax.geometry.volume import few, inside_of_tiles, tile_maxima
from slefejax.lanes import nets
from slefejax.lanes.maxima import EXACT, Maxima, at_least, largest
from slefejax.lanes.nets import Net

Grid = Float[Array, "bu bv lanes"]


class Widths(NamedTuple):
    """Of the boxes of visible tiles: the largest in pixels and in window depth (or None), and if there is one."""

    pixels: Array
    depth: Array | None
    seen: Array


def visible_widths(
    boxes: tuple[Array, Array],
    control: Array | None,
    projection: Projection,
    maxima: Maxima,
    segments: tuple[int, int],
    with_depth: bool,
) -> Widths:
    """The largest width of the boxes of visible tiles in pixels ([YBP12], (8)) and in depth.

    control : of rational patches, nothing else is looked at
    """
    lower, upper = boxes
    inside = inside_of_tiles(lower, upper, projection.frustum)
    if lower.shape[2] == 4:
        assert control is not None
        width, depth = rational_widths(control, projection, segments, with_depth, maxima)
    else:
        width, depth = projected_widths(lower, upper, projection, with_depth, maxima)
    of_depth = None if depth is None else visible_maximum(depth, inside, maxima)
    return Widths(visible_maximum(width, inside, maxima), of_depth, nets.top(inside) >= 0)


def visible_maximum(width: Grid, inside: Net, maxima: Maxima) -> Float[Array, "lanes"]:
    """The largest width ([YBP12], (8)) over the boxes of the tiles that are on the screen; 0 if there is none.

    Softly a box counts once, exactly that of every tile.
    """
    if not maxima.exact:
        return maxima.largest_along(jnp.where(_seen_boxes(inside), width, 0.0), (0, 1))
    tiles = tile_maxima(nets.coordinates(width[:, :, None], few(width))[0])
    return nets.top(nets.each(lambda w, i: select(i >= 0, w, jnp.zeros_like(w)), tiles, inside))


def _seen_boxes(inside: Net) -> Any:
    """Whether any of the tiles around a box is on the screen, ``(bu, bv, lanes)``."""
    around = jnp.pad(nets.stacked(inside), ((1, 1), (1, 1), (0, 0)), constant_values=-1.0)
    return jnp.asarray(tile_maxima(around)) >= 0


def widest(width: Grid, inside: Net) -> Array:
    """The number of the first of the widest boxes that belong to a tile on the screen, counted along v first; or -1."""
    if not nets.unrolled(inside):
        seen = jnp.where(_seen_boxes(inside), width, -1.0).reshape(-1, width.shape[-1])
        number = jnp.argmax(seen, axis=0).astype(np.int32)
        return jnp.where(jnp.max(seen, axis=0) >= 0, number, -1)
    most = jnp.full_like(width[0, 0], -1.0)
    number = jnp.full(most.shape, -1, np.int32)
    for i, j in np.ndindex(*width.shape[:2]):
        around = inside[max(i - 1, 0) : i + 1, max(j - 1, 0) : j + 1]
        wider = (width[i, j] > most) & (largest(list(around.ravel())) >= 0)
        most = select(wider, width[i, j], most)
        number = select(wider, jnp.full_like(number, i * width.shape[1] + j), number)
    return number


def projected_widths(
    lower: Array, upper: Array, projection: Projection, with_depth: bool, maxima: Maxima = EXACT
) -> tuple[Grid, Grid | None]:
    """Longer side of the rectangle around each projected box ([YBP12], (7), (8)), pixels; its extent in window depth.

    A corner with W below that of the near plane is measured in the near plane.
    """
    matrix, ends = numbers(projection.to_pixels), (lower, upper)
    parts = [[[row[a] * end[:, :, a] for end in ends] for a in range(3)] for row in matrix]
    rows = range(3) if with_depth else range(2)
    seen: list[list[Any]] = [[] for _ in rows]
    for corner in product((0, 1), repeat=3):
        position = [
            nets.total([*(p[a][corner[a]] for a in range(3)), row[3]]) for p, row in zip(parts, matrix, strict=True)
        ]
        inverse = 1.0 / at_least(position[3], projection.near_w)
        for r in rows:
            seen[r].append(position[r] * inverse)
    sides = [maxima.extent(own) for own in seen]
    return maxima.largest(sides[:2]), sides[2] if with_depth else None


def rational_widths(
    control: Float[Array, "nu nv 4 lanes"],
    projection: Projection,
    segments: tuple[int, int],
    with_depth: bool,
    maxima: Maxima = EXACT,
) -> tuple[Grid, Grid | None]:
    """The widths of rational patches: those of ``rational_boxes`` (docs/math.md, 6)."""
    _, low, high = rational_boxes(control, projection, segments, 3 if with_depth else 2, maxima)
    sides = high - low
    return maxima.largest([sides[:, :, 0], sides[:, :, 1]]), sides[:, :, 2] if with_depth else None


def rational_boxes(
    control: Float[Array, "nu nv 4 lanes"],
    projection: Projection,
    segments: tuple[int, int],
    rows: int,
    maxima: Maxima = EXACT,
) -> tuple[Array, Array, Array]:
    """Position s on the screen at each breakpoint, and from how far below it to how far above (docs/math.md, 6).

    Each ``(bu, bv, rows, lanes)``, rows of pixels and window depth: the slefe of X - s W, over W. X, Y and W are the
    polynomials of the undivided pixel position, s is X/W at the breakpoint, so x - s = (X - s W)/W, and numerator and
    denominator do not vary apart. Near and behind the camera W counts as at the near plane.
    """
    screen = jnp.stack(projection.undivided(control), axis=2)
    u, v = (np.arange(m + 1) / m for m in segments)
    basis_u, basis_v = (
        jnp.asarray(np.stack(bernstein(degree, t)), screen.dtype)
        for degree, t in ((screen.shape[0] - 1, u), (screen.shape[1] - 1, v))
    )
    point = jnp.einsum("ik,jl,ijcp->klcp", basis_u, basis_v, screen, precision="highest")
    w = at_least(point[:, :, 3], projection.near_w)[:, :, None]
    at = point[:, :, :rows] / w
    g = screen[:, :, None, None, :rows] - at * screen[:, :, None, None, 3:]
    low, high = _enclose_each(g, segments, maxima)
    return at, low / w, high / w


def _enclose_each(
    g: Float[Array, "nu nv bu bv rows lanes"], segments: tuple[int, int], maxima: Maxima
) -> tuple[Any, Any]:
    """Lower and upper ends ``(bu, bv, rows, lanes)``, at every breakpoint of its own coefficients."""
    by_v, across = jnp.transpose(g, (1, 3, 0, 2, 4, 5)), Signs(maxima, alike=(1,))
    along = across.of_bounds(by_v, segments[1], lambda wider: jnp.swapaxes(wider[:, 0], 0, 1))
    bounds = enclose_at(by_v, segments[1], across)
    low, high = (enclose_at(jnp.transpose(bound, (1, 2, 0, 3, 4)), segments[0], along) for bound in bounds)
    return low[0], high[1]
