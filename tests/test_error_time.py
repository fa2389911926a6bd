from __future__ import annotations

import json
import os

import numpy as np
import pytest

from slefejax import Camera, View
from slefejax.experiments.cli import main
from slefejax.experiments.studies import measures
from slefejax.gpu import Triangles
from slefejax.measure.error import SLIPPED


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.gl
def test_run(device, capsys):
    few = ["slefe m=3", "filip", "screen-box 8", "fixed 16"]
    command = ["error-time", "teapot", "--size", "240x150", "--cameras", "2", "--repeats", "2", "--json"]
    assert main([*command, "--methods", *few]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [row["method"] for row in result["rows"]] == few
    assert len(result["table"]) == 8
    for row in result["table"]:
        assert 0 <= row["share_above_1"] <= row["share_above_0.5"] <= row["share_above_0.1"] <= 1
        assert row["share_area_below_0.5"] <= row["share_area_below_20"] <= 1
        assert 0 <= row["share_pixels_area_below_5"] <= row["share_pixels_area_below_20"] <= 1
        # pixels see less than the whole domain; edges that share levels see more
        assert row["max_error_px"] <= row["drawn_sup_error_px"] + 0.01
        assert (row["slipped_pixels"] > 0) == (row["max_slip_px"] > SLIPPED)
        assert row["predict_ms"] > 0
        assert row["render_ms"] > 0
        assert row["largest_ring_ratio"] >= 1 - 1e-3
        assert row["share_unsafe_by_rings"] <= row["share_worse_by_rings"] <= 1
        if row["method"] == "fixed":
            assert row["share_worse_by_rings"] == 0, "all edges alike: no rings"
        if row["method"] == "filip":
            assert row["sup_error_px"] <= 0.5
            assert row["factor_over_minimal_median"] >= 1
    for row in result["rows"]:
        own = [other for other in result["table"] if other["method_name"] == row["method"]]
        assert row["slipped_pixels"] == max(other["slipped_pixels"] for other in own)
        assert row["max_slip_px"] == max(other["max_slip_px"] for other in own)
    pictures = {"error_against_time.png", "pixels_against_triangles.png", "triangle_sizes.png", "side_by_side.png"}
    assert pictures | {"table.csv", "run.json", "error_filip.png"} <= set(os.listdir(result["out"]))


@pytest.mark.gl
@pytest.mark.slow
def test_names_with_blanks_and_several_scenes(device, capsys, tmp_path):
    quad = "1\n1 1\n0 0 0\n0 1 0\n1 0 0\n1 1 0.3\n"
    (tmp_path / "my first quad.bpt").write_text(quad)
    command = [
        "error-time",
        "my first quad.bpt",
        "teapot",
        "--size",
        "120x80",
        "--cameras",
        "2",
        "--repeats",
        "1",
        "--json",
        "--methods",
        "slefe m=3",
        "fixed 16",
    ]
    assert main(command) == 0
    table = json.loads(capsys.readouterr().out)["table"]
    wanted = [(name, camera) for name in ("my first quad", "teapot") for camera in (0, 1)]
    assert [(row["scene"], row["camera"]) for row in table[::2]] == wanted


def test_areas_of_triangles_by_hand():
    """Halves of squares of 1, 4 and 30 px side, one behind the camera."""
    view = View(Camera.orthographic((0, 0, 5), (0, 0, 0), up=(0, 1, 0), height=100.0), 100, 100)
    clip = np.zeros((4, 3, 4))
    for k, side in enumerate((0.9, 4.0, 30.0, 4.0)):
        clip[k] = [[0, 0, 0, 1], [side / 50, 0, 0, 1], [0, side / 50, 0, 1]]
    clip[3, 0, 3] = -1.0
    shares = measures.area_shares(Triangles(np.zeros(4, int), np.zeros((4, 3, 2)), clip), view)
    assert list(shares.values()) == pytest.approx([1 / 3, 1 / 3, 2 / 3, 2 / 3])


@pytest.mark.parametrize(
    "arguments",
    [["teapot", "--cameras", "0"], ["teapot", "--repeats", "0"], ["no.bpt"], ["teapot", "--tolerance", "-1"]],
)
def test_bad_input(capsys, tmp_path, arguments):
    assert main(["error-time", *arguments]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    assert not (tmp_path / "runs").exists()
