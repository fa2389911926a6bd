"""Gaussian products: rational patches of bi-degree 9 from bicubic ones of inverse covariances (docs/conversion.md).

A vertex has the nine numbers q = (Q, h), Q = Sigma^-1 symmetric, h = Q (mu - o), with one origin o for the mesh.
Subdivision is linear in q [PBW19]; so are, with nonnegative weights, the Bézier points of q. A patch of q is

    mu(u, v) - o = Q(u, v)^-1 h(u, v) = adj(Q) h / det Q,

numerator and denominator of bi-degree 9: products of nets, by the binomials convolved. Weights are positive: every
coefficient of det Q is a positive combination of mixed discriminants of positive definite matrices.

Nearly parallel or long Gaussians make det Q the difference of large numbers. So a net is *whitened* first: with
L L^T the mean of its Q, Q' = L^-1 Q L^-T and h' = L^-1 h have mu' = L^T mu, and what is left is near the identity.
Corners, sides and what is inside a patch each have a frame of their own, and points that neighbours share are made
once. All of it is in float64: in single precision the solution of such a system is off by more than a patch.
"""

from __future__ import annotations

from math import comb
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Float, Int

from slefejax.errors import InputError
from slefejax.model.gaussians import Gaussians
from slefejax.model.mesh import Mesh

DEGREE = 9
_ENTRY = ((0, 1, 2), (1, 3, 4), (2, 4, 5))  # of a symmetric matrix among (11, 12, 13, 22, 23, 33)
_UPPER = ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2))
_LEAST_SPREAD = 1e-6  # of weights within a patch
_AT_A_TIME = 1024  # nets, on the host: what the second-level cache takes


class Dual(NamedTuple):
    """How Gaussians become q: relative to ``origin`` (scene units), Q divided by ``unit`` to keep weights near 1."""

    origin: Float[np.ndarray, "3"]
    unit: float

    @staticmethod
    def of(gaussians: Gaussians) -> Dual:
        """The middle of the means, and the power of two that is next to the median of all Q."""
        means, covariances = (np.asarray(part, np.float64) for part in gaussians)
        sizes = np.linalg.slogdet(covariances)[1] / (3.0 * np.log(2.0))
        return Dual(0.5 * (means.min(axis=0) + means.max(axis=0)), float(2.0 ** -np.round(np.median(sizes))))

    def __call__(self, gaussians: Gaussians) -> Any:
        """q ``(vertices, 9)``: Q's entries 11, 12, 13, 22, 23, 33, then h."""
        means, covariances = gaussians
        xp = _numpy_of(means, covariances)
        half = xp.linalg.inv(xp.linalg.cholesky(covariances * self.unit))  # L^-1, so that L^-T L^-1 is symmetric
        inverse = xp.swapaxes(half, -1, -2) @ half
        pulled = (inverse @ (means - self.origin)[..., None])[..., 0]
        return xp.concatenate([xp.stack([inverse[..., i, j] for i, j in _UPPER], axis=-1), pulled], axis=-1)


def _numpy_of(*arrays: Any) -> Any:
    """NumPy for its own arrays, otherwise JAX, which must have double precision."""
    if all(isinstance(x, (np.ndarray, np.number)) for x in arrays):
        return np
    if any(x.dtype != np.float64 for x in arrays if isinstance(x, (jax.Array, Tracer))):
        raise InputError(
            "Gaussian products need double precision, which JAX has off: set jax_enable_x64, or compute on_host"
        )
    return jnp


