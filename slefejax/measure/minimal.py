"""Minimal factors: the smallest whole number of pieces that keeps the tolerances (docs/math.md, 4).

The error need not fall from one factor to the next, so a bisection could miss the smallest one. Every factor is
therefore tried, from 1 upwards, but nearly all are ruled out by witnesses (``measure.witnesses``). Only a factor that
all of these allow is measured over the whole domain; if it fails there, its worst points become witnesses too.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Int

from slefejax.arguments import (
    Number,
    Patches,
    check_concrete,
    check_degrees,
    check_patches,
    check_positive,
    is_whole,
    on_host,
)
from slefejax.errors import InputError
from slefejax.geometry.normals import kind_of_normals
from slefejax.geometry.view import View
from slefejax.measure.normals import shaded
from slefejax.measure.supremum import Supremum
from slefejax.measure.surface import Surface
from slefejax.measure.witnesses import Criterion, NormalCriterion
from slefejax.tessellator.levels import MOST_LEVEL

_AHEAD = 32  # candidates that are tried against the witnesses at once

Progress = Callable[[int], None]


def minimal_factors(
    patches: Patches,
    view: View,
    tolerance: Number | None = 0.5,
    *,
    normal_tolerance: Number | None = None,
    normals: str = "surface",
    tangents: Any = None,
    limit: int = 4096,
    progress: Progress | None = None,
) -> Int[np.ndarray, "patches"]:
    """The smallest whole factor of every patch whose sampled errors are at most the tolerances.

    patches           : control points ``(patches, du+1, dv+1, 3)``, or 4 at the end if rational; or ``GregoryPatches``
    tolerance         : pixels; None: wherever points are drawn
    normal_tolerance  : degrees between interpolated and exact normals, less than 90; None: whatever they are
    normals, tangents : which normals, as of ``sampled_normal_error``
    limit             : the largest factor to try
    progress          : hears how many patches are settled
    returns           : ``(patches,)`` whole numbers, at least 1; 0 for a patch of which nothing is visible

    The errors are those of ``sampled_error`` and ``sampled_normal_error``: uniform, either diagonal, known to 1 %;
    where one is that close to its tolerance the factor may be one too small. Raises InputError for bad arguments, or
    for a patch that needs more than ``limit``.

    >>> parabola = np.zeros((1, 3, 2, 3))
    >>> parabola[0, :, :, 0], parabola[0, 2, :, 1], parabola[0, :, 1, 2] = [[0], [50], [100]], 200, 1
    >>> from slefejax import Camera
    >>> camera = Camera.orthographic((50, 100, 5), (50, 100, 0), up=(0, 1, 0), height=300.0)
    >>> minimal_factors(parabola, View(camera, 300, 300), tolerance=2.1).tolist()         # 200 / (4 n^2) <= 2.1
    [5]
    """
    check_concrete("minimal_factors", patches, view, tangents)
    if not is_whole(limit, 1) or limit > MOST_LEVEL:
        raise InputError(f"the limit must be a whole number from 1 to {MOST_LEVEL}, not {limit!r}")
    criteria = _criteria(patches, view, tolerance, normal_tolerance, normals, tangents)
    diagonal = np.repeat(np.arange(1, limit + 1)[:, None], 2, axis=1)
    return _Search(criteria, diagonal).run(progress)[:, 0]


def minimal_pairs(
    patches: Patches,
    view: View,
    tolerance: Number | None = 0.5,
    *,
    normal_tolerance: Number | None = None,
    normals: str = "surface",
    tangents: Any = None,
    limit: int = 512,
    progress: Progress | None = None,
) -> Int[np.ndarray, "patches 2"]:
    """The pair (n_u, n_v) of every patch with the fewest triangles whose sampled errors are at most the tolerances.

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
    kept = {"normal_tolerance": normal_tolerance, "normals": normals, "tangents": tangents}
    square = minimal_factors(patches, view, tolerance, limit=limit, **kept)
    pairs = _by_triangles(int(square.max()))
    return _Search(_criteria(patches, view, tolerance, **kept), pairs).run(progress)


