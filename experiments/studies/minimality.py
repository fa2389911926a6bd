"""Are the predicted factors safe, and are they minimal? Scale them, render, and look at every pixel."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from functools import partial
from typing import Any

import numpy as np
import tyro

from slefejax import Factors, GregoryPatches, Scene, View, pack
from slefejax.experiments.levels import Edges, check_seen, levels_of
from slefejax.experiments.looks.wire import wire_colours
from slefejax.experiments.options import (
    FigureOptions,
    LoadOptions,
    PredictionOptions,
    ViewOptions,
    camera_record,
    check_scales,
    columns_of,
)
from slefejax.experiments.report import Report
from slefejax.experiments.shading import FOR_CERTIFIED, Shaded, unclaimed
from slefejax.experiments.store import Row, Run, digest
from slefejax.experiments.studies.look import Look, Shown
from slefejax.experiments.studies.measures import (
    Measure,
    measure,
    normals,
    pixels,
    rendering,
    size,
    triangles_over_minimal,
)
from slefejax.experiments.studies.study import Case, Study
from slefejax.figures.error_image import write_error_image
from slefejax.figures.looks.panels import Heading
from slefejax.figures.studies.enough import told_apart, write_enough
from slefejax.figures.studies.minimality import Wire, write_factor_map, write_minimality_figure
from slefejax.gpu import Renderer, open_device
from slefejax.gpu.renderer import check_levels
from slefejax.predict.factors import predicted
from slefejax.predict.factors import shaded as shaded_by
from slefejax.predict.kernel import Prepared
from slefejax.predict.methods import Request, Slefe, label_of
from slefejax.tessellator.levels import MOST_LEVEL


@dataclass(frozen=True)
class Minimality:
    """Scale the predicted tessellation factors, render each, and measure the error of every pixel."""

    scene: tyro.conf.Positional[str]
    """A file (.obj, .usd…, .glb, …: the README lists them), or walker, teapot, twisted-quad, steep-patch."""
    scales: tuple[float, ...] = (1.0, 0.9, 0.8, 0.75, 0.7, 0.5)
    """What the predicted factors are multiplied by, one row each."""
    edges: Edges = "shared"
    """Edge levels: the larger of the two neighbours', without cracks; or each patch's own, with cracks."""
    prediction: tyro.conf.OmitArgPrefixes[PredictionOptions] = field(default_factory=PredictionOptions)
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Predict, render at every scale, measure, draw the pictures."""
        check_scales(self.scales)
        scene = self.loading.load(self.scene)
        view = self.camera.view(scene)
        request, shaded = self.prediction.request(scene), self.prediction.shading.of(scene)
        factors, predict_ms = _predict(scene, view, request, shaded)
        largest = factors.scaled(max(self.scales)).levels
        same = isinstance(request.method, Slefe) or isinstance(scene.patches(), GregoryPatches)
        beside = None if same else _estimate(scene, view, request)
        device = open_device()
        check_levels(largest)
        arguments = {**asdict(self), "output": None, "camera": camera_record(view)}
        inputs = {"scene": digest(scene.patches().tobytes()), "opengl": device.renderer}
        with Run("minimality", arguments, self.output.out, inputs, self.output.pages(self)) as run:
            renderer = Renderer(scene.patches(), device, **shaded.drawn)
            shown = Shown(scene, view, self.prediction.tolerance, shaded=shaded)
            shown.heard(factors)
            sweep = _Sweep(shown, factors, beside, self, run, renderer)
            own = columns_of(request.method)
            cases = [Case(scale, {"scale": scale, **own}, partial(sweep.look, scale)) for scale in self.scales]
            times = Measure(("predict_ms",), lambda _: {"predict_ms": predict_ms})
            estimate = () if beside is None else (_estimate_beside,)
            turned = (normals,) if shaded else ()
            measures = (size, triangles_over_minimal, pixels, *turned, rendering, *estimate, times)
            study = Study(cases, measures, error_name)
            rows = study.rows(run, "rendering")
            sweep.draw_pictures(rows)
            alone = (FOR_CERTIFIED,) if shaded and beside is not None else ()
            notes = (*scene.notes, *unclaimed(factors.without_normal), *alone)
            record = {
                "scene": scene.name,
                "notes": notes,
                "opengl": {"renderer": device.renderer, "version": device.version},
                "sum_of_factors": float(np.sum(factors.factor)),
                "patches_off_screen": int(np.sum(np.asarray(factors.factor) == 0)),
                "left_out": self.prediction.left_out(scene),
            }
            out = run.finish(rows, record)
        title = _title(scene, view, factors, self.prediction.asked)
        extra = {"sum_of_factors": record["sum_of_factors"]}
        return Report(scene.name, out, rows, title, notes, extra, self.output.json)


def _predict(scene: Scene, view: View, request: Request, shaded: Shaded) -> tuple[Factors, float]:
    """The factors, and how long they take once compiled (median of 5, milliseconds)."""

    def timed() -> tuple[Factors, float]:
        start = time.perf_counter()
        prepared = shaded_by(request, Prepared(pack(scene.patches())), *shaded.kind)
        factors = predicted(request, prepared, view, scene.edge_numbers)
        return factors, time.perf_counter() - start

    (factors, _), *others = [timed() for _ in range(6)]
    check_seen(factors)
    return factors, 1e3 * float(np.median([seconds for _, seconds in others]))


