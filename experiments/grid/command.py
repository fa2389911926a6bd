"""The command ``slefejax study``: a study's file run, or said how long it would take."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np
import tyro

from slefejax.experiments.cli import BAD_INPUT
from slefejax.experiments.grid.crew import Crew
from slefejax.experiments.grid.plan import Study
from slefejax.experiments.grid.running import Running
from slefejax.experiments.options import OutputOptions
from slefejax.experiments.report import Report
from slefejax.experiments.tables import Row


@dataclass(frozen=True)
class StudyOfFile:
    """A grid of scenes, views, tolerances, methods and more, as a file says it: a row a case, kept as it is found."""

    study: Annotated[str, tyro.conf.Positional]
    """The study's file (.toml): docs/studies.md says what stands in it."""
    dry_run: bool = False
    """Measure nothing: say how many cases there are, how many are left, and how long they will take by what was
    measured so far."""
    trust_rules: bool = False
    """Run methods of one's own that the file names, such as my_module:MyMethod: code, found beside where the command is
    run."""
    workers: int | None = None
    """Measure in so many processes of this machine, each with one thread and an OpenGL context of its own."""
    scheduler: str | None = None
    """Measure on the workers of this scheduler of dask.distributed: tcp://HOST:8786 (docs/studies.md says how)."""
    output: tyro.conf.OmitArgPrefixes[OutputOptions] = field(default_factory=OutputOptions)

    def run(self) -> Report:
        """Measure what is not there yet."""
        study = Study.load(self.study, trust_rules=self.trust_rules)
        folder = self.output.out or Path("runs/study") / Path(self.study).stem
        running, name = Running(study, folder, Crew(self.workers, self.scheduler)), Path(self.study).stem
        scenes = list(study.scenes)
        if self.dry_run:
            rows = running.estimate()
            title = f"{name}: {_sum(rows, 'cases'):,.0f} cases, of which {_sum(rows, 'left'):,.0f} are left"
            return Report(scenes, None, rows, title + _minutes(_sum(rows, "minutes")), as_json=self.output.json)
        rows = running.rows()
        title = f"{name}: {len(rows):,} cases"
        shown = running.shown(rows)
        status = BAD_INPUT if running.failed else 0
        notes = running.notes
        return Report(scenes, running.folder, rows, title, notes, as_json=self.output.json, shown=shown, status=status)


def _sum(rows: list[Row], name: str) -> float:
    return float(sum(row[name] for row in rows))


def _minutes(number: float) -> str:
    if np.isnan(number):
        return "; nothing was measured yet that says how long they take"
    return f": some {number:.1f} minutes, by what was measured so far"
