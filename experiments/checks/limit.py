"""How far patches are from the Catmull-Clark limit surface, and by how much their normals jump, scheme by scheme."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field, replace
from typing import Any, NamedTuple

import numpy as np
import tyro

from slefejax import Scene, View, limit_distance, tessellation_factors, triangle_counts
from slefejax.errors import InputError
from slefejax.experiments.checks.mirror import reflections
from slefejax.experiments.checks.splats import splatted
from slefejax.experiments.options import FigureOptions, LoadOptions, Scenes, ViewOptions, camera_record, notes_of
from slefejax.experiments.report import Report, progress
from slefejax.experiments.shading import Shaded, ShadingOptions, numbers_without
from slefejax.experiments.store import Row, Run, digest
from slefejax.figures.checks.limit import Pictures, write_limit_figure, write_reflection_figure
from slefejax.figures.fitting import short
from slefejax.measure.jumps import normal_jumps
from slefejax.predict.methods import Certified

_DEPTHS = (1, 2, 3)
_MOST_PATCHES = 200_000
_SHOWN = 2  # schemes in the figure


class _Case(NamedTuple):
    """A scene, by its number, and how patches are made of it."""

    scene: int
    scheme: str
    depth: int

    def name(self) -> str:
        return f"{self.scene} {self.scheme} {self.depth}"


@dataclass(frozen=True)
class Limit:
    """How far patches are from the exact limit surface of their control mesh, and by how much their normals jump.

    Without --scheme: acc (pinched where there are triangles), gregory, and both after 1, 2 and 3 steps of subdivision.
    """

    scenes: Scenes
    """Files with control meshes (.obj, .usd…, .glb, …), or walker."""
    tolerance: float = 0.5
    """Error in pixels for the triangles that are counted."""
    shading: tyro.conf.OmitArgPrefixes[ShadingOptions] = field(default_factory=ShadingOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Measure, tabulate, draw."""
        if not self.scenes:
            raise InputError("name at least one scene with a control mesh: a file or walker")
        self.shading.check()
        scenes = [self.loading.load(name) for name in self.scenes]
        for scene in scenes:
            _check(scene)
        views = [self.camera.view(scene) for scene in scenes]
        cases, left_out = self._cases(scenes)
        arguments = {**asdict(self), "output": None, "camera": [camera_record(view) for view in views]}
        inputs = {"scenes": [digest(scene.points().tobytes()) for scene in scenes]}
        names = [scene.name for scene in scenes]
        by_name = {case.name(): case for case in cases}
        with Run("limit", arguments, self.output.out, inputs, self.output.pages(self)) as run:
            with progress("measuring", len(cases)) as show:
                rows = run.each("case", list(by_name), lambda name: self._row(by_name[name], names, views), show)
            rows = [{name: value for name, value in row.items() if name != "case"} for row in rows]
            self._draw(run, [case for case in cases if case.scene == 0], views[0])
            notes = notes_of(scenes) + left_out + _unbounded(rows)
            out = run.finish(rows, {"scene": names, "notes": notes})
        title = "distance from the limit surface in per cent of the box diagonal, and jumps of normals in degrees"
        return Report(names, out, rows, title, notes, as_json=self.output.json)

    def _cases(self, scenes: list[Scene]) -> tuple[list[_Case], tuple[str, ...]]:
        """What is measured, and sentences on what would be too much."""
        cases, notes = [], []
        for number, scene in enumerate(scenes):
            assert scene.conversion is not None
            if self.loading.scheme != "auto":
                depth = (self.loading.steps or 1) if self.loading.scheme.startswith("catmull-clark") else 0
                cases.append(_Case(number, self.loading.scheme, depth))
                continue
            cases += [_Case(number, scheme, 0) for scheme in _without_steps(scene)]
            for depth in _DEPTHS:
                made = len(scene.conversion.mesh.corners) * 4 ** (depth - 1)
                if made > _MOST_PATCHES:
                    notes.append(f"{scene.name}: depth {depth} is left out, {made:,} patches")
                    continue
                cases += [_Case(number, f"catmull-clark+{own}", depth) for own in ("acc", "gregory")]
        if self.shading.normals == "tangents" and self.loading.scheme == "auto":
            cases = [case for case in cases if not case.scheme.endswith("gregory")]
            notes.append("left out, as they have no tangent patches: gregory, catmull-clark+gregory")
        return cases, tuple(notes)

    def _scene(self, case: _Case) -> Scene:
        own = replace(self.loading, scheme=case.scheme, steps=case.depth or None)
        return own.load(self.scenes[case.scene])

    def _row(self, case: _Case, names: list[str], views: list[View]) -> Row:
        start = time.perf_counter()
        scene, view = self._scene(case), views[case.scene]
        return {
            "scene": names[case.scene],
            "scheme": case.scheme,
            "depth": case.depth,
            "patches": len(scene.patches()),
            **triangles(scene, view, self.tolerance, self.shading.of(scene)),
            **distance_row(scene, view),
            "normal_jump_deg": largest_jump(scene),
            "seconds": time.perf_counter() - start,
        }

    def _draw(self, run: Run, cases: list[_Case], view: View) -> None:
        """Of the first scene: where the distances are, and what smoothness looks like."""
        chosen = cases[:_SHOWN]
        scenes = [self._scene(case) for case in chosen]
        titles = [case.scheme + _after(case.depth) for case in chosen]
        found = [limit_distance(scene, view) for scene in scenes]
        diagonal = _diagonal(scenes[0])
        pictures = [_distances(scene, own, view, 100.0 / diagonal) for scene, own in zip(scenes, found, strict=True)]
        said = [
            f"{title}\nlargest {100.0 * own.largest / diagonal:.3f} %, {own.pixels:.2f} px, hidden parts too"
            for title, own in zip(titles, found, strict=True)
        ]
        write_limit_figure(run.figure("limit"), Pictures(pictures, said, scenes[0].name))
        stripes = [*reflections(scenes)]
        if stripes:
            jumps = [largest_jump(scene) for scene in scenes]
            said = [f"{title}\nnormals jump by up to {short(jump)}°" for title, jump in zip(titles, jumps, strict=True)]
            shown = Pictures(stripes, [*said, "limit surface"], scenes[0].name)
            write_reflection_figure(run.figure("reflections"), shown)


