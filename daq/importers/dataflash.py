"""Reader of ArduPilot's DataFlash logs (BIN), through pymavlink's DFReader.

Names and units of the messages: ardupilot.org/rover/docs/logmessages.html. TimeUS is the time since boot at which a
loop of the autopilot wrote the message. DFReader converts it to UTC by the first GPS week of the log. A fix arrived up
to one loop earlier; GPA.SMS has its arrival in whole milliseconds, and the sample gets this time. A loop writes ATT
before IMU, so an attitude is joined with the IMU message nearest in time.
"""

from __future__ import annotations

import contextlib
import io
import math
import os
import struct
import tempfile
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from seatrial.daq.errors import SeatrialError, counted, warn
from seatrial.daq.importers.damage import is_chain
from seatrial.daq.importers.write_log import Timed
from seatrial.daq.protocol import FIXES, HALF_MS, mode_name
from seatrial.daq.rig import Device, Rig
from seatrial.daq.samples import NAN, Ahrs, Autopilot, Battery, Esc, Event, Frame, Gnss, Sample, Servo, wrap_angle

Found = list[Sample]
OLDEST_FIX_S = 1.0  # s between a fix and its message; a larger difference is an error, not an age
# MAV_TYPE by the first word of a text message
FIRMWARE = {"ArduRover": 10, "ArduSub": 12, "ArduCopter": 2, "ArduPlane": 1, "Blimp": 7, "AntennaTracker": 5}
HEAD = b"\xa3\x95"  # first bytes of each message; the type of the message follows
FMT, FMT_SIZE = 0x80, 89  # type and size [bytes] of the messages that define the other types
TIME_OFF_US = 1_000_000  # us from the median of the neighbouring times; a larger difference is a damaged time
NO_TYPE = 0  # MAV_TYPE of an unknown vehicle, whose modes have no names


