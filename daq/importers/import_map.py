"""The map of `seatrial import`, which assigns columns of topics to signals of the log (docs/formats/import.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from itertools import zip_longest
from pathlib import Path

from seatrial.daq.config import TomlTable, parse_toml, read_text
from seatrial.daq.importers.boat_tables import BoatTable, boat_numbers_of, with_boat_tables
from seatrial.daq.importers.table import SourceOptions, TextStyle
from seatrial.daq.importers.units import UNITS
from seatrial.daq.rig import NAME

# Both formats have the same keys. A map of the second, older format keeps repeats by default.
FORMATS = ("seatrial-import 1", "seatrial-import-csv 1")
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9, "min": 60.0, "h": 3600.0, "day": 86400.0}
DAY_COUNTS = {"datenum": 719529.0, "excel": 25569.0, "excel1904": 24107.0}  # formats of days -> day of 1970-01-01
GPS_UNITS = {"gps": 1.0, "gps_ms": 1e-3}  # formats of times in a GPS week -> their unit [s]
FORMATS_OF_TIME = (*TIME_UNITS, "iso", *DAY_COUNTS, "labview", *GPS_UNITS)
FRAMES = {"NED": "NED", "FRD": "NED", "ENU": "ENU", "FLU": "ENU"}
CAN_PROTOCOLS = ("vesc", "dronecan", "nmea2000")
# Names of signals in east, north, up (ENU) or forward, left, up (FLU) -> names in NED or forward, starboard, down (FRD)
RENAMED = {"x": "y", "y": "x", "vx": "vy", "vy": "vx", "speed_x": "speed_y", "speed_y": "speed_x"}
GEOGRAPHIC = ("north", "east", "velocity_north", "velocity_east")  # always in NED
MAKES: dict[str, tuple[str, tuple[str, ...]]] = {  # made signal -> its unit, and the default units of its columns
    "north": ("m", ("deg", "deg")),  # from latitude and longitude; the origin is the first position of the file
    "east": ("m", ("deg", "deg")),
    "velocity_north": ("m/s", ("m/s", "deg")),  # from speed and course over ground
    "velocity_east": ("m/s", ("m/s", "deg")),
    "roll": ("rad", ("1",) * 4),  # from a quaternion x, y, z, w
    "pitch": ("rad", ("1",) * 4),
    "yaw": ("rad", ("1",) * 4),
}


@dataclass(frozen=True)
class TimeColumn:
    """Source of the times of rows in an import map: a column, or a rate if the file has no times.

    Attributes
    ----------
    column : str
        Name of the column; "" for times by `rate_hz`.
    format : str
        s, ms, us, ns, min, h, day, iso, datenum (days of MATLAB), excel, excel1904, labview (s since 1904), gps or
        gps_ms (in the GPS week of `date`), or a strptime pattern.
    date : str
        Column of the dates if `column` has times of day, or of the GPS weeks; "" if not needed.
    fraction : str
        How the text behind the last point is read: "decimal" (a fraction of a second) or "unpadded-ns" (a number of ns
        without leading zeros); "" to read it by `format`.
    rate_hz : float
        Rate of the rows [Hz]; 0 for times of a column.
    origin : float
        Time that is added to the times [s since 1970].
    """

    column: str = ""
    # s | ms | us | ns | iso | datenum (days of MATLAB) | excel | excel1904 | labview (s since 1904) | gps | gps_ms (in
    # the GPS week of `date`) | a strptime pattern
    format: str = "s"
    date: str = ""  # column of the date, if `column` has the time of day; or of the GPS week
    fraction: str = ""  # decimal | unpadded-ns: how the text behind the last point is read; `format` reads the rest
    rate_hz: float = 0.0  # Hz; 0 for times of a column
    origin: float = 0.0  # s since 1970, added to the times

    @property
    def is_text(self) -> bool:
        """Whether the times are read as text: dates (iso or a strptime pattern), or numbers with the key `fraction`."""
        return self.format not in FORMATS_OF_TIME or self.format == "iso" or bool(self.fraction)


@dataclass(frozen=True)
class Signal:
    """Conversion of a column of a source file to a signal: sign * (scale * cell + offset), then from `unit` to SI.

    Then the signal is converted from `frame` to NED. With `make`, the signal is computed from several columns with the
    units `units`. Scale, offset and sign then apply to the computed signal.

    Attributes
    ----------
    name : str
        Name in the map, before conversion to NED.
    columns : tuple of str
        Column of the signal, or columns of a signal with `make`.
    unit : str
        Unit of the cells, a key of `seatrial.daq.importers.units.UNITS`.
    scale, offset, sign : float
        Numbers of the conversion above; `sign` is 1 or -1.
    angle : str
        "keep", "wrap" to -pi .. pi, or "unwrap" to a continuous angle.
    role : str
        "input" or "output" of the system.
    hold : str
        Value between two samples: "zero" (the last value), "linear" or "sampled" (a held output, sampled at a rate).
    nan : str
        Treatment of a cell without a number: "error", "drop" (no sample), "keep" (a sample NaN) or "zero" (the cell
        means zero, in `unit`); "" for `TextStyle.nan` of the source, by default "error" for text and "drop" otherwise.
    timeout : float
        Time after which a signal with the hold "zero" that is not repeated becomes zero [s]; 0 for never.
    missing : float or None
        Number in a cell that marks a missing measurement; None if there is no such number.
    missing_is : float or None
        Value of a cell with the number `missing`, in `unit`; None to leave the cell out.
    topic : str
        Topic of the table; "" for a file with a single table.
    time, time_format : str
        Column of the signal's own times, and their format; "" to use [time].
    frame : str
        "NED" (north, east, down; forward, starboard, down) or "ENU" (east, north, up; forward, left, up).
    make : str
        Quantity that is computed from several columns, a key of `MAKES`; "" for a single column.
    units : tuple of str
        Units of the columns with `make`.
    repeats : str
        "keep" or "drop" values that repeat the previous one; "" for `TextStyle.repeats` of the source.
    is_role_assumed : bool
        Whether the map has no role for the signal, which is then an output.
    time_shift : float
        Time [s] that is added to the times of the signal.
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
    nan: str = ""  # as TextStyle.nan; or zero: a cell without a number means zero, in `unit`
    timeout: float = 0.0  # s after which an input that is not repeated becomes zero; 0: never
    missing: float | None = None  # number in a cell that marks a missing measurement
    missing_is: float | None = None  # value of such a cell, in `unit`; None: unknown
    topic: str = ""
    time: str = ""  # column of the signal's own time, instead of that of [time]
    time_format: str = ""  # format of that column, instead of that of [time]
    frame: str = (
        "NED"  # NED: north, east, down and forward, starboard, down; ENU: east, north, up and forward, left, up
    )
    make: str = ""  # a key of MAKES
    units: tuple[str, ...] = ()
    repeats: str = ""  # keep | drop: values that repeat the previous one; "": as TextStyle.repeats
    is_role_assumed: bool = False
    time_shift: float = 0.0  # s

    @property
    def log_name(self) -> str:
        """Name of the signal in the log, after conversion to NED.

        In the frame ENU (east, north, up), x and y are exchanged, also in vx and vy, and in speed_x and speed_y. Other
        names stay.
        """
        return self.name if self.frame == "NED" else RENAMED.get(self.name, self.name)


