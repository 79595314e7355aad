"""Runner of missions and link tests. Every run ends at zero thrust and with a closed log."""

from __future__ import annotations

import contextlib
import math
import signal
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np

from seatrial.bench.execution.autopilots import LEAVE_S, Autopilots
from seatrial.bench.execution.device_startup import await_devices, await_limits
from seatrial.bench.execution.link_test import (
    HOLD_S,
    MUTED,
    NEUTRAL,
    REST_S,
    SETTLED_S,
    SILENCE_S,
    LinkTest,
    link_test_plan,
    measure_link_loss,
    save_link_tests,
)
from seatrial.bench.execution.operator_interface import HELP, WORDS, Display, Keys, MissionStatus, StopSignals
from seatrial.bench.execution.safety_guard import Rest, Row, SafetyGuard
from seatrial.bench.execution.sequencer import CommandFollower, CommandSource, MissionSequencer, Schedule
from seatrial.bench.execution.tare import Tare, describe_tares, measure_tares
from seatrial.bench.mission_limits import dry_run
from seatrial.daq.acquisition import Acquisition, Source, Status
from seatrial.daq.clock import RunClock, SuspendDetector
from seatrial.daq.config import Mission, dump_mission
from seatrial.daq.errors import SafetyStop, SeatrialError
from seatrial.daq.log import open_log
from seatrial.daq.realtime_priority import realtime_priority
from seatrial.daq.rig import LOAD_CELLS, Rig
from seatrial.daq.samples import MEASURED, Esc, Gnss, LoadCell, Servo

# Wall seconds.
POLL_S = 0.02  # time between two checks of the status
AHEAD_S = 0.5  # longest time by which set-points are sent to the acquisition before they are due
LEAD_S = 0.2  # from the decision to start to the first set-point
SETTLE_S = 4.0  # longest wait for a measurement of rest after the last zero
SETTLE_POLL_S = 0.05  # time between two of these measurements
LONGEST_PAUSE_S = 1.0  # longest pause between two checks of the status
FLUSH_S = 0.8  # time after which all samples so far are in the file, which is flushed every 0.25 s

ZERO = "thrust is zero"  # used only if zero thrust was measured
NO_THRUST = "no thrust was commanded"


class RunInterrupted(SeatrialError):
    """Error of a run that a signal has ended. The exit status is 128 plus the number of the signal."""

    def __init__(self, line: str, number: signal.Signals) -> None:
        """Store the message ``line`` of the error, and the exit status 128 plus the ``number`` of the signal."""
        super().__init__(line)
        self.exit_status = 128 + number


def run_mission(
    mission: Mission,
    rig: Rig,
    path: Path,
    display: Display,
    metadata: dict[str, str] | None = None,
    arm: bool = False,
    retries: int = 0,
    commands: CommandSource | None = None,
) -> RunResult:
    """Run a mission on the devices of a rig and record it. THRUSTERS TURN. The run ends at zero thrust.

    It must be called from the main thread, because it handles signals. Keys of the operator: space pauses and resumes
    the mission, r repeats the present segment, m marks the log.

    Parameters
    ----------
    mission : Mission
        The set-points of the thrusters and their limits.
    rig : Rig
        The rig that is driven.
    path : Path
        Path of the new log.
    display : Display
        Display that shows the state of the run to the operator. It is started and ended here.
    metadata : dict, optional
        Metadata of the log: texts by name.
    arm : bool
        Whether to put autopilots into MANUAL and arm them before the run, and to disarm them after it.
    retries : int
        How many segments of the mission, in all, are repeated if set-points, samples or ports were lost in them, or a
        device was silent. It is not used with ``commands``.
    commands : CommandSource, optional
        Commands that replace the set-points of the mission. The limits of the mission apply to them.

    Returns
    -------
    RunResult
        Tares of the load cells, and the autopilots that are still armed.

    Raises
    ------
    SafetyStop
        If the guard ends the run, if zero thrust is not measured at its end although thrust was commanded, if an
        external command is not accepted, or if this program stood still for more than 1 s or the computer was
        suspended.
    RunInterrupted
        On Ctrl-C, SIGTERM or SIGHUP.
    SeatrialError
        If the mission is beyond the limits of the rig, the log exists already, the run cannot start, the acquisition
        process fails, or an autopilot does not confirm that it is disarmed.

    Notes
    -----
    After an error in the run, zero is commanded and the log is closed, as far as the acquisition still answers. Then
    the error is raised. The message reports zero thrust only if it was measured. If it was not, and thrust was
    commanded in this run, the exit status of every SeatrialError is 3.
    """
    keys = Keys()
    with _prepared_runner(mission, rig, path, display, metadata or {}, keys, commands) as runner:
        return runner.run(arm, retries, keys)


