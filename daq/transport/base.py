"""Interface of the ports, and the error of a port.

A thread opens a port, waits on its file descriptor, reads and writes. Each error of the operating system or of a
library becomes a PortError with a message of one line.
"""

from __future__ import annotations

import errno
import re
from abc import ABC, abstractmethod
from typing import TypeGuard

from seatrial.daq.protocol import DatagramDecoder, Decoder
from seatrial.daq.samples import Frame

READ_BYTES = 65536  # bytes of one read, at most
WRITE_S = 0.05  # wall s; a port that accepts no bytes for longer is treated as lost


class PortError(Exception):
    """Error of a port that cannot be opened or was lost. The message is one line without the name of the port."""


class Port(ABC):
    """Interface of a port. Serial ports read and write bytes, CAN ports complete 16-byte `struct can_frame`.

    Attributes
    ----------
    bytes_in : int
        Bytes read so far.
    unparsed_bytes : int
        Read bytes that the port itself has discarded, for example datagrams of other senders.
    hint : str
        Advice to the user on the port, in one line; set when the port is opened, empty without advice.
    """

    def __init__(self) -> None:
        self.bytes_in = 0
        self.unparsed_bytes = 0
        self.hint = ""  # a possible improvement of the port, in one line; set when the port is opened

    @property
    def is_confirmed(self) -> bool:
        """Whether the sender of the last read is known to be the device. `confirm` makes a new sender known."""
        return True

    def confirm(self) -> None:
        """Accept the sender of the last read, because a frame of the device was found in it."""
        return

    @abstractmethod
    def open(self) -> None:
        """Open the port.

        Raises
        ------
        PortError
            If the port cannot be opened.
        """

    def take_over(self) -> None:
        """Open the port in place of a process that hangs or dies.

        If the kind of port allows it, the port is opened before the other process has closed it.

        Raises
        ------
        PortError
            If the port cannot be opened.
        """
        self.open()

    @abstractmethod
    def fileno(self) -> int:
        """Return the file descriptor to wait on."""

    @abstractmethod
    def read(self) -> bytes:
        """Return the bytes that have arrived, possibly none. Call it after waiting on the file descriptor.

        Raises
        ------
        PortError
            If the other end was lost.
        """

    @abstractmethod
    def write(self, data: bytes) -> None:
        """Write all bytes.

        Raises
        ------
        PortError
            If the port does not accept them.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the port in any state. This method raises no error."""


_REASONS = {
    errno.ECONNREFUSED: "refuses the connection: no program listens there",
    errno.ECONNRESET: "closed the connection",
    errno.EADDRINUSE: "is in use by another program",
    errno.EADDRNOTAVAIL: "is not an address of this machine",
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
    """Return the message, in one line, of an error of the operating system or of a library."""
    number = getattr(error, "errno", None) or getattr(error, "error_code", None)
    if number is None and (inner := re.search(r"\((\d+), '", str(error))):  # pyserial quotes the original error
        number = int(inner[1])
    return _REASONS.get(number or 0) or " ".join(str(error).split()) or type(error).__name__


def _takes_datagrams(decoder: Decoder) -> TypeGuard[DatagramDecoder]:
    """Return whether a decoder is a `DatagramDecoder`."""
    # `isinstance` with a Protocol would take a quarter of the processor time of a port.
    return hasattr(decoder, "begin_datagram")


def decode_read(port: Port, decoder: Decoder, data: bytes, t_rx: float) -> list[Frame]:
    """Decode the bytes of one read. On a network, answer from now on the sender of a frame of the device.

    Parameters
    ----------
    port
        The port that was read.
    decoder
        Decoder of the device.
    data
        Bytes of the read.
    t_rx
        Run time [s] at which the read returned.
    """
    if not _takes_datagrams(decoder):
        return decoder.feed(data, t_rx)
    if not port.is_confirmed:
        decoder.begin_datagram()
    n_accepted = decoder.accepted
    frames = decoder.feed(data, t_rx)
    if decoder.accepted > n_accepted:
        port.confirm()
    return frames
