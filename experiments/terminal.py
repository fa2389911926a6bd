"""Tables as text that fits a terminal: as many columns as there is room for, the most telling ones."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import zip_longest
from typing import Any, NamedTuple

import numpy as np
from rich.cells import cell_len, set_cell_size

from slefejax.experiments.tables import Row

MOST_ROWS = 60
LEAST_WIDTH = 20  # what a table is made for where a terminal says that it is narrower
_WORD = 24  # of a narrow column: longer words are cut, unless there is room
HEADINGS = {
    "share_above_0.1": "> 0.1 px",
    "share_above_0.5": "> 0.5 px",
    "share_above_1": "> 1 px",
    "covered_pixels": "pixels",
    "max_error_px": "largest px",
    "max_normal_error_deg": "normals °",
    "patches_without_normal": "no normal",
    "slipped_pixels": "slipped",
    "max_slip_px": "slip px",
    "slefe_triangles": "slefe: triangles",
    "slefe_share_above_0.5": "slefe: > 0.5 px",
    "slefe_max_error_px": "slefe: largest px",
    "predict_ms": "predict ms",
    "render_ms": "render ms",
    "width_over_optimum_median": "width/optimum",
    "width_over_optimum_p95": "95 %",
    "width_over_optimum_max": "largest",
    "sup_error_px": "sup px",
    "drawn_sup_error_px": "drawn sup px",
    "sup_normal_error_deg": "sup °",
    "drawn_sup_normal_error_deg": "drawn °",
    "slack_deg": "slack °",
    "analytic_cubic": "analytic",
    "held_out_share_unsafe": "unsafe, held out",
    "quantile_low": "low",
    "quantile_high": "high",
    "largest_unsafe_share": "unsafe: largest",
    "quantile_unsafe_share": "quantile",
    "quantile_triangles": "its triangles",
    "factor_over_minimal_p95": "95 %",
    "triangles_over_minimal": "/ minimal",
    "twist_coefficient": "twist",
    "below_analytic_share": "below",
    "factor_over_minimal_median": "over minimal",
    "share_wrong_silhouette": "wrong edge",
    "share_wrong_patch_inside": "wrong inside",
    "us_per_curve": "µs a curve",
    "single_error": "single: error",
    "double_error": "double: error",
    "single_broken": "single: broken",
    "double_broken": "double: broken",
    "single_refused": "refused",
    "nonfinite": "not finite",
    "single_unsafe_from": "single unsafe from",
    "single_estimate_off_from": "1 % off from",
    "single_certified_loose_from": "certified loose from",
    "skinning_ms": "skin + convert",
    "boxes_ms": "slefe boxes",
    "view_ms": "view",
    "levels_ms": "edges",
    "hand_over_ms": "hand over",
    "pop_max_px": "pop px",
    "pop_p99_px": "pop 99 %",
    "changed_share": "changed",
    "sum_of_factors": "factors",
    "frames_per_second": "frames/s",
    "limit_max_percent": "limit: largest %",
    "limit_rms_percent": "limit: rms %",
    "limit_bound_percent": "limit: bound %",
    "limit_max_px": "limit: px",
    "normal_jump_deg": "normals jump",
    "relative_percent": "by, %",
    "without_ms": "without, ms",
    "with_ms": "with, ms",
    "tolerance_px": "within px",
    "tolerance_deg": "within °",
    "tolerance_depth": "within depth",
}
_DIGITS = {"scale": 9, "first": 7, "second": 7, "by": 3}
SETTINGS = ("scene", "method", "segments", "patches", "spacing", "scheme", "degree", "precision", "device", "unit")
"""Columns that a title names, if they are the same in every row."""
LEAST_TELLING = (
    *("max_slip_px", "slipped_pixels", "covered_pixels", "predict_ms", "render_ms", "share_above_0.1"),
    *("slefe_triangles", "time", "hand_over_ms", "levels_ms", "boxes_ms", "skinning_ms", "view_ms"),
    *("share_wrong_patch_inside", "share_wrong_silhouette", "inner_u", "inner_v", "low_ms", "high_ms", "peak_mb", "by"),
)
"""Columns that are left out first, in this order, where there is no room; then what never changes, then the last."""


class Fitted(NamedTuple):
    """A table as text.

    text       : its lines
    everywhere : settings that are the same in every row and have no column, their headings and values
    left_out   : names of the columns for which there was no room
    """

    text: str
    everywhere: dict[str, str]
    left_out: tuple[str, ...]


def fitted(rows: Sequence[Row], width: int) -> Fitted:
    """The first rows, in lines of at most so many cells. A single row is shown as a column.

    >>> rows = [{"patch": 8, "method": "slefe"}, {"patch": 9, "method": "slefe"}]
    >>> fitted(rows, 80).text.split()
    ['patch', '──────', '8', '9']
    >>> fitted(rows, 80).everywhere
    {'method': 'slefe'}
    """
    width = max(width, LEAST_WIDTH)
    if len(rows) == 1:
        return Fitted(_as_column(rows[0], width), {}, ())
    constant = {name for name, value in rows[0].items() if all(_same(row[name], value) for row in rows)}
    silent = {name for name in constant if not _says(rows[0][name])}
    settings = [name for name in SETTINGS if name in constant - silent]
    names = [name for name in rows[0] if name not in silent and name not in settings] or list(rows[0])
    columns = [_Column(name, [row[name] for row in rows[:MOST_ROWS]]) for name in names]
    layout = _SPACED if _SPACED.total(columns, lambda own: own.widest) <= width else _NARROW
    kept = columns if layout is _SPACED else _with_room(columns, width, constant)
    everywhere = {heading(name): shown(name, rows[0][name]) for name in settings if name not in names}
    left_out = tuple(own.name for own in columns if own not in kept)
    return Fitted(_drawn(kept, layout, width), everywhere, left_out)


def heading(name: str) -> str:
    """What stands above a column."""
    return HEADINGS.get(name, name.replace("_", " "))


def shown(name: str, value: Any) -> str:
    """A value as tables show it."""
    if isinstance(value, float) and np.isnan(value):
        return "-"
    if "share" in name:
        return f"{100 * value:.2f} %"
    if name.endswith(("_percent", "_deg")) and isinstance(value, float):
        return f"{value:.3g}"
    if name.endswith("_error") and isinstance(value, float):
        return f"{value:.1e}" if value else "0"
    if isinstance(value, float):
        return (
            f"{value:.{_DIGITS[name]}g}"
            if name in _DIGITS
            else f"{value:.4g}"
            if "us" in name.split("_")
            else f"{value:.3f}"
        )
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    if isinstance(value, bool):
        return "yes" if value else "no"
    words = " ".join(str(value).split())
    return "".join(letter for letter in words if letter.isprintable())


class _Column:
    """What a column has to show, and how narrow it can be."""

    def __init__(self, name: str, values: Sequence[Any]) -> None:
        self.name, self.heading = name, heading(name)
        self.cells = [shown(name, value) for value in values]
        self.words = any(isinstance(value, str) for value in values)

    @cached_property
    def widest(self) -> int:
        """Everything in one line."""
        return max(map(cell_len, (self.heading, *self.cells)))

    @cached_property
    def least(self) -> int:
        """Headings one word a line, numbers whole, words whole unless they are long ones."""
        widest = max(map(cell_len, self.cells))
        if self.words and widest > _WORD:
            widest = max(_WORD // 2, *(min(_longest_word(cell), _WORD) for cell in self.cells))
        return max(widest, min(_longest_word(self.heading), _WORD))


@dataclass(frozen=True)
class _Layout:
    indent: int
    gap: int

    def total(self, columns: Sequence[_Column], width: Callable[[_Column], int]) -> int:
        """Cells in a line."""
        return self.indent + sum(map(width, columns)) + self.gap * (len(columns) - 1)


_SPACED, _NARROW = _Layout(2, 3), _Layout(1, 2)


def _with_room(columns: list[_Column], width: int, constant: set[str]) -> list[_Column]:
    """Those that fit side by side as narrow as they can be; the first one always stays."""
    rest = columns[:0:-1]
    order = sorted(rest, key=lambda own: _rank(own.name, constant))
    left_out: list[_Column] = []

    def kept() -> list[_Column]:
        return [own for own in columns if own not in left_out]

    def fit() -> bool:
        return _NARROW.total(kept(), lambda own: own.least) <= width

    for own in order:
        if not fit():
            left_out.append(own)
    for own in tuple(reversed(left_out)):  # a wide one went, and there is room for a narrow one again
        left_out.remove(own)
        if not fit():
            left_out.append(own)
    return kept()


def _rank(name: str, constant: set[str]) -> int:
    if name in LEAST_TELLING:
        return LEAST_TELLING.index(name)
    return len(LEAST_TELLING) + (name not in constant)


def _drawn(columns: list[_Column], layout: _Layout, width: int) -> str:
    """Headings, a rule, and the cells."""
    widths = _widths(columns, layout, width)
    indent, gap = " " * layout.indent, " " * layout.gap

    def lines(cells: list[list[str]]) -> list[str]:
        each = zip(columns, widths, cells, strict=True)
        aligned = [[_aligned(line, room, column) for line in cell] for column, room, cell in each]
        return [indent + gap.join(parts) for parts in zip(*aligned, strict=True)]

    headings = [_folded(own.heading, room) for own, room in zip(columns, widths, strict=True)]
    height = max(map(len, headings))
    found = lines([[""] * (height - len(own)) + own for own in headings])
    found.append(indent[1:] + "─" * (1 + sum(widths) + layout.gap * (len(widths) - 1)))
    for k in range(len(columns[0].cells)):
        cells = [_folded(own.cells[k], room) for own, room in zip(columns, widths, strict=True)]
        height = max(map(len, cells))
        found += lines([own + [""] * (height - len(own)) for own in cells])
    return "\n".join(line.rstrip() for line in found)


def _widths(columns: list[_Column], layout: _Layout, width: int) -> list[int]:
    """Of every column: as wide as it is, or as narrow as it can be, and what is left over for words."""
    if layout is _SPACED:
        return [own.widest for own in columns]
    widths = [min(own.least, width - layout.indent) for own in columns]
    spare = max(width - layout.total(columns, lambda own: own.least), 0)
    for k, own in enumerate(columns):
        more = min(spare, max(own.widest - widths[k], 0)) if own.words else 0
        widths[k], spare = widths[k] + more, spare - more
    return widths


def _as_column(row: Row, width: int) -> str:
    """A line a value, behind its heading; long texts are folded."""
    headings = {name: heading(name) for name in row}
    side = min(max(map(cell_len, headings.values())), width // 2)
    lines = []
    for name, value in row.items():
        cells = _folded(shown(name, value), width - side - 5)
        for head, cell in zip_longest(_folded(headings[name], side), cells, fillvalue=""):
            lines.append(f"  {set_cell_size(head, side)}   {cell}".rstrip())
    return "\n".join(lines)


def _aligned(text: str, room: int, column: _Column) -> str:
    space = " " * (room - cell_len(text))
    return text + space if column.words else space + text


def _folded(text: str, room: int) -> list[str]:
    """Lines of whole words; a word that is longer than a line loses its middle."""
    lines = [""]
    for word in _words(text):
        own = cut(word, room)
        longer = f"{lines[-1]} {own}".lstrip()
        if cell_len(longer) <= room:
            lines[-1] = longer
        else:
            lines.append(own)
    return [line.replace(_HARD, " ") for line in lines]


def cut(word: str, room: int) -> str:
    """Its first and last letters, if there is no room for all of them."""
    if cell_len(word) <= room:
        return word
    last = (room - 1) // 2
    end = word
    while cell_len(end) > last:
        end = end[1:]
    return set_cell_size(word, room - 1 - cell_len(end)).rstrip() + "…" + end


_HARD = "\N{NO-BREAK SPACE}"


def _words(text: str) -> list[str]:
    """What stays in one line: words, a sign with what follows it, a number with its per cent."""
    return re.sub(r"(?<![^ ])([<>/±]) | (%)", lambda found: f"{found[1] or ''}{_HARD}{found[2] or ''}", text).split(" ")


def _longest_word(text: str) -> int:
    return max(map(cell_len, _words(text)))


def _same(one: Any, other: Any) -> bool:
    return one == other or not (_says(one) or _says(other))


def _says(value: Any) -> bool:
    """Whether there is anything to show: no text, and a number that is none, say nothing."""
    return value != "" and not (isinstance(value, float) and np.isnan(value))
