"""Static thrust curve: steady force against command, from benches that measure force and know only the command.

Levels are means over steady commands, with standard errors that allow for autocorrelated readings and for the scatter
between visits to one level. The level at rest is the zero of the load cell and is taken off all others. Where the
thruster saturates, is asymmetric or has a dead band, the quadratic ``c1 n|n| + c2 n^2`` (thesis section 4.2) does not
hold; a monotone curve through the measured levels does: isotonic regression (pool adjacent violators, Barlow et al.
1972) and between the levels the monotone cubic of Fritsch and Carlson (1980). Which of them predicts better is judged
by levels that were left out. The curve's file is described in docs/formats/curve.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray
from scipy import interpolate, optimize, stats

from seatrial.daq.config import parse_toml, read_text
from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import write_output
from seatrial.ident.data import Channel, sample_and_hold
from seatrial.ident.numerics import Array, mean_error, steady_segments

LEVEL_TOLERANCE = 1e-3  # of full command: closer commands are one level
MIN_SAMPLES = 20  # of the force at one level
REVERSED = -0.5  # correlation of the force with n|n|: noise is above it, a load cell with the wrong sign near -1
BEYOND_ERROR = 5.0  # standard errors between the least and the largest of some levels: by chance hardly ever
FALLS = (
    "the force falls as the command rises: the load cell is reversed; turn the sign of newton_per_count in the rig, or "
    "of the force's scale in the import map, and make the log again"
)
AT_REST = 1e12  # weight of the level at rest in the curve, over that of the best level: no command, no thrust
ADEQUATE = 0.01  # p value from which the quadratic is not rejected
FORMAT = "seatrial-curve 1"


@dataclass(frozen=True)
class Levels:
    """Steady force at each command: n, force [N], se [N] (n_levels,), n_samples (n_levels,), and autocorrelation
    time [samples] of the readings (1: independent).

    ``se`` are independent of each other. ``offset`` [N]: what the load cell read at rest, with its error
    ``offset_se``, and what has been taken off all forces; None: there was no level at rest. ``scatter`` [N]: standard
    deviation between visits to one level beyond their errors, in ``se``, estimated with ``dof`` degrees of freedom; 0
    of them: no level was visited twice.
    """

    n: Array
    force: Array
    se: Array
    n_samples: Array
    memory: Array
    offset: float | None = None
    offset_se: float = 0.0
    scatter: float = 0.0
    dof: int = 0

    @property
    def at_rest(self) -> NDArray[np.bool_]:
        """The level that the load cell's zero was taken from (n_levels,)."""
        return np.asarray((self.n == 0.0) & (self.offset is not None))

    @property
    def error(self) -> Array:
        """Standard errors [N] (n_levels,) with that of the load cell's zero, which all levels share."""
        return np.hypot(self.se, np.where(self.at_rest, 0.0, self.offset_se))


def find_levels(command: Channel, force: Channel, settle: float = 1.5) -> Levels:
    """Means of the force while the command is constant, without the first ``settle`` seconds after each change.

    A command given more than once is one level. The variance between visits is one for all levels, since two or three
    visits to one alone hardly tell it. Raises ValueError where no command lasts.
    """
    visits: list[tuple[float, float, float, int, float]] = []
    for steady in steady_segments(command.t, command.value, np.inf):
        held = force.value[(force.t >= steady.start + settle) & (force.t < steady.end)]
        held = held[np.isfinite(held)]
        if held.size >= MIN_SAMPLES:
            error, memory = mean_error(held)
            visits.append((steady.level, float(held.mean()), error, held.size, memory))
    if not visits:
        lacks = f"the command is nowhere held for {settle:g} s and {MIN_SAMPLES} readings of the force"
        raise ValueError(f"{lacks}; {hold_advice(command, force, settle)}")
    return _zeroed(_merged(sorted(visits)))


