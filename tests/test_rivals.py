from __future__ import annotations

import numpy as np
import pytest

from slefejax import InputError
from slefejax.bounds.optimum import optimal_curve, optimal_patch
from slefejax.bounds.rivals import (
    BATCH_METHODS,
    CURVE_METHODS,
    SURFACE_METHODS,
    batch_widths,
    enclose_curve,
    enclose_surface,
    polygon_distance,
)
from slefejax.geometry.bezier import evaluate_curve, evaluate_patch
from slefejax.testing import assert_encloses

STEP = np.array([0.0, -1.0, 1.0, 0.0])  # the step-like cubic of [YBP12], figure 2
WORST = np.array([0.0, -2 / 3, -1 / 3, 0.0])  # second differences (1, 0)


def inside(outline, points, slack):
    """Whether points lie in a convex outline, to within slack."""
    centre = outline.mean(axis=0)
    a, b = outline, np.roll(outline, -1, axis=0)
    normal = np.stack([(b - a)[:, 1], (a - b)[:, 0]], axis=-1)
    normal *= -np.sign(np.sum(normal * (centre - a), axis=1, keepdims=True))
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.divide(normal, length, out=np.zeros_like(normal), where=length > 0)
    return np.all(np.einsum("nkc,kc->nk", points[:, None] - a, normal) <= slack, axis=1)


@pytest.mark.parametrize("pieces", [3, 6])
@pytest.mark.parametrize("method", CURVE_METHODS)
def test_regions_hold_the_curve(method, pieces, rng):
    for curve in [STEP, WORST, np.array([0.0, 1.0, 2.0, 3.0]), *rng.normal(size=(5, 4))]:
        found = enclose_curve(method, curve, pieces)
        for i, region in enumerate(found.regions):
            t = np.linspace(i / len(found.regions), (i + 1) / len(found.regions), 33)
            points = np.column_stack([t, evaluate_curve(curve, t)])
            if len(region) > 2:
                # a disc is drawn as a polygon of 180 corners
                assert np.all(inside(region, points, 1e-3 if method == "disc" else 1e-9)), (curve, i)
        assert found.width >= 0
        assert found.area >= 0


@pytest.mark.parametrize(
    ("method", "width"),
    [("slefe", 0.0695214343), ("optimum", 0.0695214343), ("filip", 2 * 0.75 / 9), ("control-polygon", 2 / 3)],
)
def test_numbers_of_the_worst_cubic(method, width):
    """docs/math.md, 2, 5 and 10: .0695; Filip's one-sided 6/8, .083 in three pieces; N(3) = 1/3 on either side."""
    assert enclose_curve(method, WORST, 3).width == pytest.approx(width, abs=1e-9)
    assert enclose_curve("filip", WORST, 1).width == pytest.approx(2 * 0.75)
    assert enclose_curve("min-max", WORST, 1).width == pytest.approx(2 / 3)


def test_boxes_and_disc_of_the_step_by_hand():
    """Control points (0,0) (1/3,-1) (2/3,1) (1,0): hull a parallelogram of area 1, its longest vertical is 1.5 high."""
    hull = enclose_curve("convex-hull", STEP, 1)
    assert hull.area == pytest.approx(1.0)
    assert hull.width == pytest.approx(1.5)
    assert enclose_curve("min-max", STEP, 1).area == pytest.approx(2.0)
    box = enclose_curve("oriented-box", STEP, 1)
    assert hull.area < box.area < 2.0
    # the two inner points are furthest apart, and the outer ones lie inside of their circle
    assert enclose_curve("disc", STEP, 1).width == pytest.approx(np.hypot(1 / 3, 2.0))


def test_disc_of_an_obtuse_triangle_is_the_one_on_its_longest_side():
    assert enclose_curve("disc", [0.0, 0.001, 0.0], 1).width == pytest.approx(1.0)


@pytest.mark.parametrize("degree", [2, 3, 4, 5, 8])
def test_control_polygon_distance_is_sharp(degree):
    """All second differences 1: at the middle the distance is attained."""
    curve = 0.5 * np.arange(degree + 1.0) ** 2
    t = np.linspace(0, 1, 1001)
    polygon = np.interp(t, np.linspace(0, 1, degree + 1), curve)
    distance = np.max(np.abs(polygon - evaluate_curve(curve, t)))
    assert distance <= polygon_distance(degree) + 1e-12
    assert distance == pytest.approx(polygon_distance(degree), rel=0.3)


