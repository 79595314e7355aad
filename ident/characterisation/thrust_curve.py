"""Static thrust curve: steady force against command, from benches that measure the force and not the shaft speed.

A level is the mean of the force over the times in which the command has one constant value. A visit is one of these
times. The standard errors of levels allow for autocorrelated samples and for the scatter between visits to one level.
The force at zero command (rest) is the zero of the load cell and is subtracted from all levels.

The quadratic ``c1 n|n| + c2 n^2`` (thesis section 4.2) does not hold if the thruster saturates, is asymmetric or has a
dead band. The alternative is a monotone curve through the measured levels: isotonic regression (pool adjacent
violators, Barlow et al. 1972), and between the levels the monotone cubic of Fritsch and Carlson (1980). Levels that
were left out show which of the two predicts better. The curve's file is described in docs/formats/curve.md.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import tomlkit
from numpy.typing import NDArray

from seatrial.daq.config import parse_toml, read_text
from seatrial.daq.errors import SeatrialError
from seatrial.daq.files import write_output
from seatrial.ident.data import Channel, sample_and_hold
from seatrial.ident.model import command_of, shaft_speed_of, thrust_of
from seatrial.ident.numerics import Array, chi2_sf, fisher_sf, mean_error, steady_segments

LEVEL_TOLERANCE = 1e-3  # of full command: closer commands are one level
MIN_SAMPLES = 20  # of the force in a visit, for a mean
REVERSED = -0.5  # correlation of the force with n|n|; noise gives more, a load cell with the wrong sign about -1
BEYOND_ERROR = 5.0  # standard errors between the smallest and the largest force; chance hardly ever gives more
REVERSED_LOAD_CELL = (
    "the force falls as the command rises: the load cell is reversed; change the sign of newton_per_count in the rig, "
    "or of the force's scale in the import map, and make the log again"
)
AT_REST = 1e12  # weight of the level at rest over that of the best level: forces the curve through zero thrust at rest
ADEQUATE = 0.01  # p value; the quadratic is not rejected above it
FORMAT = "seatrial-curve 1"


@dataclass(frozen=True)
class Levels:
    """Steady force of a thruster at each command (level) of a bench log.

    A visit is a time in which the command is constant. A level contains all visits to one command.

    Attributes
    ----------
    n : Array (n_levels,)
        Command of each level, -1 to 1, in ascending order.
    force : Array (n_levels,)
        Mean force of each level [N], less the offset.
    se : Array (n_levels,)
        Standard error of each mean force [N], with the scatter and without the error of the offset. These errors are
        independent of each other.
    n_samples : Array (n_levels,)
        Number of samples of the force in each level.
    memory : Array (n_levels,)
        Autocorrelation time of the samples in each level [samples], the largest of its visits; 1 for independent
        samples.
    offset
        Mean force at rest (zero command) [N], which has been subtracted from all forces. None if there is no level at
        rest.
    offset_se
        Standard error of the offset [N].
    scatter
        Standard deviation [N] between visits to one level other than rest, beyond the errors of the visits.
    dof
        Degrees of freedom of the scatter; 0 if no level other than rest was visited twice.
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
        """Mask (n_levels,) that is true for the level at rest (zero command), which gave the zero of the load cell.

        It is false for all levels if ``offset`` is None.
        """
        return np.asarray((self.n == 0.0) & (self.offset is not None))

    @property
    def error(self) -> Array:
        """Standard errors (n_levels,) [N] of the forces, with the error of the load cell's zero that was subtracted.

        All levels share this error, except the level at rest, whose error is that of ``se`` alone.
        """
        return np.hypot(self.se, np.where(self.at_rest, 0.0, self.offset_se))