def _estimate(scene: Scene, view: View, request: Request) -> Factors:
    """The published factors, to be shown beside others."""
    return predicted(Request(Slefe(), request.tolerances), pack(scene.patches()), view, scene.edge_numbers)


@dataclass
class _Scaled(Look):
    """With what the published estimate leads to at the same scale; None where it is too large to be drawn."""

    estimate: Look | None = None


@dataclass
class _Sweep:
    shown: Shown
    factors: Factors
    beside: Factors | None
    options: Minimality
    run: Run
    renderer: Renderer

    def levels(self, scale: float, factors: Factors | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Inner and outer levels at a scale."""
        return levels_of((factors or self.factors).scaled(scale), edges=self.options.edges)

    def look(self, scale: float) -> _Scaled:
        """Render at a scale, and keep the picture."""
        (patches, view), levels = (self.shown.patches, self.shown.view), self.levels(scale)
        found = _Scaled(patches, view, self.renderer, *levels, factors=self.factors.scaled(scale), shown=self.shown)
        if self.beside is not None:
            inner, outer = self.levels(scale, self.beside)
            if max(inner.max(), outer.max()) <= MOST_LEVEL:
                found.estimate = Look(patches, view, self.renderer, inner, outer)
        _ = found.render_ms
        name, asked = self.shown.scene.name, self.options.prediction.asked
        title = f"{name}: factors for {asked} ({self.options.prediction.method}), times {scale:g}"
        write_error_image(self.run.file(error_name(scale)), found.error, title)
        return found

    def draw_pictures(self, rows: list[Row]) -> None:
        """The factors on the patches, and one figure with everything."""
        inner, outer = self.levels(max(self.options.scales))
        patch = self.renderer.draw(self.shown.view, inner, outer).patch
        painted = np.where(patch >= 0, np.append(np.asarray(self.factors.factor, float), 0.0)[patch], np.nan)
        labels = _labels(patch, np.asarray(self.factors.factor, float))
        images = [self.run.file(error_name(row["scale"])) for row in rows]
        shown = (painted, labels, self.shown.scene.name, self.options.prediction.asked)
        scales = self.options.scales
        main = 1.0 if 1.0 in scales else max(scales)
        told = told_apart(rows, self.options.prediction.tolerance)
        wires = self.wires([main, *(row["scale"] for row, _ in told)])
        write_minimality_figure(self.run.figure("minimality"), rows, images, *shown, Wire(main, wires[0]))
        write_factor_map(self.run.figure("factors"), *shown)
        images = [self.run.file(error_name(row["scale"])) for row, _ in told]
        write_enough(self.run.figure("enough"), told, wires[1:], images, self.heading)

    @property
    def heading(self) -> Heading:
        """Of the figure that is understood at a glance."""
        view, asked = self.shown.view, f"{self.options.prediction.tolerance:g} px"
        how = f"method {label_of(self.options.prediction.value())}, {view.width} x {view.height} pixels"
        return Heading(
            self.shown.scene.name, f"how many triangles are enough, so that no pixel is off by more than {asked}?", how
        )

    def wires(self, scales: list[float]) -> list[np.ndarray]:
        """Of each scale the triangles as lines over shading, as colours."""
        (patches, view), device = (self.shown.patches, self.shown.view), self.renderer.device
        renderer = Renderer(patches, device, normals=True, wire=True)
        found = [wire_colours(Look(patches, view, renderer, *self.levels(scale))) for scale in scales]
        renderer.release()
        return found


def error_name(scale: float) -> str:
    """File name of the error image of a scale."""
    return f"error_scale_{float(scale)!r}.png".replace(".0.png", ".png")


def _labels(patch: np.ndarray, factor: np.ndarray, most: int = 80) -> list[tuple[float, float, str]]:
    """(column, row, factor): where to write a patch's factor, in the middle of what is seen of it if that is enough."""
    numbers, counts = np.unique(patch[patch >= 0], return_counts=True)
    large = numbers[counts > patch.size / 1500]
    if len(large) > most:
        return []
    places = [np.argwhere(patch == number) for number in large]
    nearest = [place[np.argmin(np.sum((place - np.median(place, axis=0)) ** 2, axis=1))] for place in places]
    return [(float(c), float(r), f"{factor[n]:.1f}") for (r, c), n in zip(nearest, large, strict=True)]


_BESIDE = ("triangles", "share_above_0.5", "max_error_px")


@measure(*(f"slefe_{name}" for name in _BESIDE))
def _estimate_beside(look: Any) -> Row:
    """What the published factors lead to at the same scale; NaN where they are too large to be drawn."""
    other = look.estimate
    found = dict.fromkeys(_BESIDE, float("nan")) if other is None else {**size(other), **pixels(other)}
    return {f"slefe_{name}": found[name] for name in _BESIDE}


def _title(scene: Scene, view: View, factors: Factors, asked: str) -> str:
    assert factors.request is not None
    total, method = float(np.sum(factors.factor)), factors.request.method
    return (
        f"{scene.name}: {len(scene.patches())} patches at {view.width}x{view.height},"
        f" method {label_of(method)}, tolerance {asked}, sum of factors {total:.3f}"
    )
