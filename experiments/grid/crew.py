"""Workers that measure a study's cases: processes of this machine, or those of a scheduler that is there already."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from importlib.util import find_spec
from typing import Protocol

from slefejax.arguments import check_whole
from slefejax.errors import InputError
from slefejax.experiments.grid.scenes import Scenes
from slefejax.experiments.grid.sights import Asked, Sights
from slefejax.experiments.tables import Row
from slefejax.lanes.passes import cores
from slefejax.late import one_at_a_time

_NEEDED = ("distributed",)  # of the extra cluster
MOST_A_CORE = 8  # workers of this machine
_ANSWER = 10.0  # seconds that a scheduler has to answer, and a worker to appear there


class Work(Protocol):
    """Whoever measures."""

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know of it afterwards."""
        ...

    def rows(self, asked: Iterable[Asked], tell: Callable[[str], None]) -> Iterator[list[Row]]:
        """Rows as they are found; ``tell`` hears what is being measured."""
        ...


class Alone:
    """This process measures, one case after the other."""

    notes: tuple[str, ...] = ()

    def __init__(self, scenes: Scenes) -> None:
        self.scenes, self.sights = scenes, Sights(scenes.study)

    def rows(self, asked: Iterable[Asked], tell: Callable[[str], None]) -> Iterator[list[Row]]:
        """Row by row."""
        try:
            for own in asked:
                tell(f"{own.case.scene}, view {own.case.view}")
                yield [self.sights.row(own, self.scenes.scene(own.case), self.scenes.view(own.case))]
        finally:
            self.sights.release()


@dataclass(frozen=True)
class Crew:
    """Who measures: this process, if nobody is named.

    workers   : so many processes of this machine, each with one thread and an OpenGL context of its own
    scheduler : the address of one of dask.distributed instead, ``"tcp://HOST:8786"``

    Raises InputError for numbers that are none, for both, and where the extra ``cluster`` is needed and not there.
    """

    workers: int | None = None
    scheduler: str | None = None

    def __post_init__(self) -> None:
        if self.workers is not None:
            check_whole("workers", self.workers, 1)
            if self.workers > (most := MOST_A_CORE * cores()):
                said = f"workers are {most} at most on the {cores()} cores of this machine, not {self.workers}"
                raise InputError(said, options=("workers",))
        if self.workers is not None and self.scheduler is not None:
            said = "workers are processes of this machine, and scheduler names others: give one of them"
            raise InputError(said, options=("workers", "scheduler"))
        if not self.alone and (missing := [name for name in _NEEDED if find_spec(name) is None]):
            raise InputError(f"workers need the package {missing[0]}, not installed: pip install 'slefejax[cluster]'")

    @property
    def alone(self) -> bool:
        """Whether this process measures."""
        return self.workers is None and self.scheduler is None

    @property
    def hands(self) -> int:
        """How many measure at a time, as far as that is known beforehand."""
        return self.workers or 1

    @contextmanager
    def opened(self, scenes: Scenes) -> Iterator[Work]:
        """Whoever measures, for as long as the context lasts.

        Raises InputError for a scheduler that does not answer or has no workers, and for workers of other versions.
        """
        if self.alone:
            yield Alone(scenes)
            return
        with one_at_a_time:
            from slefejax.experiments.grid.dispatch import Dispatch
            from slefejax.experiments.grid.processes import on_this_machine, scheduler_at
        where = on_this_machine(self.workers) if self.workers else scheduler_at(self.scheduler or "", _ANSWER)
        with where as client:
            dispatch = Dispatch(client, scenes, self.scheduler or "of this machine")
            dispatch.wait(_ANSWER)
            yield dispatch
