"""Texture coordinates: read, kept, handed to patches; and pictures that are looked up at them."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from slefejax import Camera, InputError, View, load, pixel_error, save
from slefejax.conversion.acc import patch_corners
from slefejax.conversion.catmull_clark import refine
from slefejax.conversion.scheme import convert
from slefejax.experiments.cli import main
from slefejax.experiments.looks.picture import checker_picture, looked_up, read_picture
from slefejax.experiments.looks.texture import Texture, Textured, _worst_part, displacement, texture
from slefejax.gpu import Renderer
from slefejax.io.content import joined
from slefejax.io.obj import read_obj
from slefejax.loading import read
from slefejax.measure.exact import exact_parameters
from slefejax.model.mesh import Mesh
from slefejax.model.texture import texture_at
from tests.gltf_files import FACES, TETRAHEDRON, Writer, primitive_of
from tests.gltf_files import save as save_gltf
from tests.meshes import grid, triangle_fan
from tests.test_cli import SMALL, in_an_empty_folder, run_json  # noqa: F401
from tests.test_exr import read_exr
from tests.test_gpu import above, lattice
from tests.test_io import OBJ, polygons, write
from tests.test_scene import CUBE
from tests.test_usd import USD
from tests.test_wire import square

# a pentagon beside a triangle and a quad; corners of one vertex differ
TEXTURED = """v 0 0 0
v 2 0 0
v 3 1 0
v 1 3 0
v -1 1 0
v 4 3 0
v 2 4 0
vt 0 0
vt 1 0 0
vt 1 0.5
vt 0.5 1 7
vt 0 .5
f 1/1 2/2 3/3 4/4 5/5
f 3/5/ -2/-5/ 4/1//
f 4/1 6/2/1 7/3
"""
FROM_ABOVE = ["--eye", "1", "1", "9", "--method", "fixed", "--setting", "4"]
PENTAGON = [[0, 0], [1, 0], [1, 0.5], [0.5, 1], [0, 0.5]]


def textured(mesh: Mesh, rng) -> Mesh:
    return replace(mesh, texture=rng.uniform(size=(len(mesh.corners), 2)))


def kept(content: Any) -> np.ndarray:
    found = polygons(content).texture
    assert found is not None
    return found


def test_obj_corners(tmp_path):
    mesh = polygons(read_obj(write(tmp_path, "a.obj", TEXTURED.replace("4/1//", "4/1/"))))
    assert mesh.texture is not None
    assert mesh.texture[:5].tolist() == PENTAGON
    assert mesh.texture[5:].tolist() == [[0, 0.5], [0, 0], [0, 0], [0, 0], [1, 0], [1, 0.5]]


def test_corners_without_coordinates_have_nan(tmp_path):
    mesh = polygons(read_obj(write(tmp_path, "a.obj", OBJ)))  # two corners of seven name one
    assert mesh.texture is not None
    assert np.isnan(mesh.texture).all(axis=1).tolist() == [False, True, False, True, True, True, True]
    assert polygons(read_obj(write(tmp_path, "b.obj", CUBE))).texture is None
    odd = "vt nan 1\nvt 0.25\n" + CUBE.replace("f 1 ", "f 1/1 ", 1).replace("f 5 ", "f 5/2 ", 1)
    found = kept(read_obj(write(tmp_path, "c.obj", odd)))
    assert np.count_nonzero(~np.isnan(found[:, 0])) == 1
    assert found[~np.isnan(found[:, 0])].tolist() == [[0.25, 0.0]]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (("f 1/1 2/2", "f 1/1 2/9"), "line 13: the face names texture coordinate 9, but there are 5: is the file"),
        (("f 1/1 2/2", "f 1/1 2/0"), "a face should name texture coordinates by their numbers, from 1 on, not '0'"),
        (("f 1/1 2/2", "f 1/1 2/-6"), "texture coordinate -6 is counted back beyond the first of 5"),
        (("vt 0 0\n", "vt 0 x\n"), "line 8: a texture coordinate should be a number, not 'x'"),
        (("vt 0 0\n", "vt\n"), "line 8: texture coordinates need a number at least"),
    ],
)
def test_bad_obj_is_one_sentence(tmp_path, change, says):
    with pytest.raises(InputError, match=says):
        load(write(tmp_path, "a.obj", TEXTURED.replace("4/1//", "4/1/").replace(*change)))


def test_gltf_has_its_second_coordinate_down(tmp_path, rng):
    """Beside it a mirrored copy, whose faces turn round, and a primitive without any."""
    writer, st = Writer(), rng.uniform(size=(4, 2)).astype(np.float32)
    with_st = primitive_of(writer, TETRAHEDRON, FACES)
    with_st["attributes"]["TEXCOORD_0"] = writer.array(st)
    plain = primitive_of(writer, TETRAHEDRON + 2.0, FACES)
    nodes = [{"mesh": 0}, {"mesh": 1, "scale": [-1, 1, 1], "translation": [5, 0, 0]}]
    meshes = [{"primitives": [with_st, plain]}, {"primitives": [with_st]}]
    content = writer.content(nodes=nodes, meshes=meshes, scenes=[{"nodes": [0, 1]}])
    found = kept(read(save_gltf(tmp_path, content))).reshape(-1, 3, 2)
    wanted = (st * [1, -1] + [0, 1])[FACES]
    np.testing.assert_array_equal(found[:4], wanted)
    assert np.isnan(found[4:8]).all()
    np.testing.assert_array_equal(found[8:], wanted[:, [0, 2, 1]])


def test_gltf_splits_do_not_matter(tmp_path):
    """A vertex for every corner, whole numbers that stand for fractions; welded, corners keep what they had."""
    writer = Writer()
    st = np.arange(24).reshape(12, 2) * 1000
    primitive = primitive_of(writer, TETRAHEDRON[FACES.ravel()], np.arange(12).reshape(4, 3))
    primitive["attributes"]["TEXCOORD_0"] = writer.array(st, "<u2", normalized=True)
    content = writer.content(nodes=[{"mesh": 0}], meshes=[{"primitives": [primitive]}], scenes=[{"nodes": [0]}])
    mesh = polygons(read(path := save_gltf(tmp_path, content)))
    assert mesh.vertex_count == 4
    np.testing.assert_allclose(kept(read(path)), st / 65535 * [1, -1] + [0, 1], atol=1e-15)
    primitive["attributes"]["TEXCOORD_0"] = writer.array(st[:5], "<u2", normalized=True)
    content = writer.content(nodes=[{"mesh": 0}], meshes=[{"primitives": [primitive]}], scenes=[{"nodes": [0]}])
    with pytest.raises(InputError, match="TEXCOORD_0 has 5 rows for 12 vertices"):
        load(save_gltf(tmp_path, content))


def stage(tmp_path, attributes: str):
    text = USD.replace("int[] creaseIndices", attributes + "\n        int[] creaseIndices", 1)
    return write(tmp_path, "a.usda", text)


def test_usd_primvars(tmp_path):
    pytest.importorskip("pxr", reason="usd-core is not installed")
    pairs = np.arange(16).reshape(8, 2) / 16
    said = "[" + ", ".join(f"({s}, {t})" for s, t in pairs) + "]"
    numbers = "[" + ", ".join(str(k % 8) for k in range(24)) + "]"
    declared = f"texCoord2f[] primvars:st = {said} "
    by_vertex = stage(tmp_path, declared + '(interpolation = "vertex")')
    mesh = polygons(read(by_vertex))
    np.testing.assert_array_equal(kept(read(by_vertex)), pairs[mesh.corners])
    of_corners = declared + f'(interpolation = "faceVarying")\n        int[] primvars:st:indices = {numbers}'
    np.testing.assert_array_equal(kept(read(stage(tmp_path, of_corners))), np.tile(pairs, (3, 1)))
    turned = kept(read(stage(tmp_path, of_corners + '\n        uniform token orientation = "leftHanded"')))
    np.testing.assert_array_equal(turned.reshape(6, 4, 2), np.tile(pairs, (3, 1)).reshape(6, 4, 2)[:, [0, 3, 2, 1]])
    content = read(stage(tmp_path, declared + '(interpolation = "uniform")'))
    assert polygons(content).texture is None
    assert "/top/cube: primvars:st of interpolation 'uniform' was left out" in content.notes
    with pytest.raises(InputError, match="/top/cube: primvars:st should be 24 pairs of numbers, not an array"):
        read(stage(tmp_path, declared + '(interpolation = "faceVarying")'))


def test_subdivided_faces_have_linear_coordinates(tmp_path):
    """The pentagon's children by hand: corner, middle of the edge, mean of the face, middle of the edge before."""
    scene = load(write(tmp_path, "a.obj", TEXTURED.replace("4/1//", "4/1/")))
    found, own = scene.texture_coordinates(), np.array(PENTAGON)
    assert found.shape == (11, 2, 2, 2)
    for k in range(5):
        before, behind = 0.5 * (own[k] + own[k - 1]), 0.5 * (own[k] + own[(k + 1) % 5])
        wanted = [[own[k], before], [behind, own.mean(axis=0)]]
        np.testing.assert_allclose(found[k], wanted, atol=1e-15)
    twice = load(tmp_path / "a.obj", steps=2).texture_coordinates()
    np.testing.assert_allclose(twice[0, 1, 1], found[0].mean(axis=(0, 1)), atol=1e-15)


