"""Normals that the renderer draws, against the surface's in float64."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from slefejax import Camera, InputError, View, convert, evaluate_patches, normal_error
from slefejax.conversion.acc import acc_patches
from slefejax.conversion.gaussian.published import published
from slefejax.geometry.bezier import derivative, evaluate_patch
from slefejax.geometry.gregory import GregoryPatches, twist_slopes
from slefejax.geometry.normals import collapsed_sides, normal_net, without_collapsed
from slefejax.geometry.view import homogeneous
from slefejax.gpu.renderer import Renderer
from slefejax.model.gaussians import with_gaussians
from tests.meshes import disc, triangle_fan
from tests.test_gaussian import UPPER, scene_of, torus
from tests.test_strays import sheet

pytestmark = pytest.mark.gl

VIEW = View(Camera.look_at((3.0, -6.0, 4.0), (0.0, 0.0, 0.0)), 240, 150)
ROUNDING = 0.01  # degrees, of normals at vertices: some thousand times float32's eps, as control points cancel
INSIDE = 1 - 1e-6  # where no side is a point
GREGORY = 5e-5  # of a patch's longest, so far inside
REDUCED = 2e-6  # of a patch's longest: reduced normals at vertices, as much in any direction


def levels(count, level):
    return np.full((count, 2), level), np.full((count, 4), level)


def drawn(device, patches, level, view=VIEW, **options) -> Any:
    renderer = Renderer(patches, device, normals=True, **options)
    found = renderer.draw(view, *levels(len(patches), level))
    renderer.release()
    return found


def captured(device, patches, level) -> tuple[Any, ...]:
    """Patch, u, v and undivided normal of all captured vertices; none is left out."""
    renderer = Renderer(patches, device, normals=True)
    found: Any = renderer.capture(VIEW, *levels(len(patches), level))
    renderer.release()
    u, v = found.parameters.reshape(-1, 2).T.astype(float)
    return np.repeat(found.patch, 3), u, v, found.normal.reshape(-1, 3).astype(float)


def at_vertices(device, patches, level) -> tuple[Any, ...]:
    """The same with unit normals."""
    *place, normal = captured(device, patches, level)
    return *place, unit(normal)


def degrees(found, wanted):
    return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(found, wanted), axis=1), np.sum(found * wanted, axis=1)))


def slopes(control, u, v):
    """Values and derivatives by u and v of coefficients ``(n, n, rest, places)``."""
    by_v = np.swapaxes(derivative(np.swapaxes(control, 0, 1)), 0, 1)
    return [evaluate_patch(own, u, v).T for own in (control, derivative(control), by_v)]


def bracket(control, u, v):
    """w p_u x p_v - w_v p_u x p - w_u p x p_v, which is w^3 times the normal."""
    (p, w), (p_u, w_u), (p_v, w_v) = ((x[:, :3], x[:, 3:]) for x in slopes(control, u, v))
    return w * np.cross(p_u, p_v) - w_v * np.cross(p_u, p) - w_u * np.cross(p, p_v)


def unit(vectors):
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def undivided_normals(patches, patch, u, v):
    """By NumPy, where nothing has to be compiled."""
    if isinstance(patches, GregoryPatches):
        _, *along = slopes(np.moveaxis(patches.net[patch], 0, -1), u, v)
        turns = twist_slopes(patches.twists.shape[1], u, v)
        along = [x + np.einsum("kn,nkc->nc", t, patches.twists[patch]) for x, t in zip(along, turns, strict=True)]
        return np.cross(*along)
    return bracket(np.moveaxis(homogeneous(patches)[patch], 0, -1), u, v)


def exact_normals(patches, patch, u, v):
    return unit(undivided_normals(patches, patch, u, v))


def reduced_normals(patches, patch, u, v):
    """Over the distances from sides that are points, as polynomials."""
    net = without_collapsed(normal_net(np.moveaxis(patches, 0, -1)), collapsed_sides(patches).T)
    return evaluate_patch(net[..., patch], u, v).T


def apart(patch, found, wanted):
    """Of vectors that are equal but for one positive number a patch: the largest difference over the longest."""
    worst = 0.0
    for own in (patch == k for k in np.unique(patch)):
        scale = np.sum(found[own] * wanted[own]) / np.sum(found[own] ** 2)
        assert scale > 0
        longest = np.linalg.norm(wanted[own], axis=1).max()
        worst = max(worst, np.linalg.norm(scale * found[own] - wanted[own], axis=1).max() / longest)
    return worst


def with_points(rng, shape, sides):
    """Random patches of which some sides, all along u or all along v, are points."""
    patches = rng.normal(size=(3, *shape))
    patches[..., 3:] = rng.uniform(0.5, 2.0, patches[..., 3:].shape)
    for side in sides:
        turned = patches.swapaxes(1, 2) if side % 2 else patches
        turned[:, -(side // 2), :, :3] = turned[:, -(side // 2), :1, :3]
    patches[..., :3] *= patches[..., 3:] if shape[2] == 4 else 1.0
    return patches


def solved_normals(control, u, v):
    """Of nets of q ``(4, 4, 9, places)``: Sigma (h_u - Q_u mu) x Sigma (h_v - Q_v mu), Sigma = Q^-1."""

    def parts(q):
        matrix = np.empty((len(q), 3, 3))
        for k, (i, j) in enumerate(UPPER):
            matrix[:, i, j] = matrix[:, j, i] = q[:, k]
        return matrix, q[:, 6:, None]

    (matrix, pulled), *along = (parts(q) for q in slopes(control, u, v))
    mu = np.linalg.solve(matrix, pulled)
    tangents = [np.linalg.solve(matrix, h - m @ mu)[..., 0] for m, h in along]
    return np.cross(*tangents)


def sphere(weight=1.0):
    """An eighth of the unit sphere, biquadratic; its side v = 1 is a point with three different weights."""
    s = np.sqrt(0.5)
    w = np.array([1.0, s, 1.0])
    x, y = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]).T
    r, z = np.array([[1.0, 0.0], [1.0, 1.0], [0.0, 1.0]]).T
    points = np.stack([np.outer(x, r), np.outer(y, r), np.outer(1.0 + 0.0 * x, z), np.ones((3, 3))], axis=-1)
    return weight * (w[:, None] * w)[..., None] * points


def test_normals_of_a_teapot_come_nearer_with_the_square_of_the_level(device, teapot):
    """At the points of its lid and bottom, too."""
    view = View(teapot.default_camera(), 240, 150)
    errors = [normal_error(teapot.patches(), view, drawn(device, teapot.patches(), n, view)) for n in (16, 64)]
    there = ~np.isnan(errors[1])
    assert there.sum() > 5000
    coarse, fine = (error[there & ~np.isnan(errors[0])] for error in errors)
    assert np.median(coarse) / np.median(fine) == pytest.approx(16.0, rel=0.15)
    assert np.median(fine) < 0.003
    assert fine.max() < 0.2


def test_normals_of_flat_patches_are_exact(device):
    square = np.array([[[-1, -1, 0], [-1, 1, 0]], [[1, -1, 0], [1, 1, 0]]], float)[None]
    seen = drawn(device, square, 3)
    there = seen.patch >= 0
    assert there.sum() > 500
    assert np.array_equal(seen.normal[there], np.broadcast_to([0.0, 0.0, 1.0], (there.sum(), 3)))
    assert np.all(np.isnan(seen.normal[~there]))
    assert np.array_equal(normal_error(square, VIEW, seen), np.where(there, 0.0, np.nan), equal_nan=True)
    turned = drawn(device, square[:, ::-1], 3)
    assert np.all(turned.normal[turned.patch >= 0] == [0, 0, -1]), "p_u x p_v, whatever side is seen"


@pytest.mark.parametrize("shape", [(2, 2, 3), (2, 5, 3), (3, 6, 4)])
def test_normals_of_any_degrees(device, rng, shape):
    patches = rng.normal(size=(5, *shape))
    patches[..., 3:] = rng.uniform(0.5, 2.0, patches[..., 3:].shape)
    patch, u, v, normal = at_vertices(device, patches, 7)
    wanted = exact_normals(patches, patch, u, v)
    # where tangents are nearly parallel rounding turns the normal further
    angles = degrees(normal, wanted)
    assert np.median(angles) < 1e-4
    assert angles.max() < 0.1


@pytest.mark.parametrize("sides", [(0,), (1,), (2,), (3,), (0, 2), (1, 3)])
@pytest.mark.parametrize("shape", [(4, 4, 3), (3, 5, 4)])
def test_normals_over_the_distance_from_sides_that_are_points(device, rng, shape, sides):
    patches = with_points(rng, shape, sides)
    assert np.all(np.flatnonzero(collapsed_sides(patches)[0]) == sides)
    *place, normal = captured(device, patches, 8)
    assert apart(place[0], normal, reduced_normals(patches, *place)) < REDUCED


def test_reduced_normals_of_a_teapot(device, teapot):
    patches = teapot.patches()
    assert collapsed_sides(patches).any(axis=1).sum() == 8
    *place, normal = captured(device, patches, 8)
    wanted = reduced_normals(patches, *place)
    assert apart(place[0], normal, wanted) < REDUCED
    assert degrees(normal, wanted).max() < 1e-3


@pytest.mark.parametrize("below", [False, True])
def test_normals_at_the_points_of_a_teapot_come_nearer_with_the_square_of_the_level(device, teapot, below):
    patches = teapot.patches()
    view = View(Camera.look_at((0.3, -0.4, -8.0 if below else 8.0), (0.0, 0.0, 1.5), fov_y=20.0), 240, 150)
    points = collapsed_sides(patches)
    assert set(np.flatnonzero(points.any(axis=0))) == {0}
    largest = []
    for level in (16, 64):
        seen = drawn(device, patches, level, view)
        near = points[seen.patch, 0] & (seen.patch >= 0) & (seen.u < 1 / 8)
        assert near.sum() > 1000
        largest.append(np.nanmax(normal_error(patches, view, seen)[near]))
    assert largest[0] / largest[1] == pytest.approx(16.0, rel=0.25)


@pytest.mark.parametrize("weight", [1.0, 1e-14])
def test_rational_patches_that_end_in_a_point(device, weight):
    patches = sphere(weight)[None]
    *place, normal = captured(device, patches, 12)
    assert apart(place[0], normal, reduced_normals(sphere()[None], *place)) < REDUCED
    points = evaluate_patches(patches, np.stack(place[1:], axis=1))[0]
    assert degrees(normal, points).max() < ROUNDING
    view = View(Camera.look_at((3.0, 3.0, 4.0), (0.4, 0.4, 0.6), fov_y=20.0), 240, 150)
    for level in (8, 32):
        error = normal_error(patches, view, drawn(device, patches, level, view))
        assert np.nanmax(error) < 95.0 / level**2, "next to the point, too"


def test_a_cusp_has_no_normal(device):
    """Both tangents of a corner have one direction: rounding must not make another one of their product."""
    u, v = np.meshgrid(np.arange(4.0), np.arange(4.0), indexing="ij")
    patches = np.stack([u, v, 0.1 * u * v], axis=-1)[None]
    patches[0, 0, 1], patches[0, 1, 0] = [0.9, 0.7, 0.3], [2.7, 2.1, 0.9]
    _, u, v, normal = captured(device, patches, 8)
    corner = (u == 0) & (v == 0)
    assert corner.any()
    assert np.array_equal(np.any(normal != 0, axis=1), ~corner)


def test_normals_of_gaussian_products(device):
    """Against those of q itself; both sides of the bracket know nothing of one another."""
    scene = scene_of(torus(20.0))
    dual = scene.conversion.patchwork.products.dual
    nets = acc_patches(scene.conversion.mesh).on_host(dual(scene.conversion.control))
    patches = scene.patches()
    patch, u, v, normal = at_vertices(device, patches, 6)
    wanted = unit(solved_normals(np.moveaxis(nets, 0, -1)[..., patch], u, v))
    np.testing.assert_allclose(exact_normals(patches, patch, u, v), wanted, atol=1e-9)
    np.testing.assert_allclose(normal, wanted, atol=1e-5)


@pytest.mark.parametrize("mesh", [disc(5, rng=np.random.default_rng(4)), triangle_fan(5, np.random.default_rng(4))])
def test_normals_of_gregory_patches(device, mesh):
    patches = convert(mesh, "gregory").patchwork.on_host(mesh.vertices)
    assert np.any(patches.twists[:, -1] != 0), "of a quad, and of a triangle"
    patch, u, v, normal = captured(device, patches, 7)
    inside = np.where(collapsed_sides(patches)[patch, 2], np.minimum(u, INSIDE), u)
    wanted = undivided_normals(patches, patch, inside, v)
    wanted /= np.where(collapsed_sides(patches)[patch, 2], 1.0 - inside, 1.0)[:, None]
    assert degrees(normal, wanted).max() < ROUNDING
    assert apart(patch, normal, wanted) < GREGORY
    error = normal_error(patches, VIEW, drawn(device, patches, 64))
    assert np.nanmedian(error) < 0.005
    assert np.nanmax(error) < 0.3


@pytest.mark.parametrize("sides", [(0,), (1,), (2,), (3,), (0, 2), (1, 3)])
@pytest.mark.parametrize("n", [4, 5])
def test_normals_of_gregory_patches_with_sides_that_are_points(device, rng, n, sides):
    patches = GregoryPatches(with_points(rng, (n, n, 3), sides), rng.normal(size=(3, 4 if n == 4 else 6, 3)))
    patch, u, v, normal = captured(device, patches, 7)
    u_in, v_in = np.clip(u, 1 - INSIDE, INSIDE), np.clip(v, 1 - INSIDE, INSIDE)
    wanted = undivided_normals(patches, patch, u_in, v_in)
    for side in sides:
        wanted /= np.stack([u_in, v_in, 1 - u_in, 1 - v_in])[side][:, None]
    corner = ((u == 0) | (u == 1)) & ((v == 0) | (v == 1))  # there differences turn, and nothing has a limit
    assert apart(patch[~corner], normal[~corner], wanted[~corner]) < GREGORY
    assert np.all(np.isfinite(normal))


@pytest.mark.parametrize("mesh", [torus(20.0), with_gaussians(disc(5, rng=np.random.default_rng(4)), "infer")])
def test_normals_of_nested_nets(device, mesh):
    own = published(mesh)
    patch, u, v, normal = at_vertices(device, own.nets, 6)
    wanted = exact_normals(own.limit.net, *own.on_limit(patch, u, v))
    assert np.abs(normal - wanted).max() < 1e-4
    seen = drawn(device, own.nets, 64)
    there = seen.patch >= 0
    place = own.on_limit(*(x[there] for x in (seen.patch, seen.u, seen.v)))
    error = degrees(seen.normal[there].astype(float), exact_normals(own.limit.net, *place))
    assert np.median(error) < 0.01
    assert error.max() < 0.8


def test_pictures_are_the_same_with_normals(device, teapot):
    view = View(teapot.default_camera(), 240, 150)
    renderer = Renderer(teapot.patches(), device)
    plain, captured = (f(view, *levels(32, 9)) for f in (renderer.draw, renderer.capture))
    renderer.release()
    assert plain.normal is None
    assert captured.normal is None
    seen = drawn(device, teapot.patches(), 9, view)
    for name in ("u", "v", "patch", "depth", "drawn"):
        assert np.array_equal(getattr(plain, name), getattr(seen, name)), name
    np.testing.assert_allclose(np.linalg.norm(seen.normal[seen.patch >= 0], axis=1), 1.0, atol=1e-6)
    with pytest.raises(InputError, match="no normals: draw it with"):
        normal_error(teapot.patches(), view, plain)
    with pytest.raises(InputError, match="of 150 rows and 240 columns is needed, not"):
        normal_error(teapot.patches(), view, SimpleNamespace(**vars(seen) | {"patch": seen.patch[1:]}))


def test_strays_have_the_normal_of_where_they_are_moved(device, rng, monkeypatch):
    """A sheet that is seen edge on, most of its triangles thinner than the grid that corners are snapped to."""
    moved = []
    settled = Renderer._settled

    def counted(self, strays, *others):
        moved.append(len(strays.patch))
        return settled(self, strays, *others)

    monkeypatch.setattr(Renderer, "_settled", counted)
    patches = sheet(rng, 0.05)
    view = View(Camera.look_at((0.1, -0.6, 4e-4), (0.1, 0.4, 3.9e-4), near=0.01, far=5.0), 300, 200)
    error = normal_error(patches, view, drawn(device, patches, 64, view))
    assert moved
    assert moved[0] > 20
    assert np.nanmax(error) < 0.1
