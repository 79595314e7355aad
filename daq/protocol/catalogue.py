"""Catalogue of protocols: one row describes one protocol for the rest of daq.

The module of a decoder is imported when the decoder is made, so that a rig file is read quickly.
"""

from __future__ import annotations

import importlib.util
from collections.abc import Callable, Iterator, Mapping
from typing import NamedTuple

from seatrial.daq.errors import SeatrialError, warn
from seatrial.daq.plugins import load_or_warn, load_plugin, plugins
from seatrial.daq.protocol.decoder import Decoder
from seatrial.daq.rig import Device, Rig

GROUP = "seatrial.protocols"  # group of entry points with which other packages add protocols

SERIAL, CAN, NET = "serial", "can", "net"  # NET: a serial device or a socket
GNSS_BAUDS = (9600, 38400, 115200, 4800, 57600, 460800, 230400, 921600)  # bit/s, the commonest first


class DeviceType(NamedTuple):
    """Description of one protocol: its bus, its keys in the rig file, and its decoder.

    Attributes
    ----------
    description
        Description of the device, for lists of devices.
    bus
        Kind of the port: SERIAL, CAN, or NET (a serial device or a socket).
    make
        Function that returns a new decoder for a device of a rig.
    options
        Keys of a [[device]] table of the rig file that this protocol uses, beside the keys of all protocols.
        seatrial.daq.config.rig_file checks the keys of built-in protocols. The keys of other protocols are passed on in
        `Device.settings`.
    bauds
        Baud rates [bit/s] that `seatrial devices` tries, the commonest first. Empty if `seatrial devices` cannot
        recognise the protocol.
    module
        Python module that the protocol needs. The optional dependency (extra) with the protocol's name installs it.
        Empty if the protocol needs no module.
    """

    description: str
    bus: str
    make: Callable[[Device, Rig], Decoder]
    options: tuple[str, ...] = ()
    bauds: tuple[int, ...] = ()
    module: str = ""

    @property
    def installed(self) -> bool:
        """Whether the Python module that the protocol needs is installed; True if the protocol needs none."""
        return not self.module or importlib.util.find_spec(self.module) is not None


# Each of the following functions makes a new decoder of one protocol for a device of a rig. The module of the decoder
# is imported in the function.


