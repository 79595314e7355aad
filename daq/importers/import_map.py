"""The map of `seatrial import`: which columns of which topics become which signals (docs/formats/import.md)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import zip_longest
from pathlib import Path

from seatrial.daq.config import TomlTable, parse_toml, read_text
from seatrial.daq.importers.table import SourceOptions, TextStyle
from seatrial.daq.importers.units import UNITS
from seatrial.daq.rig import NAME

# Every map of the second kind is one of the first, but keeps repeats unless it says otherwise.
FORMATS = ("seatrial-import 1", "seatrial-import-csv 1")
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "day": 86400.0}
DAY_COUNTS = {"datenum": 719529.0, "excel": 25569.0, "excel1904": 24107.0}  # formats of days: 1970-01-01 in each
GPS_UNITS = {"gps": 1.0, "gps_ms": 1e-3}  # formats of times of a GPS week [s]
FORMATS_OF_TIME = (*TIME_UNITS, "iso", *DAY_COUNTS, "labview", *GPS_UNITS)
GEOMETRY = ("y_left", "y_right", "length")  # thrusters to starboard, and the hull's length [m]
FRAMES = {"NED": "NED", "FRD": "NED", "ENU": "ENU", "FLU": "ENU"}
CAN_PROTOCOLS = ("vesc", "dronecan", "nmea2000")
# What becomes what from east, north, up and forward, left, up to north, east, down and forward, starboard, down
RENAMED = {"x": "y", "y": "x", "vx": "vy", "vy": "vx", "speed_x": "speed_y", "speed_y": "speed_x"}
GEOGRAPHIC = ("north", "east", "velocity_north", "velocity_east")  # have no other frame
MAKES: dict[str, tuple[str, tuple[str, ...]]] = {  # what is made -> its unit, and the usual units of what it is made of
    "north": ("m", ("deg", "deg")),  # of latitude and longitude, from the file's first
    "east": ("m", ("deg", "deg")),
    "velocity_north": ("m/s", ("m/s", "deg")),  # of speed and course over ground
    "velocity_east": ("m/s", ("m/s", "deg")),
    "roll": ("rad", ("1",) * 4),  # of a quaternion x, y, z, w
    "pitch": ("rad", ("1",) * 4),
    "yaw": ("rad", ("1",) * 4),
}
SCALE = ("c1", "c2")  # thrust of one thruster at n = 1 and -1: c1 + c2 and -(c1 - c2) [N]


@dataclass(frozen=True)
class TimeColumn:
    """Where time comes from: a column, or a rate where the file has none."""

    column: str = ""
    # s | ms | us | ns | iso | datenum (MATLAB's days) | excel | excel1904 | labview (s since 1904) | gps | gps_ms (of
    # the GPS week in `date`) | a strptime pattern
    format: str = "s"
    date: str = ""  # column of the date, in front of the time of day in `column`; or of the GPS week
    fraction: str = ""  # decimal | unpadded-ns: text behind the last point, taken off before `format` applies
    rate_hz: float = 0.0
    origin: float = 0.0  # s since 1970, added

    @property
    def is_text(self) -> bool:
        """Whether the times are read as text."""
        return self.format not in FORMATS_OF_TIME or self.format == "iso" or bool(self.fraction)


@dataclass(frozen=True)
class Signal:
    """The way of a column into the log: sign * (scale * cell + offset), from `unit` to SI, then from `frame` to ours.

    With `make` it is of several columns: their own units are `units`, and `scale` and the rest act on what is made.
    """

    name: str
    columns: tuple[str, ...]
    unit: str = "1"
    scale: float = 1.0
    offset: float = 0.0
    sign: float = 1.0
    angle: str = "keep"  # keep | wrap | unwrap
    role: str = "output"  # input | output
    hold: str = "linear"  # zero | linear | sampled
    nan: str = ""  # as TextStyle.nan, or zero: a cell without a number says zero, in `unit`
    timeout: float = 0.0  # s after which an input that is not repeated is zero; 0: never
    missing: float | None = None  # the value of a cell without a measurement
    missing_is: float | None = None  # what such a cell says all the same, in `unit`; None: nothing
    topic: str = ""
    time: str = ""  # the column of its own time, in place of [time]
    time_format: str = ""  # of that column, in place of [time]'s
    frame: str = (
        "NED"  # NED: north, east, down and forward, starboard, down; ENU: east, north, up and forward, left, up
    )
    make: str = ""  # a key of MAKES
    units: tuple[str, ...] = ()
    repeats: str = ""  # keep | drop: values that repeat the one before; "": as TextStyle.repeats

    @property
    def log_name(self) -> str:
        """Name in the log, in our axes."""
        return self.name if self.frame == "NED" else RENAMED.get(self.name, self.name)


@dataclass(frozen=True)
class Source:
    """One kind of file: how it is read, its clock, its signals. `match` is a glob on the file's name."""

    match: str
    options: SourceOptions
    time: TimeColumn | None  # None: the source has times of its own
    signals: tuple[Signal, ...]


