"""Sides of drawn triangles, pixel by pixel, beside the triangles that the tessellator says it made."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from scipy.spatial import KDTree

from slefejax import Camera, View, load, tessellation_factors, with_pieces
from slefejax.experiments.looks.wire import lines
from slefejax.gpu import Renderer
from tests.test_gpu import above, random_levels

pytestmark = pytest.mark.gl

ROUNDED = 2e-3  # pixels: float32 of places up to some hundred pixels, and a few operations


def square(height=0.0, size=1.0, at=(0.0, 0.0)) -> np.ndarray:
    """A flat patch, from its corner at x, y."""
    x, y = at
    corners = [[[x, y, height], [x, y + size, height]], [[x + size, y, height], [x + size, y + size, height]]]
    return np.array([corners], float)


def drawn(device, patches, view, inner, outer, **options) -> tuple[Any, Any]:
    renderer = Renderer(patches, device, wire=True, **options)
    seen, made = renderer.draw(view, inner, outer), renderer.capture(view, inner, outer)
    renderer.release()
    return seen, made


def on_screen(made, view) -> np.ndarray:
    """Corners ``(triangles, 3, 3)``: pixels, and window depth; float64."""
    clip = made.clip.astype(np.float64)
    ndc = clip[..., :3] / clip[..., 3:]
    return (ndc + 1.0) * [0.5 * view.width, 0.5 * view.height, 0.5]


def to_sides(points, triangles) -> np.ndarray:
    """From points ``(n, 2)`` to the nearest side of one triangle each ``(n, 3, 2)``."""
    found = np.full(len(points), np.inf)
    for k in range(3):
        a, b = triangles[:, k], triangles[:, (k + 1) % 3]
        along = b - a
        length = np.maximum(np.sum(along**2, axis=1), 1e-300)
        t = np.clip(np.sum((points - a) * along, axis=1) / length, 0.0, 1.0)
        found = np.minimum(found, np.linalg.norm(points - a - t[:, None] * along, axis=1))
    return found


def areas(triangles) -> np.ndarray:
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    return 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])


def owners(seen, made) -> tuple[np.ndarray, np.ndarray]:
    """Pixels ``(n, 2)``, row and column, and the triangles in whose inside their parameters lie, well away from sides.

    Of a pixel's patch the triangles with the nearest middles are looked at.
    """
    pixels, which = [], []
    for patch in np.unique(seen.patch[seen.patch >= 0]):
        own, at = np.flatnonzero(made.patch == patch), np.argwhere(seen.patch == patch)
        place = np.stack([seen.u[tuple(at.T)], seen.v[tuple(at.T)]], axis=1).astype(np.float64)
        corners = made.parameters[own].astype(np.float64)
        _, near = KDTree(corners.mean(axis=1)).query(place, k=min(8, len(own)))
        near = np.asarray(near).reshape(len(at), -1)
        matrix = np.concatenate([np.ones((len(own), 3, 1)), corners], axis=2).transpose(0, 2, 1)
        shares = (np.linalg.inv(matrix)[near] @ np.insert(place, 0, 1.0, axis=1)[:, None, :, None])[..., 0].min(axis=2)
        inside = shares.max(axis=1) > 1e-3
        pixels.append(at[inside])
        which.append(own[near[inside, shares[inside].argmax(axis=1)]])
    return np.concatenate(pixels), np.concatenate(which)


def check_sides(seen, made, view) -> None:
    """Every pixel knows the nearest point of its own triangle's sides, and the triangle's area."""
    screen = on_screen(made, view)[..., :2]
    at, which = owners(seen, made)
    assert len(at) > 0.9 * np.count_nonzero(seen.patch >= 0)
    rows = tuple(at.T)
    centre, edge = at[:, ::-1] + 0.5, seen.edge[rows].astype(np.float64)
    length = np.linalg.norm(edge, axis=1)
    wrong = ~np.isclose(length, to_sides(centre, screen[which]), rtol=0, atol=ROUNDED)
    wrong |= to_sides(centre + edge, screen[which]) > ROUNDED
    wrong |= ~np.isclose(seen.area[rows], areas(screen[which]), rtol=ROUNDED, atol=ROUNDED)
    # parameters that were rounded, or beside a triangle seen edge on, may lie in a much smaller neighbour
    assert wrong.mean() < 5e-4


def check_lines(seen, made, view) -> None:
    """Lines lie along sides of captured triangles, and all of these that are seen have one."""
    found, screen = lines(seen), on_screen(made, view)
    ends = np.concatenate([screen[:, [k, (k + 1) % 3]] for k in range(3)])
    t = np.linspace(0.0, 1.0, 2 + int(2 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max()))[:, None]
    points = ends[:, :1] + t * (ends[:, 1:] - ends[:, :1])
    patch = np.repeat(np.tile(made.patch, 3)[:, None], len(t), axis=1)
    shown = np.all((points[..., :2] >= 1) & (points[..., :2] < [view.width - 1, view.height - 1]), axis=2)
    points, patch = points[shown], patch[shown]
    apart, _ = KDTree(points[:, :2]).query(np.argwhere(found[2:-2, 2:-2] > 0)[:, ::-1] + 2.5)
    # a line reaches one pixel to either side, and points of a side are half a pixel apart; across an outline a line
    # goes straight on where the side that gave it ends
    assert np.quantile(apart, 0.999) < 1.05
    assert apart.max() < 1.8
    # seen without doubt: the pixel and all around show the side's patch, which has about one depth there
    column, row = points[:, :2].astype(int).T
    steps = [(i, j) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    depth = np.stack([seen.depth[row + i, column + j] for i, j in steps])
    own = np.all([seen.patch[row + i, column + j] == patch for i, j in steps], axis=0)
    own &= np.ptp(depth, axis=0) < 0.05 * np.ptp(seen.depth[seen.patch >= 0]) + 1e-6
    own &= np.abs(points[:, 2] - seen.depth[row, column]) <= np.ptp(depth, axis=0) + 1e-6
    assert own.sum() > 1000
    # half a diagonal of a pixel away at most, where lines still cover .29
    assert found[row, column][own].min() > 0.25


@pytest.mark.parametrize("spacing", ["equal", pytest.param("fractional-odd", marks=pytest.mark.slow)])
def test_lines_are_sides_of_captured_triangles(device, rng, teapot, spacing):
    view = View(teapot.default_camera(), 240, 150)
    inner, outer = random_levels(rng, teapot.patches(), 2, 12)
    if spacing != "equal":
        inner, outer = inner + 0.3, outer + 0.3
    seen, made = drawn(device, teapot.patches(), view, inner, outer, spacing=spacing)
    check_sides(seen, made, view)
    check_lines(seen, made, view)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "options"), [("suzanne.obj", {"scheme": "gregory"}), ("rational_torus.bv", {}), ("fox.glb", {})]
)
def test_lines_of_models(device, models, name, options):
    scene = load(models / name, **options)
    view = View(scene.default_camera(), 320, 200)
    factors = tessellation_factors(scene.patches(), view, edge_numbers=scene.edge_numbers)
    seen, made = drawn(device, scene.patches(), view, factors.inner, factors.edges)
    check_sides(seen, made, view)
    check_lines(seen, made, view)


def test_lines_of_patches_in_pieces(device):
    """Level 160 of a square much larger than the picture."""
    levels = with_pieces(np.full((1, 2), 160), np.full((1, 4), 160), np.arange(4)[None])
    view = above(height=0.213, size=128)
    seen, made = drawn(device, square(at=(-0.4713, -0.5237)), view, *levels)
    check_sides(seen, made, view)
    check_lines(seen, made, view)


def test_lines_are_as_wide_everywhere(device):
    """Across upright lines, what is covered adds up to a pixel: inside, at outlines, before and behind other things."""
    view = above(height=2.0, size=64)
    patches = np.concatenate([square(0.0, 1.63, (-0.81, -0.79)), square(0.5, 0.7, (-0.33, -0.31))])
    levels = np.array([[1] * 6, [2] * 6])
    seen, _ = drawn(device, patches, view, levels[:, :2], levels[:, 2:])
    row = lines(seen)[32 + 4]  # through the front one, away from its middle, where diagonals are
    x = np.arange(64) + 0.5
    for place in (-0.81, 0.82, -0.33, 0.02, 0.37):
        near = np.abs(x - (32 + 32 * place)) < 1.0
        assert row[near].sum() == pytest.approx(1.0, abs=0.02), place
    front = seen.patch == 1
    inside = front & np.roll(front, 2, 0) & np.roll(front, -2, 0) & np.roll(front, 2, 1) & np.roll(front, -2, 1)
    alone, _ = drawn(device, patches[1:], view, levels[1:, :2], levels[1:, 2:])
    # float32 relative to another box
    np.testing.assert_allclose(
        lines(seen)[inside], lines(alone)[inside], atol=1e-5, err_msg="hidden lines leave a trace"
    )


def test_hidden_sides_are_not_given_away(device):
    """A side that lies a pixel within the outline of what hides it: pixels beside know it, those in front must not."""
    view = above(height=2.0, size=64)
    front, hidden = (19.6 - 32) / 32, (20.6 - 32) / 32
    patches = np.concatenate([square(0.0, hidden + 0.9, (-0.9, -0.3)), square(0.5, 0.7, (front, -0.31))])
    ones = np.ones((2, 6), int)
    seen, _ = drawn(device, patches, view, ones[:, :2], ones[:, 2:])
    assert seen.patch[36, [19, 20]].tolist() == [0, 1]
    assert seen.edge[36, 19].tolist() == pytest.approx([1.1, 0.0], abs=ROUNDED)
    # the outline is .1 and .9 px away, the hidden side .1 from the second
    assert lines(seen)[36, [19, 20]].tolist() == pytest.approx([0.9, 0.1], abs=ROUNDED)


def test_sides_cost_nothing_unless_they_are_asked_for(device, teapot, main_view):
    levels = np.full((32, 6), 7)
    view = View(main_view.camera, 180, 120)
    plain, wired = (Renderer(teapot.patches(), device, wire=wire, normals=True) for wire in (False, True))
    without, beside = (own.draw(view, levels[:, :2], levels[:, 2:]) for own in (plain, wired))
    assert without.edge is None
    assert without.area is None
    assert [len(own._framebuffer(view).color_attachments) for own in (plain, wired)] == [3, 4]
    for name in ("u", "v", "patch", "depth", "drawn", "normal"):
        assert np.array_equal(getattr(without, name), getattr(beside, name), equal_nan=True), name
    assert beside.edge is not None
    assert beside.area is not None
    assert np.isnan(beside.edge[beside.patch < 0]).all()
    assert np.isnan(beside.area[beside.patch < 0]).all()
    assert np.isfinite(beside.edge[beside.patch >= 0]).all()


def test_triangles_that_reach_behind_the_camera(device):
    """A floor below the camera: sides end, and areas too, at the near plane."""
    floor = 40.0 * (square()[0] - [0.5, 0.5, 0.0])[None]
    view = View(Camera.look_at((0.3, -3.0, 1.0), (0.0, 9.0, 0.7), near=0.5, far=90.0), 160, 100)
    ones = np.ones((1, 6), int)
    seen, made = drawn(device, floor, view, ones[:, :2], ones[:, 2:])
    assert (made.clip[..., 3] < 0).any()
    at, which = owners(seen, made)
    near, centre = made.clip.astype(np.float64), at[:, ::-1] + 0.5
    polygons = [beyond_near(near[k]) @ np.diag([80.0, 50.0]) + [80.0, 50.0] for k in range(2)]
    for k, polygon in enumerate(polygons):
        rows = tuple(at[which == k].T)
        if rows[0].size:
            x, y = polygon.T
            area = 0.5 * abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1)))
            np.testing.assert_allclose(seen.area[rows], area, rtol=1e-4)
    length = np.linalg.norm(seen.edge[tuple(at.T)].astype(float), axis=1)
    for k, corners in enumerate(near):
        sides = [part for part in map(cut, corners, np.roll(corners, -1, axis=0)) if part is not None]
        ends = np.array(sides) * [80.0, 50.0] + [80.0, 50.0]
        own = centre[which == k]
        apart = [to_sides(own, np.broadcast_to(side[[0, 1, 1]], (len(own), 3, 2))) for side in ends]
        np.testing.assert_allclose(length[which == k], np.min(apart, axis=0), rtol=1e-4, atol=ROUNDED)


def cut(first, second) -> np.ndarray | None:
    """X/W, Y/W of both ends of what of a side lies beyond the near plane; None for nothing."""
    behind = [own[2] < -own[3] for own in (first, second)]
    if all(behind):
        return None
    t = (first[2] + first[3]) / (first[2] + first[3] - second[2] - second[3]) if any(behind) else 0.0
    on_plane = first + t * (second - first)
    ends = np.array([on_plane if hidden else own for own, hidden in zip((first, second), behind, strict=True)])
    return ends[:, :2] / ends[:, 3:]


def beyond_near(corners) -> np.ndarray:
    """The polygon ``(3 or 4, 2)`` of X/W, Y/W of what of a triangle lies beyond the near plane."""
    found = []
    for own, after in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        if own[2] >= -own[3]:
            found.append(own)
        if (own[2] >= -own[3]) != (after[2] >= -after[3]):
            t = (own[2] + own[3]) / (own[2] + own[3] - after[2] - after[3])
            found.append(own + t * (after - own))
    found = np.array(found)
    return found[:, :2] / found[:, 3:]
