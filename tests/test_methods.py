"""Methods as values: those of the package, one's own, by name; and values that JAX may take apart and stack."""

from __future__ import annotations

import pickle
from dataclasses import dataclass, replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import (
    Camera,
    InputError,
    Session,
    View,
    load,
    minimal_factors,
    pack,
    pixel_error,
    sampled_error,
    slefe_boxes,
    tessellation_factors,
    tolerance_for_budget,
    triangle_error,
    triangulate,
)
from slefejax.predict import methods
from slefejax.predict.kernel import Method, Tolerances
from slefejax.predict.methods import METHODS, label_of, method_of

FAST = methods.Slefe(1)


@dataclass(frozen=True)
class EverySo:
    """So many pixels a piece, by the distance of a patch's corners on the screen."""

    pixels: float = 20.0

    def prepare(self, patches):
        return patches[:, :: patches.shape[1] - 1, :: patches.shape[2] - 1]

    def factor(self, prepared, view, tolerances):
        assert isinstance(tolerances, Tolerances)
        homogeneous = jnp.concatenate([prepared, jnp.ones_like(prepared[..., :1])], axis=-1)
        screen = homogeneous @ view.world_to_screen.T
        flat = (screen[..., :2] / screen[..., 3:]).reshape(len(prepared), 4, 2)
        return jnp.maximum(jnp.linalg.norm(jnp.ptp(flat, axis=1), axis=-1) / self.pixels, 1.0)


@dataclass(frozen=True)
class Wrong:
    made: Any

    def prepare(self, patches):
        return patches

    def factor(self, prepared, view, tolerances):
        return self.made


def same(one, other):
    np.testing.assert_array_equal(one.factor, other.factor)
    np.testing.assert_array_equal(one.edges, other.edges)


@pytest.mark.parametrize("name", METHODS)
def test_a_name_and_a_value_are_the_same(name, teapot, main_view):
    value = method_of(name)
    assert isinstance(value, Method)
    same(
        tessellation_factors(teapot.patches(), main_view, name),
        tessellation_factors(pack(teapot.patches()), main_view, value),
    )
    again = jax.tree.unflatten(jax.tree.structure(value), jax.tree.leaves(value))
    assert again == pickle.loads(pickle.dumps(value)) == value
    assert label_of(value).startswith(name)


@pytest.mark.parametrize(
    ("value", "knobs"),
    [
        pytest.param(methods.Certified(tiles=1), {"tiles": 1}, marks=pytest.mark.slow),
        (methods.Slefe((2, 4), 0.8), {"segments": (2, 4), "k": 0.8}),
        (methods.EdgeLength(12.0), {"setting": 12.0}),
    ],
)
def test_numbers_of_a_value_are_those_by_name(value, knobs, teapot, main_view):
    named = tessellation_factors(teapot.patches(), main_view, value.name, **knobs)
    same(named, tessellation_factors(teapot.patches(), main_view, value))


@pytest.mark.parametrize("value", [methods.Certified(tiles=1), methods.Slefe(2), methods.Filip(), EverySo()])
def test_both_phases_apart(value, teapot, main_view):
    """What is prepared once serves many views."""
    given = teapot.patches() if isinstance(value, EverySo) else pack(teapot.patches())
    prepared = value.prepare(given)
    for view in (main_view, replace(main_view, width=400)):
        found = value.factor(prepared, view, Tolerances(0.7))
        wanted = tessellation_factors(teapot.patches(), view, value, tolerance=0.7).factor
        np.testing.assert_allclose(found, wanted, rtol=1e-11)  # boxes are relative to another origin


