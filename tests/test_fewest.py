"""Patches that choose their levels together."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from slefejax.predict.fewest import fewest_triangles, lowest
from slefejax.tessellator.direct3d11 import ONE
from slefejax.tessellator.levels import OWN_AXIS, triangle_counts
from slefejax.tessellator.rings import direct3d11

ROW = np.array([[0, 1, 2, 3], [2, 4, 5, 6], [5, 7, 8, 9]])  # three patches side by side
FAN = np.array([[0, 1, 2, 3], [0, 4, 5, 6], [0, 7, 8, 9]])  # three on one edge
TUBE = np.array([[0, 1, 0, 2], [2, 3, 4, 5]])  # the first one meets itself


def instance(seed: int, count: int, choices: int):
    """Levels 2 ... 8 with as much freedom as the pattern gives to triangles of a random length."""
    rng = np.random.default_rng(seed)
    inner = rng.integers(2, 9, (count, choices, 2))
    inner[:, 0] = 6  # all the same: possible
    longest = rng.uniform(0.0, 0.6, (count, choices, 4))
    return inner, direct3d11().edge_levels(inner[:, :, OWN_AXIS], longest)


def triangles_of(inner, sets, numbers, choice):
    """Triangles for a choice of every patch, infinitely many if an edge has no level left."""
    row = np.arange(len(numbers))
    edges = np.zeros(numbers.shape)
    for number in np.unique(numbers):
        allowed = np.bitwise_and.reduce(sets[row, choice][numbers == number])
        levels = [m for m in range(1, 65) if int(allowed) >> (m - 1) & 1]
        if not levels:
            return np.inf
        edges[numbers == number] = levels[0]
    return triangle_counts(inner[row, choice], edges.astype(int)).sum()


@pytest.mark.parametrize("numbers", [ROW, FAN, TUBE])
def test_often_as_good_as_trying_everything(numbers):
    """Random freedom is harder than that of surfaces, where finer grids allow more: half of the time is not bad."""
    best = 0
    for seed in range(12):
        inner, sets = instance(seed, len(numbers), 5)
        every = [triangles_of(inner, sets, numbers, list(c)) for c in product(range(5), repeat=len(numbers))]
        found, edges = fewest_triangles(inner, sets, numbers)
        triangles = triangle_counts(found, edges).sum()
        assert min(every) <= triangles <= every[0], "the first of all choices is where the search starts"
        assert triangles in every, "the levels belong to a choice"
        best += triangles == min(every)
        for number in np.unique(numbers):
            assert len(np.unique(edges[numbers == number])) == 1
    assert best >= 6


def test_crowded_edges_stay_as_they_are():
    numbers = np.column_stack([np.zeros(20, int), np.arange(1, 61).reshape(20, 3)])
    inner, sets = instance(0, 20, 5)
    found, _ = fewest_triangles(inner, sets, numbers)
    assert np.array_equal(found, inner[:, 0])


def test_lowest_level():
    sets = np.array([0, 1, 0b1100, 1 << 63, 2**64 - 2], np.uint64)
    assert lowest(sets).tolist() == [np.inf, 1, 3, 64, 2]


def test_edge_levels_are_those_whose_rings_are_short_enough(rng):
    pattern = direct3d11()
    inner = rng.integers(2, 65, 200)
    longest = np.concatenate(
        [rng.uniform(0.0, 1.0, 100), pattern.reach[inner[100:], rng.integers(1, 65, 100)] + 2 / ONE + 1e-9]
    )
    sets = pattern.edge_levels(inner, longest)
    for n, length, allowed in zip(inner, longest, sets, strict=True):
        expected = [m for m in range(1, 65) if pattern.reach[n, m] + 2 / ONE <= length or m == n]
        assert [m for m in range(1, 65) if int(allowed) >> (m - 1) & 1] == expected