@dataclass(frozen=True)
class Source:
    """One kind of source file in an import map: how it is read, its time column and its signals.

    Attributes
    ----------
    match : str
        Glob pattern of the file's name.
    options : SourceOptions
        Options of the reader.
    time : TimeColumn or None
        Source of the times; None if the map has no table [time] for the source.
    signals : tuple of Signal
        Signals to import.
    """

    match: str  # glob pattern of the file's name
    options: SourceOptions
    time: TimeColumn | None  # None: the source has its own times
    signals: tuple[Signal, ...]


@dataclass(frozen=True)
class Piece:
    """Interval of time of the source files that becomes a log of its own, from a table [[log]] of an import map.

    Attributes
    ----------
    name : str
        Name of the piece, which ends the name of its log.
    t_from, t_to : float
        First and last time, both included [s of the file's clock, before `TimeColumn.origin` is added].
    match : str
        Pattern of the runs that the piece is cut from, as ``run1*``: of the name of a run's log (that of the folder, or
        of the file without ending) or of one of its files; "" for each run that has samples in the interval.
    """

    name: str
    t_from: float  # s of the file's clock, before `origin` is added
    t_to: float  # s, likewise
    match: str = ""


@dataclass(frozen=True)
class ImportMap:
    """Import map, a TOML file that assigns columns of source files to signals of a log.

    Attributes
    ----------
    name : str
        Name of the map.
    path : Path
        File of the map.
    text : str
        Text of the file.
    merge : bool
        Whether all files together make one log; otherwise each file makes its own log.
    sources : tuple of Source
        Kinds of source files; a map without [[file]] has one.
    pieces : tuple of Piece
        Intervals of time that become logs; empty for one log of the whole time.
    vehicle : dict
        Known numbers of the boat by name, as `y_left` [m], `c1` or `ahead` [N], and their standard uncertainties
        (`NAME_sd`).
    """

    name: str
    path: Path
    text: str
    merge: bool  # whether all files together make one log; otherwise each file makes its own log
    sources: tuple[Source, ...]
    pieces: tuple[Piece, ...]
    vehicle: Mapping[str, float] = field(default_factory=dict)  # known model parameters of the boat, by name


