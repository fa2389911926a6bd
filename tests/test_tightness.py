from __future__ import annotations

import json
import os

import numpy as np
import pytest

from slefejax.experiments.checks.tightness import curve_kinds, step_curve, tensor_order
from slefejax.experiments.cli import main
from tests.tables import SHOWN


@pytest.fixture(autouse=True)
def in_an_empty_folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)


def test_run(capsys):
    assert main(["tightness", "--segments", "1", "3", "--curves", "6", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    rows = result["rows"]
    pictures = {"slefe_construction.png", "six_bounds.png", "width_against_pieces.png", "width_against_time.png"}
    assert set(os.listdir(result["out"])) == pictures | SHOWN
    assert {row["method"] for row in rows if row["segments"] == 3} == {
        *("min-max", "oriented-box", "convex-hull", "disc", "filip", "control-polygon", "slefe")
    }
    assert not [row for row in rows if row["segments"] == 1 and row["method"] == "control-polygon"]
    # the optimum is the narrowest continuous enclosure; separate boxes a piece may be narrower
    for row in rows:
        if row["method"] == "slefe":
            assert row["width_over_optimum_median"] >= 1 - 1e-6
        assert row["width_over_optimum_median"] <= row["width_over_optimum_max"] * (1 + 1e-12)
        assert row["us_per_curve"] > 0
    by_case = {(row["curve"], row["segments"], row["method"]): row["width_over_optimum_max"] for row in rows}
    assert by_case["one bend", 3, "slefe"] == pytest.approx(1.0, abs=1e-6)
    assert by_case["convex", 3, "slefe"] < 1.07
    assert by_case["step", 3, "slefe"] == pytest.approx(1.584, abs=1e-3)


def test_kinds_are_what_they_are_called():
    kinds = curve_kinds(3, 50, seed=4)
    assert step_curve(3).tolist() == [0, -1, 1, 0]
    assert step_curve(4).tolist() == [0, -1, 0, 1, 0]
    assert np.all(np.diff(kinds["convex"], 2, axis=0) >= -1e-12)
    assert np.abs(np.diff(kinds["nearly straight"], 2, axis=0)).max() < 1e-4
    for name, curves in kinds.items():
        assert curves.shape[0] == 4, name
        assert np.array_equal(curves, curve_kinds(3, 50, seed=4)[name]), "reproducible"


def test_neither_tensor_order_is_tighter():
    order = tensor_order(seed=1, patches=400)
    assert order["v_then_u_over_u_then_v_median"] == pytest.approx(1.0, abs=0.02)
    assert order["v_then_u_over_u_then_v_min"] < 0.9
    assert order["v_then_u_over_u_then_v_max"] > 1.1


@pytest.mark.parametrize(
    "arguments", [["--degree", "1"], ["--segments", "0"], ["--curves", "0"], ["--segments", "3", "-1"]]
)
def test_bad_input(capsys, tmp_path, arguments):
    assert main(["tightness", *arguments]) == 2
    shown = capsys.readouterr()
    assert shown.out == ""
    assert shown.err.count("\n") == 1
    assert not (tmp_path / "runs").exists()
