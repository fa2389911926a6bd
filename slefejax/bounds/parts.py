"""How far a part of a patch errs on the screen at most: kernels for cells, triangles, and parts of both.

The error is that of interpolating X - s W over W (docs/certified.md, sections 2 and 7), and is compared with that of
the quadratic polynomial which agrees with it at corners and in middles of sides. Patches come as ``predict.cells``
pictures them: control points and twists, patches first, half of the picture, sizes of terms, the floor of W.
"""

from __future__ import annotations

from functools import partial, reduce
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from slefejax.bounds.twists import VARYING, OnBox, on_box
from slefejax.geometry.bezier import bernstein
from slefejax.geometry.gregory import twist_basis
from slefejax.geometry.projection import reaches
from slefejax.lanes import loops, nets
from slefejax.lanes.maxima import larger, smaller
from slefejax.lanes.nets import Lanes, Net
from slefejax.lanes.tuning import TUNING

_THIRD = ((3, 0, 1.0), (2, 1, 3.0), (1, 2, 3.0), (0, 3, 1.0))  # d/du, d/dv, multiplicity
# How far quadratic interpolation on a triangle in the unit square errs for a constant third derivative of size 1,
# 1/(72 sqrt 3); for one that differs by 1 from a constant it is VARYING
CONSTANT = 0.00802
ROUNDING = 256.0 * np.finfo(np.float64).eps
_IN_QUARTERS = np.indices((5, 5)).reshape(2, 25, 1) / 4.0


class _Places(NamedTuple):
    """Where a part of a patch is looked at, and its twist terms there: the same for all rows."""

    along: list[Any]  # Bernstein polynomials of the box at the places along u, and along v
    terms: list[Any]  # what every twist is multiplied with, (places, lanes)
    middle: list[Lanes]  # the same in the box' middle
    on_box: list[OnBox]
    shares: list[Any]  # of windows: for either diagonal, of the cell's corners in what is drawn, (places, lanes) each


class _Polynomial(NamedTuple):
    """One polynomial of a part of a patch, and its twist terms' numbers."""

    net: Net
    twists: list[Lanes]
    corners: list[Lanes]  # of windows: the values at the corners of the cell

    def less(self, s: Lanes, other: _Polynomial) -> _Polynomial:
        """This one less s times another one."""
        net = nets.each(lambda x, d: x - s * d, self.net, other.net)
        lists = ((self.twists, other.twists), (self.corners, other.corners))
        return _Polynomial(net, *([x - s * d for x, d in zip(*pair, strict=True)] for pair in lists))

    def drawn(self, diagonal: int, places: _Places) -> Any:
        """What is drawn of a window's cell at the places, ``(places, lanes)``."""
        return nets.total([c * k for c, k in zip(self.corners, places.shares[diagonal], strict=True)])

    def at(self, values: list[Lanes], places: _Places) -> list[Lanes]:
        """The values at all places, from the net's alone."""
        if not self.twists:
            return values
        more = nets.total([t * b for t, b in zip(self.twists, places.terms, strict=True)])
        return [value + more[k] for k, value in enumerate(values)]

    def middle(self, places: _Places) -> Lanes:
        """The value in the box' middle."""
        return self._with(_middle(self.net), self.twists, places.middle)

    def centred(self, places: _Places) -> Net:
        """A net within ``swing`` of which all values lie."""
        return nets.each(lambda x: self._with(x, self.twists, places.middle), self.net)

    def swing(self, places: _Places) -> Lanes:
        """How far the twist terms are at most from what they are in the middle."""
        return self._with(jnp.zeros_like(self.net[0, 0]), self._sizes, [own.swing for own in places.on_box])

    def rest(self, places: _Places) -> Lanes:
        """What they differ at most from the quadratics."""
        return self._with(jnp.zeros_like(self.net[0, 0]), self._sizes, [own.rest for own in places.on_box])

    @property
    def _sizes(self) -> list[Lanes]:
        return [jnp.abs(t) for t in self.twists]

    def _with(self, value: Lanes, numbers: list[Lanes], terms: list[Lanes]) -> Lanes:
        return nets.total([value, *(t * b for t, b in zip(numbers, terms, strict=True))])


