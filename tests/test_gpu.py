from __future__ import annotations

import gc
import threading
import weakref

import numpy as np
import pytest

from slefejax import Camera, InputError, View, tessellation_factors, triangle_error
from slefejax.geometry.bezier import evaluate_patch
from slefejax.geometry.view import homogeneous
from slefejax.tessellator.edges import edge_maxima, shared_edges
from slefejax.tessellator.levels import SPACINGS, levels_for, segments, triangle_counts, widest_pieces
from tests.test_edges import SYMMETRIES

pytestmark = pytest.mark.gl


@pytest.fixture(scope="module")
def gpu(device):
    """The renderer's module, once a device is there; OpenGL's error state is clean before and after."""
    from slefejax.gpu import renderer

    assert device.context.error == "GL_NO_ERROR"
    yield renderer
    assert device.context.error == "GL_NO_ERROR"


def lattice(rng, side, degree, relief=0.6):
    """side x side patches over a rectangle, joined along their edges, each laid some other way; and their places."""
    n = side * degree + 1
    x, y = np.meshgrid(np.linspace(-1, 1, n), np.linspace(-1, 1, n), indexing="ij")
    net = np.stack([x, y, np.zeros_like(x)], axis=-1) + rng.normal(size=(n, n, 3)) * [0.3 / n, 0.3 / n, relief / n]
    ways = list(SYMMETRIES.values())
    patches = []
    for i in range(side):
        for j in range(side):
            block = net[i * degree : (i + 1) * degree + 1, j * degree : (j + 1) * degree + 1]
            patches.append(ways[rng.integers(len(ways))](block))
    return np.array(patches)


def above(height=1.2, size=256):
    camera = Camera.orthographic((0, 0, 3), (0, 0, 0), up=(0, 1, 0), height=height, near=0.5, far=6.0)
    return View(camera, size, size)


def random_levels(rng, patches, lowest=1, highest=20):
    inner = rng.integers(lowest, highest + 1, len(patches))
    return np.repeat(inner[:, None], 2, axis=1), edge_maxima(inner, shared_edges(patches))


def test_self_test_passes_and_can_fail(device, gpu, monkeypatch):
    from slefejax.gpu import selftest

    assert selftest.wrong_pixels(device) == 0
    if "llvmpipe" in device.renderer:
        monkeypatch.setattr(selftest, "VERTICES_A_DRAW", 64 * 50**2)
        monkeypatch.setattr(gpu, "VERTICES_A_DRAW", 10**9)
        assert selftest.wrong_pixels(device) > 0, "software OpenGL loses triangles in a draw as full as this"


@pytest.mark.parametrize("shape", [(2, 2, 3), (3, 4, 3), (4, 4, 3), (7, 7, 3), (4, 4, 4), (3, 6, 4)])
def test_vertices_are_the_surface(device, gpu, rng, shape):
    """GLSL against the JAX side's evaluator, at the coordinates that came out; 7 x 7 is more than 32 vertices."""
    patches = rng.normal(size=(5, *shape))
    if shape[2] == 4:
        patches[..., 3] = rng.uniform(0.5, 2.0, patches.shape[:3])
    view = View(Camera.look_at((0, -9, 2), (0, 0, 0)), 320, 200)
    levels = np.full((5, 6), 6)
    found = gpu.Renderer(patches, device).capture(view, levels[:, :2], levels[:, 2:])
    assert len(found.patch) == triangle_counts(levels[:, :2], levels[:, 2:]).sum()
    control = np.moveaxis(homogeneous(patches.astype(np.float32).astype(float)), 0, -1)
    uv = found.parameters.astype(float)
    points = evaluate_patch(control[..., found.patch][..., None], uv[..., 0], uv[..., 1])
    wanted = np.moveaxis(points, 0, -1) @ view.world_to_clip.T
    # a few dozen float32 operations on numbers up to about ten
    np.testing.assert_allclose(found.clip, wanted, rtol=0, atol=3e-5)


