"""Pixels whose parameters lie outside of their triangle, and the nearest point that the triangle has.

The rasteriser snaps corners to a grid of 1/256 pixel and asks whether a pixel's centre lies in what comes out; then it
interpolates the parameters between corners that are not snapped. Of a triangle that is seen edge on, thinner than the
grid, it gets parameters from far outside. What is drawn of a triangle ends at its sides and at the planes of the view
volume: the nearest point of that, in the domain, is taken instead.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from slefejax.errors import OpenGLError
from slefejax.late import one_at_a_time
from slefejax.tessellator.levels import Pieces

_SIDES = 9
_ROUNDING = 1e-7  # of a function's largest value at a corner
_WIDTH = 1e-6  # of triangles that have none in the domain: of a thousand pixels' patch a thousandth of a pixel
_NEVER = 1e9
_FAR = 64.0  # parameters beyond are noise, and would leave nothing of the digits of the triangle
_APART = 8.0  # between the domains of patches: more than the sum of three parameters
_MOST_PIECES = 256  # that a patch is cut into along u or v
_SAME = 1e-5  # of a sum of parameters in single precision; triangles are some 1/16,384 apart
_AT_ONCE = 128  # pieces whose triangles are looked at: at most 8,192 each


class Strays(NamedTuple):
    """What ``gbuffer.frag`` tells of such pixels.

    patch : whose triangle it is;  corners : the sum of its corners, u and v, which no other triangle of the patch has
    place : the parameters that were interpolated;  centre : the pixel's, in pixels from the picture's
    """

    patch: Int[np.ndarray, "pixels"]
    corners: Float[np.ndarray, "pixels 2"]
    place: Float[np.ndarray, "pixels 2"]
    centre: Float[np.ndarray, "pixels 2"]

    @staticmethod
    def of(
        samples: Float[np.ndarray, "height width 4"], drawn: Float[np.ndarray, "height width 2"]
    ) -> tuple[Strays, tuple[np.ndarray, ...]]:
        """Those of a picture, and their rows and columns."""
        at = np.nonzero(samples[..., 2] < -1)
        height, width = samples.shape[:2]
        centre = np.stack([at[1] + 0.5 - width / 2, at[0] + 0.5 - height / 2], axis=1)
        patch = (-2 - samples[at][:, 2]).astype(np.int64)
        return Strays(patch, drawn[at].astype(float), samples[at][:, :2].astype(float), centre), at

    def triangles(
        self, parts: Pieces, capture: Callable[[Pieces], Any]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        """Parameters ``(pixels, 3, 2)`` and clip-space positions ``(pixels, 3, 4)`` of the corners of their triangles,
        and normals ``(pixels, 3, 3)`` if these have some.

        parts   : all pieces that were drawn
        capture : makes the triangles of some of them, ``slefejax.gpu.Triangles``

        Raises OpenGLError if they are not among these.
        """
        with one_at_a_time:
            from scipy.spatial import KDTree  # slow to import

        parts, count = self._own(parts), len(self.patch)
        wanted = np.column_stack([_APART * self.patch, self.corners])
        nearest, parameters, clip = np.full(count, np.inf), np.zeros((count, 3, 2)), np.zeros((count, 3, 4))
        normals = None
        for first in range(0, len(parts.patch), _AT_ONCE):
            made = capture(Pieces(*(x[first : first + _AT_ONCE] for x in parts)))
            known = np.column_stack([_APART * made.patch, made.parameters.sum(axis=1, dtype=float)])
            apart, which = (np.asarray(x) for x in KDTree(known).query(wanted))
            closer = apart < nearest
            nearest[closer] = apart[closer]
            parameters[closer], clip[closer] = made.parameters[which[closer]], made.clip[which[closer]]
            if made.normal is not None:
                normals = np.zeros((count, 3, 3)) if normals is None else normals
                normals[closer] = made.normal[which[closer]]
        if np.any(nearest > _SAME):
            raise OpenGLError("the tessellator does not make the same triangles twice: what was drawn is not known")
        return _with_area(parameters), clip, normals

    def _own(self, parts: Pieces) -> Pieces:
        """The pieces that their triangles are in."""
        along = parts.along[np.searchsorted(parts.patch, self.patch)]
        place = np.minimum((self.corners / 3.0 * along).astype(np.int64), along - 1)
        wanted = np.isin(_numbers(parts.patch, parts.place), _numbers(self.patch, place))
        return Pieces(*(x[wanted] for x in parts))


def _numbers(patch: np.ndarray, place: np.ndarray) -> np.ndarray:
    return (patch.astype(np.int64) * _MOST_PIECES + place[:, 0]) * _MOST_PIECES + place[:, 1]


def _with_area(corners: np.ndarray) -> np.ndarray:
    """The same, but corners on a line, which fractional spacing makes, are moved off it."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    flat = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]) < _WIDTH**2
    along = np.where(np.sum(a**2, axis=1, keepdims=True) > np.sum(b**2, axis=1, keepdims=True), a, b)
    across = along[:, ::-1] * [-1.0, 1.0] / np.linalg.norm(along, axis=1, keepdims=True)
    # irrational: wherever they lie on the line, they lie on none afterwards
    shifts = _WIDTH * np.array([0.0, 1.0, np.sqrt(5.0)])
    return np.where(flat[:, None, None], corners + shifts[:, None] * across[:, None], corners)


