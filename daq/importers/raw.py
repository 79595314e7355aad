"""`seatrial import raw`: the bytes that a device once sent -> a log, by the decoder that also reads the live port."""

from __future__ import annotations

import hashlib
import math
import re
import warnings
from collections import Counter
from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from seatrial.daq.config import default_decoder
from seatrial.daq.errors import SeatrialError, SeatrialWarning, counted
from seatrial.daq.importers.write_log import SignalRow, write_frames
from seatrial.daq.protocol import Decoder, nmea, ubx, vectornav
from seatrial.daq.samples import Ahrs, Frame, Gnss, LoadCell, Scalar

_NAMES: dict[type, str] = {Ahrs: "ahrs", Gnss: "gnss", LoadCell: "load_cell"}
XDR = "xdr_"  # in front of the name of a transducer
_CHUNK = 1 << 16
# s: a jump of the date that no run has; a pause between two parts that may be of one run
OTHER_CALENDAR_S, LONGEST_PAUSE_S = 300 * nmea.DAY, 600.0
UNDATED = 2 * nmea.DAY  # s since 1970; a time of day without a date is given the day of the receipt, which is 0 here


def import_raw(
    protocol: str, path: Path, *, rate: float | None = None, out: Path | None = None, force: bool = False
) -> tuple[Path, str]:
    """Decode a capture and write its samples; returns the path of the log and a summary in one line.

    A capture has no times of its own. With `rate` [Hz] the samples are put 1/rate apart, beginning in 1970: those of
    the most frequent kind, rarer ones (headings between fixes) at the one before them. Without it each carries the
    device's own time. NMEA before its first date has that of the date which follows, and the day of 1970-01-01 where
    none does. Raises SeatrialError.
    """
    decoder = default_decoder(protocol)
    if isinstance(decoder, nmea.Decoder):
        decoder.transducers = []
    frames, sha256 = _decode(decoder, path)
    wrong = f"{counted(decoder.checksum_errors, 'checksum error')}, {counted(decoder.unparsed_bytes, 'byte')} unparsed"
    if not frames:
        raise SeatrialError(f"{path}: no {protocol} samples among {decoder.frames} whole frames ({wrong})")
    if isinstance(decoder, vectornav.Decoder):
        frames, n_left_out = _without_doubles(frames)
        wrong += f"; {counted(n_left_out, 'ASCII sample')} left out beside the binary ones" * bool(n_left_out)
    if not rate and isinstance(decoder, (nmea.Decoder, ubx.Decoder)):
        frames = _one_calendar(path, frames)
    transducers = list(decoder.transducers or ()) if isinstance(decoder, nmea.Decoder) else []
    names = _names(frames, transducers)
    if all(name.startswith(XDR) for name in names):
        raise SeatrialError(f"{path}: has transducers (XDR) only, which have no times")
    device = next(name for name in names if not name.startswith(XDR))
    times = _even_times(frames, names, rate) if rate else _device_times(path, frames)
    said = f"{counted(len(frames), 'sample')} of {counted(decoder.frames, f'{protocol} frame')}; {wrong}"
    target = out or Path(f"{path.stem}.mcap")
    metadata = {"import": "raw", "import.protocol": protocol, "source.1.name": path.name, "source.1.sha256": sha256}
    if rate:
        metadata["import.rate_hz"] = repr(rate)
    rows = [
        SignalRow(t, name if name.startswith(XDR) else device, frame._replace(t_rx=t))
        for t, name, frame in zip(times, names, frames, strict=True)
    ]
    units = {name: one.unit for name, one in zip((n for n in names if n.startswith(XDR)), transducers, strict=True)}
    if min(times) < 0.0 or max(times) >= 2**31:
        raise SeatrialError(f"{target}: the device's times do not lie between 1970 and 2038; give --rate instead")
    note = f"{path.name} as {protocol}: {said}"
    write_frames(target, rows, metadata=metadata, note=note, units=units, force=force, reads=[path])
    return target, said


def _names(frames: Sequence[Frame], transducers: Sequence[nmea.Transducer]) -> list[str]:
    """Return a name for each frame: that of its kind, or for a transducer its own, as a signal can have it."""
    left = iter(transducers)
    return [
        f"{XDR}{re.sub('[^A-Za-z0-9_]+', '_', next(left).name).strip('_')}"
        if isinstance(frame.sample, Scalar)
        else _NAMES[type(frame.sample)]
        for frame in frames
    ]


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
    if isinstance(decoder, (nmea.Decoder, ubx.Decoder)):
        frames += decoder.flush()
        frames = _dated([_timed(frame) for frame in frames])
    decoder.reset()  # an incomplete frame counts as unparsed
    return frames, digest.hexdigest()


