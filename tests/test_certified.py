"""The certified factor: is it ever exceeded, how close is it, and what does it say of odd input?"""

from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import (
    Camera,
    InputError,
    View,
    minimal_factors,
    sampled_error,
    tessellation_factors,
    triangle_error,
)
from slefejax.cameras import cameras_around
from slefejax.tessellator.levels import triangle_counts

from .hostile import case

AFFORDABLE = 40  # levels whose error is measured


def suitable_tolerance(patches, view, **options):
    """One at which half of the patches need fewer than about ten cells a side."""
    factor = np.asarray(tessellation_factors(patches, view, tiles=1, **options).factor)
    seen = factor[factor > 0]
    return 0.5 * (np.median(seen) / 10.0) ** 2 if seen.size else None


def violations(seed, count, tiles, dtype=np.float64):
    """(pairs looked at, descriptions of those that break the tolerance) on uniform grids of n and a few more cells."""
    hostile = case(seed, count)
    hostile = replace(hostile, patches=hostile.patches.astype(dtype))
    tolerance = suitable_tolerance(hostile.patches, hostile.view)
    if tolerance is None:
        return 0, []
    factors = tessellation_factors(hostile.patches, hostile.view, tiles=tiles, tolerance=tolerance)
    levels = factors.levels
    unseen = np.where(levels == 0, 4, 0)
    broken = list(np.flatnonzero(sampled_error(hostile.patches, unseen, hostile.view) > 0))
    more = np.random.default_rng(seed).integers(0, 4, count) * np.random.default_rng(seed + 1).integers(0, 2, count)
    cut = np.where((levels > 0) & (levels <= AFFORDABLE), levels + more, 0)
    error = sampled_error(hostile.patches, cut, hostile.view)
    broken += list(np.flatnonzero(error > tolerance))
    return np.count_nonzero(cut) + np.count_nonzero(unseen), [f"{hostile.name}, patch {k}" for k in broken]


@pytest.mark.parametrize("seed", [11, 24, 30, *(pytest.param(x, marks=pytest.mark.slow) for x in (25, 36, 49))])
def test_uniform_grids_of_hostile_patches_hold(seed, precision):
    """Errors are measured of the rounded patches, in double precision, with nothing to spare."""
    pairs, broken = violations(seed, 48, 1, precision)
    assert broken == []
    assert pairs > 0


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 420, 20))
def test_many_uniform_grids_of_hostile_patches_hold(first):
    """137,304 pairs of patch and view in all, no less than 4,762 (10^5 / 21) in each part."""
    found = [violations(seed, 512, tiles=1 + seed % 3) for seed in range(first, first + 20)]
    assert [text for _, broken in found for text in broken] == []
    assert sum(pairs for pairs, _ in found) > 4762


@pytest.mark.slow
@pytest.mark.parametrize("tiles", [2, 3])
def test_more_tiles_hold_too(tiles):
    broken = [text for seed in (0, 7, 9, 13, 16, 21, 27, 29, 33) for text in violations(seed, 128, tiles)[1]]
    assert broken == []


def drawn_violations(seed, count, device, anisotropic=False):
    """Triangles as the tessellator makes them, every edge shared with that of some other patch."""
    from slefejax.gpu import Renderer

    hostile = case(seed, count)
    tolerance = suitable_tolerance(hostile.patches, hostile.view)
    if tolerance is None:
        return 0, []
    numbers = np.random.default_rng(seed).permutation(4 * count).reshape(count, 4) // 2
    factors = tessellation_factors(
        hostile.patches, hostile.view, tiles=1, tolerance=tolerance, edge_numbers=numbers, anisotropic=anisotropic
    )
    drawable = np.maximum(factors.inner.max(axis=1), factors.edges.max(axis=1)) <= 64
    inner = np.where(drawable[:, None], factors.inner, 0)
    edges = np.where(drawable[:, None], factors.edges, 0)
    for number in np.unique(numbers):
        own = factors.edges[numbers == number]
        assert len(set(own[own > 0].tolist())) <= 1, "the neighbours agree"
    renderer = Renderer(hostile.patches, device)
    error = triangle_error(hostile.patches, renderer.capture(hostile.view, inner, edges), hostile.view)
    renderer.release()
    broken = [f"{hostile.name}, patch {k}" for k in np.flatnonzero(error > tolerance)]
    return int(np.count_nonzero(drawable & (factors.levels > 0))), broken


@pytest.mark.slow
@pytest.mark.gl
@pytest.mark.parametrize("seed", [25, 30])
def test_drawn_triangles_of_hostile_patches_hold(device, seed):
    pairs, broken = drawn_violations(seed, 24, device)
    assert broken == []
    assert pairs > 0


