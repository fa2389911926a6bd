"""Levels for the triangles that a tessellator really makes of all patches together (docs/certified.md, section 6)."""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

from slefejax.predict.certificate import Certificate
from slefejax.predict.drawn.fewest import lowered_levels
from slefejax.predict.drawn.proved import proved_levels
from slefejax.predict.normals.shading import MOST
from slefejax.tessellator.edges import edge_maxima
from slefejax.tessellator.levels import HIGHEST_LEVEL, with_pieces

_HIGHEST_TRIED = 96  # of a level that 64 might do for
_FAR_TOO_LARGE = 1e6  # an error
_MORE = 3  # cells along one side that are tried at once, to save some along the other
_ROUNDS = 64

Pairs = Int[np.ndarray, "patches 2"]
Numbers = Int[np.ndarray, "patches 4"]


def drawn_levels(
    certificate: Certificate, numbers: Numbers, *, anisotropic: bool, fewest: bool
) -> tuple[Pairs, Numbers]:
    """Inner and outer levels, all of which keep the tolerance; 0 for unseen patches.

    numbers : equal for shared edges (``slefejax.tessellator.edges``)
    fewest  : levels are lowered as long as any can be, else once

    Every patch begins with the coarsest grid that was found, and every edge with the larger of its neighbours' levels;
    they are proved, and raised where they are not (``slefejax.predict.drawn.proved``).
    """
    grids = small_grids(certificate, anisotropic)
    inner, edges = proved_levels(certificate, *with_pieces(grids, edge_maxima(grids, numbers), numbers), numbers, grids)
    return lowered_levels(certificate, inner, edges, numbers, _ROUNDS if fewest else 2)


def small_grids(certificate: Certificate, anisotropic: bool) -> Pairs:
    """Levels along u and v of the grids with few cells that were found to keep the tolerance; 0 for unseen patches.

    anisotropic : they may differ
    """
    even = np.repeat(_coarsest(certificate)[:, None], 2, axis=1)
    return _narrowed(certificate, even) if anisotropic else even


def _coarsest(certificate: Certificate) -> Int[np.ndarray, "patches"]:
    """The same along u and v. How much a grid errs tells which one to look at next."""
    found = certificate.even.copy()
    failed, trial = np.zeros_like(found), np.minimum(found - 1, HIGHEST_LEVEL)
    # factors of normals may be three times as high as needed
    worth = found <= (_HIGHEST_TRIED if certificate.normals is None else MOST)
    while (own := np.flatnonzero(worth & (failed < trial) & (trial < found) & (trial <= HIGHEST_LEVEL))).size:
        error = certificate.grid_errors(own, np.repeat(trial[own, None], 2, axis=1))
        fine = error <= 1.0
        found[own[fine]], failed[own[~fine]] = trial[own[fine]], trial[own[~fine]]
        guess = np.ceil(trial[own] * np.sqrt(np.minimum(error, _FAR_TOO_LARGE)))
        trial[own] = np.maximum(guess.astype(np.int64), failed[own] + 1)
    return found


def _narrowed(certificate: Certificate, even: Pairs) -> Pairs:
    """Fewer cells: along v for as many along u as there are, and the reverse; then for some more along either side."""
    best = even.copy()
    every = np.flatnonzero(even[:, 0] > 2)  # 1 acts as 2
    for axis in (0, 1):
        found = _least(certificate, every, axis, even[every, 0], even[every, 0])
        best[every] = _fewer(best[every], found)
    for axis in (0, 1):
        patch, more = every, np.ones(len(every), np.int64)
        for _ in range(_ROUNDS):
            fixed = best[patch, axis] + more
            found = _least(certificate, patch, axis, fixed, (best[patch].prod(axis=1) - 1) // fixed)
            before = best[patch]
            best[patch] = _fewer(before, found)
            more = np.where(np.any(best[patch] != before, axis=1), 1, more + 1)
            patch, more = patch[more <= _MORE], more[more <= _MORE]
            if not patch.size:
                break
    return best


def _fewer(one: Pairs, other: Pairs) -> Pairs:
    """The pairs with fewer cells; none of 0."""
    better = np.all(other > 0, axis=1) & (other.prod(axis=1) < one.prod(axis=1))
    return np.where(better[:, None], other, one)


def _least(certificate: Certificate, patch: np.ndarray, axis: int, fixed: np.ndarray, highest: np.ndarray) -> Pairs:
    """Pairs with that many cells along an axis and the fewest across, up to some; 0 where these are too few.

    Found by halving: as if more cells were never worse.
    """

    def pair(across: np.ndarray) -> Pairs:
        return np.stack([fixed, across] if axis == 0 else [across, fixed], axis=1)

    def holds(across: np.ndarray, which: np.ndarray) -> np.ndarray:
        fine = np.zeros(len(patch), bool)
        own = np.flatnonzero(which)
        fine[own] = certificate.grids_keep(patch[own], pair(across)[own])
        return fine

    found = np.where(holds(highest, highest >= 2), highest, 0)
    failed = np.ones_like(found)
    while np.any(open_ones := found > failed + 1):
        middle = (found + failed) // 2
        fine = holds(middle, open_ones)
        found = np.where(open_ones & fine, middle, found)
        failed = np.where(open_ones & ~fine, middle, failed)
    return np.where((found > 0)[:, None], pair(found), 0)
