"""The pattern of the running driver's tessellator (``slefejax.tessellator.rings``), from triangles that it made."""

from __future__ import annotations

import numpy as np

from slefejax.geometry.view import Camera, View
from slefejax.gpu.context import Device
from slefejax.gpu.renderer import Renderer
from slefejax.tessellator.levels import HIGHEST_LEVEL
from slefejax.tessellator.rings import Pattern, direct3d11

_ACROSS = 4  # inner level in the other direction: the ring along an edge does not depend on it


def measure_pattern(device: Device | None = None) -> Pattern:
    """Capture the rings of all pairs of levels up to 64, and the lines of all inner grids.

    A pattern all of whose captured triangles are Direct3D 11's is ``known``.

    >>> measure_pattern().reach[6, 8] * 6                                   # doctest: +SKIP
    1.5
    """
    count = HIGHEST_LEVEL
    quad = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], np.float64)
    view = View(Camera.orthographic((0.5, 0.5, 5.0), (0.5, 0.5, 0.0), up=(0, 1, 0)), 16, 16)
    renderer = Renderer(np.repeat(quad[None], count, axis=0), device)
    points, reach = np.ones((count + 1, count + 1)), np.zeros((count + 1, count + 1))
    points[:, 0] = 0.0
    outer = np.full((count, 4), _ACROSS)
    outer[:, 1] = np.arange(1, count + 1)
    expected, known = direct3d11(), True
    for n in range(2, count + 1):
        outer[:, 3] = n
        triangles = renderer.capture(view, np.tile([n, _ACROSS], (count, 1)), outer)
        u, v = np.moveaxis(triangles.parameters.astype(np.float64), 2, 0)
        ring = (v.min(axis=1) == 0) & (v.max(axis=1) < 1.5 / _ACROSS)
        np.maximum.at(reach[n], triangles.patch[ring] + 1, np.ptp(u[ring], axis=1))
        wanted = expected.ring_triangles(np.ones(count, int), np.tile([n, _ACROSS], (count, 1)), outer[:, 1], False)
        known = known and _among(wanted, (triangles.patch[ring], np.stack([u[ring], v[ring]], axis=2)))
        points[n, 1:n] = np.unique(u[(v > 0) & (v < 1) & (u > 0) & (u < 1)])
    renderer.release()
    reach[1] = reach[2]
    return Pattern(points, reach, known and np.array_equal(points, expected.points))


def _among(some: tuple[np.ndarray, np.ndarray], every: tuple[np.ndarray, np.ndarray]) -> bool:
    """Whether triangles (whose, corners) are among others, from any corner on."""

    def ordered(own: np.ndarray, corners: np.ndarray) -> np.ndarray:
        return np.unique(np.column_stack([own, np.sort(corners[..., 0] + 1j * corners[..., 1], axis=1)]), axis=0)

    one, other = ordered(*some), ordered(*every)
    return len(np.unique(np.concatenate([one, other]), axis=0)) == len(other)
