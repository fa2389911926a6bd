"""Levels that are lowered in turns: fewer triangles, each of which keeps the tolerance."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from slefejax import InputError, cameras_around, load, tessellation_factors, triangle_error, triangulate
from slefejax.geometry.view import View
from slefejax.predict.drawn.fewest import lowered_levels
from slefejax.tessellator.levels import triangle_counts
from slefejax.tessellator.rings import direct3d11
from tests.test_drawn import flat_on, quadratics
from tests.test_proved import KINDS, scene


def asked(seed, kind, **options):
    patches, view, numbers = scene(seed, kind, 0.5)
    factors = tessellation_factors(patches, view, tiles=1, edge_numbers=numbers, **options)
    error = triangle_error(patches, triangulate(patches, factors), view).max()
    return factors, triangle_counts(factors.inner, factors.edges).sum(), error


@pytest.mark.parametrize("kind", [pytest.param(KINDS[0], marks=pytest.mark.slow), *KINDS[1:]])
def test_fewest_are_few_and_hold(kind):
    for seed in range(2):
        (_, fast, error), (_, fewest, other) = (asked(seed, kind, levels=way) for way in ("fast", "fewest"))
        assert fewest <= fast
        assert max(error, other) <= 0.5


def test_nothing_more_to_lower(teapot, main_view):
    """What is found stays as it is; every edge has one level, which one piece less would spoil for a neighbour."""
    numbers = teapot.edge_numbers
    factors = tessellation_factors(teapot.patches(), main_view, edge_numbers=numbers, levels="fewest")
    assert factors.certify is not None
    inner, edges = lowered_levels(factors.certify(), factors.inner, factors.edges, numbers, 1)
    assert np.array_equal(inner, factors.inner)
    assert np.array_equal(edges, factors.edges)
    for number in np.unique(numbers):
        assert len(np.unique(edges[numbers == number])) == 1


@pytest.mark.parametrize("name", ["teapot", pytest.param("walker", marks=pytest.mark.slow)])
def test_how_few(name):
    """Of what grids of the minimal factors have with edges like the larger neighbour, which is 1.007 and 1.054."""
    shown = load(name)
    view = View(shown.default_camera(), 1440, 900)
    wanted = {"teapot": 2 * 10089, "walker": 2 * 18018}[name]  # measured by slefejax.minimal_factors
    counts = {}
    for way in ("fast", "fewest"):
        factors = tessellation_factors(shown.patches(), view, edge_numbers=shown.edge_numbers, levels=way)
        counts[way] = triangle_counts(factors.inner, factors.edges).sum()
    assert counts["fewest"] <= counts["fast"] <= 1.03 * counts["fewest"]
    assert counts["fast"] <= 1.1 * wanted


@pytest.mark.slow
@pytest.mark.parametrize("way", ["fast", "fewest"])
def test_rings_of_which_only_the_length_is_known(way):
    """A pattern that was measured and is not Direct3D 11's: more triangles, and they hold."""
    for seed in range(2):
        _, known, _ = asked(seed, "cubics", levels=way)
        _, measured, error = asked(seed, "cubics", levels=way, pattern=replace(direct3d11(), known=False))
        assert known <= measured
        assert error <= 0.5


def test_ways_that_there_are(teapot, main_view):
    with pytest.raises(InputError, match="there is no levels 'slow'"):
        tessellation_factors(teapot.patches(), main_view, levels="slow")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="levels"):
        tessellation_factors(teapot.patches(), main_view, "slefe", levels="fast")


def test_a_patch_of_one_cell_beside_one_that_is_cut():
    """Three edges that could be 1 if the fourth were: while that one stays cut the patch is a fan around its middle."""
    found = []
    for bend in np.linspace(1.0, 4.2, 9):
        patches = quadratics([bend, 40.0], [0.0, 0.0], [-bend, 0.0])
        numbers = np.array([[0, 1, 2, 3], [0, 4, 5, 6]])
        view = flat_on(200.0)
        factors = tessellation_factors(patches, view, tiles=1, edge_numbers=numbers, levels="fewest")
        found.append(triangle_error(patches, triangulate(patches, factors), view).max())
    assert max(found) <= 0.5


@pytest.mark.slow
@pytest.mark.parametrize("name", ["walker", "spot_control_mesh.obj", "suzanne.obj", "rational_torus.bv", "fox.glb"])
@pytest.mark.parametrize("way", ["fast", "fewest"])
def test_real_models_hold(models, name, way):
    shown = load(name if name == "walker" else models / name)
    for view in (View(shown.default_camera(), 1440, 900), *cameras_around(shown, 1440, 900, 3)):
        for anisotropic in (False, True):
            for tolerance in (0.1, 0.5, 2.0):
                options = {"tolerance": tolerance, "anisotropic": anisotropic, "levels": way}
                factors = tessellation_factors(shown.patches(), view, edge_numbers=shown.edge_numbers, **options)
                made = triangulate(shown.patches(), factors)
                assert triangle_error(shown.patches(), made, view).max() <= tolerance
