"""Does the certified factor hold, where does the published estimate fail, and what does the proof cost?"""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from functools import partial

import jax
import numpy as np
import tyro

from slefejax import Factors, Scene, View, tessellation_factors
from slefejax.errors import InputError, naming
from slefejax.experiments.options import (
    FigureOptions,
    LoadOptions,
    Scenes,
    ViewOptions,
    applicable,
    camera_record,
    check_count,
    notes_of,
    rounding_notes,
)
from slefejax.experiments.report import Report
from slefejax.experiments.shading import FOR_CERTIFIED, ShadingOptions, both_tolerances, unclaimed_numbers
from slefejax.experiments.store import Row, Run, digest
from slefejax.experiments.studies.look import Look, Shown
from slefejax.experiments.studies.measures import (
    Measure,
    domain,
    domain_of_normals,
    measure,
    minimal,
    normals,
    size,
    slips,
    without_normal,
)
from slefejax.experiments.studies.study import Case, Study, shown
from slefejax.experiments.studies.times import taking_turns
from slefejax.figures.error_image import write_error_image
from slefejax.figures.studies.certify import write_certify_figure
from slefejax.gpu import open_device
from slefejax.predict.kernel import Method
from slefejax.predict.methods import Certified, Slefe
from slefejax.predict.rules import Filip
from slefejax.tessellator.levels import HIGHEST_LEVEL

SHOWN = ("certified", "slefe")
_REPEATS = 7


