"""Messages that the emulated autopilot sends about its state and its sensors. It uses no ports."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

from seatrial.daq.protocol import GRAVITY, Codec
from seatrial.daq.rig import Thruster
from seatrial.daq.samples import NAN, Ahrs, Esc, Gnss
from seatrial.mocks.world import EscController

LOOP_HZ = 50.0  # SCHED_LOOP_RATE
MANUAL = 0  # mode of ArduPilot Rover
BOOT_S = 20.0  # s since the boot of the autopilot when the mock starts
EKF_READY = 0x33F  # EKF_STATUS_FLAGS: attitude, velocities and positions are valid, no constant-position mode
EKF_INITIALISING = 0x0A7  # EKF_STATUS_FLAGS: no horizontal position, constant-position mode
NO_FIX = 1  # GPS_FIX_TYPE
ROVER, ARDUPILOT, UNUSED = 11, 3, 0xFFFF  # MAV_TYPE_SURFACE_BOAT, MAV_AUTOPILOT_ARDUPILOTMEGA, no value


def parameters(thrusters: list[Thruster], own_system: int, override_s: float) -> dict[str, float]:
    """Return the ArduPilot parameters of an emulated autopilot whose ground station drives its thrusters.

    `seatrial check` accepts these values. A thruster with ``position_m`` y < 0 is the left one.

    Parameters
    ----------
    thrusters : list of Thruster
        Thrusters with their servo outputs and RC channels. Each must have an `output`.
    own_system : int
        MAVLink system ID of the ground station.
    override_s : float
        RC_OVERRIDE_TIME [s], after which an RC override ends.

    Returns
    -------
    dict of str to float
        Values by the names of ArduPilot Rover 4.7.
    """
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
        side = 73.0 if thruster.position_m[1] < 0.0 else 74.0  # ThrottleLeft, ThrottleRight
        found |= {f"{channel}_DZ": 0.0, f"{channel}_REVERSED": 0.0}
        found["RCMAP_ROLL" if side == 73.0 else "RCMAP_THROTTLE"] = float(output.rc_channel)
        found |= {f"{servo}_FUNCTION": side, f"{servo}_REVERSED": 0.0}
    return found


@dataclass
class Vehicle:
    """State of an emulated autopilot: its parameters, mode, estimator and last messages of the ground station.

    Attributes
    ----------
    parameters : dict of str to float
        ArduPilot parameters by name.
    armed : bool
        Whether the autopilot is armed.
    mode : int
        Number of the mode of ArduPilot Rover; 0 is MANUAL.
    ekf_ready_at : float
        Run time [s] at which the position estimator (EKF) is ready.
    ground_heard : float
        Run time [s] of the last heartbeat of the ground station; minus infinity before the first one.
    overridden : float
        Run time [s] of the last RC override; minus infinity before the first one.
    receiver : bool
        Whether the RC receiver has received a transmitter since boot.
    sticks : dict of int to float
        Command n (-1 to 1) of the last RC override, by servo output.
    """

    parameters: dict[str, float]
    armed: bool = False
    mode: int = MANUAL
    ekf_ready_at: float = 0.0
    ground_heard: float = -math.inf
    overridden: float = -math.inf
    receiver: bool = True
    sticks: dict[int, float] = field(default_factory=dict)


class Reports:
    """Encoder of MAVLink messages about the state of the autopilot and its latest measurements.

    Attributes
    ----------
    t : float
        Present run time [s]. The emulator of the autopilot sets it before it calls a method.
    clock_error : float
        Time [s] by which the clock of the autopilot is fast.
    """

    def __init__(
        self,
        vehicle: Vehicle,
        codec: Codec,
        thrusters: Mapping[int, Thruster],
        controllers: Mapping[int, EscController],
    ) -> None:
        """Set up the encoder of the messages of one autopilot.

        Parameters
        ----------
        vehicle : Vehicle
            State of the autopilot, which may change between the calls.
        codec : Codec
            Encoder of MAVLink frames.
        thrusters : mapping of int to Thruster
            Thrusters, by servo output.
        controllers : mapping of int to EscController
            Speed controllers, by servo output.
        """
        self.t = 0.0
        self._vehicle, self._codec, self._thrusters, self._controllers = vehicle, codec, thrusters, controllers
        self._esc: dict[int, Esc] = {}
        self._esc_counts: dict[int, int] = {}
        self.clock_error = 0.0
        self._gnss: Gnss | None = None  # last GNSS sample, with or without a fix
        self._fix: Gnss | None = None  # last GNSS sample with a fix
        self._fix_at, self._fix_boot_ms = 0.0, 0  # its run time [s], and its time since boot [ms]

    def take(self, sample: Esc | Gnss) -> None:
        """Store a telemetry or GNSS sample as the latest measurement, for messages that are encoded later.

        Telemetry is stored by speed controller. If a GNSS sample has no position fix, position and time of the latest
        fix are kept.
        """
        if isinstance(sample, Esc):
            self._esc[sample.node] = sample
            self._esc_counts[sample.node] = self._esc_counts.get(sample.node, 0) % 0xFFFF + 1
        else:
            self._gnss = sample
            if sample.fix >= 2:  # without a fix the reported position and its time stay the same
                self._fix, self._fix_at, self._fix_boot_ms = sample, self.t, self._boot_ms

    @property
    def ekf(self) -> int:
        """Present flags of the autopilot's position estimator (EKF), as in the message EKF_STATUS_REPORT.

        Before the run time `Vehicle.ekf_ready_at` they report that the estimator has no position.
        """
        return EKF_READY if self.t >= self._vehicle.ekf_ready_at else EKF_INITIALISING

    @property
    def _boot_ms(self) -> int:
        """Time since the boot of the autopilot [ms], by its own clock."""
        return self._boot_us // 1000  # rounded down, as ArduPilot does

    @property
    def _boot_us(self) -> int:
        """Time since the boot of the autopilot [us], by its own clock."""
        return round((self.t + self.clock_error + BOOT_S) * 1e6)

    def encode_message(self, name: str, ahrs: Ahrs) -> bytes:
        """Return the bytes (frame) of the MAVLink message ``name`` with the present state and latest measurements.

        ``ahrs`` is the newest AHRS sample, for ATTITUDE and RAW_IMU. Empty bytes are returned for an unknown name, and
        for GPS_RAW_INT, BATTERY_STATUS and ESC_TELEMETRY_1_TO_4 before the first sample of their quantity.
        """
        ms = self._boot_ms
        if name == "ATTITUDE":
            return self._codec.encode(name, ms, ahrs.roll, ahrs.pitch, ahrs.yaw, ahrs.p, ahrs.q, ahrs.r)
        if name == "RAW_IMU":
            accel = (round(a / GRAVITY * 1e3) for a in (ahrs.ax, ahrs.ay, ahrs.az))
            gyro = (round(w * 1e3) for w in (ahrs.p, ahrs.q, ahrs.r))
            # Components of the magnetic field without a value are sent as 0.
            field_ = (0 if math.isnan(b) else round(b * 1e7) for b in (ahrs.mx, ahrs.my, ahrs.mz))
            return self._codec.encode(name, self._boot_us, *accel, *gyro, *field_)
        if name == "SERVO_OUTPUT_RAW":
            return self._codec.encode(name, self._boot_us % 2**32, 0, *(self._pulse_us(node) for node in range(1, 17)))
        if name == "HEARTBEAT":
            mode = 128 * self._vehicle.armed + 1 + 64  # MAV_MODE_FLAG: armed, custom mode, manual input
            return self._codec.encode(name, ROVER, ARDUPILOT, mode, self._vehicle.mode, 3 + self._vehicle.armed, 3)
        if name == "SYSTEM_TIME":
            utc = 0 if self._fix is None else round((self._fix.utc + self.t - self._fix_at) * 1e6)
            return self._codec.encode(name, utc, ms)
        if name == "EKF_STATUS_REPORT":
            return self._codec.encode(name, self.ekf, 0.01, 0.01, 0.01, 0.01, 0.0, 0.0)
        if name == "RC_CHANNELS":
            channels = 8 if self._vehicle.receiver else 0
            return self._codec.encode(name, ms, channels, *([1500] * channels + [0] * (18 - channels)), 0xFF)
        return self._encode_measurement(name)

    def _encode_measurement(self, name: str) -> bytes:
        """Return the bytes (frame) of a MAVLink message with latest measurements.

        ``name`` is GPS_RAW_INT, BATTERY_STATUS or ESC_TELEMETRY_1_TO_4. Empty bytes are returned for other names, and
        if the quantity has not been measured yet. The battery has the mean of the known voltages of the speed
        controllers and the sum of the magnitudes of their currents. Its charge is 0 % at 12 V or less and 100 % at
        16.8 V or more, linear in between. Voltage and charge have the value for "unknown" if no voltage is known.
        """
        if name == "GPS_RAW_INT" and self._gnss is not None:
            return self._encode_fix(self._gnss)
        if name == "BATTERY_STATUS" and self._esc:
            known = [esc.voltage for esc in self._esc.values() if not math.isnan(esc.voltage)]
            volts = sum(known) / len(known) if known else NAN
            amps = sum(abs(esc.current) for esc in self._esc.values())
            cells = [_nearest_integer(volts * 1e3, UNUSED)] + [UNUSED] * 9
            percent = min(max(_nearest_integer((volts - 12.0) / 4.8 * 100.0), 0), 100) if known else -1
            centiamps = min(round(amps * 100), 0x7FFF)  # largest value of the field
            return self._codec.encode(name, 0, 0, 1, 0x7FFF, cells, centiamps, -1, -1, percent)
        if name == "ESC_TELEMETRY_1_TO_4" and self._esc:
            return self._encode_escs(name)
        return b""

    def _encode_fix(self, gnss: Gnss) -> bytes:
        """Return the bytes (frame) of the message GPS_RAW_INT for the latest GNSS sample, with or without a fix.

        Time, position, velocity and accuracy are those of the latest fix. Before the first fix they are 0, or the
        value for "unknown" of the field. The type of fix, the HDOP and the satellites are those of the latest sample.
        """
        fix = self._fix or Gnss(0.0, NAN, NAN)
        course = math.degrees(math.atan2(fix.vel_e, fix.vel_n)) % 360.0
        sigma = _nearest_integer(fix.sigma_h * math.sqrt(2.0) * 1e3)  # mm, of both horizontal axes together
        return self._codec.encode(
            "GPS_RAW_INT",
            self._fix_boot_ms * 1000,
            {2: 2, 3: 3, 4: 4, 5: 6, 6: 5}.get(gnss.fix, NO_FIX),  # MAVLink: 6 RTK fixed, 5 RTK float
            _nearest_integer(fix.lat * 1e7),
            _nearest_integer(fix.lon * 1e7),
            _nearest_integer(fix.alt * 1e3),
            _nearest_integer(gnss.hdop * 100, UNUSED),
            UNUSED,
            UNUSED if math.isnan(fix.speed) else int(fix.speed * 100),  # rounded down, as ArduPilot does
            UNUSED if math.isnan(course) else round(course * 100) % 36000,
            max(gnss.n_sat, 0),
            0,
            sigma,
            sigma,
        )

    def _encode_escs(self, name: str) -> bytes:
        """Return the bytes (frame) of the message ``name``, ESC_TELEMETRY_1_TO_4, with telemetry of outputs 1 to 4.

        Shaft speeds and currents have no sign. Temperatures are limited to 0 to 255 deg C. An output without telemetry
        so far has zeros, and so has an unknown voltage or temperature, because the message has no value for "unknown".
        """
        zeros = Esc(0, 0.0, 0.0, 0.0, 0.0, 0.0)
        escs = [self._esc.get(node, zeros) for node in range(1, 5)]
        return self._codec.encode(
            name,
            bytes(min(max(_nearest_integer(esc.temperature), 0), 255) for esc in escs),
            [_nearest_integer(esc.voltage * 100) for esc in escs],
            [round(abs(esc.current) * 100) for esc in escs],
            [0] * 4,
            [round(abs(esc.rpm)) for esc in escs],  # without a sign, as from ArduPilot
            [self._esc_counts.get(node, 0) for node in range(1, 5)],
        )

    def _pulse_us(self, node: int) -> int:
        """Return the pulse width [us] at the servo output with the number ``node``, by the command of its controller.

        Return 0 for an output without a thruster or a speed controller.
        """
        thruster, controller = self._thrusters.get(node), self._controllers.get(node)
        if thruster is None or thruster.output is None or controller is None:
            return 0
        low, neutral, high = thruster.output.pwm_us
        n = controller.duty
        return round(neutral + n * (high - neutral if n > 0.0 else neutral - low))


def _nearest_integer(value: float, unknown: int = 0) -> int:
    """Return the integer nearest to ``value``, or ``unknown`` if ``value`` is NaN."""
    return unknown if math.isnan(value) else round(value)
