"""Which normals are drawn: those of the surface, or of tangent patches beside it (docs/math.md, 4)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Bool

from slefejax.arguments import check_choice, floating
from slefejax.errors import InputError
from slefejax.geometry.view import LARGEST

NORMALS = ("surface", "tangents")
_STILL = 64.0  # eps of the patch's longest tangent: tangents along a side that are shorter are 0


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
    if not isinstance(patches, np.ndarray) or patches.shape[3] != 3:
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
    nets = [np.asarray(floating(net)) for net in tangents]
    if [net.shape for net in nets] != wanted:
        raise InputError(
            f"tangents of patches {shape} must have shapes {wanted[0]} and {wanted[1]}, not"
            f" {' and '.join(str(net.shape) for net in nets)}"
        )
    small = [np.all(np.abs(net) < LARGEST, axis=(1, 2, 3)) for net in nets]
    bad = np.flatnonzero(~np.all(small, axis=0))
    if bad.size:
        raise InputError(f"patch {bad[0]} (counted from 0) has tangents that are not numbers below {LARGEST:g}")
    return TangentNets(*nets)


def still_sides(tangents: TangentNets) -> Bool[np.ndarray, "patches 4"]:
    """Along which sides u=0, v=0, u=1, v=1 the tangents in their direction are 0, as where a patch's side is a point.

    >>> along_u, along_v = np.ones((1, 1, 2, 3)), np.array([0.0, 1.0]).reshape(1, 2, 1, 1) * np.ones(3)
    >>> still_sides(TangentNets(along_u, along_v)).tolist()
    [[True, False, False, False]]
    """
    u, v = (np.abs(net) for net in tangents)
    most = np.maximum(*(net.max(axis=(1, 2, 3)) for net in (u, v)))
    eps = max(np.finfo(net.dtype).eps for net in tangents)
    sides = v[:, 0], u[:, :, 0], v[:, -1], u[:, :, -1]
    return np.stack([side.max(axis=(1, 2)) <= _STILL * eps * most for side in sides], axis=1)
