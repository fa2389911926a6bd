"""A tessellation factor with a proof: docs/certified.md has the theorem, and the letters that are used here.

Kernels run with the patches along the last axis (``slefejax.lanes.layout``), on nets that are unrolled or arrays
(``lanes.nets``). Unrolled, the compiler makes one loop of everything between two divisions or roots, and repeats
what several loops need, so there are few of them. ``predict.plainly`` has the same without that, patch by patch.
"""

from __future__ import annotations

from functools import partial, reduce
from math import perm
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slefejax.bounds.triangles import Extent, HalfCells, Triangles, sum_of_sizes
from slefejax.bounds.twists import any_errors, on_tiles
from slefejax.geometry.bezier import tile_matrices
from slefejax.geometry.gregory import Twisted, lowered
from slefejax.geometry.projection import Projection, numbers, reaches, undivided
from slefejax.lanes import loops, nets
from slefejax.lanes.maxima import EXACT, Maxima, larger, smaller
from slefejax.lanes.nets import Lanes, Net
from slefejax.lanes.tuning import TUNING
from slefejax.predict.terms import FOURTH, THIRD, Terms, solved

Hessian = tuple[Net | None, ...]  # uu, uv, vv

_ROUNDING = 16.0  # a coefficient of a tile is wrong by at most half of this, in eps of the sum of its terms' sizes


@loops.chunked
def certified_factors(
    control: Any, projection: Projection, tolerances: Any, maxima: Maxima, *, tiles: int
) -> tuple[Float[Array, "lanes"], Any]:
    """``certified_factor`` of control points in the world, and of which patches it is not; called with all chunks.

    Differentiable in forward and reverse mode: unrolled that would take the compiler minutes.
    """
    near, apart, others = _near(control, projection)
    return certified_factor(near, projection, tolerances, tiles=tiles, maxima=maxima, apart=apart), others


@certified_factors.rest
def _as_given(control: Any, projection: Projection, tolerances: Any, maxima: Maxima, *, tiles: int) -> Array:
    return certified_factor(projection.relative(control), projection, tolerances, tiles=tiles, maxima=maxima)


@certified_factors.slopes
def _slopes(control: Any, _: Any, projection: Projection, tolerances: Any, maxima: Maxima, *, tiles: int) -> Array:
    near, apart, others = _near(control, projection)
    factor = partial(certified_factor, projection=projection, tolerances=tolerances, tiles=tiles, maxima=maxima)
    found = factor(near, apart=apart, unrolled=False)
    if others is None:
        return found
    return jnp.where(others, factor(projection.relative(control), unrolled=False), found)


def _near(control: Any, projection: Projection) -> tuple[Any, Any, Any]:
    """Control points relative to the origin, of quads of bi-degree 4 ``lowered`` ones, with what that returns."""
    near = projection.relative(control)
    if isinstance(near, Twisted) and len(near.net) == 5:
        return lowered(near, projection.origin)
    return near, None, None


