"""Levels lowered, in turns, as long as all triangles keep the tolerance (docs/certified.md, section 6).

What a ring needs depends on its patch's grid and on its own edge alone. So as long as no grid changes, all edges can be
lowered at once, and as long as no edge changes, all grids.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Int

from slefejax.predict.certificate import Certificate
from slefejax.predict.drawn.proved import acting, has_pieces, ring_errors
from slefejax.tessellator.levels import OWN_AXIS, pieces_along

_SMALLER = ((1, 0), (0, 1))  # cells less along u and v
_ALLOWED = 0.9  # stands for the error of a ring that is part of a grid: that is allowed, and no more is known
_FAR_TOO_LARGE = 1e6  # an error

Pairs = Int[np.ndarray, "patches 2"]
Numbers = Int[np.ndarray, "patches 4"]


def lowered_levels(
    certificate: Certificate, inner: Pairs, edges: Numbers, numbers: Numbers, rounds: int
) -> tuple[Pairs, Numbers]:
    """Inner and edge levels, no higher than those given, that are proved if those are.

    numbers : equal for shared edges
    rounds  : at most so many

    Patches that are drawn in pieces, and the edges of these, stay as they are.
    """
    seen = np.all(edges > 0, axis=1)
    whole = seen & np.all(pieces_along(inner, edges) == 1, axis=1)
    in_pieces = has_pieces(inner, edges)
    free = ~np.isin(numbers, numbers[seen & ~whole]) & whole[:, None]
    patches, sides = whole, free
    for _ in range(rounds):
        before = inner, edges
        edges = _lower_edges(certificate, inner, edges, numbers, sides, in_pieces)
        patches = whole & (patches | np.any(edges != before[1], axis=1))
        inner = _smaller_grids(certificate, inner, edges, patches, in_pieces)
        patches, lowered = np.any(inner != before[0], axis=1), edges != before[1]
        if not (patches.any() or lowered.any()):
            break
        sides = free & (lowered | np.isin(numbers, numbers[patches]))
    return inner, edges


def _lower_edges(
    certificate: Certificate,
    inner: Pairs,
    edges: Numbers,
    numbers: Numbers,
    sides: Bool[np.ndarray, "patches 4"],
    in_pieces: bool,
) -> Numbers:
    """The lowest levels of edges that were found to be allowed by all neighbours.

    How much the rings of a level err tells which one to look at next.
    """
    found = np.zeros(numbers.max() + 1, np.int64)
    np.maximum.at(found, numbers.ravel(), edges.ravel())
    failed, trial = np.where(np.isin(np.arange(len(found)), numbers[sides]), 0, found), found - 1
    while np.any(open_ones := (failed < trial) & (trial < found)):
        patch, side = np.nonzero(open_ones[numbers] & sides)
        number, error = numbers[patch, side], np.zeros(len(found))
        now, lower = (np.where(edges > 0, own[numbers], 0) for own in (found, np.where(open_ones, trial, found)))
        # which of the others will be lowered is not known yet: as long as one is cut, 1 acts as 2
        fits = acting(inner, now)[patch, OWN_AXIS[side]] == lower[patch, side]
        np.maximum.at(error, number[fits], _ALLOWED)
        own = patch[~fits], side[~fits]
        np.maximum.at(error, number[~fits], ring_errors(certificate, inner, lower, *own, in_pieces))
        fine = error <= 1.0
        found = np.where(open_ones & fine, trial, found)
        failed = np.where(open_ones & ~fine, trial, failed)
        guess = np.ceil(trial * np.sqrt(np.minimum(error, _FAR_TOO_LARGE))).astype(np.int64)
        trial = np.where(open_ones, np.maximum(guess, failed + 1), trial)
    return np.where(edges > 0, found[numbers], 0)


def _smaller_grids(
    certificate: Certificate, inner: Pairs, edges: Numbers, patches: Bool[np.ndarray, "patches"], in_pieces: bool
) -> Pairs:
    """A cell less along u or v for every patch that keeps the tolerance so."""
    for less in _SMALLER:
        trial = np.maximum(inner - np.array(less), 1)
        worth = patches & np.any(acting(trial, edges) != acting(inner, edges), axis=1)
        patch = np.flatnonzero(worth)
        fine = patch[certificate.grids_keep(patch, acting(trial[patch], edges[patch]), in_pieces)]
        own, side = np.nonzero(edges[fine] != acting(trial[fine], edges[fine])[:, OWN_AXIS])
        holds = np.ones(len(fine), bool)
        errors = ring_errors(certificate, trial, edges, fine[own], side, in_pieces)
        np.logical_and.at(holds, own, errors <= 1.0)
        inner = inner.copy()
        inner[fine[holds]] = trial[fine[holds]]
    return inner
