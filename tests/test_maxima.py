"""Maxima: soft ones are upper bounds, smooth, and keep their distance where numbers are equal, zero, tiny or huge."""

from __future__ import annotations

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from slefejax.lanes.maxima import EXACT, Soft, at_least, larger, largest, largest_along, root, smaller, smallest_along

# subnormal numbers count as 0
sizes_of_numbers = st.lists(st.just(0.0) | st.floats(1e-90, 1e6), min_size=2, max_size=6)
temperatures = st.sampled_from([1.0, 0.3, 0.01, 1e-4])
EPS = 1e-12  # of rounding, relative


@given(sizes_of_numbers, temperatures, st.sampled_from([1e-200, 1.0, 1e200]))
def test_a_soft_maximum_is_at_least_the_maximum_and_at_most_n_to_the_t_times_it(values, t, unit):
    scaled = [jnp.asarray(v * unit) for v in values]
    found = float(Soft(t).largest(scaled))
    exact = max(values) * unit
    assert exact * (1 - EPS) <= found <= exact * len(values) ** t * (1 + EPS)
    along = float(Soft(t).largest_along(jnp.stack(scaled), (0,)))
    assert along == pytest.approx(found, rel=1e-9, abs=0.0)


@given(st.lists(st.floats(-1e6, 1e6), min_size=2, max_size=6), temperatures)
def test_a_soft_extent_is_at_least_the_extent(values, t):
    found, exact = float(Soft(t).extent([jnp.asarray(v) for v in values])), max(values) - min(values)
    spread = np.std(values)
    assert exact - EPS * 1e6 <= found <= exact + 2 * t * spread * np.log(len(values)) + EPS * 1e6


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=5), temperatures)
def test_smooth_sizes_are_at_least_the_sizes(values, t):
    for found, value in zip(Soft(t).sizes([jnp.asarray(v) for v in values]), values, strict=True):
        assert abs(value) - EPS * 1e3 <= float(found) <= abs(value) + t * np.linalg.norm(values) + EPS * 1e3


@pytest.mark.parametrize("values", [[0.0, 0.0, 0.0], [2.0, 2.0, 2.0], [1e-300, 0.0, 1e-300], [1e300, 1.0, 0.0]])
@pytest.mark.parametrize("t", [1.0, 0.01, 1e-4])
def test_gradients_are_finite_where_numbers_tie_or_vanish(values, t):
    at = jnp.asarray(values)
    soft = {
        "largest": lambda x: Soft(t).largest(list(x)),
        "along": lambda x: Soft(t).largest_along(x, (0,)),
        "extent": lambda x: Soft(t).extent(list(x)),
        "sizes": lambda x: sum(Soft(t).sizes(list(x))),
        "root": lambda x: jnp.sum(root(x)),
    }
    for name, function in soft.items():
        assert np.isfinite(jax.grad(function)(at)).all(), name
    by_temperature = jax.grad(lambda temperature: Soft(temperature).largest(list(at)))(t)
    assert np.isfinite(by_temperature)


def test_sizes_of_alike_numbers_are_smooth_where_some_are_all_zero():
    """A row of zeros beside another row; the blur of both is the mean of theirs."""
    values = [jnp.array([0.0, 3.0]), jnp.array([0.0, 4.0])]
    added = float(Soft(0.1).blur(values, (0,))[0])
    assert added == pytest.approx(0.1 * np.sqrt((0 + 25) / 2))
    found = np.stack(Soft(0.1).sizes(values, (0,)))
    np.testing.assert_allclose(found, np.sqrt(np.stack(values) ** 2 + added**2))
    slope = jax.grad(lambda x: Soft(0.1).sizes([x, values[1]], (0,))[0][0])(jnp.array([1e-9, 3.0]))
    assert abs(slope[0]) < 1e-6, "flat at the bottom, where abs has a corner"


def test_ties_are_shared_by_the_soft_maximum_alone():
    at = jnp.array([3.0, 3.0, 1.0])
    # N^T = 2^.5 for the two that are equal, shared between them
    np.testing.assert_allclose(
        jax.grad(lambda x: Soft(0.01).largest(list(x)))(at), [2**0.01 / 2, 2**0.01 / 2, 0], atol=1e-12
    )
    assert jax.grad(lambda x: largest(list(x)))(at).tolist() == [0.0, 1.0, 0.0]
    assert jax.grad(lambda x: larger(x[0], x[1]))(at).tolist() == [0.0, 1.0, 0.0]
    assert jax.grad(lambda x: smaller(x[0], x[1]))(at).tolist() == [0.0, 1.0, 0.0]


