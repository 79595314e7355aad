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
    """Emulator of one autopilot.

    `encode` must be called with an attitude at the rate of the autopilot's loop, LOOP_HZ. `receive` must be called
    with the bytes of the host.
    """

    def __init__(
        self, rig: Rig, device: Device, controllers: Mapping[int, EscController], now_unix: float = EPOCH_2015
    ) -> None:
        """Set up an autopilot.

        Parameters
        ----------
        rig : Rig
            Rig with the thrusters of the autopilot.
        device : Device
            The autopilot.
        controllers : mapping of int to EscController
            Speed controllers by servo output.
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
        self._decoder.listener = self._handle
        self._rates: dict[str, float] = dict(ALWAYS)
        self._sent: dict[str, int] = {}  # number of the interval in which each message was sent last
        self._queue: deque[bytes] = deque()
        self._texts: deque[tuple[int, bytes, int, int]] = deque()  # each loop sends one text, behind the answers
        self._t, self._text_id = 0.0, 0
        self._reports = Reports(self.vehicle, self._codec, self._thrusters, controllers)

    # Messages to the host.

    def encode(self, sample: Sample, t: float) -> bytes:
        """Return the messages that are due at ``t`` [s].

        An AHRS sample runs the loop of the autopilot. Other samples are stored for later messages.
        """
        self._t = self._reports.t = t
        self._reports.clock_error = self.clock_error
        if isinstance(sample, Esc | Gnss):
            self._reports.take(sample)
        elif isinstance(sample, Ahrs):
            self._check_failsafes()
            sent = [self._reports.encode_message(name, sample) for name in list(self._rates) if self._is_due(name)]
            if self._texts:
                sent.append(self._codec.encode("STATUSTEXT", *self._texts.popleft()))
            return b"".join(sent) + self._flush()
        return self._flush()

    def _is_due(self, name: str) -> bool:
        """Return whether a message is due, which is once in each of its intervals.

        The intervals are counted from boot, so messages of one rate are sent together, as by ArduPilot.
        """
        count = math.floor((self._t + BOOT_S) * self._rates[name] + 1e-6)
        previous, self._sent[name] = self._sent.get(name, -1), count
        return count != previous

    def _flush(self) -> bytes:
        """Return the queued answers and clear the queue."""
        out = b"".join(self._queue)
        self._queue.clear()
        return out

    def _text(self, severity: int, text: str) -> None:
        """Queue a text for the host as STATUSTEXT messages. Texts of several messages have a common number."""
        data = text.encode()
        self._text_id = self._text_id % 0xFFFF + (len(data) > CHUNK)
        number = self._text_id if len(data) > CHUNK else 0
        for k in range(0, len(data), CHUNK):
            part = data[k : k + CHUNK]
            self._texts.append((severity, part, number, k // CHUNK))

    # Actions of the autopilot.

    def _check_failsafes(self) -> None:
        """End RC overrides that have timed out, and start failsafes, like Rover 4.7."""
        own, p = self.vehicle, self.vehicle.parameters
        silence = (self._t - own.overridden) / self._speed
        # After the time-out of an override the channels of the receiver apply. Without a receiver the override stays
        # until the throttle failsafe acts.
        lasts = p["RC_OVERRIDE_TIME"] if own.receiver else RADIO_S if p["FS_THR_ENABLE"] else math.inf
        if own.armed and own.mode == MANUAL:
            for node, controller in self._controllers.items():
                n = own.sticks.get(node, 0.0)
                if n and silence > lasts >= 0.0:
                    controller.command(self._t, 0.0)
                elif n:
                    controller.command(self._t, n)  # the servo output repeats its pulse
        self._drive()
        # The failsafe needs a first heartbeat: before it, the time since the last heartbeat is infinite.
        ground_silence = (self._t - own.ground_heard) / self._speed
        watched = own.armed and p["FS_GCS_ENABLE"] and p["FS_ACTION"] and math.isfinite(ground_silence)
        if watched and own.mode == MANUAL and ground_silence > p["FS_GCS_TIMEOUT"] + p["FS_TIMEOUT"]:
            self._text(CRITICAL, "GCS Failsafe")
            if p["FS_ACTION"] == TERMINATE:
                self.disarm()
            else:
                self._set_mode(RTL if p["FS_ACTION"] == 1.0 else HOLD)

    def disarm(self, text: str = "Throttle disarmed") -> None:
        """Disarm and stop the thrusters. ``text`` is sent to the host if the autopilot was armed."""
        if self.vehicle.armed:
            self.vehicle.armed = False
            self._text(INFO, text)
        self._stop()

    def _set_mode(self, mode: int) -> None:
        """Change the mode. All modes except MANUAL stop the thrusters first."""
        self.vehicle.mode = mode
        if mode != MANUAL:
            self._stop()
        self._drive()

    def _drive(self) -> None:
        """Drive in the modes AUTO and RTL, in which RC overrides have no effect."""
        if self.vehicle.armed and self.vehicle.mode in (AUTO, RTL):
            for controller in self._controllers.values():
                controller.command(self._t, OWN_N)

    def _stop(self) -> None:
        """Command zero to all thrusters."""
        for controller in self._controllers.values():
            controller.command(self._t, 0.0)

    # Messages of the host.

    def receive(self, data: bytes, t: float) -> bytes:
        """Process messages of the host and return the answers."""
        self._t = self._reports.t = t
        self._decoder.feed(data, t)
        return self._flush()

    def _handle(self, m: Any) -> None:
        """Process one message. Heartbeats and overrides of other ground stations are ignored."""
        name = m.get_type()
        if name in ("HEARTBEAT", "RC_CHANNELS_OVERRIDE") and m.get_srcSystem() != self._ground:
            return
        if name == "HEARTBEAT":
            self.vehicle.ground_heard = self._t
        elif name == "TIMESYNC" and not m.tc1:
            self._queue.append(self._codec.encode("TIMESYNC", round((self._t + BOOT_S) * 1e9), m.ts1))
        elif getattr(m, "target_system", self._address[0]) != self._address[0]:
            return
        elif name == "RC_CHANNELS_OVERRIDE":
            self._override(m)
        elif name == "COMMAND_LONG":
            result = self._command(m)
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
        """Queue the PARAM_VALUE message of a parameter."""
        names = list(self.vehicle.parameters)
        value = self.vehicle.parameters[name]
        self._queue.append(self._codec.encode("PARAM_VALUE", name.encode(), value, 9, len(names), names.index(name)))

    def _override(self, m: Any) -> None:
        """Apply an RC override to the sticks, and to the thrusters if the autopilot is armed and in MANUAL."""
        own = self.vehicle
        if own.parameters.get("MAV_GCS_SYSID") != self._ground or int(own.parameters["RC_OPTIONS"]) & IGNORES_OVERRIDES:
            return
        own.overridden = self._t
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
                self._controllers[node].command(self._t, self.vehicle.sticks[node])

    def _command(self, m: Any) -> int:
        """Execute a COMMAND_LONG and return its MAV_RESULT."""
        if m.command == 511:  # SET_MESSAGE_INTERVAL
            return self._interval(int(m.param1), m.param2)
        if m.command == 176:  # DO_SET_MODE
            if mode_name(int(m.param2)).startswith("mode "):
                return FAILED
            self._set_mode(int(m.param2))
            return ACCEPTED
        if m.command == 400:  # COMPONENT_ARM_DISARM
            return self._arm() if m.param1 == 1.0 else self._disarm()
        if m.command == 183:  # DO_SET_SERVO, which is denied for the outputs of motors
            return DENIED
        return UNSUPPORTED

    def _interval(self, number: int, interval_us: float) -> int:
        """Set the interval [us] of a message and return the MAV_RESULT. An interval of 0 or less stops the message."""
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

    def _disarm(self) -> int:
        """Disarm and return the MAV_RESULT."""
        self.disarm()
        return ACCEPTED

    def _arm(self) -> int:
        """Arm if all conditions are met and return the MAV_RESULT. Send the reason of a refusal as a text."""
        if self.vehicle.armed:
            return ACCEPTED
        refusal = self._refusal()
        if refusal:
            self._text(CRITICAL, refusal)  # sent after the answer
            return FAILED
        self.vehicle.armed = True
        self._text(INFO, "Throttle armed")
        return ACCEPTED

    def _refusal(self) -> str:
        """Return the reason why the autopilot does not arm; empty if it can arm."""
        if self._reports.ekf != EKF_READY:
            return "PreArm: AHRS: EKF3 is still initialising, wait for it or reboot"
        if self.vehicle.mode not in (MANUAL, HOLD):
            return "Arm: Mode not armable"
        if any(abs(n) > NEUTRAL_N for n in self.vehicle.sticks.values()):
            return "Arm: Throttle (RC3) is not neutral"
        return ""
