"""Messages of a boat's autopilot about itself and its sensors, each by its name. Sans I/O."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from seatrial.daq.protocol import GRAVITY, Codec
from seatrial.daq.rig import Thruster
from seatrial.daq.samples import NAN, Ahrs, Esc, Gnss
from seatrial.mocks.world import EscController

LOOP_HZ = 50.0  # SCHED_LOOP_RATE
MANUAL = 0
BOOT_S = 20.0  # since boot when the mock starts
EKF_READY = 0x33F  # attitude, velocities and positions, no constant-position mode
EKF_INITIALISING = 0x0A7
NO_FIX = 1  # GPS_FIX_TYPE
ROVER, ARDUPILOT, UNUSED = 11, 3, 0xFFFF  # MAV_TYPE_SURFACE_BOAT, MAV_AUTOPILOT_ARDUPILOTMEGA, no value


def parameters(thrusters: list[Thruster], own_system: int, override_s: float) -> dict[str, float]:
    """The parameters of a vehicle that is set up for a ground station which drives two thrusters."""
    found = {
        "PILOT_STEER_TYPE": 1.0, "MOT_SLEWRATE": 0.0, "MOT_THR_MIN": 0.0, "MOT_THST_EXPO": 0.0,
        "RC_OVERRIDE_TIME": override_s, "FS_GCS_ENABLE": 1.0, "FS_GCS_TIMEOUT": 5.0, "FS_THR_ENABLE": 1.0,
        "FS_THR_VALUE": 910.0, "FS_TIMEOUT": 1.5, "FS_ACTION": 2.0, "FS_OPTIONS": 0.0, "RC_OPTIONS": 32.0,
        "MOT_THST_ASYM": 1.0, "MOT_THR_MAX": 100.0, "MANUAL_STR_EXPO": 0.0, "MAV_GCS_SYSID": float(own_system),
        "SCHED_LOOP_RATE": LOOP_HZ, "BATT_FS_LOW_ACT": 0.0, "BATT_FS_CRT_ACT": 0.0, "FENCE_ENABLE": 0.0,
        "FENCE_ACTION": 2.0,
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
        found["RCMAP_ROLL" if side == 73.0 else "RCMAP_THROTTLE"] = float(output.rc_channel)
        found |= {f"{servo}_FUNCTION": side, f"{servo}_REVERSED": 0.0}
    return found


@dataclass
class Vehicle:
    """State of the autopilot."""

    parameters: dict[str, float]
    armed: bool = False
    mode: int = MANUAL
    ekf_ready_at: float = 0.0  # s, run time
    ground_heard: float = -math.inf  # s, last heartbeat of the ground station
    overridden: float = -math.inf  # s, last override
    receiver: bool = True  # a transmitter was heard since boot
    sticks: dict[int, float] = field(default_factory=dict)  # n by output, as overridden last


class Reports:
    """What it has measured last, and the messages about it at its own time ``t`` (s)."""

    def __init__(
        self,
        vehicle: Vehicle,
        codec: Codec,
        thrusters: Mapping[int, Thruster],
        controllers: Mapping[int, EscController],
    ) -> None:
        """Thrusters and controllers by output."""
        self.t = 0.0
        self._vehicle, self._codec, self._thrusters, self._controllers = vehicle, codec, thrusters, controllers
        self._esc: dict[int, Esc] = {}
        self._esc_counts: dict[int, int] = {}
        self.clock_error = 0.0  # s by which its clock is ahead
        self._sight: Gnss | None = None  # what the receiver said last
        self._fix: Gnss | None = None  # and when it had a fix
        self._fix_at, self._fix_ms = 0.0, 0

    def take(self, sample: Esc | Gnss) -> None:
        """Telemetry of a speed controller, or a fix."""
        if isinstance(sample, Esc):
            self._esc[sample.node] = sample
            self._esc_counts[sample.node] = self._esc_counts.get(sample.node, 0) % 0xFFFF + 1
        else:
            self._sight = sample
            if sample.fix >= 2:  # without one the place stays, and so does the time
                self._fix, self._fix_at, self._fix_ms = sample, self.t, self._boot_ms

    @property
    def ekf(self) -> int:
        """Flags of EKF_STATUS_REPORT."""
        return EKF_READY if self.t >= self._vehicle.ekf_ready_at else EKF_INITIALISING

    @property
    def _boot_ms(self) -> int:
        return self._boot_us // 1000  # cut, as the real one does

    @property
    def _boot_us(self) -> int:
        return round((self.t + self.clock_error + BOOT_S) * 1e6)

    def say(self, name: str, ahrs: Ahrs) -> bytes:
        """One message by its name; nothing for what there is nothing to say about."""
        ms = self._boot_ms
        if name == "ATTITUDE":
            return self._codec.encode(name, ms, ahrs.roll, ahrs.pitch, ahrs.yaw, ahrs.p, ahrs.q, ahrs.r)
        if name == "RAW_IMU":
            accel = (round(a / GRAVITY * 1e3) for a in (ahrs.ax, ahrs.ay, ahrs.az))
            gyro = (round(w * 1e3) for w in (ahrs.p, ahrs.q, ahrs.r))
            field_ = (0 if math.isnan(b) else round(b * 1e7) for b in (ahrs.mx, ahrs.my, ahrs.mz))
            return self._codec.encode(name, self._boot_us, *accel, *gyro, *field_)
        if name == "SERVO_OUTPUT_RAW":
            return self._codec.encode(name, self._boot_us % 2**32, 0, *(self._pulse(node) for node in range(1, 17)))
        if name == "HEARTBEAT":
            mode = 128 * self._vehicle.armed + 1 + 64
            return self._codec.encode(name, ROVER, ARDUPILOT, mode, self._vehicle.mode, 3 + self._vehicle.armed, 3)
        if name == "SYSTEM_TIME":
            utc = 0 if self._fix is None else round((self._fix.utc + self.t - self._fix_at) * 1e6)
            return self._codec.encode(name, utc, ms)
        if name == "EKF_STATUS_REPORT":
            return self._codec.encode(name, self.ekf, 0.01, 0.01, 0.01, 0.01, 0.0, 0.0)
        if name == "RC_CHANNELS":
            heard = 8 if self._vehicle.receiver else 0
            return self._codec.encode(name, ms, heard, *([1500] * heard + [0] * (18 - heard)), 0xFF)
        return self._say_slow(name)

    def _say_slow(self, name: str) -> bytes:
        if name == "GPS_RAW_INT" and self._sight is not None:
            return self._say_fix(self._sight)
        if name == "BATTERY_STATUS" and self._esc:
            volts = sum(esc.voltage for esc in self._esc.values()) / len(self._esc)
            amps = sum(abs(esc.current) for esc in self._esc.values())
            cells = [round(volts * 1e3)] + [UNUSED] * 9
            percent = min(max(round((volts - 12.0) / 4.8 * 100.0), 0), 100)
            centiamps = min(round(amps * 100), 0x7FFF)  # the most that the field holds
            return self._codec.encode(name, 0, 0, 1, 0x7FFF, cells, centiamps, -1, -1, percent)
        if name == "ESC_TELEMETRY_1_TO_4" and self._esc:
            return self._say_escs(name)
        return b""

    def _say_fix(self, sight: Gnss) -> bytes:
        """The time is that of the newest fix, 0 before there was one; so are the place and what belongs to it."""
        fix = self._fix or Gnss(0.0, NAN, NAN)
        course = math.degrees(math.atan2(fix.vel_e, fix.vel_n)) % 360.0
        sigma = _whole(fix.sigma_h * math.sqrt(2.0) * 1e3)  # of both axes together
        return self._codec.encode(
            "GPS_RAW_INT",
            self._fix_ms * 1000,
            {2: 2, 3: 3, 4: 4, 5: 6, 6: 5}.get(sight.fix, NO_FIX),
            _whole(fix.lat * 1e7),
            _whole(fix.lon * 1e7),
            _whole(fix.alt * 1e3),
            _whole(sight.hdop * 100, UNUSED),
            UNUSED,
            UNUSED if math.isnan(fix.speed) else int(fix.speed * 100),  # cut, as the real one does
            UNUSED if math.isnan(course) else round(course * 100) % 36000,
            max(sight.n_sat, 0),
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

    def _pulse(self, node: int) -> int:
        """The pulse [us] at an output."""
        thruster, controller = self._thrusters.get(node), self._controllers.get(node)
        if thruster is None or thruster.output is None or controller is None:
            return 0
        low, neutral, high = thruster.output.pwm_us
        n = controller.duty
        return round(neutral + n * (high - neutral if n > 0.0 else neutral - low))


def _whole(value: float, none: int = 0) -> int:
    """The nearest whole number; `none` for NaN."""
    return none if math.isnan(value) else round(value)
