"""Safety guard: a pure state machine that decides which set-points may be sent and when a run has to end.

Theory of operation
-------------------
Inputs are the run time and a `Status`: the newest samples, the commands as last sent, the ports and the links. The
output is a `Decision`: the set-points that are allowed, or a `Stop` with its code and reason. The guard reads no clock,
opens no port and drives nothing, so a recorded log can be replayed through it.

======== ========================================= =====================================================
state    set-points that are allowed               leaves to
======== ========================================= =====================================================
WAITING  none                                      RUNNING by `start`; STOPPED, at a stop
RUNNING  within n_max                              STOPPED, at the first stop
STOPPED  none                                      no state: thrust starts only with a new run
======== ========================================= =====================================================

A limit needs a source: a device that reports the limited quantity, and whose values change when the thrust changes. The
caller of `start` has to wait until every limit has a source. If a limit has no source in a check, or loses it, the run
ends. The geofence is a circle around the start; the boat must be able to stop inside it. The outputs of autopilots and
the reports of speed controllers are compared with the commands, so that zero thrust is a measurement.

Two further protections work without the guard. The acquisition process commands zero if the runner sends no heartbeat.
Every ESC stops by its own time-out if the acquisition process sends no command.
"""

from __future__ import annotations

import enum
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from seatrial.bench.execution.link_test import NEUTRAL
from seatrial.daq.acquisition import NO_STATUS_S, Source, Status, count_senders
from seatrial.daq.drivers import LinkStatus
from seatrial.daq.errors import SafetyStop, counted
from seatrial.daq.rig import LOAD_CELLS, Rig, Thruster
from seatrial.daq.samples import NAN, Ahrs, Battery, Esc, Gnss, LoadCell, Sample, Servo

Row = tuple[float, Mapping[str, float]]  # run time, n_cmd by thruster
SATURATED, SPIKE = 1, 2  # LoadCell.flags
# How long a device may be silent: STALE_PERIODS of its `rate_hz`, within these bounds.
STALE_PERIODS = 5.0
STALE_S = 1.0  # run seconds, at least
STALE_MAX_S = 5.0  # run seconds, at most
# Wall seconds, at least. With real devices this is the same second as STALE_S. With mocks at 20 run seconds per wall
# second, one run second is 50 ms, and a busy machine alone makes longer pauses.
STALE_WALL_S = 1.0
STUCK_WALL_S = 3.0  # wall seconds within which the file of the log must grow; it is flushed every 0.25 s
# A limited quantity may be missing for this multiple of the patience with its device. The factor is above 1, so that a
# pulled plug is reported as a silent device. SLOW is for position, temperature, voltage and charge, which are sent less
# often.
QUICK, SLOW = 1.5, 3.0
LIMIT_MAX_S = 6.0  # run seconds for which a limited quantity may be missing, at most
REST_PART = 0.05  # fraction of limits.force_n; a larger force at rest is named in the reason of a stop
RATE_RATIO = 3.0  # largest ratio of measured rate and `rate_hz`; beyond it the patience does not fit the device
EARTH_RADIUS_M = 6_371_008.8  # IUGG mean radius
STOPPED = 0.05  # m/s; a boat slower than this drifts and does not coast
REACTION_S = 0.1  # s from the fix to zero thrust
# Speed [m/s] and distance [m] of a possible movement between two fixes. A fix beyond them needs a second one.
JUMP_SPEED, JUMP_M = 15.0, 20.0
LINK_AGE_S = 3.0  # wall seconds without a heartbeat; an autopilot sends one every second
COLDEST_C = -40.0  # deg C; a lower reading means that the temperature sensor is missing or broken

# Movement: a value that must change when the commanded thrust changes.
CHANGE = 0.3  # smallest change of a command after which the value must change
FROZEN_S, FROZEN_SAMPLES = 2.0, 5  # run seconds, and samples, for which the value may stay the same after that change
# A position must change after IMPULSE_S run seconds of full thrust ahead (at least AT_REST_S after its last change), or
# after TRAVEL_M metres by the reported speed.
IMPULSE_S, AT_REST_S, TRAVEL_M = 3.0, 5.0, 5.0

# Outputs of autopilots against commands. Run seconds at the speed of the wall clock.
TOLERANCE, WINDOW_S = 0.05, 0.25  # an output may differ by TOLERANCE from the commands of the last WINDOW_S
LASTS_S = 0.1  # a longer deviation ends the run; with the delays of the link, thrust is then zero within 0.5 s

# Speed controllers against commands.
DUTY_TOLERANCE, DUTY_WINDOW_S, DUTY_LASTS_S = 0.1, 1.0, 0.3  # wider, as controllers ramp and report with a delay
FREE_DUTY = 0.05  # a motor with a smaller duty is not driven
COAST_S, FALLING = 3.0, 0.92  # in COAST_S s the speed of a coasting propeller falls below this fraction
# Largest speed of a motor at rest: fraction of rpm_max, and bounds of this speed in rev/min
IDLE_PART, IDLE_RPM_MIN, IDLE_RPM_MAX = 0.07, 30.0, 300.0
IDLE_CURRENT = 0.05  # fraction of the largest current so far; a motor with less is not driven
SENSED_A = 1.0  # A; a controller that has reported more is known to measure its current
BLOCKED_N, BLOCKED_RPM = 0.3, 10.0  # a motor that turns more slowly at such a command is blocked

TELEMETRY = "telemetry"  # word in limits.unwatched: speed controllers are not compared with their commands
MANUAL = "MANUAL"
CUT_POWER = "cut its power before you approach, then check its settings"
RIVAL = (
    "another ground station has the same system id as seatrial (own_system_id in the rig), so the autopilot would not "
    "notice that seatrial is lost; end that station, or change one of the two ids"
)


class GuardState(enum.StrEnum):
    """State of the safety guard of a run.

    Attributes
    ----------
    WAITING
        The run has not started. No set-point is allowed.
    RUNNING
        Set-points within `limits.n_max` of the rig are allowed.
    STOPPED
        There was a reason to end the run. No set-point is allowed any more.
    """

    WAITING = "waiting"
    RUNNING = "running"
    STOPPED = "stopped"


class StopCode(enum.StrEnum):
    """Code of the reason that ends a run. It is written to the log with the reason.

    Attributes
    ----------
    ACQUISITION
        The acquisition process ended thrust by itself, or does not answer.
    LOG
        The file of the log does not grow.
    PORT_LOST
        The port of a device was closed.
    SILENT
        A device, or the controller or output of a thruster, sends nothing.
    LIMIT
        A limited quantity is beyond its limit.
    FENCE
        The boat is outside the geofence, or cannot stop inside it.
    UNWATCHED
        No device reports the quantity of a limit any more, or its value is frozen.
    LINK
        An autopilot is silent, disarmed, in another mode than MANUAL, or reports an alarm.
    RIVAL
        Another ground station has our MAVLink system id.
    PARAMETER
        A parameter of an autopilot was changed.
    OUTPUT
        A thruster is not driven as commanded.
    SETPOINT
        A set-point is not allowed.
    """

    ACQUISITION = "acquisition"
    LOG = "log"
    PORT_LOST = "port-lost"
    SILENT = "silent"
    LIMIT = "limit"
    FENCE = "fence"
    UNWATCHED = "unwatched"
    LINK = "link"
    RIVAL = "rival"
    PARAMETER = "parameter"
    OUTPUT = "output"
    SETPOINT = "set-point"


class Stop(NamedTuple):
    """Decision of the safety guard to end a run.

    Attributes
    ----------
    code : StopCode
        Kind of the reason.
    reason : str
        What has happened, with the device and the measured values, in one line.
    """

    code: StopCode
    reason: str


class Decision(NamedTuple):
    """Decision of the safety guard after it has checked one status of the acquisition.

    Attributes
    ----------
    setpoints : tuple of Row
        Set-points that may be sent: pairs of run time [s] and n_cmd by thruster; empty unless the guard is running.
    stop : Stop or None
        Why the run has to end; None while the run may go on.
    """

    setpoints: tuple[Row, ...]
    stop: Stop | None


