"""Tests of the tables of a rig from an autopilot's parameters: thrusters, and a comment for each caveat."""

from __future__ import annotations

import socket
import threading
from pathlib import Path

import pytest

from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.protocol.mavlink_wire import Codec
from seatrial.daq.rig import Rig
from seatrial.daq.tools.autopilot_tables import DiscoveredAutopilot, identify_autopilot
from tests.daq.mavlink_ends import Ends, mav_rig


def tables(**changes: float) -> tuple[Rig, list[str]]:
    """Return the rig and the caveats of the mock's parameters with changes."""
    parameters = {**Ends(mav_rig()).autopilot.vehicle.parameters, **changes}
    found = DiscoveredAutopilot("udp:127.0.0.1:14550", "", "mavlink", vehicle="ArduPilot Rover", parameters=parameters)
    text = found.toml("mavlink1")
    caveats = [line.partition("caveat: ")[2] for line in text.splitlines() if "caveat: " in line]
    return parse_rig(f'format = "seatrial-rig 1"\nname = "found"\n{text}', Path("rig.toml")), caveats


def test_the_tables_of_the_mock_autopilot_have_the_thrusters_of_its_rig() -> None:
    rig, caveats = tables()
    wanted = {t.name: (t.node, t.output, t.position_m[1] < 0.0) for t in mav_rig().thrusters}
    assert {t.name: (t.node, t.output, t.position_m[1] < 0.0) for t in rig.thrusters} == wanted
    assert [caveat for caveat in caveats if "measure" not in caveat] == []
    assert rig.devices[0].mavlink is not None
    assert (rig.devices[0].name, rig.devices[0].rate_hz) == ("mavlink1", 25.0)
    assert rig.devices[0].mavlink.rates == {"SERVO_OUTPUT_RAW": 40.0}  # four fifths of its loop, by a network


def test_two_boats_in_one_rig_have_separate_thrusters() -> None:
    parameters = Ends(mav_rig()).autopilot.vehicle.parameters
    boats = [
        DiscoveredAutopilot(f"udp:127.0.0.1:{port}", "", "mavlink", vehicle="ArduPilot Rover", parameters=parameters)
        for port in (14550, 14560)
    ]
    tables = "\n".join(boat.toml(f"mavlink{k}", alone=False) for k, boat in enumerate(boats, start=1))
    rig = parse_rig(f'format = "seatrial-rig 1"\nname = "found"\n{tables}', Path("rig.toml"))
    assert [(t.name, t.device) for t in rig.thrusters] == [
        (f"{device}_{side}", device) for device in ("mavlink1", "mavlink2") for side in ("left", "right")
    ]


def test_channels_pulses_and_ground_station_are_the_autopilots() -> None:
    rig, _ = tables(
        RCMAP_ROLL=5, RC5_MIN=1050, RC5_TRIM=1510, RC5_MAX=1950, SERVO1_MIN=1120, MAV_GCS_SYSID=250, SCHED_LOOP_RATE=25
    )
    left = rig.thruster("left").output
    assert left is not None
    assert (left.rc_channel, left.rc_us, left.pwm_us) == (5, (1050.0, 1510.0, 1950.0), (1120.0, 1500.0, 1900.0))
    assert rig.devices[0].mavlink is not None
    assert rig.devices[0].mavlink.own_system_id == 250
    assert (rig.devices[0].rate_hz, rig.devices[0].mavlink.rates) == (20.0, {})  # four fifths of its loop


@pytest.mark.parametrize(
    ("name", "value"), [("FS_ACTION", 1), ("RC_OVERRIDE_TIME", 3), ("SERVO3_REVERSED", 1), ("MOT_THR_MAX", 50)]
)
def test_a_parameter_that_prevents_driving_is_a_caveat(name: str, value: float) -> None:
    _, caveats = tables(**{name: value})
    assert any(caveat.startswith(f"{name} is {value:g}") for caveat in caveats)


def test_a_boat_with_a_rudder_has_no_thruster() -> None:
    rig, caveats = tables(SERVO1_FUNCTION=26, SERVO3_FUNCTION=70)
    assert rig.thrusters == ()
    assert any("output 1 steers" in caveat for caveat in caveats)
    assert any("output 3 is the throttle of both sides" in caveat for caveat in caveats)


@pytest.mark.parametrize("changes", [{"SERVO2_FUNCTION": 73.0}, {"SERVO2_FUNCTION": 73.0, "SERVO4_FUNCTION": 73.0}])
def test_a_second_output_of_a_side_is_a_caveat_instead_of_a_thruster(changes: dict[str, float]) -> None:
    rig, caveats = tables(**changes)
    assert [(t.name, t.node) for t in rig.thrusters] == [("left", 1), ("right", 3)]
    also = [caveat for caveat in caveats if "turns with channel 1, too" in caveat]
    assert [caveat.partition(" (left)")[0] for caveat in also] == [f"output {name[5]}" for name in changes]


def test_sides_on_one_channel_are_one_thruster() -> None:
    rig, caveats = tables(RCMAP_THROTTLE=1.0)
    assert [thruster.name for thruster in rig.thrusters] == ["left"]
    assert any(caveat.startswith("output 3 (right) turns with channel 1, too") for caveat in caveats)


@pytest.mark.parametrize("vehicle", ["ArduSub", "ArduCopter", "PX4"])
def test_other_vehicles_are_named_and_have_no_thruster(vehicle: str) -> None:
    found = DiscoveredAutopilot("tcp:10.0.0.2:5760", "", "mavlink", vehicle=vehicle, system_id=3, signed=True)
    text = found.toml("mavlink1")
    rig = parse_rig(f'format = "seatrial-rig 1"\nname = "found"\n{text}', Path("rig.toml"))
    assert rig.thrusters == ()
    assert rig.devices[0].mavlink is not None
    assert rig.devices[0].mavlink.system_id == 3
    assert text.count("caveat: ") == 2
    assert vehicle in text.splitlines()[0]


@pytest.mark.parametrize(("autopilot", "vehicle", "message"), [
    (12, 11, "PX4, system 1; only ArduPilot Rover can be driven, this vehicle is only logged"),
    (3, 12, "ArduSub, system 1; only ArduPilot Rover can be driven, this vehicle is only logged"),
    (3, 11, "ArduPilot Rover, system 1"),
])  # fmt: skip
def test_only_a_rover_with_ardupilot_can_be_driven(autopilot: int, vehicle: int, message: str) -> None:
    """The vehicle sends heartbeats over UDP. With --toml, a vehicle that cannot be driven gets no request."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as vehicle_socket:
        vehicle_socket.bind(("127.0.0.1", 0))
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as taken:
            taken.bind(("127.0.0.1", 0))
            port = taken.getsockname()[1]
        codec = Codec(1, 1)
        ending = threading.Event()

        def beat() -> None:
            while not ending.wait(0.1):
                vehicle_socket.sendto(codec.encode("HEARTBEAT", vehicle, autopilot, 0, 0, 4, 3), ("127.0.0.1", port))

        thread = threading.Thread(target=beat)
        thread.start()
        found = identify_autopilot(f"udpin:127.0.0.1:{port}", 0, vehicle != 11)
        ending.set()
        thread.join()
        assert found.says == message
        vehicle_socket.setblocking(False)
        if "logged" in message:
            with pytest.raises(BlockingIOError):
                vehicle_socket.recv(100)
