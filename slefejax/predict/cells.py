"""How far cells and triangles of a patch err on the screen: one by one, from above (docs/certified.md, section 7).

On a cell, or on any triangle, the error is compared with that of the quadratic polynomial which agrees with it at the
corners and in the middles of the sides. For a quadratic these middles tell the largest error exactly; the rest is a
third derivative, of the cell alone, and small. Nothing is sampled in the sense that something could be missed.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from slefejax.bounds.parts import part_error
from slefejax.bounds.quadratics import PARTS
from slefejax.geometry.gregory import Twisted
from slefejax.geometry.projection import Projection, undivided
from slefejax.geometry.view import homogeneous
from slefejax.lanes import loops, nets, passes
from slefejax.lanes.tuning import TUNING
from slefejax.predict.normals.parts import part_turn
from slefejax.predict.normals.undivided import Undivided
from slefejax.tessellator.direct3d11 import ragged

_HIGHEST = 128  # factors above are left as they are: proofs take time as the square
_TRIED = 16  # numbers below a factor that are tried, at most
_EVEN = np.minimum(np.arange(_HIGHEST + 1) / np.maximum(np.arange(_HIGHEST + 1), 1)[:, None], 1.0)
_BATCH = 2**16  # cells or triangles that are held at once
_NEAR = 4.0  # errors up to that may turn out to be at most 1
_HALVINGS = 3
_QUARTERS = np.array([[0, 0], [0, 1], [1, 0], [1, 1]], float)


class Pictured(NamedTuple):
    """Patches on the screen, float64, patches last; rows X, Y and Z over their tolerances, W."""

    control: np.ndarray  # (nu, nv, 4, patches)
    twists: np.ndarray  # (slots, 4, patches) of Gregory patches; no slots of others
    half: np.ndarray  # (3,)
    sizes: np.ndarray  # (4, patches): of the terms that coefficients are summed from
    floor: np.ndarray  # (patches,): W of visible points is at least this
    rows: int  # 3 with a depth tolerance, else 2

    @staticmethod
    def of(patches: Any, projection: Projection, tolerances: tuple[Any, Any]) -> Pictured:
        """From control points in the world."""
        patches, twists = patches if isinstance(patches, Twisted) else (patches, np.zeros((len(patches), 0, 3)))
        depth = 1.0 if tolerances[1] is None else float(tolerances[1])
        scale = 1.0 / np.array([float(tolerances[0]), float(tolerances[0]), depth, 1.0])
        matrix = np.asarray(projection.to_pixels, np.float64) * scale[:, None]
        points = projection.relative(np.moveaxis(homogeneous(np.asarray(patches, np.float64)), 0, -1))
        control = np.stack(undivided(matrix, nets.coordinates(points, unrolled=False)), axis=2)
        largest = np.abs(points).max(axis=(0, 1))
        largest[:3] += np.abs(twists).sum(axis=1).T
        if patches.shape[-1] == 4:
            # coordinates times weights were taken off
            largest[:3] += np.abs(projection.origin)[:, None] * largest[3]
        sizes = np.einsum("rc,cp->rp", np.abs(matrix), largest)
        half = np.asarray(projection.half, np.float64) * scale[:3]
        floor = float(projection.near_w) * points[:, :, 3].min(axis=(0, 1))
        turned = np.einsum("rc,psc->srp", matrix[:, :3], np.asarray(twists, np.float64))
        return Pictured(control, turned, half, sizes, floor, 2 if tolerances[1] is None else 3)

    def page(self, count: int) -> tuple[Any, ...]:
        """For so many patches, with zeros behind the last; control points patches first, so that one's lie together."""
        control, twists, sizes, floor = _filled((self.control, self.twists, self.sizes, self.floor), count)
        return np.moveaxis(control, -1, 0), np.moveaxis(twists, -1, 0), self.half, sizes, floor, self.rows

    @staticmethod
    def programs() -> dict[str, passes.Pass]:
        """For parts of them, by the kind of part."""
        return ERRORS


class Turned(NamedTuple):
    """Undivided normals of patches, float64, patches last, and the angle that is allowed."""

    normals: Undivided
    angle: float  # radians

    def page(self, count: int) -> tuple[Any, ...]:
        """As of ``Pictured``."""
        net, size, spin = jax.tree.map(lambda own: np.moveaxis(_filled((own,), count)[0], -1, 0), self.normals)
        return net, size, np.float64(self.angle), *([] if spin is None else spin)

    @staticmethod
    def programs() -> dict[str, passes.Pass]:
        """As of ``Pictured``."""
        return TURNS