def certified_factor(
    control: Any,
    projection: Projection,
    tolerances: Any,
    triangles: Triangles | None = None,
    *,
    tiles: int,
    maxima: Maxima = EXACT,
    unrolled: bool | None = None,
    apart: Float[Array, "dim lanes"] | None = None,
) -> Float[Array, "lanes"]:
    """A real n >= 1 from which on the bound of docs/certified.md is at most the tolerance; 0 for an unseen patch.

    control    : ``(nu, nv, dim, lanes)``, or ``Twisted`` of Gregory patches, relative to the projection's origin
    tolerances : in pixels, and of window depth or None
    triangles  : for which the bound holds from n on, wherever they are visible; None: all cells of grids
    maxima     : those that make n: over coefficients, both ends of the picture, coordinates, tiles. Whether a patch is
                 seen, and what it reaches of the picture, is exact in any case
    unrolled   : the form of the nets; None: what suits their degrees
    apart      : how far control points may be from those that the factor is for
    """
    if unrolled is None:
        net = control.net if isinstance(control, Twisted) else control
        few = net.shape[0] * net.shape[1] <= TUNING.unrolled_coefficients
        unrolled = bool(few and net.shape[2] == 3 and maxima.exact)
    shapes = HalfCells() if triangles is None else triangles
    screen = Screen.of(control, projection, tolerances, unrolled, apart)
    bends = [_largest_sum(net, shapes.extent, maxima) for net in (*screen.rows[:2], screen.w)]
    if screen.turns is not None:
        turned = (*screen.turns.every[:2], screen.turns.every[3])
        bends = [b + screen.turns.bend(own, shapes) for b, own in zip(bends, turned, strict=True)]
    # in one piece and unrolled it is for speed: turns towards n would be as dear as all the rest
    quick = tiles == 1 and screen.turns is None and nets.unrolled(screen.w)
    of_pieces = _of_the_whole if quick else partial(_of_tiles, tiles=tiles)
    square = of_pieces(screen, shapes, bends, maxima)
    rounded = 1.0 + 128.0 * screen.eps
    # a bound that 1 fulfils is not rounded up: flat patches are one quad
    square = maxima.largest([square * rounded, jnp.ones_like(square)])
    return jnp.sqrt(jnp.where(screen.visible, square, 1.0)) * jnp.where(screen.visible, 1.0, 0.0)


def _of_the_whole(screen: Screen, triangles: Triangles, bends: list[Lanes], maxima: Maxima) -> Lanes:
    """n^2 of patches in one piece: at least what the corners need, which is known without a second loop."""
    whole = Piece.of(screen, None, None, 1)
    least = _least_square(screen, whole, triangles.extent, maxima)
    square = _square(screen, whole, bends[2], triangles, maxima, 1.0 / jnp.sqrt(least))
    return maxima.largest([square, jnp.where(least > 1.0, least, 0.0)])


def _of_tiles(screen: Screen, triangles: Triangles, bends: list[Lanes], maxima: Maxima, tiles: int) -> Lanes:
    """The largest n^2 that a tile needs."""
    unrolled, lanes = nets.unrolled(screen.w), screen.w_size

    def step(found: Lanes, given: tuple[Any, Any], which: tuple[int, ...]) -> Lanes:
        if unrolled:
            # lanes all the same: with single numbers the compiler would split the loop
            given = jax.tree.map(lambda x: _numbers(x, lanes), given)
        piece = Piece.of(screen, *(given if tiles > 1 else (None, given[1])), tiles)
        square = _square(screen, piece, bends[2], triangles, maxima, which=which)
        return maxima.largest([found, smaller(square, _last_visible(screen, piece, bends))])

    (du, dv), square = nets.degrees(screen.w), jnp.zeros_like(lanes)
    table = None if screen.turns is None else on_tiles(screen.turns.slots, du, tiles)
    given = jax.tree.map(lambda x: jnp.asarray(x, lanes.dtype), (tile_matrices(du + 1, dv + 1, tiles), table))
    every = tuple(range(len(screen.rows)))
    # unrolled, loops over three rows take the compiler longer than two loops; with twist terms, those over two rows are
    # not vectorised
    by_loop = (every,)
    if unrolled:
        by_loop = (every[:2], *([every[2:]] if every[2:] else [])) if screen.turns is None else [(k,) for k in every]
    for which in by_loop:
        square = loops.repeated(partial(step, which=which), square, given, differentiable=not unrolled)
    return square


def _numbers(array: Any, lanes: Lanes) -> Any:
    """Rows and rows of numbers, each of them lanes."""
    return [_numbers(x, lanes) for x in array] if array.ndim else jnp.broadcast_to(array, lanes.shape)


