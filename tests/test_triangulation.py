"""The tessellator on the host: against the driver's triangles, and against what every triangulation has to be."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slefejax import Camera, InputError, View, load, tessellation_factors, triangle_error, triangulate
from slefejax.geometry.bezier import elevate, evaluate_patch
from slefejax.tessellator.direct3d11 import ONE, places, rings, tessellate
from slefejax.tessellator.edges import edge_maxima, shared_edges
from slefejax.tessellator.levels import SPACINGS, highest_level, segments, triangle_counts, with_pieces
from tests.mixed import as_bv, cube_sphere
from tests.test_gpu import lattice
from tests.test_pieces import some_levels

QUAD = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], np.float64)
STEPS = 2**24


def some(rng: np.random.Generator, count: int, spacing: str, highest: float):
    """Random levels inside and on the edges."""
    if spacing == "equal":
        return rng.integers(1, int(highest) + 1, (count, 2)), rng.integers(1, int(highest) + 1, (count, 4))
    return rng.uniform(0.3, highest, (count, 2)), rng.uniform(0.3, highest, (count, 4))


def in_order(patch: np.ndarray, parameters: np.ndarray) -> np.ndarray:
    """Triangles as rows of whole numbers, whatever their order and that of their corners."""
    place = np.rint(parameters.astype(float) * STEPS).astype(np.int64)
    rows = np.column_stack([patch, np.sort(place[..., 0] * (STEPS + 1) + place[..., 1], axis=1)])
    return rows[np.lexsort(rows.T[::-1])]


def same_as_driver(renderer, inner, outer, spacing="equal") -> bool:
    view = View(Camera.orthographic((0.5, 0.5, 5.0), (0.5, 0.5, 0.0), up=(0, 1, 0)), 16, 16)
    driver = renderer.capture(view, inner, outer)
    own = triangulate(np.repeat(QUAD[None], len(inner), axis=0), (inner, outer), spacing)
    found = in_order(own.patch[own.faces[:, 0]], own.parameters[own.faces])
    return np.array_equal(in_order(driver.patch, driver.parameters), found)


@pytest.fixture
def renderer_of(device):
    """Makes a renderer of so many unit squares."""
    from slefejax.gpu import Renderer

    made = []

    def make(count: int, spacing: str = "equal") -> Renderer:
        made.append(Renderer(np.repeat(QUAD[None], count, axis=0), device, spacing))
        return made[-1]

    yield make
    for each in made:
        each.release()


@pytest.mark.gl
@pytest.mark.parametrize("spacing", SPACINGS)
def test_the_drivers_triangles(renderer_of, rng, spacing):
    """Equal sets of parameters for random levels; few and small ones, where special cases are, too."""
    renderer = renderer_of(150, spacing)
    for highest in (2, 5, highest_level(spacing)):
        inner, outer = some(rng, 150, spacing, highest)
        inner[0], outer[0] = 1, 1
        assert same_as_driver(renderer, inner, outer, spacing)


@pytest.mark.gl
def test_the_drivers_triangles_of_pieces(renderer_of):
    """Patches past 64 beside others, all vertices placed with 24 bits."""
    renderer = renderer_of(9)
    for seed in range(4):
        inner, outer = with_pieces(*some_levels(seed, 700))
        assert np.any(outer > 64)
        assert same_as_driver(renderer, inner, outer)


@pytest.mark.gl
@pytest.mark.slow
def test_every_pair_and_ten_thousand_sixtuples_of_the_driver(renderer_of, rng):
    renderer = renderer_of(64)
    every = np.arange(1, 65)
    for n in every:
        inner = np.column_stack([np.full(64, n), np.full(64, 3)])
        assert same_as_driver(renderer, inner, np.column_stack([np.full(64, 3), every, np.full(64, 3), every]))
        assert same_as_driver(
            renderer, inner[:, ::-1], np.column_stack([every, np.full(64, 3), every[::-1], np.full(64, 3)])
        )
    for spacing in SPACINGS:
        many = renderer_of(500, spacing)
        for _ in range(20):
            assert same_as_driver(many, *some(rng, 500, spacing, highest_level(spacing)), spacing)


@given(st.integers(0, 10**6), st.sampled_from(SPACINGS), st.sampled_from([3.0, 12.0, 63.0]))
def test_triangles_fill_the_domain_once(seed, spacing, highest):
    """As many as OpenGL prescribes, none turned over, areas that add up to 1, no vertex that is not used."""
    inner, outer = some(np.random.default_rng(seed), 3, spacing, highest)
    outer[1, seed % 4] = 0
    made = tessellate(inner, outer, spacing)
    owner = made.patch[made.triangles[:, 0]]
    assert np.array_equal(np.bincount(owner, minlength=3), triangle_counts(inner, outer, spacing))
    assert np.all(np.diff(owner) >= 0)
    a, b, c = np.moveaxis(made.parameters()[made.triangles] * ONE, 1, 0).astype(np.int64)
    area = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    assert area.min() >= 0 if spacing != "equal" else area.min() > 0, "fractional segments begin without length"
    assert np.bincount(owner, area, minlength=3).tolist() == [2 * ONE**2, 0, 2 * ONE**2]
    assert np.array_equal(np.unique(made.triangles), np.arange(len(made.patch)))


@given(st.integers(0, 10**6), st.sampled_from(SPACINGS))
def test_points_are_mirrored_and_in_order(seed, spacing):
    level = np.random.default_rng(seed).uniform(2.0, highest_level(spacing))
    level = np.array(np.ceil(level) if spacing == "equal" else level)
    count = segments(level, spacing)
    found = places(level, count, np.arange(int(count) + 1))
    assert np.array_equal(found, ONE - found[::-1])
    assert np.all(np.diff(found) >= 0)
    assert found[[0, -1]].tolist() == [0, ONE]


def test_rings_walk_from_end_to_end():
    """Each ring takes every point of its rim and of its edge, one step a triangle, and is its own mirror image."""
    n, m = (x.ravel() for x in np.meshgrid(np.arange(2, 65), np.arange(1, 65), indexing="ij"))
    pair, corners = rings(n, m)
    assert np.array_equal(np.bincount(pair), n - 2 + m)
    of_edge = np.sum(corners >= 0, axis=1) == 2
    assert np.array_equal(np.bincount(pair[of_edge]), m)
    assert np.all(np.sum(corners >= 0, axis=1) >= 1)
    for k in np.flatnonzero((n * m) % 97 == 5):
        own = corners[pair == k]
        if n[k] % 2 and m[k] % 2:
            continue  # the quad in the middle has one diagonal
        mirrored = np.where(own >= 0, m[k] - own, -(n[k] + own))
        assert {tuple(sorted(t)) for t in own.tolist()} == {tuple(sorted(t)) for t in mirrored.tolist()}


@pytest.mark.parametrize("degree", [1, 3, 4])
def test_a_mesh_without_cracks(rng, degree):
    """Positions lie on the surface, and those on a shared side are equal bit for bit, whatever way patches lie."""
    patches = lattice(rng, 3, degree)
    numbers = shared_edges(patches)
    inner = np.repeat(rng.choice([1, 5, 33, 70, 150], 9)[:, None], 2, axis=1)
    inner[0] = 70
    inner, outer = with_pieces(inner, edge_maxima(inner[:, 0], numbers), numbers)
    made = triangulate(patches, (inner, outer))
    places_, welded = np.unique(made.positions, axis=0, return_inverse=True)
    faces = welded.ravel()[made.faces]
    sides = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    used = np.unique(sides, axis=0, return_counts=True)[1]
    assert used.max() == 2
    rim = outer[np.bincount(numbers.ravel())[numbers] == 1].sum()
    assert np.sum(used == 1) == rim
    assert len(places_) - len(np.unique(sides, axis=0)) + len(faces) == 1, "Euler's formula for a disc"
    exact = evaluate_patch(np.moveaxis(patches[made.patch], 0, -1), *made.parameters.T).T
    np.testing.assert_allclose(made.positions, exact, rtol=0, atol=1e-14)


@pytest.mark.parametrize("weld", [None, 0.0])
def test_a_mesh_of_mixed_degrees_without_cracks(tmp_path, weld):
    """Patches of 3 x 3, 4 x 4 and 5 x 4 in one file: watertight with sides that have owners, and not without."""
    (tmp_path / "mixed.bv").write_text(as_bv(cube_sphere(np.random.default_rng(5))))
    scene = load(tmp_path / "mixed.bv", weld=weld)
    rng = np.random.default_rng(5)
    level = rng.integers(2, 90, len(scene.patches()))
    inner = np.repeat(level[:, None], 2, axis=1)
    inner, outer = with_pieces(inner, edge_maxima(level, scene.edge_numbers), scene.edge_numbers)
    made = triangulate(scene.patches(), (inner, outer), sides=scene.sides)
    welded = np.unique(made.positions, axis=0, return_inverse=True)[1].ravel()[made.faces]
    sides = np.sort(np.stack([welded, np.roll(welded, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    open_sides = np.sum(np.unique(sides, axis=0, return_counts=True)[1] != 2)
    assert (open_sides == 0) == (weld is None)


def test_rational_positions_and_normals(rng):
    """A sphere's octant of degree 4 x 3 (rational, a collapsed side): radius 1, normals along positions."""
    arc = np.array([[1, 0, 1], [1, 1, 1], [0, 2, 2]], float)  # (w x, w y, w) of a quarter circle
    x, y, w = arc.T
    patch = np.stack([np.outer(x, x), np.outer(y, x), np.outer(w, y), np.outer(w, w)], axis=-1)
    raised = np.swapaxes(elevate(np.swapaxes(elevate(patch, 4), 0, 1), 3), 0, 1)
    made = triangulate(raised[None], ([[9, 7]], [[9, 12, 4, 9]]))
    np.testing.assert_allclose(np.linalg.norm(made.positions, axis=1), 1.0, rtol=0, atol=1e-15 * 8)
    # beside the pole by 2^-16 of the domain
    np.testing.assert_allclose(np.abs(np.sum(made.normals * made.positions, axis=1)), 1.0, rtol=0, atol=1e-8)
    assert np.all(made.parameters[~made.normals.any(axis=1)] == 0)


