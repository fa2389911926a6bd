"""Error against run time: every rule for tessellation factors on the same scenes and cameras."""

from __future__ import annotations

import re
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field

import numpy as np
import tyro

from slefejax import Factors, Scene, View, minimal_factors, sampled_error, tessellation_factors, triangle_error
from slefejax.arguments import no_such
from slefejax.cameras import cameras_around
from slefejax.errors import InputError, naming
from slefejax.experiments.minimality import error_shares
from slefejax.experiments.options import (
    LoadOptions,
    OutputOptions,
    Scenes,
    check_count,
    columns_of,
    notes_of,
    own_modules,
    parse_size,
)
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Row, Run, digest
from slefejax.figures.error_image import write_error_image
from slefejax.figures.error_time import write_error_against_time, write_pixels_against_triangles, write_triangle_sizes
from slefejax.figures.side_by_side import write_side_by_side
from slefejax.gpu import GBuffer, Renderer, Triangles, open_device
from slefejax.measure.covering import covering_error
from slefejax.measure.error import drawn_error
from slefejax.predict.kernel import Method
from slefejax.predict.methods import Certified, Slefe, label_of, method_of
from slefejax.predict.rules import EdgeLength, Filip, Fixed, ScreenBox
from slefejax.tessellator.levels import HIGHEST_LEVEL, pieces, triangle_counts

AREAS = (0.5, 5.0, 10.0, 20.0)  # square pixels; the classes of [YBP12], section 7


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
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def values(self) -> dict[str, Method]:
        """The rules by name. Raises InputError for a name that there is not, or that stands there twice."""
        if len(set(self.methods)) < len(self.methods):
            raise InputError("--methods names a rule twice")
        with own_modules(*self.methods):
            return {name: METHODS.get(name) or _own(name) for name in self.methods or METHODS}

    def pictures(self) -> tuple[str, ...]:
        """Those whose error images are shown side by side."""
        return tuple(name for name in self.methods or PICTURES)[:_MOST_PICTURES]

    def run(self) -> Report:
        """Measure every view, tabulate, draw."""
        check_count("--cameras", self.cameras)
        check_count("--repeats", self.repeats)
        self.values()
        if not self.scenes:
            raise InputError("name at least one scene: a file, or teapot")
        scenes = [self.loading.load(name) for name in self.scenes]
        device = open_device()
        inputs = {"scenes": [digest(s.patches().tobytes()) for s in scenes], "opengl": device.renderer}
        views = {
            f"{index} {scene.name} {number}": (scene, view, number)
            for index, scene in enumerate(scenes)
            for number, view in enumerate(cameras_around(scene, *parse_size(self.size), self.cameras, self.seed))
        }
        with Run("error-time", {**asdict(self), "output": None}, self.output.out, inputs) as run:
            with progress("measuring", len(views)) as show:

                def measure(key: str) -> Row:
                    scene, view, camera = views[key]
                    first = run if key == next(iter(views)) else None
                    count = f"of {len(scene.patches()):,} minimal factors"
                    with naming(f"scene {scene.name!r}"):
                        seen = _View(scene, view, self, first, lambda n: show(detail=f"{n:,} {count}"))
                        return {"rows": seen.rows(camera)}

                found = run.each("view", list(views), measure, show)
            rows = [row for view in found for row in view["rows"]]
            write_error_against_time(run.file("error_against_time.png"), rows, self.tolerance)
            write_pixels_against_triangles(run.file("pixels_against_triangles.png"), rows, self.tolerance)
            write_triangle_sizes(run.file("triangle_sizes.png"), rows, AREAS)
            first = {row["method_name"]: row for row in found[0]["rows"]}
            panels = [(first[name], run.file(picture_name(name))) for name in self.pictures()]
            write_side_by_side(run.file("side_by_side.png"), panels, self.tolerance)
            names = " ".join(scene.name for scene in scenes)
            opengl = {"renderer": device.renderer, "version": device.version}
            out = run.finish(rows, {"scene": names, "notes": notes_of(scenes), "opengl": opengl})
        title = f"{names}: rules for tessellation factors at {self.tolerance:g} px, {len(views)} views of {self.size}"
        return Report(
            names, out, summary(rows), title, notes_of(scenes), extra={"table": rows}, as_json=self.output.json
        )


def _own(name: str) -> Method:
    if ":" not in name:
        raise InputError(no_such("rule", name, METHODS))
    return method_of(name)


def picture_name(method: str) -> str:
    """File name of the error image of a rule."""
    return f"error_{re.sub('[^a-zA-Z0-9.-]+', '_', method.replace('=', ''))}.png"


