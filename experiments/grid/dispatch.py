"""Cases given to workers and rows taken from them, whatever happens to a worker meanwhile."""

from __future__ import annotations

import ast
import json
import pickle
import sys
import time
import uuid
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.util import resolve_name
from pathlib import Path
from queue import Empty, Queue
from typing import Any

import jax
from distributed import Future, KilledWorker

from slefejax.errors import InputError
from slefejax.experiments.grid.plan import Case, Study
from slefejax.experiments.grid.scenes import Scenes
from slefejax.experiments.grid.shares import Shares
from slefejax.experiments.grid.sights import FAILED, REFUSED, Asked
from slefejax.experiments.grid.worker import Message, Parcel, identity, measure
from slefejax.experiments.tables import Row

_LOOK = 1.0  # seconds, from one look at who is there to the next
_AIM = 1.0  # seconds that the cases of a task take: to hand out a task and to hear of it takes some milliseconds
_MOST = 64  # cases of a task
_GATHER = 0.01  # seconds in which more rows may come: they are written together
_TRIES = 2  # of a case whose worker dies


@dataclass
class _Task:
    """Cases that a worker was given, but for those whose rows came back."""

    asked: dict[str, Asked]
    future: Future


@dataclass
class _Worker:
    """One that is there.

    tasks : by their numbers, the one that is under way first
    scene : the last that it was sent;  pace : seconds that its last row took
    """

    tasks: dict[int, _Task] = field(default_factory=dict)
    scene: str = ""
    pace: float = _AIM


class Dispatch:
    """A study's cases on the workers of a scheduler: who is asked for what, and what comes back.

    client : of dask.distributed;  where : how sentences call the scheduler
    """

    def __init__(self, client: Any, scenes: Scenes, where: str) -> None:
        self.client, self.scenes, self.where = client, scenes, where
        self._topic = f"slefejax-{uuid.uuid4().hex}"
        self._heard: Queue[tuple[int, str | None]] = Queue()
        self._workers: dict[str, _Worker] = {}
        self._refused: dict[str, str] = {}  # addresses, and why
        self._deaths: Counter[str] = Counter()
        self._given = 0
        self._looked = -_LOOK
        self._modules = sources(scenes.study)
        client.subscribe_topic(self._topic, lambda event: self._heard.put(tuple(event[1])))

    @property
    def notes(self) -> tuple[str, ...]:
        """What to know of the workers."""
        return tuple(f"not asked: {reason}" for reason in self._refused.values())

    def wait(self, seconds: float) -> None:
        """For the first worker. Raises InputError if none comes, or if one of those there can make none of the rows."""
        end = time.monotonic() + seconds
        while not self._present() and time.monotonic() < end:
            time.sleep(0.1)
        self._look(Shares(()))
        if self._refused:
            raise InputError(next(iter(self._refused.values())))
        if not self._workers:
            raise InputError(f"the scheduler {self.where} has no workers: docs/studies.md says how to start some")

    def rows(self, asked: Iterable[Asked], tell: Callable[[str], None]) -> Iterator[list[Row]]:
        """Rows as they come back; a case whose workers died has a row that says so, in ``FAILED``.

        Raises InputError if the scheduler is gone, and whatever a worker raises.
        """
        shares = Shares(asked)
        while shares or any(worker.tasks for worker in self._workers.values()):
            found = []
            if time.monotonic() - self._looked >= _LOOK:
                found += self._look(shares)
            self._occupy(shares)
            found += self._back(shares, _LOOK / 4)
            if found:
                yield found
                tell(self._told(found[-1]))
            elif not self._workers:
                tell("no worker is there, waiting")

    def _told(self, row: Row) -> str:
        count = len(self._workers)
        return f"{row['scene']}, {count} worker{'s' * (count > 1)}"

    def _present(self) -> dict[str, int]:
        """Addresses of those that are there, and how many threads they have."""
        try:
            found: Any = self.client.nthreads() if self.client.status == "running" else None
        except (OSError, RuntimeError):
            found = None
        if found is None:
            raise self._no_scheduler()
        return found

    def _look(self, shares: Shares) -> list[Row]:
        """Who came and who went. Returns rows of cases that are given up."""
        self._looked = time.monotonic()
        there = self._present()
        self._welcome({address: threads for address, threads in there.items() if address not in self._workers})
        for task in (task for worker in self._workers.values() for task in worker.tasks.values()):
            self._check(task.future)
        gone = self._workers.keys() - there.keys()
        if not gone:
            return []
        found = list(self._back(shares, _LOOK / 4))  # what they sent before
        for address in gone:
            found += self._lost(shares, address)
        return found

    def _check(self, future: Future) -> None:
        """Raise what a worker raised; one that died is seen otherwise."""
        if future.status == "cancelled":
            raise self._no_scheduler()
        error: Any = future.exception() if future.status == "error" else None
        if error is not None and not isinstance(error, KilledWorker):
            raise error

    def _no_scheduler(self) -> InputError:
        return InputError(f"the scheduler {self.where} is gone: the same command goes on where it was")

    def _welcome(self, new: dict[str, int]) -> None:
        """Those of the same versions, with one thread."""
        new = {address: threads for address, threads in new.items() if address not in self._refused}
        if not new:
            return
        mine = identity()
        try:
            own: Any = self.client.run(identity, workers=list(new), on_error="return")
        except (OSError, KeyError):  # one of them is gone again
            return
        for address, threads in new.items():
            reason = _unfit(address, threads, own.get(address), mine)
            if reason:
                self._refused[address] = reason
            elif address in own:
                self._workers[address] = _Worker()

    def _occupy(self, shares: Shares) -> None:
        """A task under way and one that waits for everybody; no more than one where it takes long."""
        for address, worker in self._workers.items():
            while len(worker.tasks) < 1 + (worker.pace < _AIM):
                asked = shares.take(address, max(1, min(_MOST, int(_AIM / max(worker.pace, 1e-9)))))
                if not asked:
                    return
                self._give(address, worker, asked)

    def _give(self, address: str, worker: _Worker, asked: list[Asked]) -> None:
        case, number = asked[0].case, self._given
        self._given += 1
        scene = f"{self._topic} {case.scene} {case.scheme}"
        parcel = None if worker.scene == scene else self._parcel(case)
        worker.scene = scene
        message = pickle.dumps(Message(self._topic, number, scene, parcel, asked))
        future = self.client.submit(
            measure, message, key=f"{self._topic}-{number}", workers=[address], allow_other_workers=False, pure=False
        )
        worker.tasks[number] = _Task({own.key: own for own in asked}, future)

    def _parcel(self, case: Case) -> Parcel:
        config = jax.config.values
        keep = bool(config["jax_enable_compilation_cache"] and config["jax_compilation_cache_dir"])
        pickled = pickle.dumps((self.scenes.study, self.scenes.scene(case), self.scenes.views(case)))
        return Parcel(pickled, self._modules, bool(config["jax_enable_x64"]), keep)

    def _back(self, shares: Shares, seconds: float) -> list[Row]:
        """Rows that came back; those of tasks that were given up are not waited for any more."""
        found, heard = [], []
        with suppress(Empty):
            heard.append(self._heard.get(timeout=seconds))
            time.sleep(_GATHER)
            while True:
                heard.append(self._heard.get_nowait())
        whose = {number: worker for worker in self._workers.values() for number in worker.tasks}
        for number, text in heard:
            if number in whose and number in whose[number].tasks:
                found += _taken(whose[number], number, text, shares)
        return found

    def _lost(self, shares: Shares, address: str) -> list[Row]:
        """What a worker had goes back; the case that it died of is given up if it is not the first."""
        worker, found = self._workers.pop(address), []
        shares.leave(address)
        left = [(task, list(task.asked.values())) for task in worker.tasks.values()]
        for k, (task, asked) in enumerate(left):
            task.future.release()
            first = asked[0]
            if k == 0:
                self._deaths[first.key] += 1
                if self._deaths[first.key] >= _TRIES:
                    found.append(_failed(first))
                    asked = asked[1:]
            shares.put_back(asked)
        return found


