"""Tests of sensor noise: known truths, the exact likelihood, and measured sensors at rest."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy import signal

from seatrial.ident.characterisation.sensor_noise import (
    INITIAL_SD,
    NoiseFit,
    band_spectrum,
    estimate_noise,
    innovation_form,
    welch,
)
from seatrial.ident.data.record import Channel
from seatrial.ident.validation.whiteness import autocorrelation, ljung_box, predictable_share
from tests.measured.data import measured


def drawn(white: float, walk: float, n: int = 6000, dt: float = 0.02, seed: int = 0, gap: bool = False) -> Channel:
    rng = np.random.default_rng(seed)
    t = np.arange(n) * dt
    if gap:
        t = np.delete(t, slice(n // 4, n // 2))
    b = np.cumsum(np.append(3.0, walk * np.sqrt(np.diff(t)) * rng.normal(size=t.size - 1)))
    return Channel(t, b + white * rng.normal(size=t.size))


@pytest.mark.parametrize("gap", [False, True])
@pytest.mark.parametrize("unit", [1.0, 1e-6])
def test_truth_is_within_the_standard_errors(gap: bool, unit: float) -> None:
    channel = drawn(0.3, 0.2, gap=gap)
    found = estimate_noise(Channel(channel.t, channel.value * unit))
    assert abs(found.white / unit - 0.3) < 4 * found.white_error / unit
    assert abs(found.walk / unit - 0.2) < 4 * found.walk_error / unit
    assert found.white_error < 0.01 * unit
    assert found.walk_error < 0.06 * unit
    assert not found.rejected
    assert not found.flags


def test_standard_errors_equal_the_spread_of_the_estimates() -> None:
    fits = [estimate_noise(drawn(0.3, 0.5, 1500, seed=seed)) for seed in range(40)]
    z = np.array([[(f.white - 0.3) / f.white_error, (f.walk - 0.5) / f.walk_error] for f in fits])
    np.testing.assert_allclose(z.std(axis=0), 1.0, atol=0.4)
    assert (np.abs(z.mean(axis=0)) < 0.7).all()
    assert sum(f.rejected or f.heavy_tailed or f.coarse for f in fits) == 0


def test_likelihood_is_exact() -> None:
    """The reference is the joint Gaussian of all samples with an unknown offset."""
    channel = drawn(0.3, 0.8, 200, gap=True)
    found = estimate_noise(channel)
    t, y = channel.t, channel.value
    S = found.white**2 * np.eye(t.size) + found.walk**2 * np.minimum.outer(t - t[0], t - t[0])
    S += (INITIAL_SD * np.std(np.diff(y))) ** 2
    r = y - y[0]
    wanted = -0.5 * (r @ np.linalg.solve(S, r) + np.linalg.slogdet(S)[1] + t.size * math.log(2 * math.pi))
    assert found.log_likelihood == pytest.approx(wanted, rel=1e-9)


def test_innovation_form_has_the_same_differences() -> None:
    for white, walk, dt in ((0.3, 0.2, 0.02), (0.0, 1.0, 0.5), (1.0, 0.0, 1.0)):
        c, sd = innovation_form(white, walk, dt)
        assert (1 + c * c) * sd**2 == pytest.approx(walk**2 * dt + 2 * white**2)
        assert c * sd**2 == pytest.approx(-(white**2))
        assert -1.0 <= c <= 0.0


@pytest.mark.parametrize(("white", "walk", "lost"), [(0.3, 0.0, "walk"), (0.0, 0.5, "white")])
def test_absent_part_is_flagged(white: float, walk: float, lost: str) -> None:
    found = estimate_noise(drawn(white, walk, 20_000))
    kept = "white" if lost == "walk" else "walk"
    assert getattr(found, kept) == pytest.approx(white + walk, rel=0.05)
    error = getattr(found, f"{lost}_error")
    assert math.isnan(error) or getattr(found, lost) < 3 * error
    if math.isnan(error):
        assert any(flag.startswith(lost) for flag in found.flags)
    assert not found.rejected


@pytest.mark.parametrize("lost", ["walk", pytest.param("white", marks=pytest.mark.study)])
def test_part_as_large_as_its_limit_is_found(lost: str) -> None:
    """It is found in 95 of 100 records. On average, the variance of a white part too small to be found is right."""
    dt, n, trials, missed, variances = 0.1, 400, 100, 0, []
    white, walk = (0.3, 17 * 0.3 / (n * np.sqrt(dt))) if lost == "walk" else (0.0494, 0.5)
    for seed in range(trials):
        found = estimate_noise(drawn(white, walk, n, dt, seed))
        small = getattr(found, lost), getattr(found, f"{lost}_error"), getattr(found, f"{lost}_limit")
        missed += math.isnan(small[1])
        variances.append(found.white**2)
        assert small[2] == pytest.approx(walk if lost == "walk" else white, rel=0.35)
    assert missed < 13  # Five are expected. Thirteen have a chance of one in a thousand.
    assert np.mean(variances) == pytest.approx(white**2, rel=0.2)


def test_density_agrees_with_the_periodogram() -> None:
    channel = drawn(0.3, 0.5, 100_000)
    frequency, density = welch(channel)
    ratio = density[4:] / estimate_noise(channel).psd(frequency[4:])
    for part in np.array_split(ratio, 6):
        assert np.mean(part) == pytest.approx(1.0, abs=0.15)


@pytest.mark.parametrize("walk", [0.0, pytest.param(0.1, marks=pytest.mark.study)])
def test_bands_of_the_density_cover_the_true_density(walk: float) -> None:
    """The first bands are left out, because detrending and window leakage distort them."""
    rng, inside, dt, n = np.random.default_rng(11), [], 0.1, 4000
    for _ in range(150):
        y = 0.3 * rng.normal(size=n) + np.cumsum(walk * np.sqrt(dt) * rng.normal(size=n))
        found = band_spectrum(*welch(Channel(dt * np.arange(n), y)))
        f = found.frequency
        true = 2 * dt * 0.3**2 + 2 * dt * walk**2 * dt / (2 - 2 * np.cos(2 * np.pi * f * dt))
        inside.append(((found.low < true) & (true < found.high))[5:-1])
    share = np.mean(inside, axis=0)
    assert share.size > 10
    assert 0.93 < share.mean() < 0.97
    assert share.min() > 0.85


def test_filtered_noise_is_rejected() -> None:
    rng = np.random.default_rng(0)
    smooth = np.convolve(rng.normal(size=3000), np.hanning(20) / 10, mode="same")
    found = estimate_noise(Channel(np.arange(3000) * 1.0, smooth))
    assert found.rejected
    assert found.ljung_box < 1e-6


def rejections(make: Callable[[np.random.Generator, int], np.ndarray], trials: int, n: int) -> list[NoiseFit]:
    rng = np.random.default_rng(n)
    fits = [estimate_noise(Channel(0.1 * np.arange(n), make(rng, n))) for _ in range(trials)]
    return [f for f in fits if f.rejected]


@pytest.mark.parametrize(
    ("walk", "n"),
    [
        (1.0, 60),
        *(
            pytest.param(walk, n, marks=pytest.mark.study)
            for walk in (0.0, 0.1, 1.0) for n in (60, 600, 2000) if (walk, n) != (1.0, 60)
        ),
    ],
)  # fmt: skip
def test_right_model_is_not_rejected(walk: float, n: int) -> None:
    """Each test has a level of 0.1 %, so 200 trials reject 0.6 on average. Five have a chance of one in 2500."""
    found = rejections(lambda rng, n: rng.normal(size=n) + walk * np.cumsum(rng.normal(size=n)), 200, n)
    assert len(found) < 5


SLOW = {
    "a sine": lambda rng, n: 0.1 * rng.normal(size=n) + np.sin(2 * np.pi * np.arange(n) / 200),
    "a trend": lambda rng, n: 0.1 * rng.normal(size=n) + 0.01 * np.arange(n),
    "bounded": lambda rng, n: signal.lfilter([1.0], [1.0, -0.9], rng.normal(size=n)),
}


@pytest.mark.parametrize("kind", SLOW)
def test_slow_signal_that_is_not_a_walk_is_rejected(kind: str) -> None:
    """Each correlation is small. The regression on many lags and the lowest octave find it."""
    found = rejections(SLOW[kind], 20, 2000)
    assert len(found) == 20
    assert all(f.departures.band.matters and f.departures.band.low == 0 for f in found)
    if kind != "bounded":
        assert all(f.departures.predictable.matters for f in found)
        assert all(abs(f.largest_correlation) < 0.2 for f in found)


def test_spectral_line_is_found_at_its_frequency() -> None:
    found = rejections(lambda rng, n: rng.normal(size=n) + 0.5 * np.sin(2 * np.pi * 0.17 * np.arange(n)), 20, 2000)
    assert len(found) == 20
    assert all(f.departures.line.frequency == pytest.approx(0.17, abs=1e-3) for f in found)
    assert np.mean([f.departures.line.share for f in found]) == pytest.approx(0.125 / 1.125, abs=0.02)


def test_predictable_share_is_that_of_the_truth() -> None:
    """The predictable share of an AR(1) process with coefficient phi is phi^2. That of a mean is the share of its
    square.
    """
    rng = np.random.default_rng(9)
    e = signal.lfilter([1.0], [1.0, -0.4], rng.normal(size=20_000))
    assert predictable_share(e).share == pytest.approx(0.16, abs=0.015)
    assert predictable_share(rng.normal(size=20_000) + 0.5).share == pytest.approx(0.25 / 1.25, abs=0.015)
    small = predictable_share(signal.lfilter([1.0], [1.0, -0.1], rng.normal(size=20_000)))
    assert small.p < 1e-9
    assert not small.matters  # The correlation is significant, but only 1 % of the variance.


def test_predictable_share_is_independent_of_the_unit() -> None:
    e = np.random.default_rng(9).normal(size=2000) + 0.2
    for unit in (1e-8, 1e4, 1e8):
        np.testing.assert_allclose(predictable_share(unit * e), predictable_share(e), rtol=1e-6)


def test_white_noise_has_uniform_p_values() -> None:
    acf = [autocorrelation(np.random.default_rng(seed).normal(size=500), 20) for seed in range(200)]
    p = [ljung_box(r, 500, n_fitted=2) for r in acf]
    # Two degrees of freedom are subtracted for parameters that were not fitted here.
    assert 0.3 < np.mean(p) < 0.5


def test_errors_of_heavy_tailed_noise_equal_the_spread_of_the_estimates() -> None:
    """A share of 0.2 % are outliers of ten or more standard deviations. Each record has only a few."""
    rng, fits = np.random.default_rng(3), []
    for _ in range(40):
        y = 0.01 * rng.normal(size=3000) * np.where(rng.random(3000) < 0.002, 20.0, 1.0)
        fits.append(estimate_noise(Channel(0.02 * np.arange(3000), y)))
    white, error = np.array([f.white for f in fits]), np.array([f.white_error for f in fits])
    assert sum(f.heavy_tailed for f in fits) >= 36  # Some records have no visible outlier.
    assert not any(f.coarse for f in fits)
    assert 0.6 < np.median(error) / white.std() < 1.6


def test_single_jump_gives_a_large_error_and_coarse_steps_are_found() -> None:
    t = 0.02 * np.arange(4000)
    jump = estimate_noise(Channel(t, np.where(t < 40.0, 0.0, 1e-3)))
    assert jump.heavy_tailed
    assert jump.t[np.argmax(np.abs(jump.innovations))] == pytest.approx(40.0)
    assert jump.walk_error > 0.5 * jump.walk
    fine, coarse = (
        estimate_noise(Channel(t, step * np.round(drawn(0.01, 0.0, 4000).value / step))) for step in (0.01, 0.06)
    )
    assert (fine.coarse, coarse.coarse) == (False, True)
    assert coarse.resolution == pytest.approx(0.06)
    assert not fine.heavy_tailed


def test_missing_samples_are_ignored_and_short_records_are_rejected() -> None:
    channel = drawn(0.3, 0.2, 2000)
    value = channel.value.copy()
    value[::7] = np.nan
    assert estimate_noise(Channel(channel.t, value)).n == np.isfinite(value).sum()
    with pytest.raises(ValueError, match="gyro: 20 samples are too few"):
        estimate_noise(Channel(channel.t[:20], channel.value[:20]), "gyro")
    with pytest.raises(ValueError, match="gyro: all samples have the same value"):
        estimate_noise(Channel(channel.t, np.ones(2000)), "gyro")


def gps(name: str) -> list[NoiseFit]:
    (file,) = measured("static").glob(f"gps_{name}_*.csv")
    data = np.genfromtxt(file, delimiter=",", names=True, dtype=None, encoding="utf-8")
    return [estimate_noise(Channel(data["Time"], data[axis]), axis) for axis in ("UTM_easting", "UTM_northing")]


@pytest.mark.measured
def test_single_point_gps_is_rejected() -> None:
    for axis in gps("LAB1"):
        assert axis.rejected
        assert axis.largest_correlation > 0.8


@pytest.mark.measured
def test_rtk_gps_is_white_noise_plus_a_random_walk() -> None:
    for axis in gps("LAB2"):
        assert not axis.rejected
        assert axis.white == pytest.approx(0.003, abs=0.0005)
        assert axis.walk == pytest.approx(0.0009, abs=0.0003)


@pytest.mark.measured
def test_vectornav_heading_at_rest_is_a_random_walk() -> None:
    lines = (measured("static") / "vn100_stationary_40Hz_vnymr.txt").read_text().splitlines()
    yaw = np.array([float(line.split(",")[1]) for line in lines if line.startswith("$VNYMR") and line.count(",") == 12])
    found = estimate_noise(Channel(np.arange(yaw.size) / 40.0, yaw), "yaw")
    assert found.walk == pytest.approx(0.0104, rel=0.05)  # Unit: degrees per root second
    assert found.white < 0.1 * found.walk * math.sqrt(found.interval)


def test_samples_are_cut_at_a_long_gap() -> None:
    """A sensor that drifted by much while it was off has no larger random walk. Its spectrum is that of one part."""
    first, second = drawn(0.3, 0.2, 4000), drawn(0.3, 0.2, 3000, seed=1)
    t = np.append(first.t, second.t + 86_400.0)
    both = Channel(t, np.append(first.value, second.value + 400.0))
    found = estimate_noise(both)
    assert found.n == found.innovations.size == found.t.size == 7000
    assert abs(found.white - 0.3) < 4 * found.white_error
    assert abs(found.walk - 0.2) < 4 * found.walk_error
    assert not found.rejected
    assert not found.heavy_tailed
    for density, of_one in zip(welch(both), welch(first), strict=True):
        np.testing.assert_array_equal(density, of_one)
