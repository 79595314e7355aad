"""Profile likelihood: the log-likelihood over one parameter with all others fitted again, and its 95 % interval.

The interval is valid where a standard error is not, because the log-likelihood is no parabola. From the estimate the
parameter is moved outwards until the log-likelihood has dropped by 1.92, half of the 95 % quantile of chi-squared
(Pawitan 2001, section 3.4). Two difficulties are handled:

- A refit from bad initial values ends at another local maximum or at a bound. Each refit therefore starts at the best
  of several sets of values. If the drop jumps, the refit is repeated from more sets.
- The distance of the first point is a guess from the curvature. If this point lies too far out, or if the likelihood is
  not finite there, the end of the interval lies between it and the last point inside. This bracket is then narrowed
  until the distance of the end is known to one per cent.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

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

    It is the log-likelihood as a function of this parameter, with all other estimated parameters fitted again at each
    value.

    Attributes
    ----------
    name, unit
        Full name of the parameter (``V_x@0``: the value of V_x in record 0), and its unit.
    value
        Value at the maximum of the likelihood. It is the fit's estimate, except in two cases: after REML (restricted
        maximum likelihood), it is the maximum of the likelihood itself; if a better fit was found during the search,
        it is the value of that fit, and ``notes`` contain a line about it.
    grid : Array (n,)
        Values of the parameter, increasing, with ``value`` among them.
    drop : Array (n,)
        Drop of the log-likelihood from its maximum at these values, all other parameters fitted again; zero at
        ``value``.
    low, high
        Ends of the 95 % interval, where the drop is 1.92, in general accurate to about one per cent of their distance
        from ``value``. An end is the bound of the parameter if the interval reaches it, and NaN if no end was found.
    wald_low, wald_high
        Ends of the Wald interval: the fit's value +- 1.96 standard errors (of the logarithm if the fit estimates the
        logarithm). NaN if the parameter has no standard error.
    notes
        Remarks about the two ends of the interval and about a better fit, as sentences for a report.
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
    """Return the profile likelihood of one estimated parameter, on a grid whose range is found by the search.

    It is used for a 95 % interval that does not assume a quadratic log-likelihood.

    Parameters
    ----------
    fit, records
        Fit, and the records to which it was fitted, in the same order.
    name
        Name of the parameter: ``NAME``, or ``NAME@K`` for the value of a per-record parameter in record K. ``NAME`` is
        enough if the fit has one record.
    threads
        Largest number of records that are evaluated at the same time.

    Returns
    -------
    Profile
        Log-likelihood over the parameter, and the 95 % interval. If a better fit is found during the search, the
        profile is that of the better fit, and ``notes`` says so.

    Raises
    ------
    ValueError
        If the fit did not estimate the parameter, or if a fit to these records would estimate other parameters: the fit
        has per-record parameters, and the number of records differs. Other differences of the records are not found.
    """
    full = segment_name(name, 0) if name not in fit.names and len(fit.records) == 1 else name
    if full not in fit.names:
        each = [p.full_name for p in fit.parameters if p.name == name]
        hint = f"each run has its own: {', '.join(each)}" if each else f"it estimated {', '.join(fit.names)}"
        raise ValueError(f"no profile of {name}: the fit did not estimate it; {hint}")
    problem = _problem_of_fit(fit, records, threads)
    estimate = problem.bounds.clip(
        np.array([p.to_free(v) for p, v in zip(problem.parameters, fit.values, strict=True)])
    )
    objective = ConstrainedObjective(problem, fit.names.index(full), estimate)
    if fit.options.reml:  # REML moved the noise away from the maximum of the likelihood, which is profiled here
        objective.release(estimate)
        objective.restart()
    before, sides = objective.top, _trace_both_sides(objective)
    for _ in range(N_RESTARTS):
        if not objective.restart():
            break
        sides = _trace_both_sides(objective)
    notes = [f"{word} side: {side.note}" for word, side in zip(("lower", "upper"), sides, strict=True) if side.note]
    if objective.best_found[0] > before + MIN_GAIN:
        p = objective.parameter
        value = p.from_free(float(objective.z[objective.coordinate]))
        again = f"--initial {full}={value:.6g}" if p.segment is None else "other initial values (--initial)"
        notes.append(
            f"the profile found a fit with a log-likelihood larger by {objective.best_found[0] - before:.2g}, and "
            f"belongs to that fit: fit again with {again}"
        )
    error = fit.errors[objective.coordinate] / np.abs(objective.parameter.slope(fit.values[objective.coordinate]))
    return _profile_in_own_unit(
        objective, full, sides, [estimate[objective.coordinate] + sign * Z_95 * error for sign in (-1, 1)], notes
    )


def _trace_both_sides(objective: ConstrainedObjective) -> list[ProfileBranch]:
    """Trace the profile on the lower side, then on the upper side of the estimate, and return both in this order."""
    return [trace_profile(objective, sign) for sign in (-1, 1)]


def _problem_of_fit(fit: Fit, records: Sequence[Record], threads: int) -> Problem:
    """Return the objective of a fit (log-posterior of its estimated parameters) for the given records.

    ``threads`` is the largest number of records that are evaluated at the same time. Raise ValueError if the fit has
    per-record parameters and the number of records differs: the names of the estimated parameters then differ. Other
    differences of the records are not found.
    """
    likelihood = Likelihood(fit.model, process_noise=fit.options.process_noise)
    free = tuple(dict.fromkeys(p.name for p in fit.parameters))
    problem = Problem(likelihood, [r.for_model(fit.model) for r in records], free, threads)
    if problem.names != fit.names:
        raise ValueError(
            f"the fit estimated {len(fit.names)} parameters, but a fit to these records would estimate "
            f"{len(problem.names)}; give the records to which the model was fitted"
        )
    return problem


def _profile_in_own_unit(
    objective: ConstrainedObjective,
    name: str,
    sides: Sequence[ProfileBranch],
    wald: Sequence[float],
    notes: Sequence[str],
) -> Profile:
    """Convert the two sides of a profile from the estimator's coordinate to the parameter's own unit.

    The estimator's coordinate is the logarithm of the parameter for a parameter with ``transform="log"``, otherwise the
    parameter itself.

    Parameters
    ----------
    objective
        Objective of which the profile was traced.
    name
        Full name of the parameter.
    sides
        Profile below and above the estimate, in this order.
    wald
        Lower and upper end of the Wald interval (1.96 standard errors), in the estimator's coordinate. An end that is
        not finite becomes NaN.
    notes
        Remarks for the reader.
    """
    p, centre = objective.parameter, float(objective.z[objective.coordinate])

    def own(z: float) -> float:
        """Return a value of the coordinate in the parameter's own unit; NaN if it is not finite."""
        return float(np.clip(p.from_free(z), *p.bounds)) if np.isfinite(z) else float("nan")

    below, above = (side.plotted_points for side in sides)
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