@dataclass(frozen=True)
class Piece:
    """An interval of time that becomes a log of its own, in seconds of the file's clock (before `origin`)."""

    name: str
    t_from: float
    t_to: float


@dataclass(frozen=True)
class ImportMap:
    """A whole map. `merge`: the files make one log together; otherwise each makes its own."""

    name: str
    path: Path
    text: str
    merge: bool
    sources: tuple[Source, ...]
    pieces: tuple[Piece, ...]
    vehicle: Mapping[str, float] = field(default_factory=dict)  # what is known of the boat, model parameters by name


def load_import_map(path: Path) -> ImportMap:
    """Read and check a map. Raises SeatrialError that names file and key of whatever is wrong."""
    text = read_text(path)
    root = parse_toml(text, path)
    form = root.text("format", choices=FORMATS)
    name = root.text("name", path.stem)
    files = root.tables("file")
    whole = () if files else (_source(root, "*", path.parent),)
    sources = whole or tuple(_source(table, table.text("match"), path.parent) for table in files)
    if form == FORMATS[1]:
        sources = tuple(_as_it_was(source) for source in sources)
    names = [signal.log_name for source in sources for signal in source.signals]
    for one in names:
        if names.count(one) > 1:
            raise root.error("signal", f"'{one}' appears twice (in the axes of the log); a name belongs to one column")
    pieces = tuple(_piece(table) for table in root.tables("log"))
    if len({piece.name for piece in pieces}) < len(pieces):
        raise root.error("log", "two of them have one name")
    vehicle = _known(root.table("geometry"), GEOMETRY) | _known(root.table("scale"), SCALE)
    root.done()
    return ImportMap(name, path, text, bool(files), sources, pieces, vehicle)


def _as_it_was(source: Source) -> Source:
    """A source of the first format, which kept repeats unless the map said otherwise: its logs stay the same."""
    style = source.options.style
    return replace(source, options=replace(source.options, style=replace(style, repeats=style.repeats or "keep")))


def _known(table: TomlTable | None, names: Sequence[str]) -> dict[str, float]:
    """Numbers by name, each with its standard uncertainty ``NAME_sd`` where the table has one."""
    if table is None:
        return {}
    found = {name: table.number(name) for name in names if table.has(name)}
    for name in tuple(found):
        if table.has(f"{name}_sd"):
            found[f"{name}_sd"] = table.number(f"{name}_sd", positive=True)
    for name in ("c1", "length"):
        if found.get(name, 1.0) <= 0.0:
            raise table.error(name, f"must be positive, not {found[name]:g}")
    for name in ("y_left", "y_right"):
        if abs(found.get(name, 0.0)) > found.get("length", math.inf):
            where = f"{abs(found[name]):g} m from the middle of a hull of {found['length']:g} m"
            raise table.error(name, f"{where}; positions are in metres, to starboard")
    if found.get("y_left", -1.0) >= found.get("y_right", 1.0):
        raise table.error("y_left", "must be less than y_right: positions are counted to starboard")
    table.done()
    return found


