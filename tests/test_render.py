"""slefejax render: its looks, their numbers, and what it says where there is nothing to draw."""

from __future__ import annotations

import json
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from matplotlib.image import imread

from slefejax import NoOpenGLError, View, drawn_error, exact_normals, tessellation_factors
from slefejax.experiments.cli import main
from slefejax.experiments.levels import levels_of
from slefejax.experiments.looks import render
from slefejax.experiments.looks.checker import squares
from slefejax.experiments.looks.light import lit
from slefejax.experiments.looks.triangle_sizes import CLASSES, size_rows
from slefejax.experiments.store import open_first
from slefejax.experiments.studies.measures import areas
from slefejax.figures.error_image import error_colours
from slefejax.figures.looks.panels import Heading
from slefejax.figures.looks.pictures import wired, write_errors, write_values
from slefejax.figures.page import Page
from slefejax.gpu import GBuffer, Renderer
from tests.tables import SHOWN, TABLES
from tests.test_cli import SMALL, in_an_empty_folder, run_json  # noqa: F401
from tests.test_exr import read_exr
from tests.test_gpu import lattice
from tests.test_io import write
from tests.test_scene import CUBE
from tests.test_wire import above, square

QUICK = [*SMALL, "--method", "fixed", "--setting", "5"]
PICTURES = ("shaded", "reflection")  # and no numbers
FEW = ("error", "factors", "depth", "checker", "triangle-size")
PLAIN = tuple(name for name in render.LOOKS if name != "texture")  # of what has no texture coordinates


@pytest.mark.gl
@pytest.mark.parametrize("looks", [FEW, pytest.param(PLAIN, marks=pytest.mark.slow)], ids=["few", "all"])
def test_looks_and_their_numbers(device, capsys, teapot, looks):
    """Pictures, numbers of pixels and their summary; the numbers are those of the same levels drawn here."""
    result = run_json(capsys, "render", "teapot", *QUICK, "--format", "exr", "--look", *looks)
    out, rows = result["out"], {row["look"]: row for row in result["rows"]}
    numbers = [name for name in looks if name not in PICTURES]
    names = {f"{name}.png" for name in looks} | {f"{name}.exr" for name in numbers}
    sizes = {name.replace("table", "triangle_sizes") for name in TABLES}
    assert set(os.listdir(out)) == names | SHOWN | sizes
    assert open_first(Path(out)).name == f"{looks[0]}.png"
    assert list(rows) == list(looks)
    without = [name for name in looks if name in PICTURES]
    assert (f"no .exr file of what has no numbers: {', '.join(without)}" in result["notes"]) == bool(without)
    for name in looks:
        picture = imread(f"{out}/{name}.png")
        assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 10, name
    levels = np.full((32, 6), 5)
    view = View(teapot.default_camera(), 180, 120)
    seen = Renderer(teapot.patches(), device, wire=True).draw(view, levels[:, :2], levels[:, 2:])
    assert seen.area is not None
    there, channels = seen.patch >= 0, {}
    for name in numbers:
        found, texts = read_exr(Path(out) / f"{name}.exr")
        assert texts["scene"] == ("string", b"teapot")
        assert b"scale 1" in texts["how"][1]
        assert list(found) == sorted(rows[name]["values"].split(", "))
        channels |= {key: own[::-1] for key, own in found.items()}
    for name, own in {"u": seen.u, "v": seen.v, "depth": seen.depth, "patch": seen.patch}.items():
        assert np.array_equal(channels[name], np.where(there, own, np.nan), equal_nan=True)
    error = drawn_error(teapot.patches(), view, seen)
    np.testing.assert_array_equal(channels["error_px"], error.astype(np.float32))
    assert rows["error"]["largest"] == pytest.approx(np.nanmax(error))
    assert np.array_equal(channels["area_px2"], seen.area, equal_nan=True)
    assert set(np.unique(channels["factor"][there])) == {5.0}
    assert result["covered_pixels"] == there.sum()
    table = result["triangle_sizes"]
    assert [row["class"] for row in table] == list(CLASSES)
    assert sum(row["pixels"] for row in table) == there.sum()
    assert sum(row["triangles"] for row in table) == result["triangles"]
    assert sum(row["share_of_pixels"] for row in table) == pytest.approx(1.0)


