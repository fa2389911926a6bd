"""What is drawn on the sides of patches: points of the owner's curve, whoever draws them."""

from __future__ import annotations

import numpy as np
import pytest

from slefejax import Camera, InputError, View, load, tessellation_factors, triangle_error, with_pieces
from slefejax.geometry.bezier import evaluate_curve, evaluate_patch
from slefejax.tessellator.edges import Sides, edge_maxima, shared_edges
from slefejax.tessellator.levels import segments
from tests.mixed import as_bv, boundaries, cube_sphere, in_perspective, open_edges
from tests.test_edges import SYMMETRIES
from tests.test_io import write

pytestmark = pytest.mark.gl
EYE = np.array([4.5, -6.0, 4.0])
WHOLE = View(Camera.look_at(EYE, (0, 0, 0)), 320, 200)


@pytest.fixture(scope="module")
def scenes(tmp_path_factory):
    """The closed surface of mixed degrees, polynomial and rational, loaded."""
    place = tmp_path_factory.mktemp("mixed")
    raw = cube_sphere(np.random.default_rng(5))
    plain = load(write(place, "mixed.bv", as_bv(raw)))
    return {"polynomial": plain, "rational": load(write(place, "r.bv", as_bv([in_perspective(p) for p in raw])))}


def some_levels(numbers, choices, rng):
    """The patches' own levels among some, their edges' the largest, in whole pieces."""
    inner = np.repeat(rng.choice(choices, len(numbers))[:, None], 2, axis=1)
    return with_pieces(inner, edge_maxima(inner[:, 0], numbers), numbers)


@pytest.mark.parametrize(
    ("kind", "dtype", "choices"),
    [
        ("polynomial", np.float64, (1, 2, 7, 33)),
        ("polynomial", np.float32, (1, 2, 7, 33)),
        ("rational", np.float64, (1, 2, 7, 33)),
        ("polynomial", np.float64, (5, 60, 70)),
        ("rational", np.float32, (5, 60, 70)),
        ("polynomial", np.float64, (66, 130)),
    ],
)
def test_neighbours_have_the_same_vertices(device, scenes, rng, kind, dtype, choices):
    """Bit for bit, below, across and past 64: on every curve, in every corner, and no triangle's edge stays open."""
    from slefejax.gpu import Renderer

    patches, numbers = scenes[kind].patches().astype(dtype), scenes[kind].edge_numbers
    inner, outer = some_levels(numbers, choices, rng)
    renderer = Renderer(patches, device)
    found = renderer.capture(WHOLE, inner, outer)
    renderer.release()
    drawn = boundaries(found, numbers)
    assert len(drawn) == 48
    for number, (one, other) in drawn.items():
        assert len(one) == outer[numbers == number][0] + 1
        assert np.array_equal(one, other)
    corners = found.clip[np.all(np.isin(found.parameters, (0.0, 1.0)), axis=-1)]
    assert len(np.unique(corners, axis=0)) == 26  # of a closed surface of 24 quads
    assert open_edges(found) == 0


@pytest.mark.parametrize("spacing", ["fractional-even", "fractional-odd"])
def test_neighbours_have_the_same_vertices_with_fractional_spacing(device, scenes, rng, spacing):
    from slefejax.gpu import Renderer

    patches, numbers = scenes["polynomial"].patches(), scenes["polynomial"].edge_numbers
    outer = rng.uniform(1.0, 30.0, 48)[numbers]
    renderer = Renderer(patches, device, spacing)
    found = renderer.capture(WHOLE, rng.uniform(2.0, 30.0, (24, 2)), outer)
    renderer.release()
    for number, (one, other) in boundaries(found, numbers).items():
        assert len(one) == segments(outer[numbers == number], spacing)[0] + 1
        assert np.array_equal(one, other)


