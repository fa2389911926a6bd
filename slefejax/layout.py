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
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Shaped

LANES = 1024
_FEWEST_LANES = 32


def _padded_shape(count: int) -> tuple[int, int]:
    """(chunks, lanes) for ``count`` items: lanes a power of two, chunks with at most a quarter of padding."""
    lanes = min(LANES, max(_FEWEST_LANES, 1 << (count - 1).bit_length()))
    chunks = -(-count // lanes)
    step = 1 << max(0, chunks.bit_length() - 3)
    return -(-chunks // step) * step, lanes


def pack(items: Shaped[Array | np.ndarray, "count *rest"]) -> Shaped[Array | np.ndarray, "chunks *rest lanes"]:
    """Items first ``(count, *rest)`` become chunks ``(chunks, *rest, lanes)``, padded with the last item."""
    xp: Any = jnp if isinstance(items, Tracer) else np
    items = items if xp is jnp else np.asarray(items)
    count = items.shape[0]
    chunks, lanes = _padded_shape(count)
    padding = xp.broadcast_to(items[-1:], (chunks * lanes - count, *items.shape[1:]))
    padded = xp.concatenate([items, padding]).reshape(chunks, lanes, *items.shape[1:])
    return xp.moveaxis(padded, 1, -1)


def unpack(chunks: Shaped[Array | np.ndarray, "chunks *rest lanes"], count: int) -> Any:
    """The inverse of ``pack``: ``(count, *rest)`` without the padding."""
    return _unpacked(chunks, count, jnp) if isinstance(chunks, Tracer) else jnp.asarray(unpack_on_host(chunks, count))


def unpack_on_host(chunks: Any, count: int) -> Shaped[np.ndarray, "count *rest"]:
    """The same as a NumPy array."""
    return _unpacked(np.asarray(chunks), count, np)


def _unpacked(chunks: Any, count: int, xp: Any) -> Any:
    items = xp.moveaxis(chunks, -1, 1)
    return items.reshape(-1, *items.shape[2:])[:count]


def over_chunks(kernel: Callable[..., Any], packed: Any, *arguments: Any) -> Any:
    """``kernel(chunk, *arguments)`` for one chunk after the other; results are stacked along the first axis.

    packed : ``(chunks, *rest, lanes)``, or a tree of such arrays
    """
    # for gradients: what is computed again stays in the cache, which is up to four times faster than to store it
    again = jax.checkpoint(lambda chunk: kernel(chunk, *arguments), prevent_cse=False)
    return jax.lax.map(again, packed)
