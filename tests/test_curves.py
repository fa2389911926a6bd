"""Constants of curves: analytic where there are formulas, and what random curves come to."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import linprog

from slefejax import InputError, curve_constant, slefe_table
from slefejax.bounds.slefe_tables import basis_coefficients
from slefejax.geometry.bezier import bernstein
from slefejax.study.curves import curve_ratios


@pytest.mark.parametrize(("m", "k"), [(1, 1.3959), (2, 1.1529), (3, 1.0948), (4, 1.0687), (5, 1.0539), (6, 1.0443)])
def test_cubics(m, k):
    assert curve_constant(3, m) == pytest.approx(k, abs=5e-5)


@pytest.mark.parametrize("m", [1, 2, 3, 7])
def test_a_parabola_is_what_a_slefe_is_exact_for(m):
    assert curve_constant(2, m) == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("degree", [3, 4, 5])
def test_it_falls_to_one_with_the_pieces_and_grows_with_the_degree(degree):
    values = [curve_constant(degree, m) for m in (1, 2, 4, 16)]
    assert values == sorted(values, reverse=True)
    assert 1.0 <= values[-1] < 1.05
    assert curve_constant(degree, 1) > curve_constant(degree - 1, 1)


def test_one_bend_by_hand():
    """Only D_1 = 1: M = |p''| = 6 at an end, w = the largest gap of the bounds of a_1; k = sqrt(6 / (8 w)) / m."""
    for m in (1, 2, 3):
        table = slefe_table(3, m)
        gap = float((table.upper - table.lower)[0].max())
        assert curve_constant(3, m) >= np.sqrt(6 / 8 / gap) / m - 1e-9
        one = np.array([float(c) for c in basis_coefficients(3, 1)])[:, None]
        assert curve_ratios(one, m, 2000)[0] == pytest.approx(np.sqrt(6 / 8 / gap) / m, rel=1e-3)


def test_the_linear_program_against_a_dense_grid():
    """Degree 5, two pieces: every parameter of a fine grid has its own program."""
    table = slefe_table(5, 2)
    gaps = (table.upper - table.lower).T
    best = 0.0
    for t in np.linspace(0.0, 1.0, 401):
        found = linprog(-np.array(bernstein(3, t)), A_ub=gaps, b_ub=np.ones(len(gaps)), bounds=(0, None))
        best = max(best, -float(found.fun))
    assert curve_constant(5, 2) == pytest.approx(np.sqrt(20 / 8 * best) / 2, rel=1e-4)


@pytest.mark.parametrize("m", [1, 3, 6])
def test_random_cubics_come_within_a_percent_of_it_and_never_above(m):
    """Real factors, many pieces; second differences (1, 0) among them, the worst."""
    rng = np.random.default_rng(0)
    curves = rng.normal(size=(4, 4000))
    curves[:, 0] = [float(c) for c in basis_coefficients(3, 1)]
    ratios = curve_ratios(curves, m, 64)
    k = curve_constant(3, m)
    assert 0.99 * k <= ratios.max() <= k * (1 + 1e-9)


@pytest.mark.parametrize("degree", [4, 6])
def test_no_curve_of_a_higher_degree_needs_more(degree, rng):
    ratios = curve_ratios(rng.normal(size=(degree + 1, 3000)), 2, 48)
    k = curve_constant(degree, 2)
    assert 0.8 * k < ratios.max() <= k * (1 + 1e-9)


def test_ratios_do_not_depend_on_size_place_or_straight_curves(rng):
    curves = rng.normal(size=(4, 50))
    plain = curve_ratios(curves, 2, 20)
    np.testing.assert_allclose(curve_ratios(1e-8 * curves, 2, 20), plain, rtol=1e-6)
    np.testing.assert_allclose(curve_ratios(1e8 * curves + 3e8, 2, 20), plain, rtol=1e-5)
    line = np.linspace(0.0, 1.0, 4)[:, None] * [[1.0, 0.0, 1e9]]
    assert curve_ratios(line, 2, 20).tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: curve_constant(1, 3), "whole degree from 2"),
        (lambda: curve_constant(3, 0), "segments"),
        (lambda: curve_ratios(np.zeros(4), 1, 5), "shape"),
        (lambda: curve_ratios(np.full((4, 1), np.nan), 1, 5), "finite"),
        (lambda: curve_ratios(np.zeros((4, 2)), 1, 0), "number of pieces"),
    ],
)
def test_bad_input(call, says):
    with pytest.raises(InputError, match=says):
        call()
