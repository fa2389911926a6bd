from __future__ import annotations

from dataclasses import replace

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from slefejax.lanes import layout, loops, passes
from slefejax.lanes.tuning import TUNING


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

    result = layout.unpack(loops.over_chunks(kernel, packed, 1.0), 2500)
    assert set(shapes) == {(1, TUNING.lanes)}
    assert np.array_equal(result, items[:, 0] + 1.0)


@passes.as_pass(2)
def _scaled(chunks, factor, power):
    first, second = chunks
    both = loops.over_chunks(lambda own: own[0] * factor**power, first)
    return both, both if second is None else loops.over_chunks(lambda own: own[0] + own[1], (both, second))


@pytest.mark.parametrize("count", [5, 4096, 9000, 40_000])
@pytest.mark.parametrize("cores", [1, 2, 3])
def test_cores_change_nothing(count, cores, rng, monkeypatch):
    """Nor do parts, which a second pass takes as they are."""
    monkeypatch.setattr(passes, "cores", lambda: cores)
    items = rng.normal(size=(count, 1))
    packed = layout.pack(items)
    first, same = _scaled((packed, None), 3.0, 2)
    wanted = 9.0 * items[:, 0]
    for found in (first, same):
        np.testing.assert_array_equal(layout.unpack_on_host(found, count), wanted)
    both = _scaled((packed, first), 3.0, 2)[1]
    np.testing.assert_array_equal(layout.unpack_on_host(both, count), 2.0 * wanted)


def test_parts_are_shared(rng, monkeypatch):
    monkeypatch.setattr(passes, "cores", lambda: 2)
    packed = layout.pack(rng.normal(size=(9000, 1)))
    found = _scaled((packed, None), 3.0, 2)[0]
    assert isinstance(found, layout.Parts)
    assert [part.shape for part in found.each] == [(3, TUNING.lanes)] * 2


def test_every_thread_has_the_precision_of_the_caller(rng, monkeypatch):
    monkeypatch.setattr(passes, "cores", lambda: 2)
    with jax.enable_x64(False):
        packed = layout.pack(rng.normal(size=(9000, 1)).astype(np.float32))
        found = _scaled((packed, None), 3.0, 2)[0]
        assert {part.dtype for part in found.each} == {np.dtype(np.float32)}
    packed = layout.pack(rng.normal(size=(9000, 1)))
    assert {part.dtype for part in _scaled((packed, None), 3.0, 2)[0].each} == {np.dtype(np.float64)}


def test_a_pass_inside_of_jit_and_grad(rng):
    items = rng.normal(size=(9000, 1))
    found = jax.jit(lambda x: layout.unpack(_scaled((layout.pack(x), None), 3.0, 2)[0], 9000))(items)
    np.testing.assert_array_equal(found, 9.0 * items[:, 0])
    slope = jax.grad(lambda x: layout.unpack(_scaled((layout.pack(x), None), 3.0, 2)[0], 9000).sum())(items)
    np.testing.assert_array_equal(slope, np.full((9000, 1), 9.0))


def test_other_devices_take_chunks_side_by_side(rng, monkeypatch):
    packed = layout.pack(rng.normal(size=(9000, 2)))
    kernel = lambda own, offset: own[0] * own[1] + offset  # noqa: E731
    wanted = loops.over_chunks(kernel, packed, 1.0)
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    np.testing.assert_allclose(loops.over_chunks(kernel, packed, 1.0), wanted, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("count", [0, 1, 129, 2048, 40_000])
def test_through_a_pass_in_blocks(rng, count):
    items = rng.normal(size=(count, 2))
    found = layout.through(lambda packed: _scaled((packed, None), 3.0, 2)[0], items)
    np.testing.assert_array_equal(found, 9.0 * items[:, 0])


def test_any_numbers_of_items_are_a_few_programs(rng, monkeypatch):
    monkeypatch.setattr(passes, "cores", lambda: 2)
    own = passes.as_pass()(lambda chunks: 2.0 * chunks[:, 0])
    for count in rng.integers(1, 100_000, 60):
        items = rng.normal(size=(count, 2))
        np.testing.assert_array_equal(layout.through(own, items), 2.0 * items[:, 0])
    assert own.compiled() <= 5


def test_compiler_options_that_are_not_known_are_left_out_with_one_warning(monkeypatch):
    """Also of a program that another thread's failure has made known as unknown; other errors are errors."""
    options = {"cpu": {"xla_no_such_thing": True, "xla_cpu_prefer_vector_width": 256}}
    monkeypatch.setattr(passes, "TUNING", replace(TUNING, compiler_options=options))
    monkeypatch.setattr(passes, "_unknown", set())
    first, second = (passes.as_pass()(lambda own, k=k: k * own) for k in (2.0, 3.0))
    with pytest.warns(UserWarning, match="does not know the compiler option xla_no_such_thing"):
        np.testing.assert_array_equal(first(np.ones((1, 1, 32))), np.full((1, 1, 32), 2.0))
    np.testing.assert_array_equal(second(np.ones((1, 1, 32))), np.full((1, 1, 32), 3.0))
    assert passes._options() == {"xla_cpu_prefer_vector_width": 256}
    monkeypatch.setattr(passes, "TUNING", replace(TUNING, compiler_options={"gpu": options["cpu"]}))
    assert passes._options() == {}


def test_programs_are_forgotten_before_there_are_too_many(monkeypatch):
    """Passes that have nothing to do with the one that compiles, too."""
    other = passes.as_pass()(lambda own: own + 1.0)
    one = passes.as_pass()(lambda own: 2.0 * own)
    other(np.zeros((1, 1, 32)))
    assert other.compiled() == 1
    monkeypatch.setattr(passes, "TUNING", replace(TUNING, most_maps=0))
    np.testing.assert_array_equal(one(np.ones((1, 1, 32))), np.full((1, 1, 32), 2.0))
    assert (one.compiled(), other.compiled()) == (0, 0)
