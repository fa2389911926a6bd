"""The error of given domain triangles, such as those that the tessellator really makes: transition rings included.

As in ``measure.supremum``, but each triangle comes with the parameters of its own vertices, and its edges, corners and
inside are sampled by a lattice in barycentric coordinates. The largest samples are zoomed into as there.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from slefejax.arguments import Patches, check_concrete, check_patches, real_numbers, whole_numbers
from slefejax.errors import InputError
from slefejax.geometry.evaluate import evaluate
from slefejax.geometry.view import View
from slefejax.lanes import layout, loops, passes
from slefejax.measure.supremum import Supremum, largest_of_each
from slefejax.measure.surface import Quantity, Surface, of_patches

_LATTICE = 10  # intervals along each edge
_COARSEST = 1 / 6  # a triangle that is longer than this in the domain is cut before it is sampled
_KEPT = 6
_ZOOMS = 5
_BATCH = 2**16

Corners = Float[np.ndarray, "triangles 3 3"]


class DomainTriangles(NamedTuple):
    """Triangles in the domains of patches; ``slefejax.gpu.Triangles`` serves as well."""

    patch: Int[np.ndarray, "triangles"]
    parameters: Float[np.ndarray, "triangles 3 2"]  # (u, v) of each vertex


def triangle_error(patches: Patches, triangles: Any, view: View) -> Float[np.ndarray, "patches"]:
    """The largest error of every patch in pixels over the visible part of given triangles.

    patches   : control points ``(patches, du+1, dv+1, 3)``, or 4 at the end if rational; or ``GregoryPatches``
    triangles : what ``slefejax.triangulate`` or ``slefejax.gpu.Renderer.capture`` returns, or anything else with
                ``.patch`` ``(triangles,)`` and ``.parameters`` ``(triangles, 3, 2)``: a ``DomainTriangles``
    returns   : ``(patches,)`` float64, known as well as ``sampled_error``; 0 for a patch without a visible triangle

    Raises InputError for triangles of the wrong shape, or of patches that are not there.
    """
    check_concrete("triangle_error", patches, view)
    return worst_triangle_points(patches, triangles, view).error


def worst_triangle_points(patches: Patches, triangles: Any, view: View) -> Supremum:
    """``triangle_error`` and the parameters of the maxima."""
    given = check_patches(patches, gregory=True)
    return worst_in_triangles(Surface.of(given, view), triangles, len(given))


def worst_in_triangles(surface: Surface, triangles: Any, count: int) -> Supremum:
    """The worst points of triangles of so many patches."""
    patch, parameters = _checked(triangles, count)
    error, place = np.zeros(count), np.full((count, 2), np.nan)
    order = np.argsort(patch, kind="stable")
    for part in _whole_patches(patch[order]):
        chosen = order[part]
        _zoom_in(surface, patch[chosen], parameters[chosen], error, place)
    return Supremum(error, place[:, 0], place[:, 1])


def _checked(triangles: Any, count: int) -> tuple[np.ndarray, np.ndarray]:
    try:
        patch, parameters = triangles.patch, triangles.parameters
        if hasattr(triangles, "faces"):
            patch, parameters = patch[triangles.faces[:, 0]], parameters[triangles.faces]
    except AttributeError:
        raise InputError(
            f"triangles are what a draw captured, with patch and parameters, not {type(triangles).__name__}"
        ) from None
    patch, parameters = whole_numbers(patch, "patch numbers"), real_numbers(parameters, "parameters")
    if patch.ndim != 1 or parameters.shape != (len(patch), 3, 2):
        raise InputError(
            f"triangles need patch numbers (triangles,) and parameters (triangles, 3, 2), not {patch.shape} and"
            f" {parameters.shape}"
        )
    if len(patch) and not (patch.min() >= 0 and patch.max() < count):
        raise InputError(f"triangles name patches {patch.min()} to {patch.max()}, but there are {count}")
    if not (np.isfinite(parameters).all() and parameters.min(initial=0) >= 0 and parameters.max(initial=0) <= 1):
        raise InputError("the parameters of triangles must lie between 0 and 1")
    return patch, parameters


def _whole_patches(patch: np.ndarray) -> list[slice]:
    """Parts of sorted patch numbers with about _BATCH entries each, never dividing a patch."""
    cuts, start = [], 0
    while start < len(patch):
        end = min(start + _BATCH, len(patch))
        if end < len(patch):
            first = int(np.searchsorted(patch, patch[end]))
            end = first if first > start else int(np.searchsorted(patch, patch[end], side="right"))
        cuts.append(slice(start, end))
        start = end
    return cuts


def _zoom_in(surface: Surface, patch: np.ndarray, parameters: np.ndarray, error: np.ndarray, place: np.ndarray) -> None:
    """Write the largest errors of these triangles' patches, and their places, into ``error`` and ``place``."""
    index, corners = _cut_long_ones(parameters)
    found, best = _sample(surface, patch[index], parameters[index], corners)
    for _ in range(_ZOOMS):
        keep = largest_of_each(patch[index], found, _KEPT)
        index, corners, known, at = index[keep], corners[keep], found[keep], best[keep]
        corners = 0.5 * (corners + at[:, None])
        found, best = _sample(surface, patch[index], parameters[index], corners)
        better = found > known
        found, best = np.where(better, found, known), np.where(better[:, None], best, at)
    first = largest_of_each(patch[index], found, 1)
    first = first[found[first] >= 0]
    error[patch[index[first]]] = found[first]
    place[patch[index[first]]] = np.einsum("tk,tkc->tc", best[first], parameters[index[first]])


