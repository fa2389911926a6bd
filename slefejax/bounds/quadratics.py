"""How far linear interpolation of one polynomial errs on a part of a patch: compared with quadratics.

The error is compared with that of the quadratic polynomial which agrees with it at corners and in middles of sides
(docs/certified.md, section 7). Parts are cells, triangles, and parts of both.
"""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from slefejax.bounds.twists import VARYING, OnBox, on_box
from slefejax.geometry.bezier import bernstein
from slefejax.geometry.gregory import twist_basis
from slefejax.lanes import nets
from slefejax.lanes.maxima import larger, smaller
from slefejax.lanes.nets import Lanes, Net

_THIRD = ((3, 0, 1.0), (2, 1, 3.0), (1, 2, 3.0), (0, 3, 1.0))  # d/du, d/dv, multiplicity
# How far quadratic interpolation on a triangle in the unit square errs for a constant third derivative of size 1,
# 1/(72 sqrt 3); for one that differs by 1 from a constant it is VARYING
CONSTANT = 0.00802
IN_QUARTERS = np.indices((5, 5)).reshape(2, 25, 1) / 4.0


class Places(NamedTuple):
    """Where a part of a patch is looked at, and its twist terms there: the same for all rows."""

    along: list[Any]  # Bernstein polynomials of the box at the places along u, and along v
    terms: list[Any]  # what every twist is multiplied with, (places, lanes)
    middle: list[Lanes]  # the same in the box' middle
    on_box: list[OnBox]
    shares: list[Any]  # of windows: for either diagonal, of the cell's corners in what is drawn, (places, lanes) each


class Polynomial(NamedTuple):
    """One polynomial of a part of a patch, and its twist terms' numbers."""

    net: Net
    twists: list[Lanes]
    corners: list[Lanes]  # of windows: the values at the corners of the cell

    def less(self, s: Lanes, other: Polynomial) -> Polynomial:
        """This one less s times another one."""
        net = nets.each(lambda x, d: x - s * d, self.net, other.net)
        lists = ((self.twists, other.twists), (self.corners, other.corners))
        return Polynomial(net, *([x - s * d for x, d in zip(*pair, strict=True)] for pair in lists))

    def drawn(self, diagonal: int, places: Places) -> Any:
        """What is drawn of a window's cell at the places, ``(places, lanes)``."""
        return nets.total([c * k for c, k in zip(self.corners, places.shares[diagonal], strict=True)])

    def at(self, values: list[Lanes], places: Places) -> list[Lanes]:
        """The values at all places, from the net's alone."""
        if not self.twists:
            return values
        more = nets.total([t * b for t, b in zip(self.twists, places.terms, strict=True)])
        return [value + more[k] for k, value in enumerate(values)]

    def middle(self, places: Places) -> Lanes:
        """The value in the box' middle."""
        return self._with(_middle(self.net), self.twists, places.middle)

    def centred(self, places: Places) -> Net:
        """A net within ``swing`` of which all values lie."""
        return nets.each(lambda x: self._with(x, self.twists, places.middle), self.net)

    def swing(self, places: Places) -> Lanes:
        """How far the twist terms are at most from what they are in the middle."""
        return self._with(jnp.zeros_like(self.net[0, 0]), self._sizes, [own.swing for own in places.on_box])

    def rest(self, places: Places) -> Lanes:
        """What they differ at most from the quadratics."""
        return self._with(jnp.zeros_like(self.net[0, 0]), self._sizes, [own.rest for own in places.on_box])

    @property
    def _sizes(self) -> list[Lanes]:
        return [jnp.abs(t) for t in self.twists]

    def _with(self, value: Lanes, numbers: list[Lanes], terms: list[Lanes]) -> Lanes:
        return nets.total([value, *(t * b for t, b in zip(numbers, terms, strict=True))])


class Measured(NamedTuple):
    """The interpolation error of one polynomial: at most the largest size in one of the lists, and the rest."""

    ways: list[list[Lanes]]
    rest: Lanes

    @property
    def size(self) -> Lanes:
        """A bound of it."""
        return reduce(smaller, [largest_size(way) for way in self.ways]) + self.rest


