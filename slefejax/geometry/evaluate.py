"""Points of patches of every kind: the one evaluator of everything that measures."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from slefejax.arguments import Numbers, Patches, check_patches, check_weights, floating
from slefejax.errors import InputError
from slefejax.geometry.bezier import Values, bernstein, combine, evaluate_patch
from slefejax.geometry.gregory import GregoryPatches, Twisted, twist_basis


def evaluate(control: Any, u: Values, v: Values) -> Values:
    """Points of Bézier patches, coefficients ``(du+1, dv+1, ...)``, or of Gregory patches: ``Twisted``, twists
    ``(slots, ...)``; u and v broadcast against the rest.

    >>> flat = Twisted(np.ones((4, 4, 3)), np.zeros((4, 3)))
    >>> evaluate(flat, 0.5, 0.25).tolist()
    [1.0, 1.0, 1.0]
    """
    if not isinstance(control, Twisted):
        return evaluate_patch(control, u, v)
    return evaluate_patch(control.net, u, v) + combine(control.twists, twist_basis(len(control.twists), u, v))


def places_at(control: Any, u: Values, v: Values, evaluator: Callable[..., Values] = evaluate) -> Values:
    """The same in space, ``(3, ...)``: of rational patches, of four rows, over their weights.

    evaluator : ``evaluate``, or ``evaluate_grid`` with parameters as it takes them

    >>> half = np.array([1.0, 2.0, 3.0, 2.0]).reshape(1, 1, 4)
    >>> places_at(half, 0.5, 0.25).tolist()
    [0.5, 1.0, 1.5]
    """
    found = evaluator(control, u, v)
    return found[:3] / found[3] if len(found) == 4 else found


def evaluate_grid(control: Any, u: Any, v: Any) -> Any:
    """Points ``(4, us, vs, lanes)`` of patches ``(nu, nv, 4, lanes)``, u ``(us, lanes)`` with v ``(vs, lanes)``.

    >>> evaluate_grid(jnp.ones((2, 2, 4, 1)), jnp.zeros((3, 1)), jnp.zeros((2, 1))).shape
    (4, 3, 2, 1)
    """
    net = control.net if isinstance(control, Twisted) else control
    rows = combine(net[:, :, :, None], bernstein(net.shape[0] - 1, u))
    found = combine(rows[:, :, :, None], bernstein(net.shape[1] - 1, v[None]))
    if not isinstance(control, Twisted):
        return found
    basis = twist_basis(len(control.twists), u[:, None], v[None])
    return found + combine(control.twists[:, :, None, None], basis)


def evaluate_patches(patches: Patches, parameters: Numbers) -> Float[Array | np.ndarray, "patches places 3"]:
    """Points of patches at parameters (u, v), which run from 0 to 1; differentiable by both.

    patches    : ``(patches, du+1, dv+1, 3)``, u before v; 4 at the end if rational, (w x, w y, w z, w), w > 0; or
                 ``GregoryPatches``
    parameters : ``(places, 2)``, the same for all patches, or ``(patches, places, 2)``, for each its own
    returns    : ``(patches, places, 3)``, in the units and the precision of the patches; by NumPy unless one of both is
                 JAX's

    Raises InputError for a wrong shape, or a weight that is not positive (with the patch's number).

    >>> arc = np.array([[1, 0, 0, 1], [1, 1, 0, 1], [0, 2, 0, 2]], float)      # a quarter circle
    >>> evaluate_patches(np.stack([arc, arc], axis=1)[None], [[0.0, 0.5], [0.5, 0.5]]).tolist()
    [[[1.0, 0.0, 0.0], [0.6, 0.8, 0.0]]]
    """
    given, parameters = check_patches(patches, gregory=True), floating(parameters)
    check_weights(given)
    if parameters.shape[-1:] != (2,) or parameters.shape[:-2] not in ((), given.shape[:1]) or parameters.ndim < 2:
        raise InputError(
            f"parameters of {len(given)} patches must have shape (places, 2) or ({len(given)}, places, 2), not"
            f" {tuple(parameters.shape)}"
        )
    xp: Any = np if all(isinstance(x, np.ndarray) for x in (*jax.tree.leaves(given), parameters)) else jnp
    control = beside_places(given, xp)
    u, v = xp.moveaxis(xp.asarray(parameters, given.dtype), -1, 0)
    return xp.moveaxis(places_at(control, u, v), 0, -1)


def as_control(patches: Any) -> Any:
    """An array of Bézier points as it is, and ``Twisted`` of Gregory patches.

    >>> as_control(np.zeros((1, 4, 4, 3))).shape
    (1, 4, 4, 3)
    """
    return Twisted(patches.net, patches.twists) if isinstance(patches, GregoryPatches) else patches


def beside_places(patches: Any, xp: Any = jnp) -> Any:
    """What ``evaluate`` takes with parameters ``(patches, places)``, by NumPy or JAX: an axis more for the places.

    >>> beside_places(np.zeros((5, 4, 4, 3))).shape
    (4, 4, 3, 5, 1)
    """
    return jax.tree.map(lambda x: xp.moveaxis(xp.asarray(x), 0, -1)[..., None], as_control(patches))
