"""MAVLink from one autopilot: frames to AHRS, GNSS, servo outputs, ESCs, battery, state and status texts, in SI."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from seatrial.daq.errors import printable
from seatrial.daq.protocol.framing import StreamDecoder
from seatrial.daq.protocol.mavlink_wire import ESC_STATUS, Codec, dialect, head, is_known, is_whole
from seatrial.daq.rig import AutopilotOutput, Device, Rig
from seatrial.daq.samples import NAN, Ahrs, Autopilot, Battery, Esc, Event, Frame, Gnss, Sample, Servo

# Besides messages that become samples: those that the driver of the link needs.
SERVICE = (
    *("HEARTBEAT", "COMMAND_ACK", "PARAM_VALUE", "STATUSTEXT", "EKF_STATUS_REPORT", "TIMESYNC", "RC_CHANNELS"),
    *("RC_CHANNELS_OVERRIDE", "COMMAND_LONG", "PARAM_REQUEST_READ", "PARAM_REQUEST_LIST", "PARAM_SET"),
)
GRAVITY = 9.80665
SAME_S = 0.005  # s of boot time within which attitude and IMU are of one moment
IMU_AWAITED_S = 1.0  # s of boot time after an IMU message for which an attitude waits for its own
EKF_POSITION, EKF_STANDS = 16, 128  # EKF_STATUS_REPORT: an absolute horizontal position; constant-position mode
HALF_MS = 0.0005  # s by which a time that was cut to whole milliseconds is too early, on the average
RESTART_S = 1.0  # s by which time since boot runs back in no link: the autopilot has restarted
UNIX_US = 10**14  # a time_usec from here on counts from 1970, below from boot
ARDUPILOT = 3  # HEARTBEAT.autopilot; its RAW_IMU has units
ANY = 0  # system id: of all systems, as an autopilot hears them
INVALID = 8  # HEARTBEAT.autopilot of other components
ARMED = 128  # HEARTBEAT.base_mode
FIXES = {2: 2, 3: 3, 4: 4, 5: 6, 6: 5, 7: 3, 8: 4}  # GPS_FIX_TYPE -> samples.Gnss.fix
CHUNK = 50  # characters of STATUSTEXT
SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
PX4 = 12  # HEARTBEAT.autopilot
BOAT = 11  # MAV_TYPE_SURFACE_BOAT
ROVER = "ArduPilot Rover"
VEHICLES = {  # of ArduPilot, by MAV_TYPE
    **dict.fromkeys((10, BOAT), ROVER), 12: "ArduSub", **dict.fromkeys((2, 3, 4, 13, 14, 15, 29, 35), "ArduCopter"),
    **dict.fromkeys((1, *range(19, 26)), "ArduPlane"), 5: "AntennaTracker", 7: "Blimp",
}  # fmt: skip
Found = list[tuple[Sample, float]]  # with the device's time, s since boot, NaN where the message has none


def make_decoder(device: Device, rig: Rig) -> MavlinkDecoder:
    """The decoder for a device of the rig, without a key: the driver of the link gives it one by `secure`."""
    assert device.mavlink is not None
    return MavlinkDecoder(make_samples(device, rig), device.mavlink.system_id, device.mavlink.component_id)


def make_samples(device: Device, rig: Rig) -> Samples:
    """The sample maker for a device of the rig."""
    here = [thruster for thruster in rig.thrusters if thruster.device == device.name]
    outputs = {thruster.node: thruster.output for thruster in here if thruster.output is not None}
    reversed_nodes = frozenset(thruster.node for thruster in here if thruster.reversed)
    gnss = device.mavlink.gnss if device.mavlink is not None else "raw"
    return Samples(outputs or None, reversed_nodes, gnss)


class MavlinkDecoder(StreamDecoder[Frame]):
    """Frames of one system and component -> samples; `listener` gets every decoded message of it.

    Messages of any other system are counted in `foreign` and ignored, as are unsigned and wrongly signed ones
    (`unsigned`) where there is a key. Frames of messages that are not in the dialect count as frames.
    """

    sync = re.compile(rb"[\xfd\xfe]")
    between = b""
    unordered = True  # a fix is older than the attitude sent before it: device times of all kinds need not ascend

    def __init__(self, samples: Samples, system: int = 1, component: int = 1, codec: Codec | None = None) -> None:
        super().__init__()
        mode_name(0)  # what it loads, half a second long, is loaded before anything is urgent
        self.foreign: dict[int, int] = {}  # frames of other systems
        self.unsigned = 0
        self.signed = 0  # frames of it that bear a signature, looked at or not
        self.lost = 0  # frames of it that its sequence numbers count and that did not come
        self._sequence = -1
        self.accepted = 0  # messages of the autopilot, signed where there is a key
        self.listener: Callable[[Any], None] | None = None
        self._samples, self._who = samples, (system, component)
        self._codec = codec or Codec(255, 190)
        self._ids: dict[int, bool] = {}  # whether a message is used

    def secure(self, codec: Codec) -> None:
        """Decode, and check signatures, by this codec from now on."""
        self._codec = codec

    def begin_datagram(self) -> None:
        """Discard an incomplete frame: the next bytes are of another sender."""
        super().reset()

    def reset(self) -> None:
        """Discard an incomplete frame and all received state (the port was reopened). Counters stay."""
        super().reset()
        self._samples.forget()
        self._sequence = -1

    def _take(self, buffer: bytearray, start: int, t_rx: float) -> int:
        found = head(buffer, start)
        if isinstance(found, int):
            return found
        if len(buffer) < start + found.total:
            return 0
        frame = bytes(buffer[start : start + found.total])
        if not is_whole(frame, found):
            self.checksum_errors += is_known(found.message_id)
            return -1
        self.frames += 1
        if self._who[0] not in (found.system, ANY):
            self.foreign[found.system] = self.foreign.get(found.system, 0) + 1
        elif found.component == self._who[1]:
            self.signed += found.signed
            self._count_lost(found.sequence)
            if self._is_of_use(found.message_id):
                self._decode(frame, t_rx)
        return found.total

    def _count_lost(self, sequence: int) -> None:
        gap = (sequence - self._sequence - 1) % 256 if self._sequence >= 0 else 0
        self.lost += gap if gap < 128 else 0  # a larger one is an older frame, or a restart
        self._sequence = sequence

    def _is_of_use(self, message_id: int) -> bool:
        use = self._ids.get(message_id)
        if use is None:
            use = self._ids[message_id] = message_name(message_id) in {*self._samples.wanted, *SERVICE}
        return use

    def _decode(self, frame: bytes, t_rx: float) -> None:
        message = self._codec.decode(frame)
        if message is None:
            self.unsigned += 1
            return
        self.accepted += 1
        self._out += [Frame(sample, t_rx, t) for sample, t in self._samples.take(message)]
        if self.listener is not None:
            self.listener(message)


def message_name(message_id: int) -> str:
    """The name of a message; empty for one that is not in the dialect."""
    if message_id == ESC_STATUS:
        return "ESC_STATUS"
    kind = dialect().mavlink_map.get(message_id)
    return "" if kind is None else str(kind.msgname)


def mode_name(mode: int, vehicle: int = BOAT, autopilot: int = ARDUPILOT) -> str:
    """The name of a mode (HEARTBEAT.custom_mode) of this kind of vehicle (MAV_TYPE)."""
    from pymavlink import mavutil

    if autopilot == PX4:
        return str(mavutil.interpret_px4_mode(0, mode))
    return str((mavutil.mode_mapping_bynumber(vehicle) or {}).get(mode, f"mode {mode}"))


def vehicle_name(autopilot: int, vehicle: int) -> str:
    """What sends such a heartbeat: the name of its software, as "ArduPilot Rover" or "PX4"."""
    if autopilot == PX4:
        return "PX4"
    return VEHICLES.get(vehicle, "") if autopilot == ARDUPILOT else f"autopilot {autopilot} (MAV_AUTOPILOT)"


class Samples:
    """Turns the messages of one autopilot into samples.

    An attitude waits for the IMU message of the same moment, and both make one `Ahrs`; where they are of different
    moments each makes one, with NaN for what it has not. A fix that is sent again is
    dropped; a lost fix is one sample, without a time of its own. ESC_TELEMETRY has no sign: it gets that of the output.
    Nothing here depends on the time of day.
    """

    def __init__(
        self,
        outputs: Mapping[int, AutopilotOutput] | None = None,
        reversed_nodes: frozenset[int] = frozenset(),
        gnss: str = "raw",
    ) -> None:
        """`outputs` by servo number, from the rig; without them every output that ever had a pulse is reported."""
        self.wanted: dict[str, Callable[[Any], Found]] = {
            "HEARTBEAT": self._heartbeat, "ATTITUDE": self._attitude, "SYSTEM_TIME": self._system_time,
            "RAW_IMU": self._raw_imu, "SCALED_IMU": self._scaled_imu, "HIGHRES_IMU": self._highres_imu,
            "SERVO_OUTPUT_RAW": self._servos, "BATTERY_STATUS": self._battery, "SYS_STATUS": self._sys_status,
            "EKF_STATUS_REPORT": self._ekf, "STATUSTEXT": self._text, "ESC_STATUS": self._esc_status,
            **{f"ESC_TELEMETRY_{k}_TO_{k + 3}": self._esc_telemetry for k in range(1, 33, 4)},
        }  # fmt: skip
        self.wanted |= {"GPS_RAW_INT": self._gps} if gnss == "raw" else {"GLOBAL_POSITION_INT": self._position}
        self._outputs, self._reversed = outputs, reversed_nodes
        self.forget()

    def forget(self) -> None:
        """The link was reopened: the autopilot may have restarted since."""
        self._boot = math.nan  # s, the newest
        self._utc_of_boot = math.nan  # s since 1970
        self._attitude_waits: tuple[Ahrs, float] | None = None
        self._imu: tuple[float, tuple[float, ...], tuple[float, ...]] | None = None
        self._imu_at = -math.inf
        self._fix = (-1, -1)  # time and type of the newest
        self._n: dict[int, float] = {}  # by output
        self._counts: dict[int, int] = {}
        self._seen: set[int] = set()
        self._pilot: Autopilot | None = None
        self._ardupilot = self._has_battery = False
        self._ekf_flags = -1
        self._chunks: tuple[int, str] = (0, "")

    def take(self, message: Any) -> Found:
        """The samples that a message completes."""
        handler = self.wanted.get(message.get_type())
        return [] if handler is None else handler(message)

    def _at(self, usec: int, wraps: bool = False) -> float:
        """Seconds since boot of a time in us; of one that wraps at 32 bits, the nearest to the newest."""
        if usec >= UNIX_US:
            return usec * 1e-6 - self._utc_of_boot
        t = usec * 1e-6
        if wraps and not math.isnan(self._boot):
            t += round((self._boot - t) / 2**32 * 1e6) * 2**32 * 1e-6
        return t

    def _boot_time(self, t: float) -> float:
        """Take a time since boot [s]: where it runs back, all that was received is of before a restart."""
        if self._boot - t > RESTART_S:
            ardupilot = self._ardupilot
            self.forget()
            self._ardupilot = ardupilot
        return t

    def _heartbeat(self, m: Any) -> Found:
        if m.autopilot == INVALID:
            return []
        self._ardupilot = m.autopilot == ARDUPILOT
        before = self._pilot
        self._pilot = Autopilot(int(bool(m.base_mode & ARMED)), m.custom_mode, m.system_status, self._ekf_flags)
        found: Found = [(self._pilot, NAN)]
        if before is None or (before.armed, before.mode) != (self._pilot.armed, self._pilot.mode):
            word = "armed" if self._pilot.armed else "disarmed"
            mode = mode_name(m.custom_mode, m.type, m.autopilot)
            found.append((Event("autopilot", f"{word}, {mode}"), NAN))
        return found

    def _ekf(self, m: Any) -> Found:
        self._ekf_flags = m.flags
        if self._pilot is None:
            return []
        self._pilot = replace(self._pilot, ekf=m.flags)
        return [(self._pilot, NAN)]

    def _system_time(self, m: Any) -> Found:
        t = self._boot_time(_since_boot(m.time_boot_ms))
        if m.time_unix_usec >= UNIX_US:
            self._utc_of_boot = m.time_unix_usec * 1e-6 - t
        return []

    def _attitude(self, m: Any) -> Found:
        self._boot = t = self._boot_time(_since_boot(m.time_boot_ms))
        found: Found = [self._attitude_waits] if self._attitude_waits is not None else []
        self._attitude_waits = None
        ahrs = Ahrs(m.yaw, m.pitch, m.roll, m.rollspeed, m.pitchspeed, m.yawspeed)
        if self._imu is not None and abs(self._imu[0] - t) <= SAME_S:
            found.append((_joined(ahrs, self._imu), t))
            self._imu = None
            return found
        if self._imu is not None and self._imu[0] < t:  # no attitude will come for it: before this one, in its turn
            found.append((_joined(Ahrs(NAN, NAN, NAN), self._imu), self._imu[0]))
            self._imu = None
        if 0.0 <= t - self._imu_at <= IMU_AWAITED_S:
            self._attitude_waits = (ahrs, t)
        else:
            found.append((ahrs, t))
        return found

    def _raw_imu(self, m: Any) -> Found:
        return self._milli(m, self._at(m.time_usec)) if self._ardupilot else []

    def _scaled_imu(self, m: Any) -> Found:
        return self._milli(m, _since_boot(m.time_boot_ms))

    def _milli(self, m: Any, t: float) -> Found:
        """Thousandths of g and of a gauss."""
        accel = tuple(1e-3 * GRAVITY * a for a in (m.xacc, m.yacc, m.zacc))
        return self._take_imu(t, accel, tuple(1e-7 * b for b in (m.xmag, m.ymag, m.zmag)))

    def _highres_imu(self, m: Any) -> Found:
        field = tuple(1e-4 * b for b in (m.xmag, m.ymag, m.zmag))
        return self._take_imu(self._at(m.time_usec), (m.xacc, m.yacc, m.zacc), field)

    def _take_imu(self, t: float, accel: tuple[float, ...], field: tuple[float, ...]) -> Found:
        self._imu_at = self._boot_time(t)
        imu = (t, accel, field if any(field) else (NAN, NAN, NAN))
        found: Found = []
        if self._imu is not None:  # no attitude came for that one: it is a sample of its own
            found.append((_joined(Ahrs(NAN, NAN, NAN), self._imu), self._imu[0]))
            self._imu = None
        waiting, self._attitude_waits = self._attitude_waits, None
        if waiting is not None and abs(waiting[1] - t) <= SAME_S:
            return [*found, (_joined(waiting[0], imu), waiting[1])]
        self._imu = imu
        return found if waiting is None else [*found, waiting]

    def _gps(self, m: Any) -> Found:
        if (m.time_usec, m.fix_type) == self._fix:
            return []
        self._fix = m.time_usec, m.fix_type
        fix = FIXES.get(m.fix_type, 0)
        t = self._at(m.time_usec) if fix else NAN  # ArduPilot's stands still without a fix, at 0 before the first
        if self._ardupilot and m.time_usec < UNIX_US:  # its milliseconds, times thousand
            t += HALF_MS
        course = math.radians(m.cog * 0.01) if m.cog != 0xFFFF else NAN
        speed = _cut(m.vel) if fix >= 2 and m.vel != 0xFFFF else NAN
        return [
            (
                Gnss(
                    utc=t + self._utc_of_boot,
                    lat=m.lat * 1e-7 if fix else NAN,
                    lon=m.lon * 1e-7 if fix else NAN,
                    alt=m.alt * 1e-3 if fix >= 3 else NAN,
                    vel_n=speed * math.cos(course),
                    vel_e=speed * math.sin(course),
                    fix=fix,
                    n_sat=-1 if m.satellites_visible == 255 else m.satellites_visible,
                    hdop=NAN if m.eph == 0xFFFF else m.eph * 0.01,
                    # As of UBX, whose hAcc autopilots pass on: of both axes together.
                    sigma_h=m.h_acc * 1e-3 / math.sqrt(2.0) if fix and m.h_acc else NAN,
                    speed=speed,
                ),
                t,
            )
        ]

    def _position(self, m: Any) -> Found:
        t = self._boot_time(_since_boot(m.time_boot_ms))
        if m.time_boot_ms == self._fix[0]:
            return []
        self._fix = m.time_boot_ms, 0
        if m.lat == 0 and m.lon == 0:
            return [(Gnss(t + self._utc_of_boot, NAN, NAN), t)]
        north, east, down = (_cut(v) for v in (m.vx, m.vy, m.vz))
        # An estimator that has lost its position goes on sending one: where it was, or where it reckons to be.
        known = self._ekf_flags < 0 or (self._ekf_flags & EKF_POSITION and not self._ekf_flags & EKF_STANDS)
        kind = 3 if known else 0
        fix = Gnss(t + self._utc_of_boot, m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3, north, east, down, fix=kind)
        return [(fix, t)]

    def _servos(self, m: Any) -> Found:
        t = self._at(m.time_usec, wraps=True)
        found: Found = []
        for k in range(1, 17):
            node, pwm = 16 * m.port + k, float(getattr(m, f"servo{k}_raw"))
            if self._outputs is None:
                self._seen |= {node} if pwm else set()
                if node in self._seen:
                    found.append((Servo(node, pwm), t))
            elif node in self._outputs:
                n = self._outputs[node].applied(pwm) if pwm else 0.0  # no pulse: the thruster stands
                self._n[node] = -n if node in self._reversed else n
                found.append((Servo(node, pwm, self._n[node] + 0.0), t))
        return found

    def _esc_telemetry(self, m: Any) -> Found:
        first = int(m.get_type().split("_")[2])
        found: Found = []
        for k in range(4):
            node, count = first + k, m.count[k]
            if self._counts.get(node, 0) == count:
                continue  # nothing new from this one, or no such controller
            self._counts[node] = count
            n = self._n.get(node, NAN)
            rpm = math.copysign(float(m.rpm[k]), n) if n else float(m.rpm[k])
            esc = Esc(node, rpm, m.current[k] * 0.01, n, m.voltage[k] * 0.01, float(m.temperature[k]))
            found.append((esc, NAN))
        return found

    def _esc_status(self, m: Any) -> Found:
        found: Found = []
        for k in range(4):
            node = m.first + k + 1
            if m.voltage[k] == 0.0 and (self._outputs is None or node not in self._outputs):
                continue
            sign = -1.0 if node in self._reversed else 1.0
            esc = Esc(node, sign * m.rpm[k], m.current[k], self._n.get(node, NAN), m.voltage[k])
            found.append((esc, self._at(m.time_usec)))
        return found

    def _battery(self, m: Any) -> Found:
        cells = [v for v in (*m.voltages, *m.voltages_ext) if v not in (0, 0xFFFF)]
        if m.id != 0 or not cells:
            return []
        self._has_battery = True
        return [(_battery(sum(cells) * 1e-3, m.current_battery, m.battery_remaining), NAN)]

    def _sys_status(self, m: Any) -> Found:
        if self._has_battery or m.voltage_battery in (0, 0xFFFF):
            return []
        return [(_battery(m.voltage_battery * 1e-3, m.current_battery, m.battery_remaining), NAN)]

    def _text(self, m: Any) -> Found:
        number, before = self._chunks
        said = printable(m.text)
        text = before + said if m.id and m.id == number and m.chunk_seq else said
        if m.id and len(m.text) == CHUNK:
            self._chunks = (m.id, text)
            return []
        self._chunks = (0, "")
        word = SEVERITIES[m.severity] if m.severity < len(SEVERITIES) else f"severity {m.severity}"
        return [(Event("statustext", f"{word}: {text}"), NAN)]


def _since_boot(ms: int) -> float:
    """Seconds of a time in whole milliseconds."""
    return ms * 1e-3 + HALF_MS


def _cut(velocity: int) -> float:
    """m/s: the middle of what ArduPilot and PX4 cut to these whole cm/s, towards zero."""
    return (velocity + math.copysign(0.5, velocity)) * 0.01 if velocity else 0.0


def _joined(ahrs: Ahrs, imu: tuple[float, tuple[float, ...], tuple[float, ...]]) -> Ahrs:
    (ax, ay, az), (mx, my, mz) = imu[1], imu[2]
    return replace(ahrs, ax=ax, ay=ay, az=az, mx=mx, my=my, mz=mz)


def _battery(voltage: float, centiampere: int, percent: int) -> Battery:
    return Battery(voltage, NAN if centiampere < 0 else centiampere * 0.01, NAN if percent < 0 else percent * 0.01)
