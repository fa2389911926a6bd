"""Relative errors of factors in hard cases, single and double precision, a panel a family."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.lines import Line2D

from slefejax.figures.style import SETTINGS, new_figure, save

Rows = list[dict[str, Any]]
_STYLES: dict[str, dict[str, Any]] = {
    "single": {"color": "#d55e00", "marker": "o"},
    "double": {"color": "#0072b2", "marker": "s"},
}
_LEAST, _MOST = 1e-17, 10.0
_ZERO = 1e-18  # where an error of exactly 0 is marked, below the axis of the others
_ZERO_SIZES = {"single": 10, "double": 5}  # one lies within the other where both are 0
_COLUMNS = 4


def write_stability_figure(path: Path, rows: Rows) -> None:
    """Error against value for every family; violations, and what is not finite or refused, are marked."""
    names = list(dict.fromkeys(row["family"] for row in rows))
    count = -(-len(names) // _COLUMNS)
    with mpl.rc_context(SETTINGS):
        figure = new_figure(16, 1.0 + 3.1 * count)
        panels = figure.subplots(count, _COLUMNS, squeeze=False).ravel()
        for axes, name in zip(panels, names, strict=False):
            _panel(axes, name, [row for row in rows if row["family"] == name])
        for axes in panels[len(names) :]:
            axes.set_axis_off()
        handles, labels = panels[0].get_legend_handles_labels()
        marks = {
            "exactly 0": Line2D([], [], color="0.3", marker="o", markerfacecolor="white", linestyle=""),
            "leaves its enclosure, misses its certificate, refused or not finite": Line2D(
                [], [], color="black", marker="X", linestyle="", markersize=10
            ),
            "certified factor's excess": Line2D([], [], color="black", linestyle=":"),
            "1 %": Line2D([], [], color="0.7", linewidth=1),
        }
        figure.legend([*handles, *marks.values()], [*labels, *marks], loc="outside upper center", ncols=6)
        save(figure, path)


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
        axes.plot(np.take(at, zero), level, linestyle="", markerfacecolor="white", markersize=size, **style)
        excess = np.clip(np.array([row["certified_over_double"] for row in own]) - 1.0, _LEAST, _MOST)
        if precision == "single":
            axes.plot(at, np.where(excess > _LEAST, excess, np.nan), linestyle=":", color=style["color"])
        bad = [
            k
            for k, row in enumerate(own)
            if row["containment_violations"] or row["certificate_violations"] or row["nonfinite"] or row["refused"]
        ]
        shown = np.where(exact == 0, _ZERO, np.where(np.isnan(exact), _MOST, error))
        axes.plot([at[k] for k in bad], shown[bad], "X", color="black", markersize=10)
    axes.axhline(0.01, color="0.7", linewidth=1)
    axes.set_yscale("log")
    axes.set_ylim(_ZERO / 4, _MOST * 3)
    axes.axhspan(_ZERO / 4, _LEAST / 2, color="0.93", zorder=0)
    powers = range(-16, 1, 4)
    axes.set_yticks([_ZERO, *(10.0**k for k in powers)], ["0", *(f"$10^{{{k}}}$" for k in powers)])
    axes.minorticks_off()
    axes.set_xticks(range(len(values)), [f"{value:.8g}" for value in values], rotation=40, fontsize=9)
    axes.set_title(name)
    axes.set_xlabel(rows[0]["parameter"], fontsize=10)
    axes.set_ylabel("relative error")
