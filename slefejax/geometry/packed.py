"""Patches in the layout of the kernels, and brought to where the kernels' numbers hold them.

Kernels compute with points relative to an origin near to them or to the eye. The origin is taken off in the precision
that the points come in, before anything is rounded: on the host where that is more than JAX has, or where a scene is so
small or so large that single numbers of it are none any more (``Packed.placed``).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from slefejax.arguments import Patches, check_patches, check_weights
from slefejax.geometry.evaluate import as_control
from slefejax.geometry.gregory import GregoryPatches, Twisted
from slefejax.geometry.projection import Projection, least_distance, relative
from slefejax.geometry.view import View
from slefejax.lanes import layout


@dataclass(frozen=True, eq=False)
class Packed:
    """Patches as the kernels want them; make it with ``pack``, or ``Packed.made`` of chunks that are there.

    given : ``(patches, du+1, dv+1, dim)`` or ``GregoryPatches``, in whatever precision they came in; None if they were
            made as chunks
    own   : chunks ``(chunks, du+1, dv+1, dim, lanes)`` (``lanes.layout``), ``Twisted`` of Gregory patches; None if they
            are made of those given
    count : how many patches there are
    rounded : whether the chunks have fewer digits than the patches had

    >>> packed = pack(np.zeros((5, 4, 4, 3)))
    >>> len(packed), packed.chunks.shape, packed.patches().shape
    (5, (2, 4, 4, 3, 16), (5, 4, 4, 3))
    """

    given: Any
    own: Any
    count: int
    rounded: bool

    @staticmethod
    def made(chunks: Any, count: int, rounded: bool = False) -> Packed:
        """Patches that are in the layout of the kernels already."""
        return Packed(None, chunks, count, rounded)

    def __len__(self) -> int:
        return self.count

    @cached_property
    def chunks(self) -> Any:
        """In the layout of the kernels, and in JAX's precision."""
        return _packed(as_control(self.given)) if self.own is None else self.own

    @property
    def gregory(self) -> bool:
        """Whether they are Gregory patches."""
        return isinstance(self.given, GregoryPatches) or isinstance(self.own, Twisted)

    @property
    def dimension(self) -> int:
        """3, or 4 if they are rational."""
        return _net(self.own).shape[3] if self.given is None else self.given.shape[3]

    @property
    def dtype(self) -> Any:
        """Of the numbers that kernels compute with."""
        return _net(self.own).dtype if self.given is None else jax.dtypes.canonicalize_dtype(self.given.dtype)

    def patches(self) -> Any:
        """In the order of users, ``(patches, du+1, dv+1, dim)``: those given, or made of the chunks."""
        if self.given is not None:
            return self.given
        unpack = layout.unpack if isinstance(_net(self.own), Tracer) else layout.unpack_on_host
        found = jax.tree.map(lambda chunks: unpack(chunks, self.count), self.own)
        return GregoryPatches(*found) if isinstance(found, Twisted) else found

    def __jax_array__(self) -> Any:
        """So that functions that take patches take these."""
        return self.patches()

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        """The same for NumPy."""
        return np.array(self.patches(), dtype, copy=copy)

    def placed(self, view: View) -> tuple[Any, Projection]:
        """Chunks near to an origin, or in a unit, in which their digits are held, and the projection for these."""
        unit = _unit(view, self.dtype)
        exact = self.given is None or self.given.dtype == self.dtype
        source = _net(self.own) if self.given is None else self.given
        source = source.net if isinstance(source, GregoryPatches) else source
        known = not isinstance(source, Tracer) and isinstance(view.camera.world_to_eye, np.ndarray)
        if not known or (exact and unit == 1.0):
            origin = line_of_sight(view, self.chunks)
            return self.chunks, Projection.of(view, self.dtype, origin, self.rounded)
        control = jax.tree.map(lambda x: np.asarray(x, np.float64), as_control(self.patches()))
        points = _net(control)
        origin = _beside_nearest(view, np.moveaxis(points[:, 0, 0], 0, -1))
        near = relative(points, origin, axis=-1)
        near[..., :3] *= unit
        near = Twisted(near, control.twists * unit) if isinstance(control, Twisted) else near
        moved = Projection.of(_in_units(view, unit), self.dtype, origin * unit)
        with np.errstate(over="ignore"):  # what overflows is refused with the patch's number
            near = jax.tree.map(lambda x: x.astype(self.dtype), near)
        return _packed(near), moved._replace(origin=np.zeros(3, self.dtype))


