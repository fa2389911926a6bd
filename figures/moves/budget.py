"""Triangles against the tolerance, or the distance of the camera, with the budgets that were asked for."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from slefejax.figures.style import SETTINGS, new_figure, save


def write_budget(
    path: Path, rows: list[dict[str, Any]], curve: tuple[np.ndarray, np.ndarray], by: str, scene: str
) -> None:
    """The curve of real numbers of triangles, and what was found for every budget.

    rows : a budget each;  curve : tolerances in pixels (distances in scene units) and triangles without rounding
    """
    name, label = ("tolerance_px", "tolerance (px)") if by == "tolerance" else ("distance", "camera distance (scene)")
    with mpl.rc_context(SETTINGS):
        figure = new_figure(8.5, 5.6)
        axes = figure.subplots()
        axes.plot(*curve, color="#56b4e9", lw=2, label="2 Σ τ², without rounding")
        axes.plot(
            [row[name] for row in rows], [row["triangles"] for row in rows], "o", color="#009e73", ms=8, label="drawn"
        )
        for row in rows:
            axes.axhline(row["budget"], color="#d55e00", lw=1, ls="--")
            text = f"{row['triangles']:,} at {row[name]:.4g}, largest error {row['sup_error_px']:.3g} px"
            axes.annotate(text, (row[name], row["triangles"]), (8, 6), textcoords="offset points", fontsize=10)
        axes.plot([], [], color="#d55e00", lw=1, ls="--", label="budget")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel(label)
        axes.set_ylabel("triangles")
        axes.set_title(f"{scene}: what meets a number of triangles")
        axes.legend(fontsize=10, loc="lower left")
        save(figure, path)
