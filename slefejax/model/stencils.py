"""Tables of stencils: every output is a weighted sum of a few inputs, built once on the host, applied by JAX.

A row says which inputs an output is made of and with what weights. On the host a table is a sparse matrix, so that
tables are put together by matrix algebra. To be applied, rows are sorted by their number of weights into classes that
are padded each to its own width: a pole of valence 64 does not make every row as wide as its own.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Float, Int
from scipy.sparse import csr_array, eye_array, vstack

from slefejax.errors import InputError

# Widths that rows are padded to; wider rows than the last get classes that grow by half.
WIDTHS = (1, 2, 3, 4, 6, 9, 12, 16, 20, 24, 32)
_GROWTH = 1.5
_UNROLLED = 32
_REGISTER = 4  # numbers


@jax.tree_util.register_pytree_node_class
@dataclass(frozen=True, eq=False)
class StencilTable:
    """A linear map from ``(columns, *rest)`` to ``(rows, *rest)``.

    To JAX it is a tree of its padded arrays, so that a table can be an argument of a jitted function; closed over, its
    arrays would become constants of the program, which takes long to compile where they are large.

    >>> midpoints = StencilTable.of([0, 0, 1, 1], [0, 1, 1, 2], [0.5] * 4, (2, 3))
    >>> midpoints(np.array([0.0, 2.0, 6.0])).tolist()
    [1.0, 4.0]
    """

    matrix: Any
    traced: Any = field(default=None, repr=False)  # inside of JAX: (groups, order), and the table that they are of

    def tree_flatten(self) -> tuple[Any, StencilTable]:
        """For JAX: groups and order are data."""
        if self.traced is not None:
            return self.traced
        return self._on_device[jax.config.read("jax_enable_x64")], self

    @classmethod
    def tree_unflatten(cls, table: StencilTable, arrays: Any) -> StencilTable:
        """For JAX: the inverse of ``tree_flatten``."""
        return cls(table.matrix, (tuple(arrays), table))

    @staticmethod
    def of(rows: Any, columns: Any, weights: Any, shape: tuple[int, int]) -> StencilTable:
        """From lists of equal length: output, input, weight. Weights for the same pair add up, zeros are left out."""
        weights = np.asarray(weights, np.float64)
        matrix = csr_array((weights, (np.asarray(rows, np.int64), np.asarray(columns, np.int64))), shape=shape)
        matrix.sum_duplicates()
        matrix.eliminate_zeros()
        return StencilTable(matrix)

    @staticmethod
    def identity(count: int) -> StencilTable:
        """Every output is the input of the same number."""
        return StencilTable(csr_array(eye_array(count, format="csr")))

    @property
    def rows(self) -> int:
        """Number of outputs."""
        return self.matrix.shape[0]

    @property
    def columns(self) -> int:
        """Number of inputs."""
        return self.matrix.shape[1]

    def __matmul__(self, first: StencilTable) -> StencilTable:
        """The table that does ``first`` and then this one."""
        return _clean(self.matrix @ first.matrix)

    def combined(self, rows: Int[np.ndarray, "n k"], weights: Float[np.ndarray, "n k"]) -> StencilTable:
        """Sums of k of its rows each, with these numbers and weights: a number may come twice.

        >>> StencilTable.identity(2).combined(np.array([[0, 1]]), np.array([[0.25, 0.75]])).on_host([0.0, 4.0]).tolist()
        [3.0]
        """
        ends = rows.shape[1] * np.arange(len(rows) + 1)
        sums = csr_array((weights.ravel(), rows.ravel(), ends), shape=(len(rows), self.rows))
        sums.eliminate_zeros()
        return _clean(sums @ self.matrix)

    def __add__(self, other: StencilTable) -> StencilTable:
        """Outputs added up."""
        return _clean(self.matrix + other.matrix)

    def __sub__(self, other: StencilTable) -> StencilTable:
        """Outputs subtracted."""
        return _clean(self.matrix - other.matrix)

    def scaled(self, factors: Any) -> StencilTable:
        """Row r times ``factors[r]``, or every row times one number."""
        factors = np.broadcast_to(np.asarray(factors, np.float64), (self.rows,))
        own = self.matrix
        arrays = (own.data * np.repeat(factors, self.counts), own.indices, own.indptr)
        scaled = csr_array(arrays, shape=own.shape)
        return StencilTable(scaled) if np.all(factors) else _clean(scaled.copy())

    def normalised(self) -> StencilTable:
        """Every row divided by the sum of its weights, so that outputs are affine combinations."""
        return self.scaled(1.0 / self.row_sums())

    def row_sums(self) -> Float[np.ndarray, "rows"]:
        """The sum of the weights of every row."""
        return np.asarray(self.matrix.sum(axis=1)).ravel()

    def pruned(self, least: float) -> StencilTable:
        """Without weights of at most that size, which rounding left."""
        matrix, kept = self.matrix, np.abs(self.matrix.data) > least
        ends = np.append(0, np.cumsum(kept))[matrix.indptr]
        return StencilTable(csr_array((matrix.data[kept], matrix.indices[kept], ends), shape=matrix.shape))

    def take(self, rows: Any) -> StencilTable:
        """The rows of these numbers, in their order."""
        return StencilTable(csr_array(self.matrix[np.asarray(rows, np.int64)]))

    def stacked(self, *others: StencilTable) -> StencilTable:
        """The rows of this table, then those of others with the same inputs."""
        return StencilTable(csr_array(vstack([self.matrix, *(other.matrix for other in others)], format="csr")))

    def on_host(self, values: Any) -> Float[np.ndarray, "rows *rest"]:
        """The outputs in float64, by NumPy alone: ``(columns, *rest)`` to ``(rows, *rest)``."""
        values = np.asarray(values, np.float64)
        self._check(values)
        return (self.matrix @ values.reshape(self.columns, -1)).reshape(self.rows, *values.shape[1:])

    def __call__(self, values: Any) -> Any:
        """The outputs, by JAX, in the precision of ``values``: ``(columns, *rest)`` to ``(rows, *rest)``.

        Differentiable (it is linear). Raises InputError if the number of inputs is another one.
        """
        values = values if isinstance(values, (jax.Array, Tracer)) else np.asarray(values)
        self._check(values)
        if self.traced is not None:
            return _apply_jit(values, *self.traced[0])
        if isinstance(values, Tracer):
            return _apply_jit(values, self.groups, self.order)
        return _apply_jit(values, *self._on_device[jax.config.read("jax_enable_x64")])

    @cached_property
    def _on_device(self) -> _Copies:
        return _Copies((self.groups, self.order))

    def _check(self, values: Any) -> None:
        if values.ndim == 0 or values.shape[0] != self.columns:
            raise InputError(f"this table takes {self.columns} inputs along the first axis, not shape {values.shape}")

    @cached_property
    def counts(self) -> Int[np.ndarray, "rows"]:
        """The number of weights of every row."""
        return np.diff(self.matrix.indptr)

    @cached_property
    def classes(self) -> list[tuple[int, np.ndarray]]:
        """(width, rows) of every class: how wide its rows are padded, and their numbers."""
        ladder: list[int] = list(WIDTHS)
        while ladder[-1] < self.counts.max(initial=0):
            ladder.append(int(np.ceil(ladder[-1] * _GROWTH)))
        steps = np.array(ladder)
        cls = np.searchsorted(steps, self.counts)
        found = [np.flatnonzero(cls == k) for k in range(len(steps))]
        # no wider than its widest row
        return [(int(max(1, self.counts[rows].max())), rows) for rows in found if rows.size]

    @cached_property
    def groups(self) -> tuple[tuple[Int[np.ndarray, "width rows"], Float[np.ndarray, "width rows"]], ...]:
        """Indices and weights of the rows of each class; what is missing in a row has weight 0 and its first index."""
        groups = []
        for width, rows in self.classes:
            slots = np.arange(width)[:, None]
            there = slots < self.counts[rows]
            at = self.matrix.indptr[rows] + np.where(there, slots, 0)
            filled = self.counts[rows] > 0
            at = np.where(filled, at, 0)
            index = np.where(filled, self.matrix.indices[at], 0) if len(self.matrix.indices) else np.zeros_like(at)
            weight = np.where(there, self.matrix.data[at], 0.0) if len(self.matrix.data) else np.zeros(at.shape)
            groups.append((index.astype(np.int32), weight))
        return tuple(groups)

    @cached_property
    def order(self) -> Int[np.ndarray, "rows"]:
        """Where each output stands among the rows of all classes, one class after the other."""
        place = np.empty(self.rows, np.int32)
        place[np.concatenate([rows for _, rows in self.classes])] = np.arange(self.rows, dtype=np.int32)
        return place

    @property
    def padded_bytes(self) -> int:
        """Memory of the padded tables: 4-byte indices, 8-byte weights."""
        return sum(index.nbytes + weight.nbytes for index, weight in self.groups) + self.order.nbytes

    @property
    def padding(self) -> float:
        """The share of the padded weights that is padding."""
        slots = sum(weight.size for _, weight in self.groups)
        return 1.0 - self.matrix.nnz / slots if slots else 0.0


class _Copies(dict):
    """Arrays where JAX computes, copied when they are first asked for: once with float64, once without."""

    def __init__(self, arrays: Any) -> None:
        super().__init__()
        self._arrays = arrays

    def __missing__(self, double: bool) -> Any:
        self[double] = jax.device_put(self._arrays)
        return self[double]


def _clean(matrix: Any) -> StencilTable:
    matrix = csr_array(matrix)
    matrix.eliminate_zeros()
    matrix.sort_indices()
    return StencilTable(matrix)


@jax.jit
def _apply_jit(values: Any, groups: Any, order: Any) -> Any:
    """Gather, weight, sum: inputs in rows of a whole register, which are gathered at one go."""
    flat = values.reshape(values.shape[0], -1)
    if not jnp.issubdtype(flat.dtype, jnp.floating):
        flat = flat.astype(jax.dtypes.canonicalize_dtype(np.float64))
    count = flat.shape[1]
    missing = -count % _REGISTER if count > 1 else 0
    if missing:
        # copies, not zeros: whatever is not finite stays where it was
        flat = jnp.concatenate([flat, *[flat[:, :1]] * missing], axis=1)
    sums = jnp.concatenate([_weighted(flat, *group) for group in groups])
    return _rows(sums, order)[:, :count].reshape(len(order), *values.shape[1:])


def _weighted(flat: Any, index: Any, weight: Any) -> Any:
    weight = weight.astype(flat.dtype)[..., None]
    if index.shape[0] > _UNROLLED:
        return jnp.sum(weight * _rows(flat, index), axis=0)
    total = weight[0] * _rows(flat, index[0])
    for k in range(1, index.shape[0]):
        total = total + weight[k] * _rows(flat, index[k])
    return total


def _rows(values: Any, index: Any) -> Any:
    """Rows of numbers that are known to exist."""
    return values.at[index].get(mode="promise_in_bounds", wrap_negative_indices=False)
