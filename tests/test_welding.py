"""Which of the vertices that a file splits become one: bodies stay whole, and apart where they only touch."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slefejax import load
from slefejax.io.gltf.read import read_gltf
from slefejax.io.welding import welded_soundly
from slefejax.model.defects import find_defects
from slefejax.model.mesh import Mesh
from tests.gltf_files import Writer, primitive_of, save

QUADS = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
TRIANGLES = np.array([t for a, b, c, d in QUADS for t in ((a, b, c), (a, c, d))])
UNIT = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], float)
SPLITS = ("not", "at every face", "at every triangle")


def welded(places: Any, triangles: Any, split: str) -> tuple[Mesh, int]:
    """Vertices split as an exporter does, equal ones made one, and that divided where it is not sound."""
    places, triangles = np.asarray(places, float), np.asarray(triangles)
    own = triangles.ravel()
    if split == "at every face":
        own = own + len(places) * np.repeat(np.arange(len(triangles)) // 2, 3)
    elif split == "at every triangle":
        own = np.arange(triangles.size)
    vertices, inverse = np.unique(places, axis=0, return_inverse=True)
    mesh = Mesh.packed(vertices, inverse.ravel()[triangles].ravel(), np.full(len(triangles), 3))
    vertex, corners, apart = welded_soundly(mesh, own)
    assert np.array_equal(vertices[vertex][corners], places[triangles.ravel()])
    return Mesh.packed(vertices[vertex], corners, mesh.sizes), apart


def cubes(*shifts: Any) -> tuple[np.ndarray, np.ndarray]:
    """Cubes with vertices of their own."""
    return np.concatenate([UNIT + s for s in shifts]), np.concatenate([TRIANGLES + 8 * k for k in range(len(shifts))])


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize(
    ("shifts", "apart"),
    [
        ([(0, 0, 0)], 0),
        ([(0, 0, 0), (5, 0, 0)], 0),
        ([(0, 0, 0), (1, 1, 0)], 2),  # an edge
        ([(0, 0, 0), (1, 1, 1)], 1),  # a vertex
        ([(0, 0, 0), (1, 0, 0)], 4),  # a face
        ([(0, 0, 0), (0, 0, 0)], 8),  # all of it
        ([(0, 0, 0), (1, 1, 0), (0, 1, 1)], 4),  # three edges, which meet in a vertex of all three
    ],
)
def test_cubes_that_touch_stay_cubes(shifts, apart, split):
    found, divided = welded(*cubes(*shifts), split)
    assert find_defects(found) == []
    assert (found.components[0], found.vertex_count, divided) == (len(shifts), 8 * len(shifts), apart)
    assert not found.boundary.any()


SHEET = np.array([[x, y, 0.1 * x * x] for x in range(3) for y in range(2)], float)
FRONT = np.array([(0, 2, 1), (2, 3, 1), (2, 4, 3), (4, 5, 3)])


def test_the_two_sides_of_a_leaf_stay_apart():
    found, divided = welded(np.concatenate([SHEET, SHEET]), np.concatenate([FRONT, FRONT[:, ::-1] + 6]), "not")
    assert find_defects(found) == []
    assert (found.components[0], found.vertex_count, divided) == (2, 12, 6)
    assert found.boundary.sum() == 12


def test_walls_that_meet_others_end_there():
    """Two faces go on, as the file's own vertices say; what comes from the side ends."""
    wall = [(0, 2, 1), (2, 3, 1), (2, 4, 3), (4, 5, 3)]
    places = np.concatenate([SHEET, [[1, 0, 0.1], [1, 1, 0.1], [1, 0, 1], [1, 1, 1]]])
    found, divided = welded(places, np.array([*wall, (6, 8, 7), (8, 9, 7)]), "not")
    assert find_defects(found) == []
    assert (found.components[0], found.vertex_count, divided) == (2, 10, 2)


def test_neighbours_that_look_away_from_each_other_stay_apart():
    found, divided = welded(
        SHEET[[0, 1, 2, 3, 2, 3, 4, 5]], np.array([(0, 2, 1), (2, 3, 1), (4, 5, 6), (6, 5, 7)]), "not"
    )
    assert find_defects(found) == []
    assert (found.components[0], divided) == (2, 2)


@pytest.mark.parametrize(
    "triangles",
    [
        [(0, 2, 1), (1, 2, 3), (2, 1, 4)],  # an edge of three faces
        [(0, 2, 1), (0, 1, 2)],  # the same vertices
        [(0, 2, 1), (1, 3, 4)],  # two fans at a vertex
    ],
)
def test_defects_of_the_file_s_own_are_left_to_be_told(triangles):
    found, divided = welded(np.random.default_rng(1).normal(size=(5, 3)), np.array(triangles), "not")
    assert find_defects(found) != []
    assert divided == 0


def test_cubes_of_a_file(tmp_path):
    writer = Writer()
    primitives = [primitive_of(writer, UNIT + s, TRIANGLES) for s in ((0, 0, 0), (1, 1, 0))]
    path = save(tmp_path, writer.content(nodes=[{"mesh": 0}], meshes=[{"primitives": primitives}]))
    found: Any = read_gltf(path)
    assert found.notes == ("node 'node 0': in 2 places surfaces only touch: their vertices there were kept apart",)
    scene: Any = load(path, drop_defects=True)
    assert (scene.conversion.mesh.face_count, scene.conversion.mesh.components[0]) == (24, 2)


def test_cubes_of_an_obj_file_have_the_vertices_that_it_gives_them(tmp_path):
    places, triangles = cubes((0, 0, 0), (1, 1, 1))
    lines = ["v {} {} {}".format(*p) for p in places] + ["f {} {} {}".format(*(t + 1)) for t in triangles]
    (tmp_path / "touch.obj").write_text("\n".join(lines))
    scene: Any = load(tmp_path / "touch.obj")
    assert (scene.conversion.mesh.components[0], scene.notes) == (2, ())
