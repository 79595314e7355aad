"""The command `seatrial import raw`: captured bytes of a device become a log, by the decoder of the live port."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Sequence
from dataclasses import fields, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from seatrial.daq.config import default_decoder
from seatrial.daq.errors import SeatrialError, counted, warn
from seatrial.daq.importers.write_log import SignalRow, write_frames
from seatrial.daq.protocol import Decoder, nmea, ubx, vectornav
from seatrial.daq.samples import Ahrs, Frame, Gnss, LoadCell, Transducer

_NAMES: dict[type, str] = {Ahrs: "ahrs", Gnss: "gnss", LoadCell: "load_cell"}
_MAGNETIC = "its magnetic headings are left out, because a capture has no declination; set the compass to true headings"
_CHUNK_BYTES = 1 << 16
OTHER_CALENDAR_S = 300 * nmea.DAY  # s; a larger jump of the date cannot happen within a run
LONGEST_PAUSE_S = 600.0  # s; longest pause between two parts of the same run
# s since 1970; the decoder gives a time of day without a date the day of its receipt, which is day 0 for a capture
UNDATED = 2 * nmea.DAY


def import_raw(
    protocol: str, path: Path, *, rate: float | None = None, out: Path | None = None, force: bool = False
) -> tuple[Path, str]:
    """Decode the captured bytes of a device and write its samples as a log.

    Parameters
    ----------
    protocol
        Protocol of the device, for example "nmea" or "vectornav".
    path
        The captured bytes.
    rate
        Rate [Hz] of the samples; None to use the times of the device.
    out
        The log to write; by default it is named after `path`, in the current folder.
    force
        Whether an existing log is replaced.

    Returns
    -------
    tuple
        The path of the new log, and the numbers of samples, checksum errors and unparsed bytes as a text.

    Raises
    ------
    SeatrialError
        If the capture cannot be read, has no samples, only transducers or no times, or the log cannot be written.

    Notes
    -----
    The first sample that is no transducer names the device in the topics, for example "gnss". Transducers (XDR) become
    signals with their own names.

    A capture does not contain the times of receipt. With `rate`, the samples of the most frequent kind are 1/rate
    apart, beginning in 1970. Rarer samples (headings between fixes) get the time of the most frequent one before them.
    Without `rate`, samples of NMEA and UBX before the first date get the date that follows, or 1970-01-01 if no date
    follows.
    """
    decoder = default_decoder(protocol)
    frames, sha256 = _decoded_frames(decoder, path)
    wrong = f"{counted(decoder.checksum_errors, 'checksum error')}, {counted(decoder.unparsed_bytes, 'byte')} unparsed"
    if not frames:
        advice = "check the protocol"
        if isinstance(decoder, nmea.Decoder) and decoder.left_out_headings:
            advice = _MAGNETIC
        received = counted(decoder.frames, f"complete {protocol} message")
        raise SeatrialError(f"{path}: {received}, and no sample in them ({wrong}); {advice}")
    if isinstance(decoder, vectornav.Decoder):
        frames, n_left_out = _without_duplicate_quantities(frames)
        wrong += f"; {counted(n_left_out, 'ASCII sample')} left out, contained in binary samples" * bool(n_left_out)
    if isinstance(decoder, nmea.Decoder) and decoder.two_receivers:
        why = "since only one position per time is kept"
        warn(f"{path}: {decoder.two_receivers}, {why}")
    if isinstance(decoder, nmea.Decoder) and decoder.left_out_headings:
        warn(f"{path}: {_MAGNETIC}")
    if not rate and isinstance(decoder, (nmea.Decoder, ubx.Decoder)):
        frames = _with_corrected_dates(path, frames)
    names = [_signal_name(frame) for frame in frames]
    device = next((name for name in names if not name.startswith(nmea.XDR)), None)
    if device is None:
        raise SeatrialError(f"{path}: contains only transducers (XDR), which have no times; record a GNSS receiver too")
    times = _times_by_rate(frames, names, rate) if rate else _device_times(path, frames)
    summary = f"{counted(len(frames), 'sample')} of {counted(decoder.frames, f'{protocol} frame')}; {wrong}"
    target = out or Path(f"{path.stem}.mcap")
    metadata = {"import": "raw", "import.protocol": protocol, "source.1.name": path.name, "source.1.sha256": sha256}
    if rate:
        metadata["import.rate_hz"] = repr(rate)
    rows = [
        SignalRow(t, name if name.startswith(nmea.XDR) else device, frame._replace(t_rx=t))
        for t, name, frame in zip(times, names, frames, strict=True)
    ]
    samples = (frame.sample for frame in frames)
    units = {sample.name: sample.unit for sample in samples if isinstance(sample, Transducer)}
    if min(times) < 0.0 or max(times) >= 2**31:
        raise SeatrialError(
            f"{target}: the times of the device are not between 1970 and 2038; give the rate of its samples with --rate"
        )
    note = f"{path.name} as {protocol}: {summary}"
    write_frames(target, rows, metadata=metadata, note=note, units=units, force=force, reads=[path])
    return target, summary


def _signal_name(frame: Frame) -> str:
    """Return the name of a decoded sample (frame): that of a transducer (`xdr_ENGINE_0`), or its kind ("gnss")."""
    return frame.sample.name if isinstance(frame.sample, Transducer) else _NAMES[type(frame.sample)]


def _decoded_frames(decoder: Decoder, path: Path) -> tuple[list[Frame], str]:
    """Decode the captured bytes in a file. Return the decoded samples with their times, and the SHA-256 of the file.

    For NMEA and UBX, a fix gets its UTC as device time, and samples before the first date get the date that follows.
    Raise SeatrialError if the file cannot be read.
    """
    frames: list[Frame] = []
    digest = hashlib.sha256()
    try:
        with path.open("rb") as file:
            while chunk := file.read(_CHUNK_BYTES):
                digest.update(chunk)
                frames += decoder.feed(chunk, 0.0)
    except OSError as error:
        raise SeatrialError(f"{path}: cannot be read: {error.strerror}; check its path and permissions") from error
    if isinstance(decoder, (nmea.Decoder, ubx.Decoder)):
        frames += decoder.flush()
        frames = _with_first_dates([_with_utc_as_device_time(frame) for frame in frames])
    decoder.reset()  # an incomplete frame counts as unparsed
    return frames, digest.hexdigest()


def _without_duplicate_quantities(frames: Sequence[Frame]) -> tuple[list[Frame], int]:
    """Remove the quantities that a VectorNav sends twice: in ASCII without a time, and in binary with a time.

    Parameters
    ----------
    frames
        All samples of a capture, with their times.

    Returns
    -------
    tuple
        The samples, and the number of samples left out. A sample with a time is kept unchanged. A sample without a time
        keeps only the quantities that no sample with a time has; the sample is left out if none remains. Nothing is
        removed if no sample has a time. The magnetic field, which no model uses, is never removed, and does not keep a
        sample by itself.
    """
    timed = [frame.sample for frame in frames if math.isfinite(frame.t_device)]
    names = [
        field.name for field in fields(Ahrs) if field.name not in ("mx", "my", "mz")
    ]  # no model uses the magnetic field
    known = {name for name in names for sample in timed if not math.isnan(getattr(sample, name))}
    if not known:
        return list(frames), 0
    kept: list[Frame] = []
    for frame in frames:
        measured = {name for name in names if not math.isnan(getattr(frame.sample, name))}
        if math.isfinite(frame.t_device):
            kept.append(frame)
        elif isinstance(frame.sample, Ahrs) and measured - known:
            kept.append(frame._replace(sample=replace(frame.sample, **dict.fromkeys(measured & known, math.nan))))
    return kept, len(frames) - len(kept)


def _with_utc_as_device_time(frame: Frame) -> Frame:
    """Return a fix with its UTC as its device time, even if the receiver marks this UTC as uncertain.

    Samples of other kinds are returned unchanged.
    """
    sample = frame.sample
    return frame._replace(t_device=sample.utc) if isinstance(sample, Gnss) else frame


def _with_first_dates(frames: list[Frame]) -> list[Frame]:
    """Move the samples before the first date of a capture to the day of the samples that follow; return all samples.

    Without any date in the capture they are on 1970-01-01. Only device times below 2 days after 1970 are moved; the UTC
    of a fix changes with them.
    """
    times = [frame.t_device for frame in frames]
    near = nmea.DAY / 2 if any(t < 0.0 for t in times) else math.nan  # without any date: on 1970-01-01
    for k in reversed(range(len(frames))):
        if times[k] < UNDATED and math.isfinite(near):
            times[k] = nmea.nearest_day(times[k], near)
        near = times[k] if math.isfinite(times[k]) else near
    return [_at_device_time(frame, t) if t != frame.t_device else frame for frame, t in zip(frames, times, strict=True)]


def _with_corrected_dates(path: Path, frames: list[Frame]) -> list[Frame]:
    """Correct the dates of a GNSS capture that are too early by years. Return the samples. Warn about them.

    A receiver counts from a date of its firmware until it has received the week, and its week number starts again every
    1024 weeks. Both make its date too early by years, so the latest date is assumed to be right. Samples of other dates
    are moved next to it by whole days. These samples are left out if they would then overlap the samples of the right
    date, or be more than 10 minutes away from them. Samples without a device time stay. The samples are unchanged,
    without a warning, if no date jumps by more than 300 days. `path` is for the warning.
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
            edge = float(t[parts[k][-1 if way < 0 else 0]])
            days = nmea.DAY * round((near - edge) / nmea.DAY)
            if not 0.0 <= way * (edge + days - near) <= LONGEST_PAUSE_S:
                left_out[parts[k]] = True
                continue
            moved[parts[k]] = days
            near = float(t[parts[k][0 if way < 0 else -1]]) + days
    counts = {"moved": int(np.count_nonzero(moved)), "left out": int(left_out.sum())}
    places = [f"{counted(n, 'sample')} {action}" for action, n in counts.items() if n]
    text = "wrong dates: the receiver had not received the date yet, or its week number started again (1024 weeks)"
    warn(f"{path}: {text}; {' and '.join(places)}: check the date of the log")
    rows = zip(frames, moved.tolist(), left_out.tolist(), strict=True)
    return [_at_device_time(frame, frame.t_device + days) if days else frame for frame, days, out in rows if not out]


