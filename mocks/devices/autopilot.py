"""A boat's autopilot on a MAVLink link, as ArduPilot Rover 4.7 behaves towards a ground station. Sans I/O.

It obeys one ground station, arms only on its command and refuses where a real one does, follows RC overrides while it
is armed and in MANUAL, and takes silence for the end of thrust. Its command and its output are two things.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from typing import Any, final

from seatrial.daq.protocol import EPOCH_2015, Codec, Samples, mavlink, mode_name, read_key
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

INTERVAL_PART = 0.8  # of the loop's rate: a faster message is denied
HOLD, AUTO, RTL = 4, 10, 11
OWN_N = 0.4  # of both thrusters where it drives by itself
RADIO_S = 0.5  # without a receiver's frame or an override: a failsafe of the throttle
TERMINATE = 5.0  # FS_ACTION
RELEASED = 8  # the last channel that an override of 0 releases; behind it 0 is no value
IGNORES_OVERRIDES = 2  # of RC_OPTIONS
CHUNK = 50  # bytes of a STATUSTEXT
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
INFO, CRITICAL = 6, 2
ALWAYS = {"HEARTBEAT": 1.0}  # Hz, asked for or not
NEUTRAL_N = 0.02  # a stick further out forbids arming


@final
class AutopilotEmulator(DeviceEmulator):
    """One autopilot: `encode` is called at its loop rate with the attitude, `receive` with what the host sends."""

    def __init__(
        self, rig: Rig, device: Device, controllers: Mapping[int, EscController], now_unix: float = EPOCH_2015
    ) -> None:
        """`controllers` by output; `now_unix` for signatures. Raises SeatrialError for a key that cannot be read."""
        assert device.mavlink is not None
        settings = device.mavlink
        self._thrusters = {t.node: t for t in rig.thrusters if t.device == device.name}
        self._controllers, self._speed, self._ground = controllers, rig.speed, settings.own_system_id
        timeout = min((t.timeout_s for t in self._thrusters.values()), default=1.0)
        own = parameters(list(self._thrusters.values()), settings.own_system_id, timeout / rig.speed)
        self.vehicle = Vehicle(own)
        key = None if settings.key_file is None else read_key(settings.key_file)
        self._who = (settings.system_id, settings.component_id)
        self._codec = Codec(*self._who, key, now_unix)
        self._decoder = mavlink.MavlinkDecoder(Samples({}), mavlink.ANY, settings.own_component_id, self._codec)
        self._decoder.listener = self._hear
        self._rates: dict[str, float] = dict(ALWAYS)
        self._sent: dict[str, int] = {}  # the interval in which a message was sent last
        self._queue: deque[bytes] = deque()
        self._texts: deque[tuple[int, bytes, int, int]] = deque()  # one leaves with each loop, behind its answer
        self._t, self._text_id = 0.0, 0
        self._reports = Reports(self.vehicle, self._codec, self._thrusters, controllers)

    # What it sends.

    def encode(self, sample: Sample, t: float) -> bytes:
        """The messages that are due; an attitude is the tick of the loop."""
        self._t = self._reports.t = t
        self._reports.clock_error = self.clock_error
        if isinstance(sample, Esc | Gnss):
            self._reports.take(sample)
        elif isinstance(sample, Ahrs):
            self._judge()
            sent = [self._reports.say(name, sample) for name in list(self._rates) if self._is_due(name)]
            if self._texts:
                sent.append(self._codec.encode("STATUSTEXT", *self._texts.popleft()))
            return b"".join(sent) + self._flush()
        return self._flush()

    def _is_due(self, name: str) -> bool:
        """Once in each interval, counted from boot: messages of one rate leave together, as ArduPilot's do."""
        count = math.floor((self._t + BOOT_S) * self._rates[name] + 1e-6)
        before, self._sent[name] = self._sent.get(name, -1), count
        return count != before

    def _flush(self) -> bytes:
        out = b"".join(self._queue)
        self._queue.clear()
        return out

    def _text(self, severity: int, text: str) -> None:
        data = text.encode()
        self._text_id = self._text_id % 0xFFFF + (len(data) > CHUNK)
        number = self._text_id if len(data) > CHUNK else 0
        for k in range(0, len(data), CHUNK):
            part = data[k : k + CHUNK]
            self._texts.append((severity, part, number, k // CHUNK))

    # What it does.

    def _judge(self) -> None:
        """Overrides that have timed out, and failsafes, as Rover 4.7 has them."""
        own, p = self.vehicle, self.vehicle.parameters
        silence = (self._t - own.overridden) / self._speed
        # An override times out to the receiver's own channels; without a receiver it stays, until its silence is a
        # failsafe of the throttle.
        lasts = p["RC_OVERRIDE_TIME"] if own.receiver else RADIO_S if p["FS_THR_ENABLE"] else math.inf
        if own.armed and own.mode == MANUAL:
            for node, controller in self._controllers.items():
                n = own.sticks.get(node, 0.0)
                if n and silence > lasts >= 0.0:
                    controller.command(self._t, 0.0)
                elif n:
                    controller.command(self._t, n)  # a servo's pulse goes on
        self._drive()
        gone = (self._t - own.ground_heard) / self._speed
        watched = own.armed and p["FS_GCS_ENABLE"] and p["FS_ACTION"] and math.isfinite(gone)
        if watched and own.mode == MANUAL and gone > p["FS_GCS_TIMEOUT"] + p["FS_TIMEOUT"]:
            self._text(CRITICAL, "GCS Failsafe")
            if p["FS_ACTION"] == TERMINATE:
                self.disarm()
            else:
                self._set_mode(RTL if p["FS_ACTION"] == 1.0 else HOLD)

    def disarm(self, text: str = "Throttle disarmed") -> None:
        """No thrust from here on."""
        if self.vehicle.armed:
            self.vehicle.armed = False
            self._text(INFO, text)
        self._stop()

    def _set_mode(self, mode: int) -> None:
        self.vehicle.mode = mode
        if mode != MANUAL:
            self._stop()
        self._drive()

    def _drive(self) -> None:
        """On its own way, which no override of ours ends."""
        if self.vehicle.armed and self.vehicle.mode in (AUTO, RTL):
            for controller in self._controllers.values():
                controller.command(self._t, OWN_N)

    def _stop(self) -> None:
        for controller in self._controllers.values():
            controller.command(self._t, 0.0)

    # What it receives.

    def receive(self, data: bytes, t: float) -> bytes:
        """Messages of the host; the answers."""
        self._t = self._reports.t = t
        self._decoder.feed(data, t)
        return self._flush()

    def _hear(self, m: Any) -> None:
        name = m.get_type()
        if name in ("HEARTBEAT", "RC_CHANNELS_OVERRIDE") and m.get_srcSystem() != self._ground:
            return  # not its ground station
        if name == "HEARTBEAT":
            self.vehicle.ground_heard = self._t
        elif name == "TIMESYNC" and not m.tc1:
            self._queue.append(self._codec.encode("TIMESYNC", round((self._t + BOOT_S) * 1e9), m.ts1))
        elif getattr(m, "target_system", self._who[0]) != self._who[0]:
            return
        elif name == "RC_CHANNELS_OVERRIDE":
            self._override(m)
        elif name == "COMMAND_LONG":
            result = self._command(m)
            self._queue.append(self._codec.encode("COMMAND_ACK", m.command, result))
        elif name == "PARAM_REQUEST_READ" and m.param_id in self.vehicle.parameters:
            self._say_parameter(m.param_id)
        elif name == "PARAM_REQUEST_LIST":
            for parameter in self.vehicle.parameters:
                self._say_parameter(parameter)
        elif name == "PARAM_SET" and m.param_id in self.vehicle.parameters:
            self.vehicle.parameters[m.param_id] = m.param_value
            self._say_parameter(m.param_id)

    def _say_parameter(self, name: str) -> None:
        known = list(self.vehicle.parameters)
        value = self.vehicle.parameters[name]
        self._queue.append(self._codec.encode("PARAM_VALUE", name.encode(), value, 9, len(known), known.index(name)))

    def _override(self, m: Any) -> None:
        own = self.vehicle
        if own.parameters.get("MAV_GCS_SYSID") != self._ground or int(own.parameters["RC_OPTIONS"]) & IGNORES_OVERRIDES:
            return
        own.overridden = self._t
        for node, thruster in self._thrusters.items():
            assert thruster.output is not None
            channel = thruster.output.rc_channel
            pulse = getattr(m, f"chan{channel}_raw")
            # 0 gives the channels 1 to 8 back to the receiver, whose sticks rest; without one the last value stays.
            if pulse == UNUSED or (pulse == 0 and not (channel <= RELEASED and own.receiver)):
                continue
            low, neutral, high = thruster.output.rc_us
            pulse = pulse or neutral
            n = (pulse - neutral) / (high - neutral if pulse > neutral else neutral - low)
            self.vehicle.sticks[node] = max(-1.0, min(1.0, n))
            if self.vehicle.armed and self.vehicle.mode == MANUAL and node in self._controllers:
                self._controllers[node].command(self._t, self.vehicle.sticks[node])

    def _command(self, m: Any) -> int:
        if m.command == 511:
            return self._interval(int(m.param1), m.param2)
        if m.command == 176:
            if mode_name(int(m.param2)).startswith("mode "):
                return FAILED
            self._set_mode(int(m.param2))
            return ACCEPTED
        if m.command == 400:
            return self._arm() if m.param1 == 1.0 else self._disarm()
        if m.command == 183:  # DO_SET_SERVO: refused on the outputs of motors
            return DENIED
        return UNSUPPORTED

    def _interval(self, number: int, interval_us: float) -> int:
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
        self.disarm()
        return ACCEPTED

    def _arm(self) -> int:
        if self.vehicle.armed:
            return ACCEPTED
        refusal = self._refusal()
        if refusal:
            self._text(CRITICAL, refusal)  # leaves after the answer
            return FAILED
        self.vehicle.armed = True
        self._text(INFO, "Throttle armed")
        return ACCEPTED

    def _refusal(self) -> str:
        """Why it does not arm; empty when it does."""
        if self._reports.ekf != EKF_READY:
            return "PreArm: AHRS: EKF3 is still initialising, wait for it or reboot"
        if self.vehicle.mode not in (MANUAL, HOLD):
            return "Arm: Mode not armable"
        if any(abs(n) > NEUTRAL_N for n in self.vehicle.sticks.values()):
            return "Arm: Throttle (RC3) is not neutral"
        return ""
