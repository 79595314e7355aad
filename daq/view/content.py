"""Content of a log as the page shows it: types of the answers of the server."""

from __future__ import annotations

from msgspec import Struct

WAITING, LIVE, WHOLE, CUT = "waiting", "live", "whole", "cut off"  # states of a log


class SignalRow(Struct):
    """One signal in the list of the page: its id for requests, its name, its unit, and whether its value is held.

    The id is TOPIC:COLUMN. The value of a held signal stays constant until the next sample.
    """

    id: str
    name: str
    unit: str
    held: bool


class TableRow(Struct):
    """Table of samples of one device or controller: its topic, its signals, and how regularly the samples came.

    Attributes
    ----------
    device
        Name of the device; "signals" for imported signals.
    topic
        Topic of the log.
    title
        Kind of the samples. It is followed by the name of the thruster, or by the number of the node if the rig has no
        thruster there. Empty for an imported signal.
    signals
        Signals with at least one finite value.
    samples
        Number of samples in memory.
    expected
        Expected rate of the samples by the rig [Hz]; NaN if it is unknown.
    rate
        Mean rate of the samples in memory [Hz]; NaN unless they have two different times.
    recent
        Number of samples in the last 10 s of the log, without one at their begin, divided by this time [Hz]. The time
        is shorter if the first sample is later. NaN without samples, or if the log ends with the first one.
    gap, gap_at
        Longest time between two samples [s], and its begin [s of the log]; NaN with fewer than two samples.
    silent
        Time from the last sample to the end of the log [s]; NaN without samples.
    """

    device: str
    topic: str
    title: str
    signals: list[SignalRow]
    samples: int
    expected: float
    rate: float
    recent: float
    gap: float
    gap_at: float
    silent: float


class EventRow(Struct):
    """Event of the log: its time [s of the log], kind and text."""

    t: float
    kind: str
    text: str


class PortRow(Struct):
    """Last counters of the port of a device."""

    device: str
    port: str
    bytes_in: int
    frames: int
    checksum_errors: int
    unparsed_bytes: int
    dropped: int
    reconnects: int


class Content(Struct):
    """Content of a log, as the page shows it.

    Attributes
    ----------
    name, path
        Name and path of the log.
    state
        WAITING (the file does not exist yet), LIVE (it grows), WHOLE, or CUT (it has no end and does not grow).
    utc
        UTC of time zero [s since 1970].
    end
        Time of the last message [s of the log].
    shown_from
        Time from which samples are in memory [s of the log]; above 0 in a very long recording only.
    tables, events, ports
        Tables of samples, events, and last counters of the ports.
    n_events
        Number of events of the log. If there are more than 2000, `events` has only the first and the last 1000.
    tracks
        Names of the tracks: the topics of GNSS receivers, and "x, y" for imported positions.
    warnings
        Tables that cannot be read, and unless the log is LIVE the faults of the log.
    imported
        Whether [[log]] tables apply: an import map made the log, the map can be read, and its files have one origin.
    """

    name: str
    path: str
    state: str
    utc: float = 0.0
    end: float = 0.0
    shown_from: float = 0.0
    tables: list[TableRow] = []
    events: list[EventRow] = []
    n_events: int = 0
    ports: list[PortRow] = []
    tracks: list[str] = []
    warnings: list[str] = []
    imported: bool = False


class FindingRow(Struct):
    """Finding of `seatrial check`: severity, device, name of the check, text and advice."""

    level: str
    where: str
    check: str
    text: str
    advice: str


class Track(Struct):
    """Track of the boat over ground: times [s of the log], and positions east and north [m].

    Positions of a GNSS receiver count from its first position in memory. Imported positions are as in the log: east is
    y, and north is x.
    """

    t: list[float]
    east: list[float]
    north: list[float]


class CutText(Struct):
    """Texts of intervals, for other commands.

    Attributes
    ----------
    options
        `--from A --to B` for each interval, one line each.
    commands
        A command of `seatrial ident vehicle` for each interval, one line each.
    toml
        [[log]] tables of an import map. Empty if such tables do not apply (`Content.imported`).
    """

    options: str
    commands: str
    toml: str
