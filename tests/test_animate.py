"""The command animate, camera paths, and poses on the command line."""

from __future__ import annotations

import csv
import json
import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from PIL import Image

from slefejax import InputError, Session, View, load, tessellation_factors
from slefejax.experiments.bench.savings import savings
from slefejax.experiments.checks.inspect import rig_row
from slefejax.experiments.cli import main
from slefejax.experiments.options import LoadOptions
from slefejax.experiments.studies import animate
from slefejax.experiments.studies.camera_path import camera_path
from slefejax.experiments.studies.frames import Frames, frame_levels, moves_of_pixels
from slefejax.experiments.studies.modes import MODES
from slefejax.figures.looks.film import read_strip
from slefejax.figures.style import ERROR_CLASSES, LINES
from slefejax.gpu.renderer import GBuffer
from tests.tables import SHOWN
from tests.test_cli import run_json

SMALL = ["--size", "240x150", "--frames", "3", "--seconds", "0.05"]
FAST = ["--method", "slefe"]


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.fixture(scope="module")
def walker() -> Any:
    return load("walker")


@pytest.mark.gl
def test_animate(device, capsys, walker):
    result = run_json(capsys, "animate", "walker", *SMALL, *FAST, "--camera-path", "orbit:60")
    rows, modes = result["rows"], result["modes"]
    assert [row["time"] for row in rows] == [0.0, 8.0, 16.0]
    assert rows[0]["pop_max_px"] is None
    for row in rows:
        assert row["patches"] == row["visible_patches"] == 2496
        assert row["proved"] == (row["method"] == "certified")
        assert row["share_above_0.5"] < 0.02
        assert row["boxes_ms"] > 0
    assert 0 < rows[1]["pop_p99_px"] <= rows[1]["pop_max_px"] < 1.5
    assert [row["mode"] for row in modes] == list(MODES)
    static, looking, moving = modes[3], modes[2], modes[0]
    assert looking["skinning_ms"] == looking["boxes_ms"] == 0.0 < looking["view_ms"]
    assert static["skinning_ms"] == static["boxes_ms"] == static["view_ms"] == 0.0
    assert min(moving[name] for name in ("skinning_ms", "boxes_ms", "view_ms", "render_ms")) > 0
    names = SHOWN | {"modes.csv", "timeline.png", "time_of_a_frame.png", "animation.gif"}
    assert set(os.listdir(result["out"])) == names | {
        f"{name}_{k:04d}.png" for name in ("frame", "looks") for k in range(3)
    }
    film: Any = Image.open(f"{result['out']}/animation.gif")
    assert (film.n_frames, film.info["duration"]) == (3, 330)  # 8 of 24 frames a second
    with Image.open(f"{result['out']}/frame_0001.png") as page:
        assert film.size == page.size
    film.close()
    record = json.loads(Path(result["out"], "run.json").read_text())
    assert any(line.startswith("weights") for line in record["left_out"])
    assert record["memory"]["slefe boxes"] > record["memory"]["control points"]
    with open(f"{result['out']}/table.csv") as file:
        assert [float(row["triangles"]) for row in csv.DictReader(file)] == [row["triangles"] for row in rows]


@pytest.mark.gl
def test_rows_are_those_of_the_pose(device, capsys, walker):
    """A frame by itself, predicted without a session."""
    result = run_json(capsys, "animate", "walker", *SMALL[:2], "--frames", "5:5:1", "--seconds", "0", *FAST)
    (row,) = result["rows"]
    assert result["modes"] == []
    options = json.loads(Path(result["out"], "run.json").read_text())["arguments"]["camera"]
    from slefejax import Camera

    names = ("eye", "target", "up", "fov_y", "near", "far")
    camera = Camera.look_at(*(options[name] for name in names))
    wanted = tessellation_factors(np.asarray(walker.pose(5.0)), View(camera, 240, 150), "slefe")
    assert row["sum_of_factors"] == pytest.approx(float(np.sum(wanted.factor)), rel=1e-9)


