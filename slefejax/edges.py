"""Which patch edges are one and the same curve, found from the control points.

Edges of a patch are numbered as OpenGL numbers its outer levels:

        v=1   3
        +-----------+        0: u = 0     2: u = 1
        |           |        1: v = 0     3: v = 1
      0 |           | 2
        |           |        edges 0 and 2 have dv+1 control points (v grows along them),
        +-----------+        edges 1 and 3 have du+1 (u grows along them)
        v=0   1

Two edges are shared where their control points are equal bit for bit, in the same or in the opposite
order. An edge whose control points all coincide is a point, and is shared with nobody.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Int, Real, Shaped

from slefejax.arguments import whole_numbers
from slefejax.errors import InputError

EDGES = ("u=0", "v=0", "u=1", "v=1")


def edge_points(patches: Shaped[np.ndarray, "patches nu nv dim"]) -> list[np.ndarray]:
    """Control points of the four edges of every patch, each ``(patches, points, dim)``, in OpenGL's order."""
    return [patches[:, 0], patches[:, :, 0], patches[:, -1], patches[:, :, -1]]


def shared_edges(patches: Shaped[np.ndarray, "patches nu nv dim"]) -> Int[np.ndarray, "patches 4"]:
    """A number for every edge of every patch, equal exactly where edges are shared (module docstring).

    patches : control points, or numbers of control points ``(patches, nu, nv, 1)``

    >>> quad = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)
    >>> shared_edges(np.stack([quad, quad + [1, 0, 0]])).tolist()
    [[0, 1, 2, 3], [2, 4, 5, 6]]
    """
    patches = np.asarray(patches)
    longest = max(patches.shape[1:3])
    keys = np.stack([_keys(points, longest) for points in edge_points(patches)], axis=1)
    keys = keys.reshape(-1, keys.shape[-1])
    collapsed = np.stack([_collapsed(points) for points in edge_points(patches)], axis=1).ravel()
    # A collapsed edge gets a key of its own: its number, where no other edge has one.
    own = np.where(collapsed, np.arange(1, len(keys) + 1), 0)
    return _number_by_first_use(np.column_stack([own, keys])).reshape(-1, 4)


def _keys(points: np.ndarray, longest: int) -> np.ndarray:
    """One row a curve, the same for both directions: whichever comes first in lexicographic order."""
    points = points + 0.0  # -0.0 and 0.0 are one place
    forwards, backwards = (p.reshape(len(p), -1) for p in (points, points[:, ::-1]))
    differ = forwards != backwards
    first = np.argmax(differ, axis=1)[:, None]
    swap = np.take_along_axis(forwards > backwards, first, axis=1)
    rows = np.where(swap, backwards, forwards)
    missing = (longest - points.shape[1]) * points.shape[2]
    return np.pad(rows, ((0, 0), (0, missing)), constant_values=np.inf)


def _collapsed(points: np.ndarray) -> np.ndarray:
    return np.all(points == points[:, :1], axis=(1, 2))


def _number_by_first_use(rows: np.ndarray) -> np.ndarray:
    _, first, inverse = np.unique(rows, axis=0, return_index=True, return_inverse=True)
    rank = np.empty(len(first), int)
    rank[np.argsort(first)] = np.arange(len(first))
    return rank[inverse.ravel()]


def check_edge_numbers(numbers: Any, count: int) -> Int[np.ndarray, "patches 4"]:
    """The numbers of edges as an array, or InputError."""
    numbers = whole_numbers(numbers, "edge_numbers")
    if numbers.shape != (count, 4) or np.any(numbers < 0):
        raise InputError(
            f"edge_numbers must be whole numbers from 0 on, ({count}, 4), equal for shared edges, not"
            f" {numbers.dtype} {numbers.shape}: shared_edges makes them"
        )
    return numbers.astype(np.int64)


def edge_maxima(
    levels: Real[np.ndarray, "patches"], edges: Int[np.ndarray, "patches 4"]
) -> Real[np.ndarray, "patches 4"]:
    """For every edge the largest level of the patches that share it; 0 on the edges of a patch with level 0.

    The rule of both papers (MATH.md, section 3): a visible patch keeps its own level where its neighbour is not drawn.
    """
    largest = np.zeros(edges.max() + 1, levels.dtype)
    np.maximum.at(largest, edges.ravel(), np.repeat(levels, 4))
    return np.where(levels[:, None] > 0, largest[edges], 0)
