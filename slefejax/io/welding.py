"""Vertices that a file splits where its normals or texture coordinates differ, made one again where that is sound.

Two surfaces that touch in a vertex or along an edge have equal vertices there, too. To make those one would spoil both:
an edge would have four faces, a vertex several fans. So vertices become one as far as faces hang together around them:

- Faces are neighbours across an edge that just two of them have, in opposite directions, unless they have all vertices
  in common, as the two sides of a leaf do.
- Of several faces at an edge, those two are neighbours, in opposite directions, that have the file's own vertices in
  common there; or else those that hang together by other edges; or that are of the same copy, if faces are there
  several times; or else those that have the inside of a solid between them.
- Corners that are one vertex in the file stay one: defects of the file's own are left for others to find.
"""

from __future__ import annotations

import numpy as np

from slefejax.model.defects import find_defects
from slefejax.model.mesh import Mesh, connected

_EQUAL = 1e-6  # radians between faces that lie on each other


def welded_soundly(mesh: Mesh, own: np.ndarray) -> tuple[np.ndarray, np.ndarray, int]:
    """How to divide a mesh again whose equal vertices were made one, where that is not sound.

    mesh : triangles, equal vertices made one
    own  : ``(corners,)``, the vertex of each corner in the file

    Returns the vertex of the mesh that each of the new ones is, the new vertices of all corners, and how many vertices
    of the mesh were divided.
    """
    if not find_defects(mesh):
        return np.arange(mesh.vertex_count), mesh.corners, 0
    one, other = _neighbours(mesh, own)
    # of two half-edges that meet, each begins where the other one ends
    follow = mesh.next_corner
    pairs = [(one, follow[other]), (other, follow[one]), _chained(own)]
    corners = connected(len(mesh.corners), *(np.concatenate(part) for part in zip(*pairs, strict=True)))[1]
    first = np.unique(corners, return_index=True)[1]
    # numbered as before: by vertex, then by the corner that comes first
    order = np.lexsort((first, mesh.corners[first]))
    number = np.empty(len(order), np.int64)
    number[order] = np.arange(len(order))
    vertex = mesh.corners[first[order]]
    apart = int(np.sum(np.bincount(vertex, minlength=mesh.vertex_count) > 1))
    return vertex, number[corners], apart


def _neighbours(mesh: Mesh, own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of half-edges across which faces hang together."""
    alike = np.unique(np.sort(mesh.corners.reshape(-1, 3), axis=1), axis=0, return_inverse=True)[1].ravel()
    order = np.argsort(alike, kind="stable")
    copy = np.empty_like(alike)
    copy[order] = np.arange(len(alike)) - np.searchsorted(alike[order], alike[order])
    ends = own[mesh.next_corner]
    left = np.arange(len(mesh.corners))
    one = other = left[:0]

    def take(a: np.ndarray, b: np.ndarray) -> None:
        """Those of the pairs that can be neighbours."""
        nonlocal left, one, other
        fine = (mesh.corners[a] == mesh.ends[b]) & (alike[mesh.face[a]] != alike[mesh.face[b]])
        one, other = np.concatenate([one, a[fine]]), np.concatenate([other, b[fine]])
        left = np.setdiff1d(left, np.concatenate([one, other]))

    take(*_twos(left, mesh.edge))
    take(*_twos(left, mesh.edge, np.minimum(own, ends), np.maximum(own, ends)))
    take(*_twos(left, mesh.edge, connected(mesh.face_count, mesh.face[one], mesh.face[other])[1][mesh.face]))
    take(*_twos(left, mesh.edge, copy[mesh.face]))
    take(*_around(mesh, left))
    return one, other


def _twos(corners: np.ndarray, *keys: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of these half-edges those of which just two have equal keys."""
    group = np.unique(np.stack(keys, axis=1)[corners], axis=0, return_inverse=True)[1].ravel()
    order, count = np.argsort(group, kind="stable"), np.bincount(group)
    first = (np.cumsum(count) - count)[count == 2]
    return corners[order[first]], corners[order[first + 1]]


def _around(mesh: Mesh, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of these half-edges those that follow each other around their edge and have the inside of a solid between them.

    Only of edges around which every second face looks the other way, as where solids touch; where two of them lie on
    each other the insides are not between them.
    """
    edge = mesh.edge[corners]
    start, end = (mesh.vertices[mesh.edge_vertices[edge, k]] for k in (0, 1))
    axis = end - start
    beside = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis), axis=1)])
    inwards = mesh.vertices[mesh.ends[mesh.next_corner[corners]]] - start
    height = np.linalg.norm(axis, axis=1)
    angle = np.arctan2(np.sum(inwards * np.cross(axis, beside), axis=1), np.sum(inwards * beside, axis=1) * height)
    along = mesh.corners[corners] == mesh.edge_vertices[edge, 0]
    order = np.argsort(edge, kind="stable")
    edge, along, angle, corners = edge[order], along[order], angle[order], corners[order]
    first = np.searchsorted(edge, edge)
    count = np.searchsorted(edge, edge, side="right") - first
    angle = np.round(np.mod(angle - angle[first] + 0.5 * _EQUAL, 2 * np.pi) / _EQUAL - 0.5)
    order = np.lexsort((~along, angle, edge))
    along, corners = along[order], corners[order]
    place = np.arange(len(edge)) - first
    after = first + (place + 1) % np.maximum(count, 1)
    mixed = np.isin(edge, edge[along == along[after]])
    # the inside of a face that runs along the axis lies before it, of one that runs against it behind it
    found = np.flatnonzero(~mixed & ~along)
    return corners[found], corners[after[found]]


def _chained(own: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners that are one vertex in the file, each with the next one."""
    order = np.argsort(own, kind="stable")
    same = own[order[1:]] == own[order[:-1]]
    return order[:-1][same], order[1:][same]
