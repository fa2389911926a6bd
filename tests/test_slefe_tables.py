from __future__ import annotations

from fractions import Fraction
from itertools import pairwise
from math import comb

import numpy as np
import pytest
from scipy.optimize import linprog

from slefejax import InputError, slefe_table
from slefejax.bounds.slefe_tables import basis_coefficients

# degree 3, 3 segments, j = 1: solved apart with 40 digits (tangent of the first segment, then touching lines)
TABLE_1_UPPER = (0.0, -10 / 27, -8 / 27, 0.0)
TABLE_1_LOWER = (-0.06952143432217485, -0.43989180469254522, -0.31535159393226927, -0.00873272179185513)


def exact_value(degree, j, t):
    return sum(
        comb(degree, k) * (1 - t) ** (degree - k) * t**k * c for k, c in enumerate(basis_coefficients(degree, j))
    )


def bezier_on_segment(degree, j, start, end):
    """Exact Bézier coefficients of a_j on [start, end], by blossoming."""
    rows = []
    for k in range(degree + 1):
        c = list(basis_coefficients(degree, j))
        for t in [start] * (degree - k) + [end] * k:
            c = [(1 - t) * a + t * b for a, b in pairwise(c)]
        rows.append(c[0])
    return rows


def certainly_not_negative(coefficients, depth=40):
    """A proof that a polynomial is >= 0 on [0, 1]: after enough halving all of its Bézier coefficients are."""
    if all(c >= 0 for c in coefficients):
        return True
    if depth == 0 or coefficients[0] < 0 or coefficients[-1] < 0:
        return False
    left, c = [coefficients[0]], list(coefficients)
    right = [coefficients[-1]]
    while len(c) > 1:
        c = [(a + b) / 2 for a, b in pairwise(c)]
        left.append(c[0])
        right.append(c[-1])
    return certainly_not_negative(left, depth - 1) and certainly_not_negative(right[::-1], depth - 1)


def test_table_1_of_the_papers():
    table = slefe_table(3, 3)
    np.testing.assert_allclose(table.upper[0], TABLE_1_UPPER, rtol=0, atol=1e-15)
    np.testing.assert_allclose(table.lower[0], TABLE_1_LOWER, rtol=0, atol=1e-14)
    # as printed: ten digits for the first two, and what follows from the printed six for the others
    assert np.round(table.lower[0], 10).tolist()[:2] == [-0.0695214343, -0.4398918047]
    assert np.trunc(table.lower[0] * 1e6).tolist() == [-69521, -439891, -315351, -8732]
    # the numbers beside figure 3 of [YBP12], which are about a_1: width < .07, min-max bound 2/3
    assert 0.0695 < (table.upper - table.lower)[0].max() < 0.07
    assert -min(basis_coefficients(3, 1)) == Fraction(2, 3)


@pytest.mark.parametrize(("degree", "j"), [(2, 1), (3, 1), (5, 2), (8, 7)])
def test_basis_has_one_second_difference(degree, j):
    c = basis_coefficients(degree, j)
    differences = [c[i - 1] - 2 * c[i] + c[i + 1] for i in range(1, degree)]
    assert differences == [int(i == j) for i in range(1, degree)]
    assert c[0] == c[-1] == 0


def check_proof(degree, segments, rows=None):
    """In exact arithmetic, and strictly: upper - a_j and a_j - lower have non-negative Bézier coefficients."""
    table = slefe_table(degree, segments)
    for j in rows or range(1, degree):
        for i in range(segments):
            start, end = Fraction(i, segments), Fraction(i + 1, segments)
            own = bezier_on_segment(degree, j, start, end)
            for name, sign in (("upper", 1), ("lower", -1)):
                row = getattr(table, name)[j - 1]
                left, right = Fraction(float(row[i])), Fraction(float(row[i + 1]))
                line = [left + Fraction(k, degree) * (right - left) for k in range(degree + 1)]
                difference = [sign * (b - a) for a, b in zip(own, line, strict=True)]
                assert certainly_not_negative(difference), (j, i, name)


@pytest.mark.parametrize("segments", [1, 2, 3, 5])
@pytest.mark.parametrize("degree", [2, 3, 4, 5, 7])
def test_bounds_hold_by_proof(degree, segments):
    check_proof(degree, segments)


@pytest.mark.parametrize("segments", [1, 2, 3, 4, 7])
def test_quadratics_by_hand(segments):
    """a_1 = -u (1-u) for degree 2: every gap is a quarter of the squared segment length."""
    table = slefe_table(2, segments)
    np.testing.assert_allclose(table.upper - table.lower, 0.25 / segments**2, rtol=0, atol=2**-48)


@pytest.mark.parametrize(("degree", "segments"), [(3, 3), (4, 1), (4, 5), (6, 4), (9, 9), (20, 32)])
def test_reversal_is_exact(degree, segments):
    table = slefe_table(degree, segments)
    assert np.array_equal(table.lower, table.lower[::-1, ::-1])
    assert np.array_equal(table.upper, table.upper[::-1, ::-1])