def _filled(arrays: tuple[np.ndarray, ...], count: int) -> list[np.ndarray]:
    """With zeros behind the last patch."""
    return [np.pad(x, [(0, 0)] * (x.ndim - 1) + [(0, count - x.shape[-1])]) for x in arrays]


class Pictures:
    """Patches on the screen as they are asked for: most scenes have many that nobody needs to look at.

    They are kept in pages of one size, so that one program does for all of them.

    make  : makes those of some numbers
    count : of all patches
    """

    def __init__(self, make: Callable[[np.ndarray], Pictured | Turned], count: int) -> None:
        self._make = make
        self._place = np.full(count, -1)
        self._pages: list[tuple[Any, ...]] = []
        self._made_of: type[Pictured | Turned] = Pictured

    def errors(self, kind: str, patch: Int[np.ndarray, "n"], *numbers: np.ndarray) -> Float[np.ndarray, "n"]:
        """At most how far parts of a kind err, over what is allowed; numbers ``(n, ...)`` tell which parts."""
        if not len(patch):
            return np.zeros(0)
        self._look_for(patch)
        compiled = self._made_of.programs()[kind]
        page, place = np.divmod(self._place[patch], TUNING.page)
        items, found = np.column_stack([place, *numbers]).astype(np.float64), np.empty(len(patch))
        which = _blocks(page, TUNING.cells)
        chunks = items[which].reshape(len(which), 2, -1, items.shape[1]).swapaxes(2, 3).copy()
        with jax.enable_x64(True):
            # nothing is waited for before all of them are under way
            made = [compiled(own, *self._pages[page[block[0]]]) for own, block in zip(chunks, which, strict=True)]
        for block, own in zip(which, made, strict=True):
            found[block] = np.asarray(own).ravel()
        return found

    def _look_for(self, patch: np.ndarray) -> None:
        missing = np.unique(patch[self._place[patch] < 0])
        for start in range(0, len(missing), TUNING.page):
            own = missing[start : start + TUNING.page]
            made = self._make(own)
            self._place[own] = len(self._pages) * TUNING.page + np.arange(len(own))
            with jax.enable_x64(True):
                page, self._made_of = made.page(TUNING.page), type(made)
                self._pages.append(tuple(x if isinstance(x, int) else jnp.asarray(x) for x in page))


