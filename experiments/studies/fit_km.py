"""Constants k_m fitted to measured minimal factors, and what one term more makes of the published estimate."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import jax
import numpy as np
import tyro

from slefejax import Camera, Scene, View, load, sampled_error, tessellation_factors
from slefejax.bounds.slefe_tables import basis_coefficients
from slefejax.bounds.widths import screen_twists, screen_widths
from slefejax.cameras import cameras_around
from slefejax.errors import InputError, naming
from slefejax.experiments.options import (
    FigureOptions,
    LoadOptions,
    Scenes,
    check_count,
    notes_of,
    parse_size,
)
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Row, Run, digest
from slefejax.experiments.studies.measures import Measure
from slefejax.experiments.studies.study import Case, Study
from slefejax.experiments.studies.times import taking_turns
from slefejax.figures.studies.fit_km import write_fit_km
from slefejax.study.curves import curve_constant, curve_ratios
from slefejax.study.fitting import ESTIMATORS, TEMPERATURE, Fit, bootstrap_km, cross_validated, fit_km, held_out
from slefejax.study.samples import TWIST, Samples, measure_factors, slefe_term

PUBLISHED = "1.5 … 1 [YBP14]; 1, √2 [YBP12]"
_WHY = "k_m is fitted to the width of slefes, which are of Bézier patches"
_CURVES, _PIECES = 20_000, 64
_UNSEEN = ("twisted-quad", "steep-patch")
_REPEATS = 7
_MOST_SEGMENTS = 64
_WORST = 8
_SHOWN = (
    "scene",
    "segments",
    "analytic_cubic",
    "largest",
    "quantile",
    "quantile_low",
    "quantile_high",
    "least-squares",
)
_SHOWN += ("largest_unsafe_share", "quantile_unsafe_share", "quantile_triangles", "samples", "published", "converged")


@dataclass(frozen=True)
class FitKm:
    """Measure minimal factors of all patches in many views, and fit the constants of the published estimate to them."""

    scenes: Scenes
    """Files (.obj, .usd…, .glb, …: the README lists them), or walker, teapot."""
    segments: tuple[int, ...] = (1, 2, 3, 4, 5, 6)
    """Numbers m of pieces for which k_m is fitted."""
    target: float = 0.99
    """Share of the samples (a patch in a view) that shall be safe; 1 for all."""
    cameras: int = 20
    """Cameras: the scene's own, and others on a sphere around it."""
    seed: int = 1
    """Seed of the other cameras, of the bootstrap and of random curves."""
    size: str = "1440x900"
    """Width x height of the picture in pixels."""
    tolerance: float = 0.5
    """Error in pixels that is allowed."""
    folds: int = 5
    """Into so many sets views are divided, of which each is held out once."""
    resamples: int = 400
    """Sets of views that the bootstrap draws."""
    temperature: float = TEMPERATURE
    """Of the smoothed pinball loss, in units of log(tau)."""
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Measure, fit, compare, draw."""
        self._check()
        scenes = _named([self.loading.bezier(name, _WHY) for name in self.scenes])
        inputs = {"scenes": [digest(scene.patches().tobytes()) for scene in scenes]}
        with Run("fit-km", {**asdict(self), "output": None}, self.output.out, inputs, self.output.pages(self)) as run:
            found = self._measure(run, scenes)
            together = [("all", Samples.joined([m.samples for m in found]))] if len(found) > 1 else []
            sets = [*((m.name, m.samples) for m in found), *together]
            cases = [(name, samples, m) for name, samples in sets for m in self.segments]
            with progress("fitting", len(cases)) as show:
                rows = []
                for case in cases:
                    rows.append(self._row(*case))
                    show(len(rows))
            curves = [self._curve_row(m) for m in self.segments]
            models = self._compare(found)
            worst = [row for m in found for row in _worst_rows(m, self.segments)]
            best = self._m
            points = [(m.name, m.samples.terms[slefe_term(best)], m.samples) for m in found]
            fits = [row for row in rows if row["scene"] == sets[-1][0]]
            write_fit_km(run.figure("fit_km"), points, fits, curves, models, best, self.target)
            _write_samples(run, found)
            names = " ".join(scene.name for scene in scenes)
            more = {"curves": curves, "models": models, "worst": worst}
            out = run.finish(
                rows,
                {"scene": names, **more, "samples": {m.name: len(m.samples) for m in found}, "notes": notes_of(scenes)},
            )
        title = (
            f"{names}: k_m for {100 * self.target:g} % of the patches at {self.tolerance:g} px, {self.cameras} views"
        )
        below = (
            (f"curves in one variable, {_CURVES:,} random cubics, {_PIECES} pieces: the largest ratio", curves),
            (f"models with m = {best}, in views that they were not fitted to, factors rounded up", models),
            ("where the estimate is furthest off: ratio of what is needed to it, and its twist over m² w", worst),
        )
        return Report(names, out, rows, title, notes_of(scenes), more, self.output.json, more=below, shown=_SHOWN)

    def _check(self) -> None:
        if not self.scenes or len(set(self.scenes)) < len(self.scenes):
            raise InputError("name at least one scene, a file or teapot, and none twice")
        if not self.segments or len(set(self.segments)) < len(self.segments):
            raise InputError("--segments needs at least one number, and none twice")
        for name, least in (("cameras", 2), ("folds", 2), ("resamples", 2), ("seed", 0)):
            check_count(f"--{name}", getattr(self, name), least)
        if not 1 <= min(self.segments) <= max(self.segments) <= _MOST_SEGMENTS:
            raise InputError(f"--segments are numbers from 1 to {_MOST_SEGMENTS}, not {self.segments}")
        if not 1e-9 <= self.temperature <= 1.0:
            raise InputError(f"--temperature must lie between 1e-9 and 1, not {self.temperature}")
        if not 0.0 < self.target <= 1.0:
            raise InputError(f"--target is a share, above 0 and at most 1, not {self.target}")

    @property
    def _m(self) -> int:
        """The m of the figure and of the comparison of models."""
        return 3 if 3 in self.segments else self.segments[0]

    def _measure(self, run: Run, scenes: list[Scene]) -> list[_Measured]:
        width, height = parse_size(self.size)
        views = {
            f"{index} {number}": (scene, view)
            for index, scene in enumerate(scenes)
            for number, view in enumerate(cameras_around(scene, width, height, self.cameras, self.seed))
        }

        def look(key: str) -> _Measured:
            scene, view = views[key]
            with naming(f"scene {scene.name!r}"):
                measured = _measured(scene, [view], self)
            np.savez(run.file(_part(key)), allow_pickle=False, **measured.samples.terms, **_columns(measured))
            return measured

        count = Measure(("samples",), lambda measured: {"samples": len(measured.samples)})
        cases = [Case(key, {"scene": scene.name}, partial(look, key)) for key, (scene, _) in views.items()]
        Study(cases, (count,), _part).rows(run, "measuring views")
        found = []
        for index, scene in enumerate(scenes):
            parts = [_read_part(run.file(_part(key)), self.tolerance) for key in views if key.startswith(f"{index} ")]
            joined = Samples.joined([samples for samples, _ in parts])
            # patches of one scene are the same in all of its views; views without any keep their number
            counted = np.concatenate([np.full(len(s), number) for number, (s, _) in enumerate(parts)])
            patch = np.concatenate([s.patch for s, _ in parts])
            samples = Samples(counted, patch, joined.minimal, joined.needed, joined.terms, joined.tolerance)
            certified = np.concatenate([factor for _, factor in parts])
            own = [view for key, (_, view) in views.items() if key.startswith(f"{index} ")]
            found.append(_Measured(scene.name, scene.patches(), own, samples, certified))
        for key in views:
            run.file(_part(key)).unlink()
        return found

    def _row(self, name: str, samples: Samples, m: int) -> Row:
        """All estimators, with intervals, and how each does in views that were held out."""
        row: Row = {"scene": name, "segments": m}
        count, every = 0, []
        for estimator in ESTIMATORS:
            options = {"target": self.target, "estimator": estimator, "temperature": self.temperature}
            fit = fit_km(samples, m, **options)
            interval = bootstrap_km(samples, m, **options, resamples=self.resamples, seed=self.seed)
            factors, fits = cross_validated(samples, self.folds, segments=m, **options)
            outcome = held_out(samples, factors)
            count, every = fit.samples, [*every, fit, *fits]
            row |= {
                estimator: fit.k,
                f"{estimator}_low": interval.low,
                f"{estimator}_high": interval.high,
                f"{estimator}_unsafe_share": outcome.share_unsafe,
                f"{estimator}_over_minimal_median": outcome.over_minimal_median,
                f"{estimator}_over_minimal_p95": outcome.over_minimal_p95,
                f"{estimator}_triangles": outcome.triangles_over_minimal,
            }
        analytic = {"analytic_cubic": curve_constant(3, m), "published": PUBLISHED}
        return {**row, **analytic, "samples": count, "converged": _said(every)}

    def _curve_row(self, m: int) -> Row:
        random = np.random.default_rng(self.seed).normal(size=(4, _CURVES))
        worst = np.array([float(c) for c in basis_coefficients(3, 1)])[:, None]
        analytic = curve_constant(3, m)
        of_random, of_worst = (float(curve_ratios(c, m, _PIECES).max()) for c in (random, worst))
        return {
            "segments": m,
            "k_random": of_random,
            "k_one_bend": of_worst,
            "analytic_cubic": analytic,
            "below_analytic_share": 1.0 - max(of_random, of_worst) / analytic,
        }

    def _compare(self, found: list[_Measured]) -> list[Row]:
        """The estimate, fitted, with a twist term, and the certified factor: on the scenes, and on others."""
        m, term = self._m, slefe_term(self._m)
        options = {"segments": m, "target": self.target, "temperature": self.temperature}
        fitted = {f"slefe, k_{m} fitted": (), "slefe and twist": (TWIST,)}
        rows = []
        for scene in found:
            plain = np.sqrt(np.maximum(1.0, scene.samples.terms[term]))
            factors = {"slefe, k = 1": (plain, [])}
            for name, more in fitted.items():
                factors[name] = cross_validated(scene.samples, self.folds, more=more, **options)
            factors["certified"] = (scene.certified, [])
            times = _times(scene, m, self.tolerance)
            for name, (factor, fits) in factors.items():
                rows.append({**_model_row(scene, name, factor, fits), "predict_ms": times[name.split(",")[0]]})
        whole = Samples.joined([scene.samples for scene in found])
        models = {name: fit_km(whole, more=more, **options) for name, more in fitted.items()}
        for other in _others(self):
            factors = {"slefe, k = 1": np.sqrt(np.maximum(1.0, other.samples.terms[term]))}
            factors |= {name: fit.factor(other.samples) for name, fit in models.items()}
            factors["certified"] = other.certified
            for name, factor in factors.items():
                fits = [models[name]] if name in models else []
                rows.append({**_model_row(other, name, factor, fits), "predict_ms": float("nan")})
        return rows


def _named(scenes: list[Scene]) -> list[Scene]:
    """With names of their own, where files in different folders have the same."""
    names = [scene.name for scene in scenes]
    return [
        replace(scene, name=f"{scene.name} ({names[:k].count(scene.name) + 1})")
        if names.count(scene.name) > 1
        else scene
        for k, scene in enumerate(scenes)
    ]


class _Measured(NamedTuple):
    """A scene in its views; certified: real factors of the samples."""

    name: str
    patches: np.ndarray
    views: list[View]
    samples: Samples
    certified: np.ndarray


def _measured(scene: Scene, views: list[View], options: FitKm) -> _Measured:
    patches = scene.patches()
    samples = measure_factors(patches, views, options.segments, options.tolerance)
    factors = [np.asarray(tessellation_factors(patches, v, tolerance=options.tolerance).factor) for v in views]
    return _Measured(scene.name, patches, views, samples, np.stack(factors)[samples.view, samples.patch])


def _others(options: FitKm) -> list[_Measured]:
    """Scenes that no model is fitted to: the ones where the estimate is known to fail, and random patches."""
    size = parse_size(options.size)
    scenes = [load(name) for name in _UNSEEN if name not in options.scenes]
    patches = np.random.default_rng(options.seed).normal(size=(200, 4, 4, 3))
    scenes.append(Scene("random patches", patches, Camera.look_at((2.0, -12.0, 4.0), (0.0, 0.0, 0.0))))
    found = [_measured(scene, [View(scene.default_camera(), *size)], options) for scene in scenes]
    return [one for one in found if np.any(one.samples.minimal > 1)]


def _model_row(scene: _Measured, name: str, factor: np.ndarray, fits: list[Fit]) -> Row:
    outcome = held_out(scene.samples, factor)
    coefficients = np.mean([fit.coefficients for fit in fits], axis=0) if fits else np.zeros(0)
    return {
        "scene": scene.name,
        "model": name,
        "k": float(np.sqrt(coefficients[0])) if len(coefficients) else float("nan"),
        "twist_coefficient": float(coefficients[1]) if len(coefficients) > 1 else float("nan"),
        "held_out_share_unsafe": outcome.share_unsafe,
        "max_error_px": _largest_error(scene, factor),
        "factor_over_minimal_median": outcome.over_minimal_median,
        "factor_over_minimal_p95": outcome.over_minimal_p95,
        "triangles_over_minimal": outcome.triangles_over_minimal,
        "converged": _said(fits),
    }


def _largest_error(scene: _Measured, factor: np.ndarray) -> float:
    """Over all samples, measured at factors rounded up: an error may grow again above the minimal factor."""
    largest, samples = 0.0, scene.samples
    if not np.isfinite(factor).all():
        return float("nan")
    levels = np.ceil(factor).astype(int)
    for number, view in enumerate(scene.views):
        own = samples.view == number
        if own.any():
            error = sampled_error(scene.patches[samples.patch[own]], levels[own], view)
            largest = max(largest, float(error.max()))
    return largest


def _times(scene: _Measured, m: int, tolerance: float) -> dict[str, float]:
    """Milliseconds that predictions of one view take once compiled; the methods take turns, medians."""
    patches, view = scene.patches, scene.views[0]
    calls: dict[str, Callable[[], object]] = {
        "slefe": lambda: tessellation_factors(patches, view, "slefe", segments=m, tolerance=tolerance).factor,
        "slefe and twist": lambda: (screen_widths(patches, view, m), screen_twists(patches, view)),
        "certified": lambda: tessellation_factors(patches, view, tolerance=tolerance).factor,
    }
    ready = {name: partial(_awaited, call) for name, call in calls.items()}
    for call in ready.values():
        call()
    return {name: median for name, (median, _) in taking_turns(ready, _REPEATS).items()}


def _awaited(call: Callable[[], object]) -> None:
    jax.block_until_ready(call())


def _worst_rows(scene: _Measured, segments: tuple[int, ...]) -> list[Row]:
    """The samples that need most over the estimate; each patch once."""
    m = 3 if 3 in segments else segments[0]
    samples = scene.samples
    slefe = samples.terms[slefe_term(m)]
    with np.errstate(divide="ignore"):
        ratio = np.where(samples.minimal > 1, samples.needed / np.sqrt(slefe), 0.0)
        twist = samples.terms[TWIST] / slefe
    rows: dict[int, Row] = {}
    for at in np.argsort(-ratio):
        if len(rows) == _WORST // 2:
            break
        patch = int(samples.patch[at])
        row = {"scene": scene.name, "patch": patch, "view": int(samples.view[at]), "minimal": int(samples.minimal[at])}
        rows.setdefault(patch, {**row, "needed_over_estimate": float(ratio[at]), "twist_over_slefe": float(twist[at])})
    return list(rows.values())


def _said(fits: list[Fit]) -> str:
    """Yes, or why not."""
    reasons = [fit.reason for fit in fits if not fit.converged]
    return reasons[0] if reasons else "yes"


def _part(key: str) -> str:
    """The file of one scene and view."""
    return f"samples_{key.replace(' ', '_')}.npz"


def _columns(measured: _Measured) -> dict[str, np.ndarray]:
    samples = measured.samples
    own = {name: getattr(samples, name) for name in ("patch", "minimal", "needed")}
    return {f"_{name}": values for name, values in {**own, "certified": measured.certified}.items()}


def _read_part(path: Path, tolerance: float) -> tuple[Samples, np.ndarray]:
    with np.load(path) as file:
        arrays = dict(file)
    patch, minimal, needed, certified = (arrays.pop(f"_{name}") for name in ("patch", "minimal", "needed", "certified"))
    return Samples(np.zeros(len(patch), int), patch, minimal, needed, arrays, tolerance), certified


def _write_samples(run: Run, found: list[_Measured]) -> None:
    """Everything that was measured, a file a scene, for whoever wants to fit something else."""
    for number, measured in enumerate(found):
        names = [*_columns(measured), *measured.samples.terms]
        values = [*_columns(measured).values(), *measured.samples.terms.values()]
        header = ",".join(["view", *(name.strip("_").replace(" ", "_") for name in names)])
        table = np.column_stack([measured.samples.view, *values])
        np.savetxt(run.file(f"samples_{number}_{measured.name}.csv"), table, "%.9g", ",", header=header, comments="")
