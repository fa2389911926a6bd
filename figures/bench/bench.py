"""How the time of each stage grows with the number of patches, and what share of a frame each has."""

from __future__ import annotations

from typing import Any

import numpy as np

from slefejax.figures.page import Page
from slefejax.figures.style import BACKGROUND, COLOURS, HATCHES, QUIET, drawing, legend_below, on_picture, series

Rows = list[dict[str, Any]]
FRAME = ("skinning", "stencils", "pose pass", "view pass", "draw", "read-back", "error image")
_LEAST = 6.0  # per cent of a bar that has room for a number


def _own(rows: Rows, stage: str, cores: int, precision: str) -> dict[int, dict[str, Any]]:
    """The first row of each number of patches."""
    found: dict[int, dict[str, Any]] = {}
    for row in rows:
        if (row["stage"], row["cores"], row["precision"]) == (stage, cores, precision):
            found.setdefault(row["count"], row)
    return found


def _precision(rows: Rows, stage: str) -> str:
    kinds = {row["precision"] for row in rows if row["stage"] == stage}
    return "single" if "single" in kinds else "double"


def write_growth(page: Page, rows: Rows) -> None:
    """Milliseconds against patches, both logarithmic: JAX on one core as lines, plain NumPy dashed."""
    stages = [name for name in dict.fromkeys(row["stage"] for row in rows) if name != "table"]
    title = "Time of each stage on one core, against the number of patches (median, bars from 10 to 90 %)"
    with drawing(page, 12, 7.5, title) as figure:
        axes = figure.subplots()
        for k, stage in enumerate(stages):
            own, style = _own(rows, stage, 1, _precision(rows, stage)), series(k)
            place = sorted(own)
            low, high = ([abs(own[n][key] - own[n]["median_ms"]) for n in place] for key in ("low_ms", "high_ms"))
            middle = [own[n]["median_ms"] for n in place]
            axes.errorbar(place, middle, yerr=[low, high], label=stage, capsize=3, **style)
            peer = [own[n]["peer_ms"] if own[n]["peer"] in ("NumPy", "SciPy") else np.nan for n in place]
            if np.isfinite(peer).any():
                axes.plot(place, peer, ls="--", alpha=0.7, **style)
        axes.plot([], [], ls="--", color=QUIET, label="the same in NumPy or SciPy")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("patches")
        axes.set_ylabel("time (ms), single precision where there is any")
        legend_below(figure)


def write_shares(page: Page, rows: Rows) -> None:
    """What a frame of each number of patches is made of, on one core."""
    counts = sorted({row["count"] for row in rows if row["stage"] in FRAME})
    stages = [stage for stage in FRAME if any(row["stage"] == stage for row in rows)]
    with drawing(page, 12, 2.0 + 0.7 * len(counts), "What the time of a frame consists of, on one core") as figure:
        axes = figure.subplots()
        for line, count in enumerate(counts):
            times = []
            for stage in stages:
                own = _own(rows, stage, 1, _precision(rows, stage)).get(count)
                times.append(0.0 if own is None else own["median_ms"])
            start, whole = 0.0, sum(times) or 1.0
            for k, (stage, value) in enumerate(zip(stages, times, strict=True)):
                share, look = 100 * value / whole, {"color": COLOURS[k], "hatch": HATCHES[k], "edgecolor": BACKGROUND}
                axes.barh(line, share, left=start, label=stage if line == 0 else None, **look)
                if share >= _LEAST:
                    on_picture(axes, (start + share / 2, line), f"{value:.3g} ms")
                start += share
        axes.set_yticks(range(len(counts)), [f"{count:,} patches" for count in counts])
        axes.set_xlabel("share of what the measured stages take (%)")
        axes.set_xlim(0, 100)
        axes.grid(visible=False)
        legend_below(figure)
