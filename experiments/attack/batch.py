"""One batch of ``slefejax attack``: nets of a family in hostile views, asked for in one way, judged.

A batch is made again from its family, setting and seed alone.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from slefejax import GregoryPatches
from slefejax.experiments.attack.claims import Claim, Rng, Scene, claim_of, claimed, rng_of, scene_of
from slefejax.experiments.attack.drawn import judged_levels
from slefejax.experiments.attack.families.products import ProductNets
from slefejax.experiments.attack.families.shaded import Shaded
from slefejax.experiments.attack.judge.search import ALLOWANCE, Found, judge_uniform
from slefejax.experiments.attack.settings import SETTINGS, Setting
from slefejax.experiments.store import Row

MOST_OFFENDERS = 3  # of a batch that are kept with all their numbers
_WORST = 1e300  # stands for an infinite ratio, which JSON does not have
_UNSEEN_CUT = 5  # cells a side, where the factor says that nothing is seen
_EXTRA = (0, 0, 0, 1, 2, 3)  # more cells a side than the factor asks for
_COMPARED = (8, 64)  # factors that are compared with minimal ones, one of every claim


def attack(family: str, setting: str, seed: int) -> Row:
    """Judge a batch.

    Returns ``pairs``, ``unseen``, ``without_normal``, ``refused``, ``violations``, the ``worst_ratio``,
    ``over_minimal`` (factors over minimal ones of some pairs) and ``offenders``, as many as are kept.
    """
    from slefejax.experiments.attack.climb import climb  # which is made of this module's parts

    asked, rng = SETTINGS[setting], rng_of(family, setting, seed)
    if asked.judged == "climb":
        return climb(family, asked, seed, rng)
    scene = scene_of(family, asked, seed, rng)
    return (_drawn if asked.judged == "drawn" else _uniform)(scene, asked, rng)


def _uniform(scene: Scene, setting: Setting, rng: Rng) -> Row:
    answers = [
        claimed(scene.patches, look, setting, rng) for look in scene.looks.values() for _ in range(setting.claims)
    ]
    claims = [claim for claim in answers if claim is not None]
    refused = len(scene.patches) * (len(answers) - len(claims))
    if not claims:
        return outcome([], [], refused=refused)
    judged = judged_uniform(claims, rng)
    return outcome(claims, judged[0], judged[1], refused=refused, over_minimal=_over_minimal(claims, rng))


def judged_uniform(
    claims: list[Claim], rng: Rng, extra: tuple[int, ...] = _EXTRA
) -> tuple[list[np.ndarray], list[Row]]:
    """The ratios of every claim, cut into ceil(factor) cells or a few more, and some offenders."""
    parts = [claim.judged() for claim in claims]
    whole = parts[0].joined(parts)
    factor = np.concatenate([claim.factor for claim in claims])
    cuts = _whole_cuts(factor, rng.choice(extra, len(factor)))
    found = judge_uniform(whole, np.stack([cuts, cuts], axis=1), int(rng.integers(2**31)))
    ratios, offenders, start = [], [], 0
    for claim in claims:
        own = slice(start, start + len(claim.patches))
        ratio, broken = decided(claim, Found(*(x[own] for x in found)))
        ratios.append(ratio)
        for k in broken:
            offenders.append(offender(claim, Found(*(x[own] for x in found)), k, float(ratio[k])))
            offenders[-1]["cut"] = int(cuts[own][k])
        start = own.stop
    return ratios, offenders[:MOST_OFFENDERS]


def _whole_cuts(factor: np.ndarray, extra: Any) -> np.ndarray:
    """n = ceil(factor) and some more; a few where nothing is said to be seen, or the factor is no number."""
    fit = np.isfinite(factor) & (factor > 0)
    return np.where(fit, np.ceil(np.where(fit, factor, 1.0)).astype(np.int64) + extra, _UNSEEN_CUT)


def decided(claim: Claim, found: Found) -> tuple[np.ndarray, list[int]]:
    """The ratios of a claim's patches, those above 1 with all digits, and which patches break it.

    Infinite where something is seen of what is said to be unseen, and where the factor is no number.
    """
    seen, factor = found.ratio >= 0, claim.factor
    ratio = np.where(seen, found.ratio, 0.0)
    for k in np.flatnonzero(np.isfinite(ratio) & (ratio > 1.0)):
        ratio[k] = claim.settled(int(k), found.triangle[k], found.share[k])
    ratio = np.where(~np.isfinite(factor) | (seen & (factor == 0)), np.inf, ratio)
    return ratio, np.flatnonzero((ratio > 1.0 + ALLOWANCE) & claim.own).tolist()


def _over_minimal(claims: list[Claim], rng: Rng) -> list[float]:
    """ceil(factor) over the smallest number that keeps the tolerance, of a patch of every claim."""
    found = []
    for claim in claims:
        fit = np.flatnonzero((claim.factor >= _COMPARED[0]) & (claim.factor <= _COMPARED[1]))
        if not fit.size:
            continue
        k = int(rng.choice(fit))
        n = int(np.ceil(claim.factor[k]))
        trials = np.arange(1, n + 1)
        one = claim.judged().only(np.full(n, k))
        ratio = judge_uniform(one, np.stack([trials, trials], axis=1)).ratio
        fine = trials[(ratio >= 0) & (ratio <= 1.0)]
        found += [n / int(fine[0])] if fine.size else []
    return found


def _drawn(scene: Scene, setting: Setting, rng: Rng) -> Row:
    """Every side is shared with one of some other patch, whose factor is any."""
    claims, ratios, offenders, refused, count = [], [], [], 0, len(scene.patches)
    for look in scene.looks.values():
        numbers = rng.permutation(4 * count).reshape(count, 4) // 2
        claim = claimed(scene.patches, look, setting, rng, numbers)
        if claim is None or not claim.own.any():
            refused += count * (claim is None)
            continue
        judged, drawn = judged_levels(claim.judged(), claim.found.inner, claim.found.edges)
        claim = claim._replace(own=claim.own & drawn)
        ratio, broken = decided(claim, judged)
        claims.append(claim)
        ratios.append(ratio)
        for k in broken[: MOST_OFFENDERS - len(offenders)]:
            own = _drawn_offender(claim, numbers, judged, k, float(ratio[k]))
            offenders.append(_with_neighbours_only(claim, numbers, k, setting) or own)
    return outcome(claims, ratios, offenders, refused=refused)


def _with_neighbours_only(claim: Claim, numbers: np.ndarray, k: int, setting: Setting) -> Row | None:
    """The offender among its neighbours alone, if it is one there."""
    own = np.append(k, np.setdiff1d(np.flatnonzero(np.isin(numbers, numbers[k]).any(axis=1)), k))
    few = np.unique(numbers[own], return_inverse=True)[1].reshape(-1, 4)
    smaller = claim_of(claim.patches[own], claim.own[own], claim.look, setting, claim.tolerances, few)
    if smaller is None:
        return None
    judged, _ = judged_levels(smaller.judged(), smaller.found.inner, smaller.found.edges)
    ratio, broken = decided(smaller, judged)
    return _drawn_offender(smaller, few, judged, 0, float(ratio[0])) if 0 in broken else None


def _drawn_offender(claim: Claim, numbers: np.ndarray, judged: Found, k: int, ratio: float) -> Row:
    """All patches of the scene: neighbours have a say in levels."""
    scene = {**_lists(claim.patches), "which": k, "edge_numbers": numbers.tolist()}
    levels = {"inner": claim.found.inner.tolist(), "edges": claim.found.edges.tolist()}
    return {**offender(claim, judged, k, ratio), **scene, **levels}


def outcome(
    claims: list[Claim],
    ratios: list[np.ndarray],
    offenders: list[Row] | None = None,
    *,
    refused: int = 0,
    over_minimal: list[float] | None = None,
) -> Row:
    """What a batch found, from the ratios of all claims."""
    pairs = list(zip(claims, ratios, strict=True))
    ratio = np.concatenate([np.zeros(0), *(own[claim.own] for claim, own in pairs)])
    unseen = sum(int(np.sum(claim.own & (claim.factor == 0))) for claim in claims)
    without = sum(int(np.sum(claim.own & claim.without)) for claim in claims)
    return {
        "pairs": len(ratio) - unseen - without,
        "unseen": unseen,
        "without_normal": without,
        "refused": refused,
        "violations": int(np.sum(ratio > 1.0 + ALLOWANCE)),
        "worst_ratio": float(np.max(np.minimum(ratio, _WORST), initial=0.0)),
        "over_minimal": over_minimal or [],
        "offenders": offenders or [],
    }


def _lists(patches: Any) -> Row:
    """Control points, twists of Gregory patches, tangent patches, and what Gaussian products are made of."""
    if isinstance(patches, GregoryPatches):
        return _lists(patches.net) | {"twists": patches.twists.astype(np.float64).tolist()}
    if isinstance(patches, Shaded):
        tangents = [own.astype(np.float64).tolist() for own in (patches.along_u, patches.along_v)]
        return _lists(patches.net) | {"tangents": tangents}
    if isinstance(patches, ProductNets):
        numbers = {name: getattr(patches, name).tolist() for name in ("gaussians", "scale", "offset")}
        return _lists(patches.patches()) | {"products": numbers}
    return {"patches": patches.astype(np.float64).tolist()}


def offender(claim: Claim, found: Found, k: int, ratio: float) -> Row:
    """All numbers of a violation: the patch, the claim, and the worst place, a triangle and the shares in it."""
    factor = float(claim.factor[k])
    return {
        **_lists(claim.patches[k : k + 1]),
        "look": list(claim.look),
        "tolerances": list(claim.tolerances),
        "factor": factor if np.isfinite(factor) else None,
        "triangle": found.triangle[k].tolist(),
        "share": found.share[k].tolist(),
        "ratio": min(ratio, _WORST),
    }
