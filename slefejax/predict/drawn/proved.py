"""Levels are proved last: whatever was chosen, raised or cut, as it will be drawn (docs/certified.md, section 6)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax.errors import InputError
from slefejax.geometry.bezier import restrict
from slefejax.geometry.gregory import GregoryPatches
from slefejax.predict.certificate import Certificate
from slefejax.tessellator.direct3d11 import ONE
from slefejax.tessellator.levels import HIGHEST_LEVEL, MOST_LEVEL, OWN_AXIS, pieces_along, with_pieces
from slefejax.tessellator.rings import ringed_sides, with_better_rings

_TRIES = 4  # a cell more along u and v
_BLOCK = 2**14  # strips that are held at once

Pairs = Int[np.ndarray, "patches 2"]
Numbers = Int[np.ndarray, "patches 4"]


def proved_levels(
    certificate: Certificate, inner: Pairs, edges: Numbers, numbers: Numbers, known: Pairs | None = None
) -> tuple[Pairs, Numbers]:
    """These levels where they are proved, higher ones where they are not.

    inner, edges : what is to be drawn: 0 for unseen patches, edges equal where they are shared
    numbers      : equal for shared edges (``slefejax.tessellator.edges``)
    known        : grids that are proved already, as they are drawn in a picture without pieces

    A patch whose grid fails gets a few cells more, and then levels from which on all grids hold; a ring that fails more
    cells or more pieces of its edge, until it is part of the grid. Levels only grow, so this ends. Raises InputError,
    with the patch's number, where more than can be drawn would be needed.
    """
    known = np.zeros(inner.shape, np.int64) if known is None else known.copy()
    safe, tries = np.full(inner.shape, MOST_LEVEL), np.zeros(len(inner), np.int64)
    changed = np.all(edges > 0, axis=1)
    while changed.any():
        _check_drawable(inner, edges)
        before = inner, edges
        in_pieces = was_in_pieces = has_pieces(inner, edges)
        patch = np.flatnonzero(changed)
        grids = acting(inner[patch], edges[patch])
        asked = ~np.all(inner[patch] >= safe[patch], axis=1) & (in_pieces | np.any(grids != known[patch], axis=1))
        patch, grids = patch[asked], grids[asked]
        fine = certificate.grids_keep(patch, grids, in_pieces)
        if not in_pieces:
            known[patch[fine]] = grids[fine]
        if not fine.all():
            inner = _raised(certificate, inner, patch[~fine], grids[~fine], tries, safe)
            inner, edges = with_pieces(inner, edges, numbers)
        in_pieces |= has_pieces(inner, edges)
        patch, side = _ringed(inner, edges, changed)
        failing = ring_errors(certificate, inner, edges, patch, side, in_pieces) > 1.0
        inner, edges = with_better_rings(inner, edges, numbers, patch[failing], side[failing], certificate.pattern)
        changed = np.any(inner != before[0], axis=1) | np.any(edges != before[1], axis=1)
        if not was_in_pieces and has_pieces(inner, edges):
            changed = np.all(edges > 0, axis=1)  # vertices of all patches are placed otherwise
    return inner, edges


def _raised(
    certificate: Certificate, inner: Pairs, patch: np.ndarray, grids: Pairs, tries: np.ndarray, safe: Pairs
) -> Pairs:
    """More cells for patches whose grids fail; ``tries`` and ``safe`` are brought up to date."""
    inner = inner.copy()
    tries[patch] += 1
    often = (tries[patch] > _TRIES) | np.any(grids >= HIGHEST_LEVEL, axis=1)
    inner[patch] = np.maximum(inner[patch], grids + 1)
    last = patch[often]
    safe[last] = certificate.for_all_boxes(last, inner[last])
    inner[last] = np.maximum(inner[last], safe[last])
    return inner


def has_pieces(inner: Pairs, edges: Numbers) -> bool:
    """Whether a patch is drawn in pieces.

    >>> has_pieces(np.array([[65, 3]]), np.array([[3, 65, 3, 65]]))
    True
    """
    return bool(max(inner.max(), edges.max()) > HIGHEST_LEVEL)


def _ringed(inner: Pairs, edges: Numbers, changed: Bool[np.ndarray, "patches"]) -> tuple[np.ndarray, np.ndarray]:
    """Patches and sides where the grid and the edge have different levels."""
    patch, side = np.nonzero((edges != acting(inner, edges)[:, OWN_AXIS]) & changed[:, None])
    return patch, side


def acting(inner: Pairs, edges: Numbers) -> Pairs:
    """A level of 1 acts as 2 unless nothing of the patch is cut.

    >>> acting(np.array([[1, 3], [1, 1]]), np.array([[1, 1, 1, 1], [1, 1, 1, 1]])).tolist()
    [[2, 3], [1, 1]]
    """
    cut = np.any(inner > 1, axis=1) | np.any(edges > 1, axis=1)
    return np.where(cut[:, None], np.maximum(inner, 2), inner)


def ring_errors(
    certificate: Certificate, inner: Pairs, edges: Numbers, patch: np.ndarray, side: np.ndarray, in_pieces: bool
) -> Float[np.ndarray, "n"]:
    """At most how far rings that are no part of a grid err, over what is allowed; infinity where that is not known.

    Triangles of patches that are drawn whole are looked at one by one where the pattern tells them; others, and those
    near to the eye's plane, count as any triangle of their length.
    """
    errors = np.full(len(patch), np.inf)
    if certificate.pattern.known:
        own = np.flatnonzero(np.all(pieces_along(inner[patch], edges[patch]) == 1, axis=1))
        at = patch[own], side[own]
        errors[own] = certificate.ring_errors(*at, inner[at[0]], edges[at], in_pieces)
    own = np.flatnonzero(~np.isfinite(errors))
    errors[own[_lengths_keep(certificate, inner, edges, patch[own], side[own], in_pieces)]] = 1.0
    return errors


def _lengths_keep(
    certificate: Certificate, inner: Pairs, edges: Numbers, patch: np.ndarray, side: np.ndarray, in_pieces: bool
) -> Bool[np.ndarray, "n"]:
    _, n, m, along = ringed_sides(inner, edges, patch, side)
    reach = certificate.pattern.fine_reach if in_pieces else certificate.pattern.reach
    length = (reach[n, m] + 2.0 / ONE) / along  # a little more, for what single precision makes of them
    across = np.maximum(np.take_along_axis(inner[patch], 1 - OWN_AXIS[side][:, None], axis=1)[:, 0], 2)
    width = certificate.pattern.cells(across)
    holds = np.ones(len(patch), bool)
    for start in range(0, len(patch), _BLOCK):
        # one side after the other, so that all of a block are one call
        block = start + np.argsort(side[start : start + _BLOCK], kind="stable")
        own = patch[block], side[block], length[block], width[block]
        holds[block] = _positions_keep(certificate, *own)
        if certificate.normals is not None:
            strips_of = lambda nets, which, own=own: _along_sides(nets, own[1][which], own[3][which])  # noqa: E731
            given = own[0], OWN_AXIS[own[1]], *own[2:], certificate.scale, strips_of
            holds[block] &= certificate.normals.triangles_keep(*given)
    return holds


def _positions_keep(
    certificate: Certificate, patch: np.ndarray, side: np.ndarray, length: np.ndarray, width: np.ndarray
) -> Bool[np.ndarray, "n"]:
    """Whether triangles that long, in strips along sides, keep the tolerance."""
    patches, axis = certificate.patches[patch], OWN_AXIS[side]
    if isinstance(patches, GregoryPatches):
        return certificate.triangles_keep(patches, axis, length, width)
    return certificate.triangles_keep(_along_sides(patches, side, width), axis, length)


def _along_sides(nets: np.ndarray, side: np.ndarray, width: np.ndarray) -> np.ndarray:
    """Strips of nets, each along its side; sides are in order."""
    every = [np.flatnonzero(side == which) for which in range(4)]
    found = [strips(nets[own], which, width[own, None])[:, 0] for which, own in enumerate(every)]
    return np.concatenate(found)


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
