"""Measurements of one stage, in a process of their own for every number of cores.

A process that merely may not use all cores still has a thread for each of them, which take turns: JAX is up to a fifth
slower there than where it found one core from the beginning, as on a computer that has only one.
"""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from functools import lru_cache
from multiprocessing import get_context
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import jax
import numpy as np

from slefejax.errors import InputError, NoOpenGLError, OpenGLError
from slefejax.experiments.bench.stages import OPENGL, STAGES, Setting, Work
from slefejax.experiments.store import Row
from slefejax.gpu import Device, open_device

PRECISIONS = {"single": np.float32, "double": np.float64}
_FEWEST, _MOST = 3, 25  # runs
_NO_PEER = {"peer": "", "peer_ms": float("nan"), "peer_ratio": float("nan"), "difference": float("nan")}


class Worker:
    """A process on so many cores that measures what it is asked to; to be used in a ``with`` statement."""

    def __init__(self, cores: int, seconds: float) -> None:
        context = get_context("spawn")
        self.cores = cores
        self._pipe, theirs = context.Pipe()
        self._process = context.Process(target=_serve, args=(theirs, seconds), daemon=True)
        with on_cores(cores):
            self._process.start()
        theirs.close()

    def __enter__(self) -> Worker:
        return self

    def __exit__(self, *_: object) -> None:
        self._process.kill()
        self._process.join()

    def rows(self, stage: str, count: int, precision: str, with_peers: bool) -> list[Row]:
        """A row for every peer, or one without. Raises what was raised there, and InputError if the process ended."""
        try:
            self._pipe.send((stage, count, precision, with_peers))
            answer = self._pipe.recv()
        except (EOFError, OSError):
            raise InputError(
                f"the process that measured {stage} of {count:,} patches ended, perhaps for want of memory: "
                "leave the largest --counts out"
            ) from None
        if isinstance(answer, BaseException):
            raise answer
        return [row | {"cores": self.cores} for row in answer]


def _serve(pipe: Connection, seconds: float) -> None:
    """What the process does until it is killed, or nobody asks any more. Ctrl-C is for the one who asks."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_enable_compilation_cache", False)  # first calls are measured too
    with suppress(EOFError, OSError):
        while True:
            stage, count, precision, with_peers = pipe.recv()
            try:
                pipe.send(_rows(stage, count, precision, with_peers, seconds))
            except (InputError, OpenGLError, MemoryError) as error:
                pipe.send(error)


def _rows(stage: str, count: int, precision: str, with_peers: bool, seconds: float) -> list[Row]:
    if stage in OPENGL and the_device() is None:
        return []
    work = STAGES[stage](_setting(count, precision))
    jax.clear_caches()
    base = {"stage": stage, "count": count, "items": work.items, "unit": work.unit, "precision": precision}
    base |= {"device": jax.default_backend(), **_measured(work, seconds)}
    peers = work.peers if with_peers else {}
    return [base | _beside(work, name, seconds) for name in peers] or [base | _NO_PEER]


@lru_cache(maxsize=1)
def _setting(count: int, precision: str) -> Setting:
    return Setting(count, PRECISIONS[precision], the_device())


@lru_cache(maxsize=1)
def the_device() -> Device | None:
    """The OpenGL device of this process; without one its stages are left out."""
    try:
        return open_device()
    except NoOpenGLError:
        return None


def _measured(work: Work, seconds: float) -> Row:
    """Median and spread, the first call's excess, and how much memory it took besides what was there."""
    before = _reset_peak()
    first = _seconds(work.run)
    times: list[float] = []
    while len(times) < _FEWEST or (len(times) < _MOST and sum(times) < seconds):
        times.append(_seconds(work.run))
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


def _beside(work: Work, peer: str, seconds: float) -> Row:
    """The peer and the stage in turn; their results must agree."""
    other = work.peers[peer]
    found = _difference(work, other)
    ratios, others = [], []
    start = time.perf_counter()
    while len(ratios) < _FEWEST or (len(ratios) < _MOST and time.perf_counter() - start < seconds):
        own, theirs = (_seconds(each) for each in (work.run, other))
        ratios.append(theirs / own)
        others.append(theirs)
    medians = {"peer_ms": 1e3 * float(np.median(others)), "peer_ratio": float(np.median(ratios))}
    return {"peer": peer, **medians, "difference": found}


def _seconds(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    jax.block_until_ready(run())
    return time.perf_counter() - start


def _difference(work: Work, other: Callable[[], Any]) -> float:
    """The largest difference of both results, over the largest entry. Raises InputError if they do not agree."""
    results = jax.block_until_ready((work.run(), other()))
    if work.same is None:
        return float("nan")
    own, theirs = (work.same(result) for result in results)
    if own is None or theirs is None:
        return float("nan")
    found = float(np.max(np.abs(np.asarray(own, np.float64) - theirs)) / max(float(np.max(np.abs(theirs))), 1e-300))
    if not found <= work.close:
        raise InputError(f"a stage and its peer differ by {found:.1e}: the benchmark compares different things")
    return found


@contextmanager
def on_cores(count: int) -> Iterator[None]:
    """This thread, and processes that it starts, on so many of its cores, where the system can do that."""
    if not hasattr(os, "sched_setaffinity"):
        yield
        return
    whole = os.sched_getaffinity(0)
    os.sched_setaffinity(0, set(sorted(whole)[:count]))
    try:
        yield
    finally:
        os.sched_setaffinity(0, whole)


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
