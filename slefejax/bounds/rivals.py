"""Enclosures that others use, each in its sharpest published form, and the best that exists, to compare slefes with.

All enclose a function p over [0, 1] in Bézier form, or over [0, 1]^2, cut into the same number of pieces; a bound
that is not piecewise linear by nature is applied to the control points of every piece, which are exact (blossoming).
The graph (t, p(t)) has control points (j/d, c_j), so bounds of plane curves apply to functions too.

The *width* of an enclosure is its largest vertical extent, in the units of p. Plain NumPy, float64, one function at a
time where a library does the geometry, so these are references and not fast paths.

min-max          the smallest and the largest coefficient of a piece (convex hull property)
oriented-box     the smallest rectangle (box) of any direction around the control points of the graph
convex-hull      of the control points of the graph
disc             the smallest disc around the control points of the graph (curves only)
filip            chord, or the two triangles of a tile, and the second-derivative bound of [FMM86]:
                 h^2/8 max|p''|, or h^2/8 (max|p_uu| + 2 max|p_uv| + max|p_vv|), by the coefficients of a piece
control-polygon  the distance from the control polygon of [NPL99]:
                 floor(d/2) ceil(d/2) / (2d) max|second difference|; a part of the curve has d legs
slefe            ``slefejax.bounds.slefe``
optimum          no continuous piecewise-linear enclosure with these breakpoints is narrower (linear programming)
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from itertools import combinations, pairwise
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float
from scipy.spatial import ConvexHull, QhullError
from trimesh.bounds import oriented_bounds, oriented_bounds_2D

from slefejax.arguments import check_choice, check_segments, floating
from slefejax.bounds.optimum import optimal_curve, optimal_patch
from slefejax.bounds.slefe import enclose, slefe, slefe_boxes
from slefejax.errors import InputError
from slefejax.geometry.bezier import restrict, second_differences
from slefejax.late import one_at_a_time

Points = Float[np.ndarray, "points 2"]


@dataclass(frozen=True)
class Enclosure:
    """One enclosure of a function.

    width   : largest vertical extent, in the units of the function
    area    : of the enclosing regions, each piece by itself (curves; NaN for patches)
    regions : outlines in the plane of the graph, ``(points, 2)`` each (curves)
    """

    width: float
    area: float = float("nan")
    regions: list[Points] = field(default_factory=list)


def enclose_curve(method: str, coefficients: Any, pieces: int) -> Enclosure:
    """An enclosure of p(t) = sum_j c_j b_j(t) by one of ``CURVE_METHODS``.

    coefficients : ``(d+1,)``, d >= 1;  pieces : equal pieces of [0, 1]

    Raises InputError for an unknown method, bad coefficients, or, for the control polygon, a number of pieces that is
    no multiple of the degree (it has as many legs as its degree).

    >>> round(enclose_curve("filip", [0.0, -2 / 3, -1 / 3, 0.0], 1).width, 3)
    1.5
    """
    coefficients = _function(coefficients, 1)
    check_segments(pieces)
    return _pick(method, CURVE_METHODS, "curves")(coefficients, pieces)


def enclose_surface(method: str, coefficients: Any, pieces: int) -> Enclosure:
    """An enclosure of p(u, v), coefficients ``(du+1, dv+1)``, on pieces x pieces tiles, by one of ``SURFACE_METHODS``.

    Raises InputError as ``enclose_curve`` does.

    >>> enclose_surface("min-max", [[0.0, 1.0], [2.0, 3.0]], 1).width
    3.0
    """
    coefficients = _function(coefficients, 2)
    check_segments(pieces)
    return _pick(method, SURFACE_METHODS, "surfaces")(coefficients, pieces)


def _function(coefficients: Any, axes: int) -> np.ndarray:
    values = np.asarray(floating(coefficients), np.float64)
    if values.ndim != axes or min(values.shape) < 2 or not np.isfinite(values).all():
        raise InputError(f"a function needs finite coefficients along {axes} axes, at least two along each")
    return values


def _pick(method: str, methods: dict[str, Callable[..., Enclosure]], what: str) -> Callable[..., Enclosure]:
    check_choice(f"bound of {what}", method, methods)
    return methods[method]


def _curve_pieces(c: np.ndarray, pieces: int) -> list[tuple[float, float, np.ndarray]]:
    """(start, end, coefficients) of every piece."""
    cuts = np.linspace(0.0, 1.0, pieces + 1)
    return [(a, b, np.asarray(restrict(c, a, b))) for a, b in pairwise(cuts)]


def _graph(start: float, end: float, c: np.ndarray) -> Points:
    return np.column_stack([np.linspace(start, end, len(c)), c])


def _from_regions(regions: list[Points]) -> Enclosure:
    return Enclosure(max(map(_vertical_extent, regions)), sum(map(_area, regions)), regions)


def _vertical_extent(outline: Points) -> float:
    """Of a convex region: a concave function of t, piecewise linear with its bends at the vertices."""
    closed = np.vstack([outline, outline[:1]])
    extents = []
    for t in outline[:, 0]:
        heights = []
        for (t0, y0), (t1, y1) in pairwise(closed):
            if min(t0, t1) <= t <= max(t0, t1):
                heights += [y0, y1] if t0 == t1 else [y0 + (t - t0) / (t1 - t0) * (y1 - y0)]
        extents.append(max(heights) - min(heights))
    return max(extents)


def _area(outline: Points) -> float:
    x, y = (outline - outline[0]).T
    return 0.5 * abs(float(x @ np.roll(y, -1) - y @ np.roll(x, -1)))


def _band(t: np.ndarray, lower: np.ndarray, upper: np.ndarray) -> Enclosure:
    """Of a piecewise-linear enclosure: one quadrangle a piece."""
    regions = [
        np.array([(t[i], lower[i]), (t[i + 1], lower[i + 1]), (t[i + 1], upper[i + 1]), (t[i], upper[i])])
        for i in range(len(t) - 1)
    ]
    return Enclosure(float(np.max(upper - lower)), sum(map(_area, regions)), regions)


def _min_max(c: np.ndarray, pieces: int) -> Enclosure:
    return _from_regions(
        [np.array([(a, p.min()), (b, p.min()), (b, p.max()), (a, p.max())]) for a, b, p in _curve_pieces(c, pieces)]
    )


def _oriented_box(c: np.ndarray, pieces: int) -> Enclosure:
    return _from_regions([_rectangle(_graph(*piece)) for piece in _curve_pieces(c, pieces)])


def _rectangle(points: Points) -> Points:
    hull = _hull(points)
    if len(hull) == 2:
        return hull
    to_origin, extents = oriented_bounds_2D(hull)
    corners = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)]) * (extents / 2.0)
    return (np.column_stack([corners, np.ones(4)]) @ np.linalg.inv(to_origin).T)[:, :2]


def _hull(points: Points) -> Points:
    """The hull's outline; of points on a line its two ends."""
    try:
        return points[ConvexHull(points).vertices]
    except QhullError:
        return points[[0, -1]]


