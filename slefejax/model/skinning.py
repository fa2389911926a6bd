"""Vertices in motion: shape keys, linear blend skinning, dual-quaternion blending (docs/math.md, 8).

A deformation is a plain function of (rest positions, bone transforms, influences) that returns positions;
``linear_blend`` and ``dual_quaternion_blend`` are two, and any other function of that kind can take their place:

>>> def stiff(rest, transforms, influences):  # every vertex follows its strongest bone
...     strongest = np.argmax(influences.table.matrix.toarray(), axis=1)
...     return jnp.einsum("nij,nj->ni", transforms[strongest, :, :3], rest) + transforms[strongest, :, 3]

Transforms take points of the rest pose to the pose; ``slefejax.model.rig`` makes them of joints that turn.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jaxtyping import Float, Int

from slefejax.arguments import Numbers
from slefejax.errors import InputError
from slefejax.model.stencils import StencilTable


@dataclass(frozen=True, eq=False)
class Influences:
    """Which bones move a vertex, and how much: a table from bones to vertices whose rows add up to 1.

    >>> halves = Influences.of(np.array([[0, 1]]), np.array([[0.5, 0.5]]), 2)
    >>> halves.table.on_host(np.array([[2.0], [4.0]])).tolist()  # of what two bones say
    [[3.0]]
    """

    table: StencilTable

    @staticmethod
    def of(indices: Any, weights: Numbers, bones: int) -> Influences:
        """From ``(vertices, k)`` bone numbers and weights; zero weights are padding. Weights are divided by their sum.

        Raises InputError for a bone that does not exist, a weight that is negative or not finite, and a vertex whose
        weights are all zero, with their numbers.

        >>> two = Influences.of([[0, 1], [1, 1]], [[3.0, 1.0], [2.0, 0.0]], bones=2)
        >>> two.table.matrix.toarray().tolist()
        [[0.75, 0.25], [0.0, 1.0]]
        """
        indices, weights = np.asarray(indices, np.int64), np.asarray(weights, np.float64)
        if indices.ndim != 2 or indices.shape != weights.shape:
            raise InputError(
                f"influences need bone numbers and weights, both (vertices, k), not {indices.shape} and {weights.shape}"
            )
        used = weights != 0
        bad = np.argwhere(used & ((indices < 0) | (indices >= bones)))
        if bad.size:
            raise InputError(
                f"vertex {bad[0, 0]} has a weight for bone {indices[tuple(bad[0])]}, but there are {bones}"
            )
        bad = np.argwhere(~np.isfinite(weights) | (weights < 0))
        if bad.size:
            raise InputError(
                f"vertex {bad[0, 0]} has the weight {weights[tuple(bad[0])]:g}: weights must not be negative"
            )
        bad = np.flatnonzero(weights.sum(axis=1) <= 0)
        if bad.size:
            raise InputError(f"the weights of vertex {bad[0]} are all zero ({bad.size} such vertices): give it a bone")
        vertex = np.broadcast_to(np.arange(len(indices))[:, None], indices.shape)
        table = StencilTable.of(vertex[used], indices[used], weights[used], (len(indices), bones))
        return Influences(table.normalised())

    @cached_property
    def most(self) -> int:
        """The largest number of bones that move one vertex."""
        return int(self.table.counts.max())

    @cached_property
    def strongest(self) -> Int[np.ndarray, "vertices"]:
        """The bone with the largest weight of every vertex, the first of several."""
        matrix = self.table.matrix
        vertex = np.repeat(np.arange(self.table.rows), self.table.counts)
        order = np.lexsort((np.arange(matrix.nnz), -matrix.data, vertex))
        return matrix.indices[order[matrix.indptr[:-1]]].astype(np.int32)


def linear_blend(
    rest: Array | np.ndarray, transforms: Array | np.ndarray, influences: Influences
) -> Array | np.ndarray:
    """v' = (sum_k w_k M_k) v for rest positions ``(vertices, 3)`` and transforms M ``(bones, 3, 4)``.

    With frames first, ``(frames, bones, 3, 4)`` (and the rest positions too, if they change), so is the result.
    Differentiable by positions and transforms.

    >>> up = np.array([[1.0, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 2]])
    >>> half = Influences.of(np.array([[0, 1]]), np.array([[0.5, 0.5]]), 2)
    >>> linear_blend(np.zeros((1, 3)), np.stack([np.eye(3, 4), up]), half).tolist()
    [[0.0, 0.0, 1.0]]
    """
    if transforms.ndim == 4:
        return jax.vmap(linear_blend, (0 if rest.ndim == 3 else None, 0, None))(rest, transforms, influences)
    blended = influences.table(transforms.reshape(len(transforms), 12)).reshape(-1, 3, 4)
    x, y, z = (rest[:, k, None] for k in range(3))
    return blended[..., 0] * x + blended[..., 1] * y + blended[..., 2] * z + blended[..., 3]


def dual_quaternion_blend(
    rest: Array | np.ndarray, transforms: Array | np.ndarray, influences: Influences
) -> Array | np.ndarray:
    """Blends rigid motions, so that limbs that twist keep their volume [KCZO08].

    As ``linear_blend``. Of a transform that scales or shears, M = R P with a rotation R and a symmetric P, P is blended
    linearly and applied first, then the rigid motions, as UsdSkel does. Quaternions are blended on the side of the
    vertex's strongest bone, since q and -q are one rotation.
    """
    if transforms.ndim == 4:
        return jax.vmap(dual_quaternion_blend, (0 if rest.ndim == 3 else None, 0, None))(rest, transforms, influences)
    turn = polar_rotations(transforms[:, :, :3])
    stretch = jnp.einsum("nji,njk->nik", turn, transforms[:, :, :3])
    blended = influences.table(stretch.reshape(len(stretch), 9)).reshape(-1, 3, 3)
    x, y, z = (rest[:, k, None] for k in range(3))
    rest = blended[..., 0] * x + blended[..., 1] * y + blended[..., 2] * z
    real = quaternions(turn)
    moved = jnp.concatenate([jnp.zeros_like(transforms[:, :1, 3]), transforms[:, :, 3]], axis=1)
    both = jnp.concatenate([real, 0.5 * multiply(moved, real)], axis=1)
    blended = _on_one_side(both, influences)
    blended = blended / jnp.linalg.norm(blended[:, :4], axis=1, keepdims=True)
    w, r, dual_w, dual = blended[:, :1], blended[:, 1:4], blended[:, 4:5], blended[:, 5:]
    turned = rest + 2.0 * jnp.cross(r, jnp.cross(r, rest) + w * rest)
    return turned + 2.0 * (w * dual - dual_w * r + jnp.cross(r, dual))


@jax.custom_jvp
def polar_rotations(matrices: Float[Any, "*rest 3 3"]) -> Float[Any, "*rest 3 3"]:
    """The rotations R of M = R P with symmetric P, of matrices M ``(..., 3, 3)``.

    P is positive; where M mirrors, negative, as UsdSkel has it. Where M flattens space, R is a rotation all the same.
    Derivatives are finite everywhere, and 0 where R has none (a bone that is scaled to 0 along two axes).

    >>> polar_rotations(np.diag([2.0, 3.0, 4.0])).round(9).tolist()
    [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    u, sizes, v = jnp.linalg.svd(matrices)
    same = u @ v
    flat = sizes[..., 2] <= 8 * jnp.finfo(sizes.dtype).eps * sizes[..., 0]
    mirrored = (jnp.linalg.det(same) < 0)[..., None, None]
    other = jnp.where(flat[..., None, None], same - 2.0 * u[..., :, 2:] * v[..., 2:, :], -same)
    return jnp.where(mirrored, other, same)


@polar_rotations.defjvp
def _polar_rotations_jvp(primals: tuple[Any], tangents: tuple[Any]) -> tuple[Any, Any]:
    """dR = R [w]x: of dM = R ([w]x P + dP) the skew part of R^T dM is [(tr(P) I - P) w]x."""
    (m,), (dm,) = primals, tangents
    turn = polar_rotations(m)
    back = jnp.swapaxes(turn, -1, -2)
    p, skew = back @ m, back @ dm
    skew = skew - jnp.swapaxes(skew, -1, -2)
    trace = jnp.trace(p, axis1=-2, axis2=-1)[..., None, None]
    gain = trace * jnp.eye(3, dtype=p.dtype) - p
    there = jnp.abs(jnp.linalg.det(gain))[..., None, None] > jnp.finfo(p.dtype).eps * jnp.abs(trace) ** 3
    gain = jnp.where(there, gain, jnp.eye(3, dtype=p.dtype))
    axis = jnp.stack([skew[..., 2, 1], skew[..., 0, 2], skew[..., 1, 0]], axis=-1)[..., None]
    x, y, z = (jnp.where(there, jnp.linalg.inv(gain) @ axis, 0.0)[..., k, 0] for k in range(3))
    zero = jnp.zeros_like(x)
    rows = [[zero, -z, y], [z, zero, -x], [-y, x, zero]]
    return turn, turn @ jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)


