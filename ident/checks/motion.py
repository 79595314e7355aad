"""Signs and sides of thrusters from the boat's motion, before any fit: regressions, no model but first-order lags.

- `motion`, for a log: yaw rate and forward speed are regressed on each thruster's thrust behind a first-order lag,
  whose time constant is searched. A boat that an autopilot steers oscillates: a free delay would let a thrust explain
  the turn before it. Found are thrusters that are swapped, reversed or dead.
- `check_sides`, for the runs of a fit: the correlation of yaw rate with the thrust difference behind a lag of a given
  time constant. Only where all runs that are significant agree are the sides taken for swapped (`swap_sides`).
"""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy import stats

from daq.checks import Finding
from ident.checks.sensors import Channels
from ident.data import Channel, block_mean
from ident.model import Model
from ident.numerics import Array, first_order_lag

RATE = 10.0  # Hz, of the regressions
YAW_LAGS, SURGE_LAGS = (0.3, 0.6, 1.0, 1.7, 3.0), (1.0, 2.0, 4.0, 8.0)  # s, time constants that are tried
MIN_DURATION = 15.0  # s, of a log
MIN_SAMPLES = 50  # of a run, for a correlation
SIGNIFICANT_T = 4.5  # t statistic from which an effect has a sign
DEAD_RATIO = 0.4  # of the strongest thruster's effect: one that is surely less, and has no sign, is none
MIN_OWN_VARIATION = 0.1  # share of a thruster's variation that the others lack, from which it has an effect of its own
SIGNIFICANT_P = 1e-3  # of the correlation of one run


class RegressionEffect(NamedTuple):
    """Effect of each thruster's push on one motion and its t statistics; t is 0 where it cannot be told apart."""

    size: Array
    t: Array


class PushResponse(NamedTuple):
    """Effects on yaw rate and on speed ahead, and the t statistic of the turning moment as a whole on yaw."""

    names: tuple[str, ...]
    yaw: RegressionEffect
    surge: RegressionEffect
    moment_t: float


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
    side = _side(sides, found.names)
    yaw = np.where(np.abs(found.yaw.t) > SIGNIFICANT_T, np.sign(found.yaw.size) * side, 0.0)
    surge = np.where(np.abs(found.surge.t) > SIGNIFICANT_T, np.sign(found.surge.size), 0.0)
    faults = [f for f in _verdict(found, yaw, surge) if f.where not in dead]
    yield from faults
    if not faults and not dead and ((yaw > 0).any() or found.moment_t > SIGNIFICANT_T):
        yield Finding("ok", "thruster-sides-agree", "sides", " and ".join(found.names), "the boat turns as they push")


def _verdict(found: PushResponse, yaw: Array, surge: Array) -> Iterator[Finding]:
    # One that pushes ahead as it should and turns the boat the wrong way is on the other side.
    against = (yaw < 0).any() if (yaw != 0).any() else found.moment_t < -SIGNIFICANT_T
    if against and not (yaw > 0).any() and not (surge < 0).any():
        yield Finding(
            "fault",
            "thruster-sides-swapped",
            "sides",
            " and ".join(found.names),
            "left and right are swapped: the boat turns against its thrust difference",
            "exchange the nodes in the rig or the plugs; else the sign of one thruster or of the yaw rate",
        )
        return
    most = np.minimum(_most(found.yaw), _most(found.surge))
    for k, name in enumerate(found.names):
        if surge[k] < 0 or (yaw[k] < 0 and not surge[k] > 0):
            yield Finding(
                "fault",
                "thruster-sign-reversed",
                "sign",
                name,
                "it pushes astern when it is told ahead",
                "`reversed` of the rig, two of the motor's phases, or a propeller of the other hand",
            )
        elif most[k] < DEAD_RATIO and not (yaw[k] > 0 or surge[k] > 0):
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
    """Regressions of yaw rate and speed ahead on each thruster's push; None as for `forces`."""
    given = thruster_forces(c, sides)
    if given is None:
        return None
    names, t, edges, f, side = given
    r = fill_gaps(t, block_mean(c["r"], edges)[0])
    moment = _effect(r, (f @ side)[:, None], [], YAW_LAGS).t[0] if side.any() else 0.0
    return PushResponse(names, _effect(r, f, [], YAW_LAGS), _surge(c, t, edges, f), float(moment))


