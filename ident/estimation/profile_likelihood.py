"""Profile likelihood: the log-likelihood over one parameter, all others refitted, and the 95 % interval by its drop.

From the estimate the parameter is moved outwards until the log-likelihood has dropped by 1.92, half of the 95 %
quantile of chi-squared (Pawitan 2001, section 3.4). Neither half of that can be taken on trust. A refit from a bad
place ends in another valley, or at a bound: each begins at the best of several places, and a drop that jumps is tried
from more. The distance of the first point is a guess from the curvature: what lies too far out, or where the likelihood
is not finite, only closes a bracket, which is then narrowed until the crossing is known to a hundredth of its distance.
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

TARGET_DROPS = (0.15, 0.6, 1.3, 2.4)  # of the log-likelihood that points aim at, either way; the interval ends at 1.92
MAX_OUTWARD_POINTS = 12  # either way, before that side of the interval is left open
MAX_BRACKET_POINTS = 14  # between the last point inside and the first outside
MAX_GROWTH = 3.0  # of the distance from point to point, where the drop lags behind its target
MAX_LOG_STEP = 1.5  # of a logarithm from point to point: a factor 4.5
MIN_DROP = 1e-3  # of the log-likelihood: less is within the tolerance of a refit
CROSSING_TOLERANCE = 0.01  # of its distance: how well the end of the interval is known
JUMP_RATIO = 4.0  # of a drop to that of a parabola through the last point: a bad refit, or a cliff
MIN_GAIN = 0.01  # of the log-likelihood: another optimum, and no rounding
N_RESTARTS = 4  # of the profile from better optima


@dataclass(frozen=True)
class Profile:
    """A parameter's profile in its own unit; ``name`` as in ``Fit.names`` (``V_x@0``: of record 0).

    value: the estimate (where noise was restricted, that of the likelihood's own maximum), or that of a better fit met
    on the way, which a note then tells; grid (n,) increasing, drop
    (n,) of the log-likelihood there (zero at ``value``); low, high: the 95 % interval, to about a hundredth, NaN where
    a side is open; wald_low, wald_high: the fit's value +- 1.96 standard errors (of the logarithm for a parameter that
    is estimated as one), NaN where there is none; notes: what to know.
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
    """The profile of one estimated parameter, on a grid that finds its own range.

    ``records``: those of the fit. A parameter that every record has for itself is named ``NAME@K``; ``NAME`` will do
    where there is one record. Raises ValueError where the fit did not estimate it.
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
    if fit.options.reml:  # its noise is not that of the maximum, and the profile is of the likelihood
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
            f"a better fit was found on the way, by {line.found[0] - before:.2g}, and the profile is of that: "
            "fit again from there"
        )
    error = fit.errors[line.k] / np.abs(line.parameter.slope(fit.values[line.k]))
    return _gathered(line, full, sides, [estimate[line.k] + sign * Z_95 * error for sign in (-1, 1)], notes)


def _sides(line: ConstrainedObjective) -> list[ProfileBranch]:
    return [trace_profile(line, sign) for sign in (-1, 1)]


def _problem(fit: Fit, records: Sequence[Record], threads: int) -> Problem:
    """The fit's objective; raises ValueError where it cannot be of these records."""
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
    """One side (``sign`` is -1 or 1), until the crossing is known, a bound is reached or the patience is at an end. It
    breaks off where the line is better than its centre."""
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
            line.release(point.z)  # behind a ridge, with a summit of its own
        side.add(point)
    _end(line, sign, side, room)
    return side


def _end(line: ConstrainedObjective, sign: int, side: ProfileBranch, room: float) -> None:
    reached = line.parameter.from_free(float(line.z[line.k]) + sign * side.inner.s)
    if side.outer is None:
        bound = side.inner.s >= room
        side.limit = room if bound else float("nan")
        side.note = "reaches its bound" if bound else f"the data set no limit as far as was looked, to {reached:.4g}"
    elif np.isfinite(side.outer.drop):
        side.limit = side.crossing()[0]
    else:
        side.note = f"the likelihood cannot be evaluated beyond {reached:.4g}"


def _outwards(line: ConstrainedObjective, side: ProfileBranch, sign: int, target: float) -> float:
    """Where the drop should reach the target: from the curvature at first, then from the points so far."""
    last, logarithmic = side.inner, bool(line.bounds.logarithmic[line.k])
    if last.s > 0.0:
        s = last.s * float(np.clip((target / max(last.drop, MIN_DROP)) ** (1.0 / side.power), 1.25, MAX_GROWTH))
    elif line.curvature > 0.0:
        # g s + c s^2 / 2 = target; g is zero but for a parameter that is pushed against its bound
        g, c = max(-sign * line.gradient, 0.0), line.curvature
        s = 2.0 * target / (g + np.sqrt(g * g + 2.0 * c * target))
    else:
        p = line.parameter
        s = MAX_LOG_STEP if logarithmic else p.step or 0.1 * abs(float(line.z[line.k])) or 1.0
    return float(min(s, last.s + MAX_LOG_STEP) if logarithmic else s)


@dataclass(frozen=True)
class ProfilePoint:
    """At the distance ``s`` from the estimate the likelihood is lower by ``drop`` (infinite: it is not a number), with
    all coordinates at ``z`` (n,)."""

    s: float
    drop: float
    z: Array


