"""Tests of ports that cannot be opened or are lost: one line each, with the behaviour of the operating system."""

from __future__ import annotations

import os
import select
import tty
from pathlib import Path

import pytest

from seatrial.daq.protocol import slcan
from seatrial.daq.protocol.canframe import pack_can
from seatrial.daq.transport.base import PortError
from seatrial.daq.transport.can_port import REFUSED, SlcanPort, SocketCanPort
from seatrial.daq.transport.serial_port import SerialPort
from tests.daq.ptys import Pty, wait_for


def heard(pty: Pty, count: int) -> bytes:
    """Return the first `count` bytes that the host wrote."""

    def enough() -> bool:
        pty.read()
        return len(pty.received) >= count

    wait_for(enough)
    return bytes(pty.received)


def test_a_missing_port_is_reported(tmp_path: Path) -> None:
    with pytest.raises(PortError, match=r"^the port is not there; plug the device in"):
        SerialPort(str(tmp_path / "nothing"), 9600).open()


def test_a_regular_file_is_not_accepted_as_a_port(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("mine")
    with pytest.raises(PortError, match="is not a serial device"):
        SerialPort(str(tmp_path / "file"), 9600).open()
    assert (tmp_path / "file").read_text() == "mine"
    with pytest.raises(PortError, match=r"^the port is not a serial device; give its device file"):
        SerialPort("/dev/null", 9600).open()


def test_a_port_in_use_by_another_program_is_reported(tmp_path: Path) -> None:
    pty = Pty(tmp_path / "port")
    first, second = SerialPort(str(pty.path), 9600), SerialPort(str(pty.path), 9600)
    first.open()
    with pytest.raises(PortError, match="in use by another program"):
        second.open()
    first.close()
    second.open()
    second.close()
    pty.pull()


def test_bytes_pass_unchanged_both_ways(tmp_path: Path) -> None:
    pty = Pty(tmp_path / "port")
    port = SerialPort(str(pty.path), 115200)
    port.open()
    everything = bytes(range(256))
    pty.write(everything)
    assert select.select([port.fileno()], [], [], 5.0)[0]
    assert port.read() == everything
    port.write(everything)
    assert heard(pty, 256) == everything
    assert port.bytes_in == 256
    port.close()
    pty.pull()


def test_a_hang_up_is_detected_and_closing_raises_no_error(tmp_path: Path) -> None:
    pty = Pty(tmp_path / "port")
    port = SerialPort(str(pty.path), 9600)
    port.open()
    pty.pull()
    assert select.select([port.fileno()], [], [], 5.0)[0]
    with pytest.raises(PortError, match="disconnected"):
        port.read()
    with pytest.raises(PortError, match="disconnected"):
        port.write(b"x")
    port.close()
    port.close()


def test_a_port_that_accepts_no_bytes_is_reported(tmp_path: Path) -> None:
    master, slave = os.openpty()
    tty.setraw(slave)
    port = SerialPort(os.ttyname(slave), 9600)
    port.open()
    with pytest.raises(PortError, match="accepts no more bytes"):
        port.write(bytes(1 << 20))
    port.close()
    os.close(slave)
    os.close(master)


def test_an_slcan_adapter_is_opened_and_closed(tmp_path: Path) -> None:
    pty = Pty(tmp_path / "can")
    port = SlcanPort(str(pty.path), 115200, 250_000)
    port.open()
    pty.write(b"\r\r" + slcan.encode(0x901, bytes(8)) + b"junk\r" + slcan.encode(0x902, b"")[:4])
    assert select.select([port.fileno()], [], [], 5.0)[0]
    assert port.read() == pack_can(0x901, bytes(8))
    assert port.unparsed_bytes == 4
    pty.write(slcan.encode(0x902, b"")[4:])
    assert select.select([port.fileno()], [], [], 5.0)[0]
    assert port.read() == pack_can(0x902, b"")
    port.write(pack_can(1, b"\x00\x00\xc3\x50") + pack_can(2, b""))
    port.close()
    expected = b"\rC\rS5\rO\rT0000000140000C350\rT000000020\rC\r"
    assert heard(pty, len(expected)) == expected
    pty.pull()


@pytest.mark.parametrize(
    ("answers", "refused"),
    [
        (b"\r\a\r\r", False),  # an earlier session has closed it
        (b"\r\r\r\r", False),
        (b"\a\r\rT000009010\r", False),  # no answer to an empty line
        (b"T000009010\r\a\r\rz\rT000009010\r", False),  # a frame from before, and the answer to a frame
        (b"T000009010\rT000009020\r", False),  # an adapter that sends no answers
        (b"\r\a\a\r", True),
        (b"\r\a\r\a", True),
        (b"\a\a\r\r", False),  # neither an empty line nor closing a closed channel is an error
        (b"\r\a\rT000009010\r", True),
    ],
)
def test_an_adapter_that_refuses_the_bit_rate_is_named(tmp_path: Path, answers: bytes, refused: bool) -> None:
    pty = Pty(tmp_path / "can")
    port = SlcanPort(str(pty.path), 115200, 250_000)
    port.open()
    for at in range(len(answers)):
        pty.write(answers[at : at + 1])
        assert select.select([port.fileno()], [], [], 5.0)[0]
        port.read()
    assert ("refused the bit rate 250000" in port.hint) == refused
    port.close()
    pty.pull()


@pytest.mark.parametrize(
    ("answers", "raises"),
    [
        (b"\a" * REFUSED, True),
        (b"\a" * (REFUSED - 1), False),
        (b"\a" * (REFUSED - 1) + b"Z\r" + b"\a" * (REFUSED - 1), False),
        (b"\a" * (REFUSED - 1) + b"z\r" + b"\a" * (REFUSED - 1), False),
        (b"\a" * (REFUSED - 1) + b"\r" + b"\a" * (REFUSED - 1), False),  # an empty line also means yes
        (b"T000009010\r\a" * REFUSED, True),  # frames received between the answers are not answers
        (b"", False),
    ],
)
@pytest.mark.parametrize("at_once", [True, False])
def test_an_adapter_that_refuses_every_frame_is_a_lost_port(
    tmp_path: Path, answers: bytes, raises: bool, at_once: bool
) -> None:
    pty = Pty(tmp_path / "can")
    port = SlcanPort(str(pty.path), 115200, 250_000)
    port.open()
    pty.write(b"\a" * 2)  # answers to the empty line and to closing: no frame was sent yet
    assert select.select([port.fileno()], [], [], 5.0)[0]
    port.read()
    port.write(pack_can(1, b""))
    refusal = ""
    for part in [answers] if at_once else [answers[k : k + 1] for k in range(len(answers))]:
        if not part:
            continue
        pty.write(part)
        assert select.select([port.fileno()], [], [], 5.0)[0]
        try:
            port.read()
        except PortError as error:
            refusal = str(error)
    assert refusal.startswith(f"the adapter refused {REFUSED} frames in a row (BELL)") == raises
    port.close()
    pty.pull()


def test_a_bit_rate_that_slcan_lacks_is_refused(tmp_path: Path) -> None:
    pty = Pty(tmp_path / "can")
    with pytest.raises(PortError, match="no bit rate 42"):
        SlcanPort(str(pty.path), 115200, 42).open()
    pty.pull()


def test_a_missing_can_interface_is_reported() -> None:
    port = SocketCanPort("nothing0")
    with pytest.raises(PortError) as caught:
        port.open()
    assert "\n" not in str(caught.value)
    port.close()
