"""The guard as a state machine: controllers, frozen sources, jumps, rates, and random sequences of statuses."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from seatrial.bench.execution import safety_guard as guard_module
from seatrial.bench.execution.safety_guard import (
    AT_REST_S,
    COAST_S,
    DUTY_LASTS_S,
    EARTH_RADIUS_M,
    FROZEN_S,
    JUMP_SPEED,
    LIMIT_MAX_S,
    GuardState,
    SafetyGuard,
    Stop,
    StopCode,
)
from seatrial.daq.acquisition.status import Latest, PortStatus, Status
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.drivers import LinkStatus
from seatrial.daq.errors import SafetyStop
from seatrial.daq.rig import Limits, Rig
from seatrial.daq.samples import Ahrs, Esc, Gnss, LoadCell, Sample, Servo
from tests.bench.execution.test_safety_guard import GNSS
from tests.bench.standin import RIG
from tests.daq.mavlink_ends import mav_rig

T = 1_763_616_000.0
NAN = math.nan
DT = 0.05
ESC, CELL, FIX = ("esc", 1), ("loadcell", None), ("gnss", None)
METRE = math.degrees(1.0 / EARTH_RADIUS_M)  # of latitude
Device = Callable[[float, float], Sample]  # run time and command to a sample


def rig_of(tmp_path: Path, **limits: float | tuple[str, ...]) -> Rig:
    """Return a rig with one thruster, a load cell, GNSS and AHRS, and these limits alone."""
    rig = parse_rig(RIG.format(speed=1.0).replace("[[thruster]]", GNSS + "[[thruster]]"), tmp_path / "rig.toml")
    return replace(rig, limits=replace(Limits(), **limits))


def port(name: str, rate: float = 40.0) -> PortStatus:
    return PortStatus(name, "", f"ports/{name}", rate, rate, 0.01, 99, 99, 0, 0, 0, 0, 999, 0.0, 0.0, "")


def status(t: float, n: float, latest: dict[tuple[str, int | None], Sample], **changes: object) -> Status:
    ports = {name: port(name) for name in ("esc", "loadcell", "gnss", "ahrs")}
    found = {source: Latest(sample, T + t - 0.01) for source, sample in latest.items()}
    made = Status(T + t, ports, found, {"left": n}, 3, "run.mcap", round(1000 * t), 10, t, "", ())
    return replace(made, **changes)  # type: ignore[arg-type]


def ran(
    rig: Rig, seconds: float, n: Callable[[float], float], devices: dict[tuple[str, int | None], Device]
) -> tuple[float, Stop | None]:
    """Return the time and the stop of a run of the guard over these devices; infinity and None without one."""
    guard = SafetyGuard(rig, 1.0, ("left",))
    guard.start()
    for k in range(1, round(seconds / DT)):
        t = k * DT
        latest = {source: device(t, n(t)) for source, device in devices.items()}
        if stop := guard.step(T + t, status(t, n(t), latest)).stop:
            return t, stop
    return math.inf, None


def steps(t: float) -> float:
    """Return commands up to 0.8 of either sign, with rests of 4 s."""
    return (0.0, 0.4, 0.0, -0.4, 0.0, 0.8, 0.2, 0.0)[int(t / 4.0) % 8]


class Shaft:
    """A thruster whose speed follows its command with a lag, behind a controller that reports some quantities."""

    def __init__(self, tau: float = 0.3, *, duty: bool = True, current: bool = True, limited: float = 1.0) -> None:
        self.rpm, self._tau, self._duty, self._current, self._limited = 0.0, tau, duty, current, limited
        self.wake_rpm = 0.0  # at which the water turns the propeller

    def __call__(self, t: float, n: float) -> Esc:
        aim = 4500.0 * min(max(n, -self._limited), self._limited)
        self.wake_rpm = max(self.wake_rpm, 0.6 * abs(aim)) / (1.0 + DT * self.wake_rpm / 9000.0)
        if n == 0.0:
            aim = self.wake_rpm
        self.rpm += (aim - self.rpm) * DT / self._tau
        put_out = min(max(n, -self._limited), self._limited) if self._duty else NAN
        drawn = 20.0 * abs(n) + 0.01 * math.sin(9.0 * t) if self._current else NAN
        return Esc(1, self.rpm + math.sin(7.0 * t), drawn, put_out, 24.0 + 0.01 * math.sin(t), 30.0)


@pytest.mark.parametrize("tau", [0.1, 0.8])
@pytest.mark.parametrize("limited", [1.0, 0.5])
@pytest.mark.parametrize(("duty", "current"), [(True, True), (False, True), (True, False), (False, False)])
def test_a_controller_that_follows_ends_no_run(
    tmp_path: Path, tau: float, limited: float, duty: bool, current: bool
) -> None:
    """Simulate a lag, a current limit and a propeller that the wake turns for a while after zero."""
    shaft = Shaft(tau, duty=duty, current=current, limited=limited)
    assert ran(rig_of(tmp_path), 64.0, steps, {ESC: shaft}) == (math.inf, None)


def stuck_at_zero(kind: str) -> Device:
    """Return a controller that follows until zero is commanded after 8 s, and goes on at 2700 rpm."""

    def device(t: float, n: float) -> Esc:
        ignores = t > 8.0 and n == 0.0
        rpm = 2700.0 if ignores or n != 0.0 else 0.0
        shake = math.sin(7.0 * t)
        duty = {"duty": 0.6 if ignores else n, "silent": NAN, "zero": n}[kind]
        return Esc(1, rpm + shake, 8.0 + 0.1 * shake if rpm else 0.1, duty, 24.0 - 0.01 * shake, 30.0)

    return device


@pytest.mark.parametrize(("kind", "within"), [("duty", 1.0 + 0.25 + DUTY_LASTS_S + 0.3), ("silent", COAST_S + 0.5)])
def test_a_controller_that_ignores_zero_ends_the_run(tmp_path: Path, kind: str, within: float) -> None:
    at, stop = ran(rig_of(tmp_path), 30.0, lambda t: 0.6 if 2.0 < t < 10.0 else 0.0, {ESC: stuck_at_zero(kind)})
    assert 10.0 < at < 10.0 + within
    assert stop is not None
    assert stop.code is StopCode.OUTPUT
    assert "thruster left (node 1 on esc)" in stop.reason
    assert "it ignores commands" in stop.reason
    allowed = rig_of(tmp_path, unwatched=("telemetry",))
    assert ran(allowed, 30.0, lambda t: 0.6 if 2.0 < t < 10.0 else 0.0, {ESC: stuck_at_zero(kind)})[1] is None


@pytest.mark.parametrize("reverse", [1.0, -1.0])
def test_more_duty_than_commanded_ends_the_run(tmp_path: Path, reverse: float) -> None:
    def device(t: float, n: float) -> Esc:
        return Esc(1, 900.0 * n + math.sin(t), 5.0, n if t < 5.0 else 3.0 * n, 24.0, 30.0)

    at, stop = ran(rig_of(tmp_path), 20.0, lambda t: 0.2 * reverse, {ESC: device})
    assert 5.0 + DUTY_LASTS_S < at < 5.0 + DUTY_LASTS_S + 0.3
    assert stop is not None
    assert f"puts out duty {0.6 * reverse:+.2f}, commanded {0.2 * reverse:+.2f}" in stop.reason


@pytest.mark.parametrize("duty", [0.0, NAN])
@pytest.mark.parametrize("n", [0.5, -0.5])
def test_a_controller_that_does_not_move_ends_the_run(tmp_path: Path, duty: float, n: float) -> None:
    def blocked(t: float, n: float) -> Esc:
        return Esc(1, 0.0, 0.1, duty, 24.0 + 0.01 * math.sin(t), 30.0)

    at, stop = ran(rig_of(tmp_path), 20.0, lambda t: n if t > 5.0 else 0.0, {ESC: blocked})
    assert 5.0 + COAST_S < at < 5.0 + COAST_S + 0.4
    assert stop is not None
    assert f"does not turn, commanded {n:+.2f} for 3 s" in stop.reason
    # Without a speed sensor the current shows that the motor turns.
    drawing = Esc(1, 0.0, 5.0, NAN, 24.0, 30.0)
    follows = ran(rig_of(tmp_path), 20.0, steps, {ESC: lambda t, n: replace(drawing, current=0.1 + abs(n) * 9.0 + t)})
    assert follows == (math.inf, None)


def test_telemetry_that_repeats_while_the_command_changes_ends_the_run(tmp_path: Path) -> None:
    frozen = Esc(1, 900.0, 5.0, NAN, 24.0, 30.0)
    at, stop = ran(rig_of(tmp_path), 30.0, lambda t: 0.2 if t < 9.0 else 0.6, {ESC: lambda t, n: frozen})
    assert 9.0 + FROZEN_S <= at < 9.0 + FROZEN_S + 0.3
    assert stop is not None
    assert "repeats the same telemetry" in stop.reason
    constant = ran(rig_of(tmp_path), 60.0, lambda t: 0.2, {ESC: lambda t, n: frozen})
    assert constant == (math.inf, None)  # nothing had to change


def shaken(t: float, n: float) -> Esc:
    """Return the telemetry of a controller that follows, with noise."""
    return Esc(1, 4500.0 * n + math.sin(9.0 * t), 20.0 * abs(n), n, 24.0, 30.0)


def test_a_force_that_repeats_while_the_command_changes_is_not_watched(tmp_path: Path) -> None:
    """A scale in decimal kilograms that froze at 8.5 N."""
    devices: dict[tuple[str, int | None], Device] = {ESC: shaken, CELL: lambda t, n: LoadCell(0.867, 8.5)}
    at, stop = ran(rig_of(tmp_path, force_n=60.0), 60.0, lambda t: 0.8 if t > 5.0 else 0.0, devices)
    assert 5.0 + FROZEN_S <= at < 5.0 + FROZEN_S + 0.4
    assert stop is not None
    assert stop.code is StopCode.UNWATCHED
    assert "limits.force_n is not watched any more: no force of loadcell" in stop.reason
    assert "loadcell repeats the same value" in stop.reason
    devices[CELL] = lambda t, n: LoadCell(0.867, round(40.0 * n * abs(n) + 0.4 * math.sin(t)))  # whole newtons
    assert ran(rig_of(tmp_path, force_n=60.0), 60.0, steps, devices) == (math.inf, None)


def test_a_current_that_is_always_zero_is_not_watched(tmp_path: Path) -> None:
    unmeasured: dict[tuple[str, int | None], Device] = {ESC: lambda t, n: replace(shaken(t, n), current=0.0)}
    _, stop = ran(rig_of(tmp_path, current_a=40.0), 30.0, steps, unmeasured)
    assert stop is not None
    assert "limits.current_a is not watched any more: no current of thruster left" in stop.reason
    assert ran(rig_of(tmp_path), 30.0, steps, unmeasured) == (math.inf, None)  # without the limit it is not needed


@pytest.mark.parametrize(
    ("n", "speed", "within"),
    [(0.8, 0.0, AT_REST_S + 0.5), (0.2, 0.0, 15.6), (0.1, 1.5, 3.7)],
    ids=["fast", "slow", "by its own speed"],
)
def test_a_position_that_stays_although_the_boat_is_driven_is_not_watched(
    tmp_path: Path, n: float, speed: float, within: float
) -> None:
    held = Gnss(T, 41.18, -8.70, vel_n=speed, vel_e=0.0, fix=3)
    devices: dict[tuple[str, int | None], Device] = {ESC: shaken, FIX: lambda t, _: replace(held, utc=T + t)}
    at, stop = ran(rig_of(tmp_path, radius_m=500.0), 60.0, lambda t: n, devices)
    assert at < within
    assert stop is not None
    assert "no position: gnss repeats the same value" in stop.reason
    assert "though the boat was driven" in stop.reason


def test_a_position_in_thousandths_of_a_minute_is_watched(tmp_path: Path) -> None:
    def coarse(t: float, n: float) -> Gnss:
        return Gnss(T + t, round(41.18 * 60 + METRE * 60 * 0.5 * t, 3) / 60, -8.70, vel_n=0.5, vel_e=0.0, fix=3)

    devices: dict[tuple[str, int | None], Device] = {ESC: shaken, FIX: coarse}
    assert ran(rig_of(tmp_path, radius_m=500.0), 120.0, lambda t: 0.3, devices) == (math.inf, None)


def test_a_boat_that_turns_on_the_spot_or_rests_may_hold_its_position(tmp_path: Path) -> None:
    held: dict[tuple[str, int | None], Device] = {ESC: shaken, FIX: lambda t, n: Gnss(T + t, 41.18, -8.7, fix=3)}
    assert ran(rig_of(tmp_path, radius_m=500.0), 60.0, lambda t: 0.0, held) == (math.inf, None)
    rig = mav_rig()
    guard = SafetyGuard(replace(rig, limits=Limits(radius_m=100.0)), 1.0, ("left", "right"))
    for k in range(1, 900):
        t = 0.05 * k
        n = {"left": 0.6, "right": -0.6}
        found = {("autopilot/gnss", None): Latest(Gnss(T, 41.18, -8.7, fix=3), T + t)}
        assert not guard.unwatched(Status(T + t, {}, found, n, 0, "", k, 1, t, "", ()))


def test_impossible_temperatures_do_not_count_as_measurements(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, temperature_c=80.0)
    guard = SafetyGuard(rig, 1.0, ("left",))
    for k, (celsius, watched) in enumerate([(-273.15, False), (-40.0, False), (-39.0, True), (25.0, True)]):
        now = status(10.0 * (k + 1), 0.0, {ESC: Esc(1, 0.0, temperature=celsius)})
        assert (guard.unwatched(now) == []) is watched


# The fence.


def fixes(rig: Rig, north: list[float], dt: float = 0.2, speed: float = 0.5) -> tuple[int, Stop | None]:
    """Return the index of the fix [m north of the start] at which the guard stops, and the stop."""
    guard = SafetyGuard(rig, 1.0, ("left",))
    for k, metres in enumerate(north):
        for look in range(4):  # each fix is seen in several statuses
            t = 1.0 + k * dt
            fix = Gnss(T + t, 41.18 + METRE * metres, -8.70, vel_n=0.0, vel_e=speed, fix=3)
            now = status(t + 0.05 * look, 0.2, {ESC: shaken(t, 0.2)})
            found = {**now.latest, FIX: Latest(fix, T + t)}
            if stop := guard.step(now.t, replace(now, latest=found)).stop:
                return k, stop
    return len(north), None


def test_a_jump_of_the_position_violates_the_fence_only_if_a_second_fix_confirms_the_jump(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, radius_m=100.0)
    assert fixes(rig, [0.0, 0.1, 0.2, 1000.0, 0.3, 0.4]) == (6, None)
    assert fixes(rig, [0.0, 0.1, 1000.0, 0.3, 1000.0, 0.4, -1000.0, 0.5]) == (8, None)
    at, stop = fixes(rig, [0.0, 0.1, 0.2, 1000.0, 1000.1])
    assert at == 4
    assert stop is not None
    assert stop.code is StopCode.FENCE
    at, stop = fixes(rig, [0.0, 0.1, 0.2, 1000.0, -1000.0])  # two that no boat can reach: the receiver is lost
    assert at == 4
    assert stop is not None


def test_a_boat_that_leaves_is_stopped_at_the_first_fix_outside(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, radius_m=100.0)
    at, stop = fixes(rig, [2.0 * k for k in range(80)], speed=0.0)
    assert at == 51  # 102 m: the first fix beyond
    assert stop is not None


def test_a_start_at_a_jump_does_not_move_the_fence_unnoticed(tmp_path: Path) -> None:
    at, stop = fixes(rig_of(tmp_path, radius_m=100.0), [1000.0, 0.0, 0.1, 0.2])
    assert at == 2
    assert stop is not None


def test_a_single_impossible_speed_does_not_stop_the_run(tmp_path: Path) -> None:
    guard = SafetyGuard(replace(rig_of(tmp_path, radius_m=100.0), vehicle={"m_u": 40.0, "d_u": 5.0}), 1.0, ("left",))
    for k, speed in enumerate([0.5, 0.5, 80.0, 0.5, JUMP_SPEED + 1.0, JUMP_SPEED + 1.0]):
        fix = Gnss(T + k, 41.18 + METRE * (10.0 + 0.5 * k), -8.7, vel_n=speed, vel_e=0.0, fix=3)
        now = status(1.0 + k, 0.2, {ESC: shaken(k, 0.2), FIX: fix})
        stop = guard.step(now.t, now).stop
        assert (stop is not None) == (k == 5), stop


@pytest.mark.parametrize(("lat", "lon"), [(0.0, 0.0), (60.0, 10.0), (-60.0, 179.9999), (41.0, -180.0)])
@pytest.mark.parametrize("bearing", [0.0, 90.0, 180.0, 270.0, 45.0])
def test_the_fence_is_a_circle_in_metres_at_every_latitude(
    tmp_path: Path, lat: float, lon: float, bearing: float
) -> None:
    """A boat on a great circle away from the start is stopped between 99 and 101 m."""
    guard = SafetyGuard(rig_of(tmp_path, radius_m=100.0), 1.0, ("left",))
    heading = math.radians(bearing)
    for k in range(300):
        metres = 0.5 * k
        north, east = metres * math.cos(heading), metres * math.sin(heading)
        there = lon + METRE * east / math.cos(math.radians(lat))
        fix = Gnss(T, lat + METRE * north, (there + 180.0) % 360.0 - 180.0, fix=3)
        now = status(0.1 * k + 1.0, 0.2, {ESC: shaken(k, 0.2), FIX: fix})
        if guard.step(now.t, now).stop:
            assert 100.0 <= metres < 101.0
            return
    raise AssertionError("the boat has left the fence")


@pytest.mark.parametrize(("vel_n", "vel_e", "stops"), [(0.0, 2.0, True), (0.0, -2.0, False), (2.0, 0.0, False)])
def test_only_the_speed_outward_counts(tmp_path: Path, vel_n: float, vel_e: float, stops: bool) -> None:
    """The boat is 98 m east of the start and needs 3 m to stop from 2 m/s."""
    rig = replace(rig_of(tmp_path, radius_m=100.0), vehicle={"m_u": 15.0, "d_u": 10.0})
    guard = SafetyGuard(rig, 1.0, ("left",))
    east = 98.0 * METRE / math.cos(math.radians(41.18))
    first = status(1.0, 0.0, {ESC: shaken(0, 0.0), FIX: Gnss(T, 41.18, -8.70, fix=3)})
    assert guard.step(first.t, first).stop is None
    there = Gnss(T, 41.18, -8.70 + east, vel_n=vel_n, vel_e=vel_e, fix=3)
    now = status(20.0, 0.0, {ESC: shaken(0, 0.0), FIX: there})
    assert (guard.step(now.t, now).stop is not None) == stops


@pytest.mark.parametrize(("fix", "watched"), [(0, False), (1, False), (2, True), (3, True), (6, True)])
def test_a_fix_of_two_dimensions_watches_the_fence_and_dead_reckoning_does_not(
    tmp_path: Path, fix: int, watched: bool
) -> None:
    guard = SafetyGuard(rig_of(tmp_path, radius_m=100.0), 1.0, ("left",))
    now = status(1.0, 0.0, {FIX: Gnss(T, 41.18, -8.7, fix=fix)})
    assert (guard.unwatched(now) == []) is watched
    guard.check(status(1.1, 0.0, {ESC: Esc(1), FIX: Gnss(T, 41.18, -8.7, fix=3)}))
    assert guard._fence is not None
    assert bool(guard._fence.reason("gnss", Gnss(T, 41.18 + 500 * METRE, -8.7, fix=fix), T + 99.0)) is watched


# Rates and patience.


@pytest.mark.parametrize(
    ("rate_hz", "measured", "fits"),
    [(0.05, 50.0, False), (50.0, 50.0, True), (50.0, 17.0, True), (50.0, 16.0, False), (20.0, 61.0, False)],
)
def test_a_rate_far_from_the_measured_one_is_refused(
    tmp_path: Path, rate_hz: float, measured: float, fits: bool
) -> None:
    rig = rig_of(tmp_path)
    rig = replace(rig, devices=tuple(replace(device, rate_hz=rate_hz) for device in rig.devices[:1]))
    guard = SafetyGuard(replace(rig, thrusters=()), 1.0, ())
    found = guard.rate_conflicts(status(1.0, 0.0, {}, ports={"esc": port("esc", measured)}))
    assert (found == []) is fits
    if found:
        assert f"sends {measured:g} samples/s, and the rig says rate_hz = {rate_hz:g}" in found[0]
    assert guard.rate_conflicts(status(1.0, 0.0, {}, ports={"esc": port("esc", NAN)})) == []
    assert guard.rate_conflicts(status(1.0, 0.0, {}, ports={})) == []


def test_patience_is_limited_for_a_rig_with_very_low_rates(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, radius_m=100.0, force_n=60.0)
    slow = tuple(replace(device, rate_hz=0.05) for device in rig.devices)
    guard = SafetyGuard(replace(rig, devices=slow), 1.0, ("left",))
    assert {guard.patience(device.name) for device in slow} == {5.0}
    latest: dict[tuple[str, int | None], Sample] = {CELL: LoadCell(1.0, 1.0), FIX: Gnss(T, 41.0, -8.0, fix=3)}
    assert guard.unwatched(status(1.0, 0.0, latest)) == []
    still = status(1.0 + LIMIT_MAX_S - 0.1, 0.0, {})
    assert guard.unwatched(still) == []
    assert {limit.key for limit in guard.unwatched(status(1.0 + LIMIT_MAX_S + 0.1, 0.0, {}))} == {"radius_m", "force_n"}


def test_a_port_that_hangs_up_ends_the_run_at_once(tmp_path: Path) -> None:
    guard = SafetyGuard(rig_of(tmp_path), 1.0, ("left",))
    good = status(1.0, 0.2, {ESC: shaken(1.0, 0.2)})
    assert guard.step(good.t, good).stop is None
    never = {**good.ports, "ahrs": replace(port("ahrs"), open=False, samples=0)}
    assert guard.step(good.t, replace(good, ports=never)).stop is None  # it has not begun yet
    lost = {**good.ports, "ahrs": replace(port("ahrs"), open=False, message="disconnected")}
    stop = guard.step(good.t, replace(good, ports=lost)).stop
    assert stop is not None
    assert stop.code is StopCode.PORT_LOST
    assert "was lost: disconnected; check its plug" in stop.reason


# What is at zero at the end.


def at_the_end(tmp_path: Path, before: list[Sample], zeroed: float | None = 9.0) -> tuple[bool | None, str]:
    guard = SafetyGuard(rig_of(tmp_path), 1.0, ("left",))
    guard.start()
    now = status(0.0, 0.0, {})
    for k, sample in enumerate(before):
        now = status(10.0 + 0.1 * k, 0.0, {ESC: sample}, zeroed={} if zeroed is None else {"esc": T + zeroed})
        found = guard.rest(now)
    assert [rest.thruster for rest in found] == ["left"]
    return found[0].is_zero, found[0].text


@pytest.mark.parametrize(
    ("samples", "is_zero"),
    [
        ([Esc(1, 12.0)], True),
        ([Esc(1, -12.0, duty=0.0)], True),
        ([Esc(1, duty=0.02)], True),
        ([Esc(1, duty=-0.3)], False),
        ([Esc(1, 12.0, duty=0.3)], False),
        ([Esc(1, 2700.0)] * 5, False),
        ([Esc(1, -2700.0)] * 5, False),
        ([Esc(1, 2700.0, duty=0.0)] * 5, False),
        ([Esc(1, 2700.0), Esc(1, 2000.0)], None),
        ([Esc(1, 2700.0, duty=0.0), Esc(1, 2000.0, duty=0.0)], True),
        ([Esc(1, 2700.0, 20.0), Esc(1, 2700.0, 0.2)], True),
        ([Esc(1, 2700.0, 20.0), Esc(1, 2700.0, 2.0)], False),
        ([Esc(1, 2700.0, 0.0)] * 5, False),  # a controller without a current sensor
        ([Esc(1)], None),
    ],
)
def test_zero_thrust_is_concluded_from_measurements_only(
    tmp_path: Path, samples: list[Sample], is_zero: bool | None
) -> None:
    assert at_the_end(tmp_path, samples)[0] is is_zero


def test_only_a_sample_of_after_the_zero_counts(tmp_path: Path) -> None:
    assert at_the_end(tmp_path, [Esc(1, 0.0)], zeroed=10.5) == (None, "left has not reported since")
    assert at_the_end(tmp_path, [Esc(1, 0.0)], zeroed=None) == (None, "left was not reached")


@pytest.mark.parametrize(
    ("servo", "is_zero"),
    [
        (Servo(1, 1500.0, 0.0), True),
        (Servo(1, 1510.0, 0.02), True),
        (Servo(1, 1700.0, 0.4), False),
        (Servo(1, 1300.0, -0.4), False),
        (Servo(1, 0.0), True),
        (Servo(1, 1500.0), None),
    ],
)
def test_an_output_at_neutral_is_zero(servo: Servo, is_zero: bool | None) -> None:
    guard = SafetyGuard(mav_rig(), 1.0, ("left",))
    latest = {("autopilot", 1): Latest(servo, T)}
    now = Status(T, {}, latest, {}, 0, "", 1, 1, 0.0, "", (), zeroed={"autopilot": T - 1.0})
    assert [rest.is_zero for rest in guard.rest(now)] == [is_zero]
    late = replace(now, zeroed={"autopilot": T + 1.0})
    assert [rest.is_zero for rest in guard.rest(late)] == [None]


def test_a_thruster_that_turns_before_anything_was_commanded_is_named(tmp_path: Path) -> None:
    guard = SafetyGuard(rig_of(tmp_path), 1.0, ("left",))
    turning = status(1.0, 0.0, {ESC: Esc(1, 2700.0)})
    assert guard.turning(turning) == ["left turns at 2700 rpm"]
    assert SafetyGuard(rig_of(tmp_path, unwatched=("telemetry",)), 1.0, ("left",)).turning(turning) == []
    assert SafetyGuard(rig_of(tmp_path), 1.0, ("left",)).turning(status(1.0, 0.0, {ESC: Esc(1, 200.0)})) == []


# The machine.


def test_set_points_are_allowed_between_start_and_stop_only(tmp_path: Path) -> None:
    guard = SafetyGuard(rig_of(tmp_path), 1.0, ("left",))
    rows = [(T + 1.0, {"left": 0.3})]
    good = status(1.0, 0.0, {ESC: shaken(1.0, 0.0)})
    assert guard.step(good.t, good, rows) == ((), None)
    assert guard.allow(rows) == ()
    guard.start()
    assert guard.step(good.t, good, rows) == (tuple(rows), None)
    assert guard.allow(rows) == rows
    ended = replace(good, stopped="the watchdog is gone")
    decision = guard.step(good.t, ended, rows)
    assert decision == ((), Stop(StopCode.ACQUISITION, "the watchdog is gone"))
    assert guard.step(good.t, good, rows) == decision  # the first stop stays
    assert guard.allow(rows) == ()
    guard.start()
    assert guard.state is GuardState.STOPPED


@pytest.mark.parametrize(
    "row",
    [(T, {"left": 0.61}), (T, {"left": -0.61}), (T, {"left": NAN}), (NAN, {"left": 0.1}), (T, {"other": 0.1})],
)
def test_a_set_point_that_is_not_allowed_ends_the_run(tmp_path: Path, row: tuple[float, dict[str, float]]) -> None:
    rig = rig_of(tmp_path, n_max=0.6)
    guard = SafetyGuard(rig, 1.0, ("left",))
    guard.start()
    assert guard.allow([(T, {"left": 0.6}), (T, {"left": -0.6})])
    with pytest.raises(SafetyStop, match=r"limits\.n_max of the rig allows only -0\.6 to 0\.6; correct"):
        guard.allow([row])
    assert guard.stop is not None
    assert guard.stop.code is StopCode.SETPOINT
    second_guard = SafetyGuard(rig, 1.0, ("left",))
    second_guard.start()
    good = status(1.0, 0.0, {ESC: shaken(1.0, 0.0)})
    assert second_guard.step(good.t, good, [row]).stop == guard.stop


@pytest.mark.parametrize("speed", [1.0, 20.0])
def test_an_acquisition_that_does_not_answer_ends_the_run(tmp_path: Path, speed: float) -> None:
    guard = SafetyGuard(rig_of(tmp_path), speed, ("left",))
    good = status(1.0, 0.0, {ESC: shaken(1.0, 0.0)})
    assert guard.step(good.t + 0.99 * speed, good).stop is None
    stop = guard.step(good.t + 1.01 * speed, good).stop
    assert stop is not None
    assert "has not answered for 1 s" in stop.reason
    assert SafetyGuard(rig_of(tmp_path), speed, ("left",)).step(NAN, good).stop is not None


numbers = st.one_of(st.floats(-200.0, 200.0), st.just(NAN), st.just(math.inf))
samples = st.one_of(
    st.builds(Esc, st.just(1), st.floats(-6000.0, 6000.0), numbers, st.floats(-1.0, 1.0), numbers, numbers),
    st.builds(LoadCell, numbers, numbers, st.integers(0, 3)),
    st.builds(Gnss, st.just(T), st.floats(41.0, 41.01), st.floats(-8.71, -8.70), fix=st.integers(0, 6)),
)
events = st.fixed_dictionaries(
    {
        "dt": st.floats(0.0, 2.0),
        "n": st.floats(-1.0, 1.0),
        "wanted": st.one_of(st.floats(-2.0, 2.0), st.just(NAN)),
        "samples": st.lists(samples, max_size=3),
        "age": st.floats(0.0, 2.0),
        "open": st.booleans(),
        "stopped": st.sampled_from(["", "", "", "told to end"]),
    }
)
SOURCES = {Esc: ESC, LoadCell: CELL, Gnss: FIX}


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(events, min_size=1, max_size=25), st.integers(0, 5), st.floats(-1e6, 1e6))
def test_no_sequence_of_statuses_moves_a_thruster_beyond_the_limits(
    tmp_path: Path, sequence: list[dict[str, object]], starts: int, shift: float
) -> None:
    """For any statuses, thrust is zero before the start, after a stop and beyond a limit, and never exceeds n_max.

    The same sequence at another time of day gives the same decisions, so the guard reads no clock.
    """
    rig = rig_of(tmp_path, n_max=0.6, force_n=60.0, rpm=4000.0, current_a=40.0, radius_m=200.0, voltage_min_v=10.0)
    guard, again = SafetyGuard(rig, 1.0, ("left",)), SafetyGuard(rig, 1.0, ("left",))
    shift = round(shift * 1024.0) / 1024.0  # exact in a double at the size of T
    latest: dict[tuple[str, int | None], Latest] = {}
    t, first = 0.0, None
    for k, event in enumerate(sequence):
        if k == starts:
            guard.start()
            again.start()
        t = round((t + float(event["dt"])) * 1024.0) / 1024.0  # type: ignore[arg-type]
        for sample in event["samples"]:  # type: ignore[attr-defined]
            latest[SOURCES[type(sample)]] = Latest(sample, T + t)
        now = replace(status(t, float(event["n"]), {}, stopped=event["stopped"]), latest=dict(latest))  # type: ignore[arg-type]
        ports = {
            name: replace(port_status, age=event["age"], open=event["open"]) for name, port_status in now.ports.items()
        }
        now = replace(now, ports=ports, bytes=k)
        rows = [(now.t, {"left": float(event["wanted"])})]  # type: ignore[arg-type]
        decision = guard.step(now.t, now, rows)
        for _, row in decision.setpoints:
            assert starts <= k
            assert abs(row["left"]) <= 0.6
        assert first is None or decision.stop == first
        first = decision.stop
        if first is not None:
            assert decision.setpoints == ()
            assert guard.state is GuardState.STOPPED
        else:
            esc, cell = latest.get(ESC), latest.get(CELL)
            assert not now.stopped
            assert event["open"]
            assert float(event["age"]) <= 1.0  # type: ignore[arg-type]
            if esc is not None and isinstance(esc.sample, Esc):
                assert not abs(esc.sample.rpm) > 4000.0
                assert not abs(esc.sample.current) > 40.0
                assert not esc.sample.voltage < 10.0
            if cell is not None and isinstance(cell.sample, LoadCell) and not cell.sample.flags:
                assert not abs(cell.sample.force) > 60.0
        later = {source: value._replace(t=value.t + shift) for source, value in latest.items()}
        moved = replace(now, t=now.t + shift, latest=later)
        shifted = again.step(moved.t, moved, [(moved.t, rows[0][1])])
        assert (shifted.stop is None) == (decision.stop is None)
        assert len(shifted.setpoints) == len(decision.setpoints)


# What the mutation test asked for: numbers, windows at other speeds, and sources of several thrusters.


def test_the_numbers_equal_the_numbers_of_the_safety_page() -> None:
    """A change of one of these changes what docs/safety.md promises."""
    assert (guard_module.STALE_S, guard_module.STALE_PERIODS, guard_module.STALE_MAX_S) == (1.0, 5.0, 5.0)
    assert (guard_module.STALE_WALL_S, guard_module.STUCK_WALL_S, guard_module.LIMIT_MAX_S) == (1.0, 3.0, 6.0)
    assert (guard_module.QUICK, guard_module.SLOW) == (1.5, 3.0)
    assert (guard_module.RATE_RATIO, guard_module.REST_PART) == (3.0, 0.05)
    assert (guard_module.STOPPED, guard_module.REACTION_S, guard_module.LINK_AGE_S) == (0.05, 0.1, 3.0)
    assert (guard_module.JUMP_SPEED, guard_module.JUMP_M, guard_module.COLDEST_C) == (15.0, 20.0, -40.0)
    assert (guard_module.CHANGE, guard_module.FROZEN_S, guard_module.FROZEN_SAMPLES) == (0.3, 2.0, 5)
    assert (guard_module.IMPULSE_S, guard_module.AT_REST_S, guard_module.TRAVEL_M) == (3.0, 5.0, 5.0)
    assert (guard_module.TOLERANCE, guard_module.WINDOW_S, guard_module.LASTS_S) == (0.05, 0.25, 0.1)
    assert (guard_module.DUTY_TOLERANCE, guard_module.DUTY_WINDOW_S, guard_module.DUTY_LASTS_S) == (0.1, 1.0, 0.3)
    assert (guard_module.FREE_DUTY, guard_module.COAST_S, guard_module.FALLING) == (0.05, 3.0, 0.92)
    assert (guard_module.IDLE_PART, guard_module.IDLE_RPM_MIN, guard_module.IDLE_RPM_MAX) == (0.07, 30.0, 300.0)
    assert (guard_module.IDLE_CURRENT, guard_module.SENSED_A) == (0.05, 1.0)
    assert (guard_module.BLOCKED_N, guard_module.BLOCKED_RPM) == (0.3, 10.0)
    assert pytest.approx(6_371_008.8) == EARTH_RADIUS_M


def test_a_history_holds_values_for_a_limited_time() -> None:
    history = guard_module.History(2.0)
    assert not history.covers(0.0)
    assert history.since(0.0) == []
    for k in range(100):
        history.add(0.1 * k, float(k))
    assert len(history._rows) == 21  # the oldest one holds at the begin of the window
    assert history.covers(7.9)
    assert not history.covers(7.7)
    assert history.since(9.75) == [97.0, 98.0, 99.0]  # the one that held at that time, too
    assert history.since(9.8) == [97.0, 98.0, 99.0]
    assert history.since(100.0) == [99.0]


def watched(values: list[float], commands: list[float], dt: float = 0.5) -> list[bool]:
    watch = guard_module.MovementWatch()
    found = []
    for k, (value, n) in enumerate(zip(values, commands, strict=True)):
        watch.update(k * dt, (value,), {"left": n})
        found.append(watch.is_frozen)
    return found


def test_a_value_is_frozen_from_the_fifth_sample_and_the_second_second_after_a_change() -> None:
    still, step = [8.5] * 12, [0.0, *[0.5] * 11]
    assert watched(still, step).index(True) == 6  # 2.5 s after the change: five samples after the one that showed it
    assert watched(still, step, dt=0.1) == [False] * 12  # too soon
    assert watched(still, [0.0, *[0.29] * 11]) == [False] * 12
    assert watched(still, [0.0, 0.5, *[0.0] * 10]).index(True) == 6  # that the command is as before does not help
    assert watched([8.5, 8.5, 8.5, 8.5, 8.6, *[8.6] * 7], step) == [False] * 12  # it has moved
    moved = watched([8.5, 8.5, 8.5, 8.5, 8.6, *[8.6] * 11], [0.0, *[0.5] * 6, *[0.9] * 9])
    assert moved.index(True) == 12  # from the newer value on
    watch = guard_module.MovementWatch()
    for _ in range(20):
        watch.update(0.0, (8.5,), {"left": 0.0})  # the same sample, seen in many statuses
    for k in range(1, 12):
        watch.update(0.045 * k, (8.5,), {})
        assert not watch.is_frozen
    silent = guard_module.MovementWatch()
    for k in range(20):
        silent.update(float(k), (8.5,), {})  # without a thruster no value has to change
        assert not silent.is_frozen
    watch.update(0.6, (8.5,), {"new": 0.3})  # a thruster that was not commanded before
    for k in range(5):
        watch.update(3.0 + k, (8.5,), {})
    assert watch.is_frozen
    assert watch.unchanged_s == 7.0


def position_watched(commands: dict[str, float], speed: float, dt: float, n: int) -> list[bool]:
    watch = guard_module.MovementWatch()
    watch.is_position = True
    found = []
    for k in range(n):
        watch.update(k * dt, (41.0, -8.0), commands, speed)
        found.append(watch.is_frozen)
    return found


def test_a_position_is_frozen_by_thrust_ahead_or_by_its_own_speed() -> None:
    assert position_watched({"left": 1.0, "right": 1.0}, NAN, 1.0, 20).index(True) == 5
    assert position_watched({"left": -0.5, "right": -0.125}, 0.0, 1.0, 20).index(True) == 10
    assert position_watched({"left": 0.5, "right": -0.5}, -1.0, 1.0, 20) == [False] * 20
    assert position_watched({}, 1.0, 1.0, 20).index(True) == 5
    assert position_watched({}, 2.0, 1.0, 20).index(True) == 5  # and five repeats at least
    assert position_watched({}, 0.4, 1.0, 20).index(True) == 13


@pytest.mark.parametrize("speed", [1.0, 8.0])
def test_the_windows_of_controllers_are_longer_where_time_runs_faster(tmp_path: Path, speed: float) -> None:
    """The way to a controller and back takes wall time."""
    check = guard_module.ControllerCheck(rig_of(tmp_path).thruster("left"), speed)
    window, lasts, coast = 1.0 + 0.25 * speed, 0.3 + 0.1 * speed, 3.0 + 0.25 * speed
    found = math.inf
    for k in range(600):
        t = 0.05 * k
        n = 0.6 if t < 10.0 else 0.0
        now = status(t, n, {ESC: Esc(1, 2700.0 + math.sin(t), 5.0 + 0.1 * math.sin(t), 0.6, 24.0, 30.0)})
        if check.reason(now):
            found = t
            break
    assert found == pytest.approx(10.0 + window + lasts, abs=0.16)
    turning = guard_module.ControllerCheck(rig_of(tmp_path).thruster("left"), speed)
    for k in range(600):
        t = 0.05 * k
        now = status(t, 0.6 if t < 10.0 else 0.0, {ESC: Esc(1, 2700.0 + math.sin(t), 5.0 + 0.1 * math.sin(t))})
        if turning.reason(now):
            found = t
            break
    assert found == pytest.approx(10.0 + coast, abs=0.16)


@pytest.mark.parametrize("speed", [1.0, 8.0])
def test_the_windows_of_outputs_are_longer_where_time_runs_faster(speed: float) -> None:
    thruster = mav_rig().thrusters[0]
    check = guard_module.OutputCheck(thruster, speed)
    found = math.inf
    for k in range(400):
        t = 0.05 * k
        latest = {("autopilot", thruster.node): Latest(Servo(thruster.node, 1700.0, 0.4), T + t)}
        now = Status(T + t, {}, latest, {"left": 0.4 if t < 5.0 else 0.0}, 0, "", 1, 1, t, "", ())
        if check.reason(now):
            found = t
            break
    assert found == pytest.approx(5.0 + 0.25 * speed + 0.1 * speed, abs=0.16)
    assert len(check._commands) < 200 * speed


def two_thrusters(tmp_path: Path, **limits: float | tuple[str, ...]) -> Rig:
    rig = rig_of(tmp_path, **limits)
    right = replace(rig.thrusters[0], name="right", node=2)
    return replace(rig, thrusters=(*rig.thrusters, right))


def test_two_controllers_on_one_bus_share_its_rate(tmp_path: Path) -> None:
    rig = two_thrusters(tmp_path, rpm=4000.0)
    slow = replace(rig, devices=tuple(replace(device, rate_hz=4.0) for device in rig.devices))
    guard = SafetyGuard(slow, 1.0, ("left", "right"))
    both: dict[tuple[str, int | None], Sample] = {ESC: Esc(1, 0.0), ("esc", 2): Esc(2, 0.0)}
    assert guard.unwatched(status(1.0, 0.0, both)) == []
    assert guard.unwatched(status(1.0 + 1.5 * 2.5 - 0.1, 0.0, {})) == []  # five periods of 2 Hz, times QUICK
    late = guard.unwatched(status(1.0 + 1.5 * 2.5 + 0.1, 0.0, {}))
    assert [limit.whom for limit in late] == ["thruster left", "thruster right"]


@pytest.mark.parametrize(
    ("key", "sample", "patience"),
    [
        ("rpm", Esc(1, 0.0), 1.5),
        ("current_a", Esc(1, current=0.0), 1.5),
        ("temperature_c", Esc(1, temperature=20.0), 3.0),
        ("voltage_min_v", Esc(1, voltage=24.0), 3.0),
    ],
)
def test_slow_quantities_may_be_missing_for_longer(tmp_path: Path, key: str, sample: Esc, patience: float) -> None:
    guard = SafetyGuard(rig_of(tmp_path, **{key: 50.0 if key == "temperature_c" else 5.0}), 1.0, ("left",))
    assert guard.unwatched(status(1.0, 0.0, {ESC: sample})) == []
    assert guard.unwatched(status(0.99 + patience - 0.02, 0.0, {})) == []
    assert [limit.key for limit in guard.unwatched(status(0.99 + patience + 0.02, 0.0, {}))] == [key]


def test_a_thruster_before_its_first_command_counts_as_at_zero(tmp_path: Path) -> None:
    guard = SafetyGuard(rig_of(tmp_path, rpm=4000.0), 1.0, ("left",))
    for k in range(1, 200):
        now = replace(status(0.05 * k, 0.0, {ESC: Esc(1, 10.0)}), commanded={})
        assert guard.unwatched(now) == []
        assert guard.step(now.t, now).stop is None


def test_a_shown_value_is_outdated_after_a_time_that_follows_its_own_rate(tmp_path: Path) -> None:
    rig = two_thrusters(tmp_path)
    guard = SafetyGuard(
        replace(rig, devices=tuple(replace(device, rate_hz=4.0) for device in rig.devices)), 1.0, ("left",)
    )
    both: dict[tuple[str, int | None], Sample] = {ESC: Esc(1, 0.0), ("esc", 2): Esc(2, 0.0), CELL: LoadCell(1.0, 1.0)}
    first = status(0.0, 0.0, both)

    def outdated(source: tuple[str, int | None], age: float) -> bool:
        return guard.is_outdated(source, replace(first, t=first.latest[source].t + age))

    assert not outdated(ESC, 1.5 * 2.5 - 0.01)
    assert outdated(ESC, 1.5 * 2.5 + 0.01)
    assert not outdated(CELL, 1.5 * 1.25 - 0.01)
    assert outdated(CELL, 1.5 * 1.25 + 0.01)
    many = replace(first, latest={**first.latest, ("loadcell/battery", None): first.latest[CELL]})
    assert guard.is_outdated(("loadcell/battery", None), replace(many, t=many.t + 3.0 * 1.25 + 0.1))
    assert not guard.is_outdated(("loadcell/battery", None), replace(many, t=many.t + 3.0 * 1.25 - 0.1))


def test_a_device_far_below_its_rate_is_a_conflict_and_a_device_without_a_rate_is_none(tmp_path: Path) -> None:
    guard = SafetyGuard(rig_of(tmp_path), 1.0, ("left",))
    ports = {name: port(name, 40.0) for name in ("esc", "loadcell", "gnss", "ahrs")}
    for rate, conflicts in ((0.01, True), (0.0, False), (NAN, False), (40.0, False)):
        now = status(1.0, 0.0, {}, ports={**ports, "esc": port("esc", rate)})
        assert any(line.startswith("esc ") for line in guard.rate_conflicts(now)) is conflicts


def test_a_message_of_a_controller_names_the_newest_command(tmp_path: Path) -> None:
    check = guard_module.ControllerCheck(rig_of(tmp_path).thruster("left"), 1.0)
    message = ""
    for k in range(200):
        t = 0.05 * k
        message = check.reason(status(t, 0.1 if t < 4.0 else 0.2, {ESC: Esc(1, 3000.0 + math.sin(t), 9.0, 0.9)}))
        if t > 4.2:
            break
    assert "commanded +0.20" in message
    for k in range(40):  # the command changes just before the message
        n = 0.2 if k % 2 else 0.1
        if message := check.reason(status(20.0 + 0.05 * k, n, {ESC: Esc(1, 3000.0 + math.sin(k), 9.0, 0.9)})):
            assert f"commanded {n:+.2f}" in message


def test_message_of_an_unwatched_limit_contains_the_duration_or_the_reason(tmp_path: Path) -> None:
    guard = SafetyGuard(rig_of(tmp_path, rpm=4000.0, force_n=60.0), 1.0, ("left",))
    guard.unwatched(status(1.0, 0.0, {ESC: Esc(1, 0.0), CELL: LoadCell(1.0, 8.5)}))
    message = {limit.key: limit.silence(T + 5.0) for limit in guard.unwatched(status(5.0, 0.0, {}))}
    assert message == {
        "rpm": "no shaft speed of thruster left (node 1 on esc) received for 4.0 s",
        "force_n": "no force of loadcell received for 4.0 s",
    }
    for k in range(10):
        now = status(6.0 + 0.5 * k, 0.0 if k == 0 else 0.5, {ESC: Esc(1, 9.0 * k), CELL: LoadCell(1.0, 8.5)})
        frozen = guard.unwatched(now)
    assert [limit.key for limit in frozen] == ["force_n"]
    assert frozen[0].silence(T + 20.0).endswith("loadcell repeats the same value for 9.5 s though the commands changed")


def test_the_patience_with_a_limit_grows_with_the_speed_of_time(tmp_path: Path) -> None:
    """Against mocks a busy machine pauses for a second of wall time, which is many run seconds."""
    guard = SafetyGuard(rig_of(tmp_path, rpm=4000.0, temperature_c=80.0), 20.0, ("left",))
    guard.unwatched(status(1.0, 0.0, {ESC: Esc(1, 0.0, temperature=20.0)}))
    assert guard.unwatched(status(0.99 + 29.9, 0.0, {})) == []
    assert [limit.key for limit in guard.unwatched(status(0.99 + 30.1, 0.0, {}))] == ["rpm"]
    assert len(guard.unwatched(status(0.99 + 59.9, 0.0, {}))) == 1
    assert len(guard.unwatched(status(0.99 + 60.1, 0.0, {}))) == 2


def test_message_of_a_force_beyond_its_limit_contains_the_force_at_rest(tmp_path: Path) -> None:
    guard = SafetyGuard(rig_of(tmp_path, force_n=60.0), 1.0, ("left",))
    guard.check(status(0.1, 0.0, {ESC: Esc(1), CELL: LoadCell(1.0, 24.4)}))
    with pytest.raises(SafetyStop) as caught:
        guard.check(status(0.2, 0.5, {ESC: Esc(1), CELL: LoadCell(1.0, 60.5)}))
    text = "force is 60.5 N by loadcell, above limits.force_n = 60; 24.4 N of it are there at rest: correct zero_counts"
    assert str(caught.value).startswith(text)


def test_a_blocked_controller_is_named_with_its_newest_command(tmp_path: Path) -> None:
    check = guard_module.ControllerCheck(rig_of(tmp_path).thruster("left"), 1.0)
    message = ""
    for k in range(300):
        n = 0.5 if k % 2 else 0.4
        esc = Esc(1, 0.0, 0.1, NAN, 24.0 + 0.01 * math.sin(k))
        if message := check.reason(status(0.05 * k, n, {ESC: esc})):
            break
    assert f"does not turn, commanded {n:+.2f} for 3 s" in message


def test_a_boat_at_its_start_is_not_stopped_by_its_speed_alone(tmp_path: Path) -> None:
    rig = replace(rig_of(tmp_path, radius_m=5.0), vehicle={"m_u": 100.0, "d_u": 10.0})
    guard = SafetyGuard(rig, 1.0, ("left",))
    assert guard_module.stopping_distance(2.0, {"m_u": 30.0, "d_u": 6.0, "d_uu": 6.0}) > 0.0
    start = Gnss(T, 41.18, -8.7, vel_n=2.0, vel_e=0.0, fix=3)  # outward has no direction at the start itself
    guard.check(status(1.0, 0.0, {ESC: Esc(1), FIX: start}))


def test_a_shaft_speed_that_repeats_while_the_command_changes_is_not_watched(tmp_path: Path) -> None:
    def held(t: float, n: float) -> Esc:
        return Esc(1, 100.0, 9.0 + math.sin(t), NAN, 24.0, 30.0)

    _, stop = ran(rig_of(tmp_path, rpm=4000.0), 30.0, steps, {ESC: held})
    assert stop is not None
    assert stop.code is StopCode.UNWATCHED
    assert "limits.rpm is not watched any more: no shaft speed of thruster left" in stop.reason
    assert ran(rig_of(tmp_path), 30.0, steps, {ESC: held}) == (math.inf, None)


@pytest.mark.parametrize("current", [0.7, -0.7])
def test_a_motor_that_draws_current_is_not_blocked_at_any_measured_speed(tmp_path: Path, current: float) -> None:
    def unsensed(t: float, n: float) -> Esc:
        return Esc(1, 0.0, current + 0.05 * math.sin(t), NAN, 24.0, 30.0)

    assert ran(rig_of(tmp_path), 20.0, lambda t: 0.5, {ESC: unsensed}) == (math.inf, None)


def test_a_motor_with_duty_is_not_blocked_at_any_measured_speed(tmp_path: Path) -> None:
    def unsensed(t: float, n: float) -> Esc:
        return Esc(1, 0.0, 0.1, n, 24.0 + 0.01 * math.sin(t), 30.0)

    assert ran(rig_of(tmp_path), 20.0, lambda t: 0.5, {ESC: unsensed}) == (math.inf, None)


def test_no_rig_allows_more_than_full_thrust(tmp_path: Path) -> None:
    guard = SafetyGuard(rig_of(tmp_path, n_max=3.0), 1.0, ("left",))
    guard.start()
    assert len(guard.allow([(1.0, {"left": 1.0})])) == 1
    with pytest.raises(SafetyStop, match="allows only -1 to 1; correct"):
        guard.allow([(1.0, {"left": 1.01})])


def test_a_silent_controller_among_two_is_silent_after_five_of_its_own_periods(tmp_path: Path) -> None:
    rig = two_thrusters(tmp_path)
    guard = SafetyGuard(
        replace(rig, devices=tuple(replace(device, rate_hz=4.0) for device in rig.devices)), 1.0, ("left",)
    )
    first = status(1.0, 0.0, {ESC: Esc(1, 0.0), ("esc", 2): Esc(2, 0.0)})
    assert guard.step(first.t, first).stop is None
    late = replace(first, t=first.latest[ESC].t + 2.49, bytes=first.bytes + 1)
    assert guard.step(late.t, late).stop is None
    silent = replace(late, t=first.latest[ESC].t + 2.51, bytes=late.bytes + 1)
    stop = guard.step(silent.t, silent).stop
    assert stop is not None
    assert stop.reason.startswith("thruster left (node 1 on esc) is silent for 2.5 s; check")


@pytest.mark.parametrize(("known", "stops"), [({}, True), ({"autopilot": 0}, True), ({"autopilot": 1}, False)])
def test_a_parameter_changed_before_the_start_does_not_stop_the_run(known: dict[str, int], stops: bool) -> None:
    guard = SafetyGuard(replace(mav_rig(), limits=Limits()), 1.0, ("left",))
    guard.start(known)
    link = LinkStatus(received=True, age=0.0, armed=True, mode="MANUAL", changed=("FS_THR_ENABLE is 0, was 1",))
    now = Status(T, {"autopilot": port("autopilot")}, {}, {}, 0, "", 1, 1, 1.0, "", (), links={"autopilot": link})
    codes = [stop.code for stop in guard._link_stops(now)]
    assert codes == ([StopCode.PARAMETER] if stops else [])


def test_linear_and_quadratic_damping_of_the_same_size_both_brake() -> None:
    """The closed form of 10 u' = -2 u - 2 u^2 from 1 m/s to 0.05 m/s."""
    way = guard_module.stopping_distance(1.0, {"m_u": 10.0, "d_u": 2.0, "d_uu": 2.0})
    assert way == pytest.approx(5.0 * math.log(2.0 / 1.05))
    linear = {"m_u": 10.0, "d_u": 0.5}
    assert guard_module.stopping_distance(1.0, linear) == pytest.approx(10.0 * 0.95 / 0.5)
    assert guard_module.stopping_distance(1.0, {**linear, "d_uu": -2.0}) == pytest.approx(10.0 * 0.95 / 0.5)
    quadratic = {"m_u": 10.0, "d_uu": 0.5}
    assert guard_module.stopping_distance(1.0, quadratic) == pytest.approx(20.0 * math.log(20.0))
    assert guard_module.stopping_distance(1.0, {"d_u": 0.5}) == 0.0


