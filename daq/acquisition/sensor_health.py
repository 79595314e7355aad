"""Plausibility checks of the samples of one device, without I/O and without a clock.

The checks find stuck sensors, saturated load cells, spikes, frequent wrong checksums, clocks that jump, and dates of
another GPS era. A message stays the same while its fault lasts, because each new message is written to the log as an
event.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from operator import attrgetter
from typing import Any, NamedTuple

from seatrial.daq.protocol import SATURATED, SPIKE
from seatrial.daq.samples import Frame, Gnss, LoadCell
from seatrial.daq.sensor_limits import FLAGGED_SHARE, STUCK_LIVE, can_be_stuck

SPIKES_S = 10.0  # run s over which spikes are counted
FLOOD_S = 5.0  # run s over which checksum errors are counted
FLOOD_SHARE = 0.05  # part of the frames that may have a wrong checksum
FLOOD_ERRORS = 10  # smallest number of checksum errors that is reported
JUMP_S = 10.0  # run s for which a jump of the clock is reported
ERA = 1024 * 604_800.0  # s; the GPS week number repeats after this time


class _RepeatedSample(NamedTuple):
    """Run of successive samples of one kind of a device that repeat exactly the same values.

    Attributes
    ----------
    key
        Values of the compared fields of these samples; 0 stands for NaN.
    since
        Run time [s] of the receipt of the first sample with these values.
    until
        Run time [s] of the receipt of the last sample with these values.
    repeats
        Number of samples with these values, at least 1.
    """

    key: tuple[float, ...]
    since: float
    until: float
    repeats: int


# A kind of sample, and which of its compared fields are not NaN. An autopilot sends attitudes and accelerations in
# different samples of one kind. Each is compared only with samples that have the same fields.
_SampleForm = tuple[type, tuple[bool, ...]]


def _make_getter(fields: tuple[str, ...]) -> Callable[[Any], tuple[float, ...]]:
    """Return a function of a sample that returns the values of its named fields as a tuple, also for a single field.

    The values are in the order of `fields`.
    """
    get: Callable[[Any], Any] = attrgetter(*fields)
    return get if len(fields) > 1 else lambda sample: (get(sample),)


# These tables are built once, because every sample is compared.
_VALUES = {kind: _make_getter(limit.fields) for kind, limit in STUCK_LIVE.items()}
_WHOLE: dict[type, _SampleForm] = {kind: (kind, (True,) * len(limit.fields)) for kind, limit in STUCK_LIVE.items()}


class SensorHealth:
    """Plausibility checks of the samples and counters of one device. They detect faults of the sensor.

    `take` receives each sample, and `count` the counters after each read. `message` then returns the present fault.
    """

    def __init__(self) -> None:
        """Start the plausibility checks of one device. It has no samples and no fault yet."""
        self._same: dict[_SampleForm, _RepeatedSample] = {}
        self._last = self._now = 0.0
        self._jumps, self._jumped = 0, -math.inf
        self._cell: deque[tuple[float, int]] = deque()  # flags of the last SPIKES_S
        self._spikes = 0
        self._era = 0.0
        self._counters: deque[tuple[float, int, int]] = deque()

    def take(self, frame: Frame) -> None:
        """Check the sample in `frame`: repeated values, spikes of a load cell, or a wrong date of a GNSS receiver.

        Samples whose values may repeat without a fault (`can_be_stuck`) are not checked for repeated values. Nothing is
        returned; `message` reports a fault.
        """
        sample, t = frame.sample, frame.t_rx
        kind = type(sample)
        if kind in _VALUES and can_be_stuck(kind, sample):
            self._count_repeats(kind, _VALUES[kind](sample), t)
        if isinstance(sample, Gnss):
            if math.isfinite(sample.utc):
                self._era = sample.utc - t
        elif isinstance(sample, LoadCell):
            self._count_spikes(t, sample.flags)

    def count(self, t: float, frames: int, errors: int, jumps: int = 0) -> None:
        """Store the counters of a device's decoder and of its clock map, after every read from its port.

        The counters of the decoder are stored at most every 0.5 s, and kept for 5 s (FLOOD_S).

        Parameters
        ----------
        t : float
            Run time [s].
        frames : int
            Valid frames so far.
        errors : int
            Wrong checksums so far.
        jumps : int
            Detected jumps of the device clock so far.
        """
        if jumps != self._jumps:
            self._jumps, self._jumped = jumps, t
        self._now = t
        if not self._counters or t - self._counters[-1][0] >= 0.1 * FLOOD_S:
            self._counters.append((t, frames, errors))
            while t - self._counters[0][0] > FLOOD_S:
                self._counters.popleft()

    @property
    def stuck(self) -> tuple[type, ...]:
        """Classes of samples of the device whose values do not change any more, as those of a dead sensor.

        The compared values and the limits are in STUCK_LIVE (daq/sensor_limits.py): 20 equal samples or more over 5 s
        or more. A class that the device has not sent for 5 s, while it sends others, is left out.
        """
        return tuple(dict.fromkeys(form[0] for form in self._same if self._is_stuck(form)))

    def _is_stuck(self, form: _SampleForm) -> bool:
        """Return whether the samples of a form repeat the same values for too long, as a dead sensor does.

        A form is the class of a sample together with which of its compared fields are not NaN; there must be a sample
        of it. Too long is at least the number of samples and at least the time in STUCK_LIVE, for example 20 attitudes
        and 5 s.
        Return False for a form that the device has not sent for this time, while it has sent others.
        """
        same, limit = self._same[form], STUCK_LIVE[form[0]]
        still_sent = self._last - same.until < limit.seconds
        return still_sent and same.repeats >= limit.samples and same.until - same.since >= limit.seconds

    def message(self) -> str:
        """Return the most severe present fault of the device's samples or counters in one line; empty without a fault.

        The order is: wrong checksums (at least 10 in 5 s, and 1 for 20 valid frames), saturation of the last sample,
        spikes (at least 2 in 10 s, and more than 1 in 100 samples), repeated values, a jump of the clock in the last 10
        s, and a date that differs from the run clock by more than 0.9 GPS eras (of 1024 weeks).
        """
        if self._counters:
            (_, frames_0, errors_0), (_, frames, errors) = self._counters[0], self._counters[-1]
            if errors - errors_0 >= max(FLOOD_ERRORS, FLOOD_SHARE * (frames - frames_0)):
                return "more than 1 frame in 20 has a wrong checksum: check wiring, ground and baud rate"
        if self._cell and self._cell[-1][1] & SATURATED:
            return "saturated: the load is beyond the range of the converter; lower the load or the gain"
        if self._spikes > max(FLAGGED_SHARE * len(self._cell), 1):
            return "spikes in more than 1 of 100 samples: check the wires between load cell and converter"
        if kinds := self.stuck:
            what = "its time does not change" if kinds[0] is Gnss else "the same values all the time"
            return f"stuck: {what}; switch its power off and on"
        if self._now - self._jumped < JUMP_S:
            text = f"its clock has jumped (jump {self._jumps}): it was set, or the device restarted"
            return f"{text}; check its power supply"
        if abs(self._era) > 0.9 * ERA:
            text = "its date is 20 years off: an old receiver (GPS week rollover), or a wrong clock of this computer"
            return f"{text}; update the receiver's firmware, or set the clock"
        return ""

    def _count_repeats(self, kind: type, values: tuple[float, ...], t: float) -> None:
        """Count a sample: whether it repeats exactly the values of the previous sample of its kind.

        `kind` is the class of the sample, `values` are its compared fields, and `t` is its run time [s]. Samples in
        which other fields are NaN are compared and counted separately.
        """
        total = sum(values)
        if total == total:  # the usual case: no value is NaN
            key, form = values, _WHOLE[kind]
        else:
            key = tuple([0.0 if value != value else value for value in values])  # so that NaN equals NaN
            form = kind, tuple([value == value for value in values])
        self._last = t
        before = self._same.get(form)
        if before is None or before.key != key:
            self._same[form] = _RepeatedSample(key, t, t, 1)
        else:
            self._same[form] = _RepeatedSample(key, before.since, t, before.repeats + 1)

    def _count_spikes(self, t: float, flags: int) -> None:
        """Add the flags of a load cell at run time `t` [s], and count the spikes of the last 10 s (`SPIKES_S`).

        `flags` are the bits SATURATED and SPIKE, of which only SPIKE counts here. Older flags are discarded.
        """
        self._cell.append((t, flags))
        self._spikes += bool(flags & SPIKE)
        while t - self._cell[0][0] > SPIKES_S:
            self._spikes -= bool(self._cell.popleft()[1] & SPIKE)
