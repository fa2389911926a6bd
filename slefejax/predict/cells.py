"""How far cells and triangles of a patch err on the screen: one by one, from above (docs/certified.md, section 7).

On a cell, or on any triangle, the error is compared with that of the quadratic polynomial which agrees with it at the
corners and in the middles of the sides. For a quadratic these middles tell the largest error exactly; the rest is a
third derivative, of the cell alone, and small. Nothing is sampled in the sense that something could be missed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial, reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from slefejax.geometry.bezier import bernstein
from slefejax.geometry.projection import Projection, reaches, undivided
from slefejax.geometry.view import homogeneous
from slefejax.lanes import loops, nets, passes
from slefejax.lanes.maxima import larger, smaller
from slefejax.lanes.nets import Lanes, Net
from slefejax.lanes.tuning import TUNING
from slefejax.tessellator.direct3d11 import ragged

_THIRD = ((3, 0, 1.0), (2, 1, 3.0), (1, 2, 3.0), (0, 3, 1.0))  # d/du, d/dv, multiplicity
# How far quadratic interpolation on a triangle in the unit square errs: for a constant third derivative of size 1,
# 1/(72 sqrt 3), and for one that differs by 1 from a constant (docs/certified.md, section 7)
_CONSTANT = 0.00802
_VARYING = 0.0208
_ROUNDING = 256.0 * np.finfo(np.float64).eps
_HIGHEST = 128  # factors above are left as they are: proofs take time as the square
_TRIED = 16  # numbers below a factor that are tried, at most
_EVEN = np.minimum(np.arange(_HIGHEST + 1) / np.maximum(np.arange(_HIGHEST + 1), 1)[:, None], 1.0)
_BATCH = 2**16  # cells or triangles that are held at once


class Pictured(NamedTuple):
    """Patches on the screen, float64, patches last; rows X, Y and Z over their tolerances, W."""

    control: np.ndarray  # (nu, nv, 4, patches)
    half: np.ndarray  # (3,)
    sizes: np.ndarray  # (4, patches): of the terms that coefficients are summed from
    floor: np.ndarray  # (patches,): W of visible points is at least this
    rows: int  # 3 with a depth tolerance, else 2

    @staticmethod
    def of(patches: np.ndarray, projection: Projection, tolerances: tuple[Any, Any]) -> Pictured:
        """From control points in the world."""
        depth = 1.0 if tolerances[1] is None else float(tolerances[1])
        scale = 1.0 / np.array([float(tolerances[0]), float(tolerances[0]), depth, 1.0])
        matrix = np.asarray(projection.to_pixels, np.float64) * scale[:, None]
        points = projection.relative(np.moveaxis(homogeneous(np.asarray(patches, np.float64)), 0, -1))
        control = np.stack(undivided(matrix, nets.coordinates(points, unrolled=False)), axis=2)
        largest = np.abs(points).max(axis=(0, 1))
        if patches.shape[-1] == 4:
            # coordinates times weights were taken off
            largest[:3] += np.abs(projection.origin)[:, None] * largest[3]
        sizes = np.einsum("rc,cp->rp", np.abs(matrix), largest)
        half = np.asarray(projection.half, np.float64) * scale[:3]
        floor = float(projection.near_w) * points[:, :, 3].min(axis=(0, 1))
        return Pictured(control, half, sizes, floor, 2 if tolerances[1] is None else 3)

    def page(self, count: int) -> list[np.ndarray]:
        """For so many patches, with zeros behind the last; control points patches first, so that one's lie together."""
        missing = count - self.control.shape[-1]
        more = lambda x: np.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, missing)])  # noqa: E731
        return [np.moveaxis(more(self.control), -1, 0), self.half, more(self.sizes), more(self.floor)]


class Pictures:
    """Patches on the screen as they are asked for: most scenes have many that nobody needs to look at.

    They are kept in pages of one size, so that one program does for all of them.

    make  : makes those of some numbers
    count : of all patches
    """

    def __init__(self, make: Callable[[np.ndarray], Pictured], count: int) -> None:
        self._make = make
        self._place = np.full(count, -1)
        self._pages: list[tuple[Any, ...]] = []

    def through(self, compiled: Any, patch: Int[np.ndarray, "n"], *numbers: np.ndarray) -> Float[np.ndarray, "n"]:
        """What a pass makes of patches and numbers ``(n, ...)`` each."""
        if not len(patch):
            return np.zeros(0)
        self._look_for(patch)
        page, place = np.divmod(self._place[patch], TUNING.page)
        items, found = np.column_stack([place, *numbers]).astype(np.float64), np.empty(len(patch))
        which = _blocks(page, TUNING.cells)
        chunks = items[which].reshape(len(which), 2, -1, items.shape[1]).swapaxes(2, 3).copy()
        with jax.enable_x64(True):
            # nothing is waited for before all of them are under way
            made = [compiled(own, *self._pages[page[block[0]]]) for own, block in zip(chunks, which, strict=True)]
        for block, own in zip(which, made, strict=True):
            found[block] = np.asarray(own).ravel()
        return found

    def _look_for(self, patch: np.ndarray) -> None:
        missing = np.unique(patch[self._place[patch] < 0])
        for start in range(0, len(missing), TUNING.page):
            own = missing[start : start + TUNING.page]
            made = self._make(own)
            self._place[own] = len(self._pages) * TUNING.page + np.arange(len(own))
            with jax.enable_x64(True):
                self._pages.append((*(jnp.asarray(x) for x in made.page(TUNING.page)), made.rows))


