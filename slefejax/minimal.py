"""Minimal factors: the smallest whole number of pieces that keeps the tolerance (MATH.md, section 4).

The error need not fall from one factor to the next, so a bisection could miss the smallest one. Every factor is
therefore tried, from 1 upwards, but nearly all are ruled out cheaply: the places where a patch's error was largest at
other factors are witnesses, and a factor at which the cells around them err by more than the tolerance is too small.
Only a factor that all witnesses allow is measured over the whole domain; if it fails there, its worst points become
witnesses too.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from jaxtyping import Int

from slefejax.arguments import Number, Patches, check_patches, check_positive, is_whole
from slefejax.errors import InputError
from slefejax.supremum import Surface, cell_errors, worst_points
from slefejax.view import View

_FIRST = 12  # the factor whose worst points are the first witnesses, and at which a patch must be seen to count
_AHEAD = 16  # factors that are tried against the witnesses at once
_WITNESSES = 8

Progress = Callable[[int], None]


def minimal_factors(
    patches: Patches,
    view: View,
    tolerance: Number = 0.5,
    *,
    limit: int = 4096,
    progress: Progress | None = None,
) -> Int[np.ndarray, "patches"]:
    """The smallest whole factor of every patch whose sampled error is at most ``tolerance`` pixels.

    patches   : control points ``(patches, du+1, dv+1, 3)``, or 4 at the end if rational
    tolerance : pixels
    limit     : the largest factor to try
    progress  : hears how many patches are settled
    returns   : ``(patches,)`` whole numbers, at least 1; 0 for a patch of which nothing is visible

    The error is that of ``sampled_error``: uniform, either diagonal, known to 1 %; where it is that close to the
    tolerance the factor may be one too small. Raises InputError for bad arguments, or for a patch that needs more than
    ``limit``.

    >>> parabola = np.zeros((1, 3, 2, 3))
    >>> parabola[0, :, :, 0], parabola[0, 2, :, 1], parabola[0, :, 1, 2] = [[0], [50], [100]], 200, 1
    >>> from slefejax import Camera
    >>> camera = Camera.orthographic((50, 100, 5), (50, 100, 0), up=(0, 1, 0), height=300.0)
    >>> minimal_factors(parabola, View(camera, 300, 300), tolerance=2.0).tolist()         # 200 / (4 n^2) <= 2
    [5]
    """
    patches = check_patches(patches)
    check_positive("tolerance", tolerance)
    if not is_whole(limit, 1):
        raise InputError(f"the limit must be a whole number of at least 1, not {limit!r}")
    search = _Search(np.asarray(patches), view, float(tolerance), limit)
    while search.open.any():
        search.step()
        if progress is not None:
            progress(int(np.count_nonzero(~search.open)))
    return search.factor


class _Search:
    """All patches at once: each has a next factor to try and its witnesses."""

    def __init__(self, patches: np.ndarray, view: View, tolerance: float, limit: int) -> None:
        self.patches, self.view, self.tolerance, self.limit = patches, view, tolerance, limit
        self.surface = Surface.of(patches, view)
        self.factor = np.zeros(len(patches), np.int64)
        self.next = np.ones(len(patches), np.int64)
        self.witnesses = np.full((len(patches), _WITNESSES, 2), np.nan)
        self.known = np.zeros(len(patches), np.int64)  # witnesses that a patch has had
        first = worst_points(patches, np.full(len(patches), _FIRST), view)
        self.open = ~np.isnan(first.u)
        seen = np.flatnonzero(self.open)
        self._add_witnesses(seen, first.u[seen], first.v[seen])
        self._skip(seen)

    def step(self) -> None:
        """Measure the next factor of every open patch, then skip those that the witnesses rule out."""
        chosen = np.flatnonzero(self.open)
        self._check_limit(chosen)
        found = worst_points(self.patches[chosen], self.next[chosen], self.view)
        # triangles that miss the screen have no error, but the patch is on it: they do not count as fine
        drawn = ~np.isnan(found.u)
        fine = drawn & (found.error <= self.tolerance)
        self.factor[chosen[fine]] = self.next[chosen[fine]]
        self.open[chosen[fine]] = False
        bad = chosen[~fine]
        self._add_witnesses(chosen[~fine & drawn], found.u[~fine & drawn], found.v[~fine & drawn])
        self.next[bad] += 1
        self._skip(bad)

    def _add_witnesses(self, chosen: np.ndarray, u: np.ndarray, v: np.ndarray) -> None:
        self.witnesses[chosen, self.known[chosen] % _WITNESSES] = np.column_stack([u, v])
        self.known[chosen] += 1

    def _skip(self, chosen: np.ndarray) -> None:
        """Move on past all factors at which a witness's cell errs too much."""
        while chosen.size:
            ahead = self.next[chosen][:, None] + np.arange(_AHEAD)
            allowed = self._allowed(chosen, ahead) | (ahead > self.limit)
            stop = allowed.any(axis=1)
            self.next[chosen] += np.where(stop, np.argmax(allowed, axis=1), _AHEAD)
            chosen = chosen[~stop]

    def _allowed(self, chosen: np.ndarray, factors: np.ndarray) -> np.ndarray:
        """Whether no witness speaks against these factors, ``(chosen, ahead)``."""
        there = ~np.isnan(self.witnesses[chosen, None, :, 0])
        row, column, which = np.nonzero(np.broadcast_to(there, (*factors.shape, _WITNESSES)))
        place = self.witnesses[chosen][row, which]
        levels = factors[row, column][:, None]
        cell = np.minimum(np.floor(place * levels), levels - 1)
        cells = np.column_stack([cell[:, 0], cell[:, 0] + 1, cell[:, 1], cell[:, 1] + 1]) / levels
        whole = np.tile([0.0, 0.0, 1.0], (len(cells), 1))
        error, _, _ = cell_errors(self.surface, chosen[row], cells, whole)
        worst = np.zeros(factors.shape)
        np.maximum.at(worst, (row, column), error)
        return worst <= self.tolerance

    def _check_limit(self, chosen: np.ndarray) -> None:
        beyond = chosen[self.next[chosen] > self.limit]
        if beyond.size:
            raise InputError(
                f"patch {beyond[0]} (counted from 0) needs a factor above {self.limit} for {self.tolerance:g} px: raise"
                " the limit or the tolerance (a patch that passes the camera's plane on the screen can never be right)"
            )
