"""Colours, fonts, sizes, titles and captions: all figures have them from here."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.lines import Line2D
from matplotlib.patches import Patch

from slefejax.figures.colours import COLOURS, MARKS, METHOD_STYLES
from slefejax.figures.fitting import finish, room_of, width_of, wrapped
from slefejax.figures.page import Page

# The error colours of [YBP12], in shades whose lightness falls from class to class, whatever colours one can tell
# apart: (limit in pixels, colour, name)
ERROR_CLASSES = (
    (0.1, "#c8c8c8", "≤ 0.1 px"),
    (0.5, "#5b9bea", "≤ 0.5 px"),
    (1.0, "#3f8450", "≤ 1 px"),
    (float("inf"), "#a81414", "> 1 px"),
)
BACKGROUND = "#ffffff"
INK, QUIET, FAINT, HAZE = "#000000", "#4d4d4d", "#b3b3b3", "#ededed"  # from what is read first to what is behind
ON_DARK = "#ffffff"  # letters
LINES = "#303030"  # of meshes and nets
PLAIN = "#d9d9d9"  # what is as it usually is
NET = "#f4f1ea"  # faces of a control mesh
PART, PART_MARKED, PART_APART = "#f4f0e6", "#f6d5b8", "#cfe3f4"  # boxes with words in them
REGION, REGION_EDGE = "#f4e3b5", "#b8860b"  # what is between two bounds
MARKED = "#d55e00"  # what a figure points at
WRONG = ERROR_CLASSES[-1][1]
FACTOR_MAP = "viridis"
DIVERGING_MAP = "RdBu_r"
GREY_MAP = "gray"
# Triangles by their area on the screen in [YBP12], section 7, blue, green, red and white there: here the background is
# white. (limit in square pixels, colour, name)
SIZE_CLASSES = (
    (5.0, ERROR_CLASSES[1][1], "< 5 px²"),
    (10.0, ERROR_CLASSES[2][1], "5 to 10 px²"),
    (20.0, ERROR_CLASSES[3][1], "10 to 20 px²"),
    (float("inf"), "#e4e0d8", "≥ 20 px²"),
)
CHECKER = ("#f2efe9", "#3f5f7f")
UNTEXTURED = "#b0b0b0"  # faces without texture coordinates

# Areas: an eighth colour, and patterns that tell bars apart where colours repeat
YELLOW = "#f0e442"
HATCHES = ("", "//", "\\\\", "..", "xx", "--", "++", "oo")

OTHER_METHOD: dict[str, Any] = {"color": QUIET, "marker": "o"}

SMALL, TITLE, LARGE = 11, 14, 22
_BETWEEN = 1.3  # baselines, in sizes of the font
_LEAST_MARK = 7.0  # points, in legends
_MARGIN = 12  # pixels around what is shown of a picture
_PLATE = {"facecolor": BACKGROUND, "edgecolor": "none", "alpha": 0.88, "pad": 1.0}  # behind letters on a picture

SETTINGS: dict[Any, Any] = {
    "font.size": 12,
    "axes.titlesize": 12,
    "legend.fontsize": SMALL,
    "legend.title_fontsize": SMALL,
    "xtick.labelsize": SMALL,
    "ytick.labelsize": SMALL,
    "axes.grid": True,
    "axes.axisbelow": True,  # lines of the grid are over nothing
    "grid.alpha": 0.3,
    "figure.dpi": 100,
    "savefig.dpi": 100,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "svg.fonttype": "none",  # letters stay letters
    "pdf.fonttype": 42,
    "svg.hashsalt": "slefejax",  # the same figure is the same file
}


def series(number: int) -> dict[str, Any]:
    """Colour and mark of a series; no two of the first 98 have both in common."""
    return {"color": COLOURS[number % len(COLOURS)], "marker": MARKS[number % len(MARKS)]}


def method_style(name: str) -> dict[str, Any]:
    """Colour and mark of a method, also of one that is somebody's own."""
    return METHOD_STYLES.get(name, OTHER_METHOD)


@contextmanager
def drawing(page: Page, width: float, height: float, title: str, *, grid: bool = True) -> Iterator[Any]:
    """A figure with a title above and the page's caption below; written when the block is left.

    What is given is the part between them, so many inches wide and high, with all that a ``Figure`` has.

    title : what is shown; broken into lines as wide as the figure
    """
    room = 72 * (width - 0.3)  # points
    above, below = wrapped(title, room, TITLE), wrapped(page.caption, room, SMALL)
    strips = [_height(above, TITLE), height, _height(below, SMALL)]
    with mpl.rc_context({**SETTINGS, "axes.grid": grid}):
        figure = Figure(figsize=(width, sum(strips)), layout="constrained")
        FigureCanvasAgg(figure)  # letters are measured as they are drawn
        parts: Any = figure.subfigures(3, 1, height_ratios=[max(strip, 1e-3) for strip in strips])
        parts[0].text(0.5, 0.45, above, ha="center", va="center", size=TITLE)
        parts[2].text(0.15 / width, 0.55, below, ha="left", va="center", size=SMALL, color=QUIET)
        yield parts[1]
        finish(figure, parts[1])
        save(figure, page)


