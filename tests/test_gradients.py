"""Gradients that can be trusted: finite everywhere, right off ties, and smooth factors that stay upper bounds."""

from __future__ import annotations

from functools import cache, partial
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import Camera, InputError, View, load, sampled_error, tessellation_factors
from slefejax.predict.methods import METHODS

FAST: dict[str, dict[str, Any]] = {"slefe": {"segments": 1}, "certified": {"tiles": 1}, "fixed": {"setting": 7.0}}
EYE = jnp.array([4.5, -6.0, 4.0])
TARGET = (0.0, 0.0, 1.2)
SHAPES = [(4, 4, 3), (3, 5, 3), (6, 6, 3), (2, 4, 3), (4, 4, 4), (3, 3, 4)]  # control nets; with 4 at the end rational
EACH_TIME = [("slefe", (4, 4, 3)), ("filip", (4, 4, 3))]  # the others are slow tests


def _view(eye: Any) -> View:
    return View(Camera.look_at(eye, TARGET), 1440, 900)


@pytest.fixture(scope="module")
def hard() -> np.ndarray:
    """Bicubic patches where a maximum has no derivative, or a root none, or nothing is seen."""
    rng = np.random.default_rng(8)
    grid = np.linspace(-0.5, 0.5, 4)
    flat = np.stack([*np.meshgrid(grid, grid, indexing="ij"), np.zeros((4, 4))], axis=-1)
    rough = flat + 0.2 * rng.normal(size=flat.shape)
    collapsed = rough.copy()
    collapsed[0] = collapsed[0, :1]
    symmetric = flat.copy()
    symmetric[1:3, 1:3, 2] = 0.3
    bilinear = flat.copy()
    bilinear[..., 2] = flat[..., 0] * flat[..., 1]
    line = flat * [1.0, 0.0, 0.0]
    away = np.array([4.5, -6.0, 4.0])
    toward = (np.array(TARGET) - away) / np.linalg.norm(np.array(TARGET) - away)
    around_the_eye = rough + away
    places = [
        *(flat, rough, collapsed, symmetric, bilinear, line, np.zeros_like(flat), rough * 1e-12),
        *(rough + 3.0 * away, rough + [90.0, 0.0, 0.0], around_the_eye, rough + away + 0.1 * toward),
        *(rough * 1e4, symmetric[::-1], rough + 60.0 * toward, rough * 1e-150),
    ]
    return np.stack(places)


QUICK = ("filip",)  # methods whose gradients every run looks at; the others are slow tests


def _total(points: Any, eye: Any, tolerance: Any, method: str, **more: Any) -> Any:
    options = {**FAST.get(method, {}), **more}
    return jnp.sum(tessellation_factors(points, _view(eye), method, tolerance=tolerance, **options).factor)


@pytest.mark.parametrize("method", [m if m in QUICK else pytest.param(m, marks=pytest.mark.slow) for m in METHODS])
def test_no_gradient_is_nan(method, hard):
    """Flat, bilinear, collapsed, symmetric, linear, behind, beside, around the eye, tiny, huge."""
    slopes = jax.jit(jax.grad(partial(_total, method=method), argnums=(0, 1, 2)))(jnp.asarray(hard), EYE, 0.5)
    for slope in slopes:
        assert np.isfinite(slope).all()
    hidden = slopes[0][8:10]
    assert not np.any(hidden), "of what is off-screen nothing depends on anything"


@pytest.fixture(scope="module")
def rough() -> np.ndarray:
    """Patches in front of the camera of no symmetry, and no multiple of a chunk's lanes."""
    rng = np.random.default_rng(11)
    return np.array(TARGET) + rng.normal(size=(45, 1, 1, 3)) + 0.5 * rng.normal(size=(45, 4, 4, 3))


