"""Time between the sensors of a boat and its thrust, by the motion that each of them must follow.

Theory of operation. Three groups of signals have a clock each: thrust (commands or shaft speeds), attitude (heading and
yaw rate), and position (position and velocity over ground). Within a group a signal is compared with the integral of
another one (`seatrial.ident.checks.sensors`). That comparison is blind to a group that is late as a whole. Between the
groups:

- Yaw rate follows the thrust: its change is a moment by each thruster, less damping, without any delay.
- Speed ahead follows the sum of thrusts in the same way.
- Both together compare attitude with velocity, whatever the delay of the shafts behind the commands is.

Each of the first two is a linear regression: increments of the motion over a window on integrals of thrust and of the
motion itself, repeated for each lag that is tried. The lag with the least error is the delay. Its standard error is
that of the jackknife over blocks of time, so that disturbances that last for seconds count as what they are. Where the
regression explains too little, or the interval is wide, the delay is not known.

Notes
-----
Heading and course over ground by themselves do not tell: a boat that drifts outwards in turns has a course that follows
its heading late, by about a second, with all sensors in time. Source of the jackknife: Kunsch, Annals of Statistics 17
(1989) 1217.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import OK, Finding
from seatrial.ident.checks.sensors import (
    DELAY_FAULT,
    DELAY_WARNING,
    STEP,
    Channels,
    LagErrors,
    LagEstimate,
    cumulative,
    delay_interval,
    delay_level,
    grid,
)
from seatrial.ident.data import Channel
from seatrial.ident.numerics import Array

YAW_WINDOW, SURGE_WINDOW = 0.5, 2.0  # s, of the increments of yaw rate and of speed
LONGEST = 2.5  # s, lag that is tried either way: more than is found, so that no estimate lies at the end
LEAST_SECONDS = 60.0  # of a log
LEAST_R2 = 0.6  # of the increments, from which a regression tells a time
MOST_SE = 0.2  # s, standard error from which a delay is not known
# By how much the model of the regression may be off, times the root of what it does not explain [s]. On boats of other
# plants a yaw rate is found up to 0.2 s early where a fifth is not explained.
SYSTEMATIC = 0.3
SURE = 0.18  # s, that the interval must keep from zero
SHAFT_LAG = 0.2  # s, of usual shafts behind their commands
HEADING_HALF, POSITION_HALF = 0.25, 1.0  # s either way, over which headings and positions are differenced
EVERY = 0.25  # s between two increments
MOST_ROWS = 20_000  # of a regression
GAP_S, GAP_PERIODS = 1.0, 5.0  # a longer pause of a signal is left out

THRUST, ATTITUDE, VELOCITY = "thrust", "heading and yaw rate", "velocity"


class ThrustSignals(NamedTuple):
    """What drives the boat: pushes that turn it and that drive it ahead, and whether they were measured. A command is
    ahead of the thrust by the delay of the shafts, which a fit estimates."""

    turning: list[Channel]
    ahead: list[Channel]
    measured: bool
    where: str


def check_latency(c: Channels, sides: Mapping[str, float]) -> Iterator[Finding]:
    """Compare the times of attitude, velocity and thrust, each pair with its interval.

    Parameters
    ----------
    c
        Channels of a log (`seatrial.ident.data.channels`).
    sides
        Position of each thruster to starboard [m].

    Yields
    ------
    Finding
        ``sensor-late`` or ``thrust-late``; ``sensors-in-time``; ``delay-unknown`` where it cannot be told.
    """
    push = _thrust(c, sides)
    if "psi" not in c:
        return
    attitude, velocity = (f(c, push) if push else None for f in (_yaw_after_thrust, _speed_after_thrust))
    turned, moved = _place(c, ("r", "psi")), _place(c, ("vx", "u", "x"))
    if moved:
        yield from _sensors(attitude, velocity, turned, moved)
    if push:
        yield from _thrust_times(attitude, velocity, push)


def _sensors(attitude: LagEstimate | None, velocity: LagEstimate | None, turned: str, moved: str) -> Iterator[Finding]:
    """Attitude against velocity, each as it follows the thrust."""
    if not _known(attitude) or not _known(velocity):
        text = f"the time between {ATTITUDE} and {VELOCITY} is not known: they follow the thrust too little"
        yield Finding(OK, "delay-unknown", "late", turned, text)
        return
    assert attitude is not None
    assert velocity is not None
    lag, half = attitude.lag - velocity.lag, _half(attitude, velocity)
    late, ahead, where = (ATTITUDE, VELOCITY, turned) if lag > 0.0 else (VELOCITY, ATTITUDE, moved)
    level = _level(abs(lag), half)
    if level == OK:
        apart = f"{abs(lag):.2f} s apart, as both follow the thrust ({delay_interval(abs(lag), half)})"
        text = f"{ATTITUDE} and {VELOCITY} are {apart}"
        yield Finding(OK, "sensors-in-time", "late", turned, text)
        return
    come = "comes" if late == VELOCITY else "come"
    text = f"{late} {come} {abs(lag):.2f} s after {ahead}, as both follow the thrust ({delay_interval(abs(lag), half)})"
    its = "its" if late == VELOCITY else "their"
    yield Finding(level, "sensor-late", "late", where, text, f"{its} filters, output rate or time stamps")


def _thrust_times(attitude: LagEstimate | None, velocity: LagEstimate | None, push: ThrustSignals) -> Iterator[Finding]:
    """Thrust against all sensors: the motion cannot begin before it, and not long after a measured one."""
    found = [one for one in (attitude, velocity) if one is not None and _known(one)]
    if not found:
        yield Finding(OK, "delay-unknown", "late", push.where, "the time between thrust and motion is not known")
        return
    nearest = min(found, key=lambda one: abs(one.lag))  # of two sensors, of which one may be late itself
    same = len({one.lag > 0.0 for one in found}) == 1
    lag, half = nearest.lag, _half(nearest)
    # Commands are ahead of the thrust by the shafts' lag, which hides a part of their own delay.
    fault_from = DELAY_FAULT if push.measured else DELAY_FAULT - SHAFT_LAG
    level = _level(abs(lag), half, fault_from) if same else OK
    if level != OK and lag < 0.0:
        before = f"{-lag:.2f} s before the thrust ({delay_interval(-lag, half)})"
        text = f"the motion comes {before}: the thrust is logged late"
        advice = "time stamps and filters of shaft speeds or commands"
        yield Finding(level, "thrust-late", "late", push.where, text, advice)
    elif level != OK and push.measured:
        text = f"the motion comes {lag:.2f} s after the measured thrust ({delay_interval(lag, half)})"
        advice = "time stamps of the shaft speeds, or of all sensors"
        yield Finding(level, "motion-late", "late", push.where, text, advice)
    else:
        order = "before" if lag < 0.0 else "after"
        text = f"the motion comes {abs(lag):.2f} s {order} the thrust ({delay_interval(abs(lag), half)})"
        yield Finding(OK, "thrust-in-time", "late", push.where, text)


def _level(lag: float, half: float, fault_from: float = DELAY_FAULT) -> str:
    if lag < DELAY_WARNING - STEP / 2 or lag - half < SURE:
        return OK
    return delay_level(lag, half, fault_from)


def _known(found: LagEstimate | None) -> bool:
    return found is not None and found.r2 > LEAST_R2 and found.se < MOST_SE and abs(found.lag) < LONGEST - 2 * STEP


def _half(*found: LagEstimate) -> float:
    """Half the width of a 95 % interval [s] of a delay, or of the difference of two."""
    return float(np.sqrt(sum(one.half**2 + SYSTEMATIC**2 * (1.0 - one.r2) for one in found)))


def _place(c: Channels, names: Sequence[str]) -> str:
    return next((c[n].source or n for n in names if n in c), "")


def _thrust(c: Channels, sides: Mapping[str, float]) -> ThrustSignals | None:
    """The pushes of a log; None without any."""
    if "N" in c or "X" in c:
        return ThrustSignals([c[n] for n in "N" if n in c], [c[n] for n in "X" if n in c], False, "thrust")
    found, measured = dict[str, Channel](), True
    for name in sides:
        key = next((k for k in (f"f_{name}", f"n_{name}", f"n_cmd_{name}") if k in c), "")
        if not key:
            continue
        found[name] = c[key] if key.startswith("f_") else _squared(c[key])
        measured &= key == f"n_{name}" and (c[key].hold == "linear" or (not c[key].hold and f"n_cmd_{name}" in c))
    if not found:
        return None
    return ThrustSignals(list(found.values()), list(found.values()), measured, " and ".join(found))


def _squared(shaft: Channel) -> Channel:
    return Channel(shaft.t, shaft.value * np.abs(shaft.value), "", shaft.source, shaft.hold)


class _Motion(NamedTuple):
    """Motion on a common grid of times t (n,) [s]; NaN nowhere. ``u``, ``v``: over ground, ahead and to starboard
    [m/s], None where nothing tells; ``half``: seconds either way over which they, or r, were differenced."""

    t: Array
    r: Array
    psi: Array | None
    u: Array | None
    v: Array | None
    half: float


def _motion(c: Channels, push: Sequence[Channel], half_r: float = HEADING_HALF) -> _Motion | None:
    names = [n for n in ("psi", "r", "vx", "vy", "u", "v", "x", "y") if n in c]
    t = grid(*push, *(c[n] for n in names))
    if t.size * STEP < LEAST_SECONDS:
        return None
    psi = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value)) if "psi" in c else None
    half = 0.0
    if "r" in c:
        r = np.interp(t, c["r"].t, c["r"].value)
    else:
        assert psi is not None
        r, half = _slope(psi, half_r), half_r
    u = v = None
    if {"u", "v"} <= set(c):
        u, v = (np.interp(t, c[n].t, c[n].value) for n in ("u", "v"))
    elif psi is not None and ({"vx", "vy"} <= set(c) or {"x", "y"} <= set(c)):
        if "vx" in c and "vy" in c:
            north, east = (np.interp(t, c[n].t, c[n].value) for n in ("vx", "vy"))
        else:
            half = max(half, POSITION_HALF)
            north, east = (_slope(np.interp(t, c[n].t, c[n].value), POSITION_HALF) for n in ("x", "y"))
        u, v = north * np.cos(psi) + east * np.sin(psi), east * np.cos(psi) - north * np.sin(psi)
    return _Motion(t, r, psi, u, v, half)


def _slope(s: Array, half: float) -> Array:
    """The derivative (n,) of a signal on the grid over ``half`` seconds either way: the moving mean of its rate."""
    k = round(half / STEP)
    return (np.pad(s, k, mode="edge")[2 * k :] - np.pad(s, k, mode="edge")[: -2 * k]) / (2.0 * k * STEP)


def _yaw_after_thrust(c: Channels, push: ThrustSignals) -> LagEstimate | None:
    """By how much yaw rate follows the thrust late."""
    if not push.turning or (m := _motion(c, push.turning)) is None:
        return None
    smooth = 0.0 if "r" in c else HEADING_HALF
    terms = [m.r, m.r * np.abs(m.r), np.ones(m.t.size)]
    if m.u is not None and m.v is not None:  # the Munk moment, and a sway velocity that is not measured in time
        terms += [m.u * m.v, m.u * m.r, m.v, m.r * np.abs(m.u)]
    pushes = [part for one in push.turning for part in _signs(_at(one, m.t))]
    return _lag(c, m, m.r, terms, pushes, YAW_WINDOW, smooth)


def _speed_after_thrust(c: Channels, push: ThrustSignals) -> LagEstimate | None:
    """By how much speed ahead follows the thrust late."""
    if not push.ahead or (m := _motion(c, push.ahead)) is None or m.u is None or m.v is None:
        return None
    smooth = 0.0 if {"vx", "vy"} <= set(c) or {"u", "v"} <= set(c) else POSITION_HALF
    terms = [m.u, m.u * np.abs(m.u), m.v * m.r, m.r * m.r, np.ones(m.t.size)]
    if m.psi is not None:  # a current
        terms += [np.cos(m.psi), np.sin(m.psi)]
    pushes = _signs(sum((_at(one, m.t) for one in push.ahead), np.zeros(m.t.size)))
    return _lag(c, m, m.u, terms, pushes, SURGE_WINDOW, smooth)


def _at(push: Channel, t: Array) -> Array:
    """A push on the grid: commands hold until the next one."""
    if push.hold != "zero":
        return np.interp(t, push.t, push.value)
    return push.value[np.clip(np.searchsorted(push.t, t, side="right") - 1, 0, None)]


def _signs(f: Array) -> list[Array]:
    """Its parts ahead and astern: a propeller pushes less astern."""
    return [part for part in (np.maximum(f, 0.0), np.minimum(f, 0.0)) if np.ptp(part) > 1e-6]


def _lag(
    c: Channels, m: _Motion, y: Array, terms: Sequence[Array], pushes: Sequence[Array], window: float, smooth: float
) -> LagEstimate | None:
    """The lag of ``y`` (n,) behind the pushes, beside terms of the motion; ``smooth``: the moving mean that y went
    through, which all others go through, too."""
    if not pushes or np.std(y) < 1e-9:
        return None
    mean = (lambda s: _slope(cumulative(m.t, s), smooth)) if smooth else (lambda s: s)
    own = [cumulative(m.t, mean(s)) for s in terms]
    late = [cumulative(m.t, mean(s)) for s in pushes]
    ahead, most = round(window / STEP), round(LONGEST / STEP)
    every = max(round(EVERY / STEP), y.size // MOST_ROWS)
    at = np.arange(most, y.size - most - ahead, every)
    at = at[_undisturbed(c, m.t, at, ahead)]
    if at.size * every * STEP < LEAST_SECONDS:
        return None
    errors = LagErrors(np.linspace(-LONGEST, LONGEST, 2 * most + 1), at.size)
    target = y[at + ahead] - y[at]
    fixed = np.column_stack([s[at + ahead] - s[at] for s in own])
    for k in range(-most, most + 1):
        moved = np.column_stack([s[at - k + ahead] - s[at - k] for s in late])
        errors.add(np.column_stack([fixed, moved]), target)
    return errors.estimate()


def _undisturbed(c: Channels, t: Array, at: NDArray[np.intp], ahead: int) -> NDArray[np.bool_]:
    """Which increments lie in no pause of a sensor (n_rows,)."""
    paused = np.zeros(t.size + 1)
    for name in (n for n in ("psi", "r", "vx", "vy", "x", "y", "u", "v") if n in c):
        pause = np.diff(c[name].t)
        for k in np.flatnonzero(pause > max(GAP_S, GAP_PERIODS * float(np.median(pause)))):
            a, b = np.searchsorted(t, c[name].t[k : k + 2])
            paused[a] += 1.0
            paused[b] -= 1.0
    before = np.append(0.0, np.cumsum(np.cumsum(paused[:-1]) > 0.0))
    return np.asarray(before[at + ahead + 1] == before[at])