@pytest.mark.gl
def test_the_film_shows_the_looks_that_are_asked_for(device, capsys, monkeypatch):
    """The triangles of the frame, and its errors; what is timed draws neither normals nor sides."""
    asked, renderer = [], animate.Renderer

    def spy(*arguments, **options):
        asked.append({name for name in ("wire", "normals") if options.get(name)})
        return renderer(*arguments, **options)

    monkeypatch.setattr(animate, "Renderer", spy)
    words = ["animate", "walker", *SMALL[:2], "--frames", "6:6:1", "--seconds", "0", *FAST]
    result = run_json(capsys, *words, "--look", "error", "wire", "error")
    assert asked == [set(), {"wire", "normals"}]
    (row,) = result["rows"]
    error, wire = read_strip(Path(result["out"], "looks_0000.png"), 2)
    assert error.shape == wire.shape == (150, 240, 3)
    covered = np.any(error != 1.0, axis=2)
    assert covered.sum() == row["covered_pixels"]
    far = {name: np.all(np.isclose(error, to_rgb(colour), atol=1 / 255), axis=2) for _, colour, name in ERROR_CLASSES}
    assert (far["≤ 1 px"] | far["> 1 px"]).sum() == round(row["share_above_0.5"] * row["covered_pixels"])
    dark = np.all(np.isclose(wire, to_rgb(LINES), atol=1 / 255), axis=2)
    assert 0.05 < dark[covered].mean() < 0.6
    assert not dark[~covered].any()
    run_json(capsys, *words, "--look", "error")
    assert asked[2:] == [set()]


def test_what_is_said_of_frames():
    """As many letters in each, so that they stand still; true of what was measured."""
    rows = [{"triangles": 1234, "max_error_px": error} for error in (0.46, 0.5, 0.94, float("nan"), *[0.4] * 6)]
    found = animate.said(rows, 0.5)
    assert found[0] == (
        "frame 01 of 10, 1,234 triangles",
        "every pixel is right to within 0.5 px: the largest error is 0.46 px",
    )
    assert len({len(shows) for shows, _ in found}) == 1
    assert found[1][1].startswith("every pixel is right")
    assert found[2][1] == "not every pixel is right to within 0.5 px: the largest error is 0.94 px"
    assert found[3][1] == "nothing of it is on the screen"


@pytest.mark.gl
@pytest.mark.parametrize("spacing", [pytest.param("fractional-even", marks=pytest.mark.slow), "fractional-odd"])
def test_spacing(device, capsys, spacing):
    result = run_json(
        capsys, "animate", "walker", *SMALL[:2], "--frames", "4:6:1", "--seconds", "0", *FAST, "--spacing", spacing
    )
    assert {(row["spacing"], row["proved"]) for row in result["rows"]} == {(spacing, False)}
    assert result["rows"][1]["changed_share"] < 0.05
    assert max(row["max_error_px"] for row in result["rows"]) < 1.0


@pytest.mark.gl
def test_a_stopped_film_continues_where_it_was(device, capsys, monkeypatch):
    arguments = ["animate", "teapot", *SMALL, *FAST, "--camera-path", "zoom:2"]
    row, seen = animate._Film.look, []

    def stopping(self, frame):
        if len(seen) == 2:
            raise KeyboardInterrupt
        seen.append(frame)
        return row(self, frame)

    monkeypatch.setattr(animate._Film, "look", stopping)
    assert main(arguments) == 130
    capsys.readouterr()
    monkeypatch.setattr(animate._Film, "look", lambda self, frame: seen.append(frame) or row(self, frame))
    result = run_json(capsys, *arguments)
    assert seen == [0, 1, 2]
    assert [r["frame"] for r in result["rows"]] == [0, 1, 2]
    assert result["rows"][2]["pop_max_px"] is not None
    assert result["rows"][2]["triangles"] > result["rows"][0]["triangles"]


