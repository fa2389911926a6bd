"""The points of Gregory patches, approximate Catmull-Clark that is smooth across edges [LSNC09] (docs/conversion.md).

With n edges, faces of any size, midpoints m_i of the edges and centroids c_i of the faces (c_i between edges i and
i+1) around a vertex v, t = 2 pi/n, s = (4 + cos^2(pi/n))^(-1/2) and L the subdominant eigenvalue of subdivision:

    p   = (n-3)/(n+5) v + 4/(n (n+5)) sum (m_i + c_i)                        the limit point
    q_k = 2/n sum [(1 - s cos(pi/n)) cos((i-k) t) m_i + 2 s cos((i-k+1/2) t) c_i]        a limit tangent
    e_k = p + 2/3 L q_k                                                      the edge point along edge k
    f   = 1/d [c_b p_a + (d - 2 c_a - c_b) e_a + 2 c_a e_b + r]              the face point at a along the edge a -> b
    r   = 1/3 (m_(i+1) - m_(i-1)) + 2/3 (c_i - c_(i-1))                      at a, i the edge, the face on its left

with c_x = cos(2 pi/n_x), d = 3 in a quad and 4 in a triangle. A face point to the right of an edge has -r. Along
boundaries and creases, which divide a vertex' faces, points are cubic B-splines'; edges between them have the tangents
of ``slefejax.conversion.tangents``. Where an edge has no face on one side, the corner's other face point stands for
the one along it; where both are missing, and at corners of several faces, ``acc``'s.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from slefejax.conversion.acc import ALPHA, Neighbourhood, corner_masks, corner_points, out_and_back
from slefejax.conversion.acc import edge_points as acc_edge_points
from slefejax.conversion.catmull_clark import CORNER, SMOOTH, face_points, refine
from slefejax.conversion.tangents import crease_frame
from slefejax.model.stencils import StencilTable


class Points:
    """Tables of the points of Gregory patches: of vertices, two an edge, two a corner.

    around : the neighbourhood of every corner
    """

    def __init__(self, around: Neighbourhood) -> None:
        self.around = around
        self._masks = corner_masks(around, ALPHA)

    @cached_property
    def _fan(self) -> Int[np.ndarray, "corners"]:
        return self.around.fans.fan

    @cached_property
    def _smooth(self) -> Bool[np.ndarray, "corners"]:
        """Whether the half-edge has a face on either side, and is not sharp."""
        mesh = self.around.mesh
        return (mesh.twin >= 0) & ~self.around.sharp[mesh.edge]

    @cached_property
    def middles(self) -> StencilTable:
        """Of the edges."""
        mesh = self.around.mesh
        rows = np.repeat(np.arange(mesh.edge_count), 2)
        shape = (mesh.edge_count, mesh.vertex_count)
        return StencilTable.of(rows, mesh.edge_vertices.ravel(), np.full(len(rows), 0.5), shape)

    @cached_property
    def centroids(self) -> StencilTable:
        """Of the faces."""
        return face_points(self.around.mesh)

    @cached_property
    def vertices(self) -> StencilTable:
        """p, on boundaries and creases a B-spline's."""
        mesh, rule = self.around.mesh, self.around.rule
        count = mesh.vertex_count
        n = np.maximum(np.bincount(mesh.corners, minlength=count), 1).astype(float)
        gather = lambda columns, width: StencilTable.of(  # noqa: E731
            mesh.corners, columns, np.ones(len(columns)), (count, width)
        )
        sums = gather(mesh.edge, mesh.edge_count) @ self.middles + gather(mesh.face, mesh.face_count) @ self.centroids
        smooth = StencilTable.identity(count).scaled((n - 3.0) / (n + 5.0)) + sums.scaled(4.0 / (n * (n + 5.0)))
        others = corner_points(self.around, self._masks)
        return smooth.scaled(1.0 * (rule == SMOOTH)) + others.scaled(1.0 * (rule != SMOOTH))

    @cached_property
    def edges(self) -> StencilTable:
        """e, two an edge: rows 2 e (at the lower vertex) and 2 e + 1."""
        mesh, around = self.around.mesh, self.around
        rule = around.rule[mesh.corners]
        own = np.flatnonzero(~around.sharp_from[:, 0] & (rule != CORNER))
        row, first = np.unique(out_and_back(mesh)[0][own], return_index=True)
        corner = own[first]
        fan, k = self._fan[corner], around.fans.position[corner]
        angle = k * 2.0 * np.pi / around.steps[fan]
        a, b = (table.take(fan) for table in self._frame)
        found = a.scaled(np.cos(angle)) + b.scaled(np.sin(angle)) + self.vertices.take(mesh.corners[corner])
        table = acc_edge_points(around, self._masks)
        place = np.arange(table.rows)
        place[row] = table.rows + np.arange(len(row))
        return table.stacked(found).take(place)

    @cached_property
    def _frame(self) -> tuple[StencilTable, StencilTable]:
        """A and B of every fan: edge k is at p + cos(k t) A + sin(k t) B."""
        n = self.around.steps.astype(float)
        lam = eigenvalue(n)
        closed = self.around.fans.closed
        crease_a, crease_b = self._crease_frame
        a, b = (self._waves(phase).scaled(2.0 / 3.0 * lam * closed) for phase in (np.cos, np.sin))
        return a + crease_a.scaled(1.0 / 3.0), b + crease_b.scaled(2.0 / 3.0 * lam)

    def _waves(self, phase: Any) -> StencilTable:
        """q_0 (cosines) or q_(n/4) (sines) of every fan."""
        mesh, fans = self.around.mesh, self.around.fans
        n = self.around.steps[self._fan].astype(float)
        cosine = np.cos(np.pi / n)
        s, t, k = 1.0 / np.sqrt(4.0 + cosine**2), 2.0 * np.pi / n, fans.position
        of_edges, of_faces = 2.0 / n * (1.0 - s * cosine) * phase(k * t), 4.0 / n * s * phase((k + 0.5) * t)
        count = len(fans.size)
        edges = StencilTable.of(self._fan, mesh.edge, of_edges, (count, mesh.edge_count))
        faces = StencilTable.of(self._fan, mesh.face, of_faces, (count, mesh.face_count))
        return edges @ self.middles + faces @ self.centroids

    @cached_property
    def _crease_frame(self) -> tuple[StencilTable, StencilTable]:
        """Of fans between creases: half of what lies between their ends, and the limit tangent across.

        That tangent's mask is for quads; it is an eigenvector, so it may as well be taken of the points after a step.
        """
        around, mesh = self.around, self.around.mesh
        if np.all(mesh.sizes == 4):
            return crease_frame(around)
        sharp = np.where(mesh.crease_sharpness >= 1.0, np.inf, 0.0)
        finer, step, _ = refine(replace(mesh, crease_sharpness=sharp))
        later = Neighbourhood.of(finer)
        fan = np.zeros(len(around.fans.size), np.int64)
        fan[self._fan] = later.fans.fan[4 * np.arange(len(mesh.corners))]
        _, b = crease_frame(later)
        return crease_frame(around)[0], (b.take(fan) @ step).scaled(1.0 / eigenvalue(around.steps.astype(float)))

    @cached_property
    def faces(self) -> tuple[StencilTable, StencilTable]:
        """f of every corner V, along V -> W and along V -> X."""
        mesh, around = self.around.mesh, self.around
        corner, before = np.arange(len(mesh.corners)), mesh.prev_corner
        at_corner = around.rule[mesh.corners] == CORNER
        there = [self._smooth & ~at_corner, self._smooth[before] & ~at_corner]
        other = mesh.next_corner[np.maximum(mesh.twin, 0)], np.maximum(mesh.twin[before], 0)
        across = mesh.edge[other[0]], mesh.edge[before[other[1]]]
        beside = mesh.edge[before], mesh.edge
        out, back = out_and_back(mesh)
        near, far = (out, back[before]), (back, out[before])
        last = mesh.next_corner, before
        found = [
            self._face_points(corner, last[k], near[k], far[k], beside[k], across[k], mesh.face[other[k]])
            for k in (0, 1)
        ]
        both = found[0].stacked(found[1], self._masks.normalised())
        count = len(corner)
        rows = [np.where(there[k], corner + k * count, corner + (1 - k) * count) for k in (0, 1)]
        neither = ~there[0] & ~there[1]
        plus, minus = (both.take(np.where(neither, corner + 2 * count, row)) for row in rows)
        return plus, minus

    def _face_points(self, corner: Any, last: Any, near: Any, far: Any, beside: Any, across: Any, other: Any) -> Any:
        """f of corners along edges, from the numbers of what lies around them."""
        mesh = self.around.mesh
        d = np.where(mesh.sizes[mesh.face] == 4, 3.0, 4.0)
        cosine = np.cos(2.0 * np.pi / self.around.steps)[self._fan]
        c_a, c_b = cosine, cosine[last]
        r = (self.middles.take(beside) - self.middles.take(across)).scaled(1.0 / 3.0)
        r = r + (self.centroids.take(mesh.face) - self.centroids.take(other)).scaled(2.0 / 3.0)
        at_a = self.vertices.take(mesh.corners[corner]).scaled(c_b)
        ends = self.edges.take(near).scaled(slide(d, c_a, c_b)) + self.edges.take(far).scaled(2.0 * c_a)
        return (at_a + ends + r).scaled(1.0 / d)


def slide(d: Any, c_a: Any, c_b: Any) -> Any:
    """The weight of e_a in d f.

    >>> slide(3.0, 0.0, 0.0)
    3.0
    """
    return d - 2.0 * c_a - c_b


def eigenvalue(n: Any) -> Any:
    """The subdominant eigenvalue of Catmull-Clark subdivision around a vertex of valence n.

    >>> float(eigenvalue(4.0))
    0.5
    """
    c = np.cos(2.0 * np.pi / n)
    return (5.0 + c + np.cos(np.pi / n) * np.sqrt(18.0 + 2.0 * c)) / 16.0
