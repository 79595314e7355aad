"""Tests of a late group of sensors and of late thrust, found by the motion that follows the thrust."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from seatrial.daq.checks import Finding
from seatrial.ident.checks.latency import (
    SensorDelay,
    _attitude_velocity_delay,
    check_latency,
    compare_sensor_delays,
    sensor_delay_of,
)
from seatrial.ident.checks.sensors import LagEstimate, why_no_warning
from seatrial.ident.data import Channel

SIDES = {"left": -0.35, "right": 0.35}
DT, SECONDS, SHAFT_LAG = 0.02, 180.0, 0.2
ATTITUDE, VELOCITY = ("psi", "r"), ("x", "y", "vx", "vy")
COMMANDS, SHAFTS = ("n_cmd_left", "n_cmd_right"), ("n_left", "n_right")


@cache
def sailed(seed: int, shaft_lag: float = SHAFT_LAG) -> Mapping[str, Channel]:
    """Simulate a boat of 50 kg with two thrusters by Euler's method: steps of the commands, sensors with noise."""
    rng = np.random.default_rng(seed)
    n_steps = round(SECONDS / DT)
    t = DT * np.arange(n_steps)
    n_cmd = np.repeat(rng.uniform(-0.5, 0.9, (n_steps, 2))[::250], 250, axis=0)[:n_steps]
    n_cmd[:100] = 0.0
    rows = np.empty((n_steps, 8))
    x, y, psi, u, v, r = np.zeros(6)
    n = np.zeros(2)
    for k in range(n_steps):
        rows[k] = x, y, psi, u, v, r, *n
        f = 35.0 * n * np.abs(n)
        du = (f.sum() + 75.0 * v * r - 8.0 * u - 20.0 * abs(u) * u) / 50.0 + rng.normal(0.0, 0.03)
        dv = (-50.0 * u * r - 50.0 * v - 50.0 * abs(v) * v) / 75.0
        dr = ((f[0] - f[1]) * 0.35 - 25.0 * u * v - 8.0 * r - 8.0 * abs(r) * r) / 10.0 + rng.normal(0.0, 0.03)
        x, y = x + DT * (u * np.cos(psi) - v * np.sin(psi)), y + DT * (u * np.sin(psi) + v * np.cos(psi))
        psi, u, v, r = psi + DT * r, u + DT * du, v + DT * dv, r + DT * dr
        n = n + DT / max(shaft_lag, DT) * (n_cmd[k] - n)
    x_, y_, psi_, u_, v_, r_ = rows[:, :6].T
    vx, vy = u_ * np.cos(psi_) - v_ * np.sin(psi_), u_ * np.sin(psi_) + v_ * np.cos(psi_)

    def channel(value: np.ndarray, every: int, noise: float, hold: str = "") -> Channel:
        own = value[::every]
        return Channel(t[::every], own + rng.normal(0.0, noise, own.size) if noise else own, hold=hold)

    found = {"psi": channel(psi_, 5, 0.005), "r": channel(r_, 5, 0.004)}
    found |= {"x": channel(x_, 10, 0.1), "y": channel(y_, 10, 0.1)}
    found |= {"vx": channel(vx, 10, 0.03), "vy": channel(vy, 10, 0.03)}
    for k, side in enumerate(SIDES):
        found[f"n_{side}"] = channel(rows[:, 6 + k], 5, 0.002, "linear")
        found[f"n_cmd_{side}"] = channel(n_cmd[:, k], 5, 0.0, "zero")
    return found


def log(*groups: tuple[str, ...], late: tuple[str, ...] = (), by: float = 0.0, seed: int = 1) -> dict[str, Channel]:
    """Return these groups of signals. The signals in ``late`` are delayed ``by`` seconds."""
    own = {name: sailed(seed)[name] for group in groups for name in group}
    return {n: Channel(c.t + by * (n in late), c.value, c.unit, c.source, c.hold) for n, c in own.items()}


def alarms(c: Mapping[str, Channel]) -> list[Finding]:
    return [f for f in check_latency(c, SIDES) if f.is_problem]


@pytest.mark.parametrize("thrust", [COMMANDS, SHAFTS])
@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_sensors_in_time_give_no_alarm(thrust: tuple[str, ...], seed: int) -> None:
    found = list(check_latency(log(ATTITUDE, VELOCITY, thrust, seed=seed), SIDES))
    assert [f.code for f in found] == ["sensors-in-time", "thrust-in-time"]
    assert all("95 %" in f.text for f in found)
    assert re.match(r"(heading and yaw rate come|velocity comes) 0\.\d\d s after ", found[0].text)


