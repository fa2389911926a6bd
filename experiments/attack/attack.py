"""The promise of the certified factor attacked: hostile nets in hostile views, judged by a judge of its own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from functools import partial
from itertools import count
from typing import Any

import jax
import numpy as np
import tyro

from slefejax import InputError
from slefejax.arguments import no_such
from slefejax.experiments.attack.batch import attack
from slefejax.experiments.attack.families.nets import FAMILIES
from slefejax.experiments.attack.families.steep import STEEP_FAMILIES
from slefejax.experiments.attack.judge.search import ALLOWANCE
from slefejax.experiments.attack.offender import script
from slefejax.experiments.attack.settings import SETTINGS
from slefejax.experiments.attack.workers import results, until
from slefejax.experiments.cli import start_jax
from slefejax.experiments.options import FigureOptions, check_count
from slefejax.experiments.report import Report, progress
from slefejax.experiments.store import Row, Run
from slefejax.figures.attack.attack import write_attack_figure
from slefejax.lanes.passes import cores

EVERY_FAMILY = (*FAMILIES, *STEEP_FAMILIES)
Batch = tuple[str, str, int]  # family, setting, seed


@dataclass(frozen=True)
class Attack:
    """Hostile patches in hostile views: is any visible point ever further off than the certified factor promises?"""

    pairs: int = 20_000
    """Pairs of a patch and a view that are judged, at least."""
    hours: float | None = None
    """The time after which no batch is begun any more."""
    seed: int = 0
    """Of the first round of batches; each further round has the next one."""
    family: tuple[str, ...] = ()
    """Families of nets, such as saddle; all if there are none."""
    setting: tuple[str, ...] = ()
    """Ways to ask, such as tiles-2 or drawn; all if there are none."""
    workers: int = 0
    """Processes; 0: as many as there are cores."""
    output: tyro.conf.OmitArgPrefixes[FigureOptions] = field(default_factory=FigureOptions)

    def run(self) -> Report:
        """Judge batch after batch, write down every offender."""
        self._check()
        asked = {**asdict(self), "output": None, "workers": None, "hours": None}
        with Run("attack", asked, self.output.out, {}, self.output.pages(self)) as run:
            found = {_batch(row): row for row in run.rows()}
            with progress("judging", self.pairs) as show:
                for row in self._new(found, show):
                    run.add(row)
            rows = [found[batch] for batch in sorted(found, key=self._place)]
            if not rows:
                raise InputError("--hours ended before the first batch: give it more time")
            offenders = [_write_offender(run, row, k) for row in rows for k in range(len(row["offenders"]))]
            table = summary(rows)
            write_attack_figure(run.figure("attack"), table)
            totals = _totals(rows)
            out = run.finish(table, {"scene": None, "batches": len(rows), **totals, "offenders": offenders})
        extra = {**totals, "batches": len(rows), "offenders": [str(out / name) for name in offenders]}
        notes = tuple(f"offender: {out / name}" for name in offenders)
        status = int(totals["violations"] > 0)
        return Report(None, out, table, _title(totals), notes, extra, self.output.json, status)

    def _check(self) -> None:
        for name, given, known in (("family", self.family, EVERY_FAMILY), ("setting", self.setting, SETTINGS)):
            unknown = [own for own in given if own not in known]
            if unknown:
                raise InputError(no_such(name, unknown[0], known))
        if not self._kinds():
            raise InputError("none of these settings takes any of these families: normals have families of their own")
        check_count("--pairs", self.pairs)
        check_count("--seed", self.seed, 0)
        check_count("--workers", self.workers, 0)
        if self.hours is not None and not self.hours > 0:
            raise InputError(f"--hours must be a positive number, not {self.hours}")

    def _kinds(self) -> list[tuple[str, str]]:
        settings, families = self.setting or tuple(SETTINGS), self.family or EVERY_FAMILY
        return [(family, name) for name in settings for family in families if SETTINGS[name].takes(family)]

    def _place(self, batch: Batch) -> tuple[int, int]:
        return batch[2], self._kinds().index(batch[:2])

    def _new(self, found: dict[Batch, Row], show: Callable[..., None]) -> Any:
        """Rows of batches that are not found yet, until there are enough pairs or time is over."""
        over, kinds = until(self.hours), self._kinds()
        every = ((*kind, seed) for seed in count(self.seed) for kind in kinds)
        ahead: list[Batch] = []

        def judged() -> int:
            return sum(row["pairs"] for row in found.values())

        def next_batch(under_way: list[Batch]) -> Batch | None:
            """The next one, of a setting that nobody compiles just now if there is one among the next few."""
            if over() or judged() >= self.pairs:
                return None
            while len(ahead) < len(kinds):
                batch = next(every)
                ahead.extend([] if batch in found else [batch])
            busy = {batch[1] for batch in under_way}
            return ahead.pop(next((k for k, batch in enumerate(ahead) if batch[1] not in busy), 0))

        prepare = partial(start_jax, jax.config.values["jax_enable_compilation_cache"])
        for batch, outcome in results(attack, prepare, next_batch, self.workers or cores()):
            found[batch] = dict(zip(("family", "setting", "seed"), batch, strict=True)) | outcome
            violations = sum(row["violations"] for row in found.values())
            show(judged(), detail=f"{violations} violations")
            yield found[batch]


def _batch(row: Row) -> Batch:
    return row["family"], row["setting"], row["seed"]


def summary(rows: list[Row]) -> list[Row]:
    """A row for every family and setting, in the order in which they were first attacked."""
    found = []
    for family, setting in dict.fromkeys((row["family"], row["setting"]) for row in rows):
        own = [row for row in rows if (row["family"], row["setting"]) == (family, setting)]
        over = np.concatenate([[np.nan], *(row["over_minimal"] for row in own)])[1:]
        median, p95 = np.quantile(over, (0.5, 0.95)) if over.size else (np.nan, np.nan)
        found.append(
            {
                "family": family,
                "setting": setting,
                "pairs": sum(row["pairs"] for row in own),
                "violations": sum(row["violations"] for row in own),
                "worst_ratio": max(row["worst_ratio"] for row in own),
                "factor_over_minimal_median": float(median),
                "factor_over_minimal_p95": float(p95),
                "without_normal": _share_without(own) if SETTINGS[setting].normals else np.nan,
                "refused": sum(row["refused"] for row in own),
            }
        )
    return found


def _share_without(rows: list[Row]) -> float:
    """Of the patches that are seen, those without a claim on normals."""
    without = sum(row["without_normal"] for row in rows)
    return without / max(1, without + sum(row["pairs"] for row in rows))


def _totals(rows: list[Row]) -> Row:
    drawn = {name for name, setting in SETTINGS.items() if setting.judged == "drawn"}
    pairs = {True: 0, False: 0}
    for row in rows:
        pairs[row["setting"] in drawn] += row["pairs"]
    sums = {name: sum(row[name] for row in rows) for name in ("violations", "refused", "unseen", "without_normal")}
    return {"uniform_pairs": pairs[False], "drawn_pairs": pairs[True], **sums}


def _title(totals: Row) -> str:
    return (
        f"{totals['uniform_pairs']:,} pairs of patch and view on uniform grids, {totals['drawn_pairs']:,} as drawn:"
        f" {totals['violations']:,} are further off than the tolerance (by more than {ALLOWANCE:g} of it);"
        f" {totals['unseen']:,} more are unseen, {totals['without_normal']:,} have no claim on normals,"
        f" {totals['refused']:,} were refused"
    )


def _write_offender(run: Run, row: Row, k: int) -> str:
    name = f"offender_{row['family']}_{row['setting']}_{row['seed']}_{k}.py"
    run.file(name).write_text(
        script({**{key: row[key] for key in ("family", "setting", "seed")}, **row["offenders"][k]})
    )
    return name
