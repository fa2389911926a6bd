"""Gaussian products: conversion to rational patches, covariances from files, poses, and what is claimed of them."""

from __future__ import annotations

from fractions import Fraction
from itertools import combinations, permutations
from math import comb
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree

from slefejax import (
    Gaussians,
    InputError,
    Mesh,
    Pose,
    Scene,
    Session,
    View,
    convert,
    covariance_parameters,
    covariances,
    dual_quaternion_blend,
    evaluate_patches,
    limit_distance,
    linear_blend,
    load,
    minimal_factors,
    sampled_error,
    save,
    tessellation_factors,
    triangle_error,
)
from slefejax.conversion.acc import acc_patches
from slefejax.conversion.catmull_clark import refine
from slefejax.conversion.gaussian.products import Dual, Products, rational_net
from slefejax.experiments.cli import main
from slefejax.gpu import Renderer
from slefejax.model.gaussians import balls, inferred, with_gaussians
from slefejax.tessellator.edges import edge_points
from tests.meshes import disc, grid
from tests.test_cli import run_json

UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))


def torus(condition=20.0, seed=0, nu=4, nv=5) -> Any:
    """A closed mesh of quads, regular, with Gaussians that are discs of that condition number, tilted a little."""
    rng = np.random.default_rng(seed)
    a, b = np.meshgrid(2 * np.pi * np.arange(nu) / nu, 2 * np.pi * np.arange(nv) / nv, indexing="ij")
    normal = np.stack([np.cos(b) * np.cos(a), np.sin(b) * np.cos(a), np.sin(a)], axis=-1).reshape(-1, 3)
    middle = 2.0 * np.stack([np.cos(b), np.sin(b), 0 * b], axis=-1).reshape(-1, 3)
    places = middle + 0.8 * normal + 0.1 * rng.normal(size=normal.shape)
    tilted = normal + 0.3 * rng.normal(size=normal.shape)
    tilted /= np.linalg.norm(tilted, axis=1, keepdims=True)
    spread = np.eye(3) - (1.0 - 1.0 / condition) * tilted[:, :, None] * tilted[:, None, :]
    number = lambda i, j: i % nu * nv + j % nv  # noqa: E731
    faces = [
        (number(i, j), number(i, j + 1), number(i + 1, j + 1), number(i + 1, j)) for i in range(nu) for j in range(nv)
    ]
    return with_gaussians(Mesh.of(places, faces), 0.1 * spread)


def scene_of(mesh, **options) -> Any:
    conversion = convert(mesh, "gaussian", **options)
    return Scene("mesh", conversion.patchwork.on_host(conversion.control), conversion=conversion)


def solved(nets, u, v):
    """Points Q^-1 h of bicubic nets of q ``(patches, 4, 4, 9)`` at parameters, by solving."""
    basis = [np.stack([comb(3, k) * t**k * (1 - t) ** (3 - k) for k in range(4)], axis=-1) for t in (u, v)]
    q = np.einsum("ni,nj,pijc->pnc", *basis, nets)
    matrix = np.empty((*q.shape[:2], 3, 3))
    for k, (i, j) in enumerate(UPPER):
        matrix[..., i, j] = matrix[..., j, i] = q[..., k]
    return np.linalg.solve(matrix, q[..., 6:, None])[..., 0]


PLACES = np.random.default_rng(5).uniform(size=(20, 2))


@pytest.mark.parametrize(
    "mesh",
    [
        with_gaussians(disc(5), "infer"),
        *(pytest.param(m, marks=pytest.mark.slow) for m in (torus(), torus(1e4, 1), with_gaussians(disc(64), 2.0))),
    ],
)
def test_patches_are_what_inverse_covariances_say_at_every_place(mesh):
    conversion: Any = convert(mesh, "gaussian")
    products = conversion.patchwork.products
    q = acc_patches(mesh).on_host(products.dual(conversion.control))
    wanted = solved(q, *PLACES.T) + products.dual.origin
    patches = conversion.patchwork.on_host(conversion.control)
    assert np.all(patches[..., 3] > 0)
    np.testing.assert_allclose(evaluate_patches(patches, PLACES), wanted, atol=1e-11)
    by_jax = conversion.patchwork.patches(conversion.control)
    np.testing.assert_allclose(by_jax, patches, rtol=1e-12, atol=1e-13 * np.abs(patches).max())


