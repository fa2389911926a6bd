"""Skeletons, and how their joints move over time (docs/math.md, 8).

A skeleton is a tree of joints. Each has a *bind transform*, from its own coordinates to those of the mesh at rest, and,
in a pose, a *local transform*, from its coordinates to its parent's. The world transform of a joint is that of its
parent times its local one, and what moves the vertices is world times inverse bind (``Skeleton.transforms``).
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer
from jaxtyping import Bool, Float, Int

from slefejax.arguments import floating, no_such, whole_numbers
from slefejax.errors import InputError
from slefejax.late import one_at_a_time
from slefejax.model.gaussians import Gaussians
from slefejax.model.skinning import (
    Influences,
    ShapeKeys,
    dual_quaternion_blend,
    linear_blend,
    polar_rotations,
    rotation_matrices,
)

_FLAT = 1e-12  # determinant of unit columns

Deformation = Callable[[Any, Any, Influences], Any]


def check_time(time: Any) -> None:
    """Raise InputError for what is no single number.

    >>> check_time("now")
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: a time must be a number, not 'now'
    """
    number = isinstance(time, (int, float, np.number, np.ndarray, jax.Array)) and not isinstance(time, bool)
    if not number or np.ndim(time) != 0 or np.iscomplexobj(time) or np.asarray(time).dtype.kind not in "fiu":
        raise InputError(f"a time must be a number, not {time!r}")


class Pose(NamedTuple):
    """How a rig stands; whatever is None is as at rest (``Rig.rest``).

    local       : ``(joints, 4, 4)`` local transforms of the joints
    keys        : ``(keys,)`` weights of the shape keys
    covariances : ``(vertices, 3, 3)`` of a covariance mesh at rest, instead of its own
    """

    local: Any = None
    keys: Any = None
    covariances: Any = None


@dataclass(frozen=True, eq=False)
class Skeleton:
    """A tree of joints; build it with ``Skeleton.of``.

    names   : of the joints
    parents : ``(joints,)``, number of the parent, -1 for a root
    bind    : ``(joints, 4, 4)``, from joint to mesh coordinates at rest, column vectors
    """

    names: tuple[str, ...]
    parents: Int[np.ndarray, "joints"]
    bind: Float[np.ndarray, "joints 4 4"]

    @staticmethod
    def of(names: Any, parents: Any, bind: Any) -> Skeleton:
        """Checked. Raises InputError, with the joint's name, for a parent that does not exist, a cycle, and a bind
        transform that is missing or cannot be inverted.
        """
        names, parents = tuple(names), whole_numbers(parents, "the parents of joints")
        if bind is None or len(np.shape(bind)) != 3 or np.shape(bind)[1:] != (4, 4):
            raise InputError(
                "a skeleton needs a bind transform, 4 x 4, of every joint: without it there is no rest pose"
            )
        bind = np.asarray(bind, np.float64)
        if not len(names) == len(parents) == len(bind):
            raise InputError(
                f"a skeleton needs as many parents and bind transforms as joints: there are {len(names)} joints,"
                f" {len(parents)} parents, {len(bind)} bind transforms"
            )
        bad = np.flatnonzero((parents < -1) | (parents >= len(names)))
        if bad.size:
            raise InputError(f"joint {names[bad[0]]!r} has the parent {parents[bad[0]]}, but there are {len(names)}")
        skeleton = Skeleton(names, parents, bind)
        deepest = skeleton.depth
        cycle = np.flatnonzero(deepest < 0)
        if cycle.size:
            raise InputError(f"joint {names[cycle[0]]!r} is its own ancestor: the joints must form a tree")
        singular = np.flatnonzero(~(np.abs(np.linalg.det(bind[:, :3, :3])) > 0) | ~np.isfinite(bind).all(axis=(1, 2)))
        if singular.size:
            raise InputError(f"the bind transform of joint {names[singular[0]]!r} cannot be inverted")
        return skeleton

    @cached_property
    def depth(self) -> Int[np.ndarray, "joints"]:
        """Ancestors of every joint; -1 for those that are on a cycle or hang on one."""
        depth = np.where(self.parents < 0, 0, -1)
        for _ in range(len(self.parents)):
            known = (depth < 0) & (depth[self.parents] >= 0)
            if not known.any():
                break
            depth[known] = depth[self.parents[known]] + 1
        return depth

    @cached_property
    def inverse_bind(self) -> Float[np.ndarray, "joints 4 4"]:
        """From mesh to joint coordinates at rest."""
        return np.linalg.inv(self.bind)

    @cached_property
    def rest(self) -> Float[np.ndarray, "joints 4 4"]:
        """The local transforms of the bind pose."""
        parent = np.where((self.parents >= 0)[:, None, None], self.inverse_bind[self.parents], np.eye(4))
        return parent @ self.bind

    def world(self, local: Array | np.ndarray) -> Array | np.ndarray:
        """``(joints, 4, 4)`` world transforms of local ones; differentiable.

        Products of 1, 2, 4 … generations: as many steps as the depth of the tree has binary digits.
        """
        found, above = jnp.asarray(local), self.parents
        while np.any(above >= 0):
            known = (above >= 0)[:, None, None]
            product = jnp.einsum("jab,jbc->jac", found[np.maximum(above, 0)], found)
            found = jnp.where(known, product, found)
            above = np.where(above >= 0, above[np.maximum(above, 0)], -1)
        return found

    def transforms(self, local: Array | np.ndarray) -> Array | np.ndarray:
        """``(joints, 3, 4)``: what moves vertices of the rest pose, world times inverse bind."""
        world = self.world(local)
        return jnp.einsum("jab,jbc->jac", world, jnp.asarray(self.inverse_bind, world.dtype))[:, :3]


@dataclass(frozen=True, eq=False)
class Motion:
    """Samples of a pose over time, in between interpolated: translations and scales linearly, rotations along the arc.

    times        : ``(samples,)``, growing, in the units of the file (frames or seconds)
    translations : ``(samples, joints, 3)``;  rotations : ``(samples, joints, 4)`` quaternions (w, x, y, z)
    scales       : ``(samples, joints, 3)``, or None for none
    keys         : ``(samples, keys)`` weights of shape keys, or None for none
    """

    times: Float[np.ndarray, "samples"]
    translations: Float[np.ndarray, "_ joints 3"] | None = None
    rotations: Float[np.ndarray, "_ joints 4"] | None = None
    scales: Float[np.ndarray, "_ joints 3"] | None = None
    keys: Float[np.ndarray, "_ keys"] | None = None

    def __post_init__(self) -> None:
        if len(self.times) == 0 or np.any(np.diff(self.times) <= 0) or not np.isfinite(self.times).all():
            raise InputError("the times of a motion must be finite numbers that grow, at least one")
        for name in ("translations", "rotations", "scales", "keys"):
            values = getattr(self, name)
            if values is not None and len(values) != len(self.times):
                raise InputError(f"a motion has {len(self.times)} times but {len(values)} {name}")

    @property
    def span(self) -> tuple[float, float]:
        """The first and the last time."""
        return float(self.times[0]), float(self.times[-1])

    def check(self, time: Any) -> None:
        """Raise InputError for a time outside of the motion's own; a traced time cannot be looked at."""
        first, last = self.span
        if isinstance(time, Tracer):
            return
        check_time(time)
        if len(self.times) > 1 and not first <= float(time) <= last:
            raise InputError(f"time {float(time):g} lies outside of the motion, {first:g} to {last:g}")

    def _between(self, time: Any) -> tuple[Any, Any]:
        times = jnp.asarray(self.times)
        if len(self.times) == 1:
            return 0, jnp.zeros_like(jnp.asarray(time, float))
        k = jnp.clip(jnp.searchsorted(times, time, side="right") - 1, 0, len(self.times) - 2)
        return k, jnp.clip((time - times[k]) / (times[k + 1] - times[k]), 0.0, 1.0)

    def local(self, time: Any) -> Array | np.ndarray:
        """``(joints, 4, 4)`` local transforms at a time; they stay before the first and after the last."""
        k, share = self._between(time)
        n = min(1, len(self.times) - 1)

        def linear(values: Any) -> Array | np.ndarray:
            values = jnp.asarray(values)
            return (1 - share) * values[k] + share * values[k + n]

        turn = rotation_matrices(_arc(jnp.asarray(self.rotations)[k], jnp.asarray(self.rotations)[k + n], share))
        if self.scales is not None:
            turn = turn * linear(self.scales)[:, None, :]
        upper = jnp.concatenate([turn, linear(self.translations)[:, :, None]], axis=2)
        last = jnp.broadcast_to(jnp.asarray([0.0, 0.0, 0.0, 1.0], upper.dtype), (len(upper), 1, 4))
        return jnp.concatenate([upper, last], axis=1)

    def weights(self, time: Any) -> Array | np.ndarray:
        """``(keys,)`` weights of the shape keys at a time."""
        k, share = self._between(time)
        values = jnp.asarray(self.keys)
        return (1 - share) * values[k] + share * values[k + min(1, len(self.times) - 1)]


