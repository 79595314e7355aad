"""Signs and sides of thrusters from the boat's motion, before any fit: regressions, no model but first-order lags.

Yaw rate and forward speed are regressed on each thruster's thrust behind a first-order lag, whose time constant is
searched. A boat that an autopilot steers oscillates: a free delay would let a thrust explain the turn before it. The
turning moment is regressed beside the sum of thrusts, which turns a boat that is not quite even. Without a gyro the
yaw rate is that of the heading, else of the course over ground. Errors are robust to correlated residuals (sums over
blocks of time), and an effect that explains too little of the motion (``SURE``) has no sign. Found are thrusters that
are swapped, reversed or dead.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import Finding
from seatrial.ident.checks.frames import half_turn
from seatrial.ident.checks.sensors import Channels
from seatrial.ident.data import Channel, block_mean
from seatrial.ident.numerics import Array, first_order_lag

RATE = 10.0  # Hz, of the regressions
YAW_LAGS, SURGE_LAGS = (0.3, 0.6, 1.0, 1.7, 3.0), (1.0, 2.0, 4.0, 8.0)  # s, time constants that are tried
MIN_DURATION = 15.0  # s, of a log
BLOCK, FEWEST_BLOCKS = 5.0, 6  # s, at least, of residuals that are taken together; and their number
# t statistic, and share of the motion's variance, from which an effect has a sign. In straight runs of 90 mock boats
# the thrust difference that is left has a share of at most 0.26 with the wrong sign, at t = 3.
SIGNIFICANT_T = 4.5
SURE = ((SIGNIFICANT_T, 0.05), (3.0, 0.3))
LEANING_T = 2.0  # from which an effect has a sign beside another that is sure
FELT_T = 3.0  # from which a push ahead is felt: in a minute's log a thruster may turn the boat too little to be seen
COURSE_HALF = 1.0  # s either way, over which positions are differenced for a course
SLOWEST = 0.3  # m/s, over ground: a slower boat's course says nothing of its turning
DEAD_RATIO = 0.4  # of the strongest thruster's effect: one that is surely less, and has no sign, is none
MIN_OWN_VARIATION = 0.1  # share of a thruster's variation that the others lack, from which it has an effect of its own


class RegressionEffect(NamedTuple):
    """Effect of each thruster's push on one motion, its t statistic (0 where it cannot be told apart) and the share of
    the motion's variance that it alone explains."""

    size: Array
    t: Array
    share: Array

    @property
    def sign(self) -> Array:
        """+1 or -1 where it is sure, else 0."""
        sure = np.any([(np.abs(self.t) > t) & (self.share > share) for t, share in SURE], axis=0)
        return np.where(sure, np.sign(self.size), 0.0)


class PushResponse(NamedTuple):
    """Effects on yaw rate and on speed ahead, and the sign of the effect of the turning moment on yaw."""

    names: tuple[str, ...]
    yaw: RegressionEffect
    surge: RegressionEffect
    moment: int


class ThrusterForces(NamedTuple):
    """Each thruster's push f (n, n_thrusters) on common times t (n,) [s] between ``edges`` (n + 1,), and its side."""

    names: tuple[str, ...]
    t: Array
    edges: Array
    f: Array
    side: Array


def check_motion(c: Channels, sides: Mapping[str, float], dead: Collection[str] = ()) -> Iterator[Finding]:
    """Whether the boat moves as its thrusters push; ``sides``: thruster -> position to starboard [m].

    Nothing more is said of thrusters that are known to be ``dead``.
    """
    found = thrust_responses(c, sides)
    if found is None:
        return
    yaw, surge = found.yaw.sign * _side(sides, found.names), found.surge.sign
    faults = [f for f in _verdict(found, yaw, surge) if f.where not in dead]
    yield from faults
    if not faults and not dead and ((yaw > 0).any() or found.moment > 0):
        yield Finding("ok", "thruster-sides-agree", "sides", " and ".join(found.names), "the boat turns as they push")


