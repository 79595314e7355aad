"""Checks of a log before any fit, by the motion in it: part of `seatrial check`, and what every fit of a boat begins
with.

Evidence of a check, as curves for its page: sample intervals, signals, shafts, and motion against thrust.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import FAULT, OK, Finding, check_devices, worst_first
from seatrial.daq.errors import SeatrialError
from seatrial.daq.log import Log, open_log
from seatrial.daq.samples import Ahrs, Command, Esc, Gnss, LoadCell, Scalar
from seatrial.ident.checks.frames import check_accelerometer, check_frames
from seatrial.ident.checks.held import check_held, check_held_inputs
from seatrial.ident.checks.inputs import check_exchanged_telemetry, check_frozen_force, check_inputs
from seatrial.ident.checks.latency import check_latency
from seatrial.ident.checks.motion import (
    SURGE_LAGS,
    YAW_LAGS,
    ThrusterForces,
    ahead,
    best_turn_rate,
    check_motion,
    delayed_forces,
    fill_gaps,
    thruster_forces,
    turning,
)
from seatrial.ident.checks.outliers import check_outliers
from seatrial.ident.checks.sensors import (
    STEP,
    WINDOW,
    Channels,
    check_time_scale,
    gyro_and_heading,
    position_and_velocity,
    sensor_matches,
    velocity_and_acceleration,
)
from seatrial.ident.checks.shaft_sign import check_wrapped, one_sided_shafts
from seatrial.ident.checks.shafts import check_shafts
from seatrial.ident.checks.signals import (
    check_alternating,
    check_frozen,
    check_intervals,
    check_quantised,
    check_ranges,
    check_smoothing,
)
from seatrial.ident.data import SHORTEST_PIECE_S, Channel, channels, parts_between, seconds, silent_times
from seatrial.ident.numerics import Array

POSITION_WINDOW = 5.0  # s, over which positions are differenced, as the check does
# Signals of a log in the order of showing; whatever else an imported one holds comes after them.
SHOWN = ("psi", "r", "ax", "ay", "x", "y", "vx", "vy", "force")
MOST_SIGNALS = 12
ELSEWHERE = ("phi", "theta", "p", "q", "speed")  # said by others; thrusters have a plot of their own


@dataclass(frozen=True)
class SampleIntervals:
    """Seconds between neighbouring samples of a device: ``interval`` (n,) at the times ``t`` (n,) of the later ones;
    ``expected``: by the rig's rate, None without one."""

    source: str
    t: Array
    interval: Array
    expected: float | None

    def between(self, begin: float, end: float) -> SampleIntervals:
        """The intervals that end in a part of the log [s]; that from before the part is none of its own."""
        own = (self.t > begin) & (self.t <= end) & (self.t - self.interval >= begin)
        return replace(self, t=self.t[own], interval=self.interval[own])


@dataclass(frozen=True)
class ShaftResponse:
    """Shaft speed ``n`` (n,) at times ``t``, and its command ``n_command`` (m,) at ``t_command``, each held until the
    next one; both are parts of full speed. ``end`` [s]: of the shaft's samples."""

    name: str
    t: Array
    n: Array
    t_command: Array
    n_command: Array
    end: float


@dataclass(frozen=True)
class PushResponseCurve:
    """A motion as it was ``measured`` and as the thrusters' push would have it, ``expected``: (n,) at times ``t``."""

    title: str
    unit: str
    t: Array
    measured: Array
    expected: Array


@dataclass(frozen=True)
class SensorPair:
    """One motion by two sensors, ``one`` and ``other`` (n,) at times ``t`` (n,); ``names``: of both, for people."""

    title: str
    unit: str
    names: tuple[str, str]
    t: Array
    one: Array
    other: Array


@dataclass(frozen=True)
class SignalCurve:
    """The ``value`` (n,) of a channel at times ``t`` (n,), as it came; ``angle``: it is one, and may jump by a turn."""

    channel: str
    unit: str
    t: Array
    value: Array
    angle: bool


