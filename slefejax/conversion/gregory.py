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
from jaxtyping import Bool, Float, Int

from slefejax.conversion.acc import ALPHA, Neighbourhood, corner_masks, corner_points, out_and_back
from slefejax.conversion.acc import edge_points as acc_edge_points
from slefejax.conversion.catmull_clark import CORNER, SMOOTH, face_points, refine
from slefejax.conversion.tangents import crease_frame
from slefejax.model.stencils import StencilTable

ROUNDING = 1e-13  # of a weight: sums that are 0 by topology have less


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
    def _regular(self) -> Bool[np.ndarray, "vertices"]:
        """Smooth inner vertices of four quads: around these, points are those of ``acc``."""
        mesh = self.around.mesh
        faces, quads = (
            np.bincount(mesh.corners, weights, minlength=mesh.vertex_count)
            for weights in (None, mesh.sizes[mesh.face] == 4)
        )
        return (mesh.valence == 4) & (faces == 4) & (quads == 4) & (self.around.rule == SMOOTH)

    @cached_property
    def _pool(self) -> StencilTable:
        """Vertices, middles of edges, centroids of faces."""
        mesh = self.around.mesh
        rows = np.repeat(np.arange(mesh.edge_count), 2)
        shape = (mesh.edge_count, mesh.vertex_count)
        middles = StencilTable.of(rows, mesh.edge_vertices.ravel(), np.full(len(rows), 0.5), shape)
        return StencilTable.identity(mesh.vertex_count).stacked(middles, face_points(mesh))

    @cached_property
    def _first(self) -> tuple[int, int]:
        """Where middles and centroids begin there."""
        return self.around.mesh.vertex_count, self.around.mesh.vertex_count + self.around.mesh.edge_count

    @cached_property
    def vertices(self) -> StencilTable:
        """p, on boundaries and creases a B-spline's."""
        mesh = self.around.mesh
        found = corner_points(self.around, self._masks)
        odd = np.flatnonzero(~self._regular & (self.around.rule == SMOOTH))
        place = np.full(mesh.vertex_count, -1)
        place[odd] = np.arange(len(odd))
        corner = np.flatnonzero(place[mesh.corners] >= 0)
        row = place[mesh.corners[corner]]
        n = np.bincount(row, minlength=len(odd)).astype(float)
        around = np.tile((4.0 / (n * (n + 5.0)))[row], 2)
        column = np.concatenate(
            [odd, *(f + x[corner] for f, x in zip(self._first, (mesh.edge, mesh.face), strict=True))]
        )
        weight = np.concatenate([(n - 3.0) / (n + 5.0), around])
        rows = np.concatenate([np.arange(len(odd)), row, row])
        return _instead(found, odd, self._of(rows, column, weight, len(odd)))

    def _of(self, rows: Any, columns: Any, weights: Any, count: int) -> StencilTable:
        return StencilTable.of(rows, columns, weights, (count, self._pool.rows)) @ self._pool

    @cached_property
    def edges(self) -> StencilTable:
        """e, two an edge: rows 2 e (at the lower vertex) and 2 e + 1."""
        mesh, around = self.around.mesh, self.around
        rule = around.rule[mesh.corners]
        own = np.flatnonzero(~around.sharp_from[:, 0] & (rule != CORNER) & ~self._regular[mesh.corners])
        row, first = np.unique(out_and_back(mesh)[0][own], return_index=True)
        corner = own[first]
        fan, k = self._fan[corner], around.fans.position[corner]
        angle = k * 2.0 * np.pi / around.steps[fan]
        a, b = (table.take(fan) for table in self._frame)
        found = a.scaled(np.cos(angle)) + b.scaled(np.sin(angle)) + self.vertices.take(mesh.corners[corner])
        return _instead(acc_edge_points(around, self._masks), row, found.pruned(ROUNDING))

    @cached_property
    def _frame(self) -> tuple[StencilTable, StencilTable]:
        """A and B of every irregular fan: edge k is at p + cos(k t) A + sin(k t) B."""
        lam = eigenvalue(self.around.steps.astype(float))
        a, b = (self._waves(phase).scaled(2.0 / 3.0 * lam) for phase in (np.cos, np.sin))
        if self.around.fans.closed.all():
            return a, b
        crease_a, crease_b = self._crease_frame
        return a + crease_a.scaled(1.0 / 3.0), b + crease_b.scaled(2.0 / 3.0 * lam)

    def _waves(self, phase: Any) -> StencilTable:
        """q_0 (cosines) or q_(n/4) (sines) of every closed irregular fan."""
        mesh, fans = self.around.mesh, self.around.fans
        c = np.flatnonzero(fans.closed[self._fan] & ~self._regular[mesh.corners])
        fan, k = self._fan[c], fans.position[c]
        n = self.around.steps[fan].astype(float)
        cosine = np.cos(np.pi / n)
        s, t = 1.0 / np.sqrt(4.0 + cosine**2), 2.0 * np.pi / n
        weights = 2.0 / n * (1.0 - s * cosine) * phase(k * t), 4.0 / n * s * phase((k + 0.5) * t)
        column = np.concatenate([f + x[c] for f, x in zip(self._first, (mesh.edge, mesh.face), strict=True)])
        return self._of(np.tile(fan, 2), column, np.concatenate(weights), len(fans.size))

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
    def odd(self) -> Int[np.ndarray, "odd"]:
        """Corners whose face points are not those of ``acc``: V, W or X is irregular."""
        mesh, regular = self.around.mesh, self._regular
        return np.flatnonzero(~(regular[mesh.corners] & regular[mesh.ends] & regular[mesh.corners[mesh.prev_corner]]))

    @cached_property
    def inside(self) -> StencilTable:
        """Of every corner the mean of both face points."""
        plus, minus = self._odd_faces
        return _instead(self._masks.normalised(), self.odd, (plus + minus).scaled(0.5).pruned(ROUNDING))

    @cached_property
    def twists(self) -> StencilTable:
        """f along V -> W less f along V -> X, of odd corners; of the others they are equal."""
        plus, minus = self._odd_faces
        return (plus - minus).pruned(ROUNDING)

    @cached_property
    def faces(self) -> tuple[StencilTable, StencilTable]:
        """f of every corner V, along V -> W and along V -> X."""
        masks = self._masks.normalised()
        plus, minus = (_instead(masks, self.odd, own) for own in self._odd_faces)
        return plus, minus

    @cached_property
    def _odd_faces(self) -> list[StencilTable]:
        """Both face points of odd corners."""
        return [self._all.combined(*terms) for terms in self._terms]

    @cached_property
    def _all(self) -> StencilTable:
        """What face points are made of: the pool, edge points, corner points, ``acc``'s own of odd corners."""
        return self._pool.stacked(self.edges, self.vertices, self._masks.take(self.odd).normalised())

    @cached_property
    def _terms(self) -> list[tuple[Int[np.ndarray, "odd 7"], Float[np.ndarray, "odd 7"]]]:
        """Both face points of odd corners: numbers of what they are made of, in all that, and weights."""
        mesh, corner = self.around.mesh, self.odd
        before, vertex = mesh.prev_corner, mesh.corners
        fixed = self.around.rule[vertex] == CORNER
        there = [(own & ~fixed)[corner] for own in (self._smooth, self._smooth[before])]
        other = mesh.next_corner[np.maximum(mesh.twin, 0)], np.maximum(mesh.twin[before], 0)
        across = mesh.edge[other[0]], mesh.edge[before[other[1]]]
        out, back = out_and_back(mesh)
        along = (
            (mesh.next_corner, out, back, mesh.edge[before], across[0], mesh.face[other[0]]),
            (before, back[before], out[before], mesh.edge, across[1], mesh.face[other[1]]),
        )
        plus, minus = (self._face_points(corner, *(numbers[corner] for numbers in own)) for own in along)
        return [self._chosen(plus, minus, *there), self._chosen(minus, plus, *there[::-1])]

    def _chosen(self, one: Any, other: Any, here: Any, there: Any) -> Any:
        """The one where it is here, else the other where that is there, else the corners' own masks."""
        numbers, weights = (x.copy() for x in one)
        beside, alone = np.flatnonzero(~here & there), np.flatnonzero(~here & ~there)
        numbers[beside], weights[beside] = (x[beside] for x in other)
        numbers[alone] = self._all.rows - len(numbers) + alone[:, None]
        weights[alone] = np.eye(1, weights.shape[1])
        return numbers, weights

    def _face_points(self, corner: Any, last: Any, near: Any, far: Any, beside: Any, across: Any, other: Any) -> Any:
        """f of corners along edges, from the numbers of what lies around them: numbers and weights, seven each."""
        mesh, (middles, centroids) = self.around.mesh, self._first
        d = np.where(mesh.sizes[mesh.face[corner]] == 4, 3.0, 4.0)
        cosine = np.cos(2.0 * np.pi / self.around.steps)[self._fan]
        c_a, c_b = cosine[corner], cosine[last]
        edges, points = self._pool.rows, self._pool.rows + self.edges.rows
        ones = np.ones(len(corner))
        terms = (
            (points + mesh.corners[corner], c_b),
            (edges + near, slide(d, c_a, c_b)),
            (edges + far, 2.0 * c_a),
            (middles + beside, ones / 3.0),
            (middles + across, -ones / 3.0),
            (centroids + mesh.face[corner], 2.0 * ones / 3.0),
            (centroids + other, -2.0 * ones / 3.0),
        )
        columns, weights = (np.stack(x, axis=1) for x in zip(*terms, strict=True))
        return columns, weights / d[:, None]


def _instead(table: StencilTable, rows: Int[np.ndarray, "n"], found: StencilTable) -> StencilTable:
    """The table with other rows in the place of these."""
    if not len(rows):
        return table
    place = np.arange(table.rows)
    place[rows] = table.rows + np.arange(len(rows))
    return table.stacked(found).take(place)


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
