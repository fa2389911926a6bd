"""How far a drawn point lies from where it belongs, over the tolerance.

With a camera, evaluation and visibility of its own, in NumPy; what exceeds 1 in long double is decided with 60 digits
(``settled``).

A row of the screen is undivided and over its tolerance: X/W is the distance from the picture's centre in tolerances, so
that the *ratio* of an error to what is allowed is the largest |X/W - X_lin/W_lin|. The drawn point counts where it lies
in the view volume; an exact W <= 0 there is an infinite ratio.
"""

from __future__ import annotations

from math import comb
from typing import Any, NamedTuple

import numpy as np

from slefejax.experiments.attack.judge.digits import MP, exact, long
from slefejax.experiments.attack.judge.search import UNSEEN, Places, bernstein

_FINEST, _FINEST_PRODUCT = 24, 96  # samples along each side of a patch, at least; Gaussian products have narrow ridges
_TERMS = 64.0  # rounding errors of a ratio, in units of the last place of its terms
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
        along = np.matmul(bernstein(nu - 1, u), self.net.reshape(count, nu, nv * parts)).reshape(count, -1, nv, parts)
        found = np.sum(bernstein(nv - 1, v)[..., None] * along, axis=2)
        if self.lens.shape[1]:
            return _solved(found) @ np.swapaxes(self.lens, 1, 2)
        if self.twists.shape[1]:
            found += np.matmul(np.stack(_turning(self.twists.shape[1], u, v), axis=2), self.twists)
        return found

    def on_grid(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Rows ``(4, pairs, nu, nv)`` at all pairs of u ``(nu,)`` and v ``(nv,)``."""
        net = np.moveaxis(self.net, 3, 0)
        by_u, by_v = (bernstein(net.shape[2 + axis] - 1, t) for axis, t in enumerate((u, v)))
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
        surface, half = _seen(patches, look, (tolerance, depth_tolerance), long, np.tan)
        return Screen(surface, np.broadcast_to(half, (len(patches), 3)), 2 if depth_tolerance is None else 3)

    @staticmethod
    def joined(parts: list[Screen]) -> Screen:
        """The pairs of several views."""
        surface = Surface(*(np.concatenate(x) for x in zip(*(part.surface for part in parts), strict=True)))
        return Screen(surface, np.concatenate([part.half for part in parts]), parts[0].compared)

    @property
    def pairs(self) -> int:
        """How many there are."""
        return len(self.half)

    @property
    def finest(self) -> int:
        """Samples along each side of a patch, at least."""
        return _FINEST_PRODUCT if self.close else _FINEST

    @property
    def close(self) -> bool:
        """Whether short triangles are sampled closely too: Gaussian products."""
        return bool(self.surface.lens.shape[1])

    @property
    def numbers(self) -> int:
        """Control numbers of a pair."""
        return self.surface.net[0].size

    def only(self, chosen: Any) -> Screen:
        """Some of the pairs."""
        return Screen(self.surface.only(chosen), self.half[chosen], self.compared)

    def astype(self, dtype: Any) -> Screen:
        """In another precision."""
        return Screen(self.surface.astype(dtype), self.half.astype(dtype), self.compared)

    def at(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Rows ``(pairs, places, 4)`` at u and v ``(pairs, places)``."""
        return self.surface.at(u, v)

    def on_grid(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Rows ``(4, pairs, nu, nv)`` at all pairs of u ``(nu,)`` and v ``(nv,)``."""
        return self.surface.on_grid(u, v)

    def ratio(self, true: np.ndarray, drawn: np.ndarray) -> np.ndarray:
        """The ratio of samples ``(pairs, ...)``, of rows ``(4, pairs, ...)``."""
        seen, ahead = self.seen(drawn), true[3] > 0
        w, true_w = np.where(seen, drawn[3], 1), np.where(ahead, true[3], 1)
        worst = np.zeros(w.shape, w.dtype)
        with np.errstate(over="ignore", invalid="ignore"):
            for one, row in zip(true[: self.compared], drawn, strict=False):
                worst = np.fmax(worst, np.abs(one / true_w - row / w))
        return np.where(seen, np.where(ahead, worst, np.inf), UNSEEN)

    def seen(self, drawn: np.ndarray) -> np.ndarray:
        """Whether drawn points ``(4, pairs, ...)`` lie in the view volume."""
        w, half = drawn[3], self.half.T.reshape(3, -1, *[1] * (drawn.ndim - 2))
        found = w > 0
        for row, extent in zip(drawn, half, strict=False):
            found = found & (np.abs(row) <= extent * w)
        return found

    def noise(self, places: Places) -> np.ndarray:
        """What rounding in double precision may make of the ratio at these places, one of every pair."""
        own = self.astype(np.float64)
        corners = np.moveaxis(places.triangle, 2, 0)
        sizes = own.surface.sizes(*corners)
        terms = np.max(sizes[:, : self.compared] + own.half[:, : self.compared] * sizes[:, 3:], axis=1)
        w = np.maximum(np.sum(places.share * own.at(*corners)[..., 3], axis=1), 1e-300)
        return _TERMS * float(np.finfo(np.float64).eps) * terms / w


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


def _camera(look: Look, number: Any, tan: Any) -> tuple[np.ndarray, np.ndarray]:
    """(matrix, half): from points relative to the eye to rows in pixels, window depth and W; half the picture.

    number, tan : what makes numbers of the precision that is wanted, and their tangent
    """
    digits = number is exact
    eye, target, up = number(look.eye), number(look.target), number(look.up)
    near, far, extent, width, height = number([look.near, look.far, look.extent, look.width, look.height])
    zero, one = number([0, 1])
    pi = MP.mpf(_PI) if digits else np.longdouble(_PI)
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
    return vector / (MP.sqrt(square) if vector.dtype == object else np.sqrt(square))


def _seen(
    patches: Any, look: Look, tolerances: tuple[float, float | None], number: Any, tan: Any
) -> tuple[Surface, np.ndarray]:
    """The rows of patches, and half the picture over the tolerances, in the precision that ``number`` makes."""
    matrix, half = _camera(look, number, tan)
    pixels, depth = tolerances
    scale, eye = number([pixels, pixels, 1.0 if depth is None else depth]), number(look.eye)
    matrix[:3] = matrix[:3] / scale[:, None]
    none = number(np.zeros((len(patches), 0, 4)))
    if hasattr(patches, "gaussians"):
        size, place = number(patches.scale)[:, None, None], number(patches.offset) - eye
        lens = np.concatenate([matrix[:, :3] * size, (place @ matrix[:, :3].T + matrix[:, 3])[..., None]], axis=2)
        return Surface(number(patches.gaussians), none, lens), half / scale
    points, twists = parts_of(patches)
    net = number(points)
    weight = net[..., 3:] if net.shape[3] == 4 else number(np.ones((*net.shape[:3], 1)))
    rows = np.concatenate([net[..., :3] - weight * eye, weight], axis=3) @ matrix.T
    return Surface(rows, number(twists) @ matrix[:, :3].T, none), half / scale


def parts_of(patches: Any) -> tuple[np.ndarray, np.ndarray]:
    """Control points, and twists, of which only Gregory patches have any."""
    net = np.asarray(getattr(patches, "net", patches))
    return net, np.asarray(getattr(patches, "twists", np.zeros((len(net), 0, 3))))


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


def _with_all_digits(
    patch: Any,
    look: Look,
    tolerances: tuple[float, float | None],
    triangle: np.ndarray,
    share: np.ndarray,
    inwards: float,
) -> float:
    surface, half = _seen(patch, look, tolerances, exact, MP.tan)
    parts = exact(np.maximum((1 - inwards) * share + inwards / 3, 0.0))
    parts = parts / sum(parts)
    corners = [_point(surface, *exact(corner)) for corner in triangle]
    drawn = parts @ np.stack(corners)
    true = _point(surface, *(parts @ exact(triangle)))
    if not drawn[3] > 0 or any(abs(drawn[k]) > half[k] * drawn[3] for k in range(3)):
        return UNSEEN
    if not true[3] > 0:
        return float("inf")
    compared = 2 if tolerances[1] is None else 3
    return float(max(abs(true[k] / true[3] - drawn[k] / drawn[3]) for k in range(compared)))


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
