"""What the published estimate says and what is needed: constants, residuals, and the twist that it does not see."""

from __future__ import annotations

from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.lines import Line2D

from slefejax.figures.page import Page
from slefejax.figures.style import BACKGROUND, COLOURS, FAINT, INK, MARKS, QUIET, drawing, legend_below, series

Rows = list[dict[str, Any]]
_MODEL_COLOURS = (
    COLOURS[1],
    COLOURS[4],
    COLOURS[0],
    COLOURS[2],
)  # estimate as published, fitted, with twist, certified
_ESTIMATORS: dict[str, dict[str, Any]] = {
    "largest": {"color": COLOURS[1], "marker": "^"},
    "quantile": {"color": COLOURS[0], "marker": "o"},
    "least-squares": {"color": COLOURS[3], "marker": "s"},
}
_MOST = 4000  # dots a scene


def write_fit_km(
    page: Page, points: list[tuple[str, Any, Any]], fits: Rows, curves: Rows, models: Rows, m: int, target: float
) -> None:
    """Four panels: needed against predicted; the ratio against twist; k_m against m; what each model costs and leaves.

    points : for every scene its name, the terms m^2 w / tolerance, and its samples
    fits   : rows of one set of samples, a number of segments each;  curves : rows a number of segments
    models : rows a scene and model, those with a time belonging to scenes that were fitted
    """
    k = next(row["quantile"] for row in fits if row["segments"] == m)
    title = "The published estimate of factors against what is needed"
    with drawing(page, 14, 13.5, title) as figure:
        first, second, third, fourth = np.ravel(figure.subfigures(2, 2, height_ratios=[1, 1.08]))
        shown = [(name, *_chosen(slefe, samples)) for name, slefe, samples in points]
        hidden = sum(int(np.sum((samples.minimal > 1) & (slefe <= 0))) for _, slefe, samples in points)
        beyond = f"\n{hidden:,} more need pieces though the estimate is 0" if hidden else ""
        _plot_factors(first, shown, k, m, target, beyond)
        _plot_ratios(second, shown, k, m)
        _plot_constants(third, fits, curves)
        _plot_models(fourth, models)


