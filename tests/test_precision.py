"""Whatever precision numbers come in, and whatever JAX computes in: a factor may be loose or refused, never short."""

from __future__ import annotations

import subprocess
import sys
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import Camera, InputError, Session, View, load, sampled_error, screen_widths, tessellation_factors
from slefejax.arguments import floating


def bent(offset: np.ndarray) -> tuple[np.ndarray, View]:
    """A nearly flat quadratic patch of size 1 seen along its side, all of it moved."""
    u = np.array([-0.5, 0.0, 0.5])
    patch = np.zeros((1, 3, 3, 3))
    patch[0, ..., 1], patch[0, ..., 2] = u[:, None], u
    patch[0, :, 1, 0] = 0.024
    view = View(Camera.look_at(offset + (0.6, 2.1, 0.9), offset, (1, 0, 0), near=0.01), 1440, 900)
    return patch + offset, view


@pytest.mark.parametrize(
    "method", ["filip", *(pytest.param(x, marks=pytest.mark.slow) for x in ("certified", "slefe", "screen-box"))]
)
def test_double_patches_far_away_while_jax_is_single(method):
    """The origin is taken off before anything is rounded to float32: the same factor as in double precision."""
    patches, view = bent(np.array([1e6, 0.0, 0.0]))
    options: dict[str, Any] = {"tiles": 1} if method == "certified" else {}
    double = np.asarray(tessellation_factors(patches, view, method, **options).factor)
    with jax.enable_x64(False):
        found = tessellation_factors(patches, view, method, **options)
        assert found.factor.dtype == np.float32
        # rounding costs a certificate up to a hundredth, and makes nothing shorter
        assert double[0] * (1 - 1e-5) <= found.factor[0] <= double[0] * (1.01 if method == "certified" else 1 + 1e-4)
        if method == "certified":
            assert sampled_error(patches, found.inner, view)[0] <= 0.5
            assert sampled_error(patches, found.levels, view)[0] <= 0.5
        widths = screen_widths(patches, view)
    np.testing.assert_allclose(widths, screen_widths(patches, view), rtol=1e-4)


@pytest.mark.parametrize("dtype", [np.int32, np.int64])
def test_whole_numbers_far_away(dtype):
    offset = np.array([10**9, 0, 0])
    patch = np.array([[[[100 * i, 100 * j, 30 * i * j] for j in range(3)] for i in range(3)]])
    eye, target = offset + [300, -200, 300], offset + [100, 100, 0]
    view = View(Camera.look_at(eye, target, near=1.0, far=5000.0), 1440, 900)
    near = View(Camera.look_at(eye - offset, target - offset, near=1.0, far=5000.0), 1440, 900)
    expected = np.asarray(tessellation_factors(patch.astype(float), near, tiles=1).factor)
    for double in (True, False):
        with jax.enable_x64(double):
            found = tessellation_factors((patch + offset).astype(dtype), view, tiles=1)
            assert expected[0] * (1 - 1e-5) <= found.factor[0] <= expected[0] * 1.01
            assert sampled_error(patch + offset, found.levels, view)[0] <= 0.5


def test_whole_numbers_that_are_no_float64():
    with pytest.raises(InputError, match=r"beyond 2\^53"):
        floating(np.array([2**53 + 1]))
    assert floating(np.array([2**53])).dtype == np.float64
    assert floating(jnp.asarray([3], jnp.int32)).dtype == np.float64


