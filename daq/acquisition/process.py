"""Acquisition process: it owns every port and the log, and commands zero if its parent stops responding.

`seatrial.daq.acquisition.session.Acquisition` starts it as `python -m seatrial.daq.acquisition.process FD`. No user
code runs in this process, so that only the operating system can delay it. One thread serves each port, and one thread
writes the log. The main thread receives the messages of the parent (seatrial.daq.acquisition.ipc).
"""

from __future__ import annotations

import contextlib
import gc
import os
import select
import signal
import socket
import sys
import threading
import time
from pathlib import Path
from types import FrameType

from seatrial.daq.acquisition.device_loop import DeviceLoop
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
    Stop,
    StreamSamples,
    ZeroThrust,
)
from seatrial.daq.acquisition.log_thread import WRITE_S, LogItem, LogSink, LogThread, SampleStream
from seatrial.daq.acquisition.status_reporter import StatusReporter
from seatrial.daq.acquisition.watchdog import Heartbeat
from seatrial.daq.clock import RunClock
from seatrial.daq.config import parse_rig
from seatrial.daq.drivers import LinkRole, Setpoints, check_keys, make_driver
from seatrial.daq.errors import SeatrialError, printable
from seatrial.daq.log import Recorder, check_room
from seatrial.daq.protocol import make_decoder
from seatrial.daq.realtime_priority import set_realtime_priority
from seatrial.daq.rig import DRIVES, Rig
from seatrial.daq.samples import NAN, Event, Frame, PortHealth
from seatrial.daq.transport import make_port

# Wall seconds.
STATUS_S = 0.05  # between two reports of the status
SILENCE_S = 0.25  # longest time without a heartbeat of the parent while thrust is commanded
RECORD_ON_S = 1.0  # recording goes on for so long after a stop that the parent did not request
RETURN_S = 3.0  # longest wait for a lost port of a thruster to come back and receive its zero

UNRESPONSIVE = "(it hangs, or the computer is too busy: end other programs)"

BATCH = 100  # samples in one message to the parent: about 25 kB, which a writable socket accepts without blocking


