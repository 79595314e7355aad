"""Samples -> bytes of each device, and bytes of the host -> what the device does. No I/O, no clock."""

from __future__ import annotations

import time
from collections.abc import Mapping
from dataclasses import replace
from typing import final

from seatrial.daq.errors import SeatrialError
from seatrial.daq.protocol import NUMBERS, Assembler, dronecan, loadcell, nmea, vectornav, vesc
from seatrial.daq.rig import Device, Rig, Thruster
from seatrial.daq.samples import NAN, Ahrs, Esc, Gnss, LoadCell
from seatrial.mocks.devices.base import DeviceEmulator
from seatrial.mocks.devices.slcan_adapter import Adapter, CanFrame
from seatrial.mocks.world import EscController, Sample

FIRST_ESC_NODE = 20  # of DroneCAN controllers
SLOW_STATUS_S = 0.2  # between STATUS 4 and 5 of one controller


@final
class VectorNav(DeviceEmulator):
    """Binary messages with the device's time, or $VNYMR."""

    def __init__(self, ascii_: bool) -> None:
        self._ascii = ascii_

    def encode(self, sample: Sample, t: float) -> bytes:
        """One message."""
        assert isinstance(sample, Ahrs)
        if self._ascii:
            return vectornav.encode_ascii(sample)
        return vectornav.encode_binary(sample, max(t + self.clock_error, 0.0))


@final
class Nmea(DeviceEmulator):
    """The sentences of an epoch."""

    def encode(self, sample: Sample, t: float) -> bytes:
        """GGA, RMC, VTG and GST."""
        assert isinstance(sample, Gnss)
        return nmea.encode(replace(sample, utc=sample.utc + self.clock_error))


@final
class LoadCellLine(DeviceEmulator):
    """One line a reading."""

    def encode(self, sample: Sample, t: float) -> bytes:
        """The counts."""
        assert isinstance(sample, LoadCell)
        return loadcell.encode(sample.counts)


@final
class VescBus(DeviceEmulator):
    """Speed controllers on a CAN bus behind an slcan adapter."""

    def __init__(self, controllers: Mapping[int, EscController], pole_pairs: Mapping[int, int]) -> None:
        """Both by node."""
        self._controllers = controllers
        self._pole_pairs = pole_pairs
        self._adapter = Adapter()
        self._slow_due: dict[int, float] = {}
        vesc.encode_duty(0, 0.0)  # loads the library behind it now and not when the first sample is due

    def encode(self, sample: Sample, t: float) -> bytes:
        """STATUS 1, and STATUS 4 and 5 five times a second."""
        assert isinstance(sample, Esc)
        if t < self._slow_due.get(sample.node, 0.0):
            sample = replace(sample, temperature=NAN, voltage=NAN)
        else:
            self._slow_due[sample.node] = t + SLOW_STATUS_S - 1e-6
        frames = vesc.encode_status(sample, self._pole_pairs[sample.node])
        return b"".join(self._adapter.encode(CanFrame(*frame)) for frame in frames)

    def receive(self, data: bytes, t: float) -> bytes:
        """The adapter's answers; duty commands reach their controllers."""
        answers, frames = self._adapter.feed(data)
        for frame in frames:
            command = vesc.decode_command(frame.arbitration_id, frame.data) if frame.extended else None
            if command is not None and command[0] in self._controllers:
                self._controllers[command[0]].command(t, max(-1.0, min(1.0, command[1])))
        return answers


@final
class DronecanBus(DeviceEmulator):
    """DroneCAN speed controllers behind an slcan adapter; the controller of index k is node 20 + k of the bus."""

    def __init__(self, controllers: Mapping[int, EscController]) -> None:
        """By index."""
        self._controllers = controllers
        self._adapter = Adapter()
        self._commands = Assembler(dronecan.RAW_COMMAND)
        self._sent: dict[int, int] = {}

    def encode(self, sample: Sample, t: float) -> bytes:
        """An esc.Status."""
        assert isinstance(sample, Esc)
        number = self._sent[sample.node] = (self._sent.get(sample.node, -1) + 1) % NUMBERS
        frames = dronecan.encode(sample, FIRST_ESC_NODE + sample.node, number)
        return b"".join(self._adapter.encode(CanFrame(*frame)) for frame in frames)

    def receive(self, data: bytes, t: float) -> bytes:
        """The adapter's answers; each controller takes its own part of a command, if it has one."""
        answers, frames = self._adapter.feed(data)
        for frame in frames:
            if not frame.extended:
                continue
            for payload, _ in self._commands.take(frame.arbitration_id, frame.data, t):
                for index, n in enumerate(dronecan.decode_command(payload)):
                    if index in self._controllers:
                        self._controllers[index].command(t, n)
        return answers


def make_emulator(
    rig: Rig, device: Device, controllers: Mapping[int, EscController], ascii_: bool = False
) -> DeviceEmulator:
    """The emulator of ``device``. Raises SeatrialError for a rig that no mock can serve."""
    if device.protocol == "vectornav":
        return VectorNav(ascii_)
    if device.protocol == "nmea":
        return Nmea()
    if device.protocol == "loadcell":
        if loadcell.compile_pattern(device.pattern).search(loadcell.encode(-123.0).decode().rstrip()) is None:
            raise SeatrialError(
                f"{rig.path}: device {device.name}: the mock sends lines like -123, which the pattern does not match"
            )
        return LoadCellLine()
    if device.protocol == "mavlink":
        from seatrial.mocks.devices.autopilot import AutopilotEmulator  # brings pymavlink with it

        return AutopilotEmulator(rig, device, controllers, time.time())
    if not device.port.startswith("slcan:"):
        raise SeatrialError(f"{rig.path}: device {device.name}: a mock serves CAN as slcan:PORT, not {device.port}")
    if device.protocol == "dronecan":
        return DronecanBus(controllers)
    return VescBus(controllers, {t.node: t.pole_pairs for t in rig.thrusters if t.device == device.name})


def by_side(rig: Rig) -> tuple[Thruster, Thruster]:
    """The left and the right thruster of a boat. Raises SeatrialError unless there is one on each side."""
    left = [t for t in rig.thrusters if t.position_m[1] < 0.0]
    right = [t for t in rig.thrusters if t.position_m[1] > 0.0]
    if len(left) != 1 or len(right) != 1 or len(rig.thrusters) != 2:
        raise SeatrialError(
            f"{rig.path}: a mock boat has two thrusters, one at position_m y < 0 and one at y > 0; "
            f"this rig has {len(left)} and {len(right)} there"
        )
    return left[0], right[0]
