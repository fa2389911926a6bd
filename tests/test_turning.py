"""Certified normals: dense sampling finds no interpolated normal further off than was asked for."""

from __future__ import annotations

import pickle
from functools import partial
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slefejax as sj
from slefejax import Camera, InputError, Session, View, tessellation_factors
from slefejax.geometry.bezier import evaluate_patch
from slefejax.geometry.normals import collapsed_sides, normal_net, without_collapsed
from slefejax.predict.cells import Pictures, Turned, cell_errors, triangle_errors
from slefejax.predict.normals.turning import turning
from slefejax.predict.normals.undivided import Undivided

ABOVE = View(Camera.orthographic((0.0, 0.0, 50.0), (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), height=40.0), 300, 300)
SHAPES = [(4, 4, 3), *(pytest.param(own, marks=pytest.mark.slow) for own in ((3, 3, 4), (2, 2, 3), (3, 4, 3)))]


def sheets(rng, count, shape, steep=0.2):
    """Wavy sheets seen from above, with weights if there are four coordinates."""
    nu, nv, dim = shape
    x, y = np.meshgrid(np.linspace(-1, 1, nu), np.linspace(-1, 1, nv), indexing="ij")
    points = np.stack([x, y, 0 * x], axis=-1) + steep * rng.normal(size=(count, nu, nv, 3))
    if dim == 3:
        return points
    weights = np.exp(0.4 * rng.normal(size=(count, nu, nv, 1)))
    return np.concatenate([points * weights, weights], axis=-1)


def undivided(patches):
    net = normal_net(np.moveaxis(np.asarray(patches, np.float64), 0, -1))
    return np.moveaxis(without_collapsed(net, np.asarray(collapsed_sides(patches)).T), -1, 0)


def degrees_between(a, b):
    return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def at(net, u, v):
    """(..., 3)"""
    return np.moveaxis(evaluate_patch(net.reshape(*net.shape, *[1] * u.ndim), u, v), 0, -1)


def on_cell(net, low, high, places=13):
    """The largest angle on a cell, for both diagonals."""
    t = np.linspace(0, 1, places)
    a, b = np.meshgrid(t, t, indexing="ij")
    exact = at(net, low[0] + a * (high[0] - low[0]), low[1] + b * (high[1] - low[1]))
    p, q, r, s = exact[0, 0], exact[-1, 0], exact[0, -1], exact[-1, -1]
    a, b = a[..., None], b[..., None]
    rising = np.where(a >= b, p + a * (q - p) + b * (s - q), p + b * (r - p) + a * (s - r))
    falling = np.where(a + b <= 1, p + a * (q - p) + b * (r - p), s + (1 - a) * (r - s) + (1 - b) * (q - s))
    return max(degrees_between(rising, exact).max(), degrees_between(falling, exact).max())


def on_grid(net, n):
    cells = [(np.array([i, j]) / n, np.array([i + 1, j + 1]) / n) for i in range(n) for j in range(n)]
    return max(on_cell(net, low, high) for low, high in cells)


@pytest.mark.parametrize("shape", SHAPES)
def test_grids_keep_the_angle(rng, shape):
    patches = sheets(rng, 12, shape)
    for allowed in (1.0, 5.0):
        found = tessellation_factors(patches, ABOVE, tolerance=1e6, normal_tolerance=allowed)
        factor, claimed = np.asarray(found.factor), ~np.asarray(found.without_normal)
        assert claimed.sum() >= 9
        for net, n in zip(undivided(patches)[claimed], np.ceil(factor[claimed]).astype(int), strict=True):
            if n <= 25:
                assert on_grid(net, n) <= allowed