def load_import_map(path: Path, geometry: BoatTable | None = None, scale: BoatTable | None = None) -> ImportMap:
    """Read and check an import map.

    Parameters
    ----------
    path
        The map, a TOML file.
    geometry, scale
        Numbers of the boat that replace those of the tables [geometry] and [scale] of the map.

    Returns
    -------
    ImportMap
        The map.

    Raises
    ------
    SeatrialError
        If the file cannot be read or a key is wrong, if two signals have the same name after conversion to NED, or two
        [[log]] tables the same name. The message names the file and the key.
    """
    return parse_import_map(with_boat_tables(read_text(path), path, geometry, scale), path)


def parse_import_map(text: str, path: Path) -> ImportMap:
    """Parse and check the text of an import map.

    Parameters
    ----------
    text
        Text of the map, in TOML.
    path
        File of the map, for error messages. Paths in the map are relative to its folder.

    Returns
    -------
    ImportMap
        The map.

    Raises
    ------
    SeatrialError
        If a key is wrong, if two signals have the same name after conversion to NED, or two [[log]] tables the same
        name. The message names the file and the key.
    """
    root = parse_toml(text, path)
    form = root.text("format", choices=FORMATS)
    name = root.text("name", path.stem)
    files = root.tables("file")
    whole = () if files else (_source_of_table(root, "*", path.parent),)
    sources = whole or tuple(_source_of_table(table, table.text("match"), path.parent) for table in files)
    if form == FORMATS[1]:
        sources = tuple(_keeping_repeats(source) for source in sources)
    seen: dict[str, str] = {}
    for k, source in enumerate(sources, 1):
        for i, signal in enumerate(source.signals, 1):
            entry = f"{f'file[{k}].' if files else ''}signal[{i}] ({_column_text(signal)})"
            if (before := seen.setdefault(signal.log_name, entry)) is not entry:
                raise root.error(
                    "signal",
                    f"'{signal.log_name}' appears twice (after conversion to NED), as {before} and as {entry}; leave "
                    f"one of them out, or rename one{_advice_on_name(signal.log_name)}",
                )
    pieces = tuple(_piece_of_table(table) for table in root.tables("log"))
    if len({(piece.name, piece.match or "*") for piece in pieces}) < len(pieces):
        raise root.error("log", "two [[log]] tables have the same name; rename one")
    vehicle = boat_numbers_of(root.table("geometry"), root.table("scale"))
    root.done()
    return ImportMap(name, path, text, bool(files), sources, pieces, vehicle)


