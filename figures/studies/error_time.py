"""Rules for tessellation factors compared: error against run time, bad pixels against triangles, triangle sizes."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes

from slefejax.figures.page import Page
from slefejax.figures.style import (
    INK,
    LINES,
    SIZE_CLASSES,
    beside,
    drawing,
    legend_below,
    level,
    method_style,
    size_legend,
)

Rows = list[dict[str, Any]]
_AREAS = {"the triangles": "share_area_below", "the covered pixels": "share_pixels_area_below"}


def _medians(rows: Rows, name: str, *keys: str) -> list[float]:
    own = [row for row in rows if row["method_name"] == name]
    return [float(np.median([row[key] for row in own])) for key in keys]


def _names(rows: Rows) -> list[str]:
    return list(dict.fromkeys(row["method_name"] for row in rows))


def _scatter(axes: Axes, rows: Rows, place: Any) -> None:
    """A mark a rule; its family in the legend, its number beside it."""
    families: set[str] = set()
    for name in _names(rows):
        family, _, number = name.partition(" ")
        style = method_style(family)
        x, y = place(name)
        axes.plot([x], [y], ls="none", ms=9, label=None if family in families else family, **style)
        families.add(family)
        beside(axes, (x, y), number)
    axes.set_xscale("log")
    axes.margins(0.12)


def write_error_against_time(page: Page, rows: Rows, tolerance: float) -> None:
    """Largest error over the domain against predict plus render time; medians over the views."""
    title = f"{_scenes(rows)}: error against run time; lower left is better, on or below the line is safe"
    with drawing(page, 10, 6.4, title) as figure:
        axes = figure.subplots()

        def at(name: str) -> tuple[float, float]:
            predict, render, error = _medians(rows, name, "predict_ms", "render_ms", "sup_error_px")
            return predict + render, error

        _scatter(axes, rows, at)
        level(axes, tolerance, f"asked for: {tolerance:g} px")
        axes.set_yscale("log")
        axes.set_xlabel("time to predict and to draw (ms)")
        axes.set_ylabel("largest error over the visible domain (px)")
        legend_below(figure)


def write_pixels_against_triangles(page: Page, rows: Rows, tolerance: float) -> None:
    """Share of bad pixels against triangles, in units of what minimal factors need."""
    title = f"{_scenes(rows)}: bad pixels against triangles; lower left is better"
    with drawing(page, 10, 6.4, title) as figure:
        axes = figure.subplots()

        def place(name: str) -> tuple[float, float]:
            own = [row for row in rows if row["method_name"] == name]
            cost = float(np.median([row["triangles"] / max(1, row["minimal_triangles"]) for row in own]))
            return cost, 100 * _medians(rows, name, "share_above_0.5")[0]

        _scatter(axes, rows, place)
        axes.axvline(1.0, color=INK, lw=1.2, ls="--", label=f"minimal factors for {tolerance:g} px")
        axes.set_yscale("symlog", linthresh=0.01)
        axes.set_ylim(-0.004, 200)
        ticks = [0, 0.01, 0.1, 1, 10, 100]
        axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
        axes.set_xlabel(f"triangles over those of minimal factors for {tolerance:g} px")
        axes.set_ylabel("pixels off by more than 0.5 px (%)")
        legend_below(figure)


def write_triangle_sizes(page: Page, rows: Rows) -> None:
    """Shares of triangles and of the screen by the area of triangles, a bar a rule; medians over the views."""
    names = _names(rows)
    title = f"{_scenes(rows)}: how large triangles are on the screen"
    with drawing(page, 13, 0.42 * len(names) + 2.2, title, grid=False) as figure:
        panels = figure.subplots(1, 2, sharey=True)
        for axes, (of, column) in zip(panels, _AREAS.items(), strict=True):
            limits = [f"{column}_{limit:g}" for limit, _, _ in SIZE_CLASSES[:-1]]
            ends = 100 * np.array([[0.0, *_medians(rows, name, *limits), 1.0] for name in names])
            for k, (_, colour, _) in enumerate(SIZE_CLASSES):
                look = {"color": colour, "edgecolor": LINES, "linewidth": 0.5}
                axes.barh(names, ends[:, k + 1] - ends[:, k], left=ends[:, k], **look)
            axes.set_xlim(0, 100)
            axes.set_xlabel(f"share of {of} (%)")
        panels[0].invert_yaxis()
        size_legend(figure)


def _scenes(rows: Rows) -> str:
    return ", ".join(dict.fromkeys(row["scene"] for row in rows))
