"""Fewer triangles for nearly the same surface: inner control points of patches moved along gradients.

Boundary rows of control points stay, so edges stay where they are, point by point, and nothing opens. Inner ones are
moved, in space and along the surface (which changes the parametrisation alone), so that factors get smaller, as long as
the surface stays within a distance of the one that was given.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float

from slefejax.arguments import Number, Patches, check_patches, check_positive, is_whole
from slefejax.bezier import evaluate_patch
from slefejax.budget import real_triangles
from slefejax.errors import InputError
from slefejax.factors import tessellation_factors
from slefejax.view import View

_SMOOTH = 0.02  # temperature of the factors while points move
_WEIGHTS = (0.1, 1.0)  # of distances beyond the allowed one, one after the other
_ALLOWED = 0.8  # of the distance: between the places where it is looked at it may be larger
_PLACES = 9  # along each side, while points move
_CHECKED = 33  # along each side, afterwards
_NEAREST = 2  # steps towards the nearest point while points move
_NEAREST_CHECKED = 8
_HALVINGS = 12


class Relaxed(NamedTuple):
    """Patches that need fewer triangles.

    patches   : control points of the same shape;  distance : ``(patches,)``, the largest from the given surface, in
                scene units, at places of a fine grid
    moved     : ``(patches,)``, whether anything of the patch was moved
    steps     : of the solver;  reason : why it ended before it had converged, if it did
    """

    patches: Float[np.ndarray, "patches nu nv 3"]
    distance: Float[np.ndarray, "patches"]
    moved: Any
    steps: int
    reason: str


def fewer_triangles(
    patches: Patches,
    views: Sequence[View],
    within: Number,
    *,
    steps: int = 40,
    progress: Callable[[int], None] | None = None,
    **options: Any,
) -> Relaxed:
    """Move inner control points so that the triangles of all views become fewer, within a distance of the surface.

    patches : polynomial, ``(patches, du+1, dv+1, 3)``, of degree 2 or more in u and v
    views   : whose sum of 2 tau^2 shall become small
    within  : the largest distance from the given surface, in scene units
    steps   : of the solver (L-BFGS) for each of its two weights;  progress : hears how many weights are done
    options : those of ``tessellation_factors`` but ``anisotropic``, ``verify`` and ``smooth``

    A patch that ends too far away goes back on a straight line as far as it must, and all the way if its triangles
    did not become fewer. Raises InputError for rational patches, linear ones, and as ``tessellation_factors`` does.
    """
    patches = check_patches(patches, dims=(3,))
    check_positive("within", within)
    if min(patches.shape[1:3]) < 3:
        raise InputError("patches of degree 1 have no inner control points to move")
    if not is_whole(steps, 1) or not len(views):
        raise InputError("moving control points needs a step and a view at least")
    for name in ("anisotropic", "verify", "smooth"):
        if options.pop(name, None):
            raise InputError(f"{name} has no meaning here: factors are real, and smooth while points move")
    given, distance = jnp.asarray(patches), float(within)
    before = _per_patch(given, views, options)
    offsets, count, reason = _descend(given, views, distance, steps, progress, options)
    share = _feasible_share(given, offsets, distance)
    found = _shifted(given, offsets * share[:, None, None, None])
    better = _per_patch(found, views, options) < before * (1.0 - 1e-9)
    found = jnp.where(jnp.asarray(better)[:, None, None, None], found, given)
    return Relaxed(np.asarray(found), surface_distance(found, given), better, count, reason)


def surface_distance(patches: Patches, given: Patches, places: int = _CHECKED) -> Float[np.ndarray, "patches"]:
    """How far each patch lies from the one of the same number that was given: the largest over a grid of places.

    From every point of the grid on the patch Newton's method looks for the nearest point of the other, beginning at the
    same parameters; what it finds is no nearer than the nearest there is, so distances are not understated between the
    same places. Scene units.
    """
    patches, given = check_patches(patches, dims=(3,)), check_patches(given, dims=(3,))
    if patches.shape[0] != given.shape[0]:
        raise InputError(f"there are {patches.shape[0]} patches and {given.shape[0]} to compare with")
    squares = _distances_jit(jnp.asarray(patches), jnp.asarray(given), places, _NEAREST_CHECKED)
    return np.sqrt(np.max(np.asarray(squares), axis=1))


def _descend(
    given: Any, views: Sequence[View], distance: float, steps: int, progress: Any, options: dict[str, Any]
) -> tuple[Any, int, str]:
    start = float(sum(real_triangles(given, view, **options) for view in views))

    def objective(offsets: Any, arguments: tuple[Any, Any]) -> Any:
        given, weight = arguments
        patches = _shifted(given, distance * offsets)
        triangles = sum(real_triangles(patches, view, smooth=_SMOOTH, **options) for view in views)
        over = jnp.maximum(_distances(patches, given, _PLACES, _NEAREST) / distance**2 - _ALLOWED**2, 0.0)
        return triangles / start + weight * jnp.sum(over**2) / len(given)

    nu, nv = given.shape[1:3]
    offsets = jnp.zeros((len(given), nu - 2, nv - 2, 3), given.dtype)
    count, reason = 0, ""
    for number, weight in enumerate(_WEIGHTS):
        solver = optx.LBFGS(rtol=1e-5, atol=1e-5)
        found = optx.minimise(objective, solver, offsets, args=(given, weight), max_steps=steps, throw=False)
        if not np.isfinite(np.asarray(found.value)).all():
            return distance * offsets, count, "the solver met a number that is not finite"
        offsets, count = found.value, count + int(found.stats["num_steps"])
        reason = "" if bool(found.result == optx.RESULTS.successful) else f"{steps} steps were not enough to converge"
        if progress is not None:
            progress(number + 1)
    return distance * offsets, count, reason


def _shifted(given: Any, offsets: Any) -> Any:
    return given.at[:, 1:-1, 1:-1].add(offsets)


def _per_patch(patches: Any, views: Sequence[View], options: dict[str, Any]) -> np.ndarray:
    """Triangles of each patch, summed over views, without rounding."""
    return sum(np.asarray(tessellation_factors(patches, view, **options).factor) ** 2 for view in views)  # type: ignore[return-value]


def _feasible_share(given: Any, offsets: Any, distance: float) -> Any:
    """How much of each patch's offsets keeps it within the distance: all, or what halving an interval finds."""
    low, high = np.zeros(len(given)), np.ones(len(given))
    fine = surface_distance(_shifted(given, offsets), given) <= distance
    low[fine] = 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        fine = surface_distance(_shifted(given, offsets * middle[:, None, None, None]), given) <= distance
        low, high = np.where(fine, middle, low), np.where(fine, high, middle)
    return low


