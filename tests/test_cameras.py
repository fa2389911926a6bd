"""Cameras all around a scene."""

from __future__ import annotations

import numpy as np
import pytest

from slefejax import Camera, InputError, Scene, cameras_around, load
from slefejax.experiments.options import ViewOptions


def test_cameras_are_reproducible_and_hold_the_scene(teapot):
    views = cameras_around(teapot, 160, 100, 12, seed=3)
    again = cameras_around(teapot, 160, 100, 12, seed=3)
    other = cameras_around(teapot, 160, 100, 12, seed=4)
    assert np.array_equal(views[0].camera.eye, (4.5, -6.0, 4.0))
    assert all(np.array_equal(a.camera.eye, b.camera.eye) for a, b in zip(views, again, strict=True))
    assert not np.array_equal(views[1].camera.eye, other[1].camera.eye)
    points = np.column_stack([teapot.points(), np.ones(len(teapot.points()))])
    for view in views[1:]:
        x, y, z, w = view.world_to_screen @ points.T
        assert np.all((w > 0) & (x >= 0) & (x <= 160 * w) & (y >= 0) & (y <= 100 * w) & (z >= 0) & (z <= w))


def far_teapot():
    """A hundred times as large, behind the far plane of its own camera."""
    return Scene("far", 100 * load("teapot").patches(), Camera.look_at((450, -600, 400), (0, 0, 120)))


@pytest.mark.parametrize("name", ["teapot", "walker", "steep-patch", "far"])
def test_the_first_is_the_view_of_the_commands(name):
    scene = far_teapot() if name == "far" else load(name)
    own, wanted = cameras_around(scene, 320, 200, 1)[0], ViewOptions(size="320x200").view(scene)
    assert (own.width, own.height) == (320, 200)
    for field in ("eye", "target", "up", "extent", "near", "far", "perspective"):
        assert np.array_equal(getattr(own.camera, field), getattr(wanted.camera, field)), field


def test_cameras_are_spread_over_the_sphere(teapot):
    """No hemisphere without one, none much closer to another than on average."""
    eyes = np.array([view.camera.eye - view.camera.target for view in cameras_around(teapot, 160, 100, 41, 5)[1:]])
    places = eyes / np.linalg.norm(eyes, axis=1, keepdims=True)
    assert np.linalg.norm(places.mean(axis=0)) < 0.1
    near = places @ places.T - 2.0 * np.eye(40)
    assert np.degrees(np.arccos(near.max(axis=1))).min() > 10.0


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"scene": "teapot"}, "cameras look at a slefejax.Scene, as load gives it, not at str"),
        ({"width": 0}, "width must be a whole number of at least 1, not 0"),
        ({"height": 10.5}, "height must be a whole number of at least 1, not 10.5"),
        ({"count": 0}, "count must be a whole number of at least 1, not 0"),
        ({"seed": -1}, "seed must be a whole number of at least 0, not -1"),
        ({"scene": Scene("far", np.full((1, 2, 2, 3), np.nan))}, "coordinates must be finite"),
    ],
)
def test_bad_input_is_one_sentence(teapot, change, says):
    with pytest.raises(InputError, match=says):
        cameras_around(**{"scene": teapot, "width": 160, "height": 100, "count": 3, "seed": 1, **change})
