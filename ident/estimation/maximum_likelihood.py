"""Maximum likelihood estimation over any number of records; maximum a posteriori if parameters have priors."""

from __future__ import annotations

import itertools
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident.data import Record
from seatrial.ident.estimation.fisher_scoring import Bounds, Iterations, Optimum, Problem, maximise, refine_lbfgsb
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.output_error import with_free_initial_states
from seatrial.ident.estimation.restricted_likelihood import apply_reml
from seatrial.ident.estimation.standard_errors import (
    AUTOCORRELATED_TOO_LONG,
    COLOURED_P_VALUE,
    FLAGGED_INFLATION,
    Z_95,
    Sandwich,
    Uncertainty,
    assess,
    flat_coordinates,
    sandwich,
    widened,
    with_interval_information,
)
from seatrial.ident.model import Flag, Model, Parameter, segment_name
from seatrial.ident.model import with_outlier_model as with_outliers
from seatrial.ident.numerics import Array

Method = Literal["prediction-error", "output-error"]
TOLERANCE = 1e-6  # of the log-likelihood: parameters are then exact to about a thousandth of a standard error


@dataclass(frozen=True)
class EstimationOptions:
    """Options that define an estimate: method, outliers and noise. The command line sets them, and the fit keeps them.

    ValueError is raised for an unknown method.

    Attributes
    ----------
    outlier_model
        Whether all sensors get the outlier model: contaminated normal innovations
        (``seatrial.ident.model.outlier_density``). Otherwise only the sensors for which the model has it.
    reml
        Whether the noise is estimated by restricted maximum likelihood
        (``seatrial.ident.estimation.restricted_likelihood``). It has no effect in output error, which has no noise
        parameters except those of the sensors.
    mean_order
        1: the mean follows the model's equations. 2: the curvature term ``1/2 tr(P f_xx)`` is added (second-order
        extended Kalman filter). None: as the model specifies.
    method
        ``prediction-error``: extended Kalman filter between samples. ``output-error``: simulation without process
        noise.
    horizon
        Time [s] over which predictions are compared with validation data; None: that of the model. The fit itself does
        not depend on it.
    """

    outlier_model: bool = False
    reml: bool = False
    mean_order: Literal[1, 2] | None = None
    method: Method = "prediction-error"
    horizon: float | None = None

    def __post_init__(self) -> None:
        """Raise ValueError if the estimation method is unknown."""
        if self.method not in ("prediction-error", "output-error"):
            raise ValueError(f"there is no estimation method {self.method!r}; use prediction-error or output-error")

    @property
    def process_noise(self) -> bool:
        """Whether the likelihood includes the process noise: True for prediction error, False for output error.

        Prediction error runs an extended Kalman filter; output error is a simulation.
        """
        return self.method == "prediction-error"

    def with_mean_order(self, model: Model) -> Model:
        """Return the model with the filter mean of order ``mean_order``: 1, or 2 with the curvature term.

        It is the same model if ``mean_order`` is None.
        """
        return model if self.mean_order is None else replace(model, second_order=self.mean_order == 2)


@dataclass(frozen=True)
class SearchSettings:
    """Settings of one search for the maximum of the likelihood: accuracy and effort.

    ValueError is raised for an unknown ``initial_state``.

    Attributes
    ----------
    tolerance
        The search ends if the expected gain of the next step in log-likelihood is smaller.
    max_iterations
        Largest number of iterations of Fisher scoring.
    robust_errors
        Whether to compute robust standard errors, the standard errors of parameters with a flat likelihood, and the
        part of all errors that comes from considered parameters. These cost evaluations, which the many rough fits of a
        diagnosis avoid.
    initial_state
        For output error only. ``free``: the initial state of each record is estimated
        (``seatrial.ident.estimation.output_error.with_free_initial_states``). ``given``: it is that of the model, taken
        as exact.
    joseph
        Whether to use Joseph's form of the covariance update, for an initial state that is uncertain by many orders of
        magnitude.
    threads
        Largest number of records that are evaluated at the same time.
    refine
        Whether to continue by L-BFGS-B if Fisher scoring stops before it has converged and before ``max_iterations``.
        It can take many iterations.
    """

    tolerance: float = TOLERANCE
    max_iterations: int = 60
    robust_errors: bool = True
    initial_state: Literal["free", "given"] = "free"
    joseph: bool = False
    threads: int = 2
    refine: bool = True

    def __post_init__(self) -> None:
        """Check the settings. Raise ValueError if ``initial_state`` is another word than ``free`` or ``given``."""
        if self.initial_state not in ("free", "given"):
            raise ValueError(f"initial_state is {self.initial_state!r}; use free or given")


