"""Static thrust curve: steady force against command, from benches that measure force and know only the command.

Levels are means over steady commands, with standard errors that allow for autocorrelated readings. Where the thruster
saturates, is asymmetric or has a dead band, the quadratic ``c1 n|n| + c2 n^2`` (thesis section 4.2) does not hold; a
monotone curve through the measured levels does: isotonic regression (pool adjacent violators, Barlow et al. 1972) and
between the levels the monotone cubic of Fritsch and Carlson (1980). Which of them predicts better is judged by levels
that were left out. The curve's file is described in docs/formats/curve.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from scipy import interpolate, optimize, stats

from daq.config import parse_toml, read_text
from daq.errors import SeatrialError
from ident.data import Channel, sample_and_hold
from ident.numerics import Array, block_error, integrated_autocorrelation_time, steady_segments

LEVEL_TOLERANCE = 1e-3  # of full command: closer commands are one level
MIN_SAMPLES = 20  # of the force at one level
FORMAT = "seatrial-curve 1"


@dataclass(frozen=True)
class Levels:
    """Steady force at each command: n, force [N], se [N] (n_levels,), n_samples (n_levels,), and autocorrelation
    time [samples] of the readings (1: independent)."""

    n: Array
    force: Array
    se: Array
    n_samples: Array
    memory: Array


def find_levels(command: Channel, force: Channel, settle: float = 1.5) -> Levels:
    """Means of the force while the command is constant, without the first ``settle`` seconds after each change.

    A command given more than once is one level, whose error is at least the scatter between its visits.
    """
    visits: list[tuple[float, float, float, int, float]] = []
    for steady in steady_segments(command.t, command.value, np.inf):
        held = force.value[(force.t >= steady.start + settle) & (force.t < steady.end)]
        held = held[np.isfinite(held)]
        if held.size >= MIN_SAMPLES:
            memory = integrated_autocorrelation_time([held], "positive")
            error = max(float(held.std(ddof=1)) * np.sqrt(memory / held.size), block_error(held))
            visits.append((steady.level, float(held.mean()), float(error), held.size, memory))
    if not visits:
        raise ValueError(f"the command is nowhere held for {settle:g} s and {MIN_SAMPLES} readings of the force")
    return _merged(sorted(visits))


def _merged(visits: Sequence[tuple[float, float, float, int, float]]) -> Levels:
    table = np.array(visits)
    group = np.append(0, np.cumsum(np.diff(table[:, 0]) > LEVEL_TOLERANCE)).astype(int)
    rows = []
    for k in range(group[-1] + 1):
        n, force, se, count, memory = table[group == k].T
        se = np.maximum(se, 1e-9)
        weight = se**-2 / np.sum(se**-2)
        error = float(np.sum(se**-2)) ** -0.5
        if n.size > 1:
            error = max(error, float(force.std(ddof=1)) / np.sqrt(n.size))
        rows.append((n.mean(), weight @ force, error, count.sum(), memory.max()))
    return Levels(*np.array(rows).T)


@dataclass(frozen=True)
class Curve:
    """A monotone curve: force [N] at the knots n, with standard errors; constant beyond the ends."""

    n: Array
    force: Array
    se: Array

    def __call__(self, n: Array) -> Array:
        return np.asarray(interpolate.PchipInterpolator(self.n, self.force)(np.clip(n, self.n[0], self.n[-1])))

    def slope(self, n: Array) -> Array:
        """d force / d n [N]; zero beyond the ends."""
        inside = (n > self.n[0]) & (n < self.n[-1])
        return np.where(inside, interpolate.PchipInterpolator(self.n, self.force).derivative()(n), 0.0)

    def error(self, n: Array) -> Array:
        """Standard error, linear between the knots."""
        return np.interp(n, self.n, self.se)


def fit_curve(levels: Levels) -> Curve:
    """Isotonic regression on the levels. A pooled knot's error covers what pooling moved it by."""
    force = optimize.isotonic_regression(levels.force, weights=levels.se**-2).x
    return Curve(levels.n, np.asarray(force), np.hypot(levels.se, force - levels.force))


