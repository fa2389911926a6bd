from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest

from slefejax import tessellation_factors
from slefejax.errors import InputError
from slefejax.experiments.bench import peers
from slefejax.experiments.bench.bench import Bench, machine_record
from slefejax.experiments.bench.process import Worker, on_cores
from slefejax.experiments.bench.stages import STAGES, Setting
from slefejax.experiments.cli import main
from slefejax.lanes import passes
from slefejax.measure.error import pixel_error
from tests.tables import SHOWN


@pytest.fixture(scope="module")
def setting():
    return Setting(100, np.float64, None)


@pytest.mark.parametrize("stage", ["stencils", "skinning", "pose pass", "view pass", "fused"])
def test_stages_and_their_peers_do_the_same(setting, stage):
    """To rounding in double precision."""
    work = STAGES[stage](setting)
    assert work.same is not None
    own: Any = work.same(work.run())
    compared = [work.same(other()) for other in work.peers.values()]
    assert any(theirs is not None for theirs in compared)
    for theirs in compared:
        if theirs is not None:
            np.testing.assert_allclose(own, theirs, rtol=1e-8, atol=1e-8)


def test_peers_give_the_factors_of_the_library(setting):
    patches, view = setting.patches, setting.view
    wanted = np.asarray(tessellation_factors(patches, view, "slefe").factor)
    moved = patches - np.asarray(setting.projection.origin)
    plain = peers.plain_factors(peers.plain_boxes(moved, 3), setting.projection, 0.5, 3)
    unrolled = peers.unrolled_factors(np.moveaxis(moved, 0, -1), setting.projection, 0.5, 3)
    np.testing.assert_allclose(plain, wanted, rtol=1e-9)
    np.testing.assert_allclose(unrolled, wanted, rtol=1e-9)


def test_peer_of_the_error_image(setting, rng):
    u, v = rng.uniform(size=(2, 30, 40)).astype(np.float32)
    patch = rng.integers(-1, setting.count, (30, 40))
    drawn = rng.normal(size=(30, 40, 2)).astype(np.float32)
    own = pixel_error(setting.patches, setting.view, u, v, patch, drawn)
    theirs = peers.plain_pixel_error(setting.patches, np.asarray(setting.view.world_to_screen), u, v, patch, drawn)
    np.testing.assert_allclose(own, theirs, rtol=1e-9)


def test_command(tmp_path, capsys):
    status = main(["bench", "--counts", "40", "--only", "fused", "table", "--quick", "--json", "--out", str(tmp_path)])
    rows = json.loads(capsys.readouterr().out)["rows"]
    assert status == 0
    assert {row["stage"] for row in rows} == {"fused", "table"}
    assert all(row["median_ms"] > 0 and row["low_ms"] <= row["median_ms"] <= row["high_ms"] for row in rows)
    assert {row["peer"] for row in rows if row["stage"] == "fused"} >= {"NumPy", "NumPy, unrolled"}
    assert {path.name for path in tmp_path.iterdir()} == SHOWN | {"benchmarks.md", "time_against_patches.png"}


def test_a_process_that_ends_is_one_sentence():
    with Worker(1, 0.01) as worker:
        (row,) = worker.rows("table", 1, "double", False)
        worker._process.kill()
        with pytest.raises(InputError, match=r"table of 1 patches ended.*--counts"):
            worker.rows("table", 1, "double", False)
    assert row["cores"] == 1


@pytest.mark.parametrize(
    ("options", "says"), [({"only": ("lunch",)}, "no stage 'lunch'"), ({"counts": (0,)}, "counts")]
)
def test_bad_options(options, says):
    with pytest.raises(InputError, match=says):
        Bench(**options).run()


def test_cores_are_given_back():
    before = passes.cores()
    with on_cores(1):
        assert passes.cores() == 1
    assert passes.cores() == before


def test_the_machine_is_described():
    record: Any = machine_record()
    assert record["cores"] == passes.cores()
    assert record["processor"]


def test_programs_are_kept_unless_that_is_not_wanted(tmp_path, monkeypatch, capsys):
    import jax

    before = (
        jax.config.values["jax_compilation_cache_dir"],
        jax.config.values["jax_persistent_cache_min_compile_time_secs"],
        jax.config.values["jax_enable_compilation_cache"],
    )
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    monkeypatch.delenv("JAX_COMPILATION_CACHE_DIR")
    try:
        assert main(["doctor", "--no-cache", "--json"]) == 0
        assert not (tmp_path / "slefejax").exists()  # Mesa may keep its own there
        assert not jax.config.values["jax_enable_compilation_cache"]
        assert main(["doctor", "--json"]) == 0
        assert jax.config.values["jax_compilation_cache_dir"].startswith(str(tmp_path / "slefejax"))
    finally:
        jax.config.update("jax_compilation_cache_dir", before[0])
        jax.config.update("jax_persistent_cache_min_compile_time_secs", before[1])
        jax.config.update("jax_enable_compilation_cache", before[2])
    capsys.readouterr()
