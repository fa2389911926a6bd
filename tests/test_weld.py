"""Sides that a file's digits parted, or that neighbours have in different degrees: one curve once they are loaded."""

from __future__ import annotations

import numpy as np
import pytest

from slefejax import InputError, load, save, tessellation_factors
from slefejax.conversion.common import blocks_of, common_degree
from slefejax.conversion.weld import welded
from slefejax.geometry.bezier import elevate
from slefejax.io.numbers import Numbers
from slefejax.tessellator.coincidence import coincident_sides
from slefejax.tessellator.edges import collapsed, edge_points, shared_edges
from tests.mixed import as_bv, cube_sphere, in_perspective
from tests.test_edges import SYMMETRIES
from tests.test_io import write
from tests.test_scene import CUBE
from tests.test_usd import nurbs_usd, usd


def uses(scene):
    """How many curves are of no, of one, of two … patches."""
    return np.bincount(np.bincount(scene.edge_numbers.ravel())).tolist()


@pytest.fixture(scope="module")
def raw():
    return cube_sphere(np.random.default_rng(5))


@pytest.fixture(scope="module")
def path(raw, tmp_path_factory):
    return write(tmp_path_factory.mktemp("mixed"), "mixed.bv", as_bv(raw))


def test_a_closed_surface_of_mixed_degrees_is_closed(raw, path):
    """24 patches, 48 curves, each of two; no point more than two roundings of 5e-7 from where it was; insides kept."""
    scene = load(path)
    assert scene.patches().shape == (24, 6, 5, 3)
    assert uses(scene) == [0, 0, 48]
    assert not coincident_sides(scene.patches(), scene.edge_numbers).any()
    assert "sides within 1.2e-06 of their neighbours' were welded" in scene.notes[0]
    exact = common_degree(blocks_of(raw))[0]
    # half a unit of the file's, and what a twin is away from it
    np.testing.assert_allclose(scene.patches(), exact, rtol=0, atol=5e-7 + 1.25e-6)
    assert (
        len(np.unique(np.concatenate([p[:, [0, -1]] for p in edge_points(scene.patches())]).reshape(-1, 3), axis=0))
        == 26
    )
    old = load(path, weld=0)
    assert np.bincount(old.edge_numbers.ravel()).tolist().count(1) > 48
    free = np.bincount(old.edge_numbers.ravel())[old.edge_numbers] == 1
    assert np.array_equal(coincident_sides(old.patches(), old.edge_numbers), free)
    whole = [5 * (k % 3 == 2) + 4 * (k % 3 == 1) == 5 for k in range(24)]  # 5 x 4 is not raised
    assert np.array_equal(scene.patches()[whole][:, 1:-1, 1:-1], old.patches()[whole][:, 1:-1, 1:-1])


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_neighbours_of_mixed_degrees_get_equal_levels(path, dtype, main_view):
    scene = load(path)
    patches = scene.patches().astype(dtype)
    assert np.array_equal(shared_edges(patches), scene.edge_numbers)
    factors = tessellation_factors(patches, main_view, "slefe")
    seen = factors.edges > 0
    for number in range(48):
        assert len(np.unique(factors.edges[(scene.edge_numbers == number) & seen])) <= 1


def test_what_is_saved_is_loaded_bit_for_bit(path, tmp_path):
    scene = load(path)
    save(scene, tmp_path / "again.bpt")
    again = load(tmp_path / "again.bpt")
    assert np.array_equal(again.patches(), scene.patches())
    assert np.array_equal(again.edge_numbers, scene.edge_numbers)
    assert again.notes == ()


def test_rational_patches_of_mixed_degrees(raw, tmp_path):
    """Seen in perspective by a matrix, each patch's weights times a factor of its own: digits and factors at once."""
    factors = np.random.default_rng(8).uniform(0.5, 2.0, len(raw))
    patches = [in_perspective(patch) * f for patch, f in zip(raw, factors, strict=True)]
    scene = load(write(tmp_path, "a.bv", as_bv(patches)))
    assert scene.patches().shape == (24, 6, 5, 4)
    assert uses(scene) == [0, 0, 48]
    assert "weights of 23 of 24 patches were multiplied by a factor" in scene.notes[0]
    assert "were welded" in scene.notes[1]
    where = scene.patches()[..., :3] / scene.patches()[..., 3:]
    exact = common_degree(blocks_of(patches))[0]
    # rounded to 5e-7 as w x and w, w above .3 and |x| below 1.6, and welded to what is as far off
    np.testing.assert_allclose(where, exact[..., :3] / exact[..., 3:], rtol=0, atol=2e-5)


