"""Interface of the decoders of wire protocols. A decoder does no I/O and reads no clock.

Each protocol has one file with a `Decoder`, whose `feed(data, t_rx)` returns a list of `Frame`, and with functions that
encode samples or commands. A decoder raises no error for any input. It counts the bytes outside valid frames and
searches for the next valid frame. The samples and counters do not depend on how the stream is split into reads.
"""

from __future__ import annotations

from typing import Protocol, runtime_checkable

from seatrial.daq.samples import Frame


class Decoder(Protocol):
    """Interface of all decoders of protocols: counters of the stream, and the conversion of bytes to samples.

    Attributes
    ----------
    frames
        Number of complete valid frames, with a correct checksum if the protocol has one.
    checksum_errors
        Number of complete frames with a wrong checksum.
    unparsed_bytes
        Number of bytes outside valid frames, without the line ends between frames.
    remark
        Advice about the stream for the user, in one line; empty if there is none.
    """

    frames: int  # complete frames with a correct checksum
    checksum_errors: int  # complete frames with a wrong checksum
    unparsed_bytes: int  # bytes outside valid frames, without the line ends between frames
    remark: str  # advice about the stream for the user, in one line; empty if there is none

    def feed(self, data: bytes, t_rx: float) -> list[Frame]:
        """Decode the bytes of one read.

        Parameters
        ----------
        data
            Bytes of the stream. They may begin and end inside a frame.
        t_rx
            Run time [s] at which the read returned.

        Returns
        -------
        list of Frame
            The samples that these bytes complete.
        """
        ...

    def reset(self) -> None:
        """Discard an incomplete frame, because the port was reopened. The counters of the stream are kept.

        The bytes of the frame count as unparsed.
        """
        ...


@runtime_checkable
class DatagramDecoder(Decoder, Protocol):
    """Interface of decoders of datagrams, which may come from unknown senders.

    Attributes
    ----------
    accepted
        Number of decoded frames that the device itself sent. If the decoder has a signing key, only frames with a
        correct signature count. The reader of the port confirms the sender of a datagram that increases it.
    """

    accepted: int  # frames of the device itself; if a key is given, only frames with a correct signature

    def begin_datagram(self) -> None:
        """Discard an incomplete frame, because the next datagram may come from another sender."""
        ...
