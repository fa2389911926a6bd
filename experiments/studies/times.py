"""How long things take."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping

import numpy as np


def taking_turns(calls: Mapping[str, Callable[[], object]], repeats: int) -> dict[str, tuple[float, float]]:
    """Median and spread, in milliseconds, of the times of calls that take turns: what slows a machine slows all."""
    times: dict[str, list[float]] = {name: [] for name in calls}
    for _ in range(repeats):
        for name, call in calls.items():
            times[name].append(milliseconds(call))
    return {name: (float(np.median(own)), float(np.ptp(own))) for name, own in times.items()}


def milliseconds(work: Callable[[], object]) -> float:
    """How long it takes."""
    start = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - start)
