"""Content of a log as data and as tables, for `seatrial info`."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import groupby
from pathlib import Path

import numpy as np
import numpy.typing as npt
from rich import box, markup
from rich.console import Console
from rich.table import Table

from seatrial.daq.console import print_table
from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.log import Log, armed_intervals, bag_of_ros, first_sample, first_segment_of, schema
from seatrial.daq.samples import PortHealth, Scalar

Array = npt.NDArray[np.float64]
FIRST_EVENTS, LAST_EVENTS = 25, 15  # of many events only these are shown: the last events are about the end of the run
_ABOUT = {  # texts of the metadata that are shown, with their names for the user
    "rig": "rig",
    "operator": "operator",
    "host": "host",
    "imported_by": "imported by",
    "imported_on": "imported on",
    "git": "git",
    "command_line": "command",
    "speed": "run seconds per wall second",
    "import.map": "import.map",
}
MAX_CHARACTERS = 2000  # characters of a text that are shown; longer texts are not meant for readers
WIDE = 120  # columns of a console in which the heads of the tables need no second line
OWN_TYPES = "seatrial_msgs/msg/"  # package of the types of messages of seatrial
FOLDED = ("skipped", "parameter")  # kinds of events that often repeat; repetitions become one line


def escape(text: str) -> str:
    """Return a text of a log in which the markup of the console (rich) is escaped, so that [bold] is printed unchanged.

    A text of more than 2000 characters is cut off, and the number of its characters is added.
    """
    return markup.escape(
        text if len(text) <= MAX_CHARACTERS else f"{text[:MAX_CHARACTERS]}... ({len(text)} characters)"
    )


@dataclass(frozen=True)
class TopicContent:
    """One topic of a log.

    Attributes
    ----------
    topic, type
        Name of the topic, and type of its messages.
    messages
        Number of messages.
    rate
        Mean rate [Hz]; NaN if it is unknown.
    longest_gap
        Longest time between two messages [s]; NaN if it is unknown.
    signal
        Name of the imported signal; None for other topics. The next three are None then.
    role, unit, hold
        Input or output, unit, and interpolation between the samples of the signal. The unit is None if it is unknown.
    """

    topic: str
    type: str
    messages: int
    rate: float
    longest_gap: float
    signal: str | None = None
    role: str | None = None
    unit: str | None = None
    hold: str | None = None


@dataclass(frozen=True)
class Event:
    """One event of a log: time since the start of the log [s], kind and text."""

    t: float
    kind: str
    text: str


@dataclass(frozen=True)
class ArmedInterval:
    """Interval of time in which an autopilot was armed.

    Attributes
    ----------
    device
        Name of the autopilot.
    begin, end
        Times since the first sample of the log [s], from which ``--from`` and ``--to`` of `seatrial ident` count.
    """

    device: str
    begin: float
    end: float


@dataclass(frozen=True)
class LogContent:
    """Content of a log, as `seatrial info` shows it; `--json` prints these fields.

    Attributes
    ----------
    format
        Version of this document.
    path
        File of the log, or its first segment.
    bytes
        Size of all its segments.
    segments
        Number of segments.
    complete
        Whether the log was closed.
    start
        Time of the first message [s since 1970]; NaN without messages.
    duration
        Time from the first message to the last [s]; NaN without messages.
    samples, messages
        Number of samples, and of all messages.
    first_segment
        File with the begin of the log if `path` is a later segment; otherwise None.
    metadata
        Metadata by name; None if a text is empty.
    attachments
        Size [bytes] of each attachment by name.
    topics
        Topics, in the order of the log.
    ports
        Last counters of the port of each device, by device.
    armed
        Intervals of time in which autopilots were armed.
    events
        All events, in the order of the file.
    warnings
        Faults of the log.
    import_command
        Command that begins the import of a bag of ROS, by guessing its import map; None for other logs.
    """

    format: str
    path: str
    bytes: int
    segments: int
    complete: bool
    start: float
    duration: float
    samples: int
    messages: int
    first_segment: str | None
    metadata: Mapping[str, str | None]
    attachments: Mapping[str, int]
    topics: Sequence[TopicContent]
    ports: Mapping[str, PortHealth]
    armed: Sequence[ArmedInterval]
    events: Sequence[Event]
    warnings: Sequence[str]
    import_command: str | None = None


def log_content(log: Log) -> LogContent:
    """Return the content of a log: duration, metadata, topics with rates, port counters, events and warnings.

    The warnings include times that ran back on a topic, and the reason if the events cannot be read.
    """
    steps = [
        f"{topic}: its times ran back {counted(n, 'time')}, by up to {longest:.1f} s: a clock was set, or there are "
        "two clocks; import the data of each clock separately"
        for topic, (n, longest) in log.clock_steps.items()
    ]
    events, armed, unreadable = [], [], []
    try:
        events = [Event(t - log.start, kind, text) for t, kind, text in log.events()]
        armed = _armed(log)
    except SeatrialError as error:
        unreadable = [str(error)]
    first = first_segment_of(log.path) if log.metadata.get("segment", "0") != "0" else None
    types = log.types()
    bag = None if log.metadata.get("format") else bag_of_ros(log.path)
    return LogContent(
        "seatrial-info 1",
        str(log.path),
        sum(path.stat().st_size for path in log.paths),
        len(log.paths),
        log.complete,
        log.start if log.counts else math.nan,
        log.duration if log.counts else math.nan,
        sum(log.counts[topic] for topic, kind in types.items() if kind in schema.SAMPLE_TYPES) if log.counts else 0,
        sum(log.counts.values()),
        None if first is None else first.name,
        {name: text or None for name, text in log.metadata.items()},
        {name: len(data) for name, data in log.attachments.items()},
        _topics(log) if log.counts else (),
        {device: log.health(device)[-1][1] for device in log.sources(PortHealth)},
        armed,
        events,
        [*unreadable, *steps, *log.warnings],
        None if bag is None else _import_command(bag),
    )


def bag_content(path: Path, receipts: Mapping[tuple[str, str], Array], remark: str) -> LogContent:
    """Return the content of a bag of ROS that is no MCAP file: duration, and topics with rates.

    Parameters
    ----------
    path
        File or folder of the bag.
    receipts
        Times of receipt of the messages (n,) [s since 1970], by topic and type.
    remark
        What was repaired or is missing; "" for a whole bag.
    """
    files = [file for file in path.rglob("*") if file.is_file()] if path.is_dir() else [path]
    every = np.concatenate([np.empty(0), *receipts.values()])
    topics = []
    for (topic, kind), t in receipts.items():
        intervals = np.diff(np.sort(t))
        span = float(intervals.sum())
        rate, gap = ((t.size - 1) / span, float(intervals.max())) if span > 0 else (math.nan, math.nan)
        topics.append(TopicContent(topic, kind, t.size, rate, gap))
    return LogContent(
        "seatrial-info 1",
        str(path),
        sum(file.stat().st_size for file in files),
        sum(file.name != "metadata.yaml" for file in files),
        not remark,
        float(every.min()) if every.size else math.nan,
        float(np.ptp(every)) if every.size else math.nan,
        0,
        every.size,
        None,
        {},
        {},
        topics,
        {},
        [],
        [],
        [remark] if remark else [],
        _import_command(path),
    )


def _import_command(bag: Path) -> str:
    """Return the command that guesses the import map of a bag of ROS."""
    return f"seatrial import --guess {shlex.quote(str(bag))}"


def _armed(log: Log) -> list[ArmedInterval]:
    """Return the intervals in which the autopilots of a log were armed, after the first sample that a fit can use."""
    found = [(device, *interval) for device, intervals in armed_intervals(log).items() for interval in intervals]
    first = first_sample(log) if found else 0.0
    return [ArmedInterval(name, max(begin - first, 0.0), end - first) for name, begin, end in found if end > first]


def _topics(log: Log) -> list[TopicContent]:
    """Return the content of each topic of a log, in the order of the log."""
    signals = {f"/signal/{name}": name for name in log.sources(Scalar)}
    found = []
    for topic, type_name in log.types().items():
        rate, gap = log.rate_and_gap(topic)
        row = TopicContent(topic, type_name, log.counts[topic], rate, gap)
        if topic in signals:
            name = signals[topic]
            row = replace(row, signal=name, role=log.role(name), unit=log.unit(name) or None, hold=log.hold(name))
        found.append(row)
    return found


def show_log(content: LogContent, console: Console) -> None:
    """Print the content of a log: duration, metadata, topics with rates, port counters, events and warnings.

    If the log is a later segment, a line names the first segment. A log without messages has no topics. Metadata are
    shown only if they are in the table _ABOUT, and the clock speed only if it is not 1.
    """
    pieces = f" in {content.segments} segments" if content.segments > 1 else ""
    state = "complete" if content.complete else "cut off, or still being written"
    console.print(f"[bold]{escape(content.path)}[/]  {_size_text(content.bytes)}{pieces}, {state}")
    if content.messages:
        begin = datetime.fromtimestamp(content.start, UTC).isoformat(sep=" ", timespec="milliseconds")
        samples = "" if content.import_command else f"{counted(content.samples, 'sample')} in "
        counts = f"{samples}{counted(content.messages, 'message')}"
        console.print(f"from {begin}, {content.duration:.3f} s, {counts}")
    else:
        console.print("no messages")
    if content.first_segment:
        number = escape(content.metadata["segment"] or "")
        console.print(f"  segment {number} of {escape(content.first_segment)}; open that file for the whole log")
    for key, words in _ABOUT.items():
        text = content.metadata.get(key)
        if text and (key, text) != ("speed", "1.0"):
            console.print(f"  {words}: {escape(text)}")
    for name, size in content.attachments.items():
        console.print(f"  attached: {escape(name)} ({counted(size, 'byte')})")
    if content.topics:
        print_table(console, _topic_table(content.topics, console.width))
    if content.ports:
        for device, port in content.ports.items():
            console.print(f"  port of {escape(device)}: {escape(port.port)}", soft_wrap=True)
        print_table(console, _port_table(content.ports, console.width))
    for row in content.armed:
        console.print(
            f"  armed: {escape(row.device)}, {row.end - row.begin:.1f} s: --from {row.begin:.1f} --to {row.end:.1f} "
            "(seatrial ident)"
        )
    _print_events(content.events, console)
    for warning in content.warnings:
        console.print(f"[bold]warning:[/] {escape(warning)}")
    if content.import_command:
        command = escape(content.import_command)
        console.print(f"a bag of ROS; `{command}` guesses the map that imports its topics as a log", soft_wrap=True)


def _narrow_table(first: Sequence[str], numbers: Sequence[str], width: int) -> Table:
    """Return an empty table with heads of texts, and of numbers, which are broken at "|" in a narrow console.

    `width` is the number of columns of the console. Below 120, columns are set close to each other.
    """
    narrow = width < WIDE
    table = Table(*first, box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 0 if narrow else 1, 0, 0))
    for head in numbers:
        lines = head.split("|") if narrow else [head.replace("-|", "").replace("|", " ")]
        # Without `escape` the console takes [s] as markup.
        table.add_column(escape("\n".join(lines)), justify="right", min_width=max(map(len, lines)))
    return table


def _topic_table(topics: Sequence[TopicContent], width: int) -> Table:
    """Return a table of the topics of a log: types, numbers of messages, mean rates [Hz] and longest gaps [s].

    The package of seatrial's own types is left out. An unknown rate or gap is "-". If the log has imported signals,
    there is a column with their role (input or output), unit and hold (interpolation between samples). `width` is that
    of the console.
    """
    with_signals = any(row.signal for row in topics)
    table = _narrow_table(("topic", "type"), ("messages", "rate|[Hz]", "longest|gap [s]"), width)
    if with_signals:
        table.add_column("")
    for row in topics:
        note = f"{row.role} [{row.unit or ''}], hold {row.hold}" if row.signal else ""
        numbers = (str(row.messages), _number_text(row.rate, 2), _number_text(row.longest_gap, 4))
        kind = row.type.removeprefix(OWN_TYPES)
        table.add_row(escape(row.topic), escape(kind), *numbers, *[escape(note)] * with_signals)
    return table


def _port_table(ports: Mapping[str, PortHealth], width: int) -> Table:
    """Return a table of the last counters of the port of each device: bytes, frames, errors and delay [ms].

    The delay of the samples is mean ± standard deviation; it is "-" for a device without a clock. The addresses of the
    ports are not in it, so that it fits into 80 columns. `width` is that of the console.
    """
    heads = ("bytes|in", "frames", "checksum|errors", "unparsed|bytes", "dropped", "recon-|nects", "delay|[ms]")
    table = _narrow_table(("device",), heads, width)
    for device, last in ports.items():
        counters = (
            last.bytes_in,
            last.frames,
            last.checksum_errors,
            last.unparsed_bytes,
            last.dropped,
            last.reconnects,
        )
        delay = "-"
        if math.isfinite(last.clock_bias):
            delay = f"{last.clock_bias * 1e3:.2f} ± {_number_text(last.clock_spread * 1e3, 2)}"
        table.add_row(escape(device), *(str(counter) for counter in counters), delay)
    return table


def _print_events(events: Sequence[Event], console: Console) -> None:
    """Print the first 25 and the last 15 events of a log, with their times since its start [s].

    Successive events of a kind that often repeats count as one. The number of events between is printed.
    """
    lines = _with_repeats_joined(events)
    left_out = max(len(lines) - FIRST_EVENTS - LAST_EVENTS, 0)
    for k, event in enumerate(lines):
        if k == FIRST_EVENTS and left_out:
            console.print(f"       ... {counted(left_out, 'event')} left out; `seatrial export csv` writes all of them")
        if k < FIRST_EVENTS or k >= FIRST_EVENTS + left_out:
            console.print(f"{event.t:10.3f} s  [bold]{escape(event.kind)}[/]  {escape(event.text)}")


def _with_repeats_joined(events: Sequence[Event]) -> list[Event]:
    """Join consecutive events of kinds that often repeat ("skipped", "parameter") to one that states their number.

    Events of other kinds are unchanged.
    """
    lines: list[Event] = []
    for kind, group in groupby(events, key=lambda event: event.kind):
        first, *more = group
        if kind not in FOLDED or not more:
            lines += [first, *more]
            continue
        rest = f" (and {len(more)} more until {more[-1].t - first.t:.3f} s later)"
        lines.append(replace(first, text=first.text + rest))
    return lines


def _size_text(n_bytes: int) -> str:
    """Return the size of a log [bytes] as a text in MB (1e6 bytes), or in kB below one million bytes."""
    return f"{n_bytes / 1e6:.2f} MB" if n_bytes >= 1e6 else f"{n_bytes / 1e3:.1f} kB"


def _number_text(value: float, digits: int) -> str:
    """Return a rate, gap or delay of a log as a text with `digits` digits behind the point; "-" for NaN."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"
