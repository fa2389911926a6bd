"""The judge of ``slefejax attack``: how far a drawn point lies from where it belongs, over the tolerance.

It shares nothing with the prediction, nor with what the package measures by: its own camera, evaluation and visibility,
in NumPy. Samples are compared in double precision; places whose ratio comes near 1, or that double precision cannot
tell, are looked at again in long double; what still exceeds 1 is decided with 60 digits (``settled``).

A row of the screen is undivided and over its tolerance: X/W is the distance from the picture's centre in tolerances, so
that the *ratio* of an error to what is allowed is the largest |X/W - X_lin/W_lin|. The drawn point counts where it lies
in the view volume; an exact W <= 0 there is an infinite ratio.
"""

from __future__ import annotations

from functools import cache
from itertools import product
from math import comb
from typing import Any, NamedTuple

import mpmath
import numpy as np

ALLOWANCE = 4e-9  # a ratio of at most 1 + this is not held against anyone
NEAR = 0.9  # ratios from which on double precision is not enough
_UNSEEN = -1.0
_FINEST, _FINEST_PRODUCT = 24, 96  # samples along each side of a patch, at least; Gaussian products have narrow ridges
_MOST_LINES = 96  # cells along u and v that are looked at; of finer grids so many are drawn by lot
_BLOCK = 2**17  # samples at once
_KEPT = 3  # places of a pair that are looked at more closely
_ZOOMS, _FINE_ZOOMS = 5, 12
_TERMS = 64.0  # rounding errors of a ratio, in units of the last place of its terms
_LONG_TRIANGLE = 1 / 6  # of the domain; sampled more densely
_MP: Any = mpmath.MPContext()  # its own, so that nobody else's digits change
_MP.dps = 60
_PI = "3.14159265358979323846264338327950288419716939937510582097494459"