@dataclass(frozen=True)
class _LimitedQuantity:
    """Measured quantity that a limit in [limits] of the rig bounds, such as the shaft speed.

    Attributes
    ----------
    name : str
        Name of the quantity in messages.
    value : mapping of type to callable
        By class of sample: function that returns the quantity from a sample, or NaN if the sample does not contain it.
    remedy : str
        Advice that is shown if no device reports the quantity.
    slow : bool
        Whether the quantity is reported less often than the other values of its device.
    moves : bool
        Whether the quantity changes when the thrust changes, so that a constant value reveals a frozen device.
    """

    name: str
    value: Mapping[type[Any], Callable[[Any], float]]
    remedy: str
    slow: bool = False
    moves: bool = False


def _position(fix: Gnss) -> float:
    """Return the latitude [deg] of a GNSS sample, as a sign that it contains a position; NaN without a position fix."""
    return fix.lat if fix.fix >= 2 and math.isfinite(fix.lon) else NAN


def _temperature(esc: Esc) -> float:
    """Return the temperature [deg C] in a sample of a speed controller; NaN at -40 deg C or less (sensor missing)."""
    return esc.temperature if esc.temperature > COLDEST_C else NAN


# One advice wherever a run waits for a position: limits, estimator of an autopilot, check of a rig.
OPEN_SKY = "give the GNSS antenna open sky, and wait for a fix (up to a minute after power-on)"
_STATUS = "set the speed controller to send its status messages"
_QUANTITIES = {  # by key of [limits]
    "force_n": _LimitedQuantity(
        "force",
        {LoadCell: lambda cell: NAN if cell.flags else cell.force},
        "give the load cell a [device.calibration] in the rig",
        moves=True,
    ),
    "rpm": _LimitedQuantity("shaft speed", {Esc: lambda esc: esc.rpm}, _STATUS, moves=True),
    "current_a": _LimitedQuantity("current", {Esc: lambda esc: esc.current}, _STATUS, moves=True),
    "temperature_c": _LimitedQuantity("temperature", {Esc: _temperature}, f"{_STATUS} (VESC: status 4)", slow=True),
    "voltage_min_v": _LimitedQuantity(
        "voltage",
        {Esc: lambda esc: esc.voltage, Battery: lambda battery: battery.voltage},
        f"{_STATUS} (VESC: status 5), or the autopilot to send the voltage of its battery",
        slow=True,
    ),
    "battery_min": _LimitedQuantity(
        "charge",
        {Battery: lambda battery: battery.remaining},
        "set the autopilot to send the charge of its battery",
        slow=True,
    ),
    "roll_deg": _LimitedQuantity("roll", {Ahrs: lambda ahrs: ahrs.roll}, "add an AHRS to the rig"),
    "pitch_deg": _LimitedQuantity("pitch", {Ahrs: lambda ahrs: ahrs.pitch}, "add an AHRS to the rig"),
    "radius_m": _LimitedQuantity("position", {Gnss: _position}, OPEN_SKY, slow=True, moves=True),
}


class MovementWatch:
    """Detector of a frozen device: its measured value stays exactly the same although the commanded thrust changes.

    A frozen device can pass the other checks: its samples are on time and valid, and its value is within the limits.
    The attribute `is_position` is whether the value is a position, which needs stronger commands before it must change.
    """

    def __init__(self) -> None:
        """Prepare a detector of a frozen device. It has no value yet, and its values are not taken as positions."""
        self.is_position = False
        self._restart_counters(math.nan, (), {})

    def _restart_counters(self, t: float, value: tuple[float, ...], commands: Mapping[str, float]) -> None:
        """Store a measured value that differs from the previous one, and reset the counters of unchanged samples.

        ``t`` is the run time of its sample [s], and ``commands`` are the commands n_cmd by thruster at that time.
        """
        self._value = value
        self._t = self._changed_at = t  # run times of the newest sample, and of the first one with this value
        self._commands = dict(commands)  # commands at the last change of the value
        self._commanded_at = math.nan  # run time from which the commands differ from those; NaN if they do not
        self._samples = 0  # samples since that time
        self._repeats = 0  # samples with the same value
        self._impulse = self._travel = 0.0  # s of full thrust, and m by the reported speed, since the last change

    def update(self, t: float, value: tuple[float, ...], commands: Mapping[str, float], speed: float = NAN) -> None:
        """Take a sample: compare its value with the previous one, and add up the commands since the last change.

        The sums are the integral of the absolute mean command of all thrusters [s], in which opposite commands cancel,
        and the distance by ``speed`` [m]. Also stored are the first sample at which a command differs by 0.3 or more
        from that at the last change, and the number of samples since. If the value differs, all of this starts again. A
        sample with the same value that is not newer than the previous sample is ignored.

        Parameters
        ----------
        t : float
            Run time of the sample [s].
        value : tuple of float
            The value, or several values at least one of which must change.
        commands : Mapping
            Commands n_cmd by thruster, as last sent.
        speed : float
            Speed over ground [m/s] that a GNSS receiver reports with its position; NaN for other quantities. Only
            positive speeds are added.
        """
        if value != self._value:
            self._restart_counters(t, value, commands)
            return
        if not t > self._t:
            return
        dt, self._t = t - self._t, t
        self._repeats += 1
        # Only the mean command moves the boat: with opposite commands it turns on the spot.
        self._impulse += dt * abs(sum(commands.values())) / max(len(commands), 1)
        self._travel += dt * speed if speed > 0.0 else 0.0
        change = max((abs(n - self._commands.get(name, 0.0)) for name, n in commands.items()), default=0.0)
        if math.isnan(self._commanded_at):
            if change >= CHANGE:
                self._commanded_at = t
        else:
            self._samples += 1

    @property
    def unchanged_s(self) -> float:
        """Time [run s] from the first to the newest sample with the present measured value; NaN without a sample."""
        return self._t - self._changed_at

    @property
    def is_frozen(self) -> bool:
        """Whether the device is frozen: its value should have changed by now because of the commands.

        A position must change after an integral of 3 s of the absolute mean command of all thrusters (and at least
        5 s), or after 5 m by the reported speed, counted from its last change; at least 5 samples must have repeated
        it. Any other value must change within 2 s and 5 samples after the first sample at which a command differs by
        0.3 or more from the command at the last change of the value; if the command goes back later, this still counts.
        All times are run time.
        """
        if self.is_position:
            driven = self._impulse >= IMPULSE_S and self.unchanged_s >= AT_REST_S
            return self._repeats >= FROZEN_SAMPLES and (driven or self._travel >= TRAVEL_M)
        return self._samples >= FROZEN_SAMPLES and self._t - self._commanded_at >= FROZEN_S


@dataclass
class LimitSource:
    """Limit of the rig with its source: the device that has last reported the limited quantity.

    Attributes
    ----------
    key : str
        Name of the limit in [limits] of the rig, such as "current_a".
    limit : float
        Value of the limit, in the unit of its name.
    whom : str
        Thruster or load cell that the limit protects, in words; empty if samples of any device count.
    place : str
        Node and device of that thruster, in words; empty if the limit protects no single thruster.
    takes : callable
        Function of a source (device and node) and a sample that returns whether the sample counts for this limit.
    source : str
        Name of the device that has last reported the quantity; empty before the first report.
    t : float
        Run time of that report [s]; minus infinity without one, or if the device is frozen.
    frozen : str
        Why the device does not count, if its value is frozen (see `MovementWatch`); else empty.
    """

    key: str
    limit: float
    whom: str
    place: str
    takes: Callable[[Source, Sample], bool]
    source: str = ""
    t: float = -math.inf
    frozen: str = ""
    _watches: dict[Source, MovementWatch] = field(default_factory=dict)

    @property
    def is_slow(self) -> bool:
        """Whether the limited quantity is sent less often than others, so that it may be missing for longer."""
        return _QUANTITIES[self.key].slow

    def observe(self, source: Source, sample: Sample, t: float, commands: Mapping[str, float]) -> None:
        """Take a sample, and store its device as the source of the limit if the sample contains the limited quantity.

        Other samples, and values that are not finite, are ignored. A device whose value is frozen does not count until
        its value changes (only for a quantity that must change with the thrust). If it was the source, the limit has no
        source until another device reports. If another device is the source, a frozen one is ignored. A sample that is
        not newer than the stored report does not replace it.

        Parameters
        ----------
        source : Source
            Device and node of the sample.
        sample : Sample
            The sample.
        t : float
            Run time of the sample [s].
        commands : Mapping
            Commands n_cmd by thruster, as last sent.
        """
        quantity = _QUANTITIES[self.key]
        value = quantity.value.get(type(sample))
        if value is None or not self.takes(source, sample) or not math.isfinite(number := value(sample)):
            return
        name = source[0].partition("/")[0]
        if quantity.moves:
            watch = self._watches.setdefault(source, MovementWatch())
            if isinstance(sample, Gnss):
                watch.is_position = True
                watch.update(t, (sample.lat, sample.lon), commands, sample.speed)
            else:
                watch.update(t, (number,), commands)
            if watch.is_frozen:
                if self.source in ("", name):
                    cause = "the boat was driven" if watch.is_position else "the commands changed"
                    self.frozen = f"{name} repeats the same value for {watch.unchanged_s:.1f} s though {cause}"
                    self.t = -math.inf
                return
        if t > self.t:
            self.source, self.t, self.frozen = name, t, ""

    def silence(self, now: float) -> str:
        """Return the text that the limited quantity is missing at run time ``now`` [s], and since when or why.

        It names the quantity and the thruster or load cell that the limit protects. It ends with the time since the
        last report, or with "since the start" without a report, or with the reason if the device is frozen.
        """
        whom = f" of {self.whom}" if self.whom else ""
        missing = f"no {_QUANTITIES[self.key].name}{whom}{self.place}"
        return f"{missing}: {self.frozen}" if self.frozen else f"{missing} received{_age_text(now - self.t)}"

    def refusal(self, now: float) -> str:
        """Return the message that refuses to start a run because no device reports the limited quantity.

        The message names the limit, the missing quantity at run time ``now`` [s], and the remedy.
        """
        remedy = f'{_QUANTITIES[self.key].remedy}, or write unwatched = ["{self.key}"] in [limits]'
        return f"limits.{self.key} = {self.limit:g} is not watched: {self.silence(now)}; {remedy}"


