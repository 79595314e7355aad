"""Reader of logs into memory: signals, rig, mission, and the provenance for results.

The signals have the names that models use.

| name | source |
|---|---|
| psi, phi, theta | AHRS: yaw, roll and pitch, not unwrapped |
| p, q, r, ax, ay | AHRS: body rates, specific force |
| x, y, vx, vy | GNSS: metres north and east of the first fix (`share_frame`), velocity over ground |
| n_left, n_right | shaft speed over rpm_max of the rig, positive forward |
| n_cmd_left, n_cmd_right | commands; behind an autopilot its outputs |
| voltage_left, voltage_right | supply voltage of the speed controllers [V] |
| servo_1, servo_2, ... | pulse widths of an autopilot's outputs [us], if the log has no rig |
| force | load cell, with its offset |
| speed | speed along the track, from velocity over ground (imported speed_x and speed_y, or vx and vy) |
| other names | imported signals |

Some controllers report only the magnitude of the shaft speed, for example the ESC telemetry of an autopilot.
`shaft_speed` then takes the sign from the delayed and lagged command. `propulsion_input` chooses the signals that drive
a model.
"""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime, timedelta
from enum import StrEnum
from itertools import chain, count
from math import inf, nan
from pathlib import Path
from typing import Annotated, Any

import msgspec
import numpy as np
from msgspec import Meta
from numpy.typing import NDArray

from seatrial.daq.checks import Finding, unknown_times
from seatrial.daq.config import parse_toml
from seatrial.daq.errors import SeatrialError, counted, warn
from seatrial.daq.geometry import local_ned
from seatrial.daq.log import WHOLE as WHOLE
from seatrial.daq.log import Log, bag_of_ros, open_log
from seatrial.daq.log import TimeWindow as TimeWindow
from seatrial.daq.rig import Rig, Thruster
from seatrial.daq.samples import Ahrs, Command, Esc, Gnss, LoadCell, Scalar, Servo
from seatrial.ident.data.gaps import (
    SHORTEST_PIECE_S,
    clock_of,
    gap_line,
    is_held,
    parts_between,
    seconds,
    silent_times,
    slice_channel,
)
from seatrial.ident.data.outliers import sections_elsewhere, without_outliers
from seatrial.ident.data.record import Channel, LogSegment
from seatrial.ident.model import SignalId, command_of, shaft_speed_of
from seatrial.ident.numerics import Array, LagData, first_order_lag, fit_first_order_lag

Table = NDArray[np.void]  # of `Log.table`, shape (n,)
TRACK_WINDOW = 20.0  # s before and after, over which the direction of travel is averaged
GRID_STEP = 0.01  # s, of the grid on which the command of a shaft of unknown sign is filtered
DELAYS = tuple(np.arange(0.0, 1.01, 0.05).tolist())  # s, values of the coarse search
TIME_CONSTANTS = tuple(1.0 / (1.5 * 1.5**k) for k in range(9))  # s, of the coarse search, from 0.67 to 0.026
TIMES = re.compile(r"\[[\d.e+]+:[\d.e+inf]+\]\Z")  # at the end of the name of a part
MARGIN_S = 60.0  # read before and after a part of a log: the last value of each input, and the sample after the end
# Fine search around the best values: differences of the delay [s], and factors on the time constant.
NEAR_DELAYS = np.arange(-0.05, 0.051, 0.01)
NEAR_TIME_CONSTANTS = np.array([0.7, 0.8, 0.9, 1.0, 1.1, 1.25, 1.4])


class PropulsionInput(StrEnum):
    """Kind of the thruster signals of a log that drive a model of the boat, best first.

    ``MEASURED``: shaft speeds with their sign and the time of their measurement. ``TELEMETRY``: shaft speeds that an
    autopilot relays with an unknown delay and without a sign. ``COMMAND``: commands, because shaft speeds are missing,
    too rare, or held between their samples.
    """

    MEASURED = "measured"  # shaft speeds with their sign and the time of measurement
    TELEMETRY = "telemetry"  # shaft speeds relayed by an autopilot, with an unknown delay and without a sign
    COMMAND = "command"  # commands only: shaft speeds are missing or too rare


TimeWindows = TimeWindow | Sequence[TimeWindow]  # one interval for all logs, or one for each of them, in their order


def window_of_each(windows: TimeWindows, n: int) -> list[TimeWindow]:
    """Return a list with the interval of time of each of n logs: the same for all, or the given ones in their order.

    Raises
    ------
    ValueError
        If the number of given intervals is not n.
    """
    each = [windows] * n if isinstance(windows, TimeWindow) else list(windows)
    if len(each) != n:
        raise ValueError(
            f"there are {len(each)} intervals of time for {n} logs; give one for all logs, or one for each"
        )
    return each


DeviceChecks = Callable[[Log], Sequence[Finding]]
SHAFTS = shaft_speed_of("left"), shaft_speed_of("right")
COMMANDS = command_of("left"), command_of("right")
ORIGIN = "origin"  # key in `meta` of a segment: the `FrameOrigin` of its x and y, if known
SHARED_WITHIN = 10_000.0  # m between first fixes; beyond that distance a common local tangent plane is wrong
SLOWEST_TELEMETRY = 0.15  # s between shaft speeds; slower ones do not show when the thrust changes


