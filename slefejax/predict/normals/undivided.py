"""Nets of undivided normals, as bounds take them (docs/certified.md, 11): of patches of every kind, and tangent nets.

Arrays are in kernels' order, with the patches last.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np

from slefejax.geometry.bezier import derivative
from slefejax.geometry.gregory import QUAD_TWISTS, Twisted
from slefejax.geometry.normals import (
    array_module,
    crossed,
    normal_net,
    with_points,
    with_still,
    without_collapsed,
)

_SLOPE = 1.0  # slopes of quads' twist terms are no larger than that, of triangles' nearly so
_PINCH = 2  # the side u = 1


class Spin(NamedTuple):
    """What twists of Gregory patches turn: N = (A + sum alpha_k a_k) x (B + sum beta_k b_k).

    alpha_k and beta_k are the slopes of twist terms, a_k and b_k the twists at the scales of A and of B. Where a
    triangle is pinched, B and beta_k are over 1 - u.
    """

    along_u: Any  # (nu-1, nv, 3, lanes): A
    along_v: Any  # (nu, nv-1, 3, lanes): B
    by_u: Any  # (slots, 3, lanes): a_k
    by_v: Any  # (slots, 3, lanes): b_k


class Undivided(NamedTuple):
    """Normals, at any scale.

    net  : ``(ku+1, kv+1, 3, lanes)``, without what twists make
    size : ``(lanes,)``, of a coordinate, to which its rounding errors are proportional; 0 where nothing is known
    spin : of Gregory patches
    """

    net: Any
    size: Any
    spin: Spin | None = None


class Surfaces(NamedTuple):
    """Patches, and which of their sides are points."""

    control: Any  # (nu, nv, 3 or 4, lanes), or Twisted
    collapsed: Any  # (4, lanes)

    def undivided(self) -> Undivided:
        """Their normals."""
        if isinstance(self.control, Twisted):
            net = with_points(self.control.net, self.collapsed)
            return Tangents(*tangents_of(net), self.collapsed, self.control.twists).undivided()
        control = with_points(self.control, self.collapsed)
        if control.shape[2] == 3:
            return Tangents(*tangents_of(control), self.collapsed).undivided()
        near, size = from_corner(control)
        return Undivided(without_collapsed(normal_net(near), self.collapsed), size * _grown(self.collapsed, near.shape))


class Tangents(NamedTuple):
    """Tangent nets along u, ``(du, dv+1, 3, lanes)``, and along v, ``(du+1, dv, 3, lanes)``."""

    along_u: Any
    along_v: Any
    still: Any  # (4, lanes): along which sides those in their direction are 0
    twists: Any = None  # (slots, 3, lanes) of Gregory patches, whose slopes are added

    def undivided(self) -> Undivided:
        """As of ``Surfaces``."""
        nets = with_still((self.along_u, self.along_v), self.still)
        scales = [_largest(net) for net in nets]
        near = [net / scale for net, scale in zip(nets, scales, strict=True)]
        size = array_module(*near).full_like(near[0][0, 0, 0], 2.0) * _grown(self.still, near[1].shape)
        net = without_collapsed(crossed(*near), self.still)
        if self.twists is None:
            return Undivided(net, size)
        turns = [self.twists / scale for scale in scales]
        for own in turns:
            size = size * (1.0 + _SLOPE * _lengths(own).sum(axis=0))
        pinched = [own & (side == _PINCH) for side, own in enumerate(self.still)]
        spin = Spin(near[0], without_collapsed(near[1], pinched), *turns)
        return Undivided(net, array_module(size).where(self._unknown, 0.0, size), spin)

    @property
    def _unknown(self) -> Any:
        """Slopes of twist terms are divided by 1 - u, of triangles, and by nothing else."""
        quad, triangle = ((own != 0).any(axis=(0, 1)) for own in (self.twists[:QUAD_TWISTS], self.twists[QUAD_TWISTS:]))
        pinched = self.still[_PINCH]
        others = self.still[0] | self.still[1] | self.still[3]
        return (others & (quad | triangle)) | (pinched & quad) | (~pinched & triangle)


def tangents_of(control: Any) -> tuple[Any, Any]:
    """Nets of the derivatives by u and by v. Differences of points that are given are as good as these."""
    return derivative(control), derivative(control.swapaxes(0, 1)).swapaxes(0, 1)


def from_corner(control: Any) -> tuple[Any, Any]:
    """Rational patches from a corner, with coordinates up to 1, and how large coordinates of their normals may be.

    Larger where weights times the corner, which are taken off, are large beside what is left.
    """
    xp, (nu, nv) = array_module(control), control.shape[:2]
    corner, weights = control[:1, :1, :3] / control[:1, :1, 3:], control[:, :, 3:]
    points = control[:, :, :3] - weights * corner
    near = xp.concatenate([points / _largest(points), weights / _largest(weights)], axis=2)
    return near, 6.0 * (nu - 1) * (nv - 1) * (1.0 + _top(weights * corner) / _largest(points))


def _grown(divided: Any, shape: tuple[int, ...]) -> Any:
    """By how much dividing by distances from sides lets rounding errors grow at most."""
    return (3.0 * max(shape[:2])) ** divided.sum(axis=0)


def _lengths(vectors: Any) -> Any:
    """Of ``(slots, 3, lanes)``, or more."""
    xp = array_module(vectors)
    return xp.abs(vectors).sum(axis=-2)


def _top(net: Any) -> Any:
    """The size of the largest number of a net; what numbers are divided by has no slope."""
    xp = array_module(net)
    size = xp.max(xp.abs(net), axis=(0, 1, 2))
    return size if xp is np else jax.lax.stop_gradient(size)


def _largest(net: Any) -> Any:
    """The same, or 1 where all are 0."""
    size, xp = _top(net), array_module(net)
    return xp.where(size > 0, size, xp.ones_like(size))
