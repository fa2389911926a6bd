"""What decides which triangles keep an angle between interpolated normals and exact ones (docs/certified.md, 11)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Float

from slefejax.bounds.triangles import AnyTriangle, HalfCells
from slefejax.lanes import layout, loops, passes
from slefejax.predict.cells import Pictures, Turned
from slefejax.predict.normals.turning import turning


@dataclass(frozen=True, eq=False)
class NormalClaim:
    """Which triangles keep an angle. Errors are over it; of patches without a claim they are 0."""

    pictures: Pictures
    turned: Callable[[np.ndarray], Turned]
    angle: float
    tiles: int
    spun: bool  # they are Gregory patches'
    claimed: Bool[np.ndarray, "patches"]

    def boxes(self, patch: np.ndarray, extents: np.ndarray, evenness: Any) -> Float[np.ndarray, "n"]:
        """Real factors for halves of boxes of sides extent/n (``Certificate.factors``); 0 without a claim."""
        numbers = np.column_stack([extents, np.broadcast_to(evenness, len(patch))])
        return self._through(_boxes_pass, patch, numbers)

    def triangles_keep(
        self,
        patch: np.ndarray,
        along: np.ndarray,
        length: np.ndarray,
        width: np.ndarray,
        scale: float,
        strip: Callable[[np.ndarray, np.ndarray], np.ndarray],
    ) -> Bool[np.ndarray, "n"]:
        """Whether triangles of any shape, of a length along an axis and a width, keep the angle.

        width : of strips of the patches
        strip : makes these of nets ``(m, ku+1, kv+1, 3)`` of some of the patches, whose places it is told; what twists
                add has no strips, it is looked at over the whole patch
        """
        whole = self.spun
        size, extents = shape_of(along, length, width if whole else 1.0)
        return scale * size * self._through(_triangles_pass, patch, extents, None if whole else strip) <= 1.0

    def _through(self, compiled: Any, patch: np.ndarray, numbers: np.ndarray, part: Any = None) -> np.ndarray:
        found = np.zeros(len(patch))
        own = np.flatnonzero(self.claimed[patch])
        if len(own):
            normals = self.turned(patch[own]).normals
            normals = jax.tree.map(lambda x: np.moveaxis(x, -1, 0), normals)
            normals = normals if part is None else normals._replace(net=part(normals.net, own))
            run = lambda given: compiled(given, self.angle, self.tiles)  # noqa: E731
            with jax.enable_x64(True):
                found[own] = layout.through(run, (normals, numbers[own]), np.float64)
        return found


def shape_of(along: np.ndarray, length: np.ndarray, width: Any) -> tuple[np.ndarray, Float[np.ndarray, "n 2"]]:
    """Of triangles of a length along an axis and a width: 1/n, and the sides of the box that holds them times n.

    >>> [x.tolist() for x in shape_of(np.array([0]), np.array([0.5]), 0.125)]
    [[0.25], [[2.0, 0.5]]]
    """
    ratio = np.sqrt(length / width)
    long_u, long_v = np.stack([ratio, 1.0 / ratio], 1), np.stack([1.0 / ratio, ratio], 1)
    return np.sqrt(length * width), np.where((along == 0)[:, None], long_u, long_v)


@passes.as_pass(2)
def _boxes_pass(given: Any, angle: Any, tiles: int) -> Any:
    def kernel(both: Any) -> Any:
        normals, (e_u, e_v, evenness) = both
        return turning(normals, angle, HalfCells((e_u, e_v), evenness), tiles=tiles).factor

    return loops.over_chunks(kernel, given)


@passes.as_pass(2)
def _triangles_pass(given: Any, angle: Any, tiles: int) -> Any:
    def kernel(both: Any) -> Any:
        normals, (e_u, e_v) = both
        return turning(normals, angle, AnyTriangle((e_u, e_v)), tiles=tiles).factor

    return loops.over_chunks(kernel, given)