@pytest.mark.parametrize("size", [1e-41, 1e-39, 1e-35, 1e-30, 1e30])
@pytest.mark.parametrize("tiles", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_single_scenes_of_any_size(size, tiles):
    """Denormal numbers, too: what is left of a scene in them is right to half a pixel."""
    rng = np.random.default_rng(0)
    patches = (rng.normal(size=(4, 3, 3, 3)) * size).astype(np.float32)
    view = View(Camera.look_at((0, -8 * size, 3 * size), (0, 0, 0), near=0.1 * size, far=100 * size), 800, 600)
    factors = tessellation_factors(patches, view, tiles=tiles)
    assert factors.factor.min() > 10
    assert np.all(sampled_error(patches, factors.levels, view) <= 0.5)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_double_scenes_of_any_size(dtype):
    with jax.enable_x64(dtype == np.float64):
        for size in (1e-300, 1e-200, 1e90):
            rng = np.random.default_rng(0)
            patches = rng.normal(size=(2, 3, 3, 3)) * size
            view = View(Camera.look_at((0, -8 * size, 3 * size), (0, 0, 0), near=0.1 * size, far=100 * size), 800, 600)
            found = tessellation_factors(patches, view, tiles=1).factor
            assert 20 < found[0] < 23


def test_traced_scenes_that_are_too_small_are_nan():
    """Inside of jit nobody can look at them and bring them to another size."""
    patches, _ = bent(np.zeros(3))

    def factor(points, size):
        view = View(
            Camera.look_at((0.6 * size, 2.1 * size, 0.9 * size), (0, 0, 0), (1, 0, 0), near=0.01 * size), 80, 60
        )
        return tessellation_factors(points, view, tiles=1).factor

    with jax.enable_x64(False):
        for size, known in ((1.0, True), (1e-15, True), (1e-36, False)):
            found = jax.jit(factor)((patches * size).astype(np.float32), np.float32(size))
            assert np.isfinite(found).all() == known


@pytest.mark.parametrize("method", ["certified", "slefe", "minmax", "edge-length", "screen-box", "fixed"])
def test_traced_weights_that_are_not_positive_are_nan(method):
    """With a weight of -1 or 0 among those of one patch; its neighbour in the batch is not concerned."""
    good = np.array([[[0, 0, 0, 1.0], [0, 1, 0, 1]], [[1, 0, 0, 1], [1, 1, 0, 1]]])
    view = View(Camera.look_at((0.5, 0.5, 4), (0.5, 0.5, 0), (0, 1, 0)), 800, 600)
    run = jax.jit(lambda points: tessellation_factors(points, view, method, tiles=1).factor)
    if method != "certified":
        run = jax.jit(lambda points: tessellation_factors(points, view, method).factor)
    for weight in (-1.0, 0.0):
        bad = good.copy()
        bad[1, 1] *= weight
        assert np.isfinite(run(np.stack([bad, good]))).tolist() == [False, True]


def test_a_traced_single_camera_is_not_short_for_double_patches():
    """Patches are rounded as they are traced: the certificate counts that, and far away it is loose."""
    for offset in (0.0, 300.0):
        patches, _ = bent(np.array([offset, 0.0, 0.0]))
        eye = np.array([offset + 0.6, 2.1, 0.9], np.float32)
        view = View(Camera.look_at(eye.astype(float), (offset, 0, 0), (1, 0, 0), near=0.01), 1440, 900)

        def factor(eye, patches=patches, offset=offset):
            camera = Camera.look_at(eye, (offset, 0.0, 0.0), (1, 0, 0), near=0.01)
            return tessellation_factors(patches, View(camera, 1440, 900), tiles=1).factor

        with jax.enable_x64(False):
            found = jax.jit(factor)(eye)
        assert sampled_error(patches, np.ceil(found).astype(int), view)[0] <= 0.5
        tight = tessellation_factors(patches, view, tiles=1).factor
        assert found[0] >= tight[0] * (1 - 1e-3)
        assert found[0] <= tight[0] * (1.02 if offset == 0 else 2.0)


@pytest.mark.parametrize("offset", [pytest.param(0.0, marks=pytest.mark.slow), 1e4])
def test_single_sessions_of_double_scenes(tmp_path, offset):
    """A session in single precision rounds the scene: its certificate counts that."""
    patches = load("teapot").patches()[:4] + [offset, 0.0, 0.0]
    nets = ["\n".join(" ".join(map(repr, point)) for point in net.reshape(-1, 3).tolist()) for net in patches]
    (tmp_path / "part.bpt").write_text("\n".join(["4", *(f"3 3\n{net}" for net in nets)]) + "\n")
    scene = load(tmp_path / "part.bpt")
    view = View(scene.default_camera(), 640, 400)
    single = Session(scene, dtype=np.float32, tiles=1).factors(view)
    assert single.factor.dtype == np.float32
    assert np.all(sampled_error(scene.patches(), single.levels, view) <= 0.5)
    double = np.asarray(Session(scene, tiles=1).factors(view).factor)
    assert np.all(np.asarray(single.factor) >= double * (1 - 1e-3))
    assert np.all(np.asarray(single.factor) <= double * (1.01 if offset == 0 else 10.0))


def test_a_traced_single_camera_warns_of_nothing():
    """In a process of its own, with warnings as errors and JAX as it comes."""
    code = """
import jax, numpy as np, slefejax as sj
patches = np.array([[[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, .5]]]], np.float32)
def total(eye, near, height):
    views = [sj.View(sj.Camera.look_at(eye, (0.5, 0.5, 0.0), near=near), 640, 400),
             sj.View(sj.Camera.orthographic(eye, (0.5, 0.5, 0.0), height=height, near=near), 640, 400)]
    return sum(sj.tessellation_factors(patches, view, "minmax").factor.sum() for view in views)
print(jax.jit(total)(np.array([3.0, 2, 2], np.float32), np.float32(.1), np.float32(2)))
"""
    done = subprocess.run([sys.executable, "-W", "error", "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
