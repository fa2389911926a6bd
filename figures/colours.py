"""Colours and marks of series, as figures and pages have them: plain names, without Matplotlib."""

from __future__ import annotations

from typing import Any

# For the colour-blind [OI]; with the marks they tell series apart
COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
MARKS = ("o", "s", "^", "D", "v", "P", "*", "X", "<", ">", "h", "p", "d", "8")

# One colour and one mark a method, the same in every figure
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
