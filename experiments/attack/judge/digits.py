"""Numbers as exact as they are given: with 60 digits, or in long double."""

from __future__ import annotations

from typing import Any

import mpmath
import numpy as np

MP: Any = mpmath.MPContext()  # its own, so that nobody else's digits change
MP.dps = 60


def long(values: Any) -> np.ndarray:
    """In long double."""
    return np.asarray(values).astype(np.longdouble)


def exact(values: Any) -> np.ndarray:
    """With 60 digits, an array of objects."""
    array = np.asarray(values)
    return np.array([MP.mpf(float(x)) for x in array.ravel()], object).reshape(array.shape)
