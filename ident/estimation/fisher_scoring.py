"""Damped Fisher scoring inside bounds, and the objective of a fit.

Fisher scoring makes Gauss-Newton steps with the expected information as the Hessian. The damping is Levenberg's, with
Nielsen's rule for its size (Madsen, Nielsen and Tingleff 2004, section 3.2). A step that would leave the bounds ends on
them, and its rest is solved again. A step to a value that is not finite is rejected.

The objective of a fit (`Problem`) is the log-likelihood plus the log-prior, over the free coordinates.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data import Record
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.numerics import Array

Flags = NDArray[np.bool_]
LARGEST_STEP = 1.5  # largest change of a parameter's logarithm in one iteration: a factor 4.5
# If such a step changes the log-likelihood by less than this, the coordinate must not shorten the steps of the others.
FLAT_CHANGE = 0.5
MAX_DAMPING = 1e12  # relative to the Hessian's diagonal; with more damping no step remains
DIVERGENCE_LIMIT = 1e30  # information above this is not possible: the simulation has diverged
# If a step increases the information by more than this factor (median over the coordinates), the simulation is about
# to diverge.
MAX_SENSITIVITY_RATIO = 1e6
DAMPING_FLOOR = 1e-4  # least damping of a coordinate, relative to the largest information that it had so far
LBFGSB_TOLERANCE = 0.05  # L-BFGS-B ends if a step gains less than this share of the fit's tolerance
QUADRATIC_GAIN = 3.0  # the objective is nearly quadratic if a step gains less log-likelihood than this
ROUNDING = 1e-12  # relative tolerance in the comparison with a bound: z + (bound - z) may differ from the bound
MAX_BFGS_PAIRS = 12  # largest number of steps in a BFGS correction


@dataclass(frozen=True)
class Evaluation:
    """Objective and its derivatives at a point. The objective is maximised.

    Attributes
    ----------
    value
        The objective.
    gradient : Array (n,)
        Its gradient.
    information : Array (n, n)
        Its expected information.
    curvature : Array (n,)
        What has to be added to the information's diagonal to get that of the negative Hessian; zero if unknown.
    """

    value: float
    gradient: Array
    information: Array
    curvature: Array

    @property
    def hessian(self) -> Array:
        """Best approximation of the negative Hessian (n, n); positive semidefinite."""
        return self.information + np.diag(self.curvature)

    @property
    def finite(self) -> bool:
        """Whether the values are finite, so that a search can continue from this point."""
        numbers = np.isfinite(self.value) and np.isfinite(self.gradient).all() and np.isfinite(self.information).all()
        return bool(numbers and np.diag(self.information).max(initial=0.0) < DIVERGENCE_LIMIT)


@dataclass(frozen=True)
class Bounds:
    """Bounds of the coordinates.

    Attributes
    ----------
    low, high : Array (n,)
        Lower and upper bounds.
    logarithmic : Array (n,) of bool
        Whether the coordinate is a logarithm. Steps of logarithms are limited.
    """

    low: Array
    high: Array
    logarithmic: Flags

    def clip(self, z: Array) -> Array:
        """Return the coordinates z (n,) clipped to the bounds."""
        return np.clip(z, self.low, self.high)

    def held(self, z: Array, gradient: Array) -> Flags:
        """Return which coordinates are at a bound and have a gradient that points out of it."""
        low, high = self.reached(z)
        return np.asarray((low & (gradient < 0)) | (high & (gradient > 0)))

    def reached(self, z: Array) -> tuple[Flags, Flags]:
        """Return which coordinates are at their lower and which at their upper bound, within rounding."""
        near = [ROUNDING * np.where(np.isfinite(bound), np.abs(bound), 0.0) for bound in (self.low, self.high)]
        return np.asarray(z <= self.low + near[0]), np.asarray(z >= self.high - near[1])


@dataclass(frozen=True)
class Optimum:
    """End point of a search.

    Attributes
    ----------
    z : Array (n,)
        Coordinates.
    at
        Objective and derivatives there.
    iterations, evaluations
        Effort of the search.
    gain_left
        Expected gain of one more step.
    """

    z: Array
    at: Evaluation
    iterations: int
    evaluations: int
    gain_left: float


Evaluate = Callable[[Array], Evaluation]
Iterations = Callable[[int, float], None]  # called with the number and the objective of each iteration


@dataclass
class BfgsCorrection:
    """Correction of the expected information near the optimum, from steps and the changes of the gradient along them.

    Each step corrects the Hessian in its direction by a BFGS update (Nocedal and Wright 2006, eq. 6.19).

    Attributes
    ----------
    largest : Array (n,)
        Largest diagonal of the Hessian so far. At a kink, such as the end of a dead zone between two samples, a
        coordinate loses its information. If its damping were relative to what remains, its next step would reach its
        bounds (Moré 1978, section 5).
    pairs
        Steps (n,) and changes of the gradient (n,).
    """

    largest: Array
    pairs: list[tuple[Array, Array]] = field(default_factory=list)

    def add(self, step: Array, before: Evaluation, after: Evaluation) -> None:
        """Add a step. Forget all steps if this one gained so much that the objective is not quadratic yet."""
        self.largest = np.maximum(self.largest, np.diag(after.hessian))
        if after.value - before.value > QUADRATIC_GAIN:
            self.pairs.clear()
            return
        self.pairs = [*self.pairs[1 - MAX_BFGS_PAIRS :], (step, before.gradient - after.gradient)]

    def holds(self, trial: Evaluation) -> bool:
        """Return whether the sensitivities at a trial point have the same order of magnitude as before.

        Just before a simulation diverges, its value may be finite and even better. Its sensitivities have diverged
        already, so that the remaining gain appears to be zero.
        """
        known = self.largest > 0.0
        if not known.any():
            return True
        return bool(np.median(np.diag(trial.information)[known] / self.largest[known]) < MAX_SENSITIVITY_RATIO)

    def hessian(self, at: Evaluation) -> Array:
        """Return the corrected negative Hessian (n, n) at a point."""
        H = at.hessian
        for s, y in self.pairs:
            Hs = H @ s
            old, new = float(s @ Hs), float(s @ y)
            if old > 0 and 0.05 * old < new < 20.0 * old:
                H = H - np.outer(Hs, Hs) / old + np.outer(y, y) / new
        return H


def solve_step(at: Evaluation, H: Array, z: Array, bounds: Bounds, damping: float, least: Array | float = 0.0) -> Array:
    """Return the damped step, which ends on the bounds if it would cross them.

    Coordinates without any information do not move. No logarithm moves by more than ``LARGEST_STEP``; otherwise the
    whole step is shortened. A logarithm that hardly changes the objective is an exception: it alone is limited, and the
    step of the others is solved with it. Otherwise a noise parameter that the data do not inform would ask for a very
    long step and shorten those of all others to almost zero.

    Parameters
    ----------
    at
        Objective and derivatives at ``z``.
    H : Array (n, n)
        Negative Hessian.
    z : Array (n,)
        Coordinates.
    bounds
        Their bounds.
    damping
        Damping relative to the diagonal of ``H``.
    least : Array (n,) or float
        The least value of that diagonal in the damping.

    Returns
    -------
    Array (n,)
        The step.
    """
    change = LARGEST_STEP * np.abs(at.gradient) + 0.5 * LARGEST_STEP**2 * np.diag(H)
    reach = np.where(bounds.logarithmic & (change < FLAT_CHANGE), LARGEST_STEP, np.inf)
    low, high = np.maximum(bounds.low - z, -reach), np.minimum(bounds.high - z, reach)
    fixed = bounds.held(z, at.gradient) | (np.diag(H) <= 0.0)
    size = np.maximum(np.diag(H), 1e-300)
    H = H + damping * np.diag(np.maximum(size, least))
    step = np.zeros(z.size)
    for _ in range(z.size + 1):
        free = ~fixed
        if not free.any():
            break
        right = at.gradient[free] - H[np.ix_(free, fixed)] @ step[fixed]
        scale = np.sqrt(size[free])
        scaled = H[np.ix_(free, free)] / np.outer(scale, scale)
        step[free] = np.linalg.lstsq(scaled, right / scale, rcond=1e-13)[0] / scale
        crossing = free & ((step < low) | (step > high))
        if not crossing.any():
            break
        # Only the first bound is applied: with its coordinate held, the others may not cross their bounds.
        room = np.where(step < 0, -low, high)
        first = int(np.argmin(np.where(crossing, room / np.maximum(np.abs(step), 1e-300), np.inf)))
        step[first] = np.clip(step[first], low[first], high[first])
        fixed[first] = True
    largest = np.abs(step[bounds.logarithmic]).max(initial=0.0)
    return step * min(1.0, LARGEST_STEP / largest) if largest > 0 else step


def expected_gain(at: Evaluation, H: Array, step: Array) -> float:
    """Return the gain of the objective that the quadratic approximation predicts for a step (n,)."""
    return float(at.gradient @ step - 0.5 * step @ H @ step)


def remaining_gain(at: Evaluation, H: Array, z: Array, bounds: Bounds) -> float:
    """Return the expected gain of an undamped step."""
    return expected_gain(at, H, solve_step(at, H, z, bounds, 0.0))


def maximise(
    evaluate: Evaluate,
    z: Array,
    bounds: Bounds,
    *,
    max_iterations: int,
    tolerance: float,
    progress: Iterations | None = None,
) -> Optimum:
    """Maximise an objective from ``z`` by damped Fisher scoring.

    The search ends if a full step is expected to gain less than ``tolerance``. It also ends if no step gains anything,
    neither with the corrected Hessian nor with the expected information alone.

    Parameters
    ----------
    evaluate
        The objective with its derivatives; finite at the start.
    z : Array (n,)
        Start.
    bounds
        Bounds of the coordinates.
    max_iterations
        Largest number of iterations.
    tolerance
        Expected gain below which the search ends.
    progress
        Called in each iteration.
    """
    z = bounds.clip(z)
    at = evaluate(z)
    correction = BfgsCorrection(np.diag(at.hessian))
    evaluations, damping, growth = 1, 1e-3, 2.0
    for iteration in range(max_iterations):
        if progress is not None:
            progress(iteration, at.value)
        H = correction.hessian(at)
        gain_left = remaining_gain(at, H, z, bounds)
        if abs(gain_left) < tolerance:
            return Optimum(z, at, iteration, evaluations, gain_left)
        while True:
            step = solve_step(at, H, z, bounds, damping, DAMPING_FLOOR * correction.largest)
            expected = expected_gain(at, H, step)
            trial = evaluate(bounds.clip(z + step))
            evaluations += 1
            gained = trial.value - at.value if trial.finite and correction.holds(trial) else -np.inf
            if gained > max(1e-4 * expected, 0.0):
                ratio = min(gained / max(expected, 1e-300), 1.0)
                damping, growth = max(damping * max(1 / 10, 1 - (2 * ratio - 1) ** 3), 1e-12), 2.0
                correction.add(bounds.clip(z + step) - z, at, trial)
                z, at = bounds.clip(z + step), trial
                break
            damping, growth = damping * growth, growth * 2
            if damping > MAX_DAMPING or growth > 2.0**12:
                if not correction.pairs:
                    return Optimum(z, at, iteration + 1, evaluations, gain_left)
                # Steps as small as rounding, or across a kink, have spoiled the correction: continue without it.
                correction.pairs.clear()
                damping, growth = 1e-3, 2.0
                break
    return Optimum(z, at, max_iterations, evaluations, remaining_gain(at, correction.hessian(at), z, bounds))


def refine_lbfgsb(
    value_and_gradient: Callable[[Array], tuple[float, Array]],
    start: Optimum,
    bounds: Bounds,
    evaluate: Evaluate,
    tolerance: float,
) -> Optimum:
    """Continue a search by L-BFGS-B with the exact gradient, if Fisher scoring makes no progress.

    The coordinates are scaled by the information. The search ends if a step gains a small share of the ``tolerance``,
    so that a rough fit does not spend hundreds of steps on it.

    Parameters
    ----------
    value_and_gradient
        The objective and its gradient (n,).
    start
        Point at which Fisher scoring ended.
    bounds
        Bounds of the coordinates.
    evaluate
        The objective with all derivatives.
    tolerance
        Tolerance of the fit.

    Returns
    -------
    Optimum
        The start, if no better point was found.
    """
    from scipy import optimize  # imported here: it takes half a second and is seldom needed

    size = np.sqrt(np.maximum(np.diag(start.at.hessian), 1e-12))

    def negative(w: Array) -> tuple[float, Array]:
        value, gradient = value_and_gradient(bounds.clip(w / size))
        finite = np.isfinite(value) and bool(np.isfinite(gradient).all())
        return (-value, -gradient / size) if finite else (1e30, np.zeros(size.size))

    relative = LBFGSB_TOLERANCE * tolerance / max(abs(start.at.value), 1.0)  # L-BFGS-B takes it relative to the value
    limits = optimize.Bounds(bounds.low * size, bounds.high * size)
    found = optimize.minimize(
        negative,
        start.z * size,
        jac=True,
        method="L-BFGS-B",
        bounds=limits,
        options={"maxiter": 200, "maxcor": 30, "ftol": max(1e-14, relative), "gtol": 1e-6},
    )
    z = bounds.clip(found.x / size)
    at = evaluate(z)
    spent = start.evaluations + int(found.nfev) + 1
    if not at.finite or at.value < start.at.value:
        return Optimum(start.z, start.at, start.iterations, spent, start.gain_left)
    left = remaining_gain(at, at.hessian, z, bounds)
    return Optimum(z, at, start.iterations + int(found.nit), spent, left)


T = TypeVar("T")


class Problem:
    """Objective of a fit: log-posterior of the free parameters, given records.

    A per-record parameter has one coordinate for each record.

    Parameters
    ----------
    likelihood
        Likelihood of the model.
    records
        The records.
    free
        Names of the parameters to be estimated.
    threads
        Number of records that are evaluated at once.
    begin
        Initial values of per-record parameters (``V_x@0``) that differ from the model's.
    """

    def __init__(
        self,
        likelihood: Likelihood,
        records: Sequence[Record],
        free: Sequence[str],
        threads: int,
        begin: Mapping[str, float] | None = None,
    ) -> None:
        self.likelihood, self.records, self.begin = likelihood, tuple(records), begin or {}
        model = self.model = likelihood.model
        index = {p.name: i for i, p in enumerate(model.parameters)}
        shared = [n for n in free if not model.parameter(n).per_record]
        own = [n for n in free if model.parameter(n).per_record]
        self.free = (*shared, *own)
        copies = [replace(model.parameter(n), segment=i) for i in range(len(records)) for n in own]
        self.parameters = (*(model.parameter(n) for n in shared), *copies)
        self.names = tuple(p.full_name for p in self.parameters)
        # columns[k]: index of coordinate k's parameter in model.parameters
        # places[i]: indices of record i's free parameters among the coordinates
        self.columns = [index[p.name] for p in self.parameters]
        first = len(shared)
        self.places = [
            [*range(first), *range(first + i * len(own), first + (i + 1) * len(own))] for i in range(len(records))
        ]
        self.base = np.array([p.value for p in model.parameters])
        self.threads = max(1, min(threads, len(records)))
        self._last_values: dict[int, tuple[Array, float]] = {}  # by record: values and result of the last `value`

    @cached_property
    def bounds(self) -> Bounds:
        """Bounds of the coordinates."""
        low, high = np.array([p.free_bounds() for p in self.parameters]).reshape(-1, 2).T
        return Bounds(low, high, np.array([p.transform == "log" for p in self.parameters], dtype=bool))

    @property
    def start(self) -> Array:
        """Initial coordinates (n,)."""
        own = zip(self.names, self.parameters, strict=True)
        return np.array([p.to_free(self.begin.get(name, p.value)) for name, p in own])

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Mean and information of each coordinate's prior (n,); the information is zero without a prior."""
        given = [p.free_prior() for p in self.parameters]
        mean = np.array([g[0] if g else 0.0 for g in given])
        return mean, np.array([1.0 / g[1] ** 2 if g else 0.0 for g in given])

    def values(self, z: Array) -> Array:
        """Return the values of all parameters for each record (n_records, n_parameters), in their own units."""
        own = self.own(z)
        out = np.tile(self.base, (len(self.records), 1))
        for i, places in enumerate(self.places):
            out[i, [self.columns[k] for k in places]] = own[places]
        return out

    def own(self, z: Array) -> Array:
        """Return the values of the free parameters in their own units (n,).

        They are clipped to their bounds again, since logarithms are rounded.
        """
        return np.array([np.clip(p.from_free(float(c)), *p.bounds) for p, c in zip(self.parameters, z, strict=True)])

    def slopes(self, z: Array) -> Array:
        """Return the derivative of each parameter by its coordinate (n,)."""
        return np.array([p.slope(p.from_free(float(c))) for p, c in zip(self.parameters, z, strict=True)])

    def evaluate(self, z: Array) -> Evaluation:
        """Return log-posterior, gradient and information by the coordinates.

        The information includes that of the priors.
        """
        mean, weight = self.prior
        value = 0.0
        gradient, information = np.zeros(z.size), np.zeros((z.size, z.size))
        rows = self._map(lambda i, v: self.likelihood.scores(self.records[i], v, self.free), z)
        slope = self.slopes(z)
        for places, scores in zip(self.places, rows, strict=True):
            value += scores.value
            gradient[places] += slope[places] * scores.gradient
            information[np.ix_(places, places)] += np.outer(slope[places], slope[places]) * scores.information
        # The logarithm of a standard deviation s near zero: ln L ~ -c s^2, whose second derivative by ln s is twice
        # the first. The expected information is of the order s^4; a step of the prior alone would overshoot.
        twice = np.where(self.bounds.logarithmic, 2.0 * np.maximum(-gradient, 0.0), 0.0)
        curvature = np.maximum(twice - np.diag(information), 0.0)
        value -= 0.5 * float(weight @ (z - mean) ** 2)
        return Evaluation(value, gradient - weight * (z - mean), information + np.diag(weight), curvature)

    def information(self, z: Array, which: NDArray[np.intp]) -> Array:
        """Return the information of some coordinates (n_which, n_which), with that of their priors.

        It costs less than the information of all.
        """
        slope, selected, n = self.slopes(z), set(which.tolist()), len(self.free)
        total = np.diag(self.prior[1])

        def chosen(i: int) -> list[int]:
            return [k for k in range(n) if self.places[i][k] in selected]

        rows = self._map(lambda i, v: self.likelihood.scores(self.records[i], v, [self.free[k] for k in chosen(i)]), z)
        for i, scores in enumerate(rows):
            at = [self.places[i][k] for k in chosen(i)]
            total[np.ix_(at, at)] += np.outer(slope[at], slope[at]) * scores.information
        return total[np.ix_(which, which)]

    def value(self, z: Array) -> float:
        """Return the log-posterior.

        A record whose values are the same as in the last call is not evaluated again. If only a per-record parameter
        changes, a single record is evaluated.
        """

        def work(i: int, v: Array) -> float:
            """Return the log-likelihood of record i, from the last call if its values are the same."""
            last, known = self._last_values.get(i, (None, 0.0))
            if last is None or not np.array_equal(last, v):
                known = self.likelihood.value(self.records[i], v)
                self._last_values[i] = v, known
            return known

        mean, weight = self.prior
        return sum(self._map(work, z), -0.5 * float(weight @ (z - mean) ** 2))

    def value_and_gradient(self, z: Array) -> tuple[float, Array]:
        """Return the log-posterior and its gradient (n,), by the adjoint filter."""
        mean, weight = self.prior
        value, gradient = -0.5 * float(weight @ (z - mean) ** 2), -weight * (z - mean)
        slope = self.slopes(z)
        rows = self._map(lambda i, v: self.likelihood.gradient(self.records[i], v), z)
        for places, (ll, by_parameter) in zip(self.places, rows, strict=True):
            value += ll
            gradient[places] += slope[places] * by_parameter[[self.columns[k] for k in places]]
        return value, gradient

    def by_row(self, z: Array) -> list[tuple[list[int], Array]]:
        """Return for each record the indices of its coordinates and the contribution of each row to their gradient."""
        slope = self.slopes(z)
        rows = self._map(lambda i, v: self.likelihood.scores(self.records[i], v, self.free, by_row=True), z)
        return [
            (places, slope[places] * scores.by_row)
            for places, scores in zip(self.places, rows, strict=True)
            if scores.by_row is not None
        ]

    def check(self, z: Array) -> None:
        """Raise ValueError if a record cannot be evaluated; the message names the first one."""
        for record, values in zip(self.records, self.values(z), strict=True):
            if not np.isfinite(self.likelihood.value(record, values)):
                raise ValueError(
                    f"record {record.name}: the likelihood of model {self.model.name} cannot be "
                    "evaluated at the initial values"
                )

    def _map(self, work: Callable[[int, Array], T], z: Array) -> list[T]:
        """Return ``work(i, values)`` for each record i, in threads."""
        values = self.values(z)
        if self.threads == 1:
            return [work(i, v) for i, v in enumerate(values)]
        with ThreadPoolExecutor(self.threads) as pool:  # the kernels release Python's global lock
            return list(pool.map(work, range(len(values)), values))
