"""What keeps polygons from being a control mesh: found, told by element number, dropped if that is asked for."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Int

from slefejax.errors import InputError
from slefejax.model.mesh import Mesh


@dataclass(frozen=True)
class Defect:
    """One kind of defect.

    what   : a sentence on the first one, by number, and how many there are
    count  : how many
    faces  : ``(faces,)``, the faces to drop so that it is gone (others may then appear)
    """

    what: str
    count: int
    faces: Bool[np.ndarray, "faces"]


def find_defects(mesh: Mesh) -> list[Defect]:
    """All kinds of defects that no surface can be made of; an empty list if there are none.

    Faces of fewer than three vertices, faces that name a vertex twice, faces with the same vertices, edges of more than
    two faces, neighbours that run along their edge in the same direction, vertices where fans of faces only touch.
    Faces have the numbers of their file, everything is counted from 0.
    """
    if (small := _small(mesh)) is not None:
        return [small]
    found = [_degenerate(mesh), _duplicates(mesh)]
    found = [defect for defect in found if defect is not None]
    if found:  # they spoil the edges, too
        return found
    found = [_crowded_edges(mesh), _opposed_edges(mesh)]
    found = [defect for defect in found if defect is not None]
    if found:
        return found
    touching = _touching_fans(mesh)
    return [] if touching is None else [touching]


def check_manifold(mesh: Mesh) -> None:
    """Raise InputError, one sentence with the numbers, if there are defects."""
    defects = find_defects(mesh)
    if defects:
        said = "; ".join(defect.what for defect in defects)
        raise InputError(
            f"{said} (counted from 0): repair the mesh, or leave such faces out (drop_defects)",
            options=("drop_defects",),
        )


def without_defects(mesh: Mesh) -> tuple[Mesh, tuple[str, ...]]:
    """The mesh without the faces that make it defective, and a sentence on each kind that was dropped.

    Raises InputError if nothing is left.
    """
    notes, creases = [], len(mesh.creases)
    while defects := find_defects(mesh):
        drop = np.any([defect.faces for defect in defects], axis=0)
        if drop.all():
            raise InputError(f"{defects[0].what} (counted from 0): without such faces nothing is left of the mesh")
        numbers = mesh.numbers[drop]
        said = "; ".join(defect.what for defect in defects)
        notes.append(f"{said}: {len(numbers)} faces were dropped ({_some(numbers)})")
        mesh = mesh.keep(~drop)
    if len(mesh.creases) < creases:
        notes.append(f"{creases - len(mesh.creases)} creases are no edges any more and were left out")
    return mesh, tuple(notes)


def isolated_vertices(mesh: Mesh) -> Int[np.ndarray, "isolated"]:
    """Vertices of no face."""
    return np.flatnonzero(mesh.valence == 0)


def _some(numbers: np.ndarray, most: int = 4) -> str:
    said = ", ".join(str(n) for n in numbers[:most].tolist())
    return said + (", …" if len(numbers) > most else "")


def _small(mesh: Mesh) -> Defect | None:
    faces = mesh.sizes < 3
    if not faces.any():
        return None
    first = np.flatnonzero(faces)[0]
    what = f"face {mesh.numbers[first]} has {mesh.sizes[first]} vertices, and needs three"
    return Defect(what + _more(int(faces.sum())), int(faces.sum()), faces)


def _degenerate(mesh: Mesh) -> Defect | None:
    order = np.lexsort((mesh.corners, mesh.face))
    twice = (np.diff(mesh.corners[order]) == 0) & (np.diff(mesh.face[order]) == 0)
    places = order[1:][twice]
    faces = np.zeros(mesh.face_count, bool)
    faces[mesh.face[places]] = True
    if not faces.any():
        return None
    first = places[np.argmin(mesh.face[places])]
    what = f"face {mesh.numbers[mesh.face[first]]} names vertex {mesh.corners[first]} twice"
    return Defect(what + _more(int(faces.sum())), int(faces.sum()), faces)


def _duplicates(mesh: Mesh) -> Defect | None:
    earlier = np.arange(mesh.face_count)
    for size in np.unique(mesh.sizes):  # one table a size: a few large faces do not make all rows as wide
        own = np.flatnonzero(mesh.sizes == size)
        rows = np.sort(mesh.corners[mesh.offsets[own][:, None] + np.arange(size)], axis=1)
        _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
        earlier[own] = own[first[inverse.ravel()]]
    faces = earlier != np.arange(mesh.face_count)
    if not faces.any():
        return None
    worst = int(np.flatnonzero(faces)[0])
    what = f"faces {mesh.numbers[earlier[worst]]} and {mesh.numbers[worst]} have the same vertices"
    return Defect(what + _more(int(faces.sum())), int(faces.sum()), faces)


def _crowded_edges(mesh: Mesh) -> Defect | None:
    crowded = np.flatnonzero(mesh.edge_faces > 2)
    if not crowded.size:
        return None
    rank = _rank_within(mesh.edge)
    faces = np.zeros(mesh.face_count, bool)
    faces[mesh.face[np.isin(mesh.edge, crowded) & (rank >= 2)]] = True
    a, b = mesh.edge_vertices[crowded[0]].tolist()
    around = mesh.numbers[mesh.face[mesh.edge == crowded[0]]]
    what = f"the edge of vertices {a} and {b} belongs to {len(around)} faces ({_some(around)})"
    return Defect(what + _more(len(crowded)), len(crowded), faces)


def _rank_within(group: np.ndarray) -> np.ndarray:
    """How many earlier entries have the same value."""
    order = np.argsort(group, kind="stable")
    ordered = group[order]
    starts = np.searchsorted(ordered, ordered)
    rank = np.empty(len(group), np.int64)
    rank[order] = np.arange(len(group)) - starts
    return rank


def _opposed_edges(mesh: Mesh) -> Defect | None:
    opposed = (mesh.edge_faces[mesh.edge] == 2) & (mesh.twin < 0)
    if not opposed.any():
        return None
    edges = np.unique(mesh.edge[opposed])
    faces = np.zeros(mesh.face_count, bool)
    faces[mesh.face[opposed & (_rank_within(mesh.edge) == 1)]] = True
    first = mesh.numbers[mesh.face[mesh.edge == edges[0]]].tolist()
    a, b = mesh.edge_vertices[edges[0]].tolist()
    what = f"faces {first[0]} and {first[1]} run along their common edge of vertices {a} and {b} in the same direction"
    return Defect(what + _more(len(edges)), len(edges), faces)


def _touching_fans(mesh: Mesh) -> Defect | None:
    fans = mesh.fans()
    several = np.flatnonzero(np.bincount(fans.vertex, minlength=mesh.vertex_count) > 1)
    if not several.size:
        return None
    own = np.flatnonzero(np.isin(fans.vertex, several))
    # of every such vertex the largest fan stays, the first of several
    order = own[np.lexsort((own, -fans.size[own], fans.vertex[own]))]
    first = np.append(True, np.diff(fans.vertex[order]) != 0)
    dropped = np.zeros(len(fans.size), bool)
    dropped[order[~first]] = True
    faces = np.zeros(mesh.face_count, bool)
    faces[mesh.face[dropped[fans.fan]]] = True
    count = int(np.count_nonzero(fans.vertex == several[0]))
    what = f"at vertex {several[0]} {count} fans of faces only touch, which is not manifold"
    return Defect(what + _more(len(several)), len(several), faces)


def _more(count: int) -> str:
    return f", and {count - 1} more like it" if count > 1 else ""
