"""Tests of the discovery of devices on real ptys. The devices send garbage to a host with the wrong baud rate."""

from __future__ import annotations

import contextlib
import json
import os
import random
import socket
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from click.testing import CliRunner
from pymavlink.dialects.v20.ardupilotmega import MAVLink

from seatrial.daq import cli
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.protocol import DEVICES, loadcell, nmea, openscale, slcan, ubx, vectornav, vesc
from seatrial.daq.protocol.framing import sentence
from seatrial.daq.samples import Ahrs, Esc, Gnss
from seatrial.daq.tools import autopilot_tables
from seatrial.daq.tools.discovery import _ProtocolCandidate, baud_rates, identify_protocol
from tests.daq.streams import COLD

SPEEDS = {9600: termios.B9600, 38400: termios.B38400, 115200: termios.B115200, 57600: termios.B57600}


def fix(k: int) -> Gnss:
    return Gnss(1.7e9 + 0.1 * k, 41.0, -8.7, 1.0, 0.5, 0.1, fix=3, n_sat=9)


def esc(k: int) -> bytes:
    return b"".join(slcan.encode(*frame) for frame in vesc.encode_status(Esc(1, 10.0 * k, 1.0, 0.1), 7))


def attitude(k: int) -> bytes:
    link = MAVLink(None, srcSystem=1, srcComponent=1)
    heartbeat = link.heartbeat_encode(11, 3, 0, 0, 3)  # a surface boat, ArduPilot, disarmed
    attitude_message = link.attitude_encode(20 * k, 0.01, 0.02, 0.5, 0.0, 0.0, 0.1)
    return b"".join(bytes(message.pack(link)) for message in (heartbeat, attitude_message))


SAYS: dict[str, tuple[int, Callable[[int], bytes]]] = {
    "vectornav": (115200, lambda k: vectornav.encode_binary(Ahrs(0.1, 0.0, 0.0, 0.0, 0.0, 0.0), 0.02 * k)),
    "nmea": (38400, lambda k: nmea.encode(fix(k))),
    "ubx": (9600, lambda k: nmea.encode(fix(k)) + ubx.encode(fix(k))),
    "loadcell": (57600, lambda k: loadcell.encode(84000 + k)),
    "openscale": (9600, lambda k: openscale.encode(0.5 + k, "kg", 100 * k)),
    "slcan": (115200, esc),
    "mavlink": (57600, attitude),
}


@contextlib.contextmanager
def device(baud: int, say: Callable[[int], bytes]) -> Iterator[str]:
    """Serve a device that sends every 20 ms. A host that listens at another baud rate gets garbage."""
    master, slave = os.openpty()
    tty.setraw(slave)
    os.set_blocking(master, False)
    ending = threading.Event()
    say(0)  # its modules are imported before a host listens

    def run() -> None:
        rng, k = random.Random(1), 0
        while not ending.wait(0.02):
            right = termios.tcgetattr(slave)[5] == SPEEDS[baud]
            with contextlib.suppress(BlockingIOError):
                os.write(master, say(k) if right else rng.randbytes(len(say(k))))
            k += 1

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield os.ttyname(slave)
    finally:
        ending.set()
        thread.join()
        os.close(master)
        os.close(slave)


@pytest.mark.parametrize("name", list(SAYS))
def test_a_device_is_recognised_with_its_baud_rate(name: str) -> None:
    baud, say = SAYS[name]
    with device(baud, say) as port:
        found = identify_protocol(port, bauds=(115200, 9600, 57600, 38400), listen=0.8)
    assert (found.protocol, found.baud) == (name, baud)
    assert 0.0 < found.rate < 200.0


@pytest.mark.parametrize(("name", "each"), [("nmea", 1), ("vectornav", 1), ("loadcell", 1), ("mavlink", 2)])
def test_the_rate_is_that_of_the_samples(name: str, each: int) -> None:
    """The last fix of a receiver is complete only when the next begins, or at the end."""
    ear = _ProtocolCandidate(name)
    for k in range(6):
        ear.feed(SAYS[name][1](k), 0.2 * k)
    ear.close()
    assert ear.rate() == pytest.approx(5.0 * each)


def test_transducers_do_not_change_the_rate_of_a_receiver() -> None:
    candidate = _ProtocolCandidate("nmea")
    for k in range(6):
        candidate.feed(nmea.encode(fix(k)) + sentence("IIXDR,C,40.5,C,OIL,P,1.5,B,FUEL"), 0.2 * k)
    candidate.close()
    assert candidate.samples == candidate.gnss == 6
    assert candidate.rate() == pytest.approx(5.0)


