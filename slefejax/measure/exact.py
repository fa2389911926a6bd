"""Which parameters the exact surface has at pixel centres: what a texture is looked up at where nothing is off."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from slefejax.arguments import Patches, check_concrete, check_patches
from slefejax.geometry.view import View
from slefejax.measure.error import surface_on_screen

_STEPS = 6  # of Newton's method, which doubles the digits in each
_APART = 1e-6  # of the domain: of difference quotients in float64 half of the digits are right
_SETTLED = 1e-9  # pixels


def exact_parameters(
    patches: Patches, view: View, seen: Any
) -> tuple[Float[np.ndarray, "height width"], Float[np.ndarray, "height width"]]:
    """u and v of the exact surface's point at the centre of every pixel, float64, near what was drawn there.

    patches : as ``pixel_error`` takes them
    view    : whose picture it is
    seen    : with ``.u``, ``.v`` and ``.patch``, such as a ``slefejax.gpu.GBuffer``: of fine triangles, so that the
              right patch is seen and nothing is far from its place

    Newton's method on the screen from there, inside of the patch. Where it comes no nearer the drawn parameters stay:
    at outlines, where the surface turns away, and where a neighbour lies at the centre. NaN where nothing is.

    >>> from types import SimpleNamespace
    >>> from slefejax import Camera
    >>> square = np.array([[[[-1.0, -1.0, 0.0], [-1.0, 1.0, 0.0]], [[1.0, -1.0, 0.0], [1.0, 1.0, 0.0]]]])
    >>> view = View(Camera.look_at((0, 0, 9), (0, 0, 0), up=(0, 1, 0)), width=1, height=1)
    >>> seen = SimpleNamespace(u=np.array([[0.6]]), v=np.array([[0.3]]), patch=np.array([[0]]))
    >>> [x.round(9).tolist() for x in exact_parameters(square, view, seen)]
    [[[0.5]], [[0.5]]]
    """
    check_concrete("exact_parameters", patches, view, seen.u, seen.v, seen.patch)
    own = check_patches(patches, gregory=True)
    at = np.nonzero(seen.patch >= 0)
    found = np.full((2, *seen.patch.shape), np.nan)
    if at[0].size:
        search = _Search(own, view, seen.patch[at], np.stack([at[1], at[0]], axis=1) + 0.5)
        found[(slice(None), *at)] = search.from_start(np.stack([seen.u[at], seen.v[at]]).astype(np.float64))
    return found[0], found[1]


class _Search:
    """Of points of patches at places on the screen."""

    def __init__(self, patches: Any, view: View, patch: np.ndarray, place: np.ndarray) -> None:
        self.patches, self.view, self.patch, self.place = patches, view, patch, place

    def from_start(self, start: np.ndarray) -> np.ndarray:
        """Parameters ``(2, points)`` that come as near as may be; a step that leads away is not taken."""
        best, miss = start.copy(), self.miss(slice(None), start)
        left = np.arange(start.shape[1])
        for _ in range(_STEPS):
            left = left[_length(miss[left]) > _SETTLED]
            if not left.size:
                break
            there = np.clip(best[:, left] + self.step(left, best[:, left], miss[left]), 0.0, 1.0)
            own = self.miss(left, there)
            nearer = _length(own) < _length(miss[left])  # false for NaN
            left = left[nearer]
            best[:, left], miss[left] = there[:, nearer], own[nearer]
        return best

    def miss(self, which: Any, place: np.ndarray) -> np.ndarray:
        """``(points, 2)`` pixels from a point to where it should be."""
        screen = surface_on_screen(self.patches, self.view, self.patch[which], place[0], place[1])
        return self.place[which] - screen[:, :2]

    def step(self, which: np.ndarray, place: np.ndarray, miss: np.ndarray) -> np.ndarray:
        """Towards where both difference quotients say that nothing is missed; inwards at sides."""
        columns = []
        for axis in (0, 1):
            off = place.copy()
            off[axis] += np.where(place[axis] < 0.5, _APART, -_APART)
            columns.append((miss - self.miss(which, off)) / (off[axis] - place[axis])[:, None])
        (a, c), (b, d) = (column.T for column in columns)
        with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
            found = np.stack([d * miss[:, 0] - b * miss[:, 1], a * miss[:, 1] - c * miss[:, 0]]) / (a * d - b * c)
        return np.nan_to_num(found, nan=0.0, posinf=0.0, neginf=0.0)


def _length(miss: np.ndarray) -> np.ndarray:
    """As errors are measured: the larger of both."""
    return np.max(np.abs(miss), axis=1, initial=0.0)
