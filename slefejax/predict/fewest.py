"""Which inner levels all patches together should choose for the fewest triangles (docs/certified.md, section 6).

Every patch has a few pairs of inner levels to choose from, each with the edge levels that its rings then allow, as bits
m - 1 of a set. An edge gets the lowest level that all patches on it allow. What a choice costs depends on the
neighbours' choices alone, so patches that share no edge choose at the same time, over and over; that some choices at
first are not the best ones finds better ends.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, UInt64

_ROUNDS = 100
_HEAT = 0.05  # of a patch's triangles: how much worse a choice may be at first
_SHARED_BY = 8  # patches on edges that more patches share keep their first choice

Inner = Int[np.ndarray, "patches choices 2"]
Sets = UInt64[np.ndarray, "patches choices 4"]
Numbers = Int[np.ndarray, "patches 4"]
Sides = Int[np.ndarray, "n"]  # 4 times the patch plus the side


def fewest_triangles(
    inner: Inner, sets: Sets, numbers: Numbers
) -> tuple[Int[np.ndarray, "patches 2"], Int[np.ndarray, "patches 4"]]:
    """Inner and edge levels.

    inner   : levels of at least 1; all first choices together must be possible
    sets    : edge levels allowed; an empty set rules a choice out
    numbers : equal for shared edges
    """
    numbers = np.unique(numbers, return_inverse=True)[1].reshape(-1, 4)
    sets = _with_own_edges(sets, numbers)
    members = np.bincount(numbers.ravel())[numbers]
    fixed = np.any(members > _SHARED_BY, axis=1)
    cost = _own_triangles(inner)
    cost[fixed, 1:] = np.inf
    sides, others = _sharing(numbers, members)
    least, best = np.inf, np.zeros(len(inner), np.int64)
    # from the choices that are possible, and from the cheapest ones: patches that need less together seldom get there
    # one by one
    for choice in (best, np.argmin(cost, axis=1)):
        rng = np.random.default_rng(0)
        for turn in range(_ROUNDS):
            total = _total(cost, sets, numbers, choice)
            if total < least:
                least, best = total, choice
            heat = _HEAT * max(0.0, 1.0 - 1.25 * turn / _ROUNDS)
            own = _taking_turns(numbers, rng)
            neighbours = _neighbours(_chosen(sets, choice), sides, others)[own]
            price = cost[own] + (members[own, None] * lowest(sets[own] & neighbours[:, None])).sum(axis=2)
            noise = rng.gumbel(size=price.shape) * heat * np.maximum(cost[own, :1], 0.0)
            choice = choice.copy()
            choice[own] = np.argmin(price - noise, axis=1)
    row = np.arange(len(inner))
    return inner[row, best], _edge_levels(_chosen(sets, best), numbers)[numbers].astype(np.int64)


def lowest(sets: UInt64[np.ndarray, "*shape"]) -> Float[np.ndarray, "*shape"]:
    """The lowest level in each set, infinity for an empty one.

    >>> lowest(np.array([0b1000, 0], np.uint64)).tolist()
    [4.0, inf]
    """
    bit = np.frexp((sets & (~sets + np.uint64(1))).astype(np.float64))[1]
    return np.where(sets == 0, np.inf, bit)


def _own_triangles(inner: Inner) -> Float[np.ndarray, "patches choices"]:
    """Triangles of a patch, but for one for every piece of its edges (``tessellator.levels.triangle_counts``)."""
    u, v = np.moveaxis(np.maximum(inner, 2) - 2.0, 2, 0)
    return np.where(np.all(inner == 1, axis=2), -2.0, 2.0 * (u * v + u + v))


def _with_own_edges(sets: Sets, numbers: Numbers) -> Sets:
    """A patch may meet itself: both sides then allow what both allow."""
    sets = sets.copy()
    for a in range(4):
        for b in range(a):
            same = np.flatnonzero(numbers[:, a] == numbers[:, b])
            sets[same, :, a] = sets[same, :, b] = sets[same, :, a] & sets[same, :, b]
    return sets


def _sharing(numbers: Numbers, members: Int[np.ndarray, "patches 4"]) -> tuple[Sides, Sides]:
    """Pairs of sides of different patches that share an edge, in both orders."""
    flat, members = numbers.ravel(), members.ravel()
    order = np.argsort(flat, kind="stable")
    place = np.empty_like(order)
    place[order] = np.arange(len(order))
    start = np.searchsorted(flat[order], flat)
    sides, others = [], []
    for step in range(1, _SHARED_BY):
        side = np.flatnonzero((members > step) & (members <= _SHARED_BY))
        other = order[start[side] + (place[side] - start[side] + step) % members[side]]
        apart = side // 4 != other // 4
        sides.append(side[apart])
        others.append(other[apart])
    return np.concatenate(sides), np.concatenate(others)


def _chosen(sets: Sets, choice: Int[np.ndarray, "patches"]) -> UInt64[np.ndarray, "patches 4"]:
    return sets[np.arange(len(sets)), choice]


def _neighbours(chosen: UInt64[np.ndarray, "patches 4"], sides: Sides, others: Sides) -> UInt64[np.ndarray, "p 4"]:
    """What the other patches on every edge allow."""
    found = np.full(chosen.size, ~np.uint64(0))
    np.bitwise_and.at(found, sides, chosen.ravel()[others])
    return found.reshape(chosen.shape)


def _edge_levels(chosen: UInt64[np.ndarray, "patches 4"], numbers: Numbers) -> Float[np.ndarray, "edges"]:
    allowed = np.full(numbers.max() + 1, ~np.uint64(0))
    np.bitwise_and.at(allowed, numbers.ravel(), chosen.ravel())
    return lowest(allowed)


def _total(cost: np.ndarray, sets: Sets, numbers: Numbers, choice: Int[np.ndarray, "patches"]) -> float:
    levels = _edge_levels(_chosen(sets, choice), numbers)
    return float(cost[np.arange(len(cost)), choice].sum() + levels[numbers].sum())


def _taking_turns(numbers: Numbers, rng: np.random.Generator) -> Int[np.ndarray, "n"]:
    """Patches of which no two share an edge, drawn at random."""
    lot = rng.random(len(numbers))
    highest = np.zeros(numbers.max() + 1)
    np.maximum.at(highest, numbers.ravel(), np.repeat(lot, 4))
    return np.flatnonzero(lot >= highest[numbers].max(axis=1))