def nearest_drawn(
    parameters: Float[np.ndarray, "pixels 3 2"],
    clip: Float[np.ndarray, "pixels 3 4"],
    place: Float[np.ndarray, "pixels 2"],
) -> Float[np.ndarray, "pixels 2"]:
    """The points of the visible parts of triangles that are nearest to places in the domain.

    parameters, clip : of the corners, as ``slefejax.gpu.Triangles`` has them

    Nine linear functions of the domain are nowhere negative there: the barycentric coordinates, and in clip space
    W + X, W - X and so on, whatever the sign of W. The nearest point is the place itself, or it lies on a line where
    one of them is zero: the foot of the perpendicular, or an end of what the other ones leave of that line.
    """
    w = clip[..., 3:]
    values = np.concatenate([np.eye(3) + 0.0 * w, w + clip[..., :3], w - clip[..., :3]], axis=2)
    functions = linear_functions(parameters, values)
    place = np.where(np.isfinite(place).all(axis=1, keepdims=True), place, parameters.mean(axis=1))[:, None]
    place = np.clip(place, -_FAR, _FAR)
    normals = np.swapaxes(functions[:, 1:], 1, 2)  # (pixels, sides, 2)
    along = normals[..., ::-1] * [-1.0, 1.0]
    climb = along @ functions[:, 1:]  # of every function along every line
    climb[:, range(_SIDES), range(_SIDES)] = 0.0
    with np.errstate(divide="ignore", invalid="ignore"):  # a function that is the same everywhere has no line
        feet = place - normals * np.swapaxes(_at(functions, place), 1, 2) / np.sum(normals**2, axis=2, keepdims=True)
        ends = -_at(functions, feet) / climb
        low = np.max(np.where(climb > 0, ends, -np.inf), axis=2)
        high = np.min(np.where(climb < 0, ends, np.inf), axis=2)
        found = feet + along * np.clip(0.0, low, high)[..., None]
        found = np.concatenate([place, found], axis=1)
        beyond = np.max(-_at(functions, found) / np.abs(values).max(axis=1)[:, None], axis=2)
        cost = np.linalg.norm(found - place, axis=2) + np.where(beyond < _ROUNDING, 0.0, _NEVER)
    best = np.argmin(np.where(np.isnan(cost), np.inf, cost), axis=1)
    return found[range(len(found)), best]


def drawn_at(
    parameters: Float[np.ndarray, "pixels 3 2"],
    clip: Float[np.ndarray, "pixels 3 4"],
    place: Float[np.ndarray, "pixels 2"],
) -> Float[np.ndarray, "pixels 2"]:
    """X/W and Y/W of the points of triangles with these parameters."""
    position = _at(linear_functions(parameters, clip), place[:, None])[:, 0]
    return position[:, :2] / position[:, 3:]


def normals_at(
    parameters: Float[np.ndarray, "pixels 3 2"],
    normals: Float[np.ndarray, "pixels 3 3"],
    place: Float[np.ndarray, "pixels 2"],
) -> Float[np.ndarray, "pixels 3"]:
    """Unit normals of triangles with these at their corners, undivided; 0 where there is none."""
    found = _at(linear_functions(parameters, normals), place[:, None])[:, 0]
    length = np.linalg.norm(found, axis=1, keepdims=True)
    return found / np.where(length > 0, length, 1.0)


def linear_functions(
    corners: Float[np.ndarray, "pixels 3 2"], values: Float[np.ndarray, "pixels 3 functions"]
) -> Float[np.ndarray, "pixels 3 functions"]:
    """The linear functions of the domain with these values at three corners: at u = v = 0, and slopes along u and v."""
    return np.linalg.solve(np.concatenate([np.ones((len(corners), 3, 1)), corners], axis=2), values)


def _at(functions: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Values ``(pixels, points, functions)`` at ``(pixels, points, 2)``."""
    return functions[:, None, 0] + points @ functions[:, 1:]