def test_a_pinched_triangle_is_linear(tmp_path, rng):
    scene = load(write(tmp_path, "a.obj", "v 0 0 0\nv 1 0 0\nv 0 1 0\nvt 0 1\nvt .5 0\nvt 1 1\nf 1/1 2/2 3/3\n"))
    found = scene.texture_coordinates()
    # all valences are equal: the vertex of the lowest number is the pinch
    np.testing.assert_array_equal(found[0], [[[1, 1], [0.5, 0]], [[0, 1], [0, 1]]][:1] + [[[0, 1], [0, 1]]])
    u, v = rng.uniform(size=(2, 50))
    weights = np.stack([(1 - u) * (1 - v), (1 - u) * v, u], axis=1)
    wanted = weights @ found[0].reshape(4, 2)[:3]
    np.testing.assert_allclose(texture_at(found, np.zeros(50, int), u, v), wanted, atol=1e-15)


@pytest.mark.parametrize("scheme", ["acc", "pinched", "gregory", "catmull-clark+acc", "catmull-clark+gregory"])
def test_corners_are_those_of_the_net(scheme, rng):
    """Points of nets that are vertices have those vertices' numbers."""
    mesh = grid(4, 4, rng=rng) if scheme == "acc" else triangle_fan(5, rng=rng)
    found = convert(mesh, scheme)
    corners = found.finer.corners[patch_corners(found.finer)]
    np.testing.assert_array_equal(corners, found.patchwork.net[:, [0, 0, -1, -1], [0, -1, 0, -1]].reshape(-1, 2, 2))