def test_a_method_of_ones_own_everywhere(teapot, main_view, monkeypatch, tmp_path):
    found = tessellation_factors(teapot.patches(), main_view, EverySo(30.0))
    assert found.levels.max() > 10
    assert np.array_equal(found.inner[:, 0], found.levels)
    jitted = jax.jit(lambda points: tessellation_factors(points, main_view, EverySo(30.0)))(teapot.patches())
    np.testing.assert_allclose(jitted.factor, found.factor, rtol=1e-12)
    assert np.array_equal(jitted.at(teapot.patches(), main_view).edges, found.edges)
    scene = load("walker")
    view = View(scene.default_camera(), 640, 400)
    session = Session(scene, method=EverySo())
    moved = session.factors(view, 0.3)
    same(moved, tessellation_factors(session.patches, view, EverySo(), edge_numbers=scene.edge_numbers))
    assert session.left_out() == scene.left_out()
    slope = jax.grad(lambda points: jnp.sum(tessellation_factors(points, main_view, EverySo()).factor))(
        teapot.patches()
    )
    assert np.isfinite(slope).all()
    assert np.any(slope)
    (tmp_path / "my_rules.py").write_text("from tests.test_methods import EverySo as Mine\nnone = 3\n")
    monkeypatch.syspath_prepend(tmp_path)
    named = tessellation_factors(teapot.patches(), main_view, "my_rules:Mine")
    same(named, tessellation_factors(teapot.patches(), main_view, EverySo()))
    with pytest.raises(InputError, match="no method 'my_rules:Yours'"):
        method_of("my_rules:Yours")
    with pytest.raises(InputError, match="there is no method 3: choose one of certified"):
        method_of("my_rules:none")
    with pytest.raises(InputError, match="method 'my_rules:Mine' has no setting: its own are pixels"):
        method_of("my_rules:Mine", {"setting": 3.0})


@pytest.mark.parametrize(
    ("made", "says"),
    [
        (np.ones(3), r"real factors of shape \(32,\), not float64 \(3,\)"),
        (np.full(32, np.nan), r"made the factor nan of patch 0"),
        (np.full(32, -1.0), r"made the factor -1 of patch 0"),
        (np.zeros(32, bool), "real factors"),
    ],
)
def test_factors_of_ones_own_that_are_none(made, says, teapot, main_view):
    with pytest.raises(InputError, match=says):
        tessellation_factors(teapot.patches(), main_view, Wrong(made))


@pytest.mark.parametrize(
    ("method", "knobs", "says"),
    [
        ("slefe", {"tiles": 4}, "method 'slefe' has no tiles: its own are segments, k, smooth"),
        ("certified", {"segments": 7}, "method 'certified' has no segments"),
        ("certified", {"k": 3.0}, "method 'certified' has no k"),
        ("certified", {"tolerence": 0.5}, r"no option 'tolerence' \(did you mean tolerance\?\)"),
        ("certifed", {}, r"no method 'certifed' \(did you mean certified\?\)"),
        (methods.Slefe(), {"k": 2.0}, r"the method is a value with its numbers, .*: give k to it"),
        (methods.Slefe, {}, r"the method is a class: give a value, such as Slefe\(\)"),
        (methods.Certified(tiles=0), {}, "tiles must be a whole number"),
        (methods.Fixed(-1.0), {}, "setting must be a positive number"),
        (3, {}, "no method 3"),
    ],
)
def test_methods_and_numbers_that_there_are_not(method, knobs, says, teapot, main_view):
    with pytest.raises(InputError, match=says):
        tessellation_factors(teapot.patches(), main_view, method, **knobs)
    if "tolerence" not in knobs:
        with pytest.raises(InputError, match=says):
            tolerance_for_budget(teapot.patches(), main_view, 5000, method=method, **knobs)


def test_views_are_plain_pytrees(teapot, main_view):
    """Stacked, mapped over, without leaves, differentiated by."""
    other = View(Camera.look_at((5.0, -5.0, 3.0), (0.0, 0.0, 1.2)), 1440, 900)
    both = jax.tree.map(lambda *numbers: jnp.stack([jnp.asarray(x) for x in numbers]), main_view, other)

    def total(view):
        return jnp.sum(tessellation_factors(teapot.patches(), view, methods.Minmax(), tolerance=20.0).factor)

    np.testing.assert_allclose(jax.jit(jax.vmap(total))(both), [total(main_view), total(other)], rtol=1e-12)
    assert jax.tree.leaves(jax.tree.map(lambda x: None, main_view)) == []
    slope = jax.jit(jax.grad(total))(jax.tree.map(lambda x: jnp.asarray(x, float), main_view)).camera.eye
    direction, h = np.array([0.3, 0.5, -0.2]), 1e-6

    def moved(step):
        camera = main_view.camera
        return total(replace(main_view, camera=replace(camera, eye=camera.eye + step * direction)))

    assert float(slope @ direction) == pytest.approx(float(moved(h) - moved(-h)) / (2 * h), rel=1e-4)


