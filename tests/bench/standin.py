"""Stand-in bench behind real ptys under full control of a test: unplugged ports, garbage, forces on the load cell.

The devices of `seatrial mock` are complete. This stand-in is small and reacts at once. It keeps a trace of the commands
that the ESC received and of the motion of the thruster, with the ESC's own time-out.
"""

from __future__ import annotations

import contextlib
import os
import select
import threading
import time
import tty
from pathlib import Path
from typing import Self

from seatrial.daq.protocol import loadcell, vesc
from seatrial.daq.samples import Esc

NODE, POLE_PAIRS, RPM_MAX = 1, 7, 4500.0
ZERO_COUNTS, NEWTON_PER_COUNT = 84210.0, 0.001
TIMEOUT_S = 4.0  # run seconds, the time-out of the ESC itself
SLOW_ESC_S = 40.0  # the default of a new controller

RIG = """
format = "seatrial-rig 1"
name = "stand-in bench"
[clock]
speed = {speed}
[[device]]
name = "esc"
protocol = "vesc"
port = "slcan:ports/can"
rate_hz = 40.0
[[device]]
name = "loadcell"
protocol = "loadcell"
port = "ports/loadcell"
rate_hz = 80.0
[device.calibration]
newton_per_count = 0.001
zero_counts = 84210.0
[[thruster]]
name = "left"
device = "esc"
node = 1
position_m = [0.0, 0.0, 0.0]
pole_pairs = 7
rpm_max = 4500.0
timeout_s = 4.0
[limits]
n_max = 0.9
force_n = 60.0
current_a = 40.0
temperature_c = 80.0
voltage_min_v = 10.0
"""


class Port:
    """Pty with a symlink to it, and the data last received on it."""

    def __init__(self, link: Path) -> None:
        self.link = link
        link.parent.mkdir(exist_ok=True)
        self.plug()

    def plug(self) -> None:
        """Make the pty and the link, also again after the port was pulled."""
        self.master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self.master, False)
        self.link.symlink_to(os.ttyname(self._slave))
        self.open = True

    def write(self, data: bytes) -> None:
        """Send data. A full pty drops it, like a serial line without flow control."""
        with contextlib.suppress(BlockingIOError, OSError):
            os.write(self.master, data)

    def read(self) -> bytes:
        """Return the bytes received since the last call."""
        with contextlib.suppress(BlockingIOError, OSError):
            return os.read(self.master, 65536)
        return b""

    def pull(self) -> None:
        """Unplug the port. The host gets a hang-up and no longer finds the port."""
        if self.open:
            self.open = False
            self.link.unlink()
            os.close(self._slave)
            os.close(self.master)


class StandIn:
    """ESC and load cell, as a context manager that runs them on a thread."""

    def __init__(self, folder: Path, speed: float = 4.0, timeout_s: float = TIMEOUT_S) -> None:
        self._timeout_s = timeout_s
        self.rig = folder / "bench-rig.toml"
        self.rig.write_text(RIG.format(speed=speed), encoding="utf-8")
        self.speed = speed
        self.can, self.cell = Port(folder / "ports" / "can"), Port(folder / "ports" / "loadcell")
        self.commands: list[tuple[float, float]] = []  # (monotonic s, n) as received
        self.motion: list[tuple[float, float]] = [(time.monotonic(), 0.0)]  # changes of the thruster's motion
        self.extra_force = 0.0
        self._flicker = 1
        self.current_per_n = 20.0
        self.temperature, self.voltage = 30.0, 24.0  # NaN: the status frames with this value are not sent
        self._garbage = b""
        self._pull: Port | None = None
        self._plug: Port | None = None
        self._stop = False
        self._line = b""
        self._thread = threading.Thread(target=self._loop, name="stand-in")

    def __enter__(self) -> Self:
        """Start the devices."""
        self._thread.start()
        return self

    def __exit__(self, *reason: object) -> None:
        """Stop the devices and remove the ports."""
        self._stop = True
        self._thread.join()
        for port in (self.can, self.cell):
            port.pull()

    @property
    def n(self) -> float:
        """Return the current duty of the thruster."""
        return self.motion[-1][1]

    def garble(self, data: bytes) -> None:
        """Send these bytes on both ports between the frames."""
        self._garbage = data

    def pull(self, port: Port) -> None:
        """Unplug a port and wait until it is gone."""
        self._pull = port
        until(lambda: not port.open, 5.0)

    def plug(self, port: Port) -> None:
        """Plug the port in again."""
        self._plug = port
        until(lambda: port.open, 5.0)

    def zero_after(self, t: float) -> float:
        """Return the monotonic time, not before `t`, from which the thruster stayed at zero; inf while it turns."""
        if self.n != 0.0:
            return float("inf")
        return max(t, self.motion[-1][0])

    def _loop(self) -> None:
        start = time.monotonic()
        sent_esc = sent_cell = 0
        while not self._stop:
            if self._pull is not None:
                self._pull.pull()
                self._pull = None
            if self._plug is not None:
                self._plug.plug()
                self._plug = None
            watched = [port.master for port in (self.can, self.cell) if port.open]
            select.select(watched, [], [], 0.002)
            self._listen()
            if self.commands and time.monotonic() - self.commands[-1][0] > self._timeout_s / self.speed:
                self._move(0.0)
            if self._garbage:
                data, self._garbage = self._garbage, b""
                for port in (self.can, self.cell):
                    if port.open:
                        port.write(data)
            run_s = (time.monotonic() - start) * self.speed
            sent_esc = self._send(run_s * 40.0, sent_esc, self._say_esc)
            sent_cell = self._send(run_s * 80.0, sent_cell, self._say_cell)

    def _send(self, due: float, sent: int, say: object) -> int:
        assert callable(say)
        if due > sent:
            say()
        return max(sent, int(due) + 1)

    def _listen(self) -> None:
        if self.cell.open:
            self.cell.read()
        if not self.can.open:
            return
        *lines, self._line = (self._line + self.can.read()).split(b"\r")
        for line in lines:
            if line[:1] != b"T":
                continue
            command = vesc.decode_command(int(line[1:9], 16), bytes.fromhex(line[10:].decode()))
            if command is not None and command[0] == NODE:
                self.commands.append((time.monotonic(), command[1]))
                self._move(command[1])

    def _move(self, n: float) -> None:
        if n != self.n:
            self.motion.append((time.monotonic(), n))

    def _say_esc(self) -> None:
        if not self.can.open:
            return
        n = self.n
        esc = Esc(NODE, n * RPM_MAX, self.current_per_n * abs(n), n, self.voltage, self.temperature)
        for identifier, data in vesc.encode_status(esc, POLE_PAIRS):
            self.can.write(b"T%08X%d%s\r" % (identifier, len(data), data.hex().upper().encode()))

    def _say_cell(self) -> None:
        if self.cell.open:
            force = 40.0 * self.n * abs(self.n) + self.extra_force
            self._flicker = -self._flicker  # noise of the last digit, as in any converter
            self.cell.write(loadcell.encode(round(ZERO_COUNTS + force / NEWTON_PER_COUNT) + self._flicker))


def until(condition: object, seconds: float) -> None:
    """Wait until `condition()` holds. Fail the test after `seconds` of wall time."""
    assert callable(condition)
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, "it did not happen in time"
        time.sleep(0.002)
