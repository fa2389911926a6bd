"""Tangents and normals of patches of every kind, and the way along tangents to the point that is nearest to another.

Control points and parameters are as ``geometry.evaluate.places_at`` takes them. Differentiable.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp

from slefejax.geometry.bezier import Values
from slefejax.geometry.evaluate import evaluate, places_at

_FLAT = 1e-9  # sine of an angle between tangents: below, there is no tangent plane
_STEEP = 1e-12  # square of such a sine: below, no step is taken
_SHORTER = 0.25  # a step that leads no nearer is tried again so much shorter


def tangents(
    control: Any, u: Values, v: Values, evaluator: Callable[..., Values] = evaluate
) -> tuple[Values, Values, Values]:
    """Points and their derivatives by u and by v, each ``(3, ...)``.

    evaluator : as of ``places_at``

    >>> square = jnp.array([[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[2.0, 0.0, 0.0], [2.0, 1.0, 0.0]]])
    >>> [x.tolist() for x in tangents(square, jnp.array(0.5), jnp.array(0.0))]
    [[1.0, 0.0, 0.0], [2.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """
    point, along_u = jax.jvp(lambda x: places_at(control, x, v, evaluator), (u,), (jnp.ones_like(u),))
    _, along_v = jax.jvp(lambda x: places_at(control, u, x, evaluator), (v,), (jnp.ones_like(v),))
    return point, along_u, along_v


def with_normals(control: Any, u: Values, v: Values) -> tuple[Values, Values]:
    """Points and unit normals ``(3, ...)``; normals are 0 where there is no tangent plane.

    >>> square = jnp.array([[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[2.0, 0.0, 0.0], [2.0, 1.0, 0.0]]])
    >>> with_normals(square, jnp.array(0.5), jnp.array(0.0))[1].tolist()
    [0.0, 0.0, 1.0]
    """
    point, along_u, along_v = tangents(control, u, v)
    return point, unit_normals(along_u, along_v)


def unit_normals(along_u: Values, along_v: Values) -> Values:
    """Of tangents ``(3, ...)``; 0 where they span no plane.

    >>> unit_normals(jnp.array([2.0, 0.0, 0.0]), jnp.array([1.0, 1.0, 0.0])).tolist()
    [0.0, 0.0, 1.0]
    """
    normal = jnp.cross(along_u, along_v, axis=0)
    square = jnp.sum(normal**2, axis=0)
    plane = square > _FLAT**2 * jnp.sum(along_u**2, axis=0) * jnp.sum(along_v**2, axis=0)
    return jnp.where(plane, normal / jnp.sqrt(jnp.where(plane, square, 1.0)), 0.0)


class Foot(NamedTuple):
    """The nearest point of a patch that was reached.

    square : of the distance
    beyond : how far outside of the patch the next step would lead; 0 if no side holds it back
    """

    u: Any
    v: Any
    square: Any
    beyond: Any


def nearest_foot(control: Any, points: Values, u: Values, v: Values, steps: int) -> Foot:
    """Nearest points of patches to ``(3, ...)`` by Gauss-Newton's method, beginning at u and v, each ``(...)``.

    Convergence is linear with a factor distance times curvature. Where a step would leave the patch it goes along the
    side; what is reached is never further away than what it began with.

    >>> square = jnp.array([[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[2.0, 0.0, 0.0], [2.0, 1.0, 0.0]]])
    >>> middle = jnp.array(0.5)
    >>> [x.tolist() for x in nearest_foot(square, jnp.array([0.5, 2.0, 1.0]), middle, middle, 2)]
    [0.25, 1.0, 2.0, 1.0]
    """

    def step(_: Any, state: Any) -> Any:
        u, v, square, share = state
        move_u, move_v, _ = _step(control, points, u, v)
        there = jnp.clip(u + share * move_u, 0.0, 1.0), jnp.clip(v + share * move_v, 0.0, 1.0)
        found = jnp.sum((points - places_at(control, *there)) ** 2, axis=0)
        nearer = found < square
        u, v, square = (jnp.where(nearer, new, old) for new, old in zip((*there, found), (u, v, square), strict=True))
        return u, v, square, jnp.where(nearer, 1.0, _SHORTER * share)

    square = jnp.sum((points - places_at(control, u, v)) ** 2, axis=0)
    # two at once: derivatives of two steps need no loop
    u, v, square, _ = jax.lax.fori_loop(0, steps, step, (u, v, square, jnp.ones_like(u)), unroll=2)
    return Foot(u, v, square, _step(control, points, u, v)[2])


def _step(control: Any, points: Values, u: Values, v: Values) -> tuple[Values, Values, Values]:
    """Gauss-Newton's step within the patch, and how far beyond it would go. No step where tangents are parallel."""
    here, p, q = tangents(control, u, v)
    left = points - here
    a, b, c = (jnp.sum(x * y, axis=0) for x, y in ((p, p), (p, q), (q, q)))
    x, y = jnp.sum(p * left, axis=0), jnp.sum(q * left, axis=0)
    determinant = a * c - b * b
    steep = determinant > _STEEP * a * c
    safe = jnp.where(steep, determinant, 1.0)
    step_u, step_v = jnp.where(steep, (c * x - b * y) / safe, 0.0), jnp.where(steep, (a * y - b * x) / safe, 0.0)
    out_u, out_v = (((t <= 0) & (d < 0)) | ((t >= 1) & (d > 0)) for t, d in ((u, step_u), (v, step_v)))
    beyond = jnp.maximum(jnp.where(out_u, jnp.abs(step_u), 0.0), jnp.where(out_v, jnp.abs(step_v), 0.0))
    alone_u, alone_v = (jnp.where(s > 0, r / jnp.where(s > 0, s, 1.0), 0.0) for r, s in ((x, a), (y, c)))
    move_u = jnp.where(out_u, 0.0, jnp.where(out_v, alone_u, step_u))
    move_v = jnp.where(out_v, 0.0, jnp.where(out_u, alone_v, step_v))
    return move_u, move_v, beyond
