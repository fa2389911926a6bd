"""Pictures of patches without a renderer: so many points of each that every pixel gets some, the nearest is seen."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from slefejax import View
from slefejax.geometry.view import homogeneous
from slefejax.measure.jumps import points_and_normals

_A_PIXEL = 2.0  # points along it
_MOST = 512  # points along the side of a patch
_AT_A_TIME = 400_000  # points
Painter = Callable[[np.ndarray, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


def splatted(patches: Any, view: View, paint: Painter) -> np.ndarray:
    """``(height, width)``, row 0 at the top: what ``paint`` says of the nearest point of every pixel, or NaN.

    paint : from numbers of patches ``(some,)``, parameters ``(places, 2)``, points and normals ``(some, places, 3)``
            to values ``(some, places)``
    """
    height, width = int(view.height), int(view.width)
    depth = np.full(height * width + 1, np.inf)
    seen = np.full(height * width + 1, np.nan)
    sides = _sides(patches, view)
    for n in np.unique(sides[sides > 0]):
        t = np.linspace(0.0, 1.0, n)
        grid = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
        own = np.flatnonzero(sides == n)
        step = max(1, _AT_A_TIME // len(grid))
        for k in range(0, len(own), step):
            which = own[k : k + step]
            points, normals = points_and_normals(patches[which], np.broadcast_to(grid, (len(which), *grid.shape)))
            pixel, far = _pixels(points, view)
            np.minimum.at(depth, pixel, far)
            front = (far == depth[pixel]) & np.isfinite(far)
            seen[pixel[front]] = paint(which, grid, points, normals).ravel()[front]
    return seen[:-1].reshape(height, width)[::-1]


def _pixels(points: np.ndarray, view: View) -> tuple[np.ndarray, np.ndarray]:
    """The pixel of every point, row 0 at the bottom, and its depth; one past the last for points that are off."""
    x, y, z, w = (homogeneous(points).reshape(-1, 4) @ np.asarray(view.world_to_screen).T).T
    ahead = w > 0
    safe = np.where(ahead, w, 1.0)
    column, row, far = np.floor(x / safe), np.floor(y / safe), z / safe
    inside = ahead & (column >= 0) & (column < view.width) & (row >= 0) & (row < view.height) & (far >= 0) & (far <= 1)
    pixel = np.where(inside, row * view.width + column, view.width * view.height).astype(np.int64)
    return pixel, np.where(inside, far, np.inf)


def _sides(patches: Any, view: View) -> np.ndarray:
    """Points along the sides of every patch, powers of two; 0 of those that are not in the picture."""
    net = np.asarray(patches.net if hasattr(patches, "twists") else patches)
    screen = homogeneous(net.reshape(len(net), -1, net.shape[3])) @ np.asarray(view.world_to_screen).T
    w = screen[..., 3]
    ahead = (w > 0).all(axis=1)
    flat = screen[..., :2] / np.where(w > 0, w, 1.0)[..., None]
    low, high = flat.min(axis=1), flat.max(axis=1)
    size = np.array([view.width, view.height], float)
    shown = ahead & (high > 0).all(axis=1) & (low < size).all(axis=1)
    wanted = np.clip(_A_PIXEL * (high - low).max(axis=1) + 2.0, 4.0, _MOST)
    return np.where(shown, 2 ** np.ceil(np.log2(wanted)), 0).astype(np.int64)
