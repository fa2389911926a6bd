"""Minimal factors: the smallest whole number of pieces that keeps the tolerance (docs/math.md, 4).

The error need not fall from one factor to the next, so a bisection could miss the smallest one. Every factor is
therefore tried, from 1 upwards, but nearly all are ruled out cheaply: the places where a patch's error was largest at
other factors are witnesses, and a factor at which the cells around them err by more than the tolerance is too small.
Only a factor that all witnesses allow is measured over the whole domain; if it fails there, its worst points become
witnesses too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Int

from slefejax.arguments import Number, Patches, check_concrete, check_patches, check_positive, is_whole, on_host
from slefejax.errors import InputError
from slefejax.geometry.view import View
from slefejax.measure.supremum import Surface, in_batches, worst_points
from slefejax.tessellator.levels import MOST_LEVEL

_FIRST = 12  # the factor whose worst points are the first witnesses, and at which a patch must be seen to count
_AHEAD = 32  # candidates that are tried against the witnesses at once
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
    >>> minimal_factors(parabola, View(camera, 300, 300), tolerance=2.1).tolist()         # 200 / (4 n^2) <= 2.1
    [5]
    """
    check_concrete("minimal_factors", patches, view)
    patches = check_patches(patches, gregory=True)
    check_positive("tolerance", tolerance)
    if not is_whole(limit, 1) or limit > MOST_LEVEL:
        raise InputError(f"the limit must be a whole number from 1 to {MOST_LEVEL}, not {limit!r}")
    diagonal = np.repeat(np.arange(1, limit + 1)[:, None], 2, axis=1)
    return _Search(on_host(patches), view, float(tolerance), diagonal).run(progress)[:, 0]


def minimal_pairs(
    patches: Patches,
    view: View,
    tolerance: Number = 0.5,
    *,
    limit: int = 512,
    progress: Progress | None = None,
) -> Int[np.ndarray, "patches 2"]:
    """The pair (n_u, n_v) of every patch with the fewest triangles whose sampled error is at most ``tolerance``.

    Arguments and errors as ``minimal_factors``; of pairs with equally many triangles the one nearest to a square.
    Returns ``(patches, 2)`` whole numbers, 0 for a patch of which nothing is visible. A pair is never more than the
    square of the minimal factor.

    >>> parabola = np.zeros((1, 3, 2, 3))
    >>> parabola[0, :, :, 0], parabola[0, 2, :, 1], parabola[0, :, 1, 2] = [[0], [50], [100]], 200, 1
    >>> from slefejax import Camera
    >>> camera = Camera.orthographic((50, 100, 5), (50, 100, 0), up=(0, 1, 0), height=300.0)
    >>> minimal_pairs(parabola, View(camera, 300, 300), tolerance=2.1).tolist()
    [[5, 1]]
    """
    square = minimal_factors(patches, view, tolerance, limit=limit)
    pairs = _by_triangles(int(square.max()))
    return _Search(on_host(check_patches(patches, gregory=True)), view, float(tolerance), pairs).run(progress)


