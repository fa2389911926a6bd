from __future__ import annotations

import numpy as np
import pytest

from slefejax import load
from slefejax.edges import edge_maxima, edge_points, shared_edges


def grid_patch(rng, du=3, dv=3):
    return rng.normal(size=(du + 1, dv + 1, 3))


# All ways in which a square can be laid down again: turned and reflected.
SYMMETRIES = {
    "same": lambda p: p,
    "u reversed": lambda p: p[::-1],
    "v reversed": lambda p: p[:, ::-1],
    "half turn": lambda p: p[::-1, ::-1],
    "transposed": lambda p: np.swapaxes(p, 0, 1),
    "quarter turn": lambda p: np.swapaxes(p, 0, 1)[::-1],
    "other quarter turn": lambda p: np.swapaxes(p, 0, 1)[:, ::-1],
    "transposed, half turn": lambda p: np.swapaxes(p, 0, 1)[::-1, ::-1],
}


@pytest.mark.parametrize("name", SYMMETRIES)
def test_neighbours_are_found_however_they_are_laid(name, rng):
    left, right = grid_patch(rng), grid_patch(rng)
    right[0] = left[-1]  # v from the same end, at u = 1 of one and u = 0 of the other
    numbers = shared_edges(np.stack([left, SYMMETRIES[name](right)]))
    common = set(numbers[0]) & set(numbers[1])
    assert common == {numbers[0, 2]}
    assert len(set(numbers.ravel())) == 7


def test_one_bit_is_a_difference(rng):
    left, right = grid_patch(rng), grid_patch(rng)
    right[0] = left[-1]
    right[0, 1, 2] = np.nextafter(right[0, 1, 2], np.inf)
    assert len(set(shared_edges(np.stack([left, right])).ravel())) == 8


def test_negative_zero_is_zero():
    flat = np.zeros((2, 2, 2, 3))
    flat[0, :, :, 0], flat[0, :, :, 1] = [[-1, -1], [0.0, 0.0]], [[0, 1], [0, 1]]
    flat[1, :, :, 0], flat[1, :, :, 1] = [[-0.0, -0.0], [1, 1]], [[-0.0, 1], [0, 1]]
    numbers = shared_edges(flat)
    assert numbers[0, 2] == numbers[1, 0]


def test_collapsed_edges_are_shared_with_nobody(rng):
    first, second = grid_patch(rng), grid_patch(rng)
    first[0] = second[0] = 1.5
    assert len(set(shared_edges(np.stack([first, second])).ravel())) == 8


def test_different_degrees_in_u_and_v(rng):
    left, below = grid_patch(rng, 3, 2), grid_patch(rng, 3, 2)
    below[:, 0] = left[::-1, -1]
    numbers = shared_edges(np.stack([left, below]))
    assert numbers[0, 3] == numbers[1, 1]
    assert len(set(numbers.ravel())) == 7
    assert [points.shape[1] for points in edge_points(np.stack([left, below]))] == [3, 4, 3, 4]


def test_teapot(teapot):
    """52 curves shared by two patches, 16 by one, 8 collapsed edges (models/README)."""
    counts = np.bincount(shared_edges(teapot.patches()).ravel())
    assert (counts == 2).sum() == 52
    assert (counts == 1).sum() == 16 + 8
    assert counts.max() == 2


def test_the_shipped_teapot_is_the_model(teapot, models):
    assert np.array_equal(teapot.patches(), load(models / "teapot.bpt").patches())


def test_edge_maxima_follow_the_papers_rule():
    numbers = np.array([[0, 1, 2, 3], [2, 4, 5, 6], [5, 7, 8, 9]])
    levels = np.array([5, 3, 0])
    assert edge_maxima(levels, numbers).tolist() == [[5, 5, 5, 5], [5, 3, 3, 3], [0, 0, 0, 0]]
