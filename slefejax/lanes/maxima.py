"""Maxima for kernels: exact ones (``Exact``), and soft ones that are smooth and never smaller (``Soft``).

A soft maximum of temperature T, 0 < T <= 1, of numbers that are not negative is their norm of order 1/T: at least the
largest of them, at most N^T times as much where there are N, and smooth, with weights that add up in its gradient
where several are equal. It does not depend on units. Where all of them are 0 it is 0 and so is its gradient. A
temperature below 128 eps counts as that.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial, reduce
from operator import add
from typing import ClassVar

import jax
import jax.numpy as jnp
from jax import Array
from jax.lax import select, stop_gradient

from slefejax.arguments import Number
from slefejax.lanes.plain import plain


def larger(a: Array, b: Array) -> Array:
    """The larger of two arrays, element by element; NaN is not passed on.

    Where they are equal the derivative is that of b.

    >>> larger(jnp.array([1.0, 5.0]), jnp.array([2.0, 3.0])).tolist()
    [2.0, 5.0]
    """
    # select instead of jnp.maximum: 4 to 6 times faster on the CPU
    return select(a > b, a, b)


def smaller(a: Array, b: Array) -> Array:
    """The smaller of two arrays, element by element; NaN is not passed on. The derivative is b's where equal.

    >>> smaller(jnp.array([1.0, 5.0]), jnp.array([2.0, 3.0])).tolist()
    [1.0, 3.0]
    """
    return select(a < b, a, b)


def at_least(values: Array, floor: Number) -> Array:
    """The larger of an array's elements and one number; NaN is not passed on.

    Where they are equal the derivative is that of the number.

    >>> at_least(jnp.array([0.5, 2.0]), 1.0).tolist()
    [1.0, 2.0]
    """
    return larger(values, jnp.full_like(values, floor))


def largest(values: list[Array]) -> Array:
    """The largest of arrays, element by element.

    >>> largest([jnp.array(1.0), jnp.array(3.0), jnp.array(2.0)]).item()
    3.0
    """
    return reduce(larger, values)


def smallest_along(values: Array, axis: tuple[int, ...]) -> Array:
    """The smallest along axes; where several are equal each has its share of the derivative.

    >>> smallest_along(jnp.array([[1.0, 5.0], [3.0, 2.0]]), (0,)).tolist()
    [1.0, 2.0]
    """
    return _chosen_along(jnp.min, axis, values)


def largest_along(values: Array, axis: tuple[int, ...]) -> Array:
    """The largest along axes; where several are equal each has its share of the derivative.

    >>> largest_along(jnp.array([[1.0, 5.0], [3.0, 2.0]]), (0, 1)).item()
    5.0
    """
    return _chosen_along(jnp.max, axis, values)


@partial(jax.custom_jvp, nondiff_argnums=(0, 1))
def _chosen_along(choose: Callable[..., Array], axis: tuple[int, ...], values: Array) -> Array:
    return choose(values, axis=axis)


@_chosen_along.defjvp
def _of_the_chosen(
    choose: Callable[..., Array], axis: tuple[int, ...], at: tuple[Array], along: tuple[Array]
) -> tuple[Array, Array]:
    """The mean of the tangents of those that are chosen; one of them is found without comparing two computations.

    JAX's own rule (``_reduce_chooser_jvp_rule``) takes all that equal the result bit for bit. So it "depend[s] on
    bitwise equivalence of forward & backward pass" (jax-ml/jax#40578, which mends the maximum of two arrays, not that
    along axes), and "silently drops a gradient branch" where the compiler "emits the operand twice with different
    rounding" (#40564); where it drops the only one it is NaN. From jax 0.12.0 on XLA's CPU backend does, inside of a
    jit before, too, and a barrier does not keep it from that. An index is one of the chosen whatever the rounding.
    """
    (values,), (tangent,) = at, along
    whole = choose(values, axis=axis)

    def flat(array: Array) -> Array:
        return jnp.moveaxis(array, axis, range(len(axis))).reshape(-1, *whole.shape)

    values, tangent = flat(values), flat(tangent)
    number = jnp.arange(len(values)).reshape(-1, *(1,) * whole.ndim)
    chosen = (number == _PLACE[choose](values, axis=0)) | (values == whole)
    return whole, jnp.sum(select(chosen, tangent, jnp.zeros_like(tangent)), axis=0) / jnp.sum(chosen, axis=0)


_PLACE = {jnp.max: jnp.argmax, jnp.min: jnp.argmin}


@plain()
@dataclass(frozen=True)
class Exact:
    """Maxima, sizes and extents as they are.

    >>> EXACT.extent([jnp.array(1.0), jnp.array(4.0)]).item()
    3.0
    """

    exact: ClassVar[bool] = True

    def largest(self, values: list[Array]) -> Array:
        """The largest of arrays, element by element."""
        return largest(values)

    def largest_along(self, values: Array, axis: tuple[int, ...]) -> Array:
        """The largest along axes."""
        return largest_along(values, axis)

    def sizes(self, values: list[Array], alike: tuple[int, ...] = ()) -> list[Array]:
        """The sizes of numbers."""
        return [jnp.abs(value) for value in values]

    def positive_parts(self, values: list[Array], alike: tuple[int, ...] = (), wider: Number = 0.0) -> list[Array]:
        """max(0, x) of every number x."""
        return [larger(value, jnp.zeros_like(value)) for value in values]

    def extent(self, values: list[Array]) -> Array:
        """The largest less the smallest of arrays, element by element."""
        return largest(values) - reduce(smaller, values)


@plain("temperature")
@dataclass(frozen=True)
class Soft:
    """Soft maxima of a temperature, of numbers that are not negative; smooth sizes and extents, never smaller either.

    Along axes that are ``alike`` numbers have one unit.

    >>> round(Soft(0.1).largest([jnp.array(1.0), jnp.array(1.0)]).item(), 4)  # 2^T where two are equal
    1.0718
    """

    temperature: Number
    exact: ClassVar[bool] = False

    def largest(self, values: list[Array]) -> Array:
        """The norm of order 1/T of arrays, element by element."""
        whole = largest(values)
        if len(values) == 1:
            return whole
        unit, temperature = _unit(whole), self._resolvable(whole)
        return _soft(whole, reduce(add, [(value / unit) ** (1.0 / temperature) for value in values]), temperature)

    def largest_along(self, values: Array, axis: tuple[int, ...]) -> Array:
        """The norm of order 1/T along axes."""
        whole = largest_along(values, axis)
        unit, temperature = _unit(whole), self._resolvable(whole)
        powers = (values / jnp.expand_dims(unit, axis)) ** (1.0 / temperature)
        return _soft(whole, jnp.sum(powers, axis=axis), temperature)

    def sizes(self, values: list[Array], alike: tuple[int, ...] = ()) -> list[Array]:
        """Smooth stand-ins for the sizes of numbers, at least these and at most ``blur`` larger.

        They have no derivative only where all of the numbers are 0, along the axes that are alike too: it is 0 then.
        """
        added = self.blur(values, alike)
        found = []
        for value in values:
            unit = _unit(larger(jnp.abs(value), jnp.broadcast_to(added, value.shape)))
            found.append(unit * root((value / unit) ** 2 + (added / unit) ** 2))
        return found

    def blur(self, values: list[Array], alike: tuple[int, ...] = ()) -> Array:
        """T times the length of all values, or of their mean along axes that are alike; these get length 1."""
        unit = _unit(jnp.max(reduce(larger, [jnp.abs(value) for value in values]), axis=alike, keepdims=True))
        square = jnp.mean(reduce(add, [(value / unit) ** 2 for value in values]), axis=alike, keepdims=True)
        return unit * self.temperature * root(square)

    def positive_parts(self, values: list[Array], alike: tuple[int, ...] = (), wider: Number = 0.0) -> list[Array]:
        """Smooth max(0, x), not smaller; half of what is ``wider`` is added."""
        if not values:
            return []
        return [0.5 * (size + wider + x) for size, x in zip(self.sizes(values, alike), values, strict=True)]

    def extent(self, values: list[Array]) -> Array:
        """The largest less the smallest of arrays, element by element."""
        middle = reduce(add, values) / len(values)
        apart = [value - middle for value in values]
        unit = _unit(largest([jnp.abs(x) for x in apart]))
        scaled = [x / unit for x in apart]
        blur = self.temperature * root(reduce(add, [x * x for x in scaled]) / len(values))
        # where all are equal nothing is added, and nothing is divided by 0
        safe = jnp.where(blur > 0, blur, 1.0)
        ends = []
        for side in ([x for x in scaled], [-x for x in scaled]):
            top = stop_gradient(largest(side))
            ends.append(top + blur * jnp.log(reduce(add, [jnp.exp((x - top) / safe) for x in side])))
        return unit * (ends[0] + ends[1]) * (blur > 0)

    def _resolvable(self, values: Array) -> Array:
        """Where 1/T is so large that numbers that differ by rounding have powers that differ much, 128 eps is T."""
        return jnp.maximum(self.temperature, 128.0 * jnp.finfo(values.dtype).eps)


Maxima = Exact | Soft
EXACT = Exact()


def maxima_of(temperature: Number | None) -> Maxima:
    """Soft ones of a temperature, exact ones for None.

    >>> maxima_of(None), maxima_of(0.01)
    (Exact(), Soft(temperature=0.01))
    """
    return EXACT if temperature is None else Soft(temperature)


def _soft(whole: Array, powers: Array, temperature: Number) -> Array:
    """From the sum of powers of the values over their largest: 1 or more, but for rounding, unless all values are 0."""
    some, eps = whole > 0, jnp.finfo(whole.dtype).eps
    return _unit(whole) * (1.0 + 8.0 * eps) * jnp.where(some, powers, 1.0) ** temperature * some


def _unit(whole: Array) -> Array:
    """What numbers are divided by, so that powers neither overflow nor vanish; the result does not depend on it."""
    return stop_gradient(jnp.where(whole > 0, whole, jnp.ones_like(whole)))


def root(square: Array) -> Array:
    """The square root, with a derivative of 0 at 0.

    >>> jax.grad(root)(0.0).item()
    0.0
    """
    safe = jnp.where(square > 0, square, 1.0)
    return jnp.where(square > 0, jnp.sqrt(safe), 0.0)
