"""MCAP -> numpy: tables of samples, events and raw bytes of a log (docs/formats/log.md).

    log = daq.log.reader.open_log("run.mcap")
    ahrs = log.table(Ahrs, "ahrs")
    ahrs["t"], ahrs["yaw"]

Killed and truncated files open like any other, with all complete messages; `log.warnings` reports the damage.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Mapping
from functools import cached_property
from pathlib import Path

import numpy as np
from mcap.records import Channel
from numpy.typing import NDArray

from daq.config import parse_rig, parse_toml
from daq.errors import SeatrialError, printable
from daq.log import schema
from daq.log.cdr import ENCAPSULATION, HEAD, NANO, CdrLayout, cdr_layout, stamps
from daq.log.schema import Measured
from daq.log.segments import open_raw, read_note
from daq.rig import Rig
from daq.samples import Ahrs, Command, Esc, PortHealth, Scalar, Servo

_COUNTERS = ("bytes_in", "frames", "checksum_errors", "unparsed_bytes", "dropped", "reconnects")
_DIRECTIONS = ("rx", "tx")
MAX_FRAME_ID = 256
_LITTLE = int.from_bytes(ENCAPSULATION[:2], "little")


def open_log(path: Path | str) -> Log:
    """Open a log, whole or killed, with all its segments. Raises SeatrialError where it is no log at all."""
    return Log(Path(path))


class Log:
    """One log. Times are run seconds since 1970."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = open_raw(path)
        self.paths = [raw.path for raw in self._file.files]  # more than one where the log has segments
        self.warnings = self._file.warnings
        if note := read_note(path):
            self.warnings.append(note)
        self.complete = self._file.complete
        self.metadata: dict[str, str] = {}
        for record in self._file.metadata:
            if record.name == "seatrial":
                self.metadata.update(record.metadata)
        self.attachments = {record.name: record.data for record in self._file.attachments}
        times = self._file.messages["log_ns"]
        self.start = float(times.min()) / NANO if len(times) else 0.0
        self.end = float(times.max()) / NANO if len(times) else 0.0

    def __enter__(self) -> Log:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Let go of the file; tables already read stay."""
        self._file.close()

    @property
    def duration(self) -> float:
        """Seconds from the first message to the last."""
        return self.end - self.start

    @cached_property
    def sha256(self) -> str:
        """Of the file as it is now; with several segments, of all their bytes in order."""
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
            return parse_rig(data.decode(), self.path.parent / f"{self.path.name}:rig.toml")
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
        numbers, n = np.unique(self._file.messages["channel"], return_counts=True)
        found: dict[str, int] = {}
        for number, count in zip(numbers, n, strict=True):
            name = self._file.channels[int(number)].topic
            found[name] = found.get(name, 0) + int(count)
        return dict(sorted(found.items()))

    def types(self) -> dict[str, str]:
        """Message type of each topic that has messages."""
        schemas = self._file.schemas
        names = {c.topic: schemas[c.schema_id].name for c in self._file.channels.values() if c.schema_id in schemas}
        return {name: names.get(name, "?") for name in self.counts}

    def rate_and_gap(self, topic: str) -> tuple[float, float]:
        """Mean rate [Hz] and longest gap [s] of a topic's messages by their own time; NaN where there is one only."""
        numbers = [channel.id for channel in self._channels(topic)]
        messages = self._file.messages
        t = np.sort(messages["stamp_ns"][np.isin(messages["channel"], numbers)]) / NANO
        if len(t) < 2 or t[-1] == t[0]:
            return float("nan"), float("nan")
        return float((len(t) - 1) / (t[-1] - t[0])), float(np.diff(t).max())

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
        return [(p[0], int(p[1])) for p in parts if len(p) == 3 and p[2] == last and p[1].isdecimal()]

    def table(self, kind: type[Measured], source: str, node: int | None = None) -> NDArray[np.void]:
        """All samples of a kind, shape (n,): t, t_rx, t_device, then the sample's fields.

        `t` is the estimated time of the sample in s since 1970 and never decreases. Raises SeatrialError where the
        log has no such samples.
        """
        if kind is Esc or kind is Command or kind is Servo:
            node = self._only_node(kind, source, node)
        topic = schema.topic(kind, source, node)
        if kind is Ahrs:
            return _table(kind, *self._ahrs(topic, source))
        _, rows = self._rows(topic, schema.TYPES[kind])
        return _table(kind, stamps(rows), schema.own_columns(kind, rows))

    def _only_node(self, kind: type[Esc] | type[Command] | type[Servo], source: str, node: int | None) -> int:
        nodes = self.nodes(kind, source)
        if node is None and len(nodes) == 1:
            return nodes[0]
        if node is None and len(nodes) > 1:
            raise self._error(f"{source} has nodes {nodes}: name one")
        return 0 if node is None else node

    def _ahrs(self, topic: str, source: str) -> tuple[NDArray[np.float64], schema.Columns]:
        messages, rows = self._rows(topic, schema.IMU)
        columns = schema.imu_columns(rows)
        order = messages["sequence"]
        numbered = bool(np.all(np.diff(order.astype(np.int64)) > 0)) and len(order) > 0
        columns["t_rx"] = messages["log_ns"] / NANO
        for name in ("t_device", "mx", "my", "mz"):
            columns[name] = np.full(len(rows), np.nan)
        # What belongs to one sample carries one sequence number; a killed file may end between the two.
        for other, type_name, names in (
            ("device_time", schema.DEVICE_TIME, {"t_rx": "t_rx", "t_device": "t_device"}),
            ("mag", schema.MAG, {f"m{axis}": f"magnetic_field.{axis}" for axis in "xyz"}),
        ):
            if not numbered or f"/{source}/{other}" not in self.counts:
                continue
            others, other_rows = self._rows(f"/{source}/{other}", type_name)
            _, here, there = np.intersect1d(order, others["sequence"], return_indices=True)
            for name, field in names.items():
                columns[name][here] = other_rows[field][there]
        return stamps(rows), columns

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

    def unit(self, signal: str) -> str:
        """Unit of an imported signal."""
        return self._about(signal).get("unit", "")

    def hold(self, signal: str) -> str:
        """How an imported signal goes on between its samples: "zero" or "linear"."""
        return self._about(signal).get("hold", "linear")

    def role(self, signal: str) -> str:
        """What an imported signal is to the system: "input" or "output"."""
        return self._about(signal).get("role", "output")

    def _about(self, signal: str) -> dict[str, str]:
        return self._channels(schema.topic(Scalar, signal))[0].metadata

    def _error(self, text: str) -> SeatrialError:
        """An error of this log, in one line whatever a damaged file has for names."""
        return SeatrialError(f"{self.path}: {' '.join(text.split())}")

    def _channels(self, topic: str) -> list[Channel]:
        found = [channel for channel in self._file.channels.values() if channel.topic == topic]
        if not found or topic not in self.counts:
            there = ", ".join(self.counts) or "nothing"
            raise self._error(f"no messages on {topic}; there is: {there}")
        return found

    def _messages(self, topic: str, type_name: str) -> NDArray[np.void]:
        channels = self._channels(topic)
        for channel in channels:
            found = self._file.schemas.get(channel.schema_id)
            if found is None or found.name != type_name or channel.message_encoding != "cdr":
                what = "an unknown type" if found is None else f"{found.name} ({channel.message_encoding})"
                raise self._error(f"{topic} is {what}, not {type_name} (cdr)")
        messages = self._file.messages
        return messages[np.isin(messages["channel"], [channel.id for channel in channels])]

    def _rows(self, topic: str, type_name: str) -> tuple[NDArray[np.void], NDArray[np.void]]:
        """Positions (dtype MESSAGE) and decoded fixed parts of a topic's messages, both shape (n,)."""
        messages = self._messages(topic, type_name)
        wrong = self._error(f"a message on {topic} is no {type_name} in little-endian CDR")
        written = [self._file.schemas[channel.schema_id].data for channel in self._channels(topic)]
        added = schema.ADDED.get(type_name, ())
        lacking = tuple(name for name in added if not all(f" {name} ".encode() in data for data in written))
        if np.any(messages["length"] < HEAD.itemsize):
            raise wrong
        # Our own logs have one frame_id a topic: what the first message has is tried for all.
        found = _layout(type_name, self._file.rows(messages[:1], HEAD)["n_frame"][0], lacking)
        if found is not None and np.all(messages["length"] >= found.dtype.itemsize):
            rows = self._file.rows(messages, found.dtype)
            if np.all(rows["n_frame"] == rows["n_frame"][0]) and np.all(rows["endian"] == _LITTLE):
                return messages, rows
        rows = np.zeros(len(messages), cdr_layout(type_name, b"", lacking).dtype)
        heads = self._file.rows(messages, HEAD)
        if np.any(heads["endian"] != _LITTLE):
            raise wrong
        for n_frame in np.unique(heads["n_frame"]):
            part = np.flatnonzero(heads["n_frame"] == n_frame)
            found = _layout(type_name, n_frame, lacking)
            if found is None or np.any(messages["length"][part] < found.dtype.itemsize):
                raise wrong
            decoded = self._file.rows(messages[part], found.dtype)
            for name in rows.dtype.names or ():
                rows[name][part] = decoded[name]
        return messages, rows

    def _whole(self, topic: str, type_name: str) -> Iterator[tuple[float, np.void, tuple[bytes, ...]]]:
        """Stamp, fixed part and variable fields of each message of a topic, in the order written."""
        messages, rows = self._rows(topic, type_name)
        for t, message, row in zip(stamps(rows), messages, rows, strict=True):
            found = cdr_layout(type_name, b"\0" * (int(row["n_frame"]) - 1))
            try:
                tail = found.unpack_tail(self._file.payload(message))
            except ValueError as error:
                raise self._error(f"a message on {topic} is no {type_name}") from error
            yield float(t), row, tail


def _layout(type_name: str, n_frame: int, lacking: tuple[str, ...]) -> CdrLayout | None:
    """The layout for a frame_id of so many bytes, its end included; None where that makes no sense."""
    return cdr_layout(type_name, b"\0" * (int(n_frame) - 1), lacking) if 1 <= n_frame <= MAX_FRAME_ID else None


def _table(kind: type[Measured], t: NDArray[np.float64], columns: schema.Columns) -> NDArray[np.void]:
    names = ["t", "t_rx", "t_device", *schema.field_names(kind)]
    dtype = [(name, "i8" if name != "t" and columns[name].dtype.kind in "iu" else "f8") for name in names]
    table = np.zeros(len(t), dtype)
    # Estimates of the clock may jitter; the order of the samples is the device's and is kept.
    table["t"] = np.maximum.accumulate(t) if len(t) else t
    for name in names[1:]:
        table[name] = columns[name]
    return table
