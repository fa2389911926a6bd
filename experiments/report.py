"""What a command shows: a table in the terminal, or one JSON object."""

from __future__ import annotations

import json
import re
import shutil
import sys
import textwrap
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from contextvars import ContextVar
from dataclasses import dataclass, field
from pathlib import Path

from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

from slefejax.experiments.store import PAGE, TABLE, open_first
from slefejax.experiments.tables import Row, header, strict
from slefejax.experiments.terminal import MOST_ROWS, cut, fitted, heading


@dataclass(frozen=True)
class Report:
    """The outcome of a command: the scene's name, or a list of names, the run's folder, and the table.

    status : the exit status;  extra : more entries of the JSON object
    more   : further tables, (title, rows), shown below the first
    shown  : of the first, the columns that the terminal shows; all if there are none
    """

    scene: str | list[str] | None
    out: Path | None
    rows: list[Row]
    title: str
    notes: tuple[str, ...] = ()
    extra: Row = field(default_factory=dict)
    as_json: bool = False
    status: int = 0
    more: tuple[tuple[str, list[Row]], ...] = ()
    shown: tuple[str, ...] = ()

    def print(self) -> None:
        """To standard output, at once."""
        sys.stdout.write(self._json() if self.as_json else self._text())

    def _json(self) -> str:
        out = None if self.out is None else str(self.out)
        content = {"scene": self.scene, "out": out, "notes": list(self.notes), **self.extra, "rows": self.rows}
        return json.dumps(strict(content), allow_nan=False) + "\n"

    def _text(self) -> str:
        notes = [_wrapped(f"Note: {note}") for note in self.notes]
        lines = [*notes, *self._table(self.title, self.rows, self.shown)]
        if len(self.rows) > MOST_ROWS:
            where = "with --json" if self.out is None else f"in {TABLE}"
            lines.append(f"… and {len(self.rows) - MOST_ROWS:,} more rows {where}")
        for title, rows in self.more:
            apart = [] if not lines or lines[-1].endswith("\n") else [""]
            lines += [*apart, *self._table(title, rows)] if rows else []
        if self.out is not None:
            first = open_first(self.out).name
            lines += [f"{PAGE} has the table, charts and all pictures, for a browser"] * (first != PAGE)
            lines.append(f"Results are in {self.out}: open {first} first")
        return "".join(f"{line}\n" for line in lines)

    def _table(self, title: str, rows: Sequence[Row], shown: Sequence[str] = ()) -> Iterator[str]:
        """The title, with settings that are the same in every row; the table; which columns are somewhere else."""
        if not rows:
            yield from [_wrapped(title)] * bool(title)
            return
        table = fitted([{name: row[name] for name in shown or row} for row in rows], columns())
        settings = [f"{name} {value}" for name, value in table.everywhere.items() if not _named(title, name, value)]
        title = "; ".join(own for own in (title, ", ".join(settings)) if own)
        yield from [_wrapped(title)] * bool(title)
        yield f"\n{table.text}\n"
        left_out = (*table.left_out, *(name for name in rows[0] if shown and name not in shown))
        if left_out:
            yield self._elsewhere(left_out)

    def _elsewhere(self, names: Sequence[str]) -> str:
        """What there was no room for, in one line."""
        kept = [] if self.out is None else header(self.out / TABLE)
        where = f"Only in {TABLE}" if set(names) <= set(kept) else "No room for"
        line = ""
        for count in range(len(names), 0, -1):
            more = f" and {len(names) - count} more" * (count < len(names))
            line = f"{where}: {', '.join(map(heading, names[:count]))}{more}"
            if len(line) <= columns():
                break
        return line


def columns() -> int:
    """How many the terminal has that the table is shown in, or COLUMNS says; 80 where there is none."""
    return shutil.get_terminal_size((80, 24)).columns


def _wrapped(sentence: str) -> str:
    """Between words, in a terminal; whoever reads a pipe looks for sentences in one line."""
    if not sys.stdout.isatty():
        return sentence
    return textwrap.fill(sentence, columns(), break_long_words=False, break_on_hyphens=False)