def _convex_hull(c: np.ndarray, pieces: int) -> Enclosure:
    return _from_regions([_hull(_graph(*piece)) for piece in _curve_pieces(c, pieces)])


def _disc(c: np.ndarray, pieces: int) -> Enclosure:
    discs = [_smallest_disc(_graph(*piece)) for piece in _curve_pieces(c, pieces)]
    angle = np.linspace(0.0, 2.0 * np.pi, 181)[:-1]
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    return Enclosure(
        max(2.0 * radius for _, radius in discs),
        sum(np.pi * radius**2 for _, radius in discs),
        [centre + radius * circle for centre, radius in discs],
    )


def _smallest_disc(points: Points) -> tuple[np.ndarray, float]:
    """Two or three of the hull's points lie on its rim: the smallest such circle that holds all."""
    hull = _hull(points)
    circles = [_circle(np.array(rim)) for count in (2, 3) for rim in combinations(hull, count)]
    roundoff = 1e-12 * float(np.ptp(hull, axis=0).max())
    holding = [c for c in circles if np.all(np.linalg.norm(hull - c[0], axis=1) <= c[1] + roundoff)]
    return min(holding, key=lambda circle: circle[1])


def _circle(rim: Points) -> tuple[np.ndarray, float]:
    """The smallest circle through two or three points: its centre is an affine combination of them."""
    edges = rim[1:] - rim[0]
    centre = rim[0] + np.linalg.lstsq(edges, 0.5 * np.sum(edges**2, axis=1), rcond=None)[0]
    return centre, float(np.linalg.norm(rim - centre, axis=1).max())


def _filip(c: np.ndarray, pieces: int) -> Enclosure:
    t = np.linspace(0.0, 1.0, pieces + 1)
    parts = [p for _, _, p in _curve_pieces(c, pieces)]
    reach = [_largest_second(p, 0) / 8.0 for p in parts]
    regions = [
        np.array([(t[i], p[0] - r), (t[i + 1], p[-1] - r), (t[i + 1], p[-1] + r), (t[i], p[0] + r)])
        for i, (p, r) in enumerate(zip(parts, reach, strict=True))
    ]
    return Enclosure(2.0 * max(reach), sum(map(_area, regions)), regions)


