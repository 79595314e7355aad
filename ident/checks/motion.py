"""Signs and sides of thrusters from the motion of the boat, by regressions with first-order lags.

Theory of operation. Yaw rate and surge speed are regressed on the thrust of each thruster behind a first-order lag. The
time constant of the lag is searched. There is no free delay: a boat that an autopilot steers oscillates, and with a
free delay a thrust could explain the turn before it. The turning moment is regressed beside the sum of the thrusts,
since the sum also turns an asymmetric boat; in spins on the spot, where the sum is small, it is regressed alone.
Without a gyro the yaw rate is taken from the heading, else from the course over ground. Standard errors are robust to
correlated residuals (sums over blocks of time). An effect that explains too little of the motion (``SIGN_LIMITS``) has
no sign. The checks find thrusters that are swapped, reversed or dead.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from seatrial.daq.checks import UNKNOWN, Finding
from seatrial.ident.checks.frames import half_turn
from seatrial.ident.checks.sensors import Channels
from seatrial.ident.data import Channel, block_mean
from seatrial.ident.model import command_of, shaft_speed_of, thrust_of
from seatrial.ident.numerics import Array, first_order_lag, ned_to_body

RATE = 10.0  # Hz, of the regressions
YAW_LAGS, SURGE_LAGS = (0.3, 0.6, 1.0, 1.7, 3.0), (1.0, 2.0, 4.0, 8.0)  # s, time constants of the search
LEAST_DIFFERENCE = 0.02  # of the thrust of both sides, as a part of the range of the thrusts; with less they are equal
MIN_DURATION = 15.0  # s, of a log
BLOCK_S, FEWEST_BLOCKS = 5.0, 6  # least duration and number of the blocks of residuals
# An effect has a sign if its t statistic and its share of the variance of the motion are above one of these pairs. In
# straight runs of 90 mock boats the remaining thrust difference has a wrong sign with a share up to 0.26 at t = 3.
SIGNIFICANT_T = 4.5
SIGN_LIMITS = ((SIGNIFICANT_T, 0.05), (3.0, 0.3))
# With thrusters in a fixed ratio, as in spins on the spot, the turning moment and the sum of the thrusts change
# together. The moment is then the cause if its spread is this much larger: the sum of the thrusts turns an asymmetric
# boat with at most the arm of a thruster, as if the other one had no thrust.
SPIN_RATIO = 2.0
ONE_SIDED = 0.95  # share of the turns to one side in a log without turns to the other side
LEANING_T = 2.0  # enough for the sign of an effect that another, significant effect supports
SURGE_T = 3.0  # t statistic of the surge effect of a working thruster; in a short log it may hardly turn the boat
COURSE_HALF = 1.0  # s before and after, over which positions are differenced for a course
SLOWEST = 0.3  # m/s over ground; the course of a slower boat does not show how it turns
DEAD_RATIO = 0.4  # of the strongest thruster's effect; a thruster without a sign whose upper bound is less is dead
MIN_OWN_VARIATION = 0.1  # share of a thruster's variation that other thrusters lack; with less it is not separable


class RegressionEffect(NamedTuple):
    """Effects of the thrusters on one motion.

    Attributes
    ----------
    size
        Regression factors (n_thrusters,): motion per unit of thrust. 0 for a thruster that is not separable from
        others.
    t
        t statistics (n_thrusters,); 0 for a thruster that is not separable from others.
    share
        Share (n_thrusters,) of the variance of the motion that this thruster alone explains.
    """

    size: Array
    t: Array
    share: Array

    @property
    def sign(self) -> Array:
        """Sign of each effect (n_thrusters,): +1 or -1 if it is significant, else 0.

        An effect is significant if ``|t|`` exceeds 4.5 and the share of the variance 0.05, or ``|t|`` 3 and the share
        0.3.
        """
        significant = np.any([(np.abs(self.t) > t) & (self.share > share) for t, share in SIGN_LIMITS], axis=0)
        return np.where(significant, np.sign(self.size), 0.0)


class ThrustResponse(NamedTuple):
    """Effects of the thrusters on yaw rate and surge speed.

    Attributes
    ----------
    names
        Names of the thrusters.
    yaw, surge
        Effects on the yaw rate (positive: bow to starboard) and on the surge speed (positive: forward).
    moment
        Sign of the effect of the turning moment on the yaw rate: +1 as expected, -1 against it, 0 unknown.
    """

    names: tuple[str, ...]
    yaw: RegressionEffect
    surge: RegressionEffect
    moment: int


class ThrusterForces(NamedTuple):
    """Thrust of each thruster on a common grid of times.

    Attributes
    ----------
    names
        Names of the thrusters.
    t
        Times (n,) [s], at the middle of intervals of 0.1 s.
    edges
        Edges (n + 1,) [s] of the intervals around t.
    f
        Thrust (n, n_thrusters), positive forward, in any unit.
    side
        Side of each thruster (n_thrusters,): +1 to port, -1 to starboard, 0 in the middle.
    """

    names: tuple[str, ...]
    t: Array
    edges: Array
    f: Array
    side: Array


def check_motion(c: Channels, sides: Mapping[str, float], dead: Collection[str] = ()) -> Iterator[Finding]:
    """Yield findings on thrusters that are swapped, reversed or without effect.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    sides
        Position of each thruster to starboard [m].
    dead
        Thrusters that other checks have reported as dead. They get no further finding of their own.

    Yields
    ------
    Finding
        Faults. Without faults and without ``dead`` thrusters, ``thruster-sides-agree`` (ok) if the log shows the sides,
        else ``thruster-sides-unknown`` (unknown) with the reason. Nothing without thrust, without a sensor of motion,
        and if all thrusters are in the middle of the boat.
    """
    found = thrust_responses(c, sides)
    if found is None:
        yield from _sides_unknown(c, sides)
        return
    yaw, surge = found.yaw.sign * _side_signs(sides, found.names), found.surge.sign
    faults = [f for f in _thruster_faults(found, yaw, surge) if f.where not in dead]
    yield from faults
    if not faults and not dead and ((yaw > 0).any() or found.moment > 0):
        text = f"the boat turns with the {'thrust difference' if len(found.names) > 1 else 'thrust'}"
        yield Finding("ok", "thruster-sides-agree", "sides", " and ".join(found.names), text)
    elif not faults and not dead:
        yield from _sides_unknown(c, sides)


def _sides_unknown(c: Channels, sides: Mapping[str, float]) -> Iterator[Finding]:
    """Yield ``thruster-sides-unknown``: the log does not show whether the thrusters are on their sides, and why.

    There is no finding without thrust or without a sensor of motion, as on a bench, and if all thrusters are in the
    middle.
    """
    names = tuple(n for n in sides if _thrust_channel(c, n) is not None)
    if not names or not {"psi", "r", "u", "vx", "x"} & set(c) or not _side_signs(sides, names).any():
        return
    forces = thruster_forces(c, sides)
    if not {"psi", "r"} & set(c) and not {"x", "y"} <= set(c):
        why, advice = "the log has no heading, yaw rate or position", "log one of them"
    elif forces is None:
        why = f"thrust and motion are in the log together for less than {MIN_DURATION:g} s"
        advice = "check a longer log with turns"
    elif len(names) > 1 and np.ptp(forces.f @ forces.side) < LEAST_DIFFERENCE * np.ptp(forces.f):
        why, advice = "all thrusters have the same thrust throughout", "turn with more thrust on one side"
    else:
        difference = "thrust difference" if len(names) > 1 else "thrust"
        why, advice = f"the {difference} explains too little of the yaw rate", "check a log with turns to both sides"
        rate = best_turn_rate(c, forces.edges)
        if rate is not None and (inseparable := _inseparable_turns(forces, rate)):
            why = inseparable
            advice = "check a log with turns to both sides and straight parts, in which the thrust of each side changes"
    text = f"it is not known whether the thrusters are on the right sides: {why}"
    yield Finding(UNKNOWN, "thruster-sides-unknown", "sides", " and ".join(names), text, advice)


def _inseparable_turns(forces: ThrusterForces, rate: Array) -> str:
    """Return what was seen if the thrust difference explains the yaw rate (n,), but is not separable from the sum.

    Sum and difference of the thrusts then change in a fixed ratio, so that the sum may be the cause of the turns. The
    result is "" otherwise, and for a single thruster.
    """
    if len(forces.names) < 2:
        return ""
    moment, total = forces.f @ forces.side, forces.f.sum(axis=1)
    effect = _thrust_effect(rate, moment[:, None], [], YAW_LAGS)
    if not effect.sign[0] or (_independent_share(np.column_stack([moment, total])) > MIN_OWN_VARIATION).any():
        return ""
    known = rate[np.isfinite(rate)]
    sides = np.clip(known, 0.0, None).sum(), -np.clip(known, None, 0.0).sum()
    one_sided = max(sides) > ONE_SIDED * sum(sides)
    turned = f", all to {'starboard' if sides[0] > sides[1] else 'port'}" if one_sided else ""
    return (
        f"the boat turns {'with' if effect.sign[0] > 0 else 'against'} the thrust difference, which explains "
        f"{100.0 * effect.share[0]:.0f} % of the yaw rate{turned}; but the thrusts of both sides change in a fixed "
        "ratio, so that their sum explains the turns too"
    )


def _thruster_faults(found: ThrustResponse, yaw: Array, surge: Array) -> Iterator[Finding]:
    """Yield the faults of the thrusters: heading reversed, sides swapped, sign reversed, or no effect.

    A reversed heading or swapped sides are the only fault; otherwise each thruster has at most one. ``found``: effects
    of the thrusters on yaw rate and surge speed. ``yaw``, ``surge`` (n_thrusters,): sign of each effect, +1 as expected
    for the thruster's side, -1 against it, 0 unknown.
    """
    if found.moment > 0 and (surge < 0).any() and not (surge > 0).any() and not (yaw < 0).any():
        yield half_turn("the boat turns as expected, but moves opposite to its heading when the thrust is forward")
        return
    # A thruster that drives the boat forward as expected, but turns it the wrong way, is on the other side.
    ahead_too = found.surge.t > LEANING_T
    against = found.moment < 0 or bool(found.moment == 0 and ((yaw < 0) & ahead_too).any())
    if against and not (yaw > 0).any() and not (surge < 0).any():
        yield Finding(
            "fault",
            "thruster-sides-swapped",
            "sides",
            " and ".join(found.names),
            "left and right are swapped: the boat turns against its thrust difference",
            "exchange the plugs, the nodes in the rig file, or the columns in the import map (for a fit alone: --fix "
            "y_left=POSITIVE --fix y_right=NEGATIVE); or correct the signs of both thrusters, or of heading and yaw "
            "rate (clockwise)",
        )
        return
    most = np.minimum(_relative_upper_bounds(found.yaw), _relative_upper_bounds(found.surge))
    for k, name in enumerate(found.names):
        if surge[k] < 0 or (yaw[k] < 0 and not ahead_too[k]):
            yield Finding(
                "fault",
                "thruster-sign-reversed",
                "sign",
                name,
                "the thrust is in reverse when the command is forward",
                "correct `reversed` in the rig file, or `sign` of the signal in the import map of an imported log; or "
                "exchange two phases of the motor, or change the propeller",
            )
        elif most[k] < DEAD_RATIO and not (yaw[k] > 0 or surge[k] > 0 or found.surge.t[k] > SURGE_T):
            yield Finding(
                "fault",
                "thruster-without-effect",
                "dead",
                name,
                "the thruster has no effect on the boat: neither yaw rate nor surge speed responds to its command",
                "check whether the propeller is lost or fouled, and whether the shaft turns",
            )


def _relative_upper_bounds(effect: RegressionEffect) -> Array:
    """Return the upper bound (n_thrusters,) of the size of each effect, divided by the largest significant effect.

    The bound is two standard errors above the size. An effect is significant if its |t| exceeds 6.75. The result is 1
    for an effect that is not separable from others (t = 0), and for all effects if none is significant.
    """
    clear = np.abs(effect.t) > 1.5 * SIGNIFICANT_T
    if not clear.any():
        return np.ones(effect.size.size)
    size = np.abs(effect.size)
    bound = size + 2.0 * size / np.maximum(np.abs(effect.t), 1e-12)
    return np.where(effect.t != 0, bound / size[clear].max(), 1.0)


def thrust_responses(c: Channels, sides: Mapping[str, float]) -> ThrustResponse | None:
    """Regress yaw rate and surge speed on the thrust of each thruster.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    sides
        Position of each thruster to starboard [m].

    Returns
    -------
    ThrustResponse or None
        None if the log is shorter than 15 s, or has no thrust or no sensor of the yaw rate.
    """
    forces = thruster_forces(c, sides)
    if forces is None:
        return None
    rate = best_turn_rate(c, forces.edges)
    if rate is None:
        return None
    yaw = _thrust_effect(rate, forces.f, [], YAW_LAGS)
    return ThrustResponse(
        forces.names, yaw, _surge_effect(c, forces.t, forces.edges, forces.f), _moment_sign(forces, rate)
    )


def best_turn_rate(c: Channels, edges: Array) -> Array | None:
    """Return the yaw rate (n,) [rad/s] by the gyro, else the heading, else the course; None without these sensors.

    A sensor whose yaw rate is NaN in all intervals counts as missing.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    edges
        Edges of the intervals (n + 1,) [s].
    """
    rates = (turn_rate(c, edges, name) for name in ("gyro", "heading", "course"))
    return next((rate for rate in rates if rate is not None and np.isfinite(rate).any()), None)


def turning_signs(c: Channels, sides: Mapping[str, float]) -> dict[str, int]:
    """Return the sign with which the boat turns with the moment of its thrusters, by each sensor.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    sides
        Position of each thruster to starboard [m].

    Returns
    -------
    dict
        By ``gyro`` and ``heading``, without a heading also by the course of the ``position``: +1 as expected, -1 if the
        boat turns against the moment, 0 if it is not significant. A sensor that the log lacks is left out. Empty if the
        log has no thrust, or is shorter than 15 s.
    """
    forces = thruster_forces(c, sides)
    if forces is None:
        return {}
    names = {"gyro": "gyro"} | ({"heading": "heading"} if "psi" in c else {"position": "course"})
    rates = {name: turn_rate(c, forces.edges, by) for name, by in names.items()}
    return {name: _moment_sign(forces, rate) for name, rate in rates.items() if rate is not None}


def _moment_sign(forces: ThrusterForces, rate: Array) -> int:
    """Return the sign of the effect of the turning moment on a yaw rate (n,), beside the sum of thrusts.

    The sum is left out if it varies much less than the moment, as in spins on the spot (`SPIN_RATIO`). The result is +1
    if the boat turns with the moment, -1 if it turns against the moment. It is 0 if the effect is not significant, or
    if all thrusters are in the middle.
    """
    if not forces.side.any():
        return 0
    moment, total = forces.f @ forces.side, forces.f.sum(axis=1)
    beside = [] if np.std(moment) > SPIN_RATIO * np.std(total) else [total]
    return int(_thrust_effect(rate, np.column_stack([moment, *beside]), [], YAW_LAGS).sign[0])


def turn_rate(c: Channels, edges: Array, name: str) -> Array | None:
    """Return the yaw rate in each interval by one sensor.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    edges
        Edges of the intervals (n + 1,) [s].
    name
        ``gyro``, ``heading`` or ``course`` (over ground, by positions).

    Returns
    -------
    Array (n,) or None
        Yaw rate [rad/s], positive to starboard; NaN while the boat is slower than 0.3 m/s for a course. Intervals
        without a sample of the gyro are interpolated. None without this sensor.
    """
    t = (edges[1:] + edges[:-1]) / 2
    if name == "gyro":
        return fill_gaps(t, block_mean(c["r"], edges)) if "r" in c else None
    if name == "heading":
        return _central_rate(c["psi"].t, np.unwrap(c["psi"].value), t) if "psi" in c else None
    if not {"x", "y"} <= set(c):
        return None
    vx, vy = (_central_rate(c[n].t, c[n].value, t, COURSE_HALF) for n in ("x", "y"))
    ax, ay = (_central_rate(t, v, t, COURSE_HALF) for v in (vx, vy))
    speed = np.hypot(vx, vy)
    return np.where(speed > SLOWEST, (vx * ay - vy * ax) / np.maximum(speed, SLOWEST) ** 2, np.nan)


def _central_rate(t: Array, value: Array, at: Array, half: float = 0.5) -> Array:
    """Return the rate of change (n,) of a signal (k,) with times t (k,), at times ``at`` (n,) [s].

    The difference is taken from ``half`` [s] before to ``half`` after, or over two samples if that is more. The signal
    is continued with its end values.
    """
    half = max(half, float(np.median(np.diff(t))))
    return np.asarray((np.interp(at + half, t, value) - np.interp(at - half, t, value)) / (2.0 * half))


def thruster_forces(c: Channels, sides: Mapping[str, float]) -> ThrusterForces | None:
    """Return the thrust of each thruster on a common grid of times.

    Parameters
    ----------
    c
        Channels (signals) of a log by name. Thrust is a measured force, else ``n|n|`` of the shaft speed, else of the
        command.
    sides
        Position of each thruster to starboard [m].

    Returns
    -------
    ThrusterForces or None
        None if thrusts and motion overlap for less than 15 s, or if the log has no thrust or no sensor of heading, yaw
        rate or position. Thrusters without a thrust are left out. The thrust is interpolated linearly at t.
    """
    found = {n: s for n in sides if (s := _thrust_channel(c, n)) is not None}
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
    return ThrusterForces(tuple(found), t, edges, f, _side_signs(sides, tuple(found)))


def _thrust_channel(c: Channels, name: str) -> Channel | None:
    """Return the thrust of the thruster ``name``: measured force, else ``n|n|`` of shaft speed or command.

    The command also replaces telemetry that ended more than 3 s before the commands. The result is None without any of
    these signals.
    """
    if thrust_of(name) in c:
        return c[thrust_of(name)]
    shaft, command = c.get(shaft_speed_of(name)), c.get(command_of(name))
    if shaft is None or (command is not None and shaft.t[-1] < command.t[-1] - 3.0):
        shaft = command  # there is no telemetry, or it ended before the commands
    if shaft is None:
        return None
    return Channel(shaft.t, shaft.value * np.abs(shaft.value))


def _side_signs(sides: Mapping[str, float], names: Sequence[str]) -> Array:
    """Return the side (n_thrusters,) of each named thruster: +1 left, -1 right, 0 within 2 cm of the middle.

    Forward thrust on the left turns the bow to starboard. ``sides``: positions to starboard [m].
    """
    return np.array([-np.sign(sides[n]) if abs(sides[n]) > 0.02 else 0.0 for n in names])


def _surge_effect(c: Channels, t: Array, edges: Array, f: Array) -> RegressionEffect:
    """Return the effects of the thrusts f (n, n_thrusters) on the surge speed over ground at times t (n,) [s].

    If no t statistic exceeds 9, and the effects on the acceleration ``ax`` are more significant, return those instead.
    ``edges`` (n + 1,) [s]: intervals around t. All effects are 0 without either sensor.
    """
    found = RegressionEffect(*np.zeros((3, f.shape[1])))
    drift = []
    if "psi" in c:  # a current adds to the speed over ground on one heading and subtracts on the opposite one
        psi = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value))
        drift = [np.cos(psi), np.sin(psi)]
    if (u := surge_speed(c, t)) is not None:
        found = _thrust_effect(u, f, drift, SURGE_LAGS)
    if "ax" in c and np.abs(found.t).max() < 2 * SIGNIFICANT_T:
        ax = fill_gaps(t, block_mean(c["ax"], edges))
        by_acceleration = _thrust_effect(ax, f, [], SURGE_LAGS, washed=True)
        if np.abs(by_acceleration.t).sum() > np.abs(found.t).sum():
            return by_acceleration
    return found


def _thrust_effect(
    y: Array, f: Array, others: Sequence[Array], lags: Sequence[float], *, washed: bool = False
) -> RegressionEffect:
    """Regress a motion on thrusts behind the first-order lag that fits best.

    Parameters
    ----------
    y
        Motion (n,). Rows in which it is NaN are left out.
    f
        Thrusts (n, n_thrusters), or moment and sum of the thrusts.
    others
        Further regressors (n,), without a lag.
    lags
        Time constants of the search [s].
    washed
        Whether the regressors are the differences of f and its lagged columns (high-pass), as for an acceleration.

    Returns
    -------
    RegressionEffect
        All zeros if no thrust is separable, y is constant, or less than 15 s of y are left.

    Notes
    -----
    Neighbouring samples are correlated. The variance therefore counts one sample in two time constants, and is at least
    that of the scores summed over blocks of time (the idea of Newey and West, with blocks).
    """
    valid = np.isfinite(y)
    y, free = y[valid], _independent_share(f[valid])
    columns = np.flatnonzero(free > MIN_OWN_VARIATION)
    size, t, share = np.zeros((3, f.shape[1]))
    if not columns.size or y.size < MIN_DURATION * RATE or np.ptp(y) == 0.0:
        return RegressionEffect(size, t, share)
    best = np.inf
    for lag in lags:
        past = first_order_lag(f, lag, 1.0 / RATE)
        X = np.column_stack([f - past if washed else past, *others, np.ones(valid.size)])[valid]
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
    """Return the variances (k,) of the factors of X (n, k), from the scores of the residuals e (n,) summed over blocks.

    A block lasts at least 5 s and four time constants ``lag`` [s]. In a short record the blocks are shorter, so that
    there are at least 6. ``inverse`` (k, k): inverse of X'X / n.
    """
    rows = round(max(BLOCK_S, 4.0 * lag) * RATE)
    count = e.size // rows
    if count < FEWEST_BLOCKS:
        rows, count = max(e.size // FEWEST_BLOCKS, 1), FEWEST_BLOCKS
    sums = np.add.reduceat(X * e[:, None], np.arange(count) * rows) @ inverse / e.size
    return np.asarray((sums**2).sum(axis=0) * count / max(count - X.shape[1], 1.0))


def _independent_share(f: Array) -> Array:
    """Return the share (k,) of the standard deviation of each column of f (n, k) that the other columns cannot explain.

    The share is 1 for a column that is independent of the others and for a single column, and 0 for a constant column.
    """
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
    """Return the expected response of a motion to a thrust through the first-order lag that fits best.

    Parameters
    ----------
    y
        Measured motion (n,), without NaN.
    push
        Thrust or moment (n,) on the grid of `thruster_forces`, without NaN.
    lags
        Time constants of the search [s].

    Returns
    -------
    Array (n,)
        Response with the mean of y and the expected, positive sign. For swapped sides it is the mirror image of y.
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


def surge_speed(c: Channels, t: Array) -> Array | None:
    """Return the surge speed over ground (n,) [m/s] at times t (n,) [s]; None if no sensor measures it.

    It is ``u``, else the velocity or the change of position along the heading.

    Parameters
    ----------
    c
        Channels (signals) of a log by name.
    t
        Times (n,) [s].
    """
    if "u" in c:
        return np.interp(t, c["u"].t, c["u"].value)
    if "psi" not in c or not ({"vx", "vy"} <= set(c) or {"x", "y"} <= set(c)):
        return None
    psi = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value))
    if "vx" in c and "vy" in c:
        vx, vy = (np.interp(t, c[n].t, c[n].value) for n in ("vx", "vy"))
    else:
        vx, vy = (_central_rate(c[n].t, c[n].value, t) for n in ("x", "y"))
    return np.asarray(ned_to_body(psi, vx, vy)[0])


def fill_gaps(t: Array, values: Array) -> Array:
    """Return values (n,) at times t (n,) [s] with each NaN interpolated between its neighbours.

    The first and last finite values are continued to the ends. At least one value must be finite. Infinite values are
    interpolated too.
    """
    good = np.isfinite(values)
    return np.interp(t, t[good], values[good])
