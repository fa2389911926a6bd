"""Patches for ``slefejax attack`` that are shaded with tangent patches: no normals of their own, any pair of nets."""

from __future__ import annotations

from typing import Any

import numpy as np

Rng = np.random.Generator
_OFF_DECADES = -4.0, 0.3  # how far tangent patches are off derivatives, of their size


class Shaded:
    """Bézier patches and tangent patches beside them.

    net              : ``(patches, du+1, dv+1, 3)``
    along_u, along_v : ``(patches, du, dv+1, 3)`` and ``(patches, du+1, dv, 3)``
    """

    def __init__(self, net: Any, along_u: Any, along_v: Any) -> None:
        self.net, self.along_u, self.along_v = net, along_u, along_v

    def __len__(self) -> int:
        return len(self.net)

    def __getitem__(self, which: Any) -> Shaded:
        return Shaded(self.net[which], self.along_u[which], self.along_v[which])

    def astype(self, dtype: Any) -> Shaded:
        """In another precision."""
        return Shaded(*(own.astype(dtype) for own in (self.net, self.along_u, self.along_v)))

    def moved(self, scale: float, offset: np.ndarray) -> Shaded:
        """With another size, and then elsewhere."""
        return Shaded(self.net * scale + offset, self.along_u * scale, self.along_v * scale)

    def normals(self) -> dict[str, Any]:
        """How the package is asked for these."""
        return {"normals": "tangents", "tangents": (self.along_u, self.along_v)}


def shaded_nets(rng: Rng, net: np.ndarray) -> Shaded:
    """With tangent patches that are derivatives and more: half of them off by a part of each alone.

    Then what is 0 stays 0, and a side that is a point has none.
    """
    count, nu, nv, _ = net.shape
    nets = []
    for own in ((nu - 1) * np.diff(net, axis=1), (nv - 1) * np.diff(net, axis=2)):
        length = np.linalg.norm(own, axis=3, keepdims=True)
        mean = np.broadcast_to(length.mean(axis=(1, 2), keepdims=True), length.shape)
        size = np.where(rng.integers(0, 2, (count, 1, 1, 1)), length, mean)
        off = 10.0 ** rng.uniform(*_OFF_DECADES, (count, 1, 1, 1))
        nets.append(own + off * size * rng.normal(size=own.shape))
    return Shaded(net, *nets)