def propulsion_input(log: Log, found: Mapping[str, Channel], holds: Mapping[str, str]) -> PropulsionInput | None:
    """Choose the thruster signals of a log that drive a model of the boat: shaft speeds or commands.

    Parameters
    ----------
    log
        An open log. Its rig file shows whether an autopilot drives the thrusters.
    found
        Signals of the log by name.
    holds
        Hold of each signal by name: ``zero``, ``average``, ``linear``, or empty.

    Returns
    -------
    PropulsionInput or None
        None if the log has neither shaft speeds nor commands of both thrusters left and right. ``COMMAND`` if it has no
        shaft speeds of both, if one of these has the hold ``zero`` or is a sampled output (`Channel.sampled`), or if
        the log also has both commands and a median interval of the shaft speeds exceeds `SLOWEST_TELEMETRY` (0.15 s).
        Otherwise ``TELEMETRY`` behind an autopilot (a thruster of the rig names its output), else ``MEASURED``.

    Notes
    -----
    A shaft speed that is held between its samples, or is a sampled output of an autopilot, is treated as a command,
    since a real shaft speed cannot jump.
    """
    if not all(n in found for n in SHAFTS):
        return PropulsionInput.COMMAND if all(n in found for n in COMMANDS) else None
    if any(found[n].sampled or holds.get(n) == "zero" for n in SHAFTS):
        return PropulsionInput.COMMAND
    if all(n in found for n in COMMANDS) and max(np.median(np.diff(found[n].t)) for n in SHAFTS) > SLOWEST_TELEMETRY:
        return PropulsionInput.COMMAND
    by_autopilot = any(t.output is not None for t in (log.rig.thrusters if log.rig else ()))
    return PropulsionInput.TELEMETRY if by_autopilot else PropulsionInput.MEASURED


def channels(log: Log) -> dict[str, Channel]:
    """Return all signals of a log by the names that models use, without outliers.

    Parameters
    ----------
    log
        An open log.

    Returns
    -------
    dict
        The signals with at least two samples, by name: ``psi``, ``r``, ``ax``, ... of an AHRS, ``x``, ``y``, ``vx``,
        ``vy`` of a GNSS receiver, ``n_NAME``, ``n_cmd_NAME`` and ``voltage_NAME`` of a thruster, ``servo_N`` of an
        autopilot's output if the log has no rig file, ``force`` of a load cell, ``speed`` along the track, and imported
        signals by their own names. Times are in s since 1970.

    Notes
    -----
    The table at the top of this module has all names. An imported signal takes precedence over an AHRS, a receiver or a
    load cell with the same signal. A thruster of the rig takes precedence over an imported signal. Of several devices
    of a kind, the first one is used for each signal; of several AHRS and load cells even for a signal of which the
    first one has no samples, and which is then left out.
    """
    found: dict[str, Channel] = {}
    for source in log.sources(Scalar):
        table = log.table(Scalar, source)
        channel = _channel_of_column(table, "value", log.unit(source), source)
        if log.role(source) == "input" and log.hold(source) != "sampled":
            channel = replace(channel, hold=log.hold(source))
        found[source] = _resample_output(channel) if log.hold(source) == "sampled" else channel
    rig = log.rig
    for source in log.sources(Ahrs):
        table = log.table(Ahrs, source)
        for name, column, unit in (
            ("psi", "yaw", "rad"),
            ("phi", "roll", "rad"),
            ("theta", "pitch", "rad"),
            ("p", "p", "rad/s"),
            ("q", "q", "rad/s"),
            ("r", "r", "rad/s"),
            ("ax", "ax", "m/s2"),
            ("ay", "ay", "m/s2"),
        ):
            found.setdefault(name, _channel_of_column(table, column, unit, source))
    for source in log.sources(Gnss):
        found = _gnss_channels(log.table(Gnss, source), source) | found
    for thruster in rig.thrusters if rig else ():
        _add_thruster(log, thruster, found)
    if rig is None:
        for source in log.sources(Servo):
            for node in log.nodes(Servo, source):
                channel = _channel_of_column(log.table(Servo, source, node), "pwm", "us", source)
                found.setdefault(str(SignalId(str(node), "servo")), channel)
    for source in log.sources(LoadCell):
        found.setdefault(
            "force", _channel_of_column(_without_error_flags(log.table(LoadCell, source)), "force", "N", source)
        )
    found = without_outliers({name: c for name, c in found.items() if c.t.size > 1})
    for pair in (("speed_x", "speed_y"), ("vx", "vy")):
        if "speed" not in found and all(n in found for n in pair):
            x, y = (found[n] for n in pair)
            if np.array_equal(x.t, y.t):
                found["speed"] = Channel(x.t, along_track(x.t, x.value, y.value), x.unit, x.source)
    return found


def ahrs_channels(table: Table, source: str) -> dict[str, Channel]:
    """Return the signals of all axes that an AHRS reported, with their outliers.

    Parameters
    ----------
    table
        Samples of the AHRS (n,), as `Log.table` returns them.
    source
        Name of the device, which is stored in the channels.

    Returns
    -------
    dict
        Signals by name: ``psi``, ``theta``, ``phi`` [rad], ``p``, ``q``, ``r`` [rad/s], ``ax``, ``ay``, ``az`` [m/s2].
        A signal with fewer than two finite samples is left out.
    """
    names = {"yaw": "psi", "pitch": "theta", "roll": "phi"}
    rows = (("rad", ("yaw", "pitch", "roll")), ("rad/s", ("p", "q", "r")), ("m/s2", ("ax", "ay", "az")))
    found = {names.get(c, c): _channel_of_column(table, c, unit, source) for unit, columns in rows for c in columns}
    return {name: c for name, c in found.items() if c.t.size > 1}


def _rows_with_position(table: Table) -> Table:
    """Return the samples of a GNSS receiver (``table``, (n,)) that have a fix and a position.

    Samples without a fix (``fix`` below 2), without a latitude, or with latitude and longitude zero are left out. A
    receiver without a fix may report such zeros as valid.
    """
    somewhere = (table["lat"] != 0.0) | (table["lon"] != 0.0)
    good: Table = table[(table["fix"] >= 2) & np.isfinite(table["lat"]) & somewhere]
    return good


def _origin_row(table: Table) -> int:
    """Return the index of the fix that is the origin of x and y: the first one after the receiver has settled.

    ``table`` (n,) has the fixes of the receiver, at least one. The origin is the first fix that is not in a short
    section at another place (`sections_elsewhere`); the index is 0 if all are.
    """
    x, y = local_ned(table["lat"], table["lon"])
    return int(np.argmin(sections_elsewhere(table["t"], x, y, np.ones(x.size, bool))))


