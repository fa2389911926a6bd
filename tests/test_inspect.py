"""slefejax inspect, and the options of all commands that say how a file becomes a scene."""

from __future__ import annotations

import os

import numpy as np
import pytest
from matplotlib.image import imread

from slefejax import NoOpenGLError
from slefejax.experiments.cli import main
from slefejax.gpu import renderer
from tests.mixed import as_bv, cube_sphere
from tests.tables import SHOWN
from tests.test_cli import SMALL, in_an_empty_folder, run_json  # noqa: F401
from tests.test_io import OBJ, write
from tests.test_scene import CUBE


@pytest.mark.gl
def test_inspect_counts_and_draws(device, capsys, tmp_path):
    write(tmp_path, "box.obj", CUBE + "v 7 7 7\nt crease 2/1/0 0 1 3\n")
    result = run_json(capsys, "inspect", "box.obj", *SMALL)
    (row,) = result["rows"]
    wanted = {
        **{
            "vertices": 9,
            "isolated_vertices": 1,
            "faces": 6,
            "triangles_of_the_mesh": 0,
            "quads": 6,
            "larger_faces": 0,
        },
        **{
            "pieces": 1,
            "boundary_edges": 0,
            "valences": "8 of 3",
            "creases": "1, sharpness up to 3",
            "defects": "none",
        },
        **{"patches": 6, "bi_degree": "3 x 3", "common_edges": 12, "free_edges": 0, "scheme": "acc"},
        **{"table_rows": 9 + 24 + 24, "coincident_vertices": 0, "kinds": "2 extraordinary, 4 crease"},
    }
    assert {name: row[name] for name in wanted} == wanted
    assert row["table_weights"] * 12 / 1024 <= row["table_kilobytes"] + 1
    assert row["max_error_px"] <= 0.5 + 1e-3  # float32 on the device
    assert row["slipped_pixels"] < 10
    assert 0 < row["max_slip_px"]
    said = " ".join(result["notes"])
    assert "1 vertices belong to no face (the first is 8" in said
    assert "1 creases of sharpness up to 3 are drawn infinitely sharp" in said
    assert "not needed: triangle stencils" in said
    assert set(os.listdir(result["out"])) == SHOWN | {"inspect.png"}
    picture = imread(f"{result['out']}/inspect.png")
    assert len(np.unique(picture.reshape(-1, picture.shape[2]), axis=0)) > 50


