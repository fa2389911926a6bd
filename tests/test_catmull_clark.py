from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from slefejax.conversion.catmull_clark import refine
from slefejax.model.defects import find_defects
from slefejax.model.mesh import Mesh
from tests.meshes import cube, disc, grid, mixed, triangle_fan


def textbook_step(mesh):
    """Catmull and Clark's rules face by face and edge by edge, smooth and with sharp boundaries."""
    faces = [mesh.corners[a:b].tolist() for a, b in zip(mesh.offsets[:-1], mesh.offsets[1:], strict=True)]
    p = mesh.vertices
    centre = [p[face].mean(axis=0) for face in faces]
    around: dict = {}
    for number, face in enumerate(faces):
        for a, b in zip(face, face[1:] + face[:1], strict=True):
            around.setdefault(frozenset((a, b)), []).append(number)
    edge = {}
    for pair, own in around.items():
        middle = p[list(pair)].mean(axis=0)
        edge[pair] = middle if len(own) == 1 else (2 * middle + centre[own[0]] + centre[own[1]]) / 4
    vertex = []
    for v in range(len(p)):
        mine = [pair for pair in around if v in pair]
        rim = [next(iter(pair - {v})) for pair in mine if len(around[pair]) == 1]
        touching = [k for k, face in enumerate(faces) if v in face]
        n = len(mine)
        if not mine or (rim and len(touching) == 1):
            vertex.append(p[v])
        elif rim:
            vertex.append((6 * p[v] + p[rim[0]] + p[rim[1]]) / 8)
        else:
            q = np.mean([centre[k] for k in touching], axis=0)
            r = np.mean([p[list(pair)].mean(axis=0) for pair in mine], axis=0)
            vertex.append((q + 2 * r + (n - 3) * p[v]) / n)
    return vertex, edge, centre


@pytest.mark.parametrize("kind", ["grid", "torus", "disc 3", "disc 7", "fan", "mixed", "cube"])
def test_one_step_is_the_textbooks(rng, kind):
    mesh = {
        "grid": lambda: grid(4, 5, rng=rng),
        "torus": lambda: grid(4, 5, True, True, rng=rng),
        "disc 3": lambda: disc(3, rng=rng),
        "disc 7": lambda: disc(7, rng=rng),
        "fan": lambda: triangle_fan(6, rng=rng),
        "mixed": lambda: mixed(rng),
        "cube": cube,
    }[kind]()
    finer, table, parents = refine(mesh)
    vertex, edge, centre = textbook_step(mesh)
    wanted = [*vertex, *(edge[frozenset(pair)] for pair in mesh.edge_vertices.tolist()), *centre]
    np.testing.assert_allclose(finer.vertices, wanted, atol=1e-14)
    np.testing.assert_allclose(table.row_sums(), 1.0, atol=1e-15)
    assert find_defects(finer) == []
    assert np.all(finer.sizes == 4)
    assert finer.face_count == len(mesh.corners)
    # every child touches a vertex of its parent, and its middle
    assert np.array_equal(finer.corners[0::4], mesh.corners)
    assert np.array_equal(finer.corners[2::4] - mesh.vertex_count - mesh.edge_count, parents)


def creased(mesh, sharpness, pairs=None, points=(), point_sharpness=()):
    pairs = mesh.edge_vertices if pairs is None else np.array(pairs)
    return Mesh.packed(
        mesh.vertices,
        mesh.corners,
        mesh.sizes,
        creases=pairs,
        crease_sharpness=np.full(len(pairs), float(sharpness)),
        points=np.array(points, np.int64),
        point_sharpness=np.array(point_sharpness, float),
    )


def test_a_cube_with_sharp_edges_stays_a_cube():
    mesh = creased(cube(), np.inf)
    for _ in range(3):
        mesh, _, _ = refine(mesh)
    distance = np.min(np.abs(np.stack([mesh.vertices, mesh.vertices - 1])), axis=(0, 2))
    assert np.all(distance == 0)
    assert [v in mesh.vertices.tolist() for v in cube().vertices.tolist()] == [True] * 8