@pytest.mark.parametrize("side", [0, *(pytest.param(side, marks=pytest.mark.slow) for side in (1, 2, 3))])
def test_sides_that_are_points_have_claims(rng, side):
    patches = sheets(rng, 6, (4, 4, 3), steep=0.05)
    if side % 2 == 0:
        patches[:, -(side // 2)] = patches[:, -(side // 2), 1:2]
    else:
        patches[:, :, -(side // 2)] = patches[:, 1:2, -(side // 2)]
    found = tessellation_factors(patches, ABOVE, tolerance=1e6, normal_tolerance=2.0)
    assert not np.any(found.without_normal)
    for net, factor in zip(undivided(patches), np.asarray(found.factor), strict=True):
        assert on_grid(net, int(np.ceil(factor))) <= 2.0


def test_a_cusp_has_no_claim_and_keeps_its_position(rng):
    patches = sheets(rng, 2, (4, 4, 3), steep=0.0)
    # p_u turns round on the way: its normal does, too
    patches[1, :, :, 0] = np.array([0.0, 1.0, -1.0, 0.0])[:, None]
    plain = tessellation_factors(patches, ABOVE)
    found = tessellation_factors(patches, ABOVE, normal_tolerance=1.0)
    assert np.asarray(found.without_normal).tolist() == [False, True]
    assert np.array_equal(found.factor, plain.factor)
    assert np.array_equal(found.edges, plain.edges)


@pytest.mark.parametrize("shape", [(4, 4, 3), (3, 3, 4)])
def test_cells_and_triangles_turn_no_more_than_is_told_and_little_less(rng, shape):
    nets = undivided(sheets(rng, 20, shape))
    made = lambda which: Undivided(np.moveaxis(nets[which], 0, -1), np.ones(len(which)))  # noqa: E731
    pictures = Pictures(lambda which: Turned(made(which), np.deg2rad(1.0)), 20)
    low = rng.uniform(0, 0.8, (20, 2))
    high = low + rng.uniform(0.05, 0.2, (20, 2))
    told = cell_errors(pictures, np.arange(20), low, high)
    true = np.array([on_cell(net, *box) for net, *box in zip(nets, low, high, strict=True)])
    assert np.all(true <= told)
    assert np.median(told / true) < 1.3
    corners = np.stack([low, np.stack([high[:, 0], low[:, 1]], axis=1), high], axis=1)
    halves = triangle_errors(pictures, np.arange(20), corners)
    shares = rng.dirichlet(np.ones(3), 200)
    for net, triangle, most in zip(nets, corners, halves, strict=True):
        drawn = shares @ at(net, *triangle.T)
        assert degrees_between(drawn, at(net, *(shares @ triangle).T)).max() <= most


@pytest.mark.parametrize(
    "options", [{}, pytest.param({"anisotropic": True, "levels": "fewest"}, marks=pytest.mark.slow)]
)
def test_triangles_of_the_teapot_keep_an_angle_as_drawn(teapot, options):
    patches, view = teapot.patches(), View(teapot.default_camera(), 1440, 900)
    found = tessellation_factors(patches, view, normal_tolerance=2.0, **options)
    drawn = sj.triangulate(patches, found)
    assert sj.triangle_normal_error(patches, drawn, view).max() <= 2.0
    assert sj.triangle_error(patches, drawn, view).max() <= 0.5


@pytest.mark.slow
def test_verify_finds_smaller_factors_that_hold(rng):
    patches = sheets(rng, 8, (4, 4, 3))
    loose, tight = (
        np.asarray(tessellation_factors(patches, ABOVE, tolerance=1e6, normal_tolerance=1.0, verify=verify).factor)
        for verify in (False, True)
    )
    assert np.all(tight <= np.ceil(loose))
    assert np.median(tight / np.ceil(loose)) < 1.0
    for net, n in zip(undivided(patches), np.ceil(tight).astype(int), strict=True):
        assert on_grid(net, n) <= 1.0


@pytest.mark.slow
def test_more_tiles_are_never_looser(rng):
    nets = jnp.asarray(np.moveaxis(undivided(sheets(rng, 16, (4, 4, 3))), 0, -1))
    squares = [turning(Undivided(nets, jnp.ones(16)), 0.02, tiles=tiles).factor for tiles in (1, 4)]
    for coarse, fine in pairwise(squares):
        assert np.all(np.asarray(fine) <= 1.001 * np.asarray(coarse))


def total_factor(patches, along, smooth, step, degrees):
    """Of patches moved along, cut for an angle."""
    asked = {"tolerance": 1e6, "tiles": 1, "smooth": smooth}
    return jnp.sum(tessellation_factors(patches + step * along, ABOVE, normal_tolerance=degrees, **asked).factor)


@pytest.mark.slow
@pytest.mark.parametrize("smooth", [None, 0.05])
def test_derivatives_are_those_of_finite_differences(rng, smooth):
    patches, step = sheets(rng, 2, (3, 3, 3)), 1e-6
    total = partial(total_factor, patches, rng.normal(size=patches.shape), smooth)
    with jax.enable_x64(True):
        # in one direction: others are combined of it where reverse mode agrees
        found = jax.jvp(total, (0.0, 1.0), (1.0, 0.5))[1]
        wanted = float(total(step, 1.0 + 0.5 * step) - total(-step, 1.0 - 0.5 * step)) / (2 * step)
    np.testing.assert_allclose(found, wanted, rtol=2e-4)


@pytest.mark.slow
@pytest.mark.parametrize("smooth", [None, 0.05])
def test_derivatives_in_reverse_are_those_forward(rng, smooth):
    patches = sheets(rng, 2, (3, 3, 3))
    total = partial(total_factor, patches, rng.normal(size=patches.shape), smooth)
    with jax.enable_x64(True):
        forward = [jax.jvp(total, (0.0, 1.0), along)[1] for along in ((1.0, 0.0), (0.0, 1.0))]
        np.testing.assert_allclose(jax.grad(total, (0, 1))(0.0, 1.0), forward, rtol=1e-9)


@pytest.mark.slow
def test_inside_of_jit_factors_are_the_same(rng):
    patches = sheets(rng, 5, (4, 4, 3))

    def factors(points):
        return tessellation_factors(points, ABOVE, normal_tolerance=1.0)

    with jax.enable_x64(True):
        inside, outside = jax.jit(factors)(patches), factors(patches)
        np.testing.assert_allclose(inside.factor, outside.factor, rtol=1e-12)
        assert np.array_equal(np.asarray(inside.without_normal), np.asarray(outside.without_normal))
        assert np.array_equal(inside.at(patches, ABOVE).edges, outside.edges)


def test_single_precision_holds(rng):
    patches = sheets(rng, 12, (4, 4, 3)).astype(np.float32) + np.float32(100.0)
    view = View(Camera.orthographic((100, 100, 200), (100, 100, 100), up=(0, 1, 0), height=40.0), 300, 300)
    with jax.enable_x64(False):
        found = tessellation_factors(patches, view, tolerance=1e6, normal_tolerance=1.0)
    double = tessellation_factors(patches.astype(np.float64), view, tolerance=1e6, normal_tolerance=1.0)
    ratio = np.asarray(found.factor) / np.asarray(double.factor)
    assert np.all((ratio > 0.999) & (ratio < 1.2))


def test_without_a_tolerance_there_are_no_normals_in_the_trace(teapot):
    view = View(teapot.default_camera(), 1440, 900)
    text = [str(program) for program in Session(teapot).programs(view).values()]
    assert not any("6,6,3" in own for own in text)
    programs = Session(teapot, normal_tolerance=1.0).programs(view)
    assert "6,6,3" in str(programs["normals"])
    assert "6,6,3" not in str(programs["view"])
    assert any("normals" in said for said in Session(teapot).left_out())


@pytest.mark.slow
def test_sessions_know_normals_of_every_pose():
    walker = sj.load("walker")
    view = View(walker.default_camera(), 640, 400)
    session = Session(walker, normal_tolerance=2.0, normals="tangents")
    for time in (0.0, 6.0):
        found = session.factors(view, time)
        patches, tangents = np.asarray(walker.pose(time)), walker.tangents(time)
        wanted = tessellation_factors(patches, view, normal_tolerance=2.0, normals="tangents", tangents=tangents)
        np.testing.assert_allclose(found.factor, wanted.factor, rtol=1e-6)


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"normal_tolerance": 0}, "more than 0 and less than 90 degrees, not 0"),
        ({"normal_tolerance": -1.0}, "not -1.0"),
        ({"normal_tolerance": 200}, "not 200"),
        ({"normal_tolerance": float("nan")}, "not nan"),
        ({"normal_tolerance": 1.0, "method": "slefe"}, "'slefe' knows no normal_tolerance"),
        ({"normal_tolerance": 1.0, "normals": "tangents"}, "needs tangents="),
        ({"normals": "tangents"}, "give one"),
        ({"normal_tolerance": 1.0, "normals": "flat"}, "no kind of normals 'flat'"),
    ],
)
def test_bad_arguments(rng, options, says):
    with pytest.raises(InputError, match=says):
        tessellation_factors(sheets(rng, 1, (4, 4, 3)), ABOVE, **options)


