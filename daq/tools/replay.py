"""`seatrial replay`: the raw bytes of a log, sent again on serial ports (ptys) at the times of receipt.

A rig file with these ports stands beside them, so that `seatrial log` records the log anew. Names come from the log,
which may be anybody's: only those that a rig could give to a device are taken, everything is made anew within the one
folder, and nothing but what was made here is taken away.
"""

from __future__ import annotations

import contextlib
import heapq
import os
import select
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import tomlkit

from seatrial.daq.config import parse_rig
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import Log
from seatrial.daq.protocol import CAN_FRAME, EXTENDED, FRAME_BYTES
from seatrial.daq.rig import NAME
from seatrial.daq.samples import PortHealth

SETTLE_S = 0.1  # a host configures the port after it has opened it
WAIT_S = 0.05
READ_BYTES = 65536
Chunk = tuple[float, str, bytes]
RIG = "replay.toml"
HEAD = "# Made by `seatrial replay`, and taken away when it ends: the log's own rig with the ports of the replay.\n"


def replay_log(
    log: Log,
    devices: Sequence[str],
    folder: Path,
    *,
    speed: float = 1.0,
    said: Callable[[str], None] = lambda text: None,
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """Serve the ports FOLDER/DEVICE and a rig for them, wait for a host on each, send; returns the bytes sent.

    `speed` is recorded seconds per second. `said` gets progress messages, `stopped` is called often.
    """
    names = recorded(log, devices)
    place = ReplayFolder(folder)
    ports: dict[str, ReplayPort] = {}
    try:
        rig = write_replay_rig(log, names, place, speed)
        for name in names:
            ports[name] = ReplayPort(place, name)
        again = f"; `seatrial log {rig}` records them anew" if rig else ""
        said(f"waiting for a reader of {', '.join(str(port.path) for port in ports.values())}{again}")
        while {port.has_host() for port in ports.values()} != {True}:  # every port is called: the call holds it open
            if stopped():
                return 0
            time.sleep(WAIT_S)
        said(f"replaying {log.duration:.1f} s at speed {speed:g}")
        return _send(chunks(log, names), ports, speed, stopped)
    finally:
        place.close()
        for port in ports.values():
            port.close()


class ReplayFolder:
    """The folder of the ports. Nothing in it is replaced, and only what was made here is taken away."""

    def __init__(self, folder: Path) -> None:
        self.path = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            raise SeatrialError(f"{folder}: {error.strerror}; --dir names another folder") from error
        self._made: dict[str, tuple[int, int, int]] = {}  # by name

    def link(self, name: str, target: str) -> Path:
        """Make a symbolic link. Raises SeatrialError where anything has that name."""
        return self._make(name, lambda: os.symlink(target, name, dir_fd=self._fd))

    def write(self, name: str, text: str) -> Path:
        """Write a new file. Raises SeatrialError where anything has that name."""

        def write() -> None:
            fd = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o644, dir_fd=self._fd)
            with os.fdopen(fd, "w", encoding="utf-8") as file:
                file.write(text)

        return self._make(name, write)

    def _make(self, name: str, make: Callable[[], None]) -> Path:
        try:
            make()
        except FileExistsError:
            raise SeatrialError(
                f"{self.path / name}: is there already, and a replay replaces nothing; take it away if an earlier "
                "replay was killed, or name another folder with --dir"
            ) from None
        except OSError as error:
            raise SeatrialError(f"{self.path / name}: {error.strerror}") from error
        self._made[name] = self._identity(name)
        return self.path / name

    def _identity(self, name: str) -> tuple[int, int, int]:
        """What tells an entry from any other of that name; an inode alone is given again."""
        there = os.stat(name, dir_fd=self._fd, follow_symlinks=False)
        return there.st_dev, there.st_ino, there.st_ctime_ns

    def close(self) -> None:
        """Take away what was made here and is still the same."""
        for name, made in self._made.items():
            with contextlib.suppress(OSError):
                if self._identity(name) == made:
                    os.unlink(name, dir_fd=self._fd)
        os.close(self._fd)


def recorded(log: Log, devices: Sequence[str] = ()) -> list[str]:
    """The devices of a log whose bytes can be replayed. Raises SeatrialError for one without, and for a name that no
    rig would have: it is a path in the folder of the ports."""
    there = [name for name in log.sources(PortHealth) if f"/raw/{name}" in log.counts]
    there = there or [topic.removeprefix("/raw/") for topic in log.counts if topic.startswith("/raw/")]
    if not there:
        raise SeatrialError(f"{log.path}: holds no raw bytes; only what seatrial itself has recorded can be replayed")
    for name in devices:
        if name not in there:
            raise SeatrialError(f"{log.path}: no raw bytes of '{name}'; there are those of {', '.join(there)}")
    names = list(devices) or there
    for name in names:
        if not NAME.fullmatch(name):
            raise SeatrialError(f"{log.path}: /raw/{name!r} names no device: a letter, then letters, digits or _")
    return names


