"""By how much normals of neighbouring patches differ along the edges that they share."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from slefejax.arguments import check_patches, on_host
from slefejax.geometry.evaluate import as_control, evaluate

_PLACES = 33  # along an edge
_AT_A_TIME = 8192  # edges
_FLAT = 1e-9  # sine of an angle between tangents: below, there is no tangent plane


def normal_jumps(patches: Any, sides: Int[np.ndarray, "edges 2 2"]) -> Float[np.ndarray, "edges"]:
    """The largest angle, in degrees, between tangent planes on both sides of edges, of 33 places along each.

    patches : polynomial ones, Bézier or Gregory
    sides   : (patch, side) on both sides of every edge, sides u=0, v=0, u=1, v=1; a scene's are
              ``scene.conversion.smooth_sides``

    Ends of edges are left out, and places where a patch has no tangent plane.

    >>> flat = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)[None]
    >>> roof = flat * [1.0, 1.0, 0.0] + [1.0, 0.0, 0.0] + (flat[..., :1]) * [0.0, 0.0, 1.0]
    >>> normal_jumps(np.concatenate([flat, roof]), np.array([[[0, 2], [1, 0]]])).round(6).tolist()
    [45.0]
    """
    control = on_host(check_patches(patches, dims=(3,), gregory=True))
    if not len(sides):
        return np.zeros(0)
    if len(sides) > _AT_A_TIME:
        parts = range(0, len(sides), _AT_A_TIME)
        return np.concatenate([normal_jumps(patches, sides[k : k + _AT_A_TIME]) for k in parts])
    (one, n), (other, m) = (_side(control[sides[:, k, 0]], sides[:, k, 1]) for k in (0, 1))
    there, back = (np.abs(one - other[:, ::step]).max(axis=(1, 2)) for step in (1, -1))
    m = np.where((there <= back)[:, None, None], m, m[:, ::-1])
    angle = np.arctan2(np.linalg.norm(np.cross(n, m), axis=-1), np.abs(np.sum(n * m, axis=-1)))
    return np.degrees(angle.max(axis=1))


def points_and_normals(patches: Any, parameters: Float[np.ndarray, "patches places 2"]) -> tuple[Any, Any]:
    """Points and unit normals ``(patches, places, 3)`` of polynomial patches, each at parameters of its own; by NumPy.

    Normals are 0 where a patch has no tangent plane.

    >>> flat = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)[None]
    >>> points_and_normals(flat, np.array([[[0.5, 0.25]]]))[1].tolist()
    [[[0.0, 0.0, 1.0]]]
    """
    control = jax.tree.map(
        lambda x: np.moveaxis(np.asarray(x, np.float64), 0, -1)[..., None], as_control(on_host(patches))
    )
    with jax.enable_x64(True):
        found = _normals_jit(control, *np.moveaxis(np.asarray(parameters, np.float64), -1, 0))
    points, normals = (np.moveaxis(np.asarray(x), 0, -1) for x in found)
    return points, normals


def _side(patches: Any, side: np.ndarray) -> tuple[Any, Any]:
    """Points and normals along a side of each patch."""
    t = (np.arange(_PLACES) + 0.5) / _PLACES
    u = np.where((side % 2 == 1)[:, None], t, np.where((side == 0)[:, None], 0.0, 1.0))
    v = np.where((side % 2 == 0)[:, None], t, np.where((side == 1)[:, None], 0.0, 1.0))
    return points_and_normals(patches, np.stack([u, v], axis=-1))


@jax.jit
def _normals_jit(control: Any, u: Any, v: Any) -> tuple[Any, Any]:
    point, along_u = jax.jvp(lambda x: evaluate(control, x, v), (u,), (jnp.ones_like(u),))
    _, along_v = jax.jvp(lambda x: evaluate(control, u, x), (v,), (jnp.ones_like(v),))
    normal = jnp.cross(along_u, along_v, axis=0)
    square = jnp.sum(normal**2, axis=0)
    plane = square > _FLAT**2 * jnp.sum(along_u**2, axis=0) * jnp.sum(along_v**2, axis=0)
    return point, jnp.where(plane, normal / jnp.sqrt(jnp.where(plane, square, 1.0)), 0.0)
