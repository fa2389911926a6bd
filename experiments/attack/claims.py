"""What is claimed of hostile patches: scenes made by a seed, tolerances that leave no slack, factors."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from slefejax import Factors
from slefejax.experiments.attack.families.nets import DEGREES, RATIONAL, moved, nets
from slefejax.experiments.attack.families.steep import STEEP_FAMILIES, STEEP_RATIONAL, steep_nets
from slefejax.experiments.attack.judge import normals, screen
from slefejax.experiments.attack.judge.screen import Look
from slefejax.experiments.attack.judge.search import Judged
from slefejax.experiments.attack.settings import Setting, Tolerances, predicted
from slefejax.experiments.attack.views import VIEWS, elsewhere

Rng = np.random.Generator
Ask = Callable[[float], Factors | None]

_GUESS, _DEPTH_GUESS = 0.5, 1e-4  # tolerances that factors are first asked for with
_ANY = 1e9  # a tolerance that plays no part
_ASKED, _TUNED = 9, 2  # how often a tolerance is tried at most, and changed where a factor says by how much
_LESS = 1e-3  # times a tolerance for which all factors are 1
_HAIR = 1e-2  # what a factor that was tuned may still be too large by
_MOST_POLYNOMIAL, _MOST_RATIONAL = 8, 6  # degrees whose normals have one of at most 16
_DEGREES = 0.05, 20.0  # between which tolerances of normals are drawn
_MOST_DEGREES = 60.0
_SELDOM, _MORE = 0.1, 4.0  # how often levels are so many times those of the setting


class Scene(NamedTuple):
    """Patches of a batch as they are asked for, and the views of them by name."""

    patches: Any
    looks: dict[str, Look]


class Claim(NamedTuple):
    """What was predicted for patches in one view.

    own    : ``(patches,)``, false for those that stand in for others, whose factors are too large to judge
    hidden : whether normals are claimed where they are not seen, too
    """

    patches: Any
    look: Look
    tolerances: Tolerances
    found: Factors
    own: np.ndarray
    hidden: bool

    @property
    def factor(self) -> np.ndarray:
        """Real factors, ``(patches,)``."""
        return np.asarray(self.found.factor, np.float64)

    @property
    def without(self) -> np.ndarray:
        """Which patches are seen, but have no claim on normals, ``(patches,)``; none where none is asked for."""
        without = self.found.without_normal
        return np.zeros(len(self.patches), bool) if without is None else np.asarray(without) & (self.factor > 0.0)

    def judged(self) -> Judged:
        """For the judge: normals where there is a tolerance for them, else positions."""
        degrees = self.tolerances.degrees
        if degrees is None:
            return screen.Screen.of(self.patches, self.look, *self.tolerances[:2])
        counted = (self.factor > 0.0) & ~self.without
        return normals.Normals.of(self.patches, self.look, degrees, counted, hidden=self.hidden)

    def settled(self, k: int, triangle: np.ndarray, share: np.ndarray) -> float:
        """The ratio of a patch at a place, with all digits."""
        patch, degrees = self.patches[[k]], self.tolerances.degrees
        position = screen.settled(patch, self.look, self.tolerances[:2], triangle, share)
        if degrees is None or (position < 0.0 and not self.hidden):
            return position
        return normals.settled(patch, degrees, triangle, share)


def rng_of(family: str, setting: str, seed: int) -> Rng:
    """The numbers of a batch."""
    return np.random.default_rng([seed, crc32(family.encode()), crc32(setting.encode())])


def degrees_of(seed: int) -> tuple[int, int]:
    """All batches of a seed have one bi-degree, so that few programs are compiled."""
    return DEGREES[seed % len(DEGREES)]


def scene_of(family: str, setting: Setting, seed: int, rng: Rng) -> Scene:
    """Patches and views of a batch; single precision is tried with flat nets too."""
    reliefs = 10.0 ** (rng.uniform(-1.5, 0.3) + rng.uniform(-0.4, 0.4, setting.patches))
    if setting.judged == "drawn":
        reliefs *= 10.0 ** (rng.uniform(-3.0, 0.0) * rng.uniform(0.0, 1.0, setting.patches))
    if setting.single and rng.integers(2):
        reliefs *= 10.0 ** rng.uniform(-5.0, 0.0)
    own = _nets(family, setting, seed, rng, reliefs)
    scale = 10.0 ** (rng.uniform(-3.0, 3.0) * rng.integers(0, 2))
    offset = rng.integers(0, 2) * scale * 10.0 ** rng.uniform(0.0, 5.0) * rng.normal(size=3)
    patches = moved(own, scale, offset).astype(setting.dtype)
    return Scene(patches, {name: elsewhere(make(rng), scale, offset) for name, make in VIEWS.items()})


def _nets(family: str, setting: Setting, seed: int, rng: Rng, reliefs: np.ndarray) -> Any:
    degrees = degrees_of(seed)
    if not setting.normals:
        return nets(family, rng, degrees, reliefs)
    most = _MOST_RATIONAL if family in (RATIONAL, STEEP_RATIONAL) else _MOST_POLYNOMIAL
    degrees = min(degrees[0], most), min(degrees[1], most)
    if family in STEEP_FAMILIES:
        return steep_nets(family, rng, degrees, len(reliefs))
    return nets(family, rng, degrees, reliefs)


def claimed(
    patches: Any, look: Look, setting: Setting, rng: Rng, edge_numbers: np.ndarray | None = None
) -> Claim | None:
    """Factors for tolerances with which one of the patches needs just a whole number of cells.

    Mostly one of the setting's levels, seldom more. Of claims with a tolerance of depth half hold pixels to nothing.
    Returns None where factors are refused.
    """
    tolerances = _tolerances(patches, look, setting, rng)
    if tolerances is None:
        return None
    chosen, own = affordable(patches, look, setting, tolerances)
    if not own.any():
        return claim_of(chosen, own, look, setting.plain, tolerances)
    return claim_of(chosen, own, look, setting, tolerances, edge_numbers)


def _tolerances(patches: Any, look: Look, setting: Setting, rng: Rng) -> Tolerances | None:
    if setting.normals:
        return _of_normals(patches, look, setting, rng)
    n = level_of(setting, rng) * (_MORE if rng.uniform() < _SELDOM and setting.judged != "drawn" else 1.0)
    share = rng.uniform(*setting.share)
    pixels, depth = _ANY, None
    if setting.depth:
        depth = tuned(lambda t: predicted(patches, look, setting.plain, Tolerances(_ANY, t)), _DEPTH_GUESS, n, share)
    if not setting.depth or rng.integers(2):
        with_depth = depth and _ANY
        pixels = tuned(lambda t: predicted(patches, look, setting.plain, Tolerances(t, with_depth)), _GUESS, n, share)
    return None if pixels is None or (setting.depth and depth is None) else Tolerances(pixels, depth)


def _of_normals(patches: Any, look: Look, setting: Setting, rng: Rng) -> Tolerances | None:
    """A tolerance between .05 and 20 degrees, and then the next with which a patch needs just a whole number."""

    def ask(degrees: float) -> Factors | None:
        found = predicted(patches, look, setting.plain, Tolerances(_ANY, None, degrees))
        return None if found is None else _with_normals(found)

    degrees, share = float(np.exp(rng.uniform(*np.log(_DEGREES)))), rng.uniform(*setting.share)
    found = ask(degrees)
    if found is None:
        return None
    value = _at_share(np.asarray(found.factor), share)
    tuned_to = tuned(ask, degrees, np.rint(value), share) if value > 1.0 else degrees
    return None if tuned_to is None else Tolerances(_ANY, None, min(tuned_to, _MOST_DEGREES))


def _with_normals(found: Factors) -> Factors:
    """Factors, 0 where there is no claim on normals."""
    without = np.asarray(found.without_normal)
    return replace(found, factor=np.where(without, 0.0, np.asarray(found.factor)))


def _at_share(factor: np.ndarray, share: float) -> float:
    """The factor that this share of those on the screen is below; 0 if none is there."""
    seen = np.sort(factor[np.isfinite(factor) & (factor > 0.0)])
    return float(seen[int(share * len(seen))]) if seen.size else 0.0


def level_of(setting: Setting, rng: Rng) -> float:
    """A whole number of cells between those of the setting."""
    return float(np.rint(np.exp(rng.uniform(*np.log(setting.levels)))))


def claim_of(
    patches: Any,
    own: np.ndarray,
    look: Look,
    setting: Setting,
    tolerances: Tolerances,
    edge_numbers: np.ndarray | None = None,
) -> Claim | None:
    """The claim for given tolerances, None where it is refused."""
    found = predicted(patches, look, setting, tolerances, edge_numbers)
    return None if found is None else Claim(patches, look, tolerances, found, own, setting.hidden)


def affordable(patches: Any, look: Look, setting: Setting, tolerances: Tolerances) -> tuple[Any, np.ndarray]:
    """Patches, others in the place of those whose factors take too much time, and which are there themselves.

    None are where all would take too much: beside the eye no tolerance makes factors small.
    """
    own = np.ones(len(patches), bool)
    found = predicted(patches, look, setting.plain, tolerances) if np.isfinite(setting.most) else None
    if found is None:
        return patches, own
    own = np.asarray(found.factor, np.float64) <= setting.most
    few = np.flatnonzero(own)
    if not few.size:
        return patches, own
    return patches[np.where(own, np.arange(len(own)), few[np.arange(len(own)) % len(few)])], own


def tuned(ask: Ask, guess: float, n: float, share: float) -> float | None:
    """A tolerance with which the patch at that share of the factors needs n, or a hair less; None where refused."""
    changed = 0
    for _ in range(_ASKED):
        found = ask(guess)
        if found is None:
            return None
        factor = np.asarray(found.factor)
        value = _at_share(factor, share)
        if value == 0.0:
            break
        if changed >= _TUNED and not n < value < n * (1.0 + _HAIR):
            break
        # a factor of 1 says nothing of how much less would do
        guess *= (value / n) ** 2 * (1.0 + float(np.finfo(factor.dtype).eps)) if value > 1.0 else _LESS
        changed += value > 1.0
    return guess


def tolerance_for(patches: Any, look: Look, setting: Setting, rng: Rng) -> float | None:
    """One with which the middle one of the factors is one of the setting's levels; None where refused."""
    return tuned(lambda t: predicted(patches, look, setting.plain, Tolerances(t)), _GUESS, level_of(setting, rng), 0.5)
