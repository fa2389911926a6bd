"""Which cores work on chunks, and how the compiler is told to compile for them.

XLA runs a loop over chunks on one core. A ``Pass`` gives each core chunks of its own: calls of one program, from one
thread each, over views of the same arrays.
"""

from __future__ import annotations

import os
import re
import warnings
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial, update_wrapper
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jax.core import Tracer

from slefejax.lanes.layout import Parts
from slefejax.lanes.tuning import TUNING

_passes: list[Pass] = []


class Pass:
    """A function of chunks, jitted, that all cores work on; inside of jit, grad and the like it is one program.

    Its first argument is an array ``(chunks, *rest, lanes)``, ``Parts`` of another pass, None, or a tuple of these;
    its results have the chunks first; each of them is one array, or ``Parts``.

    >>> twice = Pass(lambda chunks: 2.0 * chunks)
    >>> float(np.asarray(twice(np.ones((1, 16)))).sum()), twice.compiled()
    (32.0, 1)
    """

    def __init__(self, function: Callable[..., Any], static_argnums: tuple[int, ...] = ()) -> None:
        self._inside: Any = jax.jit(function, static_argnums=static_argnums)
        self._compile = partial(jax.jit, function, static_argnums=static_argnums)
        self._program: Any = None
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
            return self._called(parts[0], *arguments)
        double = jax.config.read("jax_enable_x64")

        def work(part: Any) -> Any:
            with jax.enable_x64(double):  # which every thread has to be told
                return jax.block_until_ready(self._called(part, *arguments))

        with ThreadPoolExecutor(len(parts) - 1) as others:
            waiting = [others.submit(work, part) for part in parts[1:]]
            found = [work(parts[0]), *(result.result() for result in waiting)]
        return jax.tree.map(lambda *each: Parts(each), *found)

    def _called(self, *arguments: Any) -> Any:
        """The program's results, compiled with those options of this backend that its compiler knows."""
        while True:
            program = self._program
            if program is None:
                program = self._program = self._compile(compiler_options=_options())
            try:
                return program(*arguments)
            except jax.errors.JaxRuntimeError as error:
                _leave_out(error)
                self._program = None

    def clear_cache(self) -> None:
        """Forget what was compiled."""
        self._inside.clear_cache()
        if self._program is not None:
            self._program.clear_cache()
        self._known = 0

    def compiled(self) -> int:
        """How many programs there are."""
        return 0 if self._program is None else self._program._cache_size()


_unknown: set[str] = set()


def _options() -> dict[str, Any]:
    """The compiler's options for the backend that computes."""
    own = TUNING.compiler_options.get(jax.default_backend(), {})
    return {name: value for name, value in own.items() if name not in _unknown}


def _leave_out(error: Exception) -> None:
    """Do without an option that the compiler says it does not know; any other error is raised again."""
    name = re.search(r"No such compile option: '(\w+)'", str(error))
    if name is None:
        raise error
    if name[1] not in _unknown:
        _unknown.add(name[1])
        warnings.warn(f"this jaxlib does not know the compiler option {name[1]}: kernels may be slower", stacklevel=2)


def _forget_if_many() -> None:
    """Programs consist of hundreds of mappings of memory each; where a process has too many of them, JAX crashes."""
    maps = Path("/proc/self/maps")
    if maps.exists() and maps.read_bytes().count(b"\n") > TUNING.most_maps:
        for each in _passes:
            each.clear_cache()


def as_pass(*static_argnums: int) -> Callable[[Callable[..., Any]], Pass]:
    """Decorates a function that ``Pass`` runs; the arguments of these numbers are static.

    >>> @as_pass(1)
    ... def scaled(chunks, factor):
    ...     return factor * chunks
    >>> float(np.asarray(scaled(np.ones((1, 16)), 3)).sum())
    48.0
    """
    return partial(Pass, static_argnums=static_argnums)


def cores() -> int:
    """On how many cores this process may run.

    >>> cores() >= 1
    True
    """
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
        count = max(1, min(cores(), len(leaves[0]) // TUNING.fewest_shared))
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
    leaves, tree = jax.tree.flatten(part)
    pieces = [np.split(np.asarray(leaf), count) for leaf in leaves]
    return [tree.unflatten(own) for own in zip(*pieces, strict=True)] if leaves else [part] * count


def _on_cpu(leaf: Any) -> bool:
    return isinstance(leaf, np.ndarray) or all(device.platform == "cpu" for device in leaf.devices())
