"""Checks of single signals: sample interval, range and unit, frozen segments, resolution, smoothing."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from math import comb
from types import MappingProxyType

import numpy as np

from seatrial.daq.checks import Finding
from seatrial.ident.checks.sensors import Channels
from seatrial.ident.checks.two_receivers import second_receiver
from seatrial.ident.data import Channel
from seatrial.ident.model import COMMAND, SHAFT_SPEED, THRUSTER_FORCE, SignalId, is_of_thruster
from seatrial.ident.numerics import NORMAL_MAD, Array

MOTION = ("psi", "r", "ax", "ay", "x", "y", "vx", "vy", "u", "v")
# Signals of one sensor. If one of a group is frozen, the others of the group cannot prove that the boat moves.
GROUPS = (("psi",), ("r",), ("ax", "ay"), ("x", "y"), ("vx", "vy"), ("u", "v"))
TRACKS = (("x", "y"), ("vx", "vy"))
BODY = (("ax", "ay"), ("u", "v"))  # one axis of these may be zero in the whole log
LONGEST_INTERVAL, SHORTEST_INTERVAL = 10.0, 2e-4  # s between samples of a boat's sensors
DAY, YEAR = 86400.0, 365.25 * 86400.0  # s
LONGEST_PAUSE = DAY  # s, in the log of one run
MAX_N = 1.5  # of full speed; larger values have another unit
MAX_YAW_RATE = 5.0  # rad/s
TWICE = np.radians(2.0 * np.pi)  # rad, a turn of a heading in radians that was converted as if it were degrees
MAX_TRACK_DEG = 0.1  # largest extent of a track that is in degrees
# A signal is frozen if a value stays exactly the same for longer than the first two, and for `FROZEN_TIMES` times as
# long as its values usually stay (99 % quantile), while the boat moves.
FROZEN_S, FROZEN_SAMPLES, FROZEN_TIMES = 5.0, 10, 10.0
# The boat moves: standard deviation of the heading [rad]; mean command over the largest command.
TURNS, DRIVEN = 0.15, 0.1
SETTLED_S = 1.0  # largest delay of a receiver; the ends of a frozen time are not compared with other sensors
# A motion is not steady if the residuals are above these values or above `TIMES_NOISE` times the noise: velocity over
# ground [m/s] of constant acceleration in the boat's frame; position [m] on a straight line at constant speed.
UNSTEADY_VELOCITY, UNSTEADY_PLACE, TIMES_NOISE = 0.15, 0.5, 3.0
# White noise (standard deviation in rad, rad/s, m/s2, m, m/s) below which a signal has no noise of a sensor.
NO_NOISE = {"psi": 1e-4, "r": 1e-4, "ax": 1e-3, "ay": 1e-3, "x": 2e-3, "y": 2e-3, "vx": 1e-3, "vy": 1e-3, "u": 1e-3,
            "v": 1e-3}  # fmt: skip
# Usual accuracy (standard deviation) of a navigation filter's output, as examples of what a user can give to a fit: the
# noise parameter of each signal in the models of the boat, its size and unit.
FILTER_NOISE = {
    "psi": ("e_psi", 0.03, "rad"),
    "r": ("e_r", 0.02, "rad/s"),
    **dict.fromkeys(("ax", "ay"), ("e_a", 0.1, "m/s2")),
    **dict.fromkeys(("x", "y"), ("e_xy", 0.3, "m")),
    **dict.fromkeys(("vx", "vy"), ("e_vxy", 0.05, "m/s")),
    **dict.fromkeys(("u", "v"), ("e_uv", 0.05, "m/s")),
}
ESTIMATED = 0.03  # m; a position with less white noise is the output of an estimator, not of a receiver
FEWEST = 200  # samples
# Least and largest step of a coarse resolution [m, m/s], for example 0.001 and 0.01 minutes, or 1 km/h and 1 m/s.
COARSE = {"x": (0.3, 20.0), "y": (0.3, 20.0), "vx": (0.2, 1.1), "vy": (0.2, 1.1)}
LEAST_PER_LEVEL = 3  # samples per level from which a resolution can be seen
ON_GRID = 0.02  # largest distance of a difference from a whole number of steps
MAX_STEPS = 2.5  # steps before and after a value that stays the same only because of the resolution
ALTERNATE_BLOCK = 20  # samples that are evaluated together
ALTERNATES = 0.7  # share of the differences that alternates if two sensors share a signal; white noise has 0.05
FEW_REPEATS = 0.2  # with a larger share of repeated values a signal is held and is not tested
FEWEST_STEADY, FINE_S = 4, 0.02  # samples of velocity that confirm an acceleration; step of its integral


def check_intervals(c: Channels) -> Iterator[Finding]:
    """Yield at most one fault: a pause of more than a day, or sample intervals of a time that is not in seconds.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. The motion signals, such as ``psi`` and ``x`` (`MOTION`), are examined in
        turn, and the first fault ends the check.

    Yields
    ------
    Finding
        ``times-jump`` for a pause of more than a day. ``time-scale`` for a median interval below 0.2 ms or above 10 s.
    """
    for name in (n for n in MOTION if n in c):
        pause = np.diff(c[name].t)
        step = float(np.median(pause))
        if pause.max() > LONGEST_PAUSE:
            # The other checks would fill the memory with their grids.
            k = int(np.argmax(pause))
            far = f"{pause[k] / YEAR:.1f} years" if pause[k] > YEAR else f"{pause[k] / DAY:.1f} days"
            text = f"its times jump by {far}, {c[name].t[k] - c[name].t[0]:.1f} s after its start"
            advice = (
                "the device's clock was set, or these are two runs; cut the log there (t_from, t_to under [[log]] in "
                "the import map)"
            )
            yield Finding("fault", "times-jump", "time", name, text, advice)
            return
        if step > LONGEST_INTERVAL or step < SHORTEST_INTERVAL:
            unit = "ms" if LONGEST_INTERVAL < step < 1e4 else "us" if step > 1.0 else "a unit other than s"
            yield Finding(
                "fault",
                "time-scale",
                "time",
                name,
                f"one sample every {step:.3g} s: is its time in {unit}?",
                "correct format (s, ms, us or ns) under [time] in the import map",
            )
            return


def largest_inputs(c: Channels) -> dict[str, float]:
    """Return the 99 % quantile of the size of each command and shaft speed, by its name, sorted by name."""
    names = sorted(n for n in c if is_of_thruster(n, COMMAND, SHAFT_SPEED))
    return {name: float(np.quantile(np.abs(c[name].value), 0.99)) for name in names}


def _quantity_of(name: str) -> str:
    """Return the quantity of the signal of a thruster: ``n_cmd`` or ``n``."""
    return SignalId.parse(name).quantity


def check_ranges(c: Channels) -> Iterator[Finding]:
    """Yield a fault for each signal whose values no boat can have, with the unit that would explain them.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. Missing ones are not checked.

    Yields
    ------
    Finding
        ``n-out-of-range`` for a command or shaft speed above 1.5 times full speed (99 % quantile). ``angle-in-degrees``
        for a yaw rate above 5 rad/s (99 % quantile), and for headings in degrees or converted twice.
        ``positions-in-degrees`` for a track of less than 0.1 in both directions, far from its origin.
    """
    for name, most in (largest := largest_inputs(c)).items():
        if most > MAX_N:
            # All thrusters get one scale, so that equal speeds stay equal.
            top = max(n for other, n in largest.items() if _quantity_of(other) == _quantity_of(name))
            value = c[name].value
            # microseconds of a servo output, 0 without a pulse
            pulses = float(np.median(value)) > 700.0 and value.min() >= 0.0 and float(value.max()) < 2600.0
            unit = "a pulse width in us" if pulses else "percent" if top <= 110.0 else "rev/min, or a wrong offset"
            fix = "scale = 0.0025, offset = -3.75" if pulses else f"scale = {1.0 / top:.3g}"
            fix = 'unit = "%"' if unit == "percent" else fix
            guess = (
                ""
                if pulses or top <= 110.0
                else ", a guess from the largest number; better: 1 / (number at full speed)"
            )
            advice = f"set {fix} for all thrusters in the import map{guess}, or correct rpm_max in the rig file"
            yield Finding(
                "fault",
                "n-out-of-range",
                "units",
                name,
                f"goes from {value.min():.4g} to {value.max():.4g}, but 1 is full speed: is it {unit}?",
                advice,
            )
    if "r" in c and (most := float(np.quantile(np.abs(c["r"].value), 0.99))) > MAX_YAW_RATE:
        text = f"reaches {most:.3g} rad/s: is it in deg/s?"
        advice = 'if so, set unit = "deg/s" for r in the import map'
        yield Finding("fault", "angle-in-degrees", "units", "r", text, advice)
    if "psi" in c and np.abs(c["psi"].value).max() > 7.0:
        t = np.arange(c["psi"].t[0], c["psi"].t[-1], max(1.0, 2.0 * float(np.median(np.diff(c["psi"].t)))))
        rate = np.diff(np.interp(t, c["psi"].t, np.unwrap(c["psi"].value, period=360.0))) / np.diff(t)
        if rate.size and float(np.quantile(np.abs(rate), 0.95)) > MAX_YAW_RATE:
            text = f"goes from {c['psi'].value.min():.4g} to {c['psi'].value.max():.4g} rad: is it in degrees?"
            advice = 'if so, set unit = "deg" for psi in the import map'
            yield Finding("fault", "angle-in-degrees", "units", "psi", text, advice)
    psi = c["psi"].value if "psi" in c else np.zeros(2)
    if 0.9 * TWICE < np.ptp(psi) < 1.02 * TWICE and np.abs(np.diff(psi)).max() > 0.8 * TWICE:
        text = f"jumps by {TWICE:.3f} rad: radians were converted as if they were degrees"
        advice = 'set unit = "rad" for psi in the import map'
        yield Finding("fault", "angle-in-degrees", "units", "psi", text, advice)
    if {"x", "y"} <= set(c):
        span = [float(np.ptp(c[n].value)) for n in ("x", "y")]
        away = [abs(float(np.median(c[n].value))) for n in ("x", "y")]
        small = 0.0 < max(span) < MAX_TRACK_DEG and away[0] <= 90.0 and away[1] <= 180.0
        if small and max(away) > 20.0 * max(span):
            distance = f"{away[0]:.4g} m north and {away[1]:.4g} m east"
            text = f"the track spans {max(span):.2g} m, {distance} of its origin: are positions in degrees?"
            advice = (
                "if so, set scale = 111200 for x (latitude) and 111200 cos(latitude) for y (longitude) in the import "
                "map; x and y are in metres"
            )
            yield Finding("fault", "positions-in-degrees", "units", "x, y", text, advice)


def check_frozen(c: Channels) -> Iterator[Finding]:
    """Yield a fault for each motion signal that stays exactly the same for more than 5 s while the boat moves.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.

    Yields
    ------
    Finding
        ``channel-constant`` if the value is the same in (nearly) the whole log, else ``channel-frozen``.

    Notes
    -----
    There is no finding if no other sensor or thruster shows that the boat moves, if another sensor confirms the
    constant value, or if a coarse resolution explains it. Nor is there one if the value often stays the same for
    similar times (`_longest_unusual_hold`), or if only one axis of the acceleration or of the body velocity stays.
    """
    for group in GROUPS:
        held = {name: _longest_unusual_hold(c[name]) for name in group if name in c}
        held = {name: (begin, end) for name, (begin, end) in held.items() if end - begin > FROZEN_S}
        for name, (begin, end) in held.items():
            same = [n for n, (a, b) in held.items() if min(b, end) - max(a, begin) > 0.8 * (end - begin)]
            whole = len(same) == len([n for n in group if n in c])
            if (group in BODY and not whole) or not _boat_moves(c, group, whole, begin, end):
                continue
            noisy = group == ("ax", "ay") and not all(_lacks_sensor_noise(n, c[n]) for n in same)
            if not noisy and _constant_motion_confirmed(c, group, begin + SETTLED_S, end - SETTLED_S):
                continue  # noiseless signals, as of simulators, are constant in a steady motion
            if _resolution_explains_hold(c, name, begin, end):
                continue
            start, duration = float(c[name].t[0]), float(np.ptp(c[name].t))
            value = float(c[name].value[np.searchsorted(c[name].t, begin)])
            advice = "check the sensor; give another column in the import map, or leave the signal out of the map"
            if end - begin >= 0.99 * duration:
                text, code = f"stays at {value + 0.0:g} in the whole log, but the boat moves", "channel-constant"
            else:
                code = "channel-frozen"
                advice += ", or leave this time out (t_from, t_to under [[log]])"
                since = f"for {end - begin:.1f} s, from {begin - start:.1f} s on"
                text = f"stays at {value:.6g} {since}, but the boat moves"
            yield Finding("fault", code, "stuck", name, text, advice)


def check_quantised(c: Channels) -> Iterator[Finding]:
    """Yield a warning for positions, and for velocities, in coarse steps, such as minutes with three decimals.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. ``x`` and ``y`` together give at most one warning, ``vx`` and ``vy`` also.
    """
    for group in TRACKS:
        steps = {name: coarse_step(c, name) for name in group if name in c}
        if any(steps.values()):
            unit = "m" if group == ("x", "y") else "m/s"
            text = f"rounded to steps of {max(steps.values()):.2g} {unit}: the rounding error adds to the noise"
            advice = "set more decimals in the receiver, or in the program that exported the log"
            where = ", ".join(name for name, step in steps.items() if step)
            yield Finding("warning", "channel-quantised", "resolution", where, text, advice)


def coarse_step(c: Channels, name: str) -> float:
    """Return the step of a position [m] or velocity [m/s] that its receiver rounds coarsely.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    name
        Name of a channel of the log. For ``vx`` and ``vy`` the speed over ground may be rounded instead of its
        components.

    Returns
    -------
    float
        0 if the signal is not rounded, if its step is not 0.3 to 20 m, or 0.2 to 1.1 m/s, or if it is not ``x``, ``y``,
        ``vx`` or ``vy``.
    """
    if name not in COARSE:
        return 0.0
    return next((step for _, step in _coarse_candidates(c, name)), 0.0)


def _coarse_candidates(c: Channels, name: str) -> Iterator[tuple[Array, float]]:
    """Yield values (n,) that lie on a coarse grid, and the step of the grid: 0.3 to 20 m, or 0.2 to 1.1 m/s.

    The candidates are the signal ``name`` (``x``, ``y``, ``vx`` or ``vy``) and, for ``vx`` or ``vy`` with equal times,
    the speed over ground. Nothing is yielded if neither is rounded coarsely.
    """
    candidates = [c[name].value]
    if name in ("vx", "vy") and {"vx", "vy"} <= set(c) and np.array_equal(c["vx"].t, c["vy"].t):
        candidates.append(np.hypot(c["vx"].value, c["vy"].value))
    least, most = COARSE[name]
    for value in candidates:
        if least <= (step := _grid_step(value)) <= most:
            yield value, step


def _grid_step(value: Array) -> float:
    """Return the step of the grid that contains all values (n,), in the unit of the values.

    The result is 0 if the values are on no grid, are all equal, or have fewer than three samples per different value.
    """
    levels = np.unique(value)
    steps = np.diff(levels)
    steps = steps[steps > 1e-6 * np.ptp(value)]
    if not steps.size or value.size < LEAST_PER_LEVEL * (steps.size + 1):
        return 0.0
    whole = steps / steps.min()
    return float(steps.min()) if np.all(np.abs(whole - np.round(whole)) < ON_GRID) else 0.0


def _resolution_explains_hold(c: Channels, name: str, begin: float, end: float) -> bool:
    """Return whether a coarse resolution explains that a value stays the same from ``begin`` to ``end`` [s].

    This holds if the changes before and after that time are less than 2.5 steps of the resolution. False if the signal
    has no coarse resolution, or if that time is the whole log.
    """
    value, step = next(_coarse_candidates(c, name), (c[name].value, 0.0)) if name in COARSE else (c[name].value, 0.0)
    t = c[name].t
    a, b = int(np.searchsorted(t, begin)), int(np.searchsorted(t, end, side="right"))
    edges = [abs(float(value[k] - value[k - 1])) for k in (a, b) if 0 < k < t.size]
    return bool(step and edges) and max(edges) < MAX_STEPS * step


def _longest_unusual_hold(channel: Channel) -> tuple[float, float]:
    """Return begin and end [s] of the longest time in which the value of a channel stays exactly the same.

    The result is (0, 0) if this time has 10 samples or fewer. It is (0, 0) also if this time is shorter than ten times
    the usual one (99 % quantile of such times, if there are more than 100).
    """
    first = np.flatnonzero(np.diff(channel.value, prepend=np.nan) != 0)
    last = np.append(first[1:], channel.value.size) - 1
    held = channel.t[last] - channel.t[first]
    k = int(np.argmax(held))
    usual = float(np.quantile(held, 0.99)) if held.size > 100 else 0.0
    if last[k] - first[k] < FROZEN_SAMPLES or held[k] < FROZEN_TIMES * usual:
        return 0.0, 0.0
    return float(channel.t[first[k]]), float(channel.t[last[k]])


def _boat_moves(c: Channels, group: Sequence[str], whole: bool, begin: float, end: float) -> bool:
    """Return whether the boat moves from ``begin`` to ``end`` [s], by the other sensors or by its thrusters.

    ``group``: signals of one sensor, which cannot prove the motion. ``whole``: whether all logged signals of the group
    stay the same in that time. A turn of the boat is enough in general, and so is any command if ``whole``. For
    positions and velocities over ground, both thrusters together must also push forward or back, if they are logged.
    For a heading or yaw rate a command is not enough; but if the other one of the two is not logged, a difference of
    both thrusters is.
    """
    turns = any(np.std(turn) > TURNS for turn in _headings_by_other_sensors(c, group, begin, end))
    quantities = (SHAFT_SPEED, THRUSTER_FORCE, COMMAND)
    inputs = {n: _samples_between(c[n], begin, end) for n in c if is_of_thruster(n, *quantities)}
    most = max((float(np.abs(c[n].value).max()) for n in inputs), default=0.0)
    names = [[str(SignalId(side, quantity)) for side in ("left", "right")] for quantity in quantities]
    pairs = [(inputs[left], inputs[right]) for left, right in names if left in inputs and right in inputs]
    steps = np.linspace(begin, end, 50)
    sides = [(np.interp(steps, *a), np.interp(steps, *b)) for a, b in pairs if a[0].size and b[0].size]
    if group in TRACKS and sides:  # turning alone is no proof: the position may stay the same in a turn on the spot
        return (turns or whole) and any(np.mean(np.abs(a + b)) / 2 > DRIVEN * most for a, b in sides)
    if turns:
        return True
    if group in (("psi",), ("r",)):
        return not {"psi", "r"} <= set(c) and any(np.std(a - b) > DRIVEN * most for a, b in sides)
    return whole and any(np.mean(np.abs(value)) > DRIVEN * most for _, value in inputs.values())


def _lacks_sensor_noise(name: str, channel: Channel) -> bool:
    """Return whether the white noise of the channel ``name`` is below that of any sensor, or below its resolution.

    The resolution is the least difference between two different values. The result is false for fewer than 200 samples
    that differ from the one before, also for a constant channel.
    """
    return noise_floor(channel) < max(NO_NOISE[name], float(np.diff(np.unique(channel.value)).min(initial=np.inf)))


def _constant_motion_confirmed(c: Channels, group: Sequence[str], begin: float, end: float) -> bool:
    """Return whether another sensor confirms that the signals of ``group`` were constant from ``begin`` to ``end`` [s].

    Positions confirm a velocity over ground. Velocities over ground confirm an acceleration in the boat's frame. The
    result is false for other groups, and if the other sensor is missing, or a velocity has fewer than 4 samples.
    """
    if group == ("vx", "vy") and {*group, "x", "y"} <= set(c):
        misfits = []
        for place, speed in zip(("x", "y"), group, strict=True):
            t, value = _samples_between(c[place], begin, end)
            moved = value - float(np.interp(begin, c[speed].t, c[speed].value)) * t
            misfits.append(np.std(moved) < max(UNSTEADY_PLACE, TIMES_NOISE * _noise_or_zero(c[place])))
        return all(misfits)
    if group != ("ax", "ay") or not {"psi", "vx", "vy"} <= set(c):
        return False
    t, north = _samples_between(c["vx"], begin, end)
    east = np.interp(t, c["vy"].t, c["vy"].value)
    if t.size < FEWEST_STEADY:
        return False
    fine = np.arange(begin, end, FINE_S)
    psi = np.interp(fine, c["psi"].t, np.unwrap(c["psi"].value))
    C, S = (np.interp(t, fine, np.cumsum(f(psi)) * FINE_S) for f in (np.cos, np.sin))
    ones, zeros = np.ones(t.size), np.zeros(t.size)
    # Velocity at constant acceleration in the boat's frame: the acceleration turned by the heading, and the start.
    rows = np.vstack([np.column_stack([C, -S, ones, zeros]), np.column_stack([S, C, zeros, ones])])
    velocity = np.concatenate([north, east])
    residuals = velocity - rows @ np.linalg.lstsq(rows, velocity, rcond=None)[0]
    return float(np.std(residuals)) < max(
        UNSTEADY_VELOCITY, TIMES_NOISE * max(_noise_or_zero(c["vx"]), _noise_or_zero(c["vy"]))
    )


def _noise_or_zero(channel: Channel) -> float:
    """Return the standard deviation of a signal's white noise (`noise_floor`), or zero if the samples are too few."""
    floor = noise_floor(channel)
    return floor if np.isfinite(floor) else 0.0


