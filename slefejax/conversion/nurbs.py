"""B-spline and NURBS surfaces of any degree, as Bézier patches, exactly: knot insertion as a table of stencils.

On the interval [a, b] between two knots a spline is a polynomial, and its Bézier coefficient j is the blossom of that
polynomial with degree - j arguments a and j arguments b. Each step of the blossom is one of de Boor's affine
combinations, so the weights depend on the knots alone. Rational surfaces go through the same table as homogeneous
points (w x, w y, w z, w).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.sparse import csr_array, kron

from slefejax.conversion.patchwork import KINDS, Patchwork
from slefejax.errors import InputError
from slefejax.geometry.bezier import HIGHEST_DEGREE
from slefejax.model.stencils import StencilTable

_SLIVER = 1e-9  # of an interval between knots; a smaller piece at the end of a range is a rounding error
_SAME = 1e-13  # weights are affine combinations of numbers below 1, exact to a few rounding errors


@dataclass(frozen=True)
class Axis:
    """One parameter of a surface.

    rows   : ``(different points, control points)``, weights of the Bézier points
    net    : ``(intervals, degree + 1)``, which of them each interval has; neighbours share their common one
    """

    rows: Float[np.ndarray, "points control"]
    net: Int[np.ndarray, "intervals order"]


def bezier_axis(
    knots: Float[np.ndarray, "knots"], degree: int, count: int, bounds: tuple[float, float] | None = None
) -> Axis:
    """How the Bézier points of a spline of that degree, with ``count`` control points, are made of them.

    knots  : count + degree + 1 numbers, not decreasing; those at the ends need not be repeated
    bounds : the part of the parameter that is wanted; the whole domain if not given

    A knot repeated degree + 1 times parts the surface. Raises InputError for knots that are no such list, and for
    bounds outside of the domain.

    >>> bezier_axis(np.array([0.0, 0.0, 1.0, 2.0, 2.0]), 1, 3).net.tolist()
    [[0, 1], [1, 2]]
    """
    knots = np.asarray(knots, np.float64)
    check_knots(knots, degree, count)
    low, high = bounds or (knots[degree], knots[count])
    slack = _SLIVER * (knots[count] - knots[degree])
    if not knots[degree] - slack <= low < high - slack <= knots[count]:
        raise InputError(
            f"the range {low:g} to {high:g} is no part of the spline's own, {knots[degree]:g} to {knots[count]:g}"
        )
    rows, net = [], []
    for i in range(degree, count):
        a, b = max(low, knots[i]), min(high, knots[i + 1])
        if b - a <= _SLIVER * (knots[i + 1] - knots[i]):
            continue
        own = _interval_rows(knots, degree, count, i, a, b)
        start = 0
        if rows and np.allclose(rows[-1], own[0], rtol=0, atol=_SAME):
            start = 1
        net.append(np.arange(degree + 1) + len(rows) - start)
        rows.extend(own[start:])
    return Axis(np.array(rows), np.array(net))


def check_knots(knots: np.ndarray, degree: int, count: int) -> None:
    """Raise InputError unless these are the knots of a spline of that degree with so many control points."""
    if not 1 <= degree <= HIGHEST_DEGREE:
        raise InputError(f"a spline surface needs a degree from 1 to {HIGHEST_DEGREE}, not {degree}")
    if count < degree + 1:
        raise InputError(f"a spline of degree {degree} needs at least {degree + 1} control points, not {count}")
    if knots.shape != (count + degree + 1,):
        raise InputError(
            f"a spline of degree {degree} with {count} control points needs {count + degree + 1} knots,"
            f" not {knots.size}"
        )
    if not np.isfinite(knots).all() or np.any(np.diff(knots) < 0):
        raise InputError("the knots of a spline must be finite numbers that do not decrease")
    if np.any(knots[degree + 1 :] == knots[: -degree - 1]):
        raise InputError(f"a knot of a spline of degree {degree} is repeated more than {degree + 1} times")
    if not knots[degree] < knots[count]:
        raise InputError("the knots of a spline leave no interval: they are all the same")


def _interval_rows(knots: np.ndarray, degree: int, count: int, i: int, a: float, b: float) -> np.ndarray:
    """``(degree + 1, count)``: the Bézier points of [a, b], a part of [knots[i], knots[i+1]]."""
    rows = np.zeros((degree + 1, count))
    for j in range(degree + 1):
        rows[j, i - degree : i + 1] = _blossom_weights(knots, degree, i, [a] * (degree - j) + [b] * j)
    return rows


def _blossom_weights(knots: np.ndarray, degree: int, i: int, arguments: list[float]) -> np.ndarray:
    """Weights of control points i - degree ... i for the blossom of piece i at these arguments (de Boor)."""
    points = np.eye(degree + 1)
    for step, t in enumerate(arguments):
        low = knots[i - degree + 1 + step : i + 1]
        high = knots[i + 1 : i + 1 + degree - step]
        share = ((t - low) / (high - low))[:, None]
        points = (1.0 - share) * points[:-1] + share * points[1:]
    return points[0]


def spline_patches(control: Float[np.ndarray, "nu nv dim"], axes: tuple[Axis, Axis], surface: int = 0) -> Patchwork:
    """Bézier patches of a tensor-product spline; its control points are numbered row by row, u before v.

    control : only to see which control points coincide: where a surface closes or shrinks to a point, patches then
              share what they have in common
    surface : its number, kept as the face of every patch
    """
    flat = control.reshape(-1, control.shape[2])
    table, place = _merged(kron(csr_array(axes[0].rows), csr_array(axes[1].rows), format="csr"), flat)
    across = len(axes[1].rows)
    net = axes[0].net[:, None, :, None] * across + axes[1].net[None, :, None, :]
    net = place[net.reshape(-1, *net.shape[2:])]
    return Patchwork(table, net, np.full(len(net), surface), np.full(len(net), KINDS.index("spline")))


def _merged(rows: Any, control: np.ndarray) -> tuple[StencilTable, Int[np.ndarray, "rows"]]:
    """Rows over control points of which equal ones count as one, each different row once; where every row went."""
    _, first, same = np.unique(control + 0.0, axis=0, return_index=True, return_inverse=True)
    count = len(control)
    fold = csr_array((np.ones(count), (np.arange(count), first[same.ravel()])), shape=(count, count))
    folded = csr_array(rows @ fold)
    folded.data[np.abs(folded.data) < _SAME] = 0.0
    folded.eliminate_zeros()
    folded.sort_indices()
    table = StencilTable(folded).normalised().matrix
    kept: list[int] = []
    place = np.empty(table.shape[0], np.int64)
    known: dict[bytes, list[int]] = {}
    for row in range(table.shape[0]):
        part = slice(table.indptr[row], table.indptr[row + 1])
        alike = known.setdefault(table.indices[part].tobytes(), [])
        for number in alike:
            other = slice(table.indptr[kept[number]], table.indptr[kept[number] + 1])
            if np.max(np.abs(table.data[part] - table.data[other])) < _SAME:
                place[row] = number
                break
        else:
            place[row] = len(kept)
            alike.append(len(kept))
            kept.append(row)
    return StencilTable(table).take(kept), place


def uniform_knots(count: int, degree: int) -> Float[np.ndarray, "knots"]:
    """The knots of a uniform B-spline, one apart, none repeated: its domain is 0 ... count - degree.

    >>> uniform_knots(4, 2).tolist()
    [-2.0, -1.0, 0.0, 1.0, 2.0, 3.0, 4.0]
    """
    return np.arange(count + degree + 1, dtype=np.float64) - degree