class _MessageConverter:
    """Converter of the messages of an ArduPilot DataFlash log to samples, with one method for each type of message.

    `joined` completes the samples after the whole log has been read. If no shaft speed of the log is negative, the
    speeds are magnitudes, and each gets the sign of the command of its output, if this is known and not zero. Otherwise
    those of the reversed thrusters of the rig change their sign, as in MAVLink.

    Attributes
    ----------
    vehicle : int
        MAV_TYPE of the vehicle, `NO_TYPE` (0) if unknown. The caller sets it before the first message.
    take : dict
        Method for each type of message: it takes a message of DFReader and returns the list of samples in it.
    parameters : dict
        Parameters of the autopilot so far, by name.
    is_signed : bool
        Whether the shaft speeds so far have a sign: one of them is negative.
    """

    def __init__(self, rig: Rig | None, device: Device | None) -> None:
        """Prepare the conversion for the autopilot `device` of `rig`; both may be None.

        The thrusters of the device select and scale the outputs. The command of a reversed thruster changes its sign.
        Without a rig, or if no thruster of the device has an output, outputs are pulse widths only.
        """
        self.vehicle = NO_TYPE  # MAV_TYPE
        thrusters = [t for t in rig.thrusters if device is not None and t.device == device.name] if rig else []
        self._outputs = {t.node: (t.output, -1.0 if t.reversed else 1.0) for t in thrusters if t.output is not None}
        self._reversed = {t.node for t in thrusters if t.reversed}
        self._imu: list[tuple[float, ...]] = []  # time [s], angular rates [rad/s] and specific forces [m/s2]
        self._ages: dict[float, float] = {}  # time of the message of a fix -> s since the fix arrived
        self._seen: set[int] = set()  # outputs that have had a pulse
        self._n: dict[int, float] = {}  # last command of each output, -1 to 1
        self.is_signed = False
        self.take: dict[str, Callable[[Any], Found]] = {
            "IMU": self._on_imu, "ATT": self._on_att, "GPS": self._on_gps, "RCOU": self._on_rcou, "ESC": self._on_esc,
            "BAT": self._on_bat, "MSG": self._on_msg, "MODE": self._on_mode, "ARM": self._on_arm,
            "EV": self._on_ev, "ERR": self._on_err,
            "PARM": self._on_parm, "GPA": self._on_gpa,
        }  # fmt: skip
        self.parameters: dict[str, float] = {}
        self._pilot = Autopilot(0, 0, 3)

    def _on_imu(self, m: Any) -> Found:
        """Store time, angular rates and specific forces of a DataFlash IMU message, if it is of the first IMU.

        Return no sample. After the whole log has been read, `joined` adds the stored values to the attitudes.
        """
        if getattr(m, "I", 0) == 0:
            self._imu.append((m._timestamp, m.GyrX, m.GyrY, m.GyrZ, m.AccX, m.AccY, m.AccZ))
        return []

    def _on_gpa(self, m: Any) -> Found:
        """Store the age [s] of a fix from a DataFlash GPA message of the first receiver: time of message minus arrival.

        Half a millisecond is subtracted, because the arrival is truncated to whole milliseconds; the result is at least
        0. An age that is negative before this, or 1 s or more, is ignored. Return no sample. After the whole log has
        been read, `joined` sets the fix back by its age.
        """
        age = getattr(m, "TimeUS", NAN) * 1e-6 - getattr(m, "SMS", NAN) * 1e-3
        if getattr(m, "I", 0) == 0 and 0.0 <= age < OLDEST_FIX_S:
            self._ages[m._timestamp] = max(age - HALF_MS, 0.0)
        return []

    def joined(self, rows: list[Timed]) -> Iterator[Timed]:
        """Complete the samples of a DataFlash log after the whole log has been read, and yield them in order.

        An attitude gets rates and specific forces of the IMU message nearest in time, if the log has IMU messages. If
        no shaft speed of the log is negative, each gets the sign of the command of its output; it stays as it is if the
        command is zero or unknown. If one is negative, those of reversed thrusters change their sign. The age of a fix
        is subtracted from its estimated time and from its device time, so that they are those of its arrival. Other
        samples are unchanged.
        """
        times = np.array([row[0] for row in self._imu])
        middle = (times[1:] + times[:-1]) / 2
        for row in rows:
            sample, t_rx, t_device = row.frame
            if isinstance(sample, Ahrs) and self._imu:
                imu = self._imu[int(np.searchsorted(middle, row.t))][1:]
                sample = Ahrs(sample.yaw, sample.pitch, sample.roll, *imu)
            if isinstance(sample, Esc) and self.is_signed:
                sample = replace(sample, rpm=-sample.rpm) if sample.node in self._reversed else sample
            elif isinstance(sample, Esc) and abs(sample.duty) > 0.0:  # a magnitude without sign
                sample = replace(sample, rpm=math.copysign(sample.rpm, sample.duty))
            age = self._ages.get(row.t, 0.0) if isinstance(sample, Gnss) else 0.0
            yield Timed(Frame(sample, t_rx, t_device - age), row.t - age)

    def _on_att(self, m: Any) -> Found:
        """Convert a DataFlash ATT message to an AHRS sample with the attitude [rad].

        Rates, specific forces and magnetic field are NaN; `joined` adds rates and specific forces later.
        """
        yaw, pitch, roll = (math.radians(angle) for angle in (m.Yaw, m.Pitch, m.Roll))
        return [Ahrs(wrap_angle(yaw), pitch, roll, *[NAN] * 6)]

    def _on_gps(self, m: Any) -> Found:
        """Convert a DataFlash GPS message of the first receiver to a GNSS sample; no sample for other receivers.

        Values that its kind of fix does not determine are NaN: the position without a fix, the velocity below a 2D fix.
        """
        if getattr(m, "I", 0) != 0:
            return []
        fix, course = FIXES.get(m.Status, 0), math.radians(m.GCrs)
        known, moving = fix > 0, fix >= 2
        return [
            Gnss(
                utc=m._timestamp,
                lat=m.Lat if known else NAN,
                lon=m.Lng if known else NAN,
                alt=m.Alt if known else NAN,
                vel_n=m.Spd * math.cos(course) if moving else NAN,
                vel_e=m.Spd * math.sin(course) if moving else NAN,
                vel_d=m.VZ if moving else NAN,
                fix=fix,
                n_sat=m.NSats,
                hdop=m.HDop,
                speed=m.Spd if moving else NAN,
            )
        ]

    def _on_rcou(self, m: Any) -> Found:
        """Convert a DataFlash RCOU message to Servo samples with the pulse width [us], one for each output in use.

        Of the outputs 1 to 14, those that drive thrusters of the rig are in use. Their samples also have the command
        (-1 to 1) by the scale of the rig: 0 without a pulse, and with the opposite sign for a reversed thruster. If no
        thruster of the rig has an output of this autopilot, or without a rig, the outputs that have had a pulse in the
        log so far are in use, and their samples have no command (NaN).
        """
        found: Found = []
        for node in range(1, 15):
            pwm = float(getattr(m, f"C{node}", 0))
            if self._outputs and node in self._outputs:
                output, sign = self._outputs[node]
                self._n[node] = sign * output.applied(pwm) + 0.0 if pwm else 0.0
                found.append(Servo(node, pwm, self._n[node]))
            elif not self._outputs and (pwm or node in self._seen):
                self._seen.add(node)
                found.append(Servo(node, pwm))
        return found

    def _on_esc(self, m: Any) -> Found:
        """Convert a DataFlash ESC message to a sample of a motor controller: speed, current, voltage, temperature.

        The sample also has the last command of the output with the same number, NaN without one. The number of the
        controller is the instance in the message plus 1. Store whether a speed was negative.
        """
        node = m.Instance + 1
        self.is_signed = self.is_signed or m.RPM < 0.0
        return [Esc(node, m.RPM, m.Curr, self._n.get(node, NAN), m.Volt, m.Temp)]

    def _on_bat(self, m: Any) -> Found:
        """Convert a DataFlash BAT message to voltage, current and charge (0 to 1, NaN if unknown) of the first battery.

        The percentage in the message is divided by 100. Messages of other batteries give no sample.
        """
        if getattr(m, "Inst", getattr(m, "I", 0)) != 0:
            return []
        return [Battery(m.Volt, m.Curr, getattr(m, "RemPct", NAN) * 0.01)]

    def _on_msg(self, m: Any) -> Found:
        """Convert a DataFlash MSG message, a text of the autopilot, to an event of the kind "statustext"."""
        return [Event("statustext", str(m.Message))]

    def _on_mode(self, m: Any) -> Found:
        """Convert a DataFlash MODE message to the autopilot's state with the new mode, and an event with its name.

        The mode is the field ModeNum, or Mode in older logs. Whether the autopilot is armed stays as before.
        """
        self._pilot = replace(self._pilot, mode=m.ModeNum if hasattr(m, "ModeNum") else int(m.Mode))
        return [self._pilot, Event("autopilot", mode_name(self._pilot.mode, self.vehicle))]

    def _on_arm(self, m: Any) -> Found:
        """Convert a DataFlash ARM message to the state of the autopilot after arming or disarming, and an event.

        The state (MAV_STATE) is 4, active, if armed, and 3, standby, if not. The mode stays that of the last MODE
        message.
        """
        self._pilot = replace(self._pilot, armed=int(bool(m.ArmState)), state=3 + bool(m.ArmState))
        return [self._pilot, Event("autopilot", "armed" if self._pilot.armed else "disarmed")]

    def _on_ev(self, m: Any) -> Found:
        """Convert a DataFlash EV message to an event with the number of ArduPilot's event (LogEvent)."""
        return [Event("autopilot", f"event {m.Id} (LogEvent)")]

    def _on_err(self, m: Any) -> Found:
        """Convert a DataFlash ERR message to an event with error code and number of the autopilot's subsystem.

        The code and the subsystem are written as numbers.
        """
        return [Event("autopilot", f"error {m.ECode} of subsystem {m.Subsys} (LogErrorSubsystem)")]

    def _on_parm(self, m: Any) -> Found:
        """Store a parameter of the autopilot from a DataFlash PARM message, by its name. Return no sample.

        A later value of the same parameter replaces the earlier one.
        """
        self.parameters[str(m.Name)] = float(m.Value)
        return []


