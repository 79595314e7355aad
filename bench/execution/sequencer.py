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
    """Interface of the receiver of a sequencer's set-points and events.

    The receiver is the runner of a mission. The runner asks the safety guard before a set-point is sent.
    """

    def schedule(self, rows: Sequence[Row]) -> None:
        """Append set-points to those that will be sent at their times.

        ``rows`` are pairs of run time [s] and n_cmd by name of the thruster.
        """

    def zero(self, reason: str) -> None:
        """Command zero to all thrusters at once, and discard set-points that are not yet due. Log the ``reason``."""

    def mark(self, kind: str, text: str) -> None:
        """Write an event to the log: its kind, a word such as "segment", and its text in one line."""


class MissionSequencer:
    """Sequencer of one mission: it sends the set-points in time, and handles pauses, marks and repeated steps.

    A step is one execution of a segment of the mission. The runner calls the method `step` with every new status.

    Attributes
    ----------
    timeline : Schedule
        Run times of the mission's set-points and segments.
    commanded : int
        Number of set-points that were given to the receiver so far; a set-point for two thrusters counts as two.
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
        """Prepare the schedule of a mission. Nothing is sent yet.

        Parameters
        ----------
        mission : Mission
            The mission.
        start : float
            Run time [s] of the mission's time 0.
        lead : float
            Run seconds from the decision to repeat a step, or to resume after a pause, to its first set-point.
        acquisition : EventSink
            Receiver of set-points and events.
        patience : Callable
            Function of the name of a device that returns how long [run s] the device may be silent in a run.
        say : Callable
            Function that prints a line for the operator.
        retries : int
            Largest number of repetitions, in all, of steps whose data are invalid (for example lost samples).
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
        """Name of the present segment of the mission.

        It is empty before the first segment, and from a restart of a segment to its new beginning.
        """
        return "" if self._step is None else self._step.name

    @property
    def paused(self) -> bool:
        """Whether the operator has paused the mission at zero thrust."""
        return self._paused_at is not None

    def elapsed(self, now: float) -> float:
        """Return the mission's own time [run s] at run time ``now`` [s]. It does not advance during a pause.

        It is negative before the mission starts.
        """
        return self.timeline.elapsed(now if self._paused_at is None else self._paused_at)

    def is_over(self, now: float) -> bool:
        """Return whether the mission has been run to its end at run time ``now`` [s]; False during a pause."""
        return not self.paused and now >= self.timeline.end

    def must_repeat(self, now: float, status: Status) -> bool:
        """Check the last segment when the mission has ended, and return whether the mission goes on to repeat it.

        ``now`` is the run time [s], and ``status`` the newest status of the acquisition. The segment is scheduled again
        if its data are invalid (lost set-points, samples or ports, or a silent device) and repetitions are left;
        without a repetition the log gets an event "invalid". The method also returns True if the mission has not ended.
        """
        self._enter_step(now, status)
        return not self.is_over(now)

    def step(self, now: float, ahead: float, status: Status, keys: str = "") -> None:
        """Act on pressed keys and on the status, then send the set-points that are due soon.

        During a pause only keys are handled. When a segment ends in which data were lost or a device was silent, it is
        repeated, or marked as invalid in the log if no repetition is left.

        Parameters
        ----------
        now : float
            Run time [s].
        ahead : float
            Set-points before run time ``now + ahead`` are sent [run s].
        status : Status
            Newest status of the acquisition.
        keys : str
            Keys that the operator has pressed, as characters in their order.
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
        """Act on a key of the operator at run time ``now`` [s], with a message and an event in the log.

        Space and `p` pause the mission at zero thrust; in a pause they resume it with the beginning of the present
        segment. `r` repeats the present segment; in a pause it is ignored. `m` marks the log. Other keys are ignored.
        """
        step = self._step or self._restarted
        name = "" if step is None else step.name
        if key in " p" and not self.paused:
            self._paused_at = now
            self._acquisition.zero("pause")
            self._acquisition.mark("pause", name)
            self._say("paused: zero thrust is commanded; press space to resume at the beginning of the step")
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
        """Schedule the mission again from the beginning of the segment entered last, or from its start without one.

        The segment entered last may have ended already. `_enter_step` checks a segment when the next one has started or
        the mission has ended. If its data are invalid and repetitions are left, `_enter_step` calls this method instead
        of entering the next segment. The first set-point is due at run time ``now + lead`` [s]; `lead` is an argument
        of the constructor. No segment is entered before that time. If this method is called again before that time, it
        restarts the same segment. Thrust must be zero when it is called.
        """
        if self._step is not None:
            self._restarted = self._step
        self.timeline.restart(0 if self._restarted is None else self._restarted.segment, now + self._lead)
        self._step = None

    def _note_silent_device(self, status: Status) -> None:
        """Store the first device that is silent for too long in the present segment, so that its data are invalid.

        Too long is more than half of the time after which the silence would end the run.
        """
        for name, port in status.ports.items():
            if not self._silence and not port.age <= GAP_PART * self._patience(name):
                self._silence = f"{name} was silent for {port.age:.1f} s"

    def _enter_step(self, now: float, status: Status) -> None:
        """At run time ``now`` [s], if a segment has started or the mission has ended, check the previous segment.

        If its data are invalid (losses, or a silent device) and repetitions are left, it is scheduled again. Without a
        repetition the log gets an event "invalid". For a segment that has started the log gets an event "segment".
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
        """Return why the data of the segment that has just ended are invalid; empty if they are valid.

        Reasons are lost set-points, samples or ports, and a device that was silent for too long.
        """
        return describe_losses(self._counts_at_start, _loss_counts(status)) or self._silence