def _headings_by_other_sensors(c: Channels, group: Sequence[str], begin: float, end: float) -> Iterator[Array]:
    """Yield the heading (n,) [rad] from ``begin`` to ``end`` [s] by compass and by gyro, unless it is in ``group``.

    By gyro it is the integral of the yaw rate. If the yaw rate is the group, the turn at its constant rate is
    subtracted from the heading. A sensor with too few samples gives one zero.
    """
    if "psi" in c and "psi" not in group:
        t, psi = _samples_between(Channel(c["psi"].t, np.unwrap(c["psi"].value)), begin, end)
        rate = float(np.interp(begin, c["r"].t, c["r"].value)) if group == ("r",) else 0.0
        yield psi - rate * t if psi.size else np.zeros(1)
    if "r" in c and "r" not in group:
        t, r = _samples_between(c["r"], begin, end)
        yield np.cumsum(r[1:] * np.diff(t)) if r.size > 1 else np.zeros(1)


def _samples_between(channel: Channel, begin: float, end: float) -> tuple[Array, Array]:
    """Return times (n,) [s] and values (n,) of the samples from ``begin`` to ``end`` [s], both ends included."""
    inside = (channel.t >= begin) & (channel.t <= end)
    return channel.t[inside], channel.value[inside]


def check_alternating(c: Channels) -> Iterator[Finding]:
    """Yield a fault for signals in which the samples of two sensors alternate, or of two receivers of unequal rate.

    Each value of alternating sensors is off the line between its neighbours, to alternating sides. Receivers of unequal
    rate are found only in positions (`second_receiver`).

    Parameters
    ----------
    c
        Channels (signals) of a log by name. Signals of one sensor, such as ``x`` and ``y``, share one finding.
    """
    for group in GROUPS:
        shares = {name: _alternating_share(c[name]) for name in group if name in c}
        found = [name for name, share in shares.items() if share > ALTERNATES]
        if found:
            text = "the values alternate from sample to sample: two sensors, or two receivers, are in one signal"
            advice = "give each sensor its own topic, column or port, and import only one"
            yield Finding("fault", "two-sensors", "alike", ", ".join(found), text, advice)
        elif group == ("x", "y") and len(shares) == 2 and np.array_equal(c["x"].t, c["y"].t):
            x, y = c["x"], c["y"]
            if x.t.size >= FEWEST and (other := second_receiver(x.t, x.value, y.value)) is not None:
                text = (
                    f"{100 * other.share:.0f} % of the fixes, at regular times, lie {other.offset:.1f} m beside the "
                    "others: two receivers of unequal rate are in one signal"
                )
                advice = "give each receiver its own topic, column or port, and import only one"
                yield Finding("fault", "two-sensors", "alike", "x, y", text, advice)


