"""Normals as polynomials: what shaders pass on undivided, and what certificates bound (docs/certified.md, 11).

Of polynomial patches N = P_u x P_v, of bi-degree (2 du - 1, 2 dv - 1). Of rational ones, p = w P in homogeneous
coordinates, w p_u x p_v - w_v p_u x p - w_u p x p_v, which is w^3 P_u x P_v and of bi-degree (3 du - 2, 3 dv - 2). Of a
pair of tangent nets T_u x T_v.

Where a side is a point, N is 0 along it; divided by the distance from that side in the domain it is a polynomial again,
which has a direction there.
"""

from __future__ import annotations

from collections.abc import Callable
from math import comb
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Bool

from slefejax.arguments import Patches, check_choice, floating
from slefejax.errors import InputError
from slefejax.geometry.bezier import Values, derivative
from slefejax.geometry.gregory import GregoryPatches
from slefejax.geometry.view import LARGEST
from slefejax.lanes.nets import total

NORMALS = ("surface", "tangents")
"""Which normals are drawn: those of the surface, or of tangent patches beside it (docs/math.md, 4)."""
# Sides are points that are no longer than rounding makes them: of coordinates, and beside the patch nothing
_ROUNDED = 64.0  # eps of coordinates
_NOTHING = 1e-9, 4.0  # of the patch's size, or so many eps of it if that is more


def collapsed_sides(patches: Patches) -> Bool[Array | np.ndarray, "patches 4"]:
    """Which sides of patches are points: u=0, v=0, u=1, v=1, in OpenGL's order.

    Those whose control points are equal, but for rounding: by 64 eps of their coordinates at most, and by a billionth
    of the patch's size (in single precision by 4 eps of it).

    >>> fan = np.array([[[0, 0, 0], [0, 0, 0]], [[1, 0, 0], [0, 1, 0]]], float)
    >>> collapsed_sides(fan[None]).tolist()
    [[True, False, False, False]]
    """
    given = patches.net if isinstance(patches, GregoryPatches) else patches
    given = given if isinstance(given, Tracer) else np.asarray(given)
    xp = array_module(given)
    eps = float(xp.finfo(given.dtype).eps) if jnp.issubdtype(given.dtype, jnp.floating) else 0.0
    points = given[..., :3] / given[..., 3:] if given.shape[-1] == 4 else given
    sides = points[:, 0], points[:, :, 0], points[:, -1], points[:, :, -1]
    own = _extent(points.reshape(len(points), -1, 3)) * max(_NOTHING[0], _NOTHING[1] * eps)
    rounded = [_ROUNDED * eps * xp.abs(side).max(axis=(1, 2)) for side in sides]
    return xp.stack([_extent(side) <= xp.minimum(own, most) for side, most in zip(sides, rounded, strict=True)], axis=1)


def _extent(points: Values) -> Values:
    """The largest extent of points ``(patches, points, 3)`` along an axis."""
    return (points.max(axis=1) - points.min(axis=1)).max(axis=-1)


def with_points(control: Values, collapsed: Values) -> Values:
    """Patches whose sides that are points are exactly that.

    control   : ``(du+1, dv+1, 3 or 4, ...)``
    collapsed : four masks ``(...)``, of u=0, v=0, u=1, v=1

    >>> fan = np.array([[[0, 0, 0], [0, 0, 1e-17]], [[1, 0, 0], [0, 1, 0]]], float)[..., None]
    >>> with_points(fan, np.array([[True], [False], [False], [False]]))[0, 1].ravel().tolist()
    [0.0, 0.0, 0.0]
    """
    xp = array_module(control)
    for side, which in enumerate(collapsed):
        net = xp.moveaxis(control, side % 2, 0)
        net = net[::-1] if side > 1 else net
        first = net[:1, :1]
        if net.shape[2] == 4:
            # an own weight is kept as it is
            weights = net[:1, :, 3:]
            first = xp.concatenate([weights * (first[:, :, :3] / first[:, :, 3:]), weights], axis=2)
        net = xp.concatenate([xp.where(which, xp.broadcast_to(first, net[:1].shape), net[:1]), net[1:]])
        control = xp.moveaxis(net[::-1] if side > 1 else net, 0, side % 2)
    return control


