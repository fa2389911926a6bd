"""Kernels against the formulas as they are written, and how many operations they are made of."""

from __future__ import annotations

from functools import partial
from typing import Any

import jax
import numpy as np
import pytest

from slefejax import Camera, View, tessellation_factors
from slefejax.bounds.slefe import enclose_patch
from slefejax.geometry.projection import Projection
from slefejax.predict import plainly
from slefejax.predict.certified import certified_factor

NEAR = View(Camera.look_at((1.5, -2.0, 2.0), (0, 0, 1.2)), 400, 300)


@pytest.mark.parametrize("shape", [(4, 4), (2, 3), pytest.param((6, 5), marks=pytest.mark.slow)])
@pytest.mark.parametrize(("tiles", "depth"), [(2, None), pytest.param(3, 1e-3, marks=pytest.mark.slow)])
def test_certified_factors(shape, tiles, depth, main_view, rng):
    """In whole and in part on the screen, and beside it; 1e-11 is the margin for rounding, which the kernel has."""
    patches = np.array([0, 0, 1.2]) + 0.7 * rng.normal(size=(16, 1, 1, 3)) + 0.2 * rng.normal(size=(16, *shape, 3))
    for view in (main_view, NEAR):
        found = tessellation_factors(patches, view, tiles=tiles, tolerance=0.4, depth_tolerance=depth).factor
        wanted = [plainly.certified_factor(patch, view, tiles, 0.4, depth) for patch in patches]
        np.testing.assert_allclose(found, wanted, rtol=1e-11)
    assert 0.0 in wanted
    assert max(wanted) > 20.0


def operations(function: Any, *arguments: Any) -> int:
    """How many primitive operations there are, of loops those of one turn."""

    def count(jaxpr: Any) -> int:
        inner = [
            [getattr(own, "jaxpr", own) for own in jax.tree.leaves(list(eqn.params.values()), is_leaf=has_equations)]
            for eqn in jaxpr.eqns
        ]
        return sum(sum(count(own) for own in each if hasattr(own, "eqns")) or 1 for each in inner)

    return count(jax.make_jaxpr(function)(*arguments).jaxpr)


def has_equations(value: Any) -> bool:
    return hasattr(value, "eqns") or hasattr(value, "jaxpr")


@pytest.mark.parametrize(("tiles", "depth", "wanted"), [(1, None, 5394), (2, None, 6099), (2, 1e-3, 9944)])
def test_certified_kernels_do_not_grow(tiles, depth, wanted, main_view):
    """Of bicubic patches, unrolled: more of them would be slower everywhere, and nothing else would show it."""
    kernel = partial(certified_factor, tiles=tiles)
    found = operations(kernel, np.zeros((4, 4, 3, 64)), Projection.of(main_view), (0.5, depth))
    assert 0.97 * wanted <= found <= 1.01 * wanted, "JAX 0.12 counts 1.7 % fewer"


def test_slefe_kernels_do_not_grow():
    found = operations(lambda control: enclose_patch(control, (3, 3)), np.zeros((4, 4, 3, 64)))
    assert found == pytest.approx(242, rel=0.01)
