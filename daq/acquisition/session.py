"""Acquisition session in the parent process: starts the acquisition process, sends it messages, and ends it."""

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

STDERR = 2  # file descriptor
# Wall seconds.
HEARTBEAT_S = 0.05
START_S = 30.0  # longest start of the acquisition process
STOP_S = 15.0  # longest end of the acquisition process
WATCHDOG_S = 5.0  # longest end of the watchdog, which tries to open ports for 3 s and sends zero for 1 s


def _copy_of_stderr() -> int | None:
    """Return a new file descriptor of standard error; None if standard error is closed, as in a service.

    The caller has to close it.
    """
    try:
        return os.dup(STDERR)
    except OSError:
        return None


class Acquisition:
    """Acquisition of all devices of a rig into a new log while the context lasts.

    It is done by a process of its own, the acquisition process; this class is its interface in the parent process. Any
    thread may call the methods. If the process has failed, all methods raise SeatrialError, except `alive` and a second
    call of `stop`.

    Parameters
    ----------
    rig : Rig
        The rig with its devices.
    path : Path
        The new log.
    clock : RunClock
        The run clock, which the process shares.
    attachments : Mapping, optional
        Attachments of the log: bytes by name.
    metadata : Mapping, optional
        Metadata of the log.
    drive : bool
        Whether thrust will be commanded. A watchdog process then monitors the acquisition process
        (seatrial.daq.acquisition.watchdog).
    ask : bool
        Whether to request parameters and the rates of the rig from autopilots. Without `drive` and `ask` no message is
        sent to autopilots.

    Attributes
    ----------
    end_reason : str
        Text of the event "end" in the log. It may be changed until the end.

    Notes
    -----
    A failure of the parent cannot leave thrust on. If the parent ends, or if while thrust is commanded it sends nothing
    or neither `alive` nor `schedule` is called for 0.25 s (wall), the process commands zero, records one more second
    and closes the log.
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
        """Prepare the acquisition of all devices of a rig into the new log `path`.

        The acquisition process is started when the context begins. `clock` is the run clock. `attachments` and
        `metadata` of the log are bytes and texts by name. `drive` is whether thrust will be commanded; a watchdog
        process is then started too. `ask` is whether data are requested from autopilots.
        """
        self.end_reason = Stop().reason
        self._drive = drive
        self._role = LinkRole.DRIVE if drive else LinkRole.ASK if ask else LinkRole.LISTEN
        self.rig, self.path, self.clock = rig, Path(path), clock
        self._attachments, self._metadata = dict(attachments or {}), dict(metadata or {})
        self._changed = threading.Condition()
        self._status: Status | None = None
        self._take_samples: Callable[[Sequence[StreamedSample], int], None] | None = None
        self._failure = ""
        self._gone = False  # whether the process has closed its end of the socket
        self._ended = ""  # why the process ended by itself, without an error
        self._alive = threading.Event()
        self._stopping = threading.Event()
        self._stopped = False
        self._watchdog: subprocess.Popen[bytes] | None = None

    def __enter__(self) -> Acquisition:
        """Start the acquisition process, wait until the log is open, and return this object.

        With `drive` a watchdog process is started too.

        Raises
        ------
        SeatrialError
            If the process does not start within 30 s (wall), cannot open the log, or gets no watchdog.
        """
        ours, theirs = socket.socketpair()
        self._stderr: IO[bytes] = tempfile.TemporaryFile()
        with theirs, contextlib.ExitStack() as stack:
            ends: list[int] = [theirs.fileno()]
            if self._drive:
                watched, watching = (stack.enter_context(sock) for sock in socket.socketpair())
                self._watchdog = self._start_process("seatrial.daq.acquisition.watchdog", [watching.fileno()])
                ends.append(watched.fileno())
            terminal = _copy_of_stderr()
            if terminal is not None:
                stack.callback(os.close, terminal)
            inherited = [] if terminal is None else [terminal]
            self._process = self._start_process("seatrial.daq.acquisition.process", ends, inherited)
        self._link = AcquisitionChannel(ours)
        self._threads = [
            threading.Thread(target=self._receive_messages, name="acquisition status", daemon=True),
            threading.Thread(target=self._send_heartbeats, name="acquisition heartbeat", daemon=True),
        ]
        try:
            self._send_message(self._configuration(-1 if terminal is None else terminal))
            for thread in self._threads:
                thread.start()
            self._wait_until(lambda: self._status is not None, START_S, "did not start")
        except BaseException:
            self._release_processes()
            raise
        return self

    def _start_process(
        self, module: str, ends: Sequence[int], inherited: Sequence[int] = ()
    ) -> subprocess.Popen[bytes]:
        """Start a module of this program as a process of its own, and return the process.

        Its standard output and error go to a temporary file, from which a crash is reported.

        Parameters
        ----------
        module : str
            Full name of the module.
        ends : sequence of int
            File descriptors of sockets, which the process inherits and gets as arguments.
        inherited : sequence of int
            Further file descriptors, which the process inherits.
        """
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
        """Stop the acquisition at the end of the context: command zero, close the log and end the process.

        An error that was raised in the context takes precedence over an error of the stop.
        """
        try:
            self.stop()
        except SeatrialError:
            if error is None:
                raise

    def schedule(self, rows: Sequence[tuple[float, Mapping[str, float]]]) -> None:
        """Append set-points to the schedule of the acquisition process, which sends each at its run time.

        A set-point holds until the next one. A set-point whose time has passed is sent at once; of several for one
        thruster only the newest is sent. If the process has stopped thrust by itself (`Status.stopped`), set-points are
        ignored until a new run. The call also counts as a call of `alive`.

        Parameters
        ----------
        rows : sequence of tuple
            Pairs of run time [s] and commands n_cmd by name of the thruster, -1 to 1, positive forward.

        Raises
        ------
        SeatrialError
            If the rig lacks a thruster, a command is NaN or beyond `limits.n_max` or 1, a time is not finite, or the
            process has ended.
        """
        limit = min(self.rig.limits.n_max, 1.0)
        for t, row in rows:
            for name, n in row.items():
                self.rig.thruster(name)
                if not (math.isfinite(t) and abs(n) <= limit):
                    raise SeatrialError(
                        f"set-point n = {n} for thruster {name} at {t} s: limits.n_max of the rig allows only "
                        f"-{limit:g} to {limit:g}; correct the set-point or the limit"
                    )
        self._send_message(ScheduleSetpoints([(t, dict(row)) for t, row in rows]))

    def zero(self, reason: str) -> None:
        """Discard all scheduled set-points and command zero to all thrusters at once; log `reason` as an event.

        The call does not wait until zero was sent; `Status.zeroed` shows it. Set-points of later calls of
        `schedule` are sent as usual. Raise SeatrialError if the acquisition process has ended.
        """
        self._send_message(ZeroThrust(reason))

    def mark(self, kind: str, text: str) -> None:
        """Write an event to the log: its kind, a word such as "segment", and a description in one line.

        The event gets the run time at which the acquisition process receives it. The call does not wait until it is
        written. Raise SeatrialError if the acquisition process has ended.
        """
        self._send_message(LogEvent(kind, text))

    def stream(self, take: Callable[[Sequence[StreamedSample], int], None]) -> None:
        """Pass all samples that are logged from now on to a function, every 50 ms (wall).

        One call of the function has at most 100 samples; the function may be called several times in a row. Samples of
        transducers, and events, are left out. A second call of `stream` replaces the function.

        Parameters
        ----------
        take : Callable
            Function of the new samples and of the number of samples that could not be passed on so far. The thread that
            receives the status calls it, so that it must neither wait nor raise.
        """
        self._take_samples = take
        self._send_message(StreamSamples())

    def request(self, device: str, action: str, value: float = 0.0) -> None:
        """Send a request to an autopilot. The method does not wait; the answer will be in `Status.links`.

        Parameters
        ----------
        device : str
            Name of the autopilot.
        action : str
            `arm`, `disarm`, `mode` (change the mode), or `mute` (send nothing to it while thrust is commanded, as if
            the link was cut).
        value : float
            Number of the mode for `mode`, wall seconds for `mute`; unused otherwise.

        Raises
        ------
        SeatrialError
            If the rig has no such device, or the acquisition process has ended.
        """
        self.rig.device(device)
        self._send_message(DriverRequest(device, action, value))

    def alive(self) -> None:
        """Report that the program that commands thrust is still working.

        It must be called every 0.1 s (wall) while thrust is commanded. If thrust is commanded or scheduled, and this
        method and `schedule` are not called for 0.25 s, the acquisition process commands zero and ends.
        """
        self._alive.set()

    def status(self) -> Status:
        """Return the newest status of the acquisition, usually at most about 50 ms (wall) old; after `stop` the last.

        Raises
        ------
        SeatrialError
            If the process has failed, or has ended by itself before `stop`.
        """
        with self._changed:
            self._raise_failure()
            if self._gone and not self._stopped:
                raise SeatrialError(f"the acquisition process has ended: {self._ended}; the log is {self.path}")
            assert self._status is not None, "status is for inside the with block"
            return self._status

    def stop(self) -> None:
        """Command zero, close the log, and wait until the acquisition process has ended. A second call does nothing.

        Raises
        ------
        SeatrialError
            If the process has failed, or does not close the log within 15 s (wall).
        """
        if self._stopped:
            return
        self._stopped = True
        try:
            with contextlib.suppress(OSError):  # the process is ending by itself; its errors are raised below
                if not self._gone:
                    self._link.send(Stop(self.end_reason))
            self._wait_until(lambda: self._gone, STOP_S, "did not close the log")
        finally:
            self._release_processes()
        self._raise_failure()

    def _configuration(self, terminal: int) -> Configuration:
        """Return the first message to the acquisition process: rig, path of the log, clock, role and log metadata.

        `terminal` is the file descriptor of standard error that the process inherits; -1 if it is closed.
        """
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

    def _send_message(self, message: Message) -> None:
        """Send a message to the acquisition process. Raise SeatrialError with the reason if the process has ended."""
        try:
            self._link.send(message)
        except OSError:
            with self._changed:
                self._changed.wait_for(lambda: self._gone, timeout=1.0)
                self._raise_failure()
                why = f": {self._ended}" if self._ended else ""
            raise SeatrialError(f"the acquisition process has ended{why}; the log is {self.path}; run again") from None

    def _send_heartbeats(self) -> None:
        """Send a heartbeat to the acquisition process every 50 ms until the acquisition ends (code of a thread).

        Each heartbeat contains whether `alive` was called since the last one.
        """
        set_realtime_priority()  # a busy machine must not delay the heartbeats, without which thrust ends
        while not self._stopping.wait(HEARTBEAT_S):
            alive = self._alive.is_set()
            self._alive.clear()
            try:
                self._link.send(ParentAlive(runner=alive))
            except OSError:
                return

    def _receive_messages(self) -> None:
        """Receive messages of the acquisition process until it closes the socket (code of a thread).

        The newest status and the reason for the end are stored, and threads that wait for them are notified. Logged
        samples are passed to the function that `stream` got. If the process ends without a last message, its crash is
        stored as an error.
        """
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
                self._failure = self._describe_crash()
            self._gone = True
            self._changed.notify_all()

    def _describe_crash(self) -> str:
        """Return the error message, in one line, for an acquisition process that has ended without a last message.

        It contains the exit status of the process, the last line of the output of process and watchdog, and the note
        that the watchdog has written beside the log, if there is one. The method waits up to 2 s for the process and
        5 s for the watchdog to end (wall).
        """
        code = "none yet"
        with contextlib.suppress(subprocess.TimeoutExpired):
            code = str(self._process.wait(timeout=2.0))
        self._stderr.seek(0)
        lines = self._stderr.read().decode(errors="replace").strip().splitlines()
        details = f": {lines[-1].strip()}" if lines else ""
        if self._watchdog is not None:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._watchdog.wait(timeout=WATCHDOG_S)
            details += f"; {note}" if (note := read_note(self.path)) else ""
        text = f"the acquisition process ended by itself (status {code}{details})"
        return f"{text}; the log so far is {self.path}; run again, and report it if it happens again"

    def _raise_failure(self) -> None:
        """Raise SeatrialError with the reason if the acquisition process has reported an error or has crashed.

        An end without an error raises nothing.
        """
        if self._failure:
            raise SeatrialError(self._failure)

    def _wait_until(self, condition: Callable[[], bool], seconds: float, failure: str) -> None:
        """Wait until the function `condition` returns true. It is called again when the process sends a message.

        A message with samples does not count. Raise SeatrialError after `seconds` (wall), with the words `failure` in
        the message, such as "did not start", or as soon as the acquisition process fails.
        """
        with self._changed:
            if not self._changed.wait_for(lambda: condition() or self._failure, timeout=seconds):
                raise SeatrialError(
                    f"the acquisition process {failure} in {seconds:g} s; the log so far is {self.path}; end other "
                    "programs, because the computer is too busy"
                )
            self._raise_failure()

    def _release_processes(self) -> None:
        """Close the socket, wait for the end of acquisition process and watchdog, and end the threads of this object.

        A process that does not end in time (15 s, and 5 s for the watchdog) is killed.
        """
        self._stopped = True
        self._stopping.set()
        self._link.close()  # a process that still runs then commands zero and closes the log
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
