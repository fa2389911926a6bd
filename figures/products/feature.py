"""One feature in three ways, equally near to its target."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from slefejax.figures.style import SETTINGS, new_figure, save

_WAYS = {"covariances": ("#009e73", "o"), "creases": ("#d55e00", "s"), "edge loops": ("#0072b2", "^")}
_PANELS = (
    ("nearest", "largest distance, % of the side", "how near each way comes", 50.0),
    ("triangles", "certified triangles", "triangles, at one distance for all", 1.0),
    ("kilobytes", "kB of control points on the device", "memory, at that distance", 1.0),
)


def write_feature(path: Path, rows: list[dict[str, Any]]) -> None:
    """Distances, triangles and memory against the radius that edges are rounded with."""
    with mpl.rc_context(SETTINGS):
        figure = new_figure(15, 5.0)
        for axes, (column, label, title, unit) in zip(figure.subplots(1, 3), _PANELS, strict=True):
            for way, (colour, marker) in _WAYS.items():
                own = sorted((row for row in rows if row["way"] == way), key=lambda row: row["radius"])
                values = [unit * row[column] for row in own]
                axes.plot([50.0 * row["radius"] for row in own], values, color=colour, marker=marker, label=way)
            axes.set(xscale="log", yscale="log", xlabel="radius, % of the side", ylabel=label)
            ticks = sorted({50.0 * row["radius"] for row in rows})
            axes.set_xticks(ticks, [f"{x:g}" for x in np.round(ticks, 6)])
            axes.set_xticks([], minor=True)
            axes.set_title(title)
        figure.axes[0].legend(frameon=True)
        figure.suptitle("the edges of a cube, rounded: by covariances, by semi-sharp creases, by edge loops")
        save(figure, path)