class Screen(NamedTuple):
    """Patches in undivided screen coordinates, each row over its tolerance, and what rounding may have done to them."""

    rows: list[Net]  # X, Y and, if there is a depth tolerance, Z: X/W = 1 is one tolerance from the centre
    w: Net
    half: list[Any]  # half the picture's extent for every row
    floor: Lanes  # W of a visible point is at least this
    sizes: list[Lanes]  # of the terms that a row's g_s is summed from: its rounding errors are proportional to them
    w_size: Lanes
    eps: float
    visible: Lanes  # not all control points outside of one plane of the view volume
    rational: bool
    turns: Turns | None  # of Gregory patches

    @staticmethod
    def of(control: Any, projection: Projection, tolerances: Any, unrolled: bool, apart: Any = None) -> Screen:
        """From control points relative to the origin. An unseen patch may count as visible, never the reverse."""
        control, twists = control if isinstance(control, Twisted) else (control, None)
        rational, (pixels, depth) = control.shape[2] == 4, tolerances
        scales = [1.0 / pixels, 1.0 / pixels, 1.0 if depth is None else 1.0 / depth]
        half = [extent * scale for extent, scale in zip(projection.half, scales, strict=True)]
        rows = numbers([row * scale for row, scale in zip(projection.to_pixels, (*scales, 1.0), strict=True)])
        points = nets.coordinates(control, unrolled)
        x, y, z, w = undivided(rows, points)
        largest = [nets.top(nets.each(jnp.abs, coordinate)) for coordinate in points]
        # of rational patches coordinates times weights were taken off
        weight = largest[3] if rational else projection.rounded
        moved = [c + jnp.abs(o) * weight for c, o in zip(largest, projection.origin, strict=False)]
        if twists is not None:
            moved = [c + jnp.sum(jnp.abs(twists[:, a]), axis=0) for a, c in enumerate(moved)]
        eps = float(jnp.finfo(control.dtype).eps)
        if apart is not None:
            # of which _ROUNDING makes what is apart, and 9.6 eps for what lowering them rounds
            moved = [1.6 * c + x / (_ROUNDING * eps) for c, x in zip(moved, apart, strict=True)]
        largest = [*moved, largest[3] if rational else 1.0]
        *own, w_size = (nets.total([jnp.abs(m) * c for m, c in zip(row, largest, strict=True)]) for row in rows)
        sizes = [size + extent * w_size for size, extent in zip(own, half, strict=True)]
        turns = None if twists is None else Turns.of(rows, twists)
        rooms = [] if turns is None else turns.rooms(on_tiles(turns.slots, nets.degrees(w)[0], 1).spread[0].tolist())
        inside = []
        for k, (net, extent, size) in enumerate(zip((x, y, z), half, sizes, strict=True)):
            error = _ROUNDING * eps * size
            inside += [reach + error for reach in _reaches(net, w, extent, rooms, k)]
        # a reduction of stacked arrays would not be vectorised
        visible = reduce(jnp.logical_and, [reach >= 0 for reach in inside])
        weight = nets.bottom(points[3]) if rational else jnp.ones_like(largest[0])
        count = 2 if depth is None else 3
        floor = projection.near_w * weight
        return Screen([x, y, z][:count], w, half[:count], floor, sizes[:count], w_size, eps, visible, rational, turns)


