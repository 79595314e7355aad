"""Predictions of one record by one model of a comparison: the task that `seatrial ident compare` runs in parallel."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.data import Record
from seatrial.ident.estimation import (
    FIT_ERRORS,
    IntervalCalibration,
    Likelihood,
    ParameterUncertainty,
    RecordEvaluation,
    evaluate_records,
    evaluated_in_blocks,
)
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array
from seatrial.ident.results import PredictionKind
from seatrial.ident.validation import (
    ChannelResiduals,
    PredictionErrors,
    horizon_errors,
    horizon_forecasts,
    horizon_prediction,
    one_step_calibration,
    one_step_errors,
    residual_tests,
    simulation_run,
    standardised_errors,
)


class Kind(NamedTuple):
    """Kind of prediction and its horizon.

    Attributes
    ----------
    kind
        One step ahead, over a horizon, or a simulation.
    seconds
        Horizon [s]. None for the other kinds.
    """

    kind: PredictionKind
    seconds: float | None = None


ONE_STEP, SIMULATION = Kind("one_step"), Kind("simulation")


class Curve(NamedTuple):
    """Predicted channel over time.

    Attributes
    ----------
    t, y, sd : Array (n,)
        Times of the samples [s], predicted values (NaN from the divergence on), and their standard deviations.
    """

    t: Array
    y: Array
    sd: Array


@dataclass(frozen=True)
class PredictionTask:
    """Prediction of one record by one model.

    Attributes
    ----------
    index
        Index of the model in the comparison.
    model
        Model with its estimates, with a first-order filter.
    record
        The record.
    horizons
        Prediction horizons [s].
    interval
        Length of the intervals [s] of which each has one prediction of a channel over a horizon.
    uncertainty
        Uncertainty of the parameters, which widens the band of the simulation; None: not known.
    block
        Duration [s] over which residuals may be correlated, from which the length of blocks in time follows
        (``evaluated_in_blocks``). None: the record is predicted as a whole.
    """

    index: int
    model: Model
    record: Record
    horizons: tuple[float, ...]
    interval: float
    uncertainty: ParameterUncertainty | None = None
    block: float | None = None


@dataclass(frozen=True)
class PredictedRecord:
    """Predictions of one record, or of one block in time of it, by one model.

    Attributes
    ----------
    t : Array (n_rows,)
        Times of the rows [s].
    samples
        Number of samples of each channel that has any.
    ll : Array (n_rows,)
        Contribution of each row to the log-likelihood.
    errors
        Prediction errors by kind of prediction and channel.
    curves
        Predictions by horizon or simulation, and by channel.
    standardised
        Errors over their standard deviations at the times of `errors`, by kind of prediction and channel. NaN for an
        outlier one step ahead, and infinite where a prediction diverged. Channels without standard deviations are left
        out.
    residuals
        Standardised innovations with their tests, by channel; empty for a block in time of a record.
    """

    t: Array
    samples: Mapping[str, int]
    ll: Array
    errors: Mapping[Kind, Mapping[str, PredictionErrors]]
    curves: Mapping[Kind, Mapping[str, Curve]]
    standardised: Mapping[Kind, Mapping[str, Array]] = field(default_factory=dict)
    residuals: Sequence[ChannelResiduals] = ()


def predict_record(task: PredictionTask) -> list[PredictedRecord]:
    """Predict a record, or blocks in time of it, by a model one step ahead, over each horizon and in simulation.

    Only the parameters that belong to a log, such as the current, are estimated from the record. In blocks, those of
    effects are estimated from the other blocks of the record.

    Parameters
    ----------
    task : PredictionTask
        Model, record and horizons.

    Returns
    -------
    list of PredictedRecord
        Errors, log-likelihood and predictions of each block in the order of time, or of the record alone.

    Raises
    ------
    SeatrialError
        If the model cannot predict the record, with the reason.
    """
    views, failed = evaluate_records(task.model, [task.record])
    if failed:
        raise SeatrialError(failed[0].reason)
    if task.block is not None:
        try:
            views = list(evaluated_in_blocks(views[0].model, views, task.block))
        except FIT_ERRORS as problem:
            raise SeatrialError(str(problem)) from None
    return [_predictions(view, task) for view in views]


def _predictions(view: RecordEvaluation, task: PredictionTask) -> PredictedRecord:
    """Return the predictions of an evaluated record, or of a block of it, for the horizons of a task."""
    model, record, likelihood = view.model, view.record, Likelihood(view.model)
    errors: dict[Kind, Mapping[str, PredictionErrors]] = {ONE_STEP: one_step_errors(model, record, view.run)}
    innovations = one_step_calibration(model, view.run)
    z: dict[Kind, Mapping[str, Array]] = {
        ONE_STEP: {n: innovations[n][np.searchsorted(record.t, e.t)] for n, e in errors[ONE_STEP].items()}
    }
    curves: dict[Kind, Mapping[str, Curve]] = {}
    for seconds in task.horizons:
        kind = Kind("horizon", seconds)
        errors[kind] = horizon_errors(model, record, view.values, view.run.x_filt, seconds, task.interval)
        curves[kind] = _horizon_curves(view, errors[kind], seconds, likelihood)
        z[kind] = {
            n: standardised_errors(errors[kind][n].e, curve.sd)
            for n, curve in curves[kind].items()
            if np.isfinite(curve.sd).any()
        }
    simulated = simulation_run(model, record, view.values, likelihood, task.uncertainty)
    errors[SIMULATION] = simulated.errors
    own: dict[str, Curve] = {}
    for j, o in enumerate(model.outputs):
        seen = np.isfinite(record.y[:, j])
        if seen.any():
            t, y = record.t[seen], simulated.y[seen, j].copy()
            y[t >= simulated.diverged.get(o.name, np.inf)] = np.nan
            own[o.name] = Curve(t, y, simulated.sd[seen, j])
    curves[SIMULATION] = own
    z[SIMULATION] = {
        n: standardised_errors(e.e, own[n].sd[np.searchsorted(own[n].t, e.t)]) for n, e in simulated.errors.items()
    }
    counts = np.isfinite(record.y).sum(axis=0).tolist()
    samples = {name: n for name, n in zip(record.outputs, counts, strict=True) if n}
    tests = residual_tests(model, record, view.run.standardised, "validation") if task.block is None else ()
    return PredictedRecord(record.t, samples, view.ll, errors, curves, z, tests)


def widened(predicted: PredictedRecord, intervals: IntervalCalibration | None) -> PredictedRecord:
    """Return the predictions with the standard deviations of a run that the model has not seen.

    Those over the horizon of the validation, and of the simulation, are multiplied by the factor of the channel. Other
    horizons, predictions one step ahead, and channels without a factor are not changed. A channel with an infinite
    factor (its prediction of the validation data diverged) has no standardised errors.

    Parameters
    ----------
    predicted : PredictedRecord
        Predictions with the standard deviations of the model itself.
    intervals : IntervalCalibration or None
        Scales of the errors on the validation data of the model; None: there were none.
    """
    if intervals is None:
        return predicted
    curves, z = dict(predicted.curves), dict(predicted.standardised)
    for kind, by_name in curves.items():
        factors = intervals.widening(kind.seconds)
        curves[kind] = {n: curve._replace(sd=curve.sd * factors.get(n, 1.0)) for n, curve in by_name.items()}
        own = z.get(kind, {})
        z[kind] = {n: e / f for n, e in own.items() if np.isfinite(f := factors.get(n, 1.0))}
    return replace(predicted, curves=curves, standardised=z)


def _horizon_curves(
    view: RecordEvaluation, errors: Mapping[str, PredictionErrors], seconds: float, likelihood: Likelihood
) -> dict[str, Curve]:
    """Return the predictions over a horizon of ``seconds`` [s] by channel, from their errors.

    Their standard deviations are those that the model predicts for the errors, with process and measurement noise.
    """
    forecasts = horizon_forecasts(view.model, view.record, view.values, view.run, seconds, likelihood)
    found = {n: horizon_prediction(view.record, n, e, forecasts.get(n)) for n, e in errors.items()}
    return {n: Curve(p.t, p.y, p.sd) for n, p in found.items()}