@pytest.mark.parametrize("radius", [1.0, *(pytest.param(r, marks=pytest.mark.slow) for r in (1e-3, 1e4))])
def test_balls_give_the_ordinary_surface(radius, main_view):
    mesh = disc(5)
    gaussian, plain = scene_of(with_gaussians(mesh, radius)), convert(mesh, "acc")
    ordinary = plain.patchwork.on_host(mesh.vertices)
    np.testing.assert_allclose(
        evaluate_patches(gaussian.patches(), PLACES), evaluate_patches(ordinary, PLACES), atol=1e-13
    )
    assert 0.3 < gaussian.patches()[..., 3].min() <= gaussian.patches()[..., 3].max() < 3.0, "scaled by powers of two"
    view = View(gaussian.default_camera(), 1440, 900)
    least = [minimal_factors(patches, view) for patches in (gaussian.patches(), ordinary)]
    np.testing.assert_array_equal(least[0], least[1])
    factor = [np.asarray(tessellation_factors(patches, view).factor) for patches in (gaussian.patches(), ordinary)]
    assert np.all(factor[0] <= 1.05 * factor[1]), "nets of higher degree may be tighter"


def exact_net(q):
    """Control points of a 4 x 4 net of q by fractions: the determinant of Q with a column replaced by h, or none."""

    def times(a, b):
        found = {}
        for (i, j), x in a.items():
            for (k, m), y in b.items():
                found[i + k, j + m] = found.get((i + k, j + m), 0) + x * y
        return found

    scaled = [
        {(i, j): Fraction(float(q[i, j, k])) * comb(3, i) * comb(3, j) for i in range(4) for j in range(4)}
        for k in range(9)
    ]
    entry = {pair: scaled[k] for k, (i, j) in enumerate(UPPER) for pair in ((i, j), (j, i))}
    found = np.zeros((10, 10, 4))
    for kept in range(4):
        total = {}
        for order in permutations(range(3)):
            sign = (-1) ** sum(order[a] > order[b] for a, b in combinations(range(3), 2))
            parts = [scaled[6 + row] if column == kept else entry[row, column] for column, row in enumerate(order)]
            for place, value in times(times(parts[0], parts[1]), parts[2]).items():
                total[place] = total.get(place, 0) + sign * value
        for (i, j), value in total.items():
            found[i, j, kept] = float(value / (comb(9, i) * comb(9, j)))
    return found


def alike(stretch, apart, seed=0):
    """q of 4 x 4 Gaussians over the unit square, stretched alike along directions that differ by about so much."""
    rng = np.random.default_rng(seed)
    turn = np.linalg.qr(np.eye(3) + apart * rng.normal(size=(4, 4, 3, 3)))[0]
    inverse = (turn * np.array([1.0, 1.0, stretch])) @ np.swapaxes(turn, -1, -2)
    inverse = 0.5 * (inverse + np.swapaxes(inverse, -1, -2))
    places = np.stack([*np.meshgrid(np.arange(4) / 3.0, np.arange(4) / 3.0, indexing="ij"), np.zeros((4, 4))], axis=-1)
    pulled = (inverse @ (places + 0.05 * rng.normal(size=places.shape))[..., None])[..., 0]
    return np.concatenate([np.stack([inverse[..., i, j] for i, j in UPPER], axis=-1), pulled], axis=-1)


