"""Nets of Gregory patches: Bézier points with the mean of both face points at every corner, and their differences.

Where all faces are quads nets are bicubic, four differences each. With triangles among them all are of bi-degree 4,
triangles pinched at u = 1, six differences each: those of quads, and those of triangles (``geometry.gregory``).
"""

from __future__ import annotations

from functools import cache
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from slefejax.conversion.acc import Neighbourhood, kinds, out_and_back, pinched_last, quad_net
from slefejax.conversion.gregory import ROUNDING, Points
from slefejax.conversion.patchwork import Patchwork
from slefejax.geometry.bezier import bernstein, elevate
from slefejax.geometry.gregory import QUAD_TWISTS, TRIANGLE_TWISTS
from slefejax.model.mesh import Mesh
from slefejax.model.stencils import StencilTable

_INSIDE = 9  # of 5 x 5 points


def gregory_patches(mesh: Mesh) -> Patchwork:
    """Gregory patches of a manifold mesh of quads and triangles, one a face, in their order.

    >>> square = Mesh.of([[0, 0, 0], [3, 0, 0], [3, 3, 0], [0, 3, 0]], [(0, 1, 2, 3)])
    >>> gregory_patches(square).on_host(square.vertices).net[0, 1, 1].tolist()
    [1.0, 1.0, 0.0]
    """
    around = Neighbourhood.of(mesh)
    points = Points(around)
    own = (_cubic if mesh.sizes.min() == 4 else _quartic)(mesh, points)
    there = np.flatnonzero(points.twists.counts)
    none = StencilTable.of([], [], [], (1, mesh.vertex_count))
    first, *others = own.points
    rows = sum(table.rows for table in own.points)
    place = np.full(len(mesh.corners) + 1, rows)
    place[points.odd[there]] = rows + 1 + np.arange(len(there))
    table = first.stacked(*others, none, points.twists.take(there))
    return Patchwork(table, own.net, np.arange(mesh.face_count), kinds(around), twists=place[own.corners])


class _Nets(NamedTuple):
    """Points, which of them every face has, and of which corner the differences are: past the last one, of none."""

    points: tuple[StencilTable, ...]  # one table after the other
    net: Int[np.ndarray, "faces n n"]
    corners: Int[np.ndarray, "faces slots"]


def _cubic(mesh: Mesh, points: Points) -> _Nets:
    corner = np.arange(len(mesh.corners))
    first = mesh.vertex_count + 2 * mesh.edge_count
    out, back = (mesh.vertex_count + rows for rows in out_and_back(mesh))
    by_face = corner.reshape(-1, 4)
    tables = points.vertices, points.edges, points.inside
    return _Nets(tables, quad_net(mesh.corners, out, back, first + corner, by_face.T), by_face)


def _quartic(mesh: Mesh, own: Points) -> _Nets:
    """Sides are raised once an edge, so that neighbours have the same points."""
    pool = own.vertices.stacked(own.edges, *own.faces)
    first = mesh.vertex_count
    lower, upper = mesh.edge_vertices.min(axis=1), mesh.edge_vertices.max(axis=1)
    near, far = first + 2 * np.arange(mesh.edge_count), first + 2 * np.arange(mesh.edge_count) + 1
    cubic = np.stack([lower, near, far, upper], axis=1)
    sides = _combined(elevate(np.eye(4), 4)[1:-1], cubic, pool)
    quads, triangles = np.flatnonzero(mesh.sizes == 4), np.flatnonzero(mesh.sizes == 3)
    quad_corners = mesh.offsets[:-1][quads][:, None] + np.arange(4)
    turned = pinched_last(mesh, triangles).T
    of_quads = _combined(_of_quad(), _numbers(mesh, quad_corners), pool)
    of_triangles = _combined(_of_triangle()[1:-1, 1:-1].reshape(_INSIDE, -1), _numbers(mesh, turned), pool)
    net = np.empty((mesh.face_count, 5, 5), np.int64)
    at = first + sides.rows + np.arange(mesh.face_count * _INSIDE).reshape(-1, 3, 3)
    net[np.concatenate([quads, triangles]), 1:-1, 1:-1] = at
    _put_sides(mesh, net, quads, quad_corners, turned, triangles)
    corners = np.full((mesh.face_count, QUAD_TWISTS + TRIANGLE_TWISTS), len(mesh.corners))
    corners[quads, :QUAD_TWISTS] = quad_corners
    corners[triangles, QUAD_TWISTS:] = turned[:, [1, 0]]
    return _Nets((own.vertices, sides, of_quads, of_triangles), net, corners)


