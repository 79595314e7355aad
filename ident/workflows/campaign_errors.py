"""Prediction errors on the logs of two campaigns, with the values of each and with the changed parameters alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from seatrial.daq.errors import SeatrialError
from seatrial.ident.checks import device_faults
from seatrial.ident.data import load_all, make_record
from seatrial.ident.estimation import (
    conditional_mean,
    evaluate_records,
    mean_of_logs,
    model_values,
    nominal_model,
)
from seatrial.ident.models import accepting_code
from seatrial.ident.parallel import Workers, run_many
from seatrial.ident.reporter import Reporter
from seatrial.ident.results import CampaignErrors, FailedLog, error_rows, finite
from seatrial.ident.validation import PredictionErrors, horizon_errors, pooled_errors, prediction_change_by_record
from seatrial.ident.workflows.campaign_fits import Comparison, Values
from seatrial.ident.workflows.campaign_logs import FittedLogs, campaign_of, positive_definite
from seatrial.ident.workflows.fleet import FleetLog, portable
from seatrial.ident.workflows.vehicle_model import VehicleRequest, vehicle_problem


@dataclass(frozen=True)
class PredictedLog:
    """Log whose predictions are compared, as a task for a worker.

    Attributes
    ----------
    log
        The log.
    values
        Values of each model, by name of the model (`CampaignErrors.values`): reported values by reported name.
    """

    log: FleetLog
    values: Mapping[str, Values]


@dataclass(frozen=True)
class LogErrors:
    """Prediction errors of several models on one log.

    Attributes
    ----------
    horizon
        Prediction horizon [s].
    units
        Unit of each channel.
    errors
        Prediction errors by model and channel. A log that is shorter than the horizon has none.
    """

    horizon: float
    units: Mapping[str, str]
    errors: Mapping[str, Mapping[str, PredictionErrors]]


@dataclass(frozen=True)
class Predictions:
    """Predictions of the logs of two campaigns.

    Attributes
    ----------
    errors
        Errors on the logs of each campaign, by the values of the model.
    horizon
        Prediction horizon [s].
    failed
        Logs that could not be predicted, with the reasons.
    """

    errors: tuple[CampaignErrors, ...]
    horizon: float
    failed: tuple[FailedLog, ...]


def prediction_errors(
    fitted: FittedLogs,
    comparison: Comparison,
    logs: Sequence[FleetLog],
    vehicle: VehicleRequest,
    code: frozenset[str],
    workers: Workers,
    reporter: Reporter,
) -> Predictions:
    """Predict each log by the values of the campaigns without this log, and return the errors and the horizon [s].

    Values that need the log itself, because its campaign has no other one, are left out. ``code`` has the hashes of the
    Python files that the model may run. The reporter gets a warning for each log that cannot be predicted.
    """
    by_name = {log.name: log for log in logs}
    before = _campaign_values(fitted.part(~fitted.after), comparison.scatter)
    tasks = [
        PredictedLog(by_name[name], values)
        for k, name in enumerate(fitted.logs)
        if (values := _values_without(fitted, comparison, k, before))
    ]
    found: dict[str, LogErrors] = {}
    failed: list[FailedLog] = []
    work = partial(_errors_of_log, portable(vehicle), code)
    for n, outcome in enumerate(run_many(tasks, work, workers, reporter), 1):
        if outcome.value is None:
            reporter.warning(f"{outcome.task.log.name}: no prediction: {outcome.error}")
            failed.append(FailedLog(log=outcome.task.log.name, reason=outcome.error))
            continue
        found[outcome.task.log.name] = outcome.value
        reporter.progress(f"{n} of {len(tasks)}: {outcome.task.log.name} predicted")
    horizon = next((x.horizon for x in found.values()), vehicle.estimation.horizon or float("nan"))
    later = dict(zip(fitted.logs, fitted.after.tolist(), strict=True))
    rows = []
    for after, kinds in ((False, ("before",)), (True, ("before", "changed", "after"))):
        part = {log: found[log] for log in fitted.logs if log in found and later[log] is after}
        rows += [row for kind in kinds if (row := _errors_row(part, after, kind, horizon)) is not None]
    return Predictions(tuple(rows), horizon, tuple(failed))


def _values_without(fitted: FittedLogs, comparison: Comparison, k: int, before: Values) -> dict[str, Values]:
    """Return the values of the models that predict the log with the index k, none of which uses this log.

    A log before gets the values of the other logs before. A log after gets those before (``before``), those before with
    the changed parameters of after, and those after. The parameters of a changed combination count as changed, and
    beside a changed parameter also those that have changed by one factor: the lost thrust of one side changes the mean
    thrust, and so masses and damping, whose single changes the unknown scale of the forces hides.
    """
    others = fitted.part((np.arange(len(fitted.logs)) != k) & (fitted.after == fitted.after[k]))
    if not fitted.after[k]:
        return {"before": _campaign_values(others, comparison.scatter)} if others.logs else {}
    found = {"before": before}
    if others.logs:
        changed = {p.name for p in comparison.parameters if p.changed}
        changed |= {name for c in comparison.combinations if c.changed for name in c.parameters}
        factor = comparison.common_factor
        if changed and factor is not None and factor.explains:
            changed |= set(factor.parameters)
        if changed:
            found["changed"] = _campaign_values(others, comparison.scatter, before, changed)
        found["after"] = _campaign_values(others, comparison.scatter)
    return found


def _campaign_values(
    part: FittedLogs, scatter: Mapping[str, float], held: Values | None = None, changed: set[str] | None = None
) -> Values:
    """Return the values of all parameters of one campaign: means over its logs, with their correlations.

    Parameters
    ----------
    part : FittedLogs
        Logs of the campaign.
    scatter : mapping
        Scatter between the logs by parameter; 0 for other parameters.
    held : dict, optional
        Values of another campaign. All parameters except ``changed`` keep them, and the changed ones get the values
        that the logs have together with them.
    changed : set of str, optional
        Names of the changed parameters.

    Notes
    -----
    The estimates of one log are correlated: linear and quadratic damping, for example. A changed parameter alone, with
    the others of another campaign, would not predict the motion. Parameters without an error in a log have their plain
    mean.
    """
    names = [n for n in part.names if not any(r[n]["per_log"] for r in part.rows if n in r)]
    found = {n: float(np.mean([r[n]["value"] for r in part.rows if n in r])) for n in names}
    known = [n for n in names if part.known(n).all()]
    if known:
        covariances = np.array([positive_definite(S, np.diag(S)) for S in part.covariances(known)])
        mean, covariance = mean_of_logs(part.values(known), covariances, np.array([scatter.get(n, 0.0) for n in known]))
        if held is not None:
            same = np.array([n in held and n not in (changed or ()) for n in known])
            mean = conditional_mean(mean, covariance, same, np.array([held.get(n, 0.0) for n in known]))
        found |= dict(zip(known, mean.tolist(), strict=True))
    return found if held is None else held | {n: v for n, v in found.items() if n in (changed or ())}


def _errors_of_log(vehicle: VehicleRequest, code: frozenset[str], task: PredictedLog) -> LogErrors:
    """Predict one log by each model, in a worker process. ``code``: hashes of the Python files that may be run."""
    loaded, _ = load_all([task.log.path], [], vehicle.window, device_faults)
    with accepting_code(code):
        problem = vehicle_problem(vehicle, loaded, [])
    # First order, as in `seatrial ident compare`.
    model = replace(nominal_model(problem.model), second_order=False)
    horizon = vehicle.estimation.horizon or model.horizon
    record = make_record(model, problem.segments[0], vehicle.rate)
    found = {}
    for kind, values in task.values.items():
        # The priors of the nominal model are scaled to the size of the boat.
        adapted = nominal_model(model.with_values(model_values(model, values)))
        views, failed = evaluate_records(adapted, [record])
        if failed:
            raise SeatrialError(failed[0].reason)
        (v,) = views
        found[kind] = horizon_errors(v.model, v.record, v.values, v.run.x_filt, horizon)
    return LogErrors(horizon, {o.name: o.unit for o in model.outputs}, found)


def _errors_row(part: Mapping[str, LogErrors], after: bool, kind: Any, horizon: float) -> CampaignErrors | None:
    """Return the prediction errors of one model on the logs of one campaign.

    The result is None if the model predicts no channel of these logs.
    """
    now = {log: x.errors[kind] for log, x in part.items() if x.errors.get(kind)}
    base = {log: x.errors["before"] for log, x in part.items() if log in now and x.errors.get("before")}
    units = {name: unit for x in part.values() for name, unit in x.units.items()}
    new, old = (pooled_errors(list(errors.values())) for errors in (now, base))
    if not new:
        return None
    if kind == "before":
        return CampaignErrors(logs=campaign_of(after), values=kind, channels=error_rows(new, {}, units))
    change = prediction_change_by_record(base, now, horizon)
    return CampaignErrors(
        logs=campaign_of(after), values=kind, channels=error_rows(new, old, units, change), ratio=finite(change.ratio),
        low=finite(change.low), high=finite(change.high), verdict=change.verdict,
    )  # fmt: skip