def _height(text: str, size: float) -> float:
    """Inches that a text of some lines needs."""
    return (text.count("\n") + 1.5) * _BETWEEN * size / 72 if text else 0.0


def save(figure: Figure, page: Page) -> None:
    """Write the figure in the format of the file's suffix; without the time, so that equal figures are equal files."""
    kind = page.path.suffix[1:]
    said: dict[str, Any] = {"pdf": {"CreationDate": None}, "svg": {"Date": None}}.get(kind, {})
    if page.described:
        said = {**said, "Subject" if kind == "pdf" else "Description": page.described}
    figure.savefig(page.path, format=kind, metadata=said)


def occupied(something: np.ndarray) -> tuple[slice, slice]:
    """Rows and columns of the part of a picture where a mask is set, with a margin; all of it where nothing is."""
    if not something.any():
        return slice(0, something.shape[0]), slice(0, something.shape[1])
    rows, columns = (np.flatnonzero(something.any(axis=axis)) for axis in (1, 0))
    first, second = (slice(max(0, r[0] - _MARGIN), r[-1] + _MARGIN + 1) for r in (rows, columns))
    return first, second


def legend_below(part: Any, handles: Sequence[Any] | None = None, title: str | None = None) -> None:
    """A legend under a figure or a part of one, never over its data; as many columns as there is room for.

    handles : those of all axes of the part, each name once, if not given
    """
    if handles is None:
        named: dict[str, Any] = {}
        for axes in part.axes:
            for handle, name in zip(*axes.get_legend_handles_labels(), strict=True):
                named.setdefault(name, handle)
        labels, handles = list(named), list(named.values())
    else:
        labels = [handle.get_label() for handle in handles]
    if not handles:
        return
    widest = max(width_of(line, SMALL) for label in labels for line in label.split("\n")) + 5.2 * SMALL
    columns = max(1, min(len(labels), int((room_of(part) - 2 * SMALL) / widest)))
    lines = -(-len(labels) // columns)
    shown = part.legend(
        handles, labels, loc="outside lower center", ncols=-(-len(labels) // lines), frameon=False, title=title
    )
    for handle in shown.legend_handles:
        if handle is not None and not isinstance(handle, Patch):
            handle.set_alpha(1.0)
        if isinstance(handle, Line2D):
            handle.set_markersize(max(handle.get_markersize(), _LEAST_MARK))


def error_legend(part: Any) -> None:
    """The error colours and what they mean, below a figure or a part of one."""
    _class_legend(part, ERROR_CLASSES, "error of a pixel")


def size_legend(part: Any) -> None:
    """The colours of triangles by their area, as ``error_legend``."""
    _class_legend(part, SIZE_CLASSES, "area of a triangle on the screen")


def _class_legend(part: Any, classes: Sequence[tuple[float, str, str]], title: str) -> None:
    handles = [Patch(facecolor=colour, edgecolor=LINES, lw=0.6, label=name) for _, colour, name in classes]
    legend_below(part, handles, title)


def bare(axes: Any, title: str = "") -> None:
    """Axes of a picture: no ticks, no frame, no grid."""
    axes.set_title(title)
    axes.set_xticks([])
    axes.set_yticks([])
    axes.set_facecolor(BACKGROUND)
    axes.grid(visible=False)
    for spine in axes.spines.values():
        spine.set_visible(False)


def show_pixels(axes: Any, image: np.ndarray, **how: Any) -> Any:
    """A picture, row 0 at the bottom, as large as fits whose pixels are squares of whole pixels of the page."""
    return axes.imshow(image, origin="lower", interpolation="nearest", gid="whole pixels", **how)


def hide_rest(grid: Any, used: int) -> None:
    """Panels of a grid that nothing is drawn in."""
    for axes in np.ravel(grid)[used:]:
        axes.set_axis_off()


def on_picture(axes: Any, place: tuple[float, float], text: str) -> None:
    """Letters on a picture, on a light plate; left out where they would lie over letters that were there before."""
    axes.annotate(
        text, place, ha="center", va="center", size=SMALL, bbox=_PLATE, gid="may go", in_layout=False, visible=False
    )


def beside(axes: Any, place: tuple[float, float], text: str, colour: str = INK) -> None:
    """Letters beside a mark: where they are over no mark and no other letters, with a line where that is far away."""
    if text:
        line = {"arrowstyle": "-", "color": FAINT, "lw": 0.8, "shrinkA": 1, "shrinkB": 2}
        offset = {"xytext": (6, 6), "textcoords": "offset points", "arrowprops": line}
        axes.annotate(text, place, **offset, size=SMALL, color=colour, gid="may move", in_layout=False, visible=False)


def level(axes: Any, value: float, text: str) -> None:
    """A dashed line across, and what it is in the legend."""
    axes.axhline(value, color=INK, lw=1.2, ls="--", label=text)


def bar_numbers(axes: Any, bars: Any, texts: Sequence[str]) -> None:
    """A number at the end of each bar, with room for it; lines behind it are covered."""
    axes.bar_label(bars, texts, padding=2, size=SMALL, bbox=_PLATE)
    axes.margins(y=0.2) if bars.orientation == "vertical" else axes.margins(x=0.2)
