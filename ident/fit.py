"""Maximum likelihood, or maximum a posteriori where parameters have priors, over any number of records."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np
from numpy.typing import NDArray

from ident.dataset import Record
from ident.model import Model
from ident.pe import Likelihood
from ident.plateau import informed, plateaus
from ident.restricted import restrict
from ident.robust import robust as with_outliers
from ident.scoring import Bounds, Evaluation, Optimum, climb, maximise
from ident.uncertainty import Uncertainty, assess, sandwich

Array = NDArray[np.float64]
TOLERANCE = 1e-6  # of the log-likelihood: parameters within about a thousandth of a standard error
CLOSE_ENOUGH = 1e-2  # what may be left to gain where no step gains more
Progress = Callable[[int, float], None]
T = TypeVar("T")


@dataclass(frozen=True)
class Fit:
    """An estimate and what is known of it, in the parameters' own units.

    names (n,): ``m_u`` for shared parameters, ``V_x@0`` for those of record 0; values, errors (n,): errors are
    NaN for parameters at a bound or not informed, which ``flags`` names; limits (n,): of a parameter at its bound,
    the far end of its 95 % interval, NaN for all others; covariance, correlation (n, n);
    prior_weight (n,): the part of a parameter's information that its prior gave (1: the data said nothing);
    robust_errors (n,): from the sandwich covariance, valid when the residuals are coloured, NaN where they
    were not asked for; record_values (n_records, n_parameters): over ``model.parameters`` in order. The log-likelihood
    is the largest, also where the noise was then restricted; the log-posterior leaves out the constants of the priors.
    ``gain_left``: what one more step would gain.
    """

    model: Model
    method: str
    records: tuple[str, ...]
    names: tuple[str, ...]
    values: Array
    errors: Array
    limits: Array
    covariance: Array
    correlation: Array
    prior_weight: Array
    robust_errors: Array
    record_values: Array
    log_likelihood: float
    log_posterior: float
    n_measured: int
    gradient_norm: float
    gain_left: float
    iterations: int
    evaluations: int
    cpu_seconds: float
    flags: tuple[tuple[str, str], ...]
    converged: bool
    message: str

    def estimate(self, name: str, record: int = 0) -> tuple[float, float]:
        """Value and standard error (NaN: fixed, at a bound, or not informed) of a parameter in a record."""
        for full in (name, f"{name}@{record}"):
            if full in self.names:
                i = self.names.index(full)
                return float(self.values[i]), float(self.errors[i])
        return self.model.parameter(name).value, float("nan")

    @property
    def bic(self) -> float:
        """Schwarz's criterion; smaller is better."""
        return float(len(self.names) * np.log(self.n_measured) - 2.0 * self.log_likelihood)


class Problem:
    """The free coordinates of a fit, and the objective over them."""

    def __init__(self, likelihood: Likelihood, records: Sequence[Record], free: Sequence[str], threads: int) -> None:
        self.likelihood, self.records = likelihood, tuple(records)
        model = self.model = likelihood.model
        index = {p.name: i for i, p in enumerate(model.parameters)}
        shared = [n for n in free if not model.parameter(n).per_record]
        own = [n for n in free if model.parameter(n).per_record]
        self.free = (*shared, *own)
        self.names = (*shared, *[f"{n}@{i}" for i in range(len(records)) for n in own])
        self.parameters = [model.parameter(n.partition("@")[0]) for n in self.names]
        self.columns = [index[p.name] for p in self.parameters]
        # places[i]: where record i's free parameters stand among the coordinates
        first = len(shared)
        self.places = [[*range(first), *range(first + i * len(own), first + (i + 1) * len(own))]
                       for i in range(len(records))]
        self.base = np.array([p.value for p in model.parameters])
        self.threads = max(1, min(threads, len(records)))

    @cached_property
    def bounds(self) -> Bounds:
        low, high = np.array([p.free_bounds() for p in self.parameters]).reshape(-1, 2).T
        return Bounds(low, high, np.array([p.transform == "log" for p in self.parameters], dtype=bool))

    @property
    def start(self) -> Array:
        return np.array([p.to_free(p.value) for p in self.parameters])

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
        return [(places, slope[places] * scores.by_row) for places, scores in zip(self.places, rows, strict=True)
                if scores.by_row is not None]

    def check(self, z: Array) -> None:
        """Raise ValueError naming the first record that cannot be evaluated."""
        for record, values in zip(self.records, self.values(z), strict=True):
            if not np.isfinite(self.likelihood.value(record, values)):
                raise ValueError(f"record {record.name}: the likelihood of model {self.model.name} cannot be "
                                 "evaluated at the starting values")

    def _map(self, work: Callable[[int, Array], T], z: Array) -> list[T]:
        values = self.values(z)
        if self.threads == 1:
            return [work(i, v) for i, v in enumerate(values)]
        with ThreadPoolExecutor(self.threads) as pool:  # the kernels leave Python's lock
            return list(pool.map(work, range(len(values)), values))


