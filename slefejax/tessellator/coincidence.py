"""Sides that lie on each other without being shared: neighbours between which a crack may show.

A free side (of one patch only, ``tessellator.edges``) lies on a curve if points all along it do, to within a tolerance.
That finds the same curve at another pace, or further apart than what was welded, and parts of sides: T-junctions.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax.geometry.bezier import elevate, evaluate_curve
from slefejax.late import one_at_a_time
from slefejax.tessellator.edges import edge_points

_NEAR = 1e-5  # of the size of the scene
_PLACES = np.arange(17) / 16.0  # on each side
_COARSE = np.arange(33) / 32.0  # on the curve, where the nearest point is looked for
_FINER = np.arange(-4, 5) / 4.0
_ROUNDS = 8  # each four times as fine: to 5e-7 of the parameter, well below _NEAR of a curve's length
_AT_A_TIME = 4096  # pairs


def coincident_sides(
    patches: Float[np.ndarray, "patches nu nv dim"], numbers: Int[np.ndarray, "patches 4"], near: float = _NEAR
) -> Bool[np.ndarray, "patches 4"]:
    """Which free sides lie on another side, or have a free one that lies on them.

    numbers : equal for sides that are shared (``slefejax.tessellator.edges``)
    near    : how far off a point may be, as a share of the longest side of the box around all control points

    Sides shorter than that are left out.

    >>> quad = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)
    >>> half = quad * [1, 0.5, 1] + [1, 0, 0]
    >>> coincident_sides(np.stack([quad, half]), np.arange(8).reshape(2, 4)).tolist()
    [[False, False, True, False], [True, False, False, False]]
    """
    curves, first = _curves(patches, numbers)
    where = _places(curves)
    low, high = where.min(axis=1), where.max(axis=1)
    tolerance = near * float(np.max(high.max(axis=0) - low.min(axis=0)))
    long = np.max(high - low, axis=1) > tolerance
    free = np.flatnonzero((np.bincount(numbers.ravel(), minlength=len(curves)) == 1) & long)
    pairs = _candidates(curves, free, low, high, tolerance)
    pairs = pairs[long[pairs[:, 1]]]
    for places in (_PLACES[8:9], _PLACES):  # most are told by the middle
        pairs = pairs[_lie_on(curves, pairs, places, tolerance)]
    found = np.zeros(len(curves), bool)
    found[np.intersect1d(pairs, free)] = True
    return found[first].reshape(numbers.shape)


def _curves(patches: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Points ``(curves, points, dim)`` of each different side, all of one degree, and which of them each side is."""
    _, first, inverse = np.unique(numbers, return_index=True, return_inverse=True)
    degree = max(patches.shape[1:3]) - 1
    edges = [np.moveaxis(elevate(np.moveaxis(points, 1, 0), degree), 0, 1) for points in edge_points(patches)]
    return np.stack(edges, axis=1).reshape(-1, degree + 1, patches.shape[3])[first], inverse.ravel()


def _places(points: np.ndarray) -> np.ndarray:
    return points if points.shape[-1] == 3 else points[..., :3] / points[..., 3:]


def _candidates(
    curves: np.ndarray, free: np.ndarray, low: np.ndarray, high: np.ndarray, tolerance: float
) -> Int[np.ndarray, "pairs 2"]:
    """Free curves and others whose boxes reach to their middle."""
    if not free.size:
        return np.zeros((0, 2), int)
    with one_at_a_time:
        from scipy.spatial import KDTree  # slow to import

    middle = _evaluate(curves[free], np.full((len(free), 1), 0.5))[:, 0]
    centre, reach = 0.5 * low + 0.5 * high, 0.5 * np.max(high - low) + tolerance
    lists = KDTree(centre).query_ball_point(middle, reach, p=np.inf)
    here = np.repeat(np.arange(len(free)), [len(near) for near in lists])
    there = np.concatenate(lists).astype(int)
    inside = np.all((middle[here] >= low[there] - tolerance) & (middle[here] <= high[there] + tolerance), axis=1)
    pairs = np.stack([free[here], there], axis=1)[inside]
    return pairs[pairs[:, 0] != pairs[:, 1]]


def _lie_on(curves: np.ndarray, pairs: np.ndarray, places: np.ndarray, tolerance: float) -> Bool[np.ndarray, "pairs"]:
    """Whether points of the first curve of each pair, at these parameters, are near the second."""
    parts = [pairs[k : k + _AT_A_TIME] for k in range(0, len(pairs), _AT_A_TIME)]
    found = [_distances(curves[part[:, 0]], curves[part[:, 1]], places).max(axis=1) <= tolerance for part in parts]
    return np.concatenate(found) if found else np.zeros(0, bool)


def _distances(one: np.ndarray, other: np.ndarray, places: np.ndarray) -> Float[np.ndarray, "pairs places"]:
    """How far points of one curve are from the other: the nearest of points that are laid ever more finely."""
    points = _evaluate(one, np.broadcast_to(places, (len(one), len(places))))[:, :, None]

    def nearest(t: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        there = _evaluate(other, t.reshape(len(other), -1)).reshape(*t.shape, 3)
        apart = np.linalg.norm(points - there, axis=-1)
        best = np.argmin(apart, axis=-1)[..., None]
        return np.take_along_axis(t, best, axis=-1), np.take_along_axis(apart, best, axis=-1)[..., 0]

    t, distance = nearest(np.broadcast_to(_COARSE, (len(one), len(places), len(_COARSE))))
    step = _COARSE[1]
    for _ in range(_ROUNDS):
        t, distance = nearest(np.clip(t + step * _FINER, 0.0, 1.0))
        step /= 4.0
    return distance


def _evaluate(curves: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Points ``(curves, parameters, 3)`` of curves at parameters ``(curves, parameters)`` of their own."""
    return _places(np.moveaxis(evaluate_curve(np.moveaxis(curves, 0, -1)[..., None], t[None]), 0, -1))
