"""Executes a mission; whatever happens on the way, it ends at zero thrust and with a closed log."""

from __future__ import annotations

import math
import signal
from collections.abc import Callable
from pathlib import Path

from bench.check import await_devices, dry_run
from bench.display import Display, View
from bench.guard import Guard
from bench.mission import Mission, dump_mission
from bench.signals import WORDS, StopSignals
from bench.tare import Tare, describe_tares, measure_tares, static_windows
from daq.acquire import Acquisition, Status
from daq.clock import RunClock
from daq.errors import SafetyStop, SeatrialError
from daq.rig import Rig
from daq.samples import Esc, Gnss, LoadCell

POLL_S = 0.02  # wall seconds between two looks at the status
AHEAD_S = 0.5  # wall seconds that set-points are sent ahead of their time, at most
LEAD_S = 0.2  # wall seconds from the decision to start to the first set-point
SILENCE_S = 1.0  # wall seconds without a status (there are twenty a second) after which the acquisition hangs
FLUSH_S = 0.8  # wall seconds after which everything said so far is in the file (it is flushed every 0.25 s)


class Interrupted(SeatrialError):
    """A signal ended the run."""

    def __init__(self, line: str, number: signal.Signals) -> None:
        super().__init__(line)
        self.exit_status = 128 + number


def run_mission(
    mission: Mission, rig: Rig, path: Path, display: Display, metadata: dict[str, str] | None = None
) -> list[Tare]:
    """Run `mission` on `rig` and record it at `path`; returns the load cell's zeros at start and end.

    Raises SafetyStop when the guard ends it, Interrupted on Ctrl-C, SIGTERM or SIGHUP, and SeatrialError when a
    device or the acquisition fails; in every case thrust is zero and the log is closed first. Call it from the
    main thread: it takes the signals while it runs.
    """
    dry_run(mission, rig)
    new_log_file(path)
    clock = RunClock(rig.speed)
    attachments = {"mission.toml": dump_mission(mission).encode()}
    with (
        StopSignals() as signals,
        Acquisition(rig, path, clock=clock, attachments=attachments, metadata=metadata or {}) as acquisition,
    ):
        return _Runner(mission, rig, path, clock, acquisition, signals, display).run()


def new_log_file(path: Path) -> None:
    """Make the folder of a log that is to be written; raises SeatrialError when the file is there already."""
    if path.exists():
        raise SeatrialError(f"{path} exists, and a log is never overwritten; give another name with -o")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise SeatrialError(f"{path.parent}: {error.strerror}; give another place for the log with -o") from error


