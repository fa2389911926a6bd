"""How many triangles OpenGL's tessellator makes of a quad patch, with equal spacing.

Levels are whole numbers: ``inner`` along u and v, ``outer`` on the edges u=0, v=0, u=1, v=1. A patch with
an outer level of 0 is dropped. All six levels 1 give two triangles; otherwise an inner level of 1 acts as 2
(OpenGL 4.6 core, section 11.2.2.2). Inside lies a grid of inner_u - 2 by inner_v - 2 cells; a ring of triangles
joins its rim to the edges.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Int

HIGHEST_LEVEL = 64  # what OpenGL guarantees, and what drivers offer

Inner = Int[np.ndarray, "patches 2"]
Outer = Int[np.ndarray, "patches 4"]


def _effective(inner: Inner, outer: Outer) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(inner levels that act, whether a patch is a single quad, whether it is drawn)."""
    drawn = np.all(outer > 0, axis=1)
    single = drawn & np.all(inner <= 1, axis=1) & np.all(outer == 1, axis=1)
    return np.maximum(inner, 2), single, drawn


def triangle_counts(inner: Inner, outer: Outer) -> Int[np.ndarray, "patches"]:
    """Triangles of every patch.

    >>> inner, outer = np.array([[3, 3], [1, 1], [2, 2]]), np.array([[3, 3, 3, 3], [1, 1, 1, 1], [0, 2, 2, 2]])
    >>> triangle_counts(inner, outer).tolist()
    [18, 2, 0]
    """
    acting, single, drawn = _effective(inner, outer)
    core = 2 * (acting[:, 0] - 2) * (acting[:, 1] - 2)
    ring = outer.sum(axis=1) + 2 * (acting - 2).sum(axis=1)
    return np.where(drawn, np.where(single, 2, core + ring), 0)