@dataclass(frozen=True)
class CheckEvidence:
    """Curves of one log; all times [s] count from its start. ``rig``: the name of the rig in it, None without one."""

    name: str
    duration: float
    rig: str | None
    intervals: tuple[SampleIntervals, ...] = ()
    shafts: tuple[ShaftResponse, ...] = ()
    push: tuple[PushResponseCurve, ...] = ()
    sensors: tuple[SensorPair, ...] = ()
    signals: tuple[SignalCurve, ...] = ()


def log_evidence(path: Path, name: str = "") -> list[CheckEvidence]:
    """Curves of one log, of each part between its gaps; ``name``: for people, else the file's. Raises SeatrialError
    where it is no log at all."""
    with open_log(path) as log:
        signals = channels(log)
        rig = log.rig
        duration, intervals, sides, start = log.duration, _intervals(log), sides_of(log), log.start
    gaps, found = silent_times(signals), []
    for signals_of_part in parts_between(signals, gaps):
        c = {n: Channel(s.t - start, s.value, s.unit, s.source) for n, s in signals_of_part.items()}
        begin, end = _span(c) if gaps and c else (0.0, duration)
        own = [row.between(begin, end) for row in intervals] if gaps else intervals
        found.append(CheckEvidence(
            f"{name or path.stem}[{seconds(begin)}:{seconds(end)}]" if gaps else name or path.stem, end - begin,
            rig.name if rig else None, tuple(row for row in own if row.t.size), tuple(_shafts(c)),
            tuple(push(c, sides)), tuple(sensors(c)), tuple(_signals(c)),
        ))  # fmt: skip
    return found


def _intervals(log: Log) -> list[SampleIntervals]:
    rig = log.rig
    expected = {d.name: 1.0 / d.rate_hz for d in rig.devices} if rig else {}
    found: list[SampleIntervals] = []
    for kind in (Ahrs, Gnss, LoadCell, Scalar):
        for source in log.sources(kind):
            if kind is not Scalar or log.role(source) == "output":
                found.append(_interval(source, log.table(kind, source)["t"], log.start, expected.get(source)))
    for source in log.sources(Esc):
        nodes = log.nodes(Esc, source)
        t = np.sort(np.concatenate([log.table(Esc, source, node)["t"] for node in nodes]))
        found.append(_interval(source, t, log.start, expected.get(source)))
    return [row for row in found if row.t.size]


def _interval(source: str, t: Array, start: float, expected: float | None) -> SampleIntervals:
    return SampleIntervals(source, t[1:] - start, np.diff(t), expected)


def _shafts(c: Channels) -> list[ShaftResponse]:
    """Each thruster that has both a command and a speed."""
    names = [n.removeprefix("n_cmd_") for n in sorted(c) if n.startswith("n_cmd_")]
    both = [(n, c[f"n_cmd_{n}"], c[f"n_{n}"]) for n in names if f"n_{n}" in c]
    return [
        ShaftResponse(n, shaft.t, shaft.value, told.t, told.value, float(shaft.t[-1]))
        for n, told, shaft in both
        if shaft.t is not told.t
    ]


def push(c: Channels, sides: Mapping[str, float]) -> list[PushResponseCurve]:
    """Yaw rate and speed ahead, measured and as the thrusters' push would have them; ``sides``: m to starboard."""
    given = thruster_forces(c, sides)
    if given is None:
        return []
    found: list[PushResponseCurve] = []
    if given.side.any():
        r = best_turn_rate(c, given.edges)
        if r is not None:
            found.append(_pushed("yaw rate", "rad/s", given, r, given.f @ given.side, YAW_LAGS))
    if (u := ahead(c, given.t)) is not None:
        found.append(_pushed("speed ahead over ground", "m/s", given, u, given.f.sum(axis=1), SURGE_LAGS))
    return [row for row in found if np.isfinite(row.expected).any()]


