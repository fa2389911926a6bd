"""The inequalities of docs/certified.md, each by itself, against dense sampling."""

from __future__ import annotations

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax.bounds.triangles import _CUBIC, AnyTriangle, HalfCells
from slefejax.geometry.bezier import evaluate_patch
from slefejax.geometry.projection import Projection
from slefejax.lanes import layout, loops, nets
from slefejax.lanes.maxima import EXACT
from slefejax.predict.certified import _ROUNDING, Piece, Screen, certified_factor
from slefejax.tessellator.direct3d11 import rings
from slefejax.tessellator.levels import GRID, HIGHEST_LEVEL, shares
from slefejax.tessellator.rings import direct3d11

from .hostile import case

HESSIANS = np.random.default_rng(3).normal(size=(3, 500)) * 10.0 ** np.random.default_rng(4).uniform(-2, 2, (3, 500))


def half_cell(count: int = 60) -> tuple[np.ndarray, np.ndarray]:
    """Points (p, q) of the triangle (0,0), (1,0), (1,1)."""
    p, q = np.meshgrid(np.linspace(0, 1, count), np.linspace(0, 1, count))
    return p[q <= p], q[q <= p]


def test_second_moments_of_half_a_cell():
    """(5): a P + 2 b B + c Q is at most sigma max(P, Q), and gets there."""
    p, q = half_cell()
    a, b, c = HESSIANS[:, :, None]
    big_p, big_q, big_b = p * (1 - p), q * (1 - q), q * (1 - p)
    for sign in (1, -1):  # the other diagonal
        left = np.abs(a * big_p + 2 * sign * b * big_b + c * big_q)
        sigma = np.asarray(HalfCells().bend(*HESSIANS))
        assert np.all(left <= sigma[:, None] * np.maximum(big_p, big_q) * (1 + 1e-12))
    both = [np.abs(a * big_p + 2 * s * b * big_b + c * big_q).max(axis=1) for s in (1, -1)]
    np.testing.assert_allclose(np.maximum(*both) * 4, sigma, rtol=2e-3)


def test_cells_that_are_narrower_one_way():
    """The measure for uneven cells is at least that of all of them."""
    a, b, c = HESSIANS
    for evenness in (0.0, 0.5, 0.98):
        bound = np.asarray(HalfCells(evenness=evenness).bend(a, b, c))
        for s in np.linspace(evenness, 1, 9):
            for t in np.linspace(evenness, 1, 9):
                assert np.all(HalfCells().bend(a * s * s, b * s * t, c * t * t) <= bound * (1 + 1e-12))


def test_any_triangle_in_a_box():
    """The largest |a x^2 + 2 b x z + c z^2| over the square is at most the measure, and mostly not much smaller."""
    x, z = np.meshgrid(np.linspace(-1, 1, 201), np.linspace(-1, 1, 201))
    a, b, c = HESSIANS
    largest = np.array([np.abs(i * x * x + 2 * j * x * z + k * z * z).max() for i, j, k in HESSIANS.T])
    ratio = np.asarray(AnyTriangle().bend(a, b, c)) / largest
    assert ratio.min() >= 1 - 1e-12
    assert ratio.max() <= 1.25 + 1e-3
    half = np.asarray(HalfCells().bend(a, b, c))
    assert np.all(half <= np.asarray(AnyTriangle().bend(a, b, c)) * (1 + 1e-12))


def test_moments_of_triangles_in_a_box(rng):
    """At any point of any triangle: second, third and fourth moments along an axis."""
    corners = rng.uniform(0, 1, (2000, 3, 2))
    shares = rng.dirichlet(np.ones(3), 2000)
    offset = corners - (shares[:, :, None] * corners).sum(axis=1, keepdims=True)
    sides = np.ptp(corners, axis=1)
    for power, largest in ((2, 1 / 4), (3, 1 / 8), (4, 1 / 12)):
        moment = (shares[:, :, None] * np.abs(offset) ** power).sum(axis=1)
        assert np.all(moment <= largest * sides**power * (1 + 1e-12))
    mixed = (shares * np.abs(offset[..., 0] * offset[..., 1])).sum(axis=1)
    assert np.all(mixed <= sides.prod(axis=1) / 4 * (1 + 1e-12))


@pytest.mark.parametrize("least", [1.0, 3.0])
def test_third_order_of_half_a_cell(rng, least):
    """(6) for random cubics, cells of 1/n with n >= m, at all points of half a cell."""
    p, q = half_cell(40)
    monomials = [(i, j) for i in range(4) for j in range(4 - i)]
    for _ in range(200):
        n = least * rng.uniform(1.0, 3.0)
        weights = {ij: rng.normal() * (0.05 if rng.random() < 0.5 and sum(ij) == 2 else 1.0) for ij in monomials}
        u, v = p / n, q / n

        def value(u, v, i=0, j=0, weights=weights):
            """The derivative (i, j) of the cubic."""
            total = np.zeros(np.shape(u))
            for (k, m), weight in weights.items():
                if k >= i and m >= j:
                    scale = np.prod(np.arange(k - i + 1, k + 1)) * np.prod(np.arange(m - j + 1, m + 1))
                    total = total + weight * scale * u ** (k - i) * v ** (m - j)
            return total

        f00, f10, f11 = value(0.0, 0.0), value(1 / n, 0.0), value(1 / n, 1 / n)
        error = np.abs(value(u, v) - (f00 + p * (f10 - f00) + q * (f11 - f10)))
        along_u = abs(value(0.0, 0.0, 3, 0)) + 3 * abs(value(0.0, 0.0, 2, 1))
        along_v = abs(value(0.0, 0.0, 0, 3)) + 3 * abs(value(0.0, 0.0, 1, 2))
        more, less = max(along_u, along_v), min(along_u, along_v)
        second = np.asarray(
            HalfCells().bend(*(jnp.asarray(value(u, v, *order)) for order in ((2, 0), (1, 1), (0, 2))), maxima=EXACT)
        )
        bound = np.maximum(second, more / least) / (8 * n**2) + (_CUBIC * more + less / 288) / n**3
        assert np.all(error <= bound * (1 + 1e-9) + 1e-15)


