"""MCAP -> numpy: tables of samples, events and raw bytes of a log (docs/formats/log.md).

    log = seatrial.daq.log.reader.open_log("run.mcap")
    ahrs = log.table(Ahrs, "ahrs")
    ahrs["t"], ahrs["yaw"]

Killed and truncated files open like any other, with all complete messages; `log.warnings` reports the damage.
"""

from __future__ import annotations

import contextlib
import copy
import hashlib
import importlib
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
MAX_FRAME_ID = 256
MAX_NODE_DIGITS = 9  # of a node id in a topic; Python converts no number of thousands of digits
_COMPANIONS = {  # of an Imu: topics that have the rest of its sample, and which column is which field
    "device_time": (schema.DEVICE_TIME, {"t_rx": "t_rx", "t_device": "t_device"}),
    "mag": (schema.MAG, {f"m{axis}": f"magnetic_field.{axis}" for axis in "xyz"}),
}
_LITTLE = int.from_bytes(ENCAPSULATION[:2], "little")
_WHOLE = (0, LAST_NS)


def open_log(path: Path | str) -> Log:
    """Open a log, whole or killed, with all its segments. Raises SeatrialError where it is no log at all."""
    return Log(Path(path))


def _library(name: str) -> Any:
    try:
        return importlib.import_module(name)
    except ModuleNotFoundError as error:
        raise SeatrialError(f"{name} is not installed: pip install 'seatrial[tables]'") from error


