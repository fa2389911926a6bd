"""The command stability, and that what it looks for would be found."""

from __future__ import annotations

import csv
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from slefejax import sampled_error, screen_widths, slefe_boxes, tessellation_factors, worst_points
from slefejax.experiments.checks import reference, stability
from slefejax.experiments.checks.cases import FAMILIES, Case, bumpy, seen_from
from slefejax.experiments.cli import main
from tests.test_cli import run_json


@pytest.fixture
def case() -> Case:
    return Case(bumpy(2, count=2), seen_from(), depth_tolerance=1e-4, segments=2)


def test_sixty_digits_agree_with_the_library(case):
    """Two computations that share no code: boxes, widths, errors."""
    exact = reference.exact(case.patches)
    lower, upper = (bound.astype(float) for bound in reference.boxes(exact, (2, 2)))
    found = slefe_boxes(case.patches, 2)
    np.testing.assert_allclose(found.lower, lower, atol=1e-13)
    np.testing.assert_allclose(found.upper, upper, atol=1e-13)
    widths = reference.widths(exact, case.view, (2, 2))[:, 0].astype(float)
    np.testing.assert_allclose(screen_widths(case.patches, case.view, 2), widths, rtol=1e-12)
    worst = worst_points(case.patches, [5, 9], case.view)
    np.testing.assert_allclose(worst.error, sampled_error(case.patches, [5, 9], case.view))
    for k, n in enumerate((5, 9)):
        again = float(reference.cell_error(exact[k], case.view, n, worst.u[k], worst.v[k]))
        assert again == pytest.approx(worst.error[k], rel=1e-9)


@pytest.mark.slow
def test_nothing_is_broken_in_an_easy_case(case):
    row = stability.measure(case, np.float32)
    assert [row[name] for name in ("containment_violations", "certificate_violations", "nonfinite", "refused")] == [
        0
    ] * 4
    assert row["certificate_checked"] == 2
    assert 0.3 < row["certificate_worst"] <= 1.0
    assert row["containment_worst"] <= 0.0


@pytest.mark.slow
def test_an_enclosure_that_is_too_small_is_found(case, monkeypatch):
    def smaller(*arguments):
        found = slefe_boxes(*arguments)
        return found._replace(upper=found.upper - 1e-13)

    monkeypatch.setattr(stability, "slefe_boxes", smaller)
    assert stability.measure(case, np.float64)["containment_violations"] > 0


@pytest.mark.slow
@pytest.mark.parametrize("of_depth", [False, True])
def test_a_factor_that_is_too_small_is_found(case, monkeypatch, of_depth):
    def coarser(patches, view, method, *, tolerance, depth_tolerance, **own):
        pixels, depth = (tolerance, 3.0 * depth_tolerance) if of_depth else (3.0 * tolerance, None)
        return tessellation_factors(patches, view, method, tolerance=pixels, depth_tolerance=depth, **own)

    hard = replace(case, depth_tolerance=1e-6 if of_depth else None)
    assert stability.measure(hard, np.float64)["certificate_violations"] == 0
    monkeypatch.setattr(stability, "tessellation_factors", coarser)
    assert stability.measure(hard, np.float64)["certificate_violations"] > 0


def test_the_command(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = run_json(capsys, "stability", "--quick", "--only", "small weights", "half turn")
    by_name = {row["family"]: row for row in result["rows"]}
    assert set(by_name) == {"small weights", "half turn"}
    for row in by_name.values():
        assert (row["single_broken"], row["double_broken"], row["nonfinite"]) == (0, 0, 0)
        assert row["single_unsafe_from"] == "never"
        assert row["double_error"] < 1e-12 < row["single_error"] < 1e-5
    folder = Path(result["out"])
    with (folder / "table.csv").open() as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == 2 * (3 + 3)
    assert (folder / "stability.png").stat().st_size > 10_000


def test_unknown_families_are_refused(capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["stability", "--only", "weather"]) == 2
    error = capsys.readouterr().err
    assert "'weather'" in error
    assert FAMILIES[0].name in error
