"""How far patches have come from other ones: distances of surfaces, turns of their tangent planes."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from slefejax.arguments import Patches, check_patches, is_whole
from slefejax.errors import InputError
from slefejax.geometry.bezier import evaluate_patch
from slefejax.tessellator.edges import check_edge_numbers

_PLACES = 33  # along each side
_AT_A_TIME = 16  # patches
_NEAREST = 16  # steps towards the nearest point
_FLAT = 1e-9  # sine of an angle between tangents: below, there is no tangent plane


def surface_distance(patches: Patches, given: Patches, places: int = _PLACES) -> Float[np.ndarray, "patches"]:
    """How far each patch lies from the one of the same number that was given: the largest over a grid of places.

    From every point of the grid on the patch Newton's method looks for the nearest point of the other, beginning at the
    same parameters; what it finds is no nearer than the nearest there is, so distances are not understated at the
    places themselves. Polynomial patches; scene units.

    >>> flat = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)[None]
    >>> surface_distance(flat + [0.0, 0.0, 0.25], flat, places=3).round(9).tolist()
    [0.25]
    """
    patches, given = _alike(patches, given)
    if not is_whole(places, 2):
        raise InputError(f"places must be a whole number of at least 2, not {places!r}")
    return np.sqrt(np.asarray(_largest_jit(patches, given, places, _NEAREST)))


def side_turns(patches: Patches, given: Patches, places: int = _PLACES) -> Float[np.ndarray, "patches"]:
    """By how many degrees the tangent plane of a patch turned from the given one, at equal parameters on its sides.

    The largest over places along the four sides, but corners and where the given one has no tangent plane. Two
    neighbours that are smooth across their edge turn against each other by at most the sum of both. Polynomial.
    """
    patches, given = _alike(patches, given)
    squares = np.asarray(_turns_jit(patches, given, places))
    return np.degrees(2.0 * np.arcsin(np.minimum(0.5 * np.sqrt(np.max(squares, axis=1)), 1.0)))


def unfolded(patches: Patches, given: Patches, places: int = _PLACES) -> np.ndarray:
    """Which patches ``(patches,)`` have normals within 90 degrees of the given ones, at equal parameters inside.

    >>> flat = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)[None]
    >>> unfolded(flat, flat, places=3).tolist(), unfolded(flat[:, ::-1], flat, places=3).tolist()
    ([True], [False])
    """
    patches, given = _alike(patches, given)
    return np.asarray(_unfolded_jit(patches, given, places))


def edge_turns(patches: Patches, edge_numbers: Int[np.ndarray, "patches 4"]) -> Float[np.ndarray, "shared"]:
    """Angles, in degrees, by which the tangent plane turns from a patch to its neighbour: the largest along each edge.

    patches      : polynomial;  edge_numbers : from ``slefejax.tessellator.edges.shared_edges``

    Of edges that exactly two patches share; corners are left out, and places where a patch has no tangent plane.

    >>> from slefejax.tessellator.edges import shared_edges
    >>> flat = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)[None]
    >>> roof = flat * [1.0, 1.0, 0.0] + [1.0, 0.0, 0.0] + (flat[..., :1]) * [0.0, 0.0, 1.0]
    >>> both = np.concatenate([flat, roof])
    >>> edge_turns(both, shared_edges(both)).round(6).tolist()
    [45.0]
    """
    control = jnp.asarray(check_patches(patches, dims=(3,)))
    sides = [_points_and_normals(control, u, v) for u, v in _sides(_PLACES)]
    points, normals = (np.moveaxis(np.asarray([side[k] for side in sides]), 1, -1) for k in (0, 1))
    by_number: dict[int, list[tuple[int, int]]] = {}
    for (patch, side), number in np.ndenumerate(check_edge_numbers(edge_numbers, len(control))):
        by_number.setdefault(int(number), []).append((side, patch))
    turns = [_turn(points, normals, *pair) for pair in by_number.values() if len(pair) == 2]
    return np.array(turns, np.float64)


def distance_squares(patches: Array | np.ndarray, given: Array | np.ndarray, places: int, steps: int) -> Array:
    """Squares of distances ``(patches, places^2)`` between points of patches and the nearest ones of those given.

    Differentiable; steps : towards the nearest point, from the same parameters
    """
    t = np.linspace(0.0, 1.0, places)
    u, v = (x.ravel().astype(patches.dtype) for x in np.meshgrid(t, t, indexing="ij"))
    point = _surface(patches, u, v)
    u, v = (jnp.broadcast_to(x, point.shape[1:]) for x in (u, v))
    square, share = jnp.sum((point - _surface(given, u, v)) ** 2, axis=0), jnp.ones_like(u)
    for _ in range(steps):
        step_u, step_v = _step(given, point, u, v)
        there = jnp.clip(u + share * step_u, 0.0, 1.0), jnp.clip(v + share * step_v, 0.0, 1.0)
        found = jnp.sum((point - _surface(given, *there)) ** 2, axis=0)
        nearer = found < square
        u, v, square = (jnp.where(nearer, new, old) for new, old in zip((*there, found), (u, v, square), strict=True))
        share = jnp.where(nearer, 1.0, 0.25 * share)
    return square


def turn_squares(patches: Array | np.ndarray, given: Array | np.ndarray, places: int) -> Array:
    """(2 sin(a / 2))^2 for the angles a of ``side_turns``, ``(patches, 4 places)``, as differences of unit normals.

    0 where the given patch has no tangent plane, 4 where only the other one has none. Differentiable.
    """
    found = []
    for u, v in _sides(places):
        (_, n), (_, m) = _points_and_normals(patches, u, v), _points_and_normals(given, u, v)
        flat, lost = (jnp.all(x == 0, axis=0) for x in (m, n))
        found.append(jnp.where(flat, 0.0, jnp.where(lost, 4.0, jnp.sum((n - m) ** 2, axis=0))))
    return jnp.concatenate(found, axis=-1)


def _unfolded(patches: Array | np.ndarray, given: Array | np.ndarray, places: int) -> Array:
    t = (np.arange(places) + 0.5) / places
    u, v = (x.ravel() for x in np.meshgrid(t, t, indexing="ij"))
    (_, n), (_, m) = _points_and_normals(patches, u, v), _points_and_normals(given, u, v)
    return jnp.all((jnp.sum(n * m, axis=0) > 0) | jnp.all(m == 0, axis=0), axis=-1)


_unfolded_jit = partial(jax.jit, static_argnums=2)(_unfolded)


@partial(jax.jit, static_argnums=(2, 3))
def _largest_jit(patches: Array | np.ndarray, given: Array | np.ndarray, places: int, steps: int) -> Array:
    """The largest square of a distance of each patch; few patches at a time, as there are many places."""

    def of_one(both: tuple[Any, Any]) -> Array:
        one, other = both
        return jnp.max(distance_squares(one[None], other[None], places, steps))

    return jax.lax.map(of_one, (patches, given), batch_size=_AT_A_TIME)


_turns_jit = partial(jax.jit, static_argnums=2)(turn_squares)


def _alike(patches: Patches, given: Patches) -> tuple[Any, Any]:
    patches, given = check_patches(patches, dims=(3,)), check_patches(given, dims=(3,))
    if patches.shape[0] != given.shape[0]:
        raise InputError(f"there are {patches.shape[0]} patches and {given.shape[0]} to compare them with")
    if not (np.isfinite(np.asarray(patches)).all() and np.isfinite(np.asarray(given)).all()):
        raise InputError("patches that are compared must have finite control points")
    return jnp.asarray(patches), jnp.asarray(given)


def _sides(places: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Parameters (u, v) of places inside of the four sides, in OpenGL's order."""
    t = (np.arange(places) + 0.5) / places
    zero, one = np.zeros(places), np.ones(places)
    return [(zero, t), (t, zero), (one, t), (t, one)]