def chunks(log: Log, devices: Sequence[str]) -> Iterator[Chunk]:
    """(time, device, bytes as they were on the wire) of all reads, in the order of time."""
    rig = log.rig
    can = {device.name for device in rig.devices if device.port.startswith(("slcan:", "socketcan:"))} if rig else set()

    def of(name: str) -> Iterator[Chunk]:
        for t, direction, data in log.raw(name):
            if direction == "rx" and data:
                yield t, name, as_slcan(data) if name in can else data

    return heapq.merge(*(of(name) for name in devices), key=lambda chunk: chunk[0])


def as_slcan(data: bytes) -> bytes:
    """CAN frames (16 bytes each, as the log keeps them) as the lines of an slcan adapter."""
    out = []
    for word, length, body in CAN_FRAME.iter_unpack(data[: len(data) // FRAME_BYTES * FRAME_BYTES]):
        head = b"T%08X" % (word & ~EXTENDED) if word & EXTENDED else b"t%03X" % (word & 0x7FF)
        out.append(b"%b%d%b\r" % (head, min(length, 8), body[: min(length, 8)].hex().upper().encode("ascii")))
    return b"".join(out)


def _send(pieces: Iterator[Chunk], ports: dict[str, ReplayPort], speed: float, stopped: Callable[[], bool]) -> int:
    n_sent, start, first = 0, time.monotonic(), 0.0
    for t, name, data in pieces:
        first = first or t
        due = start + (t - first) / speed
        while not stopped():
            for port in ports.values():
                port.pump()
            left = due - time.monotonic()
            if left <= 0.0:
                break
            time.sleep(min(left, WAIT_S if not any(port.backlog for port in ports.values()) else 0.002))
        if stopped():
            return n_sent
        ports[name].backlog += data
        ports[name].pump()
        n_sent += len(data)
    while any(port.backlog for port in ports.values()) and not stopped():
        for port in ports.values():
            port.pump()
        time.sleep(0.002)
    time.sleep(SETTLE_S)  # the host still has to read the buffered bytes before the ports are removed
    return n_sent


class ReplayPort:
    """The device's end of a pty, linked in the folder. The host's bytes are thrown away."""

    def __init__(self, folder: ReplayFolder, name: str) -> None:
        self.backlog = bytearray()
        self._slave = -1
        self._master, slave = os.openpty()
        self._tty = os.ttyname(slave)
        os.close(slave)  # so that a host that opens it can be detected
        os.set_blocking(self._master, False)
        try:
            self.path = folder.link(name, self._tty)
        except SeatrialError:
            self.close()
            raise

    def has_host(self) -> bool:
        """Whether a host has the other end open; from then on we hold it open, too."""
        if self._slave >= 0:
            return True
        poll = select.poll()
        poll.register(self._master, 0)
        if any(event & select.POLLHUP for _, event in poll.poll(0)):
            return False
        time.sleep(SETTLE_S)
        self._slave = os.open(self._tty, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._slave)  # else the first bytes would come back to us as an echo
        return True

    def pump(self) -> None:
        """Send waiting bytes, as far as there is room, and drop those of the host."""
        try:
            if self.backlog:
                del self.backlog[: os.write(self._master, self.backlog)]
            os.read(self._master, READ_BYTES)
        except OSError:
            return  # no room, nothing to read, or the host has gone

    def close(self) -> None:
        """Hang up."""
        for fd in (self._slave, self._master):
            if fd >= 0:
                os.close(fd)
        self._slave = self._master = -1


def write_replay_rig(log: Log, devices: Sequence[str], folder: ReplayFolder, speed: float) -> Path | None:
    """Write FOLDER/replay.toml for `devices`, whose ports are FOLDER/DEVICE; None where the log has no rig for them.

    Logs go to the folder of `log`. Raises SeatrialError where another file is in the way.
    """
    try:
        text = _text(log, devices, speed)
        if text is None:
            return None
        parse_rig(text, folder.path / RIG)
    except (SeatrialError, tomlkit.exceptions.TOMLKitError):
        return None  # the rig of another version: the bytes are replayed all the same
    return folder.write(RIG, text)


def _text(log: Log, devices: Sequence[str], speed: float) -> str | None:
    rig = log.rig
    if rig is None or not {device.name for device in rig.devices}.issuperset(devices):
        return None
    document = tomlkit.parse(rig.text).unwrap()
    here = [table for table in document["device"] if table["name"] in devices]
    for table in here:
        bus = "slcan:" if str(table["port"]).startswith(("slcan:", "socketcan:")) else ""
        table["port"] = f"{bus}{table['name']}"
        device = rig.device(table["name"])
        if device.dbc:
            table["dbc"] = device.dbc  # relative paths count from another folder now
        table.pop("key_file", None)  # the log does not hold it: signatures are not checked
    document["device"] = here
    document["thruster"] = [table for table in document.get("thruster", []) if table["device"] in devices]
    for key in ("live", "ros2"):  # a log does not decide who may listen, or command
        document.pop(key, None)
    document["clock"] = {"speed": speed}
    document["log"] = {**document.get("log", {}), "directory": str(log.path.parent.absolute())}
    return HEAD + tomlkit.dumps(document)
