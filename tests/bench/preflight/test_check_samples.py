"""Tests of the check of one device's samples: rate, repeated values, noise, gaps and clocks."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterable
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq import cli
from seatrial.daq.checks.device_checks import GAP_PERIODS, GAP_S, _check_stuck, check_devices, check_timestamps
from seatrial.daq.checks.findings import Finding
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.log.reader import open_log
from seatrial.daq.rig import Rig
from seatrial.daq.samples import NAN, Ahrs, Autopilot, Gnss, LoadCell, Sample
from seatrial.mocks.world import Reading
from tests.daq.mavlink_ends import mav_rig
from tests.missions import record

UTC = 1.75e9
NOISE = np.random.default_rng(3).normal(0.0, 0.003, 20_000)
RIG = """
format = "seatrial-rig 1"
name = "one"
[[device]]
name = "one"
protocol = "{protocol}"
port = "{port}"
rate_hz = {rate}
"""
COUNTS = "[device.calibration]\nnewton_per_count = 1.0\n"


def rig_with(protocol: str, rate: float, port: str = "/dev/ttyUSB0", more: str = "") -> Rig:
    return parse_rig(RIG.format(protocol=protocol, port=port, rate=rate) + more, Path("rig.toml"))


def bus(rate: float = 10.0) -> Rig:
    return rig_with("nmea2000", rate, "socketcan:can0")


def sampled(make: Callable[[float], Sample], rate: float, seconds: float, first: float = 0.0) -> list[Reading]:
    name = "one"
    return [Reading(name, make(k / rate), first + k / rate) for k in range(round(rate * seconds))]


def findings_of(
    path: Path, rig: Rig, readings: Iterable[Reading], metadata: dict[str, str] | None = None
) -> list[Finding]:
    device = rig.devices[0].name
    rows = sorted((r._replace(device=device) for r in readings), key=lambda r: r.t)
    with open_log(record(path / "run.mcap", rig, rows, metadata=metadata)) as log:
        return list(check_devices(log))


def codes(found: Iterable[Finding]) -> set[str]:
    return {f.code for f in found}


def heading(t: float) -> Ahrs:
    return Ahrs(0.5 + 0.3 * math.sin(0.2 * t) + float(NOISE[round(100 * t) % NOISE.size]), NAN, NAN)


def turning(t: float) -> Ahrs:
    return Ahrs(NAN, NAN, NAN, r=0.06 * math.cos(0.2 * t))


def attitude(t: float) -> Ahrs:
    noise = float(NOISE[round(100 * t) % NOISE.size])
    return Ahrs(0.5 + noise, 0.1 * noise, 0.0, noise, noise, noise)


def fix(t: float) -> Gnss:
    return Gnss(UTC + t, 63.4, 10.4, vel_n=0.0, vel_e=0.0, fix=3, n_sat=12)


@pytest.mark.parametrize("degrees", [0.1, 1.0])
def test_a_compass_with_repeated_values_is_not_stuck(tmp_path: Path, degrees: float) -> None:
    def rounded(t: float) -> Ahrs:
        swing = 0.02 if degrees == 0.1 else 30.0
        steps = round((40.0 + swing * math.sin(0.2 * t)) / degrees)
        return Ahrs(math.radians(degrees * steps), NAN, NAN)

    assert "sensor-stuck" not in codes(findings_of(tmp_path, rig_with("nmea", 10.0), sampled(rounded, 10.0, 60.0)))


def test_a_receiver_before_its_first_fix_is_not_stuck(tmp_path: Path) -> None:
    def cold(t: float) -> Gnss:
        return Gnss(NAN, NAN, NAN) if t < 20.0 else fix(t)

    assert "sensor-stuck" not in codes(findings_of(tmp_path, rig_with("ubx", 5.0), sampled(cold, 5.0, 60.0)))


@pytest.mark.parametrize(
    ("counts", "stuck"), [(0.0, False), (0.02, False), (3.0, False), (512.34, True), (60.0, True), (84210.0, True)]
)
def test_constant_counts_at_rest_are_fine_from_a_scale_but_not_from_a_converter(
    tmp_path: Path, counts: float, stuck: bool
) -> None:
    found = findings_of(
        tmp_path, rig_with("loadcell", 10.0, more=COUNTS), sampled(lambda t: LoadCell(counts), 10.0, 10.0)
    )
    assert ("sensor-stuck" in codes(found)) == stuck


@pytest.mark.parametrize("stuck", [False, True])
def test_a_load_cell_with_small_counts_that_repeats_under_thrust_is_stuck(tmp_path: Path, stuck: bool) -> None:
    def pull(t: float) -> LoadCell:
        """Return counts that equal the tare at rest and vary under thrust until the cell gets stuck."""
        held = 30.0 if stuck and t > 30.0 else t
        return LoadCell(0.02 if t < 20.0 else round(512.34 + 100.0 * float(NOISE[round(100 * held)]), 2))

    cell = rig_with("loadcell", 10.0, more=COUNTS)
    found = [f for f in findings_of(tmp_path, cell, sampled(pull, 10.0, 40.0)) if f.code == "sensor-stuck"]
    assert [f.text for f in found] == ["the same values for 9.9 s, from 30.0 s on"] * stuck


def test_an_attitude_that_repeats_between_changing_accelerations_is_stuck(tmp_path: Path) -> None:
    def acceleration(t: float) -> Ahrs:
        return Ahrs(NAN, NAN, NAN, ax=float(NOISE[round(100 * t)]), ay=0.0, az=-9.81)

    hung = sampled(lambda t: attitude(min(t, 5.0)), 10.0, 20.0)
    (found,) = [
        f for f in findings_of(tmp_path, mav_rig(rate=10.0), [*hung, *sampled(acceleration, 10.0, 20.0, 0.03)])
        if f.code == "sensor-stuck"
    ]  # fmt: skip
    assert found.text.startswith("the same values for 14.9 s, from 5.0 s on")


def test_the_search_for_a_stuck_sensor_is_fast() -> None:
    noise = np.random.default_rng(4).standard_normal(50_000)
    table = np.zeros(noise.size, dtype=[(name, float) for name in ("t", "yaw", "p", "q", "r", "ax", "ay", "az")])
    table["t"], table["yaw"] = 0.01 * np.arange(noise.size), noise

    def seconds(work: Callable[[], object]) -> float:
        began = time.process_time()
        work()
        return time.process_time() - began

    sort = min(seconds(lambda: np.sort(noise)) for _ in range(3))
    assert min(seconds(lambda: list(_check_stuck(Ahrs, "ahrs", table))) for _ in range(2)) < 40.0 * sort


def test_the_rate_of_an_nmea_2000_bus_is_that_of_its_headings(tmp_path: Path) -> None:
    other_samples = [*sampled(turning, 10.0, 20.0, 0.01), *sampled(fix, 5.0, 20.0, 0.02)]
    (of_rate,) = [
        f for f in findings_of(tmp_path, bus(), [*sampled(heading, 10.0, 20.0), *other_samples]) if f.check == "rate"
    ]
    assert (of_rate.code, of_rate.text) == ("rate-as-expected", "10 Hz, expected 10")


def test_the_rate_of_an_nmea_2000_bus_without_a_compass_is_that_of_its_fixes(tmp_path: Path) -> None:
    rows = [*sampled(turning, 10.0, 20.0), *sampled(fix, 5.0, 20.0, 0.02)]
    (of_rate,) = [f for f in findings_of(tmp_path, bus(5.0), rows) if f.check == "rate"]
    assert (of_rate.code, of_rate.text) == ("rate-as-expected", "5 Hz, expected 5")


@pytest.mark.parametrize("noise", [False, True])
def test_the_noise_of_headings_between_rates_of_turn_is_reported(tmp_path: Path, noise: bool) -> None:
    def shaken(t: float) -> Ahrs:
        return Ahrs(heading(t).yaw + 150.0 * noise * float(NOISE[round(100 * t)]), NAN, NAN)

    found = findings_of(tmp_path, bus(), [*sampled(shaken, 10.0, 20.0), *sampled(turning, 10.0, 20.0, 0.05)])
    assert ("sensor-noisy" in codes(found)) == noise


def test_a_missing_heading_does_not_hide_the_noise_of_the_others(tmp_path: Path) -> None:
    def shaken(t: float) -> Ahrs:
        return Ahrs(NAN if t == 1.0 else 100.0 * float(NOISE[round(100 * t)]), 0.0, 0.0, r=0.0)

    assert "sensor-noisy" in codes(findings_of(tmp_path, rig_with("nmea", 10.0), sampled(shaken, 10.0, 20.0)))


@pytest.mark.parametrize(
    ("rate", "metadata", "code", "text"),
    [
        (10.0, {}, "rate-as-expected", "10 Hz, expected 10"),
        (4.0, {}, "rate-off", "4 Hz, expected 10"),
        (0.01, {}, "rate-off", "no attitudes, expected 10 per second"),
        # the rates of a ground station, for all kinds of samples together
        (4.0, {"import": "mavlink"}, "rate-measured", "imu 4 Hz, gnss 5 Hz"),
    ],
)
def test_the_rate_of_an_autopilot_is_that_of_its_attitudes(
    tmp_path: Path, rate: float, metadata: dict[str, str], code: str, text: str
) -> None:
    rows = [*sampled(attitude, rate, 20.0), *sampled(fix, 5.0, 20.0, 0.02)]
    (of_rate,) = [f for f in findings_of(tmp_path, mav_rig(rate=10.0), rows, metadata) if f.check == "rate"]
    assert of_rate.code == code
    assert of_rate.text.startswith(text)


@pytest.mark.parametrize("first", [1.0, 4.0])
@pytest.mark.parametrize(("then", "code"), [(25.0, "rate-as-expected"), (15.0, "rate-off")])
def test_samples_of_an_autopilot_before_the_request_of_rates_do_not_count(
    tmp_path: Path, first: float, then: float, code: str
) -> None:
    rows = [*sampled(attitude, first, 1.0), *sampled(attitude, then, 2.0, 1.0)]
    (of_rate,) = [f for f in findings_of(tmp_path, mav_rig(rate=25.0), rows) if f.check == "rate"]
    assert of_rate.code == code


def test_an_autopilot_that_sends_only_its_state_has_no_attitudes(tmp_path: Path) -> None:
    found = findings_of(tmp_path, mav_rig(), sampled(lambda t: Autopilot(0, 0, 3), 1.0, 5.0))
    assert [(f.level, f.text) for f in found if f.code == "rate-off"] == [
        ("fault", "no attitudes, expected 25 per second")
    ]


def test_three_losses_of_half_a_minute_are_reported(tmp_path: Path) -> None:
    rows = [r._replace(t=r.t + 30.0 * (k // 25)) for k, r in enumerate(sampled(fix, 1.0, 100.0))]
    (gap,) = [f for f in findings_of(tmp_path, rig_with("ubx", 1.0), rows) if f.check == "gap"]
    assert gap.code == "sections-missing"
    assert gap.text.startswith("data missing: 3 sections, 93.0 s in all")


def test_a_pause_of_a_device_whose_samples_arrive_in_groups_is_reported(tmp_path: Path) -> None:
    rows = [r._replace(t=0.2 * (k // 2) + 60.0 * (k >= 700)) for k, r in enumerate(sampled(attitude, 10.0, 140.0))]
    found = findings_of(tmp_path, rig_with("nmea", 10.0), rows)
    assert {"samples-bunched", "sections-missing", "rate-as-expected"} <= codes(found), found
    (gap,) = [f for f in found if f.code == "sections-missing"]
    assert gap.text == "data missing: 1 section, 60.2 s in all, the longest (60.2 s) from 69.8 s on (pauses above 2 s)"


def _with_clock(t: np.ndarray, late: np.ndarray) -> np.ndarray:
    table = np.zeros(t.size, dtype=[("t", float), ("t_rx", float), ("t_device", float)])
    table["t"], table["t_rx"], table["t_device"] = t, t + late, t
    return table


@pytest.mark.parametrize("period", [0.9, 1.0, 5.0])
def test_the_clock_of_a_slow_device_is_compared(period: float) -> None:
    t = period * np.arange(100.0)
    late = 0.02 * np.random.default_rng(1).random(t.size)
    assert "clock-steady" in codes(check_timestamps("gnss", _with_clock(t, late), t[-1]))
    jumps = late + np.where(t > 50.0 * period, 3.0, 0.0)
    assert "clock-jumps" in codes(check_timestamps("gnss", _with_clock(t, jumps), t[-1]))


def test_too_few_samples_of_a_clock_cause_no_error() -> None:
    t = np.sort(np.concatenate([1e-3 * np.arange(49.0), [500.0, 900.0]]))
    list(check_timestamps("gnss", _with_clock(t, np.zeros(t.size)), t[-1]))


def test_the_help_of_info_has_the_limits_that_the_check_has_for_gaps() -> None:
    text = " ".join((cli.info.help or "").split())
    assert f"longer than {GAP_S:g} s and {GAP_PERIODS:g} sample intervals, they are missing sections" in text