def _alternating_share(channel: Channel) -> float:
    """Return how much of a signal alternates from sample to sample, from 0 (not at all) to 1.

    Each sample is compared with the straight line between its two neighbours. The result is the share of the mean
    square of these deviations that changes its sign at every sample (median over blocks of 20 samples).

    The result is 0 for fewer than 200 samples, and if more than 20 % of the values repeat the value before: pairs of
    equal values would also alternate.
    """
    value = np.unwrap(channel.value) if channel.unit == "rad" else channel.value
    if value.size < FEWEST or np.mean(np.diff(value) == 0.0) > FEW_REPEATS:
        return 0.0
    dt = np.maximum(np.diff(channel.t), 1e-9)
    distance = value[1:-1] - (value[:-2] * dt[1:] + value[2:] * dt[:-1]) / (dt[1:] + dt[:-1])
    signs = np.where(np.arange(distance.size) % 2 == 0, 1.0, -1.0)
    n = distance.size // ALTERNATE_BLOCK
    blocks = (distance * signs)[: n * ALTERNATE_BLOCK].reshape(n, ALTERNATE_BLOCK)
    whole = np.mean(blocks**2, axis=1)
    return float(np.median(np.mean(blocks, axis=1) ** 2 / np.maximum(whole, 1e-300)))


