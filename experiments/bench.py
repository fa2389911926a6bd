"""How long every stage takes, beside the same computation in plain NumPy, in the same run."""

from __future__ import annotations

import os
import platform
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import jax
import numpy as np
import tyro

from slefejax import layout
from slefejax.errors import InputError, NoOpenGLError
from slefejax.experiments.bench_stages import DOUBLE, ONCE, OPENGL, STAGES, Setting, Work
from slefejax.experiments.options import OutputOptions
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Row, Run
from slefejax.figures.bench import FRAME, write_growth, write_shares
from slefejax.gpu import Device, open_device

PRECISIONS = {"single": np.float32, "double": np.float64}
COUNTS = (1000, 10_000, 141_000)
_SECONDS = 1.5  # for the runs of one row
_FEWEST, _MOST = 3, 25  # of them
_COLUMNS = ("stage", "one core, ms", "10 to 90 %", "all cores, ms", "million a second", "first call, s", "memory, MB")
_COLUMNS = (*_COLUMNS, "beside")
_SHOWN = ("stage", "count", "precision", "cores", "median_ms", "low_ms", "high_ms", "million_per_s", "compile_s")
_SHOWN = (*_SHOWN, "peak_mb", "peer", "peer_ms", "peer_ratio")


@dataclass(frozen=True)
class Bench:
    """Time every stage at several numbers of patches, in both precisions, on one core and on all, beside NumPy."""

    counts: tuple[int, ...] = COUNTS
    """Numbers of patches."""
    only: tuple[str, ...] = ()
    """Names of stages, such as fused; all if there are none."""
    quick: bool = False
    """The first two numbers of patches, single precision, fewer runs."""
    output: tyro.conf.OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def run(self) -> Report:
        """Measure, compare, tabulate, draw."""
        cells = self._cells()
        machine = machine_record()
        with Run("bench", {**asdict(self), "output": None}, self.output.out, machine) as run:
            bench = _Bench(_device(), _SECONDS / 4 if self.quick else _SECONDS)
            with progress("measuring", len(cells)) as show:
                measured = run.each("cell", list(cells), lambda name: bench.rows(*cells[name]), show)
            rows = [row for cell in measured for row in cell["rows"]]
            write_growth(run.file("growth.png"), rows)
            if any(row["stage"] in FRAME for row in rows):
                write_shares(run.file("shares.png"), rows)
            run.file("benchmarks.md").write_text(as_markdown(rows, machine))
            out = run.finish(rows, {"scene": None, "machine": machine})
        title = f"{machine['processor']}, {machine['cores']} cores; medians and 10 to 90 % of the runs in milliseconds"
        return Report(None, out, rows, title, as_json=self.output.json, shown=_SHOWN)

    def _cells(self) -> dict[str, tuple[str, int, str]]:
        unknown = [name for name in self.only if name not in STAGES]
        if unknown:
            raise InputError(f"there is no stage {unknown[0]!r}: choose among {', '.join(STAGES)}")
        if not self.counts or min(self.counts) < 1:
            raise InputError("--counts needs whole numbers of at least 1")
        counts = self.counts[:2] if self.quick else self.counts
        found = {}
        for count in counts:
            for precision in ("single",) if self.quick else PRECISIONS:
                for stage in self.only or STAGES:
                    own = "double" if stage in DOUBLE else precision
                    amount = 1 if stage in ONCE else count
                    found[f"{stage}, {amount}, {own}"] = (stage, amount, own)
        return found


@dataclass
class _Bench:
    device: Device | None
    seconds: float

    def __post_init__(self) -> None:
        self._key: tuple[int, str] | None = None
        self._setting: Setting | None = None

    def rows(self, stage: str, count: int, precision: str) -> Row:
        """On one core and on all of them, a row for every peer."""
        if stage in OPENGL and self.device is None:
            return {"rows": []}
        if self._key != (count, precision):
            self._key, self._setting = (count, precision), Setting(count, PRECISIONS[precision], self.device)
        assert self._setting is not None
        work = STAGES[stage](self._setting)
        many = layout.cores()
        rows = []
        for cores in dict.fromkeys((1, many)):
            with on_cores(cores):
                own = self._measured(work)
                peers = work.peers if cores == 1 else {}
                base = {"stage": stage, "count": count, "items": work.items, "unit": work.unit}
                base |= {"precision": precision, "device": jax.default_backend(), "cores": cores, **own}
                rows += [base | self._beside(work, name) for name in peers] or [base | self._beside(work, "")]
        return {"rows": rows}

    def _measured(self, work: Work) -> Row:
        """Median and spread, the first call's excess, and how much memory it took besides what was there."""
        before = _reset_peak()
        start = time.perf_counter()
        jax.block_until_ready(work.run())
        first = time.perf_counter() - start
        times = self._times(work.run)
        median, low, high = (1e3 * float(np.percentile(times, p)) for p in (50, 10, 90))
        return {
            "median_ms": median,
            "low_ms": low,
            "high_ms": high,
            "runs": len(times),
            "million_per_s": work.items / median / 1e3,
            "compile_s": max(0.0, first - median / 1e3),
            "peak_mb": (_peak() - before) / 2**20,
        }

    def _beside(self, work: Work, peer: str) -> Row:
        """The peer and the stage in turn; their results must agree."""
        nothing = {"peer": peer, "peer_ms": float("nan"), "peer_ratio": float("nan"), "difference": float("nan")}
        if not peer:
            return nothing
        other = work.peers[peer]
        jax.block_until_ready((work.run(), other()))
        ratios, others = [], []
        spent = time.perf_counter()
        while len(ratios) < _FEWEST or (len(ratios) < _MOST and time.perf_counter() - spent < self.seconds):
            own, theirs = (_seconds(each) for each in (work.run, other))
            ratios.append(theirs / own)
            others.append(theirs)
        return nothing | {
            "peer_ms": 1e3 * float(np.median(others)),
            "peer_ratio": float(np.median(ratios)),
            "difference": _difference(work, other),
        }

    def _times(self, run: Callable[[], Any]) -> list[float]:
        times: list[float] = []
        while len(times) < _FEWEST or (len(times) < _MOST and sum(times) < self.seconds):
            times.append(_seconds(run))
        return times


