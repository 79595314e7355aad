"""Delays between the sensors of a boat and its thrust, estimated from the response of the motion to the thrust.

Theory of operation. The signals belong to three groups, and each group may have its own delay: thrust (commands or
shaft speeds), attitude (heading and yaw rate), and position (position and velocity over ground). Signals of the same
group are compared by `seatrial.ident.checks.sensors`. That comparison does not detect a group that is late as a whole.
This module compares the groups:

- The yaw rate follows the thrust: its rate of change is the moment of the thrusters less damping, without a delay.
- The surge speed follows the sum of the thrusts in the same way.
- The difference of these two delays compares attitude with velocity. The delay of the shafts cancels in it.

Each of the first two is a linear regression of increments of the motion over a window on integrals of the thrust and of
the motion. The regression is repeated for each lag of the search. The lag with the least error is the delay. Its
standard error is that of the jackknife over blocks of time, which holds for correlated disturbances. The delay is
reported as unknown if the regression explains too little or the interval is wide.

Notes
-----
Heading and course over ground alone do not show the delay. A boat drifts outwards in turns, so that its course follows
its heading about one second late even if all sensors are in time. Source of the jackknife: Kunsch, Annals of Statistics
17 (1989) 1217.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import OK, UNKNOWN, Finding
from seatrial.ident.checks.recent_results import RecentResults
from seatrial.ident.checks.sensors import (
    DELAY_FAULT,
    DELAY_OF_PAIR,
    DELAY_WARNING,
    SENSOR_GRID_S,
    Channels,
    LagErrors,
    LagEstimate,
    common_grid,
    delay_interval,
    delay_level,
    why_no_warning,
)
from seatrial.ident.data import Channel
from seatrial.ident.model import command_of, shaft_speed_of, thrust_of
from seatrial.ident.numerics import Array, cumulative_integral, ned_to_body

YAW_WINDOW, SURGE_WINDOW = 0.5, 2.0  # s, of the increments of yaw rate and of speed
MAX_LAG = 2.5  # s, of the search in both directions; longer than delays in practice, so that no estimate is at the end
MIN_DURATION = 60.0  # s, of a log
MIN_R2 = 0.6  # of the increments; with less a regression does not show a delay
MAX_SE = 0.2  # s; a delay with a larger standard error is unknown
# Systematic error of the regression [s], times the root of its unexplained share. For mock boats with other equations
# of motion the yaw rate appears up to 0.2 s early if a fifth is unexplained.
SYSTEMATIC = 0.3
MIN_DISTANCE = 0.18  # s, of the interval from zero; smaller delays are no finding
FEWEST_LOGS = 2  # for a mean of their delays
ALIKE = 1.5  # largest distance of a delay from the mean of several logs, in its own random half intervals
SHAFT_LAG = 0.2  # s, usual lag of shafts behind their commands
HEADING_HALF, POSITION_HALF = 0.25, 1.0  # s before and after, over which headings and positions are differenced
EVERY = 0.25  # s between two increments
MAX_ROWS = 20_000  # of a regression
GAP_S, GAP_PERIODS = 1.0, 5.0  # a pause of a signal longer than both (s, sample intervals) is left out

THRUST, ATTITUDE, VELOCITY = "thrust", "heading and yaw rate", "velocity"


class ThrustSignals(NamedTuple):
    """Thrust signals of a log.

    A command comes before the thrust by the delay of the shafts, which a fit estimates.

    Attributes
    ----------
    turning
        Thrusts, or one yaw moment, that turn the boat. Any unit.
    ahead
        Thrusts, or their sum, that drive the boat forward. Any unit.
    measured
        Whether all of them are measured shaft speeds with the time of measurement, not commands or given forces.
    where
        Names of the thrusters, for findings.
    """

    turning: list[Channel]
    ahead: list[Channel]
    measured: bool
    where: str


class SensorDelay(NamedTuple):
    """Delay between attitude and velocity of one log, or of several logs together.

    Attributes
    ----------
    lag
        Delay [s] of attitude behind velocity. Negative: velocity comes after attitude.
    random, systematic
        Half widths [s] of the 95 % interval by the noise of the log, and by the error of the regressions.
    turned, moved
        Names of the sensors of attitude and velocity.
    translation
        ``velocity`` or ``position``, as the log has it.
    """

    lag: float
    random: float
    systematic: float
    turned: str
    moved: str
    translation: str

    @property
    def half(self) -> float:
        """Half width of the 95 % interval [s], with both errors."""
        return float(np.hypot(self.random, self.systematic))

    @property
    def late(self) -> tuple[str, str, str]:
        """Late quantity, the quantity before which it should come, and name of the late sensor."""
        if self.lag > 0.0:
            return ATTITUDE, self.translation, self.turned
        return self.translation, ATTITUDE, self.moved


def sensor_delay_of(c: Channels, sides: Mapping[str, float]) -> SensorDelay | None:
    """Return the delay between attitude and velocity by their responses to the thrust.

    Parameters
    ----------
    c
        Channels of a log (`seatrial.ident.data.channels`).
    sides
        Position of each thruster to starboard [m]. Only its names are used.

    Returns
    -------
    SensorDelay or None
        None without heading, velocity or thrust, and if a delay behind the thrust is not well estimated.
    """
    moved = first_source(c, ("vx", "u", "x"))
    if not moved or "psi" not in c:
        return None
    return _delay_between(*_delays_behind_thrust(c, sides), first_source(c, ("r", "psi")), moved)


def compare_sensor_delays(logs: Sequence[tuple[str, SensorDelay | None]]) -> list[tuple[str, Finding]]:
    """Return the delay between attitude and velocity of several logs of one set-up together.

    Parameters
    ----------
    logs
        Name of each log, and the delay in it (`sensor_delay_of`).

    Returns
    -------
    list of tuple
        The number of logs as a name, such as ``4 logs together``, and the finding, with the codes of one log. It is
        empty unless the interval of the mean excludes zero. It is also empty if one log alone gives ``sensor-late``,
        with fewer than two delays, and if the delays differ by more than 1.5 of their random half intervals.

    Notes
    -----
    The mean has the inverse variances as weights. More logs reduce its random error. Its systematic error is that of
    one log, because the same boat gives the regressions the same error.
    """
    found = [delay for _, delay in logs if delay is not None]
    if len(found) < FEWEST_LOGS or len({(d.turned, d.moved, d.translation) for d in found}) > 1:
        return []
    if any(_level_of_delay(abs(d.lag), d.half) not in (OK, UNKNOWN) for d in found):
        return []
    weights = 1.0 / np.array([d.half for d in found]) ** 2
    weights /= weights.sum()
    lag = float(weights @ [d.lag for d in found])
    random = float(np.linalg.norm(weights * [d.random for d in found]))
    mean = found[0]._replace(lag=lag, random=random, systematic=float(weights @ [d.systematic for d in found]))
    if abs(lag) < mean.half or any(abs(d.lag - lag) > ALIKE * d.random for d in found):
        return []
    finding = _finding_of_delay(mean)
    if finding.level == OK:
        end = f"; it is not zero, but below the limit of a warning, {DELAY_WARNING:g} s"
        advice = "a diagnosis estimates the latency of a sensor, such as gnss-latency"
        finding = finding._replace(text=_text_of_delay(mean, OK) + end, advice=advice)
    return [(f"{len(found)} logs together", finding)]


def check_latency(c: Channels, sides: Mapping[str, float]) -> Iterator[Finding]:
    """Compare the times of attitude, velocity and thrust, and yield at most two findings on their delays.

    Parameters
    ----------
    c
        Channels of a log (`seatrial.ident.data.channels`). Without a heading or a thrust there is no finding.
    sides
        Position of each thruster to starboard [m]. Only its names are used.

    Yields
    ------
    Finding
        ``sensor-late``, ``thrust-late`` or ``motion-late``; ``sensors-in-time`` or ``thrust-in-time``;
        ``delay-unknown`` if the log does not show the delay.
    """
    push = thrust_signals(c, sides)
    if "psi" not in c:
        return
    attitude, velocity = _delays_behind_thrust(c, sides)
    turned, moved = first_source(c, ("r", "psi")), first_source(c, ("vx", "u", "x"))
    if moved and push:
        yield from _attitude_velocity_delay(attitude, velocity, turned, moved)
    if push:
        yield from _motion_thrust_delay(attitude, velocity, push)


def _attitude_velocity_delay(
    attitude: LagEstimate | None, velocity: LagEstimate | None, turned: str, moved: str
) -> Iterator[Finding]:
    """Yield one finding on the delay between attitude and velocity: the difference of their delays behind the thrust.

    It is ``sensor-late`` (warning or fault), ``sensors-in-time`` (ok), or ``delay-unknown`` (unknown) if one of the two
    delays is not well estimated, or if the interval of a long one reaches to short ones. ``attitude``, ``velocity``:
    delays of the yaw rate and of the surge speed behind the thrust, None if unknown. ``turned``, ``moved``: names of
    the sensors of both, for the finding.
    """
    found = _delay_between(attitude, velocity, turned, moved)
    if found is not None:
        yield _finding_of_delay(found)
        return
    text = (
        f"the delay between {ATTITUDE} and {_translation(moved)} is not known: the thrust explains too little of them"
    )
    yield Finding(UNKNOWN, "delay-unknown", "late", turned, text)


def _translation(moved: str) -> str:
    """Return what a log has of the translation, by the name of the sensor: ``position`` or ``velocity``."""
    return "position" if moved == "x" else VELOCITY


def _delay_between(
    attitude: LagEstimate | None, velocity: LagEstimate | None, turned: str, moved: str
) -> SensorDelay | None:
    """Return the difference of the delays of attitude and velocity; None if one of them is not well estimated."""
    if not _is_well_estimated(attitude) or not _is_well_estimated(velocity):
        return None
    assert attitude is not None
    assert velocity is not None
    random = float(np.hypot(attitude.half, velocity.half))
    systematic = SYSTEMATIC * float(np.sqrt(2.0 - attitude.r2 - velocity.r2))
    return SensorDelay(attitude.lag - velocity.lag, random, systematic, turned, moved, _translation(moved))


def _finding_of_delay(found: SensorDelay) -> Finding:
    """Return the finding on a delay between attitude and velocity."""
    lag, (late, _, where) = abs(found.lag), found.late
    level = _level_of_delay(lag, found.half)
    text, advice = _text_of_delay(found, level), f"check filters, output rate and time stamps of {late}"
    if level == OK:
        return Finding(level, "sensors-in-time", "late", where, text + why_no_warning(lag, found.half))
    if level == UNKNOWN:
        advice += "; a longer log with changes of speed and turns narrows the interval"
        return Finding(level, "delay-unknown", "late", where, text, advice)
    return Finding(level, "sensor-late", "late", where, text, f"{advice}; {DELAY_OF_PAIR}")


def _text_of_delay(found: SensorDelay, level: str) -> str:
    """Return the text of a finding on a delay between attitude and velocity, of a level, without its end."""
    late, ahead, _ = found.late
    come = "may come" if level == UNKNOWN else "come" if late == ATTITUDE else "comes"
    interval = delay_interval(abs(found.lag), found.half)
    return f"{late} {come} {abs(found.lag):.2f} s after {ahead}, compared by their response to the thrust ({interval})"


def _motion_thrust_delay(
    attitude: LagEstimate | None, velocity: LagEstimate | None, push: ThrustSignals
) -> Iterator[Finding]:
    """Yield one finding on the delay of the motion behind the thrust.

    The motion cannot come before the thrust (``thrust-late``), and cannot come long after a measured thrust
    (``motion-late``). Otherwise the finding is ``thrust-in-time`` (ok), also for a long delay behind commands or given
    forces. Severities are those of `_level_of_delay`. For commands and given forces, ``thrust-late`` is a fault from
    0.4 s on instead of 0.6 s, since the lag of the shafts hides a part of it. ``attitude``, ``velocity``: delays of yaw
    rate and surge speed, None if unknown. The one of smaller size is judged. If their signs differ, the finding is
    ``thrust-in-time`` (ok). If none is well estimated, it is ``delay-unknown`` (unknown).
    """
    found = [estimate for estimate in (attitude, velocity) if estimate is not None and _is_well_estimated(estimate)]
    if not found:
        yield Finding(
            UNKNOWN,
            "delay-unknown",
            "late",
            push.where,
            "the delay between thrust and motion is not known: the thrust explains too little of the motion",
        )
        return
    nearest = min(found, key=lambda estimate: abs(estimate.lag))  # one of the two sensors may be late itself
    same = len({estimate.lag > 0.0 for estimate in found}) == 1
    lag, half = nearest.lag, _half_interval(nearest)
    # Commands come before the thrust by the lag of the shafts. This lag hides a part of a delay of their time stamps.
    fault_from = DELAY_FAULT if push.measured else DELAY_FAULT - SHAFT_LAG
    level = _level_of_delay(abs(lag), half, fault_from) if same else OK
    if lag >= 0.0 and not push.measured:
        level = OK  # the lag of the shafts has no limit
    if level == UNKNOWN:
        order = "before" if lag < 0.0 else "after"
        text = f"the motion may come {abs(lag):.2f} s {order} the thrust ({delay_interval(abs(lag), half)})"
        yield Finding(UNKNOWN, "delay-unknown", "late", push.where, text)
    elif level != OK and lag < 0.0:
        before = f"{-lag:.2f} s before the thrust ({delay_interval(-lag, half)})"
        text = f"the motion comes {before}: the thrust is logged late"
        advice = "check time stamps and filters of the shaft speeds or commands"
        yield Finding(level, "thrust-late", "late", push.where, text, advice)
    elif level != OK:
        text = f"the motion comes {lag:.2f} s after the measured thrust ({delay_interval(lag, half)})"
        advice = "check the time stamps of the shaft speeds, and of all sensors"
        yield Finding(level, "motion-late", "late", push.where, text, advice)
    else:
        order = "before" if lag < 0.0 else "after"
        text = f"the motion comes {abs(lag):.2f} s {order} the thrust ({delay_interval(abs(lag), half)})"
        if lag > 0.0 and not push.measured:
            text += "; the lag of the thrusters is a part of it, which a fit estimates" * (lag > half)
        elif abs(lag) >= DELAY_WARNING and not same:
            text += "; yaw rate and speed give delays of opposite sign, so that this is no delay of the thrust"
        else:
            text += why_no_warning(abs(lag), half)
        yield Finding(OK, "thrust-in-time", "late", push.where, text)


def _level_of_delay(lag: float, half: float, fault_from: float = DELAY_FAULT) -> str:
    """Return the severity of a delay for its finding: ``ok``, ``unknown``, ``warning`` or ``fault``.

    Parameters
    ----------
    lag
        Delay [s], not negative.
    half
        Half width of its 95 % interval [s].
    fault_from
        Delay [s] from which it is a fault, however wide its interval is.

    Returns
    -------
    str
        ``ok`` if the delay is below the limit of a warning (0.3 s, less half a step of the search). ``unknown`` if it
        is not, but the lower end of its interval is below 0.18 s. Else ``fault`` or ``warning`` by `delay_level`.
    """
    if lag < DELAY_WARNING - SENSOR_GRID_S / 2:
        return OK
    if lag - half < MIN_DISTANCE:
        return UNKNOWN
    return delay_level(lag, half, fault_from)


def _is_well_estimated(found: LagEstimate | None) -> bool:
    """Return whether a delay was estimated well; false for None.

    R2 must exceed 0.6, the standard error must be below 0.2 s, and the delay must be at least 0.1 s inside the ends of
    the search (-2.5 and 2.5 s).
    """
    return (
        found is not None and found.r2 > MIN_R2 and found.se < MAX_SE and abs(found.lag) < MAX_LAG - 2 * SENSOR_GRID_S
    )


def _half_interval(*found: LagEstimate) -> float:
    """Return the half width of the 95 % interval [s] of a delay, or of the difference of two delays.

    It includes the systematic error of the regression (0.3 s times the root of the unexplained share).
    """
    return float(np.sqrt(sum(estimate.half**2 + SYSTEMATIC**2 * (1.0 - estimate.r2) for estimate in found)))


def first_source(c: Channels, names: Sequence[str]) -> str:
    """Return the source (device) of the first of the channels ``names`` that the log has.

    The result is the name of the channel if it has no source, and empty if the log has none of the channels.
    """
    return next((c[n].source or n for n in names if n in c), "")


def thrust_signals(c: Channels, sides: Mapping[str, float]) -> ThrustSignals | None:
    """Return the thrust signals of a log; None if the log has no thrust.

    The surge force ``X`` and the yaw moment ``N`` of all thrusters together are preferred. Else each thruster of
    ``sides`` gives its measured force, else ``n|n|`` of its shaft speed, else of its command. A thruster without these
    signals is left out.
    """
    if "N" in c or "X" in c:
        return ThrustSignals([c[n] for n in "N" if n in c], [c[n] for n in "X" if n in c], False, "thrust")
    found, measured = dict[str, Channel](), True
    for name in sides:
        key = next((k for k in (thrust_of(name), shaft_speed_of(name), command_of(name)) if k in c), "")
        if not key:
            continue
        found[name] = c[key] if key == thrust_of(name) else _signed_square(c[key])
        timely = c[key].hold == "linear" or (not c[key].hold and command_of(name) in c)
        measured &= key == shaft_speed_of(name) and timely
    if not found:
        return None
    return ThrustSignals(list(found.values()), list(found.values()), measured, " and ".join(found))


def _signed_square(shaft: Channel) -> Channel:
    """Return ``n|n|`` of a shaft speed or command n, which is proportional to the thrust.

    Times, source and hold are those of n.
    """
    return Channel(shaft.t, shaft.value * np.abs(shaft.value), "", shaft.source, shaft.hold)


class GridMotion(NamedTuple):
    """Motion on a common grid of times, without NaN. A signal is None if no sensor measures it.

    Attributes
    ----------
    t
        Times (n,) [s] at steps of 0.05 s.
    r
        Yaw rate (n,) [rad/s], by the gyro or the heading.
    psi
        Heading (n,) [rad], unwrapped.
    u, v
        Velocity over ground forward and to starboard (n,) [m/s].
    half
        Time [s] before and after each sample, over which headings or positions were differenced; 0 if none were.
    """

    t: Array
    r: Array
    psi: Array | None
    u: Array | None
    v: Array | None
    half: float


def motion_on_grid(c: Channels, thrusts: Sequence[Channel], half_r: float = HEADING_HALF) -> GridMotion | None:
    """Return the motion in the time that all thrusts and motion sensors cover; None if it is shorter than 60 s.

    The log needs a yaw rate or a heading. Without a yaw rate, the heading is differenced from ``half_r`` [s] before to
    ``half_r`` after each time. Without velocities, the positions are differenced from 1 s before to 1 s after.
    """
    names = [n for n in ("psi", "r", "vx", "vy", "u", "v", "x", "y") if n in c]
    t = common_grid(*thrusts, *(c[n] for n in names))
    if t.size * SENSOR_GRID_S < MIN_DURATION:
        return None
    psi = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value)) if "psi" in c else None
    half = 0.0
    if "r" in c:
        r = np.interp(t, c["r"].t, c["r"].value)
    else:
        assert psi is not None
        r, half = mean_rate(psi, half_r), half_r
    u = v = None
    if {"u", "v"} <= set(c):
        u, v = (np.interp(t, c[n].t, c[n].value) for n in ("u", "v"))
    elif psi is not None and ({"vx", "vy"} <= set(c) or {"x", "y"} <= set(c)):
        if "vx" in c and "vy" in c:
            north, east = (np.interp(t, c[n].t, c[n].value) for n in ("vx", "vy"))
        else:
            half = max(half, POSITION_HALF)
            north, east = (mean_rate(np.interp(t, c[n].t, c[n].value), POSITION_HALF) for n in ("x", "y"))
        u, v = ned_to_body(psi, north, east)
    return GridMotion(t, r, psi, u, v, half)


def mean_rate(s: Array, half: float) -> Array:
    """Return the mean rate of change (n,) per second of a signal s (n,) with a step of 0.05 s.

    It is the difference from ``half`` [s] before to ``half`` after each sample. Near both ends the signal is continued
    with its end value.
    """
    k = round(half / SENSOR_GRID_S)
    return (np.pad(s, k, mode="edge")[2 * k :] - np.pad(s, k, mode="edge")[: -2 * k]) / (2.0 * k * SENSOR_GRID_S)


_delays = RecentResults[tuple[LagEstimate | None, LagEstimate | None]]()


def _delays_behind_thrust(c: Channels, sides: Mapping[str, float]) -> tuple[LagEstimate | None, LagEstimate | None]:
    """Return the delays [s] of yaw rate and surge speed behind the thrust; None if a delay cannot be estimated.

    The delays in the same channels are estimated only once: a check of one log and one of several logs need them.
    """
    push = thrust_signals(c, sides)
    if not push:
        return None, None
    arrays = [array for name in sorted(c) for array in (c[name].t, c[name].value)]
    options = tuple(sides), tuple(sorted(c))
    return _delays.get(arrays, lambda: (_yaw_after_thrust(c, push), _speed_after_thrust(c, push)), options)


def _yaw_after_thrust(c: Channels, push: ThrustSignals) -> LagEstimate | None:
    """Estimate the delay [s] of the yaw rate (by gyro or heading) behind the thrust.

    The result is None if no thrust turns the boat, the motion is constant, or the log without pauses of the sensors is
    shorter than 60 s.
    """
    if not push.turning or (m := motion_on_grid(c, push.turning)) is None:
        return None
    smooth = 0.0 if "r" in c else HEADING_HALF
    terms = [m.r, m.r * np.abs(m.r), np.ones(m.t.size)]
    if m.u is not None and m.v is not None:  # Munk moment, coupling, and errors of a late sway velocity
        terms += [m.u * m.v, m.u * m.r, m.v, m.r * np.abs(m.u)]
    pushes = [part for thrust in push.turning for part in forward_and_reverse(thrust_at(thrust, m.t))]
    return _lag_behind_thrust(c, m, m.r, terms, pushes, YAW_WINDOW, smooth)


def _speed_after_thrust(c: Channels, push: ThrustSignals) -> LagEstimate | None:
    """Estimate the delay [s] of the surge speed behind the thrust.

    The result is None if no thrust drives the boat forward, no sensor measures the velocity, the motion is constant, or
    the log without pauses of the sensors is shorter than 60 s.
    """
    if not push.ahead or (m := motion_on_grid(c, push.ahead)) is None or m.u is None or m.v is None:
        return None
    smooth = 0.0 if {"vx", "vy"} <= set(c) or {"u", "v"} <= set(c) else POSITION_HALF
    terms = [m.u, m.u * np.abs(m.u), m.v * m.r, m.r * m.r, np.ones(m.t.size)]
    if m.psi is not None:  # a current, which may turn and grow during the log, as that of a tide
        age = np.linspace(-1.0, 1.0, m.t.size)
        axes = np.cos(m.psi), np.sin(m.psi)
        terms += [axis * age**power for axis in axes for power in range(3)]
        terms += [axis * m.r * age**power for axis in axes for power in range(2)]
    pushes = forward_and_reverse(sum((thrust_at(thrust, m.t) for thrust in push.ahead), np.zeros(m.t.size)))
    return _lag_behind_thrust(c, m, m.u, terms, pushes, SURGE_WINDOW, smooth)


def thrust_at(push: Channel, t: Array) -> Array:
    """Return the values (n,) of a thrust signal at times t (n,) [s].

    A signal with the hold ``zero`` keeps each sample until the next one; others are interpolated. Outside the samples
    the first or the last one is returned.
    """
    if push.hold != "zero":
        return np.interp(t, push.t, push.value)
    return push.value[np.clip(np.searchsorted(push.t, t, side="right") - 1, 0, None)]


def forward_and_reverse(f: Array) -> list[Array]:
    """Split a thrust (n,) into its parts forward and reverse, since a propeller gives less thrust in reverse.

    A part that is constant is left out.
    """
    return [part for part in (np.maximum(f, 0.0), np.minimum(f, 0.0)) if np.ptp(part) > 1e-6]


def _lag_behind_thrust(
    c: Channels, m: GridMotion, y: Array, terms: Sequence[Array], pushes: Sequence[Array], window: float, smooth: float
) -> LagEstimate | None:
    """Estimate the lag of a motion behind the thrust by regressions of its increments.

    Parameters
    ----------
    c
        Channels of the log, for the pauses of their sensors.
    m
        Motion on the grid.
    y
        Motion (n,) that follows the thrust: yaw rate or surge speed.
    terms
        Further regressors (n,): functions of the motion. They are not shifted.
    pushes
        Thrusts (n,), which are shifted by each lag of the search.
    window
        Time [s] of the increments.
    smooth
        Half width [s] of the moving mean that y has passed; 0 for none. The regressors pass the same mean.

    Returns
    -------
    LagEstimate or None
        Positive if the motion comes after the thrust. None without thrust, for a constant motion, or if less than 60 s
        of the log are without pauses.
    """
    if not pushes or np.std(y) < 1e-9:
        return None
    mean = (lambda s: mean_rate(cumulative_integral(m.t, s), smooth)) if smooth else (lambda s: s)
    own = [cumulative_integral(m.t, mean(s)) for s in terms]
    late = [cumulative_integral(m.t, mean(s)) for s in pushes]
    width, most = round(window / SENSOR_GRID_S), round(MAX_LAG / SENSOR_GRID_S)
    every = max(round(EVERY / SENSOR_GRID_S), y.size // MAX_ROWS)
    at = np.arange(most, y.size - most - width, every)
    at = at[increments_without_pause(c, m.t, at, width)]
    if at.size * every * SENSOR_GRID_S < MIN_DURATION:
        return None
    errors = LagErrors(np.linspace(-MAX_LAG, MAX_LAG, 2 * most + 1), at.size)
    target = y[at + width] - y[at]
    fixed = np.column_stack([s[at + width] - s[at] for s in own])
    for k in range(-most, most + 1):
        moved = np.column_stack([s[at - k + width] - s[at - k] for s in late])
        errors.add(np.column_stack([fixed, moved]), target)
    return errors.estimate()


def increments_without_pause(c: Channels, t: Array, at: NDArray[np.intp], width: int) -> NDArray[np.bool_]:
    """Return which increments (n_rows,) do not overlap a pause of a sensor: true for those that can be used.

    A pause is longer than 1 s and than five median sample intervals of the signal. Pauses of the thrust do not count.

    ``at``: first index of each increment on the grid t (n,) [s]. ``width``: its number of steps.
    """
    paused = np.zeros(t.size + 1)
    for name in (n for n in ("psi", "r", "vx", "vy", "x", "y", "u", "v") if n in c):
        pause = np.diff(c[name].t)
        for k in np.flatnonzero(pause > max(GAP_S, GAP_PERIODS * float(np.median(pause)))):
            a, b = np.searchsorted(t, c[name].t[k : k + 2])
            paused[a] += 1.0
            paused[b] -= 1.0
    before = np.append(0.0, np.cumsum(np.cumsum(paused[:-1]) > 0.0))
    return np.asarray(before[at + width + 1] == before[at])
