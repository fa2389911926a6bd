from __future__ import annotations

from fractions import Fraction
from math import comb

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slefejax import InputError, evaluate_patches
from slefejax.geometry import bezier

dyadic = st.integers(-64, 64).map(lambda n: n / 8.0)


def exact(coefficients, t):
    """p(t) in exact fractions."""
    d, t = len(coefficients) - 1, Fraction(t)
    return sum(comb(d, j) * (1 - t) ** (d - j) * t**j * Fraction(c) for j, c in enumerate(coefficients))


@given(st.lists(dyadic, min_size=1, max_size=7), st.integers(0, 8))
def test_curve_at_dyadic_parameters_is_exact(coefficients, eighth):
    t = eighth / 8.0
    assert float(bezier.evaluate_curve(np.array(coefficients), np.array(t))) == float(exact(coefficients, t))


@pytest.mark.parametrize("xp", [np, jnp])
def test_forms_keep_the_precision(xp, rng, precision):
    """Numbers of eight bits, and few enough operations that 24 bits hold all results: equal to exact fractions."""
    net, t = xp.asarray(rng.integers(-8, 8, (4, 3)) / 8.0, precision), precision(0.25)
    found = {
        "curve": (bezier.evaluate_curve(net, t), [exact(column, 0.25) for column in np.asarray(net, float).T]),
        "patch": (
            bezier.evaluate_patch(net, t, t),
            exact([exact(row, 0.25) for row in np.asarray(net, float)], 0.25),
        ),
        "restricted": (bezier.restrict(net, t, 3 * t)[0], [exact(column, 0.25) for column in np.asarray(net, float).T]),
        "second": (bezier.second_differences(net), np.diff(np.asarray(net, float), 2, axis=0)),
        "derivative": (bezier.derivative(net), 3 * np.diff(np.asarray(net, float), axis=0)),
    }
    for name, (own, wanted) in found.items():
        assert own.dtype == precision, name
        assert np.array_equal(np.asarray(own, float), np.asarray(wanted, float)), name


def test_patch_is_the_tensor_product(rng):
    control = rng.integers(-8, 8, (4, 3, 2)).astype(float)
    u, v = 0.25, 0.75
    rows = [[float(exact(control[i, :, c], v)) for c in range(2)] for i in range(4)]
    wanted = [float(exact([row[c] for row in rows], u)) for c in range(2)]
    assert bezier.evaluate_patch(control, np.array(u), np.array(v)).tolist() == wanted


def torus_patches(centre=(1.0, 2.0, 3.0), major=2.0, minor=0.5):
    """Sixteen rational patches, u along the tube, v around the axis; points by trigonometry beside them."""
    arc = np.array([[1, 0, 1], [1, 1, 1], [0, 2, 2]], float)  # a quarter circle, weights last

    def quarters():
        for k in range(4):
            turn = np.linalg.matrix_power(np.array([[0, -1], [1, 0]]), k)
            yield np.column_stack([arc[:, :2] @ turn.T, arc[:, 2]])

    patches = []
    for around in quarters():
        for tube in quarters():
            x, z, w = tube.T
            distance = major * w + minor * x  # times the weight
            xy = distance[:, None, None] * around[None, :, :2]
            weight = w[:, None] * around[None, :, 2]
            height = minor * z[:, None] * around[None, :, 2]
            points = np.concatenate([xy, height[..., None]], axis=-1) + weight[..., None] * np.array(centre)
            patches.append(np.concatenate([points, weight[..., None]], axis=-1))
    return np.array(patches)


@pytest.mark.parametrize("xp", [np, jnp])
def test_points_of_rational_patches_lie_on_the_torus(xp, rng, precision):
    parameters = rng.random((9, 2))
    found = evaluate_patches(xp.asarray(torus_patches(), precision), parameters)
    assert isinstance(found, np.ndarray if xp is np else jax.Array)
    assert found.dtype == precision
    assert found.shape == (16, 9, 3)
    x, y, z = np.moveaxis(np.asarray(found, float) - (1.0, 2.0, 3.0), -1, 0)
    np.testing.assert_allclose(np.hypot(np.hypot(x, y) - 2.0, z), 0.5, rtol=20 * np.finfo(precision).eps)


def test_points_of_patches_are_those_of_each_patch(rng):
    patches, parameters = rng.normal(size=(3, 4, 2, 3)), rng.random((3, 5, 2))
    own, shared = evaluate_patches(patches, parameters), evaluate_patches(patches, parameters[1].tolist())
    for p, patch in enumerate(patches):
        for k, (u, v) in enumerate(parameters[p]):
            np.testing.assert_allclose(own[p, k], bezier.evaluate_patch(patch, u, v), rtol=1e-14)
        np.testing.assert_array_equal(shared[p], evaluate_patches(patch[None], parameters[1])[0])
    assert np.array_equal(own[1], shared[1])
    assert evaluate_patches(patches, np.zeros((0, 2))).shape == (3, 0, 3)


