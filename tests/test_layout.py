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
    assert len(shapes) <= 22


@pytest.mark.parametrize("count", [1, 40, 1023, 3000, 9000, 141_000])
def test_padding_is_bounded(count):
    chunks, _, lanes = layout.pack(np.zeros((count, 1))).shape
    assert (
        chunks * lanes < max(2 * count, 33) if count <= layout.LANES else chunks * lanes <= 1.25 * count + layout.LANES
    )


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
