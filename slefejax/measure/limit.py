"""How far patches are from the limit surface of their control mesh, in space and on the screen."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from slefejax.arguments import on_host
from slefejax.errors import InputError
from slefejax.geometry.evaluate import evaluate_patches
from slefejax.geometry.view import View, check_view, homogeneous
from slefejax.measure.surface import distance

_PLACES = 17  # along each side
_BOUND_PLACES = 33
_AT_A_TIME = 256  # patches
_LOOKED_AT = 16  # patches with the largest distances, and as many with the largest on the screen: looked at closely
_ZOOMS = 3  # times, into the cells around the largest


@dataclass(frozen=True, eq=False)
class LimitDistance:
    """Distances of points of patches from the nearest points of the limit surface.

    largest : scene units;  rms : over places spread evenly over the parameters of all patches
    bound   : a bound of ``largest``, None where none is known
    pixels  : the largest on the screen, max(|dx|, |dy|), of points in the view volume; None without a view
    patches : ``(patches,)``, the largest of each;  bounds : ``(patches,)``, NaN where none is known
    odd     : ``(odd,)``, which patches are not the limit surface itself
    grid    : ``(odd, 17, 17)``, their distances at equal steps of u and v
    """

    largest: float
    rms: float
    bound: float | None
    pixels: float | None
    patches: Float[np.ndarray, "patches"]
    bounds: Float[np.ndarray, "patches"]
    odd: Int[np.ndarray, "odd"]
    grid: Float[np.ndarray, "odd 17 17"]


def limit_distance(scene: Any, view: View | None = None) -> LimitDistance:
    """How far the patches of a control mesh are from its exact Catmull-Clark limit surface.

    scene : from ``load``, of any scheme; tagged sharpness belongs to the limit surface
    view  : to know the distance on the screen too

    Every patch that is not the limit surface itself is sampled, 17 x 17 points, and looked at closely where the
    distance is largest. From each point the nearest limit point is looked for everywhere, in space, so what the patch's
    parameters are does not matter. Sharpness above 10 is followed for 10 steps, then taken for infinite.

    Raises InputError for a scene without a control mesh, control points that are not finite, and a view that is none.

    >>> from slefejax import Mesh, Scene, convert
    >>> corners = [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)]
    >>> faces = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    >>> conversion = convert(Mesh.of(corners, faces), "gregory")
    >>> cube = Scene("cube", conversion.patchwork.on_host(corners), conversion=conversion)
    >>> 0.0 < limit_distance(cube).rms < limit_distance(cube).largest < 0.01
    True
    """
    conversion = getattr(scene, "conversion", None)
    if conversion is None:
        name = getattr(scene, "name", f"{type(scene).__name__}")
        raise InputError(f"{name} has no control mesh: only patches of one have a limit surface to be compared with")
    if view is not None:
        check_view(view)
    patches = on_host(scene.patches())
    if not np.isfinite(np.asarray(scene.points())).all():
        raise InputError(f"{scene.name} has control points that are not finite numbers")
    places = _Places(patches, conversion, view)
    odd = np.flatnonzero(places.odd)
    largest, pixels = np.zeros((2, len(patches)))
    grids = [np.zeros((0, _PLACES, _PLACES))]
    for k in range(0, len(odd), _AT_A_TIME):
        own = odd[k : k + _AT_A_TIME]
        largest[own], pixels[own], grid = places.sampled(own)
        grids.append(grid)
    grid = np.concatenate(grids)
    share = np.array([0.5, *[1.0] * (_PLACES - 2), 0.5]) / (_PLACES - 1)
    bounds = places.bounds()
    known = bool(np.isfinite(bounds).all())
    return LimitDistance(
        float(largest.max()),
        float(np.sqrt(np.einsum("kij,i,j->", grid**2, share, share) / len(patches))),
        float(bounds.max()) if known else None,
        None if view is None else float(pixels.max()),
        largest,
        bounds,
        odd,
        grid,
    )


class _Places:
    """Places on patches, and what is found of them.

    odd : ``(patches,)``, which patches are not the limit surface itself
    """

    odd: Bool[np.ndarray, "patches"]

    def __init__(self, patches: Any, conversion: Any, view: View | None) -> None:
        self._patches, self._conversion, self._limit, self._view = patches, conversion, conversion.limit, view
        self._own_faces = conversion.own_faces
        self.odd = ~self._limit.regular if self._own_faces else np.ones(len(patches), bool)

    def sampled(self, which: Int[np.ndarray, "some"]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Of some patches the largest distance, in space and on the screen, and all of them in space."""
        t = np.linspace(0.0, 1.0, _PLACES)
        grid = np.broadcast_to(np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1), (len(which), _PLACES, _PLACES, 2))
        far = self._distances(which, grid.reshape(len(which), -1, 2))
        largest = [self._zoomed(which, own, k) for k, own in enumerate(far)]
        return largest[0], largest[1], far[0].reshape(-1, _PLACES, _PLACES)

    def bounds(self) -> Float[np.ndarray, "patches"]:
        """Of every patch, NaN where none is known.

        With one irregular corner, the limit surface at the parameters that belong to the patch's is compared with it,
        and the largest change from one place to the next is added. Between places, at most .71 steps away, it is
        enough if nowhere on the patch the difference changes 1.4 times as fast as between any two of the places.
        """
        found = np.where(self.odd, np.nan, 0.0)
        faces = np.flatnonzero(self.odd & self._conversion.one_irregular) if self._own_faces else np.zeros(0, np.int64)
        for k in range(0, len(faces), _AT_A_TIME):
            own = faces[k : k + _AT_A_TIME]
            patch, natural = self._conversion.natural(own, _BOUND_PLACES)
            points = np.asarray(evaluate_patches(self._patches[own], patch.reshape(len(own), -1, 2)))
            exact = self._limit.at(np.repeat(own, _BOUND_PLACES**2), natural.reshape(-1, 2))
            missed = (points.reshape(-1, 3) - exact).reshape(*patch.shape[:-1], 3)
            changes = [np.linalg.norm(np.diff(missed, axis=axis), axis=-1).max(axis=(1, 2)) for axis in (1, 2)]
            found[own] = np.linalg.norm(missed, axis=-1).max(axis=(1, 2)) + np.maximum(*changes)
        return found

    def _zoomed(self, which: np.ndarray, far: np.ndarray, kind: int) -> np.ndarray:
        """The largest of each, looked at closely where it is among the largest of all."""
        found = far.max(axis=1)
        chosen = np.argsort(-found)[:_LOOKED_AT]
        best = far[chosen].argmax(axis=1)
        place = np.stack([best // _PLACES, best % _PLACES], axis=1) / (_PLACES - 1.0)
        reach = 1.0 / (_PLACES - 1)
        t = np.linspace(-1.0, 1.0, 9)
        around = np.stack(np.meshgrid(t, t, indexing="ij"), axis=-1).reshape(1, -1, 2)
        for _ in range(_ZOOMS if found.max() > 0 else 0):
            there = np.clip(place[:, None] + reach * around, 0.0, 1.0)
            closer = self._distances(which[chosen], there)[kind]
            best = closer.argmax(axis=1)
            place = there[np.arange(len(chosen)), best]
            found[chosen] = np.maximum(found[chosen], closer.max(axis=1))
            reach *= 0.25
        return found

    def _distances(self, which: np.ndarray, parameters: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of patches at parameters ``(some, places, 2)``: distances in space, and on the screen, ``(some, places)``."""
        points = np.asarray(evaluate_patches(self._patches[which], parameters)).reshape(-1, 3)
        start = None
        if self._own_faces:
            start = self._limit.places(np.repeat(which, parameters.shape[1]), parameters.reshape(-1, 2))
        found = self._limit.surfaces.nearest(points, start)
        shape = parameters.shape[:2]
        screen = np.zeros(shape) if self._view is None else self._on_screen(points, found.points).reshape(shape)
        return found.distance.reshape(shape), screen

    def _on_screen(self, points: np.ndarray, exact: np.ndarray) -> np.ndarray:
        """Pixels; 0 of points outside of the view volume."""
        assert self._view is not None
        matrix = np.asarray(self._view.world_to_screen).T
        both = [(homogeneous(x) @ matrix).T for x in (exact, points)]
        size = float(self._view.width), float(self._view.height)
        return np.maximum(np.asarray(distance(both[0], both[1], size), np.float64), 0.0)
