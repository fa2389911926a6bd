"""The Utah teapot [New75] as 32 bicubic patches, z up, in its customary size of 6.525 x 4 x 3.15.

Rim, body, lid and bottom are profiles turned about the z axis; handle and spout are half sections, mirrored in
the plane y = 0. A profile point (r, t, z) stands for one row of control points of a quarter turn,
(r, 0), (r, t), (t, r), (0, r) in the plane of height z: a circular arc nearly, t = 0.56 r almost everywhere.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

RIM = [(1.4, 0.784, 2.4), (1.3375, 0.749, 2.53125), (1.4375, 0.805, 2.53125), (1.5, 0.84, 2.4)]
UPPER_BODY = [(1.5, 0.84, 2.4), (1.75, 0.98, 1.875), (2.0, 1.12, 1.35), (2.0, 1.12, 0.9)]
LOWER_BODY = [(2.0, 1.12, 0.9), (2.0, 1.12, 0.45), (1.5, 0.84, 0.225), (1.5, 0.84, 0.15)]
KNOB = [(0.0, 0.0, 3.15), (0.8, 0.45, 3.15), (0.0, 0.0, 2.85), (0.2, 0.112, 2.7)]
LID = [(0.2, 0.112, 2.7), (0.4, 0.224, 2.55), (1.3, 0.728, 2.55), (1.3, 0.728, 2.4)]
BOTTOM = [(0.0, 0.0, 0.0), (1.425, 0.798, 0.0), (1.5, 0.84, 0.075), (1.5, 0.84, 0.15)]

# Half sections: rows of (x, z) at the first and the last column, and |y| of the two columns between them.
HANDLE_TOP = [
    ((-1.6, 2.025), (-1.5, 2.25), 0.3),
    ((-2.3, 2.025), (-2.5, 2.25), 0.3),
    ((-2.7, 2.025), (-3.0, 2.25), 0.3),
    ((-2.7, 1.8), (-3.0, 1.8), 0.3),
]
HANDLE_BOTTOM = [
    ((-2.7, 1.8), (-3.0, 1.8), 0.3),
    ((-2.7, 1.575), (-3.0, 1.35), 0.3),
    ((-2.5, 1.125), (-2.65, 0.9375), 0.3),
    ((-2.0, 0.9), (-1.9, 0.6), 0.3),
]
SPOUT_BASE = [
    ((1.7, 1.425), (1.7, 0.6), 0.66),
    ((2.6, 1.425), (3.1, 0.825), 0.66),
    ((2.3, 2.1), (2.4, 2.025), 0.25),
    ((2.7, 2.4), (3.3, 2.4), 0.25),
]
SPOUT_TIP = [
    ((2.7, 2.4), (3.3, 2.4), 0.25),
    ((2.8, 2.475), (3.525, 2.49375), 0.25),
    ((2.9, 2.475), (3.45, 2.5125), 0.15),
    ((2.8, 2.4), (3.2, 2.4), 0.15),
]

EYE, TARGET = (4.5, -6.0, 4.0), (0.0, 0.0, 1.2)


def _quarter_turns(profile: list[tuple[float, float, float]], clockwise: bool) -> list[np.ndarray]:
    """Four patches about the z axis; u runs down the profile, v around, the way that makes normals consistent."""
    sign = -1.0 if clockwise else 1.0
    first = np.array([[(r, 0.0, z), (r, sign * t, z), (t, sign * r, z), (0.0, sign * r, z)] for r, t, z in profile])
    quarter = np.array([[0.0, -sign, 0.0], [sign, 0.0, 0.0], [0.0, 0.0, 1.0]])
    turns = [first]
    for _ in range(3):
        turns.append(turns[-1] @ quarter.T)
    return turns


def _mirrored_halves(sections: list[tuple]) -> list[np.ndarray]:
    """The half at y <= 0 and its mirror image, whose columns run the other way."""
    half = np.array(
        [[(a[0], 0.0, a[1]), (a[0], -y, a[1]), (b[0], -y, b[1]), (b[0], 0.0, b[1])] for a, b, y in sections]
    )
    return [half, (half * [1.0, -1.0, 1.0])[:, ::-1]]


def teapot() -> Float[np.ndarray, "32 4 4 3"]:
    """Control points ``(32, 4, 4, 3)``: rim, body, handle, spout, lid, bottom.

    >>> teapot().shape
    (32, 4, 4, 3)
    """
    parts = [_quarter_turns(profile, True) for profile in (RIM, UPPER_BODY, LOWER_BODY)]
    parts += [_mirrored_halves(part) for part in (HANDLE_TOP, HANDLE_BOTTOM, SPOUT_BASE, SPOUT_TIP)]
    parts += [_quarter_turns(profile, True) for profile in (KNOB, LID)]
    parts += [_quarter_turns(BOTTOM, False)]
    # adding 0 turns the -0.0 of the rotations into 0.0
    return np.array([patch for part in parts for patch in part]) + 0.0