def run_link_test(rig: Rig, path: Path, display: Display, metadata: dict[str, str], arm: bool) -> dict[str, LinkTest]:
    """Run a link test: measure how soon each autopilot ends thrust after a lost link. THRUSTERS TURN.

    The thrusters get a tenth of full command, then no frame is sent to the autopilots, and their outputs are recorded.
    The results are stored in RIG.link-test.json beside the rig file. No keys are read. It must be called from the main
    thread.

    Parameters
    ----------
    rig : Rig
        The rig.
    path : Path
        Path of the new log.
    display : Display
        Display that shows messages to the operator. It is started and ended here.
    metadata : dict
        Metadata of the log: texts by name.
    arm : bool
        Whether to put the autopilots into MANUAL and arm them before the test, and to disarm them after it.

    Returns
    -------
    dict
        Result of each autopilot, by its name. A result that is not passed (more than 2 s) is returned and stored too,
        without an error.

    Raises
    ------
    SafetyStop
        If the guard ends the test, if zero thrust is not measured at its end, or if the computer was suspended.
    RunInterrupted
        On Ctrl-C, SIGTERM or SIGHUP.
    SeatrialError
        If no thruster is behind an autopilot, `limits.n_max` is below 0.1, the log exists already, the test cannot
        start, a device or the acquisition fails, an autopilot does not confirm that it is disarmed, an output did not
        follow the command before the link was interrupted, or the file of results cannot be read or written.
    """
    with _prepared_runner(link_test_plan(rig), rig, path, display, metadata, nullcontext()) as runner:
        tests = runner.test_link(arm)
    save_link_tests(rig, tests)
    return tests


@contextmanager
def _prepared_runner(
    mission: Mission,
    rig: Rig,
    path: Path,
    display: Display,
    metadata: dict[str, str],
    keys: AbstractContextManager[object],
    commands: CommandSource | None = None,
) -> Iterator[_Runner]:
    """Check a mission against the limits of its rig, start the acquisition, and yield the runner of the mission.

    Handlers of signals and ``keys`` (the context that reads keys of the operator) are started too. The other parameters
    are those of `run_mission`; ``display`` is not started here. At the end of the context the acquisition is stopped
    and the signal handlers are restored (if a signal has arrived, signals are ignored from then on). Raises
    SeatrialError if the mission is beyond the limits, the log exists, or the acquisition cannot start.
    """
    dry_run(mission, rig)
    made = new_log_file(path)
    clock = RunClock(rig.speed)
    attachments = {"mission.toml": dump_mission(mission).encode()}
    has_started = False
    try:
        with (
            StopSignals() as signals,
            keys,
            Acquisition(rig, path, clock=clock, attachments=attachments, metadata=metadata, drive=True) as acquisition,
            realtime_priority(),  # this thread checks the limits
        ):
            has_started = True
            yield _Runner(mission, rig, path, clock, acquisition, signals, display, commands)
    except BaseException:
        if not has_started:
            discard_log_without_samples(path)
        if not path.exists():  # the run ended before any sample
            for folder in made:
                with contextlib.suppress(OSError):  # another program has written a file into it
                    folder.rmdir()
        raise


