"""Six bounding constructs on one curve, with their areas."""

from __future__ import annotations

import numpy as np
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from slefejax.figures.page import Page
from slefejax.figures.style import INK, REGION, REGION_EDGE, drawing, legend_below

Panel = tuple[str, list[np.ndarray], float, float]  # name, outlines, area, width


def write_six_bounds(page: Page, t: np.ndarray, curve: np.ndarray, panels: list[Panel], pieces: int) -> None:
    """A panel a construct: its regions, one a piece, around the curve (values at t)."""
    corners = np.vstack([region for _, regions, _, _ in panels for region in regions])
    title = f"Six ways to bound a step-like curve, {pieces} pieces each: area of the regions, largest vertical width"
    with drawing(page, 13, 7.6, title) as figure:
        grid = np.ravel(figure.subplots(2, 3, sharex=True, sharey=True))
        for axes, (name, regions, area, width) in zip(grid, panels, strict=True):
            for region in regions:
                axes.fill(*region.T, facecolor=REGION, edgecolor=REGION_EDGE, alpha=0.75, lw=1.2)
            axes.plot(t, curve, color=INK, lw=2)
            axes.set_title(f"{name.replace('-', ' ')}: area {area:.3f}, width {width:.3f}")
            axes.set_xlim(corners[:, 0].min() - 0.05, corners[:, 0].max() + 0.05)
            axes.set_aspect("equal", adjustable="box")
        for axes in grid[3:]:
            axes.set_xlabel("parameter t")
        for axes in grid[::3]:
            axes.set_ylabel("value")
        region = Patch(facecolor=REGION, edgecolor=REGION_EDGE, label="bound of a piece")
        legend_below(figure, [Line2D([], [], color=INK, lw=2, label="the curve"), region])
