"""Each signal of a log by itself: sample interval, range and unit, frozen segments, smoothing."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from math import comb

import numpy as np

from seatrial.daq.checks import Finding
from seatrial.ident.checks.sensors import Channels
from seatrial.ident.data import Channel
from seatrial.ident.numerics import NORMAL_MAD, Array

MOTION = ("psi", "r", "ax", "ay", "x", "y", "vx", "vy", "u", "v")
# Those that one sensor gives: none of them proves that another one moves.
GROUPS = (("psi",), ("r",), ("ax", "ay"), ("x", "y"), ("vx", "vy"), ("u", "v"))
PLACES = (("x", "y"), ("vx", "vy"))
BODY = (("ax", "ay"), ("u", "v"))  # one axis of which may be zero all the time
LONGEST_INTERVAL, SHORTEST_INTERVAL = 10.0, 2e-4  # s between samples of a boat's sensors
DAY, YEAR = 86400.0, 365.25 * 86400.0  # s
LONGEST_PAUSE = DAY  # of a log that is one run
MOST_N = 1.5  # of full speed: more is another unit
MOST_YAW_RATE = 5.0  # rad/s
TWICE = np.radians(2.0 * np.pi)  # rad, a turn of a heading in radians that was taken for degrees
MOST_TRACK = 0.1  # degrees, of a track that is in degrees
FROZEN_S, FROZEN_SAMPLES = 5.0, 10  # a value that stays exactly the same for longer than both,
FROZEN_TIMES = 10.0  # and for so many times what it usually does (99 %), while the boat moves:
TURNS, DRIVEN = 0.15, 0.1  # standard deviation of the heading [rad]; command as a part of the largest
SETTLED_S = 1.0  # that a receiver is late at most, after a change that ends a steady motion
# By what a motion is not steady: a velocity over ground (m/s) off one of constant acceleration in the boat's frame,
# positions (m) off a straight line at constant speed; or so many times their noise
UNSTEADY_VELOCITY, UNSTEADY_PLACE, TIMES_NOISE = 0.15, 0.5, 3.0
# Standard deviations from sample to sample below which no sensor's noise is in a signal (rad, rad/s, m/s2, m, m/s).
NO_NOISE = {"psi": 1e-4, "r": 1e-4, "ax": 1e-3, "ay": 1e-3, "x": 2e-3, "y": 2e-3, "vx": 1e-3, "vy": 1e-3, "u": 1e-3,
            "v": 1e-3}  # fmt: skip
ESTIMATED = 0.03  # m: white noise of a position that is less than this is no receiver's but an estimator's
FEWEST = 200  # samples
# Least and largest step of a coarse resolution (m, m/s), as 0.001 and 0.01 minutes or 1 km/h and 1 m/s; samples per
# level that show it; how near to a whole number of steps each difference is; steps at both ends of a value that stays
# the same for the sake of the resolution.
COARSE = {"x": (0.3, 20.0), "y": (0.3, 20.0), "vx": (0.2, 1.1), "vy": (0.2, 1.1)}
LEAST_PER_LEVEL, ON_GRID, MOST_STEPS = 3, 0.02, 2.5
# Samples that are judged together, share of their differences that alternates between two sensors (of white noise it is
# 0.05), and share of repeats from which values are held.
ALTERNATE_BLOCK, ALTERNATES, FEW_REPEATS = 20, 0.7, 0.2
FEWEST_STEADY, FINE_S = 4, 0.02  # samples of a velocity that bears an acceleration out; s, step of its integral


def check_intervals(c: Channels) -> Iterator[Finding]:
    """Whether time is in seconds, as far as the samples' distance shows it."""
    for name in (n for n in MOTION if n in c):
        pause = np.diff(c[name].t)
        step = float(np.median(pause))
        if pause.max() > LONGEST_PAUSE:
            # The grids of the other checks would fill the memory.
            k = int(np.argmax(pause))
            far = f"{pause[k] / YEAR:.1f} years" if pause[k] > YEAR else f"{pause[k] / DAY:.1f} days"
            text = f"its times jump by {far}, {c[name].t[k] - c[name].t[0]:.1f} s from its start"
            advice = "a clock that was not set yet, or two runs: cut the log there, [[log]] t_from, t_to in the map"
            yield Finding("fault", "times-jump", "time", name, text, advice)
            return
        if step > LONGEST_INTERVAL or step < SHORTEST_INTERVAL:
            unit = "ms" if LONGEST_INTERVAL < step < 1e4 else "us" if step > 1.0 else "another unit than s"
            yield Finding(
                "fault",
                "time-scale",
                "time",
                name,
                f"one sample every {step:.3g} s: is its time in {unit}?",
                "[time] format in the import's map: s, ms, us, ns",
            )
            return


