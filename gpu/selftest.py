"""Does the device draw every pixel? A test that every new context must pass once.

64 flat patches cover a square picture at the factor at which one draw call is as full as the renderer allows. Every
pixel must be there, from the right patch, with the right parameters, drawn at its centre. (Software OpenGL loses
triangles past that size.)
"""

from __future__ import annotations

import numpy as np

from slefejax.errors import NoOpenGLError, OpenGLError
from slefejax.geometry.view import Camera, View
from slefejax.gpu.context import PACKAGES, Device
from slefejax.gpu.renderer import VERTICES_A_DRAW, Renderer

_PATCHES_A_SIDE = 8
_PIXELS_A_SIDE = 256
# The rasteriser snaps vertices to 1/256 of a pixel, a patch has 32 pixels a side: 1/8192; as much again for float32.
_TOLERANCE = 2.0 / 8192.0


def check_coverage(device: Device) -> None:
    """Raise NoOpenGLError unless the device draws the test picture whole."""
    wrong = wrong_pixels(device)
    if wrong:
        raise NoOpenGLError(
            f"{device.renderer} draws {wrong} of {_PIXELS_A_SIDE**2} pixels of the test picture wrongly: its"
            f" results cannot be believed; use another driver, or the software OpenGL of the Debian packages {PACKAGES}"
        )


def wrong_pixels(device: Device) -> int:
    """Pixels of the test picture that are missing, or come from the wrong place."""
    level = int(np.sqrt(VERTICES_A_DRAW / _PATCHES_A_SIDE**2)) - 1
    levels = np.full((_PATCHES_A_SIDE**2, 6), level)
    renderer = Renderer(_squares(), device)
    camera = Camera.orthographic((0.5, 0.5, 1.0), (0.5, 0.5, 0.0), up=(0, 1, 0), height=1.0, near=0.5, far=2.0)
    try:
        picture = renderer.draw(View(camera, _PIXELS_A_SIDE, _PIXELS_A_SIDE), levels[:, :2], levels[:, 2:])
    except OpenGLError:  # triangles are drawn that nobody made
        return _PIXELS_A_SIDE**2
    finally:
        renderer.release()
    place = (np.arange(_PIXELS_A_SIDE) + 0.5) * (_PATCHES_A_SIDE / _PIXELS_A_SIDE)
    square, within = np.divmod(place, 1.0)
    column, row = square.astype(int)[None, :], square.astype(int)[:, None]
    right = (
        (picture.patch == row * _PATCHES_A_SIDE + column)
        & (np.abs(picture.u - within[None, :]) < _TOLERANCE)
        & (np.abs(picture.v - within[:, None]) < _TOLERANCE)
        & (np.abs(picture.drawn).max(axis=2) < _TOLERANCE * _PIXELS_A_SIDE / _PATCHES_A_SIDE)
    )
    return int(np.count_nonzero(~right))


def _squares() -> np.ndarray:
    """Bilinear patches that cut the unit square of the plane z = 0 into equal squares, row by row."""
    ends = np.linspace(0.0, 1.0, _PATCHES_A_SIDE + 1)
    corners = np.stack([*np.meshgrid(ends, ends, indexing="ij"), np.zeros((len(ends),) * 2)], axis=-1)
    patches = [corners[i : i + 2, j : j + 2] for j in range(_PATCHES_A_SIDE) for i in range(_PATCHES_A_SIDE)]
    return np.array(patches)
