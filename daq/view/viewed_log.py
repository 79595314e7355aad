"""Log of a web page: its samples in memory, the points to draw, its events, rates, tracks and cut intervals.

The log is only read, also while a recorder still writes it.
Times on the page are in s from the first sample, as those of `--from` and `--to` of `seatrial ident`.
"""

from __future__ import annotations

import contextlib
import glob
import json
import math
import shlex
import threading
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from seatrial.daq.checks import check_devices, worst_first
from seatrial.daq.errors import SeatrialError
from seatrial.daq.geometry import local_ned
from seatrial.daq.importers.import_map import parse_import_map
from seatrial.daq.log import Log, LogTable, log_tables, open_log, schema, segment_path
from seatrial.daq.rig import Rig, Thruster
from seatrial.daq.samples import Ahrs, Autopilot, Battery, Command, Gnss, PortHealth, Scalar
from seatrial.daq.view.columns import Columns
from seatrial.daq.view.content import (
    CUT,
    LIVE,
    WAITING,
    WHOLE,
    Content,
    CutText,
    EventRow,
    FindingRow,
    PortRow,
    Track,
)
from seatrial.daq.view.decimation import Array, Curve, decimate

REFRESH_S = 0.5  # wall s between two looks at a growing log
STOPPED_S = 10.0  # wall s without a new byte after which a log without its end counts as cut off
FIRST_BYTES = 64  # a file with more bytes has the first record of a log
MAX_EVENTS = 2000  # of more events only the first and the last half are shown
MAX_LIVE_BYTES = 400_000_000  # samples in memory while a log grows; above, the oldest quarter is no longer shown
NO_ZERO = (Battery, Autopilot)  # kinds that no fit uses, so that no fit counts its time from them