def _verdict(found: PushResponse, yaw: Array, surge: Array) -> Iterator[Finding]:
    if found.moment > 0 and (surge < 0).any() and not (surge > 0).any() and not (yaw < 0).any():
        yield half_turn("the boat turns as its thrusters push, and moves astern of its heading when they push ahead")
        return
    # One that pushes ahead as it should and turns the boat the wrong way is on the other side.
    ahead_too = found.surge.t > LEANING_T
    against = found.moment < 0 or bool(found.moment == 0 and ((yaw < 0) & ahead_too).any())
    if against and not (yaw > 0).any() and not (surge < 0).any():
        yield Finding(
            "fault",
            "thruster-sides-swapped",
            "sides",
            " and ".join(found.names),
            "left and right are swapped: the boat turns against its thrust difference",
            "exchange the plugs, the nodes in the rig, the columns in the import's map, or y_left and y_right (--fix); "
            "else the signs of both thrusters, or of heading and yaw rate (east, north, up)",
        )
        return
    most = np.minimum(_most(found.yaw), _most(found.surge))
    for k, name in enumerate(found.names):
        if surge[k] < 0 or (yaw[k] < 0 and not ahead_too[k]):
            yield Finding(
                "fault",
                "thruster-sign-reversed",
                "sign",
                name,
                "it pushes astern when it is told ahead",
                "`reversed` of the rig, two of the motor's phases, or a propeller of the other hand",
            )
        elif most[k] < DEAD_RATIO and not (yaw[k] > 0 or surge[k] > 0 or found.surge.t[k] > FELT_T):
            yield Finding(
                "fault",
                "thruster-without-effect",
                "dead",
                name,
                "the boat does not feel it: no thrust in yaw or surge",
                "propeller lost or fouled, or the shaft does not turn",
            )


def _most(effect: RegressionEffect) -> Array:
    """Upper bound (two standard errors) of each effect as a part of the largest; 1 where nothing can be said."""
    clear = np.abs(effect.t) > 1.5 * SIGNIFICANT_T
    if not clear.any():
        return np.ones(effect.size.size)
    size = np.abs(effect.size)
    bound = size + 2.0 * size / np.maximum(np.abs(effect.t), 1e-12)
    return np.where(effect.t != 0, bound / size[clear].max(), 1.0)


def thrust_responses(c: Channels, sides: Mapping[str, float]) -> PushResponse | None:
    """Regressions of yaw rate and speed ahead on each thruster's push; None as for `thruster_forces`, and where nothing
    tells how the boat turns."""
    given = thruster_forces(c, sides)
    if given is None:
        return None
    rate = best_turn_rate(c, given.edges)
    if rate is None:
        return None
    yaw = _effect(rate, given.f, [], YAW_LAGS)
    return PushResponse(given.names, yaw, _surge(c, given.t, given.edges, given.f), _moment(given, rate))


def best_turn_rate(c: Channels, edges: Array) -> Array | None:
    """``turn_rate`` of the best sensor that tells it: gyro, else heading, else course; None where none does."""
    rates = (turn_rate(c, edges, name) for name in ("gyro", "heading", "course"))
    return next((rate for rate in rates if rate is not None and np.isfinite(rate).any()), None)


def turning(c: Channels, sides: Mapping[str, float]) -> dict[str, int]:
    """Whether the boat turns as its thrusters push, by ``gyro`` and ``heading``, and by the course of its ``position``
    where there is no heading: +1, -1 where it turns against them, 0 where that is not sure."""
    given = thruster_forces(c, sides)
    if given is None:
        return {}
    names = {"gyro": "gyro"} | ({"heading": "heading"} if "psi" in c else {"position": "course"})
    rates = {name: turn_rate(c, given.edges, by) for name, by in names.items()}
    return {name: _moment(given, rate) for name, rate in rates.items() if rate is not None}


def _moment(given: ThrusterForces, rate: Array) -> int:
    """Sign of the effect of the turning moment; nothing where the sum of thrusts does as well."""
    if not given.side.any():
        return 0
    return int(_effect(rate, np.column_stack([given.f @ given.side, given.f.sum(axis=1)]), [], YAW_LAGS).sign[0])


