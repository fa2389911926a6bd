"""How large triangles are on the screen, by the classes of [YBP12], Fig. 12."""

from __future__ import annotations

from functools import partial

import numpy as np

from slefejax.experiments.looks.made import Made
from slefejax.experiments.store import Row
from slefejax.experiments.studies.look import Look
from slefejax.experiments.studies.measures import SIZES, areas_on_screen
from slefejax.figures.looks.pictures import write_sizes
from slefejax.figures.style import SIZE_CLASSES

CLASSES = tuple(name for _, _, name in SIZE_CLASSES)


def triangle_size(look: Look) -> Made:
    """The class of the triangle that is seen, and how pixels and triangles divide among the classes."""
    area = look.area
    draw = partial(write_sizes, classes=classes_of(area), rows=size_rows(look))
    return Made("how large triangles are", draw, {"area_px2": area}, "area_px2")


def size_rows(look: Look) -> list[Row]:
    """Of every class: pixels that show such triangles, and such triangles; of both the shares, which add up to 1.

    Triangles are all that were made in front of the camera, hidden ones and those without a pixel, too.
    """
    pixels = _counts(classes_of(look.area))
    triangles = _counts(classes_of(areas_on_screen(look.captured, look.view)))
    return [
        {
            "class": name,
            "pixels": int(pixels[k]),
            "share_of_pixels": float(pixels[k] / max(1, pixels.sum())),
            "triangles": int(triangles[k]),
            "share_of_triangles": float(triangles[k] / max(1, triangles.sum())),
        }
        for k, name in enumerate(CLASSES)
    ]


def classes_of(area: np.ndarray) -> np.ndarray:
    """The number of the class of every area, -1 for NaN.

    >>> classes_of(np.array([0.0, 4.9, 5.0, 10.0, 20.0, np.nan])).tolist()
    [0, 0, 1, 2, 3, -1]
    """
    return np.where(np.isnan(area), -1, np.searchsorted(SIZES, np.nan_to_num(area), side="right"))


def _counts(classes: np.ndarray) -> np.ndarray:
    return np.bincount(classes[classes >= 0], minlength=len(CLASSES))
