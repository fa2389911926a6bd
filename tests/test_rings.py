from __future__ import annotations

import numpy as np
import pytest

from slefejax.tessellator.rings import Pattern, direct3d11


def test_known_rings():
    """Inner 11 with an edge of 64 reaches 1.625 cells, 38 with 64 3.44 cells (docs/math.md, 5), equal ones one."""
    reach = direct3d11().reach
    assert 11 * reach[11, 64] == pytest.approx(1.625, abs=1e-3)
    assert 38 * reach[38, 64] == pytest.approx(3.44, abs=5e-3)
    n = np.arange(2, 65)
    np.testing.assert_allclose(n * reach[n, n], n * direct3d11().cell[n], rtol=1e-3)
    for n in (2, 4, 8, 16, 32):
        assert n * reach[n, 2 * n] == pytest.approx(1.0)


def test_levels_for_cells_that_are_wider_than_they_should_be():
    pattern = direct3d11()
    levels = pattern.levels_for(np.array([0.0, 1.0, 7.5, 62.9, 200.2]))
    assert levels[:3].tolist() == [0, 1, 8]
    assert levels[3] == 64, "63 cells are up to 2 % wider than 1/63"
    assert levels[4] == 201
    assert np.all(pattern.cells(levels[1:4]) <= 1 / np.array([1.0, 7.5, 62.9]))


@pytest.mark.gl
def test_this_driver_reaches_no_further(device):
    from slefejax.gpu import measure_pattern

    own, known = measure_pattern(device), direct3d11()
    assert isinstance(own, Pattern)
    assert np.all(own.reach <= known.reach)
    assert np.all(own.cell <= known.cell)
    assert own.known == known.known


@pytest.mark.gl
@pytest.mark.slow
def test_rings_depend_on_nothing_else(device):
    """Triangles for levels of all sorts lie in the boxes that the pattern says; equal levels make halves of cells."""
    from slefejax import Camera, View
    from slefejax.gpu import Renderer

    rng = np.random.default_rng(0)
    quad = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)
    renderer = Renderer(np.repeat(quad[None], 200, axis=0), device)
    view = View(Camera.orthographic((0.5, 0.5, 5), (0.5, 0.5, 0), up=(0, 1, 0)), 16, 16)
    pattern = direct3d11()
    for _ in range(5):
        inner, outer = rng.integers(1, 65, (200, 2)), rng.integers(1, 65, (200, 4))
        triangles = renderer.capture(view, inner, outer)
        extent = np.ptp(triangles.parameters.astype(float), axis=1)
        cells = pattern.cells(np.maximum(inner, 2))[triangles.patch]
        along = np.stack([pattern.reach[inner[:, 0, None], outer[:, [1, 3]]].max(axis=1)], axis=1)
        across = np.stack([pattern.reach[inner[:, 1, None], outer[:, [0, 2]]].max(axis=1)], axis=1)
        longest = np.hstack([along, across])[triangles.patch]
        in_u = (extent[:, 0] <= longest[:, 0]) & (extent[:, 1] <= cells[:, 1])
        in_v = (extent[:, 1] <= longest[:, 1]) & (extent[:, 0] <= cells[:, 0])
        assert np.all(in_u | in_v | np.all(extent <= cells, axis=1))
    equal = rng.integers(2, 65, (200, 2))
    triangles = renderer.capture(view, equal, equal[:, [1, 0, 1, 0]])
    corners = triangles.parameters.astype(float)
    for axis in (0, 1):
        levels = [len(np.unique(np.round(corner, 9))) for corner in corners[:2000, :, axis]]
        assert max(levels) == 2, "axis-parallel legs"
    renderer.release()
