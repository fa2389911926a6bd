"""How far results can be believed: hard cases in single and double precision beside sixty digits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np
import tyro

from slefejax import InputError, View, screen_widths, slefe_boxes, tessellation_factors, worst_points
from slefejax.arguments import no_such
from slefejax.experiments.checks import reference
from slefejax.experiments.checks.cases import FAMILIES, Case
from slefejax.experiments.checks.rig import MEASURES
from slefejax.experiments.options import FigureOptions
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Row, Run
from slefejax.figures.checks.stability import write_stability_figure
from slefejax.geometry.bezier import evaluate_patch
from slefejax.geometry.view import homogeneous
from slefejax.measure.supremum import in_batches
from slefejax.measure.surface import Surface
from slefejax.predict.methods import method_of

PRECISIONS = {"single": np.float32, "double": np.float64}
CLOSE = 0.01  # a relative error of factors above that is noticed
_CELLS = 40_000  # of a grid whose error is sampled whole; of a finer one as many are chosen
_SOME = 2  # places along each side of a tile where containment is checked, besides breakpoints
_FINEST = 10**6
_SOME_CELLS = 4000  # where depth is looked at


@dataclass(frozen=True)
class Stability:
    """Hard cases in single and double precision beside sixty digits: errors, and what is broken or not finite."""

    only: tuple[str, ...] = ()
    """Names of families of cases, such as offset; all if there are none."""
    quick: bool = False
    """The first, middle and last value of every family only."""
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Compute, compare, tabulate, draw."""
        cells = self._cells()
        with Run("stability", {**asdict(self), "output": None}, self.output.out, {}, self.output.pages(self)) as run:
            with progress("computing", len(cells)) as show:
                rows = run.each("case", list(cells), lambda name: _row(*cells[name]), show)
            rows = [{name: value for name, value in row.items() if name != "case"} for row in rows]
            write_stability_figure(run.figure("stability"), rows)
            out = run.finish(rows, {"scene": None, "digits": reference.DIGITS})
        broken = sum(row["containment_violations"] + row["certificate_violations"] for row in rows)
        title = (
            f"{len(rows)} cases beside {reference.DIGITS} digits: {broken} patches leave their enclosure or miss their"
            f" certificate, {sum(row['nonfinite'] for row in rows)} numbers are not finite"
        )
        return Report(None, out, summary(rows), title, extra={"table": rows}, as_json=self.output.json)

    def _cells(self) -> dict[str, tuple[Any, float, str]]:
        names = [family.name for family in FAMILIES]
        unknown = [name for name in self.only if name not in names]
        if unknown:
            raise InputError(no_such("family", unknown[0], names))
        found = {}
        for family in FAMILIES:
            if self.only and family.name not in self.only:
                continue
            values = family.values
            if self.quick:
                values = tuple(dict.fromkeys((values[0], values[len(values) // 2], values[-1])))
            for value in values:
                found |= {f"{family.name}, {value!r}, {name}": (family, value, name) for name in PRECISIONS}
        return found


def _row(family: Any, value: float, precision: str) -> Row:
    dtype = PRECISIONS[precision]
    made = family.case
    if made is None:
        error, nonfinite = MEASURES[family.name](value, dtype)
        found: Row = {**dict.fromkeys(_OF_PATCHES, 0), "error": error, "factor_error": error, "nonfinite": nonfinite}
        found |= {"largest_factor": float("nan"), "certified_over_double": float("nan")}
    else:
        found = measure(made(value), dtype)
    return {"family": family.name, "parameter": family.parameter, "value": value, "precision": precision, **found}


def summary(rows: list[Row]) -> list[Row]:
    """A row a family: the largest errors, what was broken, and from which value on single precision is no good."""
    found = []
    for name in dict.fromkeys(row["family"] for row in rows):
        single, double = (
            [row for row in rows if row["family"] == name and row["precision"] == precision] for precision in PRECISIONS
        )
        found.append(
            {
                "family": name,
                "cases": f"{single[0]['value']:g} to {single[-1]['value']:g}",
                "single_error": max(row["factor_error"] for row in single),
                "double_error": max(row["factor_error"] for row in double),
                "single_broken": sum(_broken(row) for row in single),
                "double_broken": sum(_broken(row) for row in double),
                "nonfinite": sum(row["nonfinite"] for row in single + double),
                "single_refused": sum(row["refused"] for row in single),
                "single_unsafe_from": _first(single, lambda row: _broken(row) > 0 or row["nonfinite"] > 0),
                "single_estimate_off_from": _first(single, lambda row: not row["factor_error"] <= CLOSE),
                "single_certified_loose_from": _first(
                    single, lambda row: row["refused"] > 0 or row["certified_over_double"] > 1.0 + CLOSE
                ),
            }
        )
    return found


def _broken(row: Row) -> int:
    return row["containment_violations"] + row["certificate_violations"]


def _first(rows: list[Row], bad: Callable[[Row], bool]) -> str:
    """The value of the first row that is bad."""
    return next((f"{row['value']:g}" for row in rows if bad(row)), "never")


_OF_PATCHES = (
    *("error", "factor_error", "largest_factor", "certified_over_double", "refused", "nonfinite"),
    *("containment_violations", "containment_worst", "containment_checked"),
    *("certificate_violations", "certificate_worst", "certificate_checked"),
)


def measure(case: Case, dtype: Any) -> Row:
    """A case, its control points rounded to a precision and then taken as exact."""
    patches = case.patches.astype(dtype)
    exact = reference.exact(patches)
    pair = (case.segments, case.segments)
    wide = reference.widths(exact, case.view, pair).astype(float)
    widths = _attempt(lambda: np.asarray(screen_widths(patches, case.view, case.segments)))
    factors = _attempt(lambda: _factors(patches, case, "slefe"))
    certified = _attempt(lambda: _factors(patches, case, "certified"))
    double = _attempt(lambda: _factors(patches.astype(np.float64), case, "certified"))
    computed = [x for x in (widths, factors, certified) if x is not None]
    row = {
        "error": _relative(widths, np.maximum(wide[:, 0], 0.0)),
        "factor_error": _relative(factors, _estimate(wide, case)),
        "largest_factor": float("nan") if certified is None else float(np.max(certified)),
        "certified_over_double": _largest_ratio(certified, double),
        "refused": 3 - len(computed),
        "nonfinite": sum(int(np.sum(~np.isfinite(x))) for x in computed),
    }
    return row | _containment(patches, exact, pair) | _certificate(patches, exact, case, certified)


def _estimate(wide: np.ndarray, case: Case) -> np.ndarray:
    """The published factors from widths in pixels and depth ([YBP12], (9) and (10))."""
    demand = wide[:, 0] / case.tolerance
    if case.depth_tolerance is not None:
        demand = np.maximum(demand, wide[:, 1] / case.depth_tolerance)
    return np.where(wide[:, 0] >= 0, np.maximum(case.segments * np.sqrt(np.maximum(demand, 0.0)), 1.0), 0.0)


def _attempt(work: Callable[[], Any]) -> Any:
    """What comes out, or None where it is refused in words."""
    try:
        return work()
    except InputError:
        return None


def _factors(patches: np.ndarray, case: Case, method: str) -> np.ndarray:
    value = method_of(method, {"segments": case.segments} if method == "slefe" else {})
    found = tessellation_factors(
        patches, case.view, value, tolerance=case.tolerance, depth_tolerance=case.depth_tolerance
    )
    return np.asarray(found.factor)


def _relative(found: Any, wanted: np.ndarray) -> float:
    """The largest relative error; infinite where exactly one of both is 0."""
    if found is None:
        return float("nan")
    size = np.where(wanted > 0, wanted, 1.0)
    return float(np.max(np.where((found > 0) == (wanted > 0), np.abs(found - wanted) / size, np.inf)))


def _largest_ratio(found: Any, wanted: Any) -> float:
    if found is None or wanted is None:
        return float("nan")
    both = (found > 0) & (wanted > 0)
    return float(np.max(found[both] / wanted[both], initial=1.0))


def _containment(patches: np.ndarray, exact: np.ndarray, pair: tuple[int, int]) -> Row:
    found = _attempt(lambda: slefe_boxes(patches, pair))
    if found is None:
        return dict.fromkeys(_OF_PATCHES[6:9], 0)
    lower, upper = (reference.exact(x) for x in found)
    excess, count = reference.outside(exact, lower, upper, _SOME)
    size = max(float(np.ptp(patches.astype(np.float64))), 1e-300)
    return {
        "containment_violations": int(np.sum(excess > 0)),
        "containment_worst": float(max(excess)) / size,
        "containment_checked": len(patches) * count,
    }


def _certificate(patches: np.ndarray, exact: np.ndarray, case: Case, factor: Any) -> Row:
    """Patches that err by more than the tolerance, of pixels or of depth, at the certified factor, rounded up.

    The worst places are searched in double precision, the errors there computed with all digits.
    """
    broken, checked, worst = 0, 0, 0.0
    if factor is None:
        return dict.fromkeys(_OF_PATCHES[9:], 0)
    for k in range(len(patches)):
        n = int(np.ceil(factor[k])) if np.isfinite(factor[k]) else 0
        if n == 0 or n > _FINEST:
            continue
        error, u, v = _worst_place(patches[k].astype(np.float64), case.view, n)
        if np.isnan(u):
            continue
        found = float(reference.cell_error(exact[k], case.view, n, u, v)) if np.isfinite(error) else np.inf
        share = found / case.tolerance
        if case.depth_tolerance is not None:
            place = _worst_depth(patches[k].astype(np.float64), case.view, n)
            share = max(share, float(reference.cell_error(exact[k], case.view, n, *place, (2,))) / case.depth_tolerance)
        checked, broken, worst = checked + 1, broken + (share > 1.0), max(worst, share)
    return {"certificate_violations": broken, "certificate_checked": checked, "certificate_worst": worst}


def _worst_depth(patch: np.ndarray, view: View, n: int) -> tuple[float, float]:
    """The middle of a cell with the largest error of depth, among some cells."""
    control = (homogeneous(patch) @ np.asarray(view.world_to_screen).T)[..., None]
    cell = np.random.default_rng(0).integers(0, n, (_SOME_CELLS, 2))

    def point(a: float, b: float) -> np.ndarray:
        return np.asarray(evaluate_patch(control, (cell[:, 0] + a) / n, (cell[:, 1] + b) / n)).T

    true, corners = point(0.5, 0.5), [point(a, b) for a, b in ((0, 0), (1, 1), (0, 1), (1, 0))]
    drawn = [0.5 * (corners[k] + corners[k + 1]) for k in (0, 2)]
    size = np.array([view.width, view.height, 1.0])
    seen = (true[:, 3] > view.camera.near_w) & np.all(np.abs(true[:, :3] / true[:, 3:] / size - 0.5) <= 0.5, axis=1)
    error = np.max([np.abs(true[:, 2] / true[:, 3] - x[:, 2] / x[:, 3]) for x in drawn], axis=0)
    best = cell[int(np.argmax(np.where(seen, error, -1.0)))]
    return float((best[0] + 0.5) / n), float((best[1] + 0.5) / n)


def _worst_place(patch: np.ndarray, view: View, n: int) -> tuple[float, float, float]:
    """The largest sampled error on the n x n grid, and where; of a very fine grid cells are chosen at random."""
    if n * n <= _CELLS:
        found = worst_points(patch[None], [n], view)
        return float(found.error[0]), float(found.u[0]), float(found.v[0])
    rng = np.random.default_rng(0)
    cell = rng.integers(0, n, (_CELLS, 2))
    cells = np.stack([cell, cell + 1], axis=2) / n
    whole = np.tile([0.0, 0.0, 1.0], (_CELLS, 1))
    error, a, b = in_batches(Surface.of(patch[None], view), np.zeros(_CELLS, int), cells.reshape(-1, 4), whole)
    best = int(np.argmax(error))
    if error[best] < 0:
        return 0.0, float("nan"), float("nan")
    place = (cell[best] + np.array([a[best], b[best]])) / n
    return float(error[best]), float(place[0]), float(place[1])
