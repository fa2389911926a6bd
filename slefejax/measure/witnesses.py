"""What factors have to keep, with witnesses: places that rule most of them out cheaply (docs/math.md, 4).

The places where a patch's error was largest at other factors are witnesses, and a factor at which the cells around them
err by more than the tolerance is too small.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Bool, Int

from slefejax.measure.normals import vanishing
from slefejax.measure.supremum import Supremum, in_batches, worst_of
from slefejax.measure.surface import Surface

_WITNESSES = 8
_FIRST = 12  # the factor whose worst points are the first witnesses, and at which a patch must be seen to count
_LATE = 64  # a factor from which on patches are suspected to be without a normal somewhere
_DEEP = 16  # zooms to where a normal vanishes, until it is closer than any factor would see


class Criterion:
    """A tolerance of positions, and the witnesses of every patch.

    unit  : of the tolerance
    never : which patches can never be right
    sides : of the windows around witnesses that are looked at, in their cells
    seen  : ``(patches,)``, what counts
    """

    unit = "px"
    never = "a patch that passes the camera's plane on the screen"
    sides: tuple[float, ...] = (1.0,)

    def __init__(self, surface: Surface, count: int, tolerance: float) -> None:
        self.surface, self.tolerance = surface, tolerance
        self._places = np.full((count, _WITNESSES, 2), np.nan)
        self._known = np.zeros(count, np.int64)  # witnesses that a patch has had
        first = self.worst(np.arange(count), np.full((count, 2), _FIRST))
        self.seen = ~np.isnan(first.u)
        self.remember(np.arange(count), first)

    def worst(self, chosen: Int[np.ndarray, "chosen"], levels: Int[np.ndarray, "chosen 2"]) -> Supremum:
        """The worst points of some patches at these levels."""
        return worst_of(self.surface, chosen, levels)

    def remember(self, chosen: Int[np.ndarray, "chosen"], found: Supremum) -> None:
        """Where something was found there are witnesses from now on; the oldest of a patch is forgotten."""
        there = ~np.isnan(found.u)
        own = chosen[there]
        self._places[own, self._known[own] % _WITNESSES] = np.column_stack([found.u[there], found.v[there]])
        self._known[own] += 1

    def allows(
        self, chosen: Int[np.ndarray, "chosen"], levels: Int[np.ndarray, "chosen ahead 2"]
    ) -> Bool[np.ndarray, "chosen ahead"]:
        """Whether no witness speaks against levels."""
        shape = levels.shape[:2]
        there = ~np.isnan(self._places[chosen, None, :, 0])
        row, column, which = np.nonzero(np.broadcast_to(there, (*shape, _WITNESSES)))
        place, own = self._places[chosen][row, which], levels[row, column]
        cell = np.minimum(np.floor(place * own), own - 1)
        cells = np.stack([cell, cell + 1], axis=2).reshape(-1, 4) / own[:, [0, 0, 1, 1]]
        allowed = np.ones(shape, bool)
        for side in self.sides:
            left = np.flatnonzero(allowed[row, column])
            if not left.size:
                break
            start = np.clip((place * own - cell)[left] - 0.5 * side, 0.0, 1.0 - side)
            windows = np.column_stack([start, np.full(len(left), side)])
            error = in_batches(self.surface, chosen[row[left]], cells[left], windows)[0]
            bad = left[error > self.tolerance]
            allowed[row[bad], column[bad]] = False
        return allowed


class NormalCriterion(Criterion):
    """A tolerance of normals. Next to a point that has none what is wrong is a small part of a cell."""

    unit = "degrees between normals"
    never = "a patch with a point that has no normal"
    sides = (1.0, 1e-2, 1e-4, 1e-6)

    def __init__(self, surface: Surface, count: int, tolerance: float) -> None:
        super().__init__(surface, count, tolerance)
        self._suspected = np.zeros(count, bool)

    def allows(
        self, chosen: Int[np.ndarray, "chosen"], levels: Int[np.ndarray, "chosen ahead 2"]
    ) -> Bool[np.ndarray, "chosen ahead"]:
        """The same; of patches that need many cells, where normals vanish is a witness too."""
        suspected = chosen[(levels.min(axis=2).max(axis=1) > _LATE) & ~self._suspected[chosen]]
        if suspected.size:
            self._suspected[suspected] = True
            first = np.full((len(suspected), 2), _FIRST)
            self.remember(suspected, worst_of(vanishing(self.surface), suspected, first, _DEEP))
        return super().allows(chosen, levels)