@pytest.mark.parametrize(("lat", "lon"), [(NAN, -8.7), (41.18, NAN), (math.inf, -8.7), (41.18, -math.inf)])
def test_a_fix_without_a_position_moves_neither_the_start_nor_the_fence(lat: float, lon: float) -> None:
    fence = guard_module.Fence(100.0, {})
    assert fence.reason("gnss", Gnss(T, lat, lon, fix=3), T) == ""
    assert fence.reason("gnss", Gnss(T, 41.18, -8.7, fix=3), T + 1.0) == ""
    assert fence.reason("gnss", Gnss(T, 41.18 + 99.0 * METRE, -8.7, fix=3), T + 9.0) == ""
    assert fence.reason("gnss", Gnss(T, lat, lon, fix=3), T + 10.0) == ""
    assert "101 m from the start" in fence.reason("gnss", Gnss(T, 41.18 + 101.0 * METRE, -8.7, fix=3), T + 11.0)


def test_a_doubtful_first_fix_does_not_confirm_a_later_jump() -> None:
    """The first fix has an impossible speed, the next ones are good, and then one single position is wrong."""
    fence = guard_module.Fence(100.0, {})
    assert fence.reason("gnss", Gnss(T, 41.18, -8.7, fix=3, speed=40.0), T) == ""
    assert fence.reason("gnss", Gnss(T, 41.18, -8.7, fix=3), T + 1.0) == ""
    far = Gnss(T, 41.18 + 1000.0 * METRE, -8.7, fix=3)
    assert fence.reason("gnss", far, T + 2.0) == ""
    assert "1000 m from the start" in fence.reason("gnss", far, T + 3.0)  # a second one confirms it


