"""How far linear interpolation is from the slopes of twist terms, of which normals are made (docs/certified.md, 11).

Near its corner a slope, b z by u or by v, is homogeneous of degree 1: continuous, with bounded derivatives that jump at
the corner and second ones as large as one over the distance from it. With w, P, C and y of ``bounds.twists``, along
(x, z) and with q = y x - (1-y) z

    D2 w_s = -6 y q^2/(s+t),    D3 w_s = 6 q^2 (q + 3 (x+z) y)/(s+t)^2,    w_t(s, t) = -w_s(t, s).

Where a pinched triangle's point is, slopes by v have the factor 1 - u; it is taken off, as normals have it.
"""

from __future__ import annotations

from functools import cache, reduce
from math import comb
from operator import add
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.ndimage import maximum_filter

from slefejax.geometry.gregory import QUAD_TWISTS
from slefejax.geometry.normals import array_module
from slefejax.lanes.maxima import larger, smaller

# n times what slopes err at most on n x n grids of any n, cut along either diagonal, of quads and of triangles: found
# by sampling, a fiftieth larger, for lines that are not quite even; a test looks for more
_EVEN = (3.54, 4.72)
_BOXES = 64  # along each side of a patch, on which second derivatives are bounded
COARSEST = (1, 2, 4, 8, 16)  # cells a side from which on slopes are known on tiles, widened by one of them
_TELLING = 8.0  # cells a side of which second order has to tell more than first order does
_UNBOUNDED = 1e15
# Of quadratic interpolation on a triangle in the unit square, for a first, a second and a third derivative of size 1:
# sums of sizes of Lagrange polynomials times d, d^2/2 and d^3/6, with d the larger of the distances along u and v
_MISSED = (0.57, 0.137, 0.0284)
# Of slopes of quads and of triangles in a box at the corner, over its longer side, found as the above: on the quarters
# of both halves of a cell, on any triangle
_AT_CORNER = {True: (0.473, 0.644), False: (0.945, 1.286)}

Sizes = tuple[Any, Any, Any, Any]
"""Of a function on a box: at least how large it and its first, second and third derivative along the box are."""
Range = tuple[Any, Any]
CORNERS = ((0, 0), (1, 0), (1, 1), (0, 1), (0, 0), (0, 1))  # of slots


class TileSlopes(NamedTuple):
    """Of slopes by u and by v, tile by tile; on cells, or in boxes, of sides 1/n, n at least each of ``COARSEST``.

    size   : how large they are at most, at places in the tile
    first  : n times what they err at most, or 0 where the next one says more
    second : n^2 times that, or 0
    steep  : how much they change at most, along u and along v together, where both change by 1
    """

    size: Float[np.ndarray, "tiles slots 2"]
    first: Float[np.ndarray, "tiles coarsest slots 2"]
    second: Float[np.ndarray, "tiles coarsest slots 2"]
    steep: Float[np.ndarray, "tiles coarsest slots 2"]