class _Runner:
    """One run: what `run_mission` was given, and the way back to zero."""

    def __init__(
        self,
        mission: Mission,
        rig: Rig,
        path: Path,
        clock: RunClock,
        acquisition: Acquisition,
        signals: StopSignals,
        display: Display,
    ) -> None:
        self._mission, self._rig, self._path = mission, rig, path
        self._clock, self._acquisition, self._signals, self._display = clock, acquisition, signals, display
        self._guard = Guard(rig, clock.speed, mission.thrusters)
        self._t, self._n = mission.setpoints()
        self._sent = 0
        self._segment = -1

    def run(self) -> list[Tare]:
        """From waiting for the devices to the closed log."""
        with self._display:
            try:
                start = self._excite()
                self._acquisition.zero("end of the mission")
                tares = self._tare(start)
                self._acquisition.stop()
                self._say_skipped()
            except BaseException as error:
                self._end_at_zero(error)
                raise
        return tares

    def _excite(self) -> float:
        """Wait for the devices, then send every set-point in time; returns the run time of the start."""
        names = await_devices(self._rig, self._acquisition, self._mission.thrusters, self._wait)
        self._display.say(f"devices: {', '.join(names)}; recording {self._path}")
        start = self._clock.now() + LEAD_S * self._clock.speed
        self._acquisition.mark("start", f"{self._mission.name} at {start:.6f}")
        while (now := self._clock.now()) < start + self._mission.end:
            self._send(start, now + AHEAD_S * self._clock.speed)
            self._acquisition.alive()
            status = self._acquisition.status()
            self._check(status, now)
            self._mark(now - start)
            self._display.show(self._view(status, now - start))
            self._wait(POLL_S)
        return start

    def _check(self, status: Status, now: float) -> None:
        """Raise SafetyStop when the acquisition has ended thrust, falls silent, or the guard finds a limit passed."""
        if status.stopped:
            raise SafetyStop(status.stopped)
        if now - status.t > SILENCE_S * self._clock.speed:
            raise SafetyStop(f"the acquisition process has not answered for {SILENCE_S:g} s")
        self._guard.check(status)

    def _say_skipped(self) -> None:
        """Tell of set-points that this machine was too busy to send in time; the log holds what was sent."""
        skipped, planned = self._acquisition.status().skipped, self._n.size
        if skipped:
            self._display.say(
                f"skipped: {skipped} of {planned} set-points, overtaken by later ones before they could be sent "
                "(a busy machine, or rows too close for the clock's speed); the log says what was sent and when"
            )

    def _wait(self, wall_s: float) -> None:
        """Wait, unless a signal comes: that raises Interrupted."""
        if self._signals.wait(wall_s) and self._signals.caught is not None:
            number = self._signals.caught
            raise Interrupted(f"stopped by {WORDS[number]}", number)

    def _send(self, start: float, until: float) -> None:
        """Append the set-points before run time `until`."""
        rows: list[tuple[float, dict[str, float]]] = []
        while self._sent < len(self._t) and start + self._t[self._sent] < until:
            row = self._n[self._sent].tolist()
            rows.append((start + float(self._t[self._sent]), dict(zip(self._mission.thrusters, row, strict=True))))
            self._sent += 1
        if rows:
            self._acquisition.schedule(rows)

    def _mark(self, elapsed: float) -> None:
        """Write an event for each segment that has begun."""
        spans = self._mission.starts()
        while self._segment + 1 < len(spans) and elapsed >= spans[self._segment + 1][0]:
            self._segment += 1
            self._acquisition.mark("segment", spans[self._segment][2])

    def _view(self, status: Status, elapsed: float) -> View:
        force = speed = math.nan
        rpm = {}
        for (device, node), latest in status.latest.items():
            sample = latest.sample
            if isinstance(sample, LoadCell):
                force = sample.force
            elif isinstance(sample, Gnss):
                speed = math.hypot(sample.vel_n, sample.vel_e)
            elif isinstance(sample, Esc):
                rpm[device, node] = sample.rpm
        thrusters = [self._rig.thruster(name) for name in self._mission.thrusters]
        return View(
            segment=self._mission.segments[max(self._segment, 0)].name,
            elapsed=max(elapsed, 0.0),
            total=self._mission.end,
            n_cmd=tuple(status.commanded.get(thruster.name, 0.0) for thruster in thrusters),
            rpm=tuple(rpm.get((thruster.device, thruster.node), math.nan) for thruster in thrusters),
            force=force,
            speed=speed,
            warning=status.warnings[-1] if status.warnings else "",
        )

    def _tare(self, start: float) -> list[Tare]:
        """The load cell's zero from the static segments, said and written as events."""
        windows = static_windows(self._mission, start)
        if not windows or not any(device.protocol == "loadcell" for device in self._rig.devices):
            return []
        self._wait(FLUSH_S)
        try:
            tares = measure_tares(self._path, self._rig, windows)
        except SeatrialError as error:  # the log is worth keeping without its tare
            self._display.say(f"tare: not measured: {error}")
            return []
        for line in describe_tares(tares, self._rig):
            self._acquisition.mark("tare", line)
            self._display.say(f"tare: {line}")
        return tares

    def _end_at_zero(self, error: BaseException) -> None:
        """Command zero, note the reason, close the log, and add to the error's line where that log is."""
        reason = " ".join(str(error).split()) or type(error).__name__
        told = self._tried(lambda: self._acquisition.zero(reason))
        zero = self._thrusters_heard(told)
        self._tried(lambda: self._acquisition.mark("stop", reason))
        closed = self._tried(self._acquisition.stop)
        thrust = "thrust is zero" if zero else "each ESC goes to zero by its own time-out"
        log = f"the log is {self._path}" if closed else f"the log so far is {self._path} (it opens as it is)"
        if isinstance(error, SeatrialError):
            error.args = (f"{reason}: {thrust}, {log}",)

    def _thrusters_heard(self, told: bool) -> bool:
        """Whether zero was commanded, by us or by the acquisition itself, to thrusters that are there to hear it."""
        try:
            status = self._acquisition.status()
        except SeatrialError:
            return False
        return (told or bool(status.stopped)) and self._guard.thrusters_heard(status)

    def _tried(self, action: Callable[[], None]) -> bool:
        """Whether `action` worked; on the way to zero no failure may keep the next step from being tried."""
        try:
            action()
        except (SeatrialError, OSError):
            return False
        return True
