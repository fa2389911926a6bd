"""Levels are proved last: whatever was chosen, raised or cut, as it will be drawn (docs/certified.md, section 6)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax.errors import InputError
from slefejax.geometry.bezier import restrict
from slefejax.predict.certificate import Certificate
from slefejax.tessellator.direct3d11 import ONE
from slefejax.tessellator.levels import MOST_LEVEL, OWN_AXIS, pieces_along, with_pieces
from slefejax.tessellator.rings import ringed_sides, with_better_rings

_BLOCK = 2**14  # strips that are held at once

Pairs = Int[np.ndarray, "patches 2"]
Numbers = Int[np.ndarray, "patches 4"]


def proved_levels(certificate: Certificate, inner: Pairs, edges: Numbers, numbers: Numbers) -> tuple[Pairs, Numbers]:
    """These levels where they are proved, higher ones where they are not.

    inner, edges : what is to be drawn: 0 for unseen patches, edges equal where they are shared
    numbers      : equal for shared edges (``slefejax.tessellator.edges``)

    A patch whose grid fails gets levels from which on all grids hold, a ring that fails more cells or more pieces of
    its edge, until it is part of the grid. Levels only grow, so this ends. Raises InputError, with the patch's number,
    where more than can be drawn would be needed.
    """
    safe = np.full(inner.shape, MOST_LEVEL)
    changed = np.all(edges > 0, axis=1)
    while changed.any():
        _check_drawable(inner, edges)
        before = inner, edges
        in_pieces = was_in_pieces = bool(np.any(pieces_along(inner, edges) > 1))
        patch = np.flatnonzero(changed)
        patch = patch[~np.all(inner[patch] >= safe[patch], axis=1)]
        wide = patch[~certificate.grids_keep(patch, acting(inner[patch], edges[patch]), in_pieces)]
        if wide.size:
            safe[wide] = certificate.for_all_boxes(wide, inner[wide])
            inner = inner.copy()
            inner[wide] = np.maximum(inner[wide], safe[wide])
            inner, edges = with_pieces(inner, edges, numbers)
        patch, side = np.nonzero(np.broadcast_to(changed[:, None], edges.shape))
        in_pieces |= bool(np.any(pieces_along(inner, edges) > 1))
        failing = ~_rings_keep(certificate, inner, edges, patch, side, in_pieces)
        inner, edges = with_better_rings(inner, edges, numbers, patch[failing], side[failing], certificate.pattern)
        changed = np.any(inner != before[0], axis=1) | np.any(edges != before[1], axis=1)
        if not was_in_pieces and np.any(pieces_along(inner, edges) > 1):
            changed = np.all(edges > 0, axis=1)  # vertices of all patches are placed otherwise
    return inner, edges


def acting(inner: Pairs, edges: Numbers) -> Pairs:
    """A level of 1 acts as 2 unless nothing of the patch is cut.

    >>> acting(np.array([[1, 3], [1, 1]]), np.array([[1, 1, 1, 1], [1, 1, 1, 1]])).tolist()
    [[2, 3], [1, 1]]
    """
    cut = np.any(inner > 1, axis=1) | np.any(edges > 1, axis=1)
    return np.where(cut[:, None], np.maximum(inner, 2), inner)


def _rings_keep(
    certificate: Certificate, inner: Pairs, edges: Numbers, patch: np.ndarray, side: np.ndarray, in_pieces: bool
) -> Bool[np.ndarray, "n"]:
    """Whether rings keep the tolerance: those that are part of the grid, and those whose triangles are short enough."""
    holds = np.ones(len(patch), bool)
    ringed, n, m, along = ringed_sides(inner, edges, patch, side)
    open_ones = np.flatnonzero(ringed & (n != m))
    reach = certificate.pattern.fine_reach if in_pieces else certificate.pattern.reach
    length = (reach[n, m] + 2.0 / ONE) / along  # a little more, for what single precision makes of them
    for start in range(0, len(open_ones), _BLOCK):
        # one side after the other, so that all of a block are one call
        block = open_ones[start : start + _BLOCK]
        by_side = [block[side[block] == which] for which in range(4)]
        nets = []
        for which, own in enumerate(by_side):
            across = np.maximum(inner[patch[own], 1 - OWN_AXIS[which]], 2)
            width = certificate.pattern.cells(across)[:, None]
            nets.append(strips(certificate.patches[patch[own]], which, width)[:, 0])
        own = np.concatenate(by_side)
        holds[own] = certificate.triangles_keep(np.concatenate(nets), OWN_AXIS[side[own]], length[own])
    return holds


def strips(
    patches: Float[np.ndarray, "n nu nv dim"], side: int, width: Float[np.ndarray, "n widths"]
) -> Float[np.ndarray, "n widths nu nv dim"]:
    """Control points of strips of patches along a side.

    >>> flat = np.arange(2.0).reshape(1, 2, 1, 1) * np.ones((1, 2, 2, 1))
    >>> strips(flat, 0, np.array([[0.25]]))[0, 0, :, 0, 0].tolist()  # along u = 0, a quarter wide
    [0.0, 0.25]
    """
    axis = 1 + side % 2
    nets = np.moveaxis(np.asarray(patches, np.float64)[:, None], (axis + 1, 0, 1), (0, -2, -1))
    start, end = (np.zeros_like(width), width) if side < 2 else (1.0 - width, np.ones_like(width))
    return np.moveaxis(restrict(nets, start, end), (0, -2, -1), (axis + 1, 0, 1))


def _check_drawable(inner: Pairs, edges: Numbers) -> None:
    highest = np.maximum(inner.max(axis=1), edges.max(axis=1))
    worst = int(np.argmax(highest))
    if highest[worst] > MOST_LEVEL:
        raise InputError(
            f"patch {worst} (counted from 0) needs a level of {highest[worst]}, and {MOST_LEVEL} is the most that can"
            " be drawn: move the camera away, shrink the picture or raise the tolerance"
        )
