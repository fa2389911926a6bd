"""Patches that need fewer triangles, and how far they are from what was given."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree

from slefejax import (
    Camera,
    GregoryPatches,
    InputError,
    View,
    edge_turns,
    fewer_triangles,
    load,
    real_triangles,
    save,
    side_turns,
    surface_distance,
)
from slefejax.geometry.bezier import evaluate_patch
from slefejax.geometry.gregory import twist_basis, twist_slopes
from slefejax.measure.jumps import side_places
from slefejax.study.deviation import distance_squares, turn_squares, unfolded
from slefejax.tessellator.edges import shared_edges

FAST = {"method": "slefe", "segments": 1}
LIMITS = {"within": 0.03, "turn": 10.0}


def grid(patch, n):
    u, v = (x.ravel() for x in np.meshgrid(np.linspace(0, 1, n), np.linspace(0, 1, n), indexing="ij"))
    return np.asarray(evaluate_patch(patch[..., None], u, v)).T


def patch_with(function):
    t = np.linspace(0.0, 1.0, 4)
    x, y = np.meshgrid(t, t, indexing="ij")
    return np.stack([x, y, function(x, y)], axis=-1)[None]


@pytest.mark.slow
def test_distance_against_a_cloud_of_points(rng):
    given = rng.normal(size=(3, 4, 4, 3)) * 0.1 + patch_with(lambda x, y: 0 * x)
    patches = given + 0.02 * rng.normal(size=given.shape)
    found = surface_distance(patches, given)
    for k in range(3):
        cloud, _ = KDTree(grid(given[k], 500)).query(grid(patches[k], 33))
        # the cloud is 1/500 wide: nearest points of it are no nearer than those of the surface, and hardly further
        assert cloud.max() - 3e-4 <= found[k] <= 1.01 * cloud.max()


def test_distances_that_are_known():
    flat = patch_with(lambda x, y: 0 * x)
    assert surface_distance(flat + [0, 0, 0.25], flat)[0] == pytest.approx(0.25)
    slid = flat.copy()
    slid[:, 1:-1, 1:-1, :2] += 0.1  # another parametrisation of the same square
    assert surface_distance(slid, flat)[0] < 1e-12
    assert surface_distance(flat, flat).tolist() == [0.0]
    assert surface_distance(flat * [1, 1, 0] + [0, 2.0, 0], flat)[0] == pytest.approx(2.0), "beyond a side"


@pytest.mark.slow
def test_turns_that_are_known():
    flat = patch_with(lambda x, y: 0 * x)
    slope = patch_with(lambda x, y: np.tan(np.radians(10.0)) * x)
    assert side_turns(slope, flat)[0] == pytest.approx(10.0)
    assert side_turns(flat[:, ::-1], flat)[0] == pytest.approx(180.0), "upside down"
    assert side_turns(slope * [-1, 1, -1], slope)[0] == pytest.approx(180.0, abs=1e-5), "run through the other way"
    steep = patch_with(lambda x, y: np.tan(np.radians(60.0)) * x)
    assert side_turns(steep, steep * [1, 1, -1])[0] == pytest.approx(120.0)
    folded = flat.copy()
    folded[:, 1, 1, 0], folded[:, 2, 2, 0] = 3.0, -3.0
    assert unfolded(np.concatenate([flat, folded]), np.concatenate([flat, flat])).tolist() == [True, False]
    # a roof: two slopes that meet in u = 0 of both, one of them run through backwards
    other = slope * [-1, 1, 1]
    roof = np.concatenate([slope, other[:, :, ::-1]])
    assert edge_turns(roof, shared_edges(roof))[0] == pytest.approx(20.0)
    point = slope.copy()
    point[:, 0] = point[:, 0, :1]
    assert np.isfinite(side_turns(point, slope)).all()


def test_gregory_patches_beside_bezier_ones(rng):
    """Twists of one corner over a flat square: heights are known, and so are slopes across its sides."""
    flat = patch_with(lambda x, y: 0 * x)
    twists = np.zeros((2, 4, 3))
    twists[:, 1, 2] = 0.4, 0.0
    bent = GregoryPatches(np.concatenate([flat, flat]), twists)
    whole = np.concatenate([flat, flat])
    t = np.linspace(0.0, 1.0, 33)
    heights = 0.4 * np.abs(twist_basis(4, *np.meshgrid(t, t, indexing="ij"))[1])
    assert surface_distance(bent, whole) == pytest.approx([heights.max(), 0.0], abs=1e-12)
    slopes = [
        np.stack(own)
        for own in zip(*(twist_slopes(4, u, v) for u, v in side_places(33).transpose(0, 2, 1)), strict=True)
    ]
    steepest = np.hypot(*(0.4 * own[:, 1] for own in slopes)).max()
    assert side_turns(bent, whole) == pytest.approx([np.degrees(np.arctan(steepest)), 0.0], abs=1e-9)
    assert unfolded(bent, whole).all()
    # the same corner of a neighbour beyond u = 1, bent down as this one is bent up
    far = twists[:1, [1, 0, 2, 3]] * [1.0, 1.0, -1.0]
    both = GregoryPatches(np.concatenate([flat, flat + [1.0, 0.0, 0.0]]), np.concatenate([twists[:1], far]))
    across = 0.4 * np.abs(slopes[0][2, 1])
    assert edge_turns(both, shared_edges(both)) == pytest.approx([2.0 * np.degrees(np.arctan(across.max()))])


def test_derivatives_by_twists(rng):
    net, twists = patch_with(lambda x, y: x * y), 0.2 * rng.normal(size=(1, 4, 3))
    along = rng.normal(size=twists.shape)

    @jax.jit
    @jax.value_and_grad
    def change(t):
        patches = GregoryPatches(net, twists + t * along)
        return jnp.sum(distance_squares(patches, net, 4, 1)) + jnp.sum(turn_squares(patches, net, 4))

    step = 1e-6
    (low, _), (_, slope), (high, _) = (change(t) for t in (-step, 0.0, step))
    assert float(slope) == pytest.approx(float(high - low) / (2.0 * step), rel=1e-5)


@pytest.fixture(scope="module")
def relaxed(teapot):
    flat = patch_with(lambda x, y: 0 * x)
    patches = np.concatenate([teapot.patches()[[4, 5, 12, 28]], flat, flat + [0, 900.0, 0]])
    views = [View(Camera.look_at(eye, (0, 0, 1.2)), 640, 400) for eye in ((4.5, -6, 4), (-4, 5, 6), (1, 7, -5))]
    heard = []
    found = fewer_triangles(patches, views, **LIMITS, steps=25, progress=heard.append, **FAST)
    return patches, views, found, heard


@pytest.mark.slow
def test_fewer_triangles_within_the_limits(relaxed):
    patches, views, found, _ = relaxed
    before, after = (sum(float(real_triangles(p, v, **FAST)) for v in views) for p in (patches, found.patches))
    assert after < 0.95 * before
    assert found.moved.tolist() == [True] * 4 + [False] * 2, "flat patches are one quad already, hidden ones need none"
    assert np.all(found.distance <= LIMITS["within"])
    assert np.all(found.turn <= LIMITS["turn"])
    cloud = [KDTree(grid(a, 400)).query(grid(b, 40))[0].max() for a, b in zip(patches, found.patches, strict=True)]
    assert max(cloud) <= LIMITS["within"] * 1.02
    for side in (np.s_[:, 0], np.s_[:, -1], np.s_[:, :, 0], np.s_[:, :, -1]):
        assert np.array_equal(found.patches[side], patches[side]), "edges stay, bit for bit"
    assert "25 steps were not enough" in found.reason


@pytest.mark.slow
def test_it_goes_on_where_it_was(relaxed):
    patches, views, found, heard = relaxed
    assert [at.share(25) for at in heard] == pytest.approx(np.arange(1, 51) / 50)
    again = fewer_triangles(patches, views, **LIMITS, steps=25, start=heard[37], **FAST)
    np.testing.assert_allclose(again.patches, found.patches, rtol=0, atol=1e-12)


@pytest.mark.parametrize(
    ("change", "says"),
    [
        ({"within": 0.0}, "within must be"),
        ({"turn": -1.0}, "turn must be"),
        ({"steps": 0}, "steps must be"),
        ({"views": []}, "views must be"),
        ({"patches": np.zeros((1, 2, 4, 3))}, "no inner control points"),
        ({"patches": np.ones((1, 4, 4, 4))}, "rational patches are not moved"),
        ({"verify": True}, "verify has no meaning here"),
        ({"method": "filip"}, "method 'filip' has none"),
        ({"normal_tolerance": 1.0, "normals": "tangents"}, "normals must be 'surface' here"),
    ],
)
def test_bad_input(change, says, main_view):
    options = {"patches": patch_with(lambda x, y: x * y), "views": [main_view], "within": 0.1, **change}
    with pytest.raises(InputError, match=says):
        fewer_triangles(options.pop("patches"), options.pop("views"), options.pop("within"), **options)


def test_views_of_different_kinds(main_view):
    views = [main_view, View(main_view.camera, 320, 200)]
    with pytest.raises(InputError, match="of one size"):
        fewer_triangles(patch_with(lambda x, y: x * y), views, 0.1)


def test_bpt_files_hold_patches_bit_for_bit(tmp_path, teapot):
    save(teapot, tmp_path / "pot.bpt")
    assert np.array_equal(load(tmp_path / "pot.bpt").patches(), teapot.patches())
    with pytest.raises(InputError, match="cannot be written"):
        save(teapot, tmp_path / "none" / "pot.bpt")
    with pytest.raises(InputError, match=r"\.json"):
        save(teapot, tmp_path / "pot.json")