class Log:
    """One log. Times are run seconds since 1970."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = open_raw(path)
        self.paths = [raw.path for raw in self._file.files]  # more than one where the log has segments
        self._note = read_note(path)
        self.complete = self._file.complete
        self.metadata: dict[str, str] = {}
        for record in self._file.metadata:
            if record.name == "seatrial":
                self.metadata.update(record.metadata)
        self.attachments = {record.name: record.data for record in self._file.attachments}
        self.start, self.end = (ns / NANO for ns in self._file.span_ns or (0, 0))
        self._span_ns = _WHOLE
        self._kept: dict[tuple[str, tuple[int, int]], NDArray[np.void]] | None = None
        self._read_spans: set[tuple[int, int]] = set()  # of which all tables are kept

    @contextlib.contextmanager
    def keeping_tables(self) -> Iterator[None]:
        """Within this, all tables are read at once with the first, and are not to be written to: for who looks at many
        of them, and more than once."""
        self._kept, self._read_spans = {}, set()
        try:
            yield
        finally:
            self._kept = None

    def part(self, begin: float, end: float) -> Log:
        """The log as if it had only what was received from `begin` to before `end` [s since 1970]: the rest is not
        read. What is counted (`counts`, sources and nodes) is that of the whole log, and so is `sha256`."""
        found = copy.copy(self)
        found.__dict__.pop("_spacing", None)
        found._span_ns = _span_ns(begin, end, self._span_ns)
        found.start, found.end = max(self.start, begin), max(min(self.end, end), begin)
        return found

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file; tables already read stay."""
        self._file.close()

    @property
    def warnings(self) -> list[str]:
        """What is wrong with the file; reads what was not read yet."""
        self._file.verify(*self._span_ns)
        return [*self._file.warnings, *([self._note] if self._note else [])]

    @property
    def duration(self) -> float:
        """Seconds from the first message to the last."""
        return self.end - self.start

    @cached_property
    def sha256(self) -> str:
        """Return the SHA-256 of the file. For a log of several segments, hash their bytes in order."""
        digest = hashlib.sha256()
        for path in self.paths:
            with path.open("rb") as file:
                while block := file.read(1 << 20):
                    digest.update(block)
        return digest.hexdigest()

    @cached_property
    def rig(self) -> Rig | None:
        """The rig file attached to the log, parsed once; None for an import.

        Its relative paths count from the log's folder. Raises SeatrialError where the attachment is no valid rig.
        """
        data = self.attachments.get("rig.toml")
        if data is None:
            return None
        try:
            return parse_rig(data.decode(), self.path.parent / f"{self.path.name}:rig.toml", recorded=True)
        except UnicodeDecodeError as error:
            raise self._error("the rig.toml inside is not UTF-8 text") from error

    @cached_property
    def vehicle(self) -> Mapping[str, float]:
        """What is known of the boat, model parameters by name: the rig's [vehicle]; of an import, its map's [geometry]
        and [scale]. Raises SeatrialError where the attachment is damaged."""
        data = self.attachments.get("vehicle.toml")
        if data is None:
            return self.rig.vehicle if self.rig else {}
        table = parse_toml(data.decode(errors="replace"), self.path.parent / f"{self.path.name}:vehicle.toml")
        return {name: table.number(name) for name in table.values}

    @cached_property
    def counts(self) -> dict[str, int]:
        """Messages per topic, topics in alphabetical order."""
        found: Counter[str] = Counter()
        for number, n in self._file.counts.items():
            found[self._file.channels[number].topic] += n
        return dict(sorted(found.items()))

    def types(self) -> dict[str, str]:
        """Message type of each topic that has messages."""
        schemas = self._file.schemas
        names = {c.topic: schemas[c.schema_id].name for c in self._file.channels.values() if c.schema_id in schemas}
        return {name: names.get(name, "?") for name in self.counts}

    def rate_and_gap(self, topic: str) -> tuple[float, float]:
        """Mean rate [Hz] and longest gap [s] of a topic's messages by their own time; NaN where there is one only."""
        return self._spacing[topic].rate_and_gap()

    @property
    def clock_steps(self) -> dict[str, tuple[int, float]]:
        """Topics whose times run back by more than 0.5 s from one message to the next: how often, and the longest [s].
        It is a clock that was set, or two of them."""
        found = {topic: (one.n_back, one.longest_back) for topic, one in self._spacing.items() if one.n_back}
        found.pop("/event", None)
        return found

    @cached_property
    def _spacing(self) -> dict[str, _Spacing]:
        """Of all topics, by one reading of the file."""
        found = {topic: _Spacing() for topic in self.counts}
        topics = {number: channel.topic for number, channel in self._file.channels.items()}
        for messages in self._file.read(None, *self._span_ns):
            channel, stamp = messages.heads["channel"], messages.heads["stamp_ns"] / NANO
            for number in np.unique(channel).tolist():
                found[topics[number]].add(stamp[channel == number])
        return found

    def to_pandas(self, rate: float = 10.0) -> Any:
        """A pandas.DataFrame of the whole log at `rate` [Hz], by UTC; units in ``attrs["units"]``. As `resample` does.

        Raises SeatrialError where pandas is not there, or the log has no samples.
        """
        pandas = _library("pandas")
        table = resample(self, rate)
        index = pandas.to_datetime(np.rint(table.t * NANO).astype(np.int64), unit="ns", utc=True).rename("time")
        frame = pandas.DataFrame(table.columns, index=index)
        frame.attrs["units"] = table.units
        return frame

    def to_xarray(self, rate: float = 10.0) -> Any:
        """An xarray.Dataset as `to_pandas` has it; ``time`` is UTC, units are attributes. Raises SeatrialError."""
        xarray = _library("xarray")
        table = resample(self, rate)
        time = np.rint(table.t * NANO).astype(np.int64).astype("datetime64[ns]")
        variables = {name: ("time", values, {"units": table.units[name]}) for name, values in table.columns.items()}
        return xarray.Dataset(variables, coords={"time": time})

    def sources(self, kind: type[Measured] | type[PortHealth]) -> list[str]:
        """Devices (or signal names, for Scalar) that have samples of this kind."""
        if kind is PortHealth:
            return [name.split("/")[2] for name in self.counts if name.startswith("/health/")]
        if kind is Scalar:
            return [name.removeprefix("/signal/") for name in self.counts if name.startswith("/signal/")]
        if kind in schema.NODE_TOPICS:
            return list(dict.fromkeys(source for source, _ in self._nodes(kind)))
        last = schema.topic(kind, "*").rsplit("/", 1)[1]  # type: ignore[arg-type]
        pairs = [name.split("/")[1:] for name in self.counts]
        return [pair[0] for pair in pairs if len(pair) == 2 and pair[1] == last and pair[0] not in ("raw", "health")]

    def nodes(self, kind: type[Esc] | type[Command] | type[Servo], source: str) -> list[int]:
        """Controller ids on the bus of a device that have samples of this kind."""
        return sorted(node for name, node in self._nodes(kind) if name == source)

    def _nodes(self, kind: type[Measured] | type[PortHealth]) -> list[tuple[str, int]]:
        last = schema.NODE_TOPICS[kind]
        parts = [name.split("/")[1:] for name in self.counts]
        mine = [(p[0], p[1]) for p in parts if len(p) == 3 and p[2] == last]
        return [(name, int(node)) for name, node in mine if node.isdecimal() and len(node) <= MAX_NODE_DIGITS]

    def table(
        self, kind: type[Measured], source: str, node: int | None = None, begin: float = 0.0, end: float = np.inf
    ) -> NDArray[np.void]:
        """Samples of a kind, shape (n,): t, t_rx, t_device, then the sample's fields.

        `t` is the estimated time of the sample in s since 1970 and never decreases. `begin` and `end` [s since 1970]
        bound the time of receipt (`begin <= t_rx < end`): what lies outside is not read. Raises SeatrialError where the
        log has no such samples, and where the memory does not hold them.
        """
        if kind is Esc or kind is Command or kind is Servo:
            node = self._only_node(kind, source, node)
        topic = schema.topic(kind, source, node)
        span = _span_ns(begin, end, self._span_ns)
        try:
            if self._kept is None:
                return self._read_table(kind, topic, source, span)
            if span not in self._read_spans:
                self._read_spans.add(span)
                self._kept |= self._read_tables(span)
            if (topic, span) not in self._kept:
                self._kept[topic, span] = self._read_table(kind, topic, source, span)
            table = self._kept[topic, span]
            table.flags.writeable = False
            return table
        except MemoryError:
            raise self._error(
                f"{topic} has {self.counts.get(topic, 0)} messages, which the memory of this computer does not hold: "
                "read a part of the time (begin, end), or a segment by itself"
            ) from None

    def _read_table(
        self, kind: type[Measured], topic: str, source: str, span: tuple[int, int], join: bool = True
    ) -> NDArray[np.void]:
        """One table, by its own reading of the file."""
        rows = self._rows_of(kind, topic, source, join)
        try:
            for messages in self._file.read(rows.channels, *span):
                rows.take(messages)
        except _NotNumberedError:
            return self._read_table(kind, topic, source, span, join=False)
        return self._in_order(rows.done(), topic, span)

    def _rows_of(self, kind: type[Measured], topic: str, source: str, join: bool = True) -> _Rows:
        """What becomes the table of a topic; of an AHRS with its other topics, where they are to ``join``. Raises
        SeatrialError."""
        return _AhrsRows(self, topic, source, join) if kind is Ahrs else _SampleRows(self, kind, topic)

    def _read_tables(self, span: tuple[int, int]) -> dict[tuple[str, tuple[int, int]], NDArray[np.void]]:
        """Every table of the log by one reading of the file: its chunks hold all topics. What is wrong with one is said
        when it is asked for by itself."""
        rows: dict[str, _Rows] = {}
        for kind in (*MEASURED, Command):
            for source in self.sources(kind):
                nodes = self._nodes(kind) if kind in schema.NODE_TOPICS else [(source, None)]
                for node in (node for name, node in nodes if name == source):
                    topic = schema.topic(kind, source, node)
                    with contextlib.suppress(SeatrialError):
                        rows[topic] = self._rows_of(kind, topic, source)
        every = [number for one in rows.values() for number in one.channels]
        for messages in self._file.read(every, *span):
            channel = messages.heads["channel"]
            for topic, one in list(rows.items()):
                part = messages.where(np.isin(channel, one.channels))
                try:
                    if len(part.offsets):
                        one.take(part)
                except SeatrialError:
                    del rows[topic]
        found = {}
        for topic, one in rows.items():
            with contextlib.suppress(SeatrialError):
                found[topic, span] = self._in_order(one.done(), topic, span)
        return found

    def _only_node(self, kind: type[Esc] | type[Command] | type[Servo], source: str, node: int | None) -> int:
        nodes = self.nodes(kind, source)
        if node is None and len(nodes) == 1:
            return nodes[0]
        if node is None and len(nodes) > 1:
            raise self._error(f"{source} has nodes {nodes}: name one")
        return 0 if node is None else node

    def _in_order(self, table: NDArray[np.void], topic: str, span: tuple[int, int]) -> NDArray[np.void]:
        if not len(table) and span == _WHOLE:
            raise self._error(f"no message on {topic} is readable")
        # Estimates of the clock may jitter; the order of the samples is the device's and is kept.
        np.maximum.accumulate(table["t"], out=table["t"])
        return table

    def events(self) -> list[tuple[float, str, str]]:
        """Every event as (t, kind, text), in the order written."""
        if "/event" not in self.counts:
            return []
        found = []
        for t, _, tail in self._whole("/event", schema.EVENT):
            kind, text = (printable(part.decode("utf-8", errors="replace")) for part in tail)
            found.append((t, kind, text))
        return found

    def health(self, device: str) -> list[tuple[float, PortHealth]]:
        """The counters of a device's port over time, as (t, counters)."""
        found = []
        for t, row, (port,) in self._whole(f"/health/{device}", schema.HEALTH):
            n_in, n_frames, n_bad, n_unparsed, n_dropped, n_again = (int(row[name]) for name in _COUNTERS)
            bias, spread = float(row["clock_bias"]), float(row["clock_spread"])
            name = printable(port.decode("utf-8", errors="replace"))
            found.append((t, PortHealth(name, n_in, n_frames, n_bad, n_unparsed, n_dropped, n_again, bias, spread)))
        return found

    def raw(self, device: str) -> Iterator[tuple[float, str, bytes]]:
        """Bytes of a device's port as (t, "rx" or "tx", data), in the order written."""
        for t, row, (data,) in self._whole(f"/raw/{device}", schema.RAW):
            yield t, _DIRECTIONS[min(int(row["direction"]), 1)], data

    def messages(self) -> Iterator[tuple[int, str, bytes]]:
        """Every message as it stands: log time [ns since 1970], topic, data; in the order written."""
        topics = {number: channel.topic for number, channel in self._file.channels.items()}
        for messages in self._file.read(None, *self._span_ns):
            heads = (messages.heads[name].tolist() for name in ("log_ns", "channel"))
            for log_ns, channel, data in zip(*heads, messages.payloads(), strict=True):
                yield log_ns, topics[channel], bytes(data)

    def unit(self, signal: str) -> str:
        """Unit of an imported signal."""
        return self._about(signal).get("unit", "")

    def hold(self, signal: str) -> str:
        """How an imported signal goes on between its samples: "zero", "linear" or, of an output that comes at a rate,
        "sampled": a change came at some time since the sample before."""
        return self._about(signal).get("hold", "linear")

    def role(self, signal: str) -> str:
        """What an imported signal is to the system: "input" or "output"."""
        return self._about(signal).get("role", "output")

    def _about(self, signal: str) -> dict[str, str]:
        return self._file.channels[self._channels(schema.topic(Scalar, signal))[0]].metadata

    def _error(self, text: str) -> SeatrialError:
        """An error of this log, in one line whatever a damaged file has for names."""
        return SeatrialError(f"{self.path}: {' '.join(text.split())}")

    def _channels(self, topic: str, type_name: str = "") -> list[int]:
        """Numbers of a topic's channels. Raises SeatrialError where it has no messages, or those of another type."""
        found = [number for number, channel in self._file.channels.items() if channel.topic == topic]
        if not found or topic not in self.counts:
            there = ", ".join(self.counts) or "nothing"
            raise self._error(f"no messages on {topic}; there is: {there}")
        for number in found if type_name else ():
            channel = self._file.channels[number]
            told = self._file.schemas.get(channel.schema_id)
            if told is None or told.name != type_name or channel.message_encoding != "cdr":
                what = "an unknown type" if told is None else f"{told.name} ({channel.message_encoding})"
                raise self._error(f"{topic} is {what}, not {type_name} (cdr)")
        return found

    def _lacking(self, topic: str, type_name: str) -> tuple[str, ...]:
        """The fields that the version that wrote a topic did not have."""
        channels = [self._file.channels[number] for number in self._channels(topic)]
        written = [self._file.schemas[c.schema_id].data for c in channels if c.schema_id in self._file.schemas]
        added = schema.ADDED.get(type_name, ())
        return tuple(name for name in added if not all(f" {name} ".encode() in data for data in written))

    def _rows(self, messages: Messages, topic: str, type_name: str) -> NDArray[np.void]:
        """Decoded fixed parts of messages, shape (n,)."""
        wrong = self._error(f"a message on {topic} is no {type_name} in little-endian CDR")
        lacking = self._lacking(topic, type_name)
        lengths = messages.lengths
        if np.any(lengths < HEAD.itemsize):
            raise wrong
        # Our own logs have one frame_id a topic: what the first message has is tried for all.
        heads = messages.rows(HEAD)
        found = _layout(type_name, heads["n_frame"][0] if len(heads) else 1, lacking)
        if found is not None and np.all(lengths >= found.dtype.itemsize):
            rows = messages.rows(found.dtype)
            if not len(rows) or (np.all(rows["n_frame"] == rows["n_frame"][0]) and np.all(rows["endian"] == _LITTLE)):
                return rows
        if np.any(heads["endian"] != _LITTLE):
            raise wrong
        rows = np.zeros(len(heads), cdr_layout(type_name, b"", lacking).dtype)
        for n_frame in np.unique(heads["n_frame"]):
            these = heads["n_frame"] == n_frame
            found = _layout(type_name, n_frame, lacking)
            if found is None or np.any(lengths[these] < found.dtype.itemsize):
                raise wrong
            decoded = messages.where(these).rows(found.dtype)
            for name in rows.dtype.names or ():
                rows[name][these] = decoded[name]
        return rows

    def _whole(self, topic: str, type_name: str) -> Iterator[tuple[float, np.void, tuple[bytes, ...]]]:
        """Stamp, fixed part and variable fields of each message of a topic, in the order written."""
        for messages in self._file.read(self._channels(topic, type_name), *self._span_ns):
            rows = self._rows(messages, topic, type_name)
            for t, row, data in zip(stamps(rows), rows, messages.payloads(), strict=True):
                found = cdr_layout(type_name, b"\0" * (int(row["n_frame"]) - 1))
                try:
                    tail = found.unpack_tail(data)
                except ValueError as error:
                    raise self._error(f"a message on {topic} is no {type_name}") from error
                yield float(t), row, tail