def _source(table: TomlTable, match: str, near: Path) -> Source:
    options = _options(table, near)
    time_table = table.table("time")
    time = None if time_table is None else _time(time_table)
    frame = table.text("frame", "NED", choices=tuple(FRAMES))
    signals = tuple(_signal(signal, frame) for signal in table.tables("signal"))
    if not signals:
        raise table.error("signal", "missing; a map needs at least one signal")
    topics = frozenset(signal.topic for signal in signals) - {""}
    if table.where:  # the root has more keys and is done later
        table.done()
    return Source(match, replace(options, topics=topics), time, signals)


def _options(parent: TomlTable, near: Path) -> SourceOptions:
    can, mavlink = parent.table("can"), parent.table("mavlink")
    found = SourceOptions(
        _style(parent.table("csv")),
        None if can is None or not can.has("dbc") else near / can.text("dbc"),
        "" if can is None else can.text("protocol", "", choices=("", *CAN_PROTOCOLS)),
        None if mavlink is None or not mavlink.has("rig") else near / mavlink.text("rig"),
        None if mavlink is None or not mavlink.has("system") else mavlink.integer("system", low=1, high=255),
    )
    for table in (can, mavlink):
        if table is not None:
            table.done()
    return found


def _style(table: TomlTable | None) -> TextStyle:
    if table is None:
        return TextStyle()
    delimiter = table.text("delimiter", ",")
    if len(delimiter) != 1 and delimiter != "blank":
        raise table.error("delimiter", f"must be one character or 'blank', not '{delimiter}'")
    decimal = table.text("decimal", ".", choices=(".", ","))
    if decimal == delimiter and not (table.has("delimiter") and decimal == ","):  # both where cells are in quotes
        raise table.error("decimal", "is also the delimiter")
    encoding = table.text("encoding", "utf-8-sig")
    try:
        "a".encode(encoding)  # fails for a codec that is none of text (rot13, hex), too
    except (LookupError, ValueError) as error:
        raise table.error("encoding", f"'{encoding}' is no encoding; try utf-8, latin-1, cp1252, utf-16") from error
    found = TextStyle(
        delimiter,
        decimal,
        encoding,
        table.integer("skip_rows", 0, low=0),
        table.texts("columns", ()),
        table.text("nan", "", choices=("error", "drop", "keep", "")),
        table.text("time_order", "", choices=("error", "drop", "")),
        table.text("repeats", "", choices=("keep", "drop", "")),
    )
    table.done()
    return found


def _time(table: TomlTable) -> TimeColumn:
    if table.has("column") == table.has("rate_hz"):
        raise table.error("column", f"give either column or rate_hz{table.misspelt('column')}")
    origin = _origin(table)
    if table.has("rate_hz"):
        found = TimeColumn(rate_hz=table.number("rate_hz", positive=True), origin=origin)
    else:
        pattern = _time_format(table, "format", "s")
        fraction = table.text("fraction", "", choices=("", "decimal", "unpadded-ns"))
        if fraction and pattern in FORMATS_OF_TIME and pattern not in ("s", "iso"):
            raise table.error("fraction", "goes with seconds only: format s, iso or a pattern")
        date = table.text("date", "")
        if date and pattern in FORMATS_OF_TIME and pattern not in ("iso", *GPS_UNITS):
            raise table.error(
                "date", f"goes with text or GPS weeks: format iso, gps, gps_ms or a pattern, not {pattern}"
            )
        if not date and pattern in GPS_UNITS:
            raise table.error("format", f"{pattern} needs date: the column of the GPS week")
        found = TimeColumn(table.text("column"), pattern, date, fraction, origin=origin)
    table.done()
    return found


def _time_format(table: TomlTable, key: str, usual: str) -> str:
    pattern = table.text(key, usual)
    if pattern not in (*FORMATS_OF_TIME, usual) and "%" not in pattern:
        raise table.error(key, f"must be {', '.join(FORMATS_OF_TIME)} or a pattern with %, not '{pattern}'")
    if "%" in pattern:
        try:
            datetime.strptime("", pattern)
        except re.error as error:  # `%Y %Y`
            raise table.error(key, f"'{pattern}' has a field twice; each field of a pattern comes once") from error
        except ValueError as error:
            if "does not match" not in str(error):  # the empty text never does
                raise table.error(key, f"'{pattern}' is no pattern of strptime: {error}") from error
    return pattern