def trace_profile(objective: ConstrainedObjective, sign: int) -> ProfileBranch:
    """Find the end of a parameter's 95 % likelihood interval on one side of the estimate, point by point.

    At each point the parameter is held and all others are fitted again. The search ends when the distance at which the
    log-likelihood has dropped by 1.92 is known to one per cent, or when a bound is reached. It ends without this if 12
    points outwards are all inside the interval, or if 14 points between the last point inside and the first outside are
    used. It also ends if a better optimum than the estimate is found. This optimum is then in ``objective.best_found``,
    and the caller starts again from there.

    Parameters
    ----------
    objective
        Objective of a fit with the parameter held.
    sign
        -1 for the side below the estimate, 1 for the side above.

    Returns
    -------
    ProfileBranch
        Evaluated points, the distance of the interval's end, and a remark about this end. An estimate at its bound on
        this side has the distance 0 and no further points.
    """
    z_k, side = objective.z[objective.coordinate], ProfileBranch([ProfilePoint(0.0, 0.0, objective.z)])
    room = float(
        objective.bounds.high[objective.coordinate] - z_k
        if sign > 0
        else z_k - objective.bounds.low[objective.coordinate]
    )
    if room <= 0:
        side.note, side.limit = "at its bound", 0.0
        return side
    outwards = inwards = 0
    while objective.best_found[0] < objective.top + MIN_GAIN:
        if side.first_outside is not None:
            exact = side.crossing()[1]
            if exact or inwards == MAX_BRACKET_POINTS:
                break
            inwards += 1
            s = side.next_distance_in_bracket()
        elif side.last_inside.s >= room or outwards == MAX_OUTWARD_POINTS:
            break
        else:
            s = min(
                _next_distance_outwards(objective, side, sign, TARGET_DROPS[min(outwards, len(TARGET_DROPS) - 1)]), room
            )
            outwards += 1
        point, before = objective.best_point(s, sign, side), side.last_inside
        if point.s > before.s and point.drop < before.drop - MIN_DROP:
            objective.release(point.z)  # the likelihood rises again: search for another maximum from here
        side.add_point(point)
    _set_limit_and_note(objective, sign, side, room)
    return side


