"""Bounds of the terms that turn around the corners of Gregory patches, and the certificate that rests on them."""

from __future__ import annotations

from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import (
    Camera,
    GregoryPatches,
    View,
    load,
    sampled_error,
    tessellation_factors,
    triangle_error,
    triangulate,
)
from slefejax.bounds.twists import any_errors, even_errors, on_box, spreads
from slefejax.geometry.bezier import elevate, evaluate_patch
from slefejax.geometry.gregory import Twisted, lowered, twist_basis
from slefejax.tessellator.rings import direct3d11

SLOTS = [4, 6]


def terms(slots, places):
    return np.stack(twist_basis(slots, places[..., 0], places[..., 1]))


def places_near_corners(rng, count):
    """In the unit square, many of them near its sides and corners."""
    found = rng.uniform(size=(count, 2)) ** rng.choice([1.0, 3.0, 8.0], size=(count, 2))
    return np.where(rng.uniform(size=(count, 2)) < 0.5, found, 1.0 - found)


@pytest.mark.parametrize("slots", SLOTS)
def test_terms_lie_between_their_spreads(slots, rng):
    places = places_near_corners(rng, 20_000)
    table = np.moveaxis(spreads(slots, 3 if slots == 4 else 4), 0, -1)[..., None]
    bound = evaluate_patch(table, *places.T)
    assert np.all(np.abs(terms(slots, places)) <= bound + 1e-15)


def seconds(function, places):
    """Sizes of uu, uv, vv of functions ``(functions, places)``."""
    found = np.abs(np.asarray(jax.jit(jax.vmap(jax.hessian(function)))(jnp.asarray(places))))
    return found[..., 0, 0].T, found[..., 0, 1].T, found[..., 1, 1].T


@pytest.mark.parametrize("slots", SLOTS)
def test_second_derivatives_of_terms(slots, rng):
    """Of b z: at most 18, 9/2, 18 and 27 together; of triangles 24, 6, 24 and 36. Nearly attained."""
    places = np.clip(places_near_corners(rng, 60_000), 1e-7, 1.0 - 1e-7)
    uu, uv, vv = seconds(lambda place: jnp.stack(twist_basis(slots, *place)), places)
    for own, size in ((slice(0, 4), 18.0), (slice(4, slots), 24.0)):
        if own.start < own.stop:
            assert all(x[own].max() <= size for x in (uu, vv, 4.0 * uv))
            whole = uu[own] + 2.0 * uv[own] + vv[own]
            assert 1.45 * size < whole.max() <= 1.5 * size + 1e-9


def test_second_derivatives_with_one_of_both_face_points(rng):
    """Without the mean, C chi P: 18, 9, 18 and 36 together; of triangles in barycentric coordinates 24, 12, 24, 48."""

    def quad(place):
        s, t = place
        return jnp.stack([9.0 * ((1 - s) * (1 - t)) ** 2 * s * t * t / (s + t)])

    def triangle(place):
        b, c = place
        return jnp.stack([12.0 * (1 - b - c) ** 2 * b * c * c / (b + c)])

    places = np.clip(places_near_corners(rng, 60_000), 1e-7, 1.0 - 1e-7)
    for function, size, own in ((quad, 18.0, places), (triangle, 24.0, places[places.sum(axis=1) < 1.0])):
        uu, uv, vv = seconds(function, own)
        whole = uu + 2.0 * uv + vv
        assert max(uu.max(), vv.max(), 2.0 * uv.max()) <= size * (1 + 1e-9)
        assert 1.9 * size < whole.max() <= 2.0 * size * (1 + 1e-9)


