"""Rational neighbours whose weights along their common edge differ by a factor.

Homogeneous control points (w x, w y, w z, w) may be multiplied by any number without moving the surface. Two patches
may therefore have the same edge with other weights, which neither a tessellator nor ``slefejax.edges`` sees as the
same: each patch is divided by its factor. An edge with weights that are no multiple of the neighbour's runs through the
same control points at another pace or along another curve, and no factor helps.
"""

from __future__ import annotations

from collections import deque

import numpy as np
from jaxtyping import Float
from scipy.sparse import coo_array

from slefejax.edges import EDGES, edge_points
from slefejax.errors import InputError

_SAME_PLACE = 1e-9  # of the size of the model
_SAME_RATIO = 1e-9
Pair = tuple[int, int, bool]  # edge 4 patch + side, another, whether that runs the other way


def with_common_weights(
    patches: Float[np.ndarray, "patches nu nv 4"],
) -> tuple[Float[np.ndarray, "patches nu nv 4"], tuple[str, ...]]:
    """The patches with equal weights along common edges, bit for bit, and a note if that changed any.

    Raises InputError where no factors can do that, with the numbers of the patches.
    """
    pairs = _same_places(patches)
    links: dict[int, list[tuple[int, float]]] = {}
    unequal = []
    for one, other, backwards in pairs:
        a, b = _edge(patches, one), _edge(patches, other)
        b = b[::-1] if backwards else b
        if np.array_equal(a, b):
            ratio = 1.0
        else:
            ratios = a[:, 3] / b[:, 3]
            ratio = float(ratios[0])
            if np.max(np.abs(ratios / ratio - 1.0)) > _SAME_RATIO:
                raise InputError(_no_multiple(one, other))
            ratio = 1.0 if abs(ratio - 1.0) <= _SAME_RATIO else ratio
            unequal.append((one, other, backwards))
        links.setdefault(one // 4, []).append((other // 4, ratio))
        links.setdefault(other // 4, []).append((one // 4, 1.0 / ratio))
    if not unequal:
        return patches, ()
    factor = _factors(len(patches), links)
    scaled = np.where((factor == 1.0)[:, None, None, None], patches, patches * factor[:, None, None, None])
    changed = int(np.count_nonzero(factor != 1.0))
    note = f"the weights of {changed} of {len(patches)} patches were multiplied by a factor to agree with neighbours"
    if not changed:
        note = f"{len(unequal)} edges that were the same but for rounding were made equal bit for bit"
    return _made_equal(scaled, pairs), (note,)


def _factors(count: int, links: dict[int, list[tuple[int, float]]]) -> np.ndarray:
    """What to multiply each patch by, 1 for the first one of every connected piece."""
    factor = np.zeros(count)
    for start in range(count):
        if factor[start]:
            continue
        factor[start] = 1.0
        queue = deque([start])
        while queue:
            here = queue.popleft()
            for there, ratio in links.get(here, []):
                wanted = factor[here] * ratio
                if not factor[there]:
                    factor[there] = wanted
                    queue.append(there)
                elif abs(factor[there] / wanted - 1.0) > count * _SAME_RATIO:
                    raise InputError(
                        f"the weights of patches {here} and {there} (counted from 0) cannot agree along their common"
                        " edge: going around through their neighbours another factor comes out; reparametrise them"
                    )
    return factor


def _same_places(patches: np.ndarray) -> list[Pair]:
    """Pairs of edges with the same control points in space, whatever their weights; edges of no length are left out."""
    places = [points[..., :3] / points[..., 3:] for points in edge_points(patches)]
    corners = np.concatenate([p.reshape(-1, 3) for p in places])
    near = _SAME_PLACE * float(np.max(np.ptp(corners, axis=0)))
    pairs: list[Pair] = []
    for length in sorted({p.shape[1] for p in places}):
        sides = [side for side in range(4) if places[side].shape[1] == length]
        edges = np.concatenate([places[side] for side in sides])
        number = np.concatenate([4 * np.arange(len(patches)) + side for side in sides])
        long = np.flatnonzero(np.abs(edges - edges[:, :1]).max(axis=(1, 2)) > near)
        if not long.size:
            continue
        edges, number = edges[long], number[long]
        # the sum of the points does not know the direction
        from scipy.spatial import KDTree  # slow to import

        for i, j in sorted(KDTree(edges.sum(axis=1)).query_pairs(near * length * 2)):
            for backwards in (False, True):
                if np.abs(edges[i] - (edges[j][::-1] if backwards else edges[j])).max() <= near:
                    one, other = sorted((int(number[i]), int(number[j])))
                    pairs.append((one, other, backwards))
                    break
    return pairs


def _edge(patches: np.ndarray, number: int) -> np.ndarray:
    """The points of an edge."""
    patch, side = patches[number // 4], number % 4
    return (patch[0], patch[:, 0], patch[-1], patch[:, -1])[side]


def _made_equal(patches: np.ndarray, pairs: list[Pair]) -> np.ndarray:
    """Every point of common edges with the numbers of the first patch that has it."""
    numbers = np.arange(patches[..., 0].size).reshape(patches.shape[:3])
    links = [(_edge(numbers, a), _edge(numbers, b)[:: -1 if backwards else 1]) for a, b, backwards in pairs]
    one, other = (np.concatenate(part) for part in zip(*links, strict=True))
    graph = coo_array((np.ones(len(one), bool), (one, other)), (numbers.size,) * 2)
    from scipy.sparse.csgraph import connected_components  # slow to import

    _, place = connected_components(graph, directed=False)
    _, first = np.unique(place, return_index=True)
    return patches.reshape(-1, 4)[first[place]].reshape(patches.shape)


def _no_multiple(one: int, other: int) -> str:
    return (
        f"patches {one // 4} and {other // 4} (counted from 0) have an edge in common ({EDGES[one % 4]} and"
        f" {EDGES[other % 4]}), but its weights in one are no multiple of those in the other: reparametrise one of them"
    )