def test_a_saturated_reading_now_and_then_does_not_stop(tmp_path: Path) -> None:
    guard = SafetyGuard(rig_of(tmp_path, force_n=60.0), 1.0, ("left",))
    for k in range(1, 60):
        cell = LoadCell(1.0, 1.0 + 0.1 * k, flags=guard_module.SATURATED if k % 3 == 0 else 0)
        guard.check(status(0.1 * k, 0.2, {ESC: shaken(k, 0.2), CELL: cell}))


def test_constant_values_that_do_not_depend_on_thrust_do_not_stop_the_run(tmp_path: Path) -> None:
    rig = rig_of(tmp_path, temperature_c=80.0, voltage_min_v=12.0, roll_deg=45.0, pitch_deg=45.0)
    devices: dict[tuple[str, int | None], Device] = {ESC: shaken, ("ahrs", None): lambda t, n: Ahrs(0.1, 0.0, 0.0)}
    assert ran(rig, 60.0, steps, devices) == (math.inf, None)


def test_each_jump_needs_a_second_fix_of_its_own(tmp_path: Path) -> None:
    """A jump inside the fence that was confirmed does not confirm a later one beyond it."""
    rig = rig_of(tmp_path, radius_m=100.0)
    assert fixes(rig, [0.0, 0.1, 60.0, 60.1, 60.2, 1000.0, 60.3, 60.4]) == (8, None)
    assert fixes(rig, [0.0, 0.1, 60.0, 60.1, 1000.0, 60.2, 60.3]) == (7, None)
    assert fixes(rig, [0.0, 0.1, 60.0, 60.1, 60.2, 1000.0, 1000.1])[0] == 6


