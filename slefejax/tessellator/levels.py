"""How many triangles OpenGL's tessellator makes of a quad patch, and how patches are cut that need more than it can.

Levels: ``inner`` along u and v, ``outer`` on the edges u=0, v=0, u=1, v=1. A patch with an outer level of 0 is dropped.
Each level becomes a number of segments (``segments``); with equal spacing levels are whole numbers and that number
itself. All six of 1 give two triangles; otherwise an inner one of 1 acts as the next that there is (OpenGL [GL46],
sections 11.2.2 and 11.2.2.2). Inside lies a grid of inner_u - 2 by inner_v - 2 cells; a ring of triangles joins its rim
to the edges.

Past level 64 a patch is cut in its domain, along u into the smallest power of two of equal *pieces* with which the
inner level along u and the levels of the edges v=0 and v=1 are at most 64 a piece, along v likewise (docs/math.md,
3). Each piece is tessellated by itself, with the patch's levels over the number of pieces, so these have to be whole:
the levels along an axis are multiples of the number of pieces along it (``with_pieces`` sees to that). Vertices lie at
k/n of the whole patch's levels n, whatever the pieces: a neighbour that is cut otherwise, or not at all, has the same
ones along the shared edge.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int, Real

from slefejax.arguments import Numbers, check_choice, real_numbers
from slefejax.errors import InputError

HIGHEST_LEVEL = 64  # what OpenGL guarantees, and what drivers offer
MOST_LEVEL = 256 * HIGHEST_LEVEL  # that can be drawn, in pieces: vertices are placed with 24 bits
GRID = 2.0**-24  # places of vertices of patches in pieces are multiples of that
OWN_AXIS = np.array([1, 0, 1, 0])  # the axis along which the edges u=0, v=0, u=1, v=1 run
SPACINGS = ("equal", "fractional-even", "fractional-odd")

Inner = Int[np.ndarray, "patches 2"]
Outer = Int[np.ndarray, "patches 4"]


def check_spacing(spacing: str) -> None:
    """Raise InputError for a spacing that OpenGL does not have.

    >>> check_spacing("odd")
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: there is no spacing 'odd': choose one of equal, fractional-even, fractional-odd
    """
    check_choice("spacing", spacing, SPACINGS)


def highest_level(spacing: str, limit: int = HIGHEST_LEVEL) -> int:
    """The highest level that acts: one less than the limit where segments are odd.

    >>> highest_level("equal"), highest_level("fractional-odd")
    (64, 63)
    """
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

    >>> widest_pieces(np.array([0.0, 2.0, 4.0]), "equal").tolist()
    [inf, 0.5, 0.25]
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


def shares(index: Int[np.ndarray, "*#shape"], count: Int[np.ndarray, "*#shape"]) -> Int[np.ndarray, "*shape"]:
    """index/count in steps of ``GRID``, rounded: where vertices of patches in pieces are placed.

    Those of index and count - index add up to 1.

    >>> (shares(np.array([0, 1, 2]), np.array([2, 2, 2])) * GRID).tolist()
    [0.0, 0.5, 1.0]
    """
    low = np.minimum(index, count - index)
    steps = ((low << 24) + count // 2) // np.maximum(count, 1)
    return np.where(low == index, steps, (1 << 24) - steps)


def pieces(levels: Int[np.ndarray, "*shape"]) -> Int[np.ndarray, "*shape"]:
    """The smallest powers of two with levels of at most 64 a piece.

    >>> pieces(np.array([0, 64, 65, 128, 500])).tolist()
    [1, 1, 2, 2, 8]
    """
    above = (np.maximum(levels, 1) - 1) // HIGHEST_LEVEL
    return np.int64(1) << np.frexp(above)[1].astype(np.int64)


def pieces_along(inner: Inner, outer: Outer) -> Int[np.ndarray, "patches 2"]:
    """Into how many pieces patches are cut along u and v (module docstring); 1 for those that are not drawn.

    >>> pieces_along(np.array([[130, 10]]), np.array([[10, 130, 10, 130]])).tolist()
    [[4, 1]]
    """
    longest = np.stack([np.maximum(inner[:, a], outer[:, OWN_AXIS == a].max(axis=1)) for a in (0, 1)], axis=1)
    return np.where(np.all(outer > 0, axis=1)[:, None], pieces(longest), 1)


def with_pieces(inner: Inner, outer: Outer, numbers: Outer) -> tuple[Inner, Outer]:
    """Levels raised to multiples of the numbers of pieces; those of patches and edges up to 64 stay as they are.

    numbers : equal for shared edges (``tessellator.edges``), which stay equal: they get multiples of what the neighbour
              with more pieces needs

    >>> inner, outer = np.array([[130, 10], [20, 20]]), np.array([[10, 130, 20, 130], [20, 20, 20, 20]])
    >>> [x.tolist() for x in with_pieces(inner, outer, np.array([[0, 1, 2, 3], [2, 4, 5, 6]]))]
    [[[132, 10], [20, 20]], [[10, 132, 20, 132], [20, 20, 20, 20]]]
    """
    while True:
        along = pieces_along(inner, outer)
        if np.all(along == 1):
            return inner, outer
        # level 1 in a piece acts as 2 inside, and not on the edges between pieces
        cut = np.any(along > 1, axis=1) & (np.any(inner > along, axis=1) | np.any(outer > along[:, OWN_AXIS], axis=1))
        least = np.where(cut[:, None], 2 * along, 0)
        most = np.ones(numbers.max() + 1, np.int64)
        np.maximum.at(most, numbers.ravel(), along[:, OWN_AXIS].ravel())
        inner = -(-np.maximum(inner, least) // along) * along
        outer = -(-outer // most[numbers]) * most[numbers]
        # who meets a neighbour of more than 64 times as many pieces may need more of them
        if np.array_equal(along, pieces_along(inner, outer)):
            return inner, outer


class Pieces(NamedTuple):
    """What the tessellator is given: pieces of patches, patch after patch.

    patch : whose they are;  place, along : which piece along u and v, of how many;  inner, outer : their own levels

    >>> Pieces.of(np.array([[128, 8]]), np.array([[8, 128, 8, 128]])).inner.tolist()
    [[64, 8], [64, 8]]
    """

    patch: Int[np.ndarray, "pieces"]
    place: Int[np.ndarray, "pieces 2"]
    along: Int[np.ndarray, "pieces 2"]
    inner: Real[np.ndarray, "pieces 2"]
    outer: Real[np.ndarray, "pieces 4"]

    @staticmethod
    def of(
        inner: Real[np.ndarray, "patches 2"], outer: Real[np.ndarray, "patches 4"], spacing: str = "equal"
    ) -> Pieces:
        """With fractional spacing, whose vertices move, patches stay whole.

        Raises InputError for levels past 64 that are no multiples (``with_pieces`` makes them so).
        """
        if spacing != "equal":
            ones = np.ones((len(inner), 2), np.int64)
            return Pieces(np.arange(len(inner)), 0 * ones, ones, inner, outer)
        along = pieces_along(inner, outer)
        _check_multiples(inner, outer, along)
        total = along.prod(axis=1)
        patch = np.repeat(np.arange(len(inner)), total)
        index = np.arange(len(patch)) - np.repeat(np.cumsum(total) - total, total)
        count = along[patch]
        place = np.stack([index // count[:, 1], index % count[:, 1]], axis=1)
        own = inner[patch] // count
        # between pieces of a patch there is its own grid
        rim = np.concatenate([place == 0, place == count - 1], axis=1)
        return Pieces(patch, place, count, own, np.where(rim, outer[patch] // count[:, OWN_AXIS], own[:, OWN_AXIS]))


def _check_multiples(inner: Inner, outer: Outer, along: Int[np.ndarray, "patches 2"]) -> None:
    wrong = np.any(inner % along != 0, axis=1) | np.any(outer % along[:, OWN_AXIS] != 0, axis=1)
    wrong &= np.any(along > 1, axis=1)
    if wrong.any():
        worst = int(np.argmax(wrong))
        raise InputError(
            f"levels past {HIGHEST_LEVEL} are drawn in pieces: those of patch {worst} (counted from 0) must be"
            f" multiples of {along[worst, 0]} along u and of {along[worst, 1]} along v (slefejax.with_pieces makes them"
            f" so), not inner {inner[worst].tolist()}, outer {outer[worst].tolist()}"
        )


def triangle_counts(inner: Numbers, outer: Numbers, spacing: str = "equal") -> Int[np.ndarray, "patches"]:
    """Triangles of every patch, of all of its pieces where it is cut (equal spacing only); 0 of one that is not drawn.

    inner, outer : levels ``(patches, 2)`` along u and v and ``(patches, 4)`` on the edges u=0, v=0, u=1, v=1, such as
                   ``.inner`` and ``.edges`` of ``Factors``
    spacing      : how levels become segments: ``"equal"``, ``"fractional-even"`` or ``"fractional-odd"``

    Raises InputError for other shapes, levels that are negative or no numbers, another spacing, and for levels past 64
    that are no multiples of the number of pieces (``with_pieces`` makes them so).

    >>> inner, outer = np.array([[3, 3], [1, 1], [2, 2]]), np.array([[3, 3, 3, 3], [1, 1, 1, 1], [0, 2, 2, 2]])
    >>> triangle_counts(inner, outer).tolist()
    [18, 2, 0]
    """
    inner, outer = real_numbers(inner, "levels"), real_numbers(outer, "levels")
    if inner.shape[1:] != (2,) or outer.shape != (inner.shape[0], 4):
        raise InputError(f"levels must have shapes (patches, 2) and (patches, 4), not {inner.shape} and {outer.shape}")
    inner, outer = segments(inner, spacing), segments(outer, spacing)
    along = pieces_along(inner, outer) if spacing == "equal" else np.ones_like(inner)
    _check_multiples(inner, outer, along)
    own = inner // along
    acting = np.maximum(own, 3 if spacing == "fractional-odd" else 2) - 2
    # a piece on which nothing is cut is two triangles; next to an edge with more cuts there is a row of other ones
    rows = outer > along[:, OWN_AXIS]
    plain = np.maximum(along - rows[:, :2] - rows[:, 2:], 0).prod(axis=1) * np.all(own <= 1, axis=1)
    core = 2 * (acting.prod(axis=1) + acting.sum(axis=1))
    cuts = outer.sum(axis=1) + 2 * ((along - 1) * inner[:, ::-1]).sum(axis=1)
    counts = (along.prod(axis=1) - plain) * core + cuts - 2 * plain
    return np.where(np.all(outer > 0, axis=1), counts, 0)