@pytest.mark.parametrize("degree", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("rational", [False, True])
def test_shared_boundaries_are_bitwise_equal(device, gpu, rng, degree, rational):
    """Whichever way each neighbour runs along the edge: every boundary vertex of one is one of the other's."""
    patches = lattice(rng, 4, degree)
    if rational:
        # a weight for every place: equal points get equal weights
        _, place = np.unique(patches.reshape(-1, 3), axis=0, return_inverse=True)
        weight = rng.uniform(0.5, 2.0, place.max() + 1)[place.ravel()].reshape(*patches.shape[:3], 1)
        patches = np.concatenate([patches * weight, weight], axis=-1)
    patches = patches.astype(np.float32)
    numbers = shared_edges(patches)
    inner, outer = random_levels(rng, patches, 2, 23)
    camera = Camera.look_at((0.3, -2.0, 1.5), (0, 0, 0))
    found = gpu.Renderer(patches, device).capture(View(camera, 320, 200), inner, outer)
    sides = [np.isin(found.parameters[..., axis], end) for end, axis in ((0.0, 0), (0.0, 1), (1.0, 0), (1.0, 1))]
    positions = {}
    for side, on_side in enumerate(sides):
        for patch in range(len(patches)):
            points = found.clip[on_side & (found.patch == patch)[:, None]]
            assert len(points)
            unique = np.unique(points, axis=0)
            assert len(unique) == outer[patch, side] + 1
            positions.setdefault(numbers[patch, side], []).append(unique)
    pairs = [pair for pair in positions.values() if len(pair) == 2]
    assert len(pairs) == 24
    for one, other in pairs:
        assert np.array_equal(one, other)


def test_triangle_counts_and_areas_for_all_kinds_of_levels(device, gpu, rng):
    patches = lattice(rng, 6, 1)
    inner = rng.integers(1, 15, (36, 2))
    outer = rng.integers(1, 15, (36, 4))
    inner[:6] = 1
    outer[:3] = 1
    outer[6, 2] = 0
    found = gpu.Renderer(patches, device).capture(above(), inner, outer)
    counts = triangle_counts(inner, outer)
    assert np.array_equal(np.bincount(found.patch, minlength=36), counts)
    assert counts[6] == 0
    assert counts[0] == 2
    a, b, c = np.moveaxis(found.parameters.astype(float), 1, 0)
    first, second = b - a, c - a
    area = 0.5 * (first[:, 0] * second[:, 1] - first[:, 1] * second[:, 0])
    assert np.all(area > 0), "counter-clockwise in the domain"
    total = np.bincount(found.patch, area, minlength=36)
    np.testing.assert_allclose(total, np.where(counts > 0, 1.0, 0.0), atol=1e-4)  # coordinates are 1/65536 apart


@pytest.mark.parametrize("degree", [1, 3])
def test_no_pixel_drops_out(device, gpu, rng, degree):
    """A surface that fills the picture, its patches laid in all ways and cut differently, covers every pixel."""
    patches = lattice(rng, 12, degree, relief=3.0)
    inner, outer = random_levels(rng, patches)
    renderer = gpu.Renderer(patches, device)
    seen = renderer.draw(above(), inner, outer)
    assert np.all(seen.patch >= 0)
    assert np.all((seen.depth > 0) & (seen.depth < 1))
    own = np.repeat(inner[:, :1], 4, axis=1)
    assert degree == 1 or np.any(renderer.draw(above(), inner, own).patch < 0), "without shared levels there are cracks"


def test_background_and_left_out_patches(device, gpu):
    square = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)
    levels = np.array([[1] * 6, [0] * 6])
    view = above(height=4.0, size=64)
    seen = gpu.Renderer(np.stack([square, square - 1]), device).draw(view, levels[:, :2], levels[:, 2:])
    assert np.count_nonzero(seen.patch == 0) == 16 * 16
    assert np.all(seen.patch[32:48, 32:48] == 0)
    assert np.count_nonzero(seen.patch == -1) == 64 * 64 - 16 * 16
    assert np.all(seen.depth[seen.patch == -1] == 1.0)


def test_draws_are_split_below_the_limit(gpu):
    inner = np.full((1000, 2), 11)
    outer = np.full((1000, 4), 11)
    outer[500] = 64
    ranges = gpu.draw_ranges(inner, outer)
    assert [first for first, _ in ranges] == np.cumsum([0, *(n for _, n in ranges)])[:-1].tolist()
    assert sum(n for _, n in ranges) == 1000
    for first, count in ranges:
        longest = np.maximum(inner, outer[:, :2]).max(axis=1)[first : first + count]
        assert ((longest + 1) ** 2).sum() <= gpu.VERTICES_A_DRAW


def test_full_draws_lose_nothing(device, gpu, rng):
    """3,600 patches at factor 12: a single draw of them would wrap the numbers of software OpenGL's vertices."""
    patches = lattice(rng, 60, 1, relief=0.0)
    levels = np.full((3600, 6), 12)
    seen = gpu.Renderer(patches, device).draw(above(size=512), levels[:, :2], levels[:, 2:])
    assert np.all(seen.patch >= 0)


