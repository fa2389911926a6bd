"""The one place that knows how patches lie in memory: first outside, last inside.

Users hold patches as ``(patches, du+1, dv+1, dim)``. The kernels want long, contiguous runs over
which every operation is the same, and a working set that stays in the cache: control points as
``(chunks, du+1, dv+1, dim, lanes)``, one chunk at a time, patches along the last axis. A kernel sees
one chunk, ``(du+1, dv+1, dim, lanes)``, is plain arithmetic on slices along the parameter axes, and
never indexes the last axis.

A batch that does not fill its chunks is padded with copies of its last patch, and the number of chunks
is rounded up to a few sizes, so that sweeps over many patch counts compile a few times, not each time.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Shaped

from slefejax.lanes.tuning import TUNING

_ALIGNMENT = 64  # bytes


def most_lanes(coefficients: int) -> int:
    """How many patches a chunk has at most whose nets have so many coefficients: a power of two.

    >>> most_lanes(16), most_lanes(100)
    (2048, 128)
    """
    if coefficients <= TUNING.unrolled_coefficients:
        return TUNING.lanes
    return max(TUNING.fewest_lanes, min(TUNING.lanes, 1 << (TUNING.numbers // coefficients).bit_length() >> 1))


def _padded_shape(count: int, most: int) -> tuple[int, int]:
    """(chunks, lanes) for ``count`` items: lanes are a power of two; 2, 3, 4, 6, 8, 12, 16 chunks, then 8 an octave.

    So at most a third of few chunks and an eighth of many are padding. Even numbers are shared by two cores.
    """
    lanes = min(most, max(TUNING.fewest_lanes, 1 << (count - 1).bit_length() >> 1))
    chunks = max(TUNING.fewest_chunks, -(-count // lanes))
    step = 1 << max(0, chunks.bit_length() - (2 if chunks <= TUNING.few_chunks else 4))
    return -(-chunks // step) * step, lanes


def pack(
    items: Shaped[Array | np.ndarray, "count *rest"], most: int = TUNING.lanes
) -> Shaped[Array, "chunks *rest lanes"]:
    """Items first ``(count, *rest)`` become chunks ``(chunks, *rest, lanes)``, padded with the last item.

    most : lanes of a chunk (``most_lanes``)

    >>> pack(np.zeros((5, 4, 4, 3))).shape  # two chunks of 16 lanes
    (2, 4, 4, 3, 16)
    """
    chunks, lanes = _padded_shape(items.shape[0], most)
    if not isinstance(items, Tracer):
        return jax.device_put(_packed_on_host(np.asarray(items), chunks, lanes), may_alias=True)
    padding = jnp.broadcast_to(items[-1:], (chunks * lanes - items.shape[0], *items.shape[1:]))
    padded = jnp.concatenate([items, padding]).reshape(chunks, lanes, *items.shape[1:])
    return jnp.moveaxis(padded, 1, -1)


def through(run: Callable[[Any], Any], items: Any, dtype: Any = None, most: int = TUNING.lanes) -> Any:
    """``run`` of packed items, block by block: for work of which every call has another number of items.

    Blocks have one of a few sizes, so that few programs are compiled whatever the numbers; the last two may overlap.

    run   : takes chunks, or a tuple of them, to chunks or ``Parts``
    items : an array ``(count, *rest)``, or a tuple of such arrays
    dtype : of the blocks; None: that of the items
    most  : lanes of a chunk

    >>> through(lambda chunks: 2.0 * chunks[:, 0], np.arange(3.0).reshape(3, 1)).tolist()
    [0.0, 2.0, 4.0]
    """
    count = len(jax.tree.leaves(items)[0])
    size = next((size for size in TUNING.blocks if size >= count), TUNING.blocks[-1])
    found = None
    for start in [*range(0, count - size, size), max(count - size, 0)] if count else [0]:
        block = jax.tree.map(lambda x, start=start: _filled(x[start : start + size], size, dtype), items)
        own = unpack_on_host(run(jax.tree.map(partial(pack, most=most), block)), size)
        found = np.empty((count, *own.shape[1:]), own.dtype) if found is None else found
        found[start : start + size] = own[: count - start]
    return found


def _filled(items: np.ndarray, size: int, dtype: Any) -> np.ndarray:
    """As many items as that: the last one again and again, or zeros if there is none."""
    missing = size - len(items)
    fill = items[-1:] if len(items) else np.zeros((1, *items.shape[1:]))
    items = np.concatenate([items, np.repeat(fill, missing, axis=0)]) if missing else items
    return items if dtype is None else items.astype(dtype, copy=False)


def _packed_on_host(items: np.ndarray, chunks: int, lanes: int) -> np.ndarray:
    """One chunk after the other, each of which the cache holds while it is transposed."""
    rest = items.shape[1:]
    packed = _aligned((chunks, int(np.prod(rest)), lanes), items.dtype)
    for chunk, own in enumerate(packed):
        part = items[chunk * lanes : (chunk + 1) * lanes].reshape(-1, len(own))
        own[:, : len(part)] = part.T
        own[:, len(part) :] = items[-1].reshape(-1, 1)
    return packed.reshape(chunks, *rest, lanes)


def _aligned(shape: tuple[int, ...], dtype: np.dtype) -> np.ndarray:
    """An array where JAX can use it without a copy."""
    room = np.empty(int(np.prod(shape)) * dtype.itemsize + _ALIGNMENT, np.uint8)
    start = -room.ctypes.data % _ALIGNMENT
    return room[start : len(room) - _ALIGNMENT + start].view(dtype).reshape(shape)


class Parts(NamedTuple):
    """What several cores made, chunks of one after those of the other; never copied into one array.

    >>> unpack_on_host(Parts((np.zeros((1, 16)), np.ones((1, 16)))), 20).tolist().count(1.0)
    4
    """

    each: tuple[Any, ...]


def unpack(chunks: Any, count: int) -> Any:
    """The inverse of ``pack``, of an array or of ``Parts``: ``(count, *rest)`` without the padding.

    >>> unpack(pack(np.arange(6.0).reshape(3, 2)), 3).tolist()
    [[0.0, 1.0], [2.0, 3.0], [4.0, 5.0]]
    """
    if isinstance(chunks, Tracer):
        return _unpacked(chunks, count, jnp)
    # jnp.asarray would compile a program for every count
    return jax.device_put(unpack_on_host(chunks, count))


def unpack_on_host(chunks: Any, count: int) -> Shaped[np.ndarray, "count *rest"]:
    """The same as a NumPy array.

    >>> unpack_on_host(pack(np.arange(3.0).reshape(3, 1)), 3).ravel().tolist()
    [0.0, 1.0, 2.0]
    """
    if isinstance(chunks, Parts):
        return np.concatenate([_unpacked(np.asarray(part), count, np) for part in chunks.each])[:count]
    return _unpacked(np.asarray(chunks), count, np)


def _unpacked(chunks: Any, count: int, xp: Any) -> Any:
    items = xp.moveaxis(chunks, -1, 1)
    return items.reshape(-1, *items.shape[2:])[:count]
