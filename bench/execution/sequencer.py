"""Sequencers of a mission: they turn run time into set-points and handle pauses, marks and repeated steps.

A step is the execution of one segment of the mission, which may be repeated. `MissionSequencer` sends the set-points of
a mission. `Schedule` contains their run times. `CommandFollower` sends commands of an external source instead. Run time
is an argument: no function here reads a clock.
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

# Fraction of the guard's patience with a device. A longer silence makes a step invalid, but does not end the run.
GAP_PART = 0.5


class EventSink(Protocol):
    """Receiver of set-points and events. It is the runner, which asks the safety guard before it sends a set-point."""

    def schedule(self, rows: Sequence[Row]) -> None:
        """Append set-points, as pairs of run time [s] and n_cmd by thruster."""

    def zero(self, reason: str) -> None:
        """Command zero to all thrusters at once, and discard set-points that are not yet due. Log the ``reason``."""

    def mark(self, kind: str, text: str) -> None:
        """Write an event to the log, with its kind and its text."""


class MissionSequencer:
    """Sequencer of one mission. The runner calls `step` with every new status.

    Attributes
    ----------
    timeline : Schedule
        Run times of the set-points and segments.
    commanded : int
        Number of set-points given to the acquisition so far; a row counts once for each thruster.
    """

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
        """Prepare the schedule of a mission.

        Parameters
        ----------
        mission : Mission
            The mission.
        start : float
            Run time [s] of the mission's time 0.
        lead : float
            Run seconds from a decision to the first set-point.
        acquisition : EventSink
            Receiver of set-points and events.
        patience : Callable
            Returns how long [run s] a device may be silent, by its name.
        say : Callable
            Prints a line for the operator.
        retries : int
            How many invalid steps, in all, are repeated.
        """
        self.timeline = Schedule(mission, start)
        self.commanded = 0
        self._paused_at: float | None = None
        self._acquisition, self._lead, self._patience, self._say = acquisition, lead, patience, say
        self._retries = retries
        self._step: ScheduledSegment | None = None
        self._restarted: ScheduledSegment | None = None  # the step of the last restart; None before the first one
        self._counts_at_start: tuple[int, ...] = ()
        self._silence = ""
        self._marks = 0

    @property
    def segment(self) -> str:
        """Name of the segment of the present step; empty before the first one and after a restart."""
        return "" if self._step is None else self._step.name

    @property
    def paused(self) -> bool:
        """Whether the operator has paused the mission at zero thrust."""
        return self._paused_at is not None

    def elapsed(self, now: float) -> float:
        """Return the mission's own time [run s] at run time `now`. It does not advance during a pause."""
        return self.timeline.elapsed(now if self._paused_at is None else self._paused_at)

    def is_over(self, now: float) -> bool:
        """Return whether the mission has been run to its end at run time ``now`` [s]; False during a pause."""
        return not self.paused and now >= self.timeline.end

    def must_repeat(self, now: float, status: Status) -> bool:
        """Check the last step at the end of the mission. Return whether the mission goes on with a repetition of it.

        ``now`` is the run time [s], and ``status`` the newest status. The step is repeated if its data are invalid and
        retries are left.
        """
        self._enter_step(now, status)
        return not self.is_over(now)

    def step(self, now: float, ahead: float, status: Status, keys: str = "") -> None:
        """Act on the status and on the keys, then send set-points.

        Parameters
        ----------
        now : float
            Run time [s].
        ahead : float
            Set-points are sent up to run time `now + ahead`.
        status : Status
            Newest status of the acquisition.
        keys : str
            Keys that the operator has pressed, as characters.
        """
        for key in keys:
            self._handle_key(key, now)
        if self.paused:
            return
        self._note_silent_device(status)
        self._enter_step(now, status)
        if rows := self.timeline.rows(now + ahead):
            self._acquisition.schedule(rows)
            self.commanded += sum(len(values) for _, values in rows)

    def _handle_key(self, key: str, now: float) -> None:
        """Act on a key at run time ``now`` [s]; other keys are ignored.

        Space and `p` pause the mission at zero thrust, or resume it with the beginning of the step. `r` repeats the
        step, unless the mission is paused. `m` marks the log.
        """
        step = self._step or self._restarted
        name = "" if step is None else step.name
        if key in " p" and not self.paused:
            self._paused_at = now
            self._acquisition.zero("pause")
            self._acquisition.mark("pause", name)
            self._say("paused: thrust is zero; space resumes with the step's beginning")
        elif key in " p":
            self._paused_at = None
            self._acquisition.mark("resume", name)
            self._say(f"resumed with the beginning of {name}" if name else "resumed with the beginning")
            self._restart_step(now)
        elif key == "r" and not self.paused:
            self._acquisition.zero("repeat")
            self._acquisition.mark("repeat", name)
            self._say(f"repeating {name}")
            self._restart_step(now)
        elif key == "m":
            self._marks += 1
            self._acquisition.mark("mark", f"operator mark {self._marks}")
            self._say(f"mark {self._marks}")

    def _restart_step(self, now: float) -> None:
        """Schedule the present step again from its beginning, ``lead`` seconds after run time ``now`` [s].

        Until then there is no present step. A second restart in this time is of the same step.
        """
        if self._step is not None:
            self._restarted = self._step
        self.timeline.restart(0 if self._restarted is None else self._restarted.segment, now + self._lead)
        self._step = None

    def _note_silent_device(self, status: Status) -> None:
        """Note the first device that is silent for too long in the present step. The step then becomes invalid."""
        for name, port in status.ports.items():
            if not self._silence and not port.age <= GAP_PART * self._patience(name):
                self._silence = f"{name} was silent for {port.age:.1f} s"

    def _enter_step(self, now: float, status: Status) -> None:
        """If a step has started or the mission has ended, check the previous step and mark the new one in the log.

        If the data of the previous step are invalid, it is repeated as long as retries are left. Otherwise the log gets
        an event "invalid", and the mission goes on.
        """
        started, ended = self.timeline.started(now), now >= self.timeline.end
        if self._step is not None and (ended or started[-1] != self._step):
            fault = self._step_fault(status)
            if fault and self._retries > 0:
                self._retries -= 1
                self._acquisition.zero("retry")
                self._acquisition.mark("retry", f"{self._step.name}: {fault}")
                self._say(f"repeating {self._step.name}: {fault}")
                self._restart_step(now)
                return
            if fault:
                self._acquisition.mark("invalid", f"{self._step.name}: {fault}")
                self._say(f"invalid: {self._step.name}: {fault} (--retry N runs up to N such steps again)")
        last = -1 if self._step is None else self._step.segment
        for span in started:
            if span.segment > last and not ended:
                self._acquisition.mark("segment", span.name)
                self._step, self._counts_at_start, self._silence = span, _loss_counts(status), ""

    def _step_fault(self, status: Status) -> str:
        """Return why the data of the step that has just ended are invalid: losses or silence; empty if valid."""
        return describe_losses(self._counts_at_start, _loss_counts(status)) or self._silence


