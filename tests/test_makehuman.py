"""BVH files, and folders in MakeHuman's formats."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from slefejax import InputError, load
from slefejax.io.bvh import read_bvh
from tests.meshes import cube
from tests.test_io import write
from tests.test_scene import CUBE

BVH = """HIERARCHY
ROOT hip
{
    OFFSET 1 2 3
    CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
    JOINT leg
    {
        OFFSET 0 -1 0
        CHANNELS 3 Yrotation Zrotation Xrotation
        End Site
        {
            OFFSET 0 -1 0
        }
    }
    JOINT tail
    {
        OFFSET 0 0 -1
        CHANNELS 1 Xrotation
    }
}
MOTION
Frames: 2
Frame Time: 0.25
0 0 0 0 0 0 0 0 0 0
1 2 3 30 40 50 -10 20 70 90
"""


def test_bvh(tmp_path):
    found = read_bvh(write(tmp_path, "a.bvh", BVH))
    assert found.names == ("hip", "leg", "tail")
    assert found.parents.tolist() == [-1, 0, 0]
    assert found.offsets.tolist() == [[1, 2, 3], [0, -1, 0], [0, 0, -1]]
    assert found.motion.times.tolist() == [0.0, 0.25]
    rest, moved = (np.asarray(found.motion.local(t)) for t in (0.0, 0.25))
    np.testing.assert_allclose(rest[:, :3, :3], np.tile(np.eye(3), (3, 1, 1)), atol=1e-15)
    assert moved[0, :3, 3].tolist() == [2, 4, 6]
    # capital letters: about axes that turn along, the first channel first
    for joint, axes, angles in ((0, "ZXY", [30, 40, 50]), (1, "YZX", [-10, 20, 70]), (2, "X", [90])):
        wanted = Rotation.from_euler(axes, angles, degrees=True).as_matrix()
        np.testing.assert_allclose(moved[joint, :3, :3], np.reshape(wanted, (3, 3)), atol=1e-15)


@pytest.mark.parametrize(
    "change",
    [
        str.lower,
        str.upper,
        str.title,
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace(" ", "\t"),
        lambda text: text.replace("\n", " "),
        lambda text: "\ufeff" + text.replace("Frame Time: ", "Frame Time:").replace("Frames: ", "Frames:"),
        lambda text: text.replace("Frame Time: ", "Frame  Time :\n").replace("Frames: ", "frames :"),
        lambda text: text.replace("Frame Time: ", "FrameTime:").replace("CHANNELS 1 Xrot", "channels 1 xROT"),
        lambda text: text.replace("End Site", "END SITE").replace("MOTION", "Motion").replace("ROOT", "Root"),
    ],
)
def test_bvh_in_other_clothes(tmp_path, change):
    plain, odd = (read_bvh(write(tmp_path, "a.bvh", text)) for text in (BVH, change(BVH)))
    assert [name.lower() for name in odd.names] == list(plain.names)
    assert odd.parents.tolist() == plain.parents.tolist()
    assert np.array_equal(odd.motion.times, plain.motion.times)
    for part in ("translations", "rotations"):
        assert np.array_equal(getattr(odd.motion, part), getattr(plain.motion, part))


def test_a_deep_bvh(tmp_path):
    depth = 5000
    tree = "ROOT a { CHANNELS 1 Xposition" + " JOINT a { OFFSET 0 1 0" * depth + " }" * (depth + 1)
    found = read_bvh(write(tmp_path, "a.bvh", f"HIERARCHY {tree} MOTION Frames: 1 Frame Time: 1 0.5"))
    assert found.parents.tolist() == list(range(-1, depth))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ("HIERARCHY", "", "line 2: 'ROOT' stands where HIERARCHY should be"),
        ("ROOT hip", "JOINT hip", "line 2: 'JOINT' stands where ROOT should be"),
        ("OFFSET 1 2 3", "OFFSET 1 2", "line 5: the offset of joint 'hip' should be a number, not 'CHANNELS'"),
        ("Xposition", "Wposition", "line 5: 'Wposition' is no channel"),
        ("CHANNELS 1", "CHANNELS 7", "line 18: the number of channels of joint 'tail'"),
        ("JOINT tail", "LIMB tail", "line 15: 'LIMB' stands where"),
        ("Frames: 2", "Frame: 2", "line 22: 'Frame:' stands where Frames: should be"),
        ("Frame Time: 0.25", "Frame Rate: 0.25", "line 23: 'Rate:' stands where Frame Time: should be"),
        ("Frame Time: 0.25", "Frame Time:x 0.25", "line 23: the time of a frame should be a number, not 'x'"),
        ("Frames: 2", "Frames: 3", "line 25: the file ends where a channel of frame 2"),
        ("Frames: 2", "Frames: 1", "line 25: '1' follows the last of 1 frames with 10 channels"),
        ("Frame Time: 0.25", "Frame Time: 0", "line 23: the time of a frame must be positive"),
        ("70 90", "70 ninety", "line 25: a channel of frame 1 .* not 'ninety'"),
    ],
)
def test_what_is_no_bvh(tmp_path, old, new, says):
    assert old in BVH
    with pytest.raises(InputError, match=says):
        read_bvh(write(tmp_path, "a.bvh", BVH.replace(old, new)))


def folder(tmp_path, bones=None, weights=None, target="0 1 0 0\n# a comment\n5 0 0 -1\n"):
    """A cube with two bones, one key and a pose."""
    bones = bones or {"hip": {"head": "low", "parent": None}, "leg": {"head": "high", "parent": "hip"}}
    joints = {"low": [0, 1, 4, 5], "high": [2, 3, 6, 7]}
    weights = weights or {"hip": [[v, 1.0] for v in (0, 1, 4, 5, 2)], "leg": [[v, 2.0] for v in (2, 3, 6, 7)]}
    write(tmp_path, "base.obj", CUBE)
    write(tmp_path, "a.mhskel", json.dumps({"bones": bones, "joints": joints}))
    write(tmp_path, "a.mhw", json.dumps({"weights": weights}))
    (tmp_path / "targets").mkdir(exist_ok=True)
    write(tmp_path / "targets", "smile.target", target)
    # z is up in the pose: turned about its x axis, which is the mesh's, by 90 degrees
    head, _ = BVH.split("Frames:")
    write(tmp_path, "a.bvh", head + "Frames: 1\nFrame Time: 1\n0 0 0 0 0 0 0 0 90 0\n")
    return tmp_path


def test_a_folder(tmp_path):
    scene = load(folder(tmp_path))
    assert scene.rig is not None
    assert scene.rig.keys is not None
    assert scene.rig.keys.names == ("smile",)
    np.testing.assert_allclose(scene.vertices(0.0), cube().vertices, atol=1e-15)
    posed = np.asarray(scene.vertices(1.0))
    # the head of the leg is at (.5, 1, .5); a turn about x takes y to z
    np.testing.assert_allclose(posed[[0, 1, 4, 5]], [[0, 0, 0], [0, 0, 1], [1, 0, 0], [1, 0, 1]], atol=1e-15)
    np.testing.assert_allclose(posed[[3, 7]], [[0, 0.5, 0.5], [1, 0.5, 0.5]], atol=1e-15)
    np.testing.assert_allclose(posed[2], np.array([0, 1, 0]) / 3 + 2 * np.array([0, 1.5, 0.5]) / 3, atol=1e-15)
    offsets = np.asarray(scene.rig.keys.offsets(np.array([2.0])))
    assert offsets[[0, 5]].tolist() == [[2, 0, 0], [0, 0, -2]]


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"bones": {"hip": {"head": "none", "parent": None}}}, "the head of bone 'hip' is at no vertices"),
        ({"bones": {"hip": {"head": "low", "parent": "top"}}}, "the parent 'top' of bone 'hip' does not exist"),
        (
            {"bones": {"hip": {"head": "low", "parent": "leg"}, "leg": {"head": "low", "parent": "hip"}}},
            "'hip' is its own ancestor",
        ),
        ({"weights": {"arm": [[0, 1.0]]}}, "weights for bone 'arm', which the skeleton does not have"),
        ({"weights": {"hip": [[8, 1.0]]}}, "a weight for vertex 8, but there are 8"),
        ({"weights": {"hip": [[0, 1.0]]}}, "weights of vertex 1 are all zero"),
        ({"bones": {"hip": 3}}, "the head of bone 'hip' is at no vertices"),
        ({"bones": {"hip": {"head": ["low"], "parent": None}}}, "the head of bone 'hip' is at no vertices"),
        ({"bones": {"hip": {"head": "low", "parent": ["hip"]}}}, "the parent .'hip'. of bone 'hip' does not exist"),
        ({"weights": {"hip": [[0.5, 1.0]]}}, "weights should be pairs of a vertex and a number"),
        ({"weights": {"hip": [[-1, 1.0]]}}, "a weight for vertex -1, but there are 8"),
        ({"weights": {"hip": []}}, "weights of vertex 0 are all zero"),
        ({"target": "0 0 0 1.#QNAN\n"}, "smile.target, line 1: an offset should be a number, not '1.#QNAN'"),
        ({"target": "# one\n  # two\n0 0 0 -1.#IND # three\n"}, "smile.target, line 3: .* not '-1.#IND'"),
        ({"target": "8 0 0 0\n"}, "smile.target, line 1: '8' is no vertex of the 8"),
        ({"target": "1 0 0\n"}, "smile.target, line 1: the file ends where an offset"),
    ],
)
def test_folders_that_do_not_fit_together(tmp_path, options, says):
    with pytest.raises(InputError, match=says):
        load(folder(tmp_path, **options))


def test_missing_and_broken_parts(tmp_path):
    folder(tmp_path)
    (tmp_path / "a.bvh").write_text(BVH.replace("leg", "knee"))
    with pytest.raises(InputError, match="does not move bone 'leg'"):
        load(tmp_path)
    (tmp_path / "a.mhw").write_text("{")
    with pytest.raises(InputError, match="no JSON object with 'weights'"):
        load(tmp_path)
    (tmp_path / "a.mhw").unlink()
    with pytest.raises(InputError, match=r"has no \.mhw file"):
        load(tmp_path)


def test_the_real_figure(models):
    """163 bones, 14 keys: linear blending of 200 vertices by a loop over the files themselves."""
    path = models / "makehuman"
    scene = load(path, group="body")
    assert scene.patches().shape == (13378, 4, 4, 3)
    assert scene.rig is not None
    assert scene.rig.skeleton is not None
    assert scene.rig.influences is not None
    assert scene.rig.keys is not None
    assert (len(scene.rig.skeleton.names), scene.rig.influences.most, len(scene.rig.keys.names)) == (163, 12, 14)
    rest = scene.conversion.mesh.vertices  # type: ignore[union-attr]
    np.testing.assert_allclose(scene.vertices(0.0), rest, atol=1e-13)
    weights = json.loads((path / "default_weights.mhw").read_text())["weights"]
    world = np.asarray(scene.rig.skeleton.world(scene.rig.motion.local(1.0)))  # type: ignore[union-attr]
    names, bind = scene.rig.skeleton.names, scene.rig.skeleton.bind
    moved = {name: world[k] @ np.linalg.inv(bind[k]) for k, name in enumerate(names)}
    posed = np.asarray(scene.vertices(1.0))
    for vertex in range(0, 13380, 67):
        own = [(w, moved[name]) for name, pairs in weights.items() for v, w in pairs if v == vertex]
        total = sum(w for w, _ in own)
        wanted = sum(w / total * (m[:3, :3] @ rest[vertex] + m[:3, 3]) for w, m in own)
        np.testing.assert_allclose(posed[vertex], wanted, atol=1e-12)
