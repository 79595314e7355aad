"""Plausibility of a device's samples whose frames are valid. No I/O, no clock.

Stuck sensors, saturated and spiking load cells, floods of wrong checksums, clocks that jump,
dates from another GPS era. Each message stays the same while its fault lasts: a new one
goes into the log as an event.
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

SPIKES_S = 10.0
FLOOD_S = 5.0
FLOOD_SHARE = 0.05  # of the frames
FLOOD_ERRORS = 10
JUMP_S = 10.0  # the message stays for so long
ERA = 1024 * 604_800.0  # s, after which the week of GPS begins again


class _Same(NamedTuple):
    """A sample that repeats."""

    key: tuple[float, ...]
    since: float
    until: float
    repeats: int


# A kind of sample, and which of its compared fields it has: an autopilot's attitudes and the accelerations between them
# are compared each with their own.
_Form = tuple[type, tuple[bool, ...]]


def _getter(fields: tuple[str, ...]) -> Callable[[Any], tuple[float, ...]]:
    get: Callable[[Any], Any] = attrgetter(*fields)
    return get if len(fields) > 1 else lambda sample: (get(sample),)


# Every sample is compared: what there is of it to look up is looked up once.
_VALUES = {kind: _getter(limit.fields) for kind, limit in STUCK_LIVE.items()}
_WHOLE: dict[type, _Form] = {kind: (kind, (True,) * len(limit.fields)) for kind, limit in STUCK_LIVE.items()}


class SensorHealth:
    """Checks the samples and counters of one device."""

    def __init__(self) -> None:
        self._same: dict[_Form, _Same] = {}
        self._last = self._now = 0.0
        self._jumps, self._jumped = 0, -math.inf
        self._cell: deque[tuple[float, int]] = deque()  # flags of the last SPIKES_S
        self._spikes = 0
        self._era = 0.0
        self._counters: deque[tuple[float, int, int]] = deque()

    def take(self, frame: Frame) -> None:
        """Take a decoded sample."""
        sample, t = frame.sample, frame.t_rx
        kind = type(sample)
        if kind in _VALUES and can_be_stuck(kind, sample):
            self._repeat(kind, _VALUES[kind](sample), t)
        if isinstance(sample, Gnss):
            if math.isfinite(sample.utc):
                self._era = sample.utc - t
        elif isinstance(sample, LoadCell):
            self._flags(t, sample.flags)

    def count(self, t: float, frames: int, errors: int, jumps: int = 0) -> None:
        """The counters of the decoder and of the clock's map at run time `t`; to be called after every read."""
        if jumps != self._jumps:
            self._jumps, self._jumped = jumps, t
        self._now = t
        if not self._counters or t - self._counters[-1][0] >= 0.1 * FLOOD_S:
            self._counters.append((t, frames, errors))
            while t - self._counters[0][0] > FLOOD_S:
                self._counters.popleft()

    @property
    def stuck(self) -> tuple[type, ...]:
        """The kinds of samples that repeat themselves, as those of a dead sensor do."""
        return tuple(dict.fromkeys(form[0] for form in self._same if self._is_stuck(form)))

    def _is_stuck(self, form: _Form) -> bool:
        same, limit = self._same[form], STUCK_LIVE[form[0]]
        still_sent = self._last - same.until < limit.seconds
        return still_sent and same.repeats >= limit.samples and same.until - same.since >= limit.seconds

    def message(self) -> str:
        """The fault, in one line; empty without one."""
        if self._counters:
            (_, frames_0, errors_0), (_, frames, errors) = self._counters[0], self._counters[-1]
            if errors - errors_0 >= max(FLOOD_ERRORS, FLOOD_SHARE * (frames - frames_0)):
                return "more than 1 frame in 20 has a wrong checksum: look at wiring, ground and baud rate"
        if self._cell and self._cell[-1][1] & SATURATED:
            return "saturated: the load is beyond the range of the converter"
        if self._spikes > max(FLAGGED_SHARE * len(self._cell), 1):
            return "spikes: more than 1 reading in 100; look at the wires between converter and controller"
        if kinds := self.stuck:
            return f"stuck: {'its time does not change' if kinds[0] is Gnss else 'the same values all the time'}"
        if self._now - self._jumped < JUMP_S:
            return f"its clock has jumped (the {self._jumps}. time): it was set, or the device restarted"
        if abs(self._era) > 0.9 * ERA:
            return "its date is 20 years off: a receiver whose GPS week has rolled over, or this computer's clock"
        return ""

    def _repeat(self, kind: type, values: tuple[float, ...], t: float) -> None:
        total = sum(values)
        if total == total:  # none of them is NaN, as mostly
            key, form = values, _WHOLE[kind]
        else:
            key = tuple([0.0 if value != value else value for value in values])  # NaN equals NaN here
            form = kind, tuple([value == value for value in values])
        self._last = t
        before = self._same.get(form)
        if before is None or before.key != key:
            self._same[form] = _Same(key, t, t, 1)
        else:
            self._same[form] = _Same(key, before.since, t, before.repeats + 1)

    def _flags(self, t: float, flags: int) -> None:
        self._cell.append((t, flags))
        self._spikes += bool(flags & SPIKE)
        while t - self._cell[0][0] > SPIKES_S:
            self._spikes -= bool(self._cell.popleft()[1] & SPIKE)
