"""Tests of whiteness and of correlation with inputs: their size on white noise, and their power on coloured noise."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import signal, stats

from seatrial.ident.validation.whiteness import autoregression, cross_correlation, whiteness_test

N_SETS, N = 400, 1000
T = 0.1 * np.arange(N)


def bounds(p: float) -> tuple[float, float]:
    """Return the interval that holds the rate of N_SETS trials of probability p with probability 99.9 %."""
    low, high = stats.binom.interval(0.999, N_SETS, p)
    return low / N_SETS, high / N_SETS


@pytest.fixture(scope="module")
def white() -> np.ndarray:
    """Return p values (n, 3) on white noise (Ljung-Box, cumulative periodogram, normality) and the share of
    correlations beyond the band.
    """
    rng = np.random.default_rng(1)
    found = [whiteness_test("x", T, rng.normal(size=N)) for _ in range(N_SETS)]
    return np.array([[w.ljung_box, w.periodogram, w.normal, np.mean(np.abs(w.acf) > w.band)] for w in found])


@pytest.mark.parametrize("test", [0, 1, 2])
def test_p_values_on_white_noise_have_their_level(white: np.ndarray, test: int) -> None:
    for level in (0.05, 0.3):
        low, high = bounds(level)
        rate = float(np.mean(white[:, test] < level))
        assert rate <= high
        # The test of the periodogram is asymptotic and slightly conservative.
        assert rate >= (low if test != 1 else 0.4 * low)


def test_band_covers_nineteen_of_twenty_correlations_of_white_noise(white: np.ndarray) -> None:
    assert white[:, 3].mean() == pytest.approx(0.05, abs=0.01)


@pytest.mark.parametrize("phi", [0.2, -0.2])
def test_ar_1_process_is_rejected(phi: float) -> None:
    rng = np.random.default_rng(2)
    found = [whiteness_test("x", T, signal.lfilter([1.0], [1.0, -phi], rng.normal(size=N))) for _ in range(100)]
    assert np.mean([w.ljung_box < 0.01 for w in found]) > 0.9
    assert np.mean([w.periodogram < 0.01 for w in found]) > 0.95
    assert not any(w.white for w in found[:20])
    assert np.mean([w.acf[0] for w in found]) == pytest.approx(phi, abs=0.01)


def test_wave_is_found_in_the_cumulative_periodogram_at_its_frequency() -> None:
    rng = np.random.default_rng(3)
    e = rng.normal(size=N) + 0.6 * np.sin(2 * np.pi * 0.7 * T)
    w = whiteness_test("ax", T, e)
    assert w.periodogram < 1e-3
    step = np.argmax(np.diff(w.cumulative))
    assert w.frequency[step + 1] == pytest.approx(0.7, abs=0.02)
    assert w.cumulative[-1] == pytest.approx(1.0)
    assert w.frequency[-1] == pytest.approx(5.0)
    assert (w.channel, w.n) == ("ax", N)
    assert w.mean == pytest.approx(e.mean())
    assert w.sd == pytest.approx(e.std())


def test_normality_is_rejected_for_heavy_tails_and_not_tested_on_few_samples() -> None:
    rng = np.random.default_rng(4)
    assert whiteness_test("x", T, rng.standard_t(3, N)).normal < 1e-6
    assert np.isnan(whiteness_test("x", T[:19], rng.normal(size=19), n_lags=5).normal)


def steps(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return an input that holds for two seconds, at 50 Hz, starting 5 s before the innovations."""
    t_u = np.arange(-5.0, T[-1], 0.02)
    return t_u, rng.uniform(-1, 1, 200)[((t_u + 5.0) / 2.0).astype(int)]


def test_cross_correlation_bands_cover_for_independent_innovations() -> None:
    rng = np.random.default_rng(5)
    z, p = [], []
    for _ in range(N_SETS):
        t_u, u = steps(rng)
        c = cross_correlation("r", T, rng.normal(size=N), "n_left", t_u, u)
        z.append(c.z)
        p.append(c.p)
    z = np.array(z)
    assert z.std() == pytest.approx(1.0, abs=0.05)
    assert np.mean(np.abs(z) > 1.96) == pytest.approx(0.05, abs=0.015)
    for level in (0.05, 0.2):
        assert 0.25 * level < np.mean(np.array(p) < level) <= bounds(level)[1]


