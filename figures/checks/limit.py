"""Where patches are far from the limit surface, and what its smoothness looks like in a mirror."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from matplotlib.colors import LogNorm
from matplotlib.patches import Polygon

from slefejax.figures.style import BACKGROUND, FACTOR_MAP, SETTINGS, new_figure, occupied, save

_MARKED = {"edgecolor": "#d55e00", "linewidth": 2.0}  # [OI]
_DECADES = 3.0  # of the colours: distances below a thousandth of the largest have the darkest


class Pictures(NamedTuple):
    """Pictures ``(height, width)``, row 0 at the top, NaN for background, and what each of them is."""

    values: list[np.ndarray]
    titles: list[str]
    scene: str


def write_limit_figure(path: Path, pictures: Pictures) -> None:
    """Distances in per cent, one scale for all; what is the limit surface itself is grey."""
    highest = max(1e-12, *(float(np.nanmax(picture, initial=0.0)) for picture in pictures.values))
    norm = LogNorm(10.0**-_DECADES * highest, highest)
    shown: Any = None
    with mpl.rc_context({**SETTINGS, "axes.grid": False}):
        axes, figure, crop = _panels(pictures)
        colours = mpl.colormaps[FACTOR_MAP].with_extremes(bad=BACKGROUND)
        for own, picture in zip(axes, pictures.values, strict=True):
            exact = np.where(picture[crop] == 0.0, 0.8, np.nan)
            shown = own.imshow(np.clip(picture[crop], norm.vmin, None), cmap=colours, norm=norm)
            own.imshow(exact, cmap="gray", vmin=0.0, vmax=1.0)
        bar = figure.colorbar(shown, ax=axes, shrink=0.8, extend="min")
        bar.set_label("distance, % of the diagonal\n(grey: exact)")
        figure.suptitle(f"{pictures.scene}{_break(axes)}distance from the limit surface")
        save(figure, path)


def write_reflection_figure(path: Path, pictures: Pictures) -> None:
    """Stripes of a reflected environment, side by side."""
    with mpl.rc_context({**SETTINGS, "axes.grid": False}):
        axes, figure, crop = _panels(pictures)
        for own, picture in zip(axes, pictures.values, strict=True):
            _stripes(own, picture[crop])
        figure.suptitle(f"{pictures.scene}{_break(axes)}stripes reflected where normals of the first patches jump most")
        save(figure, path)


def write_normal_figure(path: Path, whole: Pictures, near: list[np.ndarray], frame: np.ndarray) -> None:
    """Stripes of a reflected environment as drawn normals show them, a column a kind of normals.

    near  : what is shown below, of the part of the whole that has these corners
    frame : ``(4, 2)``, pixels from the upper left corner
    """
    crop = occupied(~np.isnan(whole.values[0]))
    height, width = whole.values[0][crop].shape
    with mpl.rc_context({**SETTINGS, "axes.grid": False}):
        figure = new_figure(10.5, 6.4 + 5.0 * height / width)
        grid: Any = figure.subplots(2, 2, height_ratios=[height / width, 1.0])
        for column, (title, picture, part) in enumerate(zip(whole.titles, whole.values, near, strict=True)):
            _stripes(grid[0, column], picture[crop])
            grid[0, column].set_title(title)
            grid[0, column].add_patch(Polygon(frame - [crop[1].start, crop[0].start], fill=False, **_MARKED))
            _stripes(grid[1, column], part)
        figure.suptitle(f"{whole.scene}: stripes reflected by drawn normals; below, from near, the part in the frame")
        save(figure, path)


def _stripes(axes: Any, picture: np.ndarray) -> None:
    """Background is white."""
    axes.imshow(np.where(np.isnan(picture), 1.0, 0.15 + 0.75 * picture), cmap="gray", vmin=0.0, vmax=1.0)
    axes.set_axis_off()


def _break(axes: Any) -> str:
    """After the scene's name: a line of its own above a single panel, which is narrow."""
    return ": " if len(axes) > 1 else "\n"


def _panels(pictures: Pictures) -> tuple[Any, Any, Any]:
    """A panel a picture, without axes, and the part of all pictures that is shown."""
    crop = occupied(np.any([~np.isnan(picture) for picture in pictures.values], axis=0))
    height, width = pictures.values[0][crop].shape
    count = len(pictures.values)
    figure = new_figure(5.0 * count + 1.0, 1.4 + 5.0 * min(1.3, height / width))
    axes = np.atleast_1d(figure.subplots(1, count))
    for own, title in zip(axes, pictures.titles, strict=True):
        own.set_title(title)
        own.set_axis_off()
    return axes, figure, crop
