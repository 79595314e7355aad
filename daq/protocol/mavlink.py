"""Decoder of the MAVLink frames of one autopilot to samples in SI units.

The samples are AHRS, GNSS, servo outputs, speed controllers, battery, state of the autopilot and status texts.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from typing import Any

from seatrial.daq.errors import printable
from seatrial.daq.protocol.framing import StreamDecoder
from seatrial.daq.protocol.mavlink_wire import ESC_STATUS, Codec, dialect, has_correct_checksum, is_known, parse_header
from seatrial.daq.rig import AutopilotOutput, Device, Rig
from seatrial.daq.samples import NAN, Ahrs, Autopilot, Battery, Esc, Event, Frame, Gnss, Sample, Servo

# Messages that are decoded for the driver of the link, beside those that become samples.
SERVICE = (
    *("HEARTBEAT", "COMMAND_ACK", "PARAM_VALUE", "STATUSTEXT", "EKF_STATUS_REPORT", "TIMESYNC", "RC_CHANNELS"),
    *("RC_CHANNELS_OVERRIDE", "COMMAND_LONG", "PARAM_REQUEST_READ", "PARAM_REQUEST_LIST", "PARAM_SET"),
)
GRAVITY = 9.80665  # m/s2
SAME_S = 0.005  # s of boot time; an attitude and an IMU message closer than this belong to one moment
IMU_AWAITED_S = 1.0  # s of boot time after an IMU message, in which an attitude waits for its IMU message
EKF_POSITION, EKF_STANDS = 16, 128  # EKF_STATUS_REPORT: an absolute horizontal position; constant-position mode
HALF_MS = 0.0005  # s; mean error of a time that was truncated to whole milliseconds
RESTART_S = 1.0  # s; if the time since boot decreases by more than this, the autopilot has restarted
UNIX_US = 10**14  # us; a larger time_usec counts from 1970, a smaller one from boot
ARDUPILOT = 3  # HEARTBEAT.autopilot; the units of RAW_IMU are defined for ArduPilot only
ANY = 0  # system id that stands for all systems
INVALID = 8  # HEARTBEAT.autopilot of components that are not autopilots
ARMED = 128  # flag of HEARTBEAT.base_mode
FIXES = {2: 2, 3: 3, 4: 4, 5: 6, 6: 5, 7: 3, 8: 4}  # GPS_FIX_TYPE -> samples.Gnss.fix
CHUNK = 50  # characters of one STATUSTEXT; longer texts are sent in several
SEVERITIES = ("emergency", "alert", "critical", "error", "warning", "notice", "info", "debug")
PX4 = 12  # HEARTBEAT.autopilot
BOAT = 11  # MAV_TYPE_SURFACE_BOAT
ROVER = "ArduPilot Rover"
VEHICLES = {  # MAV_TYPE -> software of ArduPilot
    **dict.fromkeys((10, BOAT), ROVER), 12: "ArduSub", **dict.fromkeys((2, 3, 4, 13, 14, 15, 29, 35), "ArduCopter"),
    **dict.fromkeys((1, *range(19, 26)), "ArduPlane"), 5: "AntennaTracker", 7: "Blimp",
}  # fmt: skip
TimedSamples = list[
    tuple[Sample, float]
]  # samples with the device's time [s since boot], NaN if the message has no time


def make_decoder(device: Device, rig: Rig) -> MavlinkDecoder:
    """Return a new decoder of the MAVLink frames of an autopilot of the rig.

    The device needs MAVLink settings. The decoder has no signing key; the driver of the link sets one with `secure`.
    """
    assert device.mavlink is not None
    return MavlinkDecoder(make_sample_converter(device, rig), device.mavlink.system_id, device.mavlink.component_id)


def make_sample_converter(device: Device, rig: Rig) -> SampleConverter:
    """Return a new converter of MAVLink messages to samples, for an autopilot of the rig and the thrusters behind it.

    If the autopilot drives no thruster with an output in the rig, each servo output that had a pulse gives samples. The
    MAVLink settings of the device decide between fixes of the receiver ("raw") and the position estimate of the
    autopilot ("fused"); without settings the fixes of the receiver are used. A thruster without an output is left out.
    """
    thrusters = [thruster for thruster in rig.thrusters if thruster.device == device.name]
    outputs = {thruster.node: thruster.output for thruster in thrusters if thruster.output is not None}
    reversed_nodes = frozenset(thruster.node for thruster in thrusters if thruster.reversed)
    gnss = device.mavlink.gnss if device.mavlink is not None else "raw"
    return SampleConverter(outputs or None, reversed_nodes, gnss)


class MavlinkDecoder(StreamDecoder[Frame]):
    """Decoder of the MAVLink frames of one autopilot to samples.

    Frames of other systems are counted in `foreign` and ignored; frames of other components of the same system are
    ignored. Only messages that give samples, or that the driver of the link needs, are decoded. If the codec has a
    signing key, frames of such messages without a correct signature are counted in `unsigned` and ignored. Frames whose
    message is not in the dialect count as frames.

    Parameters
    ----------
    samples
        Converter of messages to samples.
    system, component
        Ids of the autopilot. System 0 stands for all systems.
    codec
        Converter of frames to messages, which checks signatures if it has a signing key; None for no check.

    Attributes
    ----------
    listener
        Function that is called with each decoded message of the autopilot; None at first.
    foreign
        Number of frames of each other system, by its id.
    unsigned
        Number of frames of needed messages of the autopilot that were ignored because of their signature, or because
        pymavlink cannot decode them.
    signed
        Number of frames of the autopilot with a signature, checked or not.
    lost
        Number of frames of the autopilot that are missing by their sequence numbers.
    accepted
        Number of decoded messages of the autopilot; if the codec has a signing key, only correctly signed ones.
    """

    sync = re.compile(rb"[\xfd\xfe]")
    between = b""
    unordered = True  # device times need not ascend: a fix is older than the attitude that was sent before it

    def __init__(
        self, samples: SampleConverter, system: int = 1, component: int = 1, codec: Codec | None = None
    ) -> None:
        """Set all counters to 0.

        `samples` converts messages to samples, `system` and `component` are the ids of the autopilot (system 0: all
        systems), and `codec` converts frames to messages (None: signatures are not checked).
        """
        super().__init__()
        mode_name(0)  # imports modules for half a second; done here, because a later import would delay commands
        self.foreign: dict[int, int] = {}  # number of frames by id of another system
        self.unsigned = 0  # frames of the autopilot that were ignored for their signature
        self.signed = 0  # frames of the autopilot with a signature, checked or not
        self.lost = 0  # frames of the autopilot that are missing by their sequence numbers
        self._sequence = -1  # of the last frame
        self.accepted = 0  # messages of the autopilot; if a key is given, only correctly signed ones
        self.listener: Callable[[Any], None] | None = None
        self._samples, self._address = samples, (system, component)
        self._codec = codec or Codec(255, 190)
        self._ids: dict[int, bool] = {}  # message id -> whether the message is used

    def secure(self, codec: Codec) -> None:
        """Decode frames and check their signatures with `codec`, which contains the signing key, from now on."""
        self._codec = codec

    def begin_datagram(self) -> None:
        """Discard an incomplete MAVLink frame, because the next datagram may come from another sender.

        Its bytes count as unparsed. Values from earlier frames are kept.
        """
        super().reset()

    def reset(self) -> None:
        """Discard an incomplete MAVLink frame and all values from earlier frames, because the port was reopened.

        The counters are kept.
        """
        super().reset()
        self._samples.forget()
        self._sequence = -1

    def _decode_frame(self, buffer: bytearray, start: int, t_rx: float) -> int:
        """Decode the MAVLink frame that begins at index `start` of the buffer, and append its samples to `self._out`.

        Frames of other systems are counted, and frames of other components are ignored. A wrong checksum counts as a
        checksum error if the dialect has the message, and the result is then -1. `t_rx` is the run time of receipt [s].
        Return the length of the frame in bytes, 0 if more bytes are needed, or -1 if no valid frame begins there.
        """
        header = parse_header(buffer, start)
        if isinstance(header, int):
            return header
        if len(buffer) < start + header.total:
            return 0
        frame = bytes(buffer[start : start + header.total])
        if not has_correct_checksum(frame, header):
            self.checksum_errors += is_known(header.message_id)
            return -1
        self.frames += 1
        if self._address[0] not in (header.system, ANY):
            self.foreign[header.system] = self.foreign.get(header.system, 0) + 1
        elif header.component == self._address[1]:
            self.signed += header.signed
            self._count_lost(header.sequence)
            if self._is_used(header.message_id):
                self._decode(frame, t_rx)
        return header.total

    def _count_lost(self, sequence: int) -> None:
        """Update `lost`, the number of lost frames of the autopilot, from the sequence number (0..255) of a new frame.

        The first frame counts none as lost. A gap of 128 frames or more does not count, because it means an older frame
        or a restart of the autopilot.
        """
        gap = (sequence - self._sequence - 1) % 256 if self._sequence >= 0 else 0
        self.lost += gap if gap < 128 else 0  # a larger gap means an older frame or a restart
        self._sequence = sequence

    def _is_used(self, message_id: int) -> bool:
        """Return whether the message with this id is decoded: it gives samples, or the driver of the link needs it.

        The id is that of a MAVLink message. The result is stored for the next call.
        """
        used = self._ids.get(message_id)
        if used is None:
            used = self._ids[message_id] = message_name(message_id) in {*self._samples.wanted, *SERVICE}
        return used

    def _decode(self, frame: bytes, t_rx: float) -> None:
        """Decode a frame of the autopilot, append its samples to `self._out`, and pass its message to the listener.

        If the codec has a signing key and the signature is missing or wrong, or if pymavlink cannot decode the frame,
        the frame is counted in `unsigned` and ignored. `t_rx` is the run time of receipt [s].
        """
        message = self._codec.decode(frame)
        if message is None:
            self.unsigned += 1
            return
        self.accepted += 1
        self._out += [Frame(sample, t_rx, t) for sample, t in self._samples.take(message)]
        if self.listener is not None:
            self.listener(message)


def message_name(message_id: int) -> str:
    """Return the name of the MAVLink message with an id, such as "ATTITUDE"; empty if the dialect lacks it."""
    if message_id == ESC_STATUS:
        return "ESC_STATUS"
    kind = dialect().mavlink_map.get(message_id)
    return "" if kind is None else str(kind.msgname)


def mode_name(mode: int, vehicle: int = BOAT, autopilot: int = ARDUPILOT) -> str:
    """Return the name of an autopilot's mode, such as "MANUAL".

    Parameters
    ----------
    mode
        Number of the mode (HEARTBEAT.custom_mode).
    vehicle
        Kind of vehicle (MAV_TYPE), on which the names of ArduPilot's modes depend.
    autopilot
        Kind of autopilot (MAV_AUTOPILOT): the names of PX4, or else those of ArduPilot, are used.

    Returns
    -------
    str
        Name. A mode of ArduPilot without a name is "mode 7", with its number.
    """
    from pymavlink import mavutil

    if autopilot == PX4:
        return str(mavutil.interpret_px4_mode(0, mode))
    return str((mavutil.mode_mapping_bynumber(vehicle) or {}).get(mode, f"mode {mode}"))


def vehicle_name(autopilot: int, vehicle: int) -> str:
    """Return the name of an autopilot's software from its heartbeat: "ArduPilot Rover", "PX4", ...

    The parameters are the numbers MAV_AUTOPILOT and MAV_TYPE. The name is empty for an unknown vehicle of ArduPilot.
    For any other autopilot it is "autopilot 3 (MAV_AUTOPILOT)", with its number.
    """
    if autopilot == PX4:
        return "PX4"
    return VEHICLES.get(vehicle, "") if autopilot == ARDUPILOT else f"autopilot {autopilot} (MAV_AUTOPILOT)"


class SampleConverter:
    """Converter of the MAVLink messages of one autopilot to samples. It reads no clock.

    An attitude waits for the IMU message of the same moment (within 5 ms), and both become one `Ahrs`. If there is
    none, each becomes one `Ahrs`, in which the missing values are NaN. A fix that the autopilot sends again is dropped.
    The loss of the fix becomes one sample without a device time. The rpm of ESC_TELEMETRY has no sign; it gets the sign
    of the output's command.

    Attributes
    ----------
    wanted
        Function that converts a message to samples, by name of the message.
    """

    def __init__(
        self,
        outputs: Mapping[int, AutopilotOutput] | None = None,
        reversed_nodes: frozenset[int] = frozenset(),
        gnss: str = "raw",
    ) -> None:
        """Select the messages to convert.

        Parameters
        ----------
        outputs
            Thruster outputs of the rig by number of the servo output. If it is None, each output that had a pulse gives
            samples, without a command.
        reversed_nodes
            Numbers of the servo outputs of reversed thrusters, whose command and rpm change their sign.
        gnss
            "raw" for the fixes of the receiver (GPS_RAW_INT), "fused" for the position estimate of the autopilot
            (GLOBAL_POSITION_INT).
        """
        self.wanted: dict[str, Callable[[Any], TimedSamples]] = {
            "HEARTBEAT": self._heartbeat, "ATTITUDE": self._attitude, "SYSTEM_TIME": self._system_time,
            "RAW_IMU": self._raw_imu, "SCALED_IMU": self._scaled_imu, "HIGHRES_IMU": self._highres_imu,
            "SERVO_OUTPUT_RAW": self._servo_outputs, "BATTERY_STATUS": self._battery, "SYS_STATUS": self._sys_status,
            "EKF_STATUS_REPORT": self._ekf, "STATUSTEXT": self._status_text, "ESC_STATUS": self._esc_status,
            **{f"ESC_TELEMETRY_{k}_TO_{k + 3}": self._esc_telemetry for k in range(1, 33, 4)},
        }  # fmt: skip
        self.wanted |= (
            {"GPS_RAW_INT": self._gps_raw_int} if gnss == "raw" else {"GLOBAL_POSITION_INT": self._global_position}
        )
        self._outputs, self._reversed = outputs, reversed_nodes
        self.forget()

    def forget(self) -> None:
        """Discard all values from earlier MAVLink messages, because the autopilot may have restarted.

        The first call creates these values.
        """
        self._boot = math.nan  # s since boot, of the newest attitude
        self._utc_of_boot = math.nan  # s since 1970
        # An attitude that waits for its IMU message, and its time [s since boot].
        self._attitude_waits: tuple[Ahrs, float] | None = None
        # An IMU message that waits for its attitude: time [s since boot], specific force [m/s2], magnetic field [T].
        self._imu: tuple[float, tuple[float, ...], tuple[float, ...]] | None = None
        self._imu_at = -math.inf  # s since boot, of the last IMU message
        self._fix = (-1, -1)  # time and type of the newest fix
        self._n: dict[int, float] = {}  # output -> command, -1..1
        self._counts: dict[int, int] = {}  # controller -> counter of its telemetry
        self._seen: set[int] = set()  # outputs that had a pulse
        self._pilot: Autopilot | None = None
        self._ardupilot = self._has_battery = False
        self._ekf_flags = -1
        self._chunks: tuple[int, str] = (0, "")  # id and received part of a long text

    def take(self, message: Any) -> TimedSamples:
        """Return the samples that a MAVLink message of the autopilot completes, each with its time [s since boot].

        The time is NaN if the message has none. The list is empty for a message that completes no sample. `message` is
        an object of pymavlink, or `EscStatus`.
        """
        handler = self.wanted.get(message.get_type())
        return [] if handler is None else handler(message)

    def _to_boot_time(self, usec: int, wraps: bool = False) -> float:
        """Convert a time in a MAVLink message [us] to s since the start of the autopilot (boot).

        The time counts from boot or, if it is at least 10^14, from 1970 (UTC). The result is NaN if it is UTC and the
        UTC of the boot is unknown. If `wraps` is true, the message has only the low 32 bits of a time since boot; the
        result is then the time nearest to that of the newest attitude, if there is one.
        """
        if usec >= UNIX_US:
            return usec * 1e-6 - self._utc_of_boot
        t = usec * 1e-6
        if wraps and not math.isnan(self._boot):
            t += round((self._boot - t) / 2**32 * 1e6) * 2**32 * 1e-6
        return t

    def _check_restart(self, t: float) -> float:
        """Return a time since boot [s] unchanged. If the autopilot has restarted, discard all values from before.

        The autopilot has restarted if the time is more than 1 s (RESTART_S) before that of the newest attitude. Whether
        the autopilot is ArduPilot is kept.
        """
        if self._boot - t > RESTART_S:
            ardupilot = self._ardupilot
            self.forget()
            self._ardupilot = ardupilot
        return t

    def _heartbeat(self, m: Any) -> TimedSamples:
        """Return the state of the autopilot from a HEARTBEAT, and an event if its mode or arming has changed.

        The first HEARTBEAT also gives an event. The text of the event is "armed, MANUAL" or the like. The samples have
        no time. The list is empty if a component that is not an autopilot sent the message.
        """
        if m.autopilot == INVALID:
            return []
        self._ardupilot = m.autopilot == ARDUPILOT
        previous = self._pilot
        self._pilot = Autopilot(int(bool(m.base_mode & ARMED)), m.custom_mode, m.system_status, self._ekf_flags)
        samples: TimedSamples = [(self._pilot, NAN)]
        if previous is None or (previous.armed, previous.mode) != (self._pilot.armed, self._pilot.mode):
            word = "armed" if self._pilot.armed else "disarmed"
            mode = mode_name(m.custom_mode, m.type, m.autopilot)
            samples.append((Event("autopilot", f"{word}, {mode}"), NAN))
        return samples

    def _ekf(self, m: Any) -> TimedSamples:
        """Return the state of the autopilot with the flags of its estimator from EKF_STATUS_REPORT.

        Before the first HEARTBEAT the flags are stored, and the list is empty.
        """
        self._ekf_flags = m.flags
        if self._pilot is None:
            return []
        self._pilot = replace(self._pilot, ekf=m.flags)
        return [(self._pilot, NAN)]

    def _system_time(self, m: Any) -> TimedSamples:
        """Store the UTC at which the autopilot was started (boot), from a message SYSTEM_TIME. Return no sample.

        Nothing is stored if the autopilot does not have the UTC yet.
        """
        t = self._check_restart(_since_boot(m.time_boot_ms))
        if m.time_unix_usec >= UNIX_US:
            self._utc_of_boot = m.time_unix_usec * 1e-6 - t
        return []

    def _attitude(self, m: Any) -> TimedSamples:
        """Return the samples that an ATTITUDE message completes; each is an `Ahrs`.

        The attitude is joined with the IMU message of the same moment (within 5 ms). The attitude waits for this
        message if an IMU message has been received in the last second; the list may therefore be empty. An earlier
        attitude or IMU message that has waited in vain is returned too.
        """
        self._boot = t = self._check_restart(_since_boot(m.time_boot_ms))
        samples: TimedSamples = [self._attitude_waits] if self._attitude_waits is not None else []
        self._attitude_waits = None
        ahrs = Ahrs(m.yaw, m.pitch, m.roll, m.rollspeed, m.pitchspeed, m.yawspeed)
        if self._imu is not None and abs(self._imu[0] - t) <= SAME_S:
            samples.append((_with_imu(ahrs, self._imu), t))
            self._imu = None
            return samples
        if self._imu is not None and self._imu[0] < t:  # its attitude was lost; emit it first, in the order of time
            samples.append((_with_imu(Ahrs(NAN, NAN, NAN), self._imu), self._imu[0]))
            self._imu = None
        if 0.0 <= t - self._imu_at <= IMU_AWAITED_S:
            self._attitude_waits = (ahrs, t)
        else:
            samples.append((ahrs, t))
        return samples

    def _raw_imu(self, m: Any) -> TimedSamples:
        """Return the `Ahrs` samples that a RAW_IMU message (specific force and magnetic field) completes.

        There are none unless the autopilot is ArduPilot, because the units of other autopilots are not defined.
        """
        return self._take_milli_imu(m, self._to_boot_time(m.time_usec)) if self._ardupilot else []

    def _scaled_imu(self, m: Any) -> TimedSamples:
        """Return the `Ahrs` samples that a SCALED_IMU message (specific force and magnetic field) completes."""
        return self._take_milli_imu(m, _since_boot(m.time_boot_ms))

    def _take_milli_imu(self, m: Any, t: float) -> TimedSamples:
        """Return the `Ahrs` samples that an IMU message with values in milli-g and milligauss completes.

        `t` is the time of the message [s since boot].
        """
        accel = tuple(1e-3 * GRAVITY * a for a in (m.xacc, m.yacc, m.zacc))
        return self._take_imu(t, accel, tuple(1e-7 * b for b in (m.xmag, m.ymag, m.zmag)))

    def _highres_imu(self, m: Any) -> TimedSamples:
        """Return the `Ahrs` samples that a HIGHRES_IMU message, in m/s2 and gauss, completes."""
        field = tuple(1e-4 * b for b in (m.xmag, m.ymag, m.zmag))
        return self._take_imu(self._to_boot_time(m.time_usec), (m.xacc, m.yacc, m.zacc), field)

    def _take_imu(self, t: float, accel: tuple[float, ...], field: tuple[float, ...]) -> TimedSamples:
        """Return the samples that specific force and magnetic field of an IMU message complete; each is an `Ahrs`.

        Force and field are joined with the attitude of the same moment (within 5 ms), and get the time of the attitude.
        Without such an attitude, force and field wait for it. `t` is the time [s since boot], `accel` the specific
        force [m/s2], and `field` the magnetic field [T]. A field of zero means that it is unknown, and becomes NaN. An
        earlier attitude or IMU message that has waited in vain is returned too.
        """
        self._imu_at = self._check_restart(t)
        imu = (t, accel, field if any(field) else (NAN, NAN, NAN))
        samples: TimedSamples = []
        if self._imu is not None:  # the previous IMU message got no attitude, so it becomes a separate sample
            samples.append((_with_imu(Ahrs(NAN, NAN, NAN), self._imu), self._imu[0]))
            self._imu = None
        waiting, self._attitude_waits = self._attitude_waits, None
        if waiting is not None and abs(waiting[1] - t) <= SAME_S:
            return [*samples, (_with_imu(waiting[0], imu), waiting[1])]
        self._imu = imu
        return samples if waiting is None else [*samples, waiting]

    def _gps_raw_int(self, m: Any) -> TimedSamples:
        """Return the fix of the autopilot's GNSS receiver (GPS_RAW_INT) as a `Gnss` sample.

        The list is empty for a message with the time and type of the newest fix. Without a fix, the time, the position
        and the velocity of the sample are NaN. The height is NaN unless the fix is three-dimensional or better. Without
        a course only the speed is known.
        """
        if (m.time_usec, m.fix_type) == self._fix:
            return []
        self._fix = m.time_usec, m.fix_type
        fix = FIXES.get(m.fix_type, 0)
        t = (
            self._to_boot_time(m.time_usec) if fix else NAN
        )  # without a fix ArduPilot repeats the last time, 0 before the first
        if self._ardupilot and m.time_usec < UNIX_US:  # ArduPilot sends whole milliseconds, multiplied by 1000
            t += HALF_MS
        course = math.radians(m.cog * 0.01) if m.cog != 0xFFFF else NAN
        speed = _untruncate_velocity(m.vel) if fix >= 2 and m.vel != 0xFFFF else NAN
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
                    # Autopilots forward hAcc of UBX, which is the error of both axes together.
                    sigma_h=m.h_acc * 1e-3 / math.sqrt(2.0) if fix and m.h_acc else NAN,
                    speed=speed,
                ),
                t,
            )
        ]

    def _global_position(self, m: Any) -> TimedSamples:
        """Return the autopilot's position estimate (GLOBAL_POSITION_INT) as a `Gnss` sample.

        The list is empty for a message with the time of the last one. If latitude and longitude are 0, the sample has
        only the UTC, without a fix. The fix is 3, or 0 if the flags of the estimator (EKF_STATUS_REPORT) report no
        absolute position.
        """
        t = self._check_restart(_since_boot(m.time_boot_ms))
        if m.time_boot_ms == self._fix[0]:
            return []
        self._fix = m.time_boot_ms, 0
        if m.lat == 0 and m.lon == 0:
            return [(Gnss(t + self._utc_of_boot, NAN, NAN), t)]
        north, east, down = (_untruncate_velocity(v) for v in (m.vx, m.vy, m.vz))
        # An estimator that has lost its position continues to send the last or a dead-reckoned position.
        is_valid = self._ekf_flags < 0 or (self._ekf_flags & EKF_POSITION and not self._ekf_flags & EKF_STANDS)
        kind = 3 if is_valid else 0
        fix = Gnss(t + self._utc_of_boot, m.lat * 1e-7, m.lon * 1e-7, m.alt * 1e-3, north, east, down, fix=kind)
        return [(fix, t)]

    def _servo_outputs(self, m: Any) -> TimedSamples:
        """Return a `Servo` sample (pulse width and command) for each servo output that drives a thruster of the rig.

        The pulse width is in us. The command, -1..1, is 0 without a pulse, and that of a reversed thruster changes its
        sign. If no thruster outputs are known (`outputs` is None), each output that had a pulse gives a sample with NaN
        as command. `m` is a message SERVO_OUTPUT_RAW.
        """
        t = self._to_boot_time(m.time_usec, wraps=True)
        samples: TimedSamples = []
        for k in range(1, 17):
            node, pwm = 16 * m.port + k, float(getattr(m, f"servo{k}_raw"))
            if self._outputs is None:
                self._seen |= {node} if pwm else set()
                if node in self._seen:
                    samples.append((Servo(node, pwm), t))
            elif node in self._outputs:
                n = self._outputs[node].applied(pwm) if pwm else 0.0  # without a pulse the thruster is stopped
                self._n[node] = -n if node in self._reversed else n
                samples.append((Servo(node, pwm, self._n[node] + 0.0), t))
        return samples

    def _esc_telemetry(self, m: Any) -> TimedSamples:
        """Return an `Esc` sample for each speed controller with new values in an ESC_TELEMETRY message.

        A controller has new values if its counter in the message has changed; a counter that is still 0 gives no
        sample. The rpm in the message has no sign; it gets the sign of the output's newest command (positive is
        forward, also for a reversed thruster), and stays positive if this is zero or unknown. The command becomes the
        duty. The samples have no time.
        """
        first = int(m.get_type().split("_")[2])
        samples: TimedSamples = []
        for k in range(4):
            node, count = first + k, m.count[k]
            if self._counts.get(node, 0) == count:
                continue  # the controller has no new values or does not exist
            self._counts[node] = count
            n = self._n.get(node, NAN)
            rpm = math.copysign(float(m.rpm[k]), n) if n else float(m.rpm[k])
            esc = Esc(node, rpm, m.current[k] * 0.01, n, m.voltage[k] * 0.01, float(m.temperature[k]))
            samples.append((esc, NAN))
        return samples

    def _esc_status(self, m: Any) -> TimedSamples:
        """Return an `Esc` sample for each speed controller in an ESC_STATUS message that exists.

        A controller exists if it has a voltage or belongs to a thruster of the rig. The rpm of a reversed thruster
        changes its sign. The newest command of the output becomes the duty, NaN without one. The temperature is NaN.
        """
        samples: TimedSamples = []
        for k in range(4):
            node = m.first + k + 1
            if m.voltage[k] == 0.0 and (self._outputs is None or node not in self._outputs):
                continue
            sign = -1.0 if node in self._reversed else 1.0
            esc = Esc(node, sign * m.rpm[k], m.current[k], self._n.get(node, NAN), m.voltage[k])
            samples.append((esc, self._to_boot_time(m.time_usec)))
        return samples

    def _battery(self, m: Any) -> TimedSamples:
        """Return a `Battery` sample, without a time, from a BATTERY_STATUS message.

        The voltage is the sum of the known cell voltages. The list is empty for any battery but the first (id 0), and
        for a message without a cell voltage.
        """
        cells = [v for v in (*m.voltages, *m.voltages_ext) if v not in (0, 0xFFFF)]
        if m.id != 0 or not cells:
            return []
        self._has_battery = True
        return [(_battery(sum(cells) * 1e-3, m.current_battery, m.battery_remaining), NAN)]

    def _sys_status(self, m: Any) -> TimedSamples:
        """Return a `Battery` sample, without a time, from a SYS_STATUS message.

        The list is empty if the voltage is unknown, and once a BATTERY_STATUS has given a sample, whose values are
        better.
        """
        if self._has_battery or m.voltage_battery in (0, 0xFFFF):
            return []
        return [(_battery(m.voltage_battery * 1e-3, m.current_battery, m.battery_remaining), NAN)]

    def _status_text(self, m: Any) -> TimedSamples:
        """Return a text message of the autopilot (STATUSTEXT) as an event "statustext" with the text "SEVERITY: TEXT".

        A long text arrives in parts of 50 characters. The list is empty until its last part has been received. A lost
        part is missing in the text; if the last part is lost, there is no event.
        """
        number, received = self._chunks
        chunk = printable(m.text)
        text = received + chunk if m.id and m.id == number and m.chunk_seq else chunk
        if m.id and len(m.text) == CHUNK:
            self._chunks = (m.id, text)
            return []
        self._chunks = (0, "")
        word = SEVERITIES[m.severity] if m.severity < len(SEVERITIES) else f"severity {m.severity}"
        return [(Event("statustext", f"{word}: {text}"), NAN)]


def _since_boot(ms: int) -> float:
    """Convert a time since boot of an autopilot in whole milliseconds to seconds.

    Half a millisecond is added, because the autopilot truncates the time.
    """
    return ms * 1e-3 + HALF_MS


def _untruncate_velocity(velocity: int) -> float:
    """Convert a velocity [cm/s] in a MAVLink message to m/s, without the bias of truncation.

    ArduPilot and PX4 truncate it towards zero to whole cm/s. Half a cm/s is therefore added to its magnitude. Zero
    remains zero.
    """
    return (velocity + math.copysign(0.5, velocity)) * 0.01 if velocity else 0.0


def _with_imu(ahrs: Ahrs, imu: tuple[float, tuple[float, ...], tuple[float, ...]]) -> Ahrs:
    """Return an attitude with the specific force [m/s2] and magnetic field [T] of an IMU message.

    `imu` is a tuple of time [s], specific force (3,) and magnetic field (3,).
    """
    (ax, ay, az), (mx, my, mz) = imu[1], imu[2]
    return replace(ahrs, ax=ax, ay=ay, az=az, mx=mx, my=my, mz=mz)


def _battery(voltage: float, centiampere: int, percent: int) -> Battery:
    """Return the state of a battery from its voltage [V], current [0.01 A] and remaining charge [%].

    A negative current or charge means that it is unknown, and becomes NaN.
    """
    return Battery(voltage, NAN if centiampere < 0 else centiampere * 0.01, NAN if percent < 0 else percent * 0.01)
