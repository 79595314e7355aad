"""The driver of each kind of device."""

from __future__ import annotations

import time

from seatrial.daq.drivers.base import DeviceDriver, LinkRole, PollingDriver
from seatrial.daq.drivers.vesc import VescDriver
from seatrial.daq.protocol import Decoder, mantracourt
from seatrial.daq.rig import Device, Rig

SPARE_IDS = (254, 253, 252)  # system ids for who only asks: no autopilot takes it for its ground station


def make_driver(device: Device, rig: Rig, decoder: Decoder, role: LinkRole) -> DeviceDriver | None:
    """The driver of a device, None for one that is only listened to. Raises SeatrialError for a bad signing key."""
    here = [thruster for thruster in rig.thrusters if thruster.device == device.name]
    if device.protocol == "vesc":
        return VescDriver(frozenset(thruster.node for thruster in here if thruster.reversed))
    if device.protocol == "dronecan":
        if not here:
            return None
        from seatrial.daq.drivers.dronecan import DronecanDriver

        reversed_nodes = frozenset(thruster.node for thruster in here if thruster.reversed)
        return DronecanDriver(frozenset(thruster.node for thruster in here), reversed_nodes, device.own_node)
    if isinstance(decoder, mantracourt.Decoder):
        return PollingDriver(decoder.request, 1.0 / (device.rate_hz * rig.speed))
    if device.mavlink is None:
        return None
    from seatrial.daq.drivers.mavlink import MavlinkDriver  # brings pymavlink with it
    from seatrial.daq.protocol import mavlink, mavlink_wire

    assert isinstance(decoder, mavlink.MavlinkDecoder)
    settings = device.mavlink
    key = None if settings.key_file is None else mavlink_wire.read_key(settings.key_file)
    spare = next(number for number in SPARE_IDS if number not in (settings.system_id, settings.own_system_id))
    own = settings.own_system_id if role in (LinkRole.DRIVE, LinkRole.RESCUE) else spare
    codec = mavlink_wire.Codec(own, settings.own_component_id, key, time.time(), int(role is LinkRole.RESCUE))
    driver = MavlinkDriver(device, here, codec, role, decoder)
    decoder.listener = lambda message: driver.receive(message, time.monotonic())
    return driver


def check_keys(rig: Rig) -> None:
    """Raises SeatrialError where a signing key of the rig cannot be read: before there is a log or a watchdog."""
    for device in rig.devices:
        if device.mavlink is not None and device.mavlink.key_file is not None:
            from seatrial.daq.protocol import mavlink_wire

            mavlink_wire.read_key(device.mavlink.key_file)