@pytest.mark.parametrize(("late", "by", "device"), [(ATTITUDE, 0.18, "compass"), (VELOCITY, 0.15, "gnss")])
def test_short_delay_is_ok_and_the_text_says_why(late: tuple[str, ...], by: float, device: str) -> None:
    """The row has the name of the late device, and an interval without zero comes with the reason why it is ok."""
    sources = dict.fromkeys(ATTITUDE, "compass") | dict.fromkeys(VELOCITY, "gnss")
    c = log(ATTITUDE, VELOCITY, COMMANDS, late=late, by=by)
    c = {n: replace(own, source=sources.get(n, "thruster")) for n, own in c.items()}
    sensors, thrust = check_latency(c, SIDES)
    assert (sensors.code, sensors.level, sensors.where) == ("sensors-in-time", "ok", device)
    assert "; too short for a warning, which begins at 0.3 s" in sensors.text
    assert sensors.text.endswith("; a fit estimates and corrects it if it matters")
    assert (thrust.code, thrust.level) == ("thrust-in-time", "ok")
    assert thrust.text.endswith("; the lag of the thrusters is a part of it, which a fit estimates")


SHORT = "too short for a warning, which begins at 0.3 s"
FITTED = "a fit estimates and corrects it if it matters"


@pytest.mark.parametrize(
    ("lag", "half", "words"),
    [
        (0.15, 0.04, f"; {SHORT}; {FITTED}"),
        (0.03, 0.04, ""),
        (0.25, 0.1, f"; {SHORT}, although the log does not exclude a delay of up to 0.35 s; {FITTED}"),
        (0.15, 0.2, "; the log does not exclude a delay of up to 0.35 s"),
    ],
)
def test_a_delay_that_differs_from_zero_says_why_it_is_no_warning(lag: float, half: float, words: str) -> None:
    assert why_no_warning(lag, half) == words
    assert why_no_warning(lag, half, fitted=False) == words.removesuffix(f"; {FITTED}")


def in_a_turning_current(c: dict[str, Channel], speed: float) -> dict[str, Channel]:
    """Add a current that turns by 150 deg during the log. The boat is at rest in the water at the start."""
    for n, wave in (("vx", np.cos), ("vy", np.sin)):
        direction = np.radians(40.0 + 150.0 * c[n].t / SECONDS)
        c[n] = replace(c[n], value=c[n].value + speed * wave(direction))
    return c


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_turning_current_is_no_delay(seed: int) -> None:
    """The drag by the water changes with heading and time. Without terms for it the velocity appears 0.2 s early, or
    its delay is unknown.
    """
    found = list(check_latency(in_a_turning_current(log(ATTITUDE, ("vx", "vy"), SHAFTS, seed=seed), 0.4), SIDES))
    assert [f.code for f in found] == ["sensors-in-time", "thrust-in-time"]
    lag = float(found[0].text.split(" s after")[0].split()[-1])
    assert lag < 0.12


@pytest.mark.parametrize("thrust", [COMMANDS, SHAFTS])
@pytest.mark.parametrize(("late", "words"), [(ATTITUDE, "heading and yaw rate come"), (VELOCITY, "velocity comes")])
@pytest.mark.parametrize(("by", "level"), [(0.5, "fault"), (0.9, "fault")])
def test_late_group_of_sensors_is_found(
    thrust: tuple[str, ...], late: tuple[str, ...], words: str, by: float, level: str
) -> None:
    (found,) = alarms(log(ATTITUDE, VELOCITY, thrust, late=late, by=by))
    assert (found.code, found.level) == ("sensor-late", level)
    assert "this is the delay between these two signals; a diagnosis estimates" in found.advice
    assert found.text.startswith(words)
    assert float(found.text.split(" s after")[0].split()[-1]) == pytest.approx(by, abs=0.2)


@pytest.mark.parametrize(("thrust", "by"), [(SHAFTS, 0.5), (SHAFTS, 1.0), (COMMANDS, 0.8)])
def test_late_thrust_is_found(thrust: tuple[str, ...], by: float) -> None:
    (found,) = alarms(log(ATTITUDE, VELOCITY, thrust, late=thrust, by=by))
    assert found.code == "thrust-late"
    lag = SHAFT_LAG if thrust is COMMANDS else 0.0
    assert float(found.text.split(" s before")[0].split()[-1]) == pytest.approx(by - lag, abs=0.2)


def test_measured_shafts_before_all_sensors_are_found() -> None:
    (found,) = alarms(log(ATTITUDE, VELOCITY, SHAFTS, late=(*ATTITUDE, *VELOCITY), by=0.7))
    assert found.code == "motion-late"


