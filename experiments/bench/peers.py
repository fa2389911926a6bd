"""The same computations in plain NumPy, once as one would first write them, once with the patches last and unrolled."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np

from slefejax.bounds.slefe import slefe_table
from slefejax.geometry.bezier import bernstein
from slefejax.geometry.projection import Projection
from slefejax.model.skinning import Influences

Pair = tuple[Any, Any]


def plain_boxes(patches: np.ndarray, segments: int) -> Pair:
    """Slefe boxes ``(patches, m+1, m+1, 3)``: bounds in v, then bounds of these in u, by products of small matrices."""
    lower, upper = _plain_bounds(patches, segments)
    lower, upper = (np.swapaxes(bound, 1, 2) for bound in (lower, upper))
    return (
        np.swapaxes(_plain_bounds(lower, segments)[0], 1, 2),
        np.swapaxes(_plain_bounds(upper, segments)[1], 1, 2),
    )


def _plain_bounds(c: np.ndarray, segments: int) -> Pair:
    """Along the last but one axis ([YBP12], (2))."""
    low, up = (table.T.astype(c.dtype) for table in slefe_table(c.shape[-2] - 1, segments))
    t = np.arange(segments + 1, dtype=c.dtype)[:, None] / c.dtype.type(segments)
    difference = c[..., :-2, :] - 2 * c[..., 1:-1, :] + c[..., 2:, :]
    positive, negative = np.maximum(difference, 0), np.minimum(difference, 0)
    chord = np.concatenate([1 - t, t], axis=1) @ c[..., [0, -1], :]
    return chord + low @ positive + up @ negative, chord + up @ positive + low @ negative


def plain_factors(boxes: Pair, projection: Projection, tolerance: float, segments: int) -> np.ndarray:
    """Factors from boxes ([YBP12], (7) to (10)), eight corners of each in an array ``(patches, m+1, m+1, 8, 4)``."""
    lower, upper = boxes
    corners = np.stack([np.where(choice, upper, lower) for choice in product((False, True), repeat=3)], axis=-2)
    corners = np.concatenate([corners, np.ones_like(corners[..., :1])], axis=-1)
    clip = corners @ np.asarray(projection.to_pixels).T
    place = clip[..., :2] / np.maximum(clip[..., 3:], np.asarray(projection.near_w))
    width = np.max(np.max(place, axis=-2) - np.min(place, axis=-2), axis=-1)
    reach = np.max(corners @ np.asarray(projection.frustum).T, axis=-2)
    inside = np.min(_tile_maxima(reach), axis=-1) >= 0
    widest = np.max(np.where(inside, _tile_maxima(width), 0), axis=(1, 2))
    factor = np.maximum(segments * np.sqrt(widest / lower.dtype.type(tolerance)), 1)
    return np.where(inside.any(axis=(1, 2)), factor, 0)


def _tile_maxima(values: np.ndarray) -> np.ndarray:
    along = np.maximum(values[:, :-1], values[:, 1:])
    return np.maximum(along[:, :, :-1], along[:, :, 1:])


def unrolled_factors(packed: np.ndarray, projection: Projection, tolerance: float, segments: int) -> np.ndarray:
    """The same of control points ``(4, 4, 3, patches)``: arrays ``(3, patches)`` or ``(patches,)``, one a number."""
    nu, nv = packed.shape[:2]
    across = [_unrolled_bounds([packed[i, j] for j in range(nv)], segments) for i in range(nu)]
    pieces = range(segments + 1)
    columns = [
        (
            _unrolled_bounds([across[i][0][k] for i in range(nu)], segments)[0],
            _unrolled_bounds([across[i][1][k] for i in range(nu)], segments)[1],
        )
        for k in pieces
    ]
    boxes = [[(columns[k][0][j], columns[k][1][j]) for k in pieces] for j in pieces]
    widths = [[_unrolled_width(low, up, projection) for low, up in row] for row in boxes]
    frustum = np.asarray(projection.frustum)
    reach = [[[_reach(plane, low, up) for low, up in row] for row in boxes] for plane in frustum]
    inside = [_unrolled_tiles(net) for net in reach]
    least = [np.minimum.reduce(parts) for parts in zip(*inside, strict=True)]
    tiles = [np.where(a >= 0, b, 0) for a, b in zip(least, _unrolled_tiles(widths), strict=True)]
    factor = np.maximum(segments * np.sqrt(np.maximum.reduce(tiles) / packed.dtype.type(tolerance)), 1)
    return np.where(np.maximum.reduce(least) >= 0, factor, 0)


def _unrolled_bounds(c: list[np.ndarray], segments: int) -> tuple[list[np.ndarray], list[np.ndarray]]:
    kind = c[0].dtype.type
    low, up = slefe_table(len(c) - 1, segments)
    differences = [a - kind(2) * b + d for a, b, d in zip(c, c[1:], c[2:], strict=False)]
    positive = [np.maximum(x, 0) for x in differences]
    negative = [np.minimum(x, 0) for x in differences]
    lower, upper = [], []
    for k in range(segments + 1):
        below = above = kind(1 - k / segments) * c[0] + kind(k / segments) * c[-1]
        for p, n, a, b in zip(positive, negative, low[:, k], up[:, k], strict=True):
            below = below + (kind(a) * p + kind(b) * n)
            above = above + (kind(b) * p + kind(a) * n)
        lower.append(below)
        upper.append(above)
    return lower, upper


def _unrolled_width(low: np.ndarray, up: np.ndarray, projection: Projection) -> np.ndarray:
    matrix, near = np.asarray(projection.to_pixels), np.asarray(projection.near_w)
    parts = [[[row[a] * end[a] for end in (low, up)] for a in range(3)] for row in matrix]
    seen: list[list[np.ndarray]] = [[], []]
    for corner in product((0, 1), repeat=3):
        x, y, w = (sum(parts[r][a][corner[a]] for a in range(3)) + matrix[r, 3] for r in (0, 1, 3))
        inverse = 1 / np.maximum(w, near)
        seen[0].append(x * inverse)
        seen[1].append(y * inverse)
    return np.maximum(*(np.maximum.reduce(own) - np.minimum.reduce(own) for own in seen))


def _reach(plane: np.ndarray, low: np.ndarray, up: np.ndarray) -> np.ndarray:
    half = plane.dtype.type(0.5)
    return plane[3] + sum(
        plane[a] * (half * (low[a] + up[a])) + abs(plane[a]) * (half * (up[a] - low[a])) for a in range(3)
    )


def _unrolled_tiles(net: list[list[np.ndarray]]) -> list[np.ndarray]:
    steps = range(len(net) - 1)
    return [
        np.maximum(np.maximum(net[i][j], net[i + 1][j]), np.maximum(net[i][j + 1], net[i + 1][j + 1]))
        for i in steps
        for j in steps
    ]


def plain_blend(rest: np.ndarray, transforms: np.ndarray, influences: Influences) -> np.ndarray:
    """Linear blend skinning with four bones a vertex, all matrices gathered at once."""
    bones, weights = bones_of(influences)
    blended = np.einsum("vk,vkij->vij", weights.astype(rest.dtype), transforms[bones])
    return np.einsum("vij,vj->vi", blended[:, :, :3], rest) + blended[:, :, 3]


def bones_of(influences: Influences) -> tuple[np.ndarray, np.ndarray]:
    """Bone numbers and weights ``(vertices, most)``, padded with weight 0."""
    matrix, count = influences.table.matrix, influences.most
    slots = np.arange(count)
    there = slots < influences.table.counts[:, None]
    at = np.where(there, matrix.indptr[:-1, None] + slots, 0)
    return np.where(there, matrix.indices[at], 0), np.where(there, matrix.data[at], 0.0)


def plain_pixel_error(patches: np.ndarray, matrix: np.ndarray, u: Any, v: Any, patch: Any, drawn: Any) -> np.ndarray:
    """The error of all covered pixels ([YBP12], (1)): control points gathered for each, Bernstein sums by einsum."""
    rows, columns = np.nonzero(patch >= 0)
    own = np.concatenate([patches, np.ones_like(patches[..., :1])], axis=-1)[patch[rows, columns]] @ matrix.T
    degrees = (patches.shape[1] - 1, patches.shape[2] - 1)
    across = [
        np.stack(bernstein(degree, t[rows, columns].astype(float)), axis=-1)
        for degree, t in zip(degrees, (u, v), strict=True)
    ]
    point = np.einsum("pi,pj,pijc->pc", *across, own, optimize=["einsum_path", (0, 2), (0, 1)])
    place = np.stack([columns, rows], axis=1) + 0.5 + drawn[rows, columns]
    error = np.full(patch.shape, np.nan)
    error[rows, columns] = np.max(np.abs(point[:, :2] / point[:, 3:] - place), axis=1)
    return error
