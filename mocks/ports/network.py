"""Ports of a mock on loopback UDP and TCP, with the same methods as the ptys of seatrial.mocks.ports.pty."""

from __future__ import annotations

import contextlib
import ipaddress
import socket
from typing import Any

from seatrial.daq.errors import SeatrialError

READ_MAX = 1 << 16  # bytes
BACKLOG_MAX = 1 << 20  # bytes that wait for a slow reader; more are dropped


class NetPort:
    """Port of a mock device by UDP or TCP on loopback: the device's end of `udp:`, `udpin:`, `udpout:` or `tcp:`.

    With `udp:` and `udpin:` the host listens at the address, and the device sends first. With `udpout:` and `tcp:` the
    device listens, and the host sends or connects first.

    Attributes
    ----------
    path : str
        Address as in the rig file.
    dropped : int
        Number of bytes that were lost because no host received them. Bytes are not counted while the port is not
        plugged, and with `udpout:` before the host has sent a datagram. Nor are those that wait for a TCP host when it
        leaves or the port is unplugged.
    """

    def __init__(self, port: str) -> None:
        """Open the network port of a mock device.

        Parameters
        ----------
        port : str
            Address as in the rig file, for example `udp:127.0.0.1:14550`.

        Raises
        ------
        SeatrialError
            If the address is neither `localhost` nor a numeric address on the loopback of this machine, or the port
            cannot be opened.
        """
        kind, _, address = port.partition(":")
        host, _, number = address.rpartition(":")
        self.dropped = 0
        self._kind, self._address, self.path = kind, (host.strip("[]"), int(number)), port
        self._socket: socket.socket | None = None  # UDP socket, or TCP socket that accepts the client
        self._client: socket.socket | None = None  # TCP connection of the host
        self._peer: Any = None
        self._backlog = bytearray()
        if self._address[0] != "localhost" and not _is_loopback(self._address[0]):
            raise SeatrialError(
                f"{port}: a mock serves only addresses of this computer; give the rig 127.0.0.1 in place of this one"
            )
        self.plug()

    @property
    def plugged(self) -> bool:
        """Whether the network port is open: between `plug` and `unplug`."""
        return self._socket is not None

    def plug(self) -> None:
        """Open the socket of the port, which must not be plugged. A TCP port then waits for one host.

        Raises SeatrialError if the system refuses, for example if the address is in use.
        """
        family = socket.AF_INET6 if ":" in self._address[0] else socket.AF_INET
        sock = socket.socket(family, socket.SOCK_STREAM if self._kind == "tcp" else socket.SOCK_DGRAM)
        try:
            if self._kind in ("tcp", "udpout"):
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, self._kind == "tcp")
                sock.bind(self._address)
            else:
                self._peer = self._address
            if self._kind == "tcp":
                sock.listen(1)
        except OSError as error:
            sock.close()
            raise SeatrialError(
                f"{self.path}: {error.strerror}; end the program that uses this port (another mock?), or give the rig "
                "another port"
            ) from error
        sock.setblocking(False)
        self._socket = sock

    def unplug(self) -> None:
        """Close the sockets and drop waiting bytes, as if the link were cut. `plug` opens the port again."""
        for sock in (self._client, self._socket):
            if sock is not None:
                sock.close()
        self._client = self._socket = None
        self._backlog.clear()
        if self._kind == "udpout":
            self._peer = None

    def close(self) -> None:
        """Close the sockets of the port at the end of the mock."""
        self.unplug()

    def fileno(self) -> int:
        """Return the file descriptor by which `select` waits for bytes of the host.

        For TCP it is that of the connection if a host is connected. The port must be plugged.
        """
        current = self._client or self._socket
        assert current is not None
        return current.fileno()

    def read(self) -> bytes:
        """Return the bytes that the host has sent since the last call; empty without any. The call never blocks.

        A UDP port stores the sender of the newest datagram, to which `write` then sends. A TCP port accepts a host that
        connects, in a call that returns no bytes, and closes the connection of a host that has left. The port must be
        plugged.
        """
        if self._kind == "tcp":
            return self._read_stream()
        assert self._socket is not None
        datagrams = []
        with contextlib.suppress(OSError):  # no datagram is left, or the host does not listen yet
            while True:
                data, sender = self._socket.recvfrom(READ_MAX)
                self._peer = sender
                datagrams.append(data)
        return b"".join(datagrams)

    def _read_stream(self) -> bytes:
        """Return the bytes that a TCP port has received; empty if there are none or no host is connected.

        Without a connection, that of a waiting host is accepted, and its bytes are returned by the next call. If the
        host has left, its connection is closed, and the bytes that wait for it are dropped.
        """
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
        """Send ``data`` to the host. The call never blocks.

        The bytes are dropped if the port is not plugged or no host receives them. Bytes of a TCP port may wait for a
        slow host. ``wall`` is the monotonic time [s], which has no effect here.
        """
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
            except OSError:  # the host does not listen
                self.dropped += len(data)

    def flush(self, wall: float) -> None:
        """Send the bytes of a TCP port that wait for a slow host, as far as possible without blocking.

        If more than 1 MiB (BACKLOG_MAX) still wait, they are dropped. Other ports have no waiting bytes. ``wall`` is
        not used.
        """
        if self._client is None or not self._backlog:
            return
        with contextlib.suppress(OSError):
            del self._backlog[: self._client.send(self._backlog)]
        if len(self._backlog) > BACKLOG_MAX:
            self.dropped += len(self._backlog)
            self._backlog.clear()


def _is_loopback(host: str) -> bool:
    """Return whether a host is a numeric address on the loopback of this computer; False for a name."""
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return False
