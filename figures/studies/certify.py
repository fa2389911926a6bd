"""Where the published estimate fails and the certified factor holds, and what the proof costs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from slefejax.figures.error_image import read_error_image
from slefejax.figures.fitting import wrapped
from slefejax.figures.page import Page
from slefejax.figures.style import (
    INK,
    SMALL,
    bar_numbers,
    bare,
    drawing,
    error_legend,
    legend_below,
    level,
    method_style,
    occupied,
)

Rows = list[dict[str, Any]]
_TALL = 5.2  # inches of a line of pictures
_PANELS, _GROUP = 6.2, 0.9  # inches of the panels below, at least, and of a group of bars
_NAME = 110.0  # points for the name of a scene


def write_certify_figure(page: Page, rows: Rows, summary: Rows, images: list[list[Path]], tolerance: float) -> None:
    """A line of pictures a scene (certified, slefe), and below errors patch by patch, triangles and time.

    rows, summary : a row a patch, a row a scene and method
    images        : for every scene the error images of the certified factor, and of the estimate if it has one
    """
    names = list(dict.fromkeys(row["scene"] for row in summary))
    title = f"Asked for at most {tolerance:g} px: how far is each pixel from where its texture belongs, and what does"
    heights = [_TALL * len(names) + 0.6, max(_PANELS, 1.6 + _GROUP * len(names))]
    with drawing(page, 15, sum(heights), f"{title} a factor with a proof cost?") as figure:
        top, bottom = figure.subfigures(2, 1, height_ratios=heights)
        across = max(map(len, images))
        grid = np.reshape(top.subplots(len(names), across), (len(names), across))
        for line, name, own_images in zip(grid, names, images, strict=True):
            pictures = [read_error_image(image) for image in own_images]
            box = occupied(np.any([np.any(picture != 1.0, axis=-1) for picture in pictures], axis=0))
            own = {row["method"]: row for row in summary if row["scene"] == name}
            for axes, picture, method in zip(line, pictures, ("certified", "slefe"), strict=False):
                axes.imshow(picture[box], interpolation="nearest")
                axes.set_title(_picture_title(own[method]))
            for axes in line:
                bare(axes, axes.get_title())
        error_legend(top)
        left, right = bottom.subfigures(1, 2, width_ratios=[1, 1.6])
        _plot_errors(left, rows, tolerance)
        _plot_costs(right, summary, names)


def _picture_title(row: dict[str, Any]) -> str:
    return (
        f"{row['scene']}, {row['method']}: {row['triangles']:,} triangles\nworst pixel {row['max_error_px']:.2f} px;"
        f" over the domain {max(row['sup_error_px'], row['drawn_sup_error_px']):.2f} px,"
        f" {row['patches_above']} of {row['patches']} patches above"
    )


def _plot_errors(part: Any, rows: Rows, tolerance: float) -> None:
    """The largest error of every visible patch, in order of the estimate's."""
    axes = part.subplots()
    seen = [row for row in rows if row["minimal"] > 0]
    for method, prefix in (("slefe", "slefe_"), ("certified", "")):
        worst = np.array([max(row[f"{prefix}sup_error_px"], row[f"{prefix}drawn_sup_error_px"]) for row in seen])
        there = worst[~np.isnan(worst)]
        if there.size:
            axes.plot(np.sort(np.maximum(there, 1e-3)), ls="", ms=5, label=method, **method_style(method))
    level(axes, tolerance, f"tolerance {tolerance:g} px")
    axes.set_yscale("log")
    axes.set_xlabel("patches, each method in order of its errors")
    axes.set_ylabel("largest error over the domain (pixels)")
    axes.set_title("does it hold? (uniform and as drawn)")
    legend_below(part)


def _plot_costs(part: Any, summary: Rows, names: list[str]) -> None:
    """Triangles over minimal ones, and times over those of the quickest method of a scene."""
    left, right = part.subplots(1, 2, sharey=True)
    minimal = {row["scene"]: row["minimal_triangles"] for row in summary}
    quickest = {name: min(row["predict_ms"] for row in summary if row["scene"] == name) for name in names}
    left.set_xscale("log")
    _bars(left, summary, names, "triangles", minimal, "{:.2f}")
    left.set_xlabel("triangles drawn, over minimal")
    left.set_title("what it costs in triangles")
    _bars(right, summary, names, "predict_ms", quickest, "{:.2g} ms")
    right.set_xlabel("time of a view, over the quickest method's")
    right.set_title("what it costs in time, once compiled")
    legend_below(part)


def _bars(axes: Axes, summary: Rows, names: list[str], key: str, unit: dict[str, float], form: str) -> None:
    """A group of bars a scene, a bar a method, over the scene's unit; numbers are ratios, or the times themselves."""
    methods = list(dict.fromkeys(row["method"] for row in summary))
    for k, method in enumerate(methods):
        own = {row["scene"]: row[key] for row in summary if row["method"] == method}
        there = [i for i, name in enumerate(names) if name in own and unit[name] > 0]
        lengths = [own[names[i]] / unit[names[i]] for i in there]
        places = np.array(there) + 0.27 * (k - (len(methods) - 1) / 2)
        bars = axes.barh(places, lengths, 0.25, label=method, color=method_style(method)["color"])
        said = lengths if key == "triangles" else [own[names[i]] for i in there]
        bar_numbers(axes, bars, [form.format(value) for value in said])
    axes.axvline(1.0, color=INK, lw=1, zorder=0.5)
    axes.grid(axis="y", visible=False)
    axes.set_ylim(len(names) - 0.5, -0.5)
    axes.set_yticks(range(len(names)), [wrapped(name, _NAME, SMALL) for name in names])
