"""Camera, viewport and projection: the conventions that the whole package uses.

Clip space, viewport and y axis are OpenGL's:

- a point (x, y, z, 1) of the world goes to clip space (X, Y, Z, W) by ``View.world_to_clip``; it is
  inside the view volume where -W <= X, Y, Z <= W, and W > 0 in front of the camera;
- screen coordinates are pixels: x = (X/W + 1) width/2 to the right, y = (Y/W + 1) height/2 upwards,
  the centre of the lower left pixel is (0.5, 0.5); images are arrays ``[row, column]``, row 0 at the bottom;
- window depth is (Z/W + 1)/2: 0 at the near plane, 1 at the far plane;
- triangles that are counter-clockwise in the domain (u to the right, v upwards) keep that winding.

``View.world_to_screen`` folds the viewport into the matrix, so that X/W, Y/W are pixels and Z/W is
window depth, without a division before it is needed.

Arrays stay NumPy float64 as long as the camera's numbers are plain numbers, and become JAX arrays
where a camera is traced (to differentiate by it).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from types import ModuleType
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from slefejax.arguments import Number, real_numbers
from slefejax.errors import InputError
from slefejax.lanes.plain import plain

Matrix = Array | np.ndarray  # (4, 4), NumPy or JAX
LARGEST = 1e100  # squares and products of such numbers are still finite
Vector = Array | np.ndarray | Sequence[Any]  # three numbers: a tuple, a list or an array


def _namespace(*values: Any) -> ModuleType:
    leaves = jax.tree_util.tree_leaves(values)
    return jnp if any(isinstance(leaf, Tracer) for leaf in leaves) else np


def _vector(values: Vector) -> Any:
    xp = _namespace(values)
    return xp.asarray(values) * 1.0 if xp is jnp else real_numbers(values, "eye, target and up")


def _check(condition: Any, message: str, *options: str) -> None:
    """Raise unless the condition is known and holds; a traced condition cannot be looked at."""
    if not isinstance(condition, Tracer) and not bool(condition):
        raise InputError(message, options=options)


@plain("eye", "target", "up", "extent", "near", "far")
@dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole or an orthographic camera; build it with ``look_at`` or ``orthographic``.

    eye, target, up : three numbers each, in the units of the scene
    extent          : vertical field of view in degrees, or the height of the picture in scene units
    near, far       : distances of the clipping planes from the eye, in scene units
    perspective     : whether there is perspective (static; all else may be traced)

    >>> Camera.look_at((0, -5, 0), (0, 0, 0)).eye.tolist()
    [0.0, -5.0, 0.0]
    >>> Camera.orthographic((0, -5, 0), (0, 0, 0), height=2.0).perspective
    False
    """

    eye: Any
    target: Any
    up: Any
    extent: Any
    near: Any
    far: Any
    perspective: bool

    @staticmethod
    def look_at(
        eye: Vector,
        target: Vector,
        up: Vector = (0.0, 0.0, 1.0),
        fov_y: Number = 45.0,
        near: Number = 0.1,
        far: Number = 100.0,
    ) -> Camera:
        """A perspective camera at ``eye`` that looks towards ``target``; ``fov_y`` in degrees.

        Raises InputError for a field of view outside 0 ... 180 degrees, near <= 0, far <= near, numbers
        that are not finite, or a view direction that is zero or parallel to ``up``.

        >>> Camera.look_at((0, -5, 0), (0, 0, 0)).perspective
        True
        """
        inside = (0.0 < _scalar(fov_y)) & (_scalar(fov_y) < 180.0)
        _check(inside, f"fov_y must lie between 0 and 180 degrees, not {fov_y}", "fov_y")
        _check(_scalar(near) > 0.0, f"near must be positive for a perspective camera, not {near}", "near")
        return Camera._checked(eye, target, up, fov_y, near, far, True)

    @staticmethod
    def orthographic(
        eye: Vector,
        target: Vector,
        up: Vector = (0.0, 0.0, 1.0),
        height: Number = 2.0,
        near: Number = 0.1,
        far: Number = 100.0,
    ) -> Camera:
        """A camera without perspective whose picture is ``height`` scene units high. Raises as ``look_at``."""
        _check(_scalar(height) > 0.0, f"height must be positive, not {height}")
        return Camera._checked(eye, target, up, height, near, far, False)

    @staticmethod
    def _checked(
        eye: Vector, target: Vector, up: Vector, extent: Any, near: Any, far: Any, perspective: bool
    ) -> Camera:
        camera = Camera(_vector(eye), _vector(target), _vector(up), extent, near, far, perspective)
        xp = _namespace(camera)
        for name in ("eye", "target", "up"):
            vector = getattr(camera, name)
            if vector.shape != (3,):
                raise InputError(
                    f"the camera's {name} must be three numbers, not an array of shape {vector.shape}", options=(name,)
                )
            if xp is np:
                largest = np.max(np.abs(vector))
                said = f"the camera's {name} must be finite, and below {LARGEST:g}, not {vector}"
                _check(largest < LARGEST, said, name)
        _check(_scalar(far) > _scalar(near), f"far ({far}) must be beyond near ({near})", "far", "near")
        for name, value in (("near", near), ("far", far), ("extent", extent)):
            if not isinstance(value, Tracer):  # in float32 the limit would overflow
                _check(np.abs(_scalar(value)) < LARGEST, f"the camera's {name} must be finite, not {value}", name)
        if xp is np:
            side = np.cross(_of_size_one(camera.target - camera.eye), _of_size_one(camera.up))
            said = "the camera's eye and target coincide, or the view direction is parallel to up"
            _check(np.any(side), said, "eye", "target", "up")
        return camera

    @property
    def world_to_eye(self) -> Matrix:
        """Rigid motion to eye coordinates: x right, y up, the camera at the origin looking along -z."""
        return self.to_eye((0.0, 0.0, 0.0))

    def to_eye(self, origin: Vector) -> Matrix:
        """The same for points relative to an origin."""
        xp = _namespace(self, origin)
        forward = _unit(self.target - self.eye)
        right = _unit(xp.cross(forward, self.up))
        rotation = xp.stack([right, xp.cross(right, forward), -forward])
        translation = rotation @ (xp.asarray(origin) - self.eye)
        upper = xp.concatenate([rotation, translation[:, None]], axis=1)
        return xp.concatenate([upper, xp.asarray([[0.0, 0.0, 0.0, 1.0]])])

    def eye_to_clip(self, aspect: Number) -> Matrix:
        """OpenGL's projection matrix; ``aspect`` is width over height."""
        xp = _namespace(self, aspect)
        near, far = _scalar(self.near), _scalar(self.far)
        zero, one = xp.zeros_like(near + 0.0), xp.ones_like(near + 0.0)
        if self.perspective:
            scale = 1.0 / xp.tan(xp.deg2rad(_scalar(self.extent)) / 2.0)
            depth = [(far + near) / (near - far), 2.0 * far * (near / (near - far))]
            last = [zero, zero, -one, zero]
        else:
            scale = 2.0 / _scalar(self.extent)
            depth = [2.0 / (near - far), (far + near) / (near - far)]
            last = [zero, zero, zero, one]
        rows = [[scale / aspect, zero, zero, zero], [zero, scale * one, zero, zero], [zero, zero, *depth], last]
        return xp.stack([xp.stack([xp.asarray(x) * one for x in row]) for row in rows])

    @property
    def near_w(self) -> Any:
        """Clip-space W of the near plane: ``near`` with perspective, 1 without."""
        return self.near if self.perspective else 1.0


