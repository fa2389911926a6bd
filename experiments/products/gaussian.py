"""Gaussian products: fixed levels as published beside certified ones, in error, triangles and time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np
import tyro

from slefejax import Factors, Scene, View, convert, limit_distance, tessellation_factors
from slefejax.arguments import check_positive, is_whole
from slefejax.conversion.gaussian.products import check_spread
from slefejax.conversion.gaussian.published import DEEPEST, Published, published
from slefejax.errors import InputError
from slefejax.experiments.checks.mirror import reflections
from slefejax.experiments.options import FigureOptions, LoadOptions, ViewOptions, camera_record
from slefejax.experiments.products.feature import compared
from slefejax.experiments.products.nested import NestedLook
from slefejax.experiments.products.pictures import shaded, with_ellipsoids
from slefejax.experiments.products.recursive import Recursive
from slefejax.experiments.products.spreads import ORIENTATIONS, median_condition, spread
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Row, Run, digest
from slefejax.experiments.studies.look import Look, Shown
from slefejax.experiments.studies.measures import over_minimal, pixels, size
from slefejax.experiments.studies.times import milliseconds
from slefejax.figures.checks.limit import Pictures, write_reflection_figure
from slefejax.figures.error_image import write_error_image
from slefejax.figures.products.feature import write_feature
from slefejax.figures.products.gaussian import write_differences, write_levels, write_surface
from slefejax.gpu import Device, GBuffer, Renderer, open_device
from slefejax.model.mesh import Mesh

LEVELS = (1, 2, 3, 4, 5, 6)
_REPEATS = 3
_MOST_TRIANGLES = 4_000_000  # of which the largest error is looked for over the whole domain
_MOST_DRAWN = 60_000_000
OWN = "own"
_COLUMNS = (
    "scene",
    "orientation",
    "condition",
    "method",
    "level",
    "patches",
    "triangles",
    "max_error_px",
    "share_above_0.5",
    "sup_error_px",
    "factor_over_minimal_median",
    "factor_over_minimal_p95",
    "limit_max_px",
    "prepare_ms",
    "predict_ms",
    "render_ms",
    "kilobytes",
)
_SHOWN = (
    "orientation",
    "condition",
    "method",
    "level",
    "triangles",
    "max_error_px",
    "sup_error_px",
    "factor_over_minimal_median",
    "factor_over_minimal_p95",
    "limit_max_px",
    "prepare_ms",
    "render_ms",
)


class _Case(NamedTuple):
    """Covariances, and what is made of them."""

    orientation: str
    condition: float
    method: str
    level: int

    def name(self) -> str:
        return f"{self.orientation}_{self.condition:.9g}_{self.method}_{self.level}"


@dataclass(frozen=True)
class GaussianOfScene:
    """Gaussian products as published, fixed levels solved in single precision, beside certified rational patches.

    Every published level is compared with the same surface in double precision, certified ones with their patches; how
    far these are from the limit surface is told beside.
    """

    scene: tyro.conf.Positional[str]
    """A file with a control mesh (.obj, .ply, …), ring or walker; covariances are inferred where there are none."""
    levels: tuple[int, ...] = LEVELS
    """Published levels: 2^level segments along a face, 1 to 6."""
    conditions: tuple[float, ...] = (1.0, 1e2, 1e4, 1e6, 1e8)
    """Condition numbers of covariances that are tried besides the scene's own, in several orientations."""
    level: int = 5
    """The published level that they are drawn with."""
    feature: bool = False
    """Make one feature, the rounded edges of a cube, by covariances, by creases and by edge loops, too."""
    depth: int = DEEPEST
    """Nested levels around irregular vertices of the published method, 1 to 10."""
    tolerance: float = 0.5
    """Error in pixels that certified levels keep."""
    camera: tyro.conf.OmitArgPrefixes[ViewOptions] = field(default_factory=ViewOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Measure, tabulate, draw."""
        self._check()
        scene, notes = self._scene()
        view = self.camera.view(scene)
        device = open_device()
        bench = _Bench(self, scene, view, device)
        arguments = {**asdict(self), "output": None, "camera": camera_record(view)}
        assert scene.conversion is not None
        inputs = {"scene": digest(scene.patches().tobytes()), "opengl": device.renderer}
        with Run("gaussian", arguments, self.output.out, inputs, self.output.pages(self)) as run:
            cases = {case.name(): case for case in self._cases(bench.condition)}
            with progress("measuring", len(cases)) as show:
                kept = run.each("case", list(cases), lambda name: bench.row(run, cases[name]), show)
            found = notes + tuple(dict.fromkeys(row["_note"] for row in kept if row["_note"])) + bench.price()
            rows = [{name: row[name] for name in _COLUMNS} for row in kept]
            self._draw(run, bench, kept)
            feature = compared(tolerance=self.tolerance) if self.feature else []
            if feature:
                write_feature(run.figure("rounded_edges"), feature)
            record = {"scene": scene.name, "notes": found, "opengl": {"renderer": device.renderer}, "feature": feature}
            out = run.finish(rows, record)
        title = f"{scene.name}: Gaussian products, fixed levels as published and certified ones"
        more = (("one feature, three ways", feature),) if feature else ()
        extra = {"feature": feature}
        return Report(scene.name, out, rows, title, found, extra, self.output.json, more=more, shown=_SHOWN)

    def _check(self) -> None:
        for name, values in (("levels", self.levels), ("level", (self.level,))):
            if not values or not all(is_whole(n, 1) and n <= LEVELS[-1] for n in values):
                raise InputError(f"--{name} must be whole numbers from 1 to {LEVELS[-1]}, not {values}")
        if not (is_whole(self.depth, 1) and self.depth <= DEEPEST):
            raise InputError(f"--depth must be a whole number from 1 to {DEEPEST}, not {self.depth}")
        for condition in self.conditions:
            if not (np.isfinite(condition) and condition >= 1):
                raise InputError(f"--conditions must be finite numbers from 1 on, not {condition}")
        check_positive("tolerance", self.tolerance)

    def _scene(self) -> tuple[Scene, tuple[str, ...]]:
        """With its own covariances, or those that its mesh suggests."""
        if self.loading.scheme not in ("auto", "gaussian"):
            raise InputError("this study is of Gaussian products: leave --scheme out", options=("scheme",))
        found = self.loading.load(self.scene)
        if found.conversion is None:
            raise InputError(f"{found.name} has no control mesh, and Gaussians belong to the vertices of one")
        if found.conversion.scheme == "gaussian":
            return found, found.notes
        found = replace(self.loading, scheme="gaussian", gaussians="infer").load(self.scene)
        return found, (*found.notes, "covariances are inferred from the control mesh")

    def _cases(self, own: float) -> list[_Case]:
        """The scene's own covariances at all levels, and others at one."""
        found = [_Case(OWN, own, "certified", 0)]
        found += [_Case(OWN, own, method, level) for method in ("published", "recursive") for level in self.levels]
        for condition in self.conditions:
            for orientation in ORIENTATIONS[: None if condition > 1 else 1]:
                found += [_Case(orientation, condition, "certified", 0)]
                found += [_Case(orientation, condition, "published", self.level)]
        return found

    def _draw(self, run: Run, bench: _Bench, rows: list[Row]) -> None:
        write_levels(
            run.figure("levels_compared"), [row for row in rows if row["orientation"] == OWN], bench.scene.name
        )
        write_differences(run.figure("errors_over_anisotropy"), rows, lambda row: run.file(f"error_{row['case']}.png"))
        view, scene = bench.view, bench.scene
        assert scene.conversion is not None
        mesh = scene.conversion.mesh
        picture = shaded(scene.patches(), view, bench.seen())
        write_surface(run.figure("gaussians"), picture, with_ellipsoids(mesh, view), scene.name)
        stripes = list(reflections([scene]))
        if stripes:
            write_reflection_figure(
                run.figure("reflections"), Pictures(stripes, ["certified patches", "limit surface"], scene.name)
            )


class _Bench:
    """Draws and measures cases of one mesh in one view."""

    def __init__(self, options: GaussianOfScene, scene: Scene, view: View, device: Device) -> None:
        self.options, self.scene, self.view, self._device = options, scene, view, device
        assert scene.conversion is not None
        self.mesh = scene.conversion.mesh
        self._made: dict[tuple[str, float], tuple[Published, float]] = {}
        own = options.loading.steps or 0
        self._steps = max(own, int((self.mesh.sizes != 4).any()))

    @cached_property
    def condition(self) -> float:
        """Median of the scene's own covariances."""
        assert self.mesh.covariances is not None
        return median_condition(self.mesh.covariances)

    def row(self, run: Run, case: _Case) -> Row:
        """A row; with a note where the method refuses the case, or stops short of it."""
        found: Row = {"scene": self.scene.name, **case._asdict()}
        empty = dict.fromkeys(_COLUMNS[5:], float("nan"))
        mesh = self._mesh(case)
        take: Callable[..., Row] = {
            "certified": self._certified,
            "published": self._published,
            "recursive": self._recursive,
        }[case.method]
        try:
            found |= {**empty, **take(run, case, mesh), "_note": ""}
        except InputError as error:
            said = f"{case.method}, {case.orientation}, condition {case.condition:.3g}: {error}"
            found |= {**empty, "_note": said}
        return found

    def _mesh(self, case: _Case) -> Mesh:
        if case.orientation == OWN:
            return self.mesh
        return replace(self.mesh, covariances=spread(self.mesh, case.orientation, case.condition))

    def _published(self, run: Run, case: _Case, mesh: Mesh) -> Row:
        surface, prepare = self._surface(case[:2], mesh)
        renderer = Renderer(surface.nets, self._device)
        look = NestedLook.of(surface, self.view, renderer, case.level)
        found = self._drawn(run, case, look)
        largest = float(np.nanmax([look.largest, found.get("max_error_px", np.nan)]))  # both are samples of it
        found |= {"prepare_ms": prepare, "sup_error_px": largest, "kilobytes": surface.nets.nbytes / 1024}
        renderer.release()
        return found

    def _surface(self, spread: tuple[str, float], mesh: Mesh) -> tuple[Published, float]:
        """What all levels draw of a mesh, and in how many milliseconds it was made; the last one is kept."""
        if spread not in self._made:
            kept: list[Published] = []
            prepare = milliseconds(lambda: kept.append(published(mesh, self.options.depth, self._steps)))
            self._made = {spread: (kept[0], prepare)}
        return self._made[spread]

    def _certified(self, run: Run, case: _Case, mesh: Mesh) -> Row:
        kept: list[Scene] = []
        prepare = milliseconds(lambda: kept.append(self._as_scene(mesh)))
        scene = kept[0]
        shown = Shown(scene, self.view, self.options.tolerance)
        look = shown.drawn(self._factors(scene))
        triangles = size(look)["triangles"]
        if triangles > _MOST_DRAWN:
            raise InputError(f"the tolerance takes {triangles:,} triangles, too many to be drawn here")
        found = self._drawn(run, case, look)
        found |= {
            "level": int(max(look.inner.max(), look.outer.max())),
            "prepare_ms": prepare,
            "predict_ms": _median(lambda: self._factors(scene)),
            "sup_error_px": float(look.worst.max()) if triangles <= _MOST_TRIANGLES else float("nan"),
            "kilobytes": 4 * scene.patches().size / 1024,
        }
        if case.orientation == OWN:
            found |= {**over_minimal(look), "limit_max_px": limit_distance(scene, self.view).pixels}
        shown.release()
        return found

    def _as_scene(self, mesh: Mesh) -> Scene:
        loading = self.options.loading
        conversion = convert(mesh, "gaussian", loading.alpha, loading.steps)
        control = conversion.patchwork.on_host(conversion.control)
        check_spread(control, mesh, conversion.patchwork.faces, loading.allow_thin)
        return Scene(self.scene.name, control, conversion=conversion)

    def _drawn(self, run: Run, case: _Case, look: Look) -> Row:
        """Milliseconds to draw, errors of pixels, and the picture of these."""
        found = {"render_ms": look.render_ms, **size(look)}
        if (look.seen.patch >= 0).any():
            errors = pixels(look)
            found |= {name: errors[name] for name in ("max_error_px", "share_above_0.5")}
        title = f"{self.scene.name}: Gaussian products, {case.method}, covariances {case.orientation}"
        title += f" with condition {case.condition:.3g}" + f", at most level {case.level}" * (case.level > 0)
        write_error_image(run.file(f"error_{case.name()}.png"), look.error, title)
        return found

    def _recursive(self, _: Run, case: _Case, mesh: Mesh) -> Row:
        kept: list[Recursive] = []
        prepare = milliseconds(lambda: kept.append(Recursive(mesh, self._steps + case.level)))
        seconds = _median(kept[0].vertices)
        quads = kept[0].quads
        return {"patches": quads, "triangles": 2 * quads, "prepare_ms": prepare, "render_ms": seconds}

    def seen(self) -> GBuffer:
        """The scene's own surface, at certified levels."""
        shown = Shown(self.scene, self.view, self.options.tolerance)
        found = shown.drawn(self._factors(self.scene)).seen
        shown.release()
        return found

    def _factors(self, scene: Scene) -> Factors:
        edges, tolerance = scene.edge_numbers, self.options.tolerance
        return tessellation_factors(scene.patches(), self.view, tolerance=tolerance, edge_numbers=edges)

    def price(self) -> tuple[str, ...]:
        """A sentence on what irregular vertices cost the published method."""
        try:
            surface, _ = self._surface((OWN, self.condition), self.mesh)
        except InputError:
            return ()
        nested = surface.nets.nested
        if not nested.any() or nested.all():
            return ()
        renderer = Renderer(surface.nets, self._device)
        look = NestedLook.of(surface, self.view, renderer, self.options.level)
        each = []
        for own in (nested, ~nested):
            inner, outer = look.inner * own[:, None], look.outer * own[:, None]
            renderer.submit(self.view, inner, outer)
            each.append(_median(lambda i=inner, o=outer: renderer.submit(self.view, i, o)) / own.sum())
        renderer.release()
        memory = 1.0 - (~nested).sum() / len(surface.nets.nets)
        return (
            f"published: {nested.sum():,} of {len(nested):,} quarters are at irregular vertices; they have"
            f" {100 * memory:.0f} % of the memory, and take {each[0] / each[1]:.2f} times as long to draw",
        )


def _median(work: Callable[[], object]) -> float:
    """Milliseconds, of some repeats."""
    return float(np.median([milliseconds(work) for _ in range(_REPEATS)]))
