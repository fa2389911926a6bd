"""Dataclasses as plain pytrees: what JAX puts in place of their numbers on the way is not looked at."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import fields
from typing import Any, TypeVar

import jax

T = TypeVar("T")


def plain(*data: str) -> Callable[[type[T]], type[T]]:
    """Makes a dataclass a pytree: these fields are its children, all others are static.

    A value that JAX puts together again is not checked as one that is made is, and its fields may hold whatever JAX
    hands over: tracers, None, shapes, stacked numbers.

    >>> from dataclasses import dataclass
    >>> @plain("x")
    ... @dataclass(frozen=True)
    ... class Point:
    ...     x: float
    ...     name: str
    >>> jax.tree.map(lambda x: 2 * x, Point(1.5, "a"))
    Point(x=3.0, name='a')
    """

    def register(cls: type[T]) -> type[T]:
        static = tuple(own.name for own in fields(cls) if own.name not in data)  # type: ignore[arg-type]

        def kept_of(value: T) -> tuple[Any, ...]:
            return tuple([getattr(value, name) for name in static])

        def flatten(value: T) -> tuple[list[Any], tuple[Any, ...]]:
            return [getattr(value, name) for name in data], kept_of(value)

        def with_keys(value: T) -> tuple[list[tuple[Any, Any]], tuple[Any, ...]]:
            return [(jax.tree_util.GetAttrKey(name), getattr(value, name)) for name in data], kept_of(value)

        def unflatten(kept: tuple[Any, ...], children: Iterable[Any]) -> T:
            value = object.__new__(cls)
            for name, own in zip((*data, *static), (*children, *kept), strict=True):
                object.__setattr__(value, name, own)
            return value

        jax.tree_util.register_pytree_with_keys(cls, with_keys, unflatten, flatten)  # keys cost time in every call
        return cls

    return register
