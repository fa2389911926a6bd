"""``python -m tests.killed_at_once FOLDER KILLS SEED``: a study of instant rows, killed so often, and what is left.

Every run is a fork of this process that begins with the study's folder as it is, and is killed at a random byte.
After half of the kills the last line of the rows is cut at a random byte, as a machine that loses its power leaves it.
"""

from __future__ import annotations

import json
import os
import random
import signal
import sys
import time
from contextlib import suppress
from pathlib import Path

from slefejax import Study
from slefejax.experiments.grid.running import Running
from slefejax.experiments.grid.sights import REFUSED, Sights
from slefejax.experiments.tables import Row, Rows

CASES = 500
STUDY = Study(("twisted-quad",), {"size": [64, 40]}, tuple(0.1 + 0.01 * k for k in range(CASES)), measure=("domain",))


def instant(self: Sights, asked, scene, view) -> Row:
    """A row of made-up numbers, those of the case."""
    row = {"case": asked.key, "scene": asked.case.scene, REFUSED: "", "patches": 1, "triangles": 2}
    return row | {"sup_error_px": asked.case.pixels / 3, "seconds": 0.0}


def run_and_be_killed(folder: Path, more: int) -> None:
    """One start of the study, and its end as soon as there are so many bytes more."""
    path = folder / "rows.jsonl"
    size = Rows(path).size()
    child = os.fork()
    if child == 0:
        Running(STUDY, folder).rows()
        os._exit(0)
    while Rows(path).size() < size + more and os.waitpid(child, os.WNOHANG) == (0, 0):
        time.sleep(0.0005)
    with suppress(ProcessLookupError, ChildProcessError):
        os.kill(child, signal.SIGKILL)
        os.waitpid(child, 0)


def cut(path: Path, draw: random.Random) -> None:
    """The last line, at a byte."""
    content = path.read_bytes() if path.exists() else b""
    last = content.rstrip(b"\n").rfind(b"\n") + 1
    if content and draw.random() < 0.5:
        os.truncate(path, draw.randint(last, len(content)))


def main(folder: Path, kills: int, seed: int) -> None:
    """Print one JSON object: kills, how many of them came between two rows, studies that came to their end, rows lost
    and doubled, tables that differ.
    """
    Sights.row = instant  # type: ignore[method-assign]
    draw, found = (
        random.Random(seed),
        {"kills": 0, "within": 0, "studies": 0, "lost": 0, "doubled": 0, "other_tables": 0},
    )
    Running(STUDY, folder / "reference").rows()
    reference = (folder / "reference" / "table.csv").read_bytes()
    while found["kills"] < kills:
        own = folder / f"study {found['studies']}"
        rows = Rows(own / "rows.jsonl")
        for _ in range(min(12, kills - found["kills"])):
            before = {row["case"] for row in rows()}
            run_and_be_killed(own, draw.randint(0, 9000))
            after = [row["case"] for row in rows()]
            found["kills"] += 1
            found["within"] += len(before) < len(after) < CASES
            found["lost"] += len(before - set(after))
            found["doubled"] += len(after) - len(set(after))
            cut(rows.path, draw)
        Running(STUDY, own).rows()
        cases = [row["case"] for row in rows()]
        found["doubled"] += len(cases) - len(set(cases))
        found["lost"] += CASES - len(set(cases))
        found["other_tables"] += (own / "table.csv").read_bytes() != reference
        found["studies"] += 1
    print(json.dumps(found))


if __name__ == "__main__":
    main(Path(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
