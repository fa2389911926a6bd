"""Looks of a scene: numbers by colour, classes with a legend, greys side by side, lines over grey."""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.patches import Patch

from slefejax.figures.checks.limit import stripe_greys
from slefejax.figures.error_image import error_colours
from slefejax.figures.looks.page import Heading, Page, page
from slefejax.figures.style import BACKGROUND, CHECKER, ERROR_CLASSES, FACTOR_MAP, SETTINGS, SIZE_COLOURS, WIRE, save

_PLAIN = {**SETTINGS, "axes.grid": False}
_LEGEND = 34  # pixels of a line of a legend
_BAR, _BARS = 130, 170  # pixels of a colour bar with its label, and of two bars with shares


def write_values(path: Path, heading: Heading, values: np.ndarray, label: str, part: float = 1.0) -> None:
    """Numbers of pixels, NaN for background, with a colour bar; ``label``: what they are, with the unit.

    part : of the numbers, the smaller ones, that the colours tell apart; the others have one colour
    """
    with mpl.rc_context(_PLAIN):
        own = page(heading, ~np.isnan(values), right=_BAR)
        finite = values[np.isfinite(values)]
        low, high = (finite.min(), np.quantile(finite, part)) if finite.size else (0.0, 1.0)
        high = high if high > low else low + max(abs(low), 1.0) * 1e-3
        shown = own.show(0, values, cmap=FACTOR_MAP, vmin=low, vmax=high)
        bar = own.figure.colorbar(shown, cax=own.beside(), extend="max" if part < 1.0 else "neither")
        bar.set_label(label)
        save(own.figure, path)


def write_errors(path: Path, heading: Heading, error: np.ndarray) -> None:
    """Errors of pixels in the colours of [YBP12], NaN for background."""
    with mpl.rc_context(_PLAIN):
        own = page(heading, ~np.isnan(error), below=2 * _LEGEND)
        own.show(0, error_colours(error)[::-1])
        handles = [Patch(facecolor=colour, edgecolor="0.5", label=name) for _, colour, name in ERROR_CLASSES]
        own.legend(handles, 4, "error of a pixel")
        save(own.figure, path)


def write_greys(path: Path, heading: Heading, greys: list[np.ndarray], titles: list[str]) -> None:
    """Pictures side by side, 0 black to 1 white, NaN for background."""
    with mpl.rc_context(_PLAIN):
        there = np.any([~np.isnan(grey) for grey in greys], axis=0)
        own = page(heading, there, tuple(titles))
        for number, grey in enumerate(greys):
            own.show(number, _grey(grey))
        save(own.figure, path)


def write_reflections(path: Path, heading: Heading, stripes: list[np.ndarray], titles: list[str]) -> None:
    """Stripes, 0 to 1, NaN for background, side by side."""
    write_greys(path, heading, [stripe_greys(own) for own in stripes], titles)


def write_wire(path: Path, heading: Heading, grey: np.ndarray, lines: np.ndarray) -> None:
    """Lines over grey.

    grey  : 0 black to 1 white, NaN for background
    lines : how much of every pixel a line covers, 0 to 1
    """
    with mpl.rc_context(_PLAIN):
        own = page(heading, ~np.isnan(grey) | (lines > 0))
        own.show(0, wired(grey, lines))
        save(own.figure, path)


def wired(grey: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """``(height, width, 3)``: lines over grey that is lightened, so that they stand out."""
    share = lines[..., None]
    return (1.0 - share) * _grey(0.45 + 0.55 * grey) + share * np.array(to_rgb(WIRE))


def write_checker(path: Path, heading: Heading, squares: np.ndarray, label: str) -> None:
    """Squares of two colours: 0 and 1, -1 for background; ``label``: how large one is."""
    with mpl.rc_context(_PLAIN):
        own = page(heading, squares >= 0, below=_LEGEND)
        own.show(0, np.array([to_rgb(colour) for colour in (*CHECKER, BACKGROUND)])[squares])
        own.legend([Patch(facecolor=CHECKER[1], edgecolor="0.5", label=label)], 1)
        save(own.figure, path)


def write_sizes(path: Path, heading: Heading, classes: np.ndarray, rows: list[dict]) -> None:
    """Triangles by the class of their area, and what share of pixels and of triangles each class has.

    classes : number of the row of every pixel, -1 for background
    rows    : with class, share_of_pixels, share_of_triangles
    """
    with mpl.rc_context(_PLAIN):
        own = page(heading, classes >= 0, below=2 * _LEGEND, right=_BARS)
        own.show(0, np.array([to_rgb(colour) for colour in (*SIZE_COLOURS, BACKGROUND)])[classes])
        _shares(own, rows)
        names = [row["class"] for row in rows]
        handles = [Patch(facecolor=c, edgecolor="0.5", label=n) for c, n in zip(SIZE_COLOURS, names, strict=True)]
        own.legend(handles, len(handles), "area of a triangle on the screen")
        save(own.figure, path)


def _shares(own: Page, rows: list[dict]) -> None:
    """Two bars, with the largest class on top."""
    axes = own.beside()
    left, bottom, width, height = axes.get_position().bounds
    axes.set_position((left + width, bottom, 5.0 * width, height))
    for place, name in enumerate(("share_of_pixels", "share_of_triangles")):
        ends = 100.0 * np.cumsum([0.0, *(row[name] for row in rows)])
        for colour, low, high in zip(SIZE_COLOURS, ends, ends[1:], strict=False):
            axes.bar(place, high - low, 0.8, bottom=low, color=colour, edgecolor="0.5", linewidth=0.5)
    axes.set_xticks([0, 1], ["of the\npixels", "of the\ntriangles"], rotation=90, fontsize=10)
    axes.set_ylim(0, 100)
    axes.yaxis.tick_right()
    axes.set_yticks([0, 25, 50, 75, 100], ["0", "25", "50", "75", "100 %"], fontsize=10)
    for spine in axes.spines.values():
        spine.set_visible(False)


def _grey(values: np.ndarray) -> np.ndarray:
    """As colours; background is white."""
    return np.repeat(np.where(np.isnan(values), 1.0, values)[..., None], 3, axis=-1)
