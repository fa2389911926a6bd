"""What was found for items before: of those that are as they were, it is not computed again."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

_BASE = 128  # above the numbers that go with an item, such as levels of patches that are drawn whole


class Found(NamedTuple):
    """Results by keys, which are in order where they are looked up."""

    keys: Int[np.ndarray, "n"]
    results: Float[np.ndarray, "n"]


_NOTHING = Found(np.zeros(0, np.int64), np.zeros(0))


class Memory:
    """Results by item and by up to five whole numbers below 128 that go with it.

    >>> memory = Memory()
    >>> first = memory.recall("grids", np.array([0, 1]), [np.array([3, 5])], lambda own: own + 0.5)
    >>> later = memory.after(np.array([True, False]))                   # the second item has changed
    >>> later.recall("grids", np.array([0, 1]), [np.array([3, 5])], lambda own: own + 0.25).tolist()
    [0.5, 1.25]
    """

    def __init__(self) -> None:
        self._known: dict[str, Found] = {}
        self._asked: dict[str, list[Found]] = {}
        self._places: dict[str, int] = {}

    def recall(
        self,
        kind: str,
        item: Int[np.ndarray, "n"],
        more: list[Int[np.ndarray, "n"]],
        find: Callable[[Int[np.ndarray, "m"]], Float[np.ndarray, "m"]],
    ) -> Float[np.ndarray, "n"]:
        """The results for items and numbers: those that are known, and what ``find`` makes of the others' indices."""
        keys = item.astype(np.int64)
        for own in more:
            keys = keys * _BASE + own
        results, missing = np.empty(len(keys)), np.ones(len(keys), bool)
        known = self._known.get(kind, _NOTHING)
        if len(known.keys):
            at = np.minimum(np.searchsorted(known.keys, keys), len(known.keys) - 1)
            missing = known.keys[at] != keys
            results[~missing] = known.results[at[~missing]]
        own = np.flatnonzero(missing)
        results[own] = find(own)
        self._asked.setdefault(kind, []).append(Found(keys, results))
        self._places[kind] = len(more)
        return results

    def after(self, same: Bool[np.ndarray, "items"]) -> Memory:
        """What is still known when only those items are as they were: of what was asked for last."""
        later = Memory()
        later._places = dict(self._places)
        for kind, places in self._places.items():
            asked = self._asked.get(kind) or [self._known[kind]]
            keys, results = (np.concatenate(parts) for parts in zip(*asked, strict=True))
            kept = same[keys // _BASE**places]
            keys, first = np.unique(keys[kept], return_index=True)
            later._known[kind] = Found(keys, results[kept][first])
        return later
