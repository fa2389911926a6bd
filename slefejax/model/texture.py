"""Texture coordinates: of corners of faces, and of patches, whose corners have them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from slefejax.model.mesh import Mesh


def together(parts: Sequence[np.ndarray | None], counts: Sequence[int]) -> Float[np.ndarray, "corners 2"] | None:
    """Coordinates of so many corners each, one after the other: NaN for parts without, None if no part has any.

    >>> together([None, np.ones((1, 2))], [1, 1]).tolist()
    [[nan, nan], [1.0, 1.0]]
    """
    if all(part is None for part in parts):
        return None
    return np.concatenate(
        [np.full((count, 2), np.nan) if part is None else part for part, count in zip(parts, counts, strict=True)]
    )


def refined_texture(mesh: Mesh) -> Float[np.ndarray, "finer 2"] | None:
    """Coordinates after a step of Catmull-Clark subdivision, by the linear rules: those of corners stay.

    Four for every corner, as ``slefejax.conversion.catmull_clark`` has its quad: its own, the middle of the edge behind
    it, the mean of the face, the middle of the edge before it. None without any.
    """
    if mesh.texture is None:
        return None
    own = mesh.texture
    mean = np.add.reduceat(own, mesh.offsets[:-1]) / mesh.sizes[:, None]
    behind = 0.5 * (own + own[mesh.next_corner])
    return np.stack([own, behind, mean[mesh.face], behind[mesh.prev_corner]], axis=1).reshape(-1, 2)


def texture_at(
    coordinates: Float[np.ndarray, "patches 2 2 2"],
    patch: Int[np.ndarray, "*points"],
    u: Float[np.ndarray, "*points"],
    v: Float[np.ndarray, "*points"],
) -> Float[np.ndarray, "*points 2"]:
    """Coordinates at parameters of patches, float64: bilinear between those of the corners.

    coordinates : of the corners, as ``Scene.texture_coordinates`` has them

    >>> corners = np.array([[[[0, 0], [0, 1]], [[1, 0], [1, 1]]]], float)
    >>> texture_at(corners, np.array([0]), np.array([0.25]), np.array([0.5])).tolist()
    [[0.25, 0.5]]
    """
    u, v = (np.asarray(x, np.float64)[..., None] for x in (u, v))
    own = coordinates[patch]
    low, high = ((1.0 - v) * own[..., k, 0, :] + v * own[..., k, 1, :] for k in (0, 1))
    return (1.0 - u) * low + u * high