@plain("camera", "width", "height")
@dataclass(frozen=True, eq=False)
class View:
    """A camera and the size of its picture in pixels.

    >>> view = View(Camera.look_at((0, -5, 0), (0, 0, 0)), width=1440, height=900)
    >>> view.world_to_clip.shape
    (4, 4)
    """

    camera: Camera
    width: Any
    height: Any

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            size = getattr(self, name)
            if isinstance(size, Tracer):
                continue
            whole = isinstance(size, (int, float, np.number, jax.Array)) and size >= 1 and float(size).is_integer()
            if not whole:
                raise InputError(f"the view's {name} must be a whole number of pixels, at least 1, not {size!r}")

    @property
    def world_to_clip(self) -> Matrix:
        """World to clip space: column vectors, homogeneous coordinates."""
        return self.to_clip((0.0, 0.0, 0.0))

    def to_clip(self, origin: Vector) -> Matrix:
        """The same for points relative to an origin; near the eye it has no large numbers that cancel."""
        return self.camera.eye_to_clip(self.width / self.height) @ self.camera.to_eye(origin)

    @property
    def clip_to_screen(self) -> Matrix:
        """Clip space to undivided pixels (x, y) and window depth."""
        xp = _namespace(self.width, self.height)
        half = [0.5 * self.width, 0.5 * self.height, 0.5]
        rows = [[half[k] if c == k else half[k] if c == 3 else 0.0 for c in range(4)] for k in range(3)]
        return xp.asarray([*rows, [0.0, 0.0, 0.0, 1.0]])

    @property
    def world_to_screen(self) -> Matrix:
        """World to (X, Y, Z, W) with X/W, Y/W in pixels and Z/W the window depth, 0 to 1."""
        return self.clip_to_screen @ self.world_to_clip


