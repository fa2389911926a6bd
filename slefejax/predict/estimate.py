"""The published estimate of a factor from projected slefe boxes ([YBP12], section 5; [YBP14], section 3).

Kernels run with the patches along the last axis (``slefejax.lanes.layout``): control points ``(du+1, dv+1, 3, lanes)``.
"""

from __future__ import annotations

from functools import partial, reduce
from itertools import chain, product
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.lax import select
from jaxtyping import Array, Float

from slefejax.bounds.slefe import SECOND, Smooth, box_at, enclose_at, enclose_patch
from slefejax.geometry.bezier import bernstein
from slefejax.geometry.projection import Projection, harmless, relative
from slefejax.lanes import layout, nets
from slefejax.lanes.maxima import at_least, extent, larger, largest, largest_along, smaller
from slefejax.lanes.nets import Net

Grid = Float[Array, "bu bv lanes"]
_UNROLLED = 25  # boxes


def slefe_factor(
    control: Float[Array, "nu nv dim lanes"],
    projection: Projection,
    tolerance: Any,
    depth_tolerance: Any,
    k: Any,
    smooth: Any,
    segments: tuple[int, int],
) -> Float[Array, "lanes"]:
    """max(tau_xy, tau_z) ([YBP12], (10)), at least 1 where a tile is on the screen, 0 elsewhere."""
    boxes = enclose_patch(control, segments, smooth)
    return factor_of_boxes(boxes, control, projection, tolerance, depth_tolerance, k, smooth, segments)


def slefe_factors(
    packed: Float[Array, "chunks nu nv 3 lanes"],
    projection: Projection,
    scales: tuple[Any, Any, Any],
    segments: tuple[int, int],
) -> Float[Array, "chunks lanes"]:
    """``slefe_factor`` of all chunks of polynomial patches; NaN for those that are harmful.

    scales : tolerance, depth tolerance or None, k
    """
    # with constants: differentiation neither sees nor repeats this loop
    constants = jax.lax.stop_gradient((packed, projection, *scales))
    factor, places = layout.over_chunks(partial(_decided, segments=segments), *constants, apart=True)
    return _with_slopes(segments, (factor, places), packed, projection, scales)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _with_slopes(segments: tuple[int, int], found: tuple, packed: Any, projection: Projection, scales: tuple) -> Any:
    """The factors that were found, with the derivatives of their widest boxes alone.

    The others have no part in the largest width. A loop of its own finds it: in one loop with the rest the compiler
    would do that again wherever it is needed.
    """
    return found[0]


@_with_slopes.defjvp
def _slopes(segments: tuple[int, int], at: tuple, along: tuple) -> tuple:
    (factor, places), *given = at

    def there(packed: Any, projection: Projection, scales: tuple) -> Any:
        kernel = partial(_factor_there, segments=segments)
        return layout.over_chunks(kernel, (packed, places), projection, *scales, apart=True)

    slope = jax.jvp(there, tuple(given), along[1:])[1]
    return factor, select(places[0] >= 0, slope, jnp.zeros_like(slope))


def _decided(
    control: Any, projection: Projection, tolerance: Any, depth_tolerance: Any, k: Any, segments: tuple[int, int]
) -> tuple[Any, list[Any]]:
    """The factor, and the numbers of the widest box and, if there is a depth tolerance, of the deepest."""
    lower, upper = enclose_patch(projection.relative(control), segments)
    factor = factor_of_boxes((lower, upper), None, projection, tolerance, depth_tolerance, k, None, segments)
    inside = inside_of_tiles(lower, upper, projection.frustum)
    widths = projected_widths(lower, upper, projection, depth_tolerance is not None)
    good = harmless(control, projection)
    places = [_widest(width, inside) for width in widths if width is not None]
    places = [jnp.where(good, place, -1) for place in places]
    return jnp.where(good, factor, jnp.nan), places


def _factor_there(
    given: tuple[Any, list[Any]],
    projection: Projection,
    tolerance: Any,
    depth_tolerance: Any,
    k: Any,
    segments: tuple[int, int],
) -> Any:
    """tau of these boxes alone."""
    control, places = given
    control = projection.relative(control)
    demands = []
    for which, place in enumerate(places):
        low, high = box_at(control, divmod(place, segments[1] + 1), segments)
        width: Any = projected_widths(low[None, None], high[None, None], projection, depth_tolerance is not None)[which]
        demands.append(width[0, 0] / (tolerance, depth_tolerance)[which])
    return tau(largest(demands), k, max(segments))


