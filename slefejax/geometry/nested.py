"""Nested cubic B-splines of the nine numbers (Q, h) of Gaussian products, as they are solved where they are drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False)
class NestedNets:
    """Squares of which each is one B-spline, or nested ones around its corner u = v = 0.

    nets   : ``(nets, 4, 4, 9)`` float32, control points: Q's entries 11, 12, 13, 22, 23, 33, then h = Q (x - origin)
    first  : ``(squares,)``, the first net of each: its only one; or of nested ones, three for every level, at
             (1, 0), (0, 1) and (1, 1) of the halves, then the one that is left over at the corner
    nested : ``(squares,)``, which have nested ones
    levels : how many there are
    origin : ``(3,)``, scene units
    """

    nets: Float[np.ndarray, "nets 4 4 9"]
    first: Int[np.ndarray, "squares"]
    nested: Bool[np.ndarray, "squares"]
    levels: int
    origin: Float[np.ndarray, "3"]

    def __len__(self) -> int:
        return len(self.first)

    @property
    def nbytes(self) -> int:
        """What lies on the device."""
        return self.nets.nbytes + 8 * len(self)