def _set_limit_and_note(objective: ConstrainedObjective, sign: int, side: ProfileBranch, room: float) -> None:
    """Set ``limit`` (distance of the interval's end) and ``note`` (remark about it) of a finished ``side``, in place.

    The limit is the crossing of a drop of 1.92. Without a point beyond the crossing it is the distance of the bound if
    the bound was reached. It stays NaN if the search ended before, or if the likelihood is not finite further out.

    Parameters
    ----------
    objective
        Objective of which the profile was traced.
    sign
        -1 for the side below the estimate, 1 for the side above.
    side
        Points of this side of the profile.
    room
        Distance of the estimate from the parameter's bound on this side, in the estimator's coordinate (the logarithm
        of a positive parameter).
    """
    reached = objective.parameter.from_free(float(objective.z[objective.coordinate]) + sign * side.last_inside.s)
    if side.first_outside is None:
        bound = side.last_inside.s >= room
        side.limit = room if bound else float("nan")
        side.note = "reaches its bound" if bound else f"the data set no limit; the search ended at {reached:.4g}"
    elif np.isfinite(side.first_outside.drop):
        side.limit = side.crossing()[0]
    else:
        side.note = f"the likelihood cannot be evaluated beyond {reached:.4g}"


def _next_distance_outwards(objective: ConstrainedObjective, side: ProfileBranch, sign: int, target: float) -> float:
    """Return the distance from the estimate at which the next, more distant point of a profile is placed.

    The distance is in the estimator's coordinate (the logarithm of a positive parameter). The first distance comes from
    the curvature at the estimate. If the curvature is unknown, it is 1.5 for a logarithm, else the parameter's
    characteristic step (or a tenth of its value, or 1). Later ones extrapolate the points found so far; they are 1.25
    to 3 times the distance of the last point inside the interval. For a logarithm the distance grows by at most 1.5.

    Parameters
    ----------
    objective
        Objective with the parameter held.
    side
        Points of this side of the profile so far.
    sign
        -1 for the side below the estimate, 1 for the side above.
    target
        Drop of the log-likelihood that the next point should have.
    """
    last, logarithmic = side.last_inside, bool(objective.bounds.logarithmic[objective.coordinate])
    if last.s > 0.0:
        s = last.s * float(
            np.clip((target / max(last.drop, MIN_DROP)) ** (1.0 / side.growth_exponent), 1.25, MAX_GROWTH)
        )
    elif objective.curvature > 0.0:
        # solves g s + c s^2 / 2 = target; g is zero except for a parameter that is pushed against its bound
        g, c = max(-sign * objective.gradient, 0.0), objective.curvature
        s = 2.0 * target / (g + np.sqrt(g * g + 2.0 * c * target))
    else:
        p = objective.parameter
        s = MAX_LOG_STEP if logarithmic else p.step or 0.1 * abs(float(objective.z[objective.coordinate])) or 1.0
    return float(min(s, last.s + MAX_LOG_STEP) if logarithmic else s)