def test_levels_that_cannot_be_drawn(device, gpu, rng):
    patches = lattice(rng, 2, 1)
    renderer = gpu.Renderer(patches, device)
    levels = np.full((4, 6), 3)
    levels[2, 4] = 64 * 256 + 1
    with pytest.raises(InputError, match=r"1 of 4 patches need .* above 16384, .* \(patch 2, counted from 0: 16385\)"):
        renderer.draw(above(), levels[:, :2], levels[:, 2:])
    with pytest.raises(InputError, match="shapes"):
        renderer.draw(above(), levels[:3, :2], levels[:3, 2:])
    levels[2, 4] = 1
    with pytest.raises(InputError, match="too large"):
        renderer.draw(above(size=90_000), levels[:, :2], levels[:, 2:])
    with pytest.raises(InputError, match=r"patch 1 .* not finite"):
        gpu.Renderer(np.where(np.arange(4)[:, None, None, None] == 1, np.nan, patches), device)
    with pytest.raises(InputError, match="whole numbers"):
        renderer.draw(above(), levels[:, :2] * 0.9, levels[:, 2:])
    with pytest.raises(InputError, match="negative"):
        renderer.draw(above(), -levels[:, :2], levels[:, 2:])
    with pytest.raises(InputError, match="3 or 4 coordinates"):
        gpu.Renderer(patches[..., :2], device)


@pytest.mark.parametrize("scale", [1e-12, 1.0, 1e12])
@pytest.mark.parametrize("offset", [0.0, 1e6])
def test_place_and_size_of_the_scene_do_not_matter(device, gpu, teapot, main_view, offset, scale):
    """The same picture of a moved and scaled scene: control points go to the device relative to their box."""
    levels = np.full((32, 6), 16)
    move = np.array([1.0, -2.0, 0.5]) * offset
    seen = []
    for points, s, m in ((teapot.patches(), 1.0, 0.0 * move), ((teapot.patches() + move) * scale, scale, move)):
        camera = Camera.look_at(
            (np.array((4.5, -6, 4)) + m) * s, (np.array((0, 0, 1.2)) + m) * s, near=0.1 * s, far=100 * s
        )
        seen.append(gpu.Renderer(points, device).draw(View(camera, 360, 225), levels[:, :2], levels[:, 2:]))
    assert np.count_nonzero(seen[0].patch != seen[1].patch) <= 3  # pixels on an edge, by a rounding
    same = seen[0].patch == seen[1].patch
    assert np.quantile(np.abs(seen[0].u - seen[1].u)[same], 0.999) < 1e-3


def open_edges(triangles, patches) -> int:
    """Edges of the captured triangles inside of the lattice that no other one runs along the other way, by position."""
    corners = triangles.clip + np.float32(0)
    _, number = np.unique(corners.reshape(-1, 4), axis=0, return_inverse=True)
    number = number.reshape(-1, 3)
    pairs = np.concatenate([number[:, [0, 1]], number[:, [1, 2]], number[:, [2, 0]]])
    there = set(map(tuple, np.sort(pairs[pairs[:, 0] != pairs[:, 1]], axis=1).tolist()))
    counts = {pair: 0 for pair in there}
    for a, b in np.sort(pairs, axis=1).tolist():
        if a != b:
            counts[a, b] += 1
    return sum(count != 2 for count in counts.values())


@pytest.mark.parametrize("spacing", SPACINGS)
def test_spacing(device, gpu, rng, spacing):
    """Real levels: as many triangles as OpenGL prescribes (``capture`` refuses others), no cracks, the right pixels."""
    patches = lattice(rng, 5, 3)
    numbers = shared_edges(patches)
    level = rng.uniform(1.0, 11.0, len(patches))
    if spacing == "equal":
        level = np.ceil(level).astype(int)
    inner, outer = np.repeat(level[:, None], 2, axis=1), edge_maxima(level, numbers)
    renderer = gpu.Renderer(patches, device, spacing)
    found = renderer.capture(above(), inner, outer)
    assert len(found.patch) == triangle_counts(inner, outer, spacing).sum()
    rim = 2 * segments(outer, spacing)[np.bincount(numbers.ravel())[numbers] == 1].sum() / 2
    assert open_edges(found, patches) == rim
    own = found.parameters[found.patch == 12]
    row = np.unique(own[..., 1][own[..., 0] == 0.0])
    assert len(row) == segments(outer[12], spacing)[0] + 1
    np.testing.assert_allclose(np.diff(row).max(), widest_pieces(outer[12, :1], spacing)[0], atol=1e-4)
    assert np.all(renderer.draw(above(), inner, outer).patch[100:150, 100:150] >= 0)


