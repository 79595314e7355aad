"""Damped Fisher scoring inside bounds, and the objective of a fit.

Coordinates are the variables of the search: a parameter, or the logarithm of a positive parameter.

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
# From this number of rejected steps on, the value of a step is computed before its derivatives, which take ten times as
# long. Most searches reject no step, and need no compiled function of the value alone.
FEWEST_REJECTED = 1


@dataclass(frozen=True)
class Evaluation:
    """Value and derivatives of an objective that is maximised, at one point of the search.

    The point has n coordinates: the variables of the search, each a parameter or the logarithm of a positive parameter.

    Attributes
    ----------
    value : float
        Objective: log-likelihood plus log-prior.
    gradient : Array (n,)
        Derivatives of the objective by the coordinates.
    information : Array (n, n)
        Expected Fisher information, plus the information of the priors.
    curvature : Array (n,)
        Addition to the diagonal of the information, at least 0, that makes it closer to the negative Hessian; zero if
        unknown.
    """

    value: float
    gradient: Array
    information: Array
    curvature: Array

    @property
    def hessian(self) -> Array:
        """Approximation of the negative Hessian (n, n): information plus curvature; positive semidefinite."""
        return self.information + np.diag(self.curvature)

    @property
    def finite(self) -> bool:
        """Whether a search can continue from this point.

        It can if all values are finite and the largest diagonal element of the information is below 1e30.
        """
        numbers = np.isfinite(self.value) and np.isfinite(self.gradient).all() and np.isfinite(self.information).all()
        return bool(numbers and np.diag(self.information).max(initial=0.0) < DIVERGENCE_LIMIT)


@dataclass(frozen=True)
class Bounds:
    """Bounds of the coordinates: of the variables of a search, each a parameter or the logarithm of one.

    Attributes
    ----------
    low, high : Array (n,)
        Lower and upper bounds; infinite for a coordinate without a bound.
    logarithmic : Array (n,) of bool
        Whether the coordinate is the logarithm of a parameter. One step of Fisher scoring changes a logarithm by at
        most 1.5.
    """

    low: Array
    high: Array
    logarithmic: Flags

    def clip(self, z: Array) -> Array:
        """Return a copy of the coordinates z (n,), each clipped to its bounds."""
        return np.clip(z, self.low, self.high)

    def pushed_against(self, z: Array, gradient: Array) -> Flags:
        """Return for each coordinate whether it is at a bound and the objective rises beyond this bound (n,).

        The search must hold such a coordinate.

        Parameters
        ----------
        z : Array (n,)
            Coordinates.
        gradient : Array (n,)
            Derivatives at z of the objective, which is maximised.
        """
        low, high = self.reached(z)
        return np.asarray((low & (gradient < 0)) | (high & (gradient > 0)))

    def reached(self, z: Array) -> tuple[Flags, Flags]:
        """Return whether each coordinate of z (n,) is at its lower bound, and at its upper bound: two arrays (n,).

        A coordinate counts as at a bound if it is on the bound or beyond it, or nearer to it than 1e-12 times the size
        of the bound, for rounding. For a bound of zero this tolerance is zero.
        """
        near = [ROUNDING * np.where(np.isfinite(bound), np.abs(bound), 0.0) for bound in (self.low, self.high)]
        return np.asarray(z <= self.low + near[0]), np.asarray(z >= self.high - near[1])


@dataclass(frozen=True)
class Optimum:
    """End point of a search for the maximum of an objective, and the effort of the search.

    Attributes
    ----------
    z : Array (n,)
        Coordinates of the end point.
    at : Evaluation
        Objective and derivatives at the end point.
    iterations, evaluations : int
        Numbers of iterations and of evaluations of the objective. Fisher scoring does not count evaluations of the
        value alone.
    gain_left : float
        Gain of the objective that the quadratic approximation predicts for one more step. It is near zero if the search
        has converged.
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
    """Correction of the expected information towards the true negative Hessian, near the optimum, by BFGS updates.

    A stored step of the search corrects the matrix in its direction by the change of the gradient along it (Nocedal
    and Wright 2006, eq. 6.19).

    Attributes
    ----------
    largest : Array (n,)
        Largest value so far of each diagonal element of the uncorrected negative Hessian. The least scale of the
        damping is proportional to it. At a kink of the objective, such as the end of a dead zone between two samples, a
        coordinate loses its information. If its damping were relative to what remains, its next step would reach its
        bounds (Moré 1978, section 5).
    pairs : list[tuple[Array, Array]]
        Up to 12 latest pairs of a step (n,) and the decrease of the gradient (n,) along it.
    """

    largest: Array
    pairs: list[tuple[Array, Array]] = field(default_factory=list)

    def add_step(self, step: Array, before: Evaluation, after: Evaluation) -> None:
        """Add an accepted step of the search, and update ``largest`` from the point after it.

        If the step gained more than 3 in log-likelihood, the objective is not quadratic yet: all pairs are deleted, and
        the step is not added. Otherwise the oldest pair is dropped if there are 12 already.

        Parameters
        ----------
        step : Array (n,)
            Change of the coordinates.
        before, after
            Evaluations at the start and at the end of the step.
        """
        self.largest = np.maximum(self.largest, np.diag(after.hessian))
        if after.value - before.value > QUADRATIC_GAIN:
            self.pairs.clear()
            return
        self.pairs = [*self.pairs[1 - MAX_BFGS_PAIRS :], (step, before.gradient - after.gradient)]

    def is_plausible(self, trial: Evaluation) -> bool:
        """Return whether the information at a trial point is plausible: less than 1e6 times as large as before.

        The ratio is the median over the coordinates of: diagonal of the information, divided by `largest`. Coordinates
        that never had information are not counted; without any other the result is True.

        The search rejects a point that is not plausible. Just before a simulation diverges, its objective may be finite
        and even better. Its sensitivities have diverged already, so that the remaining gain appears to be zero.
        """
        known = self.largest > 0.0
        if not known.any():
            return True
        return bool(np.median(np.diag(trial.information)[known] / self.largest[known]) < MAX_SENSITIVITY_RATIO)

    def hessian(self, at: Evaluation) -> Array:
        """Return the negative Hessian (n, n) of the objective at a point, corrected by the stored steps of the search.

        The corrections start from information plus curvature (`Evaluation.hessian`). A step is skipped if the curvature
        along it, measured by the gradient, is zero or negative, or differs from that of the matrix by a factor of 20 or
        more. The result therefore stays positive semidefinite.
        """
        H = at.hessian
        for s, y in self.pairs:
            Hs = H @ s
            old, new = float(s @ Hs), float(s @ y)
            if old > 0 and 0.05 * old < new < 20.0 * old:
                H = H - np.outer(Hs, Hs) / old + np.outer(y, y) / new
        return H


