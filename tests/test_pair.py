"""The .json/.npz pair, and several copies of a scene."""

from __future__ import annotations

import io
import json
import struct
import tracemalloc
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from slefejax import InputError, Session, View, dual_quaternion_blend, linear_blend, load, save
from tests.test_io import write
from tests.test_scene import CUBE


@pytest.fixture(scope="module")
def walker():
    return load("walker")


def test_a_scene_is_saved_and_read_again(tmp_path, walker):
    save(walker, tmp_path / "figure.json")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["figure.json", "figure.npz"]
    again: Any = load(tmp_path / "figure.json")
    assert again.rig.skeleton.names == walker.rig.skeleton.names
    assert again.rig.keys.names == walker.rig.keys.names
    assert (again.up, again.rig.rate, again.rig.motion.span) == (walker.up, 24.0, (0.0, 24.0))
    assert np.array_equal(again.patches(), walker.patches())
    for time in (0.0, 7.5):
        np.testing.assert_allclose(again.vertices(time), walker.vertices(time), atol=1e-14)


@pytest.mark.parametrize(
    "name", ["usdskel_blendshapes.usda", "usdskel_two_bends.usda", "fox.glb", "catmark_helmet.obj"]
)
def test_real_scenes_are_saved_and_read_again(tmp_path, models, name):
    """In-betweens, several skeletons, triangles; creases, no rig at all."""
    scene = load(models / name)
    save(scene, str(tmp_path / "a.json"))
    again = load(tmp_path / "a.json")
    # at rest a rig may move the vertices, by weights that are divided by their sums once more
    atol = 0 if scene.rig is None else 1e-13 * np.abs(scene.patches()).max()
    np.testing.assert_allclose(again.patches(), scene.patches(), rtol=0, atol=atol)
    assert (again.rig is None) == (scene.rig is None)
    if scene.rig is not None:
        assert scene.rig.motion is not None
        for time in scene.rig.motion.times[:: max(1, len(scene.rig.motion.times) // 4)].tolist():
            np.testing.assert_allclose(
                again.vertices(time), scene.vertices(time), rtol=0, atol=1e-13 * np.abs(scene.patches()).max()
            )


def minimal() -> tuple[dict[str, Any], dict[str, Any]]:
    """What docs/animation.md lists, by hand: a quad on two joints that nod, and a key."""
    names = {
        "format": "slefejax rig",
        "version": 1,
        "arrays": "quad.npz",
        "joints": [{"name": "low", "parent": -1}, {"name": "high", "parent": 0}],
        "keys": [{"name": "wide"}],
    }
    bind = np.tile(np.eye(4), (2, 1, 1))
    bind[1, 1, 3] = 1.0
    arrays = {
        "vertices": np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32),
        "sizes": [4],
        "corners": [0, 1, 2, 3],
        "bind": bind,
        "influence_joints": [[0], [0], [1], [1]],
        "influence_weights": [[1.0], [1.0], [2.0], [1.0]],
        "key0_0_vertices": [1, 2],
        "key0_0_offsets": [[1.0, 0, 0], [1.0, 0, 0]],
        "times": [0.0, 1.0],
        "translations": [[[0, 0, 0], [0, 1, 0]]] * 2,
        "rotations": [[[1, 0, 0, 0]] * 2, [[1, 0, 0, 0], [3, 3, 0, 0]]],
        "key_weights": [[0.0], [1.0]],
    }
    return names, arrays


def put(tmp_path: Path, names: dict, arrays: dict) -> Path:
    np.savez(tmp_path / "quad.npz", **arrays)
    (tmp_path / "quad.json").write_text(json.dumps(names))
    return tmp_path / "quad.json"


def test_a_pair_by_hand(tmp_path):
    scene = load(put(tmp_path, *minimal()))
    assert scene.rig is not None
    assert scene.rig.rate == 24.0
    np.testing.assert_allclose(scene.vertices(1.0), [[0, 0, 0], [2, 0, 0], [2, 1, 0], [0, 1, 0]], atol=1e-15)
    lifted = scene.rig.pose(1.0, keys=[0.0])
    np.testing.assert_allclose(scene.vertices(lifted)[:2], [[0, 0, 0], [1, 0, 0]], atol=1e-15)  # type: ignore[index]


@pytest.mark.slow
def test_the_deformation_that_a_file_asks_for_is_kept(tmp_path):
    """Two of four vertices are blended by dual quaternions: in a pair, in one that is saved of it, and in copies."""
    names, arrays = minimal()
    arrays["influence_joints"], arrays["influence_weights"] = [[0, 1]] * 4, [[0.6, 0.4]] * 4
    scene = load(put(tmp_path, names, arrays | {"dual_quaternions": [0, 1, 1, 0]}))
    found, linear, dual = (
        np.asarray(scene.vertices(1.0, deform)) for deform in (None, linear_blend, dual_quaternion_blend)
    )
    assert np.array_equal(found, np.where([[False], [True], [True], [False]], dual, linear))
    assert np.abs(linear - dual).max() > 0.05
    save(scene, tmp_path / "again.json")
    np.testing.assert_allclose(load(tmp_path / "again.json").vertices(1.0), found, atol=1e-15)
    both = np.asarray(load(tmp_path / "again.json", copies=2).vertices(1.0))
    np.testing.assert_allclose(both[4:] - both[4], found - found[0], atol=1e-14)
    with pytest.raises(InputError, match=r"'dual_quaternions' must be whole numbers \(4\)"):
        load(put(tmp_path, names, arrays | {"dual_quaternions": [0.5] * 4}))


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda n, a: n.update(version=2), "none of a pair"),
        (lambda n, a: n.pop("arrays"), "none of a pair"),
        (lambda n, a: n.update(arrays="none.npz"), r"there is no file .*none\.npz"),
        (
            lambda n, a: n.update(arrays="../quad.npz"),
            r"quad\.json: its arrays are to be read from .* no file in its folder",
        ),
        (lambda n, a: n.update(arrays="/tmp/quad.npz"), r"read from '/tmp/quad\.npz', which is no file in its folder"),
        (lambda n, a: n.update(rate=0), "rate a positive number"),
        (lambda n, a: n.update(up=[0, 0, 0]), "up must be a direction"),
        (lambda n, a: n["joints"][0].update(parent=1), "'low' is its own ancestor"),
        (lambda n, a: a.pop("bind"), "needs a bind transform"),
        (
            lambda n, a: a.update(influence_joints=[[0], [0], [2], [1]]),
            "vertex 2 has a weight for bone 2, but there are 2",
        ),
        (lambda n, a: a.update(influence_weights=[[1.0], [0.0], [1.0], [1.0]]), "weights of vertex 1 are all zero"),
        (lambda n, a: a.update(influence_weights=[[1.0], [1.0]]), r"'influence_weights' must be numbers \(4, 1\)"),
        (lambda n, a: a.update(key0_0_offsets=np.zeros((3, 3))), r"'key0_0_offsets' must be numbers \(2, 3\)"),
        (lambda n, a: a.update(key0_0_vertices=[1, 9]), "'wide' moves vertex 9, but there are 4"),
        (lambda n, a: n["keys"][0].update(places=[0.0]), "places of shape key 'wide' must be different numbers"),
        (lambda n, a: a.update(sizes=[5]), "'sizes' add up to 5, but there are 4 corners"),
        (lambda n, a: a.update(corners=[0, 1, 2, 7]), "face 0 .* has a vertex 7"),
        (lambda n, a: a.update(corners=[0.5, 1, 2, 3]), "'corners' must be whole numbers"),
        (lambda n, a: a.update(times=[1.0, 0.0]), "times of a motion must be finite numbers that grow"),
        (lambda n, a: a.update(rotations=np.zeros((2, 2, 4))), "a quaternion of no length"),
        (
            lambda n, a: a.update(translations=np.full((2, 2, 3), np.nan)),
            "'translations' holds numbers that are not finite",
        ),
        (lambda n, a: a.pop("translations"), "needs both translations and rotations"),
        (lambda n, a: a.update(vertices=np.array([None] * 4)), "no .npz file of plain arrays"),
    ],
)
def test_pairs_that_are_none(tmp_path, change, says):
    names, arrays = minimal()
    change(names, arrays)
    with pytest.raises(InputError, match=says):
        load(put(tmp_path, names, arrays))


