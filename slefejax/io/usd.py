"""USD (.usd, .usda, .usdc, .usdz), through usd-core: meshes with creases, and NURBS patches, at their earliest time.

Everything is brought to the coordinates of the stage. The package is an extra: ``pip install 'slefejax[usd]'``.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from slefejax.errors import InputError
from slefejax.io.content import Y_UP, Z_UP, Content, Spline, joined, probe, read_bytes
from slefejax.io.usd_skel import SkelReader
from slefejax.mesh import Mesh

_ROUNDINGS = 4  # of points, which USD has in single precision, and of what was computed before


def read_usd(path: Path) -> Content:
    """All meshes of a stage as one control mesh, and its NURBS patches.

    Raises InputError if the file is none, for trimmed patches, and for geometry that does not fit together.
    """
    binary = not read_bytes(path).startswith(b"#usda")  # says what is wrong with the file itself
    try:
        from pxr import Tf, Usd
    except ImportError:
        raise InputError(f"{path}: to read USD, install usd-core (pip install 'slefejax[usd]')") from None
    if binary:
        probe("usd", path)
    usd: Any = Usd  # whose stubs know little
    try:
        stage = usd.Stage.Open(str(path))
    except Tf.ErrorException:
        raise InputError(f"{path} is no USD file that can be read: is it complete?") from None
    try:
        return _content(path, stage)
    except InputError:
        raise
    except (Tf.ErrorException, RuntimeError, TypeError, ValueError, OverflowError) as error:
        # a stage is whatever a file says; the library finds out when it is asked
        said = next((line.strip() for line in str(error).splitlines() if line.strip()), type(error).__name__)
        raise InputError(f"{path} contradicts itself: {said.split(' : ')[-1][:200]}") from None


def _content(path: Path, stage: Any) -> Content:
    from pxr import Usd, UsdGeom

    usd: Any = Usd
    geometry: Any = UsdGeom
    time = usd.TimeCode.EarliestTime()
    reader = _Reader(path, time, geometry, SkelReader(path, stage, time))
    walk = iter(usd.PrimRange.Stage(stage, usd.TraverseInstanceProxies()))
    for prim in walk:
        if not reader.take(prim):
            walk.PruneChildren()
    up = Y_UP if geometry.GetStageUpAxis(stage) == geometry.Tokens.y else Z_UP
    return reader.content(up)


class _Reader:
    def __init__(self, path: Path, time: Any, geometry: Any, skeletons: SkelReader) -> None:
        self.path, self.time, self.geometry, self.skeletons = path, time, geometry, skeletons
        self.paths: list[str] = []
        self.cache = geometry.XformCache(time)
        self.meshes: list[Mesh] = []
        self.counts: list[int] = []
        self.splines: list[Spline] = []
        self.notes: list[str] = []
        self.others: dict[str, int] = {}

    def content(self, up: tuple[float, float, float]) -> Content:
        if not self.meshes and not self.splines:
            raise InputError(f"{self.path} holds no mesh and no NURBS patch")
        if self.others:
            said = ", ".join(f"{count} of {name}" for name, count in sorted(self.others.items()))
            self.notes.append(f"geometry of other kinds was left out: {said}")
        mesh = joined(self.meshes, self.counts) if self.meshes else None
        counts = [mesh.vertex_count for mesh in self.meshes]
        starts = np.cumsum([0, *counts])[:-1].tolist()
        rig = self.skeletons.rig(list(zip(self.paths, counts, starts, strict=True)))
        largest = max((float(np.abs(spline.control[..., :3]).max()) for spline in self.splines), default=0.0)
        digits = _ROUNDINGS * float(np.finfo(np.float32).eps) * largest
        return Content(mesh, tuple(self.splines), up=up, notes=tuple(self.notes), rig=rig, digits=digits)

    def take(self, prim: Any) -> bool:
        """One prim; whether what lies below it is wanted too."""
        shape = self.geometry.Imageable(prim)
        if shape and (
            self.get(shape.GetVisibilityAttr()) == "invisible" or self.get(shape.GetPurposeAttr()) == "guide"
        ):
            self.leave_out("what is invisible or a guide")
            return False
        if prim.IsA(self.geometry.Mesh):
            self.mesh(self.geometry.Mesh(prim))
        elif prim.IsA(self.geometry.NurbsPatch):
            self.nurbs(self.geometry.NurbsPatch(prim))
        elif prim.IsA(self.geometry.PointInstancer):
            self.leave_out("PointInstancer")
            return False
        elif prim.IsA(self.geometry.Gprim):
            self.leave_out(str(prim.GetTypeName()))
        return True

    def leave_out(self, name: str) -> None:
        self.others[name] = self.others.get(name, 0) + 1

    def get(self, attribute: Any, default: Any = None) -> Any:
        value = attribute.Get(self.time)
        return default if value is None else value

    def array(self, attribute: Any, dtype: Any) -> np.ndarray:
        return np.array(self.get(attribute, []), dtype)

    def points(self, shape: Any) -> np.ndarray:
        """The points of a shape in the coordinates of the stage; USD multiplies row vectors from the left."""
        own = self.array(shape.GetPointsAttr(), np.float64).reshape(-1, 3)
        place = self.skeletons.place(str(shape.GetPath()))
        if place is None:
            place = np.array(self.cache.GetLocalToWorldTransform(shape.GetPrim()), np.float64).T
        return own if np.array_equal(place, np.eye(4)) else own @ place[:3, :3].T + place[:3, 3]

    def mesh(self, mesh: Any) -> None:
        name = str(mesh.GetPath())
        vertices = self.points(mesh)
        sizes = self.array(mesh.GetFaceVertexCountsAttr(), np.int64)
        corners = self.array(mesh.GetFaceVertexIndicesAttr(), np.int64)
        if len(sizes) == 0:
            self.notes.append(f"{name} has no faces and was left out")
            return
        if sizes.sum() != len(corners):
            raise InputError(f"{self.path}: {name} lists {len(corners)} corners, but its faces have {sizes.sum()}")
        if self.get(mesh.GetOrientationAttr()) == "leftHanded":
            corners = _reversed(corners, sizes)
        pairs, sharpness = self.creases(mesh, name)
        points = self.array(mesh.GetCornerIndicesAttr(), np.int64)
        try:
            own = Mesh.packed(
                vertices,
                corners,
                sizes,
                creases=pairs,
                crease_sharpness=sharpness,
                points=points,
                point_sharpness=self.array(mesh.GetCornerSharpnessesAttr(), np.float64),
            )
        except InputError as error:
            raise InputError(f"{self.path}: {name}: {error}") from None
        left = self.without_holes(own, mesh, name)
        if left is not None:
            self.meshes.append(left)
            self.paths.append(name)
            self.counts.append(own.face_count)
            self.remark(mesh, name)

    def without_holes(self, own: Mesh, mesh: Any, name: str) -> Mesh | None:
        holes = self.array(mesh.GetHoleIndicesAttr(), np.int64)
        holes = holes[(holes >= 0) & (holes < own.face_count)]
        if not holes.size:
            return own
        self.notes.append(f"{name} has {holes.size} holes: those faces were left out, their edges are boundaries")
        keep = np.ones(own.face_count, bool)
        keep[holes] = False
        return own.keep(keep) if keep.any() else None

    def remark(self, mesh: Any, name: str) -> None:
        scheme = self.get(mesh.GetSubdivisionSchemeAttr())
        if scheme in ("none", "loop", "bilinear"):
            self.notes.append(
                f"{name} says subdivision scheme '{scheme}': it was taken as a Catmull-Clark control mesh"
            )
        rule = self.get(mesh.GetInterpolateBoundaryAttr())
        if rule not in (None, "edgeAndCorner"):
            self.notes.append(f"{name} says boundary rule '{rule}': it was taken as 'edgeAndCorner'")

    def creases(self, mesh: Any, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Chains of vertices with one sharpness a chain or one an edge, as pairs."""
        indices = self.array(mesh.GetCreaseIndicesAttr(), np.int64)
        lengths = self.array(mesh.GetCreaseLengthsAttr(), np.int64)
        given = self.array(mesh.GetCreaseSharpnessesAttr(), np.float64)
        edges = np.maximum(lengths - 1, 0)
        if np.any(lengths < 2) or lengths.sum() != len(indices) or len(given) not in (len(lengths), edges.sum()):
            raise InputError(f"{self.path}: the creases of {name} do not fit their lengths and sharpnesses")
        ends = np.cumsum(lengths)
        pairs = [
            indices[start + k : start + k + 2]
            for start, end in zip(ends - lengths, ends, strict=True)
            for k in range(end - start - 1)
        ]
        sharpness = given if len(given) == edges.sum() else np.repeat(given, edges)
        return np.array(pairs, np.int64).reshape(-1, 2), sharpness

    def nurbs(self, patch: Any) -> None:
        name = str(patch.GetPath())
        if len(self.array(patch.GetTrimCurveCountsAttr(), np.int64)):
            raise InputError(
                f"{self.path}: {name} is a trimmed surface, which is not supported: remove its trim curves"
            )
        nu, nv = (int(self.get(a(), 0)) for a in (patch.GetUVertexCountAttr, patch.GetVVertexCountAttr))
        points = self.points(patch)
        if nu < 2 or nv < 2 or len(points) != nu * nv:
            raise InputError(f"{self.path}: {name} should have {nu} x {nv} points, not {len(points)}")
        weights = self.array(patch.GetPointWeightsAttr(), np.float64)
        if weights.size:
            if len(weights) != len(points):
                raise InputError(f"{self.path}: {name} has {len(weights)} weights for {len(points)} points")
            with np.errstate(invalid="ignore"):  # what is not finite is told with the name of the surface
                points = np.concatenate([points * weights[:, None], weights[:, None]], axis=1)
        control = points.reshape(nv, nu, -1).swapaxes(0, 1)  # u varies fastest
        axes = ((patch.GetUOrderAttr, patch.GetUKnotsAttr), (patch.GetVOrderAttr, patch.GetVKnotsAttr))
        degrees = tuple(int(self.get(order(), 0)) - 1 for order, _ in axes)
        knots = tuple(self.array(k(), np.float64) for _, k in axes)
        bounds = tuple(self.bounds(a()) for a in (patch.GetURangeAttr, patch.GetVRangeAttr))
        self.splines.append(Spline(control, degrees, knots, bounds, f"{self.path}: {name}"))  # type: ignore[arg-type]

    def bounds(self, attribute: Any) -> tuple[float, float] | None:
        value = self.get(attribute)
        return None if value is None or not value[0] < value[1] else (float(value[0]), float(value[1]))


def _reversed(corners: np.ndarray, sizes: np.ndarray) -> np.ndarray:
    """Every face the other way round, beginning with the same vertex."""
    ends = np.cumsum(sizes)
    starts = np.repeat(ends - sizes, sizes)
    place = np.arange(len(corners)) - starts
    return corners[starts + (np.repeat(sizes, sizes) - place) % np.repeat(sizes, sizes)]
