"""Profile likelihood: the log-likelihood over one parameter with all others fitted again, and its 95 % interval.

From the estimate the parameter is moved outwards until the log-likelihood has dropped by 1.92, half of the 95 %
quantile of chi-squared (Pawitan 2001, section 3.4). Two difficulties are handled:

- A refit from a bad place ends at another local maximum or at a bound. Each refit therefore starts at the best of
  several places. If the drop jumps, the refit is tried from more places.
- The distance of the first point is a guess from the curvature. A point that lies too far out, or at which the
  likelihood is not finite, only closes a bracket. The bracket is then narrowed until the distance of the crossing is
  known to one per cent.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np
from scipy.interpolate import PchipInterpolator

from seatrial.ident.data import Record
from seatrial.ident.estimation.fisher_scoring import Bounds, Evaluation, Optimum, Problem, maximise
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.maximum_likelihood import TOLERANCE, Fit
from seatrial.ident.estimation.standard_errors import (
    DROP_95,
    NULL_SPACE_TOLERANCE,
    Z_95,
    flat_coordinates,
    with_interval_information,
)
from seatrial.ident.model import segment_name
from seatrial.ident.numerics import Array

TARGET_DROPS = (0.15, 0.6, 1.3, 2.4)  # drops of the log-likelihood at which points are placed, on each side
MAX_OUTWARD_POINTS = 12  # points on a side before that end of the interval is left open
MAX_BRACKET_POINTS = 14  # points between the last one inside the interval and the first one outside
MAX_GROWTH = 3.0  # largest ratio of the distances of successive points
MAX_LOG_STEP = 1.5  # largest change of a logarithm between successive points: a factor 4.5
MIN_DROP = 1e-3  # smaller drops of the log-likelihood are within the tolerance of a refit
CROSSING_TOLERANCE = 0.01  # accuracy of the end of the interval, relative to its distance from the estimate
JUMP_RATIO = 4.0  # a drop this many times that of the parabola through the last point may come from a bad refit
MIN_GAIN = 0.01  # a log-likelihood higher by this is another optimum; less is rounding
N_RESTARTS = 4  # times that the profile may be traced again from a better optimum


@dataclass(frozen=True)
class Profile:
    """Profile likelihood of one parameter, in the parameter's own unit.

    Attributes
    ----------
    name
        As in ``Fit.names`` (``V_x@0``: the value of record 0).
    value
        The maximum of the likelihood: the fit's estimate, or after REML the maximum of the likelihood itself. If a
        better fit was found during the search, its value; ``notes`` then contain a line about it.
    grid : Array (n,)
        Values of the parameter, increasing.
    drop : Array (n,)
        Drop of the log-likelihood at these values; zero at ``value``.
    low, high
        Ends of the 95 % interval, accurate to about one per cent of their distance; NaN for an open side.
    wald_low, wald_high
        The fit's value +- 1.96 standard errors (of the logarithm if the fit estimates the logarithm); NaN if the
        parameter has no standard error.
    notes
        Remarks for the reader.
    """

    name: str
    unit: str
    value: float
    grid: Array
    drop: Array
    low: float
    high: float
    wald_low: float
    wald_high: float
    notes: tuple[str, ...] = ()


def profile(fit: Fit, records: Sequence[Record], name: str, *, threads: int = 2) -> Profile:
    """Return the profile likelihood of one estimated parameter, on a grid that finds its own range.

    Parameters
    ----------
    fit, records
        A fit and its records.
    name
        ``NAME@K`` for the value of record K of a per-record parameter. ``NAME`` is enough if the fit has one record.
    threads
        Number of records that are evaluated at once.

    Raises
    ------
    ValueError
        If the fit did not estimate the parameter, or if the records are not those of the fit.
    """
    full = segment_name(name, 0) if name not in fit.names and len(fit.records) == 1 else name
    if full not in fit.names:
        each = [p.full_name for p in fit.parameters if p.name == name]
        hint = f"each run has its own: {', '.join(each)}" if each else f"it estimated {', '.join(fit.names)}"
        raise ValueError(f"no profile of {name}: the fit did not estimate it; {hint}")
    problem = _problem(fit, records, threads)
    estimate = problem.bounds.clip(
        np.array([p.to_free(v) for p, v in zip(problem.parameters, fit.values, strict=True)])
    )
    line = ConstrainedObjective(problem, fit.names.index(full), estimate)
    if fit.options.reml:  # REML moved the noise away from the maximum of the likelihood, which is profiled here
        line.release(estimate)
        line.restart()
    before, sides = line.top, _sides(line)
    for _ in range(N_RESTARTS):
        if not line.restart():
            break
        sides = _sides(line)
    notes = [f"{word} side: {side.note}" for word, side in zip(("lower", "upper"), sides, strict=True) if side.note]
    if line.found[0] > before + MIN_GAIN:
        notes.append(
            f"a better fit was found during the search, by {line.found[0] - before:.2g} in log-likelihood; the profile "
            "is of that fit: fit again from there"
        )
    error = fit.errors[line.k] / np.abs(line.parameter.slope(fit.values[line.k]))
    return _gathered(line, full, sides, [estimate[line.k] + sign * Z_95 * error for sign in (-1, 1)], notes)


def _sides(line: ConstrainedObjective) -> list[ProfileBranch]:
    return [trace_profile(line, sign) for sign in (-1, 1)]


def _problem(fit: Fit, records: Sequence[Record], threads: int) -> Problem:
    """Return the fit's objective for the records. Raise ValueError if the records are not those of the fit."""
    likelihood = Likelihood(fit.model, process_noise=fit.options.process_noise)
    free = tuple(dict.fromkeys(p.name for p in fit.parameters))
    problem = Problem(likelihood, [r.for_model(fit.model) for r in records], free, threads)
    if problem.names != fit.names:
        raise ValueError(
            f"the fit estimated {len(fit.names)} parameters, these records have "
            f"{len(problem.names)}: give the records of the fit"
        )
    return problem


