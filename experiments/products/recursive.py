"""Gaussian products by subdivision alone: vertices of a finer and finer mesh, on the host, in float64."""

from __future__ import annotations

from typing import Any

import numpy as np
from jaxtyping import Float

from slefejax.conversion.catmull_clark import refine
from slefejax.conversion.gaussian.products import Dual
from slefejax.model.gaussians import Gaussians
from slefejax.model.mesh import Mesh


class Recursive:
    """Steps of subdivision of q. Tables are made once, vertices again for every pose.

    mesh : with covariances;  level : how many steps
    """

    def __init__(self, mesh: Mesh, level: int) -> None:
        assert mesh.covariances is not None
        self._gaussians = Gaussians(mesh.vertices, mesh.covariances)
        self._dual = Dual.of(self._gaussians)
        self._tables: list[Any] = []
        for _ in range(level):
            mesh, table, _ = refine(mesh)
            self._tables.append(table)
        self.quads = mesh.face_count

    def vertices(self) -> Float[np.ndarray, "vertices 3"]:
        """Of the finest mesh."""
        q = self._dual(self._gaussians)
        for table in self._tables:
            q = table.on_host(q)
        matrix = q[:, [0, 1, 2, 1, 3, 4, 2, 4, 5]].reshape(-1, 3, 3)
        return np.linalg.solve(matrix, q[:, 6:, None])[..., 0] + self._dual.origin
