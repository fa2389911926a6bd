from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import InputError, load
from slefejax.bounds.bspline import basis_pieces
from slefejax.conversion.acc import ALPHA, acc_patches
from slefejax.conversion.catmull_clark import refine
from slefejax.conversion.patchwork import KINDS
from slefejax.conversion.scheme import Acc, Subdivided, convert
from slefejax.conversion.tangents import corner_tangents, tangent_tables
from slefejax.geometry.bezier import evaluate_patch
from slefejax.lanes import layout
from slefejax.model.mesh import Mesh
from tests.meshes import cube, disc, grid, mixed, triangle_fan
from tests.test_catmull_clark import creased
from tests.test_io import write
from tests.test_scene import CUBE

VALENCES = [*range(3, 13), 16, 24, 33, 64]


def sharp_disc(rng):
    mesh = disc(6, rng=rng)
    ring = mesh.one_ring(0)
    return creased(mesh, np.inf, pairs=[[0, ring[0]], [0, ring[2]]])


MESHES = {
    "grid": lambda rng: grid(5, 4, rng=rng),
    "torus": lambda rng: grid(5, 4, True, True, rng=rng),
    "cube": lambda rng: cube(),
    "disc 3": lambda rng: disc(3, rng=rng),
    "disc 64": lambda rng: disc(64, rng=rng),
    "half disc": lambda rng: disc(10, rng=rng, half=True),
    "fan 3": lambda rng: triangle_fan(3, rng=rng),
    "fan 8": lambda rng: triangle_fan(8, rng=rng),
    "tetrahedron": lambda rng: Mesh.of(rng.normal(size=(4, 3)), [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)]),
    "creased disc": sharp_disc,
    "creased cube": lambda rng: creased(cube(), np.inf),
    "mixed": lambda rng: refine(mixed(rng))[0],
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize("alpha", [2.5, 1.0])
def test_points_are_affine_combinations_that_move_with_the_mesh(rng, name, alpha):
    mesh = MESHES[name](rng)
    work = acc_patches(mesh, alpha)
    np.testing.assert_allclose(work.points.row_sums(), 1.0, atol=1e-15)
    assert work.points.matrix.data.min() > 0, "patches stay in the convex hull"
    turn, move = rng.normal(size=(3, 3)), rng.normal(size=3)
    moved = work.on_host(mesh.vertices @ turn + move)
    np.testing.assert_allclose(moved, work.on_host(mesh.vertices) @ turn + move, atol=1e-12)
    flat = mesh.vertices.copy()
    flat[:, 2] = 0.3 * flat[:, 0] - flat[:, 1]
    patches = work.on_host(flat)
    np.testing.assert_allclose(patches[..., 2], 0.3 * patches[..., 0] - patches[..., 1], atol=1e-12)


@pytest.mark.parametrize("name", MESHES)
def test_neighbours_share_their_boundary_bitwise_and_the_jax_path_agrees(rng, name):
    mesh = MESHES[name](rng)
    work = acc_patches(mesh)
    host, jaxed = work.on_host(mesh.vertices), np.asarray(work.patches(mesh.vertices))
    np.testing.assert_allclose(jaxed, host, atol=1e-14 * np.abs(host).max())
    packed = work.packed(mesh.vertices)
    np.testing.assert_array_equal(layout.unpack(packed, len(host)), jaxed)
    # by topology every inner edge is shared, and no other; by place as well, whichever way the points were computed
    uses = np.bincount(work.edge_numbers.ravel())
    assert np.count_nonzero(uses == 2) == np.count_nonzero(mesh.edge_faces == 2)
    assert uses.max() <= 2
    for points in (host, jaxed):
        sides = np.stack([points[:, 0], points[:, :, 0], points[:, -1], points[:, :, -1]], axis=1).reshape(-1, 4, 3)
        for number in np.flatnonzero(uses == 2):
            one, other = sides[work.edge_numbers.ravel() == number]
            assert np.array_equal(one, other) or np.array_equal(one, other[::-1])


