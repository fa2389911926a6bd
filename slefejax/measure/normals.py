"""The error of normals over the whole domain (docs/math.md, 4): what a renderer shades with, and the exact surface's.

A vertex has the undivided normal N, the rasteriser interpolates it linearly over the domain triangle, and a pixel shows
its direction. The error at (u, v) is the angle between that and N(u, v). It counts where positions do
(``measure.supremum``), and where N has a direction.

Of patches N = w^3 P_u x P_v, with tangents from the derivatives of the one evaluator; of tangent patches T_u x T_v.
Sides that are points are divided out, by the distance from them, so that N has a direction there too. Limits, there and
at the corners of Gregory patches, are taken a float32's rounding further in.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float

from slefejax.arguments import Patches, check_concrete, check_patches, on_host
from slefejax.geometry.evaluate import as_control
from slefejax.geometry.gregory import Twisted
from slefejax.geometry.normals import (
    collapsed_sides,
    kind_of_normals,
    still_sides,
    tangent_nets,
    with_points,
    with_still,
)
from slefejax.geometry.tangents import tangents as tangents_of
from slefejax.geometry.view import View, homogeneous
from slefejax.lanes.tuning import TUNING
from slefejax.measure.supremum import Supremum, level_pairs, worst_of
from slefejax.measure.surface import UNSEEN, Quantity, Surface, patches_last, visible
from slefejax.measure.triangles import worst_in_triangles

_INSIDE = 1e-7  # of the domain: nearer to a side nothing is evaluated
_FLAT = 1e-9  # sine of an angle between tangents: below, there is no normal

# A distance as quadratic coefficients, by whether the side at 0 and the one at 1 is a point: 1, 1 - t, t, t (1 - t).
_RAMPS = np.array([[[1.0, 1.0, 1.0], [1.0, 0.5, 0.0]], [[0.0, 0.5, 1.0], [0.0, 0.5, 0.0]]])


def sampled_normal_error(
    patches: Patches, factors: Any, view: View, normals: str = "surface", tangents: Any = None
) -> Float[np.ndarray, "patches"]:
    """The largest angle between interpolated and exact normals of every patch, cut uniformly, in degrees.

    patches  : control points ``(patches, du+1, dv+1, 3)``, or 4 at the end if rational; or ``GregoryPatches``
    factors  : as ``sampled_error`` takes them
    normals  : "surface", P_u x P_v; or "tangents", T_u x T_v
    tangents : for the latter, ``(patches, 3, 4, 3)`` along u and ``(patches, 4, 3, 3)`` along v (``Scene.tangents``)
    returns  : ``(patches,)`` float64, over the visible domain and both diagonals, known as well as ``sampled_error``;
               0 where no normal is visible. Points without a normal do not count

    Raises InputError as ``sampled_error`` does, for normals of another kind, and for tangents that are missing.

    >>> roof = np.zeros((1, 3, 2, 3))
    >>> roof[0, :, :, 0], roof[0, :, 1, 1], roof[0, 1, :, 2] = [[-1], [0], [1]], 1, 1       # slopes 1 ... -1
    >>> from slefejax import Camera
    >>> view = View(Camera.orthographic((0, 0.5, 5), (0, 0.5, 0), up=(0, 1, 0), height=3.0), 300, 300)
    >>> sampled_normal_error(roof, [1], view).round(4).tolist()          # N is linear, and so is what is interpolated
    [0.0]
    """
    check_concrete("sampled_normal_error", patches, factors, view, tangents)
    return worst_normal_points(patches, factors, view, normals, tangents).error


def worst_normal_points(
    patches: Patches, factors: Any, view: View, normals: str = "surface", tangents: Any = None
) -> Supremum:
    """``sampled_normal_error`` and the parameters of the maxima. Arguments and errors as there."""
    check_concrete("worst_normal_points", patches, factors, view, tangents)
    given = check_patches(patches, gregory=True)
    levels = level_pairs(factors, len(given))
    return worst_of(shaded(given, view, normals, tangents), np.arange(len(given)), levels)


def triangle_normal_error(
    patches: Patches, triangles: Any, view: View, normals: str = "surface", tangents: Any = None
) -> Float[np.ndarray, "patches"]:
    """The same in degrees over the visible part of given triangles.

    triangles : as ``triangle_error`` takes them

    Everything else as ``sampled_normal_error``.
    """
    check_concrete("triangle_normal_error", patches, view, tangents)
    return worst_normal_triangle_points(patches, triangles, view, normals, tangents).error


def worst_normal_triangle_points(
    patches: Patches, triangles: Any, view: View, normals: str = "surface", tangents: Any = None
) -> Supremum:
    """``triangle_normal_error`` and the parameters of the maxima."""
    given = check_patches(patches, gregory=True)
    return worst_in_triangles(shaded(given, view, normals, tangents), triangles, len(given))


class _Shaded(NamedTuple):
    """Control points ``(..., patches)`` of what triangles interpolate.

    screen   : undivided screen coordinates
    shape    : what normals are made of, patches in space or a pair of tangent patches
    distance : the product of the distances from sides that are points, ``(3, 3, 1, patches)``
    """

    screen: Any
    shape: Any
    distance: Any


def shaded(patches: Any, view: View, normals: str = "surface", tangents: Any = None) -> Surface:
    """Patches in a view, of which normals are measured. Raises InputError as ``sampled_normal_error`` does."""
    there, given = Surface.of(patches, view), on_host(patches)
    nets = tangent_nets(given, kind_of_normals(normals), tangents)
    if nets is None:
        still, quantity = np.asarray(collapsed_sides(given)), _NORMAL
        shape = _of_one_size(_pointed(as_control(given), still))
    else:
        still, quantity = np.asarray(still_sides(nets)), _TANGENT
        along = with_still([np.moveaxis(own, 0, -1) for own in nets], still.T)
        shape = tuple(np.moveaxis(own, -1, 0) / _largest(np.moveaxis(own, -1, 0)) for own in along)
    control = _Shaded(there.control, *patches_last((shape, _distances(still))))
    return Surface(control, there.size, quantity)


def vanishing(surface: Surface) -> Surface:
    """The same patches; their worst points are where normals are smallest."""
    return surface._replace(quantity=surface.quantity._replace(error=_smallness))


def _pointed(control: Any, collapsed: np.ndarray) -> Any:
    """Patches whose sides that are points are exactly that."""
    net, twists = control if isinstance(control, Twisted) else (control, None)
    net = np.moveaxis(with_points(np.moveaxis(np.asarray(net, np.float64), 0, -1), collapsed.T), -1, 0)
    return net if twists is None else Twisted(net, twists)


def _of_one_size(control: Any) -> Any:
    """Patches moved and scaled to size 1, with weights up to 1, so that nothing is lost far away, nor overflows."""
    if isinstance(control, Twisted):
        net = np.asarray(control.net, np.float64)
        moved = net - net[:, :1, :1]
        size = _largest(moved)
        return Twisted(moved / size, np.asarray(control.twists, np.float64) / size[:, 0])
    control = np.asarray(control, np.float64)
    whole = homogeneous(control) / _largest(control[..., 3:] if control.shape[-1] == 4 else np.ones(len(control)))
    points = whole[..., :3] - whole[..., 3:] * (whole[:, :1, :1, :3] / whole[:, :1, :1, 3:])
    points = points / _largest(points)
    return np.concatenate([points, whole[..., 3:]], axis=-1) if control.shape[-1] == 4 else points


def _largest(values: np.ndarray) -> np.ndarray:
    """Of every patch the largest size of a number, beside its net; 1 if all are 0."""
    found = np.abs(values).reshape(len(values), -1).max(axis=1).reshape(-1, 1, 1, 1)
    return np.where(found > 0, found, 1.0)


def _distances(collapsed: Bool[np.ndarray, "patches 4"]) -> Float[np.ndarray, "patches 3 3 1"]:
    """Products of distances from sides that are points, as nets."""
    late = collapsed.astype(int)
    u, v = _RAMPS[late[:, 0], late[:, 2]], _RAMPS[late[:, 1], late[:, 3]]
    return (u[:, :, None] * v[:, None])[..., None]


def _rows(along: Callable[..., Any]) -> Callable[..., Any]:
    """What is interpolated: screen coordinates, N, and how large N would be if tangents were orthogonal."""

    def rows(control: _Shaded, u: Any, v: Any, evaluator: Callable[..., Any]) -> Any:
        inside = [jnp.clip(t, _INSIDE, 1.0 - _INSIDE) for t in (u, v)]
        along_u, along_v = along(control.shape, *inside, evaluator)
        vectors = jnp.concatenate([jnp.cross(along_u, along_v, axis=0), _length(along_u) * _length(along_v)])
        return jnp.concatenate([evaluator(control.screen, u, v), vectors / evaluator(control.distance, *inside)])

    return rows


def _of_surface(shape: Any, u: Any, v: Any, evaluator: Callable[..., Any]) -> tuple[Any, Any]:
    """P_u and P_v, of rational patches w^3 times as large in all."""
    _, along_u, along_v = tangents_of(shape, u, v, evaluator)
    if isinstance(shape, Twisted) or shape.shape[2] == 3:
        return along_u, along_v
    return evaluator(shape[:, :, 3:], u, v) ** 3 * along_u, along_v


def _of_tangents(shape: Any, u: Any, v: Any, evaluator: Callable[..., Any]) -> tuple[Any, Any]:
    along_u, along_v = shape
    return evaluator(along_u, u, v), evaluator(along_v, u, v)


def _length(vectors: Any) -> Any:
    return jnp.sqrt(jnp.sum(vectors**2, axis=0, keepdims=True))


def _turned(exact: Any, drawn: Any, size: Any) -> Any:
    """Degrees between normals; what is drawn without one is as wrong as can be."""
    wanted, found = exact[4:7], drawn[4:7]
    sine, cosine = _length(jnp.cross(wanted, found, axis=0))[0], jnp.sum(wanted * found, axis=0)
    angle = jnp.where(jnp.any(found != 0, axis=0), jnp.rad2deg(jnp.arctan2(sine, cosine)), 180.0)
    return jnp.where(visible(drawn[:4], size) & (_length(wanted)[0] > _FLAT * exact[7]), angle, UNSEEN)


def _smallness(exact: Any, drawn: Any, size: Any) -> Any:
    """One over the size of the exact normal."""
    return jnp.where(visible(drawn[:4], size), 1.0 / _length(exact[4:7])[0], UNSEEN)


_NORMAL = Quantity(_rows(_of_surface), _turned, TUNING.sampled)
_TANGENT = Quantity(_rows(_of_tangents), _turned, TUNING.sampled)