@pytest.mark.parametrize(
    "method", [methods.EdgeLength(jnp.asarray(12.0)), pytest.param(methods.Certified(1), marks=pytest.mark.slow)]
)
def test_factors_from_jit_get_their_levels_back(method, teapot, main_view):
    wanted = tessellation_factors(teapot.patches(), main_view, method, tolerance=0.7)
    found = jax.jit(lambda points: tessellation_factors(points, main_view, method, tolerance=0.7))(teapot.patches())
    with pytest.raises(InputError, match=r"factors\.at"):
        _ = found.edges
    back = found.at(teapot.patches(), main_view)
    assert np.array_equal(back.inner, wanted.inner)
    assert np.array_equal(back.edges, wanted.edges)
    with pytest.raises(InputError, match="32 patches, not of 5"):
        found.at(teapot.patches()[:5], main_view)
    with pytest.raises(InputError, match="compute them anew"):
        type(found)(found.factor).at(teapot.patches(), main_view)


@pytest.mark.parametrize("given", [np.float64, np.float32])
def test_packed_patches_are_patches(given, precision, teapot, main_view):
    patches = teapot.patches().astype(given)
    packed = pack(patches)
    assert pack(packed) is packed
    assert len(packed) == 32
    same(tessellation_factors(packed, main_view, FAST), tessellation_factors(patches, main_view, FAST))
    inside = jax.jit(lambda own: tessellation_factors(own, main_view, FAST).factor)(packed)
    # in jit the origin is the eye, and what more digits there are is lost
    close = 1e-11 if given == precision == np.float64 else 1e-2
    np.testing.assert_allclose(inside, tessellation_factors(patches, main_view, FAST).factor, rtol=close)
    np.testing.assert_array_equal(packed.patches(), patches)


def test_what_measures_says_that_it_does_so_on_the_host(teapot, main_view):
    patches, one = teapot.patches(), np.ones(32, int)
    triangles = triangulate(patches, (np.ones((32, 2), int), np.ones((32, 4), int)))
    nothing = np.zeros((2, 2)), np.zeros((2, 2)), np.full((2, 2), -1)
    for name, measure in (
        ("sampled_error", lambda p: sampled_error(p, one, main_view)),
        ("pixel_error", lambda p: pixel_error(p, main_view, *nothing)),
        ("minimal_factors", lambda p: minimal_factors(p, main_view)),
        ("triangle_error", lambda p: triangle_error(p, triangles, main_view)),
    ):
        with pytest.raises(InputError, match=f"{name} measures on the host, in float64: call it outside of jit"):
            jax.jit(measure)(patches)
    packed = pack(patches)
    np.testing.assert_array_equal(sampled_error(packed, one, main_view), sampled_error(patches, one, main_view))
    np.testing.assert_array_equal(minimal_factors(packed, main_view), minimal_factors(patches, main_view))
    np.testing.assert_array_equal(slefe_boxes(packed, 2).lower, slefe_boxes(patches, 2).lower)


@pytest.mark.slow
def test_both_phases_have_derivatives(teapot, main_view):
    """Boxes are relative to a place that the patches give, on which nothing depends."""
    at = jnp.asarray(teapot.patches()[:3])

    def prepared(points):
        return jnp.sum(FAST.factor(FAST.prepare(points), main_view, Tolerances()))

    def whole(points):
        return jnp.sum(FAST.factor(points, main_view, Tolerances()))

    wanted = jax.grad(whole)(at)
    np.testing.assert_allclose(jax.grad(prepared)(at), wanted, rtol=1e-9, atol=1e-9 * float(jnp.abs(wanted).max()))