def _column_text(signal: Signal) -> str:
    """Return the topic and the columns of a signal of an import map, for messages: `/rpm: data`."""
    columns = ", ".join(signal.columns)
    return f"{signal.topic}: {columns}" if signal.topic else columns


def _advice_on_name(name: str) -> str:
    """Return advice on a second name for a thruster's signal, with a colon in front; "" for other signals."""
    side = name.removeprefix("n_")
    return f": n_cmd_{side} is the command, n_{side} the shaft speed" if side in ("left", "right") else ""


def _keeping_repeats(source: Source) -> Source:
    """Return a source of an import map with the default `repeats` = "keep", as in the older format of maps.

    That format is "seatrial-import-csv 1", whose maps did not look for held values. A key `repeats` in the table [csv]
    of the map stays.
    """
    style = source.options.style
    return replace(source, options=replace(source.options, style=replace(style, repeats=style.repeats or "keep")))


def _source_of_table(table: TomlTable, match: str, near: Path) -> Source:
    """Parse how source files are read, from a table [[file]] of an import map or from the whole map.

    `match` is the pattern of the file name. Paths in the table are relative to the folder `near`. The topics of the
    signals become `topics` of the options. Raise SeatrialError if the table has no signal or a wrong key; unknown keys
    of the whole map are checked later.
    """
    options = _reading_options(table, near)
    time_table = table.table("time")
    time = None if time_table is None else _time_column(time_table)
    frame = table.text("frame", "NED", choices=tuple(FRAMES))
    signals = tuple(_signal_of_table(signal, frame) for signal in table.tables("signal"))
    if not signals:
        raise table.error(
            "signal", f"missing; add at least one signal to this import map{table.misspelling_hint('signal')}"
        )
    topics = frozenset(signal.topic for signal in signals) - {""}
    if table.where:  # the root has more keys and is done later
        table.done()
    return Source(match, replace(options, topics=topics), time, signals)


def _reading_options(parent: TomlTable, near: Path) -> SourceOptions:
    """Parse the reading options in the tables [csv], [can] and [mavlink] of an import map.

    `parent` is the whole map or a [[file]] of it. Paths are relative to the folder `near`. A missing table gives the
    defaults. Raise SeatrialError for a wrong key.
    """
    can, mavlink = parent.table("can"), parent.table("mavlink")
    found = SourceOptions(
        _text_style(parent.table("csv")),
        None if can is None or not can.has("dbc") else near / can.text("dbc"),
        "" if can is None else can.text("protocol", "", choices=("", *CAN_PROTOCOLS)),
        None if mavlink is None or not mavlink.has("rig") else near / mavlink.text("rig"),
        None if mavlink is None or not mavlink.has("system") else mavlink.integer("system", low=1, high=255),
    )
    for table in (can, mavlink):
        if table is not None:
            table.done()
    return found


def _text_style(table: TomlTable | None) -> TextStyle:
    """Parse the table [csv] of an import map: delimiter, decimal mark, encoding, header, handling of missing numbers.

    None gives the default style. The delimiter is one character or "blank"; it may equal the decimal mark only if the
    map gives both as a comma. Raise SeatrialError for a wrong key.
    """
    if table is None:
        return TextStyle()
    delimiter = table.text("delimiter", ",")
    if len(delimiter) != 1 and delimiter != "blank":
        raise table.error("delimiter", f"must be one character or 'blank', not '{delimiter}'")
    decimal = table.text("decimal", ".", choices=(".", ","))
    if decimal == delimiter and not (
        table.has("delimiter") and decimal == ","
    ):  # a comma may be both if the cells are in quotes
        raise table.error("decimal", "is also the delimiter; change one of the two")
    encoding = table.text("encoding", "utf-8-sig")
    try:
        "a".encode(encoding)  # also fails for codecs that do not encode text (rot13, hex)
    except (LookupError, ValueError) as error:
        message = f"'{encoding}' is not a text encoding; try utf-8, latin-1, cp1252 or utf-16"
        raise table.error("encoding", message) from error
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


