"""Commands with a tolerance for normals: what they ask for, what they measure, what they say."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from slefejax import Scene, Session, View, load, save
from slefejax.experiments.shading import FOR_CERTIFIED, Shaded
from slefejax.experiments.studies import minimality
from slefejax.experiments.studies.look import Shown
from tests.test_cli import COLUMNS, main, run_json
from tests.test_scene import CUBE

ALONG = np.linspace(0, 1, 4)
CURVES = ((0, 0), (0.2, 0.6), (1.0, 0.6), (1.2, 0)), ((1.5, 0), (2.5, 1), (1.5, 1), (2.5, 0))
CUSPED = Scene("cusped", np.array([[[[x, v, z] for v in ALONG] for x, z in curve] for curve in CURVES]))
SWEEP = ["minimality", "cusped.bpt", "--size", "120x80", "--scales", "1", "0.4", "--normal-tolerance", "0.5"]
UNCLAIMED = "normals of 1 seen patch have no claim, as some points have none, or nearly: patch 1 (counted from 0)"
TURNED = {"max_normal_error_deg", "patches_without_normal"}


@pytest.fixture(autouse=True)
def in_a_folder_with_a_cusp(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    save(CUSPED, tmp_path / "cusped.bpt")


def test_factors(capsys):
    plain = run_json(capsys, "factors", "teapot")
    result = run_json(capsys, "factors", "teapot", "--normal-tolerance", "1")
    assert "patches_without_normal" not in plain
    assert result["patches_without_normal"] == 0
    assert result["triangles"] > 1.2 * plain["triangles"]
    both = zip(result["rows"], plain["rows"], strict=True)
    assert all(own["factor"] >= other["factor"] for own, other in both)


def test_factors_name_patches_without_a_claim(capsys):
    assert main(["factors", "cusped.bpt", "--normal-tolerance", "0.5"]) == 0
    said = capsys.readouterr().out
    assert UNCLAIMED in said
    assert "normals within 0.5° on all but 1" in said


@pytest.mark.slow
@pytest.mark.gl
def test_a_sweep_measures_normals(device, capsys):
    result = run_json(capsys, *SWEEP)
    beside = {"slefe_triangles", "slefe_share_above_0.5", "slefe_max_error_px"}
    assert set(result["rows"][0]) - COLUMNS == TURNED | beside
    turned = [row["max_normal_error_deg"] for row in result["rows"]]
    assert 0.1 < turned[0] <= 0.5 < turned[1], "of the patch with a cusp nothing is claimed"
    assert [row["patches_without_normal"] for row in result["rows"]] == [1, 1]
    assert 0.5 < result["rows"][0]["triangles_over_minimal"] < 2.0
    assert result["notes"] == [UNCLAIMED, FOR_CERTIFIED]
    record = json.loads(Path(result["out"], "run.json").read_text())
    assert record["notes"] == result["notes"]
    assert record["arguments"]["prediction"]["shading"] == {"normal_tolerance": 0.5, "normals": "surface"}


@pytest.mark.slow
@pytest.mark.gl
def test_a_stopped_sweep_goes_on(device, capsys, monkeypatch):
    def stop(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as stopped:
        stopped.setattr(minimality, "write_minimality_figure", stop)
        assert main(SWEEP) == 130
    monkeypatch.setattr(minimality.Look, "error", property(lambda _: pytest.fail("rows are there already")))
    assert {row["patches_without_normal"] for row in run_json(capsys, *SWEEP)["rows"]} == {1}


def test_minimal_factors_are_by_both_tolerances():
    view = View(CUSPED.default_camera(), 120, 80)
    plain, both = (Shown(CUSPED, view, 0.5, shaded=Shaded(degrees)) for degrees in (None, 0.2))
    both.without = np.array([False, True])
    assert both.minimal[0] > plain.minimal[0]
    assert both.minimal[1] == plain.minimal[1], "without a claim on its normals"


@pytest.mark.slow
@pytest.mark.gl
def test_certify_measures_normals_over_the_domain(device, capsys):
    result = run_json(capsys, "certify", "cusped.bpt", "--size", "120x80", "--normal-tolerance", "0.2")
    certified, estimate = result["summary"][:2]
    assert (certified["method"], estimate["method"]) == ("certified", "slefe")
    assert certified["angle_kept"]
    assert not estimate["angle_kept"]
    for row in result["summary"]:
        assert row["patches_without_normal"] == 1
        most = max(row["sup_normal_error_deg"], row["drawn_sup_normal_error_deg"])
        assert row["max_normal_error_deg"] <= 1.01 * row["drawn_sup_normal_error_deg"]
        assert (most <= 0.2) == row["angle_kept"]
    first, second = result["rows"]
    most = max(first["sup_normal_error_deg"], first["drawn_sup_normal_error_deg"])
    assert first["slack_deg"] == pytest.approx(0.2 - most)
    assert second["slack_deg"] is None
    assert {UNCLAIMED, FOR_CERTIFIED} <= set(result["notes"])


@pytest.mark.slow
@pytest.mark.gl
def test_error_time_measures_normals(device, capsys):
    command = ["error-time", "cusped.bpt", "--size", "120x80", "--repeats", "1", "--normal-tolerance", "0.2"]
    result = run_json(capsys, *command, "--methods", "certified", "slefe m=3")
    certified, estimate = result["rows"]
    assert certified["max_normal_error_deg"] <= 0.2 < estimate["max_normal_error_deg"]
    assert certified["patches_without_normal"] == estimate["patches_without_normal"] == 1
    assert TURNED < set(result["table"][0])
    assert {UNCLAIMED, FOR_CERTIFIED} <= set(result["notes"])
    assert main([*command, "--methods", "filip"]) == 2
    assert "--normal-tolerance is for certified, which --methods leaves out" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.gl
def test_a_film_measures_normals_of_tangent_patches(device, capsys):
    still = ["animate", "walker", "--size", "120x80", "--frames", "2", "--seconds", "0.01"]
    result = run_json(capsys, *still, "--normal-tolerance", "20", "--normals", "tangents")
    for row in result["rows"]:
        assert 5 < row["max_normal_error_deg"] <= 20
        assert row["patches_without_normal"] > 0
    assert [note.startswith("normals of") for note in result["notes"]].count(True) == 1
    assert FOR_CERTIFIED in result["notes"]


@pytest.mark.slow
def test_a_session_tells_its_tangent_patches():
    scene = load("walker")
    assert Session(scene).tangents is None
    session = Session(scene, normal_tolerance=20.0, normals="tangents")
    session.factors(View(scene.default_camera(), 120, 80), 6.0)
    for own, other in zip(session.tangents, scene.tangents(6.0), strict=True):
        np.testing.assert_allclose(own, other, atol=1e-12)


@pytest.mark.gl
def test_inspect_measures_normals(device, capsys):
    command = ["inspect", "cusped.bpt", "--size", "120x80"]
    plain = run_json(capsys, *command)["rows"][0]
    result = run_json(capsys, *command, "--normal-tolerance", "0.5")
    (row,) = result["rows"]
    assert not TURNED & set(plain)
    assert row["triangles"] > plain["triangles"]
    assert 0.1 < row["max_normal_error_deg"] <= 0.5
    assert row["patches_without_normal"] == 1
    assert UNCLAIMED in result["notes"]


@pytest.mark.slow
@pytest.mark.gl
def test_the_price_of_normals_scheme_by_scheme(device, capsys):
    Path("box.obj").write_text(CUBE)
    command = ["limit", "box.obj", "--size", "120x80"]
    one, asked = ["--scheme", "acc"], ["--normal-tolerance", "1"]
    plain = run_json(capsys, *command, *one)["rows"][0]
    own = run_json(capsys, *command, *one, *asked)["rows"][0]
    soft = run_json(capsys, *command, *one, *asked, "--normals", "tangents")["rows"][0]
    assert "patches_without_normal" not in plain
    assert plain["triangles"] < min(own["triangles"], soft["triangles"])
    assert own["triangles"] != soft["triangles"]
    assert main([*command, *asked, "--scheme", "gregory", "--normals", "tangents"]) == 2
    assert "patches of the scheme 'gregory' have no tangent patches" in capsys.readouterr().err
    every = run_json(capsys, *command, *asked, "--normals", "tangents")
    assert {row["scheme"] for row in every["rows"]} == {"acc", "catmull-clark+acc"}
    assert "left out, as they have no tangent patches: gregory, catmull-clark+gregory" in every["notes"]


@pytest.mark.parametrize("command", ["minimality", "certify", "error-time", "inspect", "limit"])
@pytest.mark.parametrize("angle", ["0", "-1", "200", "nan"])
def test_angles_that_are_none(device, capsys, command, angle):
    assert main([command, "cusped.bpt", "--normal-tolerance", angle]) == 2
    shown = capsys.readouterr()
    assert "--normal-tolerance must be more than 0 and less than 90 degrees" in shown.err
    assert shown.err.count("\n") == 1
    assert not Path("runs").exists()
