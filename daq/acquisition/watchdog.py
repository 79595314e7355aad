"""Watchdog: a separate process that commands zero thrust if the acquisition process hangs or dies.

The acquisition process sends it heartbeats, which contain whether thrust is commanded. If the heartbeats stop while
thrust is commanded, the watchdog kills the acquisition process, opens the ports of the thrusters and sends zero. It
writes the reason and the outcome to `LOG.stop`, because no process writes the log any more.

`seatrial.daq.acquisition.session.Acquisition` starts it as `python -m seatrial.daq.acquisition.watchdog FD`. See
docs/decisions/0013-a-watchdog-behind-the-deadman.md.
"""

from __future__ import annotations

import contextlib
import math
import os
import select
import signal
import socket
import sys
import threading
import time
from pathlib import Path

from seatrial.daq.acquisition.hardware_watchdog import HardwareWatchdog
from seatrial.daq.acquisition.ipc import (
    ACTIVE,
    ANSWER,
    FINISHED,
    IDLE,
    AcquisitionChannel,
    WatchdogConfiguration,
    WatchdogReady,
)
from seatrial.daq.config import parse_rig
from seatrial.daq.drivers import DeviceDriver
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import write_note
from seatrial.daq.protocol import Decoder, pack_can, vesc
from seatrial.daq.realtime_priority import set_realtime_priority
from seatrial.daq.rig import DRIVES, Device, Rig
from seatrial.daq.transport import Port, PortError, decode_read, make_port

# Wall seconds.
# Longest time without a heartbeat: longer than pauses of a busy machine, shorter than the time-out of most ESCs (1 s).
HANG_S = 0.6
POLL_S = 0.02
HEARTBEAT_S = 0.02  # shortest time between heartbeats
READY_S = 20.0  # longest start of the watchdog
OPEN_S = 3.0  # longest wait for a port to be free again
ZERO_S = 1.0  # duration for which zero is sent
ANSWER_S = 1.0  # longest wait for an answer to heartbeats

READ_BYTES = 4096


