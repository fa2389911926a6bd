"""Which patch edges are one and the same curve, found from the control points.

Edges of a patch are numbered as OpenGL numbers its outer levels:

        v=1   3
        +-----------+        0: u = 0     2: u = 1
        |           |        1: v = 0     3: v = 1
      0 |           | 2
        |           |        edges 0 and 2 have dv+1 control points (v grows along them),
        +-----------+        edges 1 and 3 have du+1 (u grows along them)
        v=0   1

Every *side*, an edge as its patch has it, is (owner, first, last): the part from ``first`` to ``last`` of one curve,
that of the side ``owner``, whose control points everyone evaluates who draws it, so that both neighbours have the same
points bit for bit. ``Sides.of`` finds whole sides: two are one curve

- where their control points are equal bit for bit, in the same or in the opposite order;
- where du and dv differ, also if a side along u is a side along v raised to its degree: their ends are equal bit for
  bit, the points between to the rounding of their dtype.

A side whose control points all coincide is a point, and is shared with nobody. Sides of different degrees, or that a
file's digits part, are made so when a scene is loaded (``slefejax.conversion.weld``).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int, Real, Shaped

from slefejax.arguments import whole_numbers
from slefejax.errors import InputError
from slefejax.geometry.bezier import elevate
from slefejax.tessellator.levels import OWN_AXIS

EDGES = ("u=0", "v=0", "u=1", "v=1")
_ROUNDING = 8  # eps: points of both sides and of the raised one are rounded once each, and in each step of raising


def edge_points(patches: Any) -> list[np.ndarray]:
    """Control points of the four edges of every patch, each ``(patches, points, dim)``, in OpenGL's order.

    Those of Gregory patches are their nets'.

    >>> flat = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)[None]
    >>> [edge[0].tolist() for edge in edge_points(flat)][0]
    [[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]]
    """
    net = getattr(patches, "net", patches)
    return [net[:, 0], net[:, :, 0], net[:, -1], net[:, :, -1]]


@dataclass(frozen=True, eq=False)
class Sides:
    """For every side of every patch which part of which curve it is.

    owner       : ``(patches, 4)``, the side whose control points are that curve, as 4 patch + edge; of sides that are
                  one curve the first of the lowest degree
    first, last : ``(patches, 4)``, where the side begins and ends in the owner's parameter, u or v as it grows along
                  the edge: dyadic numbers, exact in float32. 0 and 1, or 1 and 0 where it runs against the owner; half
                  a side of a larger neighbour would have 0 and 0.5

    >>> quad = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)
    >>> sides = Sides.of(np.stack([quad, quad[::-1, ::-1] + [1, 0, 0]]))
    >>> sides.owner.tolist(), sides.first[1].tolist()
    ([[0, 1, 2, 3], [4, 5, 2, 7]], [0.0, 0.0, 1.0, 0.0])
    """

    owner: Int[np.ndarray, "patches 4"]
    first: Float[np.ndarray, "patches 4"]
    last: Float[np.ndarray, "patches 4"]

    @staticmethod
    def of(patches: Any) -> Sides:
        """Whole sides that are one curve (module docstring).

        patches : control points ``(patches, nu, nv, dim)`` or ``GregoryPatches``, or numbers of control points
                  ``(patches, nu, nv, 1)``, which are compared as they are
        """
        patches = np.asarray(getattr(patches, "net", patches))
        curve, turned = _equal_curves(patches)
        if patches.shape[1] != patches.shape[2] and patches.shape[3] > 1:
            with np.errstate(invalid="ignore", over="ignore"):  # points that are not finite are no curve's
                curve, turned = _with_raised(patches, curve, turned)
        points = np.tile([patches.shape[2], patches.shape[1]], 2 * len(patches))
        order = np.lexsort((points, curve))  # stable: the first of the fewest points
        _, start = np.unique(curve[order], return_index=True)
        owner = order[start][curve]
        against = turned != turned[owner]
        shape = (len(patches), 4)
        return Sides(owner.reshape(shape), 1.0 * against.reshape(shape), 1.0 * ~against.reshape(shape))

    @cached_property
    def numbers(self) -> Int[np.ndarray, "patches 4"]:
        """A number for every side, from 0 on, equal exactly where sides are the same part of one curve."""
        low, high = np.minimum(self.first, self.last), np.maximum(self.first, self.last)
        _, part = np.unique(low + 1j * high, return_inverse=True)
        return number_by_first_use(part.ravel() * self.owner.size + self.owner.ravel()).reshape(-1, 4)


def shared_edges(patches: Any) -> Int[np.ndarray, "patches 4"]:
    """A number for every edge of every patch, equal exactly where edges are shared (``Sides``).

    patches : control points ``(patches, nu, nv, dim)`` or ``GregoryPatches``, or numbers of control points

    >>> quad = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)
    >>> shared_edges(np.stack([quad, quad + [1, 0, 0]])).tolist()
    [[0, 1, 2, 3], [2, 4, 5, 6]]
    """
    return Sides.of(patches).numbers


def _equal_curves(patches: np.ndarray) -> tuple[Int[np.ndarray, "sides"], Bool[np.ndarray, "sides"]]:
    """Of every side its curve, equal for equal points, and whether it runs against the order that curves have."""
    longest = max(patches.shape[1:3])
    found = [_keys(points, longest) for points in edge_points(patches)]
    keys, turned = (np.stack([part[k] for part in found], axis=1) for k in (0, 1))
    keys = keys.reshape(-1, keys.shape[-1])
    # A collapsed edge gets a key of its own: its number, where no other edge has one.
    own = np.where(collapsed(patches).ravel(), np.arange(1, len(keys) + 1), 0)
    return number_by_first_use(np.column_stack([own, keys])), turned.ravel()


def _keys(points: np.ndarray, longest: int) -> tuple[np.ndarray, np.ndarray]:
    """One row a curve, the same for both directions: whichever comes first in lexicographic order; which it was."""
    points = points + 0.0  # -0.0 and 0.0 are one place
    forwards, backwards = (p.reshape(len(p), -1) for p in (points, points[:, ::-1]))
    differ = forwards != backwards
    first = np.argmax(differ, axis=1)[:, None]
    swap = np.take_along_axis(forwards > backwards, first, axis=1)
    rows = np.where(swap, backwards, forwards)
    missing = (longest - points.shape[1]) * points.shape[2]
    return np.pad(rows, ((0, 0), (0, missing)), constant_values=np.inf), swap[:, 0]


def collapsed(patches: Any) -> Bool[np.ndarray, "patches 4"]:
    """Which edges are points: all of their control points are equal bit for bit.

    >>> collapsed(np.zeros((1, 4, 4, 3))).tolist()
    [[True, True, True, True]]
    """
    return np.stack([np.all(points == points[:, :1], axis=(1, 2)) for points in edge_points(patches)], axis=1)


def _with_raised(patches: np.ndarray, curve: np.ndarray, turned: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The same with sides along one parameter that are those along the other, raised to their degree."""
    whole = np.unique(curve, return_index=True)[1]  # a side of every curve
    whole = whole[~collapsed(patches).ravel()[whole]]
    few = 0 if patches.shape[1] > patches.shape[2] else 1  # edges 0 and 2 have dv+1 points
    sides = [whole[whole % 2 == parity] for parity in (few, 1 - few)]
    low, high = (_in_order(patches, own, parity, turned) for own, parity in zip(sides, (few, 1 - few), strict=True))
    pairs = _equal_ends(low, high)
    raised = np.moveaxis(elevate(np.moveaxis(low[pairs[:, 0]], 1, 0), high.shape[1] - 1), 0, 1)
    other = high[pairs[:, 1]]
    near = _ROUNDING * np.finfo(high.dtype).eps * np.abs(other).max(axis=(1, 2))
    joined, against = np.arange(curve.max() + 1), np.zeros(curve.max() + 1, bool)
    # forwards last: a curve that is the same both ways keeps its direction
    for backwards in (True, False):
        same = np.abs(raised - (other[:, ::-1] if backwards else other)).max(axis=(1, 2)) <= near
        one, two = (curve[own[pair]] for own, pair in zip(sides, pairs[same].T, strict=True))
        joined[two], against[two] = one, backwards
    return number_by_first_use(joined[curve]), turned ^ against[curve]