def bspline_patch(points):
    """Bézier control points of the uniform bicubic spline with these 4 x 4 control points, from its exact basis."""
    pieces = np.array([[float(c) for c in piece] for piece in reversed(basis_pieces(3))])
    return np.einsum("ai,bj,abk->ijk", pieces, pieces, points)


@pytest.mark.parametrize("closed", [(True, True), (True, False), (False, False)])
def test_a_regular_mesh_gives_its_bspline(rng, closed):
    """Boundaries: ghost points by reflection, 2 V minus the inner neighbour."""
    mesh = grid(6, 5, *closed, rng=rng)
    net = mesh.vertices.reshape(6, 5, 3)
    for axis, wraps in enumerate(closed):
        first, last = (np.take(net, [k], axis) for k in (0, -1))
        inner, before = (np.take(net, [k], axis) for k in (1, -2))
        ends = (last, first, inner) if wraps else (2 * first - inner, 2 * last - before)
        net = np.concatenate([ends[0], net, *ends[1:]], axis=axis)
    found = acc_patches(mesh).on_host(mesh.vertices).reshape(6 - (not closed[0]), 5 - (not closed[1]), 4, 4, 3)
    for i in range(found.shape[0]):
        for j in range(found.shape[1]):
            wanted = bspline_patch(net[i : i + 4, j : j + 4])
            np.testing.assert_allclose(found[i, j], wanted, atol=4e-15)


@pytest.mark.parametrize("valence", VALENCES)
def test_corners_are_limit_points(rng, valence):
    """The mask of the limit does not change by a step of subdivision; and many steps get there."""
    mesh = disc(valence, rng=rng)
    finer, step, _ = refine(mesh)
    once, twice = acc_patches(mesh).points, acc_patches(finer).points @ step
    inner = np.flatnonzero(np.isin(np.arange(mesh.vertex_count), mesh.edge_vertices[mesh.boundary], invert=True))
    difference = (once.take(inner) - twice.take(inner)).matrix
    assert np.abs(difference.data).max(initial=0.0) < 2e-15 * np.sqrt(valence)
    limit = mesh
    for _ in range(4 if valence < 16 else 2):
        limit = refine(limit)[0]
    assert np.abs(limit.vertices[0] - once.on_host(mesh.vertices)[0]).max() < (0.05 if valence < 16 else 0.5)


def stencil(work, mesh, point):
    """Weights of a control point by vertex, times a factor that makes the sum whole."""
    row = work.points.take([point]).matrix
    return dict(zip(row.indices.tolist(), row.data.tolist(), strict=True))


def test_the_published_stencils_for_triangles():
    """[Yeo12], figure 6-6, n = 8 triangles around vertex 0, quads outside; and a mixed vertex."""
    n = 8
    mesh = triangle_fan(n)
    work = acc_patches(mesh)
    net = {int(f): work.net[k] for k, f in enumerate(work.faces)}
    corner = stencil(work, mesh, 0)
    total = n * n + 5 * n
    assert corner == pytest.approx({0: n * n / total, **{k: 5 / total for k in range(1, n + 1)}})
    triangle = net[0]  # vertices 0, 1, 2, pinched at 0, of the highest valence
    assert np.all(triangle[3] == 0)
    assert triangle[2, 1] == triangle[2, 2]
    assert len(np.unique(triangle)) == 12
    inside = stencil(work, mesh, triangle[2, 1])
    assert inside == pytest.approx({0: n / (n + 5), 1: 2.5 / (n + 5), 2: 2.5 / (n + 5)})
    to_ring = stencil(work, mesh, triangle[2, 0])  # on the side 0 -> 2 or 0 -> 1, triangles on both sides
    assert sorted(to_ring.values()) == pytest.approx(sorted(w / (2 * n + 10) for w in (2 * n, 5, 2.5, 2.5)))
    # vertex 1 has 2 triangles and 2 quads; its edge to 2 lies between a triangle and a quad
    mixed_corner = stencil(work, mesh, 1)
    weights = sorted(w * (16 + 2 * 4.5 + 5 + 4 + 2) for w in mixed_corner.values())
    assert weights == pytest.approx([1, 1, 4, 4.5, 4.5, 5, 16])
    across = stencil(work, mesh, triangle[0, 1])
    assert sorted(w * (8 + 4.5 + 2.5 + 2 + 1) for w in across.values()) == pytest.approx([1, 2, 2.5, 4.5, 8])


