"""Cells and triangles one by one: what is found is never less than what dense sampling finds, and little more."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slefejax import Camera, View
from slefejax.bounds import quadratics
from slefejax.geometry.bezier import evaluate_patch
from slefejax.geometry.projection import Projection
from slefejax.geometry.view import homogeneous
from slefejax.lanes import tuning
from slefejax.predict import cells
from slefejax.predict.cells import Pictured, Pictures, cell_errors, grid_errors, triangle_errors
from slefejax.tessellator.direct3d11 import tessellate
from slefejax.tessellator.rings import direct3d11

EVEN = np.minimum(np.arange(65) / np.maximum(np.arange(65), 1)[:, None], 1.0)
VIEW = View(Camera.look_at((0.4, -3.0, 1.5), (0.1, 0.0, 0.0)), 640, 480)
SHAPES = [(4, 4, 3), (4, 4, 4), (3, 3, 3)]
MORE = [(2, 2, 3), (5, 2, 3), (2, 4, 4), (6, 5, 3)]


def patches_of(rng, count, shape, size=1.0):
    """Wavy sheets before the camera."""
    nu, nv, dim = shape
    x, y = np.meshgrid(np.linspace(-1, 1, nu), np.linspace(-1, 1, nv), indexing="ij")
    points = np.stack([x, y, 0 * x], axis=-1) + 0.3 * rng.normal(size=(count, nu, nv, 3))
    points = size * points @ np.linalg.qr(rng.normal(size=(3, 3)))[0]
    if dim == 3:
        return points
    weights = np.exp(0.5 * rng.normal(size=(count, nu, nv, 1)))
    return np.concatenate([points * weights, weights], axis=-1)


def pictures_of(patches, view=VIEW, tolerances=(0.5, None)):
    return Pictures(lambda which: Pictured.of(patches[which], Projection.of(view), tolerances), len(patches))


def sampled(patch, corners, view=VIEW, tolerance=0.5, steps=24, depth=None):
    """The largest error of visible points of a drawn triangle, in tolerances, by another road: world to pixels."""
    k, m = (x.ravel() for x in np.meshgrid(np.arange(steps + 1), np.arange(steps + 1)))
    share = np.stack([k, m, steps - k - m], axis=1)[k + m <= steps] / steps
    half = np.array([0.5 * view.width, 0.5 * view.height, 0.5])
    net = homogeneous(np.asarray(patch, np.float64)[None])[0] @ np.asarray(view.world_to_clip).T
    at = lambda t: evaluate_patch(net, t[:, 0, None], t[:, 1, None])  # noqa: E731
    exact, drawn = at(share @ corners), share @ at(corners)
    w, iw = exact[:, 3], drawn[:, 3]
    exact, drawn = half * exact[:, :3] / w[:, None], half * drawn[:, :3] / iw[:, None]
    seen = np.all(np.abs(drawn) <= half, axis=1) & (iw > 0) & (w > 0)
    size = np.array([tolerance, tolerance, np.inf if depth is None else depth])
    error = np.abs(exact - drawn) / size
    return error[seen].max(initial=0.0)


def halves(low, high):
    a, b = np.array(low), np.array(high)
    p, q, r, s = a, np.array([b[0], a[1]]), b, np.array([a[0], b[1]])
    return [np.stack(t) for t in ((p, q, r), (p, r, s), (p, q, s), (q, r, s))]


@pytest.mark.parametrize(
    "shape", [*SHAPES[:3], *(pytest.param(x, marks=pytest.mark.slow) for x in SHAPES[3:])], ids=str
)
def test_cells_err_no_more_than_is_told_and_little_less(rng, shape):
    patches = patches_of(rng, 40, shape)
    low = rng.uniform(0, 0.7, (40, 2))
    high = low + rng.uniform(0.01, 0.1, (40, 2))
    told = cell_errors(pictures_of(patches), np.arange(40), low, high)
    found = np.array([max(sampled(p, t) for t in halves(*own)) for p, *own in zip(patches, low, high, strict=True)])
    assert np.all(found <= told * (1 + 1e-9))
    assert np.median(told[found > 0] / found[found > 0]) < 1.15
    assert 0.3 < found.max()


@pytest.mark.parametrize("shape", SHAPES[:2], ids=str)
def test_whole_patches_and_all_triangles(rng, shape):
    """The rest is largest here: one cell is all of a patch; triangles of any shape."""
    patches = patches_of(rng, 30, shape)
    corners = rng.uniform(0, 1, (30, 3, 2))
    corners[:5, 1] = corners[:5, 0]  # without area
    corners[5:10] = np.round(corners[5:10])
    pictures, every = pictures_of(patches), np.arange(30)
    told = triangle_errors(pictures, every, corners)
    found = np.array([sampled(p, t) for p, t in zip(patches, corners, strict=True)])
    assert np.all(found <= told * (1 + 1e-9) + 1e-9)
    told = cell_errors(pictures, every, np.zeros((30, 2)), np.ones((30, 2)))
    found = np.array([max(sampled(p, t) for t in halves((0, 0), (1, 1))) for p in patches])
    assert np.all(found <= told * (1 + 1e-9))


def test_depth_and_the_border_of_the_picture(rng):
    """Patches that reach over the border; errors of window depth too."""
    patches = patches_of(rng, 60, (4, 4, 3), size=4.0)
    view = View(Camera.look_at((0.4, -14.0, 1.5), (0.1, 0.0, 0.0), near=0.5, far=50.0, fov_y=20.0), 640, 480)
    low = np.floor(rng.uniform(0, 4, (60, 2))) / 4
    told = cell_errors(pictures_of(patches, view, (0.5, 1e-3)), np.arange(60), low, low + 0.25)
    found = [
        max(sampled(p, t, view, depth=1e-3) for t in halves(own, own + 0.25))
        for p, own in zip(patches, low, strict=True)
    ]
    assert np.all(np.array(found) <= told * (1 + 1e-9))
    assert np.any(told == 0)
    assert np.isfinite(told).all()


def test_what_is_not_in_the_picture_errs_nothing_and_near_planes_are_unknown(rng):
    behind = patches_of(rng, 1, (4, 4, 3), 0.1) + [0.0, 50.0, 30.0]
    across = patches_of(rng, 1, (4, 4, 3), 0.5) + [0.4, -3.0, 1.5]
    told = cell_errors(pictures_of(np.concatenate([behind, across])), np.arange(2), np.zeros((2, 2)), np.ones((2, 2)))
    assert told.tolist() == [0.0, np.inf]


def test_both_forms_of_nets_tell_the_same(rng, monkeypatch):
    patches, low, corners = patches_of(rng, 20, (4, 4, 3)), rng.uniform(0, 0.5, (20, 2)), rng.uniform(0, 1, (20, 3, 2))

    def told():
        pictures = pictures_of(patches)
        cells.ERRORS["cell"].clear_cache()
        cells.ERRORS["triangle"].clear_cache()
        every = np.arange(20)
        return cell_errors(pictures, every, low, low + 0.5), triangle_errors(pictures, every, corners)

    unrolled = told()
    monkeypatch.setattr(cells, "TUNING", replace(tuning.TUNING, unrolled_coefficients=0))
    for one, other in zip(unrolled, told(), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-10)
    monkeypatch.undo()
    cells.ERRORS["cell"].clear_cache()
    cells.ERRORS["triangle"].clear_cache()


def test_one_program_for_all_scenes(rng):
    patches = patches_of(rng, 2500, (4, 4, 3))
    before = None
    for count in (3, 1500, 2500):
        grid_errors(pictures_of(patches[:count]), np.arange(count), np.full((count, 2), 2), EVEN)
        before = cells.ERRORS["cell"].compiled() if before is None else before
    assert cells.ERRORS["cell"].compiled() == before


def test_constants_of_quadratic_interpolation(rng):
    """For all monomials of degree three, on triangles that fill the unit square one way and the other."""
    share = rng.dirichlet([1, 1, 1], 4000).T
    nodes = np.array([[1, 0, 0], [0, 1, 0], [0, 0, 1], [0.5, 0.5, 0], [0, 0.5, 0.5], [0.5, 0, 0.5]])
    a, b, c = share
    basis = np.stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a])
    constant, varying = [], []
    for _ in range(400):
        corners = rng.uniform(size=(3, 2)) ** rng.choice([0.2, 1.0, 5.0])
        corners = (corners - corners.min(axis=0)) / np.ptp(corners, axis=0)
        apart = (nodes @ corners)[:, None] - (share.T @ corners)[None]
        for i, j in ((3, 0), (2, 1), (1, 2), (0, 3)):
            power = apart[..., 0] ** i * apart[..., 1] ** j / 6
            constant.append(np.abs((basis * power).sum(axis=0)).max())
            varying.append((np.abs(basis) * np.abs(power)).sum(axis=0).max())
    assert 0.98 * quadratics.CONSTANT < max(constant) <= quadratics.CONSTANT
    assert 0.9 * quadratics.VARYING < max(varying) <= quadratics.VARYING


def test_triangles_of_rings_are_the_tessellators(rng):
    inner, outer = rng.integers(1, 12, (40, 2)), rng.integers(1, 14, (40, 4))
    made = tessellate(inner, outer)
    places = made.parameters()[made.triangles]
    owner = made.patch[made.triangles[:, 0]]
    patch, side = np.nonzero(np.ones((40, 4), bool))
    own, corners = direct3d11().ring_triangles(side, inner[patch], outer[patch, side], False)

    def ordered(whose, triangles):
        return np.unique(np.column_stack([whose, np.sort(triangles @ [1, 1j], axis=1)]), axis=0)

    grid = np.all((places > 0) & (places < 1), axis=(1, 2))
    rings = ordered(patch[own], corners)
    for row in ordered(owner[~grid], places[~grid]):
        assert np.any(np.all(rings == row, axis=1))
    assert len(rings) <= len(ordered(owner, places))
