"""Fit of a model to estimation data, with its evaluation on validation data. A diagnosis compares such fits."""

from __future__ import annotations

import contextlib
import itertools
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import Annotated, Literal

import msgspec
import numpy as np
from msgspec import Meta

from seatrial.daq.errors import counted
from seatrial.ident.data import LogSegment, Record, make_record
from seatrial.ident.effects import WAVES
from seatrial.ident.estimation.cross_validation import TimeBlocks, leave_one_block_out, time_blocks
from seatrial.ident.estimation.likelihood import FilterResult, Likelihood
from seatrial.ident.estimation.maximum_likelihood import (
    ROUGH_SEARCH,
    EstimationOptions,
    Fit,
    SearchSettings,
    fit,
)
from seatrial.ident.estimation.multistart import MIN_GAIN, best_of_starts
from seatrial.ident.estimation.smoother import SmoothedStates, smoothed_states
from seatrial.ident.estimation.wave_peak import other_wave_start
from seatrial.ident.model import Effect, EffectKind, Model, Parameter, ParameterOrigin, outlier_notes, segment_name
from seatrial.ident.model import with_outlier_model as with_outliers
from seatrial.ident.models import forces_of, rescale, rescale_effects, residuals_of, size_of, with_disturbances
from seatrial.ident.numerics import NORMAL_MAD, Array, noise_from_differences
from seatrial.ident.reporter import QUIET, Reporter

# Estimated noise has collapsed to zero if it is below this share of the white noise that the samples show.
COLLAPSED_NOISE = 1e-2
# Innovations larger than the declared noise by the first factor contradict it. The declared value then becomes a prior
# with the second number as its relative standard deviation.
CONTRADICTED_NOISE, DECLARED_NOISE_SD = 1.5, 0.125
RESCALING_RATIO = 2.0  # priors are scaled again if estimated and assumed force or moment differ by this factor
AS_LIKELY = 2.0  # a refit may lose this much ln L by its new priors; if it loses more, its search failed
FIT_ERRORS = (ValueError, ArithmeticError, np.linalg.LinAlgError)  # raised if a model cannot be evaluated on a record

Role = Literal["estimation", "validation"]  # role of a record in a fit
TIME_STEP_S = 10.0  # between the times at which an effect is tried that begins in a run
ValidationData = Sequence[Record] | TimeBlocks  # validation records, or blocks of the estimation records


