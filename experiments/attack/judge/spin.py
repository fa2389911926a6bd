"""What twists of Gregory patches add to normals: the slopes of their terms by the quotient rule, in any precision."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from slefejax.experiments.attack.judge.search import bernstein

QUADS = 4  # slots of quads; others are of triangles pinched at u = 1


class Spin(NamedTuple):
    """Of normals (A + a) x (B + b), with a and b what twists add to tangents; B and b over 1 - u where pinched."""

    along_u: np.ndarray  # (pairs, nu-1, nv, 3): A
    along_v: np.ndarray  # (pairs, nu, nv-1, 3): B
    twists: np.ndarray  # (pairs, slots, 3)
    scale: np.ndarray  # (pairs,): by which their product is multiplied

    def at(self, u: np.ndarray, v: np.ndarray) -> np.ndarray:
        """a x B + (A + a) x b, ``(pairs, places, 3)``, at u and v ``(pairs, places)``."""
        a, b = (_valued(net, u, v) for net in (self.along_u, self.along_v))
        by_u, by_v = (np.stack(own, axis=2) @ self.twists for own in slopes(self.twists.shape[1], u, v))
        return (cross(by_u, b) + cross(a + by_u, by_v)) * self.scale[:, None, None]


def _valued(net: np.ndarray, u: np.ndarray, v: np.ndarray) -> np.ndarray:
    count, nu, nv, _ = net.shape
    along = np.matmul(bernstein(nu - 1, u), net.reshape(count, nu, nv * 3)).reshape(count, -1, nv, 3)
    return np.sum(bernstein(nv - 1, v)[..., None] * along, axis=2)


def cross(a: np.ndarray, b: np.ndarray, axis: int = -1) -> np.ndarray:
    """Of vectors along an axis."""
    (x, y, z), (p, q, r) = np.moveaxis(a, axis, 0), np.moveaxis(b, axis, 0)
    return np.stack([y * r - z * q, z * p - x * r, x * q - y * p], axis=axis)


def slopes(slots: int, u: Any, v: Any) -> tuple[list[Any], list[Any]]:
    """Of what every twist is multiplied with, by u and by v; of triangles those by v over 1 - u."""
    a, b = 1 - u, 1 - v
    one, two, three, four = (_of_quad(*own) for own in ((u, v), (v, a), (a, b), (b, u)))
    by_u, by_v = [one[0], -two[1], -three[0], four[1]], [one[1], two[0], -three[1], -four[0]]
    for turn, w in ((1, v), (-1, b))[: slots - QUADS]:
        one, other = _of_triangle(u, w)
        by_u.append(turn * one)
        by_v.append(other)
    return by_u, by_v


def _of_quad(s: Any, t: Any) -> tuple[Any, Any]:
    """By s and t, of 9/2 s t (1-s)^2 (1-t)^2 times (s - t)/(s + t)."""
    both = _not_zero(s + t)
    turned, x, y = (s - t) / both, s * (1 - s) ** 2, t * (1 - t) ** 2
    by_s = y * ((1 - s) * (1 - 3 * s) * turned + x * 2 * t / both**2)
    by_t = x * ((1 - t) * (1 - 3 * t) * turned - y * 2 * s / both**2)
    return 9 * by_s / 2, 9 * by_t / 2


def _of_triangle(u: Any, v: Any) -> tuple[Any, Any]:
    """By u, and by v over 1 - u, of 6 u a^3 v (1-v)^2 times (u - a v)/(u + a v), a = 1 - u."""
    a, b = 1 - u, 1 - v
    both = _not_zero(u + a * v)
    turned = (u - a * v) / both
    by_u = v * b**2 * (a**2 * (a - 3 * u) * turned + u * a**3 * 2 * v / both**2)
    by_v = u * a**2 * (b * (b - 2 * v) * turned - v * b**2 * 2 * a * u / both**2)
    return 6 * by_u, 6 * by_v


def _not_zero(values: Any) -> Any:
    """At corners, where all is 0, anything else."""
    return np.where(values == 0, values + 1, values) if isinstance(values, np.ndarray) else values if values else 1
