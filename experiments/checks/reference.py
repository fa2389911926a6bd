"""The same numbers with sixty digits: what computations in single and double precision are compared with.

Arrays of mpmath numbers, patches first as users have them, written from the formulas and sharing no code with the
kernels. A number that is given counts as exactly what it is, whatever its precision.
"""

from __future__ import annotations

from itertools import product
from math import comb
from typing import Any

import mpmath
import numpy as np

from slefejax import View, slefe_table

DIGITS = 60
MP: Any = mpmath.MPContext()  # its own, so that nobody else's digits change
MP.dps = DIGITS
_MOST_PLACES = 150


def exact(values: Any) -> np.ndarray:
    """Numbers as they are."""
    array = np.asarray(values)
    flat = np.array([MP.mpf(float(x)) for x in array.ravel()], object)
    return flat.reshape(array.shape)


def screen_matrix(view: View) -> np.ndarray:
    """World to undivided pixels X, Y (from the lower left corner), window depth Z, and W, from the camera's numbers."""
    camera = view.camera
    eye, target, up = (exact(x) for x in (camera.eye, camera.target, camera.up))
    forward = _unit(target - eye)
    right = _unit(np.cross(forward, up))
    rotation = np.stack([right, np.cross(right, forward), -forward])
    near, far, size = (MP.mpf(float(x)) for x in (camera.near, camera.far, camera.extent))
    zero, one = MP.mpf(0), MP.mpf(1)
    if camera.perspective:
        scale = 1 / MP.tan((size * MP.pi / 180) / 2)
        depth, last = [(far + near) / (near - far), 2 * far * near / (near - far)], [zero, zero, -one, zero]
    else:
        scale = 2 / size
        depth, last = [2 / (near - far), (far + near) / (near - far)], [zero, zero, zero, one]
    aspect = MP.mpf(int(view.width)) / int(view.height)
    to_clip = np.array([[scale / aspect, 0, 0, 0], [0, scale, 0, 0], [0, 0, *depth], last], object)
    half = [MP.mpf(int(view.width)) / 2, MP.mpf(int(view.height)) / 2, MP.mpf("0.5")]
    rows = [half[k] * (to_clip[k] + to_clip[3]) for k in range(3)]
    to_screen = np.stack([*rows, to_clip[3]])
    return to_screen @ np.vstack([np.column_stack([rotation, -(rotation @ eye)]), [zero, zero, zero, one]])


