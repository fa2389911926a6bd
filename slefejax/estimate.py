"""The papers' estimate of a factor from projected slefe boxes (2012, section 5; animation paper, section 3).

Kernels run with the patches along the last axis (``slefejax.layout``): control points ``(du+1, dv+1, 3, lanes)``.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from itertools import pairwise, product
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax.lax import select
from jaxtyping import Array, Float

from slefejax.bezier import bernstein
from slefejax.maxima import extent, larger, largest, largest_along, smaller
from slefejax.slefe import SECOND, Smooth, enclose_at, enclose_patch
from slefejax.view import View

Grid = Float[Array, "bu bv lanes"]


class Projection(NamedTuple):
    """What the estimate needs to know of a view."""

    to_pixels: Any  # (4, 4): world to undivided pixels from the picture's centre, half window depth, W
    frustum: Any  # (6, 4): linear in the homogeneous world point, all at least 0 inside the view volume
    near_w: Any  # W of the near plane
    half: Any  # (3,): half the picture's width and height in pixels, half the window depth

    @staticmethod
    def of(view: View) -> Projection:
        """Left, right, bottom, top, near and far plane from the rows X, Y, Z, W of ``view.world_to_screen``."""
        matrix = view.world_to_screen
        x, y, z, w = matrix[0], matrix[1], matrix[2], matrix[3]
        planes = [x, view.width * w - x, y, view.height * w - y, z, w - z]
        xp = np if isinstance(matrix, np.ndarray) else jnp
        clip = view.world_to_clip
        half = (0.5 * view.width, 0.5 * view.height, 0.5)
        scaled = [clip[row] * extent for row, extent in enumerate((*half, 1.0))]
        return Projection(xp.stack(scaled), xp.stack(planes), view.camera.near_w, xp.asarray(half))


def slefe_factor(
    control: Float[Array, "nu nv dim lanes"],
    projection: Projection,
    tolerance: Any,
    depth_tolerance: Any,
    k: Any,
    smooth: Any,
    segments: tuple[int, int],
) -> Float[Array, "lanes"]:
    """max(tau_xy, tau_z) (2012, eq 10), at least 1 where a tile is on the screen, 0 elsewhere."""
    boxes = enclose_patch(control, segments, smooth)
    return factor_of_boxes(boxes, control, projection, tolerance, depth_tolerance, k, smooth, segments)


def factor_of_boxes(
    boxes: tuple[Any, Any],
    control: Any,
    projection: Projection,
    tolerance: Any,
    depth_tolerance: Any,
    k: Any,
    smooth: Any,
    segments: tuple[int, int],
) -> Float[Array, "lanes"]:
    """The same from slefe boxes that are there already; of control points only rational ones are looked at.

    smooth : a temperature (``slefejax.maxima``), or None. Whether a tile is on the screen stays a yes or no.
    """
    width, depth, seen = visible_widths(boxes, control, projection, smooth, segments, depth_tolerance is not None)
    demand = width / tolerance
    if depth is not None:
        demand = largest([demand, depth / depth_tolerance], smooth)
    factor = tau(demand, k, max(segments), smooth)
    return select(seen, factor, jnp.zeros_like(factor))


def visible_widths(
    boxes: tuple[Any, Any],
    control: Any,
    projection: Projection,
    smooth: Any,
    segments: tuple[int, int],
    with_depth: bool,
) -> tuple[Any, Any, Any]:
    """The largest width of the boxes of visible tiles in pixels (2012, eq 8) and in depth, and if there is one."""
    lower, upper = boxes
    inside = inside_of_tiles(lower, upper, projection.frustum)
    if lower.shape[2] == 4:
        width, depth = rational_widths(control, projection, segments, with_depth, smooth)
    else:
        width, depth = projected_widths(lower, upper, projection, with_depth, smooth)
    of_depth = None if depth is None else visible_maximum(depth, inside, smooth)
    return visible_maximum(width, inside, smooth), of_depth, largest_of(inside) >= 0


def tau(demand: Any, k: Any, m: int, smooth: Any = None) -> Any:
    """tau = k_m m sqrt(w / tolerance) (2012, eq 9; animation paper, eq 7), but at least 1.

    Below 1 it is constant, so its gradient there is 0, and finite at w = 0.
    """
    square = (k * m) ** 2 * demand
    return jnp.sqrt(largest([square, jnp.ones_like(square)], smooth))


def inside_of_tiles(lower: Any, upper: Any, frustum: Float[Array, "6 4"]) -> list[list[Any]]:
    """The Q-test: at least 0, ``(lanes,)`` for every tile, unless its four boxes lie outside of one and the same plane.

    Where W > 0 this is the test of the rectangle Q against the screen (2012, section 6), with near and far added; it
    needs no division, so it holds for boxes at and behind the camera too.
    """
    # one box after the other: of arrays of boxes, and of reductions, the compiler makes code that is ten times slower
    boxes = _each(lower.shape, lambda i, j: (0.5 * (lower[i, j] + upper[i, j]), 0.5 * (upper[i, j] - lower[i, j])))
    parts = range(lower.shape[2])  # homogeneous points bring their own last coordinate
    inside: list[list[Any]] | None = None
    for plane in frustum:

        def reach(i: int, j: int, plane: Any = plane) -> Any:
            centre, half = boxes[i][j]
            start: Any = 0.0 if len(parts) == 4 else plane[3]
            return start + sum(plane[a] * centre[a] + jnp.abs(plane[a]) * half[a] for a in parts)

        furthest = _tile_maxima(_each(lower.shape, reach))
        inside = furthest if inside is None else _pairwise(smaller, inside, furthest)
    assert inside is not None
    return inside


def visible_maximum(width: Grid, inside: list[list[Any]], smooth: Any = None) -> Float[Array, "lanes"]:
    """The largest width (2012, eq 8) over the boxes of the tiles that are on the screen; 0 if there is none."""
    if smooth is not None:
        return _visible_soft_maximum(width, inside, smooth)
    tiles = _tile_maxima(_each(width.shape, lambda i, j: width[i, j]))
    return largest_of(_pairwise(lambda w, i: select(i >= 0, w, jnp.zeros_like(w)), tiles, inside))


def _visible_soft_maximum(width: Grid, inside: list[list[Any]], smooth: Any) -> Float[Array, "lanes"]:
    """Softly: a box counts once, if any of its tiles is on the screen."""
    m_u, m_v = len(inside), len(inside[0])
    seen = []
    for i, j in product(range(m_u + 1), range(m_v + 1)):
        own = [inside[a][b] for a in (i - 1, i) for b in (j - 1, j) if 0 <= a < m_u and 0 <= b < m_v]
        seen.append(select(largest(own) >= 0, width[i, j], jnp.zeros_like(width[i, j])))
    return largest_along(jnp.stack(seen), (0,), smooth)


def largest_of(values: list[list[Any]]) -> Any:
    """The largest of all."""
    return reduce(larger, [value for row in values for value in row])


def _each(shape: tuple[int, ...], value: Callable[[int, int], Any]) -> list[list[Any]]:
    return [[value(i, j) for j in range(shape[1])] for i in range(shape[0])]


def _pairwise(combine: Callable[[Any, Any], Any], a: list[list[Any]], b: list[list[Any]]) -> list[list[Any]]:
    return [[combine(x, y) for x, y in zip(p, q, strict=True)] for p, q in zip(a, b, strict=True)]


def _tile_maxima(values: list[list[Any]]) -> list[list[Any]]:
    """The largest of the values at the four corners of every tile."""
    along = _pairwise(larger, values[:-1], values[1:])
    return [[larger(x, y) for x, y in pairwise(row)] for row in along]


def projected_widths(
    lower: Any, upper: Any, projection: Projection, with_depth: bool, smooth: Any = None
) -> tuple[Grid, Grid | None]:
    """Longer side of the rectangle around each projected box (2012, eq 7 and 8), pixels; its extent in window depth.

    A corner with W below that of the near plane is measured in the near plane.
    """
    matrix, ends = projection.to_pixels, (lower, upper)
    parts = [[[row[a] * end[:, :, a] for end in ends] for a in range(3)] for row in matrix]
    rows = range(3) if with_depth else range(2)
    seen: list[list[Any]] = [[] for _ in rows]
    for corner in product((0, 1), repeat=3):
        position = [sum(p[a][corner[a]] for a in range(3)) + row[3] for p, row in zip(parts, matrix, strict=True)]
        inverse = 1.0 / larger(position[3], jnp.full_like(position[3], projection.near_w))
        for r in rows:
            seen[r].append(position[r] * inverse)
    sides = [extent(own, smooth) for own in seen]
    return largest(sides[:2], smooth), sides[2] if with_depth else None


def rational_widths(
    control: Float[Array, "nu nv 4 lanes"],
    projection: Projection,
    segments: tuple[int, int],
    with_depth: bool,
    smooth: Any = None,
) -> tuple[Grid, Grid | None]:
    """The widths of rational patches: at each breakpoint that of the slefe of X - s W, over W (MATH.md, section 6).

    The papers have none. X, Y and W are the polynomials of the undivided pixel position, s is X/W at the breakpoint,
    so x - s = (X - s W)/W, and numerator and denominator do not vary apart. Near and behind the camera W counts as at
    the near plane.
    """
    screen = jnp.stack([sum(row[a] * control[:, :, a] for a in range(4)) for row in projection.to_pixels], axis=2)
    u, v = (np.arange(m + 1) / m for m in segments)
    basis_u, basis_v = (
        jnp.asarray(np.stack(bernstein(degree, t)), screen.dtype)
        for degree, t in ((screen.shape[0] - 1, u), (screen.shape[1] - 1, v))
    )
    point = jnp.einsum("ik,jl,ijcp->klcp", basis_u, basis_v, screen, precision="highest")
    w = larger(point[:, :, 3], jnp.full_like(point[:, :, 3], projection.near_w))[:, :, None]
    rows = 3 if with_depth else 2
    g = screen[:, :, None, None, :rows] - (point[:, :, :rows] / w) * screen[:, :, None, None, 3:]
    low, high = _enclose_at_breakpoints(g, segments, smooth)
    sides = (high - low) / w
    return largest([sides[:, :, 0], sides[:, :, 1]], smooth), sides[:, :, 2] if with_depth else None


def _enclose_at_breakpoints(
    g: Float[Array, "nu nv bu bv rows lanes"], segments: tuple[int, int], temperature: Any
) -> tuple[Any, Any]:
    """Lower and upper ends ``(bu, bv, rows, lanes)``, at every breakpoint of its own coefficients."""
    by_v, across, along = jnp.transpose(g, (1, 3, 0, 2, 4, 5)), None, None
    if temperature is not None:
        across = Smooth(temperature, (1,))
        wider = SECOND * across.blur(by_v, segments[1])[:, 0]
        along = Smooth(temperature, (1,), jnp.swapaxes(wider, 0, 1))
    bounds = enclose_at(by_v, segments[1], across)
    low, high = (enclose_at(jnp.transpose(bound, (1, 2, 0, 3, 4)), segments[0], along) for bound in bounds)
    return low[0], high[1]
