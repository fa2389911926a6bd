"""Where prims of a stage stand, at the earliest time and over time, in the coordinates of the stage.

USD multiplies row vectors from the left; here matrices are transposed once, where they are read.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import numpy as np
from jaxtyping import Float

from slefejax.io.usd.library import Library
from slefejax.late import one_at_a_time
from slefejax.model.rig import transform_of, transform_parts

_MOST_PIECES = 1024  # between two samples of a transform
_NEAR = 1e-5  # of the largest number of a matrix


@dataclass(eq=False)
class Mover:
    """A prim whose transform changes over time: what is below moves with it, and stands still in its coordinates.

    bind : from the coordinates of the prim to those of the stage, where meshes below it are put; the prim's place at
           the earliest time, if that can be inverted
    """

    prim: Any
    bind: Float[np.ndarray, "4 4"]


@dataclass
class Places:
    """Places of prims, at the earliest time if none is given.

    step : of time, a frame; nothing is looked at more closely
    """

    library: Library
    time: Any
    step: float
    _above: dict[str, Mover | None] = field(default_factory=dict)
    _caches: dict[float, Any] = field(default_factory=dict)

    def matrix(self, prim: Any, time: Any = None) -> Float[np.ndarray, "4 4"]:
        """From the coordinates of a prim to those of the stage."""
        return matrix(self._cache(self.time if time is None else time).GetLocalToWorldTransform(prim))

    def _cache(self, time: Any) -> Any:
        if time.GetValue() not in self._caches:
            self._caches[time.GetValue()] = self.library.geometry.XformCache(time)
        return self._caches[time.GetValue()]

    def mover(self, prim: Any) -> Mover | None:
        """The nearest prim, itself or above, whose transform changes over time."""
        paths, found = [], None
        while not prim.IsPseudoRoot():
            path = str(prim.GetPath())
            if path in self._above:
                found = self._above[path]
                break
            paths.append(path)
            own = self.library.geometry.Xformable(prim)
            if own and own.TransformMightBeTimeVarying():
                place = self.matrix(prim)
                sound = np.isfinite(place).all() and abs(np.linalg.det(place[:3, :3])) > 0
                found = Mover(prim, place if sound else np.eye(4))
                break
            if own and own.GetResetXformStack():
                break
            prim = prim.GetParent()
        self._above |= dict.fromkeys(paths, found)
        return found

    def below(self, prim: Any) -> Float[np.ndarray, "4 4"]:
        """From the coordinates of a prim to those of its mover, or of the stage if it has none."""
        mover = self.mover(prim)
        if mover is None:
            return self.matrix(prim)
        return matrix(self._cache(self.time).ComputeRelativeTransform(prim, mover.prim)[0])

    def bound(self, prim: Any) -> Float[np.ndarray, "4 4"]:
        """From the coordinates of a prim to those of the stage, where it is put before anything moves."""
        mover = self.mover(prim)
        return self.below(prim) if mover is None else mover.bind @ self.below(prim)

    def times(self, movers: list[Mover]) -> list[float]:
        """The times of all samples of movers, and every frame where what is between them is no straight way."""
        found: set[float] = set()
        for mover in movers:
            own = self._samples(mover.prim)
            found.update(own)
            for start, end in pairwise(own):
                count = min(int(np.ceil((end - start) / self.step)), _MOST_PIECES)
                if count > 1 and not self._straight(mover.prim, start, end):
                    found.update(np.linspace(start, end, count + 1)[1:-1].tolist())
        return sorted(found)

    def _samples(self, prim: Any) -> list[float]:
        found: set[float] = set()
        while not prim.IsPseudoRoot():
            own = self.library.geometry.Xformable(prim)
            if own:
                found.update(own.GetTimeSamples())
                if own.GetResetXformStack():
                    break
            prim = prim.GetParent()
        return sorted(found)

    def _straight(self, prim: Any, start: float, end: float) -> bool:
        """Whether translation and scale go straight between two times, and the rotation along an arc."""
        with one_at_a_time:
            from scipy.spatial.transform import Rotation  # slow to import

        ends = [self.matrix(prim, self.library.usd.TimeCode(time)) for time in (start, end)]
        (move, turn, scale), (to_move, to_turn, to_scale) = (transform_parts(own) for own in ends)
        rotation, to_rotation = (Rotation.from_quat(q, scalar_first=True) for q in (turn, to_turn))
        arc = (rotation.inv() * to_rotation).as_rotvec()
        for share in (0.25, 0.5, 0.75):
            wanted = self.matrix(prim, self.library.usd.TimeCode(start + share * (end - start)))
            turned = (rotation * Rotation.from_rotvec(share * arc)).as_quat(scalar_first=True)
            found = transform_of((1 - share) * move + share * to_move, turned, (1 - share) * scale + share * to_scale)
            if not np.abs(found - wanted).max() <= _NEAR * np.abs(ends).max():
                return False
        return True


def matrix(given: Any) -> Float[np.ndarray, "4 4"]:
    """A matrix of USD for column vectors."""
    return np.array(given, np.float64).T