@pytest.mark.parametrize(("alpha", "midway"), [(2.5, True), (1.5, False)])
def test_edge_points_are_midway_between_interior_points(rng, alpha, midway):
    """Of smooth inner edges; what alpha = 2.5 is for."""
    mesh = triangle_fan(7, rng=rng)
    work = acc_patches(mesh, alpha)
    points = work.points.on_host(mesh.vertices)
    first = mesh.vertex_count + 2 * mesh.edge_count
    worst = 0.0
    for c in np.flatnonzero(mesh.twin >= 0):
        other = mesh.next_corner[mesh.twin[c]]
        edge = mesh.vertex_count + 2 * mesh.edge[c] + int(mesh.corners[c] > mesh.ends[c])
        worst = max(worst, float(np.abs(points[edge] - (points[first + c] + points[first + other]) / 2).max()))
    assert (worst < 1e-14) == midway


def test_collapse_at_the_vertex_of_highest_valence_lowest_number():
    tetrahedron = Mesh.of(np.eye(4, 3), [(1, 2, 3), (0, 3, 2), (3, 0, 1), (2, 1, 0)])
    assert acc_patches(tetrahedron).net[:, 3, 0].tolist() == [1, 0, 0, 0]
    assert acc_patches(triangle_fan(5)).net[0, 3, 0] == 0


def test_winding_stays_as_it_is():
    """A flat mesh seen from above: du x dv points up in every patch, triangles too."""
    for mesh in (grid(3, 3), disc(5), triangle_fan(5)):
        patches = acc_patches(mesh).on_host(mesh.vertices)
        du = patches[:, 1:, :-1] - patches[:, :-1, :-1]
        dv = patches[:, :-1, 1:] - patches[:, :-1, :-1]
        assert np.all(np.cross(du, dv)[..., 2] > -1e-12)
        assert np.all(np.cross(du[:, 1, 1], dv[:, 1, 1])[:, 2] > 0)


def test_kinds(rng):
    kinds = lambda mesh: {KINDS[k] for k in acc_patches(mesh).kinds}  # noqa: E731
    assert kinds(grid(5, 5, True, True)) == {"regular"}
    assert kinds(cube()) == {"extraordinary"}
    assert kinds(grid(3, 3)) == {"boundary"}
    assert kinds(creased(grid(5, 5, True, True), 1.0)) == {"crease"}
    assert kinds(triangle_fan(5)) == {"triangle", "extraordinary", "boundary"}
    assert kinds(sharp_disc(rng)) == {"crease", "boundary"}


def test_a_sharp_crease_is_a_boundary_from_both_sides(rng):
    """Patches on either side are those of the mesh cut along the crease."""
    mesh = grid(6, 6, True, True, rng=rng)
    ring = np.arange(6) * 6
    pairs = [np.stack([ring + k, np.roll(ring, -1) + k], axis=1) for k in (0, 3)]
    sharp = creased(mesh, 1.0, pairs=np.concatenate(pairs))
    side = np.isin(mesh.corners.reshape(-1, 4), np.concatenate([ring + k for k in range(4)])).all(axis=1)
    alone = mesh.keep(np.asarray(side))
    np.testing.assert_allclose(
        acc_patches(sharp).on_host(mesh.vertices)[side], acc_patches(alone).on_host(mesh.vertices), atol=1e-15
    )


def fields(mesh, vertices):
    work = acc_patches(mesh)
    du, dv = (table.on_host(vertices) for table in tangent_tables(mesh, work))
    return work.on_host(vertices), du.reshape(-1, 3, 4, 3), dv.reshape(-1, 4, 3, 3)


def along_sides(du, dv, t):
    """Unit normals of a patch along its four half-edges a b, b c, c d, d a."""
    zero, one = 0 * t, 0 * t + 1
    for u, v in ((t, zero), (one, t), (1 - t, one), (zero, 1 - t)):
        normal = np.cross(evaluate_patch(du[..., None], u, v).T, evaluate_patch(dv[..., None], u, v).T)
        yield normal / np.linalg.norm(normal, axis=1, keepdims=True)


