"""Emulators of the devices of a rig, except for the autopilot. They use neither ports nor a clock."""

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

FIRST_ESC_NODE = 20  # DroneCAN node number of the controller with index 0
SLOW_STATUS_S = 0.2  # s, period of the messages STATUS 4 and 5 of one controller


@final
class VectorNav(DeviceEmulator):
    """Emulated AHRS of VectorNav. It sends binary messages with the device's time, or $VNYMR sentences."""

    def __init__(self, ascii_: bool) -> None:
        """Set up an emulated VectorNav. ``ascii_``: whether it sends $VNYMR sentences instead of binary messages."""
        self._ascii = ascii_

    def encode(self, sample: Sample, t: float) -> bytes:
        """Return one message of an AHRS sample taken at run time ``t`` [s]: binary, or a $VNYMR sentence.

        The time in a binary message is ``t`` plus the clock error, at least 0.
        """
        assert isinstance(sample, Ahrs)
        if self._ascii:
            return vectornav.encode_ascii(sample)
        return vectornav.encode_binary(sample, max(t + self.clock_error, 0.0))


@final
class Nmea(DeviceEmulator):
    """Emulated GNSS receiver that sends NMEA sentences."""

    def encode(self, sample: Sample, t: float) -> bytes:
        """Return the NMEA sentences GGA, RMC, VTG and GST of one GNSS sample.

        The clock error of the device is added to its UTC. ``t`` is not used.
        """
        assert isinstance(sample, Gnss)
        return nmea.encode(replace(sample, utc=sample.utc + self.clock_error))


@final
class LoadCellLine(DeviceEmulator):
    """Emulated load cell that sends one line of text for each sample."""

    def encode(self, sample: Sample, t: float) -> bytes:
        """Return the line of text with the counts of one load cell sample. ``t`` is not used."""
        assert isinstance(sample, LoadCell)
        return loadcell.encode(sample.counts)


@final
class VescBus(DeviceEmulator):
    """Emulated VESC speed controllers on a CAN bus behind an slcan adapter."""

    def __init__(self, controllers: Mapping[int, EscController], pole_pairs: Mapping[int, int]) -> None:
        """Set up a bus from its VESC speed controllers and the pole pairs of their motors, both by CAN node.

        The bus commands these controllers. Each node in telemetry must have pole pairs.
        """
        self._controllers = controllers
        self._pole_pairs = pole_pairs
        self._adapter = Adapter()
        self._slow_due: dict[int, float] = {}
        vesc.encode_duty(0, 0.0)  # loads the library at once, so that the first sample is not late

    def encode(self, sample: Sample, t: float) -> bytes:
        """Return the bytes of the slcan adapter with the status frames of one speed controller at run time ``t`` [s].

        ``sample`` is its telemetry. STATUS 1 is always sent, STATUS 4 and 5 (temperature and voltage) at most five
        times per second for each controller. The bytes are empty while the channel of the adapter is closed.
        """
        assert isinstance(sample, Esc)
        if t < self._slow_due.get(sample.node, 0.0):
            sample = replace(sample, temperature=NAN, voltage=NAN)
        else:
            self._slow_due[sample.node] = t + SLOW_STATUS_S - 1e-6
        frames = vesc.encode_status(sample, self._pole_pairs[sample.node])
        return b"".join(self._adapter.encode(CanFrame(*frame)) for frame in frames)

    def receive(self, data: bytes, t: float) -> bytes:
        """Process bytes of the host at run time ``t`` [s], and return the answers of the slcan adapter.

        Duty commands, clipped to -1 to 1, are passed to their speed controllers. Other frames, and commands to unknown
        nodes, have no effect.
        """
        answers, frames = self._adapter.feed(data)
        for frame in frames:
            command = vesc.decode_command(frame.arbitration_id, frame.data) if frame.extended else None
            if command is not None and command[0] in self._controllers:
                self._controllers[command[0]].command(t, max(-1.0, min(1.0, command[1])))
        return answers


