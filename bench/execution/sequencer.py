"""A mission as a sequence in time: set-points, pauses, marks, and steps repeated on request or because of bad data.

`MissionSequencer` decides, `Schedule` knows where the run is in its mission; `CommandFollower` takes the set-points of
somebody else instead. Run time in, set-points out: nothing here reads a clock.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple, Protocol

import numpy as np

from seatrial.bench.execution.link_test import NEUTRAL
from seatrial.bench.execution.safety_guard import Row
from seatrial.bench.execution.tare import windows_of
from seatrial.daq.acquisition import Status, StreamedSample
from seatrial.daq.config import Mission, Segment
from seatrial.daq.errors import SafetyStop, SeatrialError, counted
from seatrial.daq.rig import Rig
from seatrial.daq.tools import FLOOD, ReceivedCommand

GAP_PART = 0.5  # of the guard's patience: so long a silence spoils a step without ending the run


class EventSink(Protocol):
    """Receiver of set-points and events: the runner, which asks the safety guard first."""

    def schedule(self, rows: Sequence[Row]) -> None:
        """Append set-points."""

    def zero(self, reason: str) -> None:
        """Command zero at once."""

    def mark(self, kind: str, text: str) -> None:
        """Write an event to the log."""


class MissionSequencer:
    """Takes one mission from set-point to set-point; `step` is called with every status."""

    def __init__(
        self,
        mission: Mission,
        start: float,
        lead: float,
        acquisition: EventSink,
        patience: Callable[[str], float],
        say: Callable[[str], None],
        retries: int = 0,
    ) -> None:
        """`lead` [run s] from a decision to the first set-point; `patience` [run s] of the guard by device."""
        self.timeline = Schedule(mission, start)
        self.commanded = 0  # set-points given to the acquisition
        self._paused_at: float | None = None
        self._acquisition, self._lead, self._patience, self._say = acquisition, lead, patience, say
        self._retries = retries
        self._span: ScheduledSegment | None = None
        self._before: tuple[int, ...] = ()
        self._gap = ""
        self._marks = 0

    @property
    def segment(self) -> str:
        """The name of the present step; empty before the first."""
        return "" if self._span is None else self._span.name

    @property
    def paused(self) -> bool:
        """Whether the operator holds the mission at zero thrust."""
        return self._paused_at is not None

    def elapsed(self, now: float) -> float:
        """The mission's own time; it stands still in a pause."""
        return self.timeline.elapsed(now if self._paused_at is None else self._paused_at)

    def is_over(self, now: float) -> bool:
        """Whether the mission has been run to its end."""
        return not self.paused and now >= self.timeline.end

    def must_repeat(self, now: float, status: Status) -> bool:
        """Judge the last step, at the mission's end; whether it is run again."""
        self._enter(now, status)
        return not self.is_over(now)

    def step(self, now: float, ahead: float, status: Status, keys: str = "") -> None:
        """Act on the status and on the keys pressed, then send the set-points up to `now + ahead`."""
        for key in keys:
            self._press(key, now)
        if self.paused:
            return
        self._watch(status)
        self._enter(now, status)
        if rows := self.timeline.rows(now + ahead):
            self._acquisition.schedule(rows)
            self.commanded += sum(len(values) for _, values in rows)

    def _press(self, key: str, now: float) -> None:
        name = "" if self._span is None else self._span.name
        if key in " p" and not self.paused:
            self._paused_at = now
            self._acquisition.zero("pause")
            self._acquisition.mark("pause", name)
            self._say("paused: thrust is zero; space resumes with the step's beginning")
        elif key in " p":
            self._paused_at = None
            self._acquisition.mark("resume", name)
            self._say(f"resumed with the beginning of {name}" if name else "resumed with the beginning")
            self._again(now)
        elif key == "r" and not self.paused:
            self._acquisition.zero("repeat")
            self._acquisition.mark("repeat", name)
            self._say(f"repeating {name}")
            self._again(now)
        elif key == "m":
            self._marks += 1
            self._acquisition.mark("mark", f"operator mark {self._marks}")
            self._say(f"mark {self._marks}")

    def _again(self, now: float) -> None:
        """Take up the present step from its beginning."""
        segment = 0 if self._span is None else self._span.segment
        self.timeline.restart(segment, now + self._lead)
        self._span = None

    def _watch(self, status: Status) -> None:
        """Keep the first sensor that was silent for too long in this step."""
        for name, port in status.ports.items():
            if not self._gap and not port.age <= GAP_PART * self._patience(name):
                self._gap = f"{name} was silent for {port.age:.1f} s"

    def _enter(self, now: float, status: Status) -> None:
        """If a step has started or the mission ended: check the one before, and mark the new one."""
        started, ended = self.timeline.started(now), now >= self.timeline.end
        if self._span is not None and (ended or started[-1] != self._span):
            fault = self._fault(status)
            if fault and self._retries > 0:
                self._retries -= 1
                self._acquisition.zero("retry")
                self._acquisition.mark("retry", f"{self._span.name}: {fault}")
                self._say(f"repeating {self._span.name}: {fault}")
                self._again(now)
                return
            if fault:
                self._acquisition.mark("invalid", f"{self._span.name}: {fault}")
                self._say(f"invalid: {self._span.name}: {fault} (--retry N runs up to N such steps again)")
        last = -1 if self._span is None else self._span.segment
        for span in started:
            if span.segment > last and not ended:
                self._acquisition.mark("segment", span.name)
                self._span, self._before, self._gap = span, _counts(status), ""

    def _fault(self, status: Status) -> str:
        """Why the data of the step that has just ended are invalid; empty when they are valid."""
        return said_of_losses(self._before, _counts(status)) or self._gap


