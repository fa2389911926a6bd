"""Rhino's .3dm, through rhino3dm: NURBS surfaces, untrimmed faces of polysurfaces, extrusions, meshes; blocks.

What is hidden, or on a layer that is off, is left out, and said. A mirrored instance of a block keeps the front of what
it places in front: faces of meshes run the other way round, surfaces have u and v exchanged.

The package is an extra: ``pip install 'slefejax[rhino]'``.
"""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from slefejax.errors import InputError, naming
from slefejax.io.content import Content, Spline, joined, probe, read_bytes
from slefejax.io.limits import check_numbers
from slefejax.io.rhino.blocks import Blocks
from slefejax.late import one_at_a_time
from slefejax.model.mesh import Mesh


def read_3dm(path: Path) -> Content:
    """The surfaces of a file and, as one control mesh, its meshes, where they are shown.

    Raises InputError if the file is none, for trimmed faces, for blocks without end, and if it shows nothing of the
    kind.
    """
    read_bytes(path)  # says what is wrong with the file itself
    try:
        with one_at_a_time:
            import rhino3dm
    except ImportError:
        raise InputError(f"{path}: to read .3dm, install rhino3dm (pip install 'slefejax[rhino]')") from None
    probe("3dm", path)
    model: Any = rhino3dm.File3dm.Read(str(path))
    if model is None:
        raise InputError(f"{path} is no .3dm file that can be read: is it complete?")
    blocks, shapes, others = Blocks(path, model), _Shapes(path), Counter[str]()
    meshes: list[Mesh] = []
    splines: list[Spline] = []
    numbers = 0
    for number, shape, place in blocks.shown():
        for found in shapes.of(number, shape):
            if isinstance(found, str):
                others[found] += 1
                continue
            is_mesh = isinstance(found, Mesh)
            numbers += 3 * found.vertex_count + len(found.corners) if is_mesh else found.control.size
            check_numbers(path, "what its blocks place", numbers)
            if is_mesh:
                meshes.append(_placed_mesh(found, place))
            else:
                splines.append(_placed_spline(found, place))
    notes = tuple(
        f"{what}: {', '.join(f'{count} {name}' for name, count in sorted(counts.items()))}"
        for what, counts in (("objects of other kinds were left out", others), ("left out", blocks.left_out))
        if counts
    )
    if not meshes and not splines:
        raise InputError("; ".join([f"{path} shows no surface and no mesh", *notes]))
    return Content(joined(meshes) if meshes else None, tuple(splines), notes=notes)


class _Shapes:
    """Meshes and surfaces of a model's objects, each made once, however often it is placed."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._known: dict[int, list[Mesh | Spline | str]] = {}

    def of(self, number: int, shape: Any) -> list[Mesh | Spline | str]:
        """What an object is made of; the name of its kind if that is not read."""
        if number not in self._known:
            self._known[number] = self._made(shape, f"{self._path}: object {number} (counted from 0)")
        return self._known[number]

    @staticmethod
    def _made(shape: Any, name: str) -> list[Mesh | Spline | str]:
        with one_at_a_time:
            import rhino3dm

        if isinstance(shape, rhino3dm.Extrusion):
            shape = shape.ToBrep(True)
        if isinstance(shape, rhino3dm.Mesh):
            return [_mesh(shape, name) if shape.Faces.Count else "empty Mesh"]
        if isinstance(shape, rhino3dm.Brep):
            faces: Any = shape.Faces
            return [_face(faces[k], f"{name}, face {k}") for k in range(len(faces))]
        if isinstance(shape, rhino3dm.Surface):
            return [_surface(shape.ToNurbsSurface(), name)]
        return [type(shape).__name__]


def _placed_mesh(mesh: Mesh, place: Float[np.ndarray, "4 4"]) -> Mesh:
    moved = replace(mesh, vertices=mesh.vertices @ place[:3, :3].T + place[:3, 3])
    return moved.turned() if _mirrors(place) else moved


def _placed_spline(spline: Spline, place: Float[np.ndarray, "4 4"]) -> Spline:
    linear, step = place[:3, :3].T, place[:3, 3]
    weights = spline.control[..., 3:]
    moved = spline.control[..., :3] @ linear + step * (weights if weights.size else 1.0)
    spline = replace(spline, control=np.concatenate([moved, weights], axis=2))
    if not _mirrors(place):
        return spline
    control, degrees, knots = spline.control.transpose(1, 0, 2), spline.degrees[::-1], spline.knots[::-1]
    return replace(spline, control=control, degrees=degrees, knots=knots)


def _mirrors(place: np.ndarray) -> bool:
    return bool(np.linalg.det(place[:3, :3]) < 0)


def _face(face: Any, name: str) -> Spline:
    alone = face.DuplicateFace(False)
    if not alone.IsSurface:
        raise InputError(f"{name} is trimmed, which is not supported: untrim it, or make patches of it in Rhino")
    return _surface(face.UnderlyingSurface().ToNurbsSurface(), name)


def _surface(surface: Any, name: str) -> Spline:
    if surface is None:
        raise InputError(f"{name} has no NURBS form")
    points = surface.Points
    found = [[points.GetControlPoint(i, j) for j in range(points.CountV)] for i in range(points.CountU)]
    control = np.array([[(p.X, p.Y, p.Z, p.W) for p in row] for row in found])
    if not surface.IsRational:
        control = control[..., :3] / control[..., 3:]
    knots = tuple(_all_knots(k) for k in (surface.KnotsU, surface.KnotsV))
    return Spline(control, (surface.OrderU - 1, surface.OrderV - 1), knots, name=name)  # type: ignore[arg-type]


def _all_knots(knots: Any) -> np.ndarray:
    """Rhino leaves out the first and the last knot, which no point of the domain depends on."""
    own = [knots[k] for k in range(len(knots))]
    return np.array([own[0], *own, own[-1]])


def _mesh(mesh: Any, name: str) -> Mesh:
    vertices = [(p.X, p.Y, p.Z) for p in (mesh.Vertices.Point3dAt(k) for k in range(len(mesh.Vertices)))]
    faces = [mesh.Faces[k] for k in range(mesh.Faces.Count)]
    faces = [face[:3] if len(face) == 4 and face[2] == face[3] else face for face in faces]
    with naming(name):
        return Mesh.of(np.array(vertices), faces)
