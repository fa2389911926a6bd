"""A model in four pictures: its control mesh, its patches by kind, their factors, the error of every pixel."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.colors import ListedColormap
from matplotlib.patches import Patch

from slefejax.figures.error_image import error_colours
from slefejax.figures.page import Page
from slefejax.figures.style import (
    BACKGROUND,
    COLOURS,
    FACTOR_MAP,
    LINES,
    NET,
    PLAIN,
    bare,
    drawing,
    error_legend,
    legend_below,
    occupied,
)

KIND_COLOURS = {
    "regular": PLAIN,
    "extraordinary": COLOURS[5],
    "boundary": COLOURS[2],
    "crease": COLOURS[4],
    "triangle": COLOURS[3],
    "spline": PLAIN,
    "bezier": PLAIN,
}
_BEYOND = 1.0  # widths and heights of the picture that the control mesh is shown beyond its edges, at most


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


def write_inspect_figure(page: Page, panels: Panels, title: str, tolerance: str) -> None:
    """Draw the four pictures; ``tolerance`` is what the factors are for, with units."""
    box = occupied(panels.kind >= 0)
    net = _around(panels)
    down, across = (own.stop - own.start for own in box)
    tall = max(down / across, (net[1][1] - net[1][0]) / (net[0][1] - net[0][0]))
    with drawing(page, 13, 2 * (1.2 + 6.0 * min(1.05, max(0.45, tall))), title) as figure:
        parts: Any = figure.subfigures(2, 2)
        _control_mesh(parts[0, 0], panels, net)
        _kinds(parts[0, 1], panels, box)
        _factors(parts[1, 0], panels, box, tolerance)
        _errors(parts[1, 1], panels, box)


def _around(panels: Panels) -> tuple[tuple[float, float], tuple[float, float]]:
    """From where to where the control mesh is, along x and along y, in pixels: all of it, but for what is far away."""
    height, width = panels.kind.shape
    points = np.concatenate([*panels.outlines, np.zeros((0, 2))])
    if not len(points):
        return (0.0, float(width)), (0.0, float(height))
    size = np.array([width, height], float)
    low, high = (
        np.clip(own, -_BEYOND * size, (1 + _BEYOND) * size) for own in (points.min(axis=0), points.max(axis=0))
    )
    edge = 0.02 * max(1.0, *(high - low))
    (left, bottom), (right, top) = (low - edge).tolist(), (high + edge).tolist()
    return (left, right), (bottom, top)


def _control_mesh(part: Any, panels: Panels, net: Any) -> None:
    axes = part.subplots()
    thin = 0.8 if len(panels.outlines) < 2000 else 0.3
    axes.add_collection(PolyCollection(panels.outlines, facecolors=NET, edgecolors=LINES, linewidths=thin))
    axes.set_xlim(net[0])
    axes.set_ylim(net[1])
    axes.set_aspect("equal")
    bare(axes, "control mesh")


def _kinds(part: Any, panels: Panels, box: Any) -> None:
    axes = part.subplots()
    colours = [BACKGROUND, *(KIND_COLOURS[kind] for kind in panels.kinds)]
    image = panels.kind[box] + 1
    axes.imshow(
        image, origin="lower", cmap=ListedColormap(colours), vmin=0, vmax=len(colours) - 1, interpolation="nearest"
    )
    _edges(axes, panels, box)
    present = [kind for number, kind in enumerate(panels.kinds) if np.any(panels.kind == number)]
    legend_below(part, [Patch(facecolor=KIND_COLOURS[kind], edgecolor=LINES, label=kind) for kind in present])
    bare(axes, "patches by kind")


def _edges(axes: Any, panels: Panels, box: Any) -> None:
    """Thin lines where one patch ends."""
    value = panels.patch[box]
    change = np.zeros(value.shape, bool)
    change[:, 1:] |= value[:, 1:] != value[:, :-1]
    change[1:] |= value[1:] != value[:-1]
    layer = np.zeros((*value.shape, 4))
    layer[change] = (0.2, 0.2, 0.2, 0.55)
    axes.imshow(layer, origin="lower", interpolation="nearest")


def _factors(part: Any, panels: Panels, box: Any, tolerance: str) -> None:
    axes = part.subplots()
    picture = axes.imshow(panels.factor[box], origin="lower", cmap=FACTOR_MAP, interpolation="nearest")
    part.colorbar(picture, ax=axes, location="bottom", shrink=0.8, pad=0.02, label="factor: pieces along each side")
    bare(axes, f"certified tessellation factors for {tolerance}")


def _errors(part: Any, panels: Panels, box: Any) -> None:
    axes = part.subplots()
    axes.imshow(error_colours(panels.error)[::-1][box], origin="lower", interpolation="nearest")
    error_legend(part)
    bare(axes, f"error of every pixel as drawn, at most {np.nanmax(panels.error):.2g} px")