def test_derivatives_of_the_quotient():
    """w_ss = 2 y^3, w_st = 1/2 - 3 y^2 + 2 y^3, w_tt = -2 (1-y)^3 and the third derivative, against fractions."""
    h = Fraction(1, 10**15)

    def w(s, t):
        return s * t * (s - t) / (2 * (s + t))

    for s, t in (
        (Fraction(1, 3), Fraction(1, 7)),
        (Fraction(1, 1000), Fraction(2, 5)),
        (Fraction(4, 5), Fraction(1, 9)),
    ):
        y = float(t / (s + t))
        ss = (w(s + h, t) - 2 * w(s, t) + w(s - h, t)) / h**2
        tt = (w(s, t + h) - 2 * w(s, t) + w(s, t - h)) / h**2
        st = (w(s + h, t + h) - w(s + h, t - h) - w(s - h, t + h) + w(s - h, t - h)) / (4 * h**2)
        wanted = [2 * y**3, 0.5 - 3 * y**2 + 2 * y**3, -2 * (1 - y) ** 3]
        np.testing.assert_allclose([float(ss), float(st), float(tt)], wanted, atol=1e-12)
        x, z = Fraction(3, 4), Fraction(-1, 2)
        third = sum(c * w(s + k * h * x, t + k * h * z) for k, c in ((2, 1), (1, -2), (-1, 2), (-2, -1))) / (2 * h**3)
        assert float(third) == pytest.approx(-6 * (y * 0.75 + (1 - y) * 0.5) ** 3 / float(s + t), rel=1e-12)


def interpolation_errors(slots, places, corners):
    """|f - I f| of all terms at places, of which I is drawn from barycentric shares of corners ``(n, 3, 2)``."""
    a, b, c = np.moveaxis(corners, 1, 0)
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    p = places - a
    y = (p[:, 0] * (c - a)[:, 1] - p[:, 1] * (c - a)[:, 0]) / area
    z = ((b - a)[:, 0] * p[:, 1] - (b - a)[:, 1] * p[:, 0]) / area
    share = np.stack([1 - y - z, y, z], axis=1)
    drawn = np.einsum("nk,snk->sn", share, terms(slots, corners))
    return np.abs(terms(slots, places) - drawn)


@pytest.mark.parametrize("slots", SLOTS)
def test_errors_on_even_grids(slots, rng):
    """n^2 times the error at a place is at most the polynomial there; of lines as tessellators place them, too."""
    degree = 3 if slots == 4 else 4
    table = np.moveaxis(even_errors(slots, degree), 0, -1)[..., None]
    lines, largest = direct3d11().lines(False), 0.0
    for n in (1, 2, 3, 5, 8, 13, 21, 34, 55, 64, 300, 5000):
        places = places_near_corners(rng, 3000)
        many = min(n, 1000)
        beside = np.stack([(np.arange(many) + 0.5) / n, np.full(many, 0.5 / n)], axis=1)
        places[: 2 * many] = np.concatenate([beside, beside[:, ::-1]])
        bound = evaluate_patch(table, *places.T)
        for at in (np.arange(n + 1) / n, *(lines[n : n + 1, : n + 1] if n <= 64 else ())):
            cell = np.clip(np.searchsorted(at, places, side="right") - 1, 0, n - 1)
            low, high = at[cell], at[cell + 1]
            x, y = ((places - low) / (high - low)).T
            for rising in (True, False):
                far = x >= y if rising else x + y >= 1.0
                falls = np.stack([high[:, 0], low[:, 1]], 1), np.stack([low[:, 0], high[:, 1]], 1)
                ends, others = ([low, high], falls) if rising else (list(falls), (high, low))
                third, other = others
                corners = np.stack([*ends, np.where(far[:, None], third, other)], axis=1)
                error = n * n * interpolation_errors(slots, places, corners)
                assert np.all(error <= bound + 1e-9)
                largest = max(largest, float(np.max(error[-1 if slots > 4 else 0])))
    assert largest > (3.8 if slots > 4 else 3.0)


@pytest.mark.parametrize("slots", SLOTS)
def test_errors_on_any_triangle(slots, rng):
    size = rng.uniform(0.02, 1.0, (4000, 1, 1))
    corners = rng.uniform(size=(4000, 1, 2)) * (1.0 - size) + size * rng.uniform(size=(4000, 3, 2))
    share = rng.dirichlet(np.ones(3), 4000)
    error = interpolation_errors(slots, np.einsum("nk,nkc->nc", share, corners), corners)
    assert np.all(error <= any_errors(slots)[:, None] * size[:, 0, 0] ** 2)


