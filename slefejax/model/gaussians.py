"""Covariance meshes: a Gaussian at every vertex of a control mesh, its mean and how far the surface may be from it.

Sharp and semi-sharp features come from covariances alone: a flat Gaussian says that the surface is near to its plane, a
long one that it is near to its line [PBW19].
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from slefejax.arguments import check_positive, real_numbers
from slefejax.errors import InputError
from slefejax.model.mesh import Mesh

_ALIKE = 1e-9  # of the largest entry: both halves of a symmetric matrix that a file rounded
_SINGULAR = 64 * np.finfo(np.float64).eps  # of the largest eigenvalue: what is less is rounding
_ROUND = 0.05  # of the largest eigenvalue, which [PBW19]'s demo adds in every direction
_LOWER = ((0, 1, 2, 1, 2, 2), (0, 0, 0, 1, 1, 2))  # places of a lower triangle, column by column
_DIAGONAL = (0, 3, 5)


class Gaussians(NamedTuple):
    """Means ``(vertices, 3)``, scene units, and covariances ``(vertices, 3, 3)``, symmetric and positive definite."""

    means: Any
    covariances: Any


def with_gaussians(mesh: Mesh, gaussians: Any) -> Mesh:
    """The mesh with covariances.

    gaussians : ``(vertices, 3, 3)``, ``"infer"`` (``inferred``), or a radius: the same ball at every vertex (``balls``)

    Raises InputError for what is none of these.

    >>> square = Mesh.of([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]], [(0, 1, 2, 3)])
    >>> with_gaussians(square, 0.5).covariances[0].diagonal().tolist()
    [0.25, 0.25, 0.25]
    """
    if isinstance(gaussians, str):
        if gaussians != "infer":
            raise InputError(f"gaussians are 'infer', a radius or an array (vertices, 3, 3), not {gaussians!r}")
        return replace(mesh, covariances=inferred(mesh))
    if np.ndim(gaussians) == 0:
        return replace(mesh, covariances=balls(mesh.vertex_count, gaussians))
    return replace(mesh, covariances=check_covariances(gaussians, mesh.vertex_count))


def check_covariances(covariances: Any, vertices: int) -> Float[np.ndarray, "vertices 3 3"]:
    """Covariances in float64, made symmetric to the last bit.

    Raises InputError for another shape, numbers that are not finite, and what is not symmetric or not positive
    definite, with the number of the vertex.

    >>> check_covariances([np.diag([1.0, 2.0, 0.0])], 1)
    Traceback (most recent call last):
        ...
    slefejax.errors.InputError: the covariance of vertex 0 (counted from 0) is not positive definite: it has the \