def find_levels(command: Channel, force: Channel, settle: float = 1.5) -> Levels:
    """Compute the mean force at each steady command of a bench log.

    Parameters
    ----------
    command
        Channel of the command, -1 to 1.
    force
        Channel of the force [N]. Samples that are not finite are left out.
    settle
        Time after each change of the command that is left out [s].

    Returns
    -------
    Levels
        One level for each command, in ascending order of the command. Commands that differ by 0.001 or less are one
        level, and so are several visits to a command. The last command counts as constant to the end of the force.
        Visits with fewer than 20 samples of the force after ``settle`` are left out. If there is a level at zero
        command, its force has been subtracted from all levels.

    Raises
    ------
    ValueError
        If no visit has 20 samples of the force after ``settle``.

    Notes
    -----
    The variance between visits is estimated for all levels together, because two or three visits to one level hardly
    determine it.
    """
    visits: list[tuple[float, float, float, int, float]] = []
    for steady in steady_segments(command.t, command.value, np.inf):
        held = force.value[(force.t >= steady.start + settle) & (force.t < steady.end)]
        held = held[np.isfinite(held)]
        if held.size >= MIN_SAMPLES:
            error, memory = mean_error(held)
            visits.append((steady.level, float(held.mean()), error, held.size, memory))
    if not visits:
        message = (
            f"no command is constant for long enough: a level needs {settle:g} s to settle and {MIN_SAMPLES} samples "
            "of the force"
        )
        raise ValueError(f"{message}; {hold_advice(command, force, settle)}")
    return _without_offset(_merged_visits(sorted(visits)))


def hold_advice(command: Channel, force: Channel, settle: float) -> str:
    """Return the second half of an error message: how long the command is held constant, and what the user can do.

    The text states the typical time of a constant command [s] (median of these times, weighted by their length), and
    the time and the number of samples of the force that remain after ``settle``. It proposes a shorter ``settle``, or
    constant commands of longer duration if none leaves 20 samples.

    Parameters
    ----------
    command
        Command of the thruster, -1 to 1.
    force
        Force of the load cell [N].
    settle
        Time [s] that is left out after each change of the command.
    """
    end = float(max(command.t[-1], force.t[-1]))
    holds = np.sort([s.duration for s in steady_segments(command.t, command.value, end)])
    hold = float(holds[np.searchsorted(np.cumsum(holds), 0.5 * holds.sum())])
    rate = force.t.size / float(np.ptp(force.t))
    left = max(hold - settle, 0.0)
    message = (
        f"commands are constant for {hold:.2g} s, and after --settle {settle:g} s there remain {left:.2g} s with "
        f"{left * rate:.0f} samples of the force"
    )
    # half of the hold to settle, or less if the rest would have too few readings
    shorter = np.floor(10.0 * min(hold / 2.0, hold - MIN_SAMPLES / rate)) / 10.0
    if 0.0 < shorter < settle:
        return f"{message}: try --settle {shorter:g}"
    return f"{message}: hold each level for more than {settle + MIN_SAMPLES / rate:.2g} s (seatrial bench steps --hold)"


def clearly_falls(n: Array, force: Array, error: float = 0.0) -> bool:
    """Return whether a force clearly falls as n rises, as it does if the sign of the load cell is wrong.

    This is so if the correlation of the force with ``n|n|`` is below -0.5.

    Parameters
    ----------
    n : Array (n_samples,)
        Commands or shaft speeds, -1 to 1.
    force : Array (n_samples,)
        Forces [N].
    error
        Standard error of the forces [N].

    Returns
    -------
    bool
        Also False if n does not change, or if the range of the forces is at most five times ``error``, because the
        correlation may then be chance.
    """
    drive = n * np.abs(n)
    if not (np.ptp(drive) > 0.0 and np.ptp(force) > BEYOND_ERROR * error):
        return False
    return bool(np.corrcoef(drive, force)[0, 1] < REVERSED)


