"""Are the predicted factors safe, and are they minimal? Scale them, render, and look at every pixel."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from typing import Literal

import numpy as np
import tyro

from slefejax import Factors, Scene, View, pack
from slefejax.errors import InputError
from slefejax.experiments.options import (
    LoadOptions,
    OutputOptions,
    PredictionOptions,
    ViewOptions,
    camera_record,
    check_scales,
    columns_of,
)
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Row, Run, digest
from slefejax.figures.error_image import write_error_image
from slefejax.figures.minimality import write_factor_map, write_minimality_figure
from slefejax.gpu import GBuffer, Renderer, open_device
from slefejax.gpu.renderer import check_levels
from slefejax.measure.error import SLIPPED, drawn_error, slip
from slefejax.predict.factors import predicted
from slefejax.predict.kernel import Method
from slefejax.predict.methods import Request, Slefe, label_of
from slefejax.tessellator.levels import MOST_LEVEL, triangle_counts, with_pieces

THRESHOLDS = (0.1, 0.5, 1.0)  # pixels; the limits of the error colours of [YBP12]


@dataclass(frozen=True)
class Minimality:
    """Scale the predicted tessellation factors, render each, and measure the error of every pixel."""

    scene: tyro.conf.Positional[str]
    """A file (.obj, .usd…, .glb, …: the README lists them), or walker, teapot, twisted-quad, steep-patch."""
    scales: tuple[float, ...] = (1.0, 0.9, 0.8, 0.75, 0.7, 0.5)
    """What the predicted factors are multiplied by, one row each."""
    edges: Literal["shared", "own"] = "shared"
    """Edge levels: the larger of the two neighbours', without cracks; or each patch's own, with cracks."""
    prediction: tyro.conf.OmitArgPrefixes[PredictionOptions] = field(default_factory=PredictionOptions)
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def run(self) -> Report:
        """Predict, render at every scale, measure, draw the pictures."""
        check_scales(self.scales)
        scene = self.loading.load(self.scene)
        view = self.camera.view(scene)
        request = self.prediction.request(scene)
        factors, times = _predict(scene, view, request)
        largest = factors.scaled(max(self.scales)).levels
        beside = None if isinstance(request.method, Slefe) else _estimate(scene, view, request)
        device = open_device()
        check_levels(largest)
        arguments = {**asdict(self), "output": None, "camera": camera_record(view)}
        inputs = {"scene": digest(scene.patches().tobytes()), "opengl": device.renderer}
        with Run("minimality", arguments, self.output.out, inputs) as run:
            renderer = Renderer(scene.patches(), device)
            sweep = _Sweep(scene, view, factors, beside, self, request.method, run, renderer)
            with progress("rendering", len(self.scales)) as show:
                scales = list(self.scales)
                rows = run.each("scale", scales, lambda s: {**sweep.row(s), **times}, show, error_name)
            sweep.draw_pictures(rows)
            record = {
                "scene": scene.name,
                "notes": scene.notes,
                "opengl": {"renderer": device.renderer, "version": device.version},
                "sum_of_factors": float(np.sum(factors.factor)),
                "patches_off_screen": int(np.sum(np.asarray(factors.factor) == 0)),
                "left_out": self.prediction.left_out(scene),
            }
            out = run.finish(rows, record)
        title = _title(scene, view, factors)
        extra = {"sum_of_factors": record["sum_of_factors"]}
        return Report(scene.name, out, rows, title, scene.notes, extra, self.output.json)


def _predict(scene: Scene, view: View, request: Request) -> tuple[Factors, dict[str, float]]:
    """The factors, and how long they take once compiled (median of 5, milliseconds)."""

    def timed() -> tuple[Factors, float]:
        start = time.perf_counter()
        factors = predicted(request, pack(scene.patches()), view, scene.edge_numbers)
        return factors, time.perf_counter() - start

    (factors, _), *others = [timed() for _ in range(6)]
    if not np.any(np.asarray(factors.factor) > 0):
        raise InputError(
            "no patch is on the screen: turn the camera to the scene, or move it or its near and far planes"
        )
    return factors, {"predict_ms": 1e3 * float(np.median([seconds for _, seconds in others]))}


def _estimate(scene: Scene, view: View, request: Request) -> Factors:
    """The published factors, to be shown beside others."""
    return predicted(Request(Slefe(), request.tolerances), pack(scene.patches()), view, scene.edge_numbers)


@dataclass
class _Sweep:
    scene: Scene
    view: View
    factors: Factors
    beside: Factors | None
    options: Minimality
    method: Method
    run: Run
    renderer: Renderer

    def levels(self, scale: float, factors: Factors | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Inner and outer levels at a scale."""
        scaled = (factors or self.factors).scaled(scale)
        if self.options.edges == "shared":
            return scaled.inner, scaled.edges
        own = np.repeat(scaled.levels[:, None], 4, axis=1)
        return with_pieces(scaled.inner, own, np.arange(own.size).reshape(own.shape))

    def row(self, scale: float) -> Row:
        """Render at a scale, measure, keep the picture."""
        inner, outer = self.levels(scale)
        self.renderer.submit(self.view, inner, outer)  # once unmeasured: the driver may compile
        start = time.perf_counter()
        self.renderer.submit(self.view, inner, outer)
        render_ms = 1e3 * (time.perf_counter() - start)
        seen = self.renderer.read(self.view)
        error = drawn_error(self.scene.patches(), self.view, seen)
        write_error_image(self.run.file(error_name(scale)), error)
        return {
            **columns_of(self.method),
            "patches": len(self.scene.patches()),
            "triangles": int(triangle_counts(inner, outer).sum()),
            **error_shares(error, seen),
            "render_ms": render_ms,
            **self.estimate(scale),
        }

    def estimate(self, scale: float) -> Row:
        """What the published factors lead to at the same scale; NaN where they are too large to be drawn."""
        if self.beside is None:
            return {}
        inner, outer = self.levels(scale, self.beside)
        names = ("triangles", "share_above_0.5", "max_error_px")
        if max(inner.max(), outer.max()) > MOST_LEVEL:
            return {f"slefe_{name}": float("nan") for name in names}
        seen = self.renderer.draw(self.view, inner, outer)
        error = drawn_error(self.scene.patches(), self.view, seen)
        found = {"triangles": int(triangle_counts(inner, outer).sum()), **error_shares(error, seen)}
        return {f"slefe_{name}": found[name] for name in names}

    def draw_pictures(self, rows: list[Row]) -> None:
        """The factors on the patches, and one figure with everything."""
        inner, outer = self.levels(max(self.options.scales))
        patch = self.renderer.draw(self.view, inner, outer).patch
        painted = np.where(patch >= 0, np.append(np.asarray(self.factors.factor, float), 0.0)[patch], np.nan)
        labels = _labels(patch, np.asarray(self.factors.factor, float))
        write_factor_map(self.run.file("factors.png"), painted, labels)
        images = [self.run.file(error_name(row["scale"])) for row in rows]
        tolerance = self.options.prediction.tolerance
        write_minimality_figure(
            self.run.file("minimality.png"), rows, images, painted, labels, self.scene.name, tolerance
        )


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