def _origin(table: TomlTable) -> float:
    text = table.text("origin", "")
    if not text:
        return 0.0
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise table.error("origin", f"not an ISO date and time: '{text}'") from error
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _signal(table: TomlTable, frame: str) -> Signal:
    name = table.text("name")
    if not NAME.fullmatch(name):
        raise table.error("name", f"'{name}' becomes a topic of the log: a letter, then letters, digits or _")
    topic, make = table.text("topic", ""), table.text("make", "", choices=("", *MAKES))
    key = ("fields" if make else "field") if topic else ("columns" if make else "column")
    columns = table.texts(key) if make else (table.text(key),)
    unit, units = _units(table, make, columns, key)
    role = table.text("role", "output", choices=("input", "output"))
    sign = table.integer("sign", 1)
    if sign not in (1, -1):
        raise table.error("sign", f"must be 1 or -1, not {sign}")
    angle = table.text("angle", "keep", choices=("keep", "wrap", "unwrap"))
    if angle != "keep" and UNITS[unit][0] != "rad":
        raise table.error("angle", f"goes with deg and rad, not with {unit}")
    hold = table.text("hold", "zero" if role == "input" else "linear", choices=("zero", "linear", "sampled"))
    timeout = table.number("timeout", positive=True) if table.has("timeout") else 0.0
    if timeout and hold != "zero":
        raise table.error("timeout", "needs hold = 'zero': a value that is held until it is repeated")
    time, time_format = table.text("time", ""), _time_format(table, "time_format", "")
    if time_format and not time:
        raise table.error("time_format", "needs time: the column of its own time that has it")
    missing = table.maybe_number("missing")
    if missing is None and table.has("missing_is"):
        raise table.error("missing_is", "needs missing: the number in whose place it stands")
    found = Signal(
        name,
        columns,
        unit,
        table.number("scale", 1.0),
        table.number("offset", 0.0),
        float(sign),
        angle,
        role,
        hold,
        table.text("nan", "", choices=("", "error", "drop", "keep", "zero")),
        timeout,
        missing,
        table.maybe_number("missing_is"),
        topic,
        time,
        time_format,
        FRAMES[table.text("frame", "NED" if make in GEOGRAPHIC else frame, choices=tuple(FRAMES))],
        make,
        units,
        table.text("repeats", "", choices=("keep", "drop", "")),
    )
    table.done()
    return found


def _units(table: TomlTable, make: str, columns: Sequence[str], key: str) -> tuple[str, tuple[str, ...]]:
    """The unit of a signal, and those of its columns where it is made of several."""
    known = f"known: {', '.join(UNITS)}"
    if not make:
        unit = table.text("unit")
        if unit not in UNITS:
            raise table.error("unit", f"'{unit}' is not known (use scale); {known}")
        return unit, ()
    unit, usual = MAKES[make]
    if len(columns) != len(usual):
        raise table.error(key, f"{make} is made of {len(usual)}, not {len(columns)}")
    units = table.texts("units", usual)
    for one, by_default in zip_longest(units, usual):
        if one not in UNITS or by_default is None or UNITS[one][0] != UNITS[by_default][0]:
            raise table.error("units", f"must be like {', '.join(usual)}, not {', '.join(units)}; {known}")
    return unit, units


def _piece(table: TomlTable) -> Piece:
    name = table.text("name")
    if not re.fullmatch(r"[A-Za-z0-9_.-]+", name):
        raise table.error("name", f"'{name}' becomes part of a file name: letters, digits, _, - or .")
    found = Piece(name, table.number("t_from", -1e18), table.number("t_to", 1e18))
    if found.t_to <= found.t_from:
        raise table.error("t_to", "must be after t_from")
    table.done()
    return found
