"""What single precision adds when patches are drawn: a bound of it, from how they are evaluated (docs/certified.md, 1).

The renderer sends control points as float32, relative to the middle of the scene's box, sums them with Bernstein
polynomials, and multiplies by a float32 matrix (``gpu/shaders/bezier.glsl``). With u = 2^-24 a term that goes through
n roundings is wrong by at most gamma_n = n u/(1 - n u) of its size [Hig02, 3.1]. Bernstein polynomials are not
negative: what sizes of terms add up to is itself a polynomial, with the sizes of control points for coefficients.

Row R of clip space is wrong by at most E_R, and X/W of what is seen, |X/W| <= 1, by (E_X + E_W)/(W - E_W), both of them
polynomials: at most the largest quotient of their coefficients, on a tile.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float

from slefejax.arguments import Patches, check_patches, on_host
from slefejax.geometry.bezier import restrict
from slefejax.geometry.view import View, check_view

_UNIT, _UNIT64 = 2.0**-24, 2.0**-53
_MATRIX = 5  # roundings of a term: of the matrix, of the product, of three sums
_TWIST = 24  # of a twist's term (gregory.glsl), divisions counted as five
_TWIST_SIZE = 0.1  # what a twist is multiplied by at most: 9 (4/27)^2/2
_WHOLE = 23  # the highest degree whose binomials are made of numbers below 2^24
_DOUBLE = 32.0 * _UNIT64  # of what double precision adds up before
_TINY, _LARGEST = 2.0**-80, 2.0**120  # of a scene's size: below, numbers vanish; above, they overflow
_TILES = 2  # along each side; more help by a per cent
_AT_A_TIME = 512  # patches


def rounding_error(patches: Patches, view: View) -> Float[np.ndarray, "patches"]:
    """How far off, in pixels, single precision draws what is seen of each patch at most: a proof, not a measurement.

    patches : Bézier, rational or Gregory; all those that are drawn together, since they are sent relative to their box.
              A renderer whose patches have moved may have kept an earlier box, up to twice as large: this is of one
              that was made of them

    From what exact vertices draw: max(|dx|, |dy|), for vertices at places that are multiples of 2^-24, and hence for
    the triangles between them. The rasteriser's own rounding comes on top. 0 where nothing is seen, infinite where W
    cannot be told from 0. Sides that are parts of other sides (``tessellator.edges``) are taken for whole ones.

    >>> from slefejax import Camera
    >>> flat = np.array([[[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0]]]], float)
    >>> view = View(Camera.look_at((0.5, 0.5, 3), (0.5, 0.5, 0), (0, 1, 0)), 1440, 900)
    >>> bool(1e-4 < rounding_error(flat, view)[0] < 2e-3)
    True
    """
    check_view(view)
    control = on_host(check_patches(patches, gregory=True)).astype(np.float64)
    scene = _Scene.of(control, view)
    parts = range(0, len(control), _AT_A_TIME)
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        return np.concatenate([scene.bound(control[k : k + _AT_A_TIME]) for k in parts])


class _Scene(NamedTuple):
    """What all patches are sent and drawn with.

    centre, extent : of the box
    to_clip        : matrix from there;  sizes : sums of the sizes that its entries are made of
    half, floor    : half the picture, and W of the near plane
    """

    centre: np.ndarray
    extent: float
    to_clip: np.ndarray
    sizes: np.ndarray
    half: np.ndarray
    floor: float

    @staticmethod
    def of(control: Any, view: View) -> _Scene:
        net, weights, _ = _parts(control)
        places = (net / weights).reshape(-1, 3)
        low, high = places.min(axis=0), places.max(axis=0)
        centre = 0.5 * low + 0.5 * high
        camera = view.camera
        rotation = np.abs(np.asarray(camera.world_to_eye, np.float64)[:3, :3])
        moved = rotation @ (np.abs(np.asarray(camera.eye, np.float64)) + np.abs(centre))
        motion = np.vstack([np.column_stack([rotation, moved]), [0.0, 0.0, 0.0, 1.0]])
        sizes = np.abs(np.asarray(camera.eye_to_clip(view.width / view.height), np.float64)) @ motion
        to_clip = np.asarray(view.to_clip(centre), np.float64)
        half = 0.5 * np.array([view.width, view.height], np.float64)
        return _Scene(centre, float(np.max(high - low)), to_clip, sizes, half, float(camera.near_w))

    def bound(self, control: Any) -> Float[np.ndarray, "patches"]:
        """Of some of the patches."""
        net, weights, twists = _parts(control)
        rows, errors = self._rows(net, weights, _roundings(control))
        reach = _TWIST_SIZE * np.abs(twists).sum(axis=1) @ np.abs(self.to_clip[:, :3]).T
        reach = reach[:, None, None]
        errors = errors + _gamma(_TWIST + _MATRIX) * reach
        along = errors[..., :2] + errors[..., 3:]
        low = rows[..., 3:] - reach[..., 3:] - errors[..., 3:]
        floor = self.floor * weights.min(axis=(1, 2)) - errors[..., 3].max(axis=(1, 2))[:, None]
        simple = np.where(floor > 0, along.max(axis=(1, 2)) / floor, np.inf)
        ratio = np.minimum(simple, _largest_ratio(along, low))
        found = np.max(ratio * self.half, axis=1) * (1.0 + 2.0**-20)
        found = np.where(np.abs(rows).max(axis=(1, 2, 3)) < _LARGEST, found, np.inf)
        return np.where(_outside(rows, errors + reach), 0.0, found)

    def _rows(self, net: np.ndarray, weights: np.ndarray, roundings: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
        """Rows of clip space ``(patches, du+1, dv+1, 4)``, and what they are wrong by at most."""
        sent = np.concatenate([net - self.centre * weights, weights], axis=3)
        size = np.abs(sent) + _TINY * np.array([self.extent] * 3 + [1.0])
        gammas = np.array([_gamma(roundings[0])] * 3 + [_gamma(roundings[1])])
        before = np.concatenate([np.abs(net) + np.abs(self.centre) * weights, weights], axis=3)
        errors = (size * gammas) @ np.abs(self.to_clip).T + _DOUBLE * before @ self.sizes.T
        return sent @ self.to_clip.T, errors


def _parts(control: Any) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Control points (w x, w y, w z), weights, and twists, of which only Gregory patches have any."""
    net = control.net if hasattr(control, "twists") else control
    twists = control.twists if hasattr(control, "twists") else np.zeros((len(net), 0, 3))
    return net[..., :3], net[..., 3:] if net.shape[3] == 4 else np.ones((*net.shape[:3], 1)), twists