class Look(NamedTuple):
    """A camera and its picture, as plain numbers; what they mean is OpenGL's (``geometry.view`` says it too)."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    up: tuple[float, float, float]
    extent: float  # vertical field of view in degrees, or the picture's height in scene units
    near: float
    far: float
    perspective: bool
    width: int
    height: int


class Surface(NamedTuple):
    """Rows X, Y, Z over their tolerances, from the picture's centre and half the depth, and W, of some patches.

    net    : ``(pairs, du+1, dv+1, 4)``; of Gaussian products 9, the entries 11, 12, 13, 22, 23, 33 of Q, then h
    twists : ``(pairs, slots, 4)``, of Gregory patches; no slots of others
    lens   : ``(pairs, 4, 4)``, of Gaussian products: from det Q times (Q^-1 h, 1) to rows; ``(pairs, 0, 4)`` of others
    """

    net: np.ndarray
    twists: np.ndarray
    lens: np.ndarray

    def only(self, chosen: Any) -> Surface:
        """Some of them."""
        return Surface(*(x[chosen] for x in self))

    def astype(self, dtype: Any) -> Surface:
        """In another precision."""
        return Surface(*(x.astype(dtype) for x in self))

    def at(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Rows ``(pairs, places, 4)`` at u and v ``(pairs, places)``."""
        count, nu, nv, parts = self.net.shape
        along = np.matmul(_bernstein(nu - 1, u), self.net.reshape(count, nu, nv * parts)).reshape(count, -1, nv, parts)
        found = np.sum(_bernstein(nv - 1, v)[..., None] * along, axis=2)
        if self.lens.shape[1]:
            return _solved(found) @ np.swapaxes(self.lens, 1, 2)
        if self.twists.shape[1]:
            found += np.matmul(np.stack(_turning(self.twists.shape[1], u, v), axis=2), self.twists)
        return found

    def on_grid(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Rows ``(4, pairs, nu, nv)`` at all pairs of u ``(nu,)`` and v ``(nv,)``."""
        net = np.moveaxis(self.net, 3, 0)
        by_u, by_v = (_bernstein(net.shape[2 + axis] - 1, t) for axis, t in enumerate((u, v)))
        points = np.matmul(np.matmul(by_u, net), by_v.T)
        if self.lens.shape[1]:
            return np.moveaxis(_solved(np.moveaxis(points, 0, -1)) @ np.swapaxes(self.lens, 1, 2)[:, None], -1, 0)
        if self.twists.shape[1]:
            terms = np.stack(_turning(self.twists.shape[1], u[:, None], v[None]))
            points = points + np.einsum("skl,psr->rpkl", terms, self.twists)
        return points

    def sizes(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """What the terms of rows add up to at most, ``(pairs, 4)``, at places ``(pairs, places)``."""
        if not self.lens.shape[1]:
            return np.abs(self.net).max(axis=(1, 2), initial=0) + np.abs(self.twists).sum(axis=1)
        q = self._replace(lens=self.lens[:, :0]).at(u, v)
        found = np.abs(_solved(q)) * _condition(q)[..., None]
        return np.max(found @ np.swapaxes(np.abs(self.lens), 1, 2), axis=1)


class Screen(NamedTuple):
    """Patches as seen, one a pair of patch and view.

    surface  : their rows, in long double
    half     : ``(pairs, 3)`` long double: the picture's half width, half height and half depth over the tolerances
    compared : 2, or 3 where depth is held to a tolerance too
    """

    surface: Surface
    half: np.ndarray
    compared: int

    @staticmethod
    def of(patches: Any, look: Look, tolerance: float, depth_tolerance: float | None = None) -> Screen:
        """Of patches ``(patches, du+1, dv+1, 3)``, or 4 at the end if rational, ``GregoryPatches``, or
        ``ProductNets``, each number taken as exact."""
        surface, half = _seen(patches, look, (tolerance, depth_tolerance), _long, np.tan)
        return Screen(surface, np.broadcast_to(half, (len(patches), 3)), 2 if depth_tolerance is None else 3)

    @staticmethod
    def joined(parts: list[Screen]) -> Screen:
        """The pairs of several views."""
        surface = Surface(*(np.concatenate(x) for x in zip(*(part.surface for part in parts), strict=True)))
        return Screen(surface, np.concatenate([part.half for part in parts]), parts[0].compared)

    def only(self, chosen: Any) -> Screen:
        """Some of the pairs."""
        return Screen(self.surface.only(chosen), self.half[chosen], self.compared)


class Found(NamedTuple):
    """The largest ratio of every pair, and where: -1 where nothing is seen.

    triangle : ``(pairs, 3, 2)``, parameters of the corners of the domain triangle
    share    : ``(pairs, 3)``, barycentric coordinates in it
    """

    ratio: np.ndarray
    triangle: np.ndarray
    share: np.ndarray


def judge_uniform(screen: Screen, cuts: np.ndarray, seed: int = 0) -> Found:
    """Pairs cut into ``cuts`` = ``(pairs, 2)`` equal cells along u and v, the worse diagonal of each cell.

    Of grids with more than 96 cells a side so many rows and columns are looked at, drawn by the seed.
    """
    places = []
    rng = np.random.default_rng(seed)
    finest = _FINEST_PRODUCT if screen.surface.lens.shape[1] else _FINEST
    for cut in np.unique(cuts, axis=0):
        own = np.flatnonzero(np.all(cuts == cut, axis=1))
        lines = [_lines(int(n), rng) for n in cut]
        order = 2 * int(np.ceil(finest / (2 * min(finest / 2, cut.min()))))
        step = max(1, _BLOCK // (len(lines[0]) * len(lines[1]) * len(_samples(order))))
        for at in range(0, len(own), step):
            block = own[at : at + step]
            places.append(_worst_of_cells(screen.only(block), block, (int(cut[0]), int(cut[1])), lines, order))
    return _closer(screen, _Places.joined(places))


def judge_triangles(screen: Screen, pair: np.ndarray, parameters: np.ndarray) -> Found:
    """Given domain triangles ``(triangles, 3, 2)`` of the pairs ``(triangles,)``."""
    places = []
    long = np.ptp(parameters, axis=1).max(axis=1, initial=0.0) > _LONG_TRIANGLE
    order = np.argsort(pair, kind="stable")
    starts = np.searchsorted(pair[order], np.arange(len(screen.half) + 1))
    short = _CLOSE if screen.surface.lens.shape[1] else _COARSE
    for k in range(len(screen.half)):
        own = order[starts[k] : starts[k + 1]]
        for lattice, chosen in ((_shares(12), own[long[own]]), (short, own[~long[own]])):
            for at in range(0, len(chosen), max(1, _BLOCK // len(lattice))):
                block = chosen[at : at + max(1, _BLOCK // len(lattice))]
                places.append(_worst_of_triangles(screen, k, parameters[block], lattice))
    return _closer(screen, _Places.joined(places))


def settled(
    patch: Any,
    look: Look,
    tolerances: tuple[float, float | None],
    triangle: np.ndarray,
    share: np.ndarray,
) -> float:
    """The ratio at a place of one triangle with 60 digits, or a hair further inside of it where it is not seen.

    patch : the one, as ``Screen.of`` takes it
    """
    return max(
        _with_all_digits(patch, look, tolerances, triangle, share, inwards) for inwards in (0.0, 1e-15, 1e-12, 1e-9)
    )


def _long(values: Any) -> np.ndarray:
    return np.asarray(values).astype(np.longdouble)


def _exact(values: Any) -> np.ndarray:
    array = np.asarray(values)
    return np.array([_MP.mpf(float(x)) for x in array.ravel()], object).reshape(array.shape)


def _camera(look: Look, exact: Any, tan: Any) -> tuple[np.ndarray, np.ndarray]:
    """(matrix, half): from points relative to the eye to rows in pixels, window depth and W; half the picture.

    exact, tan : what makes numbers of the precision that is wanted, and their tangent
    """
    digits = exact is _exact
    eye, target, up = exact(look.eye), exact(look.target), exact(look.up)
    near, far, extent, width, height = exact([look.near, look.far, look.extent, look.width, look.height])
    zero, one = exact([0, 1])
    pi = _MP.mpf(_PI) if digits else np.longdouble(_PI)
    forward = _unit(target - eye)
    right = _unit(np.cross(forward, up))
    rotation = np.stack([right, np.cross(right, forward), -forward])
    if look.perspective:
        pixels = height / 2 / tan(extent * pi / 360)
        depth, last = [(far + near) / (near - far) / 2, far * near / (near - far)], [zero, zero, -one, zero]
    else:
        pixels = height / extent
        depth, last = [one / (near - far), (far + near) / (near - far) / 2], [zero, zero, zero, one]
    lens = np.array([[pixels, zero, zero, zero], [zero, pixels, zero, zero], [zero, zero, *depth], last])
    motion = np.vstack([np.column_stack([rotation, [zero] * 3]), [[zero, zero, zero, one]]])
    return lens @ motion, np.array([width / 2, height / 2, one / 2])


def _unit(vector: np.ndarray) -> np.ndarray:
    square = vector @ vector
    return vector / (_MP.sqrt(square) if vector.dtype == object else np.sqrt(square))


class _Places(NamedTuple):
    """Samples with large ratios: of which pair, where."""

    pair: np.ndarray
    ratio: np.ndarray
    triangle: np.ndarray
    share: np.ndarray

    @staticmethod
    def joined(parts: list[_Places]) -> _Places:
        """All of them that are seen."""
        none = _Places(np.zeros(0, int), np.zeros(0), np.zeros((0, 3, 2)), np.zeros((0, 3)))
        whole = _Places(*(np.concatenate(x) for x in zip(none, *parts, strict=True)))
        return whole.only(whole.ratio >= 0)

    def only(self, chosen: np.ndarray) -> _Places:
        """Some of them."""
        return _Places(*(x[chosen] for x in self))


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


def _bernstein(degree: int, t: np.ndarray) -> np.ndarray:
    """b_0 ... b_degree along a new last axis."""
    t = t[..., None]
    k = np.arange(degree + 1)
    return np.array([comb(degree, int(j)) for j in k]).astype(t.dtype) * t**k * (1 - t) ** (degree - k)


def _seen(
    patches: Any, look: Look, tolerances: tuple[float, float | None], exact: Any, tan: Any
) -> tuple[Surface, np.ndarray]:
    """The rows of patches, and half the picture over the tolerances, in the precision that ``exact`` makes."""
    matrix, half = _camera(look, exact, tan)
    pixels, depth = tolerances
    scale, eye = exact([pixels, pixels, 1.0 if depth is None else depth]), exact(look.eye)
    matrix[:3] = matrix[:3] / scale[:, None]
    none = exact(np.zeros((len(patches), 0, 4)))
    if hasattr(patches, "gaussians"):
        size, place = exact(patches.scale)[:, None, None], exact(patches.offset) - eye
        lens = np.concatenate([matrix[:, :3] * size, (place @ matrix[:, :3].T + matrix[:, 3])[..., None]], axis=2)
        return Surface(exact(patches.gaussians), none, lens), half / scale
    points, twists = parts_of(patches)
    net = exact(points)
    weight = net[..., 3:] if net.shape[3] == 4 else exact(np.ones((*net.shape[:3], 1)))
    rows = np.concatenate([net[..., :3] - weight * eye, weight], axis=3) @ matrix.T
    return Surface(rows, exact(twists) @ matrix[:, :3].T, none), half / scale


def parts_of(patches: Any) -> tuple[np.ndarray, np.ndarray]:
    """Control points, and twists, of which only Gregory patches have any."""
    if hasattr(patches, "twists"):
        return np.asarray(patches.net), np.asarray(patches.twists)
    return patches, np.zeros((len(patches), 0, 3))


def _solved(q: np.ndarray) -> np.ndarray:
    """det Q times (Q^-1 h, 1) of ``(..., 9)``: Q = L D L^T, whose pivots are positive."""
    a, b, c, d, e, f, x, y, z = np.moveaxis(q, -1, 0)
    l21, l31 = b / a, c / a
    second, under = d - l21 * b, e - l21 * c
    l32 = under / second
    third = f - l31 * c - l32 * under
    y = y - l21 * x
    z = (z - l31 * x - l32 * y) / third
    y = y / second - l32 * z
    x = x / a - l21 * y - l31 * z
    w = a * second * third
    return np.stack([w * x, w * y, w * z, w], axis=-1)


def _condition(q: np.ndarray) -> np.ndarray:
    """At least the condition number of Q, ``(...)``, and at most nine times it: trace Q times that of its inverse."""
    a, b, c, d, e, f = np.moveaxis(q[..., :6], -1, 0)
    minors = (a * d - b * b) + (a * f - c * c) + (d * f - e * e)
    return (a + d + f) * np.abs(minors) / _solved(q)[..., 3]


def _turning(slots: int, u: Any, v: Any) -> list[Any]:
    """What half of f+ - f- of every corner adds to the patch: (s f+ + t f-)/(s + t) less the mean, times its weight."""

    def part(s: Any, t: Any) -> Any:
        whole = s + t
        return s / np.where(whole == 0, 1, whole) - t / np.where(whole == 0, 1, whole)

    a, b = 1 - u, 1 - v
    weight = [9 * (x * y) * (1 - x) ** 2 * (1 - y) ** 2 / 2 for x, y in ((u, v), (a, v), (a, b), (u, b))]
    found = [w * part(*own) for w, own in zip(weight, ((u, v), (v, a), (a, b), (b, u)), strict=True)]
    if slots > len(found):
        # of the triangle's shares at (0, 0), (0, 1) and the third corner
        p, q = a * b, a * v
        found += [6 * p * p * q * u * part(u, q), 6 * q * q * p * u * part(p, u)]
    return found


def _ratio(exact: Any, drawn: Any, half: Any, compared: int) -> np.ndarray:
    """The ratio of samples; both are four rows, half is three."""
    w = drawn[3]
    seen = w > 0
    for row, extent in zip(drawn, half, strict=False):
        seen = seen & (np.abs(row) <= extent * w)
    ahead = exact[3] > 0
    w, true_w = np.where(seen, w, 1), np.where(ahead, exact[3], 1)
    worst = np.zeros(w.shape, w.dtype)
    with np.errstate(over="ignore", invalid="ignore"):
        for true, row in zip(exact[:compared], drawn, strict=False):
            worst = np.fmax(worst, np.abs(true / true_w - row / w))
    return np.where(seen, np.where(ahead, worst, np.inf), _UNSEEN)


def _worst_of_cells(
    screen: Screen, pair: np.ndarray, cut: tuple[int, int], lines: list[np.ndarray], order: int
) -> _Places:
    """The largest samples of each pair on some rows and columns of cells."""
    samples = _samples(order)
    steps = np.arange(order + 1) / order
    places = [((line[:, None] + steps) / n).ravel() for line, n in zip(lines, cut, strict=True)]
    points = screen.surface.astype(np.float64).on_grid(*places)
    points = points.reshape(4, len(pair), len(lines[0]), order + 1, len(lines[1]), order + 1).swapaxes(3, 4)
    corners = points[..., ::order, ::order].reshape(*points.shape[:4], 4)
    weights = np.zeros((4, len(samples)))
    for k, sample in enumerate(samples):
        for (a, b), share in zip(sample.corners, sample.share, strict=True):
            weights[2 * a + b, k] += share
    i, j = np.array([sample.at for sample in samples]).T
    half = screen.half.astype(np.float64).T[:, :, None, None, None]
    ratio = _ratio(points[..., i, j], corners @ weights, half, screen.compared).reshape(len(pair), -1)
    best = np.argpartition(-ratio, min(_KEPT, ratio.shape[1] - 1), axis=1)[:, :_KEPT]
    cell, which = np.divmod(best, len(samples))
    i, j = np.divmod(cell, len(lines[1]))
    offsets = np.array([sample.corners for sample in samples])[which]
    low = np.stack([lines[0][i], lines[1][j]], axis=-1)[:, :, None]
    triangle = (low + offsets) / np.array(cut)
    share = np.array([sample.share for sample in samples])[which]
    value = np.take_along_axis(ratio, best, axis=1)
    kept = best.shape[1]
    return _Places(np.repeat(pair, kept), value.ravel(), triangle.reshape(-1, 3, 2), share.reshape(-1, 3))


def _worst_of_triangles(screen: Screen, pair: int, parameters: np.ndarray, lattice: np.ndarray) -> _Places:
    """The largest samples of one pair."""
    shares = np.concatenate([np.eye(3), lattice])
    where = np.einsum("sk,tkc->cts", shares, parameters)
    surface = screen.surface.only(slice(pair, pair + 1)).astype(np.float64)
    points = surface.at(where[0].reshape(1, -1), where[1].reshape(1, -1)).reshape(*where.shape[1:], 4)
    points = np.moveaxis(points, 2, 0)
    half = screen.half[pair].astype(np.float64)
    ratio = _ratio(points[..., 3:], points[..., :3] @ lattice.T, half, screen.compared).ravel()
    best = np.argpartition(-ratio, min(_KEPT, len(ratio) - 1))[:_KEPT]
    which, place = np.divmod(best, len(lattice))
    return _Places(np.full(len(best), pair), ratio[best], parameters[which], lattice[place])


def _closer(screen: Screen, places: _Places) -> Found:
    """The largest ratio of each pair: every place is zoomed into, those near 1 in long double."""
    step = max(1, 2**21 // (len(_CLOSE) * screen.surface.net[0].size))
    blocks = []
    for at in range(0, len(places.pair), step):
        block = places.only(np.arange(at, min(at + step, len(places.pair))))
        block = _zoomed(screen, block, np.float64, 0.5, _ZOOMS)
        near = block.ratio + _noise(screen, block) > NEAR
        fine = _zoomed(screen, block.only(near), np.longdouble, 0.1, _FINE_ZOOMS)
        block.ratio[near], block.share[near] = fine.ratio, fine.share
        blocks.append(block)
    whole = _Places.joined(blocks)
    whole = whole.only(np.lexsort((whole.ratio, whole.pair)))
    last = np.flatnonzero(np.append(whole.pair[1:] != whole.pair[:-1], True)[: len(whole.pair)])
    count = len(screen.half)
    found = Found(np.full(count, _UNSEEN), np.zeros((count, 3, 2)), np.full((count, 3), 1 / 3))
    for all_pairs, best in zip(found, whole.only(last)[1:], strict=True):
        all_pairs[whole.pair[last]] = best
    return found


def _zoomed(screen: Screen, places: _Places, dtype: Any, size: float, zooms: int) -> _Places:
    """The largest samples of ever smaller triangles around each place."""
    if not len(places.pair):
        return places
    surface, half = screen.surface.only(places.pair).astype(dtype), screen.half[places.pair].astype(dtype).T[..., None]
    triangle, share = places.triangle.astype(dtype), places.share.astype(dtype)
    ends = surface.at(triangle[..., 0], triangle[..., 1])

    def sampled(trial: np.ndarray) -> np.ndarray:
        where = np.matmul(trial, triangle)
        points, drawn = surface.at(where[..., 0], where[..., 1]), np.matmul(trial, ends)
        return _ratio(np.moveaxis(points, 2, 0), np.moveaxis(drawn, 2, 0), half, screen.compared)

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
    return _Places(places.pair, ratio.astype(np.float64), places.triangle, share.astype(np.float64))


def _noise(screen: Screen, places: _Places) -> np.ndarray:
    """What rounding in double precision may make of the ratio at these places."""
    half = screen.half[places.pair, : screen.compared].astype(np.float64)
    surface = screen.surface.only(places.pair).astype(np.float64)
    corners = np.moveaxis(places.triangle, 2, 0)
    sizes = surface.sizes(*corners)
    terms = np.max(sizes[:, : screen.compared] + half * sizes[:, 3:], axis=1)
    w = np.maximum(np.sum(places.share * surface.at(*corners)[..., 3], axis=1), 1e-300)
    return _TERMS * float(np.finfo(np.float64).eps) * terms / w


def _with_all_digits(
    patch: Any,
    look: Look,
    tolerances: tuple[float, float | None],
    triangle: np.ndarray,
    share: np.ndarray,
    inwards: float,
) -> float:
    surface, half = _seen(patch, look, tolerances, _exact, _MP.tan)
    parts = _exact(np.maximum((1 - inwards) * share + inwards / 3, 0.0))
    parts = parts / sum(parts)
    corners = [_point(surface, *_exact(corner)) for corner in triangle]
    drawn = parts @ np.stack(corners)
    exact = _point(surface, *(parts @ _exact(triangle)))
    if not drawn[3] > 0 or any(abs(drawn[k]) > half[k] * drawn[3] for k in range(3)):
        return _UNSEEN
    if not exact[3] > 0:
        return float("inf")
    compared = 2 if tolerances[1] is None else 3
    return float(max(abs(exact[k] / exact[3] - drawn[k] / drawn[3]) for k in range(compared)))


def _point(surface: Surface, u: Any, v: Any) -> np.ndarray:
    net, twists, lens = (x[0] for x in surface)
    by_u, by_v = (
        np.array([comb(d, j) * t**j * (1 - t) ** (d - j) for j in range(d + 1)], object)
        for d, t in ((net.shape[0] - 1, u), (net.shape[1] - 1, v))
    )
    found = np.tensordot(by_v, np.tensordot(by_u, net, (0, 0)), (0, 0))
    if len(lens):
        return lens @ _solved(found)
    if not len(twists):
        return found
    terms = [x.item() if isinstance(x, np.ndarray) else x for x in _turning(len(twists), u, v)]
    return found + np.array(terms, object) @ twists