@pytest.mark.parametrize("name", ["torus", "cube", "disc 3", "disc 64", "half disc", "creased disc", "mixed", "fan 8"])
def test_normals_of_tangent_patches_agree_across_edges(rng, name):
    """To rounding on all inner, smooth edges with quads only around both ends; derivatives alone do not."""
    mesh = MESHES[name](rng)
    patches, du, dv = fields(mesh, mesh.vertices)
    t = np.linspace(0, 1, 9)
    quads = np.flatnonzero(mesh.sizes == 4)
    normal = {int(f): list(along_sides(du[f], dv[f], t)) for f in quads}
    plain = {int(f): list(along_sides(np.diff(patches[f], axis=0), np.diff(patches[f], axis=1), t)) for f in quads}
    touched = np.unique(mesh.corners[(mesh.sizes != 4)[mesh.face]])
    worst, without, edges = 0.0, 0.0, 0
    for c in np.flatnonzero((mesh.twin >= 0) & (mesh.edge_sharpness == 0)[mesh.edge]):
        ends = [mesh.corners[c], mesh.ends[c]]
        if np.isin(ends, touched).any():
            continue
        o = mesh.twin[c]
        sides = [(int(mesh.face[k]), int(k - mesh.offsets[mesh.face[k]])) for k in (c, o)]
        difference = lambda n: np.abs(n[sides[0][0]][sides[0][1]] - n[sides[1][0]][sides[1][1]][::-1]).max()  # noqa: E731, B023
        worst, without, edges = max(worst, difference(normal)), max(without, difference(plain)), edges + 1
    assert edges > 0
    assert worst < 1e-12
    assert name in ("torus", "fan 8") or without > 1e-3


@pytest.mark.parametrize(
    ("valence", "half"), [*((n, False) for n in VALENCES), *((2 * faces, True) for faces in (2, 3, 4, 5, 7, 12, 32))]
)
def test_corner_tangents_span_the_limit_tangent_plane(valence, half):
    """Left eigenvectors: a step of subdivision leaves their span as it is. Faces on half a disc: a boundary vertex."""
    from slefejax.conversion.acc import Neighbourhood
    from slefejax.conversion.tangents import _frame

    rows = []
    mesh = disc(valence, half=half)
    finer, step, _ = refine(mesh)
    for m, after in ((mesh, None), (finer, step)):
        around = Neighbourhood.of(m)
        fan = int(np.flatnonzero(around.fans.vertex == 0)[0])
        both = [table.take([fan]) for table in _frame(around)]
        rows.append(np.concatenate([(t if after is None else t @ after).matrix.toarray() for t in both]))
    before, later = rows
    solution, *_ = np.linalg.lstsq(before.T, later.T, rcond=None)
    np.testing.assert_allclose(before.T @ solution, later.T, atol=1e-15)
    assert np.all(np.linalg.norm(solution, axis=0) > 0.4)


def test_tangent_patches_of_regular_meshes_are_derivatives(rng):
    for mesh in (grid(6, 5, True, True, rng=rng), grid(5, 5, rng=rng)):
        patches, du, dv = fields(mesh, mesh.vertices)
        np.testing.assert_allclose(du, 3 * np.diff(patches, axis=1), atol=2e-14)
        np.testing.assert_allclose(dv, 3 * np.diff(patches, axis=2), atol=2e-14)


def test_tangents_around_a_vertex_belong_together(rng):
    from slefejax.conversion.acc import Neighbourhood

    around = Neighbourhood.of(disc(7, rng=rng))
    ahead, aside, sound = corner_tangents(around)
    mesh = around.mesh
    assert np.array_equal(sound, around.fans.closed | (around.fans.size > 1))
    turn = mesh.twin[mesh.prev_corner]
    inner = np.flatnonzero(turn >= 0)
    difference = (aside.take(inner) - ahead.take(turn[inner])).matrix
    assert np.abs(difference.data).max(initial=0) < 1e-15


