"""Error against run time: every rule for tessellation factors on the same scenes and cameras."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import NamedTuple

import numpy as np
import tyro

from slefejax import Factors, Scene, View, tessellation_factors
from slefejax.arguments import no_such
from slefejax.cameras import cameras_around
from slefejax.errors import InputError, naming
from slefejax.experiments.options import (
    FigureOptions,
    LoadOptions,
    Scenes,
    applicable,
    check_count,
    columns_of,
    notes_of,
    own_modules,
    parse_size,
)
from slefejax.experiments.report import Report, progress
from slefejax.experiments.shading import FOR_CERTIFIED, ShadingOptions, both_tolerances, unclaimed_numbers
from slefejax.experiments.store import Row, Run, digest
from slefejax.experiments.studies.look import Look, Shown
from slefejax.experiments.studies.measures import (
    Measure,
    areas,
    covering,
    domain,
    minimal,
    normals,
    over_minimal,
    pixels,
    rings,
    size,
    without_normal,
)
from slefejax.experiments.studies.study import Case, Study, shown
from slefejax.experiments.studies.times import milliseconds, taking_turns
from slefejax.figures.error_image import write_error_image
from slefejax.figures.studies.error_time import (
    write_error_against_time,
    write_pixels_against_triangles,
    write_triangle_sizes,
)
from slefejax.figures.studies.side_by_side import write_side_by_side
from slefejax.gpu import open_device
from slefejax.predict.kernel import Method
from slefejax.predict.methods import Certified, Slefe, label_of, method_of
from slefejax.predict.rules import EdgeLength, Filip, Fixed, ScreenBox

METHODS: dict[str, Method] = {
    label_of(method): method
    for method in (
        Certified(),
        *(Slefe(segments) for segments in range(1, 7)),
        Filip(),
        EdgeLength(8.0),
        *(ScreenBox(mu) for mu in (1.0, 2.0, 4.0, 8.0)),
        Fixed(16.0),
    )
}
_MOST_PICTURES = 6
PICTURES = ("certified", "slefe m=3", "filip", "edge-length 8", "screen-box 8", "fixed 16")


@dataclass(frozen=True)
class ErrorTime:
    """For every rule: its error at pixels and over the domain, its triangles and run time, and how far from minimal."""

    scenes: Scenes
    """Files (.obj, .usd…, .glb, …: the README lists them), or walker, teapot, twisted-quad, steep-patch."""
    cameras: int = 1
    """Cameras: the scene's own, and others on a sphere around it."""
    seed: int = 1
    """Seed of the other cameras."""
    size: str = "1440x900"
    """Width x height of the picture in pixels."""
    tolerance: float = 0.5
    """Error in pixels that is allowed."""
    repeats: int = 5
    """Runs of each rule whose median is the time; all rules take turns."""
    methods: tuple[str, ...] = ()
    """Some of the rules instead of all, by the names in the table, such as "slefe m=3"; or my_module:MyMethod."""
    shading: tyro.conf.OmitArgPrefixes[ShadingOptions] = field(default_factory=ShadingOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def values(self) -> dict[str, Method]:
        """The rules by name. Raises InputError for a name that there is not, or that stands there twice."""
        if len(set(self.methods)) < len(self.methods):
            raise InputError("--methods names a rule twice")
        with own_modules(*self.methods):
            found = {name: METHODS.get(name) or _own(name) for name in self.methods or METHODS}
        if self.shading.degrees and not any(isinstance(method, Certified) for method in found.values()):
            raise InputError("--normal-tolerance is for certified, which --methods leaves out")
        return found

    def pictures(self) -> tuple[str, ...]:
        """Those whose error images are shown side by side."""
        return tuple(name for name in self.methods or PICTURES)[:_MOST_PICTURES]

    def run(self) -> Report:
        """Measure every view, tabulate, draw."""
        check_count("--cameras", self.cameras)
        check_count("--repeats", self.repeats)
        self.shading.check()
        self.values()
        if not self.scenes:
            raise InputError("name at least one scene: a file, or teapot")
        scenes = [self.loading.load(name) for name in self.scenes]
        # those that were asked for by name are not left out silently: they are refused
        rules = [(self.values(), "") if self.methods else applicable(METHODS, scene) for scene in scenes]
        device = open_device()
        inputs = {"scenes": [digest(s.patches().tobytes()) for s in scenes], "opengl": device.renderer}
        views = [
            _Seen(scene, number, view, own)
            for scene, (own, _) in zip(scenes, rules, strict=True)
            for number, view in enumerate(cameras_around(scene, *parse_size(self.size), self.cameras, self.seed))
        ]
        with Run(
            "error-time", {**asdict(self), "output": None}, self.output.out, inputs, self.output.pages(self)
        ) as run:
            with progress("measuring", sum(len(seen.rules) for seen in views)) as show:
                looks = _Looks(views, self, run, show)
                turned = (normals, without_normal) if self.shading.degrees else ()
                found = Study(looks.cases(), (*MEASURES, *turned, looks.times)).rows(run, "measuring", show)
                looks.release()
            rows = shown(found)
            write_error_against_time(run.figure("error_against_time"), rows, self.tolerance)
            write_pixels_against_triangles(run.figure("pixels_against_triangles"), rows, self.tolerance)
            write_triangle_sizes(run.figure("triangle_sizes"), rows)
            first = {row["method_name"]: row for row in rows[: len(views[0].rules)]}
            panels = [(first[name], run.file(picture_name(name))) for name in self.pictures() if name in first]
            write_side_by_side(run.figure("side_by_side"), panels, self.tolerance)
            names = " ".join(scene.name for scene in scenes)
            opengl = {"renderer": device.renderer, "version": device.version}
            without = [_unclaimed(found, scene.name) for scene in scenes]
            beside = zip(rules, without, strict=True)
            notes = notes_of(scenes, ["; ".join(note for note in (left, *own) if note) for (_, left), own in beside])
            notes += (FOR_CERTIFIED,) if self.shading.degrees else ()
            out = run.finish(rows, {"scene": names, "notes": notes, "opengl": opengl})
        asked = both_tolerances(self.tolerance, self.shading.degrees)
        title = f"{names}: rules for tessellation factors at {asked}, {len(views)} views of {self.size}"
        return Report(names, out, summary(rows), title, notes, extra={"table": rows}, as_json=self.output.json)


def _unclaimed(rows: list[Row], name: str) -> tuple[str, ...]:
    """What to say of a scene's patches whose normals have no claim, in whatever view they are seen."""
    numbers = {patch for row in rows if row["scene"] == name for patch in row.get("_without_normal", ())}
    return unclaimed_numbers(sorted(numbers))


def _own(name: str) -> Method:
    if ":" not in name:
        raise InputError(no_such("rule", name, METHODS))
    return method_of(name)


def picture_name(method: str) -> str:
    """File name of the error image of a rule."""
    return f"error_{re.sub('[^a-zA-Z0-9.-]+', '_', method.replace('=', ''))}.png"


MEASURES = (size, minimal, pixels, domain, rings, over_minimal, covering, areas)
_TIMES = ("compile_ms", "predict_ms", "predict_spread_ms", "render_ms", "render_spread_ms")


class _Seen(NamedTuple):
    """A scene in a view, by the rules that take its patches."""

    scene: Scene
    camera: int
    view: View
    rules: dict[str, Method]


class _Looks:
    """All rules in all views, one view after the other; the error images of the first are kept."""

    def __init__(self, views: list[_Seen], options: ErrorTime, run: Run, show: Callable[..., None]) -> None:
        self._views, self._options, self._run, self._show = views, options, run, show
        self._number, self._shown = -1, self._of(0)
        self._factors: dict[str, Factors] = {}
        self._times: dict[str, Row] = {}
        self.times = Measure(_TIMES, lambda look: self._times[look.name])

    def cases(self) -> list[Case]:
        """A view and a rule each."""
        return [
            Case(
                f"{number} {name}",
                {"scene": seen.scene.name, "camera": seen.camera, "method_name": name, **columns_of(method)},
                partial(self.look, number, name),
            )
            for number, seen in enumerate(self._views)
            for name, method in seen.rules.items()
        ]

    def look(self, number: int, name: str) -> Look:
        """One view by one rule."""
        with naming(f"scene {self._views[number].scene.name!r}"):
            if number != self._number:
                self.release()
                self._number, self._shown = number, self._of(number)
                self._predict()
            found = self._shown.drawn(self._factors[name], name)
            if number == 0 and name in self._options.pictures():
                title = f"{self._views[0].scene.name}: {name}, asked for at most {self._options.tolerance:g} px"
                write_error_image(self._run.file(picture_name(name)), found.error, title)
            return found

    def _of(self, number: int) -> Shown:
        seen = self._views[number]
        count = f"of {len(seen.scene.patches()):,} minimal factors"
        settled = lambda n: self._show(detail=f"{n:,} {count}")  # noqa: E731
        shaded = self._options.shading.of(seen.scene)
        return Shown(seen.scene, seen.view, self._options.tolerance, settled, shaded)

    def _predict(self) -> None:
        """By all rules: first calls, then run times of rules that take turns."""
        scene, view, renderer = self._shown.scene, self._shown.view, self._shown.renderer
        rules = self._views[self._number].rules

        def predict(name: str) -> Factors:
            tolerance, numbers = self._options.tolerance, scene.edge_numbers
            kept = self._shown.shaded.asked(rules[name])
            return tessellation_factors(
                scene.patches(), view, rules[name], tolerance=tolerance, edge_numbers=numbers, **kept
            )

        calls = {name: partial(predict, name) for name in rules}
        first = {name: max(0.0, milliseconds(call) - milliseconds(call)) for name, call in calls.items()}
        self._factors = {name: call() for name, call in calls.items()}
        draws = {}
        for name, own in self._factors.items():
            self._shown.heard(own)
            draws[name] = partial(renderer.submit, view, own.inner, own.edges)
            draws[name]()  # once unmeasured: the driver may compile
        both = [taking_turns(what, self._options.repeats) for what in (calls, draws)]
        for name, more in first.items():
            (predicted, predicted_apart), (drawn, drawn_apart) = (found[name] for found in both)
            numbers = (more, predicted, predicted_apart, drawn, drawn_apart)
            self._times[name] = dict(zip(_TIMES, numbers, strict=True))

    def release(self) -> None:
        """Of the last view."""
        self._shown.release()


def summary(rows: list[Row]) -> list[Row]:
    """A row a rule: medians over all views, and the worst errors."""
    names = list(dict.fromkeys(row["method_name"] for row in rows))
    medians = (
        "triangles",
        "share_above_0.5",
        "share_wrong_silhouette",
        "share_wrong_patch_inside",
        "factor_over_minimal_median",
        "predict_ms",
        "render_ms",
    )
    worst = ["sup_error_px", "drawn_sup_error_px", "max_error_px", "slipped_pixels", "max_slip_px"]
    worst += [name for name in normals.columns if name in rows[0]]
    found = []
    for name in names:
        own = [row for row in rows if row["method_name"] == name]
        found.append(
            {
                "method": name,
                **{key: float(np.median([row[key] for row in own])) for key in medians},
                **{key: max(row[key] for row in own) for key in worst},
            }
        )
    return found