def _points_and_normals(control: Array | np.ndarray, u: Any, v: Any) -> tuple[Any, Any]:
    """Points and unit normals ``(3, patches, places)``; normals 0 where there is no tangent plane."""
    u, v = jnp.asarray(u, control.dtype), jnp.asarray(v, control.dtype)
    point, along_u, along_v = _derivatives(control, u, v)
    normal = jnp.cross(along_u, along_v, axis=0)
    square = jnp.sum(normal**2, axis=0)
    plane = square > _FLAT**2 * jnp.sum(along_u**2, axis=0) * jnp.sum(along_v**2, axis=0)
    return point, jnp.where(plane, normal / jnp.sqrt(jnp.where(plane, square, 1.0)), 0.0)


def _turn(points: np.ndarray, normals: np.ndarray, one: tuple[int, int], other: tuple[int, int]) -> float:
    """The largest angle along an edge that two patches share, whichever way each runs along it."""
    there, back = (np.abs(points[one] - points[other][::step]).max() for step in (1, -1))
    n, m = normals[one], normals[other][:: 1 if there <= back else -1]
    angle = np.arctan2(np.linalg.norm(np.cross(n, m), axis=-1), np.abs(np.sum(n * m, axis=-1)))
    return float(np.degrees(angle.max()))


def _step(given: Array | np.ndarray, point: Array | np.ndarray, u: Any, v: Any) -> tuple[Any, Any]:
    """Gauss-Newton's step of the parameters towards the nearest point, along a side where it would leave the patch.

    0 where tangents are parallel.
    """
    here, along_u, along_v = _derivatives(given, u, v)
    left = point - here
    a, b, c = (jnp.sum(p * q, axis=0) for p, q in ((along_u, along_u), (along_u, along_v), (along_v, along_v)))
    x, y = jnp.sum(along_u * left, axis=0), jnp.sum(along_v * left, axis=0)
    determinant = a * c - b * b
    steep = determinant > _FLAT * a * c
    safe = jnp.where(steep, determinant, 1.0)
    step_u, step_v = jnp.where(steep, (c * x - b * y) / safe, 0.0), jnp.where(steep, (a * y - b * x) / safe, 0.0)
    out_u, out_v = (((t <= 0) & (d < 0)) | ((t >= 1) & (d > 0)) for t, d in ((u, step_u), (v, step_v)))
    alone_u, alone_v = (jnp.where(p > 0, r / jnp.where(p > 0, p, 1.0), 0.0) for r, p in ((x, a), (y, c)))
    return (
        jnp.where(out_u, 0.0, jnp.where(out_v, alone_u, step_u)),
        jnp.where(out_v, 0.0, jnp.where(out_u, alone_v, step_v)),
    )


def _derivatives(control: Array | np.ndarray, u: Any, v: Any) -> tuple[Any, Any, Any]:
    """Points and both first derivatives, each ``(3, patches, places)``."""
    ones = jnp.ones_like(u)
    point, along_u = jax.jvp(lambda t: _surface(control, t, v), (u,), (ones,))
    _, along_v = jax.jvp(lambda t: _surface(control, u, t), (v,), (ones,))
    return point, along_u, along_v


def _surface(control: Array | np.ndarray, u: Any, v: Any) -> Array:
    """Points ``(3, patches, places)``."""
    return evaluate_patch(jnp.moveaxis(control, 0, -1)[..., None], u, v)