class Heartbeat:
    """Sender of heartbeats from the acquisition process to the watchdog process, with a check of its answers.

    Only the constructor raises errors. Later failures are stored in `trouble`. The watchdog counts as hanging if it
    does not answer for 1 s (`ANSWER_S`, wall).

    Attributes
    ----------
    trouble : str
        Why the watchdog could not command zero in an emergency; empty while it works. Later answers do not clear it.
    """

    def __init__(self, sock: socket.socket, rig: Rig, log: Path) -> None:
        """Send the rig to the watchdog process, and wait for up to 20 s (`READY_S`, wall) until it is ready.

        Parameters
        ----------
        sock : socket.socket
            Connection to the watchdog.
        rig : Rig
            The rig whose thrusters the watchdog brings to zero.
        log : Path
            Path of the log. In an emergency the watchdog writes a note beside it.

        Raises
        ------
        OSError, EOFError
            If the watchdog does not start in this time or ends.
        SeatrialError
            If the watchdog reports that it cannot work.
        """
        self.trouble = ""
        self._socket = sock
        self._next = self._looked = -math.inf
        self._unanswered_since = math.inf
        sock.settimeout(READY_S)
        link = AcquisitionChannel(sock)
        link.send(WatchdogConfiguration(rig.text, str(rig.path), os.getpid(), str(log.absolute())))
        answer = link.receive_first()
        if isinstance(answer, WatchdogReady) and answer.trouble:
            raise SeatrialError(answer.trouble)
        sock.setblocking(False)

    def beat(self, active: bool, now: float, at_once: bool = False) -> None:
        """Send a heartbeat to the watchdog, and read its answers to earlier heartbeats.

        Nothing is done if the last heartbeat is less than 20 ms (`HEARTBEAT_S`, wall) old. Failures set `trouble`.

        Parameters
        ----------
        active : bool
            Whether the watchdog must command zero if further heartbeats are missing: thrust is commanded.
        now : float
            Monotonic time [s].
        at_once : bool
            Whether to send even if the last heartbeat is less than 20 ms old.
        """
        if at_once or now >= self._next:
            self._next = now + HEARTBEAT_S
            self._send(ACTIVE if active else IDLE)
            self._hear(now)

    def _hear(self, now: float) -> None:
        """Read the watchdog's answers to the heartbeats. Set `trouble` if there was none for 1 s (`ANSWER_S`, wall).

        `now` is the present monotonic time [s]. The method does not wait; any bytes count as an answer. If more than
        0.5 s have passed since the last call, this process itself was stopped, and the time without an answer counts
        from now.
        """
        with contextlib.suppress(OSError):
            if self._socket.recv(READ_BYTES):
                self._unanswered_since = math.inf
        paused = now - self._looked > 0.5 * ANSWER_S  # after a pause of this process the time is counted anew
        self._unanswered_since = now if paused else min(self._unanswered_since, now)
        self._looked = now
        if now - self._unanswered_since > ANSWER_S:
            self.trouble = (
                f"the watchdog has not answered for {ANSWER_S:g} s: the computer is too busy; end other programs"
            )

    def end(self) -> None:
        """Report to the watchdog that the acquisition process ends, so that it must not be monitored any more.

        The thrusters must be at zero. The call does not wait. If the watchdog is gone, `trouble` is set.
        """
        self._send(FINISHED)

    def _send(self, word: bytes) -> None:
        """Send a heartbeat of one byte to the watchdog, without waiting. Set `trouble` if the watchdog is gone.

        `word` is `ACTIVE` (thrust is commanded), `IDLE` (no thrust) or `FINISHED` (the process ends). A full buffer is
        ignored.
        """
        try:
            self._socket.send(word)
        except BlockingIOError:
            return  # the watchdog has not read for a long time; `_hear` then sets `trouble`
        except OSError:
            self.trouble = (
                "the watchdog is gone (seatrial's second process, which ends thrust if the first fails); run again"
            )


class HeartbeatMonitor:
    """Monitor of heartbeats from the acquisition process: it decides when the watchdog must command zero.

    It reads no clock.

    Parameters
    ----------
    now : float
        Monotonic time [s], from which the time without a heartbeat counts at first.
    """

    def __init__(self, now: float) -> None:
        """Start to monitor at monotonic time `now` [s]. No heartbeat was received yet, and no thrust is commanded."""
        self._last_heartbeat = self._looked = now
        self._active = False

    def look(self, now: float, words: bytes | None) -> str | None:
        """Process the heartbeats that the watchdog has received, and decide whether it must step in and command zero.

        The watchdog steps in only while thrust is commanded, and then if the socket is closed, or after 0.6 s
        (`HANG_S`, wall) without a heartbeat. A pause of the watchdog itself does not count.

        Parameters
        ----------
        now : float
            Monotonic time [s].
        words : bytes or None
            Heartbeats as bytes: `ACTIVE` (thrust is commanded), `IDLE` or `FINISHED`; empty if none has arrived. Of
            several, the last one counts, but a `FINISHED` anywhere ends the monitoring. None if the socket is closed.

        Returns
        -------
        str or None
            The reason to step in; an empty string if the monitoring is over (the acquisition process has finished, or
            its socket is closed without thrust); None to go on.
        """
        if (pause := now - self._looked) > 3 * POLL_S:
            # A pause of the watchdog itself counts only as one poll, since heartbeats may wait unread.
            self._last_heartbeat += pause - POLL_S
        self._looked = now
        if words is None:
            return "the acquisition process died while thrust was commanded" if self._active else ""
        if words:
            if FINISHED in words:
                return ""
            self._last_heartbeat, self._active = now, words[-1:] == ACTIVE
        if self._active and now - self._last_heartbeat > HANG_S:
            return f"the acquisition process gave no sign of life for {HANG_S:g} s while thrust was commanded"
        return None


