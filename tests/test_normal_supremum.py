"""Errors of normals over the domain, and factors that are minimal by them, against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from slefejax import (
    Camera,
    InputError,
    View,
    load,
    minimal_factors,
    minimal_pairs,
    normal_error,
    sampled_error,
    sampled_normal_error,
    triangle_normal_error,
    worst_normal_points,
)
from slefejax.geometry.bezier import bernstein
from slefejax.geometry.gregory import GregoryPatches, twist_slopes
from slefejax.geometry.normals import collapsed_sides, crossed, normal_net, without_collapsed
from slefejax.gpu.renderer import Renderer
from slefejax.measure import supremum
from slefejax.measure.triangles import DomainTriangles
from tests.test_normals import VIEW, slopes
from tests.test_supremum import grid_triangles

ABOVE = View(Camera.orthographic((0.0, 0.0, 50.0), (0.0, 0.0, 0.0), up=(0, 1, 0), height=20.0), 400, 400)  # of all
SINGLE = 5e-3  # degrees


def points_of(net, u, v):
    """``(patches, us, vs, 3)`` of nets ``(nu, nv, 3, patches)``, by NumPy."""
    rows, columns = (np.stack(bernstein(n - 1, t)) for n, t in zip(net.shape[:2], (u, v), strict=True))
    return np.einsum("ijcp,iu,jv->puvc", net, rows, columns, optimize=True)


def normals_of(patches, u, v, tangents=None):
    """Undivided normals on a grid, sides that are points divided out."""
    if isinstance(patches, GregoryPatches):
        return of_gregory(patches, u, v)
    if tangents is None:
        net = normal_net(np.moveaxis(patches, 0, -1))
    else:
        net = crossed(*(np.moveaxis(np.asarray(x), 0, -1) for x in tangents))
    return points_of(without_collapsed(net, collapsed_sides(patches).T), u, v)


def of_gregory(patches, u, v):
    """Of patches without sides that are points."""
    us, vs = (x.ravel() for x in np.meshgrid(u, v, indexing="ij"))
    turns = twist_slopes(patches.twists.shape[1], us, vs)
    found = []
    for net, twists in zip(patches.net, patches.twists, strict=True):
        _, *along = slopes(net[..., None], us, vs)
        along = [x + np.einsum("kn,kc->nc", t, twists) for x, t in zip(along, turns, strict=True)]
        found.append(np.cross(*along).reshape(len(u), len(v), 3))
    return np.array(found)


def degrees(found, wanted):
    sine = np.linalg.norm(np.cross(found, wanted), axis=-1)
    return np.rad2deg(np.arctan2(sine, np.sum(found * wanted, axis=-1)))


def error_by_loops(normals, n, q):
    """The largest error of every patch, of normals ``(patches, n q + 1, n q + 1, 3)``: all triangles of the grid."""
    worst = np.zeros(len(normals))
    a, b = (t[..., None] for t in np.meshgrid(*[np.arange(q + 1) / q] * 2, indexing="ij"))
    for i, j in np.ndindex(n, n):
        own = normals[:, i * q : (i + 1) * q + 1, j * q : (j + 1) * q + 1]
        p00, p10, p01, p11 = (own[:, x : x + 1, y : y + 1] for x, y in ((0, 0), (q, 0), (0, q), (q, q)))
        rising = p00 + np.where(a >= b, a * (p10 - p00) + b * (p11 - p10), b * (p01 - p00) + a * (p11 - p01))
        early, late = a * (p10 - p00) + b * (p01 - p00), (1 - a) * (p01 - p11) + (1 - b) * (p10 - p11)
        falling = np.where(a + b <= 1, p00 + early, p11 + late)
        for drawn in (rising, falling):
            worst = np.maximum(worst, degrees(drawn, own).max(axis=(1, 2)))
    return worst


def assert_as_by_loops(patches, n, view=ABOVE, q=20, **normals):
    tangents = normals.get("tangents")
    t = np.arange(n * q + 1) / (n * q)
    wanted = error_by_loops(normals_of(patches, t, t, tangents), n, q)
    found = sampled_normal_error(patches, np.full(len(patches), n), view, **normals)
    assert wanted.max() > 1.0
    # loops miss something, too
    np.testing.assert_allclose(found, wanted, rtol=0.01, atol=1e-4)


@pytest.mark.parametrize(("n", "q"), [(2, 80), (5, 20)])
def test_the_teapot_by_loops(teapot, n, q):
    """Its lid and bottom are patches that end in points."""
    assert collapsed_sides(teapot.patches()).any(axis=1).sum() == 8
    assert_as_by_loops(teapot.patches(), n, q=q)


def waves(seed, rows=4, columns=4):
    net = np.zeros((1, rows, columns, 3))
    net[..., 0], net[..., 1] = np.linspace(-2, 2, rows)[:, None], np.linspace(-2, 2, columns)
    return net + 0.4 * np.random.default_rng(seed).normal(size=net.shape)


def rational(seed):
    rng = np.random.default_rng(seed)
    weights = rng.uniform(0.5, 2.0, (4, 4, 3, 1))
    return np.concatenate([weights * np.concatenate([waves(rng, 4, 3) for _ in range(4)]), weights], axis=-1)


@pytest.mark.slow
def test_rational_patches_by_loops():
    patches = rational(5)
    patches[0, 0] = patches[0, 0, :1] / patches[0, 0, :1, 3:] * patches[0, 0, :, 3:]  # a point of several weights
    assert collapsed_sides(patches)[0].tolist() == [True, False, False, False]
    assert_as_by_loops(patches, 4)
    alike = sampled_normal_error(1e-9 * patches, np.full(4, 4), ABOVE)
    np.testing.assert_allclose(alike, sampled_normal_error(patches, np.full(4, 4), ABOVE), rtol=1e-6)


@pytest.mark.slow
def test_gregory_patches_by_loops(models):
    scene = load(models / "monsterfrog.obj", scheme="gregory")
    patches = scene.patches()[np.linspace(0, len(scene.patches()) - 1, 30).astype(int)]
    patches = patches[~collapsed_sides(patches).any(axis=1)]
    assert len(patches) > 20
    assert np.any(patches.twists != 0)
    assert_as_by_loops(patches, 3, View(scene.default_camera(cover=0.05), 480, 300))


def test_tangent_patches_by_loops(models):
    scene = load(models / "spot_control_mesh.obj")
    along = [np.asarray(x)[::40] for x in scene.tangents()]
    patches = np.asarray(scene.patches())[::40]
    view = View(scene.default_camera(cover=0.05), 480, 300)
    assert_as_by_loops(patches, 2, view, normals="tangents", tangents=along)
    assert np.any(along[0] != 3.0 * np.diff(patches, axis=1)), "not the derivatives themselves"


def test_minimal_factors_of_the_teapot_by_normals(teapot):
    """One degree, as dense sampling by NumPy has it."""
    wanted = {13: (0, 4), 4: (4, 8), 15: (8, 12), 16: (12, 14), 12: (14, 16), 18: (16, 18), 33: (18, 20), 27: (20, 24)}
    known = np.zeros(32, int)
    for factor, (start, end) in {**wanted, 19: (28, 32)}.items():
        known[start:end] = factor
    known[24:28] = 16
    found = minimal_factors(teapot.patches(), ABOVE, None, normal_tolerance=1.0)
    assert found.tolist() == known.tolist()
    both = minimal_factors(teapot.patches(), ABOVE, 0.1, normal_tolerance=1.0)
    # errors fall with n here, so that both are kept from the larger one on
    assert both.tolist() == np.maximum(known, minimal_factors(teapot.patches(), ABOVE, 0.1)).tolist()
    assert np.any(both > known)


@pytest.mark.slow
def test_pairs_by_normals_are_valid_and_nothing_smaller_is(teapot):
    patch = teapot.patches()[20:21]
    pair = minimal_pairs(patch, ABOVE, 1.0, normal_tolerance=25.0)
    assert sampled_normal_error(patch, pair, ABOVE)[0] <= 25.0
    assert sampled_error(patch, pair, ABOVE)[0] <= 1.0
    most = int(pair.prod())
    smaller = np.array([(u, v) for u in range(1, most) for v in range(1, most) if u * v < most])
    turned, off = (np.array([f(patch, [x], ABOVE)[0] for x in smaller]) for f in (sampled_normal_error, sampled_error))
    assert np.all((turned > 25.0) | (off > 1.0))
    assert np.any((turned > 25.0) != (off > 1.0))


def test_triangles_of_a_grid_give_the_uniform_error(teapot):
    """The worse of the two diagonals."""
    both = []
    for falling in (False, True):
        own = grid_triangles(7, falling)
        triangles = DomainTriangles(np.repeat(np.arange(32), len(own)), np.tile(own, (32, 1, 1)))
        both.append(triangle_normal_error(teapot.patches(), triangles, ABOVE))
    uniform = sampled_normal_error(teapot.patches(), np.full(32, 7), ABOVE)
    np.testing.assert_allclose(np.max(both, axis=0), uniform, rtol=2e-3)


def test_only_what_is_visible_counts(teapot, main_view):
    """Worst points outside of a part of the picture do not."""
    whole = worst_normal_points(teapot.patches(), np.full(32, 8), ABOVE)
    part = View(Camera.orthographic((3.0, 0.0, 50.0), (3.0, 0.0, 0.0), up=(0, 1, 0), height=2.0), 400, 400)
    seen = worst_normal_points(teapot.patches(), np.full(32, 8), part)
    assert np.array_equal(seen.error == 0.0, np.isnan(seen.u))
    assert 0 < np.isnan(seen.u).sum() < 32
    assert np.all(seen.error <= whole.error * (1 + 1e-3))
    assert minimal_factors(teapot.patches(), part, None, normal_tolerance=5.0)[np.isnan(seen.u)].max() == 0


@settings(max_examples=12)
@given(st.integers(0, 10**6), st.floats(1e-2, 1e2), st.integers(1, 9))
def test_turned_and_scaled_scenes_have_the_same_errors(seed, scale, n):
    """And moved ones, far from the origin."""
    patches = waves(seed)
    turn = Rotation.from_rotvec(np.random.default_rng(seed).normal(size=3)).as_matrix()
    moved = scale * (patches @ turn.T + [100.0, -200.0, 300.0])

    def view(centre):
        eye, up = ((turn @ axis) for axis in np.eye(3)[[2, 1]])
        eye, reach = centre + 50.0 * scale * eye, (10.0 * scale, 100.0 * scale)
        camera = Camera.orthographic(eye, centre, up, height=20.0 * scale, near=reach[0], far=reach[1])
        return View(camera, 400, 400)

    found = sampled_normal_error(moved, [n], view(scale * np.array([100.0, -200.0, 300.0])))
    np.testing.assert_allclose(found, sampled_normal_error(patches, [n], ABOVE), rtol=1e-5, atol=1e-5)


@settings(max_examples=12)
@given(st.integers(0, 10**6), st.integers(1, 9))
def test_flat_patches_have_no_error(seed, n):
    """Whatever their parameters are, so long as normals have one side."""
    rng = np.random.default_rng(seed)
    u, v = np.sort(rng.uniform(-2, 2, (2, 4)))
    patches = np.stack([*np.meshgrid(u, v, indexing="ij"), np.zeros((4, 4))], axis=-1)[None]
    patches[..., 2] = patches[..., :2] @ rng.normal(size=2)
    assert sampled_normal_error(patches, [n], ABOVE)[0] < 1e-9


def umbrella():
    """Whitney's (s, t^2, s t): where s = t = 0 tangents are parallel, around it normals turn."""
    net = np.zeros((1, 2, 3, 3))
    s, (early, late) = np.array([-np.sqrt(0.8), 1.1])[:, None], (-np.sqrt(0.5), np.sqrt(1.7))
    net[..., 0], net[..., 1] = s, [early**2, early * late, late**2]
    net[..., 2] = s * [early, 0.5 * (early + late), late]
    return net