class Turns(NamedTuple):
    """Twist terms of Gregory patches in undivided screen coordinates (docs/certified.md, 10)."""

    every: list[list[Lanes]]  # twists of X, Y, Z and W, slot by slot

    @staticmethod
    def of(rows: list[list[Any]], twists: Array) -> Turns:
        """From twists ``(slots, 3, lanes)``, differences of points."""
        return Turns([[nets.total([m * x for m, x in zip(row, own, strict=False)]) for own in twists] for row in rows])

    @property
    def slots(self) -> int:
        """How many terms there are."""
        return len(self.every[0])

    def rooms(self, spread: Any) -> list[Lanes]:
        """How far the terms lie from 0, of X, Y, Z and W."""
        return [nets.total([jnp.abs(t) * c for t, c in zip(own, spread, strict=True)]) for own in self.every]

    def bend(self, twists: list[Lanes], triangles: Triangles) -> Lanes:
        """8 times what terms err at most, anywhere, on triangles that lie in boxes of extent/n, times n^2."""
        largest = larger(*(jnp.asarray(e, twists[0].dtype) for e in triangles.extent))
        own = any_errors(len(twists))
        return 8.0 * largest**2 * nets.total([jnp.abs(t) * float(c) for t, c in zip(twists, own, strict=True)])

    def errors(self, k: int, piece: Piece, triangles: Triangles) -> Net:
        """The same for g_s of a row and both ends of s, coefficient by coefficient of a piece, whose scale it has."""
        pairs = list(zip(self.every[k], self.every[3], strict=True))
        sizes = [reduce(larger, [jnp.abs(x - s * w) for s in piece.ends[k]]) for x, w in pairs]
        even = isinstance(triangles, HalfCells) and isinstance(triangles.evenness, float) and triangles.evenness == 1.0
        if not (even and all(isinstance(e, float) and e == 1.0 for e in triangles.extent)):
            whole = self.bend(sizes, triangles) / piece.scale
            return nets.each(lambda c: jnp.zeros_like(c) + whole, piece.w)
        scale = 8.0 / piece.scale
        if not nets.unrolled(piece.w):
            table = jnp.asarray(piece.table.errors, sizes[0].dtype) * scale
            return jnp.einsum("sl,sij->ijl", jnp.stack(sizes), table, precision=jax.lax.Precision.HIGHEST)
        found = np.empty(piece.w.shape, object)
        for i, j in np.ndindex(*found.shape):
            found[i, j] = nets.total([t * own[i][j] for t, own in zip(sizes, piece.table.errors, strict=True)]) * scale
        return found


class Piece(NamedTuple):
    """A patch or a tile of it, and the part of the picture that it can reach."""

    rows: list[Net]
    w: Net
    inverse: Net  # 1/W of the coefficients, from above
    widest: Lanes  # the largest of them
    ends: list[tuple[Lanes, Lanes]]  # of the part of the picture, for every row
    within: list[Lanes]  # whether it ends inside of the picture, for every row
    scale: float  # second derivatives of the patch are these times those of the tile
    rooms: list[Lanes]  # of Gregory patches: how far their twist terms lie from 0, of X, Y, Z and W
    table: Any  # and what these err at most (``OnTiles``)

    @staticmethod
    def of(screen: Screen, matrices: Any, table: Any, tiles: int) -> Piece:
        """Where W may lie below the floor, the floor stands for it, and all of the picture is reached.

        matrices : that make the tile of the patch; None: the whole patch
        table    : of Gregory patches: their ``OnTiles`` of this tile
        """
        *rows, w = (net if matrices is None else nets.combined(net, *matrices) for net in (*screen.rows, screen.w))
        error = _ROUNDING * screen.eps
        w_blur = error * screen.w_size
        rooms: list[Lanes] = []
        if screen.turns is not None:
            rooms = screen.turns.rooms(table.spread)
            w_blur = w_blur + rooms[3]
        safe = nets.each(lambda c: c - w_blur, w)
        deep = nets.bottom(safe) >= screen.floor
        inverse = nets.each(lambda c: 1.0 / jnp.where(deep, c, screen.floor), safe)
        widest = nets.top(inverse)
        # where an end is on the far side of 0, dividing by the largest W takes it furthest: W + blur, not W - blur
        least = 1.0 - 2.0 * w_blur * widest
        ends, within = [], []
        for k, (net, half, size) in enumerate(zip(rows, screen.half, screen.sizes, strict=True)):
            limit = jnp.broadcast_to(half, deep.shape)
            blur = error * size + rooms[k] if rooms else error * size
            low = jnp.where(deep, nets.bottom(nets.each(lambda c, i, e=blur: (c - e) * i, net, inverse)), -limit)
            high = jnp.where(deep, nets.top(nets.each(lambda c, i, e=blur: (c + e) * i, net, inverse)), limit)
            low, high = smaller(low, low * least), larger(high, high * least)
            ends.append((_clip(low, limit), _clip(high, limit)))
            within.append(deep & (low >= -limit) & (high <= limit))
        return Piece(rows, w, inverse, widest, ends, within, float(tiles**2), rooms, table)


