"""Rhino's .3dm, through rhino3dm: NURBS surfaces, untrimmed faces of polysurfaces, extrusions, meshes.

The package is an extra: ``pip install 'slefejax[rhino]'``.
"""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from slefejax.errors import InputError
from slefejax.io.content import Content, Spline, joined, probe, read_bytes
from slefejax.late import one_at_a_time
from slefejax.mesh import Mesh


def read_3dm(path: Path) -> Content:
    """The surfaces of a file and, as one control mesh, its meshes.

    Raises InputError if the file is none, for trimmed faces, and if it holds nothing of the kind.
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
    meshes: list[Mesh] = []
    splines: list[Spline] = []
    others: Counter[str] = Counter()
    for number, item in enumerate(model.Objects):
        shape: Any = item.Geometry
        name = f"{path}: object {number} (counted from 0)"
        if isinstance(shape, rhino3dm.Extrusion):
            shape = shape.ToBrep(True)
        if isinstance(shape, rhino3dm.Mesh) and shape.Faces.Count == 0:
            others["empty Mesh"] += 1
        elif isinstance(shape, rhino3dm.Mesh):
            meshes.append(_mesh(shape, name))
        elif isinstance(shape, rhino3dm.Brep):
            faces: Any = shape.Faces
            splines += [_face(faces[k], f"{name}, face {k}") for k in range(len(faces))]
        elif isinstance(shape, rhino3dm.Surface):
            splines.append(_surface(shape.ToNurbsSurface(), name))
        else:
            others[type(shape).__name__] += 1
    said = ", ".join(f"{count} {name}" for name, count in sorted(others.items()))
    if not meshes and not splines:
        raise InputError(f"{path} holds no surface and no mesh" + (f", only {said}" if said else ""))
    notes = (f"objects of other kinds were left out: {said}",) if said else ()
    return Content(joined(meshes) if meshes else None, tuple(splines), notes=notes)


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
    try:
        return Mesh.of(np.array(vertices), faces)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
