"""Maximum likelihood, or maximum a posteriori where parameters have priors, over any number of records."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from seatrial.ident.data import Record
from seatrial.ident.estimation.fisher_scoring import Iterations, Optimum, Problem, maximise, refine_lbfgsb
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.output_error import free_start
from seatrial.ident.estimation.restricted_likelihood import apply_reml
from seatrial.ident.estimation.standard_errors import (
    COLOURED,
    TOO_LONG,
    Sandwich,
    Uncertainty,
    assess,
    flat_coordinates,
    sandwich,
    widened,
    with_interval_information,
)
from seatrial.ident.model import Model, Parameter, segment_name
from seatrial.ident.model import with_outlier_model as with_outliers
from seatrial.ident.numerics import Array

Method = Literal["prediction-error", "output-error"]
TOLERANCE = 1e-6  # of the log-likelihood: parameters within about a thousandth of a standard error


@dataclass(frozen=True)
class EstimationOptions:
    """How parameters are estimated: chosen on the command line, kept with the fit.

    Attributes:
        outlier_model: contaminated normal innovations in all sensors (``seatrial.ident.model.outlier_density``);
        without it
            in those in which the model has them.
        reml: restricted maximum likelihood for noise (``seatrial.ident.estimation.restricted_likelihood``); not in
        output
            error, which has no noise parameters but those of the sensors.
        mean_order: propagation of the filter's mean, of first or second order; None: as the model says.
        method: extended Kalman filter between samples, or simulation without process noise.
        horizon: how far ahead predictions are judged [s]; None: the model's own.
    """

    outlier_model: bool = False
    reml: bool = False
    mean_order: Literal[1, 2] | None = None
    method: Method = "prediction-error"
    horizon: float | None = None

    def __post_init__(self) -> None:
        if self.method not in ("prediction-error", "output-error"):
            raise ValueError(f"no method {self.method!r}: prediction-error or output-error")

    @property
    def process_noise(self) -> bool:
        """Whether the model's process noise counts."""
        return self.method == "prediction-error"

    def with_mean_order(self, model: Model) -> Model:
        """The model with its mean propagated as chosen here."""
        return model if self.mean_order is None else replace(model, second_order=self.mean_order == 2)


@dataclass(frozen=True)
class SearchSettings:
    """How exactly one search for the maximum is carried out.

    Attributes:
        tolerance: gain in log-likelihood below which the search ends.
        max_iterations: of Fisher scoring.
        robust_errors: also standard errors that hold for autocorrelated residuals (sandwich covariance), and those of
            parameters on a flat likelihood. Both cost evaluations, which the many rough fits of a diagnosis spare.
        initial_state: of output error alone: the start of each record is estimated too
            (``seatrial.ident.estimation.output_error.free_start``), or taken for exact as the model gives it.
        joseph: Joseph's form of the covariance update, for a start that is uncertain by many orders.
        threads: records that are evaluated at once.
    """

    tolerance: float = TOLERANCE
    max_iterations: int = 60
    robust_errors: bool = True
    initial_state: Literal["free", "given"] = "free"
    joseph: bool = False
    threads: int = 2

    def __post_init__(self) -> None:
        if self.initial_state not in ("free", "given"):
            raise ValueError(f"no initial state {self.initial_state!r}: free or given")


# of a candidate's fit; the model that is kept is fitted exactly
ROUGH = SearchSettings(tolerance=0.02, robust_errors=False)


CLOSE_ENOUGH = 1e-2  # what may be left to gain where no step gains more


@dataclass(frozen=True)
class Fit:
    """An estimate and what is known of it, in the parameters' own units.

    parameters (n,): what was estimated, each record's own with its ``segment``, at their initial values, and their
    names, ``m_u`` or ``V_x@0``; values, errors (n,): errors are
    NaN for parameters at a bound or not informed, which ``flags`` names; limits (n,): of a parameter at its bound,
    the far end of its 95 % interval, NaN for all others; covariance, correlation (n, n); considered (n, n): what of the
    covariance comes from considered parameters, which what the same sensors measure does not feel;
    prior_weight (n,): the part of a parameter's information that its prior gave (1: the data said nothing);
    robust_errors (n,): from the sandwich covariance, valid when the residuals are coloured, NaN where they
    were not asked for; coloured: they are, so that errors and covariance are those of the sandwich where it is the
    larger (``_coloured``; never in output error); inflation (n,): by what factor it is, 1 where it is not;
    record_values (n_records, n_parameters): over ``model.parameters`` in order. The log-likelihood is the largest, also
    where the noise was then restricted; the log-posterior leaves out the constants of the priors.
    ``gain_left``: what one more step would gain; ``options``: what was asked for.
    """

    model: Model
    options: EstimationOptions
    records: tuple[str, ...]
    parameters: tuple[Parameter, ...]
    values: Array
    errors: Array
    limits: Array
    covariance: Array
    correlation: Array
    considered: Array
    prior_weight: Array
    robust_errors: Array
    coloured: bool
    inflation: Array
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

    @property
    def names(self) -> tuple[str, ...]:
        """Of the parameters: ``m_u``, ``V_x@0``."""
        return tuple(p.full_name for p in self.parameters)

    def estimate(self, name: str, record: int = 0) -> tuple[float, float]:
        """Value and standard error (NaN: fixed, at a bound, or not informed) of a parameter in a record."""
        for i, p in enumerate(self.parameters):
            if p.name == name and p.segment in (None, record):
                return float(self.values[i]), float(self.errors[i])
        return self.model.parameter(name).value, float("nan")

    @property
    def bic(self) -> float:
        """Schwarz's criterion; smaller is better."""
        return float(len(self.names) * np.log(self.n_measured) - 2.0 * self.log_likelihood)