def _pushed(
    title: str, unit: str, given: ThrusterForces, y: Array, f: Array, lags: Sequence[float]
) -> PushResponseCurve:
    there = np.isfinite(y)  # not where the boat is too slow for a course
    filled = fill_gaps(given.t, y)
    expected = delayed_forces(filled, f, lags) if np.ptp(f) > 0.0 else np.full(y.size, np.nan)
    return PushResponseCurve(title, unit, given.t[there], y[there], expected[there])


def sensors(c: Channels) -> list[SensorPair]:
    """What two sensors say of one motion: turning by heading and gyro, velocity by positions and by itself."""
    found = []
    if {"psi", "r"} <= set(c):
        in_radians = np.abs(c["psi"].value).max() < 7.0
        heading = np.unwrap(c["psi"].value, period=2.0 * np.pi if in_radians else 360.0)
        names = ("of the heading over 1 s", "of the gyro")
        found.append(_pair("yaw rate", "rad/s", names, (Channel(c["psi"].t, heading), c["r"]), WINDOW))
    for where, way, speed in (("north", "x", "vx"), ("east", "y", "vy")):
        if {way, speed} <= set(c):
            names = ("of the positions over 5 s", "as the receiver says")
            found.append(_pair(f"velocity {where}", "m/s", names, (c[way], c[speed]), POSITION_WINDOW))
    return [row for row in found if row.t.size > 1]


def _pair(title: str, unit: str, names: tuple[str, str], both: tuple[Channel, Channel], window: float) -> SensorPair:
    """The change of one signal over a window against the mean of its rate in that window, at the window's middle."""
    whole, rate = both
    start, end = max(whole.t[0], rate.t[0]), min(whole.t[-1], rate.t[-1])
    t = np.arange(start, end - window, 2.0 * STEP)
    grid = np.arange(start, end, STEP)
    of_rate = np.interp(grid, rate.t, rate.value)
    integral = np.append(0.0, np.cumsum(0.5 * STEP * (of_rate[1:] + of_rate[:-1]))) if grid.size else grid
    one = (np.interp(t + window, whole.t, whole.value) - np.interp(t, whole.t, whole.value)) / window
    other = (np.interp(t + window, grid, integral) - np.interp(t, grid, integral)) / window if grid.size else t
    return SensorPair(title, unit, names, t + window / 2, one, other)


def _signals(c: Channels) -> list[SignalCurve]:
    """Every sensor's values as they came."""
    others = [n for n in c if n not in SHOWN and n not in ELSEWHERE and not n.startswith(("n_", "f_"))]
    names = [*(n for n in SHOWN if n in c), *others][:MOST_SIGNALS]
    return [SignalCurve(n, c[n].unit, c[n].t, c[n].value, n == "psi") for n in names]


# Starboard positions (m) of an imported log's thrusters, of which only the side is known.
IMPORTED = {"left": -1.0, "right": 1.0}
# Faults after which a fit means nothing: frames, signs, units, sides, time, and signals that measure nothing.
SPOILING = frozenset({
    "time-scale", "times-not-increasing", "lost-zeros", "clock-jumps", "clock-ran-back",
    "angle-in-degrees", "n-out-of-range", "positions-in-degrees", "velocity-unit", "velocity-and-acceleration-scale",
    "gyro-scale", "shaft-speed-in-rad-per-s", "shaft-speed-scale", "shaft-sign-reversed",
    "heading-sense", "heading-offset", "heading-half-turn", "gyro-sign-reversed", "position-axes", "velocity-axes",
    "position-and-velocity-axes", "frames-mirrored", "velocity-earth-fixed", "body-velocity-axes", "acceleration-axes",
    "thruster-sides-swapped", "thruster-sign-reversed", "channel-frozen", "channel-constant", "sensor-stuck",
    "log-copied", "rows-left-out", "position-jumps", "shaft-speed-wrapped", "shaft-speed-one-sided", "two-sensors",
    "inputs-constant", "shaft-speed-stuck", "telemetry-exchanged", "gyro-wrapped", "times-jump",
})  # fmt: skip
OF_INPUTS = ("input-missing", "rpm-max-missing")  # warnings on devices that each fit repeats
COPIED, FEWEST_TRIPLES = 0.5, 50  # part of a log's triples of neighbouring values that another log has, too


