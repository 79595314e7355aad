"""Evaluation of a fitted model on every record: prediction errors, calibration and whiteness of the residuals.

Everything is computed once; reports and plots read the results.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Generic, TypeVar

import numpy as np

from seatrial.ident.data import TIME_INPUT, WORK_INPUT, Record
from seatrial.ident.estimation import (
    FittedModel,
    IntervalCalibration,
    Likelihood,
    RecordEvaluation,
    Role,
    parameter_uncertainty,
)
from seatrial.ident.model import DisturbanceChannel, Model
from seatrial.ident.numerics import Array
from seatrial.ident.validation import calibration
from seatrial.ident.validation.calibration import Calibration, Forecast
from seatrial.ident.validation.prediction_errors import (
    PredictionChange,
    PredictionErrors,
    SimulationRun,
    horizon_errors,
    one_step_errors,
    pooled_errors,
    prediction_change,
    prediction_change_by_record,
    simulation_run,
)
from seatrial.ident.validation.whiteness import (
    CrossCorrelation,
    Whiteness,
    autoregression,
    cross_correlation,
    whiteness_test,
)

FEWEST = 60  # smallest number of samples of a channel for residual tests

T = TypeVar("T")


@dataclass(frozen=True)
class ByHorizon(Generic[T]):
    """One quantity for three kinds of prediction: one step ahead, over a horizon, and simulation.

    Attributes
    ----------
    one_step
        Value for predictions of the next sample.
    horizon
        Value for predictions over the horizon.
    simulation
        Value for the simulation, which uses the inputs alone after its first 15 s.
    """

    one_step: T
    horizon: T
    simulation: T


@dataclass(frozen=True)
class HorizonPrediction:
    """Predictions of one channel over the horizon.

    Attributes
    ----------
    t : Array (n,)
        Times of the predicted samples [s].
    y : Array (n,)
        Predicted values in the unit of the channel, NaN if a prediction diverged.
    sd : Array (n,)
        Standard deviations of the errors in the unit of the channel: predicted ones times the `widening` of the
        channel. NaN if the channel has no forecasts.
    """

    t: Array
    y: Array
    sd: Array


@dataclass(frozen=True)
class RecordPrediction:
    """Predictions of one record by the model.

    Attributes
    ----------
    record
        The record.
    horizon
        Predictions over the horizon, by channel.
    errors
        Errors of these predictions, by channel.
    simulation
        Simulation from the inputs alone. Its standard deviations are the predicted ones times the factor of the channel
        (`ErrorScale.simulation_widening`) by the validation data.
    """

    record: Record
    horizon: Mapping[str, HorizonPrediction]
    errors: Mapping[str, PredictionErrors]
    simulation: SimulationRun


@dataclass(frozen=True)
class ChannelResiduals:
    """Residual analysis of one channel of one record.

    Attributes
    ----------
    role
        Role of the record, ``estimation`` or ``validation``.
    record, channel, unit
        Names of record and channel, and the unit of the channel.
    t : Array (n,)
        Times [s] of the rows with a sample, since the start of the log.
    e : Array (n,)
        Standardised innovations in these rows, without NaN.
    tests
        Tests for whiteness.
    inputs
        Correlation of the innovations with each input that reports show (`shown_inputs`).
    """

    role: Role
    record: str
    channel: str
    unit: str
    t: Array
    e: Array
    tests: Whiteness
    inputs: tuple[CrossCorrelation, ...]

    @property
    def lags(self) -> Array:
        """Lags (n_lags,) [s] of the autocorrelation: 1, 2, ... median sample intervals of the channel."""
        return float(np.median(np.diff(self.t))) * np.arange(1.0, self.tests.acf.size + 1.0)


@dataclass(frozen=True)
class SetEvaluation:
    """Evaluation of all records of one set of data (estimation or validation data).

    Attributes
    ----------
    records
        Predictions, record by record.
    errors
        Prediction errors of all records together, by channel.
    explained
        Prediction errors over the horizon, compared with those of a prediction by the mean of each measured channel:
        the ratio is that of the model's errors over these, below 1 if the model is better.
    calibration
        Calibration of the prediction intervals of all records together, by channel.
    """

    records: tuple[RecordPrediction, ...]
    errors: ByHorizon[Mapping[str, PredictionErrors]]
    explained: PredictionChange
    calibration: ByHorizon[Mapping[str, Calibration]]


@dataclass(frozen=True)
class PredictionEvaluation:
    """Evaluation of a model on its estimation and validation data.

    Attributes
    ----------
    model
        The fitted model.
    horizon
        Prediction horizon [s].
    estimation
        Evaluation of the estimation data.
    validation
        Evaluation of the validation data, None if there are no validation data.
    residuals
        Residual analysis: one entry for each channel of each estimation record, then of each validation record.
        Channels of a record with fewer than 60 samples, or with constant innovations, have no entry. Blocks in time of
        records have none either.
    """

    model: Model
    horizon: float
    estimation: SetEvaluation
    validation: SetEvaluation | None
    residuals: tuple[ChannelResiduals, ...]

    @property
    def estimation_residuals(self) -> list[ChannelResiduals]:
        """Residual analysis of the estimation data."""
        return [r for r in self.residuals if r.role == "estimation"]

    @property
    def headline_set(self) -> Role:
        """Name of the set that headlines report: validation if validation data exist, else estimation."""
        return "estimation" if self.validation is None else "validation"

    @property
    def sets(self) -> dict[str, SetEvaluation]:
        """Evaluations by the role of the data, ``estimation`` and ``validation``.

        The key ``validation`` is missing if there are no validation data.
        """
        both = {"estimation": self.estimation, "validation": self.validation}
        return {role: evaluation for role, evaluation in both.items() if evaluation is not None}

    @property
    def widening(self) -> dict[str, float]:
        """Factor by channel with which the predicted standard deviations over the horizon are multiplied, at least 1.

        The factor is that of the validation data (`Calibration.widening`). The dictionary is empty without validation
        data, and lacks channels that these data do not have. Standard deviations without a factor are not changed.
        """
        return {} if self.validation is None else _intervals(self.validation, self.horizon).widening(self.horizon)


def evaluate(fitted: FittedModel, horizon: float | None = None) -> PredictionEvaluation:
    """Evaluate the predictions of a fitted model on every record.

    Parameters
    ----------
    fitted
        The fitted model with its evaluated records.
    horizon
        Prediction horizon [s]. None or 0: that of the model.

    Returns
    -------
    PredictionEvaluation
        Errors, calibration and residual tests of all records.
    """
    seconds, likelihood = horizon or fitted.model.horizon, Likelihood(fitted.model)
    estimated, validated = _evaluate_set(fitted, fitted.estimation, True, seconds, likelihood), None
    if fitted.validation:
        validated = _evaluate_set(fitted, fitted.validation, False, seconds, likelihood)
        intervals = _intervals(validated, seconds)
        estimated, validated = _widened(estimated, intervals), _widened(validated, intervals)
    whole: dict[Role, tuple[RecordEvaluation, ...]] = {
        "estimation": fitted.estimation,
        "validation": () if fitted.in_blocks else fitted.validation,
    }
    tests = [
        residual_tests(fitted.model, v.record, v.run.standardised, role) for role, views in whole.items() for v in views
    ]
    return PredictionEvaluation(fitted.model, seconds, estimated, validated, tuple(r for found in tests for r in found))


def _evaluate_set(
    fitted: FittedModel, views: Sequence[RecordEvaluation], is_estimation: bool, seconds: float, likelihood: Likelihood
) -> SetEvaluation:
    """Evaluate one set of records: one-step errors, errors over the horizon, simulations, and their calibration.

    Parameters
    ----------
    fitted
        The fitted model.
    views
        Records of the set with their parameter values and filter runs.
    is_estimation
        Whether the model was fitted to these records. Their per-record parameters then have the uncertainty of the fit;
        otherwise these count as exact in the simulation.
    seconds
        Prediction horizon [s].
    likelihood
        Likelihood of the model.
    """
    model = fitted.model
    simulated = [
        simulation_run(
            model, v.record, v.values, likelihood, parameter_uncertainty(fitted.fit, i if is_estimation else None)
        )
        for i, v in enumerate(views)
    ]
    errors_ahead = [horizon_errors(model, v.record, v.values, v.run.x_filt, seconds) for v in views]
    errors = ByHorizon[Mapping[str, PredictionErrors]](
        pooled_errors([one_step_errors(model, v.record, v.run) for v in views]),
        pooled_errors(errors_ahead),
        pooled_errors([s.errors for s in simulated]),
    )
    forecasts = [calibration.horizon_forecasts(model, v.record, v.values, v.run, seconds, likelihood) for v in views]
    from_inputs = [
        calibration.simulation_calibration(model, v.record, s) for v, s in zip(views, simulated, strict=True)
    ]
    calibrated = ByHorizon[Mapping[str, Calibration]](
        calibration.pooled_calibration([calibration.one_step_calibration(model, v.run) for v in views]),
        calibration.pooled_calibration([calibration.horizon_calibration(f) for f in forecasts]),
        calibration.pooled_calibration(from_inputs, together=True),
    )
    records = tuple(
        RecordPrediction(
            v.record, {n: horizon_prediction(v.record, n, e, f.get(n)) for n, e in by_name.items()}, by_name, s
        )
        for v, by_name, f, s in zip(views, errors_ahead, forecasts, simulated, strict=True)
    )
    mean = {name: PredictionErrors(e.t, e.about) for name, e in errors.horizon.items()}
    return SetEvaluation(records, errors, prediction_change(mean, errors.horizon, seconds), calibrated)


def _intervals(validated: SetEvaluation, seconds: float) -> IntervalCalibration:
    """Return the scales of the errors on validation data, over a horizon of ``seconds`` [s] and in simulation."""
    ahead, simulation = (
        {name: channel.error_scale for name, channel in found.items()}
        for found in (validated.calibration.horizon, validated.calibration.simulation)
    )
    return IntervalCalibration(seconds, ahead, simulation)


def _widened(evaluation: SetEvaluation, intervals: IntervalCalibration) -> SetEvaluation:
    """Return the evaluation with the standard deviations over the horizon and in simulation times their factors.

    Channels without a factor are not changed. The calibration stays that of the predicted standard deviations.
    """
    ahead, simulation = intervals.widening(intervals.horizon), intervals.widening(None)
    records = []
    for r in evaluation.records:
        horizon = {n: replace(h, sd=h.sd * ahead.get(n, 1.0)) for n, h in r.horizon.items()}
        factors = np.array([simulation.get(name, 1.0) for name in r.record.outputs])
        records.append(replace(r, horizon=horizon, simulation=replace(r.simulation, sd=r.simulation.sd * factors)))
    return replace(evaluation, records=tuple(records))


def horizon_prediction(
    record: Record, name: str, errors: PredictionErrors, forecast: Forecast | None
) -> HorizonPrediction:
    """Return the predictions of the channel ``name`` at the times of their errors: measured value minus error.

    A diverged prediction, whose error is infinite, is NaN. The standard deviation is interpolated linearly between the
    forecasts, which are fewer; before the first and after the last it is that of the nearest forecast. It is NaN
    without forecasts (None).
    """
    y = record.y[np.searchsorted(record.t, errors.t), record.outputs.index(name)] - errors.e
    sd = np.full(y.size, np.nan) if forecast is None else np.interp(errors.t, forecast.t, forecast.sd)
    return HorizonPrediction(errors.t, np.where(np.isfinite(y), y, np.nan), sd)


def residual_tests(model: Model, record: Record, eps: Array, role: Role = "estimation") -> list[ChannelResiduals]:
    """Test the residuals of one record for whiteness and for correlation with the inputs, channel by channel.

    Parameters
    ----------
    model
        The model.
    record
        The record.
    eps : Array (n_rows, n_outputs)
        Standardised innovations, NaN for rows without a sample and for outliers; these are left out.
    role
        Role of the record.

    Returns
    -------
    list of ChannelResiduals
        A result for each channel, with the correlations with the inputs of `shown_inputs`. Channels with fewer than 60
        samples or with constant innovations are left out.
    """
    found = []
    for j, o in enumerate(model.outputs):
        good = np.isfinite(eps[:, j])
        if good.sum() < FEWEST or not np.ptp(eps[good, j]):
            continue
        t, e = record.t[good], eps[good, j]
        coefficients = autoregression(e)  # the same for all inputs
        inputs = tuple(
            cross_correlation(o.name, t, e, name, record.t, record.u[:, k], coefficients)
            for k, name, _ in shown_inputs(model)
        )
        tests = whiteness_test(o.name, t, e)
        found.append(ChannelResiduals(role, record.name, o.name, o.unit, t + record.t_from, e, tests, inputs))
    return found


def shown_inputs(model: Model) -> list[tuple[int, str, str]]:
    """Return the inputs that reports show, as tuples (column in ``record.u``, shown name, unit).

    The time, the work of the thrusters (integral of cubed shaft speeds) and inputs with an empty label are left out. An
    input with a label is shown under its label: of the delayed copies of a thruster's command, only the command itself
    is shown.
    """
    shown = []
    for j, i in enumerate(model.inputs):
        label = i.name if i.label is None else i.label
        if label and i.name not in (TIME_INPUT, WORK_INPUT):
            shown.append((j, label, i.unit))
    return shown


def prediction_changes(before: PredictionEvaluation, after: PredictionEvaluation) -> dict[str, PredictionChange]:
    """Compare the prediction errors of two models over the horizon.

    Parameters
    ----------
    before, after
        Evaluations of the two models.

    Returns
    -------
    dict of str to PredictionChange
        Change for each role of the data (``estimation``, ``validation``) that ``before`` has. It uses the records that
        both models were evaluated on. All ratios are NaN if there are no such records.
    """
    old, new = (
        {role: {r.record.name: r.errors for r in part.records} for role, part in evaluation.sets.items()}
        for evaluation in (before, after)
    )
    return {role: prediction_change_by_record(errors, new.get(role, {}), after.horizon) for role, errors in old.items()}


@dataclass(frozen=True)
class SmoothedForce:
    """Smoothed estimate of a disturbance force in one record.

    Attributes
    ----------
    record, name, unit
        Names of record and force, and the unit of the force.
    t : Array (n,)
        Times [s].
    mean, sd : Array (n,)
        Mean and standard deviation in the unit of the force, given all data of the record.
    """

    record: str
    name: str
    unit: str
    t: Array
    mean: Array
    sd: Array


def smoothed_forces(fitted: FittedModel, forces: Sequence[DisturbanceChannel]) -> tuple[SmoothedForce, ...]:
    """Return the smoothed disturbance forces of the estimation data.

    Parameters
    ----------
    fitted
        The fitted model with its evaluated records.
    forces
        Disturbance forces; each has a state in the model.

    Returns
    -------
    tuple of SmoothedForce
        One entry for each record and force, record by record. Mean and standard deviation come from the smoother, which
        uses all samples of the record.
    """
    states = [s.name for s in fitted.model.states]
    return tuple(
        SmoothedForce(v.record.name, f.name, f.unit, v.record.t_log, v.smoothed.x[:, i], v.smoothed.sd[:, i])
        for v in fitted.estimation
        for f in forces
        for i in [states.index(f.state)]
    )
