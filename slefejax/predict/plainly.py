"""The formulas as they are written, one patch at a time: what the kernels are compared with, and where to read first.

Patches in front of the camera; NumPy in float64, no margins for rounding, no derivatives, and no thought of speed.
"""

from __future__ import annotations

from itertools import product
from math import comb, perm

import numpy as np
from jaxtyping import Float

from slefejax.bounds.slefe import slefe_table
from slefejax.geometry.bezier import elevate, restrict
from slefejax.geometry.view import View, homogeneous

Patch = Float[np.ndarray, "nu nv 3"]
Net = Float[np.ndarray, "nu nv"]
_CUBIC = 1.0 / (12.0 * 27.0**0.5)


def slefe_factor(
    patch: Patch, view: View, segments: int, tolerance: float, k: float = 1.0, depth_tolerance: float | None = None
) -> float:
    """[YBP12], (6) to (10), with the test of section 6; 0 for a patch that is off-screen.

    >>> from slefejax import Camera, load
    >>> view = View(Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), width=1440, height=900)
    >>> round(float(slefe_factor(load("teapot").patches()[0], view, 3, 0.5)), 4)
    13.996
    """
    lower, upper = boxes(patch, segments)
    rectangles = np.zeros((segments + 1, segments + 1, 2, 3))
    for place in np.ndindex(segments + 1, segments + 1):
        corners = [[ends[c][(*place, c)] for c in range(3)] for ends in product((lower, upper), repeat=3)]
        positions = on_screen(np.array(corners), view)
        rectangles[place] = positions.min(axis=0), positions.max(axis=0)
    counted = set()
    for i, j in np.ndindex(segments, segments):
        tile = rectangles[i : i + 2, j : j + 2].reshape(4, 2, 3)
        low, high = tile[:, 0].min(axis=0), tile[:, 1].max(axis=0)
        if np.all(high >= 0) and np.all(low <= [view.width, view.height, 1.0]):
            counted |= {(i, j), (i + 1, j), (i, j + 1), (i + 1, j + 1)}
    if not counted:
        return 0.0
    extent = np.array([rectangles[place][1] - rectangles[place][0] for place in counted])
    demand = extent[:, :2].max() / tolerance
    if depth_tolerance is not None:
        demand = max(demand, extent[:, 2].max() / depth_tolerance)
    return max(1.0, k * segments * np.sqrt(demand))


def on_screen(points: Float[np.ndarray, "n 3"], view: View) -> Float[np.ndarray, "n 3"]:
    """Pixels from the lower left corner, and window depth.

    >>> from slefejax import Camera
    >>> view = View(Camera.look_at((0, -5, 0), (0, 0, 0)), 400, 300)
    >>> on_screen(np.zeros((1, 3)), view).round(6).tolist()[0][:2]
    [200.0, 150.0]
    """
    x = homogeneous(points) @ np.asarray(view.world_to_screen).T
    return x[:, :3] / x[:, 3:]


