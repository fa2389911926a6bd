from __future__ import annotations

import jax.numpy as jnp
import numpy as np
import pytest

from slefejax import layout


@pytest.mark.parametrize("count", [1, 31, 32, 33, 1000, 1024, 1025, 5000, 12_345])
def test_unpack_undoes_pack(count, rng):
    items = rng.normal(size=(count, 2, 3))
    packed = layout.pack(items)
    assert packed.shape[1:3] == (2, 3)
    assert np.array_equal(layout.unpack(packed, count), items)


def test_forty_counts_need_few_shapes():
    shapes = {layout.pack(np.zeros((count, 1))).shape for count in range(100, 140_100, 3500)}
    assert len(shapes) <= 24


@pytest.mark.parametrize(
    ("count", "most"), [(1, 32), (40, 64), (2047, 2048), (3000, 4096), (17_000, 24_576), (141_000, 147_456)]
)
def test_padding_is_bounded(count, most):
    chunks, _, lanes = layout.pack(np.zeros((count, 1))).shape
    assert count <= chunks * lanes <= most


def test_kernel_sees_one_chunk_at_a_time():
    items = np.arange(2500.0).reshape(2500, 1)
    packed = jnp.asarray(layout.pack(items))
    shapes = []

    def kernel(chunk, offset):
        shapes.append(chunk.shape)
        return chunk[0] + offset

    result = layout.unpack(layout.over_chunks(kernel, packed, 1.0), 2500)
    assert set(shapes) == {(1, layout.LANES)}
    assert np.array_equal(result, items[:, 0] + 1.0)