def _limit_sources(rig: Rig, thrusters: list[Thruster]) -> Iterator[LimitSource]:
    """Yield the limits of a rig that have to be watched in a run, still without a device that reports the quantity.

    A limit of speed controllers (also that of the voltage) is yielded once for each of ``thrusters``, and the limit of
    the force once for each load cell, or once without a load cell. Limits that the rig does not set, or that
    `unwatched` in [limits] names, are left out.
    """
    cells = [device.name for device in rig.devices if device.protocol in LOAD_CELLS]
    for key, quantity in _QUANTITIES.items():
        limit = getattr(rig.limits, key)
        if limit is None or key in rig.limits.unwatched:
            continue
        if Esc in quantity.value:
            for thruster in thrusters:
                place = f" (node {thruster.node} on {thruster.device})"
                yield LimitSource(key, limit, f"thruster {thruster.name}", place, _accepts_thruster(thruster))
        elif key == "force_n" and cells:
            for cell in cells:
                yield LimitSource(key, limit, cell, "", _accepts_device(cell))
        else:
            yield LimitSource(key, limit, "", "", lambda source, sample: True)


def _accepts_thruster(thruster: Thruster) -> Callable[[Source, Sample], bool]:
    """Return a function that decides whether a sample counts for a limit of ``thruster``.

    It takes the source (device and node) and the sample. It returns True for samples of the thruster's own controller
    and of any battery.
    """

    def takes(source: Source, sample: Sample) -> bool:
        """Return whether a sample is of the thruster's own controller, by device and node, or of any battery."""
        own = (source[0].partition("/")[0], source[1]) == (thruster.device, thruster.node)
        return own or isinstance(sample, Battery)

    return takes


def _accepts_device(name: str) -> Callable[[Source, Sample], bool]:
    """Return a function that decides whether a sample comes from the device ``name``.

    It takes the source (device and node) and the sample.
    """
    return lambda source, sample: source[0].partition("/")[0] == name


class History:
    """History of the values of a quantity over the last seconds. Between two additions the quantity is constant."""

    def __init__(self, keep_s: float) -> None:
        """Prepare an empty history that keeps the values of the last ``keep_s`` run seconds."""
        self._keep_s = keep_s
        self._rows: deque[tuple[float, float]] = deque()  # run time, value

    def add(self, t: float, value: float) -> None:
        """Add the value that holds from run time ``t`` [s] on, and forget values that are too old.

        ``t`` must not be before the previous addition.
        """
        self._rows.append((t, value))
        # The oldest row must hold at the start of the window, so that it may be older than the window.
        while len(self._rows) > 1 and self._rows[1][0] <= t - self._keep_s:
            self._rows.popleft()

    def since(self, t: float) -> list[float]:
        """Return the values that the quantity had at run time ``t`` [s] or later, oldest first; empty without any.

        The last value that was added before ``t`` is among them, even if another one was added exactly at ``t``.
        """
        recent = [value for at, value in self._rows if at >= t]
        held = [value for at, value in self._rows if at < t][-1:]
        return held + recent

    def covers(self, t: float) -> bool:
        """Return whether a value was known at run time ``t`` [s]: the oldest kept addition is at ``t`` or before.

        Return False if the history is empty.
        """
        return bool(self._rows) and self._rows[0][0] <= t


class OutputCheck:
    """Comparison of an autopilot's output for one thruster (SERVO_OUTPUT_RAW) with the commands to this thruster.

    Causes of a deviation are, for example, a parameter that changes, blocks or exchanges commands, a disarmed
    autopilot, or a link that is late.
    """

    def __init__(self, thruster: Thruster, speed: float) -> None:
        """Prepare the comparison of the autopilot's output for ``thruster`` with its commands.

        ``speed`` is the number of run seconds per wall second.
        """
        self._thruster, self._window_s, self._tolerated_s = thruster, WINDOW_S * speed, LASTS_S * speed
        self._commands: deque[tuple[float, float]] = deque()  # run time, n_cmd
        self._wrong_since = math.nan

    def reason(self, status: Status) -> str:
        """Compare the newest output with the recent commands, and return why the run has to end, in one line.

        The text is empty if the run may go on: the output is within 0.05 of the range of the commands since 0.25 s
        (wall) before its sample, or deviates for less than 0.1 s (wall), or is NaN or not reported. The command in
        ``status`` is stored.
        """
        self._commands.append((status.t, status.commanded.get(self._thruster.name, 0.0)))
        while self._commands[0][0] < status.t - 2.0 * self._window_s:
            self._commands.popleft()
        latest = status.latest.get((self._thruster.device, self._thruster.node))
        if latest is None or not isinstance(latest.sample, Servo) or not math.isfinite(latest.sample.n):
            return ""
        recent = [n for t, n in self._commands if t >= latest.t - self._window_s]
        n = latest.sample.n
        if not recent or min(recent) - TOLERANCE <= n <= max(recent) + TOLERANCE:
            self._wrong_since = math.nan
            return ""
        self._wrong_since = latest.t if math.isnan(self._wrong_since) else self._wrong_since
        if latest.t - self._wrong_since < self._tolerated_s:
            return ""
        name, device = self._thruster.name, self._thruster.device
        why = "a parameter changes the commands, or its link is late; run `seatrial check` on the rig"
        if abs(n) <= TOLERANCE:
            why = "it was disarmed or blocks commands; look at its mode and its messages in a ground station"
        return f"{device} puts out n = {n:+.2f} for thruster {name}, commanded {recent[-1]:+.2f}: {why}"


class Rest(NamedTuple):
    """Result of the measurement whether a thruster is at zero thrust.

    Attributes
    ----------
    thruster : str
        Name of the thruster.
    is_zero : bool or None
        Whether it is at zero thrust; None if the measurements do not show this.
    text : str
        The measurement in words, such as "left turns at 2700 rpm".
    is_reached : bool
        Whether zero could be sent to it; not if its port was lost.
    """

    thruster: str
    is_zero: bool | None
    text: str
    is_reached: bool = True


class _Motion(enum.Enum):
    """Motion of the motor of a thruster while zero is commanded, as its speed controller reports it.

    Attributes
    ----------
    REST
        The motor stands still, or turns more slowly than a driven motor (`ControllerCheck.idle_rpm`), or its duty is at
        most 0.05 and no shaft speed is reported.
    COASTS
        The motor turns, and its small current, or its small duty and a falling speed, show that it is not driven.
    SLOWS
        The speed of the motor falls, and no measurement shows whether it is driven.
    DRIVEN
        Its duty, or a speed that does not fall (without a small current), shows that the motor is driven.
    UNKNOWN
        Neither the duty nor the shaft speed of the motor is reported.
    """

    REST = enum.auto()
    COASTS = enum.auto()
    SLOWS = enum.auto()
    DRIVEN = enum.auto()
    UNKNOWN = enum.auto()


