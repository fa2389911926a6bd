"""A scene in motion: triangles and error over time, and where the time goes."""

from __future__ import annotations

from typing import Any

import numpy as np

from slefejax.figures.page import Page
from slefejax.figures.style import (
    BACKGROUND,
    COLOURS,
    FAINT,
    HATCHES,
    QUIET,
    YELLOW,
    bar_numbers,
    drawing,
    legend_below,
    level,
    method_style,
    on_picture,
)

Rows = list[dict[str, Any]]

# [YBP14], Table 2, in per cent of a frame
PUBLISHED = {"skinning_ms": 58.0, "boxes_ms": 4.0, "view_ms": 6.0, "render_ms": 32.0}
PARTS = {
    "skinning_ms": ("shape keys, skinning, conversion", COLOURS[5]),
    "boxes_ms": ("slefe boxes", YELLOW),
    "view_ms": ("view: projection, widths, factors", COLOURS[2]),
    "levels_ms": ("levels of shared edges and rings", COLOURS[3]),
    "hand_over_ms": ("control points to OpenGL", FAINT),
    "render_ms": ("rendering", COLOURS[0]),
}
_LEAST = 4.0  # per cent of a bar that has room for a number


def write_timeline(page: Page, rows: Rows, scene: str, tolerance: float) -> None:
    """Triangles, errors, and what pops, over the time of the motion."""
    times = [row["time"] for row in rows]
    style = method_style(rows[0]["method"]) | {"marker": "."}
    title = f"{scene} in motion, {rows[0]['patches']:,} patches: factors by '{rows[0]['method']}',"
    with drawing(page, 10, 9.5, f"{title} {rows[0]['spacing']} spacing") as figure:
        top, middle, bottom = figure.subplots(3, 1, sharex=True)
        top.plot(times, [row["triangles"] for row in rows], **style)
        top.set_ylabel("triangles")
        top.set_ylim(0, 1.1 * max(row["triangles"] for row in rows))
        middle.plot(times, [row["max_error_px"] for row in rows], label="largest error of a pixel", **style)
        level(middle, tolerance, f"asked for: {tolerance:g} px")
        middle.set_ylabel("error (pixels)")
        middle.set_ylim(0, 1.1 * max(tolerance, float(np.nanmax([row["max_error_px"] for row in rows]))))
        popping = rows[1:]
        for name, label, line in (
            ("pop_max_px", "largest popping", "^-"),
            ("pop_p99_px", "popping of 99 % of the pixels", "o--"),
        ):
            bottom.plot(times[1:], [row[name] for row in popping], line, ms=4, color=QUIET, label=label)
        bottom.set_ylabel("popping: texture moved by\nnew levels alone (pixels)")
        bottom.set_xlabel("time of the motion")
        bottom.set_ylim(0, 1.1 * max([0.01, *(row["pop_max_px"] for row in popping)]))
        edge = 0.02 * (times[-1] - times[0]) or 0.5
        bottom.set_xlim(times[0] - edge, times[-1] + edge)
        figure.align_ylabels()
        legend_below(figure)


def write_work(page: Page, modes: Rows, scene: str, renderer: str) -> None:
    """Shares of a frame in which the pose changes, beside the published ones; and frames a second of all modes."""
    every = [row for row in modes if row["mode"] == modes[0]["mode"]]
    bars = [("published\n(GTX 580)", PUBLISHED), *((f"here:\n{row['method']}", row) for row in every)]
    heights = [1.9 + 0.9 * len(bars), 1.2 + 0.45 * len(modes)]
    title = f"{scene}: where the time of a frame goes, and what posing less often saves ({renderer})"
    with drawing(page, 12, sum(heights), title) as figure:
        upper, lower = figure.subfigures(2, 1, height_ratios=heights)
        _shares(upper, bars)
        bottom = lower.subplots()
        places = np.arange(len(modes))[::-1]
        rates = [row["frames_per_second"] for row in modes]
        shown = bottom.barh(places, rates, color=[method_style(row["method"])["color"] for row in modes])
        bar_numbers(bottom, shown, [f"{rate:.3g}" for rate in rates])
        bottom.set_yticks(places, [f"{row['method']}: {row['mode']}" for row in modes])
        bottom.set_xlabel("frames a second")
        bottom.grid(axis="y", visible=False)


def _shares(part: Any, bars: list[tuple[str, dict[str, Any]]]) -> None:
    """One bar of 100 % each; parts that are long enough have their number in them."""
    axes = part.subplots()
    places = np.arange(len(bars))[::-1]
    starts = np.zeros(len(bars))
    totals = np.array([sum(bar.get(name, 0.0) for name in PARTS) for _, bar in bars])
    for (name, (label, colour)), hatch in zip(PARTS.items(), HATCHES, strict=False):
        shares = 100.0 * np.array([bar.get(name, 0.0) for _, bar in bars]) / totals
        axes.barh(places, shares, left=starts, color=colour, label=label, edgecolor=BACKGROUND, hatch=hatch)
        for place, start, share in zip(places, starts, shares, strict=True):
            if share >= _LEAST:
                on_picture(axes, (start + share / 2.0, float(place)), f"{share:.0f}")
        starts += shares
    axes.set_yticks(places, [name for name, _ in bars])
    axes.set_xlim(0, 100)
    axes.set_xlabel("share of a frame whose pose and view are new (%)")
    axes.grid(visible=False)
    legend_below(part)