def _arc(p: Array | np.ndarray, q: Array | np.ndarray, share: Any) -> Array | np.ndarray:
    """Spherical interpolation of unit quaternions, the short way; straight where they are close."""
    cosine = jnp.sum(p * q, axis=-1, keepdims=True)
    q, cosine = jnp.where(cosine < 0, -q, q), jnp.abs(cosine)
    near = cosine > 1.0 - float(jnp.finfo(cosine.dtype).eps) ** 0.5
    angle = jnp.arccos(jnp.where(near, 0.0, cosine))
    sine = jnp.sin(angle)
    a = jnp.where(near, 1.0 - share, jnp.sin((1.0 - share) * angle) / sine)
    b = jnp.where(near, share, jnp.sin(share * angle) / sine)
    return a * p + b * q


@dataclass(frozen=True, eq=False)
class Rig:
    """What moves a control mesh; whatever is None is not there and is not computed.

    skeleton, influences : joints and which of them move each vertex
    keys                 : shape keys
    motion               : poses over time
    rate                 : units of time (frames) a second
    rest                 : how the scene stands where no pose is asked for, arrays of the host; what is None in it is
                           where the vertices of the mesh are: joints as bound, all keys of weight 0
    dual_quaternions     : which vertices the file wants blended by dual quaternions; None for none

    Raises InputError for joints without influences or the other way round, and for a rest pose that does not fit.
    """

    skeleton: Skeleton | None = None
    influences: Influences | None = None
    keys: ShapeKeys | None = None
    motion: Motion | None = None
    rate: float = 24.0
    rest: Pose = field(default_factory=Pose)
    dual_quaternions: Bool[np.ndarray, "vertices"] | None = None

    def pose(self, time: Any = None, keys: Any = None) -> Pose:
        """The pose at a time of the motion, or at rest without one; differentiable by the time.

        keys : weights of shape keys instead of the motion's: ``(keys,)``, or a mapping from some of their names; the
               others keep those that they have, at rest if there is no motion of them

        Raises InputError for a time outside of the motion, keys that do not exist, and too few or too many weights.

        >>> from slefejax import load
        >>> rig = load("walker").rig
        >>> rig.pose(3.0, keys={"smile": 1.0}).keys.shape
        (6,)
        """
        local = weights = None
        if time is not None and self.motion is not None:
            self.motion.check(time)
            if self.skeleton is not None and self.motion.rotations is not None:
                local = self.motion.local(time)
            if self.keys is not None and self.motion.keys is not None:
                weights = self.motion.weights(time)
        return Pose(local, weights if keys is None else self._weights(keys, weights))

    def _weights(self, given: Any, own: Any) -> Array | np.ndarray:
        names = self.keys.names if self.keys is not None else ()
        if not isinstance(given, Mapping):
            if np.shape(given) != (len(names),):
                raise InputError(
                    f"there are {len(names)} shape keys, so weights must be ({len(names)},), not {np.shape(given)}"
                )
            return jnp.asarray(given)
        unknown = [name for name in given if name not in names]
        if unknown:
            raise InputError(no_such("shape key", unknown[0], names))
        if own is None:
            own = jnp.zeros(len(names)) if self.rest.keys is None else jnp.asarray(self.rest.keys)
        places = np.array([names.index(name) for name in given], np.int64)
        return own.at[places].set(jnp.stack([jnp.asarray(w, own.dtype) for w in given.values()])) if given else own

    def deform(
        self, rest: Array | np.ndarray, transforms: Array | np.ndarray, influences: Influences
    ) -> Array | np.ndarray:
        """The deformation that the file asks for, linear where it asks for none; each vertex by its own."""
        dual = self.dual_quaternions
        if dual is None or not dual.any():
            return linear_blend(rest, transforms, influences)
        blended = dual_quaternion_blend(rest, transforms, influences)
        return blended if dual.all() else jnp.where(dual[:, None], blended, linear_blend(rest, transforms, influences))

    def posed(self, rest: Any, pose: Pose, deform: Deformation | None = None) -> Any:
        """Positions ``(vertices, 3)`` of the mesh moved to where they are in a pose: shape keys first, then bones.

        rest   : positions, or ``Gaussians``: their covariances turn with the bones, R Sigma R^T
        deform : how bones move vertices; None: as the file says

        Raises InputError for a pose of another number of joints or keys, and for parts that this rig does not have.
        """
        pose = self.check(pose)
        if isinstance(rest, Gaussians):
            if pose.covariances is not None:
                rest = Gaussians(rest.means, pose.covariances)
            pose = pose._replace(covariances=None)
            return Gaussians(self.posed(rest.means, pose, deform), self._turned(rest, pose, deform))
        if pose.covariances is not None:
            raise InputError("a pose with covariances is of a covariance mesh, and this one has none")
        if pose.keys is not None and self.keys is not None:
            rest = rest + self.keys.offsets(pose.keys)
        if pose.local is not None and self.skeleton is not None:
            rest = (deform or self.deform)(rest, self.skeleton.transforms(pose.local), self.influences)  # type: ignore[arg-type]
        return rest

    def _turned(self, rest: Gaussians, pose: Pose, deform: Deformation | None) -> Any:
        """Covariances turned by the rotations in the derivatives of where each vertex goes by where it was."""
        if pose.local is None or self.skeleton is None:
            return rest.covariances
        bent = lambda x: self.posed(x, pose, deform)  # noqa: E731
        axes = [jnp.broadcast_to(axis, rest.means.shape) for axis in jnp.eye(3, dtype=rest.means.dtype)]
        jacobian = jnp.stack([jax.jvp(bent, (rest.means,), (axis,))[1] for axis in axes], axis=-1)
        turn = polar_rotations(jacobian)
        return turn @ rest.covariances @ jnp.swapaxes(turn, -1, -2)

    def at_rest(self, control: Any, deform: Deformation | None = None) -> Any:
        """Positions ``(vertices, 3)``, or ``Gaussians``, moved to where they are in the rest pose, on the host.

        In float64.
        """
        if all(part is None for part in self.rest):
            return jax.tree.map(lambda x: np.asarray(x, np.float64), control)
        with jax.enable_x64(True):
            return jax.tree.map(np.asarray, self.posed(jax.tree.map(jnp.asarray, control), self.rest, deform))

    def check(self, pose: Pose) -> Pose:
        """The pose as arrays, what it leaves open as it is at rest.

        Raises InputError for what are no numbers, or of another number of joints or keys.
        """
        both = zip(pose, self.rest, strict=True)
        pose = Pose(*(own if given is None else floating(given) for given, own in both))
        joints = 0 if self.skeleton is None else len(self.skeleton.names)
        keys = 0 if self.keys is None else len(self.keys.names)
        if pose.local is not None and np.shape(pose.local) != (joints, 4, 4):
            raise InputError(f"a pose of {joints} joints needs transforms ({joints}, 4, 4), not {np.shape(pose.local)}")
        if pose.keys is not None and np.shape(pose.keys) != (keys,):
            raise InputError(f"a pose of {keys} shape keys needs weights ({keys},), not {np.shape(pose.keys)}")
        return pose

    def __post_init__(self) -> None:
        if (self.skeleton is None) != (self.influences is None):
            raise InputError("a rig needs both a skeleton and the influences of its joints, or neither")
        if self.skeleton is not None and self.influences is not None:
            joints = len(self.skeleton.names)
            if self.influences.table.columns != joints:
                raise InputError(f"influences are of {self.influences.table.columns} joints, the skeleton has {joints}")
            rows = self.influences.table.rows
            if self.dual_quaternions is not None and np.shape(self.dual_quaternions) != (rows,):
                raise InputError(
                    f"dual_quaternions must say it of {rows} vertices, not {np.shape(self.dual_quaternions)}"
                )
        if not all(part is None or np.isfinite(part).all() for part in self.check(self.rest)):
            raise InputError("the rest pose of a rig has numbers that are not finite")