def _on_one_side(both: Any, influences: Influences) -> Array | np.ndarray:
    """sum_k w_k s_k q_k, with the signs s that bring every q_k to the side of the strongest bone's."""
    table, strongest = influences.table, influences.strongest
    sums = []
    for (_, rows), (index, weight) in zip(table.classes, table.groups, strict=True):
        own = both[strongest[rows]]
        total = jnp.zeros_like(own)
        for k in range(len(index)):
            q = both[index[k]]
            side = jnp.where(jnp.sum(q[:, :4] * own[:, :4], axis=1) < 0, -1.0, 1.0)
            total = total + (side * weight[k].astype(q.dtype))[:, None] * q
        sums.append(total)
    return jnp.concatenate(sums)[table.order]


def quaternions(rotations: Array | np.ndarray) -> Array | np.ndarray:
    """Unit quaternions (w, x, y, z), of either sign, of rotation matrices ``(..., 3, 3)``; scale does not matter.

    Of the four formulas that divide by one component each, the one with the largest is taken [She78].

    >>> quaternions(np.eye(3)).tolist()
    [1.0, 0.0, 0.0, 0.0]
    """
    scale = jnp.linalg.norm(rotations, axis=-1, keepdims=True)
    m = rotations / jnp.where(scale > 0, scale, 1.0)
    xx, yy, zz = m[..., 0, 0], m[..., 1, 1], m[..., 2, 2]
    a, b, c = m[..., 2, 1] - m[..., 1, 2], m[..., 0, 2] - m[..., 2, 0], m[..., 1, 0] - m[..., 0, 1]
    d, e, f = m[..., 1, 0] + m[..., 0, 1], m[..., 0, 2] + m[..., 2, 0], m[..., 2, 1] + m[..., 1, 2]
    rows = [
        [1.0 + xx + yy + zz, a, b, c],
        [a, 1.0 + xx - yy - zz, d, e],
        [b, d, 1.0 - xx + yy - zz, f],
        [c, e, f, 1.0 - xx - yy + zz],
    ]
    candidates = jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
    largest = jnp.argmax(jnp.stack([rows[k][k] for k in range(4)], axis=-1), axis=-1)
    chosen = jnp.take_along_axis(candidates, largest[..., None, None], axis=-2)[..., 0, :]
    return chosen / jnp.linalg.norm(chosen, axis=-1, keepdims=True)