class Process:
    """Acquisition process: it records all devices of a rig, commands their thrusters, and obeys its parent process.

    Parameters
    ----------
    link : AcquisitionChannel
        Socket to the parent.
    rig : Rig
        The rig with its devices and thrusters.
    recorder : Recorder
        The open log.
    clock : RunClock
        The run clock, which the parent shares.
    role : LinkRole
        Role towards autopilots: listen, request rates and parameters, or drive.
    heartbeat : Heartbeat, optional
        Sender of heartbeats to the watchdog; None if no thrust will be commanded.
    terminal : int
        File descriptor of the parent's standard error; -1 if it has none.
    """

    def __init__(
        self,
        link: AcquisitionChannel,
        rig: Rig,
        recorder: Recorder,
        clock: RunClock,
        role: LinkRole,
        heartbeat: Heartbeat | None = None,
        terminal: int = -1,
    ) -> None:
        """Prepare the threads of all ports and of the log. No thread is started, and no port is opened.

        `link` is the socket to the parent, `recorder` the open log, and `clock` the run clock. `role` is whether
        autopilots are only listened to, asked for data, or driven. `heartbeat` sends to the watchdog; None if no thrust
        will be commanded. `terminal` is the file descriptor of the parent's standard error; -1 without one.
        """
        self._role, self._terminal = role, terminal
        self._parent = os.getppid()
        self._path = recorder.path
        self._link, self._rig, self._clock, self._heartbeat = link, rig, clock, heartbeat
        self._sink = LogSink()
        self._setpoints = {device.name: Setpoints() for device in rig.devices if device.protocol in DRIVES}
        self._loops = {device.name: self._make_loop(device.name) for device in rig.devices}
        self._writer = LogThread(recorder, self._sink, self._port_counters, clock)
        path = str(self._path)
        self._reporter = StatusReporter(
            link, rig, path, clock, self._loops, self._setpoints, self._writer, self._log_event
        )
        self._parent_seen = self._runner_seen = time.monotonic()
        self._terminated = False
        self._stopped = ""  # why this process stopped thrust; thrust can start again only with a new run
        self._thrust = threading.RLock()  # held while thrust is stopped or commanded
        self._end_reason = ""
        self._unrequested = self._parent_hangs = False

    def terminate(self, number: int, frame: FrameType | None) -> None:
        """Handle the signal SIGTERM: store that the acquisition has to end.

        The main thread then ends it at its next check of time-outs. `number` and `frame` are not used.
        """
        self._terminated = True

    def run(self) -> None:
        """Run the acquisition until there is a reason to end, then command zero and close the log.

        The reasons are: the parent requests the end or is gone, the parent hangs while thrust is commanded, SIGTERM, or
        an error. Each port and the log have a thread of their own, which this method starts and ends.
        """
        self._writer.start()
        for loop in self._loops.values():
            loop.start()
        try:
            self._serve()
        except Exception as error:  # a programming error must not leave thrust on
            self._request_end(f"internal error ({type(error).__name__}: {error}): report it", unrequested=True)
        self._shut_down()

    def _serve(self) -> None:
        """Serve the parent and the watchdog until there is a reason to end, which is stored in `_end_reason`.

        Status and logged samples are sent to the parent every 50 ms (STATUS_S). Meanwhile messages of the parent are
        handled, time-outs are checked, and heartbeats are sent to the watchdog.
        """
        status_at = 0.0
        while not self._end_reason:
            now = time.monotonic()
            if now >= status_at:
                status_at = now + STATUS_S
                self._report_status()
                self._send_samples()
            ready, _, _ = select.select([self._link], [], [], max(status_at - time.monotonic(), 0.0))
            if ready:
                self._receive_messages()
            self._check_timeouts()
            self._send_heartbeat()

    def _make_loop(self, name: str) -> DeviceLoop:
        """Return a new thread that will serve the port of the device `name`, with its decoder and driver.

        The thread is not started.
        """
        device = self._rig.device(name)
        decoder = make_decoder(device, self._rig)
        return DeviceLoop(
            device,
            make_port(device),
            decoder,
            self._clock,
            self._sink,
            self._setpoints.get(name),
            make_driver(device, self._rig, decoder, self._role_of(name)),
            self._stop_thrust,
        )

    def _role_of(self, name: str) -> LinkRole:
        """Return the role of this process towards the autopilot `name`: listen, request data, or drive.

        It is the role of the process, but towards an autopilot that drives no thruster the role is at most to request
        data. Heartbeats of a driving ground station would hide from that autopilot that the heartbeats of the
        operator's station are missing.
        """
        drives = self._role is not LinkRole.DRIVE or any(thruster.device == name for thruster in self._rig.thrusters)
        return self._role if drives else LinkRole.ASK

    def _receive_messages(self) -> None:
        """Receive the waiting messages of the parent and handle them in their order.

        If the parent has closed the socket, request the end of the acquisition.
        """
        try:
            messages = self._link.receive()
        except EOFError:
            self._request_end("the program that started the acquisition has ended", unrequested=True)
            return
        for message in messages:
            self._parent_seen = time.monotonic()
            self._handle_message(message)

    def _send_heartbeat(self, at_once: bool = False) -> None:
        """Send a heartbeat to the watchdog, unless the thread of a port hangs. Stop thrust if the watchdog has failed.

        If the last heartbeat said that thrust is commanded and no other follows, the watchdog kills this process and
        sends zero itself. The heartbeat contains whether thrust is commanded, or zero not yet repeated. With `at_once`
        it is sent even if the last one was sent a moment ago. Without a watchdog, or if a thread hangs, nothing
        happens. Thrust is stopped only while it is commanded or scheduled.
        """
        now = time.monotonic()
        if self._heartbeat is None or any(loop.is_stuck(now) for loop in self._loops.values()):
            return
        # The watchdog must monitor until zero was sent and repeated, and not only until zero is commanded.
        self._heartbeat.beat(not all(s.is_settled(now) for s in self._setpoints.values()), now, at_once)
        active = any(setpoints.active for setpoints in self._setpoints.values())
        if self._heartbeat.trouble and active and not self._stopped:
            self._stop_thrust(self._heartbeat.trouble)

    def _check_timeouts(self) -> None:
        """Request the end of the acquisition, or stop thrust, after a time-out or a failure.

        The end is requested after SIGTERM and after a failure of the log. Two further checks apply only while thrust is
        commanded or scheduled. The end is requested if no message of the parent, or no heartbeat of the mission's
        runner, has arrived for 0.25 s (SILENCE_S, wall). Thrust is stopped, but recording goes on, if no data can be
        written to the log at present. The method must be called after messages were received, so that a pause of this
        process does not count as one of the parent.
        """
        now = time.monotonic()
        if self._terminated:
            active = any(setpoints.active for setpoints in self._setpoints.values())
            self._request_end("the acquisition process was told to end (SIGTERM)", unrequested=active)
        if self._writer.failure:
            self._request_end(self._writer.failure, unrequested=False)
        if self._writer.alarm and not self._stopped and any(s.active for s in self._setpoints.values()):
            self._stop_thrust(self._writer.alarm)  # an unrecorded run has no use that justifies its risk
        if any(setpoints.active for setpoints in self._setpoints.values()):
            if now - self._parent_seen > SILENCE_S:
                self._parent_hangs = True
                self._request_end(
                    f"the program that started the acquisition has not responded for {SILENCE_S} s {UNRESPONSIVE}",
                    unrequested=True,
                )
            elif now - self._runner_seen > SILENCE_S:
                self._parent_hangs = True
                self._request_end(
                    f"the program that runs the mission has not responded for {SILENCE_S} s {UNRESPONSIVE}",
                    unrequested=True,
                )

    def _request_end(self, reason: str, unrequested: bool) -> None:
        """Store the `reason` to end the acquisition, upon which the main loop ends. Only the first reason counts.

        With `unrequested`, recording goes on for 1 s, and the end is logged as "stop" instead of "end". This is for an
        end that the parent did not request.
        """
        if not self._end_reason:
            self._end_reason, self._unrequested = reason, unrequested

    def _handle_message(self, message: Message) -> None:
        """Do what a message of the parent requests.

        The requests are to schedule set-points, to command zero, to log an event, to pass a request on to an autopilot,
        to send samples, and to end. A heartbeat is stored. Messages of other types are ignored.
        """
        match message:
            case ParentAlive():
                self._runner_seen = self._parent_seen if message.runner else self._runner_seen
            case ScheduleSetpoints():
                self._append_setpoints(message)
            case ZeroThrust():
                self._command_zero()
                self._log_event("zero", message.reason)
            case LogEvent():
                self._log_event(message.kind, message.text)
            case DriverRequest():
                self._loops[message.device].request(message.action, message.value)
            case StreamSamples():
                self._writer.stream = self._writer.stream or SampleStream()
            case Stop():
                self._request_end(message.reason, unrequested=False)

    def _append_setpoints(self, message: ScheduleSetpoints) -> None:
        """Append set-points of the parent to the schedules of the devices, and wake the threads of their ports.

        A schedule belongs to one device and has the commands by node; the parent sends them by name of the thruster.
        The set-points are ignored after this process has stopped thrust by itself. In each case the message counts as a
        heartbeat of the mission's runner.
        """
        self._runner_seen = self._parent_seen
        nodes = {thruster.name: (thruster.device, thruster.node) for thruster in self._rig.thrusters}
        rows: dict[str, list[tuple[float, dict[int, float]]]] = {}
        for t, row in message.rows:
            by_device: dict[str, dict[int, float]] = {}
            for name, n in row.items():
                device, node = nodes[name]
                by_device.setdefault(device, {})[node] = n
            for device, part in by_device.items():
                rows.setdefault(device, []).append((t, part))
        with self._thrust:
            if self._stopped:
                return  # the parent sent these rows before it knew of the stop
            for device, device_rows in rows.items():
                self._setpoints[device].append(device_rows)
                self._loops[device].wake()

    def _port_counters(self) -> dict[str, PortHealth]:
        """Return the counters of each port since the start of the log, by name of the device."""
        return {name: loop.health() for name, loop in self._loops.items()}

    def _command_zero(self) -> None:
        """Discard all scheduled set-points and command zero to all thrusters, which the ports' threads send at once.

        Thrusters that never had a command get none. The method does not wait until zero was sent.
        """
        for name, setpoints in self._setpoints.items():
            setpoints.zero(time.monotonic())
            self._loops[name].wake()

    def _stop_thrust(self, reason: str) -> None:
        """Command zero to all thrusters without a request of the parent, and go on with the recording.

        Later set-points of this run are ignored. The `reason` is logged as an event. The status reports only the first
        reason. Any thread may call this method.
        """
        with self._thrust:
            self._stopped = self._stopped or reason
            self._command_zero()
        self._log_event("stop", reason)

    def _log_event(self, kind: str, text: str) -> None:
        """Put an event, with the present run time, into the queue of the log, from which it is written.

        `kind` is a word such as "stop", and `text` describes the event in one line. The event is lost if the queue is
        full.
        """
        t = self._clock.now()
        self._sink.put(LogItem("", "", b"", t, [(Frame(Event(kind, text), t, NAN), t)]))

    def _shut_down(self) -> None:
        """Command zero, wait until zero was repeated, end all threads, close the log and report the end to the parent.

        The wait for zero takes at most about 3 s (`_may_close`), and the heartbeats to the watchdog go on meanwhile.
        Autopilots that this run has armed are disarmed. After an unrequested end this method prints the last line of
        the run if the parent is gone or hangs, and therefore cannot print it.
        """
        self._command_zero()
        self._send_heartbeat(at_once=True)
        self._report_status()
        self._log_event("stop" if self._unrequested else "end", self._end_reason)
        for loop in self._loops.values():
            loop.request("leave", 0.0)
        begun = time.monotonic()
        while not self._may_close(time.monotonic() - begun):
            time.sleep(WRITE_S)
            self._send_heartbeat()
        for loop in self._loops.values():
            loop.end()
        for loop in self._loops.values():
            loop.join()
        if self._heartbeat is not None:
            self._heartbeat.end()
        self._reporter.note_skipped()
        self._writer.end()
        self._writer.join()
        self._report_status()
        with contextlib.suppress(OSError):  # the parent may be gone
            why = self._writer.failure
            self._link.send(Failed(why) if why else Closed(self._end_reason))
        if self._unrequested and (self._parent_hangs or os.getppid() != self._parent):
            self._print_last_line()

    def _print_last_line(self) -> None:
        """Print the reason for the end and the path of the log to the terminal, because the parent cannot print it.

        For a run with thrust, the line also says that zero was sent but is not confirmed. Nothing is printed if the
        terminal is closed or does not accept the text at once.
        """
        unconfirmed = "zero thrust was sent, not confirmed: make sure that the propellers stand still; "
        thrust = unconfirmed if self._setpoints and self._role is LinkRole.DRIVE else ""
        text = f"seatrial: {self._end_reason}; {thrust}the log is {printable(str(self._path))}\n"
        # A terminal or pipe that nobody reads must not block this process. One line always fits into a writable pipe.
        with contextlib.suppress(OSError, ValueError):
            if select.select([], [self._terminal], [], 0.0)[1]:
                os.write(self._terminal, text.encode(errors="replace"))

    def _may_close(self, since: float) -> bool:
        """Return whether the log may be closed, `since` wall seconds after the end of the run.

        Zero must have been repeated on every port of a thruster, or 3 s (`RETURN_S`) must have passed. After a stop
        that the parent did not request, 1 s (`RECORD_ON_S`) must have passed too, unless the log has failed.
        """
        if self._unrequested and since < RECORD_ON_S and not self._writer.failure:
            return False
        now = time.monotonic()
        return since > RETURN_S or all(loop.is_at_zero(now) for loop in self._loops.values())

    def _send_samples(self) -> None:
        """Send the samples that were logged since the last call to the parent, if it has requested samples.

        A message has up to 100 samples (BATCH). The method never waits for a parent that does not read, because this
        thread also checks the time-outs; the samples then stay in the queue. Samples for a parent that is gone are
        lost.
        """
        if (stream := self._writer.stream) is None:
            return
        for _ in range(0, stream.waiting, BATCH):
            if not select.select([], [self._link], [], 0.0)[1]:
                return
            with contextlib.suppress(OSError):  # if the parent is gone, the next status report fails and ends the run
                self._link.send(SampleBatch(stream.take(BATCH), stream.dropped))

    def _report_status(self) -> None:
        """Send the status to the parent, and write new warnings to the log.

        If the parent is gone, request the end of the acquisition.
        """
        try:
            self._reporter.report(self._stopped, self._end_reason if self._unrequested else "")
        except OSError:
            self._request_end("the program that started the acquisition has ended", unrequested=True)