def check_smoothing(c: Channels, known_noise: Collection[str] = ()) -> Iterator[Finding]:
    """Yield one warning that lists the motion signals without the white noise of a sensor. A filter has smoothed them.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    known_noise
        Signals whose noise the user has given to the fit, as the warning advises. They are not listed.
    """
    smooth = [name for name in smoothed(c) if name not in known_noise]
    if not smooth:
        return
    text = "a filter has smoothed the signal: it lacks the noise of a sensor, and its errors last for seconds"
    if estimated(c) and not {"x", "y"} & set(known_noise):
        advice = (
            "the position has so little noise that it is a navigation filter's output too, so a fit estimates these "
            "errors as states. If its masses are uncertain or implausible, give it the accuracy of the filter's output "
            "(standard deviation, by the data sheet or by experience) as white noise instead, for example "
            f"{filter_noise_options(['x', *smooth])}"
        )
    else:
        advice = (
            "a fit takes at least the noise of a usual sensor; if the data sheet states the accuracy of the filter's "
            f"output, give it to the fit, for example {filter_noise_options(smooth)}"
        )
    yield Finding("warning", "channel-smoothed", "noise", ", ".join(smooth), text, advice)


def filter_noise_options(names: Sequence[str], noises: Mapping[str, str] = MappingProxyType({})) -> str:
    """Return the options of a fit that give the noise of signals, with usual sizes, followed by their units.

    Parameters
    ----------
    names
        Names of motion signals, such as ``psi``. Signals with a common noise, such as ``x`` and ``y``, have one option.
    noises
        Noise parameters of a model by signal, where they are not those of the models of the boat.
    """
    found = {noises.get(n, FILTER_NOISE[n][0]): FILTER_NOISE[n][1:] for n in names}
    options = " ".join(f"--fix {name}={size:g}" for name, (size, _) in found.items())
    return f"{options} (in {', '.join(unit for _, unit in found.values())})"