class FailedRun(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Validation run that cannot be evaluated.

    Attributes
    ----------
    record
        Name of the run.
    reason
        Text of the error that was raised.
    """

    record: Annotated[str, Meta(description="name of the run's record")]
    reason: Annotated[str, Meta(description="why the model could not be evaluated on the run")]


@dataclass(frozen=True)
class FittedModel:
    """A model, its fit to the estimation data, and its evaluation on each record of estimation and validation data.

    On validation data only per-record parameters (the current) are estimated.

    Attributes
    ----------
    model
        Model before the fit, with its initial values.
    fit
        Fit to the estimation data.
    estimation, validation
        Evaluation of the fitted model on each record of the estimation data and of the validation data.
    failed
        Validation runs that could not be evaluated; they are not in ``validation``.
    cross_validated
        Whether ``validation`` contains blocks in time of the estimation records, because there are no validation runs.
        Each block is evaluated with the estimates from the other blocks.
    in_blocks
        Whether ``validation`` contains blocks in time of records, of the estimation data (``cross_validated``) or of
        the validation data (`validated_in_blocks`).
    """

    model: Model
    fit: Fit
    estimation: tuple[RecordEvaluation, ...]
    validation: tuple[RecordEvaluation, ...]
    failed: tuple[FailedRun, ...] = ()
    cross_validated: bool = False
    in_blocks: bool = False

    @property
    def records(self) -> list[Record]:
        """Records of the estimation data, in order, with the inputs and outputs of the fitted model only."""
        return [v.record for v in self.estimation]

    @property
    def outlier_notes(self) -> list[str]:
        """Sentences that count the outliers in the estimation data; empty for a model without the outlier model."""
        runs, measured = [v.run.outliers for v in self.estimation], [np.isfinite(r.y) for r in self.records]
        return outlier_notes(self.model, runs, measured)


@dataclass(frozen=True)
class RecordEvaluation:
    """A fitted model on one record: its filter output, log-likelihood and smoothed states.

    Filter and smoother run at the first access.

    Attributes
    ----------
    model
        Model with the estimates as values.
    record
        Record with the inputs and outputs of the model.
    values : Array (n_parameters,)
        Estimates for this record, in the order of ``model.parameters``.
    """

    model: Model
    record: Record
    values: Array

    @cached_property
    def run(self) -> FilterResult:
        """Output of the extended Kalman filter: filtered states, covariances and innovations."""
        return Likelihood(self.model).filter(self.record, self.values)

    @cached_property
    def ll(self) -> Array:
        """Contribution of each row (instant of the record) to the log-likelihood (n_rows,).

        It is cheaper than `run`, and enough for most candidates of a diagnosis. It is not finite from the row on in
        which the filter diverges.
        """
        return Likelihood(self.model).value_by_row(self.record, self.values)

    @cached_property
    def smoothed(self) -> SmoothedStates:
        """Means and standard deviations of the states, given all samples of the record."""
        return smoothed_states(self.run)


def fit_nominal_model(
    model: Model,
    estimation: Sequence[LogSegment],
    validation: Sequence[LogSegment],
    options: EstimationOptions | None = None,
    *,
    rate: float = 10.0,
    settings: SearchSettings | None = None,
    start: Mapping[str, float] | None = None,
    reporter: Reporter = QUIET,
) -> FittedModel:
    """Fit the model with disturbance forces and sensor offsets as states, without a search for missing effects.

    Parameters
    ----------
    model
        Model to fit. Disturbance forces and sensor offsets are added if it has no disturbance force and can have one
        (`nominal_model`).
    estimation, validation
        Logs to which the model is fitted, and logs on which the fit is evaluated.
    options
        Method, outliers and noise. None: prediction error, without outliers and REML.
    rate
        Rate [Hz] of the rows of a record. Faster sensors are averaged to it.
    settings
        Accuracy of the fit; None: the default.
    start
        Initial values by full name, which replace those of the model (`fit`). None: no such values.
    reporter
        Receives a line of progress, and the iterations as its details.

    Returns
    -------
    FittedModel
        Fit with its evaluation. Validation logs that cannot be converted or evaluated are in ``failed``. Without
        validation logs, ``validation`` is empty: there is no cross-validation.

    Raises
    ------
    ValueError, ArithmeticError
        If an estimation log cannot be converted to a record, or if the fit fails.
    """
    full = nominal_model(model)
    records = [make_record(full, r, rate) for r in estimation]
    validation_data, failed = validation_records(full, validation, rate)
    reporter.progress(f"fitting {full.name} to {counted(len(records), 'run')}")
    validation_data = without_unknown_noise(full, records, validation_data)
    full = without_absent_sensors(full, records)
    fitted = fit_with_restarts(full, records, validation_data, options, settings, start, reporter)
    return replace(fitted, failed=(*failed, *fitted.failed))


def fit_with_restarts(
    full: Model,
    records: Sequence[Record],
    validation_data: ValidationData,
    options: EstimationOptions | None = None,
    settings: SearchSettings | None = None,
    start: Mapping[str, float] | None = None,
    reporter: Reporter = QUIET,
) -> FittedModel:
    """Fit a model (`fit_with_rescaling`), also from other initial values of its effects of the surroundings.

    The likelihood has several maxima in the frequency of waves, and in the lever arms of a wind that has little force.
    The fit begins again with `other_wave_start`, and with the initial values of the effects of the surroundings beside
    the estimates of all other parameters. From the latter, a rough search shows first whether the maximum is higher.
    The fit with the highest log-posterior is returned.

    Parameters
    ----------
    full, records, validation_data, options, settings, start
        Arguments of `fit_with_rescaling`, which raises the errors.
    reporter
        Receives a line of progress for each further fit, and the iterations as details.
    """

    def better(fitted: FittedModel, begin: Mapping[str, float]) -> FittedModel:
        """Return the better one of a fit and of a fit from these initial values."""
        with contextlib.suppress(*FIT_ERRORS):
            again = {**(start or {}), **begin}
            other = fit_with_rescaling(full, records, validation_data, options, settings, again, reporter.detail)
            if other.fit.log_posterior > fitted.fit.log_posterior + MIN_GAIN:
                return other
        return fitted

    fitted = fit_with_rescaling(full, records, validation_data, options, settings, start, reporter.detail)
    if missed := other_wave_start(fitted.fit.model, [view.run for view in fitted.estimation]):
        reporter.progress(f"fitting {full.name} again: waves of {missed['f_wave']:.2g} Hz are left in its residuals")
        fitted = better(fitted, missed)
    if initial := _initial_values_of_surroundings(fitted.fit.model):
        with contextlib.suppress(*FIT_ERRORS):
            begin = {**fitted.fit.start_values(full), **initial}
            rough = fit_and_evaluate(full, records, (), options, ROUGH_SEARCH, begin)
            if rough.fit.log_posterior > fitted.fit.log_posterior + MIN_GAIN:
                reporter.progress(f"fitting {full.name} again: other initial values of its effects are better")
                fitted = better(fitted, rough.fit.start_values(full))
    return fitted


def _initial_values_of_surroundings(model: Model) -> dict[str, float]:
    """Return the initial values, by parameter, of effects of the surroundings that have three parameters or more.

    These have a shape beside their size. Without a size, the likelihood does not depend on the shape, such as a lever
    arm of the wind. Waves (`other_wave_start`), disturbance forces and effects with per-record parameters are left out.
    """
    free, values = set(model.free) - model.noises, dict[str, float]()
    for e in model.effects:
        own = [p for p in e.parameters if p.name in free]
        if e.place == "environment" and e.name != WAVES.name and not any(p.per_record for p in own) and len(own) > 2:
            values |= {p.name: p.value for p in own}
    return values


def validation_records(
    model: Model, segments: Sequence[LogSegment], rate: float
) -> tuple[list[Record], tuple[FailedRun, ...]]:
    """Convert validation runs to records of the model's inputs and outputs.

    A run for which the conversion raises ValueError or ArithmeticError raises no error here.

    Parameters
    ----------
    model
        Model whose inputs and outputs the records have.
    segments
        Validation runs.
    rate
        Rate of the rows of a record [Hz], to which faster sensors are averaged.

    Returns
    -------
    records, failed
        The records, and the runs that cannot be converted with the reason, both in the order of ``segments``.
    """
    records, failed = list[Record](), list[FailedRun]()
    for segment in segments:
        try:
            records.append(make_record(model, segment, rate))
        except FIT_ERRORS as problem:
            failed.append(FailedRun(segment.name, str(problem)))
    return records, tuple(failed)


def fit_with_rescaling(
    full: Model,
    records: Sequence[Record],
    validation_data: ValidationData,
    options: EstimationOptions | None = None,
    settings: SearchSettings | None = None,
    start: Mapping[str, float] | None = None,
    detail: Callable[[str], None] | None = None,
) -> FittedModel:
    """Fit a model with disturbance forces and sensor offsets, and fit it again if its priors turn out to be wrong.

    A second fit follows if the boat's force or moment scale by the estimated masses (`size_of`) differs from that by
    the initial ones by a factor of two or more, or if the innovations contradict the declared noise of the sensors. In
    the first case the priors of effects are scaled too. If the second fit fails, does not converge or is much less
    likely than the first, it is repeated from the shared estimates of the first fit.

    Parameters
    ----------
    full
        Model with disturbance forces and sensor offsets as states, a result of `nominal_model`.
    records, validation_data
        Estimation records; and validation records, or blocks in time of the estimation records for cross-validation.
    options
        Method, outliers and noise. None: prediction error, without outliers and REML.
    settings
        Accuracy of the fits; None: the default.
    start
        Initial values by full name, which replace those of the model (`fit`), except in a fit that is repeated. None:
        no such values.
    detail
        Called with a text in each iteration of the searches, such as ``second fit: iteration 7``.

    Returns
    -------
    FittedModel
        The first fit if no second one is needed. Otherwise the first refit that has converged and loses less than 2 in
        log-likelihood against the first fit, or else the best refit. If only the first fit has converged, it is
        returned, except if the declared noise is contradicted.

    Raises
    ------
    ValueError, ArithmeticError
        If the first fit fails, or if a second fit is needed and both of its attempts fail.
    """
    fitted = fit_and_evaluate(full, records, validation_data, options, settings, start, detail=detail)
    assumed, found, noise_revised = size_of(full), size_of(fitted.fit.model), without_contradicted_noise(full, fitted)
    again = noise_revised
    ratios = [found.of(unit) / assumed.of(unit) for unit in ("N", "N m")]
    if not all(1 / RESCALING_RATIO < ratio < RESCALING_RATIO for ratio in ratios):
        again = rescale_effects(rescale(again, found), assumed, found)
    if again is full:
        return fitted
    first, refits = fitted.fit, list[FittedModel]()
    again_detail = None if detail is None else (lambda text: detail(f"second fit: {text}"))
    shared = {p.name: float(v) for p, v in zip(first.parameters, first.values, strict=True) if p.segment is None}
    # The given initial values would replace the estimates of the first fit in the second attempt.
    for initial, begin in ((again, start), (again.with_values(shared), None)):
        try:
            refits.append(
                fit_and_evaluate(initial, records, validation_data, options, settings, begin, detail=again_detail)
            )
        except FIT_ERRORS:
            if initial is not again and not refits:
                raise
            continue
        if refits[-1].fit.converged and refits[-1].fit.log_likelihood > first.log_likelihood - AS_LIKELY:
            return refits[-1]
    best = max(refits, key=lambda refit: (refit.fit.converged, refit.fit.log_posterior))
    lost = first.converged and not best.fit.converged
    return fitted if lost and noise_revised is full else best


def without_contradicted_noise(full: Model, fitted: FittedModel) -> Model:
    """Replace the declared noise of the sensors by priors if the innovations of an output contradict it.

    Declared noise is a fixed noise parameter of an output. It is contradicted if the robust standard deviation of the
    standardised innovations of any such output is 1.5 or more. The declared noise parameters of all outputs with
    samples then become free, with their values as the means of priors and 12.5 % as relative standard deviation.
    Otherwise the model ``full`` is returned unchanged.

    If noise that is declared too small were kept fixed, random errors would look like an effect, and the standard
    errors would be too small. One contradicted output makes the declared noise of all outputs doubtful: the filter puts
    its errors into the states, so that the innovations of other outputs do not show them. The median of the innovations
    decides, since it is not sensitive to outliers.

    Parameters
    ----------
    full
        Model before the fit.
    fitted
        Fit of this model, whose innovations on the estimation data are tested.
    """
    declared, ratios = list[Parameter](), list[float]()
    for e, o in zip(np.concatenate([v.run.standardised for v in fitted.estimation]).T, full.outputs, strict=True):
        if o.noise and not full.parameter(o.noise).free and np.isfinite(e).any():
            declared.append(full.parameter(o.noise))
            ratios.append(NORMAL_MAD * float(np.nanmedian(np.abs(e))))
    if max(ratios, default=0.0) < CONTRADICTED_NOISE:
        return full
    priors = [p.known(p.value, DECLARED_NOISE_SD * p.value, ParameterOrigin.PRIOR) for p in declared]
    return full.replace_parameters(*priors)


def fit_and_evaluate(
    model: Model,
    records: Sequence[Record],
    validation_data: ValidationData,
    options: EstimationOptions | None = None,
    settings: SearchSettings | None = None,
    start: Mapping[str, float] | None = None,
    other_starts: Sequence[Mapping[str, float]] = (),
    detail: Callable[[str], None] | None = None,
) -> FittedModel:
    """Fit the model to the records, and evaluate the fit on the validation data.

    On validation records only the per-record parameters (the current) are estimated. On blocks of the estimation
    records, the fit is evaluated by cross-validation.

    Parameters
    ----------
    model
        Model with its initial values. Free measurement noise near zero gets a new initial value
        (`reset_collapsed_noise`). Other initial values of its start grid are tried, except in a rough search (without
        robust errors).
    records, validation_data
        Estimation records; and validation records, or blocks in time of the estimation records. A validation record
        that cannot be evaluated is named in ``failed``.
    options
        Method, outliers and noise. None: prediction error, without outliers and REML.
    settings
        Accuracy and effort of the search. None: the defaults of `SearchSettings`.
    start
        Initial values by full name, which replace those of the model (`fit`). None: no such values.
    other_starts
        Further sets of initial values by full name, each in place of some of ``start``. The search begins at the set
        with the highest log-posterior (`fit`).
    detail
        Called with a text in each iteration of the search, such as ``start 2, iteration 7``, and before the evaluation.

    Raises
    ------
    ValueError
        If the fit fails, or if a block of an estimation record cannot be evaluated.
    """
    options, settings = options or EstimationOptions(), settings or SearchSettings()
    model = options.with_mean_order(model)
    initial, rows = reset_collapsed_noise(model, records), [r.for_model(model) for r in records]

    report, starts = detail or (lambda _: None), itertools.count(1)

    def fitted_from(replaced: Mapping[str, float]) -> Fit:
        """Fit the model to all records from its initial values, of which ``replaced`` (by parameter) replaces some.

        Options and settings are those of the caller. ValueError is raised if the model cannot be evaluated there.
        """
        begin, number = {**(start or {}), **replaced}, next(starts)
        label = f"start {number}, " if number > 1 else ""  # most models have a single start
        return fit(
            initial, rows, options, settings, start=begin, other_starts=() if replaced else other_starts,
            progress=lambda iteration, _: report(f"{label}iteration {iteration + 1}"),
        )  # fmt: skip

    full_fit = fitted_from({})
    if model.start_grid is not None and settings.robust_errors:
        full_fit = best_of_starts(full_fit, records, fitted_from)
    report("evaluation")
    model = with_outliers(model) if options.outlier_model else model
    views = tuple(_evaluation_of(full_fit.model, r, full_fit.record_values[i]) for i, r in enumerate(records))
    if not isinstance(validation_data, TimeBlocks):
        judged, failed = evaluate_records(
            full_fit.model, validation_data, full_fit.record_values[0], replace(settings, robust_errors=False)
        )
        return FittedModel(model, full_fit, views, tuple(judged), tuple(failed))
    return cross_validated(FittedModel(model, full_fit, views, ()), validation_data)


def cross_validated(fitted: FittedModel, blocks: TimeBlocks) -> FittedModel:
    """Evaluate a fit by blocked cross-validation: each block in time with the estimates from all other blocks.

    Return a copy of ``fitted`` with these evaluations in ``validation``. ``blocks`` are blocks in time of the
    estimation records.

    Raises
    ------
    ValueError
        If a block cannot be evaluated, or if the fit of its per-record parameters fails.
    """
    full_fit, blocks = fitted.fit, _with_initial_states_of_effects(fitted, blocks)
    values = leave_one_block_out(full_fit.model, blocks, full_fit.record_values, full_fit.parameters)
    views = tuple(_evaluation_of(full_fit.model, r, v) for r, v in zip(blocks.records, values, strict=True))
    return replace(fitted, validation=views, cross_validated=True, in_blocks=True)


def cut_into_blocks(records: Sequence[Record], views: Sequence[RecordEvaluation], block: float) -> TimeBlocks:
    """Cut records into blocks in time for cross-validation, five to eight for each record.

    Parameters
    ----------
    records
        Records to be cut.
    views
        Evaluation of a model on each record. In a block the states start with the mean and spread of its filtered
        states over the whole record.
    block
        Duration [s] over which residuals may be correlated, 5 s for a boat (``Model.block`` of the model). A block for
        cross-validation is twelve times as long, within the limits on the number.
    """
    return time_blocks(records, block, [_state_distribution(v) for v in views])


def _with_initial_states_of_effects(fitted: FittedModel, blocks: TimeBlocks) -> TimeBlocks:
    """Return blocks of records with an initial mean and standard deviation for every state of the fitted model.

    Effects add states to a model, for which the blocks may have none. Initial values that a block already has are kept.
    Missing ones get the mean and spread of the filtered states over the record. States that start at rest would be
    wrong wherever a record is cut.
    """
    known = [r.start for r in blocks.records]
    if all(s.name in start for s in fitted.fit.model.states for start in known):
        return blocks
    own = [_state_distribution(v) for v in fitted.estimation]
    starts = [{**own[i], **start} for i, start in zip(blocks.record_indices, known, strict=True)]
    records = (replace(r, start=start) for r, start in zip(blocks.records, starts, strict=True))
    return replace(blocks, records=tuple(records))


def _state_distribution(view: RecordEvaluation) -> dict[str, tuple[float, float]]:
    """Return mean and standard deviation of each filtered state over the rows of a record, by name of the state.

    The standard deviation includes the filter's own uncertainty. Blocks of the record start with this distribution.
    """
    mean, variance = view.run.x_filt.mean(axis=0), view.run.x_filt.var(axis=0)
    sd = np.sqrt(variance + np.diagonal(view.run.P_filt, axis1=1, axis2=2).mean(axis=0))
    return {s.name: (float(m), float(e)) for s, m, e in zip(view.model.states, mean, sd, strict=True)}


def evaluate_records(
    model: Model, records: Sequence[Record], values: Array | None = None, settings: SearchSettings | None = None
) -> tuple[list[RecordEvaluation], list[FailedRun]]:
    """Evaluate a fitted model on records that it was not fitted to.

    Only the per-record parameters (the current) are estimated, from all records at once; all other parameters keep
    their values. If that fails, or if an effect has a scanned per-record parameter (the time of a change), the records
    are evaluated one by one.

    Parameters
    ----------
    model
        Model with the estimates as values.
    records
        The records.
    values : Array (n_parameters,), optional
        Values of all parameters for a model without free per-record parameters; by default those of the model.
    settings
        Settings of the search for the per-record parameters. None: those of a search without robust errors.

    Returns
    -------
    evaluations, failed
        Evaluation of each record, and the records that could not be evaluated with the reason, both in the order of
        ``records``. A record that cannot be evaluated raises no error. Both are empty without records.
    """
    settings = settings or SearchSettings(robust_errors=False)
    own = [p.name for p in model.parameters if p.free and p.per_record]
    scanned = {name: tuple(scan) for e in model.effects for name, scan in e.scan.items() if name in own}
    if not records:
        return [], []
    if len(records) == 1 or not scanned:
        try:
            if own:
                start = _start_by_scan(model, records[0], own, scanned, settings) if scanned else {}
                times = times_of_change(model.effects, records) if scanned else []
                of_model = [r.for_model(model) for r in records]
                adapted = fit(model.with_free(own), of_model, settings=settings, start=start, other_starts=times)
                return [_evaluation_of(adapted.model, r, adapted.record_values[i]) for i, r in enumerate(records)], []
            fixed = np.array(list(model.values.values())) if values is None else values
            views = [_evaluation_of(model, r, fixed) for r in records]
            for v in views:
                if not np.isfinite(v.ll).all():
                    raise ValueError(
                        f"record {v.record.name}: the likelihood of model {model.name} is not finite for the estimated "
                        "parameters; check this log with `seatrial check`, or leave it out"
                    )
            return views, []
        except FIT_ERRORS as problem:
            if len(records) == 1:
                return [], [FailedRun(records[0].name, str(problem))]
    parts = [evaluate_records(model, [r], values, settings) for r in records]
    return [v for views, _ in parts for v in views], [f for _, failed in parts for f in failed]


def times_of_change(effects: Iterable[Effect], records: Sequence[Record]) -> list[dict[str, float]]:
    """Return sets of initial values, by full name, for effects that begin at a time in a run.

    Such a time is a scanned parameter in s of an effect. The likelihood has a maximum at each strong manoeuvre, and a
    search reaches only the nearest one. The sets have the times from 10 s to the end of the longest record, every 10 s,
    and the same time in all records. The list is empty without such an effect.
    """
    longest = max((r.duration for r in records), default=0.0)
    return [
        dict.fromkeys([segment_name(p.name, i) for i in range(len(records))] if p.per_record else [p.name], at)
        for p in _change_times(effects)
        for at in np.arange(TIME_STEP_S, longest, TIME_STEP_S).tolist()
    ]


def _change_times(effects: Iterable[Effect]) -> list[Parameter]:
    """Return the parameters of effects that are the time at which the effect begins in a run."""
    return [p for e in effects for p in e.parameters if p.name in e.scan and p.unit == "s" and p.transform != "log"]


def _start_by_scan(
    model: Model, record: Record, own: Sequence[str], scanned: Mapping[str, Sequence[float]], settings: SearchSettings
) -> dict[str, float]:
    """Return initial values of the per-record parameters of one record, by a scan of some of them.

    The likelihood has several maxima in such a parameter, for example the time of a change. The other per-record
    parameters are estimated for each combination of scanned values, and the best fit is returned.

    Parameters
    ----------
    model
        Fitted model.
    record
        The record.
    own
        Names of the free per-record parameters.
    scanned
        Values of the scanned ones by name.
    settings
        Settings of the search.
    """
    others = [name for name in own if name not in scanned]
    best, start = -np.inf, dict[str, float]()
    for values in product(*scanned.values()):
        at = dict(zip(scanned, values, strict=True))
        found = fit(model.with_values(at).with_free(others), [record.for_model(model)], settings=settings)
        if found.log_posterior > best:
            best = found.log_posterior
            start = {segment_name(n, 0): v for n, v in [*at.items(), *((n, found.estimate(n)[0]) for n in others)]}
    return start


def validated_in_blocks(fitted: FittedModel) -> FittedModel:
    """Return the fit with ``validation`` replaced by blocks in time of its validation records.

    An effect with per-record parameters must be evaluated this way: the values for a block come from the other blocks
    of the run, not from the data on which they are judged. A fit without validation records, or one that is
    cross-validated already, is returned unchanged.

    Raises
    ------
    ValueError
        If a block cannot be evaluated.
    """
    if fitted.in_blocks or not fitted.validation:
        return fitted
    model = fitted.fit.model
    return replace(fitted, validation=evaluated_in_blocks(model, fitted.validation, model.block), in_blocks=True)


def evaluated_in_blocks(model: Model, views: Sequence[RecordEvaluation], block: float) -> tuple[RecordEvaluation, ...]:
    """Cut evaluated records into blocks in time, and evaluate each block with the estimates from the other blocks.

    Only per-record parameters are estimated: those of effects from the other blocks of the record, and those of the
    nominal model (the current) from the block itself. All other parameters keep their values, and so does the time at
    which an effect begins in the record: the block that has this time determines it alone.

    Parameters
    ----------
    model
        Fitted model, whose free per-record parameters are estimated.
    views
        Evaluation of the model on each record.
    block
        Duration [s] over which residuals may be correlated (``Model.block``). A block in time is twelve times as long,
        within the limits on the number of blocks (`cut_into_blocks`).

    Returns
    -------
    tuple of RecordEvaluation
        Evaluation of each block, in the order of the records and of time. The times of a block are those of its record.

    Raises
    ------
    ValueError
        If a block cannot be evaluated.
    """
    blocks = cut_into_blocks([v.record for v in views], views, block)
    times = {p.name for p in _change_times(model.effects)}
    own = [p for p in model.parameters if p.free and p.per_record and p.name not in times]
    parameters = [replace(p, segment=i) for i in range(len(views)) for p in own]
    values = leave_one_block_out(model, blocks, np.array([v.values for v in views]), parameters)
    return tuple(_evaluation_of(model, r, v) for r, v in zip(blocks.records, values, strict=True))


def _evaluation_of(model: Model, record: Record, values: Array) -> RecordEvaluation:
    """Return the evaluation of the model on a record, of which only the model's inputs and outputs are kept.

    ``values`` (n_parameters,) are the estimates for this record. The filter does not run yet. ValueError is raised if
    the record lacks an input.
    """
    return RecordEvaluation(model, record.for_model(model), values)


def nominal_model(model: Model) -> Model:
    """Return the model with which a diagnosis compares others: with disturbance forces and sensor offsets as states.

    The sizes of their noise and priors are scaled to the size of the boat, by its masses. A model that has disturbance
    forces already is only scaled. A model to which no disturbance force can be added (`forces_of`), and which has no
    quantities for the diagnosis (`residuals_of`), is returned unchanged.
    """
    if not (forces_of(model) or residuals_of(model)):
        return model
    present = any(e.kind is EffectKind.DISTURBANCE for e in model.effects)
    return rescale(model if present else with_disturbances(model), size_of(model))


def with_all_candidates(
    nominal_model: Model, candidates: Mapping[str, Effect], runs: Sequence[LogSegment]
) -> tuple[Model, dict[str, Effect]]:
    """Add the candidate effects whose inputs exist in all runs to a model. Return the model, and these effects by name.

    The other candidates are left out.

    A record of this model contains all inputs that the candidates need, so that it is made only once.

    Parameters
    ----------
    nominal_model
        Model to which the effects are added.
    candidates
        Effects by name.
    runs
        Logs, or parts of logs, whose recorded channels are searched for the inputs.
    """
    everything, kept = nominal_model, {}
    for name, effect in candidates.items():
        if not any(missing_inputs(nominal_model, effect, run) for run in runs):
            everything, kept[name] = everything + effect, effect
    return everything, kept


def missing_inputs(nominal_model: Model, effect: Effect, run: LogSegment) -> set[str]:
    """Return the names of those inputs of an effect that a run does not contain and that cannot be derived from it.

    A delayed copy (``NAME~k``) can be derived from its source ``NAME``; if that is missing, the result has the name of
    the source. The time ``t`` can always be derived. The input ``work``, the integral of the cubed shaft speeds, can be
    derived if the model has the shaft speed ``n``.

    Parameters
    ----------
    nominal_model
        Model to which the effect would be added.
    effect
        The effect.
    run
        Log, or part of a log, whose recorded channels are searched for the inputs.
    """
    derived = {"t", "work"} if nominal_model.provides and "n" in nominal_model.provides else {"t"}
    return {i.tap_of or i.name for i in effect.inputs} - derived - set(run.channels)


def without_absent_sensors(model: Model, records: Sequence[Record]) -> Model:
    """Fix the noise parameters of those sensors that have no sample in any of the records, and return the model.

    The data contain no information about these parameters. They are fixed at their present values. A noise parameter
    that a sensor with samples shares is not changed.
    """
    return model.replace_parameters(*[model.parameter(n).fixed() for n in _noise_of_absent_sensors(model, records)])


def without_unknown_noise(model: Model, records: Sequence[Record], validation_data: Sequence[Record]) -> list[Record]:
    """Return the validation records without the samples of sensors that have no sample in the estimation records.

    The samples become NaN in copies of the records. The noise of such a sensor is not estimated, so that the result of
    the validation would depend on a guess. If the noise is fixed to a given value, the samples stay. Records without
    outputs of such sensors are returned themselves, and the order is kept.

    Parameters
    ----------
    model
        Model with the noise parameters of its sensors.
    records
        Estimation records.
    validation_data
        Validation records.
    """
    unknown = {n for n in _noise_of_absent_sensors(model, records) if model.parameter(n).free}
    dropped = {o.name for o in model.outputs if o.noise in unknown}
    return [
        replace(r, y=np.where([name in dropped for name in r.outputs], np.nan, r.y)) if dropped & set(r.outputs) else r
        for r in validation_data
    ]


def _noise_of_absent_sensors(model: Model, records: Sequence[Record]) -> set[str]:
    """Return the names of the noise parameters of outputs that have no sample in any record.

    A noise parameter that an output with samples shares is not among them.
    """
    columns = {n: j for j, n in enumerate(records[0].outputs)}
    seen = {o.name for o in model.outputs if any(np.isfinite(r.y[:, columns[o.name]]).any() for r in records)}
    informed = {o.noise for o in model.outputs if o.name in seen}
    return {o.noise for o in model.outputs if o.noise} - informed


def reset_collapsed_noise(model: Model, records: Sequence[Record]) -> Model:
    """Return the model with new initial values for free measurement noise that an earlier fit estimated as almost zero.

    Noise is almost zero if it is below a hundredth of the white noise in the samples. This white noise is the new
    value; it is computed from the median second difference of the samples. A search cannot leave a noise near zero.
    Noise with a positive lower bound keeps its value: it cannot become zero, and the second differences of a smoothed
    signal would measure its motion.
    """
    new, names = [], records[0].outputs
    for o in model.outputs:
        p = model.parameter(o.noise) if o.noise else None
        if p is None or not p.free or p.bounds[0] > 0.0 or o.name not in names:
            continue
        parts = [r.y[np.isfinite(r.y[:, names.index(o.name)]), names.index(o.name)] for r in records]
        white = noise_from_differences(np.concatenate([np.diff(np.unwrap(y) if o.angle else y, 2) for y in parts]))
        if p.value < COLLAPSED_NOISE * white:
            new.append(p.at(white))
    return model.replace_parameters(*new)
