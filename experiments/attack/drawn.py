"""The triangles that a tessellator makes for levels, judged."""

from __future__ import annotations

import numpy as np

from slefejax import triangulate
from slefejax.experiments.attack.judge.search import Found, Judged, judge_triangles
from slefejax.tessellator.levels import MOST_LEVEL, triangle_counts

_MOST = 200_000  # triangles of a view; patches beyond are left out, those with the most first


def triangles(inner: np.ndarray, outer: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(patch ``(triangles,)``, parameters ``(triangles, 3, 2)``) of patches with these levels."""
    made = triangulate(np.zeros((len(inner), 2, 2, 3)), (inner, outer))
    return made.patch[made.faces[:, 0]], made.parameters[made.faces]


def judged_levels(judged: Judged, inner: np.ndarray, edges: np.ndarray) -> tuple[Found, np.ndarray]:
    """The worst place of every patch, and which patches were looked at."""
    counts = triangle_counts(inner, edges)
    order = np.argsort(counts, kind="stable")
    drawn = np.zeros(len(counts), bool)
    drawn[order] = np.cumsum(counts[order]) <= _MOST
    drawn &= np.maximum(inner.max(axis=1), edges.max(axis=1)) <= MOST_LEVEL
    # what is said to be unseen is drawn too, coarsely
    own = [np.where((drawn & (counts == 0))[:, None], 1, np.where(drawn[:, None], x, 0)) for x in (inner, edges)]
    return judge_triangles(judged, *triangles(*own)), drawn
