"""Gaussian products as their GPU method was published: nested B-splines of q, solved at every vertex that is drawn.

A face is cut in four by a step of subdivision. A quarter has at most one irregular vertex: without one it is a cubic
B-spline of q, with one it is divided again and again, three B-splines a level, and what is left over is a small patch.
Single precision holds q, evaluates and solves it. Here q is relative to the middle of the mesh, in its favour.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Int

from slefejax.arguments import is_whole
from slefejax.conversion.catmull_clark import refine
from slefejax.conversion.gaussian.products import Dual, patches_of
from slefejax.conversion.limit import LimitSurface, irregular, limit_of_q
from slefejax.errors import InputError
from slefejax.geometry.nested import NestedNets
from slefejax.model.gaussians import Gaussians
from slefejax.model.mesh import Mesh

DEEPEST = 10  # levels, and the highest valence
# Bézier points of a uniform cubic B-spline
_BEZIER = np.array([[1, 4, 1, 0], [0, 4, 2, 0], [0, 2, 4, 0], [0, 1, 4, 1]]) / 6.0


@dataclass(frozen=True, eq=False)
class Published:
    """Quarters of the faces of a covariance mesh, four a face in the order of its corners. Make it with ``published``.

    nets  : what is drawn (``slefejax.gpu.Renderer`` takes it), in single precision
    dual  : how Gaussians become q
    exact : the same surface of q in float64; its faces are the quarters
    faces : ``(quarters,)``, the face of the control mesh
    """

    nets: NestedNets
    dual: Dual
    exact: LimitSurface
    faces: Int[np.ndarray, "quarters"]

    @cached_property
    def limit(self) -> LimitSurface:
        """The surface in float64, of rational patches; its faces are the quarters."""
        return replace(self.exact, net=patches_of(self.exact.net, self.dual))

    def on_limit(self, quarter: Any, u: Any, v: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Places on quarters as places on the patches ``limit.net``: number, u, v; -1 stays."""
        shape = np.shape(quarter)
        number, at = np.full(shape, -1), np.zeros((*shape, 2))
        there = np.asarray(quarter) >= 0
        own = np.stack([np.asarray(u)[there], np.asarray(v)[there]], axis=1).astype(np.float64)
        number[there], at[there] = self.exact.places(np.asarray(quarter)[there], own)
        return number, at[..., 0], at[..., 1]


def published(mesh: Mesh, depth: int = DEEPEST, steps: int = 0) -> Published:
    """What the published method makes of a mesh of quads with covariances.

    depth : levels around irregular vertices, 1 to 10
    steps : of subdivision before, which make quads of other faces

    Raises InputError for a mesh without covariances, other faces than quads, tags of sharpness, and vertices of a
    valence above 10, with their number.
    """
    if not (is_whole(depth, 1) and depth <= DEEPEST):
        raise InputError(f"depth must be a whole number from 1 to {DEEPEST}, not {depth!r}")
    if mesh.covariances is None:
        raise InputError("the published method needs a covariance at every vertex, and there are none: give gaussians")
    gaussians = Gaussians(mesh.vertices, mesh.covariances)
    dual = Dual.of(gaussians)
    q, quads, faces = dual(gaussians), mesh, np.arange(mesh.face_count)
    for _ in range(steps):
        quads, table, parents = refine(quads)
        q, faces = table.on_host(q), faces[parents]
    _check(quads)
    quarters, table, parents = refine(quads)
    exact = limit_of_q(quarters, table.on_host(q), depth)
    bad = irregular(quarters).reshape(-1, 4)
    nested = bad[:, 0] & ~bad[:, 1:].any(axis=1)
    first, order, turns = _nested(exact, nested, depth)
    back = np.linalg.inv(_BEZIER)
    own = exact.net[order]
    for k in (1, 2, 3):
        own[turns == k] = np.rot90(own[turns == k], k, (1, 2))
    points = np.einsum("ia,jb,nabk->nijk", back, back, own, optimize=True)
    drawn = NestedNets(points.astype(np.float32), first, nested, depth, dual.origin)
    return Published(drawn, dual, exact, faces[parents])


def _check(mesh: Mesh) -> None:
    other = np.flatnonzero(mesh.sizes != 4)
    if other.size:
        raise InputError(
            f"the published method takes quads only: face {mesh.numbers[other[0]]} (counted from 0) has"
            f" {mesh.sizes[other[0]]} vertices: take a step of subdivision before"
        )
    if len(mesh.creases) or len(mesh.points):
        raise InputError("the published method has no tags of sharpness: features come from covariances")
    high = np.flatnonzero(mesh.valence > DEEPEST)
    if high.size:
        raise InputError(
            f"the published method stops at valence {DEEPEST}: vertex {high[0]} (counted from 0) has"
            f" {mesh.valence[high[0]]} edges"
        )


def _nested(
    limit: LimitSurface, nested: np.ndarray, depth: int
) -> tuple[Int[np.ndarray, "quarters"], Int[np.ndarray, "nets"], Int[np.ndarray, "nets"]]:
    """The first net of every quarter, and of all nets the patch of the limit surface, and by how many right angles it
    is turned."""
    count = np.where(nested, 3 * depth + 1, 1)
    first = np.cumsum(count) - count
    quarter = np.repeat(np.arange(len(nested)), count)
    place = np.arange(len(quarter)) - first[quarter]
    level = np.where(nested[quarter], np.minimum(place // 3 + 1, depth), 0)
    square = np.array([[1, 0], [0, 1], [1, 1]])[place % 3]
    square[(place == 3 * depth) | ~nested[quarter]] = 0
    patch, _ = limit.places(quarter, 0.5 ** level[:, None] * (square + 0.5))
    along_u = limit.frame[patch, :, 0]
    return first, patch, np.round(np.arctan2(along_u[:, 1], along_u[:, 0]) / (0.5 * np.pi)).astype(int) % 4