def _largest_second(c: np.ndarray, axis: int) -> float:
    """Bound of |p''| along an axis: d (d-1) times the largest second difference."""
    d = c.shape[axis] - 1
    return d * (d - 1) * float(np.max(np.abs(np.diff(c, 2, axis=axis)), initial=0.0))


def polygon_distance(degree: int) -> float:
    """Largest distance of p from its control polygon for second differences up to 1 [NPL99]."""
    return (degree // 2) * ((degree + 1) // 2) / (2.0 * degree)


def _parts_for_legs(degrees: tuple[int, ...], pieces: int) -> int:
    if any(pieces % d for d in degrees) or len(set(degrees)) > 1:
        raise InputError(
            f"a control polygon of degree {degrees[0]} has {degrees[0]} legs: {pieces} pieces are no multiple of that"
        )
    return pieces // degrees[0]


def _control_polygon(c: np.ndarray, pieces: int) -> Enclosure:
    d = len(c) - 1
    parts = _curve_pieces(c, _parts_for_legs((d,), pieces))
    reach = [polygon_distance(d) * float(np.max(np.abs(np.diff(p, 2)), initial=0.0)) for _, _, p in parts]
    regions = []
    for part, r in zip(parts, reach, strict=True):
        legs = _graph(*part)
        for a, b in pairwise(legs):
            regions.append(np.array([(a[0], a[1] - r), (b[0], b[1] - r), (b[0], b[1] + r), (a[0], a[1] + r)]))
    return Enclosure(2.0 * max(reach), sum(map(_area, regions)), regions)


def _slefe(c: np.ndarray, pieces: int) -> Enclosure:
    bounds = slefe(c, pieces)
    return _band(np.linspace(0, 1, pieces + 1), np.asarray(bounds.lower), np.asarray(bounds.upper))


def _optimum(c: np.ndarray, pieces: int) -> Enclosure:
    return _band(np.linspace(0, 1, pieces + 1), *optimal_curve(c, pieces))


def batch_widths(method: str, curves: Any, pieces: int) -> Any:
    """Widths of many curves at once, ``(d+1, curves)`` to ``(curves,)``, by one of ``BATCH_METHODS``.

    Formulas, all compiled alike. The same numbers as those of ``enclose_curve``; for measuring what each formula costs.
    """
    check_segments(pieces)
    return _pick(method, BATCH_METHODS, "batches of curves")(jnp.asarray(floating(curves)), pieces)


def _all_pieces(curves: Any, pieces: int) -> Any:
    """Coefficients ``(d+1, pieces, curves)`` of every piece."""
    cuts = jnp.asarray(np.linspace(0.0, 1.0, pieces + 1), curves.dtype)[:, None]
    return restrict(curves[:, None], cuts[:-1], cuts[1:])


@jax.jit(static_argnums=1)
def _min_max_widths(curves: Any, pieces: int) -> Any:
    parts = _all_pieces(curves, pieces)
    return jnp.max(jnp.max(parts, axis=0) - jnp.min(parts, axis=0), axis=0)


def _largest_bends(curves: Any, pieces: int) -> Any:
    return jnp.max(jnp.abs(second_differences(_all_pieces(curves, pieces))), axis=(0, 1))


@jax.jit(static_argnums=1)
def _filip_widths(curves: Any, pieces: int) -> Any:
    d = curves.shape[0] - 1
    return 2.0 * d * (d - 1) / 8.0 * _largest_bends(curves, pieces)


@jax.jit(static_argnums=1)
def _control_polygon_widths(curves: Any, pieces: int) -> Any:
    d = curves.shape[0] - 1
    return 2.0 * polygon_distance(d) * _largest_bends(curves, _parts_for_legs((d,), pieces))


@jax.jit(static_argnums=1)
def _slefe_widths(curves: Any, pieces: int) -> Any:
    lower, upper = enclose(curves, pieces)
    return jnp.max(upper - lower, axis=0)


BATCH_METHODS: dict[str, Callable[..., Any]] = {
    "min-max": _min_max_widths,
    "filip": _filip_widths,
    "control-polygon": _control_polygon_widths,
    "slefe": _slefe_widths,
}

CURVE_METHODS: dict[str, Callable[..., Enclosure]] = {
    "min-max": _min_max,
    "oriented-box": _oriented_box,
    "convex-hull": _convex_hull,
    "disc": _disc,
    "filip": _filip,
    "control-polygon": _control_polygon,
    "slefe": _slefe,
    "optimum": _optimum,
}


def _tiles(c: np.ndarray, pieces: int) -> list[np.ndarray]:
    rows = [p for _, _, p in _curve_pieces(c, pieces)]
    return [p.T for row in rows for _, _, p in _curve_pieces(row.T, pieces)]


def _surface_graph(c: np.ndarray, pieces: int) -> np.ndarray:
    """Control points (u, v, c) of a tile's graph, up to its place in the plane."""
    u, v = np.meshgrid(*(np.linspace(0.0, 1.0 / pieces, n) for n in c.shape), indexing="ij")
    return np.stack([u, v, c], axis=-1).reshape(-1, 3)


def _surface_min_max(c: np.ndarray, pieces: int) -> Enclosure:
    return Enclosure(max(float(np.ptp(tile)) for tile in _tiles(c, pieces)))


def _surface_oriented_box(c: np.ndarray, pieces: int) -> Enclosure:
    return Enclosure(max(_box_extent(_surface_graph(tile, pieces)) for tile in _tiles(c, pieces)))


def _box_extent(points: np.ndarray) -> float:
    """Longest vertical line inside the smallest box around the points."""
    centred = points - points.mean(axis=0)
    if np.linalg.matrix_rank(centred, tol=1e-12 * float(np.abs(centred).max())) < 3:
        return 0.0  # a plane, which is not upright: the box is flat
    to_origin, extents = oriented_bounds(points)
    upwards = np.abs(to_origin[:3, 2])
    return float(np.min(np.divide(extents, upwards, out=np.full(3, np.inf), where=upwards > 0)))


def _surface_convex_hull(c: np.ndarray, pieces: int) -> Enclosure:
    return Enclosure(max(_hull_extent(_surface_graph(tile, pieces)) for tile in _tiles(c, pieces)))


def _hull_extent(points: np.ndarray) -> float:
    """Longest vertical line inside the hull: two convex combinations over one place, as far apart as can be."""
    n, ones = len(points), np.ones(len(points))
    above = np.concatenate([-points[:, 2], points[:, 2]])
    same_place = np.hstack([points[:, :2].T, -points[:, :2].T])
    sums = np.kron(np.eye(2), ones)
    with one_at_a_time:
        from scipy.optimize import linprog  # slow to import

    found = linprog(above, A_eq=np.vstack([same_place, sums]), b_eq=[0, 0, 1, 1], bounds=[(0, None)] * (2 * n))
    return -float(found.fun)


def _surface_filip(c: np.ndarray, pieces: int) -> Enclosure:
    du, dv = (n - 1 for n in c.shape)

    def reach(tile: np.ndarray) -> float:
        mixed = du * dv * float(np.max(np.abs(np.diff(np.diff(tile, axis=0), axis=1))))
        return (_largest_second(tile, 0) + 2.0 * mixed + _largest_second(tile, 1)) / 8.0

    return Enclosure(2.0 * max(map(reach, _tiles(c, pieces))))


def _surface_control_net(c: np.ndarray, pieces: int) -> Enclosure:
    du, dv = (n - 1 for n in c.shape)

    def reach(part: np.ndarray) -> float:
        seconds = [float(np.max(np.abs(np.diff(part, 2, axis=axis)), initial=0.0)) for axis in (0, 1)]
        return polygon_distance(du) * seconds[0] + polygon_distance(dv) * seconds[1]

    return Enclosure(2.0 * max(map(reach, _tiles(c, _parts_for_legs((du, dv), pieces)))))


def _surface_slefe(c: np.ndarray, pieces: int) -> Enclosure:
    boxes = slefe_boxes(c[None, :, :, None], pieces)
    return Enclosure(float(np.max(np.asarray(boxes.upper) - np.asarray(boxes.lower))))


def _surface_optimum(c: np.ndarray, pieces: int) -> Enclosure:
    lower, upper = optimal_patch(c, pieces)
    return Enclosure(float(np.max(upper - lower)))


SURFACE_METHODS: dict[str, Callable[..., Enclosure]] = {
    "min-max": _surface_min_max,
    "oriented-box": _surface_oriented_box,
    "convex-hull": _surface_convex_hull,
    "filip": _surface_filip,
    "control-polygon": _surface_control_net,
    "slefe": _surface_slefe,
    "optimum": _surface_optimum,
}
