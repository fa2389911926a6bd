"""The error of every pixel in the colours of [YBP12]: grey, blue, green, red."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.colors import to_rgb
from matplotlib.image import imsave

from slefejax.figures.style import BACKGROUND, ERROR_CLASSES


def error_colours(error: np.ndarray) -> np.ndarray:
    """``(height, width, 3)`` bytes, row 0 at the top; errors are in pixels, row 0 at the bottom, NaN for background."""
    limits = [limit for limit, _, _ in ERROR_CLASSES[:-1]]
    palette = [*(colour for _, colour, _ in ERROR_CLASSES), BACKGROUND]
    table = np.array([[round(255 * part) for part in to_rgb(colour)] for colour in palette], np.uint8)
    kind = np.where(np.isnan(error), len(ERROR_CLASSES), np.searchsorted(limits, np.nan_to_num(error), side="left"))
    return table[kind][::-1]


def write_error_image(path: Path, error: np.ndarray) -> None:
    """One pixel of the picture a pixel of the screen, as PNG."""
    imsave(path, error_colours(error), format="png")
