"""Emulator of a boat's autopilot on a MAVLink link. It behaves towards a ground station like ArduPilot Rover 4.7.

The autopilot obeys one ground station. It arms on command only, under the conditions of a real autopilot. It follows
RC overrides while it is armed and in the mode MANUAL, and it stops the thrusters if the overrides end. The emulator
uses no ports.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any, final

from seatrial.daq.protocol import EPOCH_2015, Codec, SampleConverter, mavlink, mode_name, read_key
from seatrial.daq.rig import Device, Rig
from seatrial.daq.samples import Ahrs, Esc, Gnss
from seatrial.mocks.devices.autopilot_messages import (
    BOOT_S,
    EKF_READY,
    LOOP_HZ,
    MANUAL,
    UNUSED,
    Reports,
    Vehicle,
    parameters,
)
from seatrial.mocks.devices.base import DeviceEmulator
from seatrial.mocks.world import EscController, Sample

INTERVAL_PART = 0.8  # share of the loop's rate; requests for faster messages are denied
HOLD, AUTO, RTL = 4, 10, 11  # modes of ArduPilot Rover
OWN_N = 0.4  # command of both thrusters in the modes AUTO and RTL
RADIO_S = 0.5  # s without a frame of the receiver or an override, after which the throttle failsafe acts
TERMINATE = 5.0  # value of FS_ACTION
RELEASED = 8  # last channel that an override of 0 returns to the receiver; for higher channels 0 has no meaning
IGNORES_OVERRIDES = 2  # bit of RC_OPTIONS
CHUNK = 50  # bytes, largest text of one STATUSTEXT
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4  # MAV_RESULT
INFO, CRITICAL = 6, 2  # MAV_SEVERITY
ALWAYS = {"HEARTBEAT": 1.0}  # Hz, messages that are sent without a request
NEUTRAL_N = 0.02  # a stick that is further from neutral forbids arming


@final
class AutopilotEmulator(DeviceEmulator):
    """Emulator of one autopilot on a MAVLink link. It drives the thrusters of a simulated boat as commanded by a host.

    `encode` must be called with an attitude at the rate of the autopilot's loop, LOOP_HZ (50 Hz). `receive` must be
    called with the bytes of the host. The attribute `vehicle` is the state of the autopilot.
    """

    def __init__(
        self, rig: Rig, device: Device, controllers: Mapping[int, EscController], now_unix: float = EPOCH_2015
    ) -> None:
        """Set up an emulated autopilot.

        Its parameter RC_OVERRIDE_TIME [wall s] is the shortest time-out of its thrusters in the rig (1 run second
        without a thruster).

        Parameters
        ----------
        rig : Rig
            Rig with the thrusters of the autopilot.
        device : Device
            The autopilot. It must have MAVLink settings (``device.mavlink``).
        controllers : mapping of int to EscController
            Speed controllers, by servo output. The autopilot commands these objects.
        now_unix : float
            Present time [s since 1970] for the signatures of the messages.

        Raises
        ------
        SeatrialError
            If the file of the signing key cannot be read.
        """
        assert device.mavlink is not None
        settings = device.mavlink
        self._thrusters = {t.node: t for t in rig.thrusters if t.device == device.name}
        self._controllers, self._speed, self._ground = controllers, rig.speed, settings.own_system_id
        timeout = min((t.timeout_s for t in self._thrusters.values()), default=1.0)
        own = parameters(list(self._thrusters.values()), settings.own_system_id, timeout / rig.speed)
        self.vehicle = Vehicle(own)
        key = None if settings.key_file is None else read_key(settings.key_file)
        self._address = (settings.system_id, settings.component_id)
        self._codec = Codec(*self._address, key, now_unix)
        self._decoder = mavlink.MavlinkDecoder(SampleConverter({}), mavlink.ANY, settings.own_component_id, self._codec)
        self._decoder.listener = self._handle_message
        self._rates: dict[str, float] = dict(ALWAYS)
        self._sent: dict[str, int] = {}  # number of the interval in which each message was sent last
        self._queue: deque[bytes] = deque()
        self._texts: deque[tuple[int, bytes, int, int]] = deque()  # each loop sends one text, behind the answers
        self._now, self._text_id = 0.0, 0
        self._reports = Reports(self.vehicle, self._codec, self._thrusters, controllers)

    # Messages to the host.

    def encode(self, sample: Sample, t: float) -> bytes:
        """Take a sample of a simulated sensor at run time ``t`` [s]; return the bytes that the autopilot then sends.

        An AHRS sample runs the loop of the autopilot once: failsafes are checked, and the messages that are due and at
        most one text are returned. Telemetry and GNSS samples are stored for later messages. For any sample, queued
        answers to the host come last.
        """
        self._now = self._reports.t = t
        self._reports.clock_error = self.clock_error
        if isinstance(sample, Esc | Gnss):
            self._reports.take(sample)
        elif isinstance(sample, Ahrs):
            self._check_failsafes()
            sent = [self._reports.encode_message(name, sample) for name in list(self._rates) if self._is_due(name)]
            if self._texts:
                sent.append(self._codec.encode("STATUSTEXT", *self._texts.popleft()))
            return b"".join(sent) + self._take_answers()
        return self._take_answers()

    def _is_due(self, name: str) -> bool:
        """Return whether the MAVLink message ``name`` must be sent now. If so, the caller sends it.

        A message is due at the first call in each interval of its rate. The intervals are counted from boot, so that
        messages of one rate are sent together, as by ArduPilot. Each call marks the present interval as served.
        """
        count = math.floor((self._now + BOOT_S) * self._rates[name] + 1e-6)
        previous, self._sent[name] = self._sent.get(name, -1), count
        return count != previous

    def _take_answers(self) -> bytes:
        """Return the queued answers to the host as bytes, and clear the queue."""
        out = b"".join(self._queue)
        self._queue.clear()
        return out

    def _queue_text(self, severity: int, text: str) -> None:
        """Queue a text for the host as STATUSTEXT messages of at most 50 bytes each.

        ``severity`` is a MAV_SEVERITY. The messages of a longer text have a common number.
        """
        data = text.encode()
        self._text_id = self._text_id % 0xFFFF + (len(data) > CHUNK)
        number = self._text_id if len(data) > CHUNK else 0
        for k in range(0, len(data), CHUNK):
            chunk = data[k : k + CHUNK]
            self._texts.append((severity, chunk, number, k // CHUNK))

    # Actions of the autopilot.

    def _check_failsafes(self) -> None:
        """Act on missing messages of the ground station, like ArduPilot Rover 4.7. It is called in each loop.

        While the autopilot is armed and in MANUAL, each thruster gets the command of the last RC override again. If
        this override is older than RC_OVERRIDE_TIME, the thruster gets zero instead. Without an RC receiver the time is
        RADIO_S if FS_THR_ENABLE is set; otherwise the command stays. A negative RC_OVERRIDE_TIME never ends. A command
        of zero is not repeated.

        In AUTO and RTL an armed autopilot drives by itself. If it is armed and in MANUAL, and the heartbeats, after a
        first one, are missing for longer than FS_GCS_TIMEOUT plus FS_TIMEOUT, the autopilot obeys FS_ACTION: 5 disarms
        it, 1 changes its mode to RTL, and any other value to HOLD. With FS_GCS_ENABLE or FS_ACTION 0 it does nothing.
        These times are wall seconds.
        """
        own, p = self.vehicle, self.vehicle.parameters
        silence = (self._now - own.overridden) / self._speed
        # After the time-out of an override the channels of the receiver apply. Without a receiver the override stays
        # until the throttle failsafe acts.
        lasts = p["RC_OVERRIDE_TIME"] if own.receiver else RADIO_S if p["FS_THR_ENABLE"] else math.inf
        if own.armed and own.mode == MANUAL:
            for node, controller in self._controllers.items():
                n = own.sticks.get(node, 0.0)
                if n and silence > lasts >= 0.0:
                    controller.command(self._now, 0.0)
                elif n:
                    controller.command(self._now, n)  # the servo output repeats its pulse
        self._drive_by_itself()
        # The failsafe needs a first heartbeat: before it, the time since the last heartbeat is infinite.
        ground_silence = (self._now - own.ground_heard) / self._speed
        watched = own.armed and p["FS_GCS_ENABLE"] and p["FS_ACTION"] and math.isfinite(ground_silence)
        if watched and own.mode == MANUAL and ground_silence > p["FS_GCS_TIMEOUT"] + p["FS_TIMEOUT"]:
            self._queue_text(CRITICAL, "GCS Failsafe")
            if p["FS_ACTION"] == TERMINATE:
                self.disarm()
            else:
                self._set_mode(RTL if p["FS_ACTION"] == 1.0 else HOLD)

    def disarm(self, text: str = "Throttle disarmed") -> None:
        """Disarm the autopilot, and stop its thrusters in any case.

        If it was armed, ``text`` is queued as a message to the host.
        """
        if self.vehicle.armed:
            self.vehicle.armed = False
            self._queue_text(INFO, text)
        self._stop_thrusters()

    def _set_mode(self, mode: int) -> None:
        """Change the mode of the autopilot to ``mode``, a number of ArduPilot Rover, which is not checked here.

        In all modes except MANUAL the thrusters are stopped first. In AUTO and RTL an armed autopilot then drives by
        itself.
        """
        self.vehicle.mode = mode
        if mode != MANUAL:
            self._stop_thrusters()
        self._drive_by_itself()

    def _drive_by_itself(self) -> None:
        """Command 0.4 (OWN_N) to all thrusters if the autopilot is armed and in mode AUTO or RTL; else do nothing."""
        if self.vehicle.armed and self.vehicle.mode in (AUTO, RTL):
            for controller in self._controllers.values():
                controller.command(self._now, OWN_N)

    def _stop_thrusters(self) -> None:
        """Command zero to the speed controllers of all thrusters of the autopilot."""
        for controller in self._controllers.values():
            controller.command(self._now, 0.0)

    # Messages of the host.

    def receive(self, data: bytes, t: float) -> bytes:
        """Process bytes of the host that arrive at run time ``t`` [s], and return the bytes of the answers.

        If the bytes end within a MAVLink message, its beginning is kept for the next call.
        """
        self._now = self._reports.t = t
        self._decoder.feed(data, t)
        return self._take_answers()

    def _handle_message(self, m: Any) -> None:
        """Process one decoded MAVLink message ``m``: act on it, and queue the answer.

        The messages are HEARTBEAT, TIMESYNC, RC_CHANNELS_OVERRIDE, COMMAND_LONG, PARAM_REQUEST_READ, PARAM_REQUEST_LIST
        and PARAM_SET. Heartbeats and overrides of other ground stations, answers to TIMESYNC (``tc1`` not 0), messages
        for other systems or for all systems (target 0), unknown parameters and other messages are ignored. A heartbeat
        and an override have no answer.
        """
        name = m.get_type()
        if name in ("HEARTBEAT", "RC_CHANNELS_OVERRIDE") and m.get_srcSystem() != self._ground:
            return
        if name == "HEARTBEAT":
            self.vehicle.ground_heard = self._now
        elif name == "TIMESYNC" and not m.tc1:
            self._queue.append(self._codec.encode("TIMESYNC", round((self._now + BOOT_S) * 1e9), m.ts1))
        elif getattr(m, "target_system", self._address[0]) != self._address[0]:
            return
        elif name == "RC_CHANNELS_OVERRIDE":
            self._apply_override(m)
        elif name == "COMMAND_LONG":
            result = self._execute_command(m)
            self._queue.append(self._codec.encode("COMMAND_ACK", m.command, result))
        elif name == "PARAM_REQUEST_READ" and m.param_id in self.vehicle.parameters:
            self._send_parameter(m.param_id)
        elif name == "PARAM_REQUEST_LIST":
            for parameter in self.vehicle.parameters:
                self._send_parameter(parameter)
        elif name == "PARAM_SET" and m.param_id in self.vehicle.parameters:
            self.vehicle.parameters[m.param_id] = m.param_value
            self._send_parameter(m.param_id)

    def _send_parameter(self, name: str) -> None:
        """Queue the PARAM_VALUE message of the parameter ``name``, which must exist."""
        names = list(self.vehicle.parameters)
        value = self.vehicle.parameters[name]
        self._queue.append(self._codec.encode("PARAM_VALUE", name.encode(), value, 9, len(names), names.index(name)))

    def _apply_override(self, m: Any) -> None:
        """Apply the decoded message RC_CHANNELS_OVERRIDE: store its pulses as commands of the thrusters' RC channels.

        The command is linear in the pulse on each side of neutral, with the widths in the rig, and is limited to -1 to
        1. If the autopilot is armed and in MANUAL, the thrusters get it at once. The message is ignored if the
        parameter MAV_GCS_SYSID is not the id of the ground station, or if RC_OPTIONS forbids overrides. A pulse of
        65535 changes no command. A pulse of 0 gives the channel back to the receiver, which is neutral; without a
        receiver, and for channels above 8, it changes no command. A message that is not ignored restarts the time-out
        of the overrides, even if it changes no command.
        """
        own = self.vehicle
        if own.parameters.get("MAV_GCS_SYSID") != self._ground or int(own.parameters["RC_OPTIONS"]) & IGNORES_OVERRIDES:
            return
        own.overridden = self._now
        for node, thruster in self._thrusters.items():
            assert thruster.output is not None
            channel = thruster.output.rc_channel
            pulse = getattr(m, f"chan{channel}_raw")
            # A pulse of 0 returns the channels 1 to 8 to the receiver, whose sticks are neutral. Without a receiver the
            # last value stays.
            if pulse == UNUSED or (pulse == 0 and not (channel <= RELEASED and own.receiver)):
                continue
            low, neutral, high = thruster.output.rc_us
            pulse = pulse or neutral
            n = (pulse - neutral) / (high - neutral if pulse > neutral else neutral - low)
            self.vehicle.sticks[node] = max(-1.0, min(1.0, n))
            if self.vehicle.armed and self.vehicle.mode == MANUAL and node in self._controllers:
                self._controllers[node].command(self._now, self.vehicle.sticks[node])

    def _execute_command(self, m: Any) -> int:
        """Execute the decoded message COMMAND_LONG, and return the result code (MAV_RESULT) for the host.

        The commands are to set a message interval, to set the mode (FAILED for an unknown mode), and to arm (parameter
        1 is 1) or disarm (any other value). A command to set a servo is denied. Other commands give UNSUPPORTED.
        """
        if m.command == 511:  # SET_MESSAGE_INTERVAL
            return self._set_message_interval(int(m.param1), m.param2)
        if m.command == 176:  # DO_SET_MODE
            if mode_name(int(m.param2)).startswith("mode "):
                return FAILED
            self._set_mode(int(m.param2))
            return ACCEPTED
        if m.command == 400:  # COMPONENT_ARM_DISARM
            return self._arm_by_command() if m.param1 == 1.0 else self._disarm_by_command()
        if m.command == 183:  # DO_SET_SERVO, which is denied for the outputs of motors
            return DENIED
        return UNSUPPORTED

    def _set_message_interval(self, number: int, interval_us: float) -> int:
        """Set the time between two messages with the MAVLink ``number`` [us], and return the result code (MAV_RESULT).

        An interval of 0 or less stops the message. Unknown messages and HEARTBEAT give FAILED. A rate above 80 % of the
        loop's 50 Hz gives DENIED, and nothing is changed. Otherwise the result is ACCEPTED.
        """
        name = mavlink.message_name(number)
        if not name or name in ALWAYS:
            return FAILED
        rate = 0.0 if interval_us <= 0.0 else 1e6 / interval_us
        if rate > INTERVAL_PART * LOOP_HZ:
            return DENIED
        self._rates.pop(name, None)
        if rate:
            self._rates[name] = rate
        return ACCEPTED

    def _disarm_by_command(self) -> int:
        """Disarm the autopilot, stop its thrusters, and return the result code (MAV_RESULT), always ACCEPTED."""
        self.disarm()
        return ACCEPTED

    def _arm_by_command(self) -> int:
        """Arm the autopilot if all conditions are met, and return the result code (MAV_RESULT).

        It is ACCEPTED, also if the autopilot is armed already. If a condition is not met, it is FAILED, and the reason
        is queued as a text for the host.
        """
        if self.vehicle.armed:
            return ACCEPTED
        refusal = self._arming_refusal()
        if refusal:
            self._queue_text(CRITICAL, refusal)  # sent after the answer
            return FAILED
        self.vehicle.armed = True
        self._queue_text(INFO, "Throttle armed")
        return ACCEPTED

    def _arming_refusal(self) -> str:
        """Return the reason why the autopilot refuses to arm, as a text of ArduPilot; empty if it can arm.

        The position estimator must be ready, the mode must be MANUAL or HOLD, and the commands of the last RC override
        must be neutral (within 0.02). The text is about the first of these conditions that is not met.
        """
        if self._reports.ekf != EKF_READY:
            return "PreArm: AHRS: EKF3 is still initialising, wait for it or reboot"
        if self.vehicle.mode not in (MANUAL, HOLD):
            return "Arm: Mode not armable"
        if any(abs(n) > NEUTRAL_N for n in self.vehicle.sticks.values()):
            return "Arm: Throttle (RC3) is not neutral"
        return ""
