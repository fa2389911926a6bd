"""Pictures as textures: read, and looked up as OpenGL does it, linearly and repeated."""

from __future__ import annotations

import io
import warnings
from pathlib import Path

import numpy as np
from jaxtyping import Float
from matplotlib.colors import to_rgb

from slefejax.errors import InputError
from slefejax.figures.style import CHECKER
from slefejax.io.content import read_bytes
from slefejax.late import one_at_a_time

SQUARES = 32  # of the built-in checker along each axis; an even number, so that it repeats
_TEXELS = 32  # along the side of a square


def read_picture(path: Path, largest: int) -> Float[np.ndarray, "height width 3"]:
    """The colours of a picture, 0 to 1, row 0 at the bottom.

    largest : how many pixels a side may have

    Raises InputError for a file that is missing or no picture, and for one that is too large.
    """
    data = read_bytes(path)
    with one_at_a_time:
        from PIL import Image  # not needed by whoever has no picture
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", Image.DecompressionBombWarning)
            with Image.open(io.BytesIO(data)) as picture:
                if max(picture.size) > largest:
                    said = f"{path} has {picture.width} x {picture.height} pixels"
                    raise InputError(f"{said}, and a side may have {largest} on this device: scale the picture down")
                colours = np.asarray(picture.convert("RGB"))
    except (Image.DecompressionBombError, Image.DecompressionBombWarning):
        raise InputError(f"{path} has too many pixels for a texture: scale the picture down") from None
    except (OSError, SyntaxError, ValueError, EOFError) as error:  # what Pillow's readers raise for what is none
        if isinstance(error, InputError):
            raise
        raise InputError(f"{path} is no picture that can be read, such as a PNG file, or not whole") from None
    return colours[::-1].astype(np.float32) / np.float32(255.0)


def checker_picture() -> Float[np.ndarray, "height width 3"]:
    """Squares of two colours."""
    along = np.arange(SQUARES * _TEXELS) // _TEXELS
    return np.array([to_rgb(colour) for colour in CHECKER], np.float32)[(along[:, None] + along) % 2]


def looked_up(
    picture: Float[np.ndarray, "height width 3"], at: Float[np.ndarray, "*points 2"]
) -> Float[np.ndarray, "*points 3"]:
    """Colours at texture coordinates, NaN for NaN: linear between the centres of texels, repeated beyond 0 and 1.

    >>> picture = np.array([[[0.0] * 3, [1.0] * 3]])
    >>> looked_up(picture, np.array([[0.25, 0.0], [0.5, 7.0], [1.75, 0.0]]))[:, 0].tolist()
    [0.0, 0.5, 1.0]
    """
    height, width = picture.shape[:2]
    known = ~np.isnan(at).any(axis=-1, keepdims=True)
    own = np.where(known, at, 0.0)
    place = (own - np.floor(own)) * [width, height] - 0.5
    low = np.floor(place).astype(int)
    (s, t), (column, row) = np.moveaxis(place - low, -1, 0)[..., None], np.moveaxis(low, -1, 0)

    def texel(up: int, right: int) -> np.ndarray:
        return picture[(row + up) % height, (column + right) % width]

    found = (1.0 - t) * ((1.0 - s) * texel(0, 0) + s * texel(0, 1)) + t * ((1.0 - s) * texel(1, 0) + s * texel(1, 1))
    return np.where(known, found, np.nan)