def _span_ns(begin: float, end: float, within: tuple[int, int]) -> tuple[int, int]:
    """From s to ns since 1970, and within another."""
    first, last = (LAST_NS if t >= LAST_NS / NANO else max(0, round(t * NANO)) for t in (begin, end))
    return max(first, within[0]), min(last, within[1])


def _layout(type_name: str, n_frame: int, lacking: tuple[str, ...]) -> CdrLayout | None:
    """The layout for a frame_id of so many bytes, its end included; None where that makes no sense."""
    return cdr_layout(type_name, b"\0" * (int(n_frame) - 1), lacking) if 1 <= n_frame <= MAX_FRAME_ID else None


def _table_type(kind: type[Measured], integers: Collection[str] = ()) -> np.dtype[np.void]:
    names = ["t", "t_rx", "t_device", *schema.field_names(kind)]
    return np.dtype([(name, "i8" if name in integers else "f8") for name in names])


class _Growing:
    """An array to which rows are added, with at most an eighth more memory than they take."""

    def __init__(self, dtype: np.dtype[Any]) -> None:
        self._all, self._n = np.zeros(0, dtype), 0

    @property
    def rows(self) -> NDArray[Any]:
        """Those so far; not to be kept while more are added."""
        return self._all[: self._n]

    def more(self, n: int) -> NDArray[Any]:
        """The place for `n` more rows. Raises MemoryError."""
        self._n += n
        if self._n > len(self._all):
            self._all.resize(self._n + self._n // 8, refcheck=False)
        return self._all[self._n - n : self._n]

    def done(self) -> NDArray[Any]:
        """All of them."""
        self._all.resize(self._n, refcheck=False)
        return self._all


class _Rows:
    """The table of a topic, that grows with the messages of its ``channels``."""

    def __init__(self, log: Log, topic: str, channels: list[int], dtype: np.dtype[np.void]) -> None:
        self.topic, self.channels = topic, channels
        self._log, self._table = log, _Growing(dtype)

    def take(self, messages: Messages) -> None:
        """The next messages of these channels. Raises SeatrialError."""
        raise NotImplementedError

    def done(self) -> NDArray[np.void]:
        """The table."""
        return self._table.done()


class _SampleRows(_Rows):
    """Of one topic, whose messages are samples."""

    def __init__(self, log: Log, kind: type[Measured], topic: str) -> None:
        self._kind, self._type_name = kind, schema.TYPES[kind]
        fixed = cdr_layout(self._type_name, b"").dtype
        whole = [name for name in schema.field_names(kind) if fixed[name].kind in "iu"]
        super().__init__(log, topic, log._channels(topic, self._type_name), _table_type(kind, whole))

    def take(self, messages: Messages) -> None:
        rows = self._log._rows(messages, self.topic, self._type_name)
        part = self._table.more(len(rows))
        part["t"] = stamps(rows)
        columns = schema.own_columns(self._kind, rows)
        for name in (part.dtype.names or ())[1:]:
            part[name] = columns[name]


class _NotNumberedError(SeatrialError):
    """Messages of an Imu whose numbers do not ascend: not ours, so that nothing is joined to them."""


class _AhrsRows(_Rows):
    """Of an Imu and the topics that have the rest of its sample."""

    def __init__(self, log: Log, topic: str, source: str, join: bool) -> None:
        self._source, self._numbers = source, {"imu": log._channels(topic, schema.IMU)}
        for name, (type_name, _) in _COMPANIONS.items() if join else ():
            with contextlib.suppress(SeatrialError):
                self._numbers[name] = log._channels(f"/{source}/{name}", type_name)
        every = [number for group in self._numbers.values() for number in group]
        super().__init__(log, topic, every, _table_type(Ahrs))
        self._order = _Growing(np.dtype(np.uint32))
        self._waiting = {name: _Waiting(np.zeros(0, np.uint32), {}) for name in self._numbers}
        self._last = -1

    def take(self, messages: Messages) -> None:
        parts = {n: messages.where(np.isin(messages.heads["channel"], g)) for n, g in self._numbers.items()}
        own = parts.pop("imu")
        rows, part = self._log._rows(own, self.topic, schema.IMU), self._table.more(len(own.heads))
        part["t"], part["t_rx"], part["t_device"] = stamps(rows), own.heads["log_ns"] / NANO, np.nan
        for name in ("mx", "my", "mz"):
            part[name] = np.nan
        for name, column in schema.imu_columns(rows).items():
            part[name] = column
        sequence = np.append(self._last, own.heads["sequence"])
        if parts and np.any(np.diff(sequence) <= 0):
            raise _NotNumberedError(self.topic)
        self._order.more(len(rows))[:] = sequence[1:]
        self._last = sequence[-1]
        for name, companions in parts.items():
            type_name, fields = _COMPANIONS[name]
            found = self._log._rows(companions, f"/{self._source}/{name}", type_name)
            columns = {column: found[field] for column, field in fields.items()}
            waiting = self._waiting[name]
            table, order = self._table.rows, self._order.rows
            self._waiting[name] = waiting.join(companions.heads["sequence"], columns, table, order)


class _Waiting(NamedTuple):
    """Companions whose sample may stand in the next chunks: sequence numbers and columns."""

    sequence: NDArray[np.uint32]
    columns: dict[str, NDArray[np.float64]]

    def join(
        self,
        sequence: NDArray[np.uint32],
        columns: dict[str, NDArray[np.float64]],
        table: NDArray[np.void],
        order: NDArray[np.uint32],
    ) -> _Waiting:
        """Write these and more companions into the rows of `table` that have their number in `order`, which ascends;
        returns what waits on."""
        sequence = np.append(self.sequence, sequence)
        columns = {name: np.append(self.columns.get(name, ()), column) for name, column in columns.items()}
        place = np.searchsorted(order, sequence)
        here = np.flatnonzero(place < len(order))
        here = here[order[place[here]] == sequence[here]]
        rows, first = np.unique(place[here], return_index=True)  # of two with one number the first counts
        for name, column in columns.items():
            table[name][rows] = column[here[first]]
        later = (place == len(order)) & (np.arange(len(place)) >= len(self.sequence))
        return _Waiting(sequence[later], {name: column[later] for name, column in columns.items()})


class _Spacing:
    """Rate and longest gap of the stamps of a topic."""

    def __init__(self) -> None:
        self._n, self._first, self._last, self._gap, self._newest = 0, np.inf, -np.inf, 0.0, -np.inf
        self.n_back, self.longest_back = 0, 0.0  # steps back in the order of the file

    def add(self, t: NDArray[np.float64]) -> None:
        """More stamps [s], behind those before but for jitter."""
        steps = -np.diff(np.append(self._newest, t))
        self.n_back += int(np.sum(steps > CLOCK_STEP_S))
        self.longest_back, self._newest = max(self.longest_back, float(steps.max())), t[-1]
        t = np.sort(t)
        between = t[0] - self._last if self._n else 0.0
        self._gap = max(self._gap, between, float(np.diff(t).max(initial=0.0)))
        self._n += len(t)
        self._first, self._last = min(self._first, t[0]), max(self._last, t[-1])

    def rate_and_gap(self) -> tuple[float, float]:
        """Hz and s; NaN of a single time."""
        if self._n < 2 or self._first == self._last:
            return float("nan"), float("nan")
        return float((self._n - 1) / (self._last - self._first)), float(self._gap)