@pytest.mark.parametrize("cell", [True, False])
@pytest.mark.parametrize("slots", SLOTS)
def test_terms_on_boxes(slots, cell, rng):
    """They swing and differ from quadratics no more than is said: at corners, beside them, in thin boxes, anywhere."""
    count = 3000
    size = 10.0 ** rng.uniform(-2.5, 0.0, (count, 2))
    low = rng.uniform(size=(count, 2)) ** rng.choice([1.0, 6.0], (count, 2)) * (1.0 - size)
    low = np.where(rng.uniform(size=(count, 2)) < 0.3, 0.0, low)
    low = np.where(rng.uniform(size=(count, 1)) < 0.5, low, 1.0 - size - low)
    low = np.clip(low, 0.0, 1.0 - size)
    bounds = on_box(slots, list(jnp.asarray(low.T)), list(jnp.asarray((low + size).T)), cell)
    inside = low[:, None] + size[:, None] * rng.uniform(size=(count, 20, 2))
    middle = terms(slots, low + 0.5 * size)
    for k, bound in enumerate(bounds):
        swing = np.abs(terms(slots, inside)[k] - middle[k][:, None]).max(axis=1)
        assert np.all(swing <= np.asarray(bound.swing) + 1e-12)
    if cell:
        first = rng.choice([0.0, 0.5], (count, 1, 2))
        turned = rng.choice([1.0, -1.0], (count, 1, 2))
        half = np.array([[0.0, 0.0], [0.5, 0.0], [0.5, 0.5]])[None]
        local = first + np.where(turned > 0, half, 0.5 - half)
    else:
        local = rng.uniform(size=(count, 3, 2))
        local = np.where(rng.uniform(size=local.shape) < 0.4, np.round(local), local)
    corners = low[:, None] + size[:, None] * local
    nodes = np.concatenate([corners, 0.5 * (corners + np.roll(corners, -1, axis=1))], axis=1)
    share = rng.dirichlet(np.ones(3), (count, 40))
    a, b, c = np.moveaxis(share, -1, 0)
    lagrange = np.stack([a * (2 * a - 1), b * (2 * b - 1), c * (2 * c - 1), 4 * a * b, 4 * b * c, 4 * c * a], axis=-1)
    places = np.einsum("nmk,nkc->nmc", share, corners)
    left = np.abs(terms(slots, places) - np.einsum("nmk,snk->snm", lagrange, terms(slots, nodes))).max(axis=2)
    for k, bound in enumerate(bounds):
        assert np.all(left[k] <= np.asarray(bound.rest) + 1e-12)


def random_patches(rng, count, degree):
    """Nets and twists that no mesh has."""
    grid = np.stack(np.meshgrid(*[np.linspace(-1.0, 1.0, degree + 1)] * 2, indexing="ij"), axis=-1)
    flat = np.concatenate([grid, np.zeros_like(grid[..., :1])], axis=-1)
    net = flat + 0.3 * rng.normal(size=(count, *flat.shape))
    twists = 0.8 * rng.normal(size=(count, 4 if degree == 3 else 6, 3))
    # a patch is a quad or a triangle
    if degree == 4:
        twists[::2, 4:], twists[1::2, :4] = 0.0, 0.0
    return GregoryPatches(net, twists)


@pytest.mark.parametrize(
    ("degree", "options"),
    [
        (3, {"verify": True}),
        *(
            pytest.param(degree, options, marks=pytest.mark.slow)
            for degree in (3, 4)
            for options in (
                {},
                {"tiles": 1},
                {"tiles": 3},
                {"depth_tolerance": 1e-4},
                {"verify": True, "tolerance": 0.1},
            )
        ),
    ],
)
def test_factors_hold(degree, options, rng):
    """Of hostile nets, in a view from outside and one from among them, and for some numbers above."""
    patches = random_patches(rng, 16, degree)
    views = [
        View(Camera.look_at((2.0, -3.0, 2.5), (0, 0, 0)), 320, 200),
        View(Camera.look_at((0.2, -0.9, 0.9), (0, 0, 0), fov_y=120.0, near=0.05), 320, 200),
    ]
    for view in views:
        factors = tessellation_factors(patches, view, **options)
        for more in (0, 1, 2):
            levels = factors.levels + more * (factors.levels > 0)
            fine = np.flatnonzero((levels > 0) & (levels < 300))
            assert len(fine) > 4
            assert sampled_error(patches[fine], levels[fine], view).max() <= options.get("tolerance", 0.5)


