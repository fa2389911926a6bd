"""Gregory patches [LSNC09]: Bézier patches whose points next to corners turn from one to another around the corner.

A corner has two face points, f+ along the side that comes first counter-clockwise and f- along the other. With s and t
from 0 at the corner along these sides the patch has there F = (s f+ + t f-)/(s + t), so

    Q(u, v) = sum P_ij B_i(u) B_j(v) + sum_k D_k b_k(u, v) z_k(u, v),       z = (s - t)/(2 (s + t)),  -1/2 <= z <= 1/2,

with the means of both at the places of Bézier points, D = f+ - f-, and b_k the polynomial that F is multiplied with.
Second derivatives of b z are bounded, and jump at the corner. On the patch's sides b = 0: these are the net's curves.

Of quads there are four such terms, b = 9 s t (1-s)^2 (1-t)^2; of triangles, pinched at u = 1 with the barycentric
coordinates ((1-u)(1-v), (1-u) v, u), two, b = 12 a^2 b c: at the third corner the quotient is a polynomial.
"""

from __future__ import annotations

from functools import reduce
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from slefejax.errors import InputError
from slefejax.geometry.bezier import Values

QUAD_TWISTS = 4  # at (0, 0), (1, 0), (1, 1), (0, 1)
TRIANGLE_TWISTS = 2  # at (0, 0), (0, 1)
_CLOSE = 16.0  # a raised net is apart from what it was raised from by less, in eps of its points' distances from 0


class Twisted(NamedTuple):
    """A net and its twists, in whatever order kernels want their axes: a kernel's ``control`` of Gregory patches."""

    net: Any
    twists: Any


@jax.tree_util.register_pytree_node_class
class GregoryPatches:
    """Gregory patches: taken wherever Bézier patches are, if nothing else is said.

    net    : ``(patches, n, n, 3)``, Bézier points with the means of both face points; n is 4, or 5 with triangles
    twists : ``(patches, slots, 3)``, f+ - f-: 4 slots, of the corners (0,0), (1,0), (1,1), (0,1) of quads; with
             triangles 2 more, of their corners (0,0), (0,1). Zeros where a patch is a Bézier patch

    >>> flat = np.zeros((1, 4, 4, 3))
    >>> GregoryPatches(flat, np.zeros((1, 4, 3)))
    GregoryPatches(1 of bi-degree 3)
    """

    def __init__(self, net: Any, twists: Any) -> None:
        self.net, self.twists = net, twists
        shapes = np.shape(net), np.shape(twists)
        n = shapes[0][1] if len(shapes[0]) == 4 else 0
        slots = {4: QUAD_TWISTS, 5: QUAD_TWISTS + TRIANGLE_TWISTS}.get(n)
        if slots is None or shapes != ((len(net), n, n, 3), (len(net), slots, 3)) or not len(net):
            raise InputError(
                "Gregory patches are a net (patches, 4, 4, 3) and twists (patches, 4, 3), or with triangles"
                f" (patches, 5, 5, 3) and (patches, 6, 3), not {shapes[0]} and {shapes[1]}"
            )

    def __repr__(self) -> str:
        return f"GregoryPatches({len(self)} of bi-degree {self.net.shape[1] - 1})"

    def __len__(self) -> int:
        return len(self.net)

    def __getitem__(self, which: Any) -> GregoryPatches:
        """Some of them, none too."""
        return self.tree_unflatten(None, (self.net[which], self.twists[which]))

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> np.ndarray:
        raise InputError(_NO_BEZIER)

    def __jax_array__(self) -> Any:
        raise InputError(_NO_BEZIER)

    @property
    def shape(self) -> tuple[int, ...]:
        """Of the net."""
        return self.net.shape

    @property
    def dtype(self) -> Any:
        """Of the net."""
        return self.net.dtype

    @property
    def twisted(self) -> Any:
        """``(patches,)``: which of them are no Bézier patches."""
        return (self.twists != 0).any(axis=(1, 2))

    def astype(self, dtype: Any) -> GregoryPatches:
        """In another precision."""
        return GregoryPatches(self.net.astype(dtype), self.twists.astype(dtype))

    def on_host(self) -> GregoryPatches:
        """As NumPy arrays."""
        return GregoryPatches(np.asarray(self.net), np.asarray(self.twists))

    def tobytes(self) -> bytes:
        """All numbers, as of an array."""
        return np.asarray(self.net).tobytes() + np.asarray(self.twists).tobytes()

    def tree_flatten(self) -> tuple[Any, None]:
        """For JAX."""
        return (self.net, self.twists), None

    @classmethod
    def tree_unflatten(cls, _: None, children: Any) -> GregoryPatches:
        """For JAX, which puts anything there."""
        made = object.__new__(cls)
        made.net, made.twists = children
        return made


_NO_BEZIER = (
    "these are Gregory patches, no array of Bézier points: what is asked for takes Bézier patches (the scheme 'acc');"
    " .net and .twists are the arrays"
)


