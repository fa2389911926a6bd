"""What moves and makes patches, and what fits constants, in hard cases: the largest error beside sixty digits."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from slefejax import Samples, fit_km, linear_blend
from slefejax.conversion.scheme import convert
from slefejax.experiments.checks.reference import MP, exact
from slefejax.model.mesh import Mesh
from slefejax.model.skinning import Influences, dual_quaternion_blend

Errors = tuple[float, int]  # the largest error over the size of what is right, numbers that are not finite


def valence(value: float, dtype: Any) -> Errors:
    """The limit point that approximate Catmull-Clark patches share at an extraordinary vertex (docs/math.md, 7)."""
    n = int(value)
    angle, rng = np.arange(2 * n) * np.pi / n, np.random.default_rng(3)
    ring = np.column_stack([np.cos(angle), np.sin(angle), 0.3 * rng.normal(size=2 * n)])
    vertices = np.concatenate([rng.normal(size=(1, 3)) * 0.1, ring]).astype(dtype)
    faces = [[0, 1 + 2 * k, 2 + 2 * k, 1 + (2 * k + 2) % (2 * n)] for k in range(n)]
    work = convert(Mesh.of(vertices.astype(np.float64), faces), "acc").patchwork
    patches = np.asarray(work.patches(jnp.asarray(vertices)))
    at = exact(vertices)
    limit = (n * n * at[0] + 4 * at[1::2].sum(axis=0) + at[2::2].sum(axis=0)) / (n * n + 5 * n)
    corners = patches[:, [0, 0, -1, -1], [0, -1, 0, -1]].reshape(n, 4, 3).astype(np.float64)
    nearest = np.argmin(np.abs(corners - limit.astype(float)).sum(axis=2), axis=1)
    return _compared(corners[np.arange(n), nearest], np.broadcast_to(limit, (n, 3)))


def half_turn(value: float, dtype: Any) -> Errors:
    """A vertex between two bones, of which one turns by an angle: dual quaternions take it halfway round."""
    turn = MP.mpf(value) * MP.pi / 180
    c, s = float(MP.cos(turn)), float(MP.sin(turn))
    transforms = np.zeros((2, 3, 4))
    transforms[:, :, :3] = np.eye(3), [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]]
    influences = Influences.of([[0, 1]], [[1.0, 1.0]], 2)
    rest = np.array([[1.0, 0.0, 0.0]])
    found = dual_quaternion_blend(jnp.asarray(rest, dtype), jnp.asarray(transforms, dtype), influences)
    ways = [np.array([[MP.cos(turn / 2), sign * MP.sin(turn / 2), MP.mpf(0)]], object) for sign in (1, -1)]
    # at 180 degrees both ways round are right
    return min(_compared(np.asarray(found), way) for way in (ways if value == 180.0 else ways[:1]))


def small_weights(value: float, dtype: Any) -> Errors:
    """Vertices between bones whose weights are all tiny, or one tiny beside 1: they are divided by their sum."""
    rng = np.random.default_rng(4)
    transforms, rest = rng.normal(size=(3, 3, 4)), rng.normal(size=(4, 3))
    weights = np.array([[1, value, value], [value, 2 * value, 3 * value], [1, 1, value], [value, value, 0.0]])
    influences = Influences.of(np.tile([0, 1, 2], (4, 1)), weights, 3)
    found = linear_blend(jnp.asarray(rest, dtype), jnp.asarray(transforms, dtype), influences)
    matrices, points, shares = exact(transforms.astype(dtype)), exact(rest.astype(dtype)), exact(weights)
    blended = np.tensordot(shares / shares.sum(axis=1)[:, None], matrices, (1, 0))
    wanted = (blended[:, :, :3] * points[:, None]).sum(axis=2) + blended[:, :, 3]
    return _compared(np.asarray(found), wanted)


def stiff_loss(value: float, dtype: Any) -> Errors:
    """k_m by the smoothed pinball loss at a temperature, samples over eight decades, beside the plain quantile."""
    rng = np.random.default_rng(5)
    needed = 10.0 ** rng.uniform(0.0, 8.0, 2000)
    term, n = (needed / rng.uniform(0.8, 1.4, 2000)) ** 2, np.zeros(2000, int)
    samples = Samples(n, n, np.ceil(needed).astype(int), needed, {"slefe 3": term}, 0.5)
    with jax.enable_x64(dtype == np.float64):
        fit = fit_km(samples, 3, target=0.95, temperature=value)
    wanted = np.quantile(needed / np.sqrt(term), 0.95, method="higher")
    return _compared(np.array([fit.k if fit.converged else np.nan]), exact([wanted]))


def _compared(found: np.ndarray, wanted: np.ndarray) -> Errors:
    fine = np.isfinite(found)
    error = np.abs(exact(np.where(fine, found, 0.0)) - wanted)
    size = np.abs(wanted).max()
    return float(np.max(np.where(fine, error / size, 0.0))), int(np.sum(~fine))


MEASURES: dict[str, Callable[[float, Any], Errors]] = {
    "valence": valence,
    "half turn": half_turn,
    "small weights": small_weights,
    "stiff loss": stiff_loss,
}