def test_sharpness_lasts_as_many_steps_as_it_says():
    """Sharp for two steps, then smooth: two steps keep the cube's edges, the third is the smooth rule."""
    mesh = creased(cube(), 2.0)
    for left in (1.0, 0.0):
        mesh, _, _ = refine(mesh)
        inner = mesh.edge_sharpness[mesh.edge_sharpness > 0]
        assert np.all(inner == left)
    assert not len(mesh.creases)
    smooth, _, _ = refine(Mesh.packed(mesh.vertices, mesh.corners, mesh.sizes))
    assert np.array_equal(refine(mesh)[0].vertices, smooth.vertices)


@pytest.mark.parametrize("sharpness", [0.25, 0.5, 0.75])
def test_below_one_both_rules_are_blended(sharpness):
    mesh = cube()
    smooth, sharp = refine(mesh)[0].vertices, refine(creased(mesh, 1.0))[0].vertices
    blended = refine(creased(mesh, sharpness))[0].vertices
    np.testing.assert_allclose(blended, (1 - sharpness) * smooth + sharpness * sharp, atol=1e-15)


def test_a_crease_is_the_cubic_spline_of_its_vertices(rng):
    """Around the middle of a torus: the curve of the crease does not see what lies beside it."""
    mesh = grid(6, 6, True, True, rng=rng)
    ring = np.arange(6) * 6
    sharp = creased(mesh, 1.0, pairs=np.stack([ring, np.roll(ring, -1)], axis=1))
    finer = refine(sharp)[0]
    p = mesh.vertices[ring]
    np.testing.assert_allclose(finer.vertices[ring], (np.roll(p, 1, 0) + 6 * p + np.roll(p, -1, 0)) / 8, atol=1e-15)


def test_a_crease_that_ends_is_smooth_at_its_end(rng):
    mesh = grid(5, 5, True, True, rng=rng)
    smooth, dart = refine(mesh)[0], refine(creased(mesh, 3.0, pairs=[[6, 7]]))[0]
    assert np.array_equal(dart.vertices[:25], smooth.vertices[:25])
    changed = np.flatnonzero(np.any(dart.vertices != smooth.vertices, axis=1))
    assert len(changed) == 1
    np.testing.assert_allclose(dart.vertices[changed[0]], mesh.vertices[[6, 7]].mean(axis=0), atol=1e-15)
    assert sorted(map(tuple, dart.creases.tolist())) == [(6, changed[0]), (7, changed[0])]


def test_sharp_vertices_and_three_creases_stay(rng):
    mesh = grid(5, 5, True, True, rng=rng)
    point = refine(creased(mesh, 0.0, pairs=np.zeros((0, 2), int), points=[12], point_sharpness=[2.0]))[0]
    assert np.array_equal(point.vertices[12], mesh.vertices[12])
    assert point.point_sharpness.tolist() == [1.0]
    spokes = [[12, n] for n in mesh.one_ring(12)[:3]]
    assert np.array_equal(refine(creased(mesh, 1.0, pairs=spokes))[0].vertices[12], mesh.vertices[12])


def test_vertices_of_no_face_keep_their_number_and_place():
    mesh = Mesh.of([[0, 0, 0], [7, 8, 9], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [(0, 2, 3, 4)])
    finer, _, _ = refine(mesh)
    assert finer.vertices[1].tolist() == [7, 8, 9]


def test_every_pair_of_rules_meets_in_some_blend(rng):
    """Affine invariance with any creases, of any sharpness, on any edges."""
    mesh = mixed(rng)
    turn, move = rng.normal(size=(3, 3)), rng.normal(size=3)
    for pairs in combinations(range(mesh.edge_count), 3):
        sharp = creased(mesh, 1.0, pairs=mesh.edge_vertices[list(pairs)])
        sharp = Mesh.packed(
            sharp.vertices,
            sharp.corners,
            sharp.sizes,
            creases=sharp.creases,
            crease_sharpness=rng.uniform(0, 2.5, 3),
        )
        _, table, _ = refine(sharp)
        np.testing.assert_allclose(table.row_sums(), 1.0, atol=1e-15)
        moved = table.on_host(mesh.vertices @ turn + move)
        np.testing.assert_allclose(moved, table.on_host(mesh.vertices) @ turn + move, atol=1e-13)