def normal_net(control: Values) -> Values:
    """Coefficients ``(ku+1, kv+1, 3, ...)`` of the undivided normals of patches ``(du+1, dv+1, 3 or 4, ...)``.

    >>> square = np.array([[[0, 0, 0], [0, 1, 0]], [[2, 0, 0], [2, 1, 0]]], float)[..., None]
    >>> normal_net(square)[1, 1].ravel().tolist()
    [0.0, 0.0, 2.0]
    """
    if control.shape[2] == 4:
        return _bracket(control)
    return crossed(derivative(control), derivative(control.swapaxes(0, 1)).swapaxes(0, 1))


def crossed(one: Values, other: Values) -> Values:
    """Of two vector nets ``(..., ..., 3, ...)``: the net of their cross product, such as of tangent patches.

    >>> along_u, along_v = np.eye(3)[None, None, 0], np.stack([np.eye(3)[None, 1], 3.0 * np.eye(3)[None, 2]], axis=1)
    >>> crossed(along_u, along_v)[0].tolist()
    [[0.0, 0.0, 1.0], [0.0, -3.0, 0.0]]
    """
    return product(one, other, _cross)


def _bracket(control: Values) -> Values:
    """A patch is bilinear between four nets of one degree less: so is this between planes through three of them."""
    a, b, c, d = control[:-1, :-1], control[1:, :-1], control[:-1, 1:], control[1:, 1:]
    corners = [[_planes(a, b, c), _planes(a, d, c)], [_planes(a, b, d), _planes(c, b, d)]]
    scale = float((control.shape[0] - 1) * (control.shape[1] - 1))
    nu, nv = corners[0][0].shape[:2]
    parts = []
    for i, j in np.ndindex(2, 2):
        weights = _share(nu, i)[:, None] * _share(nv, j)
        parts.append(_into(corners[i][j] * _beside(weights, corners[i][j]), (nu + 1, nv + 1), (i, j)))
    return scale * total(parts)


def _share(count: int, late: int) -> np.ndarray:
    """Of coefficients of a curve that is multiplied with 1 - t, or t: what goes to the coefficient at ``late`` more."""
    k = np.arange(count)
    return (k + 1.0) / count if late else (count - k) / count


def _planes(a: Values, b: Values, c: Values) -> Values:
    """Normals of the planes through three points in homogeneous coordinates, the nets' products."""

    def line(p: Values, q: Values) -> Values:
        """Both halves of a line's coordinates."""
        moment = p[:, :, 3:] * q[:, :, :3] - q[:, :, 3:] * p[:, :, :3]
        return array_module(p, q).concatenate([_cross(p[:, :, :3], q[:, :, :3]), moment], axis=2)

    def plane(own: Values, r: Values) -> Values:
        return own[:, :, :3] * r[:, :, 3:] + _cross(own[:, :, 3:], r[:, :, :3])

    return product(product(a, b, line), c, plane)


def product(one: Values, other: Values, multiply: Callable[[Values, Values], Values]) -> Values:
    """Coefficients of a product of nets, whose degrees add up.

    multiply : bilinear, of one coefficient ``(1, 1, ...)`` of the first net and all of the second

    >>> ramp = np.array([0.0, 1.0]).reshape(2, 1)
    >>> product(ramp, ramp, lambda x, y: x * y).ravel().tolist()  # t^2
    [0.0, 0.0, 1.0]
    """
    one, other = (net * _beside(_binomials(net.shape), net) for net in (one, other))
    shape = tuple(n + m - 1 for n, m in zip(one.shape[:2], other.shape[:2], strict=True))
    found = None
    for i, j in np.ndindex(*one.shape[:2]):
        part = multiply(one[i : i + 1, j : j + 1], other)
        found = _into(part, shape, (i, j)) if found is None else _plus(found, part, (i, j))
    return found / _beside(_binomials(shape), found)


def _binomials(shape: tuple[int, ...]) -> np.ndarray:
    u, v = (np.array([comb(n - 1, k) for k in range(n)], np.float64) for n in shape[:2])
    return u[:, None] * v


def _beside(numbers: np.ndarray, net: Values) -> np.ndarray:
    """One number a coefficient, in the precision of a net."""
    return numbers.reshape(*numbers.shape, *[1] * (net.ndim - 2)).astype(net.dtype)


