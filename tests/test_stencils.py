from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import InputError
from slefejax.model.stencils import StencilTable, _apply_jit


def random_table(rng, rows, columns, widest):
    entries = []
    for row in range(rows):
        count = int(rng.integers(0, min(columns, widest) + 1))
        entries += [(row, c, rng.normal()) for c in rng.choice(columns, count, replace=False)]
    row, column, weight = zip(*entries, strict=True)
    return StencilTable.of(row, column, weight, (rows, columns))


@pytest.mark.parametrize(("widest", "rest"), [(1, (3,)), (5, ()), (40, (2, 9)), (129, (3,))])
def test_applying_is_a_matrix_product(rng, widest, rest, precision):
    table = random_table(rng, 70, 130, widest)
    values = rng.normal(size=(130, *rest)).astype(precision)
    wanted = np.tensordot(table.matrix.toarray(), values, 1)
    scale = np.abs(table.matrix.toarray()).sum(axis=1).max() * np.abs(values).max()
    # sums of up to 129 products, rounded weights among them
    atol = 64 * np.finfo(precision).eps * scale
    assert table(values).dtype == precision
    np.testing.assert_allclose(table(values), wanted, rtol=0, atol=atol)
    np.testing.assert_allclose(table.on_host(values), wanted, rtol=0, atol=atol)


def test_one_wide_row_does_not_widen_the_others(rng):
    rows = np.repeat(np.arange(1000), 4)
    columns = rng.integers(0, 500, 4000).reshape(1000, 4)
    columns = (columns[:, :1] + np.arange(4)).ravel() % 500
    pole = np.arange(129)
    table = StencilTable.of(np.append(rows, np.full(129, 1000)), np.append(columns, pole), np.ones(4129), (1001, 500))
    assert [weight.shape for _, weight in table.groups] == [(4, 1000), (129, 1)]
    assert table.padding == 0.0
    assert table.padded_bytes == 4129 * 12 + 1001 * 4


def test_algebra_of_tables(rng):
    a, b = random_table(rng, 20, 30, 6), random_table(rng, 30, 12, 6)
    c = random_table(rng, 20, 30, 6)
    x = rng.normal(size=(12, 3))
    np.testing.assert_allclose((a @ b)(x), a(np.asarray(b(x))), atol=1e-13)
    y = rng.normal(size=30)
    np.testing.assert_allclose((a + c)(y), a(y) + c(y), atol=1e-13)
    np.testing.assert_allclose((a - c)(y), a(y) - c(y), atol=1e-13)
    factors = rng.normal(size=20)
    np.testing.assert_allclose(a.scaled(factors)(y), factors * a(y), atol=1e-13)
    np.testing.assert_allclose(a.take([3, 3, 0])(y), np.asarray(a(y))[[3, 3, 0]], atol=0)
    np.testing.assert_allclose(a.stacked(c)(y), np.append(a(y), c(y)), atol=0)
    assert np.array_equal(StencilTable.identity(30)(y), y)
    whole = StencilTable.of([0, 0, 1], [0, 1, 1], [1.0, 3.0, 2.0], (2, 2)).normalised()
    assert whole.row_sums().tolist() == [1.0, 1.0]


def test_weights_of_one_pair_add_up_and_zeros_are_left_out():
    table = StencilTable.of([0, 0, 0], [1, 1, 2], [1.0, 2.0, 0.0], (1, 3))
    assert table.matrix.toarray().tolist() == [[0.0, 3.0, 0.0]]
    assert table.counts.tolist() == [1]


def test_precision_follows_the_values_and_gradients_are_the_transpose(rng):
    table = random_table(rng, 40, 25, 9)
    x = rng.normal(size=(25, 3))
    assert table(x.astype(np.float32)).dtype == np.float32
    assert table(np.arange(25)).dtype == np.float64
    pull = rng.normal(size=(40, 3))
    gradient = jax.grad(lambda v: jnp.sum(pull * table(v)))(x)
    np.testing.assert_allclose(gradient, table.matrix.toarray().T @ pull, atol=1e-13)


def test_one_compile_a_table(rng):
    apply: Any = _apply_jit

    table = random_table(rng, 33, 21, 7)
    before = apply._cache_size()
    for _ in range(4):
        table(rng.normal(size=(21, 3)))
    assert apply._cache_size() == before + 1


def test_the_wrong_number_of_inputs(rng):
    with pytest.raises(InputError, match=r"takes 21 inputs .* not shape \(20, 3\)"):
        random_table(rng, 33, 21, 7)(np.zeros((20, 3)))
    with pytest.raises(InputError, match="takes 21 inputs"):
        random_table(rng, 33, 21, 7).on_host(np.zeros(()))