def test_meshes_that_are_cut_joined_or_turned(rng):
    one, other = textured(grid(3, 3), rng), grid(2, 2)
    assert one.texture is not None
    keep = np.array([True, False, True, True])
    assert np.array_equal(one.keep(keep).texture, one.texture.reshape(4, 4, 2)[keep].reshape(-1, 2))  # type: ignore[arg-type]
    turned = one.turned()
    for vertex in range(9):  # a corner is a face and a vertex
        for mesh in (one, turned):
            assert mesh.texture is not None
        mine, its = (
            {(int(f), *t) for f, v, t in zip(m.face, m.corners, m.texture.tolist(), strict=True) if v == vertex}  # type: ignore[union-attr]
            for m in (one, turned)
        )
        assert mine == its
    both = joined([one, other]).texture
    assert both is not None
    assert np.array_equal(both[:16], one.texture)
    assert np.isnan(both[16:]).all()
    assert joined([other, other]).texture is None
    assert refine(other)[0].texture is None


def test_loading_keeps_them(tmp_path):
    """Defects dropped, a group, copies, steps of motion, a pair of files."""
    path = write(tmp_path, "a.obj", TEXTURED.replace("4/1//", "4/1/") + "f 1/2 1/3 2/1\ng last\nf 2/5 1/4 5/3\n")
    whole = kept(read(path))
    dropped = load(path, drop_defects=True)
    assert dropped.conversion is not None
    assert np.array_equal(dropped.conversion.mesh.texture, np.delete(whole, [11, 12, 13], axis=0))  # type: ignore[arg-type]
    last = load(path, group="last")
    assert last.conversion is not None
    assert np.array_equal(last.conversion.mesh.texture, whole[-3:])  # type: ignore[arg-type]
    twice = load(path, group="last", copies=2)
    found = last.texture_coordinates()
    assert np.array_equal(twice.texture_coordinates(), np.concatenate([found, found]))
    save(last, tmp_path / "b.json")
    assert np.array_equal(load(tmp_path / "b.json").texture_coordinates(), found)


