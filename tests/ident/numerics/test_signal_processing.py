"""Tests of first-order lags, their fit, steady segments, noise from differences, and rounding steps."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest
from scipy import signal

from seatrial.ident.numerics.signal_processing import (
    Hold,
    LagData,
    Start,
    first_order_lag,
    fit_first_order_lag,
    noise_from_differences,
    rounding_step,
    steady_segments,
    welch_spectrum,
    wrap,
)

SAMPLE_S, TAU = 0.05, 0.4


def by_recursion(f: np.ndarray, hold: Hold, start: Start) -> np.ndarray:
    keep, x = np.exp(-SAMPLE_S / TAU), np.zeros_like(f)
    x[0] = f[0] if start == "steady" else (0.0 if hold == "forward" else (1 - keep) * f[0])
    for k in range(1, len(f)):
        x[k] = keep * x[k - 1] + (1 - keep) * f[k - 1 if hold == "forward" else k]
    return x


@pytest.mark.parametrize("hold", ["forward", "backward"])
@pytest.mark.parametrize("start", ["zero", "steady"])
@pytest.mark.parametrize("shape", [(50,), (50, 3), (50, 2, 4)])
def test_first_order_lag_equals_its_difference_equation(hold: Hold, start: Start, shape: tuple[int, ...]) -> None:
    f = np.random.default_rng(0).normal(size=shape)
    np.testing.assert_allclose(first_order_lag(f, TAU, SAMPLE_S, hold=hold, start=start), by_recursion(f, hold, start))


def test_lag_without_time_constant_equals_its_input() -> None:
    f = np.random.default_rng(0).normal(size=20)
    np.testing.assert_array_equal(first_order_lag(f, 0.0, SAMPLE_S, hold="backward"), f)
    np.testing.assert_array_equal(first_order_lag(f, 0.0, SAMPLE_S)[1:], f[:-1])


def test_missing_samples_of_a_lag_stay_missing() -> None:
    f = np.ones(20)
    f[10] = np.nan
    x = first_order_lag(f, TAU, SAMPLE_S, hold="backward")
    assert np.all(np.isfinite(x[:10]))
    assert np.all(np.isnan(x[10:]))
    assert first_order_lag(np.zeros((0, 2)), TAU, SAMPLE_S).shape == (0, 2)


@pytest.mark.parametrize("n", [65, 200, 1001])
@pytest.mark.parametrize("segment", [64, 65])
def test_welch_spectrum_is_that_of_scipy(n: int, segment: int) -> None:
    rng = np.random.default_rng(n)
    x, y = 3.0 + rng.normal(size=n).cumsum(), rng.normal(size=n)
    power, cross = signal.welch(x, 1.0, "hann", segment)[1], signal.csd(x, y, 1.0, "hann", segment)[1]
    np.testing.assert_allclose(welch_spectrum(x, segment), power, rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(welch_spectrum(x, segment, y), cross, rtol=1e-9, atol=1e-12)


def test_delay_and_time_constant_are_found() -> None:
    f = np.repeat(np.random.default_rng(1).uniform(-1.0, 1.0, 20), 40)
    delays, time_constants = [k * SAMPLE_S for k in range(12)], [0.1, 0.2, 0.4, 0.8]

    def later(x: np.ndarray, delay: float) -> np.ndarray:
        k = round(delay / SAMPLE_S)
        return np.concatenate([np.zeros(k), x[: x.size - k]])

    measured = later(first_order_lag(f, 0.4, SAMPLE_S), 0.3)
    data = LagData(f, lambda x, delay: float(np.sum((measured - later(x, delay)) ** 2)))
    found = fit_first_order_lag([data, data], delays, time_constants, SAMPLE_S)
    assert (found.delay, found.time_constant) == (pytest.approx(0.3), 0.4)
    assert found.misfit == pytest.approx(0.0, abs=1e-20)


def test_steady_segments_of_a_held_signal() -> None:
    found = steady_segments(np.array([0.0, 1.0, 2.0, 5.0]), np.array([0.3, 0.3, -0.2, 0.1]), 9.0)
    assert found == [(0.0, 2.0, 0.3), (2.0, 5.0, -0.2), (5.0, 9.0, 0.1)]
    assert [s.duration for s in found] == [2.0, 3.0, 4.0]


def test_noise_from_differences_is_robust() -> None:
    rng = np.random.default_rng(2)
    y = np.sin(np.arange(5000) * 0.01) + 0.2 * rng.normal(size=5000)
    y[::50] += 30.0
    assert noise_from_differences(np.diff(y, 2)) == pytest.approx(0.2, rel=0.12)
    assert noise_from_differences(np.zeros(0)) == 0.0


def test_only_angles_are_wrapped() -> None:
    np.testing.assert_allclose(wrap(np.array([3.5, -3.5, 0.1]), True), [3.5 - 2 * np.pi, 2 * np.pi - 3.5, 0.1])
    np.testing.assert_array_equal(wrap(np.array([3.5, -3.5]), False), [3.5, -3.5])


def test_estimation_does_not_import_scipy() -> None:
    """The import of SciPy would take more than half of the time of a small fit."""
    program = "import sys; from seatrial.ident.estimation import Likelihood, fit; sys.exit('scipy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", program], check=False).returncode == 0


@pytest.mark.parametrize("step", [1e-3, 0.01, 0.0111317])
def test_rounding_step_is_found(step: float) -> None:
    x = np.random.default_rng(1).normal(size=400)
    assert rounding_step(step * np.round(x / step)) == pytest.approx(step, rel=1e-6)
    assert rounding_step((step * np.round(x / step)).astype(np.float32).astype(float)) == pytest.approx(step, rel=1e-3)
    cut = np.trunc(x / step)  # The value is the middle of its step, except for zero.
    assert rounding_step(step * (cut + 0.5 * np.sign(cut))) == pytest.approx(step, rel=1e-6)


def test_values_without_a_grid_have_no_step() -> None:
    rng = np.random.default_rng(2)
    assert rounding_step(rng.normal(size=400)) == 0.0
    assert rounding_step(np.cumsum(rng.normal(size=400))) == 0.0
    assert rounding_step(np.append(0.01 * np.arange(50), 0.123)) == 0.0
    assert rounding_step(np.zeros(100)) == 0.0
    assert rounding_step(np.array([1.0, 2.0, 4.0, np.nan])) == 0.0  # There are too few values.
