"""A model in four pictures: its control mesh, its patches by kind, their factors, the error of every pixel."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from slefejax.figures.error_image import error_colours
from slefejax.figures.style import BACKGROUND, ERROR_CLASSES, FACTOR_MAP, SETTINGS, new_figure, occupied, save

# Colours for the colour-blind [OI]
KIND_COLOURS = {
    "regular": "#d9d9d9",
    "extraordinary": "#56b4e9",
    "boundary": "#009e73",
    "crease": "#e69f00",
    "triangle": "#cc79a7",
    "spline": "#d9d9d9",
    "bezier": "#d9d9d9",
}


@dataclass(frozen=True)
class Panels:
    """What is shown. Images have row 0 at the bottom.

    outlines : polygons ``(corners, 2)`` in pixels, the furthest first
    patch    : number of the patch at every pixel, -1 for background
    kind     : number in ``kinds`` of the patch at every pixel, -1 for background
    factor   : of the patch at every pixel, NaN for background;  error : pixels, NaN for background
    """

    outlines: list[np.ndarray]
    patch: np.ndarray
    kind: np.ndarray
    kinds: tuple[str, ...]
    factor: np.ndarray
    error: np.ndarray


def write_inspect_figure(path: Path, panels: Panels, title: str, tolerance: float) -> None:
    """Draw the four pictures; ``tolerance`` is the error in pixels that the factors are for."""
    box = _with_outlines(occupied(panels.kind >= 0), panels)
    with mpl.rc_context(SETTINGS):
        figure = new_figure(13, 10)
        grid: Any = figure.subplots(2, 2)
        _control_mesh(grid[0, 0], panels, box)
        _kinds(grid[0, 1], panels, box)
        _factors(grid[1, 0], panels, box, tolerance)
        _errors(grid[1, 1], panels, box)
        figure.suptitle(title, fontsize=14)
        save(figure, path)


def _with_outlines(box: Any, panels: Panels) -> Any:
    """Rows and columns of what is shown, the control mesh included as far as it is on the screen."""
    if not panels.outlines:
        return box
    points = np.concatenate(panels.outlines)
    low, high = np.floor(points.min(axis=0)).astype(int), np.ceil(points.max(axis=0)).astype(int)
    height, width = panels.kind.shape
    rows = slice(max(0, min(box[0].start, low[1])), min(height, max(box[0].stop, high[1])))
    return rows, slice(max(0, min(box[1].start, low[0])), min(width, max(box[1].stop, high[0])))


def _control_mesh(axes: Any, panels: Panels, box: Any) -> None:
    thin = 0.8 if len(panels.outlines) < 2000 else 0.3
    faces = PolyCollection(panels.outlines, facecolors="#f4f1ea", edgecolors="#303030", linewidths=thin)
    axes.add_collection(faces)
    axes.set_xlim(box[1].start, box[1].stop)
    axes.set_ylim(box[0].start, box[0].stop)
    axes.set_aspect("equal")
    _bare(axes, "control mesh")


def _kinds(axes: Any, panels: Panels, box: Any) -> None:
    colours = [BACKGROUND, *(KIND_COLOURS[kind] for kind in panels.kinds)]
    image = panels.kind[box] + 1
    axes.imshow(
        image, origin="lower", cmap=ListedColormap(colours), vmin=0, vmax=len(colours) - 1, interpolation="nearest"
    )
    _edges(axes, panels, box)
    present = [kind for number, kind in enumerate(panels.kinds) if np.any(panels.kind == number)]
    handles = [Patch(facecolor=KIND_COLOURS[kind], edgecolor="0.5", label=kind) for kind in present]
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3, frameon=False)
    _bare(axes, "patches by kind")


def _edges(axes: Any, panels: Panels, box: Any) -> None:
    """Thin lines where one patch ends."""
    value = panels.patch[box]
    change = np.zeros(value.shape, bool)
    change[:, 1:] |= value[:, 1:] != value[:, :-1]
    change[1:] |= value[1:] != value[:-1]
    layer = np.zeros((*value.shape, 4))
    layer[change] = (0.2, 0.2, 0.2, 0.55)
    axes.imshow(layer, origin="lower", interpolation="nearest")


def _factors(axes: Any, panels: Panels, box: Any, tolerance: float) -> None:
    picture = axes.imshow(panels.factor[box], origin="lower", cmap=FACTOR_MAP, interpolation="nearest")
    bar = axes.figure.colorbar(picture, ax=axes, shrink=0.8)
    bar.set_label("factor: pieces along each side")
    _bare(axes, f"certified tessellation factors for {tolerance:g} px")


def _errors(axes: Any, panels: Panels, box: Any) -> None:
    axes.imshow(error_colours(panels.error)[::-1][box], origin="lower", interpolation="nearest")
    handles = [Patch(facecolor=colour, label=name) for _, colour, name in ERROR_CLASSES]
    axes.legend(handles=handles, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=4, frameon=False)
    _bare(axes, f"error of every pixel as drawn, at most {np.nanmax(panels.error):.2g} px")


def _bare(axes: Any, title: str) -> None:
    axes.set_title(title)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.grid(False)
    for spine in axes.spines.values():
        spine.set_visible(False)