class _Part(NamedTuple):
    """A part of a patch: what lies in a box of the domain."""

    rows: list[_Polynomial]  # of X, Y (and Z) less s W, with an s of the box's middle
    w: _Polynomial
    places: _Places
    least: Lanes  # W is at least that
    deep: Lanes  # and that is away from 0
    far: list[Lanes]  # how far s can be from that of the middle, for every row
    blur: list[Lanes]  # what rounding may have done
    unseen: Lanes  # outside of one plane, with all that is drawn of it

    @staticmethod
    def of(
        pictured: tuple[Any, ...],
        patch: Lanes,
        low: list[Lanes],
        high: list[Lanes],
        rows: int,
        inside: list[Any] | None = None,
        window: _Window | _Piece | None = None,
    ) -> _Part:
        """A cell, if nothing else is said.

        inside : places in the box of the corners and middles of a triangle, along u and v
        window : which part of which cell or triangle this is
        """
        control, twists, half, sizes, floor = pictured
        index = patch.astype(jnp.int32)
        # once: other fusions would gather again
        own, size = loops.once(jnp.moveaxis(control[index], 0, -1)), sizes[:, index]
        few = own.shape[0] * own.shape[1] <= TUNING.unrolled_coefficients
        along = [nets.restricting(n, a, b) for n, a, b in zip(own.shape[:2], low, high, strict=True)]
        slots, spun = twists.shape[1], loops.once(jnp.moveaxis(twists[index], 0, -1))
        turned = [[spun[k, a] for k in range(slots)] for a in range(4)]
        whole = nets.coordinates(own, few)
        corners = [[]] * 4 if window is None else [window.corners(*both) for both in zip(whole, turned, strict=True)]
        restricted = [nets.restricted(net, *along) for net in whole]
        *every, w = (_Polynomial(*parts) for parts in zip(restricted, turned, corners, strict=True))
        places = _places(low, high, inside, window, slots, own.shape[:2])
        swing = [own.swing(places) for own in (*every, w)] if slots else [0.0] * 4
        least = nets.bottom(w.centred(places)) - swing[-1]
        if window is not None:
            least = smaller(least, nets.bottom(_drawn_corners(w, places, inside is not None)))
        least = least - ROUNDING * size[3]
        deep = least >= 0.5 * floor[index]
        least = jnp.where(deep, least, 1.0)
        outline = _corners if window is None else partial(_drawn_corners, triangle=False)
        drawn = [outline(own, places) if inside is None else own.centred(places) for own in (*every, w)]
        room = [0.0] * 3 if inside is None else [swing[k] + half[k] * swing[-1] for k in range(3)]
        planes = [_outside(net, drawn[-1], half[k], size[k], size[3], room[k]) for k, net in enumerate(drawn[:-1])]
        middle = w.middle(places)
        relative, far, blur = [], [], []
        for k in range(rows):
            s = jnp.clip(every[k].middle(places) / jnp.where(deep, middle, 1.0), -half[k], half[k])
            relative.append(every[k].less(s, w))
            largest = nets.top(nets.each(jnp.abs, relative[-1].centred(places)))
            far.append((largest + relative[-1].swing(places) if slots else largest) / least)
            blur.append(ROUNDING * (size[k] + half[k] * size[3]))
        return _Part(relative, w, places, least, deep, far, blur, reduce(jnp.logical_or, planes))

    def error(self, measured: Any) -> Lanes:
        """The largest error, for what measures the interpolation error of one polynomial from above."""
        of_w, worst = measured(self.w, self.places), jnp.zeros_like(self.least)
        for own, far, blur in zip(self.rows, self.far, self.blur, strict=True):
            # linear in s, and a seminorm
            worst = larger(worst, (measured(own, self.places) + far * of_w + blur) / self.least)
        return jnp.where(self.unseen, 0.0, jnp.where(self.deep, worst, jnp.inf))


class _Window(NamedTuple):
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
        (u0, v0), (u1, v1) = self.low, self.high
        return [_value(net, twists, u, v) for u, v in ((u0, v0), (u1, v0), (u1, v1), (u0, v1))]

    @property
    def shares(self) -> list[tuple[Any, ...]]:
        """Of these corners in what is drawn at quarters of the square, for the rising diagonal and the other."""
        x, y = (t + self.side * k for t, k in zip(self.first, _IN_QUARTERS, strict=True))
        zero, one = jnp.zeros_like(x), jnp.ones_like(x)
        rising = 1.0 - larger(x, y), larger(x - y, zero), smaller(x, y), larger(y - x, zero)
        beyond = larger(x + y - one, zero)
        falling = larger(one - x - y, zero), smaller(x, one - y), beyond, smaller(y, one - x)
        return [rising, falling]


class _Piece(NamedTuple):
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


