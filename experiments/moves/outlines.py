"""The control mesh of a scene as it is seen, for pictures."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slefejax import Scene, View
from slefejax.geometry.view import homogeneous


class Outlines(NamedTuple):
    """What can be seen of a control mesh, the furthest first.

    polygons : ``(corners, 2)`` in pixels;  corners : numbers of their vertices (of control points, patch by patch)
    """

    polygons: list[np.ndarray]
    corners: list[np.ndarray]


def outlines(scene: Scene, view: View) -> Outlines:
    """Faces of the control mesh, or cells of the control nets of a list of patches."""
    if scene.conversion is not None:
        mesh = scene.conversion.mesh
        places, corners, sizes = np.asarray(scene.vertices()), mesh.corners, mesh.sizes
    else:
        places = scene.patches()
        count, nu, nv = places.shape[:3]
        places = places.reshape(-1, places.shape[3])
        number = np.arange(count * nu * nv).reshape(count, nu, nv)
        cells = [number[:, :-1, :-1], number[:, 1:, :-1], number[:, 1:, 1:], number[:, :-1, 1:]]
        corners = np.stack(cells, axis=-1).ravel()
        sizes = np.full(len(corners) // 4, 4)
    screen = homogeneous(places) @ np.asarray(view.world_to_screen).T
    weight = screen[:, 3]
    starts = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    depth = np.add.reduceat(weight[corners], starts) / sizes
    behind = np.minimum.reduceat(weight[corners], starts) <= 0.0
    with np.errstate(divide="ignore", invalid="ignore"):
        flat = screen[:, :2] / weight[:, None]
    of = [corners[starts[k] : starts[k] + sizes[k]] for k in np.argsort(-depth) if not behind[k]]
    return Outlines([flat[own] for own in of], of)