def _criteria(
    patches: Any, view: View, tolerance: Any, normal_tolerance: Any, normals: str, tangents: Any
) -> list[Criterion]:
    """What is to be kept: positions, normals, or both."""
    given = on_host(check_patches(patches, gregory=True))
    kind_of_normals(normals)
    if tolerance is None and normal_tolerance is None:
        said = "a tolerance is needed: in pixels, normal_tolerance= in degrees, or both"
        raise InputError(said, options=("tolerance", "normal_tolerance"))
    if tolerance is not None:
        check_positive("tolerance", tolerance)
    if normal_tolerance is not None:
        check_degrees("normal_tolerance", normal_tolerance)
    found = [] if tolerance is None else [Criterion(Surface.of(given, view), len(given), float(tolerance))]
    if normal_tolerance is not None:
        surface = shaded(given, view, normals, tangents)
        found.append(NormalCriterion(surface, len(given), float(normal_tolerance)))
    return found


def _by_triangles(largest: int) -> Int[np.ndarray, "pairs 2"]:
    """All pairs with a product of at most largest^2, the smallest first."""
    rows = []
    for n_u in range(1, largest * largest + 1):
        n_v = np.arange(1, largest * largest // n_u + 1)
        rows.append(np.column_stack([np.full(len(n_v), n_u), n_v]))
    pairs = np.concatenate(rows) if rows else np.ones((1, 2), np.int64)
    return pairs[np.lexsort((np.abs(pairs[:, 0] - pairs[:, 1]), pairs[:, 0] * pairs[:, 1]))]


class _Search:
    """All patches at once: each has a next candidate to try, in the order of the candidates."""

    def __init__(self, criteria: list[Criterion], candidates: np.ndarray) -> None:
        self.criteria, self.candidates = criteria, candidates
        self.open = np.any([own.seen for own in criteria], axis=0)
        self.found = np.zeros((len(self.open), 2), np.int64)
        self.next = np.zeros(len(self.open), np.int64)
        self._skip(np.flatnonzero(self.open))

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
        fine = self._fine(chosen, levels)
        self.found[chosen[fine]] = levels[fine]
        self.open[chosen[fine]] = False
        bad = chosen[~fine]
        self.next[bad] += 1
        self._skip(bad)

    def _fine(self, chosen: np.ndarray, levels: np.ndarray) -> np.ndarray:
        """Which patches these levels are enough for; the worst points of others are witnesses."""
        fine, drawn = np.ones(len(chosen), bool), np.zeros(len(chosen), bool)
        for own in self.criteria:
            found = own.worst(chosen, levels)
            kept = found.error <= own.tolerance
            own.remember(chosen[~kept], Supremum(*(column[~kept] for column in found)))
            fine &= kept
            drawn |= ~np.isnan(found.u)
        # triangles that miss the screen have no error, but the patch is on it: they do not count as fine
        return fine & drawn

    def _skip(self, chosen: np.ndarray) -> None:
        """Move on past all candidates at which a witness's cell errs too much."""
        while chosen.size:
            ahead = self.next[chosen][:, None] + np.arange(_AHEAD)
            past = ahead >= len(self.candidates)
            levels = self.candidates[np.minimum(ahead, len(self.candidates) - 1)]
            allowed = np.all([own.allows(chosen, levels) for own in self.criteria], axis=0) | past
            stop = allowed.any(axis=1)
            self.next[chosen] += np.where(stop, np.argmax(allowed, axis=1), _AHEAD)
            chosen = chosen[~stop]

    def _check_limit(self, chosen: np.ndarray) -> None:
        beyond = chosen[self.next[chosen] >= len(self.candidates)]
        if beyond.size:
            needs = " and ".join(f"{own.tolerance:g} {own.unit}" for own in self.criteria)
            never = " or ".join(own.never for own in self.criteria)
            raise InputError(
                f"patch {beyond[0]} (counted from 0) needs a factor above {self.candidates[-1].max()} for {needs}:"
                f" raise the limit or the tolerance ({never} can never be right)"
            )
