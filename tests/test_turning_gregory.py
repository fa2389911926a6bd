"""Certified normals of Gregory patches: sampling finds nothing that errs more than their bounds tell."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import slefejax as sj
from slefejax import Camera, GregoryPatches, View, tessellation_factors
from slefejax.bounds.triangles import HalfCells
from slefejax.geometry.bezier import elevate, evaluate_patch
from slefejax.geometry.evaluate import as_control
from slefejax.geometry.gregory import QUAD_TWISTS, twist_slopes
from slefejax.geometry.normals import collapsed_sides
from slefejax.geometry.packed import pack
from slefejax.lanes.maxima import EXACT
from slefejax.predict.cells import Pictures, Turned, cell_errors, triangle_errors
from slefejax.predict.factors import shaded
from slefejax.predict.kernel import Prepared
from slefejax.predict.methods import Request
from slefejax.predict.normals.slopes import COARSEST, on_box, on_tiles, slope_sizes
from slefejax.predict.normals.spinning import Spinning, tile_tables
from slefejax.predict.normals.undivided import Surfaces

ABOVE = View(Camera.orthographic((0.0, 0.0, 50.0), (0.0, 0.0, 0.0), up=(0.0, 1.0, 0.0), height=40.0), 300, 300)
SLOTS = 6
KINDS = ["quads", pytest.param("triangles", marks=pytest.mark.slow)]


def patches_of(rng, kind, count, twist=0.1):
    """Wavy quads, or triangles that are pinched at u = 1, as bi-quartic nets; with twists of any direction."""
    x, y = np.meshgrid(np.linspace(-1, 1, 4), np.linspace(-1, 1, 4), indexing="ij")
    net = np.stack([x, y, 0 * x], axis=-1) + 0.15 * rng.normal(size=(count, 4, 4, 3))
    if kind == "quads":
        return GregoryPatches(net, twist * rng.normal(size=(count, 4, 3)))
    net[:, -1] = net[:, -1:, 0]
    raised = np.stack([elevate(elevate(own, 4).swapaxes(0, 1), 4).swapaxes(0, 1) for own in net])
    raised[:, -1] = raised[:, -1:, 0]
    twists = np.zeros((count, SLOTS, 3))
    twists[:, QUAD_TWISTS:] = twist * rng.normal(size=(count, 2, 3))
    return GregoryPatches(raised, twists)


def slopes(u, v):
    return np.moveaxis(np.array(twist_slopes(SLOTS, u, v, pinched=True)), 0, 1)  # (slots, 2, ...)


def normals(patches, k, u, v):
    """Of one patch, by derivatives of its net and of twist terms; over 1 - u where it is pinched there."""
    net, twists = np.asarray(patches.net[k]), np.asarray(patches.twists[k])
    u, degree = (np.minimum(u, 1 - 1e-7), 4) if len(net) == 5 else (u, 3)

    def evaluated(own):
        return np.moveaxis(evaluate_patch(own.reshape(*own.shape, *[1] * u.ndim), u, v), 0, -1)

    by_u, by_v = twist_slopes(len(twists), u, v)
    along_u = evaluated(degree * np.diff(net, axis=0)) + np.tensordot(np.array(by_u), twists, (0, 0))
    along_v = evaluated(degree * np.diff(net, axis=1)) + np.tensordot(np.array(by_v), twists, (0, 0))
    found = np.cross(along_u, along_v)
    return found / (1 - u)[..., None] if len(net) == 5 else found


def degrees_between(a, b):
    return np.rad2deg(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), np.sum(a * b, axis=-1)))


def on_cell(patches, k, low, high, places=13):
    t = np.linspace(0, 1, places)
    a, b = np.meshgrid(t, t, indexing="ij")
    exact = normals(patches, k, low[0] + a * (high[0] - low[0]), low[1] + b * (high[1] - low[1]))
    p, q, r, s = exact[0, 0], exact[-1, 0], exact[0, -1], exact[-1, -1]
    a, b = a[..., None], b[..., None]
    rising = np.where(a >= b, p + a * (q - p) + b * (s - q), p + b * (r - p) + a * (s - r))
    falling = np.where(a + b <= 1, p + a * (q - p) + b * (r - p), s + (1 - a) * (r - s) + (1 - b) * (q - s))
    return max(degrees_between(rising, exact).max(), degrees_between(falling, exact).max())


def pictured(patches):
    still = np.asarray(collapsed_sides(patches))

    def made(which):
        own = jax.tree.map(lambda x: np.moveaxis(np.asarray(x, float)[which], 0, -1), as_control(patches))
        return Turned(Surfaces(own, still[which].T).undivided(), np.deg2rad(1.0))

    return Pictures(made, len(patches))


def with_boxes(rng, kind, count=24):
    """Patches, and of each the corner and the extent of a box, a third of them at corners of the patch."""
    extent = rng.uniform(0.03, 0.12, (count, 2))
    low = rng.uniform(0, 1 - extent)
    low[::3] = rng.integers(0, 2, (len(low[::3]), 2)) * (1 - extent[::3])
    return patches_of(rng, kind, count), low, extent


def of_twists(patches, u, v):
    """What twists add to normals, ``(patches, ..., 3)``: the difference to those without."""
    plain = GregoryPatches(patches.net, np.zeros_like(patches.twists))
    every = range(len(patches.net))
    return np.stack([normals(patches, k, u, v) - normals(plain, k, u, v) for k in every])


def test_slopes_on_boxes_are_no_larger_than_is_told(rng):
    """Derivatives by differences, which are good to a few per mille here."""
    step = 1e-3
    for _ in range(40):
        low = rng.uniform(0.02, 0.7, 2)
        extent = rng.uniform(0.01, 0.25, 2)
        u, v = zip(low, low + extent, strict=True)
        told = np.array(slope_sizes(SLOTS, u, v, extent[0], extent[1]))  # (slots, 2, orders)
        place = low + rng.uniform(2 * step, 1 - 2 * step, (50, 2)) * extent
        along = rng.choice([-1, 1], (50, 2)) * extent
        near = [slopes(*(place + k * step * along).T) for k in (-2, -1, 0, 1, 2)]
        first, second = (near[3] - near[1]) / (2 * step), (near[3] - 2 * near[2] + near[1]) / step**2
        third = (near[4] - 2 * near[3] + 2 * near[1] - near[0]) / (2 * step**3)
        true = np.stack([np.abs(own).max(axis=-1) for own in (near[2], first, second, third)], axis=-1)
        assert np.all(true <= 1.005 * told)


def errors_near_corners(n, tiles):
    """Of the linear interpolation on n x n grids, of every cell: errors and what slopes change from there to corners
    ``(slots, 2, places)``, the tiles of places, and how large slopes are."""
    numbers = np.unique([0, 1, 2, 3, n // 3, n // 2, n - 2, n - 1])
    t = np.linspace(0, 1, 13)
    x, y = (own.ravel() for own in np.meshgrid(t, t, indexing="ij"))
    rising = 1 - np.maximum(x, y), np.maximum(x - y, 0), np.minimum(x, y), np.maximum(y - x, 0)
    falling = np.maximum(1 - x - y, 0), np.minimum(x, 1 - y), np.maximum(x + y - 1, 0), np.minimum(y, 1 - x)
    for i, j in [(i, j) for i in numbers for j in numbers if 0 <= i < n and 0 <= j < n]:
        u, v = np.minimum((i + x) / n, 1 - 1e-9), (j + y) / n
        ends = [slopes(np.minimum((i + a) / n, 1 - 1e-9), (j + b) / n) for a, b in ((0, 0), (1, 0), (1, 1), (0, 1))]
        tile = np.minimum(tiles * np.array([u, v]), tiles - 1).astype(int)
        for shares in (rising, falling):
            drawn = sum(k * end[..., None] for k, end in zip(shares, ends, strict=True))
            here = slopes(u, v)
            changed = np.max([np.abs(here - end[..., None]) for end in ends], axis=0)
            yield np.abs(here - drawn), changed, tile[0] * tiles + tile[1], np.abs(here)


@pytest.mark.parametrize("n", [1, 2, 5, 9, 33, 400])
def test_slopes_on_even_grids_err_no_more_than_tables_tell(n):
    """On cells at the corners, near to them, and elsewhere, for both diagonals; with fine ones almost as much."""
    table, most, steepest = on_tiles(SLOTS, 4, True), 0.0, 0.0
    fine = [k for k, coarsest in enumerate(COARSEST) if n >= coarsest]
    for error, changed, tile, size in errors_near_corners(n, 4):
        allowed = np.min((table.first / n + table.second / n**2)[:, fine], axis=1)
        assert np.all(error <= np.moveaxis(allowed[tile], 0, -1) + 1e-9)
        assert np.all(n * changed <= np.moveaxis(table.steep[:, fine].min(axis=1)[tile], 0, -1) + 1e-6)
        assert np.all(size <= np.moveaxis(table.size[tile], 0, -1) + 1e-9)
        most, steepest = (
            np.maximum(*own) for own in ((most, error.max(axis=-1)), (steepest, n * changed.max(axis=-1)))
        )
    if n > 100:
        assert np.all(most * n > 0.9 * table.first.max(axis=(0, 1)))
        assert np.all(steepest > 0.45 * table.steep.max(axis=(0, 1)))  # steps along u and along v may cancel


def test_quadratics_miss_slopes_by_no_more_than_is_told(rng):
    """On parts of cells and any triangles in boxes, a third of them at a corner."""
    shares = rng.dirichlet(np.ones(3), 300)
    basis = np.hstack([shares * (2 * shares - 1), 4 * shares * np.roll(shares, -1, axis=1)])
    halves = np.array([[[0, 0], [1, 0], [1, 1]], [[0, 0], [1, 1], [0, 1]], [[0, 0], [1, 0], [0, 1]]], float)
    a, b, c = np.moveaxis(halves, 1, 0)
    quarters = np.concatenate(
        [np.stack([a, (a + b) / 2, (a + c) / 2], 1), np.stack([(a + b) / 2, (b + c) / 2, (a + c) / 2], 1)]
    )
    for turn in range(60):
        extent = 2.0 ** -rng.uniform(0, 8, 2)
        low = np.where(turn % 3, rng.uniform(0, 1 - extent), rng.integers(0, 2, 2) * (1 - extent))
        cell = bool(turn % 2)
        triangles = quarters if cell else rng.integers(0, 9, (40, 3, 2)) / 8
        ends = ([jnp.asarray(x) for x in own] for own in (low, low + extent))
        told = on_box(SLOTS, next(ends), next(ends), cell)
        most = np.array([[float(slope.rest) for slope in pair] for pair in told])
        for triangle in triangles:
            corners = low + triangle * extent
            nodes = np.concatenate([corners, (corners + np.roll(corners, -1, axis=0)) / 2])
            true, known = (slopes(np.minimum(p[:, 0], 1 - 1e-9), p[:, 1]) for p in (shares @ corners, nodes))
            assert np.all(np.abs(true - known @ basis.T).max(axis=-1) <= most + 1e-8)


def told_of_twists(patches, n):
    """How far what twists add may be off on n x n grids, and how long it may be, in the patches' units."""
    own = jax.tree.map(lambda x: np.moveaxis(np.asarray(x), 0, -1), as_control(patches))
    spin = Surfaces(own, np.asarray(collapsed_sides(patches)).T).undivided().spin
    assert spin is not None
    matrices, slopes_there = jax.tree.map(lambda x: x[0], tile_tables(spin, HalfCells(), 1))
    spinning = Spinning.of(jax.tree.map(jnp.asarray, spin), (1.0, 1.0), EXACT)
    tile = spinning.on_tile(matrices, slopes_there, 1, EXACT)
    first, second = tile.errors(tile.lengths)
    largest = np.linalg.norm(patches.twists, axis=2).max(axis=1)
    by_u, by_v = (largest / np.linalg.norm(x, axis=1).max(axis=0) for x in (spin.by_u, spin.by_v))
    most = first / n + (second + tile.bent) / n**2 + tile.more / n**3
    return by_u * by_v * np.asarray(most), by_u * by_v * np.asarray(tile.size)