def discard_log_without_samples(path: Path) -> bool:
    """Delete a closed log if no device has sent a sample to it, and return whether it was deleted.

    A log that cannot be read is kept.

    Parameters
    ----------
    path : Path
        First file of the log of a run that this program has recorded.
    """
    try:
        with open_log(path) as log:
            if len(log.paths) > 1 or any(log.sources(kind) for kind in MEASURED):
                return False
        path.unlink()
    except (SeatrialError, OSError):
        return False
    return True


def new_log_file(path: Path) -> list[Path]:
    """Check that the file ``path`` of a new log does not exist, and make its folder. The file itself is not made.

    Returns
    -------
    list of Path
        The folders that were made, the innermost first.

    Raises
    ------
    SeatrialError
        If the log exists already, or if the folder cannot be made.
    """
    if path.exists():
        raise SeatrialError(f"{path} exists, and a log is never overwritten; give another name with -o")
    made = [folder for folder in path.parents if not folder.exists()]
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SeatrialError(
            f"{path.parent}: the folder of the log cannot be made: {error.strerror}; give another place for the log "
            "with -o"
        ) from error
    return made


class NewestValues(NamedTuple):
    """Newest measured values of a run for the display. A value is NaN if its sample is outdated.

    Attributes
    ----------
    force : float or None
        Force of a load cell [N]; None if no newest sample of a device has a finite force.
    speed : float or None
        Speed over ground of a GNSS receiver [m/s]; None if no newest sample of a device has a finite speed.
    rpm : dict of (str, int) to float
        Shaft speed [rev/min] of each speed controller that has reported, by its device and node.
    """

    force: float | None
    speed: float | None
    rpm: dict[Source, float]


def newest_values(status: Status, guard: SafetyGuard) -> NewestValues:
    """Return the newest force, speed and shaft speeds for the display.

    Parameters
    ----------
    status : Status
        Newest status of the acquisition.
    guard : SafetyGuard
        Safety guard, which decides whether a sample is outdated.

    Returns
    -------
    NewestValues
        The values. A value whose sample is outdated is NaN. If several devices measure force or speed, the last of
        them in the status whose sample is not outdated counts. Force or speed are None if no newest sample of a device
        has a finite value.
    """
    force: float | None = None
    speed: float | None = None
    rpm: dict[Source, float] = {}
    for source, latest in status.latest.items():
        sample, outdated = latest.sample, guard.is_outdated(source, status)
        if isinstance(sample, LoadCell) and math.isfinite(sample.force):
            force = sample.force if not outdated else math.nan if force is None else force
        elif isinstance(sample, Gnss) and math.isfinite(sample.speed):
            speed = sample.speed if not outdated else math.nan if speed is None else speed
        elif isinstance(sample, Esc):
            rpm[source[0].partition("/")[0], source[1]] = math.nan if outdated else sample.rpm
    return NewestValues(force, speed, rpm)


@dataclass(frozen=True)
class RunResult:
    """Outcome of a run that was completed without an error.

    Attributes
    ----------
    tares : tuple of Tare
        Mean raw measurements of the load cells at rest, at the start and at the end of the run; empty if none was
        measured.
    still_armed : tuple of str
        Names of autopilots that are armed at the end of the run. Those that this run armed were disarmed before.
    """

    tares: tuple[Tare, ...]
    still_armed: tuple[str, ...]


def _all_at_zero(rests: list[Rest] | None) -> bool:
    """Return whether every thruster was measured at zero thrust.

    ``rests`` has the measurement of each thruster. If it is None (the acquisition has failed), or if the thrust of a
    thruster could not be measured, return False. An empty list gives True.
    """
    return rests is not None and all(rest.is_zero for rest in rests)


