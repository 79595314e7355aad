"""Tests of the check of a single device: each problem is reported as a fault or a warning."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pytest

from seatrial.bench.preflight.rig_checks import check_ports
from seatrial.daq.acquisition.status import PortStatus, Status
from seatrial.daq.checks.device_checks import check_devices
from seatrial.daq.checks.findings import FAULT, WARNING, Finding
from seatrial.daq.drivers.base import LinkStatus
from seatrial.daq.log.reader import open_log
from seatrial.daq.samples import NAN, Ahrs, Gnss, LoadCell
from seatrial.mocks.plant.bench import draw_bench
from seatrial.mocks.world import Sample
from tests.bench.check_cases import Case, alarms, logged, sailed
from tests.daq.mavlink_ends import mav_rig
from tests.missions import boat_with, push, sail, write_log

G = 9.81  # m/s2


def findings_of(path: Path) -> list[Finding]:
    """Return the findings of a log."""
    with open_log(path) as log:
        return alarms(list(check_devices(log)))


@pytest.mark.parametrize(
    ("fault", "level", "code", "where", "text"),
    [
        ("flat/esc@0:100", "fault", "voltage-low", "esc node 1", "6.0 V, limit 10"),
        ("stuck/esc@25:8", "fault", "shaft-speed-stuck", "esc node 2", ""),
        ("stuck/gnss@20:6", "fault", "sensor-stuck", "gnss", ""),
        ("silence/gnss@10:100", "fault", "device-fell-silent", "gnss", ""),
        ("silence/gnss@10:15", "warning", "sections-missing", "gnss", "1 section"),
        ("silence/ahrs@0:100", "fault", "device-not-in-log", "ahrs", ""),
    ],
)
def test_faults_of_one_device(tmp_path: Path, fault: str, level: str, code: str, where: str, text: str) -> None:
    found = findings_of(logged(tmp_path / "run.mcap", 3, Case("", "", "", fault), actuators=True))
    assert [f for f in found if (f.level, f.code, f.where) == (level, code, where) and text in f.text], found


def _ahrs(change: Callable[[Ahrs], Ahrs]) -> Callable[[Sample], Sample]:
    return lambda s: change(s) if isinstance(s, Ahrs) else s


@pytest.mark.parametrize(
    ("change", "code", "text"),
    [
        (_ahrs(lambda s: replace(s, ax=s.ax / G, ay=s.ay / G, az=s.az / G)), "specific-force-not-gravity", "in g?"),
        (_ahrs(lambda s: replace(s, az=s.az + G)), "specific-force-not-gravity", "without gravity?"),
        (_ahrs(lambda s: replace(s, roll=s.roll + math.pi / 2)), "sensor-not-level", "90 deg"),
        (lambda s: replace(s, fix=0) if isinstance(s, Gnss) and int(s.utc) % 2 else s, "position-missing", ""),
        (lambda s: replace(s, n_sat=4) if isinstance(s, Gnss) else s, "few-satellites", "4 "),
    ],
)
def test_implausible_sensor_values_are_reported(
    tmp_path: Path, change: Callable[[Sample], Sample], code: str, text: str
) -> None:
    readings = [r._replace(sample=change(r.sample)) for r in sailed(3, actuators=True).readings]
    found = findings_of(write_log(tmp_path / "run.mcap", "boat", readings))
    assert [f for f in found if f.code == code and text in f.text], found


def test_telemetry_that_saturates_is_not_stuck(tmp_path: Path) -> None:
    recording, _ = sail(boat_with("shaft-clip", 41), 400.0, 141)
    found = findings_of(write_log(tmp_path / "run.mcap", "boat", recording.readings))
    saturated = [f for f in found if f.code == "shaft-speed-saturated"]
    assert {f.where for f in saturated} == {"esc node 1", "esc node 2"}
    assert all(f.level == WARNING and "reports no larger speed" in f.text for f in saturated)
    assert not [f for f in found if f.code == "shaft-speed-stuck"]


def test_a_receiver_with_constant_position_at_rest_is_not_stuck(tmp_path: Path) -> None:
    held = [
        r._replace(sample=replace(s, lat=63.4, lon=9.4, vel_n=0.0, vel_e=0.0)) if isinstance(s := r.sample, Gnss) else r
        for r in sailed(3, actuators=True).readings
    ]
    assert "sensor-stuck" not in {f.code for f in findings_of(write_log(tmp_path / "run.mcap", "boat", held))}


def test_a_boat_that_turns_most_of_the_time_is_judged_at_rest(tmp_path: Path) -> None:
    turned = [
        r._replace(sample=replace(s, r=0.9, ay=0.9 * G)) if isinstance(s := r.sample, Ahrs) and r.t % 30.0 > 10.0 else r
        for r in sailed(3, actuators=True).readings
    ]
    codes = {f.code for f in findings_of(write_log(tmp_path / "run.mcap", "boat", turned))}
    assert "specific-force-not-gravity" not in codes


def test_a_saturated_load_cell_is_reported(tmp_path: Path) -> None:
    readings = push(draw_bench(2), kind="steps")[0].readings
    healthy = findings_of(write_log(tmp_path / "healthy.mcap", "bench", readings))
    assert not healthy
    spoilt = [
        r._replace(sample=replace(r.sample, flags=1)) if isinstance(r.sample, LoadCell) and k % 20 == 0 else r
        for k, r in enumerate(readings)
    ]
    (found,) = findings_of(write_log(tmp_path / "spoilt.mcap", "bench", spoilt))
    assert found.code == "load-cell-saturated"


def test_a_truncated_log_is_reported(tmp_path: Path) -> None:
    whole = logged(tmp_path / "whole.mcap", 3, actuators=True).read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) // 2])
    assert "cut off" in next(f.text for f in findings_of(tmp_path / "cut.mcap") if f.code == "log-damaged")


def test_check_refuses_thrusters_behind_px4() -> None:
    rig = mav_rig()
    port = PortStatus("autopilot", "mavlink", "", 25.0, 25.0, 0.01, 9, 9, 0, 0, 0, 0, 99, 0.0, 0.0, "")
    link = LinkStatus(received=True, vehicle="PX4", age=0.1)
    status = Status(1.0, {"autopilot": port}, {}, {}, 0, "", 1, 1, 1.0, "", (), links={"autopilot": link})
    (found,) = [finding for finding in check_ports(rig, status) if finding.code == "autopilot-not-driven"]
    assert (found.level, found.where) == (FAULT, "autopilot")
    assert "PX4: seatrial drives only ArduPilot Rover" in found.text


@pytest.mark.parametrize(
    ("frames", "n_bytes", "text"),
    [(0, 0, "nothing received"), (0, 900, "wrong baud rate"), (30, 900, "30 frames of mavlink understood")],
)
def test_a_device_without_samples_is_distinguished_from_a_wrong_baud_rate(frames: int, n_bytes: int, text: str) -> None:
    port = PortStatus("autopilot", "mavlink", "", 25.0, NAN, math.inf, 0, frames, 0, 0, 0, 0, n_bytes, NAN, NAN, "")
    status = Status(1.0, {"autopilot": port}, {}, {}, 0, "", 1, 1, 1.0, "", ())
    (found,) = [finding for finding in check_ports(mav_rig(), status) if finding.code == "device-silent"]
    assert text in found.text


@pytest.mark.parametrize(
    ("message", "advice"),
    [("no file of this name; check the cable", ""), ("the port was disconnected", "check power, cable and port")],
)
def test_a_message_with_advice_gets_no_second_one(message: str, advice: str) -> None:
    port = PortStatus("autopilot", "mavlink", "", 25.0, NAN, math.inf, 0, 0, 0, 0, 0, 0, 0, NAN, NAN, message)
    status = Status(1.0, {"autopilot": port}, {}, {}, 0, "", 1, 1, 1.0, "", ())
    (found,) = [finding for finding in check_ports(mav_rig(), status) if finding.code == "device-silent"]
    assert (found.text, found.advice) == (message, advice)


GOOD = LinkStatus(
    received=True, vehicle="ArduPilot Rover", age=0.1, mode="MANUAL", ekf=0x33F, parameters_pending=False, receiver=True
)


@pytest.mark.parametrize(
    ("link", "level", "code", "text"),
    [
        (GOOD, "ok", "autopilot-answers", "mode MANUAL, disarmed, a transmitter is received, EKF flags 831 (position)"),
        (replace(GOOD, receiver=False), "ok", "autopilot-answers", "no transmitter received"),
        (replace(GOOD, ekf=0xA7), "warning", "estimator-not-ready", "its position estimator has no position"),
        (LinkStatus(), "fault", "no-heartbeat", "no heartbeat"),
        (replace(GOOD, parameters={"FS_ACTION": 1.0}), "fault", "autopilot-parameter", "FS_ACTION is 1, wanted 2"),
        (replace(GOOD, parameters_pending=True), "warning", "parameters-unanswered", "not sent all parameters"),
        (replace(GOOD, refused=("RAW_IMU at 50 Hz: denied",)), "warning", "rate-refused", "refuses RAW_IMU at 50 Hz"),
        (
            replace(GOOD, other_station_frames=3),
            "fault",
            "rival-station",
            "another ground station has system id 255, the same as seatrial (own_system_id in the rig)",
        ),
        (replace(GOOD, lost=20), "warning", "frames-lost", "20 frames of the autopilot lost, 999 received"),
        (replace(GOOD, alarm="critical: Leak"), "warning", "autopilot-alarm", "reports critical: Leak"),
    ],
    ids=lambda value: value if isinstance(value, str) and "-" in value else "",
)
def test_the_reported_state_of_an_autopilot_is_judged(link: LinkStatus, level: str, code: str, text: str) -> None:
    port = PortStatus("autopilot", "mavlink", "", 25.0, 25.0, 0.01, 999, 999, 0, 0, 0, 0, 9999, 0.0, 0.0, "")
    status = Status(1.0, {"autopilot": port}, {}, {}, 0, "", 1, 1, 1.0, "", (), links={"autopilot": link})
    found = next(finding for finding in check_ports(mav_rig(), status) if finding.code == code and text in finding.text)
    assert (found.level, found.where) == (level, "autopilot")
    few = replace(link, lost=9)  # fewer than 1 % of the received bytes
    status = replace(status, links={"autopilot": few})
    assert not [finding for finding in check_ports(mav_rig(), status) if finding.code == "frames-lost"]


def test_a_link_without_a_heartbeat_has_the_reason_of_its_port() -> None:
    heard = "no message of system 1 (system_id in the rig), but 80 of system 7; write system_id = 7 for this device"
    port = PortStatus("autopilot", "mavlink", "", 25.0, 25.0, 0.01, 999, 999, 0, 0, 0, 0, 9999, 0.0, 0.0, heard)
    status = Status(1.0, {"autopilot": port}, {}, {}, 0, "", 1, 1, 1.0, "", (), links={"autopilot": LinkStatus()})
    found = next(finding for finding in check_ports(mav_rig(), status) if finding.code == "no-heartbeat")
    assert (found.text, found.advice) == (f"no heartbeat was received: {heard}", "")


@pytest.mark.parametrize("remark", ["", "frames of node 7, which no thruster of the rig has"])
def test_a_remark_on_a_stream_is_not_a_fault(remark: str) -> None:
    expected = remark or "[Errno 5] it hung up"
    port = PortStatus("autopilot", "mavlink", "", 25.0, 25.0, 0.01, 9, 9, 0, 0, 0, 0, 99, 0.0, 0.0, expected, remark)
    status = Status(1.0, {"autopilot": port}, {}, {}, 0, "", 1, 1, 1.0, "", ())
    (found,) = [finding for finding in check_ports(mav_rig(), status) if finding.code == "port-error"]
    assert (found.level, found.text) == (WARNING if remark else FAULT, expected)
