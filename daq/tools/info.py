"""Content of a log as tables, for `seatrial info`."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from itertools import groupby

from rich import markup
from rich.console import Console
from rich.table import Table

from seatrial.daq.errors import SeatrialError, counted
from seatrial.daq.log import Log, first_segment_of, schema
from seatrial.daq.samples import PortHealth, Scalar

FIRST_EVENTS, LAST_EVENTS = 25, 15  # of many events only these are shown: the last events are about the end of the run
_ABOUT = {  # texts of the metadata that are shown, with their names for the user
    "rig": "rig",
    "operator": "operator",
    "host": "host",
    "git": "git",
    "command_line": "command",
    "speed": "run seconds per wall second",
    "import.map": "import.map",
}
MAX_CHARACTERS = 2000  # characters of a text that are shown; longer texts are not meant for readers
FOLDED = ("skipped", "parameter")  # kinds of events that often repeat; repetitions become one line


def escape(text: str) -> str:
    """Return a text of a log in which the markup of the console (rich) is escaped, so that [bold] is printed unchanged.

    A text of more than 2000 characters is cut off, and the number of its characters is added.
    """
    return markup.escape(
        text if len(text) <= MAX_CHARACTERS else f"{text[:MAX_CHARACTERS]}... ({len(text)} characters)"
    )


def show_log(log: Log, console: Console) -> None:
    """Print the content of a log: duration, metadata, topics with rates, port counters, events and warnings.

    If `log.path` is a later segment of a log whose first segment exists, a line names the first segment. A log without
    messages has no topics.
    Metadata are shown only if they are in the table _ABOUT, and the clock speed only if it is not 1. The warnings
    include times that ran back on a topic.
    """
    size = sum(path.stat().st_size for path in log.paths)
    pieces = f" in {len(log.paths)} segments" if len(log.paths) > 1 else ""
    state = "complete" if log.complete else "cut off, or still being written"
    console.print(f"[bold]{escape(str(log.path))}[/]  {_size_text(size)}{pieces}, {state}")
    if log.counts:
        begin = datetime.fromtimestamp(log.start, UTC).isoformat(sep=" ", timespec="milliseconds")
        n_samples = sum(log.counts[topic] for topic, kind in log.types().items() if kind in schema.SAMPLE_TYPES)
        content = f"{counted(n_samples, 'sample')} in {counted(sum(log.counts.values()), 'message')}"
        console.print(f"from {begin}, {log.duration:.3f} s, {content}")
    else:
        console.print("no messages")
    first = first_segment_of(log.path)
    if first is not None and log.metadata.get("segment", "0") != "0":
        number = escape(log.metadata["segment"])
        console.print(f"  segment {number} of {escape(first.name)}; open that file for the whole log")
    for key, words in _ABOUT.items():
        if log.metadata.get(key) and (key, log.metadata[key]) != ("speed", "1.0"):
            console.print(f"  {words}: {escape(log.metadata[key])}")
    for name, data in log.attachments.items():
        console.print(f"  attached: {escape(name)} ({counted(len(data), 'byte')})")
    if log.counts:
        console.print(_topic_table(log))
    if log.sources(PortHealth):
        console.print(_port_table(log))
    _print_events(log, console)
    steps = [
        f"{topic}: its times ran back {counted(n, 'time')}, by up to {longest:.1f} s: a clock was set, or there are "
        "two clocks; import the data of each clock separately"
        for topic, (n, longest) in log.clock_steps.items()
    ]
    for warning in [*steps, *log.warnings]:
        console.print(f"[bold]warning:[/] {escape(warning)}")


def _topic_table(log: Log) -> Table:
    """Return a table of the topics of a log: types, numbers of messages, mean rates [Hz] and longest gaps [s].

    An unknown rate or gap is "-". If the log has imported signals, there is a column with their role (input or output),
    unit and hold (interpolation between samples).
    """
    signals = {f"/signal/{name}": name for name in log.sources(Scalar)}
    notes = [""] if signals else []
    heads = ("topic", "type", "messages", "rate [Hz]", "longest gap [s]", *notes)
    table = Table(*(escape(head) for head in heads))  # without `escape` the console takes [s] as markup
    for column in table.columns[2:5]:
        column.justify = "right"
    for topic, type_name in log.types().items():
        rate, gap = log.rate_and_gap(topic)
        notes = [""] if signals else []
        if topic in signals:
            name = signals[topic]
            notes = [f"{log.role(name)} [{log.unit(name)}], hold {log.hold(name)}"]
        count = str(log.counts[topic])
        table.add_row(
            escape(topic), escape(type_name), count, _number_text(rate, 2), _number_text(gap, 4), *map(escape, notes)
        )
    return table


def _port_table(log: Log) -> Table:
    """Return a table of the last counters of the port of each device in a log: bytes, frames, errors and delay [ms].

    The delay of the samples is mean ± standard deviation; it is "-" for a device without a clock.
    """
    heads = ("port", "bytes in", "frames", "checksum errors", "unparsed bytes", "dropped", "reconnects", "delay [ms]")
    table = Table("device", *(escape(head) for head in heads))
    for column in table.columns[2:]:
        column.justify = "right"
    for device in log.sources(PortHealth):
        _, last = log.health(device)[-1]
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
        table.add_row(escape(device), escape(last.port), *(str(counter) for counter in counters), delay)
    return table


def _print_events(log: Log, console: Console) -> None:
    """Print the first 25 and the last 15 events of a log, with their times since its start [s].

    Successive events of a kind that often repeats count as one. The number of events between is printed. If the events
    cannot be read, a warning is printed instead.
    """
    try:
        events = log.events()
    except SeatrialError as error:
        console.print(f"[bold]warning:[/] {escape(str(error))}")
        return
    lines = _with_repeats_joined(events)
    left_out = max(len(lines) - FIRST_EVENTS - LAST_EVENTS, 0)
    for k, (t, kind, text) in enumerate(lines):
        if k == FIRST_EVENTS and left_out:
            console.print(f"       ... {counted(left_out, 'event')} left out; `seatrial export csv` writes all of them")
        if k < FIRST_EVENTS or k >= FIRST_EVENTS + left_out:
            console.print(f"{t - log.start:10.3f} s  [bold]{escape(kind)}[/]  {escape(text)}")


def _with_repeats_joined(events: list[tuple[float, str, str]]) -> list[tuple[float, str, str]]:
    """Join consecutive events of kinds that often repeat ("skipped", "parameter") to one that states their number.

    Parameters
    ----------
    events
        Time [s since 1970], kind and text of each event of a log.

    Returns
    -------
    list of tuple
        The events; those of other kinds are unchanged.
    """
    lines: list[tuple[float, str, str]] = []
    for kind, group in groupby(events, key=lambda event: event[1]):
        first, *more = group
        if kind not in FOLDED or not more:
            lines += [first, *more]
            continue
        rest = f" (and {len(more)} more until {more[-1][0] - first[0]:.3f} s later)"
        lines.append((first[0], kind, first[2] + rest))
    return lines


def _size_text(n_bytes: int) -> str:
    """Return the size of a log [bytes] as a text in MB (1e6 bytes), or in kB below one million bytes."""
    return f"{n_bytes / 1e6:.2f} MB" if n_bytes >= 1e6 else f"{n_bytes / 1e3:.1f} kB"


def _number_text(value: float, digits: int) -> str:
    """Return a rate, gap or delay of a log as a text with `digits` digits behind the point; "-" for NaN."""
    return "-" if math.isnan(value) else f"{value:.{digits}f}"