def fit(
    model: Model,
    records: Sequence[Record],
    options: EstimationOptions | None = None,
    settings: SearchSettings | None = None,
    *,
    start: Mapping[str, float] | None = None,
    progress: Iterations | None = None,
) -> Fit:
    """Maximum likelihood (or maximum a posteriori) estimate of the free parameters of a model.

    Parameters:
        model: what is estimated, from its own values.
        records: at least one; they share all parameters but those that each record has for itself.
        options: plain maximum likelihood by prediction error where none are given.
        settings: of the search.
        start: values to begin with instead of the model's, ``V_x@0`` those of a record.
        progress: called with the iteration and the log-posterior.

    Raises ValueError, naming the record, where a record does not fit the model or cannot be evaluated, and naming all
    where the search diverges.
    """
    began = time.process_time()
    options, settings = options or EstimationOptions(), settings or SearchSettings()
    if not records:
        raise ValueError("no records to estimate from")
    model, begin = options.with_mean_order(model), dict[str, float]()
    if not options.process_noise and settings.initial_state == "free":
        model, begin = free_start(model, records)
    own = {segment_name(p.name, i) for p in model.parameters if p.per_record for i in range(len(records))}
    begin |= {n: v for n, v in (start or {}).items() if n in own}
    model = model.with_values({n: v for n, v in (start or {}).items() if n not in own})
    if options.outlier_model:
        model = _with_outliers(model, records, options, settings, begin)
    likelihood = Likelihood(model, joseph=settings.joseph, process_noise=options.process_noise)
    problem = Problem(likelihood, records, _estimable(model, options), settings.threads, begin)
    _check_enough(problem)
    mean, weight = problem.prior
    options = replace(options, reml=options.reml and options.process_noise)
    try:
        optimum = _search(problem, settings, progress)
        prior_part = -0.5 * float(weight @ (optimum.z - mean) ** 2)
        optimum = apply_reml(problem, optimum) if options.reml else optimum
        known, robust = _known(problem, optimum, settings.robust_errors)
    except np.linalg.LinAlgError as error:
        names = ", ".join(r.name for r in records)
        raise ValueError(f"{names}: the search for the parameters of model {model.name} diverged: {error}") from error
    coloured = options.process_noise and _coloured(problem, robust)
    if coloured or (not options.process_noise and settings.robust_errors):
        lost = np.isfinite(known.errors) & np.isnan(robust.errors)
        too_long = [(problem.names[i], TOO_LONG) for i in np.flatnonzero(lost).tolist()]
        known = replace(known, flags=(*known.flags, *too_long))
    known = widened(known, robust.least) if coloured else known
    return _report(problem, optimum, known, robust.errors, coloured, options, prior_part, time.process_time() - began)


def _check_enough(problem: Problem) -> None:
    """Raises ValueError where there is nothing to estimate, or less to do it from."""
    if not problem.names:
        raise ValueError(f"model {problem.model.name} has no free parameters")
    told = sum(problem.likelihood.measured(record) for record in problem.records)
    unknown = int(np.sum(problem.prior[1] == 0))
    if told < unknown:
        names = ", ".join(r.name for r in problem.records)
        raise ValueError(
            f"{names}: {told} measured samples for {unknown} free parameters of model "
            f"{problem.model.name} without a prior; give more data, or fix some of them"
        )


def _known(problem: Problem, optimum: Optimum, coloured: bool) -> tuple[Uncertainty, Sandwich]:
    """What is known of the estimates, and errors that allow for coloured residuals, NaN where not asked for."""
    z, slopes = optimum.z, problem.slopes(optimum.z)
    # A search's many rough fits need neither: both cost evaluations.
    information, bounds = optimum.at.information, problem.bounds
    flat = flat_coordinates(problem.value, z, problem.parameters, information, bounds) if coloured else []
    considered = considered_information(problem, z) if coloured and problem.model.considered else None
    known = assess(
        with_interval_information(optimum.at, flat),
        z,
        problem.bounds,
        problem.names,
        slopes,
        problem.prior[1],
        considered,
    )
    known = replace(known, flags=(*known.flags, *[(problem.names[p.at], p.remark) for p in flat]))
    robust = Sandwich(*np.full((3, z.size), np.nan))
    if coloured:
        robust = sandwich(known, problem.by_row(z), slopes, problem.prior[1])
    for p in flat:
        robust.errors[p.at] = robust.least[p.at] = known.errors[p.at]  # no row has a part in it
    return known, robust


