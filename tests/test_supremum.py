from __future__ import annotations

import numpy as np
import pytest

from slefejax import (
    Camera,
    InputError,
    View,
    minimal_factors,
    minimal_pairs,
    sampled_error,
    tessellation_factors,
    triangle_error,
    worst_points,
)
from slefejax.geometry.view import homogeneous
from slefejax.measure import supremum
from slefejax.measure.triangles import DomainTriangles


def flat_view(width=800, height=600):
    """A pixel is a unit of the plane z = 0, seen from above."""
    centre = (width / 2, height / 2)
    return View(Camera.orthographic((*centre, 5), (*centre, 0), up=(0, 1, 0), height=float(height)), width, height)


def quad(side):
    return np.array([[[0, 0, 0], [0, 500, 0]], [[500, 0, 0], [500 * side, 500, 0]]], float)[None]


def parabola(height):
    patch = np.zeros((1, 3, 2, 3))
    patch[0, :, :, 0] = np.array([0, 50, 100])[:, None]
    patch[0, 2, :, 1] = height
    patch[0, :, 1, 2] = 1
    return patch


def error_by_loops(patch, view, nu, nv, samples):
    """Dense plain sampling of one patch: every cell, both diagonals, visible points only."""
    control = homogeneous(patch) @ view.world_to_screen.T
    du, dv = (n - 1 for n in patch.shape[:2])

    def point(u, v):
        from math import comb

        bu = np.array([comb(du, i) * u**i * (1 - u) ** (du - i) for i in range(du + 1)])
        bv = np.array([comb(dv, j) * v**j * (1 - v) ** (dv - j) for j in range(dv + 1)])
        return np.einsum("i,j,ijc->c", bu, bv, control)

    worst = 0.0
    for i in range(nu):
        for j in range(nv):
            corner = {(a, b): point((i + a) / nu, (j + b) / nv) for a in (0, 1) for b in (0, 1)}
            for a in np.linspace(0, 1, samples):
                for b in np.linspace(0, 1, samples):
                    exact = point((i + a) / nu, (j + b) / nv)
                    step = corner[1, 0] - corner[0, 0], corner[0, 1] - corner[0, 0]
                    rise = corner[1, 1] - corner[1, 0], corner[1, 1] - corner[0, 1]
                    rising = corner[0, 0] + (a * step[0] + b * rise[0] if a >= b else b * step[1] + a * rise[1])
                    if a + b <= 1:
                        falling = corner[0, 0] + a * step[0] + b * step[1]
                    else:
                        falling = corner[1, 1] - (1 - a) * rise[1] - (1 - b) * rise[0]
                    for drawn in (rising, falling):
                        x, y, z, w = drawn
                        if w > 0 and 0 <= x <= view.width * w and 0 <= y <= view.height * w and 0 <= z <= w:
                            if exact[3] <= 0:
                                return np.inf
                            worst = max(worst, *np.abs(drawn[:2] / w - exact[:2] / exact[3]))
    return worst


@pytest.mark.parametrize(("side", "error"), [(1.1, 12.5), (1.5, 62.5)])
def test_twist_as_measured(side, error):
    """docs/math.md, 5: a flat 500 px quad, one side 1.1 (1.5) times as long, as one quad; at its middle."""
    found = worst_points(quad(side), [1], flat_view())
    assert found.error[0] == pytest.approx(error, abs=1e-9)
    assert (found.u[0], found.v[0]) == (0.5, 0.5)


@pytest.mark.parametrize("n", [1, 2, 3, 7, 50])
def test_parabola_by_hand(n):
    """y = A u^2: A / (4 n^2)."""
    assert sampled_error(parabola(200.0), [n], flat_view())[0] == pytest.approx(200.0 / (4 * n * n), rel=1e-9)


def test_published_figures_of_the_teapot(teapot, main_view):
    """docs/math.md, 5: 97 % and 19 % of the patches above 1/2 and 1 px, at most 1.68; 34 % and .86 with root 2."""
    for tolerance, above_half, above_one, largest in ((1.0, 31, 6, 1.68), (0.5, 11, 0, 0.86)):
        factors = tessellation_factors(teapot.patches(), main_view, "slefe", tolerance=tolerance)
        error = sampled_error(teapot.patches(), factors, main_view)
        assert np.count_nonzero(error > 0.5) == above_half
        assert np.count_nonzero(error > 1.0) == above_one
        assert error.max() == pytest.approx(largest, abs=0.006)


