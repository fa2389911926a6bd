"""Triangles against the tolerance, or the distance of the camera, with the budgets that were asked for."""

from __future__ import annotations

from typing import Any

import numpy as np

from slefejax.figures.page import Page
from slefejax.figures.style import COLOURS, beside, drawing, legend_below


def write_budget(
    page: Page, rows: list[dict[str, Any]], curve: tuple[np.ndarray, np.ndarray], by: str, scene: str
) -> None:
    """The curve of real numbers of triangles, and what was found for every budget.

    rows : a budget each;  curve : tolerances in pixels (distances in scene units) and triangles without rounding
    """
    name, label = ("tolerance_px", "tolerance (px)") if by == "tolerance" else ("distance", "camera distance (scene)")
    with drawing(page, 10, 6, f"{scene}: the {by} that meets each number of triangles") as figure:
        axes = figure.subplots()
        axes.plot(*curve, color=COLOURS[5], lw=2, label="2 Σ τ², without rounding")
        found, drawn = [row[name] for row in rows], [row["triangles"] for row in rows]
        axes.plot(found, drawn, "o", color=COLOURS[2], ms=8, label="triangles drawn, and their largest error")
        for row in rows:
            axes.axhline(row["budget"], color=COLOURS[1], lw=1, ls="--")
            text = f"{row['triangles']:,} at {row[name]:.4g}: {row['sup_error_px']:.3g} px"
            beside(axes, (row[name], row["triangles"]), text)
        axes.plot([], [], color=COLOURS[1], lw=1, ls="--", label="budget")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.margins(0.12)
        axes.set_xlabel(label)
        axes.set_ylabel("triangles")
        legend_below(figure)
