"""The cost of a frame against patches, triangles and pixels, with the fitted model."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.ticker import MaxNLocator

from slefejax.figures.fitting import plain
from slefejax.figures.page import Page
from slefejax.figures.style import COLOURS, INK, drawing, legend_below

Rows = list[dict[str, Any]]
_LABELS = {"patches": "patches", "triangles": "triangles", "shaded_pixels": "shaded pixels"}
_DOTS: dict[str, Any] = {"ls": "", "marker": "o", "ms": 5, "color": COLOURS[0], "alpha": 0.7}
_FITTED = COLOURS[1]


def write_scaling(page: Page, measured: Rows, coefficients: Rows, r_squared: float, renderer: str, scene: str) -> None:
    """First measured against modelled time. Then, for each term, the time less what the other terms explain."""
    cost = {row["term"]: row["us_each"] / 1e3 for row in coefficients}
    error = {row["term"]: row["standard_error_us"] / 1e3 for row in coefficients}
    times = np.array([row["render_ms"] for row in measured])
    parts = {name: cost[name] * np.array([row[name] for row in measured]) for name in _LABELS}
    model = cost["frame"] + sum(parts.values())
    fixed = f"{cost['frame']:.2f} ± {error['frame']:.2g} ms"
    title = f"{scene}: the time of a frame on {renderer} is {fixed} and so much for each patch, triangle and pixel"
    with drawing(page, 13, 9.5, f"{title} (± standard error)") as figure:
        first, *others = figure.subplots(2, 2).ravel()
        first.plot(model, times, label="a measured frame", **_DOTS)
        ends = [0.0, float(max(model.max(), times.max()))]
        first.plot(ends, ends, color=INK, lw=1, ls="--", label="as modelled")
        first.set_xlabel("modelled time (ms)")
        first.set_ylabel("measured time of a frame (ms)")
        first.set_title(f"all terms, R² = {r_squared:.4f}")
        for axes, (name, label) in zip(others, _LABELS.items(), strict=True):
            x = np.array([row[name] for row in measured])
            axes.plot(x, times - (model - parts[name]), **_DOTS)
            line = np.array([0.0, x.max()])
            axes.plot(line, cost[name] * line, color=_FITTED, lw=2, label="the fitted cost of one term")
            axes.set_xlabel(label)
            axes.set_ylabel("time beyond the other terms (ms)")
            axes.xaxis.set_major_locator(MaxNLocator(5))
            axes.xaxis.set_major_formatter(lambda value, _: plain(value))
            axes.set_title(f"{1e3 * cost[name]:.3g} ± {1e3 * error[name]:.2g} µs for each of the {label}")
        legend_below(figure)
