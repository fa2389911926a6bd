"""The last line of a run of the tests: what it came to, in words, below pytest's own summary."""

from __future__ import annotations

import re
import time
from collections import Counter
from pathlib import Path
from typing import Any

import pytest

_START = time.monotonic()
_SLOW = pytest.StashKey[int]()
_PEAK = pytest.StashKey[int]()
_WHOLE = pytest.StashKey[bool]()
_FAILED = ("failed", "error")


def pytest_deselected(items: list[pytest.Item]) -> None:
    """Count the slow tests that were left out; with several processes each of them sees all."""
    if items:
        left = sum(item.get_closest_marker("slow") is not None for item in items)
        items[0].config.stash[_SLOW] = items[0].config.stash.get(_SLOW, 0) + left


def pytest_sessionfinish(session: pytest.Session, exitstatus: int) -> None:
    """Note whether the run came to its end; a worker process tells how many tests it left out."""
    session.config.stash[_WHOLE] = exitstatus in (pytest.ExitCode.OK, pytest.ExitCode.TESTS_FAILED)
    told = getattr(session.config, "workeroutput", None)
    if told is not None:
        told["slow_tests_left_out"] = session.config.stash.get(_SLOW, 0)
        told["peak"] = peak_memory()


@pytest.hookimpl(optionalhook=True)
def pytest_testnodedown(node: Any, error: Any) -> None:
    """Hear what a worker process left out. (A hook of pytest-xdist.)"""
    told = getattr(node, "workeroutput", {})
    for key, name in ((_SLOW, "slow_tests_left_out"), (_PEAK, "peak")):
        node.config.stash[key] = max(told.get(name, 0), node.config.stash.get(key, 0))


def pytest_unconfigure(config: pytest.Config) -> None:
    """Print the line, in the process that the terminal belongs to."""
    reporter = config.pluginmanager.get_plugin("terminalreporter")
    if reporter is None or hasattr(config, "workerinput") or config.option.collectonly:
        return
    counts = {name: len(reports) for name, reports in reporter.stats.items()}
    reasons = Counter(_reason(report) for report in reporter.stats.get("skipped", ()))
    slow, seconds = config.stash.get(_SLOW, 0), time.monotonic() - _START
    if line := closing_line(counts, reasons, slow, seconds, config.stash.get(_WHOLE, False)):
        if peak := max(config.stash.get(_PEAK, 0), peak_memory()):
            reporter.write_line(f"The largest process had {peak / 1e6:.1f} GB.")
        reporter.write_line(line)


def peak_memory() -> int:
    """The most that this process has had, kB; 0 where that is not told."""
    status = Path("/proc/self/status")
    return int(re.findall(r"VmHWM:\s+(\d+) kB", status.read_text())[0]) if status.exists() else 0


def closing_line(counts: dict[str, int], reasons: Counter[str], slow: int, seconds: float, whole: bool = True) -> str:
    """What a run came to; nothing if no test was run.

    counts  : tests by outcome, as pytest names them;  reasons : of skipped tests, with their numbers
    slow    : tests that were left out because they are slow;  seconds : how long it took
    whole   : whether the run came to its end
    """
    failed, passed = sum(counts.get(name, 0) for name in _FAILED), counts.get("passed", 0)
    skipped = sum(reasons.values())
    if not failed + passed + skipped:
        return ""
    if failed:
        said = [f"Something is wrong: {failed:,} of {failed + passed:,} tests failed (why stands above)"]
    elif not whole:
        said = [f"The run was broken off (why stands above): {_tests(passed)} had passed"]
    else:
        said = [f"All is well: {_tests(passed)} passed"]
    if skipped:
        why = "; ".join(
            f"{count:,}: {reason}" if len(reasons) > 1 else reason for reason, count in reasons.most_common()
        )
        said.append(f"{skipped:,} {'was' if skipped == 1 else 'were'} skipped ({why})")
    if slow:
        said.append(f"{slow:,} slow {'one is' if slow == 1 else 'ones are'} left for `make slow`")
    minutes, rest = divmod(round(seconds), 60)
    return f"{', '.join(said)}; {f'{minutes} min ' * (minutes > 0)}{rest} s."


def _tests(count: int) -> str:
    return f"{count:,} {'test' if count == 1 else 'tests'}"


def _reason(report: Any) -> str:
    """Why a test was skipped, in its own words."""
    said = report.longrepr[2] if isinstance(report.longrepr, tuple) else str(report.longrepr)
    return said.removeprefix("Skipped: ").strip() or "no reason was given"
