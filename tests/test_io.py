"""Readers other than .bpt: what they understand, and how they say what they do not."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

import numpy as np
import pytest

from slefejax import InputError, load, save
from slefejax.geometry.bezier import evaluate_patch, from_triangle
from slefejax.io.bv import read_bv
from slefejax.io.obj import read_obj
from slefejax.loading import read


def write(tmp_path, name, content):
    path = tmp_path / name
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    return path


OBJ = """# a square and a triangle
v 0 0 0
v 1 0 0 1.0
v 1 1 0
v 0 1 0
vt 0 0
vn 0 0 1
o thing
g first
usemtl grey
f 1/1/1 2//1 3/1 4
v 2 0.5 0
g second side
s off
f -4 -1 -3   # 2 5 3
"""


def polygons(content):
    assert content.mesh is not None
    return content.mesh


def faces(mesh):
    return [mesh.corners[a:b].tolist() for a, b in zip(mesh.offsets[:-1], mesh.offsets[1:], strict=True)]


def test_obj(tmp_path):
    content = read_obj(write(tmp_path, "a.obj", OBJ))
    assert faces(polygons(content)) == [[0, 1, 2, 3], [1, 4, 2]]
    assert polygons(content).vertices[4].tolist() == [2, 0.5, 0]
    assert content.notes == ()
    assert content.up == (0, 1, 0)


@pytest.mark.parametrize(
    "change",
    [
        lambda text: text.replace("\n", "\r\n"),
        lambda text: text.replace("\n", "\r"),
        lambda text: text.replace("v 1 0 0 1.0", "v 1 \\\n 0 \\\n 0"),
        lambda text: text.replace(" ", "\t"),
        lambda text: "\ufeff" + text,
        lambda text: text.rstrip(),
        lambda text: text.encode().replace(b"a square", b"a sq\xfcare"),
        lambda text: text.replace("2 0.5 0", "2 +.5E0 0 .1 .2 .3"),
    ],
)
def test_obj_in_other_clothes(tmp_path, change):
    mesh = polygons(read_obj(write(tmp_path, "a.obj", change(OBJ))))
    assert faces(mesh) == [[0, 1, 2, 3], [1, 4, 2]]
    assert mesh.vertices[[1, 4]].tolist() == [[1, 0, 0], [2, 0.5, 0]]


def test_a_comment_begins_where_a_word_begins(tmp_path):
    text = OBJ.replace("g first", "g part#1  # the first").replace("o thing", "o a#b")
    path = write(tmp_path, "a.obj", text.replace("v 2 0.5 0", "v 2 0.5 0 #0"))
    assert faces(polygons(read_obj(path, "part#1"))) == [[0, 1, 2, 3]]
    assert len(polygons(read_obj(path, "a#b")).sizes) == 2
    for number in ("-1.#IND00", "1.#QNAN", "1.#INF", "-1.#J", "nan(ind)", "-nan", "0#"):
        path = write(tmp_path, "b.obj", OBJ.replace("0.5 0", f"0.5 {number}"))
        with pytest.raises(InputError, match=r"b\.obj, line 12: a coordinate should be a finite number") as raised:
            load(path)
        assert repr(number) in str(raised.value)


@pytest.mark.parametrize("small", ["f 1 2", "f 3", "f"])
def test_obj_faces_of_fewer_than_three_vertices(tmp_path, small):
    count = len(small.split()) - 1
    path = write(tmp_path, "a.obj", OBJ.replace("g second", f"{small}\ng second") + "t crease 2/1/0 0 1 2\n")
    with pytest.raises(InputError, match=rf"a\.obj: face 1 has {count} vertices, and needs three .*drop_defects"):
        load(path)
    several: list[dict[str, Any]] = [{}, {"scheme": "catmull-clark+acc"}, {"copies": 2}, {"group": ("first", "second")}]
    for options in several:
        scene = load(path, drop_defects=True, **options)
        assert scene.conversion is not None
        mesh = scene.conversion.mesh
        copies = options.get("copies", 1)
        assert faces(mesh)[:2] == [[0, 1, 2, 3], [1, 4, 2]]
        assert mesh.numbers.tolist() == [0, 2, 3, 5][: 2 * copies]
        assert mesh.creases.tolist() == [[0, 1], [5, 6]][:copies]
        assert f"face 1 has {count} vertices" in scene.notes[0]
        save(scene, tmp_path / "pair.json")
        assert np.array_equal(load(tmp_path / "pair.json", options.get("scheme", "auto")).patches(), scene.patches())
    only = write(tmp_path, "b.obj", "v 0 0 0\nv 1 0 0\nv 1 1 0\n" + small)
    with pytest.raises(InputError, match=r"b\.obj: face 0 has .*without such faces nothing is left"):
        load(only, drop_defects=True)


def test_runs_of_plain_lines_are_read_as_single_ones(tmp_path, rng):
    """Lone CR and comments behind statements make lines that are no plain ones; what is wrong is told by its line."""
    lines = [f"v {x:.3f} {y:g} -.{k}e-1" for k, (x, y) in enumerate(rng.normal(size=(60, 2)))]
    lines += [f"vt 0.{k} 1" for k in range(20)]
    for k, at in enumerate(rng.integers(1, 58, size=5000)):
        lines += [f"g part{k % 7}"] * (k % 100 == 0)
        lines += [f"f {at}/1/2 {at + 1}//3 {at + 2}" + f" {at + 3}/4" * (k % 2)]
    for group in (None, "part3"):
        found = []
        for end in ("\n", "\r\n", "\r", " # alone\n"):
            mesh = read_obj(write(tmp_path, "grid.obj", end.join([*lines, ""])), group).mesh
            assert mesh is not None
            found.append((mesh.vertices, mesh.corners, mesh.sizes, mesh.numbers))
        for parts in found[1:]:
            assert all(np.array_equal(one, two) for one, two in zip(found[0], parts, strict=True))
        assert len(found[0][2]) == (5000 if group is None else 700)
    for place in (70, 3000, 5100):
        path = write(tmp_path, "wrong.obj", "\n".join([*lines[:place], "f 1 2 x", *lines[place:]]))
        with pytest.raises(InputError, match=rf"wrong\.obj, line {place + 1}: a face should name vertices"):
            read_obj(path)


def test_obj_groups(tmp_path):
    path = write(tmp_path, "a.obj", OBJ)
    assert faces(polygons(read_obj(path, "first"))) == [[0, 1, 2, 3]]
    assert faces(polygons(read_obj(path, ("side",)))) == [[1, 4, 2]]
    assert len(polygons(read_obj(path, "thing")).sizes) == 2
    assert len(load(path, group="first").patches()) == 1
    with pytest.raises(InputError, match=r"no group with faces 'third'.*: choose one of first, second, side, thing"):
        read_obj(path, ("first", "third"))
    with pytest.raises(InputError, match="group has a meaning for"):
        read(write(tmp_path, "a.bpt", "1"), "first")


def test_obj_tags_and_what_is_left_out(tmp_path):
    tags = (
        "t crease 2/1/0 0 1 2.5\nt crease 3/2/0 1 2 3 1 4\nt corner 1/1/0 0 inf\nt interpolateboundary 1/0/0 1\n"
        "t facevaryinginterpolateboundary 1/0/0 1\nl 1 2\nl 2 3\n"
    ).replace("inf", "10")
    content = read_obj(write(tmp_path, "a.obj", OBJ + tags))
    assert polygons(content).creases.tolist() == [[0, 1], [1, 2], [2, 3]]
    assert polygons(content).crease_sharpness.tolist() == [2.5, 1, 4]
    assert polygons(content).points.tolist() == [0]
    assert content.notes == (
        "statements that are not read were left out: 2 of 'l', 1 of 't facevaryinginterpolateboundary'",
    )
    grouped = read_obj(write(tmp_path, "b.obj", OBJ + tags), "second")
    assert polygons(grouped).creases.tolist() == [[1, 2]]


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "has no faces"),
        ("v 0 0 0\n", "has no faces"),
        ("v 0 0\n", "line 1: a vertex needs three coordinates, not 2"),
        ("v 0 0 x\n", "line 1: a coordinate should be a finite number, not 'x'"),
        ("v 0 0 nan\n", "line 1: a coordinate should be a finite number"),
        ("v 0 0 1_0\n", "line 1: a coordinate should be"),
        ("v 0 0 0\n\nf 1 1\n", "face 0 has 2 vertices, and needs three"),
        ("v 0 0 0\nf 0 1 1\n", "line 2: a face should name vertices by their numbers, from 1 on, not '0'"),
        ("v 0 0 0\nf 1 -2 1\n", "line 2: vertex -2 is counted back beyond the first of 1"),
        ("v 0 0 0\nf 1 /1 1\n", "line 2: a face should name"),
        ("v 0 0 0\nf 1.0 1 1\n", "line 2: a face should name"),
        ("v 0 0 0\nf 1 2 3\n", "line 2: the face names vertex 2, but there are 1"),
        ("t crease 2/1/0 0\n", "line 1: a tag 'crease' needs vertices and one sharpness"),
        ("t crease\n", "line 1: a tag should be"),
        ("t crease 2/1/0 0 1 -2\n", "line 1: a sharpness must not be negative"),
        ("t crease 2/1/0 0 1_0 1\n", "line 1: a tag 'crease' should begin with 2 whole numbers"),
        ("t crease -2/1/0 0 1 1\n", "line 1: a tag should be"),
        ("v 0 0 0\n\r\rf 1 x 1\n", "line 4: a face should name"),
        (OBJ + "t crease 2/1/0 0 9 1\n", "crease 0 .* names vertex 9, but there are 5"),
        (OBJ + "t crease 2/1/0 0 4 1\n", "crease 0 joins vertices 0 and 4"),
        (b"v 0 0 0\0", "not a text file"),
    ],
)
def test_bad_obj_files_are_named_with_the_line(tmp_path, text, says):
    path = write(tmp_path, "a.obj", text)
    with pytest.raises(InputError, match=says) as raised:
        load(path)
    assert str(path) in str(raised.value)
    assert "\n" not in str(raised.value)


def test_every_cut_of_an_obj_file_is_refused_or_read(tmp_path):
    """A cut may leave a whole file behind; whatever it leaves, there is an answer in one sentence."""
    whole = OBJ.encode()
    for end in range(len(whole)):
        with suppress(InputError):
            load(write(tmp_path, "a.obj", whole[:end]), drop_defects=True)


BV = """
Group 0 some name
1
4 2
0 0 0  1 0 0  1 1 0  0 1 0
3 0 1 2
3 0 2 3
Group 1
5
1 2
0 0 0   0 1 0   0 2 0
1 0 0   1 1 1   1 2 0
4
1
0 0 5   0 1 5
1 0 5   1 1 5
3
2
0 0 0  1 0 0  2 0 0
 0 1 0  1 1 3
   0 2 0
