"""Distances of patches from the exact limit surface, and the command that tells them."""

from __future__ import annotations

import os
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from slefejax import Camera, InputError, Scene, View, limit_distance, load
from slefejax.conversion.acc import Neighbourhood
from slefejax.conversion.catmull_clark import refine
from slefejax.conversion.gregory import Points
from slefejax.conversion.limit import LEVELS, irregular_corner, limit_surface, regular_faces
from slefejax.conversion.natural import characteristic_mesh, natural_parameters
from slefejax.conversion.scheme import Subdivided, SubdividedGregory, convert
from slefejax.geometry.evaluate import evaluate_patches
from slefejax.measure.jumps import normal_jumps
from tests.meshes import cube, disc, grid, mixed
from tests.tables import SHOWN
from tests.test_catmull_clark import creased
from tests.test_cli import SMALL, in_an_empty_folder, run_json  # noqa: F401

SCHEMES = ("acc", "gregory")
VIEW = View(Camera.look_at((3.0, -4.0, 2.5), (0.5, 0.5, 0.5)), 640, 400)


def scene_of(mesh, scheme: Any = "acc", **options):
    conversion = convert(mesh, scheme, **options)
    patches = conversion.patchwork.on_host(mesh.vertices)
    return Scene("mesh", patches, conversion=conversion, kinds=conversion.patchwork.kinds)


def smooth(mesh):
    """Without what is tagged sharp."""
    none = {"creases": np.zeros((0, 2), np.int64), "crease_sharpness": np.zeros(0)}
    return replace(mesh, **none, points=np.zeros(0, np.int64), point_sharpness=np.zeros(0))


def diagonal(mesh):
    return np.linalg.norm(np.ptp(mesh.vertices[np.unique(mesh.corners)], axis=0))


def limit_points(mesh, steps):
    """(face, u, v, x, y, z) of limit points of quads: subdivision of all of the mesh, then limit masks."""
    corners = np.broadcast_to([[0, 0], [1, 0], [1, 1], [0, 1]], (mesh.face_count, 4, 2)).astype(float)
    face = np.arange(mesh.face_count)
    for _ in range(steps):
        following, before = np.roll(corners, -1, axis=1), np.roll(corners, 1, axis=1)
        middle = np.broadcast_to(corners.mean(axis=1, keepdims=True), corners.shape)
        corners = np.stack([corners, (corners + following) / 2, middle, (corners + before) / 2], axis=2)
        corners = corners.reshape(-1, 4, 2)
        mesh, _, parents = refine(mesh)
        face = face[parents]
    points = Points(Neighbourhood.of(mesh)).vertices.on_host(mesh.vertices)
    return np.repeat(face, 4), corners.reshape(-1, 2), points[mesh.corners]


def torus():
    u, v = np.meshgrid(2 * np.pi * np.arange(8) / 8, 2 * np.pi * np.arange(8) / 8, indexing="ij")
    places = [(3 + np.cos(v)) * np.cos(u), (3 + np.cos(v)) * np.sin(u), np.sin(v)]
    return replace(grid(8, 8, True, True), vertices=np.stack(places, axis=-1).reshape(-1, 3))


def ends_of_cube(sharpness):
    """A cube of which one face's edges are sharp."""
    return creased(cube(), sharpness, np.array([[0, 1], [1, 3], [3, 2], [2, 0]]))


@pytest.mark.parametrize("scheme", SCHEMES)
def test_regular_meshes_are_exact(scheme):
    for mesh in (torus(), grid(5, 4, rng=np.random.default_rng(1))):
        found = limit_distance(scene_of(mesh, scheme), VIEW)
        assert found.largest == found.rms == found.bound == found.pixels == 0.0
        scene = scene_of(mesh, scheme)
        t = np.linspace(0.0, 1.0, 7)
        places = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
        points = np.asarray(evaluate_patches(scene.patches(), places)).reshape(-1, 3)
        assert scene.conversion is not None
        assert scene.conversion.limit.surfaces.nearest(points).distance.max() < 1e-14 * diagonal(mesh)


@pytest.mark.parametrize("scheme", SCHEMES)
@pytest.mark.parametrize("valence", [3, 5, 8])
def test_what_is_flat_stays_in_its_plane(scheme, valence, rng):
    mesh = disc(valence, rings=3)
    found = limit_distance(scene_of(mesh, scheme))
    assert found.largest < 1e-12
    assert (
        limit_distance(
            scene_of(replace(mesh, vertices=mesh.vertices + rng.normal(size=(len(mesh.vertices), 3)) / 9), scheme)
        ).largest
        > 1e-4
    )


@pytest.mark.parametrize(
    "mesh",
    [
        disc(5, rings=2, rng=np.random.default_rng(3)),
        disc(10, rings=2, rng=np.random.default_rng(4), half=True),
        cube(),
        ends_of_cube(np.inf),
        ends_of_cube(1.0),
        ends_of_cube(2.0),
        ends_of_cube(1.3),
        replace(cube(), points=np.array([7]), point_sharpness=np.array([np.inf])),
        replace(cube(), points=np.array([7]), point_sharpness=np.array([1.5])),
    ],
    ids=["valence 5", "boundary", "cube", "crease", "semi-sharp 1", "semi-sharp 2", "blend", "corner", "soft corner"],
)
def test_limit_points_are_those_of_repeated_subdivision(mesh):
    face, parameters, points = limit_points(mesh, 4)
    found = limit_surface(mesh).at(face, parameters)
    assert np.abs(found - points).max() < 1e-13