@cache
def on_tiles(slots: int, tiles: int, even: bool) -> TileSlopes:
    """Of the tiles of a patch, in the order of ``tile_matrices``.

    even : on cells of even grids; else for any triangle in boxes of sides up to 1/n

    A cell reaches out of the tile of a place by no more than its side. Second order where the slot's corner is beyond
    that, and where it tells more.

    >>> on_tiles(4, 2, True).first[:, 3, 0].tolist()
    [[3.54, 3.54], [0.0, 0.0], [0.0, 0.0], [0.0, 0.0]]
    """
    per = -(-_BOXES // tiles)
    m = tiles * per
    edges = np.arange(m + 1) / m
    u, v = (edges[:-1, None], edges[1:, None]), (edges[None, :-1], edges[None, 1:])
    found = np.broadcast_arrays(*(x for own in slope_sizes(slots, u, v, 1.0, 1.0) for pair in own for x in pair[:3]))
    sizes = np.stack(found).reshape(slots, 2, 3, m, m)
    # the box that a cell may begin in, too
    around = np.stack([_widened(sizes[:, :, 1:], -(-m // coarsest)) for coarsest in COARSEST])
    steep, bent = np.moveaxis(_by_tile(around, tiles), 3, 0)
    second, first = bent / 8.0, _first(slots, sizes[:, :, 1], even)[..., None, None]
    near = second > _TELLING * first
    size = _by_tile(sizes[:, :, 0], tiles)
    every = size, np.where(near, first, 0.0), np.where(near, 0.0, second), steep
    return TileSlopes(*(np.moveaxis(own.reshape(*own.shape[:-2], tiles * tiles), -1, 0) for own in every))


def _first(slots: int, along: np.ndarray, even: bool) -> Float[np.ndarray, "slots 2"]:
    """By sampling; of any triangles half of what slopes change at most."""
    if even:
        return np.repeat(_EVEN, [QUAD_TWISTS, slots - QUAD_TWISTS])[:, None] * np.ones(2)
    return 0.5 * along.max(axis=(2, 3))


def _widened(values: np.ndarray, by: int) -> np.ndarray:
    """The largest of all boxes that are up to so many boxes away."""
    return maximum_filter(values, size=2 * by + 1, axes=(-2, -1), mode="nearest")


def _by_tile(values: np.ndarray, tiles: int) -> np.ndarray:
    per = values.shape[-1] // tiles
    return values.reshape(*values.shape[:-2], tiles, per, tiles, per).max(axis=(-3, -1))


def slope_sizes(slots: int, u: Range, v: Range, x: Any, z: Any, flat: bool = False) -> list[tuple[Sizes, Sizes]]:
    """Of every slot, of its slope by u and that by v, where u and v range so, along steps up to x and z.

    Second and third derivatives are large numbers, and no bounds, where the range has the slot's corner.

    flat : there second ones times the larger of s/x and t/z

    >>> [round(float(own), 3) for own in slope_sizes(4, (0.5, 0.75), (0.5, 0.5), 0.25, 0.25)[0][0]]
    [0.562, 1.371, 2.873, 5.389]
    """
    back_u, back_v = ((1.0 - b, 1.0 - a) for a, b in (u, v))
    one, two, three, four = (
        _of_quad(s, t, *steps, flat)
        for s, t, steps in ((u, v, (x, z)), (v, back_u, (z, x)), (back_u, back_v, (x, z)), (back_v, u, (z, x)))
    )
    # of every other corner s is v
    found = [one, (two[1], two[0]), three, (four[1], four[0])]
    if slots > QUAD_TWISTS:
        found += [_of_triangle(u, own, x, z, flat) for own in (v, back_v)]
    return found


class Slope(NamedTuple):
    """Of slopes on a box of the domain, or of what they are multiplied with.

    sizes : along the box
    rest  : how far they are at most from quadratics that have their values at corners and in middles of sides
    flat  : at least their second derivatives times G - G(corner), where G changes by 1 along the box
    """

    sizes: Sizes
    rest: Any
    flat: Any

    @staticmethod
    def total(slopes: list[Slope], weights: Any) -> Slope:
        """Of a weighted sum."""
        weighted = [jax.tree.map(lambda own, k=k: k * own, slope) for slope, k in zip(slopes, weights, strict=True)]
        return jax.tree.map(lambda *own: reduce(add, own), *weighted)

    def rest_with(self, other: Sizes, cell: bool) -> Any:
        """``rest`` of products with polynomials."""
        (zero, once, _, _), (_, first, second, _) = self.sizes, other
        bent = first * self.flat + 2.0 * first * once + second * zero
        own = self.rest * other[0] + _missed(cell)[1] * bent
        return least_missed(product(self.sizes, other), cell, own)


def on_box(slots: int, low: Any, high: Any, cell: bool) -> list[tuple[Slope, Slope]]:
    """Of every slot, of its slope by u and that by v, where a box reaches from low (u, v) to high.

    cell : on quarters of both halves of it, else on any triangle in it

    >>> box = [jnp.array(0.0)] * 2, [jnp.array(0.25)] * 2
    >>> [round(float(by_u.rest), 3) for by_u, _ in on_box(4, *box, True)]
    [0.118, 0.032, 0.011, 0.041]
    """
    u, v = zip(low, high, strict=True)
    x, z = u[1] - u[0], v[1] - v[0]
    every, flats = (slope_sizes(slots, u, v, x, z, flat) for flat in (False, True))
    ends = (u[0] <= 0, u[1] >= 1), (v[0] <= 0, v[1] >= 1)
    found = []
    for slot, (pair, flat) in enumerate(zip(every, flats, strict=True)):
        i, j = CORNERS[slot]
        reached = _AT_CORNER[cell][slot >= QUAD_TWISTS] * larger(x, z)
        at_corner = jnp.where(ends[0][i] & ends[1][j], reached, _UNBOUNDED)
        made = [Slope(own, least_missed(own, cell, at_corner), more[2]) for own, more in zip(pair, flat, strict=True)]
        found.append((made[0], made[1]))
    return found


def least_missed(sizes: Sizes, cell: bool, *known: Any) -> Any:
    """What is missed of a function by quadratics, as its derivatives of any order tell, or as is known otherwise."""
    orders = [c * size for c, size in zip(_missed(cell), sizes[1:], strict=True)]
    return reduce(smaller, [*orders, *known])


def _missed(cell: bool) -> list[float]:
    return [c * (0.5**m if cell else 1.0) for m, c in enumerate(_MISSED, 1)]


def _of_quad(s: Range, t: Range, x: Any, z: Any, flat: bool) -> tuple[Sizes, Sizes]:
    """By s and by t."""
    w, by_s, by_t = _turning(s, t, x, z, 0.0, flat)
    a, b = _rest(s, x), _rest(t, z)
    aa, bb = product(a, a), product(b, b)
    both = product(aa, bb)
    # P_s = -2 (1-s) (1-t)^2
    one = _sum(product(both, by_s), product(product(a, bb), w), 2.0)
    other = _sum(product(both, by_t), product(product(aa, b), w), 2.0)
    return _times(9.0, one), _times(9.0, other)


def _of_triangle(u: Range, v: Range, x: Any, z: Any, flat: bool) -> tuple[Sizes, Sizes]:
    """By u, and by v over 1 - u; t = (1-u) v."""
    t = (1.0 - u[1]) * v[0], (1.0 - u[0]) * v[1]
    w, by_s, by_t = _turning(u, t, x, v[1] * x + (1.0 - u[0]) * z, 2.0 * x * z, flat)
    a, b = _rest(u, x), _rest(v, z)
    aa, bb = product(a, a), product(b, b)
    both, nothing = product(aa, bb), 0.0 * (x + z)
    along = _sum(by_s, product((v[1], z, nothing, nothing), by_t))
    one = _sum(product(both, along), product(product(a, bb), w), 2.0)
    other = _sum(product(both, by_t), product(product(a, b), w), 2.0)
    return _times(12.0, one), _times(12.0, other)


def _turning(s: Range, t: Range, x: Any, z: Any, bent: Any, flat: bool) -> tuple[Sizes, Sizes, Sizes]:
    """Of w, w_s and w_t, where s changes by x, and t by z and is bent."""
    xp = array_module(*(value for value in (*s, *t, x, z) if not isinstance(value, float)))
    near = s[0] + t[0]
    away = near > 0
    over = xp.where(away, 1.0 / xp.where(away, near, 1.0), _UNBOUNDED)
    high = _share(xp, s[0], t[1], 1.0)
    rest = 1.0 - _share(xp, s[1], t[0], 0.0)
    turned = xp.minimum(xp.maximum(x, z), high * x + rest * z)
    square, far = turned * turned, 3.0 * (x + z)
    by_s_2, by_t_2 = 6.0 * high * square * over, 6.0 * rest * square * over
    if flat:
        # y/(s+t) times the larger of s/x and t/z is at most 1 over the smaller of x and z
        by_s_2, by_t_2 = (xp.where(away, own, 6.0 * square / xp.minimum(x, z)) for own in (by_s_2, by_t_2))
    w_2 = 2.0 * high**3 * x * x + x * z + 2.0 * rest**3 * z * z + 0.5 * s[1] * bent
    w_3 = 6.0 * turned * square * over + 3.0 * bent * (0.5 * x + 2.0 * rest**3 * z)
    w = 0.5 * s[1] * t[1], 0.5 * (t[1] * x + s[1] * z), w_2, w_3
    drawn = 18.0 * rest * turned * bent * over
    by_s = (
        0.5 * t[1],
        2.0 * high**3 * x + 0.5 * z,
        by_s_2 + 0.5 * bent,
        (6.0 * square * over) * ((turned + far * high) * over) + high * drawn,
    )
    by_t = (
        0.5 * s[1],
        0.5 * x + 2.0 * rest**3 * z,
        by_t_2 + 2.0 * rest**3 * bent,
        (6.0 * square * over) * ((turned + far * rest) * over) + rest * drawn,
    )
    return w, by_s, by_t


def _share(xp: Any, s: Any, t: Any, otherwise: float) -> Any:
    """t over s + t."""
    both = s + t
    return xp.where(both > 0, t / xp.where(both > 0, both, 1.0), otherwise)


def _rest(t: Range, change: Any) -> Sizes:
    """Of 1 - t."""
    return 1.0 - t[0], change, 0.0 * change, 0.0 * change


def product(one: Sizes, other: Sizes) -> Sizes:
    """Of a product: Leibniz' rule.

    >>> product((1.0, 2.0, 0.0, 0.0), (1.0, 2.0, 0.0, 0.0))
    (1.0, 4.0, 8.0, 0.0)
    """
    return _made(lambda m: sum(comb(m, i) * one[i] * other[m - i] for i in range(m + 1)))


def _sum(one: Sizes, other: Sizes, times: float = 1.0) -> Sizes:
    return _made(lambda m: one[m] + times * other[m])


def _times(constant: float, own: Sizes) -> Sizes:
    return _made(lambda m: constant * own[m])


def _made(order: Any) -> Sizes:
    return order(0), order(1), order(2), order(3)