def _merged_visits(visits: Sequence[tuple[float, float, float, int, float]]) -> Levels:
    """Merge the visits (times of constant command) to each command into levels. The force at rest is not subtracted.

    ``visits`` are tuples in ascending order of the command: command, mean force [N], its standard error [N], number of
    samples, and their autocorrelation time [samples]. Commands that differ by 0.001 or less from their neighbour are
    one level. Its command is the mean of its visits, its force their mean weighted by inverse variance. The variance
    between visits is common to all levels except that at rest, which has its own, because it has no thrust that could
    scatter.
    """
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
    """Return the variance [N^2] between visits to the same level beyond their errors, and its degrees of freedom.

    A visit is a time of constant command. ``force`` [N], standard errors ``se`` [N] and numbers ``level`` of the levels
    have one element per visit (n_visits,). The variance is pooled over the levels (method of moments). It is 0, with 0
    degrees of freedom, if no level was visited twice.
    """
    _, group, size = np.unique(level, return_inverse=True, return_counts=True)
    dof = level.size - size.size
    deviation = force - (np.bincount(group, force) / size)[group]
    by_errors = float(se**2 @ (1.0 - 1.0 / size[group]))
    return max(float(deviation @ deviation) - by_errors, 0.0) / max(dof, 1), dof


def _without_offset(levels: Levels) -> Levels:
    """Return the levels with the force at rest subtracted; this force becomes their ``offset``.

    The level at rest has a command below 0.001 in size, which is set to exactly 0. Without such a level, the levels are
    returned unchanged.
    """
    rest = np.abs(levels.n) < LEVEL_TOLERANCE
    if not rest.any():
        return levels
    k = int(np.argmax(rest))
    offset, n = float(levels.force[k]), np.where(rest, 0.0, levels.n)
    return replace(levels, n=n, force=levels.force - offset, offset=offset, offset_se=float(levels.se[k]))


@dataclass(frozen=True)
class Curve:
    """Monotone curve of the force against the command, never falling, and constant beyond its ends.

    It is a monotone cubic (Fritsch and Carlson) through given points, its knots.

    Attributes
    ----------
    n : Array (n_knots,)
        Commands at the knots, -1 to 1, in ascending order.
    force : Array (n_knots,)
        Forces at the knots [N].
    se : Array (n_knots,)
        Standard errors of these forces [N].
    """

    n: Array
    force: Array
    se: Array

    def __call__(self, n: Array) -> Array:
        """Return the force (n_samples,) [N] at commands n (n_samples,); beyond the ends, the force at the end."""
        return np.asarray(_interpolator(self.n, self.force)(np.clip(n, self.n[0], self.n[-1])))

    def slope(self, n: Array) -> Array:
        """Return the slope d force / d n (n_samples,) [N] at commands n (n_samples,); zero at and beyond the ends."""
        inside = (n > self.n[0]) & (n < self.n[-1])
        return np.where(inside, _interpolator(self.n, self.force).derivative()(n), 0.0)

    def error(self, n: Array) -> Array:
        """Return the standard error (n_samples,) [N] of the force at commands n (n_samples,).

        It is linear between the knots of the curve, and constant beyond its ends.
        """
        return np.interp(n, self.n, self.se)


def fit_curve(levels: Levels) -> Curve:
    """Fit a monotone curve to the levels by isotonic regression (pool adjacent violators).

    The force of the curve never falls with the command: neighbouring levels that fall get their weighted mean. The
    levels are weighted by their inverse variance. If there is a level at rest, the curve is zero there. The standard
    error of a knot includes the change of the level's force by the regression.

    Parameters
    ----------
    levels
        Measured mean forces at steady commands.

    Returns
    -------
    Curve
        Curve with a knot at the command of each level.
    """
    weights = levels.se**-2
    weights[levels.at_rest] = AT_REST * weights.max()
    from scipy import optimize  # imported here: only a fit of a curve needs it

    force = np.asarray(optimize.isotonic_regression(levels.force, weights=weights).x)
    force[np.abs(force) < 1e-9] = 0.0  # the large weight of the level at rest leaves rounding errors
    return Curve(levels.n, force, np.hypot(levels.error, force - levels.force))


