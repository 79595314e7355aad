"""The watchdog: a separate process that commands zero thrust when the acquisition process hangs or dies.

The acquisition process sends it a heartbeat every 50 ms: thrust is commanded, or not. When the heartbeats stop while
thrust is commanded, the watchdog kills the process, opens the thrusters' ports itself and sends zero; it writes what it
did and why to `LOG.stop`, since no process writes the log any more. Started by
`seatrial.daq.acquisition.session.Acquisition` as `python -m seatrial.daq.acquisition.watchdog FD`. See
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
HANG_S = 0.6  # without a heartbeat: more than a busy machine pauses, less than the second of most ESCs
POLL_S = 0.02
HEARTBEAT_S = 0.02  # between heartbeats, at least
READY_S = 20.0
OPEN_S = 3.0  # for a port to be free again
ZERO_S = 1.0  # zero is sent for so long
ANSWER_S = 1.0  # for the watchdog to answer a heartbeat

READ_BYTES = 4096


class Heartbeat:
    """The acquisition's side. Raises nothing while thrust is commanded: `trouble` says why the watchdog cannot help.

    Each side hears the other: the watchdog answers what it gets, and when it has answered nothing for `ANSWER_S` it
    hangs (stopped, swapped out) and would not step in.
    """

    def __init__(self, sock: socket.socket, rig: Rig, log: Path) -> None:
        """Return when the watchdog is ready. Raises OSError or EOFError when it does not start, else SeatrialError."""
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
        """Send a heartbeat, whether thrust is commanded, and hear the answers to earlier ones."""
        if at_once or now >= self._next:
            self._next = now + HEARTBEAT_S
            self._send(ACTIVE if active else IDLE)
            self._hear(now)

    def _hear(self, now: float) -> None:
        with contextlib.suppress(OSError):
            if self._socket.recv(READ_BYTES):
                self._unanswered_since = math.inf
        paused = now - self._looked > 0.5 * ANSWER_S  # a pause of this process: the answer may have been there in time
        self._unanswered_since = now if paused else min(self._unanswered_since, now)
        self._looked = now
        if now - self._unanswered_since > ANSWER_S:
            self.trouble = f"the watchdog has not answered for {ANSWER_S:g} s"

    def end(self) -> None:
        """End the monitoring: the thrusters are at zero and the ports will be closed."""
        self._send(FINISHED)

    def _send(self, word: bytes) -> None:
        try:
            self._socket.send(word)
        except BlockingIOError:
            return  # it has not read for so long that it hangs itself; it will find out when it goes on
        except OSError:
            self.trouble = "the watchdog is gone"


class HeartbeatMonitor:
    """Decides from the heartbeats when to step in. Reads no clock."""

    def __init__(self, now: float) -> None:
        self._last_heartbeat = self._looked = now
        self._active = False

    def look(self, now: float, words: bytes | None) -> str | None:
        """Take the bytes read (None: the socket is closed). Returns a reason to step in, "" to end, else None."""
        if (pause := now - self._looked) > 3 * POLL_S:
            self._last_heartbeat += pause - POLL_S  # of this process, which counts as one look: pauses come to an end
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
    """Sends zero to the thrusters on one port, as soon as it can be opened."""

    def __init__(self, device: Device, rig: Rig) -> None:
        super().__init__(name=f"failsafe {device.name}")
        self._device, self._rig = device, rig
        self._thrusters = [thruster for thruster in rig.thrusters if thruster.device == device.name]
        self.outcome = "not tried"
        self._port: Port = make_port(device)
        self._driver: DeviceDriver | None = None
        self._decoder: Decoder | None = None
        if device.protocol != "vesc":
            self._prepare()
            self._zero()  # whatever has to be loaded for it is loaded now
        else:
            self._frames = b"".join(pack_can(*vesc.encode_duty(t.node, 0.0)) for t in self._thrusters)

    def _prepare(self) -> None:
        """A decoder and a driver that begin now: a signature of long ago is refused."""
        from seatrial.daq.drivers import LinkRole, make_driver
        from seatrial.daq.protocol import make_decoder

        self._decoder = make_decoder(self._device, self._rig)
        self._driver = make_driver(self._device, self._rig, self._decoder, LinkRole.RESCUE)

    def _zero(self) -> bytes:
        if self._driver is None:
            return self._frames
        return b"".join(data for data, _ in self._driver.zero(time.monotonic()))

    def run(self) -> None:
        """Open, send zero for a second, close."""
        deadline = time.monotonic() + OPEN_S
        if self._driver is not None:
            with contextlib.suppress(SeatrialError):  # a key file that is gone: what was prepared first has the key
                self._prepare()
        while True:
            try:
                self._port.take_over()
                self._send_zero()
                self.outcome = "zero was sent" + ("" if self._driver is None else self._driver.confirmation)
            except PortError as error:
                self.outcome = str(error)
                if time.monotonic() < deadline:
                    time.sleep(POLL_S)
                    continue
            break
        self._port.close()

    def _send_zero(self) -> None:
        until = time.monotonic() + ZERO_S
        while time.monotonic() < until:
            ready, _, _ = select.select([self._port.fileno()], [], [], POLL_S)
            if ready:
                data = self._port.read()
                if self._decoder is not None:  # a listening UDP port learns the address to answer from this
                    decode_read(self._port, self._decoder, data, 0.0)
            self._port.write(self._zero())


def main() -> None:
    """Receive the rig from the acquisition process, then monitor it."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # it ends when what it watches has ended well
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
    set_realtime_priority()  # all of its life it waits, and when it does not it is urgent
    link.send(WatchdogReady())
    reason = _watch(sock, timer)
    if reason:
        _step_in(config.pid, Path(config.log), reason, senders)
    if timer is not None:
        timer.close()


def _watch(sock: socket.socket, timer: HardwareWatchdog | None = None) -> str:
    """Monitor until there is a reason to step in; empty when the acquisition process has finished."""
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
            with contextlib.suppress(OSError):  # it does not read any more: nobody is there to be answered
                sock.send(ANSWER)
        if timer is not None:
            timer.beat(time.monotonic())
        found = watch.look(time.monotonic(), words)
        if found is not None:
            return found


def _step_in(pid: int, log: Path, reason: str, senders: list[FailsafeSender]) -> None:
    """Kill the process that hangs, send zero, and write down why."""
    if "died" not in reason:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(pid, signal.SIGKILL)  # its end of the socket is open: it is there, and the number is its own
    for sender in senders:
        sender.start()
    # Thrust ends before anything is written: a disk may be full, or keep a write waiting.
    said = f"{time.strftime('%Y-%m-%dT%H:%M:%SZ', time.gmtime())} watchdog: {reason}"
    write_note(log, said)
    for sender in senders:
        sender.join()
    outcome = ", ".join(f"{sender.name.removeprefix('failsafe ')}: {sender.outcome}" for sender in senders)
    write_note(log, f"{said}; {outcome}")


if __name__ == "__main__":
    main()
