"""Which numbers of a run are other ones in a second run of the same command?"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tyro

from slefejax.errors import InputError
from slefejax.experiments.compare.differences import MAY_MOVE, Matched, changes, entries, matched, spread
from slefejax.experiments.compare.finished import Finished, finished
from slefejax.experiments.report import Report
from slefejax.experiments.store import Row, Run

TOLERANCE = 1e-6
_PARTS = ("arguments", "versions", "commit", "machine", "opengl")
_MOST = 6  # names in a note


@dataclass(frozen=True)
class Compare:
    """Two runs of one command side by side: exit status 1 if a count, an error or a row is another one. Times may be.

    Sums of a million numbers in double precision are right to 1e-10, and tables show three digits: a relative change
    of 1e-6 is more than rounding makes, and less than anybody sees. Whole numbers and texts are compared exactly.
    """

    first: tyro.conf.Positional[Path]
    """The folder of a finished run, such as runs/minimality/2026-01-31_12-00-00."""
    second: tyro.conf.Positional[Path]
    """That of another one."""
    tolerance: float = TOLERANCE
    """Relative change of a number that is taken for rounding."""
    out: Path | None = None
    """Folder for a table of all values; nothing is written if not given."""
    json: bool = False
    """Print one JSON object on standard output instead of the table."""

    def run(self) -> Report:
        """Read both, match their rows, and tell what moved."""
        one, other = self._read()
        rows = matched(one.rows, other.rows, one.record.get("case_columns", ()))
        both = [name for name in one.columns if name in other.columns and name not in rows.key]
        steady = [name for name in both if not MAY_MOVE.search(name)]
        if not rows.pairs or not steady:
            raise InputError(
                f"{self.first} and {self.second} have no row of the same case: there is nothing to compare"
            )
        every = changes(rows.pairs, steady, self.tolerance)
        found = [{name: row[name] for name in row if name != "moved"} for row in every if row["moved"]]
        times = spread(rows.pairs, [name for name in both if MAY_MOVE.search(name)])
        notes = (*_missing(one, other, rows), *_elsewhere(one.record, other.record))
        extra = {
            "first": str(self.first),
            "second": str(self.second),
            "matched_by": rows.key,
            "matched_rows": len(rows.pairs),
            "compared": len(every),
            "only_in_first": rows.only[0],
            "only_in_second": rows.only[1],
            "times": times,
        }
        said = f"{len(found)} of {len(every)} values moved" if found else f"none of {len(every)} values moved"
        title = f"{one.record['experiment']}, {len(rows.pairs)} rows: {said} by more than a relative {self.tolerance:g}"
        out = None if self.out is None else self._written(self.out, every, {**extra, "notes": notes})
        status = 1 if found or any(rows.only) else 0
        more = (("Times and memory, which may move: the second over the first", times),)
        return Report(one.record.get("scene"), out, found, title, notes, extra, self.json, status, more)

    def _read(self) -> tuple[Finished, Finished]:
        if not (math.isfinite(self.tolerance) and self.tolerance >= 0):
            raise InputError(f"--tolerance must be a number of at least 0, not {self.tolerance}")
        for folder in (self.first, self.second):
            if not folder.is_dir():
                raise InputError(f"there is no folder {folder}: name the folder of a finished run")
        if self.first.resolve() == self.second.resolve():
            raise InputError(f"{self.first} and {self.second} are the same folder: name another run")
        one, other = finished(self.first), finished(self.second)
        commands = [own.record["experiment"] for own in (one, other)]
        if commands[0] != commands[1]:
            said = f"{self.first} is a run of {commands[0]} and {self.second} one of {commands[1]}"
            raise InputError(f"{said}: only runs of the same command have the same columns")
        return one, other

    def _written(self, out: Path, rows: list[Row], record: Row) -> Path:
        arguments = {"first": str(self.first), "second": str(self.second), "tolerance": self.tolerance}
        with Run("compare", arguments, out) as run:
            return run.finish(rows, record)


def _missing(one: Finished, other: Finished, rows: Matched) -> tuple[str, ...]:
    """Rows and columns that only one of them has, a sentence each."""
    columns = [[name for name in a.columns if name not in b.columns] for a, b in ((one, other), (other, one))]
    kinds = (("row", rows.only), ("column", columns))
    return tuple(
        f"only the {place} has the {what}{'s' * (len(names) > 1)} {_listed(names, '; ')}"
        for what, both in kinds
        for place, names in zip(("first", "second"), both, strict=True)
        if names
    )


def _elsewhere(one: Row, other: Row) -> tuple[str, ...]:
    """What the records say that differs, of the command, the packages and the machine: a sentence a part."""
    found = []
    for part in _PARTS:
        own = [f"{name} {_short(a)} → {_short(b)}".strip() for name, a, b in entries(one.get(part), other.get(part))]
        if own:
            found.append(f"{part}: {_listed(own, ', ')}")
    return tuple(found)


def _listed(names: Sequence[str], between: str) -> str:
    more = f" and {len(names) - _MOST} more" * (len(names) > _MOST)
    return between.join(names[:_MOST]) + more


def _short(value: Any) -> str:
    return "nothing" if value is None else f"{value:g}" if isinstance(value, float) else str(value)