@pytest.mark.parametrize(("stretch", "apart"), [(1e4, 1e-2), (1e6, 1e-4), (1e8, 1e-2)])
def test_nearly_parallel_discs_lose_no_digits_that_matter(stretch, apart):
    q = alike(stretch, apart)
    products, net = Products.of(np.arange(16).reshape(1, 4, 4), Dual(np.zeros(3), 1.0))
    wanted, found = exact_net(q), products(q.reshape(16, 9))[net[0]]
    assert np.all(found[..., 3] > 0)
    np.testing.assert_allclose(found[..., 3], wanted[..., 3], rtol=1e-9)
    np.testing.assert_allclose(found[..., :3] / found[..., 3:], wanted[..., :3] / wanted[..., 3:], atol=1e-6)


def test_weights_and_points_are_sums_of_squares():
    """Cauchy and Binet: sums over triples of planes, one a vertex and axis, of squares and of where planes meet."""
    q = alike(100.0, 0.5)[:2, :2]
    planes, pulls, places = [], [], []
    for place in np.ndindex(2, 2):
        matrix = np.empty((3, 3))
        for k, (i, j) in enumerate(UPPER):
            matrix[i, j] = matrix[j, i] = q[(*place, k)]
        lower = np.linalg.cholesky(matrix)
        planes += list(lower.T)
        pulls += list(np.linalg.solve(lower, q[(*place, slice(6, None))]))
        places += [place] * 3
    found = np.zeros((4, 4, 4))
    for three in combinations(range(len(planes)), 3):
        rows, size = np.array([planes[k] for k in three]), [pulls[k] for k in three]
        square = np.linalg.det(rows) ** 2
        i, j = np.sum([places[k] for k in three], axis=0)
        point = np.linalg.solve(rows, size) if square > 1e-20 else np.zeros(3)
        found[i, j] += square * np.append(point, 1.0)
    found /= np.multiply.outer([1.0, 3.0, 3.0, 1.0], [1.0, 3.0, 3.0, 1.0])[..., None]
    np.testing.assert_allclose(rational_net(q[..., None])[..., 0], found, rtol=1e-9, atol=1e-9)


def test_regular_parts_are_the_surface_of_recursive_subdivision():
    mesh = torus(50.0)
    scene = scene_of(mesh)
    dual = scene.conversion.patchwork.products.dual
    finer, first, _ = refine(mesh)
    finest, second, _ = refine(finer)
    q = second.on_host(first.on_host(dual(scene.conversion.control)))
    corners = acc_patches(finest).on_host(q)[:, [0, 0, 3, 3], [0, 3, 0, 3]].reshape(-1, 1, 1, 9)
    limit = solved(np.tile(corners, (1, 4, 4, 1)), *np.array([[0.0, 0.0]]).T)[:, 0]
    t = np.linspace(0.0, 1.0, 5)
    own = evaluate_patches(scene.patches(), np.stack(np.meshgrid(t, t), axis=-1).reshape(-1, 2)).reshape(-1, 3)
    assert KDTree(limit).query(own - dual.origin)[0].max() < 1e-12


def test_affine_maps_of_means_and_covariances_move_the_surface():
    rng, mesh = np.random.default_rng(3), torus(1e3)
    linear, shift = rng.normal(size=(3, 3)) + 2.0 * np.eye(3), 10.0 * rng.normal(size=3)
    other = Gaussians(mesh.vertices @ linear.T + shift, linear @ mesh.covariances @ linear.T)
    moved = with_gaussians(Mesh.packed(other.means, mesh.corners, mesh.sizes), other.covariances)
    points = [evaluate_patches(scene_of(own).patches(), PLACES) for own in (mesh, moved)]
    np.testing.assert_allclose(points[0] @ linear.T + shift, points[1], atol=1e-9)


def test_neighbours_have_the_same_points_on_a_side():
    scene = scene_of(with_gaussians(disc(5), "infer"))
    curves = np.stack(edge_points(scene.patches()), axis=1).reshape(-1, 10, 4)
    numbers = scene.edge_numbers.ravel()
    shared = [np.flatnonzero(numbers == k) for k in np.unique(numbers)]
    for one, other in (pair for pair in shared if len(pair) == 2):
        assert any(np.array_equal(curves[one], curves[other][::step]) for step in (1, -1))
    assert sum(len(pair) == 2 for pair in shared) > 5


