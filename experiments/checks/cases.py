"""Families of hard cases: each is easy at one end and as hard as it can be at the other."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from slefejax import Camera, View

_COUNT = 4  # patches of a case
_AWAY = np.array([0.6, -0.5, 0.62])  # direction of offsets


@dataclass(frozen=True)
class Case:
    """What is computed: patches in float64, before they are rounded to the precision that is tried."""

    patches: np.ndarray
    view: View
    tolerance: float = 0.5
    depth_tolerance: float | None = None
    segments: int = 3


@dataclass(frozen=True)
class Family:
    """Cases along one axis, the easiest first.

    parameter : what the values are, with its unit;  log : whether values go by decades
    case      : makes one of a value; None: it is none of patches in a view (``stability_rig``)
    """

    name: str
    parameter: str
    values: tuple[float, ...]
    case: Callable[[float], Case] | None = None
    log: bool = True


def _decades(first: int, last: int, step: int = 1) -> tuple[float, ...]:
    return tuple(float(10.0**k) for k in range(first, last + (1 if step > 0 else -1), step))


def bumpy(degree: int = 3, relief: float = 0.15, seed: int = 1, count: int = _COUNT) -> np.ndarray:
    """Patches over a unit square around the origin, ``(count, degree+1, degree+1, 3)``."""
    rng, t = np.random.default_rng(seed), np.linspace(-0.5, 0.5, degree + 1)
    u, v = np.meshgrid(t, t, indexing="ij")
    return np.stack([u, v, 0.0 * u], axis=2) + relief * rng.normal(size=(count, degree + 1, degree + 1, 3))


def seen_from(distance: float = 4.0, fov: float = 45.0, height: float = 0.6) -> View:
    """A camera that looks down on the origin, obliquely."""
    eye = distance * np.array([0.3, -np.sqrt(1 - height**2 - 0.09), height])
    return View(Camera.look_at(eye, (0, 0, 0), fov_y=fov, near=0.02 * distance, far=10 * distance), 1440, 900)


def _moved(offset: float) -> Case:
    move = offset * _AWAY
    eye = np.array(seen_from().camera.eye) + move
    return Case(bumpy() + move, View(Camera.look_at(eye, move, near=0.08, far=40.0), 1440, 900))


def _scaled(scale: float) -> Case:
    own = seen_from().camera
    camera = Camera.look_at(own.eye * scale, (0, 0, 0), near=0.08 * scale, far=40.0 * scale)
    return Case(bumpy() * scale, View(camera, 1440, 900))


def _flat(relief: float) -> Case:
    return Case(bumpy(relief=relief), seen_from())


def _straight(width: float) -> Case:
    return Case(bumpy() * [1.0, width, width], seen_from())


def _collapsed(kind: float) -> Case:
    patches = bumpy()
    if kind >= 1:
        patches[:, 0] = patches[:, :1, 0]
    if kind >= 2:
        patches[:, -1] = patches[:, -1:, 0]
    if kind >= 3:
        patches[:, :, 0] = patches[:, :1, 0]
    if kind >= 4:
        patches[:, 1:] = patches[:, 1:2, 1:2]
    if kind >= 5:
        patches[:] = patches[:, :1, :1]
    return Case(patches, seen_from())


def _of_degree(degree: float) -> Case:
    return Case(bumpy(int(degree), 0.3 / degree), seen_from())


def _in_segments(segments: float) -> Case:
    return Case(bumpy(), seen_from(), segments=int(segments))


def _weighted(spread: float) -> Case:
    patches, rng = bumpy(), np.random.default_rng(2)
    weights = spread ** rng.uniform(-0.5, 0.5, (*patches.shape[:3], 1))
    return Case(np.concatenate([patches * weights, weights], axis=3), seen_from())


def _at_the_near_plane(distance: float) -> Case:
    eye = np.array([0.1, 0.05, 1.0 + distance])
    camera = Camera.look_at(eye, eye - [0, 0, 1], up=(0, 1, 0), near=1.0, far=40.0)
    return Case(bumpy(), View(camera, 1440, 900), tolerance=2.0)


def _grazing(angle: float) -> Case:
    a = np.deg2rad(angle)
    eye = 4.0 * np.array([0.0, -np.cos(a), np.sin(a)])
    return Case(bumpy(relief=0.02), View(Camera.look_at(eye, (0, 0, 0), near=0.08, far=40.0), 1440, 900))


def _field_of_view(fov: float) -> Case:
    return Case(bumpy(), seen_from(1.3 / np.tan(np.deg2rad(fov) / 2.0), fov))


def _depth_range(ratio: float) -> Case:
    own = seen_from().camera
    camera = Camera.look_at(own.eye, (0, 0, 0), near=3.0 / np.sqrt(ratio), far=6.0 * np.sqrt(ratio))
    return Case(bumpy(), View(camera, 1440, 900), depth_tolerance=1e-7)


def _tolerance(tolerance: float) -> Case:
    return Case(bumpy(), seen_from(), tolerance=tolerance)


def _distance(distance: float) -> Case:
    return Case(bumpy(), seen_from(distance))


FAMILIES = (
    Family("offset", "distance from the origin / size", (0.0, *_decades(0, 8)), _moved),
    Family("scale up", "size of everything", _decades(0, 12, 2), _scaled),
    Family("scale down", "size of everything", _decades(0, -12, -2), _scaled),
    Family("flat", "relief / size", (0.3, *_decades(-1, -17, -2)), _flat),
    Family("straight", "width / length", _decades(0, -12, -2), _straight),
    Family(
        "collapsed",
        "edges that are points: none, 1, 2, 3; two points; one point",
        (0, 1, 2, 3, 4, 5),
        _collapsed,
        False,
    ),
    Family("degree", "bi-degree", (2, 3, 4, 6, 8, 12, 16, 20), _of_degree, False),
    Family("segments", "pieces m", (1, 2, 3, 4, 8, 16, 32), _in_segments, False),
    Family("weights", "largest / smallest weight", _decades(0, 12, 2), _weighted),
    Family(
        "near plane",
        "middle of the patch in front of it / size",
        (2.0, 1.0, 0.5, 0.2, 0.1, 0.0, -0.1, -0.3, -1.0, -3.0),
        _at_the_near_plane,
        False,
    ),
    Family("grazing", "angle to the surface, degrees", (90.0, 45.0, 10.0, 1.0, 0.1, 0.01, 1e-3, 1e-4), _grazing),
    Family("narrow", "field of view, degrees", (45.0, 20.0, 5.0, 1.0, 0.3, 0.1), _field_of_view),
    Family("wide", "field of view, degrees", (45.0, 90.0, 120.0, 150.0, 165.0, 170.0), _field_of_view, False),
    Family("depth range", "far / near", _decades(0, 12, 2), _depth_range),
    Family("tolerance up", "pixels", _decades(0, 3), _tolerance),
    Family("tolerance down", "pixels", _decades(0, -6, -1), _tolerance),
    Family("close", "distance of the camera / size", (4.0, 2.0, 1.0, 0.5, 0.2, 0.1), _distance),
    Family("far", "distance of the camera / size", _decades(1, 6), _distance),
    Family("valence", "faces around a vertex", (3, 4, 5, 8, 16, 64, 256)),
    Family(
        "half turn", "angle between two bones, degrees", (0, 90, 170, 179, 179.9, 179.999, 179.99999, 180), None, False
    ),
    Family("small weights", "skin weight", (1.0, 1e-3, 1e-6, 1e-9, 1e-12, 1e-30, 1e-300)),
    Family("stiff loss", "temperature of the loss", (0.1, 0.01, 1e-3, 1e-4, 1e-6)),
)
