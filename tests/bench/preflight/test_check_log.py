"""Tests of `seatrial check LOG`: each injected fault is found and named, and a healthy run has no findings."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from seatrial import command_line
from seatrial.bench.mission_generators import make_mission
from seatrial.daq.checks.device_checks import check_lost_zeros, check_timestamps, white_noise_sd
from seatrial.daq.checks.findings import Finding, findings_lines, findings_summary, joined, worst_first
from seatrial.ident.checks.log_checks import check_signals
from seatrial.ident.checks.motion import check_motion
from seatrial.ident.checks.sensors import heading_match
from seatrial.ident.checks.shafts import Response, response
from seatrial.ident.data.record import Channel
from seatrial.mocks.offline_simulation import simulate, tables
from seatrial.mocks.plant.boat import draw_boat
from seatrial.mocks.plant.thruster import draw_thruster
from tests.bench.check_cases import CASES, Case, alarms, findings, logged, mission, named, sailed
from tests.missions import boat_with, channels_of, sail
from tests.recovery.kinds import NONE
from tests.recovery.rigs import RigCase


@pytest.mark.parametrize("case", CASES, ids=lambda case: case.name)
def test_an_injected_fault_is_found_and_named_by_the_actuator_test(tmp_path: Path, case: Case) -> None:
    found = findings(logged(tmp_path / "run.mcap", 3, case, actuators=True))
    assert named(case, found), findings_lines(found)


@pytest.mark.parametrize(
    "case", [CASES[0], pytest.param(CASES[1], marks=pytest.mark.study), CASES[8]], ids=lambda case: case.name
)
def test_an_injected_fault_is_found_and_named_in_a_mission(tmp_path: Path, case: Case) -> None:
    found = findings(logged(tmp_path / "run.mcap", 3, case))
    assert named(case, found), findings_lines(found)


@pytest.mark.parametrize("actuators", [False, True], ids=["mission", "actuators"])
@pytest.mark.parametrize("seed", [21, pytest.param(22, marks=pytest.mark.study)])
def test_a_healthy_run_raises_no_alarm(tmp_path: Path, seed: int, actuators: bool) -> None:
    found = findings(logged(tmp_path / "run.mcap", seed, None, actuators))
    assert not alarms(found), findings_lines(alarms(found))
    assert {
        "rate-as-expected", "sensor-noise-as-expected", "gyro-as-expected", "sensors-in-time", "shaft-on-time",
        "thruster-sides-agree", "voltage-as-expected",
    } <= {f.code for f in found}  # fmt: skip


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    with pytest.raises(SystemExit) as left:
        command_line.main(words)
    out, err = capsys.readouterr()
    return int(left.value.code or 0), out, err


def test_the_command_on_logs(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    good = logged(tmp_path / "good.mcap", 3, None, actuators=True)
    bad = logged(tmp_path / "bad.mcap", 3, CASES[0], actuators=True)
    status, out, err = run(capsys, "check", str(good))
    assert status == 0, err
    assert out.splitlines()[-1].startswith("0 faults, 0 warnings")
    status, out, err = run(capsys, "check", str(good), str(bad))
    assert status == 1
    assert out.splitlines()[0].startswith("fault    bad: left and right")
    assert err.count("\n") == 1
    assert "not as it should be: bad: left and right" in err
    status, out, _ = run(capsys, "check", "--json", str(bad))
    assert status == 1
    result = json.loads(out)
    assert result["format"] == "seatrial-check 1"
    faults = [f for f in result["findings"] if f["level"] == "fault"]
    assert [(f["code"], f["where"]) for f in faults] == [("thruster-sides-swapped", "left and right")]
    assert all(f["advice"] for f in faults)


@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["a.toml", "b.mcap"], "give one rig file"),
        (["b.mcap", "--actuators"], "need a rig file"),
        (["a.toml", "--from", "5"], "--from and --to apply to logs"),
        (["b.mcap", "--from", "5", "--to", "4"], "--to 4 s is not after --from 5 s"),
        (["a.toml", "--arm"], "apply only with --actuators"),
        (["a.toml", "--actuators", "--link-test", "--thrust", "0.2"], "always commands 0.1"),
    ],
)
def test_options_that_exclude_each_other_are_wrong_usage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], words: list[str], expected: str
) -> None:
    monkeypatch.chdir(tmp_path)
    for word in words:
        if not word.startswith("-"):
            Path(word).touch()
    status, _, err = run(capsys, "check", *words)
    assert status == 2
    assert expected in err


def test_a_file_of_another_format_gives_a_one_line_error(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "no.mcap"
    path.write_bytes(b"nothing of the kind")
    status, out, err = run(capsys, "check", str(path))
    assert status == 1
    assert not out
    assert err.count("\n") == 1


def test_the_reported_delay_and_dead_band_match_the_thruster() -> None:
    recording = sailed(5, None, actuators=True)
    table = tables(recording.readings)
    commanded = Channel(table["esc/1/command"]["t"].copy(), table["esc/1/command"]["n_cmd"].copy())
    found = response(commanded, channels_of(recording)["n_left"])
    assert isinstance(found, Response)
    assert found.delay == pytest.approx(0.345, abs=0.06)
    assert found.time_constant == pytest.approx(1 / 7.2115, abs=0.1)
    assert 0.05 < found.band <= 0.1  # it lies between the steps at 0.05 and 0.1: the true value is 0.086
    assert found.scale == pytest.approx(1.0, abs=0.02)


@pytest.mark.parametrize("late", [-0.8, 0.0, 0.5])
def test_the_delay_of_a_gyro_is_measured(late: float) -> None:
    c = channels_of(sailed(5))
    moved = Channel(c["r"].t + late, c["r"].value)
    found = heading_match(c | {"r": moved})
    assert found is not None
    assert found.lag == pytest.approx(-late, abs=0.051)
    assert found.scale == pytest.approx(1.0, abs=0.03)


def test_units_of_velocity_and_shaft_speed_are_recognised() -> None:
    recording = sailed(6)
    c, table = channels_of(recording), tables(recording.readings)
    for node, side in ((1, "left"), (2, "right")):
        command = table[f"esc/{node}/command"]
        c[f"n_cmd_{side}"] = Channel(command["t"].copy(), command["n_cmd"].copy())
    sides = {"left": -0.15, "right": 0.15}
    assert not [f for f in check_signals(c, sides) if f.is_problem]
    knots = c | {n: Channel(c[n].t, c[n].value / 0.5144) for n in ("vx", "vy")}
    findings = [f for f in check_signals(knots, sides) if f.code == "velocity-unit"]
    assert any("is too large: are its numbers in knots and taken as m/s?" in f.text for f in findings)
    converted = c | {n: Channel(c[n].t, c[n].value * 0.5144) for n in ("vx", "vy")}  # m/s, declared as kn in the map
    findings = [f for f in check_signals(converted, sides) if f.code == "velocity-unit"]
    assert any("is too small: are its numbers in m/s and converted as knots?" in f.text for f in findings)
    slow = c | {"n_left": Channel(c["n_left"].t, c["n_left"].value * 2 * np.pi / 60)}
    (found,) = [f for f in check_signals(slow, sides) if f.check == "units"]
    assert (found.where, found.code) == ("left", "shaft-speed-in-rad-per-s")
    backwards = c | {"n_right": Channel(c["n_right"].t, -c["n_right"].value)}
    assert [f.where for f in check_signals(backwards, sides) if f.code == "shaft-sign-reversed"] == ["right"]
    turned = c | {"r": Channel(c["r"].t, -c["r"].value)}
    assert "gyro-sign-reversed" in {f.code for f in check_signals(turned, sides)}


@pytest.mark.parametrize("actuators", [False, True], ids=["mission", "actuators"])
def test_a_thruster_without_a_propeller_is_named(actuators: bool) -> None:
    t, n = mission(7, actuators).setpoints()
    whole = channels_of(sailed(7, actuators=actuators))
    # the right thruster gives no thrust
    without = channels_of(simulate(draw_boat(7), t, n * [1.0, 0.0], float(t[-1]), 7))
    sides = {"left": -0.15, "right": 0.15}
    assert [f.code for f in check_motion(whole, sides)] == ["thruster-sides-agree"]
    (found,) = check_motion(without | {"n_right": whole["n_right"]}, sides)
    assert (found.level, found.code, found.where) == ("fault", "thruster-without-effect", "right")


def test_a_thruster_that_hardly_turns_the_boat_is_not_reported_as_dead() -> None:
    """Its share of the turning in this minute cannot be resolved.

    Its thrust ahead is resolved with 3.6 standard errors.
    """
    seed = RigCase("short", NONE, 9718).boat_seed
    t, n = make_mission("mixed", 60.0, 100 + seed).setpoints()
    boat = draw_boat(seed, [], draw_thruster(seed))
    found = check_motion(channels_of(simulate(boat, t, n, 60.0, 1)), {"left": -0.15, "right": 0.15})
    assert [f.code for f in found] == ["thruster-sides-agree"]


@pytest.mark.parametrize("seed", [0, 1, *(pytest.param(k, marks=pytest.mark.study) for k in (2, 3))])
def test_the_lever_arm_of_an_antenna_is_not_reported_as_delay(seed: int) -> None:
    """The antenna has its own velocity in each turn. A delay of 0.2 to 0.35 s of either sign explained a part of it."""
    c = channels_of(sail(boat_with("lever-arm", seed, 1.5), 200.0, seed)[0])
    assert not [f.text for f in check_signals(c, {"left": -0.15, "right": 0.15}) if f.code == "sensor-late"]


def test_white_noise_is_measured_under_motion() -> None:
    rng = np.random.default_rng(1)
    t = np.arange(0.0, 60.0, 0.02)
    assert white_noise_sd(np.sin(t) + 0.01 * rng.normal(size=t.size)) == pytest.approx(0.01, rel=0.1)


def stamped(device: np.ndarray, received: np.ndarray) -> np.ndarray:
    table = np.zeros(device.size, [("t", "f8"), ("t_rx", "f8"), ("t_device", "f8")])
    table["t"] = table["t_rx"] = received
    table["t_device"] = device
    return table


def clocks(device: np.ndarray, received: np.ndarray) -> list[Finding]:
    found = check_timestamps("ahrs", stamped(device, received), received[-1])
    return [f for f in found if f.check in ("clock", "gap")]


def test_clocks_that_jump_run_back_drift_or_lag_are_reported() -> None:
    t = np.arange(0.0, 120.0, 0.02)
    rng = np.random.default_rng(2)
    received = t + 0.003 * rng.exponential(size=t.size)
    assert [f.code for f in clocks(t, received)] == ["clock-steady"]
    jumped = t + 0.5 * (t > 60.0)
    restarted = np.where(t > 60.0, t - 60.0, t)
    for device, code, number in (
        (jumped, "clock-jumps", " 0.50 s"),
        (restarted, "clock-ran-back", " 1 time"),
        (1.001 * t, "clock-drifts", " -100"),
    ):
        (found,) = clocks(device, received)
        assert found.code == code
        assert number in found.text
        assert found.level != "ok"
    rounded = t.copy()
    # same instant, once in ms and once in us: the attitude and the IMU of an autopilot
    rounded[1] = np.nextafter(t[0], -1.0)
    assert [f.code for f in clocks(rounded, received)] == ["clock-steady"]
    bunched = np.ceil(t / 0.4) * 0.4 + 0.003
    assert "samples-late" in {f.code for f in clocks(t, bunched)}
    few = np.array([0.0, 0.5, 1.0, 1.5, 1.5, 2.0])  # a battery at 2 Hz, two samples in one read
    assert "samples-bunched" not in {f.code for f in check_timestamps("battery", stamped(few, few), 2.0)}
    assert "samples-bunched" in {f.code for f in check_timestamps("ahrs", stamped(t, np.ceil(t / 0.4) * 0.4), 120.0)}
    lost = (t < 30.0) | (t > 42.0)
    (gap,) = [f for f in clocks(t[lost], received[lost]) if f.code == "sections-missing"]
    assert "missing: 1 section, 12.0 s" in gap.text


def test_time_stamps_without_leading_zeros_are_reported() -> None:
    rng = np.random.default_rng(3)
    t = np.cumsum(rng.uniform(0.08, 0.12, 1000))
    assert not list(check_lost_zeros("n", t))
    nanoseconds = np.round((t % 1.0) * 1e9).astype(int)
    wrong = np.floor(t) + np.array([float(f"0.{k}") for k in nanoseconds])
    (found,) = check_lost_zeros("n", wrong)
    assert found.code == "lost-zeros"
    assert "unpadded-ns" in found.advice
    assert not list(check_lost_zeros("gnss", 0.5 + np.arange(1000.0)))  # a device that always sends at the half second


def test_the_findings_are_printed_as_a_table() -> None:
    found = [Finding("ok", "code", "a", "x", "fine"), Finding("fault", "code", "bb", "yy", "bad", "mend it")]
    assert findings_lines(worst_first(found)) == ["fault    yy  bb  bad: mend it", "ok       x   a   fine"]
    assert findings_summary(found) == "1 fault, 0 warnings, 1 in order"
    undecided = [*found, Finding("unknown", "delay-unknown", "late", "x", "the delay is not known")]
    assert [f.level for f in worst_first(undecided)] == ["fault", "unknown", "ok"]
    assert findings_summary(undecided) == "1 fault, 0 warnings, 1 in order, 1 unknown"


def test_one_finding_about_several_signals_is_joined() -> None:
    gap = Finding("warning", "sections-missing", "gap", "x", "1 section", "check the cable")
    stuck = Finding("warning", "signal-constant", "stuck", "y", "its value is 0")
    assert joined([gap, stuck, gap._replace(where="y"), gap._replace(text="2 sections", where="r")]) == [
        gap._replace(where="x, y"), stuck, gap._replace(text="2 sections", where="r"),
    ]  # fmt: skip