def curve_left_out(levels: Levels) -> float:
    """Return the RMS error [N] of the monotone curve at levels that were left out of its fit.

    Each level except the first and the last is predicted by the curve through all other levels. NaN if there are fewer
    than three levels.
    """
    return _left_out_error(levels, lambda n, f, at: np.asarray(_monotone_curve(n, f)(at)))


@dataclass(frozen=True)
class Quadratic:
    """Quadratic ``c1 n|n| + c2 n^2`` of the force against the command n, fitted to the levels of a bench log.

    Attributes
    ----------
    c1, c2
        Coefficients [N]; c2 is None if no two commands have opposite signs.
    covariance : Array (n_coefficients, n_coefficients)
        Covariance of the estimated coefficients [N^2], scaled by the misfit and with the error of the load cell's zero.
    rms, largest
        RMS misfit [N], and the misfit with the largest absolute value [N]: measured minus fitted force.
    at
        Command of the largest misfit.
    p, df
        p value of the misfit, given the errors of the levels, and its degrees of freedom. A small p value shows that
        the quadratic does not describe the levels.
    left_out
        RMS error [N] of the levels except the first and the last, each predicted by a fit to all other levels; NaN with
        fewer than three levels.
    """

    c1: float
    c2: float | None
    covariance: Array
    rms: float
    largest: float
    at: float
    p: float
    df: int
    left_out: float

    @property
    def formula(self) -> str:
        """Formula for reports: ``c1 n|n| + c2 n²``, or ``c1 n|n|`` if c2 is None."""
        return "c1 n|n|" if self.c2 is None else "c1 n|n| + c2 n²"

    def __call__(self, n: Array) -> Array:
        """Return the force (n_samples,) [N] of the quadratic at commands n (n_samples,)."""
        return np.asarray(self.c1 * n * np.abs(n) + (self.c2 or 0.0) * n * n)


def fit_quadratic(levels: Levels) -> Quadratic:
    """Fit the quadratic ``c1 n|n| + c2 n^2`` to the levels by least squares with equal weights, and test its misfit.

    Parameters
    ----------
    levels
        Measured mean forces at steady commands n. If no two commands have opposite signs, c2 is left out.

    Returns
    -------
    Quadratic
        Coefficients, their covariance, and the misfit with its p value.

    Notes
    -----
    Equal weights are right because the misfit is far above the errors of the levels wherever it matters. The test of
    the misfit weights the levels by their inverse variance. In the test the load cell's zero is a free parameter if
    there is a level at rest, which is equivalent to a subtraction with its error. The statistic divided by the degrees
    of freedom follows F if the scatter between visits was estimated. Otherwise the statistic follows chi-squared.
    """
    n, force, moving = levels.n, levels.force, ~levels.at_rest
    both = bool(n.min() < 0.0 < n.max())
    B = _quadratic_basis(n, both)
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
        float(fisher_sf(square / df, df, levels.dof) if levels.dof else chi2_sf(square, df)),
        df,
        _left_out_error(
            levels, lambda n, f, at: _quadratic_basis(at, both) @ np.linalg.pinv(_quadratic_basis(n, both)) @ f
        ),
    )


def adequate(quadratic: Quadratic) -> bool:
    """Return whether the quadratic describes the levels within their errors: p of its misfit is above 0.01."""
    return quadratic.p > ADEQUATE


def _left_out_error(levels: Levels, predict: Callable[[Array, Array, Array], Array]) -> float:
    """Return the RMS error [N] of levels that are predicted from all other levels.

    The first and the last level are not predicted. NaN if there are fewer than three levels. The function
    ``predict(n, force, at)`` returns the force [N] at a command ``at`` (1,) from the commands n and forces of the other
    levels.
    """
    missed = []
    for k in range(1, levels.n.size - 1):
        keep = np.arange(levels.n.size) != k
        at = predict(levels.n[keep], levels.force[keep], levels.n[k : k + 1])
        missed.append(levels.force[k] - float(np.squeeze(at)))
    return float(np.sqrt(np.mean(np.square(missed)))) if missed else float("nan")