@dataclass(frozen=True)
class Certify:
    """Patch by patch: the certified factor, the largest error that it and the published estimate lead to, the slack."""

    scenes: Scenes
    """Files (.obj, .usd…, .glb, …: the README lists them), or walker, teapot, twisted-quad, steep-patch."""
    tiles: int = 2
    """Pieces along each side that a patch is cut into to bound it; more are tighter and slower."""
    verify: bool = False
    """Smaller numbers are proved cell by cell, which is slower and tighter."""
    anisotropic: bool = False
    """Levels that differ along u and v, where that saves triangles."""
    segments: int = 3
    """Of the published estimate: pieces m in each direction."""
    tolerance: float = 0.5
    """Error in pixels that is allowed."""
    shading: tyro.conf.OmitArgPrefixes[ShadingOptions] = field(default_factory=ShadingOptions)
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Predict by all methods, measure, draw."""
        if not self.scenes:
            raise InputError("name at least one scene: a file, teapot, twisted-quad or steep-patch")
        check_count("--tiles", self.tiles)
        self.shading.check()
        scenes = [self.loading.load(name) for name in self.scenes]
        views = [self.camera.view(scene) for scene in scenes]
        device = open_device()
        arguments = {**asdict(self), "output": None, "camera": [camera_record(view) for view in views]}
        inputs = {"scenes": [digest(s.patches().tobytes()) for s in scenes], "opengl": device.renderer}
        with Run("certify", arguments, self.output.out, inputs, self.output.pages(self)) as run:
            looks = _Looks(scenes, views, self, run)
            found = Study(looks.cases(), self._measures(looks)).rows(run, "measuring")
            looks.release()
            summary = shown(found)
            rows = _patch_rows(found, self.tolerance, self.shading.degrees)
            images = [
                [run.file(picture_name(k, name)) for name in looks.methods[k] if name in SHOWN]
                for k in range(len(scenes))
            ]
            write_certify_figure(run.figure("certify"), rows, summary, images, self.tolerance)
            names = " ".join(scene.name for scene in scenes)
            rounding = [rounding_notes(*own, self.tolerance) for own in zip(scenes, views, strict=True)]
            beside = zip(looks.left_out, rounding, looks.unclaimed(found), strict=True)
            more = ["; ".join(note for note in (left, *own, *none) if note) for left, own, none in beside]
            notes = notes_of(scenes, more) + ((FOR_CERTIFIED,) if self.shading.degrees else ())
            record = {"scene": names, "notes": notes, "summary": summary, "opengl": {"renderer": device.renderer}}
            out = run.finish(rows, record)
        broken = sum(row["slack_px"] < 0 or row.get("slack_deg", 0) < 0 for row in rows)
        high = sum(max(row["inner_u"], row["inner_v"]) > HIGHEST_LEVEL for row in rows)
        asked = both_tolerances(self.tolerance, self.shading.degrees)
        title = f"{names}: certified factors at {asked}, {broken} of {len(rows)} patches above it"
        title += f", {high} need levels above {HIGHEST_LEVEL} and are drawn in pieces" if high else ""
        return Report(names, out, rows, title, notes + _sentences(summary), {"summary": summary}, self.output.json)

    def _measures(self, looks: _Looks) -> tuple[Measure, ...]:
        own = (size, _uniform, minimal, domain, _pixels, _above(self.tolerance), looks.times, _by_patch)
        degrees = self.shading.degrees
        return own if degrees is None else (*own, normals, domain_of_normals, _kept(degrees), without_normal, _turned)


def picture_name(scene: int, method: str) -> str:
    """File name of an error image; scenes are counted from 0."""
    return f"error_scene_{scene}_{method}.png"


class _Looks:
    """Scenes by all methods, one scene after the other; the error images are kept."""

    def __init__(self, scenes: list[Scene], views: list[View], options: Certify, run: Run) -> None:
        self._scenes, self._views, self._options, self._run = scenes, views, options, run
        self._number, self._shown = -1, self._of(0)
        certified = Certified(options.tiles, verify=options.verify)
        asked = {"certified": certified, "slefe": Slefe(options.segments), "filip": Filip()}
        both = [applicable(asked, scene) for scene in scenes]
        self.methods, self.left_out = [own for own, _ in both], [note for _, note in both]
        self._factors: dict[str, Factors] = {}
        self._milliseconds: dict[str, tuple[float, float]] = {}
        self.times = Measure(("predict_ms",), lambda look: {"predict_ms": self._milliseconds[look.name][0]})

    def cases(self) -> list[Case]:
        """A scene and a method each."""
        return [
            Case(f"{number} {name}", {"scene": scene.name, "method": name}, partial(self.look, number, name))
            for number, scene in enumerate(self._scenes)
            for name in self.methods[number]
        ]

    def look(self, number: int, name: str) -> Look:
        """One scene by one method."""
        with naming(f"scene {self._scenes[number].name!r}"):
            if number != self._number:
                self._enter(number)
            found = self._shown.drawn(self._factors[name], name)
            title = f"{self._scenes[number].name}: {name}, asked for at most {self._options.tolerance:g} px"
            write_error_image(self._run.file(picture_name(number, name)), found.error, title)
            return found

    def _enter(self, number: int) -> None:
        """Predict by all methods; times once they are compiled, the methods taking turns."""
        self.release()
        scene, view = self._scenes[number], self._views[number]
        self._number, self._shown = number, self._of(number)
        shaded = self._shown.shaded

        def predict(method: Method) -> Factors:
            numbers = scene.edge_numbers
            kept, tolerance = shaded.asked(method), self._options.tolerance
            factors = tessellation_factors(
                scene.patches(), view, method, tolerance=tolerance, edge_numbers=numbers, **kept
            )
            jax.block_until_ready(factors.factor)
            return factors

        methods = self.methods[number]
        self._factors = {name: predict(method) for name, method in methods.items()}
        calls = {name: partial(predict, method) for name, method in methods.items()}
        self._milliseconds = taking_turns(calls, _REPEATS)
        if self._options.anisotropic:
            self._factors["certified"] = predict(Certified(self._options.tiles, True, self._options.verify))
        self._shown.heard(self._factors["certified"])

    def _of(self, number: int) -> Shown:
        scene, view = self._scenes[number], self._views[number]
        return Shown(scene, view, self._options.tolerance, shaded=self._options.shading.of(scene))

    def unclaimed(self, rows: list[Row]) -> list[tuple[str, ...]]:
        """Of every scene, what to say of patches whose normals have no claim."""
        first = np.cumsum([0, *map(len, self.methods[:-1])])
        return [unclaimed_numbers(rows[k].get("_without_normal", [])) for k in first]

    def release(self) -> None:
        """Of the last scene."""
        self._shown.release()


@measure("uniform_triangles")
def _uniform(look: Look) -> Row:
    """Triangles of uniform grids, no edge being shared."""
    own = look.with_factors
    return {"uniform_triangles": int(2 * np.sum(own.levels**2 if own.pairs is None else own.pairs.prod(axis=1)))}


@measure("max_error_px", "slipped_pixels", "max_slip_px")
def _pixels(look: Look) -> Row:
    """Of pictures in which there may be nothing."""
    return {"max_error_px": float(np.nanmax(look.error, initial=0.0)), **slips(look.seen)}


def _above(tolerance: float) -> Measure:
    """How many patches err by more than the tolerance, uniformly cut or as they are drawn."""
    return Measure(
        ("patches_above",),
        lambda look: {"patches_above": int(np.sum(np.maximum(look.uniform, look.worst) > tolerance))},
    )


def _kept(degrees: float) -> Measure:
    """Whether no angle of normals is larger, uniformly cut or as they are drawn."""
    return Measure(
        ("angle_kept",),
        lambda look: {"angle_kept": not bool(np.any([look.uniform_turned > degrees, look.worst_turned > degrees]))},
    )


@measure("_turned_uniform", "_turned_drawn")
def _turned(look: Look) -> Row:
    """Angles of normals patch by patch, for the table of patches."""
    return {"_turned_uniform": look.uniform_turned.tolist(), "_turned_drawn": look.worst_turned.tolist()}


@measure("_factor", "_inner", "_minimal", "_uniform", "_drawn")
def _by_patch(look: Look) -> Row:
    """Patch by patch, for the table of patches."""
    factors = look.with_factors
    arrays = (factors.factor, factors.inner, look.beside.minimal, look.uniform, look.worst)
    return dict(zip(_by_patch.columns, (np.asarray(own).tolist() for own in arrays), strict=True))


def _patch_rows(found: list[Row], tolerance: float, degrees: float | None) -> list[Row]:
    """The certified factor, its errors and what is left of the tolerances, beside the estimate's where it applies."""
    rows = []
    for number, own in enumerate(found):
        if own["method"] != "certified":
            continue
        beside = [row for row in found[number + 1 : number + 2] if row["method"] == "slefe"]
        for k, least in enumerate(own["_minimal"]):
            uniform, drawn = own["_uniform"][k], own["_drawn"][k]
            estimate = [row[name][k] for row in beside for name in ("_factor", "_uniform", "_drawn")] or [np.nan] * 3
            rows.append(
                {
                    "scene": own["scene"],
                    "patch": k,
                    "factor": own["_factor"][k],
                    "inner_u": own["_inner"][k][0],
                    "inner_v": own["_inner"][k][1],
                    "minimal": least,
                    "sup_error_px": uniform,
                    "drawn_sup_error_px": drawn,
                    "slack_px": tolerance - max(uniform, drawn),
                    "slefe_factor": estimate[0],
                    "slefe_sup_error_px": estimate[1],
                    "slefe_drawn_sup_error_px": estimate[2],
                    **({} if degrees is None else _angles(own, k, degrees)),
                }
            )
    return rows