def _blocks(page: np.ndarray, size: int) -> Int[np.ndarray, "blocks size"]:
    """Which items are looked at together: so many, of one page; what is missing is the last one again."""
    order = np.argsort(page, kind="stable")
    counts = np.bincount(page)
    ends, (own, number) = np.cumsum(counts), ragged(-(-counts // size))
    start = (ends - counts)[own] + number * size
    return order[np.minimum(start[:, None] + np.arange(size), ends[own, None] - 1)]


def cell_errors(
    pictures: Pictures, patch: Int[np.ndarray, "n"], low: Float[np.ndarray, "n 2"], high: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n"]:
    """At most how far visible points of cells err, cut along either diagonal, in tolerances; 0 for unseen cells.

    Infinite where a cell is beside or behind the near plane.
    """
    return pictures.through(_cells_pass, patch, low, high)


def triangle_errors(
    pictures: Pictures, patch: Int[np.ndarray, "n"], corners: Float[np.ndarray, "n 3 2"]
) -> Float[np.ndarray, "n"]:
    """The same of triangles, from the parameters of their corners."""
    return pictures.through(_triangles_pass, patch, corners.reshape(-1, 6))


def grid_errors(
    pictures: Pictures, patch: Int[np.ndarray, "n"], levels: Int[np.ndarray, "n 2"], lines: Float[np.ndarray, "n m"]
) -> Float[np.ndarray, "n"]:
    """The same of patches cut into that many cells along u and v.

    lines : ``(levels + 1, lines)``, where the lines of a grid are, by its level
    """
    counts = levels.prod(axis=1)
    ends = np.cumsum(counts)
    worst = np.zeros(len(patch))
    for start in range(0, int(ends[-1]) if len(ends) else 0, _BATCH):
        index = np.arange(start, min(start + _BATCH, int(ends[-1])))
        which = np.searchsorted(ends, index, side="right")
        cell = np.stack(np.divmod(index - (ends[which] - counts[which]), levels[which, 1]), axis=1)
        low, high = (lines[levels[which], cell + k] for k in (0, 1))
        np.maximum.at(worst, which, cell_errors(pictures, patch[which], low, high))
    return worst


def verified_factors(factor: Float[np.ndarray, "patches"], pictures: Pictures) -> Float[np.ndarray, "patches"]:
    """Certified factors, or the smallest whole numbers from which on every grid up to them is proved fine.

    Grids are tried from the certified one downwards until one cannot be proved.
    """
    factor = np.asarray(factor, np.float64).copy()
    trial = np.ceil(factor).astype(np.int64) - 1
    open_ones = np.flatnonzero((trial >= 1) & (factor <= _HIGHEST))
    for _ in range(_TRIED):
        levels = np.repeat(trial[open_ones, None], 2, axis=1)
        fine = grid_errors(pictures, open_ones, levels, _EVEN) <= 1.0
        open_ones = open_ones[fine]
        factor[open_ones] = trial[open_ones]
        trial[open_ones] -= 1
        open_ones = open_ones[trial[open_ones] >= 1]
    return factor


@passes.as_pass(5)
def _cells_pass(packed: Any, control: Any, half: Any, sizes: Any, floor: Any, rows: int) -> Any:
    return loops.over_chunks(partial(_cell_error, rows=rows), packed, control, half, sizes, floor)


@passes.as_pass(5)
def _triangles_pass(packed: Any, control: Any, half: Any, sizes: Any, floor: Any, rows: int) -> Any:
    return loops.over_chunks(partial(_triangle_error, rows=rows), packed, control, half, sizes, floor)


class _Part(NamedTuple):
    """A part of a patch: what lies in a box of the domain."""

    rows: list[Net]  # of X, Y (and Z) less s W, with an s of the box's middle
    w: Net
    least: Lanes  # W is at least that
    deep: Lanes  # and that is away from 0
    far: list[Lanes]  # how far s can be from that of the middle, for every row
    blur: list[Lanes]  # what rounding may have done
    unseen: Lanes  # outside of one plane, with all that is drawn of it

    @staticmethod
    def of(
        pictured: tuple[Any, ...], patch: Lanes, low: list[Lanes], high: list[Lanes], rows: int, whole: bool
    ) -> _Part:
        """whole : all of the box is drawn, from corner to corner; else some triangle in it."""
        control, half, sizes, floor = pictured
        index = patch.astype(jnp.int32)
        # once: other fusions would gather again
        own, size = loops.once(jnp.moveaxis(control[index], 0, -1)), sizes[:, index]
        few = own.shape[0] * own.shape[1] <= TUNING.unrolled_coefficients
        along = [nets.restricting(n, a, b) for n, a, b in zip(own.shape[:2], low, high, strict=True)]
        *every, w = (nets.restricted(net, *along) for net in nets.coordinates(own, few))
        least = nets.bottom(w) - _ROUNDING * size[3]
        deep = least >= 0.5 * floor[index]
        least = jnp.where(deep, least, 1.0)
        drawn = [_corners(net) if whole else net for net in (*every, w)]
        planes = [_outside(net, drawn[-1], half[k], size[k], size[3]) for k, net in enumerate(drawn[:-1])]
        middle = _middle(w)
        relative, far, blur = [], [], []
        for k in range(rows):
            s = jnp.clip(_middle(every[k]) / jnp.where(deep, middle, 1.0), -half[k], half[k])
            net = nets.each(lambda x, d, s=s: x - s * d, every[k], w)
            relative.append(net)
            far.append(nets.top(nets.each(jnp.abs, net)) / least)
            blur.append(_ROUNDING * (size[k] + half[k] * size[3]))
        return _Part(relative, w, least, deep, far, blur, reduce(jnp.logical_or, planes))

    def error(self, measured: Any) -> Lanes:
        """The largest error, for what measures the interpolation error of one polynomial from above."""
        of_w, worst = measured(self.w), jnp.zeros_like(self.least)
        for net, far, blur in zip(self.rows, self.far, self.blur, strict=True):
            # linear in s, and a seminorm
            worst = larger(worst, (measured(net) + far * of_w + blur) / self.least)
        return jnp.where(self.unseen, 0.0, jnp.where(self.deep, worst, jnp.inf))


def _cell_error(lanes: Any, *pictured: Any, rows: int) -> Lanes:
    return _Part.of(pictured, lanes[0], [lanes[1], lanes[2]], [lanes[3], lanes[4]], rows, True).error(_of_cell)


def _triangle_error(lanes: Any, *pictured: Any, rows: int) -> Lanes:
    u, v = lanes[1::2], lanes[2::2]
    low, high = ([reduce(choose, x) for x in (u, v)] for choose in (smaller, larger))
    inside = [_inside(x, a, b) for x, a, b in zip((u, v), low, high, strict=True)]
    return _Part.of(pictured, lanes[0], low, high, rows, False).error(partial(_of_triangle, places=inside))


def _of_cell(net: Net) -> Lanes:
    """The interpolation error of a polynomial on a cell, for both diagonals."""
    at = nets.combined(net, *(_quarters(n) for n in net.shape[:2]))
    return reduce(larger, [_of_halves(at, rising) for rising in (True, False)]) + _rest(net) / 8.0


def _quarters(count: int) -> list[list[float]]:
    """The Bernstein polynomials at 0, 1/4, ..., 1."""
    return [[float(b) for b in bernstein(count - 1, np.float64(k / 4))] for k in range(5)]


def _of_halves(at: Net, rising: bool) -> Lanes:
    """From the values at multiples of a quarter: Bézier coefficients of the quadratics on quarters of both halves."""
    corners = at[0, 0], at[-1, 0], at[-1, -1], at[0, -1]
    error = np.empty((5, 5), object)
    for i, j in np.ndindex(5, 5):
        drawn = [(p, k) for p, k in zip(corners, _shares(i / 4, j / 4, rising), strict=True) if k]
        # of corners, exactly
        error[i, j] = jnp.zeros_like(at[0, 0]) if len(drawn) == 1 else at[i, j] - nets.total([p * k for p, k in drawn])
    found = [error[0, 2], error[2, 0], error[2, 2], error[2, 4], error[4, 2]]
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


def _of_triangle(net: Net, places: list[list[Lanes]]) -> Lanes:
    """The same on a triangle, whose corners and middles of sides lie there."""
    basis = [[bernstein(n - 1, t) for t in own] for n, own in zip(net.shape[:2], places, strict=True)]
    at = [nets.combined_at(net, u, v) for u, v in zip(*basis, strict=True)]
    a, b, c = (at[3 + k] - 0.5 * (at[k] + at[(k + 1) % 3]) for k in range(3))
    return reduce(smaller, [_of_quadratic(*own) for own in ((a, b, c), (b, c, a), (c, a, b))]) + _rest(net)


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
            parts.append(0.5 * times * (_CONSTANT * jnp.abs(high + low) + _VARYING * (high - low)))
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


def _corners(net: Net) -> Net:
    return nets.objects([[net[i, j] for j in (0, -1)] for i in (0, -1)])


def _outside(net: Net, w: Net, half: Any, size: Lanes, w_size: Lanes) -> Lanes:
    """Whether points lie outside of one of two opposite planes of the view volume."""
    margin = _ROUNDING * (size + half * w_size)
    low, high = reaches(net, w, half)
    return (low + margin < 0) | (high + margin < 0)