def measured_of_twists(patches, n):
    """The same by sampling."""
    t = np.linspace(0, 1, 9)
    x, y = np.meshgrid(t, t, indexing="ij")
    rising = np.stack([1 - np.maximum(x, y), np.maximum(x - y, 0), np.minimum(x, y), np.maximum(y - x, 0)])
    off, size = np.zeros(len(patches)), np.zeros(len(patches))
    for i, j in np.ndindex(n, n):
        ends = of_twists(patches, (i + np.array([0, 1, 1, 0])) / n, (j + np.array([0, 0, 1, 1])) / n)
        exact = of_twists(patches, (i + x) / n, (j + y) / n)
        missed = np.linalg.norm(exact - np.einsum("cxy,pck->pxyk", rising, ends), axis=-1)
        off, size = (
            np.maximum(off, missed.max(axis=(1, 2))),
            np.maximum(size, np.linalg.norm(exact, axis=-1).max((1, 2))),
        )
    return off, size


@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_what_twists_add_is_interpolated_as_well_as_is_told(rng, kind):
    """Lengths of all of it, over the whole patch: neither a direction nor an angle helps."""
    patches = patches_of(rng, kind, 6, twist=1.0)
    for n in (1, 2, 4, 9):
        for most, found in zip(told_of_twists(patches, n), measured_of_twists(patches, n), strict=True):
            assert np.all(found <= most)


