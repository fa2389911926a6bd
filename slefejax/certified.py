"""A tessellation factor with a proof: docs/certified.md has the theorem, and the letters that are used here.

Kernels run with the patches along the last axis (``slefejax.layout``), one array ``(lanes,)`` a coefficient: a net is
a list along u of lists along v of such arrays. On the CPU that is tens of times faster than larger arrays. The compiler
makes one loop of everything between two divisions or roots, and repeats what several loops need, so there are few.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from slefejax import layout, nets
from slefejax.estimate import Projection, larger, smaller
from slefejax.nets import Lanes, Net

Extent = tuple[Any, Any]  # sides of the box that holds a triangle, in units of 1/n, along u and v

_CUBIC = 1.0 / (12.0 * 27.0**0.5)  # the largest (1 - z^2) z / 24
_THIRD = ((3, 0, 1.0), (2, 1, 3.0), (1, 2, 3.0), (0, 3, 1.0))  # d/du, d/dv, multiplicity
_ROUNDING = 16.0  # a coefficient of a tile is wrong by at most half of this, in eps of the sum of its terms' sizes


@partial(jax.custom_vjp, nondiff_argnums=(3,))
def certified_factors(
    packed: Float[Array, "chunks nu nv dim lanes"], projection: Projection, tolerances: tuple[Any, Any], tiles: int
) -> Float[Array, "chunks lanes"]:
    """``certified_factor`` of all chunks, differentiable in reverse too.

    Reverse mode through thousands of lines takes the compiler forever. A factor depends on its own control points and
    on a handful of numbers of the view, so its derivative by each of them is found in forward mode, one after another.
    """
    return layout.over_chunks(partial(certified_factor, tiles=tiles), packed, projection, *tolerances)


def _with_inputs(packed: Any, projection: Any, tolerances: Any, tiles: int) -> tuple[Any, tuple]:
    return certified_factors(packed, projection, tolerances, tiles), (packed, projection, tolerances)


def _backwards(tiles: int, saved: tuple, cotangent: Any) -> tuple:
    packed, projection, tolerances = saved
    view, rebuild = ravel_pytree((projection, tolerances))
    count = packed[0, ..., 0].size

    def factors(points: Any, numbers: Any) -> Any:
        own, allowed = rebuild(numbers)
        return layout.over_chunks(partial(certified_factor, tiles=tiles), points, own, *allowed)

    def slope(which: Any) -> Any:
        unit = jnp.zeros(count + view.size, packed.dtype).at[which].set(1.0)
        shape = (1, *packed.shape[1:4], 1)
        by_points = jnp.broadcast_to(unit[:count].reshape(shape), packed.shape)
        return jax.jvp(factors, (packed, view), (by_points, unit[count:]))[1] * cotangent

    slopes = jax.lax.map(slope, jnp.arange(count + view.size))
    by_points = jnp.moveaxis(slopes[:count], 0, 1)
    by_points = by_points.reshape(packed.shape[0], *packed.shape[1:4], packed.shape[4])
    return (by_points, *rebuild(jnp.sum(slopes[count:], axis=(1, 2))))


certified_factors.defvjp(_with_inputs, _backwards)


def certified_factor(
    control: Float[Array, "nu nv dim lanes"],
    projection: Projection,
    tolerance: Any,
    depth_tolerance: Any,
    extent: Extent = (1.0, 1.0),
    *,
    tiles: int,
    any_triangle: bool = False,
) -> Float[Array, "lanes"]:
    """A real n >= 1 from which on the bound of docs/certified.md is at most the tolerance; 0 for an unseen patch.

    For n and every larger number the bound holds for all triangles that lie in a box of sides extent/n in the domain
    and are half of such a box (``any_triangle``: of any shape), wherever they are visible.
    """
    screen = Screen.of(control, projection, tolerance, depth_tolerance)
    whole = Piece.of(screen, screen.rows, screen.w, 1)
    remainders = [_remainder(row, screen.w, ends, extent) for row, ends in zip(screen.rows, whole.ends, strict=True)]
    least = _least_square(screen, whole, extent)
    inverse = 1.0 / jnp.sqrt(least)
    bends = [_largest_sum(net, extent) for net in (*screen.rows[:2], screen.w)]
    if tiles == 1:
        square = _square(screen, whole, remainders, bends[2], extent, inverse, any_triangle)
    else:

        def step(largest: Lanes, matrices: tuple[Any, Any]) -> tuple[Lanes, None]:
            u, v = (nets.entries_of(matrix, least) for matrix in matrices)
            *rows, w = (nets.restricted(net, u, v) for net in (*screen.rows, screen.w))
            piece = Piece.of(screen, rows, w, tiles)
            square = _square(screen, piece, remainders, bends[2], extent, inverse, any_triangle)
            return larger(largest, smaller(square, _last_visible(screen, piece, bends))), None

        u, v = nets.tile_matrices(control.shape[0], control.shape[1], tiles)
        matrices = (jnp.asarray(u, control.dtype), jnp.asarray(v, control.dtype))
        square, _ = jax.lax.scan(step, jnp.zeros_like(least), matrices)
    rounded = 1.0 + 64.0 * jnp.finfo(control.dtype).eps
    return jnp.sqrt(jnp.where(screen.visible, larger(square, least), 1.0)) * jnp.where(screen.visible, rounded, 0.0)


class Screen(NamedTuple):
    """Patches in undivided screen coordinates, each row over its tolerance, and what rounding may have done to them."""

    rows: list[Net]  # X, Y and, if there is a depth tolerance, Z: X/W = 1 is one tolerance from the centre
    w: Net
    half: list[Any]  # half the picture's extent for every row
    floor: Lanes  # W of a visible point is at least this
    sizes: list[Lanes]  # of the terms that a row's g_s is summed from: its rounding errors are proportional to them
    w_size: Lanes
    eps: float
    visible: Lanes  # not all control points outside of one plane of the view volume

    @staticmethod
    def of(control: Any, projection: Projection, tolerance: Any, depth_tolerance: Any) -> Screen:
        """From control points in the world. Unseen patches may be taken for visible ones, never the other way round."""
        rational = control.shape[2] == 4
        scales = [1.0 / tolerance, 1.0 / tolerance, 1.0 if depth_tolerance is None else 1.0 / depth_tolerance]
        half = [extent * scale for extent, scale in zip(projection.half, scales, strict=True)]
        matrix = [row * scale for row, scale in zip(projection.to_pixels, (*scales, 1.0), strict=True)]
        points = nets.points(control)
        rows = [[row[a] for a in range(4)] for row in matrix]
        x, y, z, w = (nets.image(points, row) for row in rows)
        largest = [nets.top([jnp.abs(c[a]) for c in nets.entries(points)]) for a in range(control.shape[2])]
        largest = largest if rational else [*largest, 1.0]
        *own, w_size = (nets.total([jnp.abs(m) * c for m, c in zip(row, largest, strict=True)]) for row in rows)
        sizes = [size + extent * w_size for size, extent in zip(own, half, strict=True)]
        eps = float(jnp.finfo(control.dtype).eps)
        inside = []
        for net, extent, size in zip((x, y, z), half, sizes, strict=True):
            pairs = [(a, extent * b) for a, b in zip(nets.entries(net), nets.entries(w), strict=True)]
            error = _ROUNDING * eps * size
            inside += [nets.top([b + a for a, b in pairs]) + error, nets.top([b - a for a, b in pairs]) + error]
        visible = nets.bottom(inside) >= 0
        weight = nets.bottom([c[3] for c in nets.entries(points)]) if rational else jnp.ones_like(largest[0])
        count = 2 if depth_tolerance is None else 3
        floor = projection.near_w * weight
        return Screen([x, y, z][:count], w, half[:count], floor, sizes[:count], w_size, eps, visible)


class Piece(NamedTuple):
    """A patch or a tile of it, and the part of the picture that it can reach."""

    rows: list[Net]
    w: Net
    inverse: list[Lanes]  # 1/W of the coefficients, from above
    widest: Lanes  # the largest of them
    ends: list[tuple[Lanes, Lanes]]  # of the part of the picture, for every row
    scale: float  # second derivatives of the patch are these times those of the tile

    @staticmethod
    def of(screen: Screen, rows: list[Net], w: Net, tiles: int) -> Piece:
        """Where W may lie below the floor, the floor stands for it, and all of the picture is reached."""
        error = _ROUNDING * screen.eps
        w_blur = error * screen.w_size
        safe = [c - w_blur for c in nets.entries(w)]
        deep = nets.bottom(safe) >= screen.floor
        inverse = [1.0 / jax.lax.select(deep, c, screen.floor) for c in safe]
        ends = []
        for net, half, size in zip(rows, screen.half, screen.sizes, strict=True):
            limit = jnp.broadcast_to(half, deep.shape)
            blur = error * size
            places = [(c, i) for c, i in zip(nets.entries(net), inverse, strict=True)]
            low = jax.lax.select(deep, nets.bottom([(c - blur) * i for c, i in places]), -limit)
            high = jax.lax.select(deep, nets.top([(c + blur) * i for c, i in places]), limit)
            ends.append((_clip(low, limit), _clip(high, limit)))
        return Piece(rows, w, inverse, nets.top(inverse), ends, float(tiles**2))


class Remainder(NamedTuple):
    """Bounds of the higher derivatives of g_s over a patch."""

    along_u: Lanes  # |g_uuu| e_u^3 + 3 |g_uuv| e_u^2 e_v
    along_v: Lanes  # |g_vvv| e_v^3 + 3 |g_uvv| e_u e_v^2
    fourth: Lanes  # over 288


def _remainder(row: Net, w: Net, ends: tuple[Lanes, Lanes], extent: Extent) -> Remainder:
    """The fourth derivatives are differences of the third, times a degree: bounded by twice as much."""
    tops = []
    for i, j, times in _THIRD:
        own, depth = (nets.entries(nets.derivative(net, i, j)) for net in (row, w))
        shifted = [jnp.abs(_shifted(x, s, y)) for s in ends for x, y in zip(own, depth, strict=True)]
        scale = times * extent[0] ** i * extent[1] ** j
        tops.append(scale * nets.top(shifted) if shifted else jnp.zeros_like(ends[0]))
    (uuu, uuv, uvv, vvv), du, dv = tops, len(row) - 1, len(row[0]) - 1
    by_u = max(du - 3, 0) * extent[0] * uuu + (4 * (du - 2) * extent[0] / 3 + (dv - 1) * extent[1]) * uuv
    by_v = max(dv - 3, 0) * extent[1] * vvv + (4 * (dv - 2) * extent[1] / 3 + (du - 1) * extent[0]) * uvv
    return Remainder(uuu + uuv, vvv + uvv, (by_u + by_v) / 144.0)


def _least_square(screen: Screen, whole: Piece, extent: Extent) -> Lanes:
    """The square of what n is at least by the second derivatives at the corners: remainders are taken there.

    Any number >= 1 would do for the proof; one just below n loses least.
    """
    across, last = len(screen.w[0]), len(whole.inverse) - 1
    corners = ((0, 0, 0), (0, -1, across - 1), (-1, 0, last - across + 1), (-1, -1, last))
    square = jnp.ones_like(whole.widest)
    depth = _plain_hessian(screen.w, extent)
    for row in screen.rows:
        own = _plain_hessian(row, extent)
        for i, j, k in corners:
            inverse = whole.inverse[k]
            s = row[i][j] * inverse
            value = [None if not x else x[i][j] - s * y[i][j] for x, y in zip(own, depth, strict=True)]
            square = larger(square, _of_half_cell(*value) * inverse / 8.0)
    return square


def _square(
    screen: Screen,
    piece: Piece,
    remainders: list[Remainder],
    w_bend: Lanes,
    extent: Extent,
    inverse: Lanes,
    any_triangle: bool,
) -> Lanes:
    """n^2 at which the bound for the points of a tile is 1, if 1/n is at most ``inverse``."""
    depth = _hessian(piece.w, extent)
    degree = len(piece.w) + len(piece.w[0]) - 2
    rounding = 2.0 * _ROUNDING * screen.eps * (degree**2 / 8.0 + degree**3 / 24.0 + degree**4 / 72.0)
    measure = _of_any_triangle if any_triangle else _of_half_cell
    squares = []
    for row, ends, remainder, size in zip(piece.rows, piece.ends, remainders, screen.sizes, strict=True):
        hessian = _hessian(row, extent)
        values = [
            measure(*map(_shifted, own, (s, s, s), other)) * i
            for s in ends
            for own, other, i in zip(hessian, depth, piece.inverse, strict=True)
        ]
        largest = nets.top(values) * piece.scale
        more, less = larger(remainder.along_u, remainder.along_v), smaller(remainder.along_u, remainder.along_v)
        if any_triangle:
            third = (more + less) / 48.0
        else:
            third = _CUBIC * more + less / 288.0
            largest = larger(largest, more * piece.widest * inverse)
        rest = (third + remainder.fourth * inverse) * inverse + w_bend / 8.0 + rounding * size
        squares.append(largest / 8.0 + rest * piece.widest)
    return nets.top(squares)


def _last_visible(screen: Screen, piece: Piece, bends: list[Lanes]) -> Lanes:
    """n^2 beyond which no triangle of a tile is visible; infinite if there is none.

    A drawn point differs from the exact one by at most bend/(8 n^2) in every row, so it is outside of a plane that all
    coefficients of the tile are further outside of.
    """
    error = _ROUNDING * screen.eps
    *row_bends, w_bend = bends
    planes = [(screen.floor - error * screen.w_size - nets.top(nets.entries(piece.w)), w_bend)]
    for net, half, size, bend in zip(piece.rows[:2], screen.half[:2], screen.sizes[:2], row_bends, strict=True):
        pairs = [(a, half * b) for a, b in zip(nets.entries(net), nets.entries(piece.w), strict=True)]
        for reach in (nets.top([b + a for a, b in pairs]), nets.top([b - a for a, b in pairs])):
            planes.append((-reach - error * size, bend + half * w_bend))
    last = jnp.full_like(screen.w_size, jnp.inf)
    for outside, bend in planes:
        away = outside > 0
        square = bend / (8.0 * jax.lax.select(away, outside, jnp.ones_like(outside)))
        last = smaller(last, jax.lax.select(away, square, jnp.full_like(square, jnp.inf)))
    return last


def _largest_sum(net: Net, extent: Extent) -> Lanes:
    """At least the largest |uu| + 2 |uv| + |vv|, each over its own coefficients."""
    tops = [
        nets.top([jnp.abs(c) for c in nets.entries(part)]) if part else None for part in _plain_hessian(net, extent)
    ]
    return _sum_of((tops[0], tops[1], tops[2]))


def _of_half_cell(a: Any, b: Lanes, c: Any) -> Lanes:
    """8 times the largest error that a quadratic with this Hessian has on one of the triangles of a unit cell."""
    if a is None or c is None:
        return _sum_of((a, b, c))
    twice = jnp.abs(b + b)
    return larger(jnp.abs(a + c) + twice, larger(jnp.abs(a), jnp.abs(c)))


def _of_any_triangle(a: Any, b: Lanes, c: Any) -> Lanes:
    """The same, or a little more, for any triangle in the cell: largest |a x^2 + 2 b x y + c y^2|, |x|, |y| <= 1."""
    if a is None or c is None:
        return _sum_of((a, b, c))
    b = jnp.abs(b)
    zero, p, q = jnp.zeros_like(b), jnp.abs(a), jnp.abs(c)
    saddle = b + larger(p + larger(b - q, zero), q + larger(b - p, zero))
    return jax.lax.select((a > 0) == (c > 0), p + q + 2.0 * b, saddle)


def _sum_of(hessian: tuple[Any, Lanes, Any]) -> Lanes:
    a, b, c = hessian
    return nets.total([jnp.abs(b + b), *(jnp.abs(x) for x in (a, c) if x is not None)])


def _shifted(x: Any, s: Lanes, w: Any) -> Any:
    return None if x is None else x - s * w


def _plain_hessian(net: Net, extent: Extent) -> list[Net]:
    """uu, uv, vv times the extents, each of its own degree; empty for one that is identically 0."""
    return [
        nets.scaled(nets.derivative(net, i, j), extent[0] ** i * extent[1] ** j) for i, j in ((2, 0), (1, 1), (0, 2))
    ]


def _hessian(net: Net, extent: Extent) -> list[tuple[Any, Lanes, Any]]:
    """(uu, uv, vv) times the extents, coefficients of the net's own degrees; None for one that is identically 0."""
    columns = []
    for part in _plain_hessian(net, extent):
        raised = (
            nets.transposed(nets.raised(nets.transposed(nets.raised(part, len(net) - 1)), len(net[0]) - 1))
            if part
            else []
        )
        columns.append(nets.entries(raised) or [None] * (len(net) * len(net[0])))
    return list(zip(*columns, strict=True))


def _clip(value: Lanes, limit: Lanes) -> Lanes:
    return larger(smaller(value, limit), -limit)