def _gnss_channels(table: Table, source: str) -> dict[str, Channel]:
    """Return the signals of a GNSS receiver by name; {} if it never had a fix.

    ``table`` (n,) has its samples, and ``source`` is the name of the device. The signals are ``x``, ``y`` [m] north and
    east of the first fix (`_origin_row`), and ``vx``, ``vy`` [m/s] if the receiver reports them. If it reports no
    velocity to the north, its speed over ground is the signal ``speed`` [m/s].
    """
    table = _rows_with_position(table)
    if not len(table):
        return {}
    origin = _origin_row(table)
    lat, lon = (np.append(table[c][origin], table[c]) for c in ("lat", "lon"))
    x, y = (axis[1:] for axis in local_ned(lat, lon))
    t = np.ascontiguousarray(table["t"])
    found = {"x": Channel(t, x, "m", source), "y": Channel(t, y, "m", source)}
    for name, column in (("vx", "vel_n"), ("vy", "vel_e")):
        if np.isfinite(table[column]).any():
            found[name] = _channel_of_column(table, column, "m/s", source)
    if "vx" not in found and np.isfinite(table["speed"]).any():
        found["speed"] = _channel_of_column(table, "speed", "m/s", source)
    return found


def _add_thruster(log: Log, thruster: Thruster, found: dict[str, Channel]) -> None:
    """Add shaft speed, voltage and command of a thruster to the signals ``found``, in place.

    The names are ``n_NAME``, ``voltage_NAME`` and ``n_cmd_NAME``, with the name of the thruster in the rig file. The
    shaft speed is divided by the ``rpm_max`` of the rig file, and is left out without it or with fewer than two
    samples. If the log has the output of the autopilot, and the shaft speed always has the sign of the present command
    (`follows_command`), this sign is not measured, and `shaft_speed` restores it. In all other cases the sign is kept.
    The command is the output of the autopilot if the log has it, otherwise the logged command. A signal of the same
    name in ``found`` is replaced. Signals that the log does not contain are not added.
    """
    device, node = thruster.device, thruster.node
    shaft = None
    if node in log.nodes(Esc, device):
        state = log.table(Esc, device, node=node)
        shaft = _channel_of_column(state, "rpm", "", device)
        if node in log.nodes(Servo, device) and follows_command(state["rpm"], state["duty"]):
            # The telemetry has the sign of the present command, but a real shaft follows its command late.
            output = _channel_of_column(log.table(Servo, device, node=node), "n", "", device)
            t, rpm = shaft_speed(shaft.t, shaft.value, output.t, output.value)
            shaft = Channel(t, rpm, "", device, "average")
        found[str(SignalId(thruster.name, "voltage"))] = _channel_of_column(state, "voltage", "V", device)
    if shaft is not None and shaft.t.size > 1 and np.isfinite(thruster.rpm_max):
        found[shaft_speed_of(thruster.name)] = replace(shaft, value=shaft.value / thruster.rpm_max)
    if node in log.nodes(Servo, device):
        # The output of the autopilot is the command of the thruster. Our command reaches the output with a delay.
        output = _channel_of_column(log.table(Servo, device, node=node), "n", "", device)
        found[command_of(thruster.name)] = _resample_output(output)
    elif node in log.nodes(Command, device):
        found[command_of(thruster.name)] = _channel_of_column(
            log.table(Command, device, node=node), "n_cmd", "", device
        )


def _resample_output(output: Channel) -> Channel:
    """Resample an output of an autopilot to a grid of times `GRID_STEP` (0.01 s) apart, by linear interpolation.

    Gaps longer than 60 s stay empty. Each value is that of the straight line in the middle of its step. A sampled
    output changed at an unknown time since the sample before. The straight line is the mean of all such changes. The
    result has the hold ``average`` and the original median sample interval in `Channel.sampled`.
    """
    clock = clock_of(output.t, GRID_STEP)
    mean = np.interp(clock + GRID_STEP / 2, output.t, output.value) if output.t.size else output.value
    interval = float(np.median(np.diff(output.t))) if output.t.size > 1 else 0.0
    return replace(output, t=clock, value=mean, hold="average", sampled=interval)


def _channel_of_column(table: Table, column: str, unit: str, source: str) -> Channel:
    """Return one column of a device's samples as a channel, without the samples in which it is NaN or infinite.

    Parameters
    ----------
    table
        Samples of a device (n,), with the times ``t`` [s since 1970].
    column
        Name of the column.
    unit, source
        Unit of the values and name of the device, which are stored in the channel.
    """
    good = np.isfinite(table[column])
    t, value = table["t"][good], table[column][good]
    return Channel(np.ascontiguousarray(t, float), np.ascontiguousarray(value, float), unit, source)


def _without_error_flags(table: Table) -> Table:
    """Return the samples of a load cell (``table``, (n,)) without an error flag (``flags`` 0), in their order."""
    good: Table = table[table["flags"] == 0]
    return good


def along_track(t: Array, vx: Array, vy: Array) -> Array:
    """Return the speed along the direction of travel, with its sign.

    Parameters
    ----------
    t
        Times (n,) [s], increasing.
    vx, vy
        Velocity over ground to the north and east (n,) [m/s].

    Returns
    -------
    Array (n,)
        Component of the velocity [m/s] along the direction of travel. Negative if the boat moves against this
        direction. Zero where the mean velocity is zero.

    Notes
    -----
    The direction of travel at a time is that of the mean of the velocities from `TRACK_WINDOW` (20 s) before to 20 s
    after, weighted by speed. The heading is not used. Motion astern therefore has a negative speed only if motion ahead
    dominates the mean. If the boat only moves astern in these 40 s, its speed is positive. A boat that drifts at rest
    before a run gets the direction of the run. The magnitude of the velocity would turn drift and noise into forward
    speed.
    """
    speed = np.hypot(vx, vy)
    a, b = np.searchsorted(t, t - TRACK_WINDOW), np.searchsorted(t, t + TRACK_WINDOW, side="right")
    sums = [np.append(0.0, np.cumsum(speed * v)) for v in (vx, vy)]
    dx, dy = (s[b] - s[a] for s in sums)
    length = np.hypot(dx, dy)
    return np.asarray(np.divide(vx * dx + vy * dy, length, out=np.zeros_like(speed), where=length > 0))