def describe_losses(before: tuple[int, ...], after: tuple[int, ...]) -> str:
    """Return the first kind of loss in a step in words, such as "2 set-points were skipped"; empty without a loss.

    Parameters
    ----------
    before, after : tuple of int
        Numbers of skipped set-points, dropped samples and lost ports, at the start and at the end of a step.
    """
    words = (("set-point", "skipped"), ("sample", "dropped"), ("port", "lost"))
    for earlier, later, (noun, verb) in zip(before, after, words, strict=True):
        if later > earlier:
            return f"{counted(later - earlier, noun)} {'was' if later - earlier == 1 else 'were'} {verb}"
    return ""


def _loss_counts(status: Status) -> tuple[int, ...]:
    """Return the numbers of skipped set-points, dropped samples and lost ports since the start of the acquisition."""
    ports = status.ports.values()
    return status.skipped, sum(port.dropped for port in ports), sum(port.reconnects for port in ports)


FOLLOW = "follow"  # name of the mission and of its segment while external commands are followed


def follow_plan(rig: Rig, seconds: float, n_max: float | None, slew: float) -> Mission:
    """Return a mission that lets external commands drive all thrusters of a rig, within limits.

    It has one segment with the command zero, which the external commands replace.

    Parameters
    ----------
    rig : Rig
        The rig. It must allow commands in [ros2].
    seconds : float
        Length of the mission [run s].
    n_max : float or None
        Largest command, as a fraction of full command; `limits.n_max` of the rig if None.
    slew : float
        Largest rate of change of a command [1/s].

    Raises
    ------
    SeatrialError
        If the rig does not allow commands, has no thruster, or has a `limits.n_max` below ``n_max``.
    """
    if not rig.ros2.commands:
        raise SeatrialError(f"{rig.path}: ROS 2 may not command its thrusters: set commands = true in [ros2]")
    if not rig.thrusters:
        raise SeatrialError(f"{rig.path}: the rig has no [[thruster]] that ROS 2 could command; add one")
    if n_max is not None and n_max > rig.limits.n_max:
        raise SeatrialError(
            f"{rig.path}: --n-max {n_max:g} is beyond limits.n_max = {rig.limits.n_max:g}; give a smaller --n-max"
        )
    names = tuple(thruster.name for thruster in rig.thrusters)
    segment = Segment(FOLLOW, np.zeros(1), np.zeros((1, len(names))))
    limit = rig.limits.n_max if n_max is None else n_max
    return Mission(FOLLOW, "mission", names, (segment,), seconds, limit, slew, "seatrial mission follow")