def test_regular_faces_are_told_from_others():
    assert regular_faces(torus()).all()
    assert not regular_faces(cube()).any()
    assert not regular_faces(creased(torus(), 2.0, np.array([[0, 1]])))[0]
    which, valence = irregular_corner(disc(5, rings=3))
    assert np.bincount(valence).tolist() == [40, 0, 0, 0, 0, 5]
    assert set(which[valence == 5]) == {0}


@pytest.mark.parametrize("gregory", [False, True])
@pytest.mark.parametrize("valence", [3, 5, 6, 16])
def test_natural_parameters_make_both_maps_one(valence, gregory):
    mesh = characteristic_mesh(valence)
    phi = natural_parameters(valence, gregory, 9)
    scheme = "gregory" if gregory else "acc"
    t = np.linspace(0.0, 1.0, 9)
    places = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1)
    patch = convert(mesh, scheme).patchwork.on_host(mesh.vertices)[:1]
    points = np.asarray(evaluate_patches(patch, places.reshape(-1, 2)))[0]
    there = limit_surface(mesh).at(np.zeros(81, int), phi.reshape(-1, 2))
    assert np.abs(points - there).max() < 1e-14
    assert np.abs((phi - places)[[-1]]).max() < 1e-14
    assert np.abs((phi - places)[:, [-1]]).max() < 1e-14
    assert 0.01 < np.abs(phi - places).max() < 0.3


@pytest.mark.parametrize("scheme", [Subdivided(), SubdividedGregory()])
def test_bounds_hold_and_are_near(scheme, rng):
    mesh = replace(cube(), vertices=cube().vertices + 0.15 * rng.normal(size=(8, 3)))
    scene = scene_of(refine(mesh)[0], scheme.name, steps=1)
    found = limit_distance(scene, VIEW)
    assert found.bound is not None
    assert found.bound >= found.largest
    assert found.pixels is not None
    assert 0 < found.pixels < 20
    ratio = found.bounds[found.odd] / found.patches[found.odd]
    assert ratio.min() >= 1.0
    assert np.median(ratio) <= 3.0
    assert limit_distance(scene_of(mesh)).bound is None, "faces have several irregular corners"


@pytest.mark.slow
@pytest.mark.parametrize("scheme", SCHEMES)
def test_distances_do_not_depend_on_how_deep_the_surface_goes(scheme, rng):
    mesh = disc(6, rings=3, rng=rng)
    scene = scene_of(mesh, scheme)
    t = np.linspace(0.0, 1.0, 17)
    places = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
    odd = np.flatnonzero(~regular_faces(mesh))
    points = np.asarray(evaluate_patches(scene.patches()[odd], places)).reshape(-1, 3)
    far = [limit_surface(mesh, levels).surfaces.nearest(points).distance.max() for levels in (6, LEVELS)]
    assert abs(far[0] / far[1] - 1.0) < 0.005
    whole = limit_distance(scene).largest
    assert far[1] <= whole < 1.03 * far[1]


def test_sharpness_belongs_to_the_limit():
    sharp, soft = (limit_distance(scene_of(ends_of_cube(sharpness))).largest for sharpness in (np.inf, 1.0))
    assert soft > 1.5 * sharp, "acc draws both infinitely sharp"
    followed = limit_distance(scene_of(ends_of_cube(1.0), "catmull-clark+acc", steps=1)).largest
    assert followed < 0.3 * soft


def test_triangles_and_larger_faces(rng):
    mesh = mixed(rng)
    found = limit_distance(scene_of(mesh, "catmull-clark+gregory", steps=1))
    assert 0 < found.rms < found.largest < 0.05 * diagonal(mesh)
    assert found.bound is None


def test_jumps_of_normals(rng):
    mesh = disc(5, rings=3, rng=rng)
    jumps = {}
    for scheme in SCHEMES:
        scene = scene_of(mesh, scheme)
        assert scene.conversion is not None
        jumps[scheme] = normal_jumps(scene.patches(), scene.conversion.smooth_sides)
    assert jumps["gregory"].max() < 1e-9
    assert jumps["acc"].max() > 1.0
    assert len(jumps["acc"]) < mesh.edge_count


def test_a_scheme_of_ones_own_has_distances():
    class Own:
        def patchwork(self, mesh):
            return convert(mesh, "acc").patchwork

    own, acc = (limit_distance(scene_of(cube(), scheme)) for scheme in (Own(), "acc"))
    assert abs(own.largest / acc.largest - 1.0) < 1e-9
    assert own.bound is None


