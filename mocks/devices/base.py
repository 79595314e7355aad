"""Samples -> bytes of each device, and bytes of the host -> what the device does. No I/O, no clock."""

from __future__ import annotations

from abc import ABC, abstractmethod

from seatrial.mocks.world import Sample


class DeviceEmulator(ABC):
    """What sits at the far end of one port."""

    clock_error = 0.0  # s by which its own clock is ahead of what it was set to

    @abstractmethod
    def encode(self, sample: Sample, t: float) -> bytes:
        """The bytes of a sample that the device takes at its own time ``t`` (s)."""

    def receive(self, data: bytes, t: float) -> bytes:
        """The answer to bytes that arrive at ``t`` (s); most devices only talk."""
        return b""
