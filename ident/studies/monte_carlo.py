"""Monte Carlo study of the estimator: bias, variance and interval coverage on data simulated with the model itself.

Each replicate is simulated with process and measurement noise (``seatrial.ident.estimation.stochastic_simulation``,
plain numpy) and estimated by ``seatrial.ident.estimation.maximum_likelihood``. All statistics are in the coordinate of
the estimator (the logarithm of a positive parameter), because its standard error refers to this coordinate:

    bias     = mean(d) / sd(d),  d = estimate - truth
    ratio    = var(d) / mean(variance that each fit reported)
    bound    = var(d) / mean(Cramér-Rao bound at the truth), which is compared with the aim
    coverage = share of |d| < 1.96 standard errors, which shows whether the reported errors are right

An estimate at its bound also counts. Its interval goes from the bound to ``Fit.limits``, and its standard error is the
length of the interval over 1.96. Near bounds no estimate is unbiased, and the Cramér-Rao bound is not the least
variance. The reference is then an efficient estimate: normal with the information at the truth, projected onto the
bounds in the metric of that information (Self and Liang 1987, Andrews 1999).
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

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
    simulate_stochastic,
    solve_step,
    with_free_initial_states,
)
from seatrial.ident.model import Model, Parameter
from seatrial.ident.numerics import Array, scaled_inverse
from seatrial.ident.results import APART, BIAS, COVERAGE, VARIANCE

Row = dict[str, Any]
Z95 = 1.96
N_DRAWS = 400  # samples of an efficient estimate near bounds, for each replicate
# packages that the results of a study depend on
HASHED_PACKAGES = (
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
    """Case of a Monte Carlo study: a model at the true values of its parameters, and the inputs of a mission.

    Attributes
    ----------
    name
        Name of the case.
    model
        Model at the true values. The order of the filter mean is a property of the model.
    inputs
        Inputs of the mission, which also define the rows (instants) of the simulated records.
    every
        Sample interval of each sensor, in rows, by name of the sensor (default 1: a sample in each row).
    about
        Description for reports.
    reml
        Whether noise parameters are estimated by restricted maximum likelihood (REML), as the commands do.
    """

    name: str
    model: Model
    inputs: SampledInputs
    every: Mapping[str, int]
    about: str = ""
    reml: bool = True

    def with_truth(self, truth: Mapping[str, float]) -> Case:
        """Return the case with other true values; ``truth`` has them by name of the parameter.

        An unknown name raises KeyError, a value outside the bounds of its parameter ValueError.
        """
        return replace(self, model=self.model.with_values(truth))


def run_replicates(case: Case, numbers: Sequence[int], seed: int, method: Method = "prediction-error") -> list[Row]:
    """Simulate and estimate independent replicates of a case: the same mission, each with its own noise.

    Parameters
    ----------
    case
        The case.
    numbers
        Numbers of the replicates.
    seed
        Seed of the study. Seed and number together determine a replicate.
    method
        Method of the estimation: ``prediction-error`` or ``output-error``.

    Returns
    -------
    list of Row
        One row for each replicate, a dictionary: its number ``k``, the mean CPU time ``simulation`` [s] of a simulation
        in this call, and the keys of `estimate`. The row of a failed fit (ValueError, ArithmeticError or LinAlgError)
        has the key ``error``, with a message, in place of the keys of `estimate`. Other errors are raised.
    """
    rngs = [np.random.default_rng([seed, k]) for k in numbers]
    truths = np.array([_draw_truth(case.model, rng) for rng in rngs])
    began = time.process_time()
    states, y = simulate_stochastic(case.model, case.inputs, truths, rngs)
    simulation = (time.process_time() - began) / len(numbers)
    rows = []
    for k, rng, truth, x, measured in zip(numbers, rngs, truths, states, y, strict=True):
        record = make_record(case, measured, f"{case.name} {k}")
        row: Row = {"k": k, "simulation": simulation}
        try:
            row |= estimate(case, record, truth, x[0], rng, method)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as problem:  # a failure is counted in the summary
            row |= {"error": f"{type(problem).__name__}: {problem}"}
        rows.append(row)
    return rows


def read_replicates(path: Path) -> list[Row]:
    """Read the replicates that earlier runs of a study have stored, so that they need not be repeated.

    Parameters
    ----------
    path
        File of JSON lines, one replicate in each. It need not exist.

    Returns
    -------
    list of Row
        Rows of `run_replicates` with the keys ``key`` (hash of case, seed and estimator) and ``code`` (hash of the
        code). Failed replicates, lines that are no valid JSON (for example the last one of a stopped run) and lines
        without these keys are left out. The list is empty if there is no file.
    """
    rows = []
    for text in path.read_text(encoding="utf-8").splitlines() if path.exists() else ():
        try:
            row = json.loads(text)
        except json.JSONDecodeError:
            continue
        if isinstance(row, dict) and {"k", "key", "code"} <= set(row) and "error" not in row:
            rows.append(row)
    return rows


def make_record(case: Case, y: Array, name: str) -> Record:
    """Return a record of a case with simulated measurements, sampled at the rates of its sensors.

    Parameters
    ----------
    case
        The case, which gives inputs and sample rates.
    y
        Measurements in all rows (n_rows, n_outputs). The array is not changed.
    name
        Name of the record.

    Returns
    -------
    Record
        Measurements that are NaN in rows in which their sensor does not sample.
    """
    model, inputs, seen, column = case.model, case.inputs, np.full(y.shape, np.nan), 0
    for sensor in model.sensors:
        rows, columns = np.s_[:: case.every.get(sensor.name, 1)], np.s_[column : column + len(sensor.outputs)]
        seen[rows, columns] = y[rows, columns]
        column = columns.stop
    names = tuple(i.name for i in model.inputs), tuple(o.name for o in model.outputs)
    return Record(name, inputs.t, inputs.u, inputs.u_next, seen, *names)


def estimate(case: Case, record: Record, truth: Array, x0: Array, rng: np.random.Generator, method: Method) -> Row:
    """Fit one replicate from random initial values and return its errors.

    An initial value is the true value times exp(z) within the bounds, with z uniform from -0.4 to 0.4; that of a
    per-record parameter is its value in the model.

    Parameters
    ----------
    case, record
        The case, and the simulated record.
    truth : Array (n_parameters,)
        True parameter values.
    x0 : Array (n_states,)
        True initial states, which are used only for output error.
    rng
        Random generator of the replicate.
    method
        Method of the estimation: ``prediction-error`` or ``output-error``.

    Returns
    -------
    Row
        ``converged``, ``iterations`` and CPU time ``cpu`` [s] of the fit. By parameter name, in the coordinate of the
        estimator (the logarithm of a positive parameter): errors ``d`` (estimate minus truth), standard errors ``se``,
        Cramér-Rao ``bound`` of the standard error, and ``far`` for an estimate at its bound: far end of its 95 %
        interval minus truth. Except in ``d``, a value that is not finite is None. ``flags``: problems of estimates, by
        parameter name. The names are those of the free parameters and, for output error, ``x0_NAME`` of the initial
        states.
    """
    model = replace(case.model, second_order=case.model.second_order and method == "prediction-error")
    true_values = dict(zip([p.name for p in model.parameters], truth.tolist(), strict=True))
    shared = [p for p in model.parameters if p.free and not p.per_record]
    drawn = {p.name: p.value * float(np.exp(rng.uniform(-APART, APART))) for p in shared}
    start = {p.name: float(np.clip(drawn[p.name], *p.bounds)) for p in shared}
    start |= {p.name: p.value for p in model.parameters if p.per_record}
    began = time.process_time()
    if method == "output-error":
        true_values |= {f"x0_{s.name}": float(x) for s, x in zip(model.states, x0, strict=True)}
        model = with_free_initial_states(model, [record])[0]
    true_values = {n: true_values[n] for n in model.values}
    options = EstimationOptions(reml=case.reml, method=method)
    found = fit(model, [record], options, SearchSettings(threads=1), start=start)
    cpu = time.process_time() - began
    parameters = found.parameters
    names = [p.name for p in parameters]
    z = _estimator_coordinates(parameters, found.values)
    slope = np.array([p.slope(v) for p, v in zip(parameters, found.values, strict=True)])
    name_of = {p.full_name: p.name for p in parameters}
    true = np.array([p.to_free(true_values[p.name]) for p in parameters])
    return {
        "converged": found.converged,
        "iterations": found.iterations,
        "cpu": cpu,
        "d": dict(zip(names, (z - true).tolist(), strict=True)),
        "se": _finite_by_name(names, found.errors / slope),
        "far": _finite_by_name(names, _estimator_coordinates(parameters, found.limits) - true),
        "bound": _finite_by_name(names, cramer_rao_errors(model.with_values(true_values), record, found, method, rng)),
        "flags": {name_of[n]: what for n, what in found.flags},
    }


def cramer_rao_errors(truth: Model, record: Record, found: Fit, method: Method, rng: np.random.Generator) -> Array:
    """Return the standard deviations (n,) of an efficient estimator, in the coordinates of the estimator.

    They are the Cramér-Rao bound, from the information at the truth and the priors, with the effect of parameter bounds
    and of considered parameters (not estimated, with an uncertain prior). A study compares its errors with them. The
    coordinates are the logarithms of positive parameters and the other parameters themselves.

    Parameters
    ----------
    truth
        Model at the true values.
    record
        The simulated record.
    found
        Fit of the record; only the selection and order of its n parameters are used.
    method
        Method of the estimation.
    rng
        Random generator of the replicate.
    """
    names = [p.name for p in found.parameters]
    problem = Problem(Likelihood(truth, process_noise=method == "prediction-error"), [record], names, 1)
    information, z = problem.evaluate(problem.initial_coordinates).information, problem.initial_coordinates
    P = scaled_inverse(information)
    if truth.considered:
        follow = P @ considered_information(problem, z)
        P = P + follow @ follow.T
    return np.sqrt(np.diag(P) + variance_change_by_bounds(information, P, z, problem.bounds, rng))


def variance_change_by_bounds(
    information: Array, P: Array, z: Array, bounds: Bounds, rng: np.random.Generator
) -> Array:
    """Return the change of the variances (n,) of an efficient estimator by parameter bounds; zero far from all bounds.

    It is a Monte Carlo estimate: the variances of 400 draws of an unbounded efficient estimate are compared with those
    of the same draws projected onto the bounds.

    Parameters
    ----------
    information, P : Array (n, n)
        Fisher information at the truth, and the covariance of the unbounded estimate (its inverse, plus the effect of
        considered parameters).
    z : Array (n,)
        True values in the coordinates of the estimator.
    bounds
        Bounds in these coordinates.
    rng
        Random generator.
    """
    free = z + rng.multivariate_normal(np.zeros(z.size), P, N_DRAWS, method="cholesky")
    kept = free.copy()
    for k in np.flatnonzero(((free < bounds.low) | (free > bounds.high)).any(axis=1)).tolist():
        pull = Evaluation(0.0, information @ (free[k] - z), information, np.zeros(z.size))
        kept[k] = z + solve_step(pull, information, z, bounds, 0.0)
    return np.asarray(kept.var(axis=0) - free.var(axis=0))


def _estimator_coordinates(parameters: Sequence[Parameter], values: Array) -> Array:
    """Return parameter values (n,) in the coordinates of the estimator: the logarithm for a positive parameter."""
    return np.array([p.to_free(v) for p, v in zip(parameters, values.tolist(), strict=True)])


def _draw_truth(model: Model, rng: np.random.Generator) -> Array:
    """Draw the true values of all parameters (n_parameters,) of one simulated replicate.

    Free per-record parameters (such as the current) and considered parameters (not estimated, with an uncertain prior)
    are drawn from their normal priors. All others, and those without a prior, have their values in the model.
    """
    drawn = {p.name for p in model.parameters if p.free and p.per_record} | {*model.considered}
    return np.array(
        [
            p.prior[0] + p.prior[1] * rng.standard_normal() if p.name in drawn and p.prior else p.value
            for p in model.parameters
        ]
    )


def _finite_by_name(names: Sequence[str], values: Array) -> dict[str, float | None]:
    """Return a dict from names to the values (n,), with None in place of NaN and infinity."""
    return {n: float(v) if np.isfinite(v) else None for n, v in zip(names, values, strict=True)}


@dataclass(frozen=True)
class ParameterCoverage:
    """Bias, variance and interval coverage of one parameter's estimates over the usable replicates of a study.

    A replicate is usable if its fit converged and the parameter has an interval and a Cramér-Rao bound. Intervals are
    95 %.

    Attributes
    ----------
    name
        Name of the parameter.
    n
        Number of usable replicates.
    at_bound
        Number of these replicates with the estimate at its bound.
    sd
        Standard deviation of the errors, in the coordinate of the estimator (the logarithm of a positive parameter).
    bias, bias_error
        Bias and its standard error, in units of ``sd``.
    ratio, ratio_interval
        Variance of the errors over the mean variance that the fits reported, and its interval.
    bound_ratio, bound_interval
        Variance of the errors over the Cramér-Rao bound, and its interval.
    coverage, coverage_interval
        Share of the 95 % intervals that contain the true value, and its interval.
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
        """Names of the statistics outside their aims: ``bias``, ``variance`` (over the Cramér-Rao bound), ``coverage``.

        The aims are a bias of at most 0.15 standard deviations, a variance ratio of 0.9 to 1.1, and a coverage of 93 to
        97 %. ``(chance?)`` follows a name if the 95 % interval of the statistic reaches into the aim.
        """
        bias = abs(self.bias) - Z95 * self.bias_error
        low, high = self.bound_interval
        found = [
            _missed_statistic("bias", abs(self.bias) > BIAS, bias > BIAS),
            _missed_statistic(
                "variance", abs(self.bound_ratio - 1) > VARIANCE, low > 1 + VARIANCE or high < 1 - VARIANCE
            ),
            _missed_statistic(
                "coverage",
                not COVERAGE[0] <= self.coverage <= COVERAGE[1],
                self.coverage_interval[1] < COVERAGE[0] or self.coverage_interval[0] > COVERAGE[1],
            ),
        ]
        return tuple(f for f in found if f)