def _time_column(table: TomlTable) -> TimeColumn:
    """Parse the table [time] of an import map: the time column and its format, or the rate of the rows.

    The default format is "s". Raise SeatrialError if the table has neither or both of them, or if its keys do not fit
    together: `fraction` needs the format s, iso or a pattern; `date` needs iso, gps, gps_ms or a pattern; gps and
    gps_ms need `date`.
    """
    if table.has("column") == table.has("rate_hz"):
        raise table.error("column", f"give one of column and rate_hz{table.misspelling_hint('column')}")
    origin = _time_origin(table)
    if table.has("rate_hz"):
        found = TimeColumn(rate_hz=table.number("rate_hz", positive=True), origin=origin)
    else:
        pattern = _time_format(table, "format", "s")
        fraction = table.text("fraction", "", choices=("", "decimal", "unpadded-ns"))
        if fraction and pattern in FORMATS_OF_TIME and pattern not in ("s", "iso"):
            raise table.error("fraction", f"works only with format s, iso or a pattern with %, not {pattern}")
        date = table.text("date", "")
        if date and pattern in FORMATS_OF_TIME and pattern not in ("iso", *GPS_UNITS):
            raise table.error("date", f"works only with format iso, gps, gps_ms or a pattern with %, not {pattern}")
        if not date and pattern in GPS_UNITS:
            raise table.error("format", f"{pattern} needs `date`, the name of the column of the GPS week; add it")
        found = TimeColumn(table.text("column"), pattern, date, fraction, origin=origin)
    table.done()
    return found


def _time_format(table: TomlTable, key: str, usual: str) -> str:
    """Return the format of times at a key of an import map, by default `usual`. Raise SeatrialError if it is invalid.

    Valid are units ("s", "ms", ...), "iso", "datenum", "excel", "excel1904", "labview", "gps", "gps_ms", and strptime
    patterns (with %).
    """
    pattern = table.text(key, usual)
    if pattern not in (*FORMATS_OF_TIME, usual) and "%" not in pattern:
        raise table.error(key, f"must be {', '.join(FORMATS_OF_TIME)} or a pattern with %, not '{pattern}'")
    if "%" in pattern:
        try:
            datetime.strptime("", pattern)
        except re.error as error:  # `%Y %Y`
            raise table.error(key, f"'{pattern}' contains a field twice; use each field once") from error
        except ValueError as error:
            if "does not match" not in str(error):  # the empty text never matches, so this error is expected
                text = f"'{pattern}' is not a strptime pattern: {error}; correct it, as %Y-%m-%d %H:%M:%S"
                raise table.error(key, text) from error
    return pattern


