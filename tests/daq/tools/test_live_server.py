"""Tests of the live view from a client: a separate WebSocket implementation on loopback receives the messages of the
log.
"""

from __future__ import annotations

import importlib.util
import json
import math
import os
import socket
import struct
import sys
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from seatrial.daq.acquisition.status import Latest, Status
from seatrial.daq.config.rig_file import parse_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import schema
from seatrial.daq.log.cdr import cdr_layout
from seatrial.daq.rig import Live, Rig
from seatrial.daq.samples import Ahrs, Gnss
from seatrial.daq.tools.live_server import LiveServer
from tests.daq.logs import RIG, T0

needs_foxglove = pytest.mark.skipif(
    importlib.util.find_spec("foxglove") is None, reason="foxglove-sdk is not installed"
)


def rig(host: str = "127.0.0.1", port: int = 0) -> Rig:
    return replace(parse_rig(RIG, Path("rig.toml")), live=Live(host, port))


def status(t: float) -> Status:
    latest = {
        ("ahrs", None): Latest(Ahrs(0.5, 0.0, 0.0, r=0.25), t),
        # like a device with several kinds of samples
        ("autopilot/gnss", None): Latest(Gnss(math.nan, 50.0, 8.0, fix=3), t),
    }
    return Status(t, {}, latest, {}, 0, "run.mcap", 0, 0, 0.0, "", ())


class Client:
    """Minimal client of RFC 6455 that receives messages."""

    def __init__(self, port: int, origin: bytes = b"") -> None:
        self._socket = socket.create_connection(("127.0.0.1", port), timeout=10.0)
        self._socket.sendall(
            b"GET / HTTP/1.1\r\nHost: x\r\n"
            + origin
            + b"Upgrade: websocket\r\nConnection: Upgrade\r\nSec-WebSocket-Version: 13\r\n"
            b"Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Protocol: foxglove.sdk.v1\r\n\r\n"
        )
        self._buffer = b""
        while b"\r\n\r\n" not in self._buffer:
            self._buffer += self._socket.recv(4096)
        head, _, self._buffer = self._buffer.partition(b"\r\n\r\n")
        if b" 403 " in head.splitlines()[0]:
            self.close()
            raise PermissionError
        assert b" 101 " in head.splitlines()[0]

    def _take(self, size: int) -> bytes:
        while len(self._buffer) < size:
            data = self._socket.recv(65536)
            assert data, "the server has closed"
            self._buffer += data
        out, self._buffer = self._buffer[:size], self._buffer[size:]
        return out

    def messages(self) -> Iterator[tuple[int, bytes]]:
        """Yield opcode (1 text, 2 binary) and content."""
        while True:
            first, second = self._take(2)
            size = second & 0x7F
            if size >= 126:
                size = int.from_bytes(self._take(2 if size == 126 else 8), "big")
            yield first & 0x0F, self._take(size)

    def send(self, text: str) -> None:
        data, mask = text.encode(), os.urandom(4)
        head = struct.pack("!BBH", 0x81, 0x80 | 126, len(data)) + mask
        self._socket.sendall(head + bytes(b ^ mask[k % 4] for k, b in enumerate(data)))

    def close(self) -> None:
        self._socket.close()


@needs_foxglove
def test_a_client_gets_the_messages_of_the_log() -> None:
    with LiveServer(rig(), lambda: status(time.time())) as server:  # a new sample each time
        assert server.address.startswith("ws://127.0.0.1:")
        client = Client(int(server.address.rpartition(":")[2]))
        try:
            channels: dict[str, dict[str, Any]] = {}
            for opcode, data in client.messages():
                announced = json.loads(data) if opcode == 1 else {}
                channels |= {c["topic"]: c for c in announced.get("channels", [])}
                if {topic.rpartition("/")[2] for topic in channels} >= {"imu", "gnss", "fix"}:
                    break
            assert channels.keys() >= {"/ahrs/imu", "/autopilot/gnss", "/autopilot/fix"}
            channel = channels["/ahrs/imu"]
            assert (channel["encoding"], channel["schemaName"]) == ("cdr", schema.IMU)
            subscription = json.dumps({"op": "subscribe", "subscriptions": [{"id": 7, "channelId": channel["id"]}]})
            client.send(subscription)
            binary = b""
            for opcode, data in client.messages():
                if opcode == 2:
                    binary = data
                    break
                if json.loads(data).get("op") == "status":  # announced shortly before a client can subscribe to it
                    client.send(subscription)
        finally:
            client.close()
    row = cdr_layout(schema.IMU, b"ahrs_frd_ned").dtype
    assert len(binary[13:]) >= row.itemsize
    (imu,) = np.frombuffer(binary[13 : 13 + row.itemsize], row)
    assert imu["angular_velocity.z"] == 0.25
    assert math.isclose(2.0 * math.atan2(imu["orientation.z"], imu["orientation.w"]), 0.5)


