"""How the time of each stage grows with the number of patches, and what share of a frame each has."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from slefejax.figures.style import SETTINGS, new_figure, save

Rows = list[dict[str, Any]]
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_MARKS = "os^DvP*X"
_PLATE = {"facecolor": "white", "edgecolor": "none", "alpha": 0.8, "pad": 1.5}  # one colour of bars is black
FRAME = ("skinning", "stencils", "pose pass", "view pass", "draw", "read-back", "error image")


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


def write_growth(path: Path, rows: Rows) -> None:
    """Milliseconds against patches, both logarithmic: JAX on one core as lines, plain NumPy dashed."""
    stages = [name for name in dict.fromkeys(row["stage"] for row in rows) if name != "table"]
    with mpl.rc_context(SETTINGS):
        figure = new_figure(12, 7)
        axes = figure.subplots()
        for k, stage in enumerate(stages):
            own = _own(rows, stage, 1, _precision(rows, stage))
            style: dict[str, Any] = {"color": _COLOURS[k % len(_COLOURS)], "marker": _MARKS[k % len(_MARKS)]}
            place = sorted(own)
            low, high = ([abs(own[n][key] - own[n]["median_ms"]) for n in place] for key in ("low_ms", "high_ms"))
            middle = [own[n]["median_ms"] for n in place]
            axes.errorbar(place, middle, yerr=[low, high], label=stage, capsize=3, **style)
            peer = [own[n]["peer_ms"] if own[n]["peer"] in ("NumPy", "SciPy") else np.nan for n in place]
            if np.isfinite(peer).any():
                axes.plot(place, peer, ls="--", alpha=0.7, **style)
        axes.plot([], [], ls="--", color="0.4", label="the same in NumPy or SciPy")
        axes.set_xscale("log")
        axes.set_yscale("log")
        axes.set_xlabel("patches")
        axes.set_ylabel("milliseconds on one core, single precision\nwhere there is any (median, 10 to 90 %)")
        figure.legend(loc="outside right upper", fontsize=10)
        save(figure, path)


def write_shares(path: Path, rows: Rows) -> None:
    """What a frame of the largest number of patches is made of, on one core."""
    counts = sorted({row["count"] for row in rows if row["stage"] in FRAME})
    stages = [stage for stage in FRAME if any(row["stage"] == stage for row in rows)]
    with mpl.rc_context(SETTINGS):
        figure = new_figure(12, 1.6 + 0.8 * len(counts))
        axes = figure.subplots()
        for line, count in enumerate(counts):
            times = []
            for stage in stages:
                own = _own(rows, stage, 1, _precision(rows, stage)).get(count)
                times.append(0.0 if own is None else own["median_ms"])
            start, whole = 0.0, sum(times) or 1.0
            for k, (stage, value) in enumerate(zip(stages, times, strict=True)):
                share = 100 * value / whole
                axes.barh(line, share, left=start, color=_COLOURS[k], label=stage if line == 0 else None)
                if share > 5:
                    axes.text(
                        start + share / 2, line, f"{value:.3g} ms", ha="center", va="center", fontsize=10, bbox=_PLATE
                    )
                start += share
        axes.set_yticks(range(len(counts)), [f"{count:,} patches" for count in counts])
        axes.set_xlabel("share of what the measured stages of a frame take on one core (%)")
        axes.set_xlim(0, 100)
        axes.grid(visible=False)
        figure.legend(loc="outside upper center", ncols=len(stages), fontsize=10)
        save(figure, path)