def array_module(*nets: Values) -> Any:
    """NumPy if all of these are its arrays, else JAX's.

    >>> array_module(np.zeros(3), jnp.zeros(3)) is jnp
    True
    """
    return np if all(isinstance(net, np.ndarray) for net in nets) else jnp


def _into(part: Values, shape: tuple[int, ...], at: tuple[int, int]) -> Values:
    """A net among zeros."""
    around = [(k, n - k - own) for k, n, own in zip(at, shape, part.shape[:2], strict=True)]
    return array_module(part).pad(part, [*around, *[(0, 0)] * (part.ndim - 2)])


def _plus(whole: Values, part: Values, at: tuple[int, int]) -> Values:
    """A net with another one added to a block of it."""
    block = tuple(slice(k, k + n) for k, n in zip(at, part.shape[:2], strict=True))
    if array_module(whole) is np:
        whole[block] += part
        return whole
    return jax.lax.dynamic_update_slice(whole, whole[block] + part, (*at, *[0] * (part.ndim - 2)))


def _cross(p: Values, q: Values) -> Values:
    """Of nets whose third axis has the coordinates."""
    (a, b, c), (x, y, z) = ([net[:, :, k] for k in range(3)] for net in (p, q))
    return array_module(p, q).stack([b * z - c * y, c * x - a * z, a * y - b * x], axis=2)


