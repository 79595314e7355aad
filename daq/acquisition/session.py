"""The parent's side of an acquisition: starts the acquisition process, sends it messages, and ends it."""

from __future__ import annotations

import contextlib
import math
import os
import socket
import subprocess
import sys
import tempfile
import threading
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO

from seatrial.daq.acquisition.ipc import (
    AcquisitionChannel,
    Closed,
    Configuration,
    DriverRequest,
    Failed,
    LogEvent,
    Message,
    ParentAlive,
    SampleBatch,
    ScheduleSetpoints,
    StatusReport,
    Stop,
    StreamSamples,
    ZeroThrust,
)
from seatrial.daq.acquisition.status import Status, StreamedSample
from seatrial.daq.child_process import module_command, module_environment
from seatrial.daq.clock import RunClock
from seatrial.daq.drivers import LinkRole
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import read_note
from seatrial.daq.realtime_priority import set_realtime_priority
from seatrial.daq.rig import Rig

STDERR = 2
HEARTBEAT_S = 0.05  # wall, as all of these
START_S = 30.0
STOP_S = 15.0
WATCHDOG_S = 5.0  # it opens ports for 3 s at most, and sends zero for 1


def _copy_of_stderr() -> int | None:
    """Return a new descriptor of standard error; None if it is closed, as in a service."""
    try:
        return os.dup(STDERR)
    except OSError:
        return None


