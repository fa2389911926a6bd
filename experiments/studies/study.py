"""A study is a table of cases: each is looked at once, measures fill its columns, a row is kept as it is found."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from slefejax.experiments.report import progress
from slefejax.experiments.store import Row, Run
from slefejax.experiments.studies.measures import Measure

CASE = "case"


@dataclass(frozen=True)
class Case:
    """What a row is of.

    key     : what no other case of the study has, as a number or text: a study that was stopped knows its rows by it
    columns : that say which case it is; the row's first
    look    : draws it, when it is its turn: a ``Look``, or whatever the measures are of
    """

    key: Any
    columns: Row
    look: Callable[[], Any]


@dataclass(frozen=True)
class Study:
    """Cases that are all measured alike.

    picture : the name of the file that is written beside a row, by its case's key: a row without its file is made again
    """

    cases: Sequence[Case]
    measures: Sequence[Measure]
    picture: Callable[[Any], str] | None = None

    @property
    def columns(self) -> tuple[str, ...]:
        """Of every row, in order."""
        return (*self.cases[0].columns, *(name for own in self.measures for name in own.columns))

    def rows(self, run: Run, what: str, show: Callable[..., None] | None = None) -> list[Row]:
        """A row a case; those of an earlier run that was stopped are taken over, if they have the same columns.

        what, show : what the progress bar says, or who hears instead how many rows there are
        """
        if show is None:
            with progress(what, len(self.cases)) as bar:
                return self.rows(run, what, bar)
        by_key = {case.key: case for case in self.cases}

        def row(key: Any) -> Row:
            case = by_key[key]
            look = case.look()
            found = dict(case.columns)
            for own in self.measures:
                found |= own(look)
            return found

        kept = run.each(CASE, list(by_key), row, show, self.picture, (CASE, *self.columns))
        return [{name: own[name] for name in self.columns} for own in kept]


def shown(rows: Sequence[Row]) -> list[Row]:
    """The table: without what is kept in rows and no column of it."""
    return [{name: value for name, value in row.items() if not name.startswith("_")} for row in rows]