@needs_foxglove
def test_a_browser_gets_a_page_that_explains_the_port() -> None:
    """An earlier version sent a browser an empty response."""
    with LiveServer(rig(), lambda: status(time.time())) as server:
        port = int(server.address.rpartition(":")[2])
        with socket.create_connection(("127.0.0.1", port), timeout=10.0) as browser:
            browser.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\nConnection: keep-alive\r\n\r\n")
            answer = b""
            while part := browser.recv(4096):
                answer += part
        head, _, page = answer.partition(b"\r\n\r\n")
        assert head.startswith(b"HTTP/1.1 426 ")
        assert f"Content-Length: {len(page)}\r\n".encode() in head
        assert f"ws://127.0.0.1:{port}<".encode() in page
        assert b"seatrial log RIG --view" in page
        with socket.create_connection(("127.0.0.1", port), timeout=10.0) as foreign:
            foreign.sendall(b"GET / HTTP/1.1\r\nHost: x\r\nOrigin: https://evil.example\r\n\r\n")
            assert b" 403 " in foreign.recv(4096).splitlines()[0]
        Client(port).close()


@needs_foxglove
def test_a_page_of_a_foreign_site_is_refused() -> None:
    with LiveServer(rig(), lambda: status(time.time())) as server:
        port = int(server.address.rpartition(":")[2])
        for origin in (
            "https://evil.example",
            "null",
            "http://localhost.evil.example",
            "http://127.0.0.1:1@evil.example",
        ):
            for header in (
                f"Origin: {origin}\r\n",
                f"oRiGiN:{origin} \r\n",
                f"Origin: http://localhost\r\norigin: {origin}\r\n",
            ):
                with pytest.raises(PermissionError):
                    Client(port, header.encode())
        for origin in ("https://app.foxglove.dev", "http://localhost:8080", "file://"):
            Client(port, f"Origin: {origin}\r\n".encode()).close()
        with socket.create_connection(("127.0.0.1", port), timeout=5.0) as quiet:  # a silent client blocks no other
            Client(port).close()
            quiet.sendall(b"\r\n\r\n")


def connected(port: int) -> Iterator[socket.socket | Client]:
    """Open connections of every kind: a client, a silent one, a closed one, a reset one, and one with garbage."""
    yield Client(port)
    yield socket.create_connection(("127.0.0.1", port))
    gone = Client(port)
    gone.close()
    yield gone
    reset = socket.create_connection(("127.0.0.1", port))
    reset.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    reset.close()
    yield reset
    garbage = socket.create_connection(("127.0.0.1", port))
    garbage.sendall(b"x" * 100_000)
    yield garbage


@needs_foxglove
@pytest.mark.parametrize("turns", [0, 1])
def test_the_end_of_the_server_prints_no_output(
    turns: int, caplog: pytest.LogCaptureFixture, capfd: pytest.CaptureFixture[str]
) -> None:
    """Neither output nor log messages may appear, for any kind of connection."""
    with LiveServer(rig(), lambda: status(time.time())) as server:
        there = list(connected(int(server.address.rpartition(":")[2])))
        time.sleep(0.2 * turns)
    assert [record.getMessage() for record in caplog.records if record.name == "asyncio"] == []
    assert capfd.readouterr().err == ""
    for connection in there:
        connection.close()


@needs_foxglove
def test_a_port_in_use_gives_a_one_line_error() -> None:
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        server = LiveServer(rig(port=taken.getsockname()[1]), lambda: status(T0))
        with pytest.raises(SeatrialError, match="the live view cannot listen there"), server:
            pass


def test_missing_library_gives_a_one_line_error(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "foxglove", None)
    with pytest.raises(SeatrialError, match=r"pip install 'seatrial\[live\]'"), LiveServer(rig(), lambda: status(T0)):
        pass


def test_the_server_listens_on_loopback_unless_the_rig_sets_a_host(tmp_path: Path) -> None:
    assert parse_rig(RIG, tmp_path / "rig.toml").live == Live("127.0.0.1", 8765)
    text = RIG.replace("[[device]]", '[live]\nhost = "0.0.0.0"\nport = 9000\n\n[[device]]', 1)
    assert parse_rig(text, tmp_path / "rig.toml").live == Live("0.0.0.0", 9000)
    more = text.replace("9000", '9000\norigins = ["http://boat.local"]')
    assert parse_rig(more, tmp_path / "rig.toml").live.origins == ("http://boat.local",)
    with pytest.raises(SeatrialError, match=r"live\.port: must be within 0 \.\. 65535"):
        parse_rig(text.replace("9000", "90000"), tmp_path / "rig.toml")
