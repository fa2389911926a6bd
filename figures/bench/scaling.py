"""The cost of a frame against patches, triangles and pixels, with the fitted model."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np

from slefejax.figures.style import SETTINGS, new_figure, save

Rows = list[dict[str, Any]]
_LABELS = {"patches": "patches", "triangles": "triangles", "shaded_pixels": "shaded pixels"}


def write_scaling(path: Path, measured: Rows, coefficients: Rows, r_squared: float, renderer: str) -> None:
    """Left: measured against modelled time. Then, for each term, the time less what the other terms explain."""
    cost = {row["term"]: row["us_each"] / 1e3 for row in coefficients}
    error = {row["term"]: row["standard_error_us"] / 1e3 for row in coefficients}
    times = np.array([row["render_ms"] for row in measured])
    parts = {name: cost[name] * np.array([row[name] for row in measured]) for name in _LABELS}
    model = cost["frame"] + sum(parts.values())
    with mpl.rc_context(SETTINGS):
        figure = new_figure(17, 4.8)
        first, *others = figure.subplots(1, 4)
        first.plot(model, times, "o", ms=5, color="#0072b2", alpha=0.7, label="measured")
        ends = [0.0, float(max(model.max(), times.max()))]
        first.plot(ends, ends, color="black", lw=1, ls="--", label="as modelled")
        first.set_xlabel("modelled time (ms)")
        first.set_ylabel("measured time of a frame (ms)")
        first.set_title(f"all frames, R² = {r_squared:.4f}")
        first.legend()
        for axes, (name, label) in zip(others, _LABELS.items(), strict=True):
            x = np.array([row[name] for row in measured])
            axes.plot(x, times - (model - parts[name]), "o", ms=5, color="#0072b2", alpha=0.7)
            line = np.array([0.0, x.max()])
            axes.plot(line, cost[name] * line, color="#d55e00", lw=2)
            axes.set_xlabel(label)
            axes.set_ylabel("ms beyond the other terms")
            axes.set_title(f"{1e3 * cost[name]:.3g} ± {1e3 * error[name]:.2g} µs each")
        fixed = f"{cost['frame']:.2f} ± {error['frame']:.2g} ms"
        figure.suptitle(
            f"cost of a frame on {renderer}: fixed {fixed} + patches + triangles + pixels (± standard error)"
        )
        save(figure, path)