def solve_step(at: Evaluation, H: Array, z: Array, bounds: Bounds, damping: float, least: Array | float = 0.0) -> Array:
    """Return the damped Newton step of a maximisation, which ends on the bounds if it would cross them.

    Coordinates without any information do not move. No logarithm moves by more than 1.5 (a factor 4.5 of the
    parameter); otherwise the whole step is shortened. A logarithm that changes the objective by less than 0.5 over this
    distance is an exception: it alone is limited, and the step of the others is solved with it. Otherwise a noise
    parameter that the data do not inform would ask for a very long step and shorten those of all others to almost zero.

    Parameters
    ----------
    at
        Objective and derivatives at ``z``.
    H : Array (n, n)
        Negative Hessian. If it is singular, the step is the least-squares solution of least length.
    z : Array (n,)
        Coordinates at the start of the step.
    bounds
        Bounds of the coordinates.
    damping
        Factor of Levenberg's damping: this multiple of the diagonal of ``H`` is added to ``H``. 0: full Newton step.
    least : Array (n,) or float
        Where the diagonal of ``H`` is smaller than this, the damping is a multiple of this instead.

    Returns
    -------
    Array (n,)
        Change of the coordinates. Zero for coordinates at a bound beyond which the objective rises.
    """
    change = LARGEST_STEP * np.abs(at.gradient) + 0.5 * LARGEST_STEP**2 * np.diag(H)
    reach = np.where(bounds.logarithmic & (change < FLAT_CHANGE), LARGEST_STEP, np.inf)
    low, high = np.maximum(bounds.low - z, -reach), np.minimum(bounds.high - z, reach)
    fixed = bounds.pushed_against(z, at.gradient) | (np.diag(H) <= 0.0)
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
    """Return the gain of an objective that its quadratic approximation predicts for a step.

    It is ``g' s - 1/2 s' H s`` with the gradient g in ``at``, the negative Hessian H (n, n) and the step s (n,).
    """
    return float(at.gradient @ step - 0.5 * step @ H @ step)


