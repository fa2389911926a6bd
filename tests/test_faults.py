"""What happens to long work: killed at any moment, a full disk, a lost device. Nothing that was found is lost."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from slefejax.experiments import store
from slefejax.experiments.cli import main
from slefejax.experiments.store import Run

ROWS = 4
SMALL = ("--size", "160x100", "--method", "slefe", "--scales", "1", "0.9", "0.8", "0.7")


def run_and_kill(folder: Path, out: str, moment: int) -> int:
    command = [sys.executable, "-m", "tests.killing", str(folder), out, str(moment), str(ROWS)]
    return subprocess.run(command, cwd=Path(__file__).parents[1], stderr=subprocess.PIPE).returncode


def places(folder: Path) -> list[Path]:
    return sorted(path.parent for path in folder.rglob("run.json") if ".partial" not in str(path))


def table_of(place: Path) -> list[dict[str, str]]:
    return list(csv.DictReader((place / "table.csv").read_text().splitlines()))


def assert_whole(place: Path) -> None:
    """The folder of a finished run: its table, its record, its files."""
    table = table_of(place)
    assert table == [{"k": str(k), "square": str(k * k)} for k in range(ROWS)]
    assert json.loads((place / "run.json").read_text())["experiment"] == "sweep"
    assert [(place / f"{k}.txt").read_text() for k in range(ROWS)] == [str(k) for k in range(ROWS)]


def check_all_kills(tmp_path: Path, out: str, moments: range) -> int:
    """Kill before the k-th operation, see what is there, go on; how many runs really were killed."""
    killed = 0
    for moment in moments:
        folder = tmp_path / f"{moment}"
        folder.mkdir()
        if out == "there":
            (folder / out).mkdir()
        status = run_and_kill(folder, out, moment)
        for place in places(folder):
            assert_whole(place)
        if status == 0:
            break
        assert status == -signal.SIGKILL
        killed += 1
        before = len(places(folder))
        if out != "-" and (folder / out / "run.json").exists():
            continue  # a folder that was named and is whole is not filled again
        assert run_and_kill(folder, out, 0) == 0
        assert len(places(folder)) == before + 1
        assert_whole(places(folder)[-1])
        assert not list(folder.rglob("*.partial")), "nothing is left over"
        made = [int(line) for line in (folder / "made").read_text().split()]
        if not before:
            # a row that was written down is never made again: only the one under way may be
            assert sorted(set(made)) == list(range(ROWS))
            assert len(made) <= ROWS + 1
    return killed


@pytest.mark.slow
@pytest.mark.parametrize("out", ["-", "new", "there"])
def test_killed_before_every_operation(tmp_path, out):
    """Every moment at which files could be half done, of runs into a folder of their own, a new one, an empty one."""
    assert check_all_kills(tmp_path, out, range(1, 200)) >= 15


@pytest.mark.parametrize("out", ["-", "new", "there"])
def test_killed_before_some_operations(tmp_path, out):
    assert check_all_kills(tmp_path, out, range(3, 40, 5)) >= 4


def test_half_a_line_costs_only_itself(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    with Run("sweep", {}, None) as run:
        run.add({"k": 1})
        run.add({"k": 2})
        with run.file("rows.jsonl").open("a") as file:
            file.write('{"k": 3, "val')
        run.add({"k": 4})
        assert run.rows() == [{"k": 1}, {"k": 2}, {"k": 4}]


def test_rows_with_other_columns_are_not_gone_on_with(tmp_path, monkeypatch):
    """Left by a version of the same name whose tables had other columns."""
    monkeypatch.chdir(tmp_path)
    with monkeypatch.context() as then:
        then.setattr(store, "_COLUMNS", 1)
        with Run("sweep", {}, None) as run:
            run.add({"k": 1, "drawn_outside": 0})
    with Run("sweep", {}, None) as run:
        assert run.rows() == []


def start(folder: Path, *more: str, limit: int | None = None) -> subprocess.Popen[bytes]:
    """``slefejax minimality`` as a process, with a limit to the size of files."""
    # set by the process itself: a function called between fork and exec is not safe beside JAX's threads
    limited = f"import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({limit}, {limit}))\n" if limit else ""
    program = limited + "from slefejax.experiments.cli import main; raise SystemExit(main())"
    command = [sys.executable, "-c", program, "minimality", "teapot", *SMALL, "--out", "out", *more]
    # what is compiled is cut off too: a folder of its own, so that others do not find it
    own = {} if limit is None else {"JAX_COMPILATION_CACHE_DIR": str(folder / "programs")}
    environment = {**os.environ, **own}
    return subprocess.Popen(command, cwd=folder, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE)


def finished(process: subprocess.Popen[bytes]) -> int:
    """Its exit status."""
    process.communicate()
    return process.returncode


def kept(folder: Path) -> list[dict]:
    """Rows of the run that is under way."""
    found = list(folder.glob(".*.partial/rows.jsonl"))
    return [json.loads(line) for line in found[0].read_text().splitlines()] if found else []


def without_times(rows: list[dict]) -> list[dict]:
    return [{name: value for name, value in row.items() if not name.endswith("_ms")} for row in rows]


@pytest.mark.gl
@pytest.mark.slow
def test_a_sweep_killed_at_random_moments(device, tmp_path):
    """The real command, killed a dozen times: rows only grow, and the table is that of a run in one go."""
    rng, kills, before = np.random.default_rng(9), 0, 0
    (tmp_path / "whole").mkdir()
    (tmp_path / "killed").mkdir()
    begun = time.perf_counter()
    assert finished(start(tmp_path / "whole")) == 0
    needed = time.perf_counter() - begun
    while kills < 12:
        process = start(tmp_path / "killed")
        try:
            process.communicate(timeout=rng.uniform(0.3, 1.0) * needed)
            break
        except subprocess.TimeoutExpired:
            process.kill()
            process.communicate()
        kills += 1
        assert len(kept(tmp_path / "killed")) >= before
        before = len(kept(tmp_path / "killed"))
    if not (tmp_path / "killed" / "out" / "run.json").exists():
        assert finished(start(tmp_path / "killed")) == 0
    tables = [table_of(tmp_path / name / "out") for name in ("whole", "killed")]
    assert without_times(tables[0]) == without_times(tables[1])


@pytest.mark.gl
def test_a_full_disk_loses_nothing(device, tmp_path):
    """Files of at most 2 kB: one sentence and status 2; with room again the same command goes on."""
    process = start(tmp_path, limit=2_000)
    _, said = process.communicate()
    assert process.returncode == 2
    assert said.decode().startswith("slefejax: the results could not be written")
    assert said.count(b"\n") == 1
    assert any((tmp_path / "programs").iterdir()), "programs that are cut off are there, and nothing is said of them"
    rows = kept(tmp_path)
    process = start(tmp_path, limit=1_000_000_000)
    _, said = process.communicate()
    assert process.returncode == 0
    assert b"cache" not in said
    table = table_of(tmp_path / "out")
    assert len(table) == 4
    for row in rows:
        assert str(row["max_error_px"]) in [other["max_error_px"] for other in table]


@pytest.mark.gl
def test_a_device_that_is_lost(device, tmp_path, monkeypatch, capsys):
    """OpenGL fails at the sixth picture, in the second row: one sentence, status 2, and the row before it is kept."""
    from slefejax.errors import OpenGLError
    from slefejax.gpu import Device

    monkeypatch.chdir(tmp_path)
    calls = []

    def lost(self: Device, doing: str) -> None:
        calls.append(doing)
        if calls.count("drawing patches") > 5:
            raise OpenGLError(f"OpenGL reports GL_CONTEXT_LOST while {doing} on {self.renderer}")

    with monkeypatch.context() as patch:
        patch.setattr(Device, "check_error", lost)
        assert main(["minimality", "teapot", *SMALL, "--out", "out"]) == 2
    said = capsys.readouterr().err
    assert "GL_CONTEXT_LOST while drawing patches" in said
    assert said.count("\n") == 1
    before = kept(tmp_path)
    assert 0 < len(before) < 4
    assert main(["minimality", "teapot", *SMALL, "--out", "out"]) == 0
    table = table_of(tmp_path / "out")
    assert [row["scale"] for row in table] == ["1.0", "0.9", "0.8", "0.7"]
    assert without_times(table)[0]["max_error_px"] == str(before[0]["max_error_px"])
