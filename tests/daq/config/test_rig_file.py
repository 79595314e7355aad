"""Tests of the rig file: the documented example is read, and each error is named in one line."""

from __future__ import annotations

import os
import re
from pathlib import Path

import numpy as np
import pytest

from seatrial.daq.config.rig_file import load_rig, parse_rig
from seatrial.daq.errors import SeatrialError

DOCUMENT = Path(__file__).parents[3] / "docs" / "formats" / "rig.md"


@pytest.fixture
def example() -> str:
    found = re.search(r"```toml\n(.*?)```", DOCUMENT.read_text(encoding="utf-8"), re.DOTALL)
    assert found is not None
    return found[1]


def test_the_documented_rig_is_read(example: str, tmp_path: Path) -> None:
    path = tmp_path / "boats" / "rig.toml"
    path.parent.mkdir()
    path.write_text(example, encoding="utf-8")
    rig = load_rig(path)
    assert (rig.name, rig.speed, rig.text) == ("mock boat", 20.0, example)
    assert rig.log_directory == path.parent / "logs"
    assert [device.name for device in rig.devices] == ["ahrs", "gnss", "esc", "loadcell"]
    assert rig.device("ahrs").port == str(path.parent / "ports" / "ahrs")
    assert rig.device("esc").port == f"slcan:{path.parent / 'ports' / 'can'}"
    assert rig.device("esc").bitrate == 500_000
    cell = rig.device("loadcell")
    assert cell.saturation == 8388607.0
    assert cell.calibration is not None
    assert cell.calibration.force(84210.0 + 5000.0) == pytest.approx(5.0)
    np.testing.assert_allclose(cell.calibration.force(np.array([84210.0, 83210.0])), [0.0, -1.0])
    left = rig.thruster("left")
    assert (left.device, left.node, left.position_m, left.reversed) == ("esc", 1, (-0.55, -0.15, 0.0), False)
    assert (rig.limits.force_n, rig.limits.radius_m, rig.vehicle) == (80.0, 200.0, {"m_u": 37.0})


def test_absolute_and_socketcan_ports_are_not_changed(example: str) -> None:
    text = example.replace('"ports/ahrs"', '"/dev/ttyUSB3"').replace("slcan:ports/can", "socketcan:can0")
    rig = parse_rig(text, "/boats/rig.toml")
    assert rig.device("ahrs").port == "/dev/ttyUSB3"
    assert rig.device("esc").port == "socketcan:can0"


