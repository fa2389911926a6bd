"""BezierView's .bv format: polyhedra and Bézier patches in plain text, one after the other.

Each begins with its kind, a number, before which there may be ``Group NUMBER NAME``:

    1  polyhedron: vertices, faces; x y z each; then for each face how many vertices, and their numbers from 0
    3  triangular patch: degree; (d+1)(d+2)/2 points x y z, row by row, d+1 of them first
    4  tensor product: one degree; 5: degrees du dv; (du+1)(dv+1) points x y z, v growing along a row
    8  rational tensor product: degrees du dv; points x y z w, with x, y, z already multiplied by w
    9  triangular patch with normals: degree, degree of the normals; points; normals
   10  tensor product with normals: degrees du dv, and of the normals; points; normals
"""

from __future__ import annotations

from array import array
from collections.abc import Callable
from pathlib import Path

import numpy as np

from slefejax.errors import InputError
from slefejax.geometry.bezier import HIGHEST_DEGREE, from_triangle
from slefejax.io.content import Content, joined
from slefejax.io.numbers import Numbers
from slefejax.model.mesh import Mesh


def read_bv(path: Path) -> Content:
    """Polyhedra as one control mesh, patches as they are; triangular ones as quads with a side of no length, exactly.

    Raises InputError, with the file and the line, for anything that is not such a file.
    """
    numbers = Numbers(path)
    meshes: list[Mesh] = []
    patches: list[np.ndarray] = []
    normals = 0
    while (item := numbers.rest()) is not None:
        if item.lower() == "group":
            item = _after_group(numbers)
        if item == "1":
            meshes.append(_polyhedron(numbers))
        elif item in _PATCHES:
            patches.append(_PATCHES[item](numbers))
            normals += item in ("9", "10")
        else:
            raise numbers.fail(f"{item[:40]!r} is no kind of surface that is read: 1, 3, 4, 5, 8, 9 and 10 are")
    if not meshes and not patches:
        raise InputError(f"{path} holds no surface: at least one is needed")
    notes = (f"the normals of {normals} patches were left out",) if normals else ()
    mesh = joined(meshes) if meshes else None
    return Content(mesh=mesh, patches=tuple(patches), notes=notes, digits=numbers.digits(patches))


def _after_group(numbers: Numbers) -> str:
    """Skip a group's number and, on the same line, its name; the item after that."""
    numbers.next("the number of a group")
    line = numbers.line
    while True:
        item = numbers.next("the kind of a surface")
        if numbers.line != line:
            return item


def _polyhedron(numbers: Numbers) -> Mesh:
    vertices = numbers.whole("the number of vertices", 1, 10**8)
    faces = numbers.whole("the number of faces", 1, 10**8)
    points = numbers.points((vertices, 3), "a coordinate of a vertex")
    corners, sizes = array("q"), array("q")
    for face in range(faces):
        sizes.append(numbers.whole(f"the number of vertices of face {face} (counted from 0)", 0, 10**6))
        corners.extend([numbers.whole("the number of a vertex", 0, vertices - 1) for _ in range(sizes[-1])])
    return Mesh.packed(points, np.array(corners), np.array(sizes))


def _degree(numbers: Numbers, name: str) -> int:
    return numbers.whole(f"the degree {name} of a patch", 1, HIGHEST_DEGREE)


def _triangle(numbers: Numbers, normals: bool = False) -> np.ndarray:
    degree = _degree(numbers, "d")
    other = numbers.whole("the degree of the normals", 0, HIGHEST_DEGREE) if normals else 0
    points = numbers.points(((degree + 1) * (degree + 2) // 2, 3), "a coordinate of a patch")
    if normals:
        numbers.points(((other + 1) * (other + 2) // 2, 3), "a normal of a patch")
    return from_triangle(points, degree)


def _tensor(numbers: Numbers, same: bool = False, dimension: int = 3, normals: bool = False) -> np.ndarray:
    du = _degree(numbers, "u")
    dv = du if same else _degree(numbers, "v")
    others = [numbers.whole("a degree of the normals", 0, HIGHEST_DEGREE) for _ in range(2)] if normals else []
    start = numbers.line
    points = numbers.points((du + 1, dv + 1, dimension), "a coordinate of a patch")
    if dimension == 4 and not np.all(points[..., 3] > 0):
        raise numbers.fail(f"a weight of the patch that begins after line {start} is not positive")
    if normals:
        numbers.points((others[0] + 1, others[1] + 1, 3), "a normal of a patch")
    return points


_PATCHES: dict[str, Callable[[Numbers], np.ndarray]] = {
    "3": _triangle,
    "4": lambda numbers: _tensor(numbers, same=True),
    "5": _tensor,
    "8": lambda numbers: _tensor(numbers, dimension=4),
    "9": lambda numbers: _triangle(numbers, normals=True),
    "10": lambda numbers: _tensor(numbers, normals=True),
}