def _gathered(
    line: ConstrainedObjective, name: str, sides: Sequence[ProfileBranch], wald: Sequence[float], notes: Sequence[str]
) -> Profile:
    """Return the profile in the parameter's own unit.

    ``sides`` are its two branches. ``wald`` are the ends of the Wald interval, in the estimator's coordinate.
    """
    p, centre = line.parameter, float(line.z[line.k])

    def own(z: float) -> float:
        return float(np.clip(p.from_free(z), *p.bounds)) if np.isfinite(z) else float("nan")

    below, above = (side.shown for side in sides)
    z = [centre - q.s for q in below[::-1]] + [centre] + [centre + q.s for q in above]
    drop = np.array([*[q.drop for q in below[::-1]], 0.0, *[q.drop for q in above]])
    return Profile(
        name,
        p.unit,
        own(centre),
        np.array([own(v) for v in z]),
        drop,
        own(centre - sides[0].limit),
        own(centre + sides[1].limit),
        own(wald[0]),
        own(wald[1]),
        tuple(notes),
    )


def trace_profile(line: ConstrainedObjective, sign: int) -> ProfileBranch:
    """Trace one side of the profile.

    The trace ends when the crossing is known, a bound is reached or the allowed number of points is used. It also ends
    if it meets a better optimum than its centre; the caller then starts again from there.

    Parameters
    ----------
    line
        The objective with the parameter held.
    sign
        -1 for the lower side, 1 for the upper.
    """
    z_k, side = line.z[line.k], ProfileBranch([ProfilePoint(0.0, 0.0, line.z)])
    room = float(line.bounds.high[line.k] - z_k if sign > 0 else z_k - line.bounds.low[line.k])
    if room <= 0:
        side.note, side.limit = "at its bound", 0.0
        return side
    outwards = inwards = 0
    while line.found[0] < line.top + MIN_GAIN:
        if side.outer is not None:
            exact = side.crossing()[1]
            if exact or inwards == MAX_BRACKET_POINTS:
                break
            inwards += 1
            s = side.between()
        elif side.inner.s >= room or outwards == MAX_OUTWARD_POINTS:
            break
        else:
            s = min(_outwards(line, side, sign, TARGET_DROPS[min(outwards, len(TARGET_DROPS) - 1)]), room)
            outwards += 1
        point, before = line.best(s, sign, side), side.inner
        if point.s > before.s and point.drop < before.drop - MIN_DROP:
            line.release(point.z)  # the likelihood rises again: search for another maximum from here
        side.add(point)
    _end(line, sign, side, room)
    return side


