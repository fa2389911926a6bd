"""How finely normals have to be interpolated: the bound of docs/certified.md, 11, for nets of undivided normals.

Nets are arrays ``(ku+1, kv+1, 3, lanes)`` (``geometry.normals``); unrolled they take the compiler too long.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from slefejax.bounds.triangles import Extent, HalfCells, Triangles
from slefejax.geometry.bezier import tile_matrices
from slefejax.lanes import loops, nets
from slefejax.lanes.maxima import EXACT, Maxima, larger, root
from slefejax.lanes.nets import Lanes
from slefejax.predict.terms import FOURTH, THIRD, Terms, solved

_SECOND = ((2, 0, 1.0), (1, 1, 2.0), (0, 2, 1.0))  # d/du, d/dv, multiplicity
# A coefficient of the net is wrong by at most that, in eps of its size, and what makes tiles of it adds an eighth
_ROUNDING = 64.0

Vectors = Array  # (ku+1, kv+1, 3, lanes)
Numbers = Array  # (ku+1, kv+1, lanes)


class Turning(NamedTuple):
    """What grids of n x n cells need for interpolated normals to be near enough.

    square  : n^2 from which on they are
    second  : the part of it that second derivatives make
    corners : what that is at corners of tiles alone, so that more tiles cannot make it less
    known   : whether all of that is so: nowhere else normals may vanish, as far as these tiles tell
    """

    square: Lanes
    second: Lanes
    corners: Lanes
    known: Lanes

    @property
    def factor(self) -> Lanes:
        """Real factors; infinite where nothing is known."""
        return jnp.where(self.known, root(self.square), jnp.inf)


def turning(
    net: Float[Array, "ku kv 3 lanes"],
    size: Lanes,
    angle: Any,
    triangles: Triangles | None = None,
    *,
    tiles: int,
    maxima: Maxima = EXACT,
) -> Turning:
    """Of undivided normals, for an angle in radians.

    size      : of a coordinate of the net, to which its rounding errors are proportional
    triangles : for which that holds; None: all cells of grids
    """
    shapes = HalfCells() if triangles is None else triangles
    whole = [nets.total([_largest(net, own, shapes.extent, maxima) for own in kind]) for kind in (_SECOND, FOURTH)]

    def step(found: Turning, matrices: Any) -> Turning:
        tile = _Tile.of(_linear(net, lambda flat: nets.combined(flat, *matrices)), size, maxima)
        own = tile.turning(whole, angle, shapes, tiles, maxima)
        square, second, corners = (maxima.largest([a, b]) for a, b in zip(found[:3], own[:3], strict=True))
        return Turning(square, second, corners, found.known & own.known)

    given = jax.tree.map(lambda x: jnp.asarray(x, net.dtype), tile_matrices(net.shape[0], net.shape[1], tiles))
    start = Turning(jnp.ones_like(size), jnp.zeros_like(size), jnp.zeros_like(size), size > 0)
    return loops.repeated(step, start, given)


class _Tile(NamedTuple):
    """A part of a net, and N . m for a direction m in its middle, by which it is divided."""

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

    @staticmethod
    def of(net: Vectors, size: Lanes, maxima: Maxima) -> _Tile:
        """From coefficients, and the size that their rounding errors are proportional to."""
        mean = jnp.sum(net, axis=(0, 1))
        axis = mean / _positive(_length(mean))
        error = _ROUNDING * float(jnp.finfo(net.dtype).eps) * size
        w = _along(net, axis)
        least = nets.bottom(w) - 2.0 * error
        deep = least > 0
        w, over = loops.once((jnp.where(deep, w, 1.0), 1.0 / jnp.where(deep, w - 2.0 * error, 1.0)))
        widest = 1.0 / jnp.where(deep, least, 1.0)
        reach = _longest(net * over[:, :, None] - axis, maxima) + error * widest
        (a, b), (c, d) = ends = [[net[i, j] / w[i, j] for j in (0, -1)] for i in (0, -1)]
        about = loops.once(_bilinear(ends, *nets.degrees(net)))
        slopes = [larger(_length(p), _length(q)) for p, q in ((c - a, d - b), (b - a, d - c))]
        return _Tile(net, axis, w, over, deep, widest, reach, error, about, (slopes[0], slopes[1]))

    def turning(self, whole: list[Lanes], angle: Any, triangles: Triangles, tiles: int, maxima: Maxima) -> Turning:
        """Of the points in the tile. whole: sums of sizes of second and of fourth derivatives of all of the patch."""
        degree, scale = float(sum(nets.degrees(self.net))), self.widest / angle
        blur = [(1.0 + tiles**order / 8.0) * (2.0 * degree) ** order * self.error * scale for order in (2, 3)]
        second, corners = self._bend(triangles, maxima)
        second = second * tiles**2 / angle + blur[0]
        uuu, uuv, uvv, vvv = (self._third(kind, triangles.extent, maxima) * tiles**3 * scale for kind in THIRD)
        third, least = triangles.third(uuu + uuv + blur[1], vvv + uvv + blur[1], maxima)
        fourth = (whole[1] * root(1.0 + self.reach**2) + 16.0 * degree**4 * self.error) / 288.0 * scale
        square = solved(Terms(second, third, fourth, least, whole[0] / 8.0 * self.widest), maxima)
        square = square * (1.0 + 128.0 * float(jnp.finfo(self.net.dtype).eps))
        return Turning(square, second / 8.0, corners * tiles**2 / (8.0 * angle), self.deep)

    def _bend(self, triangles: Triangles, maxima: Maxima) -> tuple[Lanes, Lanes]:
        """How far triangles bend N - s N.m at most, over N.m, where s is N over N.m at the place; and at corners alone.

        t stands for s, and what of a product with t is no sum of Bernstein terms is added.
        """
        parts = loops.once([self._raised(_derivative(self.net, i, j, triangles.extent)) for i, j, _ in _SECOND])
        depth = loops.once([_along(part, self.axis) for part in parts])
        left = [self._less(part, along) for part, along in zip(parts, depth, strict=True)]
        squares = maxima.largest([_square(_sum(left, own)) for own in triangles.directions]) * self.over**2
        flat = [_sum(depth, own) for own in triangles.directions]
        bend = root(nets.top(squares, maxima)) + self._slip(flat, maxima) * self.widest
        apart = _longest(self._less(self.net, self.w) * self.over[:, :, None], maxima)
        apart = apart + (self._slip([self.w], maxima) + self.error) * self.widest
        rest = nets.top(maxima.largest([jnp.abs(own) for own in flat]) * self.over, maxima)
        corners = [squares[i, j] for i in (0, -1) for j in (0, -1)]
        return bend + apart * rest, root(reduce(larger, corners))

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
        for i, slope in enumerate(self.slopes):
            steps = [nets.differences(part, 1 - i, i) for part in parts]
            if nets.size(steps[0]):
                found.append(slope * nets.top(maxima.largest([jnp.abs(own) for own in steps]), maxima))
        return 0.25 * nets.total(found) if found else jnp.zeros_like(self.reach)

    def _third(self, kind: tuple[int, int, float], extent: Extent, maxima: Maxima) -> Lanes:
        """The largest size of a third derivative of N - s N.m, for all s of the tile, times how often it counts."""
        part = _derivative(self.net, kind[0], kind[1], extent)
        if not nets.size(part):
            return jnp.zeros_like(self.reach)
        part = loops.once(part)
        along = _along(part, self.axis)
        across = _longest(part - along[:, :, None] * self.axis, maxima)
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
    return kind[2] * _longest(part, maxima) if nets.size(part) else jnp.zeros_like(net[0, 0, 0])


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


def _length(vectors: Array) -> Array:
    return root(_square(vectors))


def _longest(vectors: Vectors, maxima: Maxima) -> Lanes:
    return root(nets.top(_square(vectors), maxima))


def _positive(values: Array) -> Array:
    return jnp.where(values > 0, values, 1.0)