@pytest.mark.parametrize(
    ("method", "shape"),
    [
        case if case in EACH_TIME else pytest.param(*case, marks=pytest.mark.slow)
        for case in product(("slefe", "filip", "minmax", "edge-length", "screen-box", "certified"), SHAPES)
    ],
)
def test_reverse_mode_is_forward_mode_is_differences(method, shape, rough):
    """Patch by patch: each factor depends on its own patch alone, so one pass each way compares all of them."""
    if method == "filip" and shape[-1] == 4:
        pytest.skip("filip is for polynomial patches")
    rng = np.random.default_rng(shape)
    points = jnp.asarray(rough if shape == (4, 4, 3) else _of_shape(rng, shape))
    direction = jnp.asarray(rng.normal(size=points.shape))

    def factor(points: Any) -> Any:
        return tessellation_factors(points, _view(EYE), method, **FAST.get(method, {})).factor

    found, forward = jax.jit(lambda *at: jax.jvp(factor, at[:1], at[1:]))(points, direction)
    back = jax.jit(lambda at: jax.vjp(factor, at)[1](jnp.ones_like(found))[0])(points)
    reverse = jnp.sum(back * direction, axis=(1, 2, 3))
    # rounding of sums that cancel
    np.testing.assert_allclose(reverse, forward, rtol=1e-9, atol=1e-9 * float(jnp.abs(forward).max()))
    h = 1e-6
    numeric = (factor(points + h * direction) - factor(points - h * direction)) / (2 * h)
    # of second order, but where h reaches over a tie
    close = np.isclose(numeric, forward, rtol=1e-4, atol=1e-5 * float(jnp.abs(forward).max()))
    assert np.count_nonzero(~close) <= 1
    assert np.count_nonzero(forward) > len(points) / 3


def _of_shape(rng: np.random.Generator, shape: tuple[int, ...]) -> np.ndarray:
    points = np.array(TARGET) + rng.normal(size=(37, 1, 1, 3)) + 0.5 * rng.normal(size=(37, *shape[:2], 3))
    if shape[2] == 3:
        return points
    weights = np.exp(0.3 * rng.normal(size=(37, *shape[:2], 1)))
    return np.concatenate([points * weights, weights], axis=-1)


@cache
def _smooth(method: str) -> Any:
    """Compiled once for every temperature, which is traced: sum of factors, factors, slopes."""

    def total(points: Any, eye: Any, tolerance: Any, temperature: Any) -> Any:
        more = {"smooth": temperature, "tolerance": tolerance, **FAST[method]}
        factor = tessellation_factors(points, _view(eye), method, **more).factor
        return jnp.sum(factor), factor

    whole = jax.jit(jax.value_and_grad(total, argnums=(0, 1, 2, 3), has_aux=True))
    return lambda points, temperature: whole(jnp.asarray(points), EYE, 0.5, temperature)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["slefe", pytest.param("certified", marks=pytest.mark.slow)])
def test_smooth_factors_are_upper_bounds_with_finite_gradients(method, hard):
    exact = np.asarray(tessellation_factors(hard, _view(EYE), method, **FAST[method]).factor)
    before = exact
    for temperature in (1e-4, 1e-2, 1.0):
        (_, factor), slopes = _smooth(method)(hard, temperature)
        assert np.all(np.asarray(factor) >= before * (1 - 1e-9)), "never below, and growing with the temperature"
        assert np.array_equal(np.asarray(factor) > 0, exact > 0)
        for slope in slopes:
            assert np.isfinite(slope).all()
        if temperature == 1e-2:
            assert np.max(np.asarray(factor)[exact > 0] / exact[exact > 0]) < 1.05
        before = np.asarray(factor)


@pytest.mark.slow
def test_smooth_gradients_against_differences_on_ties(hard):
    """Collapsed sides, equal coefficients, coordinates without second differences: smooth factors have a derivative."""
    direction = np.zeros_like(hard)
    direction[[1, 2, 3, 13]] = np.random.default_rng(2).normal(size=(4, *hard.shape[1:]))
    _, slopes = _smooth("slefe")(hard, 0.05)
    h = 1e-7
    ahead, behind = (float(_smooth("slefe")(hard + s * h * direction, 0.05)[0][0]) for s in (1, -1))
    # second order: the curvature at ties is that of 1 / T
    assert float(np.vdot(slopes[0], direction)) == pytest.approx((ahead - behind) / (2 * h), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["filip", "minmax", "edge-length", "screen-box"])