def check_ranges(c: Channels) -> Iterator[Finding]:
    """Values that no boat has: shaft speeds and commands, yaw rate, positions in degrees."""
    for name in sorted(n for n in c if n.startswith("n_")):
        most = float(np.quantile(np.abs(c[name].value), 0.99))
        if most > MOST_N:
            value = c[name].value
            pulses = float(np.median(value)) > 700.0 and float(value.max()) < 2600.0
            what = "a pulse width in us" if pulses else "percent" if most <= 110.0 else "rev/min, or a wrong offset"
            how = "scale = 0.0025, offset = -3.75" if pulses else f"scale = {0.01 if most <= 110.0 else 1.0 / most:.3g}"
            yield Finding(
                "fault",
                "n-out-of-range",
                "units",
                name,
                f"goes from {value.min():.4g} to {value.max():.4g}, and 1 is full speed: {what}?",
                f"{how} in the import's map (value = sign * (scale * cell + offset)); rpm_max of the rig",
            )
    if "r" in c and (most := float(np.quantile(np.abs(c["r"].value), 0.99))) > MOST_YAW_RATE:
        text = f"{most:.3g} rad/s: in deg/s?"
        yield Finding("fault", "angle-in-degrees", "units", "r", text, 'unit = "deg/s" in the import\'s map')
    if "psi" in c and np.abs(c["psi"].value).max() > 7.0:
        t = np.arange(c["psi"].t[0], c["psi"].t[-1], max(1.0, 2.0 * float(np.median(np.diff(c["psi"].t)))))
        rate = np.diff(np.interp(t, c["psi"].t, np.unwrap(c["psi"].value, period=360.0))) / np.diff(t)
        if rate.size and float(np.quantile(np.abs(rate), 0.95)) > MOST_YAW_RATE:
            text = f"from {c['psi'].value.min():.4g} to {c['psi'].value.max():.4g} rad: in degrees?"
            yield Finding("fault", "angle-in-degrees", "units", "psi", text, 'unit = "deg" in the import\'s map')
    psi = c["psi"].value if "psi" in c else np.zeros(2)
    if 0.9 * TWICE < np.ptp(psi) < 1.02 * TWICE and np.abs(np.diff(psi)).max() > 0.8 * TWICE:
        text = f"jumps by {TWICE:.3f} rad, a turn in radians that was taken for degrees"
        yield Finding("fault", "angle-in-degrees", "units", "psi", text, 'unit = "rad" in the import\'s map')
    if {"x", "y"} <= set(c):
        span = [float(np.ptp(c[n].value)) for n in ("x", "y")]
        away = [abs(float(np.median(c[n].value))) for n in ("x", "y")]
        small = 0.0 < max(span) < MOST_TRACK and away[0] <= 90.0 and away[1] <= 180.0
        if small and max(away) > 20.0 * max(span):
            text = f"a track of {max(span):.2g} m, {away[0]:.4g} and {away[1]:.4g} m from its origin: degrees?"
            yield Finding(
                "fault", "positions-in-degrees", "units", "x, y", text,
                "x and y are metres north and east: scale = 111200 for latitude, 111200 cos(latitude) for longitude",
            )  # fmt: skip


