"""Live table of a running acquisition: rates, ages, error counters and newest samples of its devices.

Without a terminal the status is printed as lines.
"""

from __future__ import annotations

import dataclasses
import math
import threading
import time
from pathlib import Path

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from seatrial.daq.acquisition import NO_STATUS_S, Acquisition, PortStatus, Source, Status, count_senders
from seatrial.daq.clock import RunClock
from seatrial.daq.errors import counted
from seatrial.daq.rig import Rig
from seatrial.daq.samples import Ahrs, Autopilot, Battery, Esc, Gnss, LoadCell, Sample, Servo

TABLE_S = 0.2  # s of wall time between two updates of the table
LINE_S = 5.0  # s of wall time between two lines, without a terminal
FIRST_LINE_S = 0.5  # s of wall time before the first line
# A source is stale after the longest of these three times without a sample.
STALE_PERIODS = 5.0  # expected periods
STALE_S = 1.0  # s of the run clock
STALE_WALL_S = 0.25  # s of wall time
# Factor of this time for a device with several kinds of samples: fixes and batteries have lower rates than rate_hz.
SEVERAL_KINDS_FACTOR = 3.0
NO_ANSWER = "the acquisition process does not answer"
RATE_TOLERANCE = 0.1  # relative difference from the expected rate beyond which a rate is highlighted
WIDE_CHARACTERS = 110  # characters; a narrower terminal shows fewer columns
FIX_NAMES = ("no fix", "dead reckoning", "2D", "3D", "DGPS", "RTK fixed", "RTK float")
# Each state has a word besides its colour. Blue and orange are distinguishable with most colour blindness.
GOOD, BAD, DIM = "bright_blue", "bold orange1", "dim"
ALARM = "bold white on red"


def default_log_path(rig: Rig) -> Path:
    """Return the path of a new log, DIRECTORY/RIG-DATE-TIME.mcap, in the log folder and with the name of the rig.

    Date and time are the present local time. White space in the name of the rig becomes a hyphen. If the file exists,
    the first free one of -2, -3, ... is added to its stem. No file is created.
    """
    stem = f"{'-'.join(rig.name.split())}-{time.strftime('%Y%m%d-%H%M%S')}"
    path = rig.log_directory / f"{stem}.mcap"
    number = 1
    while path.exists():
        number += 1
        path = rig.log_directory / f"{stem}-{number}.mcap"
    return path


def watch(
    acquisition: Acquisition, rig: Rig, clock: RunClock, deadline: float, stop: threading.Event, console: Console
) -> None:
    """Show the status of an acquisition until a deadline: a table on a terminal, a line every 5 s otherwise.

    It blocks until the deadline or the event `stop`. Lines show each hint only once. It raises SeatrialError if the
    acquisition process fails or ends by itself meanwhile.

    Parameters
    ----------
    acquisition
        The running acquisition, which records the devices of a rig.
    rig
        Its rig.
    clock
        Run clock.
    deadline
        Time of the run clock at which this function returns [s since 1970]; inf for no deadline.
    stop
        Event that ends this function earlier.
    console
        Destination of the output.
    """
    if not console.is_terminal:
        line_at, shown = time.monotonic() + FIRST_LINE_S, set[str]()
        while not stop.wait(_wait_seconds(clock, deadline, line_at)) and clock.now() < deadline:
            if time.monotonic() >= line_at:
                status = acquisition.status()
                for hint in set(status.hints) - shown:  # lines show a hint only once; the table repeats it
                    console.print(f"hint: {hint}", soft_wrap=True, markup=False)
                shown.update(status.hints)
                console.print(line(status, rig, clock.now()), soft_wrap=True, markup=False)
                line_at += LINE_S
        return
    with Live(console=console, auto_refresh=False, screen=False) as live:
        while not stop.wait(_wait_seconds(clock, deadline, time.monotonic() + TABLE_S)) and clock.now() < deadline:
            live.update(table(acquisition.status(), rig, console.width, clock.now()), refresh=True)


def _wait_seconds(clock: RunClock, deadline: float, until_wall: float) -> float:
    """Return the wall time [s] until the deadline of the run clock or the next output, whichever is earlier.

    `until_wall` is the time of the next output by the monotonic clock [s]. The result is at least 1 ms.
    """
    return max(min(clock.wall(deadline - clock.now()), until_wall - time.monotonic()), 0.001)