def _monotone_curve(n: Array, force: Array) -> Any:
    """Return the monotone cubic (Fritsch and Carlson) through the isotonic regression of forces [N] at commands n.

    The curve never falls with the command. The result is SciPy's interpolator, a function of commands. The forces have
    equal weights.
    """
    from scipy import optimize

    return _interpolator(n, optimize.isotonic_regression(force).x)


def _quadratic_basis(n: Array, both: bool) -> Array:
    """Return the columns ``n|n|`` and ``n^2`` (n_levels, 2), or ``n|n|`` alone (n_levels, 1) if ``both`` is false.

    ``both``: whether the commands have both signs. With one sign the two columns are proportional. ``n``: commands
    (n_levels,).
    """
    return np.column_stack([n * np.abs(n), n * n])[:, : 1 + both]


@dataclass(frozen=True)
class ThrustCurve:
    """Static thrust curve: force against command of one thruster, or of several thrusters together.

    Attributes
    ----------
    curve
        Force [N] of all thrusters together.
    thrusters
        Number of thrusters, which all had the same command; at least 1.
    calibration
        Relative standard uncertainty of the load cell's force; None if it is unknown.
    """

    curve: Curve
    thrusters: int
    calibration: float | None = None

    def thrust_of_one(self, n: Array) -> Array:
        """Return the force [N] of one thruster at commands n (n_samples,): that of all, divided by their number."""
        return np.asarray(self.curve(n) / self.thrusters)


def thrust_channels(channels: Mapping[str, Channel], curve: ThrustCurve) -> dict[str, Channel]:
    """Compute the thrusts of both thrusters from the commands of a log by a static thrust curve.

    A command and its thrust are constant until the next sample.

    Parameters
    ----------
    channels
        Channels of the log by name: ``n_cmd_left`` and ``n_cmd_right``, or ``n_left`` and ``n_right`` in place of
        missing commands.
    curve
        Thrust curve.

    Returns
    -------
    dict of str to Channel
        The thrusts ``f_left`` and ``f_right``, each that of one thruster, and their sum ``X`` [N]. ``X_n`` [N] is the
        change of X per unit change of both commands away from zero. ``X - d X_n`` is therefore to first order the
        thrust with a dead band that is wider by d.

    Raises
    ------
    ValueError
        If the log has neither the command nor the shaft speed of a thruster.
    """
    found: dict[str, Channel] = {}
    slopes: list[Channel] = []
    for side in ("left", "right"):
        name = next((n for n in (command_of(side), shaft_speed_of(side)) if n in channels), None)
        if name is None:
            raise ValueError(
                f"no command for the thrust curve: the log has neither n_cmd_{side} nor n_{side}; record the commands "
                "of both thrusters"
            )
        command = channels[name]
        found[thrust_of(side)] = Channel(command.t, curve.thrust_of_one(command.value), "N", command.source)
        outward = np.sign(command.value) * curve.curve.slope(command.value) / curve.thrusters
        slopes.append(Channel(command.t, outward, "N", command.source))
    return found | {"X": sum_of_held(found["f_left"], found["f_right"]), "X_n": sum_of_held(*slopes)}


def sum_of_held(left: Channel, right: Channel) -> Channel:
    """Return the sum of two channels, ``left`` and ``right``, whose values are constant until the next sample.

    The sum has the times of both channels. Before the first sample of a channel, its value is that of this sample. Its
    unit and its source are those of ``left``.
    """
    t = np.union1d(left.t, right.t)
    return Channel(t, sample_and_hold(left, t) + sample_and_hold(right, t), left.unit, left.source)


