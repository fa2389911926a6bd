"""The constants k_m of curves: how far the estimate falls short in one variable (docs/fitting.md).

A curve of degree d with second differences D_j is off by M / (8 n^2) where it is cut into many pieces n, with M the
largest |p''|, p'' = d (d-1) sum_j D_j B_(j-1). Its slefe with m pieces is w = max_i sum_j |D_j| g_ij wide, with g the
gap between the tabulated bounds of a_j at breakpoint i. So k_m m sqrt(w / tolerance) pieces are enough for all curves
of that degree, and with no smaller constant, if k_m^2 = d (d-1) / (8 m^2) times the largest sum_j D_j B_(j-1)(t) with
w <= 1.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import numpy as np
from jaxtyping import Float
from scipy.optimize import linprog, minimize_scalar

from slefejax.arguments import check_segments, is_whole
from slefejax.bounds.slefe import slefe, slefe_table
from slefejax.errors import InputError
from slefejax.geometry.bezier import bernstein, evaluate_curve

_MOST_SEGMENTS = 1000
_PLACES = 65  # parameters at which the largest is looked for before it is refined
_SAMPLES = 33  # of a piece; its error is nearly a parabola whose top is one of them


def curve_constant(degree: Any, segments: Any) -> float:
    """The smallest k_m with which the estimate holds for all curves of a degree, cut into many pieces.

    degree   : from 2 to 64;  segments : m, at most 1000

    For cubics 1.3959, 1.1529, 1.0948, 1.0687, ... with m = 1, 2, 3, 4, ... For every parameter t a linear program over
    the second differences; the largest of them all. Raises InputError as ``slefe_table`` does.

    >>> [round(curve_constant(3, m), 4) for m in (1, 2, 3, 4)]
    [1.3959, 1.1529, 1.0948, 1.0687]
    """
    if check_segments(segments) > _MOST_SEGMENTS:
        raise InputError(f"constants are known up to {_MOST_SEGMENTS} segments, and nearly 1 from there on: {segments}")
    slefe_table(degree, segments)  # which checks the degree
    return _constant(int(degree), int(segments))


@lru_cache(maxsize=256)
def _constant(degree: int, segments: int) -> float:
    table = slefe_table(degree, segments)
    gaps = (table.upper - table.lower).T

    def worst(t: float) -> float:
        found = linprog(-np.array(bernstein(degree - 2, t)), A_ub=gaps, b_ub=np.ones(len(gaps)), bounds=(0, None))
        return -float(found.fun)

    places = np.linspace(0.0, 0.5, _PLACES)  # the tables are symmetric
    values = [worst(t) for t in places]
    at = int(np.argmax(values))
    around = places[max(0, at - 1)], places[min(_PLACES - 1, at + 1)]
    inner = minimize_scalar(lambda t: -worst(t), bounds=around, method="bounded", options={"xatol": 1e-9})
    largest = max(values[at], -float(inner.fun))
    return float(np.sqrt(degree * (degree - 1) / 8.0 * largest) / segments)


def curve_ratios(coefficients: Any, segments: Any, pieces: Any) -> Float[np.ndarray, "curves"]:
    """The k_m that each of some curves needs, cut into so many pieces: real, without rounding.

    coefficients : Bézier coefficients ``(degree + 1, curves)``;  segments : m;  pieces : n
    returns      : n / (m sqrt(w / e)) with e the largest distance between curve and chords when cut into n: n is then
                   the factor that a tolerance of e needs. 0 for straight lines

    Raises InputError for fewer than two coefficients, and m or n below 1.

    >>> curve_ratios(np.array([[0.0], [-2.0], [-1.0], [0.0]]), 1, 1000).round(3)         # second differences (3, 0)
    array([1.396])
    """
    coefficients = np.asarray(coefficients, np.float64)
    check_segments(segments)
    if not is_whole(pieces, 1):
        raise InputError(f"the number of pieces must be a whole number of at least 1, not {pieces!r}")
    if coefficients.ndim != 2 or len(coefficients) < 2 or not np.isfinite(coefficients).all():
        raise InputError("curves are finite coefficients of shape (degree + 1, curves)")
    bounds = slefe(coefficients, segments, axis=0)
    width = np.max(np.asarray(bounds.upper) - np.asarray(bounds.lower), axis=0)
    size = np.max(np.abs(coefficients), axis=0)
    error = _chord_errors(coefficients, pieces)
    straight = width <= 64 * np.finfo(np.float64).eps * size
    safe = np.where(straight, 1.0, width)
    return np.where(straight, 0.0, pieces * np.sqrt(error / safe) / segments)


def _chord_errors(coefficients: np.ndarray, pieces: int) -> np.ndarray:
    """The largest distance between each curve and its chord on any of equal pieces, piece by piece.

    Around the middle of each piece, where differences of values lose least.
    """
    largest = np.zeros(coefficients.shape[1])
    fine = np.linspace(0.0, 1.0, _SAMPLES)
    for k in range(pieces):
        t = (k + fine) / pieces
        values = np.asarray(evaluate_curve(coefficients[:, None], t[:, None]))
        chord = values[:1] + fine[:, None] * (values[-1:] - values[:1])
        largest = np.maximum(largest, np.max(np.abs(values - chord), axis=0))
    return largest
