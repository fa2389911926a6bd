"""Control nets as lists, along u, of lists, along v, of arrays ``(lanes,)``: one array a coefficient.

That is what the compiler makes fast code of: on the CPU it is tens of times faster than larger arrays.
"""

from __future__ import annotations

from collections.abc import Callable
from itertools import pairwise
from math import comb
from typing import Any

import jax.numpy as jnp
import numpy as np

from slefejax.bezier import restrict
from slefejax.estimate import larger, smaller

Lanes = Any  # (lanes,)
Net = list[list[Lanes]]


def derivative(net: Net, i: int, j: int) -> Net:
    """Coefficients of the derivative, i times by u and j times by v; empty if it is identically 0 by degree."""
    for _ in range(i):
        d = len(net) - 1
        net = scaled([[b - a for a, b in zip(*pair, strict=True)] for pair in pairwise(net)], d)
    if j and net:
        return transposed(derivative(transposed(net), j, 0))
    return net


def raised(net: Net, degree: int) -> Net:
    """The same polynomial with a higher degree along u."""
    low = len(net) - 1
    rows = []
    for i in range(degree + 1):
        used = range(max(0, i - degree + low), min(low, i) + 1)
        shares = [comb(low, k) * comb(degree - low, i - k) / comb(degree, i) for k in used]
        parts = [scaled([net[k]], share)[0] for k, share in zip(used, shares, strict=True)]
        rows.append([total(list(column)) for column in zip(*parts, strict=True)])
    return rows


def tile_matrices(nu: int, nv: int, tiles: int) -> tuple[np.ndarray, np.ndarray]:
    """Matrices that restrict coefficients to every tile, along u and along v, ``(tiles^2, d+1, d+1)``."""
    along = [[restrict(np.eye(n), k / tiles, (k + 1) / tiles) for k in range(tiles)] for n in (nu, nv)]
    pairs = [(u, v) for u in along[0] for v in along[1]]
    return np.stack([u for u, _ in pairs]), np.stack([v for _, v in pairs])


def entries_of(matrix: Any, like: Lanes) -> list[list[Lanes]]:
    """Entries of a matrix as lanes."""
    return [[jnp.broadcast_to(x, like.shape) for x in row] for row in matrix]


def restricted(net: Net, u: list[list[Lanes]], v: list[list[Lanes]]) -> Net:
    """Coefficients on a part of the domain, for the matrices along u and v (``tile_matrices``)."""
    columns = transposed(net)
    rows = [[total([a * c for a, c in zip(line, column, strict=True)]) for column in columns] for line in u]
    return [[total([a * c for a, c in zip(line, row, strict=True)]) for line in v] for row in rows]


def image(points: list, row: list) -> Net:
    """A row of the projection applied to all control points."""
    return [
        [total([m * x for m, x in zip(row, c, strict=False)] + ([row[3]] if len(c) == 3 else [])) for c in line]
        for line in points
    ]


def scaled(net: Net, factor: Any) -> Net:
    """All coefficients times a number."""
    return net if isinstance(factor, (int, float)) and factor == 1 else [[c * factor for c in row] for row in net]


def total(values: list[Any]) -> Any:
    """Their sum; ``sum`` would begin with 0."""
    total = values[0]
    for value in values[1:]:
        total = total + value
    return total


def points(control: Any) -> list:
    """Control points as lists of coordinates."""
    return [[list(control[i, j]) for j in range(control.shape[1])] for i in range(control.shape[0])]


def entries(net: Net) -> list[Lanes]:
    """All coefficients in one list, v fastest."""
    return [entry for row in net for entry in row]


def transposed(net: Net) -> Net:
    """u and v exchanged."""
    return [list(row) for row in zip(*net, strict=True)]


def top(values: list[Lanes]) -> Lanes:
    """The largest."""
    return _tree(larger, values)


def bottom(values: list[Lanes]) -> Lanes:
    """The smallest."""
    return _tree(smaller, values)


def _tree(choose: Callable[[Lanes, Lanes], Lanes], values: list[Lanes]) -> Lanes:
    """All values in pairs, the results in pairs, ...: compiles faster than one after the other."""
    while len(values) > 1:
        values = [choose(*pair) for pair in zip(values[::2], values[1::2], strict=False)] + values[
            len(values) // 2 * 2 :
        ]
    return values[0]