def _without_doubles(frames: Sequence[Frame]) -> tuple[list[Frame], int]:
    """Leave out the quantities that a VectorNav sends twice, as ASCII without a time and in binary with its own.

    Returns
    -------
    tuple
        The frames; of one without a time only what no binary one has is left, with the time of the one before. The
        number of frames of which nothing is left.
    """
    timed = [frame.sample for frame in frames if math.isfinite(frame.t_device)]
    names = [field.name for field in fields(Ahrs) if field.name not in ("mx", "my", "mz")]  # which no model takes
    known = {name for name in names for sample in timed if not math.isnan(getattr(sample, name))}
    if not known:
        return list(frames), 0
    kept: list[Frame] = []
    for frame in frames:
        own = {name for name in names if not math.isnan(getattr(frame.sample, name))}
        if math.isfinite(frame.t_device):
            kept.append(frame)
        elif isinstance(frame.sample, Ahrs) and own - known:
            kept.append(frame._replace(sample=replace(frame.sample, **dict.fromkeys(own & known, math.nan))))
    return kept, len(frames) - len(kept)


def _timed(frame: Frame) -> Frame:
    """A fix from before the receiver knew the time, with the time that it thought it was: a file has no other."""
    sample = frame.sample
    return frame._replace(t_device=sample.utc) if isinstance(sample, Gnss) else frame


def _dated(frames: list[Frame]) -> list[Frame]:
    """Frames of a time of day, before the first date, moved to the day of what follows them."""
    times = [frame.t_device for frame in frames]
    near = nmea.DAY / 2 if any(t < 0.0 for t in times) else math.nan  # without any date: within 1970-01-01
    for k in reversed(range(len(frames))):
        if times[k] < UNDATED and math.isfinite(near):
            times[k] = nmea.nearest_day(times[k], near)
        near = times[k] if math.isfinite(times[k]) else near
    return [_at(frame, t) if t != frame.t_device else frame for frame, t in zip(frames, times, strict=True)]


def _one_calendar(path: Path, frames: list[Frame]) -> list[Frame]:
    """Frames of one calendar: those of a receiver that does not know the date yet, or of another 1024 weeks, are moved.

    A receiver counts from a date of its firmware until it knows the week, and its week runs over every 1024 weeks. Both
    make its date too early by years, so the latest date is taken for right. Frames of another date are moved by whole
    days next to it. They are left out where their time of the day is wrong, too.
    """
    t = np.array([frame.t_device for frame in frames])
    known = np.flatnonzero(np.isfinite(t))
    edges = [0, *(np.flatnonzero(np.abs(np.diff(t[known])) > OTHER_CALENDAR_S) + 1).tolist(), len(known)]
    parts = [known[a:b] for a, b in pairwise(edges)]
    if len(parts) < 2:
        return frames
    right = max(range(len(parts)), key=lambda k: float(np.median(t[parts[k]])))
    moved, left_out = np.zeros(len(t)), np.zeros(len(t), bool)
    for way, order in ((-1, range(right - 1, -1, -1)), (1, range(right + 1, len(parts)))):
        near = float(t[parts[right][0 if way < 0 else -1]])
        for k in order:
            own = float(t[parts[k][-1 if way < 0 else 0]])
            days = nmea.DAY * round((near - own) / nmea.DAY)
            if not 0.0 <= way * (own + days - near) <= LONGEST_PAUSE_S:
                left_out[parts[k]] = True
                continue
            moved[parts[k]] = days
            near = float(t[parts[k][0 if way < 0 else -1]]) + days
    counts = {"moved": int(np.count_nonzero(moved)), "left out": int(left_out.sum())}
    places = [f"{counted(n, 'sample')} {what}" for what, n in counts.items() if n]
    text = "dates of another calendar: the receiver did not know the date yet, or its week ran over (1024 weeks)"
    warnings.warn(f"{path}: {text}; {' and '.join(places)}", SeatrialWarning, stacklevel=3)
    rows = zip(frames, moved.tolist(), left_out.tolist(), strict=True)
    return [_at(one, one.t_device + days) if days else one for one, days, out in rows if not out]


def _at(frame: Frame, t: float) -> Frame:
    sample = frame.sample
    return frame._replace(t_device=t, sample=replace(sample, utc=t) if isinstance(sample, Gnss) else sample)


def _even_times(frames: Sequence[Frame], kinds: Sequence[str], rate: float) -> list[float]:
    """Times [s] 1/rate apart of the most frequent kind of sample, and of one that comes as often but for the ends of
    the capture; rarer ones have the time of the most frequent one before them."""
    numbers = Counter(kinds)
    most, n_most = max(((kind, n) for kind, n in numbers.items() if not kind.startswith(XDR)), key=lambda pair: pair[1])
    so_far: Counter[str] = Counter()
    times = []
    for kind in kinds:
        so_far[kind] += 1
        n = so_far[kind if numbers[kind] >= n_most - 2 else most]
        times.append(max(n - 1, 0) / rate)
    return times


def _device_times(path: Path, frames: Sequence[Frame]) -> list[float]:
    """The device's own times [s]; a sample without one (a heading between two fixes) has that of the one before."""
    times = [frame.t_device for frame in frames]
    last = next((t for t in times if math.isfinite(t)), math.nan)
    if math.isnan(last):
        raise SeatrialError(f"{path}: its samples have no time; give their rate with --rate")
    for k, t in enumerate(times):
        last = times[k] = t if math.isfinite(t) else last
    return times
