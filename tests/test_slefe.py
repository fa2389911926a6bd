from __future__ import annotations

from typing import Any, cast

import jax
import numpy as np
import pytest

from slefejax import InputError, slefe, slefe_boxes, slefe_table
from slefejax.geometry.bezier import elevate, evaluate_curve, evaluate_patch, restrict
from slefejax.testing import assert_encloses

# Rounding of an enclosure and of the evaluation that it is compared with: a few dozen operations on numbers of the
# size of the coefficients.
ROUNDING = 64 * np.finfo(np.float64).eps


def interpolate(breakpoints, t):
    """The piecewise-linear function with these values along the first axis, at t."""
    segments = breakpoints.shape[0] - 1
    i = np.minimum((t * segments).astype(int), segments - 1)
    s = (t * segments - i).reshape((-1,) + (1,) * (breakpoints.ndim - 1))
    return (1 - s) * breakpoints[i] + s * breakpoints[i + 1]


@pytest.mark.parametrize("segments", [1, 2, 3, 5, 8])
@pytest.mark.parametrize("degree", [2, 3, 4, 5, 7])
def test_curves_stay_inside(degree, segments, rng, precision):
    """4,000 curves each, 200,000 in all, of sizes over twelve decades: single precision is rounded outwards, too."""
    size = 10.0 ** rng.uniform(-6, 6, 4000)
    curves = (rng.normal(size=(degree + 1, 4000)) * size).astype(precision)
    t = np.linspace(0, 1, 41)
    values = np.stack([evaluate_curve(curves.astype(float), x) for x in t])
    bounds = slefe(curves, segments, axis=0)
    assert bounds.lower.dtype == bounds.upper.dtype == precision
    lower, upper = (interpolate(np.asarray(b, float), t) for b in bounds)
    slack = ROUNDING * np.abs(curves).max(axis=0)
    assert np.all(lower <= values + slack)
    assert np.all(values <= upper + slack)


@pytest.mark.parametrize("segments", [(1, 1), (3, 3), (2, 5), (4, 1)])
@pytest.mark.parametrize("degrees", [(1, 1), (2, 1), (3, 3), (2, 5)])
def test_patches_stay_inside(degrees, segments, rng, precision):
    """6,400 patches each, more than 200,000 in all."""
    count, (du, dv) = 6400, degrees
    patches = rng.normal(size=(count, du + 1, dv + 1, 1)) * 10.0 ** rng.uniform(-6, 6, (count, 1, 1, 1))
    patches = patches.astype(precision).astype(float)
    boxes = slefe_boxes(patches.astype(precision), segments)
    assert boxes.lower.dtype == boxes.upper.dtype == precision
    lower, upper = (np.moveaxis(np.asarray(b, float)[..., 0], 0, -1) for b in boxes)
    assert lower.shape == (segments[0] + 1, segments[1] + 1, count)
    slack = ROUNDING * np.abs(patches).max(axis=(1, 2, 3))
    control = np.moveaxis(patches[..., 0], 0, -1)
    for u, v in rng.random((25, 2)):
        value = evaluate_patch(control, u, v)
        low, high = (interpolate(interpolate(b, np.array([u]))[0], np.array([v]))[0] for b in (lower, upper))
        assert np.all(low <= value + slack)
        assert np.all(value <= high + slack)


def test_worst_cubic_is_the_table(precision):
    """Second differences (1, 0): the enclosure's width is the table's, .0695 of docs/math.md, 2."""
    curve = np.array([0.0, -2 / 3, -1 / 3, 0.0], precision)
    lower, upper = slefe(curve, 3)
    table = slefe_table(3, 3)
    # bounds are rounded outwards, by 20 eps of the largest coefficient
    atol = 20 * np.finfo(precision).eps
    np.testing.assert_allclose(lower, table.lower[0], rtol=0, atol=atol)
    np.testing.assert_allclose(upper, table.upper[0], rtol=0, atol=atol)


@pytest.mark.parametrize("degree", [3, 4, 6])
def test_width_shrinks_with_the_square_of_the_interval(degree, rng):
    """Restricting to length h scales the largest second difference by h^2, and not the width ([YBP12], (4))."""
    for _ in range(20):
        curve = rng.normal(size=degree + 1)
        h = rng.uniform(0.05, 0.9)
        start = rng.uniform(0, 1 - h)
        part = np.asarray(restrict(curve, start, start + h))
        worst = np.abs(np.diff(curve, 2)).max()
        assert np.abs(np.diff(part, 2)).max() <= h * h * worst * (1 + 1e-9)