class _Runner:
    """Runner of one mission or link test, from the first sample of the devices to the closed log.

    The sequencer passes set-points and events to this runner (`EventSink`). The runner asks the safety guard about each
    set-point before the set-point is sent to the acquisition. After an error the runner returns thrust to zero.
    """

    def __init__(
        self,
        mission: Mission,
        rig: Rig,
        path: Path,
        clock: RunClock,
        acquisition: Acquisition,
        signals: StopSignals,
        display: Display,
        commands: CommandSource | None,
    ) -> None:
        """Prepare a run. Nothing is commanded yet. The acquisition must have started.

        ``clock`` is the run clock, and ``signals`` the context that catches signals. ``commands`` is a source of
        external commands, or None to send the set-points of the mission. The others are those of `run_mission`.
        """
        self._mission, self._rig, self._path, self._commands = mission, rig, path, commands
        self._clock, self._acquisition, self._signals, self._display = clock, acquisition, signals, display
        self._guard = SafetyGuard(rig, clock.speed, mission.thrusters)
        n_max = float(np.abs(mission.setpoints()[1]).max(initial=0.0)) if commands is None else mission.n_max
        self._vehicles = Autopilots(rig, mission.thrusters, acquisition, clock, self._wait, display.say, n_max)
        self._segment = mission.segments[0].name
        self._moved = False  # whether a set-point other than zero was sent
        self._suspended = SuspendDetector()

    def run(self, arm: bool, retries: int, keys: Keys) -> RunResult:
        """Run the mission: wait for the devices, send the set-points, measure zero thrust and close the log.

        ``arm`` is whether to arm autopilots before the run and to disarm them after it. ``retries`` is the largest
        number of segments that are repeated because of lost data. ``keys`` reads the keys of the operator. The result
        and the errors are those of `run_mission`. After an error zero is commanded, the log is closed, and the error is
        raised again (a SeatrialError with a longer message).
        """
        with self._display:
            try:
                sequencer = self._run_setpoints(arm, retries, keys)
                self._acquisition.zero("end of the mission")
                self._display.clear()  # nobody updates it while autopilots are disarmed and zero is measured
                self._vehicles.release()
                tares = self._measure_tares(sequencer.timeline)
                self._require_zero()
                still_armed = self._vehicles.still_armed()
                self._acquisition.stop()
                self._say_skipped(sequencer.commanded)
            except BaseException as error:
                self._end_at_zero(error)
                raise
        return RunResult(tuple(tares), tuple(still_armed))

    def test_link(self, arm: bool) -> dict[str, LinkTest]:
        """Run a link test: command a tenth of thrust, stop all frames, and measure when the outputs are at neutral.

        Return the result of each autopilot, by its name, from the closed log. ``arm`` is whether to arm the autopilots
        before the test and to disarm them after it. After an error in the test zero is commanded, the log is closed,
        and the error is raised again (a SeatrialError with a longer message).
        """
        with self._display:
            try:
                self._vehicles.begin_link_test()
                self._await_ready(arm)
                links = self._vehicles.await_receivers()
                self._interrupt_links()
                self._acquisition.zero("end of the link test")
                self._vehicles.release()
                self._require_zero()
                self._acquisition.stop()
            except BaseException as error:
                self._end_at_zero(error)
                raise
        n = self._mission.n_max or 0.0
        with open_log(self._path) as log:
            return {name: measure_link_loss(log, self._rig.device(name), links[name], n) for name in links}

    def _require_zero(self) -> None:
        """Wait up to 4 s (wall) until zero thrust is measured on every thruster of the mission.

        Raises SafetyStop if this is not measured, unless no thrust was commanded in this run.
        """
        rests = self._await_rest()
        if self._moved and not _all_at_zero(rests):
            raise SafetyStop("the run is complete")

    def _interrupt_links(self) -> None:
        """Command the set-points of a link test, then send no frame to the autopilots and wait for neutral outputs.

        Frames stop 3 s after the first set-point. The method returns when all reported outputs have been at neutral
        (|n| at most 0.02, or NaN) for 0.5 s, or 10 s after frames stopped. All times are wall seconds. Raises
        SafetyStop if the test has to end, for example because a limit is passed, a device is silent, or the acquisition
        process stops thrust by itself. Raises RunInterrupted if a signal arrives.
        """
        speed, start = self._clock.speed, self._clock.now() + LEAD_S * self._clock.speed
        t, n = self._mission.setpoints()
        rows = [dict(zip(self._mission.thrusters, map(float, row), strict=True)) for row in n]
        self.schedule(list(zip(start + t, rows, strict=True)))
        silent_at = start + (REST_S + HOLD_S) * speed
        muted, neutral_since = False, math.inf
        while (now := self._clock.now()) < silent_at + SILENCE_S * speed and now - neutral_since < SETTLED_S * speed:
            status = self._acquisition.status()
            if not muted and now >= silent_at:
                for name in self._vehicles.names:
                    self._acquisition.request(name, "mute", SILENCE_S)
                self._acquisition.mark(MUTED, "link test: no frame is sent from here on")
                muted = True
            if muted:
                pushes = any(
                    abs(latest.sample.n) > NEUTRAL
                    for latest in status.latest.values()
                    if isinstance(latest.sample, Servo)
                )
                neutral_since = math.inf if pushes else min(neutral_since, now)
                if status.stopped:
                    raise SafetyStop(status.stopped)
                self._guard.check(status)
            else:
                self._check_guard(status, now)
            self._acquisition.alive()
            self._wait(POLL_S)

    def _await_ready(self, arm: bool) -> None:
        """Wait until thrust may be commanded, and let the guard allow set-points from then on.

        The method waits for samples of all devices, then for parameters and estimators of the autopilots. It then waits
        until devices report the limited quantities, send at their rate, and no thruster turns. With ``arm`` it then
        arms the autopilots; otherwise they must be armed already. Raises SeatrialError if one of these conditions is
        not fulfilled in its time.
        """
        names = await_devices(self._rig, self._acquisition, self._mission.thrusters, self._wait)
        self._display.say(f"devices: {', '.join(names)}; recording {self._path}")
        self._vehicles.await_ready()
        await_limits(self._rig, self._acquisition, self._guard, self._wait)
        self._vehicles.prepare(arm)
        self._guard.start(self._vehicles.changes)

    def schedule(self, rows: Sequence[Row]) -> None:
        """Send set-points to the acquisition if the guard allows them.

        ``rows`` are pairs of run time [s] and n_cmd by thruster. Raises SafetyStop if a set-point is not allowed, for
        example beyond `limits.n_max`, also before the guard is started. Other set-points are discarded before the guard
        is started. After a stop all set-points are discarded without an error.
        """
        allowed = self._guard.allow(rows)
        self._moved = self._moved or any(n != 0.0 for _, row in allowed for n in row.values())
        self._acquisition.schedule(allowed)

    def zero(self, reason: str) -> None:
        """Command zero to all thrusters at once, and discard set-points that are not yet due. Log the ``reason``."""
        self._acquisition.zero(reason)

    def mark(self, kind: str, text: str) -> None:
        """Write an event to the log: its kind, a word such as "segment", and its text in one line."""
        self._acquisition.mark(kind, text)

    def _run_setpoints(self, arm: bool, retries: int, keys: Keys) -> MissionSequencer:
        """Wait until thrust may be commanded, then send the set-points in time until the end of the mission.

        The safety guard, signals and keys are checked every 20 ms (wall) meanwhile. ``arm``, ``retries`` and ``keys``
        are those of `run`. Return the sequencer, which has the run times of the executed segments. Raises SeatrialError
        if the run cannot start, and RunInterrupted if a signal arrives. Raises SafetyStop if the run has to end, for
        example because of the guard, or because this program was paused for more than 1 s.
        """
        self._await_ready(arm)
        if keys.available:
            self._display.say(HELP)
        lead, ahead = LEAD_S * self._clock.speed, AHEAD_S * self._clock.speed
        start = self._clock.now() + lead
        self._acquisition.mark("start", f"{self._mission.name} at {start:.6f}")
        acquisition, say = self._acquisition, self._display.say
        sequencer: MissionSequencer
        if self._commands is None:
            sequencer = MissionSequencer(self._mission, start, lead, self, self._guard.patience, say, retries)
        else:
            acquisition.stream(self._commands.put)
            timeout = self._rig.ros2.timeout_s * self._clock.speed
            sequencer = CommandFollower(self._mission, start, timeout, self, say, self._commands)
        checked_at = time.monotonic()
        while not sequencer.is_over(now := self._clock.now()) or sequencer.must_repeat(now, self._acquisition.status()):
            status = self._acquisition.status()
            # After a pause of this program the thrusters would start in the middle of the plan. The acquisition
            # notices such a pause only while thrust is commanded.
            pause, checked_at = time.monotonic() - checked_at, time.monotonic()
            if pause > LONGEST_PAUSE_S and not status.stopped:
                raise SafetyStop(
                    f"this program stood still for {pause:.1f} s: the computer is too busy; end other programs, and "
                    "run again"
                )
            self._check_guard(status, now)
            sequencer.step(now, ahead, status, keys.take())
            self._acquisition.alive()
            self._segment = sequencer.segment or self._segment
            self._display.show(self._display_status(status, sequencer, now))
            self._wait(POLL_S)
        return sequencer

    def _check_guard(self, status: Status, now: float) -> None:
        """Let the safety guard check the status at run time ``now`` [s]. Raise SafetyStop if it ends the run."""
        if stop := self._guard.step(now, status).stop:
            raise SafetyStop(stop.reason)

    def _say_skipped(self, commanded: int) -> None:
        """Print how many of the ``commanded`` set-points were skipped: a later one replaced them before they were sent.

        Nothing is printed if no set-point was skipped.
        """
        skipped = self._acquisition.status().skipped
        if skipped:
            self._display.say(
                f"skipped: {skipped} of {commanded} set-points were not sent, because later ones were due already "
                "(busy computer, or set-points too close together); the log contains those that were sent; if they "
                "are many, end other programs and repeat the run"
            )

    def _wait(self, wall_s: float) -> None:
        """Wait for ``wall_s`` seconds (wall).

        Raises RunInterrupted as soon as a signal arrives. Raises SafetyStop, before the wait, if the computer was
        suspended (for more than 0.1 s) since the last call.
        """
        if slept := self._suspended.slept():
            raise SafetyStop(
                f"the computer was suspended for {slept:.1f} s; switch its suspend off (lid, battery, power settings), "
                "and run again"
            )
        if self._signals.wait(wall_s) and self._signals.caught is not None:
            number = self._signals.caught
            raise RunInterrupted(f"stopped by {WORDS[number]}", number)

    def _display_status(self, status: Status, sequencer: MissionSequencer, now: float) -> MissionStatus:
        """Return the state of the run at run time ``now`` [s] for the display.

        ``status`` is the newest status of the acquisition, and ``sequencer`` that of this run. A shaft speed that is
        not reported is NaN.
        """
        force, speed, rpm = newest_values(status, self._guard)
        thrusters = [self._rig.thruster(name) for name in self._mission.thrusters]
        return MissionStatus(
            segment="paused" if sequencer.paused else self._segment,
            elapsed=max(sequencer.elapsed(now), 0.0),
            total=self._mission.end,
            n_cmd=tuple(status.commanded.get(thruster.name, 0.0) for thruster in thrusters),
            rpm=tuple(rpm.get((thruster.device, thruster.node), math.nan) for thruster in thrusters),
            force=force,
            speed=speed,
            warning=status.warnings[-1] if status.warnings else "",
        )

    def _measure_tares(self, timeline: Schedule) -> list[Tare]:
        """Return the tares of the load cells: their mean raw measurements while the mission rests.

        The tares and their drift are also printed and written to the log as events. ``timeline`` has the run times of
        the executed segments. The list is empty if, for example, the rig has no load cell, the mission rests neither at
        its start nor at its end, or the log cannot be read; in the last case the reason is printed.
        """
        windows = timeline.static_windows()
        if not windows or not any(device.protocol in LOAD_CELLS for device in self._rig.devices):
            return []
        self._wait(FLUSH_S)
        try:
            tares = measure_tares(self._path, self._rig, windows)
        except SeatrialError as error:  # a missing tare must not fail the run: its log is still useful
            self._display.say(f"tare: not measured: {error}")
            return []
        for line in describe_tares(tares, self._rig):
            self._acquisition.mark("tare", line)
            self._display.say(f"tare: {line}")
        return tares

    def _end_at_zero(self, error: BaseException) -> None:
        """End a run after an ``error``: command zero, disarm, write the reason to the log, and close the log.

        If the error is a SeatrialError, its message is changed in place: it then also reports the measured thrust, the
        path of the log, and the autopilots that are still armed. Its exit status becomes 3 if thrust was commanded and
        zero is not measured. SeatrialError and OSError of these actions are suppressed.
        """
        reason = " ".join(str(error).split()) or type(error).__name__
        decided = self._clock.now()
        self._succeeds(lambda: self._acquisition.zero(reason))
        self._display.clear()  # its last state has "guard ok"
        self._succeeds(lambda: self._say_end(reason))
        self._succeeds(self._vehicles.disarm)
        self._succeeds(lambda: self._acquisition.mark("stop", reason))
        if stop := self._guard.stop:
            self._succeeds(lambda: self._acquisition.mark("stop-code", stop.code.value))
        self._succeeds(lambda: self._acquisition.mark("decided", f"{decided:.6f} to stop"))
        rests = self._await_rest()
        self._succeeds(lambda: self._acquisition.mark("rest", f"{self._thrust_text(rests)}{self._armed_text()}"))
        closed = self._succeeds(self._acquisition.stop)
        if not _all_at_zero(rests):
            # Measured again, because the acquisition process repeats zero before it closes the log.
            rests = self._measure_rest()
        thrust = self._thrust_text(rests)
        disarmed = self._vehicles.disarmed()
        is_disarmed = f", {' and '.join(disarmed)} {'is' if len(disarmed) == 1 else 'are'} disarmed" if disarmed else ""
        log = f"the log is {self._path}" if closed else f"the log so far is {self._path} (it can be opened)"
        # An interrupted run was not refused: its log says how far it came.
        is_refused = closed and not self._moved and not isinstance(error, RunInterrupted)
        if is_refused and discard_log_without_samples(self._path):
            log = "no device sent a sample, so that no log is kept"
        if isinstance(error, SeatrialError):
            if self._moved and thrust != ZERO:
                error.exit_status = SafetyStop.exit_status
            if thrust in (ZERO, NO_THRUST):
                error.args = (f"{reason}; {thrust}{is_disarmed}, {log}{self._armed_text()}",)
            else:  # what to do stands first, and the log on a line of its own
                error.args = (f"{thrust}; end of the run: {reason}{is_disarmed}{self._armed_text()}",)
                error.detail = log

    def _say_end(self, reason: str) -> None:
        """Tell the operator at once that the run ends, if it has armed an autopilot: to disarm it may take seconds."""
        if armed := self._vehicles.maybe_armed():
            self._display.say(
                f"THE RUN ENDS: {reason}. Zero was commanded; disarming {', '.join(armed)} takes up to {LEAVE_S:g} s. "
                "KEEP CLEAR OF THE PROPELLERS."
            )

    def _armed_text(self) -> str:
        """Return the end of the error message of a run: the names of autopilots that are still armed.

        Those that this run has armed come first. The text is empty if no autopilot is armed.
        """
        ours = self._vehicles.maybe_armed()
        others = [name for name in self._vehicles.still_armed() if name not in ours]
        advice = "keep clear of the propellers, and disarm it yourself"
        loud = f"; {', '.join(ours)} WAS ARMED BY THIS RUN AND MAY STILL BE ARMED: {advice}" if ours else ""
        return loud + (f"; {', '.join(others)} IS STILL ARMED: {advice}" if others else "")

    def _measure_rest(self) -> list[Rest] | None:
        """Return for each thruster of the mission whether its thrust is measured as zero at present.

        Return None if the acquisition has failed, so that nothing can be measured.
        """
        try:
            return self._guard.rest(self._acquisition.status())
        except SeatrialError:
            return None

    def _await_rest(self) -> list[Rest] | None:
        """Wait until every thruster is measured at zero thrust, for at most 4 s (wall).

        Return the last measurement of each thruster, or None if the acquisition has failed. The method does not wait if
        no thrust was commanded in this run, or if the port of a thruster is closed.
        """
        until = time.monotonic() + SETTLE_S
        while (rests := self._measure_rest()) is not None and not _all_at_zero(rests):
            if time.monotonic() > until or not (self._moved and self._ports_are_open()):
                break
            time.sleep(SETTLE_POLL_S)
        return rests

    def _ports_are_open(self) -> bool:
        """Return whether the ports of all thrusters of the mission are open, so that their thrust can be measured.

        Return False if the acquisition has failed.
        """
        try:
            ports = self._acquisition.status().ports
        except SeatrialError:
            return False
        names = {self._rig.thruster(name).device for name in self._mission.thrusters}
        return all(name in ports and ports[name].open for name in names)

    def _thrust_text(self, rests: list[Rest] | None) -> str:
        """Return the part of the error message that describes the thrust at the end of a run.

        ``rests`` has the measurement of each thruster; None if the acquisition has failed. The text is "thrust is zero"
        (`ZERO`) only if zero was measured on all. Otherwise it names the thrusters that an autopilot still drives, with
        the modes of the mission's autopilots. Without such thrusters it states that no thrust was commanded in this
        run, or that zero was sent but not confirmed, with the measurements.
        """
        if _all_at_zero(rests):
            return ZERO
        wrong = [rest for rest in rests or [] if not rest.is_zero]
        pushing = [rest.thruster for rest in wrong if rest.is_zero is False and self._is_output(rest.thruster)]
        if pushing:
            links = self._acquisition.status().links
            modes = [links[name].mode for name in self._vehicles.names if name in links]
            text = f"THRUST CONTINUES on {', '.join(pushing)}: the autopilot is in mode {', '.join(modes)}"
            return f"{text}; stop it yourself by transmitter or kill switch"
        if not self._moved:
            return NO_THRUST
        unreached = [rest.thruster for rest in wrong if not rest.is_reached]
        wrong = [rest for rest in wrong if rest.is_reached]
        measured = ": thruster " + ", thruster ".join(rest.text for rest in wrong) if wrong else ""
        times = self._vehicles.tested_s.items()
        tested = [f"{name} ended thrust {seconds:.1f} s after its link was lost" for name, seconds in times]
        in_link_test = f" (in its link test {', '.join(tested)})" if tested else ""
        known = [self._unreached_words(unreached)] if unreached else []
        if wrong or not unreached:
            known.append(f"zero thrust was sent, not confirmed{measured}{in_link_test}")
        elif in_link_test:
            known.append(in_link_test.strip(" ()"))
        return f"MAKE SURE THAT THE PROPELLERS STAND STILL before you approach: {'; '.join(known)}"

    def _unreached_words(self, thrusters: Sequence[str]) -> str:
        """Return the part of the error message on ``thrusters`` to which zero could not be sent, and what ends them."""
        text = f"zero could not be sent to {' and '.join(thrusters)}"
        own = [self._rig.thruster(name) for name in thrusters if not self._is_output(name)]
        if own:
            times = ", ".join(f"{thruster.name} {thruster.timeout_s:g} s" for thruster in own)
            text += f", and only the time-out in the controller ends the thrust (in the rig: {times})"
        if len(own) < len(thrusters):
            text += ", and only the failsafe of the autopilot ends the thrust"
        return f"{text}; not measured"

    def _is_output(self, thruster: str) -> bool:
        """Return whether the thruster with this name is connected to an output of an autopilot."""
        return self._rig.thruster(thruster).output is not None

    def _succeeds(self, action: Callable[[], None]) -> bool:
        """Call ``action`` and return whether it succeeded: False if it raised SeatrialError or OSError.

        These errors are suppressed, so that the next action towards zero thrust is always tried.
        """
        try:
            action()
        except (SeatrialError, OSError):
            return False
        return True
