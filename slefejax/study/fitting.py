"""Constants of predictions, k_m and others, fitted to measured minimal factors (docs/fitting.md).

The model is tau^2 = sum_j c_j t_j with terms t_j of ``study.samples`` and coefficients c_j >= 0: with the one term
m^2 w / tolerance it is the published estimate, k_m^2 its coefficient. Coefficients are fitted so that a given share,
the *target*, of the samples is safe, tau >= needed. The estimators:

largest        the cheapest coefficients with which every sample is safe: the largest ratio, needed over estimate, where
               there is one term; a linear program, least sum of tau^2 over needed^2, where there are more
quantile       least pinball loss of log(needed) - log(tau) at the target, smoothed by a temperature
least-squares  least squares of the same in log space, and then raised by as many of the residuals' standard deviations
               as a normal distribution needs for the target

A target of 1 is taken as 1 - 1/(2N) by the last two, N samples. Patches whose minimal factor is 1 are safe whatever the
constant; they are left out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Float
from scipy.optimize import linprog
from scipy.stats import norm

from slefejax.arguments import Number, check_choice, check_positive, is_whole
from slefejax.errors import InputError
from slefejax.study.samples import Samples, slefe_term

ESTIMATORS = ("largest", "quantile", "least-squares")
TEMPERATURE = 1e-3  # of the pinball loss, in units of log(tau): a tenth of a percent
_FIRST_TEMPERATURE = 1.0  # the loss is sharpened by tens from here
_COLDEST = 1e-9
_STEPS = 400
_SMALLEST = 1e-12  # a coefficient over what its term would need alone


@dataclass(frozen=True)
class Fit:
    """Fitted coefficients, and whether the fit can be trusted.

    terms        : names of terms, as in ``Samples.terms``
    coefficients : ``(terms,)``, of tau^2; infinite if no finite ones reach the target
    converged    : whether the solver ended where it should;  reason : if not, why, in words
    estimator, target, samples : what was fitted, and to how many samples
    """

    terms: tuple[str, ...]
    coefficients: Float[np.ndarray, "terms"]
    converged: bool
    reason: str
    estimator: str
    target: float
    samples: int

    @property
    def k(self) -> float:
        """The constant k_m: the square root of the first coefficient."""
        return float(np.sqrt(self.coefficients[0]))

    def factor(self, samples: Samples) -> Float[np.ndarray, "samples"]:
        """The real factors that the fitted model predicts, at least 1; NaN if there is no such model."""
        if not np.isfinite(self.coefficients).all():
            return np.full(len(samples), np.nan)
        return np.sqrt(np.maximum(1.0, samples.design(self.terms) @ self.coefficients))


def fit_km(
    samples: Samples,
    segments: int = 3,
    *,
    target: Number = 0.99,
    estimator: str = "quantile",
    more: Sequence[str] = (),
    temperature: Number = TEMPERATURE,
) -> Fit:
    """k_m, and coefficients of ``more`` terms, with which the target share of the samples is safe.

    samples     : from ``slefejax.measure_factors``
    target      : share of the samples, above 0, at most 1
    estimator   : largest, quantile or least-squares (module docstring)
    more        : terms besides ``slefe m``, such as ``"twist"``
    temperature : of the smoothed pinball loss, in units of log(tau)

    Returns a Fit with ``.k``, ``.coefficients``, ``.converged`` and ``.reason``. A fit that fails raises nothing and
    says so there; InputError is for wrong arguments, and for samples with nothing to fit.

    >>> rng = np.random.default_rng(1)
    >>> needed, n = np.exp(rng.normal(2.0, 0.5, 500)), np.zeros(500, int)
    >>> made = Samples(n, n, np.ceil(needed).astype(int), needed, {"slefe 3": (needed / 1.2) ** 2}, 0.5)
    >>> [round(fit_km(made, 3, estimator=e).k, 1) for e in ESTIMATORS]
    [1.2, 1.2, 1.2]
    """
    if not isinstance(more, (list, tuple)) or not all(isinstance(name, str) for name in more):
        raise InputError(f"more must be a list of names of terms, such as ['twist'], not {more!r}")
    names = (slefe_term(segments), *more)
    _check(target, estimator, temperature)
    chosen = _countable(samples, names)
    level = _level(float(target), len(chosen))
    if estimator == "largest":
        level = 1.0
    design, needed = chosen.design(names), chosen.needed
    reachable = np.any(design > 0, axis=1)
    hidden = 1.0 - float(reachable.mean())
    make = partial(Fit, names, estimator=estimator, target=float(target), samples=len(chosen))
    if hidden > 1.0 - level:
        what = f"{' and '.join(names)} {'are' if len(names) > 1 else 'is'} 0"
        reason = f"{100 * hidden:.3g} % of the samples need pieces though {what}"
        return make(coefficients=np.full(len(names), np.inf), converged=False, reason=reason)
    # those out of reach are unsafe whatever the constant, so the others have to make up for them
    design, needed = design[reachable], needed[reachable]
    level = 1.0 if estimator == "largest" else _level(level / (1.0 - hidden), len(needed))
    unit = _unit(design, needed)
    found, reason = _ESTIMATORS[estimator](design * unit, needed, level, float(temperature))
    return make(coefficients=found * unit, converged=not reason, reason=reason)


class Interval(NamedTuple):
    """A confidence interval of a constant."""

    low: float
    high: float


def bootstrap_km(
    samples: Samples,
    segments: int = 3,
    *,
    target: Number = 0.99,
    estimator: str = "quantile",
    temperature: Number = TEMPERATURE,
    resamples: int = 400,
    confidence: Number = 0.95,
    seed: int = 0,
) -> Interval:
    """The confidence interval of k_m by bootstrap over views: views are drawn with replacement, whole.

    resamples  : how many sets of views are drawn;  confidence : share of their constants that lie in the interval

    The constant of samples that are drawn never passes the largest ratio, so at a target of 1 the interval says how
    often that ratio is met, and nothing about larger ones. Other arguments and errors as of ``fit_km``.
    """
    names = (slefe_term(segments),)
    _check(target, estimator, temperature)
    check_positive("confidence", confidence)
    if not is_whole(resamples, 2) or not is_whole(seed, 0) or float(confidence) >= 1.0:
        raise InputError("a bootstrap needs two resamples or more, a seed from 0 on, a confidence between 0 and 1")
    chosen = _countable(samples, names)
    views, number = np.unique(chosen.view, return_inverse=True)
    rng = np.random.default_rng(seed)
    counts = rng.multinomial(len(views), np.full(len(views), 1.0 / len(views)), size=resamples)
    with np.errstate(divide="ignore"):
        ratios = np.log(chosen.needed) - 0.5 * np.log(chosen.design(names)[:, 0])
    order, level = np.argsort(ratios), _level(float(target), len(chosen))
    found = _resampled(ratios[order], counts[:, number[order]], level, estimator, temperature)
    tail = 50.0 * (1.0 - float(confidence))
    low, high = np.percentile(np.exp(found), [tail, 100.0 - tail], method="closest_observation")
    return Interval(float(low), float(high))


class HeldOut(NamedTuple):
    """How a model does in views that it was not fitted to; factors rounded up."""

    share_unsafe: float  # of the samples, with fewer pieces than the minimal factor
    over_minimal_median: float
    over_minimal_p95: float
    triangles_over_minimal: float


def held_out(samples: Samples, factors: Float[np.ndarray, "samples"]) -> HeldOut:
    """How real factors compare with the minimal ones of the same samples, those of minimal factor 1 left out.

    All NaN if a factor is. Raises InputError if every minimal factor is 1.
    """
    counted = samples.minimal > 1
    if np.shape(factors) != counted.shape:
        raise InputError(f"there are {len(counted)} samples and factors of shape {np.shape(factors)}")
    if not counted.any():
        raise InputError("every patch has a minimal factor of 1: there is nothing to compare with")
    minimal, whole = samples.minimal[counted], np.ceil(np.asarray(factors)[counted])
    ratio = whole / minimal
    return HeldOut(
        float(np.mean(whole < minimal)) if np.isfinite(whole).all() else float("nan"),
        float(np.median(ratio)),
        float(np.quantile(ratio, 0.95)),
        float(np.sum(whole**2) / np.sum(minimal**2)),
    )


def cross_validated(samples: Samples, folds: int = 5, **options: Any) -> tuple[Float[np.ndarray, "samples"], list[Fit]]:
    """Factors of every sample by a model that was fitted without the views of its fold, and the fits of the folds.

    folds   : sets that the views are divided into, at most as many as there are views; options : those of ``fit_km``
    """
    views = samples.views
    if not is_whole(folds, 2) or len(views) < 2:
        raise InputError("views are held out by turns: that needs two views and two folds at least")
    factors, fits = np.zeros(len(samples)), []
    for fold in range(min(folds, len(views))):
        own = np.isin(samples.view, views[fold::folds])
        fits.append(fit_km(samples.where(~own), **options))
        factors[own] = fits[-1].factor(samples.where(own))
    return factors, fits


def _check(target: Any, estimator: str, temperature: Any) -> None:
    check_choice("estimator", estimator, ESTIMATORS)
    check_positive("target", target)
    if float(target) > 1.0:
        raise InputError(f"the target is a share of the samples, at most 1, not {target}")
    check_positive("temperature", temperature)
    if not _COLDEST <= float(temperature) <= 1.0:
        raise InputError(f"the temperature of the loss is at least {_COLDEST:g} and at most 1, not {temperature}")


def _countable(samples: Samples, names: Sequence[str]) -> Samples:
    """The samples that say something, checked."""
    if not isinstance(samples, Samples):
        raise InputError(f"samples come from slefejax.measure_factors, not {type(samples).__name__}")
    design = samples.design(names)
    if not (np.isfinite(design).all() and np.isfinite(samples.needed).all() and design.min(initial=0) >= 0):
        raise InputError("samples must be finite numbers, none of them negative")
    counted = samples.minimal > 1
    if not counted.any():
        raise InputError("every patch has a minimal factor of 1: there is nothing to fit (ask for a finer tolerance)")
    return samples.where(counted)


def _level(target: float, count: int) -> float:
    return min(target, 1.0 - 0.5 / count)


def _unit(design: np.ndarray, needed: np.ndarray) -> np.ndarray:
    """What each coefficient would be about if its term were alone: so terms may have any scale."""
    with np.errstate(divide="ignore"):
        logs = 2.0 * np.log(needed)[:, None] - np.log(design)
    return np.exp([np.median(column[np.isfinite(column)]) if np.isfinite(column).any() else 0.0 for column in logs.T])


def _largest(design: np.ndarray, needed: np.ndarray, *_: float) -> tuple[np.ndarray, str]:
    shares = design / needed[:, None] ** 2
    if shares.shape[1] == 1:
        return 1.0 / shares.min(axis=0), ""
    found = linprog(shares.sum(axis=0), A_ub=-shares, b_ub=-np.ones(len(shares)), bounds=(0, None))
    if found.x is None:
        return np.full(shares.shape[1], np.nan), f"the linear program failed: {found.message}"
    # the program's own tolerance may leave a sample a trace below
    return found.x / min(1.0, float((shares @ found.x).min())), ""


def _quantile(design: np.ndarray, needed: np.ndarray, level: float, temperature: float) -> tuple[np.ndarray, str]:
    if design.shape[1] == 1:
        ratios = np.sort(np.log(needed) - 0.5 * np.log(design[:, 0]))
        found = _resampled(ratios, np.ones((1, len(ratios))), level, "quantile", temperature)
        return np.exp(2.0 * found), ""
    start, sharpness = np.zeros(design.shape[1]), _FIRST_TEMPERATURE
    while True:
        sharpness = max(temperature, sharpness / 10.0)
        found, reason, start = _descend(start, design, np.log(needed), level, sharpness)
        if sharpness == temperature or not np.isfinite(found).all():
            return found, reason


def _descend(
    start: np.ndarray, design: np.ndarray, log_needed: np.ndarray, level: float, temperature: float
) -> tuple[np.ndarray, str, np.ndarray]:
    """The least smoothed pinball loss, from logarithms of coefficients on: coefficients, what failed, logarithms."""
    with jax.enable_x64(True):
        arguments = tuple(jnp.asarray(x, jnp.float64) for x in (*_padded(design, log_needed), level, temperature))
        logs, slope, failed = (np.asarray(x) for x in _descend_jit(jnp.asarray(start), arguments))
    reason = "the solver took too many steps, or diverged" if int(failed) else ""
    if not np.isfinite(logs).all():
        return np.full(len(logs), np.nan), "the solver met a number that is not finite", start
    rest = float(np.max(np.abs(slope)))
    if not reason and rest > 2.0 / len(design):
        # more than two samples would have to change sides for it to vanish
        reason = f"the solver stopped where the loss still falls: its slope is {rest:.2g}"
    return np.where(logs < np.log(_SMALLEST), 0.0, np.exp(logs)), reason, logs


@jax.jit
def _descend_jit(start: Any, arguments: tuple[Any, ...]) -> tuple[Any, Any, Any]:
    solver = optx.BFGS(rtol=1e-9, atol=1e-9)
    found = optx.minimise(_pinball, solver, start, args=arguments, max_steps=_STEPS, throw=False)
    return found.value, jax.grad(_pinball)(found.value, arguments), found.result != optx.RESULTS.successful


def _pinball(logs: Any, arguments: tuple[Any, ...]) -> Any:
    """The mean of q x + T softplus(-x / T), x = log(needed) - log(tau): q x above 0, (q - 1) x below, smoothed."""
    design, log_needed, weight, level, temperature = arguments
    x = log_needed - 0.5 * jnp.log(design @ jnp.exp(logs))
    return jnp.sum(weight * (level * x + temperature * jax.nn.softplus(-x / temperature))) / jnp.sum(weight)


def _padded(design: np.ndarray, log_needed: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Both, and weights of 1, filled up with samples of weight 0, so that few sizes are compiled."""
    count = len(design)
    more = (1 << (count - 1).bit_length()) - count
    filled = np.concatenate([design, np.ones((more, design.shape[1]))]), np.concatenate([log_needed, np.zeros(more)])
    return *filled, np.concatenate([np.ones(count), np.zeros(more)])


