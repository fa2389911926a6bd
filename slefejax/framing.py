"""A camera from which a scene covers a given share of the screen."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from slefejax.arguments import Number, Patches, check_patches
from slefejax.errors import InputError
from slefejax.geometry.evaluate import evaluate_patches
from slefejax.geometry.view import Camera, Vector, turned_up
from slefejax.late import one_at_a_time

PAPERS_SHARE = 0.38  # of the screen that a model covers in [YBP12], section 7
DIRECTION = (-0.5, 0.75, -0.4)
_PICTURE = 300  # pixels along the wider side of the picture in which coverage is measured
_MARGIN = 0.98  # of half the picture, within which everything stays
_CELLS = 20_000  # quads that are painted at most, as far as the number of patches allows
_STEPS = 6
_WITHIN = 0.002  # of the screen; a hundredth of what a different model or view changes


def clipping_planes(sphere: tuple[Any, Any], own: Camera, eye: Any) -> tuple[Any, Any]:
    """Near and far of a camera that is moved: its own, but so that the whole scene lies between them.

    sphere : centre and radius of the scene (``geometry.view.bounding_sphere``);  eye : the new place, may be traced
    """
    centre, radius = sphere
    xp: Any = jnp if isinstance(eye, jax.Array) else np
    with np.errstate(over="ignore"):  # the camera says what is wrong with such an eye
        distance = xp.linalg.norm(eye - xp.asarray(centre))
    near = xp.where(distance - radius > own.near, own.near, xp.minimum(own.near, radius / 1000.0))
    return near, xp.maximum(own.far, distance + 2.0 * radius)


def frame_share(
    patches: Patches,
    share: Number = PAPERS_SHARE,
    aspect: Number = 1.6,
    up: Vector = (0.0, 0.0, 1.0),
    fov_y: Number = 45.0,
) -> Camera:
    """A perspective camera from which the patches cover that share of the picture, or, if that is less, as much as can
    be seen with all of them on the screen.

    aspect : of the picture, width over height;  up : any direction

    Raises InputError for a share outside 0 ... 1, or no direction that is up, or no picture.
    """
    if not 0.0 < share <= 1.0:
        raise InputError(f"cover, a share of the screen, must lie between 0 and 1, not {share}", options=("cover",))
    if not (0.0 < aspect < np.inf and 0.0 < fov_y < 180.0):
        raise InputError(f"a picture needs a positive width over height and a field of view, not {aspect} and {fov_y}")
    if not (np.isfinite(up).all() and np.linalg.norm(up) > 0):
        raise InputError(f"up must be a direction, not {tuple(up)}", options=("up",))
    quads = _quads(check_patches(patches, gregory=True))
    flat = quads.reshape(-1, 3)
    centre = (flat.min(axis=0) + flat.max(axis=0)) / 2.0
    size = float(np.abs(flat - centre).max()) or 1.0
    forward = turned_up(DIRECTION, up)
    right = np.cross(forward, up) / np.linalg.norm(np.cross(forward, up))
    axes = np.stack([right, np.cross(right, forward), forward])
    local = (quads - centre) @ axes.T / size
    tangent = np.tan(np.deg2rad(fov_y) / 2.0)
    half = np.array([tangent * aspect, tangent])
    # the middle of the picture is where both sides, and top and bottom, need the same distance
    room = _MARGIN * half
    sides = [np.max(sign * local[..., :2] / room - local[..., 2:], axis=(0, 1)) for sign in (1.0, -1.0)]
    middle = room * (sides[0] - sides[1]) / 2.0
    local[..., :2] -= middle
    centre = centre + size * middle @ axes[:2]
    closest = float(np.max(sides[0] + sides[1]) / 2.0)
    closest = max(closest, 1e-3 - float(local[..., 2].min()), 1e-3)
    distance = _distance(local, half, closest, float(share))
    depths = distance + local[..., 2]
    near, far = 0.5 * float(depths.min()), 2.0 * float(depths.max())
    return Camera.look_at(centre - forward * distance * size, centre, up, fov_y, near * size, far * size)


def _distance(local: np.ndarray, half: np.ndarray, closest: float, share: float) -> float:
    """Where the share is reached: coverage falls nearly with the square of the distance."""
    distance, found = closest, _coverage(local, half, closest)
    low = closest
    for _ in range(_STEPS):
        if abs(found - share) < _WITHIN or (found < share and distance <= low):
            break
        distance = max(low, distance * float(np.sqrt(max(found, 1e-4) / share)))
        found = _coverage(local, half, distance)
    return distance


def _coverage(local: np.ndarray, half: np.ndarray, distance: float) -> float:
    """The share of the picture that the quads cover from that distance."""
    with one_at_a_time:
        from PIL import Image, ImageDraw  # not needed by whoever only computes

    aspect = half[0] / half[1]
    width, height = (_PICTURE, round(_PICTURE / aspect)) if aspect > 1 else (round(_PICTURE * aspect), _PICTURE)
    size = np.array([max(1, width), max(1, height)])
    screen = local[..., :2] / (distance + local[..., 2:]) / half
    pixels = (0.5 * size * (1.0 + screen)).reshape(len(local), -1)
    picture: Any = Image.new("1", tuple(size.tolist()))
    draw = ImageDraw.Draw(picture)
    for corners in pixels.tolist():
        draw.polygon(corners, fill=1)
    return float(np.asarray(picture).mean())


def _quads(patches: Any) -> Float[np.ndarray, "quads 4 3"]:
    """The patches cut into a few quads each."""
    pieces = int(np.clip(np.sqrt(_CELLS / len(patches)), 1, 8))
    t = np.linspace(0.0, 1.0, pieces + 1)
    places = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
    grid = np.reshape(evaluate_patches(patches, places), (len(patches), pieces + 1, pieces + 1, 3))
    a, b, c, d = grid[:, :-1, :-1], grid[:, 1:, :-1], grid[:, 1:, 1:], grid[:, :-1, 1:]
    return np.stack([a, b, c, d], axis=3).reshape(-1, 4, 3)
