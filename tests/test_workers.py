"""Studies on workers: who is asked for what, what a worker's death costs, and what is refused."""

from __future__ import annotations

import json
import os
import pickle
import signal
import socket
import subprocess
import sys
import time
from collections import Counter
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest

from slefejax import InputError, Study
from slefejax.experiments.cli import main
from slefejax.experiments.grid import crew
from slefejax.experiments.grid.crew import Crew
from slefejax.experiments.grid.dispatch import Dispatch, sources
from slefejax.experiments.grid.running import Running
from slefejax.experiments.grid.scenes import Scenes
from slefejax.experiments.grid.shares import Shares
from slefejax.experiments.grid.sights import FAILED, REFUSED, Asked
from slefejax.experiments.grid.worker import Message, identity
from slefejax.experiments.tables import Rows
from tests.test_grid import QUICK, lines, write

GRID = Study(("twisted-quad", "steep-patch"), {"cameras": 3, "size": [64, 40]}, tolerances_px=(0.25, 0.5, 1.0, 2.0))


def asked_of(study: Study) -> list[Asked]:
    return [Asked(str(k), case, study.measure) for k, case in enumerate(study.cases())]


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["--workers", "0"], "--workers must be a whole number of at least 1, not 0"),
        (["--workers", "-1"], "--workers must be a whole number of at least 1, not -1"),
        (["--workers", "10000"], "--workers are "),
        (["--workers", "2", "--scheduler", "tcp://127.0.0.1:8786"], "--workers are processes of"),
        (["--scheduler", "tcp://127.0.0.1:1"], "no scheduler answers at tcp://127.0.0.1:1"),
        (["--scheduler", "nowhere"], "no scheduler answers at nowhere"),
        (["--scheduler", "tls://127.0.0.1:1"], "needs certificates"),
    ],
)
def test_workers_that_cannot_be(capsys, tmp_path, monkeypatch, words, message):
    monkeypatch.setattr(crew, "_ANSWER", 0.5)
    path = write(tmp_path / "study.toml", **QUICK)
    assert main(["study", str(path), "--out", str(tmp_path / "out"), *words]) == 2
    said = capsys.readouterr().err
    assert message in said
    assert said.count("\n") == 1
    assert not (tmp_path / "out").exists()


def test_something_else_listens_there(capsys, tmp_path, monkeypatch):
    """And says nothing."""
    monkeypatch.setattr(crew, "_ANSWER", 0.5)
    path = write(tmp_path / "study.toml", **QUICK)
    with socket.create_server(("127.0.0.1", 0)) as other:
        address = f"tcp://127.0.0.1:{other.getsockname()[1]}"
        assert main(["study", str(path), "--out", str(tmp_path / "out"), "--scheduler", address]) == 2
    assert f"no scheduler answers at {address}" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()


def test_without_the_extra(monkeypatch):
    monkeypatch.setattr(crew, "find_spec", lambda name: None)
    assert Crew().alone
    with pytest.raises(InputError, match=r"pip install 'slefejax\[cluster\]'"):
        Crew(workers=1)


def test_how_long_it_takes_on_workers(tmp_path):
    folder = tmp_path / "out"
    Study(**QUICK).run(folder)
    more = Study(**{**QUICK, "tolerances_px": (0.5, 1.0, 2.0)})
    (one,), (two,) = (Running(more, folder, Crew(count)).estimate() for count in (None, 2))
    assert two["minutes"] == pytest.approx(one["minutes"] / 2)


def test_every_case_is_somebodys_once(rng):
    """Whoever takes, leaves and gives back."""
    asked = asked_of(GRID)
    shares, seen, held = Shares(asked), Counter(), []
    while shares or held:
        worker = f"worker {rng.integers(3)}"
        kind = rng.integers(4)
        if kind == 0 and held:
            shares.put_back(held.pop())
        elif kind == 1:
            shares.leave(worker)
        elif taken := shares.take(worker, int(rng.integers(1, 4))):
            assert len({own.case[:3] for own in taken}) == 1
            held.append(taken)
        if len(held) > 2:
            seen.update(own.key for own in held.pop(0))
        elif not shares and held:
            seen.update(own.key for own in held.pop())
    assert seen == Counter(own.key for own in asked)