def _end(line: ConstrainedObjective, sign: int, side: ProfileBranch, room: float) -> None:
    """Set the limit and the note of a finished branch. ``room`` is the distance to the parameter's bound."""
    reached = line.parameter.from_free(float(line.z[line.k]) + sign * side.inner.s)
    if side.outer is None:
        bound = side.inner.s >= room
        side.limit = room if bound else float("nan")
        side.note = "reaches its bound" if bound else f"the data set no limit; the search ended at {reached:.4g}"
    elif np.isfinite(side.outer.drop):
        side.limit = side.crossing()[0]
    else:
        side.note = f"the likelihood cannot be evaluated beyond {reached:.4g}"


def _outwards(line: ConstrainedObjective, side: ProfileBranch, sign: int, target: float) -> float:
    """Return the distance at which the drop should reach ``target``.

    The first distance comes from the curvature, or from the characteristic step if the curvature is unknown. Later ones
    extrapolate the points found so far.
    """
    last, logarithmic = side.inner, bool(line.bounds.logarithmic[line.k])
    if last.s > 0.0:
        s = last.s * float(np.clip((target / max(last.drop, MIN_DROP)) ** (1.0 / side.power), 1.25, MAX_GROWTH))
    elif line.curvature > 0.0:
        # solves g s + c s^2 / 2 = target; g is zero except for a parameter that is pushed against its bound
        g, c = max(-sign * line.gradient, 0.0), line.curvature
        s = 2.0 * target / (g + np.sqrt(g * g + 2.0 * c * target))
    else:
        p = line.parameter
        s = MAX_LOG_STEP if logarithmic else p.step or 0.1 * abs(float(line.z[line.k])) or 1.0
    return float(min(s, last.s + MAX_LOG_STEP) if logarithmic else s)


@dataclass(frozen=True)
class ProfilePoint:
    """Point of a profile branch.

    Attributes
    ----------
    s
        Distance from the estimate, in the estimator's coordinate.
    drop
        Drop of the log-likelihood from its maximum; infinite if the likelihood is not finite.
    z : Array (n,)
        All coordinates, with the others at their best.
    """

    s: float
    drop: float
    z: Array


