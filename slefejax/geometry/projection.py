"""A view as kernels need it: for points relative to an origin near to them or to the eye."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.typing import DTypeLike

from slefejax.arguments import Number
from slefejax.geometry.gregory import Twisted
from slefejax.geometry.view import View
from slefejax.lanes import nets
from slefejax.lanes.nets import Lanes, Net


class Projection(NamedTuple):
    """What factors need to know of a view, for points relative to an origin that is near to them or to the eye.

    Far from the world's origin digits would be lost otherwise, in single precision all of them a million sizes away.

    >>> from slefejax import Camera
    >>> view = View(Camera.look_at((0, -5, 0), (0, 0, 0)), 400, 300)
    >>> Projection.of(view).half.tolist()
    [200.0, 150.0, 0.5]
    """

    to_pixels: Any  # (4, 4): to undivided pixels from the picture's centre, half window depth, W
    frustum: Any  # (6, 4): linear in the homogeneous point, all at least 0 inside the view volume
    near_w: Any  # W of the near plane
    half: Any  # (3,): half the picture's width and height in pixels, half the window depth
    origin: Any  # (3,), in the world
    rounded: Any = 0.0  # 1 if points were rounded before the origin is taken off, else 0

    @staticmethod
    def of(view: View, dtype: DTypeLike = np.float64, origin: Any = None, rounded: bool = False) -> Projection:
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
        """World points relative to the origin (``relative``); twists of Gregory patches are differences as they are."""
        if isinstance(points, Twisted):
            return Twisted(relative(points.net, self.origin, axis), points.twists)
        return relative(points, self.origin, axis)

    def undivided(self, control: Array | np.ndarray) -> list[Any]:
        """X, Y, Z, W ``(du+1, dv+1, lanes)`` of control points ``(du+1, dv+1, 3 or 4, lanes)`` near the origin."""
        return undivided(self.to_pixels, nets.coordinates(control, unrolled=False))


def undivided(rows: Array | np.ndarray | list[Any], points: list[Net]) -> list[Net]:
    """Linear functions of points given by coordinates, three or four homogeneous ones: the rows of ``(r, 4)``.

    >>> x, w = undivided(np.array([[2.0, 0, 0, 1], [0, 0, 1, 0]]), [np.array([3.0]), np.array([0.0]), np.array([5.0])])
    >>> x.tolist(), w.tolist()
    ([7.0], [5.0])
    """
    return [nets.each(partial(_image, row), *points) for row in numbers(rows)]


def _image(row: list[Any], *point: Lanes) -> Lanes:
    affine = [row[3]] if len(point) == 3 else []
    return nets.total([m * x for m, x in zip(row, point, strict=False)] + affine)


def numbers(matrix: Array | np.ndarray | list[Any]) -> list[list[Any]]:
    """The entries, each taken out once: where they are used again and again, that is a third of the program.

    >>> numbers(np.eye(4))[1] == [0, 1, 0, 0]
    True
    """
    return [[row[a] for a in range(4)] for row in matrix]


def reaches(row: Net, w: Net, half: Number) -> tuple[Lanes, Lanes]:
    """How far inside of the planes row/W = -half and +half the innermost coefficients are; negative if outside.

    >>> row, w = jnp.array([[[1.0]]]), jnp.array([[[2.0]]])
    >>> [float(own[0]) for own in reaches(row, w, 3.0)]  # at 1/2, between -3 and 3, times W
    [7.0, 5.0]
    """
    return nets.top(nets.each(lambda x, y: half * y + x, row, w)), nets.top(
        nets.each(lambda x, y: half * y - x, row, w)
    )


def relative(points: Any, origin: Array | np.ndarray, axis: int = -2) -> Array | np.ndarray:
    """Points, three or four homogeneous coordinates along an axis, relative to an origin.

    >>> relative(np.array([[2.0, 4.0, 6.0, 2.0]]), np.array([1.0, 1.0, 1.0]), axis=-1).tolist()
    [[0.0, 2.0, 4.0, 2.0]]
    """
    shape = [1] * points.ndim
    shape[axis] = 3
    origin = origin.reshape(shape)
    if points.shape[axis] == 3:
        return points - origin
    xp = np if isinstance(points, np.ndarray) else jnp
    own, weight = xp.split(points, [3], axis=axis)
    return xp.concatenate([own - weight * origin, weight], axis=axis)


def least_distance(dtype: DTypeLike) -> float:
    """How small distances to the near plane may be, so that products of two such numbers keep their digits.

    >>> least_distance(np.float32) < 2e-19
    True
    """
    return float(jnp.finfo(dtype).tiny) ** 0.5


def harmless(control: Any, projection: Projection, scale: Number = 1.0) -> Array:
    """Whether all control points are finite, and small enough for their images, over a scale, to be."""
    # the sum of their sizes, which costs less than the largest of them and is not much more
    net, twists = control if isinstance(control, Twisted) else (control, None)
    reach, eye = nets.sum_of_sizes(net), jnp.max(jnp.abs(projection.origin))
    reach = reach + eye * (reach if net.shape[2] == 4 else 1.0)
    reach = reach if twists is None else reach + jnp.sum(jnp.abs(twists), axis=(0, 1))
    # a sum of four products of points and matrix entries, differences of such sums, and the picture's size
    return jnp.isfinite(64 * (reach / scale) * jnp.max(jnp.abs(projection.frustum)))


def positive(control: Any) -> Array | bool:
    """Whether all weights are; polynomial patches, ``(du+1, dv+1, 3, lanes)``, have none.

    >>> bool(positive(jnp.ones((2, 2, 4, 1)))[0]), positive(jnp.ones((2, 2, 3, 1)))
    (True, True)
    """
    if isinstance(control, Twisted) or control.shape[2] == 3:
        return True
    return jnp.all(control[:, :, 3] > 0, axis=(0, 1))


def unless_bad(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """The kernel for points in the world, with NaN for harmful patches: its selects would hide them."""

    def checked(control: Any, projection: Projection, *arguments: Any) -> Any:
        found = kernel(projection.relative(control), projection, *arguments)
        return jnp.where(harmless(control, projection) & positive(control), found, jnp.nan)

    return checked
