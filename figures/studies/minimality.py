"""The minimality sweep: factors on the patches, bad pixels against the scale, and an error image a scale."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.image import imread

from slefejax.figures.style import (
    BACKGROUND,
    FACTOR_MAP,
    METHOD_STYLES,
    SETTINGS,
    error_legend,
    new_figure,
    occupied,
    save,
)

Box = tuple[slice, slice]
Label = tuple[float, float, str]


def write_factor_map(path: Path, factor: np.ndarray, labels: list[Label]) -> None:
    """The factor of the patch that is seen at every pixel; ``factor`` has row 0 at the bottom, NaN is background.

    labels : (column, row, text) to write on the picture
    """
    with mpl.rc_context(SETTINGS):
        figure = new_figure(10, 6.2)
        axes = figure.subplots()
        _paint_factors(axes, factor, labels, occupied(~np.isnan(factor)))
        save(figure, path)


def write_minimality_figure(
    path: Path,
    rows: list[dict[str, Any]],
    images: list[Path],
    factor: np.ndarray,
    labels: list[Label],
    scene: str,
    asked: str,
) -> None:
    """Everything on one page. ``rows`` and ``images``: one a scale each; ``factor``, ``labels``: ``write_factor_map``.

    asked : the tolerances that the factors were predicted for, in words
    """
    columns = 3
    lines = -(-len(rows) // columns)
    with mpl.rc_context(SETTINGS):
        figure = new_figure(15, 5.2 + 3.6 * lines)
        halves: Any = figure.subfigures(2, 1, height_ratios=[5.2, 3.6 * lines])
        top, bottom = halves
        box = occupied(~np.isnan(factor))
        left, right = top.subplots(1, 2, width_ratios=[1.25, 1])
        _paint_factors(left, factor, labels, box)
        _plot_shares(right, rows)
        grid = np.ravel(bottom.subplots(lines, columns))
        for axes, row, image in zip(grid, rows, images, strict=False):
            _show_errors(axes, row, imread(image), box)
        for axes in grid[len(rows) :]:
            axes.set_axis_off()
        error_legend(bottom)
        first = rows[0]
        figure.suptitle(
            f"{scene}: is the predicted tessellation safe, and would less do?  Factors predicted ({first['method']})"
            f" for an error of at most {asked} are multiplied by a scale,\nthe"
            f" {first['patches']} patches rendered, and each pixel compared with the exact surface: how far is it from"
            " where its texture belongs?",
            fontsize=13,
        )
        save(figure, path)


def _paint_factors(axes: Axes, factor: np.ndarray, labels: list[Label], box: Box) -> None:
    picture = axes.imshow(factor[box], origin="lower", cmap=FACTOR_MAP, interpolation="nearest")
    for column, row, text in labels:
        place = (column - box[1].start, row - box[0].start)
        frame = {"fc": "white", "ec": "none", "alpha": 0.7}
        axes.annotate(text, place, ha="center", va="center", fontsize=9, bbox=frame)
    _bare(axes, "predicted tessellation factor of each patch, before scaling")
    bar = axes.figure.colorbar(picture, ax=axes, shrink=0.85)
    bar.set_label("factor: pieces along each side")


def _plot_shares(axes: Axes, rows: list[dict[str, Any]]) -> None:
    rows = sorted(rows, key=lambda row: row["scale"])
    scales = [row["scale"] for row in rows]
    for limit, style, grey in ((0.1, "s:", "0.55"), (0.5, "o-", "0.0"), (1.0, "^--", "0.3")):
        shares = [100 * row[f"share_above_{limit:g}"] for row in rows]
        axes.plot(scales, shares, style, color=grey, label=f"more than {limit:g} px off")
    if "slefe_share_above_0.5" in rows[0]:
        shares = [100 * row["slefe_share_above_0.5"] for row in rows]
        axes.plot(scales, shares, "o-", color=METHOD_STYLES["slefe"]["color"], label="slefe: more than 0.5 px off")
    axes.set_yscale("symlog", linthresh=0.01)
    axes.set_ylim(0, 150)
    ticks = [0, 0.01, 0.1, 1, 10, 100]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xlabel("scale of the predicted factors")
    axes.set_ylabel("share of the covered pixels (%)")
    axes.set_title("pixels that are off, against the scale")
    axes.legend(loc="lower left", frameon=True)


def _show_errors(axes: Axes, row: dict[str, Any], image: np.ndarray, box: Box) -> None:
    axes.imshow(image[::-1][box], origin="lower", interpolation="nearest")
    turned = f",  normals {row['max_normal_error_deg']:.2f}° off" if "max_normal_error_deg" in row else ""
    _bare(
        axes,
        f"scale {row['scale']:g}:  {row['triangles']:,} triangles{turned}\n{100 * row['share_above_0.5']:.2g} % of the"
        f" pixels off by more than ½ px,  worst {row['max_error_px']:.2f} px",
    )


def _bare(axes: Axes, title: str) -> None:
    axes.set_title(title)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor(BACKGROUND)
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)