def test_shared_models(models):
    """A file's own numbers, read here line by line; a character keeps them as it moves."""
    lines = [line.split() for line in (models / "spot_control_mesh.obj").read_text().splitlines()]
    known = [tuple(map(float, words[1:3])) for words in lines if words[:1] == ["vt"]]
    wanted = [known[int(item.split("/")[1]) - 1] for words in lines if words[:1] == ["f"] for item in words[1:]]
    assert np.array_equal(kept(read(models / "spot_control_mesh.obj")), wanted)
    fox = load(models / "fox.glb")
    found = fox.texture_coordinates()
    assert found.shape == (576, 2, 2, 2)
    assert 0.0 < found.min() < found.max() < 1.0
    assert np.array_equal(fox.posed(0.5).texture_coordinates(), found)
    assert np.array_equal(load(models / "fox.glb", copies=2).texture_coordinates()[576:], found)


class Odd:
    """A scheme of one's own."""

    def patchwork(self, mesh):
        return convert(mesh, "acc").patchwork


def test_scenes_without(tmp_path, teapot):
    with pytest.raises(InputError, match="teapot is no control mesh: only those have texture coordinates"):
        teapot.texture_coordinates()
    with pytest.raises(InputError, match="a has no texture coordinates: export the mesh with them"):
        load(write(tmp_path, "a.obj", CUBE)).texture_coordinates()
    quad = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nf 1/1 2/1 3/1 4/1\n"
    with pytest.raises(InputError, match="patches of the scheme 'Odd' have no texture coordinates"):
        load(write(tmp_path, "b.obj", quad), scheme=Odd()).texture_coordinates()


