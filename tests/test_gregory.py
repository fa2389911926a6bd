"""Gregory patches: their points, the terms that turn around a corner, and what is measured of them."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slefejax.conversion.gregory as points_module
from slefejax import (
    Camera,
    GregoryPatches,
    InputError,
    Session,
    View,
    convert,
    evaluate_patches,
    load,
    save,
    slefe_boxes,
    tessellation_factors,
)
from slefejax.conversion.acc import Neighbourhood, acc_patches
from slefejax.conversion.catmull_clark import CORNER, refine
from slefejax.conversion.gregory import Points, eigenvalue
from slefejax.conversion.gregory_nets import gregory_patches
from slefejax.experiments.cli import main
from slefejax.experiments.options import applicable
from slefejax.geometry.bezier import combine, derivative, evaluate_patch
from slefejax.geometry.gregory import twist_basis, twist_slopes
from slefejax.model.mesh import Mesh
from slefejax.predict.methods import Certified
from slefejax.predict.rules import EdgeLength, Filip
from slefejax.tessellator.edges import Sides
from tests.meshes import disc, grid
from tests.test_cli import run_json

VALENCES = (3, 4, 5, 6, 7, 9, 16, 32, 64)


def closed(valence, below="quads", rng=None):
    """Quads around a vertex of that valence, and around the one opposite, or triangles there."""
    count = 2 * valence
    angle = np.pi * np.arange(count) / valence
    ring = np.stack([np.cos(angle), np.sin(angle), 0.3 * (-1.0) ** np.arange(count)], axis=1)
    places = np.concatenate([[[0, 0, 1.0], [0, 0, -1.0]], ring])
    number = 2 + np.arange(count + 2) % count
    faces = [(0, *number[2 * k : 2 * k + 3]) for k in range(valence)]
    if below == "quads":
        faces += [(1, *number[2 * k + 1 : 2 * k + 4][::-1]) for k in range(valence)]
    else:
        faces += [(1, number[k + 1], number[k]) for k in range(count)]
    noise = 0.0 if rng is None else rng.normal(size=places.shape) * 0.2
    return Mesh.of(places + noise, faces)


def jumps(mesh, work):
    """The largest angle between normals, in degrees, along every edge that two patches share."""
    patches = work.on_host(mesh.vertices)
    sides = Sides.of(work.net[..., None])
    t = np.linspace(0.03, 0.97, 13)

    own = np.where(sides.first[..., None] > 0, 1.0 - t, t)
    ends = np.broadcast_to(np.array([0.0, 0.0, 1.0, 1.0])[:, None], own.shape)
    along_v = (np.arange(4) % 2 == 0)[:, None]
    places = np.stack([np.where(along_v, ends, own), np.where(along_v, own, ends)], axis=-1)
    u, v = np.moveaxis(places.reshape(len(own), -1, 2), -1, 0)
    net, twists = (np.moveaxis(x, 0, -1)[..., None] for x in (patches.net, patches.twists))
    slopes = twist_slopes(len(twists), u, v)
    along_u = evaluate_patch(derivative(net), u, v) + combine(twists, slopes[0])
    along_v = evaluate_patch(np.swapaxes(derivative(np.swapaxes(net, 0, 1)), 0, 1), u, v) + combine(twists, slopes[1])
    found = np.moveaxis(np.cross(along_u, along_v, axis=0), 0, -1)
    length = np.linalg.norm(found, axis=-1, keepdims=True)
    found = (found / np.where(length > 0, length, 1.0)).reshape(-1, len(t), 3)  # 0 along pinched sides
    order = np.argsort(sides.numbers.ravel(), kind="stable")
    same = np.diff(sides.numbers.ravel()[order]) == 0
    one, other = found[order[:-1][same]], found[order[1:][same]]
    sine, cosine = np.linalg.norm(np.cross(one, other), axis=-1), np.sum(one * other, axis=-1)
    return np.degrees(np.arctan2(sine, cosine)).max(axis=1)


@pytest.mark.parametrize("below", ["quads", "triangles"])
@pytest.mark.parametrize("valence", VALENCES)
def test_corners_are_limit_points_and_tangents_eigenvectors(valence, below, rng):
    """A step of subdivision moves no corner, and makes the frame of every fan its eigenvalue times as long."""
    # the vertex opposite of triangles has twice as many
    mesh = closed(min(valence, 32) if below == "triangles" else valence, below, rng)
    finer, step, _ = refine(mesh)
    now, later = Points(Neighbourhood.of(mesh)), Points(Neighbourhood.of(finer))
    old = np.arange(mesh.vertex_count)
    moved = later.vertices.take(old) @ step - now.vertices
    assert np.abs(moved.matrix).max() <= 1e-14
    fans, fine = now.around.fans, later.around.fans
    at = fine.fan[4 * np.arange(len(mesh.corners))]
    turned = fine.position[4 * np.arange(len(mesh.corners))] == fans.position
    turned &= ~later._regular[mesh.corners]  # those have acc's points
    own = fans.fan[turned]
    lam = eigenvalue(now.around.steps.astype(float))
    for table, other in zip(now._frame, later._frame, strict=True):
        left = other.take(at[turned]) @ step - table.take(own).scaled(lam[own])
        assert np.abs(left.matrix).max() <= 1e-14


def test_rows_are_affine(rng):
    for mesh in (closed(5, "quads", rng), closed(7, "triangles", rng), disc(6, half=True)):
        work = gregory_patches(mesh)
        sums = work.points.row_sums()
        np.testing.assert_allclose(sums[work.net], 1.0, atol=1e-14)
        assert work.twists is not None
        np.testing.assert_allclose(sums[work.twists], 0.0, atol=1e-14)


def test_regular_meshes_are_b_splines(rng):
    for mesh in (grid(5, 6, True, True, rng), grid(5, 6, rng=rng)):
        found, wanted = gregory_patches(mesh).on_host(mesh.vertices), acc_patches(mesh).on_host(mesh.vertices)
        assert not found.twisted.any()
        np.testing.assert_allclose(found.net, wanted, atol=1e-14)


def test_patches_that_agree_by_topology(rng):
    """Twists are there exactly where a corner of the face is irregular."""
    mesh = disc(5, rings=4, rng=rng)
    touches = np.zeros(mesh.vertex_count, bool)
    touches[0] = True
    near = np.bincount(mesh.face[touches[mesh.corners]], minlength=mesh.face_count) > 0
    inside = ~np.isin(np.arange(mesh.face_count), mesh.face[(mesh.twin < 0)])
    np.testing.assert_array_equal(gregory_patches(mesh).on_host(mesh.vertices).twisted[inside], near[inside])


@pytest.mark.parametrize("below", ["quads", "triangles"])
@pytest.mark.parametrize("valence", [3, 5, 7, 16, 64])
def test_normals_agree_along_edges(valence, below, rng):
    mesh = closed(valence, below, rng)
    assert jumps(mesh, gregory_patches(mesh)).max() <= 1e-8


@pytest.mark.parametrize("valence", [3, 5, 6, 8])
def test_normals_agree_at_boundaries(valence, rng):
    for mesh in (disc(valence, rng=rng), disc(2 * valence, half=True, rng=rng)):
        assert jumps(mesh, gregory_patches(mesh)).max() <= 1e-8


def test_a_misprint_would_be_found(rng, monkeypatch):
    """With + 2 c_a, as it is often printed, normals jump by 50 degrees and more."""
    monkeypatch.setattr(points_module, "slide", lambda d, c_a, c_b: d + 2.0 * c_a - c_b)
    mesh = closed(5, "quads", rng)
    assert jumps(mesh, gregory_patches(mesh)).max() >= 50.0


@pytest.mark.parametrize("name", ["monsterfrog", "suzanne", "bigguy", "catmark_gregory_test8", "catmark_pole64"])
def test_normals_agree_on_real_meshes(models, name):
    """Along inner edges without creases that end at no corner."""
    conversion = load(models / f"{name}.obj", scheme="gregory").conversion
    assert conversion is not None
    mesh = conversion.finer
    around = Neighbourhood.of(mesh)
    assert not np.any(around.sharp & ~mesh.boundary)
    found = np.sort(jumps(mesh, gregory_patches(mesh)))
    corners = np.count_nonzero(np.any(around.rule[mesh.edge_vertices] == CORNER, axis=1) & ~mesh.boundary)
    assert np.all(found[: len(found) - corners] <= 1e-8)


def directly(mesh, face, places):
    """Points of a face' patch from its 20 or 15 points, by the formulas as they are printed."""
    table = Points(Neighbourhood.of(mesh))
    p, e = (own.on_host(mesh.vertices) for own in (table.vertices, table.edges))
    plus, minus = (own.on_host(mesh.vertices) for own in table.faces)
    reverse = (mesh.corners > mesh.ends).astype(int)
    out, back = 2 * mesh.edge + reverse, 2 * mesh.edge + 1 - reverse
    corner = np.flatnonzero(mesh.face == face)
    before = mesh.prev_corner[corner]
    own = [(p[mesh.corners[c]], e[out[c]], e[back[b]], plus[c], minus[c]) for c, b in zip(corner, before, strict=True)]
    return [(_quad if len(own) == 4 else _triangle)(own, u, v) for u, v in places]


