"""Does the certified factor hold, where does the published estimate fail, and what does the proof cost?"""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field, replace

import jax
import numpy as np
import tyro

from slefejax import Factors, Scene, View, minimal_factors, sampled_error, tessellation_factors, triangle_error
from slefejax.errors import InputError, naming
from slefejax.experiments.minimality import slips
from slefejax.experiments.options import (
    LoadOptions,
    OutputOptions,
    Scenes,
    ViewOptions,
    camera_record,
    check_count,
    notes_of,
)
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Row, Run, digest
from slefejax.figures.certify import write_certify_figure
from slefejax.figures.error_image import write_error_image
from slefejax.gpu import Renderer, open_device
from slefejax.measure.error import drawn_error
from slefejax.predict.kernel import Method
from slefejax.predict.methods import Certified, Slefe
from slefejax.predict.rules import Filip
from slefejax.tessellator.levels import HIGHEST_LEVEL, triangle_counts

METHODS = ("certified", "slefe", "filip")
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
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def run(self) -> Report:
        """Predict by all methods, measure, draw."""
        if not self.scenes:
            raise InputError("name at least one scene: a file, teapot, twisted-quad or steep-patch")
        check_count("--tiles", self.tiles)
        scenes = [self.loading.load(name) for name in self.scenes]
        views = [self.camera.view(scene) for scene in scenes]
        device = open_device()
        arguments = {**asdict(self), "output": None, "camera": [camera_record(view) for view in views]}
        inputs = {"scenes": [digest(s.patches().tobytes()) for s in scenes], "opengl": device.renderer}
        with Run("certify", arguments, self.output.out, inputs) as run:
            with progress("measuring", len(scenes)) as show:

                def measure(k: int) -> Row:
                    with naming(f"scene {scenes[k].name!r}"):
                        return _measure(scenes[k], views[k], self, run, k)

                found = run.each("scene", list(range(len(scenes))), measure, show)
            summary = [row for one in found for row in one["summary"]]
            rows = [row for one in found for row in one["patches"]]
            images = [[run.file(picture_name(k, name)) for name in METHODS[:2]] for k in range(len(scenes))]
            write_certify_figure(run.file("certify.png"), rows, summary, images, self.tolerance)
            names = " ".join(scene.name for scene in scenes)
            notes = notes_of(scenes)
            record = {"scene": names, "notes": notes, "summary": summary, "opengl": {"renderer": device.renderer}}
            out = run.finish(rows, record)
        broken = sum(row["sup_error_px"] > self.tolerance or row["drawn_sup_error_px"] > self.tolerance for row in rows)
        high = sum(max(row["inner_u"], row["inner_v"]) > HIGHEST_LEVEL for row in rows)
        title = f"{names}: certified factors at {self.tolerance:g} px, {broken} of {len(rows)} patches above it"
        title += f", {high} need levels above {HIGHEST_LEVEL} and are drawn in pieces" if high else ""
        return Report(names, out, rows, title, notes + _sentences(summary), {"summary": summary}, self.output.json)


def picture_name(scene: int, method: str) -> str:
    """File name of an error image; scenes are counted from 0."""
    return f"error_{scene}_{method}.png"


def _predictions(scene: Scene, view: View, options: Certify) -> tuple[dict[str, Factors], dict[str, float]]:
    """Factors by every method, and the milliseconds they take once compiled; the methods take turns."""

    def predict(method: Method) -> Factors:
        factors = tessellation_factors(
            scene.patches(), view, method, tolerance=options.tolerance, edge_numbers=scene.edge_numbers
        )
        jax.block_until_ready(factors.factor)
        return factors

    certified = Certified(options.tiles, verify=options.verify)
    methods: dict[str, Method] = {"certified": certified, "slefe": Slefe(options.segments), "filip": Filip()}
    if scene.patches().shape[-1] == 4:
        del methods["filip"]
    factors, times = {name: predict(m) for name, m in methods.items()}, {name: [] for name in methods}
    for _ in range(_REPEATS):
        for name, method in methods.items():
            start = time.perf_counter()
            predict(method)
            times[name].append(time.perf_counter() - start)
    if options.anisotropic:
        factors["certified"] = predict(replace(certified, anisotropic=True))
    return factors, {m: 1e3 * float(np.median(t)) for m, t in times.items()}


def _measure(scene: Scene, view: View, options: Certify, run: Run, number: int) -> Row:
    """One scene: a row a patch, and a row a method; the error images are kept."""
    patches = scene.patches()
    factors, milliseconds = _predictions(scene, view, options)
    minimal = minimal_factors(patches, view, options.tolerance)
    renderer = Renderer(patches)
    summary, errors = [], {}
    for method, own in factors.items():
        inner, edges = own.inner, own.edges
        uniform = sampled_error(patches, inner, view)
        drawn = triangle_error(patches, renderer.capture(view, inner, edges), view)
        seen = renderer.draw(view, inner, edges)
        pixels = drawn_error(patches, view, seen)
        write_error_image(run.file(picture_name(number, method)), pixels)
        errors[method] = (uniform, drawn)
        summary.append(
            {
                "scene": scene.name,
                "method": method,
                "patches": len(patches),
                "triangles": int(triangle_counts(inner, edges).sum()),
                "uniform_triangles": int(2 * np.sum(own.levels**2 if own.pairs is None else own.pairs.prod(axis=1))),
                "minimal_triangles": int(2 * np.sum(minimal**2)),
                "sup_error_px": float(uniform.max()),
                "drawn_sup_error_px": float(drawn.max()),
                "max_error_px": float(np.nanmax(pixels, initial=0.0)),
                **slips(seen),
                "patches_above": int(np.sum(np.maximum(uniform, drawn) > options.tolerance)),
                "predict_ms": milliseconds[method],
            }
        )
    renderer.release()
    rows = _patch_rows(scene, factors, errors, minimal, options.tolerance)
    return {"patches": rows, "summary": summary}


def _patch_rows(
    scene: Scene,
    factors: dict[str, Factors],
    errors: dict[str, tuple[np.ndarray, np.ndarray]],
    minimal: np.ndarray,
    tolerance: float,
) -> list[Row]:
    """``errors``: uniform and as drawn, by method."""
    certified, slefe = factors["certified"], factors["slefe"]
    return [
        {
            "scene": scene.name,
            "patch": k,
            "factor": float(certified.factor[k]),
            "inner_u": int(certified.inner[k, 0]),
            "inner_v": int(certified.inner[k, 1]),
            "minimal": int(minimal[k]),
            "sup_error_px": float(errors["certified"][0][k]),
            "drawn_sup_error_px": float(errors["certified"][1][k]),
            "slack_px": tolerance - float(max(e[k] for e in errors["certified"])),
            "slefe_factor": float(slefe.factor[k]),
            "slefe_sup_error_px": float(errors["slefe"][0][k]),
            "slefe_drawn_sup_error_px": float(errors["slefe"][1][k]),
        }
        for k in range(len(minimal))
    ]


def _sentences(summary: list[Row]) -> tuple[str, ...]:
    return tuple(
        f"{row['scene']}, {row['method']}: {row['triangles']:,} triangles ({row['uniform_triangles']:,} without shared"
        f" edges; minimal {row['minimal_triangles']:,}), largest error {row['sup_error_px']:.3g} px uniform and"
        f" {row['drawn_sup_error_px']:.3g} px as drawn, {row['patches_above']} of {row['patches']} patches above the"
        f" tolerance, {row['predict_ms']:.2g} ms"
        for row in summary
    )