class _View:
    """All rules on one scene from one camera."""

    def __init__(
        self, scene: Scene, view: View, options: ErrorTime, run: Run | None, settled: Callable[[int], None]
    ) -> None:
        self.scene, self.view, self.options, self.run = scene, view, options, run
        self.methods = options.values()
        self.patches = scene.patches()
        self.renderer = Renderer(self.patches)
        self.minimal = minimal_factors(self.patches, view, options.tolerance, progress=settled)
        self.reference = self._finest(View(view.camera, 2 * view.width, 2 * view.height))

    def rows(self, camera: int) -> list[Row]:
        """A row for every rule; run times of rules that take turns."""
        compile_ms = {name: self._first_call(name) for name in self.methods}
        found = {name: self._predict(name) for name in self.methods}
        levels = {name: (factors.inner, factors.edges) for name, factors in found.items()}
        for inner, outer in levels.values():
            self.renderer.submit(self.view, inner, outer)
        times: dict[str, list[tuple[float, float]]] = {name: [] for name in self.methods}
        for _ in range(self.options.repeats):
            for name in self.methods:
                times[name].append(self._timed(name, *levels[name]))
        rows = []
        for name, method in self.methods.items():
            predict, render = (1e3 * np.array(t) for t in zip(*times[name], strict=True))
            rows.append(
                {
                    "scene": self.scene.name,
                    "camera": camera,
                    "method_name": name,
                    **columns_of(method),
                    **self._errors(name, found[name], *levels[name]),
                    "compile_ms": compile_ms[name],
                    "predict_ms": float(np.median(predict)),
                    "predict_spread_ms": float(np.ptp(predict)),
                    "render_ms": float(np.median(render)),
                    "render_spread_ms": float(np.ptp(render)),
                }
            )
        self.renderer.release()
        return rows

    def _finest(self, view: View) -> GBuffer:
        """Four samples a pixel of the scene, every patch cut as finely as is good for all of them."""
        finest = HIGHEST_LEVEL * int(pieces(self.minimal).max())
        levels = np.where(self.minimal[:, None] > 0, finest, np.zeros(6, int))
        return self.renderer.draw(view, levels[:, :2], levels[:, 2:])

    def _predict(self, name: str) -> Factors:
        return tessellation_factors(
            self.patches,
            self.view,
            self.methods[name],
            tolerance=self.options.tolerance,
            edge_numbers=self.scene.edge_numbers,
        )

    def _first_call(self, name: str) -> float:
        start = time.perf_counter()
        self._predict(name)
        first = time.perf_counter() - start
        start = time.perf_counter()
        self._predict(name)
        return 1e3 * max(0.0, first - (time.perf_counter() - start))

    def _timed(self, name: str, inner: np.ndarray, outer: np.ndarray) -> tuple[float, float]:
        start = time.perf_counter()
        self._predict(name)
        middle = time.perf_counter()
        self.renderer.submit(self.view, inner, outer)
        return middle - start, time.perf_counter() - middle

    def _errors(self, name: str, factors: Factors, inner: np.ndarray, outer: np.ndarray) -> Row:
        seen = self.renderer.draw(self.view, inner, outer)
        error = drawn_error(self.patches, self.view, seen)
        if self.run is not None and name in self.options.pictures():
            write_error_image(self.run.file(picture_name(name)), error)
        triangles = self.renderer.capture(self.view, inner, outer)
        there = self.minimal > 0
        ratio = factors.levels[there] / self.minimal[there]
        uniform = sampled_error(self.patches, inner, self.view)
        drawn = triangle_error(self.patches, triangles, self.view)
        return {
            "patches": len(self.patches),
            "triangles": int(triangle_counts(inner, outer).sum()),
            "minimal_triangles": int(2 * np.sum(self.minimal**2)),
            **error_shares(error, seen),
            "sup_error_px": float(uniform.max()),
            "drawn_sup_error_px": float(drawn.max()),
            **ring_effect(uniform[there], drawn[there], self.options.tolerance),
            "factor_over_minimal_median": float(np.median(ratio)),
            "factor_over_minimal_p95": float(np.quantile(ratio, 0.95)),
            **covering_error(seen, self.reference).summary(),
            **area_shares(triangles, self.view),
        }


def ring_effect(uniform: np.ndarray, drawn: np.ndarray, tolerance: float) -> Row:
    """What the rule for shared edges does to patches: their errors as uniform grids, and as they are drawn.

    Shares of the patches that got worse by more than 1 %, and that were within the tolerance and are no more; and the
    largest ratio, over patches that err by more than a hundredth of a pixel.
    """
    noticed = uniform > 0.01
    return {
        "share_worse_by_rings": float(np.mean(drawn > 1.01 * uniform)),
        "share_unsafe_by_rings": float(np.mean((uniform <= tolerance) & (drawn > tolerance))),
        "largest_ring_ratio": float(np.max(drawn[noticed] / uniform[noticed], initial=1.0)),
    }


def area_shares(triangles: Triangles, view: View) -> Row:
    """Shares of the triangles in front of the camera whose area on the screen is below each of ``AREAS``."""
    clip = triangles.clip.astype(np.float64)
    clip = clip[np.all(clip[..., 3] > 0, axis=1)]
    corners = clip[..., :2] / clip[..., 3:] * np.array([view.width / 2, view.height / 2])
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    area = 0.5 * np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    return {f"share_area_below_{limit:g}": float(np.mean(area < limit)) if len(area) else 0.0 for limit in AREAS}


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
    worst = ("sup_error_px", "drawn_sup_error_px", "max_error_px", "slipped_pixels", "max_slip_px")
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