def _quad(own, u, v):
    local = ((u, v), (v, 1 - u), (1 - u, 1 - v), (1 - v, u))
    f = [(s * x[3] + t * x[4]) / (s + t) for x, (s, t) in zip(own, local, strict=True)]
    (a, b, c, d) = own
    net = [
        [a[0], a[2], d[1], d[0]],
        [a[1], f[0], f[3], d[2]],
        [b[2], f[1], f[2], c[1]],
        [b[0], b[1], c[2], c[0]],
    ]
    basis = lambda t: np.array([(1 - t) ** 3, 3 * t * (1 - t) ** 2, 3 * t * t * (1 - t), t**3])  # noqa: E731
    return np.einsum("i,j,ijc->c", basis(u), basis(v), np.array(net))


def _triangle(own, a, b):
    share = np.array([a, b, 1 - a - b])
    total = np.zeros(3)
    for k in range(3):
        x, y, z = share[k], share[(k + 1) % 3], share[(k + 2) % 3]
        p, plus, minus, f_plus, f_minus = own[k]
        total += x**3 * p + 3 * x * y * (x + y) * x * plus + 3 * x * z * (x + z) * x * minus
        total += 12 * x * x * y * z * (y * f_plus + z * f_minus) / (y + z)
    return total


def test_evaluation_is_that_of_the_printed_formulas(rng):
    mesh = closed(5, "triangles", rng)
    patches = gregory_patches(mesh).on_host(mesh.vertices)
    face = int(np.flatnonzero(mesh.sizes == 4)[0])
    places = rng.uniform(0.05, 0.95, (7, 2))
    found = evaluate_patches(patches[[face]], places)[0]
    np.testing.assert_allclose(found, directly(mesh, face, places), atol=1e-14)
    only = closed(5, "quads", rng)
    found = evaluate_patches(gregory_patches(only).on_host(only.vertices)[[face]], places)[0]
    np.testing.assert_allclose(found, directly(only, face, places), atol=1e-14)


