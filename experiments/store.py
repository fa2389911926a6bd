"""The folder of a run: rows as they are found, then a table, a record and pictures, in place all at once.

While it works, a run writes into a hidden folder beside its final place, named after what was asked for and of what. A
run that is stopped leaves it there, at whatever moment; asking for the same again takes its rows over and goes on. Only
a finished run is put into place, and its rows are forgotten after that.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import shlex
import shutil
import subprocess
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from contextvars import ContextVar
from datetime import datetime
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from slefejax.errors import InputError
from slefejax.experiments.tables import Row, Rows, locked, strict, write_tables
from slefejax.figures.page import Page, Pages

PACKAGES = ("slefejax", "jax", "jaxlib", "numpy", "scipy", "scikit-image", "trimesh", "moderngl", "matplotlib")
_COLUMNS = 4  # grows when rows get other columns, or other meanings: what was stopped before is not gone on with


class Run:
    """One run of an experiment. Nothing is written before the first row or file.

    arguments : what was asked for
    inputs    : what it was asked of, besides: contents of files (``digest``), the device
    out       : the folder for the results, or None for runs/EXPERIMENT/TIME
    pages     : what its figures have in common
    """

    def __init__(
        self, experiment: str, arguments: Row, out: Path | None, inputs: Row | None = None, pages: Pages | None = None
    ) -> None:
        self.experiment, self.arguments = experiment, arguments
        self._pages, self._first = pages or Pages(), PAGE
        self._out = out.resolve() if out else None
        self.parent = self._out.parent if self._out else Path("runs") / experiment
        asked = [experiment, arguments, inputs, str(self._out), versions(), commit(), _COLUMNS]
        asked += [self._pages.format]
        text = json.dumps(asked, sort_keys=True, default=str)
        self.work = self.parent / f".{experiment}-{digest(text.encode())}.partial"
        self._rows = Rows(self.work / _ROWS)
        if (
            self._out
            and self._out.exists()
            and not (self._out.is_dir() and all(map(self._is_own, self._out.iterdir())))
        ):
            raise InputError(f"--out {out} exists and is not an empty folder: name another one, nothing is overwritten")
        self._lock: int | None = None

    def __enter__(self) -> Run:
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """A run that turned out to be impossible before its first row leaves nothing behind."""
        if kind is not None and issubclass(kind, InputError) and self._lock is not None and not self.rows():
            shutil.rmtree(self.work, ignore_errors=True)
            for folder in () if self._out else (self.parent, self.parent.parent):
                with suppress(OSError):  # it holds other runs
                    folder.rmdir()
        if self._lock is not None:
            os.close(self._lock)
            self._lock = None

    def file(self, name: str) -> Path:
        """Where a file of this run is written."""
        self._make_folder()
        return self.work / name

    def figure(self, name: str) -> Page:
        """Where a figure of this run is written. The first that is asked for is what to open first, else the page."""
        self._make_folder()
        page = self._pages.page(self.work, name)
        self._first = page.path.name if self._first == PAGE else self._first
        return page

    def _is_own(self, file: Path) -> bool:
        """Whether a file in the folder that was named is there because this run was stopped while it put it there."""
        beside = self.work / file.name
        return beside.exists() and beside.samefile(file)

    def rows(self) -> list[Row]:
        """Rows found so far, those of an earlier, stopped run of the same included."""
        return self._rows()

    def add(self, row: Row) -> None:
        """Keep a row at once, so that it survives whatever happens next."""
        self._make_folder()
        self._rows.add(row)

    def each(
        self,
        key: str,
        values: list[Any],
        make_row: Callable[[Any], Row],
        progress: Callable[[int], None],
        picture: Callable[[Any], str] | None = None,
        columns: tuple[str, ...] | None = None,
    ) -> list[Row]:
        """A row for each value, those of an earlier run taken over; ``progress`` hears how many there are.

        picture : the name of the file that ``make_row`` writes beside its row; a row without it is made again
        columns : a row with others is made again, too
        """
        found = {row[key]: row for row in self.rows() if columns is None or tuple(row) == columns}
        found = {value: row for value, row in found.items() if not picture or (self.work / picture(value)).exists()}
        for value in values:
            if value not in found:
                found[value] = {key: value, **make_row(value)}
                self.add(found[value])
            progress(len(found))
        return [found[value] for value in values]

    def finish(self, rows: list[Row], record: Row) -> Path:
        """Write the table, the record and the page, and put the run's folder into place. Returns the folder."""
        self._make_folder()
        write_results(self.work, self.experiment, self.arguments, rows, record, self._first)
        place = self._into_place()
        for name in (_ROWS, _LOCK):
            (place / name).unlink(missing_ok=True)
        return place

    def _into_place(self) -> Path:
        if self._out is None:
            return self.work.rename(self._free_place())
        if not self._out.exists():
            return self.work.rename(self._out)
        # the folder that was named may be somebody's current one: it stays, and the record comes last
        for file in sorted(self.work.iterdir(), key=lambda path: path.name == RECORD):
            if file.name not in (_ROWS, _LOCK) and not (self._out / file.name).exists():
                os.link(file, self._out / file.name)
        shutil.rmtree(self.work)
        return self._out

    def _free_place(self) -> Path:
        stamp = datetime.now().strftime("%Y-%m-%d_%H-%M-%S")
        place, number = self.parent / stamp, 1
        while place.exists():
            number += 1
            place = self.parent / f"{stamp}_{number}"
        return place

    def _make_folder(self) -> None:
        if self._lock is None:
            self._lock = locked(self.work, _LOCK)