def thruster_forces(c: Channels, sides: Mapping[str, float]) -> ThrusterForces | None:
    """The thrusters' pushes on common times; None without push or yaw rate, or where the log is too short."""
    found = {n: s for n in sides if (s := _push(c, n)) is not None}
    if not found or "r" not in c:
        return None
    used = [*found.values(), c["r"]]
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
    found = RegressionEffect(np.zeros(f.shape[1]), np.zeros(f.shape[1]))
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
    """Factors of the lagged columns of f in y (with ``washed`` of what the lag leaves over), at the lag that fits best.

    Neighbouring samples are not independent: one in two time constants counts.
    """
    free = _own_part(f)
    columns = np.flatnonzero(free > MIN_OWN_VARIATION)
    size, t = np.zeros(f.shape[1]), np.zeros(f.shape[1])
    if not columns.size:
        return RegressionEffect(size, t)
    best = np.inf
    for lag in lags:
        past = first_order_lag(f, lag, 1.0 / RATE)
        X = np.column_stack([f - past if washed else past, *others, np.ones(y.size)])
        beta, *_ = np.linalg.lstsq(X, y, rcond=None)
        e = y - X @ beta
        error = float(e @ e) / y.size
        if error < best:
            best, count = error, max(y.size / RATE / (2.0 * lag) - X.shape[1], 1.0)
            spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(X.T @ X / y.size)) * error / count, 1e-300))
            size[columns] = beta[columns]
            t[columns] = beta[columns] / spread[columns]
    return RegressionEffect(size, t)


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
    if {"vx", "vy", "psi"} <= set(c):
        psi = np.interp(t, c["psi"].t, np.unwrap(c["psi"].value))
        vx, vy = (np.interp(t, c[n].t, c[n].value) for n in ("vx", "vy"))
        return np.asarray(np.cos(psi) * vx + np.sin(psi) * vy)
    return None


def fill_gaps(t: Array, values: Array) -> Array:
    """Values (n,) at t (n,) with NaN filled in between the others."""
    good = np.isfinite(values)
    return np.interp(t, t[good], values[good])


@dataclass(frozen=True)
class ThrusterSideCheck:
    """Correlation of yaw rate with the thrust difference passed through a first-order lag, one a run, and verdict."""

    runs: tuple[str, ...]
    correlation: tuple[float, ...]
    significant: tuple[bool, ...]

    @property
    def swapped(self) -> bool:
        """Every run that says anything says that the boat turns against its thrust."""
        votes = [c for c, s in zip(self.correlation, self.significant, strict=True) if s]
        return bool(votes) and all(c < 0 for c in votes)

    @property
    def line(self) -> str:
        against = sum(c < 0 and s for c, s in zip(self.correlation, self.significant, strict=True))
        return (
            f"The boat turns against its thrust difference in {against} of {len(self.runs)} runs: left and right "
            "are swapped in the data, or the sign of one of them or of yaw is wrong. Fitted with the sides swapped."
        )


def check_sides(
    runs: Sequence[tuple[str, Mapping[str, Channel]]], time_constant: float = 1.0
) -> ThrusterSideCheck | None:
    """None where the runs have no yaw rate or no pair of thrusters."""
    found = [(name, c) for name, channels in runs if (c := _correlation(channels, time_constant)) is not None]
    if not found:
        return None
    names, values = zip(*found, strict=True)
    return ThrusterSideCheck(names, tuple(r for r, _ in values), tuple(p < SIGNIFICANT_P for _, p in values))


def _correlation(channels: Mapping[str, Channel], time_constant: float) -> tuple[float, float] | None:
    pair = next((p for p in (("f_left", "f_right"), ("n_left", "n_right")) if all(n in channels for n in p)), None)
    if pair is None or "r" not in channels:
        return None
    left, right, r = channels[pair[0]], channels[pair[1]], channels["r"]
    t = np.arange(max(c.t[0] for c in (left, right, r)), min(c.t[-1] for c in (left, right, r)), 1 / RATE)
    push = [np.interp(t, c.t, c.value) for c in (left, right)]
    if pair[0] == "n_left":
        push = [p * np.abs(p) for p in push]
    difference = push[0] - push[1]
    if t.size < MIN_SAMPLES or difference.std() < 1e-9:
        return None
    lagged = first_order_lag(difference, time_constant, 1 / RATE)
    rate = np.interp(t, r.t, r.value)
    x, y = lagged - lagged.mean(), rate - rate.mean()
    correlation = float(x @ y / np.sqrt((x @ x) * (y @ y) + 1e-300))
    # neighbouring samples are not independent: count one every two time constants
    n = max(4.0, t.size / RATE / (2 * time_constant))
    z = abs(np.arctanh(np.clip(correlation, -0.999999, 0.999999))) * np.sqrt(n - 3)
    return correlation, float(2 * stats.norm.sf(z))


def swap_sides(model: Model) -> Model:
    """The model with its thrusters on each other's side."""
    if "side" in model.values:
        return model.with_values({"side": -model.values["side"]})
    arms = {n: model.parameter(n) for n in ("y_left", "y_right")}
    return model.replace_parameters(
        replace(arms["y_left"], value=arms["y_right"].value), replace(arms["y_right"], value=arms["y_left"].value)
    )