@dataclass(frozen=True)
class ProfilePoint:
    """One evaluated point of a profile likelihood: the held parameter's distance, and the refit of all others.

    Coordinates are the variables of the search: a parameter, or the logarithm of a positive parameter.

    Attributes
    ----------
    s : float
        Distance of the held coordinate from the estimate, at least 0 on both sides.
    drop : float
        Drop of the log-likelihood from its maximum; infinite if the likelihood is not finite.
    z : Array (n,)
        All coordinates: the held one, and the others at the values that were fitted again. If ``drop`` is infinite
        there was no refit, and ``z`` is the estimate.
    """

    s: float
    drop: float
    z: Array


@dataclass
class ProfileBranch:
    """One side of a profile likelihood: its points below or above the estimate, and the end of the 95 % interval there.

    A point is inside if the log-likelihood has dropped by less than 1.92, half of the 95 % quantile of chi-squared. The
    bracket is the interval between the last point inside and the first point outside; the end lies in it. Distances are
    in the estimator's coordinate (the logarithm of a positive parameter).

    Attributes
    ----------
    points
        All points so far, in order of distance from the estimate. The first one is the estimate.
    limit
        Distance of the end of the 95 % interval from the estimate; NaN if no end was found.
    note
        Remark about this end; empty if there is nothing to remark.
    bracket_widths
        Widths of the bracket so far, one for each call of `next_distance_in_bracket`.
    """

    points: list[ProfilePoint]
    limit: float = float("nan")
    note: str = ""
    bracket_widths: list[float] = field(default_factory=list)

    @property
    def points_inside(self) -> list[ProfilePoint]:
        """Points before the first one whose log-likelihood has dropped by 1.92 or more; the estimate is among them."""
        n = next((i for i, p in enumerate(self.points) if p.drop >= DROP_95), len(self.points))
        return self.points[:n]

    @property
    def last_inside(self) -> ProfilePoint:
        """Last point inside the 95 % interval; the estimate if there is no other."""
        return self.points_inside[-1]

    @property
    def first_outside(self) -> ProfilePoint | None:
        """First point at which the log-likelihood has dropped by 1.92 or more; None if no point has."""
        return next((p for p in self.points if p.drop >= DROP_95), None)

    @property
    def plotted_points(self) -> list[ProfilePoint]:
        """Points for a plot: those inside the 95 % interval, and the first one outside if its drop is finite.

        The estimate is not included.
        """
        return [*self.points_inside[1:], *[p for p in [self.first_outside] if p is not None and np.isfinite(p.drop)]]

    def add_point(self, point: ProfilePoint) -> None:
        """Insert an evaluated point into ``points``, in order of distance from the estimate.

        It comes after points at the same distance.
        """
        self.points = sorted([*self.points, point], key=lambda p: p.s)

    @property
    def growth_exponent(self) -> float:
        """Exponent a of ``drop ~ distance^a``, from the last two points inside the 95 % interval, limited to 0.25 to 2.

        It is 2 for a parabola, and less if the log-likelihood flattens out. It extrapolates to the next distance. The
        estimate counts as a point. The exponent is 2 if the first of the two points is the estimate or has a drop
        below 0.001. There must be at least two points inside.
        """
        before, last = self.points_inside[-2:]
        if before.drop < MIN_DROP or before.s == 0.0:
            return 2.0
        return float(np.clip(np.log(max(last.drop / before.drop, 1.0)) / np.log(last.s / before.s), 0.25, 2.0))

    def doubtful_drop(self, s: float) -> float:
        """Return the drop of the log-likelihood at distance ``s`` above which a refit is suspected to have failed.

        A refit can end at a local maximum that is not the highest. The threshold is four times the drop of a parabola
        through the last point inside the 95 % interval, whose drop counts as at least 0.15. It is four times 1.92 if
        the estimate is the only point inside. The caller repeats a suspect refit from other initial values.
        """
        last = self.last_inside
        return JUMP_RATIO * (max(last.drop, TARGET_DROPS[0]) * (s / last.s) ** 2 if last.s > 0 else DROP_95)

    def crossing(self) -> tuple[float, bool]:
        """Return the distance at which the log-likelihood has dropped by 1.92; and whether it is exact to 1 %.

        The distance is the end of the 95 % interval. The square root of the drop is nearly a straight line in the
        distance, so that it is interpolated. The result counts as exact if both points are within one per cent, or if
        their drops are between 0.96 and 3.84 and either the result is within one per cent of one of them or two
        interpolations agree: by a straight line, and by a monotone cubic through all points. The distance is the middle
        between the last point inside and the first point outside if these are within one per cent, or if the drop of
        the outer one is infinite. AssertionError is raised if no point outside exists.
        """
        inner, outer = self.last_inside, self.first_outside
        assert outer is not None
        if outer.s - inner.s < CROSSING_TOLERANCE * outer.s or not np.isfinite(outer.drop):
            return 0.5 * (inner.s + outer.s), outer.s - inner.s < CROSSING_TOLERANCE * outer.s
        line = [*self.points_inside, outer]
        root = np.sqrt(np.maximum([p.drop for p in line], 0.0))
        rising = np.maximum.accumulate(root) + 1e-12 * np.arange(len(line))
        from scipy.interpolate import PchipInterpolator  # imported here: only profiles need it

        at = float(PchipInterpolator(rising, [p.s for p in line])(np.sqrt(DROP_95)))
        chord = inner.s + (outer.s - inner.s) * (np.sqrt(DROP_95) - root[-2]) / (root[-1] - root[-2])
        smooth = inner.drop > DROP_95 / 2 and outer.drop < DROP_95 * 2
        close = min(at - inner.s, outer.s - at) < CROSSING_TOLERANCE * at
        return at, bool(smooth and (close or abs(at - chord) < CROSSING_TOLERANCE * at))

    def next_distance_in_bracket(self) -> float:
        """Return the distance of the next point: between the last one inside the 95 % interval and the first outside.

        A straight line through the square roots of the drops at both points reaches the root of 1.92 at this distance.
        If that line is a poor guess (the outer drop exceeds four times 1.92, or two points have not halved the
        bracket), the middle is taken (the geometric middle if the distances differ by more than a factor of four). With
        only the estimate inside, the distance is at most half of the outer one, and a tenth if the outer drop is
        infinite. The width between both points is appended to ``bracket_widths``. AssertionError is raised if no point
        outside exists.
        """
        inner, outer = self.last_inside, self.first_outside
        assert outer is not None
        low, high = inner.s, outer.s
        self.bracket_widths.append(high - low)
        if low == 0.0:
            guess = high * np.sqrt(DROP_95 / outer.drop) if np.isfinite(outer.drop) else 0.0
            return float(np.clip(guess, 0.01 * high, 0.5 * high) if guess else 0.1 * high)
        slow = len(self.bracket_widths) > 2 and self.bracket_widths[-1] > 0.5 * self.bracket_widths[-3]
        if outer.drop > 4 * DROP_95 or slow:
            return float(np.sqrt(low * high) if high > 4.0 * low else 0.5 * (low + high))
        root = np.sqrt(np.maximum([inner.drop, outer.drop], 0.0))
        share = (np.sqrt(DROP_95) - root[0]) / (root[1] - root[0])
        return float(low + (high - low) * np.clip(share, 0.1, 0.9))


