"""Replay of a log for `seatrial replay`: its raw bytes are sent again on serial ports (ptys) at the recorded times.

A rig file with these ports is written beside them. With this rig file `seatrial log` records the log again.
The names of devices are from the log, and the log may be from a stranger. Therefore only names that are valid in a rig
are used, all files are created in one folder, no existing file is replaced, and only own files are deleted.
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

SETTLE_S = 0.1  # s; a host configures a port after it has opened the port
WAIT_S = 0.05  # s between two checks
READ_BYTES = 65536
Chunk = tuple[float, str, bytes]  # time [s since 1970], device, bytes
RIG = "replay.toml"
RIG_HEADER = (
    "# Written by `seatrial replay`, and deleted when it ends: the rig of the log with the ports of the replay.\n"
)


def replay_log(
    log: Log,
    devices: Sequence[str],
    folder: Path,
    *,
    speed: float = 1.0,
    said: Callable[[str], None] = lambda text: None,
    stopped: Callable[[], bool] = lambda: False,
) -> int:
    """Replay the raw bytes of a log on the ports FOLDER/DEVICE, beside a rig file for these ports.

    The replay begins when a program has opened each port; it waits for this without a time limit. Only received bytes
    are sent, at the times of their receipt. Without a usable rig in the log, no rig file is written.

    Parameters
    ----------
    log
        The log.
    devices
        Names of the devices to replay; empty for all devices with raw bytes.
    folder
        Folder of the ports and of the rig file. The ports and the rig file are deleted at the end; the folder stays.
    speed
        Recorded seconds in one second of wall time.
    said
        Function that receives progress messages.
    stopped
        Function that is called often. The replay ends when the result is true.

    Returns
    -------
    int
        Number of bytes sent.

    Raises
    ------
    SeatrialError
        If the log has no raw bytes of a device, if the name of a device is not valid, or if a port or the rig file
        cannot be created.
    """
    names = recorded(log, devices)
    place = ReplayFolder(folder)
    ports: dict[str, ReplayPort] = {}
    try:
        rig = write_replay_rig(log, names, place, speed)
        for name in names:
            ports[name] = ReplayPort(place, name)
        advice = f"; `seatrial log {rig}` records them again" if rig else ""
        said(f"waiting for a program that opens {', '.join(str(port.path) for port in ports.values())}{advice}")
        # The set is built from all ports on purpose: `has_host` must be called for each, because it holds a port open.
        while {port.has_host() for port in ports.values()} != {True}:
            if stopped():
                return 0
            time.sleep(WAIT_S)
        said(f"replaying {log.duration:.1f} s at speed {speed:g}")
        return _send_in_time(chunks(log, names), ports, speed, stopped)
    finally:
        place.close()
        for port in ports.values():
            port.close()


class ReplayFolder:
    """Folder of the links and the rig file of a replay. No existing file is replaced, and only own files are deleted.

    Raises
    ------
    SeatrialError
        If the folder cannot be created or opened.

    Attributes
    ----------
    path : Path
        The folder.
    """

    def __init__(self, folder: Path) -> None:
        """Create the folder of a replay if it does not exist, and open it. It stays open until `close`.

        Raise SeatrialError if the folder cannot be created or opened.
        """
        self.path = folder
        try:
            folder.mkdir(parents=True, exist_ok=True)
            self._fd = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        except OSError as error:
            raise SeatrialError(f"{folder}: {error.strerror}; use --dir to name another folder") from error
        self._made: dict[str, tuple[int, int, int]] = {}  # identity of each own file, by name

    def link(self, name: str, target: str) -> Path:
        """Create a symbolic link `name` to `target` in the folder of the replay, and return its path.

        Raise SeatrialError if a file or folder has this name already, or if the link cannot be created.
        """
        return self._create_own_file(name, lambda: os.symlink(target, name, dir_fd=self._fd))

    def write(self, name: str, text: str) -> Path:
        """Write a new text file in the folder of the replay, and return its path.

        Raise SeatrialError if a file or folder has this name already, or if the file cannot be written.
        """

        def write() -> None:
            """Create the file of the replay and write the text. Raise FileExistsError if its name exists already."""
            fd = os.open(name, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_NOFOLLOW, 0o644, dir_fd=self._fd)
            with os.fdopen(fd, "w", encoding="utf-8") as file:
                file.write(text)

        return self._create_own_file(name, write)

    def _create_own_file(self, name: str, make: Callable[[], None]) -> Path:
        """Create a file or link in the folder of the replay by calling `make`, and return its path.

        Its identity is stored, so that `close` deletes this file and no other. Raise SeatrialError if a file of this
        name exists or cannot be created.
        """
        try:
            make()
        except FileExistsError:
            raise SeatrialError(
                f"{self.path / name}: exists already, and a replay replaces no file; delete it if an earlier replay "
                "was killed, or use --dir to name another folder"
            ) from None
        except OSError as error:
            raise SeatrialError(
                f"{self.path / name}: cannot be made: {error.strerror}; use --dir to name another folder"
            ) from error
        self._made[name] = self._file_identity(name)
        return self.path / name

    def _file_identity(self, name: str) -> tuple[int, int, int]:
        """Return numbers that distinguish a file of the replay from later files of the same name.

        They are device, inode and time of change [ns].
        """
        # The inode alone is not sufficient: the file system reuses the inode of a deleted file.
        status = os.stat(name, dir_fd=self._fd, follow_symlinks=False)
        return status.st_dev, status.st_ino, status.st_ctime_ns

    def close(self) -> None:
        """Delete the files that the replay created in its folder, unless another program has replaced them.

        The folder itself stays. No further files can be created.
        """
        for name, identity in self._made.items():
            with contextlib.suppress(OSError):
                if self._file_identity(name) == identity:
                    os.unlink(name, dir_fd=self._fd)
        os.close(self._fd)


def recorded(log: Log, devices: Sequence[str] = ()) -> list[str]:
    """Return the names of the devices of a log whose raw bytes can be replayed.

    Raw bytes are logged under the topic /raw/DEVICE. If the log has port counters for some of these devices, only they
    can be replayed; otherwise all of them.

    Parameters
    ----------
    log
        The log.
    devices
        Names of the devices to replay, which are returned in this order; empty for all devices with raw bytes. A name
        that is given twice counts once.

    Raises
    ------
    SeatrialError
        If the log has no raw bytes of a device, or if a name is not valid in a rig.
    """
    available = [name for name in log.sources(PortHealth) if f"/raw/{name}" in log.counts]
    available = available or [topic.removeprefix("/raw/") for topic in log.counts if topic.startswith("/raw/")]
    if not available:
        raise SeatrialError(f"{log.path}: the log has no raw bytes of devices; give a log that seatrial recorded")
    for name in devices:
        if name not in available:
            raise SeatrialError(
                f"{log.path}: no raw bytes of device '{name}'; give one of those with raw bytes: {', '.join(available)}"
            )
    names = list(dict.fromkeys(devices)) or available
    for name in names:  # a name becomes a path in the folder of the ports
        if not NAME.fullmatch(name):
            raise SeatrialError(
                f"{log.path}: {name!r} of topic /raw is not a valid name of a device "
                "(a letter, then letters, digits or _); give a log that seatrial recorded"
            )
    return names


def chunks(log: Log, devices: Sequence[str]) -> Iterator[Chunk]:
    """Yield the bytes that the devices of a log sent, as (time of receipt [s since 1970], device, bytes).

    The order is that of time, over all devices. CAN frames become lines of an slcan adapter; the rig of the log shows
    which devices have CAN ports, so without a rig they stay as they are. Bytes that were sent to the devices are left
    out.
    """
    rig = log.rig
    can = {device.name for device in rig.devices if device.port.startswith(("slcan:", "socketcan:"))} if rig else set()

    def reads_of(name: str) -> Iterator[Chunk]:
        """Yield the bytes that one device sent, with their times. Bytes sent to the device are skipped."""
        for t, direction, data in log.raw(name):
            if direction == "rx" and data:
                yield t, name, as_slcan(data) if name in can else data

    return heapq.merge(*(reads_of(name) for name in devices), key=lambda chunk: chunk[0])


def as_slcan(data: bytes) -> bytes:
    """Convert CAN frames (16 bytes each, the format of the log) to the text lines of an slcan adapter.

    A frame with a 29-bit identifier becomes a line "T...", one with 11 bits a line "t...". At most 8 data bytes are
    taken. Remote and error frames are not distinguished from data frames. An incomplete frame at the end is left out.
    """
    out = []
    for word, length, body in CAN_FRAME.iter_unpack(data[: len(data) // FRAME_BYTES * FRAME_BYTES]):
        head = b"T%08X" % (word & ~EXTENDED) if word & EXTENDED else b"t%03X" % (word & 0x7FF)
        out.append(b"%b%d%b\r" % (head, min(length, 8), body[: min(length, 8)].hex().upper().encode("ascii")))
    return b"".join(out)


def _send_in_time(
    pieces: Iterator[Chunk], ports: dict[str, ReplayPort], speed: float, stopped: Callable[[], bool]
) -> int:
    """Send recorded bytes on the ports of a replay at their times, and return the number of bytes sent.

    `pieces` are (time [s], device, bytes) in the order of time, and `ports` are the ports by name of the device. The
    first piece is sent at once, and later ones by their time after it, divided by `speed`. At the end wait until the
    ports have accepted all bytes. Return early when `stopped()` is true; bytes that wait for a slow reader are then
    counted but not sent.
    """
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
    """Serial port (pty) on which a replay sends the bytes of one device. Bytes from the other end are discarded.

    The folder of the replay has a link to the end that a program, the host, opens.

    Attributes
    ----------
    backlog : bytearray
        Bytes that wait to be sent by `pump`.
    path : Path
        The link to the host's end.
    """

    def __init__(self, folder: ReplayFolder, name: str) -> None:
        """Open a pty for the device `name`, and create the link to its host's end in the folder.

        The host's end is closed again, so that `has_host` can detect a host that opens it. If the link cannot be
        created, close the pty and raise SeatrialError.
        """
        self.backlog = bytearray()
        self._slave = -1
        self._master, slave = os.openpty()
        self._tty = os.ttyname(slave)
        os.close(slave)  # while this end is closed, `has_host` can detect a host that opens it
        os.set_blocking(self._master, False)
        try:
            self.path = folder.link(name, self._tty)
        except SeatrialError:
            self.close()
            raise

    def has_host(self) -> bool:
        """Return whether a program, the host, has opened the port of the replay.

        When the method finds the port opened for the first time, it waits 0.1 s, in which the host configures the port.
        Then this process keeps the host's end open, too, so the result stays true.
        """
        if self._slave >= 0:
            return True
        poll = select.poll()
        poll.register(self._master, 0)
        if any(event & select.POLLHUP for _, event in poll.poll(0)):
            return False
        time.sleep(SETTLE_S)
        self._slave = os.open(self._tty, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        tty.setraw(self._slave)  # otherwise the terminal returns the first bytes as an echo
        return True

    def pump(self) -> None:
        """Send bytes of `backlog`, as many as the buffer of the port accepts, and discard bytes from the host.

        Sent bytes are removed from `backlog`. The method never waits, and ignores errors of the pty.
        """
        try:
            if self.backlog:
                del self.backlog[: os.write(self._master, self.backlog)]
            os.read(self._master, READ_BYTES)
        except OSError:
            return  # the buffer is full, there are no bytes to read, or the host has closed the port

    def close(self) -> None:
        """Close both ends of the replay's port. A second call has no effect."""
        for fd in (self._slave, self._master):
            if fd >= 0:
                os.close(fd)
        self._slave = self._master = -1


