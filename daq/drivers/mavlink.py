"""Our half of a MAVLink link: as the ground station heartbeats, requests and their answers, set-points as RC override.

Who does not drive is no ground station (`LinkRole`): an autopilot that hears heartbeats of one would miss the loss of
the operator's, and would see the loss of ours.

No I/O and no clock: `now` is given. Services: mavlink.io/en/services/{heartbeat,command,parameter}.html.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, final

from seatrial.daq.drivers.ardupilot_parameters import (
    GROUND_STATION_NAMES,
    LINK_LOSS_PARAMETERS,
    NEWER_PARAMETERS,
    parameter_names,
)
from seatrial.daq.drivers.base import DISARMED, DeviceDriver, LinkRole, LinkStatus
from seatrial.daq.drivers.setpoints import Due
from seatrial.daq.errors import printable
from seatrial.daq.protocol import (
    ARMED,
    ESC_STATUS,
    INVALID,
    SEVERITIES,
    Codec,
    MavlinkDecoder,
    dialect,
    mode_name,
    vehicle_name,
)
from seatrial.daq.rig import Device, Thruster
from seatrial.daq.samples import Event

# All wall seconds.
HEARTBEAT_S = 1.0
ANSWER_S = 0.4  # to a command, before it is sent again
TRIES = 4
PARAMETER_S = 0.5
REREAD_S = 0.2  # between two parameters that are read again, in turn
MOST_CHANGES = 1000  # that are kept; so many end a run long before
PARAMETER_TRIES, YOUNG_TRIES = 10, 5  # fewer for what an older version may lack: it keeps quiet about those
REBOOT_MS = 1000  # its clock back by more: it has restarted
RATE_PART, RATE_BEATS = 0.5, 3  # less than this part of the attitudes for so many heartbeats: somebody else has asked
LATER_S = 30.0  # until that is looked at again
TIMESYNC_S, TRIPS = 1.0, 10  # the shortest of so many is told
LOST_S = 10.0  # between two events about lost frames
UNSIGNED_FRAMES = 20  # without one that bears our key
NEUTRAL_S = 0.05  # between neutral overrides while nothing is commanded
SET_INTERVAL, SET_MODE, ARM = 511, 176, 400  # MAV_CMD
ACCEPTED, TEMPORARILY_REJECTED, IN_PROGRESS = 0, 1, 5  # MAV_RESULT
RESULTS = ("accepted", "temporarily rejected", "denied", "unsupported", "failed", "in progress", "cancelled")
CRITICAL = 2  # STATUSTEXT.severity
IGNORED_LOW, IGNORED_HIGH = 0xFFFF, 0  # RC_CHANNELS_OVERRIDE: leave a channel alone, 1 to 8 and from 9 on
CUSTOM_MODE = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
GROUND_STATION = 6  # MAV_TYPE
ACTIVE = 4  # MAV_STATE
VERSION = 3  # HEARTBEAT.mavlink_version


@dataclass
class _Command:
    """One COMMAND_LONG under way."""

    number: int
    parameters: tuple[float, ...]
    what: str  # "arm", "disarm", "mode" or the name of a message
    rate: float = 0.0
    tries: int = 0
    sent: float = -math.inf


@final
class MavlinkDriver(DeviceDriver):
    """Driver of one autopilot; `receive` gets every message that the decoder accepts."""

    def __init__(
        self,
        device: Device,
        thrusters: Sequence[Thruster],
        codec: Codec,
        role: LinkRole,
        decoder: MavlinkDecoder,
    ) -> None:
        assert device.mavlink is not None
        self._role, self._decoder = role, decoder
        decoder.secure(codec)
        self._settings, self._rate_hz, self._codec = device.mavlink, device.rate_hz, codec
        self._outputs = {t.node: (t.output, t.reversed) for t in thrusters if t.output is not None}
        self._names = parameter_names(thrusters) if self._outputs else ()
        self._status = LinkStatus()
        self._events: list[Event] = []
        self._requests: deque[tuple[str, float]] = deque()
        self._armed_by_us = False
        self._held: dict[int, float] = {}
        self._overridden = -math.inf  # when; minus infinity before the first
        self._muted_until = -math.inf
        self._disarmed = False  # an answer says so
        self._attitude_hz = self._settings.requested(self._rate_hz).get("ATTITUDE", 0.0)
        self._lost_told, self._lost_at = 0, -math.inf
        self._reread_at, self._reread_turn = -math.inf, 0
        self._rates_at = -math.inf  # when they may be asked for again
        self.opened(0.0)

    def opened(self, now: float) -> None:
        """Request everything again, from the first heartbeat on."""
        self._beat = self._last_heartbeat = -math.inf
        self._commands: deque[_Command] = deque()
        self._awaited: dict[str, int] = {}  # parameters and how often each is still to be requested
        self._asked = -math.inf
        self._reasons: list[str] = []
        self._refusal = ""  # the last request's, without its reasons
        self._started = False
        self._boot_ms = 0  # the newest
        self._attitudes = self._slow_beats = 0
        self._chunk = (0, "")
        self._synced, self._trips = -math.inf, 0
        self._status = replace(self._status, receiver=None)

    def receive(self, message: Any, now: float) -> None:
        """A message of the autopilot."""
        name = message.get_type()
        if name == "ATTITUDE":
            if message.time_boot_ms < self._boot_ms - REBOOT_MS:
                self.opened(now)  # it has forgotten what it was asked for
                self._events.append(Event("autopilot", "it has restarted: rates and parameters are asked for again"))
            self._boot_ms = message.time_boot_ms
            self._attitudes += 1
        if name == "HEARTBEAT" and message.autopilot != INVALID:
            self._receive_heartbeat(message, now)
        elif name == "COMMAND_ACK":
            self._receive_answer(message)
        elif name == "PARAM_VALUE":
            self._receive_parameter(message)
        elif name == "STATUSTEXT":
            self._receive_text(message)
        elif name == "EKF_STATUS_REPORT":
            self._status = replace(self._status, ekf=message.flags)
        elif name == "RC_CHANNELS":  # no channels where no receiver was ever heard; our overrides are none
            self._status = replace(self._status, receiver=message.chancount > 0)
        elif name == "TIMESYNC" and message.tc1 and message.ts1:
            self._receive_timesync(message, now)

    def _receive_heartbeat(self, m: Any, now: float) -> None:
        since, self._last_heartbeat = now - self._last_heartbeat, now
        mode, armed = mode_name(m.custom_mode, m.type, m.autopilot), bool(m.base_mode & ARMED)
        self._armed_by_us = self._armed_by_us and armed
        vehicle = vehicle_name(m.autopilot, m.type)
        self._status = replace(self._status, received=True, vehicle=vehicle, armed=armed, mode=mode)
        if not self._started:
            self._started = True
            self._beat = -math.inf  # on UDP a message without a receiver is lost
            lacked = NEWER_PARAMETERS.union(GROUND_STATION_NAMES)
            self._awaited = {name: YOUNG_TRIES if name in lacked else PARAMETER_TRIES for name in self._names}
            self._ask_rates(now)
        elif not self._commands and now >= self._rates_at:
            self._slow_beats = self._slow_beats + 1 if self._attitudes < RATE_PART * self._attitude_hz * since else 0
            if self._slow_beats >= RATE_BEATS:
                self._events.append(Event("autopilot", "its rates have fallen: they are asked for again"))
                self._ask_rates(now)
        self._attitudes = 0

    def _ask_rates(self, now: float) -> None:
        self._slow_beats, self._rates_at = 0, now + LATER_S
        self._commands += [_interval(name, rate) for name, rate in self._settings.requested(self._rate_hz).items()]

    def _receive_timesync(self, m: Any, now: float) -> None:
        """The answer to one of ours: how long both ways took, at best. The stamps of its samples are late by half."""
        trip = now - m.ts1 * 1e-9
        if 0.0 < trip < TIMESYNC_S and not trip >= self._status.round_trip:
            self._status = replace(self._status, round_trip=trip)
        self._trips += 1
        if self._trips == TRIPS and math.isfinite(self._status.round_trip):
            text = f"{1e3 * self._status.round_trip:.1f} ms there and back (TIMESYNC): stamps are late by half of it"
            self._events.append(Event("autopilot", text))

    def _receive_answer(self, m: Any) -> None:
        if m.target_system not in (0, self._codec.system):
            return  # the answer to another ground station
        self._disarmed = self._disarmed or (self._role is LinkRole.RESCUE and m.command == ARM and m.result == ACCEPTED)
        if not self._commands or self._commands[0].number != m.command or m.result == IN_PROGRESS:
            return
        command = self._commands[0]
        if not command.tries:
            return  # the answer to the arming that it has taken the place of
        word = RESULTS[m.result] if m.result < len(RESULTS) else f"result {m.result}"
        if command.number == SET_INTERVAL:
            self._commands.popleft()
            if m.result != ACCEPTED:
                self._refused(command, word)
        elif m.result == TEMPORARILY_REJECTED and command.tries < TRIES:
            return  # sent again when its time has passed
        else:
            self._commands.popleft()
            if command.what == "arm" and m.result == ACCEPTED:
                self._armed_by_us = True
                self._status = replace(self._status, alarm="")  # of before: it has judged itself fit
            self._refusal = "" if m.result == ACCEPTED else f"{command.what}: {word}"
            reasons = f" ({'; '.join(self._reasons)})" if self._refusal and self._reasons else ""
            self._answer(command.what, word + reasons)

    def _refused(self, command: _Command, word: str) -> None:
        """Log a refused rate and request half of it; the old rate stays until one is accepted."""
        line = f"{command.what} at {command.rate:g} Hz: {word}"
        if line not in self._status.refused:
            self._status = replace(self._status, refused=(*self._status.refused, line))
        if command.what == "ATTITUDE":
            self._attitude_hz = command.rate / 2.0
        self._events.append(Event("autopilot", f"refuses {line}"))
        if word == "denied" and command.rate > 1.0:
            self._commands.appendleft(_interval(command.what, command.rate / 2.0))

    def _answer(self, what: str, word: str) -> None:
        self._status = replace(self._status, answer=f"{what}: {word}")
        self._events.append(Event("autopilot", self._status.answer))

    def _receive_parameter(self, m: Any) -> None:
        if self._awaited.pop(m.param_id, None) is not None or m.param_id in self._names:
            if m.param_id in GROUND_STATION_NAMES:  # it has one of both
                self._awaited = {name: n for name, n in self._awaited.items() if name not in GROUND_STATION_NAMES}
            parameters = {**self._status.parameters, m.param_id: float(m.param_value)}
            before = self._status.parameters.get(m.param_id)
            if before is not None and before != m.param_value:
                change = f"{m.param_id} was changed: {before:g} to {m.param_value:g}"
                self._events.append(Event("parameter", change))
                self._status = replace(self._status, changed=(*self._status.changed, change)[-MOST_CHANGES:])
            elif before is None:
                self._events.append(Event("parameter", f"{m.param_id} = {m.param_value:g}"))
            self._status = replace(self._status, parameters=parameters)

    def _receive_text(self, m: Any) -> None:
        number, before = self._chunk
        goes_on = bool(m.id and m.id == number and m.chunk_seq)  # a later part of a long text
        text = before + printable(m.text) if goes_on else printable(m.text)
        self._chunk = (m.id, text)
        if text.startswith(("PreArm:", "Arm:")):
            self._reasons = [*(self._reasons[:-1] if goes_on else self._reasons), text][-3:]
            if self._refusal:  # its reasons come after the answer
                self._status = replace(self._status, answer=f"{self._refusal} ({'; '.join(self._reasons)})")
        elif m.severity <= CRITICAL and (goes_on or not m.chunk_seq):  # without its beginning there is nothing to go by
            self._status = replace(self._status, alarm=f"{SEVERITIES[m.severity]}: {text}")

    def request(self, action: str, value: float) -> None:
        """`arm`, `disarm`, `mode` with its number, `mute` for so many seconds (nothing is sent but zero, as if the link
        were cut), or `leave`: disarm what was armed by us."""
        self._requests.append((action, value))

    def _take_requests(self, now: float) -> None:
        while self._requests:
            action, value = self._requests.popleft()
            if action == "leave":
                if self._armed_by_us:
                    self._put_first(_Command(ARM, (0.0,) * 7, "disarm"))
                continue
            if action == "mute":
                self._muted_until = now + value
                continue
            self._reasons, self._refusal = [], ""
            self._status = replace(self._status, answer="")
            if action == "mode":
                self._put_first(_Command(SET_MODE, (CUSTOM_MODE, value, 0, 0, 0, 0, 0), action))
            else:  # param2 stays 0: no forced arming, ever
                self._put_first(_Command(ARM, (float(action == "arm"), 0, 0, 0, 0, 0, 0), action))

    def _put_first(self, command: _Command) -> None:
        """Before the rates, of which each may take a second and more, and in the place of an earlier request: a disarm
        waits for nothing, and no arming comes after it."""
        self._commands = deque([command, *(one for one in self._commands if one.number == SET_INTERVAL)])

    def poll(self, now: float) -> bytes:
        """Heartbeat, the first command of the queue, parameter requests, neutral while no thrust is commanded."""
        if self._role is LinkRole.LISTEN:
            self._requests.clear()
            return b""
        self._take_requests(now)
        if self._is_muted(now):
            return b""
        out = b""
        if self._role is LinkRole.DRIVE and now - self._beat >= HEARTBEAT_S:
            self._beat = now
            out += self._codec.encode("HEARTBEAT", GROUND_STATION, INVALID, 0, 0, ACTIVE, VERSION)
        if self._started and now - self._synced >= TIMESYNC_S:
            self._synced = now
            out += self._codec.encode("TIMESYNC", 0, round(now * 1e9))
        if self._started:
            out += self._poll_command(now) + self._poll_parameters(now)
        if self._is_idle(now):
            out += self._override(now)
        return out

    def _is_muted(self, now: float) -> bool:
        """Whether the link is as if cut; a zero is sent in any case."""
        return now < self._muted_until and any(self._held.values())

    def _is_idle(self, now: float) -> bool:
        """Whether neutral is due again: without it a vehicle does not arm, or detects a lost link."""
        told = math.isfinite(self._overridden) and not any(self._held.values())
        return told and now - self._overridden >= NEUTRAL_S

    def _poll_command(self, now: float) -> bytes:
        while self._commands:
            command = self._commands[0]
            if now - command.sent < ANSWER_S:
                return b""
            if command.tries >= TRIES:
                self._commands.popleft()
                if command.number == SET_INTERVAL:
                    self._refused(command, "no answer")
                else:
                    self._answer(command.what, "no answer")
                continue
            command.sent, command.tries = now, command.tries + 1
            return self._long(command)
        return b""

    def _long(self, command: _Command) -> bytes:
        who = (self._settings.system_id, self._settings.component_id)
        return self._codec.encode("COMMAND_LONG", *who, command.number, command.tries - 1, *command.parameters)

    def _poll_parameters(self, now: float) -> bytes:
        if not self._awaited:
            if self._status.parameters_pending:
                self._status = replace(self._status, parameters_pending=False)
            return self._reread(now)
        if now - self._asked < PARAMETER_S:
            return b""
        self._asked = now
        # It does not answer for what it has not: older and newer versions name things differently.
        if unanswered := [name for name, left in self._awaited.items() if not left]:
            self._events.append(Event("parameter", f"not answered: {', '.join(unanswered)}"))
        self._awaited = {name: left - 1 for name, left in self._awaited.items() if left}
        who = (self._settings.system_id, self._settings.component_id)
        return b"".join(self._codec.encode("PARAM_REQUEST_READ", *who, name.encode(), -1) for name in self._awaited)

    def _reread(self, now: float) -> bytes:
        """Read one parameter again: another station may change it, and its announcement may be lost on the way."""
        if self._role is not LinkRole.DRIVE or now - self._reread_at < REREAD_S:
            return b""
        # Those that decide what a lost link does come every other time.
        urgent = [name for name in LINK_LOSS_PARAMETERS if name in self._status.parameters]
        others = [name for name in self._names if name in self._status.parameters and name not in urgent]
        turn, self._reread_turn, self._reread_at = self._reread_turn, self._reread_turn + 1, now
        names = (urgent if turn % 2 == 0 else others) or urgent or others
        if not names:
            return b""
        who = (self._settings.system_id, self._settings.component_id)
        return self._codec.encode("PARAM_REQUEST_READ", *who, names[turn // 2 % len(names)].encode(), -1)

    def wait(self, now: float) -> float:
        """Seconds until `poll` may have something."""
        if self._requests:
            return 0.0
        if self._role is LinkRole.LISTEN:
            return math.inf
        if self._is_muted(now):
            return self._muted_until - now
        times = [self._beat + HEARTBEAT_S if self._role is LinkRole.DRIVE else math.inf]
        times += [self._synced + TIMESYNC_S] if self._started else []
        if self._started and self._commands:
            times.append(self._commands[0].sent + ANSWER_S)
        if self._started and (self._awaited or self._status.parameters_pending):
            times.append(self._asked + PARAMETER_S)
        elif self._started and self._role is LinkRole.DRIVE and self._status.parameters:
            times.append(self._reread_at + REREAD_S)
        if math.isfinite(self._overridden) and not any(self._held.values()):
            times.append(self._overridden + NEUTRAL_S)
        return max(min(times) - now, 0.0)

    def command(self, dues: Sequence[Due], held: Mapping[int, float], now: float) -> list[tuple[bytes, list[Due]]]:
        """One RC_CHANNELS_OVERRIDE with every thruster of the link; those without a command are at neutral."""
        self._held = dict(held)
        return [(self._override(now), list(dues))] if dues and not self._is_muted(now) else []

    def zero(self, now: float) -> list[tuple[bytes, list[Due]]]:
        """Neutral, and disarm: no further command will follow."""
        self._held = {}
        data = self._override(now) + self._long(_Command(ARM, (0.0,) * 7, "disarm", tries=1))
        return [(data, [])]

    def _override(self, now: float) -> bytes:
        self._overridden = now
        channels = [IGNORED_LOW] * 8 + [IGNORED_HIGH] * 10
        for node, (output, is_reversed) in self._outputs.items():
            n = self._held.get(node, 0.0)
            channels[output.rc_channel - 1] = output.command(-n if is_reversed else n)
        who = (self._settings.system_id, self._settings.component_id)
        return self._codec.encode("RC_CHANNELS_OVERRIDE", *who, *channels)

    @property
    def hint(self) -> str:
        """What a listener does not get."""
        if self._role is not LinkRole.LISTEN:
            return ""
        return "only listened to, so the rates are the autopilot's own; --request-rates asks for those of the rig"

    def shutdown_bytes(self, now: float) -> bytes:
        """Disarm what was armed by us. Sent twice, since no answer is awaited."""
        if not self._armed_by_us:
            return b""
        command = _Command(ARM, (0.0,) * 7, "disarm", tries=1)
        return self._long(command) * 2

    @property
    def confirmation(self) -> str:
        """Whether it has answered that it is disarmed."""
        return DISARMED if self._disarmed else ", and not answered: it may still be armed"

    def message(self) -> str:
        """What is wrong with signatures, where anything is."""
        decoder = self._decoder
        if self._role is not LinkRole.LISTEN and decoder.signed and not self._codec.signs:
            return "it signs its frames and will ignore ours: the rig has no key_file for it"
        if self._codec.signs and not decoder.accepted and decoder.unsigned >= UNSIGNED_FRAMES:
            how = "with another key than key_file" if decoder.signed else "nothing"
            return f"{decoder.unsigned} of its frames were left out: it signs {how}"
        return ""

    def events(self) -> list[Event]:
        """What happened since the last call."""
        if self._decoder.lost > self._lost_told and self._last_heartbeat - self._lost_at >= LOST_S:
            self._lost_told, self._lost_at = self._decoder.lost, self._last_heartbeat
            text = f"{self._lost_told} of its {self._lost_told + self._decoder.frames} frames were lost on the way"
            self._events.append(Event("autopilot", text))
        out, self._events = self._events, []
        return out

    def link_at(self, now: float) -> LinkStatus:
        """The state at `now`."""
        rivals = self._decoder.foreign.get(self._settings.own_system_id, 0)
        age = now - self._last_heartbeat
        return replace(self._status, age=age, rivals=rivals, lost=self._decoder.lost)


def _interval(message: str, rate: float) -> _Command:
    number = ESC_STATUS if message == "ESC_STATUS" else int(getattr(dialect(), f"MAVLINK_MSG_ID_{message}"))
    return _Command(SET_INTERVAL, (float(number), 1e6 / rate, 0, 0, 0, 0, 0), message, rate)
