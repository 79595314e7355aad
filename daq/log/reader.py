"""Reader of logs: tables of samples as numpy arrays, events and raw bytes (docs/formats/log.md).

    log = seatrial.daq.log.reader.open_log("run.mcap")
    ahrs = log.table(Ahrs, "ahrs")
    ahrs["t"], ahrs["yaw"]

Killed and truncated files open in the same way, with all complete messages. `log.warnings` describes the damage.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import importlib
import math
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.clock import CLOCK_STEP_S
from seatrial.daq.config import parse_rig, parse_toml
from seatrial.daq.errors import SeatrialError, printable
from seatrial.daq.log import schema
from seatrial.daq.log.cdr import ENCAPSULATION, HEAD, NANO, CdrLayout, cdr_layout, stamps
from seatrial.daq.log.mcap_chunk import Messages
from seatrial.daq.log.mcap_reader import LAST_NS
from seatrial.daq.log.schema import Measured
from seatrial.daq.log.segments import open_raw
from seatrial.daq.log.tables import resample
from seatrial.daq.log.watchdog_note import read_note
from seatrial.daq.rig import Rig
from seatrial.daq.samples import MEASURED, Ahrs, Command, Esc, PortHealth, Scalar, Servo

_COUNTERS = ("bytes_in", "frames", "checksum_errors", "unparsed_bytes", "dropped", "reconnects")
_DIRECTIONS = ("rx", "tx")
MAX_FRAME_ID = 256  # bytes
MAX_NODE_DIGITS = 9  # of a node id in a topic; int() of a text with thousands of digits raises an error
_COMPANIONS = {  # topics with the other columns of an AHRS sample: message type, and field of the message by column
    "device_time": (schema.DEVICE_TIME, {"t_rx": "t_rx", "t_device": "t_device"}),
    "mag": (schema.MAG, {f"m{axis}": f"magnetic_field.{axis}" for axis in "xyz"}),
}
_LITTLE = int.from_bytes(ENCAPSULATION[:2], "little")
_WHOLE = (0, LAST_NS)


def open_log(path: Path | str, growing: bool = False) -> Log:
    """Open a log, which may be whole, killed or damaged, with all its segments (files), to read its samples.

    Parameters
    ----------
    path
        First segment of the log, an MCAP file.
    growing
        Whether a program may still write the log. `Log.extend` then reads what is appended, and a record that is cut
        off at the end of the file is not read yet.

    Returns
    -------
    Log
        The open log. It is a context manager that closes the files.

    Raises
    ------
    SeatrialError
        If the file cannot be read or is no MCAP file.
    """
    return Log(Path(path), growing)


def import_library(name: str) -> Any:
    """Import an optional library and return its module.

    Parameters
    ----------
    name
        Name of the library, for example "pandas". It is one of those that ``pip install 'seatrial[tables]'`` installs.

    Raises
    ------
    SeatrialError
        If the library is missing. The message contains the command that installs it.
    """
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise SeatrialError(f"{name} is not installed: pip install 'seatrial[tables]'") from error


class Log:
    """One recorded log (MCAP), with all its segments (files). Times are times of the run clock [s since 1970].

    Attributes
    ----------
    path
        First segment.
    paths
        All segments.
    complete
        Whether every segment has its footer, the last record of a file that was closed.
    metadata
        Texts that the recorder wrote, by name.
    attachments
        Contents of the attached files, by name.
    start, end
        Times of receipt of the first and the last message [s since 1970]; 0 if the log has no messages.
    skipped
        Time [s] of the whole log before `start` of this view (`part`); 0 for the whole log.
    """

    skipped = 0.0

    def __init__(self, path: Path, growing: bool = False) -> None:
        """Open the log that begins with the MCAP file `path`, and read its index and metadata.

        With `growing`, the file may still be written (`extend`). Raise SeatrialError if the file cannot be read or is
        no MCAP file.
        """
        self.path = path
        self._file = open_raw(path, growing)
        self.paths = [raw.path for raw in self._file.files]
        self._note = read_note(path)
        self._span_ns = _WHOLE
        self._tables: dict[tuple[str, tuple[int, int]], NDArray[np.void]] | None = None
        self._read_spans: set[tuple[int, int]] = set()  # intervals of time whose tables are all kept
        self._use_index()

    def extend(self) -> bool:
        """Add the messages that were written to a growing log since it was opened or since the last call.

        Return whether anything was added. Views (`part`) that exist already keep their `start` and `end` and what they
        have computed, such as `counts`. Their tables that are read later have the new messages in their interval.
        Tables that `keeping_tables` keeps do not change. A segment that a recorder has started since is not added: open
        the log again.

        Raises
        ------
        SeatrialError
            If the file was closed since, and another file has replaced it.
        """
        if not self._file.extend():
            return False
        for name in ("counts", "rig", "vehicle", "sha256", "_spacing"):
            self.__dict__.pop(name, None)
        self._use_index()
        return True

    def _use_index(self) -> None:
        """Store the state, metadata, attachments and times of the files as attributes."""
        self.complete = self._file.complete
        self.metadata: dict[str, str] = {}
        for record in self._file.metadata:
            if record.name == "seatrial":
                self.metadata.update(record.metadata)
        self.attachments = {record.name: record.data for record in self._file.attachments}
        self.start, self.end = (ns / NANO for ns in self._file.span_ns or (0, 0))

    @contextlib.contextmanager
    def keeping_tables(self) -> Iterator[None]:
        """Keep all tables of the log in memory within a `with` block. The tables are read-only.

        The first call of `table` for an interval of time then reads all tables of this interval at once, and later
        calls return the same arrays. This is faster if a caller uses many tables, or uses a table more than once. After
        the block the log keeps no table any more.
        """
        self._tables, self._read_spans = {}, set()
        try:
            yield
        finally:
            self._tables = None

    def part(self, begin: float, end: float) -> Log:
        """Return a view of the log with the messages of an interval of time only.

        Messages outside the interval are not read. `start` and `end` are the limits of the interval, cut to the log. If
        the interval begins after the log, both are `begin`. If the interval ends before the log, `start` is the start
        of the log, and `end` is the earlier end of the interval. `counts`, `types`, `sources`, `nodes` and `sha256`
        remain those of the whole log. The view uses the same open files as the log. A part of a view has only the
        overlap of both intervals.

        Parameters
        ----------
        begin, end
            Interval of the time of receipt [s since 1970], without `end` itself.

        Raises
        ------
        SeatrialError
            If `begin` or `end` is NaN.
        """
        view = copy.copy(self)
        view.__dict__.pop("_spacing", None)
        view._span_ns = _span_ns(begin, end, self._span_ns)
        view.start, view.end = max(self.start, begin), max(min(self.end, end), begin)
        view.skipped = self.skipped + view.start - self.start
        return view

    def __enter__(self) -> Log:
        """Return the log itself, for a `with` block."""
        return self

    def __exit__(self, *_: object) -> None:
        """Close the files of the log. An error of the `with` block is passed on."""
        self.close()

    def close(self) -> None:
        """Close the files of the log. Tables that were read before stay valid. A later read opens the files again."""
        self._file.close()

    @property
    def warnings(self) -> list[str]:
        """Faults of the log, one line each, and the note of a watchdog that stopped the run.

        The unread parts of the files are read first, to find all faults; for a view (`part`), those of its interval.
        Faults outside that were found before are included.
        """
        self._file.verify(*self._span_ns)
        return [*self._file.warnings, *([self._note] if self._note else [])]

    @property
    def duration(self) -> float:
        """Time from the receipt of the first message to that of the last [s]; 0 if the log has no messages.

        For a view (`part`), the length of its interval, cut to the log. It is negative if the interval ends before the
        log.
        """
        return self.end - self.start

    @cached_property
    def sha256(self) -> str:
        """SHA-256 of the log in hexadecimal digits.

        For a log of several segments (files), the bytes of all, in order, are hashed. The value is computed once and
        kept until `extend` adds messages. OSError is raised if a file cannot be read.
        """
        digest = hashlib.sha256()
        for path in self.paths:
            with path.open("rb") as file:
                while block := file.read(1 << 20):
                    digest.update(block)
        return digest.hexdigest()

    @cached_property
    def rig(self) -> Rig | None:
        """Rig of the log, from the attached rig file. None without one, as in a log that was imported by a map.

        Relative paths in the rig are relative to the folder of the log.

        Raises
        ------
        SeatrialError
            If the attached file is no valid rig file.
        """
        data = self.attachments.get("rig.toml")
        if data is None:
            return None
        try:
            return parse_rig(data.decode(), self.path.parent / f"{self.path.name}:rig.toml", recorded=True)
        except UnicodeDecodeError as error:
            raise self._error(
                "the rig.toml in this log is not UTF-8 text; save the rig as UTF-8, and record the log again"
            ) from error

    @cached_property
    def vehicle(self) -> Mapping[str, float]:
        """Known model parameters of the boat, by name.

        The values are from the [vehicle] table of the rig. For an imported log they are from the [geometry] and [scale]
        tables of the import map. The mapping is empty if the log has neither.

        Raises
        ------
        SeatrialError
            If the attached file is damaged.
        """
        data = self.attachments.get("vehicle.toml")
        if data is None:
            return self.rig.vehicle if self.rig else {}
        table = parse_toml(data.decode(errors="replace"), self.path.parent / f"{self.path.name}:vehicle.toml")
        return {name: table.number(name) for name in table.values}

    @cached_property
    def counts(self) -> dict[str, int]:
        """Number of messages of each topic of the log, sorted by topic. Topics without messages are left out."""
        found: Counter[str] = Counter()
        for number, n in self._file.counts.items():
            found[self._file.channels[number].topic] += n
        return dict(sorted(found.items()))

    def types(self) -> dict[str, str]:
        """Return the message type of each topic of the log that has messages, by topic.

        The type is `package/msg/Name`, or "?" if it is unknown. If channels of a topic have different types, the last
        known one is returned.
        """
        schemas = self._file.schemas
        names = {c.topic: schemas[c.schema_id].name for c in self._file.channels.values() if c.schema_id in schemas}
        return {name: names.get(name, "?") for name in self.counts}

    def rate_and_gap(self, topic: str) -> tuple[float, float]:
        """Return mean rate [Hz] and longest gap [s] of the time stamps of a topic.

        The mean rate is the number of messages minus one, divided by the time from the earliest to the latest stamp.
        The gap is between stamps that follow each other in time. Both are NaN if the topic has a single time, or no
        message in the interval of a view (`part`). Raise KeyError if the log has no messages of the topic.
        """
        return self._spacing[topic].rate_and_gap()

    @property
    def clock_steps(self) -> dict[str, tuple[int, float]]:
        """Number and length of the steps back of the time stamps, by topic: (number of steps, longest step [s]).

        Only steps of more than 0.5 s (CLOCK_STEP_S) from one message to the next count. Possible causes are, for
        example, a clock that was set, or stamps from two clocks. Topics without such steps are left out, and so are
        events.
        """
        found = {topic: (item.n_back, item.longest_back) for topic, item in self._spacing.items() if item.n_back}
        found.pop("/event", None)
        return found

    @cached_property
    def _spacing(self) -> dict[str, _StampStatistics]:
        """Statistics of the time stamps of each topic (rate, gaps, backward steps), from one pass through the log.

        They are computed once. A view (`part`) has those of its interval; topics without messages there have no stamps.
        """
        found = {topic: _StampStatistics() for topic in self.counts}
        topics = {number: channel.topic for number, channel in self._file.channels.items()}
        for messages in self._file.read(None, *self._span_ns):
            channel, stamp = messages.heads["channel"], messages.heads["stamp_ns"] / NANO
            for number in np.unique(channel).tolist():
                found[topics[number]].add(stamp[channel == number])
        return found

    def to_pandas(self, rate: float = 10.0) -> Any:
        """Resample all numbers of the log to one time grid, and return them as a pandas.DataFrame.

        `seatrial.daq.log.resample` describes how values are averaged, held and interpolated.

        Parameters
        ----------
        rate
            Rate of the grid [Hz].

        Returns
        -------
        pandas.DataFrame
            One column for each number, with the UTC time as index. ``attrs["units"]`` has the units by column.

        Raises
        ------
        SeatrialError
            If pandas is not installed, if the rate is not positive, if the log has no samples, or if the grid has too
            many rows.
        """
        pandas = import_library("pandas")
        table = resample(self, rate)
        index = pandas.to_datetime(np.rint(table.t * NANO).astype(np.int64), unit="ns", utc=True).rename("time")
        frame = pandas.DataFrame(table.columns, index=index)
        frame.attrs["units"] = table.units
        return frame

    def to_xarray(self, rate: float = 10.0) -> Any:
        """Resample all numbers of the log to one time grid, and return them as an xarray.Dataset.

        `seatrial.daq.log.resample` describes how values are averaged, held and interpolated.

        Parameters
        ----------
        rate
            Rate of the grid [Hz].

        Returns
        -------
        xarray.Dataset
            One variable for each number over ``time`` (UTC). The attribute ``units`` of a variable has its unit.

        Raises
        ------
        SeatrialError
            If xarray is not installed, if the rate is not positive, if the log has no samples, or if the grid has too
            many rows.
        """
        xarray = import_library("xarray")
        table = resample(self, rate)
        time = np.rint(table.t * NANO).astype(np.int64).astype("datetime64[ns]")
        variables = {name: ("time", values, {"units": table.units[name]}) for name, values in table.columns.items()}
        return xarray.Dataset(variables, coords={"time": time})

    def sources(self, kind: type[Measured] | type[PortHealth]) -> list[str]:
        """Return the names of the devices in the log that have samples of a kind, for example `Gnss`.

        For `Scalar` they are the names of the signals. For `PortHealth` they are the devices with counters of their
        port. They are sorted by topic. The list is empty if there are none.
        """
        if kind is PortHealth:
            return [name.split("/")[2] for name in self.counts if name.startswith("/health/")]
        if kind is Scalar:
            return [name.removeprefix("/signal/") for name in self.counts if name.startswith("/signal/")]
        if kind in schema.NODE_TOPICS:
            return list(dict.fromkeys(source for source, _ in self._devices_and_nodes(kind)))
        last = schema.topic(kind, "*").rsplit("/", 1)[1]  # type: ignore[arg-type]
        pairs = [name.split("/")[1:] for name in self.counts]
        return [pair[0] for pair in pairs if len(pair) == 2 and pair[1] == last and pair[0] not in ("raw", "health")]

    def nodes(self, kind: type[Esc] | type[Command] | type[Servo], source: str) -> list[int]:
        """Return the sorted ids of the motor controllers (or servo outputs) of a device that have samples of a kind.

        `source` is the name of the device, and `kind` is `Esc`, `Command` or `Servo`. The list is empty if there are
        none.
        """
        return sorted(node for name, node in self._devices_and_nodes(kind) if name == source)

    def _devices_and_nodes(self, kind: type[Measured] | type[PortHealth]) -> list[tuple[str, int]]:
        """Return (device, id of the motor controller or servo output) for each that has samples of a kind.

        The kind is one of NODE_TOPICS: `Esc`, `Command`, `Servo`. The pairs are read from the names of the topics. A
        topic with an id that is not a number of at most 9 digits is ignored.
        """
        last = schema.NODE_TOPICS[kind]
        parts = [name.split("/")[1:] for name in self.counts]
        pairs = [(p[0], p[1]) for p in parts if len(p) == 3 and p[2] == last]
        return [(name, int(node)) for name, node in pairs if node.isdecimal() and len(node) <= MAX_NODE_DIGITS]

    def table(
        self, kind: type[Measured], source: str, node: int | None = None, begin: float = 0.0, end: float = np.inf
    ) -> NDArray[np.void]:
        """Return the samples of one device or signal of the log as a structured array.

        Parameters
        ----------
        kind
            Class of the samples.
        source
            Name of the device, or of the signal for `Scalar`.
        node
            Id of the controller or servo output, for `Esc`, `Command` and `Servo`. It may be None if the device has a
            single one. Other kinds do not use it.
        begin, end
            Interval of the time of receipt [s since 1970]: `begin <= t_rx < end`. Samples outside are left out. The log
            time counts, which a recorder never makes earlier than that of the message before.

        Returns
        -------
        Array (n,)
            Structured array with the columns t, t_rx, t_device and the fields of the sample. `t` is the estimated time
            of the sample [s since 1970] and never decreases: a time before that of the previous sample is replaced by
            it. The array is empty if all samples are outside the interval, and read-only within `keeping_tables`.

        Raises
        ------
        SeatrialError
            If the log has no such samples, if they cannot be decoded, if `node` is None and the device has several
            controllers, if `begin` or `end` is NaN, or if the memory is too small. If the whole log is read, also if no
            sample is readable.
        """
        if kind is Esc or kind is Command or kind is Servo:
            node = self._only_node(kind, source, node)
        topic = schema.topic(kind, source, node)
        span = _span_ns(begin, end, self._span_ns)
        try:
            if self._tables is None:
                return self._read_table(kind, topic, source, span)
            if span not in self._read_spans:
                self._read_spans.add(span)
                self._tables |= self._read_tables(span)
            if (topic, span) not in self._tables:
                self._tables[topic, span] = self._read_table(kind, topic, source, span)
            table = self._tables[topic, span]
            table.flags.writeable = False
            return table
        except MemoryError:
            raise self._error(
                f"{topic} has {self.counts.get(topic, 0)} messages, too many for the memory of this computer: "
                "read a shorter interval of time (begin, end), or a single segment"
            ) from None

    def _read_table(
        self, kind: type[Measured], topic: str, source: str, span: tuple[int, int], join: bool = True
    ) -> NDArray[np.void]:
        """Read the samples of one topic from the files of the log, as a structured array (n,).

        Parameters
        ----------
        kind
            Class of the samples.
        topic, source
            Topic, and name of its device or signal.
        span
            Interval of log times [ns since 1970], without its end.
        join
            Whether to add the columns of the companion topics of an AHRS: device times and magnetic field. If the
            messages have no ascending sequence numbers, the columns are not added: t_device and the field stay NaN, and
            t_rx is the log time.

        Raises
        ------
        SeatrialError
            If the topic has no messages, messages that cannot be decoded, or in the whole log no readable message.
        """
        rows = self._new_table(kind, topic, source, join)
        try:
            for messages in self._file.read(rows.channels, *span):
                rows.take(messages)
        except _NotNumberedError:
            return self._read_table(kind, topic, source, span, join=False)
        return self._with_ascending_times(rows.done(), topic, span)

    def _new_table(self, kind: type[Measured], topic: str, source: str, join: bool = True) -> _TopicTable:
        """Return a table without rows, which collects the messages of a topic.

        `kind` is the class of the samples, and `source` the name of the device. For an AHRS, the table also collects
        the topics with device times and magnetic field if `join` is true.

        Raises
        ------
        SeatrialError
            If the topic has no messages, or messages of another type.
        """
        return _AhrsTable(self, topic, source, join) if kind is Ahrs else _SampleTable(self, kind, topic)

    def _read_tables(self, span: tuple[int, int]) -> dict[tuple[str, tuple[int, int]], NDArray[np.void]]:
        """Read the samples of all devices and signals of the log in one pass, because a chunk contains many topics.

        `span` is the interval of log times [ns since 1970]. Return a structured array (n,) by topic and interval.
        Topics with errors are left out. `table` then reads the topic alone and raises the error. An AHRS without
        ascending sequence numbers is left out too. `table` then reads this AHRS alone, without its companion topics.
        """
        rows: dict[str, _TopicTable] = {}
        for kind in (*MEASURED, Command):
            for source in self.sources(kind):
                nodes = self._devices_and_nodes(kind) if kind in schema.NODE_TOPICS else [(source, None)]
                for node in (node for name, node in nodes if name == source):
                    topic = schema.topic(kind, source, node)
                    with contextlib.suppress(SeatrialError):
                        rows[topic] = self._new_table(kind, topic, source)
        channels = [number for collector in rows.values() for number in collector.channels]
        for messages in self._file.read(channels, *span):
            channel = messages.heads["channel"]
            for topic, collector in list(rows.items()):
                part = messages.where(np.isin(channel, collector.channels))
                try:
                    if len(part.offsets):
                        collector.take(part)
                except SeatrialError:
                    del rows[topic]
        tables = {}
        for topic, collector in rows.items():
            with contextlib.suppress(SeatrialError):
                tables[topic, span] = self._with_ascending_times(collector.done(), topic, span)
        return tables

    def _only_node(self, kind: type[Esc] | type[Command] | type[Servo], source: str, node: int | None) -> int:
        """Return `node`, or the id of the only motor controller (or servo output) of a device if `node` is None.

        `kind` is the class of its samples, and `source` the name of the device. A `node` that is not None is returned
        without a check. If it is None, the result is 0 for a device without a controller, and SeatrialError is raised
        for a device with several.
        """
        nodes = self.nodes(kind, source)
        if node is None and len(nodes) == 1:
            return nodes[0]
        if node is None and len(nodes) > 1:
            raise self._error(f"device {source} has several nodes, {nodes}: give one of them as `node`")
        return 0 if node is None else node

    def _with_ascending_times(self, table: NDArray[np.void], topic: str, span: tuple[int, int]) -> NDArray[np.void]:
        """Correct times in the column `t` of a table in place so that they never decrease, and return the table.

        A time that is less than the time before gets that time. Raise SeatrialError if the table of the topic is empty
        although it covers the whole log (`span`, in ns): no message of the topic is readable.
        """
        if not len(table) and span == _WHOLE:
            raise self._error(f"no message on {topic} is readable; the log is damaged: try `seatrial recover`")
        # Time estimates of the clock may jitter. The order of the samples is the order of the device and stays.
        np.maximum.accumulate(table["t"], out=table["t"])
        return table

    def events(self) -> list[tuple[float, str, str]]:
        """Return all events of the log as (time stamp [s since 1970], kind, text), in the order of the file.

        The list is empty if the log has no events. A view (`part`) has those of its interval. Characters that are not
        printable become escape sequences. Raise SeatrialError if an event cannot be decoded.
        """
        if "/event" not in self.counts:
            return []
        found = []
        for t, _, tail in self._decoded_messages("/event", schema.EVENT):
            kind, text = (printable(part.decode("utf-8", errors="replace")) for part in tail)
            found.append((t, kind, text))
        return found

    def health(self, device: str) -> list[tuple[float, PortHealth]]:
        """Return the counters of the port of a device over time, as (time stamp [s since 1970], counters).

        The counters (bytes, frames, errors, ...) count from the start of the log. The order is that of the file. Raise
        SeatrialError if the log has no counters of the device, or if they cannot be decoded.
        """
        found = []
        for t, row, (port,) in self._decoded_messages(f"/health/{device}", schema.HEALTH):
            n_in, n_frames, n_bad, n_unparsed, n_dropped, n_again = (int(row[name]) for name in _COUNTERS)
            bias, spread = float(row["clock_bias"]), float(row["clock_spread"])
            name = printable(port.decode("utf-8", errors="replace"))
            found.append((t, PortHealth(name, n_in, n_frames, n_bad, n_unparsed, n_dropped, n_again, bias, spread)))
        return found

    def raw(self, device: str) -> Iterator[tuple[float, str, bytes]]:
        """Yield the bytes of the port of a device as (time [s since 1970], direction, data), in the order of the file.

        The direction is "rx" for bytes read from the port and "tx" for bytes written to it. Raise SeatrialError if the
        log has no bytes of the device, or if they cannot be decoded.
        """
        for t, row, (data,) in self._decoded_messages(f"/raw/{device}", schema.RAW):
            yield t, _DIRECTIONS[min(int(row["direction"]), 1)], data

    def messages(self) -> Iterator[tuple[int, str, bytes]]:
        """Yield every message of the log without decoding: log time [ns since 1970], topic and data, in file order.

        The data are a copy of the encoded message. A view (`part`) yields the messages of its interval only.
        """
        topics = {number: channel.topic for number, channel in self._file.channels.items()}
        for messages in self._file.read(None, *self._span_ns):
            heads = (messages.heads[name].tolist() for name in ("log_ns", "channel"))
            for log_ns, channel, data in zip(*heads, messages.payloads(), strict=True):
                yield log_ns, topics[channel], bytes(data)

    def unit(self, signal: str) -> str:
        """Return the unit of an imported signal; "" if it is unknown.

        Raise SeatrialError if the log lacks the signal.
        """
        return self._channel_metadata(signal).get("unit", "")

    def hold(self, signal: str) -> str:
        """Return the hold of an imported signal, which describes the values between two samples; "linear" if unknown.

        "zero": the last value stays constant. "linear": values are interpolated. "sampled": a held output that is
        sampled at a rate; its value changed at an unknown time since the sample before. Raise SeatrialError if the log
        lacks the signal.
        """
        return self._channel_metadata(signal).get("hold", "linear")

    def role(self, signal: str) -> str:
        """Return whether an imported signal is an "input" or an "output" of the system; "output" if unknown.

        Raise SeatrialError if the log lacks the signal.
        """
        return self._channel_metadata(signal).get("role", "output")

    def rpm_max(self, signal: str) -> float | None:
        """Return the shaft speed [rev/min] at which an imported relative shaft speed is 1; None if it is unknown.

        It is known if the import map scaled a column with the unit of a shaft speed. Raise SeatrialError if the log
        lacks the signal.
        """
        try:
            found = float(self._channel_metadata(signal).get("rpm_max", ""))
        except ValueError:
            return None
        return found if 0.0 < found < np.inf else None

    def position_origin(self, signal: str) -> tuple[float, float] | None:
        """Return latitude and longitude [deg] of the zero of an imported position; None if they are unknown.

        They are known if the import computed the position from latitude and longitude. Raise SeatrialError if the log
        lacks the signal.
        """
        numbers = self._channel_metadata(signal).get("origin", "").split()
        try:
            lat, lon = map(float, numbers)
        except ValueError:
            return None
        return (lat, lon) if np.isfinite([lat, lon]).all() else None

    def _channel_metadata(self, signal: str) -> dict[str, str]:
        """Return the texts that the log has about an imported signal, by name, such as "unit", "hold" and "role".

        They are those of the first channel of the signal. Raise SeatrialError if the log lacks the signal.
        """
        return self._file.channels[self._channel_numbers(schema.topic(Scalar, signal))[0]].metadata

    def _error(self, text: str) -> SeatrialError:
        """Return an error whose message is the path of the log and `text`, as one line. The caller raises it.

        Line ends in the text are replaced: names in a damaged file may contain them.
        """
        return SeatrialError(f"{self.path}: {' '.join(text.split())}")

    def _channel_numbers(self, topic: str, type_name: str = "") -> list[int]:
        """Return the numbers of the MCAP channels that contain the messages of a topic.

        Parameters
        ----------
        topic
            Name of the topic.
        type_name
            Required message type, `package/msg/Name`; any type if it is empty.

        Raises
        ------
        SeatrialError
            If the topic has no messages, or if its message type is not the required one in CDR.
        """
        found = [number for number, channel in self._file.channels.items() if channel.topic == topic]
        if not found or topic not in self.counts:
            topics = ", ".join(self.counts) or "none"
            raise self._error(f"no messages on {topic}; use a topic that has messages: {topics}")
        for number in found if type_name else ():
            channel = self._file.channels[number]
            written = self._file.schemas.get(channel.schema_id)
            if written is None or written.name != type_name or channel.message_encoding != "cdr":
                written_type = "unknown" if written is None else f"{written.name} ({channel.message_encoding})"
                raise self._error(
                    f"{topic}: the message type is {written_type}, not {type_name} (cdr); use `seatrial import` for "
                    "logs of other programs"
                )
        return found

    def _missing_fields(self, topic: str, type_name: str) -> tuple[str, ...]:
        """Return the names of the fields that the messages of a topic lack, because an older version wrote the log.

        Only fields in `schema.ADDED` can be missing. A field is missing if the definition of the message type in the
        log, or one of several definitions, does not contain it; without a definition no field is missing. `type_name`
        is the message type, for example "seatrial_msgs/msg/Gnss". Raise SeatrialError if the topic has no messages.
        """
        channels = [self._file.channels[number] for number in self._channel_numbers(topic)]
        written = [self._file.schemas[c.schema_id].data for c in channels if c.schema_id in self._file.schemas]
        added = schema.ADDED.get(type_name, ())
        return tuple(name for name in added if not all(f" {name} ".encode() in data for data in written))

    def _decode_rows(self, messages: Messages, topic: str, type_name: str) -> NDArray[np.void]:
        """Decode the fields of fixed size of messages of a topic to a structured array, shape (n,).

        These are the header and all fields before the first string or sequence. Fields that older logs lack are left
        out.

        Parameters
        ----------
        messages
            The messages, in CDR.
        topic
            Name of the topic.
        type_name
            Message type, `package/msg/Name`.

        Raises
        ------
        SeatrialError
            If a message is too short, or is not in little-endian CDR.
        """
        wrong = self._error(
            f"a message on {topic} cannot be decoded as {type_name} (little-endian CDR): it is damaged or of another "
            "program; use another copy of the file, or `seatrial import` for logs of other programs"
        )
        lacking = self._missing_fields(topic, type_name)
        lengths = messages.lengths
        if np.any(lengths < HEAD.itemsize):
            raise wrong
        # In logs of seatrial a topic has one frame_id: try the layout of the first message for all messages.
        heads = messages.rows(HEAD)
        layout = _layout_for_length(type_name, heads["n_frame"][0] if len(heads) else 1, lacking)
        if layout is not None and np.all(lengths >= layout.dtype.itemsize):
            rows = messages.rows(layout.dtype)
            if not len(rows) or (np.all(rows["n_frame"] == rows["n_frame"][0]) and np.all(rows["endian"] == _LITTLE)):
                return rows
        if np.any(heads["endian"] != _LITTLE):
            raise wrong
        rows = np.zeros(len(heads), cdr_layout(type_name, b"", lacking).dtype)
        for n_frame in np.unique(heads["n_frame"]):
            mask = heads["n_frame"] == n_frame
            layout = _layout_for_length(type_name, n_frame, lacking)
            if layout is None or np.any(lengths[mask] < layout.dtype.itemsize):
                raise wrong
            decoded = messages.where(mask).rows(layout.dtype)
            for name in rows.dtype.names or ():
                rows[name][mask] = decoded[name]
        return rows

    def _decoded_messages(self, topic: str, type_name: str) -> Iterator[tuple[float, np.void, tuple[bytes, ...]]]:
        """Yield (time stamp [s since 1970], fields of fixed size, strings and bytes) of each message of a topic.

        The order is that of the file. Raise SeatrialError if the topic has no messages, if they do not have the type
        `type_name`, or if a message cannot be decoded.
        """
        for messages in self._file.read(self._channel_numbers(topic, type_name), *self._span_ns):
            rows = self._decode_rows(messages, topic, type_name)
            for t, row, data in zip(stamps(rows), rows, messages.payloads(), strict=True):
                layout = cdr_layout(type_name, b"\0" * (int(row["n_frame"]) - 1))
                try:
                    tail = layout.unpack_tail(data)
                except ValueError as error:
                    raise self._error(
                        f"a message on {topic} is not a valid {type_name}; the log is damaged: try `seatrial recover`"
                    ) from error
                yield float(t), row, tail


def _span_ns(begin: float, end: float, within: tuple[int, int]) -> tuple[int, int]:
    """Convert an interval from s to ns since 1970, and cut it to the interval `within` [ns].

    A negative limit becomes 0, and a limit beyond 64 bits (also infinity) becomes the largest time. If the intervals do
    not overlap, the first result is not below the second. NaN raises SeatrialError.
    """
    if math.isnan(begin) or math.isnan(end):
        raise SeatrialError(f"begin and end of an interval of time must be numbers, not {begin:g} and {end:g}")
    first, last = (LAST_NS if t >= LAST_NS / NANO else max(0, round(t * NANO)) for t in (begin, end))
    return max(first, within[0]), min(last, within[1])


def _layout_for_length(type_name: str, n_frame: int, lacking: tuple[str, ...]) -> CdrLayout | None:
    """Return the CDR byte layout of a message type whose `frame_id` has `n_frame` bytes, the final NUL included.

    Return None unless the length is 1 to 256. `lacking` are fields that an older version did not write.
    """
    return cdr_layout(type_name, b"\0" * (int(n_frame) - 1), lacking) if 1 <= n_frame <= MAX_FRAME_ID else None


def _table_type(kind: type[Measured], integers: Collection[str] = ()) -> np.dtype[np.void]:
    """Return the numpy type of the rows of a table of samples: t, t_rx, t_device and the fields of the class `kind`.

    All columns are floats, except for those in `integers`, which are 64-bit integers.
    """
    names = ["t", "t_rx", "t_device", *schema.field_names(kind)]
    return np.dtype([(name, "i8" if name in integers else "f8") for name in names])


class _GrowingArray:
    """Array to which rows are appended. At most an eighth more memory than its rows need is reserved.

    Parameters
    ----------
    dtype
        Type of a row.
    """

    def __init__(self, dtype: np.dtype[Any]) -> None:
        """Begin with an array without rows; `dtype` is the type of a row."""
        self._all, self._n = np.zeros(0, dtype), 0

    @property
    def rows(self) -> NDArray[Any]:
        """Rows appended so far, shape (n,), as a view. It is invalid after the next call of `append_rows`."""
        return self._all[: self._n]

    def append_rows(self, n: int) -> NDArray[Any]:
        """Append `n` rows of zeros to the array and return them as a view, shape (n,), for the caller to fill.

        Raise MemoryError if the memory is too small.
        """
        self._n += n
        if self._n > len(self._all):
            self._all.resize(self._n + self._n // 8, refcheck=False)
        return self._all[self._n - n : self._n]

    def done(self) -> NDArray[Any]:
        """Free the unused memory of the array and return all rows, shape (n,)."""
        self._all.resize(self._n, refcheck=False)
        return self._all


class _TopicTable:
    """Table of the samples of a topic. It grows while the messages of its `channels` are read.

    Attributes
    ----------
    topic
        Name of the topic.
    channels
        Numbers of the channels whose messages belong to the table, those with the device times and the magnetic field
        of an AHRS included.
    """

    def __init__(self, log: Log, topic: str, channels: list[int], dtype: np.dtype[np.void]) -> None:
        """Begin a table without rows for the messages of these channels of a log; `dtype` is the type of a row."""
        self.topic, self.channels = topic, channels
        self._log, self._table = log, _GrowingArray(dtype)

    def take(self, messages: Messages) -> None:
        """Add the next messages of the topic to the table. Raise SeatrialError if they cannot be decoded.

        Each subclass implements this method; here it raises NotImplementedError.
        """
        raise NotImplementedError

    def done(self) -> NDArray[np.void]:
        """Return the whole table of the topic, shape (n,), and free its unused memory.

        No further messages may be added.
        """
        return self._table.done()


class _SampleTable(_TopicTable):
    """Table of the samples of a topic in which each message is one sample."""

    def __init__(self, log: Log, kind: type[Measured], topic: str) -> None:
        """Begin a table without rows for the samples of class `kind` on a topic of a log.

        Raise SeatrialError if the topic has no messages, or messages of another type.
        """
        self._kind, self._type_name = kind, schema.TYPES[kind]
        fixed = cdr_layout(self._type_name, b"").dtype
        whole = [name for name in schema.field_names(kind) if fixed[name].kind in "iu"]
        super().__init__(log, topic, log._channel_numbers(topic, self._type_name), _table_type(kind, whole))

    def take(self, messages: Messages) -> None:
        """Add the next messages of the topic to the table, each of which is one sample.

        Raise SeatrialError if they cannot be decoded.
        """
        rows = self._log._decode_rows(messages, self.topic, self._type_name)
        part = self._table.append_rows(len(rows))
        part["t"] = stamps(rows)
        columns = schema.own_columns(self._kind, rows)
        for name in (part.dtype.names or ())[1:]:
            part[name] = columns[name]


class _NotNumberedError(SeatrialError):
    """Error that the sequence numbers of the Imu messages of an AHRS do not ascend.

    Such messages cannot be joined with other topics by sequence number. Another program may have written them.
    """


class _AhrsTable(_TopicTable):
    """Table of the samples of an AHRS, joined from its Imu messages, its device times and its magnetic field.

    Parameters
    ----------
    log
        The log.
    topic, source
        Topic of the Imu messages, and name of the device.
    join
        Whether to add the columns of the companion topics (device times and magnetic field). Without a message of
        device times, t_device is NaN, and t_rx is the log time of the Imu message. Without a message of the magnetic
        field, the field is NaN. If `join` is False, both are true for all samples.
    """

    def __init__(self, log: Log, topic: str, source: str, join: bool) -> None:
        """Begin a table without rows, and find the channels of Imu, device times and magnetic field in the log.

        Raise SeatrialError if the log lacks the Imu messages. A missing companion topic (device times or magnetic
        field) is left out; both are if `join` is False.
        """
        self._source, self._numbers = source, {"imu": log._channel_numbers(topic, schema.IMU)}
        for name, (type_name, _) in _COMPANIONS.items() if join else ():
            with contextlib.suppress(SeatrialError):
                self._numbers[name] = log._channel_numbers(f"/{source}/{name}", type_name)
        channels = [number for group in self._numbers.values() for number in group]
        super().__init__(log, topic, channels, _table_type(Ahrs))
        self._order = _GrowingArray(np.dtype(np.uint32))
        self._waiting = {name: _UnmatchedCompanions(np.zeros(0, np.uint32), {}) for name in self._numbers}
        self._last = -1

    def take(self, messages: Messages) -> None:
        """Add the next Imu messages of the AHRS, with the device time and magnetic field of the same sequence number.

        Messages of these companion topics that arrive before their Imu message wait for one more call, and are then
        dropped. Without a message of device times, t_device is NaN, and t_rx is the log time. Without a message of the
        magnetic field, the field is NaN. `_NotNumberedError` is raised if the sequence numbers do not ascend and there
        are companion topics. SeatrialError is raised if a message cannot be decoded.
        """
        parts = {n: messages.where(np.isin(messages.heads["channel"], g)) for n, g in self._numbers.items()}
        imu = parts.pop("imu")
        rows, part = self._log._decode_rows(imu, self.topic, schema.IMU), self._table.append_rows(len(imu.heads))
        part["t"], part["t_rx"], part["t_device"] = stamps(rows), imu.heads["log_ns"] / NANO, np.nan
        for name in ("mx", "my", "mz"):
            part[name] = np.nan
        for name, column in schema.imu_columns(rows).items():
            part[name] = column
        sequence = np.append(self._last, imu.heads["sequence"])
        if parts and np.any(np.diff(sequence) <= 0):
            raise _NotNumberedError(self.topic)
        self._order.append_rows(len(rows))[:] = sequence[1:]
        self._last = sequence[-1]
        for name, companions in parts.items():
            type_name, fields = _COMPANIONS[name]
            decoded = self._log._decode_rows(companions, f"/{self._source}/{name}", type_name)
            columns = {column: decoded[field] for column, field in fields.items()}
            waiting = self._waiting[name]
            table, order = self._table.rows, self._order.rows
            self._waiting[name] = waiting.join(companions.heads["sequence"], columns, table, order)


class _UnmatchedCompanions(NamedTuple):
    """Device times or magnetic fields of an AHRS whose Imu message may be in the next chunks of the file.

    Attributes
    ----------
    sequence
        Sequence numbers, shape (n,).
    columns
        Values (n,) by name of the column of the AHRS table.
    """

    sequence: NDArray[np.uint32]
    columns: dict[str, NDArray[np.float64]]

    def join(
        self,
        sequence: NDArray[np.uint32],
        columns: dict[str, NDArray[np.float64]],
        table: NDArray[np.void],
        order: NDArray[np.uint32],
    ) -> _UnmatchedCompanions:
        """Write the waiting and the new messages into the rows of the AHRS table with the same sequence number.

        Of two messages with one number in the same call, the first is used. Messages without a row are dropped, except
        for new ones after the last row.

        Parameters
        ----------
        sequence, columns
            Sequence numbers and columns of the new device times or magnetic fields, shape (n,).
        table
            Table of the AHRS, shape (m,). Its rows are changed.
        order
            Ascending sequence numbers of the rows of the table, shape (m,).

        Returns
        -------
        _UnmatchedCompanions
            New messages with numbers after the last row of the table, which wait for the next call.
        """
        sequence = np.append(self.sequence, sequence)
        columns = {name: np.append(self.columns.get(name, ()), column) for name, column in columns.items()}
        place = np.searchsorted(order, sequence)
        here = np.flatnonzero(place < len(order))
        here = here[order[place[here]] == sequence[here]]
        rows, first = np.unique(place[here], return_index=True)  # of two companions with one number, use the first
        for name, column in columns.items():
            table[name][rows] = column[here[first]]
        later = (place == len(order)) & (np.arange(len(place)) >= len(self.sequence))
        return _UnmatchedCompanions(sequence[later], {name: column[later] for name, column in columns.items()})


class _StampStatistics:
    """Rate, longest gap and backward steps of the time stamps of a topic, computed from batches of stamps.

    Attributes
    ----------
    n_back : int
        Number of steps back of more than 0.5 s (CLOCK_STEP_S) from one stamp to the next.
    longest_back : float
        Longest step back [s], also one of less than 0.5 s; 0 if there is none.
    """

    def __init__(self) -> None:
        """Begin the statistics of a topic without any time stamp."""
        self._n, self._first, self._last, self._gap, self._newest = 0, np.inf, -np.inf, 0.0, -np.inf
        self.n_back, self.longest_back = 0, 0.0  # steps back in the order of the file

    def add(self, t: NDArray[np.float64]) -> None:
        """Add the next time stamps of the topic [s], shape (n,), at least one.

        They are in the order of the file. Steps back of any size are allowed; those of more than 0.5 s are counted. For
        the longest gap the stamps of this call are sorted, and the gap to the latest stamp of earlier calls counts too.
        """
        steps = -np.diff(np.append(self._newest, t))
        self.n_back += int(np.sum(steps > CLOCK_STEP_S))
        self.longest_back, self._newest = max(self.longest_back, float(steps.max())), t[-1]
        t = np.sort(t)
        between = t[0] - self._last if self._n else 0.0
        self._gap = max(self._gap, between, float(np.diff(t).max(initial=0.0)))
        self._n += len(t)
        self._first, self._last = min(self._first, t[0]), max(self._last, t[-1])

    def rate_and_gap(self) -> tuple[float, float]:
        """Return mean rate [Hz] and longest gap [s] of all time stamps added.

        The rate is the number of stamps minus one, divided by the time from the earliest to the latest one. Both are
        NaN with fewer than two stamps, or if all are equal.
        """
        if self._n < 2 or self._first == self._last:
            return float("nan"), float("nan")
        return float((self._n - 1) / (self._last - self._first)), float(self._gap)
