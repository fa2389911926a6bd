from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slefejax import InputError, Scene, View, load
from slefejax.conversion.patchwork import KINDS
from slefejax.framing import frame_share
from slefejax.geometry.view import turned_up
from tests.meshes import cube, mixed
from tests.test_io import OBJ, faces, write
from tests.test_usd import nurbs_usd

CUBE = "".join(f"v {x} {y} {z}\n" for x, y, z in cube().vertices) + "".join(
    "f " + " ".join(str(v + 1) for v in face) + "\n" for face in faces(cube())
)


def test_patches_know_their_face(tmp_path):
    path = write(tmp_path, "a.obj", OBJ)
    scene = load(path)
    assert scene.conversion is not None
    assert scene.conversion.scheme == "pinched"
    assert scene.faces is not None
    assert scene.faces.tolist() == [0, 1]
    assert scene.kinds is not None
    assert [KINDS[k] for k in scene.kinds] == ["boundary", "triangle"]
    finer = load(path, "catmull-clark+acc", steps=2)
    assert finer.faces is not None
    assert np.bincount(finer.faces).tolist() == [16, 12]
    assert finer.patches().shape == (28, 4, 4, 3)
    assert load(path, alpha=1.0).patches()[1, 1, 1].tolist() != scene.patches()[1, 1, 1].tolist()


def test_faces_keep_the_numbers_of_their_file(tmp_path):
    """Whatever was dropped before them, and of whatever group they are."""
    degenerate = OBJ.replace("f 1/1/1", "f 1 1 2\nf 1/1/1")
    path = write(tmp_path, "a.obj", degenerate)
    with pytest.raises(InputError, match=r"a\.obj: face 0 names vertex 0 twice \(counted from 0\): repair"):
        load(path)
    scene = load(path, drop_defects=True)
    assert scene.faces is not None
    assert scene.faces.tolist() == [1, 2]
    side = load(path, group="side")
    assert side.faces is not None
    assert side.faces.tolist() == [2]
    with pytest.raises(InputError, match="face 3 names vertex 4 twice"):
        load(write(tmp_path, "b.obj", degenerate + "f 5 5 2\n"), group="side")


def test_creases_that_go_with_dropped_faces_are_said(tmp_path):
    square = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nf 1 2 3 4\nf 1 2 3 4\nt crease 2/1/0 0 2 2\n"
    scene = load(write(tmp_path, "a.obj", square), drop_defects=True)
    assert "1 creases are no edges any more and were left out" in scene.notes


def test_dropped_faces_and_isolated_vertices_are_said(tmp_path):
    lines = CUBE + "v 5 5 5\nf 1 1 2\n"
    scene = load(write(tmp_path, "a.obj", lines), drop_defects=True)
    assert len(scene.patches()) == 6
    assert "face 6 names vertex 0 twice: 1 faces were dropped (6)" in scene.notes[0]
    assert "1 vertices belong to no face (the first is 8, counted from 0)" in scene.notes[1]


def test_options_without_a_meaning_are_refused(tmp_path):
    every: list[dict[str, Any]] = [
        {"scheme": "acc"},
        {"alpha": 1.0},
        {"steps": 1},
        {"drop_defects": True},
        {"group": "x"},
    ]
    for options in every:
        with pytest.raises(InputError, match="teapot is a list of patches, no control mesh: "):
            load("teapot", **options)
    for group in ((), 3, ("a", 3)):
        with pytest.raises(InputError, match="group must be a name or a tuple of names"):
            load(write(tmp_path, "a.obj", CUBE), group=group)
    with pytest.raises(InputError, match="drop_defects must be True or False"):
        load(write(tmp_path, "a.obj", CUBE), drop_defects="no")
    with pytest.raises(InputError, match="a file name or a built-in scene is needed"):
        load("")
    pytest.importorskip("pxr", reason="usd-core is not installed")
    with pytest.raises(InputError, match="holds no control mesh: steps has no meaning"):
        load(write(tmp_path, "a.usda", nurbs_usd()), steps=1)


def test_tangents_of_a_scene(tmp_path):
    du, dv = load(write(tmp_path, "a.obj", CUBE)).tangents()
    assert du.shape == (6, 3, 4, 3)
    assert dv.shape == (6, 4, 3, 3)
    normal = np.cross(du[:, 0, 0], dv[:, 0, 0])
    # at a corner of the cube the limit normal is its diagonal
    np.testing.assert_allclose(np.abs(normal) / np.linalg.norm(normal, axis=1)[:, None], 3**-0.5, atol=1e-14)
    with pytest.raises(InputError, match="teapot is no control mesh"):
        load("teapot").tangents()


