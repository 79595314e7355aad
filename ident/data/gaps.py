"""Gaps of a log: long times without a sample of any sensor, and the parts of the log between them.

A filter would cross a gap step by step. A gap of a day would cost minutes and gigabytes, and after it the states would
be as uncertain as at the start of a log. A log is therefore cut at its gaps, and its parts are used as separate runs.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from seatrial.daq.checks import supply_signals
from seatrial.ident.data.record import ON_CHANGE, Channel, LeftOut
from seatrial.ident.model import COMMAND, SHAFT_SPEED, is_of_thruster
from seatrial.ident.numerics import Array

LONGEST_GAP_S = 60.0  # without a sample of any sensor; the log is cut at longer gaps
USUAL_INTERVALS = 10.0  # a gap must also be longer than so many median intervals, for logs of slow sensors
SHORTEST_PIECE_S = 10.0  # s; a shorter part of a log gives too little information
# Quantities of the thrusters, which may continue while the sensors are off. So may transducers (NMEA XDR).
DRIVES = (COMMAND, SHAFT_SPEED, "servo", "voltage")
TRANSDUCER = "xdr_"


def is_held(name: str, channel: Channel) -> bool:
    """Return whether a signal is an input that keeps its value between samples, instead of a measurement.

    Parameters
    ----------
    name
        Name of the signal. Commands of thrusters (``n_cmd_...``) are held, whatever the hold of the channel is.
    channel
        Samples of the signal. An imported input is held if its hold is ``zero`` or ``average``. A signal with the hold
        ``linear`` or an unknown (empty) hold is not.
    """
    return is_of_thruster(name, COMMAND) or channel.hold not in ("", "linear")


def silent_times(channels: Mapping[str, Channel]) -> list[tuple[float, float]]:
    """Return the gaps of a log: long times without a sample of any sensor.

    Parameters
    ----------
    channels
        The signals of the log by name.

    Returns
    -------
    list
        Start and end [s] of each gap, in order of time. A gap is longer than `LONGEST_GAP_S` (60 s) and than 10 median
        intervals between the samples of all sensors. Empty for a log without gaps or without measurements.

    Notes
    -----
    Commands, shaft speeds, servo outputs and voltages of thrusters, the supply of a bench, transducers (NMEA XDR), and
    imported inputs do not count as sensors. In a log without other signals, for example of a bench, these count after
    all, except commands and other inputs that are held between their samples (`is_held`), since inputs without
    measurements give no information.
    """
    outputs = {name: c for name, c in channels.items() if not is_held(name, c)}
    of_supply = supply_signals(channels)
    sensors = {
        name: c
        for name, c in outputs.items()
        if not (is_of_thruster(name, *DRIVES) or name in of_supply or name.startswith(TRANSDUCER) or c.hold)
    }
    times = [c.t for c in (sensors or outputs).values()]
    if not times:
        return []
    t: Array = np.unique(np.concatenate(times))
    steps = np.diff(t)
    longest = max(LONGEST_GAP_S, USUAL_INTERVALS * float(np.median(steps))) if steps.size else np.inf
    return [(float(t[k]), float(t[k + 1])) for k in np.flatnonzero(steps > longest)]


def parts_between(channels: Mapping[str, Channel], gaps: Sequence[tuple[float, float]]) -> list[dict[str, Channel]]:
    """Cut the signals of a log at its gaps.

    Parameters
    ----------
    channels
        The signals of the log by name.
    gaps
        Start and end [s] of each gap in order of time, as `silent_times` returns them. They are the times of the last
        sample before the gap and of the first one after it, which belong to the parts. Without gaps, there is one part.

    Returns
    -------
    list
        The signals by name of each part before, between and after the gaps: one entry more than gaps. A signal with
        fewer than two samples in a part is left out of it.

    Notes
    -----
    A sample inside a gap is left out. A held input (`is_held`) whose mean sample interval outside the gaps exceeds 1 s
    is logged only when it changes, and holds across the gap. Its last value is the first sample of the next part, at
    the end of the gap. Any other signal is unknown until its first sample after the gap.
    """
    edges = [-np.inf, *(t for gap in gaps for t in gap), np.inf]
    silent = sum(end - begin for begin, end in gaps)
    parts: list[dict[str, Channel]] = []
    for begin, end in zip(edges[::2], edges[1::2], strict=True):
        part: dict[str, Channel] = {}
        for name, c in channels.items():
            # A sample inside a gap belongs to no part, since no sensor has a sample near it.
            a, b = int(np.searchsorted(c.t, begin)), int(np.searchsorted(c.t, end, side="right"))
            cut = slice_channel(c, a, b)
            if a and is_held(name, c) and c.t[-1] - c.t[0] - silent > ON_CHANGE * c.t.size:
                cut = replace(cut, t=np.append(begin, cut.t), value=np.append(c.value[a - 1], cut.value))
            if cut.t.size > 1:
                part[name] = cut
        parts.append(part)
    return parts


def slice_channel(channel: Channel, a: int, b: int) -> Channel:
    """Return the samples ``a`` to ``b - 1`` of a signal, and the removed outliers between the first and last of them.

    Parameters
    ----------
    channel
        The signal.
    a, b
        Index of the first sample, and index after the last sample. The result may have no sample.
    """
    t, left_out = channel.t[a:b], channel.left_out
    if left_out is not None and t.size:
        times = left_out.t + left_out.begin
        inside = (times >= t[0]) & (times <= t[-1])
        left_out = LeftOut(times[inside] - t[0], left_out.value[inside], float(t[0])) if inside.any() else None
    return replace(channel, t=t, value=channel.value[a:b], left_out=left_out)


def gap_line(gaps: Sequence[tuple[float, float]]) -> str:
    """Return the text of the warning about the gaps at which a log is cut. It states the times of the longest gap.

    With several gaps it also states their number. The text has no name of a log.

    Parameters
    ----------
    gaps
        Start and end [s] of each gap, at least one. Of equally long gaps the first is stated.
    """
    begin, end = max(gaps, key=lambda gap: gap[1] - gap[0])
    where = f"no sensor has a sample from {seconds(begin)} to {seconds(end)} s"
    if len(gaps) == 1:
        return f"{where}: the log is cut there, and its parts are used as separate runs"
    return f"the log is cut at {len(gaps)} gaps, and its parts are used as separate runs; in the longest gap {where}"


def seconds(t: float) -> str:
    """Return the time ``t`` [s] as text with at most one decimal, for example ``12.3`` or ``12``.

    Tenths of a second keep the names of parts unique, even in logs of years.
    """
    return f"{round(t, 1) + 0.0:.1f}".removesuffix(".0")  # no "-0"


def clock_of(t: Array, step: float, before: float = 0.0) -> Array:
    """Return equidistant times over the samples of a signal, without its gaps longer than `LONGEST_GAP_S` (60 s).

    Parameters
    ----------
    t
        Times of the samples (n,), never decreasing [s].
    step
        Interval of the returned times [s].
    before
        Time [s] by which the returned times begin before the first sample, and before the first sample after each gap.
        Only gaps longer than 60 s plus this time are then left out.

    Returns
    -------
    Array (m,)
        Times, increasing [s]. Without a gap they are ``step`` apart, from ``t[0] - before`` to the last sample or less
        than one step beyond. Empty without samples.
    """
    if not t.size:
        return t
    last = np.append(np.flatnonzero(np.diff(t) > LONGEST_GAP_S + before), t.size - 1)
    first = np.append(0, last[:-1] + 1)
    return np.concatenate([np.arange(t[a] - before, t[b] + step, step) for a, b in zip(first, last, strict=True)])