class ControllerCheck:
    """Comparison of duty, shaft speed and current of a thruster's speed controller with the commands to the thruster.

    Notes
    -----
    Two deviations are no faults: a controller that limits its current puts out less duty than commanded, and a
    propeller turns freely while the boat coasts. Faults are more duty than commanded, a propeller that is driven
    seconds after zero was commanded, a motor that does not turn when commanded, and frozen telemetry.

    The attribute `idle_rpm` is the largest shaft speed [rev/min] at which a motor counts as at rest: 7 % of the
    thruster's `rpm_max`, but 30 to 300, and 300 without `rpm_max`.
    """

    def __init__(self, thruster: Thruster, speed: float) -> None:
        """Prepare the comparison of the speed controller of ``thruster`` with its commands.

        ``speed`` is the number of run seconds per wall second.
        """
        self._thruster = thruster
        delay = WINDOW_S * speed  # run s on the way to the controller and back
        self._window_s, self._tolerated_s, self._coast_s = (
            DUTY_WINDOW_S + delay,
            DUTY_LASTS_S + LASTS_S * speed,
            COAST_S + delay,
        )
        # Twice the window: a sample is older than the status that contains it, so that its window begins earlier.
        self._commands, self._rpm = History(2.0 * self._coast_s), History(2.0 * self._coast_s)
        self._wrong_since = math.nan
        self._current = 0.0  # A, the largest so far
        self._watch = MovementWatch()
        self._newest_t = -math.inf  # run time of the newest sample
        idle = IDLE_PART * thruster.rpm_max if math.isfinite(thruster.rpm_max) else IDLE_RPM_MAX
        self.idle_rpm = min(max(idle, IDLE_RPM_MIN), IDLE_RPM_MAX)

    def _newest_sample(self, status: Status) -> tuple[Esc, float] | None:
        """Return the newest sample of the thruster's speed controller, and its run time [s]; None before the first."""
        latest = status.latest.get((self._thruster.device, self._thruster.node))
        return None if latest is None or not isinstance(latest.sample, Esc) else (latest.sample, latest.t)

    def reason(self, status: Status) -> str:
        """Compare the newest sample with the recent commands, and return why the run has to end, in one line.

        The reasons are too much duty, a motor that is still driven 3 s after zero was commanded, a motor that does not
        turn, and frozen telemetry. The text is empty if the run may go on, or if there is no sample yet. Command and
        sample in ``status`` are stored.
        """
        if (latest := self.observe(status)) is None:
            return ""
        esc, t = latest
        return (
            self._excess_duty(esc, t)
            or self._still_driven(esc, t)
            or self._blocked_motor(esc, t)
            or self._frozen_telemetry()
        )

    def observe(self, status: Status) -> tuple[Esc, float] | None:
        """Store the thruster's command in ``status`` and the newest sample of its speed controller for later checks.

        Return this sample and its run time [s], or None before the first sample.
        """
        n = status.commanded.get(self._thruster.name, 0.0)
        self._commands.add(status.t, n)
        if (latest := self._newest_sample(status)) is None:
            return None
        esc, t = latest
        if t > self._newest_t:
            self._newest_t = t
            if math.isfinite(esc.rpm):
                self._rpm.add(t, abs(esc.rpm))
            self._current = max(self._current, abs(esc.current)) if math.isfinite(esc.current) else self._current
            values = (esc.rpm, esc.current, esc.duty, esc.voltage, esc.temperature)
            if any(map(math.isfinite, values)):
                finite = tuple(value if math.isfinite(value) else 0.0 for value in values)
                self._watch.update(t, finite, {self._thruster.name: n})
        return latest

    def _label(self) -> str:
        """Return the text "thruster NAME (node N on DEVICE)" that names the checked thruster in messages."""
        return f"thruster {self._thruster.name} (node {self._thruster.node} on {self._thruster.device})"

    def _excess_duty(self, esc: Esc, t: float) -> str:
        """Return why the run has to end if the motor's duty is beyond the recent commands; empty if it may go on.

        ``esc`` is the newest sample of the speed controller, and ``t`` its run time [s]. The duty must be within 0.1 of
        the range from zero to the commands of the last second; a deviation ends the run after 0.3 s. Both times are
        longer by the delay of the link (0.25 s and 0.1 s of wall time). Zero belongs to the range, because a controller
        that limits its current puts out less duty. A duty of NaN is not checked.
        """
        recent = [0.0, *self._commands.since(t - self._window_s)]
        if not math.isfinite(esc.duty) or min(recent) - DUTY_TOLERANCE <= esc.duty <= max(recent) + DUTY_TOLERANCE:
            self._wrong_since = math.nan
            return ""
        self._wrong_since = t if math.isnan(self._wrong_since) else self._wrong_since
        if t - self._wrong_since < self._tolerated_s:
            return ""
        text = f"{self._label()} puts out duty {esc.duty:+.2f}, commanded {recent[-1]:+.2f}: it ignores commands"
        return f"{text}; {CUT_POWER}"

    def _still_driven(self, esc: Esc, t: float) -> str:
        """Return why the run has to end if the motor is still driven 3 s after zero was commanded; else empty.

        ``esc`` is the newest sample of the speed controller, and ``t`` its run time [s]. The 3 s are longer by the
        delay of the link (0.25 s of wall time). A motor whose shaft speed has changed by more than 8 % in this time
        gives no reason, because the flow may turn it. Nor do commands that do not reach back so far.
        """
        begin = t - self._coast_s
        if not self._commands.covers(begin) or any(self._commands.since(begin)):
            return ""
        speeds = self._rpm.since(begin)
        # The flow may turn a propeller, for a while even faster than before, but not at a constant speed.
        constant = not speeds or min(speeds) >= FALLING * max(speeds)
        if self._motion(esc, t) is not _Motion.DRIVEN or not constant:
            return ""
        text = f"{self._label()} turns at {esc.rpm:.0f} rpm, {COAST_S:g} s after zero was commanded"
        return f"{text}: it ignores commands; {CUT_POWER}"

    def _motion(self, esc: Esc, t: float) -> _Motion:
        """Return the motion of the motor, under the condition that zero is commanded to it.

        ``esc`` is the newest sample of its speed controller, and ``t`` the run time of this sample [s]. A duty above
        0.05 in absolute value means driven. Otherwise a motor up to `idle_rpm` is at rest, also without a reported
        duty. A motor without a reported speed is at rest if its duty is reported; else its motion is unknown. A faster
        one coasts if its current is at most 5 % of the largest so far (which must have reached 1 A). Otherwise it is
        driven if its speed is above 92 % of the largest in the last 3 s (and 0.25 s of wall time). Else it coasts if
        its duty is reported, and slows if not.
        """
        has_duty = math.isfinite(esc.duty)
        if has_duty and abs(esc.duty) > FREE_DUTY:
            return _Motion.DRIVEN
        if not math.isfinite(esc.rpm):
            return _Motion.REST if has_duty else _Motion.UNKNOWN
        if abs(esc.rpm) <= self.idle_rpm:
            return _Motion.REST
        # The propeller turns. While the boat coasts, the flow turns it: without current and more and more slowly.
        if self._current >= SENSED_A and abs(esc.current) <= IDLE_CURRENT * self._current:
            return _Motion.COASTS
        if abs(esc.rpm) > FALLING * max(self._rpm.since(t - self._coast_s)):
            return _Motion.DRIVEN
        return _Motion.COASTS if has_duty else _Motion.SLOWS

    def _blocked_motor(self, esc: Esc, t: float) -> str:
        """Return why the run has to end if the motor does not turn after 3 s of commands of 0.3 or more; else empty.

        ``esc`` is the newest sample of the speed controller, and ``t`` its run time [s]. The commands must have one
        sign. The 3 s are longer by the delay of the link (0.25 s of wall time). A motor does not turn if its shaft
        speed is below 10 rev/min and its duty at most 0.05; only the one that is reported counts. A motor that draws
        more than 0.5 A, or that reports neither of these, gives no reason.
        """
        begin = t - self._coast_s
        recent = self._commands.since(begin)
        driven = self._commands.covers(begin) and (min(recent) >= BLOCKED_N or max(recent) <= -BLOCKED_N)
        reports = [abs(esc.rpm) < BLOCKED_RPM] if math.isfinite(esc.rpm) else []
        reports += [abs(esc.duty) <= FREE_DUTY] if math.isfinite(esc.duty) else []
        draws = abs(esc.current) > 0.5  # A controller without a speed sensor may report 0 rpm.
        if not driven or not reports or not all(reports) or draws:
            return ""
        text = f"{self._label()} does not turn, commanded {recent[-1]:+.2f} for {COAST_S:g} s: it blocks commands"
        return f"{text}; check its speed controller and motor with the manufacturer's tool"

    def _frozen_telemetry(self) -> str:
        """Return why the run has to end if all values of the speed controller's telemetry are frozen; else empty.

        They are frozen if they stay exactly the same for 2 s and 5 samples after a change of the command by 0.3.
        """
        if not self._watch.is_frozen:
            return ""
        seconds = self._watch.unchanged_s
        text = f"{self._label()} repeats the same telemetry for {seconds:.1f} s though its command changed"
        return f"{text}; check the power and firmware of its speed controller"

    def rest(self, status: Status, since: float) -> Rest:
        """Return whether the thruster is at zero thrust, from a sample of its speed controller.

        The sample must be newer than run time ``since`` [s], at which zero was sent. A motor that coasts counts as at
        zero thrust. `is_zero` of the result is None (not measured) without such a sample, without duty and shaft speed,
        or if the shaft speed falls and no measurement shows whether the motor is driven.
        """
        name = self._thruster.name
        latest = self.observe(status)
        if latest is None or not latest[1] > since:
            return Rest(name, None, f"{name} has not reported since")
        esc, t = latest
        motion = self._motion(esc, t)
        if motion is _Motion.UNKNOWN:
            return Rest(name, None, f"{name} reports neither duty nor shaft speed")
        turns = f"{name} turns at {esc.rpm:.0f} rpm"
        if motion is _Motion.DRIVEN:
            return Rest(name, False, turns if math.isfinite(esc.rpm) else f"{name} puts out duty {esc.duty:+.2f}")
        return Rest(name, None if motion is _Motion.SLOWS else True, turns)