def test_points_have_derivatives_by_patches_and_parameters(rng):
    patches, at = rng.normal(size=(1, 3, 4, 3)), np.array([[0.25, 0.75]])
    by_points = jax.grad(lambda points: evaluate_patches(points, at)[0, 0, 2])(jnp.asarray(patches))
    along_u, along_v = bezier.bernstein(2, 0.25), bezier.bernstein(3, 0.75)
    np.testing.assert_allclose(by_points[0, :, :, 2], np.outer(along_u, along_v), rtol=1e-6)
    by_place = jax.jacobian(lambda places: evaluate_patches(patches, places)[0, 0])(jnp.asarray(at))
    wanted = bezier.evaluate_patch(bezier.derivative(patches[0]), 0.25, 0.75)
    np.testing.assert_allclose(by_place[:, 0, 0], wanted, rtol=1e-5)


@pytest.mark.parametrize(
    ("patches", "parameters", "says"),
    [
        (
            np.zeros((3, 4, 4, 3)),
            np.zeros((4, 5, 2)),
            r"of 3 patches must have shape \(places, 2\) or \(3, places, 2\)",
        ),
        (np.zeros((3, 4, 4, 3)), np.zeros(2), r"not \(2,\)"),
        (np.zeros((3, 4, 4, 3)), np.zeros((5, 3)), r"not \(5, 3\)"),
        (np.zeros((3, 4, 4, 3)), [[0.5, "a"]], "array of numbers"),
        (np.zeros((4, 4, 3)), np.zeros((5, 2)), r"shape \(patches, du\+1, dv\+1, 3\)"),
        (np.zeros((3, 4, 4, 4)), np.zeros((5, 2)), "weights of rational patches must be positive: patch 0"),
    ],
)
def test_bad_places_are_one_sentence(patches, parameters, says):
    with pytest.raises(InputError, match=says):
        evaluate_patches(patches, parameters)


def test_evaluation_carries_batches_along(rng):
    control = rng.normal(size=(4, 4, 3, 1))
    u, v = rng.random(7), rng.random(7)
    together = bezier.evaluate_patch(control, u, v)
    one = [bezier.evaluate_patch(control[..., 0], u[k], v[k]) for k in range(7)]
    np.testing.assert_allclose(together.T, one, rtol=0, atol=1e-15 * 30)


@given(st.lists(dyadic, min_size=2, max_size=6), st.integers(0, 3), st.integers(0, 8))
def test_elevation_keeps_the_polynomial(coefficients, by, eighth):
    raised = bezier.elevate(np.array(coefficients), len(coefficients) - 1 + by)
    assert len(raised) == len(coefficients) + by
    assert raised[0] == coefficients[0]
    assert raised[-1] == coefficients[-1]
    # a handful of roundings of numbers up to 8
    assert float(exact(raised, eighth / 8)) == pytest.approx(float(exact(coefficients, eighth / 8)), abs=1e-13)


@given(st.lists(st.floats(-9, 9), min_size=2, max_size=6), st.integers(0, 3))
def test_elevation_of_the_reversed_curve_is_reversed_bitwise(coefficients, by):
    c, degree = np.array(coefficients), len(coefficients) - 1 + by
    assert np.array_equal(bezier.elevate(c[::-1], degree), bezier.elevate(c, degree)[::-1])


@given(st.lists(dyadic, min_size=2, max_size=5), st.integers(0, 3), st.integers(4, 8), st.integers(0, 4))
def test_restriction_is_reparametrisation(coefficients, start, end, quarter):
    part = bezier.restrict(np.array(coefficients), start / 8, end / 8)
    t = Fraction(quarter, 4)
    whole = Fraction(start, 8) + t * Fraction(end - start, 8)
    assert exact(part, t) == exact(coefficients, whole)


def test_second_differences_and_derivative():
    c = np.array([1.0, 4.0, 2.0, 8.0])
    assert bezier.second_differences(c).tolist() == [-5.0, 8.0]
    assert bezier.derivative(c).tolist() == [9.0, -6.0, 18.0]


def test_elevation_keeps_constants_bitwise():
    """A collapsed edge stays one point."""
    for value in (0.1, 0.7, 0.3, 1 / 3):
        assert np.all(bezier.elevate(np.full(2, value), 9) == value)