def _chosen(slefe: Any, samples: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Estimate, needed factor and share of the twist of at most so many samples, the worst among them."""
    counted = np.flatnonzero((samples.minimal > 1) & (slefe > 0))
    ratio = samples.needed[counted] / np.sqrt(slefe[counted])
    order = counted[np.argsort(-ratio)]
    chosen = np.concatenate([order[:100], order[100 :: max(1, len(order) // _MOST)]])
    return np.sqrt(slefe[chosen]), samples.needed[chosen], samples.terms["twist"][chosen] / slefe[chosen]


def _dot(values: np.ndarray) -> float:
    """The size of a dot where there are so many."""
    return 3.0 if len(values) > 1000 else 5.0


def _plot_factors(part: Any, shown: list[Any], k: float, m: int, target: float, beyond: str) -> None:
    axes = part.subplots()
    for number, (name, estimate, needed, _) in enumerate(shown):
        axes.plot(estimate, needed, ls="", ms=_dot(needed), alpha=0.4, mew=0, label=name, **series(number))
    every = np.concatenate([estimate for _, estimate, *_ in shown])
    ends = np.array([every.min(), every.max()]) if len(every) else np.array([1.0, 10.0])
    axes.plot(ends, ends, ":", color=INK, lw=1.4, label="k = 1")
    if np.isfinite(k):
        axes.plot(ends, k * ends, "-", color=INK, lw=1.8, label=f"$k_{m}$ = {k:.3f}, {100 * target:g} % below")
    axes.set_xscale("log")
    axes.set_yscale("log")
    axes.set_xlabel(f"estimate $m\\sqrt{{w/\\mathrm{{tolerance}}}}$, m = {m} (pieces)")
    axes.set_ylabel("needed τ* (pieces)")
    axes.set_title("a dot a patch and view; above a line the constant is too small" + beyond)
    legend_below(part)


def _plot_ratios(part: Any, shown: list[Any], k: float, m: int) -> None:
    axes = part.subplots()
    for number, (name, estimate, needed, twist) in enumerate(shown):
        dots = {"ls": "", "ms": _dot(needed), "alpha": 0.4, "mew": 0, **series(number)}
        axes.plot(np.maximum(twist, 1e-3), needed / estimate, label=name, **dots)
    axes.axhline(1.0, color=INK, ls=":", lw=1.4, label="k = 1")
    if np.isfinite(k):
        axes.axhline(k, color=INK, lw=1.8, label=f"$k_{m}$ = {k:.3f}")
    if not any(len(needed) for *_, needed, _ in shown):
        axes.text(0.5, 0.5, "the estimate is 0 for every patch", transform=axes.transAxes, ha="center")
        axes.set_xlim(1e-3, 10.0)
    axes.set_xscale("log")
    axes.set_xlabel("twist over m² w (what the estimate does not see over what it does)")
    axes.set_ylabel(f"needed over estimate, m = {m}")
    axes.set_title("patches with much twist break the estimate")
    legend_below(part)


def _plot_constants(part: Any, fits: Rows, curves: Rows) -> None:
    axes = part.subplots()
    for shift, (estimator, style) in zip((-0.08, 0.0, 0.08), _ESTIMATORS.items(), strict=True):
        own = [row for row in fits if np.isfinite([row[estimator], row[f"{estimator}_high"]]).all()]
        if own:
            k = np.array([row[estimator] for row in own])
            spread = [k - [row[f"{estimator}_low"] for row in own], [row[f"{estimator}_high"] for row in own] - k]
            at = np.array([row["segments"] for row in own]) + shift
            axes.errorbar(at, k, yerr=np.maximum(spread, 0.0), capsize=3, ls="--", lw=1, label=estimator, **style)
    m = [row["segments"] for row in curves]
    axes.plot(
        m, [row["analytic_cubic"] for row in curves], "-", color=INK, lw=1.8, label="cubics in one variable, analytic"
    )
    measured = [max(row["k_random"], row["k_one_bend"]) for row in curves]
    axes.plot(m, measured, "x", color=INK, ms=8, label="the same, measured")
    axes.axhspan(1.0, 1.5, color=FAINT, alpha=0.15, lw=0, label="published: between 1.5 and 1")
    axes.set_xticks(m)
    axes.set_xlabel("pieces m of the slefe")
    axes.set_ylabel("$k_m$, with 95 % intervals")
    whose = "all scenes" if fits[0]["scene"] == "all" else fits[0]["scene"]
    axes.set_title(f"fitted constants, {whose}")
    legend_below(part)


def _plot_models(part: Any, models: Rows) -> None:
    """Triangles over minimal against the share that is unsafe where it was not fitted."""
    axes = part.subplots()
    names = list(dict.fromkeys(row["model"] for row in models))
    scenes = list(dict.fromkeys(row["scene"] for row in models))
    floor = 1e-4
    # the largest marks below, so that models at the same place are all seen
    for name, colour, size in zip(names, _MODEL_COLOURS, (14, 11.5, 9, 6.5), strict=False):
        for scene, mark in zip(scenes, cycle(MARKS)):
            row = next(r for r in models if r["model"] == name and r["scene"] == scene)
            if np.isnan(row["held_out_share_unsafe"]):
                continue
            share = max(floor, row["held_out_share_unsafe"])
            axes.plot(row["triangles_over_minimal"], share, mark, ms=size, color=colour, alpha=0.85, mec=BACKGROUND)
    axes.set_yscale("log")
    axes.set_ylim(0.6 * floor, 2.0)
    axes.set_yticks([floor, 1e-3, 1e-2, 0.1, 1.0], ["none", "0.1 %", "1 %", "10 %", "100 %"])
    axes.set_xscale("log")
    axes.axvline(1.0, color=INK, lw=1, ls=":")
    axes.set_xlabel("triangles over those of minimal factors")
    axes.set_ylabel("unsafe patches, where it was not fitted")
    axes.set_title("what each model costs, and what it leaves unsafe")
    models_shown = [
        Line2D([], [], marker="o", ls="", color=colour, label=name.replace("k_3", "$k_3$"))
        for name, colour in zip(names, _MODEL_COLOURS, strict=False)
    ]
    scenes_shown = [
        Line2D([], [], marker=mark, ls="", color=QUIET, label=scene) for scene, mark in zip(scenes, cycle(MARKS))
    ]
    legend_below(part, [*models_shown, *scenes_shown])
