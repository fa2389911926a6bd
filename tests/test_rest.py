"""The rest pose of a rig: where a scene stands when no pose is asked for, everywhere the same."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slefejax import InputError, Pose, Session, View, load, save, sensitivity
from slefejax.model.rig import Rig, Skeleton
from slefejax.model.skinning import Influences, Key, ShapeKeys
from tests.test_pair import minimal, put

TURN = np.eye(4)
TURN[:3, :3] = Rotation.from_euler("z", 30, degrees=True).as_matrix()
TURN[:3, 3] = (0.0, 1.0, 2.0)
LOW = np.diag([2.0, 2.0, 2.0, 1.0])


@pytest.fixture
def quad(tmp_path):
    """The quad of docs/animation.md on two joints, with a key, in a rest pose of its own."""
    names, arrays = minimal()
    arrays |= {"rest_joints": [LOW, TURN], "rest_keys": [0.5]}
    scene: Any = load(put(tmp_path, names, arrays))
    return scene


def by_hand(low, high, key):
    """The four vertices: two of them follow each joint, and the key widens the two in the middle."""
    raw = np.array([[0, 0, 0], [1 + key, 0, 0], [1 + key, 1, 0], [0, 1, 0]], float)
    bind = np.eye(4)
    bind[1, 3] = 1.0
    moved = [low, low, low @ high @ np.linalg.inv(bind), low @ high @ np.linalg.inv(bind)]
    return np.array([(m @ [*p, 1.0])[:3] for m, p in zip(moved, raw, strict=True)])


def test_a_scene_stands_in_its_rest_pose(quad):
    wanted = by_hand(LOW, TURN, 0.5)
    np.testing.assert_allclose(quad.vertices(), wanted, atol=1e-15)
    np.testing.assert_allclose(quad.patches()[0][[0, 3, 3, 0], [0, 0, 3, 3]], wanted, atol=1e-14)
    np.testing.assert_allclose(quad.pose(), quad.patches(), atol=1e-14)
    session = Session(quad, method="slefe")
    np.testing.assert_allclose(session.patches, quad.patches(), atol=1e-14)
    single = Session(quad, method="slefe", dtype=np.float32)
    assert single.patches.dtype == np.float32
    np.testing.assert_allclose(single.patches, quad.patches(), atol=1e-6)
    assert quad.posed(Pose()).rig is None
    np.testing.assert_allclose(quad.posed(Pose()).patches(), quad.patches(), atol=1e-14)


def test_what_a_pose_leaves_open_is_as_at_rest(quad):
    np.testing.assert_allclose(quad.vertices(Pose(np.tile(np.eye(4), (2, 1, 1)))), by_hand(np.eye(4), np.eye(4), 0.5))
    np.testing.assert_allclose(quad.vertices(Pose(None, [2.0])), by_hand(LOW, TURN, 2.0), atol=1e-15)
    np.testing.assert_allclose(quad.vertices(quad.rig.pose(keys={"wide": 1.0})), by_hand(LOW, TURN, 1.0), atol=1e-15)
    np.testing.assert_allclose(quad.vertices(quad.rig.pose(keys={})), by_hand(LOW, TURN, 0.5), atol=1e-15)
    lifted = np.eye(4)
    lifted[1, 3] = 1.0  # where the second joint is bound: nothing moves
    np.testing.assert_allclose(quad.vertices(0.0), by_hand(np.eye(4), lifted, 0.0), atol=1e-15)
    still = replace(quad, rig=replace(quad.rig, motion=replace(quad.rig.motion, keys=None)))
    np.testing.assert_allclose(still.vertices(0.0), by_hand(np.eye(4), lifted, 0.5), atol=1e-15)


def test_session_sees_the_same_with_and_without_a_pose(quad):
    view = View(quad.default_camera(), 320, 200)
    session = Session(quad, method="filip")
    first = session.factors(view)
    assert session.factors(view, Pose()) is first
    assert session.factors(view, Pose(np.array([LOW, TURN]))) is first
    assert session.recomputed == ()


def test_it_is_saved_and_read_again_and_copied(quad, tmp_path):
    save(quad, tmp_path / "again.json")
    again: Any = load(tmp_path / "again.json")
    assert np.array_equal(again.patches(), quad.patches())
    three: Any = load(tmp_path / "again.json", copies=3)
    np.testing.assert_allclose(three.patches()[0], quad.patches()[0], atol=1e-14)
    step = [1.1 * np.ptp(quad.vertices()[:, 0]), 0.0, 0.0]
    np.testing.assert_allclose(three.patches()[2], quad.patches()[0] + 2 * np.array(step), atol=1e-13)
    np.testing.assert_allclose(three.pose(), three.patches(), atol=1e-13)


@pytest.mark.slow
def test_gradients_are_those_at_rest(quad):
    view = View(quad.default_camera(), 320, 200)
    found: Any = sensitivity(quad, view, method="filip")
    np.testing.assert_allclose(found.places, quad.vertices(), atol=1e-14)
    slope = jax.jacfwd(lambda w: quad.vertices(Pose(None, w)))(jnp.array([0.5]))[..., 0]
    np.testing.assert_allclose(slope, by_hand(LOW, TURN, 1.5) - by_hand(LOW, TURN, 0.5), atol=1e-14)


def test_rest_poses_that_are_none(tmp_path):
    skeleton = Skeleton.of(["a"], [-1], np.eye(4)[None])
    influences = Influences.of([[0]] * 3, [[1.0]] * 3, 1)
    keys = ShapeKeys.of([Key("k", (([0], [[1.0, 0, 0]]),))], 3)
    with pytest.raises(InputError, match="a pose of 1 joints needs transforms"):
        Rig(skeleton, influences, rest=Pose(np.zeros((2, 4, 4))))
    with pytest.raises(InputError, match="a pose of 0 joints"):
        Rig(None, None, keys, rest=Pose(np.eye(4)[None]))
    with pytest.raises(InputError, match="rest pose of a rig has numbers that are not finite"):
        Rig(None, None, keys, rest=Pose(None, np.array([np.nan])))
    names, arrays = minimal()
    with pytest.raises(InputError, match=r"quad\.npz: 'rest_joints' must be numbers \(2, 4, 4\)"):
        load(put(tmp_path, names, arrays | {"rest_joints": np.eye(4)[None]}))
