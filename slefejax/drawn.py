"""Levels for the triangles that a tessellator really makes of all patches together (docs/certified.md, section 6)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float, Int

from slefejax.bezier import restrict
from slefejax.certificate import Certificate
from slefejax.fewest import fewest_triangles
from slefejax.rings import ALONG, Pattern, safe_levels
from slefejax.tessellator import HIGHEST_LEVEL

_WORSE = 1.4  # pairs with at most so many times the fewest cells may be chosen
_CHOICES = 64
_RAISED = 4  # an isotropic patch chooses from so many levels from its own on, along u and along v
_BLOCK = 2**12  # patches whose strips are held at once

Pairs = Int[np.ndarray, "patches 2"]
Choices = Int[np.ndarray, "patches choices 2"]
Numbers = Int[np.ndarray, "patches 4"]


def drawn_levels(
    certificate: Certificate, factors: Float[np.ndarray, "patches 2"], numbers: Numbers, anisotropic: bool
) -> tuple[Pairs, Int[np.ndarray, "patches 4"]]:
    """Inner and outer levels with few triangles, all of which keep the tolerance; 0 for unseen patches.

    factors : certified along u and v
    numbers : equal for shared edges (``slefejax.edges``)

    Where the highest level that can be drawn would not do, patches and their neighbours get what they need by
    themselves: nothing draws them so.
    """
    pattern = certificate.pattern
    inner = pattern.levels_for(factors)
    choices = _unequal(certificate, inner) if anisotropic else _raised(inner)
    strips = Strips.of(certificate, choices, widths=8 if anisotropic else 3)
    start, edges = safe_levels(inner, numbers, pattern, strips.longest)
    drawable = np.all((start > 0) & (start <= HIGHEST_LEVEL), axis=1)
    free = np.flatnonzero(drawable)
    if not free.size:
        return start, edges
    # an edge that a patch beyond the highest level needs finely stays so, and the patches there as they are
    fixed = np.isin(numbers, numbers[~drawable & (start[:, 0] > 0)])[free]
    split = np.any(edges[free] > 1, axis=1) | np.any(start[free] > 1, axis=1)
    first = np.where(split[:, None], np.maximum(start[free], 2), 1)
    choices = np.concatenate([first[:, None], choices[free]], axis=1)
    sets = _edge_sets(strips, pattern, choices, free)
    sets[fixed.any(axis=1), 1:] = 0
    sets[:, 0][fixed] = ~np.uint64(0)
    found, around = fewest_triangles(choices, sets, numbers[free])
    start[free] = found
    edges[free] = np.where(fixed, edges[free], around)
    return start, edges


def _raised(inner: Pairs) -> Choices:
    """A few levels from each patch's own on."""
    more = np.stack(np.meshgrid(np.arange(_RAISED), np.arange(_RAISED), indexing="ij"), axis=-1).reshape(-1, 2)
    return _acting(np.minimum(inner[:, None] + more, np.maximum(inner, HIGHEST_LEVEL)[:, None]))


def _unequal(certificate: Certificate, inner: Pairs) -> Choices:
    """Pairs with few cells that keep the tolerance."""
    u = np.arange(HIGHEST_LEVEL + 1)[:, None]
    v = certificate.smallest(inner)[:, :, None] + np.arange(_RAISED)
    cells = np.where((u > 0) & (v <= HIGHEST_LEVEL), u * v, np.inf).reshape(len(inner), -1)
    order = np.argsort(cells, axis=1, kind="stable")[:, :_CHOICES]
    few = np.take_along_axis(cells, order, axis=1)
    few = (few <= _WORSE * few[:, :1]) & np.isfinite(few)
    pairs = np.stack([np.broadcast_to(u, v.shape[1:]).ravel()[order], _rows(v, order)], axis=2)
    return _acting(np.where(few[:, :, None], pairs, inner[:, None]))


def _rows(values: np.ndarray, order: np.ndarray) -> np.ndarray:
    return np.take_along_axis(values.reshape(len(values), -1), order, axis=1)


def _acting(levels: Choices) -> Choices:
    """A level of 1 acts as 2 unless both are 1."""
    return np.where(np.all(levels <= 1, axis=2, keepdims=True), levels, np.maximum(levels, 2))


def _edge_sets(strips: Strips, pattern: Pattern, choices: Choices, patch: Int[np.ndarray, "patches"]) -> np.ndarray:
    """Levels that the rings allow on every edge, for every choice (``slefejax.fewest``)."""
    single = np.all(choices == 1, axis=2)
    sets = np.empty((*choices.shape[:2], 4), np.uint64)
    for side in range(4):
        across = np.maximum(choices[:, :, 1 - ALONG[side]], 2)
        longest = strips.longest(patch[:, None], np.asarray(side), across)
        sets[..., side] = pattern.edge_levels(np.maximum(choices[:, :, ALONG[side]], 2), longest)
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
        across = between[:, 1 - ALONG]
        seen = np.flatnonzero(np.all(choices[:, 0] > 0, axis=1))
        length = np.zeros(across.shape)
        for at in range(0, len(seen), _BLOCK):
            own = seen[at : at + _BLOCK]
            for side in range(4):
                along = ALONG[side]
                nets = _strips(certificate.patches[own], side, certificate.pattern.cells(across[own, side]))
                flat = nets.reshape(-1, *nets.shape[2:])
                shortest, longest = 0.25 / high[own, along], np.minimum(1.0, 4.0 / low[own, along])
                ends = [np.repeat(x, widths) for x in (shortest, longest)]
                found = certificate.longest(flat, np.full(len(flat), along), *ends)
                length[own, side] = found.reshape(-1, widths)
        return Strips(across, length)

    def longest(self, patch: np.ndarray, side: np.ndarray, across: np.ndarray) -> Float[np.ndarray, "*shape"]:
        """For a level across: what holds for the next one that is not finer (``slefejax.rings.Longest``)."""
        place = (self.across[patch, side] <= across[..., None]).sum(axis=-1) - 1
        return self.length[patch, side, np.maximum(place, 0)] * (place >= 0)


def _strips(
    patches: Float[np.ndarray, "n nu nv dim"], side: int, width: Float[np.ndarray, "n widths"]
) -> Float[np.ndarray, "n widths nu nv dim"]:
    """Control points of strips along a side."""
    axis = 1 + side % 2
    nets = np.moveaxis(np.asarray(patches, np.float64)[:, None], (axis + 1, 0, 1), (0, -2, -1))
    start, end = (np.zeros_like(width), width) if side < 2 else (1.0 - width, np.ones_like(width))
    return np.moveaxis(restrict(nets, start, end), (0, -2, -1), (axis + 1, 0, 1))
