"""What the published estimate says and what is needed: constants, residuals, and the twist that it does not see."""

from __future__ import annotations

from itertools import cycle
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes

from slefejax.figures.style import SETTINGS, new_figure, save

Rows = list[dict[str, Any]]
_MARKS = "os^Dv*PX<>hpd8"
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#000000")
_MODEL_COLOURS = ("#d55e00", "#e69f00", "#0072b2", "#009e73")  # estimate as published, fitted, with twist, certified
_ESTIMATORS: dict[str, dict[str, Any]] = {
    "largest": {"color": "#d55e00", "marker": "^"},
    "quantile": {"color": "#0072b2", "marker": "o"},
    "least-squares": {"color": "#cc79a7", "marker": "s"},
}
_MOST = 4000  # dots a scene
_PIECES = (1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 500)


def write_fit_km(
    path: Path, points: list[tuple[str, Any, Any]], fits: Rows, curves: Rows, models: Rows, m: int, target: float
) -> None:
    """Four panels: needed against predicted; the ratio against twist; k_m against m; what each model costs and leaves.

    points : for every scene its name, the terms m^2 w / tolerance, and its samples
    fits   : rows of one set of samples, a number of segments each;  curves : rows a number of segments
    models : rows a scene and model, those with a time belonging to scenes that were fitted
    """
    k = next(row["quantile"] for row in fits if row["segments"] == m)
    with mpl.rc_context(SETTINGS):
        figure = new_figure(14, 11)
        first, second, third, fourth = figure.subplots(2, 2).ravel()
        shown = [(name, *_chosen(slefe, samples)) for name, slefe, samples in points]
        hidden = sum(int(np.sum((samples.minimal > 1) & (slefe <= 0))) for _, slefe, samples in points)
        beyond = f"\n{hidden:,} more need pieces though the estimate is 0" if hidden else ""
        _plot_factors(first, shown, k, m, target, beyond)
        _plot_ratios(second, shown, k, m)
        _plot_constants(third, fits, curves)
        _plot_models(fourth, models)
        figure.suptitle("The published estimate $k_m\\,m\\,\\sqrt{w/\\mathrm{tolerance}}$ against what is needed")
        save(figure, path)


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


def _plot_factors(axes: Axes, shown: list[Any], k: float, m: int, target: float, beyond: str) -> None:
    for (name, estimate, needed, _), mark, colour in zip(shown, _MARKS, _COLOURS * 2, strict=False):
        axes.plot(estimate, needed, mark, ms=_dot(needed), alpha=0.4, mew=0, color=colour, label=name)
    every = np.concatenate([estimate for _, estimate, *_ in shown])
    ends = np.array([every.min(), every.max()]) if len(every) else np.array([1.0, 10.0])
    axes.plot(ends, ends, "k:", lw=1.4, label="k = 1")
    if np.isfinite(k):
        axes.plot(ends, k * ends, "k-", lw=1.8, label=f"$k_{m}$ = {k:.3f}, {100 * target:g} % below")
    axes.set_xscale("log")
    axes.set_yscale("log")
    _plain_ticks(axes, "x", _PIECES)
    _plain_ticks(axes, "y", _PIECES)
    axes.set_xlabel(f"estimate $m\\sqrt{{w/\\mathrm{{tolerance}}}}$, m = {m} (pieces)")
    axes.set_ylabel("needed τ* (pieces)")
    axes.set_title("a dot a patch and view; above a line the constant is too small" + beyond)
    _legend(axes)


def _plot_ratios(axes: Axes, shown: list[Any], k: float, m: int) -> None:
    for (name, estimate, needed, twist), mark, colour in zip(shown, _MARKS, _COLOURS * 2, strict=False):
        axes.plot(
            np.maximum(twist, 1e-3),
            needed / estimate,
            mark,
            ms=_dot(needed),
            alpha=0.4,
            mew=0,
            color=colour,
            label=name,
        )
    axes.axhline(1.0, color="black", ls=":", lw=1.4)
    if np.isfinite(k):
        axes.axhline(k, color="black", lw=1.8)
    if not any(len(needed) for *_, needed, _ in shown):
        axes.text(0.5, 0.5, "the estimate is 0 for every patch", transform=axes.transAxes, ha="center")
        axes.set_xlim(1e-3, 10.0)
    axes.set_xscale("log")
    _plain_ticks(axes, "x", (1e-3, 0.01, 0.1, 0.2, 0.5, 1, 2, 5, 10, 100))
    axes.set_xlabel("twist over m² w (what the estimate does not see over what it does)")
    axes.set_ylabel(f"needed over estimate, m = {m}")
    axes.set_title("patches with much twist break the estimate")
    _legend(axes)