@pytest.mark.parametrize("pieces", [1, 2, 3, 5])
@pytest.mark.parametrize("degree", [2, 3, *(pytest.param(x, marks=pytest.mark.slow) for x in (5, 9))])
def test_optimum_encloses_and_nothing_is_narrower(degree, pieces, rng):
    for curve in rng.normal(size=(6, degree + 1)):
        lower, upper = optimal_curve(curve, pieces)
        assert_encloses(lower, upper, lambda t, c=curve: evaluate_curve(c, t), slack=1e-9)
        width = enclose_curve("optimum", curve, pieces).width
        for method in ("slefe", "filip", "min-max"):
            assert width <= enclose_curve(method, curve, pieces).width * (1 + 1e-8) + 1e-9


def test_optimum_against_a_plain_program_on_fixed_samples(rng):
    """The program over 2,100 samples, breakpoints among them, but no cutting planes: the same width, from below."""
    from scipy.optimize import linprog

    curve, pieces = rng.normal(size=5), 3
    t = np.linspace(0, 1, 2101)
    hat = np.maximum(0, 1 - np.abs(t[:, None] * pieces - np.arange(pieces + 1)))
    p, n = evaluate_curve(curve, t), pieces + 1
    a = np.block(
        [
            [hat, np.zeros_like(hat), np.zeros((len(t), 1))],
            [np.zeros_like(hat), -hat, np.zeros((len(t), 1))],
            [-np.eye(n), np.eye(n), -np.ones((n, 1))],
        ]
    )
    found = linprog([0] * (2 * n) + [1], A_ub=a, b_ub=[*p, *-p, *[0] * n], bounds=(None, None))
    assert enclose_curve("optimum", curve, pieces).width == pytest.approx(found.fun, rel=1e-5)
    assert enclose_curve("optimum", curve, pieces).width >= found.fun - 1e-12


def test_optimum_of_a_parabola_by_hand():
    """Width of the best enclosure of u^2 with m pieces: a quarter of the squared length, between chord and tangent."""
    for pieces in (1, 2, 4):
        assert enclose_curve("optimum", [0, 0, 1], pieces).width == pytest.approx(0.25 / pieces**2, rel=1e-8)


@pytest.mark.parametrize("method", SURFACE_METHODS)
def test_surfaces_are_no_wider_than_their_bounds(method, rng):
    """The width is at least that of the optimum, and for a function of u alone that of the curve."""
    along = np.repeat(STEP[:, None], 4, axis=1)
    pieces = 3
    if method in ("min-max", "slefe", "optimum", "control-polygon"):
        curve = enclose_curve(method, STEP, pieces).width
        assert enclose_surface(method, along, pieces).width == pytest.approx(curve, rel=3e-4)
    elif method == "filip":
        assert enclose_surface(method, along, pieces).width == pytest.approx(0.5)
    net = rng.normal(size=(4, 4))
    assert enclose_surface(method, net, pieces).width >= enclose_surface("optimum", net, pieces).width * (1 - 1e-4)


def test_optimal_patch_encloses(rng):
    net = rng.normal(size=(4, 3))
    lower, upper = (b.reshape(3, 3) for b in optimal_patch(net, 2))
    assert_encloses(lower, upper, lambda u, v: evaluate_patch(net, u, v), parameters=2, samples=41, slack=1e-4)


@pytest.mark.parametrize("method", BATCH_METHODS)
def test_batches_give_the_same_numbers(method, rng):
    curves = rng.normal(size=(4, 9))
    for pieces in (3, 6):
        single = [enclose_curve(method, curve, pieces).width for curve in curves.T]
        np.testing.assert_allclose(batch_widths(method, curves, pieces), single, rtol=0, atol=1e-13)


def test_flat_functions_have_no_width():
    for method in CURVE_METHODS:
        assert enclose_curve(method, np.zeros(4), 3).width == pytest.approx(1 / 3 if method == "disc" else 0, abs=1e-12)
    for method in SURFACE_METHODS:
        assert enclose_surface(method, np.zeros((4, 4)), 3).width == pytest.approx(0.0, abs=1e-9)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda: enclose_curve("magic", STEP, 3), "no bound of curves 'magic'"),
        (lambda: enclose_surface("disc", np.zeros((2, 2)), 3), "no bound of surfaces 'disc'"),
        (lambda: enclose_curve("slefe", STEP, 0), "segments"),
        (lambda: enclose_curve("slefe", [1.0], 3), "at least two"),
        (lambda: enclose_curve("slefe", [1.0, np.nan], 3), "finite"),
        (lambda: enclose_curve("control-polygon", STEP, 4), "no multiple"),
    ],
)
def test_bad_arguments(call, says):
    with pytest.raises(InputError, match=says):
        call()