def hold_advice(command: Channel, force: Channel, settle: float) -> str:
    """How long the command is held (the hold of the middle second), what ``settle`` [s] leaves of it, what to do."""
    end = float(max(command.t[-1], force.t[-1]))
    holds = np.sort([s.duration for s in steady_segments(command.t, command.value, end)])
    hold = float(holds[np.searchsorted(np.cumsum(holds), 0.5 * holds.sum())])
    rate = force.t.size / float(np.ptp(force.t))
    left = max(hold - settle, 0.0)
    said = (
        f"it is held for {hold:.2g} s, of which --settle {settle:g} s leaves {left:.2g} s, {left * rate:.0f} readings"
    )
    # half of the hold for what settles, where the other half has enough readings
    tried = np.floor(10.0 * min(hold / 2.0, hold - MIN_SAMPLES / rate)) / 10.0
    if 0.0 < tried < settle:
        return f"{said}: try --settle {tried:g}"
    return f"{said}: hold each level for more than {settle + MIN_SAMPLES / rate:.2g} s (seatrial bench steps --hold)"


def falls(n: Array, force: Array, error: float = 0.0) -> bool:
    """Whether a force (n_samples,) falls as n (n_samples,) rises, clearly and by more than chance with a standard
    ``error`` [N]."""
    drive = n * np.abs(n)
    if not (np.ptp(drive) > 0.0 and np.ptp(force) > BEYOND_ERROR * error):
        return False
    return bool(np.corrcoef(drive, force)[0, 1] < REVERSED)


def _merged(visits: Sequence[tuple[float, float, float, int, float]]) -> Levels:
    """One level of the visits to a command. The variance between visits is one for all levels but that at rest, where
    no thrust scatters."""
    n, force, se, count, memory = np.array(visits).T
    se = np.maximum(se, 1e-9)
    group = np.append(0, np.cumsum(np.diff(n) > LEVEL_TOLERANCE)).astype(int)
    rest = np.abs(n) < LEVEL_TOLERANCE
    at_rest, _ = _between_visits(force[rest], se[rest], group[rest])
    moving, dof = _between_visits(force[~rest], se[~rest], group[~rest])
    weight = 1.0 / (se**2 + np.where(rest, at_rest, moving))
    size, total = np.bincount(group), np.bincount(group, weight)
    return Levels(
        np.bincount(group, n) / size,
        np.bincount(group, weight * force) / total,
        1.0 / np.sqrt(total),
        np.bincount(group, count).astype(float),
        np.maximum.reduceat(memory, np.cumsum(size) - size),
        scatter=float(np.sqrt(moving)),
        dof=dof,
    )


def _between_visits(force: Array, se: Array, level: NDArray[np.int_]) -> tuple[float, int]:
    """Variance [N^2] between visits (n_visits,) to one level beyond their own errors, pooled over the levels (method of
    moments), and its degrees of freedom."""
    _, group, size = np.unique(level, return_inverse=True, return_counts=True)
    dof = level.size - size.size
    apart = force - (np.bincount(group, force) / size)[group]
    own = float(se**2 @ (1.0 - 1.0 / size[group]))
    return max(float(apart @ apart) - own, 0.0) / max(dof, 1), dof


def _zeroed(levels: Levels) -> Levels:
    """With the force at rest taken off, where the command was at zero."""
    rest = np.abs(levels.n) < LEVEL_TOLERANCE
    if not rest.any():
        return levels
    k = int(np.argmax(rest))
    offset, n = float(levels.force[k]), np.where(rest, 0.0, levels.n)
    return replace(levels, n=n, force=levels.force - offset, offset=offset, offset_se=float(levels.se[k]))


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
    """Isotonic regression on the levels, through no thrust at rest where the load cell's zero is known. A pooled knot's
    error covers what pooling moved it by."""
    weights = levels.se**-2
    weights[levels.at_rest] = AT_REST * weights.max()
    force = np.asarray(optimize.isotonic_regression(levels.force, weights=weights).x)
    force[np.abs(force) < 1e-9] = 0.0  # rounding, beside the level at rest
    return Curve(levels.n, force, np.hypot(levels.error, force - levels.force))


def curve_left_out(levels: Levels) -> float:
    """Root mean square [N] over inner levels of what the curve through all others misses them by."""
    return _left_out(levels, lambda n, f, at: np.asarray(_through(n, f)(at)))


