"""One feature in three ways, equally near to its target."""

from __future__ import annotations

from typing import Any

import numpy as np

from slefejax.figures.page import Page
from slefejax.figures.style import COLOURS, MARKS, drawing, legend_below

_WAYS = {
    "covariances": (COLOURS[2], MARKS[0]),
    "creases": (COLOURS[1], MARKS[1]),
    "edge loops": (COLOURS[0], MARKS[2]),
}
_PANELS = (
    ("nearest", "largest distance (% of the side)", "how near each way comes", 50.0),
    ("triangles", "certified triangles", "triangles, at one distance for all", 1.0),
    ("kilobytes", "control points on the device (kB)", "memory, at that distance", 1.0),
)


def write_feature(page: Page, rows: list[dict[str, Any]]) -> None:
    """Distances, triangles and memory against the radius that edges are rounded with."""
    title = "The edges of a cube, rounded: by covariances, by semi-sharp creases, by edge loops"
    with drawing(page, 15, 5.4, title) as figure:
        for axes, (column, label, heading, unit) in zip(figure.subplots(1, 3), _PANELS, strict=True):
            for way, (colour, marker) in _WAYS.items():
                own = sorted((row for row in rows if row["way"] == way), key=lambda row: row["radius"])
                values = [unit * row[column] for row in own]
                axes.plot([50.0 * row["radius"] for row in own], values, color=colour, marker=marker, label=way)
            axes.set(xscale="log", yscale="log", xlabel="radius (% of the side)", ylabel=label)
            ticks = sorted({50.0 * row["radius"] for row in rows})
            axes.set_xticks(ticks, [f"{x:g}" for x in np.round(ticks, 6)])
            axes.set_xticks([], minor=True)
            axes.set_title(heading)
        legend_below(figure)
