"""Tests of autocorrelation times of coloured noise and of errors by blocks."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.signal import lfilter

from seatrial.ident.numerics.autocorrelation import (
    Truncation,
    block_error,
    correlation_length,
    effective_sample_size,
    integrated_autocorrelation_time,
    mean_error,
)

N = 20_000


def ar1(rho: float, seed: int, n: int = N) -> np.ndarray:
    return np.asarray(lfilter([1.0], [1.0, -rho], np.random.default_rng(seed).normal(size=n)))


@pytest.mark.parametrize("truncation", ["window", "positive"])
def test_autocorrelation_time_of_first_order_noise(truncation: Truncation) -> None:
    assert integrated_autocorrelation_time([ar1(0.0, 1)], truncation) == pytest.approx(1.0, abs=0.1)
    found = np.mean([integrated_autocorrelation_time([ar1(0.9, seed)], truncation) for seed in range(5)])
    assert found == pytest.approx((1 + 0.9) / (1 - 0.9), rel=0.12)


@pytest.mark.parametrize("truncation", ["window", "positive"])
def test_autocorrelation_time_of_constants_and_ramps(truncation: Truncation) -> None:
    assert integrated_autocorrelation_time([np.ones(50)], truncation) == 1.0
    assert integrated_autocorrelation_time([np.zeros(50)], truncation) == 1.0
    assert integrated_autocorrelation_time([np.linspace(-1.0, 1.0, 500)], truncation) > 50.0


def test_short_series_are_pooled() -> None:
    parts = [ar1(0.8, seed, 3000) for seed in range(12)]
    assert integrated_autocorrelation_time(parts) == pytest.approx((1 + 0.8) / (1 - 0.8), rel=0.15)


@pytest.mark.parametrize("every", [1, 10])
@pytest.mark.parametrize("rho", [0.8, 0.95])
def test_correlation_length_of_first_order_noise(rho: float, every: int) -> None:
    """The first sensor has a sample in every row. The second is slow, and its other rows are zero."""
    found = []
    for seed in range(5):
        x = np.zeros(N)
        x[::every] = ar1(rho, seed, N // every)
        found.append(correlation_length([x]))
    tau = (1 + rho) / (1 - rho)
    assert np.mean(found) == pytest.approx(every * (tau - 1 / tau), rel=0.3)


def test_weak_long_correlation_is_found_in_sums() -> None:
    """A tenth of the variance is correlated over 400 samples. It causes nine tenths of the variance of a mean."""
    found, windows = [], []
    for seed in range(5):
        tail = ar1(0.995, seed) * np.sqrt(1 - 0.995**2)
        x = np.sqrt(0.1) * tail + np.sqrt(0.9) * np.random.default_rng(100 + seed).normal(size=N)
        found.append(correlation_length([x]))
        windows.append(integrated_autocorrelation_time([x]))
    assert np.mean(found) == pytest.approx(400.0, rel=0.4)
    assert np.mean(windows) < 80.0


def test_white_noise_is_correlated_only_by_chance() -> None:
    for n in (60, 300, 3000):
        found = np.array([correlation_length([np.random.default_rng(seed).normal(size=n)]) for seed in range(200)])
        assert np.mean(found > 0.0) < 0.08
        assert np.mean(found > n / 108) < 0.03  # Twelve blocks of nine times this length.
    assert [correlation_length([x]) for x in (np.zeros(50), np.ones(50), np.ones(2))] == [0.0, 0.0, 0.0]


def test_effective_sample_size_of_first_order_noise() -> None:
    """The reference is 1 + 2 sum rho^2k = (1 + rho^2) / (1 - rho^2)."""
    found = np.mean([effective_sample_size(ar1(0.9, seed)) for seed in range(5)])
    assert found == pytest.approx(N * (1 - 0.81) / (1 + 0.81), rel=0.15)
    assert effective_sample_size(np.zeros(7)) == 7.0


def test_drift_is_included_in_the_error_by_blocks() -> None:
    x = np.random.default_rng(0).normal(size=1000) + np.repeat(np.linspace(-1, 1, 10), 100)
    assert block_error(x) > 0.15 > 3 * x.std() / np.sqrt(1000)


def test_error_of_a_mean_includes_autocorrelation_for_few_readings() -> None:
    errors = [mean_error(ar1(0.9, seed)[:500])[0] for seed in range(20)]
    scatter = np.std([ar1(0.9, seed)[:500].mean() for seed in range(200)])
    assert np.mean(errors) == pytest.approx(scatter, rel=0.25)
    error, memory = mean_error(np.array([0.0, 1.0, 0.0, 1.0]))
    assert (error > 0.0, memory) == (True, 1.0)
