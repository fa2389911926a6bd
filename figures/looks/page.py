"""A page with pictures whose pixels are whole numbers of its own: nothing is blurred, thin lines stay even."""

from __future__ import annotations

import textwrap
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure

from slefejax.figures.style import SETTINGS, occupied

_DPI = SETTINGS["figure.dpi"]
_SMALL = 480  # pixels: a smaller picture is enlarged
_LARGEST_ZOOM = 160
_MARGIN, _GAP = 16, 24  # pixels
_NARROWEST = 560  # pixels of a page
_LINE, _LETTER = 21, 7.9  # pixels of a line of a heading, and of a letter
_TITLE = 26  # pixels above a picture that has one
_FOOT = 64  # pixels below what stands beside a picture, for its labels


class Heading(NamedTuple):
    """What stands above: the scene, what is shown of it, and how it was drawn."""

    scene: str
    shows: str
    how: str


class Page(NamedTuple):
    """The figure, its panels, and what of every picture they show.

    crop  : rows and columns
    below : pixels for a legend;  right : room for a colour bar, (left, bottom, width, height) in pixels
    """

    figure: Figure
    panels: list[Any]
    crop: tuple[slice, slice]
    below: int
    right: tuple[float, float, float, float]

    def beside(self) -> Any:
        """Axes for a colour bar."""
        return _axes(self.figure, self.right)

    def show(self, number: int, image: np.ndarray, **how: Any) -> Any:
        """A picture, row 0 at the bottom, in one of the panels."""
        return self.panels[number].imshow(image[self.crop], origin="lower", interpolation="nearest", **how)

    def legend(self, handles: list[Any], columns: int, title: str = "") -> None:
        """Below the pictures."""
        place = (0.5, float(0.5 * self.below / (self.figure.get_size_inches()[1] * _DPI)))
        plain: dict[str, Any] = {
            "frameon": False,
            "title": title or None,
            "columnspacing": 1.2,
            "handlelength": 1.5,
            "fontsize": 11,
        }
        self.figure.legend(handles=handles, loc="center", bbox_to_anchor=place, ncols=columns, **plain)


def page(heading: Heading, there: np.ndarray, titles: tuple[str, ...] = ("",), right: int = 0, below: int = 0) -> Page:
    """Panels side by side for what is seen of pictures of one size.

    there        : where anything is seen, ``(height, width)``, row 0 at the bottom
    titles       : of the panels;  right, below : pixels to keep free
    """
    crop = occupied(there)
    rows, columns = there[crop].shape
    zoom = int(np.clip(_SMALL // max(rows, columns), 1, _LARGEST_ZOOM))
    height, width = zoom * rows, zoom * columns
    inside = len(titles) * width + (len(titles) - 1) * _GAP
    across = max(_NARROWEST, inside + right + 2 * _MARGIN)
    words = _wrapped(heading, across)
    top = _LINE * (words.count("\n") + 1) + _MARGIN + _TITLE * any(titles)
    size = (across, height + top + below + _MARGIN)
    figure = Figure(figsize=(size[0] / _DPI, size[1] / _DPI), dpi=_DPI)
    left, bottom = (across - inside - right) // 2, below + _MARGIN // 2
    panels = []
    for number, title in enumerate(titles):
        own = _axes(figure, (left + number * (width + _GAP), bottom, width, height))
        own.set_axis_off()
        own.set_title(title)
        panels.append(own)
    figure.text(0.5, 1.0 - 0.5 * _MARGIN / size[1], words, ha="center", va="top", fontsize=12, linespacing=1.25)
    beside = (left + inside + _GAP / 2, bottom + _FOOT, 16.0, max(height - 1.5 * _FOOT, _FOOT))
    return Page(figure, panels, crop, below, beside)


def _axes(figure: Figure, box: tuple[float, float, float, float]) -> Any:
    """Axes at pixels."""
    width, height = figure.get_size_inches() * _DPI
    return figure.add_axes((box[0] / width, box[1] / height, box[2] / width, box[3] / height))


def _wrapped(heading: Heading, across: int) -> str:
    letters = int((across - 2 * _MARGIN) / _LETTER)
    lines = [f"{heading.scene}: {heading.shows}", heading.how]
    return "\n".join(textwrap.fill(line, letters) for line in lines)
