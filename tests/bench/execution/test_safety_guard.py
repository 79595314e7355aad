"""Tests of the safety guard with statuses made by hand: no stop within the limits, one reason beyond each limit."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import pytest

from seatrial.bench.execution.runner import newest_values
from seatrial.bench.execution.safety_guard import QUICK, SLOW, STALE_MAX_S, STOPPED, SafetyGuard, stopping_distance
from seatrial.daq.acquisition.status import Latest, PortStatus, Status
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.errors import SafetyStop
from seatrial.daq.rig import Rig
from seatrial.daq.samples import Ahrs, Battery, Esc, Gnss, LoadCell, Sample
from tests.bench.standin import RIG
from tests.daq.mavlink_ends import mav_rig

GNSS = """
[[device]]
name = "gnss"
protocol = "nmea"
port = "ports/gnss"
rate_hz = 5.0
[[device]]
name = "ahrs"
protocol = "vectornav"
port = "ports/ahrs"
rate_hz = 50.0
"""
LIMITS = """
radius_m = 100.0
rpm = 4000.0
roll_deg = 30.0
pitch_deg = 20.0
battery_min = 0.2
[vehicle]
m_u = 37.0
d_u = 0.2
d_uu = 25.0
"""
T = 1_763_616_000.0
GOOD: dict[tuple[str, int | None], Sample] = {
    ("esc", 1): Esc(1, 900.0, 5.0, 0.2, 24.0, 30.0),
    ("loadcell", None): LoadCell(85000.0, 0.8),
    ("gnss", None): Gnss(T, 41.18, -8.70, fix=3),
    ("ahrs", None): Ahrs(1.0, 0.1, -0.1),
    ("ahrs/battery", None): Battery(15.0, 3.0, 0.8),
}


@pytest.fixture
def rig(tmp_path: Path) -> Rig:
    text = RIG.format(speed=1.0).replace("[[thruster]]", GNSS + "[[thruster]]") + LIMITS
    return parse_rig(text, tmp_path / "rig.toml")


def port(name: str, age: float = 0.01) -> PortStatus:
    return PortStatus(name, "", f"ports/{name}", 1.0, 1.0, age, 9, 9, 0, 0, 0, 0, 99, 0.0, 0.0, "")


def status(t: float, size: int = 1000, **samples: Sample) -> Status:
    latest = {source: Latest(samples.get(source[0], sample), T + t - 0.01) for source, sample in GOOD.items()}
    ports = {name: port(name) for name in ("esc", "loadcell", "gnss", "ahrs")}
    return Status(T + t, ports, latest, {"left": 0.2}, 3, "run.mcap", size, 10, t, "", ())


def reason(guard: SafetyGuard, now: Status) -> str:
    with pytest.raises(SafetyStop) as caught:
        guard.check(now)
    assert caught.value.exit_status == 3
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.fixture
def guard(rig: Rig) -> SafetyGuard:
    guard = SafetyGuard(rig, 1.0, ("left",))
    guard.check(status(0.0))
    return guard


def test_the_guard_does_not_stop_within_the_limits(guard: SafetyGuard) -> None:
    for k in range(1, 200):
        guard.check(status(0.05 * k, 1000 + k))


NAN = float("nan")
AWAY = "the boat is 101 m from the start by gnss, beyond limits.radius_m = 100; bring it back"
COASTING = (
    "the boat is 96 m from the start by gnss and needs 4 m to stop from 1.0 m/s, in all beyond limits.radius_m = 100"
)


@pytest.mark.parametrize(
    ("name", "sample", "words"),
    [
        ("esc", Esc(1, 900.0, 40.5), "current of node 1 on esc is 40.5 A, above limits.current_a = 40; check"),
        ("esc", Esc(1, 900.0, -40.5), "current of node 1 on esc is -40.5 A, above limits.current_a = 40; check"),
        (
            "esc",
            Esc(1, 900.0, 5.0, temperature=81.0),
            "temperature of node 1 on esc is 81 deg C, above limits.temperature_c = 80; let it cool",
        ),
        (
            "esc",
            Esc(1, 900.0, 5.0, voltage=9.9),
            "voltage of node 1 on esc is 9.9 V, below limits.voltage_min_v = 10; charge",
        ),
        ("loadcell", LoadCell(0.0, 60.1), "force is 60.1 N by loadcell, above limits.force_n = 60; lower"),
        ("loadcell", LoadCell(0.0, -60.1), "force is -60.1 N by loadcell, above limits.force_n = 60; lower"),
        ("gnss", Gnss(T, 41.18 + 101 / 111_195, -8.70, fix=3), AWAY),
        ("gnss", Gnss(T, 41.18, -8.70 + 101 / 83_690, fix=3), AWAY),
        (
            "gnss",
            Gnss(T, 41.18 + 96 / 111_195, -8.70, vel_n=1.0, vel_e=0.5, fix=3),
            COASTING,
        ),
        (
            "gnss",
            Gnss(T, 41.18 + 96 / 111_195, -8.70, speed=1.0, fix=3),  # without a course over ground
            COASTING,
        ),
        ("esc", Esc(1, -4001.0), "speed of node 1 on esc is -4001 rpm, above limits.rpm = 4000; lower"),
        ("ahrs", Ahrs(0.0, 0.0, math.radians(-31.0)), "roll is -31 deg by ahrs, above limits.roll_deg = 30; level"),
        ("ahrs", Ahrs(0.0, math.radians(21.0), 0.0), "pitch is 21 deg by ahrs, above limits.pitch_deg = 20; level"),
        ("ahrs/battery", Battery(9.9), "battery of ahrs is at 9.9 V, below limits.voltage_min_v = 10; charge it"),
        (
            "ahrs/battery",
            Battery(12.0, 1.0, 0.19),
            "battery of ahrs has 19 % left, below limits.battery_min = 0.2; charge it",
        ),
    ],
)
def test_each_limit_stops_with_its_reason(guard: SafetyGuard, name: str, sample: Sample, words: str) -> None:
    if name == "gnss":
        guard.check(status(0.1, 1001, **{name: sample}))  # a jump: a single fix may be wrong
    assert reason(guard, status(0.2, 1002, **{name: sample})).startswith(words)


@pytest.mark.parametrize(
    ("name", "sample"),
    [
        ("esc", Esc(1, 900.0, 39.9, 0.2, 10.1, 79.9)),
        ("esc", Esc(1)),  # the sample reports only that the source exists
        ("loadcell", LoadCell(9e6, 9000.0, 2)),  # a spike that the decoder has flagged
        ("loadcell", LoadCell(8388607, 8300.0, 1)),  # saturated once
        ("gnss", Gnss(T, 41.18 + 99 / 111_195, -8.70, fix=3)),
        ("gnss", Gnss(T, NAN, NAN, fix=0)),
        ("gnss", Gnss(T, 10.0, 10.0, fix=0)),
        ("gnss", Gnss(T, 41.18 + 96 / 111_195, -8.70, vel_n=-1.0, vel_e=0.0, fix=3)),  # already on the way back
        ("ahrs", Ahrs(NAN, NAN, NAN, r=1.0)),
        ("ahrs/battery", Battery()),
    ],
)
def test_harmless_samples_do_not_stop_the_run(guard: SafetyGuard, name: str, sample: Sample) -> None:
    guard.check(status(0.1, **{name: sample}))


def test_a_load_cell_that_stays_saturated_stops_the_run(guard: SafetyGuard) -> None:
    saturated = LoadCell(8388607, 8300.0, 1)
    guard.check(status(0.1, 1001, loadcell=saturated))
    assert "saturated" in reason(guard, status(0.2, 1002, loadcell=saturated))


def test_a_saturated_load_cell_stops_the_run_if_a_second_cell_is_fine(rig: Rig) -> None:
    guard = SafetyGuard(rig, 1.0, ("left",))
    guard.check(status(0.0))

    def two(t: float) -> Status:
        now = status(t, loadcell=LoadCell(8388607, 8300.0, 1))
        return replace(now, latest=now.latest | {("other", None): Latest(GOOD["loadcell", None], now.t)})

    guard.check(two(0.05))
    assert reason(guard, two(0.1)).startswith("load cell loadcell is saturated, so its force cannot be compared")


@pytest.mark.parametrize(
    ("name", "kind", "words"),
    [("ahrs", "Ahrs", "no roll"), ("gnss", "Gnss", "no position"), ("loadcell", "LoadCell", "no force")],
)
def test_a_dead_sensor_does_not_count_as_a_source(guard: SafetyGuard, name: str, kind: str, words: str) -> None:
    def dead(t: float) -> Status:
        now = status(t, 1000 + round(100 * t))
        return replace(now, ports=now.ports | {name: replace(port(name), stuck=(kind,))})

    for k in range(1, 20):
        guard.check(dead(0.05 * k))
    assert f"is not watched any more: {words}" in reason(guard, dead(5.0))


def test_a_coarse_load_cell_may_repeat_itself_at_rest(guard: SafetyGuard) -> None:
    for k in range(1, 200):
        now = status(0.05 * k, 1000 + k)
        stuck = replace(port("loadcell"), stuck=("LoadCell",))
        guard.check(replace(now, ports=now.ports | {"loadcell": stuck}, commanded={"left": 0.0}))


def test_the_same_saturated_reading_seen_twice_does_not_stop(guard: SafetyGuard) -> None:
    once = status(0.1, 1001, loadcell=LoadCell(8388607, 8300.0, 1))
    guard.check(once)
    guard.check(replace(once, t=once.t + 0.02))


@pytest.mark.parametrize(("speed", "patience"), [(1.0, 1.0), (20.0, 20.0)])
@pytest.mark.parametrize("name", ["esc", "loadcell", "gnss"])
def test_a_silent_device_stops(rig: Rig, name: str, speed: float, patience: float) -> None:
    guard = SafetyGuard(rig, speed, ("left",))
    now = status(0.0)
    guard.check(replace(now, ports={**now.ports, name: port(name, patience - 0.01)}))
    late = replace(now, ports={**now.ports, name: port(name, patience + 0.01)})
    assert reason(guard, late).startswith(f"{name} (")


def test_a_slow_device_may_be_silent_for_five_periods_up_to_a_maximum(rig: Rig) -> None:
    slow = replace(rig.device("gnss"), rate_hz=0.5)
    others = tuple(device for device in rig.devices if device.name != "gnss")
    guard = SafetyGuard(replace(rig, devices=(*others, slow)), 1.0, ("left",))
    now = status(0.0)
    guard.check(replace(now, ports={**now.ports, "gnss": port("gnss", STALE_MAX_S - 0.1)}))
    assert "for 5.1 s" in reason(guard, replace(now, ports={**now.ports, "gnss": port("gnss", STALE_MAX_S + 0.1)}))


@pytest.mark.parametrize("age", [float("inf"), NAN])
def test_an_age_of_nan_counts_as_silence(guard: SafetyGuard, age: float) -> None:
    now = status(0.1)
    assert reason(guard, replace(now, ports={**now.ports, "esc": port("esc", age)})).startswith("esc (")


def test_a_silent_controller_on_a_busy_bus_stops(guard: SafetyGuard) -> None:
    now = status(0.1)
    latest = {**now.latest, ("esc", 1): Latest(GOOD["esc", 1], now.t - 1.1)}
    message = reason(guard, replace(now, latest=latest))
    assert message.startswith("thruster left (node 1 on esc) is silent for 1.1 s; check")


def test_a_log_that_does_not_grow_stops(guard: SafetyGuard) -> None:
    guard.check(status(2.9))
    assert "does not grow" in reason(guard, status(3.1))


def test_the_stopping_distance_follows_from_the_drag_of_the_boat() -> None:
    """The numerical integration of the equation of drag is the reference."""
    vehicle = {"m_u": 37.0, "d_u": 2.0, "d_uu": 25.0}
    u, x, dt = 1.4, 0.0, 1e-4
    while u > STOPPED:
        u, x = u - dt * (2.0 * u + 25.0 * u * u) / 37.0, x + dt * u
    assert stopping_distance(1.4, vehicle) == pytest.approx(x, rel=1e-3)
    assert stopping_distance(1.4, {}) == 0.0
    assert stopping_distance(1.0, {"m_u": 10.0, "d_u": 5.0}) == pytest.approx(10.0 / 5.0 * 0.95)


def test_a_rig_without_limits_still_has_the_two_built_in_limits(rig: Rig) -> None:
    bare = replace(rig, limits=replace(rig.limits, force_n=None, current_a=None, temperature_c=None, radius_m=None))
    guard = SafetyGuard(bare, 1.0, ("left",))
    guard.check(status(0.0, loadcell=LoadCell(0.0, 1e6), esc=Esc(1, 0.0, 1e6, temperature=1e6)))
    guard.check(status(0.1, 1001, gnss=Gnss(T, 10.0, 10.0, fix=3)))
    assert "does not grow" in reason(guard, status(3.2, 1001))


SILENT: list[tuple[str, Sample, str, float]] = [  # a source, a sample without the quantity, the limit, the patience
    ("esc", Esc(1, NAN, 5.0, 0.2, 24.0, 30.0), "rpm", QUICK),
    ("esc", Esc(1, 900.0, NAN, 0.2, 24.0, 30.0), "current_a", QUICK),
    ("esc", Esc(1, 900.0, 5.0, 0.2, 24.0, NAN), "temperature_c", SLOW),
    ("loadcell", LoadCell(85000.0), "force_n", QUICK),
    ("loadcell", LoadCell(85000.0, 0.8, 2), "force_n", QUICK),
    ("gnss", Gnss(T, NAN, NAN, fix=0), "radius_m", SLOW),
    ("gnss", Gnss(T, 41.18, -8.70, fix=1), "radius_m", SLOW),
    ("ahrs", Ahrs(1.0, 0.1, NAN), "roll_deg", QUICK),
    ("ahrs", Ahrs(1.0, NAN, -0.1), "pitch_deg", QUICK),
    ("ahrs/battery", Battery(15.0, 3.0, NAN), "battery_min", SLOW),
]


@pytest.mark.parametrize(("name", "sample", "limit", "patience"), SILENT)
def test_a_limit_without_measurements_stops_the_run(
    guard: SafetyGuard, name: str, sample: Sample, limit: str, patience: float
) -> None:
    guard.check(status(patience - 0.05, 1001, **{name: sample}))
    message = reason(guard, status(patience + 0.05, 1002, **{name: sample}))
    assert message.startswith(f"limits.{limit} is not watched any more")


@pytest.mark.parametrize(("name", "sample", "limit", "patience"), SILENT)
def test_a_limit_without_a_source_is_named_before_anything_moves(
    rig: Rig, name: str, sample: Sample, limit: str, patience: float
) -> None:
    (missing,) = SafetyGuard(rig, 1.0, ("left",)).unwatched(status(0.0, **{name: sample}))
    assert missing.key == limit
    message = missing.refusal(T)
    assert f"limits.{limit} = " in message
    assert f'unwatched = ["{limit}"]' in message
    assert "since the start" in message
    free = replace(rig, limits=replace(rig.limits, unwatched=(limit,)))
    assert not SafetyGuard(free, 1.0, ("left",)).unwatched(status(0.0, **{name: sample}))


def test_a_voltage_is_watched_by_the_controller_or_by_the_battery(rig: Rig) -> None:
    guard = SafetyGuard(rig, 1.0, ("left",))
    mute, flat = Esc(1, 900.0, 5.0, 0.2, NAN, 30.0), Battery(NAN, 3.0, 0.8)
    assert not guard.unwatched(status(0.0, esc=mute))
    (missing,) = SafetyGuard(rig, 1.0, ("left",)).unwatched(status(0.0, esc=mute, **{"ahrs/battery": flat}))
    assert missing.key == "voltage_min_v"


def test_a_limit_that_may_be_unwatched_still_stops(rig: Rig) -> None:
    guard = SafetyGuard(replace(rig, limits=replace(rig.limits, unwatched=("temperature_c",))), 1.0, ("left",))
    guard.check(status(0.0, esc=Esc(1, 900.0, 5.0, 0.2, 24.0)))
    guard.check(status(2.9, 1001, esc=Esc(1, 900.0, 5.0, 0.2, 24.0)))
    assert "temperature" in reason(guard, status(3.0, 1002, esc=Esc(1, 900.0, 5.0, 0.2, 24.0, 81.0)))


def test_each_thruster_and_each_cell_needs_its_own_source(rig: Rig) -> None:
    second, right = replace(rig.device("loadcell"), name="other"), replace(rig.thrusters[0], name="right", node=2)
    both = replace(rig, devices=(*rig.devices, second), thrusters=(*rig.thrusters, right))
    missing = SafetyGuard(both, 1.0, ("left", "right")).unwatched(status(0.0))
    assert [(row.key, row.whom) for row in missing] == [
        ("force_n", "other"), ("rpm", "thruster right"), ("current_a", "thruster right"),
        ("temperature_c", "thruster right"),
    ]  # fmt: skip


def test_an_outdated_value_is_not_a_current_value() -> None:
    guard, now = SafetyGuard(mav_rig(), 1.0, ("left",)), status(200.0)

    def with_ages(speed: float, rpm: float) -> Status:
        fix = Latest(Gnss(T, 41.0, -8.0, fix=3, speed=1.37), now.t - speed)
        esc = Latest(Esc(1, 1500.0), now.t - rpm)
        return replace(now, latest={("autopilot/gnss", None): fix, ("autopilot/esc", 1): esc})

    assert newest_values(with_ages(0.2, 0.1), guard) == (None, 1.37, {("autopilot", 1): 1500.0})
    force, speed, rpm = newest_values(with_ages(120.0, 60.0), guard)
    assert force is None
    assert speed is not None
    assert math.isnan(speed)
    assert math.isnan(rpm["autopilot", 1])


def test_a_position_lost_among_headings_becomes_outdated(guard: SafetyGuard) -> None:
    now = status(200.0)
    fix, compass = Latest(Gnss(T, 41.0, -8.0, fix=3, speed=0.5), now.t - 2.2), Latest(Ahrs(1.0, NAN, NAN), now.t)
    both = replace(now, latest={("gnss", None): fix, ("gnss/ahrs", None): compass})
    assert newest_values(both, guard)[1] == 0.5
    alone = newest_values(replace(now, latest={("gnss", None): fix}), guard)[1]
    assert alone is not None
    assert math.isnan(alone)


def test_the_newest_value_comes_from_the_receiver_that_still_sends(guard: SafetyGuard) -> None:
    now = status(200.0)
    old, new = (Latest(Gnss(T, 41.0, -8.0, fix=3, speed=v), now.t - age) for v, age in ((1.37, 120.0), (0.5, 0.1)))
    for pair in ((old, new), (new, old)):
        latest = dict(zip([("gnss", None), ("ahrs/gnss", None)], pair, strict=True))
        assert newest_values(replace(now, latest=latest), guard)[1] == 0.5
