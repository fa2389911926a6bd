"""The climber of ``slefejax attack``: control points are moved towards the worst ratio, many nets side by side."""

from __future__ import annotations

from typing import Any, NamedTuple

import jax
import numpy as np

from slefejax import GregoryPatches
from slefejax.experiments.attack.batch import MOST_OFFENDERS, judged_uniform, outcome
from slefejax.experiments.attack.claims import Claim, Rng, claim_of, degrees_of, tolerance_for
from slefejax.experiments.attack.families.nets import nets
from slefejax.experiments.attack.families.products import ProductNets
from slefejax.experiments.attack.judge.screen import Look
from slefejax.experiments.attack.settings import Setting, Tolerances
from slefejax.experiments.attack.views import VIEWS
from slefejax.experiments.store import Row

STEPS = 200
_LEAST, _MOST = 3.0, 60.0  # factors that climbers stay between
_ALIGNED = 4  # of the best climbers, each judged with a tolerance that makes its factor just a whole number
_ASKED = 5  # times for that tolerance
_LONGER, _SHORTER = 1.5, 0.9  # steps after one that went up and one that did not
_MOVED = 0.4  # of the control points, a step


class Climbers(NamedTuple):
    """Nets, their scores and how far they step."""

    nets: Any
    score: np.ndarray
    stride: np.ndarray


def climb(family: str, setting: Setting, seed: int, rng: Rng) -> Row:
    """A few hundred steps of random ascent in one view.

    The score of a net is what its ratio would be if its factor were a whole number: error n^2/(tolerance factor^2).
    Every step is judged like any other pair; in the end the tolerance is fitted to the best.
    """
    reliefs = 10.0 ** (rng.uniform(-1.0, 0.0) + rng.uniform(-0.3, 0.3, setting.patches))
    own = nets(family, rng, degrees_of(seed), reliefs)
    look = list(VIEWS.values())[int(rng.integers(len(VIEWS)))](rng)
    tolerance = tolerance_for(own, look, setting, rng)
    if tolerance is None:
        return outcome([], [], refused=setting.patches)
    climbers = Climbers(own, np.full(len(own), -1.0), np.full(len(own), 0.1))
    claims: list[Claim] = []
    everyone = np.ones(len(own), bool)
    ratios, offenders, refused = [], [], 0
    for step in range(STEPS):
        trial = climbers.nets if step == 0 else _stepped(climbers, rng)
        claim = claim_of(trial, everyone, look, setting, Tolerances(tolerance))
        if claim is None:
            refused += len(trial)
            continue
        ratio, found = judged_uniform([claim], rng, (0,))
        climbers = _kept(climbers, trial, _scores(ratio[0], claim.factor))
        claims, ratios, offenders = [*claims, claim], ratios + ratio, offenders + found
    for k in np.argsort(-climbers.score)[:_ALIGNED]:
        claim = _aligned(climbers.nets[k : k + 1], look, setting, tolerance)
        if claim is not None:
            ratio, found = judged_uniform([claim], rng, (0,))
            claims, ratios, offenders = [*claims, claim], ratios + ratio, offenders + found
    return outcome(claims, ratios, offenders[:MOST_OFFENDERS], refused=refused)


def _stepped(climbers: Climbers, rng: Rng) -> Any:
    """Some control points moved, twists too; weights by a factor; Gaussians and their means."""
    if isinstance(climbers.nets, GregoryPatches):
        twists = climbers.nets.twists
        size = climbers.stride[:, None, None] * (rng.uniform(size=twists.shape[:2]) < _MOVED)[..., None]
        net = _stepped(climbers._replace(nets=climbers.nets.net), rng)
        return GregoryPatches(net, twists + size * rng.normal(size=twists.shape))
    if isinstance(climbers.nets, ProductNets):
        count = len(climbers.nets)
        moved = rng.uniform(size=(count, 4, 4, 1)) < _MOVED
        return climbers.nets.stepped(rng, climbers.stride[:, None, None, None] * moved)
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


def _kept(climbers: Climbers, trial: Any, score: np.ndarray) -> Climbers:
    up = score > climbers.score
    stride = np.clip(climbers.stride * np.where(up, _LONGER, _SHORTER), 1e-5, 0.5)
    chosen = jax.tree.map(lambda x, y: np.where(up.reshape(-1, *[1] * (x.ndim - 1)), x, y), trial, climbers.nets)
    return Climbers(chosen, np.maximum(score, climbers.score), stride)


def _aligned(patch: Any, look: Look, setting: Setting, tolerance: float) -> Claim | None:
    """The claim for a tolerance with which the factor of a patch is a whole number, or a hair below."""
    # as many as ever, so that nothing new is compiled
    patches, first = patch[np.zeros(setting.patches, np.int64)], np.arange(setting.patches) == 0
    claim = claim_of(patches, first, look, setting, Tolerances(tolerance))
    for _ in range(_ASKED):
        if claim is None or not claim.factor[0] > 1.0:
            return None
        n = np.rint(claim.factor[0])
        tolerance *= float(claim.factor[0] / n) ** 2 * (1.0 + 1e-12)
        claim = claim_of(patches, first, look, setting, Tolerances(tolerance))
    return claim
