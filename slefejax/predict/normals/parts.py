"""How far interpolated normals turn away on a part of a patch at most: kernels as in ``bounds.parts``.

With m the direction of N in the middle, N over N . m is a point of a plane, and angles are at most distances there. So
the error is that of interpolating N - s N.m over N.m (docs/certified.md, 11). Patches come as their undivided normals,
patches first, the size of a coordinate, and the angle that is allowed, in radians.
"""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

import jax.numpy as jnp

from slefejax.bounds.parts import ROUNDING
from slefejax.bounds.quadratics import PARTS, Box, Measured, Places, Polynomial, drawn_corners, places_of
from slefejax.lanes import loops, nets
from slefejax.lanes.maxima import larger, smaller
from slefejax.lanes.nets import Lanes
from slefejax.predict.normals.spun import Missed, PartSpin
from slefejax.predict.normals.undivided import Spin


class _Part(NamedTuple):
    """What of a patch's normals lies in a box of the domain."""

    rows: list[Polynomial]  # N less m times N.m, a coordinate each
    w: Polynomial  # N.m
    places: Places
    least: Lanes  # that is at least so much
    deep: Lanes  # and positive
    far: Lanes  # how far N over it can be from m
    blur: Lanes  # what rounding may have done
    rest: Lanes  # what twists add differs at most so much from the quadratics

    @staticmethod
    def of(
        pictured: tuple[Any, ...],
        patch: Lanes,
        box: Box,
    ) -> _Part:
        """Of a patch, what lies in a box."""
        control, sizes, _, *spins = pictured
        low, high, inside, window = box
        index = patch.astype(jnp.int32)
        own, *spun = (loops.once(jnp.moveaxis(x[index], 0, -1)) for x in (control, *spins))
        spin = PartSpin(Spin(*spun), box) if spun else None
        whole = nets.coordinates(own, unrolled=False)
        along = [nets.restricting(n, a, b) for n, a, b in zip(own.shape[:2], low, high, strict=True)]
        corners = [[]] * 3 if window is None else [window.corners(net, []) for net in whole]
        restricted = [nets.restricted(net, *along) for net in whole]
        places = places_of(low, high, inside, window, 0, own.shape[:2])
        shares = [[]] * 3
        if spin is not None:
            places, shares = spin.at_places(places), spin.shares
            if window is not None:
                ends = [spin.at(u, v) for u, v in window.places]
                corners = [[c + end[k] for c, end in zip(own, ends, strict=True)] for k, own in enumerate(corners)]
        every = [Polynomial(*row) for row in zip(restricted, shares, corners, strict=True)]
        middle = [row.middle(places) for row in every]
        length = _length(middle)
        axis = [x / jnp.where(length > 0, length, 1.0) for x in middle]
        w = _along(every, axis)
        across, depth = (Missed(*[jnp.zeros_like(length)] * 2),) * 2 if spin is None else spin.missed(axis)
        least = nets.bottom(w.centred(places)) - depth.swing
        if window is not None:
            least = smaller(least, nets.bottom(drawn_corners(w, places, inside is not None)))
        blur = ROUNDING * sizes[index]
        deep = least > 2.0 * blur
        least = jnp.where(deep, least - blur, 1.0)
        rows = [row.less(m, w) for row, m in zip(every, axis, strict=True)]
        far = nets.top(nets.each(lambda *x: _length(list(x)), *(row.centred(places) for row in rows))) + across.swing
        far = far / least
        return _Part(rows, w, places, least, deep, far, blur, across.rest + far * depth.rest)

    def error(self, measured: Any, angle: Any) -> Lanes:
        """The largest error over an angle, for what measures the interpolation error of one polynomial."""
        rows = [measured(row, self.places) for row in self.rows]
        whole = _together(rows) + self.far * measured(self.w, self.places).size + self.rest + self.blur
        return jnp.where(self.deep, whole / (self.least * angle), jnp.inf)


def _together(rows: list[Measured]) -> Lanes:
    """Of the coordinates of vectors: how long they are at most."""
    ways = []
    for own in zip(*(row.ways for row in rows), strict=True):
        ways.append(reduce(larger, [_square(list(x)) for x in zip(*own, strict=True)]))
    return jnp.sqrt(reduce(smaller, ways)) + _length([row.rest for row in rows])


def _along(rows: list[Polynomial], axis: list[Lanes]) -> Polynomial:
    net = nets.total([row.net * m for row, m in zip(rows, axis, strict=True)])
    ends = [
        nets.total([x * m for x, m in zip(end, axis, strict=True)])
        for end in zip(*(row.corners for row in rows), strict=True)
    ]
    twists = [
        nets.total([x * m for x, m in zip(own, axis, strict=True)])
        for own in zip(*(row.twists for row in rows), strict=True)
    ]
    return Polynomial(net, twists, ends)


def _square(vector: list[Lanes]) -> Lanes:
    return nets.total([x * x for x in vector])


def _length(vector: list[Lanes]) -> Lanes:
    return jnp.sqrt(_square(vector))


def part_turn(lanes: Any, *pictured: Any, kind: str) -> Lanes:
    """Of parts of a kind (``PARTS``), lanes: patch, then what tells the part."""
    told, measured = PARTS[kind]
    return _Part.of(pictured, lanes[0], told(lanes[1:])).error(measured, pictured[2])