def smoothed(c: Channels) -> tuple[str, ...]:
    """Return the names of the motion signals whose white noise is less than that of any sensor.

    A signal with fewer than 200 samples that differ from the one before is not among them.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. The limits are, for example, 0.0001 rad for ``psi`` and 0.002 m for ``x``
        (`NO_NOISE`).
    """
    return tuple(n for n in MOTION if n in c and noise_floor(c[n]) < NO_NOISE[n])


def estimated(c: Channels) -> bool:
    """Return whether x or y has so little white noise (less than 3 cm) that the position comes from an estimator.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. A signal that is missing, or that has fewer than 200 samples that differ
        from the one before, does not count. The result is False if neither counts.

    Notes
    -----
    The errors of such a position are correlated for seconds. A receiver with fixed ambiguities (RTK) has errors of the
    same kind.
    """
    return any(n in c and noise_floor(c[n]) < ESTIMATED for n in ("x", "y"))


def noise_floor(channel: Channel) -> float:
    """Return an upper bound of the white noise of a signal.

    Parameters
    ----------
    channel
        The signal. Values that repeat the value before are ignored. Angles [rad] are unwrapped.

    Returns
    -------
    float
        Standard deviation, in the unit of the channel. inf for fewer than 200 samples that differ from the one before.

    Notes
    -----
    The bound is the least of the estimates from differences of orders 2, 4 and 6 (extension of von Neumann's ratio).
    White noise gives the same estimate for all orders. For a smooth signal the estimate falls with the order.
    """
    new = np.append(True, np.diff(channel.value) != 0)
    value = channel.value[new]
    if value.size < FEWEST:
        return np.inf
    value = np.unwrap(value) if channel.unit == "rad" else value
    return min(_noise_from_differences(np.diff(value, order), order) for order in (2, 4, 6))


def _noise_from_differences(differences: Array, order: int) -> float:
    """Return the standard deviation of white noise from the median size of its differences (n,) of the given order.

    The differences have zero mean and the variance of the noise times the binomial coefficient (2 order, order).
    """
    return float(NORMAL_MAD * np.median(np.abs(differences)) / np.sqrt(comb(2 * order, order)))
