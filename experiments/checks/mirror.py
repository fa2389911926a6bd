"""What smoothness looks like in a mirror: stripes where normals jump most."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from slefejax import Camera, Scene, View, evaluate_patches
from slefejax.experiments.checks.splats import splatted
from slefejax.measure.jumps import normal_jumps, points_and_normals

_STRIPES = 7.0  # periods of the reflected environment in half a turn
_CLOSE = (420, 420)  # pixels
_TRIED = 64  # edges, until one is not hidden by other parts of the scene
_EDGES = 7.0  # lengths of the edge that is looked at, across a picture


def reflections(scenes: list[Scene]) -> Iterator[np.ndarray]:
    """Stripes that are reflected where normals of the first scene's patches jump most; the limit surface's at last."""
    first = scenes[0]
    assert first.conversion is not None
    sides = first.conversion.smooth_sides
    if not len(sides):
        return
    jumps = normal_jumps(first.patches(), sides)
    for edge in np.argsort(-jumps)[:_TRIED]:
        camera, up, normal = _close_up(first, sides[edge, 0])
        view = View(camera, *_CLOSE)
        # what is seen in the middle must be one of both patches
        seen = splatted(first.patches(), view, lambda which, places, *_: np.repeat(which[:, None], len(places), axis=1))
        if seen[_CLOSE[1] // 2, _CLOSE[0] // 2] in sides[edge, :, 0]:
            break
    else:
        return

    def paint(_: np.ndarray, __: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        return stripes(camera.eye - points, normals, up, normal)

    yield from (splatted(scene.patches(), view, paint) for scene in scenes)
    yield splatted(first.conversion.limit.net, view, paint)


def stripes(towards: np.ndarray, normals: np.ndarray, up: np.ndarray, ahead: np.ndarray) -> np.ndarray:
    """0 to 1: what of stripes around the axis ``up`` a camera sees in surfaces.

    towards : from each point to the camera, ``(..., 3)``
    normals : unit vectors ``(..., 3)``, to either side
    ahead   : the direction that is in the middle of what is reflected
    """
    towards = towards / np.linalg.norm(towards, axis=-1, keepdims=True)
    along = 2.0 * np.sum(normals * towards, axis=-1, keepdims=True) * normals - towards
    angle = np.arctan2(along @ np.cross(up, ahead), along @ ahead)
    return 0.5 + 0.5 * np.clip(4.0 * np.sin(2.0 * _STRIPES * angle), -1.0, 1.0)


def _close_up(scene: Scene, side: np.ndarray) -> tuple[Camera, np.ndarray, np.ndarray]:
    """A camera above the middle of a patch' side, the direction that is up in its picture, and the normal there."""
    patch, number = side
    middle = np.array([[[0.0, 0.5], [0.5, 0.0], [1.0, 0.5], [0.5, 1.0]][number]])
    point, normal = (x[0, 0] for x in points_and_normals(scene.patches()[[patch]], middle[None]))
    ends = evaluate_patches(scene.patches()[[patch]], np.array([[0.0, 0.0], [1.0, 1.0]]))[0]
    reach = _EDGES * float(np.linalg.norm(ends[0] - ends[1])) / np.sqrt(2.0)
    up = np.eye(3)[np.argmin(np.abs(normal))]
    return Camera.look_at(point + 2.0 * reach * normal, point, up, 27.0, 0.1 * reach, 4.0 * reach), up, normal
