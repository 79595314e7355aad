"""Damped Fisher scoring inside bounds: Gauss-Newton steps with the expected information as the Hessian.

Levenberg's damping with Nielsen's rule for it (Madsen, Nielsen and Tingleff 2004, section 3.2). A step that
would leave the bounds ends on them, and the rest of it is solved for anew. A value that is not a number
rejects the step.

Objective of a fit: log-likelihood and log-prior over the free coordinates.
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
LARGEST_STEP = 1.5  # of the logarithm of a parameter in one iteration: a factor 4.5
FLAT_CHANGE = 0.5  # of the log-likelihood by such a step: less, and the coordinate must not hold up the others
MAX_DAMPING = 1e12  # over the diagonal of the Hessian: no step is left
DIVERGENCE_LIMIT = 1e30  # of the information's diagonal: no data give as much, the simulation has diverged
MAX_SENSITIVITY_RATIO = 1e6  # of the information after a step to the largest before (median): it is about to diverge
DAMPING_FLOOR = 1e-4  # of the largest information that a coordinate ever had: the least that its damping goes by
LBFGSB_TOLERANCE = 0.05  # of the fit's tolerance: gain of a step of L-BFGS-B that is not worth the next one
QUADRATIC_GAIN = 3.0  # of the log-likelihood in one step: below it the objective is about quadratic
ROUNDING = 1e-12  # of a bound: z + (bound - z) need not be the bound
MAX_BFGS_PAIRS = 12  # of steps and changes of the gradient that a BFGS correction is made of


@dataclass(frozen=True)
class Evaluation:
    """Objective to be maximised, its gradient (n,) and expected information (n, n), at a point.

    curvature (n,): what the expected information lacks of the Hessian's diagonal, where that can be said.
    """

    value: float
    gradient: Array
    information: Array
    curvature: Array

    @property
    def hessian(self) -> Array:
        """Positive: minus the second derivative, as well as it is known."""
        return self.information + np.diag(self.curvature)

    @property
    def finite(self) -> bool:
        """Whether a search can go on from there."""
        numbers = np.isfinite(self.value) and np.isfinite(self.gradient).all() and np.isfinite(self.information).all()
        return bool(numbers and np.diag(self.information).max(initial=0.0) < DIVERGENCE_LIMIT)


@dataclass(frozen=True)
class Bounds:
    """low, high (n,); logarithmic (n,): coordinates whose steps are limited."""

    low: Array
    high: Array
    logarithmic: Flags

    def clip(self, z: Array) -> Array:
        return np.clip(z, self.low, self.high)

    def held(self, z: Array, gradient: Array) -> Flags:
        """Coordinates at a bound that the objective pushes against."""
        low, high = self.reached(z)
        return np.asarray((low & (gradient < 0)) | (high & (gradient > 0)))

    def reached(self, z: Array) -> tuple[Flags, Flags]:
        """Coordinates at their lower and at their upper bound, to the rounding of the step that ended there."""
        near = [ROUNDING * np.where(np.isfinite(bound), np.abs(bound), 0.0) for bound in (self.low, self.high)]
        return np.asarray(z <= self.low + near[0]), np.asarray(z >= self.high - near[1])


@dataclass(frozen=True)
class Optimum:
    z: Array
    at: Evaluation
    iterations: int
    evaluations: int
    gain_left: float  # what a last step is expected to gain


Evaluate = Callable[[Array], Evaluation]
Iterations = Callable[[int, float], None]  # is told each iteration's number and objective


@dataclass
class BfgsCorrection:
    """Steps and the changes of the gradient they brought, near the optimum: what the expected information does
    not know of the Hessian. Each turns a direction of it by a BFGS update (Nocedal and Wright 2006, eq. 6.19).

    largest (n,): of the Hessian's diagonal so far. At a kink (the end of a dead zone between two samples) a coordinate
    loses its information, and with a damping by what is left of it would be flung to its bounds (Moré 1978, section 5).
    """

    largest: Array
    pairs: list[tuple[Array, Array]] = field(default_factory=list)

    def add(self, step: Array, before: Evaluation, after: Evaluation) -> None:
        self.largest = np.maximum(self.largest, np.diag(after.hessian))
        if after.value - before.value > QUADRATIC_GAIN:
            self.pairs.clear()
            return
        self.pairs = [*self.pairs[1 - MAX_BFGS_PAIRS :], (step, before.gradient - after.gradient)]

    def holds(self, trial: Evaluation) -> bool:
        """Whether the sensitivities are of the order that they were. Where a simulation is about to diverge its value
        may be finite, and better, but the sensitivities have diverged already, and seem to leave nothing to gain."""
        known = self.largest > 0.0
        if not known.any():
            return True
        return bool(np.median(np.diag(trial.information)[known] / self.largest[known]) < MAX_SENSITIVITY_RATIO)

    def hessian(self, at: Evaluation) -> Array:
        H = at.hessian
        for s, y in self.pairs:
            Hs = H @ s
            old, new = float(s @ Hs), float(s @ y)
            if old > 0 and 0.05 * old < new < 20.0 * old:
                H = H - np.outer(Hs, Hs) / old + np.outer(y, y) / new
        return H


def solve_step(at: Evaluation, H: Array, z: Array, bounds: Bounds, damping: float, least: Array | float = 0.0) -> Array:
    """The damped step, ending on the bounds where it would cross them; ``H`` (n, n): minus the Hessian; ``least`` (n,):
    what its diagonal counts for in the damping at least. What the data do not inform at all stays where it is.

    No logarithm moves by more than ``LARGEST_STEP``: the whole step is shortened. But one that hardly matters does not
    hold up the rest: a noise that the data do not inform asks for a step of thousands, beside which all others would
    stand still. It alone is held, and the rest is solved for it.
    """
    felt = LARGEST_STEP * np.abs(at.gradient) + 0.5 * LARGEST_STEP**2 * np.diag(H)
    reach = np.where(bounds.logarithmic & (felt < FLAT_CHANGE), LARGEST_STEP, np.inf)
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
        # only the bound that is met first: without its coordinate the others may not cross theirs
        room = np.where(step < 0, -low, high)
        first = int(np.argmin(np.where(crossing, room / np.maximum(np.abs(step), 1e-300), np.inf)))
        step[first] = np.clip(step[first], low[first], high[first])
        fixed[first] = True
    largest = np.abs(step[bounds.logarithmic]).max(initial=0.0)
    return step * min(1.0, LARGEST_STEP / largest) if largest > 0 else step


def expected_gain(at: Evaluation, H: Array, step: Array) -> float:
    return float(at.gradient @ step - 0.5 * step @ H @ step)


def remaining_gain(at: Evaluation, H: Array, z: Array, bounds: Bounds) -> float:
    """What an undamped step is expected to gain."""
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
    """From ``z`` until a full step is expected to gain less than ``tolerance``, or no step gains anything, neither by
    the corrected Hessian nor by the expected information alone.

    ``evaluate(z)`` must be finite at the start.
    """
    z = bounds.clip(z)
    at = evaluate(z)
    memory = BfgsCorrection(np.diag(at.hessian))
    evaluations, damping, growth = 1, 1e-3, 2.0
    for iteration in range(max_iterations):
        if progress is not None:
            progress(iteration, at.value)
        H = memory.hessian(at)
        left = remaining_gain(at, H, z, bounds)
        if abs(left) < tolerance:
            return Optimum(z, at, iteration, evaluations, left)
        while True:
            step = solve_step(at, H, z, bounds, damping, DAMPING_FLOOR * memory.largest)
            expected = expected_gain(at, H, step)
            trial = evaluate(bounds.clip(z + step))
            evaluations += 1
            gained = trial.value - at.value if trial.finite and memory.holds(trial) else -np.inf
            if gained > max(1e-4 * expected, 0.0):
                ratio = min(gained / max(expected, 1e-300), 1.0)
                damping, growth = max(damping * max(1 / 10, 1 - (2 * ratio - 1) ** 3), 1e-12), 2.0
                memory.add(bounds.clip(z + step) - z, at, trial)
                z, at = bounds.clip(z + step), trial
                break
            damping, growth = damping * growth, growth * 2
            if damping > MAX_DAMPING or growth > 2.0**12:
                if not memory.pairs:
                    return Optimum(z, at, iteration + 1, evaluations, left)
                memory.pairs.clear()  # of steps as small as rounding, or across a kink, they promise what is not there
                damping, growth = 1e-3, 2.0
                break
    return Optimum(z, at, max_iterations, evaluations, remaining_gain(at, memory.hessian(at), z, bounds))


def refine_lbfgsb(
    value_and_gradient: Callable[[Array], tuple[float, Array]],
    start: Optimum,
    bounds: Bounds,
    evaluate: Evaluate,
    tolerance: float,
) -> Optimum:
    """L-BFGS-B with the exact gradient, scaled by the information: where scoring stands still. It ends where a step
    gains next to nothing of the ``tolerance``: a rough fit need not crawl on for a hundred steps."""
    from scipy import optimize  # half a second of import, and scoring seldom stands still

    size = np.sqrt(np.maximum(np.diag(start.at.hessian), 1e-12))

    def negative(w: Array) -> tuple[float, Array]:
        value, gradient = value_and_gradient(bounds.clip(w / size))
        finite = np.isfinite(value) and bool(np.isfinite(gradient).all())
        return (-value, -gradient / size) if finite else (1e30, np.zeros(size.size))

    relative = LBFGSB_TOLERANCE * tolerance / max(abs(start.at.value), 1.0)  # of the value, as L-BFGS-B wants it
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
    """Of the ``free`` parameters; ``begin``: values of ``V_x@0`` and the like to start from, not the model's own."""

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
        self.columns = [index[p.name] for p in self.parameters]
        # places[i]: where record i's free parameters stand among the coordinates
        first = len(shared)
        self.places = [
            [*range(first), *range(first + i * len(own), first + (i + 1) * len(own))] for i in range(len(records))
        ]
        self.base = np.array([p.value for p in model.parameters])
        self.threads = max(1, min(threads, len(records)))
        self._last_values: dict[int, tuple[Array, float]] = {}

    @cached_property
    def bounds(self) -> Bounds:
        low, high = np.array([p.free_bounds() for p in self.parameters]).reshape(-1, 2).T
        return Bounds(low, high, np.array([p.transform == "log" for p in self.parameters], dtype=bool))

    @property
    def start(self) -> Array:
        own = zip(self.names, self.parameters, strict=True)
        return np.array([p.to_free(self.begin.get(name, p.value)) for name, p in own])

    @cached_property
    def prior(self) -> tuple[Array, Array]:
        """Mean and information of each coordinate's prior; no prior has no information."""
        given = [p.free_prior() for p in self.parameters]
        mean = np.array([g[0] if g else 0.0 for g in given])
        return mean, np.array([1.0 / g[1] ** 2 if g else 0.0 for g in given])

    def values(self, z: Array) -> Array:
        """(n_records, n_parameters) in own units."""
        own = self.own(z)
        out = np.tile(self.base, (len(self.records), 1))
        for i, places in enumerate(self.places):
            out[i, [self.columns[k] for k in places]] = own[places]
        return out

    def own(self, z: Array) -> Array:
        """The coordinates' values in own units (n,); the bounds once more, for the rounding of logarithms."""
        return np.array([np.clip(p.from_free(float(c)), *p.bounds) for p, c in zip(self.parameters, z, strict=True)])

    def slopes(self, z: Array) -> Array:
        """d value / d coordinate."""
        return np.array([p.slope(p.from_free(float(c))) for p, c in zip(self.parameters, z, strict=True)])

    def evaluate(self, z: Array) -> Evaluation:
        """Log-posterior, gradient and information with the priors', by the coordinates."""
        mean, weight = self.prior
        value = 0.0
        gradient, information = np.zeros(z.size), np.zeros((z.size, z.size))
        rows = self._map(lambda i, v: self.likelihood.scores(self.records[i], v, self.free), z)
        slope = self.slopes(z)
        for places, scores in zip(self.places, rows, strict=True):
            value += scores.value
            gradient[places] += slope[places] * scores.gradient
            information[np.ix_(places, places)] += np.outer(slope[places], slope[places]) * scores.information
        # A logarithm of a standard deviation s that goes to zero: ln L ~ -c s^2, whose second derivative is twice
        # its first, while the expected information is of the order s^4 and would let the prior overshoot.
        twice = np.where(self.bounds.logarithmic, 2.0 * np.maximum(-gradient, 0.0), 0.0)
        curvature = np.maximum(twice - np.diag(information), 0.0)
        value -= 0.5 * float(weight @ (z - mean) ** 2)
        return Evaluation(value, gradient - weight * (z - mean), information + np.diag(weight), curvature)

    def information(self, z: Array, which: NDArray[np.intp]) -> Array:
        """Of some of the coordinates alone, with their priors' (n_which, n_which): less work than all of it."""
        slope, wanted, n = self.slopes(z), set(which.tolist()), len(self.free)
        total = np.diag(self.prior[1])

        def chosen(i: int) -> list[int]:
            return [k for k in range(n) if self.places[i][k] in wanted]

        rows = self._map(lambda i, v: self.likelihood.scores(self.records[i], v, [self.free[k] for k in chosen(i)]), z)
        for i, scores in enumerate(rows):
            at = [self.places[i][k] for k in chosen(i)]
            total[np.ix_(at, at)] += np.outer(slope[at], slope[at]) * scores.information
        return total[np.ix_(which, which)]

    def value(self, z: Array) -> float:
        """Log-posterior. A record whose values are those of the last call is not evaluated again: where a coordinate
        that one record has for itself is moved, that record alone."""

        def work(i: int, v: Array) -> float:
            last, known = self._last_values.get(i, (None, 0.0))
            if last is None or not np.array_equal(last, v):
                known = self.likelihood.value(self.records[i], v)
                self._last_values[i] = v, known
            return known

        mean, weight = self.prior
        return sum(self._map(work, z), -0.5 * float(weight @ (z - mean) ** 2))

    def value_and_gradient(self, z: Array) -> tuple[float, Array]:
        """Log-posterior and gradient by the adjoint."""
        mean, weight = self.prior
        value, gradient = -0.5 * float(weight @ (z - mean) ** 2), -weight * (z - mean)
        slope = self.slopes(z)
        rows = self._map(lambda i, v: self.likelihood.gradient(self.records[i], v), z)
        for places, (ll, by_parameter) in zip(self.places, rows, strict=True):
            value += ll
            gradient[places] += slope[places] * by_parameter[[self.columns[k] for k in places]]
        return value, gradient

    def by_row(self, z: Array) -> list[tuple[list[int], Array]]:
        """For each record: its coordinates, and what each row adds to the gradient."""
        slope = self.slopes(z)
        rows = self._map(lambda i, v: self.likelihood.scores(self.records[i], v, self.free, by_row=True), z)
        return [
            (places, slope[places] * scores.by_row)
            for places, scores in zip(self.places, rows, strict=True)
            if scores.by_row is not None
        ]

    def check(self, z: Array) -> None:
        """Raise ValueError naming the first record that cannot be evaluated."""
        for record, values in zip(self.records, self.values(z), strict=True):
            if not np.isfinite(self.likelihood.value(record, values)):
                raise ValueError(
                    f"record {record.name}: the likelihood of model {self.model.name} cannot be "
                    "evaluated at the starting values"
                )

    def _map(self, work: Callable[[int, Array], T], z: Array) -> list[T]:
        values = self.values(z)
        if self.threads == 1:
            return [work(i, v) for i, v in enumerate(values)]
        with ThreadPoolExecutor(self.threads) as pool:  # the kernels leave Python's lock
            return list(pool.map(work, range(len(values)), values))
