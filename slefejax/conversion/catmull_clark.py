"""One step of Catmull-Clark subdivision, with boundaries, corners and semi-sharp creases.

New vertices are numbered: the old ones first, then one an edge, then one a face. Every corner of an old face becomes
a quad, in the order of the corners:

        prev edge ------ face          corner c of face f, at V: (V, edge of c, f, edge of the corner before)
            |             |
            V --------- edge

An edge of sharpness s is sharp for s steps; the step in which it becomes smooth is a blend of both rules
[DKT98]. A vertex is smooth with fewer than two sharp edges, on a crease with two, and stays where it is
with more, or if it belongs to one face only. Boundaries are infinitely sharp.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax.model.mesh import Mesh
from slefejax.model.stencils import StencilTable
from slefejax.model.texture import refined_texture


def refine(mesh: Mesh) -> tuple[Mesh, StencilTable, Int[np.ndarray, "children"]]:
    """The mesh after one step, the table that makes its vertices, and the old face of every new one.

    Texture coordinates are refined by the linear rules (``slefejax.model.texture``).

    >>> square = Mesh.of([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [(0, 1, 2, 3)])
    >>> finer, table, parents = refine(square)
    >>> finer.face_count, table.rows, finer.vertices[-1].tolist()
    (4, 9, [0.5, 0.5, 0.0])
    """
    faces = face_points(mesh)
    table = vertex_points(mesh).stacked(edge_points(mesh, faces), faces)
    edge = mesh.vertex_count + mesh.edge
    middle = mesh.vertex_count + mesh.edge_count + mesh.face
    corners = np.stack([mesh.corners, edge, middle, edge[mesh.prev_corner]], axis=1).ravel()
    sizes = np.full(len(mesh.corners), 4)
    more = _sharper(mesh)
    finer = Mesh.packed(table.on_host(mesh.vertices), corners, sizes, texture=refined_texture(mesh), **more)
    return finer, table, mesh.face


def _sharper(mesh: Mesh) -> dict[str, np.ndarray]:
    """Creases and sharp vertices after the step: both halves of an edge, one less sharp."""
    sharpness = np.where(mesh.boundary, 0.0, mesh.edge_sharpness - 1.0)
    edges = np.flatnonzero(sharpness > 0)
    halves = np.concatenate([np.stack([v, mesh.vertex_count + edges], axis=1) for v in mesh.edge_vertices[edges].T])
    points = np.flatnonzero(mesh.vertex_sharpness > 1)
    return {
        "creases": halves,
        "crease_sharpness": np.tile(sharpness[edges], 2),
        "points": points,
        "point_sharpness": mesh.vertex_sharpness[points] - 1.0,
    }


def face_points(mesh: Mesh) -> StencilTable:
    """The mean of the vertices of every face."""
    weights = 1.0 / mesh.sizes[mesh.face]
    return StencilTable.of(mesh.face, mesh.corners, weights, (mesh.face_count, mesh.vertex_count))


def edge_points(mesh: Mesh, faces: StencilTable) -> StencilTable:
    """Smooth: the mean of both ends and both face points. Sharp: the middle. In between: a blend."""
    sharp = np.clip(mesh.edge_sharpness, 0.0, 1.0)
    ends = _pairs(mesh.edge_vertices, mesh.vertex_count)
    around = StencilTable.of(mesh.edge, mesh.face, np.ones(len(mesh.face)), (mesh.edge_count, mesh.face_count)) @ faces
    return ends.scaled(0.25 + 0.25 * sharp) + around.scaled(0.25 * (1.0 - sharp))


def vertex_points(mesh: Mesh) -> StencilTable:
    """Old vertices moved by the rule for their sharp edges, or by a blend of two where that rule is about to change."""
    before, after = mesh.edge_sharpness, np.maximum(mesh.edge_sharpness - 1.0, 0.0)
    own, own_after = mesh.vertex_sharpness, np.maximum(mesh.vertex_sharpness - 1.0, 0.0)
    now, then = rules(mesh, before, own), rules(mesh, after, own_after)
    fading = (before > 0) & (after <= 0)
    total = _at_ends(mesh, np.where(fading, before, 0.0)) + np.where((own > 0) & (own_after <= 0), own, 0.0)
    count = _at_ends(mesh, fading.astype(float)) + ((own > 0) & (own_after <= 0))
    share = np.where(now == then, 1.0, np.minimum(1.0, total / np.maximum(count, 1.0)))
    first = _by_rule(mesh, now, before > 0).scaled(share)
    return first + _by_rule(mesh, then, after > 0).scaled(1.0 - share)


SMOOTH, CREASE, CORNER = 0, 1, 2


def rules(
    mesh: Mesh, edge_sharpness: Float[np.ndarray, "edges"], vertex_sharpness: Float[np.ndarray, "vertices"]
) -> Int[np.ndarray, "vertices"]:
    """SMOOTH, CREASE or CORNER for every vertex. One that is not used is a corner: it stays where it is."""
    sharp = _at_ends(mesh, (edge_sharpness > 0).astype(float))
    one_face = (np.bincount(mesh.corners, minlength=mesh.vertex_count) == 1) & (_at_ends(mesh, mesh.boundary * 1.0) > 0)
    corner = (sharp > 2) | (vertex_sharpness > 0) | one_face | (mesh.valence == 0)
    return np.where(corner, CORNER, np.where(sharp == 2, CREASE, SMOOTH))


def _by_rule(mesh: Mesh, rule: np.ndarray, sharp: Bool[np.ndarray, "edges"]) -> StencilTable:
    smooth, crease = (rule == SMOOTH) * 1.0, (rule == CREASE) * 1.0
    identity = StencilTable.identity(mesh.vertex_count)
    table = identity.scaled((rule == CORNER) * 1.0) + _smooth(mesh).scaled(smooth)
    return table + (identity.scaled(6.0) + neighbours(mesh, sharp)).scaled(crease / 8.0)


def _smooth(mesh: Mesh) -> StencilTable:
    """(n - 2)/n V + the sum of the neighbours / n^2 + the sum of the face points / n^2."""
    n = np.maximum(mesh.valence, 1).astype(float)
    count = mesh.vertex_count
    at_faces = StencilTable.of(mesh.corners, mesh.face, np.ones(len(mesh.face)), (count, mesh.face_count))
    around = neighbours(mesh, np.ones(mesh.edge_count, bool)) + at_faces @ face_points(mesh)
    return StencilTable.identity(count).scaled((n - 2.0) / n) + around.scaled(1.0 / n**2)


def neighbours(mesh: Mesh, along: Bool[np.ndarray, "edges"]) -> StencilTable:
    """For every vertex the sum of the vertices that some of its edges lead to."""
    a, b = mesh.edge_vertices[along].T
    shape = (mesh.vertex_count, mesh.vertex_count)
    return StencilTable.of(np.append(a, b), np.append(b, a), np.ones(2 * len(a)), shape)


def _pairs(pairs: np.ndarray, columns: int) -> StencilTable:
    rows = np.repeat(np.arange(len(pairs)), 2)
    return StencilTable.of(rows, pairs.ravel(), np.ones(2 * len(pairs)), (len(pairs), columns))


def _at_ends(mesh: Mesh, per_edge: np.ndarray) -> np.ndarray:
    """For every vertex the sum of a number over its edges."""
    finite = np.where(np.isfinite(per_edge), per_edge, 0.0)
    return np.bincount(mesh.edge_vertices.ravel(), np.repeat(finite, 2), minlength=mesh.vertex_count)
