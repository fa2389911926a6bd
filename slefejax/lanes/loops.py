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

from slefejax.lanes.tuning import TUNING


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


def repeated(step: Callable[[Any, Any], Any], start: Any, given: Any, differentiable: bool = True) -> Any:
    """``step(found, one)`` for one entry of ``given`` after the other, beginning with ``start``.

    If it need not be differentiable, a loop of a single step stays one: the compiler would make straight code of it,
    which is too long to be vectorised.

    >>> repeated(lambda found, one: found + one, jnp.array(1.0), jnp.array([2.0])).item()
    3.0
    """
    if differentiable:
        return jax.lax.scan(lambda found, one: (step(found, one), None), start, given)[0]
    count = _unknown(len(jax.tree.leaves(given)[0]))
    return jax.lax.fori_loop(0, count, lambda k, found: step(found, jax.tree.map(lambda x: x[k], given)), start)


def by_itself(kernel: Callable[..., Any]) -> Callable[..., Any]:
    """The same kernel, not differentiable, in a loop of a single step.

    What is written into the stacked results of a loop over chunks on the way is not vectorised.

    >>> by_itself(lambda chunk: 2.0 * chunk)(jnp.array(1.5)).item()
    3.0
    """

    def alone(*arguments: Any) -> Any:
        made = jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), jax.eval_shape(kernel, *arguments))
        return jax.lax.fori_loop(0, _unknown(1), lambda _, __: kernel(*arguments), made)

    return alone if jax.default_backend() == "cpu" else kernel


def _unknown(count: int) -> Any:
    """A number that the compiler does not know."""
    return once(jnp.int32(count))


def for_some(kernel: Callable[..., Any], which: Any, found: Any, packed: Any, *arguments: Any) -> Any:
    """``found``, and of some items what the kernel makes of them, who are gathered into chunks of their own.

    which, found : ``(chunks, lanes)``
    packed       : as of ``over_chunks``

    >>> chunks = jnp.arange(64.0).reshape(2, 1, 32)
    >>> some = for_some(lambda chunk: -chunk[0], chunks[:, 0] % 40 == 9, chunks[:, 0], chunks)
    >>> some[some < 0].tolist()
    [-9.0, -49.0]
    """
    lanes = which.shape[-1]
    size = min(lanes, TUNING.gathered)
    first = jnp.nonzero(which.ravel(), size=which.size, fill_value=0)[0]

    def block(k: Any, found: Any) -> Any:
        chunk, lane = jnp.divmod(jax.lax.dynamic_slice(first, (k * size,), (size,)), lanes)
        own = jax.tree.map(lambda x: jnp.moveaxis(x[chunk, ..., lane], 0, -1), packed)
        values = jnp.where(which[chunk, lane], kernel(own, *arguments), found[chunk, lane])
        return found.at[chunk, lane].set(values)

    return jax.lax.fori_loop(0, (jnp.sum(which) + size - 1) // size, block, found)


class Chunked:
    """A kernel ``kernel(chunk, *arguments, **static)`` that is called with all chunks: ``(packed, *arguments)``.

    With ``slopes`` the loop runs on constants, so that differentiation neither sees nor repeats it, and derivatives are
    those of another kernel: one that takes the compiler less long, or looks at what counts alone. With ``rest`` it may
    leave items to another kernel.

    >>> double = Chunked(lambda chunk: 2.0 * chunk[0])
    >>> double(jnp.ones((2, 1, 16))).sum().item()
    64.0
    """

    def __init__(self, kernel: Callable[..., Any], apart: bool = False) -> None:
        self.kernel = kernel
        self._apart = apart
        self._slopes: Callable[..., Any] | None = None
        self._rest: Callable[..., Any] | None = None
        update_wrapper(self, kernel)

    def slopes(self, kernel: Callable[..., Any]) -> Callable[..., Any]:
        """Decorates the kernel for derivatives, ``kernel(chunk, found, *arguments, **static)``: of the first result.

        found : what the kernel itself found for the chunk
        """
        self._slopes = kernel
        return kernel

    def rest(self, kernel: Callable[..., Any]) -> Callable[..., Any]:
        """Decorates the kernel for items that the first one leaves; that one, with slopes, returns which ones they are.

        Both return one array; the first returns None beside it where it leaves nothing.
        """
        self._rest = kernel
        return kernel

    def __call__(self, packed: Any, *arguments: Any, **static: Any) -> Any:
        """Results of all chunks, stacked along the first axis; of several that have slopes the first."""
        kernel = partial(self.kernel, **static)
        if self._slopes is None:
            return over_chunks(kernel, packed, *arguments, apart=self._apart)
        constants = jax.lax.stop_gradient((packed, *arguments))
        found = over_chunks(by_itself(kernel), *constants, apart=self._apart)
        if self._rest is not None:
            found, left = found
            found = found if left is None else for_some(partial(self._rest, **static), left, found, *constants)
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