def save_curve(
    path: Path, curve: ThrustCurve, levels: Levels, quadratic: Quadratic, provenance: Mapping[str, Any]
) -> None:
    """Write a thrust curve to a TOML file, with the levels it goes through and the quadratic it was compared with.

    Parameters
    ----------
    path
        File to write; an existing file is replaced. Its format is in docs/formats/curve.md.
    curve
        The curve.
    levels
        Measured mean forces at steady commands.
    quadratic
        Quadratic fitted to the levels.
    provenance
        Origin of the data, such as software version, command line and logs: values of TOML by key.
    """
    document = tomlkit.document()
    document["format"] = FORMAT
    document["thrusters"] = curve.thrusters
    if curve.calibration is not None:
        document["calibration"] = float(f"{curve.calibration:.4g}")
    document["provenance"] = dict(provenance)
    document["curve"] = {
        "n": _seven_digits(curve.curve.n),
        "force": _seven_digits(curve.curve.force),
        "se": _seven_digits(curve.curve.se),
        "between": "monotone cubic (Fritsch and Carlson); constant beyond the ends",
    }
    document["measured"] = {
        "n": _seven_digits(levels.n),
        "force": _seven_digits(levels.force),
        "se": _seven_digits(levels.error),
        "n_samples": [int(k) for k in levels.n_samples],
        "memory": _seven_digits(levels.memory),
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


def _seven_digits(values: Sequence[float] | Array) -> list[float]:
    """Return the values (n,) as a list of floats, rounded to seven significant digits."""
    return [float(f"{v:.7g}") for v in values]


def load_curve(path: Path) -> ThrustCurve | None:
    """Read a thrust curve from a file that `save_curve` wrote.

    Parameters
    ----------
    path
        TOML file.

    Returns
    -------
    ThrustCurve or None
        None if the file cannot be read, is no TOML, or has another ``format``: the caller tries other formats then.

    Raises
    ------
    SeatrialError
        If a key of the curve is missing or has a wrong type, or if its numbers are out of range: fewer than two
        commands, commands that do not rise, arrays of different lengths, values that are not finite, no thruster, or an
        uncertainty that is not between 0 and 1.
    """
    try:
        table = parse_toml(read_text(path), path).values
    except SeatrialError:
        return None  # the reader of the other formats reports the error
    if table.get("format") != FORMAT:
        return None
    try:
        n, force, se = (np.array(table["curve"][k], dtype=float) for k in ("n", "force", "se"))
        thrusters, uncertainty = int(table["thrusters"]), table.get("calibration")
        calibration = None if uncertainty is None else float(uncertainty)
    except (KeyError, TypeError, ValueError) as problem:
        raise SeatrialError(
            f"{path}: the thrust curve lacks a key, or a value has a wrong type: {problem}; fit the curve again"
        ) from problem
    if not (n.size == force.size == se.size >= 2 and thrusters >= 1 and np.all(np.diff(n) > 0)):
        raise SeatrialError(
            f"{path}: a thrust curve needs two or more commands n in rising order, with as many values of force and "
            "se, and one or more thrusters; fit the curve again"
        )
    if not all(np.isfinite(a).all() for a in (n, force, se)):
        raise SeatrialError(f"{path}: n, force and se of a thrust curve have to be finite numbers; fit the curve again")
    if calibration is not None and not 0.0 < calibration < 1.0:
        raise SeatrialError(
            f"{path}: calibration is {calibration:g}, but it has to be between 0 and 1 (relative standard uncertainty "
            "of the load cell); correct it"
        )
    return ThrustCurve(Curve(n, force, se), thrusters, calibration)


def _interpolator(n: Array, force: Array) -> Any:
    """Return the monotone cubic through the forces (n_knots,) at increasing commands ``n`` (n_knots,).

    The result is SciPy's interpolator, a function of commands.
    """
    from scipy.interpolate import PchipInterpolator  # imported here: it takes half a second, and only curves need it

    return PchipInterpolator(n, force)