def lowered(control: Twisted, origin: Any) -> tuple[Twisted, Any, Any]:
    """Quads of bi-degree 4 as those of bi-degree 3 that they were raised from.

    control : net ``(5, 5, 3, lanes)``, twists ``(6, 3, lanes)``, relative to the origin ``(3,)``

    Returns them; how far the coefficients given are at most from theirs, but for rounding, ``(3, lanes)``; and which
    patches are no such quads, ``(lanes,)``: triangles, and nets that more than rounding sets apart.

    >>> found, apart, others = lowered(Twisted(jnp.ones((5, 5, 3, 1)), jnp.zeros((6, 3, 1))), jnp.zeros(3))
    >>> found.net.shape, found.twists.shape, float(apart.max()), others.tolist()
    ((4, 4, 3, 1), (4, 3, 1), 0.0, [False])
    """
    net, twists = control
    rows, by_u = _lowered(net)
    columns, by_v = _lowered(jnp.swapaxes(rows, 0, 1))
    apart = jax.lax.stop_gradient(by_u + by_v)
    reach = sum(jnp.abs(net[i, j]) for i in (0, -1) for j in (0, -1)) + jnp.abs(origin)[:, None]
    wrong = [~(apart <= _CLOSE * jnp.finfo(apart.dtype).eps * reach), *(twists[QUAD_TWISTS:] != 0)]
    others = reduce(jnp.logical_or, [own[a] for own in wrong for a in range(3)])
    return Twisted(jnp.swapaxes(columns, 0, 1), twists[:QUAD_TWISTS]), jnp.where(others, 0.0, apart), others


def _lowered(net: Any) -> tuple[Any, Any]:
    """Along the first axis, and the largest size of what is then missing in the middle."""
    near, far = (4.0 * net[1] - net[0]) / 3.0, (4.0 * net[3] - net[4]) / 3.0
    return jnp.stack([net[0], near, far, net[4]]), jnp.max(jnp.abs(net[2] - 0.5 * (near + far)), axis=0)


def twist_basis(slots: int, u: Values, v: Values) -> list[Values]:
    """What twists are multiplied with: b z of every slot at (u, v).

    >>> [round(float(x), 4) for x in twist_basis(4, np.array(0.5), np.array(0.25))]
    [0.0264, -0.0264, -0.0053, 0.0053]
    """
    found = [_of_quad(s, t) for s, t in ((u, v), (v, 1 - u), (1 - u, 1 - v), (1 - v, u))]
    if slots == QUAD_TWISTS:
        return found
    a, b, c = (1 - u) * (1 - v), (1 - u) * v, u
    return [*found, 12 * a * a * b * c * _turn(c, b), 12 * b * b * a * c * _turn(a, c)]


def twist_slopes(slots: int, u: Any, v: Any, pinched: bool = False) -> tuple[list[Any], list[Any]]:
    """Derivatives of ``twist_basis`` by u, and by v; at the corner itself 0, as they are wherever one goes there.

    pinched : those by v of triangles over 1 - u, which is a factor of theirs

    >>> by_u, by_v = twist_slopes(4, np.array(0.0), np.array(0.5))
    >>> [abs(round(float(x), 4)) for x in by_u], [abs(round(float(x), 4)) for x in by_v]
    ([0.5625, 0.0, 0.0, 0.5625], [0.0, 0.0, 0.0, 0.0])
    """
    by_u, by_v = [], []
    # (s, t) of a slot, and how both change along u and along v
    turned = ((u, v, 1, 0, 0, 1), (v, 1 - u, 0, -1, 1, 0), (1 - u, 1 - v, -1, 0, 0, -1), (1 - v, u, 0, 1, -1, 0))
    for s, t, s_u, t_u, s_v, t_v in turned:
        a, b = 1 - s, 1 - t
        by_s, by_t = _slopes(9 * (a * b) ** 2, s, t, -18 * a * b**2, -18 * b * a**2)
        by_u.append(by_s * s_u + by_t * t_u)
        by_v.append(by_s * s_v + by_t * t_v)
    for k in range(slots - QUAD_TWISTS):
        # t = (1 - u) w with w = v, or 1 - v and the opposite sign
        w, sign = (v, 1.0) if k == 0 else (1 - v, -1.0)
        p, p_u, p_w = 12 * ((1 - u) * (1 - w)) ** 2, -24 * (1 - u) * (1 - w) ** 2, -24 * (1 - w) * (1 - u)
        value, by_s, by_t = _turning(u, (1 - u) * w)
        by_u.append(sign * (p_u * value + p * (by_s - w * by_t)))
        own = p_w * value + p * by_t
        by_v.append(own if pinched else (1 - u) * own)
    return by_u, by_v


def _slopes(p: Any, s: Any, t: Any, p_s: Any, p_t: Any) -> tuple[Any, Any]:
    value, by_s, by_t = _turning(s, t)
    return p_s * value + p * by_s, p_t * value + p * by_t


def _turning(s: Any, t: Any) -> tuple[Any, Any, Any]:
    """s t (s - t)/(2 (s + t)), and its derivatives by s and t."""
    both = _positive(s + t)
    y = t / both
    return s * t * (s - t) / (2.0 * both), 0.5 * t - t * y * y, 0.5 * s - s * y * (2.0 - y)


def _of_quad(s: Values, t: Values) -> Values:
    return 9 * s * t * ((1 - s) * (1 - t)) ** 2 * _turn(s, t)


def _turn(s: Values, t: Values) -> Values:
    """(s - t)/(2 (s + t)); where both are 0, whatever it is multiplied with is 0 too."""
    return (s - t) / (2.0 * _positive(s + t))


def _positive(values: Values) -> Values:
    """1 where they are not."""
    xp: Any = np if isinstance(values, (np.ndarray, np.floating, float)) else jnp
    return xp.where(values > 0, values, 1.0)
