from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import product
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import Camera, InputError, Session, View, load, tessellation_factors
from slefejax.geometry.bezier import evaluate_patch
from slefejax.predict import plainly
from slefejax.predict.kernel import view_pass

slefe_factors = partial(tessellation_factors, method="slefe")


def rounding(precision):
    """Relative, of estimates: second differences cancel most of the control points' digits (SPEED.md), then roots."""
    return 1e-9 if precision == np.float64 else 1e-3


@pytest.mark.parametrize("m", [1, 2, 3, pytest.param(5, marks=pytest.mark.slow)])
def test_against_plain_loops_on_the_teapot(teapot, main_view, m, precision):
    patches = teapot.patches().astype(precision)
    factor = slefe_factors(patches, main_view, segments=m, tolerance=0.7, k=1.2).factor
    assert factor.dtype == precision
    wanted = [plainly.slefe_factor(patch.astype(float), main_view, m, 0.7, 1.2) for patch in patches]
    np.testing.assert_allclose(factor, wanted, rtol=rounding(precision))


@pytest.mark.slow
@pytest.mark.parametrize("degrees", [(1, 2), (2, 3), (5, 4)])
def test_against_plain_loops_at_the_border_of_the_screen(degrees, rng, precision):
    view = View(Camera.look_at((0, -4, 0), (0, 0, 0)), 300, 200)
    patches = rng.normal(size=(60, degrees[0] + 1, degrees[1] + 1, 3)) * 0.6 + rng.normal(size=(60, 1, 1, 3)) * [
        3,
        0.5,
        2,
    ]
    patches[:10] += [40.0, 0, 0]
    patches[..., 1] = np.maximum(patches[..., 1], -3.0)
    factor = np.asarray(slefe_factors(patches.astype(precision), view, depth_tolerance=1e-3).factor)
    assert factor.dtype == precision
    wanted = [plainly.slefe_factor(patch, view, 3, 0.5, depth_tolerance=1e-3) for patch in patches]
    np.testing.assert_allclose(factor, wanted, rtol=rounding(precision))
    assert 0 < np.count_nonzero(factor) < 60


def test_published_sums(teapot, main_view, precision):
    """docs/math.md, 5: m = 3, k = 1, at 1 and at 1/2 pixel."""
    for tolerance, total in ((1.0, 380.316), (0.5, 537.849)):
        factors = slefe_factors(teapot.patches(), main_view, segments=3, tolerance=tolerance)
        assert factors.factor.dtype == precision
        assert float(factors.factor.sum()) == pytest.approx(total, abs=1e-3)
    assert 2 * (factors.levels**2).sum() == 19_874


def test_levels_and_edges(teapot, main_view):
    factors = slefe_factors(teapot.patches(), main_view)
    assert np.array_equal(factors.inner, np.ceil(factors.factor)[:, None].astype(int) * [1, 1])
    assert np.all(factors.edges >= factors.levels[:, None])
    for numbers in np.unique(factors.edge_numbers):
        at = factors.edge_numbers == numbers
        assert len(set(factors.edges[at])) == 1, "both sides of an edge agree"
        assert factors.edges[at][0] == factors.levels[np.nonzero(at)[0]].max()
    assert np.array_equal(factors.scaled(0.5).levels, np.ceil(0.5 * np.asarray(factors.factor)))


def test_linear_patches_need_one_piece_and_invisible_ones_none():
    square = np.array([[[0, 0, 0], [0, 0, 1]], [[1, 0, 0], [1, 0, 1]]], float)
    view = View(Camera.look_at((0, -5, 0), (0, 0, 0)), 100, 100)
    patches = np.stack([square, square + [0, -20, 0], square + [200, 0, 0], square + [0, 500, 0]])
    factors = slefe_factors(patches, view)
    assert factors.factor.tolist() == [1.0, 0.0, 0.0, 0.0], "in front, behind, beside, beyond far"
    assert factors.edges.tolist() == [[1, 1, 1, 1], [0] * 4, [0] * 4, [0] * 4]


