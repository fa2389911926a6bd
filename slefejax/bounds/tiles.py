"""Boxes around the tiles of patches, polynomial and rational, sound between the breakpoints too.

A rational patch is x = X/W with polynomial X and W > 0 (homogeneous control points w x, w y, w z, w). Quotients of the
slefes of X and of W at the breakpoints do not enclose x between them: for 1/(1+u) with one segment both slefes are
exact lines, the quotients are the end values, and their interpolant is off by .086. What holds on a tile:

- the hull of the tile's own control points, projected, holds it;
- for any number s, x - s = g/W with the polynomial g = X - s W (docs/math.md, 6), whose slefe is narrow where s is
  near x; s is the value at the tile's middle. There g <= G and L <= W <= U, with bilinear interpolants G, L, U of slefe
  values at its corners, L > 0, so g/W is at most the larger of G/L and G/U; a quotient of bilinear functions with a
  positive denominator is monotone along every parameter line, so largest at a corner. Likewise from below.

Both are computed from the tile's own control points; on each side the tighter one counts. All is rounded outwards.
"""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from slefejax.arguments import Patches, Segments, check_patches, check_weights, segment_pair
from slefejax.bounds.slefe import Slefe, outward_patch
from slefejax.geometry.bezier import evaluate_patch, restrict
from slefejax.lanes import layout, loops, passes
from slefejax.lanes.maxima import largest_along, smallest_along


def slefe_tiles(patches: Patches, segments: Segments) -> Slefe:
    """A box around every tile of polynomial or rational patches: all of the patch on that tile lies in it.

    patches  : ``(patches, du+1, dv+1, 3)``, or rational with homogeneous points (w x, w y, w z, w), w > 0, 4 at the end
    segments : m, or (m_u, m_v)
    returns  : ``.lower`` and ``.upper``, ``(patches, m_u, m_v, 3)``: box [i, j] holds the patch where
               i <= m_u u <= i+1 and j <= m_v v <= j+1

    Raises InputError for a wrong shape, segments < 1, or a weight that is not positive (with the patch's number).

    >>> arc = np.array([[1, 0, 0, 1], [1, 1, 0, 1], [0, 2, 0, 2]], float)      # a quarter circle
    >>> tiles = slefe_tiles(np.stack([arc, arc], axis=1)[None], (4, 1))
    >>> bool((tiles.lower[..., :2] ** 2).sum(-1).max() <= 1.0 <= (tiles.upper[..., :2] ** 2).sum(-1).min())
    True
    """
    patches = check_patches(patches)
    check_weights(patches)
    lower, upper = _tiles_pass(layout.pack(patches), segment_pair(segments))
    return Slefe(layout.unpack(lower, len(patches)), layout.unpack(upper, len(patches)))


@passes.as_pass(1)
def _tiles_pass(packed: Any, segments: tuple[int, int]) -> tuple[Any, Any]:
    return loops.over_chunks(_tiles, packed, segments)


def _tiles(control: Any, segments: tuple[int, int]) -> tuple[Any, Any]:
    """Boxes ``(m_u, m_v, 3, lanes)`` of one chunk ``(du+1, dv+1, 3 or 4, lanes)``.

    A control point of a tile is a mean of the patch's, of weights likewise: of d = du + dv steps, each wrong by at most
    3 u of what its terms add up to. So weights are wrong by 3 d u of themselves, positions by as much of the largest
    |x| of the patch times the weight.
    """
    own = restrict_to_tiles(control, segments)
    position = own[:, :, :3]
    weight = own[:, :, 3:] if control.shape[2] == 4 else jnp.ones_like(own[:, :, :1])
    error = (3.0 * (sum(control.shape[:2]) - 2) + 4.0) * jnp.finfo(control.dtype).eps
    whole = control[:, :, :3] / control[:, :, 3:] if control.shape[2] == 4 else control
    far = jnp.max(jnp.abs(whole), axis=(0, 1))[:, None, None]
    points = position / weight
    hull_lower, hull_upper = smallest_along(points, (0, 1)) - error * far, largest_along(points, (0, 1)) + error * far
    s = evaluate_patch(position, 0.5, 0.5) / evaluate_patch(weight, 0.5, 0.5)
    g_lower, g_upper = outward_patch(position - s * weight, (1, 1))
    blur = error * far * jnp.max(weight, axis=(0, 1))
    low, high = _weight_bounds(weight)
    ends = (low * (1.0 - error), high * (1.0 + error))
    lower = smallest_along(jnp.stack([(g_lower - blur) / end for end in ends]), (0, 1, 2))
    upper = largest_along(jnp.stack([(g_upper + blur) / end for end in ends]), (0, 1, 2))
    last = 4.0 * jnp.finfo(control.dtype).eps * (far + jnp.maximum(jnp.abs(lower), jnp.abs(upper)))
    lower, upper = jnp.maximum(s + lower - last, hull_lower), jnp.minimum(s + upper + last, hull_upper)
    return jnp.moveaxis(lower, 0, 2), jnp.moveaxis(upper, 0, 2)


def restrict_to_tiles(control: Any, segments: tuple[int, int]) -> Any:
    """Control points ``(du+1, dv+1, dim, m_u, m_v, lanes)`` of every tile, by blossoming in u and in v.

    >>> line = jnp.array([0.0, 1.0]).reshape(2, 1, 1, 1) * jnp.ones((2, 2, 1, 1))
    >>> restrict_to_tiles(line, (2, 1))[:, 0, 0, :, 0, 0].tolist()
    [[0.0, 0.5], [0.5, 1.0]]
    """
    own = control[:, :, :, None, None]
    for axis, m in enumerate(segments):
        start = (np.arange(m) / m).reshape((m, 1, 1) if axis == 0 else (1, m, 1))
        end = ((np.arange(m) + 1) / m).reshape(start.shape)
        ends = (jnp.asarray(t, control.dtype) for t in (start, end))
        own = jnp.swapaxes(restrict(jnp.swapaxes(own, 0, axis), *ends), 0, axis)
    return own


def _weight_bounds(weight: Any) -> tuple[Any, Any]:
    """Positive bounds of W at the four corners of every tile, their bilinear interpolants bounding W on it.

    A slefe of positive weights may dip below 0; where it falls below the smallest weight on a tile, that weight is
    the lower bound of the whole tile.
    """
    lower, upper = outward_patch(weight, (1, 1))
    smallest = smallest_along(weight, (0, 1))
    sunken = jnp.min(lower, axis=(0, 1)) < smallest
    return jnp.where(sunken, smallest, lower), upper