def _angles(own: Row, patch: int, degrees: float) -> Row:
    """Of normals of a patch, and what is left of the tolerance; NaN without a claim."""
    uniform, drawn = own["_turned_uniform"][patch], own["_turned_drawn"][patch]
    return {
        "sup_normal_error_deg": uniform,
        "drawn_sup_normal_error_deg": drawn,
        "slack_deg": degrees - max(uniform, drawn),
    }


def _sentences(summary: list[Row]) -> tuple[str, ...]:
    return tuple(
        f"{row['scene']}, {row['method']}: {row['triangles']:,} triangles ({row['uniform_triangles']:,} without shared"
        f" edges; minimal {row['minimal_triangles']:,}), largest error {row['sup_error_px']:.3g} px uniform and"
        f" {row['drawn_sup_error_px']:.3g} px as drawn, {row['patches_above']} of {row['patches']} patches above the"
        f" tolerance, {_said_of_normals(row)}{row['predict_ms']:.2g} ms"
        for row in summary
    )


def _said_of_normals(row: Row) -> str:
    if "angle_kept" not in row:
        return ""
    uniform, drawn = row["sup_normal_error_deg"], row["drawn_sup_normal_error_deg"]
    return f"normals up to {uniform:.3g}° off uniform and {drawn:.3g}° as drawn, "
