"""Gaussian products as published, nested and solved in single precision, and the study that compares them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from slefejax import (
    InputError,
    Scene,
    View,
    evaluate_patches,
    load,
)
from slefejax.conversion.gaussian.published import published
from slefejax.experiments.cli import main
from slefejax.experiments.products.feature import RADII, box, by_covariances, by_creases, by_loops, compared
from slefejax.experiments.products.nested import NestedLook
from slefejax.experiments.products.recursive import Recursive
from slefejax.experiments.products.spreads import ORIENTATIONS, median_condition, spread
from slefejax.figures.page import Page
from slefejax.figures.products.gaussian import write_levels
from slefejax.gpu import Renderer
from slefejax.model.gaussians import with_gaussians
from slefejax.model.mesh import Mesh
from tests.meshes import disc
from tests.test_cli import run_json
from tests.test_gaussian import ply, torus


def cubic(t):
    s = 1.0 - t
    return np.array([s**3, 3 * t * t * (t - 2) + 4, 3 * s * s * (s - 2) + 4, t**3]) / 6


def solved(surface, quarter, u, v):
    """What the shader does, in double precision."""
    nets, at = surface.nets, np.array([u, v])
    net = nets.first[quarter]
    for _ in range(nets.levels if nets.nested[quarter] else 0):
        at = 2.0 * at
        beyond = (at >= 1.0).astype(int)
        at = at - beyond
        net += beyond[0] + 2 * beyond[1] - 1 if beyond.any() else 3
        if beyond.any():
            break
    q = np.einsum("i,j,ijk", cubic(at[0]), cubic(at[1]), nets.nets[net].astype(float))
    return np.linalg.solve(q[[0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(3, 3), q[6:]) + nets.origin


@pytest.mark.parametrize("valence", [3, 5, 10])
def test_nested_nets_are_the_limit_surface(valence):
    surface = published(with_gaussians(disc(valence), "infer"))
    rng = np.random.default_rng(valence)
    irregular = np.flatnonzero(surface.nets.nested)
    assert len(irregular) == valence
    quarter = np.concatenate([rng.choice(irregular, 60), rng.integers(0, len(surface.nets), 30)])
    place = rng.random((90, 2)) ** rng.choice([1.0, 4.0], (90, 1))
    exact = surface.limit.at(quarter, place)
    own = [solved(surface, a, *b) for a, b in zip(quarter, place, strict=True)]
    # nets are in single precision
    np.testing.assert_allclose(own, exact, atol=2e-6)
    assert surface.nets.nbytes > 36 * 16 * len(surface.nets)


def test_steps_make_quads_of_other_faces():
    mesh = with_gaussians(Mesh.of(np.eye(4, 3), [(0, 1, 2), (0, 2, 3), (0, 3, 1), (1, 3, 2)]), "infer")
    with pytest.raises(InputError, match="take a step of subdivision"):
        published(mesh)
    surface = published(mesh, depth=4, steps=1)
    assert len(surface.nets) == 48
    assert surface.faces.tolist() == sorted(surface.faces.tolist())
    assert surface.on_limit(np.array([[-1, 0]]), np.zeros((1, 2)), np.zeros((1, 2)))[0][0, 0] == -1


def test_published_nets_stop_at_valence_10():
    with pytest.raises(InputError, match=r"valence 10: vertex .* 11 edges"):
        published(with_gaussians(disc(11), "infer"))
    with pytest.raises(InputError, match="give gaussians"):
        published(disc(5))
    with pytest.raises(InputError, match="depth"):
        published(with_gaussians(disc(5), "infer"), depth=11)
    mesh = replace(torus(), creases=np.array([[0, 1]]), crease_sharpness=np.array([2.0]))
    with pytest.raises(InputError, match="no tags"):
        published(mesh)


@pytest.mark.slow
def test_recursive_vertices_come_to_the_surface():
    mesh = torus(10.0)
    np.testing.assert_allclose(Recursive(mesh, 0).vertices(), mesh.vertices, atol=1e-12)
    surface = published(mesh).limit.surfaces
    far = [surface.nearest(Recursive(mesh, level).vertices()).distance.max() for level in (2, 3)]
    assert 3.0 < far[0] / far[1] < 5.0
    assert Recursive(mesh, 2).quads == 16 * mesh.face_count


@pytest.mark.slow
@pytest.mark.gl
def test_drawn_levels_come_to_the_surface(device):
    surface = published(with_gaussians(disc(5), "infer"))
    view = View(Scene("disc", surface.limit.net).default_camera(), 160, 100)
    renderer = Renderer(surface.nets, device)
    looks = [NestedLook.of(surface, view, renderer, level) for level in (1, 3, 5)]
    errors = [float(np.nanmax(look.error)) for look in looks]
    largest = [look.largest for look in looks]
    assert errors[2] < 0.05
    assert errors[0] > 3.0 * errors[1] > 3.0 * errors[2]
    # pixels are places, which samples come near to
    np.testing.assert_array_less(errors, 1.1 * np.array(largest) + 0.01)
    renderer.release()


@pytest.mark.gl
def test_only_what_moved_is_sent(device):
    patches = load("teapot").patches()
    renderer = Renderer(patches, device)
    assert renderer.moved == len(patches)
    moved = patches.copy()
    moved[[3, 4, 9], 1, 1] += 0.01
    renderer.move(moved)
    assert renderer.moved == 3
    view = View(load("teapot").default_camera(), 120, 80)
    levels = np.full((32, 2), 4), np.full((32, 4), 4)
    again, fresh = renderer.capture(view, *levels), Renderer(moved, device).capture(view, *levels)
    order = [np.lexsort((*x.parameters.reshape(-1, 6).T, x.patch)) for x in (again, fresh)]
    np.testing.assert_array_equal(again.clip[order[0]], fresh.clip[order[1]])
    renderer.move(4.0 * moved)
    assert renderer.moved == 0, "the box around them grows as they do"
    with pytest.raises(InputError, match=r"\(32, 4, 4, 3\), not \(31, 4, 4, 3\)"):
        renderer.move(moved[1:])
    renderer.release()


@pytest.mark.parametrize("orientation", ORIENTATIONS)
def test_spreads_have_their_condition(orientation):
    found = spread(disc(5), orientation, 1e4)
    np.testing.assert_allclose(np.linalg.eigvalsh(found)[:, 2], 1.0)
    assert median_condition(found) == pytest.approx(1e4)
    np.testing.assert_allclose(spread(disc(5), orientation, 1.0), np.broadcast_to(np.eye(3), found.shape), atol=1e-15)


def test_a_ring_goes_from_round_to_sharp():
    scene: Any = load("ring")
    assert scene.conversion.scheme == "gaussian"
    assert not len(scene.conversion.mesh.creases)
    conditions = np.linalg.cond(scene.conversion.mesh.covariances)
    assert conditions.min() == 1.0
    assert conditions.max() == pytest.approx(100.0)
    t = np.linspace(0.0, 1.0, 65)
    points = evaluate_patches(scene.patches(), np.stack([np.zeros(65), t], axis=1))
    # sections at both ends of the x axis: how near the surface comes to the control mesh's ridge
    reach = [float(np.max(sign * points[..., 0])) for sign in (1, -1)]
    assert 1.4 - reach[0] < 0.25 * (1.4 - reach[1])


def test_a_box_is_closed_and_looks_outwards():
    mesh = box([-1.0, -0.5, 0.25, 1.0])
    assert mesh.face_count == 54
    assert mesh.vertex_count - mesh.edge_count + mesh.face_count == 2
    corners = mesh.vertices[mesh.corners.reshape(-1, 4)]
    volume = sum(np.linalg.det(corners[:, [0, i, i + 1]]).sum() / 6.0 for i in (1, 2))
    assert volume == pytest.approx(8.0)


@pytest.mark.parametrize(
    ("make", "number", "patches"), [(by_covariances, 0.01, 96), (by_creases, 1.5, 1536), (by_loops, 0.1, 216)]
)
def test_a_cube_is_rounded(make, number, patches):
    conversion = make(number)
    points = conversion.patchwork.on_host(conversion.control)
    assert len(points) == patches
    corner = np.abs(evaluate_patches(points, [[0.0, 0.0], [1.0, 1.0]])).min(axis=2).max()
    assert 0.7 < corner < 1.0


@pytest.mark.slow
def test_features_keep_one_distance():
    rows = compared()
    for radius in RADII:
        own = [row for row in rows if row["radius"] == radius]
        assert len(own) == 3
        assert max(row["distance"] for row in own) <= max(row["nearest"] for row in own) * (1 + 1e-9)


@pytest.mark.gl
@pytest.mark.slow
def test_the_study_of_gaussian_products(capsys, tmp_path):
    (tmp_path / "mesh.ply").write_text(ply(torus(nu=3, nv=3)))
    options = "--size", "100x64", "--levels", "1", "2", "--conditions", "100", "--level", "2"
    found = run_json(capsys, "gaussian", str(tmp_path / "mesh.ply"), *options, "--out", str(tmp_path / "run"))
    rows = found["rows"]
    assert [row["method"] for row in rows[:5]] == ["certified", "published", "published", "recursive", "recursive"]
    assert rows[0]["max_error_px"] <= 0.5
    assert rows[0]["sup_error_px"] <= 0.5
    assert rows[0]["factor_over_minimal_median"] >= 1.0
    assert rows[0]["limit_max_px"] == 0.0
    assert rows[1]["triangles"] == 4 * 2 * 9
    assert rows[1]["max_error_px"] > rows[2]["max_error_px"]
    assert {row["orientation"] for row in rows[5:]} == set(ORIENTATIONS)
    names = {file.name for file in (tmp_path / "run").iterdir()}
    assert {"levels_compared.png", "errors_over_anisotropy.png", "gaussians.png", "table.csv"} <= names


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("teapot",), "no control mesh"),
        (("ring", "--levels", "7"), "--levels"),
        (("ring", "--conditions", "0.5"), "--conditions"),
        (("ring", "--depth", "11"), "--depth"),
        (("ring", "--scheme", "acc"), "--scheme"),
    ],
)
def test_the_study_refuses(options, said, capsys):
    assert main(["gaussian", *options]) == 2
    assert said in capsys.readouterr().err


def test_figures_of_methods_that_refuse(tmp_path):
    """A vertex of valence 64 leaves nothing of the published method, and sometimes nothing of others."""
    names = "triangles", "max_error_px", "sup_error_px", "render_ms", "predict_ms", "prepare_ms"
    refused = {"method": "published", "level": 5, **dict.fromkeys(names, np.nan)}
    made = {"method": "recursive", "level": 5, **dict.fromkeys(names, 2.0), "max_error_px": np.nan}
    for rows in ([refused], [refused, made], [refused, {**made, "method": "certified", "max_error_px": 0.4}]):
        write_levels(Page(tmp_path / "levels.png"), rows, "fan")
        assert (tmp_path / "levels.png").stat().st_size > 10_000
