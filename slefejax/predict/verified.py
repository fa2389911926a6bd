"""Smaller factors by a proof cell by cell (docs/certified.md, section 7): the costlier setting of certified factors.

For numbers below the certified factor all cells of the grid are looked at. On a cell the error is that of a
lattice q times as fine, for which a crude bound is enough, plus a function that is linear between the points of the
lattice, so that its values there are its largest. Nothing is sampled in the sense that something could be missed.
"""

from __future__ import annotations

from functools import cache, partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax.geometry.bezier import bernstein, combine, derivative
from slefejax.geometry.projection import Projection, reaches, undivided
from slefejax.geometry.view import homogeneous
from slefejax.lanes import layout, loops, nets, passes
from slefejax.lanes.maxima import larger
from slefejax.tessellator.levels import GRID, HIGHEST_LEVEL, shares
from slefejax.tessellator.rings import Pattern

_FINER = 12  # q
_HIGHEST = 128  # factors above are left as they are: proofs take time as the square
_TRIED = 16  # numbers below a factor that are tried, at most
_BATCH = 2**15  # cells at once
_ROUNDING = 256.0 * np.finfo(np.float64).eps


class Pictured(NamedTuple):
    """Patches on the screen, float64, patches last; rows X, Y and Z over their tolerances, W."""

    control: np.ndarray  # (nu, nv, 4, patches)
    half: np.ndarray  # (3,)
    bends: np.ndarray  # (4, patches): |row_uu| + 2 |row_uv| + |row_vv| is at most 8 times this
    sizes: np.ndarray  # (4, patches): of the terms that coefficients are summed from
    floor: np.ndarray  # (patches,): W of visible points is at least this
    rows: int  # 3 with a depth tolerance, else 2

    @staticmethod
    def of(patches: np.ndarray, projection: Projection, tolerances: tuple[Any, Any]) -> Pictured:
        """From control points in the world."""
        depth = 1.0 if tolerances[1] is None else float(tolerances[1])
        scale = 1.0 / np.array([float(tolerances[0]), float(tolerances[0]), depth, 1.0])
        matrix = np.asarray(projection.to_pixels, np.float64) * scale[:, None]
        points = projection.relative(np.moveaxis(homogeneous(np.asarray(patches, np.float64)), 0, -1))
        control = np.stack(undivided(matrix, nets.coordinates(points, unrolled=False)), axis=2)
        largest = np.abs(points).max(axis=(0, 1))
        if patches.shape[-1] == 4:
            # coordinates times weights were taken off
            largest[:3] += np.abs(projection.origin)[:, None] * largest[3]
        sizes = np.einsum("rc,cp->rp", np.abs(matrix), largest)
        half = np.asarray(projection.half, np.float64) * scale[:3]
        floor = float(projection.near_w) * points[:, :, 3].min(axis=(0, 1))
        return Pictured(control, half, _bends(control), sizes, floor, 2 if tolerances[1] is None else 3)


def _bends(control: np.ndarray) -> np.ndarray:
    """An eighth of the largest |uu| + 2 |uv| + |vv| of every row, each over its own coefficients."""
    by_u = derivative(control)
    parts = [
        (1.0, derivative(by_u)),
        (2.0, np.swapaxes(derivative(np.swapaxes(by_u, 0, 1)), 0, 1)),
        (1.0, derivative(derivative(np.swapaxes(control, 0, 1)))),
    ]
    return sum(times * np.abs(part).max(axis=(0, 1), initial=0.0) for times, part in parts) / 8.0  # type: ignore


def verified_factors(factor: Float[np.ndarray, "patches"], pictured: Pictured) -> Float[np.ndarray, "patches"]:
    """Certified factors, or the smallest whole numbers from which on every grid up to them is proved fine.

    Grids are tried from the certified one downwards until one cannot be proved.
    """
    factor = np.asarray(factor, np.float64).copy()
    trial = np.ceil(factor).astype(np.int64) - 1
    open_ones = np.flatnonzero((trial >= 1) & (factor <= _HIGHEST))
    for _ in range(_TRIED):
        fine = grids_hold(pictured, open_ones, np.repeat(trial[open_ones, None], 2, axis=1))
        open_ones = open_ones[fine]
        factor[open_ones] = trial[open_ones]
        trial[open_ones] -= 1
        open_ones = open_ones[trial[open_ones] >= 1]
    return factor


def drawn_grids_hold(
    pictured: Pictured,
    pattern: Pattern,
    patch: Int[np.ndarray, "n"],
    levels: Int[np.ndarray, "n 2"],
    in_pieces: bool = False,
) -> Bool[np.ndarray, "n"]:
    """Whether grids are proved to keep the tolerances, both with equal cells and as the tessellator draws them.

    in_pieces : whether the picture has patches in pieces, so that lines are placed with 24 bits and not by the pattern
    """
    holds = np.all(levels <= HIGHEST_LEVEL, axis=1)
    for points in (_fine_points() if in_pieces else pattern.points, None):
        open_ones = np.flatnonzero(holds)
        holds[open_ones] = grids_hold(pictured, patch[open_ones], levels[open_ones], points)
    return holds


@cache
def _fine_points() -> Float[np.ndarray, "n lines"]:
    """As ``Pattern.points``, placed with 24 bits."""
    n = np.arange(HIGHEST_LEVEL + 1)
    return shares(np.minimum(n, n[:, None]), n[:, None]) * GRID


