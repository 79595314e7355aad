"""Writers of logs of imported data, signals or samples, which all importers share."""

from __future__ import annotations

import contextlib
import hashlib
import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seatrial.daq.clock import CLOCK_STEP_S
from seatrial.daq.errors import SeatrialError, counted, warn
from seatrial.daq.files import new_file
from seatrial.daq.importers.signals import SignalData
from seatrial.daq.log import LOG_FORMAT, NANO, LogWriter, cdr_layout, collect_provenance, discard_note, schema
from seatrial.daq.samples import Event, Frame, Scalar

GPS_ERA_S = 1024 * 604_800.0  # s; the GPS week number of old receivers starts again after this time
FIRST_GPS_DATE = 9.0e8  # s since 1970, July 1998; earlier times are not dates of a receiver after 2018
FIRST_PLAUSIBLE_DATE = 1_167_609_600.0  # s since 1970, 2007-01-01; of logs that seatrial can use
WRITTEN_S = 30 * 86_400.0  # s; longest time from the end of a recording to the date of its file


class SignalRow(NamedTuple):
    """Sample that an importer writes to a log, with its time and the name of its device or signal.

    Attributes
    ----------
    t : float
        Time of the sample in the log [s since 1970].
    device : str
        Name of the device, or of the signal.
    frame : Frame
        The sample with its receipt and device time.
    """

    t: float  # s since 1970
    device: str  # or the name of the signal
    frame: Frame


class Timed(NamedTuple):
    """Sample of an autopilot with its estimated time of measurement.

    Attributes
    ----------
    frame : Frame
        The sample with its receipt and device time.
    t : float
        Estimated time of the sample [s since 1970].
    """

    frame: Frame  # the sample, with its receipt and device time
    t: float  # s since 1970, estimated


def write_signals(
    out: Path,
    signals: Sequence[SignalData],
    *,
    metadata: Mapping[str, str],
    attachments: Mapping[str, bytes],
    note: str,
    events: Sequence[tuple[float, Event]] = (),
    force: bool = False,
    reads: Sequence[Path] = (),
) -> None:
    """Write imported signals and events as one MCAP log, in the order of time. Warn of dates 1024 weeks too early.

    Parameters
    ----------
    out
        Path of the log to write.
    signals
        The signals, with times in s since 1970 that rise.
    metadata, attachments
        Metadata and attachments of the log, by name.
    note
        Text of the first event.
    events
        Further events, with their times [s since 1970]. An event before the first sample is written at the time of that
        sample.
    force
        Whether an existing log is replaced.
    reads
        Source files, which are never replaced.

    Raises
    ------
    SeatrialError
        If no sample is left, a time is not between 1970 and 2038, the log cannot be written, or it exists and `force`
        is not set.
    """
    times = [data.t for data in signals if len(data.t)]
    if not times:
        raise SeatrialError(f"{out}: no samples left to write; check t_from, t_to and nan in the import map")
    if (begin := min(float(t[0]) for t in times)) < 0.0:
        raise SeatrialError(
            f"{out}: its first time is negative, {begin:.10g} s, but times must be between 1970 and 2038; check time "
            "format and origin in the import map, or leave out these times by [[log]] t_from"
        )
    if max(t[-1] for t in times) >= 2**31:
        raise SeatrialError(
            f"{out}: times must be between 1970 and 2038; check time format and origin in the import map"
        )
    t_ns = [np.rint(data.t * NANO).astype(np.int64) for data in signals]
    first = min(int(t[0]) for t in t_ns if len(t))
    if early := warn_of_early_dates(out, min(t[0] for t in times), max(t[-1] for t in times), reads):
        events = [*events, (first / NANO, Event("clock", early))]
    about = {**collect_provenance(imported=True), "format": LOG_FORMAT, "speed": "1.0", **metadata}
    with replacing(out, force, reads) as part:
        writer = LogWriter(part, metadata=about, attachments=attachments, time_ns=first)
        try:
            _write_in_order(writer, signals, t_ns, note, first, events)
        finally:
            writer.close()