def _cut_long_ones(parameters: np.ndarray) -> tuple[np.ndarray, Corners]:
    """(index of the triangle, barycentric corners) of pieces: triangles that are long in the domain are quartered."""
    index, corners = np.arange(len(parameters)), np.broadcast_to(np.eye(3), (len(parameters), 3, 3))
    lengths = np.ptp(parameters, axis=1).max(axis=1, initial=0.0)
    while np.any(long := lengths > _COARSEST):
        a, b, c = np.moveaxis(corners[long], 1, 0)
        ab, bc, ca = (a + b) / 2, (b + c) / 2, (c + a) / 2
        quarters = [np.stack(t, axis=1) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab))]
        corners = np.concatenate([corners[~long], *quarters])
        index = np.concatenate([index[~long], *[index[long]] * 4])
        lengths = np.concatenate([lengths[~long], *[lengths[long] / 2] * 4])
    return index, corners


def _sample(
    surface: Surface, patch: np.ndarray, parameters: np.ndarray, corners: Corners
) -> tuple[np.ndarray, np.ndarray]:
    """Largest sampled error in a part of each triangle, and its barycentric place; -1 if nothing of it is seen."""
    if not len(patch):
        return np.zeros(0), np.zeros((0, 3))
    with jax.enable_x64(True):
        lanes = np.column_stack([patch, parameters.reshape(-1, 6), corners.reshape(-1, 9)])
        found = layout.through(lambda packed: _triangles_pass(packed, *surface), lanes, most=surface.quantity.lanes)
    return found[:, 0], found[:, 1:]


@passes.as_pass(3)
def _triangles_pass(packed: Any, control: Any, size: Any, quantity: Quantity) -> Any:
    return loops.over_chunks(partial(_triangle_kernel, quantity), packed, control, size)


_PLACES = np.array([(i, j, _LATTICE - i - j) for i in range(_LATTICE + 1) for j in range(_LATTICE + 1 - i)], np.float64)


def _triangle_kernel(quantity: Quantity, lanes: Any, control: Any, size: Any) -> Any:
    own = jax.tree.map(lambda x: x[..., None, :], of_patches(control, lanes[0].astype(jnp.int32)))
    u, v = lanes[1:7:2], lanes[2:7:2]  # (3, lanes) each
    part = lanes[7:16].reshape(3, 3, -1)
    shares = jnp.einsum("pk,kcl->pcl", jnp.asarray(_PLACES / _LATTICE), part)  # barycentric, (places, 3, lanes)
    exact = quantity.rows(own, *(jnp.sum(shares * t, axis=1) for t in (u, v)), evaluate)
    ends = quantity.rows(own, u, v, evaluate)  # (rows, 3, lanes)
    drawn = jnp.sum(shares * ends[:, None], axis=2)
    error = quantity.error(exact, drawn, size)
    at = jnp.argmax(error, axis=0)
    best = jnp.take_along_axis(shares, at[None, None], axis=0)[0]
    return jnp.concatenate([jnp.max(error, axis=0)[None], best])
