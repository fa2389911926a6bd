"""Nets of Gaussian products for ``slefejax attack``: bicubic nets of q, and the rational patches that are asked about.

The judge takes points from q (docs/conversion.md) and knows no rational net, so that a factor for another surface
than that of q is found out. What rounding control points adds counts.
"""

from __future__ import annotations

from typing import Any

import jax
import numpy as np

from slefejax.conversion.gaussian.products import rational_net

Rng = np.random.Generator
_STRETCH_DECADES = 4.0  # of covariances
_UPPER = np.triu_indices(3)
_FULL = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])


@jax.tree_util.register_pytree_node_class
class ProductNets:
    """Bicubic nets of q, and where their surfaces lie: scale Q^-1 h + offset, all numbers exact.

    gaussians : ``(patches, 4, 4, 9)``, the entries 11, 12, 13, 22, 23, 33 of Q, then h
    scale, offset : ``(patches,)`` and ``(patches, 3)``
    """

    def __init__(self, gaussians: Any, scale: Any = None, offset: Any = None) -> None:
        self.gaussians = gaussians
        self.scale = np.ones(len(gaussians)) if scale is None else scale
        self.offset = np.zeros((len(gaussians), 3)) if offset is None else offset

    def __len__(self) -> int:
        return len(self.gaussians)

    def __getitem__(self, which: Any) -> ProductNets:
        return ProductNets(self.gaussians[which], self.scale[which], self.offset[which])

    def tree_flatten(self) -> tuple[Any, None]:
        """For JAX."""
        return (self.gaussians, self.scale, self.offset), None

    @classmethod
    def tree_unflatten(cls, _: None, children: Any) -> ProductNets:
        """For JAX."""
        return cls(*children)

    def astype(self, dtype: Any) -> Any:
        """In single precision the rational patches: rounded, they are no product of these Gaussians any more."""
        return self if dtype == np.float64 else self.patches().astype(dtype)

    def moved(self, scale: float, offset: np.ndarray) -> ProductNets:
        """With another size, and then elsewhere; once, since that is rounded."""
        return ProductNets(self.gaussians, self.scale * scale, self.offset * scale + offset)

    def stepped(self, rng: Rng, size: np.ndarray) -> ProductNets:
        """Means moved, and covariances sheared, by normal numbers times a size ``(patches, 4, 4, 1)``."""
        q = self.gaussians
        shear = np.eye(3) + size[..., None] * rng.normal(size=(*q.shape[:3], 3, 3))
        matrix = q[..., _FULL]
        means = np.linalg.solve(matrix, q[..., 6:, None])[..., 0] + size * rng.normal(size=(*q.shape[:3], 3))
        return ProductNets(_of(shear @ matrix @ np.swapaxes(shear, -1, -2), means), self.scale, self.offset)

    def patches(self) -> np.ndarray:
        """The package's rational patches, which are asked about."""
        net = np.moveaxis(rational_net(np.moveaxis(self.gaussians, 0, -1)), -1, 0)
        net /= 2.0 ** np.round(np.log2(net[..., 3].max(axis=(1, 2))))[:, None, None, None]
        placed = self.scale[:, None, None, None] * net[..., :3] + self.offset[:, None, None] * net[..., 3:]
        return np.concatenate([placed, net[..., 3:]], axis=-1)


def product_nets(rng: Rng, means: np.ndarray) -> ProductNets:
    """Of nets of means ``(n, 4, 4, 3)``: Gaussians flat, long or round, those of a net turned nearly alike or not."""
    count = len(means)
    sizes = 10.0 ** (
        rng.uniform(-_STRETCH_DECADES, _STRETCH_DECADES, (count, 1)) * np.eye(3)[rng.integers(0, 3, count)]
    )
    apart = 10.0 ** rng.uniform(-4.0, 1.0, (count, 1, 1, 1, 1))
    turns = np.linalg.qr(np.eye(3) + apart * rng.normal(size=(count, 4, 4, 3, 3)))[0]
    inverse = (turns * sizes[:, None, None, None]) @ np.swapaxes(turns, -1, -2)
    return ProductNets(_of(inverse * rng.uniform(0.5, 2.0, (count, 4, 4, 1, 1)), means))


def _of(matrix: np.ndarray, means: np.ndarray) -> np.ndarray:
    """q ``(..., 9)`` of matrices Q, symmetric but for rounding, and means."""
    return np.concatenate([matrix[..., *_UPPER], (matrix @ means[..., None])[..., 0]], axis=-1)
