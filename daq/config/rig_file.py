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
    """Read and check a rig file.

    Raises
    ------
    SeatrialError
        If the file cannot be read, or if a key is missing, unknown or has a wrong value. The message names file and
        key.
    """
    path = Path(path)
    return parse_rig(read_text(path), path)


def parse_rig(text: str, source: Path | str, *, recorded: bool = False) -> Rig:
    """Check a rig file given as text.

    Parameters
    ----------
    source
        Path that error messages name. Relative paths in the text count from its folder.
    recorded
        The rig is that of a log. A protocol that is not installed here is accepted, because the log contains its
        samples.

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
    speed = _speed(root)
    directory, segments = _log(root)
    live = _live(root.table("live"))
    ros2 = _ros2(root.table("ros2"))
    devices = tuple(_device(table, folder, recorded) for table in root.tables("device"))
    if not devices:
        raise root.error("device", "missing; a rig needs at least one [[device]]")
    _unique(root, "device", [device.name for device in devices])
    _own_ports(root, devices)
    thrusters = tuple(_thruster(table, devices) for table in root.tables("thruster"))
    _unique(root, "thruster", [thruster.name for thruster in thrusters])
    _unique(root, "thruster", [f"{t.device} node {t.node}" for t in thrusters])
    # An RC override has one value per channel, so two thrusters on one channel would get the command of the last one.
    _unique(root, "thruster", [f"{t.device} rc_channel {t.output.rc_channel}" for t in thrusters if t.output])
    limits = _limits(root.table("limits"))
    vehicle = _vehicle(root.table("vehicle"))
    timer = root.text("hardware_watchdog", "")
    root.done()
    return Rig(
        name, path, text, speed, folder / directory, devices, thrusters, limits, vehicle, segments, live, ros2,
        Path(timer) if timer else None,
    )  # fmt: skip


def default_decoder(protocol: str) -> Decoder:
    """Return the decoder of a serial protocol with default values for all keys of its device."""
    device = f'[[device]]\nname = "a"\nprotocol = "{protocol}"\nport = "-"\nrate_hz = 1.0'
    text = f'format = "{FORMAT}"\nname = "-"\n{device}'
    rig = parse_rig(text, "-")
    return make_decoder(rig.devices[0], rig)


def _speed(root: TomlTable) -> float:
    clock = root.table("clock")
    if clock is None:
        return 1.0
    speed = clock.number("speed", 1.0, positive=True)
    clock.done()
    return speed


def _log(root: TomlTable) -> tuple[str, Segments]:
    """Read the table [log]: the folder of the logs and their segments."""
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
            raise log.error("keep_gb", "needs a log in segments, the oldest is deleted: give segment_mb or segment_s")
        if 1e3 * segments.keep_gigabytes < LEAST_SEGMENTS * (segments.megabytes or 0.0):
            raise log.error("keep_gb", f"must be at least {LEAST_SEGMENTS} segments of segment_mb")
    log.done()
    return directory, segments


def _live(table: TomlTable | None) -> Live:
    if table is None:
        return Live()
    port = table.integer("port", Live.port, low=0, high=65535)
    live = Live(table.text("host", Live.host), port, table.texts("origins", Live.origins))
    table.done()
    return live


def _ros2(table: TomlTable | None) -> Ros2:
    """Read the table [ros2]."""
    if table is None:
        return Ros2()
    router, namespace = table.text("router", Ros2.router), table.text("namespace", Ros2.namespace)
    if not re.fullmatch(r"tcp/([\w.-]+|\[[0-9a-fA-F:]+\]):\d{1,5}", router, re.ASCII):
        raise table.error("router", f"must be tcp/HOST:PORT, not '{router}'")
    if namespace and not NAME.fullmatch(namespace):
        raise table.error("namespace", f"'{namespace}' becomes a part of topics: a letter, then letters, digits or _")
    settings = Ros2(
        router,
        table.integer("domain", Ros2.domain, low=0, high=232),
        namespace,
        table.flag("commands", Ros2.commands),
        table.number("timeout_s", Ros2.timeout_s, low=0.05, high=2.0),
    )
    table.done()
    return settings


def _own_ports(root: TomlTable, devices: Sequence[Device]) -> None:
    """Check that no two devices have the same port.

    Several devices may share a CAN interface of the kernel, and a connection to a remote address.
    """
    owner: dict[str, str] = {}
    for device in devices:
        if device.port.startswith(("socketcan:", "udpout:", "tcp:")):
            continue
        port = device.port.removeprefix("udpin:").removeprefix("udp:")
        if port in owner:
            raise root.error("device", f"{owner[port]} and {device.name} have the same port, {device.port}")
        owner[port] = device.name


def _unique(root: TomlTable, key: str, names: Sequence[str]) -> None:
    for name in names:
        if names.count(name) > 1:
            raise root.error(key, f"'{name}' appears twice; give each its own")


def _name(table: TomlTable) -> str:
    name = table.text("name")
    if not NAME.fullmatch(name):
        raise table.error("name", f"'{name}' becomes a topic of the log: a letter, then letters, digits or _")
    return name


def _device(table: TomlTable, folder: Path, recorded: bool) -> Device:
    """Read one [[device]]. If `recorded` is true, its protocol need not be installed (`parse_rig`)."""
    name = _name(table)
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
    port = table.text("port") if row is None else _port(table, protocol, row.bus, folder)
    baud = table.integer("baud", 115200, low=1)
    rate = table.number("rate_hz", positive=True)
    forward, starboard, down = table.numbers("lever_arm_m", (0.0, 0.0, 0.0), length=3)
    lever_arm = (forward, starboard, down)
    options: dict[str, Any] = {"bitrate": 0}
    if row is not None:
        options |= read_options(table, row.options, folder)
        table.done()
    return Device(name, protocol, port, baud, rate_hz=rate, lever_arm_m=lever_arm, **options)


def _port(table: TomlTable, protocol: str, bus: str, folder: Path) -> str:
    """Read the port of a device. Relative paths of serial devices count from `folder`."""
    port = table.text("port")
    kind, colon, rest = port.partition(":")
    if bus == CAN:
        if kind not in ("slcan", "socketcan") or not rest:
            raise table.error("port", f"must be slcan:SERIAL or socketcan:NAME, not '{port}'")
        return port if kind == "socketcan" else f"slcan:{folder / rest}"
    if protocol == "mavlink" and kind in NET_KINDS:
        return _address(table, port)
    if not port or (colon and kind in ("slcan", "socketcan")):
        raise table.error("port", f"must be a serial device for protocol {protocol}, not '{port}'")
    return str(folder / port)


def _address(table: TomlTable, port: str) -> str:
    try:
        parse_address(port)
    except ValueError as error:
        raise table.error("port", str(error)) from error
    return port


def read_options(table: TomlTable, names: Sequence[str], folder: Path) -> dict[str, Any]:
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
        Fields of `seatrial.daq.rig.Device` by name.

    Raises
    ------
    SeatrialError
        If a key is missing or has a wrong value.
    """
    fields: dict[str, Any] = {}
    settings: dict[str, str | float | bool] = {}  # keys of a protocol of another package, which checks them itself
    for name in names:
        if name in _READ:
            fields |= _READ[name](table, folder)
        elif name in table.values:
            settings[name] = table.scalar(name)
    return {**fields, "settings": settings} if settings else fields


