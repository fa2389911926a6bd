"""What a command shows: a table in the terminal, or one JSON object."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from rich import box
from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

WIDTH = 110  # where standard output is not a terminal
MOST_ROWS = 60
HEADINGS = {
    "share_above_0.1": "> 0.1 px",
    "share_above_0.5": "> 0.5 px",
    "share_above_1": "> 1 px",
    "covered_pixels": "pixels",
    "max_error_px": "largest px",
    "predict_ms": "predict ms",
    "render_ms": "render ms",
}


@dataclass(frozen=True)
class Report:
    """The outcome of a command: the scene's name, the run's folder, and the table."""

    scene: str
    out: Path
    rows: list[dict[str, Any]]
    title: str
    notes: tuple[str, ...] = ()
    extra: dict[str, Any] = field(default_factory=dict)

    def print(self, as_json: bool) -> None:
        """To standard output."""
        if as_json:
            print(json.dumps({"scene": self.scene, "out": str(self.out), **self.extra, "rows": self.rows}))
            return
        console = Console(highlight=False, width=None if sys.stdout.isatty() else WIDTH)
        for note in self.notes:
            console.print(f"Note: {note}")
        console.print(_table(self.title, self.rows))
        if len(self.rows) > MOST_ROWS:
            console.print(f"… and {len(self.rows) - MOST_ROWS:,} more rows in the table file")
        print(f"Results are in {self.out}")


def _table(title: str, rows: list[dict[str, Any]]) -> Table:
    """The first rows; what is the same in all of them stands once, below. A single row is shown as a column."""
    if len(rows) == 1:
        table = Table("", "", title=title, title_justify="left", box=box.SIMPLE_HEAD, show_header=False)
        for name, value in rows[0].items():
            table.add_row(_heading(name), _text(name, value))
        return table
    constant = {name: value for name, value in rows[0].items() if all(row[name] == value for row in rows)}
    columns = [name for name in rows[0] if name not in constant]
    shared = ", ".join(f"{_heading(name)} {_text(name, value)}" for name, value in constant.items())
    caption = f"in every row: {shared}" if shared else None
    table = Table(title=title, caption=caption, title_justify="left", caption_justify="left", box=box.SIMPLE_HEAD)
    for name in columns:
        table.add_column(_heading(name), justify="right", no_wrap=True)
    for row in rows[:MOST_ROWS]:
        table.add_row(*[_text(name, row[name]) for name in columns])
    return table


def _heading(name: str) -> str:
    return HEADINGS.get(name, name.replace("_", " "))


def _text(name: str, value: Any) -> str:
    if name.startswith("share_"):
        return f"{100 * value:.2f} %"
    if isinstance(value, float):
        return (
            f"{value:.3g}"
            if name == "scale"
            else f"{value:.3f}"
            if name.endswith(("_px", "factor"))
            else f"{value:.2f}"
        )
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    return str(value)


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[[int], None]]:
    """A progress bar on standard error; the function that is given hears how much is done."""
    columns = (TextColumn(what), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task(what, total=total)
        yield lambda done: bar.update(task, completed=done)