def rational_net(q: Float[Any, "nu nv 9 nets"]) -> Float[Any, "mu mv 4 nets"]:
    """Control points (w x, w y, w z, w), relative to the origin, of nets of q; of bi-degree three times theirs.

    A single point is a net, and so is a curve. Whitened with the mean of the net's own Q.

    >>> q = np.zeros((2, 1, 9, 1))
    >>> q[..., [0, 3, 5], :], q[1, 0, 6] = 1.0, 3.0  # Gaussians that are balls, their means 0 and (3, 0, 0)
    >>> (rational_net(q)[:, 0, 0, 0] / rational_net(q)[:, 0, 3, 0]).round(9).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    xp = _numpy_of(q)
    mean = q.mean(axis=(0, 1)) if xp is np else jax.lax.stop_gradient(q.mean(axis=(0, 1)))  # whatever frame: one result
    frame, size = _inverse_cholesky(xp, mean)
    matrix, vector = _whitened(q, frame)
    scale = _binomials(*q.shape[:2])
    matrix, vector = [x * scale for x in matrix], [x * scale for x in vector]
    adjugate = _adjugate(xp, matrix)
    tops = [adjugate[_ENTRY[r][c]] for r in range(3) for c in range(3)] + [adjugate[c] for c in range(3)]
    rows = xp.stack(tops).reshape(4, 3, *adjugate.shape[1:])
    ends = xp.stack([xp.stack(own) for own in (vector, vector, vector, matrix[:3])])
    found = _product(xp, rows[:, 0], ends[:, 0])
    for c in (1, 2):
        found = found + _product(xp, rows[:, c], ends[:, c])
    found = found / _binomials(*found.shape[1:3])
    whole = [sum(frame[r][c] * found[r] for r in range(c, 3)) for c in range(3)] + [found[3]]
    return xp.stack(whole, axis=2) * size


_compiled = jax.jit(rational_net)  # step by step it takes seven times as long, and half as much memory again


def _inverse_cholesky(xp: Any, mean: Any) -> tuple[list[list[Any]], Any]:
    """Entries of L^-1, lower triangular, and det(L L^T), of L L^T = mean ``(9, nets)``."""
    a, b, c, d, e, f = mean[:6]
    l00 = xp.sqrt(a)
    l10, l20 = b / l00, c / l00
    l11 = xp.sqrt(d - l10 * l10)
    l21 = (e - l20 * l10) / l11
    l22 = xp.sqrt(f - l20 * l20 - l21 * l21)
    m0, m1, m2 = 1.0 / l00, 1.0 / l11, 1.0 / l22
    low = [[m0], [-l10 * m0 * m1, m1], [(l10 * l21 - l20 * l11) * m0 * m1 * m2, -l21 * m1 * m2, m2]]
    return low, (l00 * l11 * l22) ** 2


def _whitened(q: Any, m: list[list[Any]]) -> tuple[list[Any], list[Any]]:
    """The six entries of M Q M^T and the three of M h, each ``(nu, nv, nets)``, of a lower triangular M."""
    entry = lambda i, j: q[:, :, _ENTRY[i][j]]  # noqa: E731
    half = [[sum(m[i][k] * entry(k, j) for k in range(i + 1)) for j in range(3)] for i in range(3)]
    matrix = [sum(half[i][k] * m[j][k] for k in range(j + 1)) for i, j in _UPPER]
    return matrix, [sum(m[i][k] * q[:, :, 6 + k] for k in range(i + 1)) for i in range(3)]


def _adjugate(xp: Any, s: list[Any]) -> Any:
    """The six entries of the adjugate of symmetric matrices of scaled nets, stacked."""
    # cofactors: 11 = s22 s33 - s23^2, 12 = s13 s23 - s12 s33, 13 = s12 s23 - s13 s22, …
    plus = ((3, 5), (2, 4), (1, 4), (0, 5), (1, 2), (0, 3))
    minus = ((4, 4), (1, 5), (2, 3), (2, 2), (0, 4), (1, 1))
    one, other = ([xp.stack([s[pair[k]] for pair in pairs]) for k in (0, 1)] for pairs in (plus, minus))
    return _product(xp, *one) - _product(xp, *other)


def _product(xp: Any, a: Any, b: Any) -> Any:
    """Products of scaled nets ``(some, nu, nv, nets)``: convolutions."""
    nu, nv = a.shape[1] + b.shape[1] - 1, a.shape[2] + b.shape[2] - 1
    if xp is np:
        found = np.zeros((len(a), nu, nv, a.shape[3]))
        for i, j in np.ndindex(b.shape[1:3]):
            found[:, i : i + a.shape[1], j : j + a.shape[2]] += a * b[:, i, None, j, None]
        return found
    pairs = np.array(list(np.ndindex(b.shape[1:3])))

    def step(found: Any, given: tuple[Any, Any]) -> tuple[Any, None]:
        place, own = (0, *given[0], 0), given[1]
        part = jax.lax.dynamic_slice(found, place, a.shape)
        return jax.lax.dynamic_update_slice(found, part + a * own[:, None, None], place), None

    # a loop: written out, it would take the compiler ten times as long
    terms = (jnp.asarray(pairs), jnp.moveaxis(b.reshape(len(b), -1, b.shape[3]), 1, 0))
    return jax.lax.scan(step, jnp.zeros((len(a), nu, nv, a.shape[3]), a.dtype), terms)[0]


def _binomials(nu: int, nv: int) -> np.ndarray:
    """What coefficients of bi-degree (nu - 1, nv - 1) are multiplied by before they are convolved."""
    u, v = ([comb(n - 1, k) for k in range(n)] for n in (nu, nv))
    return np.multiply.outer(np.array(u, float), np.array(v, float))[..., None]


class Products(NamedTuple):
    """From points of q to the different control points of rational patches, in one list: corners, sides, inner ones.

    dual    : from Gaussians to q
    corners : ``(1, 1, corners)``, which point of q each is
    sides   : ``(4, 1, sides)``, those of every curve that is shared or free, and no point
    patches : ``(4, 4, patches)``
    """

    dual: Dual
    corners: Int[np.ndarray, "1 1 corners"]
    sides: Int[np.ndarray, "4 1 sides"]
    patches: Int[np.ndarray, "4 4 patches"]

    @staticmethod
    def of(net: Int[np.ndarray, "patches 4 4"], dual: Dual) -> tuple[Products, Int[np.ndarray, "patches 10 10"]]:
        """Of numbers of points of q, a net of them a patch; and the net of numbers of the control points made."""
        corner_of, corner = np.unique(net[:, ::3, ::3], return_inverse=True)
        corner = corner.reshape(-1, 2, 2)
        own = np.stack([net[:, 0], net[:, :, 0], net[:, 3], net[:, :, 3]], axis=1).reshape(-1, 4)
        backwards = (own[:, 3] < own[:, 0]) | ((own[:, 3] == own[:, 0]) & (own[:, 2] < own[:, 1]))
        own[backwards] = own[backwards, ::-1]
        curves, number = np.unique(own, axis=0, return_inverse=True)
        inner = len(corner_of) + 8 * number.ravel()[:, None] + np.where(backwards[:, None], 7 - _EIGHT, _EIGHT)
        collapsed = np.all(own == own[:, :1], axis=1)  # to a corner, whose control points are that one
        inner = np.where(collapsed[:, None], np.searchsorted(corner_of, own[:, :1]), inner).reshape(-1, 4, 8)
        made = np.empty((len(net), DEGREE + 1, DEGREE + 1), np.int64)
        made[:, ::DEGREE, ::DEGREE] = corner
        made[:, 0, 1:-1], made[:, 1:-1, 0], made[:, -1, 1:-1], made[:, 1:-1, -1] = np.moveaxis(inner, 1, 0)
        first = len(corner_of) + 8 * len(curves)
        made[:, 1:-1, 1:-1] = first + np.arange(64 * len(net)).reshape(-1, 8, 8)
        nets = corner_of[None, None], curves.T[:, None], np.moveaxis(net, 0, -1)
        return Products(dual, *nets), made

    def __call__(self, points: Float[Any, "points 9"]) -> Float[Any, "rows 4"]:
        """Control points (w x, w y, w z, w) in the scene's coordinates."""
        xp = _numpy_of(points)
        corners = _made(points, self.corners)[0, 0]
        sides = _made(points, self.sides)[1:-1, 0]
        inside = _made(points, self.patches)[1:-1, 1:-1]
        lists = [xp.moveaxis(part, (-1, -2), (0, -1)).reshape(-1, 4) for part in (corners, sides, inside)]
        return _placed(xp.concatenate(lists), self.dual)