@pytest.mark.parametrize("spacing", SPACINGS)
def test_levels_for_factors(spacing):
    factors = np.append(np.linspace(0.5, 63.0, 6000), np.arange(1.0, 64.0))
    levels = levels_for(factors, spacing)
    assert np.all(widest_pieces(levels, spacing) * np.maximum(factors, 1.0) < 1.0 + 1e-12)
    assert np.all(levels >= factors - 1e-12)
    assert levels_for(np.zeros(2), spacing).tolist() == [0, 0]
    order = np.argsort(factors, kind="stable")
    assert np.all(np.diff(levels[order]) > -1e-12)
    if spacing != "equal":
        coarser = np.maximum(levels - 1e-6, {"fractional-even": 2.0, "fractional-odd": 1.0}[spacing])
        lower = coarser < levels
        assert np.all(widest_pieces(coarser[lower], spacing) * factors[lower] > 1.0)
        assert np.abs(np.diff(levels[order])).max() < 0.05  # no jumps


@pytest.mark.parametrize("spacing", [SPACINGS[1], pytest.param(SPACINGS[2], marks=pytest.mark.slow)])
def test_certified_factors_hold_for_fractional_grids(device, gpu, teapot, main_view, spacing):
    """Every patch by itself, at the lowest levels whose pieces are no wider than 1/factor; not so transition rings."""
    levels = levels_for(np.asarray(tessellation_factors(teapot.patches(), main_view).factor), spacing)
    renderer = gpu.Renderer(teapot.patches(), device, spacing)
    found = renderer.capture(main_view, np.repeat(levels[:, None], 2, axis=1), np.repeat(levels[:, None], 4, axis=1))
    assert 0.3 < triangle_error(teapot.patches(), found, main_view).max() <= 0.5


def test_spacing_that_is_none(device, gpu, rng):
    patches = lattice(rng, 1, 1)
    with pytest.raises(InputError, match="no spacing 'odd': choose one of equal, fractional-even"):
        gpu.Renderer(patches, device, "odd")
    with pytest.raises(InputError, match=r"above 63, the most that can be drawn .*63.5"):
        gpu.Renderer(patches, device, "fractional-odd").draw(above(), np.full((1, 2), 63.5), np.full((1, 4), 3.0))
    with pytest.raises(InputError, match="levels must be whole numbers"):
        gpu.Renderer(patches, device).draw(above(), np.full((1, 2), 3.5), np.full((1, 4), 3.5))
    with pytest.raises(InputError, match="levels must be numbers"):
        gpu.Renderer(patches, device, "fractional-even").draw(above(), np.full((1, 2), np.nan), np.full((1, 4), 3.5))


def test_patches_that_move(device, gpu, rng):
    """New control points in the same renderer: the picture of a new renderer."""
    patches, levels = lattice(rng, 4, 3), np.full((16, 6), 5)
    renderer = gpu.Renderer(patches, device)
    renderer.draw(above(), levels[:, :2], levels[:, 2:])
    moved = 1e3 + 0.7 * patches
    view = View(Camera.orthographic((1e3, 1e3, 1e3 + 3), (1e3, 1e3, 1e3), up=(0, 1, 0), near=0.5, far=6.0), 256, 256)
    renderer.move(moved)
    found, wanted = (r.draw(view, levels[:, :2], levels[:, 2:]) for r in (renderer, gpu.Renderer(moved, device)))
    for name in ("u", "v", "patch", "depth"):
        assert np.array_equal(getattr(found, name), getattr(wanted, name))
    with pytest.raises(InputError, match=r"keep their number and degree: \(16, 4, 4, 3\), not \(15, 4, 4, 3\)"):
        renderer.move(moved[:15])
    with pytest.raises(InputError, match=r"patch 3 .* not finite"):
        renderer.move(np.where(np.arange(16)[:, None, None, None] == 3, np.nan, moved))


def test_another_thread_is_refused(device, gpu, rng):
    caught = []

    def draw():
        try:
            gpu.Renderer(lattice(rng, 2, 1), device)
        except RuntimeError as error:
            caught.append(str(error))

    thread = threading.Thread(target=draw)
    thread.start()
    thread.join()
    assert caught
    assert "another thread" in caught[0]


def test_renderers_that_nobody_holds_are_freed(device, gpu, teapot, main_view):
    """Otherwise a loop over scenes keeps every picture that it ever drew into."""
    levels = np.full((32, 2), 4), np.full((32, 4), 4)
    old = gpu.Renderer(teapot.patches())
    old.draw(main_view, *levels)
    picture = weakref.ref(old._target[1].color_attachments[0])
    assert picture() is not None
    del old
    gpu.Renderer(teapot.patches()).draw(main_view, *levels)
    gc.collect()
    gpu.Renderer(teapot.patches())
    assert picture() is None
