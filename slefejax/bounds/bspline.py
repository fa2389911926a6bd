"""Slefes of uniform B-splines, with the same number of segments in every knot interval.

A spline of degree d with control points c_0 ... c_(n-1) and uniform knots lives on n - d knot intervals. Its second
derivative (a knot interval has length 1) is sum_q D_q N_q, with D_q = c_q - 2 c_(q+1) + c_(q+2) and N_q the uniform
B-spline of degree d - 2 over the intervals q-d+2 ... q. So the spline is a line plus sum_q D_q a_q with convex a_q,
a_q'' = N_q, which are straight outside of those intervals. As in ``slefejax.bounds.slefe_tables``, interpolation at the
breakpoints bounds a_q from above, and the lexicographically optimal gaps below it bound it from below. Hence, at
every breakpoint b,

    upper(b) = p(b) + sum_q max(0, -D_q) gap_q(b),    lower(b) = p(b) - sum_q max(0, D_q) gap_q(b),

with at most d terms. Where the domain cuts off a part of the intervals of N_q the gaps are those of what is left.
"""

from __future__ import annotations

from fractions import Fraction
from functools import lru_cache
from itertools import pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from slefejax.arguments import Numbers, Segments, check_axis, check_segments, floating, is_whole, segment_pair
from slefejax.bounds.slefe import Slefe, rounding
from slefejax.bounds.slefe_tables import OUTWARD, bend_gaps
from slefejax.errors import InputError
from slefejax.geometry.bezier import second_differences


def bspline_slefe(coefficients: Numbers, degree: Any, segments: Any, axis: int = -1) -> Slefe:
    """The slefe of uniform B-splines of degree >= 1.

    coefficients : n >= degree + 1 control points along ``axis``; other axes are carried along
    segments     : number m of equal pieces of every knot interval
    returns      : ``.lower`` and ``.upper`` with (n - degree) m + 1 breakpoint values along ``axis``

    The curve begins and ends inside of its control polygon (no repeated knots); repeat the first ``degree`` points at
    the end for a closed one. Bounds are rounded outwards. Raises InputError for a degree below 1, too few control
    points or segments < 1.

    >>> hat = bspline_slefe(np.array([0.0, 0.0, 1.0, 0.0, 0.0]), degree=2, segments=1)
    >>> hat.upper.round(3).tolist(), hat.lower.round(3).tolist()
    ([0.0, 0.75, 0.75, 0.0], [-0.125, 0.375, 0.375, -0.125])
    """
    check_segments(segments)
    if not is_whole(degree, 1):
        raise InputError(f"the degree of a spline must be a whole number of at least 1, not {degree!r}")
    coefficients = floating(coefficients)
    if coefficients.ndim == 0 or coefficients.shape[check_axis(axis, coefficients.ndim)] < degree + 1:
        raise InputError(f"a spline of degree {degree} needs at least {degree + 1} control points along its axis")
    lower, upper = _spline_jit(coefficients, int(degree), int(segments), axis)
    return Slefe(lower, upper)


def bspline_slefe_boxes(net: Numbers, degree: Any, segments: Segments) -> Slefe:
    """Slefe boxes of a uniform tensor-product B-spline: bounds in v, then lower of lower and upper of upper in u.

    net      : control net ``(nu, nv, ...)``;  degree : of both parameters
    segments : per knot interval, m or (m_u, m_v)
    returns  : ``.lower`` and ``.upper``, ``((nu-degree) m_u + 1, (nv-degree) m_v + 1, ...)``

    Raises InputError as ``bspline_slefe`` does.

    >>> control = np.zeros((5, 6, 3))
    >>> bspline_slefe_boxes(control, 3, 2).upper.shape
    (5, 7, 3)
    """
    m_u, m_v = segment_pair(segments)
    across = bspline_slefe(net, degree, m_v, axis=1)
    lower = bspline_slefe(across.lower, degree, m_u, axis=0).lower
    return Slefe(lower, bspline_slefe(across.upper, degree, m_u, axis=0).upper)


@lru_cache(maxsize=64)
def basis_pieces(degree: int) -> tuple[tuple[Fraction, ...], ...]:
    """Exact Bézier coefficients of the uniform B-spline of that degree on its degree + 1 knot intervals.

    By N_n' = N_(n-1)(t) - N_(n-1)(t - 1), starting from the box function.

    >>> [[str(c) for c in piece] for piece in basis_pieces(1)]
    [['0', '1'], ['1', '0']]
    """
    if degree == 0:
        return ((Fraction(1),),)
    lower = basis_pieces(degree - 1)
    zero = (Fraction(0),) * degree
    pieces, start = [], Fraction(0)
    for here, before in zip((*lower, zero), (zero, *lower), strict=True):
        piece = [start]
        for a, b in zip(here, before, strict=True):
            piece.append(piece[-1] + (a - b) / degree)
        start = piece[-1]
        pieces.append(tuple(piece))
    return tuple(pieces)