def _bitrate(table: TomlTable, folder: Path) -> dict[str, Any]:
    usual = 250_000 if table.values.get("protocol") == "nmea2000" else 500_000
    return {"bitrate": table.integer("bitrate", usual, low=10_000)}


def _own_node(table: TomlTable, folder: Path) -> dict[str, Any]:
    return {"own_node": table.integer("own_node", OWN_NODE, low=1, high=127)}


def _index_offset(table: TomlTable, folder: Path) -> dict[str, Any]:
    return {"index_offset": table.integer("index_offset", 0, low=-19, high=19)}


def _pattern(table: TomlTable, folder: Path) -> dict[str, Any]:
    pattern = table.text("pattern", DEFAULT_PATTERN)
    try:
        loadcell.compile_pattern(pattern)
    except ValueError as error:
        raise table.error("pattern", str(error)) from error
    return {"pattern": pattern}


def _saturation(table: TomlTable, folder: Path) -> dict[str, Any]:
    return {"saturation": table.maybe_number("saturation", low=1.0)}


def _calibration(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Read the table [device.calibration] of a load cell."""
    inner = table.table("calibration")
    if inner is None:
        return {}
    gain = inner.number("newton_per_count")
    if gain == 0.0:
        raise inner.error("newton_per_count", "must not be zero")
    zero, ratio = inner.number("zero_counts", 0.0), inner.number("lever_ratio", 1.0, positive=True)
    gain_sd, ratio_sd = (inner.maybe_number(f"{name}_sd", low=0.0) for name in ("newton_per_count", "lever_ratio"))
    calibration = LoadCellCalibration(gain, zero, ratio, gain_sd, ratio_sd)
    inner.done()
    return {"calibration": calibration}


def _declination(table: TomlTable, folder: Path) -> dict[str, Any]:
    degrees = table.maybe_number("declination_deg", low=-180.0, high=180.0)
    return {"declination": None if degrees is None else math.radians(degrees)}


def _query(table: TomlTable, folder: Path) -> dict[str, Any]:
    query = table.text("query", DEFAULT_QUERY)
    if not (query.isascii() and query.isprintable() and query):
        raise table.error("query", "must be plain text, such as '!001:SYS?'")
    return {"query": query}


def _dbc(table: TomlTable, folder: Path) -> dict[str, Any]:
    """Read the DBC file of a device and the signals to read from the bus."""
    name = table.text("dbc")
    rows = table.tables("signal")
    if not rows:
        raise table.error("signal", "missing; a [[device.signal]] maps a signal of the DBC to a field")
    # A name without folder and suffix is a DBC file of seatrial itself.
    path = Path(__file__).parents[1] / "protocol" / f"{name}.dbc" if re.fullmatch(r"\w+", name) else folder / name
    if not path.is_file():
        raise table.error("dbc", f"there is no file {path}")
    return {"dbc": str(path), "signals": tuple(_signal(row) for row in rows)}


def _signal(table: TomlTable) -> DbcSignal:
    """Read one [[device.signal]]. Its node is a number or the name of a signal."""
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


def read_settings(table: TomlTable, folder: Path) -> MavlinkSettings:
    """Read the MAVLink keys of a [[device]]. Relative paths count from `folder`."""
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
        _rates(table),
    )


def _mavlink(table: TomlTable, folder: Path) -> dict[str, Any]:
    return {"mavlink": read_settings(table, folder)}


def _rates(table: TomlTable) -> dict[str, float]:
    """Read the table [device.rates]: rates [Hz] by name of the message."""
    rates: dict[str, float] = {}
    inner = table.table("rates")
    if inner is not None:
        for name in inner.values:
            if name not in RATES and name not in OTHER_RATES:
                raise inner.error(name, f"not a supported message; known: {', '.join((*RATES, *OTHER_RATES))}")
            rates[name] = inner.number(name, low=0.0, high=1000.0)
        inner.done()
    return rates


_READ: dict[str, Callable[[TomlTable, Path], dict[str, Any]]] = {
    "mavlink": _mavlink, "own_node": _own_node, "index_offset": _index_offset,
    "bitrate": _bitrate, "pattern": _pattern, "saturation": _saturation, "calibration": _calibration,
    "declination_deg": _declination, "query": _query, "dbc": _dbc,
}  # fmt: skip


def _thruster(table: TomlTable, devices: Sequence[Device]) -> Thruster:
    """Read one [[thruster]]."""
    name = _name(table)
    device = table.text("device")
    buses = {row.name: row.protocol for row in devices if row.protocol in DRIVES}
    if device not in buses:
        known = ", ".join(buses) or "none"
        raise table.error("device", f"no {' or '.join(DRIVES)} device '{device}'; there is: {known}")
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
        read_output(table, node) if autopilot else None,
    )
    table.done()
    return thruster


def read_output(table: TomlTable, node: int) -> AutopilotOutput:
    """Read the MAVLink keys of a [[thruster]] at servo output `node`."""
    if not 1 <= node <= 16:
        raise table.error("node", f"must be the number of a servo output, 1 .. 16, not {node}")
    return AutopilotOutput(
        table.integer("rc_channel", low=1, high=18),
        _pulses(table, "rc_us", (1000.0, 1500.0, 2000.0)),
        _pulses(table, "pwm_us", (1100.0, 1500.0, 1900.0)),
    )


def _pulses(table: TomlTable, key: str, default: tuple[float, float, float]) -> tuple[float, float, float]:
    """Read the pulses [us] of full reverse, neutral and full forward."""
    low, neutral, high = table.numbers(key, default, length=3)
    if not 500.0 <= low < neutral < high <= 2500.0:
        raise table.error(key, "must be [full reverse, neutral, full forward] in us, ascending, within 500 .. 2500")
    return low, neutral, high


def _limits(table: TomlTable | None) -> Limits:
    """Read the table [limits]."""
    if table is None:
        return Limits()
    unwatched = table.texts("unwatched", ())
    for key in unwatched:
        if key != "telemetry" and (key in ("n_max", "link_test_n") or not table.has(key)):
            raise table.error("unwatched", f"'{key}' is not a limit of this table; give 'telemetry' or a limit in it")
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


def _vehicle(table: TomlTable | None) -> dict[str, float]:
    """Read the table [vehicle]. Any name of a parameter is allowed, because the model may be user-defined."""
    return {} if table is None else table.named_numbers()