def describe_losses(before: tuple[int, ...], after: tuple[int, ...]) -> str:
    """Return what was lost in a segment in words, such as "2 set-points were skipped"; empty if nothing was lost.

    If there are losses of several kinds, the first kind is named: set-points, samples, ports.

    Parameters
    ----------
    before, after : tuple of int
        Numbers of skipped set-points, dropped samples and lost ports since the start of the acquisition, at the start
        and at the end of the segment.
    """
    words = (("set-point", "skipped"), ("sample", "dropped"), ("port", "lost"))
    for earlier, later, (noun, verb) in zip(before, after, words, strict=True):
        if later > earlier:
            return f"{counted(later - earlier, noun)} {'was' if later - earlier == 1 else 'were'} {verb}"
    return ""


def _loss_counts(status: Status) -> tuple[int, ...]:
    """Return the numbers of skipped set-points, dropped samples and lost ports since the start of the acquisition.

    Samples and ports of all devices are counted together. A lost port counts when it is opened again.
    """
    ports = status.ports.values()
    return status.skipped, sum(port.dropped for port in ports), sum(port.reconnects for port in ports)


FOLLOW = "follow"  # name of the mission and of its segment while external commands are followed


def follow_plan(rig: Rig, seconds: float, n_max: float | None, slew: float) -> Mission:
    """Return a mission in which commands of a ROS 2 node drive all thrusters of a rig, within limits.

    It has one segment with the command zero, which the commands of the node replace.

    Parameters
    ----------
    rig : Rig
        The rig. Its file must have `commands = true` in [ros2].
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
    """Interface of a source of external commands, to which the samples of a run are passed on.

    It is implemented by the ROS 2 node (seatrial.daq.tools.Ros2Node).
    """

    def put(self, samples: Sequence[StreamedSample], dropped: int) -> None:
        """Pass new samples of the log to the source, which publishes them, and the number of samples dropped so far.

        The method never waits.
        """

    def take(self) -> Mapping[str, Sequence[ReceivedCommand]]:
        """Return the commands that were received since the last call, by name of the thruster, oldest first.

        A thruster without a new command has an empty sequence or is missing. The method never waits.
        """


class CommandFollower(MissionSequencer):
    """Sequencer that sends external commands to the thrusters, within the mission's `n_max` and slew limit.

    Notes
    -----
    If one thruster gets no new command for a time-out, zero is commanded to all thrusters. At the start, and after each
    such silence, pause or key `r`, commands are followed only once the external sender has sent zero for every thruster
    (newest commands of at most 0.02), as with a transmitter.

    The run ends after an invalid command, a command beyond `n_max`, a command without a complete attachment (the
    metadata with sequence number, time and id of its publisher), a repeated command or one out of order, a second
    sender within the time-out, and too many commands at once. This is also checked during a pause.
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
            Mission that gives the names of the thrusters, the largest command, the slew limit and the length. Its
            set-points are not sent.
        start : float
            Run time [s] of the start.
        timeout : float
            Run seconds without a new command for a thruster after which zero is commanded to all thrusters.
        acquisition : EventSink
            Receiver of set-points and events.
        say : Callable
            Function that prints a line for the operator.
        source : CommandSource
            Source of the commands. Commands that it has received before are discarded.
        """
        super().__init__(mission, start, 0.0, acquisition, lambda device: math.inf, say)
        self._mission, self._timeout, self._source = mission, timeout, source
        source.take()  # discard commands from before the devices were ready
        self._follows, self._stepped = False, start
        self._heard: dict[str, tuple[float, ReceivedCommand]] = {}  # by thruster: run time and newest command
        self._scheduled_n = dict.fromkeys(mission.thrusters, 0.0)  # set-points that were scheduled last

    def must_repeat(self, now: float, status: Status) -> bool:
        """Return False always: with external commands no segment can be repeated. The parameters are not used."""
        return False

    @property
    def segment(self) -> str:
        """State for the display: "follow" while external commands are followed, else "waiting for zero"."""
        return FOLLOW if self._follows else "waiting for zero"

    def step(self, now: float, ahead: float, status: Status, keys: str = "") -> None:
        """Take the new external commands, check them, and schedule the resulting set-points within the slew limit.

        If commands are followed and a thruster has had none for the time-out, zero is scheduled on all thrusters, also
        during a pause. Otherwise nothing is scheduled during a pause, while a thruster has had no command for the
        time-out, and before the newest external commands for all thrusters are zero (at most 0.02). Commands are
        checked in all these cases.

        Parameters
        ----------
        now : float
            Run time [s].
        ahead, status
            They are not used.
        keys : str
            Keys that the operator has pressed, as characters in their order.

        Raises
        ------
        SafetyStop
            If a command is invalid, beyond `n_max`, without an identified sender, repeated, out of order or of a second
            sender, or if 512 or more commands for one thruster have arrived at once.
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
                    f"the commands for thruster {name} come too fast: {len(received)} at once; let the ROS 2 node that "
                    "publishes them send 20 to 100 a second"
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
        """Return the names of the thrusters that had no external command within the time-out before run time ``now``.

        A thruster without any command is among them.
        """
        return [name for name in self._mission.thrusters if not self._command_age(name, now) <= self._timeout]

    def _accept_command(self, name: str, command: ReceivedCommand, now: float) -> None:
        """Check an external command for the thruster ``name``, and store it as the newest, with run time ``now`` [s].

        Another sender may take over only after the time-out without a command for this thruster. Raises SafetyStop if
        the command is NaN, beyond the mission's `n_max`, without an id of its sender, of a second sender, repeated, or
        out of order (its sequence number is not above that of the sender's command before for this thruster).
        """
        if not abs(command.n) <= self._mission.n_max:  # written with `not`, so that NaN is refused too
            limit = f"{self._mission.n_max:g}"
            raise SafetyStop(
                f"a ROS 2 node sent the command n = {command.n:g} for thruster {name}, outside -{limit} to {limit}; "
                "correct the node, or give a larger --n-max"
            )
        if not command.sender:
            raise SafetyStop(
                f"a command for thruster {name} lacks sequence number, time or id of its publisher, so that the "
                "publisher is not known; publish it from a ROS 2 node with rmw_zenoh"
            )
        before = self._heard.get(name)
        if before is not None and before[1].sender != command.sender:
            # After a silence another sender may take over. It also has to begin with zero.
            if now - before[0] <= self._timeout:
                raise SafetyStop(f"two ROS 2 nodes send commands to thruster {name}; stop one of them")
        elif before is not None and command.number <= before[1].number:
            raise SafetyStop(
                f"command number {command.number} for thruster {name} came after number {before[1].number}: it is "
                "repeated or out of order; publish each command once (no replayed bag, no second relay)"
            )
        self._heard[name] = now, command

    def _command_age(self, name: str, now: float) -> float:
        """Return the time [run s] from the newest external command for the thruster ``name`` to run time ``now`` [s].

        It is infinite without a command.
        """
        return now - self._heard[name][0] if name in self._heard else math.inf

    def _schedule_if_changed(self, now: float, n: dict[str, float]) -> None:
        """Schedule the set-points ``n``, by thruster, at run time ``now`` [s].

        Nothing is scheduled if they are equal to those that were scheduled last.
        """
        if n != self._scheduled_n:
            self._scheduled_n = n
            self._acquisition.schedule([(now, n)])
            self.commanded += len(n)

    def _stop_following(self, why: str) -> None:
        """Schedule zero on all thrusters, and follow no external command until the sender has sent zero for all.

        Zero is a newest command of at most 0.02. ``why`` is the reason, which is logged and printed. Nothing is done if
        no commands are followed at present.
        """
        # Zero is sent as a set-point and not as `zero`, which would end a stop by the acquisition process itself.
        if self._follows:
            self._follows = False
            self._schedule_if_changed(self._stepped, dict.fromkeys(self._scheduled_n, 0.0))
            self._acquisition.mark("silence", why)
            self._say(f"zero thrust is commanded: {why}; to continue, publish the command 0 for every thruster")

    def _restart_step(self, now: float) -> None:
        """Forget all external commands, and follow none until the external sender has sent zero for every thruster.

        Zero is a newest command of at most 0.02. Senders and sequence numbers are forgotten too, so that another sender
        may begin at once. This method is called after a pause or the key `r`, when thrust is zero. ``now`` is not used.
        """
        self._follows, self._heard = False, {}
        self._scheduled_n = dict.fromkeys(self._scheduled_n, 0.0)


