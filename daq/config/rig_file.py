"""Reader of rig.toml, which checks every key and returns a `seatrial.daq.rig.Rig` (docs/formats/rig.md)."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from seatrial.daq.config.toml_reader import ErrorCollector, TomlTable, parse_toml, read_text
from seatrial.daq.errors import SeatrialError
from seatrial.daq.protocol import BUILT_IN, CAN, DEVICES, Decoder, DeviceType, loadcell, make_decoder
from seatrial.daq.rig import (
    DEFAULT_PATTERN,
    DEFAULT_QUERY,
    DRIVES,
    ESC_FIELDS,
    HIGHEST_ID,
    NAME,
    NET_KINDS,
    OTHER_RATES,
    OWN_NODE,
    RATES,
    AutopilotOutput,
    DbcSignal,
    Device,
    Limits,
    Live,
    LoadCellCalibration,
    MavlinkSettings,
    Rig,
    Ros2,
    Segments,
    Thruster,
    parse_address,
)

FORMAT = "seatrial-rig 1"
LEAST_SEGMENTS = 3  # the first segment, the one that is being written, and one complete segment
HIGHEST_NODE = {"dronecan": 19}  # protocol -> largest node; a DroneCAN command has places for nodes 0 to 19


def load_rig(path: Path | str) -> Rig:
    """Read a rig file, check it and return its rig. Relative paths in the file count from the folder of the file.

    Raises
    ------
    SeatrialError
        If the file cannot be read, or if a key is missing, unknown or has a wrong value. The message names file and
        key.
    """
    path = Path(path)
    return parse_rig(read_text(path), path)


def parse_rig(text: str, source: Path | str, *, recorded: bool = False) -> Rig:
    """Check the text of a rig file and return its rig.

    Parameters
    ----------
    text
        Text of the file, in TOML.
    source
        Path of the file, which error messages name. The file itself is not read. Relative paths in the text count from
        its folder.
    recorded
        True if the text comes from a log. A protocol that is unknown or not installed here is then accepted, because
        the log contains its decoded samples. The options of a device with an unknown protocol are not checked. Ports
        are not checked, and a DBC file need not exist.

    Raises
    ------
    SeatrialError
        If a key is missing, unknown or has a wrong value; the message names file and key.
    """
    path = Path(source)
    folder = path.absolute().parent
    root = parse_toml(text, path)
    root.text("format", choices=(FORMAT,))
    name = root.line("name")
    errors = ErrorCollector()
    speed = errors.tried(lambda: _read_clock_speed(root), 1.0)
    directory, segments = errors.tried(lambda: _read_log(root), ("", Segments()))
    live = errors.tried(lambda: _read_live(root.table("live")), Live())
    ros2 = errors.tried(lambda: _read_ros2(root.table("ros2")), Ros2())
    read = [errors.tried(partial(_read_device, table, folder, recorded), None) for table in root.tables("device")]
    devices = tuple(device for device in read if device is not None)
    tables = root.tables("thruster")
    # A thruster names its device, which has to be known for its check.
    can_check = bool(devices) and len(devices) == len(read)
    known = [errors.tried(partial(_read_thruster, table, devices), None) for table in tables if can_check]
    thrusters = tuple(thruster for thruster in known if thruster is not None)
    limits = errors.tried(lambda: _read_limits(root.table("limits")), Limits())
    no_vehicle: dict[str, float] = {}
    vehicle = errors.tried(lambda: _read_vehicle(root.table("vehicle")), no_vehicle)
    timer = errors.tried(lambda: root.text("hardware_watchdog", ""), "")
    if read:
        errors.tried(root.done, None)
    errors.raise_all()
    if not devices:
        raise root.error(
            "device", f"missing; a rig needs at least one [[device]]: add one{root.misspelling_hint('device')}"
        )
    _check_unique(root, "device", [device.name for device in devices])
    if not recorded:  # nothing opens the ports of a log, and this computer may have other links to ports
        _check_ports_differ(root, devices)
    _check_unique(root, "thruster", [thruster.name for thruster in thrusters])
    _check_unique(root, "thruster", [f"{t.device} node {t.node}" for t in thrusters])
    # An RC override has one value per channel, so two thrusters on one channel would get the command of the last one.
    _check_unique(root, "thruster", [f"{t.device} rc_channel {t.output.rc_channel}" for t in thrusters if t.output])
    root.done()
    return Rig(
        name, path, text, speed, folder / directory, devices, thrusters, limits, vehicle, segments, live, ros2,
        Path(timer) if timer else None,
    )  # fmt: skip


def default_decoder(protocol: str) -> Decoder:
    """Return a new decoder of a serial protocol, as for a device in whose table only the required keys are given.

    Raises
    ------
    SeatrialError
        If the protocol is unknown, needs a CAN bus, or needs a package that is not installed.
    """
    device = f'[[device]]\nname = "a"\nprotocol = "{protocol}"\nport = "-"\nrate_hz = 1.0'
    text = f'format = "{FORMAT}"\nname = "-"\n{device}'
    rig = parse_rig(text, "-")
    return make_decoder(rig.devices[0], rig)


def _read_clock_speed(root: TomlTable) -> float:
    """Return `speed` of the table [clock] of a rig file, in run seconds per wall second; 1 without table or key.

    A speed that is not positive raises SeatrialError.
    """
    clock = root.table("clock")
    if clock is None:
        return 1.0
    speed = clock.number("speed", 1.0, positive=True)
    clock.done()
    return speed


def _read_log(root: TomlTable) -> tuple[str, Segments]:
    """Read the table [log] of a rig file: the folder of the logs, and the rules by which a log is split into files.

    The rules are `segment_mb` and `segment_s`, after which a new file begins; `free_mb`, the disk space that a new log
    needs; and `keep_gb`, the size at which old files are deleted. Without the table the folder is "logs" and the log is
    not split. The folder is returned as written. If `keep_gb` is given without `segment_mb` or `segment_s`, or is
    smaller than three times `segment_mb` (LEAST_SEGMENTS), SeatrialError is raised.
    """
    log = root.table("log")
    if log is None:
        return "logs", Segments()
    directory = log.text("directory", "logs")
    segments = Segments(
        log.maybe_number("segment_mb", low=1.0),
        log.maybe_number("segment_s", low=1.0),
        log.number("free_mb", Segments.free_megabytes, low=0.0),
        log.maybe_number("keep_gb", low=0.0),
    )
    if segments.keep_gigabytes is not None:
        if segments.megabytes is None and segments.seconds is None:
            raise log.error(
                "keep_gb",
                "works only for a log in segments, of which it deletes the oldest: give segment_mb or segment_s",
            )
        if 1e3 * segments.keep_gigabytes < LEAST_SEGMENTS * (segments.megabytes or 0.0):
            raise log.error(
                "keep_gb", f"must be at least {LEAST_SEGMENTS} times segment_mb; raise keep_gb, or lower segment_mb"
            )
    log.done()
    return directory, segments


def _read_live(table: TomlTable | None) -> Live:
    """Read the table [live] of a rig file: settings of the server for Foxglove. Return the defaults if it is None.

    They are its `host`, `port` (0: any free port) and `origins`, the sites whose web pages may connect. A missing key
    has its default. A port outside 0 to 65535 raises SeatrialError.
    """
    if table is None:
        return Live()
    port = table.integer("port", Live.port, low=0, high=65535)
    live = Live(table.text("host", Live.host), port, table.texts("origins", Live.origins))
    table.done()
    return live


def _read_ros2(table: TomlTable | None) -> Ros2:
    """Read the table [ros2] of a rig file: settings of the connection to ROS 2. Return the defaults if it is None.

    A router that is not tcp/HOST:PORT, and a namespace that is not a letter and then letters, digits or underscores,
    raise SeatrialError. The namespace may be empty.
    """
    if table is None:
        return Ros2()
    router, namespace = table.text("router", Ros2.router), table.text("namespace", Ros2.namespace)
    if not re.fullmatch(r"tcp/([\w.-]+|\[[0-9a-fA-F:]+\]):\d{1,5}", router, re.ASCII):
        raise table.error("router", f"must be tcp/HOST:PORT, not '{router}'")
    if namespace and not NAME.fullmatch(namespace):
        raise table.error(
            "namespace", f"'{namespace}' becomes a part of topics: use a letter, then letters, digits or _"
        )
    settings = Ros2(
        router,
        table.integer("domain", Ros2.domain, low=0, high=232),
        namespace,
        table.flag("commands", Ros2.commands),
        table.number("timeout_s", Ros2.timeout_s, low=0.05, high=2.0),
    )
    table.done()
    return settings


def _check_ports_differ(root: TomlTable, devices: Sequence[Device]) -> None:
    """Raise SeatrialError if two devices of a rig file have the same port. `root` names the file in the message.

    Several devices may share a CAN interface of the kernel (socketcan:), and a connection to a remote address (udpout:,
    tcp:). `udp:` and `udpin:` with the same address are the same port. Serial ports are the same if their paths, with
    or without "slcan:", lead to one file. Links such as those of /dev/serial/by-id are followed if they exist.
    """
    owner: dict[str, Device] = {}
    for device in devices:
        if device.port.startswith(("socketcan:", "udpout:", "tcp:")):
            continue
        port = device.port.removeprefix("udpin:").removeprefix("udp:")
        if port == device.port:
            path = port.removeprefix("slcan:")
            # Links that a mock has left behind may lead to one port that is gone: they are compared as texts.
            port = os.path.realpath(path) if os.path.exists(path) else os.path.abspath(path)
        if port in owner:
            other = owner[port]
            names = " or ".join(sorted({device.port, other.port}))
            raise root.error("device", f"{other.name} and {device.name} have the same port, {names}; give each its own")
        owner[port] = device


def _check_unique(root: TomlTable, key: str, names: Sequence[str]) -> None:
    """Raise SeatrialError for the first name that appears twice in a rig file.

    `names` are the names of all devices or thrusters, or other texts that must differ, such as "can0 node 3". `key` is
    "device" or "thruster" for the message, and `root` names the file.
    """
    for name in names:
        if names.count(name) > 1:
            raise root.error(key, f"'{name}' appears twice; give each {key} its own")


def _read_topic_name(table: TomlTable) -> str:
    """Return the key `name` of a [[device]] or [[thruster]] table. It becomes a part of the topics of the log.

    It must consist of a letter, and then letters, digits or underscores; otherwise SeatrialError is raised.
    """
    name = table.text("name")
    if not NAME.fullmatch(name):
        raise table.error("name", f"'{name}' becomes a topic of the log: use a letter, then letters, digits or _")
    return name


def _read_device(table: TomlTable, folder: Path, recorded: bool) -> Device:
    """Read one [[device]] table of a rig file, check it, and return the device. Relative paths count from `folder`.

    A protocol that is unknown or not installed, and a DBC file that does not exist, raise SeatrialError. If `recorded`
    is true, the rig file comes from a log, and these are accepted. The options of an unknown protocol are then neither
    read nor checked, and `port` is returned as written, without a check.
    """
    name = _read_topic_name(table)
    protocol = table.text("protocol")
    if protocol not in BUILT_IN and not recorded:
        # Packages are searched for protocols only if one is needed: the search would delay the start of every run.
        table.text("protocol", choices=tuple(DEVICES))
    row: DeviceType | None = None
    try:
        row = DEVICES[protocol]
    except (KeyError, SeatrialError):
        if not recorded:
            raise
    if row is not None and not row.installed and not recorded:
        raise table.error(
            "protocol", f"{protocol} needs the Python module {row.module}: pip install 'seatrial[{protocol}]'"
        )
    # Nothing opens the port of a device of a log, and without its protocol its options cannot be checked.
    port = table.text("port") if row is None or recorded else _read_port(table, protocol, row.bus, folder)
    baud = table.integer("baud", 115200, low=1)
    rate = table.number("rate_hz", positive=True)
    forward, starboard, down = table.numbers("lever_arm_m", (0.0, 0.0, 0.0), length=3)
    lever_arm = (forward, starboard, down)
    options: dict[str, Any] = {"bitrate": 0}
    if row is not None:
        options |= read_protocol_options(table, row.options, folder)
        table.done()
    if not recorded and "dbc" in options and not Path(options["dbc"]).is_file():
        raise table.error(
            "dbc", f"there is no file {options['dbc']}; correct the path, which starts at the folder of the rig file"
        )
    return Device(name, protocol, port, baud, rate_hz=rate, lever_arm_m=lever_arm, **options)


def _read_port(table: TomlTable, protocol: str, bus: str, folder: Path) -> str:
    """Return the key `port` of a device, after a check that fits its protocol and its `bus` (`CAN` or serial).

    A CAN bus needs slcan:SERIAL or socketcan:NAME. An autopilot (mavlink) may have a network address, which is checked.
    Any other text is taken for the path of a serial device. An empty text, slcan: or socketcan: without a CAN bus, and
    a network address of another device raise SeatrialError. It is not checked whether the port exists. Relative paths
    of serial devices, also behind "slcan:", are joined with `folder`. Names of CAN interfaces and network addresses are
    returned as written.
    """
    port = table.text("port")
    kind, colon, rest = port.partition(":")
    if bus == CAN:
        if kind not in ("slcan", "socketcan") or not rest:
            raise table.error("port", f"must be slcan:SERIAL or socketcan:NAME, not '{port}'")
        return port if kind == "socketcan" else f"slcan:{folder / rest}"
    if protocol == "mavlink" and kind in NET_KINDS:
        return _read_network_address(table, port)
    if not port or (colon and kind in ("slcan", "socketcan", *NET_KINDS)):
        only = "; only mavlink may have a network address" if kind in NET_KINDS else ""
        raise table.error(
            "port", f"must be a serial device (such as /dev/ttyUSB0) for protocol {protocol}, not '{port}'{only}"
        )
    return str(folder / port)


def _read_network_address(table: TomlTable, port: str) -> str:
    """Return the network address `port`, such as "udp:HOST:PORT", unchanged. A wrong one raises SeatrialError.

    `table` is the table of the device, which names file and key in the message.
    """
    try:
        parse_address(port)
    except ValueError as error:
        raise table.error("port", str(error)) from error
    return port


def read_protocol_options(table: TomlTable, names: Sequence[str], folder: Path) -> dict[str, Any]:
    """Read the keys of a [[device]] table that belong to its protocol, such as `bitrate` or `pattern`.

    Parameters
    ----------
    table
        Table of the device.
    names
        Names of the keys that the protocol has.
    folder
        Folder from which relative paths count.

    Returns
    -------
    dict
        Fields of `seatrial.daq.rig.Device` by name. Keys that only a protocol of another package has are together in
        the field `settings`. Their values must be texts, finite numbers or booleans, and are not checked further. The
        field is missing if the table has no such key.

    Raises
    ------
    SeatrialError
        If a key is missing or has a wrong value.
    """
    fields: dict[str, Any] = {}
    settings: dict[str, str | float | bool] = {}  # keys of a protocol of another package, which checks them itself
    for name in names:
        if name in _OPTION_READERS:
            fields |= _OPTION_READERS[name](table, folder)
        elif name in table.values:
            settings[name] = table.scalar(name)
    return {**fields, "settings": settings} if settings else fields


# Each of the following functions reads one option of a protocol. All have the same parameters and the same kind of
# result, because they are called by way of the table _OPTION_READERS. Most do not need `folder`.


def _read_bitrate(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Return {"bitrate": bit rate of a CAN bus [bit/s]} from the key `bitrate` of a [[device]]; at least 10 000.

    The default is 250 000 for NMEA 2000 and 500 000 otherwise. `folder` is not used.
    """
    usual = 250_000 if table.values.get("protocol") == "nmea2000" else 500_000
    return {"bitrate": table.integer("bitrate", usual, low=10_000)}


