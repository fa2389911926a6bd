"""Colours and settings that all figures share."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure
from matplotlib.patches import Patch

# The error colours of [YBP12], in shades that the colour-blind can tell apart: (limit in pixels, colour, name)
ERROR_CLASSES = (
    (0.1, "#c8c8c8", "≤ 0.1 px"),
    (0.5, "#4a7fc1", "≤ 0.5 px"),
    (1.0, "#2fa36b", "≤ 1 px"),
    (float("inf"), "#c81e1e", "> 1 px"),
)
BACKGROUND = "#ffffff"
_MARGIN = 12  # pixels around what is shown of a picture
FACTOR_MAP = "viridis"

# One colour (for the colour-blind, [OI]) and one mark a method, the same in every figure
METHOD_STYLES: dict[str, dict[str, Any]] = {
    "certified": {"color": "#009e73", "marker": "*"},
    "slefe": {"color": "#d55e00", "marker": "o"},
    "filip": {"color": "#0072b2", "marker": "s"},
    "convex-hull": {"color": "#009e73", "marker": "^"},
    "oriented-box": {"color": "#56b4e9", "marker": "D"},
    "min-max": {"color": "#cc79a7", "marker": "v"},
    "control-polygon": {"color": "#000000", "marker": "P"},
    "disc": {"color": "#e69f00", "marker": "X"},
    "edge-length": {"color": "#e69f00", "marker": "X"},
    "screen-box": {"color": "#cc79a7", "marker": "v"},
    "fixed": {"color": "#000000", "marker": "P"},
    "minmax": {"color": "#cc79a7", "marker": "v"},
}

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


def occupied(something: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of the part of a picture where a mask is set, with a margin."""
    rows, columns = (np.flatnonzero(something.any(axis=axis)) for axis in (1, 0))
    first, second = (slice(max(0, r[0] - _MARGIN), r[-1] + _MARGIN + 1) for r in (rows, columns))
    return first, second


def error_legend(figure: Any) -> None:
    """The error colours and what they mean, below a figure or a part of one."""
    handles = [Patch(facecolor=colour, label=name) for _, colour, name in ERROR_CLASSES]
    figure.legend(handles=handles, loc="outside lower center", ncols=4, frameon=False, title="error of a pixel")


def save(figure: Figure, path: Path) -> None:
    """Write the figure as PNG."""
    figure.savefig(path, format="png")