class SafetyGuard:
    """State machine of one run. It decides which set-points may be sent and when the run has to end.

    The theory of operation is in the docstring of the module.

    Attributes
    ----------
    limits : list of LimitSource
        Limits of the rig that are watched, with their present sources.
    state : GuardState
        WAITING, RUNNING or STOPPED.
    stop : Stop or None
        The first reason to end the run; None while it may go on.
    """

    def __init__(self, rig: Rig, speed: float, thrusters: tuple[str, ...]) -> None:
        """Prepare the checks of a run. The state is WAITING.

        Parameters
        ----------
        rig : Rig
            The rig with its limits, devices and thrusters.
        speed : float
            Run seconds per wall second.
        thrusters : tuple of str
            Names of the thrusters that the mission commands.
        """
        self._rig = rig
        self._speed = speed
        self._thrusters = [rig.thruster(name) for name in thrusters]
        self._fence = None if rig.limits.radius_m is None else Fence(rig.limits.radius_m, rig.vehicle)
        self._log_bytes: float = math.nan  # bytes of the log at the last status
        self._grown_at = math.nan  # run time at which the log has last grown
        self._saturated_at: dict[str, float] = {}  # by load cell: run time of the first saturated reading
        self._rest_force: dict[str, float] = {}  # N, by load cell, before thrust was commanded
        self.limits = list(_limit_sources(rig, self._thrusters))
        self.state = GuardState.WAITING
        self.stop: Stop | None = None
        self._changes: dict[str, int] = {}  # by autopilot: parameters that had changed when the run started
        driving = {thruster.device for thruster in self._thrusters}
        # Thrusters that the mission does not command are compared too: an exchanged command acts on one of them.
        self._outputs = [
            OutputCheck(thruster, speed)
            for thruster in rig.thrusters
            if thruster.device in driving and thruster.output is not None
        ]
        self._controllers = {
            thruster.name: ControllerCheck(thruster, speed) for thruster in self._thrusters if thruster.output is None
        }

    def start(self, changes: Mapping[str, int] | None = None) -> None:
        """Allow set-points from here on: change the state from WAITING to RUNNING. In another state nothing happens.

        Parameters
        ----------
        changes : Mapping, optional
            By name of an autopilot: number of parameter changes that were known when its parameters were checked. A
            further change ends the run. An autopilot that is not named had no change.
        """
        if self.state is GuardState.WAITING:
            self.state, self._changes = GuardState.RUNNING, dict(changes or {})

    def step(self, now: float, status: Status, wanted: Sequence[Row] = ()) -> Decision:
        """Check one status of the acquisition, and the set-points that the mission would send.

        A reason to end the run sets the state to STOPPED. After that nothing more is checked.

        Parameters
        ----------
        now : float
            Run time [s].
        status : Status
            Newest status of the acquisition.
        wanted : sequence of Row
            Set-points, as pairs of run time [s] and n_cmd by thruster.

        Returns
        -------
        Decision
            The set-points that may be sent (all of ``wanted``, or none unless the state is RUNNING), and the first
            reason to end the run; None if it may go on.
        """
        if self.stop is None:
            self.stop = next(self._all_stops(now, status), None) or self._forbidden_setpoint(wanted)
        if self.stop is not None:
            self.state = GuardState.STOPPED
        return Decision(tuple(wanted) if self.state is GuardState.RUNNING else (), self.stop)

    def allow(self, wanted: Sequence[Row]) -> Sequence[Row]:
        """Return the set-points that may be sent: all of ``wanted`` in the state RUNNING, else an empty sequence.

        ``wanted`` are pairs of run time [s] and n_cmd by thruster.

        Raises
        ------
        SafetyStop
            If a set-point is for an unknown thruster, at a time that is not finite, or beyond `limits.n_max`. The state
            is then STOPPED. After an earlier stop nothing is raised.
        """
        if self.stop is None and (stop := self._forbidden_setpoint(wanted)):
            self.stop, self.state = stop, GuardState.STOPPED
            raise SafetyStop(stop.reason)
        return wanted if self.state is GuardState.RUNNING else ()

    def _forbidden_setpoint(self, wanted: Sequence[Row]) -> Stop | None:
        """Return the reason to end the run if a set-point is not allowed; None if all are allowed.

        ``wanted`` are pairs of run time [s] and n_cmd by thruster. A set-point must be for a thruster of the rig, at a
        finite time, and within `limits.n_max` of the rig. The reason names the first one that is not.
        """
        largest = min(self._rig.limits.n_max, 1.0)
        names = {thruster.name for thruster in self._rig.thrusters}
        for t, row in wanted:
            for name, n in row.items():
                if name not in names or not (math.isfinite(t) and abs(n) <= largest):
                    reason = (
                        f"set-point n = {n:g} for thruster {name} at {t:.3f} s: limits.n_max of the rig allows only "
                        f"-{largest:g} to {largest:g}; correct the mission or the limit"
                    )
                    return Stop(StopCode.SETPOINT, reason)
        return None

    def _all_stops(self, now: float, status: Status) -> Iterator[Stop]:
        """Yield all reasons to end the run at this status of the acquisition, at run time ``now`` [s].

        They are a stop or a silence of the acquisition process (1 s of wall time), then autopilots and the response of
        thrusters (only in the state RUNNING), then devices and limits.
        """
        if status.stopped:
            yield Stop(StopCode.ACQUISITION, status.stopped)
        if not now - status.t <= NO_STATUS_S * self._speed:
            text = f"the acquisition process has not answered for {NO_STATUS_S:g} s: the computer is too busy"
            yield Stop(StopCode.ACQUISITION, f"{text}; end other programs, and run again")
        if self.state is GuardState.RUNNING:
            yield from self._link_stops(status)
            yield from self._output_stops(status)
        yield from self._limit_stops(status)

    def check(self, status: Status) -> None:
        """Check devices and limits at this status, but not whether autopilots and thrusters follow commands.

        A link test needs this, because it interrupts the link to the autopilots. The state of the guard does not
        change.

        Raises
        ------
        SafetyStop
            If a limit is passed, no device reports the quantity of a limit, a port is lost, a device or thruster is
            silent, or the log does not grow.
        """
        for stop in self._limit_stops(status):
            raise SafetyStop(stop.reason)

    def _limit_stops(self, status: Status) -> Iterator[Stop]:
        """Yield the reasons to end the run that concern devices and limits, at this status of the acquisition.

        They are lost ports, silent devices and thrusters, a log that does not grow, limits that are passed (the
        geofence too), and limits whose quantity no device reports. The force of a load cell while zero is commanded is
        stored for later messages.
        """
        yield from self._silent_devices(status)
        yield from self._stuck_log(status)
        for source, latest in status.latest.items():
            sample = latest.sample
            if isinstance(sample, Gnss) and self._fence is not None:
                if reason := self._fence.reason(source[0].partition("/")[0], sample, latest.t):
                    yield Stop(StopCode.FENCE, reason)
                continue
            if isinstance(sample, LoadCell) and not any(status.commanded.values()) and math.isfinite(sample.force):
                self._rest_force[source[0]] = sample.force
            for reason in self._passed_limits(source[0], sample, latest.t):
                yield Stop(StopCode.LIMIT, reason)
        for limit in self.unwatched(status):
            reason = f"limits.{limit.key} is not watched any more: {limit.silence(status.t)}"
            yield Stop(StopCode.UNWATCHED, f"{reason}; check the power, cable and settings of the device")

    def _passed_limits(self, name: str, sample: Sample, t: float) -> Iterator[str]:
        """Yield a line of text for each limit that a sample of a speed controller, load cell, AHRS or battery passes.

        ``name`` is the device, and ``t`` the run time of the sample [s]. Other samples pass no limit; positions are
        checked by the geofence.
        """
        if isinstance(sample, Esc):
            yield from self._passed_esc_limits(name.partition("/")[0], sample)
        elif isinstance(sample, LoadCell):
            yield from self._passed_force_limit(name, sample, t)
        elif isinstance(sample, Ahrs):
            yield from self._passed_attitude_limits(name, sample)
        elif isinstance(sample, Battery):
            yield from self._passed_battery_limits(name.partition("/")[0], sample)

    # Sources.

    def unwatched(self, status: Status) -> list[LimitSource]:
        """Update the sources of all limits, and return the limits that have no source at this status.

        A source is a device that has reported the limited quantity recently (`_limit_patience`) and is not frozen. A
        run may start only if the returned list is empty. If the status reports that a device sends the same values of a
        kind of sample again and again, as a dead sensor does, these samples are ignored.
        """
        commands = {thruster.name: status.commanded.get(thruster.name, 0.0) for thruster in self._thrusters}
        # A dead source does not count, whatever its value is.
        alive = [item for item in status.latest.items() if not _repeats_samples(item[0], item[1].sample, status)]
        for source, latest in alive:
            for limit in self.limits:
                limit.observe(source, latest.sample, latest.t, commands)
        # Second pass: another source replaces one that was found frozen later in the first pass.
        for source, latest in alive:
            for limit in self.limits:
                if limit.frozen:
                    limit.observe(source, latest.sample, latest.t, commands)
        return [limit for limit in self.limits if not status.t - limit.t <= self._limit_patience(limit)]

    def _limit_patience(self, limit: LimitSource) -> float:
        """Return how long [run s] the quantity of ``limit`` may be missing before the limit has no source.

        The result is the time for which the device may be silent (`patience`, by the rate of one thruster if it has
        several), times 1.5, or times 3 for a quantity that is sent less often. The result is at most 6 s, or on fast
        mocks 1.5 s (3 s) of wall time if that is longer. The result is minus infinity before the first report: the
        limit has no source then.
        """
        if not limit.source:
            return -math.inf
        device = self._rig.device(limit.source)
        nodes = sum(thruster.device == device.name for thruster in self._rig.thrusters)
        factor = SLOW if limit.is_slow else QUICK
        longest = max(LIMIT_MAX_S, factor * STALE_WALL_S * self._speed)
        return min(self._patience(device.rate_hz / max(nodes, 1)) * factor, longest)

    def rate_conflicts(self, status: Status) -> list[str]:
        """Return a line of text for each device whose measured rate differs from `rate_hz` by more than a factor of 3.

        `rate_hz` is the rate of the device in the rig file. The guard derives from it how long the device may be
        silent, and would notice a silent device too late if it is wrong. A device whose rate is not yet measured is
        left out.
        """
        found = []
        for device in self._rig.devices:
            port = status.ports.get(device.name)
            if port is None or not math.isfinite(port.rate) or port.rate <= 0.0:
                continue
            ratio = port.rate / device.rate_hz
            if not 1.0 / RATE_RATIO <= ratio <= RATE_RATIO:
                found.append(
                    f"{device.name} ({device.port}) sends {port.rate:.3g} samples/s, and the rig says rate_hz = "
                    f"{device.rate_hz:g}: correct the rig, or the rate of the device"
                )
        return found

    def patience(self, device: str) -> float:
        """Return how long [run s] the device with the name ``device`` may be silent before the run ends.

        It is 5 periods of its `rate_hz` in the rig, but 1 to 5 s, and at least 1 s of wall time. Raises SeatrialError
        if the rig has no such device.
        """
        return self._patience(self._rig.device(device).rate_hz)

    def _patience(self, rate_hz: float) -> float:
        """Return how long [run s] a sender with the rate ``rate_hz`` [Hz] may be silent: 5 periods, but 1 to 5 s.

        On mocks that are faster than real time it is at least 1 s of wall time.
        """
        return max(STALE_S, min(STALE_PERIODS / rate_hz, STALE_MAX_S), STALE_WALL_S * self._speed)

    def is_outdated(self, source: Source, status: Status) -> bool:
        """Return whether the newest sample of a source is too old to be displayed.

        ``source`` is the device and node; ``status`` must contain a sample of it. Too old is more than 1.5 times the
        silence that the rate of the device permits, or 3 times if it sends several kinds of samples. Nodes of a device
        share its rate. The guard itself does not use this.
        """
        name = source[0].partition("/")[0]
        kinds, nodes = count_senders(status, name)
        rate_hz = self._rig.device(name).rate_hz / (1 if source[1] is None else nodes)
        # The rate holds for one kind of samples or for all kinds together, so that a further kind may be slower.
        slow = SLOW if kinds > 1 or name != source[0] else QUICK
        return not status.t - status.latest[source].t <= slow * self._patience(rate_hz)

    def _silent_devices(self, status: Status) -> Iterator[Stop]:
        """Yield a reason to end the run for each lost port, each silent device, and each silent thruster.

        A device or thruster is silent if it has sent no sample for longer than its rate permits (`patience`), or none
        at all. A port is lost if it is closed after its device has sent samples.
        """
        for device in self._rig.devices:
            port = status.ports.get(device.name)
            age = math.inf if port is None else port.age
            if port is not None and port.samples and not port.open:
                # A lost port is known at once. Waiting for the silence of the device would add a second of thrust.
                reason = f"{device.name} ({device.port}) was lost: {port.message or 'the port was closed'}"
                yield Stop(StopCode.PORT_LOST, f"{reason}; check its plug, cable and power")
            # Written with `not`, so that an age of NaN counts as silent.
            if not age <= self._patience(device.rate_hz):
                reason = f"{device.name} ({device.port}) is silent{_age_text(age)}"
                yield Stop(StopCode.SILENT, f"{reason}; check its power and cable")
        for reason in self._silent_thrusters(status):
            yield Stop(StopCode.SILENT, reason)

    def _silent_thrusters(self, status: Status) -> Iterator[str]:
        """Yield a line of text for each commanded thruster that has not been reported for too long.

        Reports come from its speed controller, or from the autopilot for its output.
        """
        for thruster in self._thrusters:
            latest = status.latest.get((thruster.device, thruster.node))
            age = math.inf if latest is None else status.t - latest.t
            if not age <= self._patience(self._status_rate(thruster)):
                yield (
                    f"thruster {thruster.name} (node {thruster.node} on {thruster.device}) is silent{_age_text(age)}; "
                    "check the power and cable of its controller"
                )

    def _status_rate(self, thruster: Thruster) -> float:
        """Return the rate [1/run s] at which the speed controller or output of a thruster is reported.

        It is `rate_hz` of the thruster's device, divided by the number of thrusters on this device.
        """
        device = self._rig.device(thruster.device)
        return device.rate_hz / sum(other.device == device.name for other in self._rig.thrusters)

    def _stuck_log(self, status: Status) -> Iterator[Stop]:
        """Yield a reason to end the run if the log file has not grown for more than 3 s (wall).

        The size in ``status`` is compared with that of the last call; the time counts from the last change of the size.
        The first call gives nothing.
        """
        if status.bytes != self._log_bytes:
            self._log_bytes, self._grown_at = status.bytes, status.t
        elif status.t - self._grown_at > STUCK_WALL_S * self._speed:
            yield Stop(StopCode.LOG, f"the log {status.path} does not grow any more; check the disk and its free space")

    # Links and outputs.

    def _link_stops(self, status: Status) -> Iterator[Stop]:
        """Yield the reasons to end the run that concern the autopilots of the commanded thrusters.

        An autopilot is silent for more than 3 s (wall), disarmed, in another mode than MANUAL, or reports an alarm;
        another ground station has our system id; or a parameter has changed since the run was started.
        """
        for name in dict.fromkeys(thruster.device for thruster in self._thrusters):
            if self._rig.device(name).mavlink is None:
                continue
            link = status.links.get(name, LinkStatus())
            if not link.age <= LINK_AGE_S:
                text = f"{name}: no heartbeat received for {link.age:.1f} s"
                if not math.isfinite(link.age):
                    text = f"{name}: no heartbeat received since its port was opened or it restarted"
                yield Stop(StopCode.LINK, f"{text}; check the antenna, cable and power of its link")
            reason = f" ({link.alarm})" if link.alarm else ""
            if not link.armed:
                text = f"{name} was disarmed during the run{reason}"
                yield Stop(StopCode.LINK, f"{text}; find out which station or switch did it, and run again")
            if link.mode != MANUAL:
                text = f"{name} changed from mode {MANUAL} to {link.mode}{reason}"
                yield Stop(StopCode.LINK, f"{text}; find out which station or switch did it, and run again")
            if link.alarm:
                advice = "remove the cause (a ground station shows the messages), and run again"
                yield Stop(StopCode.LINK, f"{name} reports {link.alarm}; {advice}")
            if link.other_station_frames:
                yield Stop(StopCode.RIVAL, f"{name}: {RIVAL}")
            # A changed parameter may disable a failsafe. The run ends while the link can still transmit zero and the
            # request to disarm.
            if changed := link.changed[self._changes.get(name, 0) :]:
                more = f" (and {counted(len(changed) - 1, 'other')})" if len(changed) > 1 else ""
                yield Stop(StopCode.PARAMETER, f"{name}: {changed[0]}{more} during the run; set it back, and run again")

    def _output_stops(self, status: Status) -> Iterator[Stop]:
        """Yield a reason to end the run for each thruster that does not follow its commands.

        The outputs of autopilots and the telemetry of speed controllers are compared with the commands. Speed
        controllers give no reason if `unwatched` in [limits] of the rig contains "telemetry".
        """
        for output in self._outputs:
            if reason := output.reason(status):
                yield Stop(StopCode.OUTPUT, reason)
        for controller in self._controllers.values():
            reason = controller.reason(status)
            if reason and TELEMETRY not in self._rig.limits.unwatched:
                yield Stop(StopCode.OUTPUT, reason)

    def turning(self, status: Status) -> list[str]:
        """Return a line of text for each thruster with a speed controller that is driven although zero is commanded.

        This method is called before the start of a run. The run must not start if the list is not empty. Outputs of
        autopilots are not checked. The list is empty if `unwatched` in [limits] of the rig contains "telemetry".
        """
        if TELEMETRY in self._rig.limits.unwatched:
            return []
        found = (controller.rest(status, -math.inf) for controller in self._controllers.values())
        return [rest.text for rest in found if rest.is_zero is False]

    def rest(self, status: Status) -> list[Rest]:
        """Return for each thruster of the mission whether it is measured at zero thrust.

        Only samples count that are newer than the time at which zero was sent to all thrusters of the device. Without
        such a sample, or if a command has followed, `is_zero` of the thruster is None (not measured).
        """
        found = []
        for thruster in self._thrusters:
            since = status.zeroed.get(thruster.device, math.nan)
            if math.isnan(since):
                found.append(Rest(thruster.name, None, f"{thruster.name} was not reached", is_reached=False))
            elif thruster.output is None:
                found.append(self._controllers[thruster.name].rest(status, since))
            else:
                found.append(_output_rest(thruster, status, since))
        return found

    # Limits of one sample.

    def _passed_esc_limits(self, name: str, esc: Esc) -> Iterator[str]:
        """Yield a line of text for each limit of the rig that a sample of a speed controller passes.

        ``name`` is the device that reports the controller. The limits are shaft speed, current, temperature and
        voltage. A value of NaN, or a limit that is not set, gives nothing.
        """
        limits = self._rig.limits
        if limits.rpm is not None and abs(esc.rpm) > limits.rpm:
            text = f"speed of node {esc.node} on {name} is {esc.rpm:.0f} rpm, above limits.rpm = {limits.rpm:g}"
            yield f"{text}; lower n_max, or correct the limit"
        if limits.current_a is not None and abs(esc.current) > limits.current_a:
            text = f"current of node {esc.node} on {name} is {esc.current:.1f} A"
            advice = "check whether weed or a rope blocks the propeller, or lower n_max"
            yield f"{text}, above limits.current_a = {limits.current_a:g}; {advice}"
        if limits.temperature_c is not None and esc.temperature > limits.temperature_c:
            text = f"temperature of node {esc.node} on {name} is {esc.temperature:.0f} deg C"
            yield f"{text}, above limits.temperature_c = {limits.temperature_c:g}; let it cool, and make runs shorter"
        if limits.voltage_min_v is not None and esc.voltage < limits.voltage_min_v:
            text = f"voltage of node {esc.node} on {name} is {esc.voltage:.1f} V"
            yield f"{text}, below limits.voltage_min_v = {limits.voltage_min_v:g}; charge the battery, or lower n_max"

    def _passed_attitude_limits(self, name: str, ahrs: Ahrs) -> Iterator[str]:
        """Yield a line of text for each of roll and pitch in a sample of the AHRS ``name`` that passes its limit.

        An angle of NaN, or a limit that is not set, gives nothing.
        """
        limits = self._rig.limits
        for word, angle, limit in (("roll", ahrs.roll, limits.roll_deg), ("pitch", ahrs.pitch, limits.pitch_deg)):
            if limit is not None and abs(math.degrees(angle)) > limit:
                text = f"{word} is {math.degrees(angle):.0f} deg by {name}, above limits.{word}_deg = {limit:g}"
                yield f"{text}; level the boat, or check the mounting of {name}"

    def _passed_battery_limits(self, name: str, battery: Battery) -> Iterator[str]:
        """Yield a line of text for each of voltage and charge in a sample of a battery that is below its limit.

        ``name`` is the device that reports the battery. A value of NaN, or a limit that is not set, gives nothing.
        """
        limits = self._rig.limits
        if limits.voltage_min_v is not None and battery.voltage < limits.voltage_min_v:
            text = f"battery of {name} is at {battery.voltage:.1f} V"
            yield f"{text}, below limits.voltage_min_v = {limits.voltage_min_v:g}; charge it"
        if limits.battery_min is not None and battery.remaining < limits.battery_min:
            text = f"battery of {name} has {100 * battery.remaining:.0f} % left"
            yield f"{text}, below limits.battery_min = {limits.battery_min:g}; charge it"

    def _passed_force_limit(self, name: str, cell: LoadCell, t: float) -> Iterator[str]:
        """Yield a line of text if the force passes its limit, or if two successive samples are saturated.

        ``name`` is the load cell, ``cell`` its sample, and ``t`` the run time of the sample [s]. Nothing is yielded if
        the limit is not set. A force with the flag of a spike, or of NaN, does not pass the limit. The force at rest is
        named in the text of a passed limit if it is more than 5 % of the limit.
        """
        limit = self._rig.limits.force_n
        if limit is None:
            return
        if cell.flags & SATURATED:
            # A single saturated reading may be an error of the converter; a second one ends the run.
            if t > self._saturated_at.setdefault(name, t):
                text = f"load cell {name} is saturated, so its force cannot be compared with limits.force_n"
                yield f"{text}; lower the load or the gain"
            return
        self._saturated_at.pop(name, None)
        if not cell.flags & SPIKE and abs(cell.force) > limit:
            rest = self._rest_force.get(name, 0.0)
            # A wrong zero of the load cell uses up part of the limit, so that the reason has to name it.
            advice = "lower n_max, or correct the limit"
            if abs(rest) > REST_PART * limit:
                advice = f"{rest:.1f} N of it are there at rest: correct zero_counts in the rig"
            yield f"force is {cell.force:.1f} N by {name}, above limits.force_n = {limit:g}; {advice}"


