"""Nearest points on a surface that many bicubic patches make up, to rounding, in float64.

A tree of samples says which patches may hold the nearest point, and Gauss-Newton's method finds it in each of them,
along a side where it would leave the patch. Convergence is linear with a factor distance times curvature, which is
tiny where a surface is compared with one that approximates it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from slefejax.geometry.bezier import derivative, evaluate_patch
from slefejax.late import one_at_a_time

_SAMPLES = 4  # along each side of a patch: its tree has their squares
_CANDIDATES = 8  # samples, the patches of which are tried
_STEPS = 10  # of Gauss-Newton's method
_AT_A_TIME = 8192  # points; the compiled program is for so many
_ORTHOGONAL = 1e-6  # of the distance: what is left along the tangents where a nearest point is found
_FLAT = 1e-12  # sine of an angle between tangents


@dataclass(frozen=True)
class Feet:
    """Nearest points.

    points     : ``(points, 3)``, on the surface;  distance : ``(points,)``, how far they are from those asked for
    patch      : ``(points,)``, where they lie, and at which ``parameters``, ``(points, 2)``
    """

    points: Float[np.ndarray, "points 3"]
    distance: Float[np.ndarray, "points"]
    patch: Int[np.ndarray, "points"]
    parameters: Float[np.ndarray, "points 2"]


class Surfaces:
    """Bicubic patches among which nearest points are looked for.

    net : ``(patches, 4, 4, 3)``, polynomial

    >>> line = np.arange(4) / 3.0
    >>> x, y = np.meshgrid(line, line, indexing="ij")
    >>> square = Surfaces(np.stack([x, y, 0 * x], axis=-1)[None])
    >>> found = square.nearest(np.array([[0.25, 0.5, 2.0], [2.0, 0.5, 0.0]]))
    >>> found.points.round(9).tolist(), found.distance.round(9).tolist()
    ([[0.25, 0.5, 0.0], [1.0, 0.5, 0.0]], [2.0, 1.0])
    """

    def __init__(self, net: Float[np.ndarray, "patches 4 4 3"]) -> None:
        self.net = np.asarray(net, np.float64)

    @cached_property
    def _tree(self) -> Any:
        """Of samples inside of patches, patch after patch."""
        with one_at_a_time:
            from scipy.spatial import cKDTree  # slow to import

        u, v = _grid()
        samples = evaluate_patch(np.moveaxis(self.net, 0, -1)[..., None], u, v)
        return cKDTree(samples.reshape(3, -1).T)

    def at(
        self, patch: Int[np.ndarray, "points"], parameters: Float[np.ndarray, "points 2"]
    ) -> Float[np.ndarray, "points 3"]:
        """Points at parameters (u, v) of patches."""
        net = np.moveaxis(self.net[patch], 0, -1)
        return evaluate_patch(net, parameters[:, 0], parameters[:, 1]).T

    def nearest(self, points: Float[np.ndarray, "points 3"]) -> Feet:
        """The nearest point of the whole surface to each of these."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        parts = [self._nearest(points[k : k + _AT_A_TIME]) for k in range(0, len(points), _AT_A_TIME)]
        patch, parameters = (np.concatenate([part[k] for part in parts]) for k in (0, 1))
        found = self.at(patch, parameters)
        return Feet(found, np.linalg.norm(points - found, axis=1), patch, parameters)

    def _nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        count = min(_CANDIDATES, len(self.net) * _SAMPLES**2)
        samples = self._tree.query(points, k=count)[1].reshape(len(points), count)
        candidates = samples // _SAMPLES**2
        start = np.stack(_grid(), axis=1)[samples % _SAMPLES**2]
        patch, (parameters, square, sound) = candidates[:, 0].copy(), self._feet(points, candidates[:, 0], start[:, 0])
        for k in range(1, count):
            # where the foot left its patch, those of the other samples may have it
            again = np.flatnonzero(~sound & (candidates[:, k, None] != candidates[:, :k]).all(axis=1))
            if not again.size:
                continue
            own = self._feet(points[again], candidates[again, k], start[again, k])
            better = own[1] < square[again]
            at = again[better]
            patch[at] = candidates[at, k]
            for kept, new in zip((parameters, square, sound), own, strict=True):
                kept[at] = new[better]
        return patch, parameters

    def _feet(self, points: np.ndarray, patch: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, ...]:
        """Parameters, squares of distances, and whether nothing is left along the tangents."""
        count = len(points)
        room = 1 << max(6, (count - 1).bit_length())
        fill = lambda x: np.concatenate([x, np.repeat(x[:1], room - count, axis=0)])  # noqa: E731
        with jax.enable_x64(True):
            net = np.moveaxis(self.net[fill(patch)], 0, -1)
            found = _feet_jit(net, fill(points).T, fill(start).T)
        u, v, square, left = (np.asarray(x)[:count] for x in found)
        return np.stack([u, v], axis=1), square.copy(), left <= _ORTHOGONAL


