"""How well a fitted model predicts every record, computed once: errors, calibration, whiteness of the residuals."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Generic, Literal, TypeVar

import numpy as np

from seatrial.ident.data import TIME_INPUT, WORK_INPUT, Record
from seatrial.ident.estimation import FittedModel, Likelihood, RecordEvaluation, parameter_uncertainty
from seatrial.ident.model import Model, Residual
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

FEWEST = 60  # samples of a channel whose residuals are tested

T = TypeVar("T")


@dataclass(frozen=True)
class ByHorizon(Generic[T]):
    """The same of predictions one step ahead, over a horizon, and from the inputs alone."""

    one_step: T
    horizon: T
    simulation: T


@dataclass(frozen=True)
class HorizonPrediction:
    """A channel as predicted over the horizon: y and its standard deviation sd (n,) at t (n,) [s]."""

    t: Array
    y: Array
    sd: Array


@dataclass(frozen=True)
class RecordPrediction:
    """A record and what the model predicts of it: over the horizon, by channel, with its errors, and from the inputs
    alone."""

    record: Record
    horizon: Mapping[str, HorizonPrediction]
    errors: Mapping[str, PredictionErrors]
    simulation: SimulationRun


@dataclass(frozen=True)
class ChannelResiduals:
    """Standardised innovations e (n,) of a channel at the times t (n,) [s], the tests whether they are white, and
    their correlation with each input."""

    record: str
    channel: str
    unit: str
    t: Array
    e: Array
    tests: Whiteness
    inputs: tuple[CrossCorrelation, ...]

    @property
    def lags(self) -> Array:
        """Of the autocorrelation (n_lags,) [s]."""
        return float(np.median(np.diff(self.t))) * np.arange(1.0, self.tests.acf.size + 1.0)


@dataclass(frozen=True)
class SetEvaluation:
    """Of all records of a set of data together: errors and calibration by channel; ``explained``: the errors over the
    horizon against those of a prediction by the mean of what was measured."""

    records: tuple[RecordPrediction, ...]
    errors: ByHorizon[Mapping[str, PredictionErrors]]
    explained: PredictionChange
    calibration: ByHorizon[Mapping[str, Calibration]]


@dataclass(frozen=True)
class PredictionEvaluation:
    """``horizon``: s that predictions go ahead between one step and the simulation; ``residuals``: of the estimation
    data."""

    model: Model
    horizon: float
    estimation: SetEvaluation
    validation: SetEvaluation | None
    residuals: tuple[ChannelResiduals, ...]

    @property
    def judged(self) -> Literal["estimation", "validation"]:
        """The set that headlines are of: data that the fit has not seen, where there are some."""
        return "estimation" if self.validation is None else "validation"

    @property
    def sets(self) -> dict[str, SetEvaluation]:
        """By role; without validation where there are no such data."""
        both = {"estimation": self.estimation, "validation": self.validation}
        return {role: one for role, one in both.items() if one is not None}


def evaluate(stage: FittedModel, horizon: float | None = None) -> PredictionEvaluation:
    """Predictions of a fitted model against every record. ``horizon`` [s]: by default the model's usual one."""
    seconds, likelihood = horizon or stage.model.horizon, Likelihood(stage.model)
    return PredictionEvaluation(
        stage.model,
        seconds,
        _evaluated(stage, stage.estimation, True, seconds, likelihood),
        _evaluated(stage, stage.validation, False, seconds, likelihood) if stage.validation else None,
        tuple(r for v in stage.estimation for r in residual_tests(stage.model, v.record, v.run.standardised)),
    )


