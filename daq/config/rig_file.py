"""Reader of rig.toml, which checks every key and returns a `seatrial.daq.rig.Rig` (docs/formats/rig.md)."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from seatrial.daq.config.toml_reader import TomlTable, parse_toml, read_text
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
        True if the text comes from a log. A protocol that is not installed here is then accepted, because the log
        contains its decoded samples, and the options of that device are not checked.

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
    speed = _read_clock_speed(root)
    directory, segments = _read_log(root)
    live = _read_live(root.table("live"))
    ros2 = _read_ros2(root.table("ros2"))
    devices = tuple(_read_device(table, folder, recorded) for table in root.tables("device"))
    if not devices:
        raise root.error("device", "missing; a rig needs at least one [[device]]: add one")
    _check_unique(root, "device", [device.name for device in devices])
    _check_ports_differ(root, devices)
    thrusters = tuple(_read_thruster(table, devices) for table in root.tables("thruster"))
    _check_unique(root, "thruster", [thruster.name for thruster in thrusters])
    _check_unique(root, "thruster", [f"{t.device} node {t.node}" for t in thrusters])
    # An RC override has one value per channel, so two thrusters on one channel would get the command of the last one.
    _check_unique(root, "thruster", [f"{t.device} rc_channel {t.output.rc_channel}" for t in thrusters if t.output])
    limits = _read_limits(root.table("limits"))
    vehicle = _read_vehicle(root.table("vehicle"))
    timer = root.text("hardware_watchdog", "")
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
    """Return `speed` of the table [clock] of a rig file, in run seconds per wall second; 1 without the table."""
    clock = root.table("clock")
    if clock is None:
        return 1.0
    speed = clock.number("speed", 1.0, positive=True)
    clock.done()
    return speed


def _read_log(root: TomlTable) -> tuple[str, Segments]:
    """Read the table [log] of a rig file: the folder of the logs, and the rules by which a log is split into files.

    Without the table the folder is "logs" and the rules are the defaults. The folder is returned as written. If the
    disk space `keep_gb` is smaller than 3 files of a log (LEAST_SEGMENTS), SeatrialError is raised.
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
    """Read the table [live], the address of the server for Foxglove. Return the defaults if there is no table."""
    if table is None:
        return Live()
    port = table.integer("port", Live.port, low=0, high=65535)
    live = Live(table.text("host", Live.host), port, table.texts("origins", Live.origins))
    table.done()
    return live


def _read_ros2(table: TomlTable | None) -> Ros2:
    """Read the table [ros2], the connection to ROS 2. Return the defaults if there is no table."""
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
    """Raise SeatrialError if two devices have the same port.

    Several devices may share a CAN interface of the kernel, and a connection to a remote address.
    """
    owner: dict[str, str] = {}
    for device in devices:
        if device.port.startswith(("socketcan:", "udpout:", "tcp:")):
            continue
        port = device.port.removeprefix("udpin:").removeprefix("udp:")
        if port in owner:
            raise root.error(
                "device", f"{owner[port]} and {device.name} have the same port, {device.port}; give each its own"
            )
        owner[port] = device.name


def _check_unique(root: TomlTable, key: str, names: Sequence[str]) -> None:
    """Raise SeatrialError for the first name that appears twice in a rig file.

    `names` are the names of all devices or thrusters. The message contains `key`, "device" or "thruster".
    """
    for name in names:
        if names.count(name) > 1:
            raise root.error(key, f"'{name}' appears twice; give each {key} its own")


def _read_topic_name(table: TomlTable) -> str:
    """Return `name` of a device or thruster. It must consist of a letter, and then letters, digits or underscores."""
    name = table.text("name")
    if not NAME.fullmatch(name):
        raise table.error("name", f"'{name}' becomes a topic of the log: use a letter, then letters, digits or _")
    return name


def _read_device(table: TomlTable, folder: Path, recorded: bool) -> Device:
    """Read one [[device]]. Relative paths count from `folder`.

    If `recorded` is true, the device is that of a log: its protocol need not be installed, and the options of an
    unknown protocol are neither read nor checked.
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
    # Without its protocol, port and options of a device of a log cannot be checked, and nothing opens them.
    port = table.text("port") if row is None else _read_port(table, protocol, row.bus, folder)
    baud = table.integer("baud", 115200, low=1)
    rate = table.number("rate_hz", positive=True)
    forward, starboard, down = table.numbers("lever_arm_m", (0.0, 0.0, 0.0), length=3)
    lever_arm = (forward, starboard, down)
    options: dict[str, Any] = {"bitrate": 0}
    if row is not None:
        options |= read_protocol_options(table, row.options, folder)
        table.done()
    return Device(name, protocol, port, baud, rate_hz=rate, lever_arm_m=lever_arm, **options)


def _read_port(table: TomlTable, protocol: str, bus: str, folder: Path) -> str:
    """Return `port` of a device, checked for its protocol and its `bus` (`CAN` or serial).

    Relative paths of serial devices, also behind "slcan:", are joined with `folder`. Names of CAN interfaces and
    network addresses are returned as written.
    """
    port = table.text("port")
    kind, colon, rest = port.partition(":")
    if bus == CAN:
        if kind not in ("slcan", "socketcan") or not rest:
            raise table.error("port", f"must be slcan:SERIAL or socketcan:NAME, not '{port}'")
        return port if kind == "socketcan" else f"slcan:{folder / rest}"
    if protocol == "mavlink" and kind in NET_KINDS:
        return _read_network_address(table, port)
    if not port or (colon and kind in ("slcan", "socketcan")):
        raise table.error(
            "port", f"must be a serial device (such as /dev/ttyUSB0) for protocol {protocol}, not '{port}'"
        )
    return str(folder / port)


def _read_network_address(table: TomlTable, port: str) -> str:
    """Return the network address `port`, such as "udp:HOST:PORT", unchanged. A wrong one raises SeatrialError."""
    try:
        parse_address(port)
    except ValueError as error:
        raise table.error("port", str(error)) from error
    return port


def read_protocol_options(table: TomlTable, names: Sequence[str], folder: Path) -> dict[str, Any]:
    """Read the keys of a device that belong to its protocol.

    Parameters
    ----------
    table
        Table of the device.
    names
        Names of the keys.
    folder
        Folder from which relative paths count.

    Returns
    -------
    dict
        Fields of `seatrial.daq.rig.Device` by name. Keys that only a protocol of another package has are together in
        the field `settings`, unchecked. The field is missing if the table has no such key.

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


