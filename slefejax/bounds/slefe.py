"""Slefes: tight piecewise-linear enclosures of polynomials and of tensor-product patches.

A polynomial of degree d in Bézier form is its chord plus a combination of d-1 fixed convex functions,
p = l + sum_j D_j a_j, with D_j = c_(j-1) - 2 c_j + c_(j+1) its second differences and a_j the polynomial
with end coefficients 0 whose own second differences are all 0 but the j-th, which is 1. Bounds of the
a_j by piecewise-linear functions over m equal segments, tabulated once, bound every polynomial of that
degree (docs/math.md, 2; [YBP12], (2); [YBP14], (4)).

What users get is rounded outwards: it encloses the polynomial with exactly the given coefficients, whatever the
precision (``outward``). The estimate of factors is no bound and does without.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slefejax.arguments import (
    Numbers,
    Patches,
    Segments,
    check_axis,
    check_patches,
    check_segments,
    floating,
    is_whole,
    segment_pair,
)
from slefejax.bounds.slefe_tables import build_table
from slefejax.errors import InputError
from slefejax.geometry.bezier import HIGHEST_DEGREE, second_differences
from slefejax.lanes import layout, loops, passes
from slefejax.lanes.maxima import EXACT, Exact, Maxima
from slefejax.lanes.tuning import TUNING

# Bounds in v that are b wider, or less, have second differences in u that are up to 2 b larger or smaller; with twice
# that added to their sizes the smooth bounds in u are nowhere narrower than exact ones of exact ones.
_SECOND = 4.0


class SlefeTable(NamedTuple):
    """Breakpoint values of the bounds of a_1 ... a_(d-1): row j-1 belongs to a_j, one column a breakpoint.

    >>> table = slefe_table(2, 1)
    >>> table.upper.tolist(), table.lower.round(6).tolist()
    ([[0.0, 0.0]], [[-0.25, -0.25]])
    """

    lower: Float[np.ndarray, "rows breakpoints"]
    upper: Float[np.ndarray, "rows breakpoints"]


class Slefe(NamedTuple):
    """Breakpoint values of a piecewise-linear enclosure, ``lower <= p <= upper`` between them too.

    >>> slefe([0.0, 1.0], 1).lower.tolist()
    [0.0, 1.0]
    """

    lower: Any
    upper: Any


def slefe_table(degree: Any, segments: Any) -> SlefeTable:
    """The table of degree ``degree`` with ``segments`` equal pieces, computed once and kept.

    Returns ``.lower`` and ``.upper``, each ``(degree-1, segments+1)`` float64, read-only; row j-1 holds the
    values of the bounds of a_j at the breakpoints 0, 1/segments, ..., 1 (docs/math.md, 2; Table 1 of [YBP12]
    is degree 3 with 3 segments).

    The upper bound of the convex a_j is its own chord interpolant. The lower bound makes the largest gap
    over the breakpoints as small as possible, then the next largest, and so on. Both are rounded outwards:
    the upper to the next float64, the lower by 2**-48 of the largest value of |a_j|, which covers all rounding
    of its computation. Row d-j is row j reversed, bit for bit.

    Raises InputError for a degree below 2 or above 64, or fewer than one segment.

    >>> slefe_table(3, 3).lower.round(6)
    array([[-0.069521, -0.439892, -0.315352, -0.008733],
           [-0.008733, -0.315352, -0.439892, -0.069521]])
    """
    check_segments(segments)
    if not is_whole(degree, 2) or degree > HIGHEST_DEGREE:
        raise InputError(
            f"a slefe table needs a whole degree from 2 to {HIGHEST_DEGREE}, not {degree!r} (lines are their own bound)"
        )
    return _table(int(degree), int(segments))


@lru_cache(maxsize=256)
def _table(degree: int, segments: int) -> SlefeTable:
    lower, upper = build_table(degree, segments)
    lower.flags.writeable = upper.flags.writeable = False
    return SlefeTable(lower, upper)


def slefe(coefficients: Numbers, segments: Any, axis: int = -1) -> Slefe:
    """The slefe of polynomials of any degree >= 1 (docs/math.md, 2; [YBP12], (2)).

    coefficients : Bézier coefficients, degree + 1 of them along ``axis``; other axes are carried along
    segments     : number m of equal pieces
    returns      : ``.lower`` and ``.upper`` in the dtype of the coefficients, with m+1 breakpoint values along ``axis``

    Between the breakpoints the bounds are the linear interpolants. Bounds are rounded outwards, by some units in the
    last place of the largest coefficient; but for that a polynomial of degree 1 is its own slefe.
    Raises InputError for fewer than two coefficients or fewer than one segment.

    >>> enclosure = slefe(np.array([0.0, 0.0, 1.0]), segments=1)
    >>> enclosure.upper.round(3).tolist(), enclosure.lower.round(3).tolist()
    ([0.0, 1.0], [-0.25, 0.75])
    """
    check_segments(segments)
    coefficients = floating(coefficients)
    if coefficients.ndim == 0 or coefficients.shape[check_axis(axis, coefficients.ndim)] < 2:
        raise InputError("a slefe needs at least two coefficients along its axis (degree 1 or more)")
    lower, upper = _slefe_jit(coefficients, int(segments), axis)
    return Slefe(lower, upper)


def slefe_boxes(patches: Patches, segments: Segments) -> Slefe:
    """Slefe boxes of tensor-product patches of any bi-degree ([YBP12], (6); [YBP14], (5)).

    patches  : control points ``(patches, du+1, dv+1, dim)``, u before v; every coordinate by itself
    segments : m, or (m_u, m_v)
    returns  : ``.lower`` and ``.upper``, ``(patches, m_u+1, m_v+1, dim)``, in the dtype of the control points

    The bilinear interpolants of the four corners of a tile enclose the patch on that tile: bounds in v first, and
    their bounds in u then ([YBP12], appendix). Rounded outwards, as ``slefe``. Raises InputError for a wrong
    shape or segments < 1.

    >>> flat = np.zeros((5, 4, 4, 3))
    >>> slefe_boxes(flat, 3).upper.shape
    (5, 4, 4, 3)
    """
    patches = check_patches(patches, dims=None)
    lower, upper = _outward_boxes(layout.pack(patches), segment_pair(segments))
    return Slefe(layout.unpack(lower, len(patches)), layout.unpack(upper, len(patches)))


class Signs(NamedTuple):
    """How second differences are parted by their signs: smoothly an enclosure is that much wider.

    alike : axes of the second differences ``(b, *rest)`` whose numbers have one unit
    wider : what is added to smooth sizes besides

    >>> [(float(p), float(n)) for p, n in Signs().parted([jnp.array(2.0), jnp.array(-3.0)])]
    [(2.0, 0.0), (0.0, -3.0)]
    """

    maxima: Maxima = EXACT
    alike: tuple[int, ...] = ()
    wider: Any = 0.0

    def parted(self, differences: list[Any]) -> list[tuple[Any, Any]]:
        """max(0, D_j), or a smooth one, which is not smaller, and what is left of D_j."""
        # exact maxima do not propagate NaN: inputs are checked apart
        positives = self.maxima.positive_parts(differences, self.alike, self.wider)
        return [(positive, difference - positive) for difference, positive in zip(differences, positives, strict=True)]

    def of_bounds(self, coefficients: Float[Array, "n b *rest"], segments: int, arrange: Callable[[Any], Any]) -> Signs:
        """The same for bounds of the bounds of these coefficients.

        arrange : from what those, ``(m+1, *rest)``, are wider by, to the second differences of the other direction
        """
        if isinstance(self.maxima, Exact) or coefficients.shape[0] == 2:
            return self
        table = _table_of(coefficients, segments)
        gaps = np.sum(table.upper - table.lower, axis=0)[_column(coefficients)]
        blur = self.maxima.blur(list(second_differences(coefficients)), self.alike)
        return self._replace(wider=arrange(_SECOND * (0.5 * gaps * blur)))


_PLAIN = Signs()


def enclose(coefficients: Float[Array, "n *rest"], segments: int, signs: Signs = _PLAIN) -> tuple[Any, Any]:
    """Lower and upper breakpoint values along the first axis, for use inside kernels ([YBP12], (2)).

    >>> lower, upper = enclose(jnp.array([0.0, 0.0, 1.0]), 1)
    >>> lower.round(3).tolist(), upper.round(3).tolist()
    ([-0.25, 0.75], [0.0, 1.0])
    """
    table = _table_of(coefficients, segments)
    if not signs.maxima.exact or table.lower.size > TUNING.unrolled_entries:
        return enclose_at(coefficients[:, None], segments, signs)
    # slices first and one breakpoint after the other: with sums of arrays the compiler's code takes three times as long
    slices = [coefficients[j] for j in range(coefficients.shape[0])]
    signed = signs.parted([(a - b) + (c - b) for a, b, c in zip(slices, slices[1:], slices[2:], strict=False)])
    columns = zip(
        _breakpoints(coefficients, segments).tolist(), table.lower.T.tolist(), table.upper.T.tolist(), strict=True
    )
    bounds = [_bounds((slices[0], slices[-1]), signed, *column) for column in columns]
    return jnp.stack([lower for lower, _ in bounds]), jnp.stack([upper for _, upper in bounds])


def enclose_at(coefficients: Float[Array, "n b *rest"], segments: int, signs: Signs = _PLAIN) -> tuple[Any, Any]:
    """Breakpoint values ``(m+1, *rest)``, breakpoint k from the coefficients ``[:, k]``; of b = 1 all from the same.

    >>> each = jnp.array([[0.0, 0.0], [0.0, 1.0], [1.0, 1.0]])  # two parabolas, one for each breakpoint
    >>> lower, upper = enclose_at(each, 1)
    >>> lower.round(3).tolist(), upper.round(3).tolist()
    ([-0.25, 1.0], [0.0, 1.25])
    """
    column, table = _column(coefficients), _table_of(coefficients, segments)
    signed = signs.parted(list(second_differences(coefficients)) if len(table.lower) else [])
    numbers = (_breakpoints(coefficients, segments)[column], table.lower[:, *column], table.upper[:, *column])
    return _bounds((coefficients[0], coefficients[-1]), signed, *numbers)


def _table_of(coefficients: Any, segments: int) -> SlefeTable:
    """In the dtype of the coefficients; without rows for degree 1."""
    degree = coefficients.shape[0] - 1
    if degree == 1:
        return SlefeTable(np.zeros((0, segments + 1)), np.zeros((0, segments + 1)))
    return _as_dtype(slefe_table(degree, segments), coefficients.dtype)


def _column(coefficients: Any) -> tuple[Any, ...]:
    """Brings a row of numbers to the axes of values at breakpoints."""
    return (slice(None),) + (None,) * (coefficients.ndim - 2)


def _breakpoints(coefficients: Any, segments: int) -> np.ndarray:
    return (np.arange(segments + 1) / segments).astype(coefficients.dtype)


def _bounds(ends: tuple[Any, Any], signed: list[tuple[Any, Any]], t: Any, low: Any, up: Any) -> tuple[Any, Any]:
    """Lower and upper values at t, from those of the tables there ([YBP12], (2)).

    upper = l + sum_j max(0, D_j) a_up_j + min(0, D_j) a_low_j; lower with max and min exchanged.
    """
    lower = upper = _sum([(1 - t, ends[0]), (t, ends[1])])
    for (positive, negative), a, b in zip(signed, low, up, strict=True):
        lower = _sum([(a, positive), (b, negative)], lower)
        upper = _sum([(b, positive), (a, negative)], upper)
    return lower, upper


def _sum(products: list[tuple[Any, Any]], start: Any = None) -> Any:
    """The start plus the sum of products, without those with a number that is 0."""
    terms = [
        value if isinstance(weight, float) and weight == 1.0 else weight * value
        for weight, value in products
        if not (isinstance(weight, float) and weight == 0.0)
    ]
    whole = sum(terms[1:], terms[0]) if terms else None
    return whole if start is None else start if whole is None else start + whole


def outward(bounds: tuple[Any, Any], coefficients: Float[Array, "n *rest"], segments: int) -> tuple[Any, Any]:
    """Bounds from ``enclose`` moved outwards by all that rounding may have done to them.

    With A the largest |c_j|, T_j the largest entry of a table's row, S their sum and u half an eps: second differences
    are off by 8 u A and at most 4 A, so their products with the table by 16 u A T_j; the chord is off by 5 u A; d sums
    of up to A (1 + 4 S), and this subtraction, add (d + 1) u A (1 + 4 S). Tables are outward themselves.

    >>> bounds = jnp.array([1.0]), jnp.array([1.0])
    >>> lower, upper = outward(bounds, jnp.array([1.0, 1.0, 1.0]), 1)
    >>> bool(lower < 1.0 < upper)
    True
    """
    degree = coefficients.shape[0] - 1
    if degree == 1 and segments == 1:
        return bounds
    table = 0.0 if degree == 1 else float(np.abs(slefe_table(degree, segments)).max(axis=(0, 2)).sum())
    error = rounding(coefficients, 1.01 * (2.5 + 8.0 * table + 0.5 * (degree + 1) * (1.0 + 4.0 * table)))
    return bounds[0] - error, bounds[1] + error


def rounding(coefficients: Float[Array, "n *rest"], times: float) -> Array:
    """So many eps of the largest size of coefficients along the first axis; more where numbers underflow.

    >>> float(rounding(jnp.array([1.0, -4.0]), 2.0)) == 8.0 * 2.0**-52
    True
    """
    largest, kind = jnp.max(jnp.abs(coefficients), axis=0), jnp.finfo(coefficients.dtype)
    tiny = (largest > 0) & (largest < kind.tiny / kind.eps)
    return times * kind.eps * largest + jnp.where(tiny, 64.0 * coefficients.shape[0] * kind.tiny, 0.0)


def enclose_patch(
    control: Float[Array, "nu nv *rest"], segments: tuple[int, int], maxima: Maxima = EXACT
) -> tuple[Any, Any]:
    """Tensor-product enclosure ``(m_u+1, m_v+1, *rest)``: bounds in v, then lower of lower and upper of upper in u.

    With soft maxima a smooth one, nowhere narrower.
    """
    # rows of the net, and coordinates but homogeneous ones, are alike
    across = Signs(maxima, (1, 2) if control.shape[2:3] == (3,) else (1,))
    by_v = jnp.swapaxes(control, 0, 1)
    along = across.of_bounds(by_v[:, None], segments[1], lambda wider: jnp.swapaxes(wider, 0, 1))
    across_lower, across_upper = loops.once(enclose(by_v, segments[1], across))
    lower, _ = enclose(jnp.swapaxes(across_lower, 0, 1), segments[0], along)
    _, upper = enclose(jnp.swapaxes(across_upper, 0, 1), segments[0], along)
    return loops.once((lower, upper))


def box_at(
    control: Float[Array, "nu nv *rest lanes"], place: tuple[Any, Any], segments: tuple[int, int]
) -> tuple[Array, Array]:
    """Ends ``(*rest, lanes)`` of one box of ``enclose_patch`` a lane, at breakpoints (i, j), both ``(lanes,)``."""
    across = _enclose_there(jnp.swapaxes(control, 0, 1), segments[1], place[1])
    return _enclose_there(across[0], segments[0], place[0])[0], _enclose_there(across[1], segments[0], place[0])[1]


def _enclose_there(coefficients: Float[Array, "n *rest lanes"], segments: int, breakpoint: Any) -> tuple[Any, Any]:
    """Lower and upper values ``(*rest, lanes)`` at one breakpoint a lane."""
    table = _table_of(coefficients, segments)
    signed = _PLAIN.parted(list(second_differences(coefficients)) if len(table.lower) else [])
    numbers = [
        jnp.asarray(x)[..., breakpoint] for x in (_breakpoints(coefficients, segments), table.lower, table.upper)
    ]
    return _bounds((coefficients[0], coefficients[-1]), signed, numbers[0], numbers[1], numbers[2])


@lru_cache(maxsize=512)
def _cast_outwards(degree: int, segments: int, name: str) -> SlefeTable:
    dtype, table = np.dtype(name), slefe_table(degree, segments)
    lower, upper = table.lower.astype(dtype), table.upper.astype(dtype)
    down, up = np.asarray(-np.inf, dtype), np.asarray(np.inf, dtype)
    lower = np.where(lower > table.lower, np.nextafter(lower, down), lower)
    return SlefeTable(lower, np.where(upper < table.upper, np.nextafter(upper, up), upper))


def _as_dtype(table: SlefeTable, dtype: Any) -> SlefeTable:
    """The table in another dtype, rounded outwards again."""
    degree, segments = table.lower.shape[0] + 1, table.lower.shape[1] - 1
    return _cast_outwards(degree, segments, np.dtype(dtype).name)


@jax.jit(static_argnums=(1, 2))
def _slefe_jit(coefficients: Any, segments: int, axis: int) -> tuple[Any, Any]:
    moved = jnp.moveaxis(coefficients, axis, 0)
    lower, upper = outward(enclose(moved, segments), moved, segments)
    return jnp.moveaxis(lower, 0, axis), jnp.moveaxis(upper, 0, axis)


def outward_patch(control: Float[Array, "nu nv *rest"], segments: tuple[int, int]) -> tuple[Any, Any]:
    """``enclose_patch``, rounded outwards in v and in u."""
    by_v = jnp.swapaxes(control, 0, 1)
    across = [jnp.swapaxes(bound, 0, 1) for bound in outward(enclose(by_v, segments[1]), by_v, segments[1])]
    lower, upper = (outward(enclose(bound, segments[0]), bound, segments[0]) for bound in across)
    return lower[0], upper[1]


@passes.as_pass(1)
def _outward_boxes(packed: Array | np.ndarray, segments: tuple[int, int]) -> tuple[Any, Any]:
    return loops.over_chunks(outward_patch, packed, segments)