@dataclass
class ProfileBranch:
    """Points on one side of the estimate, in order of distance, and how that side ended.

    Attributes
    ----------
    points
        All points so far.
    limit
        Distance of the end of the 95 % interval; NaN if the side is open.
    note
        Remark about this end.
    narrowed
        Widths of the bracket so far.
    """

    points: list[ProfilePoint]
    limit: float = float("nan")
    note: str = ""
    narrowed: list[float] = field(default_factory=list)

    @property
    def inside(self) -> list[ProfilePoint]:
        """The points before the first one outside the 95 % interval."""
        n = next((i for i, p in enumerate(self.points) if p.drop >= DROP_95), len(self.points))
        return self.points[:n]

    @property
    def inner(self) -> ProfilePoint:
        """The last point inside the 95 % interval."""
        return self.inside[-1]

    @property
    def outer(self) -> ProfilePoint | None:
        """The first point outside the 95 % interval; None if there is none yet."""
        return next((p for p in self.points if p.drop >= DROP_95), None)

    @property
    def shown(self) -> list[ProfilePoint]:
        """The points to be plotted: those inside, and the first one outside. Others only closed the bracket."""
        return [*self.inside[1:], *[p for p in [self.outer] if p is not None and np.isfinite(p.drop)]]

    def add(self, point: ProfilePoint) -> None:
        """Insert a point in order of distance."""
        self.points = sorted([*self.points, point], key=lambda p: p.s)

    @property
    def power(self) -> float:
        """The exponent with which the drop grows at the last point inside.

        It is 2 for a parabola, and less if the drop flattens out.
        """
        before, last = self.inside[-2:]
        if before.drop < MIN_DROP or before.s == 0.0:
            return 2.0
        return float(np.clip(np.log(max(last.drop / before.drop, 1.0)) / np.log(last.s / before.s), 0.25, 2.0))

    def expected(self, s: float) -> float:
        """Return the drop at ``s`` above which a refit is doubtful: several times that of a parabola."""
        last = self.inner
        return JUMP_RATIO * (max(last.drop, TARGET_DROPS[0]) * (s / last.s) ** 2 if last.s > 0 else DROP_95)

    def crossing(self) -> tuple[float, bool]:
        """Return the distance at which the drop is 1.92, and whether it is accurate enough.

        The root of the drop is nearly a straight line in the distance, so that it is interpolated.
        """
        inner, outer = self.inner, self.outer
        assert outer is not None
        if outer.s - inner.s < CROSSING_TOLERANCE * outer.s or not np.isfinite(outer.drop):
            return 0.5 * (inner.s + outer.s), outer.s - inner.s < CROSSING_TOLERANCE * outer.s
        line = [*self.inside, outer]
        root = np.sqrt(np.maximum([p.drop for p in line], 0.0))
        rising = np.maximum.accumulate(root) + 1e-12 * np.arange(len(line))
        at = float(PchipInterpolator(rising, [p.s for p in line])(np.sqrt(DROP_95)))
        chord = inner.s + (outer.s - inner.s) * (np.sqrt(DROP_95) - root[-2]) / (root[-1] - root[-2])
        smooth = inner.drop > DROP_95 / 2 and outer.drop < DROP_95 * 2
        close = min(at - inner.s, outer.s - at) < CROSSING_TOLERANCE * at
        return at, bool(smooth and (close or abs(at - chord) < CROSSING_TOLERANCE * at))

    def between(self) -> float:
        """Return the next distance inside the bracket.

        It is where a straight line through the root of the drop crosses. If that line is a poor guess, the middle of
        the bracket is taken (the geometric middle if the bracket spans more than a factor of four).
        """
        inner, outer = self.inner, self.outer
        assert outer is not None
        low, high = inner.s, outer.s
        self.narrowed.append(high - low)
        if low == 0.0:
            guess = high * np.sqrt(DROP_95 / outer.drop) if np.isfinite(outer.drop) else 0.0
            return float(np.clip(guess, 0.01 * high, 0.5 * high) if guess else 0.1 * high)
        slow = len(self.narrowed) > 2 and self.narrowed[-1] > 0.5 * self.narrowed[-3]
        if outer.drop > 4 * DROP_95 or slow:
            return float(np.sqrt(low * high) if high > 4.0 * low else 0.5 * (low + high))
        root = np.sqrt(np.maximum([inner.drop, outer.drop], 0.0))
        share = (np.sqrt(DROP_95) - root[0]) / (root[1] - root[0])
        return float(low + (high - low) * np.clip(share, 0.1, 0.9))