def spoils_a_fit(finding: Finding) -> bool:
    """Whether a fit to a log with this finding means nothing."""
    return finding.level == FAULT and finding.code in SPOILING


def check_log(path: Path | str) -> list[Finding]:
    """Findings of one log; that its signals cannot be read is one, too."""
    try:
        with open_log(path) as log:
            found = channels(log)
            return [*_mute(log), *_check_parts(found, sides_of(log), log.start)]
    except SeatrialError as error:
        return [Finding("warning", "log-not-readable", "motion", Path(path).name, str(error))]


def _check_parts(c: Channels, sides: Mapping[str, float], start: float) -> list[Finding]:
    """Check each part of a log between its gaps, as a fit uses them, and return the worst answer to each question.

    start: of the log [s], from which the times in the answers count.
    """
    gaps = silent_times(c)
    if not gaps:
        return list(check_signals(c, sides))
    worst: dict[tuple[str, str], Finding] = {}
    parts = [part for part in parts_between(c, gaps) if part and _duration(part) >= SHORTEST_PIECE_S]
    for part in sorted(parts, key=_duration, reverse=True):  # of equal answers, that of the longest part
        begin, end = (seconds(t - start) for t in _span(part))
        for finding in check_signals(part, sides):
            key = finding.check, finding.where
            if finding.level != OK:
                finding = finding._replace(text=f"from {begin} to {end} s: {finding.text}")
            if key not in worst or worst_first([worst[key], finding])[0] is not worst[key]:
                worst[key] = finding
    return list(worst.values())


def _span(c: Channels) -> tuple[float, float]:
    return min(float(x.t[0]) for x in c.values()), max(float(x.t[-1]) for x in c.values())


def _duration(c: Channels) -> float:
    begin, end = _span(c)
    return end - begin


def check_signals(c: Channels, sides: Mapping[str, float]) -> Iterator[Finding]:
    """Findings of channels (seatrial.ident.data.loading); ``sides``: thruster -> position to starboard [m].

    What needs another signal to be right is not asked where that one is wrong: time, units, frames, thrusters.
    """
    found = list(check_intervals(c))
    yield from found
    if found:
        return
    of_outliers = list(check_outliers(c))
    yield from of_outliers
    if any(f.code == "position-jumps" for f in of_outliers):
        # Such positions would be taken for another unit, axis or clock.
        c = {name: channel for name, channel in c.items() if name not in ("x", "y")}
    of_wraps = list(check_wrapped(c))
    # A wrapped speed is out of range, too; its unit is right.
    wraps = {f.where for f in of_wraps}
    if "r" in wraps:
        c = {name: channel for name, channel in c.items() if name != "r"}
    of_inputs = [*check_inputs({n: x for n, x in c.items() if n not in wraps}), *check_frozen_force(c)]
    ranges = [*of_wraps, *(f for f in check_ranges(c) if f.where not in wraps), *check_frozen(c)]
    ranges += [*check_alternating(c), *of_inputs]
    yield from ranges
    yield from check_smoothing(c)
    yield from check_quantised(c)
    yield from check_held(c)
    yield from check_held_inputs(c)
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
    yield from of_sensors
    unwrapped = {n: x for n, x in c.items() if n not in wraps}
    # Neither a direction, nor a shaft, nor a side can be judged by the telemetry of another thruster.
    exchanged = list(check_exchanged_telemetry(unwrapped))
    yield from exchanged
    if exchanged:
        return
    one_sided = one_sided_shafts(unwrapped)
    yield from one_sided.values()
    # Half of the directions would be taken for a dead band.
    wrong = {*one_sided, *(n.removeprefix("n_") for n in wraps)}
    wrong |= {f.where.removeprefix("n_") for f in of_inputs if f.code == "shaft-speed-stuck"}
    of_shafts = list(check_shafts({n: x for n, x in c.items() if n.removeprefix("n_cmd_") not in wrong}))
    yield from of_shafts
    wrong_inputs = [*of_wraps, *one_sided.values()]
    if wrong_inputs or any(f.level == FAULT and f.check in ("units", "stuck", "alike") for f in (*ranges, *of_sensors)):
        return
    of_frames = list(check_frames(c, matches.heading, turning(c, sides)))
    yield from of_frames
    of_motion = [] if of_frames else list(check_motion(c, sides, {f.where for f in of_shafts if f.check == "dead"}))
    yield from of_motion
    if not of_frames and not any(f.level == FAULT for f in of_motion):
        yield from check_latency(c, sides)
    if not of_frames and all(f.level == "ok" for f in of_motion):
        yield from check_accelerometer(c, matches.velocity)


