"""Tests of the decimation: every point is a sample, no peak is lost, and gaps stay."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from seatrial.daq.view.decimation import decimate, longest_period


def noisy(n: int = 50_000, rate: float = 100.0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(3)
    t = 1.7e9 + np.arange(n) / rate + rng.uniform(0.0, 0.2 / rate, n)
    return t, np.sin(t) + rng.standard_normal(n)


def test_extremes_of_every_interval_are_samples_of_the_log() -> None:
    t, values = noisy()
    begin, end, n = t[7000], t[43_000], 300
    found = decimate(t, values, begin, end, n, longest_period(t, values))
    samples = set(zip(t.tolist(), values.tolist(), strict=True))
    assert samples.issuperset(zip(found.t.tolist(), found.value.tolist(), strict=True))
    assert np.all(np.diff(found.t) > 0)
    assert len(found.t) <= 2 * (n + 2)
    edges = begin + (end - begin) * np.arange(n + 1) / n
    for a, b in pairwise(edges):
        raw = values[(t >= a) & (t < b)]
        drawn = found.value[(found.t >= a) & (found.t < b)]
        assert (drawn.min(), drawn.max()) == (raw.min(), raw.max())


def test_a_single_spike_of_an_hour_is_drawn() -> None:
    t = np.arange(360_000) / 100.0
    values = np.zeros(len(t))
    values[123_456] = 9.0
    assert decimate(t, values, 0.0, 3600.0, 800, np.inf).value.max() == 9.0


def test_few_samples_are_drawn_unchanged_with_one_neighbour_on_each_side() -> None:
    t, values = noisy(1000)
    found = decimate(t, values, t[100], t[200], 400, np.inf)
    np.testing.assert_array_equal(found.t, t[99:202])
    np.testing.assert_array_equal(found.value, values[99:202])


@pytest.mark.parametrize("n_intervals", [100, 100_000])
def test_a_gap_is_a_point_of_nan(n_intervals: int) -> None:
    t, values = noisy()
    present = (t < t[20_000]) | (t > t[20_000] + 30.0)
    t, values = t[present], values[present]
    found = decimate(t, values, t[0], t[-1], n_intervals, longest_period(t, values))
    (place,) = np.flatnonzero(np.isnan(found.value))
    assert found.t[place - 1] <= t[19_999] < found.t[place] < t[20_000] <= found.t[place + 1]


def test_samples_without_a_value_are_a_gap() -> None:
    t, values = noisy()
    values[30_000:34_000] = np.nan
    found = decimate(t, values, t[0], t[-1], 200, longest_period(t, values))
    (place,) = np.flatnonzero(np.isnan(found.value))
    assert t[29_999] < found.t[place] < t[34_000]


def test_a_gap_shorter_than_an_interval_is_not_shown() -> None:
    t, values = noisy()
    t[20_000:] += 0.3  # an interval has 5 s
    found = decimate(t, values, t[0], t[-1], 100, longest_period(t, values))
    assert not np.isnan(found.value).any()


def test_an_empty_signal_and_a_single_sample_are_drawn() -> None:
    nothing = np.zeros(0)
    assert len(decimate(nothing, nothing, 0.0, 1.0, 10, np.inf).t) == 0
    assert decimate(np.array([3.0]), np.array([2.0]), 0.0, 1.0, 10, np.inf).value.tolist() == [2.0]
    assert longest_period(np.array([3.0]), np.array([2.0])) == np.inf
    blank = np.full(5000, np.nan)
    assert len(decimate(np.arange(5000.0), blank, 0.0, 5000.0, 10, 1.0).t) == 0