@pytest.mark.parametrize("tall", [False, True])
def test_a_picture_shows_every_pixel(tmp_path, rng, tall):
    """Enlarged by a whole number, and nothing lies over it."""
    error = rng.uniform(0.0, 2.0, (50, 20) if tall else (31, 43))
    write_errors(Page(tmp_path / "error.png", "caption " * 30), Heading("one", "words " * 30, "as it is"), error)
    shown = np.round(255 * imread(tmp_path / "error.png")[..., :3]).astype(np.uint8)
    zoom = 480 // max(error.shape)
    wanted = error_colours(error).repeat(zoom, axis=0).repeat(zoom, axis=1)
    corners = np.argwhere(np.ones(np.array(shown.shape[:2]) - wanted.shape[:2] + 1, bool))
    for place in rng.integers(wanted.shape[:2], size=(60, 2)):
        corners = corners[np.all(shown[tuple((corners + place).T)] == wanted[tuple(place)], axis=1)]
    ((row, column),) = corners
    assert np.array_equal(shown[row : row + wanted.shape[0], column : column + wanted.shape[1]], wanted)


@pytest.mark.gl
def test_the_last_line_names_what_to_open(device, capsys):
    assert main(["render", "teapot", *QUICK, "--look", "wire", "wire"]) == 0
    last = capsys.readouterr().out.splitlines()[-1]
    folder, name = last.removeprefix("Results are in ").removesuffix(" first").split(": open ")
    assert folder.startswith("runs/render/") or Path(folder).parent.name == "render"
    assert name == "wire.png"
    assert os.path.getsize(f"{folder}/{name}") > 1000


@pytest.mark.gl
def test_a_stopped_run_goes_on(device, capsys, monkeypatch):
    """Looks that were made are kept."""
    made, row = [], render._Drawn.row

    def stop_at_the_second(self, name):
        if made == ["depth"]:
            raise KeyboardInterrupt
        made.append(name)
        return row(self, name)

    words = ["render", "teapot", *QUICK, "--look", "depth", "factors"]
    with monkeypatch.context() as patched:
        patched.setattr(render._Drawn, "row", stop_at_the_second)
        assert main(words) == 130
    monkeypatch.setattr(render._Drawn, "row", lambda self, name: made.append(name) or row(self, name))
    result = run_json(capsys, *words)
    assert made == ["depth", "factors"]
    assert {"depth.png", "factors.png"} < set(os.listdir(result["out"]))


@pytest.mark.gl
@pytest.mark.parametrize(
    ("words", "says"),
    [
        (["--look", "wirre"], "there is no look 'wirre' (did you mean wire?): choose one of shaded, wire"),
        (["--look"], "--look needs at least one of shaded, wire"),
        (["--scale", "-1"], "--scale must be a positive number, not -1.0"),
        (["--size", "90000x10"], "a picture of 90000 x 10 pixels is too large for"),
        (["--target", "90", "90", "90"], "no patch is on the screen"),
        (["--eye", "45000", "-60000", "40000"], "the picture is empty: no pixel centre is covered by the scene"),
        (["--spacing", "fractional-odd", "--verify"], "they have no meaning with --spacing"),
        (["--normals", "tangents"], "teapot is no control mesh: only those have tangent patches"),
    ],
)
def test_what_cannot_be_drawn_is_one_sentence(device, capsys, words, says):
    assert main(["render", "teapot", *QUICK, *words]) == 2
    shown = capsys.readouterr()
    assert says in shown.err
    assert shown.err.count("\n") == 1
    assert not os.path.exists("runs"), "nothing is left behind"


