"""`seatrial replay`: the raw bytes of a log, sent again on serial ports (ptys) at the times of receipt.

A rig file with these ports stands beside them, so that `seatrial log` records the log anew.
"""

from __future__ import annotations

import heapq
import os
import select
import time
import tty
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path

import tomlkit

from daq.config import parse_rig
from daq.errors import SeatrialError
from daq.log import Log
from daq.protocol import CAN_FRAME, EXTENDED, FRAME_BYTES
from daq.samples import PortHealth

SETTLE_S = 0.1  # a host configures the port after it has opened it
WAIT_S = 0.05
READ_BYTES = 65536
Chunk = tuple[float, str, bytes]
NAME = "replay.toml"
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
    folder.mkdir(parents=True, exist_ok=True)
    ports: dict[str, ReplayPort] = {}
    rig = write_replay_rig(log, names, folder, speed)
    try:
        for name in names:
            ports[name] = ReplayPort(folder / name)
        again = f"; `seatrial log {rig}` records them anew" if rig else ""
        said(f"waiting for a reader of {', '.join(str(port.path) for port in ports.values())}{again}")
        while {port.has_host() for port in ports.values()} != {True}:  # every port is called: the call holds it open
            if stopped():
                return 0
            time.sleep(WAIT_S)
        said(f"replaying {log.duration:.1f} s at speed {speed:g}")
        return _send(chunks(log, names), ports, speed, stopped)
    finally:
        if rig is not None:
            rig.unlink(missing_ok=True)
        for port in ports.values():
            port.close()


def recorded(log: Log, devices: Sequence[str] = ()) -> list[str]:
    """The devices of a log whose bytes can be replayed. Raises SeatrialError for one without."""
    there = [name for name in log.sources(PortHealth) if f"/raw/{name}" in log.counts]
    there = there or [topic.removeprefix("/raw/") for topic in log.counts if topic.startswith("/raw/")]
    if not there:
        raise SeatrialError(f"{log.path}: holds no raw bytes; only what seatrial itself has recorded can be replayed")
    for name in devices:
        if name not in there:
            raise SeatrialError(f"{log.path}: no raw bytes of '{name}'; there are those of {', '.join(there)}")
    return list(devices) or there


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
    """The device's end of a pty, linked at `path`. The host's bytes are thrown away."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.backlog = bytearray()
        self._slave = -1
        if os.path.lexists(path) and not path.is_symlink():
            raise SeatrialError(f"{path}: exists and is not a link; --dir names another folder for the ports")
        self._master, slave = os.openpty()
        path.unlink(missing_ok=True)
        path.symlink_to(os.ttyname(slave))
        os.close(slave)  # so that a host that opens it can be detected
        os.set_blocking(self._master, False)

    def has_host(self) -> bool:
        """Whether a host has the other end open; from then on we hold it open, too."""
        if self._slave >= 0:
            return True
        poll = select.poll()
        poll.register(self._master, 0)
        if any(event & select.POLLHUP for _, event in poll.poll(0)):
            return False
        time.sleep(SETTLE_S)
        self._slave = os.open(os.readlink(self.path), os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
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
        """Remove the port."""
        self.path.unlink(missing_ok=True)
        for fd in (self._slave, self._master):
            if fd >= 0:
                os.close(fd)
        self._slave = self._master = -1


def write_replay_rig(log: Log, devices: Sequence[str], folder: Path, speed: float) -> Path | None:
    """Write FOLDER/replay.toml for `devices`, whose ports are FOLDER/DEVICE; None where the log has no rig for them.

    Logs go to the folder of `log`. Raises SeatrialError where another file is in the way.
    """
    path = folder / NAME
    if path.exists() and not path.read_text(encoding="utf-8", errors="replace").startswith(HEAD):
        raise SeatrialError(f"{path}: exists and is not from a replay; --dir names another folder")
    try:
        text = _text(log, devices, speed)
        if text is None:
            return None
        parse_rig(text, path)
    except (SeatrialError, tomlkit.exceptions.TOMLKitError):
        return None  # the rig of another version: the bytes are replayed all the same
    path.write_text(text, encoding="utf-8")
    return path


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
    document["clock"] = {"speed": speed}
    document["log"] = {**document.get("log", {}), "directory": str(log.path.parent.absolute())}
    return HEAD + tomlkit.dumps(document)
