"""Rows on disk, whole whatever happens while they are written, and tables of them: CSV, and Parquet with its extra."""

from __future__ import annotations

import csv
import fcntl
import json
import math
import os
from pathlib import Path
from typing import Any

import numpy as np

from slefejax.errors import InputError
from slefejax.late import one_at_a_time

Row = dict[str, Any]


def write_tables(folder: Path, name: str, rows: list[Row]) -> None:
    """``NAME.csv`` and, with pyarrow, ``NAME.parquet``, with the keys of the first row as their columns."""
    write_csv(folder / f"{name}.csv", rows)
    write_parquet(folder / f"{name}.parquet", rows)


def write_csv(path: Path, rows: list[Row]) -> None:
    """A table with the keys of the first row as its columns."""
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)


def header(path: Path) -> list[str]:
    """The columns of a table."""
    with path.open(newline="") as file:
        return next(csv.reader(file), [])


def write_parquet(path: Path, rows: list[Row]) -> None:
    """The same with types; nothing without pyarrow (extra ``parquet``).

    A column such as ``share_above_0.5`` has another one beside it whose name is an identifier, ``share_above_05``.
    Numbers that are none are missing; columns of which some are numbers and some are not are text.
    """
    try:
        with one_at_a_time:
            import pyarrow
            from pyarrow import parquet
    except ImportError:
        return
    columns = {}
    for name in rows[0]:
        values = _alike([row.get(name) for row in rows])
        for own in dict.fromkeys((name, name.replace(".", ""))):
            columns[own] = values
    parquet.write_table(pyarrow.table(columns), path)


def _alike(values: list[Any]) -> list[Any]:
    """Of one type: whole numbers, numbers, yes or no, or text; None for a number that is none."""
    values = [value.item() if isinstance(value, np.generic) else value for value in values]
    values = [None if isinstance(value, float) and math.isnan(value) else value for value in values]
    kinds = {type(value) for value in values if value is not None}
    if kinds <= {bool} or kinds <= {int} or kinds <= {str}:
        return values
    if kinds <= {int, float}:
        return [None if value is None else float(value) for value in values]
    return [None if value is None else str(value) for value in values]


def strict(value: Any) -> Any:
    """The same with null for numbers that JSON does not have."""
    if isinstance(value, dict):
        return {key: strict(part) for key, part in value.items()}
    if isinstance(value, (list, tuple)):
        return [strict(part) for part in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


class Rows:
    """A file of rows, to which any number of processes may add."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __call__(self) -> list[Row]:
        """All that are whole; none where there is no file."""
        if not self.path.exists():
            return []
        with self.path.open(errors="replace") as lines:
            return [row for line in lines if (row := _whole(line)) is not None]

    def size(self) -> int:
        """Of the file, in bytes; 0 where there is none."""
        return self.path.stat().st_size if self.path.exists() else 0

    def add(self, *rows: Row) -> None:
        """Keep rows at once, so that they survive whatever happens next."""
        with self.path.open("a+b") as file:
            # a run that was stopped, or whose disk was full, may have left half a line
            torn = file.seek(0, os.SEEK_END) and (file.seek(-1, os.SEEK_END), file.read(1))[1] != b"\n"
            lines = "".join(f"{json.dumps(row)}\n" for row in rows)
            file.write(b"\n" * bool(torn) + lines.encode())
            file.flush()
            os.fsync(file.fileno())


def _whole(line: str) -> Row | None:
    try:
        row = json.loads(line)
    except ValueError:
        return None
    return row if isinstance(row, dict) else None


def locked(folder: Path, name: str) -> int:
    """A folder that is made if it is not there, held by this process until the file descriptor is closed.

    Raises InputError where it cannot be made, and where another process holds it.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
        lock = os.open(folder / name, os.O_CREAT | os.O_RDWR)
    except OSError as error:
        raise InputError(f"the results cannot be written to {folder.parent}: {error.strerror or error}") from None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError:
        os.close(lock)
        raise InputError(f"the same run is under way in another process ({folder}): wait for it") from None
    return lock