@pytest.mark.parametrize(
    ("text", "digits"),
    [
        ("0.123456 1.000000 -0.654321", 1.25e-6),
        ("0.12346 1.00000 2", 1.25e-5),
        ("1.23457e-05 0.333333 12.3457", 1.25e-4),  # six digits each: of the largest the last is 1e-4
        ("0.1234567890123456 1 0", 1.25e-16),
        ("0 1 2", None),
        ("0.5 0.25 1", None),
        ("10000 20000 30001", None),
    ],
)
def test_digits_of_a_file(tmp_path, text, digits):
    numbers = Numbers(write(tmp_path, "a.txt", text))
    patch = np.broadcast_to(numbers.points((3,), "a number")[:, None, None], (3, 2, 3))
    found = numbers.digits([patch])
    assert found is None if digits is None else found == pytest.approx(digits, rel=1e-12)


def strip(rng, x):
    """A patch that begins at the side x = 0 and ends at x = 1, wavy along y, moved by x."""
    patch = rng.normal(scale=0.2, size=(4, 4, 3))
    patch[..., 1] += np.arange(4)[None, :]
    patch[[0, -1], :, 0] = [[0.0], [1.0]]
    return patch + [x, 0, 0]


def test_no_chain_is_drawn_together(rng):
    """Three patches on a curve at 0, 0.8 and 1.6 tolerances: the second goes to the first, the third stays."""
    first = strip(rng, 0.0)
    others = [strip(rng, k) for k in (0.8e-3, 1.6e-3)]
    for k, other in zip((0.8e-3, 1.6e-3), others, strict=True):
        other[0] = first[0] + [k, 0, 0]
    (a, b, c), notes = welded([first, *others], 1e-3)
    assert np.array_equal(a, first)
    assert np.array_equal(b[0], first[0])
    assert np.array_equal(b[1:], others[0][1:])
    assert np.array_equal(c, others[1])
    assert notes == (
        "1 sides within 0.001 of their neighbours' were welded to them: control points moved by 0.0008 at most",
    )


@pytest.mark.parametrize("way", SYMMETRIES)
def test_three_patches_of_three_degrees_on_one_curve(rng, way):
    curve = np.array([[0.0, y, y * (3 - y)] for y in range(4)])
    given = []
    for degree in (5, 3, 4):
        patch = rng.normal(size=(3, degree + 1, 3))
        patch[0] = elevate(curve, degree) + rng.uniform(-4e-7, 4e-7, (degree + 1, 3))
        given.append(SYMMETRIES[way](patch) if degree == 4 else patch)
    made, _ = welded(given, 1e-6)
    numbers = shared_edges(common_degree(blocks_of(made))[0])
    uses = np.bincount(numbers.ravel())
    assert sorted(uses.tolist()) == [1] * 9 + [3]
    # the one of the lowest degree has its points still, between corners that are the first patch's
    assert np.array_equal(made[1][0, 1:-1], given[1][0, 1:-1])
    assert np.array_equal(made[1][0, [0, -1]], given[0][0, [0, -1]])


def test_a_side_shorter_than_the_tolerance_does_not_become_a_point(rng):
    """A sliver between two patches: neither of its short sides is lost, and the neighbours do not meet through it."""
    left, right, sliver = strip(rng, 0.0), strip(rng, 1.0 + 5e-4), np.empty((2, 4, 3))
    sliver[0], sliver[1] = left[-1], left[-1] + [5e-4, 0, 0]
    right[0] = sliver[1]
    made, _ = welded([left, sliver, right], 1e-3)
    assert not any(collapsed(patch[None]).any() for patch in made)
    assert np.all(np.abs(made[1][1] - made[1][0]).max(axis=-1)[[0, -1]] > 0)


