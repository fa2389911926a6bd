from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import Camera, InputError, View, sampled_error, tessellation_factors

RULES = ("filip", "minmax", "edge-length", "screen-box", "fixed")


def test_by_hand_on_a_flat_rectangle(precision):
    """400 x 100 px: flat, evenly parametrised."""
    corners = np.array([[[0, 0, 0], [0, 100, 0]], [[400, 0, 0], [400, 100, 0]]], precision)[None]
    view = View(Camera.orthographic((300, 200, 5), (300, 200, 0), up=(0, 1, 0), height=400.0), 600, 400)
    wanted = {"filip": 1.0, "minmax": 800.0, "edge-length": 50.0, "screen-box": 400.0, "fixed": 16.0}
    for method, factor in wanted.items():
        found = tessellation_factors(corners, view, method).factor
        assert found.dtype == precision, method
        assert found.tolist() == pytest.approx([factor]), method
    assert tessellation_factors(corners, view, "screen-box", setting=8).factor.tolist() == pytest.approx([50.0])
    assert tessellation_factors(corners, view, "edge-length", setting=20.0).factor.tolist() == pytest.approx([20.0])
    assert tessellation_factors(corners, view, "fixed", setting=3).factor.tolist() == [3.0]


def test_filip_by_hand(precision):
    """y = A u^2 over 100 px: second derivative 2 A, so A / (4 n^2) <= tolerance; and a twist counts twice."""
    view = View(Camera.orthographic((50, 100, 5), (50, 100, 0), up=(0, 1, 0), height=300.0), 300, 300)
    parabola = np.zeros((1, 3, 2, 3), precision)
    parabola[0, :, :, 0], parabola[0, 2, :, 1], parabola[0, :, 1, 2] = [[0], [50], [100]], 200, 1
    assert float(tessellation_factors(parabola, view, "filip").factor[0]) == pytest.approx(np.sqrt(200 / 4 / 0.5))
    twisted = np.array([[[0, 0, 0], [0, 100, 0]], [[100, 0, 0], [150, 100, 0]]], precision)[None]
    assert float(tessellation_factors(twisted, view, "filip").factor[0]) == pytest.approx(np.sqrt(2 * 50 / 8 / 0.5))


@pytest.mark.slow
def test_filip_is_sound(rng):
    """Random patches in random perspective views, all in front of the camera: never above the tolerance."""
    checked = 0
    for _ in range(3):
        patches = rng.normal(size=(150, 4, 3, 3)) * rng.uniform(0.1, 2, (150, 1, 1, 1))
        view = View(Camera.look_at(rng.normal(size=3) * 3 + [0, -9, 0], (0, 0, 0)), 640, 480)
        factors = tessellation_factors(patches, view, "filip")
        w = (np.concatenate([patches, np.ones((150, 4, 3, 1))], axis=-1) @ view.world_to_clip.T)[..., 3]
        front = (w.min(axis=(1, 2)) > 0.1) & (factors.levels > 0) & (factors.levels < 60)
        assert np.all(sampled_error(patches[front], factors.levels[front], view) <= 0.5)
        checked += np.count_nonzero(front)
    assert checked > 150


@pytest.mark.parametrize("method", RULES)
def test_off_screen_is_zero_and_float32_stays(method, teapot, main_view):
    patches = np.concatenate([teapot.patches(), teapot.patches() + [500.0, 0, 0]])
    factor = tessellation_factors(patches, main_view, method).factor
    assert np.all(np.asarray(factor[:32]) >= 1)
    assert factor[32:].tolist() == [0.0] * 32
    single = tessellation_factors(teapot.patches().astype(np.float32), main_view, method).factor
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, factor[:32], rtol=1e-4)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["filip", "minmax", "edge-length", "screen-box"])
def test_gradients(method, teapot, main_view, rng):
    patches = jnp.asarray(teapot.patches()[4:8] + 0.01 * rng.normal(size=(4, 4, 4, 3)))
    direction = rng.normal(size=patches.shape)

    def total(points):
        return tessellation_factors(points, main_view, method).factor.sum()

    h = 1e-6
    numeric = float(total(patches + h * direction) - total(patches - h * direction)) / (2 * h)
    assert float(jnp.vdot(jax.grad(total)(patches), direction)) == pytest.approx(numeric, rel=1e-4)


def test_the_box_of_rational_patches_depends_on_no_origin(rng, main_view):
    """Eager calls take an origin off that is near the patches; traced ones have none to take."""
    weights = np.exp(0.5 * rng.normal(size=(20, 4, 4, 1)))
    patches = np.concatenate([(rng.normal(size=(20, 4, 4, 3)) + [0, 0, 1]) * weights, weights], axis=-1)
    found = tessellation_factors(patches, main_view, "screen-box").factor
    traced = jax.jit(lambda points: tessellation_factors(points, main_view, "screen-box").factor)(patches)
    np.testing.assert_allclose(traced, found, rtol=1e-9)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"method": "filip", "setting": 3}, "has no setting"),
        ({"method": "fixed", "setting": 0}, "setting must be a positive"),
        ({"method": "minmax", "depth_tolerance": 0.1}, "knows no depth_tolerance"),
        ({"method": "slefe", "setting": 1}, "has no setting"),
    ],
)
def test_bad_options(teapot, main_view, options, says):
    with pytest.raises(InputError, match=says):
        tessellation_factors(teapot.patches(), main_view, **options)


def test_filip_refuses_rational_patches(main_view):
    with pytest.raises(InputError, match="rational"):
        tessellation_factors(np.ones((1, 3, 3, 4)), main_view, "filip")