def test_broken_files(tmp_path, teapot):
    path = put(tmp_path, *minimal())
    whole = (tmp_path / "quad.npz").read_bytes()
    for content in (b"", whole[:100], whole[: len(whole) // 2], b"PK" + bytes(500)):
        (tmp_path / "quad.npz").write_bytes(content)
        with pytest.raises(InputError, match=r"quad\.npz is no \.npz file of plain arrays, or not whole"):
            load(path)
    for text in ("", "[]", "{", '{"format": 3}'):
        path.write_text(text)
        with pytest.raises(InputError, match=r"quad\.json is none of a pair"):
            load(path)
    np.save(tmp_path / "one.npy", np.zeros(3))
    (tmp_path / "quad.npz").write_bytes((tmp_path / "one.npy").read_bytes())
    path.write_text(json.dumps(minimal()[0]))
    with pytest.raises(InputError, match=r"no \.npz file of plain arrays"):
        load(path)
    for rate in (10**400, "x"):
        path.write_text(json.dumps(minimal()[0] | {"rate": rate}))
        with pytest.raises(InputError, match=r"quad\.json is none of a pair"):
            load(path)
    path.write_text(json.dumps(minimal()[0] | {"arrays": "a\0"}))
    with pytest.raises(InputError, match="no file in its folder or below"):
        load(path)
    for scene, place in ((teapot, 5), (3, path), (teapot, "")):
        with pytest.raises(InputError, match="save needs a scene and the name"):
            save(scene, place)
    with pytest.raises(InputError, match="teapot is no control mesh"):
        save(teapot, tmp_path / "t.json")
    with pytest.raises(InputError, match=r"saved under the name of its \.json file"):
        save(load("walker"), tmp_path / "t.npz")
    with pytest.raises(InputError, match="cannot be written: No such file or directory"):
        save(load("walker"), tmp_path / "none" / "t.json")


def npz(path: Path, members: dict[str, bytes], how: int = zipfile.ZIP_DEFLATED) -> None:
    with zipfile.ZipFile(path, "w", how) as file:
        for name, data in members.items():
            file.writestr(name, data)


def test_arrays_that_would_fill_the_memory(tmp_path):
    """Nothing is inflated before all that a file tells is found to be small enough, and no more than it tells."""
    path = put(tmp_path, *minimal())
    zeros, many = bytes(30_000_000), tmp_path / "quad.npz"
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"shape": (10**9, 3), "fortran_order": False, "descr": "<f8"})
    npz(many, {"vertices.npy": header.getvalue() + bytes(100)})
    with pytest.raises(InputError, match=r"quad\.npz tells of 3,000,000,000 numbers in an array .* has 100 bytes"):
        load(path)
    npz(many, {"vertices.npy": zeros})
    honest = many.read_bytes()
    told = struct.pack("<I", len(zeros))
    assert honest.count(told) == 2
    for size, says in ((2_000_000_000, r"quad\.npz has 2,000 MB, more than"), (1000, r"no \.npz file of plain arrays")):
        many.write_bytes(honest.replace(told, struct.pack("<I", size)))
        tracemalloc.start()
        try:
            with pytest.raises(InputError, match=says):
                load(path)
            assert tracemalloc.get_traced_memory()[1] < 1_000_000
        finally:
            tracemalloc.stop()
    npz(many, {"vertices.npy": zeros}, zipfile.ZIP_BZIP2)
    with pytest.raises(InputError, match=r"no \.npz file of plain arrays"):
        load(path)


