"""Too few triangles, enough, more than that: the same scene at three scales of its factors, understood at a glance."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from slefejax.figures.error_image import read_error_image
from slefejax.figures.looks.panels import LEGEND, Heading, panels
from slefejax.figures.page import Page
from slefejax.figures.style import INK, LARGE, QUIET, TITLE, WRONG, error_legend

Row = dict[str, Any]

_ABOVE = 1.2  # inches: three large lines


def told_apart(rows: list[Row], tolerance: float) -> list[tuple[Row, str]]:
    """The coarsest row, the one with the fewest triangles that keeps the tolerance, the finest; what to say of each.

    >>> rows = [{"triangles": n, "max_error_px": e} for n, e in ((90, 0.1), (5, 8.0), (40, 0.5), (20, 0.6))]
    >>> [(row["triangles"], said) for row, said in told_apart(rows, 0.5)]
    [(5, 'too few'), (40, 'enough'), (90, 'more than enough')]
    """
    ordered = sorted(rows, key=lambda row: row["triangles"])
    enough = next((row for row in ordered if row["max_error_px"] <= tolerance), None)
    kept = [row for row in ordered if any(row is own for own in (ordered[0], enough, ordered[-1]))]
    return [(row, _word(row, enough, tolerance)) for row in kept]


def _word(row: Row, enough: Row | None, tolerance: float) -> str:
    if row["max_error_px"] > tolerance:
        return "too few"
    return "enough" if row is enough else "more than enough"


def write_enough(
    page: Page, told: list[tuple[Row, str]], wires: list[np.ndarray], images: list[Path], heading: Heading
) -> None:
    """A column each: the triangles, and below them the error of every pixel, under how many and how wrong.

    told   : of ``told_apart``
    wires  : colours ``(height, width, 3)`` of every pixel, 0 to 1, row 0 at the bottom;  images : of errors
    """
    pictures = [*wires, *(read_error_image(image)[::-1] for image in images)]
    there = np.any([np.any(picture != 1.0, axis=2) for picture in pictures], axis=0)
    titles = tuple(_said(*own) for own in told)
    with panels(page, heading, there, titles, rows=2, above=_ABOVE, below=LEGEND) as own:
        for number, picture in enumerate(pictures):
            own.show(number, picture)
        for axes, (_, word) in zip(own.panels, told, strict=False):
            axes.title.set(size=LARGE, color={"too few": WRONG, "enough": INK}.get(word, QUIET))
        for axes, (row, _) in zip(own.panels[len(told) :], told, strict=True):
            axes.set_xlabel(f"predicted factors, times {row['scale']:g}", size=TITLE)
        for axes, what in zip(own.panels[:: len(told)], ("its triangles", "how far each pixel is off"), strict=True):
            axes.set_ylabel(what, size=TITLE)
        error_legend(own.figure)


def _said(row: Row, word: str) -> str:
    return f"{word}\n{row['triangles']:,} triangles\nup to {row['max_error_px']:.2g} px off"