def multiply(p: Array | np.ndarray, q: Array | np.ndarray) -> Array | np.ndarray:
    """The product of quaternions (w, x, y, z).

    >>> multiply(np.array([0.0, 1, 0, 0]), np.array([0.0, 0, 1, 0])).tolist()  # i j = k
    [0.0, 0.0, 0.0, 1.0]
    """
    pw, pv, qw, qv = p[..., :1], p[..., 1:], q[..., :1], q[..., 1:]
    real = pw * qw - jnp.sum(pv * qv, axis=-1, keepdims=True)
    return jnp.concatenate([real, pw * qv + qw * pv + jnp.cross(pv, qv)], axis=-1)


@dataclass(frozen=True, eq=False)
class ShapeKeys:
    """Offsets that are added to the rest positions, each times a weight: rest = base + sum_k w_k (key_k - base).

    names  : of the keys
    table  : from shapes to ``3 vertices`` coordinates; only offsets that are not zero are kept
    places : for every key, the weights at which it has shapes of its own, (0, ...) first; most have (0, 1) only.
             Between two of them their shapes are blended, beyond the last they are extrapolated
    """

    names: tuple[str, ...]
    table: StencilTable
    places: tuple[tuple[float, ...], ...]

    @staticmethod
    def of(shapes: Sequence[Key], vertices: int) -> ShapeKeys:
        """From keys, each a ``Key``. Raises InputError for a vertex that does not exist or offsets of a wrong size."""
        rows, columns, values, places = [], [], [], []
        column = 0
        for key in shapes:
            for indices, offsets in key.shapes:
                number, moves = np.asarray(indices, np.int64), np.asarray(offsets, np.float64)
                if number.ndim != 1 or moves.shape != (len(number), 3):
                    raise InputError(
                        f"shape key {key.name!r} needs offsets (n, 3) for its {number.size} vertices, not {moves.shape}"
                    )
                if number.size and not 0 <= number.min() <= number.max() < vertices:
                    bad = number.max() if number.max() >= vertices else number.min()
                    raise InputError(f"shape key {key.name!r} moves vertex {bad}, but there are {vertices}")
                if not np.isfinite(moves).all():
                    raise InputError(f"shape key {key.name!r} has offsets that are not finite numbers")
                rows.append((3 * number[:, None] + np.arange(3)).ravel())
                columns.append(np.full(3 * len(number), column))
                values.append(moves.ravel())
                column += 1
            places.append((0.0, *key.places))
        row, offset, value = (np.concatenate(part) if part else np.zeros(0) for part in (rows, columns, values))
        table = StencilTable.of(row, offset, value, (3 * vertices, column))
        return ShapeKeys(tuple(key.name for key in shapes), table, tuple(places))

    def shape_weights(self, weights: Array | np.ndarray) -> Array | np.ndarray:
        """``(keys,)`` weights to weights of all shapes, those between 0 and 1 included."""
        parts = []
        for k, places in enumerate(self.places):
            parts += _hats(weights[k], places)
        return jnp.stack(parts) if parts else jnp.zeros((0,))

    def offsets(self, weights: Array | np.ndarray) -> Array | np.ndarray:
        """``(vertices, 3)`` offsets for ``(keys,)`` weights, by JAX; differentiable by them."""
        return self.table(self.shape_weights(weights)).reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class Key:
    """One shape key: its name and, for each of its places, (vertex numbers, offsets ``(n, 3)``)."""

    name: str
    shapes: tuple[tuple[Any, Any], ...]
    places: tuple[float, ...] = (1.0,)


