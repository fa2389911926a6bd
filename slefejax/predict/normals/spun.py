"""What twist terms of Gregory patches add to normals on a part of a patch, for ``predict.normals.parts``."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax.numpy as jnp

from slefejax.bounds.quadratics import IN_QUARTERS, Box, Places
from slefejax.bounds.twists import OnBox
from slefejax.geometry.bezier import bernstein
from slefejax.geometry.gregory import twist_slopes
from slefejax.lanes import nets
from slefejax.lanes.maxima import smaller
from slefejax.lanes.nets import Lanes
from slefejax.predict.normals.slopes import Sizes, Slope, least_missed, on_box, product
from slefejax.predict.normals.undivided import Spin
from slefejax.predict.terms import SECOND, THIRD

_KINDS = (((0, 0, 1.0),), ((1, 0, 1.0), (0, 1, 1.0)), SECOND, THIRD)


class Missed(NamedTuple):
    """Of a function on a box of the domain.

    swing : how far it is at most from what it is in the box' middle
    rest  : how far it is at most from quadratics that have its values at corners and in middles of sides
    """

    swing: Lanes
    rest: Lanes


class PartSpin(NamedTuple):
    """The vector that twists add to N, on a box of the domain."""

    spin: Spin
    box: Box

    def missed(self, axis: list[Lanes]) -> tuple[Missed, Missed]:
        """Of what of the vector is orthogonal to a direction, and of what is along it.

        On quarters of both halves of a cell, or on any triangle. Tangents are nearly orthogonal to it where it is N's,
        and of products of such what is orthogonal is small.
        """
        (one, other), cell, m = self.spin[2:], self.box.inside is None, jnp.stack(axis)
        slopes = on_box(len(one), self.box.low, self.box.high, cell)

        def twisted(twists: Any, k: int) -> tuple[Slope, Slope]:
            along = jnp.sum(twists * m, axis=1)
            parts = nets.length(twists - along[:, None] * m), jnp.abs(along)
            across, along = (Slope.total([pair[k] for pair in slopes], list(own)) for own in parts)
            return across, along

        a, b = twisted(one, 0), twisted(other, 1)
        p, q = (_sizes(net, self.box, m) for net in self.spin[:2])

        def missed(kinds: tuple[tuple[int, int], ...]) -> Missed:
            """Of the sum of a x B, A x b and a x b, of these parts of factors."""
            pairs = [(x[i], y[j]) for i, j in kinds for x, y in ((a, q), (b, p))]
            both = [product(a[i].sizes, b[j].sizes) for i, j in kinds]
            rests = [x.rest_with(y, cell) for x, y in pairs]
            rests += [least_missed(own, cell) for own in both]
            every = [*(product(x.sizes, y) for x, y in pairs), *both]
            swings = [smaller(0.5 * own[1], 2.0 * own[0]) for own in every]
            return Missed(nets.total(swings), nets.total(rests))

        return missed(((0, 1), (1, 0))), missed(((0, 0),))

    def at(self, u: Any, v: Any) -> list[Any]:
        """The vector at places of the patch."""
        by_u, by_v = twist_slopes(len(self.spin.by_u), u, v, pinched=True)
        (x, y), (p, q) = self.spin[:2], self.spin[2:]
        a, b = (_value(net, u, v) for net in (x, y))
        more_a = [nets.total([k * t[i] for k, t in zip(by_u, p, strict=True)]) for i in range(3)]
        more_b = [nets.total([k * t[i] for k, t in zip(by_v, q, strict=True)]) for i in range(3)]
        whole = [k + m for k, m in zip(a, more_a, strict=True)]
        return [s + t for s, t in zip(_cross(more_a, b), _cross(whole, more_b), strict=True)]

    @property
    def shares(self) -> list[list[Lanes]]:
        """Of its coordinates in those of N."""
        return [[jnp.full_like(self.box.low[0], float(i == k)) for i in range(3)] for k in range(3)]

    def at_places(self, places: Places) -> Places:
        """With its coordinates for twist terms."""
        low, high, inside = self.box.low, self.box.high, self.box.inside
        shares = IN_QUARTERS if inside is None else [jnp.stack(x) for x in inside]
        where = [[a + t * (b - a) for a, b, t in zip(low, high, own, strict=True)] for own in (shares, (0.5, 0.5))]
        nothing = OnBox(*[jnp.zeros_like(low[0])] * 2)
        return places._replace(terms=self.at(*where[0]), middle=self.at(*where[1]), on_box=[nothing] * 3)


def _sizes(net: Any, box: Box, axis: Any) -> tuple[Sizes, Sizes]:
    """Of what of A or B is orthogonal to a direction ``(3, lanes)``, and along it; derivatives along the box."""
    along = [nets.restricting(n, a, b) for n, a, b in zip(net.shape[:2], box.low, box.high, strict=True)]
    own = jnp.stack([nets.restricted(x, *along) for x in nets.coordinates(net, unrolled=False)], axis=2)
    found: list[list[Lanes]] = []
    for kinds in _KINDS:
        parts = [jnp.asarray(nets.derivative(own, i, j)) * times for i, j, times in kinds]
        parts = [part for part in parts if nets.size(part)]
        depths = [jnp.sum(part * axis, axis=2) for part in parts]
        across = [nets.longest(x - d[:, :, None] * axis) for x, d in zip(parts, depths, strict=True)]
        zero = jnp.zeros_like(axis[0])
        found.append([nets.total([zero, *across]), nets.total([zero, *(nets.top(jnp.abs(d)) for d in depths)])])
    one, other = zip(*found, strict=True)
    return one, other


def _value(net: Any, u: Any, v: Any) -> list[Any]:
    basis = [bernstein(n - 1, t) for n, t in zip(net.shape[:2], (u, v), strict=True)]
    return [nets.combined_at(net[:, :, k], *basis) for k in range(3)]


def _cross(p: list[Any], q: list[Any]) -> list[Any]:
    return [p[1] * q[2] - p[2] * q[1], p[2] * q[0] - p[0] * q[2], p[0] * q[1] - p[1] * q[0]]
