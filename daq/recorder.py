"""Samples, raw bytes, events and counters -> one MCAP log (docs/formats/log.md). Called from one thread."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from daq import schema
from daq.cdr import NANO, layout
from daq.mcap_write import LogWriter
from daq.provenance import collect
from daq.rig import Rig
from daq.samples import Event, Frame, PortHealth

LOG_FORMAT = "seatrial-log 1"
_DIRECTIONS = {"rx": 0, "tx": 1}


class Clock(Protocol):
    """What the recorder needs of `daq.clock.RunClock`."""

    @property
    def speed(self) -> float:
        """Run seconds a wall second."""

    @property
    def origin(self) -> object:
        """Plain numbers from which another process can rebuild the clock."""

    def now(self) -> float:
        """Run seconds since 1970."""


class Recorder:
    """Writes one log. `log_time` is the receive time, but never before that of the message written last."""

    def __init__(
        self,
        path: Path,
        *,
        rig: Rig,
        clock: Clock,
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, str] | None = None,
    ) -> None:
        origin = json.dumps(clock.origin)
        about = {"format": LOG_FORMAT, "rig": rig.name, "speed": repr(clock.speed), "origin": origin}
        self._metadata = {**collect(), **about, **(metadata or {})}
        self._attachments = {"rig.toml": rig.text.encode(), **(attachments or {})}
        self._log_ns = self._ns(clock.now(), 0)
        self._open(Path(path))

    def _open(self, path: Path) -> None:
        """Begin a segment: everything that a reader needs stands in each."""
        self._channels: dict[str, int] = {}
        self._sequences: dict[str, int] = {}
        self._writer = LogWriter(path, metadata=self._metadata, attachments=self._attachments, time_ns=self._log_ns)

    @property
    def path(self) -> Path:
        """The file being written."""
        return self._writer.path

    @property
    def size(self) -> int:
        """Bytes on disk."""
        return self._writer.size

    def write(self, device: str, frame: Frame, t: float) -> None:
        """One sample of a device (or of a signal, for Scalar); t is its estimated time, run seconds since 1970."""
        sample = frame.sample
        if isinstance(sample, Event):
            self.event(t, sample.kind, sample.text)
            return
        if isinstance(sample, PortHealth):
            self.health(device, sample, t)
            return
        log_ns, stamp_ns = self._times(frame.t_rx, t)
        key = ""
        for message in schema.messages(device, frame):
            # All messages of one sample carry the sequence number of the first: the reader joins them by it.
            if not key:
                key = message.topic
                self._sequences[key] = (self._sequences.get(key, 0) + 1) & 0xFFFFFFFF
            data = layout(message.type_name, message.frame_id.encode()).pack(stamp_ns, *message.values)
            self._add(message.topic, message.type_name, log_ns, stamp_ns, self._sequences[key], data)

    def write_raw(self, device: str, direction: str, data: bytes, t: float) -> None:
        """Bytes as read from ("rx") or written to ("tx") a port at t."""
        log_ns, stamp_ns = self._times(t, t)
        message = layout(schema.RAW, device.encode()).pack(stamp_ns, _DIRECTIONS[direction], tail=(data,))
        self._add(f"/raw/{device}", schema.RAW, log_ns, stamp_ns, 0, message)

    def event(self, t: float, kind: str, text: str) -> None:
        """Something that happened at t."""
        log_ns, stamp_ns = self._times(t, t)
        message = layout(schema.EVENT, b"").pack(stamp_ns, tail=(_line(kind), _line(text)))
        self._add("/event", schema.EVENT, log_ns, stamp_ns, 0, message)

    def health(self, device: str, health: PortHealth, t: float) -> None:
        """The counters of a device's port at t."""
        log_ns, stamp_ns = self._times(t, t)
        message = layout(schema.HEALTH, device.encode()).pack(
            stamp_ns,
            health.bytes_in,
            health.frames,
            health.checksum_errors,
            health.unparsed_bytes,
            health.dropped,
            health.reconnects,
            health.clock_bias,
            health.clock_spread,
            tail=(_line(health.port),),
        )
        self._add(f"/health/{device}", schema.HEALTH, log_ns, stamp_ns, 0, message)

    def tick(self) -> None:
        """Flush and sync when the wall clock says so; call it at least every 50 ms."""
        self._writer.tick()

    def close(self) -> None:
        """End the log. Raises SeatrialError where its end could not be written."""
        self._writer.close()

    def _times(self, t_log: float, t_stamp: float) -> tuple[int, int]:
        self._log_ns = max(self._log_ns, self._ns(t_log, self._log_ns))
        return self._log_ns, self._ns(t_stamp, self._log_ns)

    @staticmethod
    def _ns(t: float, otherwise: int) -> int:
        # A clock estimate may be NaN before its first sample; the header's seconds end in 2038 (int32).
        return round(t * NANO) if math.isfinite(t) and 0.0 <= t < 2**31 else otherwise

    def _add(self, topic: str, type_name: str, log_ns: int, stamp_ns: int, sequence: int, data: bytes) -> None:
        channel = self._channels.get(topic)
        if channel is None:
            channel = self._channels[topic] = self._writer.channel(topic, type_name)
        self._writer.add(channel, log_ns, stamp_ns, sequence, data)


def _line(text: str) -> bytes:
    """Text as CDR can carry it: a NUL would end it, a lone surrogate has no UTF-8."""
    return text.replace("\0", "").encode("utf-8", errors="replace")