def _by_triangles(largest: int) -> Int[np.ndarray, "pairs 2"]:
    """All pairs with a product of at most largest^2, the smallest first."""
    rows = []
    for n_u in range(1, largest * largest + 1):
        n_v = np.arange(1, largest * largest // n_u + 1)
        rows.append(np.column_stack([np.full(len(n_v), n_u), n_v]))
    pairs = np.concatenate(rows) if rows else np.ones((1, 2), np.int64)
    return pairs[np.lexsort((np.abs(pairs[:, 0] - pairs[:, 1]), pairs[:, 0] * pairs[:, 1]))]


class _Search:
    """All patches at once: each has a next candidate to try, in the order of the candidates, and its witnesses."""

    def __init__(self, patches: Any, view: View, tolerance: float, candidates: np.ndarray) -> None:
        self.patches, self.view, self.tolerance, self.candidates = patches, view, tolerance, candidates
        self.surface = Surface.of(patches, view)
        self.found = np.zeros((len(patches), 2), np.int64)
        self.next = np.zeros(len(patches), np.int64)
        self.witnesses = np.full((len(patches), _WITNESSES, 2), np.nan)
        self.known = np.zeros(len(patches), np.int64)  # witnesses that a patch has had
        first = worst_points(patches, np.full(len(patches), _FIRST), view)
        self.open = ~np.isnan(first.u)
        seen = np.flatnonzero(self.open)
        self._add_witnesses(seen, first.u[seen], first.v[seen])
        self._skip(seen)

    def run(self, progress: Progress | None) -> Int[np.ndarray, "patches 2"]:
        """Step until every patch is settled."""
        while self.open.any():
            self._step()
            if progress is not None:
                progress(int(np.count_nonzero(~self.open)))
        return self.found

    def _step(self) -> None:
        """Measure the next candidate of every open patch, then skip those that the witnesses rule out."""
        chosen = np.flatnonzero(self.open)
        self._check_limit(chosen)
        levels = self.candidates[self.next[chosen]]
        found = worst_points(self.patches[chosen], levels, self.view)
        # triangles that miss the screen have no error, but the patch is on it: they do not count as fine
        drawn = ~np.isnan(found.u)
        fine = drawn & (found.error <= self.tolerance)
        self.found[chosen[fine]] = levels[fine]
        self.open[chosen[fine]] = False
        bad = chosen[~fine]
        self._add_witnesses(chosen[~fine & drawn], found.u[~fine & drawn], found.v[~fine & drawn])
        self.next[bad] += 1
        self._skip(bad)

    def _add_witnesses(self, chosen: np.ndarray, u: np.ndarray, v: np.ndarray) -> None:
        self.witnesses[chosen, self.known[chosen] % _WITNESSES] = np.column_stack([u, v])
        self.known[chosen] += 1

    def _skip(self, chosen: np.ndarray) -> None:
        """Move on past all candidates at which a witness's cell errs too much."""
        while chosen.size:
            ahead = self.next[chosen][:, None] + np.arange(_AHEAD)
            past = ahead >= len(self.candidates)
            levels = self.candidates[np.minimum(ahead, len(self.candidates) - 1)]
            allowed = self._allowed(chosen, levels) | past
            stop = allowed.any(axis=1)
            self.next[chosen] += np.where(stop, np.argmax(allowed, axis=1), _AHEAD)
            chosen = chosen[~stop]

    def _allowed(self, chosen: np.ndarray, levels: np.ndarray) -> np.ndarray:
        """Whether no witness speaks against candidates: ``(chosen, ahead)`` for levels ``(chosen, ahead, 2)``."""
        shape = levels.shape[:2]
        there = ~np.isnan(self.witnesses[chosen, None, :, 0])
        row, column, which = np.nonzero(np.broadcast_to(there, (*shape, _WITNESSES)))
        place, own = self.witnesses[chosen][row, which], levels[row, column]
        cell = np.minimum(np.floor(place * own), own - 1)
        cells = np.stack([cell, cell + 1], axis=2) / own[:, :, None]
        whole = np.tile([0.0, 0.0, 1.0], (len(cells), 1))
        error = in_batches(self.surface, chosen[row], cells.reshape(-1, 4), whole)[0]
        worst = np.zeros(shape)
        np.maximum.at(worst, (row, column), error)
        return worst <= self.tolerance

    def _check_limit(self, chosen: np.ndarray) -> None:
        beyond = chosen[self.next[chosen] >= len(self.candidates)]
        if beyond.size:
            raise InputError(
                f"patch {beyond[0]} (counted from 0) needs a factor above {self.candidates[-1].max()} for"
                f" {self.tolerance:g} px: raise the limit or the tolerance (a patch that passes the camera's plane on"
                " the screen can never be right)"
            )
