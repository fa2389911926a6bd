"""A view as kernels need it: for points relative to an origin near to them or to the eye."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from slefejax.geometry.view import View
from slefejax.lanes import nets


class Projection(NamedTuple):
    """What factors need to know of a view, for points relative to an origin that is near to them or to the eye.

    Far from the world's origin digits would be lost otherwise, in single precision all of them a million sizes away.
    """

    to_pixels: Any  # (4, 4): to undivided pixels from the picture's centre, half window depth, W
    frustum: Any  # (6, 4): linear in the homogeneous point, all at least 0 inside the view volume
    near_w: Any  # W of the near plane
    half: Any  # (3,): half the picture's width and height in pixels, half the window depth
    origin: Any  # (3,), in the world
    rounded: Any = 0.0  # 1 if points were rounded before the origin is taken off, else 0

    @staticmethod
    def of(view: View, dtype: Any = np.float64, origin: Any = None, rounded: bool = False) -> Projection:
        """Numbers of a type. The frustum: left, right, bottom, top, near and far plane.

        origin : three numbers of that type; None: the eye. What the eye loses in that type is part of the matrices
        """
        origin = view.camera.eye.astype(dtype) if origin is None else origin
        clip = view.to_clip(origin)
        xp = np if isinstance(clip, np.ndarray) else jnp
        half = (0.5 * view.width, 0.5 * view.height, 0.5)
        scaled = [clip[row] * extent for row, extent in enumerate((*half, 1.0))]
        planes = [extent * clip[3] + sign * row for row, extent in zip(scaled, half, strict=False) for sign in (1, -1)]
        parts = (xp.stack(scaled), xp.stack(planes), view.camera.near_w, xp.asarray(half), origin, float(rounded))
        return Projection(*(xp.asarray(part, dtype) for part in parts))

    def relative(self, points: Any, axis: int = -2) -> Any:
        """World points relative to the origin (``relative``)."""
        return relative(points, self.origin, axis)


def relative(points: Any, origin: Any, axis: int = -2) -> Any:
    """Points, three or four homogeneous coordinates along an axis, relative to an origin."""
    shape = [1] * points.ndim
    shape[axis] = 3
    origin = origin.reshape(shape)
    if points.shape[axis] == 3:
        return points - origin
    xp = np if isinstance(points, np.ndarray) else jnp
    own, weight = xp.split(points, [3], axis=axis)
    return xp.concatenate([own - weight * origin, weight], axis=axis)


def least_distance(dtype: Any) -> float:
    """How small distances to the near plane may be, so that products of two such numbers keep their digits."""
    return float(jnp.finfo(dtype).tiny) ** 0.5


def harmless(control: Any, projection: Projection, scale: Any = 1.0) -> Any:
    """Whether all control points are finite, and small enough for their images, over a scale, to be."""
    # the sum of their sizes, which costs less than the largest of them and is not much more
    reach, eye = nets.sum_of_sizes(control), jnp.max(jnp.abs(projection.origin))
    reach = reach + eye * (reach if control.shape[2] == 4 else 1.0)
    # a sum of four products of points and matrix entries, differences of such sums, and the picture's size
    return jnp.isfinite(64 * (reach / scale) * jnp.max(jnp.abs(projection.frustum)))


def positive(control: Any) -> Any:
    """Whether all weights are; polynomial patches, ``(du+1, dv+1, 3, lanes)``, have none."""
    if control.shape[2] == 3:
        return True
    return jnp.all(control[:, :, 3] > 0, axis=(0, 1))