class Boxes(NamedTuple):
    """Slefe boxes of patches in the layout of the kernels, as rounding leaves them, relative to an origin."""

    lower: Any
    upper: Any
    origin: Any

    @staticmethod
    def of(packed: Any, origin: Any, segments: tuple[int, int], smooth: Any = None) -> Boxes:
        """From control points in the world."""
        lower, upper = boxes_pass(packed, origin, segments, smooth)
        return Boxes(lower, upper, origin)


@layout.as_pass(2)
def boxes_pass(packed: Any, origin: Any, segments: tuple[int, int], smooth: Any) -> tuple[Any, Any]:
    """What ``Boxes`` are made of."""

    def kernel(control: Any) -> tuple[Any, Any]:
        return enclose_patch(relative(control, origin), segments, smooth)

    return layout.over_chunks(kernel, packed)


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

    smooth : a temperature (``slefejax.lanes.maxima``), or None. Whether a tile is on the screen stays a yes or no.
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
    """The largest width of the boxes of visible tiles in pixels ([YBP12], (8)) and in depth, and if there is one."""
    lower, upper = boxes
    inside = inside_of_tiles(lower, upper, projection.frustum)
    if lower.shape[2] == 4:
        width, depth = rational_widths(control, projection, segments, with_depth, smooth)
    else:
        width, depth = projected_widths(lower, upper, projection, with_depth, smooth)
    of_depth = None if depth is None else visible_maximum(depth, inside, smooth)
    return visible_maximum(width, inside, smooth), of_depth, nets.top(inside) >= 0


def tau(demand: Any, k: Any, m: int, smooth: Any = None) -> Any:
    """tau = k_m m sqrt(w / tolerance) ([YBP12], (9); [YBP14], (7)), but at least 1.

    Below 1 it is constant, so its gradient there is 0, and finite at w = 0.
    """
    square = (k * m) ** 2 * demand
    return jnp.sqrt(largest([square, jnp.ones_like(square)], smooth))


def inside_of_tiles(lower: Any, upper: Any, frustum: Float[Array, "6 4"]) -> Net:
    """The Q-test: at least 0 for every tile, unless its four boxes lie outside of one and the same plane.

    Where W > 0 this is the test of the rectangle Q against the screen ([YBP12], section 6), with near and far added;
    it needs no division, so it holds for boxes at and behind the camera too.
    """
    unrolled = _unrolled(lower)
    ends = zip(nets.coordinates(lower, unrolled), nets.coordinates(upper, unrolled), strict=True)
    boxes = [
        (nets.each(lambda a, b: 0.5 * (a + b), low, high), nets.each(lambda a, b: 0.5 * (b - a), low, high))
        for low, high in ends
    ]
    inside: Net | None = None
    for plane, sizes in zip(_numbers(frustum), _numbers(jnp.abs(frustum)), strict=True):
        weights = [weight for pair in zip(plane, sizes, strict=True) for weight in pair]
        # homogeneous points bring their own last coordinate
        start = [] if len(boxes) == 4 else [plane[3]]

        def reach(*parts: Any, weights: Any = weights, start: Any = start) -> Any:
            return nets.total([*start, *(weight * part for weight, part in zip(weights, parts, strict=False))])

        furthest = _tile_maxima(nets.each(reach, *chain(*boxes)))
        inside = furthest if inside is None else nets.each(smaller, inside, furthest)
    assert inside is not None
    return inside


def _numbers(matrix: Any) -> list[list[Any]]:
    """The entries, each taken out once: where they are used again and again, that is a third of the program."""
    return [[row[a] for a in range(matrix.shape[1])] for row in matrix]


def visible_maximum(width: Grid, inside: Net, smooth: Any = None) -> Float[Array, "lanes"]:
    """The largest width ([YBP12], (8)) over the boxes of the tiles that are on the screen; 0 if there is none."""
    if smooth is not None:
        return _visible_soft_maximum(width, inside, smooth)
    tiles = _tile_maxima(nets.coordinates(width[:, :, None], _unrolled(width))[0])
    return nets.top(nets.each(lambda w, i: select(i >= 0, w, jnp.zeros_like(w)), tiles, inside))


def _visible_soft_maximum(width: Grid, inside: Net, smooth: Any) -> Float[Array, "lanes"]:
    """Softly: a box counts once."""
    return largest_along(jnp.where(_seen_boxes(inside), width, 0.0), (0, 1), smooth)


