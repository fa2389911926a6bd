"""Meshes and NURBS patches of USD as control meshes and splines, put where they stand."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from slefejax.errors import InputError, naming
from slefejax.io.content import Spline
from slefejax.model.mesh import Mesh


@dataclass
class Shapes:
    """Reads shapes at a time, with the library's geometry; what it changes or does not follow stands in notes."""

    path: Path
    time: Any
    geometry: Any
    notes: list[str] = field(default_factory=list)

    def mesh(self, shape: Any, place: Float[np.ndarray, "4 4"], mirrored: bool) -> tuple[Mesh, int] | None:
        """The mesh without its holes, and how many faces it has with them; None if nothing is left.

        place    : from its own coordinates to where it is put; where that mirrors, faces turn round
        mirrored : whether what moves it there mirrors it once more

        Raises InputError for lists that do not fit together, and as ``Mesh`` does.
        """
        name = str(shape.GetPath())
        vertices = self._points(shape, place)
        sizes = self._array(shape.GetFaceVertexCountsAttr(), np.int64)
        corners = self._array(shape.GetFaceVertexIndicesAttr(), np.int64)
        if len(sizes) == 0:
            self.notes.append(f"{name} has no faces and was left out")
            return None
        if np.any(sizes < 0) or sizes.sum() != len(corners):
            raise InputError(f"{name} lists {len(corners)} corners, but its faces have {sizes.sum()}")
        pairs, sharpness = self._creases(shape, name)
        with naming(name):
            own = Mesh.packed(
                vertices,
                corners,
                sizes,
                texture=self._texture(shape, corners, len(vertices)),
                creases=pairs,
                crease_sharpness=sharpness,
                points=self._array(shape.GetCornerIndicesAttr(), np.int64),
                point_sharpness=self._array(shape.GetCornerSharpnessesAttr(), np.float64),
            )
        own = self._with_edges(own.turned() if self._turned(shape, place) != mirrored else own, name)
        left = self._without_holes(own, shape, name)
        if left is None:
            return None
        self._remark(shape, name, left)
        return left, own.face_count

    def nurbs(self, patch: Any, place: Float[np.ndarray, "4 4"]) -> Spline:
        """A spline surface. Raises InputError for a trimmed one, and for lists that do not fit together."""
        name = str(patch.GetPath())
        if len(self._array(patch.GetTrimCurveCountsAttr(), np.int64)):
            raise InputError(f"{name} is a trimmed surface, which is not supported: remove its trim curves")
        nu, nv = (int(self._get(a(), 0)) for a in (patch.GetUVertexCountAttr, patch.GetVVertexCountAttr))
        points = self._points(patch, place)
        if nu < 2 or nv < 2 or len(points) != nu * nv:
            raise InputError(f"{name} should have {nu} x {nv} points, not {len(points)}")
        weights = self._array(patch.GetPointWeightsAttr(), np.float64)
        if weights.size:
            if len(weights) != len(points):
                raise InputError(f"{name} has {len(weights)} weights for {len(points)} points")
            with np.errstate(invalid="ignore"):  # what is not finite is told with the name of the surface
                points = np.concatenate([points * weights[:, None], weights[:, None]], axis=1)
        control = points.reshape(nv, nu, -1).swapaxes(0, 1)  # u varies fastest
        axes = ((patch.GetUOrderAttr, patch.GetUKnotsAttr), (patch.GetVOrderAttr, patch.GetVKnotsAttr))
        degrees = tuple(int(self._get(order(), 0)) - 1 for order, _ in axes)
        knots = [self._array(k(), np.float64) for _, k in axes]
        bounds = [self._bounds(a()) for a in (patch.GetURangeAttr, patch.GetVRangeAttr)]
        if self._turned(patch, place):  # u the other way
            control, knots[0] = control[::-1], -knots[0][::-1]
            bounds[0] = None if bounds[0] is None else (-bounds[0][1], -bounds[0][0])
        return Spline(control, degrees, tuple(knots), tuple(bounds), f"{self.path}: {name}")  # type: ignore[arg-type]

    def _get(self, attribute: Any, default: Any = None) -> Any:
        value = attribute.Get(self.time)
        return default if value is None else value

    def _array(self, attribute: Any, dtype: Any) -> np.ndarray:
        return np.array(self._get(attribute, []), dtype)

    def _points(self, shape: Any, place: Float[np.ndarray, "4 4"]) -> Float[np.ndarray, "points 3"]:
        own = self._array(shape.GetPointsAttr(), np.float64).reshape(-1, 3)
        return own if np.array_equal(place, np.eye(4)) else own @ place[:3, :3].T + place[:3, 3]

    def _turned(self, shape: Any, place: Float[np.ndarray, "4 4"]) -> bool:
        """Whether the front is on the other side: listed the other way round, or mirrored, but not both."""
        return (self._get(shape.GetOrientationAttr()) == "leftHanded") != (np.linalg.det(place[:3, :3]) < 0)

    def _with_edges(self, mesh: Mesh, name: str) -> Mesh:
        """Without creases that are no edges."""
        known = mesh.edge_between(mesh.creases) >= 0
        if known.all():
            return mesh
        first, count = mesh.creases[np.argmin(known)], np.count_nonzero(~known)
        self.notes.append(
            f"{name}: {count} of {len(known)} creases join vertices that share no edge, and were left out"
            f" (the first joins {first[0]} and {first[1]}, counted from 0)"
        )
        return replace(mesh, creases=mesh.creases[known], crease_sharpness=mesh.crease_sharpness[known])

    def _without_holes(self, own: Mesh, mesh: Any, name: str) -> Mesh | None:
        holes = self._array(mesh.GetHoleIndicesAttr(), np.int64)
        holes = np.unique(holes[(holes >= 0) & (holes < own.face_count)])
        if not holes.size:
            return own
        self.notes.append(f"{name} has {holes.size} holes: those faces were left out, their edges are boundaries")
        keep = np.ones(own.face_count, bool)
        keep[holes] = False
        return own.keep(keep) if keep.any() else None

    def _remark(self, shape: Any, name: str, mesh: Mesh) -> None:
        scheme = self._get(shape.GetSubdivisionSchemeAttr())
        if scheme != "catmullClark":
            self.notes.append(
                f"{name} says subdivision scheme '{scheme}': it was taken as a Catmull-Clark control mesh"
            )
        rule = self._get(shape.GetInterpolateBoundaryAttr())
        if rule != "edgeAndCorner":
            self.notes.append(f"{name} says boundary rule '{rule}': it was taken as 'edgeAndCorner'")
        rule = self._get(shape.GetTriangleSubdivisionRuleAttr())
        if rule != "catmullClark" and np.any(mesh.sizes == 3):
            self.notes.append(f"{name} says triangle subdivision rule '{rule}': it was taken as 'catmullClark'")

    def _texture(
        self, shape: Any, corners: Int[np.ndarray, "corners"], count: int
    ) -> Float[np.ndarray, "corners 2"] | None:
        """Of every corner, from ``primvars:st`` of corners or vertices; None without. InputError for a wrong number."""
        own = self.geometry.PrimvarsAPI(shape).GetPrimvar("st")
        if not own.HasValue() or not count:
            return None
        kind = str(own.GetInterpolation())
        if kind not in ("faceVarying", "vertex", "varying"):
            self.notes.append(f"{shape.GetPath()}: primvars:st of interpolation '{kind}' was left out")
            return None
        found = np.array(own.ComputeFlattened(self.time), np.float64)
        wanted = len(corners) if kind == "faceVarying" else count
        if found.shape != (wanted, 2):
            raise InputError(f"primvars:st should be {wanted} pairs of numbers, not an array {found.shape}")
        return found if kind == "faceVarying" else np.take(found, corners, axis=0, mode="clip")  # wrong ones are told

    def _creases(self, mesh: Any, name: str) -> tuple[Int[np.ndarray, "pairs 2"], Float[np.ndarray, "pairs"]]:
        """Chains of vertices with one sharpness a chain or one an edge, as pairs."""
        indices = self._array(mesh.GetCreaseIndicesAttr(), np.int64)
        lengths = self._array(mesh.GetCreaseLengthsAttr(), np.int64)
        given = self._array(mesh.GetCreaseSharpnessesAttr(), np.float64)
        edges = np.maximum(lengths - 1, 0)
        if np.any(lengths < 2) or lengths.sum() != len(indices) or len(given) not in (len(lengths), edges.sum()):
            raise InputError(f"the creases of {name} do not fit their lengths and sharpnesses")
        last = np.zeros(len(indices), bool)
        last[np.cumsum(lengths) - 1] = True
        starts = np.flatnonzero(~last)
        sharpness = given if len(given) == edges.sum() else np.repeat(given, edges)
        return indices[starts[:, None] + [0, 1]].reshape(-1, 2), sharpness

    def _bounds(self, attribute: Any) -> tuple[float, float] | None:
        value = self._get(attribute)
        return None if value is None or not value[0] < value[1] else (float(value[0]), float(value[1]))