def fit(
    model: Model,
    records: Sequence[Record],
    *,
    method: Literal["pe", "oe"] = "pe",
    start: Mapping[str, float] | None = None,
    robust: bool = False,
    restricted: bool = False,
    max_iterations: int = 60,
    tolerance: float = TOLERANCE,
    coloured: bool = True,
    progress: Progress | None = None,
    threads: int = 2,
) -> Fit:
    """Estimate the free parameters of ``model`` from ``records``.

    method: prediction error (extended Kalman filter), or output error (no process noise). start: values to begin
    with instead of the model's. robust: allow outliers in all sensors (``ident.robust`` allows them in some).
    restricted: estimate noise without the bias that the dynamics give it (``ident.restricted``; not in output error).
    tolerance: gain in log-likelihood below which the search ends. coloured: work out ``robust_errors``. progress:
    called with the iteration and the log-posterior. Raises ValueError, naming the record, where a record does not fit
    the model or cannot be evaluated.
    """
    began = time.process_time()
    if not records:
        raise ValueError("no records to estimate from")
    model = model.with_values(start or {})
    if robust:
        model = _with_outliers(model, records, method, max_iterations, threads)
    likelihood = Likelihood(model, process_noise=method == "pe")
    problem = Problem(likelihood, records, _estimable(model, method), threads)
    if not problem.names:
        raise ValueError(f"model {model.name} has no free parameters")
    for record in records:
        likelihood.measured(record)
    optimum = _search(problem, max_iterations, tolerance, progress)
    mean, weight = problem.prior
    prior_part = -0.5 * float(weight @ (optimum.z - mean) ** 2)
    optimum = restrict(problem, optimum) if restricted and method == "pe" else optimum
    flat = plateaus(lambda z: problem.value_and_gradient(z)[0], optimum.z, problem.parameters, optimum.at.information,
                    problem.bounds)
    slopes = problem.slopes(optimum.z)
    known = assess(informed(optimum.at, flat), optimum.z, problem.bounds, problem.names, slopes, weight)
    known = replace(known, flags=(*known.flags, *[(problem.names[p.at], p.remark) for p in flat]))
    robust_errors = np.full(optimum.z.size, np.nan)
    if coloured:
        robust_errors = sandwich(known, problem.by_row(optimum.z), slopes)
        for p in flat:
            robust_errors[p.at] = known.errors[p.at]  # no row has a part in it
    return _report(problem, optimum, known, robust_errors, method, prior_part, time.process_time() - began)


def _with_outliers(model: Model, records: Sequence[Record], method: Literal["pe", "oe"], max_iterations: int,
                   threads: int) -> Model:
    """The model with outliers allowed, at the better of two starts: its own values, or those of a plain fit.

    Wild samples are told from good ones by the noise, so its scale must be about right first, which a plain fit
    sees to; but one very wild sample can spoil that fit, or make it impossible.
    """
    own = with_outliers(model)
    try:
        plain = fit(model, records, method=method, max_iterations=max_iterations, threads=threads).model
    except ValueError:
        return own
    likelihood, starts = Likelihood(own, process_noise=method == "pe"), (own, with_outliers(plain))
    totals = [sum(likelihood.value(r, np.array(list(m.values.values()))) for r in records) for m in starts]
    return starts[1] if totals[1] > totals[0] or not np.isfinite(totals[0]) else own


def _estimable(model: Model, method: str) -> tuple[str, ...]:
    """Output error knows nothing of process noise and of the uncertainty of the initial state."""
    if method == "pe":
        return model.free
    ignored = {s.noise for s in model.states} | {s.sd0 for s in model.states}
    return tuple(n for n in model.free if n not in ignored)


def _search(problem: Problem, max_iterations: int, tolerance: float, progress: Progress | None) -> Optimum:
    z = problem.bounds.clip(problem.start)
    if not problem.evaluate(z).finite:
        problem.check(z)
    optimum = maximise(problem.evaluate, z, problem.bounds, max_iterations=max_iterations, tolerance=tolerance,
                       progress=progress)
    if abs(optimum.gain_left) > tolerance and optimum.iterations < max_iterations:
        optimum = climb(problem.value_and_gradient, optimum, problem.bounds, problem.evaluate,
                        tolerance)
    return optimum


def _report(problem: Problem, optimum: Optimum, known: Uncertainty, robust: Array, method: str, prior_part: float,
            cpu_seconds: float) -> Fit:
    record_values = problem.values(optimum.z)
    names = [p.name for p in problem.model.parameters]
    model = problem.model.with_values(dict(zip(names, record_values.mean(axis=0), strict=True)))
    converged = abs(optimum.gain_left) < CLOSE_ENOUGH
    message = (f"converged in {optimum.iterations} iterations" if converged else
               f"stopped after {optimum.iterations} iterations with {optimum.gain_left:.3g} left to gain")
    return Fit(
        model=model, method=method, records=tuple(r.name for r in problem.records), names=problem.names,
        values=problem.own(optimum.z), errors=known.errors, limits=problem.own(known.limits),
        covariance=known.covariance, correlation=known.correlation, prior_weight=known.prior_weight,
        robust_errors=robust, record_values=record_values,
        log_likelihood=optimum.at.value - prior_part, log_posterior=optimum.at.value,
        n_measured=sum(problem.likelihood.measured(r) for r in problem.records),
        gradient_norm=known.gradient_norm, gain_left=optimum.gain_left, iterations=optimum.iterations,
        evaluations=optimum.evaluations, cpu_seconds=cpu_seconds, flags=known.flags, converged=converged,
        message=message)