def _output_rest(thruster: Thruster, status: Status, since: float) -> Rest:
    """Return whether an autopilot's output for a thruster is at neutral, so that thrust is zero.

    The sample must be newer than run time ``since`` [s], at which zero was sent. An output without pulses is at
    neutral. `is_zero` of the result is None (not measured) without such a sample, or if its normalised output is NaN.
    """
    name = thruster.name
    latest = status.latest.get((thruster.device, thruster.node))
    if latest is None or not latest.t > since or not isinstance(latest.sample, Servo):
        return Rest(name, None, f"{name} has not reported since")
    servo = latest.sample
    if servo.pwm == 0.0:
        return Rest(name, True, f"{name} gets no pulse")
    text = f"{name} gets n = {servo.n:+.2f}"
    return Rest(name, abs(servo.n) <= NEUTRAL if math.isfinite(servo.n) else None, text)


def _repeats_samples(source: Source, sample: Sample, status: Status) -> bool:
    """Return whether a device sends the same values again and again, as a dead sensor does.

    ``source`` is the device and node of ``sample``; ``status`` contains which kinds of samples the device repeats.
    Return False for a load cell while zero is commanded: its coarse converter may repeat values at rest.
    """
    port = status.ports.get(source[0].partition("/")[0])
    rests = isinstance(sample, LoadCell) and not any(status.commanded.values())
    return port is not None and type(sample).__name__ in port.stuck and not rests


