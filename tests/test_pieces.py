"""Patches that need more than the tessellator's 64, drawn in pieces."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slefejax import (
    Camera,
    InputError,
    View,
    sampled_error,
    tessellation_factors,
    triangle_error,
    with_pieces,
)
from slefejax.measure.error import drawn_error
from slefejax.tessellator.edges import edge_maxima, shared_edges
from slefejax.tessellator.levels import (
    HIGHEST_LEVEL,
    MOST_LEVEL,
    OWN_AXIS,
    Pieces,
    pieces,
    pieces_along,
    triangle_counts,
)
from slefejax.tessellator.rings import Pattern, direct3d11, ringed_sides, with_better_rings
from tests.test_gpu import above, lattice, open_edges

CORNER = (3.3, 0.0, 2.4)  # of the teapot's rim: four patches meet


def strip(side: int) -> np.ndarray:
    """Numbers of the edges of side x side patches, each one beside the next."""
    x, y = np.meshgrid(np.arange(side + 1.0), np.arange(side + 1.0), indexing="ij")
    net = np.stack([x, y, 0.0 * x], axis=-1)
    return shared_edges(np.array([net[i : i + 2, j : j + 2] for i in range(side) for j in range(side)]))


def some_levels(seed: int, highest: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random ones of nine patches, some of them up to the highest, some not drawn."""
    rng, numbers = np.random.default_rng(seed), strip(3)
    inner = rng.integers(1, 12, (9, 2)) * np.where(rng.random((9, 2)) < 0.3, highest // 12, 1)
    level = np.maximum(1, rng.integers(0, 2, numbers.max() + 1) * rng.integers(1, highest, numbers.max() + 1))
    outer = level[numbers]
    unseen = rng.random(9) < 0.2
    inner[unseen], outer[unseen] = 0, 0
    return inner, outer, numbers


def test_numbers_of_pieces():
    levels = np.arange(0, 3000)
    found = pieces(levels)
    assert np.all(levels <= HIGHEST_LEVEL * found)
    assert np.all((found == 1) | (levels > HIGHEST_LEVEL * (found // 2)))
    assert set(np.unique(found)) == {2**k for k in range(7)}
    assert pieces(np.array([MOST_LEVEL, MOST_LEVEL + 1])).tolist() == [256, 512]


@given(st.integers(0, 10**6), st.sampled_from([40, 130, 700, 5000]))
def test_levels_of_pieces(seed, highest):
    """Raised to what pieces can have, by less than a piece's worth, equal on shared edges, and once is enough."""
    inner, outer, numbers = some_levels(seed, highest)
    own, edges = with_pieces(inner, outer, numbers)
    along = pieces_along(own, edges)
    if highest <= HIGHEST_LEVEL**2:
        assert np.array_equal(along, pieces_along(inner, outer)), "rounding up needs no more pieces"
    assert np.all(own % along == 0)
    assert np.all(edges % along[:, OWN_AXIS] == 0)
    assert np.all(own >= inner)
    assert np.all(edges >= outer)
    assert np.all((own < inner + along) | (own == 2 * along))
    assert np.all(edges < outer + along.max())
    for number in range(numbers.max() + 1):
        assert len(set(edges[(numbers == number) & (edges > 0)].tolist())) <= 1
    uncut = np.all(along == 1, axis=1)
    assert np.array_equal(own[uncut], inner[uncut])
    again = with_pieces(own, edges, numbers)
    assert np.array_equal(again[0], own)
    assert np.array_equal(again[1], edges)


@given(st.integers(0, 10**6), st.sampled_from([40, 130, 700]))
def test_pieces_make_up_their_patches(seed, highest):
    inner, outer = with_pieces(*some_levels(seed, highest))
    parts = Pieces.of(inner, outer)
    assert max(parts.inner.max(), parts.outer.max()) <= HIGHEST_LEVEL
    counts = np.bincount(parts.patch, triangle_counts(parts.inner, parts.outer), minlength=9)
    assert np.array_equal(counts, triangle_counts(inner, outer))
    area = np.bincount(parts.patch, 1.0 / parts.along.prod(axis=1), minlength=9)
    assert np.all(area == 1.0)
    for axis in (0, 1):
        for side, end in ((1 - axis, 0), (3 - axis, 1)):
            # the edges u=0 and u=1 are those of the pieces that are the first or last along u
            across = 1 - axis
            on_rim = parts.place[:, across] == end * (parts.along[:, across] - 1)
            total = np.bincount(parts.patch[on_rim], parts.outer[on_rim, side], minlength=9)
            assert np.array_equal(total, outer[:, side])


def test_levels_that_are_no_multiples():
    with pytest.raises(InputError, match=r"those of patch 1 .* multiples of 4 along u and of 1 along v .* \[130, 3\]"):
        Pieces.of(np.array([[3, 3], [130, 3]]), np.array([[3] * 4, [3] * 4]))
    with pytest.raises(InputError, match="multiples"):
        triangle_counts(np.array([[3, 3]]), np.array([[3, 65, 3, 3]]))


def test_counts_of_what_are_no_levels():
    assert triangle_counts([[3, 3]], [[3, 3, 3, 3]]).tolist() == [18], "lists do"
    right = np.full((2, 2), 3), np.full((2, 4), 3)
    for inner, outer in ((right[1], right[0]), (right[0], right[1][:1]), (3, 3), (right[0][0], right[1][0])):
        with pytest.raises(InputError, match=r"levels must have shapes \(patches, 2\) and \(patches, 4\), not"):
            triangle_counts(inner, outer)
    with pytest.raises(InputError, match="levels must be real numbers"):
        triangle_counts([["a", "b"]], right[1][:1])
    with pytest.raises(InputError, match="levels must be numbers from 0 on"):
        triangle_counts(-right[0], right[1])
    with pytest.raises(InputError, match="there is no spacing 'even'"):
        triangle_counts(*right, spacing="even")


def raised(inner: np.ndarray, numbers: np.ndarray, pattern: Pattern, longest: np.ndarray):
    """Levels for which no ring's triangle is longer than that."""
    inner, edges = with_pieces(inner, edge_maxima(inner[:, 0], numbers), numbers)
    patch, side = np.nonzero(edges)
    while True:
        ringed, n, m, along = ringed_sides(inner, edges, patch, side)
        long = ringed & (n != m) & (pattern.reach[n, m] / along > longest[patch, side])
        if not long.any():
            return inner, edges
        inner, edges = with_better_rings(inner, edges, numbers, patch[long], side[long], pattern)


def test_rings_of_pieces(rng):
    """Levels raised past 64: on every side of every piece the pattern's ring is short enough, or part of the grid."""
    numbers, pattern = strip(3), direct3d11()
    for _ in range(40):
        inner = np.repeat(rng.integers(1, 400, (9, 1)), 2, axis=1)
        cells = 1.0 / inner.min(axis=1)
        longest = 1.5 * cells[:, None] * rng.uniform(0.7, 2.0, (9, 4))
        own, edges = raised(inner, numbers, pattern, longest)
        parts = Pieces.of(own, edges)
        assert np.all(own >= inner)
        for side in range(4):
            axis = OWN_AXIS[side]
            n, m = np.maximum(parts.inner[:, axis], 2), parts.outer[:, side]
            reach = pattern.reach[n, m] / parts.along[:, axis]
            rim = parts.place[:, 1 - axis] == (0 if side < 2 else parts.along[:, 1 - axis] - 1)
            plain = np.all(parts.inner == 1, axis=1) & np.all(parts.outer == 1, axis=1)
            assert np.all((reach <= longest[parts.patch, side]) | (n == m) | ~rim | plain)
            assert np.all((n == m) | rim | plain), "between pieces there is the grid"


@pytest.mark.gl
@pytest.mark.parametrize("degree", [1, pytest.param(3, marks=pytest.mark.slow)])
def test_pieces_meet_without_a_crack(device, rng, degree):
    """Patches of 1 to 300 cells beside each other: as many triangles as prescribed, no open edge, equal bits."""
    from slefejax.gpu import Renderer

    patches = lattice(rng, 3, degree)
    numbers = shared_edges(patches.astype(np.float32))
    inner = np.repeat(rng.choice([1, 5, 33, 70, 150, 300], 9)[:, None], 2, axis=1)
    inner, outer = with_pieces(inner, edge_maxima(inner[:, 0], numbers), numbers)
    assert outer.max() > 2 * HIGHEST_LEVEL
    wide = above(height=9.0)
    found = Renderer(patches, device).capture(wide, inner, outer)
    assert np.array_equal(np.bincount(found.patch, minlength=9), triangle_counts(inner, outer))
    rim = outer[np.bincount(numbers.ravel())[numbers] == 1].sum()
    assert open_edges(found, patches) == rim
    a, b, c = np.moveaxis(found.parameters.astype(float), 1, 0)
    first, second = b - a, c - a
    area = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    assert np.all(area > 0)
    np.testing.assert_allclose(np.bincount(found.patch, area), 1.0, rtol=0, atol=1e-9)
    # in pieces or not, vertices on an edge are at k/n
    for patch in range(9):
        u, v = np.moveaxis(found.parameters[found.patch == patch].astype(float), 2, 0)
        for place, on_side, n in ((v, u == 0, outer[patch, 0]), (u, v == 1, outer[patch, 3])):
            np.testing.assert_allclose(np.unique(place[on_side]), np.arange(n + 1) / n, rtol=0, atol=2.0**-24)
    seen = Renderer(patches, device).draw(above(), inner, outer)
    assert np.all(seen.patch >= 0), "no pixel is dropped"


def zoomed(fov: float, target: Any = CORNER) -> View:
    return View(Camera.look_at((4.5, -6.0, 4.0), target, fov_y=fov), 720, 450)


@pytest.mark.slow
@pytest.mark.gl
def test_a_teapot_zoomed_until_factors_pass_500(device, teapot):
    """Certified factors past 500 keep the tolerance, uniform, as drawn and in the picture; edges meet bit by bit."""
    from slefejax.gpu import Renderer

    view, patches = zoomed(0.04), teapot.patches()
    factors = tessellation_factors(patches, view, edge_numbers=teapot.edge_numbers)
    assert factors.levels.max() > 500
    inner, outer = factors.inner, factors.edges
    renderer = Renderer(patches, device)
    found = renderer.capture(view, inner, outer)
    assert len(found.patch) < 0.3 * triangle_counts(inner, outer).sum(), "pieces off the screen are left out"
    assert triangle_error(patches, found, view).max() <= 0.5
    assert sampled_error(patches, inner, view).max() <= 0.5
    seen = renderer.draw(view, inner, outer)
    assert np.nanmax(drawn_error(patches, view, seen)) <= 0.5
    # edges that are in the picture
    numbers, met = teapot.edge_numbers, 0
    w = found.clip[..., 3:]
    inside = np.all(np.abs(found.clip[..., :2]) < w, axis=-1)
    sides = [np.isin(found.parameters[..., axis], end) for end, axis in ((0.0, 0), (0.0, 1), (1.0, 0), (1.0, 1))]
    positions: dict[int, list[np.ndarray]] = {}
    for side, on_side in enumerate(sides):
        for patch in np.unique(found.patch):
            points = found.clip[on_side & inside & (found.patch == patch)[:, None]]
            if len(points):
                positions.setdefault(int(numbers[patch, side]), []).append(np.unique(points, axis=0))
    for meeting in positions.values():
        if len(meeting) == 2:
            assert np.array_equal(meeting[0], meeting[1])
            met += 1
    assert met >= 1


@pytest.mark.gl
@pytest.mark.parametrize("fov", [0.2, 0.05])
def test_a_zoomed_teapot_drops_no_pixel(device, teapot, fov):
    """The picture lies within the surface: every pixel is covered."""
    from slefejax.gpu import Renderer

    view = zoomed(fov, (2.8, 0.0, 2.4))
    renderer = Renderer(teapot.patches(), device)
    for method in ("certified", "slefe"):
        factors = tessellation_factors(teapot.patches(), view, method, edge_numbers=teapot.edge_numbers)
        assert factors.levels.max() > 2 * HIGHEST_LEVEL
        assert np.all(renderer.draw(view, factors.inner, factors.edges).patch >= 0)


@pytest.mark.gl
def test_past_what_can_be_drawn(device, rng):
    from slefejax.gpu import Renderer

    patches = lattice(rng, 1, 1)
    with pytest.raises(InputError, match=r"factor above 16384, the most that can be drawn .*16385"):
        Renderer(patches, device).draw(above(), np.full((1, 2), 3), np.full((1, 4), MOST_LEVEL + 1))
    with pytest.raises(InputError, match=r"factor above 64, the most that can be drawn .*65"):
        Renderer(patches, device, "fractional-even").draw(above(), np.full((1, 2), 65.0), np.full((1, 4), 3.0))