def _roundings(control: Any) -> tuple[int, int]:
    """Of a term of X, Y or Z and of one of W, on the way from a control point to clip space."""
    _, nu, nv, dim = control.shape
    of_sums = 1 + _of_sum(nu - 1) + _of_sum(nv - 1) + hasattr(control, "twists") + _MATRIX
    return of_sums, of_sums if dim == 4 else _MATRIX


def _of_sum(degree: int) -> int:
    """Roundings of a term in a sum of Bernstein polynomials: those of the polynomial, where t and 1 - t are exact, as
    many as its degree; that of the product; and those of the sums, in pairs from the ends."""
    binomial = 0 if degree <= _WHOLE else 2 * (degree // 2)
    return degree + binomial + 1 + (degree // 2 + 1)


def _gamma(roundings: int) -> float:
    return roundings * _UNIT / (1.0 - roundings * _UNIT)


def _largest_ratio(upper: np.ndarray, lower: np.ndarray) -> np.ndarray:
    """The largest quotient of coefficients ``(patches, du+1, dv+1, some)`` over those of one row, tile by tile;
    infinite where one of the latter is not positive."""
    both = np.concatenate([upper, lower], axis=3)
    by_u, by_v = (
        np.concatenate([restrict(np.eye(n), k / _TILES, (k + 1) / _TILES) for k in range(_TILES)])
        for n in both.shape[1:3]
    )
    *tiles, below = np.moveaxis(by_u @ np.moveaxis(both, 3, 1) @ by_v.T, 1, 0)
    return np.stack([np.where(below > 0, own / below, np.inf).max(axis=(1, 2)) for own in tiles], axis=1)


def _outside(rows: np.ndarray, apart: np.ndarray) -> np.ndarray:
    """Which patches lie outside of a plane of the view volume, with all their points and what these are apart."""
    margin = apart[..., :3] + apart[..., 3:]
    beyond = [side * rows[..., :3] - rows[..., 3:] > margin for side in (1.0, -1.0)]
    return np.any([np.all(x, axis=(1, 2)) for x in beyond], axis=(0, 2))
