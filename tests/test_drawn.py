"""Levels of grids as they are drawn: unequal ones, unequal cells, and what saddles make of both."""

from __future__ import annotations

import numpy as np
import pytest

from slefejax import Camera, InputError, View, sampled_error, tessellation_factors
from slefejax.geometry.projection import Projection
from slefejax.lanes.memory import Memory
from slefejax.predict.cells import Pictured, Pictures, grid_errors
from slefejax.predict.certificate import Certificate
from slefejax.tessellator.rings import direct3d11

PATTERN = direct3d11()


def flat_on(width: float) -> View:
    """One pixel is one unit."""
    return View(Camera.orthographic((0, 0, 5), (0, 0, 0), up=(0, 1, 0), height=width), int(width), int(width))


def quadratics(a, b, c):
    """X = a u^2/2 + b u v + c v^2/2 less its middle, Y = 5 v."""
    a, b, c = (np.atleast_1d(np.asarray(x, float))[:, None, None] for x in (a, b, c))
    t, square = np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.0, 1.0])
    patches = np.zeros((len(a), 3, 3, 3))
    patches[..., 0] = a / 2 * square[:, None] + c / 2 * square + b * t[:, None] * t
    patches[..., 0] -= patches[..., 0].mean(axis=(1, 2), keepdims=True)
    patches[..., 1] = 5 * t
    return patches


def exact_errors(a, b, c, inner):
    """Of quadratics on cells 1/n_u by 1/n_v, for the wider and the narrower of the cells along each side."""
    acting = np.where(np.all(inner == 1, axis=1)[:, None], 1, np.maximum(inner, 2))
    worst = np.zeros(len(inner))
    width = PATTERN.cells(acting)
    for u in (width[:, 0], width[:, 0] * PATTERN.narrowest(acting)[:, 0]):
        for v in (width[:, 1], width[:, 1] * PATTERN.narrowest(acting)[:, 1]):
            x, y, z = a * u * u, b * u * v, c * v * v
            worst = np.maximum(worst, np.maximum(np.maximum(abs(x), abs(z)), abs(x + z) + 2 * abs(y)) / 8)
    return worst


@pytest.mark.slow
@pytest.mark.parametrize("anisotropic", [False, True])
@pytest.mark.parametrize("verify", [False, True])
def test_saddles_hold_with_the_levels_that_are_drawn(rng, anisotropic, verify):
    """A cell that is narrower one way can have a larger error: a and c cancel less."""
    count = 60 if verify else 2000
    a, b, c = rng.uniform(0, 1, count), rng.uniform(0, 1, count), -rng.uniform(0, 1, count)
    c *= 10 ** rng.uniform(-1, 0, count)
    top = np.maximum(np.maximum(a, -c), abs(a + c) + 2 * b)
    size = 4 * np.exp(rng.uniform(np.log(0.3), np.log(12 if verify else 60), count)) ** 2 / top
    a, b, c = (x * size for x in (a, b, c))
    numbers = rng.permutation(4 * count).reshape(count, 4) // 2
    view = flat_on(20000.0)
    factors = tessellation_factors(
        quadratics(a, b, c), view, tiles=1, anisotropic=anisotropic, verify=verify, edge_numbers=numbers
    )
    drawable = factors.inner.max(axis=1) <= 64
    assert np.mean(drawable) > 0.9
    assert exact_errors(a, b, c, factors.inner)[drawable].max() <= 0.5


def test_a_saddle_beside_a_finely_cut_patch():
    """Raised along the shared edge alone it would be wrong by .62 px."""
    a = 4 * 7.98**2
    patches = quadratics([a, 4 * 15.9**2], [0.5 * a, 0.0], [-a, 0.0])
    numbers = np.arange(8).reshape(2, 4)
    numbers[1, 0] = numbers[0, 0]
    factors = tessellation_factors(patches, flat_on(1000.0), tiles=1, edge_numbers=numbers)
    assert factors.factor[0] == pytest.approx(7.98, rel=1e-6)
    assert np.all(sampled_error(patches, factors.inner, flat_on(1000.0)) <= 0.5)
    assert sampled_error(patches[:1], np.array([[8, 16]]), flat_on(1000.0))[0] > 0.6


@pytest.mark.parametrize("level", [49, 61, 63])
def test_cells_of_unequal_width(level):
    """The widest cell times the narrowest one is what a saddle minds, not the widest squared."""
    a = 4 * (0.9999 / PATTERN.cell[level]) ** 2
    factors = tessellation_factors(quadratics(a, 0.5 * a, -a), flat_on(8000.0), tiles=1)
    assert exact_errors(a, 0.5 * a, -a, np.array([[level, level]])) > 0.505
    assert factors.inner[0, 0] in (level + 1, level + 2)
    assert exact_errors(a, 0.5 * a, -a, factors.inner) <= 0.5