def _grid() -> tuple[np.ndarray, np.ndarray]:
    t = (np.arange(_SAMPLES) + 0.5) / _SAMPLES
    u, v = np.meshgrid(t, t, indexing="ij")
    return u.ravel(), v.ravel()


@jax.jit
def _feet_jit(net: Any, points: Any, start: Any) -> Any:
    """u, v, square of the distance, and what is left along the tangents over the distance."""
    along_u, along_v = derivative(net), jnp.swapaxes(derivative(jnp.swapaxes(net, 0, 1)), 0, 1)

    def step(_: Any, state: Any) -> Any:
        u, v, square, share = state
        left, move_u, move_v, _ = _step(net, along_u, along_v, points, u, v)
        there = jnp.clip(u + share * move_u, 0.0, 1.0), jnp.clip(v + share * move_v, 0.0, 1.0)
        found = jnp.sum((points - evaluate_patch(net, *there)) ** 2, axis=0)
        nearer = found < square
        u, v, square = (jnp.where(nearer, new, old) for new, old in zip((*there, found), (u, v, square), strict=True))
        return u, v, square, jnp.where(nearer, 1.0, 0.25 * share)

    u, v = start
    square = jnp.sum((points - evaluate_patch(net, u, v)) ** 2, axis=0)
    u, v, square, _ = jax.lax.fori_loop(0, _STEPS, step, (u, v, square, jnp.ones_like(u)))
    return u, v, square, _step(net, along_u, along_v, points, u, v)[3]


def _step(net: Any, along_u: Any, along_v: Any, points: Any, u: Any, v: Any) -> tuple[Any, Any, Any, Any]:
    """What is left, Gauss-Newton's step within the patch, and how far outside the patch the step would like to go.

    The last one is 0 if nothing holds the foot at the side of its patch.
    """
    left = points - evaluate_patch(net, u, v)
    p, q = evaluate_patch(along_u, u, v), evaluate_patch(along_v, u, v)
    a, b, c = (jnp.sum(x * y, axis=0) for x, y in ((p, p), (p, q), (q, q)))
    x, y = jnp.sum(p * left, axis=0), jnp.sum(q * left, axis=0)
    determinant = a * c - b * b
    steep = determinant > _FLAT * a * c
    safe = jnp.where(steep, determinant, 1.0)
    step_u, step_v = jnp.where(steep, (c * x - b * y) / safe, 0.0), jnp.where(steep, (a * y - b * x) / safe, 0.0)
    out_u, out_v = (((t <= 0) & (d < 0)) | ((t >= 1) & (d > 0)) for t, d in ((u, step_u), (v, step_v)))
    held = jnp.maximum(jnp.where(out_u, jnp.abs(step_u), 0.0), jnp.where(out_v, jnp.abs(step_v), 0.0))
    alone_u, alone_v = (jnp.where(s > 0, r / jnp.where(s > 0, s, 1.0), 0.0) for r, s in ((x, a), (y, c)))
    move_u = jnp.where(out_u, 0.0, jnp.where(out_v, alone_u, step_u))
    move_v = jnp.where(out_v, 0.0, jnp.where(out_u, alone_v, step_v))
    return left, move_u, move_v, held
