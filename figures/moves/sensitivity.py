"""A control mesh, coloured by how many triangles it costs to move it, beside the largest of all sensitivities."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import LogNorm

from slefejax.figures.style import SETTINGS, new_figure, save

_COLOURS = ("#009e73", "#0072b2", "#56b4e9", "#e69f00")  # of kinds, in the order of the table
_DECADES = 2.0  # that are told apart below the largest value
_BARS = 8  # of a kind


def write_sensitivity(
    path: Path, polygons: list[np.ndarray], values: np.ndarray, rows: list[dict[str, Any]], scene: str, what: str
) -> None:
    """The mesh on the left, bars on the right.

    polygons : ``(corners, 2)`` in pixels, the furthest first;  values : triangles for a step of 1 %, one a polygon
    rows     : the table of the command
    """
    bars = [row for row in rows if row["name"]]
    kinds = list(dict.fromkeys((row["kind"], row["change"]) for row in bars))
    with mpl.rc_context(SETTINGS):
        figure = new_figure(14, max(6.0, 1.9 * len(kinds) + 1.5))
        left, right = figure.subplots(1, 2, width_ratios=[1.35, 1])
        _plot_mesh(left, polygons, values, what)
        _plot_bars(right, bars, kinds)
        figure.suptitle(f"{scene}: what costs triangles")
        save(figure, path)


def _plot_mesh(axes: Any, polygons: list[np.ndarray], values: np.ndarray, what: str) -> None:
    largest = float(values.max(initial=0.0)) or 1.0
    scale = LogNorm(largest * 10.0**-_DECADES, largest, clip=True)
    faces = PolyCollection(polygons, cmap="viridis", norm=scale, edgecolors="#303030", linewidths=0.25)
    faces.set_array(values)
    axes.add_collection(faces)
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.set_title(f"triangles that moving a {what} by 1 % of the scene can cost")
    axes.set_xlabel("x (pixels)")
    axes.set_ylabel("y (pixels)")
    axes.grid(False)
    axes.figure.colorbar(
        faces, ax=axes, shrink=0.8, label="triangles (mean of a face's corners; darkest: that or less)"
    )


def _plot_bars(axes: Any, bars: list[dict[str, Any]], kinds: list[tuple[str, str]]) -> None:
    at, ticks, names = 0.0, [], []
    for (kind, change), colour in zip(kinds, _COLOURS, strict=False):
        own = [row for row in bars if (row["kind"], row["change"]) == (kind, change)][:_BARS]
        places = at + np.arange(len(own))
        axes.barh(places, [row["triangles_more"] for row in own], color=colour, label=f"{kind}: {change}")
        ticks += places.tolist()
        names += [row["name"] for row in own]
        at += len(own) + 1.5
    axes.set_yticks(ticks, names, fontsize=10)
    axes.invert_yaxis()
    axes.set_xscale("symlog", linthresh=1.0)
    axes.axvline(0.0, color="black", lw=0.8)
    axes.set_xlabel("triangles more (first order)")
    axes.set_title("the largest of each kind")
    axes.legend(fontsize=10, loc="upper center", bbox_to_anchor=(0.5, -0.1), ncols=2, frameon=False)
