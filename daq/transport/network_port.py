"""Ports on a network: UDP and TCP.

udpin (and udp) listens at a local address and answers the first sender of a frame of the device (`confirm`). It changes
to another sender only after SILENT_S without a frame of the first one, so that a stray datagram or a second program
cannot take over the link. udpout sends to an address. tcp connects to an address. UDP does not report that the other
end was lost; a lost sender is detected by its silence.
"""

from __future__ import annotations

import contextlib
import errno
import socket
import time
from typing import Any

from seatrial.daq.transport.base import CLOSED, WRITE_S, Port, PortError, os_error_text

READ_BYTES = 65536  # bytes of one datagram or read, at most
MOST = 256  # datagrams of one read, at most; many received datagrams must not delay the set-points of the same thread
SILENT_S = 2.0  # wall s of silence, after which another sender can take the link
CONNECT_S = 2.0  # wall s
BUFFER_BYTES = 1 << 20  # for datagrams that arrive while this process is not running


def _resolve_address(
    host: str, number: int, kind: socket.SocketKind, passive: bool
) -> tuple[socket.AddressFamily, Any]:
    """Return the address family and the socket address of a host name and port number.

    `kind` is that of the socket (UDP or TCP). `passive` is true for a local address to listen at. If the name has
    several addresses, the first one is returned. PortError is raised if there is no such address.
    """
    flags = socket.AI_PASSIVE if passive else 0
    try:
        family, _, _, _, address = socket.getaddrinfo(host, number, type=kind, flags=flags)[0]
    except OSError as error:
        raise PortError(
            f"no address {host}:{number}: {os_error_text(error)}; correct the host name, or give its number"
        ) from error
    return family, address


class UdpPort(Port):
    """UDP port. It joins datagrams to a stream of bytes, because each datagram of MAVLink contains complete frames.

    Parameters
    ----------
    host, number
        Host and port number: the local address to listen at, or the remote address to send to.
    listen
        Whether to listen at the address and to answer the first sender of a frame of the device.
    """

    def __init__(self, host: str, number: int, listen: bool) -> None:
        """Store the address, and whether to listen at it or to send to it. The port is not opened."""
        super().__init__()
        self._host, self._number, self._listen = host, number, listen
        self._socket: socket.socket | None = None
        self._peer: Any = None  # address of the confirmed sender
        self._candidate: Any = None  # address of the sender of the last read, while it may be an unknown one
        self._heard_at = 0.0  # wall s of the last confirmed read

    def open(self) -> None:
        """Bind the local address to listen at, or connect to the remote one. Raise PortError if this fails.

        The sender that was confirmed before is forgotten.
        """
        self._open_socket(shared=False)

    def take_over(self) -> None:
        """Bind the local address although another process has bound it, or connect to the remote address.

        A killed process keeps its address until its memory is freed. The newest socket receives all datagrams. Raise
        PortError if the socket cannot be opened.
        """
        self._open_socket(shared=True)

    def _open_socket(self, shared: bool) -> None:
        """Close the UDP socket if it is open, and open a new one. Raise PortError if this fails.

        With `shared`, a port that listens gets its local address even if another process holds it. The socket of that
        process must allow this (SO_REUSEADDR), as every open `UdpPort` does. Without `shared`, PortError is raised if
        another process holds the address. A port that sends to a remote address ignores `shared`.
        """
        self.close()
        family, address = _resolve_address(self._host, self._number, socket.SOCK_DGRAM, self._listen)
        sock = socket.socket(family, socket.SOCK_DGRAM)
        try:
            sock.setblocking(False)
            sock.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
            if self._listen:
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, shared)
                sock.bind(address)
                # From now on the watchdog can bind the same address by `take_over`. Other programs cannot bind it by
                # mistake, because they do not set SO_REUSEADDR.
                sock.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, True)
            else:
                sock.connect(address)
        except OSError as error:
            sock.close()
            raise PortError(os_error_text(error)) from error
        self._socket, self._peer = sock, None if self._listen else address

    def fileno(self) -> int:
        """Return the file descriptor of the UDP socket, for `select`; -1 if the port is closed."""
        return -1 if self._socket is None else self._socket.fileno()

    def read(self) -> bytes:
        """Return the bytes that have arrived from the confirmed sender, possibly none.

        The confirmed sender is the one in whose bytes a frame of the device was found. As long as there is none, or
        after 2 s without a frame of it (SILENT_S), return one datagram of any sender. Datagrams of other senders count
        as unparsed. A port that does not listen returns the datagrams of its remote address. At most 256 datagrams are
        read in one call (MOST).

        Raises
        ------
        PortError
            If the socket fails.
        """
        assert self._socket is not None
        parts: list[bytes] = []
        open_to_others = self._listen and (self._peer is None or time.monotonic() - self._heard_at >= SILENT_S)
        self._candidate = None
        for _ in range(1 if open_to_others else MOST):
            try:
                data, sender = self._socket.recvfrom(READ_BYTES)
            except BlockingIOError:
                break
            except ConnectionRefusedError:  # the answer to one of our datagrams: no program listens there yet
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
        """Whether the bytes of the last read are from the confirmed sender; True also if nothing was read."""
        return self._candidate is None or self._candidate == self._peer

    def confirm(self) -> None:
        """Accept the sender of the last read as the device. `write` sends to this sender from now on.

        Another sender can take its place only after 2 s (SILENT_S) without a call of this method.
        """
        if self._candidate is not None:
            self._peer = self._candidate
        self._heard_at = time.monotonic()

    def write(self, data: bytes) -> None:
        """Send bytes to the device as one datagram.

        A port that listens has no address of the device before `confirm`; until then nothing is sent, and neither by a
        closed port. A datagram that the network does not accept is lost without an error. Raise PortError if the socket
        fails.
        """
        if self._socket is None or self._peer is None:
            return
        try:
            if self._listen:
                self._socket.sendto(data, self._peer)
            else:
                self._socket.send(data)
        except (BlockingIOError, ConnectionRefusedError):
            return  # datagrams may be lost; the age of the link shows a lost connection
        except OSError as error:
            raise PortError(os_error_text(error)) from error

    def close(self) -> None:
        """Close the UDP socket, if it is open."""
        if self._socket is not None:
            self._socket.close()
        self._socket = None