def _put_sides(mesh: Mesh, net: Any, quads: Any, quad_corners: Any, turned: Any, triangles: Any) -> None:
    """The outermost points: vertices, and three for every edge along the half-edge of a corner."""
    forwards = (mesh.corners < mesh.ends)[:, None]
    edge = mesh.vertex_count + 3 * mesh.edge[:, None]
    along = np.where(forwards, edge + np.arange(3), edge + 2 - np.arange(3))
    against = along[:, ::-1]
    a, b, d, e = quad_corners.T
    for place, corner in zip(((0, 0), (-1, 0), (-1, -1), (0, -1)), (a, b, d, e), strict=True):
        net[quads, place[0], place[1]] = mesh.corners[corner]
    net[quads, 0, 1:-1], net[quads, -1, 1:-1] = against[e], along[b]
    net[quads, 1:-1, 0], net[quads, 1:-1, -1] = along[a], against[d]
    p, q, top = turned.T
    net[triangles, 0, 0], net[triangles, 0, -1] = mesh.corners[q], mesh.corners[p]
    net[triangles, -1] = mesh.corners[top][:, None]
    net[triangles, 0, 1:-1] = against[p]
    net[triangles, 1:-1, 0], net[triangles, 1:-1, -1] = along[q], against[top]


def _numbers(mesh: Mesh, corners: Int[np.ndarray, "faces n"]) -> Int[np.ndarray, "faces points"]:
    """Numbers in the pool of p, e+, e-, f+, f- of these corners of every face, one kind after the other."""
    out, back = (mesh.vertex_count + rows for rows in out_and_back(mesh))
    face_points = mesh.vertex_count + 2 * mesh.edge_count
    kind = [
        mesh.corners[corners],
        out[corners],
        back[mesh.prev_corner[corners]],
        face_points + corners,
        face_points + len(mesh.corners) + corners,
    ]
    return np.concatenate(kind, axis=1)


def _combined(
    weights: Float[np.ndarray, "rows points"], numbers: Int[np.ndarray, "items points"], pool: StencilTable
) -> StencilTable:
    """Rows of every item: sums of its points in the pool."""
    rows, count = len(weights), len(numbers)
    return pool.combined(np.repeat(numbers, rows, axis=0), np.tile(weights, (count, 1))).pruned(ROUNDING)


@cache
def _of_quad() -> Float[np.ndarray, "9 20"]:
    """The inner points of a quad's net of bi-degree 4, of its 20 points."""
    corner = np.arange(4)
    p, out, back = np.eye(20)[corner], np.eye(20)[4 + corner], np.eye(20)[8 + corner]
    inside = 0.5 * (np.eye(20)[12 + corner] + np.eye(20)[16 + corner])
    pool = np.concatenate([p, out, back, inside])
    # as quad_net has them: its half-edges' far points are the next corner's e-
    numbers = quad_net(corner, 4 + corner, 8 + (corner + 1) % 4, 12 + corner, corner[:, None])[0]
    raised = elevate(np.swapaxes(elevate(pool[numbers], 4), 0, 1), 4)
    return np.swapaxes(raised, 0, 1)[1:-1, 1:-1].reshape(_INSIDE, -1)


@cache
def _of_triangle() -> Float[np.ndarray, "5 5 15"]:
    """The net of a triangle of its 15 points, the quotients at p and q left out ([LSNC09], section 3.3).

    With a = (1-u)(1-v) at q, b = (1-u) v at p, c = u at the third corner its points have the weights

        a^3 p_q + 3 a b (a + b) (a e_qp + b e_pq) + 12 a b c (a F_q + b F_p + c F_c) + ...,   F_q, F_p: means

    and F_c = v f+ + (1 - v) f-: with a = (1-u)(1-v), b = (1-u) v the quotient there is a polynomial.
    """
    u, v = np.meshgrid(np.arange(5) / 4.0, np.arange(5) / 4.0, indexing="ij")
    a, b, c = (1 - u) * (1 - v), (1 - u) * v, u
    share = [b, a, c]  # of the corners p, q, top
    weights = np.zeros((15, 5, 5))
    for k in range(3):
        x, y, z = share[k], share[(k + 1) % 3], share[(k + 2) % 3]  # the corner, the next one, the one before
        weights[k] = x**3
        weights[3 + k], weights[6 + k] = 3 * x * y * (x + y) * x, 3 * x * z * (x + z) * x
        plus = v if k == 2 else 0.5
        weights[9 + k], weights[12 + k] = 12 * x * x * y * z * plus, 12 * x * x * y * z * (1 - plus)
    values = np.stack(bernstein(4, np.arange(5) / 4.0), axis=1)
    inverse = np.linalg.inv(values)
    net = np.einsum("iu,jv,kuv->ijk", inverse, inverse, weights)
    return np.round(net * 288.0) / 288.0  # all of them are such fractions
