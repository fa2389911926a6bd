"""Levels as they are returned: every triangle that will be drawn keeps the tolerance, whatever was raised or cut."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from slefejax import Camera, InputError, View, sampled_error, tessellation_factors, triangle_error, triangulate
from slefejax.tessellator.levels import pieces_along
from slefejax.tessellator.rings import Pattern
from tests.test_drawn import flat_on, quadratics

KINDS = ("saddles", "quadratics", "cubics")


def scene(seed: int, kind: str, tolerance: float) -> tuple[np.ndarray, View, np.ndarray]:
    """Patches of factors 1 to 200, the view, and edge numbers by which sides have the levels of others.

    saddles    : x = a u^2/2 + b u v - a v^2/2, each with a factor just below 64 and one neighbour that is beyond
    quadratics : whatever their signs
    cubics     : in perspective
    """
    rng, count = np.random.default_rng(seed), 6
    numbers = rng.permutation(4 * count).reshape(count, 4) // 2
    if kind == "cubics":
        t = np.linspace(-1, 1, 4)
        patches = np.zeros((count, 4, 4, 3))
        patches[..., 0], patches[..., 1] = t[:, None], t
        patches += rng.normal(size=patches.shape) * np.exp(rng.uniform(np.log(0.003), 0.0, (count, 1, 1, 1)))
        view = View(Camera.look_at((0.6, -2.5, 2.0), (0, 0, 0), near=0.3, fov_y=60.0), 1200, 900)
        return patches, View(view.camera, *(int(size * 0.7 * tolerance + 1) for size in (2400, 1800))), numbers
    a, b, c = rng.normal(size=(3, count))
    factor = np.exp(rng.uniform(0.0, np.log(200.0), count))
    if kind == "saddles":
        b, c = a * rng.uniform(0.4, 0.6, count) * rng.choice([-1, 1], count), -a
        factor = np.where(np.arange(count) < 3, rng.uniform(61.0, 63.9, count), rng.uniform(70.0, 150.0, count))
        numbers = np.arange(4 * count).reshape(count, 4)
        numbers[3:, 1] = numbers[:3, 1]
    scale = 8.0 * tolerance * factor**2 / np.maximum(np.maximum(abs(a), abs(c)), abs(a + c) + 2 * abs(b))
    patches = quadratics(a * scale, b * scale, c * scale)
    return patches, flat_on(float(2 * np.ceil(np.abs(patches[..., 0]).max()) + 100)), numbers


def worst(seed: int, kind: str, tolerance: float, **options: Any) -> float:
    """The largest error of the triangles as drawn, over the tolerance."""
    patches, view, numbers = scene(seed, kind, tolerance)
    factors = tessellation_factors(patches, view, tolerance=tolerance, edge_numbers=numbers, **options)
    return triangle_error(patches, triangulate(patches, factors), view).max() / tolerance


def setting(seed: int) -> dict[str, Any]:
    rng = np.random.default_rng(1000 + seed)
    return {
        "tolerance": float(np.exp(rng.uniform(np.log(0.05), np.log(2.0)))),
        "tiles": int(rng.choice([1, 2, 4])),
        "verify": bool(rng.random() < 0.4),
        "anisotropic": bool(rng.random() < 0.4),
    }


@pytest.mark.parametrize("seed", [3, *(pytest.param(x, marks=pytest.mark.slow) for x in (0, 5))])
@pytest.mark.parametrize(
    ("verify", "anisotropic"), [(False, False), pytest.param(True, False, marks=pytest.mark.slow), (False, True)]
)
def test_saddles_just_below_64_beside_patches_beyond(seed, verify, anisotropic):
    assert worst(seed, "saddles", 0.05, tiles=1, verify=verify, anisotropic=anisotropic) <= 1.0


@pytest.mark.slow
@pytest.mark.parametrize("first", range(0, 200, 20))
def test_two_hundred_scenes(first):
    """Neighbours of factors 1 to 200, every setting, tolerances .05 to 2 pixels."""
    for seed in range(first, first + 20):
        assert worst(seed, KINDS[seed % 3], **setting(seed)) <= 1.0, (seed, KINDS[seed % 3], setting(seed))


def test_these_scenes_break_levels_that_are_not_proved_last(monkeypatch):
    """A saddle for which 64 along u and v is enough is raised along one of them alone."""
    monkeypatch.setattr(
        "slefejax.predict.drawn.levels.proved_levels", lambda certificate, inner, edges, *_: (inner, edges)
    )
    assert max(worst(seed, "saddles", 0.05, tiles=1) for seed in range(6)) > 1.1


def test_neighbours_in_thirty_three_pieces():
    """A flat patch beside one of level 2,090 is raised with its edge; so is a saddle that (64, 64) is enough for."""
    a = 64**2 * 4 * 0.98
    patches = quadratics([a, 4 * 2100.0**2 * 0.99, 0.01], [a / 2, 0.0, 0.0], [-a, 0.0, 0.0])
    numbers = np.arange(12).reshape(3, 4)
    numbers[0, 1] = numbers[1, 1] = numbers[2, 3]
    view = flat_on(float(2 * np.ceil(np.abs(patches[..., 0]).max()) + 100))
    factors = tessellation_factors(patches, view, tiles=1, edge_numbers=numbers)
    assert factors.levels.tolist() == [64, 2090, 1]
    assert factors.edges[0, 1] == factors.edges[1, 1] == factors.edges[2, 3] >= 2090
    own = [0, 2]
    made = triangulate(patches[own], (factors.inner[own], factors.edges[own]))
    assert triangle_error(patches[own], made, view).max() <= 0.5


@pytest.mark.slow
def test_levels_stay_as_chosen_where_they_are_proved(teapot, main_view, monkeypatch):
    """On the teapot, whose levels are all below 64, nothing is raised in the end."""
    found = tessellation_factors(teapot.patches(), main_view, tiles=1, edge_numbers=teapot.edge_numbers)
    inner, edges = found.inner, found.edges
    monkeypatch.setattr(
        "slefejax.predict.drawn.levels.proved_levels", lambda certificate, inner, edges, *_: (inner, edges)
    )
    again = tessellation_factors(teapot.patches(), main_view, tiles=1, edge_numbers=teapot.edge_numbers)
    assert np.array_equal(again.inner, inner)
    assert np.array_equal(again.edges, edges)


def test_proofs_know_where_lines_are_in_a_picture_with_pieces(monkeypatch):
    """One patch past 64 beside one that is proved cell by cell: its grid is looked at with the lines of 24 bits."""
    asked = []

    lines = Pattern.lines

    def seen(pattern, in_pieces):
        asked.append(in_pieces)
        return lines(pattern, in_pieces)

    monkeypatch.setattr(Pattern, "lines", seen)
    a = 4 * 20.4**2
    patches = quadratics([a, 4 * 150.0**2], [0.3 * a, 0.0], [0.9 * a, 0.0])
    view = flat_on(float(2 * np.ceil(np.abs(patches[..., 0]).max()) + 100))
    for count, expected in ((1, {False}), (2, {False, True})):
        asked.clear()
        factors = tessellation_factors(patches[:count], view, tiles=1, verify=True)
        assert sampled_error(patches[:count], factors.inner, view).max() <= 0.5
        assert np.any(pieces_along(factors.inner, factors.edges) > 1) == (count == 2)
        assert set(asked) == expected


def test_past_what_can_be_drawn_a_patch_is_named():
    patches = quadratics([1.0, 4 * 17000.0**2], 0.0, 0.0)
    factors = tessellation_factors(patches, flat_on(2e9), tiles=1)
    with pytest.raises(
        InputError, match=r"patch 1 \(counted from 0\) needs a level of 17\d\d\d, and 16384 is the most"
    ):
        _ = factors.inner
    assert tessellation_factors(patches, flat_on(2e9), tiles=1, tolerance=1.0).edges.max() <= 16384


def test_scaled_levels_are_what_was_asked_for():
    """Half of the levels that are proved are not proved, and nothing raises them."""
    patches, view, numbers = scene(3, "saddles", 0.5)
    factors = tessellation_factors(patches, view, tiles=1, edge_numbers=numbers)
    scaled = factors.scaled(0.5)
    assert triangle_error(patches, triangulate(patches, scaled), view).max() > 0.6
    assert np.all(scaled.edges < factors.edges)
    assert np.all(scaled.inner < factors.inner)
