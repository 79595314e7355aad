"""The ground station's half against the mock autopilot, without ports and without waiting."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from seatrial.daq.drivers.ardupilot_parameters import (
    FAILSAFE_PARAMETERS,
    NEWER_PARAMETERS,
    check_parameters,
    parameter_lines,
    parameter_names,
)
from seatrial.daq.drivers.base import DISARMED, LinkRole
from seatrial.daq.drivers.factory import make_driver
from seatrial.daq.drivers.setpoints import Due
from seatrial.daq.protocol.catalogue import make_decoder
from seatrial.daq.protocol.mavlink_wire import Codec, FrameHeader, parse_header
from seatrial.daq.rig import Rig
from seatrial.daq.samples import NAN, Ahrs, Battery, Esc, Gnss, Servo
from seatrial.mocks.devices.autopilot import HOLD, OWN_N, RTL, AutopilotEmulator
from tests.daq.mavlink_ends import LEVEL, Ends, mav_rig

LONG = "COMMAND_LONG"


def ready(ends: Ends) -> Ends:
    ends.run(2.0)
    assert not ends.driver.link_at(ends.t).parameters_pending
    return ends


def drive(ends: Ends, left: float, right: float, seconds: float) -> None:
    """Send the commands in every loop, as the acquisition does."""
    held = {1: left, 3: right}
    for _ in range(round(seconds * 50)):
        for data, _dues in ends.driver.command([Due(1, left, False)], held, ends.t):
            ends.to_vehicle(data)
        ends.run(0.02)


def armed(ends: Ends) -> Ends:
    drive(ends, 0.0, 0.0, 0.1)
    ends.driver.request("arm", 0.0)
    ends.run(1.5)
    assert ends.driver.link_at(ends.t).answer == "arm: accepted"
    assert ends.driver.link_at(ends.t).armed
    return ends


def test_the_driver_receives_the_vehicle_and_reads_its_parameters() -> None:
    ends = ready(Ends(mav_rig()))
    link = ends.driver.link_at(ends.t)
    assert link.received
    assert link.mode == "MANUAL"
    assert not link.armed
    assert link.parameters["PILOT_STEER_TYPE"] == 1.0
    assert "SYSID_MYGCS" not in link.parameters  # this vehicle has the newer name
    assert link.refused == ()
    assert check_parameters(link.parameters, mav_rig().thrusters, 255) == ()


def test_a_denied_rate_is_reported_and_half_the_rate_is_requested() -> None:
    ends = ready(Ends(mav_rig(rate=50.0)))
    refused = ends.driver.link_at(ends.t).refused
    assert "ATTITUDE at 50 Hz: denied" in refused
    assert not any("25 Hz" in line for line in refused)
    assert "refuses ATTITUDE at 50 Hz: denied" in [event.text for event in ends.driver.events()]
    before = sum(isinstance(frame.sample, Ahrs) for frame in ends.frames)
    ends.run(2.0)
    assert sum(isinstance(frame.sample, Ahrs) for frame in ends.frames) - before == pytest.approx(50, abs=3)


def test_an_unanswered_request_is_reported_as_unanswered() -> None:
    ends = ready(Ends(mav_rig()))
    ends.deaf = True
    ends.driver.request("arm", 0.0)
    ends.run(3.0)
    assert ends.driver.link_at(ends.t).answer == "arm: no answer"


def test_arming_is_refused_with_the_vehicles_own_reason() -> None:
    ends = ready(Ends(mav_rig()))
    ends.autopilot.vehicle.ekf_ready_at = 100.0
    ends.driver.request("arm", 0.0)
    ends.run(1.0)
    assert ends.driver.link_at(ends.t).answer == (
        "arm: failed (PreArm: AHRS: EKF3 is still initialising, wait for it or reboot)"
    )
    assert not ends.autopilot.vehicle.armed


def test_commands_move_the_thrusters_only_while_armed_and_signs_are_the_rigs() -> None:
    ends = ready(Ends(mav_rig()))
    drive(ends, 0.5, 0.5, 0.2)
    assert [ends.controllers[node].duty for node in (1, 3)] == [0.0, 0.0]
    armed(ends)
    drive(ends, 0.5, 0.25, 0.2)
    assert [ends.controllers[node].duty for node in (1, 3)] == pytest.approx([0.5, -0.25], abs=0.002)
    outputs = {f.sample.node: f.sample.n for f in ends.frames if isinstance(f.sample, Servo)}
    assert outputs == pytest.approx({1: 0.5, 3: 0.25}, abs=0.003)


def test_sticks_away_from_neutral_forbid_arming() -> None:
    ends = ready(Ends(mav_rig()))
    drive(ends, 0.5, 0.0, 0.1)
    ends.driver.request("arm", 0.0)
    drive(ends, 0.5, 0.0, 1.0)
    assert "not neutral" in ends.driver.link_at(ends.t).answer


def test_silence_ends_thrust_by_the_override_timeout_and_then_by_the_failsafe() -> None:
    ends = armed(ready(Ends(mav_rig())))
    drive(ends, 0.5, 0.5, 0.5)
    ends.deaf = True
    ends.run(0.9)
    assert ends.controllers[1].n == pytest.approx(0.5, abs=0.002)
    ends.run(0.2)
    assert [ends.controllers[node].n for node in (1, 3)] == [0.0, 0.0]
    ends.run(5.6)
    assert ends.autopilot.vehicle.mode == HOLD
    assert ends.driver.link_at(ends.t).alarm == "critical: GCS Failsafe"


def test_neutral_is_sent_while_no_command_is_active() -> None:
    ends = armed(ready(Ends(mav_rig())))
    drive(ends, 0.5, 0.5, 0.3)
    drive(ends, 0.0, 0.0, 0.1)
    before = ends.controllers[1].deadline
    ends.run(3.0)
    assert ends.controllers[1].deadline > before + 2.5  # heard all the time, without a command of ours


def test_the_driver_disarms_at_the_end_only_if_the_driver_armed_the_vehicle() -> None:
    ends = ready(Ends(mav_rig()))
    assert ends.driver.shutdown_bytes(ends.t) == b""
    armed(ends)
    ends.to_vehicle(ends.driver.shutdown_bytes(ends.t))
    assert not ends.autopilot.vehicle.armed


def test_a_vehicle_accepts_commands_of_its_own_ground_station_only() -> None:
    ends = armed(ready(Ends(mav_rig())))
    stranger = Ends(mav_rig(more="own_system_id = 254"))
    stranger.driver.request("disarm", 0.0)
    for data, _ in stranger.driver.command([Due(1, 1.0, True)], {1: 1.0}, 0.0):
        ends.autopilot.receive(data, ends.t)
    ends.autopilot.receive(stranger.driver.poll(0.0), ends.t)
    assert ends.autopilot.vehicle.armed
    assert ends.controllers[1].n == 0.0


def test_signed_both_ways(tmp_path: Path) -> None:
    key = tmp_path / "key"
    key.write_bytes(bytes(range(32)))
    ends = armed(ready(Ends(mav_rig(tmp_path, more='key_file = "key"'), key)))
    assert ends.decoder.unsigned == 0
    plain = Ends(mav_rig())
    before = dict(ends.autopilot.vehicle.sticks)
    for data, _ in plain.driver.command([Due(1, 1.0, True)], {1: 1.0}, 0.0):
        ends.autopilot.receive(data, ends.t)
    assert ends.autopilot.vehicle.sticks == before


@pytest.mark.parametrize(
    ("name", "value", "fatal"),
    [
        ("RC_OVERRIDE_TIME", -1.0, True),
        ("RC_OVERRIDE_TIME", 3.0, True),
        ("FS_GCS_ENABLE", 0.0, True),
        ("MAV_GCS_SYSID", 250.0, True),
        ("PILOT_STEER_TYPE", 0.0, True),
        ("SERVO1_FUNCTION", 1.0, True),  # passthrough moves it while disarmed
        ("SERVO3_MAX", 2000.0, True),
        ("RC1_TRIM", 1480.0, True),
        ("FS_THR_ENABLE", 0.0, True),
        ("FS_ACTION", 0.0, True),
        ("FS_ACTION", 1.0, True),
        ("FS_ACTION", 3.0, True),
        ("BATT_FS_LOW_ACT", 1.0, True),
        ("BATT_FS_CRT_ACT", 3.0, True),
        ("FS_GCS_TIMEOUT", 120.0, True),
        ("FS_TIMEOUT", 30.0, True),
        ("RCMAP_ROLL", 3.0, True),
        ("RCMAP_THROTTLE", 1.0, True),
        ("SERVO3_FUNCTION", 70.0, True),
        ("RC_OPTIONS", 34.0, True),
        ("RC1_REVERSED", 1.0, True),
        ("SERVO1_REVERSED", 1.0, True),
        ("MOT_THST_ASYM", 2.0, True),
        ("MOT_THR_MAX", 60.0, True),
        ("MANUAL_STR_EXPO", 0.6, True),
        ("MOT_THST_EXPO", 0.5, True),
        ("MOT_SLEWRATE", 100.0, False),
        ("RC3_DZ", 30.0, False),
        ("FS_THR_VALUE", 1050.0, False),
    ],
)
def test_a_parameter_that_is_wrong_is_named(name: str, value: float, fatal: bool) -> None:
    ends = Ends(mav_rig())
    parameters = {**ends.autopilot.vehicle.parameters, name: value}
    (found,) = check_parameters(parameters, mav_rig().thrusters, 255)
    assert (found.name, found.value, found.fatal) == (name, value, fatal)
    assert str(found).startswith(f"{name} is {value:g}, wanted ")


@pytest.mark.parametrize(
    "name",
    [name for name in parameter_names(mav_rig().thrusters) if name not in ("SYSID_MYGCS", "SCHED_LOOP_RATE")],
)
def test_a_parameter_that_was_not_answered_does_not_pass_as_good(name: str) -> None:
    parameters = Ends(mav_rig()).autopilot.vehicle.parameters
    del parameters[name]
    (found,) = check_parameters(parameters, mav_rig().thrusters, 255)
    assert (found.name, found.value, found.fatal) == (name, None, name not in FAILSAFE_PARAMETERS)
    assert str(found).startswith(f"{name} was not answered by the autopilot; the link may lose messages: repeat")


def test_many_parameters_without_an_answer_share_one_line_for_each_severity() -> None:
    good = Ends(mav_rig()).autopilot.vehicle.parameters
    lost = {"FS_TIMEOUT", "RC1_MIN", "SERVO3_MAX", "RC3_TRIM", *FAILSAFE_PARAMETERS[:2]}
    some = {**{name: value for name, value in good.items() if name not in lost}, "FS_ACTION": 1.0}
    first, fatal, other = parameter_lines(check_parameters(some, mav_rig().thrusters, 255))
    assert first[0].startswith("FS_ACTION is 1, wanted ")
    assert fatal[0].startswith(
        "4 parameters were not answered by the autopilot (RC1_MIN, RC3_TRIM, SERVO3_MAX, FS_TIMEOUT); "
    )
    assert other[0].startswith("2 parameters were not answered by the autopilot (BATT_FS_LOW_ACT, BATT_FS_CRT_ACT); ")
    assert [line[1] for line in (first, fatal, other)] == [True, True, False]
    lines = parameter_lines(check_parameters({}, mav_rig().thrusters, 255))
    assert len(lines) == 2
    assert " more)" in lines[0][0]


def test_a_parameter_without_an_answer_is_an_event_and_a_fatal_finding() -> None:
    ends = Ends(mav_rig())
    del ends.autopilot.vehicle.parameters["FS_TIMEOUT"]
    ends.run(7.0)
    link = ends.driver.link_at(ends.t)
    assert not link.parameters_pending
    assert "not answered: FS_TIMEOUT" in [event.text for event in ends.driver.events()]
    (found,) = check_parameters(link.parameters, mav_rig().thrusters, 255)
    assert (found.name, found.fatal) == ("FS_TIMEOUT", True)


def test_a_parameter_that_an_older_version_lacks_is_not_counted_as_lost() -> None:
    parameters = Ends(mav_rig()).autopilot.vehicle.parameters
    older = {
        name: value for name, value in parameters.items() if name not in NEWER_PARAMETERS and name != "MAV_GCS_SYSID"
    }
    assert check_parameters({**older, "SYSID_MYGCS": 255.0}, mav_rig().thrusters, 255) == ()


def test_a_crossed_rig_is_refused_for_both_sides() -> None:
    one, two = mav_rig().thrusters
    assert one.output is not None
    assert two.output is not None
    crossed = [replace(one, output=two.output), replace(two, output=one.output)]
    found = check_parameters(Ends(mav_rig()).autopilot.vehicle.parameters, crossed, 255)
    assert [(f.name, f.fatal) for f in found] == [("RCMAP_ROLL", True), ("RCMAP_THROTTLE", True)]


def test_a_parameter_that_changes_under_way_is_an_event() -> None:
    ends = ready(Ends(mav_rig()))
    ends.driver.events()
    ends.autopilot.vehicle.parameters["MOT_SLEWRATE"] = 50.0
    ends.autopilot._send_parameter("MOT_SLEWRATE")
    ends.run(0.1)
    assert "MOT_SLEWRATE was changed: 0 to 50" in [event.text for event in ends.driver.events()]


@pytest.mark.parametrize(("role", "sends"), [(LinkRole.LISTEN, False), (LinkRole.ASK, True)])
def test_a_link_without_the_role_to_drive_sends_no_heartbeat_of_a_ground_station(role: LinkRole, sends: bool) -> None:
    rig = mav_rig()
    device = rig.device("autopilot")
    decoder = make_decoder(device, rig)
    driver = make_driver(device, rig, decoder, role)
    assert driver is not None
    autopilot, ear = Codec(1, 1), Codec(9, 1)
    sent, t = [], 0.0
    driver.opened(t)
    for k in range(200):
        t += 0.05
        if k % 20 == 0:
            decoder.feed(autopilot.encode("HEARTBEAT", 11, 3, 81, 0, 4, 3), t)
        for asked in ("leave", "arm") if k == 100 and role is LinkRole.LISTEN else ():
            driver.request(asked, 0.0)
        sent += parsed(ear, driver.poll(t))
        assert driver.wait(t) >= 0.0
    assert bool(sent) is sends
    assert not {"HEARTBEAT", "RC_CHANNELS_OVERRIDE"} & {message.get_type() for message in sent}
    assert device.mavlink is not None
    assert all(message.get_srcSystem() not in (1, device.mavlink.own_system_id) for message in sent)
    assert bool(driver.hint) is not sends


def test_a_request_is_sent_before_rates_and_replaces_an_earlier_request() -> None:
    ends = ready(Ends(mav_rig()))
    ends.deaf = True
    ends.driver._ask_rates(ends.t)  # of which none is answered
    ends.run(0.1)
    ends.driver.request("arm", 0.0)
    ends.run(0.02)
    ends.driver.request("disarm", 0.0)
    ear = Codec(9, 1)
    sent = [m for k in range(3) for m in parsed(ear, ends.driver.poll(ends.t + 0.5 * k)) if m.get_type() == LONG]
    assert [(m.command, m.param1) for m in sent] == [(400, 0.0)] * 3


def parsed(codec: Codec, data: bytes) -> list[Any]:
    """Return the messages in complete frames."""
    found = []
    while data:
        about = parse_header(data, 0)
        assert isinstance(about, FrameHeader)
        found.append(codec.decode(data[: about.total]))
        data = data[about.total :]
    return found


def test_an_answer_to_another_ground_station_is_ignored() -> None:
    ends = ready(Ends(mav_rig()))
    ends.deaf = True
    ends.driver.request("arm", 0.0)
    ends.run(0.1)
    vehicle = Codec(1, 1)
    for target, message_of in ((254, ""), (255, "arm: failed")):
        ends.to_ground(vehicle.encode("COMMAND_ACK", 400, 4, 0, 0, target, 190))
        assert ends.driver.link_at(ends.t).answer == message_of


def test_the_reason_of_a_refusal_may_arrive_after_the_refusal() -> None:
    ends = ready(Ends(mav_rig()))
    ends.deaf = True
    ends.driver.request("arm", 0.0)
    ends.run(0.1)
    vehicle = Codec(1, 1)
    ends.to_ground(vehicle.encode("COMMAND_ACK", 400, 4, 0, 0, 255, 190))
    ends.to_ground(vehicle.encode("STATUSTEXT", 2, b"Arm: Battery 1 below minimum arming voltage"))
    assert ends.driver.link_at(ends.t).answer == "arm: failed (Arm: Battery 1 below minimum arming voltage)"


def test_the_second_part_of_a_long_text_does_not_raise_an_alarm() -> None:
    ends = ready(Ends(mav_rig()))
    vehicle = Codec(1, 1)
    for part, text in enumerate((b"PreArm: AHRS: EKF3 Yaw inconsistent 21 deg. Wait o", b"r reboot")):
        ends.to_ground(vehicle.encode("STATUSTEXT", 2, text, 7, part))
    assert ends.driver.link_at(ends.t).alarm == ""
    ends.to_ground(vehicle.encode("STATUSTEXT", 2, b"Leak detected"))
    assert "Leak" in ends.driver.link_at(ends.t).alarm


def test_after_a_reboot_rates_and_parameters_are_requested_again() -> None:
    ends = ready(Ends(mav_rig()))
    vehicle, ear = Codec(1, 1), Codec(9, 1)
    ends.deaf = True
    ends.to_ground(vehicle.encode("ATTITUDE", 5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    ends.to_ground(vehicle.encode("HEARTBEAT", 11, 3, 81, 0, 4, 3))
    asked = {message.get_type() for message in parsed(ear, ends.driver.poll(ends.t + 1.0))}
    assert {"COMMAND_LONG", "PARAM_REQUEST_READ"} <= asked
    assert any("restarted" in event.text for event in ends.driver.events())


@pytest.mark.parametrize("heard", [True, False])
def test_state_of_the_receiver_is_reported_and_unknown_after_a_restart(heard: bool) -> None:
    ends = Ends(mav_rig())
    ends.autopilot.vehicle.receiver = heard
    ready(ends)
    assert ends.driver.link_at(ends.t).receiver is heard
    ends.to_ground(Codec(1, 1).encode("ATTITUDE", 5, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0))
    assert ends.driver.link_at(ends.t).receiver is None


def test_arming_clears_earlier_alarms_and_later_alarms_remain() -> None:
    ends = ready(Ends(mav_rig()))
    ends.autopilot._queue_text(2, "GCS Failsafe")
    ends.run(0.1)
    assert ends.driver.link_at(ends.t).alarm
    armed(ends)
    assert ends.driver.link_at(ends.t).alarm == ""
    ends.autopilot._queue_text(2, "Leak detected, and a text so long that it comes in two parts of fifty")
    ends.run(0.1)
    assert ends.driver.link_at(ends.t).alarm.endswith("in two parts of fifty")


@pytest.mark.parametrize(
    ("receiver", "failsafe", "ends_after"), [(True, 1.0, 1.0), (False, 1.0, 0.5), (False, 0.0, None)]
)
def test_the_mock_without_a_receiver_holds_the_last_override(
    receiver: bool, failsafe: float, ends_after: float | None
) -> None:
    ends = armed(ready(Ends(mav_rig())))
    ends.autopilot.vehicle.receiver = receiver
    ends.autopilot.vehicle.parameters |= {"FS_THR_ENABLE": failsafe, "FS_ACTION": 0.0}
    drive(ends, 0.5, 0.5, 0.5)
    ends.deaf = True
    begun = ends.t
    while ends.controllers[1].n != 0.0 and ends.t - begun < 20.0:
        ends.run(0.02)
    took = ends.t - begun
    assert took == pytest.approx(20.0 if ends_after is None else ends_after, abs=0.1)


def test_a_muted_driver_sends_zero_commands_only() -> None:
    ends = armed(ready(Ends(mav_rig())))
    drive(ends, 0.1, 0.1, 0.3)
    ends.driver.request("mute", 5.0)
    ends.run(0.02)
    for _ in range(100):
        ends.run(0.02)
        assert ends.driver.poll(ends.t) == b""
        assert ends.driver.command([Due(1, 0.1, False)], {1: 0.1, 3: 0.1}, ends.t) == []
        assert ends.driver.wait(ends.t) > 0.0
    assert ends.controllers[1].n == 0.0
    assert ends.driver.command([Due(1, 0.0, True)], {1: 0.0, 3: 0.0}, ends.t)
    assert ends.driver.poll(ends.t)
    ends.driver.request("mute", 1.0)
    ends.driver.command([Due(1, 0.1, True)], {1: 0.1}, ends.t)
    ends.run(1.1)
    assert ends.driver.command([Due(1, 0.1, True)], {1: 0.1}, ends.t)  # it does not last


def test_another_station_with_the_same_id_and_lost_frames_are_counted() -> None:
    ends = ready(Ends(mav_rig()))
    assert (ends.driver.link_at(ends.t).other_station_frames, ends.driver.link_at(ends.t).lost) == (0, 0)
    ends.to_ground(Codec(255, 230).encode("HEARTBEAT", 6, 8, 0, 0, 4, 3))
    for _ in range(7):
        ends.autopilot._codec.encode("HEARTBEAT", 11, 3, 81, 0, 4, 3)  # on their way, and lost
    ends.run(2.0)
    assert (ends.driver.link_at(ends.t).other_station_frames, ends.driver.link_at(ends.t).lost) == (1, 7)
    texts = [event.text for event in ends.driver.events()]
    assert any(text.startswith("7 of ") and text.endswith(" frames of the autopilot were lost") for text in texts)


def test_the_round_trip_is_measured() -> None:
    ends = ready(Ends(mav_rig()))
    ends.driver._status = replace(ends.driver._status, round_trip=math.nan)  # of ends that are joined without a delay
    sent = ends.driver.poll(ends.t + 1.5)
    ends.t += 1.55
    ends.to_vehicle(sent)
    assert ends.driver.link_at(ends.t).round_trip == pytest.approx(0.05, abs=1e-6)
    ends.driver._status = replace(ends.driver._status, round_trip=0.05)
    ends.run(12.0)
    assert [event.text for event in ends.driver.events() if "TIMESYNC" in event.text]


def test_rates_lowered_by_another_station_are_requested_again() -> None:
    ends = ready(Ends(mav_rig()))
    ends.run(31.0)
    for number in (30, 36):  # ATTITUDE, SERVO_OUTPUT_RAW at 1 Hz
        ends.autopilot._set_message_interval(number, 1e6)
    ends.run(5.0)
    before = len(ends.frames)
    ends.run(2.0)
    assert sum(isinstance(frame.sample, Ahrs) for frame in ends.frames[before:]) == pytest.approx(50, abs=3)


def test_message_names_the_mistake_with_the_signing_key(tmp_path: Path) -> None:
    (tmp_path / "key").write_bytes(bytes(range(32)))
    (tmp_path / "other").write_bytes(bytes(32))
    signed, wrong_key = (mav_rig(tmp_path, more=f'key_file = "{name}"') for name in ("key", "other"))

    def message_of(ours: Rig, key: str, vehicle: Rig) -> str:
        ends = Ends(ours, tmp_path / key if key else None)
        ends.autopilot = AutopilotEmulator(vehicle, vehicle.device("autopilot"), ends.controllers, 1_800_000_000.0)
        ends.autopilot._rates["ATTITUDE"] = 25.0
        ends.run(3.0)
        return ends.driver.message()

    assert message_of(signed, "key", signed) == ""
    assert message_of(mav_rig(), "", mav_rig()) == ""
    assert "no key_file" in message_of(mav_rig(), "", signed)
    assert "another key" in message_of(wrong_key, "other", signed)
    assert "they are not signed" in message_of(signed, "key", mav_rig())


@pytest.mark.parametrize(
    ("kind", "autopilot", "number", "vehicle", "mode"),
    [
        (11, 3, 4, "ArduPilot Rover", "HOLD"),
        (2, 3, 0, "ArduCopter", "STABILIZE"),
        (12, 3, 19, "ArduSub", "MANUAL"),
        (20, 3, 7, "ArduPlane", "CRUISE"),
        (11, 12, 1 << 16, "PX4", "MANUAL"),
        (11, 3, 99, "ArduPilot Rover", "mode 99"),
    ],
)
def test_vehicles_and_their_modes_have_their_own_names(
    kind: int, autopilot: int, number: int, vehicle: str, mode: str
) -> None:
    ends = Ends(mav_rig())
    ends.to_ground(Codec(1, 1).encode("HEARTBEAT", kind, autopilot, 129, number, 4, 3))
    link = ends.driver.link_at(ends.t)
    assert (link.vehicle, link.mode, link.armed) == (vehicle, mode, True)


def test_the_rescuers_zero_is_confirmed_by_an_answer() -> None:
    ends = armed(ready(Ends(mav_rig())))
    drive(ends, 0.5, 0.5, 0.3)
    rescuer = Ends(mav_rig(), role=LinkRole.RESCUE)
    assert "may still be armed" in rescuer.driver.confirmation
    for data, _ in rescuer.driver.zero(ends.t):
        rescuer.to_ground(ends.autopilot.receive(data, ends.t))
    assert not ends.autopilot.vehicle.armed
    assert rescuer.driver.confirmation == DISARMED


def test_a_battery_current_beyond_the_range_of_its_field_is_saturated() -> None:
    ends = Ends(mav_rig())
    ends.run(3.0)
    for node in ends.controllers:
        ends.autopilot.encode(Esc(node, -1200.0, 203.0, 0.0, 15.0, 30.0), ends.t)
    ends.frames.clear()
    for _ in range(100):
        ends.t += 0.02
        ends.to_ground(ends.autopilot.encode(LEVEL, ends.t))
    currents = [frame.sample.current for frame in ends.frames if isinstance(frame.sample, Battery)]
    assert currents
    assert currents == pytest.approx([327.67] * len(currents))


def test_an_enabled_fence_that_drives_the_boat_home_is_refused() -> None:
    good = Ends(mav_rig()).autopilot.vehicle.parameters
    thrusters = mav_rig().thrusters
    assert check_parameters({**good, "FENCE_ACTION": 1.0}, thrusters, 255) == ()
    (found,) = check_parameters({**good, "FENCE_ACTION": 1.0, "FENCE_ENABLE": 1.0}, thrusters, 255)
    assert (found.name, found.fatal) == ("FENCE_ACTION", True)
    without = {name: value for name, value in good.items() if not name.startswith(("FENCE", "BATT"))}
    found = check_parameters(without, thrusters, 255)  # no battery monitor and no fence: reported, but not fatal
    assert [(finding.value, finding.fatal) for finding in found] == [(None, False)] * 4


def test_in_rtl_the_boat_drives_independently_of_commands() -> None:
    ends = armed(ready(Ends(mav_rig())))
    drive(ends, 0.5, 0.5, 0.5)
    ends.driver.request("mode", float(RTL))
    drive(ends, 0.0, 0.0, 1.0)
    assert ends.autopilot.vehicle.mode == RTL
    assert [ends.controllers[node].n for node in (1, 3)] == [OWN_N, OWN_N]


def test_a_receiver_without_a_fix_stops_its_time() -> None:
    blind = Gnss(1_800_000_000.0, NAN, NAN, n_sat=3)

    def run(ends: Ends, fixes: list[Gnss]) -> list[tuple[int, float]]:
        """Return fix and device time of the received frames while the receiver sends ``fixes`` at 5 Hz."""
        before = len(ends.frames)
        for fix in fixes:
            ends.autopilot.encode(fix, ends.t)
            for _ in range(10):
                ends.t += 0.02
                ends.to_ground(ends.autopilot.encode(LEVEL, ends.t))
        found = [frame for frame in ends.frames[before:] if isinstance(frame.sample, Gnss)]
        return [(frame.sample.fix, frame.t_device) for frame in found if isinstance(frame.sample, Gnss)]

    ends = ready(Ends(mav_rig()))
    run(ends, [replace(blind, lat=38.7, lon=-9.1, fix=3)])
    ((fix, t_device),) = run(ends, [blind] * 10)
    assert (fix, math.isnan(t_device)) == (0, True)
    t = ends.t + 20.0
    assert [(f, round(at - t, 2)) for f, at in run(ends, [replace(blind, lat=38.7, lon=-9.1, fix=3)])] == [(3, 0.0)]
    fresh = Ends(mav_rig())
    fresh.autopilot._rates["GPS_RAW_INT"] = 5.0
    ((fix, t_device),) = run(fresh, [blind] * 10)  # since boot: a time of 0
    assert (fix, math.isnan(t_device)) == (0, True)


def test_an_override_of_zero_releases_a_channel() -> None:
    ends = armed(ready(Ends(mav_rig())))
    drive(ends, 0.5, 0.5, 1.0)
    assert ends.controllers[1].n > 0.4
    codec = Codec(255, 190)
    release = codec.encode("RC_CHANNELS_OVERRIDE", 1, 1, 0, *[0xFFFF] * 7, *[0] * 10)
    ends.autopilot.receive(release, ends.t)
    assert ends.autopilot.vehicle.sticks[1] == 0.0
    assert abs(ends.autopilot.vehicle.sticks[3]) == pytest.approx(0.5, abs=0.01)  # 0xFFFF leaves a channel alone


def test_a_parameter_changed_by_another_station_is_detected() -> None:
    """ArduPilot announces a change to every link; the announcement may be lost."""
    ends = ready(Ends(mav_rig()))
    assert ends.driver.link_at(ends.t).changed == ()
    parameters = ends.autopilot.vehicle.parameters
    for name, before, after in (("FS_THR_ENABLE", 1.0, 0.0), ("SERVO1_MAX", parameters["SERVO1_MAX"], 1850.0)):
        known = len(ends.driver.link_at(ends.t).changed)
        parameters[name] = after  # without an announcement
        since = ends.t
        while len(ends.driver.link_at(ends.t).changed) == known:
            ends.run(0.1)
            assert ends.t - since < (6.0 if name == "FS_THR_ENABLE" else 20.0)
        assert ends.driver.link_at(ends.t).changed[-1] == f"{name} was changed: {before:g} to {after:g}"


def test_a_link_without_the_role_to_drive_reads_parameters_once() -> None:
    ends = ready(Ends(mav_rig(), role=LinkRole.ASK))
    ends.autopilot.vehicle.parameters["FS_THR_ENABLE"] = 0.0
    ends.run(10.0)
    assert ends.driver.link_at(ends.t).changed == ()


def test_message_names_the_systems_that_were_heard_instead_of_the_one_in_the_rig() -> None:
    ends = Ends(mav_rig())
    vehicle = mav_rig(more="system_id = 7")
    ends.autopilot = AutopilotEmulator(vehicle, vehicle.device("autopilot"), ends.controllers, 1_800_000_000.0)
    ends.autopilot._rates["ATTITUDE"] = 25.0
    ends.run(0.1)
    assert ends.driver.message() == ""  # too early to tell
    ends.run(3.0)
    message = ends.driver.message()
    assert message.startswith("no message of system 1 (system_id in the rig), but ")
    assert message.endswith(" of system 7; write system_id = 7 for this device in the rig, if this is the autopilot")
    ends.decoder.foreign = {255: 30}
    assert "of system 255; these are ids of ground stations" in ends.driver.message()