@pytest.mark.parametrize("order", ["<f8", ">f4", "<i2", "F"])
def test_arrays_of_other_layouts(tmp_path, order):
    names, arrays = minimal()
    made = np.asarray(arrays["vertices"])
    arrays["vertices"] = np.asfortranarray(made) if order == "F" else made.astype(order)
    scene = load(put(tmp_path, names, arrays))
    assert scene.conversion is not None
    assert np.array_equal(scene.conversion.mesh.vertices, made)


def test_small_faces_of_a_pair(tmp_path):
    names, arrays = minimal()
    arrays.update(sizes=[4, 2, 0], corners=[0, 1, 2, 3, 0, 1])
    path = put(tmp_path, names, arrays)
    with pytest.raises(InputError, match=r"quad\.json: face 1 has 2 vertices, and needs three, and 1 more like it"):
        load(path)
    assert len(load(path, drop_defects=True).patches()) == 1


def test_copies_stand_side_by_side_and_move_alike(walker):
    both: Any = load("walker", copies=2)
    count = walker.conversion.mesh.vertex_count
    assert len(both.patches()) == 2 * len(walker.patches())
    assert len(both.rig.skeleton.names) == 40
    assert both.rig.skeleton.names[20:22] == ("hips 2", "spine 2")
    assert both.rig.keys.names[6] == "smile 2"
    step = np.array([1.1 * np.ptp(walker.conversion.mesh.vertices[:, 0]), 0.0, 0.0])
    for time in (None, 5.0):
        one, two = (np.asarray(scene.vertices(scene.rig.pose(time))) for scene in (walker, both))
        np.testing.assert_allclose(two[:count], one, atol=1e-14)
        np.testing.assert_allclose(two[count:], one + step, atol=1e-14)
    view = View(both.default_camera(), 480, 300)
    factors = Session(both, method="fixed").factors(view, both.rig.pose(3.0, keys={"belly 2": 1.0}))
    assert np.isfinite(factors.factor).all()


def test_copies_that_are_none(tmp_path, models):
    path = write(tmp_path, "cube.obj", CUBE)
    assert len(load(path, copies=3).patches()) == 18
    for copies in (0, 1.5, True, 10**6):
        if copies is not True:
            with pytest.raises(InputError, match="copies must be a whole number from 1 to 1000"):
                load(path, copies=copies)
    with pytest.raises(InputError, match="copies has no meaning"):
        load("teapot", copies=2)
    with pytest.raises(InputError, match="holds no control mesh: copies has no meaning"):
        load(models / "teapot.bpt", copies=2)