class Remainder(NamedTuple):
    """Bounds of the higher derivatives of g_s, for s in an interval, over the least W."""

    along_u: Lanes  # |g_uuu| e_u^3 + 3 |g_uuv| e_u^2 e_v
    along_v: Lanes  # |g_vvv| e_v^3 + 3 |g_uvv| e_u e_v^2
    fourth: Lanes  # over 288


def _remainder(screen: Screen, piece: Piece, k: int, extent: Extent, maxima: Maxima) -> Remainder:
    """Of a row. The fourth ones over the whole patch, the third, too, where it is polynomial, which is cheaper.

    The third ones of rational patches are joint bounds over the piece: coefficient by coefficient over that of W.
    """
    ends = piece.ends[k]
    middle, reach = 0.5 * (ends[0] + ends[1]), 0.5 * (ends[1] - ends[0])
    degrees = nets.degrees(screen.w)

    def thirds(row: Net, w: Net) -> tuple[list[Net], list[Net]]:
        about = nets.each(lambda x, y: x - middle * y, row, w)
        one, other = ([nets.differences(net, i, j) for i, j, _ in THIRD] for net in (about, w))
        return one, other

    def sizes(about: Net, w: Net, kind: tuple[int, int, float]) -> Net:
        """Of derivatives at both ends of s, times the extents and how often they count."""
        (i, j, times), (du, dv) = kind, degrees
        scale = times * perm(du, i) * perm(dv, j) * extent[0] ** i * extent[1] ** j
        return nets.each(lambda x, y: scale * (jnp.abs(x) + reach * jnp.abs(y)), about, w) if nets.size(w) else w

    def tops(about: list[Net], w: list[Net], kinds: Any) -> list[Lanes]:
        found = [sizes(*own) for own in zip(about, w, kinds, strict=True)]
        return [nets.top(net, maxima) * piece.widest if nets.size(net) else jnp.zeros_like(reach) for net in found]

    own, depth = thirds(screen.rows[k], screen.w)
    more = [[nets.differences(net[0], 1, 0), *(nets.differences(x, 0, 1) for x in net)] for net in (own, depth)]
    fourth = nets.total(tops(more[0], more[1], FOURTH)) / 288.0
    if not screen.rational:
        uuu, uuv, uvv, vvv = tops(own, depth, THIRD)
        return Remainder(uuu + uuv, vvv + uvv, fourth)
    own, depth = thirds(piece.rows[k], piece.w)
    found = [sizes(*each) for each in zip(own, depth, THIRD, strict=True)]
    nothing = nets.each(jnp.zeros_like, piece.w)
    raised = [nets.raised(net, *degrees) if nets.size(net) else nothing for net in found]
    along = [nets.each(lambda x, y, i: (x + y) * i, *two, piece.inverse) for two in (raised[:2], raised[2:])]
    along_u, along_v = (nets.top(net, maxima) * piece.scale**1.5 for net in along)
    return Remainder(along_u, along_v, fourth)


def _least_square(screen: Screen, whole: Piece, extent: Extent, maxima: Maxima) -> Lanes:
    """The square of what n is at least by the second derivatives at the corners: remainders are taken there.

    Any number >= 1 would do for the proof; one just below n loses least.
    """
    square, cells = jnp.ones_like(whole.widest), HalfCells()
    depth = _plain_hessian(screen.w, extent)
    for row in screen.rows:
        own = _plain_hessian(row, extent)
        for i, j in ((0, 0), (0, -1), (-1, 0), (-1, -1)):
            inverse = whole.inverse[i, j]
            s = row[i, j] * inverse
            value: list[Any] = [
                x[i, j] - s * y[i, j] if nets.size(x) else None for x, y in zip(own, depth, strict=True)
            ]
            square = maxima.largest([square, cells.bend(*value, maxima=maxima) * inverse / 8.0])
    return square


