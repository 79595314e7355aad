"""Base class of the emulated devices. It uses neither ports nor a clock."""

from __future__ import annotations

from abc import ABC, abstractmethod

from seatrial.mocks.world import Sample


class DeviceEmulator(ABC):
    """Emulator of the device at one port: it encodes samples and reacts to the bytes of the host.

    Attributes
    ----------
    clock_error : float
        Time [s] by which the clock of the device is fast; negative if it is slow.
    """

    clock_error = 0.0

    @abstractmethod
    def encode(self, sample: Sample, t: float) -> bytes:
        """Return the bytes by which the device reports a sample that it has taken at run time ``t`` [s].

        They are empty if the device sends no message for this sample.
        """

    def receive(self, data: bytes, t: float) -> bytes:
        """Process bytes of the host that arrive at run time ``t`` [s], and return the answer of the device.

        This default ignores the bytes and returns empty bytes.
        """
        return b""