@final
class DronecanBus(DeviceEmulator):
    """Emulated DroneCAN speed controllers behind an slcan adapter. The controller of index k is node 20 + k."""

    def __init__(self, controllers: Mapping[int, EscController]) -> None:
        """Set up a bus from its speed controllers, by their DroneCAN index, which starts at 0."""
        self._controllers = controllers
        self._adapter = Adapter()
        self._commands = Assembler(dronecan.RAW_COMMAND)
        self._sent: dict[int, int] = {}  # transfer number of the last message, by index

    def encode(self, sample: Sample, t: float) -> bytes:
        """Return the bytes of the slcan adapter with one esc.Status message for the telemetry ``sample``.

        They are empty while the channel of the adapter is closed. ``t`` is not used.
        """
        assert isinstance(sample, Esc)
        number = self._sent[sample.node] = (self._sent.get(sample.node, -1) + 1) % NUMBERS
        frames = dronecan.encode(sample, FIRST_ESC_NODE + sample.node, number)
        return b"".join(self._adapter.encode(CanFrame(*frame)) for frame in frames)

    def receive(self, data: bytes, t: float) -> bytes:
        """Process bytes of the host at run time ``t`` [s], and return the answers of the slcan adapter.

        The set-points of a RawCommand message are passed to the speed controllers in the order of their indices.
        Set-points of unknown indices, and other messages, have no effect.
        """
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
    """Return an emulator for a device of a rig, by the protocol of the device.

    Parameters
    ----------
    rig : Rig
        Rig with the device and its thrusters.
    device : Device
        Device to emulate.
    controllers : mapping of int to EscController
        Speed controllers on this device, by node.
    ascii_ : bool
        Whether an AHRS sends $VNYMR sentences instead of binary messages.

    Raises
    ------
    SeatrialError
        If the device cannot be simulated, for example a load cell with another line format, or a CAN bus whose port is
        not `slcan:PORT`.
    """
    if device.protocol == "vectornav":
        return VectorNav(ascii_)
    if device.protocol == "nmea":
        return Nmea()
    if device.protocol == "loadcell":
        if loadcell.compile_pattern(device.pattern).search(loadcell.encode(-123.0).decode().rstrip()) is None:
            raise SeatrialError(
                f"{rig.path}: device {device.name}: the mock sends lines like -123, which the pattern does not match; "
                "change the pattern in the rig file"
            )
        return LoadCellLine()
    if device.protocol == "mavlink":
        from seatrial.mocks.devices.autopilot import AutopilotEmulator  # here, since it imports the optional pymavlink

        return AutopilotEmulator(rig, device, controllers, time.time())
    if not device.port.startswith("slcan:"):
        raise SeatrialError(
            f"{rig.path}: device {device.name}: a mock serves CAN only as slcan:PORT; write such a port in place of "
            f"{device.port}"
        )
    if device.protocol == "dronecan":
        return DronecanBus(controllers)
    return VescBus(controllers, {t.node: t.pole_pairs for t in rig.thrusters if t.device == device.name})


def by_side(rig: Rig) -> tuple[Thruster, Thruster]:
    """Return the left and the right thruster of a boat, by the sign of ``position_m`` y (negative is left).

    Raises
    ------
    SeatrialError
        If the rig does not have exactly two thrusters, one on each side. A thruster at y = 0 is on neither side.
    """
    left = [t for t in rig.thrusters if t.position_m[1] < 0.0]
    right = [t for t in rig.thrusters if t.position_m[1] > 0.0]
    if len(left) != 1 or len(right) != 1 or len(rig.thrusters) != 2:
        raise SeatrialError(
            f"{rig.path}: a mock boat has two thrusters, one at position_m y < 0 and one at y > 0; "
            f"this rig has {len(left)} and {len(right)} there: give another rig"
        )
    return left[0], right[0]
