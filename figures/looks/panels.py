"""Pictures of a scene side by side, whose pixels are whole ones of the page: nothing is blurred, lines stay even."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np

from slefejax.figures.page import Page
from slefejax.figures.style import SETTINGS, bare, drawing, occupied, show_pixels

_DPI = SETTINGS["figure.dpi"]
_SMALL = 480  # pixels: a smaller picture is enlarged
LEGEND = 0.95  # inches below a picture: a title and two lines
CLOSER = 4  # times as large, of what is shown once more
_NARROWEST, _NARROWEST_PANEL = 6.2, 2.6  # inches of a page, and of a panel with a title
_AROUND, _TITLE = 0.3, 0.6  # inches that a panel needs beside its picture, and above it for a title


class Heading(NamedTuple):
    """What stands above: the scene, what is shown of it, and how it was drawn."""

    scene: str
    shows: str
    how: str


class Panels(NamedTuple):
    """The part of the page that is drawn on, its panels, what of every picture they show, and axes beside them.

    Panels of the part that is shown from near are the last ones.
    """

    figure: Any
    panels: list[Any]
    crop: tuple[slice, slice]
    beside: Any = None

    def show(self, number: int, image: np.ndarray, crop: tuple[slice, slice] | None = None, **how: Any) -> Any:
        """A picture, row 0 at the bottom, in one of the panels; or another part of it."""
        return show_pixels(self.panels[number], image[crop or self.crop], **how)


@contextmanager
def panels(
    page: Page,
    heading: Heading,
    there: np.ndarray,
    titles: tuple[str, ...] = ("",),
    *,
    rows: int = 1,
    above: float = _TITLE,
    bar: float = 0.0,
    beside: float = 0.0,
    below: float = 0.0,
    close: tuple[int, int] | None = None,
) -> Iterator[Panels]:
    """A page with panels for what is seen of pictures of one size; written when the block is left.

    there  : where anything is seen, ``(height, width)``, row 0 at the bottom
    titles : of the panels of a row
    rows   : how many rows of whole pictures
    above  : inches of the titles, which stand above the first row
    bar    : inches that a colour bar of the panel takes
    beside : inches of axes to the right of them; none if 0
    below  : inches to keep free for a legend
    close  : rows and columns of a part of the pictures that as many panels below them show ``CLOSER``
    """
    crop = occupied(there)
    tall, wide = there[crop].shape
    zoom = max(1, _SMALL // max(tall, wide))
    titled = any(titles)
    panel = max(zoom * wide / _DPI, _NARROWEST_PANEL * titled) + _AROUND + bar
    inside = len(titles) * panel + beside
    across = max(_NARROWEST, inside)
    heights = [zoom * tall / _DPI + _AROUND] * rows
    if close is not None:
        heights.append(CLOSER * zoom * close[0] / _DPI + _AROUND)
    title = f"{heading.scene}: {heading.shows}\n{heading.how}"
    with drawing(page, across, sum(heights) + above * titled + below, title, grid=False) as figure:
        edge = max(0.5 * (across - inside), 1e-3)
        widths = [edge, len(titles) * panel, *[beside] * bool(beside), edge]
        _, middle, *right, _ = figure.subfigures(1, len(widths), width_ratios=widths)
        found = list(np.ravel(middle.subplots(len(heights), len(titles), height_ratios=heights)))
        for number, axes in enumerate(found):
            bare(axes, titles[number] if number < len(titles) else "")
        yield Panels(figure, found, crop, *(own.subplots() for own in right))