@pytest.mark.slow
def test_no_pixel_shows_the_far_side(device, scenes, tmp_path):
    """Through a closed surface nothing behind it is seen; levels keep the tolerance; unwelded there are holes."""
    from slefejax.gpu import Renderer

    view = View(Camera.look_at(EYE, (0, 0, 0), fov_y=16.0), 720, 450)
    old = load(write(tmp_path, "mixed.bv", as_bv(cube_sphere(np.random.default_rng(5)))), weld=0)
    far = []
    for scene in (scenes["polynomial"], old):
        patches = scene.patches()
        factors = tessellation_factors(patches, view, tiles=1, edge_numbers=scene.edge_numbers)
        renderer = Renderer(patches, device)
        seen = renderer.draw(view, factors.inner, factors.edges)
        shown = seen.patch >= 0
        control = np.moveaxis(patches, 0, -1)[..., seen.patch[shown]]
        points = evaluate_patch(control, seen.u[shown].astype(float), seen.v[shown].astype(float))
        # the surface is within a tenth of the unit sphere: what is in front is nearer than the silhouette
        far.append(int(np.sum(EYE @ points / np.linalg.norm(EYE) < -0.3)))
        if not far[1:]:
            found = renderer.capture(view, factors.inner, factors.edges)
            assert triangle_error(patches, found, view).max() <= 0.5
        renderer.release()
    assert far[0] == 0
    assert far[1] > 0, "the view shows where twins differ"


@pytest.mark.parametrize("way", SYMMETRIES)
def test_parts_of_a_side(device, rng, way):
    """Sides that are halves of a neighbour's are drawn on its curve, whichever way they lie: as T-junctions will be."""
    from slefejax.gpu import Renderer

    patches = rng.normal(size=(3, 4, 4, 3))
    patches[1] = SYMMETRIES[way](patches[1])
    side = int(rng.integers(4))
    sides = Sides.of(patches)
    halves = ((1, 0.5, 0.0), (2, 0.5, 1.0))
    for patch, first, last in halves:
        sides.owner[patch, side], sides.first[patch, side], sides.last[patch, side] = 2, first, last
    assert len(np.unique(sides.numbers)) == 12, "parts of a curve are no whole sides of it"
    levels = np.full((3, 6), 8)
    renderer = Renderer(patches, device, sides=sides)
    found = renderer.capture(WHOLE, levels[:, :2], levels[:, 2:])
    renderer.release()
    curve = patches[0, -1].astype(np.float32).astype(float)
    drawn = boundaries(found, np.arange(12).reshape(3, 4))
    for patch, first, last in halves:
        t = np.linspace(first, last, 9)
        points = evaluate_curve(curve[..., None], t)
        wanted = np.concatenate([points, np.ones((1, 9))]).T @ WHOLE.world_to_clip.T
        (own,) = drawn[4 * patch + side]
        own = own[np.argsort(own[:, 0])]
        # a few dozen float32 operations on numbers up to about ten
        np.testing.assert_allclose(own, wanted[np.argsort(wanted[:, 0])], rtol=0, atol=3e-5)


def test_sides_of_other_patches_are_refused(device, rng):
    from slefejax.gpu import Renderer

    patches = rng.normal(size=(2, 3, 4, 3))
    with pytest.raises(InputError, match=r"sides must be those of 2 patches, \(2, 4\), not \(1, 4\)"):
        Renderer(patches, device, sides=Sides.of(patches[:1]))
    sides = Sides.of(patches)
    sides.owner[0, 0] = 8
    with pytest.raises(InputError, match="must be parts, from 0 to 1, of sides of these patches"):
        Renderer(patches, device, sides=sides)


def test_patches_that_move_are_looked_at_again(device, scenes, rng):
    """Others with the same number of patches, whose sides are others'."""
    from slefejax.gpu import Renderer

    patches = scenes["polynomial"].patches()
    moved = np.roll(patches, 1, axis=0)[:, ::-1]
    numbers = shared_edges(moved)
    renderer = Renderer(patches, device)
    renderer.move(moved)
    inner, outer = some_levels(numbers, (3, 9, 14), rng)
    found = renderer.capture(WHOLE, inner, outer)
    renderer.release()
    assert all(np.array_equal(one, other) for one, other in boundaries(found, numbers).values())
