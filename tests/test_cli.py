from __future__ import annotations

import csv
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from slefejax.experiments.cli import main
from slefejax.experiments.studies import minimality
from slefejax.figures.error_image import error_colours, read_error_image
from tests.tables import SHOWN

SMALL = ["--size", "180x120"]
COLUMNS = {
    *("scale", "method", "segments", "patches", "triangles", "covered_pixels", "share_above_0.1", "share_above_0.5"),
    *(
        "share_above_1",
        "max_error_px",
        "slipped_pixels",
        "max_slip_px",
        "predict_ms",
        "render_ms",
        "triangles_over_minimal",
    ),
}


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def run_json(capsys, *arguments):
    assert main([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.gl
def test_minimality_reaches_the_published_numbers(device, capsys, tmp_path):
    """Uniform edges, as the numbers of docs/math.md, 5 were measured."""
    result = run_json(
        capsys, "minimality", "teapot", "--method", "slefe", "--edges", "own", "--out", str(tmp_path / "there")
    )
    rows = result["rows"]
    assert [row["scale"] for row in rows] == [1.0, 0.9, 0.8, 0.75, 0.7, 0.5]
    assert set(rows[0]) == COLUMNS
    shares = [100 * row["share_above_0.5"] for row in rows]
    # drivers differ in which pixels of an edge they draw, hence a tenth
    np.testing.assert_allclose(shares[1:], [1.0, 4.1, 7.0, 11.2, 48.0], rtol=0.1)
    assert shares[0] == pytest.approx(0.02, abs=0.01)
    assert rows[0]["max_error_px"] == pytest.approx(0.53, abs=0.02)
    assert rows[0]["triangles"] == 19_874
    record = json.loads((tmp_path / "there" / "run.json").read_text())
    assert record["sum_of_factors"] == pytest.approx(537.849, abs=1e-3)
    assert record["opengl"]["renderer"] == device.renderer
    assert any("depth" in line for line in record["left_out"])


@pytest.mark.gl
def test_folder_of_a_run(device, capsys):
    result = run_json(capsys, "minimality", "teapot", *SMALL, "--scales", "1", "0.5")
    out = result["out"]
    assert out.startswith("runs/minimality/")
    assert result["scene"] == "teapot"
    names = SHOWN | {
        "minimality.png",
        "factors.png",
        "enough.png",
        "error_scale_1.png",
        "error_scale_0.5.png",
    }
    assert set(os.listdir(out)) == names
    assert os.listdir("runs/minimality") == [os.path.basename(out)]
    with open(f"{out}/table.csv") as file:
        table = list(csv.DictReader(file))
    assert [float(row["triangles"]) for row in table] == [row["triangles"] for row in result["rows"]]
    picture = read_error_image(Path(out, "error_scale_1.png"))
    assert picture.shape[:2] == (120, 180)
    covered = np.any(picture != 1.0, axis=-1)
    assert covered.sum() == result["rows"][0]["covered_pixels"]


@pytest.mark.gl
def test_terminal_shows_the_table(device, capsys):
    assert main(["minimality", "teapot", *SMALL, "--scales", "1"]) == 0
    shown = capsys.readouterr()
    assert "> 0.5 px" in shown.out
    *_, before, last = shown.out.splitlines()
    assert before == "report.html has the table, charts and all pictures, for a browser"
    assert re.fullmatch("Results are in runs/minimality/.*: open minimality.png first", last)


@pytest.mark.gl
def test_stopped_sweep_continues_where_it_was(device, capsys, monkeypatch):
    arguments = ["minimality", "teapot", *SMALL, "--scales", "1", "0.8", "0.6"]
    row, seen = minimality._Sweep.look, []

    def stop_at_the_third(self, scale):
        if len(seen) == 2:
            raise KeyboardInterrupt
        seen.append(scale)
        return row(self, scale)

    monkeypatch.setattr(minimality._Sweep, "look", stop_at_the_third)
    assert main(arguments) == 130
    assert "goes on where it was" in capsys.readouterr().err
    assert all(name.startswith(".") for name in os.listdir("runs/minimality"))
    monkeypatch.setattr(minimality._Sweep, "look", lambda self, scale: seen.append(scale) or row(self, scale))
    result = run_json(capsys, *arguments)
    assert seen == [1.0, 0.8, 0.6], "each scale once"
    assert [r["scale"] for r in result["rows"]] == [1.0, 0.8, 0.6]
    assert "error_scale_0.8.png" in os.listdir(result["out"])


def stop_after(monkeypatch, capsys, arguments, count):
    """Run a sweep that is interrupted after so many rows; returns the folder that it leaves."""
    row, seen = minimality._Sweep.look, []

    def stopping(self, scale):
        if len(seen) == count:
            raise KeyboardInterrupt
        seen.append(scale)
        return row(self, scale)

    with monkeypatch.context() as patched:
        patched.setattr(minimality._Sweep, "look", stopping)
        assert main(arguments) == 130
    capsys.readouterr()
    (left,) = [name for name in os.listdir("runs/minimality") if name.startswith(".")]
    return f"runs/minimality/{left}"


def bpt_of(patches):
    lines = [str(len(patches))]
    for patch in patches:
        lines += ["3 3", *(" ".join(map(repr, point)) for point in patch.reshape(-1, 3).tolist())]
    return "\n".join(lines) + "\n"


@pytest.mark.gl
def test_another_scene_of_the_same_name_is_another_run(device, capsys, monkeypatch, tmp_path, teapot):
    arguments = ["minimality", "a.bpt", *SMALL, "--scales", "1", "0.8", "0.6"]
    (tmp_path / "a.bpt").write_text(bpt_of(teapot.patches()[:16]))
    stop_after(monkeypatch, capsys, arguments, 2)
    (tmp_path / "a.bpt").write_text(bpt_of(teapot.patches()[16:]))
    rows = run_json(capsys, *arguments)["rows"]
    (tmp_path / "b.bpt").write_text(bpt_of(teapot.patches()[16:]))
    fresh = run_json(capsys, "minimality", "b.bpt", *arguments[2:])["rows"]
    for row, other in zip(rows, fresh, strict=True):
        assert {**row, "predict_ms": 0, "render_ms": 0} == {**other, "predict_ms": 0, "render_ms": 0}


@pytest.mark.gl
def test_a_lost_picture_is_made_again(device, capsys, monkeypatch):
    arguments = ["minimality", "teapot", *SMALL, "--scales", "1", "0.8", "0.6"]
    left = stop_after(monkeypatch, capsys, arguments, 2)
    os.remove(f"{left}/error_scale_1.png")
    assert "error_scale_1.png" in os.listdir(run_json(capsys, *arguments)["out"])


@pytest.mark.gl
def test_the_same_run_twice_at_once_is_refused(device, capsys, monkeypatch):
    arguments = ["minimality", "teapot", *SMALL, "--scales", "1", "0.8"]
    row, inner = minimality._Sweep.look, []

    def nested(self, scale):
        if scale == 0.8 and not inner:
            inner.append(None)
            inner[0] = main(arguments)
        return row(self, scale)

    monkeypatch.setattr(minimality._Sweep, "look", nested)
    assert main(arguments) == 0
    assert inner == [2]
    assert "under way in another process" in capsys.readouterr().err


@pytest.mark.gl
def test_results_go_into_an_empty_folder_that_is_there(device, capsys, tmp_path, monkeypatch):
    (tmp_path / "e").mkdir()
    (tmp_path / "link").symlink_to("e")
    run_json(capsys, "factors", "teapot", "--out", "link")
    assert set(os.listdir("e")) == SHOWN
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    run_json(capsys, "minimality", "teapot", *SMALL, "--scales", "0.5", "0.50000001", "--out", ".")
    assert {"error_scale_0.5.png", "error_scale_0.50000001.png", "run.json"} < set(os.listdir(tmp_path / "here"))
    assert sorted(os.listdir(tmp_path)) == ["e", "here", "link"]


@pytest.mark.gl
def test_only_the_scales_that_were_asked_for_are_drawn(device, capsys):
    """The full factors are more than can be drawn here, a thousandth of them is not."""
    rows = run_json(capsys, "minimality", "teapot", *SMALL, "--tolerance", "1e-8", "--scales", "0.001")["rows"]
    assert [row["scale"] for row in rows] == [0.001]


def test_factors_beyond_the_hardware_are_noted(capsys):
    (note,) = run_json(capsys, "factors", "teapot", "--tolerance", "0.02")["notes"]
    assert note.endswith("of 32 patches need more than OpenGL's limit of 64: in pieces")


def test_camera_far_away_still_sees_the_scene(capsys):
    result = run_json(capsys, "factors", "teapot", "--eye", "600", "-800", "400")
    assert all(row["factor"] > 0 for row in result["rows"])
    with open(f"{result['out']}/run.json") as file:
        assert json.load(file)["arguments"]["camera"]["far"] > 1000


def test_a_device_that_jax_does_not_have_is_one_sentence(tmp_path):
    code = "import sys; from slefejax.experiments.cli import main; sys.exit(main(['factors', 'teapot']))"
    environment = {**os.environ, "JAX_PLATFORMS": "nonsense"}
    found = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, cwd=tmp_path)
    assert found.returncode == 2
    assert "JAX finds no device" in found.stderr
    assert found.stderr.count("\n") == 1


def test_reader_that_has_enough_does_no_harm(tmp_path):
    command = f"{sys.executable} -m slefejax factors teapot"
    found = subprocess.run(
        ["bash", "-c", f"set -o pipefail; {command} | head -1"], capture_output=True, text=True, cwd=tmp_path
    )
    assert found.returncode == 0, found.stderr
    assert found.stderr == ""


def test_factors_lists_every_patch(capsys):
    result = run_json(capsys, "factors", "teapot")
    assert len(result["rows"]) == 32
    assert result["sum_of_factors"] == pytest.approx(560.385, abs=1e-3)
    assert sum(row["triangles"] for row in result["rows"]) == result["triangles"]
    assert 0 < result["rows"][5]["inner_u"] <= np.ceil(result["rows"][5]["factor"])


def test_camera_options_are_heard(capsys):
    near = run_json(capsys, "factors", "teapot", "--eye", "3", "-4", "3", "--fov", "60", "--size", "800x600")
    far = run_json(capsys, "factors", "teapot", "--eye", "30", "-40", "30", "--target", "0", "0", "1")
    assert near["sum_of_factors"] > far["sum_of_factors"] > 0
    assert near["out"] != far["out"]


@pytest.mark.gl
def test_doctor(device, capsys):
    assert main(["doctor", "--json"]) == 0
    report = json.loads(capsys.readouterr().out)
    found = {row["item"]: row["found"] for row in report["rows"]}
    assert found["OpenGL renderer"] == device.renderer
    assert found["coverage self-test"].startswith("passed")
    assert main(["doctor", "--quiet"]) == 0
    assert capsys.readouterr().out == ""


BAD_PATCH = "1\n1 1\n0 0 0\n0 nan 0\n1 0 0\n1 1 0\n"


@pytest.mark.parametrize("command", ["minimality", "factors"])
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["no-such.bpt"], "there is no file no-such.bpt"),
        (["cut.bpt"], "cut.bpt, line 3: the file ends where"),
        (["nan.bpt"], "patch 0"),
        (["none.bpt"], "no patches"),
        (["teapot.obj"], "there is no file teapot.obj"),
        (["teapot.xyz"], "not read"),
        (["teapot", "--method", "slefe", "--segments", "0"], "segments must be a whole number of at least 1, not 0"),
        (["teapot", "--tolerance", "-1"], "tolerance must be a positive number"),
        (["teapot", "--method", "slefe", "--k", "nan"], "k must be a positive number"),
        (["teapot", "--size", "1440"], "--size must be WIDTHxHEIGHT"),
        (["teapot", "--fov", "180"], "--fov must lie between"),
        (["teapot", "--eye", "0", "0", "1.2"], "coincide"),
        (["teapot", "--eye", "0", "0", "1e200"], "below 1e+100"),
        (["teapot", "--method", "magic"], "no method 'magic'"),
        (["teapot", "--out", "full"], "is not an empty folder"),
    ],
)
def test_bad_input_is_one_sentence_and_leaves_nothing(capsys, tmp_path, command, arguments, says):
    (tmp_path / "cut.bpt").write_text("1\n1 1\n0 0 0 1")
    (tmp_path / "nan.bpt").write_text(BAD_PATCH)
    (tmp_path / "none.bpt").write_text("0\n")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "something").write_text("x")
    assert main([command, *arguments]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert says in shown.err
    assert shown.err.count("\n") == 1
    assert not (tmp_path / "runs").exists()
    assert os.listdir("full") == ["something"]


@pytest.mark.gl
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--scales", "1", "-0.5"], "--scales must be positive"),
        (["--scales", "1", "1"], "twice"),
        (["--eye", "1.6", "-1.6", "1.6", "--tolerance", "1e-8"], "above 16384, the most that can be drawn"),
        (["--eye", "4", "4", "4", "--target", "9", "9", "9"], "no patch is on the screen"),
        (["--tolerance", "1e-40"], "which no tessellation can have"),
        (["--fov", "179.9"], "the picture is empty"),
    ],
)
def test_sweeps_that_cannot_be_done(device, capsys, tmp_path, arguments, says):
    assert main(["minimality", "teapot", *SMALL, *arguments]) == 2
    shown = capsys.readouterr()
    assert says in shown.err
    assert shown.err.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_no_opengl_device_is_one_sentence(tmp_path):
    """With no driver to be found by the EGL loader, or no loader at all."""
    code = "import sys; from slefejax.experiments.cli import main; sys.exit(main(sys.argv[1:]))"
    environment = {**os.environ, "__EGL_VENDOR_LIBRARY_DIRS": "/nonexistent"}
    found = subprocess.run(
        [sys.executable, "-c", code, "minimality", "teapot", *SMALL],
        env=environment,
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert found.returncode == 2, found.stderr
    assert "no OpenGL device" in found.stderr
    assert "apt-get install libegl1" in found.stderr
    assert found.stderr.count("\n") == 1
    assert not (tmp_path / "runs").exists()


def test_usage_errors_exit_with_2(capsys):
    for arguments in (
        [],
        ["minimality"],
        ["minimality", "teapot", "--bogus"],
        ["factors", "teapot", "--segments", "x"],
    ):
        with pytest.raises(SystemExit) as raised:
            main(arguments)
        assert raised.value.code == 2
        assert capsys.readouterr().out == ""


def test_error_colours_are_those_of_the_papers():
    error = np.array([[0.0, 0.1, 0.3, 0.5], [0.7, 1.0, 1.01, np.nan]])
    colours = error_colours(error)
    grey, blue, green, red, white = colours[1, 0], colours[1, 2], colours[0, 0], colours[0, 2], colours[0, 3]
    assert np.array_equal(colours[1], [grey, grey, blue, blue]), "row 0 of the error is the last of the picture"
    assert np.array_equal(colours[0], [green, green, red, white])
    assert len({tuple(c) for c in (grey, blue, green, red, white)}) == 5
    assert blue[2] > max(blue[:2])
    assert green[1] > max(green[0], green[2])
    assert red[0] > 2 * max(red[1:])
    assert grey[0] == grey[1] == grey[2] < 255