def _named(title: str, name: str, value: str) -> bool:
    """Whether a title says already that something has that value: a number beside its name, or a name by itself."""
    if re.search(r"\d", value[:1]):
        return f"{name} {value}" in title or f"{value} {name}" in title
    return value in title


Show = Callable[..., None]
Task = Callable[[str, int], AbstractContextManager[Show]]
_TASK: ContextVar[Task | None] = ContextVar("task", default=None)


@contextmanager
def working(command: str) -> Iterator[None]:
    """Within, a terminal shows what is under way from the first moment on, while programs compile, too."""
    with _displayed(f"{command}: preparing", f"{command}: writing results") as task:
        outer = _TASK.set(task)
        try:
            yield
        finally:
            _TASK.reset(outer)


@contextmanager
def progress(what: str, total: int) -> Iterator[Show]:
    """A bar on standard error; where that is no terminal, a line every few seconds.

    The function that is given hears how much is done, or, as ``detail``, what is being done.
    """
    task = _TASK.get()
    with nullcontext(task) if task else _displayed() as own, own(what, total) as show:
        yield show


def _displayed(before: str = "", after: str = "") -> AbstractContextManager[Task]:
    """What shows tasks. Before the first of them, and after each, a terminal shows other words, if they are given."""
    return _bars(before, after) if sys.stderr.isatty() else nullcontext(_lines)


_WORDS = 36  # cells beside a bar: the line has room in a terminal of 80 columns


@contextmanager
def _bars(before: str, after: str) -> Iterator[Task]:
    """In a terminal: one line, which is gone when everything is done."""
    parts = (TextColumn("{task.description}"), BarColumn(20), TextColumn("{task.fields[count]}"), TimeElapsedColumn())
    with Progress(*parts, console=Console(stderr=True), transient=True, refresh_per_second=4) as bars:
        outer = bars.add_task(before, total=None, count="", visible=bool(before))

        @contextmanager
        def task(what: str, total: int) -> Iterator[Show]:
            bars.update(outer, visible=False, description=after)
            own = bars.add_task(what, total=total, count=f"0 of {total}")

            def show(done: int | None = None, detail: str = "") -> None:
                count = {} if done is None else {"completed": done, "count": f"{done} of {total}"}
                bars.update(own, description=cut(f"{what} {detail}".strip(), _WORDS), **count)

            try:
                yield show
            finally:
                bars.remove_task(own)
                bars.update(outer, visible=bool(after))

        yield task


_BETWEEN = 3.0  # seconds, from one line to the next at least, which says that another tenth is done
_QUIET = 20.0  # seconds after which a line says that nothing changed


@contextmanager
def _lines(what: str, total: int) -> Iterator[Show]:
    """Where there is no terminal: plain lines, few of them; none about what is done at once."""
    lines, done = _Lines(what, total), threading.Event()

    def wait() -> None:
        while not done.wait(1.0):
            lines.tick()

    waiting = threading.Thread(target=wait, daemon=True)
    waiting.start()
    try:
        yield lines.show
    finally:
        done.set()
        waiting.join()


class _Lines:
    """When a line is due, and what it says."""

    def __init__(self, what: str, total: int) -> None:
        self._what, self._total, self._detail = what, total, ""
        self._done = self._tenths = 0
        self._start = self._last = time.monotonic()
        self._lock = threading.Lock()

    def show(self, done: int | None = None, detail: str = "") -> None:
        """Hears how much is done."""
        self._done, self._detail = self._done if done is None else done, detail
        self.tick()

    def tick(self) -> None:
        """Hears that time went by."""
        with self._lock:
            now, tenths = time.monotonic(), 10 * self._done // max(self._total, 1)
            since = now - self._last
            if since >= _QUIET or (since >= _BETWEEN and tenths > self._tenths):
                self._last, self._tenths = now, tenths
                self._say(f"{int(now - self._start) // 60}:{int(now - self._start) % 60:02d}")

    def _say(self, elapsed: str) -> None:
        what = f"{self._what} {self._detail}".strip()
        with suppress(OSError, ValueError):  # nobody reads it any more
            print(f"{what}: {self._done} of {self._total}, {elapsed}", file=sys.stderr, flush=True)