def _hats(weight: Any, places: tuple[float, ...]) -> list[Any]:
    """Weights of the shapes at all places but 0: piecewise linear, beyond the ends as in the first and last piece."""
    order, weight = sorted(places), jnp.asarray(weight)
    knots = np.array(order)
    piece = jnp.searchsorted(knots[1:-1], weight, side="right")
    start, length = (jnp.asarray(part, weight.dtype)[piece] for part in (knots, np.diff(knots)))
    share = (weight - start) / length
    values = [
        jnp.where(piece == k, 1.0 - share, 0.0) + jnp.where(piece + 1 == k, share, 0.0) for k in range(len(knots))
    ]
    return [values[order.index(place)] for place in places[1:]]


def rotation_matrices(q: Float[Any, "*rest 4"]) -> Array | np.ndarray:
    """``(..., 3, 3)`` rotations of quaternions (w, x, y, z), which need not be units.

    >>> rotation_matrices(np.array([0.0, 0.0, 0.0, 1.0])).tolist()  # half a turn about z
    [[-1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, 1.0]]
    """
    w, x, y, z = (q[..., k] for k in range(4))
    s = 2.0 / jnp.sum(q * q, axis=-1)
    rows = [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]
    return jnp.stack([jnp.stack(row, axis=-1) for row in rows], axis=-2)
