"""Factors for interpolated normals (docs/certified.md, 11).

They do not depend on the view: what is found for patches serves all views.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from slefejax.arguments import on_host
from slefejax.errors import InputError
from slefejax.geometry.bezier import derivative
from slefejax.geometry.normals import (
    TangentNets,
    array_module,
    collapsed_sides,
    crossed,
    normal_net,
    still_sides,
    with_points,
    with_still,
    without_collapsed,
)
from slefejax.geometry.packed import Packed
from slefejax.lanes import layout, loops, passes
from slefejax.lanes.maxima import Maxima
from slefejax.lanes.tuning import TUNING
from slefejax.predict.cells import Pictures, Turned
from slefejax.predict.normals.claim import NormalClaim
from slefejax.predict.normals.turning import turning

MOST = 1024.0  # cells a side: a normal that needs more counts as one that does not exist
_LOOSE = 1.75  # more tiles are worth it where second derivatives are bounded by that many times what corners tell
_FINER = 4  # times as many tiles along each side
_HIGHEST_DEGREE = 16  # of normals


class Surfaces(NamedTuple):
    """Patches, and which of their sides are points."""

    control: Any  # (nu, nv, 3 or 4, lanes)
    collapsed: Any  # (4, lanes)

    def undivided(self) -> tuple[Any, Any]:
        """Their normals, at any scale, and the size of a coordinate, to which rounding errors are proportional."""
        control = with_points(self.control, self.collapsed)
        if control.shape[2] == 3:
            return Tangents(*_tangents(control), self.collapsed).undivided()
        near, size = _relative(control)
        return without_collapsed(normal_net(near), self.collapsed), size * _grown(self.collapsed, near.shape)


def _tangents(control: Any) -> tuple[Any, Any]:
    """Nets of the derivatives by u and by v. Differences of points that are given are as good as these."""
    return derivative(control), derivative(control.swapaxes(0, 1)).swapaxes(0, 1)


def _relative(control: Any) -> tuple[Any, Any]:
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


class Tangents(NamedTuple):
    """Tangent nets along u, ``(du, dv+1, 3, lanes)``, and along v, ``(du+1, dv, 3, lanes)``."""

    along_u: Any
    along_v: Any
    still: Any  # (4, lanes): along which sides those in their direction are 0

    def undivided(self) -> tuple[Any, Any]:
        """As of ``Surfaces``."""
        near = [net / _largest(net) for net in with_still(self[:2], self.still)]
        size = array_module(*near).full_like(near[0][0, 0, 0], 2.0) * _grown(self.still, near[1].shape)
        return without_collapsed(crossed(*near), self.still), size


def _top(net: Any) -> Any:
    """The size of the largest number of a net; what numbers are divided by has no slope."""
    xp = array_module(net)
    size = xp.max(xp.abs(net), axis=(0, 1, 2))
    return size if xp is np else jax.lax.stop_gradient(size)


def _largest(net: Any) -> Any:
    """The same, or 1 where all are 0."""
    size, xp = _top(net), array_module(net)
    return xp.where(size > 0, size, xp.ones_like(size))


@loops.chunked
def _turning_factors(given: Any, angle: Any, maxima: Maxima, *, tiles: int) -> Any:
    """Real factors, infinite where nothing is known, and where more tiles may find less."""
    net, size = given.undivided()
    found = turning(net, size, angle, tiles=tiles, maxima=maxima)
    tight = found.second <= _LOOSE * jnp.maximum(found.corners, 1.0)
    return found.factor, ~(tight & found.known)


@_turning_factors.rest
def _finer(given: Any, angle: Any, maxima: Maxima, *, tiles: int) -> Array:
    net, size = given.undivided()
    return turning(net, size, angle, tiles=_FINER * tiles, maxima=maxima).factor


@_turning_factors.slopes
def _slopes(given: Any, _: Any, angle: Any, maxima: Maxima, *, tiles: int) -> Array:
    found, loose = _turning_factors.kernel(given, angle, maxima, tiles=tiles)
    return jnp.where(loose, _finer(given, angle, maxima, tiles=tiles), found)


@passes.as_pass(3)
def _turning_pass(every: tuple[Any], angle: Any, maxima: Maxima, tiles: int) -> Any:
    (given,) = every
    chunks, lanes = jax.tree.leaves(given)[0].shape[0], jax.tree.leaves(given)[0].shape[-1]
    found = _turning_factors(jax.tree.map(_narrow, given), angle, maxima, tiles=tiles)
    return found.reshape(chunks, lanes)


def _narrow(packed: Array) -> Array:
    """Chunks of fewer lanes: nets of normals are large."""
    lanes = packed.shape[-1]
    own = min(lanes, TUNING.turned)
    parts = packed.reshape(*packed.shape[:-1], lanes // own, own)
    return jnp.moveaxis(parts, -2, 1).reshape(-1, *packed.shape[1:-1], own)


def turning_factors(given: Any, count: int, degrees: Any, maxima: Maxima, tiles: int) -> Float[Array, "patches"]:
    """Real factors from which on interpolated normals of patches are right to within an angle; infinite: no claim.

    given : ``Surfaces`` or ``Tangents``, chunks of them
    """
    angle = jnp.deg2rad(jnp.asarray(degrees, jax.tree.leaves(given)[0].dtype))
    found = layout.unpack(_turning_pass((given,), angle, maxima, tiles), count)
    return jnp.where(found <= MOST, found, jnp.inf)


@dataclass(frozen=True, eq=False)
class Shading:
    """How patches are shaded, and how far off that may be.

    packed   : the patches
    tangents : tangent patches; None: the surface's own normals
    degrees  : how far interpolated normals may be from the exact ones
    maxima   : of the factors
    tiles    : along each side of a patch, more where they find less

    Raises InputError for patches whose normals nothing is known of.
    """

    packed: Packed
    tangents: TangentNets | None
    degrees: Any
    maxima: Maxima
    tiles: int

    def __post_init__(self) -> None:
        """Refuse what there is no certificate for."""
        if self.tangents is not None:
            return
        if self.packed.gregory:
            raise InputError("Gregory patches have no certificate for normals: load the mesh with the scheme 'acc'")
        shape = self.packed.chunks.shape[1:3]
        highest = max((3 * n - 5 if self.packed.dimension == 4 else 2 * n - 3) for n in shape)
        if highest > _HIGHEST_DEGREE:
            raise InputError(
                f"normals of these patches have degree {highest}, and a certificate is there up to {_HIGHEST_DEGREE}:"
                " leave normal_tolerance out, or convert the mesh with the scheme 'acc'",
                options=("normal_tolerance",),
            )

    @cached_property
    def factor(self) -> Float[Array, "patches"]:
        """From which on they are not; infinite where there is no claim, such as at cusps."""
        return turning_factors(self._chunks, len(self.packed), self.degrees, self.maxima, self.tiles)

    def program(self) -> Any:
        """The traced program (jaxpr) of the factors."""
        given = (self._chunks,), self.degrees, self.maxima, self.tiles
        return jax.make_jaxpr(_turning_pass, static_argnums=3)(*given)

    @property
    def _chunks(self) -> Surfaces | Tangents:
        if self.tangents is not None:
            return self._packed_tangents(self.tangents)
        control = self.packed.chunks
        if self.packed.rounded and self.packed.given is not None:
            # what is lost of coordinates may be much of their differences
            given = np.moveaxis(np.asarray(self.packed.given, np.float64), 0, -1)
            given = with_points(given, np.asarray(self._still).T)
            if given.shape[2] == 3:
                return self._packed_tangents([np.moveaxis(own, -1, 0) for own in _tangents(given)])
            near = np.moveaxis(_relative(given)[0], -1, 0).astype(self.packed.dtype)
            control = layout.pack(near, control.shape[-1])
        return Surfaces(control, layout.pack(self._still, control.shape[-1]))

    def _packed_tangents(self, tangents: Any) -> Tangents:
        every = (*(own.astype(self.packed.dtype) for own in tangents), self._still)
        along_u, along_v, still = (layout.pack(own, TUNING.turned) for own in every)
        return Tangents(along_u, along_v, still)

    @cached_property
    def _still(self) -> Bool[Array | np.ndarray, "patches 4"]:
        """Along which sides normals are 0, because they are points."""
        return collapsed_sides(self.packed.patches()) if self.tangents is None else still_sides(self.tangents)

    def joined(self, factor: Any) -> tuple[Any, Any]:
        """Factors for positions and normals both, and of which patches on the screen normals have no claim."""
        claimed = jnp.isfinite(self.factor)
        both = self.maxima.largest([factor, jnp.where(claimed, self.factor, 0.0).astype(factor.dtype)])
        return jnp.where(factor > 0, both, factor), ~claimed & (factor > 0)

    def claim(self) -> NormalClaim:
        """What tells which triangles keep the angle."""
        pictures, claimed = Pictures(self._turned, len(self.packed)), np.isfinite(self.factor)
        return NormalClaim(pictures, self._turned, self._angle, _FINER * self.tiles, claimed)

    @property
    def _angle(self) -> float:
        return float(np.deg2rad(float(self.degrees)))

    def _turned(self, which: np.ndarray) -> Turned:
        """In double precision, whatever the patches are in."""
        if self.tangents is None:
            patches = np.moveaxis(np.asarray(on_host(self.packed.patches())[which], np.float64), 0, -1)
            given: Any = Surfaces(patches, np.asarray(self._still)[which].T)
        else:
            along_u, along_v = (np.moveaxis(np.asarray(own, np.float64)[which], 0, -1) for own in self.tangents)
            given = Tangents(along_u, along_v, np.asarray(self._still)[which].T)
        net, size = given.undivided()
        return Turned(net, size, self._angle)