def test_one_twist_of_a_flat_patch_is_interpolated_little_better_than_is_told(rng):
    """Then first order at its corner is all there is; both slopes err most at different places, and partly cancel."""
    x, y = np.meshgrid(np.linspace(0, 1, 4), np.linspace(0, 1, 4), indexing="ij")
    net = np.tile(np.stack([x, y, 0 * x], axis=-1), (8, 1, 1, 1))
    twists = np.zeros((8, 4, 3))
    twists[np.arange(8), np.arange(8) % 4] = rng.normal(size=(8, 3))
    for most, found in zip(
        *(way(GregoryPatches(net, twists), 12) for way in (told_of_twists, measured_of_twists)), strict=True
    ):
        assert np.all(found <= most)
        assert np.all(found > 0.15 * most)


@pytest.mark.parametrize("kind", KINDS)
def test_cells_turn_no_more_than_is_told(rng, kind):
    patches, low, extent = with_boxes(rng, kind)
    pictures, number = pictured(patches), np.arange(len(low))
    told = cell_errors(pictures, number, low, low + extent)
    true = np.array([on_cell(patches, k, *box) for k, *box in zip(number, low, low + extent, strict=True)])
    assert np.all(true <= told)
    assert np.median(told / true) < 5.0


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_triangles_turn_no_more_than_is_told(rng, kind):
    patches, low, extent = with_boxes(rng, kind)
    pictures, number = pictured(patches), np.arange(len(low))
    corners = low[:, None] + rng.integers(0, 3, (len(low), 3, 2)) / 2 * extent[:, None]
    halves = triangle_errors(pictures, number, corners)
    shares = rng.dirichlet(np.ones(3), 200)
    for k, triangle, most in zip(number, corners, halves, strict=True):
        drawn = shares @ normals(patches, k, *triangle.T)
        assert degrees_between(drawn, normals(patches, k, *(shares @ triangle).T)).max() <= most + 1e-6


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["quads", "triangles"])
def test_grids_keep_the_angle(rng, kind):
    patches = patches_of(rng, kind, 12, twist=0.03)
    if kind == "quads":
        # with twists, another side than u = 1 that is a point is left alone
        patches.net[11, 0] = patches.net[11, 0, 0]
    found = tessellation_factors(patches, ABOVE, tolerance=1e6, normal_tolerance=4.0)
    claimed = np.flatnonzero(~np.asarray(found.without_normal))
    assert len(claimed) >= 6
    assert kind == "triangles" or 11 not in claimed
    for k in claimed[:6]:
        n = int(np.ceil(found.factor[k]))
        cells = [(np.array([i, j]) / n, np.array([i + 1, j + 1]) / n) for i in range(n) for j in range(n)]
        assert max(on_cell(patches, k, *cell, places=7) for cell in cells) <= 4.0