def follows_command(rpm: Array, n: Array) -> bool:
    """Return whether reported shaft speeds always have the sign of the present command.

    A real shaft reverses later than its command. Shaft speeds that always have its sign are magnitudes to which the
    controller added the sign of the command.

    Parameters
    ----------
    rpm
        Reported shaft speeds (k,). Zeros and NaN are ignored.
    n
        Commands at the same times (k,). Zeros and NaN are ignored.

    Returns
    -------
    bool
        False also for commands of one sign only, which show no reversal.
    """
    both = (rpm != 0) & (n != 0) & np.isfinite(rpm) & np.isfinite(n)
    signs = np.sign(n[both])
    return bool(np.any(np.diff(signs)) and np.all(np.sign(rpm[both]) == signs))


def shaft_speed(t: Array, speed: Array, t_command: Array, command: Array) -> tuple[Array, Array]:
    """Restore the sign of a shaft speed of which only the magnitude is known, from the command of the thruster.

    Parameters
    ----------
    t
        Times of the telemetry (k,) [s], at least one.
    speed
        Shaft speed (k,), of which only the magnitude is used.
    t_command
        Times of the commands (m,) [s].
    command
        Commands (m,), at least one, each held until the next one.

    Returns
    -------
    t : Array (n,)
        Times [s], `GRID_STEP` (0.01 s) apart, except in gaps longer than a minute, from the first time of the telemetry
        (half a step earlier) to the last.
    speed : Array (n,)
        Shaft speed with its sign, each value held until the next one, in the unit of the telemetry.

    Notes
    -----
    The result is the response of the command through the delay (0 to about 1 s) and first-order lag (time constant up
    to about 1 s) that fit the magnitude best, plus the residuals, smoothed over three samples and interpolated.
    Interpolation of slow telemetry alone would smooth each step.
    """
    speed = np.abs(speed)
    clock = clock_of(t, GRID_STEP, before=DELAYS[-1])
    held = command[np.maximum(np.searchsorted(t_command, clock, side="right") - 1, 0)]

    def scale(size: Array) -> float:
        """Return the factor on ``size`` (k,) that fits the magnitudes of the shaft speed best (least squares).

        It is 0 if ``size`` is zero.
        """
        return float(size @ speed) / max(float(size @ size), 1e-12)

    def misfit(lagged: Array, delay: float) -> float:
        """Return the sum of squared errors of the shaft speed against the lagged command, later by ``delay`` [s].

        Magnitudes are compared, and the command is multiplied by its best factor.
        """
        size = np.abs(np.interp(t - delay, clock, lagged))
        return float(np.sum((speed - scale(size) * size) ** 2))

    delays, time_constants = np.array(DELAYS), np.array(TIME_CONSTANTS)
    for near in (1.0, 0.2, 0.0):  # width of the next search around the best values
        best = fit_first_order_lag(
            [LagData(held, misfit)], delays.tolist(), time_constants.tolist(), GRID_STEP, hold="backward"
        )
        delays, time_constants = best.delay + near * NEAR_DELAYS, best.time_constant * NEAR_TIME_CONSTANTS**near
    delay, lagged = 0.0, held
    if np.isfinite(best.misfit):
        delay, lagged = best.delay, first_order_lag(held, best.time_constant, GRID_STEP, hold="backward")
    response = np.interp(t - delay, clock, lagged)
    gain = scale(np.abs(response))
    residuals = np.copysign(speed, response) - gain * response
    smooth = np.convolve(np.pad(residuals, 1, mode="edge"), np.full(3, 1 / 3), mode="valid")
    own = clock[clock >= t[0]]
    return own - GRID_STEP / 2, gain * np.interp(own - delay, clock, lagged) + np.interp(own, t, smooth)


