"""How tight is a slefe? Every bound of ``bounds.rivals`` on the same curves, with the same number of pieces."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field

import jax
import numpy as np
import tyro

from slefejax import slefe, slefe_boxes, slefe_table
from slefejax.bounds.rivals import BATCH_METHODS, CURVE_METHODS, batch_widths, enclose_curve
from slefejax.bounds.slefe_tables import basis_coefficients
from slefejax.errors import InputError
from slefejax.experiments.options import FigureOptions
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Row, Run
from slefejax.figures.checks.tightness import write_width_against_pieces, write_width_against_time
from slefejax.figures.six_bounds import write_six_bounds
from slefejax.figures.slefe_construction import write_slefe_construction
from slefejax.geometry.bezier import evaluate_curve

SIX = ("disc", "min-max", "oriented-box", "convex-hull", "filip", "slefe")
TIMED_BATCH = 4096  # curves in one call when a formula is timed
FIGURE_PIECES = 3


@dataclass(frozen=True)
class Tightness:
    """The width of every bound over the narrowest that exists, and its cost in time, on random and on named curves."""

    degree: int = 3
    """Degree of the curves."""
    segments: tuple[int, ...] = (1, 2, 3, 4, 6, 9)
    """Numbers of equal pieces, the same for all bounds."""
    curves: int = 60
    """Random curves of each kind."""
    seed: int = 1
    """Seed of the random curves."""
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Measure, tabulate, draw."""
        self._check()
        kinds = curve_kinds(self.degree, self.curves, self.seed)
        cases = [
            f"{kind}, {m} pieces, {method}" for kind in kinds for m in self.segments for method in self._methods(m)
        ]
        with Run("tightness", {**asdict(self), "output": None}, self.output.out, {}, self.output.pages(self)) as run:
            cells = _Cells(kinds)
            with progress("bounding", len(cases)) as show:
                rows = run.each("case", cases, cells.row, show)
            rows = [{name: value for name, value in row.items() if name != "case"} for row in rows]
            self._draw(run, rows)
            out = run.finish(rows, {"scene": None, "timed_batch": TIMED_BATCH, **tensor_order(self.seed)})
        title = (
            f"width of bounds over the narrowest possible, curves of degree {self.degree}, scalar functions on [0, 1]"
        )
        return Report(None, out, rows, title, as_json=self.output.json)

    def _check(self) -> None:
        if self.degree < 2:
            raise InputError(f"--degree must be at least 2, not {self.degree}: lines are their own bound")
        if self.curves < 1 or not self.segments or min(self.segments) < 1:
            raise InputError("--curves and --segments must be whole numbers of at least 1")

    def _methods(self, pieces: int) -> list[str]:
        """All bounds that exist with so many pieces: a control polygon has its degree of legs."""
        return [m for m in CURVE_METHODS if m != "optimum" and (m != "control-polygon" or pieces % self.degree == 0)]

    def _draw(self, run: Run, rows: list[Row]) -> None:
        write_width_against_pieces(run.figure("width_against_pieces"), rows)
        write_width_against_time(run.figure("width_against_time"), rows)
        t = np.linspace(0.0, 1.0, 301)
        step = step_curve(self.degree)
        table, bounds = slefe_table(self.degree, FIGURE_PIECES), slefe(step, FIGURE_PIECES)
        first = np.array([float(c) for c in basis_coefficients(self.degree, 1)])
        write_slefe_construction(
            run.figure("slefe_construction"),
            t,
            evaluate_curve(step, t),
            step,
            (np.asarray(bounds.lower), np.asarray(bounds.upper)),
            evaluate_curve(first, t),
            (table.lower[0], table.upper[0]),
        )
        six = {name: enclose_curve(name, step, FIGURE_PIECES) for name in SIX}
        panels = [(name, bound.regions, bound.area, bound.width) for name, bound in six.items()]
        write_six_bounds(run.figure("six_bounds"), t, evaluate_curve(step, t), panels, FIGURE_PIECES)


def step_curve(degree: int) -> np.ndarray:
    """The step-like curve of [YBP12], figure 2, (0, -1, 1, 0) for cubics: down, then up."""
    middle = np.sign(np.arange(1, degree) - degree / 2.0)
    return np.concatenate([[0.0], middle if np.any(middle) else [1.0], [0.0]])


