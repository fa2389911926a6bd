"""Bézier patches as a table of different control points, and a net of their numbers for every patch.

Points that neighbours share have one number, so they are equal bit for bit whatever they are computed from.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Int

from slefejax.conversion.gaussian.products import Products
from slefejax.geometry.gregory import GregoryPatches, Twisted
from slefejax.geometry.packed import chunks_of, packed_numbers
from slefejax.model.gaussians import Gaussians
from slefejax.model.stencils import StencilTable
from slefejax.tessellator.edges import Sides

KINDS = ("regular", "extraordinary", "boundary", "crease", "triangle", "spline", "bezier")


@dataclass(frozen=True, eq=False)
class Patchwork:
    """How patches are made of control points.

    points : table from control points to the different control points of all patches; of Gaussian products, from q of
             vertices to that of bicubic patches
    net    : ``(patches, du+1, dv+1)``, which of them each patch has
    faces  : ``(patches,)``, the face of the control mesh (or the surface) that each patch comes from
    kinds  : ``(patches,)``, numbers in KINDS
    first  : table that is applied before ``points``, a step of subdivision; None for none. One table for both would
             have twice the weights
    twists : of Gregory patches: ``(patches, slots)``, which rows of ``points`` their twists are
             (``slefejax.geometry.gregory``); None of Bézier patches
    products : of Gaussian products: what makes control points of rational patches of ``Gaussians`` and of rows of
             ``points`` (``slefejax.conversion.gaussian.products``); None of others
    """

    points: StencilTable
    net: Int[np.ndarray, "patches nu nv"]
    faces: Int[np.ndarray, "patches"]
    kinds: Int[np.ndarray, "patches"]
    first: StencilTable | None = None
    twists: Int[np.ndarray, "patches slots"] | None = None
    products: Products | None = None

    def patches(self, control: Any) -> Any:
        """Control points of all patches by JAX: ``(inputs, dim)`` to ``(patches, du+1, dv+1, dim)``; differentiable.

        ``GregoryPatches`` of those. Of Gaussian products control are ``Gaussians``, with double precision.
        """
        return self._of(self.control_points(control))

    def on_host(self, control: Any) -> Any:
        """The same in float64 by NumPy alone."""
        control = control if self.products is None else self.products.dual(Gaussians(*map(np.asarray, control)))
        points = self.points.on_host(control if self.first is None else self.first.on_host(control))
        return self._of(points if self.products is None else self.products(points))

    def _of(self, points: Any) -> Any:
        net = points[self.net]
        return net if self.twists is None else GregoryPatches(net, points[self.twists])

    @cached_property
    def packed_net(self) -> Any:
        """``net``, and twists if there are any, in the layout of the kernels."""
        return packed_numbers(self.net if self.twists is None else Twisted(self.net, self.twists))

    def packed(self, control: Any) -> Any:
        """The same by JAX in the layout of the kernels, ``(chunks, du+1, dv+1, dim, lanes)`` (``lanes.layout``)."""
        return chunks_of(self.control_points(control), self.packed_net)

    def control_points(self, control: Any) -> Any:
        """All different control points, by JAX."""
        control = control if self.products is None else self.products.dual(Gaussians(*map(jnp.asarray, control)))
        points = self.points(control if self.first is None else self.first(control))
        return points if self.products is None else self.products(points)

    @cached_property
    def sides(self) -> Sides:
        """Which curve each side is: those with the same points are one, in any pose."""
        return Sides.of(self.net[..., None])

    @property
    def edge_numbers(self) -> Int[np.ndarray, "patches 4"]:
        """Which edges are shared."""
        return self.sides.numbers