# For the fits of candidates in a diagnosis. The model that is kept is fitted again with the default settings.
ROUGH_SEARCH = SearchSettings(tolerance=0.02, robust_errors=False)


# The estimates are about sqrt(2 gain) standard errors from the maximum, if one more step is expected to gain this much
# log-posterior. Up to the first limit, 0.14 standard errors, this does not matter. Up to the second limit, half
# a standard error, the fit counts as converged, but its results say so. The tolerance of the settings may be larger.
MAX_GAIN_LEFT = 1e-2
LARGEST_GAIN_LEFT = 0.125
# For the fit with a dead zone at its bound: iterations, and the least fall of the log-posterior that counts
AT_BOUND_ITERATIONS, LEAST_FALL = 8, 0.125


def distance_from_maximum(gain: float) -> float:
    """Return how many standard errors the estimates are away from the maximum, from the gain of one more step.

    ``gain`` is the expected gain in log-posterior; the distance is ``sqrt(2 |gain|)``, as for a parabola.
    """
    return float(np.sqrt(2.0 * abs(gain)))


@dataclass(frozen=True)
class Fit:
    """Estimates of a model's free parameters with their uncertainty, in the parameters' own units.

    Attributes
    ----------
    model
        Model with the estimates as values; per-record parameters have their mean over the records.
    options
        Options with which the estimates were computed.
    records
        Names of the records.
    parameters
        The n estimated parameters with their initial values. A per-record parameter appears once for each record, with
        the index of the record as its ``segment``.
    values, errors : Array (n,)
        Estimates and standard errors. An error is NaN if the parameter is at a bound, not identified, or of unknown
        order of magnitude; ``flags`` then contains the reason.
    limits : Array (n,)
        For a parameter at its bound, the far end of its 95 % interval, NaN without information about it; NaN for all
        others.
    covariance, correlation : Array (n, n)
        Covariance and correlation of the estimates; NaN for parameters without a standard error.
    considered : Array (n, n)
        Part of the covariance that comes from an incomplete model (``seatrial.ident.diagnosis.model_uncertainty``) and
        from considered parameters: parameters that are held while the uncertainty of their priors counts. It does not
        affect predictions of what the same sensors measure.
    prior_weight : Array (n,)
        Share of a parameter's information that comes from its prior; 1 if the data contain no information, and 0
        without a standard error.
    robust_errors : Array (n,)
        Standard errors from the sandwich covariance, valid for coloured (autocorrelated) residuals. NaN if they were
        not requested, for parameters without a standard error, and for residuals autocorrelated for too long. For a
        parameter with a flat likelihood they are those of ``errors``.
    coloured
        Whether the residuals are coloured: the information matrix test rejects the standard error of a parameter. The
        errors and the covariance are then those of the sandwich covariance if these are larger. Always False in output
        error.
    inflation : Array (n,)
        Factor by which coloured residuals increased each standard error; 1 for none.
    record_values : Array (n_records, n_parameters)
        Values of all parameters for each record, in the order of ``model.parameters``.
    log_likelihood
        Log-likelihood at the maximum of the log-posterior. The later step of REML does not change this number.
    log_posterior
        Log-likelihood plus the logarithms of the priors, without their constants.
    n_measured
        Number of scalar measurements in all records.
    gradient_norm
        Length of the gradient in standard errors: about the distance of the estimates from the maximum.
    gain_left
        Expected gain in log-posterior of one more step.
    iterations, evaluations
        Numbers of iterations of the search and of evaluations of the likelihood. Fisher scoring does not count
        evaluations without derivatives.
    cpu_seconds
        Processor time of the fit [s].
    flags
        Pairs (full name of a parameter, flag), such as "at its bound".
    converged, message
        Whether one more step is expected to gain less than 0.125 in log-posterior (the estimates are then within half a
        standard error of the maximum), or less than the tolerance of the search if that is larger; and a clause about
        the end of the search.
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
    flags: tuple[tuple[str, Flag], ...]
    converged: bool
    message: str

    @property
    def names(self) -> tuple[str, ...]:
        """Full names of the estimated parameters, such as ``m_u``, or ``V_x@0`` for the value of record 0."""
        return tuple(p.full_name for p in self.parameters)

    def estimate(self, name: str, record: int = 0) -> tuple[float, float]:
        """Return the value and the standard error of a parameter in a record.

        The value of a fixed parameter is that of the model. The error is NaN if the parameter is fixed or has no
        standard error. KeyError is raised if the model lacks the parameter.

        Parameters
        ----------
        name
            Name without the index of the record: ``V_x``.
        record
            Index of the record. It matters only for per-record parameters, for which another index than those of the
            fit's records gives the mean over the records and NaN.
        """
        for i, p in enumerate(self.parameters):
            if p.name == name and p.segment in (None, record):
                return float(self.values[i]), float(self.errors[i])
        return self.model.parameter(name).value, float("nan")

    def start_values(self, model: Model) -> dict[str, float]:
        """Return the estimates by full name, as initial values for a fit of another model to the same records.

        Estimates of parameters that ``model`` lacks or does not estimate, and of other per-record kind, are left out.
        """
        known = {p.name: p for p in model.parameters if p.free}
        return {
            p.full_name: float(value)
            for p, value in zip(self.parameters, self.values, strict=True)
            if p.name in known and known[p.name].per_record == (p.segment is not None)
        }

    @property
    def distance_left(self) -> float | None:
        """Distance of the estimates from the maximum in standard errors; None up to 0.14, which does not matter."""
        return distance_from_maximum(self.gain_left) if abs(self.gain_left) > MAX_GAIN_LEFT else None

    @property
    def aic(self) -> float:
        """Akaike information criterion ``2 n - 2 ln L`` with n estimated parameters. Smaller is better."""
        return 2.0 * len(self.names) - 2.0 * self.log_likelihood

    @property
    def bic(self) -> float:
        """Bayesian information criterion ``n ln(n_measured) - 2 ln L`` with n estimated parameters (Schwarz).

        Smaller is better.
        """
        return float(len(self.names) * np.log(self.n_measured) - 2.0 * self.log_likelihood)


def fit(
    model: Model,
    records: Sequence[Record],
    options: EstimationOptions | None = None,
    settings: SearchSettings | None = None,
    *,
    start: Mapping[str, float] | None = None,
    other_starts: Sequence[Mapping[str, float]] = (),
    progress: Iterations | None = None,
) -> Fit:
    """Estimate the free parameters of a model by maximum likelihood, or maximum a posteriori if there are priors.

    Parameters
    ----------
    model
        Model with its initial values.
    records
        At least one record. The records share all parameters except per-record ones.
    options
        Method, outliers and noise. None: prediction error, without outliers and REML.
    settings
        Accuracy and effort of the search. None: the defaults of `SearchSettings`.
    start
        Initial values by parameter, which replace those of the model. ``V_x@0`` is the value of V_x in record 0 only;
        one outside its bounds is moved onto them, any other value outside raises ValueError. KeyError is raised for a
        name that is no parameter.
    other_starts
        Further sets of initial values by full name; each replaces some of ``start``. Names that are not estimated are
        ignored. The search begins at the set with the highest log-posterior.
    progress
        Called in each iteration of the search with its number and the log-posterior. In a refinement by L-BFGS-B, each
        evaluation counts as an iteration.

    Returns
    -------
    Fit
        Estimates and their uncertainty. A search that does not converge is no error: see ``Fit.converged``.

    Raises
    ------
    ValueError
        If there is no record, no free parameter or too little data; if a record does not match the model or cannot be
        evaluated (the message names it); or if the search diverges (the message names all records).
    """
    began = time.process_time()
    options, settings = options or EstimationOptions(), settings or SearchSettings()
    if not records:
        raise ValueError("there is no record to estimate the parameters from; give at least one")
    model, begin = options.with_mean_order(model), dict[str, float]()
    if not options.process_noise and settings.initial_state == "free":
        model, begin = with_free_initial_states(model, records)
    own = {segment_name(p.name, i) for p in model.parameters if p.per_record for i in range(len(records))}
    begin |= {n: v for n, v in (start or {}).items() if n in own}
    model = model.with_values({n: v for n, v in (start or {}).items() if n not in own})
    if options.outlier_model:
        model = _with_outlier_model_and_start(model, records, options, settings, begin)
    likelihood = Likelihood(model, joseph=settings.joseph, process_noise=options.process_noise)
    problem = Problem(likelihood, records, _estimable_parameters(model, options), settings.threads, begin)
    _check_data(problem)
    mean, weight = problem.prior
    options = replace(options, reml=options.reml and options.process_noise)
    try:
        optimum = _search_maximum(problem, settings, progress, _best_start(problem, other_starts))
        prior_part = -0.5 * float(weight @ (optimum.z - mean) ** 2)
        optimum = apply_reml(problem, optimum) if options.reml else optimum
        known, robust = _assess_uncertainty(problem, optimum, settings.robust_errors)
    except np.linalg.LinAlgError as error:
        names = ", ".join(r.name for r in records)
        raise ValueError(
            f"{names}: the search for the parameters of model {model.name} diverged: {error}; give other initial "
            "values, or fix some parameters"
        ) from error
    coloured = options.process_noise and _residuals_are_coloured(problem, robust)
    if coloured or (not options.process_noise and settings.robust_errors):
        lost = np.isfinite(known.errors) & np.isnan(robust.errors)
        too_long = [(problem.names[i], AUTOCORRELATED_TOO_LONG) for i in np.flatnonzero(lost).tolist()]
        known = replace(known, flags=(*known.flags, *too_long))
    known = widened(known, robust.least) if coloured else known
    return _assembled_fit(
        problem, optimum, known, robust.errors, coloured, options, settings, prior_part, time.process_time() - began
    )


def _check_data(problem: Problem) -> None:
    """Raise ValueError if the data cannot determine the free parameters of a fit.

    The model must have a free parameter, and at least as many measured values as free parameters without a prior.
    ``problem`` is the objective of the fit.
    """
    if not problem.names:
        raise ValueError(
            f"model {problem.model.name} has no free parameters to estimate; leave out a --fix, or free a parameter"
        )
    n_measured = sum(problem.likelihood.measured(record) for record in problem.records)
    n_unknown = int(np.sum(problem.prior[1] == 0))
    if n_measured < n_unknown:
        names = ", ".join(r.name for r in problem.records)
        raise ValueError(
            f"{names}: {n_measured} measured samples for {n_unknown} free parameters of model "
            f"{problem.model.name} without a prior; give more data, or fix some of them"
        )


def _assess_uncertainty(problem: Problem, optimum: Optimum, with_robust: bool) -> tuple[Uncertainty, Sandwich]:
    """Return the uncertainty of the estimates from the information, and the robust standard errors.

    Parameters
    ----------
    problem
        Objective of the fit.
    optimum
        Maximum of the objective.
    with_robust
        Whether to compute four things that cost evaluations: robust errors, the uncertainty from considered parameters
        (not estimated, with an uncertain prior), the intervals of parameters with a flat likelihood, and how far a
        parameter at its bound may leave it. Otherwise the robust errors are NaN, and the other three are left out.
    """
    z, slopes = optimum.z, problem.slopes(optimum.z)
    # The many rough fits of a diagnosis skip what costs evaluations.
    information, bounds = optimum.at.information, problem.bounds
    flat = flat_coordinates(problem.value, z, problem.parameters, information, bounds) if with_robust else []
    considered = considered_information(problem, z) if with_robust and problem.model.considered else None
    known = assess(
        with_interval_information(optimum.at, flat),
        z,
        problem.bounds,
        problem.names,
        slopes,
        problem.prior[1],
        considered,
        problem.value if with_robust else None,
    )
    known = replace(known, flags=(*known.flags, *[(problem.names[p.coordinate], p.flag) for p in flat]))
    robust = Sandwich(*np.full((3, z.size), np.nan))
    if with_robust:
        robust = sandwich(known, problem.by_row(z), slopes, problem.prior[1])
    for p in flat:
        # the interval of a flat coordinate does not come from contributions of rows
        robust.errors[p.coordinate] = robust.least[p.coordinate] = known.errors[p.coordinate]
    return _widened_to_bound(problem, optimum, known) if with_robust else known, robust


def _widened_to_bound(problem: Problem, optimum: Optimum, known: Uncertainty) -> Uncertainty:
    """Widen the standard error of a dead zone if the likelihood falls less down to zero than this error says.

    It concerns a parameter whose likelihood may have several maxima (``Model.start_grid`` with ``gaining``), with a
    lower bound that is more than 1.96 standard errors away. The likelihood has an edge at each command, so that the
    curvature at the estimate may be that of one edge. The model is fitted again with the parameter at the bound; the
    new error is that of a parabola with the same fall of the log-posterior.
    """
    grid, z = problem.model.start_grid, optimum.z
    if grid is None or not grid.gaining or grid.names[0] not in problem.names:
        return known
    i, bounds = problem.names.index(grid.names[0]), problem.bounds
    distance = float(z[i] - bounds.low[i])
    if bounds.logarithmic[i] or not np.isfinite(distance) or not distance > Z_95 * known.errors[i]:
        return known
    high, start = bounds.high.copy(), z - np.nan_to_num(known.P[:, i]) / known.P[i, i] * distance
    high[i] = start[i] = bounds.low[i]
    held = Bounds(bounds.low, high, bounds.logarithmic)
    at_bound = maximise(
        problem.evaluate, held.clip(start), held, max_iterations=AT_BOUND_ITERATIONS, tolerance=0.1, value=problem.value
    )
    fall = max(optimum.at.value - at_bound.at.value, LEAST_FALL)
    error = distance / np.sqrt(2.0 * fall)
    if not error > FLAGGED_INFLATION * known.errors[i]:
        return known
    errors = np.full(z.size, np.nan)
    errors[i] = error
    text = (
        f"its error is {error / known.errors[i]:.1f} times as large as from the curvature: with "
        f"{problem.names[i]} = {bounds.low[i]:g} the log-likelihood is only {fall:.1f} smaller"
    )
    wider = widened(known, errors)
    return replace(wider, flags=(*wider.flags, (problem.names[i], Flag("larger error", text))))


def considered_information(problem: Problem, z: Array) -> Array:
    """Return the Fisher information between the estimates and the considered parameters.

    A considered parameter is not estimated, but the uncertainty of its prior increases the errors of the estimates.

    Parameters
    ----------
    problem
        Objective of the fit.
    z : Array (n,)
        Estimates in the estimator's coordinates (logarithms of positive parameters).

    Returns
    -------
    Array (n, n_considered)
        Off-diagonal block of the information matrix, multiplied by the prior standard deviation of each considered
        parameter. The columns are in the order of ``model.considered``.
    """
    names = problem.model.considered
    begin = dict(zip(problem.names, problem.natural_values(z).tolist(), strict=True))
    both = Problem(problem.likelihood, problem.records, (*problem.free, *names), problem.threads, begin)
    at = {name: i for i, name in enumerate(both.names)}
    own, other = [at[n] for n in problem.names], [at[n] for n in names]
    return both.evaluate(both.initial_coordinates).information[np.ix_(own, other)] / np.sqrt(both.prior[1][other])


def _residuals_are_coloured(problem: Problem, robust: Sandwich) -> bool:
    """Return whether the information matrix test rejects the standard error of any parameter except noise.

    The residuals are then autocorrelated (coloured), and robust standard errors are used. The test rejects if the
    smallest p value in ``robust`` times the number of tested parameters is below 0.001. NaN is not counted. Parameters
    of noise are not tested: their scores also depend on the fourth moment of the residuals, so that the test does not
    apply.
    """
    noise = problem.model.noise_parameters
    p = np.array([p for p, q in zip(robust.p.tolist(), problem.parameters, strict=True) if q.name not in noise])
    return bool((p * np.isfinite(p).sum() < COLOURED_P_VALUE).any())


def _with_outlier_model_and_start(
    model: Model,
    records: Sequence[Record],
    options: EstimationOptions,
    settings: SearchSettings,
    begin: Mapping[str, float],
) -> Model:
    """Add the outlier model (contaminated normal noise) to a model, with the better of two sets of initial values.

    One set is the model's own values; the other one comes from a fit without the outlier model. The set with the larger
    log-likelihood is taken. If the fit without the outlier model fails, the model's own values are taken.

    Parameters
    ----------
    model
        Model without the outlier model. The initial states of output error are already parameters of the model.
    records
        Records of the fit.
    options, settings
        Options and settings of the fit with the outlier model. The fit without it has the same method and search.
    begin
        Initial values of per-record parameters: ``V_x@0`` is V_x in record 0.

    Notes
    -----
    Outliers can be separated from good samples only if the noise is about right. A plain fit estimates it. A single far
    outlier can distort that fit or make it fail, so that the model's own values are tried, too.
    """
    own = with_outliers(model)
    try:
        # "given": the initial states of output error are already free in this model, or fixed on purpose
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


def _estimable_parameters(model: Model, options: EstimationOptions) -> tuple[str, ...]:
    """Return the names of the free parameters that the method can estimate, in the order of the model.

    These are all free parameters in prediction error. Output error has neither process noise nor uncertainty of the
    initial state, so that their standard deviations are left out.
    """
    if options.process_noise:
        return model.free
    ignored = {s.noise for s in model.states} | {s.sd0 for s in model.states}
    return tuple(n for n in model.free if n not in ignored)


def _best_start(problem: Problem, other_starts: Sequence[Mapping[str, float]]) -> Array:
    """Return the initial coordinates (n,) with the highest log-posterior, clipped to the bounds.

    They are those of the problem, or those with the values by full name of one of ``other_starts`` in their place. A
    set whose log-posterior is not finite is not chosen.
    """
    first = problem.bounds.clip(problem.initial_coordinates)
    if not other_starts:
        return first
    pairs = list(zip(problem.names, problem.parameters, strict=True))
    starts = [first]
    for given in other_starts:
        moved = [p.to_free(given[n]) if n in given else z for (n, p), z in zip(pairs, first.tolist(), strict=True)]
        starts.append(problem.bounds.clip(np.array(moved)))
    # The value takes a tenth of the time of an evaluation with derivatives.
    values = np.array([problem.value(z) for z in starts])
    return starts[int(np.argmax(np.where(np.isfinite(values), values, -np.inf)))]


def _search_maximum(problem: Problem, settings: SearchSettings, progress: Iterations | None, z: Array) -> Optimum:
    """Search for the maximum by Fisher scoring, and by L-BFGS-B if scoring stops before it has converged.

    L-BFGS-B is not used if the settings exclude it or if the largest number of iterations is reached. ``progress`` is
    called in each iteration of Fisher scoring with its number and the objective. The search begins at the coordinates
    ``z`` (n,), inside the bounds. ValueError is raised if the log-likelihood of a record is not finite there; the
    message names it.
    """
    tolerance, max_iterations = settings.tolerance, settings.max_iterations
    start = problem.evaluate(z)
    if not start.finite:
        problem.check(z)
    optimum = maximise(
        problem.evaluate, z, problem.bounds, max_iterations=max_iterations, tolerance=tolerance, progress=progress,
        value=problem.value, start=start,
    )  # fmt: skip
    if settings.refine and abs(optimum.gain_left) > tolerance and optimum.iterations < max_iterations:
        numbers = itertools.count(optimum.iterations)

        def counted_value_and_gradient(at: Array) -> tuple[float, Array]:
            """Return the objective and its gradient (n,), and report the evaluation as an iteration."""
            found = problem.value_and_gradient(at)
            if progress is not None:
                progress(next(numbers), found[0])
            return found

        optimum = refine_lbfgsb(counted_value_and_gradient, optimum, problem.bounds, problem.evaluate, tolerance)
    return optimum


def _assembled_fit(
    problem: Problem,
    optimum: Optimum,
    known: Uncertainty,
    robust: Array,
    coloured: bool,
    options: EstimationOptions,
    settings: SearchSettings,
    prior_part: float,
    cpu_seconds: float,
) -> Fit:
    """Collect the results of a search in a `Fit`, in the parameters' own units.

    Parameters
    ----------
    problem, optimum
        Objective of the fit, and its maximum.
    known
        Uncertainty of the estimates, already widened if the residuals are coloured.
    robust : Array (n,)
        Robust standard errors.
    coloured
        Whether the residuals are coloured.
    options, settings
        Options and settings of the fit. The tolerance of the settings enters the criterion of convergence.
    prior_part
        Part of the log-posterior that comes from the priors, at most 0.
    cpu_seconds
        Processor time [s].
    """
    record_values = problem.values(optimum.z)
    names = [p.name for p in problem.model.parameters]
    model = problem.model.with_values(dict(zip(names, record_values.mean(axis=0), strict=True)))
    plain = np.abs(problem.slopes(optimum.z)) * np.sqrt(np.diag(known.P + known.spread))
    inflation = np.where(np.isfinite(plain), np.fmax(known.errors / plain, 1.0), 1.0)
    converged = abs(optimum.gain_left) < max(LARGEST_GAIN_LEFT, settings.tolerance)
    message = (
        "converged"  # the iterations of this fit, which usually starts at the estimates of another one, say little
        if converged
        else f"stopped after {counted(optimum.iterations, 'iteration')}; "
        f"its estimates can still move by {distance_from_maximum(optimum.gain_left):.2g} standard errors"
    )
    return Fit(
        model=model,
        options=options,
        records=tuple(r.name for r in problem.records),
        parameters=problem.parameters,
        values=problem.natural_values(optimum.z),
        errors=known.errors,
        limits=problem.natural_values(known.limits),
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
