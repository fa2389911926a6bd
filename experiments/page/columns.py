"""A table as the page holds it: column by column, numbers with all their digits."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np

from slefejax.experiments.tables import Row

MOST_CELLS = 3_000_000  # of a table on a page: 100,000 rows of 30 columns, some 50 MB
_EXACT = 2**53  # a browser's numbers are doubles: larger whole ones are kept as their digits
NUMBER, TEXT = "number", "text"


@dataclass(frozen=True)
class Column:
    """A column's name, and its cells as JSON has them.

    cells : numbers, texts, None for what is missing; of a column of numbers, "NaN", "Infinity", "-Infinity" and the
            digits of whole numbers beyond 2^53 are texts
    kind  : ``NUMBER`` if every cell is one or missing, or ``TEXT``
    """

    name: str
    cells: list[Any]
    kind: str

    @cached_property
    def finite(self) -> np.ndarray:
        """Of a column of numbers those that are finite."""
        numbers = np.array([float(cell) for cell in self.cells if cell is not None and self.kind == NUMBER])
        return numbers[np.isfinite(numbers)] if numbers.size else numbers

    @cached_property
    def different(self) -> int:
        """How many values there are, what is missing left aside."""
        return len({cell for cell in self.cells if cell not in (None, "", "NaN")})


def columns_of_table(rows: Sequence[Row]) -> list[Column]:
    """The columns of the first rows, as many as a page holds; none of an empty table."""
    kept = rows[: kept_rows(rows)]
    return [_column(name, [_plain(row.get(name)) for row in kept]) for name in (rows[0] if rows else ())]


def kept_rows(rows: Sequence[Row]) -> int:
    """How many rows a page holds."""
    return min(len(rows), MOST_CELLS // max(len(rows[0]), 1)) if rows else 0


def _column(name: str, values: list[Any]) -> Column:
    numbers = [value for value in values if isinstance(value, (int, float)) and not isinstance(value, bool)]
    missing = sum(value is None or value == "" for value in values)
    if numbers and len(numbers) + missing == len(values):
        return Column(name, [None if value == "" else _number(value) for value in values], NUMBER)
    return Column(name, [None if value is None else _text(value) for value in values], TEXT)


def _plain(value: Any) -> Any:
    """NumPy's numbers as Python's."""
    return value.item() if isinstance(value, np.generic) else value


def _number(value: Any) -> Any:
    if value is None or (isinstance(value, int) and abs(value) <= _EXACT):
        return value
    if isinstance(value, int):
        return str(value)
    if math.isfinite(value):
        return value
    return "NaN" if math.isnan(value) else "Infinity" if value > 0 else "-Infinity"


def _text(value: Any) -> str:
    return value if isinstance(value, str) else json.dumps(value, default=str, ensure_ascii=False)