@pytest.mark.gl
@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 60, 6))
def test_many_drawn_triangles_of_hostile_patches_hold(device, first):
    found = [drawn_violations(seed, 256, device, seed % 3 == 0) for seed in range(first, first + 6)]
    assert [text for _, broken in found for text in broken] == []


def test_the_teapot_is_held_and_nearly_minimal(teapot, main_view):
    minimal = minimal_factors(teapot.patches(), main_view)
    large = minimal >= 8
    for tiles, median, p95 in ((1, 1.09, 1.25), (2, 1.06, 1.20)):
        levels = tessellation_factors(teapot.patches(), main_view, tiles=tiles).levels
        assert np.all(levels >= minimal)
        ratio = levels[large] / minimal[large]
        assert np.median(ratio) <= median
        assert np.quantile(ratio, 0.95) <= p95
    assert np.all(sampled_error(teapot.patches(), levels, main_view) <= 0.5)


@pytest.mark.slow
def test_the_teapot_from_all_sides(teapot):
    ratios = []
    for view in cameras_around(teapot, 1440, 900, 21, 1):
        minimal = minimal_factors(teapot.patches(), view)
        levels = tessellation_factors(teapot.patches(), view).levels
        assert np.all(levels >= minimal)
        ratios.append((levels / np.maximum(minimal, 1))[minimal >= 8])
    ratio = np.concatenate(ratios)
    assert np.median(ratio) <= 1.06
    assert np.quantile(ratio, 0.95) <= 1.20


def test_proved_cell_by_cell(teapot, main_view):
    patches = teapot.patches()[::3]
    minimal = minimal_factors(patches, main_view)
    plain = tessellation_factors(patches, main_view).levels
    proved = tessellation_factors(patches, main_view, verify=True).levels
    assert np.all(minimal <= proved)
    assert np.all(proved <= plain)
    assert np.median(proved / minimal) <= 1.02
    for levels in (proved, plain):
        assert np.all(sampled_error(patches, levels, main_view) <= 0.5)


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 60, 10))
def test_proofs_of_hostile_patches_hold(first):
    smaller = 0
    for seed in range(first, first + 10):
        hostile = case(seed, 64)
        tolerance = suitable_tolerance(hostile.patches, hostile.view)
        if tolerance is None:
            continue
        plain = tessellation_factors(hostile.patches, hostile.view, tiles=1, tolerance=tolerance).levels
        found = tessellation_factors(hostile.patches, hostile.view, tiles=1, tolerance=tolerance, verify=True).levels
        smaller += np.count_nonzero(found < plain)
        levels = np.where(found <= AFFORDABLE, found, 0)
        assert np.all(sampled_error(hostile.patches, levels, hostile.view) <= tolerance), hostile.name
    assert smaller > 0


@pytest.mark.gl
@pytest.mark.slow
def test_drawn_teapot_holds_with_its_rings(teapot, main_view, device):
    from slefejax.gpu import Renderer

    renderer = Renderer(teapot.patches(), device)
    triangles = []
    for anisotropic in (False, True):
        factors = tessellation_factors(teapot.patches(), main_view, anisotropic=anisotropic)
        captured = renderer.capture(main_view, factors.inner, factors.edges)
        assert np.all(triangle_error(teapot.patches(), captured, main_view) <= 0.5)
        triangles.append(triangle_counts(factors.inner, factors.edges).sum())
    renderer.release()
    assert triangles[1] <= 0.85 * triangles[0]


def test_pairs_save_triangles(teapot, main_view):
    factors = tessellation_factors(teapot.patches(), main_view, anisotropic=True)
    pairs = np.ceil(np.asarray(factors.pairs) - 1e-9).astype(int)
    assert np.all(sampled_error(teapot.patches(), pairs, main_view) <= 0.5)
    assert 2 * np.prod(pairs, axis=1).sum() <= 0.85 * 2 * (factors.levels**2).sum()


def assert_is_just_above(factor, exact):
    """By what the bound counts for rounding: some thousand eps of the numbers that it is made of."""
    assert exact <= float(factor) <= exact * (1 + 2e4 * np.finfo(factor.dtype).eps)


def test_twisted_quad(precision):
    """62.5 px for one cell (docs/math.md, 5), a quarter for each halving: 12 cells at half a pixel."""
    quad = np.array([[[[0.0, 0, 0], [0, 500, 0]], [[500, 0, 0], [750, 500, 0]]]], precision)
    view = View(Camera.orthographic((400, 300, 5), (400, 300, 0), up=(0, 1, 0), height=900.0), 1440, 900)
    for tiles in (1, 2):
        factor = tessellation_factors(quad, view, tiles=tiles).factor
        assert factor.dtype == precision
        assert_is_just_above(factor[0], np.sqrt(62.5 / 0.5))


