"""Are the predicted factors safe, and are they minimal? Scale them, render, and look at every pixel."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from typing import Any, Literal

import numpy as np
import tyro

from slefejax import Factors, Scene, View, load, tessellation_factors
from slefejax.error import pixel_error
from slefejax.errors import InputError
from slefejax.experiments.options import OutputOptions, PredictionOptions, ViewOptions, check_scales
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Row, Run
from slefejax.figures.error_image import write_error_image
from slefejax.figures.minimality import write_factor_map, write_minimality_figure
from slefejax.gpu import Renderer, open_device
from slefejax.gpu.renderer import check_levels
from slefejax.tessellator import triangle_counts

THRESHOLDS = (0.1, 0.5, 1.0)  # pixels; the limits of the papers' error colours


@dataclass(frozen=True)
class Minimality:
    """Scale the predicted tessellation factors, render each, and measure the error of every pixel."""

    scene: tyro.conf.Positional[str]
    """A file (.bpt), or teapot."""
    scales: tuple[float, ...] = (1.0, 0.9, 0.8, 0.75, 0.7, 0.5)
    """What the predicted factors are multiplied by, one row each."""
    edges: Literal["shared", "own"] = "shared"
    """Edge levels: the larger of the two neighbours', without cracks; or each patch's own, with cracks."""
    prediction: tyro.conf.OmitArgPrefixes[PredictionOptions] = field(default_factory=PredictionOptions)
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    output: tyro.conf.OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def run(self) -> Report:
        """Predict, render at every scale, measure, draw the pictures."""
        check_scales(self.scales)
        scene = load(self.scene)
        view = self.camera.view(scene)
        with Run("minimality", _plain(self), self.output.out) as run:
            return self._run(scene, view, run)

    def _run(self, scene: Scene, view: View, run: Run) -> Report:
        factors, times = _predict(scene, view, self.prediction)
        device = open_device()
        check_levels(factors.scaled(max(self.scales)).levels, device.highest_level)
        sweep = _Sweep(scene, view, factors, self.edges, run, Renderer(scene.patches(), device))
        fixed = {
            "method": self.prediction.method,
            "segments": self.prediction.segments,
            "patches": len(scene.patches()),
        }
        with progress("rendering", len(self.scales)) as show:
            rows = run.each(
                "scale", list(self.scales), lambda s: {**fixed, **sweep.row(s), "predict_ms": times["predict_ms"]}, show
            )
        sweep.draw_pictures(rows)
        record = {
            "scene": scene.name,
            "notes": scene.notes,
            "opengl": {"renderer": device.renderer, "version": device.version},
            "sum_of_factors": float(np.sum(factors.factor)),
            "patches_off_screen": int(np.sum(np.asarray(factors.factor) == 0)),
            "compile_ms": times["compile_ms"],
            "left_out": _left_out(scene, self.prediction),
        }
        return Report(
            scene.name, run.finish(rows, record), rows, _title(scene, view, factors, self.prediction), scene.notes
        )


def _plain(options: Any) -> dict[str, Any]:
    arguments = asdict(options)
    arguments["output"] = None  # where results go does not change them
    return arguments


def _predict(scene: Scene, view: View, options: PredictionOptions) -> tuple[Factors, dict[str, float]]:
    """The factors, how long they take (median of 5, milliseconds), and how much longer the first time."""

    def timed() -> tuple[Factors, float]:
        start = time.perf_counter()
        factors = tessellation_factors(scene.patches(), view, edge_numbers=scene.edge_numbers, **options.arguments())
        return factors, time.perf_counter() - start

    (factors, first), *others = [timed() for _ in range(6)]
    if not np.any(np.asarray(factors.factor) > 0):
        raise InputError("no patch is on the screen: move the camera, or turn it towards the scene")
    usual = float(np.median([seconds for _, seconds in others]))
    return factors, {"predict_ms": 1e3 * usual, "compile_ms": 1e3 * (first - usual)}


@dataclass
class _Sweep:
    scene: Scene
    view: View
    factors: Factors
    edges: str
    run: Run
    renderer: Renderer

    def levels(self, scale: float) -> tuple[np.ndarray, np.ndarray]:
        """Inner and outer levels at a scale."""
        scaled = self.factors.scaled(scale)
        return scaled.inner, scaled.edges if self.edges == "shared" else np.repeat(scaled.levels[:, None], 4, axis=1)

    def row(self, scale: float) -> Row:
        """Render at a scale, measure, keep the picture."""
        inner, outer = self.levels(scale)
        self.renderer.submit(self.view, inner, outer)  # once unmeasured: the driver may compile
        start = time.perf_counter()
        self.renderer.submit(self.view, inner, outer)
        render_ms = 1e3 * (time.perf_counter() - start)
        seen = self.renderer.read(self.view)
        error = pixel_error(self.scene.patches(), self.view, seen.u, seen.v, seen.patch)
        write_error_image(self.run.file(error_name(scale)), error)
        return {"triangles": int(triangle_counts(inner, outer).sum()), **error_shares(error), "render_ms": render_ms}

    def draw_pictures(self, rows: list[Row]) -> None:
        """The factors on the patches, and one figure with everything."""
        inner, outer = self.levels(1.0)
        patch = self.renderer.draw(self.view, inner, outer).patch
        painted = np.where(patch >= 0, np.append(np.asarray(self.factors.factor, float), 0.0)[patch], np.nan)
        write_factor_map(self.run.file("factors.png"), painted)
        images = [self.run.file(error_name(row["scale"])) for row in rows]
        write_minimality_figure(self.run.file("minimality.png"), rows, images, painted, self.scene.name)


def error_name(scale: float) -> str:
    """File name of the error image of a scale."""
    return f"error_scale_{scale:g}.png"


def error_shares(error: np.ndarray) -> Row:
    """Covered pixels, the share of them above each threshold, and the largest error."""
    covered = error[np.isfinite(error)]
    if covered.size == 0:
        raise InputError("the picture is empty: no pixel centre is covered by the scene")
    shares = {f"share_above_{limit:g}": float(np.mean(covered > limit)) for limit in THRESHOLDS}
    return {"covered_pixels": int(covered.size), **shares, "max_error_px": float(covered.max())}


def _left_out(scene: Scene, options: PredictionOptions) -> list[str]:
    left = ["skinning and shape keys: the scene does not move"]
    if scene.patches().shape[-1] == 3:
        left.append("weights: the patches are polynomial")
    if options.depth_tolerance is None:
        left.append("depth widths: no depth tolerance was given")
    return left


def _title(scene: Scene, view: View, factors: Factors, options: PredictionOptions) -> str:
    total = float(np.sum(factors.factor))
    return (
        f"{scene.name}: {len(scene.patches())} patches at {view.width}x{view.height}, method {options.method},"
        f" m = {options.segments}, tolerance {options.tolerance:g} px, sum of factors {total:.3f}"
    )
