"""The minimality sweep: factors on the patches, bad pixels against the scale, and an error image a scale."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.axes import Axes

from slefejax.figures.error_image import read_error_image
from slefejax.figures.page import Page
from slefejax.figures.style import (
    FACTOR_MAP,
    FAINT,
    INK,
    QUIET,
    bare,
    drawing,
    error_legend,
    hide_rest,
    legend_below,
    method_style,
    occupied,
    on_picture,
)

Box = tuple[slice, slice]
Label = tuple[float, float, str]


class Wire(NamedTuple):
    """The triangles of a scale, as colours of every pixel."""

    scale: float
    colours: np.ndarray


def write_factor_map(page: Page, factor: np.ndarray, labels: list[Label], scene: str, asked: str) -> None:
    """The factor of the patch that is seen at every pixel; ``factor`` has row 0 at the bottom, NaN is background.

    labels : (column, row, text) to write on the picture
    asked  : the tolerances that the factors were predicted for, in words
    """
    box = occupied(~np.isnan(factor))
    with drawing(
        page, 10, 0.8 + 8.0 * min(1.0, _tall(box)), f"{scene}: factors predicted for at most {asked}"
    ) as figure:
        _paint_factors(figure, factor, labels, box)


def write_minimality_figure(
    page: Page,
    rows: list[dict[str, Any]],
    images: list[Path],
    factor: np.ndarray,
    labels: list[Label],
    scene: str,
    asked: str,
    wire: Wire,
) -> None:
    """Everything on one page. ``rows`` and ``images``: one a scale each; the others: ``write_factor_map``.

    wire : the triangles of one scale
    """
    columns = min(3, len(rows))
    lines = -(-len(rows) // columns)
    box = occupied(~np.isnan(factor))
    heights = [6.0, (0.8 + 4.6 * min(1.2, max(0.4, _tall(box)))) * lines + 0.8]
    first = rows[0]
    title = (
        f"{scene}: is the predicted tessellation safe, and would less do? Factors predicted ({first['method']})"
        f" for an error of at most {asked} are multiplied by a scale, the"
        f" {first['patches']:,} patches rendered, and each pixel compared with the exact surface: how far is it from"
        " where its texture belongs?"
    )
    with drawing(page, 18, sum(heights), title) as figure:
        top, bottom = figure.subfigures(2, 1, height_ratios=heights)
        left, middle, right = top.subfigures(1, 3, width_ratios=[1.15, 1.0, 0.8])
        _paint_factors(left, factor, labels, box)
        _show_wire(middle, wire, box)
        _plot_shares(right, rows)
        grid = np.ravel(bottom.subplots(lines, columns))
        for axes, row, image in zip(grid, rows, images, strict=False):
            _show_errors(axes, row, read_error_image(image), box)
        hide_rest(grid, len(rows))
        error_legend(bottom)


def _tall(box: Box) -> float:
    """Height over width."""
    rows, columns = box
    return (rows.stop - rows.start) / (columns.stop - columns.start)


def _paint_factors(part: Any, factor: np.ndarray, labels: list[Label], box: Box) -> None:
    axes = part.subplots()
    picture = axes.imshow(factor[box], origin="lower", cmap=FACTOR_MAP, interpolation="nearest")
    for column, row, text in labels:
        on_picture(axes, (column - box[1].start, row - box[0].start), text)
    bare(axes, "predicted tessellation factor of each patch, before scaling")
    part.colorbar(picture, ax=axes, shrink=0.85, label="factor: pieces along each side")


def _show_wire(part: Any, wire: Wire, box: Box) -> None:
    axes = part.subplots()
    axes.imshow(wire.colours[box], origin="lower", interpolation="antialiased")
    bare(axes, f"the triangles that are drawn, scale {wire.scale:g}")


def _plot_shares(part: Any, rows: list[dict[str, Any]]) -> None:
    axes = part.subplots()
    rows = sorted(rows, key=lambda row: row["scale"])
    scales = [row["scale"] for row in rows]
    for limit, style, grey in ((0.1, "s:", FAINT), (0.5, "o-", INK), (1.0, "^--", QUIET)):
        shares = [100 * row[f"share_above_{limit:g}"] for row in rows]
        axes.plot(scales, shares, style, color=grey, label=f"more than {limit:g} px off")
    if "slefe_share_above_0.5" in rows[0]:
        shares = [100 * row["slefe_share_above_0.5"] for row in rows]
        axes.plot(scales, shares, "o-", color=method_style("slefe")["color"], label="slefe: more than 0.5 px off")
    axes.set_yscale("symlog", linthresh=0.01)
    axes.set_ylim(-0.002, 150)
    ticks = [0, 0.01, 0.1, 1, 10, 100]
    axes.set_yticks(ticks, [f"{tick:g}" for tick in ticks])
    axes.set_xlabel("scale of the predicted factors")
    axes.set_ylabel("share of the covered pixels (%)")
    axes.set_title("pixels that are off, against the scale")
    legend_below(part)


def _show_errors(axes: Axes, row: dict[str, Any], image: np.ndarray, box: Box) -> None:
    axes.imshow(image[::-1][box], origin="lower", interpolation="nearest")
    turned = f",  normals {row['max_normal_error_deg']:.2f}° off" if "max_normal_error_deg" in row else ""
    bare(
        axes,
        f"scale {row['scale']:g}:  {row['triangles']:,} triangles{turned}\n{100 * row['share_above_0.5']:.2g} % of the"
        f" pixels off by more than ½ px,  worst {row['max_error_px']:.2f} px",
    )