@pytest.mark.gl
def test_inspect_draws_reflections(device, capsys, tmp_path):
    write(tmp_path, "box.obj", CUBE)
    result = run_json(capsys, "inspect", "box.obj", *SMALL, "--reflections")
    assert set(os.listdir(result["out"])) == SHOWN | {"inspect.png", "reflections.png"}
    shown = imread(f"{result['out']}/reflections.png")[..., :3]
    width = shown.shape[1] // 2
    above_caption = slice(-width // 2, -40)
    surface, tangents = shown[above_caption, :width], shown[above_caption, -width:]
    assert np.mean(np.abs(surface - tangents)) > 0.02, "of a cube they are others everywhere"
    away = run_json(capsys, "inspect", "box.obj", *SMALL, "--reflections", "--target", "9", "9", "9")
    assert "no reflections: nothing of the scene is on the screen" in away["notes"]
    assert main(["inspect", "teapot", "--reflections"]) == 2
    assert "teapot is no control mesh: only those have tangent patches" in capsys.readouterr().err


@pytest.mark.gl
def test_inspect_of_patches(device, capsys, tmp_path, teapot):
    """Patch lists: the teapot's, once as a .bv file with a polyhedron beside."""
    points = [" ".join(map(str, p)) for p in teapot.patches()[:2].reshape(2, 16, 3).reshape(-1, 3).tolist()]
    text = "1\n3 1\n2 0 0  3 0 0  2 1 0\n3 0 1 2\n" + "".join(
        f"5\n3 3\n{'  '.join(points[k : k + 16])}\n" for k in (0, 16)
    )
    write(tmp_path, "a.bv", text)
    row = run_json(capsys, "inspect", "a.bv", *SMALL)["rows"][0]
    assert row["bi_degree"] == "3 x 3"
    assert row["kinds"] == "1 triangle, 2 bezier"
    assert row["faces"] == 1
    row = run_json(capsys, "inspect", "teapot", *SMALL)["rows"][0]
    assert (row["patches"], row["common_edges"], row["free_edges"], row["edges_of_no_length"]) == (32, 52, 16, 8)


@pytest.mark.slow
@pytest.mark.gl
def test_inspect_of_sides_that_digits_parted(device, capsys, tmp_path):
    """A closed surface of mixed degrees: no free side; with --weld 0 many, each of which lies on another."""
    write(tmp_path, "mixed.bv", as_bv(cube_sphere(np.random.default_rng(5), side=1)))
    result = run_json(capsys, "inspect", "mixed.bv", *SMALL)
    (row,) = result["rows"]
    assert (row["common_edges"], row["free_edges"], row["coincident_sides"]) == (12, 0, 0)
    assert any("were welded" in note for note in result["notes"])
    result = run_json(capsys, "inspect", "mixed.bv", *SMALL, "--weld", "0")
    (row,) = result["rows"]
    assert row["free_edges"] == row["coincident_sides"] > 12
    assert f"{row['free_edges']} free sides lie on others without being shared" in " ".join(result["notes"])


def test_inspect_says_why_a_mesh_makes_no_scene(capsys, tmp_path):
    write(tmp_path, "bad.obj", OBJ + "f 1 1 2\n")
    result = run_json(capsys, "inspect", "bad.obj")
    assert result["rows"][0]["defects"] == "face 2 names vertex 0 twice"
    assert "this makes no scene: bad.obj: face 2 names vertex 0 twice" in result["notes"][-1]
    assert "patches" not in result["rows"][0]
    assert set(os.listdir(result["out"])) == SHOWN


def test_inspect_without_opengl(capsys, tmp_path, monkeypatch):
    def none():
        raise NoOpenGLError("no device here")

    monkeypatch.setattr(renderer, "open_device", none)
    write(tmp_path, "box.obj", CUBE)
    result = run_json(capsys, "inspect", "box.obj", *SMALL, "--reflections")
    assert {"no picture: no device here", "no reflections: no device here"} <= set(result["notes"])
    assert result["rows"][0]["patches"] == 6
    assert "inspect.png" not in os.listdir(result["out"])


def test_every_command_takes_meshes_and_their_options(capsys, tmp_path):
    write(tmp_path, "a.obj", OBJ)
    assert len(run_json(capsys, "factors", "a.obj", *SMALL, "--method", "fixed")["rows"]) == 2
    subdivided = ("--scheme", "catmull-clark+acc", "--steps", "2")
    assert len(run_json(capsys, "factors", "a.obj", *SMALL, "--method", "fixed", *subdivided)["rows"]) == 28
    assert len(run_json(capsys, "factors", "a.obj", *SMALL, "--method", "fixed", "--group", "side")["rows"]) == 1
    write(tmp_path, "bad.obj", OBJ + "f 1 1 2\n")
    result = run_json(capsys, "factors", "bad.obj", *SMALL, "--method", "fixed", "--drop-defects")
    assert len(result["rows"]) == 2
    assert "1 faces were dropped (2)" in result["notes"][0]


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["teapot", "--scheme", "acc"], "scheme has no meaning"),
        (["a.obj", "--scheme", "loop"], "no scheme 'loop'"),
        (["a.obj", "--scheme", "acc"], "takes quads only, and face 1"),
        (["a.obj", "--alpha", "-1"], "alpha must be a positive number"),
        (["a.obj", "--steps", "2"], "steps belong to the scheme"),
        (["a.obj", "--group", "none"], "no group with faces 'none'"),
        (["a.obj", "--weld", "0"], "weld has no meaning for it"),
        (["a.obj", "--weld", "-1"], "weld must be a number of at least 0"),
        (["a.obj", "--cover", "2"], "share of the screen"),
        (["a.obj", "--up", "0", "0", "0"], "up must be a direction"),
        (["b.obj"], "there is no file b.obj"),
    ],
)
def test_bad_options_are_one_sentence(capsys, tmp_path, arguments, says):
    write(tmp_path, "a.obj", OBJ)
    assert main(["factors", *arguments]) == 2
    shown = capsys.readouterr()
    assert says in shown.err
    assert shown.err.count("\n") == 1
    assert not os.path.exists("runs")


def test_inspect_refuses_nonsense(capsys, tmp_path):
    write(tmp_path, "box.obj", CUBE)
    write(tmp_path, "bad.obj", OBJ + "f 1 1 2\n")
    for arguments in (["--scheme", "nonsense"], ["--alpha", "nan"], ["--steps", "0"], ["--steps", "2"]):
        assert main(["inspect", "box.obj", *arguments]) == 2
    assert main(["inspect", "bad.obj", "--drop-defects", "--scheme", "nonsense"]) == 2
    assert main(["factors", "box.obj", "--eye", "9", "9", "9", "--cover", "0.5"]) == 2
    assert "give one of them" in capsys.readouterr().err


@pytest.mark.gl
def test_cover_frames_anew(device, capsys, tmp_path):
    shares = []
    for cover in ("0.1", "0.3"):
        result = run_json(capsys, "minimality", "teapot", *SMALL, "--scales", "1", "--cover", cover)
        shares.append(result["rows"][0]["covered_pixels"] / (180 * 120))
    assert shares == pytest.approx([0.1, 0.3], abs=0.02)
