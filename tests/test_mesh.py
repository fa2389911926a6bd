from __future__ import annotations

import numpy as np
import pytest

from slefejax import InputError
from slefejax.model.defects import check_manifold, find_defects, isolated_vertices, without_defects
from slefejax.model.mesh import Mesh
from tests.meshes import cube, disc, grid, mixed, triangle_fan

SQUARE = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [2, 0, 0], [2, 1, 0], [9, 9, 9], [5, 5, 5]]


def test_counts_of_a_cube():
    mesh = cube()
    assert (mesh.face_count, mesh.edge_count, mesh.vertex_count) == (6, 12, 8)
    assert mesh.valence.tolist() == [3] * 8
    assert not mesh.boundary.any()
    assert mesh.components[0] == 1
    assert find_defects(mesh) == []


@pytest.mark.parametrize("seed", range(3))
def test_half_edges_of_any_mesh(seed):
    rng = np.random.default_rng(seed)
    for mesh in (grid(4, 5), grid(4, 5, True, True), disc(5), disc(7, half=False), triangle_fan(6), mixed(rng)):
        corner = np.arange(len(mesh.corners))
        assert np.array_equal(mesh.prev_corner[mesh.next_corner], corner)
        inner = mesh.twin >= 0
        assert np.array_equal(mesh.twin[mesh.twin[inner]], corner[inner])
        assert np.array_equal(mesh.corners[mesh.twin[inner]], mesh.ends[inner])
        assert np.array_equal(~inner, mesh.boundary[mesh.edge])
        # Euler: V - E + F of a disc, a sphere, a torus
        assert mesh.vertex_count - mesh.edge_count + mesh.face_count in (0, 1, 2)


def test_fans_turn_counter_clockwise_and_end_at_boundaries():
    mesh = grid(4, 4)
    fans = mesh.fans()
    assert np.array_equal(np.bincount(fans.vertex, minlength=16), np.ones(16))
    assert np.count_nonzero(fans.closed) == 4
    assert mesh.one_ring(5).tolist() in [np.roll([9, 6, 1, 4], k).tolist() for k in range(4)]
    assert mesh.one_ring(0).tolist() == [4, 1]
    assert mesh.one_ring(1).tolist() == [0, 5, 2]


def test_the_one_ring_of_a_pole_goes_around_once():
    mesh = disc(64)
    ring = mesh.one_ring(0)
    assert len(set(ring.tolist())) == 64
    angle = np.unwrap(np.arctan2(mesh.vertices[ring, 1], mesh.vertices[ring, 0]))
    np.testing.assert_allclose(np.diff(angle), 2 * np.pi / 64)


def test_fans_can_be_divided():
    mesh = grid(3, 3)
    last = (mesh.corners == 4) & np.isin(mesh.corners[mesh.prev_corner], [1, 7])
    fans = mesh.fans(last)
    at = fans.vertex == 4
    assert fans.size[at].tolist() == [2, 2]
    assert not fans.closed[at].any()


def test_creases_belong_to_edges():
    mesh = cube()
    sharp = Mesh.packed(
        mesh.vertices,
        mesh.corners,
        mesh.sizes,
        creases=np.array([[3, 1], [0, 1]]),
        crease_sharpness=np.array([2.0, 1.5]),
    )
    by_pair = {tuple(pair): s for pair, s in zip(sharp.edge_vertices.tolist(), sharp.edge_sharpness, strict=True)}
    assert by_pair[1, 3] == 2.0
    assert by_pair[0, 1] == 1.5
    assert sum(s > 0 for s in by_pair.values()) == 2
    odd = Mesh.packed(
        mesh.vertices, mesh.corners, mesh.sizes, creases=np.array([[0, 7]]), crease_sharpness=np.array([1.0])
    )
    with pytest.raises(InputError, match="crease 0 joins vertices 0 and 7"):
        _ = odd.edge_sharpness


@pytest.mark.parametrize(
    ("faces", "says", "left"),
    [
        ([(0, 1, 2, 3), (1, 4, 4, 2)], "face 1 names vertex 4 twice", 1),
        ([(0, 1, 2, 3), (2, 3, 0, 1)], "faces 0 and 1 have the same vertices", 1),
        ([(0, 1, 2, 3), (3, 2, 1, 0)], "faces 0 and 1 have the same vertices", 1),
        ([(0, 1, 2, 3), (1, 4, 5, 2), (2, 1, 6)], "the edge of vertices 1 and 2 belongs to 3 faces \\(0, 1, 2\\)", 2),
        ([(0, 1, 2, 3), (2, 5, 4, 1)], "faces 0 and 1 run along their common edge of vertices 1 and 2", 1),
        ([(0, 1, 2), (2, 5, 4)], "at vertex 2 2 fans of faces only touch", 1),
        ([(0, 1, 1), (0, 2, 2), (0, 1, 3)], "face 0 names vertex 1 twice, and 1 more like it", 1),
    ],
)
def test_defects_are_told_by_number_and_dropped_on_request(faces, says, left):
    mesh = Mesh.of(SQUARE, faces)
    with pytest.raises(InputError, match=says):
        check_manifold(mesh)
    clean, notes = without_defects(mesh)
    assert clean.face_count == left
    assert find_defects(clean) == []
    assert len(notes) == 1
    assert "dropped" in notes[0]


