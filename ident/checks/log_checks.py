"""All checks of the signals of one log, in the order in which they build on each other.

`seatrial check LOG` and every fit of a boat run these checks. The module also returns the evidence as curves for the
report of a check: sample intervals, signals, shaft speeds, and motion against thrust.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import FAULT, WARNING, Finding, check_devices, unknown_names, worst_first
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import WHOLE, Log, TimeWindow, open_log, part_in
from seatrial.daq.samples import Ahrs, Command, Esc, Gnss, LoadCell, Scalar
from seatrial.ident.checks.clock_step import check_clock_step
from seatrial.ident.checks.frames import check_accelerometer, check_frames
from seatrial.ident.checks.heading_offset import HeadingAngle, compare_headings, heading_angle
from seatrial.ident.checks.held import check_held, check_held_inputs
from seatrial.ident.checks.inputs import (
    INPUTS,
    check_exchanged_telemetry,
    check_frozen_force,
    check_inputs,
    check_thrust_present,
)
from seatrial.ident.checks.latency import SensorDelay, check_latency, compare_sensor_delays, sensor_delay_of
from seatrial.ident.checks.motion import (
    SURGE_LAGS,
    YAW_LAGS,
    ThrusterForces,
    best_turn_rate,
    check_motion,
    delayed_forces,
    fill_gaps,
    surge_speed,
    thruster_forces,
    turning_signs,
)
from seatrial.ident.checks.outliers import check_outliers
from seatrial.ident.checks.sensors import (
    SENSOR_GRID_S,
    WINDOW,
    Channels,
    check_time_scale,
    gyro_and_heading,
    position_and_velocity,
    sensor_matches,
    velocity_and_acceleration,
)
from seatrial.ident.checks.shaft_gain import Held, check_shaft_gain, compare_shaft_gains, held_of_thrusters
from seatrial.ident.checks.shaft_sign import check_shaft_scale, check_wrapped, one_sided_shafts
from seatrial.ident.checks.shafts import check_shafts
from seatrial.ident.checks.signals import (
    check_alternating,
    check_frozen,
    check_intervals,
    check_quantised,
    check_ranges,
    check_smoothing,
)
from seatrial.ident.data import SHORTEST_PIECE_S, Channel, channels, parts_between, seconds, silent_times, within_window
from seatrial.ident.model import (
    SignalId,
    command_of,
    commanded_thrusters,
    is_of_thruster,
    shaft_speed_of,
)
from seatrial.ident.numerics import Array

MARGIN_S = 60.0  # read before and after an interval of time: the last value of each input
POSITION_WINDOW_S = 5.0  # over which positions are differenced, as in `sensors.position_match`
# Signals shown on the page of a check, in this order. Other imported signals follow.
SHOWN = ("psi", "r", "ax", "ay", "x", "y", "vx", "vy", "force")
MAX_SIGNALS_SHOWN = 12
NOT_SHOWN = ("phi", "theta", "p", "q", "speed")  # add little to the signals above; thrusters have their own plot


@dataclass(frozen=True)
class SampleIntervals:
    """Sample intervals of one device.

    Attributes
    ----------
    source
        Name of the device.
    t
        Times (n,) [s] of the later of two neighbouring samples.
    interval
        Intervals (n,) [s] between neighbouring samples.
    expected
        Interval [s] by `rate_hz` of the rig; None if the rig gives no rate.
    """

    source: str
    t: Array
    interval: Array
    expected: float | None

    def between(self, begin: float, end: float) -> SampleIntervals:
        """Return the intervals that lie completely between the times ``begin`` and ``end`` [s], both included."""
        own = (self.t > begin) & (self.t <= end) & (self.t - self.interval >= begin)
        return replace(self, t=self.t[own], interval=self.interval[own])


@dataclass(frozen=True)
class ShaftTrace:
    """Shaft speed of one thruster and its command, both over full speed.

    Attributes
    ----------
    name
        Name of the thruster.
    t, n
        Times (n,) [s] and measured shaft speeds (n,).
    t_command, n_command
        Times (m,) [s] and commands (m,), each held until the next one.
    end
        Time [s] of the last sample of the shaft speed.
    """

    name: str
    t: Array
    n: Array
    t_command: Array
    n_command: Array
    end: float


@dataclass(frozen=True)
class ThrustResponseCurve:
    """Measured motion and the motion that the thrust is expected to cause.

    Attributes
    ----------
    title, unit
        Name of the motion, and unit of both curves.
    t
        Times (n,) [s].
    measured
        Measured motion (n,).
    expected
        Thrust through the first-order lag that fits best (n,), with the expected sign. NaN for a constant thrust.
    """

    title: str
    unit: str
    t: Array
    measured: Array
    expected: Array


@dataclass(frozen=True)
class SensorPair:
    """The same motion measured by two sensors.

    Attributes
    ----------
    title, unit
        Name of the motion, and unit of both curves.
    names
        Names of both sensors, for the legend.
    t
        Times (n,) [s].
    first, second
        Motion (n,) by the first and by the second sensor.
    """

    title: str
    unit: str
    names: tuple[str, str]
    t: Array
    first: Array
    second: Array


@dataclass(frozen=True)
class SignalCurve:
    """Samples of one channel as logged.

    Attributes
    ----------
    channel, unit
        Name and unit of the channel.
    t, value
        Times (n,) [s] and values (n,).
    angle
        Whether the value may jump by a whole turn.
    """

    channel: str
    unit: str
    t: Array
    value: Array
    angle: bool


@dataclass(frozen=True)
class CheckEvidence:
    """Curves of one log, or of one segment of a log between two gaps. All times [s] count from the start of the log.

    Attributes
    ----------
    name
        Name of the log; for a segment with its begin and end [s] in brackets.
    duration
        Duration [s].
    rig
        Name of the rig in the log; None if the log has no rig.
    intervals, shafts, thrust_response, sensors, signals
        Curves of each kind. Empty if the log lacks the signals.
    """

    name: str
    duration: float
    rig: str | None
    intervals: tuple[SampleIntervals, ...] = ()
    shafts: tuple[ShaftTrace, ...] = ()
    thrust_response: tuple[ThrustResponseCurve, ...] = ()
    sensors: tuple[SensorPair, ...] = ()
    signals: tuple[SignalCurve, ...] = ()


def log_evidence(path: Path, name: str = "", window: TimeWindow = WHOLE) -> list[CheckEvidence]:
    """Return the curves of one log, for each segment between its gaps.

    Parameters
    ----------
    path
        File or folder of the log.
    name
        Name to show. If it is empty, the name of the file without its suffix is shown.
    window
        Interval of time of the log to show.

    Returns
    -------
    list
        One entry for each segment; one entry for the whole log if it has no gap.

    Raises
    ------
    SeatrialError
        If the file is not a log, or if it ends before the interval.
    """
    with open_log(path) as log:
        signals, span = _signals_in(log, window)
        rig = log.rig
        duration, intervals, sides, start = log.duration, _sample_intervals(log), sides_of(log), log.start
    gaps, found = silent_times(signals), []
    for signals_of_part in parts_between(signals, gaps):
        c = {n: Channel(s.t - start, s.value, s.unit, s.source) for n, s in signals_of_part.items()}
        begin, end = (0.0, duration) if span is None else (span[0] - start, span[1] - start)
        begin, end = _time_span(c) if gaps and c else (begin, end)
        own = [row.between(begin, end) for row in intervals] if gaps or span else intervals
        found.append(CheckEvidence(
            f"{name or path.stem}[{seconds(begin)}:{seconds(end)}]" if gaps or span else name or path.stem, end - begin,
            rig.name if rig else None, tuple(row for row in own if row.t.size), tuple(_shaft_responses(c)),
            tuple(thrust_response_curves(c, sides)), tuple(sensor_pairs(c)), tuple(_signal_curves(c)),
        ))  # fmt: skip
    return found


def _signals_in(log: Log, window: TimeWindow) -> tuple[dict[str, Channel], tuple[float, float] | None]:
    """Return the signals of a log in an interval of time, and the interval [s since 1970]; None for the whole log.

    The commands from a minute before the interval are read too, because a command holds until the next one.
    SeatrialError is raised if the log ends before the interval.
    """
    if window == WHOLE:
        return channels(log), None
    part = part_in(log, window)
    signals = channels(log.part(part.start - MARGIN_S, part.end + MARGIN_S))
    return within_window(signals, part.start, part.end), (part.start, part.end)


def _sample_intervals(log: Log) -> list[SampleIntervals]:
    """Return the sample intervals of each sensor and of each speed controller with at least two samples.

    The nodes of a speed controller are taken together. Imported inputs are left out. Times count from the start of the
    log.
    """
    rig = log.rig
    expected = {d.name: 1.0 / d.rate_hz for d in rig.devices} if rig else {}
    found: list[SampleIntervals] = []
    for kind in (Ahrs, Gnss, LoadCell, Scalar):
        for source in log.sources(kind):
            if kind is not Scalar or log.role(source) == "output":
                found.append(
                    _intervals_of_samples(source, log.table(kind, source)["t"], log.start, expected.get(source))
                )
    for source in log.sources(Esc):
        nodes = log.nodes(Esc, source)
        t = np.sort(np.concatenate([log.table(Esc, source, node)["t"] for node in nodes]))
        found.append(_intervals_of_samples(source, t, log.start, expected.get(source)))
    return [row for row in found if row.t.size]


def _intervals_of_samples(source: str, t: Array, start: float, expected: float | None) -> SampleIntervals:
    """Return the sample intervals of one device.

    ``t``: times of its samples (n,) [s since 1970]. ``start``: start of the log [s since 1970]. ``expected``: interval
    [s] by the rig, or None.
    """
    return SampleIntervals(source, t[1:] - start, np.diff(t), expected)


def _shaft_responses(c: Channels) -> list[ShaftTrace]:
    """Return command and shaft speed of each thruster that has both, sorted by name.

    A shaft speed that is a copy of the command is left out: its array of times is the same object.
    """
    names = sorted(commanded_thrusters(c))
    both = [(n, c[command_of(n)], c[shaft_speed_of(n)]) for n in names if shaft_speed_of(n) in c]
    return [
        ShaftTrace(n, shaft.t, shaft.value, command.t, command.value, float(shaft.t[-1]))
        for n, command, shaft in both
        if shaft.t is not command.t  # the same clock: a copy of the command, not a measurement
    ]


def thrust_response_curves(c: Channels, sides: Mapping[str, float]) -> list[ThrustResponseCurve]:
    """Return the curves of yaw rate and surge speed as measured and as expected from the thrust.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    sides
        Position of each thruster to starboard [m].

    Returns
    -------
    list
        Empty if the log has no thrust or no motion, or if these overlap for less than 15 s. There is no curve of the
        yaw rate if all thrusters are in the middle of the boat, and no curve of a motion whose thrust or moment is
        constant.
    """
    forces = thruster_forces(c, sides)
    if forces is None:
        return []
    found: list[ThrustResponseCurve] = []
    if forces.side.any():
        r = best_turn_rate(c, forces.edges)
        if r is not None:
            found.append(_response_curve("yaw rate", "rad/s", forces, r, forces.f @ forces.side, YAW_LAGS))
    if (u := surge_speed(c, forces.t)) is not None:
        found.append(_response_curve("speed ahead over ground", "m/s", forces, u, forces.f.sum(axis=1), SURGE_LAGS))
    return [row for row in found if np.isfinite(row.expected).any()]


def _response_curve(
    title: str, unit: str, forces: ThrusterForces, y: Array, f: Array, lags: Sequence[float]
) -> ThrustResponseCurve:
    """Return a measured motion y (n,) and its expected response to the thrust or moment f (n,), as a curve to plot.

    The response passes a first-order lag with the best of the time constants ``lags`` [s]. The response is NaN if f is
    constant. ``forces`` gives the times (n,). Times at which y is NaN are left out.
    """
    measured = np.isfinite(y)  # a course is NaN while the boat is too slow
    filled = fill_gaps(forces.t, y)
    expected = delayed_forces(filled, f, lags) if np.ptp(f) > 0.0 else np.full(y.size, np.nan)
    return ThrustResponseCurve(title, unit, forces.t[measured], y[measured], expected[measured])


def sensor_pairs(c: Channels) -> list[SensorPair]:
    """Return each motion that two sensors measure: yaw rate by heading and gyro, velocity by positions and receiver.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.

    Returns
    -------
    list
        Yaw rate, velocity north and velocity east, as far as two sensors measure them at the same time; empty if no
        motion is measured twice. A heading in degrees (a value above 7) is unwrapped as such, but not converted to
        radians.
    """
    found = []
    if {"psi", "r"} <= set(c):
        in_radians = np.abs(c["psi"].value).max() < 7.0  # a little more than a turn
        heading = np.unwrap(c["psi"].value, period=2.0 * np.pi if in_radians else 360.0)
        names = ("change of heading over 1 s", "gyro")
        found.append(_rate_pair("yaw rate", "rad/s", names, (Channel(c["psi"].t, heading), c["r"]), WINDOW))
    for axis, position, velocity in (("north", "x", "vx"), ("east", "y", "vy")):
        if {position, velocity} <= set(c):
            names = ("change of position over 5 s", "reported by the receiver")
            found.append(_rate_pair(f"velocity {axis}", "m/s", names, (c[position], c[velocity]), POSITION_WINDOW_S))
    return [row for row in found if row.t.size > 1]


def _rate_pair(
    title: str, unit: str, names: tuple[str, str], both: tuple[Channel, Channel], window: float
) -> SensorPair:
    """Return a motion by two sensors: the change of a signal over a window, and the mean of its measured rate.

    Both are rates at the middle of the window.

    Parameters
    ----------
    title, unit, names
        Name and unit of the motion, and the names of both sensors, for the plot.
    both
        The signal, for example a position, and its measured rate.
    window
        Duration [s] of the moving window.

    Returns
    -------
    SensorPair
        Without samples if the two sensors overlap for less than the window.
    """
    whole, rate = both
    start, end = max(whole.t[0], rate.t[0]), min(whole.t[-1], rate.t[-1])
    t = np.arange(start, end - window, 2.0 * SENSOR_GRID_S)
    grid = np.arange(start, end, SENSOR_GRID_S)
    of_rate = np.interp(grid, rate.t, rate.value)
    integral = np.append(0.0, np.cumsum(0.5 * SENSOR_GRID_S * (of_rate[1:] + of_rate[:-1]))) if grid.size else grid
    one = (np.interp(t + window, whole.t, whole.value) - np.interp(t, whole.t, whole.value)) / window
    other = (np.interp(t + window, grid, integral) - np.interp(t, grid, integral)) / window if grid.size else t
    return SensorPair(title, unit, names, t + window / 2, one, other)


def _signal_curves(c: Channels) -> list[SignalCurve]:
    """Return the curves of at most 12 signals: those of `SHOWN` (motion and force) first, then all other signals.

    Roll, pitch, their rates, the speed along the track, and commands, shaft speeds and thrusts of thrusters are left
    out.
    """
    others = [n for n in c if n not in SHOWN + NOT_SHOWN and not is_of_thruster(n, *INPUTS)]
    names = [*(n for n in SHOWN if n in c), *others][:MAX_SIGNALS_SHOWN]
    return [SignalCurve(n, c[n].unit, c[n].t, c[n].value, n == "psi") for n in names]


# Positions to starboard [m] of the thrusters of an imported log. Only their signs count: the map names the sides only.
IMPORTED = {"left": -1.0, "right": 1.0}
# Faults that make the result of a fit meaningless: frames, signs, units, sides, time, and signals that do not measure.
SPOILING = frozenset({
    "time-scale", "times-not-increasing", "lost-zeros", "clock-jumps", "clock-ran-back",
    "angle-in-degrees", "n-out-of-range", "positions-in-degrees", "velocity-unit", "velocity-and-acceleration-scale",
    "gyro-scale", "shaft-speed-in-rad-per-s", "shaft-speed-scale", "shaft-sign-reversed",
    "heading-sense", "heading-offset", "heading-half-turn", "gyro-sign-reversed", "position-axes", "velocity-axes",
    "position-and-velocity-axes", "frames-mirrored", "velocity-earth-fixed", "velocity-body-fixed",
    "body-velocity-axes", "acceleration-axes",
    "thruster-sides-swapped", "thruster-sign-reversed", "channel-frozen", "channel-constant", "sensor-stuck",
    "log-copied", "rows-left-out", "position-jumps", "shaft-speed-wrapped", "shaft-speed-one-sided", "two-sensors",
    "inputs-constant", "shaft-speed-stuck", "telemetry-exchanged", "gyro-wrapped", "times-jump",
})  # fmt: skip
# Those of them that concern the telemetry of the shafts alone: a model with the commands as inputs does not use it.
OF_SHAFT_TELEMETRY = frozenset({
    "shaft-speed-in-rad-per-s", "shaft-speed-scale", "shaft-sign-reversed", "shaft-speed-wrapped",
    "shaft-speed-one-sided", "shaft-speed-stuck", "telemetry-exchanged",
})  # fmt: skip
# Warnings of the device checks that every fit repeats.
FIT_WARNINGS = ("input-missing", "rpm-max-missing", "sections-missing", "mass-of-length", "arm-of-length")
# A log is a copy if this share of its triples of neighbouring values also occurs in another log. A signal with fewer
# triples is not compared.
COPIED_SHARE, MIN_TRIPLES = 0.5, 50


def invalidates_fit(finding: Finding, uses_shaft_speeds: bool = True) -> bool:
    """Return whether the result of a fit to a log with this finding is meaningless.

    This holds for faults of frames, signs, units, sides and time, and of signals that do not measure (`SPOILING`).

    Parameters
    ----------
    finding
        Finding of any check.
    uses_shaft_speeds
        Whether the model uses the shaft speeds of the log. False: faults of their telemetry do not matter.
    """
    spoils = finding.level == FAULT and finding.code in SPOILING
    return spoils and (uses_shaft_speeds or finding.code not in OF_SHAFT_TELEMETRY)


class LogChecks:
    """Checks of the motion in several logs, and of differences between them. Each log is read once.

    The held commands of a checked log with the shaft speeds that they reached, the angle of its heading, and the delay
    between its sensors are kept for the comparison.
    """

    def __init__(self) -> None:
        """Begin without a log."""
        self._held: list[tuple[Path, str, Mapping[str, Held]]] = []
        self._headings: list[HeadingAngle | None] = []
        self._delays: list[SensorDelay | None] = []

    def check(self, path: Path | str, window: TimeWindow = WHOLE) -> list[Finding]:
        """Return the findings of one log on its signals, and on speed controllers that sent no telemetry.

        The checks of the devices are not included (`device_faults`). A log that cannot be read gives the warning
        ``log-not-readable`` alone, not an error.

        Parameters
        ----------
        path
            File or folder of the log.
        window
            Interval of time of the log to check. Times in the findings count from the start of the log.
        """
        try:
            with open_log(path) as log:
                found, _ = _signals_in(log, window)
                names = _check_names(log.sources(Scalar))
                sides = sides_of(log)
                findings = [*_silent_controllers(log), *names, *_check_segments(found, sides, log.start)]
        except SeatrialError as error:
            return [Finding("warning", "log-not-readable", "motion", Path(path).name, str(error))]
        self._held.append((Path(path), window.label, held_of_thrusters(found)))
        # With wrong axes, signs or units the angle and the delay have no meaning.
        usable = not any(map(invalidates_fit, findings))
        self._headings.append(heading_angle(found) if usable else None)
        self._delays.append(sensor_delay_of(_longest_segment(found), sides) if usable else None)
        return findings

    def differences(self) -> list[tuple[str, Finding]]:
        """Return the findings of the checked logs together, each with the name of its log or the number of logs.

        They are shafts whose speed at equal commands differs, another angle of the heading sensor, and the mean of the
        delays between attitude and velocity.
        """
        names = [path.stem + window for path, window, _ in self._held]
        if len(set(names)) < len(names):
            names = [str(path) + window for path, window, _ in self._held]
        gains = compare_shaft_gains([(name, held) for name, (_, _, held) in zip(names, self._held, strict=True)])
        headings = compare_headings(list(zip(names, self._headings, strict=True)))
        delays = compare_sensor_delays(list(zip(names, self._delays, strict=True)))
        return [*gains, *headings, *delays]


def _longest_segment(c: Channels) -> Channels:
    """Return the signals of the longest segment between the gaps of a log; all signals of a log without gaps."""
    gaps = silent_times(c)
    return max(_segments(c, gaps), key=_duration, default={}) if gaps else c


def _segments(c: Channels, gaps: Sequence[tuple[float, float]]) -> list[Channels]:
    """Return the signals of each segment between the gaps of a log, without segments that are too short to check."""
    return [part for part in parts_between(c, gaps) if part and _duration(part) >= SHORTEST_PIECE_S]


def _check_names(signals: Iterable[str]) -> Iterator[Finding]:
    """Yield a warning ``signal-name`` for each imported signal with another name than the built-in models use."""
    for name, advice in unknown_names(signals).items():
        if advice:
            yield Finding(WARNING, "signal-name", "names", name, "no model uses a signal of this name", advice)


def _check_segments(c: Channels, sides: Mapping[str, float], start: float) -> list[Finding]:
    """Return the worst finding of each check over the segments of a log between its gaps, as a fit uses them.

    Parameters
    ----------
    c
        Channels of the whole log by name.
    sides
        Position of each thruster to starboard [m].
    start
        Start of the log [s], from which the times in the findings count.

    Returns
    -------
    list
        For each pair of check and signal the worst finding; of equal ones that of the longest segment. Warnings and
        faults get the times of their segment before the text. Segments shorter than 10 s are not checked. For a log
        without gaps, all findings are returned as they are.
    """
    gaps = silent_times(c)
    if not gaps:
        return list(check_signals(c, sides))
    worst: dict[tuple[str, str], Finding] = {}
    # Of equal findings, that of the longest segment is kept.
    for part in sorted(_segments(c, gaps), key=_duration, reverse=True):
        begin, end = (seconds(t - start) for t in _time_span(part))
        for finding in check_signals(part, sides):
            key = finding.check, finding.where
            if finding.is_problem:
                finding = finding._replace(text=f"from {begin} to {end} s: {finding.text}")
            if key not in worst or worst_first([worst[key], finding])[0] is not worst[key]:
                worst[key] = finding
    return list(worst.values())


def _time_span(c: Channels) -> tuple[float, float]:
    """Return the times [s] of the first and the last sample of all channels, of which there is at least one."""
    return min(float(x.t[0]) for x in c.values()), max(float(x.t[-1]) for x in c.values())


def _duration(c: Channels) -> float:
    """Return the time [s] from the first to the last sample of all channels, of which there is at least one."""
    begin, end = _time_span(c)
    return end - begin


def check_signals(c: Channels, sides: Mapping[str, float], known_noise: Collection[str] = ()) -> Iterator[Finding]:
    """Yield the findings of all checks of the signals.

    Parameters
    ----------
    c
        Channels of a log (`seatrial.ident.data.channels`).
    sides
        Position of each thruster to starboard [m].
    known_noise
        Signals whose noise the user has given to the fit; a check before a fit does not report them as smoothed.

    Yields
    ------
    Finding
        In the order of the checks: time, outliers, exchanged telemetry, ranges, sensors, shafts, frames, motion,
        delays.

    Notes
    -----
    Some checks are skipped if a signal that they rely on has a fault. Their findings would name the wrong cause. A
    signal in a wrong unit is not compared with others. A fault of the sample times ends all checks at once, and a wrong
    time scale or exchanged telemetry ends those that would follow.
    """
    found = list(check_intervals(c))
    yield from found
    if found:
        return
    of_outliers = list(check_outliers(c))
    yield from of_outliers
    if any(f.code == "position-jumps" for f in of_outliers):
        # The checks below would explain the jumps by another unit, axis or clock.
        c = {name: channel for name, channel in c.items() if name not in ("x", "y")}
    of_wraps = list(check_wrapped(c))
    # A wrapped speed is also out of range. The check of ranges would report a wrong unit, but the unit is right.
    wraps = {f.where for f in of_wraps}
    if "r" in wraps:
        c = {name: channel for name, channel in c.items() if name != "r"}
    yield from check_thrust_present(c)
    unwrapped = {n: x for n, x in c.items() if n not in wraps}
    exchanged = list(check_exchanged_telemetry(unwrapped))
    yield from exchanged  # before its consequences
    ranges = [*of_wraps, *(f for f in check_ranges(c) if f.where not in wraps)]
    in_wrong_unit = {n for f in ranges if f.level == FAULT and f.check == "units" for n in f.where.split(", ")}
    of_inputs = [*check_inputs(unwrapped), *check_frozen_force(c)]
    # Against the command of another thruster, or in another unit, a speed that follows its command would be stuck.
    not_comparable = in_wrong_unit | {shaft_speed_of(side) for f in exchanged for side in f.where.split(" and ")}
    of_inputs = [f for f in of_inputs if f.code != "shaft-speed-stuck" or f.where not in not_comparable]
    ranges += [*check_frozen(c), *check_alternating(c), *of_inputs]
    yield from ranges
    yield from check_smoothing(c, known_noise)
    yield from check_quantised(c)
    yield from check_held(c)
    yield from check_held_inputs(c)
    # A signal in a wrong unit would accuse the right one with which it is compared. A yaw rate accuses itself: its
    # comparison with the heading shows whether both are in degrees.
    c = {name: channel for name, channel in c.items() if name not in in_wrong_unit - {"r"}}
    matches = sensor_matches(c)
    clock = check_time_scale(matches)
    if clock is not None:
        yield clock
        return
    of_sensors = [
        *gyro_and_heading(c, matches.heading),
        *velocity_and_acceleration(c, matches.velocity),
        *position_and_velocity(c, matches.position),
    ]
    # Wrong axes explain it better, if they are found below.
    disagreeing = [f for f in of_sensors if f.code == "position-and-velocity-disagree"]
    yield from (f for f in of_sensors if f not in disagreeing)
    if exchanged:  # The telemetry of another thruster cannot show the sign, the response or the side of this one.
        yield from disagreeing
        return
    one_sided = one_sided_shafts({n: x for n, x in c.items() if n not in wraps})
    yield from one_sided.values()
    # Zero speed in one direction would look like a dead band.
    stuck = {f.where for f in of_inputs if f.code == "shaft-speed-stuck"}
    wrong = {*one_sided, *(SignalId.parse(n).source for n in wraps | stuck)}
    right = {n: x for n, x in c.items() if SignalId.parse(n).source not in wrong}
    of_shafts = list(check_shafts(right))
    yield from of_shafts
    scaled = {f.where for f in of_shafts if f.level == FAULT and f.check == "units"}
    yield from check_shaft_scale({n: x for n, x in right.items() if SignalId.parse(n).source not in scaled})
    faulty = {f.where for f in of_shafts if f.is_problem}  # a shaft that is limited or drops out has no slope
    yield from check_shaft_gain({n: x for n, x in right.items() if SignalId.parse(n).source not in faulty})
    wrong_inputs = [*of_wraps, *one_sided.values()]
    if wrong_inputs or any(f.level == FAULT and f.check in ("units", "stuck", "alike") for f in (*ranges, *of_sensors)):
        yield from disagreeing
        return
    of_frames = list(check_frames(c, matches.heading, turning_signs(c, sides)))
    yield from of_frames or disagreeing
    of_motion = [] if of_frames else list(check_motion(c, sides, {f.where for f in of_shafts if f.check == "dead"}))
    yield from of_motion
    if not of_frames and not any(f.level == FAULT for f in of_motion):
        yield from check_latency(c, sides)
        yield from check_clock_step(c, sides)
    if not of_frames and not any(f.is_problem for f in of_motion):
        yield from check_accelerometer(c, matches.velocity)


def device_faults(log: Log) -> list[Finding]:
    """Return the findings on devices that concern a fit.

    Parameters
    ----------
    log
        An open log.

    Returns
    -------
    list
        Faults of devices, commanded thrusters without telemetry, and the warnings ``input-missing``,
        ``rpm-max-missing`` and ``sections-missing``.
    """
    return [f for f in (*check_devices(log), *_silent_controllers(log)) if f.level == FAULT or f.code in FIT_WARNINGS]


def check_copies(logs: Sequence[tuple[str, Channels]]) -> list[Finding]:
    """Return a finding for each log that is a copy or a part of a log before it, or contains such a log.

    Parameters
    ----------
    logs
        Name and channels of each log.

    Returns
    -------
    list
        Faults ``log-copied``, at most one for each log, in the order of the logs.

    Notes
    -----
    Measurement noise never repeats. Equal sequences of samples therefore come from the same run. A log is a copy if,
    for the median signal (of r, psi, x, y, vx, ax, u and force), more than half of the triples of neighbouring values
    also occur in the other log. The share refers to the log with fewer triples. Signals with 50 triples or fewer are
    not compared.
    """
    earlier: list[tuple[str, dict[str, NDArray[np.uint64]]]] = []
    found = []
    for name, c in logs:
        own = {n: _hashed_triples(c[n].value) for n in ("r", "psi", "x", "y", "vx", "ax", "u", "force") if n in c}
        own = {n: triples for n, triples in own.items() if triples.size > MIN_TRIPLES}
        for earlier_name, earlier_triples in earlier:
            same = {
                n: np.intersect1d(own[n], earlier_triples[n], assume_unique=True).size
                for n in own
                if n in earlier_triples
            }
            shares = [size / min(own[n].size, earlier_triples[n].size) for n, size in same.items()]
            if shares and np.median(shares) > COPIED_SHARE:
                text = f"contains the same measurements as {earlier_name}: a copy gives no new information"
                found.append(Finding(FAULT, "log-copied", "log", name, text, "give a log of another run"))
                break
        earlier.append((name, own))
    return found


def _hashed_triples(value: Array) -> NDArray[np.uint64]:
    """Return the distinct hashes (m,), sorted, of all triples of neighbouring samples of a signal (n,).

    Triples with equal neighbours are left out. The result is empty for fewer than three samples.
    """
    bits = np.ascontiguousarray(value, dtype=np.float64).view(np.uint64)
    # Multiply by the golden ratio in 64 bits: the low bits of rounded values are zero and must be filled.
    mixed = (bits ^ bits >> np.uint64(31)) * np.uint64(0x9E3779B97F4A7C15)
    mixed ^= mixed >> np.uint64(29)
    moving = value[1:] != value[:-1]
    hashes = (mixed[:-2] * np.uint64(3) + mixed[1:-1]) * np.uint64(5) + mixed[2:]
    return np.unique(hashes[moving[1:] & moving[:-1]])


def sides_of(log: Log) -> dict[str, float]:
    """Return the position of each thruster to starboard [m] by the rig of the log.

    An imported log has no rig; its thrusters are called left and right, and only the side is known (-1 m and +1 m).

    Parameters
    ----------
    log
        An open log.
    """
    rig = log.rig
    return {t.name: t.position_m[1] for t in rig.thrusters} if rig else IMPORTED


def _silent_controllers(log: Log) -> Iterator[Finding]:
    """Yield a fault for each commanded thruster whose speed controller sent no telemetry.

    Thrusters behind an autopilot, and logs without a rig, are not checked.
    """
    rig = log.rig
    for thruster in rig.thrusters if rig else ():
        device, node = thruster.device, thruster.node
        if thruster.output is None and node in log.nodes(Command, device) and node not in log.nodes(Esc, device):
            text = "the thruster is commanded, but its controller sends no telemetry"
            advice = "check power and cable of the controller, and `node` of the thruster in the rig file"
            yield Finding("fault", "controller-never-heard", "dead", thruster.name, text, advice)
