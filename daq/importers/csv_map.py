"""The map of `seatrial import csv`: which columns become which signals (docs/formats/import-csv.md)."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from pathlib import Path

from daq.config import TomlTable, parse_toml, read_text
from daq.importers.units import UNITS
from daq.rig import NAME

FORMAT = "seatrial-import-csv 1"
TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
GEOMETRY = ("y_left", "y_right", "length")  # thrusters to starboard, and the hull's length [m]
SCALE = ("c1", "c2")  # thrust of one thruster at n = 1 and -1: c1 + c2 and -(c1 - c2) [N]


@dataclass(frozen=True)
class CsvStyle:
    """How the text is cut into cells, and what to do about gaps in it."""

    delimiter: str = ","
    decimal: str = "."
    skip_rows: int = 0  # lines in front of the header
    columns: tuple[str, ...] = ()  # names, where the file has no header of its own
    nan: str = "error"  # error | drop | keep
    time_order: str = "error"  # error | drop
    repeats: str = "keep"  # keep | drop: rows whose signals all repeat the row before


@dataclass(frozen=True)
class TimeColumn:
    """Where time comes from: a column, or a rate where the file has none."""

    column: str = ""
    format: str = "s"  # s | ms | us | ns | iso | a strptime pattern
    fraction: str = ""  # decimal | unpadded-ns: text behind the last point, taken off before `format` applies
    rate_hz: float = 0.0
    origin: float = 0.0  # s since 1970, added


@dataclass(frozen=True)
class Signal:
    """One column's way into the log: value = sign * (scale * cell + offset), then from `unit` to SI."""

    name: str
    column: str
    unit: str
    scale: float
    offset: float
    sign: float
    angle: str  # keep | wrap | unwrap
    role: str  # input | output
    hold: str  # zero | linear
    nan: str
    timeout: float = 0.0  # s after which an input that is not repeated is zero; 0: never
    missing: float | None = None  # the value of a cell without a measurement


@dataclass(frozen=True)
class Source:
    """One kind of file: its style, its clock, its signals. `match` is a glob on the file's name."""

    match: str
    style: CsvStyle
    time: TimeColumn
    signals: tuple[Signal, ...]


@dataclass(frozen=True)
class Piece:
    """An interval of time that becomes a log of its own, in seconds of the file's clock (before `origin`)."""

    name: str
    t_from: float
    t_to: float


@dataclass(frozen=True)
class CsvMap:
    """A whole map. `merge`: the files make one log together; otherwise each makes its own."""

    name: str
    path: Path
    text: str
    merge: bool
    sources: tuple[Source, ...]
    pieces: tuple[Piece, ...]
    vehicle: Mapping[str, float] = field(default_factory=dict)  # what is known of the boat, model parameters by name


def load_csv_map(path: Path) -> CsvMap:
    """Read and check a map. Raises SeatrialError that names file and key of whatever is wrong."""
    text = read_text(path)
    root = parse_toml(text, path)
    root.text("format", choices=(FORMAT,))
    name = root.text("name", path.stem)
    files = root.tables("file")
    whole = () if files else (_source(root, "*"),)
    sources = whole or tuple(_source(table, table.text("match")) for table in files)
    names = [signal.name for source in sources for signal in source.signals]
    for one in names:
        if names.count(one) > 1:
            raise root.error("signal", f"'{one}' appears twice; a name belongs to one column")
    pieces = tuple(_piece(table) for table in root.tables("log"))
    if len({piece.name for piece in pieces}) < len(pieces):
        raise root.error("log", "two of them have one name")
    vehicle = _known(root.table("geometry"), GEOMETRY) | _known(root.table("scale"), SCALE)
    root.done()
    return CsvMap(name, path, text, bool(files), sources, pieces, vehicle)


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
    if found.get("y_left", -1.0) >= found.get("y_right", 1.0):
        raise table.error("y_left", "must be less than y_right: positions are counted to starboard")
    table.done()
    return found


def _source(table: TomlTable, match: str) -> Source:
    style = _style(table.table("csv"))
    time = _time(table, table.table("time"))
    signals = tuple(_signal(signal, style) for signal in table.tables("signal"))
    if not signals:
        raise table.error("signal", "missing; a map needs at least one signal")
    if table.where:  # the root has more keys and is done later
        table.done()
    return Source(match, style, time, signals)


