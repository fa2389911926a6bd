"""How long every stage takes, beside the same computation in plain NumPy, in the same run."""

from __future__ import annotations

import platform
import sys
from contextlib import ExitStack, suppress
from dataclasses import asdict, dataclass, field
from pathlib import Path

import jax
import numpy as np
import tyro

from slefejax.arguments import no_such
from slefejax.errors import InputError
from slefejax.experiments.bench.process import PRECISIONS, Worker, the_device
from slefejax.experiments.bench.stages import DOUBLE, ONCE, STAGES
from slefejax.experiments.options import FigureOptions
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Row, Run
from slefejax.figures.bench.bench import FRAME, write_growth, write_shares
from slefejax.lanes import passes

COUNTS = (1000, 10_000, 141_000)
_SECONDS = 1.5  # for the runs of one row
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
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Measure, compare, tabulate, draw."""
        cells = self._cells()
        machine = machine_record()
        with (
            Run("bench", {**asdict(self), "output": None}, self.output.out, machine, self.output.pages(self)) as run,
            ExitStack() as stack,
        ):
            seconds = _SECONDS / 4 if self.quick else _SECONDS
            workers = [stack.enter_context(Worker(cores, seconds)) for cores in dict.fromkeys((1, passes.cores()))]

            def measure(name: str) -> Row:
                return {"rows": [row for own in workers for row in own.rows(*cells[name], own.cores == 1)]}

            with progress("measuring", len(cells)) as show:
                measured = run.each("cell", list(cells), measure, show)
            rows = [row for cell in measured for row in cell["rows"]]
            write_growth(run.figure("time_against_patches"), rows)
            if any(row["stage"] in FRAME for row in rows):
                write_shares(run.figure("shares_of_a_frame"), rows)
            run.file("benchmarks.md").write_text(as_markdown(rows, machine))
            out = run.finish(rows, {"scene": None, "machine": machine})
        title = f"{machine['processor']}, {machine['cores']} cores; medians and 10 to 90 % of the runs in milliseconds"
        return Report(None, out, rows, title, as_json=self.output.json, shown=_SHOWN)

    def _cells(self) -> dict[str, tuple[str, int, str]]:
        unknown = [name for name in self.only if name not in STAGES]
        if unknown:
            raise InputError(no_such("stage", unknown[0], STAGES))
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


def machine_record() -> Row:
    """What this was measured on."""
    name = platform.processor() or platform.machine()
    with suppress(OSError):
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        name = next((line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")), name)
    device = the_device()
    return {
        "processor": name,
        "cores": passes.cores(),
        "system": f"{platform.system()} {platform.machine()}",
        "python": sys.version.split()[0],
        "jax": jax.__version__,
        "numpy": np.__version__,
        "jax_device": f"{jax.devices()[0].platform}: {jax.devices()[0].device_kind}",
        "opengl": None if device is None else device.renderer,
    }