def bounding_sphere(points: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, float]:
    """(centre, radius) of a sphere around points: the centre of their box, the distance of the furthest.

    >>> centre, radius = bounding_sphere(np.array([[1.0, 0, 0], [-1.0, 0, 0]]))
    >>> centre.tolist(), float(radius)
    ([0.0, 0.0, 0.0], 1.0)
    """
    if not np.max(np.abs(points)) < LARGEST:
        raise InputError(f"the scene's coordinates must be finite and below {LARGEST:g} to look at it")
    centre = (points.min(axis=0) + points.max(axis=0)) / 2.0
    return centre, float(np.linalg.norm(points - centre, axis=1).max()) or 1.0


def frame(
    points: Float[np.ndarray, "n 3"],
    view_direction: Vector = (-0.5, 0.75, -0.4),
    fov_y: float = 45.0,
    aspect: float = 1.0,
    up: Vector = (0.0, 0.0, 1.0),
) -> Camera:
    """A perspective camera that looks along ``view_direction`` and holds the bounding sphere of the points.

    view_direction : as if z were up; it is turned to where ``up`` is
    aspect         : of the picture, width over height; a narrow picture needs more distance
    """
    centre, radius = bounding_sphere(points)
    direction = turned_up(view_direction, up)
    half = np.arctan(np.tan(np.deg2rad(fov_y) / 2.0) * min(1.0, aspect))
    distance = radius / np.sin(half)
    eye = centre - direction * distance
    return Camera.look_at(eye, centre, up, fov_y=fov_y, near=(distance - radius) / 4.0, far=4.0 * (distance + radius))


def turned_up(direction: Vector, up: Vector) -> np.ndarray:
    """A direction, given as if z were up, as a unit vector where ``up`` is: turned by what takes the z axis there."""
    vector, up = (np.asarray(v, np.float64) / np.linalg.norm(v) for v in (direction, up))
    if up[2] < -1.0 + 1e-9:
        return vector * [1.0, -1.0, -1.0]
    axis, cosine = np.cross([0.0, 0.0, 1.0], up), up[2]
    return cosine * vector + np.cross(axis, vector) + axis * (axis @ vector) / (1.0 + cosine)


def homogeneous(points: Float[Array | np.ndarray, "*rest dim"]) -> Any:
    """Points (x, y, z) become (x, y, z, 1); rational ones (w x, w y, w z, w) stay as they are.

    >>> homogeneous(np.array([[1.0, 2.0, 3.0]])).tolist()
    [[1.0, 2.0, 3.0, 1.0]]
    """
    if points.shape[-1] == 4:
        return points
    xp = np if isinstance(points, np.ndarray) else jnp
    return xp.concatenate([points, xp.ones_like(points[..., :1])], axis=-1)


def _scalar(value: Any) -> Any:
    if isinstance(value, (jax.Array, Tracer)):
        return value
    number = real_numbers(value, "angles, sizes and distances of a camera")
    if number.ndim:
        raise InputError(f"one number is needed for a camera's angle, size or distance, not an array {number.shape}")
    return number


def _unit(vector: Any) -> Any:
    vector = _of_size_one(vector)
    return vector / _namespace(vector).linalg.norm(vector)


def _of_size_one(vector: Any) -> Any:
    """Times a power of two, so that no square of a number vanishes; as it is if it is traced."""
    if not isinstance(vector, np.ndarray) or not np.any(vector):
        return vector
    return vector * 2.0 ** -np.floor(np.log2(np.abs(vector).max()))


def check_view(view: Any) -> None:
    """InputError unless this is a view.

    >>> check_view("front")
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: the view must be a slefejax.View (a camera and a picture size), not str
    """
    if not isinstance(view, View):
        raise InputError(f"the view must be a slefejax.View (a camera and a picture size), not {type(view).__name__}")


def check_views(views: Any) -> None:
    """InputError unless these are views, one at least, in a list or tuple."""
    if not isinstance(views, (list, tuple)) or not views or not all(isinstance(view, View) for view in views):
        raise InputError("views must be a list of slefejax.View (a camera and a picture size), one at least")