def _places(
    low: list[Lanes], high: list[Lanes], inside: Any, window: _Window | _Piece | None, slots: int, shape: Any
) -> _Places:
    """Of a cell all multiples of a quarter, row by row, or of a triangle those inside of the box."""
    shares: list[Any] = [] if window is None else window.shares
    if inside is None:
        along: list[Any] = [_quarters(n) for n in shape]
    else:
        along = [[bernstein(n - 1, t) for t in own] for n, own in zip(shape, inside, strict=True)]
    if not slots:
        return _Places(along, [], [], [], shares)

    def terms(u: Any, v: Any) -> list[Lanes]:
        place = (a + t * (b - a) for a, b, t in zip(low, high, (u, v), strict=True))
        return twist_basis(slots, *place)

    own = terms(*(_IN_QUARTERS if inside is None else (jnp.stack(x) for x in inside)))
    return _Places(along, own, terms(0.5, 0.5), on_box(slots, low, high, inside is None), shares)


def cell_error(lanes: Any, *pictured: Any, rows: int) -> Lanes:
    """Of cells, lanes: patch, low and high (u, v); cut along either diagonal."""
    return _Part.of(pictured, lanes[0], [lanes[1], lanes[2]], [lanes[3], lanes[4]], rows).error(_of_cell)


def window_error(lanes: Any, *pictured: Any, rows: int) -> Lanes:
    """Of squares of cells, lanes: as of cells, then the square's corner and side in the cell's own coordinates."""
    patch, *own, side = lanes
    window = _Window(own[:2], own[2:4], own[4:], side)
    return _Part.of(pictured, patch, *window.box, rows, window=window).error(_of_window)


def piece_error(lanes: Any, *pictured: Any, rows: int) -> Lanes:
    """Of parts of triangles, lanes: as of triangles, then of each corner the shares of the second and the third."""
    places = list(zip(lanes[1:7:2], lanes[2:7:2], strict=True))
    second, third = lanes[7:13:2], lanes[8:13:2]
    window = _Piece(places, [(1.0 - b - c, b, c) for b, c in zip(second, third, strict=True)])
    u, v = window.own
    low, high = ([reduce(choose, x) for x in (u, v)] for choose in (smaller, larger))
    inside = [_inside(x, a, b) for x, a, b in zip((u, v), low, high, strict=True)]
    return _Part.of(pictured, lanes[0], low, high, rows, inside, window).error(_of_piece)


def _of_piece(own: _Polynomial, places: _Places) -> Lanes:
    """The interpolation error of a triangle on a part of it: Bézier coefficients of a quadratic, and the rest."""
    at = own.at([nets.combined_at(own.net, *at) for at in zip(*places.along, strict=True)], places)
    drawn = own.drawn(0, places)
    error = [x - drawn[k] for k, x in enumerate(at)]
    middles = [2.0 * error[3 + k] - 0.5 * (error[k] + error[(k + 1) % 3]) for k in range(3)]
    found = _largest_size([*error[:3], *middles]) + _rest(own.net)
    return found + own.rest(places) if own.twists else found


def triangle_error(lanes: Any, *pictured: Any, rows: int) -> Lanes:
    """Of triangles, lanes: patch, (u, v) of the three corners."""
    u, v = lanes[1::2], lanes[2::2]
    low, high = ([reduce(choose, x) for x in (u, v)] for choose in (smaller, larger))
    inside = [_inside(x, a, b) for x, a, b in zip((u, v), low, high, strict=True)]
    return _Part.of(pictured, lanes[0], low, high, rows, inside).error(_of_triangle)


def _of_cell(own: _Polynomial, places: _Places) -> Lanes:
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
        halves.append(_of_halves(error, rising, []))
    return reduce(larger, halves) + _beyond_quarters(own, places)


def _of_window(own: _Polynomial, places: _Places) -> Lanes:
    """The same on a part of a cell, a square along whose diagonals it is cut too, if at all."""
    at = _at_quarters(own, places)
    halves = []
    for diagonal, rising in enumerate((True, False)):
        error = np.empty((5, 5), object)
        drawn = own.drawn(diagonal, places)
        for i, j in np.ndindex(5, 5):
            error[i, j] = at[i, j] - drawn[5 * i + j]
        halves.append(_of_halves(error, rising, [error[i, j] for i in (0, -1) for j in (0, -1)]))
    return reduce(larger, halves) + _beyond_quarters(own, places)