def test_triangles_are_pinched(rng):
    """Barycentric coordinates (1-u)(1-v), (1-u) v, u of the corners q, p and the last, whichever corner that is."""
    mesh = closed(5, "triangles", rng)
    patches = gregory_patches(mesh).on_host(mesh.vertices)
    face = int(np.flatnonzero(mesh.sizes == 3)[2])
    corner = np.flatnonzero(mesh.face == face)
    last = evaluate_patches(patches[[face]], [[1.0, 0.5]])[0, 0]
    limit = Points(Neighbourhood.of(mesh)).vertices.on_host(mesh.vertices)[mesh.corners[corner]]
    third = int(np.argmin(np.linalg.norm(limit - last, axis=1)))
    u, v = rng.uniform(0.05, 0.95, (2, 9))
    share = np.zeros((9, 3))
    share[:, third], share[:, (third + 2) % 3], share[:, (third + 1) % 3] = u, (1 - u) * (1 - v), (1 - u) * v
    # p, q, last are counter-clockwise, and q is at (0, 0)
    share[:, [(third + 1) % 3, (third + 2) % 3]] = share[:, [(third + 1) % 3, (third + 2) % 3]]
    found = evaluate_patches(patches[[face]], np.stack([u, v], axis=1))[0]
    np.testing.assert_allclose(found, directly(mesh, face, share[:, :2]), atol=1e-13)


def exactly(slots, u, v):
    """The terms in fractions."""

    def turn(s, t):
        return (s - t) / (2 * (s + t))

    found = [
        9 * s * t * ((1 - s) * (1 - t)) ** 2 * turn(s, t) for s, t in ((u, v), (v, 1 - u), (1 - u, 1 - v), (1 - v, u))
    ]
    a, b, c = (1 - u) * (1 - v), (1 - u) * v, u
    return [*found, 12 * a * a * b * c * turn(c, b), 12 * b * b * a * c * turn(a, c)][:slots]