def _evaluated(
    stage: FittedModel, views: Sequence[RecordEvaluation], fitted: bool, seconds: float, likelihood: Likelihood
) -> SetEvaluation:
    model = stage.model
    simulated = [
        simulation_run(model, v.record, v.values, likelihood, parameter_uncertainty(stage.fit, i if fitted else None))
        for i, v in enumerate(views)
    ]
    ahead = [horizon_errors(model, v.record, v.values, v.run.x_filt, seconds) for v in views]
    errors = ByHorizon[Mapping[str, PredictionErrors]](
        pooled_errors([one_step_errors(model, v.record, v.run) for v in views]),
        pooled_errors(ahead),
        pooled_errors([s.errors for s in simulated]),
    )
    forecasts = [calibration.horizon_forecasts(model, v.record, v.values, v.run, seconds, likelihood) for v in views]
    alone = [calibration.simulation_calibration(model, v.record, s) for v, s in zip(views, simulated, strict=True)]
    calibrated = ByHorizon[Mapping[str, Calibration]](
        calibration.pooled_calibration([calibration.one_step_calibration(model, v.run) for v in views]),
        calibration.pooled_calibration([calibration.horizon_calibration(f) for f in forecasts]),
        calibration.pooled_calibration(alone, together=True),
    )
    records = tuple(
        RecordPrediction(v.record, {n: _predicted(v.record, n, e, f.get(n)) for n, e in far.items()}, far, s)
        for v, far, f, s in zip(views, ahead, forecasts, simulated, strict=True)
    )
    mean = {name: PredictionErrors(e.t, e.about) for name, e in errors.horizon.items()}
    return SetEvaluation(records, errors, prediction_change(mean, errors.horizon, seconds), calibrated)


def _predicted(record: Record, name: str, errors: PredictionErrors, forecast: Forecast | None) -> HorizonPrediction:
    """The standard deviation between the forecasts, which are fewer, is interpolated."""
    y = record.y[np.searchsorted(record.t, errors.t), record.outputs.index(name)] - errors.e
    sd = np.full(y.size, np.nan) if forecast is None else np.interp(errors.t, forecast.t, forecast.sd)
    return HorizonPrediction(errors.t, np.where(np.isfinite(y), y, np.nan), sd)


def residual_tests(model: Model, record: Record, eps: Array) -> list[ChannelResiduals]:
    """Of one record from its standardised innovations (n_rows, n_outputs). A channel of fewer than 60 samples, or
    whose innovations are all the same, is left out."""
    found = []
    for j, o in enumerate(model.outputs):
        good = np.isfinite(eps[:, j])
        if good.sum() < FEWEST or not np.ptp(eps[good, j]):
            continue
        t, e = record.t[good], eps[good, j]
        colour = autoregression(e)
        inputs = tuple(
            cross_correlation(o.name, t, e, name, record.t, record.u[:, k], colour)
            for k, name, _ in shown_inputs(model)
        )
        found.append(ChannelResiduals(record.name, o.name, o.unit, t, e, whiteness_test(o.name, t, e), inputs))
    return found


def shown_inputs(model: Model) -> list[tuple[int, str, str]]:
    """Column, name and unit of the inputs that people look at: not an input's own past, and of the delayed copies of a
    thruster's command the command itself."""
    shown = []
    for j, i in enumerate(model.inputs):
        label = i.name if i.label is None else i.label
        if label and i.name not in (TIME_INPUT, WORK_INPUT):
            shown.append((j, label, i.unit))
    return shown


def prediction_changes(before: PredictionEvaluation, after: PredictionEvaluation) -> dict[str, PredictionChange]:
    """By role, the change of the prediction errors over the horizon from one model to the other, on the records that
    both could be evaluated on."""
    of_role = [
        {role: {r.record.name: r.errors for r in one.records} for role, one in of.sets.items()}
        for of in (before, after)
    ]
    return {
        role: prediction_change_by_record(of, of_role[1].get(role, {}), after.horizon)
        for role, of in of_role[0].items()
    }


@dataclass(frozen=True)
class SmoothedForce:
    """A disturbance force of a record, from all of its data: mean, sd (n,) at t (n,) [s]."""

    record: str
    name: str
    unit: str
    t: Array
    mean: Array
    sd: Array


def smoothed_forces(stage: FittedModel, forces: Sequence[Residual]) -> tuple[SmoothedForce, ...]:
    """The unexplained ``forces``, which are states of the model, in the estimation data."""
    states = [s.name for s in stage.model.states]
    return tuple(
        SmoothedForce(v.record.name, f.name, f.unit, v.record.t, v.smoothed.x[:, i], v.smoothed.sd[:, i])
        for v in stage.estimation
        for f in forces
        for i in [states.index(f.state)]
    )