class CommandSource(Protocol):
    """Source of external commands, which also receives the samples (seatrial.daq.tools.Ros2Node)."""

    def put(self, samples: Sequence[StreamedSample], dropped: int) -> None:
        """Pass on logged samples and the number of dropped ones. Never waits."""

    def take(self) -> Mapping[str, Sequence[ReceivedCommand]]:
        """Return the commands since the last call, by thruster and oldest first. Never waits."""


class CommandFollower(MissionSequencer):
    """Sequencer that follows external commands within the mission's `n_max` and slew limit.

    Notes
    -----
    A thruster without a new command for the time-out ends thrust on all thrusters. At the start, and after each silence
    or pause, commands are followed only after every thruster was commanded zero, as with a transmitter.

    The run ends after an invalid command, a command beyond `n_max`, a command without a complete attachment, a repeated
    command or one out of order, a second sender, and too many commands at once.
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
        """Prepare to follow commands.

        Parameters
        ----------
        mission : Mission
            Names of the thrusters, `n_max`, slew limit and length.
        start : float
            Run time [s] of the start.
        timeout : float
            Run seconds without a command for a thruster, after which thrust is zero.
        acquisition : EventSink
            Receiver of set-points and events.
        say : Callable
            Prints a line for the operator.
        source : CommandSource
            Source of the commands.
        """
        super().__init__(mission, start, 0.0, acquisition, lambda device: math.inf, say)
        self._mission, self._timeout, self._source = mission, timeout, source
        source.take()  # discard commands from before the devices were ready
        self._follows, self._stepped = False, start
        self._heard: dict[str, tuple[float, ReceivedCommand]] = {}  # by thruster: run time and newest command
        self._scheduled_n = dict.fromkeys(mission.thrusters, 0.0)  # set-points that were scheduled last

    def must_repeat(self, now: float, status: Status) -> bool:
        """Return False always: external commands have no steps that could be repeated."""
        return False

    @property
    def segment(self) -> str:
        """State for the display: "follow" while commands are followed, else "waiting for zero"."""
        return FOLLOW if self._follows else "waiting for zero"

    def step(self, now: float, ahead: float, status: Status, keys: str = "") -> None:
        """Take the new commands, check them, and schedule the present set-points within the slew limit.

        A silent thruster ends thrust on all thrusters. The parameters are those of `MissionSequencer.step`; ``ahead``
        and ``status`` are not used.

        Raises
        ------
        SafetyStop
            If a command is invalid, beyond `n_max`, repeated, out of order or of a second sender, or if commands come
            too fast.
        """
        for key in keys:
            self._handle_key(key, now)
        dt, self._stepped = max(now - self._stepped, 0.0), now
        # The silence is checked before the new commands are taken, because they would hide it.
        if silent := self._silent_thrusters(now):
            self._stop_following(f"no command for {', '.join(silent)}")
        for name, received in self._source.take().items():
            if len(received) >= FLOOD:
                raise SafetyStop(
                    f"commands for {name} come too fast: {len(received)} at once; let the sender send fewer"
                )
            for command in received:
                self._accept_command(name, command, now)
        if self.paused or self._silent_thrusters(now):
            return
        if not self._follows and all(abs(command.n) <= NEUTRAL for _, command in self._heard.values()):
            self._follows = True
            self._acquisition.mark(FOLLOW, "commands are followed from here on")
            self._say("commands are followed")
        if not self._follows:
            return
        max_change = self._mission.slew_per_s * dt
        commanded = {name: self._heard[name][1].n for name in self._scheduled_n}
        limited = {
            name: n + min(max(commanded[name] - n, -max_change), max_change) for name, n in self._scheduled_n.items()
        }
        self._schedule_if_changed(now, limited)

    def _silent_thrusters(self, now: float) -> list[str]:
        """Return the names of the thrusters without a command within the time-out before run time ``now`` [s]."""
        return [name for name in self._mission.thrusters if not self._command_age(name, now) <= self._timeout]

    def _accept_command(self, name: str, command: ReceivedCommand, now: float) -> None:
        """Check a command for the thruster ``name`` and keep it as its newest one, received at run time ``now`` [s].

        Raises SafetyStop if the command is NaN, beyond `n_max`, without a sender, of a second sender, or out of order.
        """
        if not abs(command.n) <= self._mission.n_max:  # written with `not`, so that NaN is refused too
            limit = f"{self._mission.n_max:g}"
            raise SafetyStop(
                f"command n = {command.n:g} for {name} is outside -{limit} to {limit}; check --n-max and the sender"
            )
        if not command.sender:
            raise SafetyStop(
                f"a command for {name} has no whole attachment (sequence number, time and id of its publisher), "
                "so that its sender is not known; publish it with rmw_zenoh"
            )
        before = self._heard.get(name)
        if before is not None and before[1].sender != command.sender:
            # After a silence another sender may take over. It also has to begin with zero.
            if now - before[0] <= self._timeout:
                raise SafetyStop(f"two ROS 2 nodes send commands to {name}; stop one of them")
        elif before is not None and command.number <= before[1].number:
            raise SafetyStop(
                f"command number {command.number} for {name} came after number {before[1].number}: "
                "it is repeated or out of order"
            )
        self._heard[name] = now, command

    def _command_age(self, name: str, now: float) -> float:
        """Return the time [run s] since the newest command for the thruster ``name``; infinite without one."""
        return now - self._heard[name][0] if name in self._heard else math.inf

    def _schedule_if_changed(self, now: float, n: dict[str, float]) -> None:
        """Schedule the set-points ``n`` by thruster at run time ``now`` [s], if they differ from the last ones."""
        if n != self._scheduled_n:
            self._scheduled_n = n
            self._acquisition.schedule([(now, n)])
            self.commanded += len(n)

    def _stop_following(self, why: str) -> None:
        """Schedule zero on all thrusters and wait for zero commands, if commands are followed; else do nothing.

        ``why`` is the reason for the log and the operator.

        Zero is sent as a set-point and not as `zero`, which would end a stop by the acquisition process itself.
        """
        if self._follows:
            self._follows = False
            self._schedule_if_changed(self._stepped, dict.fromkeys(self._scheduled_n, 0.0))
            self._acquisition.mark("silence", why)
            self._say(f"thrust is zero: {why}; waiting for zero from every thruster's sender")

    def _restart_step(self, now: float) -> None:
        """Forget all commands and wait for zero commands, after a pause or a repetition. Thrust is zero then."""
        self._follows, self._heard = False, {}
        self._scheduled_n = dict.fromkeys(self._scheduled_n, 0.0)


class ScheduledSegment(NamedTuple):
    """A segment of a mission with its run times.

    Attributes
    ----------
    begin, end : float
        Run times of its beginning and end [s].
    segment : int
        Index of the segment in the mission.
    name : str
        Name of the segment.
    """

    begin: float
    end: float
    segment: int
    name: str


class Schedule:
    """Schedule of a mission in run time. It can be restarted at any segment. It returns each set-point once."""

    def __init__(self, mission: Mission, start: float) -> None:
        """Schedule the whole mission. Its time 0 is run time `start` [s]."""
        self._mission = mission
        self._executed: list[ScheduledSegment] = []
        self._schedule_from(0, start)

    def _schedule_from(self, segment: int, start: float) -> None:
        """Schedule the mission from the segment with index `segment` on. Run time `start` [s] is the mission's time 0.

        Set-points that were scheduled before are discarded.
        """
        self._start = start
        rest = replace(self._mission, segments=self._mission.segments[segment:])
        t, n = rest.setpoints()  # the slew limit starts from zero thrust
        self._t, self._scheduled_n, self._sent = t + start, n, 0
        self._planned = [
            ScheduledSegment(start + a, start + b, segment + k, name)
            for k, (a, b, name) in enumerate(rest.segment_times())
        ]

    def restart(self, segment: int, start: float) -> None:
        """Restart the mission at the beginning of the segment with index `segment`, at run time `start` [s].

        Zero thrust must have been commanded before, because the slew limit starts from zero.
        """
        self._executed += [span for span in self._planned if span.segment < segment]
        self._schedule_from(segment, start - float(self._mission.segments[segment].t[0]))

    @property
    def end(self) -> float:
        """Run time [s] of the end of the mission."""
        return self._planned[-1].end

    def rows(self, until: float) -> list[Row]:
        """Return the set-points before run time `until` [s] that were not returned before.

        Each is a pair of run time [s] and n_cmd by thruster.
        """
        rows: list[Row] = []
        while self._sent < len(self._t) and self._t[self._sent] < until:
            values = dict(zip(self._mission.thrusters, self._scheduled_n[self._sent].tolist(), strict=True))
            rows.append((float(self._t[self._sent]), values))
            self._sent += 1
        return rows

    def started(self, now: float) -> list[ScheduledSegment]:
        """Return the segments that have started by run time `now` [s], since the start or the last restart."""
        return [span for span in self._planned if span.begin <= now]

    def elapsed(self, now: float) -> float:
        """Return the mission's own time [run s] at run time `now` [s]: the time since its scheduled time 0."""
        return now - self._start

    def static_windows(self) -> list[tuple[str, float, float]]:
        """Return the rest intervals at the start and at the end of the mission, as they were executed.

        Each is ("start" or "end", begin, end) in run seconds.
        """
        return windows_of([(span.begin, span.end, span.name) for span in [*self._executed, *self._planned]])
