"""What factors have to keep, with witnesses: places that rule most of them out cheaply (docs/math.md, 4).

The places where a patch's error was largest at other factors are witnesses, and a factor at which the cells around them
err by more than the tolerance is too small.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from slefejax.geometry.view import View
from slefejax.measure.normals import shaded, without_normals
from slefejax.measure.supremum import Supremum, in_batches, worst_of
from slefejax.measure.surface import Surface

_WITNESSES = 8
_FIRST = 12  # the factor whose worst points are the first witnesses, and at which a patch must be seen to count
_NEARER = (1.0, 1e-2, 1e-4, 1e-6)  # next to a point without a normal what is wrong is a small part of a cell
_DEEP = 16  # zooms to where a normal vanishes, until it is closer than any factor would see


class Criterion:
    """A tolerance of one quantity, and the witnesses of every patch.

    needs, never : for a sentence about a patch that needs too much: what for, and which can never be right
    sides        : of the windows around witnesses that are looked at, in their cells
    seen         : ``(patches,)``, what counts
    """

    def __init__(
        self, surface: Surface, count: int, tolerance: float, needs: str, never: str, sides: tuple[float, ...] = (1.0,)
    ) -> None:
        self.surface, self.tolerance, self.needs, self.never, self.sides = surface, tolerance, needs, never, sides
        self._places = np.full((count, _WITNESSES, 2), np.nan)
        self._known = np.zeros(count, np.int64)  # witnesses that a patch has had
        first = self.worst(np.arange(count), np.full((count, 2), _FIRST))
        self.seen = ~np.isnan(first.u)
        self.remember(np.arange(count), first)

    @staticmethod
    def of_positions(patches: Any, view: View, pixels: float) -> Criterion:
        """Positions keep so many pixels."""
        never = "a patch that passes the camera's plane on the screen"
        return Criterion(Surface.of(patches, view), len(patches), pixels, f"{pixels:g} px", never)

    @staticmethod
    def of_normals(patches: Any, view: View, degrees: float, normals: str, tangents: Any) -> Criterion:
        """Normals keep so many degrees. Where one vanishes is a witness too: next to it hardly any factor will do."""
        surface, everyone = shaded(patches, view, normals, tangents), np.arange(len(patches))
        never = "a patch with a point that has no normal"
        found = Criterion(surface, len(patches), degrees, f"{degrees:g} degrees between normals", never, _NEARER)
        first = np.full((len(patches), 2), _FIRST)
        found.remember(everyone, worst_of(without_normals(surface), everyone, first, _DEEP))
        return found

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
