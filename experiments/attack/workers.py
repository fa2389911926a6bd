"""Batches of work on several processes: results come back one by one, and a worker that dies takes nothing with it."""

from __future__ import annotations

import multiprocessing
import os
import signal
import time
from collections.abc import Callable, Iterator
from multiprocessing.connection import Connection, wait
from typing import Any, NamedTuple

from slefejax.errors import InputError

Task = tuple[Any, ...]
_SPAWN = multiprocessing.get_context("spawn")


def results(
    work: Callable[..., Any],
    prepare: Callable[[], None],
    next_task: Callable[[list[Task]], Task | None],
    workers: int,
) -> Iterator[tuple[Task, Any]]:
    """(task, ``work(*task)``) as they are done, in no certain order.

    work, prepare : functions of modules, which every process imports; ``prepare`` runs there first
    next_task     : hears what is under way; None if there is nothing more to do
    workers       : processes; 1: this one

    A task whose process dies is tried once more; InputError if that dies too. Leaving the loop ends the processes.
    """
    if workers == 1:
        while (task := next_task([])) is not None:
            yield task, work(*task)
        return
    crew = _Crew(work, prepare)
    try:
        for k in range(workers):
            crew.hire(_core(k))
        yield from crew.results(next_task)
    finally:
        crew.dismiss()


def _core(k: int) -> list[int]:
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    return [cores[k % len(cores)]] if cores else []


class _Worker(NamedTuple):
    process: Any
    pipe: Connection
    cores: list[int]


class _Crew:
    """Processes, those that are free and those that are at work, by their pipes."""

    def __init__(self, work: Callable[..., Any], prepare: Callable[[], None]) -> None:
        self.work, self.prepare = work, prepare
        self.free: list[_Worker] = []
        self.busy: dict[Connection, tuple[_Worker, Task]] = {}
        self.again: list[Task] = []
        self.failed: set[Task] = set()

    def hire(self, cores: list[int]) -> None:
        """Start a process."""
        own, other = _SPAWN.Pipe()
        process = _SPAWN.Process(target=_serve, args=(other, self.work, self.prepare, cores), daemon=True)
        process.start()
        other.close()
        self.free.append(_Worker(process, own, cores))

    def results(self, next_task: Callable[[list[Task]], Task | None]) -> Iterator[tuple[Task, Any]]:
        """As they come; ends when nothing is left to do."""
        while self._occupied(next_task):
            for pipe in wait(list(self.busy)):
                assert isinstance(pipe, Connection)
                worker, task = self.busy.pop(pipe)
                try:
                    found = pipe.recv()
                except (EOFError, ConnectionError):
                    self._replace(worker, task)
                    continue
                self.free.append(worker)
                if isinstance(found, Exception):
                    raise found
                yield task, found

    def _occupied(self, next_task: Callable[[list[Task]], Task | None]) -> bool:
        """Give work to whoever is free; whether anybody has some."""
        while self.free:
            task = self.again.pop() if self.again else next_task([own for _, own in self.busy.values()])
            if task is None:
                break
            worker = self.free.pop()
            try:
                worker.pipe.send(task)
            except ConnectionError:
                self._replace(worker, task)
                continue
            self.busy[worker.pipe] = (worker, task)
        return bool(self.busy)

    def _replace(self, worker: _Worker, task: Task) -> None:
        """Another process for one that died."""
        worker.process.join(1.0)
        if task in self.failed:
            raise InputError(
                f"the process for {task} died twice (exit code {worker.process.exitcode}): is there enough memory?"
                " The same command goes on where it was"
            )
        self.failed.add(task)
        self.again.append(task)
        self.hire(worker.cores)

    def dismiss(self) -> None:
        """End all processes."""
        for worker in [*self.free, *(worker for worker, _ in self.busy.values())]:
            worker.pipe.close()
            worker.process.terminate()
            worker.process.join()


def _serve(pipe: Connection, work: Any, prepare: Any, cores: list[int]) -> None:
    """What a process does: one task after the other, on a core of its own, until nobody listens."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # whoever started it says when to end
    if cores and hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, cores)
    prepare()
    while True:
        try:
            task = pipe.recv()
            try:
                found = work(*task)
            except Exception as error:
                found = error
            pipe.send(found)
        except (EOFError, ConnectionError):
            return


def until(hours: float | None) -> Callable[[], bool]:
    """Whether time is over, so many hours from now; None: never."""
    end = float("inf") if hours is None else time.monotonic() + 3600.0 * hours
    return lambda: time.monotonic() >= end