def curve_kinds(degree: int, count: int, seed: int) -> dict[str, np.ndarray]:
    """Curves by kind, coefficients ``(degree + 1, curves)``."""
    rng = np.random.default_rng(seed)
    line, n = np.linspace(0.0, 1.0, degree + 1)[:, None], degree + 1
    bends = rng.exponential(size=(degree - 1, count))
    basis = np.array([[float(c) for c in basis_coefficients(degree, j)] for j in range(1, degree)])
    return {
        "random": rng.normal(size=(n, count)),
        "convex": basis.T @ bends,
        "nearly straight": line + 1e-6 * rng.normal(size=(n, count)),
        "step": step_curve(degree)[:, None],
        "one bend": basis[0][:, None],
        "high-frequency": np.where(np.arange(n) % 2, 1.0, -1.0)[:, None],
        "near-degenerate": np.concatenate([np.zeros(degree), [1.0]])[:, None],
    }


class _Cells:
    """Computes rows; the optimum of a kind and a number of pieces is found once."""

    def __init__(self, kinds: dict[str, np.ndarray]) -> None:
        self._kinds = kinds
        self._optima: dict[tuple[str, int], np.ndarray] = {}

    def row(self, case: str) -> Row:
        """A row for ``kind, m pieces, method``."""
        kind, pieces_text, method = case.split(", ")
        pieces, curves = int(pieces_text.split()[0]), self._kinds[kind]
        best = self._optimum(kind, pieces)
        widths, seconds = _measure(method, curves, pieces)
        ratio = widths / best
        return {
            "curve": kind,
            "degree": curves.shape[0] - 1,
            "segments": pieces,
            "method": method,
            "curves": curves.shape[1],
            "width_over_optimum_median": float(np.median(ratio)),
            "width_over_optimum_p95": float(np.quantile(ratio, 0.95)),
            "width_over_optimum_max": float(ratio.max()),
            "us_per_curve": 1e6 * seconds,
        }

    def _optimum(self, kind: str, pieces: int) -> np.ndarray:
        if (kind, pieces) not in self._optima:
            widths = [enclose_curve("optimum", curve, pieces).width for curve in self._kinds[kind].T]
            self._optima[kind, pieces] = np.array(widths)
        return self._optima[kind, pieces]


def _measure(method: str, curves: np.ndarray, pieces: int) -> tuple[np.ndarray, float]:
    """Widths, and seconds a curve: of a compiled call for many where there is a formula, one by one otherwise."""
    start = time.perf_counter()
    widths = np.array([enclose_curve(method, curve, pieces).width for curve in curves.T])
    seconds = (time.perf_counter() - start) / curves.shape[1]
    if method in BATCH_METHODS:
        many = np.tile(curves, -(-TIMED_BATCH // curves.shape[1]))[:, :TIMED_BATCH]
        seconds = _median_seconds(lambda: jax.block_until_ready(batch_widths(method, many, pieces))) / TIMED_BATCH
    return widths, seconds


def _median_seconds(call: Callable[[], object]) -> float:
    call()  # compiles
    seconds = []
    for _ in range(7):
        start = time.perf_counter()
        call()
        seconds.append(time.perf_counter() - start)
    return float(np.median(seconds))


def tensor_order(seed: int, patches: int = 1000, degree: int = 3, segments: int = 3) -> dict[str, float]:
    """Bounds in v then u over bounds in u then v: the median ratio of widths of random patches, and its extremes."""
    nets = np.random.default_rng(seed).normal(size=(patches, degree + 1, degree + 1, 1))
    one, other = (slefe_boxes(n, segments) for n in (nets, np.swapaxes(nets, 1, 2)))
    width, turned = (np.max(np.asarray(b.upper) - np.asarray(b.lower), axis=(1, 2, 3)) for b in (one, other))
    ratio = width / turned
    return {
        "v_then_u_over_u_then_v_median": float(np.median(ratio)),
        "v_then_u_over_u_then_v_min": float(ratio.min()),
        "v_then_u_over_u_then_v_max": float(ratio.max()),
    }
