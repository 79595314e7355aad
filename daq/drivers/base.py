"""Device drivers: what the thread of a port sends besides listening: set-points, requests, heartbeats. No I/O."""

from __future__ import annotations

import dataclasses
import enum
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

from seatrial.daq.drivers.setpoints import Due
from seatrial.daq.samples import Event

DISARMED = ", and it has disarmed"  # confirmation of a zero


class LinkRole(enum.StrEnum):
    """What we are to the device at the other end of a link."""

    LISTEN = "listen"  # nothing is sent: not even a heartbeat, which an autopilot takes for its ground station's
    ASK = "ask"  # requests (rates, parameters) under a system id of its own; no heartbeat, no command
    DRIVE = "drive"  # the ground station: heartbeats, requests, commands
    RESCUE = "rescue"  # the watchdog in the place of who drove: zero alone, signed as a link of its own


@dataclass(frozen=True)
class LinkStatus:
    """State of the autopilot at the other end of a link, as last reported."""

    received: bool = False  # any heartbeat so far
    vehicle: str = ""  # its software, as "ArduPilot Rover"
    age: float = math.inf  # wall s since its last heartbeat
    armed: bool = False
    mode: str = ""
    ekf: int = -1  # flags of EKF_STATUS_REPORT; -1 before the first
    parameters: dict[str, float] = dataclasses.field(default_factory=dict)  # those requested that it has
    parameters_pending: bool = True  # answers to parameter requests are still awaited
    changed: tuple[str, ...] = ()  # changes of the parameters since they were first read, one line each
    refused: tuple[str, ...] = ()  # message rates that it refused, one line each
    answer: str = ""  # to the last request: "arm: accepted", "arm: failed (PreArm: ...)"; empty while awaited
    alarm: str = ""  # the last text of severity critical or above
    receiver: bool | None = None  # whether it has heard one of a transmitter since it started; None: not said
    rivals: int = 0  # frames of another ground station with our own system id
    lost: int = 0  # frames that its sequence numbers count and that did not come
    round_trip: float = math.nan  # wall s, the shortest of a TIMESYNC


class DeviceDriver(ABC):
    """What one port sends. `now` is wall time of any origin; all methods but `request` run in the port's thread."""

    @abstractmethod
    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """Encoded set-points, each with the set-points it carries; `held` are the present commands by node."""

    def opened(self, now: float) -> None:
        """The port was opened, for the first time or again."""
        return

    def poll(self, now: float) -> bytes:
        """The bytes to send now besides set-points."""
        return b""

    def wait(self, now: float) -> float:
        """Seconds until `poll` may have something."""
        return math.inf

    def request(self, action: str, value: float) -> None:
        """A request of the operator, called from another thread: `arm`, `disarm`, `mode` with its number, or `mute` for
        so many seconds, in which no command is sent but zero."""
        return

    def shutdown_bytes(self, now: float) -> bytes:
        """The last bytes before the port is closed for good, after the last zero."""
        return b""

    def zero(self, now: float) -> list[tuple[bytes, list[Due]]]:
        """Zero to every thruster on the link, whatever was sent before: the last resort."""
        return []

    def events(self) -> list[Event]:
        """Events since the last call, for the log."""
        return []

    def link_at(self, now: float) -> LinkStatus | None:
        """State of the device at the other end; None where it reports none."""
        return None

    @property
    def hint(self) -> str:
        """A possible improvement of the link, in one line; empty without one."""
        return ""

    @property
    def confirmation(self) -> str:
        """What the device has answered to `zero`, to be added to a line; empty for one that does not answer."""
        return ""

    def message(self) -> str:
        """The fault of the link, in one line; empty without one."""
        return ""


@final
class PollingDriver(DeviceDriver):
    """Sends `request` every `period` wall seconds, on time on average; missed requests are not repeated."""

    def __init__(self, request: bytes, period: float) -> None:
        self._request, self._period = request, period
        self._due = 0.0

    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """None: it drives no thruster."""
        return []

    def opened(self, now: float) -> None:
        """Ask at once."""
        self._due = now

    def poll(self, now: float) -> bytes:
        """The request when it is time for it."""
        if now < self._due:
            return b""
        self._due += self._period
        if self._due <= now:
            self._due = now + self._period
        return self._request

    def wait(self, now: float) -> float:
        """Until the next request."""
        return max(self._due - now, 0.0)
