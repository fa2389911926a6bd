"""Two tables of the same columns: which rows are of the same case, and which of their values are other ones."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import count
from typing import Any

from slefejax.experiments.store import Row

ALWAYS = (
    *("scene", "camera", "view", "scale", "frame", "patch", "budget", "case", "look", "stage", "count", "family"),
    *("parameter", "value", "curve", "kind", "name", "change"),
)
"""Columns that say which case a row is of, whatever they hold."""
SOMETIMES = ("segments", "degree", "depth", "level", "condition", "cores", "tolerance", "distance")
"""Numbers that do where the columns before them do not tell all rows apart, as any text does."""
MAY_MOVE = re.compile(r"(_ms|_s|_seconds|_mb)$|^(us_.*|seconds|frames_per_second|peer_ratio|runs)$")
"""Columns of time and memory, and what is computed of them: they are other ones in every run."""
RESIDUE = 1e-12
"""What rounding leaves of a zero, of numbers of about one such as pixels and shares: no difference."""
Key = tuple[Any, ...]


@dataclass(frozen=True)
class Matched:
    """Rows of the same case, in both tables.

    key   : the columns that say so
    pairs : case, row of the first table, row of the second
    only  : cases that one table has, and the other has not: of the first, of the second
    """

    key: tuple[str, ...]
    pairs: list[tuple[str, Row, Row]]
    only: tuple[list[str], list[str]]


def matched(first: Sequence[Row], second: Sequence[Row], told: Sequence[str] = ()) -> Matched:
    """Rows by their cases. Rows that nothing tells apart are matched in their order.

    told : the columns that say which case a row is of, where the run's record has them
    """
    names = tuple(name for name in told if name in first[0] and name in second[0]) or key_of(first, second)
    one, other = _by_case(first, names), _by_case(second, names)
    pairs = [(_said(names, key), row, other[key]) for key, row in one.items() if key in other]
    only = [[_said(names, key) for key in own if key not in rest] for own, rest in ((one, other), (other, one))]
    return Matched(names, pairs, (only[0], only[1]))


def key_of(first: Sequence[Row], second: Sequence[Row]) -> tuple[str, ...]:
    """The columns that say which case a row is of: as few as tell the rows of each table apart.

    >>> rows = [{"scale": 1.0, "method": "slefe", "triangles": 8}, {"scale": 0.5, "method": "slefe", "triangles": 2}]
    >>> key_of(rows, rows)
    ('scale',)
    """
    common = [name for name in first[0] if name in second[0]]
    chosen = {name for name in common if name in ALWAYS}

    def different() -> list[int]:
        own = [name for name in common if name in chosen]
        return [len({tuple(map(_comparable, map(row.get, own))) for row in rows}) for rows in (first, second)]

    for name in common:
        before = different()
        if before == [len(first), len(second)]:
            break
        words = any(isinstance(row[name], str) for row in (*first, *second))
        if name not in chosen and not MAY_MOVE.search(name) and (words or name in SOMETIMES):
            chosen.add(name)
            if different() == before:
                chosen.discard(name)
    return tuple(name for name in common if name in chosen)


def changes(pairs: Sequence[tuple[str, Row, Row]], names: Sequence[str], tolerance: float) -> list[Row]:
    """A row for each value: what it was and is, whether it moved. The largest relative change first, texts before."""
    found = [
        {"case": case, "column": name, **_change(a, b), "moved": differ(a, b, tolerance)}
        for case, one, other in pairs
        for name, a, b in ((name, one[name], other[name]) for name in names)
    ]
    return sorted(found, key=lambda row: (not row["moved"], -_size(row["relative_percent"])))


def differ(one: Any, other: Any, tolerance: float) -> bool:
    """Whether two values are not the same: whole numbers and texts exactly, others to within rounding.

    >>> differ(20207, 20208, 1e-3), differ(0.5, 0.5000001, 1e-6), differ(0.5, 0.6, 1e-6)
    (True, False, True)
    """
    whole = isinstance(one, int) and isinstance(other, int)
    if whole or isinstance(one, str) or isinstance(other, str):
        return one != other
    if not (math.isfinite(one) and math.isfinite(other)):
        return _comparable(one) != _comparable(other)
    return abs(other - one) > max(tolerance * max(abs(one), abs(other)), RESIDUE)


def _change(one: Any, other: Any) -> Row:
    """From one to the other: the difference, and that over the first in per cent; NaN where there is none."""
    by = relative = math.nan
    if not (isinstance(one, str) or isinstance(other, str)):
        by = other - one
        relative = 100 * by / abs(one) if one else math.copysign(math.inf, by) if by else 0.0
    return {"first": one, "second": other, "by": by, "relative_percent": relative}


def spread(pairs: Sequence[tuple[str, Row, Row]], names: Sequence[str]) -> list[Row]:
    """A row for each column that may move: the second over the first, median and extremes of all rows."""
    found = []
    for name in names:
        both = [(one[name], other[name]) for _, one, other in pairs]
        ratios = sorted(b / a for a, b in both if _is_number(a) and _is_number(b) and a > 0)
        if ratios:
            median = (ratios[(len(ratios) - 1) // 2] + ratios[len(ratios) // 2]) / 2
            found.append(
                {"column": name, "rows": len(ratios), "median": median, "least": ratios[0], "most": ratios[-1]}
            )
    return found


def entries(one: Any, other: Any, name: str = "") -> Iterator[tuple[str, Any, Any]]:
    """Names and values of what two records have not in common, of their parts by themselves."""
    if isinstance(one, dict) and isinstance(other, dict):
        for key in dict.fromkeys((*one, *other)):
            yield from entries(one.get(key), other.get(key), f"{name} {key}".strip())
    elif one != other:
        yield name, one, other


def _by_case(rows: Sequence[Row], names: Sequence[str]) -> dict[Key, Row]:
    found: dict[Key, Row] = {}
    for row in rows:
        own = tuple(_comparable(row[name]) for name in names)
        number = next(k for k in count() if (*own, k) not in found)
        found[*own, number] = row
    return found


def _said(names: Sequence[str], key: Key) -> str:
    """A case in words."""
    own = [f"{name} {value}" for name, value in zip(names, key, strict=False)]
    return ", ".join(own + [f"row {key[-1] + 1}"] * (not own or key[-1] > 0))


def _comparable(value: Any) -> Any:
    """The same, but for a number that is none, which is equal to others such."""
    return "nan" if isinstance(value, float) and math.isnan(value) else value


def _is_number(value: Any) -> bool:
    return not isinstance(value, str) and math.isfinite(value)


def _size(relative: float) -> float:
    return math.inf if math.isnan(relative) else abs(relative)