def _missed_statistic(statistic: str, beyond: bool, significant: bool) -> str:
    """Return the name of a statistic, such as ``bias``, if it is outside its aim (``beyond``); otherwise an empty text.

    ``(chance?)`` follows the name unless the miss is ``significant``.
    """
    return "" if not beyond else statistic if significant else f"{statistic} (chance?)"


def summarise(rows: Iterable[Row]) -> list[ParameterCoverage]:
    """Return bias, variance and coverage of each parameter over the rows of `run_replicates`.

    Failed and unconverged replicates are left out, and so are parameters with fewer than three usable replicates. The
    parameters are in the order in which the rows first contain them.
    """
    good = [r for r in rows if r.get("converged")]
    names = dict.fromkeys(n for r in good for n in r["d"])
    return [j for n in names if (j := _parameter_coverage(n, [r for r in good if n in r["d"]])) is not None]


def _parameter_coverage(name: str, rows: Sequence[Row]) -> ParameterCoverage | None:
    """Return bias, variance and coverage of the parameter ``name`` over rows of replicates, all of which contain it.

    A row is usable if it has a Cramér-Rao bound, and either a standard error or, for an estimate at its bound, the far
    end of its interval. The result is None with fewer than three usable rows.
    """
    from scipy import stats  # imported here: it takes a second, and every process of a fleet loads this module

    usable = [r for r in rows if {r["se"][name], r["far"][name]} != {None} and r["bound"][name] is not None]
    n = len(usable)
    if n < 3:
        return None
    d, se, far, bound = (np.array([r[key][name] for r in usable], dtype=float) for key in ("d", "se", "far", "bound"))
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
    """Number of replicates and time of a study.

    Attributes
    ----------
    replicates, failed, unconverged
        Number of all replicates, of those whose fit raised an error, and of those whose fit did not converge.
    cpu_fit
        Median CPU time of a fit [s] over all fits without an error, converged or not; NaN without any.
    cpu_simulation
        Mean CPU time of a simulation [s], NaN without replicates.
    """

    replicates: int
    failed: int
    unconverged: int
    cpu_fit: float
    cpu_simulation: float


def count_replicates(rows: Sequence[Row]) -> ReplicateCounts:
    """Count the replicates by their success, and summarise their CPU times; ``rows`` are those of `run_replicates`."""
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
    """Return a hash (12 hexadecimal digits) of the source files that the results of a study depend on.

    It is stored with each replicate, so that a study can warn about stored replicates of another version of the code.
    The hash is computed once per process.
    """
    digest = hashlib.sha256()
    for path in hashed_files():
        digest.update(path.read_bytes())
    return digest.hexdigest()[:12]


def hashed_files() -> list[Path]:
    """Return the Python files whose change may change the results of a study, in order of their paths.

    They are all files of ten packages of ``seatrial.ident``, such as the models and the estimation.
    """
    root = Path(__file__).parents[1]
    return sorted(path for package in HASHED_PACKAGES for path in (root / package).rglob("*.py"))