def _packed(control: Any) -> Any:
    """Control points, or numbers of them, and twists if there are any, as chunks of as many lanes."""
    nu, nv = _net(control).shape[1:3]
    return jax.tree.map(lambda own: layout.pack(own, layout.most_lanes(nu * nv)), control)


def _net(chunks: Any) -> Any:
    """Of Gregory patches the nets alone."""
    return chunks.net if isinstance(chunks, Twisted) else chunks


jax.tree_util.register_pytree_node(
    Packed,
    lambda packed: ((packed.chunks,), (packed.count, packed.rounded)),
    lambda kept, children: Packed.made(children[0], *kept),
)


def pack(patches: Patches) -> Packed:
    """Patches in the layout of the kernels, made once: taken wherever patches are.

    patches : control points ``(patches, du+1, dv+1, 3)``, u before v, any bi-degree; 4 at the end if rational, with
              positive weights; or ``GregoryPatches``; or what this function returned

    Raises InputError for wrong shapes and weights.

    >>> from slefejax import load
    >>> len(pack(load("teapot").patches()))
    32
    """
    if isinstance(patches, Packed):
        return patches
    given = check_patches(patches, gregory=True)
    check_weights(given)
    return Packed(given, None, len(given), given.dtype != jax.dtypes.canonicalize_dtype(given.dtype))


def packed_numbers(net: Any) -> Any:
    """Numbers of points, a net of them a patch, ``Twisted`` with those of twists, in the layout of the kernels.

    >>> packed_numbers(np.arange(8).reshape(2, 2, 2)).shape
    (2, 2, 2, 16)
    """
    return jax.tree.map(np.asarray, _packed(jax.tree.map(lambda own: own.astype(np.int32), net)))


def chunks_of(points: Array | np.ndarray, numbers: Any) -> Any:
    """Control points ``(chunks, nu, nv, dim, lanes)`` of patches whose ``packed_numbers`` these are, by JAX.

    Of Gregory patches numbers and control points are ``Twisted``, twists ``(chunks, slots, dim, lanes)``.

    >>> points = np.arange(12.0).reshape(4, 3)
    >>> chunks_of(jnp.asarray(points), packed_numbers(np.array([[[0, 1], [2, 3]]]))).shape
    (2, 2, 2, 3, 16)
    """
    rows = points.reshape(len(points), -1).T
    return jax.tree.map(lambda own: jnp.moveaxis(rows[:, own], 0, -2), numbers)


def _unit(view: View, dtype: Any) -> float:
    """What to multiply a scene by whose numbers would not be held: a power of two, 1 for all but strange ones."""
    camera = view.camera
    size = camera.near if camera.perspective else camera.extent
    least = least_distance(dtype)
    if isinstance(size, Tracer) or least <= size <= 1.0 / least:
        return 1.0
    return float(2.0 ** -np.floor(np.log2(float(size))))


def _in_units(view: View, unit: float) -> View:
    camera = view.camera
    names = ("eye", "target", "near", "far") + (() if camera.perspective else ("extent",))
    return replace(view, camera=replace(camera, **{name: getattr(camera, name) * unit for name in names}))


def line_of_sight(view: View, packed: Any) -> Any:
    """An origin for control points in the layout of the kernels: on the line of sight, beside the nearest of them.

    That is the eye if some are beside or behind it. There points that matter have small coordinates, and those of the
    origin on the screen are 0. The eye, too, if points or view are traced.
    """
    camera, packed = view.camera, _net(packed)
    if isinstance(packed, Tracer) or not isinstance(camera.world_to_eye, np.ndarray):
        return camera.eye.astype(packed.dtype)
    corners = np.moveaxis(np.asarray(packed)[:, 0, 0].astype(np.float64), 1, 0)
    return _beside_nearest(view, corners.reshape(len(corners), -1)).astype(packed.dtype)


def _beside_nearest(view: View, corners: np.ndarray) -> np.ndarray:
    """The same in float64, from one control point of each patch, ``(dim, patches)``."""
    camera = view.camera
    with np.errstate(invalid="ignore", over="ignore"):
        points = corners[:3] / (corners[3] if len(corners) == 4 else 1.0)
        ahead = -camera.world_to_eye[2, :3] @ (points - camera.eye[:, None])
    nearest = np.min(ahead, where=np.isfinite(ahead), initial=camera.far)
    return camera.eye - max(nearest, 0.0) * camera.world_to_eye[2, :3]
