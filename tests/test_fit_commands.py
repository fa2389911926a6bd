"""The commands fit-km, budget, sensitivity, optimise."""

from __future__ import annotations

import csv
import os

import numpy as np
import pytest

from slefejax import load
from slefejax.experiments.cli import main
from tests.tables import SHOWN
from tests.test_cli import run_json

FAST = ["--method", "slefe", "--segments", "1"]
SMALL = ["--size", "320x200"]


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


@pytest.mark.slow
def test_fit_km(capsys):
    options = ["--segments", "1", "--cameras", "3", "--resamples", "20", *SMALL]
    result = run_json(capsys, "fit-km", "teapot", *options)
    rows = result["rows"]
    assert [row["segments"] for row in rows] == [1]
    for row in rows:
        assert 1.0 < row["quantile"] <= row["largest"] < 2.5
        assert row["quantile_low"] <= row["quantile"] * 1.001
        assert row["quantile"] <= row["quantile_high"] * 1.001
        assert row["published"]
        assert row["converged"] == "yes"
    assert [row["analytic_cubic"] for row in rows] == pytest.approx([1.3959], abs=1e-4)
    assert max(row["below_analytic_share"] for row in result["curves"]) < 0.01
    models = {(row["scene"], row["model"]): row for row in result["models"]}
    quad = models["twisted-quad", "slefe, k_1 fitted"]
    assert quad["max_error_px"] > 10, "no constant repairs what the estimate does not see"
    assert models["twisted-quad", "certified"]["max_error_px"] <= 0.5
    assert models["teapot", "certified"]["held_out_share_unsafe"] == 0.0
    assert os.path.getsize(f"{result['out']}/fit_km.png") > 10_000
    with open(f"{result['out']}/samples_0_teapot.csv") as file:
        samples = list(csv.DictReader(file))
    assert len(samples) == rows[0]["samples"] or len(samples) > rows[0]["samples"]
    assert {"view", "patch", "minimal", "needed", "certified", "slefe_1", "twist"} == set(samples[0])


@pytest.mark.parametrize("by", ["tolerance", pytest.param("distance", marks=pytest.mark.slow)])
def test_budget(capsys, by):
    result = run_json(capsys, "budget", "teapot", "--triangles", "2000", "9000", "--by", by, *FAST)
    for row, wanted in zip(result["rows"], (2000, 9000), strict=True):
        assert row["budget"] == wanted
        assert 0.99 <= row["share_of_budget"] <= 1.0
        assert row["met"] == "within 1 %"
    assert set(os.listdir(result["out"])) == SHOWN | {"budget.png"}


@pytest.mark.slow
def test_sensitivity(capsys):
    result = run_json(capsys, "sensitivity", "teapot", *FAST)
    rows = result["rows"]
    assert [row["kind"] for row in rows[:3]] == ["tolerance", "camera distance", "control point"]
    assert rows[0]["triangles_more"] == pytest.approx(-0.01 * result["triangles"], rel=1e-6)
    table = np.loadtxt(f"{result['out']}/points.csv", delimiter=",", skiprows=1)
    assert table.shape == (290, 7)
    steepest = 0.01 * result["radius"] * np.linalg.norm(table[:, 4:], axis=1)
    assert rows[2]["triangles_more"] == pytest.approx(steepest.max(), rel=1e-6)
    assert int(rows[2]["name"]) == int(steepest.argmax())


@pytest.mark.slow
def test_optimise(capsys):
    options = ["--cameras", "2", "--solver-steps", "4", "--within", "0.01", "--turn", "20", *SMALL, *FAST]
    result = run_json(capsys, "optimise", "teapot", *options)
    fitted, held = result["rows"]
    assert fitted["after"] < fitted["before"]
    assert (fitted["count"], held["count"]) == (1, 1)
    surface = result["surface"]
    assert surface["largest_distance"] <= surface["allowed_distance"] * 1.001
    assert surface["largest_turn_degrees"] <= 20.0
    assert surface["turn_at_edges_before_degrees"] < 0.01
    assert surface["turn_at_edges_after_degrees"] <= 40.0
    moved = load(f"{result['out']}/optimised.bpt").patches()
    teapot = load("teapot").patches()
    assert np.array_equal(moved[:, [0, -1]], teapot[:, [0, -1]])
    assert surface["control_points_moved_by"] == pytest.approx(np.linalg.norm(moved - teapot, axis=-1).max())
    names = SHOWN | {"optimise.png", "optimised.bpt", "patches.csv"}
    assert set(os.listdir(result["out"])) == names


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["fit-km", "teapot", "teapot"], "none twice"),
        (["fit-km", "teapot", "--target", "1.5"], "--target is a share"),
        (["fit-km", "teapot", "--cameras", "1"], "--cameras"),
        (["fit-km", "teapot", "--segments", "0"], "--segments are numbers from 1 to 64"),
        (["fit-km", "teapot", "--seed", "-1"], "--seed must be at least 0"),
        (["fit-km", "teapot", "--temperature", "0"], "--temperature must lie"),
        (["optimise", "teapot", "--method", "filip"], "method 'filip' has none"),
        (["budget", "teapot", "--triangles", "500", "--tolerance", "0"], "what is looked for"),
        (["sensitivity", "teapot", "--tolerance", "0"], "tolerance must be"),
        (["fit-km", "nothing.obj"], "nothing.obj"),
        (["budget", "teapot", "--triangles", "20", *FAST], "20 triangles are too few"),
        (["budget", "teapot", "--triangles", "500", "500"], "none twice"),
        (["budget", "teapot", "--triangles", "500", "--method", "fixed"], "nothing to find"),
        (["sensitivity", "teapot", "--verify"], "verify finds whole numbers"),
        (["sensitivity", "teapot", "--time", "3"], "does not move"),
        (["optimise", "twisted-quad", "--cameras", "2"], "no inner control points"),
        (["optimise", "teapot", "--within", "-1"], "--within is a share"),
        (["optimise", "teapot", "--cameras", "1"], "--cameras"),
        (
            ["budget", "teapot", "--triangles", "500", "--normal-tolerance", "0"],
            "--normal-tolerance must be more than 0",
        ),
        (["sensitivity", "teapot", "--normal-tolerance", "nan"], "--normal-tolerance must be more than 0"),
        (["optimise", "teapot", "--normal-tolerance", "200"], "--normal-tolerance must be more than 0"),
    ],
)
def test_bad_input_is_one_sentence(arguments, says, capsys):
    assert main(arguments) == 2
    said = capsys.readouterr()
    assert says in said.err
    assert said.out == ""
    assert not os.path.exists("runs"), "nothing is left behind"
