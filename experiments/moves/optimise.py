"""Do gradients save triangles? Inner control points are moved, and what that does is measured in other views."""

from __future__ import annotations

import time
from dataclasses import asdict, dataclass, field, replace

import numpy as np
import tyro

from slefejax import Scene, View, fewer_triangles, sampled_error, save, tessellation_factors
from slefejax.cameras import cameras_around
from slefejax.errors import InputError
from slefejax.experiments.moves.outlines import outlines
from slefejax.experiments.options import (
    FigureOptions,
    LoadOptions,
    PredictionOptions,
    check_count,
    parse_size,
)
from slefejax.experiments.report import Report, progress
from slefejax.experiments.shading import unclaimed
from slefejax.experiments.store import Row, Run, digest
from slefejax.experiments.tables import write_csv
from slefejax.figures.moves.optimise import write_optimise
from slefejax.geometry.view import bounding_sphere, homogeneous
from slefejax.measure.jumps import edge_turns
from slefejax.predict.methods import Options
from slefejax.study.deviation import surface_distance
from slefejax.study.relaxing import Descent, Relaxed
from slefejax.tessellator.levels import triangle_counts

_FINE = 65  # places along each side where the distance is measured at last
_LISTED = 10
_WHY = "inner control points are moved patch by patch here, and Gregory patches would no longer join smoothly"
_KEPT = 10  # steps after which what was reached is written down