def check_frozen(c: Channels) -> Iterator[Finding]:
    """Signals that stay exactly the same while the boat moves, for a while or all the time."""
    for group in GROUPS:
        held = {name: _longest_hold(c[name]) for name in group if name in c}
        held = {name: (begin, end) for name, (begin, end) in held.items() if end - begin > FROZEN_S}
        for name, (begin, end) in held.items():
            same = [n for n, (a, b) in held.items() if min(b, end) - max(a, begin) > 0.8 * (end - begin)]
            whole = len(same) == len([n for n in group if n in c])
            if (group in BODY and not whole) or not _moves(c, group, whole, begin, end):
                continue
            noisy = group == ("ax", "ay") and not all(_noiseless(n, c[n]) for n in same)
            if not noisy and _steady(c, group, begin + SETTLED_S, end - SETTLED_S):
                continue  # as in simulators, and of a coarse resolution: the same motion is the same value
            if _within_resolution(c, name, begin, end):
                continue
            start, duration = float(c[name].t[0]), float(np.ptp(c[name].t))
            value = float(c[name].value[np.searchsorted(c[name].t, begin)])
            if end - begin >= 0.99 * duration:
                text, code = f"{value:g} all the time, and the boat moves", "channel-constant"
            else:
                code = "channel-frozen"
                text = f"{value:.6g} for {end - begin:.1f} s, from {begin - start:.1f} s on, and the boat moves"
            advice = "another column, or leave that time out: [[log]] t_from, t_to in the import's map"
            yield Finding("fault", code, "stuck", name, text, advice)


def check_quantised(c: Channels) -> Iterator[Finding]:
    """Positions and velocities that are known in coarse steps, as minutes with three decimals and whole knots are."""
    for group in PLACES:
        steps = {name: coarse_step(c, name) for name in group if name in c}
        if any(steps.values()):
            unit = "m" if group == ("x", "y") else "m/s"
            text = f"known in steps of {max(steps.values()):.2g} {unit}: its rounding is a part of its noise"
            advice = "more decimals of the receiver or of the export"
            where = ", ".join(name for name, step in steps.items() if step)
            yield Finding("warning", "channel-quantised", "resolution", where, text, advice)


def coarse_step(c: Channels, name: str) -> float:
    """Return the step of a position [m] or velocity [m/s] that is rounded to coarse steps, as a whole of its receiver;
    0 if there is none. Of a velocity it may be the speed over ground that is rounded."""
    if name not in COARSE:
        return 0.0
    return next((step for _, step in _coarse_values(c, name)), 0.0)


def _coarse_values(c: Channels, name: str) -> Iterator[tuple[Array, float]]:
    """The values (n,) that are rounded to coarse steps, and the step: of the signal, or of the speed over ground."""
    candidates = [c[name].value]
    if name in ("vx", "vy") and {"vx", "vy"} <= set(c) and np.array_equal(c["vx"].t, c["vy"].t):
        candidates.append(np.hypot(c["vx"].value, c["vy"].value))
    least, most = COARSE[name]
    for value in candidates:
        if least <= (step := _grid_step(value)) <= most:
            yield value, step


def _grid_step(value: Array) -> float:
    """Step of the grid that all values (n,) lie on; 0 if they lie on none, or are too few to show it."""
    levels = np.unique(value)
    steps = np.diff(levels)
    steps = steps[steps > 1e-6 * np.ptp(value)]
    if not steps.size or value.size < LEAST_PER_LEVEL * (steps.size + 1):
        return 0.0
    whole = steps / steps.min()
    return float(steps.min()) if np.all(np.abs(whole - np.round(whole)) < ON_GRID) else 0.0


def _within_resolution(c: Channels, name: str, begin: float, end: float) -> bool:
    """Whether a value that stays the same is one step of a coarse resolution: it came, and it goes, by single steps."""
    value, step = next(_coarse_values(c, name), (c[name].value, 0.0)) if name in COARSE else (c[name].value, 0.0)
    t = c[name].t
    a, b = int(np.searchsorted(t, begin)), int(np.searchsorted(t, end, side="right"))
    edges = [abs(float(value[k] - value[k - 1])) for k in (a, b) if 0 < k < t.size]
    return bool(step and edges) and max(edges) < MOST_STEPS * step