def test_triangles_are_pinched():
    mesh = with_gaussians(Mesh.of(np.eye(4, 3), [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)]), "infer")
    scene = scene_of(mesh)
    top = scene.patches()[:, -1]
    assert np.array_equal(top, np.broadcast_to(top[:, :1], top.shape))
    assert any("pinched" in note for note in scene.conversion.notes)
    assert scene.patches().shape == (4, 10, 10, 4)


def test_faces_of_more_vertices_take_a_step():
    angle = 2 * np.pi * np.arange(5) / 5
    pentagon = Mesh.of(np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1), [(0, 1, 2, 3, 4)])
    scene = scene_of(with_gaussians(pentagon, 1.0))
    assert len(scene.patches()) == 5
    assert any("n-gons" in note for note in scene.conversion.notes)
    assert len(scene_of(torus(), steps=1).patches()) == 80


@pytest.mark.slow
def test_gradients_agree_with_differences():
    mesh = torus(10.0)
    conversion = convert(mesh, "gaussian")
    parameters = covariance_parameters(mesh.covariances)
    rng = np.random.default_rng(1)

    def height(vertices, numbers):
        patches = conversion.patchwork.patches(Gaussians(vertices, covariances(numbers)))
        return jnp.sum(evaluate_patches(patches, PLACES) ** 2)

    at = jnp.asarray(mesh.vertices), jnp.asarray(parameters)
    height, slopes = jax.jit(height), jax.jit(jax.grad(height, (0, 1)))(*at)
    for k in (0, 1):
        way, step = rng.normal(size=at[k].shape), 1e-5
        ends = [height(*(x + (sign * step * way if i == k else 0.0) for i, x in enumerate(at))) for sign in (1, -1)]
        assert (ends[0] - ends[1]) / (2 * step) == pytest.approx(float(np.sum(slopes[k] * way)), rel=1e-6)


def test_parameters_of_covariances_are_the_inverse():
    spread = torus(1e3).covariances
    np.testing.assert_allclose(covariances(covariance_parameters(spread)), spread, rtol=1e-12, atol=1e-15)
    assert np.all(np.linalg.eigvalsh(covariances(np.random.default_rng(0).normal(size=(50, 6)))) > 0)
    with pytest.raises(InputError, match="six parameters"):
        covariances(np.zeros(5))


@pytest.mark.parametrize("blend", [pytest.param(linear_blend, marks=pytest.mark.slow), dual_quaternion_blend])
def test_covariances_turn_with_bones(blend):
    """Where all bones make one rigid motion, the whole surface does."""
    scene: Any = load("walker", scheme="gaussian", gaussians="infer")
    rest = scene.rig.pose(None)
    turn = np.linalg.qr(np.random.default_rng(2).normal(size=(3, 3)))[0]
    turn *= np.linalg.det(turn)
    motion = np.eye(4)
    motion[:3, :3], motion[:3, 3] = turn, [1.0, 2.0, 3.0]
    local = np.array(scene.rig.check(rest).local if scene.rig.rest.local is not None else scene.rig.skeleton.rest)
    roots = scene.rig.skeleton.parents < 0
    local[roots] = motion @ local[roots]
    moved, still = scene.gaussians(Pose(local), deform=blend), scene.gaussians()
    np.testing.assert_allclose(moved.covariances, turn @ still.covariances @ turn.T, atol=1e-9)
    np.testing.assert_allclose(moved.means, still.means @ turn.T + motion[:3, 3], atol=1e-9)