def patches_of(nets: Float[np.ndarray, "patches 4 4 9"], dual: Dual) -> Float[np.ndarray, "patches 10 10 4"]:
    """Rational patches of nets of q, each in a frame of its own, on the host."""
    points = np.moveaxis(nets, 0, 2).reshape(-1, 9)
    made = _made(points, np.arange(len(points)).reshape(4, 4, -1))
    return _placed(np.moveaxis(made, (-1, 2), (0, -1)), dual)


def _placed(found: Any, dual: Dual) -> Any:
    """Relative to the scene's origin."""
    moved = found[..., :3] + dual.origin * found[..., 3:]
    return _numpy_of(found).concatenate([moved, found[..., 3:]], axis=-1)


def _made(points: Any, net: Any) -> Any:
    """Rational nets of nets of numbers of points of q."""
    if not isinstance(points, np.ndarray):
        return _compiled(jnp.moveaxis(points[net], 2, -1))
    parts = range(0, net.shape[2], _AT_A_TIME)
    nets = (np.moveaxis(points[net[:, :, k : k + _AT_A_TIME]], 2, -1) for k in parts)
    return np.concatenate([rational_net(q) for q in nets], axis=-1)


_EIGHT = np.arange(8)


def check_spread(
    patches: Float[np.ndarray, "patches 10 10 4"], mesh: Mesh, faces: Int[np.ndarray, "patches"], allowed: bool
) -> tuple[str, ...]:
    """A note on patches whose weights differ by more than 10^6: control points may lie far away (``rounding_error``).

    mesh, faces : the control mesh, and which of its faces each patch is of

    Raises InputError unless they are allowed, with the number of the vertex there whose Gaussian differs most from the
    others'.
    """
    weights = patches[..., 3].reshape(len(patches), -1)
    thin = np.flatnonzero(~(weights.min(axis=1) >= _LEAST_SPREAD * weights.max(axis=1)))
    if not thin.size:
        return ()
    assert mesh.covariances is not None
    first = faces[thin[0]]
    own = mesh.corners[np.isin(mesh.face, faces[thin])]
    around = np.unique(mesh.corners[np.isin(mesh.face, mesh.face[np.isin(mesh.corners, own)])])  # and the one-rings
    sizes = np.log(np.linalg.eigvalsh(mesh.covariances[around]))
    worst = int(around[np.argmax(np.abs(sizes - np.median(sizes, axis=0)).max(axis=1))])
    said = (
        f"weights differ by more than {1.0 / _LEAST_SPREAD:.0e} in {thin.size} patches (the first of face"
        f" {mesh.numbers[first]}): the Gaussian of vertex {worst} (counted from 0) differs most from its neighbours'"
    )
    if not allowed:
        raise InputError(f"{said}; make it rounder, or allow thin ones", options=("allow_thin",))
    return (f"{said}; rounding_error says what single precision adds there",)