def without_collapsed(net: Values, collapsed: Any) -> Values:
    """Normals over the distance from sides that are points: nets of the same degrees.

    net       : ``(ku+1, kv+1, 3, ...)``
    collapsed : four masks ``(...)``, of u=0, v=0, u=1, v=1

    >>> ramp = np.array([0.0, 1.0]).reshape(2, 1, 1, 1) * np.ones((2, 1, 3, 1))
    >>> without_collapsed(ramp, np.array([[True], [False], [False], [False]])).ravel().tolist()  # t over t
    [1.0, 1.0, 1.0, 1.0, 1.0, 1.0]
    """
    xp = array_module(net)
    for side, which in enumerate(collapsed):
        axis = side % 2
        matrix = xp.asarray(_over_distance(net.shape[axis], side // 2), net.dtype)
        divided = xp.moveaxis(xp.tensordot(matrix, net, (1, axis), **({} if xp is np else _EXACT)), 0, axis)
        net = xp.where(which, divided, net)
    return net


_EXACT: dict[str, Any] = {"precision": jax.lax.Precision.HIGHEST}


def _over_distance(count: int, late: int) -> np.ndarray:
    """The matrix that divides polynomials that are 0 at t = 0 by t, or those 0 at 1 by 1 - t; of one degree."""
    degree = count - 1
    lower, raise_ = np.zeros((degree, count)), np.zeros((count, degree))
    for k in range(degree):
        lower[k, k + 1] = degree / (k + 1.0)
        raise_[k, k] += 1.0 - k / degree
        raise_[k + 1, k] += (k + 1.0) / degree
    matrix = raise_ @ lower
    return matrix[::-1, ::-1] if late else matrix


class TangentNets(NamedTuple):
    """Tangent patches, ``(patches, du, dv+1, 3)`` and ``(patches, du+1, dv, 3)``, or with axes in kernels' order."""

    along_u: Any
    along_v: Any


def kind_of_normals(normals: Any) -> str | None:
    """The name of what was asked for, None for no normals. Raises InputError for what there is not.

    >>> kind_of_normals(True), kind_of_normals("tangents"), kind_of_normals(False)
    ('surface', 'tangents', None)
    """
    if isinstance(normals, bool):
        return NORMALS[0] if normals else None
    check_choice("kind of normals", normals, NORMALS)
    return normals


def tangent_nets(patches: Any, normals: str | None, tangents: Any) -> TangentNets | None:
    """Tangent patches on the host, in their own precision; None for normals of another kind.

    patches  : whose they are, ``(patches, du+1, dv+1, 3)``, on the host
    tangents : along u ``(patches, du, dv+1, 3)`` and along v ``(patches, du+1, dv, 3)``, as of ``scene.tangents()``

    Raises InputError for tangents that are missing, not needed, of another shape or not finite, and for patches that
    are not polynomial Bézier patches.

    >>> flat = np.zeros((5, 4, 4, 3))
    >>> tangent_nets(flat, "tangents", (np.zeros((5, 3, 4, 3)), np.zeros((5, 3, 4, 3))))
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: tangents of patches (5, 4, 4, 3) must have shapes (5, 3, 4, 3) and (5, 4, 3, 3), not \
(5, 3, 4, 3) and (5, 3, 4, 3)
    """
    if normals != "tangents":
        if tangents is not None:
            raise InputError("tangents= is for normals='tangents': with others there is nothing to use them for")
        return None
    if not hasattr(patches, "ndim") or patches.shape[3] != 3:
        raise InputError(
            "normals='tangents' is for polynomial Bézier patches: rational and Gregory patches and nested nets have"
            " normals='surface' alone"
        )
    if tangents is None:
        raise InputError("normals='tangents' needs tangents=, a pair of nets such as scene.tangents() returns")
    return _checked(patches.shape, tangents)


def _checked(shape: tuple[int, ...], tangents: Any) -> TangentNets:
    count, nu, nv, _ = shape
    wanted = [(count, nu - 1, nv, 3), (count, nu, nv - 1, 3)]
    if not isinstance(tangents, (tuple, list)) or len(tangents) != 2:
        raise InputError("tangents must be a pair of nets, along u and along v, such as scene.tangents() returns")
    nets = [net if isinstance(net, Tracer) else np.asarray(net) for net in map(floating, tangents)]
    if [net.shape for net in nets] != wanted:
        raise InputError(
            f"tangents of patches {shape} must have shapes {wanted[0]} and {wanted[1]}, not"
            f" {' and '.join(str(net.shape) for net in nets)}"
        )
    known = [net for net in nets if not isinstance(net, Tracer)]
    small = [np.ones(count, bool)]
    small += [np.all(np.abs(net, dtype=np.float64) < LARGEST, axis=(1, 2, 3)) for net in known]
    bad = np.flatnonzero(~np.all(small, axis=0))
    if bad.size:
        raise InputError(f"patch {bad[0]} (counted from 0) has tangents that are not numbers below {LARGEST:g}")
    return TangentNets(*nets)


def still_sides(tangents: TangentNets) -> Bool[np.ndarray, "patches 4"]:
    """Along which sides u=0, v=0, u=1, v=1 the tangents in their direction are 0, as where a patch's side is a point.

    Or no longer than a billionth of the patch's longest (in single precision 4 eps of it).

    >>> along_u, along_v = np.ones((1, 1, 2, 3)), np.array([0.0, 1.0]).reshape(1, 2, 1, 1) * np.ones(3)
    >>> still_sides(TangentNets(along_u, along_v)).tolist()
    [[True, False, False, False]]
    """
    xp = array_module(*tangents)
    u, v = (xp.abs(net) for net in tangents)
    most = xp.maximum(*(net.max(axis=(1, 2, 3)) for net in (u, v)))
    eps = max(float(xp.finfo(net.dtype).eps) for net in tangents)
    sides = v[:, 0], u[:, :, 0], v[:, -1], u[:, :, -1]
    nothing = max(_NOTHING[0], _NOTHING[1] * eps) * most
    return xp.stack([side.max(axis=(1, 2)) <= nothing for side in sides], axis=1)


def with_still(tangents: Any, still: Values) -> tuple[Values, Values]:
    """Tangent nets ``(du, dv+1, 3, ...)`` and ``(du+1, dv, 3, ...)`` that are exactly 0 along sides where they are.

    still : four masks ``(...)``, of u=0, v=0, u=1, v=1

    >>> ones = np.ones((1, 2, 3, 1)), np.ones((2, 1, 3, 1))
    >>> with_still(ones, np.array([[True], [False], [False], [False]]))[1][:, 0, 0, 0].tolist()
    [0.0, 1.0]
    """
    along_u, along_v = tangents
    xp = array_module(along_u, along_v)

    def own(net: Values, early: Values, late: Values) -> Values:
        """Along the first axis."""
        ends = xp.where(early, xp.zeros_like(net[:1]), net[:1]), xp.where(late, xp.zeros_like(net[-1:]), net[-1:])
        return xp.concatenate([ends[0], net[1:-1], ends[1]]) if len(net) > 1 else net

    along_u = xp.moveaxis(own(xp.moveaxis(along_u, 1, 0), still[1], still[3]), 0, 1)
    return along_u, own(along_v, still[0], still[2])
