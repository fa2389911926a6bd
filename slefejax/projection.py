"""A view as kernels need it, and points brought to where the kernels' numbers hold them.

Kernels compute with points relative to an origin near to them or to the eye. The origin is taken off in the precision
that the points come in, before anything is rounded: on the host where that is more than JAX has, or where a scene is so
small or so large that single numbers of it are none any more (``placed``).
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from slefejax import layout, nets
from slefejax.view import View


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


def placed(patches: Any, view: View) -> tuple[Any, Projection]:
    """Patches ``(patches, du+1, dv+1, dim)`` in the layout of the kernels, and the projection that goes with them."""
    dtype = jax.dtypes.canonicalize_dtype(patches.dtype)
    unit = _unit(view, dtype)
    known = not isinstance(patches, Tracer) and isinstance(view.camera.world_to_eye, np.ndarray)
    if not known or (patches.dtype == dtype and unit == 1.0):
        packed = layout.pack(patches)
        origin = line_of_sight(view, packed)
        return packed, Projection.of(view, dtype, origin, rounded=patches.dtype != dtype)
    points = np.asarray(patches, np.float64)
    origin = _beside_nearest(view, np.moveaxis(points[:, 0, 0], 0, -1))
    near = relative(points, origin, axis=-1)
    near[..., :3] *= unit
    moved = Projection.of(_in_units(view, unit), dtype, origin * unit)
    with np.errstate(over="ignore"):  # what overflows is refused with the patch's number
        near = near.astype(dtype)
    return layout.pack(near), moved._replace(origin=np.zeros(3, dtype))


def least_distance(dtype: Any) -> float:
    """How small distances to the near plane may be, so that products of two such numbers keep their digits."""
    return float(jnp.finfo(dtype).tiny) ** 0.5


def _unit(view: View, dtype: Any) -> float:
    """What to multiply a scene by whose numbers would not be held: a power of two, 1 for all but strange ones."""
    camera = view.camera
    size = camera.near if camera.perspective else camera.extent
    least = least_distance(dtype)
    if isinstance(size, Tracer) or least <= size <= 1.0 / least:
        return 1.0
    return float(2.0 ** -np.floor(np.log2(float(size))))


def _in_units(view: View, unit: float) -> View:
    camera = view.camera
    names = ("eye", "target", "near", "far") + (() if camera.perspective else ("extent",))
    return replace(view, camera=replace(camera, **{name: getattr(camera, name) * unit for name in names}))


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


def line_of_sight(view: View, packed: Any) -> Any:
    """An origin for control points in the layout of the kernels: on the line of sight, beside the nearest of them.

    That is the eye if some are beside or behind it. There points that matter have small coordinates, and those of the
    origin on the screen are 0. The eye, too, if points or view are traced.
    """
    camera = view.camera
    if isinstance(packed, Tracer) or not isinstance(camera.world_to_eye, np.ndarray):
        return camera.eye.astype(packed.dtype)
    corners = np.moveaxis(np.asarray(packed)[:, 0, 0].astype(np.float64), 1, 0)
    return _beside_nearest(view, corners.reshape(len(corners), -1)).astype(packed.dtype)


def _beside_nearest(view: View, corners: np.ndarray) -> np.ndarray:
    """The same in float64, from one control point of each patch, ``(dim, patches)``."""
    camera = view.camera
    with np.errstate(invalid="ignore", over="ignore"):
        points = corners[:3] / (corners[3] if len(corners) == 4 else 1.0)
        ahead = -camera.world_to_eye[2, :3] @ (points - camera.eye[:, None])
    nearest = np.min(ahead, where=np.isfinite(ahead), initial=camera.far)
    return camera.eye - max(nearest, 0.0) * camera.world_to_eye[2, :3]
