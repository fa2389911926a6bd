"""What a command shows: a table in the terminal, or one JSON object."""

from __future__ import annotations

import io
import json
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from rich import box
from rich.console import Console
from rich.markup import escape
from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeElapsedColumn
from rich.table import Table

from slefejax.experiments.store import open_first
from slefejax.experiments.tables import strict

MOST_ROWS = 60
_LONG = 40  # of a text that may be wrapped
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
    "slefe_share_above_0.5": "> 0.5 px",
    "slefe_max_error_px": "largest px",
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
    "without_ms": "without, ms",
    "with_ms": "with, ms",
}
Row = dict[str, Any]


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
        rows = [{name: row[name] for name in self.shown or row} for row in self.rows]
        lines = [*(f"Note: {note}" for note in self.notes), self.title, _table(rows)]
        if len(self.rows) > MOST_ROWS:
            lines.append(f"… and {len(self.rows) - MOST_ROWS:,} more rows in the table file")
        for title, rows in self.more:
            lines += [f"\n{title}", _table(rows)] if rows else []
        if self.out is not None:
            lines.append(f"Results are in {self.out}: open {open_first(self.out).name} first")
        return "".join(f"{line}\n" for line in lines if line)


def _table(rows: list[Row]) -> str:
    """The first rows; what is the same in all of them stands once, below. A single row is shown as a column."""
    if not rows:
        return ""
    table = Table(box=box.SIMPLE_HEAD, show_header=len(rows) > 1)
    constant = {name: value for name, value in rows[0].items() if all(_same(row[name], value) for row in rows)}
    if len(rows) == 1:
        table.add_column()
        table.add_column()
        for name, value in rows[0].items():
            table.add_row(_heading(name), _shown(name, value))
        return _rendered(table)
    columns = [name for name in rows[0] if name not in constant]
    for name in columns:
        words = [row[name] for row in rows if isinstance(row[name], str)]
        long = any(len(word) > _LONG for word in words)
        table.add_column(_heading(name), justify="left" if words else "right", no_wrap=not long)
    for row in rows[:MOST_ROWS]:
        table.add_row(*[_shown(name, row[name]) for name in columns])
    shared = ", ".join(f"{_heading(name)} {_shown(name, value)}" for name, value in constant.items() if _says(value))
    return _rendered(table) + (f"\nin every row: {shared}" if shared else "")


def _same(one: Any, other: Any) -> bool:
    return one == other or not (_says(one) or _says(other))


def _says(value: Any) -> bool:
    """Whether there is anything to show: no text, and a number that is none, say nothing."""
    return value != "" and not (isinstance(value, float) and np.isnan(value))


def _rendered(table: Table) -> str:
    """As text; wide enough for numbers, never wider than a long line of words."""
    page = io.StringIO()
    Console(file=page, width=180, highlight=False).print(table)
    return "\n".join(line.rstrip() for line in page.getvalue().strip("\n").splitlines())


def _heading(name: str) -> str:
    return HEADINGS.get(name, name.replace("_", " "))


def _shown(name: str, value: Any) -> str:
    if isinstance(value, float) and np.isnan(value):
        return "-"
    if "share" in name:
        return f"{100 * value:.2f} %"
    if name.endswith(("_percent", "_deg")) and isinstance(value, float):
        return f"{value:.3g}"
    if name.endswith("_error") and isinstance(value, float):
        return f"{value:.1e}" if value else "0"
    if isinstance(value, float):
        return f"{value:.9g}" if name == "scale" else f"{value:.4g}" if "us" in name.split("_") else f"{value:.3f}"
    if isinstance(value, int) and not isinstance(value, bool):
        return f"{value:,}"
    return escape(str(value))


@contextmanager
def progress(what: str, total: int) -> Iterator[Callable[..., None]]:
    """A progress bar on standard error, if that is a terminal.

    The function that is given hears how much is done, or, as ``detail``, what is being done.
    """
    columns = (TextColumn("{task.description}"), BarColumn(), MofNCompleteColumn(), TimeElapsedColumn())
    hidden = not sys.stderr.isatty()
    with Progress(*columns, console=Console(stderr=True), transient=True, disable=hidden) as bar:
        task = bar.add_task(what, total=total)

        def show(done: int | None = None, detail: str = "") -> None:
            bar.update(task, completed=done, description=f"{what} {detail}".strip())

        yield show
