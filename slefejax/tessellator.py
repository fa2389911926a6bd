"""How many triangles OpenGL's tessellator makes of a quad patch.

Levels: ``inner`` along u and v, ``outer`` on the edges u=0, v=0, u=1, v=1. A patch with an outer level of 0 is dropped.
Each level becomes a number of segments (``segments``); with equal spacing levels are whole numbers and that number
itself. All six of 1 give two triangles; otherwise an inner one of 1 acts as the next that there is (OpenGL 4.6 core,
sections 11.2.2 and 11.2.2.2). Inside lies a grid of inner_u - 2 by inner_v - 2 cells; a ring of triangles joins its rim
to the edges.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, Int, Real

from slefejax.errors import InputError

HIGHEST_LEVEL = 64  # what OpenGL guarantees, and what drivers offer
SPACINGS = ("equal", "fractional-even", "fractional-odd")

Inner = Int[np.ndarray, "patches 2"]
Outer = Int[np.ndarray, "patches 4"]


def check_spacing(spacing: str) -> None:
    """Raise InputError for a spacing that OpenGL does not have."""
    if spacing not in SPACINGS:
        raise InputError(f"there is no spacing {spacing!r}: choose one of {', '.join(SPACINGS)}")


def highest_level(spacing: str, limit: int = HIGHEST_LEVEL) -> int:
    """The highest level that acts: one less than the limit where segments are odd."""
    return limit - 1 if spacing == "fractional-odd" else limit


def segments(levels: Real[np.ndarray, "*shape"], spacing: str) -> Int[np.ndarray, "*shape"]:
    """Into how many pieces a level cuts: rounded up to a whole, an even or an odd number; 0 for 0.

    Fractional spacing cuts pieces of one width and two narrower ones, which grow with the level until they are as wide.

    >>> levels = np.array([0.0, 0.3, 1.0, 2.5, 3.2])
    >>> segments(levels, "fractional-even").tolist(), segments(levels, "fractional-odd").tolist()
    ([0, 2, 2, 4, 4], [0, 1, 1, 3, 5])
    """
    check_spacing(spacing)
    levels = np.asarray(levels, np.float64)
    if not np.all((levels >= 0) & (levels < 2**31)):
        raise InputError("levels must be numbers from 0 on that a tessellator could have")
    whole = np.ceil(levels).astype(np.int64)
    if spacing == "fractional-even":
        whole = np.maximum(whole + whole % 2, 2)
    elif spacing == "fractional-odd":
        whole = np.maximum(whole + (1 - whole % 2), 1)
    return np.where(levels > 0, whole, 0)


def widest_pieces(levels: Real[np.ndarray, "*shape"], spacing: str) -> Float[np.ndarray, "*shape"]:
    """The widest piece of a level, infinite for 0: with fractional spacing up to a third more than 1/level.

    OpenGL leaves it open; as Direct3D 11 has it, widths go in a straight line from one number of segments to the next.
    """
    n, levels = segments(levels, spacing), np.asarray(levels, np.float64)
    if spacing == "equal":
        return np.where(n > 0, 1.0 / np.maximum(n, 1), np.inf)
    low = np.maximum(n - 2, 1)
    share = np.clip((levels - low) / np.maximum(n - low, 1), 0.0, 1.0)
    return np.where(n > 0, (1.0 - share) / low + share / np.maximum(n, 1), np.inf)


def levels_for(factors: Real[np.ndarray, "*shape"], spacing: str) -> Real[np.ndarray, "*shape"]:
    """The lowest levels with which no piece is wider than 1/factor (``widest_pieces``); 0 for 0.

    >>> levels_for(np.array([0.0, 1.5, 2.0, 6.0]), "fractional-odd").tolist()
    [0.0, 2.0, 2.5, 6.166666666666667]
    """
    n, factors = segments(factors, spacing), np.asarray(factors, np.float64)
    if spacing == "equal":
        return n
    low = np.where(n > 2, n - 2, 1)
    share = (1.0 / low - 1.0 / np.maximum(factors, 1.0)) / (1.0 / low - 1.0 / np.maximum(n, 2))
    lowest = 2.0 if spacing == "fractional-even" else 1.0
    found = np.where(n > lowest, low + (n - low) * np.clip(share, 0.0, 1.0), lowest)
    return np.where(factors > 0, found, 0.0)


def _effective(inner: Inner, outer: Outer, spacing: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(inner levels that act, whether a patch is a single quad, whether it is drawn)."""
    drawn = np.all(outer > 0, axis=1)
    single = drawn & np.all(inner <= 1, axis=1) & np.all(outer == 1, axis=1)
    return np.maximum(inner, 3 if spacing == "fractional-odd" else 2), single, drawn


def triangle_counts(
    inner: Real[np.ndarray, "patches 2"], outer: Real[np.ndarray, "patches 4"], spacing: str = "equal"
) -> Int[np.ndarray, "patches"]:
    """Triangles of every patch.

    >>> inner, outer = np.array([[3, 3], [1, 1], [2, 2]]), np.array([[3, 3, 3, 3], [1, 1, 1, 1], [0, 2, 2, 2]])
    >>> triangle_counts(inner, outer).tolist()
    [18, 2, 0]
    """
    inner, outer = segments(inner, spacing), segments(outer, spacing)
    acting, single, drawn = _effective(inner, outer, spacing)
    core = 2 * (acting[:, 0] - 2) * (acting[:, 1] - 2)
    ring = outer.sum(axis=1) + 2 * (acting - 2).sum(axis=1)
    return np.where(drawn, np.where(single, 2, core + ring), 0)