@pytest.mark.parametrize(
    ("wrong", "says"),
    [(np.zeros((3, 2)), r"an array \(4, 2\), one for every corner"), (np.full((4, 2), np.inf), "must be finite")],
)
def test_wrong_coordinates(wrong, says):
    with pytest.raises(InputError, match=says):
        Mesh.packed([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [0, 1, 2, 3], [4], texture=wrong)


def reference(picture: np.ndarray, s: float, t: float) -> np.ndarray:
    """OpenGL's GL_LINEAR and GL_REPEAT as its specification has them, one lookup at a time."""
    height, width = picture.shape[:2]
    u, v = (s % 1.0) * width, (t % 1.0) * height
    i, j = int(np.floor(u - 0.5)), int(np.floor(v - 0.5))
    a, b = (u - 0.5) % 1.0, (v - 0.5) % 1.0
    i0, i1, j0, j1 = i % width, (i + 1) % width, j % height, (j + 1) % height
    low = (1 - a) * picture[j0, i0] + a * picture[j0, i1]
    return (1 - b) * low + b * ((1 - a) * picture[j1, i0] + a * picture[j1, i1])


def test_lookups(rng):
    picture, at = rng.uniform(size=(3, 5, 3)), rng.uniform(-3.0, 3.0, (200, 2))
    wanted = [reference(picture, *place) for place in at]
    np.testing.assert_allclose(looked_up(picture, at), wanted, atol=1e-12)
    assert np.isnan(looked_up(picture, np.array([[np.nan, 0.0]]))).all()


def of(device, patches, coordinates, view, level, picture, finer=64) -> Textured:
    """Every patch cut evenly."""
    levels, fine, coarse = (np.full((len(patches), 6), n) for n in (level, finer, max(1, level // 2)))
    return Textured(
        patches,
        view,
        Renderer(patches, device),
        levels[:, :2],
        levels[:, 2:],
        texture=Texture(picture, coordinates),
        finer=(fine[:, :2], fine[:, 2:]),
        coarser=(coarse[:, :2], coarse[:, 2:]),
    )


@pytest.mark.gl
def test_a_flat_quad_shows_the_picture(device, rng):
    """Pixel for pixel: straight below centres the colour is what a loop looks up."""
    picture = rng.uniform(size=(7, 9, 3))
    st = np.array([[[[-0.3, 0.1], [0.2, 1.4]], [[1.5, -0.2], [1.9, 1.1]]]])
    st[0, 1, 1] = st[0, 1, 0] + st[0, 0, 1] - st[0, 0, 0]
    view = above(height=3.0, size=60)
    look = of(device, square(0.0, 1.6, (-0.8, -0.8)), st, view, 1, picture)
    shown = look.texture.colours(look.seen)  # type: ignore[union-attr]
    rows, columns = np.nonzero(look.seen.patch >= 0)
    assert rows.size > 500
    for row, column in zip(rows, columns, strict=True):
        x, y = ((2 * (k + 0.5) / 60 - 1) * 1.5 for k in (column, row))
        u, v = (x + 0.8) / 1.6, (y + 0.8) / 1.6
        s, t = st[0, 0, 0] + u * (st[0, 1, 0] - st[0, 0, 0]) + v * (st[0, 0, 1] - st[0, 0, 0])
        # parameters in single precision, times a slope of some ten texels a unit
        np.testing.assert_allclose(shown[row, column], reference(picture, s, t), atol=2e-5)
    assert np.isnan(shown[look.seen.patch < 0]).all()
    exact = look.texture.colours(look.exact)  # type: ignore[union-attr]
    np.testing.assert_allclose(exact, shown, atol=2e-5)


@pytest.mark.gl
def test_texels_are_off_by_the_parametric_error(device, rng):
    """Exact parameters are found apart from it, by Newton's method from a fine drawing."""
    patches, view = lattice(rng, 3, 3, relief=1.5), above()
    st = np.tile(np.array([[[0.0, 0.0], [0.0, 1.0]], [[1.0, 0.0], [1.0, 1.0]]]), (len(patches), 1, 1, 1))
    look = of(device, patches, st, view, 3, checker_picture())
    off, exact = displacement(look, look.seen), look.exact
    error = pixel_error(patches, view, look.seen.u, look.seen.v, look.seen.patch)
    left = pixel_error(patches, view, exact.u, exact.v, exact.patch)
    both = (look.seen.patch >= 0) & (exact.patch >= 0)
    assert np.median(error[both]) > 0.1
    found = both & (left < 1e-7)
    assert found.sum() > 0.97 * both.sum()  # others lie at sides, where the neighbour was drawn, and at outlines
    # single precision of places up to some hundred pixels
    np.testing.assert_allclose(off[found], error[found], atol=1e-4)
    assert np.all(np.abs(off - error)[both] <= left[both] + 1e-9)
    made = texture(look)
    assert np.array_equal(made.channels["displacement_px"], off, equal_nan=True)
    # where parameters are the same, so are coordinates
    there = both & (look.seen.patch == exact.patch)
    np.testing.assert_array_equal(made.channels["exact_s"][there], exact.u[there])
    np.testing.assert_allclose(made.channels["t"][there], look.seen.v[there], atol=1e-15)


def test_exact_parameters_of_a_known_surface():
    """A paraboloid from straight above, far away: x and y of a pixel are known."""
    x = np.array([0.0, 0.5, 1.0])
    rise = np.array([0.0, 0.0, 1.0])
    patch = np.stack(np.broadcast_arrays(x[:, None], x, rise[:, None] + rise), axis=-1)[None]
    camera = Camera.look_at((0.5, 0.5, 4.0), (0.5, 0.5, 0.0), up=(0.0, 1.0, 0.0), fov_y=10.0)
    view = View(camera, 8, 8)
    rows, columns = np.indices((8, 8))
    slope = np.tan(np.deg2rad(5.0)) * ((np.stack([columns, rows]) + 0.5) / 4.0 - 1.0)

    def miss(u, v):
        return np.stack([u, v]) - 0.5 - slope * (4.0 - u**2 - v**2)

    seen: Any = type("Seen", (), {"u": np.full((8, 8), 0.4), "v": np.full((8, 8), 0.7), "patch": np.zeros((8, 8), int)})
    seen.patch[0, 0] = -1
    u, v = exact_parameters(patch, view, seen)
    assert np.isnan(u[0, 0])
    assert np.nanmax(np.abs(miss(u, v))) < 1e-10  # the search ends a billionth of a pixel away, of a tenth of a unit


@pytest.mark.gl
def test_the_command(device, capsys, tmp_path, rng):
    write(tmp_path, "a.obj", TEXTURED.replace("4/1//", "4/1/").replace("f 4/1 6/2/1 7/3", "f 4 6 7"))
    Image.fromarray(rng.integers(0, 256, (6, 5, 3)).astype(np.uint8)).save(tmp_path / "p.png")
    words = ["render", str(tmp_path / "a.obj"), *SMALL, "--look", "texture", *FROM_ABOVE, "--format", "exr"]
    result = run_json(capsys, *words, "--texture", str(tmp_path / "p.png"))
    (row,) = result["rows"]
    channels, _ = read_exr(Path(result["out"]) / "texture.exr")
    assert list(channels) == ["displacement_px", "exact_s", "exact_t", "s", "t"]
    assert row["largest"] == pytest.approx(np.nanmax(channels["displacement_px"]), rel=1e-6)
    assert "3 patches have no texture coordinates: they are grey" in result["notes"]
    again = run_json(capsys, *words)
    assert again["out"] != result["out"], "another picture is another run"


@pytest.mark.gl
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--look", "texture", "--texture", "none.png"], "there is no file none.png: check the name"),
        (["--look", "texture", "--texture", "a.obj"], "a.obj is no picture that can be read, such as a PNG file"),
        (["--look", "texture", "--texture", "half.png"], "half.png is no picture that can be read"),
        (["--look", "texture", "--texture", "long.png"], "long.png has 40000 x 1 pixels, and a side may have"),
        (["--look", "wire", "--texture", "p.png"], "--texture has a meaning for --look texture only"),
    ],
)
def test_what_is_no_texture_is_one_sentence(device, capsys, words, says):
    with open("a.obj", "w") as file:
        file.write(TEXTURED.replace("4/1//", "4/1/"))
    Image.new("RGB", (40000, 1)).save("long.png")
    Image.new("RGB", (50, 50)).save("p.png")
    with open("p.png", "rb") as whole, open("half.png", "wb") as half:
        half.write(whole.read()[:60])
    assert main(["render", "a.obj", *SMALL, *FROM_ABOVE, *words]) == 2
    shown = capsys.readouterr()
    assert says in shown.err
    assert shown.err.count("\n") == 1
    assert not os.path.exists("runs")


@pytest.mark.gl
def test_no_coordinates_is_one_sentence(device, capsys):
    assert main(["render", "teapot", *SMALL, "--look", "texture"]) == 2
    assert "teapot is no control mesh: only those have texture coordinates" in capsys.readouterr().err


def test_pictures_have_their_first_row_on_top(tmp_path):
    colours = np.zeros((2, 3, 4), np.uint8)
    colours[0, :, 0] = 255
    Image.fromarray(colours).save(tmp_path / "p.png")
    found = read_picture(tmp_path / "p.png", 100)
    assert found[:, 0].tolist() == [[0, 0, 0], [1, 0, 0]]


def test_the_worst_part_lies_in_what_is_shown():
    off = np.full((40, 60), np.nan)
    off[10:30, 20:60] = 0.1
    off[28, 58] = 5.0
    rows, columns = _worst_part(off, (slice(8, 42), slice(18, 62)))  # with a margin that reaches beyond the picture
    assert (rows.stop - rows.start, columns.stop - columns.start) == (8, 10)
    assert rows.start <= 28 < rows.stop <= 40
    assert columns.start <= 58 < columns.stop <= 60
