"""The error over the whole domain, not only at pixels: the supremum of docs/math.md, 4.

The pixel of a triangle at parameters (u, v) is P(L(u, v)), with L the linear interpolant of the triangle's undivided
homogeneous vertices, and the surface point of the same parameters is seen at P(p(u, v)). The error there is the
larger of their distances in x and in y. (u, v) counts only where the drawn point lies in the view volume; where the
exact point is not in front of the camera (W <= 0) the error is infinite.

How the supremum is known to 1 %: f = p - L is nearly quadratic on a triangle of a fine mesh, with largest value about
1/8 of its second derivatives' bound; at a lattice of spacing 1/q (edges, corners and midpoints among its points) the
largest sample misses at most (1/q)^2 of that: 1 % for q = 10. Coarse meshes, where f is not quadratic, are sampled as
if they were finer (``_FINEST``). Then the samples are zoomed into around the largest ones of each patch, until what
is left is far below. The supremum is always approached from below.

Where the view volume cuts a triangle, at the rim of the picture or at the near plane, what is seen of it may be a
sliver between samples. Of twisted bicubic patches from inside, at fields of view of 150 to 179 degrees, 5 in 1,000
errors up to one pixel were more than 1 % low (2 % at most), 6 in 1,000 up to 4 pixels (4 %), 1 in 10 beyond 16 (19 %).

Everything is float64, in batches of bounded size, whatever the factors.
"""

from __future__ import annotations

from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from slefejax.arguments import Patches, check_concrete, check_patches, whole_numbers
from slefejax.errors import InputError
from slefejax.geometry.evaluate import evaluate_grid
from slefejax.geometry.view import View
from slefejax.lanes import layout, loops, passes
from slefejax.measure.surface import Quantity, Surface, of_patches
from slefejax.tessellator.levels import MOST_LEVEL

_LATTICE = 10  # q: intervals of the samples' lattice along each side
_FINEST = 60  # samples along each side of a patch, at least
_KEPT = 16  # windows of a patch that are zoomed into
_ZOOMS = 4
_BATCH = 2**16  # windows in memory at once

Cells = Float[np.ndarray, "cells 4"]
Windows = Float[np.ndarray, "windows 3"]


class Supremum(NamedTuple):
    """The largest error of every patch, and where it is attained (NaN where nothing is visible).

    error : pixels, or degrees between normals

    >>> quad = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]], float)
    >>> from slefejax import Camera
    >>> view = View(Camera.look_at((0.5, -3.0, 2.0), (0.5, 0.5, 0.0)), 300, 200)
    >>> worst_points(quad[None], [1], view).error.round(9).tolist()
    [0.0]
    """

    error: Float[np.ndarray, "patches"]
    u: Float[np.ndarray, "patches"]
    v: Float[np.ndarray, "patches"]


def sampled_error(patches: Patches, factors: Any, view: View) -> Float[np.ndarray, "patches"]:
    """The largest error of every patch in pixels, cut uniformly, over its visible domain and both diagonals of a cell.

    patches : control points ``(patches, du+1, dv+1, 3)``, or 4 at the end if rational; or ``GregoryPatches``
    factors : whole numbers ``(patches,)``, or ``(patches, 2)`` along u and v, or a ``Factors``; 0: not drawn, error 0
    returns : ``(patches,)`` float64, known to 1 % but where the view volume cuts triangles (module docstring), and
              never too large; infinite where a visible sample has exact W <= 0

    OpenGL leaves the diagonal open, so the worse one counts. Raises InputError for factors of the wrong shape or kind.

    >>> quad = np.array([[[0, 0, 0], [0, 500, 0]], [[500, 0, 0], [550, 500, 0]]], float)   # one side 1.1 times as long
    >>> from slefejax import Camera
    >>> camera = Camera.orthographic((300, 300, 5), (300, 300, 0), up=(0, 1, 0), height=600.0)
    >>> sampled_error(quad[None], [1], View(camera, 600, 600)).round(6).tolist()
    [12.5]
    """
    return worst_points(patches, factors, view).error


def worst_points(patches: Patches, factors: Any, view: View) -> Supremum:
    """``sampled_error`` and the parameters of the maxima. Arguments and errors as there."""
    check_concrete("sampled_error", patches, factors, view)
    given = check_patches(patches, gregory=True)
    levels = level_pairs(factors, len(given))
    return worst_of(Surface.of(given, view), np.arange(len(given)), levels)


