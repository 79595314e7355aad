"""The watchdog: a process of its own that takes thrust away when the acquisition process hangs or dies.

The acquisition process sends it a pulse every 50 ms: thrust is commanded, or not. When the pulses stop while thrust is
commanded, the watchdog kills what hangs, opens the thrusters' ports itself and says zero; what it did and why stands
in `LOG.stop`, since nobody writes the log any more. Started by `daq.acquisition.session.Acquisition` as
`python -m daq.acquisition.watchdog FD`; it ends with a goodbye. See
docs/decisions/0013-a-watchdog-behind-the-deadman.md.
"""

from __future__ import annotations

import contextlib
import os
import select
import signal
import socket
import sys
import threading
import time
from pathlib import Path

from daq.acquisition.ipc import AcquisitionChannel
from daq.config import parse_rig
from daq.log import note_path
from daq.protocol import pack_can, vesc
from daq.realtime_priority import set_realtime_priority
from daq.rig import DRIVES, Device, Rig
from daq.transport import Port, PortError, make_port

# Wall seconds.
HANG_S = 0.6  # without a pulse: more than a busy machine pauses, less than the second of most ESCs
POLL_S = 0.02
PULSE_S = 0.02  # between pulses, at least
READY_S = 20.0
OPEN_S = 3.0  # for a port to be free again
ZERO_S = 1.0  # zero is said for so long
ACTIVE, IDLE, GOODBYE = b"1", b"0", b"q"


class Heartbeat:
    """The acquisition's side. Raises nothing while thrust is commanded: `lost` says that the watchdog is gone."""

    def __init__(self, sock: socket.socket, rig: Rig, log: Path) -> None:
        """Returns when the watchdog is ready. Raises OSError or EOFError when it does not become so."""
        self.lost = False
        self._socket = sock
        self._next = 0.0
        sock.settimeout(READY_S)
        link = AcquisitionChannel(sock)
        link.send({"rig_text": rig.text, "rig_path": str(rig.path), "pid": os.getpid(), "log": str(log.absolute())})
        while not link.receive():
            pass
        sock.setblocking(False)

    def beat(self, active: bool, now: float, at_once: bool = False) -> None:
        """Say that all is well, and whether thrust is commanded."""
        if at_once or now >= self._next:
            self._next = now + PULSE_S
            self._send(ACTIVE if active else IDLE)

    def end(self) -> None:
        """The thrusters are at zero and the ports will be closed: nothing is left to watch."""
        self._send(GOODBYE)

    def _send(self, word: bytes) -> None:
        try:
            self._socket.send(word)
        except BlockingIOError:
            return  # it has not read for so long that it hangs itself; it will find out when it goes on
        except OSError:
            self.lost = True


class HeartbeatMonitor:
    """Decides from the pulses when to step in. Reads no clock."""

    def __init__(self, now: float) -> None:
        self._heard = self._looked = now
        self._active = False

    def look(self, now: float, words: bytes | None) -> str | None:
        """After each wait: what was read (None at the end of the line). A reason to step in, "" to leave, else None."""
        if now - self._looked > 3 * POLL_S:
            self._heard += now - self._looked  # a pause of our own is not held against anybody
        self._looked = now
        if words is None:
            return "the acquisition process died while thrust was commanded" if self._active else ""
        if words:
            if GOODBYE in words:
                return ""
            self._heard, self._active = now, words[-1:] == ACTIVE
        if self._active and now - self._heard > HANG_S:
            return f"the acquisition process gave no sign of life for {HANG_S:g} s while thrust was commanded"
        return None


class FailsafeSender(threading.Thread):
    """Says zero to the thrusters on one port, as soon as it can be opened."""

    def __init__(self, device: Device, rig: Rig) -> None:
        super().__init__(name=f"rescue {device.name}")
        self._device = device
        self._thrusters = [thruster for thruster in rig.thrusters if thruster.device == device.name]
        self.outcome = "not tried"
        self._port: Port = make_port(device)
        self._talker = None
        if device.protocol != "vesc":
            from daq.drivers import make_driver
            from daq.protocol import make_decoder

            self._talker = make_driver(device, rig, make_decoder(device, rig))
            self._zero()  # whatever has to be loaded for it is loaded now
        else:
            self._frames = b"".join(pack_can(*vesc.encode_duty(t.node, 0.0)) for t in self._thrusters)

    def _zero(self) -> bytes:
        if self._talker is None:
            return self._frames
        return b"".join(data for data, _ in self._talker.zero(time.monotonic()))

    def run(self) -> None:
        """Open, say zero for a second, close."""
        deadline = time.monotonic() + OPEN_S
        while True:
            try:
                self._port.open()
                self._say_zero()
                self.outcome = "zero was sent"
            except PortError as error:
                self.outcome = str(error)
                if time.monotonic() < deadline:
                    time.sleep(POLL_S)
                    continue
            break
        self._port.close()

    def _say_zero(self) -> None:
        until = time.monotonic() + ZERO_S
        while time.monotonic() < until:
            ready, _, _ = select.select([self._port.fileno()], [], [], POLL_S)
            if ready:
                self._port.read()  # a port that listens learns from this whom to answer
            self._port.write(self._zero())


def run_failsafe(rescuers: list[FailsafeSender]) -> str:
    """Say zero on all ports at once; what came of it."""
    for rescuer in rescuers:
        rescuer.start()
    for rescuer in rescuers:
        rescuer.join()
    return ", ".join(f"{rescuer.name.removeprefix('rescue ')}: {rescuer.outcome}" for rescuer in rescuers)


def main() -> None:
    """Take the rig from the acquisition process, then watch it."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # it ends when what it watches has ended well
    sock = socket.socket(fileno=int(sys.argv[1]))
    link = AcquisitionChannel(sock)
    messages = link.receive()
    while not messages:
        messages = link.receive()
    config = messages[0]
    rig = parse_rig(config["rig_text"], Path(config["rig_path"]))
    driven = [d for d in rig.devices if d.protocol in DRIVES and any(t.device == d.name for t in rig.thrusters)]
    rescuers = [FailsafeSender(device, rig) for device in driven]
    set_realtime_priority()  # all of its life it waits, and when it does not it is urgent
    link.send({"op": "ready"})
    reason = _watch(sock)
    if reason:
        _step_in(int(config["pid"]), Path(config["log"]), reason, rescuers)


def _watch(sock: socket.socket) -> str:
    """Until there is a reason to step in, or to leave: then it is empty."""
    sock.setblocking(False)
    watch = HeartbeatMonitor(time.monotonic())
    while True:
        ready, _, _ = select.select([sock], [], [], POLL_S)
        words: bytes | None = b""
        if ready:
            try:
                words = sock.recv(4096) or None
            except BlockingIOError:
                words = b""
            except OSError:
                words = None
        found = watch.look(time.monotonic(), words)
        if found is not None:
            return found


def _step_in(pid: int, log: Path, reason: str, rescuers: list[FailsafeSender]) -> None:
    """Kill what hangs, say zero, and write down why."""
    if "died" not in reason:
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.kill(pid, signal.SIGKILL)  # its end of the socket is open: it is there, and the number is its own
    when = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())
    note = note_path(log)
    with contextlib.suppress(OSError):  # a full disk must not keep thrust on
        note.write_text(f"{when} watchdog: {reason}\n", encoding="utf-8")
    outcome = run_failsafe(rescuers)
    with contextlib.suppress(OSError):
        note.write_text(f"{when} watchdog: {reason}; {outcome}\n", encoding="utf-8")


if __name__ == "__main__":
    main()
