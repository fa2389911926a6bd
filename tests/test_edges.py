from __future__ import annotations

import numpy as np
import pytest

from slefejax import load
from slefejax.geometry.bezier import elevate
from slefejax.tessellator.edges import Sides, edge_maxima, edge_points, shared_edges


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
def test_neighbours_are_found_however_they_are_laid(name, rng, precision):
    left, right = grid_patch(rng).astype(precision), grid_patch(rng).astype(precision)
    right[0] = left[-1]  # v from the same end, at u = 1 of one and u = 0 of the other
    numbers = shared_edges(np.stack([left, SYMMETRIES[name](right)]))
    common = set(numbers[0]) & set(numbers[1])
    assert common == {numbers[0, 2]}
    assert len(set(numbers.ravel())) == 7


@pytest.mark.parametrize("name", SYMMETRIES)
def test_the_first_owns_the_side_and_the_other_runs_along_it_or_against_it(name, rng):
    """Control points of a side are its owner's, from first to last; those of all other sides are their own."""
    left, right = grid_patch(rng), grid_patch(rng)
    right[0] = left[-1]
    patches = np.stack([left, SYMMETRIES[name](right)])
    sides = Sides.of(patches)
    points = np.stack(edge_points(patches), axis=1).reshape(8, 4, 3)
    assert sorted(set(range(8)) - set(sides.owner.ravel().tolist())) == [4 + np.argwhere(sides.owner[1] == 2).item()]
    assert set(zip(sides.first.ravel().tolist(), sides.last.ravel().tolist(), strict=True)) <= {(0.0, 1.0), (1.0, 0.0)}
    for side, (owner, first) in enumerate(zip(sides.owner.ravel(), sides.first.ravel(), strict=True)):
        assert np.array_equal(points[side], points[owner][:: -1 if first else 1])


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
@pytest.mark.parametrize("backwards", [False, True])
@pytest.mark.parametrize("turned", [False, True])
def test_a_side_along_u_may_be_one_along_v_raised(dtype, backwards, turned, rng):
    """A cubic, raised to 5 along one parameter here, to 4 along the other there: the side of lower degree owns it."""
    curve = rng.normal(size=(4, 3)) + [0, 0, 50]
    patches = rng.normal(size=(2, 6, 5, 3))
    patches[0, :, 0] = elevate(curve[::-1] if backwards else curve, 5)
    patches[1, -1] = elevate(curve, 4)
    if turned:
        patches = np.swapaxes(patches, 1, 2)
    patches = patches.astype(dtype)
    sides = Sides.of(patches)
    many, few = (0, 3) if turned else (1, 2)
    assert (sides.owner[0, many], sides.first[0, many]) == (4 + few, 1.0 * backwards)
    assert (sides.owner[1, few], sides.first[1, few], sides.last[1, few]) == (4 + few, 0.0, 1.0)
    assert len(np.unique(sides.numbers)) == 7
    patches[0, 2, 2] += 1.0
    assert len(np.unique(Sides.of(patches).numbers)) == 7
    edge_points(patches)[many][0, 2] += 100 * np.finfo(dtype).eps * 50
    assert len(np.unique(Sides.of(patches).numbers)) == 8, "a hundred roundings are a difference"


def test_numbers_of_points_are_not_raised():
    """A net whose numbers along u would be those along v, raised: they are names, not places."""
    net = np.array([[[0, 4], [2, 5], [4, 6]], [[9, 8], [10, 12], [11, 13]]])[..., None]
    assert len(np.unique(shared_edges(net))) == 8


def test_one_bit_is_a_difference(rng, precision):
    left, right = grid_patch(rng).astype(precision), grid_patch(rng).astype(precision)
    right[0] = left[-1]
    right[0, 1, 2] = np.nextafter(right[0, 1, 2], precision(np.inf))
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
