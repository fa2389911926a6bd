"""A control mesh, coloured by how many triangles it costs to move it, beside the largest of all sensitivities."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm

from slefejax.figures.fitting import log_ticks
from slefejax.figures.page import Page
from slefejax.figures.style import COLOURS, FACTOR_MAP, HATCHES, INK, LINES, bar_numbers, drawing, legend_below

_DECADES = 2.0  # that are told apart below the largest value
_BARS = 8  # of a kind
_LONGEST = 28  # letters of a bone's or a key's name


def write_sensitivity(
    page: Page, polygons: list[np.ndarray], values: np.ndarray, rows: list[dict[str, Any]], scene: str, what: str
) -> None:
    """The mesh on the left, bars on the right.

    polygons : ``(corners, 2)`` in pixels, the furthest first;  values : triangles for a step of 1 %, one a polygon
    rows     : the table of the command
    """
    bars = [row for row in rows if row["name"]]
    kinds = list(dict.fromkeys((row["kind"], row["change"]) for row in bars))
    with drawing(page, 14, max(6.0, 2.2 * len(kinds) + 1.5), f"{scene}: what costs triangles when it moves") as figure:
        left, right = figure.subfigures(1, 2, width_ratios=[1.35, 1])
        _plot_mesh(left, polygons, values, what)
        _plot_bars(right, bars, kinds)


def _plot_mesh(part: Any, polygons: list[np.ndarray], values: np.ndarray, what: str) -> None:
    axes = part.subplots()
    largest = float(values.max(initial=0.0)) or 1.0
    scale = LogNorm(largest * 10.0**-_DECADES, largest, clip=True)
    faces = PolyCollection(polygons, cmap=FACTOR_MAP, norm=scale, edgecolors=LINES, linewidths=0.25)
    faces.set_array(values)
    axes.add_collection(faces)
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_title(f"triangles for a {what} moved by 1 % of the scene")
    axes.set_xlabel("x (pixels)")
    axes.set_ylabel("y (pixels)")
    axes.grid(visible=False)
    bar = part.colorbar(faces, ax=axes, shrink=0.8, extend="min", label="triangles, mean of a face's corners")
    log_ticks(bar.ax.yaxis, largest * 10.0**-_DECADES, largest)


def _plot_bars(part: Any, bars: list[dict[str, Any]], kinds: list[tuple[str, str]]) -> None:
    axes = part.subplots()
    at, ticks, names = 0.0, [], []
    for number, (kind, change) in enumerate(kinds):
        own = [row for row in bars if (row["kind"], row["change"]) == (kind, change)][:_BARS]
        places = at + np.arange(len(own))
        look = {"color": COLOURS[number % len(COLOURS)], "hatch": HATCHES[number % len(HATCHES)], "edgecolor": LINES}
        more = [row["triangles_more"] for row in own]
        bars_of_kind = axes.barh(places, more, label=f"{kind}: {change}", lw=0.5, **look)
        bar_numbers(axes, bars_of_kind, [f"{value:,.3g}" for value in more])
        ticks += places.tolist()
        names += [row["name"] if len(row["name"]) <= _LONGEST else f"{row['name'][:_LONGEST]}…" for row in own]
        at += len(own) + 1.5
    axes.set_yticks(ticks, names)
    axes.invert_yaxis()
    axes.set_xscale("symlog", linthresh=1.0)
    axes.axvline(0.0, color=INK, lw=0.8)
    axes.set_xlabel("triangles more (first order)")
    axes.set_title("the largest of each kind")
    legend_below(part)
