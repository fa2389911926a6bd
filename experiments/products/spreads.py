"""Covariances to try a method with: any condition number, in several orientations."""

from __future__ import annotations

import numpy as np
from jaxtyping import Float

from slefejax.model.mesh import Mesh

ORIENTATIONS = ("flat", "long", "aligned")
_AXIS = np.array([1.0, 2.0, 3.0]) / np.sqrt(14.0)  # of aligned ones: none of the coordinates'


def spread(mesh: Mesh, orientation: str, condition: float) -> Float[np.ndarray, "vertices 3 3"]:
    """Covariances of that condition number, of largest eigenvalue 1.

    orientation : ``"flat"``, discs across the normals of vertices; ``"long"``, needles in the tangent planes;
                  ``"aligned"``, discs that are parallel but for angles of about 1 / condition, which is what makes the
                  products differ from the means' own surface

    >>> square = Mesh.of([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]], [(0, 1, 2, 3)])
    >>> spread(square, "flat", 100.0)[0].diagonal().round(9).tolist()
    [1.0, 1.0, 0.01]
    """
    normal = vertex_normals(mesh)
    if orientation == "aligned":
        normal = _AXIS + np.random.default_rng(0).normal(size=normal.shape) / condition
        normal = normal / np.linalg.norm(normal, axis=1, keepdims=True)
    thin = 1.0 / condition
    if orientation != "long":
        return np.eye(3) - (1.0 - thin) * normal[:, :, None] * normal[:, None, :]
    axis = np.eye(3)[np.argmin(np.abs(normal), axis=1)]
    along = np.cross(normal, axis)
    along = along / np.linalg.norm(along, axis=1, keepdims=True)
    return thin * np.eye(3) + (1.0 - thin) * along[:, :, None] * along[:, None, :]


def vertex_normals(mesh: Mesh) -> Float[np.ndarray, "vertices 3"]:
    """Unit sums of the normals of all corners, by their area; along z where that is 0."""
    here, before = mesh.vertices[mesh.corners], mesh.vertices[mesh.corners[mesh.prev_corner]]
    across = np.cross(mesh.vertices[mesh.ends] - here, before - here)
    total = np.stack([np.bincount(mesh.corners, x, minlength=mesh.vertex_count) for x in across.T], axis=1)
    length = np.linalg.norm(total, axis=1, keepdims=True)
    return np.where(length > 0, total / np.where(length > 0, length, 1.0), [0.0, 0.0, 1.0])


def median_condition(covariances: Float[np.ndarray, "vertices 3 3"]) -> float:
    """Of the vertices' condition numbers."""
    own = np.linalg.eigvalsh(covariances)
    return float(np.median(own[:, 2] / own[:, 0]))
