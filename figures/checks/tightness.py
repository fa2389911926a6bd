"""Width of every bound over the narrowest possible: against the number of pieces, and against time."""

from __future__ import annotations

from typing import Any

import numpy as np

from slefejax.figures.fitting import short
from slefejax.figures.page import Page
from slefejax.figures.style import METHOD_STYLES, beside, drawing, legend_below, level

Rows = list[dict[str, Any]]
_HIGHEST = 60.0  # of the axis of widths; a bound that takes no account of slope leaves it for straight curves


def write_width_against_pieces(page: Page, rows: Rows) -> None:
    """Median and 95th percentile of width over optimum against the pieces; a panel for each kind with many curves."""
    kinds = list(dict.fromkeys(row["curve"] for row in rows if row["curves"] > 1)) or [rows[0]["curve"]]
    title = "Width of each bound over the narrowest possible, against the number of pieces (median; shaded up to 95 %)"
    with drawing(page, max(8.0, 5.2 * len(kinds)), 6.2, title) as figure:
        grid = np.atleast_1d(figure.subplots(1, len(kinds), sharey=True))
        for axes, kind in zip(grid, kinds, strict=True):
            for method, style in METHOD_STYLES.items():
                own = [row for row in rows if row["curve"] == kind and row["method"] == method]
                if not own:
                    continue
                pieces = [row["segments"] for row in own]
                axes.plot(pieces, [row["width_over_optimum_median"] for row in own], label=method, **style)
                axes.fill_between(
                    pieces,
                    [row["width_over_optimum_median"] for row in own],
                    [row["width_over_optimum_p95"] for row in own],
                    color=style["color"],
                    alpha=0.12,
                    lw=0,
                )
            axes.set_yscale("log")
            axes.set_ylim(0.9, _HIGHEST)
            level(axes, 1.0, "narrowest possible")
            axes.set_xlabel("pieces")
            axes.set_title(f"{kind} curves of degree {rows[0]['degree']}{_off_scale(rows, kind)}")
        grid[0].set_ylabel("width over the narrowest possible")
        legend_below(figure)


def write_width_against_time(page: Page, rows: Rows) -> None:
    """Median width over optimum against time a curve, random curves; a mark a number of pieces."""
    kind = rows[0]["curve"]
    title = f"What a bound costs and what it gives, {kind} curves; the numbers are pieces"
    with drawing(page, 10, 6.4, title) as figure:
        axes = figure.subplots()
        for method, style in METHOD_STYLES.items():
            own = [row for row in rows if row["curve"] == kind and row["method"] == method]
            if not own:
                continue
            times, widths = ([row[name] for row in own] for name in ("us_per_curve", "width_over_optimum_median"))
            axes.plot(times, widths, label=method, **style)
            for row, time, width in zip(own, times, widths, strict=True):
                beside(axes, (time, width), str(row["segments"]), style["color"])
        axes.set_xscale("log")
        axes.set_yscale("log")
        level(axes, 1.0, "narrowest possible")
        axes.set_xlabel("time of a curve (µs); formulas compiled and in batches, the others one by one")
        axes.set_ylabel("width over the narrowest possible (median)")
        legend_below(figure)


def _off_scale(rows: Rows, kind: str) -> str:
    """Names the methods that are nowhere in the picture, a line each."""
    best: dict[str, float] = {}
    for row in (row for row in rows if row["curve"] == kind):
        best[row["method"]] = min(row["width_over_optimum_median"], best.get(row["method"], np.inf))
    return "".join(f"\noff scale: {method}, from {short(ratio)}" for method, ratio in best.items() if ratio > _HIGHEST)