@dataclass(frozen=True)
class Quadratic:
    """``c1 n|n| + c2 n^2``: values, c2 None where all commands have one sign; covariance (n, n) of the values, scaled
    by the misfit, with that of the load cell's zero; rms and largest misfit [N]; p of a misfit as large by chance with
    df degrees of freedom, given the levels' own errors; rms of levels that were left out [N]."""

    c1: float
    c2: float | None
    covariance: Array
    rms: float
    largest: float
    at: float  # command of the largest misfit
    p: float
    df: int
    left_out: float

    @property
    def formula(self) -> str:
        """For people."""
        return "c1 n|n|" if self.c2 is None else "c1 n|n| + c2 n²"

    def __call__(self, n: Array) -> Array:
        return np.asarray(self.c1 * n * np.abs(n) + (self.c2 or 0.0) * n * n)


def fit_quadratic(levels: Levels) -> Quadratic:
    """Least squares with equal weights: the misfit is far above the readings' errors wherever it matters.

    The test has the levels' weights, and the load cell's zero free beside the level at rest, which is the same as to
    take it off with its error. Its statistic over df is F where the scatter between visits was estimated, else
    chi-squared over df.
    """
    n, force, moving = levels.n, levels.force, ~levels.at_rest
    both = bool(n.min() < 0.0 < n.max())
    B = _basis(n, both)
    solve = np.linalg.pinv(B)
    theta = solve @ force
    misfit = force - B @ theta
    df = max(int(moving.sum()) - theta.size, 1)
    worst = int(np.argmax(np.abs(misfit)))
    shift = levels.offset_se * solve @ moving
    design = B if levels.offset is None else np.column_stack([B, np.ones(n.size)])
    best = np.linalg.lstsq(design / levels.se[:, None], force / levels.se, rcond=None)[0]
    square = float(np.sum(((force - design @ best) / levels.se) ** 2))
    return Quadratic(
        float(theta[0]),
        float(theta[1]) if both else None,
        solve @ solve.T * float(misfit @ misfit) / df + np.outer(shift, shift),
        float(np.sqrt(np.mean(misfit**2))),
        float(misfit[worst]),
        float(n[worst]),
        float(stats.f.sf(square / df, df, levels.dof) if levels.dof else stats.chi2.sf(square, df)),
        df,
        _left_out(levels, lambda n, f, at: _basis(at, both) @ np.linalg.pinv(_basis(n, both)) @ f),
    )


def adequate(quadratic: Quadratic) -> bool:
    """Whether the quadratic fits within the levels' errors (1 %)."""
    return quadratic.p > ADEQUATE


def _left_out(levels: Levels, predict: Callable[[Array, Array, Array], Array]) -> float:
    missed = []
    for k in range(1, levels.n.size - 1):
        keep = np.arange(levels.n.size) != k
        at = predict(levels.n[keep], levels.force[keep], levels.n[k : k + 1])
        missed.append(levels.force[k] - float(np.squeeze(at)))
    return float(np.sqrt(np.mean(np.square(missed)))) if missed else float("nan")


def _through(n: Array, force: Array) -> interpolate.PchipInterpolator:
    return interpolate.PchipInterpolator(n, optimize.isotonic_regression(force).x)


def _basis(n: Array, both: bool) -> Array:
    """``n|n|`` and ``n^2``, the first alone where they are the same but for a sign: commands of one sign."""
    return np.column_stack([n * np.abs(n), n * n])[:, : 1 + both]


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
        "se": _rounded(levels.error),
        "n_samples": [int(k) for k in levels.n_samples],
        "memory": _rounded(levels.memory),
    } | ({} if levels.offset is None else {"offset": float(f"{levels.offset:.7g}")})
    document["quadratic"] = (
        {
            "c1": float(f"{quadratic.c1:.7g}"),
        }
        | ({} if quadratic.c2 is None else {"c2": float(f"{quadratic.c2:.7g}")})
        | {
            "rms": float(f"{quadratic.rms:.4g}"),
            "largest": float(f"{quadratic.largest:.4g}"),
            "adequate": adequate(quadratic),
        }
    )
    write_output(path, tomlkit.dumps(document))


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