def boxes(patches: np.ndarray, segments: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Lower and upper breakpoint values of the slefe ([YBP12], (6)), ``(patches, m_u+1, m_v+1, dim)``."""
    low, high = (np.moveaxis(end, 0, 2) for end in _enclose(np.moveaxis(patches, 2, 0), segments[1]))
    lower = np.moveaxis(_enclose(np.moveaxis(low, 1, 0), segments[0])[0], 0, 1)
    return lower, np.moveaxis(_enclose(np.moveaxis(high, 1, 0), segments[0])[1], 0, 1)


def widths(patches: np.ndarray, view: View, segments: tuple[int, int]) -> np.ndarray:
    """w of every patch in pixels ([YBP12], (8)) and in window depth, ``(patches, 2)``; -1 off-screen.

    Of rational patches as ``slefejax.screen_widths`` says.
    """
    matrix, near_w = screen_matrix(view), MP.mpf(float(view.camera.near_w))
    lower, upper = boxes(patches, segments)
    corners = np.stack([np.where(choice, upper, lower) for choice in product((0, 1), repeat=patches.shape[3])], axis=3)
    seen = _seen_tiles(_projected(corners, matrix), view)
    # from the picture's centre, so that a W that is raised to that of the near plane moves nothing sideways
    half = np.array([MP.mpf(int(view.width)) / 2, MP.mpf(int(view.height)) / 2, MP.mpf("0.5"), MP.mpf(0)])
    matrix = matrix - np.outer(half, matrix[3])
    if patches.shape[3] == 3:
        at = _projected(corners, matrix)
        w = np.where(at[..., 3] < near_w, near_w, at[..., 3])
        places = at[..., :3] / w[..., None]
        sides = places.max(axis=3) - places.min(axis=3)
    else:
        sides = _rational_sides(_projected(patches, matrix), segments, near_w)
    found = []
    for width in (sides[..., :2].max(axis=3), sides[..., 2]):
        tiles = [width[:, i : i + segments[0], j : j + segments[1]] for i, j in product((0, 1), repeat=2)]
        found.append(np.where(seen, np.stack(tiles).max(axis=0), MP.mpf(-1)).max(axis=(1, 2)))
    return np.stack(found, axis=1)


def outside(patches: np.ndarray, lower: np.ndarray, upper: np.ndarray, places: int = 2) -> tuple[np.ndarray, int]:
    """By how much each patch leaves the bilinear interpolants of its bounds, and how many of its numbers were compared.

    At breakpoints and at ``places`` more along each side of a tile, or some of them. 0 or less: not at all.
    """
    m_u, m_v = lower.shape[1] - 1, lower.shape[2] - 1
    every = list(product(range(m_u * (places + 1) + 1), range(m_v * (places + 1) + 1)))
    chosen = np.random.default_rng(0).permutation(len(every))[:_MOST_PLACES]
    excess = np.full(len(patches), MP.mpf("-inf"))
    for a, b in (every[k] for k in chosen):
        u, v = (MP.mpf(k) / (m * (places + 1)) for k, m in ((a, m_u), (b, m_v)))
        point = surface(patches, u, v)
        for bound, sign in ((lower, -1), (upper, 1)):
            over = (sign * (point - _bilinear(bound, u, v))).max(axis=1)
            excess = np.where(over > excess, over, excess)
    # what sixty digits cannot tell from 0 is 0
    size = np.abs(patches).max(axis=(1, 2, 3)) * MP.mpf(10) ** (10 - DIGITS)
    return np.where(np.abs(excess) <= size, MP.mpf(0), excess), 2 * patches.shape[3] * len(chosen)


def cell_error(patch: np.ndarray, view: View, n: int, u: float, v: float, rows: tuple[int, ...] = (0, 1)) -> Any:
    """The error at (u, v) on the n x n grid, the larger of both diagonals' (docs/math.md, 4).

    rows : 0 and 1 for pixels across and up, 2 for window depth
    """
    matrix, at = screen_matrix(view), (MP.mpf(float(u)), MP.mpf(float(v)))
    cell = [min(int(MP.floor(t * n)), n - 1) for t in at]
    a, b = (t * n - k for t, k in zip(at, cell, strict=True))

    def point(s: Any, t: Any) -> np.ndarray:
        return _projected(surface(patch[None], s, t), matrix)[0]

    p = [[point(MP.mpf(cell[0] + i) / n, MP.mpf(cell[1] + j) / n) for j in (0, 1)] for i in (0, 1)]
    if a >= b:
        rising = p[0][0] + a * (p[1][0] - p[0][0]) + b * (p[1][1] - p[1][0])
    else:
        rising = p[0][0] + b * (p[0][1] - p[0][0]) + a * (p[1][1] - p[0][1])
    if a + b <= 1:
        falling = p[0][0] + a * (p[1][0] - p[0][0]) + b * (p[0][1] - p[0][0])
    else:
        falling = p[1][1] + (1 - a) * (p[0][1] - p[1][1]) + (1 - b) * (p[1][0] - p[1][1])
    true = point(*at)
    return max(max(abs(true[k] / true[3] - drawn[k] / drawn[3]) for k in rows) for drawn in (rising, falling))


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / MP.sqrt(sum(x * x for x in vector))


def _projected(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """X, Y, Z, W of points with three or four coordinates, the last axis."""
    if points.shape[-1] == 4:
        return points @ matrix.T
    return points @ matrix[:, :3].T + matrix[:, 3]


def _enclose(coefficients: np.ndarray, segments: int) -> tuple[np.ndarray, np.ndarray]:
    """Breakpoint values along the first axis ([YBP12], (2))."""
    degree = len(coefficients) - 1
    lower, upper = [], []
    table = slefe_table(degree, segments) if degree > 1 else None
    for k in range(segments + 1):
        t = MP.mpf(k) / segments
        low = high = (1 - t) * coefficients[0] + t * coefficients[-1]
        for j in range(1, degree):
            assert table is not None
            second = coefficients[j - 1] - 2 * coefficients[j] + coefficients[j + 1]
            up, down = (MP.mpf(float(part[j - 1, k])) for part in (table.upper, table.lower))
            high = high + np.where(second > 0, second * up, second * down)
            low = low + np.where(second > 0, second * down, second * up)
        lower.append(low)
        upper.append(high)
    return np.stack(lower), np.stack(upper)


def _seen_tiles(corners: np.ndarray, view: View) -> np.ndarray:
    """The Q-test: whether the four boxes of a tile ``(patches, m_u+1, m_v+1, corners, 4)`` reach past every plane."""
    x, y, z, w = np.moveaxis(corners, -1, 0)
    seen = None
    for plane in (x, int(view.width) * w - x, y, int(view.height) * w - y, z, w - z):
        reach = plane.max(axis=3)
        tiles = np.stack(
            [reach[:, i : reach.shape[1] - 1 + i, j : reach.shape[2] - 1 + j] for i, j in product((0, 1), repeat=2)]
        )
        within = tiles.max(axis=0) >= 0
        seen = within if seen is None else seen & within
    return np.asarray(seen, bool)


def _rational_sides(screen: np.ndarray, segments: tuple[int, int], near_w: Any) -> np.ndarray:
    """Widths of the slefe of X - s W over W, s of each breakpoint, ``(patches, m_u+1, m_v+1, 3)``."""
    sides = np.empty((len(screen), segments[0] + 1, segments[1] + 1, 3), object)
    for i, j in product(range(segments[0] + 1), range(segments[1] + 1)):
        u, v = MP.mpf(i) / segments[0], MP.mpf(j) / segments[1]
        point = surface(screen, u, v)
        w = np.where(point[:, 3] < near_w, near_w, point[:, 3])
        for row in range(3):
            g = screen[..., row : row + 1] - (point[:, row] / w)[:, None, None, None] * screen[..., 3:]
            low, high = boxes(g, segments)
            sides[:, i, j, row] = (high - low)[:, i, j, 0] / w
    return sides


def surface(patches: np.ndarray, u: Any, v: Any) -> np.ndarray:
    """Points ``(patches, dim)`` of patches ``(patches, du+1, dv+1, dim)``."""
    along = np.tensordot(_bernstein(patches.shape[1] - 1, u), patches, (0, 1))
    return np.tensordot(_bernstein(patches.shape[2] - 1, v), along, (0, 1))


def _bernstein(degree: int, t: Any) -> np.ndarray:
    return np.array([comb(degree, j) * (1 - t) ** (degree - j) * t**j for j in range(degree + 1)], object)


def _bilinear(grid: np.ndarray, u: Any, v: Any) -> np.ndarray:
    """Interpolated values ``(patches, dim)`` of ``(patches, m_u+1, m_v+1, dim)``."""
    m = (grid.shape[1] - 1, grid.shape[2] - 1)
    i, j = (min(int(MP.floor(t * k)), k - 1) for t, k in zip((u, v), m, strict=True))
    a, b = u * m[0] - i, v * m[1] - j
    along = (1 - a) * grid[:, i] + a * grid[:, i + 1]
    return (1 - b) * along[:, j] + b * along[:, j + 1]
