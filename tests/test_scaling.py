from __future__ import annotations

import json
import os

import numpy as np
import pytest

from slefejax import InputError
from slefejax.experiments.bench import scaling
from slefejax.experiments.cli import main
from slefejax.geometry.bezier import evaluate_patch
from tests.tables import SHOWN


def made_up(rng, noise):
    """Measurements of a machine whose costs are known: 2 ms, 4 µs a patch, 0.3 µs a triangle, 5 ns a pixel."""
    rows = []
    for _ in range(60):
        patches, triangles, pixels = rng.integers(30, 600), rng.integers(2000, 60_000), rng.integers(50_000, 900_000)
        time = 2.0 + 4e-3 * patches + 3e-4 * triangles + 5e-6 * pixels
        time *= 1 + noise * rng.normal()
        rows.append({"patches": patches, "triangles": triangles, "shaded_pixels": pixels, "render_ms": time})
    return rows


def test_fit_finds_known_costs(rng):
    rows, fit = scaling.fit_costs(made_up(rng, 0.0))
    assert [row["us_each"] for row in rows] == pytest.approx([2000, 4.0, 0.3, 5e-3], rel=1e-9)
    assert fit["r_squared"] == pytest.approx(1.0)
    noisy, fit = scaling.fit_costs(made_up(rng, 0.02))
    for row, cost in zip(noisy, (2000, 4.0, 0.3, 5e-3), strict=True):
        assert abs(row["us_each"] - cost) < 4 * row["standard_error_us"], "within four standard errors"
        assert row["standard_error_share"] > 0
    assert 0.9 < fit["r_squared"] < 1.0


def test_measurements_that_do_not_vary_are_refused(rng):
    rows = made_up(rng, 0.0)
    with pytest.raises(InputError, match="do not vary enough"):
        scaling.fit_costs([{**row, "patches": 32} for row in rows])
    with pytest.raises(InputError, match="do not vary enough"):
        scaling.fit_costs(rows[:4])


def test_split_is_the_same_surface(rng):
    patches = rng.normal(size=(3, 4, 3, 3))
    parts = scaling.split(patches, 3)
    assert parts.shape == (27, 4, 3, 3)
    for p, i, j in ((0, 0, 0), (1, 2, 1), (2, 1, 2)):
        own = parts[p * 9 + i * 3 + j]
        for u, v in rng.random((4, 2)):
            whole = evaluate_patch(patches[p], (i + u) / 3, (j + v) / 3)
            np.testing.assert_allclose(evaluate_patch(own, u, v), whole, atol=1e-13)


@pytest.mark.gl
def test_run(device, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ("SPLITS", "SCALES", "ZOOMS"):
        monkeypatch.setattr(scaling, name, getattr(scaling, name)[:2])
    assert main(["scaling", "teapot", "--size", "160x100", "--repeats", "2", "--json"]) == 0
    result = json.loads(capsys.readouterr().out)
    assert [row["term"] for row in result["rows"]] == ["frame", "patches", "triangles", "shaded_pixels"]
    assert len(result["measured"]) == 8
    assert {row["patches"] for row in result["measured"]} == {32, 128}
    assert set(os.listdir(result["out"])) == SHOWN | {"scaling.png"}
    assert main(["scaling", "teapot", "--repeats", "0"]) == 2