def _in_order(patches: np.ndarray, sides: np.ndarray, parity: int, turned: np.ndarray) -> np.ndarray:
    """Points ``(sides, points, dim)`` of sides that run along one parameter, in the order that their curves have."""
    edges = np.stack(edge_points(patches)[parity::2], axis=1)
    points = edges[sides // 4, sides % 4 // 2] + 0.0
    return np.where(turned[sides][:, None, None], points[:, ::-1], points)


def _equal_ends(one: np.ndarray, other: np.ndarray) -> Int[np.ndarray, "pairs 2"]:
    """Pairs of a curve here and a curve there with the same two end points, whichever is the first."""
    ends = np.concatenate([points[:, [0, -1]] for points in (one, other)])
    place = number_by_first_use(ends.reshape(-1, ends.shape[-1])).reshape(-1, 2)
    key = number_by_first_use(np.sort(place, axis=1))
    here, there = key[: len(one)], key[len(one) :]
    order = np.argsort(there, kind="stable")
    start, end = (np.searchsorted(there[order], here, side=side) for side in ("left", "right"))
    count = end - start
    index = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
    return np.stack([np.repeat(np.arange(len(one)), count), order[np.repeat(start, count) + index]], axis=1)


def number_by_first_use(rows: Shaped[np.ndarray, "rows *columns"]) -> Int[np.ndarray, "rows"]:
    """A number for every row, from 0 on in the order in which they come, equal for equal rows.

    >>> number_by_first_use(np.array([7, 3, 7])).tolist()
    [0, 1, 0]
    """
    _, first, inverse = np.unique(rows, axis=0 if rows.ndim > 1 else None, return_index=True, return_inverse=True)
    rank = np.empty(len(first), int)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse.ravel()]


