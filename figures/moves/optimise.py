"""Triangles of patches before and after their control points were moved, and where on the model they became fewer."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import TwoSlopeNorm

from slefejax.figures.page import Page
from slefejax.figures.style import COLOURS, DIVERGING_MAP, INK, LINES, drawing, legend_below

_UNCHANGED = 0.1  # per cent, that a bar reaches where nothing changes
_STYLES = {"optimised for": (COLOURS[0], "o"), "held out": (COLOURS[1], "^")}


def write_optimise(
    page: Page,
    seen: tuple[list[np.ndarray], list[np.ndarray]],
    counts: dict[str, tuple[np.ndarray, np.ndarray]],
    shape: tuple[int, ...],
    scene: str,
) -> None:
    """The model on the left, patches against themselves on the right.

    seen   : polygons of control nets in pixels, and the numbers of their control points, patch by patch
    counts : by set of views, triangles ``(patches,)`` before and after, summed over the views
    shape  : of the control points, ``(patches, du+1, dv+1, 3)``
    """
    title = f"{scene}: inner control points moved along gradients, and how many triangles that saves"
    with drawing(page, 14, 6.6, title) as figure:
        left, right = figure.subfigures(1, 2, width_ratios=[1.25, 1])
        _plot_model(left, seen, counts["held out"], shape)
        _plot_patches(right, counts)


def _plot_model(part: Any, seen: Any, counts: tuple[np.ndarray, np.ndarray], shape: tuple[int, ...]) -> None:
    axes = part.subplots()
    before, after = counts
    share = 100.0 * (after - before) / np.maximum(before, 1.0)
    polygons, corners = seen
    values = share[[own[0] // (shape[1] * shape[2]) for own in corners]]
    low, high = float(values.min(initial=0.0)), float(values.max(initial=0.0))
    if low == high:
        low, high = -_UNCHANGED, _UNCHANGED
    limit = max(-low, high)
    norm = TwoSlopeNorm(0.0, -limit, limit)
    faces = PolyCollection(polygons, cmap=DIVERGING_MAP, norm=norm, edgecolors=LINES, linewidths=0.25)
    faces.set_array(values)
    axes.add_collection(faces)
    axes.autoscale_view()
    axes.set_aspect("equal")
    axes.grid(visible=False)
    axes.set_xlabel("x (pixels)")
    axes.set_ylabel("y (pixels)")
    axes.set_title("moved control nets")
    bar = part.colorbar(faces, ax=axes, shrink=0.8, label="change of triangles in views held out (%)")
    bar.ax.set_ylim(low, high)  # the colours are as strong on both sides of 0; the bar has those that are there


def _plot_patches(part: Any, counts: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    axes = part.subplots()
    for name, (before, after) in counts.items():
        colour, mark = _STYLES[name]
        drawn = before > 0
        fewer = 100.0 * (1.0 - after.sum() / max(before.sum(), 1.0))
        label = f"views {name}: {abs(fewer):.1f} % {'fewer' if fewer >= 0 else 'more'} in all"
        change = 100.0 * (after[drawn] / before[drawn] - 1.0)
        axes.plot(before[drawn], change, mark, color=colour, ms=6, alpha=0.8, label=label)
    axes.axhline(0.0, color=INK, lw=0.8)
    axes.set_xscale("log")
    axes.set_xlabel("triangles of a patch before, all views of a kind")
    axes.set_ylabel("change of its triangles (%)")
    axes.set_title("a mark is a patch")
    legend_below(part)
