from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import Camera, InputError, View
from slefejax.geometry.view import frame, homogeneous


def screen(view, point):
    x = view.world_to_screen @ np.append(point, 1.0)
    return x[:3] / x[3]


@pytest.fixture
def view():
    return View(Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), 1440, 900)


def test_target_is_in_the_middle_and_up_is_up(view):
    np.testing.assert_allclose(screen(view, (0, 0, 1.2))[:2], (720, 450), atol=1e-9)
    assert screen(view, (0, 0, 1.3))[1] > 450
    assert screen(view, (0.6, 0.45, 1.2))[0] > 720, "to the right of a camera that looks from the front right"


def test_perspective_by_hand():
    """At distance 5 with 45 degrees, half the picture's height is 5 tan(22.5 degrees)."""
    view = View(Camera.look_at((0, -5, 0), (0, 0, 0)), 200, 100)
    half = 5 * np.tan(np.deg2rad(22.5))
    np.testing.assert_allclose(screen(view, (half, 0, half))[:2], (150, 100), atol=1e-12)


@pytest.mark.parametrize("build", [Camera.look_at, Camera.orthographic])
def test_window_depth_is_zero_at_near_and_one_at_far(build):
    view = View(build((0, 0, 0), (0, 1, 0), near=0.5, far=20.0), 10, 10)
    assert screen(view, (0, 0.5, 0))[2] == pytest.approx(0.0, abs=1e-14)
    assert screen(view, (0, 20.0, 0))[2] == pytest.approx(1.0, abs=1e-14)
    near = np.asarray(view.world_to_clip) @ [0, 0.5, 0, 1]
    assert near[3] == pytest.approx(view.camera.near_w)


def test_orthographic_height_is_the_pictures_height():
    view = View(Camera.orthographic((0, -3, 0), (0, 0, 0), height=4.0), 300, 200)
    np.testing.assert_allclose(screen(view, (1.0, 7.0, 2.0))[:2], (200, 200), atol=1e-12)


def test_stays_float64_without_jax_settings(view):
    assert isinstance(view.world_to_clip, np.ndarray)
    assert view.world_to_clip.dtype == np.float64


def test_gradient_by_the_eye_matches_finite_differences():
    def x_on_screen(eye):
        view = View(Camera.look_at(eye, (0.0, 0.0, 1.0)), 640, 480)
        p = view.world_to_screen @ jnp.array([0.3, 0.4, 0.5, 1.0])
        return p[0] / p[3]

    eye = np.array([4.0, -5.0, 3.0])
    gradient = jax.jit(jax.grad(x_on_screen))(eye)
    h = 1e-6
    numeric = [(float(x_on_screen(eye + h * e)) - float(x_on_screen(eye - h * e))) / (2 * h) for e in np.eye(3)]
    np.testing.assert_allclose(gradient, numeric, rtol=1e-6, atol=1e-6)


def test_frame_holds_every_point(rng):
    points = rng.normal(size=(200, 3)) * [5.0, 0.1, 2.0] + [100.0, 3.0, -7.0]
    view = View(frame(points), 400, 400)
    places = np.array([screen(view, p) for p in points])
    assert places[:, :2].min() >= 0
    assert places[:, :2].max() <= 400
    assert places[:, 2].min() > 0
    assert places[:, 2].max() < 1


@pytest.mark.parametrize("size", [(400, 900), (900, 400)])
def test_frame_knows_the_pictures_shape(size, rng):
    points = rng.normal(size=(300, 3))
    view = View(frame(points, aspect=size[0] / size[1]), *size)
    places = np.array([screen(view, p) for p in points])
    assert places[:, :2].min() >= 0
    assert np.all(places[:, :2].max(axis=0) <= size)


def test_views_can_be_keys(view):
    assert len({view, view, View(view.camera, 5, 5)}) == 2


def test_homogeneous():
    assert homogeneous(np.ones((2, 3)))[:, 3].tolist() == [1.0, 1.0]
    rational = np.full((2, 4), 2.0)
    assert homogeneous(rational) is rational


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        ({"fov_y": 0.0}, "fov_y"),
        ({"fov_y": 180.0}, "fov_y"),
        ({"near": 0.0}, "near"),
        ({"near": 2.0, "far": 1.0}, "beyond near"),
        ({"far": float("inf")}, "finite"),
        ({"near": float("nan")}, "near"),
        ({"eye": (0, 0, 1e200)}, "below 1e"),
        ({"up": (0, 1, 0)}, "parallel"),
        ({"target": (0, -5, 0)}, "coincide"),
        ({"eye": (0, float("nan"), 0)}, "eye must be finite"),
        ({"eye": (0, 1)}, "three numbers"),
    ],
)
def test_bad_cameras(arguments, says):
    with pytest.raises(InputError, match=says):
        Camera.look_at(**{"eye": (0, -5, 0), "target": (0, 0, 0), **arguments})


@pytest.mark.parametrize("size", [(0, 5), (5, -1), (2.5, 5), (float("nan"), 5), ("9", 5), (np.array(-3), 4)])
def test_bad_sizes(size):
    with pytest.raises(InputError, match="whole number of pixels"):
        View(Camera.look_at((0, -5, 0), (0, 0, 0)), *size)
