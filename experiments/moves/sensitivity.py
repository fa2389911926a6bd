"""Which control points, bones and shape keys cost the most triangles?"""

from __future__ import annotations

import os
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import tyro

from slefejax import Scene, View, tessellation_factors
from slefejax.experiments.moves.outlines import outlines
from slefejax.experiments.options import FigureOptions, LoadOptions, PredictionOptions, ViewOptions, camera_record
from slefejax.experiments.report import Report
from slefejax.experiments.shading import unclaimed
from slefejax.experiments.store import Row, Run
from slefejax.figures.moves.sensitivity import write_sensitivity
from slefejax.geometry.view import bounding_sphere
from slefejax.study.sensitivity import Sensitivity, sensitivity

_MOST = 10  # rows of a kind
_SHARE = 0.01  # of the scene's radius, by which a point is moved
_DEGREE = np.pi / 180.0
_KEY = 0.1


@dataclass(frozen=True)
class SensitivityOfScene:
    """Derivatives of the number of triangles by everything that moves a scene, and a picture of them on its mesh."""

    scene: tyro.conf.Positional[str]
    """A file (.obj, .usd…, .glb, …: the README lists them), or walker, teapot, twisted-quad, steep-patch."""
    prediction: tyro.conf.OmitArgPrefixes[PredictionOptions] = field(default_factory=PredictionOptions)
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Differentiate, list, draw."""
        posed = self.loading.load(self.scene)
        scene = replace(self.loading, time=None, keys=()).load(self.scene)
        view = self.camera.view(posed)
        pose = None
        if scene.rig is not None:
            pose = scene.rig.pose(self.loading.time, self.loading.weights())
        found = sensitivity(scene, view, pose, deform=self.loading.deformation(), **self.prediction.arguments())
        _, radius = bounding_sphere(posed.points())
        rows = _rows(scene, found, radius)
        arguments = {**asdict(self), "output": None, "camera": camera_record(view)}
        with Run("sensitivity", arguments, self.output.out, {"process": os.getpid()}, self.output.pages(self)) as run:
            _draw(run, posed, view, found, rows, radius)
            table = np.column_stack([np.arange(len(found.places)), found.places, found.points])
            header = "point,x,y,z,triangles_per_unit_x,triangles_per_unit_y,triangles_per_unit_z"
            np.savetxt(run.file("points.csv"), table, "%.9g", ",", header=header, comments="")
            notes = (*scene.notes, *self._unclaimed(posed, view))
            out = run.finish(rows, {"scene": scene.name, "notes": notes, "triangles": found.triangles})
        title = f"{scene.name}: {found.triangles:,.0f} triangles without rounding, and what changes them the most"
        extra = {"triangles": found.triangles, "radius": radius}
        return Report(scene.name, out, rows, title, notes, extra, self.output.json)

    def _unclaimed(self, posed: Scene, view: View) -> tuple[str, ...]:
        """What to say of patches whose normals have no claim: they count by positions alone."""
        shading = self.prediction.shading
        if shading.degrees is None:
            return ()
        options = self.prediction.arguments()
        found = tessellation_factors(posed.patches(), view, tangents=shading.of(posed).tangents, **options)
        return unclaimed(found.without_normal)


def _rows(scene: Scene, found: Sensitivity, radius: float) -> list[Row]:
    """The largest of every kind, each for a change that is small and the same for all of its kind."""
    step = _SHARE * radius
    rows = [_row(found, "tolerance", "", "1 % more", 0.01 * found.tolerance)]
    if np.isfinite(found.distance):
        rows.append(_row(found, "camera distance", "", "1 % more", 0.01 * found.distance))
    what = "vertex" if found.numbers is None else "control point"
    rows += _largest(found, what, [str(k) for k in range(len(found.points))], "1 % of the radius", step * found.points)
    skeleton = None if scene.rig is None else scene.rig.skeleton
    if skeleton is not None and found.turns is not None and found.shifts is not None:
        names = list(skeleton.names)
        rows += _largest(found, "bone", names, "turned by 1 degree", _DEGREE * found.turns)
        rows += _largest(found, "bone", names, "moved by 1 % of the radius", step * found.shifts)
    if found.keys is not None and scene.rig is not None and scene.rig.keys is not None:
        own = np.column_stack([_KEY * found.keys, np.zeros((len(found.keys), 2))])
        rows += _largest(found, "shape key", list(scene.rig.keys.names), f"weight {_KEY:g} more", own)
    return rows


def _largest(found: Sensitivity, kind: str, names: list[str], change: str, slopes: np.ndarray) -> list[Row]:
    """The steepest first: the most triangles that a change of that size can cost, whatever its direction."""
    length = np.linalg.norm(slopes, axis=1)
    signed = kind == "shape key"
    return [
        _row(found, kind, names[k], change, float(slopes[k, 0] if signed else length[k]))
        for k in np.argsort(-length)[:_MOST]
    ]


def _row(found: Sensitivity, kind: str, name: str, change: str, triangles: float) -> Row:
    share = triangles / found.triangles if found.triangles else float("nan")
    return {"kind": kind, "name": name, "change": change, "triangles_more": triangles, "share_more": share}


def _draw(run: Run, scene: Scene, view: View, found: Sensitivity, rows: list[Row], radius: float) -> None:
    seen = outlines(scene, view)
    slopes = _SHARE * radius * found.points
    size = np.linalg.norm(slopes, axis=1)
    whose = np.arange(len(size)) if found.numbers is None else found.numbers.ravel()
    values = np.array([size[whose[corners]].mean() for corners in seen.corners])
    what = "vertex of the control mesh" if found.numbers is None else "control point"
    write_sensitivity(run.figure("sensitivity"), seen.polygons, values, rows, scene.name, what)