def among_triangles(quads, others):
    """Quads of bi-degree 3 as scenes with triangles have them, and patches of bi-degree 4 among them."""
    net = elevate(elevate(np.moveaxis(quads.net, 0, 2), 4).swapaxes(0, 1), 4).transpose(2, 1, 0, 3)
    twists = np.concatenate([quads.twists, np.zeros((len(quads), 2, 3))], axis=1)
    both = np.concatenate([net, others.net]), np.concatenate([twists, others.twists])
    order = np.arange(2 * len(quads)).reshape(2, -1).T.ravel()
    return GregoryPatches(*(x[order] for x in both))


@pytest.mark.slow
@pytest.mark.parametrize("precision", [np.float64, np.float32], indirect=True)
@pytest.mark.parametrize("tiles", [1, 2])
def test_quads_among_triangles(tiles, precision, rng):
    """Their factors are those of their bi-degree 3, the others' those that they have alone."""
    quads, others = (random_patches(rng, 40, degree).astype(precision) for degree in (3, 4))
    view = View(Camera.look_at((2.0, -3.0, 2.5), (0, 0, 0)), 320, 200)
    mixed = among_triangles(quads, others).astype(precision)
    found = np.asarray(tessellation_factors(mixed, view, tiles=tiles).factor)
    rtol = 1e-9 if precision == np.float64 else 0.02
    np.testing.assert_allclose(found[::2], tessellation_factors(quads, view, tiles=tiles).factor, rtol=rtol)
    # as they are, whatever stands beside them
    np.testing.assert_allclose(found[1::2], tessellation_factors(others, view, tiles=tiles).factor, rtol=rtol)


@pytest.mark.slow
@pytest.mark.parametrize("tiles", [1, 2])
def test_quads_among_triangles_inside_of_jit(tiles, precision, rng):
    quads, others = (random_patches(rng, 40, degree).astype(precision) for degree in (3, 4))
    view = View(Camera.look_at((2.0, -3.0, 2.5), (0, 0, 0)), 320, 200)
    mixed = among_triangles(quads, others).astype(precision)
    found = tessellation_factors(mixed, view, tiles=tiles).factor
    traced = jax.jit(lambda given: tessellation_factors(given, view, tiles=tiles).factor)(mixed)
    np.testing.assert_allclose(traced, found, rtol=1e-9 if precision == np.float64 else 0.02)


@pytest.mark.slow
def test_nets_that_are_nearly_of_bi_degree_3(rng):
    """What more than rounding sets apart is taken as it is."""
    quads, others = (random_patches(rng, 24, degree) for degree in (3, 4))
    view = View(Camera.look_at((2.0, -3.0, 2.5), (0, 0, 0)), 320, 200)
    mixed = among_triangles(quads, others)
    for size in (1e-6, 0.3):
        patches = GregoryPatches(mixed.net + size * rng.normal(size=mixed.net.shape), mixed.twists)
        factors = tessellation_factors(patches, view)
        fine = np.flatnonzero((factors.levels > 0) & (factors.levels < 300))
        assert sampled_error(patches[fine], factors.levels[fine], view).max() <= 0.5
    lanes = jnp.moveaxis(patches.net, 0, -1), jnp.moveaxis(patches.twists, 0, -1)
    assert lowered(Twisted(*lanes), jnp.zeros(3))[2].all()


@pytest.mark.slow
@pytest.mark.parametrize("options", [{}, {"levels": "fewest", "anisotropic": True}, {"tolerance": 0.02}])
def test_levels_hold_as_drawn(options, rng):
    """Quads and pinched triangles among one another, patches in pieces too (the last)."""
    scene = load("walker", scheme="gregory")
    patches, view = scene.patches(), View(scene.default_camera(), 640, 400)
    if "tolerance" in options:
        middle = scene.points().mean(axis=0)
        view = View(Camera.look_at(0.5 * (view.camera.eye + middle), middle), 640, 400)
    factors = tessellation_factors(patches, view, edge_numbers=scene.edge_numbers, **options)
    found = triangle_error(patches, triangulate(patches, factors), view)
    assert found.max() <= options.get("tolerance", 0.5)
    assert np.count_nonzero(factors.inner.max(axis=1) > 0) > 300
