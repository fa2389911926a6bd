from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.interpolate import BSpline, NdBSpline

from slefejax import InputError
from slefejax.bounds.bspline import basis_pieces
from slefejax.conversion.nurbs import bezier_axis, spline_patches, uniform_knots
from slefejax.conversion.weld import welded
from slefejax.geometry.bezier import evaluate_curve, evaluate_patch
from slefejax.tessellator.edges import shared_edges


def random_knots(rng, count, degree, clamped, repeats):
    knots = np.sort(rng.uniform(0, 5, count + degree + 1))
    if clamped:
        knots[: degree + 1], knots[count:] = knots[0], knots[-1]
    if repeats and count > degree + 2:
        knots[degree + 1 : degree + 1 + min(repeats, degree, count - degree - 1)] = knots[degree + 1]
    return knots


@given(
    st.integers(1, 6), st.integers(1, 4), st.integers(0, 5), st.integers(0, 4), st.booleans(), st.integers(0, 3),
    st.integers(0, 10**6), st.sampled_from([3, 4]),
)  # fmt: skip
def test_patches_are_the_spline(du, dv, more_u, more_v, clamped, repeats, seed, dimension):
    """Against SciPy's evaluation by de Boor; degrees, knots, repeated knots, rational surfaces at random."""
    rng = np.random.default_rng(seed)
    nu, nv = du + 1 + more_u, dv + 1 + more_v
    ku, kv = random_knots(rng, nu, du, clamped, repeats), random_knots(rng, nv, dv, not clamped, 0)
    control = rng.normal(size=(nu, nv, dimension))
    axes = bezier_axis(ku, du, nu), bezier_axis(kv, dv, nv)
    work = spline_patches(control, axes)
    patches = work.on_host(control.reshape(-1, dimension))
    spline = NdBSpline((ku, kv), control, (du, dv))
    spans_u = [i for i in range(du, nu) if ku[i] < ku[i + 1]]
    spans_v = [j for j in range(dv, nv) if kv[j] < kv[j + 1]]
    assert patches.shape == (len(spans_u) * len(spans_v), du + 1, dv + 1, dimension)
    for k, (i, j) in enumerate((i, j) for i in spans_u for j in spans_v):
        u, v = rng.random((2, 5))
        found = evaluate_patch(patches[k][..., None], u, v).T
        at = np.stack([ku[i] + u * (ku[i + 1] - ku[i]), kv[j] + v * (kv[j + 1] - kv[j])], axis=1)
        # knots may be close together: weights of the blossom are then quotients of small differences
        np.testing.assert_allclose(found, spline(at), atol=1e-9)


def test_neighbours_share_their_points():
    control = np.random.default_rng(1).normal(size=(6, 5, 3))
    work = spline_patches(control, (bezier_axis(uniform_knots(6, 3), 3, 6), bezier_axis(uniform_knots(5, 2), 2, 5)))
    assert work.net.shape == (9, 4, 3)
    assert work.points.rows == 10 * 7
    patches = work.on_host(control.reshape(-1, 3))
    assert np.array_equal(shared_edges(patches), work.edge_numbers)
    assert len(np.unique(work.edge_numbers)) == 24
    np.testing.assert_allclose(work.points.row_sums(), 1.0, atol=1e-15)


def test_uniform_knots_give_the_uniform_spline():
    axis = bezier_axis(uniform_knots(5, 4), 4, 5)
    exact = np.array([[float(c) for c in piece] for piece in reversed(basis_pieces(4))]).T
    np.testing.assert_allclose(axis.rows, exact, atol=1e-16)


def test_a_closed_surface_shares_its_seam_and_a_pole_is_a_point():
    """Control points that coincide are one: a periodic spline closes bit for bit, a row at one place is a point."""
    rng = np.random.default_rng(5)
    ring = rng.normal(size=(7, 6, 3))
    ring[0] = ring[0, 0]
    control = np.concatenate([ring, ring[:, :3]], axis=1)
    knots = np.sort(rng.uniform(0, 1, 4)).cumsum()
    clamped = np.array([0, 0, 0, 0, *(1 + knots[:3]), 9, 9, 9, 9])
    periodic = np.cumsum(np.tile([0.3, 0.7, 1.1, 0.2, 0.9, 0.55], 3))[:13]
    work = spline_patches(control, (bezier_axis(clamped, 3, 7), bezier_axis(periodic, 3, 9)))
    patches = work.on_host(control.reshape(-1, 3))
    assert len(patches) == 4 * 6
    assert np.all(patches[:6, 0] == ring[0, 0])
    uses = np.bincount(shared_edges(patches).ravel())
    assert np.count_nonzero(uses == 1) == 6 + 6, "the far rim, and the edges that are points"
    assert np.array_equal(shared_edges(patches), work.edge_numbers)