@dataclass
class ProfileBranch:
    """Points on one side, by distance from the estimate, and how it ended: ``limit``, the distance of the end of the 95
    % interval (NaN: open), and a ``note``."""

    points: list[ProfilePoint]
    limit: float = float("nan")
    note: str = ""
    narrowed: list[float] = field(default_factory=list)  # widths of the bracket

    @property
    def inside(self) -> list[ProfilePoint]:
        """The points before the first that is too far."""
        n = next((i for i, p in enumerate(self.points) if p.drop >= DROP_95), len(self.points))
        return self.points[:n]

    @property
    def inner(self) -> ProfilePoint:
        return self.inside[-1]

    @property
    def outer(self) -> ProfilePoint | None:
        """The first point that is too far."""
        return next((p for p in self.points if p.drop >= DROP_95), None)

    @property
    def shown(self) -> list[ProfilePoint]:
        """All but those further out, which only closed the bracket."""
        return [*self.inside[1:], *[p for p in [self.outer] if p is not None and np.isfinite(p.drop)]]

    def add(self, point: ProfilePoint) -> None:
        self.points = sorted([*self.points, point], key=lambda p: p.s)

    @property
    def power(self) -> float:
        """With which the drop grows at the end of the points inside: 2 for a parabola, less where it flattens out."""
        before, last = self.inside[-2:]
        if before.drop < MIN_DROP or before.s == 0.0:
            return 2.0
        return float(np.clip(np.log(max(last.drop / before.drop, 1.0)) / np.log(last.s / before.s), 0.25, 2.0))

    def expected(self, s: float) -> float:
        """The drop at ``s`` above which something is odd: that of a parabola through the last point, many times."""
        last = self.inner
        return JUMP_RATIO * (max(last.drop, TARGET_DROPS[0]) * (s / last.s) ** 2 if last.s > 0 else DROP_95)

    def crossing(self) -> tuple[float, bool]:
        """The distance at which the drop is 1.92, and whether that is exact enough; the root of the drop is nearly a
        straight line in the distance."""
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
        """The next distance within the bracket: where the root of the drop, as a straight line, crosses; but the middle
        (by ratio, where it spans more than that) where the line is a bad guess."""
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
    """The objective with coordinate ``k`` held, the others at their best.

    ``found``: the best of all that was met on the way, as (objective, coordinates).
    """

    def __init__(self, problem: Problem, k: int, z: Array) -> None:
        self.problem, self.k, self.bounds, self.parameter = problem, k, problem.bounds, problem.parameters[k]
        self.others = np.delete(np.arange(z.size), k)
        self.rest = Bounds(
            self.bounds.low[self.others], self.bounds.high[self.others], self.bounds.logarithmic[self.others]
        )
        self._centre(z)

    def _centre(self, z: Array) -> None:
        problem = self.problem
        self.z, at = z, problem.evaluate(z)
        flat = flat_coordinates(problem.value, z, problem.parameters, at.information, self.bounds)
        self.flat = np.zeros(z.size)
        self.flat[[p.at for p in flat]] = [p.information for p in flat]
        self.top, self.found = at.value, (at.value, z)
        self.gradient = float(at.gradient[self.k])
        self.curvature, self.slope = self._curvature(with_interval_information(at, flat))

    def _curvature(self, at: Evaluation) -> tuple[float, Array]:
        """Of the profile at the top (zero: not known), and how the other coordinates follow (n - 1,); those at a bound
        do not."""
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
        """Whether a better optimum was met on the way; the line then goes through that."""
        if self.found[0] < self.top + MIN_GAIN:
            return False
        self.release(self.found[1])
        self._centre(self.found[1])
        return True

    def release(self, z: Array) -> None:
        """Climb from there with all coordinates free."""
        top = maximise(self._flattened, z, self.bounds, max_iterations=40, tolerance=TOLERANCE)
        self.found = max(self.found, (top.at.value, top.z), key=lambda one: one[0])

    def best(self, s: float, sign: int, side: ProfileBranch) -> ProfilePoint:
        """The best at one distance: from the nearest good point, as it is or as the others followed at the top; where
        the drop jumps, also from the optimum and from the nearest point beyond."""
        near, z_k = side.inner, float(self.z[self.k]) + sign * s
        carried = near.z.copy()
        carried[self.others] += sign * (s - near.s) * self.slope
        point = self._refitted(s, z_k, (carried, near.z))
        if point.drop > side.expected(s):
            again = self._refitted(s, z_k, (self.z, *[p.z for p in side.points if p.s > s and np.isfinite(p.drop)][:1]))
            point = min(point, again, key=lambda p: p.drop)
        return point

    def _refitted(self, s: float, z_k: float, starts: Iterable[Array]) -> ProfilePoint:
        """From the best of the starts."""

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
        value, rest = max(tried, key=lambda one: one[0])
        if rest.size:
            found: Optimum = maximise(evaluate, rest, self.rest, max_iterations=40, tolerance=TOLERANCE * 100)
            value, rest = found.at.value, found.z
        self.found = max(self.found, (value, whole(rest)), key=lambda one: one[0])
        return ProfilePoint(s, self.top - value, whole(rest))

    def _flattened(self, z: Array) -> Evaluation:
        """A coordinate on a plateau has no less information than that gives it: with none it would be flung away."""
        at = self.problem.evaluate(z)
        return Evaluation(
            at.value, at.gradient, at.information, np.maximum(at.curvature, self.flat - np.diag(at.information))
        )
