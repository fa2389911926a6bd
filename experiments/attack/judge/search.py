"""Where the largest ratio is: cells, triangles and what is near, of anything that is interpolated over triangles.

Samples are compared in double precision; places whose ratio comes near 1, or that double precision cannot tell, are
looked at again in long double.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from math import comb
from typing import Any, NamedTuple, Protocol, Self

import numpy as np

ALLOWANCE = 4e-9  # a ratio of at most 1 + this is not held against anyone
NEAR = 0.9  # ratios from which on double precision is not enough
UNSEEN = -1.0  # the ratio of what does not count
_MOST_LINES = 96  # cells along u and v that are looked at; of finer grids so many are drawn by lot
_BLOCK = 2**17  # samples at once
_KEPT = 3  # places of a pair that are looked at more closely
_ZOOMS, _FINE_ZOOMS = 5, 12
_LONG_TRIANGLE = 1 / 6  # of the domain; sampled more densely


class Judged(Protocol):
    """What is judged of some pairs: a value of several parts everywhere, and what is linear over triangles instead."""

    @property
    def pairs(self) -> int:
        """How many there are."""
        ...

    @property
    def finest(self) -> int:
        """Samples along each side of a patch, at least."""
        ...

    @property
    def close(self) -> bool:
        """Whether short triangles are sampled closely too."""
        ...

    @property
    def numbers(self) -> int:
        """Control numbers of a pair."""
        ...

    @staticmethod
    def joined(parts: list[Any]) -> Any:
        """The pairs of several ones of a kind."""
        ...

    def only(self, chosen: Any) -> Self:
        """Some of the pairs."""
        ...

    def astype(self, dtype: Any) -> Self:
        """In another precision."""
        ...

    def at(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Values ``(pairs, places, parts)`` at u and v ``(pairs, places)``."""
        ...

    def on_grid(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Values ``(parts, pairs, nu, nv)`` at all pairs of u ``(nu,)`` and v ``(nv,)``."""
        ...

    def ratio(self, true: np.ndarray, drawn: np.ndarray) -> np.ndarray:
        """Of an error to what is allowed, ``(pairs, ...)``, of values ``(parts, pairs, ...)``; -1: does not count."""
        ...

    def noise(self, places: Places) -> np.ndarray:
        """What rounding in double precision may make of the ratio at these places, one of every pair."""
        ...


class Found(NamedTuple):
    """The largest ratio of every pair, and where: -1 where nothing is seen.

    triangle : ``(pairs, 3, 2)``, parameters of the corners of the domain triangle
    share    : ``(pairs, 3)``, barycentric coordinates in it
    """

    ratio: np.ndarray
    triangle: np.ndarray
    share: np.ndarray


def judge_uniform(judged: Judged, cuts: np.ndarray, seed: int = 0) -> Found:
    """Pairs cut into ``cuts`` = ``(pairs, 2)`` equal cells along u and v, the worse diagonal of each cell.

    Of grids with more than 96 cells a side so many rows and columns are looked at, drawn by the seed.
    """
    places = []
    rng = np.random.default_rng(seed)
    for cut in np.unique(cuts, axis=0):
        own = np.flatnonzero(np.all(cuts == cut, axis=1))
        lines = [_lines(int(n), rng) for n in cut]
        order = 2 * int(np.ceil(judged.finest / (2 * min(judged.finest / 2, cut.min()))))
        step = max(1, _BLOCK // (len(lines[0]) * len(lines[1]) * len(_samples(order))))
        for at in range(0, len(own), step):
            block = own[at : at + step]
            places.append(_worst_of_cells(judged.only(block), block, (int(cut[0]), int(cut[1])), lines, order))
    return _closer(judged, Places.joined(places))


def judge_triangles(judged: Judged, pair: np.ndarray, parameters: np.ndarray) -> Found:
    """Given domain triangles ``(triangles, 3, 2)`` of the pairs ``(triangles,)``."""
    places = []
    long = np.ptp(parameters, axis=1).max(axis=1, initial=0.0) > _LONG_TRIANGLE
    order = np.argsort(pair, kind="stable")
    starts = np.searchsorted(pair[order], np.arange(judged.pairs + 1))
    short = _CLOSE if judged.close else _COARSE
    for k in range(judged.pairs):
        own = order[starts[k] : starts[k + 1]]
        for lattice, chosen in ((_shares(12), own[long[own]]), (short, own[~long[own]])):
            for at in range(0, len(chosen), max(1, _BLOCK // len(lattice))):
                block = chosen[at : at + max(1, _BLOCK // len(lattice))]
                places.append(_worst_of_triangles(judged, k, parameters[block], lattice))
    return _closer(judged, Places.joined(places))


class Places(NamedTuple):
    """Samples with large ratios: of which pair, where."""

    pair: np.ndarray
    ratio: np.ndarray
    triangle: np.ndarray
    share: np.ndarray

    @staticmethod
    def joined(parts: list[Places]) -> Places:
        """All of them that are seen."""
        none = Places(np.zeros(0, int), np.zeros(0), np.zeros((0, 3, 2)), np.zeros((0, 3)))
        whole = Places(*(np.concatenate(x) for x in zip(none, *parts, strict=True)))
        return whole.only(whole.ratio >= 0)

    def only(self, chosen: np.ndarray) -> Places:
        """Some of them."""
        return Places(*(x[chosen] for x in self))


def _lines(n: int, rng: np.random.Generator) -> np.ndarray:
    """Which rows of cells are looked at: the outermost always."""
    if n <= _MOST_LINES:
        return np.arange(n)
    return np.unique(np.append(rng.integers(1, n - 1, _MOST_LINES - 2), [0, n - 1]))


class _Sample(NamedTuple):
    """A place of the unit cell: lattice indices, the corners of a triangle that it lies in, its shares there."""

    at: tuple[int, int]
    corners: tuple[tuple[int, int], tuple[int, int], tuple[int, int]]
    share: tuple[float, float, float]


@cache
def _samples(order: int) -> tuple[_Sample, ...]:
    """Places of a lattice in a cell, on its sides once and inside of it for both diagonals; not its corners."""
    found = []
    for i, j in product(range(order + 1), repeat=2):
        a, b = i / order, j / order
        if (i in (0, order)) and (j in (0, order)):
            continue
        rising = ((0, 0), (1, 0), (1, 1)), (1 - a, a - b, b)
        if a < b:
            rising = ((0, 0), (0, 1), (1, 1)), (1 - b, b - a, a)
        falling = ((0, 0), (1, 0), (0, 1)), (1 - a - b, a, b)
        if a + b > 1:
            falling = ((1, 1), (0, 1), (1, 0)), (a + b - 1, 1 - a, 1 - b)
        inside = 0 < i < order and 0 < j < order
        found += [_Sample((i, j), *way) for way in ((rising, falling) if inside else (rising,))]
    return tuple(found)


@cache
def _shares(order: int) -> np.ndarray:
    """Barycentric coordinates of a lattice in a triangle."""
    places = [(i, j, order - i - j) for i in range(order + 1) for j in range(order + 1 - i)]
    return np.array(places, np.float64) / order


_COARSE = np.array([[0.5, 0.5, 0.0], [0.0, 0.5, 0.5], [0.5, 0.0, 0.5], [1 / 3, 1 / 3, 1 / 3]])
_CLOSE = _shares(4)


def bernstein(degree: int, t: np.ndarray) -> np.ndarray:
    """b_0 ... b_degree along a new last axis."""
    t = t[..., None]
    k = np.arange(degree + 1)
    return np.array([comb(degree, int(j)) for j in k]).astype(t.dtype) * t**k * (1 - t) ** (degree - k)


def _worst_of_cells(
    judged: Judged, pair: np.ndarray, cut: tuple[int, int], lines: list[np.ndarray], order: int
) -> Places:
    """The largest samples of each pair on some rows and columns of cells."""
    samples = _samples(order)
    steps = np.arange(order + 1) / order
    places = [((line[:, None] + steps) / n).ravel() for line, n in zip(lines, cut, strict=True)]
    double = judged.astype(np.float64)
    points = double.on_grid(*places)
    points = points.reshape(len(points), len(pair), len(lines[0]), order + 1, len(lines[1]), order + 1).swapaxes(3, 4)
    corners = points[..., ::order, ::order].reshape(*points.shape[:4], 4)
    weights = np.zeros((4, len(samples)))
    for k, sample in enumerate(samples):
        for (a, b), share in zip(sample.corners, sample.share, strict=True):
            weights[2 * a + b, k] += share
    i, j = np.array([sample.at for sample in samples]).T
    ratio = double.ratio(points[..., i, j], corners @ weights).reshape(len(pair), -1)
    best = np.argpartition(-ratio, min(_KEPT, ratio.shape[1] - 1), axis=1)[:, :_KEPT]
    cell, which = np.divmod(best, len(samples))
    i, j = np.divmod(cell, len(lines[1]))
    offsets = np.array([sample.corners for sample in samples])[which]
    low = np.stack([lines[0][i], lines[1][j]], axis=-1)[:, :, None]
    triangle = (low + offsets) / np.array(cut)
    share = np.array([sample.share for sample in samples])[which]
    value = np.take_along_axis(ratio, best, axis=1)
    kept = best.shape[1]
    return Places(np.repeat(pair, kept), value.ravel(), triangle.reshape(-1, 3, 2), share.reshape(-1, 3))


def _worst_of_triangles(judged: Judged, pair: int, parameters: np.ndarray, lattice: np.ndarray) -> Places:
    """The largest samples of one pair."""
    shares = np.concatenate([np.eye(3), lattice])
    where = np.einsum("sk,tkc->cts", shares, parameters)
    double = judged.only(slice(pair, pair + 1)).astype(np.float64)
    points = double.at(where[0].reshape(1, -1), where[1].reshape(1, -1)).reshape(1, *where.shape[1:], -1)
    points = np.moveaxis(points, 3, 0)
    ratio = double.ratio(points[..., 3:], points[..., :3] @ lattice.T).ravel()
    best = np.argpartition(-ratio, min(_KEPT, len(ratio) - 1))[:_KEPT]
    which, place = np.divmod(best, len(lattice))
    return Places(np.full(len(best), pair), ratio[best], parameters[which], lattice[place])


def _closer(judged: Judged, places: Places) -> Found:
    """The largest ratio of each pair: every place is zoomed into, those near 1 in long double."""
    step = max(1, 2**21 // (len(_CLOSE) * judged.numbers))
    blocks = []
    for at in range(0, len(places.pair), step):
        block = places.only(np.arange(at, min(at + step, len(places.pair))))
        block = _zoomed(judged, block, np.float64, 0.5, _ZOOMS)
        near = block.ratio + judged.only(block.pair).noise(block) > NEAR
        fine = _zoomed(judged, block.only(near), np.longdouble, 0.1, _FINE_ZOOMS)
        block.ratio[near], block.share[near] = fine.ratio, fine.share
        blocks.append(block)
    whole = Places.joined(blocks)
    whole = whole.only(np.lexsort((whole.ratio, whole.pair)))
    last = np.flatnonzero(np.append(whole.pair[1:] != whole.pair[:-1], True)[: len(whole.pair)])
    count = judged.pairs
    found = Found(np.full(count, UNSEEN), np.zeros((count, 3, 2)), np.full((count, 3), 1 / 3))
    for all_pairs, best in zip(found, whole.only(last)[1:], strict=True):
        all_pairs[whole.pair[last]] = best
    return found


def _zoomed(judged: Judged, places: Places, dtype: Any, size: float, zooms: int) -> Places:
    """The largest samples of ever smaller triangles around each place."""
    if not len(places.pair):
        return places
    own = judged.only(places.pair).astype(dtype)
    triangle, share = places.triangle.astype(dtype), places.share.astype(dtype)
    ends = own.at(triangle[..., 0], triangle[..., 1])

    def sampled(trial: np.ndarray) -> np.ndarray:
        where = np.matmul(trial, triangle)
        points, drawn = own.at(where[..., 0], where[..., 1]), np.matmul(trial, ends)
        return own.ratio(np.moveaxis(points, 2, 0), np.moveaxis(drawn, 2, 0))

    ratio = sampled(share[:, None])[:, 0]
    for _ in range(zooms):
        trial = (1 - size) * share[:, None] + size * _CLOSE.astype(dtype)
        values = sampled(trial)
        best = np.argmax(values, axis=1)
        value = values[np.arange(len(best)), best]
        better = value > ratio
        share = np.where(better[:, None], trial[np.arange(len(best)), best], share)
        ratio = np.where(better, value, ratio)
        size *= 0.5
    return Places(places.pair, ratio.astype(np.float64), places.triangle, share.astype(np.float64))