class ConstrainedObjective:
    """The objective with coordinate ``k`` held and the others at their best.

    Attributes
    ----------
    z : Array (n,)
        The optimum from which the profile starts.
    top
        Objective there.
    found
        The best point of all that were evaluated, as (objective, coordinates).
    gradient, curvature
        Of the profile at the optimum, by coordinate ``k``; a curvature of zero is unknown.
    slope : Array (n - 1,)
        Derivatives of the other coordinates' best values by coordinate ``k``.
    flat : Array (n,)
        Information of flat coordinates from their intervals (`flat_coordinates`); zero for others.
    """

    def __init__(self, problem: Problem, k: int, z: Array) -> None:
        self.problem, self.k, self.bounds, self.parameter = problem, k, problem.bounds, problem.parameters[k]
        self.others = np.delete(np.arange(z.size), k)
        self.rest = Bounds(
            self.bounds.low[self.others], self.bounds.high[self.others], self.bounds.logarithmic[self.others]
        )
        self._centre(z)

    def _centre(self, z: Array) -> None:
        """Let the profile start from the optimum z (n,)."""
        problem = self.problem
        self.z, at = z, problem.evaluate(z)
        flat = flat_coordinates(problem.value, z, problem.parameters, at.information, self.bounds)
        self.flat = np.zeros(z.size)
        self.flat[[p.at for p in flat]] = [p.information for p in flat]
        self.top, self.found = at.value, (at.value, z)
        self.gradient = float(at.gradient[self.k])
        self.curvature, self.slope = self._curvature(with_interval_information(at, flat))

    def _curvature(self, at: Evaluation) -> tuple[float, Array]:
        """Return the curvature of the profile at the optimum and the slopes of the other coordinates (n - 1,).

        A curvature of zero means unknown. Coordinates at a bound have no slope.
        """
        H = at.hessian
        held = self.bounds.held(self.z, at.gradient)[self.others]
        moving = self.others[~held]
        follow = np.zeros(self.others.size)
        if moving.size:
            scale = np.sqrt(np.maximum(np.diag(H)[moving], 1e-300))
            right = H[moving, self.k] / scale
            follow[~held] = (
                -np.linalg.lstsq(H[np.ix_(moving, moving)] / np.outer(scale, scale), right, rcond=1e-12)[0] / scale
            )
        curvature = float(H[self.k, self.k] + H[self.k, self.others] @ follow)
        return (curvature if curvature > NULL_SPACE_TOLERANCE * H[self.k, self.k] else 0.0), follow

    def restart(self) -> bool:
        """Start the profile from a better optimum if one was found. Return whether it was."""
        if self.found[0] < self.top + MIN_GAIN:
            return False
        self.release(self.found[1])
        self._centre(self.found[1])
        return True

    def release(self, z: Array) -> None:
        """Search for the maximum from z (n,) with all coordinates free, and keep it in ``found`` if it is better."""
        top = maximise(self._flattened, z, self.bounds, max_iterations=40, tolerance=TOLERANCE)
        self.found = max(self.found, (top.at.value, top.z), key=lambda candidate: candidate[0])

    def best(self, s: float, sign: int, side: ProfileBranch) -> ProfilePoint:
        """Return the best point at distance ``s``.

        The refit starts from the nearest point inside, as it is or moved along the slopes at the optimum. If the drop
        jumps, the refit is repeated from the optimum and from the nearest point further out.
        """
        near, z_k = side.inner, float(self.z[self.k]) + sign * s
        carried = near.z.copy()
        carried[self.others] += sign * (s - near.s) * self.slope
        point = self._refitted(s, z_k, (carried, near.z))
        if point.drop > side.expected(s):
            again = self._refitted(s, z_k, (self.z, *[p.z for p in side.points if p.s > s and np.isfinite(p.drop)][:1]))
            point = min(point, again, key=lambda p: p.drop)
        return point

    def _refitted(self, s: float, z_k: float, starts: Iterable[Array]) -> ProfilePoint:
        """Return the point at distance ``s`` (coordinate ``z_k``), refitted from the best of the ``starts``."""

        def whole(rest: Array) -> Array:
            return np.insert(rest, self.k, z_k)

        def evaluate(rest: Array) -> Evaluation:
            at, o = self._flattened(whole(rest)), self.others
            return Evaluation(at.value, at.gradient[o], at.information[np.ix_(o, o)], at.curvature[o])

        tried = [
            (at.value, rest)
            for rest in (self.rest.clip(z[self.others]) for z in starts)
            if (at := evaluate(rest)).finite
        ]
        if not tried:
            return ProfilePoint(s, np.inf, self.z)
        value, rest = max(tried, key=lambda candidate: candidate[0])
        if rest.size:
            found: Optimum = maximise(evaluate, rest, self.rest, max_iterations=40, tolerance=TOLERANCE * 100)
            value, rest = found.at.value, found.z
        self.found = max(self.found, (value, whole(rest)), key=lambda candidate: candidate[0])
        return ProfilePoint(s, self.top - value, whole(rest))

    def _flattened(self, z: Array) -> Evaluation:
        """Return the evaluation with at least the intervals' information for flat coordinates.

        Without information a flat coordinate would take a very long step.
        """
        at = self.problem.evaluate(z)
        return Evaluation(
            at.value, at.gradient, at.information, np.maximum(at.curvature, self.flat - np.diag(at.information))
        )
