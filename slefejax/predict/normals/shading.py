"""Factors for interpolated normals (docs/certified.md, 11).

They do not depend on the view: what is found for patches serves all views.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from slefejax.arguments import on_host
from slefejax.errors import InputError
from slefejax.geometry.evaluate import as_control
from slefejax.geometry.gregory import Twisted
from slefejax.geometry.normals import TangentNets, collapsed_sides, still_sides, with_points
from slefejax.geometry.packed import Packed
from slefejax.lanes import layout, loops, passes
from slefejax.lanes.maxima import Maxima
from slefejax.lanes.tuning import TUNING
from slefejax.predict.cells import Pictures, Turned
from slefejax.predict.normals.claim import NormalClaim
from slefejax.predict.normals.turning import turning
from slefejax.predict.normals.undivided import Surfaces, Tangents, from_corner, tangents_of

MOST = 1024.0  # cells a side: a normal that needs more counts as one that does not exist
_LOOSE = 1.75  # more tiles are worth it where second derivatives are bounded by that many times what corners tell
_FINER = 4  # times as many tiles along each side
_HIGHEST_DEGREE = 16  # of normals


@loops.chunked
def _turning_factors(given: Any, angle: Any, maxima: Maxima, *, tiles: int) -> Any:
    """Real factors, infinite where nothing is known, and where more tiles may find less."""
    found = turning(given.undivided(), angle, tiles=tiles, maxima=maxima)
    tight = jnp.maximum(found.second, found.spun) <= _LOOSE * jnp.maximum(found.corners, 1.0)
    return found.factor, ~(tight & found.known)


@_turning_factors.rest
def _finer(given: Any, angle: Any, maxima: Maxima, *, tiles: int) -> Array:
    return turning(given.undivided(), angle, tiles=_FINER * tiles, maxima=maxima).factor


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
        control = self.packed.chunks
        shape = (control.net if isinstance(control, Twisted) else control).shape[1:3]
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
        lanes = jax.tree.leaves(control)[0].shape[-1]
        if self.packed.rounded and self.packed.given is not None:
            # what is lost of coordinates may be much of their differences
            given = jax.tree.map(_patches_last, as_control(self.packed.given))
            net, twists = given if isinstance(given, Twisted) else (given, None)
            net = with_points(net, np.asarray(self._still).T)
            if net.shape[2] == 3:
                tangents = [np.moveaxis(own, -1, 0) for own in tangents_of(net)]
                return self._packed_tangents(tangents, None if twists is None else np.moveaxis(twists, -1, 0))
            near = np.moveaxis(from_corner(net)[0], -1, 0).astype(self.packed.dtype)
            control = layout.pack(near, lanes)
        return Surfaces(control, layout.pack(self._still, lanes))

    def _packed_tangents(self, tangents: Any, twists: Any = None) -> Tangents:
        along_u, along_v = (own.astype(self.packed.dtype) for own in tangents)
        twists = None if twists is None else twists.astype(self.packed.dtype)
        every = Tangents(along_u, along_v, self._still, twists)
        return jax.tree.map(lambda own: layout.pack(own, TUNING.turned), every)

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
        spun = self.tangents is None and self.packed.gregory
        return NormalClaim(pictures, self._turned, self._angle, _FINER * self.tiles, spun, claimed)

    @property
    def _angle(self) -> float:
        return float(np.deg2rad(float(self.degrees)))

    def _turned(self, which: np.ndarray) -> Turned:
        """In double precision, whatever the patches are in."""
        still = np.asarray(self._still)[which].T
        if self.tangents is None:
            patches = as_control(on_host(self.packed.patches())[which])
            given: Any = Surfaces(jax.tree.map(_patches_last, patches), still)
        else:
            along_u, along_v = (_patches_last(np.asarray(own)[which]) for own in self.tangents)
            given = Tangents(along_u, along_v, still)
        return Turned(given.undivided(), self._angle)


def _patches_last(values: Any) -> np.ndarray:
    """In double precision."""
    return np.moveaxis(np.asarray(values, np.float64), 0, -1)
