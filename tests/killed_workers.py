"""``python -m tests.killed_workers FOLDER KILLS SEED``: studies whose workers are killed, and what is left.

A worker, its nanny, the scheduler, the client or all of them get SIGKILL at random moments: with ``--workers 2``, where
scheduler and nannies are threads of the client, and with a scheduler and workers of their own by turns.
"""

from __future__ import annotations

import json
import random
import subprocess
import sys
import time
from collections import Counter
from contextlib import suppress
from pathlib import Path

import psutil

from slefejax.experiments.tables import Rows

TEXT = """
scenes = ["twisted-quad", "steep-patch"]
views = { cameras = 4, size = [64, 40] }
tolerances_px = [0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.5]
measure = ["pixels", "domain"]
"""
CASES = 64
PYTHON = [sys.executable, "-m"]


def started(*words: str) -> subprocess.Popen:
    """A process of Python that says nothing."""
    return subprocess.Popen([*PYTHON, *words], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


class Processes:
    """Those of one study: its client, and a scheduler and workers of their own if it has some."""

    def __init__(self, folder: Path, cluster: bool) -> None:
        self.rows = Rows(folder / "rows.jsonl")
        self._beside: list[subprocess.Popen] = []
        self._command = ["slefejax", "study", str(folder.parent / "study.toml"), "--out", str(folder)]
        self._cluster, self._port = cluster, 20_000 + random.randrange(20_000)
        if not cluster:
            self._command += ["--workers", "2"]
        self._now = self._command
        self.client: subprocess.Popen | None = None

    def start(self) -> None:
        """Whatever is not running."""
        alive = [own for own in self._beside if own.poll() is None]
        if self._cluster and len(alive) < 3:
            self.end()
            self._port += 1
            address = f"tcp://127.0.0.1:{self._port}"
            scheduler = ["--host", "127.0.0.1", "--port", str(self._port), "--no-dashboard"]
            worker = [address, "--nthreads", "1", "--no-dashboard", "--death-timeout", "10", "--memory-limit", "0"]
            for words in (["scheduler", *scheduler], ["worker", *worker], ["worker", *worker]):
                self._beside.append(started("dask", *words))
            time.sleep(4.0)
            self._now = [*self._command, "--scheduler", address]
        if self.client is None or self.client.poll() is not None:
            self.client = started(*self._now)

    def every(self) -> list[psutil.Process]:
        """All that are running, with those that they started."""
        own = [process.pid for process in (self.client, *self._beside) if process and process.poll() is None]
        found = []
        for pid in own:
            with suppress(psutil.NoSuchProcess):
                found += [psutil.Process(pid), *psutil.Process(pid).children(recursive=True)]
        return [process for process in found if "resource_tracker" not in " ".join(process.cmdline())]

    def end(self) -> None:
        """All of them."""
        kill(self.every())
        self._beside = []


def kill(processes: list[psutil.Process]) -> None:
    for process in processes:
        with suppress(psutil.NoSuchProcess):
            process.kill()
    psutil.wait_procs(processes, timeout=10)


def main(folder: Path, kills: int, seed: int) -> None:
    """Print one JSON object: kills by victim, rows lost and doubled, tables that differ, processes that were left."""
    draw, victims, found = random.Random(seed), Counter(), Counter(studies=0, lost=0, doubled=0, other_tables=0, left=0)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "study.toml").write_text(TEXT)
    assert started("slefejax", "study", str(folder / "study.toml"), "--out", str(folder / "reference")).wait() == 0
    while sum(victims.values()) - victims["nobody"] < kills:
        own = folder / f"study {found['studies']}"
        processes = Processes(own, cluster=found["studies"] % 2 == 1)
        kept: set[str] = set()
        for _ in range(8):
            processes.start()
            time.sleep(draw.uniform(2.0, 12.0))
            victims[strike(processes, draw, found)] += 1
            cases = [row["case"] for row in processes.rows()]
            found["lost"] += len(kept - set(cases))
            found["doubled"] += len(cases) - len(set(cases))
            kept = set(cases)
        status = 1
        while status != 0:  # a row whose worker was killed twice is tried again
            processes.start()
            assert processes.client is not None
            status = processes.client.wait()
        processes.end()
        cases = [row["case"] for row in processes.rows()]
        found["lost"] += CASES - len(set(cases))
        found["doubled"] += len(cases) - len(set(cases))
        found["other_tables"] += (own / "table.csv").read_bytes() != (folder / "reference" / "table.csv").read_bytes()
        found["studies"] += 1
        print(json.dumps({"kills": dict(victims), **found}), flush=True)


def strike(processes: Processes, draw: random.Random, found: Counter) -> str:
    """Kill one process, or the client with all that it started."""
    there, client = processes.every(), processes.client
    assert client is not None
    if client.poll() is None and draw.random() < 0.4:
        own = [psutil.Process(client.pid), *psutil.Process(client.pid).children(recursive=True)]
        whole = draw.random() < 0.3
        kill(own if whole else own[:1])
        client.wait()
        found["left"] += len(psutil.wait_procs(own, timeout=30)[1])  # one that has just begun has to import first
        return "tree" if whole else "client"
    if not there:  # it came to its end
        return "nobody"
    victim = draw.choice(there)
    words = " ".join(victim.cmdline())
    kill([victim])
    if victim.pid == client.pid:
        client.wait()
        return "client"
    return "scheduler" if "dask scheduler" in words else "nanny" if "dask worker" in words else "worker"


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
