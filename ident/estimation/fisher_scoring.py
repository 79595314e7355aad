"""Damped Fisher scoring inside bounds: Gauss-Newton steps with the expected information as the Hessian.

Levenberg's damping with Nielsen's rule for it (Madsen, Nielsen and Tingleff 2004, section 3.2). A step that
would leave the bounds ends on them, and the rest of it is solved for anew. A value that is not a number
rejects the step.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ident.numerics import Array

Flags = NDArray[np.bool_]
LARGEST_STEP = 1.5  # of the logarithm of a parameter in one iteration: a factor 4.5
FLAT_CHANGE = 0.5  # of the log-likelihood by such a step: less, and the coordinate must not hold up the others
MAX_DAMPING = 1e12  # over the diagonal of the Hessian: no step is left
DIVERGENCE_LIMIT = 1e30  # of the information's diagonal: no data give as much, the simulation has diverged
MAX_SENSITIVITY_RATIO = 1e6  # of the information after a step to the largest before (median): it is about to diverge
DAMPING_FLOOR = 1e-4  # of the largest information that a coordinate ever had: the least that its damping goes by
LBFGSB_TOLERANCE = 0.05  # of the fit's tolerance: gain of a step of L-BFGS-B that is not worth the next one
QUADRATIC_GAIN = 3.0  # of the log-likelihood in one step: below it the objective is about quadratic
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
        return np.asarray(((z <= self.low) & (gradient < 0)) | ((z >= self.high) & (gradient > 0)))


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
        self.pairs = [*self.pairs[1 - MAX_BFGS_PAIRS:], (step, before.gradient - after.gradient)]

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


def maximise(evaluate: Evaluate, z: Array, bounds: Bounds, *, max_iterations: int, tolerance: float,
             progress: Iterations | None = None) -> Optimum:
    """From ``z`` until a full step is expected to gain less than ``tolerance``, or no step gains anything.

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
                return Optimum(z, at, iteration + 1, evaluations, left)
    return Optimum(z, at, max_iterations, evaluations, remaining_gain(at, memory.hessian(at), z, bounds))


def refine_lbfgsb(value_and_gradient: Callable[[Array], tuple[float, Array]], start: Optimum, bounds: Bounds,
          evaluate: Evaluate, tolerance: float) -> Optimum:
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
    found = optimize.minimize(negative, start.z * size, jac=True, method="L-BFGS-B", bounds=limits,
                              options={"maxiter": 200, "maxcor": 30, "ftol": max(1e-14, relative), "gtol": 1e-6})
    z = bounds.clip(found.x / size)
    at = evaluate(z)
    spent = start.evaluations + int(found.nfev) + 1
    if not at.finite or at.value < start.at.value:
        return Optimum(start.z, start.at, start.iterations, spent, start.gain_left)
    left = remaining_gain(at, at.hessian, z, bounds)
    return Optimum(z, at, start.iterations + int(found.nit), spent, left)