def said_of_losses(before: tuple[int, ...], after: tuple[int, ...]) -> str:
    """What was lost between two counts of set-points skipped, samples dropped and ports lost: the first of them."""
    words = (("set-point", "skipped"), ("sample", "dropped"), ("port", "lost"))
    for earlier, later, (what, how) in zip(before, after, words, strict=True):
        if later > earlier:
            return f"{counted(later - earlier, what)} {'was' if later - earlier == 1 else 'were'} {how}"
    return ""


def _counts(status: Status) -> tuple[int, ...]:
    ports = status.ports.values()
    return status.skipped, sum(port.dropped for port in ports), sum(port.reconnects for port in ports)


FOLLOW = "follow"


def follow_plan(rig: Rig, seconds: float, n_max: float | None, slew: float) -> Mission:
    """A mission without set-points of its own: all thrusters, for so many run seconds, up to `n_max` (by default the
    rig's), changing by `slew` [1/s] at most. Raises SeatrialError where the rig takes no commands."""
    if not rig.ros2.commands:
        raise SeatrialError(f"{rig.path}: nobody may command its thrusters: it has no `commands = true` in [ros2]")
    if not rig.thrusters:
        raise SeatrialError(f"{rig.path}: has no [[thruster]] to command")
    if n_max is not None and n_max > rig.limits.n_max:
        raise SeatrialError(f"{rig.path}: --n-max {n_max:g} is beyond limits.n_max = {rig.limits.n_max:g}")
    names = tuple(thruster.name for thruster in rig.thrusters)
    segment = Segment(FOLLOW, np.zeros(1), np.zeros((1, len(names))))
    limit = rig.limits.n_max if n_max is None else n_max
    return Mission(FOLLOW, "mission", names, (segment,), seconds, limit, slew, "seatrial mission follow")


class CommandSource(Protocol):
    """Whose commands are followed, and who is told the samples (seatrial.daq.tools.Ros2Node)."""

    def put(self, samples: Sequence[StreamedSample], dropped: int) -> None:
        """Samples that were logged; never waits."""

    def take(self) -> Mapping[str, Sequence[ReceivedCommand]]:
        """The commands since the last call by thruster, oldest first; never waits."""


