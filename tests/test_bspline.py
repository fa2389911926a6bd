from __future__ import annotations

from fractions import Fraction

import jax
import numpy as np
import pytest
from scipy.interpolate import BSpline

from slefejax import InputError, bspline_slefe, bspline_slefe_boxes, slefe
from slefejax.bounds.bspline import basis_pieces
from slefejax.testing import assert_encloses


def spline(control, degree):
    """SciPy's uniform spline on t in [0, 1], whatever its number of knot intervals."""
    intervals = len(control) - degree
    curve = BSpline(np.arange(len(control) + degree + 1) - degree, control, degree)
    return lambda t: curve(min(t * intervals, np.nextafter(intervals, 0)))


def as_bezier(control, degree):
    """Bézier coefficients of every knot interval, from the exact pieces of the basis."""
    pieces = np.array([[float(c) for c in piece] for piece in reversed(basis_pieces(degree))])
    return [pieces.T @ control[i : i + degree + 1] for i in range(len(control) - degree)]


@pytest.mark.parametrize("segments", [1, 3, *(pytest.param(m, marks=pytest.mark.slow) for m in (2, 5))])
@pytest.mark.parametrize("degree", [1, 2, 3, 5, *(pytest.param(d, marks=pytest.mark.slow) for d in (4, 7))])
def test_splines_stay_inside(degree, segments, rng, precision):
    for more in (1, 2, 5, 9):
        control = rng.normal(size=(degree + more, 40)).astype(precision)
        lower, upper = bspline_slefe(control, degree, segments, axis=0)
        assert lower.shape == (more * segments + 1, 40)
        assert lower.dtype == upper.dtype == precision
        control = control.astype(float)
        assert_encloses(lower, upper, spline(control, degree), samples=40 * more * segments + 1)


def test_basis_pieces_by_hand():
    """The uniform cubic: 1/6 (t^3), and so on; every degree adds up to 1 and is symmetric."""
    sixth = Fraction(1, 6)
    assert basis_pieces(3)[0] == (0, 0, 0, sixth)
    assert basis_pieces(3)[1] == (sixth, 2 * sixth, 4 * sixth, 4 * sixth)
    for degree in range(8):
        pieces = basis_pieces(degree)
        assert all(sum(column) == 1 for column in zip(*pieces, strict=True))
        assert pieces == tuple(piece[::-1] for piece in pieces[::-1])


@pytest.mark.parametrize("degree", [2, 3, 4])
def test_one_interval_of_a_spline_is_a_bezier_curve(degree, rng):
    """A single knot interval has no other breakpoints to trade with; its gaps are those of its own bumps."""
    control = rng.normal(size=degree + 1)
    lower, upper = bspline_slefe(control, degree, 3)
    own = as_bezier(control, degree)[0]
    np.testing.assert_allclose((spline(control, degree)(0), spline(control, degree)(1)), own[[0, -1]], atol=1e-14)
    assert_encloses(lower, upper, spline(control, degree))
    assert np.max(upper - lower) < 3 * np.max(np.subtract(*slefe(own, 3)[::-1]))


def test_no_wider_than_interval_by_interval(rng):
    """Median over random cubic splines of the width over that of the Bézier pieces' slefes."""
    ratios = []
    for _ in range(200):
        control = rng.normal(size=12)
        width = np.max(np.subtract(*bspline_slefe(control, 3, 3)[::-1]))
        ratios.append(width / max(np.max(np.subtract(*slefe(c, 3)[::-1])) for c in as_bezier(control, 3)))
    assert np.median(ratios) < 1.0


def test_straight_control_points_have_no_width():
    lower, upper = bspline_slefe(np.arange(9.0) * 0.25, 3, 4)
    np.testing.assert_allclose(lower, upper, atol=1e-15)
    np.testing.assert_allclose(lower, np.linspace(0.25, 1.75, 25), atol=1e-14)


def test_reversal_and_affine_maps(rng):
    control = rng.normal(size=9)
    lower, upper = (np.asarray(b) for b in bspline_slefe(control, 3, 2))
    turned = bspline_slefe(control[::-1].copy(), 3, 2)
    np.testing.assert_allclose(turned.lower, lower[::-1], atol=1e-14)
    mapped = bspline_slefe(2.0 - 3.0 * control, 3, 2)
    np.testing.assert_allclose(mapped.lower, 2.0 - 3.0 * upper, atol=1e-13)


def test_tensor_product_splines_stay_inside(rng):
    net = rng.normal(size=(5, 6))
    boxes = bspline_slefe_boxes(net, 3, (2, 3))
    assert boxes.lower.shape == (2 * 2 + 1, 3 * 3 + 1)

    def surface(u, v):
        rows = np.array([spline(row, 3)(v) for row in net])
        return spline(rows, 3)(u)

    assert_encloses(boxes.lower, boxes.upper, surface, parameters=2, samples=61)


def test_gradient_and_float32(rng):
    control = rng.normal(size=8)

    def total(c):
        return sum(b.sum() * s for b, s in zip(bspline_slefe(c, 3, 2), (-1.0, 1.0), strict=True))

    h = 1e-6
    numeric = [(total(control + h * e) - total(control - h * e)) / (2 * h) for e in np.eye(8)]
    np.testing.assert_allclose(jax.grad(total)(jax.numpy.asarray(control)), numeric, rtol=1e-6, atol=1e-8)
    assert bspline_slefe(control.astype(np.float32), 3, 2).lower.dtype == np.float32


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (([1.0, 2.0, 3.0], 3, 2), "at least 4 control points"),
        (([1.0, 2.0], 0, 2), "degree of a spline"),
        (([1.0, 2.0], 1.5, 2), "degree of a spline"),
        (([1.0, 2.0, 3.0, 4.0], 3, 0), "segments"),
        (([[1.0], [2.0, 3.0]], 1, 2), "different lengths"),
    ],
)
def test_bad_arguments(arguments, says):
    with pytest.raises(InputError, match=says):
        bspline_slefe(*arguments)