def test_workers_keep_to_scenes_and_views_and_help_at_the_end():
    shares, taken = Shares(asked_of(GRID)), {"one": [], "other": []}
    for _ in range(12):
        for worker, own in taken.items():
            own += [asked.case for asked in shares.take(worker, 1)]
    assert [{case.scene for case in own} for own in taken.values()] == [{"twisted-quad"}, {"steep-patch"}]
    assert all([case.view for case in own] == sorted(case.view for case in own) for own in taken.values())
    shares = Shares(asked_of(Study(("twisted-quad",), tolerances_px=(0.25, 0.5, 1.0, 2.0))))
    assert [own.key for own in shares.take("one", 1)] == ["0"]
    assert [own.key for own in shares.take("other", 9)] == ["2", "3"]


class FakeClient:
    """Workers that answer at once, and of which one dies whenever somebody draws the wrong number."""

    status = "running"

    def __init__(self, rng, deadly=(), share=0.0, **identities) -> None:
        self.rng, self.deadly, self.share, self.identities = rng, set(deadly), share, identities
        self.alive, self.count, self.measured = ["a0", "b0"], 0, Counter()

    def subscribe_topic(self, topic, handler) -> None:
        self.tell = handler

    def nthreads(self) -> dict[str, int]:
        return dict.fromkeys(self.alive, 1)

    def run(self, function, workers, on_error) -> dict[str, Any]:
        return {address: identity() | self.identities for address in workers}

    def submit(self, function, message, workers, **options) -> Any:
        message = Message(*pickle.loads(message))
        for own in message.asked if workers[0] in self.alive else ():
            if own.key in self.deadly or self.rng.random() < self.share:
                self.count += 1
                self.alive[self.alive.index(workers[0])] = f"{workers[0][0]}{self.count}"
                break
            self.measured[own.key] += 1
            row = {"case": own.key, "scene": own.case.scene, REFUSED: "", "seconds": 0.01}
            self.tell((0.0, [message.number, json.dumps(row)]))
        return SimpleNamespace(status="pending", release=lambda: None)


@pytest.fixture
def at_once(monkeypatch):
    monkeypatch.setattr("slefejax.experiments.grid.dispatch._LOOK", 0.002)


def test_no_row_twice_whoever_dies(rng, at_once):
    client, asked = FakeClient(rng, share=0.1), asked_of(GRID)
    found = [row for rows in Dispatch(client, Scenes(GRID), "").rows(asked, lambda detail: None) for row in rows]
    assert client.count > 3
    assert sorted(row["case"] for row in found) == sorted(own.key for own in asked)
    assert all(FAILED not in row for row in found if client.measured[row["case"]])


def test_a_case_that_kills_its_worker_is_given_up(rng, at_once, tmp_path):
    """After two deaths, and those that wait behind it are not to blame."""
    client, asked = FakeClient(rng, deadly=("1", "17")), asked_of(GRID)
    found = [row for rows in Dispatch(client, Scenes(GRID), "").rows(asked, lambda detail: None) for row in rows]
    assert {row["case"] for row in found if FAILED in row} == client.deadly
    assert client.count == 4
    assert len(found) == len(asked) == sum(client.measured.values()) + 2


def test_a_failed_row_is_shown_and_tried_again(tmp_path, monkeypatch):
    failing = crew.Alone.rows

    def half(self, asked, tell):
        yield [{"case": asked[0].key, "scene": "twisted-quad", REFUSED: "its worker died", FAILED: True}]
        yield from failing(self, asked[1:], tell)

    monkeypatch.setattr(crew.Alone, "rows", half)
    path = write(tmp_path / "study.toml", **QUICK, tolerances_px=[0.5, 1.0])
    assert main(["study", str(path), "--out", str(tmp_path / "out")]) == 2
    assert "its worker died" in (tmp_path / "out" / "table.csv").read_text()
    assert len(lines(tmp_path / "out")) == 1
    monkeypatch.setattr(crew.Alone, "rows", failing)
    assert main(["study", str(path), "--out", str(tmp_path / "out")]) == 0
    assert len(lines(tmp_path / "out")) == 2


def test_workers_of_another_version_are_refused(rng):
    with pytest.raises(InputError, match=r"the worker a0 has jax 0\.0\.1 where this process has"):
        Dispatch(FakeClient(rng, jax="0.0.1"), Scenes(GRID), "").wait(1.0)


def test_sources_of_ones_own_rules_travel(tmp_path, monkeypatch):
    (tmp_path / "grid_help.py").write_text("PIXELS = 5.0\n")
    text = "from grid_help import PIXELS\nfrom tests.test_methods import EverySo\nclass Own(EverySo): pass\n"
    (tmp_path / "travelling_rules.py").write_text(text)
    monkeypatch.chdir(tmp_path)
    method = {"name": "travelling_rules:Own", "pixels": 5.0}
    study = Study(**{**QUICK, "methods": (method,)}, trust_rules=True)
    assert set(sources(study)) == {"travelling_rules.py", "grid_help.py"}
    assert sources(GRID) == {}