def _age_text(age: float) -> str:
    """Return the end of a message on a missing report: " for 1.2 s" for an age of 1.2 s.

    For an infinite ``age`` (no report yet) or NaN it is " since the start".
    """
    return f" for {age:.1f} s" if math.isfinite(age) else " since the start"


def stopping_distance(speed: float, vehicle: Mapping[str, float]) -> float:
    """Return the distance [m] that a boat coasts without thrust until its speed has fallen to 0.05 m/s.

    Parameters
    ----------
    speed : float
        Initial speed [m/s].
    vehicle : Mapping
        Parameters of [vehicle] in the rig, by name: mass `m_u` [kg], linear damping `d_u` [kg/s] and quadratic damping
        `d_uu` [kg/m] in surge. Missing and negative values count as 0.

    Returns
    -------
    float
        The distance; 0 if `m_u` or both dampings are 0, or if the boat is not faster than 0.05 m/s.

    Notes
    -----
    The distance follows from m_u u' = -d_u u - d_uu u^2, integrated until the speed is `STOPPED`.
    """
    m_u, d_u, d_uu = (max(vehicle.get(name, 0.0), 0.0) for name in ("m_u", "d_u", "d_uu"))
    if speed <= STOPPED or m_u == 0.0 or d_u + d_uu == 0.0:
        return 0.0
    if d_uu == 0.0:
        return m_u * (speed - STOPPED) / d_u
    return m_u / d_uu * math.log((d_u + d_uu * speed) / (d_u + d_uu * STOPPED))