class CommandFollower(MissionSequencer):
    """Follows commands as they come: within the mission's n_max and slew rate, and zero without them.

    As with a transmitter, neutral comes first: at the start and after each silence or pause nothing moves before every
    thruster is commanded zero. These end the run: an invalid command, a command beyond n_max, one without a whole
    attachment, one that is repeated or out of order, a second sender and a flood.
    """

    def __init__(
        self,
        mission: Mission,
        start: float,
        timeout: float,
        acquisition: EventSink,
        say: Callable[[str], None],
        source: CommandSource,
    ) -> None:
        """`timeout` [run s] without a command of a thruster, after which thrust is zero."""
        super().__init__(mission, start, 0.0, acquisition, lambda device: math.inf, say)
        self._mission, self._timeout, self._source = mission, timeout, source
        source.take()  # what came before the devices were ready is old
        self._follows, self._stepped = False, start
        self._heard: dict[str, tuple[float, ReceivedCommand]] = {}  # when, and what, by thruster
        self._n = dict.fromkeys(mission.thrusters, 0.0)  # as scheduled last

    def must_repeat(self, now: float, status: Status) -> bool:
        """Commands of somebody else have no steps to run again."""
        return False

    @property
    def segment(self) -> str:
        """What it does."""
        return FOLLOW if self._follows else "waiting for zero"

    def step(self, now: float, ahead: float, status: Status, keys: str = "") -> None:
        """Take what came, then schedule the set-points of now. Raises SafetyStop."""
        for key in keys:
            self._press(key, now)
        dt, self._stepped = max(now - self._stepped, 0.0), now
        if silent := self._silent(now):  # before what came since: that must not hide the silence before it
            self._stop_following(f"no command for {', '.join(silent)}")
        for name, received in self._source.take().items():
            if len(received) >= FLOOD:
                raise SafetyStop(f"commands for {name} come too fast: {len(received)} at once")
            for command in received:
                self._hear(name, command, now)
        if self.paused or self._silent(now):
            return
        if not self._follows and all(abs(command.n) <= NEUTRAL for _, command in self._heard.values()):
            self._follows = True
            self._acquisition.mark(FOLLOW, "commands are followed from here on")
            self._say("commands are followed")
        if not self._follows:
            return
        most = self._mission.slew_per_s * dt
        wanted = {name: self._heard[name][1].n for name in self._n}
        self._send(now, {name: n + min(max(wanted[name] - n, -most), most) for name, n in self._n.items()})

    def _silent(self, now: float) -> list[str]:
        return [name for name in self._mission.thrusters if not self._age(name, now) <= self._timeout]

    def _hear(self, name: str, command: ReceivedCommand, now: float) -> None:
        if not abs(command.n) <= self._mission.n_max:  # NaN neither
            most = f"{self._mission.n_max:g}"
            raise SafetyStop(f"command n = {command.n:g} for {name}: only -{most} to {most} is followed")
        if not command.sender:
            raise SafetyStop(
                f"a command for {name} has no whole attachment (sequence number, time and id of its publisher), "
                "so that its sender is not known; publish it with rmw_zenoh"
            )
        before = self._heard.get(name)
        if before is not None and before[1].sender != command.sender:
            # After a silence another sender may begin, with zero as the first one had to.
            if now - before[0] <= self._timeout:
                raise SafetyStop(f"two senders command {name}")
        elif before is not None and command.number <= before[1].number:
            raise SafetyStop(
                f"command number {command.number} for {name} came after number {before[1].number}: "
                "it is repeated or out of order"
            )
        self._heard[name] = now, command

    def _age(self, name: str, now: float) -> float:
        return now - self._heard[name][0] if name in self._heard else math.inf

    def _send(self, now: float, n: dict[str, float]) -> None:
        if n != self._n:
            self._n = n
            self._acquisition.schedule([(now, n)])
            self.commanded += len(n)

    def _stop_following(self, why: str) -> None:
        """Zero as a set-point, which a stop of the acquisition's own outlasts: only an operator's zero ends that."""
        if self._follows:
            self._follows = False
            self._send(self._stepped, dict.fromkeys(self._n, 0.0))
            self._acquisition.mark("silence", why)
            self._say(f"thrust is zero: {why}; waiting for zero from every thruster's sender")

    def _again(self, now: float) -> None:
        """After a pause or a repetition, both at zero thrust: neutral first."""
        self._follows, self._heard = False, {}
        self._n = dict.fromkeys(self._n, 0.0)


class ScheduledSegment(NamedTuple):
    """A segment's place on the run clock [s]."""

    begin: float
    end: float
    segment: int
    name: str


class Schedule:
    """A mission on the run clock; it can be taken up again at any of its segments."""

    def __init__(self, mission: Mission, start: float) -> None:
        """The mission's time 0 is run time `start`."""
        self._mission = mission
        self._done: list[ScheduledSegment] = []
        self._lay(0, start)

    def _lay(self, segment: int, start: float) -> None:
        """Lay the segments from this one on, their own time running from `start`."""
        self._start = start
        rest = replace(self._mission, segments=self._mission.segments[segment:])
        t, n = rest.setpoints()  # the slew limit begins at zero again
        self._t, self._n, self._sent = t + start, n, 0
        self._spans = [
            ScheduledSegment(start + a, start + b, segment + k, name) for k, (a, b, name) in enumerate(rest.starts())
        ]

    def restart(self, segment: int, start: float) -> None:
        """Zero was commanded: take the mission up again with the first row of `segment` at `start`."""
        self._done += [span for span in self._spans if span.segment < segment]
        self._lay(segment, start - float(self._mission.segments[segment].t[0]))

    @property
    def end(self) -> float:
        """Run time from which thrust is zero."""
        return self._spans[-1].end

    def rows(self, until: float) -> list[Row]:
        """The set-points before run time `until` that were not asked for before."""
        rows: list[Row] = []
        while self._sent < len(self._t) and self._t[self._sent] < until:
            values = dict(zip(self._mission.thrusters, self._n[self._sent].tolist(), strict=True))
            rows.append((float(self._t[self._sent]), values))
            self._sent += 1
        return rows

    def started(self, now: float) -> list[ScheduledSegment]:
        """The segments that have started since the start or the restart."""
        return [span for span in self._spans if span.begin <= now]

    def elapsed(self, now: float) -> float:
        """The mission's own time at `now`."""
        return now - self._start

    def static_windows(self) -> list[tuple[str, float, float]]:
        """The rest at the start and at the end, as it came to be."""
        return windows_of([(span.begin, span.end, span.name) for span in [*self._done, *self._spans]])
