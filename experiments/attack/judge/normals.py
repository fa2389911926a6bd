"""How far an interpolated normal is turned from the exact one, over the tolerance.

Normals are undivided ones, P_u x P_v, of rational patches w^3 times that, over the distance in the domain from every
side that is a point: a polynomial, whose Bernstein coefficients are made here by convolution of scaled ones. What is
drawn interpolates it between vertices. Of patches that are shaded with tangent patches it is the product of these, over
the distance from sides along which there are none. Levels, and factors that are verified, keep normals where points
are seen. What exceeds 1 in long double is decided with 60 digits (``settled``).
"""

from __future__ import annotations

from math import comb
from typing import Any, NamedTuple

import numpy as np

from slefejax.experiments.attack.judge.digits import MP, exact, long
from slefejax.experiments.attack.judge.screen import Look, Screen, parts_of
from slefejax.experiments.attack.judge.search import UNSEEN, Places, bernstein
from slefejax.experiments.attack.judge.spin import Spin, cross, slopes

_FINEST = 24  # samples along each side of a patch, at least
_TERMS = 64.0  # rounding errors of a normal, in units of the last place of the largest one
# a side is a point if it is no longer than so many eps of its coordinates, and than such a part of the patch
_ROUNDED, _NOTHING, _NOTHING_ROUNDED = 64, 1e-9, 4


