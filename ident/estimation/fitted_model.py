"""A model fitted to estimation data and evaluated on validation data: what a diagnosis compares."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Annotated

import msgspec
import numpy as np
from msgspec import Meta

from seatrial.daq.errors import counted
from seatrial.ident.data import LogSegment, Record, make_record
from seatrial.ident.estimation.cross_validation import TimeBlocks, leave_one_block_out, time_blocks
from seatrial.ident.estimation.likelihood import FilterResult, Likelihood
from seatrial.ident.estimation.maximum_likelihood import EstimationOptions, Fit, SearchSettings, fit
from seatrial.ident.estimation.multistart import best_of_starts
from seatrial.ident.estimation.smoother import SmoothedStates, smoothed_states
from seatrial.ident.model import Effect, EffectKind, Model, Parameter, ParameterOrigin, outlier_notes
from seatrial.ident.model import with_outlier_model as with_outliers
from seatrial.ident.models import forces_of, rescale, residuals_of, size_of, with_disturbances
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

ValidationData = Sequence[Record] | TimeBlocks  # validation records, or blocks of the estimation records


class FailedRun(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """Validation run that could not be evaluated."""

    record: Annotated[str, Meta(description="name of the run's record")]
    reason: Annotated[str, Meta(description="why the model could not be evaluated on the run")]


@dataclass(frozen=True)
class FittedModel:
    """A model, its fit to the estimation data, and its evaluation on every record of both sets.

    On validation data only per-record parameters (the current) are estimated.

    Attributes
    ----------
    model
        The model before the fit.
    fit
        The fit to the estimation data.
    estimation, validation
        Evaluation of the fitted model on each record.
    failed
        Validation runs that could not be evaluated.
    cross_validated
        Whether ``validation`` contains blocks of the estimation records, each with the estimates from the other blocks.
    """

    model: Model
    fit: Fit
    estimation: tuple[RecordEvaluation, ...]
    validation: tuple[RecordEvaluation, ...]
    failed: tuple[FailedRun, ...] = ()
    cross_validated: bool = False

    @property
    def records(self) -> list[Record]:
        """The records of the fit."""
        return [v.record for v in self.estimation]

    @property
    def outlier_notes(self) -> list[str]:
        """Lines about outliers in the estimation data, one for each channel that has the outlier model."""
        runs, measured = [v.run.outliers for v in self.estimation], [np.isfinite(r.y) for r in self.records]
        return outlier_notes(self.model, runs, measured)


@dataclass(frozen=True)
class RecordEvaluation:
    """A fitted model on one record. Filter and smoother run at the first access.

    Attributes
    ----------
    model, record
        The model with its estimates, and the record.
    values : Array (n_parameters,)
        The estimates for this record, over ``model.parameters`` in order.
    """

    model: Model
    record: Record
    values: Array

    @cached_property
    def run(self) -> FilterResult:
        """Filtered states and innovations."""
        return Likelihood(self.model).filter(self.record, self.values)

    @cached_property
    def ll(self) -> Array:
        """Log-likelihood by row (n_rows,). It is cheaper than `run`, and enough for most candidates of a diagnosis."""
        return Likelihood(self.model).value_by_row(self.record, self.values)

    @cached_property
    def smoothed(self) -> SmoothedStates:
        """Smoothed states."""
        return smoothed_states(self.run)


def fit_nominal_model(
    model: Model,
    estimation: Sequence[LogSegment],
    validation: Sequence[LogSegment],
    options: EstimationOptions | None = None,
    *,
    rate: float = 10.0,
    reporter: Reporter = QUIET,
) -> FittedModel:
    """Fit the model as it is, with disturbance forces and sensor offsets as states; no search for missing effects.

    Parameters
    ----------
    model
        Its ``nominal_model`` form is fitted.
    estimation, validation
        Logs for the fit, and logs that judge it.
    options
        Plain maximum likelihood by default.
    rate
        Rows per second to which faster sensors are averaged [Hz].
    reporter
        Receives a line of progress.
    """
    full = nominal_model(model)
    records = [make_record(full, r, rate) for r in estimation]
    validation_data, failed = validation_records(full, validation, rate)
    reporter.progress(f"fitting {full.name} to {counted(len(records), 'run')}")
    validation_data = without_unknown_noise(full, records, validation_data)
    full = without_absent_sensors(full, records)
    fitted = fit_with_rescaling(full, records, validation_data, options)
    return replace(fitted, failed=(*failed, *fitted.failed))


def validation_records(
    model: Model, segments: Sequence[LogSegment], rate: float
) -> tuple[list[Record], tuple[FailedRun, ...]]:
    """Return the records of the validation runs, and the runs that cannot be converted to a record.

    ``rate`` [Hz] is that of `seatrial.ident.data.make_record`.
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
) -> FittedModel:
    """Fit the model of `nominal_model`, and fit it again if its priors turn out to be wrong.

    A second fit follows if the boat's estimated size differs from the assumed one, or if the innovations contradict the
    declared noise of the sensors. If that fit fails, does not converge or is much less likely than the first, it is
    repeated from the shared estimates of the first fit.

    Parameters
    ----------
    full
        The model of `nominal_model`.
    records, validation_data
        Estimation and validation data.
    options
        Plain maximum likelihood by default.

    Returns
    -------
    FittedModel
        The first fit if no second one is needed. Otherwise the first refit that has converged and is about as likely as
        the first fit, or else the best refit. If only the first fit has converged, it is returned, except if the
        declared noise is contradicted.

    Raises
    ------
    ValueError, ArithmeticError
        If no refit can be evaluated.
    """
    fitted = fit_and_evaluate(full, records, validation_data, options)
    assumed, found, noise_revised = size_of(full), size_of(fitted.fit.model), without_contradicted_noise(full, fitted)
    again = noise_revised
    ratios = [found.of(unit) / assumed.of(unit) for unit in ("N", "N m")]
    if not all(1 / RESCALING_RATIO < ratio < RESCALING_RATIO for ratio in ratios):
        again = rescale(again, found)
    if again is full:
        return fitted
    first, refits = fitted.fit, list[FittedModel]()
    shared = {p.name: float(v) for p, v in zip(first.parameters, first.values, strict=True) if p.segment is None}
    for initial in (again, again.with_values(shared)):
        try:
            refits.append(fit_and_evaluate(initial, records, validation_data, options))
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
    """Return the model with the declared noise of the sensors as priors if the innovations of a channel contradict it.

    If noise that is declared too small were kept fixed, random errors would look like an effect, and the standard
    errors would be too small. One contradicted channel makes the declared noise of all channels doubtful: its errors go
    into the states and hide in the innovations of the others. The median of the innovations decides, since it is not
    sensitive to outliers.
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
) -> FittedModel:
    """Fit the model to the records. On validation records estimate only the per-record parameters.

    Parameters
    ----------
    model
        The model, with its initial values. A rough search (without robust errors) tries no other initial values.
    records, validation_data
        Estimation and validation data. A validation record that cannot be evaluated is named in ``failed``.
    options, settings
        See `seatrial.ident.estimation.maximum_likelihood.fit`.

    Raises
    ------
    ValueError
        If an estimation record or a block of one cannot be evaluated.
    """
    options, settings = options or EstimationOptions(), settings or SearchSettings()
    model = options.with_mean_order(model)
    initial, rows = reset_collapsed_noise(model, records), [r.for_model(model) for r in records]

    def fitted_from(start: Mapping[str, float]) -> Fit:
        return fit(initial, rows, options, settings, start=start)

    full_fit = fitted_from({})
    if model.start_grid is not None and settings.robust_errors:
        full_fit = best_of_starts(full_fit, records, fitted_from)
    model = with_outliers(model) if options.outlier_model else model
    views = tuple(_view(full_fit.model, r, full_fit.record_values[i]) for i, r in enumerate(records))
    if not isinstance(validation_data, TimeBlocks):
        judged, failed = _adapted(full_fit, validation_data, replace(settings, robust_errors=False))
        return FittedModel(model, full_fit, views, tuple(judged), tuple(failed))
    return cross_validated(FittedModel(model, full_fit, views, ()), validation_data)


def cross_validated(fitted: FittedModel, blocks: TimeBlocks) -> FittedModel:
    """Return the fit judged on blocks in time of its estimation records, each with the estimates from the others.

    Raises
    ------
    ValueError
        If a block cannot be evaluated.
    """
    full_fit, blocks = fitted.fit, _with_own_starts(fitted, blocks)
    values = leave_one_block_out(full_fit.model, blocks, full_fit.record_values, full_fit.parameters)
    views = tuple(_view(full_fit.model, r, v) for r, v in zip(blocks.records, values, strict=True))
    return replace(fitted, validation=views, cross_validated=True)


def cut_into_blocks(records: Sequence[Record], views: Sequence[RecordEvaluation], block: float) -> TimeBlocks:
    """Cut records into blocks in time.

    Parameters
    ----------
    records
        The records.
    views
        A model evaluated on them. Its filtered states give the initial states of the blocks.
    block
        ``Model.block`` [s].
    """
    return time_blocks(records, block, [_starts_anywhere(v) for v in views])


def _with_own_starts(fitted: FittedModel, blocks: TimeBlocks) -> TimeBlocks:
    """Return the blocks with initial states for all states of the fitted model, including those of its effects.

    Initial states at rest would be wrong wherever a record is cut.
    """
    known = [r.start for r in blocks.records]
    if all(s.name in start for s in fitted.fit.model.states for start in known):
        return blocks
    own = [_starts_anywhere(v) for v in fitted.estimation]
    starts = [{**own[i], **start} for i, start in zip(blocks.of, known, strict=True)]
    records = (replace(r, start=start) for r, start in zip(blocks.records, starts, strict=True))
    return replace(blocks, records=tuple(records))


def _starts_anywhere(view: RecordEvaluation) -> dict[str, tuple[float, float]]:
    """Return mean and standard deviation of each state over a record. They include the filter's own uncertainty."""
    mean, variance = view.run.x_filt.mean(axis=0), view.run.x_filt.var(axis=0)
    sd = np.sqrt(variance + np.diagonal(view.run.P_filt, axis1=1, axis2=2).mean(axis=0))
    return {s.name: (float(m), float(e)) for s, m, e in zip(view.model.states, mean, sd, strict=True)}