def _time_origin(table: TomlTable) -> float:
    """Return the key `origin` of the table [time], a time that is added to all times [s since 1970]; 0 without it.

    A date and time without a zone is UTC. Raise SeatrialError if it is not in ISO form.
    """
    text = table.text("origin", "")
    if not text:
        return 0.0
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise table.error(
            "origin", f"must be an ISO date and time, such as 2025-05-01T12:00:00, not '{text}'"
        ) from error
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _signal_of_table(table: TomlTable, frame: str) -> Signal:
    """Parse one signal from its table [[signal]] of an import map.

    By default an input has the hold "zero" and an output "linear". `frame` ("NED", "FRD", "ENU" or "FLU") is the
    default frame of the source; a position or velocity from latitude, longitude, speed or course is always in NED by
    default. Raise SeatrialError for a wrong key, or keys that do not fit together: `angle` needs a unit of angle,
    `timeout` the hold "zero", `time_format` the key `time`, and `missing_is` the key `missing`.
    """
    name = table.text("name")
    if not NAME.fullmatch(name):
        raise table.error("name", f"'{name}' is not a valid name; use a letter, then letters, digits or _")
    table.label = f"signal '{name}'"
    topic, make = table.text("topic", ""), table.text("make", "", choices=("", *MAKES))
    key = ("fields" if make else "field") if topic else ("columns" if make else "column")
    columns = table.texts(key) if make else (table.text(key),)
    unit, units = _signal_units(table, make, columns, key)
    role = table.text("role", "output", choices=("input", "output"))
    sign = table.integer("sign", 1)
    if sign not in (1, -1):
        raise table.error("sign", f"must be 1 or -1, not {sign}")
    angle = table.text("angle", "keep", choices=("keep", "wrap", "unwrap"))
    if angle != "keep" and UNITS[unit][0] != "rad":
        raise table.error("angle", f"works only with a unit of angle (deg, rad), not {unit}")
    hold = table.text("hold", "zero" if role == "input" else "linear", choices=("zero", "linear", "sampled"))
    timeout = table.number("timeout", positive=True) if table.has("timeout") else 0.0
    if timeout and hold != "zero":
        raise table.error(
            "timeout", "needs hold = 'zero', because only a held value can time out; add it, or leave timeout out"
        )
    time, time_format = table.text("time", ""), _time_format(table, "time_format", "")
    if time_format and not time:
        raise table.error("time_format", "needs `time`, the name of the column that has this format; add it")
    missing = table.maybe_number("missing")
    if missing is None and table.has("missing_is"):
        raise table.error("missing_is", "needs `missing`, the number that it replaces; add it")
    found = Signal(
        name,
        columns,
        unit,
        table.ratio("scale", 1.0),
        table.ratio("offset", 0.0),
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
        not table.has("role"),
        table.number("time_shift", 0.0),
    )
    table.done()
    return found


def _signal_units(table: TomlTable, make: str, columns: Sequence[str], key: str) -> tuple[str, tuple[str, ...]]:
    """Return the unit of a signal of an import map and, for a signal made of several columns, the units of the columns.

    `make` is the computed quantity, for example "north", or "" for a single column, for which the second result is
    empty. `key` is the name of the columns' key in the map, for messages. Without the key `units` the columns have the
    usual units of the quantity. Raise SeatrialError for an unknown unit, a wrong number of columns, or a unit of
    another quantity.
    """
    known = f"known: {', '.join(UNITS)}"
    if not make:
        unit = table.text("unit")
        if unit not in UNITS:
            from seatrial.daq.importers.recognise import unit_of  # imported here, as only this error needs it

            meant = unit_of(unit)
            hint = f"did you mean '{meant}'? " if meant in UNITS else ""
            raise table.error("unit", f"'{unit}' is not a known unit; {hint}use one of these, and `scale`; {known}")
        return unit, ()
    unit, usual = MAKES[make]
    if len(columns) != len(usual):
        raise table.error(key, f"{make} needs {len(usual)} names, not {len(columns)}")
    units = table.texts("units", usual)
    for unit_of_column, by_default in zip_longest(units, usual):
        if unit_of_column not in UNITS or by_default is None or UNITS[unit_of_column][0] != UNITS[by_default][0]:
            raise table.error("units", f"must be convertible to {', '.join(usual)}, not {', '.join(units)}; {known}")
    return unit, units


def _piece_of_table(table: TomlTable) -> Piece:
    """Parse an interval of time that becomes a log, from a table [[log]] of an import map.

    The keys are name, t_from and t_to [s], and match. Without t_from or t_to the interval has no limit on that side,
    and without match the piece is cut from each run with samples in it. Raise SeatrialError if the name has other
    characters than letters, digits, _, - and ., or if t_to is not after t_from.
    """
    name = table.text("name")
    if not re.fullmatch(r"[A-Za-z0-9_.-]+", name):
        raise table.error("name", f"'{name}' becomes part of a file name; use letters, digits, _, - or .")
    found = Piece(name, table.number("t_from", -1e18), table.number("t_to", 1e18), table.text("match", ""))
    if found.t_to <= found.t_from:
        raise table.error("t_to", "must be later than t_from; correct one of them")
    table.done()
    return found
