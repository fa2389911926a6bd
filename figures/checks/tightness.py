"""Width of every bound over the narrowest possible: against the number of pieces, and against time."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from slefejax.figures.style import METHOD_STYLES, SETTINGS, new_figure, save

Rows = list[dict[str, Any]]
_HIGHEST = 60.0  # of the axis of widths; a bound that takes no account of slope leaves it for straight curves


def write_width_against_pieces(path: Path, rows: Rows) -> None:
    """Median and 95th percentile of width over optimum against the pieces; a panel for each kind with many curves."""
    kinds = list(dict.fromkeys(row["curve"] for row in rows if row["curves"] > 1)) or [rows[0]["curve"]]
    with mpl.rc_context(SETTINGS):
        figure = new_figure(5.2 * len(kinds), 5.4)
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
            axes.text(0.5, 0.97, _off_scale(rows, kind), transform=axes.transAxes, ha="center", va="top", fontsize=10)
            axes.axhline(1.0, color="black", lw=1, ls=":")
            axes.set_xlabel("pieces")
            axes.set_title(f"{kind} curves of degree {rows[0]['degree']}")
        grid[0].set_ylabel("width over the narrowest possible\n(median; shaded up to 95 %)")
        handles, names = _legend(grid)
        figure.legend(handles, names, loc="outside lower center", ncols=len(names), fontsize=11)
        save(figure, path)


def write_width_against_time(path: Path, rows: Rows) -> None:
    """Median width over optimum against time a curve, random curves; a mark a number of pieces."""
    kind = rows[0]["curve"]
    with mpl.rc_context(SETTINGS):
        figure = new_figure(8.5, 5.6)
        axes = figure.subplots()
        for method, style in METHOD_STYLES.items():
            own = [row for row in rows if row["curve"] == kind and row["method"] == method]
            if not own:
                continue
            times, widths = ([row[name] for row in own] for name in ("us_per_curve", "width_over_optimum_median"))
            axes.plot(times, widths, label=method, **style)
            for row, time, width in zip(own, times, widths, strict=True):
                axes.annotate(
                    str(row["segments"]), (time, width), xytext=(4, 4), textcoords="offset points", fontsize=8
                )
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.axhline(1.0, color="black", lw=1, ls=":")
        axes.set_xlabel("time a curve (µs); formulas compiled and in batches, the others one by one")
        axes.set_ylabel("width over the narrowest possible (median)")
        axes.set_title(f"what a bound costs and what it gives, {kind} curves; the numbers are pieces")
        axes.legend(fontsize=10)
        save(figure, path)


def _off_scale(rows: Rows, kind: str) -> str:
    """Names the methods that are nowhere in the picture."""
    best: dict[str, float] = {}
    for row in (row for row in rows if row["curve"] == kind):
        best[row["method"]] = min(row["width_over_optimum_median"], best.get(row["method"], np.inf))
    return "\n".join(f"off scale: {method}, from {ratio:.1e}" for method, ratio in best.items() if ratio > _HIGHEST)


def _legend(grid: Any) -> tuple[list[Any], list[str]]:
    found: dict[str, Any] = {}
    for axes in grid:
        handles, names = axes.get_legend_handles_labels()
        found.update(dict(zip(names, handles, strict=True)))
    return list(found.values()), list(found)