def _adapted(
    full_fit: Fit, validation_data: Sequence[Record], settings: SearchSettings
) -> tuple[list[RecordEvaluation], list[FailedRun]]:
    """Return the validation records with their per-record parameters (the current) estimated, and those that failed.

    All records are fitted at once. If that fails, they are fitted one by one.
    """
    model = full_fit.model
    own = [p.name for p in model.parameters if p.free and p.per_record]
    if not validation_data:
        return [], []
    try:
        if own:
            adapted = fit(model.with_free(own), [r.for_model(model) for r in validation_data], settings=settings)
            return [_view(adapted.model, r, adapted.record_values[i]) for i, r in enumerate(validation_data)], []
        views = [_view(model, r, full_fit.record_values[0]) for r in validation_data]
        for v in views:
            if not np.isfinite(v.ll).all():
                raise ValueError(f"record {v.record.name}: the likelihood of model {model.name} cannot be evaluated")
        return views, []
    except FIT_ERRORS as problem:
        if len(validation_data) == 1:
            return [], [FailedRun(validation_data[0].name, str(problem))]
    parts = [_adapted(full_fit, [r], settings) for r in validation_data]
    return [v for views, _ in parts for v in views], [f for _, failed in parts for f in failed]


def validated_in_blocks(fitted: FittedModel) -> FittedModel:
    """Return the fit judged on blocks in time of its validation records.

    An effect with per-record parameters must be judged this way: the values for a block come from the other blocks of
    the run. A fit without validation records, or one that is cross-validated already, is returned unchanged.

    Raises
    ------
    ValueError
        If a block cannot be evaluated.
    """
    if fitted.cross_validated or not fitted.validation:
        return fitted
    model = fitted.fit.model
    blocks = cut_into_blocks([v.record for v in fitted.validation], fitted.validation, model.block)
    own = [p for p in model.parameters if p.free and p.per_record]
    parameters = [replace(p, segment=i) for i in range(len(fitted.validation)) for p in own]
    values = leave_one_block_out(model, blocks, np.array([v.values for v in fitted.validation]), parameters)
    return replace(fitted, validation=tuple(_view(model, r, v) for r, v in zip(blocks.records, values, strict=True)))