def _longest_hold(channel: Channel) -> tuple[float, float]:
    """When the longest time of one value begins and ends [s]; nothing where that is usual."""
    first = np.flatnonzero(np.diff(channel.value, prepend=np.nan) != 0)
    last = np.append(first[1:], channel.value.size) - 1
    held = channel.t[last] - channel.t[first]
    k = int(np.argmax(held))
    usual = float(np.quantile(held, 0.99)) if held.size > 100 else 0.0
    if last[k] - first[k] < FROZEN_SAMPLES or held[k] < FROZEN_TIMES * usual:
        return 0.0, 0.0
    return float(channel.t[first[k]]), float(channel.t[last[k]])


def _moves(c: Channels, group: Sequence[str], whole: bool, begin: float, end: float) -> bool:
    """Whether the boat turns in that time, by another sensor or else by its thrusters; where the ``whole`` group
    stays the same, also whether it is driven."""
    turns = any(np.std(turn) > TURNS for turn in _turns(c, group, begin, end))
    kinds = ("n", "f", "n_cmd")
    inputs = {n: _part(c[n], begin, end) for n in c if n.rpartition("_")[0] in kinds}
    most = max((float(np.abs(c[n].value).max()) for n in inputs), default=0.0)
    pairs = [(inputs[f"{k}_left"], inputs[f"{k}_right"]) for k in kinds if {f"{k}_left", f"{k}_right"} <= set(inputs)]
    steps = np.linspace(begin, end, 50)
    sides = [(np.interp(steps, *a), np.interp(steps, *b)) for a, b in pairs if a[0].size and b[0].size]
    if group in PLACES and sides:  # that it turns says nothing: on the spot its place may well stay the same
        return (turns or whole) and any(np.mean(np.abs(a + b)) / 2 > DRIVEN * most for a, b in sides)
    if turns:
        return True
    if group in (("psi",), ("r",)):
        return not {"psi", "r"} <= set(c) and any(np.std(a - b) > DRIVEN * most for a, b in sides)
    return whole and any(np.mean(np.abs(value)) > DRIVEN * most for _, value in inputs.values())


def _noiseless(name: str, channel: Channel) -> bool:
    """Whether a signal has no noise, or none beyond its resolution."""
    return noise_floor(channel) < max(NO_NOISE[name], float(np.diff(np.unique(channel.value)).min(initial=np.inf)))


def _steady(c: Channels, group: Sequence[str], begin: float, end: float) -> bool:
    """Whether another sensor bears out what a group says that stays the same in that time: positions a velocity, and
    velocities over ground an acceleration in the boat's frame. It is unknown of other groups."""
    if group == ("vx", "vy") and {*group, "x", "y"} <= set(c):
        misfits = []
        for place, speed in zip(("x", "y"), group, strict=True):
            t, value = _part(c[place], begin, end)
            moved = value - float(np.interp(begin, c[speed].t, c[speed].value)) * t
            misfits.append(np.std(moved) < max(UNSTEADY_PLACE, TIMES_NOISE * _noise(c[place])))
        return all(misfits)
    if group != ("ax", "ay") or not {"psi", "vx", "vy"} <= set(c):
        return False
    t, north = _part(c["vx"], begin, end)
    east = np.interp(t, c["vy"].t, c["vy"].value)
    if t.size < FEWEST_STEADY:
        return False
    fine = np.arange(begin, end, FINE_S)
    psi = np.interp(fine, c["psi"].t, np.unwrap(c["psi"].value))
    C, S = (np.interp(t, fine, np.cumsum(f(psi)) * FINE_S) for f in (np.cos, np.sin))
    one, none = np.ones(t.size), np.zeros(t.size)
    rows = np.vstack([np.column_stack([C, -S, one, none]), np.column_stack([S, C, none, one])])
    velocity = np.concatenate([north, east])
    off = velocity - rows @ np.linalg.lstsq(rows, velocity, rcond=None)[0]
    return float(np.std(off)) < max(UNSTEADY_VELOCITY, TIMES_NOISE * max(_noise(c["vx"]), _noise(c["vy"])))


def _noise(channel: Channel) -> float:
    """Standard deviation of a signal's noise; zero where too few samples tell it."""
    floor = noise_floor(channel)
    return floor if np.isfinite(floor) else 0.0


