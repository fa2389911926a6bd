"""Rules for tessellation factors compared: error against run time, bad pixels against triangles, triangle sizes."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from slefejax.figures.style import METHOD_STYLES, SETTINGS, new_figure, save

Rows = list[dict[str, Any]]


def _medians(rows: Rows, name: str, *keys: str) -> list[float]:
    own = [row for row in rows if row["method_name"] == name]
    return [float(np.median([row[key] for row in own])) for key in keys]


def _names(rows: Rows) -> list[str]:
    return list(dict.fromkeys(row["method_name"] for row in rows))


def _scatter(axes: Axes, rows: Rows, place: Any) -> None:
    """A mark a rule; its family in the legend, its number beside it, turn by turn above and below."""
    families: set[str] = set()
    for turn, name in enumerate(_names(rows)):
        family, _, number = name.partition(" ")
        style = METHOD_STYLES.get(family, {"color": "0.4", "marker": "o"})
        x, y = place(name)
        axes.plot([x], [y], ls="none", ms=9, label=None if family in families else family, **style)
        families.add(family)
        offset = (5, 5) if turn % 2 else (5, -13)
        axes.annotate(number, (x, y), xytext=offset, textcoords="offset points", fontsize=9)
    axes.legend(fontsize=10)
    axes.set_xscale("log")
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    axes.xaxis.set_major_formatter(FormatStrFormatter("%g"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def write_error_against_time(path: Path, rows: Rows, tolerance: float) -> None:
    """Largest error over the domain against predict plus render time; medians over the views."""
    with mpl.rc_context(SETTINGS):
        figure = new_figure(9, 6)
        axes = figure.subplots()

        def at(name: str) -> tuple[float, float]:
            predict, render, error = _medians(rows, name, "predict_ms", "render_ms", "sup_error_px")
            return predict + render, error

        _scatter(axes, rows, at)
        axes.axhline(tolerance, color="black", lw=1, ls="--")
        place = {"xycoords": ("axes fraction", "data"), "ha": "right", "va": "bottom"}
        axes.annotate(f"asked for: {tolerance:g} px", (0.99, tolerance), **place)
        axes.set_yscale("log")
        axes.set_xlabel("time to predict and to draw (ms)")
        axes.set_ylabel("largest error over the visible domain (px)")
        axes.set_title("error against run time: lower left is better, below the line is safe")
        save(figure, path)


def write_pixels_against_triangles(path: Path, rows: Rows, tolerance: float) -> None:
    """Share of bad pixels against triangles, in units of what minimal factors need."""
    with mpl.rc_context(SETTINGS):
        figure = new_figure(9, 6)
        axes = figure.subplots()

        def place(name: str) -> tuple[float, float]:
            own = [row for row in rows if row["method_name"] == name]
            cost = float(np.median([row["triangles"] / max(1, row["minimal_triangles"]) for row in own]))
            return cost, 100 * _medians(rows, name, "share_above_0.5")[0]

        _scatter(axes, rows, place)
        axes.axvline(1.0, color="black", lw=1, ls="--")
        axes.set_yscale("symlog", linthresh=0.01)
        axes.set_ylim(bottom=-0.002)
        ticks = [0, 0.01, 0.1, 1, 10, 100]
        axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xlabel(f"triangles over those of minimal factors for {tolerance:g} px")
        axes.set_ylabel("pixels off by more than 0.5 px (%)")
        axes.set_title("bad pixels against triangles: lower left is better")
        save(figure, path)


def write_triangle_sizes(path: Path, rows: Rows, areas: tuple[float, ...]) -> None:
    """Shares of triangles by their area on the screen, a bar a rule; medians over the views."""
    names = _names(rows)
    with mpl.rc_context(SETTINGS):
        figure = new_figure(10, 0.42 * len(names) + 1.8)
        axes = figure.subplots()
        edges = np.array([[0.0, *_medians(rows, n, *(f"share_area_below_{a:g}" for a in areas)), 1.0] for n in names])
        labels = [f"< {areas[0]:g} px²", *(f"< {a:g} px²" for a in areas[1:]), "larger"]
        colours = mpl.colormaps["cividis"](np.linspace(0.0, 1.0, len(labels)))
        for k, (label, colour) in enumerate(zip(labels, colours, strict=True)):
            axes.barh(names, 100 * (edges[:, k + 1] - edges[:, k]), left=100 * edges[:, k], color=colour, label=label)
        axes.invert_yaxis()
        axes.set_xlabel("share of the triangles (%)")
        axes.set_title("how large triangles are on the screen")
        axes.grid(visible=False)
        figure.legend(loc="outside lower center", ncols=len(labels), frameon=False)
        save(figure, path)