def _view(model: Model, record: Record, values: Array) -> RecordEvaluation:
    return RecordEvaluation(model, record.for_model(model), values)


def nominal_model(model: Model) -> Model:
    """Return the model with disturbance forces and sensor offsets, scaled to its size.

    A model that has them already is only scaled. A model without forces or kinematic residuals is returned unchanged.
    """
    if not (forces_of(model) or residuals_of(model)):
        return model
    present = any(e.kind is EffectKind.DISTURBANCE for e in model.effects)
    return rescale(model if present else with_disturbances(model), size_of(model))


def with_all_candidates(
    nominal_model: Model, candidates: Mapping[str, Effect], runs: Sequence[LogSegment]
) -> tuple[Model, dict[str, Effect]]:
    """Return the model with all candidates whose inputs exist in all runs, and these candidates by name.

    One record of this model then serves all candidates.
    """
    everything, kept = nominal_model, {}
    for name, effect in candidates.items():
        if not any(missing_inputs(nominal_model, effect, run) for run in runs):
            everything, kept[name] = everything + effect, effect
    return everything, kept


def missing_inputs(nominal_model: Model, effect: Effect, run: LogSegment) -> set[str]:
    """Return the inputs of an effect that a run lacks and that cannot be derived from its channels."""
    derived = {"t", "work"} if nominal_model.provides and "n" in nominal_model.provides else {"t"}
    return {i.tap_of or i.name for i in effect.inputs} - derived - set(run.channels)