@pytest.mark.parametrize(
    ("scheme", "make", "says"),
    [
        ("acc", triangle_fan, r"scheme 'acc' takes quads only, and face 0 .* has 3 vertices \(5 such faces\)"),
        ("pinched", lambda n: mixed(np.random.default_rng(n)), "takes quads and triangles only, and face 1 .* has 5"),
        ("bspline", disc, "for regular meshes, and vertex 0 .* has 5 faces"),
        ("bspline", lambda n: creased(grid(n, n), 1.0), "knows no creases"),
        ("loop", disc, "no scheme 'loop': choose one of auto, acc"),
    ],
)
def test_schemes_that_cannot_do_with_a_mesh(scheme, make, says):
    with pytest.raises(InputError, match=says):
        convert(make(5), scheme)


def test_options_of_schemes():
    for bad in (0.0, -1.0, np.nan, np.inf, "2", None, np.array([1.0, 2.0])):
        with pytest.raises(InputError, match="alpha must be a positive number"):
            convert(cube(), alpha=cast(Any, bad))
    for bad in (0, 9, 1.0, True):
        with pytest.raises(InputError, match="steps must be a whole number from 1 to 8"):
            convert(cube(), "catmull-clark+acc", steps=cast(Any, bad))
    with pytest.raises(InputError, match="steps belong to the schemes 'catmull-clark"):
        convert(cube(), steps=1)


def test_what_auto_chooses(rng):
    assert convert(cube()).scheme == "acc"
    assert convert(triangle_fan(5)).scheme == "pinched"
    found = convert(mixed(rng))
    assert found.scheme == "catmull-clark+acc"
    assert len(found.patchwork.net) == 3 + 4 * 3 + 5 * 3
    assert np.array_equal(np.unique(found.patchwork.faces), np.arange(7))
    kinds = convert(grid(4, 4), "bspline").patchwork.kinds
    assert (np.sum(kinds == KINDS.index("regular")), np.sum(kinds == KINDS.index("boundary"))) == (1, 8)


def test_steps_of_subdivision_converge_to_the_same_surface():
    """The middle of a face of a cube: near the limit with no step, at it from the first one on."""
    mesh = cube()
    middles = []
    for steps in range(4):
        found = convert(mesh, "catmull-clark+acc" if steps else "acc", steps=steps or None)
        patches = found.patchwork.on_host(mesh.vertices)[found.patchwork.faces == 1]  # the face x = 1
        at = (
            evaluate_patch(np.moveaxis(patches, 0, -1), 0.5, 0.5)
            if not steps
            else patches[:, [0, 0, 3, 3], [0, 3, 0, 3]]
        )
        middles.append(at[..., 0].max() if steps else at[0].max())
    assert np.ptp(middles[1:]) < 1e-14
    assert 0 < abs(middles[0] - middles[1]) < 0.02


@pytest.mark.parametrize("case", ["T of creases", "corner at a boundary", "corner on a crease"])
def test_normals_do_not_vanish_at_corners(case):
    """Where limit tangents span no plane the patch's own derivatives serve."""
    mesh = grid(4, 4)
    number = np.arange(16).reshape(4, 4)
    if case == "T of creases":
        row = [[number[i, 2], number[i + 1, 2]] for i in range(3)]
        mesh = creased(mesh, 2.0, pairs=[*row, [number[1, 2], number[1, 3]]])
    elif case == "corner at a boundary":
        mesh = creased(mesh, 1.0, pairs=np.zeros((0, 2), int), points=[2], point_sharpness=[5.0])
    else:
        mesh = creased(mesh, 3.0, pairs=[[5, 9]], points=[5], point_sharpness=[5.0])
    _, du, dv = fields(mesh, mesh.vertices)
    corner = np.cross(du[:, [0, -1, -1, 0], [0, 0, -1, -1]], dv[:, [0, -1, -1, 0], [0, 0, -1, -1]])
    inner = np.isin(mesh.corners.reshape(-1, 4), mesh.edge_vertices[mesh.boundary])
    assert np.all(corner[..., 2][~inner | (case == "corner at a boundary")] > 1e-3)


def test_too_many_patches_are_refused():
    with pytest.raises(InputError, match="8 steps would make 23,592,960 patches, more than 2,000,000: take fewer"):
        convert(grid(19, 21), "catmull-clark+acc", steps=8)