def read_dataflash(path: Path, rig: Rig | None, device: Device | None) -> tuple[list[Timed], str, dict[str, float]]:
    """Read the samples in a DataFlash log (BIN), which ArduPilot writes. Warn about damaged or unknown messages.

    Parameters
    ----------
    path
        The log.
    rig
        The rig, which selects and scales the outputs; None to read all outputs with pulses, as pulse widths.
    device
        The autopilot of the rig; None without a rig.

    Returns
    -------
    tuple
        The samples in the order of the file, each with its time in UTC [s since 1970] by the first GPS week in the log
        (without one, [s] since boot); a summary in one line; and the parameters of the autopilot by name.

    Raises
    ------
    SeatrialError
        If the log cannot be read or contains no samples. Damaged messages are left out. If the reader still fails at
        some place, with samples before it, the log is read up to this place with a warning.
    """
    reader = _MessageConverter(rig, device)
    rows: list[Timed] = []
    n_messages, skipped, stopped = 0, 0, ""
    n_torn, n_wrong_times, n_taken_out = 0, 0, 0
    strange: Counter[str] = Counter()
    try:
        raw = path.read_bytes()
        whole, n_torn, n_wrong_times = whole_messages(raw)
        n_taken_out = 0 if whole is None else len(raw) - len(whole)
        del raw
        with _file_of_whole_messages(path, whole) as readable, _opened_log(readable) as log:
            reader.vehicle = _vehicle_of_log(log)
            skipped = log.data_len - sum(len(log.offsets[kind]) * form.len for kind, form in log.formats.items())
            while (message := log.recv_match(type=list(reader.take))) is not None:
                n_messages += 1
                kind, stopped = message.get_type(), f"damaged, read only to byte {log.offset} of {log.data_len}"
                try:
                    t = float(message._timestamp)
                    t_device = float(getattr(message, "TimeUS", math.nan)) * 1e-6
                    rows += [Timed(Frame(sample, t, t_device), t) for sample in reader.take[kind](message)]
                except Exception:  # another firmware: a field is missing, or is text instead of a number
                    strange[kind] += 1
            stopped = ""
    except Exception as error:  # a damaged file can raise any error in DFReader
        if not rows:
            raise SeatrialError(
                f"{path}: is not a readable DataFlash log ({error}); give the original .BIN file"
            ) from error
    if not rows:
        raise SeatrialError(
            f"{path}: this DataFlash log contains no attitude, GPS or outputs; set LOG_BITMASK so that it includes "
            "them, and record again"
        )
    remarks = [
        f"{counted(n, 'message')} {kind} of unknown form (another firmware) left out" for kind, n in strange.items()
    ]
    remarks += [f"{counted(n_torn, 'damaged place')}: the messages there are left out"] * bool(n_torn)
    remarks += [f"{counted(n_wrong_times, 'message')} with an impossible time left out"] * bool(n_wrong_times)
    remarks += [stopped] * bool(stopped)
    for remark in remarks:
        advice = "if these data matter, copy the file from the autopilot again, or export them to CSV"
        warn(f"{path}: {remark}; {advice}")
    if reader.is_signed and rig is None:
        warn(
            f"{path}: the shaft speeds have a sign, and without a rig reversed thrusters are unknown: their speeds "
            "are positive astern; import with the rig file"
        )
    n_unread = max(skipped, 0) + n_taken_out
    read = [counted(n_messages, "message"), f"{counted(n_unread, 'byte')} not understood", *remarks]
    return list(reader.joined(rows)), ", ".join(read), reader.parameters


