"""How far linear interpolation is from the twist terms of Gregory patches (docs/certified.md, 10).

Near its corner a term is b z = C P(s, t) w(s, t), with P = (1-s)^2 (1-t)^2 and

    w = s t (s - t)/(2 (s + t)),      s and t from 0 at the corner; C = 9 of quads, 12 of triangles,

where s and t are u and v, or of pinched triangles u and (1-u) v. w is homogeneous of degree 2: with y = t/(s+t)

    w_ss = 2 y^3,   w_st = 1/2 - 3 y^2 + 2 y^3,   w_tt = -2 (1-y)^3,   D3 w[x, z]^3 = -6 (y x - (1-y) z)^3/(s+t).
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from slefejax.geometry.bezier import elevate, tile_matrices
from slefejax.geometry.gregory import QUAD_TWISTS
from slefejax.lanes.maxima import larger, smaller
from slefejax.lanes.nets import Lanes

# Bézier coefficients of polynomials that are nowhere below n^2 |b z - I b z| on n x n grids of any n, cut along either
# diagonal: for the slot at (0, 0). Found by linear programming, and a fiftieth larger, for lines that are not quite
# even; a test looks for more by sampling
_OF_QUAD = (
    (3.45, 0.984, 0.959, 0.182),
    (0.984, 0.0, 0.0, 0.0748),
    (0.959, 0.0, 0.0, 0.0),
    (0.182, 0.0748, 0.0, 0.0003),
)
_OF_TRIANGLE = (
    (4.61, 2.533, 1.706, 0.869, 0.234),
    (0.0, 0.0, 0.0, 0.0, 0.0163),
    (1.277, 0.0, 0.0, 0.0, 0.0),
    (0.0, 0.0, 0.297, 0.0272, 0.0246),
    (0.0117, 0.038, 0.0, 0.0004, 0.0087),
)
# (sup |uu| + 2 sup |uv| + sup |vv|)/8 of b z: 45/8 and 60/8
_OF_ANY = (5.65, 7.55)
# Of quadratic interpolation on a triangle in the unit square: for a third derivative of size 1, for a second one, and
# of w itself in a box at the corner, over the box' sides; on the quarters of both halves of a cell, on any triangle
VARYING = 0.0208
_BENT = 0.1053
_AT_CORNER = {True: 0.0211, False: 0.0535}


@cache
def even_errors(slots: int, degree: int) -> Float[np.ndarray, "slots n n"]:
    """Bézier coefficients of what terms err at most on n x n grids, times n^2; slot by slot, of the degree asked for.

    >>> even_errors(4, 3).shape, float(even_errors(4, 3)[2, 3, 3])
    ((4, 4, 4), 3.45)
    """
    quad = _raised(np.array(_OF_QUAD), degree)
    found = [quad, quad[::-1], quad[::-1, ::-1], quad[:, ::-1]]
    if slots > QUAD_TWISTS:
        found += [np.array(_OF_TRIANGLE), np.array(_OF_TRIANGLE)[:, ::-1]]
    return np.stack(found)


@cache
def any_errors(slots: int) -> Float[np.ndarray, "slots"]:
    """What terms err at most on any triangle in a box of sides 1/n, times n^2.

    >>> any_errors(4).tolist()
    [5.65, 5.65, 5.65, 5.65]
    """
    return np.repeat(_OF_ANY, [QUAD_TWISTS, slots - QUAD_TWISTS])


@cache
def spreads(slots: int, degree: int) -> Float[np.ndarray, "slots n n"]:
    """Bézier coefficients of b/2: terms lie between these times -1 and 1.

    >>> spreads(4, 3)[0].tolist()[1]
    [0.0, 0.5, 0.0, 0.0]
    """
    quad = _raised(0.5 * np.outer(np.eye(4)[1], np.eye(4)[1]), degree)
    found = [quad, quad[::-1], quad[::-1, ::-1], quad[:, ::-1]]
    if slots > QUAD_TWISTS:
        # 12 a^2 b c = 4 u (1-u)^3 3 v (1-v)^2
        own = _raised(0.5 * np.outer(np.eye(5)[1], np.eye(4)[1]), 4)
        found += [own, own[:, ::-1]]
    return np.stack(found)


class OnTiles(NamedTuple):
    """Of all terms, tile by tile."""

    spread: Any  # (tiles^2, slots): how far they lie from 0
    errors: Any  # (tiles^2, slots, n, n): coefficients of ``even_errors``


@cache
def on_tiles(slots: int, degree: int, tiles: int) -> OnTiles:
    """Of the tiles of a patch, in the order of ``tile_matrices``.

    >>> on_tiles(4, 3, 2).spread[0].round(3).tolist()
    [0.125, 0.094, 0.07, 0.094]
    """
    matrices = tile_matrices(degree + 1, degree + 1, tiles)

    def restricted(tables: np.ndarray) -> np.ndarray:
        return np.einsum("tia,tjb,sab->tsij", *matrices, tables)

    spread = restricted(spreads(slots, degree)).max(axis=(2, 3))
    return OnTiles(spread, restricted(even_errors(slots, degree)))


def _raised(net: Float[np.ndarray, "m n"], degree: int) -> Float[np.ndarray, "k k"]:
    return elevate(elevate(net, degree).T, degree).T


class OnBox(NamedTuple):
    """Of one term over a box of the domain."""

    swing: Lanes  # how far its values are at most from that in the box' middle
    rest: Lanes  # how far it is at most from quadratics that have its values at corners and in middles of sides


def on_box(slots: int, low: list[Lanes], high: list[Lanes], cell: bool) -> list[OnBox]:
    """Of every term, where a box reaches from low (u, v) to high; ``cell``: on quarters of both halves of it, else on
    any triangle in it.

    >>> box = [jnp.array(0.0)] * 2, [jnp.array(0.25)] * 2
    >>> [round(float(term.rest), 4) for term in on_box(4, *box, True)]
    [0.0418, 0.0062, 0.0021, 0.0062]
    """
    u, v = ((a, b) for a, b in zip(low, high, strict=True))
    back_u, back_v = ((1.0 - b, 1.0 - a) for a, b in (u, v))
    found = [_of_quad(s, t, cell) for s, t in ((u, v), (v, back_u), (back_u, back_v), (back_v, u))]
    if slots > QUAD_TWISTS:
        found += [_of_triangle(u, own, cell) for own in (v, back_v)]
    return found


Range = tuple[Lanes, Lanes]


def _of_quad(s: Range, t: Range, cell: bool) -> OnBox:
    sizes = s[1] - s[0], t[1] - t[0]
    return _of_product(9.0, s, t, s, t, sizes[1], jnp.zeros_like(s[0]), cell)


def _of_triangle(u: Range, v: Range, cell: bool) -> OnBox:
    """With t = (1-u) v: along (x, z) it changes by at most v |x| + (1-u) |z|, and is bent by 2 |x z|."""
    t = (1.0 - u[1]) * v[0], (1.0 - u[0]) * v[1]
    sizes = u[1] - u[0], v[1] - v[0]
    change = v[1] * sizes[0] + (1.0 - u[0]) * sizes[1]
    return _of_product(12.0, u, v, u, t, change, 2.0 * sizes[0] * sizes[1], cell)


def _of_product(
    constant: float, u: Range, v: Range, s: Range, t: Range, along_t: Lanes, bent: Lanes, cell: bool
) -> OnBox:
    """Of C P(u, v) w(s, t), where t changes by ``along_t`` along the box, and is bent by ``bent``."""
    x, z, a, b = u[1] - u[0], v[1] - v[0], 1.0 - u[0], 1.0 - v[0]
    # P and what its first, second, third derivatives make along the box
    p, p_1 = (a * b) ** 2, 2.0 * a * b * (b * x + a * z)
    p_2, p_3 = 2.0 * (b * x) ** 2 + 8.0 * a * b * x * z + 2.0 * (a * z) ** 2, 12.0 * x * z * (b * x + a * z)
    lowest, highest = _share(s[1], t[0], 0.0), _share(s[0], t[1], 1.0)  # of y
    rest = 1.0 - lowest
    w, w_1 = 0.5 * s[1] * t[1], 0.5 * (t[1] * x + s[1] * along_t)
    w_2 = 2.0 * highest**3 * x * x + x * along_t + 2.0 * rest**3 * along_t**2 + 0.5 * s[1] * bent
    turned = smaller(larger(x, along_t), highest * x + rest * along_t)
    w_3, more = 6.0 * turned**3, 3.0 * bent * (0.5 * x + 2.0 * rest**3 * along_t)
    near = s[0] + t[0]
    away = near > 0
    by_third = jnp.where(away, w_3 / jnp.where(away, near, 1.0), jnp.inf)
    third, second = VARYING * (0.125 if cell else 1.0), _BENT * (0.25 if cell else 1.0)
    changing = _changing(lowest, highest, x, along_t) if constant == 9.0 else w_2
    of_w = smaller(third * (by_third + more), second * changing)
    of_w = jnp.where((u[0] <= 0) & (v[0] <= 0), smaller(of_w, _AT_CORNER[cell] * x * z), of_w)
    # P differs from its largest value by at most 2 (u + v), and u + v is at most 2 (s + t)
    last = smaller((2.0 if constant == 9.0 else 4.0) * w_3, p_1 * by_third) + p_1 * more
    products = 3.0 * p_1 * w_2 + 3.0 * p_2 * w_1 + p_3 * w + last
    return OnBox(0.5 * constant * (p * w_1 + p_1 * w), constant * (p * of_w + third * products))


def _share(s: Lanes, t: Lanes, otherwise: float) -> Lanes:
    both = s + t
    return jnp.where(both > 0, t / jnp.where(both > 0, both, 1.0), otherwise)


def _changing(low: Lanes, high: Lanes, x: Lanes, z: Lanes) -> Lanes:
    """Half of how far second derivatives of w range, along the box."""
    mixed = lambda y: 0.5 - 3.0 * y * y + 2.0 * y**3  # noqa: E731
    last = (1.0 - low) ** 3 - (1.0 - high) ** 3
    return (high**3 - low**3) * x * x + (mixed(low) - mixed(high)) * x * z + last * z * z