@pytest.mark.parametrize("t", [1.0, 0.1, 0.01])
def test_gradients_against_differences(rng, t):
    at, direction = rng.uniform(0.5, 2.0, 6), rng.normal(size=6)
    for function in (
        lambda x: Soft(t).largest(list(x)),
        lambda x: Soft(t).largest_along(x, (0,)),
        lambda x: Soft(t).extent(list(x)),
        lambda x: sum(Soft(t).sizes(list(x))),
    ):
        h = 1e-7
        numeric = (function(jnp.asarray(at + h * direction)) - function(jnp.asarray(at - h * direction))) / (2 * h)
        slope = jnp.vdot(jax.grad(function)(jnp.asarray(at)), direction)
        assert float(slope) == pytest.approx(float(numeric), rel=1e-5, abs=1e-8)  # second order: 1 / t^2 h^2


def test_exact_maxima():
    values = [jnp.array([1.0, -2.0]), jnp.array([0.0, 5.0]), jnp.array([0.5, 4.0])]
    assert largest(values).tolist() == [1.0, 5.0]
    assert EXACT.extent(values).tolist() == [1.0, 7.0]
    assert [x.tolist() for x in EXACT.sizes(values[:1])] == [[1.0, 2.0]]
    assert [x.tolist() for x in EXACT.positive_parts(values[:1])] == [[1.0, 0.0]]
    assert root(jnp.array([4.0, 0.0])).tolist() == [2.0, 0.0]
    assert jax.grad(lambda x: jnp.sum(root(x)))(jnp.array([4.0, 0.0])).tolist() == [0.25, 0.0]


@pytest.mark.parametrize("dtype", [np.float64, np.float32])
def test_no_branch_of_a_gradient_is_dropped(rng, dtype):
    """The smallest of computed numbers, in a loop that is computed again for the gradient.

    All points moved along the row change W alone, so that derivative is known: bends / W^2. With ``jnp.min`` part of
    it is missing in some lanes in jax 0.12.0 and 0.12.0.1: see ``slefejax.lanes.maxima``.
    """
    nets, row = rng.normal(size=(2, 4, 4, 3, 64)).astype(dtype), jnp.asarray([-0.5, 0.7, 0.4, 5.0], dtype)

    def quotient(net, row):
        bends = [largest_along(jnp.sum(jnp.diff(net, 2, axis) ** 2, axis=2), (0, 1)) for axis in (0, 1)]
        w = sum(row[a] * net[:, :, a] for a in range(3)) + row[3]
        return (bends[0] + bends[1]) / smallest_along(w, (0, 1))

    @jax.jit
    def slope(nets, row):
        again = jax.checkpoint(lambda net: quotient(net, row), prevent_cse=False)
        values, back = jax.vjp(lambda nets: jax.lax.map(again, nets), nets)
        return values, back(jnp.ones_like(values))[0]

    values, slopes = slope(nets, row)
    assert slopes.dtype == values.dtype == dtype
    unit = np.asarray(row[:3], float)
    w = np.tensordot(unit, nets.astype(float), axes=(0, 3)).min(axis=(1, 2)) + 5.0
    found = np.einsum("cijal,a->cl", np.asarray(slopes, float), unit) / (unit @ unit)
    # the gradients of bends cancel: a few dozen roundings of numbers up to 16 times theirs
    np.testing.assert_allclose(found, -np.asarray(values, float) / w, rtol=1e4 * np.finfo(dtype).eps, atol=1e-9)


def test_maxima_along_axes(rng):
    values = rng.normal(size=(3, 4, 5))
    assert np.array_equal(largest_along(jnp.asarray(values), (0, 1)), values.max(axis=(0, 1)))
    assert np.array_equal(smallest_along(jnp.asarray(values), (0, 1)), values.min(axis=(0, 1)))
    at = jnp.array([3.0, 3.0, 1.0])
    assert jax.grad(lambda x: largest_along(x, (0,)))(at).tolist() == [0.5, 0.5, 0.0]
    assert jax.grad(lambda x: smallest_along(x, (0,)))(at).tolist() == [0.0, 0.0, 1.0]
    assert jax.hessian(lambda x: largest_along(x, (0,)) ** 2)(at[1:]).tolist() == [[2.0, 0.0], [0.0, 0.0]]
    assert at_least(at, 2.0).tolist() == [3.0, 3.0, 2.0]
    assert jax.grad(lambda x: jnp.sum(at_least(x, 3.0)))(jnp.array([4.0, 3.0, 1.0])).tolist() == [1.0, 0.0, 0.0]
