"""One batch of ``slefejax attack``: nets of a family in hostile views, asked for in one way, judged.

A batch is made again from its family, setting and seed alone.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple
from zlib import crc32

import numpy as np

from slefejax.experiments.attack_drawn import judged_levels
from slefejax.experiments.attack_judge import ALLOWANCE, Found, Look, Screen, judge_uniform, settled
from slefejax.experiments.attack_nets import DEGREES, moved, nets
from slefejax.experiments.attack_settings import SETTINGS, Setting, predicted
from slefejax.experiments.attack_views import VIEWS, elsewhere
from slefejax.experiments.store import Row

MOST_OFFENDERS = 3  # of a batch that are kept with all their numbers
_GUESS = 0.5  # the tolerance that factors are first asked for with
_DEPTH_GUESS = 1e-4
_ANY = 1e9  # a tolerance that plays no part
_WORST = 1e300  # stands for an infinite ratio, which JSON does not have
_UNSEEN_CUT = 5  # cells a side, where the factor says that nothing is seen
_EXTRA = (0, 0, 0, 1, 2, 3)  # more cells a side than the factor asks for
_COMPARED = (8, 64)  # factors that are compared with minimal ones
_SAMPLES = 2  # of every view that are


class Scene(NamedTuple):
    """Patches of a batch as they are asked for, and the views of them by name."""

    patches: np.ndarray
    looks: dict[str, Look]


class Claim(NamedTuple):
    """What was predicted for all patches in one view, and the tolerances."""

    look: Look
    tolerances: tuple[float, float | None]
    factor: np.ndarray


def rng_of(family: str, setting: str, seed: int) -> np.random.Generator:
    """The numbers of a batch."""
    return np.random.default_rng([seed, crc32(family.encode()), crc32(setting.encode())])


def attack(family: str, setting: str, seed: int) -> Row:
    """Judge a batch.

    Returns pairs, unseen, refused, violations, the worst ratio, ``over_minimal`` (factors over minimal ones of some
    pairs) and ``offenders``, as many as are kept.
    """
    from slefejax.experiments.attack_climb import climb  # which is made of batches' parts

    asked = SETTINGS[setting]
    rng = rng_of(family, setting, seed)
    if asked.judged == "climb":
        return climb(family, asked, seed, rng)
    scene = scene_of(family, asked, seed, rng)
    if asked.judged == "drawn":
        return _drawn(scene, asked, rng)
    return _uniform(scene, asked, rng)


def scene_of(family: str, setting: Setting, seed: int, rng: np.random.Generator) -> Scene:
    """Patches and views. All families of a seed have one bi-degree, so that few programs are compiled.

    Single precision is tried with flat nets, and away from the origin.
    """
    reliefs = 10.0 ** (rng.uniform(-1.5, 0.3) + rng.uniform(-0.4, 0.4, setting.patches))
    if setting.judged == "drawn":
        reliefs *= 10.0 ** rng.uniform(-3.0, 0.0, setting.patches)
    hard = setting.single and rng.integers(2)
    if hard:
        reliefs *= 10.0 ** rng.uniform(-5.0, 0.0)
    own = nets(family, rng, DEGREES[seed % len(DEGREES)], reliefs)
    scale = 10.0 ** (rng.uniform(-3.0, 3.0) * rng.integers(0, 2))
    offset = np.zeros(3)
    if rng.integers(2) or hard:
        offset = rng.normal(size=3) * scale * 10.0 ** rng.uniform(0.0, 5.0)
    patches = moved(own, scale, offset).astype(setting.dtype)
    looks = {name: elsewhere(make(rng), scale, offset) for name, make in VIEWS.items()}
    return Scene(patches, looks)


# --- uniform grids --------------------------------------------------------------------------------------------------


def _uniform(scene: Scene, setting: Setting, rng: np.random.Generator) -> Row:
    answers = [claimed(scene.patches, look, setting, rng) for look in scene.looks.values()]
    claims = [claim for claim in answers if claim is not None]
    refused = len(scene.patches) * (len(answers) - len(claims))
    if not claims:
        return outcome(refused=refused)
    screen = Screen.joined([Screen.of(scene.patches, claim.look, *claim.tolerances) for claim in claims])
    factor = np.concatenate([claim.factor for claim in claims])
    judged = judged_uniform(scene.patches, claims, screen, factor, rng)
    over_minimal = _over_minimal(screen, factor, len(scene.patches), rng)
    return outcome(*judged, unseen=int(np.sum(factor == 0)), refused=refused, over_minimal=over_minimal)


def judged_uniform(
    patches: np.ndarray,
    claims: list[Claim],
    screen: Screen,
    factor: np.ndarray,
    rng: np.random.Generator,
    extra: tuple[int, ...] = _EXTRA,
) -> tuple[np.ndarray, list[Row]]:
    """The ratios of all pairs, claim after claim, cut into ceil(factor) cells or a few more, and some offenders."""
    cuts = whole_cuts(np.where(np.isfinite(factor), factor, 0.0), rng.choice(extra, len(factor)))
    found = judge_uniform(screen, np.stack([cuts, cuts], axis=1), int(rng.integers(2**31)))
    ratio = judged_ratios(found, factor)
    offenders = []
    for pair in np.flatnonzero(ratio > 1.0 + ALLOWANCE):
        claim, k = claims[pair // len(patches)], pair % len(patches)
        place = found.triangle[pair], found.share[pair]
        if np.isfinite(ratio[pair]):
            ratio[pair] = settled(patches[k], claim.look, claim.tolerances, *place)
        if ratio[pair] > 1.0 + ALLOWANCE and len(offenders) < MOST_OFFENDERS:
            offenders.append(offender(patches[k : k + 1], claim, float(factor[pair]), place, float(ratio[pair])))
            offenders[-1]["cut"] = int(cuts[pair])
    return ratio, offenders


def claimed(patches: np.ndarray, look: Look, setting: Setting, rng: np.random.Generator) -> Claim | None:
    """Factors for tolerances with which one of the patches needs just a whole number of cells.

    Mostly one of the setting's levels, seldom more; None where factors are refused. Of those with a tolerance of depth
    half hold pixels to nothing.
    """
    n = float(np.rint(np.exp(rng.uniform(*np.log(setting.levels))) * (1.0 if rng.uniform() < 0.9 else 4.0)))
    share, only_depth = rng.uniform(0.4, 0.9), setting.depth and bool(rng.integers(2))
    pixels, depth = _ANY, None
    if setting.depth:
        depth = _tuned(lambda t: predicted(patches, look, setting, _ANY, t), _DEPTH_GUESS, n, share)
        if depth is None:
            return None
    if not only_depth:
        pixels = _tuned(lambda t: predicted(patches, look, setting, t, depth and _ANY), _GUESS, n, share)
    found = None if pixels is None else predicted(patches, look, setting, pixels, depth)
    if found is None or pixels is None:
        return None
    return Claim(look, (pixels, depth), np.asarray(found.factor, np.float64))


def _tuned(ask: Callable[[float], Any], guess: float, n: float, share: float) -> float | None:
    """A tolerance with which the patch at that share of the factors needs n; None where they are refused."""
    for _ in range(2):
        found = ask(guess)
        if found is None:
            return None
        factor = np.asarray(found.factor, np.float64)
        seen = np.sort(factor[np.isfinite(factor) & (factor > 1.0)])
        if not seen.size:
            break
        guess *= float(seen[int(share * len(seen))] / n) ** 2
    return guess


def whole_cuts(factor: np.ndarray, extra: Any) -> np.ndarray:
    """n = ceil(factor) and some more; a few where nothing is said to be seen."""
    return np.where(factor > 0, np.ceil(factor).astype(np.int64) + extra, _UNSEEN_CUT)


def judged_ratios(found: Found, factor: np.ndarray) -> np.ndarray:
    """Ratios; infinite where something is seen of what is said to be unseen, and where the factor is no number."""
    seen = found.ratio >= 0
    ratio = np.where(seen, found.ratio, 0.0)
    return np.where(~np.isfinite(factor) | (seen & (factor == 0)), np.inf, ratio)


def _over_minimal(screen: Screen, factor: np.ndarray, patches: int, rng: np.random.Generator) -> list[float]:
    """ceil(factor) over the smallest number that keeps the tolerance, of some pairs of every view."""
    found = []
    fit = np.flatnonzero((factor >= _COMPARED[0]) & (factor <= _COMPARED[1]))
    chosen = [own[:_SAMPLES] for own in _by_view(rng.permutation(fit), patches)]
    for pair in np.concatenate(chosen).astype(int) if chosen else []:
        n = int(np.ceil(factor[pair]))
        one = screen.only([pair])
        trials = np.arange(1, n + 1)
        many = Screen(*(np.repeat(x, n, axis=0) for x in one[:2]), screen.compared)
        ratio = judge_uniform(many, np.stack([trials, trials], axis=1)).ratio
        fine = trials[(ratio >= 0) & (ratio <= 1.0)]
        found += [n / int(fine[0])] if fine.size else []
    return found


def _by_view(pairs: np.ndarray, patches: int) -> list[np.ndarray]:
    view = pairs // patches
    return [pairs[view == k] for k in np.unique(view)]


# --- drawn triangles ------------------------------------------------------------------------------------------------


def _drawn(scene: Scene, setting: Setting, rng: np.random.Generator) -> Row:
    ratios, offenders, refused, unseen = [np.zeros(0)], [], 0, 0
    count = len(scene.patches)
    for look in scene.looks.values():
        numbers = rng.permutation(4 * count).reshape(count, 4) // 2
        tolerance = _tolerance_for_levels(scene.patches, look, setting, rng)
        found = None
        if tolerance is not None:
            found = predicted(scene.patches, look, setting, tolerance, None, numbers)
        if found is None or tolerance is None:
            refused += count
            continue
        screen = Screen.of(scene.patches, look, tolerance)
        judged, drawn = judged_levels(screen, found.inner, found.edges)
        factor = np.asarray(found.factor, np.float64)
        ratio = judged_ratios(judged, factor)
        claim = Claim(look, (tolerance, None), factor)
        for k in np.flatnonzero(ratio > 1.0 + ALLOWANCE):
            place = judged.triangle[k], judged.share[k]
            if np.isfinite(ratio[k]):
                ratio[k] = settled(scene.patches[k], look, claim.tolerances, *place)
            if ratio[k] > 1.0 + ALLOWANCE and len(offenders) < MOST_OFFENDERS:
                own = offender(scene.patches, claim, float(factor[k]), place, float(ratio[k]))
                levels = {"inner": found.inner.tolist(), "edges": found.edges.tolist()}
                offenders.append({**own, "which": int(k), "edge_numbers": numbers.tolist(), **levels})
        unseen += int(np.sum(drawn & (factor == 0)))
        ratios.append(ratio[drawn])
    return outcome(np.concatenate(ratios), offenders, unseen=unseen, refused=refused)


def _tolerance_for_levels(patches: np.ndarray, look: Look, setting: Setting, rng: np.random.Generator) -> float | None:
    """One with which the larger factors are about what the setting wants; None where factors are refused."""
    wanted = np.exp(rng.uniform(*np.log(setting.levels)))
    found = predicted(patches, look, setting, _GUESS)
    if found is None:
        return None
    factor = np.asarray(found.factor, np.float64)
    seen = factor[np.isfinite(factor) & (factor > 1.0)]
    return _GUESS * (float(np.quantile(seen, 0.9)) / wanted) ** 2 if seen.size else _GUESS


# --- outcomes -------------------------------------------------------------------------------------------------------


def outcome(
    ratio: np.ndarray | None = None,
    offenders: list[Row] | None = None,
    *,
    unseen: int = 0,
    refused: int = 0,
    over_minimal: list[float] | None = None,
) -> Row:
    """What a batch found; ``ratio``: of every pair that was judged."""
    ratio = np.zeros(0) if ratio is None else ratio
    return {
        "pairs": len(ratio) - unseen,
        "unseen": unseen,
        "refused": refused,
        "violations": int(np.sum(ratio > 1.0 + ALLOWANCE)),
        "worst_ratio": float(np.max(np.minimum(ratio, _WORST), initial=0.0)),
        "over_minimal": over_minimal or [],
        "offenders": offenders or [],
    }


def offender(
    patches: np.ndarray, claim: Claim, factor: float, place: tuple[np.ndarray, np.ndarray], ratio: float
) -> Row:
    """All numbers of a violation: the patches, the claim, and the worst place, a triangle and the shares in it."""
    return {
        "patches": patches.astype(np.float64).tolist(),
        "look": list(claim.look),
        "tolerances": list(claim.tolerances),
        "factor": factor if np.isfinite(factor) else None,
        "triangle": place[0].tolist(),
        "share": place[1].tolist(),
        "ratio": min(ratio, _WORST),
    }