def whole_messages(raw: bytes) -> tuple[bytes | None, int, int]:
    """Remove damaged messages from the bytes of a DataFlash log.

    A message is complete if the first bytes of another message, or the end of the file, or at most 2 bytes, follow it.
    Bytes after a damaged place are skipped up to the next three complete messages in a row, or up to complete messages
    that end the log. A complete message is removed too if its time (TimeUS) is more than 1 s from the median of the
    five times around it; fewer than five times in a log are not checked. For times that rise, this median is the time
    itself. A log that is only cut off at its end is not damaged.

    Parameters
    ----------
    raw
        The bytes of the log.

    Returns
    -------
    tuple
        The remaining bytes, None if nothing is removed; the number of damaged places; the number of messages removed
        for their time.
    """
    sizes = {FMT: FMT_SIZE}  # bytes of a message by its type
    timed: set[int] = set()  # types whose first field is TimeUS

    def end_of(place: int) -> int:
        """Return the end [bytes] of the DataFlash message at offset `place`; -1 if no known type begins there.

        The result is also -1 if the message would end behind the end of the log.
        """
        if raw[place : place + 2] != HEAD or place + 3 > len(raw):
            return -1
        size = sizes.get(raw[place + 2], -1)
        return -1 if size < 3 or place + size > len(raw) else place + size

    found: list[tuple[int, int]] = []  # place and end of each complete message
    place, n_torn = 0, 0
    while place < len(raw):
        end = end_of(place)
        # The type of the next message may be defined later, so only its first bytes are checked.
        if end > 0 and (end == len(raw) or raw[end : end + 2] == HEAD or len(raw) - end < 3):
            if raw[place + 2] == FMT:
                kind, size = raw[place + 3], raw[place + 4]
                sizes[kind] = size if kind != FMT else FMT_SIZE
                if raw[place + 9 : place + 10] == b"Q" and raw[place + 25 : place + 31] == b"TimeUS":
                    timed.add(kind)
            found.append((place, end))
            place = end
            continue
        begin, place = place, raw.find(HEAD, place + 1)
        while place >= 0 and not is_chain(place, len(raw), end_of):
            place = raw.find(HEAD, place + 1)
        if place < 0:  # the log is cut off here, or the rest is an unused part of the last page
            if end > 0:
                found.append((begin, end))
            break
        n_torn += 1
    places = [k for k, (begin, _) in enumerate(found) if raw[begin + 2] in timed]
    times = np.array([struct.unpack_from("<Q", raw, found[k][0] + 3)[0] for k in places], np.float64)
    wrong: set[int] = set()
    if len(times) >= 5:
        around = np.lib.stride_tricks.sliding_window_view(np.pad(times, 2, mode="edge"), 5)
        off = np.abs(times - np.median(around, axis=1)) > TIME_OFF_US
        wrong = {places[k] for k in np.flatnonzero(off)}
    if not n_torn and not wrong:
        return None, 0, 0
    kept = b"".join(raw[begin:end] for k, (begin, end) in enumerate(found) if k not in wrong)
    return kept, n_torn, len(wrong)