def considered_information(problem: Problem, z: Array) -> Array:
    """Information (n, n_considered) between the estimates and the considered parameters, per standard deviation of the
    latter."""
    names = problem.model.considered
    begin = dict(zip(problem.names, problem.own(z).tolist(), strict=True))
    both = Problem(problem.likelihood, problem.records, (*problem.free, *names), problem.threads, begin)
    at = {name: i for i, name in enumerate(both.names)}
    own, other = [at[n] for n in problem.names], [at[n] for n in names]
    return both.evaluate(both.start).information[np.ix_(own, other)] / np.sqrt(both.prior[1][other])


def _coloured(problem: Problem, robust: Sandwich) -> bool:
    """Whether the information matrix test rejects the errors of any parameter but noise, whose scores depend on the
    fourth moment of the residuals, too."""
    noise = problem.model.noise_parameters
    p = np.array([p for p, q in zip(robust.p.tolist(), problem.parameters, strict=True) if q.name not in noise])
    return bool((p * np.isfinite(p).sum() < COLOURED).any())


def _with_outliers(
    model: Model,
    records: Sequence[Record],
    options: EstimationOptions,
    settings: SearchSettings,
    begin: Mapping[str, float],
) -> Model:
    """The model with outliers allowed, at the better of two starts: its own values, or those of a plain fit.

    Outliers are told from good samples by the noise, so its scale must be about right first, which a plain fit
    sees to; but one far outlier can spoil that fit, or make it impossible.
    """
    own = with_outliers(model)
    try:
        # output error's starts are free in this model already, or meant to be as they are
        plain = fit(
            model,
            records,
            EstimationOptions(method=options.method),
            replace(settings, initial_state="given", robust_errors=False),
            start=begin,
        ).model
    except ValueError:
        return own
    likelihood, starts = Likelihood(own, process_noise=options.process_noise), (own, with_outliers(plain))
    totals = [sum(likelihood.value(r, np.array(list(m.values.values()))) for r in records) for m in starts]
    return starts[1] if totals[1] > totals[0] or not np.isfinite(totals[0]) else own


def _estimable(model: Model, options: EstimationOptions) -> tuple[str, ...]:
    """Output error knows nothing of process noise and of the uncertainty of the initial state."""
    if options.process_noise:
        return model.free
    ignored = {s.noise for s in model.states} | {s.sd0 for s in model.states}
    return tuple(n for n in model.free if n not in ignored)


def _search(problem: Problem, settings: SearchSettings, progress: Iterations | None) -> Optimum:
    tolerance, max_iterations = settings.tolerance, settings.max_iterations
    z = problem.bounds.clip(problem.start)
    if not problem.evaluate(z).finite:
        problem.check(z)
    optimum = maximise(
        problem.evaluate, z, problem.bounds, max_iterations=max_iterations, tolerance=tolerance, progress=progress
    )
    if abs(optimum.gain_left) > tolerance and optimum.iterations < max_iterations:
        optimum = refine_lbfgsb(problem.value_and_gradient, optimum, problem.bounds, problem.evaluate, tolerance)
    return optimum


def _report(
    problem: Problem,
    optimum: Optimum,
    known: Uncertainty,
    robust: Array,
    coloured: bool,
    options: EstimationOptions,
    prior_part: float,
    cpu_seconds: float,
) -> Fit:
    record_values = problem.values(optimum.z)
    names = [p.name for p in problem.model.parameters]
    model = problem.model.with_values(dict(zip(names, record_values.mean(axis=0), strict=True)))
    plain = np.abs(problem.slopes(optimum.z)) * np.sqrt(np.diag(known.P + known.spread))
    inflation = np.where(np.isfinite(plain), np.fmax(known.errors / plain, 1.0), 1.0)
    converged = abs(optimum.gain_left) < CLOSE_ENOUGH
    message = (
        f"converged in {optimum.iterations} iterations"
        if converged
        else f"stopped after {optimum.iterations} iterations with {optimum.gain_left:.3g} left to gain"
    )
    return Fit(
        model=model,
        options=options,
        records=tuple(r.name for r in problem.records),
        parameters=problem.parameters,
        values=problem.own(optimum.z),
        errors=known.errors,
        limits=problem.own(known.limits),
        covariance=known.covariance,
        correlation=known.correlation,
        considered=known.considered,
        prior_weight=known.prior_weight,
        robust_errors=robust,
        coloured=coloured,
        inflation=inflation,
        record_values=record_values,
        log_likelihood=optimum.at.value - prior_part,
        log_posterior=optimum.at.value,
        n_measured=sum(problem.likelihood.measured(r) for r in problem.records),
        gradient_norm=known.gradient_norm,
        gain_left=optimum.gain_left,
        iterations=optimum.iterations,
        evaluations=optimum.evaluations,
        cpu_seconds=cpu_seconds,
        flags=known.flags,
        converged=converged,
        message=message,
    )