class _RelativeFix(NamedTuple):
    """GNSS position relative to the start of the boat.

    Attributes
    ----------
    t : float
        Run time [s].
    north, east : float
        Position to the north and to the east of the start, as angles at the centre of the earth [rad]; multiplied by
        the earth's radius they are in m.
    speed : float
        Speed over ground [m/s] that the receiver reports.
    """

    t: float
    north: float
    east: float
    speed: float


class Fence:
    """Geofence: a circle around the first position of the boat, inside which the boat must be able to stop.

    A GNSS receiver may report a single wrong position. A position that the boat cannot have reached counts only if a
    second one confirms it. All receivers share the centre, and each is checked alone.
    """

    def __init__(self, radius_m: float, vehicle: Mapping[str, float]) -> None:
        """Prepare a geofence with the radius ``radius_m`` [m]. Its centre will be the first position.

        ``vehicle`` has the parameters of [vehicle] in the rig, from which the stopping distance is computed.
        """
        self._radius, self._vehicle = radius_m, vehicle
        self._home: tuple[float, float] | None = None  # rad
        self._last: dict[str, _RelativeFix] = {}  # by receiver: the newest fix that counts
        self._doubted: dict[str, float] = {}  # by receiver: run time of a fix that needs a confirmation

    def reason(self, name: str, fix: Gnss, t: float) -> str:
        """Return why the run has to end, in one line; empty while the boat is inside the fence and can stop inside it.

        The first position is the centre of the fence, even if it is doubtful. A sample without a position fix, and a
        position that the boat cannot have reached and that no second one confirms, give an empty text.

        Parameters
        ----------
        name : str
            Name of the GNSS receiver.
        fix : Gnss
            Newest sample of the receiver.
        t : float
            Run time of the sample [s].
        """
        if fix.fix < 2 or not (math.isfinite(fix.lat) and math.isfinite(fix.lon)):
            return ""
        lat, lon = math.radians(fix.lat), math.radians(fix.lon)
        if self._home is None:
            self._home = (lat, lon)
        north = lat - self._home[0]
        # The remainder takes the shorter way around the globe, so that a start near the date line works.
        east = math.remainder(lon - self._home[1], 2.0 * math.pi) * math.cos(lat)
        here = _RelativeFix(t, north, east, fix.speed)
        if self._is_doubtful(name, here):
            return ""
        self._last[name] = here
        return self._fence_reason(name, here, fix)

    def _is_doubtful(self, name: str, here: _RelativeFix) -> bool:
        """Return whether the position ``here`` of the receiver ``name`` is doubtful and not confirmed.

        A position is doubtful if the boat cannot have reached it: more than 20 m plus 15 m/s times the time from the
        receiver's last accepted position, or a reported speed above 15 m/s. Before the first accepted position only the
        speed counts. A doubtful one is stored until a later accepted position follows. If a newer position is doubtful
        while one is stored, return False for it: the jump is confirmed, whether or not both are close to each other.
        """
        last = self._last.get(name)
        step, reach = 0.0, JUMP_M
        if last is not None:
            step = EARTH_RADIUS_M * math.hypot(here.north - last.north, here.east - last.east)
            reach += JUMP_SPEED * max(here.t - last.t, 0.0)
        if step <= reach and not here.speed > JUMP_SPEED:
            self._doubted.pop(name, None)
            return False
        # The same fix is seen in several statuses; only a newer one confirms it.
        if here.t > self._doubted.setdefault(name, here.t):
            del self._doubted[name]
            return False
        return True

    def _fence_reason(self, name: str, here: _RelativeFix, fix: Gnss) -> str:
        """Return why the run has to end, if the boat is outside the fence or cannot stop inside it; else empty.

        ``here`` is the position relative to the start, and ``fix`` the sample of the receiver ``name`` with the
        velocity. The boat stops after 0.1 s at its outward velocity and the `stopping_distance` from it. Without a
        course the whole speed is taken as outward; without a speed only the position counts.
        """
        length = math.hypot(here.north, here.east)
        distance = EARTH_RADIUS_M * length
        if distance > self._radius:
            text = f"the boat is {distance:.0f} m from the start by {name}, beyond limits.radius_m = {self._radius:g}"
            return f"{text}; bring it back, and use a shorter mission or a larger area"
        outward = (here.north * fix.vel_n + here.east * fix.vel_e) / length if length > 0.0 else 0.0
        if math.isnan(outward):  # a speed without a course is taken as straight outward
            outward = fix.speed
        if not outward > 0.0:  # NaN too: the receiver reports no velocity
            return ""
        coast = outward * REACTION_S + stopping_distance(outward, self._vehicle)
        if distance + coast > self._radius:
            return (
                f"the boat is {distance:.0f} m from the start by {name} and needs {coast:.0f} m to stop from "
                f"{outward:.1f} m/s, in all beyond limits.radius_m = {self._radius:g}; use a shorter mission or a "
                "larger area"
            )
        return ""
