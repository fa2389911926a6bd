"""The error of what was drawn, against the exact surface (docs/math.md, 4).

Nothing here is shared with the prediction but the camera. Everything is computed in float64, whatever JAX's
settings are.
"""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from slefejax.arguments import Patches, check_concrete, check_patches, on_host
from slefejax.errors import InputError
from slefejax.geometry.evaluate import as_control, evaluate
from slefejax.geometry.normals import TangentNets, kind_of_normals, tangent_nets
from slefejax.geometry.tangents import unit_normals, with_normals
from slefejax.geometry.view import View
from slefejax.lanes import layout, loops, passes
from slefejax.measure.surface import of_patches, undivided

SLIPPED = 1 / 16  # pixels
_BESIDE = 1e-7  # of the domain


def pixel_error(
    patches: Patches,
    view: View,
    u: Float[np.ndarray, "height width"],
    v: Float[np.ndarray, "height width"],
    patch: Int[np.ndarray, "height width"],
    drawn: Float[np.ndarray, "height width 2"] | None = None,
) -> Float[np.ndarray, "height width"]:
    """The parametric error of every pixel: max(|dx|, |dy|) between P(p(u, v)) and where it was drawn ([YBP12], (1)).

    patches     : control points, ``(patches, du+1, dv+1, 3)`` or, rational, 4 at the end; or ``GregoryPatches``
    u, v, patch : what the renderer found at each pixel centre, row 0 at the bottom; patch -1 where nothing is
    drawn       : where it drew that point, in pixels from the pixel's centre; None: at the centre
    returns     : pixels, float64; NaN where nothing is, infinite where the exact point is not in front of the camera

    Colours in the pictures of [YBP12]: grey up to 0.1 pixel, blue up to 0.5, green up to 1, red above.
    """
    check_concrete("pixel_error", patches, view, u, v, patch, drawn)
    patches = check_patches(patches, gregory=True)
    rows, columns = np.nonzero(patch >= 0)
    error = np.full(patch.shape, np.nan)
    if rows.size:
        at = (rows, columns)
        place = np.stack([columns, rows], axis=1) + 0.5
        if drawn is not None:
            place += drawn[at]
        screen = surface_on_screen(patches, view, patch[at], u[at], v[at])
        distance = np.max(np.abs(screen[:, :2] - place), axis=1)
        error[at] = np.where(np.isnan(distance), np.inf, distance)
    return error


def drawn_error(patches: Patches, view: View, seen: Any) -> Float[np.ndarray, "height width"]:
    """``pixel_error`` of what was drawn, and where: the error of its triangles, whatever the driver did beside it.

    seen : a ``slefejax.gpu.GBuffer``, or anything with ``.u``, ``.v`` and ``.patch``, and ``.drawn`` unless every pixel
           shows what was drawn at its centre

    From the pixel's centre the exact point is no further than ``drawn_error`` and ``slip`` together.
    """
    return pixel_error(patches, view, seen.u, seen.v, seen.patch, getattr(seen, "drawn", None))


def slip(seen: Any) -> Float[np.ndarray, "height width"]:
    """How far from its centre a pixel's point was drawn: max(|dx|, |dy|) in pixels, NaN where nothing is.

    seen : with ``.patch`` and ``.drawn``, such as a ``slefejax.gpu.GBuffer``

    That is the driver's doing. Float32 makes it some ten thousandths of a pixel; it is more in triangles that are seen
    edge on, thinner than the grid that drivers snap corners to. A pixel whose slip is above ``SLIPPED`` has slipped.

    >>> from types import SimpleNamespace
    >>> seen = SimpleNamespace(patch=np.array([[0, -1]]), drawn=np.array([[[0.25, 0.0], [9.0, 9.0]]]))
    >>> slip(seen).tolist()
    [[0.25, nan]]
    """
    return np.where(seen.patch >= 0, np.max(np.abs(seen.drawn), axis=-1).astype(np.float64), np.nan)


def normal_error(
    patches: Patches, view: View, seen: Any, normals: str = "surface", tangents: Any = None
) -> Float[np.ndarray, "height width"]:
    """The angle between the drawn normal of every pixel and the exact one at (patch, u, v), in degrees, float64.

    patches  : as ``pixel_error`` takes them
    view     : whose picture it is
    seen     : a ``slefejax.gpu.GBuffer`` of a ``Renderer(..., normals=True)``, or anything with ``.u``, ``.v``,
               ``.patch`` and ``.normal``
    normals  : which are exact: ``"surface"``, p_u x p_v, or ``"tangents"``, the cross product of tangent patches
    tangents : these, as ``Renderer`` takes them
    returns  : 0 to 180, whatever side is seen; NaN where nothing is, where no normal was drawn, and where tangents span
               no plane

    Raises InputError for a picture without normals, or of another size, and for tangents as ``Renderer`` does.
    """
    check_concrete("normal_error", patches, view, seen.u, seen.v, seen.patch, tangents)
    if getattr(seen, "normal", None) is None:
        raise InputError("the picture has no normals: draw it with Renderer(patches, normals=True)")
    if seen.patch.shape != (view.height, view.width):
        raise InputError(f"a picture of {view.height} rows and {view.width} columns is needed, not {seen.patch.shape}")
    at = np.nonzero(seen.patch >= 0)
    error = np.full(seen.patch.shape, np.nan)
    exact, drawn = exact_normals(patches, seen, normals, tangents)[at], seen.normal[at].astype(np.float64)
    sine = np.linalg.norm(np.cross(exact, drawn), axis=1)
    error[at] = np.rad2deg(np.arctan2(sine, np.sum(exact * drawn, axis=1)))
    return error