@partial(jax.jit, static_argnums=(2, 3))
def _distances_jit(patches: Any, given: Any, places: int, steps: int) -> Any:
    return _distances(patches, given, places, steps)


def _distances(patches: Any, given: Any, places: int, steps: int) -> Any:
    """Squares of distances ``(patches, places^2)`` between points of patches and the nearest ones of those given."""
    t = np.linspace(0.0, 1.0, places)
    u, v = (x.ravel().astype(patches.dtype) for x in np.meshgrid(t, t, indexing="ij"))
    point = _surface(patches, u, v)
    u, v = (jnp.broadcast_to(x, point.shape[1:]) for x in (u, v))
    for _ in range(steps):
        u, v = _nearer(given, point, u, v)
    return jnp.sum((point - _surface(given, u, v)) ** 2, axis=0)


def _nearer(given: Any, point: Any, u: Any, v: Any) -> tuple[Any, Any]:
    """A Gauss-Newton step of the parameters towards the foot of the perpendicular; none where tangents are parallel."""
    ones = jnp.ones_like(u)
    here, along_u = jax.jvp(lambda t: _surface(given, t, v), (u,), (ones,))
    _, along_v = jax.jvp(lambda t: _surface(given, u, t), (v,), (ones,))
    left = point - here
    a, b, c = (jnp.sum(p * q, axis=0) for p, q in ((along_u, along_u), (along_u, along_v), (along_v, along_v)))
    x, y = jnp.sum(along_u * left, axis=0), jnp.sum(along_v * left, axis=0)
    determinant = a * c - b * b
    steep = determinant > 1e-9 * a * c
    safe = jnp.where(steep, determinant, 1.0)
    step_u, step_v = jnp.where(steep, (c * x - b * y) / safe, 0.0), jnp.where(steep, (a * y - b * x) / safe, 0.0)
    return jnp.clip(u + step_u, 0.0, 1.0), jnp.clip(v + step_v, 0.0, 1.0)


def _surface(control: Any, u: Any, v: Any) -> Any:
    """Points ``(3, patches, places)``."""
    return evaluate_patch(jnp.moveaxis(control, 0, -1)[..., None], u, v)