def test_parabola_is_exact(precision):
    """x = 100 u^2: error 100/(4 n^2)."""
    parabola = np.zeros((1, 3, 2, 3), precision)
    parabola[0, 2, :, 0], parabola[0, :, 1, 1] = 100.0, 50.0
    view = View(Camera.orthographic((50, 25, 5), (50, 25, 0), up=(0, 1, 0), height=200.0), 200, 200)
    factor = tessellation_factors(parabola, view).factor
    assert factor.dtype == precision
    assert_is_just_above(factor[0], np.sqrt(25 / 0.5))


@pytest.mark.slow
def test_rational_patches_are_nearly_minimal():
    """A quarter of a torus: second derivatives of W are as large as those of X, and s goes along with the place."""
    half = np.sqrt(0.5)
    arc = np.array([[1.0, 0.0, 1.0], [half, half, half], [0.0, 1.0, 1.0]])  # (w x, w y, w) of a quarter of a circle
    torus = np.zeros((1, 3, 3, 4))
    for i, (x, y, w) in enumerate(arc):
        for j, (radius, height, weight) in enumerate(arc):
            torus[0, i, j] = [x * (2 * weight + radius), y * (2 * weight + radius), w * height, w * weight]
    view = View(Camera.look_at((5.0, -3.0, 4.0), (1.2, 1.2, 0.3)), 1440, 900)
    minimal = minimal_factors(torus, view)[0]
    assert minimal >= 20
    for tiles, most in ((1, 1.45), (2, 1.15), (4, 1.06)):
        levels = tessellation_factors(torus, view, tiles=tiles).levels
        assert minimal <= levels[0] <= most * minimal
        assert sampled_error(torus, levels, view)[0] <= 0.5


def test_straight_patches_need_one_piece_and_unseen_ones_none(main_view):
    straight = np.zeros((2, 4, 4, 3))
    straight[..., 0], straight[..., 1] = np.linspace(0, 1, 4)[:, None], np.linspace(0, 1, 4)
    straight[1] += 2 * np.asarray(main_view.camera.eye)
    factors = tessellation_factors(straight, main_view)
    np.testing.assert_allclose(factors.factor, [1.0, 0.0], atol=1e-9)
    assert factors.inner.tolist()[1] == [0, 0]
    assert factors.edges.tolist()[1] == [0, 0, 0, 0]


def test_depth_is_held(teapot, main_view):
    patches = teapot.patches()
    tolerance = 1e-6
    factors = tessellation_factors(patches, main_view, tolerance=1e6, depth_tolerance=tolerance)
    assert factors.levels.max() > 2
    # window depth as if it were a picture's row: one pixel wide pictures of depth
    screen = main_view.world_to_screen
    t = np.linspace(0.0, 1.0, 97)
    from slefejax.geometry.bezier import evaluate_patch

    for patch, n in zip(patches[:6], factors.levels[:6], strict=True):
        u, v = (x.ravel() for x in np.meshgrid(t, t, indexing="ij"))
        points = evaluate_patch(patch[..., None], u, v)
        exact = (screen[2, :3] @ points + screen[2, 3]) / (screen[3, :3] @ points + screen[3, 3])
        i, j = (np.minimum(np.floor(x * n), n - 1) for x in (u, v))
        a, b = u * n - i, v * n - j
        ends = [evaluate_patch(patch[..., None], (i + k) / n, (j + m) / n) for k in (0, 1) for m in (0, 1)]
        p00, p01, p10, p11 = ends
        drawn = np.where(a >= b, p00 + a * (p10 - p00) + b * (p11 - p10), p00 + b * (p01 - p00) + a * (p11 - p01))
        depth = (screen[2, :3] @ drawn + screen[2, 3]) / (screen[3, :3] @ drawn + screen[3, 3])
        assert np.abs(exact - depth).max() <= tolerance


@pytest.mark.slow
def test_single_precision_is_safe_too(teapot, main_view):
    single = tessellation_factors(teapot.patches().astype(np.float32), main_view).factor
    double = tessellation_factors(teapot.patches(), main_view).factor
    assert single.dtype == np.float32
    assert np.all(single >= double)
    np.testing.assert_allclose(single, double, rtol=0.01)


