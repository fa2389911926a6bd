"""Approximate Catmull-Clark: one bicubic patch a face, and pinched quads for triangles (docs/math.md, 7).

Everything is put together from one mask a face corner. At vertex V of valence n, in a face of which W and X are the
neighbours of V and D (in a quad) is opposite:

    quad:      n V + 2 W + 2 X + D        triangle:  n V + a W + a X        with a = alpha, 2.5 in [Yeo12]

- the interior point next to V is the mask of its face;
- the edge point at V towards W is the sum of the masks of the two faces of that edge;
- the corner point is the sum of the masks of all faces around V;

each divided by the sum of its weights ([LS08]; [Yeo12], figures 6-3, 6-6). Along a boundary or a crease that is sharp,
edge points are (2 V + W)/3, and corner points (X + 4 V + W)/6 or, where V is a corner, V itself. Faces on one side of
a crease do not see those on the other; n is twice their number there, at a corner four times.

            v = 1
      d  dc  cd  c        a triangle p, q, c pinched at c:      u = 0    q   qp  pq  p     v grows to the right
      da  D   C  cb                                                      qc   Q   P  pc
      ad  A   B  bc                                                      cq   C   C  cp
      a  ab  ba  b   u = 1                                      u = 1    c    c   c   c
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from slefejax.conversion.catmull_clark import CORNER, CREASE, SMOOTH, neighbours, rules
from slefejax.conversion.patchwork import KINDS, Patchwork
from slefejax.model.mesh import Fans, Mesh
from slefejax.model.stencils import StencilTable

ALPHA = 2.5


@dataclass(frozen=True, eq=False)
class Neighbourhood:
    """What the masks look at. An edge of sharpness 1 and more is taken for infinitely sharp, any other for smooth.

    sharp : ``(edges,)``;  rule : ``(vertices,)``, as in ``catmull_clark``
    fans  : corners around vertices, divided by sharp edges
    """

    mesh: Mesh
    sharp: Bool[np.ndarray, "edges"]
    rule: Int[np.ndarray, "vertices"]
    fans: Fans

    @staticmethod
    def of(mesh: Mesh) -> Neighbourhood:
        """The neighbourhood of every corner of a manifold mesh."""
        sharp = mesh.edge_sharpness >= 1.0
        rule = rules(mesh, sharp * 1.0, (mesh.vertex_sharpness >= 1.0) * 1.0)
        divided = rule[mesh.corners] != SMOOTH
        return Neighbourhood(mesh, sharp, rule, mesh.fans(sharp[mesh.edge[mesh.prev_corner]] & divided))

    @cached_property
    def steps(self) -> Int[np.ndarray, "fans"]:
        """n: how many such angles as the faces of a fan have make a full turn."""
        faces, rule = self.fans.size, self.rule[self.fans.vertex]
        return np.where(self.fans.closed, faces, np.where(rule == CORNER, 4 * faces, 2 * faces))

    @cached_property
    def sharp_from(self) -> Bool[np.ndarray, "corners 2"]:
        """Whether the edge of every half-edge is sharp at its start, and at its end (not where a crease runs out)."""
        mesh = self.mesh
        ends = np.stack([mesh.corners, mesh.ends], axis=1)
        return self.sharp[mesh.edge][:, None] & (self.rule[ends] != SMOOTH)


def acc_patches(mesh: Mesh, alpha: float = ALPHA) -> Patchwork:
    """Bicubic patches of a manifold mesh of quads and triangles, one a face, in their order.

    >>> square = Mesh.of([[0, 0, 0], [3, 0, 0], [3, 3, 0], [0, 3, 0]], [(0, 1, 2, 3)])
    >>> acc_patches(square).on_host(square.vertices)[0, 1, 1].tolist()
    [1.0, 1.0, 0.0]
    """
    around = Neighbourhood.of(mesh)
    masks = corner_masks(around, alpha)
    points = corner_points(around, masks).stacked(edge_points(around, masks), masks.normalised())
    return Patchwork(points, _net(mesh), np.arange(mesh.face_count), kinds(around))


def corner_masks(around: Neighbourhood, alpha: float) -> StencilTable:
    """The mask of every corner, weights as they stand in the module's docstring."""
    mesh = around.mesh
    corner = np.arange(len(mesh.corners))
    w, x = mesh.ends, mesh.corners[mesh.prev_corner]
    quad = mesh.sizes[mesh.face] == 4
    side = np.where(quad, 2.0, alpha)
    opposite = mesh.ends[mesh.next_corner]
    n = around.steps[around.fans.fan].astype(float)
    rows = np.concatenate([corner, corner, corner, corner[quad]])
    columns = np.concatenate([mesh.corners, w, x, opposite[quad]])
    weights = np.concatenate([n, side, side, np.ones(int(quad.sum()))])
    return StencilTable.of(rows, columns, weights, (len(corner), mesh.vertex_count))


def corner_points(around: Neighbourhood, masks: StencilTable) -> StencilTable:
    """Smooth: the sum of all masks. On a crease (1, 4, 1)/6. At a corner, and where nothing is: V."""
    mesh, rule = around.mesh, around.rule
    count = mesh.vertex_count
    identity = StencilTable.identity(count)
    gather = StencilTable.of(
        mesh.corners, np.arange(len(mesh.corners)), np.ones(len(mesh.corners)), (count, masks.rows)
    )
    smooth = gather @ masks
    along = identity.scaled(4.0) + neighbours(mesh, around.sharp)
    sums = np.where(rule == SMOOTH, smooth.row_sums(), 1.0)
    return (
        smooth.scaled((rule == SMOOTH) / sums)
        + along.scaled((rule == CREASE) / 6.0)
        + identity.scaled((rule == CORNER) * 1.0)
    )