@contextlib.contextmanager
def _file_of_whole_messages(path: Path, whole: bytes | None) -> Iterator[Path]:
    """Yield the file to read: a temporary file with the bytes `whole`, or the log itself if `whole` is None.

    `whole` are the bytes of the log without its damaged messages. The temporary file is deleted at the end.
    """
    if whole is None:
        yield path
        return
    with tempfile.TemporaryDirectory() as folder:
        repaired = Path(folder) / "whole.BIN"
        repaired.write_bytes(whole)
        yield repaired


def firmware_type(texts: Iterable[str]) -> int | None:
    """Return the MAV_TYPE (type of vehicle) of ArduPilot's firmware, by the messages of an autopilot; None if unknown.

    The first text that begins with the name of a firmware, in the same case, counts. For example "ArduRover V4.7.0"
    gives 10.
    """
    return next((number for text in texts for name, number in FIRMWARE.items() if text.startswith(name)), None)


def _vehicle_of_log(log: Any) -> int:
    """Return the MAV_TYPE (type of vehicle) by the text messages (MSG) of a DataFlash log, `NO_TYPE` (0) if unknown.

    `log` is pymavlink's reader. It is read to the end and then rewound to the beginning.
    """
    texts = (str(getattr(message, "Message", "")) for message in iter(lambda: log.recv_match(type="MSG"), None))
    found = firmware_type(texts)
    log.rewind()
    return NO_TYPE if found is None else found


@contextlib.contextmanager
def _opened_log(path: Path) -> Iterator[Any]:
    """Yield pymavlink's reader of a DataFlash log, and close its file at the end of the `with` block.

    What Python code prints in the block is discarded. What C code writes to standard error is discarded only while the
    log is opened. The reader may raise any error for a damaged file.
    """
    from pymavlink import DFReader

    # The reader prints the contents of a damaged file, also from C code, and never closes the file. Creating and
    # initialising it in two steps gives access to the open file if the initialisation fails.

    log = DFReader.DFReader_binary.__new__(DFReader.DFReader_binary)
    try:
        with contextlib.redirect_stdout(io.StringIO()), contextlib.redirect_stderr(io.StringIO()):
            with _without_error_output():
                log.__init__(str(path))
            yield log
    finally:
        for name in ("data_map", "filehandle"):
            if (part := getattr(log, name, None)) is not None:
                with contextlib.suppress(BufferError):  # a traceback may still refer to the memory map
                    part.close()


@contextlib.contextmanager
def _without_error_output() -> Iterator[None]:
    """Discard what a `with` block writes to standard error, also from C code, which writes to the file descriptor."""
    before = os.dup(2)
    try:
        with open(os.devnull, "wb") as nowhere:
            os.dup2(nowhere.fileno(), 2)
        yield
    finally:
        os.dup2(before, 2)
        os.close(before)