def test_neighbour_off_screen_leaves_the_edge_to_the_visible_one(rng):
    """Two patches with an edge in common: it, and all of the second, lie to the right of the picture."""
    view = View(Camera.look_at((0, -5, 0), (0, 0, 0)), 100, 100)
    across = np.linspace(0.0, 6.0, 4)[:, None, None] * np.array([1.0, 0.0, 0.0])
    seen = across + rng.normal(size=(4, 4, 3)) * 0.3
    hidden = seen[-1:] + across + rng.normal(size=(4, 4, 3)) * 0.1
    hidden[0] = seen[-1]
    factors = slefe_factors(np.stack([seen, hidden]), view)
    assert factors.edge_numbers[0, 2] == factors.edge_numbers[1, 0]
    assert factors.levels[0] > 1
    assert factors.levels[1] == 0
    assert factors.edges.tolist() == [[factors.levels[0]] * 4, [0] * 4]
    wider = View(Camera.look_at((6, -30, 0), (6, 0, 0)), 1000, 1000)
    assert slefe_factors(np.stack([seen, hidden]), wider).levels.min() > 1, "and both are drawn from afar"


def test_near_plane_rule_does_not_depend_on_left_and_right(rng):
    """A mirrored scene in a mirrored view has the same factors, where patches cross the near plane too."""
    view = View(Camera.look_at((0, 0, 0), (0, 1, 0)), 640, 480)
    patches = rng.normal(size=(200, 4, 4, 3))
    straight, mirrored = (np.asarray(slefe_factors(patches * [s, 1, 1], view).factor) for s in (1, -1))
    np.testing.assert_allclose(straight, mirrored, rtol=1e-9)
    assert np.count_nonzero(np.any(patches[..., 1] < 0.1, axis=(1, 2)) & (straight > 0)) > 100


def test_factors_beyond_all_levels_are_refused(rng):
    near = View(Camera.look_at((0, 0, 0), (0, 1, 0), near=1e-44), 640, 480)
    factors = slefe_factors(rng.normal(size=(3, 4, 4, 3)), near)
    with pytest.raises(InputError, match=r"factor of patch \d .* which no tessellation can have"):
        _ = factors.levels


@pytest.mark.parametrize("distance", [0.0, 1e-12, 0.05, 0.1, 0.3, 1.0])
def test_patches_through_the_camera_plane_stay_finite(distance, rng):
    """The eye lies in, or near, the patch; no division by zero, and nearer than the near plane counts as in it."""
    view = View(Camera.look_at((0, -distance, 0), (0, 1, 0)), 640, 480)
    patches = rng.normal(size=(50, 4, 4, 3)) * [2.0, 2.0, 2.0]
    factor = np.asarray(slefe_factors(patches, view).factor)
    assert np.all(np.isfinite(factor))
    assert np.all(factor >= 0)
    assert np.any(factor > 1)


@pytest.mark.slow
def test_two_numbers_of_segments(teapot, main_view):
    patches = teapot.patches()
    same = slefe_factors(patches, main_view, segments=(3, 3)).factor
    assert np.array_equal(same, slefe_factors(patches, main_view, segments=3).factor)
    turned = slefe_factors(np.swapaxes(patches, 1, 2), main_view, segments=(4, 2)).factor
    straight = slefe_factors(patches, main_view, segments=(2, 4)).factor
    # not equal: bounds in v then u are not those in u then v
    np.testing.assert_allclose(turned, straight, rtol=0.1)


def test_float32_in_float32_out(teapot, main_view):
    single = slefe_factors(teapot.patches().astype(np.float32), main_view).factor
    double = slefe_factors(teapot.patches(), main_view).factor
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, double, rtol=1e-3)  # SPEED.md: cancellation costs up to 6e-4