@pytest.mark.parametrize(
    ("old", "new", "line"),
    [
        ('format = "seatrial-rig 1"', 'format = "seatrial-rig 9"', r"format: must be 'seatrial-rig 1', not '"),
        ("speed = 20.0", "sped = 20.0", r"clock\.sped: unknown key 'sped'; did you mean 'speed'\? Known here: speed"),
        ("speed = 20.0", "speed = nan", r"clock\.speed: must be a finite number"),
        ("speed = 20.0", "speed = true", r"clock\.speed: must be a number, not true"),
        ('protocol = "vectornav"', 'protocol = "xsens"', r"device\[1\]\.protocol: must be one of vectornav, "),
        ("baud = 38400", "", r"^$"),  # a default value
        ("rate_hz = 50.0", "rate_hz = -1", r"device\[1\]\.rate_hz: must be above zero"),
        ("rate_hz = 50.0", "", r"device\[1\]\.rate_hz: missing; add this required key"),
        (
            "rate_hz = 50.0",
            "rate = 50.0",
            r"device\[1\]\.rate_hz: missing; the table has 'rate': rename it to 'rate_",
        ),
        ("n_max = 1.0", "n_max = 1.0\ncurrent = 9", r"limits\.current: unknown key; .*known here"),
        ("current_a = 40.0", "current = 9", r"limits\.current: unknown key 'current'; did you mean 'current_a'\?"),
        ("rate_hz = 50.0", "rate_hz = 50.0\nbitrate = 500000", r"device\[1\]\.bitrate: unknown key"),
        ('name = "gnss"', 'name = "ahrs"', r"device: 'ahrs' appears twice"),
        ('name = "gnss"', 'name = "G/1"', r"device\[2\]\.name: 'G/1' becomes a topic"),
        ('"slcan:ports/can"', '"ports/can"', r"device\[3\]\.port: must be slcan:SERIAL or socketcan:NAME"),
        (r"(?P<counts>-?\d+)", r"(-?\d+)", r"device\[4\]\.pattern: must have a group"),
        (r"(?P<counts>-?\d+)", r"(?P<counts>-?\d+", r"device\[4\]\.pattern: not a regular expression"),
        ("node = 1", "node = 1.5", r"thruster\[1\]\.node: must be a whole number, not 1\.5"),
        (
            'device = "esc"',
            'device = "ahrs"',
            r"thruster\[1\].device: the rig has no device 'ahrs' of protocol vesc or dronecan or mavlink",
        ),
        ("[-0.55, -0.15, 0.0]", "[-0.55, -0.15]", r"position_m: must have 3 numbers, not 2"),
        ("n_max = 1.0", "n_max = 1.5", r"limits\.n_max: must be within 0\.0 \.\. 1\.0"),
        ('["pitch_deg"]', '["unwatched"]', r"limits\.unwatched: 'unwatched' is not a limit"),
        ("[limits]", "[limit]", r"limit: unknown key 'limit'; did you mean 'limits'\? Known here: format, name"),
        ("[limits]", "[limits", r"not valid TOML.*line"),
        (
            "n_max = 1.0",
            "n_max = 128 kg",
            r"line \d+: not valid TOML: n_max = 128 kg is a number with a unit; write the number alone, "
            r"in the unit that the format states: n_max = 128$",
        ),
        ("n_max = 1.0", "n_max = 1.5m/s", r"n_max = 1\.5m/s is a number with a unit; .*: n_max = 1\.5$"),
        ("n_max = 1.0", "n_max = 10 %  # of full", r"n_max = 10 % is a number with a unit; .*: n_max = 10$"),
        ('name = "mock boat"', "name = boat", r'name = boat is a text without quotes; write name = "boat"'),
        ("n_max = 1.0", "n_max = 1.2.3", r"not valid TOML: Expected newline .*line \d+.*; correct the text there"),
        ('name = "mock boat"', 'name = "a\\u001b[2Jb"', r"name: has characters that are not printable: 'a\\x1b\[2Jb'"),
        ("m_u = ", '"m\\u0007" = ', r"vehicle\.'m\\x07': this name has characters that are not printable"),
        ("commands = false", "commands = 1", r"ros2\.commands: must be true or false"),
        ('"tcp/127.0.0.1:7447"', '"udp/10.0.0.1:7447#iface=x"', r"ros2\.router: must be tcp/HOST:PORT"),
        ('namespace = ""', 'namespace = "a/**"', r"ros2\.namespace: 'a/\*\*' becomes a part of topics"),
        ("timeout_s = 0.3", "timeout_s = 30.0", r"ros2\.timeout_s: must be within 0\.05 \.\. 2\.0"),
    ],
)
def test_an_error_in_a_rig_is_named_in_one_line(example: str, old: str, new: str, line: str) -> None:
    text = example.replace(old, new, 1)
    assert text != example
    if line == "^$":
        parse_rig(text, "boat/rig.toml")
        return
    with pytest.raises(SeatrialError, match=line) as caught:
        parse_rig(text, "boat/rig.toml")
    assert str(caught.value).startswith("boat/rig.toml: ")
    assert "\n" not in str(caught.value)


def test_all_mistakes_in_a_rig_are_named_at_once(example: str) -> None:
    text = example.replace("speed = 20.0", "sped = 20.0").replace("rate_hz = 5.0", "rate = 5.0\nfoo = 1\nbar = 2", 1)
    text = text.replace("radius_m", "radius", 1)
    with pytest.raises(SeatrialError) as raised:
        parse_rig(text, "rig.toml")
    message = str(raised.value)
    assert message.startswith("rig.toml: clock.sped: unknown key 'sped'; did you mean 'speed'?")
    assert " | 2 more errors: device[2].rate_hz: missing; the table has 'rate': rename it to 'rate_hz' | " in message
    assert "limits.radius: unknown key 'radius'; did you mean 'radius_m'?" in message
    assert message.count("rig.toml") == 1
    assert "\n" not in message
    with pytest.raises(SeatrialError, match=r"known here: .*; also unknown: 'bar'"):
        parse_rig(example.replace("rate_hz = 5.0", "rate_hz = 5.0\nfoo = 1\nbar = 2", 1), "rig.toml")


def test_an_unreadable_rig_gives_a_one_line_error(tmp_path: Path) -> None:
    with pytest.raises(SeatrialError, match=r"none\.toml: cannot be read: No such file"):
        load_rig(tmp_path / "none.toml")
    (tmp_path / "latin.toml").write_bytes(b"name = '\xe5'")
    with pytest.raises(SeatrialError, match="not UTF-8"):
        load_rig(tmp_path / "latin.toml")


