"""Wire protocols without I/O and without a clock: bytes in, frames out; samples in, bytes out.

One file per protocol. Each has a `Decoder` with `feed(data, t_rx) -> list[Frame]` and functions that encode. A
decoder never raises on what it is fed: bytes that are in no valid frame are counted, and the next valid frame is
found. How the bytes were cut into reads makes no difference to the samples or to the counters.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from seatrial.daq.samples import Frame


class Decoder(Protocol):
    """What all decoders share."""

    frames: int  # frames on the wire that were whole and had the right checksum
    checksum_errors: int  # frames that were whole and had a wrong one
    unparsed_bytes: int  # bytes in no valid frame; line ends between frames do not count
    remark: str  # what a user has to know of the stream, in one line; empty when nothing

    def feed(self, data: bytes, t_rx: float) -> list[Frame]:
        """Take the bytes of one read that returned at run time `t_rx`; returns the samples they complete."""
        ...

    def reset(self) -> None:
        """Discard an incomplete frame (the port was reopened). Counters stay."""
        ...


@runtime_checkable
class DatagramDecoder(Decoder, Protocol):
    """A decoder of datagrams that anybody may send: it tells whether they are the device's own."""

    accepted: int  # frames of the device itself, signed where there is a key

    def begin_datagram(self) -> None:
        """The next bytes are of another sender: no frame may be put together of both."""
        ...
