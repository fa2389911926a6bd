"""Fewer triangles for nearly the same surface: inner control points of patches moved along gradients.

Boundary rows of control points stay, so edges stay where they are, point by point, and nothing opens. Inner ones are
moved, in space and along the surface (which changes the parametrisation alone), so that factors get smaller, as long as
the surface stays within a distance of the one that was given, and its tangent planes along the edges within an angle.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any, NamedTuple, Unpack

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float

from slefejax.arguments import Number, Patches, check_patches, check_positive, is_whole
from slefejax.errors import InputError
from slefejax.geometry.view import View, check_views
from slefejax.predict.factors import predicted
from slefejax.predict.methods import Certified, Options, Request, Slefe
from slefejax.study.budget import counted, with_normals
from slefejax.study.deviation import distance_squares, side_turns, surface_distance, turn_squares, unfolded

_SMOOTH = 0.02  # temperature of the factors while points move
_WEIGHTS = (0.1, 1.0)  # of distances and turns beyond the allowed ones, one after the other
_ALLOWED = 0.8  # of both: between the places where they are looked at they may be larger
_PLACES = 9  # along each side, while points move
_NEAREST = 2  # steps towards the nearest point while points move
_HALVINGS = 12
_CLOSE = 1e-6  # of the objective, which begins at 1, and of offsets over the distance


class Relaxed(NamedTuple):
    """Patches that need fewer triangles.

    patches   : control points of the same shape;  distance : ``(patches,)``, the largest from the given surface, in
                scene units, at places of a fine grid
    turn      : ``(patches,)``, degrees, the largest turn of the tangent plane along the sides
    moved     : ``(patches,)``, whether anything of the patch was moved
    reason    : why the solver ended before it had converged, if it did
    """

    patches: Float[np.ndarray, "patches nu nv 3"]
    distance: Float[np.ndarray, "patches"]
    turn: Float[np.ndarray, "patches"]
    moved: Any
    reason: str


class Descent(NamedTuple):
    """How far moving has got, to go on from there.

    offsets : of the inner control points, ``(patches, du-1, dv-1, 3)``, over the allowed distance
    weight  : which of the weights of the limits is at work, counted from 0;  steps : taken with it
    memory  : arrays of the solver
    """

    offsets: Any
    weight: int
    steps: int
    memory: tuple[Any, ...]

    def share(self, steps: int) -> float:
        """Of the work, if so many steps are allowed."""
        return (self.weight + min(1.0, self.steps / steps)) / len(_WEIGHTS)


def fewer_triangles(
    patches: Patches,
    views: Sequence[View],
    within: Number,
    turn: Number = 1.0,
    *,
    steps: int = 200,
    start: Descent | None = None,
    progress: Callable[[Descent], None] | None = None,
    **options: Unpack[Options],
) -> Relaxed:
    """Move inner control points so that the triangles of all views become fewer, and the surface hardly changes.

    patches : polynomial, ``(patches, du+1, dv+1, 3)``, of degree 2 or more in u and v; no Gregory patches, which would
              not join smoothly any more
    views   : whose sum of 2 tau^2 shall become small; of one size and one kind of camera
    within  : the largest distance from the given surface, in scene units
    turn    : the largest angle, in degrees, between the tangent planes of a patch before and after, along its sides: at
              twice that neighbours that were smooth may meet. Inside, normals stay within 90 degrees: nothing folds
    steps   : of the solver (L-BFGS) for each of its two weights of the limits
    start, progress : ``progress`` hears after each step how far it has got, and from there ``start`` goes on
    options : those of ``tessellation_factors`` but ``anisotropic``, ``verify`` and ``smooth``; method ``certified`` or
              ``slefe``; normals, if they have to be right, are the surface's

    A patch that ends too far away, or turned too much, goes back on a straight line as far as it must, and all the way
    if its triangles did not become fewer. Raises InputError for rational patches, linear ones, and as
    ``tessellation_factors`` does.
    """
    patches = check_patches(patches)
    if patches.shape[3] == 4:
        raise InputError("rational patches are not moved: give polynomial ones, (patches, du+1, dv+1, 3)")
    request = Request.of(options)
    if not isinstance(request.method, (Certified, Slefe)):
        raise InputError(f"points are moved with smooth factors: method {request.name!r} has none")
    if options.get("normals", "surface") != "surface":
        raise InputError(
            "tangent patches do not follow points that are moved: normals must be 'surface' here", options=("normals",)
        )
    check_positive("within", within)
    check_positive("turn", turn)
    if min(patches.shape[1:3]) < 3:
        raise InputError("patches of degree 1 have no inner control points to move")
    if not is_whole(steps, 1):
        raise InputError(f"steps must be a whole number of at least 1, not {steps!r}")
    check_views(views)
    if len({(view.width, view.height, view.camera.perspective) for view in views}) > 1:
        raise InputError("the views must be of one size, all with perspective or all without")
    for name in ("anisotropic", "verify", "smooth"):
        if getattr(request.method, name, None):
            raise InputError(
                f"{name} has no meaning here: factors are real, and smooth while points move", options=(name,)
            )
    given, limits = jnp.asarray(patches), _Limits(float(within), float(turn))
    before = _per_patch(given, views, request)
    nu, nv = patches.shape[1:3]
    start = start or Descent(np.zeros((len(patches), nu - 2, nv - 2, 3)), 0, 0, ())
    at, reason = _descend(given, views, limits, steps, start, progress, request)
    offsets = limits.distance * jnp.asarray(at.offsets, given.dtype)
    share = _feasible_share(given, offsets, limits)
    found = _shifted(given, offsets * share[:, None, None, None])
    better = _per_patch(found, views, request) < before * (1.0 - 1e-9)
    found = jnp.where(jnp.asarray(better)[:, None, None, None], found, given)
    return Relaxed(np.asarray(found), surface_distance(found, given), side_turns(found, given), better, reason)


class _Limits(NamedTuple):
    """What may change: a distance in scene units, an angle in degrees."""

    distance: float
    turn: float

    def excess(self, patches: Any, given: Any) -> Any:
        """How far patches are beyond the limits, or near them, at a few places: a sum of squares, differentiable."""
        distances = distance_squares(patches, given, _PLACES, _NEAREST) / self.distance**2
        turns = turn_squares(patches, given, _PLACES) / (2.0 * np.sin(np.radians(min(self.turn, 180.0) / 2.0))) ** 2
        return sum(jnp.sum(jnp.maximum(x - _ALLOWED**2, 0.0) ** 2) for x in (distances, turns))

    def kept(self, patches: Any, given: Any) -> Any:
        """Which patches are within both, at many places."""
        near = (surface_distance(patches, given) <= self.distance) & (side_turns(patches, given) <= self.turn)
        return near & unfolded(patches, given)


def _descend(
    given: Any, views: Sequence[View], limits: _Limits, steps: int, at: Descent, progress: Any, request: Request
) -> tuple[Descent, str]:
    """Step by step, one weight of the limits after the other: where that ended, and why if it had not converged."""
    begin, step = _solver(_objective(given, views, limits, request), given.dtype)
    reason = ""
    while at.weight < len(_WEIGHTS):
        offsets, memory = jnp.asarray(at.offsets, given.dtype), begin(jnp.asarray(at.offsets, given.dtype))
        if at.memory:
            memory = jax.tree.unflatten(jax.tree.structure(memory), at.memory)
        taken, converged = at.steps, False
        while taken < steps and not converged:
            offsets, memory, converged = step(offsets, memory, (given, jnp.asarray(_WEIGHTS[at.weight], given.dtype)))
            if not np.isfinite(np.asarray(offsets)).all():
                return at, "the solver met a number that is not finite"
            taken += 1
            at = Descent(np.asarray(offsets), at.weight, taken, tuple(jax.tree.leaves(memory)))
            if progress is not None:
                progress(at)
        reason = "" if converged else f"{steps} steps were not enough to converge"
        at = Descent(at.offsets, at.weight + 1, 0, ())
    return at, reason


def _objective(given: Any, views: Sequence[View], limits: _Limits, request: Request) -> Callable[..., Any]:
    """Triangles over those of the given patches, and what is beyond the limits, of offsets over the distance."""
    start = float(np.sum(_per_patch(given, views, request))) or 1.0
    # side by side, so that the chain from control points to factors is compiled once
    width, height = views[0].width, views[0].height
    cameras = jax.tree.map(lambda *numbers: jnp.stack([jnp.asarray(x) for x in numbers]), *(v.camera for v in views))

    smooth = request._replace(method=replace(request.method, smooth=_SMOOTH))

    def objective(offsets: Any, arguments: tuple[Any, Any]) -> tuple[Any, None]:
        given, weight = arguments
        patches = _shifted(given, limits.distance * offsets)
        prepared = with_normals(smooth, patches)
        counts = jax.lax.map(lambda camera: counted(smooth, prepared, View(camera, width, height)), cameras)
        return jnp.sum(counts) / start + weight * limits.excess(patches, given) / len(given), None

    return objective


def _solver(objective: Callable[..., Any], dtype: Any) -> tuple[Callable[..., Any], Callable[..., Any]]:
    """L-BFGS a step at a time: what makes its memory, and a step from (offsets, memory, arguments) to those and an end.

    ``optimistix.minimise`` takes all steps in one call, which cannot be stopped, and tells nobody how far it is.
    """
    solver, tags = optx.LBFGS(rtol=_CLOSE, atol=_CLOSE), frozenset()
    static: list[Any] = []

    def begin(offsets: Any) -> Any:
        state = solver.init(objective, offsets, None, {}, jax.ShapeDtypeStruct((), dtype), None, tags)
        memory, rest = eqx.partition(state, eqx.is_array)
        static[:] = [rest]
        return memory

    @jax.jit
    def step(offsets: Any, memory: Any, arguments: tuple[Any, Any]) -> tuple[Any, Any, Any]:
        state = eqx.combine(static[0], memory)
        found, state, _ = solver.step(objective, offsets, arguments, {}, state, tags)
        over, _ = solver.terminate(objective, found, arguments, {}, state, tags)
        return found, eqx.filter(state, eqx.is_array), over

    return begin, step


def _shifted(given: Any, offsets: Any) -> Any:
    return given.at[:, 1:-1, 1:-1].add(offsets)


def _per_patch(patches: Any, views: Sequence[View], request: Request) -> np.ndarray:
    """Triangles of each patch, summed over views, without rounding."""
    prepared = with_normals(request, patches)
    factors = [np.asarray(predicted(request, prepared, view).factor) for view in views]
    return 2.0 * np.sum(np.square(factors), axis=0)


def _feasible_share(given: Any, offsets: Any, limits: _Limits) -> Any:
    """How much of each patch's offsets keeps it within the limits: all, or what halving an interval finds."""
    low, high = np.zeros(len(given)), np.ones(len(given))
    fine = limits.kept(_shifted(given, offsets), given)
    low[fine] = 1.0
    for _ in range(_HALVINGS):
        middle = 0.5 * (low + high)
        fine = limits.kept(_shifted(given, offsets * middle[:, None, None, None]), given)
        low, high = np.where(fine, middle, low), np.where(fine, high, middle)
    return low