class Normals(NamedTuple):
    """Normals of patches that are seen and have a claim, and of others, which do not count.

    Values are the rows of the screen, and normals.

    screen  : the patches as seen
    net     : ``(pairs, ku+1, kv+1, 3)``, in long double
    degrees : ``(pairs,)``, the tolerances
    claimed : ``(pairs,)``
    hidden  : whether normals count where the drawn point is not seen, too
    spin    : of Gregory patches, what twists add
    """

    screen: Screen
    net: np.ndarray
    degrees: np.ndarray
    claimed: np.ndarray
    hidden: bool
    spin: Spin | None

    @staticmethod
    def of(patches: Any, look: Look, degrees: float, claimed: np.ndarray, *, hidden: bool) -> Normals:
        """Of patches ``(patches, du+1, dv+1, 3)``, or 4 at the end if rational, ``GregoryPatches``, or ``Shaded``.

        Each number is taken as exact.
        """
        nets, spin = normal_nets(patches, long)
        tolerances = np.full(len(patches), np.longdouble(degrees))
        return Normals(Screen.of(patches, look, 1.0), nets, tolerances, claimed, hidden, spin)

    @staticmethod
    def joined(parts: list[Normals]) -> Normals:
        """The pairs of several views."""
        arrays = zip(*((part.net, part.degrees, part.claimed) for part in parts), strict=True)
        net, degrees, claimed = (np.concatenate(x) for x in arrays)
        spins = [part.spin for part in parts if part.spin is not None]
        spin = Spin(*(np.concatenate(x) for x in zip(*spins, strict=True))) if spins else None
        return Normals(Screen.joined([part.screen for part in parts]), net, degrees, claimed, parts[0].hidden, spin)

    @property
    def pairs(self) -> int:
        """How many there are."""
        return len(self.net)

    @property
    def finest(self) -> int:
        """Samples along each side of a patch, at least."""
        return _FINEST

    @property
    def close(self) -> bool:
        """Normals turn within short triangles beside cusps."""
        return True

    @property
    def numbers(self) -> int:
        """Control numbers of a pair."""
        return self.screen.numbers + self.net[0].size

    def only(self, chosen: Any) -> Normals:
        """Some of the pairs."""
        net, degrees, claimed = (x[chosen] for x in (self.net, self.degrees, self.claimed))
        spin = None if self.spin is None else Spin(*(x[chosen] for x in self.spin))
        return Normals(self.screen.only(chosen), net, degrees, claimed, self.hidden, spin)

    def astype(self, dtype: Any) -> Normals:
        """In another precision."""
        numbers = self.net.astype(dtype), self.degrees.astype(dtype)
        spin = None if self.spin is None else Spin(*(x.astype(dtype) for x in self.spin))
        return Normals(self.screen.astype(dtype), *numbers, self.claimed, self.hidden, spin)

    def at(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Rows and normals ``(pairs, places, 7)`` at u and v ``(pairs, places)``."""
        count, nu, nv, _ = self.net.shape
        along = np.matmul(bernstein(nu - 1, u), self.net.reshape(count, nu, nv * 3)).reshape(count, -1, nv, 3)
        normals = np.sum(bernstein(nv - 1, v)[..., None] * along, axis=2)
        if self.spin is not None:
            normals = normals + self.spin.at(u, v)
        return np.concatenate([self.screen.at(u, v), normals], axis=2)

    def on_grid(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """Rows and normals ``(7, pairs, nu, nv)`` at all pairs of u ``(nu,)`` and v ``(nv,)``."""
        net = np.moveaxis(self.net, 3, 0)
        normals = np.matmul(np.matmul(bernstein(net.shape[2] - 1, u), net), bernstein(net.shape[3] - 1, v).T)
        if self.spin is not None:
            every = (np.tile(x.ravel(), (self.pairs, 1)) for x in np.meshgrid(u, v, indexing="ij"))
            normals = normals + np.moveaxis(self.spin.at(*every), 2, 0).reshape(normals.shape)
        return np.concatenate([self.screen.on_grid(u, v), normals])

    def ratio(self, true: np.ndarray, drawn: np.ndarray) -> np.ndarray:
        """The ratio of samples ``(pairs, ...)``, of values ``(7, pairs, ...)``; what is 0 is as wrong as can be."""
        counted = self.claimed.reshape(-1, *[1] * (true.ndim - 2)) & (self.hidden | self.screen.seen(drawn[:4]))
        true, drawn = true[4:], drawn[4:]
        sine = np.sqrt(np.sum(cross(true, drawn, 0) ** 2, axis=0))
        cosine = np.sum(true * drawn, axis=0)
        none = np.all(true == 0, axis=0) | np.all(drawn == 0, axis=0)
        turned = np.where(none, 180, np.rad2deg(np.arctan2(sine, cosine)))
        return np.where(counted, turned / self.degrees.reshape(-1, *[1] * (turned.ndim - 1)), UNSEEN)

    def noise(self, places: Places) -> np.ndarray:
        """What rounding in double precision may make of the ratio at these places, one of every pair."""
        own = self.astype(np.float64)
        corners = own.at(*np.moveaxis(places.triangle, 2, 0))[..., 4:]
        drawn = np.sum(places.share[..., None] * corners, axis=1)
        where = np.sum(places.share[..., None] * places.triangle, axis=1)
        true = own.at(where[:, :1], where[:, 1:])[:, 0, 4:]
        least = np.minimum(*(np.sqrt(np.sum(x * x, axis=1)) for x in (true, drawn)))
        largest = np.abs(own.net).max(axis=(1, 2, 3))
        terms = _TERMS * float(np.finfo(np.float64).eps) * largest / np.maximum(least, 1e-300)
        return np.rad2deg(terms) / own.degrees


def settled(patch: np.ndarray, degrees: float, triangle: np.ndarray, share: np.ndarray) -> float:
    """The ratio at a place of one triangle with 60 digits.

    patch : ``(1, du+1, dv+1, 3 or 4)``, the one
    """
    net, spin = normal_nets(patch, exact)
    parts = exact(np.maximum(share, 0.0))
    parts = parts / sum(parts)
    corners = exact(triangle)
    true, *ends = (_spun(net[0], spin, u, v) for u, v in [parts @ corners, *corners])
    drawn = parts @ np.stack(ends)
    sine, cosine = MP.sqrt(sum(cross(true, drawn, 0) ** 2)), true @ drawn
    if not any(true) or not any(drawn):
        return 180.0 / degrees
    return float(MP.degrees(MP.atan2(sine, cosine)) / MP.mpf(degrees))


def _spun(net: np.ndarray, spin: Spin | None, u: Any, v: Any) -> np.ndarray:
    normal = _point(net, u, v)
    if spin is None:
        return normal
    a, b = _point(spin.along_u[0], u, v), _point(spin.along_v[0], u, v)
    by_u, by_v = (np.array(own, object) @ spin.twists[0] for own in slopes(len(spin.twists[0]), u, v))
    return normal + (cross(by_u, b) + cross(a + by_u, by_v)) * spin.scale[0]


def _point(net: np.ndarray, u: Any, v: Any) -> np.ndarray:
    by_u, by_v = (
        np.array([comb(n - 1, j) * t**j * (1 - t) ** (n - 1 - j) for j in range(n)], object)
        for n, t in zip(net.shape[:2], (u, v), strict=True)
    )
    return np.tensordot(by_v, np.tensordot(by_u, net, (0, 0)), (0, 0))


def point_sides(patches: np.ndarray) -> np.ndarray:
    """Which sides u=0, v=0, u=1, v=1 are points, ``(patches, 4)``."""
    points = patches[..., :3] / patches[..., 3:] if patches.shape[3] == 4 else patches
    eps = float(np.finfo(patches.dtype).eps)
    size = np.ptp(points.reshape(len(points), -1, 3), axis=1).max(axis=1)
    nothing = max(_NOTHING, _NOTHING_ROUNDED * eps) * size
    found = []
    for side in (points[:, 0], points[:, :, 0], points[:, -1], points[:, :, -1]):
        length = np.ptp(side, axis=1).max(axis=1)
        found.append((length <= _ROUNDED * eps * np.abs(side).max(axis=(1, 2))) & (length <= nothing))
    return np.stack(found, axis=1)


def normal_nets(patches: Any, number: Any) -> tuple[np.ndarray, Spin | None]:
    """Coefficients ``(patches, ku+1, kv+1, 3)`` of normals, the largest 1, in the precision that ``number`` makes.

    And what twists of Gregory patches add.
    """
    if hasattr(patches, "along_u"):
        return _of_tangents(patches, number), None
    control, twists = parts_of(patches)
    which = point_sides(control)
    net = number(control)
    rational = net.shape[3] == 4
    weight = net[..., 3:] if rational else number(np.ones((*net.shape[:3], 1)))
    first = net[:, :1, :1, :3] / weight[:, :1, :1]
    points = _with_points(net[..., :3] - weight * first, weight, which)
    size = _largest(points)
    points = points / size
    along_u, along_v = _slopes(points)
    found = _bracket(points, weight / _largest(weight)) if rational else _product(along_u, along_v, cross)
    scale = 1 / _largest(found)
    if not twists.shape[1]:
        return _over_distance(found * scale, which), None
    pinched = which & (np.arange(4) == 2)
    spin = Spin(along_u, _over_distance(along_v, pinched), number(twists) / size[:, 0], scale[:, 0, 0, 0])
    return _over_distance(found * scale, which), spin


def _of_tangents(shaded: Any, number: Any) -> np.ndarray:
    along_u, along_v = (np.asarray(own) for own in (shaded.along_u, shaded.along_v))
    which = still_sides(along_u, along_v)
    along_u, along_v = (own / _largest(own) for own in map(number, (along_u, along_v)))
    for k in range(4):
        side = _side(along_u if k % 2 else along_v, k)
        side[which[:, k]] = 0 * side[which[:, k]]
    found = _product(along_u, along_v, cross)
    return _over_distance(found / _largest(found), which)


def still_sides(along_u: np.ndarray, along_v: np.ndarray) -> np.ndarray:
    """Along which sides u=0, v=0, u=1, v=1 there are no tangents in their direction, ``(patches, 4)``."""
    sizes = [np.abs(own).max(axis=(1, 2, 3)) for own in (along_u, along_v)]
    nothing = max(_NOTHING, _NOTHING_ROUNDED * float(np.finfo(along_u.dtype).eps)) * np.maximum(*sizes)
    sides = along_v[:, 0], along_u[:, :, 0], along_v[:, -1], along_u[:, :, -1]
    return np.stack([np.abs(side).max(axis=(1, 2)) <= nothing for side in sides], axis=1)


def _largest(net: np.ndarray) -> np.ndarray:
    """``(patches, 1, 1, 1)``, 1 where all numbers are 0."""
    found = np.abs(net).max(axis=(1, 2, 3))
    return np.where(found == 0, found + 1, found)[:, None, None, None]


def _side(net: np.ndarray, k: int) -> np.ndarray:
    """A view of the control points along u=0, v=0, u=1 or v=1, ``(patches, points, ...)``."""
    return np.moveaxis(net, 1 + k % 2, 0)[-(k // 2)]


def _with_points(points: np.ndarray, weight: np.ndarray, which: np.ndarray) -> np.ndarray:
    """The sides that are points made exactly that: (w p) to w times the first p."""
    for k in range(4):
        side, own = _side(points, k), _side(weight, k)
        side[which[:, k]] = (own * (side[:, :1] / own[:, :1]))[which[:, k]]
    return points


def _slopes(net: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Derivatives by u and by v."""
    return (net.shape[1] - 1) * (net[:, 1:] - net[:, :-1]), (net.shape[2] - 1) * (net[:, :, 1:] - net[:, :, :-1])


def _bracket(p: np.ndarray, w: np.ndarray) -> np.ndarray:
    """w p_u x p_v - w_v p_u x p - w_u p x p_v, of homogeneous control points."""
    (p_u, p_v), (w_u, w_v) = _slopes(p), _slopes(w)
    turning = _product(w, _product(p_u, p_v, cross), np.multiply)
    early = _product(w_v, _product(p_u, p, cross), np.multiply)
    return turning - early - _product(w_u, _product(p, p_v, cross), np.multiply)


def _product(a: np.ndarray, b: np.ndarray, multiply: Any) -> np.ndarray:
    """Of two nets, whose degrees add up."""
    a, b = a * _binomials(a), b * _binomials(b)
    found: Any = None
    for i, j in np.ndindex(*a.shape[1:3]):
        part = multiply(a[:, i : i + 1, j : j + 1], b)
        if found is None:
            shape = a.shape[1] + b.shape[1] - 1, a.shape[2] + b.shape[2] - 1
            found = np.zeros((len(a), *shape, part.shape[3]), part.dtype)
        found[:, i : i + b.shape[1], j : j + b.shape[2]] += part
    return found / _binomials(found)


def _binomials(net: np.ndarray) -> np.ndarray:
    by_u, by_v = ([comb(n - 1, k) for k in range(n)] for n in net.shape[1:3])
    return np.outer(by_u, by_v)[..., None].astype(net.dtype)


def _over_distance(net: np.ndarray, which: np.ndarray) -> np.ndarray:
    """Divided by the distance from sides; of the same degrees, raised again."""
    net = net.copy()
    for k in range(4):
        own = np.moveaxis(net, 1 + k % 2, 0)
        own = own[::-1] if k > 1 else own
        degree = len(own) - 1
        if degree == 0:
            own[:, which[:, k]] = 0 * own[:, which[:, k]]
            continue
        lower = np.stack([own[j] * degree / j for j in range(1, degree + 1)])
        for j in range(degree + 1):
            before = j * lower[j - 1] if j else 0 * lower[0]
            after = (degree - j) * lower[j] if j < degree else 0 * lower[0]
            own[j][which[:, k]] = ((before + after) / degree)[which[:, k]]
    return net