def _at_device_time(frame: Frame, t: float) -> Frame:
    """Return a decoded sample with another device time [s since 1970]; the UTC of a fix changes with it."""
    sample = frame.sample
    return frame._replace(t_device=t, sample=replace(sample, utc=t) if isinstance(sample, Gnss) else sample)


def _times_by_rate(frames: Sequence[Frame], kinds: Sequence[str], rate: float) -> list[float]:
    """Return times [s] for the samples of a capture without times, by their rate [Hz]; the first time is 0.

    `kinds` has the kind of each sample. Samples of the most frequent kind are 1/rate apart; so are those of a kind with
    at most two samples fewer. A sample of a rarer kind has the time of the most frequent sample before it. Transducers
    (XDR) never count as the most frequent kind. Samples before the first one of the most frequent kind have time 0.
    """
    numbers = Counter(kinds)
    most, n_most = max(
        ((kind, n) for kind, n in numbers.items() if not kind.startswith(nmea.XDR)), key=lambda pair: pair[1]
    )
    so_far: Counter[str] = Counter()
    times = []
    for kind in kinds:
        so_far[kind] += 1
        # At the ends of a capture a kind of the same rate may lack a sample or two; it is counted by itself.
        n = so_far[kind if numbers[kind] >= n_most - 2 else most]
        times.append(max(n - 1, 0) / rate)
    return times


def _device_times(path: Path, frames: Sequence[Frame]) -> list[float]:
    """Return the device time [s] of each sample of a capture.

    A sample without a time (a heading between fixes) has that of the sample before. Samples before the first time have
    the first time. Raise SeatrialError if no sample has a time. `path` is for the error message.
    """
    times = [frame.t_device for frame in frames]
    last = next((t for t in times if math.isfinite(t)), math.nan)
    if math.isnan(last):
        raise SeatrialError(f"{path}: its samples have no times; give the rate of the samples with --rate")
    for k, t in enumerate(times):
        last = times[k] = t if math.isfinite(t) else last
    return times
