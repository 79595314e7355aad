"""Real ports for tests: ptys at the paths where a rig expects its devices, and small devices that write to them."""

from __future__ import annotations

import contextlib
import os
import threading
import time
import tty
from collections.abc import Callable
from pathlib import Path

from seatrial.daq.protocol import loadcell, nmea, slcan, vectornav, vesc
from seatrial.daq.protocol.canframe import unpack_can
from seatrial.daq.samples import Ahrs, Esc, Gnss

RIG = """
format = "seatrial-rig 1"
name = "test boat"

[clock]
speed = {speed}

[[device]]
name = "ahrs"
protocol = "vectornav"
port = "ahrs"
rate_hz = 100.0

[[device]]
name = "gnss"
protocol = "nmea"
port = "gnss"
rate_hz = 20.0

[[device]]
name = "esc"
protocol = "vesc"
port = "slcan:can"
rate_hz = 100.0

[[device]]
name = "cell"
protocol = "loadcell"
port = "cell"
rate_hz = 100.0
saturation = 8388607
[device.calibration]
newton_per_count = 0.01
zero_counts = 1000.0

[[thruster]]
name = "left"
device = "esc"
node = 1
position_m = [-0.25, -0.15, 0.0]
pole_pairs = 7
rpm_max = 4500.0

[[thruster]]
name = "right"
device = "esc"
node = 2
position_m = [-0.25, 0.15, 0.0]
pole_pairs = 7
rpm_max = 4500.0
reversed = true

[limits]
n_max = 0.8
"""


def wait_for(condition: Callable[[], bool], seconds: float = 10.0, what: str = "the condition") -> None:
    """Wait until `condition()` holds. Raise AssertionError if it does not hold in time."""
    deadline = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < deadline, f"{what} did not come true in {seconds} s"
        time.sleep(0.005)


class Pty:
    """Port on a pty. `received` contains the bytes from the host; `sent_at` and `heard` contain times (monotonic)."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.received = bytearray()
        self.heard: list[tuple[float, bytes]] = []
        self._master = self._slave = -1
        self.plug()

    def plug(self) -> None:
        """Make the pty and the link to it."""
        self._master, self._slave = os.openpty()
        tty.setraw(self._slave)
        os.set_blocking(self._master, False)
        self.path.symlink_to(os.ttyname(self._slave))

    def pull(self) -> None:
        """Remove the port. A program that has it open gets a hang-up."""
        if self._master >= 0:
            self.path.unlink()
            os.close(self._slave)
            os.close(self._master)
            self._master = self._slave = -1

    def write(self, data: bytes) -> None:
        """Send data. Bytes that do not fit because the host does not read are lost, as on a wire."""
        if self._master >= 0:
            with contextlib.suppress(BlockingIOError):
                os.write(self._master, data)

    def read(self) -> None:
        """Read the bytes that the host has written."""
        if self._master >= 0:
            with contextlib.suppress(BlockingIOError):
                data = os.read(self._master, 65536)
                self.received += data
                self.heard.append((time.monotonic(), data))

    def commands(self) -> list[tuple[int, float]]:
        """Return node and duty of every command that the host has sent so far."""
        return commands_in(bytes(self.received))


def commands_in(data: bytes) -> list[tuple[int, float]]:
    """Return node and duty of the commands in slcan text."""
    commands = []
    for frame in slcan.Decoder().feed(data, 0.0):
        identified = unpack_can(frame)
        command = vesc.decode_command(*identified) if identified else None
        if command is not None:
            commands.append(command)
    return commands


class TestBoat:
    """The four devices of `RIG` on ptys in `folder`, each sending every 10 ms (GNSS 50 ms) of wall time."""

    __test__ = False

    def __init__(self, folder: Path, speed: float = 1.0) -> None:
        self.rig_path = folder / "rig.toml"
        self.rig_path.write_text(RIG.format(speed=speed))
        self.ports = {name: Pty(folder / name) for name in ("ahrs", "gnss", "can", "cell")}
        self.sent = dict.fromkeys(self.ports, 0)
        self.silent: set[str] = set()
        self._speed = speed
        self._lock = threading.Lock()
        self._rounds = 0
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)

    def __enter__(self) -> TestBoat:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self.catch_up()
        self._ending.set()
        self._thread.join()
        for port in self.ports.values():
            port.pull()

    def pull(self, name: str) -> None:
        """Unplug one port."""
        with self._lock:
            self.ports[name].pull()

    def plug(self, name: str) -> None:
        """Plug it in again: a new pty under the same name."""
        with self._lock:
            self.ports[name].plug()

    def catch_up(self) -> None:
        """Wait until all bytes that the host has written so far were read, also on a busy machine."""
        if not self._thread.is_alive():
            return
        rounds = self._rounds
        wait_for(lambda: self._rounds >= rounds + 2, 30.0, "the devices' next round")

    def write(self, name: str, data: bytes) -> None:
        """Send additional bytes on a port."""
        with self._lock:
            self.ports[name].write(data)

    def _run(self) -> None:
        k = 0
        start = time.monotonic()
        while not self._ending.wait(max(start + 0.01 * k - time.monotonic(), 0.0)):
            with self._lock:
                self._send(k)
                for port in self.ports.values():
                    port.read()
                self._rounds += 1
            k += 1

    def _send(self, k: int) -> None:
        t = 0.01 * k * self._speed
        messages = {
            "ahrs": vectornav.encode_binary(Ahrs(0.1, 0.0, 0.0, 0.0, 0.0, 1e-3 * k, 0.0, 0.0, -9.8), t),
            "can": b"".join(
                slcan.encode(*frame)
                for node in (1, 2)
                for frame in vesc.encode_status(Esc(node, 100.0 * node, 1.0, 0.1, 16.0, 30.0), 7)
            ),
            "cell": loadcell.encode(2000.0 + k % 100),
        }
        if k % 5 == 0:
            messages["gnss"] = nmea.encode(
                Gnss(1.8e9 + t, 41.0, -8.7, 1.0, 0.5, 0.1, fix=3, n_sat=9, hdop=1.0, sigma_h=0.5)
            )
        for name, data in messages.items():
            if name not in self.silent:
                self.ports[name].write(data)
                self.sent[name] += 1