def test_without_opengl(capsys, monkeypatch):
    def none():
        raise NoOpenGLError("no device here")

    monkeypatch.setattr(render, "open_device", none)
    assert main(["render", "teapot", *QUICK]) == 2
    assert capsys.readouterr().err == "slefejax: no device here\n"
    assert not os.path.exists("runs")


@pytest.mark.gl
@pytest.mark.slow
def test_normals_of_tangent_patches_without_a_tolerance(device, capsys, tmp_path):
    """Which normals are drawn can be said by itself; they are others."""
    write(tmp_path, "box.obj", CUBE)
    words = ["render", "box.obj", *QUICK, "--look", "normals", "--format", "exr", "--normals"]
    found = [read_exr(Path(run_json(capsys, *words, k)["out"]) / "normals.exr")[0] for k in SURFACES]
    there = ~np.isnan(found[0]["normal_x"])
    assert np.mean(np.abs(found[0]["normal_x"] - found[1]["normal_x"])[there] > 0.02) > 0.2
    assert max(np.nanmedian(own["normal_error_deg"]) for own in found) < 5.0, "each beside its own exact ones"


SURFACES = ("surface", "tangents")


@pytest.mark.gl
def test_what_the_renderer_draws_is_what_looks_need(device, capsys, monkeypatch):
    asked = []
    renderer = render.Renderer

    def spy(*arguments, **options):
        asked.append({name for name in ("wire", "normals") if options.get(name)})
        return renderer(*arguments, **options)

    def only_draw(self, name):
        return {"picture": self.picture(name), "values": render.LOOKS[name].make(self.look).shows}

    monkeypatch.setattr(render, "Renderer", spy)
    monkeypatch.setattr(render._Drawn, "row", only_draw)
    for look in ("error", "normals", "triangle-size", "wire"):
        run_json(capsys, "render", "teapot", *QUICK, "--look", look)
    assert asked == [set(), {"normals"}, {"wire"}, {"wire", "normals"}]


def test_exact_normals_are_the_surface(rng):
    """A sphere's patch is not at hand: a saddle z = x y, whose normal is (-y, -x, 1)."""
    x = np.array([[0.0, 0.0], [1.0, 1.0]])
    patch = np.stack([x, x.T, x * x.T], axis=-1)[None]
    u, v = rng.uniform(size=(2, 3, 4))
    seen = SimpleNamespace(u=u, v=v, patch=np.array([[0, 0, -1, 0]] * 3))
    found = exact_normals(patch, seen)
    wanted = np.stack([-v, -u, np.ones_like(u)], axis=-1)
    wanted /= np.linalg.norm(wanted, axis=-1, keepdims=True)
    np.testing.assert_allclose(found[:, [0, 1, 3]], wanted[:, [0, 1, 3]], atol=1e-12)
    assert np.isnan(found[:, 2]).all()


def test_light_falls_on_both_sides(main_view):
    view = View(main_view.camera, 30, 20)
    back = view.camera.eye - view.camera.target
    facing = np.broadcast_to(back / np.linalg.norm(back), (20, 30, 3))
    bright, away, edge_on = (lit(own, view) for own in (facing, -facing, np.cross(facing, [0.0, 0.0, 1.0])))
    np.testing.assert_array_equal(bright, away)
    assert bright.min() > edge_on.max()
    assert 0.0 <= edge_on.min() < bright.max() <= 1.0
    assert np.isnan(lit(np.full((20, 30, 3), np.nan), view)).all()


