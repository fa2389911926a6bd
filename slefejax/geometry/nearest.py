"""Nearest points on a surface that many Bézier patches make up, to rounding, in float64.

A tree of samples says which patches may hold the nearest point, and Gauss-Newton's method finds it in each of them,
along a side where it would leave the patch: in few steps where a surface is compared with one that approximates it.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property, partial
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from slefejax.geometry.evaluate import places_at
from slefejax.geometry.tangents import nearest_foot
from slefejax.late import one_at_a_time

_PLACES = 4  # of samples along each side of a patch
_CANDIDATES = 64  # samples, the patches of which are tried
_STEPS = 10  # of Gauss-Newton's method
_AT_A_TIME = 8192  # points; the compiled program is for so many
_HELD = 1e-6  # of a patch's side: a foot that would go no further than this beyond its patch is none of the next


@dataclass(frozen=True)
class Feet:
    """Nearest points.

    points     : ``(points, 3)``, on the surface;  distance : ``(points,)``, how far they are from those asked for
    patch      : ``(points,)``, where they lie, and at which ``parameters``, ``(points, 2)``
    """

    points: Float[np.ndarray, "points 3"]
    distance: Float[np.ndarray, "points"]
    patch: Int[np.ndarray, "points"]
    parameters: Float[np.ndarray, "points 2"]


class Surfaces:
    """Patches among which nearest points are looked for.

    net    : ``(patches, du+1, dv+1, 3)``, 4 at the end if rational
    places : of samples along the sides, one number or ``(patches,)``; best where they are about as dense everywhere

    >>> line = np.arange(4) / 3.0
    >>> x, y = np.meshgrid(line, line, indexing="ij")
    >>> square = Surfaces(np.stack([x, y, 0 * x], axis=-1)[None])
    >>> found = square.nearest(np.array([[0.25, 0.5, 2.0], [2.0, 0.5, 0.0]]))
    >>> found.points.round(9).tolist(), found.distance.round(9).tolist()
    ([[0.25, 0.5, 0.0], [1.0, 0.5, 0.0]], [2.0, 1.0])
    """

    def __init__(self, net: Float[np.ndarray, "patches nu nv dim"], places: Any = _PLACES) -> None:
        self.net = np.asarray(net, np.float64)
        self._places = np.broadcast_to(np.asarray(places, np.int64), len(self.net))

    @cached_property
    def _samples(self) -> tuple[Any, np.ndarray, np.ndarray]:
        """The tree, and the patch and the parameters of every sample."""
        with one_at_a_time:
            from scipy.spatial import KDTree  # slow to import

        patch, parameters = [], []
        for places in np.unique(self._places):
            t = (np.arange(places) + 0.5) / places
            grid = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
            own = np.flatnonzero(self._places == places)
            patch.append(np.repeat(own, len(grid)))
            parameters.append(np.tile(grid, (len(own), 1)))
        patch, parameters = np.concatenate(patch), np.concatenate(parameters)
        return KDTree(self.at(patch, parameters)), patch, parameters

    def at(
        self, patch: Int[np.ndarray, "points"], parameters: Float[np.ndarray, "points 2"]
    ) -> Float[np.ndarray, "points 3"]:
        """Points at parameters (u, v) of patches."""
        found = [
            places_at(np.moveaxis(self.net[patch[part]], 0, -1), *parameters[part].T).T for part in _parts(len(patch))
        ]
        return np.concatenate(found) if found else np.zeros((0, 3))

    def nearest(self, points: Float[np.ndarray, "points 3"], start: tuple[Any, Any] | None = None) -> Feet:
        """The nearest point of the whole surface to each of these.

        start : patches ``(points,)`` and parameters ``(points, 2)`` of points that are near, where some are known; -1
                where none is
        """
        points = np.asarray(points, np.float64).reshape(-1, 3)
        found = [
            self._nearest(points[part], None if start is None else (start[0][part], start[1][part]))
            for part in _parts(len(points))
        ]
        patch, parameters = (np.concatenate([part[k] for part in found]) for k in (0, 1))
        there = self.at(patch, parameters)
        return Feet(there, np.linalg.norm(points - there, axis=1), patch, parameters)

    def _nearest(self, points: np.ndarray, start: tuple[Any, Any] | None) -> tuple[np.ndarray, np.ndarray]:
        tree, patches, parameters = self._samples
        sample = tree.query(points)[1]
        best = _Best.of(patches[sample], self._feet(points, patches[sample], parameters[sample]))
        open_ = ~best.sound
        if start is not None:
            known = np.flatnonzero(start[0] >= 0)
            if known.size:
                found = self._feet(points[known], start[0][known], start[1][known])
                best.take(known, start[0][known], found)
                open_[known] |= ~found[2]
        # where the foot would leave its patch, another one may have it: those of the next samples
        held = np.flatnonzero(open_)
        count = min(_CANDIDATES, len(patches))
        samples = tree.query(points[held], k=count)[1].reshape(len(held), count)
        candidates = patches[samples]
        for k in range(1, count):
            own = np.flatnonzero((candidates[:, k, None] != candidates[:, :k]).all(axis=1))
            if own.size:
                place = samples[own, k]
                best.take(held[own], patches[place], self._feet(points[held[own]], patches[place], parameters[place]))
        return best.patch, best.parameters

    def _feet(self, points: np.ndarray, patch: np.ndarray, start: np.ndarray) -> tuple[np.ndarray, ...]:
        """Parameters, squares of distances, and whether no side of the patch holds the foot."""
        count = len(points)
        room = 1 << max(6, (count - 1).bit_length())
        fill = lambda x: np.concatenate([x, np.repeat(x[:1], room - count, axis=0)])  # noqa: E731
        with jax.enable_x64(True):
            net = np.moveaxis(self.net[fill(patch)], 0, -1)
            found = _feet_jit(net, fill(points).T, *fill(start).T)
        u, v, square, held = (np.asarray(x)[:count] for x in found)
        return np.stack([u, v], axis=1), square.copy(), held <= _HELD


@dataclass
class _Best:
    """The nearest that was found of every point.

    sound : whether no side of its patch holds it
    """

    patch: np.ndarray
    parameters: np.ndarray
    square: np.ndarray
    sound: np.ndarray

    @staticmethod
    def of(patch: np.ndarray, found: tuple[np.ndarray, ...]) -> _Best:
        return _Best(patch.copy(), *found)

    def take(self, which: np.ndarray, patch: np.ndarray, found: tuple[np.ndarray, ...]) -> None:
        """Others of some points, where they are nearer."""
        better = found[1] < self.square[which]
        at = which[better]
        self.patch[at] = patch[better]
        for kept, new in zip((self.parameters, self.square, self.sound), found, strict=True):
            kept[at] = new[better]


def _parts(count: int) -> list[slice]:
    return [slice(k, min(k + _AT_A_TIME, count)) for k in range(0, count, _AT_A_TIME)]


_feet_jit = jax.jit(partial(nearest_foot, steps=_STEPS))