def test_gradients_without_perspective(method, hard):
    """Row W of the matrix is (0, 0, 0, 1) there: its first three numbers have no direction."""

    def total(eye: Any, points: Any) -> Any:
        view = View(Camera.orthographic(eye, TARGET, height=6.0), 640, 400)
        return jnp.sum(tessellation_factors(points, view, method).factor)

    for slope in jax.grad(total, argnums=(0, 1))(EYE, jnp.asarray(hard)):
        assert np.isfinite(slope).all()


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, pytest.param(np.float64, marks=pytest.mark.slow)])
def test_a_temperature_next_to_nothing_is_no_smaller_than_rounding(dtype, hard):
    points, options = hard.astype(dtype), FAST["slefe"]
    exact = np.asarray(tessellation_factors(points, _view(EYE), "slefe", **options).factor)
    for temperature in (1e-30, 1e-10, 1e-6):
        soft = np.asarray(tessellation_factors(points, _view(EYE), "slefe", smooth=temperature, **options).factor)
        assert np.all(soft >= exact * (1 - 16 * np.finfo(dtype).eps))


@pytest.mark.parametrize("method", ["slefe", "filip"])
def test_traced_numbers_beyond_their_range_give_nan(method, hard):
    view = _view(EYE)
    factor = jax.jit(lambda t: tessellation_factors(hard, view, method, tolerance=t, **FAST.get(method, {})).factor)
    for tolerance in (0.0, -1.0, np.nan):
        assert np.isnan(factor(tolerance)).all()
    if method == "slefe":
        soft = jax.jit(lambda t: tessellation_factors(hard, view, "slefe", smooth=t, segments=1).factor)
        for temperature in (0.0, -1.0, 2.0):
            assert np.isnan(soft(temperature)).all()


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"method": "filip", "smooth": 0.1}, "'filip' has no smooth"),
        ({"smooth": 0.1, "verify": True}, "anisotropic and verify find whole numbers"),
        ({"smooth": 0.1, "anisotropic": True}, "anisotropic and verify find whole numbers"),
        ({"smooth": 2.0}, "a temperature of at most 1"),
        ({"smooth": 0.0}, "smooth must be"),
        ({"smooth": True}, "not yes or no"),
        ({"smooth": float("nan")}, "smooth must be"),
        ({"method": "slefe", "smooth": "hot"}, "smooth must be"),
    ],
)
def test_a_temperature_that_is_none(options, says, main_view):
    with pytest.raises(InputError, match=says):
        tessellation_factors(load("teapot").patches(), main_view, **options)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["slefe", "certified"])
@pytest.mark.parametrize("rational", [False, True])
def test_the_defaults_with_depth_and_weights(method, rational, hard):
    """m = 3 and two tiles, with a depth tolerance, exact and smooth."""
    rng = np.random.default_rng(3)
    points = hard
    if rational:
        weights = np.exp(0.5 * rng.normal(size=points.shape[:3]))[..., None]
        points = np.concatenate([points * weights, weights], axis=-1)
    exact = np.asarray(tessellation_factors(points, _view(EYE), method, depth_tolerance=1e-4).factor)
    for smooth in (None, 1e-3, 0.3):

        def total(points: Any, eye: Any, tolerance: Any, smooth: Any = smooth) -> Any:
            more = {"depth_tolerance": 1e-4, "tolerance": tolerance, "smooth": smooth}
            factor = tessellation_factors(points, _view(eye), method, **more).factor
            return jnp.sum(factor), factor

        grad = jax.jit(jax.grad(total, argnums=(0, 1, 2), has_aux=True))
        slopes, factor = grad(jnp.asarray(points), EYE, 0.5)
        # certified ones stay so, but remainders over n are smaller where the second order is larger
        lost = 1e-9 if method == "slefe" else 1e-4
        assert np.all(np.asarray(factor) >= exact * (1 - lost))
        for slope in slopes:
            assert np.isfinite(slope).all()
        if method == "certified":
            levels = np.ceil(np.asarray(factor)).astype(int)
            few = np.flatnonzero((levels > 0) & (levels < 500))
            assert np.all(sampled_error(points[few], levels[few], _view(EYE)) <= 0.5)