def check_edge_numbers(numbers: Any, count: int) -> Int[np.ndarray, "patches 4"]:
    """The numbers of edges as an array, or InputError.

    >>> check_edge_numbers([[0, 1, 2, 3]], 1).tolist()
    [[0, 1, 2, 3]]
    """
    numbers = whole_numbers(numbers, "edge_numbers")
    if numbers.shape != (count, 4) or np.any(numbers < 0):
        raise InputError(
            f"edge_numbers must be whole numbers from 0 on, ({count}, 4), equal for shared edges, not"
            f" {numbers.dtype} {numbers.shape}: shared_edges makes them"
        )
    return numbers.astype(np.int64)


def edge_maxima(
    levels: Real[np.ndarray, "patches"] | Real[np.ndarray, "patches 2"], edges: Int[np.ndarray, "patches 4"]
) -> Real[np.ndarray, "patches 4"]:
    """For every edge the largest level of the patches that share it; 0 on the edges of a patch with level 0.

    levels : the same along u and v, or one along each, of which an edge gets that along it

    [YBP12], section 6 (docs/math.md, 3): a visible patch keeps its own level where its neighbour is not drawn.

    >>> edge_maxima(np.array([3, 5]), np.array([[0, 1, 2, 3], [2, 4, 5, 6]])).tolist()
    [[3, 3, 5, 3], [5, 5, 5, 5]]
    """
    along = np.repeat(levels[:, None], 4, axis=1) if levels.ndim == 1 else levels[:, OWN_AXIS]
    largest = np.zeros(edges.max() + 1, levels.dtype)
    np.maximum.at(largest, edges.ravel(), along.ravel())
    return np.where(np.all(along > 0, axis=1)[:, None], largest[edges], 0)