@lru_cache(maxsize=64)
def _values(degree: int, segments: int) -> np.ndarray:
    """Weights ``(segments + 1, degree + 1)`` of c_i ... c_(i+d) for the values at the breakpoints of interval i."""
    rows = []
    for k in range(segments + 1):
        t = Fraction(k, segments)
        rows.append([float(_casteljau(piece, t)) for piece in reversed(basis_pieces(degree))])
    return np.array(rows)


def _casteljau(piece: tuple[Fraction, ...], t: Fraction) -> Fraction:
    row = list(piece)
    while len(row) > 1:
        row = [(1 - t) * a + t * b for a, b in pairwise(row)]
    return row[0]


@lru_cache(maxsize=256)
def _gaps(degree: int, segments: int, first: int, last: int) -> np.ndarray:
    """Gaps ``(last - first + 1, segments + 1)`` of a bump of which the intervals first ... last lie in the domain."""
    bends = [[float(c) for c in piece] for piece in basis_pieces(degree - 2)[first : last + 1]]
    gaps = bend_gaps(degree, bends, segments)
    gaps = gaps + OUTWARD * gaps.max()
    return np.stack([gaps[i * segments : (i + 1) * segments + 1] for i in range(last - first + 1)])


@lru_cache(maxsize=64)
def _gap_table(degree: int, segments: int, intervals: int) -> np.ndarray:
    """``(bumps, degree - 1, segments + 1)``: gaps of every bump on each of its intervals, 0 outside of the domain."""
    table = np.zeros((intervals + degree - 2, degree - 1, segments + 1))
    for q in range(len(table)):
        first, last = max(0, degree - 2 - q), min(degree - 2, intervals - 1 + degree - 2 - q)
        table[q, first : last + 1] = _gaps(degree, segments, first, last)
    return table


@jax.jit(static_argnums=(1, 2, 3))
def _spline_jit(coefficients: Any, degree: int, segments: int, axis: int) -> tuple[Any, Any]:
    c = jnp.moveaxis(coefficients, axis, 0)
    intervals = c.shape[0] - degree
    weights = _values(degree, segments).astype(c.dtype)
    windows = [c[r : r + intervals] for r in range(degree + 1)]
    value = _breakpoints(sum(_outer(w, weights[:, r]) for r, w in enumerate(windows)))
    if degree == 1:
        lower, upper, gaps = value, value, 0.0
    else:
        bend = second_differences(c)
        table = _gap_table(degree, segments, intervals).astype(c.dtype)
        lower = value - _spread(jnp.maximum(bend, 0), table, intervals)
        upper = value + _spread(jnp.maximum(-bend, 0), table, intervals)
        gaps = float(table.sum(axis=1).max())
    # of d + 1 products and sums each: values of at most the largest coefficient, bends of at most four times that
    error = rounding(c, (degree + 4.0) * (1.0 + 4.0 * gaps))
    lower, upper = lower - error, upper + error
    return jnp.moveaxis(lower, 0, axis), jnp.moveaxis(upper, 0, axis)


def _outer(values: Any, weights: Any) -> Any:
    """``(intervals, breakpoints of an interval, ...)``: values along the first axis times weights along the second."""
    shape = (1, -1) + (1,) * (values.ndim - 1)
    return values[:, None] * weights.reshape(shape)


def _breakpoints(grid: Any) -> Any:
    """From ``(intervals, segments + 1, ...)`` to all breakpoints, each knot once."""
    flat = grid[:, :-1].reshape(grid.shape[0] * (grid.shape[1] - 1), *grid.shape[2:])  # -1 fails on nothing
    return jnp.concatenate([flat, grid[-1:, -1]])


def _spread(bend: Any, table: np.ndarray, intervals: int) -> Any:
    """sum_q bend_q gap_q at all breakpoints."""
    pieces = table.shape[1]
    total = 0
    for r in range(pieces):
        gaps = table[r : r + intervals, pieces - 1 - r]
        total = total + bend[r : r + intervals, None] * gaps.reshape(*gaps.shape, *(1,) * (bend.ndim - 1))
    # at an inner knot the bump that ends there counts too; the one that begins there is in the sum already
    ending = bend[: intervals - 1] * table[: intervals - 1, -1, -1].reshape(-1, *(1,) * (bend.ndim - 1))
    return _breakpoints(jnp.asarray(total).at[1:, 0].add(ending))
