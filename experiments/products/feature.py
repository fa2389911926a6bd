"""One feature in three ways: by covariances, by semi-sharp creases, by edge loops, equally near to a target.

The target is a cube of side 2 whose edges and corners are rounded with some radius. Every way has one number: how thin
Gaussians are, how sharp creases, how near loops to the edges. The nearest that each way comes gives the distance that
all of them keep; of the numbers that keep it the one with the fewest certified triangles is taken.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from slefejax import (
    Camera,
    Conversion,
    Mesh,
    Scene,
    View,
    convert,
    evaluate_patches,
    tessellation_factors,
    triangle_counts,
)
from slefejax.experiments.store import Row

RADII = (0.05, 0.1, 0.2)
VIEW = View(Camera.look_at((3.2, -4.2, 2.8), (0.0, 0.0, 0.0), fov_y=35.0), 1440, 900)
_CELLS = 4  # along the cube's side
_PLACES = 9  # along a patch' side, where distances are looked at
_TRIED = 21  # numbers of each way
_SHARPEST = 4.0


def box(cuts: Any) -> Mesh:
    """The surface of a lattice of cells, the same cuts along every axis.

    >>> box([-1.0, 0.0, 1.0]).face_count
    24
    """
    cuts = np.asarray(cuts, float)
    n = len(cuts) - 1
    points: dict[Any, int] = {}
    faces = []
    for axis in range(3):
        for end in (0, n):
            for i, j in np.ndindex(n, n):
                ring = [(i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)]
                places = [tuple(np.insert(p, axis, end).tolist()) for p in ring]
                outside = (end > 0) ^ (axis == 1)
                faces.append([points.setdefault(p, len(points)) for p in (places if outside else places[::-1])])
    return Mesh.of(cuts[np.array(list(points))], faces)


class _Way(NamedTuple):
    """A family of surfaces with one number."""

    numbers: Any
    make: Callable[[float], Conversion]


def by_covariances(thin: float) -> Conversion:
    """Variance ``thin`` across faces, at edges across both, at corners in all directions; 1 along them."""
    mesh = box(np.linspace(-1.0, 1.0, _CELLS + 1))
    spread = np.where(np.abs(mesh.vertices) == 1.0, thin, 1.0)
    return convert(replace(mesh, covariances=spread[:, :, None] * np.eye(3)), "gaussian")


def by_creases(sharpness: float) -> Conversion:
    """The cube's edges and corners are sharp for so many steps, which are taken before there are patches."""
    mesh = box(np.linspace(-1.0, 1.0, _CELLS + 1))
    fixed = np.abs(mesh.vertices) == 1.0
    on = np.sum(fixed[mesh.edge_vertices].all(axis=1), axis=1) == 2
    creases, corners = mesh.edge_vertices[on], np.flatnonzero(fixed.all(axis=1))
    sharp = {"creases": creases, "crease_sharpness": np.full(len(creases), sharpness)}
    sharp |= {"points": corners, "point_sharpness": np.full(len(corners), sharpness)}
    steps = max(1, int(np.ceil(sharpness)))
    return convert(Mesh.packed(mesh.vertices, mesh.corners, mesh.sizes, **sharp), "catmull-clark+acc", steps=steps)


def by_loops(inset: float) -> Conversion:
    """One more loop of edges on both sides of every edge of the cube, so far from it."""
    cuts = np.linspace(-1.0, 1.0, _CELLS + 1)
    return convert(box(np.sort([*cuts, inset - 1.0, 1.0 - inset])), "acc")


_WAYS = {
    "covariances": _Way(np.geomspace(1e-5, 1.0, _TRIED), by_covariances),
    "creases": _Way(np.linspace(0.0, _SHARPEST, _TRIED), by_creases),
    "edge loops": _Way(np.geomspace(0.004, 0.45, _TRIED), by_loops),
}


def compared(view: View = VIEW, tolerance: float = 0.5) -> list[Row]:
    """A row a radius and a way: its number, its distance, the nearest of all its numbers, and what it takes to draw."""
    made = {name: [_Made.of(way, float(x)) for x in way.numbers] for name, way in _WAYS.items()}
    rows = []
    for radius in RADII:
        far = {name: np.array([own.distance(radius) for own in some]) for name, some in made.items()}
        allowed = max(own.min() for own in far.values())
        for name, some in made.items():
            kept = [own for own, x in zip(some, far[name], strict=True) if x <= allowed * (1.0 + 1e-9)]
            best = min(kept, key=lambda own: own.triangles(view, tolerance))
            rows.append(
                {
                    "radius": radius,
                    "way": name,
                    "number": best.number,
                    "distance": best.distance(radius),
                    "nearest": float(far[name].min()),
                    "patches": len(best.scene.patches()),
                    "kilobytes": 4 * best.scene.patches().size / 1024,
                    "triangles": best.triangles(view, tolerance),
                }
            )
    return rows


class _Made:
    """A surface of one of the ways."""

    def __init__(self, number: float, scene: Scene, points: np.ndarray) -> None:
        self.number, self.scene, self._points = number, scene, points
        self._triangles: int | None = None

    @staticmethod
    def of(way: _Way, number: float) -> _Made:
        """With points all over its patches."""
        conversion = way.make(number)
        scene = Scene("cube", conversion.patchwork.on_host(conversion.control), conversion=conversion)
        t = np.linspace(0.0, 1.0, _PLACES)
        grid = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(-1, 2)
        return _Made(number, scene, np.asarray(evaluate_patches(scene.patches(), grid)).reshape(-1, 3))

    def distance(self, radius: float) -> float:
        """The largest from the rounded cube."""
        out = np.abs(self._points) - (1.0 - radius)
        outside = np.linalg.norm(np.maximum(out, 0.0), axis=1)
        return float(np.abs(outside + np.minimum(out.max(axis=1), 0.0) - radius).max())

    def triangles(self, view: View, tolerance: float) -> int:
        """At certified levels."""
        if self._triangles is None:
            scene = self.scene
            found = tessellation_factors(scene.patches(), view, tolerance=tolerance, edge_numbers=scene.edge_numbers)
            self._triangles = int(triangle_counts(found.inner, found.edges).sum())
        return self._triangles