def test_patches_of_high_degree_have_no_certificate(rng):
    with pytest.raises(InputError, match="degree 25"):
        tessellation_factors(sheets(rng, 1, (10, 10, 4)), ABOVE, normal_tolerance=1.0)


@pytest.mark.slow
def test_what_is_known_of_normals_can_be_pickled(rng):
    found = tessellation_factors(sheets(rng, 2, (4, 4, 3)), ABOVE, normal_tolerance=2.0)
    edges = found.edges
    again = pickle.loads(pickle.dumps(found))
    assert np.array_equal(again.edges, edges)
    assert np.array_equal(again.scaled(2.0).edges, found.scaled(2.0).edges)


@pytest.mark.parametrize("half", [0.0005, 0.003, 2.0**-14])
def test_short_sides_far_away_are_no_points(half):
    """Rounding of coordinates may be as long as a side that is seen."""
    patch = np.array([[[0, -half, 0], [0, half, 0]], [[1, 0, -1], [1, 0, 1]]]) + [1000.0, 0.0, 0.0]
    patches = patch[None].astype(np.float32)
    view = View(Camera.orthographic((1000.5, -5, 0), (1000.5, 0, 0), up=(0, 0, 1), height=4.0), 300, 300)
    assert not collapsed_sides(patches).any()
    with jax.enable_x64(False):
        found = tessellation_factors(patches, view, tolerance=1e9, normal_tolerance=1.0)
    n = np.ceil(found.factor).astype(int)
    assert np.all(np.asarray(found.without_normal)) or sj.sampled_normal_error(patches, n, view).max() <= 1.0