def _style(table: TomlTable | None) -> CsvStyle:
    if table is None:
        return CsvStyle()
    delimiter = table.text("delimiter", ",")
    if len(delimiter) != 1:
        raise table.error("delimiter", f"must be one character, not '{delimiter}'")
    decimal = table.text("decimal", ".", choices=(".", ","))
    if decimal == delimiter:
        raise table.error("decimal", "is also the delimiter")
    columns = table.texts("columns", ())
    found = CsvStyle(
        delimiter,
        decimal,
        table.integer("skip_rows", 0, low=0),
        columns,
        table.text("nan", "error", choices=("error", "drop", "keep")),
        table.text("time_order", "error", choices=("error", "drop")),
        table.text("repeats", "keep", choices=("keep", "drop")),
    )
    table.done()
    return found


def _time(parent: TomlTable, table: TomlTable | None) -> TimeColumn:
    if table is None:
        raise parent.error("time", "missing; give [time] column = ... (or rate_hz = ... where there is none)")
    if table.has("column") == table.has("rate_hz"):
        raise table.error("column", "give either column or rate_hz")
    origin = _origin(table)
    if table.has("rate_hz"):
        found = TimeColumn(rate_hz=table.number("rate_hz", positive=True), origin=origin)
    else:
        pattern = table.text("format", "s")
        if pattern not in (*TIME_UNITS, "iso") and "%" not in pattern:
            raise table.error("format", f"must be s, ms, us, ns, iso or a pattern with %, not '{pattern}'")
        fraction = table.text("fraction", "", choices=("", "decimal", "unpadded-ns"))
        if fraction and pattern in ("ms", "us", "ns"):
            raise table.error("fraction", "goes with seconds only: format s, iso or a pattern")
        found = TimeColumn(table.text("column"), pattern, fraction, origin=origin)
    table.done()
    return found


def _origin(table: TomlTable) -> float:
    text = table.text("origin", "")
    if not text:
        return 0.0
    try:
        moment = datetime.fromisoformat(text)
    except ValueError as error:
        raise table.error("origin", f"not an ISO date and time: '{text}'") from error
    return (moment if moment.tzinfo else moment.replace(tzinfo=UTC)).timestamp()


def _signal(table: TomlTable, style: CsvStyle) -> Signal:
    name = table.text("name")
    if not NAME.fullmatch(name):
        raise table.error("name", f"'{name}' becomes a topic of the log: a letter, then letters, digits or _")
    unit = table.text("unit")
    if unit not in UNITS:
        raise table.error("unit", f"'{unit}' is not known (use scale); known: {', '.join(UNITS)}")
    role = table.text("role", "output", choices=("input", "output"))
    sign = table.integer("sign", 1)
    if sign not in (1, -1):
        raise table.error("sign", f"must be 1 or -1, not {sign}")
    angle = table.text("angle", "keep", choices=("keep", "wrap", "unwrap"))
    if angle != "keep" and UNITS[unit][0] != "rad":
        raise table.error("angle", f"goes with deg and rad, not with {unit}")
    hold = table.text("hold", "zero" if role == "input" else "linear", choices=("zero", "linear"))
    timeout = table.number("timeout", positive=True) if table.has("timeout") else 0.0
    if timeout and hold != "zero":
        raise table.error("timeout", "needs hold = 'zero': a value that is held until it is repeated")
    found = Signal(
        name,
        table.text("column"),
        unit,
        table.number("scale", 1.0),
        table.number("offset", 0.0),
        float(sign),
        angle,
        role,
        hold,
        table.text("nan", style.nan, choices=("error", "drop", "keep")),
        timeout,
        table.maybe_number("missing"),
    )
    table.done()
    return found


def _piece(table: TomlTable) -> Piece:
    name = table.text("name")
    if not re.fullmatch(r"[A-Za-z0-9_.-]+", name):
        raise table.error("name", f"'{name}' becomes part of a file name: letters, digits, _, - or .")
    found = Piece(name, table.number("t_from", -1e18), table.number("t_to", 1e18))
    if found.t_to <= found.t_from:
        raise table.error("t_to", "must be after t_from")
    table.done()
    return found