def _least_squares(design: np.ndarray, needed: np.ndarray, level: float, _: float) -> tuple[np.ndarray, str]:
    with jax.enable_x64(True):
        arguments = tuple(jnp.asarray(x, jnp.float64) for x in _padded(design, np.log(needed)))
        start = jnp.full(design.shape[1], -np.log(design.shape[1]), jnp.float64)
        found, rest, failed = (np.asarray(x) for x in _squares_jit(start, arguments))
    reason = "the solver took too many steps, or diverged" if int(failed) else ""
    if not np.isfinite(found).all():
        return np.full(len(found), np.nan), "the solver met a number that is not finite"
    raised = norm.ppf(level) * float(np.std(rest[: len(design)]))
    return np.exp(found + 2.0 * raised), reason


@jax.jit
def _squares_jit(start: Any, arguments: tuple[Any, ...]) -> tuple[Any, Any, Any]:
    def residuals(logs: Any, arguments: tuple[Any, ...]) -> Any:
        design, log_needed, weight = arguments
        return weight * (log_needed - 0.5 * jnp.log(design @ jnp.exp(logs)))

    solver = optx.LevenbergMarquardt(rtol=1e-10, atol=1e-10)
    found = optx.least_squares(residuals, solver, start, args=arguments, max_steps=_STEPS, throw=False)
    return found.value, residuals(found.value, arguments), found.result != optx.RESULTS.successful


