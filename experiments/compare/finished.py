"""The folder of a finished run, read again."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import dataclass
from pathlib import Path

from slefejax.errors import InputError
from slefejax.experiments.store import RECORD, TABLE, Row
from slefejax.io.content import read_bytes


@dataclass(frozen=True)
class Finished:
    """A run's table, numbers as numbers, and its record."""

    folder: Path
    record: Row
    columns: tuple[str, ...]
    rows: list[Row]


def finished(folder: Path) -> Finished:
    """Raises InputError for a folder that no run was finished in, and for files of it that are not whole."""
    record, table = folder / RECORD, folder / TABLE
    missing = [path.name for path in (record, table) if not path.is_file()]
    if missing:
        raise InputError(f"{folder} is not the folder of a finished run: it has no {' and no '.join(missing)}")
    columns, rows = _table(table)
    return Finished(folder, _record(record), columns, rows)


def _record(path: Path) -> Row:
    try:
        found = json.loads(read_bytes(path))
    except (ValueError, RecursionError):
        raise InputError(f"{path} is not whole, or no record of a run: make the run again") from None
    if not isinstance(found, dict) or not isinstance(found.get("experiment"), str):
        raise InputError(f"{path} does not say which command it is of: it is no record of a run")
    return found


def _table(path: Path) -> tuple[tuple[str, ...], list[Row]]:
    try:
        text = read_bytes(path).decode()
        lines = list(csv.reader(io.StringIO(text, newline=""), strict=True))
    except (ValueError, csv.Error):
        raise InputError(f"{path} is not whole, or no table: make the run again") from None
    if len(lines) < 2:
        raise InputError(f"{path} has no rows: make the run again")
    columns = tuple(lines[0])
    if len(set(columns)) < len(columns):
        raise InputError(f"{path} has two columns of the same name")
    for number, line in enumerate(lines[1:], 2):
        if len(line) != len(columns):
            said = f"{path}, row {number} has {len(line)} of {len(columns)} cells"
            raise InputError(f"{said}: the table is not whole, make the run again")
    if not text.endswith("\n"):
        raise InputError(f"{path}, row {len(lines)} does not end: the table is not whole, make the run again")
    return columns, [dict(zip(columns, map(_value, line), strict=True)) for line in lines[1:]]


def _value(text: str) -> int | float | str:
    """Whole numbers stay whole, so that counts are compared exactly."""
    for kind in () if "_" in text else (int, float):  # Python takes 1_000 for a number
        try:
            return kind(text)
        except ValueError:
            continue
    return text
