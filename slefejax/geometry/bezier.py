"""Polynomials and tensor-product patches in Bernstein-Bézier form (docs/math.md, 1).

Coefficients run along the first axes: a curve is ``(d+1, ...)``, a patch ``(du+1, dv+1, ...)``,
u before v. Whatever follows (coordinates, many patches) is carried along, so the same functions
serve one patch, a batch with the patches last, and scalar functions.
"""

from __future__ import annotations

from itertools import pairwise
from math import comb
from typing import Any

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Shaped

HIGHEST_DEGREE = 64  # of what is read, and of slefes
Values = Any  # numbers or arrays, NumPy or JAX, that broadcast


def bernstein(degree: int, t: Values) -> list[Values]:
    """The Bernstein polynomials b_j(t) = C(d, j) (1-t)^(d-j) t^j, j = 0 ... d, of docs/math.md, 1.

    ``t`` may have any shape; the result is a list of ``degree + 1`` arrays of that shape.

    >>> [float(b) for b in bernstein(2, np.array(0.5))]
    [0.25, 0.5, 0.25]
    """
    s = 1 - t
    rising, falling = [t * 0 + 1], [t * 0 + 1]
    for _ in range(degree):
        rising.append(rising[-1] * t)
        falling.append(falling[-1] * s)
    return [comb(degree, j) * (rising[j] * falling[degree - j]) for j in range(degree + 1)]


def combine(coefficients: Values, basis: list[Values]) -> Values:
    """The sum of coefficients[j] * basis[j] over the first axis.

    >>> float(combine(np.array([1.0, 2.0]), [0.25, 0.75]))
    1.75
    """
    total = coefficients[0] * basis[0]
    for c, b in zip(coefficients[1:], basis[1:], strict=True):
        total = total + c * b
    return total


def evaluate_curve(coefficients: Float[Array | np.ndarray, "n *rest"], t: Values) -> Values:
    """p(t) = sum_j c_j b_j(t) for coefficients ``(d+1, *rest)``; ``t`` broadcasts against ``rest``.

    >>> float(evaluate_curve(np.array([0.0, 0.0, 1.0]), np.array(0.5)))
    0.25
    """
    return combine(coefficients, bernstein(coefficients.shape[0] - 1, t))


def evaluate_patch(coefficients: Float[Array | np.ndarray, "nu nv *rest"], u: Values, v: Values) -> Values:
    """p(u, v) = sum_ij c_ij b_i(u) b_j(v) ([YBP12], (5)) for coefficients ``(du+1, dv+1, *rest)``.

    ``u`` and ``v`` broadcast against ``rest``: with one patch ``(du+1, dv+1, 3, 1)`` and parameters
    ``(n,)`` the result is ``(3, n)``.

    >>> bilinear = np.array([[0.0, 0.0], [0.0, 1.0]])[..., None]
    >>> evaluate_patch(bilinear, 0.5, 0.5).tolist()
    [0.25]
    """
    across = bernstein(coefficients.shape[1] - 1, v)
    rows = [combine(row, across) for row in coefficients]
    return combine(rows, bernstein(coefficients.shape[0] - 1, u))


def second_differences(coefficients: Shaped[Array | np.ndarray, "n *rest"]) -> Values:
    """The second differences c_(j-1) - 2 c_j + c_(j+1), j = 1 ... d-1, along the first axis (docs/math.md, 2).

    >>> second_differences(np.array([0.0, 0.0, 1.0, 4.0])).tolist()
    [1.0, 2.0]
    """
    return (coefficients[:-2] - coefficients[1:-1]) + (coefficients[2:] - coefficients[1:-1])


def derivative(coefficients: Float[Array | np.ndarray, "n *rest"]) -> Values:
    """Coefficients of p' along the first axis: d (c_(j+1) - c_j), degree d-1.

    >>> derivative(np.array([0.0, 1.0, 4.0])).tolist()
    [2.0, 6.0]
    """
    return (coefficients.shape[0] - 1) * (coefficients[1:] - coefficients[:-1])


def elevate(coefficients: Float[np.ndarray, "n *rest"], degree: int) -> Float[np.ndarray, "m *rest"]:
    """The same polynomial along the first axis with ``degree`` at least its own.

    End coefficients are kept exactly, and elevating the reversed coefficients gives the reversed
    result bit for bit, so neighbouring patches stay equal along their edge.

    >>> elevate(np.array([0.0, 2.0]), 2)
    array([0., 1., 2.])
    """
    while coefficients.shape[0] - 1 < degree:
        n = coefficients.shape[0]
        share = np.arange(1, n).reshape((-1,) + (1,) * (coefficients.ndim - 1))
        before, after = coefficients[:-1], coefficients[1:]
        # equal neighbours stay as they are, so that a collapsed edge stays one
        inner = np.where(before == after, before, (share / n) * before + ((n - share) / n) * after)
        coefficients = np.concatenate([coefficients[:1], inner, coefficients[-1:]])
    return coefficients


def restrict(coefficients: Float[Array | np.ndarray, "n *rest"], start: Values, end: Values) -> Values:
    """Coefficients of t -> p(start + t (end - start)) along the first axis, by blossoming (de Casteljau).

    Coefficient j is the blossom of p with d-j arguments ``start`` and j arguments ``end``.

    >>> restrict(np.array([0.0, 0.0, 1.0]), 0.0, 0.5).tolist()  # t^2 on the first half
    [0.0, 0.0, 0.25]
    """
    degree = coefficients.shape[0] - 1
    xp = np if isinstance(coefficients, np.ndarray) else jnp
    return xp.stack([_blossom(coefficients, [start] * (degree - j) + [end] * j) for j in range(degree + 1)])


def _blossom(coefficients: Values, arguments: list[Values]) -> Values:
    for t in arguments:
        coefficients = (1 - t) * coefficients[:-1] + t * coefficients[1:]
    return coefficients[0]


def from_triangle(points: Float[np.ndarray, "n *rest"], degree: int) -> Float[np.ndarray, "nu nv *rest"]:
    """A triangular Bézier patch as a tensor-product one of bi-degree (d, d) whose side u = 1 is a point; exact.

    points : ``((d+1)(d+2)/2, ...)``, row by row: d+1 points of the side u = 0 first, the opposite corner last

    With barycentric coordinates ((1-u) v, (1-u)(1-v), u), row k is a curve of degree d - k in v, raised to d. The
    winding of the corners stays as it is, so v runs against the rows.

    >>> from_triangle(np.array([0.0, 1.0, 5.0]), 1).tolist()
    [[1.0, 0.0], [5.0, 5.0]]
    """
    starts = [row * (degree + 1) - row * (row - 1) // 2 for row in range(degree + 2)]
    return np.stack([elevate(points[a:b][::-1], degree) for a, b in pairwise(starts)])


def tile_matrices(nu: int, nv: int, tiles: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrices that restrict coefficients to every tile, along u and along v, ``(tiles^2, d+1, d+1)``.

    >>> u, v = tile_matrices(2, 2, 2)
    >>> u.shape, (u[0] @ [0.0, 1.0]).tolist(), (u[3] @ [0.0, 1.0]).tolist()
    ((4, 2, 2), [0.0, 0.5], [0.5, 1.0])
    """
    along = [[restrict(np.eye(n), k / tiles, (k + 1) / tiles) for k in range(tiles)] for n in (nu, nv)]
    pairs = [(u, v) for u in along[0] for v in along[1]]
    return np.stack([u for u, _ in pairs]), np.stack([v for _, v in pairs])
