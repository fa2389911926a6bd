"""Control nets of many patches, in one of two forms.

Unrolled, a net is a NumPy array of objects ``(nu, nv)``, each of them lanes: one array ``(lanes,)`` a coefficient. The
CPU runs that faster than larger arrays, but the compiler takes longer the more coefficients there are, and for reverse
mode forever. As an array, a net is ``(nu, nv, lanes)``: slower, and compiled in a second whatever the degree.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from math import comb, perm
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array

from slefejax.lanes.maxima import EXACT, Maxima, larger, root, smaller, smallest_along
from slefejax.lanes.tuning import TUNING

Lanes = Array  # (lanes,)
Net = Array | np.ndarray  # (nu, nv, lanes), or (nu, nv) of (lanes,)


def coordinates(control: Array | np.ndarray, unrolled: bool) -> list[Net]:
    """One net for every coordinate of ``(nu, nv, dim, lanes)``.

    >>> [net.shape for net in coordinates(jnp.zeros((4, 3, 3, 16)), unrolled=True)]
    [(4, 3), (4, 3), (4, 3)]
    """
    nu, nv, dim, _ = control.shape
    if unrolled:
        return [objects([[control[i, j, a] for j in range(nv)] for i in range(nu)]) for a in range(dim)]
    return [control[:, :, a] for a in range(dim)]


def objects(rows: Sequence[Sequence[Any]]) -> Net:
    """An unrolled net, of coefficients row by row.

    >>> objects([[1, 2], [3, 4]]).shape
    (2, 2)
    """
    net = np.empty((len(rows), len(rows[0])), object)
    for place in np.ndindex(*net.shape):
        net[place] = rows[place[0]][place[1]]
    return net


def unrolled(net: Net) -> bool:
    """Whether a net is in that form.

    >>> unrolled(objects([[1, 2]])), unrolled(np.zeros((1, 2, 16)))
    (True, False)
    """
    return net.dtype == object


def each(function: Callable[..., Any], *nets: Net) -> Net:
    """The function of corresponding coefficients.

    >>> each(lambda a, b: a + b, objects([[1, 2]]), objects([[10, 20]])).tolist()
    [[11, 22]]
    """
    if unrolled(nets[0]):
        return np.frompyfunc(function, len(nets), 1)(*nets)
    return function(*nets)


def top(net: Net, maxima: Maxima = EXACT) -> Lanes:
    """The largest coefficient; softly only of an array that is not negative (``lanes.maxima``).

    >>> top(jnp.arange(4.0).reshape(2, 2, 1)).tolist()
    [3.0]
    """
    return _tree(larger, net) if unrolled(net) else maxima.largest_along(jnp.asarray(net), (0, 1))


def bottom(net: Net) -> Lanes:
    """The smallest coefficient.

    >>> bottom(jnp.arange(4.0).reshape(2, 2, 1)).tolist()
    [0.0]
    """
    return _tree(smaller, net) if unrolled(net) else smallest_along(jnp.asarray(net), (0, 1))


def size(net: Net) -> int:
    """How many coefficients there are; 0 for a derivative that is identically 0 by degree.

    >>> size(np.zeros((4, 3, 16)))
    12
    """
    return net.shape[0] * net.shape[1]


def degrees(net: Net) -> tuple[int, int]:
    """Degrees along u and v.

    >>> degrees(np.zeros((4, 3, 16)))
    (3, 2)
    """
    return net.shape[0] - 1, net.shape[1] - 1


def derivative(net: Net, i: int, j: int) -> Net:
    """Coefficients of the derivative, i times by u and j times by v; none if it is identically 0 by degree.

    >>> parabola = jnp.array([0.0, 0.0, 1.0]).reshape(3, 1, 1)  # u^2
    >>> derivative(parabola, 2, 0).ravel().tolist()
    [2.0]
    """
    (du, dv), found = degrees(net), differences(net, i, j)
    scale = perm(du, i) * perm(dv, j)
    return found * scale if size(found) and scale != 1 else found


def differences(net: Net, i: int, j: int) -> Net:
    """Differences of neighbours, i times along u and j times along v; none if there are too few coefficients.

    >>> differences(jnp.array([0.0, 1.0, 4.0]).reshape(3, 1, 1), 1, 0).ravel().tolist()
    [1.0, 3.0]
    """
    for _ in range(i):
        net = net[1:] - net[:-1]
    for _ in range(j):
        net = net[:, 1:] - net[:, :-1]
    return net


def raised(net: Net, du: int, dv: int) -> Net:
    """The same polynomials with higher degrees.

    >>> raised(jnp.array([0.0, 2.0]).reshape(2, 1, 1), 2, 0).ravel().tolist()
    [0.0, 1.0, 2.0]
    """
    # numbers of Python's own, which leave single precision as it is
    return combined(net, *(_raising(low, high).tolist() for low, high in zip(degrees(net), (du, dv), strict=True)))


def combined(net: Net, u: Any, v: Any) -> Net:
    """u times the net times v transposed, for matrices of numbers or, unrolled, of lanes.

    >>> combined(objects([[1.0, 2.0]]), [[3.0]], [[1.0, 1.0]]).tolist()
    [[9.0]]
    """
    if not unrolled(net):
        u, v = (jnp.asarray(x, net.dtype) for x in (u, v))
        return jnp.einsum("ia,jb,abl->ijl", u, v, net, precision=jax.lax.Precision.HIGHEST)
    rows = [[_weighted(line, column) for column in net.T] for line in u]
    return objects([[_weighted(line, row) for line in v] for row in rows])


def restricting(count: int, low: Lanes, high: Lanes) -> list[list[Lanes]]:
    """The matrix of lanes that restricts a curve of so many coefficients to low ... high.

    Row k is the blossom's, with k arguments ``high`` and the others ``low``.

    >>> [[x.item() for x in row] for row in restricting(2, jnp.array(0.0), jnp.array(0.25))]
    [[1.0, 0.0], [0.75, 0.25]]
    """
    rows = []
    for k in range(count):
        row = [jnp.ones_like(low)]
        for step in range(count - 1):
            t = high if step < k else low
            inner = [a * (1.0 - t) + b * t for a, b in zip(row[1:], row[:-1], strict=True)]
            row = [row[0] * (1.0 - t), *inner, row[-1] * t]
        rows.append(row)
    return rows


def restricted(net: Net, u: list[list[Lanes]], v: list[list[Lanes]]) -> Net:
    """u times the net times v transposed, for matrices of lanes.

    >>> net = jnp.array([0.0, 1.0]).reshape(1, 2, 1)
    >>> ends = jnp.array([0.25]), jnp.array([0.5])
    >>> restricted(net, restricting(1, *ends), restricting(2, *ends)).ravel().tolist()
    [0.25, 0.5]
    """
    if unrolled(net):
        return combined(net, u, v)
    by_u, by_v = (jnp.stack([jnp.stack(row) for row in matrix]) for matrix in (u, v))
    rows = total([by_u[:, i, None] * net[i] for i in range(net.shape[0])])
    return total([by_v[:, j] * rows[:, j, None] for j in range(net.shape[1])])


def combined_at(net: Net, u: list[Lanes], v: list[Lanes]) -> Lanes:
    """The sum of the coefficients times u and v of their places.

    >>> combined_at(objects([[1.0, 2.0]]), [3.0], [1.0, 1.0])
    9.0
    """
    return total([x * total([c * y for c, y in zip(row, v, strict=True)]) for row, x in zip(net, u, strict=True)])


def bilinear_times(corners: list[list[Lanes]], net: Net) -> Net:
    """The product with the bilinear function that has these values at the corners (i, j); both degrees grow by one.

    >>> ones = [[jnp.ones(1)] * 2] * 2
    >>> bilinear_times(ones, jnp.full((1, 1, 1), 5.0)).ravel().tolist()
    [5.0, 5.0, 5.0, 5.0]
    """
    du, dv = degrees(net)
    along_u, along_v = _times_linear(du), _times_linear(dv)
    parts = [combined(net, along_u[i], along_v[j]) for i in (0, 1) for j in (0, 1)]
    weights = [corners[i][j] for i in (0, 1) for j in (0, 1)]
    return total([each(lambda c, k=weight: c * k, part) for weight, part in zip(weights, parts, strict=True)])


def sum_of_sizes(control: Array | np.ndarray) -> Lanes:
    """The sum of the sizes of all numbers of ``(nu, nv, dim, lanes)``.

    >>> sum_of_sizes(jnp.full((2, 2, 3, 1), -1.0)).tolist()
    [12.0]
    """
    if np.prod(control.shape[:3]) > TUNING.unrolled_sums:
        return jnp.sum(jnp.abs(control), axis=(0, 1, 2))
    return total([jnp.abs(control[place]) for place in np.ndindex(*control.shape[:3])])


def length(vectors: Array) -> Array:
    """Of vectors ``(..., 3, lanes)``, with a slope of 0 where it is 0.

    >>> length(jnp.array([[3.0], [4.0], [0.0]])).tolist()
    [5.0]
    """
    return root(_square(vectors))


def longest(net: Array, maxima: Maxima = EXACT) -> Array:
    """The length of the longest coefficient of vector nets ``(..., nu, nv, 3, lanes)``.

    >>> longest(jnp.array([3.0, 4.0, 0.0]).reshape(1, 1, 3, 1)).tolist()
    [5.0]
    """
    return root(maxima.largest_along(_square(net), (-3, -2)))


def _square(vectors: Array) -> Array:
    return jnp.sum(vectors * vectors, axis=-2)


def stacked(net: Net) -> Array:
    """A net as an array ``(nu, nv, lanes)``.

    >>> stacked(objects([[jnp.zeros(5), jnp.ones(5)]])).shape
    (1, 2, 5)
    """
    return jnp.stack([jnp.stack(list(row)) for row in net])


def transposed(net: Net) -> Net:
    """u and v exchanged.

    >>> transposed(objects([[1, 2]])).tolist()
    [[1], [2]]
    """
    return net.swapaxes(0, 1)


def total(values: list[Any]) -> Any:
    """Their sum; ``sum`` would begin with 0.

    >>> total([1, 2, 3])
    6
    """
    whole = values[0]
    for value in values[1:]:
        whole = whole + value
    return whole


def _raising(low: int, high: int) -> np.ndarray:
    """The matrix ``(high+1, low+1)`` that raises a degree."""
    raising = np.zeros((high + 1, low + 1))
    for i in range(high + 1):
        for k in range(max(0, i - high + low), min(low, i) + 1):
            raising[i, k] = comb(low, k) * comb(high - low, i - k) / comb(high, i)
    return raising


def _times_linear(degree: int) -> list[list[list[float]]]:
    """Matrices ``(degree+2, degree+1)`` that multiply by 1 - t, and by t."""
    i = np.arange(degree + 2) / (degree + 1)
    eye = np.eye(degree + 2)
    return [((1.0 - i)[:, None] * eye[:, :-1]).tolist(), (i[:, None] * eye[:, 1:]).tolist()]


def _weighted(weights: Any, values: Sequence[Lanes]) -> Lanes:
    """The weighted sum, without what is known to be 0."""
    used = [(w, x) for w, x in zip(weights, values, strict=True) if not (isinstance(w, float) and w == 0.0)]
    return total([x if isinstance(w, float) and w == 1.0 else x * w for w, x in used or [(0.0, values[0])]])


def _tree(choose: Callable[[Lanes, Lanes], Lanes], net: Net) -> Lanes:
    """All values in pairs, the results in pairs, ...: compiles faster than one after the other."""
    values = list(net.ravel())
    while len(values) > 1:
        pairs = zip(values[::2], values[1::2], strict=False)
        values = [choose(*pair) for pair in pairs] + values[len(values) // 2 * 2 :]
    return values[0]