def edge_points(around: Neighbourhood, masks: StencilTable) -> StencilTable:
    """Two for every edge, next to either end: rows 2 e (at the lower vertex) and 2 e + 1."""
    mesh = around.mesh
    out, back = out_and_back(mesh)
    corner, following = np.arange(len(mesh.corners)), mesh.next_corner
    sharp_out, sharp_back = around.sharp_from.T
    at_start, at_end = ~sharp_out, ~sharp_back
    rows = np.concatenate([out[at_start], back[at_end]])
    columns = np.concatenate([corner[at_start], following[at_end]])
    shape = (2 * mesh.edge_count, masks.rows)
    smooth = StencilTable.of(rows, columns, np.ones(len(rows)), shape) @ masks
    if not around.sharp.any():
        return smooth.normalised()
    rows = np.concatenate([out[sharp_out], back[sharp_back]])
    near = np.concatenate([mesh.corners[sharp_out], mesh.ends[sharp_back]])
    far = np.concatenate([mesh.ends[sharp_out], mesh.corners[sharp_back]])
    weights = np.repeat([2.0, 1.0], len(rows))  # twice where both faces say it: the sum is divided out
    sharp = StencilTable.of(np.tile(rows, 2), np.append(near, far), weights, (shape[0], mesh.vertex_count))
    return (smooth + sharp).normalised()


def out_and_back(mesh: Mesh) -> tuple[Any, Any]:
    """For every half-edge V -> W the rows, among edge points, of the one next to V and the one next to W."""
    reverse = (mesh.corners > mesh.ends).astype(np.int64)
    return 2 * mesh.edge + reverse, 2 * mesh.edge + 1 - reverse


def _net(mesh: Mesh) -> Int[np.ndarray, "faces 4 4"]:
    out, back = (mesh.vertex_count + rows for rows in out_and_back(mesh))
    inside = mesh.vertex_count + 2 * mesh.edge_count + np.arange(len(mesh.corners))
    net = np.empty((mesh.face_count, 4, 4), np.int64)
    quads = mesh.sizes == 4
    if quads.any():
        c = mesh.offsets[:-1][quads] + np.arange(4)[:, None]
        net[quads] = quad_net(mesh.corners, out, back, inside, c)
    if not quads.all():
        c = pinched_last(mesh, np.flatnonzero(~quads))
        net[~quads] = _pinched_net(mesh.corners, out, back, inside, c)
    return net


def quad_net(vertex: Any, out: Any, back: Any, inside: Any, c: Any) -> Any:
    """Numbers ``(quads, 4, 4)`` of the points of quads with corners c ``(4, quads)``, from the numbers at corners."""
    a, b, d, e = c  # the corners, counter-clockwise
    rows = [
        [vertex[a], back[e], out[e], vertex[e]],
        [out[a], inside[a], inside[e], back[d]],
        [back[a], inside[b], inside[d], out[d]],
        [vertex[b], out[b], back[b], vertex[d]],
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def _pinched_net(vertex: Any, out: Any, back: Any, inside: Any, c: Any) -> Any:
    p, q, top = c  # the corners, counter-clockwise
    rows = [
        [vertex[q], back[p], out[p], vertex[p]],
        [out[q], inside[q], inside[p], back[top]],
        [back[q], inside[top], inside[top], out[top]],
        [vertex[top]] * 4,
    ]
    return np.moveaxis(np.array(rows), -1, 0)


def pinched_last(mesh: Mesh, triangles: Int[np.ndarray, "triangles"]) -> Int[np.ndarray, "3 triangles"]:
    """Corners of triangles, turned so that the vertex of highest valence, the lowest of several, comes last."""
    c = mesh.offsets[:-1][triangles][:, None] + np.arange(3)
    vertex = mesh.corners[c]
    best = np.lexsort((vertex, -mesh.valence[vertex]), axis=1)[:, 0]
    turned = (best[:, None] + np.arange(1, 4)) % 3
    return np.take_along_axis(c, turned, axis=1).T


def patch_corners(mesh: Mesh) -> Int[np.ndarray, "faces 2 2"]:
    """Which corner of its face lies at (u, v) in {0, 1}^2 of the patch; of a pinched triangle the last one twice."""
    found = np.empty((mesh.face_count, 2, 2), np.int64)
    quads = mesh.sizes == 4
    found[quads] = mesh.offsets[:-1][quads][:, None, None] + [[0, 3], [1, 2]]
    p, q, top = pinched_last(mesh, np.flatnonzero(~quads))
    found[~quads] = np.stack([q, p, top, top], axis=1).reshape(-1, 2, 2)
    return found


def kinds(around: Neighbourhood) -> Int[np.ndarray, "faces"]:
    """Of every face the last of KINDS that one of its vertices makes it; where all are regular, it is a B-spline."""
    mesh = around.mesh
    kind = np.zeros(mesh.face_count, np.int64)
    touched = np.zeros(mesh.vertex_count, bool)
    touched[mesh.corners[(mesh.sizes != 4)[mesh.face]]] = True
    at_boundary = np.zeros(mesh.vertex_count, bool)
    at_boundary[mesh.edge_vertices[mesh.boundary]] = True
    creased = (around.rule != SMOOTH) & ~at_boundary
    creased[mesh.edge_vertices[around.sharp & ~mesh.boundary]] = True
    for name, vertices in (
        ("extraordinary", touched | (mesh.valence != 4)),
        ("boundary", at_boundary),
        ("crease", creased),
    ):
        kind[mesh.face[vertices[mesh.corners]]] = KINDS.index(name)
    kind[mesh.sizes == 3] = KINDS.index("triangle")
    return kind