def _connect_watchdog(rig: Rig, path: Path) -> Heartbeat:
    """Wait until the watchdog process is ready, and return the sender of heartbeats to it.

    `rig` has the thrusters, and `path` is that of the log. The file descriptor of the socket to the watchdog is the
    second argument of this process. Raise SeatrialError if the watchdog does not start within 20 s or cannot work.
    """
    try:
        return Heartbeat(socket.socket(fileno=int(sys.argv[2])), rig, path)
    except (OSError, EOFError) as error:
        why = str(error) or "it ended"
        raise SeatrialError(
            f"the watchdog process did not start ({why}), and no thrust is commanded without it; remove the cause, "
            "or check the limits of the operating system on memory and processes"
        ) from error


def main() -> None:
    """Run the acquisition process: receive the configuration from the parent, open the log, and record until the end.

    The arguments of the process are the file descriptors of the sockets to the parent and, if thrust will be commanded,
    to the watchdog. If the log cannot be opened, or there is no watchdog, this is reported to the parent as a `Failed`
    message.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    link = AcquisitionChannel(socket.socket(fileno=int(sys.argv[1])))
    begin = link.receive_first()
    assert isinstance(begin, Configuration)
    clock = RunClock(begin.speed, (begin.origin[0], begin.origin[1]))
    rig = parse_rig(begin.rig_text, Path(begin.rig_path))
    try:
        path = Path(begin.path)
        check_keys(rig)
        check_room(path, rig.segments.free_megabytes)
        recorder = Recorder(
            path, rig=rig, clock=clock, attachments=begin.attachments, metadata=begin.metadata, patient=True
        )
        try:
            heartbeat = _connect_watchdog(rig, path) if len(sys.argv) > 2 else None
            process = Process(link, rig, recorder, clock, LinkRole(begin.role), heartbeat, begin.terminal)
        except BaseException:
            recorder.discard()  # nothing was recorded, and the next start may have the same name
            raise
    except SeatrialError as error:
        link.send(Failed(str(error)))
        return
    signal.signal(signal.SIGTERM, process.terminate)
    sys.setswitchinterval(0.0005)  # threads switch often enough for set-points a millisecond apart
    gc.freeze()  # the garbage collector skips all objects so far, which shortens its pauses
    set_realtime_priority()  # a busy machine must not delay times of receipt and set-points
    process.run()


if __name__ == "__main__":
    main()