def turn_rate(c: Channels, edges: Array, name: str) -> Array | None:
    """Yaw rate (n,) [rad/s] between edges (n + 1,), by the ``gyro``, the ``heading`` or the ``course`` over ground;
    None without that sensor; NaN where the boat is too slow for a course."""
    t = (edges[1:] + edges[:-1]) / 2
    if name == "gyro":
        return fill_gaps(t, block_mean(c["r"], edges)[0]) if "r" in c else None
    if name == "heading":
        return _difference(c["psi"].t, np.unwrap(c["psi"].value), t) if "psi" in c else None
    if not {"x", "y"} <= set(c):
        return None
    vx, vy = (_difference(c[n].t, c[n].value, t, COURSE_HALF) for n in ("x", "y"))
    ax, ay = (_difference(t, v, t, COURSE_HALF) for v in (vx, vy))
    speed = np.hypot(vx, vy)
    return np.where(speed > SLOWEST, (vx * ay - vy * ax) / np.maximum(speed, SLOWEST) ** 2, np.nan)


def _difference(t: Array, value: Array, at: Array, half: float = 0.5) -> Array:
    """Rate of change (n,) at times ``at`` (n,) of a signal (k,) at times t (k,), over ``half`` seconds either way, or
    two samples."""
    half = max(half, float(np.median(np.diff(t))))
    return np.asarray((np.interp(at + half, t, value) - np.interp(at - half, t, value)) / (2.0 * half))


def thruster_forces(c: Channels, sides: Mapping[str, float]) -> ThrusterForces | None:
    """The thrusters' pushes on common times; None without push or turning, or where the log is too short."""
    found = {n: s for n in sides if (s := _push(c, n)) is not None}
    turns = next((c[n] for n in ("r", "psi", "x") if n in c), None)
    if not found or turns is None:
        return None
    used = [*found.values(), turns]
    start, end = max(s.t[0] for s in used), min(s.t[-1] for s in used)
    edges = np.arange(start, end, 1.0 / RATE)
    if edges.size < MIN_DURATION * RATE:
        return None
    t = edges[:-1] + 0.5 / RATE
    f = np.column_stack([np.interp(t, s.t, s.value) for s in found.values()])
    return ThrusterForces(tuple(found), t, edges, f, _side(sides, tuple(found)))


def _push(c: Channels, name: str) -> Channel | None:
    if f"f_{name}" in c:
        return c[f"f_{name}"]
    shaft, told = c.get(f"n_{name}"), c.get(f"n_cmd_{name}")
    if shaft is None or (told is not None and shaft.t[-1] < told.t[-1] - 3.0):
        shaft = told  # without telemetry, or with one that ended
    if shaft is None:
        return None
    return Channel(shaft.t, shaft.value * np.abs(shaft.value))


def _side(sides: Mapping[str, float], names: Sequence[str]) -> Array:
    """+1 for a thruster on the left, whose push turns the bow to starboard, -1 on the right, 0 in the middle."""
    return np.array([-np.sign(sides[n]) if abs(sides[n]) > 0.02 else 0.0 for n in names])


def _surge(c: Channels, t: Array, edges: Array, f: Array) -> RegressionEffect:
    """On speed ahead over ground, or on the accelerometer where that says more."""
    found = RegressionEffect(*np.zeros((3, f.shape[1])))
    drift = []
    if "psi" in c:  # a current shows in the speed over ground, ahead on one heading and astern on the other
        psi = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value))
        drift = [np.cos(psi), np.sin(psi)]
    if (u := ahead(c, t)) is not None:
        found = _effect(u, f, drift, SURGE_LAGS)
    if "ax" in c and np.abs(found.t).max() < 2 * SIGNIFICANT_T:
        ax = fill_gaps(t, block_mean(c["ax"], edges)[0])
        other = _effect(ax, f, [], SURGE_LAGS, washed=True)
        if np.abs(other.t).sum() > np.abs(found.t).sum():
            return other
    return found


