"""A boat's autopilot on a MAVLink link, as ArduPilot Rover 4.7 behaves towards a ground station. Sans I/O.

It obeys one ground station, arms only on its command and refuses where a real one does, follows RC overrides while it
is armed and in MANUAL, and takes silence for the end of thrust. What it was told and what it put out are two things.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, final

from daq.protocol import mavlink
from daq.protocol.mavlink_samples import GRAVITY, ROVER_MODES, Samples
from daq.protocol.mavlink_wire import EPOCH_2015, Codec, read_key
from daq.rig import Device, Rig, Thruster
from daq.samples import Ahrs, Esc, Gnss
from mocks.devices import Speaker
from mocks.world import Controller, Sample

LOOP_HZ = 50.0  # SCHED_LOOP_RATE
INTERVAL_PART = 0.8  # of it: a faster message is denied
MANUAL, HOLD = 0, 4
BOOT_S = 20.0  # since boot when the mock starts
EKF_READY = 0x33F  # attitude, velocities and positions, no constant-position mode
EKF_INITIALISING = 0x0A7
ACCEPTED, DENIED, UNSUPPORTED, FAILED = 0, 2, 3, 4
INFO, CRITICAL = 6, 2
ALWAYS = {"HEARTBEAT": 1.0}  # Hz, asked for or not
NEUTRAL_N = 0.02  # a stick further out forbids arming
ROVER, ARDUPILOT, UNUSED = 11, 3, 0xFFFF  # MAV_TYPE_SURFACE_BOAT, MAV_AUTOPILOT_ARDUPILOTMEGA, no value


def parameters(thrusters: list[Thruster], own_system: int, override_s: float) -> dict[str, float]:
    """The parameters of a vehicle that is set up for a ground station which drives two thrusters."""
    found = {
        "PILOT_STEER_TYPE": 1.0, "MOT_SLEWRATE": 0.0, "MOT_THR_MIN": 0.0, "MOT_THST_EXPO": 0.0,
        "RC_OVERRIDE_TIME": override_s, "FS_GCS_ENABLE": 1.0, "FS_TIMEOUT": 5.0, "FS_ACTION": 2.0,
        "MAV_GCS_SYSID": float(own_system), "SCHED_LOOP_RATE": LOOP_HZ,
    }  # fmt: skip
    for thruster in thrusters:
        output = thruster.output
        assert output is not None
        channel, servo = f"RC{output.rc_channel}", f"SERVO{thruster.node}"
        ends = ("MIN", "TRIM", "MAX")
        found |= {f"{channel}_{end}": us for end, us in zip(ends, output.rc_us, strict=True)}
        found |= {f"{servo}_{end}": us for end, us in zip(ends, output.pwm_us, strict=True)}
        side = 73.0 if thruster.position_m[1] < 0.0 else 74.0
        found |= {f"{channel}_DZ": 0.0, f"{channel}_REVERSED": 0.0}
        found |= {f"{servo}_FUNCTION": side, f"{servo}_REVERSED": 0.0}
    return found


@dataclass
class Vehicle:
    """What the autopilot knows of itself."""

    parameters: dict[str, float]
    armed: bool = False
    mode: int = MANUAL
    ekf_ready_at: float = 0.0  # s, run time
    ground_heard: float = -math.inf  # s, last heartbeat of the ground station
    sticks: dict[int, float] = field(default_factory=dict)  # n by output, as overridden last


@final
class Autopilot(Speaker):
    """One autopilot: `encode` is called at its loop rate with the attitude, `receive` with what the host sends."""

    def __init__(
        self, rig: Rig, device: Device, controllers: Mapping[int, Controller], now_unix: float = EPOCH_2015
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
        self._decoder = mavlink.Decoder(Samples({}), settings.own_system_id, settings.own_component_id, self._codec)
        self._decoder.listener = self._hear
        self._rates: dict[str, float] = dict(ALWAYS)
        self._sent: dict[str, int] = {}  # the interval in which a message was sent last
        self._queue: deque[bytes] = deque()
        self._t = 0.0
        self._esc: dict[int, Esc] = {}
        self._esc_counts: dict[int, int] = {}
        self._fix: Gnss | None = None
        self._fix_at = 0.0

    # What it says.

    def encode(self, sample: Sample, t: float) -> bytes:
        """The messages that are due; an attitude is the tick of the loop."""
        self._t = t
        if isinstance(sample, Esc):
            self._esc[sample.node] = sample
            self._esc_counts[sample.node] = self._esc_counts.get(sample.node, 0) % 0xFFFF + 1
        elif isinstance(sample, Gnss):
            self._fix, self._fix_at = sample, t
        elif isinstance(sample, Ahrs):
            self._judge()
            return b"".join(self._say(name, sample) for name in list(self._rates) if self._is_due(name)) + self._flush()
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

    @property
    def _boot_ms(self) -> int:
        return round((self._t + BOOT_S) * 1e3)

    def _say(self, name: str, ahrs: Ahrs) -> bytes:
        """One message by its name; nothing for what there is nothing to say about."""
        ms = self._boot_ms
        if name == "ATTITUDE":
            return self._codec.encode(name, ms, ahrs.roll, ahrs.pitch, ahrs.yaw, ahrs.p, ahrs.q, ahrs.r)
        if name == "RAW_IMU":
            accel = (round(a / GRAVITY * 1e3) for a in (ahrs.ax, ahrs.ay, ahrs.az))
            gyro = (round(w * 1e3) for w in (ahrs.p, ahrs.q, ahrs.r))
            field_ = (0 if math.isnan(b) else round(b * 1e7) for b in (ahrs.mx, ahrs.my, ahrs.mz))
            return self._codec.encode(name, ms * 1000, *accel, *gyro, *field_)
        if name == "SERVO_OUTPUT_RAW":
            return self._codec.encode(name, ms * 1000 % 2**32, 0, *(self._pulse(node) for node in range(1, 17)))
        if name == "HEARTBEAT":
            mode = 128 * self.vehicle.armed + 1 + 64
            return self._codec.encode(name, ROVER, ARDUPILOT, mode, self.vehicle.mode, 3 + self.vehicle.armed, 3)
        if name == "SYSTEM_TIME":
            utc = 0 if self._fix is None else round((self._fix.utc + self._t - self._fix_at) * 1e6)
            return self._codec.encode(name, utc, ms)
        if name == "EKF_STATUS_REPORT":
            return self._codec.encode(name, self._ekf(), 0.01, 0.01, 0.01, 0.01, 0.0, 0.0)
        return self._say_slow(name)

    def _say_slow(self, name: str) -> bytes:
        if name == "GPS_RAW_INT" and self._fix is not None:
            return self._say_fix(self._fix)
        if name == "BATTERY_STATUS" and self._esc:
            volts = sum(esc.voltage for esc in self._esc.values()) / len(self._esc)
            amps = sum(abs(esc.current) for esc in self._esc.values())
            cells = [round(volts * 1e3)] + [UNUSED] * 9
            percent = min(max(round((volts - 12.0) / 4.8 * 100.0), 0), 100)
            return self._codec.encode(name, 0, 0, 1, 0x7FFF, cells, round(amps * 100), -1, -1, percent)
        if name == "ESC_TELEMETRY_1_TO_4" and self._esc:
            return self._say_escs(name)
        return b""

    def _say_fix(self, fix: Gnss) -> bytes:
        course = math.degrees(math.atan2(fix.vel_e, fix.vel_n)) % 360.0
        fix_type = {2: 2, 3: 3, 4: 4, 5: 6, 6: 5}.get(fix.fix, 0)
        sigma = 0 if math.isnan(fix.sigma_h) else round(fix.sigma_h * 1e3)
        return self._codec.encode(
            "GPS_RAW_INT",
            round((self._fix_at + BOOT_S) * 1e6),
            fix_type,
            round(fix.lat * 1e7),
            round(fix.lon * 1e7),
            0 if math.isnan(fix.alt) else round(fix.alt * 1e3),
            UNUSED if math.isnan(fix.hdop) else round(fix.hdop * 100),
            UNUSED,
            round(math.hypot(fix.vel_n, fix.vel_e) * 100),
            round(course * 100) % 36000,
            max(fix.n_sat, 0),
            0,
            sigma,
            sigma,
        )

    def _say_escs(self, name: str) -> bytes:
        none = Esc(0, 0.0, 0.0, 0.0, 0.0, 0.0)
        escs = [self._esc.get(node, none) for node in range(1, 5)]
        return self._codec.encode(
            name,
            bytes(min(max(round(esc.temperature), 0), 255) for esc in escs),
            [round(esc.voltage * 100) for esc in escs],
            [round(abs(esc.current) * 100) for esc in escs],
            [0] * 4,
            [round(abs(esc.rpm)) for esc in escs],  # unsigned, as the real one
            [self._esc_counts.get(node, 0) for node in range(1, 5)],
        )

    def _text(self, severity: int, text: str) -> None:
        self._queue.append(self._codec.encode("STATUSTEXT", severity, text.encode()[:50]))

    # What it does.

    def _pulse(self, node: int) -> int:
        """The pulse [us] at an output."""
        thruster, controller = self._thrusters.get(node), self._controllers.get(node)
        if thruster is None or thruster.output is None or controller is None:
            return 0
        low, neutral, high = thruster.output.pwm_us
        n = controller.duty
        return round(neutral + n * (high - neutral if n > 0.0 else neutral - low))

    def _ekf(self) -> int:
        return EKF_READY if self._t >= self.vehicle.ekf_ready_at else EKF_INITIALISING

    def _judge(self) -> None:
        """Failsafes: the ground station has fallen silent."""
        own, silence = self.vehicle, self._t - self.vehicle.ground_heard
        watched = own.armed and own.parameters["FS_GCS_ENABLE"] and own.mode != HOLD and math.isfinite(silence)
        if watched and silence > own.parameters["FS_TIMEOUT"] * self._speed:
            self._set_mode(HOLD)
            self._text(CRITICAL, "GCS Failsafe")

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

    def _stop(self) -> None:
        for controller in self._controllers.values():
            controller.command(self._t, 0.0)

    # What it is told.

    def receive(self, data: bytes, t: float) -> bytes:
        """Messages of the host; the answers."""
        self._t = t
        self._decoder.feed(data, t)
        return self._flush()

    def _hear(self, m: Any) -> None:
        name = m.get_type()
        if name == "HEARTBEAT":
            self.vehicle.ground_heard = self._t
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
        if self.vehicle.parameters.get("MAV_GCS_SYSID") != self._ground:
            return
        for node, thruster in self._thrusters.items():
            assert thruster.output is not None
            pulse = getattr(m, f"chan{thruster.output.rc_channel}_raw")
            if pulse in (0, UNUSED):
                continue
            low, neutral, high = thruster.output.rc_us
            n = (pulse - neutral) / (high - neutral if pulse > neutral else neutral - low)
            self.vehicle.sticks[node] = max(-1.0, min(1.0, n))
            if self.vehicle.armed and self.vehicle.mode == MANUAL and node in self._controllers:
                self._controllers[node].command(self._t, self.vehicle.sticks[node])

    def _command(self, m: Any) -> int:
        if m.command == 511:
            return self._interval(int(m.param1), m.param2)
        if m.command == 176:
            if int(m.param2) not in ROVER_MODES:
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
            self._text(CRITICAL, refusal)
            return FAILED
        self.vehicle.armed = True
        self._text(INFO, "Throttle armed")
        return ACCEPTED

    def _refusal(self) -> str:
        """Why it does not arm; empty when it does."""
        if self._ekf() != EKF_READY:
            return "PreArm: EKF3 is still initialising"
        if self.vehicle.mode not in (MANUAL, HOLD):
            return "Arm: Mode not armable"
        if any(abs(n) > NEUTRAL_N for n in self.vehicle.sticks.values()):
            return "Arm: Throttle (RC3) is not neutral"
        return ""