class ScheduledSegment(NamedTuple):
    """Segment of a mission with the run times of its execution.

    Attributes
    ----------
    begin, end : float
        Run times [s] of its beginning and its end.
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
    """Schedule of a mission: the run times of its set-points and segments. It can be restarted at any segment.

    Each scheduled set-point is returned once.
    """

    def __init__(self, mission: Mission, start: float) -> None:
        """Schedule the whole mission. The mission's time 0 is run time ``start`` [s]."""
        self._mission = mission
        self._executed: list[ScheduledSegment] = []
        self._schedule_from(0, start)

    def _schedule_from(self, segment: int, start: float) -> None:
        """Schedule the segments of the mission from index ``segment`` on, and discard the set-points scheduled before.

        Run time ``start`` [s] becomes the mission's time 0 and may be in the past. The segments keep their mission
        times: one from mission time 20 s on begins at ``start + 20``, also if the segments before it are left out.
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
        """Schedule the mission again from its segment with index ``segment``, which begins at run time ``start`` [s].

        Zero thrust must have been commanded before, because the slew limit starts from zero.
        """
        self._executed += [span for span in self._planned if span.segment < segment]
        self._schedule_from(segment, start - float(self._mission.segments[segment].t[0]))

    @property
    def end(self) -> float:
        """Run time [s] of the end of the mission, by the present schedule."""
        return self._planned[-1].end

    def rows(self, until: float) -> list[Row]:
        """Return the set-points before run time ``until`` [s] that were not returned since the last restart.

        Each is a pair of run time [s] and n_cmd by thruster. The list is empty if there is no new one.
        """
        rows: list[Row] = []
        while self._sent < len(self._t) and self._t[self._sent] < until:
            values = dict(zip(self._mission.thrusters, self._scheduled_n[self._sent].tolist(), strict=True))
            rows.append((float(self._t[self._sent]), values))
            self._sent += 1
        return rows

    def started(self, now: float) -> list[ScheduledSegment]:
        """Return the segments, since the start or the last restart, that have started by run time ``now`` [s].

        They are in the order of time. The list is empty before the first one.
        """
        return [span for span in self._planned if span.begin <= now]

    def elapsed(self, now: float) -> float:
        """Return the mission's own time [run s] at run time ``now`` [s]: the time since its scheduled time 0.

        It is negative before time 0.
        """
        return now - self._start

    def static_windows(self) -> list[tuple[str, float, float]]:
        """Return the intervals at rest at the start and at the end of the mission, by their executed run times.

        Load cells are tared in them. Each is ("start" or "end", begin, end), with run times [s]. An interval is missing
        if the mission does not rest there; a mission of one segment has none at the end. The last one begins 3 s after
        zero thrust, when the water has calmed, or in the middle of a last segment of less than 6 s.
        """
        return windows_of([(span.begin, span.end, span.name) for span in [*self._executed, *self._planned]])
