"""Messages between the acquisition process, the parent that started it, and the watchdog: types and transport.

| from | to | messages |
|---|---|---|
| parent | acquisition process | Configuration first; ParentAlive, ScheduleSetpoints, ZeroThrust, LogEvent |
| | | DriverRequest, Stop; StreamSamples, once |
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

# Heartbeats: thrust is commanded; thrust is not commanded; the monitoring may end.
ACTIVE, IDLE, FINISHED = b"1", b"0", b"q"
ANSWER = b"a"  # answer of the watchdog to heartbeats


@dataclass(frozen=True)
class Configuration:
    """Configuration of the acquisition process: the first message that its parent sends to it.

    Attributes
    ----------
    rig_text
        Text of the rig file.
    rig_path
        Absolute path of the rig file.
    path
        Absolute path of the log.
    speed
        Run seconds per wall second.
    origin
        Raw monotonic time [s] and run time [s] of one instant (`RunClock.origin`).
    role
        Value of LinkRole: whether the process only listens to autopilots, requests data, or drives.
    attachments
        Attachments of the log: bytes by name.
    metadata
        Metadata of the log: texts by name.
    terminal
        Inherited file descriptor of the parent's standard error; -1 if it has none.
    """

    rig_text: str
    rig_path: str
    path: str
    speed: float
    origin: Sequence[float]
    role: str
    attachments: Mapping[str, bytes] = field(default_factory=dict)
    metadata: Mapping[str, str] = field(default_factory=dict)
    terminal: int = -1


@dataclass(frozen=True)
class ParentAlive:
    """Heartbeat of the parent process to the acquisition process.

    Attributes
    ----------
    runner
        Whether the runner of the mission has called `Acquisition.alive` since the last heartbeat.
    """

    runner: bool


@dataclass(frozen=True)
class ScheduleSetpoints:
    """Request of the parent to the acquisition process: append set-points to the schedule.

    Attributes
    ----------
    rows
        Run time [s], and the command n_cmd, -1..1, by name of the thruster, of each set-point.
    """

    rows: Sequence[tuple[float, Mapping[str, float]]]


@dataclass(frozen=True)
class ZeroThrust:
    """Request of the parent to the acquisition process: clear the schedule and command zero at once.

    Attributes
    ----------
    reason
        Reason, which is written to the log as an event.
    """

    reason: str


@dataclass(frozen=True)
class LogEvent:
    """Request of the parent to the acquisition process: write an event to the log.

    Attributes
    ----------
    kind
        Kind of the event, such as "zero" or "warning".
    text
        Description in one line.
    """

    kind: str
    text: str


@dataclass(frozen=True)
class DriverRequest:
    """Request of the parent to the acquisition process: send a request of the operator to an autopilot.

    Attributes
    ----------
    device
        Name of the device.
    action
        `arm`, `disarm`, `mode` or `mute` (send nothing while thrust is commanded).
    value
        Number of the mode for `mode`, wall seconds for `mute`; unused otherwise.
    """

    device: str
    action: str
    value: float


@dataclass(frozen=True)
class StreamSamples:
    """Request of the parent to the acquisition process: send the samples that are logged from now on to the parent.

    Events and samples of transducers are not sent. The request cannot be cancelled. A second request changes nothing.
    """


@dataclass(frozen=True)
class Stop:
    """Request of the parent to the acquisition process: command zero, close the log and end.

    Attributes
    ----------
    reason
        Text of the event "end" in the log.
    """

    reason: str = "closed on request"


@dataclass(frozen=True)
class StatusReport:
    """Message of the acquisition process to the parent, every 50 ms: the state of the acquisition.

    Attributes
    ----------
    status
        State of all ports, set-points and the log.
    """

    status: Status


@dataclass(frozen=True)
class SampleBatch:
    """Message of the acquisition process to the parent: samples that were written to the log.

    Attributes
    ----------
    samples
        The samples, oldest first.
    dropped
        Number of samples, since the request for samples, that could not be sent to the parent.
    """

    samples: Sequence[StreamedSample]
    dropped: int


@dataclass(frozen=True)
class Failed:
    """Last message of the acquisition process to the parent: the start failed, or the log could not be written.

    Attributes
    ----------
    reason
        The error in one line.
    """

    reason: str


@dataclass(frozen=True)
class Closed:
    """Last message of the acquisition process to the parent: the log is closed and was written without an error.

    Attributes
    ----------
    reason
        Why the acquisition ended, in one line. It may have ended by itself, for example because the parent hangs.
    """

    reason: str


@dataclass(frozen=True)
class WatchdogConfiguration:
    """First message of the acquisition process to the watchdog: the process to monitor, and the rig with the thrusters.

    Attributes
    ----------
    rig_text
        Text of the rig file.
    rig_path
        Path of the rig file.
    pid
        Process id of the acquisition process.
    log
        Absolute path of the log, beside which the watchdog writes its note.
    """

    rig_text: str
    rig_path: str
    pid: int
    log: str


@dataclass(frozen=True)
class WatchdogReady:
    """First message of the watchdog to the acquisition process: it is ready, or it cannot work.

    Attributes
    ----------
    trouble
        Why the watchdog cannot work; empty if it is ready.
    """

    trouble: str = ""


Message = (
    Configuration | ParentAlive | ScheduleSetpoints | ZeroThrust | LogEvent | DriverRequest | StreamSamples | Stop
    | StatusReport | SampleBatch | Failed | Closed | WatchdogConfiguration | WatchdogReady
)  # fmt: skip
_TYPES: dict[str, type[Message]] = {kind.__name__: kind for kind in Message.__args__}


def encode_message(message: Message) -> bytes:
    """Return a message between processes as one line of JSON, with the name of its type, its fields and a line end.

    NaN and infinity are written as the words NaN and Infinity, as Python's json does.
    """
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
    """Return the message between processes that `encode_message` has written as one line of JSON.

    An invalid line raises an error (such as ValueError, KeyError or TypeError), because both processes run the same
    program.
    """
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
    """End of the socket by which two processes exchange messages.

    Any thread may call `send`; only one thread may call `receive`.
    """

    def __init__(self, sock: socket.socket) -> None:
        """Use the connected stream socket `sock` for messages. `close` closes it."""
        self._socket = sock
        self._lock = threading.Lock()
        self._buffer = bytearray()

    def fileno(self) -> int:
        """Return the file descriptor of the socket, so that `select` can wait for messages of the other process."""
        return self._socket.fileno()

    def send(self, message: Message) -> None:
        """Send one message to the other process, and wait while the socket's buffer is full.

        Messages of several threads are never mixed. Raise OSError if the other process has closed its end.
        """
        data = encode_message(message)
        with self._lock:
            self._socket.sendall(data)

    def receive(self) -> list[Message]:
        """Wait for bytes of the other process, and return the messages that are complete now, oldest first.

        The list is empty if the bytes do not complete a message; they are kept for the next call.

        Raises
        ------
        EOFError
            If the other process has closed its end, or the socket has failed.
        """
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
        """Wait for the first message of the other process, and return it. Raise EOFError if it closes its end before.

        Further messages that arrive together with the first one are discarded.
        """
        while not (messages := self.receive()):
            pass
        return messages[0]

    def messages(self) -> Iterator[Message]:
        """Yield the messages of the other process one after the other, with waits, until it closes its end.

        The iteration then ends without an error.
        """
        while True:
            try:
                yield from self.receive()
            except EOFError:
                return

    def close(self) -> None:
        """Close the socket to the other process. A `receive` that waits in another thread ends with EOFError."""
        with contextlib.suppress(OSError):  # the other end may be closed already
            self._socket.shutdown(socket.SHUT_RDWR)
        self._socket.close()
