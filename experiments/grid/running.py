"""A study's cases measured one after the other, and its folder: rows are taken over from there, and kept there."""

from __future__ import annotations

import json
import os
import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict
from functools import cached_property
from pathlib import Path

import numpy as np

from slefejax.errors import InputError, naming
from slefejax.experiments.grid.measured import ALWAYS, MEASURES, TELLING
from slefejax.experiments.grid.plan import Case, Study
from slefejax.experiments.grid.sights import Sights
from slefejax.experiments.options import camera_record
from slefejax.experiments.report import progress
from slefejax.experiments.store import commit, digest, versions, write_results
from slefejax.experiments.tables import Row, Rows, locked

_ROWS, _LOCK = "rows.jsonl", "lock"
REFUSED = "refused"


class Running:
    """A study in a folder.

    Raises InputError for scenes that are missing, and for a folder of something else.
    """

    def __init__(self, study: Study, folder: Path) -> None:
        self.study, self.folder = study, folder.resolve()
        self.sights = Sights(study)
        self.cases = {self._key(case): case for case in study.cases()}
        self._file = Rows(self.folder / _ROWS)
        self._by = digest(json.dumps([versions(), commit()], sort_keys=True).encode())
        self._check_folder()

    def rows(self) -> list[Row]:
        """Measure what is not there yet. A row a case, in the order of the study."""
        with self._held():
            with progress("measuring", len(self.cases)) as show:
                done = self.done
                for key, case in self.cases.items():
                    if not self._is_done(key):
                        show(done, detail=f"{case.scene}, view {case.view}")
                        self._measure(key, case)
                        done += 1
                    show(done)
            self.sights.release()
            found = self.table()
            asked = {**asdict(self.study), "rules": None, "folder": None}
            more = {"scene": list(self.study.scenes), "notes": self.notes, "case_columns": self.case_columns}
            write_results(self.folder, "study", asked, found, more)
        return found

    def table(self) -> list[Row]:
        """The rows that are whole; with a column ``refused`` where some case was."""
        found = [self._row(key, case) for key, case in self.cases.items() if self._is_done(key)]
        refused = any(row[REFUSED] for row in found)
        return found if refused else [{name: row[name] for name in row if name != REFUSED} for row in found]

    @property
    def case_columns(self) -> list[str]:
        """Those that say which case a row is of."""
        return list(self.study.columns(next(iter(self.cases.values())), ""))

    def shown(self, rows: list[Row]) -> tuple[str, ...]:
        """What a terminal shows of them: what the cases differ in, and one column of each measure."""
        differ = [name for name in self.case_columns if len({str(row[name]) for row in rows}) > 1]
        told = [TELLING[name] for name in self.study.measure]
        return (*differ, *told, "triangles", *([REFUSED] if REFUSED in rows[0] else []))

    @property
    def done(self) -> int:
        """How many cases are whole."""
        return sum(map(self._is_done, self.cases))

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know of the table."""
        rows = self._file()
        other = {row["case"] for row in rows} - set(self.cases)
        older = {row["case"] for row in rows if row["by"] != self._by} & set(self.cases)
        refused = [own[REFUSED] for key in self.cases if (own := self._known.get(key, {})).get(REFUSED)]
        found = [f"{len(refused)} of {len(self.cases)} cases were refused; the first: {refused[0]}"] if refused else []
        found += [f"rows of {len(other)} other cases stay in {_ROWS}"] if other else []
        found += [f"{len(older)} cases had rows of another version: they were made again"] if older else []
        return tuple(found)

    def estimate(self) -> list[Row]:
        """A row a scene: cases, how many are there, how many are left, and how many minutes these will take."""
        seconds = defaultdict(list)
        for row in self._file():
            seconds[row["scene"]].append(row["seconds"])
        every = [own for several in seconds.values() for own in several]
        found = []
        for scene in self.study.scenes:
            own = [key for key, case in self.cases.items() if case.scene == scene]
            left = len(own) - sum(map(self._is_done, own))
            each = np.mean(seconds[scene] or every) if every else np.nan
            found.append({"scene": scene, "cases": len(own), "left": left, "minutes": float(left * each / 60.0)})
        return found

    @cached_property
    def _known(self) -> dict[str, Row]:
        """What was measured of each case by this version."""
        found: dict[str, Row] = {}
        for row in self._file():
            if row.get("by") == self._by:
                found.setdefault(row["case"], {}).update(row)
        return found

    def _is_done(self, key: str) -> bool:
        own = self._known.get(key)
        return own is not None and (bool(own.get(REFUSED)) or not self._missing(own))

    def _missing(self, own: Row) -> list[str]:
        return [name for name in self.study.measure if not set(MEASURES[name].columns) <= set(own)]

    def _measure(self, key: str, case: Case) -> None:
        missing, start = self._missing(self._known.get(key, {})), time.perf_counter()
        row: Row = {"case": key, "by": self._by, "scene": case.scene, REFUSED: ""}
        try:
            with naming(f"scene {case.scene!r}"):
                look = self.sights.of(case)
                for own in (ALWAYS, *(MEASURES[name] for name in missing)):
                    row |= own(look)
        except InputError as error:
            row[REFUSED] = str(error)
        row["seconds"] = time.perf_counter() - start
        self._file.add(row)
        self._known.setdefault(key, {}).update(row)

    def _row(self, key: str, case: Case) -> Row:
        names = [*ALWAYS.columns, *(column for name in self.study.measure for column in MEASURES[name].columns)]
        known = self._known[key]
        own = {name: known.get(name, np.nan) for name in dict.fromkeys(names)}
        return {**self.study.columns(case, self.sights.name(case)), **own, REFUSED: known[REFUSED]}

    def _key(self, case: Case) -> str:
        """What no other case has, whatever else the study asks."""
        rule, view = self.study.rules[case.rule], self.sights.view(case)
        asked = [self.sights.content(case), case.scheme, camera_record(view), rule.name, rule.settings]
        asked += [*case[3:6], *case[7:]]
        return digest(json.dumps(asked, sort_keys=True, default=str).encode())

    def _check_folder(self) -> None:
        if not self.folder.exists():
            return
        if not self.folder.is_dir() or (any(self.folder.iterdir()) and not self._file.path.exists()):
            raise InputError(f"{self.folder.name} exists and is no study's folder: name another one, nothing is lost")
        there = {row.get("case") for row in self._file()}
        if there and not there & set(self.cases):
            raise InputError(
                f"{self.folder.name} holds another study, of {len(there)} cases that are none of these: name another"
                " folder"
            )

    @contextmanager
    def _held(self) -> Iterator[None]:
        lock = locked(self.folder, _LOCK)
        try:
            self._file.path.touch()
            yield
        finally:
            os.close(lock)
