"""The inequality for n that certificates end in, (1) of docs/certified.md, and the n that fulfils it."""

from __future__ import annotations

from typing import NamedTuple

import jax.numpy as jnp

from slefejax.lanes import loops
from slefejax.lanes.maxima import Maxima, larger, root
from slefejax.lanes.nets import Lanes

# d/du, d/dv, multiplicity
SECOND = ((2, 0, 1.0), (1, 1, 2.0), (0, 2, 1.0))
THIRD = ((3, 0, 1.0), (2, 1, 3.0), (1, 2, 3.0), (0, 3, 1.0))
FOURTH = ((4, 0, 1.0), (3, 1, 4.0), (2, 2, 6.0), (1, 3, 4.0), (0, 4, 1.0))
_TURNS = 2  # towards the n that a tile needs


class Terms(NamedTuple):
    """n^2 is to be at least second/8 + first n + third/n + fourth/n^2 + rest, and second at least ``least``/n."""

    second: Lanes
    third: Lanes
    fourth: Lanes
    least: Lanes | None
    rest: Lanes
    first: Lanes | None = None

    def square(self, over_n: Lanes, maxima: Maxima) -> Lanes:
        """The right side for some 1/n: too large for 1/n that is too large."""
        second = self.second if self.least is None else maxima.largest([self.second, self.least * over_n])
        return self.with_first(second / 8.0 + (self.third + self.fourth * over_n) * over_n + self.rest)

    def with_first(self, others: Lanes) -> Lanes:
        """The n^2 that is first n + others."""
        if self.first is None:
            return others
        half = 0.5 * self.first
        return (half + root(half * half + others)) ** 2


def solved(terms: Terms, maxima: Maxima) -> Lanes:
    """The least n^2 that is enough, or a little more.

    What comes of an n that is too large is too small, and the other way round: in turns, both come nearer.
    """
    # each root ends a loop of the compiler's, and the next one would begin with all that terms are made of
    terms = loops.once(terms)
    square = terms.with_first(terms.second / 8.0)  # less than what is enough
    for _ in range(2 * _TURNS + 1):
        square = terms.square(1.0 / jnp.sqrt(larger(square, jnp.ones_like(square))), maxima)
    return square
