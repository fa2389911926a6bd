"""What is claimed of hostile patches: scenes made by a seed, tolerances that leave no slack, factors."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from slefejax import Factors
from slefejax.experiments.attack.judge import Look, Screen
from slefejax.experiments.attack.nets import DEGREES, moved, nets
from slefejax.experiments.attack.settings import Setting, predicted
from slefejax.experiments.attack.views import VIEWS, elsewhere

Rng = np.random.Generator
Ask = Callable[[float], Factors | None]

_GUESS, _DEPTH_GUESS = 0.5, 1e-4  # tolerances that factors are first asked for with
_ANY = 1e9  # a tolerance that plays no part
_ASKED, _TUNED = 9, 2  # how often a tolerance is tried at most, and changed where a factor says by how much
_LESS = 1e-3  # times a tolerance for which all factors are 1
_HAIR = 1e-2  # what a factor that was tuned may still be too large by
_SELDOM, _MORE = 0.1, 4.0  # how often levels are so many times those of the setting


class Scene(NamedTuple):
    """Patches of a batch as they are asked for, and the views of them by name."""

    patches: Any
    looks: dict[str, Look]


class Claim(NamedTuple):
    """What was predicted for patches in one view.

    tolerances : of pixels, and of depth or None
    own        : ``(patches,)``, false for those that stand in for others, whose factors are too large to judge
    """

    patches: Any
    look: Look
    tolerances: tuple[float, float | None]
    found: Factors
    own: np.ndarray

    @property
    def factor(self) -> np.ndarray:
        """Real factors, ``(patches,)``."""
        return np.asarray(self.found.factor, np.float64)

    def screen(self) -> Screen:
        """For the judge."""
        return Screen.of(self.patches, self.look, *self.tolerances)


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
    own = nets(family, rng, degrees_of(seed), reliefs)
    scale = 10.0 ** (rng.uniform(-3.0, 3.0) * rng.integers(0, 2))
    offset = rng.integers(0, 2) * scale * 10.0 ** rng.uniform(0.0, 5.0) * rng.normal(size=3)
    patches = moved(own, scale, offset).astype(setting.dtype)
    return Scene(patches, {name: elsewhere(make(rng), scale, offset) for name, make in VIEWS.items()})


def claimed(
    patches: Any, look: Look, setting: Setting, rng: Rng, edge_numbers: np.ndarray | None = None
) -> Claim | None:
    """Factors for tolerances with which one of the patches needs just a whole number of cells.

    Mostly one of the setting's levels, seldom more. Of claims with a tolerance of depth half hold pixels to nothing.
    Returns None where factors are refused.
    """
    n = level_of(setting, rng) * (_MORE if rng.uniform() < _SELDOM and setting.judged != "drawn" else 1.0)
    share = rng.uniform(*setting.share)
    pixels, depth = _ANY, None
    if setting.depth:
        depth = tuned(lambda t: predicted(patches, look, setting.plain, _ANY, t), _DEPTH_GUESS, n, share)
    if not setting.depth or rng.integers(2):
        pixels = tuned(lambda t: predicted(patches, look, setting.plain, t, depth and _ANY), _GUESS, n, share)
    if pixels is None or (setting.depth and depth is None):
        return None
    chosen, own = affordable(patches, look, setting, (pixels, depth))
    if not own.any():
        return claim_of(chosen, own, look, setting.plain, (pixels, depth))
    return claim_of(chosen, own, look, setting, (pixels, depth), edge_numbers)


def level_of(setting: Setting, rng: Rng) -> float:
    """A whole number of cells between those of the setting."""
    return float(np.rint(np.exp(rng.uniform(*np.log(setting.levels)))))


def claim_of(
    patches: Any,
    own: np.ndarray,
    look: Look,
    setting: Setting,
    tolerances: tuple[float, float | None],
    edge_numbers: np.ndarray | None = None,
) -> Claim | None:
    """The claim for given tolerances, None where it is refused."""
    found = predicted(patches, look, setting, *tolerances, edge_numbers)
    return None if found is None else Claim(patches, look, tolerances, found, own)


def affordable(
    patches: Any, look: Look, setting: Setting, tolerances: tuple[float, float | None]
) -> tuple[Any, np.ndarray]:
    """Patches, others in the place of those whose factors take too much time, and which are there themselves.

    None are where all would take too much: beside the eye no tolerance makes factors small.
    """
    own = np.ones(len(patches), bool)
    found = predicted(patches, look, setting.plain, *tolerances) if np.isfinite(setting.most) else None
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
        seen = np.sort(factor[np.isfinite(factor) & (factor > 0.0)])
        if not seen.size:
            break
        value = float(seen[int(share * len(seen))])
        if changed >= _TUNED and not n < value < n * (1.0 + _HAIR):
            break
        # a factor of 1 says nothing of how much less would do
        guess *= (value / n) ** 2 * (1.0 + float(np.finfo(factor.dtype).eps)) if value > 1.0 else _LESS
        changed += value > 1.0
    return guess


def tolerance_for(patches: Any, look: Look, setting: Setting, rng: Rng) -> float | None:
    """One with which the middle one of the factors is one of the setting's levels; None where refused."""
    return tuned(lambda t: predicted(patches, look, setting.plain, t), _GUESS, level_of(setting, rng), 0.5)
