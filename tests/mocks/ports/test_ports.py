"""Tests of mock ports: they appear, vanish and return, wait for slow readers, and keep no old bytes for late ones."""

from __future__ import annotations

import fcntl
import os
import struct
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest
import serial

from seatrial.daq.errors import SeatrialError
from seatrial.mocks.ports.network import NetPort
from seatrial.mocks.ports.pty import CHECK, PATIENCE, PtyPort


@pytest.mark.parametrize("host", ["boat.local", "192.168.2.1", "[2001:db8::1]"])
def test_a_network_port_of_another_computer_is_refused(host: str) -> None:
    with pytest.raises(SeatrialError, match="a mock serves only addresses of this computer"):
        NetPort(f"udpout:{host}:14550")


@pytest.fixture
def port(tmp_path: Path) -> Iterator[PtyPort]:
    port = PtyPort(tmp_path / "ports" / "ahrs")
    yield port
    port.close()


def opened(port: PtyPort, timeout: float = 5.0) -> serial.Serial:
    return serial.Serial(str(port.path), 115200, timeout=timeout)


def test_bytes_go_both_ways_unchanged(port: PtyPort) -> None:
    every = bytes(range(256))
    with opened(port) as host:
        port.write(every, 1.0)
        assert host.read(256) == every
        host.write(every)
        host.flush()
        received = b""
        while len(received) < 256:
            received += port.read()
        assert received == every
        assert port.read() == b""


def test_a_pulled_port_hangs_up_and_returns(port: PtyPort) -> None:
    with opened(port) as host:
        port.unplug()
        assert not os.path.lexists(port.path)
        with pytest.raises((serial.SerialException, OSError, termios.error)):
            host.read(1)
    port.write(b"lost", 0.0)
    port.plug()
    with opened(port) as host:
        port.write(b"back", 1.0)
        assert host.read(4) == b"back"


def test_close_removes_all_ports(tmp_path: Path) -> None:
    port = PtyPort(tmp_path / "gnss")
    port.close()
    assert list(tmp_path.iterdir()) == []


def test_a_dead_mocks_link_is_replaced(tmp_path: Path) -> None:
    (tmp_path / "can").symlink_to("/dev/pts/nowhere")
    port = PtyPort(tmp_path / "can")
    with opened(port) as host:
        port.write(b"x", 1.0)
        assert host.read(1) == b"x"
    port.close()


def test_another_mock_on_the_same_port_is_refused(port: PtyPort) -> None:
    with pytest.raises(SeatrialError, match="another mock serves this port"):
        PtyPort(port.path)


def test_a_real_file_is_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "ahrs").write_text("precious")
    with pytest.raises(SeatrialError, match="is not the port of a mock"):
        PtyPort(tmp_path / "ahrs")
    assert (tmp_path / "ahrs").read_text() == "precious"
    assert [path.name for path in tmp_path.iterdir()] == ["ahrs"]


def test_a_slow_reader_receives_all_bytes(port: PtyPort) -> None:
    sent = os.urandom(50_000)
    with opened(port) as host:
        port.write(b"hello", 1.0)
        assert host.read(5) == b"hello"
        for at in range(0, len(sent), 500):
            port.write(sent[at : at + 500], wall=2.0 + 1e-3 * at / 500)
        got = host.read(1000)
        while len(got) < len(sent):
            port.flush(1.0)
            got += host.read(min(2000, len(sent) - len(got)))
    assert got == sent
    assert port.dropped == 0


class Watcher:
    """Host end of a port, opened without reading. It reports the number of unread bytes."""

    def __init__(self, port: PtyPort) -> None:
        self._fd = os.open(port.path, os.O_RDWR | os.O_NOCTTY)

    def __enter__(self) -> Watcher:
        return self

    def __exit__(self, *_: object) -> None:
        os.close(self._fd)

    @property
    def unread(self) -> int:
        found: int = struct.unpack("i", fcntl.ioctl(self._fd, termios.FIONREAD, b"\0\0\0\0"))[0]
        return found

    def read(self) -> bytes:
        return os.read(self._fd, 4096)

    def awaits(self, count: int) -> None:
        """Wait until ``count`` bytes are unread, because the kernel moves them with a delay."""
        deadline = time.monotonic() + 5.0
        while self.unread != count:
            assert time.monotonic() < deadline


def test_without_a_reader_only_one_write_is_kept(port: PtyPort) -> None:
    with Watcher(port) as late:
        for k in range(100):
            port.write(b"%06d\n" % k, wall=1.0 + CHECK * k)
            late.awaits(7)
        assert port.dropped == 99 * 7
        assert late.read() == b"000099\n"
        port.write(b"000100\n", wall=10.0)  # the bytes have been read, so a reader is present
        port.write(b"000101\n", wall=10.001)
        late.awaits(14)
        assert late.read() == b"000100\n000101\n"


def test_a_reader_that_closes_the_port_is_noticed(port: PtyPort) -> None:
    with opened(port) as host:
        port.write(b"seen", 1.0)
        assert host.read(4) == b"seen"
        port.write(b"seen", 2.0)
        assert host.read(4) == b"seen"
    with Watcher(port) as late:
        for k in range(60):
            before, dropped = late.unread, port.dropped
            port.write(b"%06d\n" % k, wall=3.0 + CHECK * k)
            late.awaits(before + 7 - (port.dropped - dropped))
        assert late.read() == b"000059\n"
    assert PATIENCE < 60 * CHECK


def test_a_request_of_the_host_is_answered_at_once(port: PtyPort) -> None:
    with opened(port) as host:
        port.write(b"probe", 1.0)
        assert host.read(5) == b"probe"
        host.write(b"V\r")
        host.flush()
        while not port.read():
            pass
        port.write(b"V1013\r", 1.001)
        assert host.read(6) == b"V1013\r"