@pytest.mark.parametrize(("lat", "lon", "watched"), [(41.0, -8.0, True), (NAN, -8.0, False), (41.0, NAN, False)])
def test_a_fix_without_latitude_or_longitude_watches_no_fence(
    tmp_path: Path, lat: float, lon: float, watched: bool
) -> None:
    guard = SafetyGuard(rig_of(tmp_path, radius_m=100.0), 1.0, ("left",))
    assert (guard.unwatched(status(1.0, 0.0, {FIX: Gnss(T, lat, lon, fix=3)})) == []) is watched


def test_a_thruster_that_turns_before_its_first_command_ends_the_run(tmp_path: Path) -> None:
    guard = SafetyGuard(rig_of(tmp_path), 1.0, ("left",))
    guard.start()
    for k in range(1, 100):
        t = 0.05 * k
        now = replace(status(t, 0.0, {ESC: Esc(1, 900.0 + math.sin(t), 3.0, 0.5)}), commanded={})
        if stop := guard.step(now.t, now).stop:
            assert "puts out duty +0.50, commanded +0.00" in stop.reason
            return
    raise AssertionError("the guard lets it turn")


@pytest.mark.parametrize(
    ("put_out", "commanded", "why"),
    [
        (0.0, 0.4, "it was disarmed or blocks commands"),
        (-0.05, 0.4, "it was disarmed or blocks commands"),
        (0.3, 0.4, "a parameter changes the commands, or its link is late"),
        (-0.3, 0.0, "a parameter changes the commands, or its link is late"),
    ],
)
def test_message_of_a_wrong_output_names_the_possible_cause(put_out: float, commanded: float, why: str) -> None:
    thruster = mav_rig().thrusters[0]
    check = guard_module.OutputCheck(thruster, 1.0)
    message = ""
    for k in range(40):
        t = 0.05 * k
        latest = {("autopilot", thruster.node): Latest(Servo(thruster.node, 1500.0, put_out), T + t)}
        message = check.reason(Status(T + t, {}, latest, {"left": commanded}, 0, "", 1, 1, t, "", ()))
    assert f"commanded {commanded:+.2f}: {why}; " in message


@pytest.mark.parametrize("first", ["gnss", "ahrs"])
@pytest.mark.parametrize("age", [0.0, 0.08])
def test_a_second_receiver_replaces_a_receiver_with_a_frozen_position(tmp_path: Path, first: str, age: float) -> None:
    """The order of the reports does not matter. With two frozen positions, the run stops."""
    for n_frozen in (1, 2):
        guard = SafetyGuard(rig_of(tmp_path, radius_m=100.0), 1.0, ("left",))
        guard.start()
        stop = None
        for k in range(1, 400):
            t = 0.05 * k
            held = Gnss(T + t, 41.18, -8.70, vel_n=0.1, vel_e=0.0, fix=3)
            moves = held if n_frozen == 2 else replace(held, lat=41.18 + 0.1 * t * METRE)
            two = {"gnss": Latest(held, T + t), "ahrs": Latest(moves, T + t - age)}
            found = {(name, None): two[name] for name in sorted(two, key=lambda name: name != first)}
            now = status(t + 0.01, 0.8, {ESC: shaken(t, 0.8)})
            now = replace(now, latest={**found, **now.latest})
            if stop := guard.step(now.t, now).stop:
                break
        assert (stop is not None) == (n_frozen == 2), stop