def test_notes_tell_what_is_left_out(rng):
    mesh = grid(5, 5, True, True, rng=rng)
    assert convert(mesh).notes == ()
    assert "1 creases of sharpness up to 3 are drawn infinitely sharp" in convert(creased(mesh, 3.0, [[0, 1]])).notes[0]
    assert "1 creases of sharpness below 1 are drawn smooth" in convert(creased(mesh, 0.4, [[0, 1]])).notes[0]
    assert convert(creased(mesh, 1.0, [[0, 1]]), "catmull-clark+acc").notes == ()
    assert convert(creased(mesh, np.inf, [[0, 1]])).notes == ()
    assert "not midway" in convert(triangle_fan(5), alpha=2.0).notes[0]


@pytest.mark.slow
def test_gradients_go_through_the_conversion(rng):
    """Of a number that depends on all patches and their tangents, by every vertex, against finite differences."""
    found = convert(triangle_fan(3, rng=rng))
    vertices = found.mesh.vertices
    weights = rng.normal(size=found.patchwork.on_host(vertices).shape)

    def number(v):
        du, dv = found.tangents(v)
        return jnp.sum(weights * found.patchwork.patches(v) ** 2) + jnp.sum(du**2) - jnp.sum(dv**2)

    gradient = jax.grad(number)(vertices)
    for _ in range(3):
        direction = rng.normal(size=vertices.shape)
        numeric = (number(vertices + 1e-5 * direction) - number(vertices - 1e-5 * direction)) / 2e-5
        np.testing.assert_allclose(np.sum(gradient * direction), numeric, rtol=1e-7)


class Again:
    """Approximate Catmull-Clark as a scheme of one's own."""

    def patchwork(self, mesh):
        return acc_patches(mesh, ALPHA)


class Nothing:
    def __init__(self, made):
        self.made = made

    def patchwork(self, mesh):
        return self.made


def test_a_scheme_of_ones_own(tmp_path, monkeypatch):
    """Registered again, approximate Catmull-Clark is bit for bit what it was."""
    path = write(tmp_path, "a.obj", CUBE)
    wanted = load(path, scheme="acc")
    (tmp_path / "my_schemes.py").write_text("from tests.test_acc import Again\n")
    monkeypatch.syspath_prepend(tmp_path)
    for scheme in (Again(), "my_schemes:Again", Acc()):
        found = load(path, scheme=scheme)
        np.testing.assert_array_equal(found.patches(), wanted.patches())
        np.testing.assert_array_equal(found.edge_numbers, wanted.edge_numbers)
        assert found.conversion is not None
        assert found.conversion.scheme == ("acc" if isinstance(scheme, Acc) else "Again")
    finer = load(path, scheme="catmull-clark+acc", steps=2)
    np.testing.assert_array_equal(load(path, scheme=Subdivided(steps=2)).patches(), finer.patches())
    for scheme in (Again(), type("Again", (Again,), {"name": "acc"})()):
        with pytest.raises(InputError, match="'Again' have no tangent patches"):
            load(path, scheme=scheme).tangents()


def test_schemes_that_are_none(tmp_path):
    path = write(tmp_path, "a.obj", CUBE)
    conversion = load(path).conversion
    assert conversion is not None
    work = acc_patches(conversion.mesh, ALPHA)
    for scheme, says in (
        (Nothing(3), "scheme 'Nothing' must make a slefejax Patchwork, not int"),
        (Nothing(acc_patches(grid(3, 3), ALPHA)), "made a table for 9 vertices, and the mesh has 8"),
        (Nothing(replace(work, net=work.net + 10**6)), "numbers of points that there are not"),
        ("my_schemes:None", "there is no scheme 'my_schemes:None'"),
        ("accc", r"no scheme 'accc' \(did you mean acc\?\)"),
    ):
        with pytest.raises(InputError, match=says):
            load(path, scheme=scheme)
    with pytest.raises(InputError, match=r"the scheme is a value with its numbers, .*: give steps to it"):
        load(path, scheme=Acc(), steps=2)