@pytest.mark.gl
@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["--frames", "0"], "--frames must be a number of frames"),
        (["--frames", "1:2:-1"], "FIRST:LAST:STEP with a positive step, not '1:2:-1'"),
        (["--frames", "a"], "not 'a'"),
        (["--frames", "20:30:5"], "time 25 lies outside of the motion, 0 to 24"),
        (["--time", "3"], "--time has no meaning"),
        (["--look", "wirre"], "there is no look 'wirre' (did you mean wire?): choose one of shaded, wire, error"),
        (["--look", "depth"], "there is no look 'depth'"),
        (["--look"], "--look needs at least one of shaded, wire, error, reflection"),
        (["--seconds", "-1"], "--seconds must not be negative"),
        (["--camera-path", "spiral"], "--camera-path must be still, orbit:DEGREES"),
        (["--camera-path", "orbit:x"], "needs a number behind the colon"),
        (["--camera-path", "zoom:-2"], "needs a positive number behind the colon"),
        (["--camera-path", "none.csv"], "there is no file none.csv"),
        (["--keys", "grin=1"], "no shape key 'grin'"),
        (["--keys", "smile=1", "smile=2"], "--keys names 'smile' twice"),
        (["--keys", "smile"], "--keys are names and weights, such as smile=0.5, not 'smile'"),
        (["--method", "certified", "--verify", "--spacing", "fractional-odd"], "have no meaning with --spacing"),
    ],
)
def test_bad_arguments(device, capsys, arguments, says):
    assert main(["animate", "walker", *SMALL, *arguments]) == 2
    assert says in capsys.readouterr().err
    assert not os.path.exists("runs")


@pytest.mark.gl
def test_frames_in_which_nothing_is_seen(device, capsys, tmp_path):
    """A path that looks away goes on; one that always does, or has no camera, is refused."""
    head = "eye_x,eye_y,eye_z,target_x,target_y,target_z\n"
    (tmp_path / "away.csv").write_text(head + "0,-8,2,0,0,1\n0,-8,2,0,-20,1\n")
    result = run_json(capsys, "animate", "teapot", *SMALL[:4], "--seconds", "0", *FAST, "--camera-path", "away.csv")
    assert [row["covered_pixels"] > 0 for row in result["rows"]] == [True, False, False]
    assert result["rows"][2]["max_error_px"] is None
    (tmp_path / "never.csv").write_text(head + "0,-8,2,0,-20,1\n")
    assert main(["animate", "teapot", *SMALL, *FAST, "--camera-path", "never.csv"]) == 2
    assert "nothing of the scene is on the screen in any frame" in capsys.readouterr().err
    (tmp_path / "none.csv").write_text(head + "0,-8,2,0,0,1\n0,0,1,0,0,1\n")
    assert main(["animate", "teapot", *SMALL, *FAST, "--camera-path", "none.csv"]) == 2
    assert "--camera-path, frame 2: the camera's eye and target coincide" in capsys.readouterr().err


def test_poses_on_the_command_line(capsys, walker):
    moved = run_json(
        capsys, "factors", "walker", "--method", "edge-length", "--time", "6", "--keys", "belly=1", "smile=0"
    )
    still = run_json(capsys, "factors", "walker", "--method", "edge-length")
    assert moved["rows"] != still["rows"]
    scene = LoadOptions(time=6.0, keys=("belly=1", "smile=0")).load("walker")
    wanted = walker.pose(walker.rig.pose(6.0, {"belly": 1.0, "smile": 0.0}))
    np.testing.assert_allclose(scene.patches(), wanted, atol=1e-14)
    assert main(["factors", "teapot", "--time", "1"]) == 2
    assert "teapot does not move: --time has no meaning for it" in capsys.readouterr().err
    assert main(["factors", "walker", "--time", "99"]) == 2
    assert "time 99 lies outside of the motion" in capsys.readouterr().err
    twisted = LoadOptions(time=6.0, deform="dual-quaternion").load("walker")
    assert np.abs(twisted.patches() - walker.posed(6.0).patches()).max() > 1e-3


def test_camera_paths(tmp_path, teapot, main_view):
    eye, target = main_view.camera.eye, main_view.camera.target
    assert camera_path("still", teapot, main_view)(0.7) is main_view
    quarter = camera_path("orbit:360", teapot, main_view)(0.25).camera
    np.testing.assert_allclose(quarter.eye, [6.0, 4.5, 4.0], atol=1e-12)
    np.testing.assert_allclose(camera_path("zoom:4", teapot, main_view)(0.5).camera.eye, target + (eye - target) / 2)
    (tmp_path / "path.csv").write_text(
        "eye_x,eye_y,eye_z,target_x,target_y,target_z\n4,-6,4,0,0,1\n8,-6,4,0,0,1\n8,-12,4,0,0,3\n"
    )
    path = camera_path("path.csv", teapot, main_view)
    np.testing.assert_allclose(path(0.25).camera.eye, [6, -6, 4])
    np.testing.assert_allclose(path(1.0).camera.target, [0, 0, 3])
    near, far = (camera_path("zoom:100", teapot, main_view)(s).camera.near for s in (0.0, 1.0))
    assert far < near
    for text in ("eye_x\n1\n", "eye_x,eye_y,eye_z,target_x,target_y,target_z\n1,2,3,4,5,x\n", ""):
        (tmp_path / "bad.csv").write_text(text)
        with pytest.raises(InputError, match=r"bad\.csv"):
            camera_path("bad.csv", teapot, main_view)