class Window(NamedTuple):
    """A part of a cell: a square of its local coordinates."""

    low: list[Lanes]  # of the cell
    high: list[Lanes]
    first: list[Lanes]  # corner of the square, from 0 to 1
    side: Lanes

    @property
    def box(self) -> tuple[list[Lanes], list[Lanes]]:
        """The square in the patch."""
        sizes = [b - a for a, b in zip(self.low, self.high, strict=True)]
        low = [a + t * size for a, t, size in zip(self.low, self.first, sizes, strict=True)]
        return low, [a + self.side * size for a, size in zip(low, sizes, strict=True)]

    def corners(self, net: Net, twists: list[Lanes]) -> list[Lanes]:
        """Values at the cell's corners, counter-clockwise."""
        return [_value(net, twists, u, v) for u, v in self.places]

    @property
    def places(self) -> list[tuple[Lanes, Lanes]]:
        """(u, v) of these."""
        (u0, v0), (u1, v1) = self.low, self.high
        return [(u0, v0), (u1, v0), (u1, v1), (u0, v1)]

    @property
    def shares(self) -> list[tuple[Any, ...]]:
        """Of these corners in what is drawn at quarters of the square, for the rising diagonal and the other."""
        x, y = (t + self.side * k for t, k in zip(self.first, IN_QUARTERS, strict=True))
        zero, one = jnp.zeros_like(x), jnp.ones_like(x)
        rising = 1.0 - larger(x, y), larger(x - y, zero), smaller(x, y), larger(y - x, zero)
        beyond = larger(x + y - one, zero)
        falling = larger(one - x - y, zero), smaller(x, one - y), beyond, smaller(y, one - x)
        return [rising, falling]


class Piece(NamedTuple):
    """A part of a triangle: one with these barycentric coordinates."""

    places: list[tuple[Lanes, Lanes]]  # (u, v) of the triangle's corners
    parts: list[tuple[Lanes, ...]]  # of each corner of the part, the shares of these

    @property
    def own(self) -> list[list[Lanes]]:
        """u, and v, of the part's corners."""
        return [
            [nets.total([t * x[axis] for t, x in zip(part, self.places, strict=True)]) for part in self.parts]
            for axis in (0, 1)
        ]

    def corners(self, net: Net, twists: list[Lanes]) -> list[Lanes]:
        """Values at the triangle's corners."""
        return [_value(net, twists, u, v) for u, v in self.places]

    @property
    def shares(self) -> list[tuple[Any, ...]]:
        """Of these in what is drawn at the part's corners and in the middles of its sides."""
        ends = [jnp.stack([part[k] for part in self.parts]) for k in range(3)]
        return [tuple(jnp.concatenate([x, 0.5 * (x + jnp.roll(x, -1, axis=0))]) for x in ends)]


def _value(net: Net, twists: list[Lanes], u: Lanes, v: Lanes) -> Lanes:
    """Of a whole patch at a place."""
    basis = [bernstein(n - 1, t) for n, t in zip(net.shape[:2], (u, v), strict=True)]
    terms = twist_basis(len(twists), u, v) if twists else []
    return nets.total([nets.combined_at(net, *basis), *(t * b for t, b in zip(twists, terms, strict=True))])


def places_of(
    low: list[Lanes], high: list[Lanes], inside: Any, window: Window | Piece | None, slots: int, shape: Any
) -> Places:
    """Of a cell all multiples of a quarter, row by row, or of a triangle those inside of the box."""
    shares: list[Any] = [] if window is None else window.shares
    if inside is None:
        along: list[Any] = [_quarters(n) for n in shape]
    else:
        along = [[bernstein(n - 1, t) for t in own] for n, own in zip(shape, inside, strict=True)]
    if not slots:
        return Places(along, [], [], [], shares)

    def terms(u: Any, v: Any) -> list[Lanes]:
        place = (a + t * (b - a) for a, b, t in zip(low, high, (u, v), strict=True))
        return twist_basis(slots, *place)

    own = terms(*(IN_QUARTERS if inside is None else (jnp.stack(x) for x in inside)))
    return Places(along, own, terms(0.5, 0.5), on_box(slots, low, high, inside is None), shares)