class TcpPort(Port):
    """TCP port. It connects to a server.

    Parameters
    ----------
    host, number
        Host and port number of the server.
    """

    def __init__(self, host: str, number: int) -> None:
        """Store host and port number of the server. The port is not opened."""
        super().__init__()
        self._host, self._number = host, number
        self._socket: socket.socket | None = None

    def open(self) -> None:
        """Connect to the server. Raise PortError if there is no connection within 2 s (CONNECT_S).

        If the host has several addresses, each is tried for 2 s.
        """
        self.close()
        _resolve_address(self._host, self._number, socket.SOCK_STREAM, False)
        try:
            self._socket = socket.create_connection((self._host, self._number), timeout=CONNECT_S)
        except OSError as error:
            raise PortError(os_error_text(error)) from error
        self._socket.settimeout(WRITE_S)
        self._socket.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)

    def fileno(self) -> int:
        """Return the file descriptor of the TCP socket, for `select`; -1 if the port is closed."""
        return -1 if self._socket is None else self._socket.fileno()

    def read(self) -> bytes:
        """Return the bytes that have arrived at the TCP socket, possibly none.

        Raise PortError if the connection was lost.
        """
        assert self._socket is not None
        try:
            data = self._socket.recv(READ_BYTES, socket.MSG_DONTWAIT)
        except BlockingIOError:
            return b""
        except OSError as error:
            raise PortError(os_error_text(error)) from error
        if not data:
            raise PortError(CLOSED)
        self.bytes_in += len(data)
        return data

    def write(self, data: bytes) -> None:
        """Send all bytes to the TCP server.

        Raise PortError if the connection was lost, or accepts no more bytes for 50 ms (WRITE_S).
        """
        assert self._socket is not None
        try:
            self._socket.sendall(data)
        except OSError as error:
            if error.errno == errno.EPIPE:
                raise PortError(CLOSED) from error
            raise PortError(os_error_text(error)) from error

    def close(self) -> None:
        """Close the TCP connection, if it is open. No error is raised."""
        if self._socket is not None:
            with contextlib.suppress(OSError):
                self._socket.shutdown(socket.SHUT_RDWR)
            self._socket.close()
        self._socket = None
