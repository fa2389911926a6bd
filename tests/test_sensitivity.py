"""Sensitivities against finite differences of whole chains: keys, bones, conversion, camera, tolerance."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import (
    InputError,
    Mesh,
    Pose,
    Scene,
    View,
    convert,
    dual_quaternion_blend,
    linear_blend,
    load,
    real_triangles,
    sensitivity,
)
from slefejax.geometry.view import bounding_sphere
from slefejax.study.budget import moved

FAST = {"method": "slefe", "segments": 1}
# of a figure with symmetries: ties have no derivative unless they are smooth
SMOOTH = {**FAST, "smooth": 0.02}
H = 1e-6


@pytest.fixture(scope="module")
def walker():
    return load("walker")


@pytest.fixture(scope="module")
def posed(walker):
    """A pose between two samples of the motion, with keys of its own, its view, and what was found."""
    pose = walker.rig.pose(7.3, {"smile": 0.4, "brows": 0.2})
    view = View(walker.default_camera(), 640, 400)
    return pose, view, sensitivity(walker, view, pose, **SMOOTH)


def count(scene, pose, view, **options):
    patches = scene.conversion.patchwork.patches(
        scene.rig.posed(jnp.asarray(scene.conversion.mesh.vertices), pose, linear_blend)
    )
    return float(real_triangles(patches, view, **{**SMOOTH, **options}))


@pytest.mark.slow
def test_the_number_itself(walker, posed):
    pose, view, found = posed
    assert found.triangles == pytest.approx(count(walker, pose, view), rel=1e-12)


@pytest.mark.slow
def test_bones_by_differences(walker, posed, rng):
    pose, view, found = posed
    turns, shifts = (rng.normal(size=found.turns.shape) for _ in range(2))
    for values, slopes in ((turns, found.turns), (shifts, found.shifts)):
        numbers = []
        for s in (H, -H):
            motion = np.tile(np.eye(4), (len(values), 1, 1))
            if values is turns:
                x, y, z = (s * values).T
                motion[:, 0, 1], motion[:, 0, 2], motion[:, 1, 0] = -z, y, z
                motion[:, 1, 2], motion[:, 2, 0], motion[:, 2, 1] = -x, -y, x
            else:
                motion[:, :3, 3] = s * values
            numbers.append(count(walker, Pose(np.asarray(pose.local) @ motion, pose.keys), view))
        slope = (numbers[0] - numbers[1]) / (2 * H)
        assert float(np.vdot(slopes, values)) == pytest.approx(slope, rel=1e-4)


@pytest.mark.slow
def test_keys_tolerance_and_distance_by_differences(walker, posed, rng):
    pose, view, found = posed
    values = rng.normal(size=found.keys.shape)
    ahead, behind = (count(walker, Pose(pose.local, np.asarray(pose.keys) + s * values), view) for s in (H, -H))
    assert float(np.vdot(found.keys, values)) == pytest.approx((ahead - behind) / (2 * H), rel=1e-4)
    ahead, behind = (count(walker, pose, view, tolerance=0.5 * np.exp(s)) for s in (H, -H))
    assert found.tolerance == pytest.approx((ahead - behind) / (2 * H), rel=1e-5)
    sphere = bounding_sphere(walker.points())
    ahead, behind = (count(walker, pose, moved(view, sphere, np.exp(s))) for s in (H, -H))
    assert found.distance == pytest.approx((ahead - behind) / (2 * H), rel=1e-4)


@pytest.mark.slow
def test_vertices_by_differences(walker, posed, rng):
    pose, view, found = posed
    mesh = walker.conversion.mesh
    values = rng.normal(size=found.points.shape) * (rng.uniform(size=(len(found.points), 1)) < 0.1)
    vertices = walker.rig.posed(jnp.asarray(mesh.vertices), pose, linear_blend)
    np.testing.assert_allclose(found.places, vertices, atol=1e-12)
    patches = walker.conversion.patchwork.patches
    ahead, behind = (float(real_triangles(patches(vertices + s * values), view, **SMOOTH)) for s in (H, -H))
    assert float(np.vdot(found.points, values)) == pytest.approx((ahead - behind) / (2 * H), rel=1e-4)


def test_points_of_patches_move_together(teapot, main_view, rng):
    # symmetric control nets tie: shaken, with equal points still equal
    flat = teapot.patches().reshape(-1, 3)
    _, first, number = np.unique(flat.round(9), axis=0, return_index=True, return_inverse=True)
    shaken = flat[first] + 0.01 * rng.normal(size=(len(first), 3))
    control = shaken[number].reshape(teapot.patches().shape)
    found = sensitivity(replace(teapot, control=control), main_view, method="filip")
    assert found.numbers is not None
    assert len(found.places) == len(first) == 290
    assert found.turns is found.shifts is found.keys is None
    values = rng.normal(size=found.points.shape)
    own = values[found.numbers]
    ahead, behind = (float(real_triangles(control + s * own, main_view, method="filip")) for s in (H, -H))
    assert float(np.vdot(found.points, values)) == pytest.approx((ahead - behind) / (2 * H), rel=1e-4)


@pytest.mark.slow
def test_certified_and_dual_quaternions(walker):
    """The default method, blended by dual quaternions."""
    view = View(walker.default_camera(), 640, 400)
    found = sensitivity(walker, view, 3.0, deform=dual_quaternion_blend)
    for name in ("points", "turns", "shifts", "keys"):
        assert np.isfinite(getattr(found, name)).all()
    patches = walker.conversion.patchwork.patches
    posed = walker.rig.posed(jnp.asarray(walker.conversion.mesh.vertices), walker.rig.pose(3.0), dual_quaternion_blend)
    ahead, behind = (float(real_triangles(patches(posed), view, tolerance=0.5 * np.exp(s))) for s in (H, -H))
    assert found.tolerance == pytest.approx((ahead - behind) / (2 * H), rel=1e-5)


@pytest.mark.slow
def test_normals_of_tangent_patches(rng):
    """They move with the mesh; positions need next to nothing at such a tolerance."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) + 0.1 * rng.normal(size=(8, 3))
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    made = convert(Mesh.of(corners, faces))
    scene = Scene("cube", np.asarray(made.patchwork.patches(corners)), conversion=made)
    view = View(scene.default_camera(), 200, 150)
    options: Any = {"tolerance": 20.0, "normal_tolerance": 5.0}
    found = sensitivity(scene, view, **options, normals="tangents")

    def shaded(vertices):
        patches, tangents = made.patchwork.patches(vertices), made.tangents(vertices)
        return float(real_triangles(patches, view, tangents=tangents, normals="tangents", **options))

    assert found.triangles == pytest.approx(shaded(corners))
    step = rng.normal(size=corners.shape)
    slope = (shaded(corners + H * step) - shaded(corners - H * step)) / (2 * H)
    assert float(np.vdot(found.points, step)) == pytest.approx(slope, rel=1e-3)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda t, v: sensitivity(t.patches(), v), "sensitivity is of a slefejax.Scene"),
        (lambda t, v: sensitivity(t, cast(Any, "view")), "the view must be a slefejax.View"),
        (lambda t, v: sensitivity(t, v, verify=True), "verify finds whole numbers"),
        (lambda t, v: sensitivity(load("twisted-quad"), v, 3.0), "twisted-quad does not move"),
        (lambda t, v: sensitivity(t, v, tolerance=0.0), "tolerance must be"),
        (lambda t, v: sensitivity(t, v, method="best"), "no method 'best'"),
        (lambda t, v: sensitivity(t, v, normal_tolerance=1.0, normals="tangents"), "teapot is no control mesh"),
    ],
)
def test_bad_input(call, says, teapot, main_view):
    with pytest.raises(InputError, match=says):
        call(teapot, main_view)