@pytest.mark.parametrize("levels", [(1, 1), *(pytest.param(x, marks=pytest.mark.slow) for x in ((2, 3), (4, 4)))])
def test_against_dense_loops(levels, rng):
    """Within 1 %, from below but for what the loops themselves miss; perspective, the screen's edge, rational."""
    view = View(Camera.look_at((0, -5, 1), (0, 0, 0)), 300, 200)
    patches = rng.normal(size=(6, 4, 3, 3)) * 0.7
    weights = rng.uniform(0.5, 2.0, (6, 4, 3, 1))
    for batch in (patches, patches + [1.6, 0, 0], np.concatenate([patches * weights, weights], axis=-1)):
        found = sampled_error(batch, np.full((6, 2), levels), view)
        wanted = [error_by_loops(patch, view, levels[0], levels[1], 41) for patch in batch]
        # at the border of the screen the visible part is only sampled, by either
        slack = 0.03 if batch is not patches else 0.01
        np.testing.assert_allclose(found, wanted, rtol=slack, atol=1e-9)


def test_points_behind_the_camera():
    """A patch through the camera's plane: its drawn triangles are on the screen where the exact surface is behind."""
    view = View(Camera.look_at((0, 0, 0), (0, 1, 0), near=0.01), 200, 200)
    patch = np.zeros((1, 3, 2, 3))
    patch[0, :, :, 1] = np.array([1.0, -3.0, 1.0])[:, None]
    patch[0, :, :, 0] = np.array([-0.2, 0, 0.2])[:, None]
    patch[0, :, 1, 2] = 0.1
    assert np.isposinf(sampled_error(patch, [1], view)[0])
    assert sampled_error(patch + [0, -50, 0], [1], view)[0] == 0.0
    assert minimal_factors(patch + [0, -50, 0], view).tolist() == [0]


def test_factors_zero_are_not_drawn_and_bad_ones_are_refused(teapot, main_view):
    assert sampled_error(teapot.patches(), np.zeros(32, int), main_view).tolist() == [0.0] * 32
    for bad in (np.ones(31, int), np.full(32, 1.5), -np.ones(32, int), np.ones((32, 3), int)):
        with pytest.raises(InputError, match="factors"):
            sampled_error(teapot.patches(), bad, main_view)


def test_points_that_are_not_finite_are_named(teapot, main_view):
    patches = teapot.patches().copy()
    patches[3, 0, 0, 0] = np.nan
    for call in (
        lambda: sampled_error(patches, np.full(32, 4), main_view),
        lambda: minimal_factors(patches, main_view),
    ):
        with pytest.raises(InputError, match=r"patch 3 \(counted from 0\)"):
            call()


def test_pairs_cut_along_u_and_v(rng):
    """A function of u alone does not care how often v is cut."""
    view = flat_view(200, 300)
    once, often = (sampled_error(parabola(200.0), [[5, k]], view)[0] for k in (1, 9))
    assert once == pytest.approx(often, rel=1e-9)
    assert sampled_error(parabola(200.0), [[1, 9]], view)[0] == pytest.approx(50.0)


def test_minimal_factors_of_the_teapot(teapot, main_view):
    """20,178 triangles at half a pixel (docs/math.md, 5); each keeps the tolerance, and nothing smaller does."""
    factors = minimal_factors(teapot.patches(), main_view)
    assert (2 * factors**2).sum() == pytest.approx(20_178, rel=0.01)
    assert sampled_error(teapot.patches(), factors, main_view).max() <= 0.5
    for n in range(1, factors.max()):
        too_small = n < factors
        assert np.all(sampled_error(teapot.patches(), np.full(32, n), main_view)[too_small] > 0.5)


@pytest.mark.slow
def test_minimal_factors_far_beyond_the_hardware(teapot, main_view):
    factors = minimal_factors(teapot.patches()[:4], main_view, tolerance=1e-3)
    assert factors.min() > 200
    assert sampled_error(teapot.patches()[:4], factors, main_view).max() <= 1e-3
    with pytest.raises(InputError, match=r"patch \d \(counted from 0\) needs a factor above 100"):
        minimal_factors(teapot.patches()[:4], main_view, tolerance=1e-3, limit=100)


def test_error_that_does_not_fall_monotonically():
    """A peak in the middle, which an even number of pieces meets and an odd one cuts off."""
    patch = np.zeros((1, 13, 2, 3))
    patch[0, :, :, 0] = np.linspace(0, 100, 13)[:, None]
    patch[0, 6, :, 1] = 1000
    patch[0, :, 1, 2] = 1
    view = flat_view(200, 400)
    errors = [sampled_error(patch, [n], view)[0] for n in range(1, 9)]
    rising = [n for n in range(1, 8) if errors[n] > errors[n - 1]]
    assert rising, errors
    for tolerance in (errors[rising[0] - 1] * 1.001, errors[-1] * 1.001):
        smallest = next(n for n, error in enumerate(errors, 1) if error <= tolerance)
        assert minimal_factors(patch, view, tolerance=tolerance).tolist() == [smallest]