@pytest.mark.parametrize(("degree", "segments"), [(3, 3), (4, 2), (5, 6)])
def test_upper_values_are_the_exact_ones_rounded_up(degree, segments):
    table = slefe_table(degree, segments)
    for j in range(1, degree):
        for i in range(segments + 1):
            exact, stored = exact_value(degree, j, Fraction(i, segments)), float(table.upper[j - 1, i])
            assert Fraction(np.nextafter(stored, -np.inf)) < exact <= Fraction(stored)


def test_tables_are_kept_and_cannot_be_changed():
    assert slefe_table(3, 3) is slefe_table(3, 3)
    with pytest.raises(ValueError, match="read-only"):
        slefe_table(3, 3).lower[0, 0] = 1.0


@pytest.mark.parametrize(("degree", "segments"), [(1, 3), (0, 1), (2.5, 1), (True, 1), (3, 0), (3, -1), (3, 1.5)])
def test_bad_arguments(degree, segments):
    with pytest.raises(InputError, match="whole"):
        slefe_table(degree, segments)


def lexicographic_by_programs(degree, j, segments, samples=160):
    """Gaps by linear programs over samples: lower the largest, find which must be that large, fix them, go on.

    Samples demand a little less than the whole interval does: gaps come out too small by the square of their spacing.
    """
    t = np.linspace(0, 1, samples * segments + 1)
    a = bernstein_values(degree, j, t)
    hat = np.maximum(0, 1 - np.abs(t[:, None] * segments - np.arange(segments + 1)))
    need = hat @ a[::samples] - a  # hat @ gaps >= need
    scale = need.max()
    need = need / scale  # the solver's tolerances, 1e-7, are absolute
    gaps, free = np.full(segments + 1, np.nan), np.ones(segments + 1, bool)
    while free.any():
        bounds = [(0, None) if f else (g, g) for f, g in zip(free, gaps, strict=True)]
        level = solve([*np.zeros(segments + 1), 1], hat, need, bounds, free)[-1]
        below = [(0, level + 1e-6) if f else (g, g) for f, g in zip(free, gaps, strict=True)]
        least = {i: solve([*np.eye(segments + 1)[i], 0], hat, need, below, free)[i] for i in np.flatnonzero(free)}
        forced = [i for i, g in least.items() if g >= level * (1 - 1e-3) - 1e-6] or [max(least, key=lambda i: least[i])]
        gaps[forced] = level
        free[forced] = False
    return scale * gaps


def bernstein_values(degree, j, t):
    c = [float(x) for x in basis_coefficients(degree, j)]
    return np.sum([comb(degree, k) * (1 - t) ** (degree - k) * t**k * c[k] for k in range(degree + 1)], axis=0)


def solve(target, hat, need, bounds, free):
    """Minimise target over (gaps, level): hat @ gaps >= need, free gaps at most the level."""
    n = hat.shape[1]
    rows = np.block([[-hat, np.zeros((len(hat), 1))], [np.diag(free.astype(float)), -free[:, None].astype(float)]])
    limits = np.concatenate([-need, np.zeros(n)])
    found = linprog(target, A_ub=rows, b_ub=limits, bounds=[*bounds, (0, None)], method="highs")
    assert found.status == 0, found.message
    return found.x


def check_lexicographic(degree, segments):
    table = slefe_table(degree, segments)
    for j in range(1, degree // 2 + 1):
        ours = (table.upper - table.lower)[j - 1]
        found = lexicographic_by_programs(degree, j, segments)
        # the samples' shortfall, relative to the largest gap; an error in a settled gap is passed on to the next
        np.testing.assert_allclose(ours, found, rtol=0, atol=2e-3 * ours.max(), err_msg=f"a_{j}")
        assert ours.max() <= found.max() * (1 + 1e-3)


@pytest.mark.parametrize(("degree", "segments"), [(3, 1), (3, 3), (3, 5), (4, 3), (5, 2), (6, 4)])
def test_lexicographic_order_by_an_independent_optimiser(degree, segments):
    check_lexicographic(degree, segments)


@pytest.mark.slow
@pytest.mark.parametrize("segments", range(1, 10))
@pytest.mark.parametrize("degree", range(2, 10))
def test_lexicographic_order_of_all_tables(degree, segments):
    check_lexicographic(degree, segments)


@pytest.mark.slow
@pytest.mark.parametrize("segments", [1, 2, 3, 4, 5, 6, 7, 8, 9, 32])
@pytest.mark.parametrize("degree", [2, 3, 4, 5, 6, 7, 8, 9, 20])
def test_all_bounds_hold_by_proof(degree, segments):
    if degree == 20 and segments == 32:
        check_proof(degree, segments, rows=(1, 2, 10, 17))
    else:
        check_proof(degree, segments)