def test_faces_of_fewer_than_three_vertices_are_a_defect():
    """Wherever they stand, none of them disturbs what the other faces are."""
    whole = Mesh.of(SQUARE, [(0, 1, 2, 3), (1, 4, 5, 2)])
    mesh = Mesh.packed(SQUARE, [7, 0, 1, 2, 3, 6, 7, 1, 4, 5, 2], [0, 1, 4, 0, 2, 4, 0])
    says = "face 0 has 0 vertices, and needs three, and 4 more like it"
    with pytest.raises(InputError, match=says):
        check_manifold(mesh)
    own = np.isin(mesh.face, [2, 5])
    for name in ("next_corner", "prev_corner"):
        assert mesh.corners[getattr(mesh, name)[own]].tolist() == whole.corners[getattr(whole, name)].tolist()
    clean, notes = without_defects(mesh)
    assert clean.corners.tolist() == whole.corners.tolist()
    assert clean.numbers.tolist() == [2, 5]
    assert notes == (f"{says}: 5 faces were dropped (0, 1, 3, 4, …)",)
    with pytest.raises(InputError, match="nothing is left"):
        without_defects(Mesh.packed(SQUARE, [0, 1], [2, 0]))
    with pytest.raises(InputError, match="negative number of vertices"):
        Mesh.packed(SQUARE, [0, 1, 2], [4, -1])


def test_dropping_goes_on_until_nothing_is_left_to_drop():
    # the third face makes an edge of three; without it two fans touch at vertex 2
    mesh = Mesh.of(SQUARE, [(0, 1, 2, 3), (2, 5, 4), (2, 1, 6), (1, 2, 7)])
    clean, notes = without_defects(mesh)
    assert find_defects(clean) == []
    assert len(notes) >= 1
    with pytest.raises(InputError, match="nothing is left"):
        without_defects(Mesh.of(SQUARE, [(0, 1, 1)]))


def test_faces_keep_the_numbers_of_their_file():
    mesh = Mesh.of(SQUARE, [(0, 1, 1), (0, 1, 2, 3), (2, 5, 4, 1)])
    with pytest.raises(InputError, match="face 0 names"):
        check_manifold(mesh)
    assert mesh.keep(np.array([False, True, True])).numbers.tolist() == [1, 2]
    with pytest.raises(InputError, match="faces 1 and 2 run"):
        check_manifold(mesh.keep(np.array([False, True, True])))


def test_isolated_vertices_are_no_defect():
    mesh = Mesh.of(SQUARE, [(0, 1, 2, 3)])
    assert find_defects(mesh) == []
    assert isolated_vertices(mesh).tolist() == [4, 5, 6, 7]


@pytest.mark.parametrize(
    ("vertices", "faces", "says"),
    [
        (SQUARE, [], "at least one face"),
        (SQUARE, [(0, 1)], "face 0 .* has 2 vertices"),
        (SQUARE, [(0, 1, 2), (0, 1, 8)], "face 1 .* has a vertex 8, but there are 8"),
        (SQUARE, [(0, 1, -1)], "face 0 .* has a vertex -1"),
        ([[0, 0], [1, 0], [1, 1]], [(0, 1, 2)], "array \\(vertices, 3\\)"),
        ([[0, 0, 0], [1, np.nan, 0], [1, 1, 0]], [(0, 1, 2)], "vertex 1 .* not at a finite place"),
    ],
)
def test_what_is_no_mesh(vertices, faces, says):
    with pytest.raises(InputError, match=says):
        Mesh.of(vertices, faces)


@pytest.mark.parametrize(
    ("sharp", "says"),
    [
        ({"creases": [[0, 8]], "crease_sharpness": [1.0]}, "crease 0 .* names vertex 8, but there are 8"),
        ({"creases": [[-1, 0]], "crease_sharpness": [1.0]}, "crease 0 .* names vertex -1"),
        ({"creases": [[0, 1]], "crease_sharpness": [np.nan]}, "crease 0 .* has the sharpness nan"),
        ({"creases": [[0, 1]], "crease_sharpness": [-3.0]}, "crease 0 .* has the sharpness -3"),
        ({"creases": [[0, 1]], "crease_sharpness": []}, "every crease needs a sharpness: there are 1 and 0"),
        ({"points": [0, 9], "point_sharpness": [1.0, 2.0]}, "sharp vertex 1 .* names vertex 9"),
    ],
)
def test_what_is_no_crease(sharp, says):
    square = Mesh.of(SQUARE, [(0, 1, 2, 3)])
    with pytest.raises(InputError, match=says):
        Mesh.packed(
            square.vertices, square.corners, square.sizes, **{name: np.array(value) for name, value in sharp.items()}
        )


def test_faces_name_vertices_by_whole_numbers():
    with pytest.raises(InputError, match="whole numbers"):
        Mesh.of(SQUARE, [(0.7, 1, 2, 3)])


def test_large_faces_do_not_widen_the_search_for_duplicates():
    """A cylinder with two caps of 20,000 corners; a table as wide as those would take 6 GB."""
    n = 20_000
    ring = np.arange(n)
    sides = np.stack([ring, np.roll(ring, -1), n + np.roll(ring, -1), n + ring], axis=1)
    angle = 2 * np.pi * ring / n
    places = np.stack([np.cos(angle), np.sin(angle), 0 * angle], axis=1)
    corners = np.concatenate([sides.ravel(), ring[::-1], n + ring])
    mesh = Mesh.packed(np.concatenate([places, places + [0, 0, 1]]), corners, [*[4] * n, n, n])
    assert find_defects(mesh) == []


def test_a_vertex_with_two_fans_has_no_one_ring():
    with pytest.raises(InputError, match="2 fans"):
        Mesh.of(SQUARE, [(0, 1, 2), (2, 5, 4)]).one_ring(2)