def boxes(patch: Patch, segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Bounds in v, then lower ones of lower and upper ones of upper ones in u ([YBP12], appendix).

    >>> boxes(np.zeros((4, 4, 3)), 3)[0].shape
    (4, 4, 3)
    """
    across = [np.stack(end) for end in zip(*(bounds(row, segments) for row in patch), strict=True)]
    return bounds(across[0], segments)[0], bounds(across[1], segments)[1]


def bounds(c: np.ndarray, segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Breakpoint values of the slefe of polynomials with coefficients along the first axis ([YBP12], (2)).

    >>> lower, upper = bounds(np.array([0.0, 0.0, 1.0]), 1)
    >>> lower.round(3).tolist(), upper.tolist()
    ([-0.25, 0.75], [0.0, 1.0])
    """
    t = (np.arange(segments + 1) / segments).reshape(-1, *(1,) * (c.ndim - 1))
    lower = upper = (1 - t) * c[0] + t * c[-1]
    if len(c) > 2:
        table = slefe_table(len(c) - 1, segments)
        for j in range(1, len(c) - 1):
            bend = c[j - 1] - 2 * c[j] + c[j + 1]
            low, up = (end[j - 1].reshape(t.shape) for end in table)
            upper = upper + np.where(bend > 0, bend * up, bend * low)
            lower = lower + np.where(bend > 0, bend * low, bend * up)
    return lower, upper


def certified_factor(
    patch: Patch, view: View, tiles: int, tolerance: float, depth_tolerance: float | None = None
) -> float:
    """n of docs/certified.md, (6), over tiles: for polynomial patches cut into 2 x 2 tiles or more; 0 off-screen.

    >>> from slefejax import Camera, load
    >>> view = View(Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), width=1440, height=900)
    >>> round(certified_factor(load("teapot").patches()[0], view, 2, 0.5), 4)
    12.2107
    """
    half = 0.5 * np.array([view.width / tolerance, view.height / tolerance, 1.0 / (depth_tolerance or 1.0)])
    screen = np.moveaxis(homogeneous(patch) @ np.asarray(view.world_to_screen).T, -1, 0)
    w = screen[3]
    # undivided, over the tolerances, from the middle of the picture
    scales = (tolerance, tolerance, depth_tolerance or 1.0)
    rows = [x / given - h * w for x, given, h in zip(screen[:3], scales, half, strict=True)]
    if any(np.all(h * w + sign * row < 0) for row, h in zip(rows, half, strict=True) for sign in (1, -1)):
        return 0.0
    count = 2 if depth_tolerance is None else 3
    squares = [1.0]
    for u, v in product(range(tiles), repeat=2):
        own = [_tile(net, u / tiles, (u + 1) / tiles, v / tiles, (v + 1) / tiles) for net in (*rows[:count], w)]
        needed = max(_square(rows[k], w, own[k], own[-1], half[k], tiles) for k in range(count))
        squares.append(min(needed, _last_visible(rows, w, own, half)))
    return float(np.sqrt(max(squares)))


def _square(row: Net, w: Net, tile: Net, tile_w: Net, half: float, tiles: int) -> float:
    """n^2 at which the bound for the points of a tile is at most 1, in one coordinate."""
    places = tile / tile_w
    ends = np.clip([places.min(), places.max()], -half, half)
    inverse = 1.0 / tile_w
    second = 0.0
    for s in ends:
        uu, uv, vv = (_raised(_derivative(tile - s * tile_w, *order), tile) for order in ((2, 0), (1, 1), (0, 2)))
        bend = np.maximum(np.abs(uu + vv) + 2 * np.abs(uv), np.maximum(np.abs(uu), np.abs(vv)))
        second = max(second, float((bend * inverse).max()) * tiles**2)
    sizes = [
        comb(order, j) * max(_largest(_derivative(row - s * w, order - j, j)) for s in ends)
        for order in (3, 4)
        for j in range(order + 1)
    ]
    along_u, along_v, fourth = sizes[0] + sizes[1], sizes[2] + sizes[3], sum(sizes[4:]) / 288
    more, less, widest = max(along_u, along_v), min(along_u, along_v), float(inverse.max())
    third = _CUBIC * more + less / 288

    def square(step: float) -> float:
        rest = (third + fourth * step) * step + _bend(w) / 8
        return max(second, more * widest * step) / 8 + rest * widest

    widest_step = step = 1.0 / np.sqrt(max(second / 8, 1.0))
    for _ in range(2):
        low = square(1.0 / np.sqrt(max(square(step), 1.0)))
        step = min(widest_step, 1.0 / np.sqrt(max(low, 1.0)))
    return square(step)


def _last_visible(rows: list[Net], w: Net, own: list[Net], half: np.ndarray) -> float:
    """n^2 beyond which nothing of a tile is drawn in the picture; infinite if there is none."""
    last = np.inf
    for row, tile, h in list(zip(rows, own, half, strict=False))[:2]:
        for sign in (1, -1):
            outside = -float((h * own[-1] + sign * tile).max())
            if outside > 0:
                last = min(last, (_bend(row) + h * _bend(w)) / (8 * outside))
    return last


def _bend(net: Net) -> float:
    """At least the largest |uu| + 2 |uv| + |vv|."""
    return sum(times * _largest(_derivative(net, *order)) for order, times in {(2, 0): 1, (1, 1): 2, (0, 2): 1}.items())


def _derivative(net: Net, i: int, j: int) -> Net:
    du, dv = (n - 1 for n in net.shape)
    return perm(du, i) * perm(dv, j) * np.diff(np.diff(net, i, axis=0), j, axis=1)


def _largest(net: Net) -> float:
    return float(np.abs(net).max(initial=0.0))


def _raised(net: Net, like: Net) -> Net:
    """The same polynomial with the degrees of another."""
    if not net.size:
        return np.zeros_like(like)
    return elevate(elevate(net, len(like) - 1).T, like.shape[1] - 1).T


def _tile(net: Net, u0: float, u1: float, v0: float, v1: float) -> Net:
    return restrict(restrict(net, u0, u1).T, v0, v1).T
