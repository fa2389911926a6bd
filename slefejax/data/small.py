"""Two patches on which the published estimate fails, and where to look at them from."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

QUAD_TARGET = (3.0, 3.0, 0.0)
QUAD_EYE = (3.0, 3.0, 4.5 * (1.0 + 2.0**0.5))  # 9 units fill the height of a picture of 45 degrees
STEEP_EYE, STEEP_TARGET, STEEP_FOV = (0.0, -0.9, 0.8), (0.0, 2.0, 0.0), 75.0


def twisted_quad() -> Float[np.ndarray, "1 2 2 3"]:
    """A flat quad with sides of 5 and one of 7.5: no second differences, but a twist (docs/math.md, 5).

    >>> twisted_quad().shape
    (1, 2, 2, 3)
    """
    return np.array([[[[0.0, 0.0, 0.0], [0.0, 5.0, 0.0]], [[5.0, 0.0, 0.0], [7.5, 5.0, 0.0]]]])


def steep_patch() -> Float[np.ndarray, "1 4 4 3"]:
    """A low bicubic wave that runs from the camera's feet into the distance.

    >>> steep_patch().shape
    (1, 4, 4, 3)
    """
    u, v = np.meshgrid(np.linspace(-1.0, 1.0, 4), np.linspace(0.0, 8.0, 4), indexing="ij")
    heights = np.array([[0.0, 0.2, -0.2, 0.0], [0.1, -0.3, 0.4, 0.1], [0.0, 0.3, -0.2, 0.2], [0.1, -0.1, 0.2, 0.0]])
    return np.stack([u, v, heights], axis=2)[None]