def test_bad_input(teapot):
    with pytest.raises(InputError, match=r"teapot has no control mesh: only patches of one have a limit surface"):
        limit_distance(teapot)
    with pytest.raises(InputError, match=r"the view must be a slefejax\.View .* not str"):
        limit_distance(load("walker"), "front")  # type: ignore[arg-type]
    with pytest.raises(InputError, match="no control mesh"):
        limit_distance("teapot")


COLUMNS = ["scene", "scheme", "depth", "patches", "triangles", "limit_max_percent", "limit_rms_percent"]
COLUMNS += ["limit_bound_percent", "limit_max_px", "normal_jump_deg", "seconds"]


def write_cube(path):
    mesh = cube()
    lines = ["v " + " ".join(map(str, vertex)) for vertex in mesh.vertices.tolist()]
    lines += ["f " + " ".join(str(v + 1) for v in face) for face in mesh.corners.reshape(-1, 4).tolist()]
    path.write_text("\n".join(lines) + "\n")


@pytest.mark.slow
def test_the_command_of_one_scheme(capsys, tmp_path):
    write_cube(tmp_path / "box.obj")
    result = run_json(capsys, "limit", "box.obj", "--scheme", "gregory", *SMALL)
    (row,) = result["rows"]
    assert list(row) == COLUMNS
    assert result["scene"] == ["box"]
    assert row["limit_bound_percent"] is None
    assert 0 < row["limit_rms_percent"] < row["limit_max_percent"]
    assert row["normal_jump_deg"] < 1e-9
    assert "no bound" in " ".join(result["notes"])
    assert set(os.listdir(result["out"])) == SHOWN | {"limit.png", "reflections.png"}


@pytest.mark.slow
def test_the_command_of_all_schemes(capsys, tmp_path):
    write_cube(tmp_path / "box.obj")
    pyramid = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv .5 .5 1\nf 4 3 2 1\nf 1 2 5\nf 2 3 5\nf 3 4 5\nf 4 1 5\n"
    (tmp_path / "pyramid.obj").write_text(pyramid)
    result = run_json(capsys, "limit", "box.obj", "pyramid.obj", *SMALL)
    made = [(row["scene"], row["scheme"], row["depth"]) for row in result["rows"]]
    assert result["scene"] == ["box", "pyramid"]
    assert made[:2] == [("box", "acc", 0), ("box", "gregory", 0)]
    assert made[8] == ("pyramid", "pinched", 0)
    assert [depth for *_, depth in made[2:8]] == [1, 1, 2, 2, 3, 3]
    for row in result["rows"]:
        bound = row["limit_bound_percent"]
        assert bound is None or bound >= row["limit_max_percent"]
    known = [row["depth"] for row in result["rows"][:8] if row["limit_bound_percent"] is not None]
    assert known == [1, 1, 2, 2, 3, 3]


PUBLISHED = {  # per cent of the diagonal: root mean squares
    ("suzanne", "pinched"): 0.0100,
    ("suzanne", "gregory"): 0.0072,
    ("monsterfrog", "acc"): 0.0048,
    ("monsterfrog", "gregory"): 0.0027,
    ("bigguy", "acc"): 0.0034,
    ("bigguy", "gregory"): 0.0026,
}


@pytest.mark.slow
@pytest.mark.parametrize(("name", "scheme"), PUBLISHED, ids=str)
def test_distances_agree_with_those_found_otherwise(models, name, scheme):
    """Limit points of a mesh after steps of subdivision, and their distance from planes that touch patches."""
    conversion = load(models / f"{name}.obj").conversion
    assert conversion is not None
    mesh = smooth(conversion.mesh)
    found = limit_distance(scene_of(mesh, scheme))
    assert 100.0 * found.rms / diagonal(mesh) == pytest.approx(PUBLISHED[name, scheme], rel=0.05)


@pytest.mark.slow
@pytest.mark.parametrize("scheme", ["catmull-clark+acc", "catmull-clark+gregory"])
@pytest.mark.parametrize("name", ["spot_control_mesh", "monsterfrog", "bigguy"])
def test_a_step_brings_patches_nearer_by_an_eigenvalue(models, name, scheme):
    far = [limit_distance(load(models / f"{name}.obj", scheme=scheme, steps=steps)) for steps in (2, 3)]
    assert 0.340 - 0.02 < far[1].largest / far[0].largest < 0.410 + 0.02
    for found in far:
        assert found.bound is not None
        ratio = found.bounds[found.odd] / found.patches[found.odd]
        assert ratio.min() >= 1.0
        assert np.median(ratio) <= 3.0


@pytest.mark.slow
def test_gregory_patches_are_smoother_and_not_reliably_nearer(models):
    nearer = []
    for name in ("suzanne", "catmark_gregory_test8", "catmark_lefthanded", "catmark_xord_boundary", "catmark_pole64"):
        scenes = [load(models / f"{name}.obj", scheme="catmull-clark+" + scheme, steps=1) for scheme in SCHEMES]
        acc, gregory = map(limit_distance, scenes)
        nearer.append(gregory.largest < acc.largest)
        conversion = scenes[1].conversion
        assert conversion is not None
        assert normal_jumps(scenes[1].patches(), conversion.smooth_sides).max() < 1e-5
    assert len(set(nearer)) == 2
