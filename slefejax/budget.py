"""How coarse a tolerance, or how far a camera, meets a number of triangles.

Triangles that are drawn are a staircase: levels are whole numbers, shared edges and transition rings add some. First
optimistix finds the root of the sum of 2 tau^2 over the patches, a real number that JAX computes; from there the
staircase is climbed step by step, by counts of the triangles that a tessellator makes.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from slefejax.arguments import Patches, check_patches, is_whole
from slefejax.edges import shared_edges
from slefejax.errors import InputError
from slefejax.factors import Factors, tessellation_factors
from slefejax.framing import clipping_planes
from slefejax.late import one_at_a_time
from slefejax.tessellator import triangle_counts
from slefejax.view import Camera, View, bounding_sphere

WITHIN = 0.01  # of the budget, below it
_AIM = 0.996  # of the budget: where a step of the search aims
_STEP = 1e-6  # of the tolerance or the distance: two places so near with counts on both sides of the budget are a step
_CLIMB = 60
_REACH = 30.0  # logarithms of the tolerance on either side of half a pixel
_LEVEL = 2.0**20  # factors beyond it are no search's aim
_DISTANCES = np.exp(np.linspace(0.0, 12.0, 97))  # at which a place for the camera is looked for, from its own on


class Budget(NamedTuple):
    """What meets a budget of triangles.

    tolerance : pixels;  view : the camera;  distance : of the eye from the target, in scene units
    factors   : with their levels, those that are drawn;  triangles : how many these are, at most the budget
    above     : the fewest triangles above the budget that were met on the way; None if there were none
    is_step   : whether the next triangles are that many at once, so that nothing lies between them and the budget
    counts    : how often drawn triangles were counted
    """

    tolerance: float
    view: View
    distance: float
    factors: Factors
    triangles: int
    above: int | None
    is_step: bool
    counts: int


def tolerance_for_budget(
    patches: Patches, view: View, triangles: Any, *, edge_numbers: Any = None, **options: Any
) -> Budget:
    """A tolerance that a number of triangles is enough for: the finest, to within 1 % of them or one step.

    patches, view, edge_numbers, options : as for ``tessellation_factors``, but for the tolerance
    triangles    : as drawn, with shared edges and transition rings

    Raises InputError for a budget that even the coarsest tolerance exceeds, and as ``tessellation_factors`` does.

    >>> from slefejax import Camera, load
    >>> view = View(Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), width=1440, height=900)
    >>> found = tolerance_for_budget(load("teapot").patches(), view, 10_000, method="slefe")
    >>> 0.99 * 10_000 <= found.triangles <= 10_000
    True
    """
    patches, wanted = _checked(patches, view, triangles, options, True)
    edges = shared_edges(np.asarray(patches)) if edge_numbers is None else edge_numbers

    def factors(log: float) -> Factors:
        own = {**options, "tolerance": float(np.exp(log))}
        return tessellation_factors(patches, view, edge_numbers=edges, **own)

    start = _tolerance_root(patches, view, wanted, options)
    return _climb(factors, start, wanted, lambda log: (float(np.exp(log)), view))


def distance_for_budget(
    patches: Patches, view: View, triangles: Any, *, edge_numbers: Any = None, **options: Any
) -> Budget:
    """The nearest place of the camera, on its line of sight, from which a number of triangles is enough.

    Nearest to where it is: a camera that needs too many goes away from its target until they are enough, one that needs
    fewer comes closer until they are used up. Near and far move along. Arguments as of ``tolerance_for_budget``, with a
    tolerance among the options (half a pixel if not).

    Raises InputError for a camera without perspective, for a budget that no place on the line meets, and as
    ``tessellation_factors`` does.
    """
    patches, wanted = _checked(patches, view, triangles, options, False)
    if not view.camera.perspective:
        raise InputError("without perspective the distance of the camera changes nothing: ask for the tolerance")
    edges = shared_edges(np.asarray(patches)) if edge_numbers is None else edge_numbers
    points = np.asarray(patches)[..., :3] / (np.asarray(patches)[..., 3:] if patches.shape[3] == 4 else 1.0)
    sphere = bounding_sphere(points.reshape(-1, 3))
    tolerance = float(options.get("tolerance", 0.5))

    def factors(log: float) -> Factors:
        return tessellation_factors(patches, moved(view, sphere, float(np.exp(log))), edge_numbers=edges, **options)

    start = _distance_root(patches, view, sphere, wanted, options)
    return _climb(factors, start, wanted, lambda log: (tolerance, moved(view, sphere, float(np.exp(log)))))


def moved(view: View, sphere: tuple[Any, Any], scale: Any) -> View:
    """The view from so many times as far away from its target; ``scale`` may be traced.

    sphere : centre and radius of the scene, for the clipping planes (``slefejax.view.bounding_sphere``)
    """
    camera = view.camera
    eye = camera.target + scale * (camera.eye - camera.target)
    near, far = clipping_planes(sphere, camera, eye)
    return replace(view, camera=Camera.look_at(eye, camera.target, camera.up, camera.extent, near, far))


def real_triangles(patches: Any, view: View, **options: Any) -> Any:
    """The sum of 2 tau^2 over the visible patches: triangles of uniform grids without rounding. Differentiable."""
    factor = tessellation_factors(patches, view, **options).factor
    return 2.0 * jnp.sum(jnp.minimum(factor, _LEVEL) ** 2)


def _checked(patches: Any, view: Any, triangles: Any, options: dict[str, Any], is_tolerance: bool) -> tuple[Any, int]:
    patches = check_patches(patches)
    if is_tolerance and "tolerance" in options:
        raise InputError("the tolerance is what is looked for: leave it out")
    if not is_whole(triangles, 2):
        raise InputError(f"a budget is a whole number of triangles, at least 2, not {triangles!r}")
    if options.get("method") == "fixed":
        raise InputError("method 'fixed' makes the same triangles whatever the tolerance: there is nothing to find")
    coarse = {"edge-length": "setting", "screen-box": "setting"}.get(options.get("method", "certified"))
    if coarse:
        raise InputError(f"method {options['method']!r} knows no tolerance: change its {coarse}")
    plain = {name: value for name, value in options.items() if name not in ("anisotropic", "verify")}
    visible = int(np.count_nonzero(np.asarray(tessellation_factors(patches, view, **plain).factor)))
    if visible == 0:
        raise InputError("no patch is visible from this camera: there is nothing to spend triangles on")
    return patches, int(triangles)


def _smooth_options(options: dict[str, Any]) -> dict[str, Any]:
    """Those that a traced count can do with: whole numbers come later."""
    return {name: value for name, value in options.items() if name not in ("anisotropic", "verify", "tolerance")}


def _tolerance_root(patches: Any, view: View, wanted: int, options: dict[str, Any]) -> float:
    smooth = _smooth_options(options)

    def excess(log: Any, patches: Any) -> Any:
        return jnp.log(real_triangles(patches, view, tolerance=jnp.exp(log), **smooth) / (wanted + 0.5))

    middle = float(np.log(0.5))
    return _root(excess, middle - _REACH, middle + _REACH, jnp.asarray(patches))


def _distance_root(patches: Any, view: View, sphere: Any, wanted: int, options: dict[str, Any]) -> float:
    own = {**_smooth_options(options), "tolerance": options.get("tolerance", 0.5)}
    tolerance = own.pop("tolerance")

    def excess(log: Any, patches: Any) -> Any:
        seen = real_triangles(patches, moved(view, sphere, jnp.exp(log)), tolerance=tolerance, **own)
        return jnp.log(jnp.maximum(seen, 1e-3) / (wanted + 0.5))

    points = jnp.asarray(patches)
    at = jax.jit(excess)
    too_many = float(at(0.0, points)) > 0
    before = 0.0
    for distance in _DISTANCES[1:]:
        log = float(np.log(distance)) * (1.0 if too_many else -1.0)
        if (float(at(log, points)) > 0) != too_many:
            return _root(excess, min(before, log), max(before, log), points)
        before = log
    how = "away" if too_many else "closer"
    raise InputError(f"no place on the camera's line of sight meets {wanted:,} triangles, however far it moves {how}")


def _root(excess: Callable[[Any, Any], Any], low: float, high: float, patches: Any) -> float:
    """Where the excess, which falls, changes its sign; the end that is nearer to that if it does not."""
    with one_at_a_time:
        import optimistix as optx  # slow to import

    solver = optx.Bisection(rtol=0.0, atol=1e-3, flip=True)

    def double(log: Any, patches: Any) -> Any:
        return excess(log, patches).astype(log.dtype)  # which patches in single precision do not make

    with jax.enable_x64(True):
        ends = {"lower": jnp.asarray(low), "upper": jnp.asarray(high)}
        found = optx.root_find(
            double, solver, jnp.asarray(0.5 * (low + high)), args=patches, options=ends, max_steps=60, throw=False
        )
        return float(found.value)


def _climb(
    factors: Callable[[float], Factors], start: float, wanted: int, place: Callable[[float], tuple[float, View]]
) -> Budget:
    """From a first logarithm to the best one: counts fall as it grows, about as exp(-log)."""
    low = high = above = None
    best: tuple[int, float, Factors] | None = None
    log, counts, is_step = start, 0, False
    while counts < _CLIMB:
        found = factors(log)
        count, counts = int(triangle_counts(found.inner, found.edges).sum()), counts + 1
        if count > wanted:
            low, above = log, count if above is None else min(above, count)
            if found.levels.max() <= 1:
                raise InputError(f"{wanted:,} triangles are too few: with one piece a patch there are {count:,}")
        else:
            high = log
            if best is None or count >= best[0]:
                best = count, log, found
            if best[0] >= (1.0 - WITHIN) * wanted or log < start - _REACH:
                break
        if low is not None and high is not None and abs(high - low) < _STEP:
            is_step = True
            break
        log = _next(log + np.log(max(count, 1) / (_AIM * wanted)), log, low, high, counts)
    if best is None:
        raise InputError(f"nothing was found that meets {wanted:,} triangles: the fewest that were met are {above:,}")
    count, log, found = best
    tolerance, view = place(log)
    camera = view.camera
    distance = float(np.linalg.norm(np.asarray(camera.target) - np.asarray(camera.eye)))
    return Budget(tolerance, view, distance, found, count, above, is_step, counts)


def _next(guess: float, log: float, low: float | None, high: float | None, counts: int) -> float:
    """Where to count next: the guess if it leads on, or the middle of what is left."""
    if low is None or high is None:
        # overshoot a little, so that the other side is met
        return float(np.clip(guess + 1e-3 * counts * np.sign(guess - log), log - 3.0, log + 3.0))
    margin = 0.05 * abs(high - low)
    inside = min(low, high) + margin < guess < max(low, high) - margin
    return float(guess) if inside and counts % 3 else 0.5 * (low + high)