def exact_normals(
    patches: Patches, seen: Any, normals: str = "surface", tangents: Any = None
) -> Float[np.ndarray, "height width 3"]:
    """The exact unit normal at the (patch, u, v) of every pixel, in the scene's axes, float64.

    patches, normals, tangents : as ``normal_error`` takes them
    seen                       : a ``slefejax.gpu.GBuffer``, or anything with ``.u``, ``.v`` and ``.patch``
    returns                    : along p_u x p_v whatever side is seen; NaN where nothing is, and where tangents span no
                                 plane

    Raises InputError for patch numbers that are not there, and for tangents as ``normal_error`` does.

    >>> from types import SimpleNamespace
    >>> square = np.array([[[[0.0, 0.0, 0.0], [0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0], [1.0, 1.0, 0.0]]]])
    >>> half = np.full((1, 2), 0.5)
    >>> exact_normals(square, SimpleNamespace(u=half, v=half, patch=np.array([[0, -1]]))).tolist()
    [[[0.0, 0.0, 1.0], [nan, nan, nan]]]
    """
    check_concrete("exact_normals", patches, seen.u, seen.v, seen.patch, tangents)
    own: Any = on_host(check_patches(patches, gregory=True))
    nets = tangent_nets(own, kind_of_normals(normals), tangents)
    at = np.nonzero(seen.patch >= 0)
    found = np.full((*seen.patch.shape, 3), np.nan)
    if at[0].size:
        control = as_control(own) if nets is None else nets
        exact = _normals(control, len(own), seen.patch[at], seen.u[at], seen.v[at])
        found[at] = np.where(np.any(exact != 0, axis=1, keepdims=True), exact, np.nan)
    return found


def _normals(
    control: Any,
    count: int,
    patch: Int[np.ndarray, "points"],
    u: Float[np.ndarray, "points"],
    v: Float[np.ndarray, "points"],
) -> Float[np.ndarray, "points 3"]:
    """Unit normals of so many patches, or of tangent patches, at points; float64, 0 where there is no tangent plane.

    On sides, which may be points, they are those of a float32's rounding further in: as good as their limits.
    """
    _check_numbers(count, patch)
    u, v = (np.clip(np.asarray(x, np.float64), _BESIDE, 1.0 - _BESIDE) for x in (u, v))
    with jax.enable_x64(True):
        control = jax.tree.map(lambda x: np.moveaxis(np.asarray(x, np.float64), 0, -1), control)
        samples = np.column_stack([u, v, patch])
        return layout.through(lambda packed: _evaluate_normals(packed, control), samples)


def surface_on_screen(
    patches: Any,
    view: View,
    patch: Int[np.ndarray, "points"],
    u: Float[np.ndarray, "points"],
    v: Float[np.ndarray, "points"],
) -> Float[np.ndarray, "points 3"]:
    """P(p(u, v)): screen position in pixels and window depth of points of patches, float64.

    NaN for a point that is not in front of the camera (W <= 0). Raises InputError for a patch number that is not there.
    """
    _check_numbers(len(patches), patch)
    with jax.enable_x64(True):
        control = undivided(patches, view)
        samples = np.column_stack([u, v, patch]).astype(np.float64)
        return layout.through(lambda packed: _evaluate(packed, control), samples)


def _check_numbers(count: int, patch: Int[np.ndarray, "points"]) -> None:
    if patch.size and not (patch.min() >= 0 and patch.max() < count):
        raise InputError(f"patch numbers must be from 0 to {count - 1}, not {patch.min()} to {patch.max()}")


@passes.as_pass()
def _evaluate_normals(samples: Float[Any, "chunks 3 lanes"], control: Any) -> Any:
    def normals(chunk: Any) -> Any:
        own = of_patches(control, chunk[2].astype(jnp.int32))
        if isinstance(own, TangentNets):
            return unit_normals(*(evaluate(net, chunk[0], chunk[1]) for net in own))
        return with_normals(own, chunk[0], chunk[1])[1]

    return loops.over_chunks(normals, samples)


@passes.as_pass()
def _evaluate(samples: Float[Any, "chunks 3 lanes"], control: Any) -> Any:
    def positions(chunk: Any) -> Any:
        own = of_patches(control, chunk[2].astype(jnp.int32))
        point = evaluate(own, chunk[0], chunk[1])
        return jnp.where(point[3] > 0, point[:3] / point[3], jnp.nan)

    return loops.over_chunks(positions, samples)
