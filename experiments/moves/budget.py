"""What tolerance, or what distance of the camera, meets a number of triangles?"""

from __future__ import annotations

import os
import time
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import jax
import numpy as np
import tyro

from slefejax import Scene, View, distance_for_budget, sampled_error, tolerance_for_budget
from slefejax.arguments import on_device
from slefejax.errors import InputError
from slefejax.experiments.options import FigureOptions, LoadOptions, PredictionOptions, ViewOptions, camera_record
from slefejax.experiments.report import Report, progress
from slefejax.experiments.shading import numbers_without, unclaimed_numbers
from slefejax.experiments.store import Row, Run
from slefejax.experiments.studies.study import shown
from slefejax.figures.moves.budget import write_budget
from slefejax.geometry.view import bounding_sphere
from slefejax.predict.methods import Options, name_of
from slefejax.study.budget import Budget, counted, moved, with_normals
from slefejax.tessellator.levels import HIGHEST_LEVEL

_CURVE = np.exp(np.linspace(-2.5, 2.5, 41))  # around what was found


@dataclass(frozen=True)
class BudgetOfScene:
    """The finest tolerance, or the nearest place of the camera, that some numbers of triangles are enough for."""

    scene: tyro.conf.Positional[str]
    """A file (.obj, .usd…, .glb, …: the README lists them), or walker, teapot, twisted-quad, steep-patch."""
    triangles: tuple[int, ...]
    """Numbers of triangles, as drawn."""
    by: Literal["tolerance", "distance"] = "tolerance"
    """What is changed: the tolerance, or the camera's distance from its target at --tolerance."""
    prediction: tyro.conf.OmitArgPrefixes[PredictionOptions] = field(default_factory=PredictionOptions)
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Search, measure, draw."""
        if not self.triangles or len(set(self.triangles)) < len(self.triangles):
            raise InputError("--triangles needs at least one number, and none twice")
        if self.by == "tolerance" and self.prediction.tolerance != PredictionOptions.tolerance:
            raise InputError("--tolerance is what is looked for: leave it out, or search --by distance")
        scene = self.loading.load(self.scene)
        view = self.camera.view(scene)
        arguments = {**asdict(self), "output": None, "camera": camera_record(view)}
        with Run("budget", arguments, self.output.out, {"process": os.getpid()}, self.output.pages(self)) as run:
            with progress("searching", len(self.triangles)) as show:
                found = []
                for wanted in self.triangles:
                    found.append(self._row(scene, view, wanted))
                    show(len(found))
            rows = shown(found)
            write_budget(run.figure("budget"), rows, self._curve(scene, view, rows), self.by, scene.name)
            without = sorted({patch for row in found for patch in row["_without_normal"]})
            notes = (*scene.notes, *_beyond(rows), *unclaimed_numbers(without))
            out = run.finish(rows, {"scene": scene.name, "notes": notes})
        what = "tolerance" if self.by == "tolerance" else "distance of the camera"
        title = f"{scene.name}: the {what} that meets a number of triangles, method {name_of(self.prediction.value())}"
        return Report(scene.name, out, rows, title, notes, as_json=self.output.json)

    def _options(self) -> Options:
        options = self.prediction.arguments()
        if self.by == "tolerance":
            del options["tolerance"]
        return options

    def _row(self, scene: Scene, view: View, wanted: int) -> Row:
        search = tolerance_for_budget if self.by == "tolerance" else distance_for_budget
        start = time.perf_counter()
        tangents = self.prediction.shading.of(scene).tangents
        found = search(
            scene.patches(), view, wanted, tangents=tangents, edge_numbers=scene.edge_numbers, **self._options()
        )
        seconds = time.perf_counter() - start
        error = sampled_error(scene.patches(), found.factors.inner, found.view)
        return {
            "budget": wanted,
            "triangles": found.triangles,
            "share_of_budget": found.triangles / wanted,
            "next_triangles": -1 if found.above is None else found.above,
            "met": _met(found, wanted),
            "tolerance_px": found.tolerance,
            "distance": found.distance,
            "visible_patches": int(np.count_nonzero(found.factors.levels)),
            "highest_level": int(found.factors.inner.max()),
            "sup_error_px": float(error.max()),
            "counts": found.counts,
            "seconds": seconds,
            "_without_normal": numbers_without(found.factors.without_normal),
        }

    def _curve(self, scene: Scene, view: View, rows: list[Row]) -> tuple[np.ndarray, np.ndarray]:
        """Triangles without rounding, against tolerance or distance, around what was found."""
        request = self.prediction.request(scene).real
        patches, sphere = on_device(scene.patches()), bounding_sphere(scene.points())
        shaded = self.prediction.shading.of(scene)
        name = "tolerance_px" if self.by == "tolerance" else "distance"
        middle = float(np.exp(np.mean(np.log([row[name] for row in rows]))))
        spread = max(1.0, float(np.ptp(np.log([row[name] for row in rows]))))
        places = middle * _CURVE**spread
        own = float(np.linalg.norm(np.asarray(view.camera.target) - np.asarray(view.camera.eye)))

        @jax.jit
        def count(patches: Any, place: Any) -> Any:
            prepared = with_normals(request, patches, *shaded.kind)
            if self.by == "tolerance":
                return counted(request.at(place), prepared, view)
            return counted(request, prepared, moved(view, sphere, place / own))

        return places, np.array([float(count(patches, place)) for place in places])


def _met(found: Budget, wanted: int) -> str:
    """In words, how near the count is."""
    if found.triangles >= 0.99 * wanted:
        return "within 1 %"
    return "to one step" if found.is_step else "the scene needs no more"


def _beyond(rows: list[Row]) -> tuple[str, ...]:
    """What to say of levels that OpenGL's tessellator does not have."""
    highest = max(row["highest_level"] for row in rows)
    if highest <= HIGHEST_LEVEL:
        return ()
    return (f"the highest level is {highest}: past {HIGHEST_LEVEL} patches are drawn in pieces",)