def test_terms_and_their_slopes_against_fractions(rng):
    """To rounding; derivatives are differences over 10^-20, in fractions."""
    step = Fraction(1, 10**20)
    for u, v in rng.uniform(0.01, 0.99, (20, 2)):
        x, y = Fraction(u), Fraction(v)
        np.testing.assert_allclose(twist_basis(6, u, v), [float(b) for b in exactly(6, x, y)], atol=1e-15)
        slopes = [
            [float((p - m) / (2 * step)) for p, m in zip(exactly(6, *there), exactly(6, *here), strict=True)]
            for there, here in (((x + step, y), (x - step, y)), ((x, y + step), (x, y - step)))
        ]
        np.testing.assert_allclose(twist_slopes(6, u, v), slopes, atol=1e-12)


def test_numbers_of_valence_two_and_several_corners(rng):
    """Told in a note; patches are there, and finite."""
    pillow = Mesh.of([[0, 0, 0], [1, 0, 0.2], [1, 1, 0], [0, 1, 0.1]], [(0, 1, 2, 3), (3, 2, 1, 0)])
    found = convert(pillow, "gregory")
    assert any("two edges (vertex 0" in note for note in found.notes)
    assert np.isfinite(found.patchwork.on_host(pillow.vertices).net).all()


@pytest.mark.slow
def test_a_session():
    """Poses go through the same tables."""
    walker = load("walker", scheme="gregory")
    assert isinstance(walker.patches(), GregoryPatches)
    view = View(walker.default_camera(), 640, 400)
    session = Session(walker, tiles=1)
    factors = session.factors(view, 3.0)
    posed = walker.pose(3.0)
    np.testing.assert_allclose(session.patches.net, posed.net, atol=1e-12)
    np.testing.assert_allclose(session.patches.twists, posed.twists, atol=1e-12)
    np.testing.assert_allclose(factors.factor, tessellation_factors(posed, view, tiles=1).factor, rtol=1e-9)


@pytest.mark.slow
@pytest.mark.parametrize("below", ["quads", "triangles"])
def test_gradients(below, rng):
    """Factors have the derivatives that differences have."""
    mesh = closed(5, below, rng)
    table = gregory_patches(mesh)
    near = View(Camera.look_at((3.0, -4.0, 2.0), (0, 0, 0)), 640, 400)

    @jax.jit
    def total(vertices):
        return jnp.sum(tessellation_factors(table.patches(vertices), near, tiles=1).factor)

    along = rng.normal(size=mesh.vertices.shape)
    slope = float(jnp.vdot(jax.grad(total)(jnp.asarray(mesh.vertices)), along))
    ends = [float(total(mesh.vertices + h * along)) for h in (1e-6, -1e-6)]
    assert slope == pytest.approx((ends[0] - ends[1]) / 2e-6, rel=1e-5)


def test_what_gregory_patches_are_not_for(tmp_path):
    scene = load("walker", scheme="gregory")
    view = View(scene.default_camera(), 320, 200)
    with pytest.raises(InputError, match="method 'slefe' is for Bézier patches"):
        tessellation_factors(scene.patches(), view, "slefe")
    with pytest.raises(InputError, match="method 'slefe' is for Bézier patches"):
        Session(scene, method="slefe").factors(view)
    with pytest.raises(InputError, match="this takes Bézier patches"):
        slefe_boxes(scene.patches(), 3)
    with pytest.raises(InputError, match=r"Gregory patches, which a \.bpt file cannot hold"):
        save(scene, tmp_path / "walker.bpt")
    with pytest.raises(InputError, match="alpha is of triangles' points in 'acc'"):
        load("walker", scheme="gregory", alpha=2.0)
    with pytest.raises(InputError, match=r"are a net \(patches, 4, 4, 3\) and twists \(patches, 4, 3\)"):
        GregoryPatches(np.zeros((2, 4, 4, 3)), np.zeros((2, 6, 3)))
    with pytest.raises(InputError, match="no array of Bézier points"):
        np.asarray(scene.patches())
    fixed = tessellation_factors(scene.patches(), view, "fixed", setting=3.0)
    assert set(np.asarray(fixed.factor)) == {3.0}