def test_unknown_names_in_a_rig_are_refused(example: str) -> None:
    rig = parse_rig(example, "rig.toml")
    with pytest.raises(SeatrialError, match="no device 'cell'; give one that it has: ahrs, gnss, esc, loadcell"):
        rig.device("cell")
    with pytest.raises(SeatrialError, match="no thruster 'right'; give one that it has: left"):
        rig.thruster("right")


@pytest.mark.parametrize(
    ("port", "kind"), [("ports/gnss", "nmea"), ("udp:127.0.0.1:14550", "mavlink"), ("slcan:ports/can", "vesc")]
)
def test_two_devices_on_one_port_are_refused(port: str, kind: str) -> None:
    row = '[[device]]\nname = "{}"\nprotocol = "{}"\nport = "{}"\nrate_hz = 5.0\n'
    text = 'format = "seatrial-rig 1"\nname = "x"\n' + row.format("a", kind, port) + row.format("b", kind, port)
    with pytest.raises(SeatrialError, match="a and b have the same port"):
        parse_rig(text, "rig.toml")
    for shared in ("socketcan:can0", "tcp:127.0.0.1:5760"):
        of = "vesc" if shared.startswith("socketcan") else "mavlink"
        both = 'format = "seatrial-rig 1"\nname = "x"\n' + row.format("a", of, shared) + row.format("b", of, shared)
        assert len(parse_rig(both, "rig.toml").devices) == 2


def test_names_of_one_port_are_recognised(tmp_path: Path) -> None:
    row = '[[device]]\nname = "{}"\nprotocol = "{}"\nport = "{}"\nrate_hz = 5.0\n'
    text = (
        'format = "seatrial-rig 1"\nname = "x"\n' + row.format("a", "vesc", "slcan:{}") + row.format("b", "nmea", "{}")
    )
    device, link = tmp_path / "ttyUSB0", tmp_path / "usb-receiver"
    device.touch()
    link.symlink_to(device)
    for first, second in ((link, link), (link, device), ("x/../gnss", "gnss")):
        with pytest.raises(SeatrialError, match=r"a and b have the same port, .*(/usb-receiver|/gnss).*; give"):
            parse_rig(text.format(first, second), tmp_path / "rig.toml")
        # The links of this computer do not show which ports a log was recorded from.
        assert parse_rig(text.format(first, second), tmp_path / "rig.toml", recorded=True).devices
    # Links that mocks have left behind may point to one port that is gone.
    (tmp_path / "stale").symlink_to("/dev/pts/99999")
    (tmp_path / "old").symlink_to("/dev/pts/99999")
    assert parse_rig(text.format("stale", "old"), tmp_path / "rig.toml").devices


@pytest.mark.parametrize("port", ["udp:0.0.0.0:14550", "tcp:10.0.0.2:4001"])
def test_only_an_autopilot_may_have_a_network_address(port: str) -> None:
    row = '[[device]]\nname = "a"\nprotocol = "nmea"\nport = "{}"\nrate_hz = 5.0\n'
    text = 'format = "seatrial-rig 1"\nname = "x"\n' + row.format(port)
    with pytest.raises(SeatrialError, match=r"device\[1\]\.port: .* protocol nmea, not .*; only mavlink .* network"):
        parse_rig(text, "rig.toml")
    assert parse_rig(text, "rig.toml", recorded=True).devices[0].port == port  # a log stays readable


@pytest.mark.parametrize(
    "more",
    [f"x = {'[' * 20_000}", f"x = {'9' * 5_000}", f"[live]\nport = {'9' * 4_000}", f"[clock]\nspeed = {'9' * 4_000}"],
)
def test_a_rig_that_is_too_deep_or_too_long_gives_a_one_line_error(example: str, more: str) -> None:
    text = example.replace("[clock]\nspeed = 20.0", "") if "clock" in more else example
    with pytest.raises(SeatrialError) as caught:
        parse_rig(f"{text}\n{more}" if more[0] == "[" else f"{more}\n{text}", "rig.toml")
    assert len(str(caught.value)) < 300


@pytest.mark.timeout(10)
def test_a_named_pipe_in_place_of_a_rig_does_not_block_a_command(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "rig.toml")
    with pytest.raises(SeatrialError, match=r"rig\.toml: is not a file"):
        load_rig(tmp_path / "rig.toml")
    with pytest.raises(SeatrialError, match="Is a directory"):
        load_rig(tmp_path)
