"""Reader of CAN logs in text form: candump, Vector's ASC, BusMaster, and three dialects of NMEA 2000.

| dialect | example of a line | source |
|---|---|---|
| candump -L, -l | ``(1715504400.100000) can0 123#1122`` | can-utils, candump.c |
| candump -ta, -tA, -tz, -td | ``(2024-05-12 09:00:00.1)  can0  123   [2]  11 22`` | can-utils, candump.c |
| ASC | ``0.100000 1  123x  Rx  d 2 11 22`` | Vector, CANalyzer |
| BusMaster | ``9:00:00:1234 Rx 1 0x123 s 2 11 22``, 100 us | rbei-etas.github.io/busmaster |
| Yacht Devices RAW | ``09:00:00.100 R 09F11200 11 22`` | manual of YDNU-02, appendix E |
| N2K ASCII | ``A090000.100 00FF2 1F112 1122`` | Actisense, NMEA 2000 ASCII output format |
| canboat | ``2024-05-12T09:00:00.100Z,2,127250,0,255,2,11,22`` | canboat, analyzer |
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from datetime import UTC, datetime
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

from seatrial.daq.errors import SeatrialError, counted, warn
from seatrial.daq.protocol import EXTENDED

DAY = 86400.0  # s
LONGEST_FRAME = 8  # bytes
LOOKED_AT = 40  # lines; the dialect is recognised in these first lines
LARGEST_PGN = 0x3FFFF  # a gateway reports its own state with larger numbers
_MONTHS = ("jan", "feb", "m.r", "apr", "ma[iy]", "jun", "jul", "aug", "sep", "o[ck]t", "nov", "de[cz]")


class BusFrame(NamedTuple):
    """One data frame of a CAN log: its time, bus, identifier and data bytes.

    Attributes
    ----------
    t : float
        Time of the frame [s since 1970]; in a log without a date [s] since its start or since midnight.
    bus : str
        Name or number of the bus, as the log writes it; "1" in a text format that does not name the bus.
    word : int
        Identifier. The flag EXTENDED is set for identifiers of 29 bits.
    data : bytes
        Data of the frame, at most 8 bytes.
    """

    t: float  # s since 1970, or since the start of the log
    bus: str
    word: int  # identifier; the flag EXTENDED is set for identifiers of 29 bits
    data: bytes


Fields = dict[str, str]
_BYTES = r"(?P<data>(?:[0-9A-Fa-f]{2}(?: +|$))*)"
_CANDUMP_TIME = r"\((?P<t>\d+\.\d+|\d{4}-\d\d-\d\d \d\d:\d\d:\d\d\.\d+)\)"
_COMPACT = re.compile(
    rf"{_CANDUMP_TIME} +(?P<bus>\S+) +(?P<id>[0-9A-Fa-f]{{3,8}})#(?P<data>[#0-9A-Fa-fRr.]*)(?: [RT])?"
)
_SPACED = re.compile(
    rf"(?:{_CANDUMP_TIME} +)?(?P<bus>[A-Za-z]\S*) +(?:[RT]X +[-BE] [-BE] +)?(?P<id>[0-9A-Fa-f]{{3,8}}) +"
    r"\[(?P<n>\d+)\] *(?P<data>(?:[0-9A-Fa-f]{2} ?)*|remote request)(?: +'.*')?"
)
_ASC = re.compile(
    r"(?P<t>\d+\.\d+) +(?P<bus>\d+) +(?P<id>[0-9A-Fa-f]+)(?P<long>x?) +(?:Rx|Tx) +(?P<kind>[dr])"
    r"(?: +(?P<n>[0-9A-Fa-f]+)(?P<data>(?: +[0-9A-Fa-f]+)*?))?(?: +\w+ *= *.*)?",
    re.IGNORECASE,
)
_ASC_EVENT = re.compile(r"(?P<t>\d+\.\d+) +\S.*")
_ASC_DATE = re.compile(
    r"(?i)(?:date|begin triggerblock) +\w+ +(?P<month>\w+) +(?P<day>\d+) +(?P<h>\d+):(?P<m>\d+):(?P<s>\d+(?:\.\d+)?) *"
    r"(?P<half>[ap]m)? +(?P<year>\d{4})"
)
_BUSMASTER = re.compile(
    r"(?P<t>\d+:\d+:\d+:\d+) +(?:Rx|Tx) +(?P<bus>\d+) +(?P<id>(?:0x)?[0-9A-Fa-f]+) +(?P<kind>s|x|sr|xr) +(?P<n>\d+)"
    r"(?P<data>(?: +[0-9A-Fa-f]+)*)"
)
_BUSMASTER_DATE = re.compile(r"\*{3}START DATE AND TIME (\d+):(\d+):(\d+) (\d+):(\d+):(\d+):(\d+)")
_YACHT = re.compile(rf"(?P<t>\d\d:\d\d:\d\d\.\d+) +[RT] +(?P<id>[0-9A-Fa-f]{{8}}) *{_BYTES}")
_N2K = re.compile(
    r"A(?P<t>\d{6}\.\d+) +(?P<source>[0-9A-Fa-f]{2})(?P<to>[0-9A-Fa-f]{2})(?P<priority>[0-9A-Fa-f]) +"
    r"(?P<pgn>[0-9A-Fa-f]{5}) +(?P<data>(?:[0-9A-Fa-f]{2})*)"
)
_CANBOAT = re.compile(
    r"(?P<t>\d{4}-\d\d-\d\d[T -]\d\d:\d\d:\d\d(?:\.\d+)?Z?),(?P<priority>\d),(?P<pgn>\d+),(?P<source>\d+),(?P<to>\d+),"
    r"(?P<n>\d+)(?P<data>(?:,[0-9A-Fa-f]{2})*)"
)


class _Dialect(NamedTuple):
    """Text format (dialect) of CAN logs, for example that of candump: its name, the pattern and the parser of a line.

    Attributes
    ----------
    name : str
        Name of the dialect.
    form : re.Pattern
        Pattern of a line with a frame.
    frames : callable
        Function that takes the state of the log and the texts of the pattern's groups by name, and yields the CAN
        frames of the line. The function may change the state. The function may raise ValueError, for example for an
        invalid number.
    """

    name: str
    form: re.Pattern[str]  # of a line with a frame
    frames: Callable[[_LogState, Fields], Iterator[BusFrame]]  # converts the groups of a matching line to frames


class _LogState:
    """State of the parser of one CAN log in text form: the values of its heading, and a counter of fast packets.

    A fast packet is a message of NMEA 2000 above 8 bytes, which is sent as several frames.

    Attributes
    ----------
    start : float
        Time that is added to the times of the frames [s since 1970]; 0 if the log has no date that can be read.
    since_midnight : float
        Time of day of the start in the heading of a BusMaster log [s]; otherwise 0.
    base : int
        Number base of identifiers and data, 10 or 16.
    is_delta : bool
        Whether each time counts from the previous frame.
    sequence : int
        Sequence number of the next fast packet, 0 to 7.
    has_no_times : bool
        Whether a frame without a time was found.
    """

    def __init__(self) -> None:
        """Begin with the state before the first line of a log: time 0, base 16, and absolute times."""
        self.start = 0.0  # s since 1970
        self.since_midnight = 0.0  # s; time of day of the start
        self.base = 16  # number base of identifiers and data
        self.is_delta = False  # whether each time counts from the previous frame
        self.sequence = 0  # sequence number of the next fast packet
        self.has_no_times = False  # whether a frame without a time was found


def dialect_of(head: bytes) -> str:
    """Return the text format of a CAN log, for example "candump" or "ASC", from its first bytes; "" if it is none.

    ASC and BusMaster are recognised by their headings. For other formats at least half of the first 40 lines that are
    not blank must be frames. The compact form of candump has the name "candump -L", its other forms "candump".
    """
    lines = [line.strip() for line in head.decode("utf-8", "replace").splitlines() if line.strip()][:LOOKED_AT]
    if any(_BUSMASTER_DATE.match(line) or line.startswith("***BUSMASTER") for line in lines):
        return "BusMaster"
    if any(re.match(r"(?i)base +(hex|dec)", line) for line in lines):
        return "ASC"
    for candidate in _DIALECTS:
        # The last line may be cut off, and a log may begin in the middle of a line.
        matching = [k for k, line in enumerate(lines) if candidate.form.fullmatch(line)]
        if matching and len(matching) >= 0.5 * len(lines) and candidate.name not in ("ASC", "BusMaster"):
            return candidate.name
    return ""


def read_text_frames(path: Path, dialect: str) -> list[BusFrame]:
    """Read the data frames of a CAN log in text form. Warn of lines that are no valid frames.

    Parameters
    ----------
    path
        The log.
    dialect
        Its text format, as `dialect_of` returns it, for example "candump".

    Returns
    -------
    list of BusFrame
        The frames in the order of the file, with times in s since 1970; in a log without a date in s since its start or
        since midnight. Known lines without a frame, such as headings and comments, cause no warning.

    Raises
    ------
    SeatrialError
        If the file cannot be read, a frame has no time, or more lines are unknown than there are frames.
    """
    dialect_of_log = next(known for known in _DIALECTS if known.name == dialect)
    log = _LogState()
    frames: list[BusFrame] = []
    strange: list[int] = []  # numbers of lines
    try:
        with path.open(encoding="utf-8", errors="replace") as file:
            for number, line in enumerate(file, start=1):
                text = line.strip()
                match = dialect_of_log.form.fullmatch(text)
                try:
                    if match is not None:
                        frames += dialect_of_log.frames(log, match.groupdict(default=""))
                    elif text and not _is_heading(log, dialect_of_log.name, text):
                        strange.append(number)
                except ValueError:  # an invalid number, or a date that does not exist
                    strange.append(number)
    except OSError as error:
        raise SeatrialError(f"{path}: cannot be read: {error.strerror}; check its path and permissions") from error
    if log.has_no_times:
        raise SeatrialError(
            f"{path}: its frames have no times; record again with times: candump -ta can0, or candump -L can0"
        )
    if len(strange) > len(frames):
        raise SeatrialError(
            f"{path}: cannot be read as a CAN log: line {strange[0]} is not a frame of {dialect}; correct or remove "
            "such lines"
        )
    if strange:
        text = f"{path}: {counted(len(strange), 'line')} left out, not CAN frames; check the first, line {strange[0]}"
        warn(text)
    return _with_continuous_times(log, dialect_of_log.name, frames)


def _with_continuous_times(log: _LogState, dialect: str, frames: list[BusFrame]) -> list[BusFrame]:
    """Return CAN frames with continuous times: the start of the log (`log.start`) plus the time in the frame [s].

    Times that count from the previous frame are summed; for "candump" (not "candump -L") they do so if all are below
    one day and any is less than the one before. In formats with times of day ("BusMaster", "Yacht Devices", "N2K"), 24
    h are added from each frame on whose time is more than 12 h before the previous one (midnight). The start is in s
    since 1970, or 0 if the log has no date.
    """
    t, total = [frame.t for frame in frames], 0.0
    is_delta = log.is_delta
    if dialect == "candump" and t and max(t) < DAY:  # -td counts from the previous frame, -tz from the first
        is_delta = any(b < a for a, b in pairwise(t))
    if is_delta:
        times = []
        for step in t:
            total += step
            times.append(total)
        t = times
    elif dialect in ("BusMaster", "Yacht Devices", "N2K"):
        for k in range(1, len(t)):
            total += DAY * (t[k] + total < t[k - 1] - DAY / 2)
            t[k] += total
    return [frame._replace(t=log.start + time) for frame, time in zip(frames, t, strict=True)]


def _is_heading(log: _LogState, dialect: str, line: str) -> bool:
    """Return whether a line of a CAN log without a data frame is a known one: a heading, a comment or an event.

    The date, the number base and the mode of the times (absolute, or counted from the previous frame) in a heading are
    stored in `log`. Known lines are: in BusMaster those that begin with ***, in ASC see `_is_asc_heading`, otherwise
    comments (#, //, ;), error frames, and in canboat lines without a comma. Raise ValueError for a date that does not
    exist.
    """
    if dialect == "ASC":
        return _is_asc_heading(log, line)
    if dialect == "BusMaster":
        if (date := _BUSMASTER_DATE.match(line)) is not None:
            day, month, year, hours, minutes, seconds, milliseconds = (int(part) for part in date.groups())
            log.start = datetime(year, month, day, tzinfo=UTC).timestamp()  # the frames have the time of day
            log.since_midnight = 3600.0 * hours + 60.0 * minutes + seconds + 1e-3 * milliseconds
        elif line == "***DEC***":
            log.base = 10
        elif line in ("***RELATIVE MODE***", "***ABSOLUTE MODE***"):
            log.start += log.since_midnight  # in these modes the frames count from the start
            log.is_delta = line.startswith("***REL")
        return line.startswith("***")
    return line.startswith(("#", "//", ";")) or "ERRORFRAME" in line or (dialect == "canboat" and "," not in line)


def _is_asc_heading(log: _LogState, line: str) -> bool:
    """Return whether a line of an ASC file without a frame is a known one: a heading, an event, or a text.

    An event begins with a time. A text is any line that begins without a digit. Of several dates the first with a known
    month counts. The date, the number base and the mode of the times (absolute, or counted from the previous frame) in
    a heading are stored in `log`.
    """
    low = line.lower()
    if (date := _ASC_DATE.match(line)) is not None:
        if not log.start:
            log.start = _asc_date(date.groupdict(default=""))
        return True
    if low.startswith("base"):
        log.base = 10 if "dec" in low.split() else 16
        log.is_delta = "relative" in low.split()
        return True
    event = _ASC_EVENT.fullmatch(line)
    return event is not None or not line[0].isdigit()


def _asc_date(parts: Fields) -> float:
    """Return the date and time in the heading of an ASC file, taken as UTC [s since 1970]; 0 if the month is unknown.

    `parts` are the texts of the heading by name: year, month, day, h, m, s, and half ("am", "pm", or "" for 24 h).
    Raise ValueError for a day that does not exist.
    """
    month = next((k for k, name in enumerate(_MONTHS, 1) if re.match(name, parts["month"].lower())), 0)
    hours = int(parts["h"])
    if parts["half"]:
        hours = hours % 12 + 12 * (parts["half"].lower() == "pm")
    if not month:
        return 0.0
    day = datetime(int(parts["year"]), month, int(parts["day"]), tzinfo=UTC).timestamp()
    return day + 3600.0 * hours + 60.0 * int(parts["m"]) + float(parts["s"])


def _candump_frames(log: _LogState, parts: Fields) -> Iterator[BusFrame]:
    """Yield the CAN frame of a candump line; `parts` are its texts: time "t", "bus", "id" and hexadecimal "data".

    An identifier of more than 3 digits has 29 bits. CAN FD frames, remote requests, error messages and data above 8
    bytes yield no frame. A line without a time sets `log.has_no_times`. Raise ValueError if the number of data bytes
    differs from the number in the line.
    """
    text = parts["data"]
    if not parts["t"]:
        log.has_no_times = True
    if text.startswith("#") or text[:1] in ("R", "r"):  # CAN FD, or a remote request
        return
    word, is_long = int(parts["id"], 16), len(parts["id"]) > 3
    if word > 0x1FFFFFFF:  # an error message: identifiers have 29 bits
        return
    data = bytes.fromhex(text.replace(".", ""))
    if len(data) <= LONGEST_FRAME and int(parts.get("n") or len(data)) == len(data):
        yield BusFrame(_text_seconds(parts["t"]), parts["bus"], word | (EXTENDED if is_long else 0), data)
    elif len(data) <= LONGEST_FRAME:
        raise ValueError(text)


def _text_seconds(text: str) -> float:
    """Convert the time in a line of a CAN log to s: a number of seconds, or an ISO date and time in UTC.

    A date and time give s since 1970. An empty text gives 0. Raise ValueError for other texts.
    """
    if "-" not in text:
        return float(text or "0")
    moment = datetime.fromisoformat(text.rstrip("Z"))
    return moment.replace(tzinfo=UTC).timestamp()


def _asc_frames(log: _LogState, parts: Fields) -> Iterator[BusFrame]:
    """Yield the CAN frame of a line of a Vector ASC file; no frame for a remote request.

    `parts` are the texts of the line by name, for example "id" and "data". `log.base` is their number base, 10 or 16.
    An identifier with an x has 29 bits. Data beyond 8 bytes are cut off. Raise ValueError for an invalid number.
    """
    data = bytes(int(part, log.base) for part in parts["data"].split())
    if parts["kind"] in "dD":
        word = int(parts["id"], log.base) | (EXTENDED if parts["long"] else 0)
        yield BusFrame(float(parts["t"]), parts["bus"], word, data[:LONGEST_FRAME])


def _busmaster_frames(log: _LogState, parts: Fields) -> Iterator[BusFrame]:
    """Yield the CAN frame of a BusMaster line with its time [s], which is usually the time of day.

    Remote requests and data above 8 bytes yield no frame. The kind "x" has 29 bits of identifier, the kind "s" 11.
    `parts` are the texts of the line by name, for example "id" and "data". `log.base` is their number base, 10 or 16;
    an identifier with 0x is always hexadecimal. Raise ValueError for an invalid number.
    """
    data = bytes(int(part, log.base) for part in parts["data"].split())
    word = int(parts["id"], 16 if parts["id"].startswith("0x") else log.base)
    if parts["kind"] in ("s", "x") and len(data) <= LONGEST_FRAME:
        hours, minutes, seconds, ticks = (int(part) for part in parts["t"].split(":"))
        t = 3600.0 * hours + 60.0 * minutes + seconds + 1e-4 * ticks
        yield BusFrame(t, parts["bus"], word | (EXTENDED if parts["kind"] == "x" else 0), data)


def _yacht_frames(log: _LogState, parts: Fields) -> Iterator[BusFrame]:
    """Yield the CAN frame of a line in Yacht Devices' RAW format, with the time since midnight [s].

    `parts` are the texts of the line by name: time "t", "id" and "data". The identifier has 29 bits, and the bus is
    "1". Data beyond 8 bytes are cut off. `log` is not used.
    """
    hours, minutes, seconds = parts["t"].split(":")
    t = 3600.0 * int(hours) + 60.0 * int(minutes) + float(seconds)
    yield BusFrame(t, "1", int(parts["id"], 16) | EXTENDED, bytes.fromhex(parts["data"])[:LONGEST_FRAME])


def _n2k_frames(log: _LogState, parts: Fields) -> Iterator[BusFrame]:
    """Yield the CAN frames of an NMEA 2000 message in Actisense's N2K ASCII format, with the time since midnight [s].

    `parts` are the texts of the line by name, for example "pgn" and "data". A message above 8 bytes becomes several
    frames (a fast packet), which increases the sequence number in `log`.
    """
    clock = parts["t"]
    t = 3600.0 * int(clock[:2]) + 60.0 * int(clock[2:4]) + float(clock[4:])
    numbers = [int(parts[name], 16) for name in ("priority", "pgn", "source", "to")]
    yield from _message_frames(log, t, numbers, bytes.fromhex(parts["data"]))


def _canboat_frames(log: _LogState, parts: Fields) -> Iterator[BusFrame]:
    """Yield the CAN frames of an NMEA 2000 message in canboat's text format, with the time since 1970 [s].

    `parts` are the texts of the line by name, for example "pgn" and "data". A message above 8 bytes becomes several
    frames (a fast packet), which increases the sequence number in `log`. Raise ValueError if the number of data bytes
    differs from the number in the line.
    """
    text = parts["t"]
    t = _text_seconds(text[:10] + "T" + text[11:])
    numbers = [int(parts[name]) for name in ("priority", "pgn", "source", "to")]
    data = bytes.fromhex(parts["data"].replace(",", ""))
    if len(data) != int(parts["n"]):
        raise ValueError(text)
    yield from _message_frames(log, t, numbers, data)


def _message_frames(log: _LogState, t: float, numbers: Sequence[int], data: bytes) -> Iterator[BusFrame]:
    """Yield the CAN frames of a complete NMEA 2000 message at the time `t` [s].

    Decoders then read the message as from a bus, which has the name "1". `numbers` are priority, PGN (number of the
    message), source and destination address. Data above 8 bytes become several frames (a fast packet), which increases
    the sequence number in `log`; up to 8 bytes are always a single frame. A PGN above 0x3FFFF or an address above 255
    yields no frame.
    """
    priority, pgn, source, to = numbers
    if pgn > LARGEST_PGN or source > 255 or to > 255:
        return
    is_addressed = pgn >> 8 & 0xFF < 0xF0
    word = EXTENDED | (priority & 7) << 26 | (pgn | (to if is_addressed else 0)) << 8 | source
    if len(data) <= LONGEST_FRAME:
        yield BusFrame(t, "1", word, data)
        return
    first = log.sequence << 5
    log.sequence = (log.sequence + 1) % 8
    yield BusFrame(t, "1", word, bytes([first, len(data)]) + data[:6])
    for k, at in enumerate(range(6, len(data), 7), start=1):
        yield BusFrame(t, "1", word, bytes([first | k]) + data[at : at + 7].ljust(7, b"\xff"))


_DIALECTS = (
    _Dialect("candump -L", _COMPACT, _candump_frames),
    _Dialect("candump", _SPACED, _candump_frames),
    _Dialect("ASC", _ASC, _asc_frames),
    _Dialect("BusMaster", _BUSMASTER, _busmaster_frames),
    _Dialect("Yacht Devices", _YACHT, _yacht_frames),
    _Dialect("N2K", _N2K, _n2k_frames),
    _Dialect("canboat", _CANBOAT, _canboat_frames),
)