def test_frames(walker, teapot):
    frames = Frames.of(walker, "4")
    assert frames.times.tolist() == [0, 6, 12, 18]
    assert frames.seconds_a_frame == 0.25
    assert Frames.of(walker, "2:4:0.5").times.tolist() == [2, 2.5, 3, 3.5, 4]
    assert Frames.of(walker, "2:4").times.tolist() == [2, 3, 4]
    own = Frames.of(walker, "2", {"smile": 1.0})
    assert [float(pose.keys[0]) for pose in own.poses] == [1.0, 1.0]
    still = Frames.of(teapot, "5")
    assert not still.moves
    assert still.poses == [None] * 5
    assert still.shares.tolist() == [0, 0.25, 0.5, 0.75, 1]


def test_what_pops(teapot, main_view):
    """Equal pictures do not; a picture whose parameters are shifted by as much as it says."""
    levels = frame_levels(Session(teapot, method="slefe"), main_view, None, "equal")
    patch = np.full((10, 10), -1, np.int32)
    patch[2:5, 2:5] = 3
    u = np.full((10, 10), 0.5, np.float32)
    centre = np.zeros((10, 10, 2), np.float32)
    one, two = GBuffer(u, u, patch, u, centre), GBuffer(u + np.float32(0.25), u, patch, u, centre)
    assert moves_of_pixels(levels.patches, main_view, one, one) == {"pop_p99_px": 0.0, "pop_max_px": 0.0}
    from slefejax.measure.error import surface_on_screen

    ends = surface_on_screen(teapot.patches(), main_view, np.array([3, 3]), np.array([0.5, 0.75]), np.array([0.5, 0.5]))
    found = moves_of_pixels(levels.patches, main_view, one, two)
    assert found["pop_max_px"] == pytest.approx(np.abs(ends[0] - ends[1])[:2].max(), rel=1e-9)
    slipped = GBuffer(two.u, u, patch, u, centre + (ends[1] - ends[0])[:2].astype(np.float32))
    # the point was drawn where it belongs: nothing pops but the driver
    assert moves_of_pixels(levels.patches, main_view, one, slipped)["pop_max_px"] < 1e-4
    empty = GBuffer(u, u, np.full_like(patch, -1), u, centre)
    assert moves_of_pixels(levels.patches, main_view, one, empty)["pop_max_px"] == 0.0


@pytest.mark.slow
def test_savings(walker, teapot, main_view):
    rows = savings(teapot, main_view)
    assert {row["left_out"] for row in rows} == {"depth widths", "weights", "view that is the same"}
    assert all(row["with_ms"] > 0 for row in rows)
    assert [row["without_ms"] for row in rows if row["left_out"] == "view that is the same"] == [0.0, 0.0]


def test_inspect_tells_of_the_rig(walker, teapot):
    row = rig_row(walker)
    assert (row["joints"], row["depth_of_the_tree"], row["most_influences"]) == (20, 6, 4)
    assert row["shape_keys"] == "6: smile, brows, cheeks, breath, belly, biceps"
    assert row["motion"] == "time 0 to 24, 25 samples, 24 a second"
    assert rig_row(teapot) == {}


@pytest.mark.slow
@pytest.mark.gl
def test_inspect_and_its_savings(device, capsys):
    result = run_json(capsys, "inspect", "walker", "--size", "200x120", "--savings")
    assert result["rows"][0]["joints"] == 20
    assert {row["left_out"] for row in result["savings"]} == {"depth widths", "view that is the same"}