def _after(depth: int) -> str:
    """Steps of subdivision, for a title."""
    return f", {depth} step{'s' * (depth > 1)}" if depth else ""


def _check(scene: Scene) -> None:
    if scene.conversion is None:
        raise InputError(
            f"{scene.name} has no control mesh: only patches of one have a limit surface to be compared with"
        )


def _without_steps(scene: Scene) -> tuple[str, ...]:
    """Schemes that need none; faces of more than four vertices do."""
    assert scene.conversion is not None
    sizes = scene.conversion.mesh.sizes
    if sizes.max() > 4:
        return ()
    return ("pinched" if sizes.min() < 4 else "acc", "gregory")


def _diagonal(scene: Scene) -> float:
    """Of the box around the control mesh."""
    assert scene.conversion is not None
    mesh = scene.conversion.mesh
    return float(np.linalg.norm(np.ptp(mesh.vertices[np.unique(mesh.corners)], axis=0)))


def distance_row(scene: Scene, view: View) -> Row:
    """Distances in per cent of the box diagonal of the control mesh, and in pixels."""
    found, unit = limit_distance(scene, view), 0.01 * _diagonal(scene)
    return {
        "limit_max_percent": found.largest / unit,
        "limit_rms_percent": found.rms / unit,
        "limit_bound_percent": float("nan") if found.bound is None else found.bound / unit,
        "limit_max_px": found.pixels,
    }


def largest_jump(scene: Scene) -> float:
    """Of normals, in degrees; NaN where no edge of the scene should be smooth."""
    assert scene.conversion is not None
    jumps = normal_jumps(scene.patches(), scene.conversion.smooth_sides)
    return float(jumps.max()) if jumps.size else float("nan")


def triangles(scene: Scene, view: View, tolerance: float, shaded: Shaded) -> Row:
    """At certified levels; of normals that have to be right, too, on how many patches nothing is claimed."""
    asked = {"tolerance": tolerance, **shaded.asked(Certified())}
    factors = tessellation_factors(scene.patches(), view, edge_numbers=scene.edge_numbers, **asked)
    row: Row = {"triangles": int(triangle_counts(factors.inner, factors.edges).sum())}
    return row | ({"patches_without_normal": len(numbers_without(factors.without_normal))} if shaded else {})


def _unbounded(rows: list[Row]) -> tuple[str, ...]:
    """A note where no bound is known."""
    without = sum(not np.isfinite(row["limit_bound_percent"]) for row in rows)
    if not without:
        return ()
    return (
        f"{without} of {len(rows)} rows have no bound: none is known at irregular boundaries and creases, beside"
        " triangles, at valence 2, and for faces with several irregular vertices",
    )


def _distances(scene: Scene, found: Any, view: View, unit: float) -> np.ndarray:
    """A picture of distances times a unit."""
    grid = np.zeros((len(scene.patches()), 17, 17))
    grid[found.odd] = found.grid * unit

    def paint(which: np.ndarray, parameters: np.ndarray, *_: np.ndarray) -> np.ndarray:
        at = np.minimum((parameters * 16).astype(int), 15)
        (i, j), (s, t) = at.T, (parameters * 16 - at).T
        own = grid[which]
        rows = [own[:, i + k, j] * (1 - t) + own[:, i + k, j + 1] * t for k in (0, 1)]
        return rows[0] * (1 - s) + rows[1] * s

    return splatted(scene.patches(), view, paint)
