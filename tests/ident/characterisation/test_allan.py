"""Tests of the Allan deviation: white noise, random walk and flicker floor, and the units of data sheets."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.characterisation.allan import allan_deviation
from seatrial.ident.data.record import Channel
from seatrial.ident.report.sections.noise import data_sheet
from seatrial.ident.results.commands import ChannelNoise

DT = 0.02
DEG = np.pi / 180
T = np.arange(0.0, 2000.0, DT)


def test_white_noise_falls_with_the_root_of_time() -> None:
    white = 3e-3 * np.random.default_rng(0).standard_normal(T.size)
    found = allan_deviation(Channel(T, white + 7.0, "rad/s"))
    assert found is not None
    short = found.tau < 50.0
    np.testing.assert_allclose(found.deviation[short], 3e-3 * np.sqrt(DT / found.tau[short]), rtol=0.15)
    assert found.tau[0] == pytest.approx(DT)
    assert found.tau[-1] == pytest.approx(400.0)
    # The first values of the record are independent: their error is that of a variance of n samples.
    assert found.error[0] == pytest.approx(found.deviation[0] / np.sqrt(2.0 * T.size), rel=0.01)


def test_random_walk_rises_and_its_bias_instability_is_at_the_minimum() -> None:
    rng = np.random.default_rng(1)
    walk, white = 1e-4, 3e-3
    y = white * rng.standard_normal(T.size) + walk * np.sqrt(DT) * np.cumsum(rng.standard_normal(T.size))
    found = allan_deviation(Channel(T, y, "rad/s"))
    assert found is not None
    late = (found.tau > 30.0) & (found.tau < 100.0)
    model = np.sqrt(white**2 * DT / found.tau + walk**2 * found.tau / 3.0)
    np.testing.assert_allclose(found.deviation[late], model[late], rtol=0.35)
    # The minimum of N^2 / tau + K^2 tau / 3 is at sqrt(3) N / K.
    assert found.bias_tau == pytest.approx(np.sqrt(3.0) * white * np.sqrt(DT) / walk, rel=0.6)
    assert not found.is_limit
    assert found.bias_instability == pytest.approx(found.deviation.min() / 0.664)


def test_short_or_constant_channel_has_none_and_gaps_are_left_out() -> None:
    assert allan_deviation(Channel(T[:9], T[:9])) is None
    assert allan_deviation(Channel(T, np.ones(T.size))) is None
    y = np.random.default_rng(2).standard_normal(T.size)
    jump = np.where(T > 1200.0, 100.0, 0.0)
    later = allan_deviation(Channel(np.where(T > 1200.0, T + 300.0, T), y + jump))
    assert later is not None
    assert later.deviation.max() < 1.5


@pytest.mark.parametrize(
    ("unit", "expected"),
    [
        (
            "rad/s",
            [(0.29 * DEG / 60, "deg/√h"), (8.0 * DEG / 3600, "deg/h"), (DEG / 216000, "deg/h/√h")],
        ),
        ("m/s2", [(0.05 / 60, "m/s/√h"), (40e-6 * 9.80665, "µg"), (1e-6 * 9.80665 / 60, "µg/√h")]),
        ("rad", [(np.pi / 180, "deg/√Hz"), (np.pi / 180, "deg"), (np.pi / 180, "deg/√s")]),
        ("N", [(1.0, "N/√Hz"), (1.0, "N"), (1.0, "N/√s")]),
    ],
)  # fmt: skip
def test_numbers_are_in_the_units_of_data_sheets(unit: str, expected: list[tuple[float, str]]) -> None:
    shown = {"rad/s": (0.29, 8.0, 1.0), "m/s2": (0.05, 40.0, 1.0)}.get(unit, (1.0, 1.0, 1.0))
    e = np.zeros(0)
    channel = ChannelNoise(
        channel="r", unit=unit, white=1.0, random_walk=1.0, se_white=None, se_random_walk=None, accepted=True, p=None,
        predictable=None, reason=None, frequency=e, psd=e, psd_model=e,
    )  # fmt: skip
    for (factor, name), (value, wanted), number in zip(data_sheet(channel), expected, shown, strict=True):
        assert name == wanted
        assert factor * value == pytest.approx(number)