def test_affine_maps_carry_the_enclosure_along(rng):
    curve = rng.normal(size=6)
    lower, upper = slefe(curve, 4)
    line = 2.0 - 3.0 * np.linspace(0, 1, 6)
    moved = slefe(4.0 * curve + line, 4)
    np.testing.assert_allclose(moved.lower, 4.0 * np.asarray(lower) + 2 - 3 * np.linspace(0, 1, 5), atol=1e-13)
    flipped = slefe(-curve, 4)
    np.testing.assert_allclose(flipped.upper, -np.asarray(lower), atol=1e-14)
    np.testing.assert_allclose(flipped.lower, -np.asarray(upper), atol=1e-14)


def test_reversed_curve_has_the_reversed_slefe(rng):
    curve = rng.normal(size=5)
    forwards, backwards = slefe(curve, 3), slefe(curve[::-1].copy(), 3)
    np.testing.assert_allclose(backwards.lower, np.asarray(forwards.lower)[::-1], atol=1e-15)
    np.testing.assert_allclose(backwards.upper, np.asarray(forwards.upper)[::-1], atol=1e-15)


def test_lines_are_their_own_enclosure():
    lower, upper = slefe(np.array([1.0, 3.0]), 4)
    for bound in (lower, upper):  # rounded outwards
        np.testing.assert_allclose(bound, [1.0, 1.5, 2.0, 2.5, 3.0], rtol=0, atol=4e-15)
    assert [end.tolist() for end in slefe(np.array([1.0, 3.0]), 1)] == [[1.0, 3.0], [1.0, 3.0]]
    assert [end.tolist() for end in slefe(np.zeros(4), 3)] == [[0.0] * 4, [0.0] * 4]


def test_any_axis_and_plain_lists(rng):
    curves = rng.normal(size=(3, 5, 2))
    middle = slefe(curves, 2, axis=1)
    assert middle.lower.shape == (3, 3, 2)
    np.testing.assert_array_equal(middle.lower[1, :, 0], slefe(curves[1, :, 0].tolist(), 2).lower)


def test_float32_stays_float32_and_bounds_still_hold(rng):
    curve = rng.normal(size=(4, 500)).astype(np.float32)
    lower, upper = slefe(curve, 3, axis=0)
    assert lower.dtype == upper.dtype == np.float32
    t = np.linspace(0, 1, 31)
    values = np.stack([evaluate_curve(curve.astype(np.float64), x) for x in t])
    slack = 16 * np.finfo(np.float32).eps * np.abs(curve).max(axis=0)
    assert np.all(interpolate(np.asarray(lower, np.float64), t) <= values + slack)
    assert np.all(values <= interpolate(np.asarray(upper, np.float64), t) + slack)


def test_gradient_matches_finite_differences(rng):
    curve = rng.normal(size=5)

    def total_width(c):
        lower, upper = slefe(c, 3)
        return (upper - lower).sum()

    h = 1e-6
    numeric = [(total_width(curve + h * e) - total_width(curve - h * e)) / (2 * h) for e in np.eye(5)]
    np.testing.assert_allclose(jax.grad(total_width)(jax.numpy.asarray(curve)), numeric, rtol=1e-6, atol=1e-8)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: slefe([1.0], 3), "at least two coefficients"),
        (lambda: slefe(3.0, 3), "at least two coefficients"),
        (lambda: slefe([1.0, 2.0], 0), "segments"),
        (lambda: slefe([[1.0, 2.0], [3.0]], 2), "different lengths"),
        (lambda: slefe(["a", "b"], 2), "array of numbers"),
        (lambda: slefe_boxes(np.zeros((2, 4, 3)), 3), "shape"),
        (lambda: slefe_boxes(np.zeros((0, 4, 4, 3)), 3), "no patches"),
        (lambda: slefe_boxes(np.zeros((1, 1, 4, 3)), 3), "degree of at least 1"),
        (lambda: slefe_boxes(np.zeros((1, 4, 4, 3)), (3, 0)), "segments"),
        (lambda: slefe_boxes(np.zeros((1, 4, 4, 3)), cast(Any, (3, 3, 3))), "pair"),
    ],
)
def test_bad_arguments(call, says):
    with pytest.raises(InputError, match=says):
        call()


@pytest.mark.parametrize("degree", [2, 3, 5])
def test_elevated_curves_are_enclosed_as_well(degree, rng):
    """The same function in a higher degree has another slefe; both hold it, neither twice as wide as the other."""
    widths = []
    for _ in range(30):
        curve = rng.normal(size=degree + 1)
        raised = elevate(curve, degree + 2)
        lower, upper = slefe(raised, 3)
        assert_encloses(lower, upper, lambda t, c=curve: evaluate_curve(c, t), slack=1e-13)
        own = slefe(curve, 3)
        widths.append(float(np.max(upper - lower) / np.max(own.upper - own.lower)))
    assert 0.5 < np.median(widths) < 2.0
