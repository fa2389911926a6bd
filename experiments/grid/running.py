"""A study's cases measured, and its folder: rows are taken over from there, and kept there."""

from __future__ import annotations

import json
import os
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from slefejax.errors import InputError
from slefejax.experiments.grid.crew import Crew
from slefejax.experiments.grid.measured import ALWAYS, MEASURES, TELLING
from slefejax.experiments.grid.plan import Case, Study
from slefejax.experiments.grid.scenes import Scenes
from slefejax.experiments.grid.sights import FAILED, REFUSED, Asked
from slefejax.experiments.report import progress
from slefejax.experiments.store import commit, digest, versions, write_results
from slefejax.experiments.tables import Row, Rows, locked

_ROWS, _LOCK = "rows.jsonl", "lock"
_ALWAYS = {"case", "by", "scene", "seconds"}  # what every row on disk has


@dataclass
class _Found:
    """What a study's folder has.

    size    : of the file of rows, bytes;  known : what was measured of each case by this version
    others  : cases of which there are rows and the study has none;  older : cases with rows of another version
    seconds : that rows took, by the scene
    """

    size: int
    known: dict[str, Row] = field(default_factory=dict)
    others: set[str] = field(default_factory=set)
    older: set[str] = field(default_factory=set)
    seconds: dict[str, list[float]] = field(default_factory=dict)


class Running:
    """A study in a folder.

    Raises InputError for scenes that are missing, and for a folder of something else.
    """

    def __init__(self, study: Study, folder: Path, crew: Crew | None = None) -> None:
        self.study, self.folder, self.crew = study, folder.resolve(), crew or Crew()
        self.scenes = Scenes(study)
        self.failed: dict[str, Row] = {}
        self._told: tuple[str, ...] = ()
        self.cases = {self._key(case): case for case in study.cases()}
        self._file = Rows(self.folder / _ROWS)
        self._by = digest(json.dumps([versions(), commit()], sort_keys=True).encode())
        self._found = self._read()
        self._check_folder()

    def rows(self) -> list[Row]:
        """Measure what is not there yet. A row a case, in the order of the study."""
        # workers first: nothing is written where there are none
        with (self.crew if self._left() else Crew()).opened(self.scenes) as work, self._held():
            left = self._left()
            with progress("measuring", len(self.cases)) as show:
                done = len(self.cases) - len(left)
                show(done)
                for rows in work.rows(left, lambda detail: show(detail=detail)):
                    self._keep(rows)
                    done += len(rows)
                    show(done)
            self._told = work.notes
            found = self.table()
            asked = {**asdict(self.study), "rules": None, "folder": None}
            more = {"scene": list(self.study.scenes), "notes": self.notes, "case_columns": self.case_columns}
            write_results(self.folder, "study", asked, found, more)
        return found

    def table(self) -> list[Row]:
        """The rows that are whole; with a column ``refused`` where some case was."""
        every = self.cases.items()
        found = [self._row(key, case) for key, case in every if self._is_done(key) or key in self.failed]
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
    def notes(self) -> tuple[str, ...]:
        """What to know of the table."""
        other, older = self._found.others, self._found.older
        refused = [own[REFUSED] for key in self.cases if (own := self._found.known.get(key, {})).get(REFUSED)]
        found = [f"{len(refused)} of {len(self.cases)} cases were refused; the first: {refused[0]}"] if refused else []
        found += [f"rows of {len(other)} other cases stay in {_ROWS}"] if other else []
        found += [f"{len(older)} cases had rows of another version: they were made again"] if older else []
        if self.failed:
            first = next(iter(self.failed.values()))[REFUSED]
            found.append(f"{len(self.failed)} cases failed, and the same command tries them again; the first: {first}")
        return (*found, *self._told)

    def estimate(self) -> list[Row]:
        """A row a scene: cases, how many are there, how many are left, and how many minutes these will take."""
        seconds = self._found.seconds
        every = [own for several in seconds.values() for own in several]
        found = []
        for scene in self.study.scenes:
            own = [key for key, case in self.cases.items() if case.scene == scene]
            left = len(own) - sum(map(self._is_done, own))
            each = np.mean(seconds.get(scene, every)) / self.crew.hands if every else np.nan
            found.append(
                {
                    "scene": scene,
                    "cases": len(own),
                    "left": left,
                    "minutes": float(left * each / 60.0),
                }
            )
        return found

    def _read(self) -> _Found:
        """What there is on disk, read once: there may be a million rows."""
        found = _Found(self._file.size())
        for row in self._file():
            if not row.keys() >= _ALWAYS:
                raise InputError(f"{self.folder.name} has rows that are no study's in {_ROWS}: name another folder")
            key = row["case"]
            found.seconds.setdefault(row["scene"], []).append(row["seconds"])
            if key not in self.cases:
                found.others.add(key)
            elif row["by"] != self._by:
                found.older.add(key)
            else:
                found.known.setdefault(key, {}).update(row)
        return found

    def _is_done(self, key: str) -> bool:
        own = self._found.known.get(key)
        return own is not None and (bool(own.get(REFUSED)) or not self._missing(own))

    def _missing(self, own: Row) -> list[str]:
        return [name for name in self.study.measure if not all(map(own.__contains__, MEASURES[name].columns))]

    def _left(self) -> list[Asked]:
        """What is not there yet."""
        left = [key for key in self.cases if not self._is_done(key)]
        return [Asked(key, self.cases[key], tuple(self._missing(self._found.known.get(key, {})))) for key in left]

    def _keep(self, rows: list[Row]) -> None:
        """On disk, all but those that failed: these are tried again by whoever goes on."""
        self.failed |= {row["case"]: row for row in rows if FAILED in row}
        whole = [row | {"by": self._by} for row in rows if FAILED not in row]
        self._file.add(*whole)
        for row in whole:
            self._found.known.setdefault(row["case"], {}).update(row)

    def _row(self, key: str, case: Case) -> Row:
        names = [*ALWAYS.columns, *(column for name in self.study.measure for column in MEASURES[name].columns)]
        known = self._found.known.get(key, {}) | self.failed.get(key, {})
        own = {name: known.get(name, np.nan) for name in dict.fromkeys(names)}
        return {**self.study.columns(case, self.scenes.name(case)), **own, REFUSED: known[REFUSED]}

    def _key(self, case: Case) -> str:
        """What no other case has, whatever else the study asks."""
        rule, scenes = self.study.rules[case.rule], self.scenes
        asked = [scenes.content(case), case.scheme, scenes.camera(case), rule.name, rule.settings]
        asked += [*case[3:6], *case[7:]]
        return digest(json.dumps(asked, sort_keys=True, default=str).encode())

    def _check_folder(self) -> None:
        if not self.folder.exists():
            return
        if not self.folder.is_dir() or (any(self.folder.iterdir()) and not self._file.path.exists()):
            raise InputError(f"{self.folder.name} exists and is no study's folder: name another one, nothing is lost")
        found = self._found
        if found.others and not found.older and not found.known:
            raise InputError(
                f"{self.folder.name} holds another study, of {len(found.others)} cases that are none of these: name"
                " another folder"
            )

    @contextmanager
    def _held(self) -> Iterator[None]:
        lock = locked(self.folder, _LOCK)
        try:
            self._file.path.touch()
            if self._file.size() != self._found.size:  # somebody was here in between
                self._found = self._read()
            yield
        finally:
            os.close(lock)