def test_lag_of_shafts_behind_commands_gives_no_alarm() -> None:
    """A fit estimates the delay of the shafts."""
    assert not alarms(log(ATTITUDE, VELOCITY, COMMANDS, late=(*ATTITUDE, *VELOCITY), by=0.7))


@pytest.mark.parametrize(("late", "by"), [((), 0.0), (("psi",), 0.8), (("x", "y"), 0.8)])
def test_late_sensor_is_found_without_gyro_and_velocity(late: tuple[str, ...], by: float) -> None:
    found = alarms(log(("psi",), ("x", "y"), SHAFTS, late=late, by=by))
    assert [f.code for f in found] == ["sensor-late"] * bool(late)


def test_unknown_delay_is_reported() -> None:
    """With a constant thrust, a course that follows its heading may be sideslip. Without thrust nothing is compared."""
    assert not list(check_latency(log(ATTITUDE, VELOCITY, late=ATTITUDE, by=0.8), SIDES))
    constant = log(ATTITUDE, VELOCITY, COMMANDS)
    constant |= {n: Channel(constant[n].t, np.full(constant[n].t.size, 0.5), hold="zero") for n in COMMANDS}
    assert {(f.code, f.level) for f in check_latency(constant, SIDES)} == {("delay-unknown", "unknown")}
    assert "not known" in next(check_latency(constant, SIDES)).text


@pytest.mark.parametrize(("lag", "where"), [(0.41, "ahrs"), (-0.41, "gnss")])
def test_delay_that_is_not_decided_is_shown_at_the_late_signal(lag: float, where: str) -> None:
    """The interval of 0.41 s reaches down to small delays: the log does not decide, and says what to check."""
    yaw, speed = (LagEstimate(x, 0.1, 0.95) for x in (max(lag, 0.0), max(-lag, 0.0)))
    (found,) = _attitude_velocity_delay(yaw, speed, "ahrs", "gnss")
    assert (found.code, found.level, found.where) == ("delay-unknown", "unknown", where)
    assert f"time stamps of {'velocity' if where == 'gnss' else 'heading and yaw rate'}; a longer log" in found.advice


def test_pauses_of_a_receiver_are_ignored() -> None:
    c = log(ATTITUDE, VELOCITY, SHAFTS)
    for name in VELOCITY:
        out = (c[name].t % 40.0) < 6.0
        c[name] = Channel(c[name].t[~out], c[name].value[~out])
    assert not alarms(c)


def delays(*of_logs: tuple[float, float], systematic: float = 0.1) -> list[tuple[str, SensorDelay | None]]:
    """Return delays [s] of several logs, each with its random half interval [s]."""
    return [
        (f"run{k}", SensorDelay(lag, random, systematic, "compass", "gnss", "velocity"))
        for k, (lag, random) in enumerate(of_logs, 1)
    ]


def test_delay_of_several_logs_is_their_mean() -> None:
    """Each log alone hardly shows the delay. The systematic error does not become less with the number of logs."""
    of_logs = delays((-0.30, 0.10), (-0.18, 0.10), (-0.27, 0.10), (-0.24, 0.10))
    ((name, finding),) = compare_sensor_delays([*of_logs, ("drift", None)])
    assert (name, finding.level, finding.where) == ("4 logs together", "ok", "gnss")
    assert "velocity comes 0.25 s after heading and yaw rate" in finding.text
    assert "(95 %: 0.14 to 0.36 s); it is not zero, but below the limit of a warning, 0.3 s" in finding.text
    ((_, longer),) = compare_sensor_delays(delays((-0.28, 0.15), (-0.29, 0.15), (-0.27, 0.15), systematic=0.02))
    assert (longer.level, longer.code) == ("warning", "sensor-late")


@pytest.mark.parametrize(
    "of_logs",
    [
        ((-0.25, 0.05),),
        ((0.05, 0.1), (-0.02, 0.1)),
        ((-0.20, 0.02), (-0.10, 0.02)),
        ((-0.70, 0.05), (-0.66, 0.05)),
    ],
    ids=["one log", "zero", "unlike", "each log has a finding"],
)
def test_no_common_delay_is_claimed(of_logs: tuple[tuple[float, float], ...]) -> None:
    assert compare_sensor_delays(delays(*of_logs)) == []


def test_common_delay_has_the_estimate_of_each_log() -> None:
    found = sensor_delay_of(log(ATTITUDE, VELOCITY, SHAFTS, late=VELOCITY, by=0.2), SIDES)
    assert found is not None
    assert found.lag == pytest.approx(-0.2, abs=found.half)
    assert sensor_delay_of(log(ATTITUDE, SHAFTS), SIDES) is None