def _of_piece(own: Polynomial, places: Places) -> Measured:
    """The interpolation error of a triangle on a part of it: Bézier coefficients of a quadratic, and the rest."""
    at = own.at([nets.combined_at(own.net, *at) for at in zip(*places.along, strict=True)], places)
    drawn = own.drawn(0, places)
    error = [x - drawn[k] for k, x in enumerate(at)]
    middles = [2.0 * error[3 + k] - 0.5 * (error[k] + error[(k + 1) % 3]) for k in range(3)]
    return Measured([[*error[:3], *middles]], _beyond(own, places, 1.0))


def _of_cell(own: Polynomial, places: Places) -> Measured:
    """The interpolation error of a polynomial on a cell, for both diagonals."""
    at = _at_quarters(own, places)
    corners = at[0, 0], at[-1, 0], at[-1, -1], at[0, -1]
    halves = []
    for rising in (True, False):
        error = np.empty((5, 5), object)
        for i, j in np.ndindex(5, 5):
            drawn = [(p, k) for p, k in zip(corners, _shares(i / 4, j / 4, rising), strict=True) if k]
            # of corners, exactly
            exact = len(drawn) == 1
            error[i, j] = jnp.zeros_like(at[0, 0]) if exact else at[i, j] - nets.total([p * k for p, k in drawn])
        halves += _of_halves(error, rising, [])
    return Measured([halves], _beyond(own, places, 0.125))


def _of_window(own: Polynomial, places: Places) -> Measured:
    """The same on a part of a cell, a square along whose diagonals it is cut too, if at all."""
    at = _at_quarters(own, places)
    halves = []
    for diagonal, rising in enumerate((True, False)):
        error = np.empty((5, 5), object)
        drawn = own.drawn(diagonal, places)
        for i, j in np.ndindex(5, 5):
            error[i, j] = at[i, j] - drawn[5 * i + j]
        halves += _of_halves(error, rising, [error[i, j] for i in (0, -1) for j in (0, -1)])
    return Measured([halves], _beyond(own, places, 0.125))


def _at_quarters(own: Polynomial, places: Places) -> Net:
    at = nets.combined(own.net, *places.along)
    return at if not own.twists else nets.objects([own.at(list(at.reshape(25, *at.shape[2:])), places)]).reshape(5, 5)


def _beyond(own: Polynomial, places: Places, share: float) -> Lanes:
    """What differs from the quadratics, of polynomials a share of what they differ from those of the whole part."""
    found = _rest(own.net) * share
    return found + own.rest(places) if own.twists else found


def drawn_corners(own: Polynomial, places: Places, triangle: bool) -> Net:
    """What is drawn at the corners of a window, for either diagonal, or at those of a part of a triangle."""
    if triangle:
        return nets.objects([list(own.drawn(0, places)[:3])])
    return nets.objects([[own.drawn(d, places)[20 * i + 4 * j] for i in (0, 1) for j in (0, 1)] for d in (0, 1)])


def _quarters(count: int) -> list[list[float]]:
    """The Bernstein polynomials at 0, 1/4, ..., 1."""
    return [[float(b) for b in bernstein(count - 1, np.float64(k / 4))] for k in range(5)]


def _of_halves(error: Net, rising: bool, corners: list[Lanes]) -> list[Lanes]:
    """From errors at multiples of a quarter: Bézier coefficients of the quadratics on quarters of both halves."""
    found = [*corners, error[0, 2], error[2, 0], error[2, 2], error[2, 4], error[4, 2]]
    for i, j in np.ndindex(5, 5):
        if i % 2 or j % 2:
            # the ends of the side whose middle this is
            one, other = ((i + k * (i % 2), j + k * (j % 2) * (1 if rising or not i % 2 else -1)) for k in (-1, 1))
            found.append(2.0 * error[i, j] - 0.5 * (error[one] + error[other]))
    return found


def _shares(x: float, y: float, rising: bool) -> tuple[float, ...]:
    """Of a cell's corners (0, 0), (1, 0), (1, 1), (0, 1) in what is drawn at (x, y)."""
    if rising:
        return 1 - max(x, y), max(x - y, 0.0), min(x, y), max(y - x, 0.0)
    return max(1 - x - y, 0.0), min(x, 1 - y), max(x + y - 1, 0.0), min(y, 1 - x)


