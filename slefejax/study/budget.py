"""How coarse a tolerance, or how far a camera, meets a number of triangles.

Triangles that are drawn are a staircase: levels are whole numbers, shared edges and transition rings add some. First
optimistix finds the root of the sum of 2 tau^2 over the patches, a real number that JAX computes; from there the
staircase is climbed step by step, by counts of the triangles that a tessellator makes.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple, Unpack

import jax
import jax.numpy as jnp
import numpy as np
from jax import Array
from jax.core import Tracer

from slefejax.arguments import Patches, is_whole, on_device, on_host
from slefejax.errors import InputError
from slefejax.framing import clipping_planes
from slefejax.geometry.packed import pack
from slefejax.geometry.view import Camera, View, bounding_sphere, check_view
from slefejax.late import one_at_a_time
from slefejax.predict.factors import Factors, predicted, shaded
from slefejax.predict.kernel import Prepared
from slefejax.predict.methods import Options, Request
from slefejax.predict.rules import EdgeLength, Fixed, ScreenBox
from slefejax.tessellator.edges import check_edge_numbers, shared_edges
from slefejax.tessellator.levels import triangle_counts

WITHIN = 0.01  # of the budget, below it
_AIM = 0.996  # of the budget: where a step of the search aims
_STEP = 1e-6  # of the tolerance or the distance: two places so near with counts on both sides of the budget are a step
_CLIMB = 60
_REACH = 30.0  # logarithms of the tolerance on either side of half a pixel
_COARSEST = float(np.log(0.5)) + _REACH  # a logarithm at which positions need one piece a patch
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
    patches: Patches,
    view: View,
    triangles: Any,
    *,
    tangents: Any = None,
    edge_numbers: Any = None,
    **options: Unpack[Options],
) -> Budget:
    """A tolerance that a number of triangles is enough for: the finest, to within 1 % of them or one step.

    patches, view, tangents, edge_numbers, options : as for ``tessellation_factors``, but for the tolerance
    triangles    : as drawn, with shared edges and transition rings

    A ``normal_tolerance`` stays what it is. Raises InputError for a budget that even the coarsest tolerance exceeds, or
    that normals exceed, and as ``tessellation_factors`` does.

    >>> from slefejax import Camera, load
    >>> view = View(Camera.look_at((4.5, -6.0, 4.0), (0.0, 0.0, 1.2)), width=1440, height=900)
    >>> found = tolerance_for_budget(load("teapot").patches(), view, 10_000, method="slefe")
    >>> 0.99 * 10_000 <= found.triangles <= 10_000
    True
    """
    if "tolerance" in options:
        raise InputError("the tolerance is what is looked for: leave it out")
    prepared, request, edges = _checked(patches, view, triangles, options, tangents, edge_numbers)

    def factors(log: float) -> Factors:
        return predicted(request.at(float(np.exp(log))), prepared, view, edges)

    start = _tolerance_root(prepared.packed.patches(), view, triangles, _positions(request))
    coarsest = None if prepared.shading is None else _COARSEST
    return _climb(factors, start, int(triangles), lambda log: (float(np.exp(log)), view), coarsest)


def distance_for_budget(
    patches: Patches,
    view: View,
    triangles: Any,
    *,
    tangents: Any = None,
    edge_numbers: Any = None,
    **options: Unpack[Options],
) -> Budget:
    """The nearest place of the camera, on its line of sight, from which a number of triangles is enough.

    Nearest to where it is: a camera that needs too many goes away from its target until they are enough, one that needs
    fewer comes closer until they are used up. Near and far move along. Arguments as of ``tolerance_for_budget``, with a
    tolerance among the options (half a pixel if not).

    Raises InputError for a camera without perspective, for a budget that no place on the line meets, and as
    ``tessellation_factors`` does.
    """
    prepared, request, edges = _checked(patches, view, triangles, options, tangents, edge_numbers)
    packed = prepared.packed
    if not view.camera.perspective:
        raise InputError("without perspective the distance of the camera changes nothing: ask for the tolerance")
    given = on_host(packed.patches())
    net = getattr(given, "net", given)
    points = net[..., :3] / (net[..., 3:] if packed.dimension == 4 else 1.0)
    sphere = bounding_sphere(points.reshape(-1, 3))
    tolerance = float(request.tolerances.pixels)

    def factors(log: float) -> Factors:
        return predicted(request, prepared, moved(view, sphere, float(np.exp(log))), edges)

    start = _distance_root(given, view, sphere, triangles, _positions(request))
    furthest = None if prepared.shading is None else float(np.log(_DISTANCES[-1]))
    place = lambda log: (tolerance, moved(view, sphere, float(np.exp(log))))  # noqa: E731
    return _climb(factors, start, int(triangles), place, furthest)


def moved(view: View, sphere: tuple[Any, Any], scale: Any) -> View:
    """The view from so many times as far away from its target; ``scale`` may be traced.

    sphere : centre and radius of the scene, for the clipping planes (``slefejax.geometry.view.bounding_sphere``)
    """
    camera = view.camera
    if isinstance(scale, Tracer):
        # an array of NumPy's that is part of a program in single and of one in double precision is mixed up by JAX
        copied = partial(np.array, dtype=jax.dtypes.canonicalize_dtype(np.float64))
        camera = jax.tree.map(lambda part: copied(part) if isinstance(part, np.ndarray) else part, camera)
    eye = camera.target + scale * (camera.eye - camera.target)
    near, far = clipping_planes(sphere, camera, eye)
    return replace(view, camera=Camera.look_at(eye, camera.target, camera.up, camera.extent, near, far))


def real_triangles(patches: Patches, view: View, *, tangents: Any = None, **options: Unpack[Options]) -> Array:
    """The sum of 2 tau^2 over the visible patches: triangles of uniform grids without rounding. Differentiable.

    Arguments as of ``tessellation_factors``.
    """
    packed = pack(patches)
    check_view(view)
    request = Request.of(options, packed.dimension)
    return counted(request, with_normals(request, packed, options.get("normals", "surface"), tangents), view)


def with_normals(request: Request, patches: Patches, normals: str = "surface", tangents: Any = None) -> Prepared:
    """Patches for many views or tolerances: if their normals have to be right, the factors for that are there."""
    found = shaded(request, Prepared(pack(patches)), normals, tangents)
    if found.shading is not None:
        _ = found.shading.factor  # no view changes it; found in a loop over views it would be lost after it
    return found


def counted(request: Request, prepared: Prepared, view: View) -> Array:
    """``real_triangles`` of what was checked."""
    factor = predicted(request, prepared, view).factor
    return 2.0 * jnp.sum(jnp.minimum(factor, _LEVEL) ** 2)


def _checked(
    patches: Patches, view: Any, triangles: Any, options: Mapping[str, Any], tangents: Any, edge_numbers: Any
) -> tuple[Prepared, Request, Any]:
    packed = pack(patches)
    check_view(view)
    if not is_whole(triangles, 2):
        raise InputError(f"a budget is a whole number of triangles, at least 2, not {triangles!r}")
    request = Request.of(options, packed.dimension)
    if isinstance(request.method, Fixed):
        raise InputError("method 'fixed' makes the same triangles whatever the tolerance: there is nothing to find")
    if isinstance(request.method, (EdgeLength, ScreenBox)):
        raise InputError(f"method {request.name!r} knows no tolerance: change its setting")
    prepared = with_normals(request, packed, options.get("normals", "surface"), tangents)
    if not np.any(np.asarray(predicted(request.real, prepared, view).factor)):
        raise InputError("no patch is visible from this camera: there is nothing to spend triangles on")
    edges = shared_edges(on_host(packed.patches())) if edge_numbers is None else edge_numbers
    return prepared, request, check_edge_numbers(edges, len(packed))


def _positions(request: Request) -> Request:
    """Real factors for positions alone: where they meet a budget is near enough to begin with."""
    return request.real._replace(normal_tolerance=None)


def _tolerance_root(patches: Patches, view: View, wanted: int, request: Request) -> float:
    def excess(log: Any, patches: Patches) -> Array:
        return jnp.log(counted(request.at(jnp.exp(log)), with_normals(request, patches), view) / (wanted + 0.5))

    return _root(excess, _COARSEST - 2.0 * _REACH, _COARSEST, on_device(patches))


def _distance_root(patches: Patches, view: View, sphere: Any, wanted: int, request: Request) -> float:
    def excess(log: Any, patches: Patches) -> Array:
        seen = counted(request, with_normals(request, patches), moved(view, sphere, jnp.exp(log)))
        return jnp.log(jnp.maximum(seen, 1e-3) / (wanted + 0.5))

    points = on_device(patches)
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


def _root(excess: Callable[[Any, Any], Any], low: float, high: float, patches: Patches) -> float:
    """Where the excess, which falls, changes its sign; the end that is nearer to that if it does not."""
    with one_at_a_time:
        import optimistix as optx  # slow to import

    solver = optx.Bisection(rtol=0.0, atol=1e-3, flip=True)

    def alike(log: Any, patches: Patches) -> Array:
        return excess(log, patches).astype(log.dtype)  # whatever precision the patches are in

    ends = {"lower": jnp.asarray(low), "upper": jnp.asarray(high)}
    start = jnp.asarray(0.5 * (low + high))
    found = optx.root_find(alike, solver, start, args=patches, options=ends, max_steps=60, throw=False)
    return float(found.value)


def _climb(
    factors: Callable[[float], Factors],
    start: float,
    wanted: int,
    place: Callable[[float], tuple[float, View]],
    coarsest: float | None,
) -> Budget:
    """From a first logarithm to the best one: counts fall as it grows, about as exp(-log).

    coarsest : a logarithm at which normals alone ask for triangles, where they do: there, counts no longer fall
    """
    low = high = above = None
    best: tuple[int, float, Factors] | None = None
    log, counts, is_step = start, 0, False
    if coarsest is not None:
        high, best, counts = coarsest, _least(factors, wanted, coarsest), 1
    while counts < _CLIMB:
        found = factors(log)
        count, counts = _drawn(found), counts + 1
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


def _least(factors: Callable[[float], Factors], wanted: int, coarsest: float) -> tuple[int, float, Factors]:
    """What normals alone ask for. Raises InputError if that is too much."""
    found = factors(coarsest)
    count = _drawn(found)
    if count > wanted:
        said = f"{wanted:,} triangles are too few: for normal_tolerance alone there are {count:,}"
        raise InputError(said, options=("normal_tolerance",))
    return count, coarsest, found


def _drawn(found: Factors) -> int:
    return int(triangle_counts(found.inner, found.edges).sum())


def _next(guess: float, log: float, low: float | None, high: float | None, counts: int) -> float:
    """Where to count next: the guess if it leads on, or the middle of what is left."""
    if low is None or high is None:
        # overshoot a little, so that the other side is met
        return float(np.clip(guess + 1e-3 * counts * np.sign(guess - log), log - 3.0, log + 3.0))
    margin = 0.05 * abs(high - low)
    inside = min(low, high) + margin < guess < max(low, high) - margin
    return float(guess) if inside and counts % 3 else 0.5 * (low + high)
