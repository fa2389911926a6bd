"""A scene: patches and the camera to look at them with."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from slefejax.arguments import Number
from slefejax.conversion.acc import patch_corners
from slefejax.conversion.scheme import Conversion
from slefejax.errors import InputError
from slefejax.framing import PAPERS_SHARE, frame_share
from slefejax.geometry.gregory import GregoryPatches
from slefejax.geometry.view import Camera, Vector
from slefejax.io.content import Z_UP
from slefejax.model.gaussians import Gaussians
from slefejax.model.rig import Deformation, Pose, Rig
from slefejax.tessellator.edges import Sides


@dataclass(frozen=True, eq=False)
class Scene:
    """Patches with a name, where they come from, and what was noticed when they were read.

    control    : ``(patches, du+1, dv+1, 3)`` float64, 4 at the end if rational, at rest; or ``GregoryPatches``
    camera     : the camera that belongs to the scene, or None: ``default_camera`` then frames it
    notes      : sentences about what loading changed or left out
    up         : the direction that is up
    faces      : ``(patches,)``, the face, the surface or the patch of the file that each comes from
    kinds      : ``(patches,)``, numbers in ``slefejax.conversion.patchwork.KINDS``
    conversion : of a control mesh: how patches are made of it, differentiably, in any pose; None for other scenes
    rig        : what moves the control mesh; None if nothing does. The vertices of ``conversion.mesh`` are those that
                 it moves; ``vertices()`` are where they stand at rest

    >>> from slefejax import load
    >>> load("teapot").points().shape
    (512, 3)
    """

    name: str
    control: Any
    camera: Camera | None = None
    notes: tuple[str, ...] = field(default=())
    up: tuple[float, float, float] = Z_UP
    faces: Int[np.ndarray, "patches"] | None = None
    kinds: Int[np.ndarray, "patches"] | None = None
    conversion: Conversion | None = None
    rig: Rig | None = None

    def patches(self) -> Any:
        """Control points at rest, ``(patches, du+1, dv+1, 3)``, u before v; ``GregoryPatches`` of that scheme."""
        return self.control

    def vertices(self, pose: Any = None, deform: Deformation | None = None) -> Any:
        """Positions ``(vertices, 3)`` of the control mesh in a pose, by JAX; differentiable by it.

        pose   : a time of the scene's motion, a ``Pose`` (``Scene.rig.pose`` makes some), or None for the pose at rest
        deform : how bones move vertices: ``linear_blend``, ``dual_quaternion_blend``, or a function like them; None: as
                 the file says, linear if it says nothing

        Raises InputError for a scene without a control mesh, for a time before the first or after the last sample, and
        for a pose of another rig.
        """
        return getattr(found := self._moved(pose, deform), "means", found)

    def gaussians(self, pose: Any = None, deform: Deformation | None = None) -> Gaussians:
        """Means ``(vertices, 3)`` and covariances ``(vertices, 3, 3)`` of a covariance mesh in a pose, as ``vertices``.

        Covariances turn with the bones that carry their vertices. Raises InputError for other scenes, too.
        """
        if self.conversion is None or self.conversion.mesh.covariances is None:
            raise InputError(f"{self.name} has no covariances: load it with gaussians")
        return Gaussians(*self._moved(pose, deform, self.conversion.mesh.covariances))

    def _moved(self, pose: Any, deform: Deformation | None, covariances: Any = None) -> Any:
        """What patches are made of, in a pose: positions, or Gaussians."""
        if self.conversion is None:
            raise InputError(f"{self.name} is no control mesh: there are no vertices to move")
        vertices = self.conversion.mesh.vertices
        rest = jax.tree.map(
            jnp.asarray, self.conversion.control if covariances is None else Gaussians(vertices, covariances)
        )
        if self.mover is None:
            return rest
        return self.mover.posed(rest, pose if isinstance(pose, Pose) else self.mover.pose(pose), deform)

    @property
    def mover(self) -> Rig | None:
        """The rig; of Gaussian products without one a rig of nothing, as poses may have other covariances."""
        still = self.conversion is None or self.conversion.patchwork.products is None
        return self.rig if still or self.rig is not None else Rig()

    def pose(self, pose: Any = None, deform: Deformation | None = None) -> Any:
        """Control points of all patches in a pose, ``(patches, du+1, dv+1, 3)``: those at rest if nothing moves.

        Pose and deform as in ``vertices``.
        """
        if self.mover is None or self.conversion is None:
            return self.control
        with self.conversion.precision():
            return self.conversion.patchwork.patches(self._moved(pose, deform))

    def posed(self, pose: Any, deform: Deformation | None = None) -> Scene:
        """The scene as it stands in a pose, with nothing that moves any more.

        >>> from slefejax import load
        >>> load("walker").posed(6.0).rig is None
        True
        """
        if self.conversion is None or self.mover is None:
            raise InputError(f"{self.name} does not move: it has no pose but the one at rest")
        with self.conversion.precision():
            found = jax.tree.map(lambda x: np.asarray(x, np.float64), self._moved(pose, deform))
        named = found._asdict() if isinstance(found, Gaussians) else {"means": found}
        mesh = replace(self.conversion.mesh, **{"vertices" if k == "means" else k: x for k, x in named.items()})
        conversion = replace(self.conversion, mesh=mesh)
        return replace(self, control=conversion.patchwork.on_host(found), conversion=conversion, rig=None)

    @cached_property
    def sides(self) -> Sides:
        """Which curve each side is, found once: of a control mesh from its topology, otherwise from the points."""
        return Sides.of(self.control) if self.conversion is None else self.conversion.patchwork.sides

    @property
    def edge_numbers(self) -> Int[np.ndarray, "patches 4"]:
        """Which edges are shared: whole sides that are one curve have equal numbers."""
        return self.sides.numbers

    def points(self) -> Float[np.ndarray, "points 3"]:
        """All control points, divided by their weights if there are any; of Gregory patches their nets'."""
        if isinstance(self.control, GregoryPatches):
            return np.asarray(self.control.net).reshape(-1, 3)
        points = self.control[..., :3] / (self.control[..., 3:] if self.control.shape[-1] == 4 else 1.0)
        return points.reshape(-1, 3)

    def left_out(self) -> tuple[str, ...]:
        """What is not computed because this scene does not need it, a sentence each."""
        left = []
        if self.rig is None:
            left.append("skinning and shape keys: the scene does not move")
        elif self.rig.skeleton is None:
            left.append("skinning: there is no skeleton")
        elif self.rig.keys is None:
            left.append("shape keys: there are none")
        if self.control.shape[-1] == 3:
            left.append("weights: the patches are polynomial")
        if self.conversion is not None and self.conversion.finer.sizes.min() > 3:
            left.append("triangle stencils: patches come from quads only")
        return tuple(left)

    def texture_coordinates(self) -> Float[np.ndarray, "patches 2 2 2"]:
        """Texture coordinates of the corners of every patch, those at (u, v) = (i, j) in ``[:, i, j]``, the second up.

        Between corners they are bilinear in the patch's own u and v (``slefejax.model.texture.texture_at``). Where
        faces were subdivided they are the refined faces', by the linear rules: middles of edges, means of faces.

        A triangle is pinched at u = 1: its patch has the barycentric coordinates (1-u)(1-v), (1-u) v, u, the first at
        corner (0, 0), the second at (0, 1), the last at the pinch. Coordinates of the third corner stand at both ends
        of the side u = 1, so that bilinear interpolation is the triangle's linear one, and the same at the pinch for
        every v. NaN for patches of faces that have none in their file.

        Raises InputError for scenes without any, and for a scheme of one's own, whose patches' corners are not known.
        """
        if self.conversion is None:
            raise InputError(f"{self.name} is no control mesh: only those have texture coordinates")
        finer = self.conversion.finer
        if finer.texture is None:
            raise InputError(f"{self.name} has no texture coordinates: export the mesh with them")
        if not self.conversion.own_faces:
            said = (
                f"patches of the scheme {self.conversion.scheme!r} have no texture coordinates: choose another scheme"
            )
            raise InputError(said, options=("scheme",))
        return finer.texture[patch_corners(finer)]

    def tangents(self, pose: Any = None, deform: Deformation | None = None) -> tuple[Any, Any]:
        """Tangent patches in a pose (``Conversion.tangents``); pose and deform as in ``vertices``.

        Raises InputError for a scene without a control mesh.
        """
        if self.conversion is None:
            raise InputError(f"{self.name} is no control mesh: only those have tangent patches")
        return self.conversion.tangents(self.vertices(pose, deform))

    def default_camera(self, aspect: float = 1.6, cover: Number | None = None, up: Vector | None = None) -> Camera:
        """The scene's own camera, or one that frames it in a picture of that width over height.

        cover : the share of the picture that the scene shall cover; .38, as in [YBP12], where it has no own camera.
                Less where all of it would not be on the screen otherwise
        up    : the direction that is up in the picture; the scene's own if not given
        """
        if self.camera is not None and cover is None and up is None:
            return self.camera
        return frame_share(
            self.control, PAPERS_SHARE if cover is None else cover, aspect, self.up if up is None else up
        )