def grid_triangles(n, falling):
    """Domain triangles of an n x n grid with one or the other diagonal."""
    found = []
    for i in range(n):
        for j in range(n):
            a, b, c, d = ((i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1))
            found += [(a, b, c), (d, c, b)] if falling else [(a, b, d), (a, d, c)]
    return np.array(found) / n


def test_triangles_of_a_grid_give_the_uniform_error(teapot, main_view):
    """The worse of the two diagonals is the uniform error."""
    n = 9
    uniform = sampled_error(teapot.patches(), np.full(32, n), main_view)
    both = []
    for falling in (False, True):
        own = grid_triangles(n, falling)
        triangles = DomainTriangles(np.repeat(np.arange(32), len(own)), np.tile(own, (32, 1, 1)))
        both.append(triangle_error(teapot.patches(), triangles, main_view))
    np.testing.assert_allclose(np.max(both, axis=0), uniform, rtol=2e-3)


def test_one_long_triangle():
    """Half of the twisted quad: its error is at the middle of the diagonal."""
    half = DomainTriangles(np.array([0]), np.array([[[0, 0], [1, 0], [1, 1.0]]]))
    assert triangle_error(quad(1.5), half, flat_view())[0] == pytest.approx(62.5, rel=1e-3)


@pytest.mark.parametrize(
    ("triangles", "says"),
    [
        (DomainTriangles(np.array([1]), np.zeros((1, 3, 2))), "but there are 1"),
        (DomainTriangles(np.array([0]), np.zeros((1, 3))), "parameters"),
        (DomainTriangles(np.array([0]), np.full((1, 3, 2), 1.5)), "between 0 and 1"),
        (DomainTriangles(np.array([0]), np.full((1, 3, 2), np.nan)), "between 0 and 1"),
    ],
)
def test_bad_triangles(triangles, says):
    with pytest.raises(InputError, match=says):
        triangle_error(quad(1.1), triangles, flat_view())


@pytest.mark.gl
@pytest.mark.parametrize("edges", ["own", "shared"])
@pytest.mark.parametrize("eye", [(4.5, -6.0, 4.0), (0.5, -5.0, 7.0), (-6.0, 2.0, 1.0), (2.6, -2.2, 2.6)])
def test_rendered_pixels_agree_with_the_captured_triangles(device, teapot, edges, eye):
    """No pixel errs more than the supremum of its patch's triangles and the renderer's floor; the largest come near."""
    from slefejax.gpu import Renderer
    from slefejax.measure.error import drawn_error

    view = View(Camera.look_at(eye, (0, 0, 1.2)), 1440, 900)
    factors = tessellation_factors(teapot.patches(), view, "slefe", tolerance=1.0)
    outer = factors.edges if edges == "shared" else np.repeat(factors.levels[:, None], 4, axis=1)
    renderer = Renderer(teapot.patches(), device)
    found = triangle_error(teapot.patches(), renderer.capture(view, factors.inner, outer), view)
    seen = renderer.draw(view, factors.inner, outer)
    error = drawn_error(teapot.patches(), view, seen)
    largest = np.array([np.nanmax(np.where(seen.patch == p, error, 0.0)) for p in range(32)])
    assert np.all(largest <= found + 0.01)  # sub-pixel snapping, 1/256 px, and float32
    shown = largest > 0
    assert np.median(largest[shown] / found[shown]) > 0.8


@pytest.mark.gl
@pytest.mark.parametrize("degree", [1, 2, 4])
def test_rendered_pixels_agree_on_other_surfaces(device, rng, degree):
    """Patches of other degrees, laid in all ways, with random levels, in perspective."""
    from slefejax.gpu import Renderer
    from slefejax.measure.error import drawn_error
    from tests.test_gpu import lattice, random_levels

    patches = lattice(rng, 5, degree, relief=4.0)
    view = View(Camera.look_at((0.3, -2.2, 1.6), (0, 0, 0)), 900, 600)
    inner, outer = random_levels(rng, patches, 1, 7)
    renderer = Renderer(patches, device)
    found = triangle_error(patches, renderer.capture(view, inner, outer), view)
    seen = renderer.draw(view, inner, outer)
    error = drawn_error(patches, view, seen)
    largest = np.array([np.nanmax(np.where(seen.patch == p, error, 0.0)) for p in range(len(patches))])
    assert np.all(largest <= found + 0.01)
    shown = found > 0.05
    assert np.median(largest[shown] / found[shown]) > 0.9


