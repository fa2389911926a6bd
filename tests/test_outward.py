"""Enclosures hold exactly, with exact arithmetic and no slack, whatever the precision and however bad the numbers."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slefejax import slefe, slefe_boxes, slefe_tiles
from slefejax.bounds.bspline import basis_pieces, bspline_slefe
from slefejax.experiments.checks import reference

DTYPES = [np.float32, np.float64]


def hard(seed: int, shape: tuple[int, ...], dtype: type) -> np.ndarray:
    """Numbers of every kind: spread, far from 0, nearly equal, equal, on a line, huge, tiny."""
    rng = np.random.default_rng(seed)
    numbers = rng.normal(size=shape)
    kind = seed % 7
    if kind == 1:
        numbers += 10.0 ** rng.uniform(0, 6)
    elif kind == 2:
        numbers = 1.0 + 1e-7 * numbers
    elif kind == 3:
        numbers = np.full(shape, numbers.flat[0])
    elif kind == 4:
        numbers = rng.normal() + rng.normal() * np.arange(shape[0]).reshape(-1, *[1] * (len(shape) - 1)) + 0.0 * numbers
    elif kind == 5:
        numbers *= 10.0 ** rng.uniform(-30, 30)
    elif kind == 6:
        numbers *= 10.0 ** rng.uniform(-3, 3, shape)
    return numbers.astype(dtype)


def exact_value(coefficients: list[Fraction], t: Fraction) -> Fraction:
    row = coefficients
    while len(row) > 1:
        row = [(1 - t) * a + t * b for a, b in pairwise(row)]
    return row[0]


def assert_encloses_exactly(lower, upper, places, value):
    """Bounds at 0, 1/m ... 1 of their domain hold the value at places of it, in fractions."""
    ends = [[Fraction(float(x)) for x in np.asarray(bound)] for bound in (lower, upper)]
    m = len(ends[0]) - 1
    for t in places:
        k = min(int(t * m), m - 1)
        share = t * m - k
        low, high = ((1 - share) * bound[k] + share * bound[k + 1] for bound in ends)
        assert low <= value(t) <= high


@pytest.mark.parametrize("dtype", [np.float32, pytest.param(np.float64, marks=pytest.mark.slow)])
@given(st.integers(0, 10**6), st.integers(1, 9), st.integers(1, 6))
def test_curves(dtype, seed, degree, segments):
    curve = hard(seed, (degree + 1,), dtype)
    lower, upper = slefe(curve, segments)
    assert lower.dtype == dtype
    coefficients = [Fraction(float(c)) for c in curve]
    places = [Fraction(k, 3 * segments) for k in range(3 * segments + 1)]
    assert_encloses_exactly(lower, upper, places, lambda t: exact_value(coefficients, t))


@pytest.mark.parametrize("dtype", [np.float64, pytest.param(np.float32, marks=pytest.mark.slow)])
@given(st.integers(0, 10**6), st.integers(1, 4), st.integers(1, 3), st.integers(1, 5))
def test_splines(dtype, seed, degree, segments, intervals):
    points = hard(seed, (degree + intervals,), dtype)
    lower, upper = bspline_slefe(points, degree, segments)
    exact = [Fraction(float(c)) for c in points]
    pieces = [list(piece) for piece in reversed(basis_pieces(degree))]

    def value(t: Fraction) -> Fraction:
        i = min(int(t * intervals), intervals - 1)
        share = t * intervals - i
        return sum((exact_value(pieces[r], share) * exact[i + r] for r in range(degree + 1)), Fraction(0))

    places = [Fraction(k, 3 * segments * intervals) for k in range(3 * segments * intervals + 1)]
    assert_encloses_exactly(lower, upper, places, value)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("shape", [(2, 2), (4, 4), pytest.param((3, 5), marks=pytest.mark.slow)])
def test_patches(dtype, shape):
    """Bilinear interpolants of the boxes hold all points, with sixty digits."""
    patches = np.stack([hard(seed, (*shape, 3), dtype) for seed in range(21)])
    for segments in ((1, 1), (3, 2)):
        lower, upper = (reference.exact(bound) for bound in slefe_boxes(patches, segments))
        excess, _ = reference.outside(reference.exact(patches), lower, upper)
        assert np.all(excess <= 0)


@pytest.mark.parametrize("dtype", DTYPES)
@pytest.mark.parametrize("dimension", [3, 4])
def test_tiles(dtype, dimension):
    """Boxes of tiles hold all points on them, of rational patches with weights over decades too."""
    segments, patches = (2, 3), np.stack([hard(seed, (4, 3, dimension), dtype) for seed in range(28)])
    if dimension == 4:
        weights = 10.0 ** np.random.default_rng(1).uniform(-1, 1, patches.shape[:3]) ** np.array(3)
        patches[..., 3] = weights
        patches[..., :3] = (patches[..., :3] * patches[..., 3:]).astype(dtype)
    lower, upper = (reference.exact(bound) for bound in slefe_tiles(patches, segments))
    exact = reference.exact(patches)
    for i in range(segments[0]):
        for j in range(segments[1]):
            for a, b in ((0, 0), (1, 2), (2, 3), (3, 1), (3, 3)):
                u, v = reference.MP.mpf(3 * i + a) / (3 * segments[0]), reference.MP.mpf(3 * j + b) / (3 * segments[1])
                point = reference.surface(exact, u, v)
                place = point[:, :3] / point[:, 3:] if dimension == 4 else point
                assert np.all(lower[:, i, j] <= place)
                assert np.all(place <= upper[:, i, j])


@pytest.mark.parametrize("dtype", DTYPES)
def test_what_it_costs(dtype, rng):
    """Rounding outwards makes a slefe of degree 3 wider by some 40 eps of the largest coefficient."""
    curves = rng.normal(size=(4, 1000)).astype(dtype)
    lower, upper = (np.asarray(bound, np.float64) for bound in slefe(curves, 3, axis=0))
    plain = [np.asarray(bound, np.float64) for bound in slefe(curves.astype(np.float64), 3, axis=0)]
    wider = (upper - lower) - (plain[1] - plain[0])
    size = np.finfo(dtype).eps * np.abs(curves).max(axis=0)
    assert np.all(wider <= 48 * size)