# Each of the following functions reads one option of a protocol, and returns fields of `Device` by name. `folder` is
# the folder from which relative paths count; most options do not need it.


def _read_bitrate(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Read `bitrate` [bit/s] of a CAN bus; the default is 250 000 for NMEA 2000 and 500 000 otherwise."""
    usual = 250_000 if table.values.get("protocol") == "nmea2000" else 500_000
    return {"bitrate": table.integer("bitrate", usual, low=10_000)}


def _read_own_node(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Read `own_node`, the number of this computer on a DroneCAN bus, 1 to 127."""
    return {"own_node": table.integer("own_node", OWN_NODE, low=1, high=127)}


def _read_index_offset(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Read `index_offset` of a DroneCAN bus: the number of a controller in its telemetry minus that in its commands.

    It is a whole number, -19 to 19.
    """
    return {"index_offset": table.integer("index_offset", 0, low=-19, high=19)}


def _read_pattern(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Read `pattern`, the regular expression of the lines of a load cell, and check that it can be compiled."""
    pattern = table.text("pattern", DEFAULT_PATTERN)
    try:
        loadcell.compile_pattern(pattern)
    except ValueError as error:
        raise table.error("pattern", str(error)) from error
    return {"pattern": pattern}


def _read_saturation(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Read `saturation`, the counts at which the converter of a load cell is at its limit; None if it is not given."""
    return {"saturation": table.maybe_number("saturation", low=1.0)}


def _read_calibration(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Read the table [device.calibration] of a load cell. Return no field if there is no table."""
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
    """Read `declination_deg`, the magnetic declination, and convert it to rad; None if it is not given."""
    degrees = table.maybe_number("declination_deg", low=-180.0, high=180.0)
    return {"declination": None if degrees is None else math.radians(degrees)}


def _read_query(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Read `query`, the printable ASCII text that requests a reading from a device."""
    query = table.text("query", DEFAULT_QUERY)
    if not (query.isascii() and query.isprintable() and query):
        raise table.error("query", "must be plain text, such as '!001:SYS?'")
    return {"query": query}


def _read_dbc(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Read `dbc`, the path of the DBC file of a device, and its [[device.signal]] tables.

    A name without folder and suffix stands for a DBC file of this package. The file must exist, and there must be at
    least one signal.
    """
    name = table.text("dbc")
    rows = table.tables("signal")
    if not rows:
        raise table.error("signal", "missing; add a [[device.signal]], which maps a signal of the DBC file to a field")
    # A name without folder and suffix is a DBC file of seatrial itself.
    path = Path(__file__).parents[1] / "protocol" / f"{name}.dbc" if re.fullmatch(r"\w+", name) else folder / name
    if not path.is_file():
        raise table.error(
            "dbc", f"there is no file {path}; correct the path, which starts at the folder of the rig file"
        )
    return {"dbc": str(path), "signals": tuple(_read_dbc_signal(row) for row in rows)}


def _read_dbc_signal(table: TomlTable) -> DbcSignal:
    """Read one [[device.signal]]. Its `node` is a number, 0 to 255, or the name of a signal with the number."""
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
    """Read the MAVLink keys of a [[device]]. Relative paths count from `folder`.

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
    """Read the MAVLink keys of a [[device]] as the field `mavlink`."""
    return {"mavlink": read_mavlink_settings(table, folder)}


def _read_message_rates(table: TomlTable) -> dict[str, float]:
    """Read the table [device.rates]: rates [Hz], 0 to 1000, by name of the MAVLink message; empty without a table."""
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

    Behind an autopilot `pole_pairs` is not read, and `rpm_max` may be missing; it is then NaN. On a DroneCAN bus
    `pole_pairs` may be missing.
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
    """Return the pulse widths [us] of full reverse, neutral and full forward. They must ascend within 500 to 2500."""
    low, neutral, high = table.numbers(key, default, length=3)
    if not 500.0 <= low < neutral < high <= 2500.0:
        raise table.error(key, "must be [full reverse, neutral, full forward] in us, ascending, within 500 .. 2500")
    return low, neutral, high


def _read_limits(table: TomlTable | None) -> Limits:
    """Read the table [limits], the values at which a run ends. Return the defaults if there is no table.

    The list `unwatched` may contain "telemetry", and limits that are in the table. `n_max` and `link_test_n` are not
    monitored and must not be in it.
    """
    if table is None:
        return Limits()
    unwatched = table.texts("unwatched", ())
    for key in unwatched:
        if key != "telemetry" and (key in ("n_max", "link_test_n") or not table.has(key)):
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
    """Read the table [vehicle]: known values of model parameters by name; empty without a table.

    Any name of a parameter is allowed, because the model may be user-defined.
    """
    return {} if table is None else table.named_numbers()