@pytest.mark.slow
def test_gradient_by_points_camera_tolerance_and_k(teapot, main_view, rng):
    # the teapot's symmetries are ties of second differences with 0: shake them off
    patches = teapot.patches()[4:8] + 0.01 * rng.normal(size=(4, 4, 4, 3))

    def total(points, eye, tolerance, k):
        view = View(Camera.look_at(eye, (0.0, 0.0, 1.2)), 1440, 900)
        return slefe_factors(points, view, segments=1, tolerance=tolerance, k=k).factor.sum()

    at: tuple[Any, ...] = (jnp.asarray(patches), jnp.array([4.5, -6.0, 4.0]), jnp.asarray(0.5), jnp.asarray(1.1))
    gradients = jax.jit(jax.grad(total, argnums=(0, 1, 2, 3)))(*at)
    for n, gradient in enumerate(gradients):
        direction = rng.normal(size=np.shape(at[n]))
        h = 1e-6
        ahead, behind = ([*at[:n], at[n] + s * h * direction, *at[n + 1 :]] for s in (1, -1))
        numeric = float(jnp.subtract(total(*ahead), total(*behind))) / (2 * h)
        # off ties; the second-order term of the difference and its rounding stay below this
        assert float(jnp.vdot(gradient, direction)) == pytest.approx(numeric, rel=1e-5, abs=1e-6)


def test_one_compilation_a_configuration(teapot, main_view):
    compiled: Any = view_pass
    compiled.clear_cache()
    for angle in np.linspace(0, 1, 5):
        view = View(Camera.look_at((6 * np.cos(angle), 6 * np.sin(angle), 3), (0, 0, 1)), 800, 600)
        for count in (20, 25, 32):
            slefe_factors(teapot.patches()[:count], view, tolerance=0.3 + angle)
    assert compiled.compiled() == 1
    slefe_factors(teapot.patches(), main_view, segments=2)
    assert compiled.compiled() == 2


def test_tracing_gives_factors_but_no_edges(teapot, main_view):
    factors = jax.jit(lambda p: slefe_factors(p, main_view))(teapot.patches())
    np.testing.assert_allclose(factors.factor, slefe_factors(teapot.patches(), main_view).factor, rtol=1e-12)
    with pytest.raises(InputError, match="outside of jit"):
        _ = factors.edges


@pytest.mark.parametrize(
    ("options", "says"),
    [
        ({"segments": 0}, "segments"),
        ({"tolerance": -0.5}, "tolerance must be a positive number"),
        ({"tolerance": float("nan")}, "tolerance"),
        ({"depth_tolerance": 0.0}, "depth_tolerance"),
        ({"k": "1"}, "k must be"),
        ({"tolerance": None}, "tolerance"),
        ({"method": "magic"}, "no method 'magic'"),
    ],
)
def test_bad_options(teapot, main_view, options, says):
    with pytest.raises(InputError, match=says):
        slefe_factors(teapot.patches(), main_view, **options)


def test_views_and_other_dtypes(teapot, main_view):
    with pytest.raises(InputError, match=r"must be a slefejax\.View"):
        slefe_factors(teapot.patches(), main_view.camera)
    wanted = slefe_factors(teapot.patches(), main_view).factor
    for dtype in (">f8", np.longdouble):
        assert np.array_equal(slefe_factors(teapot.patches().astype(dtype), main_view).factor, wanted)
    assert slefe_factors(teapot.patches().astype(np.float16), main_view).factor.dtype == np.float32


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_bad_control_points_are_named(teapot, main_view, value):
    patches = teapot.patches().copy()
    patches[[7, 9], 1, 2, 0] = value
    with pytest.raises(InputError, match=r"patch 7 and 1 more .* not finite"):
        slefe_factors(patches, main_view)


def test_overflow_is_named(main_view, rng):
    with pytest.raises(InputError, match="overflows float32"):
        slefe_factors(rng.normal(size=(2, 4, 4, 3)).astype(np.float32) * np.float32(1e38), main_view)


def rational(patches, weights):
    return np.concatenate([patches * weights, weights], axis=-1)


def test_weights_that_are_all_alike_change_nothing_much(teapot, main_view):
    """Without perspective, X - s W is X but for a constant: widths are those of the projected patch's own slefe,

    never more than those of the boxes around it, and equal where the screen's axes are the world's.
    """
    patches = teapot.patches()
    alike = rational(patches, np.full((*patches.shape[:3], 1), 3.0))
    slanted = View(Camera.orthographic((4, -6, 4), (0, 0, 1), height=6.0), 800, 600)
    along = View(Camera.orthographic((0, -6, 1), (0, 0, 1), height=6.0), 800, 600)
    weighted, plain = (np.asarray(slefe_factors(p, slanted).factor) for p in (alike, patches))
    assert np.all(weighted <= plain * (1 + 1e-12))
    assert np.median(weighted / plain) > 0.7
    weighted, plain = (np.asarray(slefe_factors(p, along).factor) for p in (alike, patches))
    np.testing.assert_allclose(weighted, plain, rtol=1e-9)
    weighted, plain = (np.asarray(slefe_factors(p, main_view).factor) for p in (alike, patches))
    assert np.median(weighted / plain) == pytest.approx(0.85, abs=0.15)