class ConstrainedObjective:
    """Objective of a fit (log-posterior) as a function of one held coordinate, with all other coordinates fitted again.

    Coordinates are the variables of the search: a parameter, or the logarithm of a positive parameter.

    Parameters
    ----------
    problem
        Objective of the fit, a function of n coordinates.
    k
        Index of the held coordinate.
    z : Array (n,)
        Coordinates of the estimate, from which the profile starts.

    Attributes
    ----------
    problem : Problem
        Objective of the fit.
    coordinate : int
        Index of the held coordinate.
    parameter : Parameter
        Parameter of the held coordinate.
    bounds, other_bounds : Bounds
        Bounds of all coordinates, and of all except the held one.
    others : Array (n - 1,) of int
        Indices of all coordinates except the held one.
    z : Array (n,)
        Optimum from which the profile starts.
    top : float
        Objective at this optimum.
    best_found : tuple[float, Array]
        Best point of all that were evaluated, as (objective, coordinates).
    gradient, curvature : float
        First derivative and negative second derivative of the profile at the optimum, by the held coordinate. A
        curvature of zero means unknown.
    slope : Array (n - 1,)
        Derivatives of the fitted values of the other coordinates by the held one, at the optimum.
    flat : Array (n,)
        For coordinates whose likelihood is flat around the optimum: information (1 / variance) of a normal distribution
        whose 95 % interval is the width of the flat part. Zero for all other coordinates.
    """

    def __init__(self, problem: Problem, k: int, z: Array) -> None:
        """Hold coordinate k of the objective, and evaluate the objective at its optimum z (n,)."""
        self.problem, self.coordinate, self.bounds, self.parameter = problem, k, problem.bounds, problem.parameters[k]
        self.others = np.delete(np.arange(z.size), k)
        self.other_bounds = Bounds(
            self.bounds.low[self.others], self.bounds.high[self.others], self.bounds.logarithmic[self.others]
        )
        self._set_centre(z)

    def _set_centre(self, z: Array) -> None:
        """Make z (n,) the optimum from which the profile starts.

        Evaluate the objective there, and set the attributes that depend on it: the objective, its derivatives, the
        slopes of the other coordinates, and the coordinates whose likelihood is flat.
        """
        problem = self.problem
        self.z, at = z, problem.evaluate(z)
        flat = flat_coordinates(problem.value, z, problem.parameters, at.information, self.bounds)
        self.flat = np.zeros(z.size)
        self.flat[[p.coordinate for p in flat]] = [p.information for p in flat]
        self.top, self.best_found = at.value, (at.value, z)
        self.gradient = float(at.gradient[self.coordinate])
        self.curvature, self.slope = self._profile_curvature(with_interval_information(at, flat))

    def _profile_curvature(self, at: Evaluation) -> tuple[float, Array]:
        """Return the curvature of the profile at the optimum, and the slopes of the other coordinates (n - 1,).

        The curvature is the negative second derivative of the profile by the held coordinate (the Schur complement of
        the negative Hessian); zero means unknown, because it is within rounding. The slope of a coordinate is the
        derivative of its fitted value by the held coordinate. It is zero if the coordinate is at a bound beyond which
        the objective rises. ``at`` is the evaluation at the optimum.
        """
        H = at.hessian
        held = self.bounds.pushed_against(self.z, at.gradient)[self.others]
        moving = self.others[~held]
        follow = np.zeros(self.others.size)
        if moving.size:
            scale = np.sqrt(np.maximum(np.diag(H)[moving], 1e-300))
            right = H[moving, self.coordinate] / scale
            follow[~held] = (
                -np.linalg.lstsq(H[np.ix_(moving, moving)] / np.outer(scale, scale), right, rcond=1e-12)[0] / scale
            )
        curvature = float(H[self.coordinate, self.coordinate] + H[self.coordinate, self.others] @ follow)
        return (curvature if curvature > NULL_SPACE_TOLERANCE * H[self.coordinate, self.coordinate] else 0.0), follow

    def restart(self) -> bool:
        """Make the best point found so far the new optimum, if it is better. Return whether it is.

        It is better if its objective exceeds that of the present optimum by 0.01 or more. Before it becomes the
        optimum, it is improved by a search over all coordinates.
        """
        if self.best_found[0] < self.top + MIN_GAIN:
            return False
        self.release(self.best_found[1])
        self._set_centre(self.best_found[1])
        return True

    def release(self, z: Array) -> None:
        """Search for the maximum over all coordinates, the held one included, from z (n,).

        The result replaces ``best_found`` if its objective is larger.
        """
        top = maximise(self._evaluate_with_flat_information, z, self.bounds, max_iterations=40, tolerance=TOLERANCE)
        self.best_found = max(self.best_found, (top.at.value, top.z), key=lambda candidate: candidate[0])

    def best_point(self, s: float, sign: int, side: ProfileBranch) -> ProfilePoint:
        """Return the profile's point at distance ``s`` from the estimate, with all other coordinates fitted again.

        The refit starts at the coordinates of the nearest point inside the 95 % interval, or at these moved along the
        slopes at the optimum, whichever has the larger objective. If the drop of the log-likelihood is larger than
        expected, the refit is repeated from the optimum and from the nearest more distant point, and the smaller drop
        counts.

        Parameters
        ----------
        s
            Distance of the held coordinate from the estimate, positive, in the coordinate's unit.
        sign
            -1 for the side below the estimate, 1 for the side above.
        side
            Points of this side so far. It is not changed.
        """
        near, z_k = side.last_inside, float(self.z[self.coordinate]) + sign * s
        carried = near.z.copy()
        carried[self.others] += sign * (s - near.s) * self.slope
        point = self._refit_at_distance(s, z_k, (carried, near.z))
        if point.drop > side.doubtful_drop(s):
            again = self._refit_at_distance(
                s, z_k, (self.z, *[p.z for p in side.points if p.s > s and np.isfinite(p.drop)][:1])
            )
            point = min(point, again, key=lambda p: p.drop)
        return point

    def _refit_at_distance(self, s: float, z_k: float, starts: Iterable[Array]) -> ProfilePoint:
        """Hold the coordinate at a value, fit all others again, and return the point of the profile.

        ``best_found`` is replaced if the refit is better.

        Parameters
        ----------
        s
            Distance of ``z_k`` from the estimate. It is only copied to the result.
        z_k
            Value at which the coordinate is held.
        starts
            Coordinates (n,) from which the refit may start; the one with the largest objective is used. Their entry of
            the held coordinate is ignored. If the objective is finite at none of them, the drop of the result is
            infinite.
        """

        def whole(rest: Array) -> Array:
            """Insert the value ``z_k`` of the held coordinate into the others (n - 1,), and return all of them (n,)."""
            return np.insert(rest, self.coordinate, z_k)

        def evaluate(rest: Array) -> Evaluation:
            """Return the evaluation at the other coordinates (n - 1,), without the derivatives by the held one."""
            at, o = self._evaluate_with_flat_information(whole(rest)), self.others
            return Evaluation(at.value, at.gradient[o], at.information[np.ix_(o, o)], at.curvature[o])

        tried = [
            (at.value, rest)
            for rest in (self.other_bounds.clip(z[self.others]) for z in starts)
            if (at := evaluate(rest)).finite
        ]
        if not tried:
            return ProfilePoint(s, np.inf, self.z)
        value, rest = max(tried, key=lambda candidate: candidate[0])
        if rest.size:
            found: Optimum = maximise(evaluate, rest, self.other_bounds, max_iterations=40, tolerance=TOLERANCE * 100)
            value, rest = found.at.value, found.z
        self.best_found = max(self.best_found, (value, whole(rest)), key=lambda candidate: candidate[0])
        return ProfilePoint(s, self.top - value, whole(rest))

    def _evaluate_with_flat_information(self, z: Array) -> Evaluation:
        """Return the evaluation at z (n,), with enough information in the coordinates whose likelihood is flat.

        Where the information plus the curvature of such a coordinate is less than its entry in ``flat``, the curvature
        is increased, so that the sum is equal to the entry. With less information the search would take a very long
        step along this coordinate.
        """
        at = self.problem.evaluate(z)
        return Evaluation(
            at.value, at.gradient, at.information, np.maximum(at.curvature, self.flat - np.diag(at.information))
        )
