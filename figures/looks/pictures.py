"""Looks of a scene: numbers by colour, classes with a legend, greys side by side, lines over grey."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.patches import Patch, Rectangle

from slefejax.figures.checks.limit import stripe_greys
from slefejax.figures.error_image import error_colours
from slefejax.figures.looks.panels import LEGEND, Heading, panels
from slefejax.figures.page import Page
from slefejax.figures.style import (
    BACKGROUND,
    CHECKER,
    FACTOR_MAP,
    LINES,
    MARKED,
    SIZE_CLASSES,
    UNTEXTURED,
    error_legend,
    legend_below,
    size_legend,
)

_ONE_LINE = 0.4  # inches below: a legend of a line
_BAR, _BARS = 1.6, 1.7  # inches beside: a colour bar with its label, or two bars with shares


def write_values(page: Page, heading: Heading, values: np.ndarray, label: str, part: float = 1.0) -> None:
    """Numbers of pixels, NaN for background, with a colour bar; ``label``: what they are, with the unit.

    part : of the numbers, the smaller ones, that the colours tell apart; the others have one colour
    """
    finite = values[np.isfinite(values)]
    low, high = (finite.min(), np.quantile(finite, part)) if finite.size else (0.0, 1.0)
    high = high if high > low else low + max(abs(low), 1.0) * 1e-3
    with panels(page, heading, ~np.isnan(values), bar=_BAR) as own:
        shown = own.show(0, values, cmap=FACTOR_MAP, vmin=low, vmax=high)
        own.figure.colorbar(shown, ax=own.panels[0], extend="max" if part < 1.0 else "neither", label=label)


def write_errors(page: Page, heading: Heading, error: np.ndarray) -> None:
    """Errors of pixels in the colours of [YBP12], NaN for background."""
    with panels(page, heading, ~np.isnan(error), below=LEGEND) as own:
        own.show(0, error_colours(error)[::-1])
        error_legend(own.figure)


def write_greys(page: Page, heading: Heading, greys: list[np.ndarray], titles: list[str]) -> None:
    """Pictures side by side, 0 black to 1 white, NaN for background."""
    there = np.any([~np.isnan(grey) for grey in greys], axis=0)
    with panels(page, heading, there, tuple(titles)) as own:
        for number, grey in enumerate(greys):
            own.show(number, grey_colours(grey))


def write_textured(
    page: Page,
    heading: Heading,
    colours: dict[str, np.ndarray],
    there: list[np.ndarray],
    close: tuple[slice, slice],
) -> None:
    """Colours ``(height, width, 3)`` of pixels side by side, by titles; below them a part of each from near.

    there : ``(height, width)``, whether there is anything: grey where it has no colour
    close : rows and columns of that part, which a frame shows
    """
    rows, columns = close
    size = rows.stop - rows.start, columns.stop - columns.start
    with panels(page, heading, np.any(there, axis=0), tuple(colours), close=size) as own:
        corner = columns.start - own.crop[1].start - 0.5, rows.start - own.crop[0].start - 0.5
        for number, (seen, inside) in enumerate(zip(colours.values(), there, strict=True)):
            plain = np.where(inside[..., None], to_rgb(UNTEXTURED), to_rgb(BACKGROUND))
            shown = np.where(np.isnan(seen), plain, seen)
            own.show(number, shown)
            own.panels[number].add_patch(
                Rectangle(corner, size[1], size[0], fill=False, edgecolor=MARKED, linewidth=1.5)
            )
            own.show(len(colours) + number, shown, close)


def write_reflections(page: Page, heading: Heading, stripes: list[np.ndarray], titles: list[str]) -> None:
    """Stripes, 0 to 1, NaN for background, side by side."""
    write_greys(page, heading, [stripe_greys(own) for own in stripes], titles)


def write_wire(page: Page, heading: Heading, grey: np.ndarray, lines: np.ndarray) -> None:
    """Lines over grey.

    grey  : 0 black to 1 white, NaN for background
    lines : how much of every pixel a line covers, 0 to 1
    """
    with panels(page, heading, ~np.isnan(grey) | (lines > 0)) as own:
        own.show(0, wired(grey, lines))


def wired(grey: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """``(height, width, 3)``: lines over grey that is lightened, so that they stand out."""
    share = lines[..., None]
    return (1.0 - share) * grey_colours(0.45 + 0.55 * grey) + share * np.array(to_rgb(LINES))


def write_checker(page: Page, heading: Heading, squares: np.ndarray, label: str) -> None:
    """Squares of two colours: 0 and 1, -1 for background; ``label``: how large one is."""
    with panels(page, heading, squares >= 0, below=_ONE_LINE) as own:
        own.show(0, _in_colours(squares, CHECKER))
        legend_below(own.figure, [Patch(facecolor=CHECKER[1], edgecolor=LINES, label=label)])


def write_sizes(page: Page, heading: Heading, classes: np.ndarray, rows: list[dict]) -> None:
    """Triangles by the class of their area, and what share of pixels and of triangles each class has.

    classes : number of the class of every pixel, -1 for background
    rows    : a class each, with share_of_pixels, share_of_triangles
    """
    with panels(page, heading, classes >= 0, below=LEGEND, beside=_BARS) as own:
        own.show(0, _in_colours(classes, tuple(colour for _, colour, _ in SIZE_CLASSES)))
        _shares(own.beside, rows)
        size_legend(own.figure)


def _shares(axes: Any, rows: list[dict]) -> None:
    """Two bars, with the largest class on top."""
    for place, name in enumerate(("share_of_pixels", "share_of_triangles")):
        ends = 100.0 * np.cumsum([0.0, *(row[name] for row in rows)])
        for (_, colour, _), low, high in zip(SIZE_CLASSES, ends, ends[1:], strict=False):
            axes.bar(place, high - low, 0.8, bottom=low, color=colour, edgecolor=LINES, linewidth=0.5)
    axes.set_xticks([0, 1], ["of the\npixels", "of the\ntriangles"], rotation=90)
    axes.set_ylim(0, 100)
    axes.yaxis.tick_right()
    axes.set_yticks([0, 25, 50, 75, 100], ["0", "25", "50", "75", "100 %"])
    for spine in axes.spines.values():
        spine.set_visible(False)


def _in_colours(numbers: np.ndarray, colours: tuple[str, ...]) -> np.ndarray:
    """Those of numbers, and the background for -1."""
    return np.array([to_rgb(colour) for colour in (*colours, BACKGROUND)])[numbers]


def grey_colours(values: np.ndarray) -> np.ndarray:
    """As colours; background is white."""
    return np.repeat(np.where(np.isnan(values), 1.0, values)[..., None], 3, axis=-1)
