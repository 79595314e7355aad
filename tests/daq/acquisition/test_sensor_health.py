"""Tests of the warnings about wrong readings in correct frames: one line while the problem lasts."""

from __future__ import annotations

import math

import pytest

from seatrial.daq.acquisition.sensor_health import ERA, SensorHealth
from seatrial.daq.protocol.text_lines import SATURATED, SPIKE
from seatrial.daq.samples import Ahrs, Frame, Gnss, LoadCell, Sample
from seatrial.daq.sensor_limits import STUCK_LIVE

T0 = 1.7e9


def seen(samples: list[Sample], rate: float = 20.0) -> str:
    watch = SensorHealth()
    for k, sample in enumerate(samples):
        watch.take(Frame(sample, T0 + k / rate, math.nan))
    return watch.message()


def ahrs(k: int) -> Ahrs:
    return Ahrs(0.1, 0.0, 0.0, 0.0, 0.0, 1e-6 * k, 0.0, 0.0, -9.8)


def test_a_sensor_that_repeats_its_value_is_stuck() -> None:
    n = round(20 * STUCK_LIVE[Ahrs].seconds) + 2
    assert seen([ahrs(0)] * n) == "stuck: the same values all the time; switch its power off and on"
    assert seen([ahrs(k) for k in range(n)]) == ""
    assert seen([ahrs(0)] * (n // 2)) == ""
    assert seen([*[ahrs(0)] * n, ahrs(1)]) == ""  # the sensor delivers new values again
    assert seen([LoadCell(84210.0)] * n).startswith("stuck")
    assert seen([LoadCell(0.0)] * n) == ""  # a scale with rounded values
    assert seen([LoadCell(1234.5)] * n) == ""
    assert seen([Gnss(T0, 41.0, -8.0)] * n) == "stuck: its time does not change; switch its power off and on"
    assert seen([Gnss(T0 + k / 20, 41.0, -8.0) for k in range(n)]) == ""


def test_both_sensors_of_one_device_may_be_stuck() -> None:
    watch, limit = SensorHealth(), max(STUCK_LIVE[Ahrs].seconds, STUCK_LIVE[Gnss].seconds)
    for k in range(round(20 * limit) + 20):
        for sample in (ahrs(0), Gnss(T0, 41.0, -8.0)):
            watch.take(Frame(sample, T0 + k / 20, math.nan))
    assert set(watch.stuck) == {Ahrs, Gnss}


def test_a_compass_may_repeat_its_value_for_long() -> None:
    assert seen([Ahrs(0.1, math.nan, math.nan)] * 500) == ""


def test_a_saturated_cell_is_reported_while_it_lasts() -> None:
    good = [LoadCell(84000.0 + k) for k in range(50)]
    assert seen([*good, LoadCell(8388607.0, flags=SATURATED)]).startswith("saturated")
    assert seen([LoadCell(8388607.0, flags=SATURATED), *good]) == ""


def test_many_spikes_are_reported() -> None:
    cell = [LoadCell(84000.0 + k) for k in range(150)]
    few, many = list(cell), list(cell)
    few[20] = LoadCell(131071.0, flags=SPIKE)
    for k in (20, 50, 80):
        many[k] = LoadCell(131071.0, flags=SPIKE)
    assert seen(few) == ""
    assert seen(many).startswith("spikes")
    assert seen([*many, *[LoadCell(90000.0 + k) for k in range(250)]]) == ""  # the problem is over


@pytest.mark.parametrize(("bad", "expected"), [(1, ""), (9, ""), (12, "more than 1 frame in 20"), (200, "more than 1")])
def test_many_wrong_checksums_are_reported(bad: int, expected: str) -> None:
    watch = SensorHealth()
    for k in range(40):
        watch.count(T0 + 0.1 * k, 4 * k, round(bad * k / 39))
    assert watch.message().startswith(expected)
    assert bool(watch.message()) == bool(expected)
    for k in range(40, 120):
        watch.count(T0 + 0.1 * k, 4 * k, bad)
    assert watch.message() == ""


def test_a_date_of_another_gps_era_is_reported() -> None:
    assert seen([Gnss(T0 - ERA + 0.05 * k, 41.0, -8.0) for k in range(5)]).startswith("its date is 20 years off")
    assert seen([Gnss(T0 + 86400.0 + k, 41.0, -8.0) for k in range(5)]) == ""


def test_a_clock_jump_is_reported_for_some_time() -> None:
    watch = SensorHealth()
    watch.count(T0, 1, 0, 0)
    assert watch.message() == ""
    watch.count(T0 + 1.0, 2, 0, 1)
    assert watch.message().startswith("its clock has jumped (jump 1)")
    watch.count(T0 + 20.0, 3, 0, 1)
    assert watch.message() == ""