def test_a_point_stays_one(rng):
    """Two patches around a pole that one of them has half a unit beside: both sides u = 0 stay points, the same one."""
    one, other = rng.normal(size=(2, 4, 4, 3))
    one[0] = 0.0
    other[0] = [5e-7, 0, -5e-7]
    other[:, 0] = one[:, -1] + rng.uniform(-5e-7, 5e-7, (4, 3))
    other[0] = other[0, 0]
    made, _ = welded([one, other], 1e-6)
    assert np.all(made[1][0] == 0.0)
    assert np.array_equal(made[1][:, 0], one[:, -1])


def test_a_patch_that_meets_itself(rng):
    """A tube: u = 0 and u = 1 are one curve but for rounding, and the other two sides are loops, no points."""
    angle = np.linspace(0, 2 * np.pi, 6)
    tube = np.stack([[[np.cos(a), np.sin(a), z] for z in range(4)] for a in angle])
    tube += rng.uniform(-4e-7, 4e-7, tube.shape)
    (made,), _ = welded([tube], 1e-6)
    numbers = shared_edges(made[None])[0]
    assert numbers.tolist() == [0, 1, 0, 2]
    assert np.array_equal(made[1:-1], tube[1:-1])


def test_splines_of_other_degrees_and_knots_meet(tmp_path):
    """A surface raised along their common side meets one that is not; one with another knot there has a T-junction."""
    usd()
    plain = nurbs_usd()

    def beside(degree, knots, places):
        points = ", ".join(f"({u}, {v}, {2 * v * (u == 2)})" for v in places for u in (2, 3))
        return f"""
def NurbsPatch "beside"
{{
    point3f[] points = [{points}]
    int uVertexCount = 2
    int vVertexCount = {len(places)}
    int uOrder = 2
    int vOrder = {degree + 1}
    double[] uKnots = [0, 0, 1, 1]
    double[] vKnots = {knots}
}}
"""

    third = np.arange(10) / 3.0
    raised = beside(3, [0, 0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 3, 3, 3], third.tolist())
    scene = load(write(tmp_path, "a.usda", plain + raised))
    assert scene.patches().shape == (6, 3, 4, 3)
    shared = scene.edge_numbers
    assert [shared[k, 2] == shared[k + 3, 0] for k in range(3)] == [True] * 3
    assert not coincident_sides(scene.patches(), shared).any()
    halved = beside(1, [0, 0, 0.5, 1, 2, 3, 3], [0, 0.5, 1, 2, 3])
    scene = load(write(tmp_path, "b.usda", plain + halved))
    found = coincident_sides(scene.patches(), scene.edge_numbers)
    assert np.argwhere(found).tolist() == [[0, 2], [3, 0], [4, 0]]


@pytest.mark.parametrize("weld", [-1e-6, np.nan, np.inf, True, "wide", [1e-6]])
def test_bad_tolerances(path, weld):
    with pytest.raises(InputError, match="weld must be a number of at least 0"):
        load(path, weld=weld)


def test_places_too_far_out_for_small_weights(tmp_path):
    text = as_bv([np.array([[[1e90, y, 0.5, 1e-250] for y in (0.0, 1.0)] for _ in (0, 1)])], "{!r}")
    with pytest.raises(InputError, match=r"coordinates of 1e\+100 and more"):
        load(write(tmp_path, "a.bv", text))


def test_where_welding_has_no_meaning(tmp_path):
    with pytest.raises(InputError, match="a control mesh and nothing else: weld has no meaning"):
        load(write(tmp_path, "a.obj", CUBE), weld=0.1)
    with pytest.raises(InputError, match="weld has no meaning"):
        load("teapot", weld=0)


@pytest.mark.parametrize(
    ("name", "wanted"),
    [("teapot.bpt", [0, 24, 52]), ("rational_torus.bv", [0, 0, 16]), ("usd_bendy_nurbs.usda", [0, 12, 66])],
)
def test_models_stay_as_they_are(models, name, wanted):
    """None has twins that digits parted; the teapot's free sides are 16, and 8 points."""
    if name.endswith("usda"):
        usd()
    scene = load(models / name)
    assert uses(scene) == wanted
    assert not any("welded" in note for note in scene.notes)
    assert np.array_equal(scene.patches(), load(models / name, weld=0).patches())