def test_factors_and_captured_triangles_have_one_error(teapot, main_view):
    """Triangles of factors keep the tolerance; the published estimate's 34 % unsafe patches are seen."""
    patches = teapot.patches()
    for method, safe in (("certified", True), ("slefe", False)):
        factors = tessellation_factors(patches, main_view, method, edge_numbers=teapot.edge_numbers)
        made = triangulate(patches, factors)
        assert len(made.faces) == triangle_counts(factors.inner, factors.edges).sum()
        error = triangle_error(patches, made, main_view)
        assert (error.max() <= 0.5) == safe


def test_bad_levels(rng):
    patches = lattice(rng, 1, 1)
    for levels, message in [
        (([[3, 3]], [[3, 3, 3]]), r"shapes \(1, 2\) and \(1, 4\), not \(1, 2\) and \(1, 3\)"),
        (([[3, 2.5]], [[3, 3, 3, 3]]), "whole numbers"),
        (([[3, -1]], [[3, 3, 3, 3]]), "from 0 to 16384"),
        (([[130, 3]], [[3, 3, 3, 3]]), "multiples"),
        (([[16384, 16384]], [[16384] * 4]), "536,870,912 triangles"),
        (7, "a pair"),
    ]:
        with pytest.raises(InputError, match=message):
            triangulate(patches, levels)
    with pytest.raises(InputError, match="from 0 to 63"):
        triangulate(patches, ([[64.0, 3]], [[3, 3, 3, 3]]), "fractional-odd")
    with pytest.raises(InputError, match="spacing"):
        triangulate(patches, ([[4, 3]], [[3, 3, 3, 3]]), "odd")
    nothing = triangulate(patches, ([[3, 3]], [[0, 3, 3, 3]]))
    assert nothing.faces.shape == (0, 3)
    assert nothing.positions.shape == nothing.normals.shape == (0, 3)


def test_many_patches_at_once():
    """Vertices of a patch lie together, whichever patches are drawn; normals of a whole character."""
    patches = load("walker").patches()
    inner, outer, _ = some_levels(1, 40)
    made = triangulate(patches, (np.resize(inner, (len(patches), 2)), np.resize(outer, (len(patches), 4))))
    assert np.all(np.diff(made.patch) >= 0)
    np.testing.assert_allclose(np.linalg.norm(made.normals, axis=1), 1.0, rtol=0, atol=1e-12)