def test_rows_of_a_worker_are_those_of_this_process(tmp_path):
    path = write(tmp_path / "study.toml", **QUICK, tolerances_px=[0.25, 0.5, 1.0])
    study = Study.load(path)
    study.run(tmp_path / "alone")
    command(path, tmp_path / "one", "--workers", "1")
    assert table(tmp_path / "one") == table(tmp_path / "alone")


def command(path: Path, folder: Path, *more: str, cwd: Path | None = None) -> None:
    words = [sys.executable, "-m", "slefejax", "study", str(path), "--out", str(folder), *more]
    there = {**os.environ, "PYTHONPATH": str(Path(__file__).resolve().parents[1])}
    found = subprocess.run(words, capture_output=True, text=True, check=False, cwd=cwd, env=there)
    assert found.returncode == 0, found.stderr


def table(folder: Path) -> str:
    return (folder / "table.csv").read_text()


def killed(module: str, folder: Path, kills: int) -> dict[str, Any]:
    """What a script says that kills studies."""
    words = [sys.executable, "-m", f"tests.{module}", str(folder), str(kills), "20261129"]
    said = subprocess.run(words, stdout=subprocess.PIPE, text=True, check=True).stdout
    return json.loads(said.splitlines()[-1])


@pytest.mark.slow
def test_instant_rows_and_many_kills(tmp_path):
    found = killed("killed_at_once", tmp_path, int(os.environ.get("SLEFEJAX_STUBBED_KILLS", "60")))
    assert found["within"] > found["kills"] / 2
    assert (found["lost"], found["doubled"], found["other_tables"]) == (0, 0, 0)


@pytest.mark.slow
def test_real_processes_and_kills(tmp_path):
    """One study with ``--workers`` and one with ``--scheduler`` at least; ten minutes for twenty kills."""
    found = killed("killed_workers", tmp_path, int(os.environ.get("SLEFEJAX_KILLS", "9")))
    assert found["studies"] >= 2
    assert (found["lost"], found["doubled"], found["other_tables"], found["left"]) == (0, 0, 0, 0)


@pytest.mark.slow
def test_two_workers_say_what_one_process_says(tmp_path):
    """To the last digit, with a rule of one's own and a case that is refused."""
    (tmp_path / "rules_of_workers.py").write_text("from tests.test_methods import EverySo as Mine\n")
    methods = ["certified", {"name": "rules_of_workers:Mine", "pixels": 5.0}, {"name": "fixed", "setting": 1e7}]
    content = {**QUICK, "scenes": ["twisted-quad", "steep-patch"], "views": {"cameras": 2, "size": [160, 100]}}
    path = write(tmp_path / "study.toml", **{**content, "methods": methods, "measure": ["pixels", "domain", "drawn"]})
    command(path, tmp_path / "alone", "--trust-rules", cwd=tmp_path)
    command(path, tmp_path / "two", "--trust-rules", "--workers", "2", cwd=tmp_path)
    assert table(tmp_path / "two") == table(tmp_path / "alone")


@pytest.mark.slow
@pytest.mark.parametrize("kind", [signal.SIGINT, signal.SIGTERM, signal.SIGKILL])
def test_workers_end_with_the_client(tmp_path, kind):
    """However it ends; the folder goes on without workers."""
    views, folder = {"cameras": 30, "size": [160, 100]}, tmp_path / "out"
    path = write(tmp_path / "study.toml", **{**QUICK, "views": views})
    words = [sys.executable, "-m", "slefejax", "study", str(path), "--out", str(folder)]
    with subprocess.Popen([*words, "--workers", "2"], stdout=subprocess.DEVNULL, stderr=subprocess.PIPE) as client:
        while client.poll() is None and not Rows(folder / "rows.jsonl")():
            time.sleep(0.02)
        own = psutil.Process(client.pid).children(recursive=True)
        assert len(own) >= 2
        client.send_signal(kind)
        said = client.communicate()[1].decode()
    assert psutil.wait_procs(own, timeout=30)[1] == []  # one that has just begun has to import first
    assert kind != signal.SIGINT or (client.returncode == 130 and said.count("\n") == 1)
    command(path, folder)
    assert len({row["case"] for row in lines(folder)}) == len(lines(folder)) == 30