class Acquisition:
    """Records every device of `rig` to a new log at `path`, in a process of its own, while in the `with` block.

    The process is safe against any failure here: when this process dies or stops answering, or when thrust is
    commanded and `alive` is not called for 0.25 s (wall), it commands zero, records one second more and closes the
    log. With `drive` a watchdog process monitors it (seatrial.daq.acquisition.watchdog); no thrust may be commanded
    without. Autopilots are only listened to, but for `drive`, and with `ask` for their parameters and the rates of the
    rig. All methods may be called from any thread; all but `alive` raise SeatrialError when the process has failed.
    """

    def __init__(
        self,
        rig: Rig,
        path: Path,
        *,
        clock: RunClock,
        attachments: Mapping[str, bytes] | None = None,
        metadata: Mapping[str, str] | None = None,
        drive: bool = False,
        ask: bool = False,
    ) -> None:
        self._drive = drive
        self._role = LinkRole.DRIVE if drive else LinkRole.ASK if ask else LinkRole.LISTEN
        self.rig, self.path, self.clock = rig, Path(path), clock
        self._attachments, self._metadata = dict(attachments or {}), dict(metadata or {})
        self._changed = threading.Condition()
        self._status: Status | None = None
        self._take_samples: Callable[[Sequence[StreamedSample], int], None] | None = None
        self._failure = ""
        self._gone = False  # the process has closed its side of the socket
        self._ended = ""  # why it ended by itself, in good order
        self._alive = threading.Event()
        self._stopping = threading.Event()
        self._stopped = False
        self._watchdog: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Acquisition:
        """Start the process; returns when the log is open. Raises SeatrialError when it cannot be."""
        ours, theirs = socket.socketpair()
        self._stderr: IO[bytes] = tempfile.TemporaryFile()
        with theirs, contextlib.ExitStack() as stack:
            ends: list[int] = [theirs.fileno()]
            if self._drive:
                watched, watching = (stack.enter_context(sock) for sock in socket.socketpair())
                self._watchdog = self._start("seatrial.daq.acquisition.watchdog", [watching.fileno()])
                ends.append(watched.fileno())
            terminal = _copy_of_stderr()
            if terminal is not None:
                stack.callback(os.close, terminal)
            inherited = [] if terminal is None else [terminal]
            self._process = self._start("seatrial.daq.acquisition.process", ends, inherited)
        self._link = AcquisitionChannel(ours)
        self._threads = [
            threading.Thread(target=self._listen, name="acquisition status", daemon=True),
            threading.Thread(target=self._beat, name="acquisition heartbeat", daemon=True),
        ]
        try:
            self._send(self._configuration(-1 if terminal is None else terminal))
            for thread in self._threads:
                thread.start()
            self._await(lambda: self._status is not None, START_S, "did not start")
        except BaseException:
            self._abandon()
            raise
        return self

    def _start(self, module: str, ends: Sequence[int], inherited: Sequence[int] = ()) -> subprocess.Popen[bytes]:
        """Start a module as a process that gets the sockets `ends` as arguments and inherits them and `inherited`."""
        return subprocess.Popen(
            module_command(module, *map(str, ends)),
            pass_fds=[*ends, *inherited],
            stdin=subprocess.DEVNULL,
            stdout=self._stderr,
            stderr=self._stderr,
            env=module_environment(),
            start_new_session=True,  # Ctrl-C is for the parent; the process ends by a message
        )

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """`stop`; an error of the block itself takes precedence."""
        try:
            self.stop()
        except SeatrialError:
            if error is None:
                raise

    def schedule(self, rows: Sequence[tuple[float, Mapping[str, float]]]) -> None:
        """Append set-points (run time, {thruster: n_cmd}), -1..1, positive forward; the last one holds.

        A row whose time has passed is sent at once. Rows are ignored once the process has ended thrust by itself
        (`Status.stopped`): thrust starts only with a new run. Raises SeatrialError for a thruster that the rig has not
        and for a value beyond `limits.n_max`.
        """
        limit = min(self.rig.limits.n_max, 1.0)
        for t, row in rows:
            for name, n in row.items():
                self.rig.thruster(name)
                if not (math.isfinite(t) and abs(n) <= limit):
                    raise SeatrialError(f"set-point {n} for {name} at {t}: only -{limit:g} to {limit:g} is allowed")
        self._send(ScheduleSetpoints([(t, dict(row)) for t, row in rows]))

    def zero(self, reason: str) -> None:
        """Clear the schedule and command zero to all thrusters at once; `reason` is logged as an event."""
        self._send(ZeroThrust(reason))

    def mark(self, kind: str, text: str) -> None:
        """Write an event to the log."""
        self._send(LogEvent(kind, text))

    def stream(self, take: Callable[[Sequence[StreamedSample], int], None]) -> None:
        """From here on give every sample that is logged to `take`, twenty times a second, and how many were dropped.

        `take` is called by the thread that receives the status: it must neither wait nor raise.
        """
        self._take_samples = take
        self._send(StreamSamples())

    def request(self, device: str, action: str, value: float = 0.0) -> None:
        """Request an autopilot to `arm`, `disarm` or change its `mode`; the answer is in `Status.links`."""
        self.rig.device(device)
        self._send(DriverRequest(device, action, value))

    def alive(self) -> None:
        """Heartbeat of the runner: to be called every 0.1 s (wall) while thrust is commanded."""
        self._alive.set()

    def status(self) -> Status:
        """The newest status, at most some 50 ms (wall) old; after `stop` the last one."""
        with self._changed:
            self._raise_failure()
            if self._gone and not self._stopped:
                raise SeatrialError(f"the acquisition process ended: {self._ended}; the log is {self.path}")
            assert self._status is not None, "status is for inside the with block"
            return self._status

    def stop(self) -> None:
        """Zero thrust, close the log and wait for it. Calling it again does nothing."""
        if self._stopped:
            return
        self._stopped = True
        try:
            with contextlib.suppress(OSError):  # it is ending by itself; whether in good order is seen below
                if not self._gone:
                    self._link.send(Stop())
            self._await(lambda: self._gone, STOP_S, "did not close the log")
        finally:
            self._abandon()
        self._raise_failure()

    def _configuration(self, terminal: int) -> Configuration:
        return Configuration(
            rig_text=self.rig.text,
            rig_path=str(Path(self.rig.path).absolute()),
            path=str(self.path.absolute()),
            speed=self.clock.speed,
            origin=self.clock.origin,
            role=self._role.value,
            terminal=terminal,
            attachments=self._attachments,
            metadata={"command_line": " ".join(sys.argv), **self._metadata},
        )

    def _send(self, message: Message) -> None:
        try:
            self._link.send(message)
        except OSError:
            with self._changed:
                self._changed.wait_for(lambda: self._gone, timeout=1.0)
                self._raise_failure()
                why = f": {self._ended}" if self._ended else ""
            raise SeatrialError(f"the acquisition process ended{why}; the log is {self.path}") from None

    def _beat(self) -> None:
        set_realtime_priority()  # this thread's heartbeats keep thrust on, also on a busy machine
        while not self._stopping.wait(HEARTBEAT_S):
            alive = self._alive.is_set()
            self._alive.clear()
            try:
                self._link.send(ParentAlive(runner=alive))
            except OSError:
                return

    def _listen(self) -> None:
        closed = False
        for message in self._link.messages():
            if isinstance(message, SampleBatch) and self._take_samples is not None:
                self._take_samples(message.samples, message.dropped)
                continue
            with self._changed:
                if isinstance(message, StatusReport):
                    self._status = message.status
                elif isinstance(message, Failed):
                    self._failure = message.reason
                elif isinstance(message, Closed):
                    closed, self._ended = True, message.reason
                self._changed.notify_all()
        with self._changed:
            if not (closed or self._failure):
                self._failure = self._died()
            self._gone = True
            self._changed.notify_all()

    def _died(self) -> str:
        """The error, in one line, of a process that has ended without a message."""
        code = "none yet"
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = str(self._process.wait(timeout=2.0))
        self._stderr.seek(0)
        lines = self._stderr.read().decode(errors="replace").strip().splitlines()
        said = f": {lines[-1].strip()}" if lines else ""
        if self._watchdog is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._watchdog.wait(timeout=WATCHDOG_S)
            said += f"; {note}" if (note := read_note(self.path)) else ""
        return f"the acquisition process ended by itself (status {code}{said}); the log so far is {self.path}"

    def _raise_failure(self) -> None:
        if self._failure:
            raise SeatrialError(self._failure)

    def _await(self, condition: Callable[[], bool], seconds: float, what: str) -> None:
        with self._changed:
            if not self._changed.wait_for(lambda: condition() or self._failure, timeout=seconds):
                raise SeatrialError(f"the acquisition process {what} in {seconds:g} s; the log so far is {self.path}")
            self._raise_failure()

    def _abandon(self) -> None:
        """End the process, by a signal if it does not end by itself, and release its resources."""
        self._stopped = True
        self._stopping.set()
        self._link.close()  # a process that still runs takes this as the parent's death: zero thrust, log closed
        try:
            self._process.wait(timeout=STOP_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        if self._watchdog is not None:
            try:
                self._watchdog.wait(timeout=WATCHDOG_S)  # it may still be sending zero
            except subprocess.TimeoutExpired:  # it hangs
                self._watchdog.kill()
                self._watchdog.wait()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join()
        self._stderr.close()