def _square(
    screen: Screen,
    piece: Piece,
    w_bend: Lanes,
    triangles: Triangles,
    maxima: Maxima,
    inverse: Lanes | None = None,
    which: tuple[int, ...] | None = None,
) -> Lanes:
    """n^2 at which the bound for the points of a tile is at most 1.

    inverse : 1/n is at most that; None: what the second derivatives say
    which   : of the rows are looked at; None: all
    """
    depth = _hessian(piece.w, triangles.extent)
    degree = sum(nets.degrees(piece.w))
    rounding = 2.0 * _ROUNDING * screen.eps * (degree**2 / 8.0 + degree**3 / 24.0 + degree**4 / 72.0)
    squares = []
    for k in range(len(piece.rows)) if which is None else which:
        row, ends, size = piece.rows[k], piece.ends[k], screen.sizes[k]
        remainder = _remainder(screen, piece, k, triangles.extent, maxima)
        hessian = _hessian(row, triangles.extent)
        more = None if screen.turns is None else screen.turns.errors(k, piece, triangles)
        tops = [nets.top(_measured(triangles, s, hessian, depth, piece.inverse, maxima, more), maxima) for s in ends]
        second = maxima.largest(tops)
        if screen.rational:
            followed = _followed(screen, piece, row, size, triangles, maxima)
            second = jnp.where(piece.within[k], smaller(second, followed), second)
        second = second * piece.scale
        third, least = triangles.third(remainder.along_u, remainder.along_v, maxima)
        rest = (w_bend / 8.0 + rounding * size) * piece.widest
        terms = Terms(second, third, remainder.fourth, least, rest)
        squares.append(solved(terms, maxima) if inverse is None else terms.square(inverse, maxima))
    return maxima.largest(squares)


def _followed(screen: Screen, piece: Piece, row: Net, size: Lanes, triangles: Triangles, maxima: Maxima) -> Lanes:
    """The largest measure of the Hessian of g_s* over W where s* = X/W follows the place: docs/certified.md, (7).

    A bilinear s stands for X/W, and the largest distance between the two counts in full. The second derivatives of W of
    rational patches are large, so that it matters which s goes with them.
    """
    corners = [[row[i, j] * piece.inverse[i, j] for j in (0, -1)] for i in (0, -1)]
    du, dv = (d + 1 for d in nets.degrees(row))

    def raised(part: Net) -> Net | None:
        return nets.raised(part, du, dv) if nets.size(part) else None

    bends = _plain_hessian(piece.w, triangles.extent)
    own = [raised(part) for part in _plain_hessian(row, triangles.extent)]
    followed = [raised(nets.bilinear_times(corners, part)) if nets.size(part) else None for part in bends]
    error = _ROUNDING * screen.eps
    w = nets.raised(piece.w, du, dv)
    inverse = nets.each(lambda c: 1.0 / larger(c - error * screen.w_size, jnp.broadcast_to(screen.floor, c.shape)), w)
    ones = jnp.ones_like(size)
    whole = _measured(triangles, ones, tuple(own), tuple(followed), inverse, maxima)
    zero = [None if part is None else nets.each(jnp.zeros_like, part) for part in own]
    depth = [raised(part) for part in bends]
    rest = _measured(triangles, ones, tuple(zero), tuple(depth), inverse, maxima)
    apart = nets.each(
        lambda x, y, i: (jnp.abs(x - y) + error * size) * i,
        nets.raised(row, du, dv),
        nets.bilinear_times(corners, piece.w),
        inverse,
    )
    return nets.top(whole, maxima) + nets.top(apart, maxima) * nets.top(rest, maxima)


