"""The cost model of a frame: ms = k + c0 patches + c1 triangles + c2 shaded pixels ([YBP12], (11)), fitted."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field
from itertools import product

import jax.numpy as jnp
import numpy as np
import tyro

from slefejax import Camera, Scene, View, tessellation_factors
from slefejax.bounds.tiles import restrict_to_tiles
from slefejax.errors import InputError
from slefejax.experiments.options import FigureOptions, LoadOptions, check_count, parse_size
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Row, Run, digest
from slefejax.figures.bench.scaling import write_scaling
from slefejax.gpu import Renderer, open_device
from slefejax.tessellator.levels import HIGHEST_LEVEL, triangle_counts

_WHY = "patches are split here, and parts of Gregory patches are none"
TERMS = ("patches", "triangles", "shaded_pixels")
SPLITS = (1, 2, 3, 4)  # each patch into s x s, cut less finely by as much, so that the triangles stay
SCALES = (0.5, 1.0, 1.5, 2.0)
CLEAR = 2.0  # standard errors that a cost must be above zero to be told apart from none
ZOOMS = (0.5, 0.75, 1.0, 1.35)  # of the picture: the cover


@dataclass(frozen=True)
class Scaling:
    """Vary patches (by splitting), triangles (by scaling) and pixels (by cover), and fit the cost of each."""

    scene: tyro.conf.Positional[str]
    """A file (.obj, .usd…, .glb, …: the README lists them), or walker, teapot, twisted-quad, steep-patch."""
    size: str = "1440x900"
    """Width x height of the picture in pixels."""
    repeats: int = 9
    """Draws whose median is a time."""
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Measure all combinations, fit, draw."""
        check_count("--repeats", self.repeats)
        scene, size = self.loading.bezier(self.scene, _WHY), parse_size(self.size)
        device = open_device()
        inputs = {"scene": digest(scene.patches().tobytes()), "opengl": device.renderer}
        cases = [f"{s}x{s} parts, scale {m:g}, zoom {z:g}" for s, m, z in product(SPLITS, SCALES, ZOOMS)]
        settings = dict(zip(cases, product(SPLITS, SCALES, ZOOMS), strict=True))
        with Run("scaling", {**asdict(self), "output": None}, self.output.out, inputs, self.output.pages(self)) as run:
            bench = _Bench(scene, size, self.repeats)
            with progress("drawing", len(cases)) as show:
                measured = run.each("case", cases, lambda case: bench.row(*settings[case]), show)
            rows, fit = fit_costs(measured)
            write_scaling(run.figure("scaling"), measured, rows, fit["r_squared"], device.renderer, scene.name)
            notes = (*scene.notes, *undetermined(rows))
            record = {
                "scene": scene.name,
                "notes": notes,
                "opengl": {"renderer": device.renderer},
                **fit,
                "coefficients": rows,
            }
            out = run.finish(measured, record)
        title = f"{scene.name}: cost of a frame at {self.size} on {device.renderer}, R² = {fit['r_squared']:.4f}"
        return Report(scene.name, out, rows, title, notes, {**fit, "measured": measured}, self.output.json)


class _Bench:
    """Draws a scene with its patches split, its factors scaled, its picture zoomed."""

    def __init__(self, scene: Scene, size: tuple[int, int], repeats: int) -> None:
        self.scene, self.size, self.repeats = scene, size, repeats
        self._renderers: dict[int, Renderer] = {}
        self._whole = tessellation_factors(scene.patches(), self._view(1.0)).levels

    def _view(self, zoom: float) -> View:
        own = self.scene.default_camera(aspect=self.size[0] / self.size[1])
        fov = 2.0 * np.rad2deg(np.arctan(np.tan(np.deg2rad(own.extent / 2.0)) / zoom))
        return View(Camera.look_at(own.eye, own.target, own.up, fov, own.near, own.far), *self.size)

    def row(self, parts: int, scale: float, zoom: float) -> Row:
        """What was drawn, and how long it took (median, milliseconds)."""
        if parts not in self._renderers:
            self._renderers[parts] = Renderer(split(self.scene.patches(), parts))
        renderer, view = self._renderers[parts], self._view(zoom)
        levels = np.clip(np.rint(self._whole * scale / parts).astype(int), 1, HIGHEST_LEVEL)
        levels = np.repeat(np.where(self._whole > 0, levels, 0), parts * parts)
        inner, outer = np.repeat(levels[:, None], 2, axis=1), np.repeat(levels[:, None], 4, axis=1)
        covered = int(np.count_nonzero(renderer.draw(view, inner, outer).patch >= 0))
        seconds = []
        for _ in range(self.repeats):
            start = time.perf_counter()
            renderer.submit(view, inner, outer)
            seconds.append(time.perf_counter() - start)
        return {
            "patches": int(np.count_nonzero(levels)),
            "triangles": int(triangle_counts(inner, outer).sum()),
            "shaded_pixels": covered,
            "render_ms": 1e3 * float(np.median(seconds)),
        }


def split(patches: np.ndarray, parts: int) -> np.ndarray:
    """Every patch as parts x parts patches of the same surface, in order."""
    control = restrict_to_tiles(jnp.moveaxis(jnp.asarray(patches), 0, -1), (parts, parts))
    own = np.moveaxis(np.asarray(control), (5, 3, 4), (0, 1, 2))
    return own.reshape(-1, *patches.shape[1:])


def fit_costs(measured: list[Row]) -> tuple[list[Row], dict[str, float]]:
    """Least squares of [YBP12], (11): a row a term with its standard error, and R² and the residuals.

    Raises InputError if the measurements do not tell the terms apart.
    """
    terms = np.array([[1.0, *(row[name] for name in TERMS)] for row in measured])
    times = np.array([row["render_ms"] for row in measured])
    scale = np.max(np.abs(terms), axis=0)
    if len(measured) <= terms.shape[1] or np.linalg.matrix_rank(terms / scale) < terms.shape[1]:
        raise InputError("the measurements do not vary enough to tell patches, triangles and pixels apart")
    cost, *_ = np.linalg.lstsq(terms / scale, times, rcond=None)
    residual = times - (terms / scale) @ cost
    variance = float(residual @ residual) / (len(times) - terms.shape[1])
    error = np.sqrt(variance * np.diag(np.linalg.inv((terms / scale).T @ (terms / scale))))
    rows = [
        {
            "term": name,
            "us_each": float(1e3 * c / s),
            "standard_error_us": float(1e3 * e / s),
            "standard_error_share": float(e / abs(c)),
            "largest_ms": float(c),
        }
        for name, c, e, s in zip(("frame", *TERMS), cost, error, scale, strict=True)
    ]
    spread = float(np.sum((times - times.mean()) ** 2))
    fit = {
        "r_squared": 1.0 - float(residual @ residual) / spread,
        "residual_ms": float(np.sqrt(np.mean(residual**2))),
        "largest_residual_share": float(np.max(np.abs(residual) / times)),
    }
    return rows, fit


def undetermined(rows: list[Row]) -> tuple[str, ...]:
    """A sentence on the costs that the measurements do not tell from zero, with their standard errors."""
    loose = [row for row in rows if not row["us_each"] > CLEAR * row["standard_error_us"]]
    if not loose:
        return ()
    costs = ", ".join(
        f"{row['term'].replace('_', ' ')} {row['us_each']:.4g} ± {row['standard_error_us']:.3g} µs" for row in loose
    )
    return (
        f"these costs are not determined, being less than {CLEAR:g} standard errors above zero (a negative one is"
        f" noise): {costs}; more --repeats on a machine that does nothing else narrow them down",
    )