MIXED = [(False, True), (True, False), (False, False)]


@pytest.mark.parametrize(
    ("verify", "anisotropic"), [(True, True), *(pytest.param(*x, marks=pytest.mark.slow) for x in MIXED)]
)
def test_a_flat_patch_is_two_triangles(verify, anisotropic):
    flat = np.zeros((1, 2, 2, 3))
    flat[0, 1, :, 0], flat[0, :, 1, 1] = 1.0, 1.0
    view = View(Camera.look_at((0.5, 0.4, 3), (0.5, 0.5, 0), up=(0, 1, 0)), 800, 600)
    for patches in (flat, flat.astype(np.float32)):
        factors = tessellation_factors(patches, view, anisotropic=anisotropic, verify=verify)
        assert factors.factor[0] == 1.0
        assert factors.inner.tolist() == [[1, 1]]
        assert factors.edges.tolist() == [[1, 1, 1, 1]]


def test_all_smaller_boxes_hold(rng):
    """The levels that the search begins with: raised along u or v, grids still keep the tolerance."""
    a, b, c = rng.normal(size=(3, 300)) * 400
    view = flat_on(4000.0)
    projection = Projection.of(view)
    near = projection.relative(quadratics(a, b, c), axis=-1)
    given = lambda: (near, projection)  # noqa: E731
    certificate = Certificate(given, (0.5, None), 1, PATTERN, np.ones(300), Pictures(None, 300), Memory())  # type: ignore
    levels = certificate.for_all_boxes(np.arange(300), np.ones((300, 2), int))
    for more in rng.integers(0, 30, (20, 2)):
        assert exact_errors(a, b, c, np.minimum(levels + more, 64)).max() <= 0.5


def test_proofs_look_at_the_lines_that_are_drawn():
    """A cell that is 2 % wider than the rest has a 4 % larger error."""
    level = 61
    a = 4 * 0.985 * (1 / PATTERN.cell[level]) ** 2
    view = flat_on(8000.0)
    patches = quadratics([a, a * 1.03], 0.0, 0.0)
    nets = Pictures(lambda which: Pictured.of(patches[which], Projection.of(view), (0.5, None)), 2)
    patch, levels = np.arange(2), np.full((2, 2), level)
    even = np.minimum(np.arange(65) / np.maximum(np.arange(65), 1)[:, None], 1.0)
    assert (grid_errors(nets, patch, levels, even) <= 1).tolist() == [True, True]
    assert (grid_errors(nets, patch, levels, PATTERN.points) <= 1).tolist() == [True, False]


def test_single_precision_proofs_far_from_the_origin(rng):
    """The view is not rounded to the patches' precision before a proof."""
    patches = (rng.normal(size=(4, 3, 3, 3)) + [5e4, 0, 0]).astype(np.float32)
    view = View(Camera.look_at((5e4, -8, 3), (5e4, 0, 0), near=0.01, far=100.0), 800, 600)
    factors = tessellation_factors(patches, view, tiles=1, verify=True, tolerance=2.0)
    error = sampled_error(patches.astype(np.float64), factors.levels, view)
    assert np.all(error <= 2.0)


@pytest.mark.slow
def test_scaled_proofs():
    """What is proved for n is taken for scale times n."""
    a = 4 * 7.5**2
    factors = tessellation_factors(quadratics(a, 0.0, a * 0.05), flat_on(1000.0), tiles=1, verify=True)
    assert factors.levels.tolist() == [8]
    for scale, level in ((0.5, 4), (1.0, 8), (1.5, 12)):
        scaled = factors.scaled(scale)
        assert scaled.levels.tolist() == [level]
        assert np.all(scaled.inner <= level)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"pattern": "d3d"}, "pattern must be a"),
        ({"edge_numbers": np.zeros((2, 4), int)}, "edge_numbers must be whole numbers"),
        ({"edge_numbers": np.full((1, 4), 0.5)}, "edge_numbers must be whole numbers"),
        ({"edge_numbers": np.full((1, 4), -1)}, "edge_numbers must be whole numbers"),
        ({"tolerance": 1e-310}, "overflows"),
        ({"depth_tolerance": 1e-310}, "overflows"),
    ],
)
def test_bad_arguments(options, message):
    with pytest.raises(InputError, match=message):
        _ = tessellation_factors(quadratics(1.0, 1.0, 1.0), flat_on(100.0), tiles=1, **options).inner
