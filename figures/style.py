"""Colours and settings that all figures share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
from matplotlib.figure import Figure

# The papers' error colours, in shades that the colour-blind can tell apart: (limit in pixels, colour, name)
ERROR_CLASSES = (
    (0.1, "#c8c8c8", "≤ 0.1 px"),
    (0.5, "#4a7fc1", "≤ 0.5 px"),
    (1.0, "#2fa36b", "≤ 1 px"),
    (float("inf"), "#c81e1e", "> 1 px"),
)
BACKGROUND = "#ffffff"
FACTOR_MAP = "viridis"

SETTINGS: dict[Any, Any] = {
    "font.size": 12,
    "axes.titlesize": 12,
    "axes.grid": True,
    "grid.alpha": 0.3,
    "figure.dpi": 100,
    "savefig.dpi": 100,
    "axes.spines.top": False,
    "axes.spines.right": False,
}


def new_figure(width: float, height: float) -> Figure:
    """A figure of that many inches, in the common style, with no window behind it."""
    with mpl.rc_context(SETTINGS):
        return Figure(figsize=(width, height), layout="constrained")


def save(figure: Figure, path: Path) -> None:
    """Write the figure as PNG."""
    figure.savefig(path, format="png")
