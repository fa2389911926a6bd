"""How the slefe tables are computed: the lexicographically optimal bounds of the a_j.

a_j has degree d, end coefficients 0, and the j-th second difference 1, all others 0. It is convex with
a_j'' = d (d-1) b_(j-1)^(d-2) (docs/math.md, 2). On one segment write a_j = chord + sag, the sag convex,
at most 0, and 0 at both ends. A line that lies g_0 below a_j at the left breakpoint and g_1 below it at the right
one stays below a_j between them exactly if g_1 >= phi(g_0), where phi decreases: the line through the left
point that touches a_j. So the smallest gap that both ends of a segment can share is the depth of
its sag, reached only with both gaps equal to it; and a segment of which one gap is settled forces the other
to be at least phi of it.

Lexicographic optimum: take the largest of these demands over all segments. Nothing can do with less, and
nothing needs more, so it is the optimal largest gap; settle the breakpoints that it belongs to, and go on
with what is left, which has fallen apart into independent chains.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from math import comb

import numpy as np
from jaxtyping import Float

from slefejax.geometry.bezier import derivative, evaluate_curve, restrict
from slefejax.late import one_at_a_time

# Relative to the largest |a_j|: sixteen units in the last place of float64, several times what the computation loses.
OUTWARD = 2.0**-48


def basis_coefficients(degree: int, j: int) -> list[Fraction]:
    """Exact Bézier coefficients of a_j: -i (d-j)/d up to i = j, -j (d-i)/d from there (docs/math.md, 2).

    >>> [str(c) for c in basis_coefficients(3, 1)]
    ['0', '-2/3', '-1/3', '0']
    """
    return [Fraction(-min(i * (degree - j), j * (degree - i)), degree) for i in range(degree + 1)]


def build_table(
    degree: int, segments: int
) -> tuple[Float[np.ndarray, "rows breakpoints"], Float[np.ndarray, "rows breakpoints"]]:
    """(lower, upper) of ``slefe_table``; half of the rows are computed, the others are their mirror images.

    >>> lower, upper = build_table(2, 2)
    >>> upper.round(6).tolist()
    [[0.0, -0.25, 0.0]]
    """
    lower = np.empty((degree - 1, segments + 1))
    upper = np.empty((degree - 1, segments + 1))
    for j in range(1, degree // 2 + 1):
        low, up = _row(degree, j, segments)
        if 2 * j == degree:
            low, up = np.minimum(low, low[::-1]), np.maximum(up, up[::-1])
        lower[j - 1], upper[j - 1] = low, up
        lower[degree - j - 1], upper[degree - j - 1] = low[::-1], up[::-1]
    return lower, upper


def _row(degree: int, j: int, segments: int) -> tuple[np.ndarray, np.ndarray]:
    upper = np.array([_value_rounded_up(degree, j, i, segments) for i in range(segments + 1)])
    margin = OUTWARD * float(max(-c for c in basis_coefficients(degree, j)))
    bend = [0.0] * (degree - 1)
    bend[j - 1] = float(degree * (degree - 1))
    return upper - bend_gaps(degree, [bend], segments) - margin, upper


def _value_rounded_up(degree: int, j: int, i: int, segments: int) -> float:
    """The smallest float64 that is at least a_j(i/segments)."""
    terms = [
        c * comb(degree, k) * i**k * (segments - i) ** (degree - k) for k, c in enumerate(basis_coefficients(degree, j))
    ]
    exact = sum(terms, Fraction(0)) / segments**degree
    value = float(exact)
    return value if Fraction(value) >= exact else float(np.nextafter(value, np.inf))


def bend_gaps(degree: int, bends: list[list[float]], segments: int) -> Float[np.ndarray, "breakpoints"]:
    """Gaps of a convex function made of polynomials of that degree on intervals of length 1, cut into segments each.

    bends : for every interval the Bézier coefficients, all >= 0, of its second derivative (degree - 2)
    """
    basis = np.array([[float(c) for c in basis_coefficients(degree, k)] for k in range(1, degree)])
    scale = segments**2 * degree * (degree - 1)
    ends = [(i / segments, (i + 1) / segments) for i in range(segments)]
    # second differences on a segment: non-negative, so the sags are accurate relative to their own size
    sags = [restrict(np.array(bend), *end) @ basis / scale for bend in bends for end in ends]
    return _lexicographic_gaps(sags)


def _lexicographic_gaps(sags: list[np.ndarray]) -> Float[np.ndarray, "breakpoints"]:
    """The gaps at the breakpoints, the largest as small as possible, then the next (module docstring)."""
    gaps = np.full(len(sags) + 1, np.nan)
    demands = {i: (_shared_gap(sag), [i, i + 1]) for i, sag in enumerate(sags)}
    while demands:
        demand, places = demands.pop(max(demands, key=lambda i: demands[i][0]))
        gaps[places] = demand
        for i in {k for b in places for k in (b - 1, b)} & demands.keys():
            left, right = gaps[i], gaps[i + 1]
            if np.isnan(left) and not np.isnan(right):
                demands[i] = (_forced_gap(sags[i][::-1], right), [i])
            elif np.isnan(right) and not np.isnan(left):
                demands[i] = (_forced_gap(sags[i], left), [i + 1])
            else:
                del demands[i]
    return gaps


def _shared_gap(sag: np.ndarray) -> float:
    """The smallest gap that both ends of a segment can share: the depth of its sag, where the slope is 0."""
    slope = derivative(sag)
    return -_at(sag, _root(lambda s: _at(slope, s)))


def _forced_gap(sag: np.ndarray, gap: float) -> float:
    """phi(gap): the least gap at the right end when the left end has ``gap``, by the line that touches the sag.

    It is 0 where the line to the right end itself stays below: where its slope, ``gap``, is at least the sag's there.
    """
    slope = derivative(sag)
    if _at(slope, 1.0) <= gap:
        return 0.0
    touch = _root(lambda s: s * _at(slope, s) - _at(sag, s) - gap)
    return max(0.0, gap - _at(slope, touch))


def _root(increasing: Callable[[float], float]) -> float:
    """Where an increasing function on [0, 1] passes 0, or the end that is nearest to that."""
    if increasing(0.0) >= 0.0:
        return 0.0
    if increasing(1.0) <= 0.0:
        return 1.0
    with one_at_a_time:
        from scipy.optimize import brentq  # here, since it takes longer to import than all of this package

    return float(brentq(increasing, 0.0, 1.0, xtol=1e-16, rtol=4 * np.finfo(float).eps))  # type: ignore[arg-type]


def _at(coefficients: np.ndarray, s: float) -> float:
    return float(evaluate_curve(coefficients, np.float64(s)))
