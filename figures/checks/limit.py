"""Where patches are far from the limit surface, and what its smoothness looks like in a mirror."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.colors import ListedColormap, LogNorm
from matplotlib.patches import Patch, Polygon

from slefejax.figures.fitting import log_ticks
from slefejax.figures.page import Page
from slefejax.figures.style import (
    BACKGROUND,
    FACTOR_MAP,
    GREY_MAP,
    LINES,
    MARKED,
    PLAIN,
    bare,
    drawing,
    legend_below,
    occupied,
)

_DECADES = 3.0  # of the colours: distances below a thousandth of the largest have the darkest


class Pictures(NamedTuple):
    """Pictures ``(height, width)``, row 0 at the top, NaN for background, and what each of them is."""

    values: list[np.ndarray]
    titles: list[str]
    scene: str


def write_limit_figure(page: Page, pictures: Pictures) -> None:
    """Distances in per cent, one scale for all; what is the limit surface itself is grey."""
    highest = max(1e-12, *(float(np.nanmax(picture, initial=0.0)) for picture in pictures.values))
    lowest = 10.0**-_DECADES * highest
    norm = LogNorm(lowest, highest)
    shown: Any = None
    with _panels(page, pictures, "how far patches are from the limit surface") as (axes, figure, crop):
        colours = mpl.colormaps[FACTOR_MAP].with_extremes(bad=BACKGROUND)
        exact = ListedColormap([PLAIN])
        for own, picture in zip(axes, pictures.values, strict=True):
            shown = own.imshow(np.clip(picture[crop], lowest, None), cmap=colours, norm=norm)
            own.imshow(np.where(picture[crop] == 0.0, 1.0, np.nan), cmap=exact)
        bar = figure.colorbar(shown, ax=axes, shrink=0.8, extend="min", label="distance (% of the diagonal)")
        log_ticks(bar.ax.yaxis, lowest, highest)
        if any(np.any(picture[crop] == 0.0) for picture in pictures.values):
            legend_below(figure, [Patch(facecolor=PLAIN, edgecolor=LINES, label="the limit surface itself")])


def write_reflection_figure(page: Page, pictures: Pictures) -> None:
    """Stripes of a reflected environment, side by side."""
    what = "stripes reflected where normals of the first patches jump most"
    with _panels(page, pictures, what) as (axes, _, crop):
        for own, picture in zip(axes, pictures.values, strict=True):
            _stripes(own, picture[crop])


def write_normal_figure(page: Page, whole: Pictures, near: list[np.ndarray], frame: np.ndarray) -> None:
    """Stripes of a reflected environment as drawn normals show them, a column a kind of normals.

    near  : what is shown below, of the part of the whole that has these corners
    frame : ``(4, 2)``, pixels from the upper left corner
    """
    crop = occupied(~np.isnan(whole.values[0]))
    height, width = whole.values[0][crop].shape
    title = f"{whole.scene}: stripes reflected by drawn normals; below, from near, the part in the frame"
    with drawing(page, 10.5, 6.0 + 5.0 * height / width, title, grid=False) as figure:
        grid: Any = figure.subplots(2, 2, height_ratios=[height / width, 1.0])
        for column, (heading, picture, part) in enumerate(zip(whole.titles, whole.values, near, strict=True)):
            _stripes(grid[0, column], picture[crop])
            grid[0, column].set_title(heading)
            outline = {"edgecolor": MARKED, "linewidth": 2.0}
            grid[0, column].add_patch(Polygon(frame - [crop[1].start, crop[0].start], fill=False, **outline))
            _stripes(grid[1, column], part)


def _stripes(axes: Any, picture: np.ndarray) -> None:
    """Background is white."""
    axes.imshow(np.where(np.isnan(picture), 1.0, stripe_greys(picture)), cmap=GREY_MAP, vmin=0.0, vmax=1.0)
    axes.set_axis_off()


def stripe_greys(stripes: np.ndarray) -> np.ndarray:
    """Of stripes, 0 to 1: neither black nor the white of the background."""
    return 0.15 + 0.75 * stripes


@contextmanager
def _panels(page: Page, pictures: Pictures, what: str) -> Iterator[tuple[Any, Any, Any]]:
    """A panel a picture, without axes; the figure; and the part of all pictures that is shown."""
    crop = occupied(np.any([~np.isnan(picture) for picture in pictures.values], axis=0))
    height, width = pictures.values[0][crop].shape
    count = len(pictures.values)
    size = 5.0 * count + 1.0, 1.6 + 5.0 * min(1.3, height / width)
    with drawing(page, *size, f"{pictures.scene}: {what}", grid=False) as figure:
        axes = np.atleast_1d(figure.subplots(1, count))
        for own, title in zip(axes, pictures.titles, strict=True):
            bare(own, title)
        yield axes, figure, crop
