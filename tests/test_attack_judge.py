"""The judge of slefejax attack: against exact values, another computation with sixty digits, and what it may import."""

from __future__ import annotations

import ast
from pathlib import Path

import numpy as np
import pytest

from slefejax import sampled_error
from slefejax.experiments.attack import judge as attack_judge
from slefejax.experiments.attack.families.nets import moved, nets
from slefejax.experiments.attack.judge.screen import Look, Screen, settled
from slefejax.experiments.attack.judge.search import judge_triangles, judge_uniform
from slefejax.experiments.attack.views import VIEWS, elsewhere, view_of
from slefejax.experiments.checks import reference

FLAT_ON = Look((0.0, 0.0, 5.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 4000.0, 0.1, 10.1, False, 4000, 4000)  # 1 px a unit


def quadratic(a: float, b: float, c: float, row: int = 0) -> np.ndarray:
    """a u^2/2 + b u v + c v^2/2 in one coordinate, nothing in the others."""
    t, square = np.array([0.0, 0.5, 1.0]), np.array([0.0, 0.0, 1.0])
    patch = np.zeros((1, 3, 3, 3))
    patch[0, ..., row] = a / 2 * square[:, None] + b * np.outer(t, t) + c / 2 * square
    return patch


def square_cuts(*cuts: int) -> np.ndarray:
    return np.array([[n, n] for n in cuts])


def test_it_shares_no_code():
    """Neither with the prediction nor with what else measures."""
    names = set()
    for path in Path(attack_judge.__file__).parent.glob("*.py"):
        nodes = list(ast.walk(ast.parse(path.read_text())))
        names |= {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
        names |= {str(node.module) for node in nodes if isinstance(node, ast.ImportFrom)}
    others = {name for name in names if not name.startswith(f"{attack_judge.__name__}.")}
    assert others == {"__future__", "functools", "itertools", "math", "typing", "mpmath", "numpy"}


@pytest.mark.parametrize(("a", "b", "c"), [(300, 0, 0), (0, 200, 0), (100, 30, 250), (300, 140, -290), (-90, 0, -400)])
@pytest.mark.parametrize("cut", [(1, 1), (3, 2), (7, 7), (60, 25), (500, 300)])
def test_quadratics(a, b, c, cut):
    """max(|a|, |c|, |a + c| + 2 |b|)/8 of a cell (docs/certified.md, 5); sixteen digits less what cancels."""
    x, y, z = a / cut[0] ** 2, b / cut[0] / cut[1], c / cut[1] ** 2
    wanted = max(abs(x), abs(z), abs(x + z) + 2 * abs(y)) / 8 / 0.25
    found = judge_uniform(Screen.of(quadratic(a, b, c), FLAT_ON, 0.25), np.array([cut]))
    assert found.ratio[0] == pytest.approx(wanted, rel=1e-9)


def test_triangles_of_any_shape(rng):
    """Of a u^2/2 the error is a/8 times the square of how far a triangle reaches along u."""
    triangles = rng.uniform(size=(40, 3, 2)) * rng.uniform(0.01, 1.0, (40, 1, 1))
    patches = np.concatenate([quadratic(320.0, 0.0, 0.0), quadratic(80.0, 0.0, 0.0)])
    pair = np.arange(40) % 2
    found = judge_triangles(Screen.of(patches, FLAT_ON, 0.5), pair, triangles)
    reach = np.ptp(triangles[:, :, 0], axis=1)
    wanted = [320.0 / 8 / 0.5 * reach[pair == 0].max() ** 2, 80.0 / 8 / 0.5 * reach[pair == 1].max() ** 2]
    np.testing.assert_allclose(found.ratio, wanted, rtol=1e-4)  # coarse samples, zoomed into where they come near 1


def test_depth():
    """Window depth is z over far - near = 10 here; pixels have nothing against it."""
    screen = Screen.of(quadratic(0.08, 0.0, 0.0, row=2), FLAT_ON, 1e9, 1e-4)
    assert judge_uniform(screen, square_cuts(2)).ratio[0] == pytest.approx(0.08 / 8 / 4 / 10 / 1e-4, rel=1e-9)


@pytest.mark.parametrize("family", ["random", "rational"])
@pytest.mark.parametrize("view", ["around", "wide", "narrow", "near-plane"])
def test_sixty_digits_agree(family, view):
    """Own camera, evaluation and interpolation against those of slefejax.experiments.checks.reference."""
    rng = np.random.default_rng(3)
    patches, look = nets(family, rng, (3, 2), np.full(4, 0.4)), VIEWS[view](rng)
    cuts = square_cuts(1, 2, 5, 9)
    found = judge_uniform(Screen.of(patches, look, 0.5), cuts)
    seen = np.flatnonzero((found.ratio > 0) & np.isfinite(found.ratio))
    assert seen.size >= 2
    for k in seen:
        u, v = found.share[k] @ found.triangle[k]
        wanted = float(reference.cell_error(reference.exact(patches[k]), view_of(look), int(cuts[k, 0]), u, v)) / 0.5
        # the other one takes the worse diagonal, and only one may be seen at a place
        assert found.ratio[k] <= wanted * (1 + 1e-9)
        exact = settled(patches[[k]], look, (0.5, None), found.triangle[k], found.share[k])
        # the place is told with sixteen digits, and errors are steep beside the eye
        assert found.ratio[k] == pytest.approx(exact, rel=1e-7)


def test_it_finds_what_the_other_measure_finds(teapot):
    """Both come from below, and that one is known to 1 %."""
    look = Look((4.5, -6.0, 4.0), (0.0, 0.0, 1.2), (0.0, 0.0, 1.0), 45.0, 0.1, 100.0, True, 1440, 900)
    screen = Screen.of(teapot.patches(), look, 1.0)
    view = view_of(look)
    for n in (1, 2, 5, 13):
        wanted = sampled_error(teapot.patches(), np.full(32, n), view)
        found = judge_uniform(screen, square_cuts(*[n] * 32)).ratio
        np.testing.assert_allclose(found, wanted, rtol=0.01)
        assert np.all(found >= wanted * (1 - 1e-3))


@pytest.mark.parametrize("family", ["gregory", "gregory-triangle"])
def test_gregory_patches(family, rng):
    """Its own evaluator finds what the other measure finds, and sixty digits agree."""
    patches, look = nets(family, rng, (3, 3), np.full(6, 0.4)), VIEWS["around"](rng)
    cuts = square_cuts(1, 2, 5, 9, 12, 20)
    found = judge_uniform(Screen.of(patches, look, 0.5), cuts)
    np.testing.assert_allclose(found.ratio, sampled_error(patches, cuts[:, 0], view_of(look)) / 0.5, rtol=0.01)
    for k in np.flatnonzero(found.ratio > 0):
        exact = settled(patches[[k]], look, (0.5, None), found.triangle[k], found.share[k])
        assert found.ratio[k] == pytest.approx(exact, rel=1e-9)


def test_gaussian_products(rng):
    """From q it finds what the other measure finds from rational patches, and sixty digits agree."""
    nets_of_q, look = nets("gaussian", rng, (3, 3), np.full(6, 0.4)), VIEWS["around"](rng)
    products = moved(nets_of_q, 3.0, np.array([50.0, 0.0, -20.0]))
    look = elsewhere(look, 3.0, np.array([50.0, 0.0, -20.0]))
    cuts = square_cuts(1, 2, 5, 9, 12, 20)
    found = judge_uniform(Screen.of(products, look, 0.5), cuts)
    wanted = sampled_error(products.patches(), cuts[:, 0], view_of(look)) / 0.5
    np.testing.assert_allclose(found.ratio, wanted, rtol=0.1)  # on narrow ridges both fall short
    for k in np.flatnonzero(found.ratio > 0):
        exact = settled(products[[k]], look, (0.5, None), found.triangle[k], found.share[k])
        assert found.ratio[k] == pytest.approx(exact, rel=1e-9)
    one = judge_triangles(Screen.of(products, look, 0.5), np.arange(6), found.triangle)
    np.testing.assert_allclose(one.ratio, found.ratio, rtol=0.1)


def test_what_is_not_seen_has_no_error():
    beside = quadratic(300.0, 0.0, 0.0) + [3000.0, 0.0, 0.0]
    behind = quadratic(300.0, 0.0, 0.0) + [0.0, 0.0, 6.0]
    found = judge_uniform(Screen.of(np.concatenate([beside, behind]), FLAT_ON, 0.5), square_cuts(3, 3))
    assert found.ratio.tolist() == [-1.0, -1.0]


def test_behind_the_eye_what_is_drawn_before_it():
    """The middle of an arc lies behind the camera: no number of pixels says how wrong that is."""
    look = Look((0.0, 0.0, 0.0), (0.0, 0.0, -1.0), (0.0, 1.0, 0.0), 90.0, 0.1, 10.0, True, 100, 100)
    arc = np.zeros((1, 3, 2, 3))
    arc[0, :, 1, 1], arc[0, :, :, 2] = 0.5, np.array([-1.0, 2.0, -1.0])[:, None]
    found = judge_uniform(Screen.of(arc, look, 0.5), square_cuts(1))
    assert np.isinf(found.ratio[0])
    assert np.isinf(settled(arc[:1], look, (0.5, None), found.triangle[0], found.share[0]))


def test_double_precision_is_not_enough():
    """A picture of 20,000 pixels and a tolerance of 1e-9 of one: the places are looked at in long double."""
    look = FLAT_ON._replace(extent=20_000.0, width=20_000, height=20_000)
    patch = quadratic(3e-7, 0.0, 0.0) + [7000.1, 3000.7, 0.0]
    found = judge_uniform(Screen.of(patch, look, 1e-9), square_cuts(6))
    exact = settled(patch[:1], look, (1e-9, None), found.triangle[0], found.share[0])
    assert found.ratio[0] == pytest.approx(exact, rel=1e-5)
