"""Monte Carlo study of the estimator: bias, variance and interval coverage on simulated data of the model itself.

Each replicate is simulated with process and measurement noise (``seatrial.ident.estimation.stochastic_simulation``,
plain numpy) and estimated by ``seatrial.ident.estimation.maximum_likelihood``. All statistics are in the coordinate of
the estimator (the logarithm of a positive parameter), to which its standard error refers:

    bias     = mean(d) / sd(d),  d = estimate - truth
    ratio    = var(d) / mean(variance that each fit reported);  bound: the same with the Cramér-Rao bound at the truth,
               which is compared with the aim; the coverage shows whether the reported errors are right
    coverage = share of |d| < 1.96 standard errors

An estimate at its bound counts as well: its interval goes from the bound to ``Fit.limits``, and its standard error is
the length of the interval over 1.96. Near bounds no estimate is unbiased, and the Cramér-Rao bound is not the least
variance. The reference is then an efficient estimate: normal with the information at the truth, projected onto the
bounds in the metric of that information (Self and Liang 1987, Andrews 1999).
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from seatrial.ident.data import Record
from seatrial.ident.estimation import (
    Bounds,
    EstimationOptions,
    Evaluation,
    Fit,
    Likelihood,
    Method,
    Problem,
    SampledInputs,
    SearchSettings,
    considered_information,
    fit,
    free_start,
    simulate_stochastic,
    solve_step,
)
from seatrial.ident.model import Model, Parameter
from seatrial.ident.numerics import Array, scaled_inverse
from seatrial.ident.results import APART, BIAS, COVERAGE, VARIANCE

Row = dict[str, Any]
Z95 = 1.96
N_DRAWS = 400  # samples of an efficient estimate near bounds, for each replicate
# The wings that a study's results hang on.
HASHED_WINGS = (
    "characterisation",
    "data",
    "effects",
    "engine",
    "estimation",
    "experiment_design",
    "model",
    "models",
    "numerics",
    "studies",
)


@dataclass(frozen=True)
class Case:
    """Case of a study: a model at the true values of its parameters, and the inputs of a mission.

    Attributes:
        every: rows between the samples of a sensor (default 1).
        reml: noise parameters by restricted maximum likelihood (REML), as the commands do. The order of the
            filter mean is a property of the model.
    """

    name: str
    model: Model
    inputs: SampledInputs
    every: Mapping[str, int]
    about: str = ""
    reml: bool = True

    def at(self, truth: Mapping[str, float]) -> Case:
        """The case with other true values."""
        return replace(self, model=self.model.with_values(truth))


def run_replicates(case: Case, numbers: Sequence[int], seed: int, method: Method = "prediction-error") -> list[Row]:
    """Simulate and estimate the replicates of these numbers, one row each; replicates are independent."""
    rngs = [np.random.default_rng([seed, k]) for k in numbers]
    truths = np.array([_draw(case.model, rng) for rng in rngs])
    began = time.process_time()
    states, y = simulate_stochastic(case.model, case.inputs, truths, rngs)
    simulation = (time.process_time() - began) / len(numbers)
    rows = []
    for k, rng, truth, x, measured in zip(numbers, rngs, truths, states, y, strict=True):
        record = make_record(case, measured, f"{case.name} {k}")
        row: Row = {"k": k, "simulation": simulation}
        try:
            row |= estimate(case, record, truth, x[0], rng, method)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as problem:  # counted, and the study goes on
            row |= {"error": f"{type(problem).__name__}: {problem}"}
        rows.append(row)
    return rows


def make_record(case: Case, y: Array, name: str) -> Record:
    """Measurements at the rows at which the sensors sample."""
    model, inputs, seen, column = case.model, case.inputs, np.full(y.shape, np.nan), 0
    for sensor in model.sensors:
        rows, columns = np.s_[:: case.every.get(sensor.name, 1)], np.s_[column : column + len(sensor.outputs)]
        seen[rows, columns] = y[rows, columns]
        column = columns.stop
    names = tuple(i.name for i in model.inputs), tuple(o.name for o in model.outputs)
    return Record(name, inputs.t, inputs.u, inputs.u_next, seen, *names)


def estimate(case: Case, record: Record, truth: Array, x0: Array, rng: np.random.Generator, method: Method) -> Row:
    """Fit from random initial values, and its errors.

    Names are those of ``case.model.free`` and, for output error, ``x0_NAME`` of the initial states, whose truth is
    ``x0`` (n_states,).
    """
    model = replace(case.model, second_order=case.model.second_order and method == "prediction-error")
    named = dict(zip([p.name for p in model.parameters], truth.tolist(), strict=True))
    shared = [p for p in model.parameters if p.free and not p.per_record]
    apart = {p.name: p.value * float(np.exp(rng.uniform(-APART, APART))) for p in shared}
    start = {p.name: float(np.clip(apart[p.name], *p.bounds)) for p in shared}
    start |= {p.name: p.value for p in model.parameters if p.per_record}
    began = time.process_time()
    if method == "output-error":
        named |= {f"x0_{s.name}": float(x) for s, x in zip(model.states, x0, strict=True)}
        model = free_start(model, [record])[0]
    named = {n: named[n] for n in model.values}
    options = EstimationOptions(reml=case.reml, method=method)
    found = fit(model, [record], options, SearchSettings(threads=1), start=start)
    cpu = time.process_time() - began
    parameters = found.parameters
    names = [p.name for p in parameters]
    z = _coordinates(parameters, found.values)
    slope = np.array([p.slope(v) for p, v in zip(parameters, found.values, strict=True)])
    name_of = {p.full_name: p.name for p in parameters}
    true = np.array([p.to_free(named[p.name]) for p in parameters])
    return {
        "converged": found.converged,
        "iterations": found.iterations,
        "cpu": cpu,
        "d": dict(zip(names, (z - true).tolist(), strict=True)),
        "se": _finite(names, found.errors / slope),
        "far": _finite(names, _coordinates(parameters, found.limits) - true),
        "bound": _finite(names, cramer_rao_errors(model.with_values(named), record, found, method, rng)),
        "flags": {name_of[n]: what for n, what in found.flags},
    }


def cramer_rao_errors(truth: Model, record: Record, found: Fit, method: Method, rng: np.random.Generator) -> Array:
    """Standard deviations (n,) of an efficient estimator in the coordinates of the estimator: the Cramér-Rao bound from
    the information at the truth and the priors, with the effect of parameter bounds."""
    names = [p.name for p in found.parameters]
    problem = Problem(Likelihood(truth, process_noise=method == "prediction-error"), [record], names, 1)
    information, z = problem.evaluate(problem.start).information, problem.start
    P = scaled_inverse(information)
    if truth.considered:
        follow = P @ considered_information(problem, z)
        P = P + follow @ follow.T
    return np.sqrt(np.diag(P) + variance_change_by_bounds(information, P, z, problem.bounds, rng))


def variance_change_by_bounds(
    information: Array, P: Array, z: Array, bounds: Bounds, rng: np.random.Generator
) -> Array:
    """Change of the variances (n,) by parameter bounds, from ``N_DRAWS`` samples with and without projection."""
    free = z + rng.multivariate_normal(np.zeros(z.size), P, N_DRAWS, method="cholesky")
    kept = free.copy()
    for k in np.flatnonzero(((free < bounds.low) | (free > bounds.high)).any(axis=1)).tolist():
        pull = Evaluation(0.0, information @ (free[k] - z), information, np.zeros(z.size))
        kept[k] = z + solve_step(pull, information, z, bounds, 0.0)
    return np.asarray(kept.var(axis=0) - free.var(axis=0))


def _coordinates(parameters: Sequence[Parameter], values: Array) -> Array:
    return np.array([p.to_free(v) for p, v in zip(parameters, values.tolist(), strict=True)])


def _draw(model: Model, rng: np.random.Generator) -> Array:
    """The true values; what each record has for itself comes from its prior, and so does what is considered."""
    own = {p.name for p in model.parameters if p.free and p.per_record} | {*model.considered}
    return np.array(
        [
            p.prior[0] + p.prior[1] * rng.standard_normal() if p.name in own and p.prior else p.value
            for p in model.parameters
        ]
    )


def _finite(names: Sequence[str], values: Array) -> dict[str, float | None]:
    return {n: float(v) if np.isfinite(v) else None for n, v in zip(names, values, strict=True)}


@dataclass(frozen=True)
class ParameterCoverage:
    """Statistics of one parameter over all replicates; intervals are 95 %.

    Attributes:
        n: replicates with an interval.
        at_bound: replicates among them with the estimate at its bound.
        sd, bias, bias_error: in the coordinate of the estimator; bias in units of sd.
        ratio: variance over mean reported variance.
        bound_ratio: variance over the Cramér-Rao bound.
        coverage: empirical coverage of the 95 % intervals.
    """

    name: str
    n: int
    at_bound: int
    sd: float
    bias: float
    bias_error: float
    ratio: float
    ratio_interval: tuple[float, float]
    bound_ratio: float
    bound_interval: tuple[float, float]
    coverage: float
    coverage_interval: tuple[float, float]

    @property
    def misses(self) -> tuple[str, ...]:
        """Statistics outside their aims; marked ``(chance?)`` where the 95 % interval reaches into the aim."""
        bias = abs(self.bias) - Z95 * self.bias_error
        low, high = self.bound_interval
        found = [
            _miss("bias", abs(self.bias) > BIAS, bias > BIAS),
            _miss("variance", abs(self.bound_ratio - 1) > VARIANCE, low > 1 + VARIANCE or high < 1 - VARIANCE),
            _miss(
                "coverage",
                not COVERAGE[0] <= self.coverage <= COVERAGE[1],
                self.coverage_interval[1] < COVERAGE[0] or self.coverage_interval[0] > COVERAGE[1],
            ),
        ]
        return tuple(f for f in found if f)


def _miss(what: str, beyond: bool, significant: bool) -> str:
    return "" if not beyond else what if significant else f"{what} (chance?)"


def summarise(rows: Iterable[Row]) -> list[ParameterCoverage]:
    """Statistics of the parameters in order, without failed and unconverged replicates (``counts`` has them)."""
    good = [r for r in rows if r.get("converged")]
    names = dict.fromkeys(n for r in good for n in r["d"])
    return [j for n in names if (j := _statistics(n, [r for r in good if n in r["d"]])) is not None]


def _statistics(name: str, rows: Sequence[Row]) -> ParameterCoverage | None:
    known = [r for r in rows if {r["se"][name], r["far"][name]} != {None} and r["bound"][name] is not None]
    n = len(known)
    if n < 3:
        return None
    d, se, far, bound = (np.array([r[key][name] for r in known], dtype=float) for key in ("d", "se", "far", "bound"))
    at_bound = np.isnan(se)
    se = np.where(at_bound, np.abs(far - d) / Z95, se)
    variance, inside = float(d.var(ddof=1)), int(np.sum(np.where(at_bound, d * far <= 0, np.abs(d) < Z95 * se)))
    ratio, bound_ratio = variance / float(np.mean(se**2)), variance / float(np.mean(bound**2))
    low, high = (float((n - 1) / stats.chi2.ppf(q, n - 1)) for q in (0.975, 0.025))
    interval = stats.binomtest(inside, n).proportion_ci(method="exact")
    return ParameterCoverage(
        name,
        n,
        int(at_bound.sum()),
        float(np.sqrt(variance)),
        float(d.mean() / np.sqrt(variance)),
        1 / float(np.sqrt(n)),
        ratio,
        (ratio * low, ratio * high),
        bound_ratio,
        (bound_ratio * low, bound_ratio * high),
        inside / n,
        (float(interval.low), float(interval.high)),
    )


@dataclass(frozen=True)
class ReplicateCounts:
    """How many replicates there are, failed, did not converge; median CPU time of a fit and mean of a simulation [s],
    NaN without any."""

    replicates: int
    failed: int
    unconverged: int
    cpu_fit: float
    cpu_simulation: float


def counts(rows: Sequence[Row]) -> ReplicateCounts:
    """Of rows as ``run_replicates`` makes them."""
    good = [r for r in rows if "error" not in r]
    return ReplicateCounts(
        replicates=len(rows),
        failed=len(rows) - len(good),
        unconverged=sum(not r["converged"] for r in good),
        cpu_fit=float(np.median([r["cpu"] for r in good])) if good else float("nan"),
        cpu_simulation=float(np.mean([r["simulation"] for r in rows])) if rows else float("nan"),
    )


@cache
def estimator_code_hash() -> str:
    """A hash of what a result depends on."""
    digest = hashlib.sha256()
    for path in hashed_files():
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def hashed_files() -> list[Path]:
    """The files whose change may change a study's results."""
    root = Path(__file__).parents[1]
    return sorted(path for wing in HASHED_WINGS for path in (root / wing).rglob("*.py"))
