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
    """Interface of a port. CAN ports read and write complete 16-byte `struct can_frame`, other ports any bytes.

    Attributes
    ----------
    bytes_in : int
        Bytes read so far.
    unparsed_bytes : int
        Read bytes that the port itself has discarded, for example datagrams of other senders.
    hint : str
        Advice to the user on the port, in one line; empty without advice. It is set when the port is opened. An slcan
        port also sets it later, if the adapter refuses its settings.
    """

    def __init__(self) -> None:
        """Set the counters to 0 and the hint to an empty text. The port is not opened."""
        self.bytes_in = 0
        self.unparsed_bytes = 0
        self.hint = ""  # a possible improvement of the port, in one line; set when the port is opened

    @property
    def is_confirmed(self) -> bool:
        """Whether the bytes of the last read are from a sender that is known to be the device.

        Only a listening UDP port can return False; all other ports always return True.
        """
        return True

    def confirm(self) -> None:
        """Accept the sender of the last read as the device, because a frame of the device was found in it.

        Only a UDP port has several senders; the default does nothing.
        """
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
        """Open the port in place of another process that hangs or dies, so that zero thrust can be commanded.

        A UDP port is opened although the other process still has it. Other ports are opened as by `open`, which may
        fail until that process has ended, for example at a serial port.

        Raises
        ------
        PortError
            If the port cannot be opened.
        """
        self.open()

    @abstractmethod
    def fileno(self) -> int:
        """Return the file descriptor of the port, for `select`; -1 if the port is closed."""

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
        """Write all bytes, with a wait of some 50 ms at most. A UDP port may lose them without an error.

        A SocketCAN port waits so long for each frame.

        Raises
        ------
        PortError
            If the port does not accept them.
        """

    @abstractmethod
    def close(self) -> None:
        """Close the port in any state. This method raises no error."""


NOT_SERIAL = "the port is not a serial device; give its device file, such as /dev/ttyUSB0"
CLOSED = "the program at the other end (autopilot, router or simulator) closed the connection; start it again"
_NOT_THERE = "the port is not there; plug the device in, or correct the name of the port"
_NOT_ALLOWED = "the port may not be opened by this user; for a serial port, join the group dialout and log in again"
_IN_USE = "the port is in use by another program; end that program"
_NO_ROUTE = "the network has no connection to the address; check network and address"
_REASONS = {
    errno.ECONNREFUSED: "the address refuses the connection: no program listens there; start it, or correct the port",
    errno.ECONNRESET: CLOSED,
    errno.ETIMEDOUT: "the other end does not answer; check that it is switched on, and its address",
    errno.EHOSTUNREACH: _NO_ROUTE,
    errno.ENETUNREACH: _NO_ROUTE,
    errno.EADDRINUSE: _IN_USE,
    errno.EADDRNOTAVAIL: "the address is not an address of this machine; listen at 0.0.0.0 for all its addresses",
    errno.ENOENT: _NOT_THERE,
    errno.ENODEV: _NOT_THERE,
    errno.ENXIO: _NOT_THERE,
    errno.EIO: _NOT_THERE,
    errno.EACCES: _NOT_ALLOWED,
    errno.EPERM: _NOT_ALLOWED,
    errno.EBUSY: _IN_USE,
    errno.EAGAIN: _IN_USE,
    errno.ENOTTY: NOT_SERIAL,
    errno.ENETDOWN: "the CAN interface is down; start it: sudo ip link set NAME up type can bitrate BITRATE",
}


def os_error_text(error: BaseException) -> str:
    """Return the message of an error of the operating system or of a library, as one line for the user.

    The message does not contain the name of the port. Known error numbers, such as that of a port in use, get a text of
    their own. An error without a text gives the name of its class.
    """
    number = getattr(error, "errno", None) or getattr(error, "error_code", None)
    if number is None and isinstance(error, TimeoutError):  # the time-out of a socket has no number
        number = errno.ETIMEDOUT
    if number is None and (inner := re.search(r"\((\d+), '", str(error))):  # pyserial quotes the original error
        number = int(inner[1])
    return _REASONS.get(number or 0) or " ".join(str(error).split()) or type(error).__name__


def _takes_datagrams(decoder: Decoder) -> TypeGuard[DatagramDecoder]:
    """Return whether a decoder can discard an incomplete frame at the begin of a datagram (`DatagramDecoder`)."""
    # `isinstance` with a Protocol would take a quarter of the processor time of a port.
    return hasattr(decoder, "begin_datagram")


def decode_read(port: Port, decoder: Decoder, data: bytes, t_rx: float) -> list[Frame]:
    """Decode the bytes of one read from a port, and return the samples that they complete.

    Before a datagram of an unknown sender, the decoder discards the incomplete frame of earlier bytes. If the bytes
    contain a frame of the device, the port accepts their sender as the device (`Port.confirm`). Both apply only to
    decoders of datagrams (MAVLink).

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

    Returns
    -------
    list of Frame
        The samples with their times; empty if no sample is complete.
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
