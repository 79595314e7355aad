"""Ports of a mock on loopback UDP and TCP, with the same face as the ptys of seatrial.mocks.ports.pty."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
from typing import Any

from seatrial.daq.errors import SeatrialError

READ_MAX = 1 << 16
BACKLOG_MAX = 1 << 20


class NetPort:
    """The far end of a rig's `udp:`, `udpin:`, `udpout:` or `tcp:` port; on loopback only."""

    def __init__(self, port: str) -> None:
        """`port` as in the rig. Raises SeatrialError for an address that is not this machine's loopback."""
        kind, _, address = port.partition(":")
        host, _, number = address.rpartition(":")
        self.dropped = 0  # bytes that nobody was there to take
        self._kind, self._where, self.path = kind, (host.strip("[]"), int(number)), port
        self._socket: socket.socket | None = None  # datagrams, or what listens
        self._client: socket.socket | None = None  # TCP
        self._peer: Any = None
        self._backlog = bytearray()
        if self._where[0] != "localhost" and not ipaddress.ip_address(self._where[0]).is_loopback:
            raise SeatrialError(f"{port}: a mock serves loopback only; give the rig an address such as 127.0.0.1")
        self.plug()

    @property
    def plugged(self) -> bool:
        """Whether the port is there."""
        return self._socket is not None

    def plug(self) -> None:
        """Open the socket."""
        family = socket.AF_INET6 if ":" in self._where[0] else socket.AF_INET
        sock = socket.socket(family, socket.SOCK_STREAM if self._kind == "tcp" else socket.SOCK_DGRAM)
        try:
            if self._kind in ("tcp", "udpout"):
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, self._kind == "tcp")
                sock.bind(self._where)
            else:
                self._peer = self._where
            if self._kind == "tcp":
                sock.listen(1)
        except OSError as error:
            sock.close()
            raise SeatrialError(f"{self.path}: {error.strerror}; does another mock serve this port?") from error
        sock.setblocking(False)
        self._socket = sock

    def unplug(self) -> None:
        """The link is cut."""
        for sock in (self._client, self._socket):
            if sock is not None:
                sock.close()
        self._client = self._socket = None
        self._backlog.clear()
        if self._kind == "udpout":
            self._peer = None

    def close(self) -> None:
        """Unplug for good."""
        self.unplug()

    def fileno(self) -> int:
        """For select; only while plugged."""
        current = self._client or self._socket
        assert current is not None
        return current.fileno()

    def read(self) -> bytes:
        """What the host has sent."""
        if self._kind == "tcp":
            return self._read_stream()
        assert self._socket is not None
        parts = []
        with contextlib.suppress(OSError):  # nothing more, or nobody listens there yet
            while True:
                data, sender = self._socket.recvfrom(READ_MAX)
                self._peer = sender
                parts.append(data)
        return b"".join(parts)

    def _read_stream(self) -> bytes:
        assert self._socket is not None
        if self._client is None:
            with contextlib.suppress(BlockingIOError):
                self._client, _ = self._socket.accept()
                self._client.setblocking(False)
            return b""
        try:
            data = self._client.recv(READ_MAX)
        except BlockingIOError:
            return b""
        except OSError:
            data = b""
        if not data:
            self._client.close()
            self._client = None
            self._backlog.clear()
        return data

    def write(self, data: bytes, wall: float) -> None:
        """Send to the host. Never blocks."""
        if not (self.plugged and data):
            return
        if self._kind == "tcp":
            self._backlog += data if self._client is not None else b""
            self.dropped += 0 if self._client is not None else len(data)
            self.flush(wall)
        elif self._peer is not None:
            assert self._socket is not None
            try:
                self._socket.sendto(data, self._peer)
            except OSError:  # nobody listens there
                self.dropped += len(data)

    def flush(self, wall: float) -> None:
        """Send what waits."""
        if self._client is None or not self._backlog:
            return
        with contextlib.suppress(OSError):
            del self._backlog[: self._client.send(self._backlog)]
        if len(self._backlog) > BACKLOG_MAX:
            self.dropped += len(self._backlog)
            self._backlog.clear()