8
1 1
0 0 0 1   0 2 0 2
1 0 0 1   .5 .5 0 .5
9
1 1
0 0 0 1 0 0 0 1 0
0 0 1 0 0 1 0 0 1
10
1 1 1 1
0 0 0  0 1 0
1 0 0  1 1 0
0 0 1  0 0 1
0 0 1  0 0 1
"""


def test_bv(tmp_path):
    content = read_bv(write(tmp_path, "a.bv", BV))
    assert faces(polygons(content)) == [[0, 1, 2], [0, 2, 3]]
    assert [p.shape for p in content.patches] == [(2, 3, 3), (2, 2, 3), (3, 3, 3), (2, 2, 4), (2, 2, 3), (2, 2, 3)]
    assert content.patches[0][1, 1].tolist() == [1, 1, 1]
    assert content.notes == ("the normals of 2 patches were left out",)
    scene = load(write(tmp_path, "a.bv", BV))
    assert scene.patches().shape == (8, 4, 4, 4)
    assert any("raised to bi-degree 3 x 3" in note for note in scene.notes)
    assert any("7 of 8 patches got weights of 1" in note for note in scene.notes)
    assert scene.faces is not None
    assert scene.faces.tolist() == [0, 1, 0, 1, 2, 3, 4, 5]
    assert scene.conversion is None, "there are patches beside those of the mesh"


def test_triangular_patches_are_themselves(rng):
    """Against the triangle's own Bernstein form, at random barycentric coordinates."""
    from math import factorial

    for degree in range(1, 6):
        points = rng.normal(size=((degree + 1) * (degree + 2) // 2, 3))
        patch = from_triangle(points, degree)
        assert patch.shape == (degree + 1, degree + 1, 3)
        assert np.all(patch[-1] == patch[-1, 0])
        u, v = rng.random((2, 7))
        a, b, c = (1 - u) * v, (1 - u) * (1 - v), u  # of the first, the last of the first row, the top
        wanted = np.zeros((7, 3))
        places = iter(points)
        for k in range(degree + 1):
            for j in range(degree - k + 1):
                i = degree - k - j
                count = factorial(degree) / (factorial(i) * factorial(j) * factorial(k))
                wanted += (count * a**i * b**j * c**k)[:, None] * next(places)
        np.testing.assert_allclose(evaluate_patch(patch[..., None], u, v).T, wanted, atol=1e-14)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("", "holds no surface"),
        ("Group", "line 1: the file ends where the number of a group should be"),
        ("Group 1 name", "line 1: the file ends where the kind of a surface should be"),
        ("7\n1 1\n", "line 1: '7' is no kind of surface that is read"),
        ("5\n1 1\n0 0 0 0 0 0\n", "line 3: the file ends where a coordinate of a patch"),
        ("5\n1 0\n", "line 2: the degree v of a patch should be a whole number from 1 to 64, not '0'"),
        ("8\n1 1\n0 0 0 1  0 0 0 0\n0 0 0 1  0 0 0 1\n", "a weight of the patch that begins after line 2 is not pos"),
        ("1\n3 1\n0 0 0 1 0 0 0 1 0\n3 0 1 3\n", "line 4: the number of a vertex .* from 0 to 2, not '3'"),
        ("1\n3 1\n0 0 0 1 0 0 0 1 0\n2 0 1\n", "a.bv: face 0 has 2 vertices, and needs three"),
        ("1\n3 1\n0 0 0 1 0 0 0 1 0\n-2 0 1\n", "line 4: the number of vertices of face 0"),
        ("1\n3 1\n0 0 0 1 0 0 0 1 inf\n3 0 1 2\n", "line 3: a coordinate of a vertex is not a finite number"),
    ],
)
def test_bad_bv_files_are_named_with_the_line(tmp_path, text, says):
    path = write(tmp_path, "a.bv", text)
    with pytest.raises(InputError, match=says) as raised:
        load(path)
    assert str(path) in str(raised.value)


@pytest.mark.parametrize("name", ["a.usda", "a.3dm"])
def test_missing_extras_are_one_sentence(tmp_path, monkeypatch, name):
    import sys

    monkeypatch.setitem(sys.modules, "pxr", None)
    monkeypatch.setitem(sys.modules, "rhino3dm", None)
    with pytest.raises(InputError, match=r"install (usd-core|rhino3dm) \(pip install"):
        load(write(tmp_path, name, "something"))


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".usda", ".3dm", ".bv"])
def test_files_that_are_not_there(tmp_path, suffix):
    with pytest.raises(InputError, match="there is no file"):
        load(tmp_path / f"no{suffix}")
    with pytest.raises(InputError, match="FBX is not supported"):
        load(tmp_path / "some.fbx")
