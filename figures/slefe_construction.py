"""How a slefe is made: a curve between its piecewise-linear bounds, and the bounds of one basis function."""

from __future__ import annotations

import numpy as np

from slefejax.figures.page import Page
from slefejax.figures.style import COLOURS, INK, QUIET, REGION, drawing, legend_below

Bounds = tuple[np.ndarray, np.ndarray]
_UPPER, _LOWER = COLOURS[1], COLOURS[0]


def write_slefe_construction(
    page: Page, t: np.ndarray, curve: np.ndarray, control: np.ndarray, bounds: Bounds, basis: np.ndarray, table: Bounds
) -> None:
    """Left: a curve (values at t), its control polygon and its slefe. Right: a_1 and the row of the table for it."""
    title = "A slefe: p is its chord plus second differences times fixed functions aⱼ, bounded once and for all"
    pieces, width = len(table[0]) - 1, float(np.max(table[1] - table[0]))
    with drawing(page, 13, 5.6, title) as figure:
        left, right = (part.subplots() for part in figure.subfigures(1, 2))
        left.plot(np.linspace(0, 1, len(control)), control, "o--", color=QUIET, ms=5, lw=1, label="control polygon")
        for axes, values, (lower, upper), name in ((left, curve, bounds, "p"), (right, basis, table, "a₁")):
            places = np.linspace(0.0, 1.0, len(lower))
            axes.fill_between(places, lower, upper, color=REGION, lw=0)
            axes.plot(places, upper, "v-", color=_UPPER, ms=6, label=f"upper bound of {name}")
            axes.plot(places, lower, "^-", color=_LOWER, ms=6, label=f"lower bound of {name}")
            axes.plot(t, values, color=INK, lw=2, label=name)
            axes.set_xlabel("parameter t")
            axes.set_ylabel("value")
            legend_below(axes.figure)
        left.set_title(f"a curve p and its slefe with {pieces} pieces")
        right.set_title(f"the basis function a₁ and its tabulated bounds, width {width:.4f}")
