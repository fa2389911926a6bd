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


class _Worker(NamedTuple):
    process: Any
    pipe: Connection


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
    yield from _on_processes(work, prepare, next_task, workers)


def _on_processes(work: Any, prepare: Any, next_task: Any, workers: int) -> Iterator[tuple[Task, Any]]:
    cores = sorted(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else []
    free = [_started(work, prepare, cores[k : k + 1]) for k in range(workers)]
    busy: dict[Connection, tuple[_Worker, Task, list[int]]] = {}
    failed: dict[Task, int] = {}
    again: list[Task] = []
    try:
        while True:
            while free:
                task = again.pop() if again else next_task([own for _, own, _ in busy.values()])
                if task is None:
                    break
                worker = free.pop()
                worker.pipe.send(task)
                busy[worker.pipe] = (worker, task, cores)
            if not busy:
                return
            for pipe in wait(list(busy)):
                assert isinstance(pipe, Connection)
                worker, task, _ = busy.pop(pipe)
                try:
                    found = pipe.recv()
                except (EOFError, ConnectionError):
                    failed[task] = failed.get(task, 0) + 1
                    _check_not_again(task, failed[task], worker)
                    again.append(task)
                    free.append(_started(work, prepare, cores[len(free) % max(1, len(cores)) :][:1]))
                    continue
                free.append(worker)
                if isinstance(found, Exception):
                    raise found
                yield task, found
    finally:
        for worker in [*free, *(worker for worker, _, _ in busy.values())]:
            worker.pipe.close()
            worker.process.terminate()
            worker.process.join()


def _check_not_again(task: Task, times: int, worker: _Worker) -> None:
    worker.process.join(1.0)
    if times > 1:
        raise InputError(
            f"the process for {task} died twice (exit code {worker.process.exitcode}): is there enough memory?"
            " The same command goes on where it was"
        )


def _started(work: Any, prepare: Any, cores: list[int]) -> _Worker:
    own, other = _SPAWN.Pipe()
    process = _SPAWN.Process(target=_serve, args=(other, work, prepare, cores), daemon=True)
    process.start()
    other.close()
    return _Worker(process, own)


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