_ESTIMATORS = {"largest": _largest, "quantile": _quantile, "least-squares": _least_squares}


def _resampled(
    ratios: np.ndarray, weights: np.ndarray, level: float, estimator: str, temperature: Any
) -> Float[np.ndarray, "resamples"]:
    """log k_m of one term for every row of weights: ratios ``(samples,)`` sorted, weights ``(resamples, samples)``."""
    if estimator == "largest":
        last = weights.shape[1] - 1 - np.argmax(weights[:, ::-1] > 0, axis=1)
        return ratios[last]
    if estimator == "least-squares":
        finite = np.isfinite(ratios)
        own, of = weights[:, finite], ratios[finite]
        some = np.maximum(own.sum(axis=1), 1e-300)
        mean = own @ of / some
        spread = np.sqrt(np.maximum(0.0, own @ of**2 / some - mean**2))
        # as in fit_km: the others make up for those that are out of reach
        needed = level * weights.sum(axis=1) / some
        return np.where(needed < 1.0, mean + norm.ppf(np.clip(needed, 0.0, np.nextafter(1.0, 0.0))) * spread, np.inf)
    more = (1 << (len(ratios) - 1).bit_length()) - len(ratios)
    ratios, weights = np.pad(ratios, (0, more), constant_values=np.inf), np.pad(weights, ((0, 0), (0, more)))
    with jax.enable_x64(True):
        arrays = [jnp.asarray(x, jnp.float64) for x in (ratios, weights, level, temperature)]
        return np.asarray(_quantiles_jit(*arrays))


@jax.jit
def _quantiles_jit(ratios: Any, weights: Any, level: Any, temperature: Any) -> Any:
    """Where the derivative of the convex, smoothed pinball loss is 0: it rises, so bisection always arrives."""
    reach = 40.0 * temperature
    low, high = ratios[0] - reach, jnp.max(jnp.where(jnp.isfinite(ratios), ratios, -jnp.inf)) + reach

    def one(own: Any) -> Any:
        def slope(logk: Any, _: Any) -> Any:
            return jnp.sum(own * jax.nn.sigmoid((logk - ratios) / temperature)) / jnp.sum(own) - level

        solver = optx.Bisection(rtol=0.0, atol=1e-7, flip=False)
        middle = 0.5 * (low + high)
        options = {"lower": low, "upper": high}
        found = optx.root_find(slope, solver, middle, options=options, max_steps=100, throw=False)
        # where even the last ratio leaves more unsafe, there is none
        return jnp.where(slope(high, None) >= 0, found.value, jnp.inf)

    return jax.lax.map(one, weights)