class FailsafeSender(threading.Thread):
    """Thread of the watchdog that sends zero to the thrusters of one device, as soon as its port can be opened.

    Parameters
    ----------
    device : Device
        The device with the port.
    rig : Rig
        The rig with its thrusters.

    Attributes
    ----------
    outcome : str
        Result in words. It is "not tried" at first, and the last error of the port after a failure. After success it is
        "zero thrust was sent", and after that whether the device has confirmed this (`DeviceDriver.confirmation`).
    """

    def __init__(self, device: Device, rig: Rig) -> None:
        """Prepare the thread that sends zero to the thrusters of one device in an emergency.

        It is not started, and the port is not opened. All modules that it needs are loaded now.
        """
        super().__init__(name=f"failsafe {device.name}")
        self._device, self._rig = device, rig
        self._thrusters = [thruster for thruster in rig.thrusters if thruster.device == device.name]
        self.outcome = "not tried"
        self._port: Port = make_port(device)
        self._driver: DeviceDriver | None = None
        self._decoder: Decoder | None = None
        if device.protocol != "vesc":
            self._prepare()
            self._zero()  # loads all modules now, so that none has to be loaded in an emergency
        else:
            self._frames = b"".join(pack_can(*vesc.encode_duty(t.node, 0.0)) for t in self._thrusters)

    def _prepare(self) -> None:
        """Make and store a new encoder and decoder of the device's messages (driver and decoder).

        They are made again before zero is sent, because an autopilot refuses an old MAVLink signature. Raise
        SeatrialError if the signing key of the autopilot cannot be read; the earlier driver then stays.
        """
        from seatrial.daq.drivers import LinkRole, make_driver
        from seatrial.daq.protocol import make_decoder

        self._decoder = make_decoder(self._device, self._rig)
        self._driver = make_driver(self._device, self._rig, self._decoder, LinkRole.RESCUE)

    def _zero(self) -> bytes:
        """Return the bytes that command zero to all thrusters of the port, in the protocol of the device.

        They are made anew for each call, except for VESC controllers, whose bytes are always the same.
        """
        if self._driver is None:
            return self._frames
        return b"".join(data for data, _ in self._driver.zero(time.monotonic()))

    def run(self) -> None:
        """Open the port, send zero to its thrusters for 1 s (`ZERO_S`), and close the port (code of the thread).

        After an error of the port this is tried again, until 3 s (`OPEN_S`) have passed since the start. All times are
        wall seconds. The result is stored in `outcome`.
        """
        deadline = time.monotonic() + OPEN_S
        if self._driver is not None:
            with contextlib.suppress(SeatrialError):  # if the key file is gone, the first driver still has the key
                self._prepare()
        while True:
            try:
                self._port.take_over()
                self._send_zero()
                self.outcome = "zero thrust was sent" + ("" if self._driver is None else self._driver.confirmation)
            except PortError as error:
                self.outcome = str(error)
                if time.monotonic() < deadline:
                    time.sleep(POLL_S)
                    continue
            break
        self._port.close()

    def _send_zero(self) -> None:
        """Send zero to the thrusters of the port repeatedly for 1 s (`ZERO_S`, wall), and decode replies meanwhile.

        Zero is sent every 20 ms (`POLL_S`), and after each reply. The replies may contain the confirmation of an
        autopilot. Raise PortError if the port fails.
        """
        until = time.monotonic() + ZERO_S
        while time.monotonic() < until:
            ready, _, _ = select.select([self._port.fileno()], [], [], POLL_S)
            if ready:
                data = self._port.read()
                if self._decoder is not None:  # a listening UDP port obtains the address to answer to
                    decode_read(self._port, self._decoder, data, 0.0)
            self._port.write(self._zero())