def _seconds(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - start


def _difference(work: Work, other: Callable[[], Any]) -> float:
    """The largest difference of both results, over the largest entry. Raises InputError if they do not agree."""
    if work.same is None:
        return float("nan")
    own, theirs = work.same(work.run()), work.same(other())
    if own is None or theirs is None:
        return float("nan")
    found = float(np.max(np.abs(np.asarray(own, np.float64) - theirs)) / max(float(np.max(np.abs(theirs))), 1e-300))
    if not found <= work.close:
        raise InputError(f"a stage and its peer differ by {found:.1e}: the benchmark compares different things")
    return found


def as_markdown(rows: list[Row], machine: Row) -> str:
    """A table a number of patches and precision, with a line a stage, under a description of the machine."""
    lines = [", ".join(f"{name.replace('_', ' ')} {value}" for name, value in machine.items() if value is not None)]
    kinds = dict.fromkeys((row["count"], row["precision"]) for row in rows)
    for count, precision in kinds:
        own = [row for row in rows if (row["count"], row["precision"]) == (count, precision)]
        what = "Whatever the number of patches" if count == 1 else f"{count:,} patches"
        lines += [
            f"\n## {what}, {precision} precision\n",
            f"| {' | '.join(_COLUMNS)} |",
            "|---" * len(_COLUMNS) + "|",
        ]
        lines += [_line(stage, own) for stage in dict.fromkeys(row["stage"] for row in own)]
    return "\n".join(lines) + "\n"


def _line(stage: str, rows: list[Row]) -> str:
    own = [row for row in rows if row["stage"] == stage]
    first, last = own[0], own[-1]
    beside = ", ".join(
        f"{row['peer']} {row['peer_ms']:.3g} ms ({row['peer_ratio']:.3g} times)" for row in own if row["peer"]
    )
    cells = [
        f"{stage} ({first['unit']})",
        f"{first['median_ms']:.3g}",
        f"{first['low_ms']:.3g} to {first['high_ms']:.3g}",
        f"{last['median_ms']:.3g}",
        f"{first['million_per_s']:.3g}",
        f"{first['compile_s']:.2g}",
        f"{first['peak_mb']:.3g}",
        beside,
    ]
    return f"| {' | '.join(cells)} |"


@contextmanager
def on_cores(count: int) -> Iterator[None]:
    """All threads of this process on so many of its cores, where the system can do that."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    whole = os.sched_getaffinity(0)
    _pin(set(sorted(whole)[:count]))
    try:
        yield
    finally:
        _pin(whole)


def _pin(cores: set[int]) -> None:
    for thread in os.listdir("/proc/self/task") if os.path.isdir("/proc/self/task") else ["0"]:
        with suppress(OSError):  # the thread has ended
            os.sched_setaffinity(int(thread), cores)


def _reset_peak() -> int:
    """Forget the largest size that the process had; bytes that it has now."""
    with suppress(OSError):
        Path("/proc/self/clear_refs").write_text("5")
    return _status("VmRSS")


def _peak() -> int:
    return _status("VmHWM")


def _status(name: str) -> int:
    """An entry of Linux's account of this process, bytes; 0 elsewhere."""
    with suppress(OSError):
        for line in Path("/proc/self/status").read_text().splitlines():
            if line.startswith(name + ":"):
                return int(line.split()[1]) * 1024
    return 0


def machine_record() -> Row:
    """What this was measured on."""
    name = platform.processor() or platform.machine()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), name)
    device = _device()
    return {
        "processor": name,
        "cores": layout.cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": sys.version.split()[0],
        "jax": jax.__version__,
        "numpy": np.__version__,
        "jax_device": f"{jax.devices()[0].platform}: {jax.devices()[0].device_kind}",
        "opengl": None if device is None else device.renderer,
    }


def _device() -> Device | None:
    """The OpenGL device; without one its stages are left out."""
    try:
        return open_device()
    except NoOpenGLError:
        return None