def test_what_a_scene_leaves_out(tmp_path):
    said = " ".join(load(write(tmp_path, "a.obj", CUBE)).left_out())
    assert "triangle stencils" in said
    assert "weights" in said
    assert "triangle stencils" not in " ".join(load(write(tmp_path, "a.obj", OBJ)).left_out())


def covered(scene, view):
    """The share of the picture that dense samples of the surface fall into, and whether all of them are in it."""
    from slefejax.geometry.bezier import evaluate_patch

    t = np.linspace(0, 1, 90)
    u, v = np.meshgrid(t, t, indexing="ij")
    points = np.moveaxis(evaluate_patch(np.moveaxis(scene.patches(), 0, -1)[..., None, None], u, v), 0, -1)
    screen = np.concatenate([points, np.ones_like(points[..., :1])], axis=-1) @ view.world_to_screen.T
    pixels = (screen[..., :2] / screen[..., 3:]).reshape(-1, 2)
    inside = np.all((pixels >= 0) & (pixels < [view.width, view.height]))
    depth = screen[..., 2] / screen[..., 3]
    seen = np.zeros((view.height, view.width), bool)
    seen[
        np.clip(pixels[:, 1], 0, view.height - 1).astype(int), np.clip(pixels[:, 0], 0, view.width - 1).astype(int)
    ] = 1
    return seen.mean(), bool(inside and np.all((depth > 0) & (depth < 1)))


@pytest.mark.parametrize("share", [0.05, 0.2, 0.38])
@pytest.mark.parametrize("size", [(160, 100), (80, 120)])
def test_the_camera_covers_the_share_that_is_asked_for(teapot, share, size):
    view = View(teapot.default_camera(size[0] / size[1], share), *size)
    found, inside = covered(teapot, view)
    assert inside
    # the teapot is wider than high: a tall picture cannot hold .38 of it
    if not (share == 0.38 and size[1] > size[0]):
        assert found == pytest.approx(share, abs=0.02)
    else:
        assert found < 0.3


def test_what_does_not_fit_is_seen_whole(teapot):
    closest = View(teapot.default_camera(1.6, 1.0), 160, 100)
    found, inside = covered(teapot, closest)
    assert inside
    assert 0.4 < found < 0.8


@pytest.mark.parametrize("scale", [1e-9, 1.0, 1e9])
@pytest.mark.parametrize("offset", [0.0, 1e5])
def test_framing_follows_size_and_place(teapot, scale, offset):
    moved = Scene("moved", (teapot.patches() + offset) * scale)
    plain, other = (Scene("plain", teapot.patches()).default_camera(), moved.default_camera())
    # coverage is counted in pixels: one of 56,000 that rounding turns moves the camera by its share
    np.testing.assert_allclose(other.eye / scale - offset, plain.eye, atol=1e-3)
    assert other.near / scale == pytest.approx(plain.near, rel=1e-3)


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 1, 0), (1, 0, 0), (0, 0, -1), (1, -2, 0.5)])
def test_any_direction_can_be_up(teapot, up):
    camera = teapot.default_camera(1.6, 0.1, up)
    forward = camera.target - camera.eye
    cosine = forward @ np.asarray(up) / np.linalg.norm(forward) / np.linalg.norm(up)
    np.testing.assert_allclose(cosine, turned_up((-0.5, 0.75, -0.4), (0, 0, 1))[2], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(turned_up((1, 2, 3), up)), 1.0)


def test_bad_framing(teapot):
    for aspect in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="a picture needs a positive width over height"):
            frame_share(teapot.patches(), aspect=aspect)
    for share in (0.0, -1.0, 1.5, np.nan):
        with pytest.raises(InputError, match="share of the screen"):
            frame_share(teapot.patches(), share)
    with pytest.raises(InputError, match="up must be a direction"):
        frame_share(teapot.patches(), up=(0.0, 0.0, 0.0))


def test_a_point_and_a_line_can_be_framed():
    for patches in (np.zeros((1, 2, 2, 3)), np.array([[[[0, 0, 0], [0, 0, 0]], [[1, 0, 0], [1, 0, 0.0]]]])):
        camera = frame_share(patches)
        assert np.isfinite(camera.eye).all()
        assert 0 < camera.near < camera.far


def test_a_mesh_of_the_library_itself_makes_a_scene(rng):
    """Without a file: convert, then hand the patches over."""
    from slefejax.conversion.scheme import convert

    found = convert(mixed(rng))
    patches = found.patchwork.patches(found.mesh.vertices)
    assert patches.shape == (30, 4, 4, 3)
