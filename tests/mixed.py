"""A closed surface of patches of bi-degrees 3 x 3, 4 x 4 and 5 x 4, as a .bv file has it; what is drawn of it."""

from __future__ import annotations

from typing import Any

import numpy as np

from slefejax.geometry.bezier import elevate
from tests.test_edges import SYMMETRIES

BI_DEGREES = ((3, 3), (4, 4), (5, 4))


def cube_sphere(rng: np.random.Generator, side: int = 2) -> list[np.ndarray]:
    """Six faces of side x side patches on about the unit sphere, each laid some way and of one of BI_DEGREES.

    All sides are cubics through points of the sphere, and so the same for both neighbours but for rounding; inside,
    patches of higher degrees are moved so that no lower one would do.
    """
    ways = list(SYMMETRIES.values())
    patches = []
    for axis in range(3):
        for sign in (-1.0, 1.0):
            for i, j in np.ndindex(side, side):
                patch = _interpolated(axis, sign, np.array([i, j]) / side, 1.0 / side)
                patch = ways[rng.integers(len(ways))](patch)
                du, dv = BI_DEGREES[len(patches) % 3]
                patch = np.swapaxes(elevate(np.swapaxes(elevate(patch, du), 0, 1), dv), 0, 1)
                if (du, dv) != (3, 3):
                    patch[1:-1, 1:-1] += rng.normal(scale=0.05 / side, size=patch[1:-1, 1:-1].shape)
                patches.append(patch)
    return patches


def _interpolated(axis: int, sign: float, corner: np.ndarray, width: float) -> np.ndarray:
    """The bicubic patch through 4 x 4 points of the sphere over a square of a cube's face, outwards if u x v is."""
    t = np.arange(4) / 3.0
    x, y = np.meshgrid(*(2.0 * (corner[k] + width * t) - 1.0 for k in (0, 1)), indexing="ij")
    cube = np.empty((4, 4, 3))
    cube[..., axis], cube[..., (axis + 1) % 3], cube[..., (axis + 2) % 3] = sign, x, y
    sphere = cube / np.linalg.norm(cube, axis=-1, keepdims=True)
    inverse = np.linalg.inv([[(1 - s) ** 3, 3 * (1 - s) ** 2 * s, 3 * (1 - s) * s**2, s**3] for s in t])
    return np.einsum("ai,bj,ijc->abc", inverse, inverse, sphere)


def as_bv(patches: list[np.ndarray], number: str = "{:.6f}") -> str:
    """The text of a .bv file; kinds 5 and, rational, 8."""
    lines = []
    for patch in patches:
        lines += ["5" if patch.shape[2] == 3 else "8", f"{patch.shape[0] - 1} {patch.shape[1] - 1}"]
        lines += [" ".join(number.format(x) for x in point) for point in patch.reshape(-1, patch.shape[2]).tolist()]
    return "\n".join(lines) + "\n"


def boundaries(found: Any, numbers: np.ndarray) -> dict[int, list[np.ndarray]]:
    """Of every number of a side the clip-space positions on it, sorted, as each patch that has it drew them.

    found : captured triangles
    """
    sides = [np.isin(found.parameters[..., axis], end) for end, axis in ((0.0, 0), (0.0, 1), (1.0, 0), (1.0, 1))]
    positions: dict[int, list[np.ndarray]] = {}
    for (patch, side), number in np.ndenumerate(numbers):
        points = found.clip[sides[side] & (found.patch == patch)[:, None]]
        positions.setdefault(int(number), []).append(np.unique(points, axis=0))
    return positions


def in_perspective(patch: np.ndarray) -> np.ndarray:
    """A polynomial patch seen through a lens: homogeneous points by one matrix, so sides that are one stay one."""
    matrix = np.eye(4)
    matrix[3] = [0.2, 0.1, -0.25, 1.0]
    return np.concatenate([patch, np.ones_like(patch[..., :1])], axis=-1) @ matrix.T


def open_edges(found: Any) -> int:
    """Edges of captured triangles, told by their positions, that not exactly two triangles have."""
    _, number = np.unique(found.clip.reshape(-1, 4) + np.float32(0), axis=0, return_inverse=True)
    a, b, c = number.reshape(-1, 3).T
    ends = np.sort(np.concatenate([np.stack(pair, axis=1) for pair in ((a, b), (b, c), (c, a))]), axis=1)
    _, count = np.unique(ends[ends[:, 0] != ends[:, 1]], axis=0, return_counts=True)
    return int(np.sum(count != 2))
