from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import jax
import numpy as np
import pytest

from slefejax import Camera, InputError, View
from slefejax.experiments.studies.measures import pixels, slips
from slefejax.measure.error import SLIPPED, drawn_error, pixel_error, slip, surface_on_screen


def bernstein3(t):
    return np.array([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3])


def test_position_by_plain_numpy(teapot, main_view, rng, precision):
    patch, u, v = rng.integers(0, 32, 50), rng.random(50), rng.random(50)
    patches = teapot.patches().astype(precision)
    found = surface_on_screen(patches, main_view, patch, u, v)
    assert found.dtype == np.float64, "what is measured is, in double precision, whatever is drawn"
    for n in range(50):
        point = np.einsum("i,j,ijc->c", bernstein3(u[n]), bernstein3(v[n]), patches[patch[n]].astype(float))
        x = main_view.world_to_screen @ np.append(point, 1.0)
        np.testing.assert_allclose(found[n], x[:3] / x[3], rtol=1e-12)


def test_rational_quarter_circle():
    """An exact arc: its points are at distance 1 from the axis."""
    w = np.sqrt(0.5)
    arc = np.array([[1, 0, 0, 1], [w, w, 0, w], [0, 1, 0, 1]], float)
    tube = np.stack([arc, arc + [0, 0, 1, 0] * arc[:, 3:]], axis=1)[None]
    view = View(Camera.orthographic((0, 0, 5), (0, 0, 0), up=(0, 1, 0), height=4.0), 400, 400)
    t = np.linspace(0, 1, 9)
    x, y, _ = surface_on_screen(tube, view, np.zeros(9, int), t, t * 0).T
    np.testing.assert_allclose(np.hypot(x - 200, y - 200), 100.0, rtol=1e-13)


def test_error_is_the_larger_coordinate_and_nan_where_nothing_is():
    square = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)[None]
    view = View(Camera.orthographic((0.5, 0.5, 5), (0.5, 0.5, 0), up=(0, 1, 0), height=1.0), 4, 4)
    u, v = np.meshgrid((np.arange(4) + 0.5) / 4, (np.arange(4) + 0.5) / 4)
    patch = np.zeros((4, 4), int)
    patch[3, 3] = -1
    u[0, 1] += 0.3 / 4
    v[0, 1] -= 0.7 / 4
    error = pixel_error(square, view, u, v, patch)
    assert np.isnan(error[3, 3])
    assert error[0, 1] == pytest.approx(0.7, abs=1e-12)
    assert np.nansum(error) == pytest.approx(0.7, abs=1e-12)
    assert np.all(np.isnan(pixel_error(square, view, u, v, patch * 0 - 1)))


def test_error_from_where_it_was_drawn_and_slip_apart():
    """The point belongs 0.3 px to the right of the centre and was drawn 0.25 px to the left, and 1/16 px above."""
    square = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)[None]
    view = View(Camera.orthographic((0.5, 0.5, 5), (0.5, 0.5, 0), up=(0, 1, 0), height=1.0), 4, 4)
    u, v = np.meshgrid((np.arange(4) + 0.5) / 4, (np.arange(4) + 0.5) / 4)
    patch, drawn = np.zeros((4, 4), int), np.zeros((4, 4, 2))
    patch[3, 3] = -1
    u[2, 1] += 0.3 / 4
    drawn[2, 1] = -0.25, 1 / 16
    seen: Any = SimpleNamespace(u=u, v=v, patch=patch, drawn=drawn)
    assert pixel_error(square, view, u, v, patch)[2, 1] == pytest.approx(0.3, abs=1e-12)
    error = drawn_error(square, view, seen)
    assert error[2, 1] == pytest.approx(0.55, abs=1e-12)
    assert np.nansum(error) == pytest.approx(0.55, abs=1e-12)
    assert np.array_equal(error, pixel_error(square, view, u, v, patch, drawn), equal_nan=True)
    assert slip(seen)[2, 1] == 0.25
    assert np.nansum(slip(seen)) == 0.25
    assert np.isnan(slip(seen)[3, 3])
    assert slips(seen) == {"slipped_pixels": 1, "max_slip_px": 0.25}
    drawn[2, 1] = SLIPPED, -SLIPPED
    assert slips(seen)["slipped_pixels"] == 0, "above, not from on"
    row = pixels(SimpleNamespace(error=drawn_error(square, view, seen), seen=seen))
    assert (row["covered_pixels"], row["share_above_0.1"]) == (15, 1 / 15)
    patch[:] = -1
    assert slips(seen) == {"slipped_pixels": 0, "max_slip_px": 0.0}


def test_points_behind_the_camera_are_infinitely_wrong():
    square = np.array([[[0, -9, 0], [0, -9, 1]], [[1, -9, 0], [1, -9, 1]]], float)[None]
    view = View(Camera.look_at((0, -5, 0), (0, 0, 0)), 2, 2)
    half, first = np.full((2, 2), 0.5), np.zeros((2, 2), int)
    assert np.all(np.isposinf(pixel_error(square, view, half, half, first)))
    assert np.all(np.isposinf(pixel_error(square + [0, 4, 0], view, half, half, first)))
    with pytest.raises(InputError, match="from 0 to 0, not 1 to 1"):
        pixel_error(square, view, half, half, first + 1)


def test_float64_whatever_the_settings(teapot, main_view):
    patch, u = np.arange(32), np.full(32, 0.3)
    wanted = surface_on_screen(teapot.patches(), main_view, patch, u, u)
    with jax.enable_x64(False):
        assert np.array_equal(surface_on_screen(teapot.patches(), main_view, patch, u, u), wanted)


@pytest.mark.gl
@pytest.mark.parametrize(("side", "error"), [(1.1, 12.5), (1.5, 62.5)])
def test_twist_as_measured(device, side, error):
    """A flat 500 px quad with one side 1.1 (1.5) times as long, drawn as one quad: off by 12.5 (62.5) px."""
    from slefejax.gpu import Renderer

    quad = np.array([[[0, 0, 0], [0, 500, 0]], [[500, 0, 0], [500 * side, 500, 0]]], float)[None]
    camera = Camera.orthographic((400, 300, 5), (400, 300, 0), up=(0, 1, 0), height=600.0)
    view = View(camera, 800, 600)
    one = np.ones((1, 6), int)
    renderer = Renderer(quad, device)
    seen = renderer.draw(view, one[:, :2], one[:, 2:])
    worst = np.nanmax(drawn_error(quad, view, seen))
    # the worst point need not be a pixel's centre, and the renderer has its floor
    assert worst == pytest.approx(error, rel=0.01)


@pytest.mark.gl
def test_bad_pixels_vanish_as_factors_grow(device, teapot, main_view):
    from slefejax import tessellation_factors
    from slefejax.gpu import Renderer

    factors = tessellation_factors(teapot.patches(), main_view, "slefe")
    renderer = Renderer(teapot.patches(), device)
    shares = []
    for scale in (0.25, 0.5, 1.0, 2.0):
        scaled = factors.scaled(scale)
        # each patch's own level on its edges: transition rings have errors of their own
        seen = renderer.draw(main_view, scaled.inner, np.repeat(scaled.levels[:, None], 4, axis=1))
        error = drawn_error(teapot.patches(), main_view, seen)
        shares.append(np.mean(error[np.isfinite(error)] > 0.5))
    assert shares == sorted(shares, reverse=True)
    assert shares[0] > 0.5
    assert shares[-1] == 0.0
