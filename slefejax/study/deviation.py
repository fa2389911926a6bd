"""How far patches have come from other ones: distances of surfaces, turns of their tangent planes."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float

from slefejax.arguments import Patches, check_patches, is_whole, on_device, on_host
from slefejax.errors import InputError
from slefejax.geometry.evaluate import beside_places, places_at
from slefejax.geometry.tangents import nearest_foot, with_normals
from slefejax.measure.jumps import side_places

_PLACES = 33  # along each side
_AT_A_TIME = 16  # patches
_NEAREST = 16  # steps towards the nearest point


def surface_distance(patches: Patches, given: Patches, places: int = _PLACES) -> Float[np.ndarray, "patches"]:
    """How far each patch lies from the one of the same number that was given: the largest over a grid of places.

    From every point of the grid on the patch Newton's method looks for the nearest point of the other, beginning at the
    same parameters; what it finds is no nearer than the nearest there is, so distances are not understated at the
    places themselves. Polynomial patches, Bézier or Gregory, also one of each; scene units.

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
    neighbours that are smooth across their edge turn against each other by at most the sum of both. Polynomial patches,
    Bézier or Gregory.
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


def distance_squares(patches: Any, given: Any, places: int, steps: int) -> Array:
    """Squares of distances ``(patches, places^2)`` between points of patches and the nearest ones of those given.

    Differentiable; steps : towards the nearest point, from the same parameters
    """
    t = np.linspace(0.0, 1.0, places)
    u, v = _both(np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1), patches)
    points = places_at(beside_places(patches), u, v)
    u, v = (jnp.broadcast_to(x, points.shape[1:]) for x in (u, v))
    return nearest_foot(beside_places(given), points, u, v, steps).square


def turn_squares(patches: Any, given: Any, places: int) -> Array:
    """(2 sin(a / 2))^2 for the angles a of ``side_turns``, ``(patches, 4 places)``, as differences of unit normals.

    0 where the given patch has no tangent plane, 4 where only the other one has none. Differentiable.
    """
    n, m = _normals(patches, given, side_places(places))
    flat, lost = (jnp.all(x == 0, axis=0) for x in (m, n))
    return jnp.where(flat, 0.0, jnp.where(lost, 4.0, jnp.sum((n - m) ** 2, axis=0)))


def _unfolded(patches: Any, given: Any, places: int) -> Array:
    t = (np.arange(places) + 0.5) / places
    n, m = _normals(patches, given, np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1))
    return jnp.all((jnp.sum(n * m, axis=0) > 0) | jnp.all(m == 0, axis=0), axis=-1)


_unfolded_jit = partial(jax.jit, static_argnums=2)(_unfolded)


@partial(jax.jit, static_argnums=(2, 3))
def _largest_jit(patches: Any, given: Any, places: int, steps: int) -> Array:
    """The largest square of a distance of each patch; few patches at a time, as there are many places."""

    def of_one(both: Any) -> Array:
        one, other = jax.tree.map(lambda x: x[None], both)
        return jnp.max(distance_squares(one, other, places, steps))

    return jax.lax.map(of_one, (patches, given), batch_size=_AT_A_TIME)


_turns_jit = partial(jax.jit, static_argnums=2)(turn_squares)


def _alike(patches: Patches, given: Patches) -> tuple[Any, Any]:
    both = [check_patches(own, gregory=True) for own in (patches, given)]
    if len(both[0]) != len(both[1]):
        raise InputError(f"there are {len(both[0])} patches and {len(both[1])} to compare them with")
    if not all(np.isfinite(x).all() for x in jax.tree.leaves([on_host(own) for own in both])):
        raise InputError("patches that are compared must have finite control points")
    return on_device(both[0]), on_device(both[1])


def _normals(patches: Any, given: Any, parameters: np.ndarray) -> list[Array]:
    """Unit normals ``(3, patches, places)`` of both at parameters ``(..., 2)``; 0 where there is no tangent plane."""
    u, v = _both(parameters, patches)
    return [with_normals(beside_places(own), u, v)[1] for own in (patches, given)]


def _both(parameters: np.ndarray, patches: Any) -> Array:
    """u and v, each ``(places,)``, in the precision of the patches."""
    return jnp.asarray(parameters.reshape(-1, 2).T, patches.dtype)