@pytest.mark.gl
def test_finer_triangles_shade_like_the_surface(device, rng):
    patches, view = lattice(rng, 2, 3, relief=2.0), above()
    apart = []
    for level in (2, 16):
        levels = np.full((4, 6), level)
        seen = Renderer(patches, device, normals=True).draw(view, levels[:, :2], levels[:, 2:])
        assert seen.normal is not None
        shades = [lit(own.astype(float), view) for own in (exact_normals(patches, seen), seen.normal)]
        apart.append(np.nanmean(np.abs(shades[0] - shades[1])))
    # interpolation errs with the square of the size
    assert apart[1] < apart[0] / 20


def test_squares_of_a_checker():
    u = np.array([[0.0, 0.124, 0.126, 1.0, 0.5]], np.float32)
    v = np.array([[0.0, 0.0, 0.0, 1.0, 0.9]], np.float32)
    patch = np.array([[0, 0, 0, 0, -1]], np.int32)
    seen = GBuffer(u, v, patch, u, np.zeros((1, 5, 2), np.float32))
    assert squares(seen).tolist() == [[0, 0, 1, 0, -1]]


@pytest.mark.gl
def test_sizes_of_triangles_by_hand(device):
    """A square of 40 x 40 pixels in 2 x 4 x 4 triangles of 50 px², and one of 8 x 8 in 32 of 2 px²."""
    patches = np.concatenate([square(0.0, 1.0, (-1.0, -1.0)), square(0.0, 0.2, (0.5, 0.5))])
    levels = np.full((2, 6), 4)
    view = above(height=3.0, size=120)
    renderer = Renderer(patches, device, wire=True)
    asked = view, levels[:, :2], levels[:, 2:]
    look: Any = SimpleNamespace(area=renderer.draw(*asked).area, captured=renderer.capture(*asked), view=view)
    rows = size_rows(look)
    assert [row["pixels"] for row in rows] == [64, 0, 0, 1600]
    assert [row["triangles"] for row in rows] == [32, 0, 0, 32]
    assert [row["share_of_triangles"] for row in rows] == [0.5, 0.0, 0.0, 0.5]
    shares = areas(look)  # the same classes in a study's table
    assert [shares[f"share_area_below_{limit}"] for limit in (0.5, 5, 10, 20)] == [0.0, 0.5, 0.5, 0.5]
    assert [shares[f"share_pixels_area_below_{limit}"] for limit in (5, 10, 20)] == [64 / 1664] * 3


def test_levels_of_factors(teapot, main_view):
    factors = tessellation_factors(teapot.patches(), main_view, method="fixed", setting=5.5)
    inner, outer = levels_of(factors)
    assert np.all(inner == 6)
    assert np.all(outer == 6)
    inner, outer = levels_of(factors, "fractional-even", "own")
    assert inner.shape == (32, 2)
    assert outer.shape == (32, 4)
    assert np.all((inner > 5.5) & (inner == outer[:, :2]))


def test_pictures_of_almost_nothing(tmp_path):
    """A single pixel, numbers that are all the same, one that is infinite."""
    heading = Heading("one", "a pixel", "as it is")
    value = np.full((3, 4), np.nan)
    value[1, 2] = 7.0
    write_values(Page(tmp_path / "one.png"), heading, value, "px")
    value[0, 0] = np.inf
    write_errors(Page(tmp_path / "two.png"), heading, value)
    assert imread(tmp_path / "one.png").shape[1] >= 480
    assert imread(tmp_path / "two.png").shape[1] >= 480
    assert wired(np.array([[np.nan, 0.5]]), np.array([[0.0, 1.0]]))[0, 0].tolist() == [1.0, 1.0, 1.0]


@pytest.mark.gl
def test_the_record_says_how(device, capsys):
    result = run_json(capsys, "render", "teapot", *QUICK, "--look", "depth", "--scale", "0.5", "--edges", "own")
    with open(f"{result['out']}/run.json") as file:
        record = json.load(file)
    assert record["opengl"]["renderer"] == device.renderer
    assert record["arguments"]["scale"] == 0.5
    assert record["triangles"] == result["triangles"] == 32 * 2 * 3 * 3