def test_single_precision_has_a_program(rng):
    packed = pack(patches_of(rng, "quads", 4).astype(np.float32))
    request = Request.of({"normal_tolerance": 4.0})
    shading = shaded(request, Prepared(packed)).shading
    assert shading is not None
    assert shading.program().out_avals[0].shape[0] >= 1


@pytest.mark.slow
def test_single_precision_tells_nearly_the_same(rng):
    """Rounding counts, and is a thousandth of these angles."""
    patches = patches_of(rng, "quads", 4)
    exact, rounded = (
        np.asarray(tessellation_factors(own, ABOVE, tolerance=1e6, normal_tolerance=4.0).factor)
        for own in (patches, patches.astype(np.float32))
    )
    np.testing.assert_allclose(rounded, exact, rtol=1e-2)


@pytest.mark.slow
def test_without_twists_they_are_bezier_patches(rng):
    net = patches_of(rng, "quads", 4).net
    plain = tessellation_factors(net, ABOVE, tolerance=1e6, normal_tolerance=4.0).factor
    found = tessellation_factors(GregoryPatches(net, np.zeros((4, 4, 3))), ABOVE, tolerance=1e6, normal_tolerance=4.0)
    np.testing.assert_allclose(found.factor, plain, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("options", [{}, {"levels": "fewest", "anisotropic": True}, {"verify": True}])
def test_triangles_of_models_keep_an_angle_as_drawn(models, dtype, options):
    patches = sj.load(models / "catmark_gregory_test8.obj", scheme="gregory").patches().astype(dtype)
    view = View(sj.load(models / "catmark_gregory_test8.obj").default_camera(), 600, 400)
    found = tessellation_factors(patches, view, normal_tolerance=3.0, **options)
    claimed = ~np.asarray(found.without_normal)
    assert claimed.sum() >= 20
    drawn = sj.triangulate(patches, found)
    assert sj.triangle_normal_error(patches, drawn, view)[claimed].max() <= 3.0
    uniform = np.ceil(found.factor).astype(int)
    assert sj.sampled_normal_error(patches, uniform, view)[claimed].max() <= 3.0
