"""Relative errors of factors in hard cases, single and double precision, a panel a family."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from slefejax.figures.fitting import plain
from slefejax.figures.page import Page
from slefejax.figures.style import BACKGROUND, COLOURS, FAINT, HAZE, INK, QUIET, drawing, hide_rest, legend_below

Rows = list[dict[str, Any]]
_STYLES: dict[str, dict[str, Any]] = {
    "single": {"color": COLOURS[1], "marker": "o"},
    "double": {"color": COLOURS[0], "marker": "s"},
}
_LEAST, _MOST = 1e-17, 10.0
_ZERO = 1e-18  # where an error of exactly 0 is marked, below the axis of the others
_ZERO_SIZES = {"single": 10, "double": 5}  # one lies within the other where both are 0
_COLUMNS = 3  # at most
_TICKS = 5  # values that are written, at most


def write_stability_figure(page: Page, rows: Rows) -> None:
    """Error against value for every family; violations, and what is not finite or refused, are marked."""
    names = list(dict.fromkeys(row["family"] for row in rows))
    columns = min(_COLUMNS, len(names))
    count = -(-len(names) // columns)
    title = "Relative errors of factors in hard cases: each family of cases becomes harder from left to right"
    with drawing(page, 13, 1.4 + 2.7 * count, title) as figure:
        panels = figure.subplots(count, columns, squeeze=False)
        for axes, name in zip(panels.ravel(), names, strict=False):
            _panel(axes, name, [row for row in rows if row["family"] == name])
        for axes in panels[:, 0]:
            axes.set_ylabel("relative error")
        hide_rest(panels, len(names))
        wrong = "leaves its enclosure, misses its certificate, refused or not finite"
        precisions = [Line2D([], [], label=f"{name} precision", **style) for name, style in _STYLES.items()]
        marks = [
            Line2D([], [], color=QUIET, marker="o", mfc=BACKGROUND, ls="", label="exactly 0"),
            Line2D([], [], color=COLOURS[1], ls=":", label="by how much the certified factor is larger in single"),
            Line2D([], [], color=FAINT, lw=1.5, label="1 %"),
            Line2D([], [], color=INK, marker="X", ls="", ms=10, label=wrong),
        ]
        legend_below(figure, [*precisions, *marks])


def _panel(axes: Axes, name: str, rows: Rows) -> None:
    values = list(dict.fromkeys(row["value"] for row in rows))
    place = {value: k for k, value in enumerate(values)}
    for precision, style in _STYLES.items():
        own = [row for row in rows if row["precision"] == precision]
        at = [place[row["value"]] for row in own]
        exact = np.array([row["factor_error"] for row in own])
        error = np.where(exact == 0, np.nan, np.clip(exact, _LEAST, _MOST))
        axes.plot(at, error, label=f"{precision} precision", **style)
        zero = np.flatnonzero(exact == 0)
        size = _ZERO_SIZES[precision]
        level = np.full(len(zero), _ZERO)
        axes.plot(np.take(at, zero), level, linestyle="", markerfacecolor=BACKGROUND, markersize=size, **style)
        excess = np.clip(np.array([row["certified_over_double"] for row in own]) - 1.0, _LEAST, _MOST)
        if precision == "single":
            axes.plot(at, np.where(excess > _LEAST, excess, np.nan), linestyle=":", color=style["color"])
        bad = [
            k
            for k, row in enumerate(own)
            if row["containment_violations"] or row["certificate_violations"] or row["nonfinite"] or row["refused"]
        ]
        shown = np.where(exact == 0, _ZERO, np.where(np.isnan(exact), _MOST, error))
        axes.plot([at[k] for k in bad], shown[bad], "X", color=INK, markersize=10)
    axes.axhline(0.01, color=FAINT, linewidth=1.5)
    axes.set_yscale("log")
    axes.set_ylim(_ZERO / 4, _MOST * 3)
    axes.axhspan(_ZERO / 4, _LEAST / 2, color=HAZE, zorder=0)
    powers = range(-16, 1, 4)
    axes.set_yticks([_ZERO, *(10.0**k for k in powers)], ["0", *(f"$10^{{{k}}}$" for k in powers)])
    axes.minorticks_off()
    written = range(0, len(values), -(-len(values) // _TICKS))
    axes.set_xticks(range(len(values)), [plain(value) if k in written else "" for k, value in enumerate(values)])
    axes.set_title(name)
    axes.set_xlabel(rows[0]["parameter"])