def test_rational_widths_by_loops(rng, precision):
    """One breakpoint after the other: the slefe of X - s W, in v and then in u."""
    view = View(Camera.look_at((0, -6, 1), (0, 0, 0)), 320, 240)
    patch = rational(rng.normal(size=(4, 3, 3)), rng.uniform(0.5, 2, (4, 3, 1)))
    found = slefe_factors(patch[None].astype(precision), view, tolerance=0.5).factor
    screen = patch @ (np.diag([160, 120, 0.5, 1]) @ view.world_to_clip).T
    widths = []
    for i, j in product(range(4), range(4)):
        point = evaluate_patch(screen, i / 3, j / 3)
        for c in (0, 1):
            g = screen[..., c] - point[c] / point[3] * screen[..., 3]
            across = [plainly.bounds(row, 3) for row in g]
            low = plainly.bounds(np.array([low[j] for low, _ in across]), 3)[0][i]
            high = plainly.bounds(np.array([high[j] for _, high in across]), 3)[1][i]
            widths.append((high - low) / point[3])
    assert found.dtype == precision
    assert float(found[0]) == pytest.approx(3 * np.sqrt(max(widths) / 0.5), rel=rounding(precision))


def test_rational_patches_behind_and_beside_are_not_drawn(rng):
    view = View(Camera.look_at((0, -5, 0), (0, 0, 0)), 100, 100)
    points = (
        rng.normal(size=(4, 3, 3, 3)) * 0.3
        + np.array([[0, 0, 0], [0, -20, 0], [300, 0, 0], [0, 900, 0]])[:, None, None]
    )
    factor = np.asarray(slefe_factors(rational(points, rng.uniform(0.5, 2, (4, 3, 3, 1))), view).factor)
    assert factor[0] > 1
    assert factor[1:].tolist() == [0, 0, 0]


def test_weights_must_be_positive(main_view):
    with pytest.raises(InputError, match=r"weights .* patch 0"):
        slefe_factors(np.zeros((1, 4, 4, 4)), main_view)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["slefe", "certified", "filip", "screen-box"])
def test_nothing_is_lost_far_from_the_origin(method, rng):
    """In single precision, a hundred thousand sizes away: what is left is the rounding of relative coordinates.

    Certified factors are raised by bounds of rounding errors, 1 % at most here.
    """
    away = np.array([1e5, -7e4, 3e4])
    single = (rng.uniform(-1, 1, (50, 4, 4, 3)) * [1.0, 1.0, 0.3] + away).astype(np.float32)
    view = View(Camera.look_at(away + [0.3, -4.1, 1.7], away), 1440, 900)
    near = View(Camera.look_at((0.3, -4.1, 1.7), (0, 0, 0)), 1440, 900)
    found = np.asarray(tessellation_factors(single, view, method=method).factor)
    wanted = np.asarray(tessellation_factors(single.astype(np.float64) - away, near, method=method).factor)
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, wanted, rtol=1e-2 if method == "certified" else 1e-4)


def test_boxes_of_a_session_lose_nothing_far_from_the_origin():
    steep = load("steep-patch")
    away = np.array([1e5, -7e4, 3e4])
    scene = replace(steep, control=(steep.control + away).astype(np.float32).astype(np.float64))
    camera = steep.default_camera()
    moved = View(Camera.look_at(away + camera.eye, away + camera.target, camera.up), 1440, 900)
    single, double = (
        np.asarray(Session(scene, method="slefe", dtype=d).factors(moved).factor) for d in ("float32", "float64")
    )
    np.testing.assert_allclose(single, double, rtol=1e-4)
