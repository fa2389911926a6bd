"""The one place that knows how patches lie in memory, and which cores work on them: first outside, last inside.

Users hold patches as ``(patches, du+1, dv+1, dim)``. The kernels want long, contiguous runs over
which every operation is the same, and a working set that stays in the cache: control points as
``(chunks, du+1, dv+1, dim, lanes)``, one chunk at a time, patches along the last axis. A kernel sees
one chunk, ``(du+1, dv+1, dim, lanes)``, is plain arithmetic on slices along the parameter axes, and
never indexes the last axis.

A batch that does not fill its chunks is padded with copies of its last patch, and the number of chunks
is rounded up to a few sizes, so that sweeps over many patch counts compile a few times, not each time.

XLA runs a loop over chunks on one core. A ``Pass`` gives each core chunks of its own: calls of one program, from one
thread each, over views of the same arrays.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial, update_wrapper
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Shaped

LANES = 2048
_FEWEST_LANES = 16
_FEWEST_CHUNKS = 2  # at all
_ALIGNMENT = 64  # bytes
_FEW_CHUNKS = 16
_BLOCKS = (128, 1024, 8192)
_MOST_MAPS = 40_000  # of the 65,530 that Linux allows
_FEWEST_SHARED = 2  # chunks for a core: with fewer of them threads cost more than they save
# CPUs with registers of 512 bits are told to use them: up to a fifth faster than what the compiler prefers. What loops
# over the tiles of a chunk could have in common stays inside of them: to load a hundred arrays takes longer.
_OPTIONS = {"xla_cpu_prefer_vector_width": 512, "xla_disable_hlo_passes": "while-loop-invariant-code-motion"}


def _padded_shape(count: int) -> tuple[int, int]:
    """(chunks, lanes) for ``count`` items: lanes are a power of two; 2, 3, 4, 6, 8, 12, 16 chunks, then 8 an octave.

    So at most a third of few chunks and an eighth of many are padding. Even numbers are shared by two cores. There are
    no loops over one chunk: XLA makes straight code of it, which takes twice as long in gradients.
    """
    lanes = min(LANES, max(_FEWEST_LANES, 1 << (count - 1).bit_length() >> 1))
    chunks = max(_FEWEST_CHUNKS, -(-count // lanes))
    step = 1 << max(0, chunks.bit_length() - (2 if chunks <= _FEW_CHUNKS else 4))
    return -(-chunks // step) * step, lanes


def pack(items: Shaped[Array | np.ndarray, "count *rest"]) -> Shaped[Array, "chunks *rest lanes"]:
    """Items first ``(count, *rest)`` become chunks ``(chunks, *rest, lanes)``, padded with the last item."""
    chunks, lanes = _padded_shape(items.shape[0])
    if not isinstance(items, Tracer):
        return jax.device_put(_packed_on_host(np.asarray(items), chunks, lanes), may_alias=True)
    padding = jnp.broadcast_to(items[-1:], (chunks * lanes - items.shape[0], *items.shape[1:]))
    padded = jnp.concatenate([items, padding]).reshape(chunks, lanes, *items.shape[1:])
    return jnp.moveaxis(padded, 1, -1)


def through(run: Callable[[Any], Any], items: Any, dtype: Any = None) -> Any:
    """``run`` of packed items, block by block: for work of which every call has another number of items.

    Blocks have one of a few sizes, so that few programs are compiled whatever the numbers; the last two may overlap.

    run   : takes chunks, or a tuple of them, to chunks or ``Parts``
    items : an array ``(count, *rest)``, or a tuple of such arrays
    dtype : of the blocks; None: that of the items
    """
    count = len(jax.tree.leaves(items)[0])
    size = next((size for size in _BLOCKS if size >= count), _BLOCKS[-1])
    found = None
    for start in [*range(0, count - size, size), max(count - size, 0)] if count else [0]:
        block = jax.tree.map(lambda x, start=start: _filled(x[start : start + size], size, dtype), items)
        own = unpack_on_host(run(jax.tree.map(pack, block)), size)
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
    """What several cores made, chunks of one after those of the other; never copied into one array."""

    each: tuple[Any, ...]


def unpack(chunks: Any, count: int) -> Any:
    """The inverse of ``pack``, of an array or of ``Parts``: ``(count, *rest)`` without the padding."""
    if isinstance(chunks, Tracer):
        return _unpacked(chunks, count, jnp)
    # jnp.asarray would compile a program for every count
    return jax.device_put(unpack_on_host(chunks, count))


def unpack_on_host(chunks: Any, count: int) -> Shaped[np.ndarray, "count *rest"]:
    """The same as a NumPy array."""
    if isinstance(chunks, Parts):
        return np.concatenate([_unpacked(np.asarray(part), count, np) for part in chunks.each])[:count]
    return _unpacked(np.asarray(chunks), count, np)


def _unpacked(chunks: Any, count: int, xp: Any) -> Any:
    items = xp.moveaxis(chunks, -1, 1)
    return items.reshape(-1, *items.shape[2:])[:count]


def over_chunks(kernel: Callable[..., Any], packed: Any, *arguments: Any, apart: bool = False) -> Any:
    """``kernel(chunk, *arguments)`` for one chunk after the other; results are stacked along the first axis.

    packed : ``(chunks, *rest, lanes)``, or a tree of such arrays
    apart  : every chunk has its own copy of the arguments. Programs that a user compiles then have nothing that could
             be moved out of the loop, which takes the compiler longer than the rest where it is differentiated

    Where no CPU computes, chunks are worked on side by side.
    """
    in_turn = jax.default_backend() == "cpu"
    if apart and in_turn:
        count = len(jax.tree.leaves(packed)[0])
        copies = jax.tree.map(lambda x: jnp.broadcast_to(x, (count, *jnp.shape(x))), arguments)
        return over_chunks(lambda given: kernel(given[0], *once(given[1])), (packed, copies))
    # for gradients: what is computed again stays in the cache, which is up to four times faster than to store it
    again = jax.checkpoint(lambda chunk: kernel(chunk, *arguments), prevent_cse=False)
    return jax.lax.map(again, packed) if in_turn else jax.vmap(again)(packed)


def once(values: Any) -> Any:
    """The same; the compiler makes them one time, instead of again inside of everything that uses them."""
    # one a leaf: a barrier over values of which some are not differentiated fails from JAX 0.11.2 on
    return jax.tree.map(jax.lax.optimization_barrier, values)


_passes: list[Pass] = []


class Pass:
    """A function of chunks, jitted, that all cores work on; inside of jit, grad and the like it is one program.

    Its first argument is an array ``(chunks, *rest, lanes)``, ``Parts`` of another pass, None, or a tuple of these;
    its results have the chunks first; each of them is one array, or ``Parts``.
    """

    def __init__(self, function: Callable[..., Any], static_argnums: tuple[int, ...] = ()) -> None:
        self._inside: Any = jax.jit(function, static_argnums=static_argnums)
        self._program: Any = jax.jit(function, static_argnums=static_argnums, compiler_options=_OPTIONS)
        self._known = 0
        _passes.append(self)
        update_wrapper(self, function)

    def __call__(self, chunks: Any, *arguments: Any) -> Any:
        """Run it, or make it part of what is being traced."""
        if any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves((chunks, arguments))):
            return self._inside(chunks, *arguments)
        found = self._run(_split(chunks), arguments)
        if self.compiled() > self._known:
            self._known = self.compiled()
            _forget_if_many()
        return found

    def _run(self, parts: list[Any], arguments: tuple[Any, ...]) -> Any:
        if len(parts) == 1:
            return self._program(parts[0], *arguments)
        double = jax.config.read("jax_enable_x64")

        def work(part: Any) -> Any:
            with jax.enable_x64(double):  # which every thread has to be told
                return jax.block_until_ready(self._program(part, *arguments))

        with ThreadPoolExecutor(len(parts) - 1) as others:
            waiting = [others.submit(work, part) for part in parts[1:]]
            found = [work(parts[0]), *(result.result() for result in waiting)]
        return jax.tree.map(lambda *each: Parts(each), *found)

    def clear_cache(self) -> None:
        """Forget what was compiled."""
        self._inside.clear_cache()
        self._program.clear_cache()
        self._known = 0

    def compiled(self) -> int:
        """How many programs there are."""
        return self._program._cache_size()


def _forget_if_many() -> None:
    """Programs consist of hundreds of mappings of memory each; where a process has too many of them, JAX crashes."""
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > _MOST_MAPS:
        for each in _passes:
            each.clear_cache()


def as_pass(*static_argnums: int) -> Callable[[Callable[..., Any]], Pass]:
    """Decorates a function that ``Pass`` runs; the arguments of these numbers are static."""
    return partial(Pass, static_argnums=static_argnums)


def cores() -> int:
    """On how many cores this process may run."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _split(chunks: Any) -> list[Any]:
    """Views of the chunks of every core; all are of one size, so that one program is enough, of whole sizes only.

    A number of chunks that cannot be shared evenly is worked on by fewer cores.
    """
    component = chunks if isinstance(chunks, tuple) and not isinstance(chunks, Parts) else (chunks,)
    done = [len(part.each) for part in component if isinstance(part, Parts)]
    leaves = [leaf for leaf in jax.tree.leaves(component) if leaf.ndim]
    if done:
        count = done[0]
    elif all(_on_cpu(leaf) for leaf in leaves):
        count = max(1, min(cores(), len(leaves[0]) // _FEWEST_SHARED))
        while len(leaves[0]) % count:
            count -= 1
    else:
        count = 1
    if count == 1 and not done:
        return [chunks]
    split = list(zip(*(_shared(part, count) for part in component), strict=True))
    return split if isinstance(chunks, tuple) and not isinstance(chunks, Parts) else [part for (part,) in split]


def _shared(part: Any, count: int) -> list[Any]:
    if isinstance(part, Parts):
        return list(part.each)
    if part is None:
        return [None] * count
    return np.split(np.asarray(part), count)


def _on_cpu(leaf: Any) -> bool:
    return isinstance(leaf, np.ndarray) or all(device.platform == "cpu" for device in leaf.devices())