def test_edges_are_as_long_as_the_nets(rng):
    net, twists = rng.normal(size=(3, 4, 4, 3)), rng.normal(size=(3, 4, 3))
    view = View(Camera.look_at((3.0, -14.0, 2.0), (0, 0, 0)), 640, 400)
    both = GregoryPatches(net, twists), net
    smooth, plain = (np.asarray(tessellation_factors(own, view, "edge-length").factor) for own in both)
    assert np.array_equal(smooth, plain)
    assert smooth.min() > 1.0


@pytest.fixture
def pyramid(tmp_path, monkeypatch):
    """A square and four triangles."""
    monkeypatch.chdir(tmp_path)
    corners = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv .5 .5 1\n"
    (tmp_path / "pyramid.obj").write_text(corners + "f 4 3 2 1\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n")
    return ("pyramid.obj", "--scheme", "gregory")


@pytest.mark.parametrize(
    ("command", "why"),
    [
        ("fit-km", "slefes, which are of Bézier patches"),
        ("optimise", "would no longer join smoothly"),
        ("scaling", "parts of Gregory patches are none"),
    ],
)
def test_commands_for_bezier_patches_say_why(command, why, pyramid, capsys):
    assert main([command, *pyramid]) == 2
    said = capsys.readouterr().err
    assert f"{why}: choose --scheme acc or pinched for pyramid" in said
    assert said.count("\n") == 1


@pytest.mark.slow
@pytest.mark.gl
def test_certify_leaves_out_what_is_for_bezier_patches(device, pyramid, capsys):
    found = run_json(capsys, "certify", *pyramid, "--size", "120x80")
    assert "these are Gregory ones: slefe, filip" in found["notes"][0]
    assert [row["method"] for row in found["summary"]] == ["certified"]
    assert found["summary"][0]["patches_above"] == 0
    for row in found["rows"]:
        assert 2 <= row["minimal"] <= row["factor"]
        assert 0 < row["sup_error_px"] <= 0.5 - row["slack_px"] <= 0.5
        assert row["slefe_factor"] is None


@pytest.mark.slow
@pytest.mark.gl
def test_error_time_leaves_out_what_is_for_bezier_patches(device, pyramid, capsys):
    found = run_json(capsys, "error-time", *pyramid, "--size", "120x80", "--repeats", "1")
    assert [row["method"] for row in found["rows"]] == ["certified", "edge-length 8", "fixed 16"]
    assert "slefe m=6, filip, screen-box 1" in found["notes"][0]
    assert found["rows"][0]["drawn_sup_error_px"] <= 0.5


@pytest.mark.gl
def test_what_is_asked_for_by_name_is_not_left_out(device, pyramid, capsys):
    assert (
        main(["error-time", *pyramid, "--size", "120x80", "--repeats", "1", "--methods", "fixed 16", "slefe m=3"]) == 2
    )
    assert "scene 'pyramid': method 'slefe' is for Bézier patches" in capsys.readouterr().err


def test_which_rules_take_which_patches(teapot):
    rules = {"certified": Certified(), "filip": Filip(), "edges": EdgeLength()}
    weighted = np.concatenate([teapot.control, np.ones_like(teapot.control[..., :1])], axis=3)
    rational, gregory = replace(teapot, control=weighted), load("walker", scheme="gregory")
    assert applicable(rules, teapot) == (rules, "")
    kinds = (rational, "polynomial patches and these are rational"), (gregory, "Bézier patches and these are Gregory")
    for scene, said in kinds:
        taken, note = applicable(rules, scene)
        assert list(taken) == ["certified", "edges"]
        assert said in note
        assert note.endswith("ones: filip")


@pytest.mark.slow
@pytest.mark.gl
def test_savings_of_what_is_for_gregory_patches(device, pyramid, capsys):
    found = run_json(capsys, "inspect", *pyramid, "--size", "120x80", "--savings")
    assert {row["left_out"] for row in found["savings"]} == {
        "depth widths",
        "skinning by one bone",
        "view that is the same",
    }
    assert {row["method"] for row in found["savings"]} == {"certified"}
    assert found["notes"][-1].endswith("Gregory ones: slefe")


@pytest.mark.slow
@pytest.mark.gl
def test_a_sweep(capsys, tmp_path):
    """Smooth patches with certified levels: no pixel is wrong by more than half of one."""
    asked = (
        "minimality",
        "walker",
        "--scheme",
        "gregory",
        "--scales",
        "1",
        "--size",
        "320x200",
        "--out",
        str(tmp_path),
    )
    found = run_json(capsys, *asked)
    assert found["rows"][0]["max_error_px"] <= 0.501
