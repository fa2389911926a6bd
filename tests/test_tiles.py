from __future__ import annotations

import numpy as np
import pytest

from slefejax import InputError, slefe_boxes, slefe_tiles
from slefejax.geometry.bezier import evaluate_patch

ROUNDING = 256 * np.finfo(np.float64).eps


def rational(rng, count, degrees, decades):
    points = rng.normal(size=(count, degrees[0] + 1, degrees[1] + 1, 3))
    weights = 10.0 ** rng.uniform(-decades / 2, decades / 2, (*points.shape[:3], 1))
    return np.concatenate([points * weights, weights], axis=-1)


def check_inside(patches, segments, rng, samples=60):
    tiles = slefe_tiles(patches, segments)
    assert tiles.lower.dtype == tiles.upper.dtype == patches.dtype
    lower, upper, patches = (np.asarray(x, float) for x in (*tiles, patches))
    assert lower.shape == (len(patches), *segments, 3)
    control = np.moveaxis(patches, 0, -1)
    slack = ROUNDING * np.max(np.abs(patches[..., :3] / (patches[..., 3:] if patches.shape[3] == 4 else 1)))
    for u, v in [*rng.random((samples, 2)), (0, 0), (1, 1), (1 / segments[0], 0.5)]:
        i, j = (min(int(t * m), m - 1) for t, m in ((u, segments[0]), (v, segments[1])))
        value = evaluate_patch(control, u, v)
        point = (value[:3] / value[3] if len(value) == 4 else value).T
        assert np.all(lower[:, i, j] <= point + slack)
        assert np.all(point <= upper[:, i, j] + slack)


@pytest.mark.parametrize("decades", [0, 12, *(pytest.param(d, marks=pytest.mark.slow) for d in (2, 6))])
@pytest.mark.parametrize("segments", [(1, 1), (2, 5), pytest.param((3, 3), marks=pytest.mark.slow)])
@pytest.mark.parametrize("degrees", [(1, 1), (2, 3), (3, 3)])
def test_rational_patches_stay_inside(degrees, segments, decades, rng, precision):
    """What is left for rounding is that of the comparison, in double precision: bounds are outward in both."""
    check_inside(rational(rng, 500, degrees, decades).astype(precision), segments, rng)


def test_polynomial_patches_stay_inside_and_nearer_than_by_boxes(rng):
    patches = rng.normal(size=(400, 4, 4, 3))
    check_inside(patches, (3, 2), rng)
    tiles, boxes = slefe_tiles(patches, 3), slefe_boxes(patches, 3)
    corners = [(slice(a, a + 3), slice(b, b + 3)) for a in (0, 1) for b in (0, 1)]
    low, high = (np.asarray(b) for b in boxes)
    extent = np.max([high[:, u, v] for u, v in corners], 0) - np.min([low[:, u, v] for u, v in corners], 0)
    assert np.median((np.asarray(tiles.upper) - tiles.lower) / extent) < 1.0


def test_quotient_that_breakpoints_do_not_enclose():
    """1/(1+u), one segment: quotients at the breakpoints are 1 and 1/2, their interpolant misses .083 in the middle."""
    patch = np.zeros((1, 2, 2, 4))
    patch[..., 0], patch[0, 0, :, 3], patch[0, 1, :, 3] = 1.0, 1.0, 2.0
    boxes = slefe_boxes(patch, 1)
    quotient = np.asarray(boxes.lower[..., 0] / boxes.lower[..., 3])
    assert np.array_equal(boxes.lower, boxes.upper)
    t = np.linspace(0, 1, 1001)
    gap = np.max(quotient[0, 0, 0] + t * (quotient[0, 1, 0] - quotient[0, 0, 0]) - 1 / (1 + t))
    assert gap == pytest.approx(0.0833, abs=3e-3)
    tiles = slefe_tiles(patch, 1)
    assert tiles.lower[0, 0, 0, 0] <= 0.5
    assert tiles.upper[0, 0, 0, 0] >= 1.0


def test_equal_weights_are_no_weights(rng):
    patches = rng.normal(size=(30, 3, 4, 3))
    weighted = np.concatenate([patches * 7.0, np.full((*patches.shape[:3], 1), 7.0)], axis=-1)
    for one, other in zip(slefe_tiles(patches, 3), slefe_tiles(weighted, 3), strict=True):
        np.testing.assert_allclose(one, other, rtol=0, atol=1e-12)


def test_boxes_shrink_onto_the_surface(rng):
    """The excess over the surface's own extent falls with the square of the tile."""
    patch = rational(rng, 20, (3, 3), 1)
    excess = []
    for m in (8, 16):
        lower, upper = (np.asarray(b) for b in slefe_tiles(patch, m))
        u = np.linspace(0, 1, 8 * m + 1)
        value = np.stack([evaluate_patch(np.moveaxis(patch, 0, -1)[..., None], s, u) for s in u])  # u, xyzw, n, v
        point = value[:, :3] / value[:, 3:]
        own = np.stack(
            [
                [np.ptp(point[8 * i : 8 * i + 9, ..., 8 * j : 8 * j + 9], axis=(0, 3)).T for j in range(m)]
                for i in range(m)
            ]
        )
        excess.append(np.max(upper - lower - np.moveaxis(own, 2, 0), axis=(1, 2, 3)))
    assert np.median(excess[0] / excess[1]) > 3.0


@pytest.mark.parametrize(
    ("weight", "says"),
    [(0.0, r"patch 2 .* has 0"), (-1.0, r"patch 2 .* has -1"), (np.nan, "patch 2"), (np.inf, "patch 2")],
)
def test_weights_must_be_positive(weight, says, rng):
    patches = rational(rng, 4, (2, 2), 1)
    patches[2, 1, 1, 3] = weight
    with pytest.raises(InputError, match=says):
        slefe_tiles(patches, 3)