def _seen_boxes(inside: Net) -> Any:
    """Whether any of the tiles around a box is on the screen, ``(bu, bv, lanes)``."""
    tiles = jnp.stack([jnp.stack(list(row)) for row in inside])
    around = jnp.pad(tiles, ((1, 1), (1, 1), (0, 0)), constant_values=-1.0)
    return jnp.asarray(_tile_maxima(around)) >= 0


def _widest(width: Grid, inside: Net) -> Any:
    """The number of the first of the widest boxes that belong to a tile on the screen, counted along v first; or -1."""
    if not isinstance(inside, list):
        seen = jnp.where(_seen_boxes(inside), width, -1.0).reshape(-1, width.shape[-1])
        number = jnp.argmax(seen, axis=0).astype(np.int32)
        return jnp.where(jnp.max(seen, axis=0) >= 0, number, -1)
    most = jnp.full_like(width[0, 0], -1.0)
    number = jnp.full(most.shape, -1, np.int32)
    for i, j in np.ndindex(*width.shape[:2]):
        tiles = [
            inside[a][b] for a in (i - 1, i) for b in (j - 1, j) if 0 <= a < len(inside) and 0 <= b < len(inside[0])
        ]
        wider = (width[i, j] > most) & (reduce(larger, tiles) >= 0)
        most = select(wider, width[i, j], most)
        number = select(wider, jnp.full_like(number, i * width.shape[1] + j), number)
    return number


def _unrolled(grid: Any) -> bool:
    """Whether a grid is few enough boxes for one after the other, of which the compiler makes faster code."""
    return grid.shape[0] * grid.shape[1] <= _UNROLLED


def _tile_maxima(net: Net) -> Net:
    """The largest of the values at the four corners of every tile."""
    for _ in ("u", "v"):
        net = nets.transposed(nets.each(larger, net[:-1], net[1:]))
    return net


def projected_widths(
    lower: Any, upper: Any, projection: Projection, with_depth: bool, smooth: Any = None
) -> tuple[Grid, Grid | None]:
    """Longer side of the rectangle around each projected box ([YBP12], (7), (8)), pixels; its extent in window depth.

    A corner with W below that of the near plane is measured in the near plane.
    """
    matrix, ends = _numbers(projection.to_pixels), (lower, upper)
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
    sides = [extent(own, smooth) for own in seen]
    return largest(sides[:2], smooth), sides[2] if with_depth else None


def rational_widths(
    control: Float[Array, "nu nv 4 lanes"],
    projection: Projection,
    segments: tuple[int, int],
    with_depth: bool,
    smooth: Any = None,
) -> tuple[Grid, Grid | None]:
    """The widths of rational patches: those of ``rational_boxes`` (docs/math.md, 6)."""
    _, low, high = rational_boxes(control, projection, segments, 3 if with_depth else 2, smooth)
    sides = high - low
    return largest([sides[:, :, 0], sides[:, :, 1]], smooth), sides[:, :, 2] if with_depth else None


def rational_boxes(
    control: Float[Array, "nu nv 4 lanes"],
    projection: Projection,
    segments: tuple[int, int],
    rows: int,
    smooth: Any = None,
) -> tuple[Any, Any, Any]:
    """Position s on the screen at each breakpoint, and from how far below it to how far above (docs/math.md, 6).

    Each ``(bu, bv, rows, lanes)``, rows of pixels and window depth: the slefe of X - s W, over W. X, Y and W are the
    polynomials of the undivided pixel position, s is X/W at the breakpoint, so x - s = (X - s W)/W, and numerator and
    denominator do not vary apart. Near and behind the camera W counts as at the near plane.
    """
    screen = jnp.stack([sum(row[a] * control[:, :, a] for a in range(4)) for row in projection.to_pixels], axis=2)
    u, v = (np.arange(m + 1) / m for m in segments)
    basis_u, basis_v = (
        jnp.asarray(np.stack(bernstein(degree, t)), screen.dtype)
        for degree, t in ((screen.shape[0] - 1, u), (screen.shape[1] - 1, v))
    )
    point = jnp.einsum("ik,jl,ijcp->klcp", basis_u, basis_v, screen, precision="highest")
    w = at_least(point[:, :, 3], projection.near_w)[:, :, None]
    at = point[:, :, :rows] / w
    g = screen[:, :, None, None, :rows] - at * screen[:, :, None, None, 3:]
    low, high = _enclose_at_breakpoints(g, segments, smooth)
    return at, low / w, high / w


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