def check_gradients(points, eye, tiles):
    """Reverse mode against central differences, along random directions and by the camera's place."""

    @jax.jit
    def total(points, eye):
        view = View(Camera.look_at(eye, (0.0, 0.0, 1.2)), 1440, 900)
        return tessellation_factors(points, view, tiles=tiles).factor.sum()

    by_points, by_eye = jax.jit(jax.grad(total, argnums=(0, 1)))(points, eye)
    assert np.isfinite(by_points).all()
    rng = np.random.default_rng(5)
    for _ in range(3):
        direction = rng.normal(size=points.shape)
        h = 1e-7
        slope = (total(points + h * direction, eye) - total(points - h * direction, eye)) / (2 * h)
        assert float(jnp.vdot(by_points, direction)) == pytest.approx(float(slope), rel=1e-4)
    for axis in np.eye(3):
        slope = (total(points, eye + 1e-6 * axis) - total(points, eye - 1e-6 * axis)) / 2e-6
        assert float(by_eye @ axis) == pytest.approx(float(slope), rel=1e-4, abs=1e-6)


def test_gradients_against_differences(rng):
    quads = jnp.asarray(rng.normal(size=(5, 2, 2, 3)) + [0.0, 0.0, 1.2])
    check_gradients(quads, jnp.asarray([4.5, -6.0, 4.0]), 1)


@pytest.mark.slow
def test_gradients_on_the_teapot(teapot, rng):
    """A little off the teapot: its symmetries make coefficients equal, where the largest has no derivative."""
    points = teapot.patches()[:8] + 1e-3 * rng.normal(size=(8, 4, 4, 3))
    check_gradients(jnp.asarray(points), jnp.asarray([4.5, -6.0, 4.0]), 2)


@pytest.mark.slow
def test_forward_mode_and_second_derivatives(rng, main_view):
    """Along one direction: slopes of both modes agree, and the slope of the slope with differences of it."""
    points, direction = jnp.asarray(rng.normal(size=(2, 4, 2, 2, 3)) + [0.0, 0.0, 1.2])

    def along(t):
        return tessellation_factors(points + t * direction, main_view, tiles=1).factor.sum()

    slope = jax.jit(jax.jacfwd(along))
    assert float(slope(0.0)) == pytest.approx(float(jax.grad(along)(0.0)), rel=1e-12)
    bend = float(jax.jit(jax.jacfwd(jax.jacfwd(along)))(1e-3))
    h = 1e-6
    assert bend == pytest.approx(float(slope(1e-3 + h) - slope(1e-3 - h)) / (2 * h), rel=1e-4)


@pytest.mark.slow
def test_traced_tolerances(teapot, main_view):
    """What cannot be refused inside of jit is not a number; it is not 0, which stands for unseen."""
    factors = jax.jit(lambda t: tessellation_factors(teapot.patches(), main_view, tolerance=t).factor)
    assert np.isnan(factors(-0.5)).all()
    # Under jit coordinates are relative to the eye, otherwise to a point near the patches: they round differently
    np.testing.assert_allclose(factors(0.5), tessellation_factors(teapot.patches(), main_view).factor, rtol=1e-11)


@pytest.mark.slow
@pytest.mark.parametrize("tiles", [2, 3])
def test_tiles_off_the_screen_need_not_be_cut(rng, tiles):
    """Half of each patch is far to the right of the picture and curved; no visible point is wrong for it."""
    u = np.linspace(0, 1, 4)
    patches = np.zeros((40, 4, 4, 3))
    patches[..., 0], patches[..., 1] = 900 * u[:, None] - 100, 200 * u
    patches[:, 3] += rng.normal(size=(40, 4, 3)) * [60, 60, 0]
    view = View(Camera.orthographic((150, 100, 5), (150, 100, 0), up=(0, 1, 0), height=300.0), 300, 300)
    one = tessellation_factors(patches, view, tiles=1)
    more = tessellation_factors(patches, view, tiles=tiles)
    assert np.mean(more.levels / one.levels) < 0.95
    for extra in range(4):
        assert sampled_error(patches, more.levels + extra, view).max() <= 0.5


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tiles": 0}, "tiles must be a whole number"),
        (
            {"method": "slefe", "anisotropic": True},
            "method 'slefe' has no anisotropic: its own are segments, k, smooth",
        ),
        ({"method": "filip", "verify": True}, "method 'filip' has no verify: it has nothing to set"),
    ],
)
def test_bad_options(teapot, main_view, options, message):
    with pytest.raises(InputError, match=message):
        tessellation_factors(teapot.patches(), main_view, **options)


def test_whole_numbers_cannot_be_traced(teapot, main_view):
    with pytest.raises(InputError, match="outside of jit"):
        jax.jit(lambda p: tessellation_factors(p, main_view, anisotropic=True).factor)(teapot.patches())
