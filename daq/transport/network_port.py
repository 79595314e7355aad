"""Ports on a network: UDP and TCP.

udpin (and udp) listens at a local address and answers the first sender of a frame that is the device's (`confirm`); it
changes to another address only when none has come from there for a while, so that neither a stray byte nor a second
program can take over the link. udpout sends to an address, tcp connects to one. UDP has no hang-up: a lost sender is
detected by its silence.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import time
from typing import Any

from seatrial.daq.transport.base import WRITE_S, Port, PortError, os_error_text

READ_BYTES = 65536
MOST = 256  # datagrams a read: a flood must not keep the thread from its set-points
SILENT_S = 2.0  # wall; the first sender keeps the link until it is silent for this long
CONNECT_S = 2.0  # wall
BUFFER_BYTES = 1 << 20  # for bursts while this process waits for its turn


def _resolve(host: str, number: int, kind: socket.SocketKind, passive: bool) -> tuple[socket.AddressFamily, Any]:
    flags = socket.AI_PASSIVE if passive else 0
    try:
        family, _, _, _, address = socket.getaddrinfo(host, number, type=kind, flags=flags)[0]
    except OSError as error:
        raise PortError(f"no address {host}:{number}: {os_error_text(error)}") from error
    return family, address


class UdpPort(Port):
    """Datagrams, joined to a stream of bytes: MAVLink puts whole frames into each."""

    def __init__(self, host: str, number: int, listen: bool) -> None:
        super().__init__()
        self._host, self._number, self._listen = host, number, listen
        self._socket: socket.socket | None = None
        self._peer: Any = None
        self._candidate: Any = None  # who sent the last read, before a frame of it was found to be the device's
        self._heard = 0.0

    def open(self) -> None:
        """Bind or connect."""
        self._open(beside=False)

    def take_over(self) -> None:
        """Bind beside the process that has it bound, which a killed one has until its memory is returned: the newest
        gets what arrives."""
        self._open(beside=True)

    def _open(self, beside: bool) -> None:
        self.close()
        family, address = _resolve(self._host, self._number, socket.SOCK_DGRAM, self._listen)
        sock = socket.socket(family, socket.SOCK_DGRAM)
        try:
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            if self._listen:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, beside)
                sock.bind(address)
                # From now on who asks for it may bind beside this one: not who does so by mistake, but the watchdog.
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, True)
            else:
                sock.connect(address)
        except OSError as error:
            sock.close()
            raise PortError(os_error_text(error)) from error
        self._socket, self._peer = sock, None if self._listen else address

    def fileno(self) -> int:
        """The file descriptor to wait on."""
        return -1 if self._socket is None else self._socket.fileno()

    def read(self) -> bytes:
        """Bytes received from the present sender; without one a single datagram, of whoever sent it."""
        assert self._socket is not None
        parts: list[bytes] = []
        open_to_others = self._listen and (self._peer is None or time.monotonic() - self._heard >= SILENT_S)
        self._candidate = None
        for _ in range(1 if open_to_others else MOST):
            try:
                data, sender = self._socket.recvfrom(READ_BYTES)
            except BlockingIOError:
                break
            except ConnectionRefusedError:  # the answer to a datagram of ours: no program listens there yet
                continue
            except OSError as error:
                raise PortError(os_error_text(error)) from error
            self.bytes_in += len(data)
            if open_to_others:
                self._candidate = sender
            elif self._listen and sender != self._peer:
                self.unparsed_bytes += len(data)
                continue
            parts.append(data)
        return b"".join(parts)

    @property
    def is_confirmed(self) -> bool:
        """Whether the bytes of the last read came from the present sender."""
        return self._candidate is None or self._candidate == self._peer

    def confirm(self) -> None:
        """The sender of the last read is the one to answer."""
        if self._candidate is not None:
            self._peer = self._candidate
        self._heard = time.monotonic()

    def write(self, data: bytes) -> None:
        """Send to the other end; nothing before the first frame from it."""
        if self._socket is None or self._peer is None:
            return
        try:
            if self._listen:
                self._socket.sendto(data, self._peer)
            else:
                self._socket.send(data)
        except (BlockingIOError, ConnectionRefusedError):
            return  # lost, as datagrams may be; the link's age shows it
        except OSError as error:
            raise PortError(os_error_text(error)) from error

    def close(self) -> None:
        """Close the socket."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None


class TcpPort(Port):
    """A TCP connection as client."""

    def __init__(self, host: str, number: int) -> None:
        super().__init__()
        self._host, self._number = host, number
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Connect."""
        self.close()
        _resolve(self._host, self._number, socket.SOCK_STREAM, False)
        try:
            self._socket = socket.create_connection((self._host, self._number), timeout=CONNECT_S)
        except OSError as error:
            raise PortError(os_error_text(error)) from error
        self._socket.settimeout(WRITE_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def fileno(self) -> int:
        """The file descriptor to wait on."""
        return -1 if self._socket is None else self._socket.fileno()

    def read(self) -> bytes:
        """Bytes received."""
        assert self._socket is not None
        try:
            data = self._socket.recv(READ_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise PortError(os_error_text(error)) from error
        if not data:
            raise PortError("closed the connection")
        self.bytes_in += len(data)
        return data

    def write(self, data: bytes) -> None:
        """Send all of it."""
        assert self._socket is not None
        try:
            self._socket.sendall(data)
        except OSError as error:
            if error.errno == errno.EPIPE:
                raise PortError("closed the connection") from error
            raise PortError(os_error_text(error)) from error

    def close(self) -> None:
        """Close the connection."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._socket.close()
        self._socket = None
