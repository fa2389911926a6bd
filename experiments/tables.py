"""Tables of rows as files: CSV, and Parquet where the extra of that name is installed."""

from __future__ import annotations

import csv
import math
from pathlib import Path
from typing import Any

import numpy as np

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
