"""Factory of device drivers."""

from __future__ import annotations

import time

from seatrial.daq.drivers.base import DeviceDriver, LinkRole, PollingDriver
from seatrial.daq.drivers.vesc import VescDriver
from seatrial.daq.protocol import Decoder, mantracourt
from seatrial.daq.rig import Device, Rig

# System ids of a program in the role ASK. An autopilot does not take a program with such an id for its ground station.
SPARE_IDS = (254, 253, 252)


def make_driver(device: Device, rig: Rig, decoder: Decoder, role: LinkRole) -> DeviceDriver | None:
    """Return the driver of a device, or None if nothing is ever sent to the device.

    VESC buses, DroneCAN buses with a thruster, autopilots, and converters that are polled (Mantracourt) have a driver.
    An autopilot also has one in the role LISTEN, in which it sends nothing.

    Parameters
    ----------
    device
        The device.
    rig
        The rig with its thrusters.
    decoder
        Decoder of the device. For an autopilot, the driver is also set as its `listener`.
    role
        Role towards an autopilot: listen, request rates and parameters, drive, or send zero in an emergency. It has no
        influence on other drivers.

    Raises
    ------
    SeatrialError
        If the signing key of an autopilot cannot be read.
    """
    thrusters = [thruster for thruster in rig.thrusters if thruster.device == device.name]
    if device.protocol == "vesc":
        return VescDriver(frozenset(thruster.node for thruster in thrusters if thruster.reversed))
    if device.protocol == "dronecan":
        if not thrusters:
            return None
        from seatrial.daq.drivers.dronecan import DronecanDriver

        reversed_nodes = frozenset(thruster.node for thruster in thrusters if thruster.reversed)
        return DronecanDriver(frozenset(thruster.node for thruster in thrusters), reversed_nodes, device.own_node)
    if isinstance(decoder, mantracourt.Decoder):
        return PollingDriver(decoder.request, 1.0 / (device.rate_hz * rig.speed))
    if device.mavlink is None:
        return None
    from seatrial.daq.drivers.mavlink import MavlinkDriver  # imported here because it imports pymavlink, which is slow
    from seatrial.daq.protocol import mavlink, mavlink_wire

    assert isinstance(decoder, mavlink.MavlinkDecoder)
    settings = device.mavlink
    key = None if settings.key_file is None else mavlink_wire.read_key(settings.key_file)
    spare = next(number for number in SPARE_IDS if number not in (settings.system_id, settings.own_system_id))
    own_system = settings.own_system_id if role in (LinkRole.DRIVE, LinkRole.RESCUE) else spare
    codec = mavlink_wire.Codec(own_system, settings.own_component_id, key, time.time(), int(role is LinkRole.RESCUE))
    driver = MavlinkDriver(device, thrusters, codec, role, decoder)
    decoder.listener = lambda message: driver.receive(message, time.monotonic())
    return driver


def check_keys(rig: Rig) -> None:
    """Raise SeatrialError if the file of a MAVLink signing key (`key_file`) in the rig cannot be read or has no key.

    The check is made before a log is written and before the watchdog is connected. Nothing is returned.
    """
    for device in rig.devices:
        if device.mavlink is not None and device.mavlink.key_file is not None:
            from seatrial.daq.protocol import mavlink_wire

            mavlink_wire.read_key(device.mavlink.key_file)