def _effect(
    y: Array, f: Array, others: Sequence[Array], lags: Sequence[float], *, washed: bool = False
) -> RegressionEffect:
    """Factors of the lagged columns of f in y (with ``washed`` of what the lag leaves over), at the lag that fits best;
    rows where y is NaN do not count.

    Neighbouring samples are not independent: one in two time constants counts, and no more than sums of scores over
    blocks of time say (Newey and West's idea, with blocks).
    """
    there = np.isfinite(y)
    y, free = y[there], _own_part(f[there])
    columns = np.flatnonzero(free > MIN_OWN_VARIATION)
    size, t, share = np.zeros((3, f.shape[1]))
    if not columns.size or y.size < MIN_DURATION * RATE or np.ptp(y) == 0.0:
        return RegressionEffect(size, t, share)
    best = np.inf
    for lag in lags:
        past = first_order_lag(f, lag, 1.0 / RATE)
        X = np.column_stack([f - past if washed else past, *others, np.ones(there.size)])[there]
        beta, *_ = np.linalg.lstsq(X, y, rcond=None)
        e = y - X @ beta
        error = float(e @ e) / y.size
        if error < best:
            best, inverse = error, np.linalg.pinv(X.T @ X / y.size)
            count = max(y.size / RATE / (2.0 * lag) - X.shape[1], 1.0)
            variance = np.maximum(np.diag(inverse) * error / count, _block_variance(X, e, inverse, lag))
            size[columns] = beta[columns]
            t[columns] = beta[columns] / np.sqrt(np.maximum(variance[columns], 1e-300))
            share[columns] = beta[columns] ** 2 / np.maximum(np.diag(inverse)[columns], 1e-300) / np.var(y)
    return RegressionEffect(size, t, share)


def _block_variance(X: Array, e: Array, inverse: NDArray[Any], lag: float) -> Array:
    """Variances (k,) of the factors of X (n, k) from sums of their scores over blocks; infinite for few blocks."""
    rows = round(max(BLOCK, 4.0 * lag) * RATE)
    count = e.size // rows
    if count < FEWEST_BLOCKS:
        rows, count = max(e.size // FEWEST_BLOCKS, 1), FEWEST_BLOCKS
    sums = np.add.reduceat(X * e[:, None], np.arange(count) * rows) @ inverse / e.size
    return np.asarray((sums**2).sum(axis=0) * count / max(count - X.shape[1], 1.0))


def _own_part(f: Array) -> Array:
    """Part of each column's spread that the others do not share; 0 for one that does not vary."""
    centred = f - f.mean(axis=0)
    spread = centred.std(axis=0)
    found = np.zeros(f.shape[1])
    for k in np.flatnonzero(spread > 1e-9):
        rest = np.delete(centred, k, axis=1)
        column = centred[:, k]
        shared = rest @ np.linalg.lstsq(rest, column, rcond=None)[0] if rest.size else np.zeros_like(column)
        found[k] = (column - shared).std() / spread[k]
    return found


def delayed_forces(y: Array, push: Array, lags: Sequence[float]) -> Array:
    """What a push (n,) does to y (n,) through the first-order lag that fits best, with the sign that it should have.

    Where y goes the other way the two are mirror images: that is what swapped sides look like.
    """
    found, best = np.full(y.size, np.nan), np.inf
    for lag in lags:
        past = first_order_lag(push, lag, 1.0 / RATE)
        X = np.column_stack([past, np.ones(y.size)])
        beta, *_ = np.linalg.lstsq(X, y, rcond=None)
        error = float(np.sum((y - X @ beta) ** 2))
        if error < best:
            best, found = error, abs(beta[0]) * (past - past.mean()) + y.mean()
    return found


def ahead(c: Channels, t: Array) -> Array | None:
    """Speed ahead [m/s] at the times t, over ground."""
    if "u" in c:
        return np.interp(t, c["u"].t, c["u"].value)
    if "psi" not in c or not ({"vx", "vy"} <= set(c) or {"x", "y"} <= set(c)):
        return None
    psi = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value))
    if "vx" in c and "vy" in c:
        vx, vy = (np.interp(t, c[n].t, c[n].value) for n in ("vx", "vy"))
    else:
        vx, vy = (_difference(c[n].t, c[n].value, t) for n in ("x", "y"))
    return np.asarray(np.cos(psi) * vx + np.sin(psi) * vy)


def fill_gaps(t: Array, values: Array) -> Array:
    """Values (n,) at t (n,) with NaN filled in between the others."""
    good = np.isfinite(values)
    return np.interp(t, t[good], values[good])