@dataclass(frozen=True)
class Optimise:
    """Move inner control points of patches so that fewer triangles are needed and the surface hardly changes."""

    scene: tyro.conf.Positional[str]
    """A file (.obj, .usd…, .glb, …: the README lists them), or walker, teapot, twisted-quad, steep-patch."""
    within: float = 0.002
    """How far the surface may move: a share of the scene's radius."""
    turn: float = 1.0
    """By how many degrees tangent planes may turn along the sides of a patch."""
    cameras: int = 16
    """Views around the scene: every other one is optimised for, the others are held out."""
    solver_steps: int = 200
    """At most, for each of its two passes."""
    seed: int = 0
    """Of the cameras."""
    size: str = "1440x900"
    """Width x height of the picture in pixels."""
    prediction: tyro.conf.OmitArgPrefixes[PredictionOptions] = field(default_factory=PredictionOptions)
    loading: tyro.conf.OmitArgPrefixes[LoadOptions] = field(default_factory=LoadOptions)
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Move, measure, write, draw."""
        check_count("--cameras", self.cameras, 2)
        check_count("--seed", self.seed, 0)
        if not (np.isfinite(self.within) and self.within > 0):
            raise InputError(f"--within is a share of the radius, a positive number, not {self.within}")
        scene = self.loading.bezier(self.scene, _WHY)
        _, radius = bounding_sphere(scene.points())
        views = cameras_around(scene, *parse_size(self.size), self.cameras, self.seed)
        inputs = {"patches": digest(scene.patches().tobytes())}
        options, allowed = self.prediction.arguments(), self.within * radius
        with Run("optimise", {**asdict(self), "output": None}, self.output.out, inputs, self.output.pages(self)) as run:
            start = time.perf_counter()
            found = self._move(run, scene, views[::2], allowed, options)
            seconds = time.perf_counter() - start
            changed = replace(scene, control=found.patches)
            sets = {"optimised for": views[::2], "held out": views[1::2]}
            counts = {
                name: (_counts(scene, own, options), _counts(changed, own, options)) for name, own in sets.items()
            }
            rows = [_row(name, scene, changed, sets[name], counts[name], options) for name in sets]
            surface = _surface_row(scene, found, allowed, views)
            patches = _patch_rows(found, counts)
            save(changed, run.file("optimised.bpt"))
            write_csv(run.file("patches.csv"), patches)
            whole = {name: tuple(one.sum(axis=0) for one in pair) for name, pair in counts.items()}
            shown = replace(scene, control=found.patches, conversion=None)
            write_optimise(run.figure("optimise"), outlines(shown, views[0]), whole, scene.control.shape, scene.name)
            out = run.finish(rows, {"scene": scene.name, "surface": surface, "seconds": seconds})
        notes = (*scene.notes, *([f"The solver stopped early: {found.reason}."] if found.reason else []))
        notes += _stayed(found)
        notes += _unclaimed(scene, views, options)
        title = f"{scene.name}: triangles before and after, the surface within {self.within:.3g} of the radius"
        moved = [row for row, moves in zip(patches, found.moved, strict=True) if moves]
        best = sorted(moved, key=lambda row: row["held_out_after"] - row["held_out_before"])[:_LISTED]
        more = {"surface": surface, "patches": patches, "seconds": seconds}
        below = (("patches that save the most in views that were held out", best),)
        if moved:
            below = (("the surface", [surface]), *below)
        return Report(scene.name, out, rows, title, notes, more, self.output.json, more=below)

    def _move(self, run: Run, scene: Scene, views: list[View], allowed: float, options: Options) -> Relaxed:
        """From where a run that was stopped had got."""
        kept, start = run.file("so_far.npz"), None
        if kept.exists():
            with np.load(kept) as file:
                memory = tuple(file[f"memory_{k}"] for k in range(len(file.files) - 3))
                start = Descent(file["offsets"], int(file["weight"]), int(file["steps"]), memory)
        with progress("moving control points", 100) as show:

            def keep(at: Descent) -> None:
                if at.steps % _KEPT == 0:
                    numbers = {"offsets": at.offsets, "weight": at.weight, "steps": at.steps}
                    memory = {f"memory_{k}": array for k, array in enumerate(at.memory)}
                    with (part := run.file("part.npz")).open("wb") as file:
                        np.savez(file, allow_pickle=False, **numbers, **memory)
                    part.replace(kept)
                show(round(100 * at.share(self.solver_steps)))

            found = fewer_triangles(
                scene.patches(),
                views,
                allowed,
                self.turn,
                steps=self.solver_steps,
                start=start,
                progress=keep,
                **options,
            )
        kept.unlink(missing_ok=True)
        return found


def _counts(scene: Scene, views: list[View], options: Options) -> np.ndarray:
    """Triangles of patches, ``(views, patches)``, without rounding."""
    factors = [np.asarray(tessellation_factors(scene.patches(), view, **options).factor) for view in views]
    return 2.0 * np.square(factors)


def _unclaimed(scene: Scene, views: list[View], options: Options) -> tuple[str, ...]:
    """What to say of patches whose normals have no claim, in whatever view they are seen."""
    if options.get("normal_tolerance") is None:
        return ()
    found = [tessellation_factors(scene.patches(), view, **options).without_normal for view in views]
    return unclaimed(np.any(np.stack([np.asarray(own) for own in found]), axis=0))


def _row(
    name: str,
    scene: Scene,
    changed: Scene,
    views: list[View],
    counts: tuple[np.ndarray, np.ndarray],
    options: Options,
) -> Row:
    before, after = (float(count.sum()) for count in counts)
    drawn, error = zip(*(_drawn(one, views, options) for one in (scene, changed)), strict=True)
    each = 1.0 - counts[1].sum(axis=1) / np.maximum(counts[0].sum(axis=1), 1.0)
    return {
        "views": name,
        "count": len(views),
        "before": before,
        "after": after,
        "fewer_share": 1.0 - after / before if before else float("nan"),
        "least_share": float(each.min()),
        "most_share": float(each.max()),
        "drawn_before": drawn[0],
        "drawn_after": drawn[1],
        "error_before_px": error[0],
        "error_after_px": error[1],
    }


def _drawn(scene: Scene, views: list[View], options: Options) -> tuple[int, float]:
    """Triangles with shared edges and transition rings, and the largest error of uniform grids; sums over views."""
    triangles, error = 0, 0.0
    for view in views:
        factors = tessellation_factors(scene.patches(), view, edge_numbers=scene.edge_numbers, **options)
        triangles += int(triangle_counts(factors.inner, factors.edges).sum())
        error = max(error, float(sampled_error(scene.patches(), factors.inner, view).max()))
    return triangles, error


def _surface_row(scene: Scene, found: Relaxed, allowed: float, views: list[View]) -> Row:
    """What happened to the surface: measured from either side, at places that the search did not look at."""
    given = scene.patches()
    there, back = (surface_distance(*pair, places=_FINE) for pair in ((found.patches, given), (given, found.patches)))
    before, after = (edge_turns(patches, scene.edge_numbers) for patches in (given, found.patches))
    moved = np.linalg.norm(found.patches - given, axis=-1)
    return {
        "moved_patches": int(np.count_nonzero(found.moved)),
        "allowed_distance": allowed,
        "largest_distance": float(there.max()),
        "largest_distance_back": float(back.max()),
        "largest_distance_px": max(_pixels(view, given, there.max()) for view in views),
        "control_points_moved_by": float(moved.max()),
        "largest_turn_degrees": float(found.turn.max()),
        "turn_at_edges_before_degrees": float(before.max(initial=0.0)),
        "turn_at_edges_after_degrees": float(after.max(initial=0.0)),
        "turn_at_edges_after_median": float(np.median(after)) if len(after) else 0.0,
    }


def _pixels(view: View, patches: np.ndarray, distance: float) -> float:
    """The most pixels that a small distance can be at the control points of patches, along x or y."""
    matrix = np.asarray(view.world_to_screen)
    screen = homogeneous(patches.reshape(-1, 3)) @ matrix.T
    front = screen[screen[:, 3] > 0]
    slopes = (matrix[None, :2, :3] - (front[:, :2] / front[:, 3:])[..., None] * matrix[3, :3]) / front[:, 3:, None]
    return float(distance * np.linalg.norm(slopes, axis=-1).max(initial=0.0))


def _stayed(found: Relaxed) -> tuple[str, ...]:
    """What did not move, and is left out of the tables in the terminal."""
    count, still = len(found.moved), int(np.count_nonzero(~found.moved))
    if still == count:
        return (
            f"none of the {count:,} patches was moved: no triangles were saved within these limits; wider ones"
            " (--within, --turn) or more --solver-steps may find some",
        )
    return (f"{still:,} of {count:,} patches stayed where they are, which leaves nothing to show of them",) * (
        still > 0
    )


def _patch_rows(found: Relaxed, counts: dict[str, tuple[np.ndarray, np.ndarray]]) -> list[Row]:
    totals = {
        f"{name.replace(' ', '_')}_{when}": count.sum(axis=0)
        for name, pair in counts.items()
        for when, count in zip(("before", "after"), pair, strict=True)
    }
    return [
        {
            "patch": k,
            **{name: float(values[k]) for name, values in totals.items()},
            "distance": float(found.distance[k]),
            "turn_degrees": float(found.turn[k]),
        }
        for k in range(len(found.distance))
    ]