def remaining_gain(at: Evaluation, H: Array, z: Array, bounds: Bounds) -> float:
    """Return the gain of the objective that one full Newton step from z (n,) is expected to bring.

    A search has converged if it is near zero. ``at`` is the evaluation at z, and H (n, n) the negative Hessian there.
    The step stays inside the ``bounds``.
    """
    return expected_gain(at, H, solve_step(at, H, z, bounds, 0.0))


def maximise(
    evaluate: Evaluate,
    z: Array,
    bounds: Bounds,
    *,
    max_iterations: int,
    tolerance: float,
    progress: Iterations | None = None,
    value: Callable[[Array], float] | None = None,
    start: Evaluation | None = None,
) -> Optimum:
    """Maximise an objective from ``z``, inside bounds, by Fisher scoring with Levenberg's damping.

    Fisher scoring makes Newton steps with the expected information as the negative Hessian; here BFGS updates correct
    it. The search ends if a full step is expected to gain less than ``tolerance``. It also ends if no step gains
    enough, neither with the corrected Hessian nor with the uncorrected one, and after ``max_iterations``.

    Parameters
    ----------
    evaluate
        Returns the objective with its derivatives; finite at the start. A step to a point that is not finite is
        rejected.
    z : Array (n,)
        Start of the search. It is clipped to the bounds.
    bounds
        Bounds of the coordinates.
    max_iterations
        Largest number of iterations.
    tolerance
        Expected gain below which the search ends.
    progress
        Called in each iteration with its number, from 0, and the objective. None: no call.
    value
        Returns the objective without its derivatives, in a fraction of the time. In a search that has rejected several
        steps, further steps are evaluated by it first. None: every step is evaluated with its derivatives.
    start
        Result of ``evaluate`` at ``z``, which must be inside the bounds. None: it is computed.

    Returns
    -------
    Optimum
        Best point found. The search has converged if the absolute value of its ``gain_left`` is below the tolerance.
    """
    z = bounds.clip(z)
    at = evaluate(z) if start is None else start
    correction = BfgsCorrection(np.diag(at.hessian))
    evaluations, rejected, damping, growth = 1, 0, 1e-3, 2.0
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
            target = bounds.clip(z + step)
            least = at.value + max(1e-4 * expected, 0.0)  # an accepted step exceeds this value
            if value is None or rejected < FEWEST_REJECTED or value(target) > least:  # False for NaN
                trial = evaluate(target)
                evaluations += 1
                if trial.finite and correction.is_plausible(trial) and trial.value > least:
                    ratio = min((trial.value - at.value) / max(expected, 1e-300), 1.0)
                    damping, growth = max(damping * max(1 / 10, 1 - (2 * ratio - 1) ** 3), 1e-12), 2.0
                    correction.add_step(target - z, at, trial)
                    z, at = target, trial
                    break
            rejected += 1
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
    """Continue a search by the quasi-Newton method L-BFGS-B with the exact gradient.

    A fit uses it if Fisher scoring stops before it has converged. The coordinates are scaled by the square roots of the
    Hessian's diagonal. The search ends, among other cases, if a step gains less than about a twentieth of the
    ``tolerance``, or after 200 iterations.

    Parameters
    ----------
    value_and_gradient
        Returns the objective and its gradient (n,).
    start
        Point at which Fisher scoring ended.
    bounds
        Bounds of the coordinates.
    evaluate
        Returns the objective with all derivatives.
    tolerance
        Tolerance of the fit in log-likelihood.

    Returns
    -------
    Optimum
        End point of L-BFGS-B, with the iterations and evaluations of both searches. If it is worse than ``start`` or
        not finite, the point is that of ``start``, and only the evaluations are added.
    """
    from scipy import optimize  # imported here: it takes half a second and is seldom needed

    size = np.sqrt(np.maximum(np.diag(start.at.hessian), 1e-12))

    def negative_objective(w: Array) -> tuple[float, Array]:
        """Return the negative objective and its gradient (n,), for a minimiser, at the scaled coordinates w (n,).

        If they are not finite, return 1e30 and a zero gradient.
        """
        value, gradient = value_and_gradient(bounds.clip(w / size))
        finite = np.isfinite(value) and bool(np.isfinite(gradient).all())
        return (-value, -gradient / size) if finite else (1e30, np.zeros(size.size))

    relative = LBFGSB_TOLERANCE * tolerance / max(abs(start.at.value), 1.0)  # L-BFGS-B takes it relative to the value
    limits = optimize.Bounds(bounds.low * size, bounds.high * size)
    found = optimize.minimize(
        negative_objective,
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
    """Objective of a fit: log-posterior of the free parameters, given the measured records.

    It is a function of n coordinates: one for each shared free parameter, then one for each per-record parameter in
    each record. A coordinate is the parameter or, for a parameter with the transform "log", its logarithm.

    Parameters
    ----------
    likelihood
        Likelihood of the model.
    records
        Records of the fit.
    free
        Names of the parameters to be estimated.
    threads
        Largest number of records that are evaluated at the same time.
    initial_values
        Initial values by full name (``V_x@0`` is V_x in record 0) that differ from the model's, also of shared
        parameters. A name that is not estimated is ignored. None: no such values.

    Attributes
    ----------
    model : Model
        Model of the likelihood.
    parameters : tuple[Parameter, ...]
        Parameter of each coordinate; a per-record parameter has the index of the record as its ``segment``.
    names : tuple[str, ...]
        Full name of each coordinate's parameter, such as ``m_u`` or ``V_x@0``.
    columns : list[int]
        Index of each coordinate's parameter in ``model.parameters``.
    coordinates : list[list[int]]
        For each record, the indices of the coordinates on which it depends, in the order of `free`.
    free : tuple[str, ...]
        Names of the estimated parameters, the shared ones first.
    base : Array (n_parameters,)
        Values of all parameters of the model before the fit.
    """

    def __init__(
        self,
        likelihood: Likelihood,
        records: Sequence[Record],
        free: Sequence[str],
        threads: int,
        initial_values: Mapping[str, float] | None = None,
    ) -> None:
        """Create the objective, and assign a coordinate to each free parameter; see the class for the arguments."""
        self.likelihood, self.records, self.initial_values = likelihood, tuple(records), initial_values or {}
        model = self.model = likelihood.model
        index = {p.name: i for i, p in enumerate(model.parameters)}
        shared = [n for n in free if not model.parameter(n).per_record]
        own = [n for n in free if model.parameter(n).per_record]
        self.free = (*shared, *own)
        copies = [replace(model.parameter(n), segment=i) for i in range(len(records)) for n in own]
        self.parameters = (*(model.parameter(n) for n in shared), *copies)
        self.names = tuple(p.full_name for p in self.parameters)

        self.columns = [index[p.name] for p in self.parameters]
        first = len(shared)
        self.coordinates = [
            [*range(first), *range(first + i * len(own), first + (i + 1) * len(own))] for i in range(len(records))
        ]
        self.base = np.array([p.value for p in model.parameters])
        self.threads = max(1, min(threads, len(records)))
        self._last_values: dict[int, tuple[Array, float]] = {}  # by record: values and result of the last `value`

    @cached_property
    def bounds(self) -> Bounds:
        """Bounds of the coordinates (logarithms of the parameters' bounds for the transform "log")."""
        low, high = np.array([p.free_bounds() for p in self.parameters]).reshape(-1, 2).T
        return Bounds(low, high, np.array([p.transform == "log" for p in self.parameters], dtype=bool))

    @property
    def initial_coordinates(self) -> Array:
        """Coordinates (n,) of the initial values of the parameters, not clipped to the bounds."""
        own = zip(self.names, self.parameters, strict=True)
        return np.array([p.to_free(self.initial_values.get(name, p.value)) for name, p in own])

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Mean (n,) and information (n,) of each coordinate's prior; both are zero without a prior.

        The information is 1 / variance. For a coordinate that is a logarithm, both are those of the logarithm.
        """
        given = [p.free_prior() for p in self.parameters]
        mean = np.array([g[0] if g else 0.0 for g in given])
        return mean, np.array([1.0 / g[1] ** 2 if g else 0.0 for g in given])

    def values(self, z: Array) -> Array:
        """Return the values of all parameters of the model for each record (n_records, n_parameters).

        ``z`` (n,) are the coordinates; the values are in the parameters' own units. Parameters that are not estimated
        have their values in the model.
        """
        own = self.natural_values(z)
        out = np.tile(self.base, (len(self.records), 1))
        for i, coordinates in enumerate(self.coordinates):
            out[i, [self.columns[k] for k in coordinates]] = own[coordinates]
        return out

    def natural_values(self, z: Array) -> Array:
        """Convert the coordinates z (n,) of a search to values of the free parameters (n,) in their own units.

        The exponential of a logarithm is taken. The values are clipped to the parameters' bounds, since logarithms are
        rounded.
        """
        return np.array([np.clip(p.from_free(float(c)), *p.bounds) for p, c in zip(self.parameters, z, strict=True)])

    def slopes(self, z: Array) -> Array:
        """Return the derivative (n,) of each free parameter by its coordinate, at the coordinates z (n,).

        It is 1, or the parameter itself if the coordinate is its logarithm. It converts gradients and standard errors.
        """
        return np.array([p.slope(p.from_free(float(c))) for p, c in zip(self.parameters, z, strict=True)])

    def evaluate(self, z: Array) -> Evaluation:
        """Return log-posterior, gradient and expected information at the coordinates z (n,), summed over the records.

        The derivatives come from forward sensitivities. The information includes that of the priors. The value includes
        all constants of the likelihood, but not those of the priors. It is NaN if the filter diverges in a record.
        """
        mean, weight = self.prior
        value = 0.0
        gradient, information = np.zeros(z.size), np.zeros((z.size, z.size))
        rows = self._for_each_record(lambda i, v: self.likelihood.scores(self.records[i], v, self.free), z)
        slope = self.slopes(z)
        for coordinates, scores in zip(self.coordinates, rows, strict=True):
            value += scores.value
            gradient[coordinates] += slope[coordinates] * scores.gradient
            information[np.ix_(coordinates, coordinates)] += (
                np.outer(slope[coordinates], slope[coordinates]) * scores.information
            )
        # The logarithm of a standard deviation s near zero: ln L ~ -c s^2, whose second derivative by ln s is twice
        # the first. The expected information is of the order s^4; a step of the prior alone would overshoot.
        twice = np.where(self.bounds.logarithmic, 2.0 * np.maximum(-gradient, 0.0), 0.0)
        curvature = np.maximum(twice - np.diag(information), 0.0)
        value -= 0.5 * float(weight @ (z - mean) ** 2)
        return Evaluation(value, gradient - weight * (z - mean), information + np.diag(weight), curvature)

    def information(self, z: Array, which: NDArray[np.intp]) -> Array:
        """Return the block (n_which, n_which) of the Fisher information at z (n,) for some of the coordinates.

        It includes the information of their priors, and costs less than the whole matrix.

        Parameters
        ----------
        z : Array (n,)
            Coordinates: free parameters, or their logarithms.
        which : Array (n_which,) of int
            Indices of the coordinates of the block, which also give its order.
        """
        slope, selected, n = self.slopes(z), set(which.tolist()), len(self.free)
        total = np.diag(self.prior[1])

        def chosen(i: int) -> list[int]:
            """Return the indices in ``free`` of those parameters of record i whose coordinates are selected."""
            return [k for k in range(n) if self.coordinates[i][k] in selected]

        rows = self._for_each_record(
            lambda i, v: self.likelihood.scores(self.records[i], v, [self.free[k] for k in chosen(i)]), z
        )
        for i, scores in enumerate(rows):
            at = [self.coordinates[i][k] for k in chosen(i)]
            total[np.ix_(at, at)] += np.outer(slope[at], slope[at]) * scores.information
        return total[np.ix_(which, which)]

    def value(self, z: Array) -> float:
        """Return the log-posterior at the coordinates z (n,), without the constants of the priors.

        The result is NaN if the filter diverges in a record. A record whose values are the same as in the last call is
        not evaluated again. If only a per-record parameter changes, a single record is evaluated.
        """

        def work(i: int, v: Array) -> float:
            """Return the log-likelihood of record i with the values v (n_parameters,), and store it for the next call.

            If v are the values of the last call, the stored result is returned.
            """
            last, known = self._last_values.get(i, (None, 0.0))
            if last is None or not np.array_equal(last, v):
                known = self.likelihood.value(self.records[i], v)
                self._last_values[i] = v, known
            return known

        mean, weight = self.prior
        return sum(self._for_each_record(work, z), -0.5 * float(weight @ (z - mean) ** 2))

    def value_and_gradient(self, z: Array) -> tuple[float, Array]:
        """Return the log-posterior at the coordinates z (n,) and its gradient (n,), by the adjoint filter.

        The constants of the priors are left out, as in `value`. Both results are not finite if the filter diverges.
        """
        mean, weight = self.prior
        value, gradient = -0.5 * float(weight @ (z - mean) ** 2), -weight * (z - mean)
        slope = self.slopes(z)
        rows = self._for_each_record(lambda i, v: self.likelihood.gradient(self.records[i], v), z)
        for coordinates, (ll, by_parameter) in zip(self.coordinates, rows, strict=True):
            value += ll
            gradient[coordinates] += slope[coordinates] * by_parameter[[self.columns[k] for k in coordinates]]
        return value, gradient

    def by_row(self, z: Array) -> list[tuple[list[int], Array]]:
        """Return the contribution of each row of each record to the gradient of the log-likelihood at z (n,).

        A row is one instant of a record with its samples. Robust standard errors need these contributions. The priors
        are not included.

        Returns
        -------
        list of (coordinates, contributions)
            For each record: indices of the coordinates on which it depends, and an array (n_rows, n_coordinates).
        """
        slope = self.slopes(z)
        rows = self._for_each_record(lambda i, v: self.likelihood.scores(self.records[i], v, self.free, by_row=True), z)
        return [
            (coordinates, slope[coordinates] * scores.by_row)
            for coordinates, scores in zip(self.coordinates, rows, strict=True)
            if scores.by_row is not None
        ]

    def check(self, z: Array) -> None:
        """Raise ValueError if the log-likelihood of a record is not finite at z (n,); the message names the first one.

        The message calls z the initial values.
        """
        for record, values in zip(self.records, self.values(z), strict=True):
            if not np.isfinite(self.likelihood.value(record, values)):
                raise ValueError(
                    f"record {record.name}: the likelihood of model {self.model.name} cannot be evaluated at the "
                    "initial values of the parameters; give others (--initial NAME=VALUE)"
                )

    def _for_each_record(self, work: Callable[[int, Array], T], z: Array) -> list[T]:
        """Return the results of ``work(i, values)`` for all records i in order, computed in up to ``threads`` threads.

        The call waits for all of them. An error of ``work`` is raised here. ``values`` (n_parameters,) are all
        parameters of record i at the coordinates z (n,), in their own units.
        """
        values = self.values(z)
        if self.threads == 1:
            return [work(i, v) for i, v in enumerate(values)]
        with ThreadPoolExecutor(self.threads) as pool:  # the kernels release Python's global lock
            return list(pool.map(work, range(len(values)), values))