def device_faults(log: Log) -> list[Finding]:
    """Faults of a log's devices, thrusters of which nothing was heard, and warnings on the inputs of a fit."""
    return [f for f in (*check_devices(log), *_mute(log)) if f.level == FAULT or f.code in OF_INPUTS]


def check_copies(logs: Sequence[tuple[str, Channels]]) -> list[Finding]:
    """Logs (name, channels) that are copies, or parts, of one before them: measured noise never repeats."""
    known: list[tuple[str, dict[str, NDArray[np.uint64]]]] = []
    found = []
    for name, c in logs:
        own = {n: _triples(c[n].value) for n in ("r", "psi", "x", "y", "vx", "ax", "u", "force") if n in c}
        own = {n: triples for n, triples in own.items() if triples.size > FEWEST_TRIPLES}
        for other, its in known:
            same = {n: np.intersect1d(own[n], its[n], assume_unique=True).size for n in own if n in its}
            shares = [size / min(own[n].size, its[n].size) for n, size in same.items()]
            if shares and np.median(shares) > COPIED:
                text = f"the same measurements as in {other}: a copy proves nothing"
                found.append(Finding(FAULT, "log-copied", "log", name, text, "give a log of another run"))
                break
        known.append((name, own))
    return found


def _triples(value: Array) -> NDArray[np.uint64]:
    """Hashes, each once, of three neighbouring values (n,) each, where they differ."""
    bits = np.ascontiguousarray(value, dtype=np.float64).view(np.uint64)
    mixed = (bits ^ bits >> np.uint64(31)) * np.uint64(0x9E3779B97F4A7C15)  # of rounded values the low bits are zero
    mixed ^= mixed >> np.uint64(29)
    moving = value[1:] != value[:-1]
    hashes = (mixed[:-2] * np.uint64(3) + mixed[1:-1]) * np.uint64(5) + mixed[2:]
    return np.unique(hashes[moving[1:] & moving[:-1]])


def sides_of(log: Log) -> dict[str, float]:
    """Thruster -> position to starboard [m] by the log's rig; of an imported log only the side is known."""
    rig = log.rig
    return {t.name: t.position_m[1] for t in rig.thrusters} if rig else IMPORTED


def _mute(log: Log) -> Iterator[Finding]:
    """Thrusters that were commanded and whose controllers never said a word."""
    rig = log.rig
    for thruster in rig.thrusters if rig else ():
        device, node = thruster.device, thruster.node
        if thruster.output is None and node in log.nodes(Command, device) and node not in log.nodes(Esc, device):
            text = "commanded, and its controller has never said a word"
            yield Finding(
                "fault", "controller-never-heard", "dead", thruster.name, text, "its node on the bus, power and cable"
            )