def _taken(worker: _Worker, number: int, text: str | None, shares: Shares) -> list[Row]:
    """The row that a worker sent, of one of its tasks; or none, if it does not have the scene any more."""
    asked, row = worker.tasks[number].asked, None
    if text is None:  # another study was there in between
        worker.scene = ""
        shares.put_back(asked.values())
        asked.clear()
    else:
        row = json.loads(text)
        del asked[row["case"]]
        worker.pace = row["seconds"]
    if not asked:
        del worker.tasks[number]
    return [] if row is None else [row]


def _failed(asked: Asked) -> Row:
    said = f"the worker that measured it died, {_TRIES} times (killed, or out of memory?)"
    return {"case": asked.key, "scene": asked.case.scene, REFUSED: said, FAILED: True}


def _unfit(address: str, threads: int, own: Any, mine: dict[str, str | None]) -> str:
    """Why a worker cannot make rows of this study; nothing if it can."""
    if isinstance(own, BaseException):
        return f"the worker {address} has no slefejax that it can run ({own}): install the same version there"
    for name in mine if isinstance(own, dict) else ():
        if own.get(name) != mine[name]:
            return (
                f"the worker {address} has {name} {own.get(name)} where this process has {mine[name]}: rows of a study"
                " are of one version"
            )
    if threads != 1:
        return f"the worker {address} has {threads} threads, and OpenGL takes one: start it with --nthreads 1"
    return ""


def sources(study: Study) -> dict[str, str]:
    """Files of methods of one's own in the folder that the command is run in, and of what they import from there."""
    here, found, waiting = Path.cwd(), {}, [type(rule.method).__module__ for rule in study.rules]
    named = [own if isinstance(own, str) else own["name"] for own in study.methods]
    waiting += [name.partition(":")[0] for name in named if ":" in name]
    seen = {"slefejax"}
    while waiting:
        name = waiting.pop()
        file = Path(getattr(sys.modules.get(name), "__file__", None) or "/")
        if name in seen or name.startswith("slefejax.") or not file.is_relative_to(here):
            continue
        seen.add(name)
        text = file.read_text()
        found[file.relative_to(here).as_posix()] = text
        waiting += [name.rpartition(".")[0], *_imported(text, sys.modules[name].__package__ or "")]
    return found


def _imported(text: str, package: str) -> Iterator[str]:
    """Names that a module imports; some of them may be no modules."""
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            whole = resolve_name("." * node.level + (node.module or ""), package) if node.level else node.module or ""
            yield from (whole, *(f"{whole}.{alias.name}" for alias in node.names))