def worst_of(surface: Surface, chosen: np.ndarray, levels: np.ndarray, zooms: int = _ZOOMS) -> Supremum:
    """The worst points of some patches, cut uniformly.

    chosen : numbers of the patches
    levels : ``(chosen, 2)`` along u and v
    zooms  : how often the largest samples are looked at more closely
    """
    result = Supremum(np.zeros(len(chosen)), *(np.full(len(chosen), np.nan) for _ in range(2)))
    for block in _blocks(_window_counts(levels)):
        for whole, own in zip(result, _worst_in(surface, chosen[block], levels[block], zooms), strict=True):
            whole[block] = own
    return result


def level_pairs(factors: Any, count: int) -> Int[np.ndarray, "patches 2"]:
    """Levels along u and v as whole numbers ``(patches, 2)``, or InputError.

    >>> level_pairs([2, 3], 2).tolist()
    [[2, 2], [3, 3]]
    """
    levels = whole_numbers(getattr(factors, "inner", factors), "factors")
    if levels.shape not in ((count,), (count, 2)):
        raise InputError(f"factors of {count} patches must have shape ({count},) or ({count}, 2), not {levels.shape}")
    if levels.min(initial=0) < 0 or levels.max(initial=0) > MOST_LEVEL:
        raise InputError(f"factors must be from 0 to {MOST_LEVEL}, which is the most that is drawn")
    return np.stack([levels, levels], axis=1) if levels.ndim == 1 else levels