def test_a_rate_that_the_user_names_is_tried_with_every_protocol() -> None:
    baud = 9600  # no VectorNav has this rate by default
    assert baud not in DEVICES["vectornav"].bauds
    with device(baud, SAYS["vectornav"][1]) as port:
        found = identify_protocol(port, bauds=(baud,), listen=0.4)
    assert (found.protocol, found.baud) == ("vectornav", baud)


def test_a_receiver_without_a_fix_is_recognised() -> None:
    with device(9600, lambda k: COLD) as port:
        done = CliRunner().invoke(cli.devices, [port, "--baud", "9600", "--seconds", "0.4"])
    assert done.exit_code == 0, done.output
    assert "nmea at 9600 baud" in done.output
    assert "it sends data, but has no fix" in done.output


def test_valid_frames_without_a_sample_are_not_reported_as_a_wrong_baud_rate() -> None:
    """The receiver only lists satellites."""
    with device(9600, lambda k: sentence("GPGSV,1,1,00")) as port:
        found = identify_protocol(port, bauds=(9600,), listen=0.4)
    assert found.protocol == ""
    assert found.says.startswith("frames of vectornav at 9600 baud or nmea at 9600 baud")


def test_an_unknown_device_is_reported() -> None:
    with device(115200, lambda k: b"\x00\xf7 nothing of the kind") as port:
        found = identify_protocol(port, bauds=(115200, 9600), listen=0.2)
    message = "bytes of no known protocol at 115200, 9600 baud: check the output settings of the device, or give --baud"
    assert (found.protocol, found.says) == ("", message)
    assert "is not there" in identify_protocol("/dev/none", listen=0.1).says


def test_a_silent_port_is_tried_at_the_first_baud_rate_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("seatrial.daq.tools.discovery.SILENT_S", 0.1)
    with device(9600, lambda k: b"") as port:
        assert identify_protocol(port, listen=0.1).says.startswith("silent")


def test_all_baud_rates_of_the_table_are_tried() -> None:
    assert baud_rates()[0] == 115200
    assert set(baud_rates()) >= {4800, 9600, 38400, 57600, 115200, 460800, 921600}
    assert baud_rates((300,)) == [300]


@pytest.mark.parametrize("address", ["tcp:192.168.1.1", "udp:14550x", "udp:127.0.0.1:0"])
def test_an_invalid_address_is_wrong_usage(address: str) -> None:
    done = CliRunner().invoke(cli.devices, [address])
    assert done.exit_code == 2, done.output
    assert f"must be udp:HOST:PORT, udpin:HOST:PORT, udpout:HOST:PORT or tcp:HOST:PORT, not '{address}'" in done.output


def test_the_devices_command_writes_the_tables_of_a_rig_file(tmp_path: Path) -> None:
    baud, say = SAYS["nmea"]
    with device(baud, say) as port:
        done = CliRunner().invoke(
            cli.devices, [port, "--baud", "9600", "--baud", "38400", "--seconds", "0.4", "--toml"]
        )
    assert done.exit_code == 0, done.output
    rig = parse_rig(done.output, tmp_path / "rig.toml")
    assert (rig.devices[0].protocol, rig.devices[0].baud, rig.devices[0].port) == ("nmea", 38400, port)


def test_the_devices_command_prints_json_alone() -> None:
    baud, say = SAYS["nmea"]
    with device(baud, say) as port:
        words = [port, "--baud", "38400", "--seconds", "0.4", "--json"]
        found = json.loads(CliRunner().invoke(cli.devices, words, catch_exceptions=False).stdout)
    assert found["format"] == "seatrial-devices 1"
    (only,) = found["devices"]
    assert (only["port"], only["protocol"], only["baud"]) == (port, "nmea", 38400)
    assert only["rate"] is None or only["rate"] > 0.0
    assert CliRunner().invoke(cli.devices, ["--json", "--toml"]).exit_code == 2


def test_a_device_that_sends_once_has_no_rate() -> None:
    """All its samples have the same time of arrival. An earlier version printed a rate of nan."""
    burst = b"".join(nmea.encode(fix(k)) for k in range(4))
    with device(38400, lambda k: burst if k == 10 else b"") as path:
        words = [path, "--baud", "38400", "--seconds", "0.6"]
        output = CliRunner().invoke(cli.devices, words, catch_exceptions=False).output
    assert f"{path}: nmea at 38400 baud: " in output
    assert "nan" not in output


def test_a_dead_address_gives_an_error_and_no_rig_file(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(autopilot_tables, "LISTEN_S", 0.3)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = f"udp:127.0.0.1:{free.getsockname()[1]}"
    result = CliRunner().invoke(cli.devices, [address, "--toml"])
    assert result.stdout == ""
    assert isinstance(result.exception, SeatrialError)
    assert str(result.exception) == (
        f"no device was recognised at {address}; check host and port of the address, that the autopilot is powered, "
        "and that it sends there"
    )