def test_bilinear_products(rng):
    """Coefficients of the product, in both forms of nets, against values."""
    net, corners = rng.normal(size=(3, 4, 7)), rng.normal(size=(2, 2, 7))
    lists = nets.objects([[jnp.asarray(c) for c in row] for row in net])
    product = np.asarray(nets.bilinear_times(corners, jnp.asarray(net)))
    np.testing.assert_allclose(nets.stacked(nets.bilinear_times(corners, lists)), product, rtol=1e-12)
    for u, v in rng.uniform(size=(5, 2)):
        place = partial(evaluate_patch, u=np.array([u]), v=np.array([v]))
        for lane in range(7):
            values = [place(x[..., lane][:, :, None, None])[0, 0] for x in (net, corners, product)]
            assert values[0] * values[1] == pytest.approx(values[2], rel=1e-12)


@pytest.mark.parametrize("seed", [11, pytest.param(30, marks=pytest.mark.slow)])
@pytest.mark.parametrize(
    "triangles", [HalfCells((0.8, 1.25), 0.9), pytest.param(AnyTriangle((0.8, 1.25)), marks=pytest.mark.slow)]
)
def test_both_forms_of_nets_are_one_computation(seed, triangles):
    hostile = case(seed, 64)
    packed, projection = jnp.asarray(layout.pack(hostile.patches)), Projection.of(hostile.view)
    found = []
    for unrolled in (True, False):

        def kernel(control, unrolled=unrolled):
            near = projection.relative(control)
            return certified_factor(near, projection, (0.5, 1e-3), triangles, tiles=2, unrolled=unrolled)

        found.append(jax.jit(lambda p, kernel=kernel: loops.over_chunks(kernel, p))(packed))
    np.testing.assert_allclose(*found, rtol=1e-9)


@pytest.mark.parametrize("offset", [-3.0, 0.0, 3.0])
def test_ends_of_the_part_of_the_picture(rng, offset):
    """Coefficients that rounding moved by as much as is allowed still lie between both ends: W up as well as down.

    With roundings of 1e-4 instead of 1e-16, so that the wrong end of W shows.
    """
    eps, lanes = 1e-4, 200
    x = jnp.asarray(offset + rng.uniform(-1.0, 1.0, (3, 3, lanes)))
    w = jnp.asarray(rng.uniform(0.5, 2.0, (3, 3, lanes)))
    size, half = jnp.full(lanes, 4.0), jnp.asarray(100.0)
    floor, ones = jnp.full(lanes, 0.1), jnp.ones(lanes)
    screen = Screen([x], w, [half], floor, [size], 2.0 * ones, eps, ones > 0, False, None)
    piece = Piece.of(screen, None, None, 1)
    (low, high), error = (np.asarray(end) for end in piece.ends[0]), _ROUNDING * eps
    assert np.all(np.asarray(piece.within[0]))
    for x_sign in (-1, 1):
        for w_sign in (-1, 1):
            moved = (np.asarray(x) + x_sign * error * 4.0) / (np.asarray(w) + w_sign * error * 2.0)
            # both are rounded in their last digits
            assert np.all(low <= moved.min(axis=(0, 1)) + 1e-12)
            assert np.all(moved.max(axis=(0, 1)) - 1e-12 <= high)
            assert np.all(1.0 / (np.asarray(w) + w_sign * error * 2.0) <= np.asarray(piece.inverse) * (1 + 1e-15))
    exact = np.asarray(x) / np.asarray(w)
    assert np.all(high - low <= np.ptp(exact, axis=(0, 1)) + 8.0 * error * (4.0 + 12.0 * 2.0) / 0.45)


def test_rings_whose_vertices_lie_at_k_over_n():
    """In a picture with patches in pieces no triangle of a ring is longer than is assumed; as with 16 bits some are."""
    pattern, levels = direct3d11(), np.arange(HIGHEST_LEVEL + 1)
    n, m = (x.ravel() for x in np.meshgrid(levels[2:], levels[1:], indexing="ij"))
    pair, corners = rings(n, m)
    count = np.where(corners >= 0, m[pair, None], n[pair, None])
    extent = np.ptp(shares(np.abs(corners), count) * GRID, axis=1)
    assert np.all(extent <= pattern.fine_reach[n[pair], m[pair]] + GRID)
    assert np.max(extent - pattern.reach[n[pair], m[pair]]) > 2e-4
    assert np.max(pattern.fine_reach - pattern.reach) < 5e-4


def test_lines_of_24_bits_lie_between_those_of_16():
    """Cells of k/n placed with 24 bits are neither wider nor narrower than the pattern says of 16 bits, or 1/n."""
    pattern = direct3d11()
    for n in range(2, HIGHEST_LEVEL + 1):
        widths = np.diff(shares(np.arange(n + 1), np.full(n + 1, n)) * GRID)
        assert widths.max() <= pattern.cells(np.array(n))
        assert widths.min() >= pattern.cells(np.array(n)) * pattern.narrowest(np.array(n))
    for n in (65, 100, 1000, 16383, 16384):
        widths = np.diff(shares(np.arange(n + 1), np.full(n + 1, n)) * GRID)
        assert widths.max() <= pattern.cells(np.array(n))
        assert widths.min() >= pattern.cells(np.array(n)) * pattern.narrowest(np.array(n))
