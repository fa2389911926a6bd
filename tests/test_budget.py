"""Budgets are met, within 1 % or to one step, and what cannot be is said."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import (
    Camera,
    InputError,
    View,
    distance_for_budget,
    load,
    real_triangles,
    tessellation_factors,
    tolerance_for_budget,
)
from slefejax.geometry.view import bounding_sphere
from slefejax.study.budget import moved
from slefejax.tessellator.edges import shared_edges
from slefejax.tessellator.levels import triangle_counts

FAST = {"method": "slefe", "segments": 1}


def drawn(patches, view, **options):
    factors = tessellation_factors(patches, view, **options)
    return int(triangle_counts(factors.inner, factors.edges).sum())


@pytest.mark.parametrize("wanted", [500, 5_000, 60_000])
def test_a_tolerance_meets_the_budget(wanted, teapot, main_view):
    found = tolerance_for_budget(teapot.patches(), main_view, wanted, **FAST)
    assert 0.99 * wanted <= found.triangles <= wanted
    assert drawn(teapot.patches(), main_view, tolerance=found.tolerance, **FAST) == found.triangles
    assert found.view is main_view


@pytest.mark.parametrize("wanted", [pytest.param(300, marks=pytest.mark.slow), 20_000])
def test_a_distance_meets_the_budget(wanted, teapot, main_view, precision):
    found = distance_for_budget(teapot.patches(), main_view, wanted, **FAST)
    assert found.triangles <= wanted
    assert found.triangles >= 0.99 * wanted or (found.is_step and found.above > wanted)
    assert drawn(teapot.patches(), found.view, **FAST) == found.triangles
    eye, target = (np.asarray(getattr(found.view.camera, name)) for name in ("eye", "target"))
    assert np.linalg.norm(eye - target) == pytest.approx(found.distance)
    own = np.asarray(main_view.camera.eye) - np.asarray(main_view.camera.target)
    np.testing.assert_allclose((eye - target) / found.distance, own / np.linalg.norm(own), atol=1e-12)
    assert (found.distance > np.linalg.norm(own)) == (wanted < drawn(teapot.patches(), main_view, **FAST))


def test_a_step_that_is_larger_than_a_percent_is_called_one():
    """A single bent quad has 2, 8, 18, 32, ... triangles and nothing between."""
    bent = np.array([[[0, 0, 0], [0, 0.5, 0.7], [0, 1, 0]], [[1, 0, 0], [1, 0.5, 0.7], [1, 1, 0]]])[None]
    view = View(Camera.look_at((0.5, -4, 1), (0.5, 0.5, 0)), 800, 600)
    found = tolerance_for_budget(bent, view, 25, **FAST)
    assert (found.triangles, found.above, found.is_step) == (18, 32, True)
    finer = drawn(bent, view, tolerance=found.tolerance * (1 - 3e-6), **FAST)
    assert finer == 32, "the finest tolerance that the budget is enough for"


def test_options_reach_the_prediction(teapot, main_view):
    edges = shared_edges(teapot.patches())
    plain = tolerance_for_budget(teapot.patches(), main_view, 9_000, edge_numbers=edges, **FAST)
    strict = tolerance_for_budget(teapot.patches(), main_view, 9_000, k=2.0, **FAST)
    assert strict.tolerance == pytest.approx(4 * plain.tolerance, rel=0.03)


# a cubic bend along u, straight along v: its normals turn unevenly
BENT = np.array([[[x, v, z] for v in (0.0, 1.0)] for x, z in ((0, 0), (0.2, 0.6), (1, 0.6), (1.2, 0))])[None]
NORMALS: Any = {"normal_tolerance": 0.2}


@pytest.mark.slow
@pytest.mark.parametrize("search", [tolerance_for_budget, pytest.param(distance_for_budget, marks=pytest.mark.slow)])
def test_normals_stay_right_within_a_budget(search):
    view = View(Camera.look_at((0.6, -4, 1), (0.6, 0.5, 0.2)), 200, 150)
    with pytest.raises(InputError, match="10 triangles are too few: for normal_tolerance alone there are") as said:
        search(BENT, view, 10, **NORMALS)
    least = int(str(said.value).rsplit(maxsplit=1)[1])
    found = search(BENT, view, least + 20, **NORMALS)
    assert least <= found.triangles <= least + 20
    assert found.triangles == drawn(BENT, found.view, tolerance=found.tolerance, **NORMALS)
    assert found.triangles >= 0.99 * (least + 20) or found.is_step
    with pytest.raises(InputError, match="needs tangents="):
        search(BENT, view, 200, normals="tangents", **NORMALS)


@pytest.mark.slow
def test_triangles_that_normals_need_are_differentiable(rng):
    view = View(Camera.look_at((0.6, -4, 1), (0.6, 0.5, 0.2)), 200, 150)
    count = jax.jit(lambda patches: real_triangles(patches, view, tolerance=50.0, **NORMALS))
    bent = BENT + 0.02 * rng.normal(size=BENT.shape)  # what is symmetric ties
    assert float(count(bent)) > 10 * float(real_triangles(bent, view, tolerance=50.0))
    step = rng.normal(size=BENT.shape)
    ahead, behind = (float(count(bent + s * step)) for s in (1e-6, -1e-6))
    slope = float(np.vdot(jax.grad(count)(bent), step))
    assert slope == pytest.approx((ahead - behind) / 2e-6, rel=1e-3)


def test_real_triangles_are_differentiable(teapot, main_view):
    def count(log):
        return real_triangles(teapot.patches(), main_view, tolerance=jnp.exp(log), **FAST)

    slope = float(jax.grad(count)(0.0))
    numeric = float(count(1e-5) - count(-1e-5)) / 2e-5
    assert slope == pytest.approx(numeric, rel=1e-5)
    factor = np.asarray(tessellation_factors(teapot.patches(), main_view, tolerance=1.0, **FAST).factor)
    assert float(count(0.0)) == pytest.approx(2 * (factor**2).sum())


def test_a_moved_camera_keeps_the_scene_between_its_planes(teapot, main_view):
    sphere = bounding_sphere(teapot.points())
    for scale in (0.3, 1.0, 40.0):
        camera = moved(main_view, sphere, scale).camera
        eye, target = np.asarray(camera.eye), np.asarray(camera.target)
        own = np.asarray(main_view.camera.eye) - np.asarray(main_view.camera.target)
        np.testing.assert_allclose(eye - target, scale * own)
        distance = np.linalg.norm(eye - sphere[0])
        assert camera.near <= max(distance - sphere[1], camera.near)
        assert camera.far >= distance + sphere[1]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"triangles": 20}, "20 triangles are too few: with one piece a patch there are 64"),
        ({"triangles": 1}, "at least 2"),
        ({"tolerance": 7.0}, "the tolerance is what is looked for"),
        ({"triangles": 2.5}, "a whole number"),
        ({"triangles": float("nan")}, "a whole number"),
        ({"triangles": "many"}, "a whole number"),
        ({"method": "fixed", "segments": None}, "there is nothing to find"),
        ({"method": "edge-length", "segments": None}, "knows no tolerance: change its setting"),
        ({"method": "best", "segments": None}, "no method 'best'"),
    ],
)
def test_bad_budgets(change, says, teapot, main_view):
    options = {**FAST, "triangles": 1000, **change}
    with pytest.raises(InputError, match=says):
        tolerance_for_budget(teapot.patches(), main_view, **options)


def test_cameras_that_no_distance_helps(teapot, main_view):
    flat = View(Camera.orthographic((0, -5, 0), (0, 0, 0)), 800, 600)
    with pytest.raises(InputError, match="without perspective the distance"):
        distance_for_budget(teapot.patches(), flat, 1000, **FAST)
    away = replace(main_view, camera=Camera.look_at((0, -9, 0), (0, -20, 0)))
    with pytest.raises(InputError, match="no patch is visible"):
        tolerance_for_budget(load("teapot").patches(), away, 1000, **FAST)
