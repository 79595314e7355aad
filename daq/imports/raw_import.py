"""`seatrial import raw`: the bytes that a device once sent -> a log, by the decoder that also reads the live port."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Callable, Sequence
from pathlib import Path

from daq import schema
from daq.cdr import NANO, layout
from daq.errors import SeatrialError
from daq.imports.write import replacing
from daq.mcap_write import LogWriter
from daq.protocol import Decoder, loadcell, nmea, vectornav
from daq.provenance import collect
from daq.recorder import LOG_FORMAT
from daq.samples import Frame

# VESC frames are not here: their rpm and sign need the rig.
DECODERS: dict[str, tuple[str, Callable[[], Decoder]]] = {
    "vectornav": ("ahrs", vectornav.Decoder),
    "nmea": ("gnss", nmea.Decoder),
    "loadcell": ("load_cell", loadcell.Decoder),
}
_CHUNK = 1 << 16


def import_raw(
    protocol: str, path: Path, *, rate: float | None = None, out: Path | None = None, force: bool = False
) -> tuple[Path, str]:
    """Decode a capture and write its samples; returns the log and a line that says what was in the capture.

    A capture has no times of its own. With `rate` [Hz] the samples are put 1/rate apart, beginning in 1970; without
    it each carries the device's own time. Raises SeatrialError.
    """
    device, make = DECODERS[protocol]
    decoder = make()
    frames, sha256 = _decode(decoder, path)
    if not frames:
        raise SeatrialError(
            f"{path}: no {protocol} samples among {decoder.frames} whole frames "
            f"({decoder.checksum_errors} checksum errors, {decoder.unparsed_bytes} bytes unparsed)"
        )
    times = [k / rate for k in range(len(frames))] if rate else [_device_time(path, f) for f in frames]
    said = (
        f"{len(frames)} samples of {decoder.frames} {protocol} frames; "
        f"{decoder.checksum_errors} checksum errors, {decoder.unparsed_bytes} bytes unparsed"
    )
    target = out or Path(f"{path.stem}.mcap")
    metadata = {"import": "raw", "import.protocol": protocol, "source.1.name": path.name, "source.1.sha256": sha256}
    if rate:
        metadata["import.rate_hz"] = repr(rate)
    _write(target, device, frames, times, metadata, f"{path.name} as {protocol}: {said}", force)
    return target, said


def _decode(decoder: Decoder, path: Path) -> tuple[list[Frame], str]:
    frames: list[Frame] = []
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while chunk := file.read(_CHUNK):
                digest.update(chunk)
                frames += decoder.feed(chunk, 0.0)
    except OSError as error:
        raise SeatrialError(f"{path}: cannot be read: {error.strerror}") from error
    decoder.reset()  # what is left half-read counts as unparsed
    return frames, digest.hexdigest()


def _device_time(path: Path, frame: Frame) -> float:
    if not math.isfinite(frame.t_device):
        raise SeatrialError(f"{path}: its samples carry no time; say how many there are a second with --rate")
    return frame.t_device


def _write(
    out: Path,
    device: str,
    frames: Sequence[Frame],
    times: Sequence[float],
    metadata: dict[str, str],
    note: str,
    force: bool,
) -> None:
    order = sorted(range(len(times)), key=times.__getitem__)
    if times[order[0]] < 0.0 or times[order[-1]] >= 2**31:
        raise SeatrialError(f"{out}: the device's times do not lie between 1970 and 2038; give --rate instead")
    first = round(times[order[0]] * NANO)
    about = {**collect(), "format": LOG_FORMAT, "speed": "1.0", **metadata}
    with replacing(out, force) as part:
        writer = LogWriter(part, metadata=about, attachments={}, time_ns=first)
        try:
            event = writer.channel("/event", schema.EVENT)
            writer.add(event, first, first, 0, layout(schema.EVENT, b"").pack(first, tail=(b"import", note.encode())))
            channels: dict[str, int] = {}
            for sequence, k in enumerate(order, start=1):
                t_ns = round(times[k] * NANO)
                for message in schema.messages(device, frames[k]._replace(t_rx=times[k])):
                    if message.topic not in channels:
                        channels[message.topic] = writer.channel(message.topic, message.type_name)
                    data = layout(message.type_name, message.frame_id.encode()).pack(t_ns, *message.values)
                    writer.add(channels[message.topic], t_ns, t_ns, sequence, data)
        finally:
            writer.close()