@pytest.mark.slow
def test_sides_that_rounding_leaves_are_points(rng):
    patches = sheets(rng, 2, (4, 4, 4), steep=0.05)
    corner = patches[:, 0, :1, :3] / patches[:, 0, :1, 3:]
    patches[:, 0, :, :3] = patches[:, 0, :, 3:] * corner
    patches[1, 0, :, :3] *= 1.0 + 1e-7
    assert collapsed_sides(patches)[:, 0].tolist() == [True, True]
    patches[1, 0, 1, :3] *= 1.0 + 1e-7
    assert collapsed_sides(patches)[:, 0].tolist() == [True, False]
    found = tessellation_factors(patches, ABOVE, tolerance=1e6, normal_tolerance=2.0)
    assert not np.asarray(found.without_normal)[0]
    assert sj.sampled_normal_error(patches, np.ceil(found.factor).astype(int), ABOVE)[0] <= 2.0


@pytest.mark.slow
def test_points_far_apart_beside_points_close_together(rng):
    """In single precision differences of points are as good as the points, whatever lies beside them."""
    patches = sheets(rng, 6, (4, 4, 3), steep=0.01)
    patches[..., 0] = np.where(patches[..., 0] > 0.9, 1000.0, 0.01 * patches[..., 0])
    patches = patches.astype(np.float32)
    with jax.enable_x64(False):
        found = tessellation_factors(patches, ABOVE, tolerance=1e6, normal_tolerance=1.0)
    claimed = ~np.asarray(found.without_normal)
    for net, factor in zip(undivided(patches)[claimed], np.asarray(found.factor)[claimed], strict=True):
        if factor <= 25:
            assert on_grid(net, int(np.ceil(factor))) <= 1.0


@pytest.mark.parametrize("allowed", [2.0, pytest.param(0.01, marks=pytest.mark.slow)])
def test_tangent_patches_keep_the_angle(rng, allowed):
    """Of a cube, uniformly cut and as drawn, and where normals are finer than the tessellator's limit."""
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]) + 0.1 * rng.normal(size=(8, 3))
    faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    made = sj.convert(sj.Mesh.of(corners, faces))
    patches, tangents = np.asarray(made.patchwork.patches(corners)), made.tangents(corners)
    shaded = {"normals": "tangents", "tangents": tangents}
    view = View(Camera.orthographic((0.5, 0.5, 9), (0.5, 0.5, 0), up=(0, 1, 0), height=4.0), 300, 300)
    found = tessellation_factors(patches, view, tolerance=1e6, normal_tolerance=allowed, **shaded)
    assert not np.any(np.asarray(found.without_normal))
    drawn = sj.triangulate(patches, found)
    assert 0.5 * allowed < sj.triangle_normal_error(patches, drawn, view, **shaded).max() <= allowed
    uniform = np.ceil(found.factor).astype(int)
    assert sj.sampled_normal_error(patches, uniform, view, **shaded).max() <= allowed
    assert (found.inner.max() > 64) == (allowed < 1)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, pytest.param(np.float64, marks=pytest.mark.slow)])
def test_tiny_rational_patches_at_the_origin_have_claims(rng, dtype):
    patches = sheets(rng, 4, (3, 3, 4))
    corner = patches[:, :1, :1, :3] / patches[:, :1, :1, 3:]
    patches[..., :3] = 1e-8 * (patches[..., :3] - patches[..., 3:] * corner)
    view = View(Camera.orthographic((0, 0, 1e-6), (0, 0, 0), up=(0, 1, 0), height=1e-6), 300, 300)
    found = tessellation_factors(patches.astype(dtype), view, tolerance=1e6, normal_tolerance=2.0)
    assert not np.any(np.asarray(found.without_normal))
