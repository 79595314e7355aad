"""Tests of robust standard errors: correct for coloured residuals, and omitted if the record has too few blocks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from seatrial.ident.data.record import Record
from seatrial.ident.estimation.fisher_scoring import Bounds, Evaluation
from seatrial.ident.estimation.maximum_likelihood import SearchSettings, fit
from seatrial.ident.estimation.standard_errors import (
    AUTOCORRELATED_TOO_LONG,
    Sandwich,
    Uncertainty,
    assess,
    sandwich,
    widened,
)
from seatrial.ident.model.parameter import Parameter
from seatrial.ident.model.structure import Model, Output, Sensor, State, plain_model

N = 4000


def coloured(keep: float, seed: int, n: int = N) -> np.ndarray:
    """Return first-order noise of unit variance."""
    white = np.random.default_rng(seed).standard_normal(n + 500)
    return np.asarray(lfilter([np.sqrt(1 - keep**2)], [1.0, -keep], white)[500:])


def known_of(information: np.ndarray) -> Uncertainty:
    zero = np.zeros(len(information))
    names = [f"p{k}" for k in range(zero.size)]
    free = Bounds(zero - np.inf, zero + np.inf, zero > 0)
    return assess(Evaluation(0.0, zero, information, zero), zero, free, names, zero + 1.0, zero)


def regression(keep: float, seed: int) -> tuple[float, float]:
    """Return the error of a regression over its plain and its robust standard error. Noise and input are
    autocorrelated.
    """
    A = np.column_stack([np.ones(N), coloured(keep, 1000 + seed)])
    e = coloured(keep, seed)
    information = A.T @ A
    found = np.linalg.solve(information, A.T @ e)
    known = known_of(information)
    robust = sandwich(known, [([0, 1], A * (e - A @ found)[:, None])], np.ones(2), np.zeros(2)).errors
    return float(found[1] / known.errors[1]), float(found[1] / robust[1])


@pytest.mark.parametrize("keep", [0.0, 0.8, 0.95])
def test_robust_intervals_cover_for_any_autocorrelation(keep: float) -> None:
    plain, robust = np.array([regression(keep, k) for k in range(300)]).T
    assert 0.90 < np.mean(np.abs(robust) < 1.96) < 0.99
    assert np.mean(np.abs(plain) < 1.96) > 0.9 or keep > 0.0
    assert np.mean(np.abs(plain) < 1.96) < 0.7 or keep < 0.9


# Standard deviations of the prior: it dominates, it equals the data, it is negligible.
@pytest.mark.parametrize("sd", [0.01, 0.05, 1.0])
def test_robust_errors_include_the_uncertainty_of_a_prior(sd: float) -> None:
    found = []
    for seed in range(100):
        A, e = np.column_stack([np.ones(N), coloured(0.9, 1000 + seed)]), coloured(0.9, seed)
        prior = np.array([0.0, sd**-2])
        # This is the error of the mean of the prior.
        offset = np.array([0.0, sd * np.random.default_rng(seed).standard_normal()])
        x = np.linalg.solve(A.T @ A + np.diag(prior), A.T @ e + prior * offset)
        zero = np.zeros(2)
        free = Bounds(zero - np.inf, zero + np.inf, zero > 0)
        known = assess(Evaluation(0.0, zero, A.T @ A + np.diag(prior), zero), zero, free, ["a", "b"], zero + 1, prior)
        robust = sandwich(known, [([0, 1], A * (e - A @ x)[:, None])], np.ones(2), prior)
        found.append(x[1] / robust.errors[1])
    assert 0.90 < np.mean(np.abs(found) < 1.96) < 0.99


def test_record_shorter_than_its_autocorrelation_time_has_no_error() -> None:
    walk = np.cumsum(np.random.default_rng(4).standard_normal(N))
    rows = (walk - walk.mean())[:, None]
    assert np.isnan(sandwich(known_of(np.array([[float(N)]])), [([0], rows)], np.ones(1), np.zeros(1)).errors).all()


def sparse(x: np.ndarray, every: int) -> np.ndarray:
    found = np.zeros(x.size * every)
    found[::every] = x
    return found


def scores_error(scores: list[np.ndarray]) -> Sandwich:
    """Return the robust error of a mean from its scores. Each sample has unit information."""
    n = sum(np.count_nonzero(s) for s in scores)
    rows = [([0], s[:, None]) for s in scores]
    return sandwich(known_of(np.array([[float(n)]])), rows, np.ones(1), np.zeros(1))


@pytest.mark.parametrize("every", [1, 2, 5, 10])
def test_slow_sensor_has_the_errors_of_its_samples(every: int) -> None:
    """The rows between its samples are empty. They must not count as white noise."""
    dense = scores_error([coloured(0.9, 1)]).errors
    np.testing.assert_allclose(scores_error([sparse(coloured(0.9, 1), every)]).errors, dense, rtol=0.1)
    assert dense == pytest.approx(np.sqrt(19.0 / N), rel=0.35)
    short = scores_error([sparse(coloured(0.9, 1, 300), every)])
    assert np.isnan(short.errors).all()
    assert (short.least > 2.0 / np.sqrt(300)).all()
    assert (short.p < 0.001).all()


def test_weak_long_correlation_is_included_or_the_errors_are_omitted() -> None:
    """A tenth of the variance is correlated over 200 rows. It causes nine tenths of the variance of the mean."""
    n, found, least, withheld = 60_000, [], [], []
    for seed in range(20):
        x = np.sqrt(0.1) * coloured(0.99, seed, n) + np.sqrt(0.9) * coloured(0.0, 100 + seed, n)
        robust = scores_error([x - x.mean()])
        found.append(float(robust.errors[0]))
        short = scores_error([x[:4000] - x[:4000].mean()])
        withheld.append(bool(np.isnan(short.errors[0])))
        least.append(float(short.least[0]))
    assert np.sqrt(np.nanmean(np.square(found))) == pytest.approx(np.sqrt((0.9 + 0.1 * 199) / n), rel=0.15)
    assert np.mean(np.isnan(found)) < 0.1
    assert np.mean(withheld) > 0.85
    assert np.sqrt(np.mean(np.square(least))) == pytest.approx(np.sqrt((0.9 + 0.1 * 199) / 4000), rel=0.3)


@pytest.mark.parametrize(("n", "every"), [(60, 10), (300, 1), (300, 10), (3000, 1)])
def test_white_scores_are_rarely_called_autocorrelated(n: int, every: int) -> None:
    found = [scores_error([sparse(np.random.default_rng(k).normal(size=n), every)]) for k in range(300)]
    assert np.mean([np.isnan(f.errors[0]) for f in found]) < 0.03
    assert np.sqrt(np.nanmean([f.errors[0] ** 2 for f in found])) == pytest.approx(n**-0.5, rel=0.08)
    assert np.mean([f.p[0] < 0.01 for f in found]) < 0.03


def test_many_records_are_used_as_blocks() -> None:
    """The records are independent random walks, so no block length within a record would be long enough."""
    walks = [np.cumsum(np.random.default_rng(k).standard_normal(200)) for k in range(30)]
    sums = np.array([w.sum() for w in walks])
    rows = [([0], (w - sums.mean() / 200)[:, None]) for w in walks]
    (error,) = sandwich(known_of(np.array([[100.0]])), rows, np.ones(1), np.zeros(1)).errors
    assert error == pytest.approx(np.sqrt(30) * sums.std(ddof=1) / 100.0, rel=0.15)


def test_larger_error_is_used_and_correlations_are_kept() -> None:
    known = known_of(np.array([[2.0, 1.0], [1.0, 2.0]]))
    wider = widened(known, known.errors * np.array([3.0, 0.5]))
    np.testing.assert_allclose(wider.errors, known.errors * [3.0, 1.0])
    np.testing.assert_allclose(np.sqrt(np.diag(wider.covariance)), wider.errors)
    assert wider.covariance[0, 1] == pytest.approx(3.0 * known.covariance[0, 1])
    np.testing.assert_array_equal(widened(known, np.full(2, np.nan)).errors, known.errors)


def line() -> Model:
    return plain_model(
        "line",
        f=lambda x, u, p: {"t": 1.0},
        h=lambda x, u, p: {"y": p.mean + p.slope * x.t},
        states=(State("t", sd0=0.0),),
        inputs=(),
        sensors=(Sensor("one", (Output("y", noise="e"),)),),
        parameters=(Parameter("mean", 0.3), Parameter("slope", 0.0), Parameter("e", 1.5, transform="log")),
    )


@pytest.mark.parametrize("keep", [0.0, 0.8])
def test_fit_with_coloured_residuals_is_flagged_and_has_robust_errors(keep: float) -> None:
    empty = np.zeros((N, 0))
    model = line()
    record = Record("one", 0.1 * np.arange(N), empty, empty, coloured(keep, 3)[:, None], (), ("y",))
    plain = fit(model, [record], settings=SearchSettings(robust_errors=False))
    found = fit(model, [record])
    assert found.coloured == (keep > 0.0)
    expected = np.fmax(plain.errors, found.robust_errors) if found.coloured else plain.errors
    np.testing.assert_allclose(found.inflation, expected / plain.errors)
    np.testing.assert_allclose(found.errors, expected, rtol=1e-6)
    assert (found.errors[:2] > 2.0 * plain.errors[:2]).all() == found.coloured


def test_fit_with_too_long_autocorrelation_is_flagged() -> None:
    """Its errors are those of the longest blocks."""
    empty = np.zeros((600, 0))
    y = 0.7 * coloured(0.98, 4, 600) + 0.7 * coloured(0.0, 5, 600)
    record = Record("one", 0.1 * np.arange(600), empty, empty, y[:, None], (), ("y",))
    plain = fit(line(), [record], settings=SearchSettings(robust_errors=False))
    found = fit(line(), [record])
    assert found.coloured
    assert ("mean", AUTOCORRELATED_TOO_LONG) in found.flags
    assert np.isnan(found.robust_errors[0])
    assert found.errors[0] > 2.5 * plain.errors[0]