def _make_vectornav(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder of a VectorNav AHRS. The device and the rig are not used."""
    from seatrial.daq.protocol import vectornav

    return vectornav.Decoder()


def _make_mip(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder of a MicroStrain inertial sensor. The device and the rig are not used."""
    from seatrial.daq.protocol import mip

    return mip.Decoder()


def _make_nmea(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder of NMEA 0183, with the magnetic declination of the device in the rig.

    If several devices of the rig have the protocol nmea or ubx, the names of its transducers end with the name of the
    device. Otherwise these names have no ending.
    """
    from seatrial.daq.protocol import nmea

    return nmea.Decoder(device.declination, _signal_ending(device, rig))


def _make_ubx(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder of a u-blox receiver, with the magnetic declination of the device in the rig.

    If several devices of the rig have the protocol nmea or ubx, the names of its transducers end with the name of the
    device. Otherwise these names have no ending.
    """
    from seatrial.daq.protocol import ubx

    return ubx.Decoder(device.declination, _signal_ending(device, rig))


def _signal_ending(device: Device, rig: Rig) -> str:
    """Return the ending of the names under which the log stores the transducers (NMEA sentence XDR) of a device.

    The ending is `_NAME`, with the name of the device, if several devices of the rig have the protocol nmea or ubx,
    since their transducers may have equal names. Otherwise it is empty.
    """
    return f"_{device.name}" if sum(other.protocol in ("nmea", "ubx") for other in rig.devices) > 1 else ""


def _make_loadcell(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder of a load cell, with the pattern, saturation and calibration of the device.

    Without a calibration the forces are NaN. The decoder discards the first line after each opening of the port, which
    may be incomplete. Raise ValueError if the pattern is invalid.
    """
    from seatrial.daq.protocol import loadcell

    force = device.calibration.force if device.calibration else None
    return loadcell.Decoder(device.pattern, device.saturation, force, skip_first=True)


def _make_openscale(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder of an OpenScale board, with the saturation and calibration of the device.

    Without a calibration the forces are those that the board computes. The decoder discards the first line after each
    opening of the port, which may be incomplete.
    """
    from seatrial.daq.protocol import openscale

    force = device.calibration.force if device.calibration else None
    return openscale.Decoder(device.saturation, force, skip_first=True)


def _make_mantracourt(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder of a Mantracourt converter, with the query, saturation and calibration of the device.

    Without a calibration the forces are NaN. No answer is discarded after an opening of the port.
    """
    from seatrial.daq.protocol import mantracourt

    force = device.calibration.force if device.calibration else None
    return mantracourt.Decoder(device.saturation, force, query=device.query)


def _make_vesc(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder of VESC controllers, with the pole pairs of the thrusters that the device drives.

    The sign of rpm and duty of reversed thrusters is changed. Status frames of controllers that drive no thruster of
    the device are counted and give no sample.
    """
    from seatrial.daq.protocol import vesc

    thrusters = [thruster for thruster in rig.thrusters if thruster.device == device.name]
    return vesc.Decoder(
        {thruster.node: thruster.pole_pairs for thruster in thrusters},
        frozenset(thruster.node for thruster in thrusters if thruster.reversed),
    )


def _make_mavlink(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder of an autopilot, with the servo outputs of the thrusters that the device drives.

    If the device drives no thruster with a servo output, each servo output that had a pulse gives samples. The device
    needs MAVLink settings.
    """
    from seatrial.daq.protocol import mavlink

    return mavlink.make_decoder(device, rig)


def _make_dbc(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder of the signals of the device in its DBC file.

    Raise SeatrialError if the file cannot be read, or if the file lacks a message or a signal. The error names the rig
    file and the device in the second case.
    """
    from seatrial.daq.protocol import dbc

    database = dbc.load_dbc(device.dbc)
    try:
        return dbc.Decoder(database, device.signals)
    except SeatrialError as error:
        raise SeatrialError(f"{rig.path}: device {device.name}, {device.dbc}: {error}") from error


def _make_dronecan(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder of the DroneCAN controllers of the thrusters that a device drives.

    The sign of the rpm of reversed thrusters is changed. The key `index_offset` of the device is the index of a
    controller in its telemetry minus its index in the commands. Controllers that drive no thruster also give samples,
    with the sign that they report.
    """
    from seatrial.daq.protocol import dronecan

    thrusters = [thruster for thruster in rig.thrusters if thruster.device == device.name]
    return dronecan.Decoder(
        frozenset(thruster.node for thruster in thrusters if thruster.reversed), device.index_offset
    )


def _make_nmea2000(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder of an NMEA 2000 bus, with the magnetic declination of the device in the rig."""
    from seatrial.daq.protocol import nmea2000

    return nmea2000.Decoder(device.declination)


BUILT_IN: dict[str, DeviceType] = {
    "vectornav": DeviceType(
        "VectorNav AHRS, ASCII and binary", SERIAL, _make_vectornav, (), (115200, 921600, 460800, 230400)
    ),
    "mip": DeviceType("MicroStrain inertial sensor, MIP", SERIAL, _make_mip, (), (115200, 921600, 460800, 230400)),
    "nmea": DeviceType("GNSS receiver or compass, NMEA 0183", SERIAL, _make_nmea, ("declination_deg",), GNSS_BAUDS),
    "ubx": DeviceType("u-blox GNSS receiver, UBX and NMEA mixed", SERIAL, _make_ubx, ("declination_deg",), GNSS_BAUDS),
    "loadcell": DeviceType(
        "load cell, one line of text per reading", SERIAL, _make_loadcell, ("pattern", "saturation", "calibration"),
        (115200, 9600, 57600, 38400),
    ),
    "openscale": DeviceType(
        "SparkFun OpenScale", SERIAL, _make_openscale, ("saturation", "calibration"), (9600, 115200, 57600, 38400)
    ),
    "mantracourt": DeviceType(
        "Mantracourt DSCUSB or DCell, one request per reading", SERIAL, _make_mantracourt,
        ("query", "saturation", "calibration"),
    ),
    "vesc": DeviceType("VESC speed controllers", CAN, _make_vesc, ("bitrate",)),
    "dbc": DeviceType("shaft speed from any CAN bus, by a DBC file", CAN, _make_dbc, ("bitrate", "dbc")),
    "dronecan": DeviceType("DroneCAN speed controllers", CAN, _make_dronecan, ("bitrate", "own_node", "index_offset")),
    "nmea2000": DeviceType(
        "ship's bus (NMEA 2000): compass, attitude, GNSS", CAN, _make_nmea2000, ("bitrate", "declination_deg")
    ),
    "mavlink": DeviceType(
        "autopilot: AHRS, GNSS, outputs, battery", NET, _make_mavlink, ("mavlink",), (57600, 115200, 921600),
        "pymavlink",
    ),
}  # fmt: skip


class DeviceTypes(Mapping[str, DeviceType]):
    """Mapping from the names of protocols to their descriptions: the built-in protocols, then those of other packages.

    The package of a protocol is imported when its description is read. `SeatrialError` is raised if the import fails,
    or if two packages add protocols with the same name.
    """

    def __getitem__(self, name: str) -> DeviceType:
        """Return the description of the protocol `name`.

        If a protocol with this name is built in and added by a package, the built-in one is returned.

        Raises
        ------
        KeyError
            If no package has the protocol.
        SeatrialError
            If the package of the protocol cannot be imported, or if it adds an object that is not a DeviceType.
        """
        if name in BUILT_IN:
            return BUILT_IN[name]
        return load_plugin(plugins(GROUP)[name], DeviceType)

    def __iter__(self) -> Iterator[str]:
        """Yield the names of all protocols, the built-in ones first.

        A protocol of another package with the name of a built-in one is left out, with a warning.
        """
        yield from BUILT_IN
        for name in plugins(GROUP):
            if name in BUILT_IN:
                warn(
                    f"a package adds a protocol {name!r} to {GROUP}, but this name is built in; the added protocol is "
                    "ignored: rename it in the package"
                )
            else:
                yield name

    def __len__(self) -> int:
        """Return the number of protocols, built-in and added ones.

        A name that is built in and added counts once.
        """
        return len(set(BUILT_IN) | set(plugins(GROUP)))

    def usable(self) -> dict[str, DeviceType]:
        """Return the descriptions of the protocols whose libraries are installed, by name, the built-in ones first.

        If the package that adds a protocol cannot be imported, the protocol is left out with a warning. A protocol
        whose library is missing is left out without a warning.
        """
        rows = {name: BUILT_IN.get(name) or load_or_warn(plugins(GROUP)[name], DeviceType) for name in self}
        return {name: row for name, row in rows.items() if row is not None and row.installed}


DEVICES = DeviceTypes()


def serial_protocols() -> tuple[str, ...]:
    """Return the names of the protocols of serial devices whose libraries are installed.

    Protocols of CAN buses, and protocols that also work on a socket (bus NET), such as mavlink, are not included. The
    built-in protocols come first.
    """
    return tuple(name for name, row in DEVICES.usable().items() if row.bus == SERIAL)


def make_decoder(device: Device, rig: Rig) -> Decoder:
    """Return a new decoder for a device of the rig, by the protocol of the device.

    Raises
    ------
    KeyError
        If the protocol is unknown.
    SeatrialError
        For example if the protocol of another package cannot be imported, or a file of the device cannot be read.
    """
    return DEVICES[device.protocol].make(device, rig)
