"""Tangent patches: a pair of vector fields a patch whose normals agree across edges, for shading [LS08].

The patches of ``acc`` join, but not smoothly where the valence is not 4. Their derivatives are therefore replaced, at
the corners by limit tangents of the Catmull-Clark surface and along the edges so that both sides span one plane. Along
a half-edge from a to b, in a face that lies to its left, with T the derivative along it and N the one into the face:

    T_0 = tangent at a towards b    T_1 = 3 (ba - ab)                              T_2 = -(tangent at b towards a)
    N_0 = tangent at a, next edge   N_1 = (2 c_a T_1 - c_b T_0)/3 + 3 (A - ab)
    N_3 = tangent at b, edge before N_2 = (c_a T_2 - 2 c_b T_1)/3 + 3 (B - ba)

with c = cos(2 pi / n), and ab, ba, A, B the edge and interior points of ``acc``. The fields of two faces then satisfy
N + N' = 2 ((1-t) c_a - t c_b) T all along the edge. At boundaries and sharp edges N_1, N_2 are the derivatives of the
patch itself, and so is everything at edges with an end that touches a triangle, is a corner, or has valence 2: nothing
is promised there.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool

from slefejax.conversion.acc import Neighbourhood, out_and_back
from slefejax.conversion.catmull_clark import CORNER
from slefejax.conversion.patchwork import Patchwork
from slefejax.model.mesh import Mesh
from slefejax.model.stencils import StencilTable


def tangent_tables(mesh: Mesh, patches: Patchwork) -> tuple[StencilTable, StencilTable]:
    """Tables of the coefficients of d/du, ``faces * 3 * 4`` rows, and of d/dv, ``faces * 4 * 3``, in C order.

    mesh, patches : a mesh and ``acc_patches`` of it
    """
    points, net = patches.points, patches.net
    du = (points.take(net[:, 1:].ravel()) - points.take(net[:, :-1].ravel())).scaled(3.0)
    dv = (points.take(net[:, :, 1:].ravel()) - points.take(net[:, :, :-1].ravel())).scaled(3.0)
    quads = np.flatnonzero(mesh.sizes == 4)
    if not quads.size:
        return du, dv
    around = Neighbourhood.of(mesh)
    along, inward, usable = _edge_fields(around, points)
    pool = du.stacked(dv, along, inward)
    u = _Choice(np.arange(du.rows).reshape(-1, 3, 4))
    v = _Choice(du.rows + np.arange(dv.rows).reshape(-1, 4, 3))
    first = du.rows + dv.rows
    for side in range(4):
        corner = mesh.offsets[:-1][quads] + side
        t = first + 3 * corner[:, None] + np.arange(3)
        n = first + along.rows + 4 * corner[:, None] + np.arange(4)
        _put(u, v, quads, side, t, n, usable[corner])
    return tuple(pool.take(c.row.ravel()).scaled(c.sign.ravel()) for c in (u, v))  # type: ignore[return-value]


class _Choice:
    """For every coefficient the row of a pool of rows that it is, and its sign."""

    def __init__(self, row: np.ndarray) -> None:
        self.row, self.sign = row.copy(), np.ones(row.shape)

    def put(self, where: Any, row: np.ndarray, sign: float, usable: np.ndarray) -> None:
        self.row[where] = np.where(usable, row, self.row[where])
        self.sign[where] = np.where(usable, sign, self.sign[where])


def _put(u: _Choice, v: _Choice, faces: Any, side: int, t: np.ndarray, n: np.ndarray, usable: np.ndarray) -> None:
    """Place the fields of one side; sides are those of the half-edges ab (v=0), bc (u=1), cd (v=1), da (u=0)."""
    # the half-edge runs with or against its parameter, and into the face is against the other one at u=1, v=1
    along, across = (u, v) if side in (0, 2) else (v, u)
    end = 0 if side in (0, 3) else -1
    sign_t, sign_n = (1.0 if side in (0, 1) else -1.0), (1.0 if side in (0, 3) else -1.0)
    forwards = side in (0, 1)
    for k in range(3):
        at = k if forwards else 2 - k
        where = (faces, at, end) if side in (0, 2) else (faces, end, at)
        along.put(where, t[:, k], sign_t, usable[:, 0])
    for k in range(4):
        at = k if forwards else 3 - k
        where = (faces, at, end) if side in (0, 2) else (faces, end, at)
        across.put(where, n[:, k], sign_n, usable[:, 1] if k in (1, 2) else usable[:, 0])


def _edge_fields(around: Neighbourhood, points: StencilTable) -> tuple[StencilTable, StencilTable, Bool[Any, "c 2"]]:
    """T_0 ... T_2 and N_0 ... N_3 of every half-edge; usable: whether T, N_0, N_3 are, and whether N_1, N_2 are."""
    mesh, fans = around.mesh, around.fans
    ahead, aside, sound = corner_tangents(around)
    out, back = (mesh.vertex_count + rows for rows in out_and_back(mesh))
    inside = mesh.vertex_count + 2 * mesh.edge_count + np.arange(len(mesh.corners))
    following = mesh.next_corner
    middle = (points.take(back) - points.take(out)).scaled(3.0)
    first, last = ahead, aside.take(following).scaled(-1.0)
    cosine = np.cos(2.0 * np.pi / around.steps)[fans.fan]
    c_a, c_b = cosine, cosine[following]
    near = (points.take(inside) - points.take(out)).scaled(3.0)
    far = (points.take(inside[following]) - points.take(back)).scaled(3.0)
    n_1 = middle.scaled(2.0 / 3.0 * c_a) - first.scaled(c_b / 3.0) + near
    n_2 = last.scaled(c_a / 3.0) - middle.scaled(2.0 / 3.0 * c_b) + far
    along = _interleaved([first, middle, last])
    inward = _interleaved([aside, n_1, n_2, ahead.take(following)])
    good = sound[fans.fan]
    ends = good & good[following]
    smooth = (mesh.twin >= 0) & ~around.sharp[mesh.edge]
    return along, inward, np.stack([ends, ends & smooth], axis=1)


def _interleaved(tables: list[StencilTable]) -> StencilTable:
    """Row r of every table, for every r in turn."""
    count = tables[0].rows
    order = np.arange(len(tables))[None] * count + np.arange(count)[:, None]
    return tables[0].stacked(*tables[1:]).take(order.ravel())


def corner_tangents(around: Neighbourhood) -> tuple[StencilTable, StencilTable, Bool[np.ndarray, "fans"]]:
    """At every corner the limit tangents along its half-edge V -> W and along V -> X; of which fans they are usable.

    In a fan all of them are cos(k t) A + sin(k t) B, k the place of the edge and t = 2 pi / n. They are not around
    vertices that touch a triangle, stay where they are (corners), or have all their edges in one line (n = 2).
    """
    fans = around.fans
    angle = 2.0 * np.pi / around.steps[fans.fan]
    a, b = (table.take(fans.fan) for table in _frame(around))
    k = fans.position
    ahead = a.scaled(np.cos(k * angle)) + b.scaled(np.sin(k * angle))
    aside = a.scaled(np.cos((k + 1) * angle)) + b.scaled(np.sin((k + 1) * angle))
    others = np.bincount(fans.fan, around.mesh.sizes[around.mesh.face] != 4, minlength=len(fans.size))
    return ahead, aside, (others == 0) & (around.rule[fans.vertex] != CORNER) & (around.steps > 2)


def _frame(around: Neighbourhood) -> tuple[StencilTable, StencilTable]:
    """A and B of every fan."""
    (closed_a, closed_b), (crease_a, crease_b) = _closed_frame(around), crease_frame(around)
    return closed_a + crease_a, closed_b + crease_b


def crease_frame(around: Neighbourhood) -> tuple[StencilTable, StencilTable]:
    """A and B of fans between creases or at a boundary, for quads; 0 of the others."""
    fans, mesh = around.fans, around.mesh
    first, last = _ends_of_fans(around)
    count = len(fans.size)

    def rows(columns: np.ndarray) -> StencilTable:
        return StencilTable.of(np.arange(count), columns, np.ones(count), (count, mesh.vertex_count))

    a = (rows(first) - rows(last)).scaled(0.5 * ~fans.closed)
    return a, _across_crease(around, rows(first) + rows(last), rows(fans.vertex))


def _ends_of_fans(around: Neighbourhood) -> tuple[np.ndarray, np.ndarray]:
    """The vertices that the first and the last edge of every fan lead to."""
    fans, mesh = around.fans, around.mesh
    first, last = np.empty((2, len(fans.size)), np.int64)
    opens, ends = fans.position == 0, fans.position == fans.size[fans.fan] - 1
    first[fans.fan[opens]] = mesh.ends[opens]
    last[fans.fan[ends]] = mesh.corners[mesh.prev_corner[ends]]
    return first, last


def _waves(around: Neighbourhood, edge: Any, diagonal: Any, phase: Any, chosen: np.ndarray) -> StencilTable:
    """For every chosen fan the sum of edge weights phase(k t) and diagonal weights phase(k t) + phase((k+1) t)."""
    fans, mesh = around.fans, around.mesh
    angle = (2.0 * np.pi / around.steps)[fans.fan]
    k, fan = fans.position, fans.fan
    c = np.flatnonzero(chosen[fan])
    weight = edge[fan] * phase(k * angle)
    both = diagonal[fan] * (phase(k * angle) + phase((k + 1) * angle))
    opposite = mesh.ends[mesh.next_corner]
    shape = (len(fans.size), mesh.vertex_count)
    return StencilTable.of(
        np.tile(fan[c], 2), np.append(mesh.ends[c], opposite[c]), np.append(weight[c], both[c]), shape
    )


def _closed_frame(around: Neighbourhood) -> tuple[StencilTable, StencilTable]:
    """Limit tangents of an interior vertex ([LS08], section 4; the scale of a B-spline for n = 4).

    Edge weights (1/n + c/(n s)) cos(k t), diagonal ones cos((k + 1/2) t)/(n s), with c = cos(pi/n), s = sqrt(4 + c^2).
    """
    n = around.steps.astype(float)
    c = np.cos(np.pi / n)
    s = np.sqrt(4.0 + c * c)
    edge = 1.0 / n + c / (n * s)
    # cos((k + 1/2) t) = (cos(k t) + cos((k + 1) t)) / (2 cos(pi / n)); for n = 2 all of them are 0
    diagonal = np.where(c > 1e-9, 1.0 / (2.0 * n * s * np.where(c > 1e-9, c, 1.0)), 0.0)
    closed = around.fans.closed
    return (_waves(around, edge, diagonal, np.cos, closed), _waves(around, edge, diagonal, np.sin, closed))


def _across_crease(around: Neighbourhood, both_ends: StencilTable, vertex: StencilTable) -> StencilTable:
    """The limit tangent across a boundary or a crease, the left eigenvector of one subdivision step around it.

    Between the ends of the fan that step is the one of an interior vertex with n = 2 f edges, f faces, so the weights
    of edges and diagonals are those of ``_closed_frame``, twice (as for a B-spline), with eigenvalue
    (5 + cos t + cos(t/2) sqrt(18 + 2 cos t))/16. The equation for the column of an end gives the weight of both ends,
    and all weights together are 0.
    """
    fans = around.fans
    crease = ~fans.closed & (around.rule[fans.vertex] != CORNER) & (fans.size > 1)  # one face is a half turn
    f = np.where(crease, fans.size, 2).astype(float)
    t, c = np.pi / f, np.cos(np.pi / (2.0 * f))
    s = np.sqrt(4.0 + c * c)
    edge, diagonal = (s + c) / (f * s), 1.0 / (2.0 * c * f * s)
    inner = _waves(around, edge, diagonal, np.sin, crease)
    eigenvalue = (5.0 + np.cos(t) + c * np.sqrt(18.0 + 2.0 * np.cos(t))) / 16.0
    total = inner.row_sums()
    first_edge, first_diagonal = edge * np.sin(t), diagonal * np.sin(t)
    ends = (first_diagonal / 4.0 + first_edge / 16.0 - total / 8.0) / (eigenvalue - 0.25)
    ends = np.where(crease, ends, 0.0)
    return inner + both_ends.scaled(ends) - vertex.scaled(2.0 * ends + total)