def main() -> None:
    """Run the watchdog process: receive the rig from the acquisition process, and monitor that process until it ends.

    The argument of this process is the file descriptor of the socket. If the acquisition process dies or hangs while
    thrust is commanded, zero is sent to its thrusters. If the hardware watchdog of the rig cannot be opened, this is
    reported to the acquisition process, and the watchdog ends. Ctrl-C, SIGTERM and SIGHUP are ignored.
    """
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # the watchdog ends only when the acquisition process has ended
    sock = socket.socket(fileno=int(sys.argv[1]))
    link = AcquisitionChannel(sock)
    config = link.receive_first()
    assert isinstance(config, WatchdogConfiguration)
    rig = parse_rig(config.rig_text, Path(config.rig_path))
    driven = [d for d in rig.devices if d.protocol in DRIVES and any(t.device == d.name for t in rig.thrusters)]
    senders = [FailsafeSender(device, rig) for device in driven]
    try:
        timer = None if rig.hardware_watchdog is None else HardwareWatchdog(rig.hardware_watchdog)
    except OSError as error:
        why = f"hardware_watchdog {rig.hardware_watchdog} cannot be opened ({error.strerror})"
        remedy = "give this user the right to write to it, or take the key out of the rig"
        link.send(WatchdogReady(f"{rig.path}: {why}: {remedy}"))
        return
    set_realtime_priority()  # it waits nearly all the time, and when it acts it is urgent
    link.send(WatchdogReady())
    reason = _watch(sock, timer)
    if reason:
        _step_in(config.pid, Path(config.log), reason, senders)
    if timer is not None:
        timer.close()


def _watch(sock: socket.socket, timer: HardwareWatchdog | None = None) -> str:
    """Monitor the acquisition process until it ends or hangs, and answer its heartbeats.

    Parameters
    ----------
    sock : socket.socket
        Connection to the acquisition process.
    timer : HardwareWatchdog, optional
        Watchdog timer of the computer, whose time-out is restarted meanwhile; None if the rig names none.

    Returns
    -------
    str
        Why the watchdog must command zero: the process died or hangs under thrust. It is empty if the process has
        finished, or has died without thrust.
    """
    sock.setblocking(False)
    watch = HeartbeatMonitor(time.monotonic())
    while True:
        ready, _, _ = select.select([sock], [], [], POLL_S)
        words: bytes | None = b""
        if ready:
            try:
                words = sock.recv(READ_BYTES) or None
            except BlockingIOError:
                words = b""
            except OSError:
                words = None
        if words:
            with contextlib.suppress(OSError):  # the process has died, or does not read any more
                sock.send(ANSWER)
        if timer is not None:
            timer.beat(time.monotonic())
        found = watch.look(time.monotonic(), words)
        if found is not None:
            return found


def _step_in(pid: int, log: Path, reason: str, senders: list[FailsafeSender]) -> None:
    """Act in an emergency: kill the acquisition process if it hangs, send zero to all thrusters, and write a note.

    The note contains the time, the reason, and later the outcome of each port.

    Parameters
    ----------
    pid : int
        Process id of the acquisition process.
    log : Path
        Path of the log, LOG. The note is the file `LOG.stop`.
    reason : str
        Reason that `HeartbeatMonitor.look` has returned. If it contains "died", no process is killed.
    senders : list of FailsafeSender
        One sender for each port with thrusters; their threads are started here.
    """
    if "died" not in reason:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(pid, signal.SIGKILL)  # its end of the socket is open, so that the process id is still its own
    for sender in senders:
        sender.start()
    # Thrust ends before the note is written, because the disk may be full or may block the write.
    note = f"{time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())} watchdog: {reason}"
    write_note(log, note)
    for sender in senders:
        sender.join()
    outcome = ", ".join(f"{sender.name.removeprefix('failsafe ')}: {sender.outcome}" for sender in senders)
    write_note(log, f"{note}; {outcome}")


if __name__ == "__main__":
    main()