def curve_left_out(levels: Levels) -> float:
    """Root mean square [N] over inner levels of what the curve through all others misses them by."""
    return _left_out(levels, lambda n, f, at: np.asarray(_through(n, f)(at)))


@dataclass(frozen=True)
class Quadratic:
    """``c1 n|n| + c2 n^2``: values, errors and covariance scaled by the misfit; rms and largest misfit [N]; chi2 with
    df degrees of freedom against the levels' own errors; rms of levels that were left out [N]."""

    c1: float
    c2: float
    covariance: Array
    rms: float
    largest: float
    at: float  # command of the largest misfit
    chi2: float
    df: int
    left_out: float

    def __call__(self, n: Array) -> Array:
        return np.asarray(self.c1 * n * np.abs(n) + self.c2 * n * n)


def fit_quadratic(levels: Levels) -> Quadratic:
    """Least squares with equal weights: the misfit is far above the readings' errors wherever it matters."""
    theta = _quadratic(levels.n, levels.force)
    B = _basis(levels.n)
    misfit = levels.force - B @ theta
    df = max(levels.n.size - 2, 1)
    worst = int(np.argmax(np.abs(misfit)))
    weights = levels.se**-2
    best = np.linalg.lstsq(B * np.sqrt(weights)[:, None], levels.force * np.sqrt(weights), rcond=None)[0]
    return Quadratic(
        float(theta[0]),
        float(theta[1]),
        np.linalg.inv(B.T @ B) * float(misfit @ misfit) / df,
        float(np.sqrt(np.mean(misfit**2))),
        float(misfit[worst]),
        float(levels.n[worst]),
        float(np.sum(weights * (levels.force - B @ best) ** 2)),
        df,
        _left_out(levels, lambda n, f, at: _basis(at) @ _quadratic(n, f)),
    )


def adequate(quadratic: Quadratic) -> bool:
    """Whether the quadratic fits within the levels' errors (chi-square, 1 %)."""
    return bool(stats.chi2.sf(quadratic.chi2, quadratic.df) > 0.01)


def _left_out(levels: Levels, predict: Callable[[Array, Array, Array], Array]) -> float:
    missed = []
    for k in range(1, levels.n.size - 1):
        keep = np.arange(levels.n.size) != k
        at = predict(levels.n[keep], levels.force[keep], levels.n[k : k + 1])
        missed.append(levels.force[k] - float(np.squeeze(at)))
    return float(np.sqrt(np.mean(np.square(missed)))) if missed else float("nan")


def _through(n: Array, force: Array) -> interpolate.PchipInterpolator:
    return interpolate.PchipInterpolator(n, optimize.isotonic_regression(force).x)


def _basis(n: Array) -> Array:
    return np.column_stack([n * np.abs(n), n * n])


def _quadratic(n: Array, force: Array) -> Array:
    return np.asarray(np.linalg.lstsq(_basis(n), force, rcond=None)[0])


@dataclass(frozen=True)
class ThrustCurve:
    """Force [N] against command, of ``thrusters`` thrusters together at one command; ``calibration``: relative standard
    uncertainty of the load cell's force, None where nobody gave it."""

    curve: Curve
    thrusters: int
    calibration: float | None = None

    def of_one(self, n: Array) -> Array:
        """Force of one thruster [N] at commands n (n_samples,)."""
        return np.asarray(self.curve(n) / self.thrusters)