def transform_of(translation: Any, rotation: Any, scale: Any) -> Float[np.ndarray, "4 4"]:
    """The matrix of a scale, then a rotation (w, x, y, z), then a translation.

    >>> transform_of([1, 2, 3], [1, 0, 0, 0], [2, 2, 2]).tolist()[0]
    [2.0, 0.0, 0.0, 1.0]
    """
    matrix = np.eye(4)
    w, x, y, z = rotation
    with one_at_a_time:
        from scipy.spatial.transform import Rotation  # slow to import

    matrix[:3, :3] = Rotation.from_quat([x, y, z, w]).as_matrix() * np.asarray(scale)
    matrix[:3, 3] = translation
    return matrix


def transform_parts(matrix: Float[np.ndarray, "4 4"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Translation, rotation (w, x, y, z) and scale of a matrix that is made of them.

    >>> [part.tolist() for part in transform_parts(np.diag([2.0, 2.0, 2.0, 1.0]))]
    [[0.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [2.0, 2.0, 2.0]]
    """
    upper = matrix[:3, :3]
    scale = np.linalg.norm(upper, axis=0)
    if np.linalg.det(upper) < 0:
        scale[0] = -scale[0]
    turn = upper / np.where(scale != 0, scale, 1.0)
    if not np.linalg.det(turn) > _FLAT:
        # what flattens space has no rotation of its own: the nearest one
        u, _, v = np.linalg.svd(turn)
        turn = u @ np.diag([1.0, 1.0, np.linalg.det(u @ v)]) @ v
    with one_at_a_time:
        from scipy.spatial.transform import Rotation  # slow to import

    x, y, z, w = Rotation.from_matrix(turn).as_quat()
    return matrix[:3, 3], np.array([w, x, y, z]), scale
