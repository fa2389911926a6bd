"""Pieces of patches that are off the screen, and need not be drawn."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from slefejax.geometry.bezier import restrict
from slefejax.geometry.gregory import GregoryPatches
from slefejax.geometry.view import homogeneous
from slefejax.tessellator.levels import Pieces

_ROUNDING = 1e-5  # of single precision on the device, in sizes of the terms that a position is summed from


def without_unseen(parts: Pieces, patches: Any, to_clip: Float[np.ndarray, "4 4"]) -> Pieces:
    """The pieces but those of cut patches whose control points are all outside of one plane of the view volume.

    patches : control points ``(patches, nu, nv, dim)`` as they are on the device, or ``GregoryPatches``
    to_clip : from these to clip space
    """
    cut = np.flatnonzero(np.any(parts.along > 1, axis=1))
    if not cut.size:
        return parts
    seen = np.ones(len(parts.patch), bool)
    own = parts.patch[cut]
    room = np.zeros((4, len(cut)))
    if isinstance(patches, GregoryPatches):
        # twist terms are at most half a twist
        room = 0.5 * np.abs(patches.twists[own].astype(np.float64) @ to_clip[:, :3].T).sum(axis=1).T
        patches = patches.net
    points = homogeneous(np.asarray(patches, np.float64))
    seen[cut] = _seen(points, own, parts.place[cut], parts.along[cut], to_clip, room)
    return Pieces(*(x[seen] for x in parts))


def _seen(
    points: np.ndarray, patch: np.ndarray, place: np.ndarray, count: np.ndarray, to_clip: np.ndarray, room: np.ndarray
) -> np.ndarray:
    clip = np.moveaxis((points @ to_clip.T)[patch], 0, -1)  # (du+1, dv+1, 4, pieces)
    size = np.moveaxis(np.abs(points).max(axis=(1, 2))[patch], 0, -1)
    error = _ROUNDING * (np.abs(to_clip) @ size) + room
    for axis in (0, 1):
        own = restrict(
            np.swapaxes(clip, 0, axis), place[:, axis] / count[:, axis], (place[:, axis] + 1) / count[:, axis]
        )
        clip = np.swapaxes(own, 0, axis)
    w, inside = clip[:, :, 3], np.ones(len(patch), bool)
    for a in range(3):
        for sign in (1.0, -1.0):
            reach = (w + sign * clip[:, :, a]).max(axis=(0, 1))
            inside &= reach >= -(error[3] + error[a])
    return inside