_LOCK, _ROWS = "lock", "rows.jsonl"
RECORD, TABLE, PAGE = "run.json", "table.csv", "report.html"


def write_results(folder: Path, experiment: str, arguments: Row, rows: list[Row], more: Row, first: str = PAGE) -> None:
    """The table; what was asked for, by what, where and when; and the page that shows both, and the folder's pictures.

    first : the file to open first
    """
    from slefejax.experiments.page.writing import write_page  # not before there is something to write

    write_tables(folder, "table", rows)
    content = {
        "experiment": experiment,
        "open_first": first,
        "command": _COMMAND.get(),
        "arguments": arguments,
        "time": datetime.now().astimezone().isoformat(timespec="seconds"),
        "versions": versions(),
        "commit": commit(),
        "machine": machine(),
        **more,
    }
    (folder / RECORD).write_text(json.dumps(strict(content), indent=2, default=str, allow_nan=False) + "\n")
    write_page(folder, PAGE, content, rows, TABLE)


_COMMAND: ContextVar[str | None] = ContextVar("command", default=None)


@contextmanager
def typed(words: Sequence[str]) -> Iterator[None]:
    """Within, runs are those of a command that was typed: their records say what to type for the same again."""
    outer = _COMMAND.set(shlex.join(["slefejax", *_without_folder(words)]))
    try:
        yield
    finally:
        _COMMAND.reset(outer)


def _without_folder(words: Sequence[str]) -> Iterator[str]:
    """Without ``--out FOLDER``: nothing is overwritten, and the same again needs another one."""
    rest = iter(words)
    for word in rest:
        if word == "--out":
            next(rest, None)
        elif not word.startswith("--out="):
            yield word


def open_first(folder: Path) -> Path:
    """The file of a finished run that says the most."""
    return folder / json.loads((folder / RECORD).read_text())["open_first"]


def digest(content: bytes) -> str:
    """A short name for some content."""
    return hashlib.sha256(content).hexdigest()[:12]


def machine() -> dict[str, Any]:
    """What this one is."""
    return {"system": platform.platform(), "processor": platform.machine(), "cores": os.cpu_count()}


def versions() -> dict[str, str]:
    """Of Python and of the packages that numbers depend on."""
    found = {"python": platform.python_version()}
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            found[name] = "not installed"
    return found


def commit() -> str | None:
    """The commit of the checkout that this code runs from, if it is one."""
    here = Path(__file__).resolve().parent
    if not (here.parent / ".git").exists():
        return None
    command = ["git", "-C", str(here), "describe", "--always", "--dirty", "--abbrev=40"]
    try:
        return subprocess.run(command, capture_output=True, text=True, timeout=10, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return None
