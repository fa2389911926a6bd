"""The built-in character."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slefejax import InputError, View, load, sampled_error, tessellation_factors, triangle_error
from slefejax.cameras import cameras_around
from slefejax.measure.error import SLIPPED, drawn_error, slip
from slefejax.model.defects import find_defects


@pytest.fixture(scope="module")
def walker() -> Any:
    return load("walker")


def test_what_it_is_made_of(walker):
    mesh, rig = walker.conversion.mesh, walker.rig
    assert mesh.face_count >= 2000
    assert np.bincount(mesh.sizes).tolist() == [0, 0, 0, 400, 2096]
    assert not find_defects(mesh)
    assert mesh.components[0] == 1
    assert not mesh.boundary.any()
    assert (len(rig.skeleton.names), len(rig.keys.names), rig.influences.most) == (20, 6, 4)
    assert np.all((1.7 < np.ptp(mesh.vertices[:, 2]), np.ptp(mesh.vertices[:, 2]) < 1.9))


def test_it_is_symmetric_and_walks_round(walker):
    """Mirrored at rest; the cycle closes, and half a cycle later the other leg is where the first one was."""
    rest = walker.conversion.mesh.vertices
    mirrored = rest * [-1, 1, 1]
    order = np.lexsort(np.round(mirrored, 9).T), np.lexsort(np.round(rest, 9).T)
    np.testing.assert_allclose(mirrored[order[0]], rest[order[1]], atol=1e-8)
    np.testing.assert_allclose(walker.vertices(24.0), walker.vertices(0.0), atol=1e-12)
    world = {t: np.asarray(walker.rig.skeleton.world(walker.rig.motion.local(t))) for t in (3.0, 15.0)}
    left, right = (walker.rig.skeleton.names.index(f"foot.{side}") for side in "LR")
    np.testing.assert_allclose(world[3.0][left, :3, 3] * [-1, 1, 1], world[15.0][right, :3, 3], atol=1e-12)
    steps = [np.abs(walker.vertices(t + 1.0) - np.asarray(walker.vertices(t))).max() for t in np.arange(24.0)]
    assert 0.01 < min(steps) <= max(steps) < 0.3


def test_options_of_control_meshes(walker):
    finer = load("walker", "catmull-clark+acc", steps=1)
    assert len(finer.patches()) == 4 * 2096 + 3 * 400
    assert finer.rig is not None
    assert len(np.asarray(finer.pose(2.0))) == len(finer.patches())
    with pytest.raises(InputError, match="walker is built in: group has no meaning"):
        load("walker", group="head")


@pytest.mark.slow
@pytest.mark.gl
@pytest.mark.parametrize("time", [0.0, 5.5, 11.0, 19.0])
def test_certified_factors_hold_in_motion(device, walker, time):
    """Every drawn triangle, uniform grids, and the pixels of five views in a pose."""
    from slefejax.gpu import Renderer

    scene = walker.posed(time)
    renderer = Renderer(scene.patches(), device)
    for view in cameras_around(scene, 720, 450, 5, 7):
        factors = tessellation_factors(scene.patches(), view, edge_numbers=scene.edge_numbers)
        found = renderer.capture(view, factors.inner, factors.edges)
        assert triangle_error(scene.patches(), found, view).max() <= 0.5
        assert sampled_error(scene.patches(), factors.levels, view).max() <= 0.5
        seen = renderer.draw(view, factors.inner, factors.edges)
        assert np.nanmax(drawn_error(scene.patches(), view, seen)) <= 0.5 + 1e-3  # float32 on the device
        assert np.sum(slip(seen) > SLIPPED) < 20


def test_views_of_it(walker):
    view = View(walker.default_camera(), 480, 300)
    assert np.all(np.asarray(tessellation_factors(walker.patches(), view, "slefe").factor) > 0)
