"""Base class of the emulated devices. It uses neither ports nor a clock."""

from __future__ import annotations

from abc import ABC, abstractmethod

from seatrial.mocks.world import Sample


class DeviceEmulator(ABC):
    """Emulator of the device at one port: it encodes samples and reacts to the bytes of the host."""

    clock_error = 0.0  # s by which the clock of the device is fast

    @abstractmethod
    def encode(self, sample: Sample, t: float) -> bytes:
        """Return the message of a sample that the device takes at ``t`` [s]; empty bytes if no message is due."""

    def receive(self, data: bytes, t: float) -> bytes:
        """Process bytes of the host that arrive at ``t`` [s] and return the answer. By default it is empty."""
        return b""