def grids_hold(
    pictured: Pictured, patch: Int[np.ndarray, "n"], levels: Int[np.ndarray, "n 2"], points: np.ndarray | None = None
) -> Bool[np.ndarray, "n"]:
    """Whether patches cut into that many cells along u and v, with either diagonal, are proved to keep the tolerances.

    points : where the lines of a grid are, ``Pattern.points``; None: equal cells
    """
    counts = levels.prod(axis=1)
    ends = np.cumsum(counts)
    holds = np.ones(len(patch), bool)
    for start in range(0, int(ends[-1]) if len(ends) else 0, _BATCH):
        index = np.arange(start, min(start + _BATCH, int(ends[-1])))
        which = np.searchsorted(ends, index, side="right")
        keep = holds[which]
        index, which = index[keep], which[keep]
        if not index.size:
            continue
        cell = np.stack(np.divmod(index - (ends[which] - counts[which]), levels[which, 1]), axis=1)
        low, high = (_line(cell + k, levels[which], points) for k in (0, 1))
        np.logical_and.at(holds, which, _cells_hold(pictured, patch[which], low, high - low))
    return holds


def _line(index: np.ndarray, levels: np.ndarray, points: np.ndarray | None) -> np.ndarray:
    return index / levels if points is None else points[levels, index]


def _cells_hold(pictured: Pictured, patch: np.ndarray, low: np.ndarray, sides: np.ndarray) -> np.ndarray:
    with jax.enable_x64(True):
        lanes = np.column_stack([patch, low, sides]).astype(np.float64)
        arrays = [jnp.asarray(x) for x in pictured[:5]]
        return layout.through(lambda packed: _cells_pass(packed, *arrays, pictured.rows), lanes)


@passes.as_pass(6)
def _cells_pass(packed: Any, control: Any, half: Any, bends: Any, sizes: Any, floor: Any, rows: int) -> Any:
    return loops.over_chunks(partial(_cell_holds, rows=rows), packed, control, half, bends, sizes, floor)


def _cell_holds(lanes: Any, control: Any, half: Any, bends: Any, sizes: Any, floor: Any, rows: int) -> Any:
    patch = lanes[0].astype(jnp.int32)
    own, bend, size, low = control[..., patch], bends[:, patch], sizes[:, patch], floor[patch]
    steps = jnp.asarray(np.arange(_FINER + 1) / _FINER)
    a, b = steps[:, None, None], steps[None, :, None]
    points = _tensor(own, lanes[1] + steps[:, None] * lanes[3], lanes[2] + steps[:, None] * lanes[4])
    p00, p01, p10, p11 = (points[:, k, m, None, None] for k in (0, -1) for m in (0, -1))
    rising = jnp.where(a >= b, p00 + a * (p10 - p00) + b * (p11 - p10), p00 + b * (p01 - p00) + a * (p11 - p01))
    falling = jnp.where(
        a + b <= 1, p00 + a * (p10 - p00) + b * (p01 - p00), p11 + (1 - a) * (p01 - p11) + (1 - b) * (p10 - p11)
    )
    w = points[3]
    finest = (larger(lanes[3], lanes[4]) / _FINER) ** 2
    lowest = jnp.min(w, axis=(0, 1)) - bend[3] * finest - _ROUNDING * size[3]
    deep = lowest >= 0.5 * low  # away from 0; it is itself what W is at least
    divisor = jnp.where(deep, lowest, 1.0)
    worst = jnp.zeros_like(lowest)
    for r in range(rows):
        places = points[r] / jnp.where(w > 0, w, 1.0)
        far = jnp.max(jnp.abs(places), axis=(0, 1))
        wider = (bend[r] + far * bend[3]) * finest / divisor + _ROUNDING * (size[r] + far * size[3]) / divisor
        ends = (jnp.min(places, axis=(0, 1)) - wider, jnp.max(places, axis=(0, 1)) + wider)
        for s in (jnp.clip(end, -half[r], half[r]) for end in ends):
            lattice = jnp.zeros_like(lowest)
            for drawn in (rising, falling):
                values = jnp.abs(points[r] - drawn[r] - s * (w - drawn[3]))
                lattice = jnp.maximum(lattice, jnp.max(values, axis=(0, 1)))
            rest = (bend[r] + jnp.abs(s) * bend[3]) * finest + _ROUNDING * (size[r] + jnp.abs(s) * size[3])
            worst = jnp.maximum(worst, (lattice + rest) / divisor)
    return (deep & (worst <= 1.0)) | _outside(points, half, size)


def _outside(points: Any, half: Any, size: Any) -> Any:
    """Whether the corners of a cell, hence all points drawn of it, lie outside of one plane of the view volume."""
    *rows, w = points[:, :: points.shape[1] - 1, :: points.shape[2] - 1]
    sides = [
        reach + _ROUNDING * (size[k] + half[k] * size[3]) < 0
        for k, row in enumerate(rows)
        for reach in reaches(row, w, half[k])
    ]
    return jnp.any(jnp.stack(sides), axis=0)


def _tensor(control: Any, u: Any, v: Any) -> Any:
    rows = combine(control[:, :, :, None], bernstein(control.shape[0] - 1, u))
    return combine(rows[:, :, :, None], bernstein(control.shape[1] - 1, v[None]))
