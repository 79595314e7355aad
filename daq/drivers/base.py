"""Interface of the device drivers. A driver encodes the set-points, requests and heartbeats that a port sends.

A driver does no I/O. The thread of the port writes the bytes.
"""

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

DISARMED = ", and it has disarmed"  # confirmation of a zero command by an autopilot


class LinkRole(enum.StrEnum):
    """Role of this program on a link to an autopilot, which determines what it sends.

    Attributes
    ----------
    LISTEN
        Nothing is sent.
    ASK
        Requests of message rates, parameters and the round trip are sent, and requests of the operator, but no
        heartbeat and no set-point.
    DRIVE
        The program is the ground station: it sends heartbeats, requests and commands.
    RESCUE
        The watchdog sends only zero commands and disarms, in place of the process that drove.
    """

    # Nothing is sent. Even a heartbeat would have an effect: an autopilot takes it for that of its ground station.
    LISTEN = "listen"
    ASK = "ask"  # requests of rates and parameters are sent under a separate system id; no heartbeat, no command
    DRIVE = "drive"  # the program is the ground station: it sends heartbeats, requests and commands
    # The watchdog has replaced the process that drove. It sends only zero, and signs with a separate link id.
    RESCUE = "rescue"


@dataclass(frozen=True)
class LinkStatus:
    """State of the autopilot at the other end of a link, as last reported.

    Attributes
    ----------
    received
        Whether a heartbeat has been received.
    vehicle
        Software of the autopilot, for example "ArduPilot Rover".
    age
        Time since its last heartbeat [wall s]; infinite before the first one since the port was opened or the autopilot
        restarted.
    armed
        Whether the motors are armed.
    mode
        Name of the flight or driving mode, for example "MANUAL".
    ekf
        Flags of EKF_STATUS_REPORT; -1 before the first.
    parameters
        Values of the requested parameters that were answered, by name.
    parameters_pending
        Whether answers to parameter requests are still awaited. It is also True before the first request, and always in
        the role LISTEN.
    changed
        Changes of the parameters since they were first read, one line each; the last 1000.
    refused
        Message rates that the autopilot refused or did not answer, one line each.
    answer
        Answer to the last request, for example "arm: accepted" or "arm: failed (PreArm: ...)"; empty while it is
        awaited.
    alarm
        Last text of severity critical or above; empty without one, and again after an accepted arming.
    receiver
        Whether the autopilot has received a transmitter since its start; None: it has not reported this.
    other_station_frames
        Number of received frames with the `own_system_id` of the rig, which another ground station has sent.
    lost
        Number of frames that are missing by the sequence numbers.
    round_trip
        Shortest round trip of a TIMESYNC [wall s]; NaN before the first.
    """

    received: bool = False
    vehicle: str = ""
    age: float = math.inf
    armed: bool = False
    mode: str = ""
    ekf: int = -1
    parameters: dict[str, float] = dataclasses.field(default_factory=dict)
    parameters_pending: bool = True
    changed: tuple[str, ...] = ()
    refused: tuple[str, ...] = ()
    answer: str = ""
    alarm: str = ""
    receiver: bool | None = None
    other_station_frames: int = 0
    lost: int = 0
    round_trip: float = math.nan


class DeviceDriver(ABC):
    """Interface of the drivers. A driver encodes all bytes that one port sends to its device; it does not write them.

    Set-points are commands to thrusters, -1..1. `now` is wall time [s] with any origin. Other threads than that of the
    port call only `request`, `link_at`, `hint` and `message`.
    """

    @abstractmethod
    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """Encode set-points as the messages of the device.

        Parameters
        ----------
        dues
            Set-points to send now.
        held
            Present command, -1..1, of each node (controller or servo output) of the port.
        now
            Wall time [s].

        Returns
        -------
        list of (bytes, list of Due)
            Messages to write, each with the set-points that it contains.
        """

    def opened(self, now: float) -> None:
        """Discard the stored state of the link to the device. It is called whenever the port was opened.

        A driver that stores no such state does not override this method. `now` is wall time [s].
        """
        return

    def poll(self, now: float) -> bytes:
        """Return the bytes that the port must send at wall time `now` [s], without set-points: requests and heartbeats.

        The default returns no bytes.
        """
        return b""

    def wait(self, now: float) -> float:
        """Return the wall time [s] from `now` until `poll` may have bytes to send. The default is infinite."""
        return math.inf

    def request(self, action: str, value: float) -> None:
        """Store a request of the operator to the device, which `poll` sends. The default ignores it.

        This method is called from another thread than that of the port.

        Parameters
        ----------
        action
            "arm" or "disarm" the motors, change the "mode", "mute": send nothing for a time while thrust is commanded,
            or "leave": disarm if this program has armed the motors.
        value
            Number of the mode, or time of the muting [wall s]; unused for other requests.
        """
        return

    def shutdown_bytes(self, now: float) -> bytes:
        """Return the last bytes that the port sends to the device: after the last zero command and before it is closed.

        `now` is wall time [s]. The default returns no bytes.
        """
        return b""

    def zero(self, now: float) -> list[tuple[bytes, list[Due]]]:
        """Encode the command zero for all thrusters of the port, for an emergency stop by the watchdog.

        The result does not depend on earlier commands. It is a list of messages (bytes), each with an empty list of
        set-points. `now` is wall time [s]. The default returns no message.
        """
        return []

    def events(self) -> list[Event]:
        """Return the events of the device since the last call, for the log, and forget them.

        The default returns none.
        """
        return []

    def link_at(self, now: float) -> LinkStatus | None:
        """Return the state of the autopilot at the other end of the link, at wall time `now` [s].

        Return None if the device is no autopilot, which is the default.
        """
        return None

    @property
    def hint(self) -> str:
        """Advice to the user on the link, in one line; empty if there is none, which is the default."""
        return ""

    @property
    def confirmation(self) -> str:
        """Last words of the sentence "zero thrust was sent ...": whether the device has confirmed that it stopped.

        The default is empty, for a device that never answers.
        """
        return ""

    def message(self) -> str:
        """Return the fault of the link to the device in one line, such as a wrong signing key; empty without one.

        The default is empty.
        """
        return ""


@final
class PollingDriver(DeviceDriver):
    """Driver of a device that sends only on request: it encodes the same request in each period.

    Parameters
    ----------
    request
        Bytes of one request.
    period
        Time between two requests [wall s].

    Notes
    -----
    A delayed request does not delay the next ones. Requests that are late by a whole period are left out.
    """

    def __init__(self, request: bytes, period: float) -> None:
        """Store the bytes of one request, and the period of the requests [wall s]. The first request is due at once."""
        self._request, self._period = request, period
        self._due = 0.0  # wall time [s] of the next request

    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """Return an empty list, because the device drives no thruster."""
        return []

    def opened(self, now: float) -> None:
        """Make the next request due at wall time `now` [s], because the port was opened."""
        self._due = now

    def poll(self, now: float) -> bytes:
        """Return the request if it is due at wall time `now` [s], else no bytes.

        The next one is due a period after this one was due, or after `now` if that time has passed already.
        """
        if now < self._due:
            return b""
        self._due += self._period
        if self._due <= now:
            self._due = now + self._period
        return self._request

    def wait(self, now: float) -> float:
        """Return the wall time [s] from `now` until the next request is due; 0 if it is late."""
        return max(self._due - now, 0.0)