@pytest.mark.gl
def test_transition_rings_break_the_papers_rule(device, teapot, main_view):
    """docs/math.md, 5: raising an edge's factor to the neighbour's can multiply the error."""
    from slefejax.gpu import Renderer

    factors = tessellation_factors(teapot.patches(), main_view, "slefe")
    captured = Renderer(teapot.patches(), device).capture(main_view, factors.inner, factors.edges)
    ring = triangle_error(teapot.patches(), captured, main_view)
    uniform = sampled_error(teapot.patches(), factors, main_view)
    assert (ring / uniform).max() > 2.0
    assert np.count_nonzero(ring > 0.5) > np.count_nonzero(uniform > 0.5)


def test_memory_is_bounded_whatever_the_factors(monkeypatch):
    """360,000 cells of one patch are sampled in batches."""
    batches = []
    real = supremum.cell_errors

    def counting(surface, patch, cells, windows):
        batches.append(len(patch))
        return real(surface, patch, cells, windows)

    monkeypatch.setattr(supremum, "cell_errors", counting)
    found = sampled_error(parabola(200.0), [600], flat_view())
    assert found[0] == pytest.approx(200.0 / (4 * 600**2), rel=1e-6)
    assert max(batches) <= supremum._BATCH
    assert sum(batches) >= 600**2


def test_minimal_pairs_are_valid_and_nothing_smaller_is(teapot, main_view):
    """Against brute force over all pairs with fewer triangles."""
    patches, tolerance = teapot.patches()[[0, 13, 20]], 8.0
    pairs = minimal_pairs(patches, main_view, tolerance=tolerance)
    assert np.all(sampled_error(patches, pairs, main_view) <= tolerance)
    for n_u in range(1, int(pairs.prod(axis=1).max()) + 1):
        for n_v in range(1, int(pairs.prod(axis=1).max()) // n_u + 1):
            smaller = n_u * n_v < pairs.prod(axis=1)
            if smaller.any():
                error = sampled_error(patches[smaller], np.tile([n_u, n_v], (smaller.sum(), 1)), main_view)
                assert np.all(error > tolerance), (n_u, n_v)


@pytest.mark.slow
def test_minimal_pairs_save_triangles_on_the_teapot(teapot, main_view):
    pairs = minimal_pairs(teapot.patches(), main_view)
    factors = minimal_factors(teapot.patches(), main_view)
    assert sampled_error(teapot.patches(), pairs, main_view).max() <= 0.5
    assert np.all(pairs.prod(axis=1) <= factors**2)
    assert 2 * pairs.prod(axis=1).sum() == pytest.approx(15_994, rel=0.01)


def test_the_largest_of_many_maxima_at_wide_angles(monkeypatch):
    """Twisted bicubic patches from inside, 60 cells a side, many maxima nearly as high: 1 % of a finer search."""
    t, cells = np.linspace(-0.5, 0.5, 4), np.full(2, 60)
    patches, views = [], []
    for seed, number in ((17, 7), (9, 1)):
        rng = np.random.default_rng(seed)
        nets = np.zeros((24, 4, 4, 3))
        nets[..., 0], nets[..., 1] = t[:, None], t
        nets += rng.normal(size=nets.shape) * rng.choice([0.05, 0.2, 0.5], (24, 1, 1, 1))
        nets[:, -1, -1] += rng.normal(size=(24, 3))
        fov, direction = rng.uniform(150.0, 179.0), rng.normal(size=3)
        eye = direction / np.linalg.norm(direction) * rng.uniform(0.1, 1.2)
        views.append(View(Camera.look_at(eye, rng.normal(size=3) * 0.2, fov_y=fov, near=0.01), 800, 600))
        patches.append(nets[number])
    for patch, view, n in zip(patches, views, cells, strict=True):
        found = sampled_error(patch[None], [n], view)[0]
        with monkeypatch.context() as finer:
            for name, value in (("_FINEST", 640), ("_KEPT", 128), ("_ZOOMS", 6)):
                finer.setattr(supremum, name, value)
            dense = sampled_error(patch[None], [n], view)[0]
        assert 0.2 < dense < 4.0
        assert 0.99 * dense <= found <= dense * (1 + 1e-9)