def _turns(c: Channels, group: Sequence[str], begin: float, end: float) -> Iterator[Array]:
    """Heading [rad] in that time by the sensors that are not of the group, less what a frozen yaw rate says."""
    if "psi" in c and "psi" not in group:
        t, psi = _part(Channel(c["psi"].t, np.unwrap(c["psi"].value)), begin, end)
        rate = float(np.interp(begin, c["r"].t, c["r"].value)) if group == ("r",) else 0.0
        yield psi - rate * t if psi.size else np.zeros(1)
    if "r" in c and "r" not in group:
        t, r = _part(c["r"], begin, end)
        yield np.cumsum(r[1:] * np.diff(t)) if r.size > 1 else np.zeros(1)


def _part(channel: Channel, begin: float, end: float) -> tuple[Array, Array]:
    inside = (channel.t >= begin) & (channel.t <= end)
    return channel.t[inside], channel.value[inside]


def check_alternating(c: Channels) -> Iterator[Finding]:
    """Signals of two sensors that alternate: each value lies off the line between its neighbours, to one side and to
    the other in turn."""
    for group in GROUPS:
        shares = {name: _alternating(c[name]) for name in group if name in c}
        found = [name for name, share in shares.items() if share > ALTERNATES]
        if found:
            text = "its values jump to and fro from sample to sample: two sensors, or two receivers, in one signal"
            advice = "give each sensor a topic, column or port of its own, and import one of them"
            yield Finding("fault", "two-sensors", "alike", ", ".join(found), text, advice)


def _alternating(channel: Channel) -> float:
    """Share of the differences from the line between the neighbours that alternates in sign; 0 for few samples, and for
    values that repeat, which alternate when each stands in two rows."""
    value = np.unwrap(channel.value) if channel.unit == "rad" else channel.value
    if value.size < FEWEST or np.mean(np.diff(value) == 0.0) > FEW_REPEATS:
        return 0.0
    dt = np.maximum(np.diff(channel.t), 1e-9)
    off = value[1:-1] - (value[:-2] * dt[1:] + value[2:] * dt[:-1]) / (dt[1:] + dt[:-1])
    signs = np.where(np.arange(off.size) % 2 == 0, 1.0, -1.0)
    n = off.size // ALTERNATE_BLOCK
    blocks = (off * signs)[: n * ALTERNATE_BLOCK].reshape(n, ALTERNATE_BLOCK)
    whole = np.mean(blocks**2, axis=1)
    return float(np.median(np.mean(blocks, axis=1) ** 2 / np.maximum(whole, 1e-300)))


def check_smoothing(c: Channels) -> Iterator[Finding]:
    """Signals without any sensor's noise: what a filter made of sensors, with errors that last."""
    smooth = smoothed(c)
    if smooth:
        text = "no sensor's noise is seen from sample to sample: smoothed by a filter, whose errors last for seconds"
        yield Finding(
            "warning", "channel-smoothed", "noise", ", ".join(smooth), text,
            "give the noise of these channels (--fix e_psi=0.03, ...); else a usual sensor's is the least fitted",
        )  # fmt: skip


def smoothed(c: Channels) -> tuple[str, ...]:
    """The signals of motion in which no white noise is seen."""
    return tuple(n for n in MOTION if n in c and noise_floor(c[n]) < NO_NOISE[n])


def estimated(c: Channels) -> bool:
    """Whether the position is an estimator's output, or a receiver's with errors of that kind (fixed ambiguities)."""
    return any(n in c and noise_floor(c[n]) < ESTIMATED for n in ("x", "y"))


def noise_floor(channel: Channel) -> float:
    """Upper bound of a signal's white noise (standard deviation) from differences of rising order; inf for few samples.

    White noise is the same in all orders; a smooth signal goes to zero with the order (von Neumann's ratio, extended).
    Values that repeat the one before are no samples.
    """
    new = np.append(True, np.diff(channel.value) != 0)
    value = channel.value[new]
    if value.size < FEWEST:
        return np.inf
    value = np.unwrap(value) if channel.unit == "rad" else value
    return min(_scatter(np.diff(value, order), order) for order in (2, 4, 6))


def _scatter(differences: Array, order: int) -> float:
    return float(NORMAL_MAD * np.median(np.abs(differences)) / np.sqrt(comb(2 * order, order)))