def _write_in_order(
    writer: LogWriter,
    signals: Sequence[SignalData],
    t_ns: Sequence[np.typing.NDArray[np.int64]],
    note: str,
    first: int,
    events: Sequence[tuple[float, Event]],
) -> None:
    """Write imported signals and events to an MCAP log in the order of time.

    `t_ns` has the times (n,) of each signal [ns since 1970], and `first` is the earliest of them. The time of a sample
    is both its log time and its stamp; its device time is NaN. The first event is the import, with the text `note`. At
    equal times the signals come in their order, then the events. `events` have their times [s since 1970]; an event
    before `first` gets this time.
    """
    event, about = writer.channel("/event", schema.EVENT), cdr_layout(schema.EVENT, b"")
    writer.add(event, first, first, 0, about.pack(first, tail=(b"import", note.encode())))
    channels, layouts = [], []
    for data in signals:
        signal = data.signal
        metadata = {"unit": data.unit, "hold": signal.hold, "role": signal.role}
        if data.origin is not None:
            metadata["origin"] = f"{data.origin[0]!r} {data.origin[1]!r}"
        if data.rpm_max is not None:
            metadata["rpm_max"] = f"{data.rpm_max:.9g}"
        topic = schema.topic(Scalar, signal.name)
        channels.append(writer.channel(topic, schema.TYPES[Scalar], metadata))
        layouts.append(cdr_layout(schema.TYPES[Scalar], signal.name.encode()))
    # Events before the first sample (as the mode of an autopilot) are written at the begin of the log.
    t_event = np.array([max(round(t * NANO), first) for t, _ in events], np.int64)
    times = np.concatenate([*t_ns, t_event])
    which = np.repeat(np.arange(len(signals) + 1), [*(len(t) for t in t_ns), len(t_event)])
    row = np.concatenate([*(np.arange(len(t)) for t in t_ns), np.arange(len(t_event))])
    order = np.lexsort((which, times))
    for t, i, k in zip(times[order].tolist(), which[order].tolist(), row[order].tolist(), strict=True):
        if i == len(signals):
            tail = (events[k][1].kind.encode(), events[k][1].text.encode())
            writer.add(event, t, t, 0, about.pack(t, tail=tail))
            continue
        values = (float(signals[i].t[k]), float("nan"), float(signals[i].values[k]))
        writer.add(channels[i], t, t, k + 1, layouts[i].pack(t, *values))


def write_frames(
    out: Path,
    rows: Sequence[SignalRow],
    *,
    metadata: Mapping[str, str],
    note: str,
    units: Mapping[str, str] | None = None,
    force: bool = False,
    reads: Sequence[Path] = (),
) -> None:
    """Write decoded samples as one MCAP log, in the order of time.

    Warn of dates 1024 weeks too early and of times that run back, and add these lines to the log as events.

    Parameters
    ----------
    out
        Path of the log to write.
    rows
        The samples, in the order of the source file.
    metadata
        Metadata of the log, by name.
    note
        Text of the first event.
    units
        Units of the signals among the samples, by name.
    force
        Whether an existing log is replaced.
    reads
        Source files, which are never replaced.

    Raises
    ------
    SeatrialError
        If there are no samples, a time is not between 1970 and 2038, the log cannot be written, or it exists and
        `force` is not set.
    """
    if not rows:
        raise SeatrialError(f"{out}: its source contains no samples that seatrial can use; give another source")
    ordered = sorted(rows, key=lambda row: row.t)
    if ordered[0].t < 0.0 or ordered[-1].t >= 2**31:
        raise SeatrialError(
            f"{out}: the times of its source are not between 1970 and 2038; correct the clock, and record it again"
        )
    steps = clock_steps(out, ((row.device, row.frame, row.t) for row in rows))
    if early := warn_of_early_dates(out, ordered[0].t, ordered[-1].t, reads):
        steps.append(early)
    first = round(ordered[0].t * NANO)
    about = {**collect_provenance(imported=True), "format": LOG_FORMAT, "speed": "1.0", **metadata}
    with replacing(out, force, reads) as part:
        writer = LogWriter(part, metadata=about, attachments={}, time_ns=first)
        try:
            event = writer.channel("/event", schema.EVENT)
            for kind, text in [("import", note), *(("clock", text) for text in steps)]:
                data = cdr_layout(schema.EVENT, b"").pack(first, tail=(kind.encode(), text.encode()))
                writer.add(event, first, first, 0, data)
            _write_frames(writer, ordered, units or {})
        finally:
            writer.close()


def early_dates(first: float, last: float, written: Sequence[float]) -> str:
    """Return a line for the user if dates are probably 1024 GPS weeks too early; "" if the dates are plausible.

    Parameters
    ----------
    first, last
        First and last time of a log [s since 1970].
    written
        Dates of its source files, and the present time [s since 1970]. Without any, the result is "".

    Notes
    -----
    The corrected end is the last time plus 1024 weeks. The dates are suspicious if a file was written from 1 day before
    to 30 days after the corrected end. The dates are also suspicious if the last time is before 2007 and a file was
    written later than 1 day before the corrected end. Times before July 1998, for example since the start of a device,
    are no dates. The times are not changed, since an old log with right dates looks the same.
    """
    true_end = last + GPS_ERA_S
    if first < FIRST_GPS_DATE or true_end > max(written, default=0.0) + 86_400.0:
        return ""
    near = any(-86_400.0 <= t - true_end <= WRITTEN_S for t in written)
    if not near and last >= FIRST_PLAUSIBLE_DATE:
        return ""
    day, right = (f"{datetime.fromtimestamp(t, UTC):%Y-%m-%d}" for t in (first, first + GPS_ERA_S))
    how_sure = "probably" if near else "perhaps"
    return (
        f"its dates are {how_sure} 1024 weeks too early ({day} for {right}): the week number of an old GPS receiver "
        'starts again; a fit does not use the date; a map corrects dates by origin = "1989-08-17" in [time]'
    )


