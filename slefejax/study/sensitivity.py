"""What the triangles of a scene depend on: control points, bones, shape keys, the tolerance, the camera's distance."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from typing import Any, Unpack

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from slefejax.errors import InputError
from slefejax.geometry.view import View, bounding_sphere, check_view
from slefejax.model.gaussians import Gaussians
from slefejax.model.rig import Deformation, Pose
from slefejax.predict.methods import Options, Request
from slefejax.scene import Scene
from slefejax.study.budget import counted, moved, with_normals


@dataclass(frozen=True)
class Sensitivity:
    """Derivatives of the number of triangles, 2 sum tau^2 without rounding, in one view and pose.

    triangles : that number
    places    : ``(points, 3)``: vertices of the control mesh in the pose, or distinct control points of patches
    points    : ``(points, 3)``, triangles a scene unit by which the point is moved along x, y, z
    numbers   : ``(patches, du+1, dv+1)``, of a list of patches: which point each control point is; else None
    turns     : ``(joints, 3)``, triangles a radian about the joint's own x, y, z; None without skeleton
    shifts    : ``(joints, 3)``, triangles a unit along the joint's own x, y, z; None without skeleton
    keys      : ``(keys,)``, triangles a unit of the weight of each shape key; None without
    tolerance : triangles a factor e of the tolerance: about minus as many as there are
    distance  : triangles a factor e of the camera's distance from its target; NaN without perspective
    """

    triangles: float
    places: Float[np.ndarray, "points 3"]
    points: Float[np.ndarray, "points 3"]
    numbers: Int[np.ndarray, "patches nu nv"] | None
    turns: Float[np.ndarray, "joints 3"] | None
    shifts: Float[np.ndarray, "joints 3"] | None
    keys: Float[np.ndarray, "keys"] | None
    tolerance: float
    distance: float


def sensitivity(
    scene: Scene, view: View, pose: Any = None, *, deform: Deformation | None = None, **options: Unpack[Options]
) -> Sensitivity:
    """All derivatives at once, by reverse mode through projection, slefes or bounds, conversion, skinning, keys.

    pose    : a time of the scene's motion, a ``Pose``, or None for the pose at rest
    options : those of ``tessellation_factors`` but ``anisotropic`` and ``verify``; half a pixel and certified if none.
              Tangent patches, where normals are theirs, are the scene's, and move with it.
              With ``smooth`` ties are shared, without it one of those that tie counts (docs/gradients.md)

    Raises InputError for a scene, a pose or options that the functions above would refuse.
    """
    if not isinstance(scene, Scene):
        raise InputError(f"sensitivity is of a slefejax.Scene, as load gives it, not of {type(scene).__name__}")
    check_view(view)
    if pose is not None and scene.rig is None:
        raise InputError(f"{scene.name} does not move: it has no pose but the one at rest")
    request = Request.of(options, scene.control.shape[3])
    for name in ("anisotropic", "verify"):
        if getattr(request.method, name, False) is True:
            raise InputError(f"{name} finds whole numbers, which have no derivatives: leave it out", options=(name,))
    tolerance = float(request.tolerances.pixels)
    model = _Mesh(scene, pose, deform) if scene.conversion is not None else _Points(scene)
    sphere, normals = bounding_sphere(scene.points()), options.get("normals", "surface")
    if normals == "tangents":
        scene.tangents(pose, deform)  # a scene without is refused

    def count(at: dict[str, Any], model: Any) -> Any:
        seen = moved(view, sphere, jnp.exp(at["distance"])) if "distance" in at else view
        tangents = model.tangents(at) if normals == "tangents" else None
        prepared = with_normals(request, model.patches(at), normals, tangents)
        return counted(request.at(tolerance * jnp.exp(at["tolerance"])), prepared, seen)

    at = {**model.origin(), "tolerance": jnp.zeros(())}
    if view.camera.perspective:
        at["distance"] = jnp.zeros(())
    triangles, slope = jax.jit(jax.value_and_grad(partial(count, model=model)))(at)
    if not float(triangles) > 0:
        raise InputError(f"nothing of {scene.name} is visible from this camera: turn it towards the scene")
    slope = {name: np.asarray(value, np.float64) for name, value in slope.items()}
    return Sensitivity(
        float(triangles),
        model.places,
        slope["points"],
        model.numbers,
        slope.get("turns"),
        slope.get("shifts"),
        slope.get("keys"),
        float(slope["tolerance"]),
        float(slope.get("distance", np.nan)),
    )


class _Points:
    """A list of patches: control points that coincide move together, so that nothing opens."""

    def __init__(self, scene: Scene) -> None:
        self.control = scene.patches()
        flat = self.control.reshape(-1, self.control.shape[3])
        size = float(np.max(np.abs(flat))) or 1.0
        # as near as rounding leaves equal points
        _, first, numbers = np.unique(np.round(flat / size, 12), axis=0, return_index=True, return_inverse=True)
        self.places = flat[first, :3] / (flat[first, 3:] if flat.shape[1] == 4 else 1.0)
        self.numbers = numbers.reshape(self.control.shape[:3])

    def origin(self) -> dict[str, Any]:
        return {"points": jnp.zeros(self.places.shape)}

    def patches(self, at: dict[str, Any]) -> Any:
        offset = at["points"][self.numbers]
        if self.control.shape[3] == 3:
            return self.control + offset
        weighted = offset * self.control[..., 3:]
        return self.control + jnp.concatenate([weighted, jnp.zeros_like(weighted[..., :1])], axis=-1)


class _Mesh:
    """A control mesh, with what moves it."""

    numbers = None

    def __init__(self, scene: Scene, pose: Any, deform: Deformation | None) -> None:
        self.scene, self.deform, self.rig = scene, deform, scene.rig
        self.pose = Pose()
        if self.rig is not None:
            found = self.rig.check(pose if isinstance(pose, Pose) else self.rig.pose(pose))
            local, keys = found.local, found.keys
            if local is None and self.rig.skeleton is not None:
                local = jnp.asarray(self.rig.skeleton.rest)
            if keys is None and self.rig.keys is not None:
                keys = jnp.zeros(len(self.rig.keys.names))
            self.pose = found._replace(local=local, keys=keys)
        moved = self._moved(self.pose)
        self.places = np.asarray(getattr(moved, "means", moved), np.float64)

    def origin(self) -> dict[str, Any]:
        found: dict[str, Any] = {"points": jnp.zeros(self.places.shape)}
        if self.pose.local is not None:
            found["turns"] = found["shifts"] = jnp.zeros((len(self.pose.local), 3))
        if self.pose.keys is not None:
            found["keys"] = jnp.zeros(len(self.pose.keys))
        return found

    def patches(self, at: dict[str, Any]) -> Any:
        assert self.scene.conversion is not None
        return self.scene.conversion.patchwork.patches(self._changed(at))

    def tangents(self, at: dict[str, Any]) -> Any:
        assert self.scene.conversion is not None
        return self.scene.conversion.tangents(self._changed(at))

    def _changed(self, at: dict[str, Any]) -> Any:
        """Positions, or Gaussians, with what is differentiated by."""
        local, keys = self.pose.local, self.pose.keys
        if local is not None:
            local = local @ _small_motions(at["turns"], at["shifts"])
        if keys is not None:
            keys = keys + at["keys"]
        moved = self._moved(self.pose._replace(local=local, keys=keys))
        if isinstance(moved, Gaussians):
            return Gaussians(moved.means + at["points"], moved.covariances)
        return moved + at["points"]

    def _moved(self, pose: Pose) -> Any:
        """Positions, or Gaussians, in a pose."""
        assert self.scene.conversion is not None
        rest = jax.tree.map(jnp.asarray, self.scene.conversion.control)
        return rest if self.rig is None else self.rig.posed(rest, pose, self.deform)


def _small_motions(turns: Any, shifts: Any) -> Any:
    """Matrices ``(joints, 4, 4)`` of turns ``(joints, 3)``, to first order, and shifts."""
    x, y, z = turns[:, 0], turns[:, 1], turns[:, 2]
    one, zero = jnp.ones_like(x), jnp.zeros_like(x)
    rows = [[one, -z, y, shifts[:, 0]], [z, one, -x, shifts[:, 1]], [-y, x, one, shifts[:, 2]], [zero, zero, zero, one]]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