def without_absent_sensors(model: Model, records: Sequence[Record]) -> Model:
    """Return the model with the noise of sensors that no record has fixed, since the data cannot inform it."""
    return model.replace_parameters(*[model.parameter(n).fixed() for n in _absent_noise(model, records)])


def without_unknown_noise(model: Model, records: Sequence[Record], validation_data: Sequence[Record]) -> list[Record]:
    """Return the validation records without samples of sensors that no estimation record has.

    The noise of such a sensor is not estimated, and a guess of it would judge the model. If its noise is fixed to a
    given value, the samples stay.
    """
    unknown = {n for n in _absent_noise(model, records) if model.parameter(n).free}
    dropped = {o.name for o in model.outputs if o.noise in unknown}
    return [
        replace(r, y=np.where([name in dropped for name in r.outputs], np.nan, r.y)) if dropped & set(r.outputs) else r
        for r in validation_data
    ]


def _absent_noise(model: Model, records: Sequence[Record]) -> set[str]:
    """Return the noise parameters of sensors that no record has."""
    columns = {n: j for j, n in enumerate(records[0].outputs)}
    seen = {o.name for o in model.outputs if any(np.isfinite(r.y[:, columns[o.name]]).any() for r in records)}
    informed = {o.noise for o in model.outputs if o.name in seen}
    return {o.noise for o in model.outputs if o.noise} - informed


def reset_collapsed_noise(model: Model, records: Sequence[Record]) -> Model:
    """Return the model with new initial values for noise that an earlier fit estimated as almost zero.

    No search returns from a noise near zero. The new value comes from the median second difference of the samples,
    taken as white noise. Noise with a lower bound keeps its value: it cannot collapse. The second differences of a
    smoothed signal would measure its motion instead.
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