def _read_own_node(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Return {"own_node": number of this computer on a DroneCAN bus, 1 to 127} from the key `own_node` of a [[device]].

    The default is 100 (OWN_NODE). `folder` is not used.
    """
    return {"own_node": table.integer("own_node", OWN_NODE, low=1, high=127)}


def _read_index_offset(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Return {"index_offset": whole number, -19 to 19} from the key `index_offset` of a DroneCAN [[device]].

    It is the number of a speed controller in its telemetry minus its number in the commands; 0 by default. `folder` is
    not used.
    """
    return {"index_offset": table.integer("index_offset", 0, low=-19, high=19)}


def _read_pattern(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Return {"pattern": regular expression of a line of a load cell} from the key `pattern` of a [[device]].

    The default matches lines with one whole number. An expression that the decoder of load cells does not accept raises
    SeatrialError. `folder` is not used.
    """
    pattern = table.text("pattern", DEFAULT_PATTERN)
    try:
        loadcell.compile_pattern(pattern)
    except ValueError as error:
        raise table.error("pattern", str(error)) from error
    return {"pattern": pattern}


def _read_saturation(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Return {"saturation": counts at which the converter of a load cell is at its limit, at least 1}.

    The value is None if the [[device]] table lacks the key `saturation`. `folder` is not used.
    """
    return {"saturation": table.maybe_number("saturation", low=1.0)}


def _read_calibration(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Return {"calibration": LoadCellCalibration} from the table [device.calibration] of a load cell.

    The force is (counts - zero_counts) * newton_per_count * lever_ratio; only the gain `newton_per_count` is required.
    `zero_counts` is 0 and `lever_ratio` 1 by default. The standard deviations `newton_per_count_sd` and
    `lever_ratio_sd` are None if missing. The dictionary is empty if there is no such table. A gain of zero, and a
    `lever_ratio` that is not positive, raise SeatrialError. `folder` is not used.
    """
    inner = table.table("calibration")
    if inner is None:
        return {}
    gain = inner.number("newton_per_count")
    if gain == 0.0:
        raise inner.error("newton_per_count", "must not be zero; write the force per count of the load cell, in N")
    zero, ratio = inner.number("zero_counts", 0.0), inner.number("lever_ratio", 1.0, positive=True)
    gain_sd, ratio_sd = (inner.maybe_number(f"{name}_sd", low=0.0) for name in ("newton_per_count", "lever_ratio"))
    calibration = LoadCellCalibration(gain, zero, ratio, gain_sd, ratio_sd)
    inner.done()
    return {"calibration": calibration}


def _read_declination(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Return {"declination": magnetic declination [rad]} from the key `declination_deg` [deg] of a [[device]].

    The value is None if the table lacks the key. `folder` is not used.
    """
    degrees = table.maybe_number("declination_deg", low=-180.0, high=180.0)
    return {"declination": None if degrees is None else math.radians(degrees)}


def _read_query(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Return {"query": text that is sent to request a reading} from the key `query` of a [[device]].

    The default is that of a Mantracourt converter (DEFAULT_QUERY). The text must be printable ASCII and not empty.
    `folder` is not used.
    """
    query = table.text("query", DEFAULT_QUERY)
    if not (query.isascii() and query.isprintable() and query):
        raise table.error("query", "must be plain text, such as '!001:SYS?'")
    return {"query": query}


def _read_dbc(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Return {"dbc": path of the DBC file, "signals": tuple of DbcSignal} from the keys `dbc` and `signal` of a device.

    A relative path counts from `folder`. A name without folder and suffix stands for a DBC file of this package.
    Without a [[device.signal]], SeatrialError is raised. The file is not read here, and need not exist: the rig of a
    log may name a file of another computer.
    """
    name = table.text("dbc")
    rows = table.tables("signal")
    if not rows:
        raise table.error("signal", "missing; add a [[device.signal]], which maps a signal of the DBC file to a field")
    # A name without folder and suffix is a DBC file of seatrial itself.
    path = Path(__file__).parents[1] / "protocol" / f"{name}.dbc" if re.fullmatch(r"\w+", name) else folder / name
    return {"dbc": str(path), "signals": tuple(_read_dbc_signal(row) for row in rows)}


def _read_dbc_signal(table: TomlTable) -> DbcSignal:
    """Read one [[device.signal]] table, which maps a signal of a DBC file to a field of a speed controller's sample.

    `node` is the number of the controller, 0 to 255, or the name of the signal that contains it (SOURCE: the address of
    the sender). `scale` (1 by default) and `offset` (0) convert the value of the DBC file to the unit of the field. A
    field that a speed controller's sample lacks (ESC_FIELDS) raises SeatrialError. Whether the DBC file has the message
    and the signal is not checked here.
    """
    by_name = isinstance(table.values.get("node"), str)
    node: int | str = table.text("node") if by_name else table.integer("node", low=0, high=255)
    signal = DbcSignal(
        table.text("message"),
        table.text("signal"),
        table.text("field", choices=ESC_FIELDS),
        node,
        table.number("scale", 1.0),
        table.number("offset", 0.0),
    )
    table.done()
    return signal


def read_mavlink_settings(table: TomlTable, folder: Path) -> MavlinkSettings:
    """Read the MAVLink keys of a [[device]] table: ids, signing key, source of the fixes and message rates.

    Missing keys have the defaults of `MavlinkSettings`. A relative path of `key_file` counts from `folder`.

    Raises
    ------
    SeatrialError
        If a key has a wrong value, or if this computer has the system id of the autopilot.
    """
    key = table.text("key_file", "")
    system = table.integer("system_id", 1, low=1, high=HIGHEST_ID)
    own_system = table.integer("own_system_id", 255, low=1, high=HIGHEST_ID)
    if own_system == system:
        raise table.error("own_system_id", f"{own_system} is the system_id of the autopilot; give another")
    return MavlinkSettings(
        system,
        table.integer("component_id", 1, low=1, high=HIGHEST_ID),
        own_system,
        table.integer("own_component_id", 190, low=1, high=HIGHEST_ID),
        folder / key if key else None,
        table.text("gnss", "raw", choices=("raw", "fused")),
        _read_message_rates(table),
    )


def _read_mavlink(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Return {"mavlink": MavlinkSettings} from the MAVLink keys of a [[device]] (ids, signing key, message rates).

    A relative path of the signing key counts from `folder`. A wrong value raises SeatrialError.
    """
    return {"mavlink": read_mavlink_settings(table, folder)}


def _read_message_rates(table: TomlTable) -> dict[str, float]:
    """Read the table [device.rates] of a [[device]]: rates [Hz], 0 to 1000, by name of the MAVLink message.

    A message with rate 0 is not requested. The dictionary is empty without the table. A message that is not in RATES or
    OTHER_RATES raises SeatrialError.
    """
    rates: dict[str, float] = {}
    inner = table.table("rates")
    if inner is not None:
        for name in inner.values:
            if name not in RATES and name not in OTHER_RATES:
                raise inner.error(name, f"not a supported message; use one of {', '.join((*RATES, *OTHER_RATES))}")
            rates[name] = inner.number(name, low=0.0, high=1000.0)
        inner.done()
    return rates


_OPTION_READERS: dict[str, Callable[[TomlTable, Path], dict[str, Any]]] = {
    "mavlink": _read_mavlink, "own_node": _read_own_node, "index_offset": _read_index_offset,
    "bitrate": _read_bitrate, "pattern": _read_pattern, "saturation": _read_saturation,
    "calibration": _read_calibration, "declination_deg": _read_declination, "query": _read_query, "dbc": _read_dbc,
}  # fmt: skip


def _read_thruster(table: TomlTable, devices: Sequence[Device]) -> Thruster:
    """Read one [[thruster]], whose device must be one of `devices` and must have a protocol that drives thrusters.

    These protocols are vesc, dronecan and mavlink (an autopilot). `node` is 0 to 255, on a DroneCAN bus at most 19, and
    behind an autopilot 1 to 16. Behind an autopilot `pole_pairs` is an unknown key, and `rpm_max` may be missing; it is
    then NaN. On a DroneCAN bus `pole_pairs` may be missing. It is then 1. A wrong value raises SeatrialError.
    """
    name = _read_topic_name(table)
    device = table.text("device")
    buses = {row.name: row.protocol for row in devices if row.protocol in DRIVES}
    if device not in buses:
        known = ", ".join(buses) or "none"
        raise table.error(
            "device", f"the rig has no device '{device}' of protocol {' or '.join(DRIVES)}; such devices: {known}"
        )
    forward, starboard, down = table.numbers("position_m", length=3)
    node = table.integer("node", low=0, high=HIGHEST_NODE.get(buses[device], 255))
    autopilot = buses[device] == "mavlink"
    # The poles of the motor are not needed if the controller reports the speed of the shaft, or no speed.
    no_poles = autopilot or (buses[device] == "dronecan" and not table.has("pole_pairs"))
    thruster = Thruster(
        name,
        device,
        node,
        (forward, starboard, down),
        1 if no_poles else table.integer("pole_pairs", low=1, high=100),
        math.nan if autopilot and not table.has("rpm_max") else table.number("rpm_max", positive=True),
        table.flag("reversed", False),
        table.number("timeout_s", 1.0, positive=True),
        read_autopilot_output(table, node) if autopilot else None,
    )
    table.done()
    return thruster


def read_autopilot_output(table: TomlTable, node: int) -> AutopilotOutput:
    """Read the keys of a [[thruster]] behind an autopilot. `node` is the number of its servo output.

    `rc_channel` is the channel that commands it. Without `rc_us` the pulses of the channel are 1000, 1500 and 2000 us,
    and without `pwm_us` those of the output are 1100, 1500 and 1900 us (full reverse, neutral, full forward).

    Raises
    ------
    SeatrialError
        If `node` is not 1 to 16, or if a key is missing or has a wrong value.
    """
    if not 1 <= node <= 16:
        raise table.error("node", f"must be the number of a servo output, 1 .. 16, not {node}")
    return AutopilotOutput(
        table.integer("rc_channel", low=1, high=18),
        _read_pulse_widths(table, "rc_us", (1000.0, 1500.0, 2000.0)),
        _read_pulse_widths(table, "pwm_us", (1100.0, 1500.0, 1900.0)),
    )


def _read_pulse_widths(table: TomlTable, key: str, default: tuple[float, float, float]) -> tuple[float, float, float]:
    """Return the pulse widths [us] in the list `key` of a [[thruster]]: full reverse, neutral and full forward.

    They must ascend within 500 to 2500 us; otherwise SeatrialError is raised. Without the key return `default`.
    """
    low, neutral, high = table.numbers(key, default, length=3)
    if not 500.0 <= low < neutral < high <= 2500.0:
        raise table.error(key, "must be [full reverse, neutral, full forward] in us, ascending, within 500 .. 2500")
    return low, neutral, high


def _read_limits(table: TomlTable | None) -> Limits:
    """Read the table [limits], the values at which a run ends. Return the defaults if there is no table.

    A limit that is missing is None: it does not apply. Only `n_max` (1) and `link_test_n` have other defaults. The list
    `unwatched` has limits that a run may have without a device that reports their quantity. It may contain limits that
    are in the table, and "telemetry": reports of speed controllers are not compared with their commands. `n_max` and
    `link_test_n` are not monitored and must not be in it.
    """
    if table is None:
        return Limits()
    unwatched = table.texts("unwatched", ())
    for key in unwatched:
        if key != "telemetry" and (key in ("n_max", "link_test_n", "unwatched") or not table.has(key)):
            raise table.error(
                "unwatched", f"'{key}' is not a limit that [limits] sets; name one of those, or 'telemetry'"
            )
    limits = Limits(
        table.number("n_max", 1.0, low=0.0, high=1.0),
        table.maybe_number("force_n", low=0.0),
        table.maybe_number("current_a", low=0.0),
        table.maybe_number("temperature_c"),
        table.maybe_number("voltage_min_v", low=0.0),
        table.maybe_number("radius_m", low=0.0),
        table.maybe_number("rpm", low=0.0),
        table.maybe_number("roll_deg", low=0.0),
        table.maybe_number("pitch_deg", low=0.0),
        table.number("battery_min", low=0.0, high=1.0) if table.has("battery_min") else None,
        table.number("link_test_n", Limits.link_test_n, low=0.0, high=1.0),
        unwatched,
    )
    table.done()
    return limits


def _read_vehicle(table: TomlTable | None) -> dict[str, float]:
    """Read the table [vehicle] of a rig file: known values of model parameters by name; empty if `table` is None.

    Any name of a parameter is allowed, because the model may be user-defined. A value that is not a finite number
    raises SeatrialError.
    """
    return {} if table is None else table.named_numbers()