def _last_visible(screen: Screen, piece: Piece, bends: list[Lanes]) -> Lanes:
    """n^2 beyond which no triangle of a tile is visible; infinite if there is none.

    A drawn point differs from the exact one by at most bend/(8 n^2) in every row, so it is outside of a plane that all
    coefficients of the tile are further outside of.
    """
    error = _ROUNDING * screen.eps
    *row_bends, w_bend = bends
    planes = [(screen.floor - error * screen.w_size - nets.top(piece.w), w_bend)]
    if piece.rooms:
        planes = [(planes[0][0] - piece.rooms[3], w_bend)]
    for k, (net, half, size, bend) in enumerate(
        zip(piece.rows[:2], screen.half[:2], screen.sizes[:2], row_bends, strict=True)
    ):
        reached = _reaches(net, piece.w, half, piece.rooms, k)
        planes += [(-reach - error * size, bend + half * w_bend) for reach in reached]
    last = jnp.full_like(screen.w_size, jnp.inf)
    for outside, bend in planes:
        away = outside > 0
        square = bend / (8.0 * jax.lax.select(away, outside, jnp.ones_like(outside)))
        last = smaller(last, jax.lax.select(away, square, jnp.full_like(square, jnp.inf)))
    return last


def _reaches(net: Net, w: Net, half: Any, rooms: list[Lanes], k: int) -> tuple[Lanes, Lanes]:
    """``reaches``, and what twist terms may add."""
    found = reaches(net, w, half)
    if not rooms:
        return found
    more = rooms[k] + half * rooms[3]
    return found[0] + more, found[1] + more


def _largest_sum(net: Net, extent: Extent, maxima: Maxima) -> Lanes:
    """At least the largest |uu| + 2 |uv| + |vv|, each over its own coefficients."""
    parts = _plain_hessian(net, extent)
    tops: list[Any] = [nets.top(nets.each(jnp.abs, part), maxima) if nets.size(part) else None for part in parts]
    return sum_of_sizes(tops[0], tops[1], tops[2])


def _measured(
    triangles: Triangles,
    s: Lanes,
    own: Hessian,
    depth: Hessian,
    inverse: Net,
    maxima: Maxima,
    more: Net | None = None,
) -> Net:
    """What triangles are off by the Hessian of g_s over W, coefficient by coefficient, and by ``more``."""
    there = [x is not None for x in own]

    def minus(x: Lanes, y: Lanes) -> Lanes:
        return x - s * y

    def at(i: Lanes, *values: Lanes) -> Lanes:
        pairs = zip(values[::2], values[1::2], strict=True)
        hessian: list[Any] = [None if not given else minus(*next(pairs)) for given in there]
        return triangles.bend(*hessian, maxima=maxima) * i

    found = nets.each(at, inverse, *(x for pair in zip(own, depth, strict=True) for x in pair if x is not None))
    return found if more is None else nets.each(lambda x, y, i: x + y * i, found, more, inverse)


def _plain_hessian(net: Net, extent: Extent) -> list[Net]:
    """uu, uv, vv times the extents, each of its own degree; without coefficients if it is identically 0."""
    parts = []
    for i, j in ((2, 0), (1, 1), (0, 2)):
        part, scale = nets.derivative(net, i, j), extent[0] ** i * extent[1] ** j
        plain = isinstance(scale, float) and scale == 1.0
        parts.append(part if plain or not nets.size(part) else nets.each(lambda c, k=scale: c * k, part))
    return parts


def _hessian(net: Net, extent: Extent) -> Hessian:
    """(uu, uv, vv) times the extents, coefficients of the net's own degrees; None for one that is identically 0."""
    uu, uv, vv = (nets.raised(x, *nets.degrees(net)) if nets.size(x) else None for x in _plain_hessian(net, extent))
    return uu, uv, vv


def _clip(value: Lanes, limit: Lanes) -> Lanes:
    return larger(smaller(value, limit), -limit)
