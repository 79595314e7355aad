"""Signals -> a log: what all imports share."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np

from daq import schema
from daq.cdr import NANO, layout
from daq.errors import SeatrialError
from daq.imports.csv_read import SignalData
from daq.mcap_write import LogWriter
from daq.provenance import collect
from daq.recorder import LOG_FORMAT
from daq.samples import Scalar


@contextlib.contextmanager
def replacing(out: Path, force: bool) -> Iterator[Path]:
    """A path to write to; it becomes `out` when the block ends well, and nothing stays behind when not."""
    if out.exists() and not force:
        raise SeatrialError(f"{out}: there is such a file already; --force replaces it, -o names another")
    part = out.with_name(f".{out.name}.{os.getpid()}.part")
    try:
        yield part
        os.replace(part, out)
    finally:
        part.unlink(missing_ok=True)


def write_signals(
    out: Path,
    signals: Sequence[SignalData],
    *,
    metadata: Mapping[str, str],
    attachments: Mapping[str, bytes],
    note: str,
    force: bool = False,
) -> None:
    """Write one log of signals, messages in the order of time, with `note` as its first event."""
    times = [one.t for one in signals if len(one.t)]
    if not times:
        raise SeatrialError(f"{out}: no samples left to write; look at the map's t_from, t_to and nan")
    if min(t[0] for t in times) < 0.0 or max(t[-1] for t in times) >= 2**31:
        raise SeatrialError(f"{out}: times must lie between 1970 and 2038; look at the map's time format and origin")
    t_ns = [np.rint(one.t * NANO).astype(np.int64) for one in signals]
    first = min(int(t[0]) for t in t_ns if len(t))
    about = {**collect(), "format": LOG_FORMAT, "speed": "1.0", **metadata}
    with replacing(out, force) as part:
        writer = LogWriter(part, metadata=about, attachments=attachments, time_ns=first)
        try:
            _write(writer, signals, t_ns, note, first)
        finally:
            writer.close()


def _write(
    writer: LogWriter, signals: Sequence[SignalData], t_ns: Sequence[np.typing.NDArray[np.int64]], note: str, first: int
) -> None:
    event = writer.channel("/event", schema.EVENT)
    writer.add(event, first, first, 0, layout(schema.EVENT, b"").pack(first, tail=(b"import", note.encode())))
    channels, layouts = [], []
    for one in signals:
        signal = one.signal
        about = {"unit": one.unit, "hold": signal.hold, "role": signal.role}
        topic = schema.topic(Scalar, signal.name)
        channels.append(writer.channel(topic, schema.TYPES[Scalar], about))
        layouts.append(layout(schema.TYPES[Scalar], signal.name.encode()))
    times = np.concatenate(list(t_ns))
    which = np.repeat(np.arange(len(signals)), [len(t) for t in t_ns])
    row = np.concatenate([np.arange(len(t)) for t in t_ns])
    order = np.lexsort((which, times))
    for t, i, k in zip(times[order].tolist(), which[order].tolist(), row[order].tolist(), strict=True):
        values = (float(signals[i].t[k]), float("nan"), float(signals[i].values[k]))
        writer.add(channels[i], t, t, k + 1, layouts[i].pack(t, *values))
