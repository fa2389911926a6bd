"""Views that are meant to break a bound, of patches around the origin whose size is about 1 (``attack_nets``)."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from slefejax.experiments.attack.judge.screen import Look
from slefejax.geometry.view import Camera, View

Rng = np.random.Generator


def _towards(
    rng: Rng,
    direction: np.ndarray,
    distance: float,
    *,
    fov: float = 45.0,
    near: float | None = None,
    far: float | None = None,
    aside: float = 0.15,
    size: tuple[int, int] = (1440, 900),
) -> Look:
    """A camera that looks at a point near the origin, from a direction and a distance."""
    target = aside * rng.normal(size=3)
    eye = target + distance * direction / np.linalg.norm(direction)
    near = 0.02 * distance if near is None else near
    far = distance + 50.0 if far is None else far
    return Look(_three(eye), _three(target), _up(rng), fov, near, far, True, *size)


def _three(vector: np.ndarray) -> tuple[float, float, float]:
    return (float(vector[0]), float(vector[1]), float(vector[2]))


def _up(rng: Rng) -> tuple[float, float, float]:
    return _three(rng.normal(size=3))


def _around(rng: Rng) -> Look:
    return _towards(rng, rng.normal(size=3), rng.uniform(1.0, 4.0))


def _orthographic(rng: Rng) -> Look:
    eye = rng.normal(size=3)
    eye *= 3.0 / np.linalg.norm(eye)
    height = 10.0 ** rng.uniform(-0.5, 0.7)
    return Look(_three(eye), (0.0, 0.0, 0.0), _up(rng), height, 0.01, 10.0, False, 1440, 900)


def _edge_on(rng: Rng) -> Look:
    """Along the plane of the nets that are not turned, or nearly."""
    angle, tilt = rng.uniform(0.0, 2.0 * np.pi), 10.0 ** rng.uniform(-8.0, -1.0) * rng.integers(0, 2)
    return _towards(rng, np.array([np.cos(angle), np.sin(angle), tilt]), rng.uniform(1.0, 4.0), aside=0.0)


def _near_plane(rng: Rng) -> Look:
    """The near plane passes through the middle of the patches."""
    distance = rng.uniform(0.2, 2.0)
    return _towards(rng, rng.normal(size=3), distance, near=distance * rng.uniform(0.7, 1.2))


def _inside(rng: Rng) -> Look:
    """The eye among the patches, which pass through its plane."""
    return _towards(rng, rng.normal(size=3), rng.uniform(0.05, 0.4), fov=100.0, near=10.0 ** rng.uniform(-4.0, -1.0))


def _narrow(rng: Rng) -> Look:
    fov = 10.0 ** rng.uniform(-2.0, 0.0)
    distance = rng.uniform(0.5, 2.0) / np.tan(np.deg2rad(fov / 2.0))
    return _towards(rng, rng.normal(size=3), distance, fov=fov, near=0.5 * distance)


def _wide(rng: Rng) -> Look:
    return _towards(rng, rng.normal(size=3), rng.uniform(0.2, 1.5), fov=float(rng.choice([150.0, 170.0, 179.0])))


def _one_pixel(rng: Rng) -> Look:
    return _towards(rng, rng.normal(size=3), rng.uniform(1.0, 4.0), size=(1, 1))


def _huge(rng: Rng) -> Look:
    return _towards(rng, rng.normal(size=3), rng.uniform(1.0, 4.0), size=(20_000, 20_000))


def _off_centre(rng: Rng) -> Look:
    """At the rim of the picture, or across it."""
    return _towards(rng, rng.normal(size=3), rng.uniform(1.5, 4.0), aside=0.6)


def _far_away(rng: Rng) -> Look:
    return _towards(rng, rng.normal(size=3), 10.0 ** rng.uniform(2.0, 6.0))


VIEWS: dict[str, Callable[[Rng], Look]] = {
    "around": _around,
    "orthographic": _orthographic,
    "edge-on": _edge_on,
    "near-plane": _near_plane,
    "inside": _inside,
    "narrow": _narrow,
    "wide": _wide,
    "one-pixel": _one_pixel,
    "huge": _huge,
    "off-centre": _off_centre,
    "far-away": _far_away,
}


def elsewhere(look: Look, scale: float, offset: np.ndarray) -> Look:
    """The same view of a scene that has another size and lies elsewhere."""
    ends = [_three(np.asarray(point) * scale + offset) for point in (look.eye, look.target)]
    extent = look.extent if look.perspective else look.extent * scale
    return look._replace(eye=ends[0], target=ends[1], extent=extent, near=look.near * scale, far=look.far * scale)


def view_of(look: Look) -> View:
    """For the prediction."""
    make = Camera.look_at if look.perspective else Camera.orthographic
    camera = make(look.eye, look.target, look.up, look.extent, look.near, look.far)
    return View(camera, look.width, look.height)