eigenvalue 0
    """
    found = real_numbers(covariances, "covariances")
    if found.shape != (vertices, 3, 3):
        raise InputError(f"there are {vertices} vertices, so covariances must be ({vertices}, 3, 3), not {found.shape}")
    _refuse(np.logical_not(np.isfinite(found)).any(axis=(1, 2)), "has entries that are not finite numbers")
    turned = np.swapaxes(found, 1, 2)
    size = np.abs(found).max(axis=(1, 2))
    _refuse(np.asarray(np.abs(found - turned).max(axis=(1, 2)) > _ALIKE * size), "is not symmetric")
    found = 0.5 * found + 0.5 * turned
    scale = np.where(size > 0, size, 1.0)
    least = np.linalg.eigvalsh(found / scale[:, None, None])[:, 0]
    thin = least <= _SINGULAR
    first = int(np.argmax(thin))
    _refuse(thin, f"is not positive definite: it has the eigenvalue {least[first] * scale[first]:.3g}")
    return found


def _refuse(bad: Any, why: str) -> None:
    if bad.any():
        more = f" ({bad.sum()} such vertices)" if bad.sum() > 1 else ""
        raise InputError(f"the covariance of vertex {np.argmax(bad)} (counted from 0) {why}{more}")


def balls(vertices: int, radius: Any) -> Float[np.ndarray, "vertices 3 3"]:
    """The same Gaussian in every direction at every vertex: radius^2 times the identity.

    >>> balls(2, 3.0)[1].diagonal().tolist()
    [9.0, 9.0, 9.0]
    """
    check_positive("a radius of Gaussians", radius)
    return np.tile(np.eye(3) * float(radius) ** 2, (vertices, 1, 1))


def inferred(mesh: Mesh) -> Float[np.ndarray, "vertices 3 3"]:
    """Covariances that a mesh's own shape suggests, as the public demo of [PBW19] does.

    A face has the covariance of its vertices plus .05 of its largest eigenvalue in every direction; the inverse of a
    vertex's is the sum of its faces' inverses. Vertices of no face get the mean of the others.

    Raises InputError for a face whose vertices coincide.

    >>> square = Mesh.of([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]], [(0, 1, 2, 3)])
    >>> inferred(square)[0].diagonal().round(9).tolist()
    [1.05, 1.05, 0.05]
    """
    weights = (1.0 / mesh.sizes)[mesh.face]
    centre = np.stack([np.bincount(mesh.face, weights * x[mesh.corners]) for x in mesh.vertices.T], axis=1)
    away = mesh.vertices[mesh.corners] - centre[mesh.face]
    products = (away[:, :, None] * away[:, None, :] * weights[:, None, None]).reshape(-1, 9)
    spread = np.stack([np.bincount(mesh.face, own) for own in products.T], axis=1).reshape(-1, 3, 3)
    largest = np.linalg.eigvalsh(spread)[:, 2]
    points = np.flatnonzero(~(largest > 0))
    if points.size:
        raise InputError(
            f"no covariance can be inferred from face {mesh.numbers[points[0]]} (counted from 0), whose vertices"
            " coincide: leave it out, or give gaussians"
        )
    inverse = np.linalg.inv(spread + _ROUND * largest[:, None, None] * np.eye(3)).reshape(-1, 9)
    sums = [np.bincount(mesh.corners, own[mesh.face], minlength=mesh.vertex_count) for own in inverse.T]
    precision = np.stack(sums, axis=1).reshape(-1, 3, 3)
    used = mesh.valence > 0
    found = np.empty_like(precision)
    found[used] = np.linalg.inv(precision[used])
    found[~used] = found[used].mean(axis=0)
    return 0.5 * found + 0.5 * np.swapaxes(found, 1, 2)


def covariances(parameters: Any) -> Any:
    """``(..., 3, 3)`` positive definite matrices of any numbers ``(..., 6)``, by JAX; differentiable.

    L L^T with a lower triangular L: its entries column by column, logarithms on the diagonal. For optimisation, which
    must not leave positive definite matrices; ``covariance_parameters`` is the inverse.

    >>> covariances(np.zeros(6)).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    parameters = jnp.asarray(parameters)
    if parameters.ndim == 0 or parameters.shape[-1] != 6:
        raise InputError(f"covariances have six parameters each, (..., 6), not {parameters.shape}")
    a, b, c, d, e, f = (jnp.exp(x) if k in _DIAGONAL else x for k, x in enumerate(jnp.moveaxis(parameters, -1, 0)))
    zero = jnp.zeros_like(a)
    rows = [[a, zero, zero], [b, d, zero], [c, e, f]]
    lower = jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
    return lower @ jnp.swapaxes(lower, -1, -2)


def covariance_parameters(matrices: Float[Any, "*rest 3 3"]) -> Float[np.ndarray, "*rest 6"]:
    """Parameters ``(..., 6)`` of positive definite matrices (``covariances``), in float64 on the host.

    >>> covariance_parameters(np.diag([1.0, 4.0, 9.0])).round(3).tolist()
    [0.0, 0.0, 0.0, 0.693, 0.0, 1.099]
    """
    given = real_numbers(matrices, "covariances")
    if given.shape[-2:] != (3, 3):
        raise InputError(f"covariances must be (..., 3, 3), not {given.shape}")
    checked = check_covariances(given.reshape(-1, 3, 3), given.size // 9)
    found = np.linalg.cholesky(checked)[:, _LOWER[0], _LOWER[1]]
    found[:, _DIAGONAL] = np.log(found[:, _DIAGONAL])
    return found.reshape(*given.shape[:-2], 6)