def _of_triangle(own: Polynomial, places: Places) -> Measured:
    """The same on a triangle, whose corners and middles of sides are the places."""
    at = own.at([nets.combined_at(own.net, *at) for at in zip(*places.along, strict=True)], places)
    a, b, c = (at[3 + k] - 0.5 * (at[k] + at[(k + 1) % 3]) for k in range(3))
    ways = [_of_quadratic(*one) for one in ((a, b, c), (b, c, a), (c, a, b))]
    return Measured(ways, _beyond(own, places, 1.0))


def _of_quadratic(one: Lanes, other: Lanes, last: Lanes) -> list[Lanes]:
    """No smaller than a quadratic on a triangle, 0 at the corners, from its values in the middles of the sides.

    That is (5) of docs/certified.md for any triangle, whichever side is the last: the size of one + other, and that of
    last - (one + other) more.
    """
    return [one, other, last, 2.0 * (one + other) - last]


def _rest(net: Net) -> Lanes:
    """What a polynomial differs at most from the quadratic that has its values at the corners and middles."""
    parts = [jnp.zeros_like(net[0, 0])]
    for i, j, times in _THIRD:
        third = nets.derivative(net, i, j)
        if nets.size(third):
            high, low = nets.top(third), nets.bottom(third)
            parts.append(0.5 * times * (CONSTANT * jnp.abs(high + low) + VARYING * (high - low)))
    return nets.total(parts)


def _half_way(line: Any) -> Lanes:
    """A curve in its middle."""
    return nets.total([x * float(b) for x, b in zip(line, bernstein(len(line) - 1, np.float64(0.5)), strict=True)])


def _middle(net: Net) -> Lanes:
    return _half_way([_half_way(row) for row in net])


def largest_size(values: list[Lanes]) -> Lanes:
    """Of numbers."""
    return reduce(larger, [jnp.abs(x) for x in values])


class Box(NamedTuple):
    """A box of the domain, and which part of a patch lies in it."""

    low: list[Lanes]
    high: list[Lanes]
    inside: list[Any] | None = None  # where in the box the corners and middles of a triangle are, along u and v
    window: Window | Piece | None = None  # of which cell or triangle it is a part


def _cell(lanes: Any) -> Box:
    """Low and high (u, v); cut along either diagonal."""
    return Box([lanes[0], lanes[1]], [lanes[2], lanes[3]])


def _window(lanes: Any) -> Box:
    """A square of a cell: as of cells, then the square's corner and side in the cell's own coordinates."""
    *own, side = lanes
    window = Window(own[:2], own[2:4], own[4:], side)
    return Box(*window.box, None, window)


def _triangle(lanes: Any) -> Box:
    """(u, v) of the three corners."""
    return _around([lanes[0::2], lanes[1::2]])


def _piece(lanes: Any) -> Box:
    """A part of a triangle: as of triangles, then of each corner the shares of the second and the third."""
    places = list(zip(lanes[0:6:2], lanes[1:6:2], strict=True))
    second, third = lanes[6:12:2], lanes[7:12:2]
    window = Piece(places, [(1.0 - b - c, b, c) for b, c in zip(second, third, strict=True)])
    return _around(window.own)._replace(window=window)


def _around(corners: Any) -> Box:
    """The box around a triangle."""
    low, high = ([reduce(choose, x) for x in corners] for choose in (smaller, larger))
    return Box(low, high, [_inside(x, a, b) for x, a, b in zip(corners, low, high, strict=True)])


PARTS: dict[str, tuple[Any, Any]] = {
    "cell": (_cell, _of_cell),
    "window": (_window, _of_window),
    "triangle": (_triangle, _of_triangle),
    "piece": (_piece, _of_piece),
}
"""Of every kind of part: what makes a box of the numbers that tell it, and what measures errors on it."""


def _inside(places: Any, low: Lanes, high: Lanes) -> list[Lanes]:
    """Corners and middles of the sides of a triangle, from one end of its box to the other."""
    wide = jnp.where(high > low, high - low, 1.0)
    own = [(x - low) / wide for x in places]
    return [*own, *(0.5 * (own[k] + own[(k + 1) % 3]) for k in range(3))]