def _update_ages(status: Status, rig: Rig, now: float) -> tuple[Status, bool]:
    """Bring the ages and rates in a status of the acquisition to the run time `now` [s since 1970].

    An age is the time since the last sample of a device. Return the new status, and whether the acquisition still
    answers, which means that its status is at most 1 s of wall time old; if not, the rates are NaN. Without this update
    a hanging acquisition would seem to work, because it computes the ages in its status itself.
    """
    late = max(now - status.t, 0.0)
    answers = late <= NO_STATUS_S * rig.speed
    ports = {
        name: dataclasses.replace(port, age=port.age + late, rate=port.rate if answers else math.nan)
        for name, port in status.ports.items()
    }
    return dataclasses.replace(status, t=status.t + late, ports=ports), answers


def table(status: Status, rig: Rig, width: int, now: float) -> Group:
    """Return the live table of an acquisition: a header line, the rows of the devices, warnings and hints.

    A device has further rows for further speed controllers and kinds of samples.

    Parameters
    ----------
    status
        Status of the acquisition.
    rig
        Its rig.
    width
        Width of the terminal [characters].
    now
        Time of the run clock [s since 1970].
    """
    status, answers = _update_ages(status, rig, now)
    wide = width >= WIDE_CHARACTERS
    rows = Table(box=None, expand=True, padding=(0, 1, 0, 0), header_style="bold")
    columns = ["device", "rate/Hz", "of", "age/s", "frames", "errors", "latest"]
    if wide:
        columns = [
            "device",
            "rate/Hz",
            "of",
            "age/s",
            "frames",
            "checksum",
            "unparsed",
            "dropped",
            "reopened",
            "late/ms",
            "latest",
        ]
    for name in columns:
        left = name in ("device", "latest")
        rows.add_column(
            name,
            justify="left" if left else "right",
            no_wrap=True,
            overflow="ellipsis",
            ratio=1 if name == "latest" else None,
        )
    for port in status.ports.values():
        values = [
            _newest_text(source, port, status, rig)
            for source in sorted(status.latest, key=str)
            if source[0].partition("/")[0] == port.name  # DEVICE/KIND for a device with several kinds of samples
        ] or [Text(port.message or "no sample yet", style=BAD)]
        rows.add_row(*_device_cells(port, rig.speed, wide), values[0])
        for value in values[1:]:
            rows.add_row(*[""] * (len(columns) - 1), value)
    parts: list[Table | Text] = [_header_line(status, rig, answers), Text(), rows, Text()]
    parts += [Text(f"! {warning}", style=BAD) for warning in status.warnings]
    parts += [Text(f"hint: {hint}", style=DIM) for hint in status.hints]
    parts.append(Text("Ctrl-C ends the log", style=DIM))
    return Group(*parts)


def _newest_text(source: Source, port: PortStatus, status: Status, rig: Rig) -> Text:
    """Return the newest sample of a device or speed controller (`source`) as text for the live table.

    For a sample that is too old for its rate (`_stale_after`) the text begins with STALE and its age [s], in the colour
    of a fault. The expected rate of a device is shared by its speed controllers. The limit is three times as long if
    the device sends several kinds of samples. A GNSS receiver without a fix is not marked while its device sends.
    """
    latest = status.latest[source]
    text, age = describe(latest.sample, rig, port.name), status.t - latest.t
    kinds, nodes = count_senders(status, port.name)
    rate = port.expected if source[1] is None else port.expected / nodes
    seldom = SEVERAL_KINDS_FACTOR if kinds > 1 or source[0] != port.name else 1.0
    stale = age > seldom * _stale_after(rate, rig.speed)
    # An autopilot without a fix repeats its last message, and a repetition is no new sample: it is not stale.
    waits = isinstance(latest.sample, Gnss) and latest.sample.fix == 0 and not _is_silent(port, rig.speed)
    return Text(f"STALE {age:.0f} s: {text}", style=BAD) if stale and not waits else Text(text)


def _is_silent(port: PortStatus, speed: float) -> bool:
    """Return whether a device has sent no sample for too long.

    Too long is the longest of 5 expected periods, 1 s, and 0.25 s of wall time. `speed` is the number of run seconds
    per wall second.
    """
    return port.age > _stale_after(port.expected, speed)


def _stale_after(rate: float, speed: float) -> float:
    """Return the time without a sample [s of the run clock] after which a device with this sample rate [Hz] is stale.

    It is the longest of 5 periods, 1 s, and 0.25 s of wall time (`speed`: run seconds per wall second).
    """
    return max(STALE_S, STALE_PERIODS / rate, STALE_WALL_S * speed)


