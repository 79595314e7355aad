"""Samples of foreign logs -> a log of ours: what the imports that know of devices share."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from daq import schema
from daq.cdr import NANO, layout
from daq.errors import SeatrialError
from daq.imports.write import replacing
from daq.mcap_write import LogWriter
from daq.provenance import collect
from daq.recorder import LOG_FORMAT
from daq.samples import Frame, Scalar


class Row(NamedTuple):
    """One sample: its time [s since 1970], its device (or the name of the signal) and itself."""

    t: float
    device: str
    frame: Frame


def write_frames(
    out: Path,
    rows: Sequence[Row],
    *,
    metadata: Mapping[str, str],
    note: str,
    units: Mapping[str, str] | None = None,
    force: bool = False,
) -> None:
    """Write samples in the order of time, with `note` as the first event; `units` are those of the signals.

    Raises SeatrialError where there is nothing to write, and for times that lie not between 1970 and 2038.
    """
    if not rows:
        raise SeatrialError(f"{out}: there is nothing in it that seatrial can use")
    ordered = sorted(rows, key=lambda row: row.t)
    if ordered[0].t < 0.0 or ordered[-1].t >= 2**31:
        raise SeatrialError(f"{out}: the times do not lie between 1970 and 2038")
    first = round(ordered[0].t * NANO)
    about = {**collect(), "format": LOG_FORMAT, "speed": "1.0", **metadata}
    with replacing(out, force) as part:
        writer = LogWriter(part, metadata=about, attachments={}, time_ns=first)
        try:
            event = writer.channel("/event", schema.EVENT)
            writer.add(event, first, first, 0, layout(schema.EVENT, b"").pack(first, tail=(b"import", note.encode())))
            _write(writer, ordered, units or {})
        finally:
            writer.close()


def _write(writer: LogWriter, rows: Sequence[Row], units: Mapping[str, str]) -> None:
    channels: dict[str, int] = {}
    for sequence, (t, device, frame) in enumerate(rows, start=1):
        t_ns = round(t * NANO)
        for message in schema.messages(device, frame):
            if message.topic not in channels:
                extra = None
                if isinstance(frame.sample, Scalar):
                    extra = {"unit": units.get(device, ""), "hold": "linear", "role": "output"}
                channels[message.topic] = writer.channel(message.topic, message.type_name, extra)
            data = layout(message.type_name, message.frame_id.encode()).pack(t_ns, *message.values)
            writer.add(channels[message.topic], t_ns, t_ns, sequence & 0xFFFFFFFF, data)
