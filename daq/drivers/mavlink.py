"""Driver of a MAVLink link: heartbeats, requests and their answers, and set-points as RC overrides.

A program sends heartbeats of a ground station only if it drives (`LinkRole`). Heartbeats of a program that only logs
would be harmful: the autopilot would not detect the loss of the operator's ground station, and it would react to the
end of that program.

The driver does no I/O and reads no clock; `now` is a parameter. Sources:
mavlink.io/en/services/{heartbeat,command,parameter}.html.
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

# All times are wall time [s].
HEARTBEAT_S = 1.0  # between two heartbeats
ANSWER_S = 0.4  # without an answer, after which a command is sent again
TRIES = 4  # of a command
PARAMETER_S = 0.5  # between two requests of the missing parameters
REREAD_S = 0.2  # between two parameters that are read again, one after the other
MOST_CHANGES = 1000  # kept changes of parameters; a run ends long before this number is reached
PARAMETER_TRIES = 10
NEWER_TRIES = 5  # of parameters that an older version may lack; such a version never answers
REBOOT_MS = 1000  # ms; if the autopilot's clock decreases by more than this, it has restarted
# Fewer attitudes than this fraction of the requested rate, for this number of heartbeats, mean that another ground
# station has changed the rates.
RATE_PART, RATE_BEATS = 0.5, 3
LATER_S = 30.0  # after a request of the rates, in which they are not checked again
TIMESYNC_S, TRIPS = 1.0, 10  # between two TIMESYNC; number of round trips of which the shortest is reported
LOST_S = 10.0  # between two events about lost frames
FOREIGN_FRAMES = 20  # frames of other systems, and none of the autopilot, that are reported as a fault
LOWEST_STATION_ID = 250  # ground stations count down from 255, and vehicles up from 1
UNSIGNED_FRAMES = 20  # frames without a correct signature that are reported as a fault
NEUTRAL_S = 0.05  # between two neutral overrides while no thrust is commanded
SET_INTERVAL, SET_MODE, ARM = 511, 176, 400  # MAV_CMD
ACCEPTED, TEMPORARILY_REJECTED, IN_PROGRESS = 0, 1, 5  # MAV_RESULT
RESULTS = ("accepted", "temporarily rejected", "denied", "unsupported", "failed", "in progress", "cancelled")
CRITICAL = 2  # STATUSTEXT.severity
IGNORED_LOW, IGNORED_HIGH = 0xFFFF, 0  # RC_CHANNELS_OVERRIDE: do not change the channel (1 to 8; 9 and higher)
CUSTOM_MODE = 1  # MAV_MODE_FLAG_CUSTOM_MODE_ENABLED
GROUND_STATION = 6  # MAV_TYPE
ACTIVE = 4  # MAV_STATE
VERSION = 3  # HEARTBEAT.mavlink_version


@dataclass
class _Command:
    """Command to the autopilot (MAVLink message COMMAND_LONG) in the queue, not yet sent or not yet answered.

    Attributes
    ----------
    number
        Number of the command (MAV_CMD).
    parameters
        Parameters 1 to 7 of the command.
    label
        "arm", "disarm", "mode", or the name of the message whose rate is requested.
    rate
        Requested rate of a message [Hz]; 0 for other commands.
    tries
        How often the command was sent.
    sent
        Wall time [s] at which it was sent last.
    """

    number: int
    parameters: tuple[float, ...]
    label: str
    rate: float = 0.0
    tries: int = 0
    sent: float = -math.inf


@final
class MavlinkDriver(DeviceDriver):
    """Driver of one autopilot on a MAVLink link. The decoder calls `receive` with each message that it accepts.

    Parameters
    ----------
    device
        The device in the rig, with its MAVLink settings.
    thrusters
        Thrusters behind the autopilot.
    codec
        Encoder of the frames, with system id and signing key. It is also given to the decoder.
    role
        Role of this program on the link. In the role LISTEN nothing is sent.
    decoder
        Decoder of the link, with its counters.
    """

    def __init__(
        self,
        device: Device,
        thrusters: Sequence[Thruster],
        codec: Codec,
        role: LinkRole,
        decoder: MavlinkDecoder,
    ) -> None:
        """Prepare the link to an autopilot, and give the codec to the decoder. Nothing is sent.

        The caller has to set `receive` as the listener of the decoder. The parameters are described in the docstring of
        the class.
        """
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
        self._overridden = -math.inf  # wall s of the last override; minus infinity before the first
        self._muted_until = -math.inf  # wall s
        self._disarmed = False  # whether the autopilot has accepted our disarming
        self._attitude_hz = self._settings.requested(self._rate_hz).get("ATTITUDE", 0.0)
        self._reported_lost, self._lost_at = 0, -math.inf  # frames, and wall s, of the last event about lost frames
        self._reread_at, self._reread_turn = -math.inf, 0
        self._rates_at = -math.inf  # wall s, before which the rates are not requested again
        self.opened(0.0)

    def opened(self, now: float) -> None:
        """Discard the state of the link to the autopilot, because the port was opened or the autopilot has restarted.

        Commands in the queue are dropped. After the next heartbeat of the autopilot, rates and parameters are requested
        again. The reported state (`LinkStatus`) stays, except `receiver`, and `age`, which is infinite until the next
        heartbeat. Requests of the operator that `poll` has not taken up stay too. `now` is not used.
        """
        self._beat = self._last_heartbeat = -math.inf  # wall s of our last heartbeat, and of the autopilot's
        self._commands: deque[_Command] = deque()
        self._awaited: dict[str, int] = {}  # missing parameter -> remaining number of requests
        self._asked = -math.inf  # wall s of the last request of parameters
        self._reasons: list[str] = []  # texts of the autopilot with reasons for a refusal
        self._refusal = ""  # refusal of the last request, without reasons
        self._started = False  # whether a heartbeat has been received
        self._boot_ms = 0  # ms since boot, of the newest attitude
        self._attitudes = self._slow_beats = 0  # attitudes since the last heartbeat; heartbeats with low rates in a row
        self._chunk = (0, "")  # id and received part of a long text
        self._synced, self._trips = -math.inf, 0
        self._status = replace(self._status, receiver=None)

    def receive(self, message: Any, now: float) -> None:
        """Update the state of the link from a message of the autopilot, received at wall time `now` [s].

        The messages are attitudes, heartbeats, answers to commands, parameters, texts, and the state of estimator,
        receiver and clock. Messages of other types are ignored.
        """
        name = message.get_type()
        if name == "ATTITUDE":
            if message.time_boot_ms < self._boot_ms - REBOOT_MS:
                self.opened(now)  # the restarted autopilot has lost the requested rates
                text = "the autopilot has restarted: rates and parameters are requested again"
                self._events.append(Event("autopilot", text))
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
        elif name == "RC_CHANNELS":  # chancount is 0 before the first RC receiver; our overrides do not count
            self._status = replace(self._status, receiver=message.chancount > 0)
        elif name == "TIMESYNC" and message.tc1 and message.ts1:
            self._receive_timesync(message, now)

    def _receive_heartbeat(self, m: Any, now: float) -> None:
        """Update mode and arming of the autopilot from its heartbeat `m`, received at wall time `now` [s].

        After the first heartbeat, the message rates and the parameters are requested. The rates are requested again if
        fewer than half of the requested attitudes arrived during 3 heartbeats in a row (RATE_PART, RATE_BEATS). This is
        checked while no command is in the queue, from 30 s after the last request on (LATER_S). Once the autopilot is
        disarmed, it no longer counts as armed by this program.
        """
        since, self._last_heartbeat = now - self._last_heartbeat, now
        mode, armed = mode_name(m.custom_mode, m.type, m.autopilot), bool(m.base_mode & ARMED)
        self._armed_by_us = self._armed_by_us and armed
        vehicle = vehicle_name(m.autopilot, m.type)
        self._status = replace(self._status, received=True, vehicle=vehicle, armed=armed, mode=mode)
        if not self._started:
            self._started = True
            self._beat = -math.inf  # send a heartbeat at once: on UDP the earlier ones were lost, without a receiver
            may_lack = NEWER_PARAMETERS.union(GROUND_STATION_NAMES)
            self._awaited = {name: NEWER_TRIES if name in may_lack else PARAMETER_TRIES for name in self._names}
            self._ask_rates(now)
        elif not self._commands and now >= self._rates_at:
            self._slow_beats = self._slow_beats + 1 if self._attitudes < RATE_PART * self._attitude_hz * since else 0
            if self._slow_beats >= RATE_BEATS:
                text = "the message rates have fallen: they are requested again"
                self._events.append(Event("autopilot", text))
                self._ask_rates(now)
        self._attitudes = 0

    def _ask_rates(self, now: float) -> None:
        """Put a request for the rate of each message that the rig needs into the queue of commands.

        The received rates are not checked for the next 30 s (LATER_S). `now` is wall time [s].
        """
        self._slow_beats, self._rates_at = 0, now + LATER_S
        self._commands += [_rate_request(name, rate) for name, rate in self._settings.requested(self._rate_hz).items()]

    def _receive_timesync(self, m: Any, now: float) -> None:
        """Compute the round trip [s] from the autopilot's answer `m` to our TIMESYNC, and keep the shortest one.

        The answer arrived at wall time `now` [s]. A round trip that is not between 0 and 1 s is ignored. The time
        stamps of the samples are late by about half of the round trip. After 10 answers (TRIPS), the result is logged
        as an event.
        """
        trip = now - m.ts1 * 1e-9
        if 0.0 < trip < TIMESYNC_S and not trip >= self._status.round_trip:
            self._status = replace(self._status, round_trip=trip)
        self._trips += 1
        if self._trips == TRIPS and math.isfinite(self._status.round_trip):
            text = (
                f"round trip of {1e3 * self._status.round_trip:.1f} ms (TIMESYNC): time stamps are late by half of it"
            )
            self._events.append(Event("autopilot", text))

    def _receive_answer(self, m: Any) -> None:
        """Process the autopilot's answer to a command (message COMMAND_ACK `m`).

        Answers to other ground stations are ignored. In the role RESCUE, an accepted disarming is stored for
        `confirmation`, whatever the queue contains. Apart from this, only an answer to the first command of the queue
        counts, and only if this command was sent already. If a request of the operator was temporarily rejected, it is
        sent again, up to 4 times in all (TRIES). "In progress" is ignored. Otherwise the command is removed from the
        queue. The answer to a request of the operator is then stored and logged. A message rate that is not accepted,
        also temporarily, is logged, and requested again at half the rate only if it was denied.
        """
        if m.target_system not in (0, self._codec.system):
            return  # this is the answer to another ground station
        self._disarmed = self._disarmed or (self._role is LinkRole.RESCUE and m.command == ARM and m.result == ACCEPTED)
        if not self._commands or self._commands[0].number != m.command or m.result == IN_PROGRESS:
            return
        command = self._commands[0]
        if not command.tries:
            return  # the command has not been sent: this is the answer to the arming that it has replaced
        word = RESULTS[m.result] if m.result < len(RESULTS) else f"result {m.result}"
        if command.number == SET_INTERVAL:
            self._commands.popleft()
            if m.result != ACCEPTED:
                self._handle_refused_rate(command, word)
        elif m.result == TEMPORARILY_REJECTED and command.tries < TRIES:
            return  # the command is sent again after ANSWER_S
        else:
            self._commands.popleft()
            if command.label == "arm" and m.result == ACCEPTED:
                self._armed_by_us = True
                self._status = replace(self._status, alarm="")  # earlier alarms ended: the autopilot's checks passed
            self._refusal = "" if m.result == ACCEPTED else f"{command.label}: {word}"
            reasons = f" ({'; '.join(self._reasons)})" if self._refusal and self._reasons else ""
            self._store_answer(command.label, word + reasons)

    def _handle_refused_rate(self, command: _Command, word: str) -> None:
        """Log that the autopilot refused a message rate. If it was denied, request half the rate.

        `command` is the refused request, and `word` is the answer, such as "denied" or "no answer". A rate of 1 Hz or
        less is not requested again; the autopilot then keeps its old rate.
        """
        line = f"{command.label} at {command.rate:g} Hz: {word}"
        if line not in self._status.refused:
            self._status = replace(self._status, refused=(*self._status.refused, line))
        if command.label == "ATTITUDE":
            self._attitude_hz = command.rate / 2.0
        self._events.append(Event("autopilot", f"refuses {line}"))
        if word == "denied" and command.rate > 1.0:
            self._commands.appendleft(_rate_request(command.label, command.rate / 2.0))

    def _store_answer(self, label: str, word: str) -> None:
        """Store the answer to a request of the operator, and log it as an event.

        `label` is the request and `word` the answer, which together give a text such as "arm: accepted".
        """
        self._status = replace(self._status, answer=f"{label}: {word}")
        self._events.append(Event("autopilot", self._status.answer))

    def _receive_parameter(self, m: Any) -> None:
        """Store the value of a parameter of the autopilot, and log it if it is new or has changed.

        `m` is the message PARAM_VALUE. The parameter is then no longer awaited. A change is also stored in
        `LinkStatus.changed`. A parameter that a run does not need is ignored.
        """
        if self._awaited.pop(m.param_id, None) is not None or m.param_id in self._names:
            if m.param_id in GROUND_STATION_NAMES:  # each version has only one of both names
                self._awaited = {name: n for name, n in self._awaited.items() if name not in GROUND_STATION_NAMES}
            parameters = {**self._status.parameters, m.param_id: float(m.param_value)}
            previous = self._status.parameters.get(m.param_id)
            if previous is not None and previous != m.param_value:
                change = f"{m.param_id} was changed: {previous:g} to {m.param_value:g}"
                self._events.append(Event("parameter", change))
                self._status = replace(self._status, changed=(*self._status.changed, change)[-MOST_CHANGES:])
            elif previous is None:
                self._events.append(Event("parameter", f"{m.param_id} = {m.param_value:g}"))
            self._status = replace(self._status, parameters=parameters)

    def _receive_text(self, m: Any) -> None:
        """Store a text of the autopilot (message STATUSTEXT `m`) if it is important.

        A text that begins with "PreArm:" or "Arm:" is stored as the reason for a refused arming; the last three are
        kept. Another text of severity critical or above is stored as an alarm, which ends a run, unless its beginning
        is missing. All other texts are ignored here.
        """
        number, received = self._chunk
        continues = bool(m.id and m.id == number and m.chunk_seq)  # this is a later chunk of a long text
        text = received + printable(m.text) if continues else printable(m.text)
        self._chunk = (m.id, text)
        if text.startswith(("PreArm:", "Arm:")):
            self._reasons = [*(self._reasons[:-1] if continues else self._reasons), text][-3:]
            if self._refusal:  # the reasons arrive after the answer
                self._status = replace(self._status, answer=f"{self._refusal} ({'; '.join(self._reasons)})")
        elif m.severity <= CRITICAL and (continues or not m.chunk_seq):  # a chunk without the first one is useless
            self._status = replace(self._status, alarm=f"{SEVERITIES[m.severity]}: {text}")

    def request(self, action: str, value: float) -> None:
        """Store a request of the operator to the autopilot. Any thread may call this; `poll` sends the request.

        Parameters
        ----------
        action
            "arm" or "disarm"; "mode"; "mute", to send nothing for a time while thrust is commanded, as if the link was
            cut; "leave", to disarm the autopilot if this program has armed it. In the role LISTEN all are ignored.
        value
            Number of the mode, or time of the muting [wall s]; unused otherwise.
        """
        self._requests.append((action, value))

    def _take_requests(self, now: float) -> None:
        """Put the stored requests of the operator ("arm", "disarm", "mode", "leave") into the queue of commands.

        A request to mute is not queued; it takes effect at wall time `now` [s]. A request to leave is queued as a
        disarming if this program has armed the autopilot, and is else ignored.
        """
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
            else:  # param2 is always 0: arming is never forced
                self._put_first(_Command(ARM, (float(action == "arm"), 0, 0, 0, 0, 0, 0), action))

    def _put_first(self, command: _Command) -> None:
        """Put a command to the autopilot at the front of the queue, and remove all others except requests of rates.

        A disarming must not wait for the requests of rates, each of which may take more than a second. An arming that
        was requested earlier must not follow the disarming.
        """
        rates = (queued for queued in self._commands if queued.number == SET_INTERVAL)
        self._commands = deque([command, *rates])

    def poll(self, now: float) -> bytes:
        """Return the frames that have to be sent to the autopilot at wall time `now` [s], except commands of thrust.

        They are a heartbeat (role DRIVE only), TIMESYNC, the first command of the queue, requests of parameters, and a
        neutral RC override while no thrust is commanded. Before the first heartbeat of the autopilot there are only
        heartbeats and overrides. Nothing is returned in the role LISTEN or while sending is muted.
        """
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
        if self._is_neutral_due(now):
            out += self._encode_override(now)
        return out

    def _is_muted(self, now: float) -> bool:
        """Return whether sending is muted at wall time `now` [s], because the operator has requested it (`request`).

        While zero thrust is commanded, it is never muted: all frames are then sent.
        """
        return now < self._muted_until and any(self._held.values())

    def _is_neutral_due(self, now: float) -> bool:
        """Return whether the neutral command (RC override) has to be sent again at wall time `now` [s].

        It is sent every 50 ms (NEUTRAL_S) while zero thrust is commanded, once a first command was sent. Without it a
        vehicle does not arm, or detects a lost link.
        """
        neutral = math.isfinite(self._overridden) and not any(self._held.values())
        return neutral and now - self._overridden >= NEUTRAL_S

    def _poll_command(self, now: float) -> bytes:
        """Return the frame of the first command in the queue, if it is due at wall time `now` [s]; else no bytes.

        It is due every 0.4 s (ANSWER_S) until it is answered. A command that was sent 4 times (TRIES) without an answer
        is removed, and "no answer" is stored as its answer. A message rate then counts as refused.
        """
        while self._commands:
            command = self._commands[0]
            if now - command.sent < ANSWER_S:
                return b""
            if command.tries >= TRIES:
                self._commands.popleft()
                if command.number == SET_INTERVAL:
                    self._handle_refused_rate(command, "no answer")
                else:
                    self._store_answer(command.label, "no answer")
                continue
            command.sent, command.tries = now, command.tries + 1
            return self._encode_command(command)
        return b""

    def _encode_command(self, command: _Command) -> bytes:
        """Encode a command to the autopilot as the bytes of one MAVLink frame (COMMAND_LONG).

        It is addressed to system and component id of the rig. Its field `confirmation` is the number of earlier tries.
        Nothing is stored.
        """
        address = (self._settings.system_id, self._settings.component_id)
        return self._codec.encode("COMMAND_LONG", *address, command.number, command.tries - 1, *command.parameters)

    def _poll_parameters(self, now: float) -> bytes:
        """Return requests for all parameters that the autopilot has not yet sent, if requests are due.

        They are due every 0.5 s (PARAMETER_S); `now` is wall time [s]. A parameter that stays unanswered is given up
        after 10 requests, with an event; after 5 if the autopilot may be a version that lacks it. If no parameter is
        missing, one known parameter is requested again in the role DRIVE, to notice a change.
        """
        if not self._awaited:
            if self._status.parameters_pending:
                self._status = replace(self._status, parameters_pending=False)
            return self._poll_one_parameter(now)
        if now - self._asked < PARAMETER_S:
            return b""
        self._asked = now
        # An autopilot sends no answer for a parameter that it lacks; the names differ between versions.
        if unanswered := [name for name, left in self._awaited.items() if not left]:
            self._events.append(Event("parameter", f"not answered: {', '.join(unanswered)}"))
        self._awaited = {name: left - 1 for name, left in self._awaited.items() if left}
        address = (self._settings.system_id, self._settings.component_id)
        return b"".join(self._codec.encode("PARAM_REQUEST_READ", *address, name.encode(), -1) for name in self._awaited)

    def _poll_one_parameter(self, now: float) -> bytes:
        """Return the request to read one known parameter of the autopilot again, to notice a change; or no bytes.

        One request is due every 0.2 s (REREAD_S), and only in the role DRIVE. Every second one is for a parameter of
        the reaction to a lost link. Another ground station may change a parameter, and the message about the change may
        be lost. `now` is wall time [s].
        """
        if self._role is not LinkRole.DRIVE or now - self._reread_at < REREAD_S:
            return b""
        # Every second request is for a parameter that determines the reaction to a lost link.
        urgent = [name for name in LINK_LOSS_PARAMETERS if name in self._status.parameters]
        others = [name for name in self._names if name in self._status.parameters and name not in urgent]
        turn, self._reread_turn, self._reread_at = self._reread_turn, self._reread_turn + 1, now
        names = (urgent if turn % 2 == 0 else others) or urgent or others
        if not names:
            return b""
        address = (self._settings.system_id, self._settings.component_id)
        return self._codec.encode("PARAM_REQUEST_READ", *address, names[turn // 2 % len(names)].encode(), -1)

    def wait(self, now: float) -> float:
        """Return the wall time [s] from `now` until `poll` may have frames to send to the autopilot; at least 0.

        It is 0 if a request of the operator waits, and otherwise infinite in the role LISTEN. While sending is muted,
        it is the rest of this time.
        """
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
        """Encode the commands of all thrusters behind the autopilot as one frame (RC_CHANNELS_OVERRIDE).

        `dues` are the set-points to send now. `held` are the present commands, -1..1, by servo output; an output
        without a command gets neutral. The list has one pair of frame and `dues`; it is empty if nothing is due or
        sending is muted. `now` is wall time [s].
        """
        self._held = dict(held)
        return [(self._encode_override(now), list(dues))] if dues and not self._is_muted(now) else []

    def zero(self, now: float) -> list[tuple[bytes, list[Due]]]:
        """Encode neutral for all thrusters behind the autopilot, and the command to disarm it, for an emergency stop.

        The result is one pair: the bytes of both frames, and an empty list of set-points. `now` is wall time [s].
        """
        self._held = {}
        data = self._encode_override(now) + self._encode_command(_Command(ARM, (0.0,) * 7, "disarm", tries=1))
        return [(data, [])]

    def _encode_override(self, now: float) -> bytes:
        """Encode the present commands of all thrusters behind the autopilot as one frame RC_CHANNELS_OVERRIDE.

        A thruster without a command gets neutral. The command of a reversed thruster changes its sign. Channels of the
        transmitter that drive no thruster are left as they are. `now` is stored as the wall time [s] of sending.
        """
        self._overridden = now
        channels = [IGNORED_LOW] * 8 + [IGNORED_HIGH] * 10
        for node, (output, is_reversed) in self._outputs.items():
            n = self._held.get(node, 0.0)
            channels[output.rc_channel - 1] = output.command(-n if is_reversed else n)
        address = (self._settings.system_id, self._settings.component_id)
        return self._codec.encode("RC_CHANNELS_OVERRIDE", *address, *channels)

    @property
    def hint(self) -> str:
        """Advice about message rates, in one line, if nothing is sent to the autopilot (role LISTEN); else empty."""
        if self._role is not LinkRole.LISTEN:
            return ""
        return (
            "seatrial sends it nothing, so it chooses its message rates; --request-rates requests the rates in the rig"
        )

    def shutdown_bytes(self, now: float) -> bytes:
        """Encode the command to disarm the autopilot, if this program has armed it; else return no bytes.

        The frame is contained twice, because no answer is awaited and one frame may be lost. `now` is not used.
        """
        if not self._armed_by_us:
            return b""
        command = _Command(ARM, (0.0,) * 7, "disarm", tries=1)
        return self._encode_command(command) * 2

    @property
    def confirmation(self) -> str:
        """End of the sentence "zero thrust was sent ...": whether the autopilot has confirmed that it is disarmed.

        It begins with a comma. A confirmation counts only in the role RESCUE (watchdog).
        """
        return DISARMED if self._disarmed else ", and not answered: it may still be armed"

    def message(self) -> str:
        """Return the fault in the ids or signing of the received frames, in one line for the user; empty without one.

        The faults: all frames are of systems other than `system_id` of the rig; the autopilot signs its frames and the
        rig has no key; its frames are not signed with the key of the rig. The second fault is not reported in the role
        LISTEN, in which nothing is sent.
        """
        decoder = self._decoder
        if sum(decoder.foreign.values()) >= FOREIGN_FRAMES and not (decoder.accepted or decoder.unsigned):
            return self._wrong_system_id()
        if self._role is not LinkRole.LISTEN and decoder.signed and not self._codec.signs:
            return "the autopilot signs its frames and will ignore ours: the rig has no key_file for it; add this key"
        if self._codec.signs and not decoder.accepted and decoder.unsigned >= UNSIGNED_FRAMES:
            how = "are not signed; take key_file out of the rig, or switch signing on in the autopilot"
            if decoder.signed:
                how = "are signed with another key than key_file in the rig; give the key of the autopilot"
            return f"{decoder.unsigned} frames of the autopilot were ignored: they {how}"
        return ""

    def _wrong_system_id(self) -> str:
        """Return the fault that all frames are of other systems: the ids of these, and the `system_id` to set.

        Ids of ground stations are listed and not proposed.
        """
        own, heard = self._settings.system_id, self._decoder.foreign
        vehicles = [str(system) for system in sorted(heard) if system < LOWEST_STATION_ID]
        advice = f"write system_id = {' or '.join(vehicles)} for this device in the rig, if this is the autopilot"
        if not vehicles:
            advice = "these are ids of ground stations: check that the autopilot sends on this link"
        ids = ", ".join(map(str, sorted(heard)))
        return f"no message of system {own} (system_id in the rig), but {sum(heard.values())} of system {ids}; {advice}"

    def events(self) -> list[Event]:
        """Return the events of the link since the last call, and forget them.

        The number of lost frames becomes an event at most once in 10 s (LOST_S).
        """
        lost = self._decoder.lost
        if lost > self._reported_lost and self._last_heartbeat - self._lost_at >= LOST_S:
            self._reported_lost, self._lost_at = lost, self._last_heartbeat
            text = f"{lost} of {lost + self._decoder.frames} frames of the autopilot were lost"
            self._events.append(Event("autopilot", text))
        out, self._events = self._events, []
        return out

    def link_at(self, now: float) -> LinkStatus:
        """Return the last reported state of the autopilot, with the age of its heartbeat at wall time `now` [s].

        The age is infinite before the first heartbeat since the port was opened or the autopilot restarted.
        """
        other_station_frames = self._decoder.foreign.get(self._settings.own_system_id, 0)
        age = now - self._last_heartbeat
        return replace(self._status, age=age, other_station_frames=other_station_frames, lost=self._decoder.lost)


def _rate_request(message: str, rate: float) -> _Command:
    """Return the command that requests a MAVLink message at a rate [Hz] (MAV_CMD_SET_MESSAGE_INTERVAL).

    `message` is the name of the message, such as "ATTITUDE". The rate must be above zero; the command contains the
    interval [us].
    """
    number = ESC_STATUS if message == "ESC_STATUS" else int(getattr(dialect(), f"MAVLINK_MSG_ID_{message}"))
    return _Command(SET_INTERVAL, (float(number), 1e6 / rate, 0, 0, 0, 0, 0), message, rate)
