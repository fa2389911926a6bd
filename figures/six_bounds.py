"""Six bounding constructs on one curve, with their areas."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np

from slefejax.figures.style import SETTINGS, new_figure, save

Panel = tuple[str, list[np.ndarray], float, float]  # name, outlines, area, width


def write_six_bounds(path: Path, t: np.ndarray, curve: np.ndarray, panels: list[Panel], pieces: int) -> None:
    """A panel a construct: its regions, one a piece, around the curve (values at t)."""
    corners = np.vstack([region for _, regions, _, _ in panels for region in regions])
    with mpl.rc_context(SETTINGS):
        figure = new_figure(13, 7.6)
        grid = np.ravel(figure.subplots(2, 3, sharex=True, sharey=True))
        for axes, (name, regions, area, width) in zip(grid, panels, strict=True):
            for region in regions:
                axes.fill(*region.T, facecolor="#f4e3b5", edgecolor="#b8860b", alpha=0.75, lw=1.2)
            axes.plot(t, curve, color="black", lw=2)
            axes.set_title(f"{name.replace('-', ' ')}: area {area:.3f}, width {width:.3f}")
            axes.set_xlim(corners[:, 0].min() - 0.05, corners[:, 0].max() + 0.05)
            axes.set_aspect("equal", adjustable="box")
        for axes in grid[3:]:
            axes.set_xlabel("parameter t")
        for axes in grid[::3]:
            axes.set_ylabel("value")
        figure.suptitle(
            f"Six ways to bound a step-like curve, {pieces} pieces each: area of the regions, largest vertical width"
        )
        save(figure, path)