def thrust_channels(channels: Mapping[str, Channel], curve: ThrustCurve) -> dict[str, Channel]:
    """``f_left``, ``f_right`` and their sum ``X`` [N] from the commands of a log; a command holds until the next.

    ``X_n`` [N] is what X gains for commands further from zero by one: ``X - d X_n`` is the thrust with a dead band
    wider by d, to first order. Commands are ``n_cmd_left``, or ``n_left`` where a log has no other. Raises
    ValueError where there are none.
    """
    found: dict[str, Channel] = {}
    slopes: list[Channel] = []
    for side in ("left", "right"):
        name = next((n for n in (f"n_cmd_{side}", f"n_{side}") if n in channels), None)
        if name is None:
            raise ValueError(f"no command for the thrust curve: there is no n_cmd_{side} and no n_{side}")
        command = channels[name]
        found[f"f_{side}"] = Channel(command.t, curve.of_one(command.value), "N", command.source)
        outward = np.sign(command.value) * curve.curve.slope(command.value) / curve.thrusters
        slopes.append(Channel(command.t, outward, "N", command.source))
    return found | {"X": total(found["f_left"], found["f_right"]), "X_n": total(*slopes)}


def total(left: Channel, right: Channel) -> Channel:
    """Sum of two held signals, on the times of both."""
    t = np.union1d(left.t, right.t)
    return Channel(t, sample_and_hold(left, t) + sample_and_hold(right, t), left.unit, left.source)


def save_curve(
    path: Path, curve: ThrustCurve, levels: Levels, quadratic: Quadratic, provenance: Mapping[str, Any]
) -> None:
    """Write a curve, the levels it goes through, and the quadratic it was compared with."""
    document = tomlkit.document()
    document["format"] = FORMAT
    document["thrusters"] = curve.thrusters
    if curve.calibration is not None:
        document["calibration"] = float(f"{curve.calibration:.4g}")
    document["provenance"] = dict(provenance)
    document["curve"] = {
        "n": _rounded(curve.curve.n),
        "force": _rounded(curve.curve.force),
        "se": _rounded(curve.curve.se),
        "between": "monotone cubic (Fritsch and Carlson); constant beyond the ends",
    }
    document["measured"] = {
        "n": _rounded(levels.n),
        "force": _rounded(levels.force),
        "se": _rounded(levels.se),
        "n_samples": [int(k) for k in levels.n_samples],
        "memory": _rounded(levels.memory),
    }
    document["quadratic"] = {
        "c1": float(f"{quadratic.c1:.7g}"),
        "c2": float(f"{quadratic.c2:.7g}"),
        "rms": float(f"{quadratic.rms:.4g}"),
        "largest": float(f"{quadratic.largest:.4g}"),
        "adequate": adequate(quadratic),
    }
    path.write_text(tomlkit.dumps(document), encoding="utf-8")


def _rounded(values: Sequence[float] | Array) -> list[float]:
    return [float(f"{v:.7g}") for v in values]


def load_curve(path: Path) -> ThrustCurve | None:
    """Read a curve; None where the file says it is something else. Raises SeatrialError for a broken curve."""
    try:
        table = parse_toml(read_text(path), path).values
    except SeatrialError:
        return None  # whoever reads it as something else says what is wrong
    if table.get("format") != FORMAT:
        return None
    try:
        n, force, se = (np.array(table["curve"][k], dtype=float) for k in ("n", "force", "se"))
        thrusters, given = int(table["thrusters"]), table.get("calibration")
        calibration = None if given is None else float(given)
    except (KeyError, TypeError, ValueError) as problem:
        raise SeatrialError(f"{path}: not a complete curve: {problem}") from problem
    if not (n.size == force.size == se.size >= 2 and thrusters >= 1 and np.all(np.diff(n) > 0)):
        raise SeatrialError(f"{path}: a curve needs two or more rising n, with as many force and se")
    if not all(np.isfinite(a).all() for a in (n, force, se)):
        raise SeatrialError(f"{path}: a curve has numbers only")
    if calibration is not None and not 0.0 < calibration < 1.0:
        raise SeatrialError(f"{path}: calibration is a relative standard uncertainty, more than 0 and less than 1")
    return ThrustCurve(Curve(n, force, se), thrusters, calibration)