def test_a_session_takes_covariances_and_keeps_what_they_leave():
    mesh = torus(20.0)
    scene = scene_of(mesh)
    view = View(scene.default_camera(), 320, 200)
    session = Session(scene)
    first = session.factors(view)
    np.testing.assert_allclose(session.patches, scene.patches(), rtol=1e-12)
    assert session.factors(view) is first
    before = np.array(session.patches)
    changed = mesh.covariances.copy()
    changed[0] *= 4.0
    second = session.factors(view, Pose(covariances=changed))
    assert session.recomputed == ("pose", "view")
    other = scene.posed(Pose(covariances=changed))
    # coordinates are about 1, and what cancels to nearly 0 is off by their rounding
    np.testing.assert_allclose(session.patches, other.patches(), rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(second.factor, tessellation_factors(other.patches(), view).factor, rtol=1e-9)
    untouched = np.all(np.asarray(session.patches) == before, axis=(1, 2, 3))
    assert 0 < untouched.sum() < len(untouched)
    changed[3] = -np.eye(3)
    with pytest.raises(InputError, match="vertex 3"):
        session.factors(view, Pose(covariances=changed))


def test_single_precision_makes_patches_in_double_precision():
    scene = scene_of(torus(1e4))
    with jax.enable_x64(False):
        session = Session(scene)
        session.factors(View(scene.default_camera(), 320, 200))
        np.testing.assert_allclose(session.patches, scene.patches(), rtol=1e-6)
        with pytest.raises(InputError, match="jax_enable_x64"):
            scene.conversion.patchwork.patches(scene.conversion.control)


@pytest.mark.parametrize(
    ("condition", "tiles"),
    [(100.0, 2), *(pytest.param(*own, marks=pytest.mark.slow) for own in ((1.0, 2), (20.0, 2), (20.0, 1)))],
)
def test_factors_hold_and_are_nearly_minimal(condition, tiles):
    scene = scene_of(torus(condition))
    view = View(scene.default_camera(), 1440, 900)
    factor = np.ceil(tessellation_factors(scene.patches(), view, tiles=tiles).factor)
    assert np.all(sampled_error(scene.patches(), factor.astype(int), view) <= 0.5)
    least = minimal_factors(scene.patches(), view)
    if tiles == 2:
        assert np.median(factor / least) <= 1.15
        assert np.percentile(factor / least, 95) <= 1.25


@pytest.mark.gl
@pytest.mark.slow
def test_drawn_pictures_hold(device):
    scene = scene_of(torus(5.0, nu=3, nv=4))
    view = View(scene.default_camera(), 160, 100)
    factors = tessellation_factors(scene.patches(), view, edge_numbers=scene.edge_numbers)
    renderer = Renderer(scene.patches(), device)
    drawn = renderer.capture(view, factors.inner, factors.edges)
    renderer.release()
    assert np.all(triangle_error(scene.patches(), drawn, view) <= 0.5)


@pytest.mark.slow
def test_caps_come_nearer_to_the_limit_surface():
    mesh = with_gaussians(disc(5), "infer")
    found = [limit_distance(scene_of(mesh, steps=steps)).largest for steps in (1, 2)]
    assert 0.2 < found[1] / found[0] < 0.5
    assert limit_distance(scene_of(torus())).largest == 0.0


def ply(mesh: Any, names="xx xy xz yy yz zz", broken=None):
    rows = [
        " ".join(map(repr, [*x.tolist(), *(float(c[i, j]) for i, j in UPPER)][: 3 + len(names.split())]))
        for x, c in zip(mesh.vertices, mesh.covariances, strict=True)
    ]
    head = ["ply", "format ascii 1.0", f"element vertex {mesh.vertex_count}", *(f"property double {a}" for a in "xyz")]
    head += [f"property double cov_{name}" for name in names.split()]
    head += [f"element face {mesh.face_count}", "property list uchar int vertex_indices", "end_header"]
    faces = [f"4 {' '.join(map(str, face))}" for face in mesh.corners.reshape(-1, 4)]
    return "\n".join([*head, *rows, *faces]) + "\n"


def test_files_keep_covariances(tmp_path):
    mesh = torus()
    (tmp_path / "mesh.ply").write_text(ply(mesh))
    scene: Any = load(tmp_path / "mesh.ply")
    assert scene.conversion.scheme == "gaussian"
    np.testing.assert_array_equal(scene.conversion.mesh.covariances, mesh.covariances)
    save(scene, tmp_path / "copy.json")
    again = load(tmp_path / "copy.json")
    np.testing.assert_array_equal(again.patches(), scene.patches())
    twice = load(tmp_path / "mesh.ply", copies=2)
    assert len(twice.patches()) == 2 * len(scene.patches())
    plain = load(tmp_path / "mesh.ply", scheme="acc")
    assert any("covariances" in note for note in plain.notes)
    (tmp_path / "bad.ply").write_text(ply(mesh, "xx xy xz yy yz"))
    with pytest.raises(InputError, match="cov_zz"):
        load(tmp_path / "bad.ply")


def changed(spread, vertex, matrix):
    found = spread.copy()
    found[vertex] = matrix
    return found


BAD = {
    "not symmetric": lambda c: changed(c, 3, [[1, 2, 0], [0, 1, 0], [0, 0, 1]]),
    "vertex 4 .* eigenvalue -1": lambda c: changed(c, 4, np.diag([1.0, 1.0, -1.0])),
    "vertex 5 .* eigenvalue 0": lambda c: changed(c, 5, np.diag([1.0, 0.0, 1.0])),
    "vertex 6 .* not finite": lambda c: changed(c, 6, np.nan),
    "must be": lambda c: c[:3],
    "radius": lambda _: -1.0,
    "'infer', a radius": lambda _: "guess",
}


@pytest.mark.parametrize("said", BAD)
def test_bad_covariances_are_refused_with_the_vertex(said):
    mesh = torus()
    with pytest.raises(InputError, match=said):
        with_gaussians(mesh, BAD[said](mesh.covariances))


def test_meshes_without_covariances_are_refused(tmp_path):
    with pytest.raises(InputError, match="give gaussians"):
        convert(grid(2, 2), "gaussian")
    with pytest.raises(InputError, match="coincide"):
        inferred(Mesh.of(np.zeros((4, 3)), [(0, 1, 2, 3)]))
    with pytest.raises(InputError, match="no covariances"):
        load("walker").gaussians()
    with pytest.raises(InputError, match="has none"):
        load("walker").pose(Pose(covariances=np.eye(3)))


def test_thin_weights_are_refused_unless_allowed(tmp_path):
    spread = balls(25, 1.0)
    spread[12] = np.diag([1e-5, 1e-5, 1e-6])
    mesh = with_gaussians(grid(5, 5), spread)
    (tmp_path / "thin.ply").write_text(ply(mesh))
    with pytest.raises(InputError, match="vertex 12"):
        load(tmp_path / "thin.ply")
    scene = load(tmp_path / "thin.ply", allow_thin=True)
    assert any("single precision" in note for note in scene.notes)


def test_commands_take_gaussians(capsys, tmp_path):
    mesh = torus()
    (tmp_path / "mesh.obj").write_text(
        "".join(f"v {x} {y} {z}\n" for x, y, z in mesh.vertices)
        + "".join(f"f {' '.join(map(str, face + 1))}\n" for face in mesh.corners.reshape(-1, 4))
    )
    np.save(tmp_path / "spread.npy", mesh.covariances)
    given = "--gaussians", str(tmp_path / "spread.npy")
    found = run_json(capsys, "factors", str(tmp_path / "mesh.obj"), *given, "--size", "160x100")
    assert len(found["rows"]) == 20
    (tmp_path / "broken.npy").write_bytes(b"none")
    for given, said in (("guess", "--gaussians"), (str(tmp_path / "broken.npy"), "no .npy"), ("-2", "radius")):
        assert main(["factors", str(tmp_path / "mesh.obj"), f"--gaussians={given}"]) == 2
        assert said in capsys.readouterr().err


def test_products_have_one_number_for_one_point():
    mesh = torus()
    work = acc_patches(mesh)
    products, net = Products.of(work.net, Dual.of(Gaussians(mesh.vertices, mesh.covariances)))
    assert net.max() + 1 == len(np.unique(net)) == 20 + 8 * 40 + 64 * 20
    assert products.corners.shape[2] == 20