def _header_line(status: Status, rig: Rig, answers: bool) -> Text:
    """Return the header line of the live table: state of the recording, duration, speed, size and name of the log.

    The state is that the acquisition does not answer if `answers` is false. Otherwise it is NOT RECORDING with the
    reason if the status has an alarm, else REC. The speed of the run clock is shown only if it is not 1.
    """
    text = Text(no_wrap=True, overflow="ellipsis")
    if not answers:
        text.append(f"! {NO_ANSWER}", style=BAD)
    elif status.alarm:
        text.append(f" NOT RECORDING: {status.alarm} ", style=ALARM)
    else:
        text.append(" REC ", style="reverse bold")
    text.append(f" {duration_text(status.duration)}", style="bold")
    if rig.speed != 1.0:
        text.append(f" at speed {rig.speed:g}", style=DIM)
    text.append(f"  {size_text(status.bytes)}  {Path(status.path).name}")
    return text


def _device_cells(port: PortStatus, speed: float, wide: bool) -> list[Text]:
    """Return the cells of a device's row in the live table, except its newest sample.

    `speed` is the number of run seconds per wall second. A `wide` table has a column for each error counter, a narrow
    one has a single column for all that are not zero. Only a wide table has a last cell with the delay of the samples
    [wall ms], "-" if it is unknown. Faults have a word or mark beside their colour, except error counters, and a rate
    that differs by more than 10 % from the expected rate.
    """
    stale = _is_silent(port, speed)
    off = not abs(port.rate - port.expected) <= RATE_TOLERANCE * port.expected
    age = "never" if math.isinf(port.age) else f"{port.age:.1f}" if stale else f"{port.age:.2f}"
    cells = [
        Text(f"{'!' if stale or port.message else '●'} {port.name}", style=BAD if stale or port.message else GOOD),
        Text("-" if math.isnan(port.rate) else f"{port.rate:.1f}", style=BAD if off and not stale else ""),
        Text(f"{port.expected:g}", style=DIM),
        Text(f"{age} STALE" if stale and not math.isinf(port.age) else age, style=BAD if stale else ""),
        Text(f"{port.frames}"),
    ]
    counts = [port.checksum_errors, port.unparsed_bytes, port.dropped, port.reconnects]
    if not wide:
        named_counts = zip(counts, ("chk", "unp", "drop", "reop"), strict=True)
        short = " ".join(f"{count}{name}" for count, name in named_counts if count)
        return [*cells, Text(short or "0", style=BAD if short else DIM)]
    cells += [Text(f"{count}", style=BAD if count else DIM) for count in counts]
    return [*cells, Text("-" if math.isnan(port.latency) else f"{1e3 * port.latency / speed:.1f}")]


def describe(sample: Sample, rig: Rig, device: str) -> str:
    """Return the values of a sample as a short text for the user.

    Angles are in degrees; unknown values (NaN) are left out.

    Parameters
    ----------
    sample
        The sample. One of a kind without a format here is shown by its `str`.
    rig
        Rig with the names of the thrusters. A controller without a thruster is named by its number.
    device
        Name of the device of the sample.
    """
    if isinstance(sample, Ahrs):
        return _joined_values(
            ("yaw", math.degrees(sample.yaw), ".1f", "°"),
            ("r", math.degrees(sample.r), ".1f", "°/s"),
            ("roll", math.degrees(sample.roll), ".1f", "°"),
            ("pitch", math.degrees(sample.pitch), ".1f", "°"),
        )
    if isinstance(sample, Gnss):
        fix = FIX_NAMES[sample.fix] if 0 <= sample.fix < len(FIX_NAMES) else f"fix {sample.fix}"
        fix += " 2D" if sample.fix > 2 and sample.dimensions == 2 else ""
        satellites = f"{sample.n_sat} sat " if sample.n_sat >= 0 else ""
        velocity_and_position = _joined_values(
            ("", sample.speed, ".2f", "m/s"), ("", sample.lat, ".6f", ""), ("", sample.lon, ".6f", "")
        )
        return f"{fix} {satellites}{velocity_and_position}"
    if isinstance(sample, Esc):
        names = [t.name for t in rig.thrusters if (t.device, t.node) == (device, sample.node)]
        values = (("", sample.rpm, ".0f", "rpm"), ("", sample.current, ".1f", "A"))
        supply = (("", sample.voltage, ".1f", "V"), ("", sample.temperature, ".0f", "°C"))
        return f"{names[0] if names else sample.node}: " + _joined_values(*values, *supply)
    if isinstance(sample, LoadCell):
        flags = " saturated" * (sample.flags & 1) + " spike" * (sample.flags >> 1 & 1)
        return _joined_values(("", sample.force, ".2f", "N"), ("", sample.counts, ".0f", "counts")) + flags
    if isinstance(sample, Battery):
        level = ("", 100.0 * sample.remaining, ".0f", "%")
        return "battery " + _joined_values(("", sample.voltage, ".1f", "V"), ("", sample.current, ".1f", "A"), level)
    if isinstance(sample, Servo):
        return f"output {sample.node}: " + _joined_values(("", sample.pwm, ".0f", "us"), ("n", sample.n, ".2f", ""))
    if isinstance(sample, Autopilot):
        return f"{'armed' if sample.armed else 'not armed'}, mode {sample.mode}"
    return str(sample)


