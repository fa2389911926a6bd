"""Kernels over chunks: one after the other where a CPU computes, with constants, and derivatives of their own.

A kernel is written for one chunk, patches along the last axis (``slefejax.lanes.layout``), like the equation that it
computes. ``@chunked`` makes it one for all chunks.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, update_wrapper
from typing import Any

import jax
import jax.numpy as jnp


def over_chunks(kernel: Callable[..., Any], packed: Any, *arguments: Any, apart: bool = False) -> Any:
    """``kernel(chunk, *arguments)`` for one chunk after the other; results are stacked along the first axis.

    packed : ``(chunks, *rest, lanes)``, or a tree of such arrays
    apart  : every chunk has its own copy of the arguments. Programs that a user compiles then have nothing that could
             be moved out of the loop, which takes the compiler longer than the rest where it is differentiated

    Where no CPU computes, chunks are worked on side by side.

    >>> over_chunks(lambda chunk, offset: chunk[0] + offset, jnp.zeros((2, 1, 16)), 3.0).shape
    (2, 16)
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
    """The same; the compiler makes them one time, instead of again inside of everything that uses them.

    >>> once((jnp.array(1.0), 2.0))[0].item()
    1.0
    """
    # one a leaf: a barrier over values of which some are not differentiated fails from JAX 0.11.2 on
    return jax.tree.map(jax.lax.optimization_barrier, values)


class Chunked:
    """A kernel ``kernel(chunk, *arguments, **static)`` that is called with all chunks: ``(packed, *arguments)``.

    With ``slopes`` the loop runs on constants, so that differentiation neither sees nor repeats it, and derivatives are
    those of another kernel: one that takes the compiler less long, or looks at what counts alone.

    >>> double = Chunked(lambda chunk: 2.0 * chunk[0])
    >>> double(jnp.ones((2, 1, 16))).sum().item()
    64.0
    """

    def __init__(self, kernel: Callable[..., Any], apart: bool = False) -> None:
        self.kernel = kernel
        self._apart = apart
        self._slopes: Callable[..., Any] | None = None
        update_wrapper(self, kernel)

    def slopes(self, kernel: Callable[..., Any]) -> Callable[..., Any]:
        """Decorates the kernel for derivatives, ``kernel(chunk, found, *arguments, **static)``: of the first result.

        found : what the kernel itself found for the chunk
        """
        self._slopes = kernel
        return kernel

    def __call__(self, packed: Any, *arguments: Any, **static: Any) -> Any:
        """Results of all chunks, stacked along the first axis; of several that have slopes the first."""
        kernel = partial(self.kernel, **static)
        if self._slopes is None:
            return over_chunks(kernel, packed, *arguments, apart=self._apart)
        constants = jax.lax.stop_gradient((packed, *arguments))
        found = over_chunks(kernel, *constants, apart=self._apart)
        return _with_slopes(partial(self._slopes, **static), found, packed, arguments)


def chunked(kernel: Callable[..., Any] | None = None, *, apart: bool = False) -> Any:
    """Decorates a kernel that ``Chunked`` runs.

    apart : as of ``over_chunks``

    >>> @chunked
    ... def power(chunk, *, order):
    ...     return chunk[0] ** order
    >>> power(jnp.full((2, 1, 16), 3.0), order=2)[0, 0].item()
    9.0
    """
    return partial(Chunked, apart=apart) if kernel is None else Chunked(kernel, apart)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _with_slopes(slopes: Callable[..., Any], found: Any, packed: Any, arguments: tuple[Any, ...]) -> Any:
    return jax.tree.leaves(found)[0]


@_with_slopes.defjvp
def _derivative(slopes: Callable[..., Any], at: tuple[Any, ...], along: tuple[Any, ...]) -> Any:
    found, *given = at

    def there(packed: Any, arguments: tuple[Any, ...]) -> Any:
        kernel = lambda both, *own: slopes(both[0], both[1], *own)  # noqa: E731
        return over_chunks(kernel, (packed, found), *arguments, apart=True)

    return jax.tree.leaves(found)[0], jax.jvp(there, tuple(given), along[1:])[1]