def test_patches_without_a_normal_somewhere_are_named_at_once(monkeypatch):
    """Not after all grids up to the limit have been sampled."""
    windows = []
    real = supremum.cell_errors

    def counting(surface, patch, cells, parts):
        windows.append(len(patch))
        return real(surface, patch, cells, parts)

    monkeypatch.setattr(supremum, "cell_errors", counting)
    patches = np.concatenate([umbrella(), umbrella()])
    patches[0, ..., 2], patches[0, ..., 1] = 0.1, np.linspace(-1, 1, 3)
    says = r"patch 1 \(counted from 0\) needs a factor above 4096 for 1 degrees between normals: .* no normal can never"
    with pytest.raises(InputError, match=says):
        minimal_factors(patches, ABOVE, None, normal_tolerance=1.0)
    with pytest.raises(InputError, match=r"for 0\.5 px and 1 degrees between normals"):
        minimal_factors(patches, ABOVE, 0.5, normal_tolerance=1.0)
    assert sum(windows) < 200_000
    assert minimal_factors(patches[[0, 0]], ABOVE, None, normal_tolerance=1.0).tolist() == [1, 1]


def test_a_curve_has_no_normals():
    line = np.zeros((1, 4, 4, 3))
    line[..., 0] = np.array([-1.0, -0.9, 0.9, 1.0])[:, None]
    found = worst_normal_points(line, [3], ABOVE)
    assert (found.error[0], np.isnan(found.u[0])) == (0.0, True)
    assert minimal_factors(line, ABOVE, None, normal_tolerance=1.0).tolist() == [0]
    assert minimal_factors(line, ABOVE, 0.1, normal_tolerance=1.0) == minimal_factors(line, ABOVE, 0.1)


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda p: sampled_normal_error(p, [1], ABOVE, "flat"), "there is no kind of normals 'flat'"),
        (lambda p: sampled_normal_error(p, [1], ABOVE, "tangents"), "needs tangents="),
        (lambda p: sampled_normal_error(p, [1], ABOVE, "tangents", p), "must be a pair"),
        (lambda p: sampled_normal_error(p, [1], ABOVE, "tangents", (p, p)), r"must have shapes \(1, 3, 4, 3\)"),
        (lambda p: sampled_normal_error(p, [1, 2], ABOVE), "factors of 1 patches"),
        (lambda p: triangle_normal_error(p, None, ABOVE), "what a draw captured"),
        (lambda p: minimal_factors(p, ABOVE, None), "a tolerance is needed"),
        (lambda p: minimal_pairs(p, ABOVE, None), "a tolerance is needed"),
        (lambda p: minimal_factors(p, ABOVE, normal_tolerance=200), "less than 90 degrees, not 200"),
        (lambda p: minimal_factors(p, ABOVE, normal_tolerance=np.ones(2)), "less than 90 degrees"),
        (lambda p: minimal_factors(p, ABOVE, normals="tangent"), "did you mean tangents"),
    ],
)
def test_bad_arguments(call, says):
    with pytest.raises(InputError, match=says):
        call(waves(1))


@pytest.mark.slow
@pytest.mark.gl
@pytest.mark.parametrize("kind", ["teapot", "rational"])
def test_no_pixel_errs_more_than_the_domain(device, teapot, kind):
    """But for single precision; the largest come near."""
    patches = teapot.patches() if kind == "teapot" else rational(7)
    view = View(teapot.default_camera(), 720, 450) if kind == "teapot" else VIEW
    renderer = Renderer(patches, device, normals=True)
    levels = np.full((len(patches), 2), 9), np.full((len(patches), 4), 9)
    seen, captured = renderer.draw(view, *levels), renderer.capture(view, *levels)
    renderer.release()
    error = normal_error(patches, view, seen)
    largest = np.array([np.nanmax(error[seen.patch == k], initial=0.0) for k in range(len(patches))])
    uniform = sampled_normal_error(patches, np.full(len(patches), 9), view)
    drawn = triangle_normal_error(patches, captured, view)
    assert np.all(largest <= drawn + SINGLE)
    assert np.all(drawn <= uniform * 1.01 + SINGLE)
    assert np.max(largest / uniform) > 0.9
