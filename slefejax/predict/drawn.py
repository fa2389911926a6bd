"""Levels for the triangles that a tessellator really makes of all patches together (docs/certified.md, section 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from slefejax.predict.certificate import Certificate
from slefejax.predict.fewest import fewest_triangles
from slefejax.predict.proved import proved_levels, strips
from slefejax.tessellator.levels import HIGHEST_LEVEL, OWN_AXIS, pieces_along
from slefejax.tessellator.rings import Pattern, safe_levels

_WORSE = 1.4  # pairs with at most so many times the fewest cells may be chosen
_AROUND = np.arange(-3, 4)  # levels along v around those that were swept, for every level along u
_CHOICES = 128
_RAISED = 4  # an isotropic patch chooses from so many levels from its own on, along u and along v
_BLOCK = 2**11  # patches whose strips are held at once

Pairs = Int[np.ndarray, "patches 2"]
Choices = Int[np.ndarray, "patches choices 2"]
Numbers = Int[np.ndarray, "patches 4"]


def drawn_levels(
    certificate: Certificate, inner: Pairs, numbers: Numbers, anisotropic: bool
) -> tuple[Pairs, Int[np.ndarray, "patches 4"]]:
    """Inner and outer levels with few triangles, all of which keep the tolerance; 0 for unseen patches.

    inner   : levels that are about enough, along u and v
    numbers : equal for shared edges (``slefejax.tessellator.edges``)

    The search begins with levels that no grid is too coarse for whatever the other level is, so that they can be raised
    until rings fit. Patches that have to be cut into pieces, their own level or an edge's being too high, stay so. What
    is found is proved in the end (``slefejax.predict.proved``).
    """
    return proved_levels(certificate, *_chosen(certificate, inner, numbers, anisotropic), numbers)


def _chosen(certificate: Certificate, inner: Pairs, numbers: Numbers, anisotropic: bool) -> tuple[Pairs, Numbers]:
    pattern = certificate.pattern
    plain = certificate.start(inner)
    choices = _that_keep(certificate, _unequal(certificate, inner) if anisotropic else _raised(inner), plain)
    strips = Strips.of(certificate, choices, widths=8 if anisotropic else 3)
    start, edges = safe_levels(plain, numbers, pattern, strips.longest)
    seen = np.all(start > 0, axis=1)
    whole = np.all(pieces_along(start, edges) == 1, axis=1)
    free = np.flatnonzero(seen & whole)
    if not free.size:
        return start, edges
    # an edge of a patch in pieces stays as it is, and the patches there
    fixed = np.isin(numbers, numbers[seen & ~whole])[free]
    finer = np.any(edges[free] > 1, axis=1) | np.any(start[free] > 1, axis=1)
    first = np.where(finer[:, None], np.maximum(start[free], 2), 1)
    choices = np.concatenate([first[:, None], choices[free]], axis=1)
    sets = _edge_sets(strips, pattern, choices, free)
    sets[fixed.any(axis=1), 1:] = 0
    sets[:, 0][fixed] = ~np.uint64(0)
    found, around = fewest_triangles(choices, sets, numbers[free])
    start[free] = found
    edges[free] = np.where(fixed, edges[free], around)
    return start, edges


def _that_keep(certificate: Certificate, choices: Choices, plain: Pairs) -> Choices:
    """Choices that keep the tolerance on their grids, as many as the patch with the most has, and what always does."""
    base = choices.max() + 1
    keys = ((np.arange(len(choices))[:, None] * base + choices[..., 0]) * base + choices[..., 1]).ravel()
    keys, inverse = np.unique(keys, return_inverse=True)
    fine = certificate.grids_keep(keys // base**2, np.stack([keys // base % base, keys % base], axis=1))
    fine = fine[inverse].reshape(choices.shape[:2]) & np.all(choices <= HIGHEST_LEVEL, axis=2)
    order = np.argsort(~fine, axis=1, kind="stable")[:, : fine.sum(axis=1).max()]
    choices = np.where(fine[:, :, None], choices, plain[:, None])
    return np.concatenate([plain[:, None], np.take_along_axis(choices, order[:, :, None], axis=1)], axis=1)


def _raised(inner: Pairs) -> Choices:
    """A few levels from each patch's own on."""
    more = np.stack(np.meshgrid(np.arange(_RAISED), np.arange(_RAISED), indexing="ij"), axis=-1).reshape(-1, 2)
    return _acting(np.minimum(inner[:, None] + more, np.maximum(inner, HIGHEST_LEVEL)[:, None]))