LIVELY = {
    "white": lambda rng, n: rng.normal(size=n),
    "chirp": lambda rng, n: np.sin(0.6 * np.cumsum(np.linspace(0.02, rng.uniform(0.3, 3), n)) + rng.uniform(0, 6)),
    "long holds": lambda rng, n: rng.choice([-1.0, 1.0], n // 100 + 1).repeat(100)[:n],
}


@pytest.mark.parametrize(
    ("kind", "trials"), [("chirp", 500), *(pytest.param(kind, 2500, marks=pytest.mark.study) for kind in LIVELY)]
)
def test_p_value_of_a_correlation_with_an_input_has_its_level(kind: str, trials: int) -> None:
    """The input decides whether 31 lags are 31 tests or three.

    The false-alarm rate may be a quarter too high or four times too low, plus chance.
    """
    rng = np.random.default_rng(8)
    p = np.array([
        cross_correlation("r", T, rng.normal(size=N), "n", T, LIVELY[kind](rng, N)).p for _ in range(trials)
    ])  # fmt: skip
    for level in (0.05, 0.01):
        rare, often = (stats.binom.interval(0.999, trials, level * by) for by in (0.25, 1.25))
        assert rare[0] <= np.sum(p < level) <= often[1]


@pytest.mark.parametrize("n", [60, *(pytest.param(n, marks=pytest.mark.study) for n in (80, 200, 1000))])
@pytest.mark.study
def test_short_channels_have_the_same_false_alarm_rate(n: int) -> None:
    rng, trials = np.random.default_rng(n), 2000
    found = [whiteness_test("x", T[:n], rng.normal(size=n)) for _ in range(trials)]
    for level in (0.01, 0.05):
        assert np.mean([w.ljung_box < level for w in found]) < 1.25 * level + 3 * np.sqrt(level / trials)
    assert np.mean([not w.white for w in found]) < 0.0125 + 3 * np.sqrt(0.01 / trials)
    coloured = [whiteness_test("x", T[:n], signal.lfilter([1.0], [1.0, -0.6], rng.normal(size=n))) for _ in range(100)]
    assert np.mean([not w.white for w in coloured]) > 0.7


def test_response_to_an_input_is_found_at_its_lag() -> None:
    rng = np.random.default_rng(6)
    t_u, _ = steps(rng)
    u = rng.normal(size=t_u.size // 5 + 1).repeat(5)[: t_u.size]  # The input holds for 0.1 s, so its lag can be found.
    e = rng.normal(size=N) + 0.3 * np.interp(T - 0.7, t_u, u)
    c = cross_correlation("ax", T, e, "n_left", t_u, u)
    assert c.p < 1e-6
    assert c.lags[np.argmax(c.z)] == pytest.approx(0.7, abs=0.11)
    assert (c.channel, c.input) == ("ax", "n_left")
    later = cross_correlation("ax", T, np.interp(T + 1.0, t_u, u), "n_left", t_u, u)  # A later input is not a cause.
    assert later.p > 1e-3


COLOURS = {"slow": [1.0, -0.95], "fast": [1.0, 0.6], "oscillating": [1.0, -1.6, 0.9]}


ALL = [pytest.param(kind, c, 600, marks=pytest.mark.study) for kind in ("chirp", "long holds") for c in COLOURS]


@pytest.mark.parametrize(
    ("kind", "colour", "trials"), [("chirp", "slow", 200), ("long holds", "oscillating", 200), *ALL]
)
def test_p_value_with_autocorrelated_innovations_has_its_level(kind: str, colour: str, trials: int) -> None:
    """The innovations of a drifting receiver or of an estimator are autocorrelated. If they were treated as white,
    every input would be significant.
    """
    rng = np.random.default_rng(9)
    e = signal.lfilter([1.0], COLOURS[colour], rng.normal(size=(trials, N + 200)))[:, 200:]
    found = [cross_correlation("r", T, own, "n", T, LIVELY[kind](rng, N)) for own in e]
    p, z = np.array([c.p for c in found]), np.array([c.z for c in found])
    for level in (0.05, 0.01):
        assert np.sum(p < level) <= stats.binom.interval(0.999, trials, level * 1.5)[1]
    assert 0.6 < z.std() < 1.25


def test_response_to_an_input_is_found_in_autocorrelated_innovations() -> None:
    rng = np.random.default_rng(10)
    u = rng.choice([-1.0, 1.0], N // 5).repeat(5)
    e = signal.lfilter([1.0], [1.0, -0.9], rng.normal(size=N)) + 1.5 * np.interp(T - 0.7, T, u)
    c = cross_correlation("ax", T, e, "n", T, u)
    assert c.p < 1e-4
    assert c.lags[np.argmax(c.z)] == pytest.approx(0.7, abs=0.11)


def test_correlation_coefficient_equals_numpy() -> None:
    rng = np.random.default_rng(11)
    e, u = rng.normal(size=(2, N))
    c = cross_correlation("r", T, e + 0.2 * u, "n", T, u)
    assert c.largest == pytest.approx(abs(np.corrcoef(e + 0.2 * u, u)[0, 1]), abs=1e-6)


def test_autoregression_recovers_the_filter() -> None:
    e = signal.lfilter([1.0], [1.0, -0.5, 0.3], np.random.default_rng(12).normal(size=20_000))
    np.testing.assert_allclose(autoregression(e), [0.5, -0.3], atol=0.03)
    assert autoregression(np.random.default_rng(13).normal(size=2000)).size == 0


def test_constant_input_gives_no_correlation() -> None:
    c = cross_correlation("r", T, np.random.default_rng(7).normal(size=N), "n", T, np.full(N, 0.3))
    assert not c.z.any()
    assert c.p == 1.0
