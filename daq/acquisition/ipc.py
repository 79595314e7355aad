"""Messages between the acquisition process, the parent that started it, and the watchdog: types and transport.

| from | to | messages |
|---|---|---|
| parent | acquisition process | Configuration first; ParentAlive, Schedule, ZeroThrust, LogEvent, DriverRequest, Stop |
| | | StreamSamples, once |
| acquisition process | parent | StatusReport, SampleBatch, then Failed or Closed as the last |
| acquisition process | watchdog | WatchdogConfiguration first, then heartbeats of one byte: ACTIVE, IDLE, FINISHED |
| watchdog | acquisition process | WatchdogReady first, then an answer of one byte to heartbeats |

Each message is one line of JSON on a stream socket: the name of its type, and its fields.
"""

from __future__ import annotations

import base64
import contextlib
import dataclasses
import json
import socket
import threading
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from seatrial.daq import samples
from seatrial.daq.acquisition.status import Status, StreamedSample, fields_of, from_json, to_json

ACTIVE, IDLE, FINISHED = b"1", b"0", b"q"  # heartbeats: thrust is commanded; it is not; nothing is left to watch
ANSWER = b"a"  # of the watchdog


@dataclass(frozen=True)
class Configuration:
    """What to record, and where to; the first message of the parent."""

    rig_text: str
    rig_path: str  # absolute
    path: str  # of the log, absolute
    speed: float  # run seconds per wall second
    origin: Sequence[float]  # of the run clock: `RunClock.origin`
    role: str  # LinkRole, to the autopilots
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    metadata: Mapping[str, str] = field(default_factory=dict)
    terminal: int = -1  # inherited descriptor of the parent's standard error; -1 if it has none


@dataclass(frozen=True)
class ParentAlive:
    """The parent's heartbeat."""

    runner: bool  # whether the runner has called `Acquisition.alive` since the last one


@dataclass(frozen=True)
class ScheduleSetpoints:
    """Set-points to append: rows of (run time [s], {thruster: n_cmd})."""

    rows: Sequence[tuple[float, Mapping[str, float]]]


@dataclass(frozen=True)
class ZeroThrust:
    """Clear the schedule and command zero at once."""

    reason: str


@dataclass(frozen=True)
class LogEvent:
    """An event to write to the log."""

    kind: str
    text: str


@dataclass(frozen=True)
class DriverRequest:
    """A request to the driver of a device: `arm`, `disarm`, or `mode` with its number as the value."""

    device: str
    action: str
    value: float


@dataclass(frozen=True)
class StreamSamples:
    """From here on the samples that are logged are sent to the parent, too."""


@dataclass(frozen=True)
class Stop:
    """Zero thrust, close the log and end."""


@dataclass(frozen=True)
class StatusReport:
    """The state of the acquisition, sent every 50 ms."""

    status: Status


@dataclass(frozen=True)
class SampleBatch:
    """Samples that were logged, oldest first, and how many of all could not be sent."""

    samples: Sequence[StreamedSample]
    dropped: int


@dataclass(frozen=True)
class Failed:
    """The process ends because of an error."""

    reason: str


@dataclass(frozen=True)
class Closed:
    """The log is closed in good order, and the process ends."""

    reason: str


@dataclass(frozen=True)
class WatchdogConfiguration:
    """What to watch: the process, and the rig whose thrusters are brought to zero when it fails."""

    rig_text: str
    rig_path: str
    pid: int
    log: str  # absolute path


@dataclass(frozen=True)
class WatchdogReady:
    """The watchdog can step in from now on, or it states why it cannot."""

    trouble: str = ""


Message = (
    Configuration | ParentAlive | ScheduleSetpoints | ZeroThrust | LogEvent | DriverRequest | StreamSamples | Stop
    | StatusReport | SampleBatch | Failed | Closed | WatchdogConfiguration | WatchdogReady
)  # fmt: skip
_TYPES: dict[str, type[Message]] = {kind.__name__: kind for kind in Message.__args__}


def encode_message(message: Message) -> bytes:
    """One line of JSON, its end included; NaN and Infinity are written as Python's json does."""
    values: dict[str, Any] = {name.name: getattr(message, name.name) for name in dataclasses.fields(message)}
    if isinstance(message, Configuration):
        values["attachments"] = {name: base64.b64encode(data).decode() for name, data in message.attachments.items()}
    elif isinstance(message, StatusReport):
        values["status"] = to_json(message.status)
    elif isinstance(message, SampleBatch):
        values["samples"] = [
            [device, type(sample).__name__, fields_of(sample), t] for device, sample, t in message.samples
        ]
    return json.dumps([type(message).__name__, values], separators=(",", ":")).encode() + b"\n"


def decode_message(line: bytes | bytearray) -> Message:
    """The inverse of `encode`."""
    name, values = json.loads(line)
    kind = _TYPES[name]
    if kind is Configuration:
        values["attachments"] = {name: base64.b64decode(text) for name, text in values["attachments"].items()}
    elif kind is StatusReport:
        values["status"] = from_json(values["status"])
    elif kind is SampleBatch:
        values["samples"] = [
            StreamedSample(device, getattr(samples, kind_name)(*fields), t)
            for device, kind_name, fields, t in values["samples"]
        ]
    return kind(**values)


class AcquisitionChannel:
    """One end of the socket. `send` may be called from any thread, `receive` from one."""

    def __init__(self, sock: socket.socket) -> None:
        self._socket = sock
        self._lock = threading.Lock()
        self._buffer = bytearray()

    def fileno(self) -> int:
        """The file descriptor to wait on."""
        return self._socket.fileno()

    def send(self, message: Message) -> None:
        """Send one message; raises OSError when the other end is closed."""
        data = encode_message(message)
        with self._lock:
            self._socket.sendall(data)

    def receive(self) -> list[Message]:
        """Wait for bytes and return the complete messages, maybe none; raises EOFError when the other end is closed."""
        try:
            data = self._socket.recv(1 << 20)
        except OSError as error:
            raise EOFError from error
        if not data:
            raise EOFError
        self._buffer += data
        *lines, rest = self._buffer.split(b"\n")
        self._buffer = rest
        return [decode_message(line) for line in lines]

    def receive_first(self) -> Message:
        """Wait for the first message. Raises EOFError when the other end is closed before."""
        while not (messages := self.receive()):
            pass
        return messages[0]

    def messages(self) -> Iterator[Message]:
        """All messages until the other end is closed."""
        while True:
            try:
                yield from self.receive()
            except EOFError:
                return

    def close(self) -> None:
        """Close; a `receive` that waits in another thread ends too."""
        with contextlib.suppress(OSError):  # the other end may be closed already
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
