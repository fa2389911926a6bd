"""The climber of ``slefejax attack``: control points are moved towards the worst ratio, many nets side by side."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from slefejax.experiments.attack_batch import Claim, judged_uniform, outcome
from slefejax.experiments.attack_judge import Look, Screen
from slefejax.experiments.attack_nets import DEGREES, nets
from slefejax.experiments.attack_settings import Setting, predicted
from slefejax.experiments.attack_views import VIEWS
from slefejax.experiments.store import Row

STEPS = 200
_LEAST, _MOST = 3.0, 60.0  # factors that climbers stay between
_ALIGNED = 4  # of the best climbers, each judged with a tolerance that makes its factor just a whole number
_LONGER, _SHORTER = 1.5, 0.9  # steps after one that went up and one that did not
_MOVED = 0.4  # of the control points, a step


class Climbers(NamedTuple):
    """Nets, their scores and how far they step."""

    nets: np.ndarray
    score: np.ndarray
    stride: np.ndarray


def climb(family: str, setting: Setting, seed: int, rng: np.random.Generator) -> Row:
    """A few hundred steps of random ascent in one view.

    The score of a net is what its ratio would be if its factor were a whole number: error n^2/(tolerance factor^2).
    Every step is judged like any other pair; in the end the tolerance is fitted to the best.
    """
    reliefs = 10.0 ** (rng.uniform(-1.0, 0.0) + rng.uniform(-0.3, 0.3, setting.patches))
    own = nets(family, rng, DEGREES[seed % len(DEGREES)], reliefs)
    look = list(VIEWS.values())[int(rng.integers(len(VIEWS)))](rng)
    tolerance = _tolerance(own, look, setting, float(np.exp(rng.uniform(np.log(6.0), np.log(24.0)))))
    if tolerance is None:
        return outcome(refused=setting.patches)
    climbers = Climbers(own, np.full(len(own), -1.0), np.full(len(own), 0.1))
    ratios, offenders, refused, unseen = [np.zeros(0)], [], 0, 0
    for step in range(STEPS):
        trial = climbers.nets if step == 0 else _stepped(climbers, rng)
        claim = _claim(trial, look, setting, tolerance)
        if claim is None:
            refused += len(trial)
            continue
        ratio, found = _judged(trial, claim, rng)
        climbers = _kept(climbers, trial, _scores(ratio, claim.factor))
        ratios.append(ratio)
        offenders += found
        unseen += int(np.sum(claim.factor == 0))
    for k in np.argsort(-climbers.score)[:_ALIGNED]:
        claim = _aligned(climbers.nets, int(k), look, setting, tolerance)
        if claim is not None:
            ratio, found = _judged(climbers.nets[k : k + 1], claim._replace(factor=claim.factor[k : k + 1]), rng)
            ratios.append(ratio)
            offenders += found
    return outcome(np.concatenate(ratios), offenders[:3], unseen=unseen, refused=refused)


def _tolerance(patches: np.ndarray, look: Look, setting: Setting, n: float) -> float | None:
    found = predicted(patches, look, setting, 0.5)
    if found is None:
        return None
    factor = np.asarray(found.factor, np.float64)
    seen = factor[np.isfinite(factor) & (factor > 1.0)]
    return 0.5 * (float(np.median(seen)) / n) ** 2 if seen.size else 0.5


def _claim(patches: np.ndarray, look: Look, setting: Setting, tolerance: float) -> Claim | None:
    found = predicted(patches, look, setting, tolerance)
    return None if found is None else Claim(look, (tolerance, None), np.asarray(found.factor, np.float64))


def _judged(patches: np.ndarray, claim: Claim, rng: np.random.Generator) -> tuple[np.ndarray, list[Row]]:
    return judged_uniform(patches, [claim], Screen.of(patches, claim.look, *claim.tolerances), claim.factor, rng, (0,))


def _stepped(climbers: Climbers, rng: np.random.Generator) -> np.ndarray:
    """Some control points moved; weights by a factor."""
    size = climbers.stride[:, None, None, None] * (rng.uniform(size=climbers.nets.shape[:3]) < _MOVED)[..., None]
    moves = rng.normal(size=climbers.nets.shape)
    if climbers.nets.shape[3] == 3:
        return climbers.nets + size * moves
    weights = climbers.nets[..., 3:]
    places = climbers.nets[..., :3] / weights + size * moves[..., :3]
    weights = weights * np.exp(size * moves[..., 3:])
    return np.concatenate([places * weights, weights], axis=3)


def _scores(ratio: np.ndarray, factor: np.ndarray) -> np.ndarray:
    fit = (factor >= _LEAST) & (factor <= _MOST)
    return np.where(fit, ratio * (np.ceil(factor) / np.where(fit, factor, 1.0)) ** 2, -1.0)


def _kept(climbers: Climbers, trial: np.ndarray, score: np.ndarray) -> Climbers:
    up = score > climbers.score
    stride = np.clip(climbers.stride * np.where(up, _LONGER, _SHORTER), 1e-5, 0.5)
    return Climbers(np.where(up[:, None, None, None], trial, climbers.nets), np.maximum(score, climbers.score), stride)


def _aligned(patches: np.ndarray, k: int, look: Look, setting: Setting, tolerance: float) -> Claim | None:
    """The claim for a tolerance with which the factor of one patch is a whole number, or a hair below."""
    claim = _claim(patches, look, setting, tolerance)
    for _ in range(4):
        if claim is None or not claim.factor[k] > 1.0:
            return None
        n = np.rint(claim.factor[k])
        tolerance *= float(claim.factor[k] / n) ** 2 * (1.0 + 1e-12)
        claim = _claim(patches, look, setting, tolerance)
    return claim