def _blocks(page: np.ndarray, size: int) -> Int[np.ndarray, "blocks size"]:
    """Which items are looked at together: so many, of one page; what is missing is the last one again."""
    order = np.argsort(page, kind="stable")
    counts = np.bincount(page)
    ends, (own, number) = np.cumsum(counts), ragged(-(-counts // size))
    start = (ends - counts)[own] + number * size
    return order[np.minimum(start[:, None] + np.arange(size), ends[own, None] - 1)]


def cell_errors(
    pictures: Pictures, patch: Int[np.ndarray, "n"], low: Float[np.ndarray, "n 2"], high: Float[np.ndarray, "n 2"]
) -> Float[np.ndarray, "n"]:
    """At most how far visible points of cells err, cut along either diagonal, in tolerances; 0 for unseen cells.

    Infinite where a cell is beside or behind the near plane.
    """
    return pictures.errors("cell", patch, low, high)


def triangle_errors(
    pictures: Pictures, patch: Int[np.ndarray, "n"], corners: Float[np.ndarray, "n 3 2"], closer: Any = False
) -> Float[np.ndarray, "n"]:
    """The same of triangles, from the parameters of their corners.

    closer : of which triangles, if they are just above 1, parts are looked at one by one
    """
    flat = corners.reshape(-1, 6)
    error = pictures.errors("triangle", patch, flat)
    near = np.flatnonzero((error > 1.0) & (error < _NEAR) & closer)
    parts = np.tile(np.array([0.0, 0.0, 1.0, 0.0, 0.0, 1.0]), (len(near), 1))  # shares of the second and third corner

    def quarters(parts: np.ndarray) -> np.ndarray:
        a, b, c = np.moveaxis(parts.reshape(-1, 3, 2), 1, 0)
        ab, bc, ca = 0.5 * (a + b), 0.5 * (b + c), 0.5 * (c + a)
        return np.stack([np.hstack(t) for t in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (bc, ca, ab))], axis=1)

    find = lambda own, part: pictures.errors("piece", patch[own], flat[own], part)  # noqa: E731
    return _part_by_part(error, near, parts, quarters, find)


def _closer(pictures: Pictures, patch: np.ndarray, low: np.ndarray, high: np.ndarray, error: np.ndarray) -> np.ndarray:
    """The same errors of cells; those that are just above 1 are looked at part by part."""
    near = np.flatnonzero((error > 1.0) & (error < _NEAR))

    def quarters(parts: np.ndarray) -> np.ndarray:
        place, side = parts[:, None, :2] + 0.5 * parts[:, 2, None, None] * _QUARTERS, 0.5 * parts[:, 2]
        return np.concatenate([place, np.broadcast_to(side[:, None, None], (*place.shape[:2], 1))], axis=2)

    parts = np.tile([0.0, 0.0, 1.0], (len(near), 1))
    find = lambda own, part: pictures.errors("window", patch[own], low[own], high[own], part)  # noqa: E731
    return _part_by_part(error, near, parts, quarters, find)


def _part_by_part(
    error: np.ndarray,
    near: np.ndarray,
    parts: np.ndarray,
    quarters: Callable[[np.ndarray], np.ndarray],
    find: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> np.ndarray:
    """Errors of items, of some the largest of their parts, quarters of quarters as long as one is above 1."""
    settled = np.zeros(len(error))
    for _ in range(_HALVINGS):
        if not len(near):
            break
        parts = quarters(parts)
        item, parts = np.repeat(near, parts.shape[1]), parts.reshape(-1, parts.shape[2])
        found, worst = find(item, parts), settled.copy()
        np.maximum.at(worst, item, found)
        error[near] = np.minimum(error[near], worst[near])
        again = (found > 1.0) & (worst[item] < _NEAR)
        np.maximum.at(settled, item[found <= 1.0], found[found <= 1.0])
        near, parts = item[again], parts[again]
    return error


def grid_errors(
    pictures: Pictures,
    patch: Int[np.ndarray, "n"],
    levels: Int[np.ndarray, "n 2"],
    lines: Float[np.ndarray, "n m"],
    closer: Any = False,
) -> Float[np.ndarray, "n"]:
    """The same of patches cut into that many cells along u and v.

    lines  : ``(levels + 1, lines)``, where the lines of a grid are, by its level
    closer : of which patches cells just above 1 are looked at part by part, whose bounds are tighter
    """
    counts = levels.prod(axis=1)
    ends = np.cumsum(counts)
    worst = np.zeros(len(patch))
    for start in range(0, int(ends[-1]) if len(ends) else 0, _BATCH):
        index = np.arange(start, min(start + _BATCH, int(ends[-1])))
        which = np.searchsorted(ends, index, side="right")
        cell = np.stack(np.divmod(index - (ends[which] - counts[which]), levels[which, 1]), axis=1)
        low, high = (lines[levels[which], cell + k] for k in (0, 1))
        error = cell_errors(pictures, patch[which], low, high)
        if np.any(closer):
            worth = np.broadcast_to(closer, len(worst)).copy()
            worth[which[error >= _NEAR]] = False
            own = np.flatnonzero(worth[which])
            error[own] = _closer(pictures, patch[which[own]], low[own], high[own], error[own])
        np.maximum.at(worst, which, error)
    return worst


def verified_factors(
    factor: Float[np.ndarray, "patches"], errors: Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
) -> Float[np.ndarray, "patches"]:
    """Certified factors, or the smallest whole numbers from which on every grid up to them is proved fine.

    Grids are tried from the certified one downwards until one cannot be proved.

    errors : of patches with levels ``(n, 2)`` and lines of grids by level, at most (``Certificate.even_errors``)
    """
    factor = np.asarray(factor, np.float64).copy()
    trial = np.ceil(factor).astype(np.int64) - 1
    open_ones = np.flatnonzero((trial >= 1) & (factor <= _HIGHEST))
    for _ in range(_TRIED):
        levels = np.repeat(trial[open_ones, None], 2, axis=1)
        fine = errors(open_ones, levels, _EVEN) <= 1.0
        open_ones = open_ones[fine]
        factor[open_ones] = trial[open_ones]
        trial[open_ones] -= 1
        open_ones = open_ones[trial[open_ones] >= 1]
    return factor


def _error_pass(kind: str) -> passes.Pass:
    def run(packed: Any, *pictured: Any) -> Any:
        *arrays, rows = pictured
        return loops.over_chunks(partial(part_error, kind=kind, rows=rows), packed, *arrays)

    return passes.Pass(run, (6,))


def _turn_pass(kind: str) -> passes.Pass:
    def run(packed: Any, *pictured: Any) -> Any:
        return loops.over_chunks(partial(part_turn, kind=kind), packed, *pictured)

    return passes.Pass(run)


ERRORS = {kind: _error_pass(kind) for kind in PARTS}
TURNS = {kind: _turn_pass(kind) for kind in PARTS}
