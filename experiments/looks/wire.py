"""The triangles that were drawn, as lines over shading."""

from __future__ import annotations

from functools import partial

import numpy as np

from slefejax.experiments.looks.light import shades
from slefejax.experiments.looks.made import Made
from slefejax.experiments.studies.look import Look
from slefejax.figures.looks.pictures import wired, write_wire
from slefejax.gpu import GBuffer

_WIDTH = 1.0  # pixels
_AHEAD = 0.7  # cosine: how directly beyond a side a pixel lies


def wire(look: Look) -> Made:
    """Sides of the triangles that are seen, as the tessellator made them."""
    seen = look.seen
    assert seen.edge is not None
    assert seen.area is not None
    draw = partial(write_wire, grey=shades(look), lines=lines(seen))
    distance = np.linalg.norm(seen.edge, axis=-1)
    return Made("the triangles that are drawn", draw, {"side_px": distance, "area_px2": seen.area}, "side_px")


def wire_colours(look: Look) -> np.ndarray:
    """The same as colours of every pixel."""
    return wired(shades(look), lines(look.seen))


def lines(seen: GBuffer) -> np.ndarray:
    """How much of every pixel is covered by lines along the sides of triangles that are seen, ``(height, width)``.

    seen : with ``edge``

    A pixel knows the sides of its own triangle. Across an outline it knows nothing: there what lies nearer gives its
    sides to its neighbours, so that lines are as wide there as elsewhere. What is hidden gives nothing.
    """
    assert seen.edge is not None
    found = _covered(np.linalg.norm(seen.edge, axis=-1))
    given = found.copy()
    for row in (-1, 0, 1):
        for column in (-1, 0, 1):
            if row or column:
                to, off = _neighbours(found.shape, row, column)
                nearer = seen.depth[off] < seen.depth[to]
                own = np.where(nearer, _covered(_beyond(seen.edge[off], np.array([column, row], float))), 0.0)
                given[to] = np.maximum(given[to], own)
    return given


def _covered(distance: np.ndarray) -> np.ndarray:
    """By a line so far from the pixel's centre; NaN is nowhere."""
    return np.clip(0.5 + 0.5 * _WIDTH - np.nan_to_num(distance, nan=np.inf), 0.0, min(_WIDTH, 1.0))


def _beyond(edge: np.ndarray, step: np.ndarray) -> np.ndarray:
    """From a pixel one step away to the line through the nearest point of a side, at right angles to the way there.

    NaN where the step leads along the line, or away from it.
    """
    length = np.linalg.norm(edge, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        along = edge @ step / length
    return np.where(along >= _AHEAD * np.linalg.norm(step), np.abs(along - length), np.nan)


def _neighbours(shape: tuple[int, ...], row: int, column: int) -> tuple[tuple[slice, ...], tuple[slice, ...]]:
    """Pixels, and those from which a step of so many rows and columns leads to them."""
    to = tuple(slice(max(0, d), n + min(0, d)) for d, n in zip((row, column), shape, strict=True))
    off = tuple(slice(max(0, -d), n + min(0, -d)) for d, n in zip((row, column), shape, strict=True))
    return to, off