def cell_errors(
    surface: Surface, patch: Int[np.ndarray, "windows"], cells: Cells, windows: Windows
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Largest sampled error in a window of a cell, over both diagonals, and where: (error, a, b); -1: nothing is seen.

    cells   : u0, u1, v0, v1 of the cell whose corners are drawn
    windows : a0, b0 and side of the part that is sampled, in the cell's own coordinates 0 ... 1
    """
    with jax.enable_x64(True):
        lanes = np.column_stack([patch, cells, windows]).astype(np.float64)
        found = layout.through(lambda packed: _cells_pass(packed, *surface), lanes, most=surface.quantity.lanes)
        error, a, b = found.T
        return error, a, b


@passes.as_pass(3)
def _cells_pass(packed: Any, control: Any, size: Any, quantity: Quantity) -> Any:
    return loops.over_chunks(partial(_cell_kernel, quantity), packed, control, size)


def _cell_kernel(quantity: Quantity, lanes: Any, control: Any, size: Any) -> Any:
    own = of_patches(control, lanes[0].astype(jnp.int32))
    u0, u1, v0, v1, a0, b0, side = (lanes[k] for k in range(1, 8))
    steps = jnp.asarray(np.arange(_LATTICE + 1) / _LATTICE)[:, None]
    a, b = a0 + side * steps, b0 + side * steps
    exact = quantity.rows(own, u0 + a * (u1 - u0), v0 + b * (v1 - v0), evaluate_grid)
    ends = quantity.rows(own, jnp.stack([u0, u1]), jnp.stack([v0, v1]), evaluate_grid)
    p00, p01, p10, p11 = (ends[:, i, j][:, None, None] for i in (0, 1) for j in (0, 1))
    a, b = a[:, None], b[None, :]
    rising = jnp.where(a >= b, p00 + a * (p10 - p00) + b * (p11 - p10), p00 + b * (p01 - p00) + a * (p11 - p01))
    falling = jnp.where(
        a + b <= 1, p00 + a * (p10 - p00) + b * (p01 - p00), p11 + (1 - a) * (p01 - p11) + (1 - b) * (p10 - p11)
    )
    error = jnp.maximum(quantity.error(exact, rising, size), quantity.error(exact, falling, size))
    flat = error.reshape(-1, error.shape[-1])
    at = jnp.argmax(flat, axis=0)
    place = jnp.stack([at // (_LATTICE + 1), at % (_LATTICE + 1)]) / _LATTICE
    return jnp.stack([jnp.max(flat, axis=0), a0 + side * place[0], b0 + side * place[1]])


def _window_counts(levels: np.ndarray) -> np.ndarray:
    """Windows that a patch's cells are sampled by, 0 for a patch that is not drawn."""
    drawn = np.all(levels > 0, axis=1)
    return np.where(drawn, np.prod(levels, axis=1) * _splits(levels) ** 2, 0)


def _splits(levels: np.ndarray) -> np.ndarray:
    """Windows along each side of a cell, so that coarse meshes are sampled finely."""
    coarsest = np.maximum(1, levels.min(axis=1))
    return -(-_FINEST // (_LATTICE * coarsest))


def _blocks(counts: np.ndarray) -> list[np.ndarray]:
    """Patches in groups with at most _BATCH windows each, or one patch; those without windows are left out."""
    drawn = np.flatnonzero(counts)
    groups = (np.cumsum(counts[drawn]) - 1) // _BATCH
    return [drawn[groups == g] for g in np.unique(groups)]


def windows_of(levels: Int[np.ndarray, "patches 2"], start: int, end: int) -> tuple[np.ndarray, Cells, Windows]:
    """(patch, cells, windows) number start ... end-1 of those that sample all cells of patches cut by these levels.

    >>> patch, cells, windows = windows_of(np.array([[6, 6]]), 0, 100)
    >>> len(cells), cells[7].round(3).tolist()
    (36, [0.167, 0.333, 0.167, 0.333])
    """
    splits = _splits(levels)
    ends = np.cumsum(_window_counts(levels))
    index = np.arange(start, min(end, int(ends[-1])))
    patch = np.searchsorted(ends, index, side="right")
    index = index - np.where(patch > 0, ends[patch - 1], 0)
    split, nu, nv = splits[patch], levels[patch, 0], levels[patch, 1]
    index, part = np.divmod(index, split**2)
    i, j = np.divmod(index, nv)
    cells = np.column_stack([i / nu, (i + 1) / nu, j / nv, (j + 1) / nv])
    return patch, cells, np.column_stack([(part // split) / split, (part % split) / split, 1.0 / split])


class _Sampled(NamedTuple):
    """Windows with their largest sampled errors and where in the cell these are."""

    patch: np.ndarray
    cells: Cells
    windows: Windows
    error: np.ndarray
    a: np.ndarray
    b: np.ndarray

    def only(self, keep: np.ndarray) -> _Sampled:
        """Some of them."""
        return _Sampled(*(column[keep] for column in self))


def _worst_in(surface: Surface, chosen: np.ndarray, levels: np.ndarray, zooms: int) -> Supremum:
    """The worst points of a block of patches."""
    kept = []
    for start in range(0, int(_window_counts(levels).sum()), _BATCH):
        patch, cells, windows = windows_of(levels, start, start + _BATCH)
        found = _Sampled(patch, cells, windows, *cell_errors(surface, chosen[patch], cells, windows))
        kept.append(found.only(largest_of_each(found.patch, found.error, _KEPT)))
    best = _Sampled(*(np.concatenate(column) for column in zip(*kept, strict=True)))
    for _ in range(zooms):
        best = best.only(largest_of_each(best.patch, best.error, _KEPT))
        best = _zoomed(surface, chosen, best)
    best = best.only(largest_of_each(best.patch, best.error, 1))
    u = best.cells[:, 0] + best.a * (best.cells[:, 1] - best.cells[:, 0])
    v = best.cells[:, 2] + best.b * (best.cells[:, 3] - best.cells[:, 2])
    seen = best.error >= 0
    return Supremum(np.maximum(best.error, 0.0), np.where(seen, u, np.nan), np.where(seen, v, np.nan))


def _zoomed(surface: Surface, chosen: np.ndarray, best: _Sampled) -> _Sampled:
    """The windows around the largest samples, where that finds something larger."""
    windows = _around(best.a, best.b, best.windows[:, 2])
    found = cell_errors(surface, chosen[best.patch], best.cells, windows)
    better = found[0] > best.error
    known = (best.error, best.a, best.b)
    return _Sampled(
        best.patch, best.cells, windows, *(np.where(better, new, old) for new, old in zip(found, known, strict=True))
    )


def in_batches(surface: Surface, patch: np.ndarray, cells: Cells, windows: Windows) -> tuple[np.ndarray, ...]:
    """``cell_errors`` with bounded memory."""
    parts = [slice(at, at + _BATCH) for at in range(0, len(patch), _BATCH)]
    found = [cell_errors(surface, patch[part], cells[part], windows[part]) for part in parts]
    return tuple(np.concatenate(column) for column in zip(*found, strict=True))


def _around(a: np.ndarray, b: np.ndarray, side: np.ndarray) -> Windows:
    """A window of three lattice intervals around a sample, inside of the cell."""
    zoomed = 3.0 / _LATTICE * side
    return np.column_stack([*(np.clip(t - zoomed / 2.0, 0.0, 1.0 - zoomed) for t in (a, b)), zoomed])


def largest_of_each(patch: np.ndarray, error: np.ndarray, most: int) -> np.ndarray:
    """Indices of the largest errors of each patch, at most so many, patches in order, the largest first.

    >>> largest_of_each(np.array([0, 1, 0]), np.array([1.0, 5.0, 2.0]), 1).tolist()
    [2, 1]
    """
    order = np.lexsort((-error, patch))
    sorted_patch = patch[order]
    start = np.searchsorted(sorted_patch, sorted_patch)
    return order[np.arange(len(order)) - start < most]