def write_replay_rig(log: Log, devices: Sequence[str], folder: ReplayFolder, speed: float) -> Path | None:
    """Write the rig file of a replay, FOLDER/replay.toml, with the ports FOLDER/DEVICE, and return its path.

    With this rig file new logs are recorded in the folder of `log`.

    Returns
    -------
    Path or None
        None if the log has no valid rig with these devices.

    Raises
    ------
    SeatrialError
        If a file of this name exists already, or if the file cannot be written.
    """
    try:
        text = _replay_rig_text(log, devices, speed)
        if text is None:
            return None
        parse_rig(text, folder.path / RIG)
    except (SeatrialError, tomlkit.exceptions.TOMLKitError):
        return None  # the rig is from another version: the bytes are replayed without a rig file
    return folder.write(RIG, text)


def _replay_rig_text(log: Log, devices: Sequence[str], speed: float) -> str | None:
    """Return the text of the rig file of a replay; None if the log has no rig with these devices.

    It is the rig of the log with only these devices and their thrusters, the ports of the replay, the clock at `speed`
    and the folder of the log. Network access (live, ros2) and keys are left out.
    """
    rig = log.rig
    if rig is None or not {device.name for device in rig.devices}.issuperset(devices):
        return None
    document = tomlkit.parse(rig.text).unwrap()
    tables = [table for table in document["device"] if table["name"] in devices]
    for table in tables:
        bus = "slcan:" if str(table["port"]).startswith(("slcan:", "socketcan:")) else ""
        table["port"] = f"{bus}{table['name']}"
        device = rig.device(table["name"])
        if device.dbc:
            table["dbc"] = device.dbc  # full path: the new rig file lies in another folder
        table.pop("key_file", None)  # the log does not contain the key file: signatures are not checked
    document["device"] = tables
    document["thruster"] = [table for table in document.get("thruster", []) if table["device"] in devices]
    for key in ("live", "ros2"):  # a log must not open network access to samples or commands
        document.pop(key, None)
    document["clock"] = {"speed": speed}
    document["log"] = {**document.get("log", {}), "directory": str(log.path.parent.absolute())}
    return RIG_HEADER + tomlkit.dumps(document)