def _at_quarters(own: _Polynomial, places: _Places) -> Net:
    at = nets.combined(own.net, *places.along)
    return at if not own.twists else nets.objects([own.at(list(at.reshape(25, *at.shape[2:])), places)]).reshape(5, 5)


def _beyond_quarters(own: _Polynomial, places: _Places) -> Lanes:
    """What differs from the quadratics on quarters of both halves."""
    found = _rest(own.net) / 8.0
    return found + own.rest(places) if own.twists else found


def _drawn_corners(own: _Polynomial, places: _Places, triangle: bool) -> Net:
    """What is drawn at the corners of a window, for either diagonal, or at those of a part of a triangle."""
    if triangle:
        return nets.objects([list(own.drawn(0, places)[:3])])
    return nets.objects([[own.drawn(d, places)[20 * i + 4 * j] for i in (0, 1) for j in (0, 1)] for d in (0, 1)])


def _quarters(count: int) -> list[list[float]]:
    """The Bernstein polynomials at 0, 1/4, ..., 1."""
    return [[float(b) for b in bernstein(count - 1, np.float64(k / 4))] for k in range(5)]


def _of_halves(error: Net, rising: bool, corners: list[Lanes]) -> Lanes:
    """From errors at multiples of a quarter: Bézier coefficients of the quadratics on quarters of both halves."""
    found = [*corners, error[0, 2], error[2, 0], error[2, 2], error[2, 4], error[4, 2]]
    for i, j in np.ndindex(5, 5):
        if i % 2 or j % 2:
            # the ends of the side whose middle this is
            one, other = ((i + k * (i % 2), j + k * (j % 2) * (1 if rising or not i % 2 else -1)) for k in (-1, 1))
            found.append(2.0 * error[i, j] - 0.5 * (error[one] + error[other]))
    return _largest_size(found)


def _shares(x: float, y: float, rising: bool) -> tuple[float, ...]:
    """Of a cell's corners (0, 0), (1, 0), (1, 1), (0, 1) in what is drawn at (x, y)."""
    if rising:
        return 1 - max(x, y), max(x - y, 0.0), min(x, y), max(y - x, 0.0)
    return max(1 - x - y, 0.0), min(x, 1 - y), max(x + y - 1, 0.0), min(y, 1 - x)


def _of_triangle(own: _Polynomial, places: _Places) -> Lanes:
    """The same on a triangle, whose corners and middles of sides are the places."""
    at = own.at([nets.combined_at(own.net, *at) for at in zip(*places.along, strict=True)], places)
    a, b, c = (at[3 + k] - 0.5 * (at[k] + at[(k + 1) % 3]) for k in range(3))
    quadratic = reduce(smaller, [_of_quadratic(*one) for one in ((a, b, c), (b, c, a), (c, a, b))])
    found = quadratic + _rest(own.net)
    return found + own.rest(places) if own.twists else found


def _of_quadratic(one: Lanes, other: Lanes, last: Lanes) -> Lanes:
    """At most the size of a quadratic on a triangle, 0 at the corners, from its values in the middles of the sides.

    That is (5) of docs/certified.md for any triangle, whichever side is the last.
    """
    both = one + other
    return larger(_largest_size([one, other]), jnp.abs(both) + jnp.abs(last - both))


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


def _largest_size(values: list[Lanes]) -> Lanes:
    return reduce(larger, [jnp.abs(x) for x in values])


def _inside(places: Any, low: Lanes, high: Lanes) -> list[Lanes]:
    """Corners and middles of the sides of a triangle, from one end of its box to the other."""
    wide = jnp.where(high > low, high - low, 1.0)
    own = [(x - low) / wide for x in places]
    return [*own, *(0.5 * (own[k] + own[(k + 1) % 3]) for k in range(3))]


def _corners(own: _Polynomial, places: _Places) -> Net:
    """The values at the corners of a cell."""
    values = [own.net[-i, -j] for i in (0, 1) for j in (0, 1)]
    if own.twists:
        ends = np.array([0, 4, 20, 24])
        values = own.at(values, places._replace(terms=[b[ends] for b in places.terms]))
    return nets.objects([values[:2], values[2:]])


def _outside(net: Net, w: Net, half: Any, size: Lanes, w_size: Lanes, room: Any) -> Lanes:
    """Whether points lie outside of one of two opposite planes of the view volume."""
    margin = ROUNDING * (size + half * w_size) + room
    low, high = reaches(net, w, half)
    return (low + margin < 0) | (high + margin < 0)
