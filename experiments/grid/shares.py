"""Who measures which cases: a worker keeps to a scene and a view for as long as there are cases of it."""

from __future__ import annotations

from collections import Counter, deque
from collections.abc import Iterable
from itertools import groupby

from slefejax.experiments.grid.sights import Asked

_Run = deque[Asked]  # cases of one scene in one view, which share what is costly


class Shares:
    """Cases that nobody has begun.

    >>> from slefejax import Study
    >>> cases = Study(("teapot",), {"cameras": 2}, tolerances_px=(0.5, 1.0)).cases()
    >>> shares = Shares(Asked(str(k), case, ()) for k, case in enumerate(cases))
    >>> [[asked.key for asked in shares.take(worker, 1)] for worker in ("a", "b", "a", "b", "a")]
    [['0'], ['2'], ['1'], ['3'], []]
    """

    def __init__(self, asked: Iterable[Asked]) -> None:
        self._waiting: dict[tuple[str, str], deque[_Run]] = {}  # by scene and scheme
        self._own: dict[str, _Run] = {}
        self._at: dict[str, tuple[str, str]] = {}
        for _, several in groupby(asked, key=lambda own: own.case[:3]):
            self._wait(deque(several), last=True)

    def __bool__(self) -> bool:
        return bool(self._waiting) or any(self._own.values())

    def take(self, worker: str, most: int) -> list[Asked]:
        """The next cases for a worker, ``most`` of them or fewer, of one scene and one view; none if there are none."""
        run = self._own.get(worker) or self._begun(worker)
        return [run.popleft() for _ in range(min(most, len(run)))]

    def put_back(self, asked: Iterable[Asked]) -> None:
        """Cases that were taken and not measured, of one scene and one view: they are the next of that scene."""
        self._wait(deque(asked), last=False)

    def leave(self, worker: str) -> None:
        """A worker that takes no more: others go on with what it kept to."""
        self._at.pop(worker, None)
        self.put_back(self._own.pop(worker, ()))

    def _wait(self, run: _Run, last: bool) -> None:
        if run:
            waiting = self._waiting.setdefault(run[0].case[:2], deque())
            waiting.append(run) if last else waiting.appendleft(run)

    def _begun(self, worker: str) -> _Run:
        """What a worker keeps to from now on: more of its scene, else of one that few are at, or half of another's."""
        if self._waiting:
            crowd = Counter(self._at.values())
            at = self._at.get(worker)
            of = at if at in self._waiting else min(self._waiting, key=lambda own: crowd[own])
            waiting = self._waiting[of]
            self._own[worker], self._at[worker] = waiting.popleft(), of
            if not waiting:
                del self._waiting[of]
        else:
            longest = max(self._own.values(), key=len, default=deque())
            half = [longest.pop() for _ in range((len(longest) + 1) // 2)]
            self._own[worker] = deque(reversed(half))
        return self._own[worker]
