"""Which triangles a bound is for, and how far they are off for given derivatives (docs/certified.md)."""

from __future__ import annotations

from dataclasses import dataclass

import jax
import jax.numpy as jnp

from slefejax.arguments import Number
from slefejax.lanes import nets
from slefejax.lanes.maxima import EXACT, Maxima, larger, smaller
from slefejax.lanes.nets import Lanes

Extent = tuple[Number, Number]  # sides of the box that holds a triangle, in units of 1/n, along u and v
_CUBIC = 1.0 / (12.0 * 27.0**0.5)  # the largest (1 - z^2) z / 24


@dataclass(frozen=True)
class HalfCells:
    """Halves, along either diagonal, of boxes with sides from ``evenness`` times extent/n to extent/n.

    >>> HalfCells().bend(jnp.array(1.0), jnp.array(0.0), jnp.array(1.0)).item()  # u^2 + v^2: both halves
    2.0
    """

    extent: Extent = (1.0, 1.0)
    evenness: Number = 1.0

    def bend(self, a: Lanes | None, b: Lanes, c: Lanes | None, maxima: Maxima = EXACT) -> Lanes:
        """8 times the largest error that a quadratic with Hessian (a, b, c) has on such a half; None for what is 0.

        A narrower box has larger errors if a and c cancel less.
        """
        if a is None or c is None:
            return sum_of_sizes(a, b, c, maxima)
        size_a, twist, size_c, together = maxima.sizes([a, b + b, c, a + c])
        if not (isinstance(self.evenness, float) and self.evenness == 1.0):
            less = self.evenness * self.evenness * smaller(size_a, size_c)
            together = larger(together, larger(size_a, size_c) - less)
        return maxima.largest([together + twist, size_a, size_c])

    @property
    def directions(self) -> list[tuple[Number, Number, Number]]:
        """Of (a, b, c): the same for vectors is the longest of these sums."""
        found: list[tuple[Number, Number, Number]] = [
            (1.0, 0.0, 0.0),
            (0.0, 0.0, 1.0),
            (1.0, 2.0, 1.0),
            (1.0, -2.0, 1.0),
        ]
        if not (isinstance(self.evenness, float) and self.evenness == 1.0):
            less = self.evenness * self.evenness
            found += [own for twist in (2.0, -2.0) for own in ((1.0, twist, less), (less, twist, 1.0))]
        return found

    def third(self, along_u: Lanes, along_v: Lanes, maxima: Maxima = EXACT) -> tuple[Lanes, Lanes | None]:
        """What third derivatives add, over n^3, and what the second derivatives count as at least, over n W."""
        more = maxima.largest([along_u, along_v])
        return (_CUBIC - 1.0 / 288.0) * more + (along_u + along_v) / 288.0, more


@dataclass(frozen=True)
class AnyTriangle:
    """Triangles of any shape that lie in boxes with sides of at most extent/n.

    >>> AnyTriangle().bend(jnp.array(1.0), jnp.array(0.0), jnp.array(-1.0)).item()
    1.0
    """

    extent: Extent = (1.0, 1.0)

    def bend(self, a: Lanes | None, b: Lanes, c: Lanes | None, maxima: Maxima = EXACT) -> Lanes:
        """8 times that error, or a little more: the largest abs(a x^2 + 2 b x y + c y^2) for sizes x, y up to 1."""
        if a is None or c is None:
            return sum_of_sizes(a, b, c, maxima)
        b = jnp.abs(b)
        zero, p, q = jnp.zeros_like(b), jnp.abs(a), jnp.abs(c)
        saddle = b + larger(p + larger(b - q, zero), q + larger(b - p, zero))
        return jax.lax.select((a > 0) == (c > 0), p + q + 2.0 * b, saddle)

    @property
    def directions(self) -> list[tuple[Number, Number, Number]]:
        """Of (a, b, c): the same for vectors is at most the longest of these sums, Bézier coefficients."""
        halves = [(1.0, 1.0, 0.0), (1.0, -1.0, 0.0), (0.0, 1.0, 1.0), (0.0, -1.0, 1.0)]
        return [(1.0, 0.0, 0.0), (0.0, 0.0, 1.0), (1.0, 2.0, 1.0), (1.0, -2.0, 1.0), *halves]

    def third(self, along_u: Lanes, along_v: Lanes, maxima: Maxima = EXACT) -> tuple[Lanes, Lanes | None]:
        """As of ``HalfCells``."""
        return (along_u + along_v) / 48.0, None


Triangles = HalfCells | AnyTriangle


def sum_of_sizes(a: Lanes | None, b: Lanes, c: Lanes | None, maxima: Maxima = EXACT) -> Lanes:
    """abs(a) + 2 abs(b) + abs(c); None for what is 0.

    >>> sum_of_sizes(jnp.array(-1.0), jnp.array(2.0), None).item()
    5.0
    """
    return nets.total(maxima.sizes([b + b, *(x for x in (a, c) if x is not None)]))