class ViewedLog:
    """One log of the page. Its methods may be called by several threads; none of them writes a file.

    Parameters
    ----------
    path
        First segment of the log.
    wait
        Whether the file may not exist yet, because a command is about to record it.

    Raises
    ------
    SeatrialError
        If the file is no log; with `wait` only when it exists.
    """

    def __init__(self, path: Path, wait: bool = False) -> None:
        """Read the log. With `wait`, a file that does not exist yet is read later.

        Raise SeatrialError if the file is not a log, or if it does not exist and `wait` is false.
        """
        self.path, self._wait = path, wait
        self._lock = threading.Lock()
        self._log: Log | None = None
        self._looked, self._grown = -math.inf, time.monotonic()
        self._findings: list[FindingRow] | None = None
        with self._lock:
            self._clear()
            self._look()

    def content(self) -> Content:
        """Return the content of the log as it is now. A growing log is read on, at most twice a second (`_look`)."""
        with self._lock:
            self._look()
            return self._content

    def curve(self, signal: str, begin: float, end: float, n_intervals: int) -> Curve:
        """Return the points to draw of a signal between two times [s of the log].

        `signal` is the id of the signal (`SignalRow`); the other parameters are those of `decimate`. The last value of
        a held signal is drawn on to `end`, but not beyond the end of the log. Raise KeyError if there is no such
        signal.
        """
        topic, _, name = signal.rpartition(":")
        with self._lock:
            table, zero = self._tables[topic], self._zero
            t, values, longest = table.t, table.values(name), table.longest(name)
            end_of_log = self._log.end if self._log else 0.0
        found = decimate(t, values, begin + zero, end + zero, n_intervals, longest)
        if table.is_step(name) and len(found.t) and found.t[-1] < end_of_log:  # the last value holds on
            last = min(max(end + zero, float(found.t[-1])), end_of_log)
            found = Curve(np.append(found.t, last), np.append(found.value, found.value[-1]))
        return Curve(found.t - zero, found.value)

    def track(self, name: str, begin: float, end: float, n_points: int) -> Track:
        """Return the points of a track between two times [s of the log], without the end, at most `n_points`.

        If there are more points, every second, third, ... one is returned. Raise KeyError if there is no such track.
        """
        with self._lock:
            t, east, north = self._position(name)
            t = t - self._zero
        first, last = np.searchsorted(t, (begin, end)).tolist()
        step = max(-(-(last - first) // max(n_points, 1)), 1)
        return Track(t[first:last:step].tolist(), east[first:last:step].tolist(), north[first:last:step].tolist())

    def findings(self) -> list[FindingRow] | None:
        """Return the findings of the device checks, worst first; None while the log does not exist or still grows.

        They are computed by the first call after the log was opened. An error of the checks becomes a finding.
        """
        if self.content().state in (WAITING, LIVE):
            return None
        if self._findings is None:
            try:
                with open_log(self.path) as log, log.keeping_tables():
                    found = worst_first(check_devices(log))
                self._findings = [FindingRow(f.level, f.where, f.check, f.text, f.advice) for f in found]
            except SeatrialError as error:
                self._findings = [FindingRow("warning", self.path.name, "check", str(error), "")]
        return self._findings

    def cut(self, intervals: Sequence[tuple[float, float]]) -> CutText:
        """Return intervals (begin, end) [s of the log] as texts that other commands accept.

        The times in the texts are in s, rounded to ms. Raise ValueError if an interval is empty or begins before 0.
        """
        if any(not 0.0 <= begin < round(end, 3) or begin >= end for begin, end in intervals):
            raise ValueError("an interval must begin at 0 s or later, and end after its begin")
        options = [f"--from {begin:.3f} --to {end:.3f}" for begin, end in intervals]
        names = [f"vehicle-{k}" for k in range(1, len(intervals) + 1)] if len(intervals) > 1 else ["vehicle"]
        log = shlex.quote(str(self.path))
        commands = [
            f"seatrial ident vehicle {log} {window} --out {name}" for window, name in zip(options, names, strict=False)
        ]
        with self._lock:
            shift = self._shift_to_source()
            run = self._log.metadata.get("import.run", "") if self._log else ""
        match = f"match = {json.dumps(glob.escape(run), ensure_ascii=False)}\n" if run else ""
        tables = [
            f'[[log]]\nname = "part{k}"\nt_from = {begin + shift:.3f}\nt_to = {end + shift:.3f}\n{match}'
            for k, (begin, end) in enumerate(intervals, start=1)
            if shift is not None
        ]
        return CutText("\n".join(options), "\n".join(commands), "\n".join(tables))

    def _shift_to_source(self) -> float | None:
        """Return the clock of the imported source minus the time of the log [s], as [[log]] tables need it.

        None if no import map made the log, if the map cannot be read, or if its files have different origins.
        """
        text = self._log.attachments.get("import.toml") if self._log else None
        if text is None:
            return None
        with contextlib.suppress(SeatrialError, UnicodeDecodeError):
            sources = parse_import_map(text.decode(), self.path.with_name("import.toml")).sources
            origins = {source.time.origin if source.time else 0.0 for source in sources}
            if len(origins) == 1:
                return self._zero - origins.pop()
        return None

    def _clear(self) -> None:
        """Forget all samples, events, counters and time zero. The state of the content becomes WAITING."""
        self._tables: dict[str, Columns] = {}
        self._events: list[tuple[float, str, str]] = []
        self._ports: dict[str, PortHealth] = {}
        self._problems: dict[str, None] = {}
        self._read_to, self._shown_from = 0.0, -math.inf
        self._zero, self._has_zero = 0.0, False
        self._content = Content(self.path.name, str(self.path), WAITING)

    def _look(self) -> None:
        """Read what is new in the log, unless this was done less than 0.5 s ago.

        A file that now exists is opened. A growing log is read on. It is opened and read again when it has its end, or
        has not grown for 10 s. A log that does not grow is opened again if a recorder continues it (`_has_continued`).
        """
        now = time.monotonic()
        if now - self._looked < REFRESH_S:
            return
        if self._log is None:
            if not self._wait or self._exists():
                self._open(growing=True)
        elif self._content.state == LIVE:
            if self._log.extend():
                self._grown = now
            if self._log.complete or now - self._grown > STOPPED_S:
                self._open(growing=False)  # now with a record that is cut off at the end, and with all warnings
            else:
                self._take_new(self._log.end)
        elif self._has_continued(self._log):
            self._open(growing=True)
        self._looked = time.monotonic()

    def _exists(self) -> bool:
        """Return whether the file of the log exists and has its first record."""
        try:
            return self.path.stat().st_size > FIRST_BYTES
        except OSError:
            return False

    def _has_continued(self, log: Log) -> bool:
        """Return whether a recorder has started the next segment (file) of a log, or writes its last file again."""
        number = log.paths[-1].stem.removeprefix(self.path.stem).removeprefix(".")
        following = segment_path(self.path, int(number or 0) + 1)
        return following.exists() or (not log.complete and self._is_written(log))

    def _is_written(self, log: Log) -> bool:
        """Return whether the last file of a log was written in the last 10 s."""
        try:
            return time.time() - log.paths[-1].stat().st_mtime < STOPPED_S
        except OSError:
            return False

    def _open(self, growing: bool) -> None:
        """Open the log and read everything again. With `growing`, it is LIVE if it has no end and is being written.

        Otherwise its state is WHOLE if it has its end, and CUT if not.
        """
        log = open_log(self.path, growing=growing)
        live = growing and not log.complete and self._is_written(log)
        if growing and not log.complete and not live:
            log = open_log(self.path)
        if self._log is not None:
            self._log.close()
        self._clear()
        self._log, self._grown, self._findings = log, time.monotonic(), None
        self._content.state = LIVE if live else WHOLE if log.complete else CUT
        self._take_new(log.end if live else math.inf)

    def _take_new(self, end: float) -> None:
        """Read the messages from where the last call ended to a log time [s since 1970], without the end itself."""
        log = self._log
        assert log is not None
        if log.counts and end > self._read_to:
            part = log.part(self._read_to, end)
            with part.keeping_tables():
                for table in log_tables(part, self._note):
                    if len(table.rows):
                        self._table_of(table).append(table.rows)
            try:
                self._events += part.events()
                for device in part.sources(PortHealth):
                    if counters := part.health(device):
                        self._ports[device] = counters[-1][1]
            except SeatrialError as error:
                self._note(error)
            self._read_to = end
        if self._content.state == LIVE:
            self._forget_oldest()
        self._describe(log)

    def _note(self, error: SeatrialError) -> None:
        """Keep the message of a table that cannot be read, as a warning of the page."""
        self._problems[str(error)] = None

    def _table_of(self, table: LogTable) -> Columns:
        """Return the samples in memory to which a part of a table belongs. A new table begins empty."""
        topic = schema.topic(table.kind, table.source, table.node)
        if topic not in self._tables:
            title, device = table.kind.__name__, table.source
            if table.kind is Scalar:
                title, device = "", "signals"
            elif table.node is not None:
                names = [t.name for t in self._thrusters() if (t.device, t.node) == (table.source, table.node)]
                title += f" {names[0] if names else table.node}"
            self._tables[topic] = Columns(table, title, device, topic)
        return self._tables[topic]

    def _rig(self) -> Rig | None:
        """Return the rig of the log; None if the log has no rig, or if its rig cannot be read."""
        with contextlib.suppress(SeatrialError):
            return self._log.rig if self._log is not None else None
        return None

    def _thrusters(self) -> tuple[Thruster, ...]:
        """Return the thrusters of the rig of the log; none if the log has no rig, or one that cannot be read."""
        rig = self._rig()
        return tuple(rig.thrusters) if rig else ()

    def _forget_oldest(self) -> None:
        """Drop the oldest quarter of a growing log from memory if its samples need more than 400 MB."""
        if sum(table.n_bytes for table in self._tables.values()) > MAX_LIVE_BYTES:
            begins = [float(table.t[0]) for table in self._tables.values() if len(table.t)]
            self._shown_from = min(begins) + 0.25 * (self._read_to - min(begins))
            for table in self._tables.values():
                table.drop_before(self._shown_from)

    def _describe(self, log: Log) -> None:
        """Store the content of the log for the page. Time zero is set once, as soon as there is a sample for it."""
        if not self._has_zero:
            self._zero, self._has_zero = self._first_time(log)
        zero, end, rig = self._zero, log.end, self._rig()
        n, half = len(self._events), MAX_EVENTS // 2
        events = self._events if n <= MAX_EVENTS else self._events[:half] + self._events[-half:]
        about = self._content
        warnings = [] if about.state == LIVE else log.warnings
        self._content = Content(
            name=about.name, path=about.path, state=about.state, utc=zero, end=end - zero,
            shown_from=max(self._shown_from - zero, 0.0),
            tables=[table.row(zero, end, self._expected_rate(table, rig)) for table in self._tables.values()],
            events=[EventRow(t - zero, kind, text) for t, kind, text in events], n_events=n,
            ports=[
                PortRow(
                    device, port.port, port.bytes_in, port.frames, port.checksum_errors, port.unparsed_bytes,
                    port.dropped, port.reconnects,
                )
                for device, port in self._ports.items()
            ],
            tracks=self._track_names(), warnings=[*warnings, *self._problems],
            imported=self._shift_to_source() is not None,
        )  # fmt: skip

    def _expected_rate(self, table: Columns, rig: Rig | None) -> float:
        """Return the rate of a table by the rig [Hz], which the controllers of a device share; NaN if it is unknown.

        Of an autopilot or a ship's bus, the rate in the rig applies to tables of class `Ahrs` only; other tables have
        NaN. Commands have NaN too.
        """
        device = next((d for d in rig.devices if d.name == table.device), None) if rig else None
        if device is None or table.kind is Command or (device.sends_many_kinds and table.kind is not Ahrs):
            return math.nan
        return device.rate_hz / sum((t.device, t.kind) == (table.device, table.kind) for t in self._tables.values())

    def _first_time(self, log: Log) -> tuple[float, bool]:
        """Return the time of the first sample that a fit can use [s since 1970], as `ident` counts its times.

        Without such a sample it is the start of the log, and the second result is False. A fix counts from the first
        position on.
        """
        firsts = []
        for table in self._tables.values():
            column = {Gnss: "lat", Scalar: "value"}.get(table.kind, "t")
            finite = np.flatnonzero(np.isfinite(table.values(column)))
            if table.kind not in NO_ZERO and len(finite):
                firsts.append(float(table.t[finite[0]]))
        return min(firsts, default=log.start), bool(firsts)

    def _track_names(self) -> list[str]:
        """Return the names of the tracks: topics of GNSS receivers with a position, "x, y" for imported positions."""
        names = [t.topic for t in self._tables.values() if t.kind is Gnss and np.isfinite(t.values("lat")).any()]
        return [*names, "x, y"] if {"/signal/x", "/signal/y"} <= set(self._tables) else names

    def _position(self, name: str) -> tuple[Array, Array, Array]:
        """Return the times [s since 1970] of a track and its positions [m] east and north.

        Positions of a GNSS receiver count from its first position. Imported positions are returned as they are: east is
        y, interpolated to the times of x, and north is x. Raise KeyError if there is no such track.
        """
        if name not in self._content.tracks:
            raise KeyError(name)
        if name == "x, y":
            x, y = self._tables["/signal/x"], self._tables["/signal/y"]
            return x.t, np.interp(x.t, y.t, y.values("value")), x.values("value")
        table = self._tables[name]
        lat, lon = table.values("lat"), table.values("lon")
        fix = np.isfinite(lat) & np.isfinite(lon)
        north, east = local_ned(lat[fix], lon[fix])
        return table.t[fix], east, north
