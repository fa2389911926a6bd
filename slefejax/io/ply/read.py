"""PLY: control meshes of any polygons and of strips of triangles, as text or binary of either byte order."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jaxtyping import Int

from slefejax.errors import InputError, naming
from slefejax.io.content import Content, read_bytes
from slefejax.io.limits import LARGEST_TEXT
from slefejax.io.ply.file import Column, read_elements
from slefejax.model.gaussians import with_gaussians
from slefejax.model.mesh import Mesh

_NAMES = ("vertex_indices", "vertex_index")
_COVARIANCE = ("cov_xx", "cov_xy", "cov_xz", "cov_yy", "cov_yz", "cov_zz")
_PLACES = [0, 1, 2, 1, 3, 4, 2, 4, 5]  # of the entries of a symmetric matrix among these


def read_ply(path: Path) -> Content:
    """The control mesh of a file: ``x y z`` of its vertices, ``vertex_indices`` of its faces and triangle strips.

    Vertices that have ``cov_xx cov_xy cov_xz cov_yy cov_yz cov_zz`` make it a covariance mesh.

    In a strip each vertex makes a triangle with the two before it, whose orientation alternates; -1 begins another one.
    Triangles of strips are numbered behind the faces.

    Raises InputError, with the file and what is wrong where, for what is no such file.
    """
    found, notes = read_elements(path, read_bytes(path, LARGEST_TEXT))
    if "vertex" not in found or not ("face" in found or "tristrips" in found):
        name = "face" if "vertex" in found else "vertex"
        raise InputError(f"{path} has no element '{name}': a control mesh needs vertices and faces")
    missing = [axis for axis in "xyz" if axis not in found["vertex"] or found["vertex"][axis].sizes is not None]
    if missing:
        raise InputError(f"{path} has no number '{missing[0]}' of its vertices")
    points = np.stack([found["vertex"][axis].values for axis in "xyz"], axis=1)
    corners, sizes = [], []
    if "face" in found:
        numbers, lengths = _vertices(path, "face", found["face"])
        corners, sizes = [numbers], [lengths]
    if "tristrips" in found:
        triangles, more = _triangles(*_vertices(path, "tristrips", found["tristrips"]))
        corners, sizes, notes = [*corners, triangles.ravel()], [*sizes, np.full(len(triangles), 3)], notes + more
    with naming(path):
        mesh = Mesh.packed(points, np.concatenate(corners), np.concatenate(sizes))
        return Content(mesh=_with_covariances(mesh, found["vertex"]), notes=notes)


def _with_covariances(mesh: Mesh, columns: dict[str, Column]) -> Mesh:
    """The mesh with the covariances of its vertices, if there are any."""
    there = [name in columns and columns[name].sizes is None for name in _COVARIANCE]
    if not any(there):
        return mesh
    if not all(there):
        raise InputError(
            f"a covariance needs all of {' '.join(_COVARIANCE)}, and vertices have no {_COVARIANCE[there.index(False)]}"
        )
    entries = np.stack([columns[name].values for name in _COVARIANCE], axis=1)
    return with_gaussians(mesh, entries[:, _PLACES].reshape(-1, 3, 3))


def _vertices(path: Path, element: str, columns: dict[str, Column]) -> tuple[np.ndarray, np.ndarray]:
    """The vertex numbers of all rows of an element, and how many each of them has."""
    named = [columns[name] for name in _NAMES if name in columns and columns[name].sizes is not None]
    if not named:
        raise InputError(f"{path} has no list 'vertex_indices' of its elements '{element}'")
    values, sizes = named[0].values, named[0].sizes
    assert sizes is not None
    bad = np.flatnonzero(~((np.abs(values) < 2.0**53) & (values == np.floor(values))))
    if bad.size:
        row = int(np.searchsorted(np.cumsum(sizes), bad[0], side="right"))
        what = f"{element} {row} (counted from 0) names vertex {values[bad[0]]:g}, which is no whole number"
        raise InputError(f"{path}: {what}")
    return values.astype(np.int64), sizes


def _triangles(
    numbers: Int[np.ndarray, "numbers"], sizes: Int[np.ndarray, "rows"]
) -> tuple[Int[np.ndarray, "triangles 3"], tuple[str, ...]]:
    """The triangles of strips, and a note on those that only join parts of a strip."""
    kept = numbers != -1
    strip = np.repeat(np.arange(len(sizes)), sizes) + np.cumsum(~kept)  # grows at the end of a row, and at -1
    numbers, strip = numbers[kept], strip[kept]
    first = np.searchsorted(strip, strip)
    last = np.flatnonzero(np.arange(len(strip)) - first >= 2)
    odd = (last - first[last]) % 2 == 1
    a, b, c = numbers[last - 2], numbers[last - 1], numbers[last]
    triangles = np.stack([np.where(odd, b, a), np.where(odd, a, b), c], axis=1)
    flat = (a == b) | (b == c) | (a == c)
    notes = (f"{flat.sum()} triangles that only join parts of a strip were left out",) if flat.any() else ()
    return triangles[~flat], notes