@pytest.mark.parametrize("bounds", [(1.0, 3.0), (0.5, 2.25), (2.1, 2.9), (0.0, 5.0 - 1e-12)])
def test_a_part_of_the_domain(bounds):
    """Intervals that the range cuts are cut, exactly."""
    rng = np.random.default_rng(3)
    control = rng.normal(size=8)
    axis = bezier_axis(uniform_knots(8, 3), 3, 8, bounds)
    breaks = [bounds[0], *(k for k in range(6) if bounds[0] < k < bounds[1] - 1e-9), bounds[1]]
    assert len(axis.net) == len(breaks) - 1
    spline = BSpline(uniform_knots(8, 3), control, 3)
    for net, a, b in zip(axis.net, breaks[:-1], breaks[1:], strict=True):
        t = np.linspace(0, 1, 7)
        np.testing.assert_allclose(evaluate_curve((axis.rows @ control)[net], t), spline(a + t * (b - a)), atol=1e-13)


@pytest.mark.parametrize("bounds", [(-1.0, 2.0), (1.0, 7.0), (2.0, 1.0), (3.0, 3.0), (np.nan, 2.0)])
def test_what_is_no_part_of_the_domain(bounds):
    with pytest.raises(InputError, match="is no part of the spline's own, 0 to 5"):
        bezier_axis(uniform_knots(8, 3), 3, 8, bounds)


def test_a_knot_that_parts_the_surface():
    axis = bezier_axis(np.array([0.0, 0, 1, 1, 2, 2]), 1, 4)
    assert axis.net.tolist() == [[0, 1], [2, 3]]
    with pytest.raises(InputError, match="degree 1 is repeated more than 2 times"):
        bezier_axis(np.array([0.0, 0, 1, 1, 1, 2, 2]), 1, 5)


@pytest.mark.parametrize(
    ("knots", "degree", "count", "says"),
    [
        (np.arange(7.0), 3, 4, "needs 8 knots, not 7"),
        (np.array([0, 1, 2, 3, 2, 5, 6, 7.0]), 3, 4, "do not decrease"),
        (np.array([0, 1, 2, 3, np.nan, 5, 6, 7.0]), 3, 4, "do not decrease"),
        (np.zeros(8), 3, 4, "repeated more than 4 times"),
        (np.array([0, 1, 2, 2, 2, 2, 3, 4.0]), 3, 4, "leave no interval"),
        (np.arange(7.0), 3, 3, "at least 4 control points, not 3"),
        (np.arange(7.0), 0, 6, "a degree from 1 to 64, not 0"),
    ],
)
def test_what_are_no_knots(knots, degree, count, says):
    with pytest.raises(InputError, match=says):
        bezier_axis(knots, degree, count)


def quarter(turn, factor=1.0):
    """A patch of an exact cylinder, its weights times a factor."""
    a, b = np.pi / 2 * turn, np.pi / 2 * (turn + 1)
    arc = [[np.cos(a), np.sin(a), 1.0], [0, 0, np.sqrt(0.5)], [np.cos(b), np.sin(b), 1.0]]
    arc[1][:2] = np.sqrt(0.5) * np.array([np.cos(a) + np.cos(b), np.sin(a) + np.sin(b)])
    return factor * np.array([[[x, y, z * w, w] for z in (0.0, 2.0)] for x, y, w in arc])


def test_weights_of_neighbours_are_brought_together():
    patches = np.array([quarter(0), quarter(1, 0.5), quarter(2, 3.7), quarter(3)[::-1] / 9.1])
    same = [patches[0] * 1.0, *(patches[1:] / np.array([0.5, 3.7, 1 / 9.1])[:, None, None, None])]
    assert len(np.unique(shared_edges(patches))) == 16
    made, notes = welded(list(patches), 0.0)
    found = np.stack(made)
    assert "weights of 3 of 4 patches were multiplied by a factor" in notes[0]
    np.testing.assert_allclose(found, same, rtol=1e-14, atol=1e-15)
    assert len(np.unique(shared_edges(found))) == 12
    nudged = found.copy()
    nudged[1, 0] *= 1 + 1e-14
    made, notes = welded(list(nudged), 0.0)
    assert "1 sides within" in notes[0]
    assert len(np.unique(shared_edges(np.stack(made)))) == 12
    given = list(found)
    again, notes = welded(given, 0.0)
    assert again is given
    assert notes == ()


def test_weights_that_cannot_agree_are_refused():
    other = quarter(1)
    other[0, 1] *= 1.5
    with pytest.raises(InputError, match=r"patches 0 and 1 .* edge in common \(u=1 and u=0\).* no multiple"):
        welded([quarter(0), other], 0.0)
    # each pair agrees up to a factor, but the factors around the ring multiply to something else than 1
    ring = np.array([quarter(k) for k in range(4)])
    ring[3, 2] *= 2.0
    with pytest.raises(InputError, match=r"cannot agree along their common edge"):
        welded(list(ring), 0.0)