def _plot_constants(axes: Axes, fits: Rows, curves: Rows) -> None:
    for shift, (estimator, style) in zip((-0.08, 0.0, 0.08), _ESTIMATORS.items(), strict=True):
        own = [row for row in fits if np.isfinite([row[estimator], row[f"{estimator}_high"]]).all()]
        if own:
            k = np.array([row[estimator] for row in own])
            spread = [k - [row[f"{estimator}_low"] for row in own], [row[f"{estimator}_high"] for row in own] - k]
            at = np.array([row["segments"] for row in own]) + shift
            axes.errorbar(at, k, yerr=np.maximum(spread, 0.0), capsize=3, ls="--", lw=1, label=estimator, **style)
    m = [row["segments"] for row in curves]
    axes.plot(m, [row["analytic_cubic"] for row in curves], "k-", lw=1.8, label="cubics in one variable, analytic")
    measured = [max(row["k_random"], row["k_one_bend"]) for row in curves]
    axes.plot(m, measured, "kx", ms=8, label="the same, measured")
    axes.axhspan(1.0, 1.5, color="#999999", alpha=0.15, lw=0, label="published: between 1.5 and 1")
    axes.set_xticks(m)
    axes.set_xlabel("pieces m of the slefe")
    axes.set_ylabel("$k_m$, with 95 % intervals")
    whose = "all scenes" if fits[0]["scene"] == "all" else fits[0]["scene"]
    axes.set_title(f"fitted constants, {whose}")
    axes.legend(fontsize=10, ncols=2, loc="upper right")
    axes.set_ylim(top=axes.get_ylim()[1] + 0.35 * np.diff(axes.get_ylim())[0])


def _plot_models(axes: Axes, models: Rows) -> None:
    """Triangles over minimal against the share that is unsafe where it was not fitted."""
    names = list(dict.fromkeys(row["model"] for row in models))
    scenes = list(dict.fromkeys(row["scene"] for row in models))
    floor = 1e-4
    # the largest marks below, so that models at the same place are all seen
    for name, colour, size in zip(names, _MODEL_COLOURS, (13, 10, 7.5, 5), strict=False):
        for scene, mark in zip(scenes, cycle(_MARKS)):
            row = next(r for r in models if r["model"] == name and r["scene"] == scene)
            if np.isnan(row["held_out_share_unsafe"]):
                continue
            share = max(floor, row["held_out_share_unsafe"])
            axes.plot(row["triangles_over_minimal"], share, mark, ms=size, color=colour, alpha=0.85, mec="white")
    for name, colour in zip(names, _MODEL_COLOURS, strict=False):
        axes.plot([], [], "o", color=colour, label=name)
    for scene, mark in zip(scenes, cycle(_MARKS)):
        axes.plot([], [], mark, color="#777777", label=scene)
    axes.set_yscale("log")
    axes.set_ylim(0.6 * floor, 2.0)
    axes.set_yticks([floor, 1e-3, 1e-2, 0.1, 1.0], ["none", "0.1 %", "1 %", "10 %", "100 %"])
    axes.set_xscale("log")
    _plain_ticks(axes, "x", (0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 1.5, 2, 3, 5))
    axes.axvline(1.0, color="black", lw=1, ls=":")
    axes.set_xlabel("triangles over those of minimal factors")
    axes.set_ylabel("unsafe patches, where it was not fitted")
    axes.set_title("what each model costs, and what it leaves unsafe")
    axes.legend(fontsize=9, ncols=2, loc="center left")


def _plain_ticks(axes: Axes, which: str, ticks: tuple[float, ...]) -> None:
    """Those of the ticks that lie on a logarithmic axis, as plain numbers."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = axis.get_view_interval()
    axis.set_ticks([t for t in ticks if low <= t <= high], [f"{t:g}" for t in ticks if low <= t <= high])
    axis.set_ticks([], minor=True)


def _legend(axes: Axes) -> None:
    for handle in axes.legend(fontsize=10).legend_handles:
        if handle is not None:
            handle.set_alpha(1.0)
