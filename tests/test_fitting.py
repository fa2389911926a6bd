"""Fits of k_m: against SciPy, NumPy, known answers, and where they are stiff or cannot be."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, cast

import numpy as np
import pytest
from scipy.optimize import minimize

from slefejax import (
    Camera,
    InputError,
    Samples,
    View,
    bootstrap_km,
    fit_km,
    measure_factors,
    sampled_error,
    screen_twists,
    screen_widths,
)
from slefejax.measure.minimal import minimal_factors
from slefejax.study.fitting import ESTIMATORS, cross_validated, held_out
from slefejax.study.samples import slefe_term

TERMS = (slefe_term(3), "twist")


def made(rng, count=400, spread=0.3, views=10, scale=1.0, decades=0.0) -> Samples:
    """Samples with needed^2 = 1.1 slefe + .7 twist, and noise."""
    slefe = np.exp(rng.normal(3.0, 1.0, count)) * 10.0 ** rng.uniform(0.0, decades, count)
    twist = slefe * rng.uniform(0.0, 2.0, count)
    needed = np.sqrt(1.1 * slefe + 0.7 * twist) * np.exp(rng.normal(0.0, spread, count))
    minimal = np.maximum(2, np.ceil(needed)).astype(np.int64)
    terms = {TERMS[0]: slefe * scale, TERMS[1]: twist / scale}
    return Samples(rng.integers(0, views, count), np.arange(count), minimal, needed, terms, 0.5)


def ratios(samples: Samples) -> np.ndarray:
    return np.sort(samples.needed / np.sqrt(samples.terms[TERMS[0]]))


def test_one_constant_is_a_quantile_of_the_ratios(rng):
    samples = made(rng)
    by_hand = ratios(samples)
    assert fit_km(samples, estimator="largest").k == pytest.approx(by_hand[-1], rel=1e-12)
    for target in (0.5, 0.9, 0.99):
        k = fit_km(samples, target=target).k
        # smoothed: two neighbours of the sorted ratios away at most, besides a temperature of .001
        low, high = (np.quantile(by_hand, target + d, method="lower") for d in (-2 / 400, 2 / 400))
        assert low * 0.999 <= k <= high * 1.001
        assert abs(np.mean(by_hand <= k) - target) <= 2 / 400
    assert fit_km(samples, target=1.0).k >= by_hand[-2]


def test_least_squares_of_one_constant(rng):
    samples = made(rng)
    logs = np.log(ratios(samples))
    fit = fit_km(samples, estimator="least-squares", target=0.8413447460685429)
    assert fit.k == pytest.approx(np.exp(logs.mean() + logs.std()), rel=1e-6)


def test_two_terms_against_scipy(rng):
    """The smoothed loss by Nelder and Mead, from the same place."""
    samples = made(rng)
    design, logs = samples.design(TERMS), np.log(samples.needed)
    temperature, level = 0.02, 0.95

    def loss(x):
        rest = logs - 0.5 * np.log(design @ np.exp(x))
        return np.mean(level * rest + temperature * np.logaddexp(0.0, -rest / temperature))

    options = {"xatol": 1e-10, "fatol": 1e-15, "maxiter": 4000}
    best = minimize(loss, np.zeros(2), method="Nelder-Mead", options=options)
    fit = fit_km(samples, target=level, more=("twist",), temperature=temperature)
    assert fit.converged
    assert loss(np.log(fit.coefficients)) <= best.fun + 1e-9
    squares = fit_km(samples, target=0.5, estimator="least-squares", more=("twist",))
    found = minimize(lambda x: np.sum((logs - 0.5 * np.log(design @ np.exp(x))) ** 2), np.zeros(2), tol=1e-12)
    np.testing.assert_allclose(squares.coefficients, np.exp(found.x), rtol=1e-4)


def test_a_model_that_holds_is_found_again(rng):
    samples = made(rng, spread=0.0)
    for estimator in ESTIMATORS:
        fit = fit_km(samples, estimator=estimator, target=0.9, more=("twist",))
        assert fit.converged
        np.testing.assert_allclose(fit.coefficients, [1.1, 0.7], rtol=2e-2 if estimator == "quantile" else 1e-4)
    assert np.all(fit_km(samples, estimator="largest", more=("twist",)).factor(samples) >= samples.needed * (1 - 1e-9))


@pytest.mark.parametrize("temperature", [1e-4, 1e-6])
@pytest.mark.parametrize(("scale", "decades"), [(1.0, 8.0), (1e8, 0.0), (1e-8, 8.0)])
def test_stiff_fits_converge_or_say_why_not(rng, temperature, scale, decades):
    """Little temperature, terms of very different size, samples over eight decades."""
    samples = made(rng, scale=scale, decades=decades)
    for more in ((), ("twist",)):
        fit = fit_km(samples, target=0.95, more=more, temperature=temperature)
        assert np.isfinite(fit.coefficients).all()
        assert fit.converged, fit.reason
        assert np.mean(fit.factor(samples) >= samples.needed) == pytest.approx(0.95, abs=0.01)
    plain = fit_km(made(np.random.default_rng(20261122), decades=decades), target=0.95, more=("twist",))
    expected = plain.coefficients * [1 / scale, scale]
    if temperature == 1e-4:
        np.testing.assert_allclose(fit.coefficients, expected, rtol=0.1)


def test_samples_that_no_constant_reaches(rng):
    samples = made(rng)
    samples.terms[TERMS[0]][:20] = 0.0
    fit = fit_km(samples, target=0.99)
    assert fit.k == np.inf
    assert not fit.converged
    assert "5 % of the samples need pieces though slefe 3 is 0" in fit.reason
    assert np.isnan(fit.factor(samples)).all()
    assert np.isnan(held_out(samples, fit.factor(samples)).share_unsafe)
    for estimator, more in (("quantile", ()), ("quantile", ("twist",)), ("least-squares", ())):
        # all others have to be safe for that
        samples.terms["twist"][:20] = 0.0
        edge = fit_km(samples, target=0.95, estimator=estimator, more=more)
        assert edge.converged
        assert 1.0 < edge.k < 5.0
    enough = fit_km(samples, target=0.9)
    assert enough.converged
    assert np.mean(enough.factor(samples) >= samples.needed) == pytest.approx(0.9, abs=0.01)


def test_factors_are_at_least_one_and_held_out_counts(rng):
    samples = made(rng)
    factors = np.where(np.arange(400) < 100, samples.minimal - 1.5, samples.minimal + 0.0)
    outcome = held_out(samples, factors)
    assert outcome.share_unsafe == 0.25
    assert outcome.over_minimal_median == 1.0
    whole = np.where(np.arange(400) < 100, samples.minimal - 1, samples.minimal)
    assert outcome.triangles_over_minimal == pytest.approx((whole**2).sum() / (samples.minimal**2).sum())
    assert fit_km(samples, target=0.5).factor(samples).min() >= 1.0


def test_cross_validation_never_sees_the_view_that_it_predicts(rng):
    samples = made(rng, views=4)
    odd = samples.view == 3
    samples.needed[odd] *= 50.0  # a view unlike the others: only a model that saw it would be safe there
    factors, fits = cross_validated(samples, folds=4, estimator="largest")
    assert len(fits) == 4
    for view in range(4):
        own = samples.view == view
        others = fit_km(samples.where(~own), estimator="largest")
        np.testing.assert_allclose(factors[own], others.factor(samples.where(own)))
    assert np.mean(factors[odd] < samples.needed[odd]) > 0.9
    assert len(cross_validated(samples, folds=50)[1]) == 4


def test_bootstrap_is_of_views_and_reproducible(rng):
    samples = made(rng, views=20)
    first = bootstrap_km(samples, target=0.9, resamples=100, seed=3)
    assert first == bootstrap_km(samples, target=0.9, resamples=100, seed=3)
    k = fit_km(samples, target=0.9).k
    assert first.low <= k <= first.high
    # by hand: whole views, with replacement
    draws, own = np.random.default_rng(7), []
    for _ in range(300):
        views = draws.integers(0, 20, 20)
        drawn = np.concatenate([np.flatnonzero(samples.view == v) for v in views])
        own.append(np.quantile(samples.needed[drawn] / np.sqrt(samples.terms[TERMS[0]][drawn]), 0.9))
    np.testing.assert_allclose(first, np.quantile(own, [0.025, 0.975]), rtol=0.04)
    same = replace(samples, view=np.zeros(400, int))
    alone = bootstrap_km(same, target=0.9, resamples=10)
    assert alone.low == pytest.approx(alone.high), "one view leaves nothing to draw"


@pytest.mark.parametrize("estimator", ["largest", "least-squares"])
def test_bootstrap_of_the_other_estimators(rng, estimator):
    samples = made(rng, views=20)
    interval = bootstrap_km(samples, estimator=estimator, target=0.9, resamples=200)
    assert interval.low <= fit_km(samples, estimator=estimator, target=0.9).k * (1 + 1e-9)
    assert interval.low <= interval.high


def test_measured_samples_of_the_teapot(teapot, main_view):
    views = [main_view, View(teapot.default_camera(cover=0.1), 320, 200)]
    samples = measure_factors(teapot.patches(), views, (1, 3))
    first = samples.where(samples.view == 0)
    minimal = minimal_factors(teapot.patches(), main_view)
    assert np.array_equal(first.minimal, minimal[minimal > 0])
    assert np.array_equal(np.ceil(samples.needed), samples.minimal)
    for m in (1, 3):
        width = np.asarray(screen_widths(teapot.patches(), main_view, m))
        np.testing.assert_allclose(first.terms[slefe_term(m)], 2 * m * m * width)
    np.testing.assert_allclose(first.terms["twist"], 2 * np.asarray(screen_twists(teapot.patches(), main_view)))
    both = Samples.joined([samples, samples])
    assert len(both.views) == 4
    assert len(both) == 2 * len(samples)


def test_the_sum_of_the_estimates_is_what_math_says(teapot, main_view):
    width = np.asarray(screen_widths(teapot.patches(), main_view, 3))
    assert float(3 * np.sqrt(width).sum()) == pytest.approx(380.316, abs=1e-3)


def test_the_twist_of_a_bilinear_patch_is_its_error(main_view):
    """Two triangles for a bilinear patch are off by a quarter of the mixed difference: without perspective exactly."""
    quad = np.array([[[0, 0, 0], [0, 1, 0]], [[1, 0, 0], [1, 1, 0.5]]], float)[None]
    view = View(Camera.orthographic((0, -5, 0), (0, 0, 0), height=4.0), 800, 800)
    twist = float(screen_twists(quad, view)[0])
    assert twist == pytest.approx(0.25 * 0.5 * 200)
    assert float(sampled_error(quad, np.array([1]), view)[0]) == pytest.approx(twist, rel=1e-6)
    assert float(screen_widths(quad, view, 2)[0]) == 0.0
    elevated = np.stack([[[[i / 3, j / 3, 0.5 * i * j / 9] for j in range(4)] for i in range(4)]])
    assert float(screen_twists(elevated, view)[0]) == pytest.approx(twist, rel=1e-9)
    assert screen_twists(quad + [0, -50, 0], main_view).tolist() == [0.0]


@pytest.mark.parametrize(
    ("call", "says"),
    [
        (lambda s: fit_km(s, target=0.0), "target must be"),
        (lambda s: fit_km(s, target=1.5), "at most 1"),
        (lambda s: fit_km(s, estimator="mean"), "no estimator 'mean'"),
        (lambda s: fit_km(s, 2), "no term 'slefe 2'"),
        (lambda s: fit_km(s, temperature=-1.0), "temperature must be"),
        (lambda s: fit_km(s.where(s.minimal < 0)), "nothing to fit"),
        (lambda s: fit_km(cast(Any, "samples")), "measure_factors"),
        (lambda s: cross_validated(s.where(s.view == 0)), "two views"),
        (lambda s: bootstrap_km(s, resamples=1), "two resamples"),
        (lambda s: bootstrap_km(s, confidence=1.0), "confidence between"),
        (lambda s: bootstrap_km(s, seed=-1), "a seed from 0 on"),
        (lambda s: fit_km(s, temperature=1e30), "at most 1, not 1e"),
        (lambda s: held_out(s, np.ones(3)), "400 samples and factors of shape"),
        (lambda s: Samples.joined([s, replace(s, terms={})]), "same terms"),
        (lambda s: fit_km(replace(s, needed=s.needed * np.nan)), "finite numbers"),
    ],
)
def test_bad_input(rng, call, says):
    with pytest.raises(InputError, match=says):
        call(made(rng))


def test_fits_are_compiled_for_few_sizes(rng):
    """Numbers of samples are padded to powers of 2."""
    from slefejax.study.fitting import _descend_jit

    fit_km(made(rng, count=300), more=("twist",), target=0.9)
    before = _descend_jit._cache_size()  # type: ignore[attr-defined]
    for count in (280, 310, 500):
        fit_km(made(rng, count=count), more=("twist",), target=0.9)
    assert _descend_jit._cache_size() == before  # type: ignore[attr-defined]
