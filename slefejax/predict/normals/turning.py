"""How finely normals have to be interpolated: the bound of docs/certified.md, 11, for nets of undivided normals.

Nets are arrays ``(ku+1, kv+1, 3, lanes)`` (``geometry.normals``); unrolled they take the compiler too long.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array

from slefejax.bounds.triangles import Extent, HalfCells, Triangles
from slefejax.geometry.bezier import tile_matrices
from slefejax.lanes import loops, nets
from slefejax.lanes.maxima import EXACT, Maxima, larger, root, smallest_along
from slefejax.lanes.nets import Lanes
from slefejax.predict.normals.spinning import Seen, Spinning, TileSpin, tile_tables
from slefejax.predict.normals.undivided import Undivided
from slefejax.predict.terms import FOURTH, SECOND, THIRD, Terms, solved

# A coefficient of the net is wrong by at most that, in eps of its size, and what makes tiles of it adds an eighth
_ROUNDING = 64.0

Vectors = Array  # (ku+1, kv+1, 3, lanes)
Numbers = Array  # (ku+1, kv+1, lanes)


class Turning(NamedTuple):
    """What grids of n x n cells need for interpolated normals to be near enough.

    square  : n^2 from which on they are
    second  : the part of it that second derivatives make
    spun    : all of it, of patches with twists, else 0
    corners : what that is at corners of tiles alone, so that more tiles cannot make it less
    known   : whether all of that is so: nowhere else normals may vanish, as far as these tiles tell
    """

    square: Lanes
    second: Lanes
    spun: Lanes
    corners: Lanes
    known: Lanes

    @property
    def factor(self) -> Lanes:
        """Real factors; infinite where nothing is known."""
        return jnp.where(self.known, root(self.square), jnp.inf)


def turning(
    normals: Undivided,
    angle: Any,
    triangles: Triangles | None = None,
    *,
    tiles: int,
    maxima: Maxima = EXACT,
) -> Turning:
    """Of undivided normals, for an angle in radians.

    triangles : for which that holds; None: all cells of grids
    """
    net, size, spin = normals
    shapes = HalfCells() if triangles is None else triangles
    whole = [nets.total([_largest(net, own, shapes.extent, maxima) for own in kind]) for kind in (SECOND, FOURTH)]

    spinning = None if spin is None else Spinning.of(spin, shapes.extent, maxima)

    def step(found: Turning, given: Any) -> Turning:
        matrices, tables = given
        turns = None if spinning is None else spinning.on_tile(tables[0], tables[1], tiles, maxima)
        tile = _Tile.of(_linear(net, lambda flat: nets.combined(flat, *matrices)), size, turns, maxima)
        own = tile.turning(whole, angle, shapes, tiles, maxima)
        square, second, spun, corners = (maxima.largest([a, b]) for a, b in zip(found[:4], own[:4], strict=True))
        return Turning(square, second, spun, corners, found.known & own.known)

    tables = None if spin is None else tile_tables(spin, shapes, tiles)
    every = tile_matrices(net.shape[0], net.shape[1], tiles), tables
    given = jax.tree.map(lambda x: jnp.asarray(x, net.dtype), every)
    nothing = jnp.zeros_like(size)
    start = Turning(jnp.ones_like(size), nothing, nothing, nothing, size > 0)
    return loops.repeated(step, start, given)


class _Tile(NamedTuple):
    """A part of a net, and N . m for a direction m in its middle, by which it is divided.

    What twists add to the net is nowhere longer than ``spun.size``.
    """

    net: Vectors
    axis: Array  # (3, lanes): m
    w: Numbers  # N . m
    over: Numbers  # 1 over the least that it may be
    deep: Lanes  # it is positive
    widest: Lanes  # 1 over the least of it
    reach: Lanes  # how far N over it is from m
    error: Lanes  # of a coefficient of the whole net
    about: Vectors  # a bilinear t that has the values of N over it at the corners, at the places of coefficients
    slopes: tuple[Lanes, Lanes]  # how much t changes along u and along v
    spun: TileSpin | None  # of Gregory patches

    @staticmethod
    def of(net: Vectors, size: Lanes, spun: TileSpin | None, maxima: Maxima) -> _Tile:
        """From coefficients, and the size that their rounding errors are proportional to."""
        mean = jnp.sum(net, axis=(0, 1))
        axis = mean / _positive(nets.length(mean))
        error = _ROUNDING * float(jnp.finfo(net.dtype).eps) * size
        w = _along(net, axis)
        apart = error if spun is None else error + spun.size
        least = nets.bottom(w) - error - apart
        deep = least > 0
        w, over = loops.once((jnp.where(deep, w, 1.0), 1.0 / jnp.where(deep, w - error - apart, 1.0)))
        widest = 1.0 / jnp.where(deep, least, 1.0)
        reach = nets.longest((net - w[:, :, None] * axis) * over[:, :, None], maxima) + apart * widest
        (a, b), (c, d) = ends = [[net[i, j] / w[i, j] for j in (0, -1)] for i in (0, -1)]
        about = loops.once(_bilinear(ends, *nets.degrees(net)))
        slopes = [larger(nets.length(p), nets.length(q)) for p, q in ((c - a, d - b), (b - a, d - c))]
        return _Tile(net, axis, w, over, deep, widest, reach, error, about, (slopes[0], slopes[1]), spun)

    def turning(self, whole: list[Lanes], angle: Any, triangles: Triangles, tiles: int, maxima: Maxima) -> Turning:
        """Of the points in the tile. whole: sums of sizes of second and of fourth derivatives of all of the patch."""
        degree, scale = float(sum(nets.degrees(self.net))), self.widest / angle
        blur = [(1.0 + tiles**order / 8.0) * (2.0 * degree) ** order * self.error * scale for order in (2, 3)]
        second, corners, apart = self._bend(triangles, maxima)
        second = second * tiles**2 / angle + blur[0]
        uuu, uuv, uvv, vvv = (self._third(kind, triangles.extent, maxima) * tiles**3 * scale for kind in THIRD)
        third, least = triangles.third(uuu + uuv + blur[1], vvv + uvv + blur[1], maxima)
        fourth = (whole[1] * root(1.0 + self.reach**2) + 16.0 * degree**4 * self.error) / 288.0 * scale
        terms = Terms(second, third, fourth, least, whole[0] / 8.0 * self.widest)
        if self.spun is None:
            square, spun = solved(terms, maxima), jnp.zeros_like(second)
        else:
            square = solved(self._with_twists(terms, self.spun, apart, angle, maxima), maxima)
            coarsest = self.spun.coarsest.astype(square.dtype)
            square = smallest_along(maxima.largest([square, coarsest**2]), (0,))
            spun = jnp.where(self.spun.size > 0, square, 0.0)
        square = square * (1.0 + 128.0 * float(jnp.finfo(self.net.dtype).eps))
        return Turning(square, second / 8.0, spun, corners * tiles**2 / (8.0 * angle), self.deep)

    def _bend(self, triangles: Triangles, maxima: Maxima) -> tuple[Lanes, Lanes, Lanes]:
        """How far triangles bend N - s N.m at most, over N.m, where s is N over N.m at the place; at corners alone; and
        how far s is from t.

        t stands for s, and what of a product with t is no sum of Bernstein terms is added.
        """
        parts = loops.once([self._raised(_derivative(self.net, i, j, triangles.extent)) for i, j, _ in SECOND])
        depth = loops.once([_along(part, self.axis) for part in parts])
        left = [self._less(part, along) for part, along in zip(parts, depth, strict=True)]
        squares = maxima.largest([_square(_sum(left, own)) for own in triangles.directions]) * self.over**2
        flat = [_sum(depth, own) for own in triangles.directions]
        bend = root(nets.top(squares, maxima)) + self._slip(flat, maxima) * self.widest
        apart = nets.longest(self._less(self.net, self.w) * self.over[:, :, None], maxima)
        apart = apart + (self._slip([self.w], maxima) + self.error) * self.widest
        if self.spun is not None:
            apart = apart + self._steepest * self.spun.size * self.widest
        rest = nets.top(maxima.largest([jnp.abs(own) for own in flat]) * self.over, maxima)
        corners = [squares[i, j] for i in (0, -1) for j in (0, -1)]
        return bend + apart * rest, root(reduce(larger, corners)), apart

    def _with_twists(self, terms: Terms, spun: TileSpin, apart: Lanes, angle: Any, maxima: Maxima) -> Terms:
        """All of it for grids that are at least as fine as ``spun.coarsest``, ``(coarsest, lanes)``."""
        first, second = self._spun(spun, apart, angle, maxima)
        all_of_it = self.widest * (root(1.0 + self.reach**2) / angle + 1.0) * spun.largest**2
        rest = terms.rest + second + all_of_it * spun.bent
        third = terms.third + all_of_it * spun.largest * spun.more
        second, fourth = (jnp.broadcast_to(own, rest.shape) for own in (terms.second, terms.fourth))
        return Terms(second, third, fourth, terms.least, rest, first)

    def _spun(self, spun: TileSpin, apart: Lanes, angle: Any, maxima: Maxima) -> tuple[Any, Any]:
        """What twists make of the angle, times n and times n^2: of what turns N, and of N.m."""

        def turned(several: Array) -> Array:
            """Of nets beside each other."""
            along = jnp.sum(several * self.axis, axis=-2)
            t = _bilinear(self._ends, several.shape[-4] - 1, several.shape[-3] - 1)
            size = maxima.largest_along(jnp.abs(along), (-3, -2))
            left = nets.longest(several - t * along[..., None, :], maxima)
            return left + self._slip([along], maxima) + apart * size

        def turned_everywhere(vectors: Array) -> Array:
            along = jnp.sum(vectors * self.axis, axis=-2)
            left = [nets.length(vectors - end * along[..., None, :]) for row in self._ends for end in row]
            return reduce(larger, left) + apart * jnp.abs(along)

        seen = Seen.of(spun.products, turned, turned_everywhere)
        found = zip(spun.errors(seen), spun.errors(spun.lengths), strict=True)
        first, second = (self.widest * (x / angle + y) for x, y in found)
        return first, second

    @property
    def _ends(self) -> list[list[Array]]:
        """t at the corners."""
        return [[self.about[i, j] for j in (0, -1)] for i in (0, -1)]

    @property
    def _steepest(self) -> Lanes:
        """The largest length of t: by so much vectors less t times their part along m are longer than they are."""
        return reduce(larger, [nets.length(own) for row in self._ends for own in row])

    def _raised(self, part: Vectors) -> Vectors:
        """Of the degrees of the tile."""
        du, dv = nets.degrees(self.net)
        return _linear(part, lambda flat: nets.raised(flat, du, dv)) if nets.size(part) else jnp.zeros_like(self.net)

    def _less(self, vectors: Vectors, along: Numbers) -> Vectors:
        """Vectors less t times numbers, coefficient by coefficient."""
        return vectors - self.about * along[:, :, None]

    def _slip(self, parts: list[Numbers], maxima: Maxima) -> Lanes:
        """How far such sums are at most from products with t: (u - i/d) b_i add up to u (1-u)/d times a derivative."""
        found = []
        for axis, slope in zip((-3, -2), self.slopes, strict=True):
            if parts[0].shape[axis] > 1:
                steps = [jnp.abs(jnp.diff(part, axis=axis)) for part in parts]
                found.append(slope * maxima.largest_along(maxima.largest(steps), (-3, -2)))
        return 0.25 * nets.total(found) if found else jnp.zeros_like(self.reach)

    def _third(self, kind: tuple[int, int, float], extent: Extent, maxima: Maxima) -> Lanes:
        """The largest size of a third derivative of N - s N.m, for all s of the tile, times how often it counts."""
        part = _derivative(self.net, kind[0], kind[1], extent)
        if not nets.size(part):
            return jnp.zeros_like(self.reach)
        part = loops.once(part)
        along = _along(part, self.axis)
        across = nets.longest(part - along[:, :, None] * self.axis, maxima)
        return kind[2] * (across + self.reach * nets.top(jnp.abs(along), maxima))


def _bilinear(ends: list[list[Array]], du: int, dv: int) -> Vectors:
    """At the places (i/du, j/dv)."""
    (a, b), (c, d) = ends
    x, y = (jnp.linspace(0.0, 1.0, n + 1).astype(a.dtype) for n in (du, dv))
    x, y = x[:, None, None, None], y[:, None, None]
    return (1.0 - x) * ((1.0 - y) * a + y * b) + x * ((1.0 - y) * c + y * d)


def _derivative(net: Vectors, i: int, j: int, extent: Extent) -> Vectors:
    scale, found = extent[0] ** i * extent[1] ** j, jnp.asarray(nets.derivative(net, i, j))
    return found if isinstance(scale, float) and scale == 1.0 else found * scale


def _largest(net: Vectors, kind: tuple[int, int, float], extent: Extent, maxima: Maxima) -> Lanes:
    """The largest size of a derivative, times its multiplicity."""
    part = _derivative(net, kind[0], kind[1], extent)
    return kind[2] * nets.longest(part, maxima) if nets.size(part) else jnp.zeros_like(net[0, 0, 0])


def _linear(net: Vectors, function: Callable[[Array], Any]) -> Vectors:
    """A linear map of nets of numbers, of all three coordinates."""
    found = function(net.reshape(*net.shape[:2], -1))
    return found.reshape(*found.shape[:2], *net.shape[2:])


def _sum(parts: list[Any], weights: tuple[Any, ...]) -> Any:
    used = [(k, part) for k, part in zip(weights, parts, strict=True) if not (isinstance(k, float) and k == 0.0)]
    return nets.total([k * part for k, part in used])


def _along(vectors: Vectors, axis: Array) -> Numbers:
    return jnp.sum(vectors * axis, axis=2)


def _square(vectors: Array) -> Array:
    """Of lengths; coordinates are the last axis but one."""
    return jnp.sum(vectors * vectors, axis=-2)


def _positive(values: Array) -> Array:
    return jnp.where(values > 0, values, 1.0)