class FrameOrigin(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Origin of the NED frame of a log, where x = y = 0.

    Attributes
    ----------
    latitude, longitude : float
        Position of the origin [deg].
    log : str
        Name of the log whose first fix is the origin. Empty if no log is named.
    """

    latitude: Annotated[float, Meta(description="[deg]")]
    longitude: Annotated[float, Meta(description="[deg]")]
    log: Annotated[str, Meta(description="name of the log whose first fix is the origin")] = ""

    def offset(self, other: FrameOrigin) -> tuple[float, float]:
        """Return the distances north and east [m] from this origin to the origin ``other``, on the ellipsoid.

        The radii of the ellipsoid are those half way between both origins.
        """
        east = (other.longitude - self.longitude + 180.0) % 360.0 - 180.0
        middle = (0.5 * (self.latitude + other.latitude), self.longitude + 0.5 * east)
        lat, lon = zip(middle, *((o.latitude, o.longitude) for o in (self, other)), strict=True)
        x, y = local_ned(np.array(lat), np.array(lon))
        return float(x[2] - x[1]), float(y[2] - y[1])


@dataclass(frozen=True)
class LoadedLog:
    """Log in memory: its signals, and its description for reports.

    Attributes
    ----------
    run : LogSegment
        The signals, with times [s] from the first sample of the log.
    about : dict
        Description for results: path, hash, role, name, duration [s], rig, mission, warnings; origin if it is known.
    holds : Mapping
        Hold of each signal by name; empty text if it is unknown.
    rig : Rig or None
        Rig file of the log. None if it has none, as an imported log.
    propulsion : PropulsionInput or None
        Kind of the thruster signals that drive a model. None without signals of both thrusters.
    segments : tuple
        Start [s, from the first sample of the log] and name of each step of the mission.
    vehicle : Mapping
        Parameters of the boat by name, from the rig file or the import map.
    device_faults : tuple of Finding or None
        Findings of the checks of the devices. None if the devices were not checked. Empty for all parts of a log that
        was cut except the first.
    origin : FrameOrigin or None
        Origin of x and y. None without latitude and longitude.
    shift : tuple of float
        Distance north and east [m] from the origin to the log's own first fix.
    unknown : tuple
        Start and end [s] of each interval of time in which an input has no value.
    zero : float
        Time of the first sample of the log [s since 1970], from which all other times count. NaN if it is unknown.
    rpm_max : Mapping
        Shaft speed [rev/min] at which a relative shaft speed is 1, by the name of the signal, as far as it is known.
    """

    run: LogSegment
    about: dict[str, Any]
    holds: Mapping[str, str]
    rig: Rig | None
    propulsion: PropulsionInput | None = None
    segments: tuple[tuple[float, str], ...] = ()
    vehicle: Mapping[str, float] = field(default_factory=dict)
    device_faults: tuple[Finding, ...] | None = None
    origin: FrameOrigin | None = None
    shift: tuple[float, float] = (0.0, 0.0)
    unknown: tuple[tuple[float, float], ...] = ()
    zero: float = nan
    rpm_max: Mapping[str, float] = field(default_factory=dict)

    @property
    def own_channels(self) -> Mapping[str, Channel]:
        """Signals of the log by name, with x and y relative to the log's own first fix instead of `origin`.

        If the log was not moved (`shift` is zero), they are the signals of `run` themselves.
        """
        return _shift_positions(self.run.channels, -self.shift[0], -self.shift[1])

    @property
    def unplaced(self) -> bool:
        """Whether the log has positions x, y of which the origin (latitude and longitude) is unknown.

        False for a log without positions.
        """
        return self.origin is None and "x" in self.run.channels

    def hull(self, mass: float | None = None) -> dict[str, float]:
        """Return what the user knows of the boat, for the checks of a fit.

        These are ``length`` [m], weighed ``mass`` [kg] and ``ahead``, the thrust of one thruster ahead without that
        astern [N]. They are from the rig file or import map, if they have them. ``mass`` replaces that of the log.
        SeatrialError is raised if the mass is not positive.
        """
        known = {n: self.vehicle[n] for n in ("length", "mass", "ahead") if n in self.vehicle}
        known |= {} if mass is None else {"mass": mass}
        if not known.get("mass", 1.0) > 0.0:
            raise SeatrialError(f"mass = {known['mass']:g} kg: the weighed mass must be positive; correct it")
        return known


def _shift_positions(found: Mapping[str, Channel], north: float, east: float) -> Mapping[str, Channel]:
    """Return the signals ``found`` with ``north`` [m] added to x and ``east`` [m] added to y.

    If both are zero, return the same object. Otherwise return a copy of the mapping. Without x and y, as in a part of a
    log with fewer than two fixes, its signals are unchanged.
    """
    if not (north or east):
        return found
    by = {"x": north, "y": east}
    return {n: replace(c, value=c.value + by[n]) if n in by else c for n, c in found.items()}


def share_frame(logs: Sequence[LoadedLog], reference: FrameOrigin | None = None) -> list[LoadedLog]:
    """Move x and y of all logs to one origin.

    An object that is fixed over ground, for example a mooring, then has the same x and y in all logs.

    Parameters
    ----------
    logs
        The logs.
    reference
        The origin. None: the origin of the first log that has latitude and longitude.

    Returns
    -------
    list
        The logs in the same order. A log keeps its own origin if this is farther than `SHARED_WITHIN` (10 km) from the
        reference. It is unchanged if its own origin is unknown, or if all origins are.

    Notes
    -----
    Each log is moved as a whole, so that its motion is unchanged except for rounding.
    """
    reference = reference or next((log.origin for log in logs if log.origin is not None), None)
    return [log if log.origin is None or reference is None else _move_to_origin(log, reference) for log in logs]


def _move_to_origin(log: LoadedLog, reference: FrameOrigin) -> LoadedLog:
    """Return the log with x and y relative to the origin ``reference``. Its own origin must be known.

    A log whose origin is farther than `SHARED_WITHIN` (10 km) from the reference is returned unchanged.
    """
    assert log.origin is not None
    north, east = reference.offset(log.origin)
    if np.hypot(north, east) > SHARED_WITHIN:
        return log
    run = replace(log.run, channels=_shift_positions(log.run.channels, north, east))
    return _with_origin(replace(log, run=run, shift=(log.shift[0] + north, log.shift[1] + east)), reference)


def _with_origin(log: LoadedLog, origin: FrameOrigin) -> LoadedLog:
    """Return the log with ``origin`` noted as the origin of its x and y. The positions are not changed.

    The origin is also stored in the ``meta`` of its signals and in its ``about``, for records and results.
    """
    run = replace(log.run, meta={**log.run.meta, ORIGIN: origin})
    return replace(log, origin=origin, run=run, about=log.about | {ORIGIN: msgspec.structs.asdict(origin)})


def far_apart(origins: Sequence[object]) -> bool:
    """Return whether several logs have different origins of x and y (`FrameOrigin`).

    Unknown origins (None) are ignored. Origins with different names of their logs differ even at the same place.
    """
    return len({o for o in origins if o is not None}) > 1


def load_all(
    logs: Sequence[Path],
    validate: Sequence[Path],
    window: TimeWindows = WHOLE,
    device_faults: DeviceChecks | None = None,
) -> tuple[list[LoadedLog], list[LoadedLog]]:
    """Load estimation and validation data, cut at gaps, with unique names and with x and y from one origin.

    Parameters
    ----------
    logs
        Files or folders of the estimation logs.
    validate
        Files or folders of the validation logs.
    window
        Interval of time of the estimation logs to use: one for all, or one for each. Validation logs are used as a
        whole.
    device_faults
        Function that returns the findings on the devices of an open log. None: the devices are not checked.

    Returns
    -------
    estimation, validation : list
        The logs, each as its parts between gaps (`usable_parts`), with unique names.

    Raises
    ------
    SeatrialError
        If a log is in both lists, is given twice with the same interval of time, or cannot be used.
    ValueError
        If the number of intervals of time is neither one for all nor that of the logs.
    """
    same = {p.resolve() for p in logs} & {p.resolve() for p in validate}
    if same:
        name = sorted(same)[0].name
        raise SeatrialError(
            f"{name}: this log is given for the fit and for the validation, which would prove nothing; give another "
            "log to --validate"
        )
    windows = window_of_each(window, len(logs))
    for files, own in ((logs, windows), (validate, [WHOLE] * len(validate))):
        used = [(path.resolve(), window) for path, window in zip(files, own, strict=True)]
        if twice := [path.name for k, (path, window) in enumerate(used) if (path, window) in used[:k]]:
            raise SeatrialError(f"{twice[0]}: this log is given twice, and its samples would count twice; give it once")
    estimation = [
        (p, part)
        for p, own in zip(logs, windows, strict=True)
        for part in usable_parts(load_run(p, "estimation", own, device_faults))
    ]
    validation = [(p, part) for p in validate for part in usable_parts(load_run(p, "validation", WHOLE, device_faults))]
    files = [p for p, _ in (*estimation, *validation)]
    named = share_frame(with_unique_names([part for _, part in (*estimation, *validation)], files))
    return named[: len(estimation)], named[len(estimation) :]


def usable_parts(log: LoadedLog) -> list[LoadedLog]:
    """Cut a log into the parts in which at least one sensor has samples and all inputs are known.

    Parameters
    ----------
    log
        The log. It is cut at long times without a sample of any sensor (`silent_times`), and at times in which an input
        has no value.

    Returns
    -------
    list
        The parts in order of time, each as a separate log. A log without such times is returned unchanged. Parts
        shorter than `SHORTEST_PIECE_S` (10 s) are left out.

    Raises
    ------
    SeatrialError
        If all parts are too short. Also if, in one part between two gaps of the sensors, all segments with known inputs
        are too short.

    Notes
    -----
    A warning states the times without sensors. Times of unknown inputs must be cut out: a fit that held the last value
    would use a wrong thrust.
    """
    return [piece for part in parts_with_sensors(log) for piece in _parts_with_inputs(part)]


def parts_with_sensors(log: LoadedLog) -> list[LoadedLog]:
    """Cut a log only at long times without a sample of any sensor, as the first step of `usable_parts`.

    Parameters
    ----------
    log
        The log.

    Returns
    -------
    list
        The parts in order of time, each as a separate log; parts shorter than `SHORTEST_PIECE_S` (10 s) are left out.
        Only the first of them has the findings on the devices; the others have (). A log without such times is returned
        unchanged.

    Raises
    ------
    SeatrialError
        If all parts are too short.

    Warns
    -----
    SeatrialWarning
        If the log was cut. The warning has the times of the longest gap. It also has the number of gaps if there are
        several, and the number of parts that were left out, if any.
    """
    gaps = silent_times(log.run.channels)
    if not gaps:
        return [log]
    edges = [-inf, *(t for gap in gaps for t in gap), inf]
    found, n_short = list[LoadedLog](), 0
    for begin, end, signals in zip(edges[::2], edges[1::2], parts_between(log.run.channels, gaps), strict=True):
        a = max(begin, log.run.t_from or 0.0, min((float(c.t[0]) for c in signals.values()), default=0.0))
        last = max((float(c.t[-1]) for c in signals.values()), default=-inf)
        b = min(end, inf if log.run.t_to is None else log.run.t_to, last)
        if b - a < SHORTEST_PIECE_S:
            n_short += 1
            continue
        # Without these limits a record begins and ends where all signals are known.
        t_from = log.run.t_from if log.run.t_from is not None and log.run.t_from > begin else None
        t_to = log.run.t_to if log.run.t_to is not None and log.run.t_to < end else None
        unknown = tuple((max(x, a), min(y, b)) for x, y in log.unknown if x < b and y > a)
        found.append(_named_part(log, replace(log.run, channels=signals, t_from=t_from, t_to=t_to), (a, b), unknown))
    path, short = log.about["path"], counted(n_short, "part") + f" shorter than {SHORTEST_PIECE_S:g} s"
    if not found:
        raise SeatrialError(
            f"{path}: no segment of the log between two gaps is as long as {SHORTEST_PIECE_S:g} s, so none can be "
            f"used; check the sensors with `seatrial check {path}` ({gap_line(gaps)})"
        )
    omitted = f"; {short} {'is' if n_short == 1 else 'are'} left out" if n_short else ""
    warn(f"{path}: {gap_line(gaps)}{omitted}")
    # The findings on the devices belong to the whole log. They are reported once, with the first part.
    return [replace(part, device_faults=log.device_faults if k == 0 else ()) for k, part in enumerate(found)]


def _parts_with_inputs(log: LoadedLog) -> list[LoadedLog]:
    """Cut a log at times in which an input is unknown, and leave out parts shorter than `SHORTEST_PIECE_S` (10 s).

    A log without such times is returned unchanged. If a signal has samples at or before the start of a part, the last
    of them is its first sample in the part, because the value of a command still holds then. A signal is left out of a
    part if it has fewer than two samples, this one included. Only the first part has the findings on the devices; the
    others have ().

    Raises
    ------
    SeatrialError
        If all parts are too short.
    """
    if not log.unknown:
        return [log]
    first = min(float(c.t[0]) for c in log.run.channels.values()) if log.run.t_from is None else log.run.t_from
    last = max(float(c.t[-1]) for c in log.run.channels.values()) if log.run.t_to is None else log.run.t_to
    edges = [first, *(t for gap in log.unknown for t in gap), last]
    spans = [(a, b) for a, b in zip(edges[::2], edges[1::2], strict=True) if b - a >= SHORTEST_PIECE_S]
    if not spans:
        raise SeatrialError(
            f"{log.about['path']}: no segment of the log in which all inputs are known is as long as "
            f'{SHORTEST_PIECE_S:g} s; record without gaps in the inputs, or give another column or nan = "zero" for '
            "them in the import map"
        )
    found = []
    for k, (a, b) in enumerate(spans):
        parts = {name: part for name, c in log.run.channels.items() if (part := _samples_within(c, a, b)).t.size > 1}
        piece = _named_part(log, replace(log.run, channels=parts, t_from=a, t_to=b), (a, b), ())
        found.append(replace(piece, device_faults=log.device_faults if k == 0 else ()))
    return found


def _named_part(
    log: LoadedLog, run: LogSegment, span: tuple[float, float], unknown: tuple[tuple[float, float], ...]
) -> LoadedLog:
    """Return a part of a log, with its times [s] at the end of its name and path, for example ``run[0:60]``.

    The ``about`` of the part has this name and path, and the duration of the part.

    Parameters
    ----------
    log
        The log. Times at the end of its name and path are replaced.
    run
        Signals of the part.
    span
        Start and end of the part [s].
    unknown
        Start and end [s] of each interval of time in the part in which an input has no value.
    """
    a, b = span
    file, name = (TIMES.sub("", str(log.about[key])) for key in ("path", "name"))
    times = f"[{seconds(a)}:{seconds(b)}]"
    about = log.about | {"path": f"{file}{times}", "name": f"{name}{times}", "duration": b - a}
    if log.about.get("start"):
        begin = datetime.fromisoformat(log.about["start"]) + timedelta(seconds=a - (log.run.t_from or 0.0))
        about["start"] = begin.isoformat(timespec="seconds")
    return replace(log, run=replace(run, name=f"{name}{times}"), about=about, unknown=unknown)


def _samples_within(channel: Channel, begin: float, end: float) -> Channel:
    """Return a signal from ``begin`` to ``end`` [s], both included, and its last sample at or before ``begin``.

    The value of a command before ``begin`` still holds then.
    """
    a = max(int(np.searchsorted(channel.t, begin, side="right")) - 1, 0)
    b = int(np.searchsorted(channel.t, end, side="right"))
    return slice_channel(channel, a, b)


def load_runs(
    logs: Sequence[Path],
    role: str,
    window: TimeWindows = WHOLE,
    reference: FrameOrigin | None = None,
    device_faults: DeviceChecks | None = None,
    *,
    cut: bool = True,
) -> list[LoadedLog]:
    """Load several logs of one role, with unique names, and with x and y from one origin.

    Parameters
    ----------
    logs
        Files or folders of the logs.
    role
        ``estimation`` or ``validation``, for reports.
    window
        Interval of time of the logs to load: one for all, or one for each.
    reference
        Origin of x and y. None: the origin of the first log that has latitude and longitude.
    device_faults
        Function that returns the findings on the devices of an open log. None: the devices are not checked.
    cut
        Whether to cut the logs at their gaps (`usable_parts`). The result then has one entry per part.

    Raises
    ------
    SeatrialError
        If a log cannot be used.
    ValueError
        If the number of intervals of time is neither one for all nor that of the logs.
    """
    windows = window_of_each(window, len(logs))
    whole = [(p, load_run(p, role, own, device_faults)) for p, own in zip(logs, windows, strict=True)]
    loaded = [(p, part) for p, log in whole for part in (usable_parts(log) if cut else [log])]
    return share_frame(with_unique_names([log for _, log in loaded], [p for p, _ in loaded]), reference)


def with_unique_names(loaded: Sequence[LoadedLog], files: Sequence[Path]) -> list[LoadedLog]:
    """Return the logs with unique names and paths, in the same order.

    Parameters
    ----------
    loaded
        The logs.
    files
        Their files, in the same order.

    Returns
    -------
    list
        Logs of the same name get the name of their folder before their own (``mon/run``). If the names are still equal,
        the first of them stays so, and the next ones get a number (``mon/run (2)``). Other logs keep their names. A log
        whose own first fix is its origin gets the new name in the origin too.

    Notes
    -----
    Runs are compared, paired and shown by name, so that two runs of the same name would be confused.
    """
    names = _unique_labels([log.run.name for log in loaded], files)
    paths = _unique_labels([log.about["path"] for log in loaded], files)
    named = (
        replace(log, run=replace(log.run, name=name), about=log.about | {"name": name, "path": path})
        for log, name, path in zip(loaded, names, paths, strict=True)
    )
    return [
        log
        if log.origin is None or log.origin.log != before.run.name
        else _with_origin(log, msgspec.structs.replace(log.origin, log=log.run.name))
        for log, before in zip(named, loaded, strict=True)
    ]


def _unique_labels(labels: Sequence[str], files: Sequence[Path]) -> list[str]:
    """Return unique ``labels`` (names or paths) of files, in the same order.

    A label that occurs several times gets the name of the file's folder before it. If it is still not unique, the first
    one stays so, and the next ones get a number from 2 on: ``mon/run (2)``. Other labels are unchanged, unless an
    earlier one is equal after its change.
    """
    found: list[str] = []
    for label, file in zip(labels, files, strict=True):
        name = f"{file.resolve().parent.name}/{label}" if labels.count(label) > 1 else label
        numbered = (f"{name} ({k})" for k in count(2))
        found.append(next(candidate for candidate in chain([name], numbered) if candidate not in found))
    return found


def within_window(channels: Mapping[str, Channel], begin: float, end: float) -> dict[str, Channel]:
    """Cut signals to the interval of time from ``begin`` to ``end`` [s], both included.

    The last value of a held input before the interval is its first sample, at ``begin``. A signal with fewer than two
    samples is left out.
    """
    found: dict[str, Channel] = {}
    for name, c in channels.items():
        a, b = int(np.searchsorted(c.t, begin)), int(np.searchsorted(c.t, end, side="right"))
        cut = slice_channel(c, a, b)
        if a and is_held(name, c) and not (cut.t.size and cut.t[0] == begin):
            cut = replace(cut, t=np.append(begin, cut.t), value=np.append(c.value[a - 1], cut.value))
        if cut.t.size > 1:
            found[name] = cut
    return found


def load_run(path: Path, role: str, window: TimeWindow = WHOLE, device_faults: DeviceChecks | None = None) -> LoadedLog:
    """Load a log, or an interval of its time, into memory.

    Parameters
    ----------
    path
        File or folder of the log.
    role
        ``estimation`` or ``validation``, for reports.
    window
        Interval of time of the log to load. The messages of the rest are not read (except its first minute, and one
        minute on both sides). The signals contain the minute on both sides. ``about["sha256"]`` is the hash of the
        whole file, and ``about["path"]`` ends with the interval.
    device_faults
        Function that returns the findings on the devices of an open log, or of its window. None: the devices are not
        checked.

    Returns
    -------
    LoadedLog
        Times count from the first sample of the whole log [s].

    Raises
    ------
    SeatrialError
        If the file is not a log, has no signal for an identification, ends before the window, or has no sample in it.
    """
    with open_log(path) as whole:
        log, start = whole, None
        if window != WHOLE:
            head = channels(whole.part(0.0, whole.start + MARGIN_S))
            start = min((c.t[0] for c in head.values()), default=whole.start)
            if start + window.t_from >= whole.end:
                begin = f"no data are left from {window.t_from:g} s on"
                raise SeatrialError(f"{path}: is {whole.end - start:.0f} s long, so {begin}; choose an earlier start")
            log = whole.part(start + window.t_from - MARGIN_S, start + window.t_to + MARGIN_S)
        with log.keeping_tables():
            found = channels(log)
            origin = _origin_of_positions(log, found, path.stem)
            unknown = _unknown_inputs(log)
            # Of a window only its own findings count: a gap in the minute on either side is no reason to warn.
            checked = log if start is None else whole.part(start + window.t_from, start + window.t_to)
            faults = tuple(device_faults(checked)) if device_faults is not None and found else None
        if not found and (bag := bag_of_ros(path)) is not None:
            raise SeatrialError(
                f"{path} is a bag of ROS 2; import it first with `seatrial import --guess {shlex.quote(str(bag))}`"
            )
        if not found:
            raise SeatrialError(
                f"{path}: has no signal that an identification can use; list its signals with `seatrial info {path}`"
            )
        start = min(c.t[0] for c in found.values()) if start is None else start
        ends = start + window.t_from, start + window.t_to
        if not any(((c.t >= ends[0]) & (c.t <= ends[1])).any() for c in found.values()):
            raise SeatrialError(
                f"{path}: there is no sample from {window.t_from:g} s to {window.t_to:g} s; choose a longer window"
            )
        moved = {n: replace(c, t=c.t - start) for n, c in found.items()}
        last = float(max(c.t[-1] for c in moved.values()))
        about = {
            "path": path.name if window == WHOLE else f"{path.name}[{window.t_from:g}:{window.t_to:g}]",
            "sha256": log.sha256,  # of the whole file, also of a part: a later comparison recognises the log by it
            "role": role,
            "name": path.stem,
            "start": datetime.fromtimestamp(start + window.t_from, UTC).isoformat(timespec="seconds"),
            "duration": log.duration if window == WHOLE else min(window.t_to, last) - window.t_from,
            "rig": log.rig.name if log.rig else None,
            "mission": _mission_name(log),
            "warnings": list(log.warnings),
        }
        holds = {n: c.hold or _hold_in_log(log, n) for n, c in found.items()}
        full_speeds = _full_speeds(log)
        segments = tuple((t - start, text) for t, kind, text in log.events() if kind == "segment")
        propulsion = propulsion_input(log, moved, holds)
        t_to = min(window.t_to, last) if window.t_to < inf else None
        run = LogSegment(path.stem, moved, window.t_from or None, t_to)
        gaps = tuple((float(a - start), float(b - start)) for a, b in unknown)
        loaded = LoadedLog(
            run,
            about,
            holds,
            log.rig,
            propulsion,
            segments,
            log.vehicle,
            faults,
            unknown=gaps,
            zero=float(start),
            rpm_max=full_speeds,
        )
        return loaded if origin is None else _with_origin(loaded, origin)


def _full_speeds(log: Log) -> dict[str, float]:
    """Return the shaft speeds [rev/min] at which relative shaft speeds are 1, by the name of the signal.

    They are those of the rig file, or of imported signals whose map scales a column in a unit of shaft speeds.
    """
    imported = {source: rpm for source in log.sources(Scalar) if (rpm := log.rpm_max(source)) is not None}
    thrusters = log.rig.thrusters if log.rig else ()
    return imported | {shaft_speed_of(t.name): t.rpm_max for t in thrusters if np.isfinite(t.rpm_max)}


def _unknown_inputs(log: Log) -> list[tuple[float, float]]:
    """Return the intervals of time in which an imported input has no value, as (start, end) [s since 1970].

    They are in order of time, and overlapping intervals are joined.
    """
    found: list[tuple[float, float]] = []
    for source in log.sources(Scalar):
        if log.role(source) == "input":
            table = log.table(Scalar, source)
            found += unknown_times(table["t"], table["value"])
    joined: list[tuple[float, float]] = []
    for a, b in sorted(found):
        if joined and a <= joined[-1][1]:
            joined[-1] = joined[-1][0], max(joined[-1][1], b)
        else:
            joined.append((a, b))
    return joined


def _origin_of_positions(log: Log, found: Mapping[str, Channel], name: str) -> FrameOrigin | None:
    """Return the origin of x and y if they were measured as latitude and longitude; else None.

    With a GNSS receiver of the log, the origin is the first fix after the receiver has settled. Imported positions have
    the origin that the import stored, if it made both from latitude and longitude. ``found`` has the signals of the log
    by name, and ``name`` is the name of the log, which is stored in the origin.
    """
    if "x" not in found or "y" not in found:
        return None
    if found["x"].source not in log.sources(Gnss):
        return _imported_origin(log, found, name)
    table = _rows_with_position(log.table(Gnss, found["x"].source))
    first = table[_origin_row(table)]
    return FrameOrigin(float(first["lat"]), float(first["lon"]), name)


def _imported_origin(log: Log, found: Mapping[str, Channel], name: str) -> FrameOrigin | None:
    """Return the origin of imported x and y; None if it is unknown, or if the two have different origins."""
    sources = [found[n].source for n in ("x", "y")]
    if not set(sources) <= set(log.sources(Scalar)):
        return None
    origins = {log.position_origin(source) for source in sources}
    place = origins.pop()
    return None if place is None or origins else FrameOrigin(*place, name)


def _hold_in_log(log: Log, name: str) -> str:
    """Return the hold that the log states for the imported signal ``name``: ``zero``, ``linear`` or ``sampled``.

    It is ``linear`` if the log states none. The text is empty for a signal that was not imported.
    """
    try:
        return str(log.hold(name))
    except (KeyError, SeatrialError):
        return ""


def _mission_name(log: Log) -> str | None:
    """Return the name of the mission in the log; None if the log has no readable mission, or one without a name."""
    text = log.attachments.get("mission.toml")
    if text is None:
        return None
    try:  # parse only the lines before the first table: the samples of a long mission take seconds to parse
        name = parse_toml(text.partition(b"\n[")[0].decode(), "mission.toml").values.get("name")
    except (SeatrialError, UnicodeDecodeError):
        return None
    return None if name is None else str(name)
