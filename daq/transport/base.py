"""What every port has in common: the interface `Port`, and its errors in one line.

A port is opened, waited for through its file descriptor, read and written; every error of the operating system or of a
library becomes a PortError of one line.
"""

from __future__ import annotations

import errno
import re
from abc import ABC, abstractmethod
from typing import TypeGuard

from seatrial.daq.protocol import DatagramDecoder, Decoder
from seatrial.daq.samples import Frame

READ_BYTES = 65536
WRITE_S = 0.05  # wall; a port that takes no bytes for longer is as good as gone


class PortError(Exception):
    """The port cannot be opened, or was lost. The message is one line without the port's name."""


class Port(ABC):
    """One port. CAN ports read and write whole 16-byte `struct can_frame`s, serial ports bytes."""

    def __init__(self) -> None:
        self.bytes_in = 0
        self.unparsed_bytes = 0
        self.hint = ""  # what could be better about it, in one line; known when it is open

    @property
    def is_confirmed(self) -> bool:
        """Whether the bytes of the last read are the device's; of an unknown sender `confirm` has to say so."""
        return True

    def confirm(self) -> None:
        """The bytes of the last read held a frame of the device."""
        return

    @abstractmethod
    def open(self) -> None:
        """Open; raises PortError."""

    def take_over(self) -> None:
        """Open in the place of a process that hangs or dies, before it has let go where a port allows that. Raises
        PortError."""
        self.open()

    @abstractmethod
    def fileno(self) -> int:
        """The file descriptor to wait on."""

    @abstractmethod
    def read(self) -> bytes:
        """What has arrived, after waiting; may be empty. Raises PortError when the other end is gone."""

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Write all of it; raises PortError."""

    @abstractmethod
    def close(self) -> None:
        """Close, whatever state it is in; never raises."""


_REASONS = {
    errno.ECONNREFUSED: "refuses the connection: no program listens there",
    errno.ECONNRESET: "closed the connection",
    errno.EADDRINUSE: "is in use by another program",
    errno.EADDRNOTAVAIL: "is no address of this machine",
    errno.ENOENT: "is not there",
    errno.ENODEV: "is not there",
    errno.ENXIO: "is not there",
    errno.EIO: "is not there",
    errno.EACCES: "may not be opened by this user (group dialout?)",
    errno.EPERM: "may not be opened by this user (group dialout?)",
    errno.EBUSY: "is in use by another program",
    errno.EAGAIN: "is in use by another program",
    errno.ENOTTY: "is not a serial device",
    errno.ENETDOWN: "is down (ip link set ... up)",
}


def os_error_text(error: BaseException) -> str:
    """One line for an error of the operating system or of a library."""
    number = getattr(error, "errno", None) or getattr(error, "error_code", None)
    if number is None and (inner := re.search(r"\((\d+), '", str(error))):  # pyserial quotes the one below it
        number = int(inner[1])
    return _REASONS.get(number or 0) or " ".join(str(error).split()) or type(error).__name__


def _takes_datagrams(decoder: Decoder) -> TypeGuard[DatagramDecoder]:
    """Whether it is a DatagramDecoder. `isinstance` of a protocol, on every read, takes a quarter of a port's time."""
    return hasattr(decoder, "begin_datagram")


def decode_read(port: Port, decoder: Decoder, data: bytes, t_rx: float) -> list[Frame]:
    """The samples of one read. On a network, who has sent a frame of the device is the one to answer."""
    if not _takes_datagrams(decoder):
        return decoder.feed(data, t_rx)
    if not port.is_confirmed:
        decoder.begin_datagram()
    before = decoder.accepted
    frames = decoder.feed(data, t_rx)
    if decoder.accepted > before:
        port.confirm()
    return frames
