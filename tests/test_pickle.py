"""What is computed can be stored, copied and sent to another process; what lies on a device says that it cannot."""

from __future__ import annotations

import copy
import pickle
import subprocess
import sys

import numpy as np
import pytest

from slefejax import Pose, Session, View, dual_quaternion_blend, load, tessellation_factors
from slefejax.errors import InputError
from slefejax.gpu import Renderer
from slefejax.scene import Scene

AGAIN = [lambda value: pickle.loads(pickle.dumps(value)), copy.deepcopy]
IDS = ["pickle", "deepcopy"]


@pytest.fixture(scope="module")
def walker() -> Scene:
    return load("walker")


@pytest.fixture(scope="module")
def view(walker) -> View:
    return View(walker.default_camera(), 320, 200)


@pytest.mark.parametrize("again", AGAIN, ids=IDS)
def test_session_goes_on_where_it_was(walker, view, again):
    session = Session(walker, deform=dual_quaternion_blend, method="edge-length")
    wanted = np.asarray(session.factors(view, 2.0).factor)
    other = again(session)
    assert other._pose_pass is not session._pose_pass, "compiled programs belong to one session"
    np.testing.assert_array_equal(other.factors(view, 2.0).factor, wanted)
    assert other.recomputed == (), "what was computed came along"
    np.testing.assert_array_equal(other.patches, session.patches)
    later = np.asarray(other.factors(view, 6.0).factor)
    assert other.recomputed == ("pose", "view")
    np.testing.assert_array_equal(session.factors(view, 2.0).factor, wanted, "and its moves are its own")
    np.testing.assert_array_equal(later, session.factors(view, 6.0).factor)


OTHER = """
import pickle, sys
import numpy as np
session, view = pickle.load(open(sys.argv[1], "rb"))
found = session.factors(view, 2.0)
assert session.recomputed == ("pose", "view"), session.recomputed
assert found.factor.dtype == np.float32
np.save(sys.argv[2], np.asarray(found.factor))
"""


def test_session_of_another_precision_is_computed_anew(walker, view, tmp_path):
    """In a process where JAX is as it comes: the file is of float64."""
    session = Session(walker, method="edge-length")
    wanted = np.asarray(session.factors(view, 2.0).factor)
    with (tmp_path / "session").open("wb") as file:
        pickle.dump((session, view), file)
    subprocess.run([sys.executable, "-c", OTHER, "session", "factors.npy"], check=True, cwd=tmp_path)
    np.testing.assert_allclose(np.load(tmp_path / "factors.npy"), wanted, rtol=1e-3)


@pytest.mark.parametrize("again", [AGAIN[0], pytest.param(AGAIN[1], marks=pytest.mark.slow)], ids=IDS)
def test_factors(teapot, main_view, again):
    first = tessellation_factors(teapot.patches(), main_view)
    before = again(first)  # what was not asked for yet is made there
    for found, wanted in ((before, first), (again(first.scaled(0.5)), first.scaled(0.5)), (again(first), first)):
        for name in ("factor", "levels", "inner", "edges"):
            np.testing.assert_array_equal(getattr(found, name), getattr(wanted, name))


@pytest.mark.parametrize("again", AGAIN, ids=IDS)
def test_scene_view_and_pose(walker, view, again):
    scene = again(walker)
    np.testing.assert_array_equal(scene.pose(3.0), walker.pose(3.0))
    np.testing.assert_array_equal(again(view).world_to_screen, view.world_to_screen)
    np.testing.assert_array_equal(again(view.camera).world_to_eye, view.camera.world_to_eye)
    pose = again(walker.rig.pose(3.0, keys={"smile": 1.0}))
    assert isinstance(pose, Pose)
    np.testing.assert_array_equal(scene.pose(pose), walker.pose(walker.rig.pose(3.0, keys={"smile": 1.0})))


def test_input_error_keeps_its_options():
    error = pickle.loads(pickle.dumps(InputError("weld is wrong", options=("weld",))))
    assert (str(error), error.typed({"weld"})) == ("weld is wrong", "--weld is wrong")


@pytest.mark.gl
@pytest.mark.parametrize("again", AGAIN, ids=IDS)
def test_renderer_says_that_it_cannot(device, again):
    renderer = Renderer(load("steep-patch").patches())
    with pytest.raises(TypeError, match="a Renderer cannot be pickled or copied"):
        again(renderer)