def warn_of_early_dates(out: Path, first: float, last: float, reads: Sequence[Path]) -> str:
    """Warn of dates that are probably 1024 GPS weeks too early, and return the warning; "" for plausible dates.

    Parameters
    ----------
    out
        The log, for the warning.
    first, last
        First and last time of the log [s since 1970].
    reads
        Source files and folders, whose dates show when they were written. The present time is used like such a date.
        Maps and rigs (.toml) among them are not recordings, so their dates do not count.

    Returns
    -------
    str
        The warning; "" for plausible dates.
    """
    files = [file for path in reads for file in (path.rglob("*") if path.is_dir() else [path])]
    written = [file.stat().st_mtime for file in files if file.is_file() and file.suffix != ".toml"]
    line = early_dates(first, last, [*written, time.time()])
    if line:
        warn(f"{out}: {line}")
    return line


def clock_steps(out: Path, samples: Iterable[tuple[str, Frame, float]]) -> list[str]:
    """Warn about each device whose times run back in the order of its file, and return the warnings.

    Parameters
    ----------
    out
        The log, for the warnings; the returned lines do not contain it.
    samples
        Device, sample with its times (frame), and time [s] of each sample, in the order of the file.

    Returns
    -------
    list of str
        One line for each such device, with the number of steps back and the largest one [s]. A step back is more than
        0.5 s from one sample to the next of the same kind.

    Notes
    -----
    A clock was set, or there are two clocks. In the order of time, samples from before and after the step are mixed.
    """
    newest: dict[tuple[object, ...], float] = {}
    steps: dict[str, list[float]] = {}
    for device, frame, t in samples:
        key = device, type(frame.sample), getattr(frame.sample, "node", None)
        if newest.get(key, t) - t > CLOCK_STEP_S:
            steps.setdefault(device, []).append(newest[key] - t)
        newest[key] = t
    lines = [
        f"{device}: its times ran back {counted(len(back), 'time')}, by up to {max(back):.1f} s: a clock was set, or "
        "there are two clocks; two tracks are mixed where their times overlap"
        for device, back in steps.items()
    ]
    for line in lines:
        warn(f"{out}: {line}; import the data of each clock separately")
    return lines


def _write_frames(writer: LogWriter, rows: Sequence[SignalRow], units: Mapping[str, str]) -> None:
    """Write decoded samples to an MCAP log in the given order, each to the topics of its kind.

    A signal is an output with linear hold. `units` has the unit of each signal; a signal that it lacks gets the unit
    "".
    """
    channels: dict[str, int] = {}
    for sequence, (t, device, frame) in enumerate(rows, start=1):
        t_ns = round(t * NANO)
        for message in schema.messages(device, frame):
            if message.topic not in channels:
                extra = None
                if isinstance(frame.sample, Scalar):
                    extra = {"unit": units.get(device, ""), "hold": "linear", "role": "output"}
                channels[message.topic] = writer.channel(message.topic, message.type_name, extra)
            data = cdr_layout(message.type_name, message.frame_id.encode()).pack(t_ns, *message.values)
            writer.add(channels[message.topic], t_ns, t_ns, sequence & 0xFFFFFFFF, data)


@contextlib.contextmanager
def replacing(out: Path, force: bool, reads: Sequence[Path]) -> Iterator[Path]:
    """Yield a temporary path to write to. The file becomes `out` if the `with` block succeeds, and is removed if not.

    Parameters
    ----------
    out
        The file to write.
    force
        Whether an existing file is replaced.
    reads
        Source files and folders, which are never replaced, even with `force`: a recording cannot be made again.

    Yields
    ------
    Path
        The temporary path.

    Raises
    ------
    SeatrialError
        If `out` exists, and `force` is not set, `out` is one of `reads`, or `out` lies in a folder of `reads` (except a
        .toml file).
    """
    for path in reads if out.exists() else ():
        inside = path.resolve() in out.resolve().parents and out.suffix != ".toml"  # a map may be in a bag's folder
        if (path.exists() and out.samefile(path)) or inside:
            raise SeatrialError(f"{out}: is the source of this import and is never replaced; give another file with -o")
    with new_file(out, force) as part:
        yield part
    discard_note(out)


def sha256_of(path: Path) -> str:
    """Return the SHA-256 of a source file of an import, or of the files of a folder in the order of their names.

    Entries that are no regular files are left out. Of a folder, with its subfolders, the contents of the files enter
    the digest, not their names.

    Parameters
    ----------
    path
        The file or folder.

    Returns
    -------
    str
        The digest in hexadecimal digits.
    """
    digest = hashlib.sha256()
    for file in sorted(path.rglob("*")) if path.is_dir() else [path]:
        if file.is_file():
            with file.open("rb") as opened:
                while block := opened.read(1 << 20):
                    digest.update(block)
    return digest.hexdigest()
