"""The folders of the package, row by row, and which of them imports which."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from matplotlib.patches import FancyBboxPatch

from slefejax.figures.page import Page
from slefejax.figures.style import LINES, PART, PART_APART, PART_MARKED, QUIET, SMALL, drawing

_SAYS = {
    "lanes": "how kernels run",
    "geometry": "Bézier form, camera, projection",
    "bounds": "slefes, tables, rivals",
    "tessellator": "counts, rings, shared edges",
    "model": "control meshes, skinning, rigs",
    "conversion": "mesh to patches",
    "io": "a format a file",
    "data": "scenes that ship",
    "loading": "files, scenes",
    "scene": "what a file becomes",
    "predict": "methods: patches to factors",
    "measure": "the error of what is drawn",
    "gpu": "OpenGL: levels in, G-buffer out",
    "study": "fits, budgets, sensitivity",
    "session": "what is kept over time",
    "experiments": "commands",
    "figures": "a picture a file",
}
_ACROSS, _UP = 3.3, 1.45  # between columns and rows
_WIDTH, _HEIGHT = 3.05, 0.86
_COLOURS = {"predict": PART_MARKED, "measure": PART_APART, "gpu": PART_APART}


def write_architecture(
    path: Path, places: dict[str, tuple[float, int]], sizes: dict[str, int], arrows: list[tuple[str, str]]
) -> None:
    """A box a folder at its column and row, an arrow from what imports to what is imported.

    sizes : modules of each folder;  arrows : they stand in the file's own text too
    """
    middle = {part: (_ACROSS * column, _UP * row) for part, (column, row) in places.items()}
    title = "An arrow points to what is imported; arrows that follow from others are left out."
    with drawing(Page(path, described=described(arrows)), 14.5, 9, title, grid=False) as figure:
        axes = figure.subplots()
        for one, other in arrows:
            _arrow(axes, middle[one], middle[other])
        for part, (x, y) in middle.items():
            corner, colour = (x - _WIDTH / 2, y - _HEIGHT / 2), _COLOURS.get(part, PART)
            shape = "round,pad=0,rounding_size=0.12"
            axes.add_patch(FancyBboxPatch(corner, _WIDTH, _HEIGHT, shape, fc=colour, ec=LINES, zorder=2))
            count = f"{sizes[part]} module" + "s" * (sizes[part] != 1)
            words: Any = {"ha": "center", "va": "center", "size": SMALL, "zorder": 3}
            axes.text(x, y + 0.17, f"{part}  ({count})", weight="bold", **words)
            axes.text(x, y - 0.2, _SAYS[part], **words)
        xs, ys = zip(*middle.values(), strict=True)
        axes.set_xlim(min(xs) - _WIDTH / 2 - 0.1, max(xs) + _WIDTH / 2 + 0.1)
        axes.set_ylim(min(ys) - _HEIGHT, max(ys) + _HEIGHT)
        axes.set_axis_off()


def described(arrows: list[tuple[str, str]]) -> str:
    """The arrows as a line of text."""
    return " ".join(f"{one}>{other}" for one, other in arrows)


def _arrow(axes: Any, start: tuple[float, float], end: tuple[float, float]) -> None:
    (x, y), (u, v) = start, end
    if y == v:
        side = 1.0 if u > x else -1.0
        x, u = x + side * _WIDTH / 2, u - side * _WIDTH / 2
    else:
        y, v = y - _HEIGHT / 2, v + _HEIGHT / 2
    style = {"arrowstyle": "-|>", "color": QUIET, "lw": 1.4, "shrinkA": 0, "shrinkB": 0}
    axes.annotate("", (u, v), (x, y), arrowprops=style, zorder=1)