def _unequal(certificate: Certificate, inner: Pairs) -> Choices:
    """Pairs with few cells, around those that were swept."""
    every = np.concatenate([certificate.swept, inner[:, None]], axis=1)
    patch = np.broadcast_to(np.arange(len(every))[:, None], every.shape[:2])
    drawn = np.all((every > 0) & (every <= HIGHEST_LEVEL), axis=2)
    least = np.full((len(every), HIGHEST_LEVEL + 1), 2 * HIGHEST_LEVEL)
    np.minimum.at(least, (patch[drawn], every[drawn, 0]), every[drawn, 1])
    u = np.arange(HIGHEST_LEVEL + 1)[:, None]
    v = np.maximum(np.minimum.accumulate(least, axis=1)[:, :, None] + _AROUND, 1)
    cells = np.where((u > 0) & (v <= HIGHEST_LEVEL), u * v, np.inf).reshape(len(inner), -1)
    order = np.argsort(cells, axis=1, kind="stable")[:, :_CHOICES]
    few = np.take_along_axis(cells, order, axis=1)
    few = (few <= _WORSE * inner.prod(axis=1)[:, None]) & np.isfinite(few)
    pairs = np.stack([np.broadcast_to(u, v.shape[1:]).ravel()[order], _rows(v, order)], axis=2)
    return _acting(np.where(few[:, :, None], pairs, inner[:, None]))


def _rows(values: np.ndarray, order: np.ndarray) -> np.ndarray:
    return np.take_along_axis(values.reshape(len(values), -1), order, axis=1)


def _acting(levels: Choices) -> Choices:
    """A level of 1 acts as 2 unless both are 1."""
    return np.where(np.all(levels <= 1, axis=2, keepdims=True), levels, np.maximum(levels, 2))


def _edge_sets(strips: Strips, pattern: Pattern, choices: Choices, patch: Int[np.ndarray, "patches"]) -> np.ndarray:
    """Levels that the rings allow on every edge, for every choice (``slefejax.predict.fewest``)."""
    single = np.all(choices == 1, axis=2)
    sets = np.empty((*choices.shape[:2], 4), np.uint64)
    for side in range(4):
        across = np.maximum(choices[:, :, 1 - OWN_AXIS[side]], 2)
        longest = strips.longest(patch[:, None], np.asarray(side), across)
        sets[..., side] = pattern.edge_levels(np.maximum(choices[:, :, OWN_AXIS[side]], 2), longest)
        sets[..., side] = np.where(single, np.uint64(1), sets[..., side])
    return sets


@dataclass(frozen=True, eq=False)
class Strips:
    """How long triangles may be in the outermost rows of cells, along each side.

    across : levels across the side, ascending; the width of a row is that of the widest cell
    length : in the domain 0 ... 1, for each of these levels
    """

    across: Int[np.ndarray, "patches 4 widths"]
    length: Float[np.ndarray, "patches 4 widths"]

    @staticmethod
    def of(certificate: Certificate, choices: Choices, widths: int) -> Strips:
        """For a few widths between those of the choices. A strip is a patch of its own: others do not matter to it."""
        low, high = (np.maximum(x, 2) for x in (choices.min(axis=1), choices.max(axis=1)))
        steps = np.linspace(0.0, 1.0, widths)
        between = np.round(low[:, :, None] + (high - low)[:, :, None] * steps).astype(np.int64)
        across = between[:, 1 - OWN_AXIS]
        seen = np.flatnonzero(np.all(choices[:, 0] > 0, axis=1))
        length = np.zeros(across.shape)
        for at in range(0, len(seen), _BLOCK):
            own = seen[at : at + _BLOCK]
            cells = certificate.pattern.cells(across[own])
            nets = np.stack([strips(certificate.patches[own], side, cells[:, side]) for side in range(4)], axis=1)
            shortest, longest = 0.25 / high[own][:, OWN_AXIS], np.minimum(1.0, 4.0 / low[own][:, OWN_AXIS])
            each = [np.broadcast_to(x[..., None], length[own].shape) for x in (OWN_AXIS, shortest, longest)]
            found = certificate.longest(nets.reshape(-1, *nets.shape[3:]), *(x.ravel() for x in each))
            length[own] = found.reshape(-1, 4, widths)
        return Strips(across, length)

    def longest(self, patch: np.ndarray, side: np.ndarray, across: np.ndarray) -> Float[np.ndarray, "*shape"]:
        """For a level across: what holds for the next one that is not finer (``tessellator.rings.Longest``)."""
        place = (self.across[patch, side] <= across[..., None]).sum(axis=-1) - 1
        return self.length[patch, side, np.maximum(place, 0)] * (place >= 0)