def error_shares(error: np.ndarray, seen: GBuffer) -> Row:
    """Covered pixels, the share of them above each threshold, the largest error, and the driver's slips."""
    covered = error[~np.isnan(error)]
    if covered.size == 0:
        raise InputError("the picture is empty: no pixel centre is covered by the scene")
    shares = {f"share_above_{limit:g}": float(np.mean(covered > limit)) for limit in THRESHOLDS}
    return {"covered_pixels": int(covered.size), **shares, "max_error_px": float(covered.max()), **slips(seen)}


def slips(seen: GBuffer) -> Row:
    """How many pixels show what was drawn further than ``SLIPPED`` from their centres, and the furthest."""
    found = slip(seen)
    return {
        "slipped_pixels": int(np.count_nonzero(found > SLIPPED)),
        "max_slip_px": float(np.max(found, where=~np.isnan(found), initial=0.0)),
    }


def _title(scene: Scene, view: View, factors: Factors) -> str:
    assert factors.request is not None
    total, (method, tolerances) = float(np.sum(factors.factor)), factors.request
    return (
        f"{scene.name}: {len(scene.patches())} patches at {view.width}x{view.height},"
        f" method {label_of(method)}, tolerance {tolerances.pixels:g} px, sum of factors {total:.3f}"
    )