def _joined_values(*parts: tuple[str, float, str, str]) -> str:
    """Join values to one text, from (name, value, format, unit) of each: "yaw 12.3° r 0.5°/s".

    NaN is left out; the text is empty if all values are NaN.
    """
    texts = []
    for name, value, form, unit in parts:
        if not math.isnan(value):
            gap = " " if unit and not unit.startswith("°") else ""
            texts.append(f"{name} {value:{form}}{gap}{unit}".strip())
    return " ".join(texts)


def line(status: Status, rig: Rig, now: float) -> str:
    """Return the status of an acquisition as one line, for a file or a pipe: rates and errors of the devices, warnings.

    `now` is the time of the run clock [s since 1970]. Only error counters that are not zero are shown. A device without
    any sample so far is "silent". Hints and samples are not in the line.
    """
    status, answers = _update_ages(status, rig, now)
    ports = []
    for port in status.ports.values():
        rate = "-" if math.isnan(port.rate) else f"{port.rate:.1f}"
        rate = "silent" if math.isinf(port.age) else f"{rate}/{port.expected:g} Hz"
        counts = (port.checksum_errors, port.unparsed_bytes, port.dropped, port.reconnects)
        errors = counted(counts[0], "checksum error"), counted(counts[1], "unparsed byte")
        words = (*errors, f"{counts[2]} dropped", f"{counts[3]} reopened")
        faults = "".join(f" {word}" for count, word in zip(counts, words, strict=True) if count)
        ports.append(f"{port.name} {rate}{faults}")
    warnings = "".join(f"; {warning}" for warning in status.warnings)
    silence = f" {NO_ANSWER}" if not answers else " NOT RECORDING" if status.alarm else ""
    return f"{duration_text(status.duration)} {size_text(status.bytes)}{silence}: {', '.join(ports)}{warnings}"


def log_summary(status: Status, path: Path, speed: float = 1.0) -> str:
    """Return the line for the user at the end of a recording: log file, duration, number of samples and size.

    If there are any, it also has the number of lost samples, the devices without a sample, and the devices that were
    silent at the end, with the time of silence and the fault of the port. `status` is the last status of the
    acquisition, `path` is the log, and `speed` has run seconds per wall second.
    """
    quiet = [
        f"{port.name} for {port.age:.1f} s{f' ({port.message})' if port.message else ''}"
        for port in status.ports.values()
        if port.samples and _is_silent(port, speed)
    ]
    lost = sum(port.dropped for port in status.ports.values())
    silent = [port.name for port in status.ports.values() if port.samples == 0]
    text = f"{path}: {duration_text(status.duration)}, {counted(status.messages, 'sample')}, {size_text(status.bytes)}"
    text += f", {lost} lost" if lost else ""
    text += f"; nothing from {', '.join(silent)}" if silent else ""
    return text + (f"; SILENT AT THE END: {', '.join(quiet)}" if quiet else "")


def duration_text(seconds: float) -> str:
    """Return the duration of a recording [s] as a text: `1:02:03`, or `2:03.4` for less than an hour.

    The text is rounded down. A negative duration is shown as zero.
    """
    minutes, rest = divmod(max(seconds, 0.0), 60.0)
    if minutes < 60.0:
        return f"{int(minutes)}:{math.floor(rest * 10.0) / 10.0:04.1f}"
    return f"{int(minutes // 60)}:{int(minutes % 60):02d}:{int(rest):02d}"


def size_text(n_bytes: int) -> str:
    """Return the size of a log [bytes] as a text such as `1.2 MB`, with decimal units.

    Bytes have no decimals, kB and MB have one, and GB, the largest unit, has two.
    """
    size = float(n_bytes)
    for unit in ("B", "kB", "MB"):
        if size < 1000.0:
            return f"{size:.0f} {unit}" if unit == "B" else f"{size:.1f} {unit}"
        size /= 1000.0
    return f"{size:.2f} GB"
