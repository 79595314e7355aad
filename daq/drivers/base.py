"""Device drivers: what the thread of a port sends besides listening: set-points, requests, heartbeats. No I/O."""

from __future__ import annotations

import dataclasses
import math
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import final

from daq.drivers.setpoints import Due
from daq.samples import Event


@dataclass(frozen=True)
class LinkStatus:
    """State of the autopilot at the other end of a link, as last reported."""

    received: bool = False  # any heartbeat so far
    age: float = math.inf  # wall s since its last heartbeat
    armed: bool = False
    mode: str = ""
    ekf: int = -1  # flags of EKF_STATUS_REPORT; -1 before the first
    parameters: dict[str, float] = dataclasses.field(default_factory=dict)  # those requested that it has
    parameters_pending: bool = True  # answers to parameter requests are still awaited
    refused: tuple[str, ...] = ()  # message rates that it refused, one line each
    answer: str = ""  # to the last request: "arm: accepted", "arm: failed (PreArm: ...)"; empty while awaited
    alarm: str = ""  # the last text of severity critical or above


class DeviceDriver(ABC):
    """The speaking half of one port. `now` is wall time of any origin; called from the port's thread alone."""

    @abstractmethod
    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """The bytes of set-points, with those that they carry; `held` is what every node holds now."""

    def opened(self, now: float) -> None:
        """The port was opened, for the first time or again."""
        return

    def poll(self, now: float) -> bytes:
        """What is to be sent now beside set-points."""
        return b""

    def wait(self, now: float) -> float:
        """Seconds until `poll` may have something."""
        return math.inf

    def request(self, action: str, value: float) -> None:
        """A request of the operator: `arm`, `disarm`, `mode` with its number. Called from another thread."""
        return

    def shutdown_bytes(self, now: float) -> bytes:
        """The last bytes before the port is closed for good, behind the last zero."""
        return b""

    def zero(self, now: float) -> list[tuple[bytes, list[Due]]]:
        """Zero to everything on the link, whatever was said before: the last resort."""
        return []

    def events(self) -> list[Event]:
        """What happened since the last call, for the log."""
        return []

    def link_at(self, now: float) -> LinkStatus | None:
        """What the other end is known to be; None where there is nobody to talk with."""
        return None

    def message(self) -> str:
        """What is wrong with the link, in one line; empty when nothing is."""
        return ""


@final
class PollingDriver(DeviceDriver):
    """Sends `request` every `period` wall seconds, on time on average; what was missed is not made up for."""

    def __init__(self, request: bytes, period: float) -> None:
        self._request, self._period = request, period
        self._due = 0.0

    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """It drives nothing."""
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
