"""Workflow of `seatrial ident changes`: one vehicle model on two campaigns of logs, and what differs between them.

The model is fitted to each log separately, as by `seatrial ident fleet`, with the same table of estimates. It has the
common errors of sensors and hull form that a fit of the logs before shows, the same for all logs, and a difference of
the thrusts of both sides. The means of the campaigns are compared with the scatter between logs as a random effect
(docs/decisions/0049-campaigns.md). The logs are then predicted with the values of each campaign.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import msgspec

from seatrial.daq.errors import SeatrialError, counted
from seatrial.ident.checks import device_faults
from seatrial.ident.data import load_all
from seatrial.ident.effects import catalogue
from seatrial.ident.models import accepting_code, is_own_model, thrust_of
from seatrial.ident.parallel import Workers
from seatrial.ident.reporter import Reporter
from seatrial.ident.results import (
    CampaignLog,
    CampaignsResult,
    FailedLog,
    VehicleResult,
    campaigns_answer,
    provenance,
    read_result,
    write_result,
)
from seatrial.ident.workflows.campaign_errors import prediction_errors
from seatrial.ident.workflows.campaign_fits import FALSE_DISCOVERY_RATE, compare_fits
from seatrial.ident.workflows.campaign_logs import Row, campaign_of, fitted_logs
from seatrial.ident.workflows.fleet import (
    TABLE,
    FleetLog,
    FleetRequest,
    checked_code,
    fit_logs,
    hashed_logs,
    score_test_note,
    warnings_of_logs,
)
from seatrial.ident.workflows.vehicle import fit_vehicle, is_tested, write_vehicle_fit
from seatrial.ident.workflows.vehicle_model import VehicleRequest, is_saved_model, vehicle_problem

LOGS_TOGETHER = 4  # logs before that are fitted together to find the common errors; more would only take longer


@dataclass(frozen=True)
class ChangesRequest:
    """Options of `seatrial ident changes`.

    Attributes
    ----------
    before, after
        Logs of both campaigns. A log in both is an error.
    vehicle
        Options of each fit. Its logs and its folder are not used.
    out
        Folder for the results; None: no file is written.
    workers
        Processes that run the fits and the predictions.
    force
        Whether to start again if the folder has fits. Otherwise the fits in it are used.
    false_discovery_rate
        Largest expected share of false ones among the changed parameters, between 0 and 1.
    common_errors
        Whether the first logs before are fitted together first, and the common errors that they show are added to the
        model of all logs, with a difference of the thrusts of both sides. A saved model gets this difference only. It
        has no influence on a user-defined model, and on fits with score tests.
    """

    before: Sequence[Path]
    after: Sequence[Path]
    vehicle: VehicleRequest
    out: Path | None
    workers: Workers = field(default_factory=Workers)
    force: bool = False
    false_discovery_rate: float = FALSE_DISCOVERY_RATE
    common_errors: bool = True


@dataclass(frozen=True)
class Changes:
    """Comparison of two campaigns.

    Attributes
    ----------
    result
        Content of result.json.
    table
        All estimates as a ``pyarrow.Table``: the rows of fits.parquet.
    """

    result: CampaignsResult
    table: Any


def find_changes(request: ChangesRequest, command: str, reporter: Reporter) -> Changes:
    """Fit one model to the logs of two campaigns, and compare the campaigns.

    With a folder, it holds fits.parquet, which is replaced while the fits are running, and result.json at the end. Fits
    that fits.parquet has already are not repeated.

    Parameters
    ----------
    request : ChangesRequest
        Campaigns, options of a fit, folder and workers.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress and warnings.

    Returns
    -------
    Changes
        Differences between the campaigns, and the table of all estimates.

    Raises
    ------
    SeatrialError
        If a campaign has no log, or none whose fit converged, if a log is in both campaigns, if it is given which
        thruster has the given thrust, or as `fit_fleet`.

    Notes
    -----
    The differences refer to the mean thrust of both sides, also if the model of a file has the given thrust for one
    side: what has changed may be this side.
    """
    if not (request.before and request.after):
        raise SeatrialError("a comparison needs logs of both campaigns; give one or more before and one or more after")
    if request.vehicle.thrust_of is not None:
        raise SeatrialError(
            "--thrust-of: a comparison of campaigns does not assume that one thruster has kept its thrust; leave the "
            "option out"
        )
    if is_saved_model(request.vehicle.model) or ":thrust-of-" in request.vehicle.model:
        request = replace(request, vehicle=replace(request.vehicle, thrust_of="unknown"))
    code = checked_code(request.vehicle)
    before, after = (hashed_logs(paths, reporter) for paths in (request.before, request.after))
    twice = {x.sha256: x.name for x in before}
    for log in after:
        if log.sha256 in twice:
            raise SeatrialError(f"{log.name}: is in both campaigns (as {twice[log.sha256]}); leave it out of one")
    logs = [*before, *after]
    vehicle, common = request.vehicle, tuple[str, ...]()
    if request.common_errors and not is_tested(vehicle) and not is_saved_model(vehicle.model):
        vehicle, common = _with_common_errors(request, [log.path for log in before], reporter)
    sides = ""
    if request.common_errors and not is_tested(vehicle):
        with accepting_code(code):
            sides = _difference_of_sides(vehicle, logs)
        vehicle = replace(vehicle, effects=(*vehicle.effects, *filter(None, [sides])))
    table = fit_logs(logs, FleetRequest((), vehicle, request.out, request.workers, request.force), code, reporter)
    rows = table.to_pylist()
    later = {log.sha256 for log in after}
    fitted = fitted_logs(rows, later)
    if not fitted.after.any() or fitted.after.all():
        which = "before" if fitted.after.all() else "after"
        first = _failed([r for r in rows if (r["sha256"] in later) == (which == "after")])[0]
        raise SeatrialError(f"no fit to a log {which} has converged; {first.log}: {first.reason}")
    comparison = compare_fits(fitted, request.false_discovery_rate)
    predicted = prediction_errors(fitted, comparison, logs, vehicle, code, request.workers, reporter)
    made = provenance([], command)
    result = CampaignsResult(
        created=made.created, seatrial=made.seatrial, command=made.command, answer="",
        warnings=tuple(w for w in warnings_of_logs(rows) if w.code != "thrust-sides-differ"),  # a note has it
        notes=(
            *comparison.notes, *_notes_on_models(request.vehicle, common), *_notes_on_sides(sides),
            score_test_note(vehicle, rows),
        ),
        model=vehicle.model, score_tests=is_tested(vehicle), common_errors=common,
        table="" if request.out is None else str(request.out / TABLE),
        horizon=predicted.horizon, false_discovery_rate=request.false_discovery_rate,
        campaigns=_campaign_logs(rows, later), failed=_failed(rows), parameters=comparison.parameters,
        combinations=comparison.combinations, not_compared=comparison.not_compared, effects=comparison.effects,
        joint=comparison.joint, common_factor=comparison.common_factor, errors=predicted.errors,
        unpredicted=predicted.failed,
    )  # fmt: skip
    result = msgspec.structs.replace(result, answer=campaigns_answer(result))
    if request.out is not None:
        write_changes(result, request.out)
    return Changes(result, table)


def write_changes(result: CampaignsResult, folder: Path) -> None:
    """Write result.json and report.html of a comparison of campaigns to a folder. Existing files are replaced."""
    from seatrial.ident.report import write_report

    write_result(result, folder / "result.json")
    write_report(result, folder / "report.html")


def _with_common_errors(
    request: ChangesRequest, before: Sequence[Path], reporter: Reporter
) -> tuple[VehicleRequest, tuple[str, ...]]:
    """Return the options of each fit with the common errors of the logs before, and the names of these errors.

    The first `LOGS_TOGETHER` logs before are fitted together, as by `seatrial ident vehicle`. With a folder for the
    results, this fit is in its folder ``before``, and a continued run reads it there. The options are unchanged if the
    logs show too few common errors, if they cannot be fitted together, or for a user-defined model.

    Parameters
    ----------
    request : ChangesRequest
        Options of each fit, and the folder for the results.
    before : sequence of Path
        Logs of the campaign before.
    reporter : Reporter
        Receives the progress, and a warning if the logs cannot be fitted together.
    """
    together = replace(request.vehicle, logs=before[:LOGS_TOGETHER], score_tests=True)
    if not is_tested(together):
        return request.vehicle, ()
    folder = None if request.out is None else request.out / "before"
    if folder is None or request.force or not (folder / "result.json").exists():
        try:
            done = fit_vehicle(together, "", _ProgressOnly(reporter))
        except SeatrialError as problem:
            reporter.warning(f"the logs before cannot be fitted together to find common errors: {problem}")
            return request.vehicle, ()
        if folder is not None:
            write_vehicle_fit(done, folder)
    # The rounded values of the file, so that a continued run has the same start.
    found = done.result if folder is None else read_result(folder / "result.json")
    if not isinstance(found, VehicleResult) or found.common_errors is None:
        return request.vehicle, ()
    common = [name for name in found.common_errors.names if name not in request.vehicle.effects]
    own = {p.name for p in found.common_errors.parameters}  # without those of one log, whose names have its name too
    # The estimates are the start of the fits to single logs, which have less data.
    start = {p.name: p.value for p in found.fit.parameters if p.name in own and p.free}
    vehicle = replace(
        request.vehicle,
        effects=(*request.vehicle.effects, *common),
        initial={**start, **request.vehicle.initial},
    )
    return vehicle, tuple(common)


def _difference_of_sides(vehicle: VehicleRequest, logs: Sequence[FleetLog]) -> str:
    """Return the effect of a difference of the thrusts of both sides, which the model of all logs gets.

    The name is empty if the model cannot have it (it has one already, or no two thrusters), for a user-defined model,
    and if it is given which side has the given thrust. Without this effect, a thruster that has lost thrust looks like
    larger masses and damping. The first log that can be read decides.

    Parameters
    ----------
    vehicle : VehicleRequest
        Options of each fit.
    logs : sequence of FleetLog
        Logs of both campaigns.
    """
    effects = [e for e in catalogue().values() if e.thrust_difference]
    for log in logs:
        try:
            loaded, _ = load_all([log.path], [], vehicle.window, device_faults)
            model = vehicle_problem(vehicle, loaded, []).model
        except SeatrialError:
            continue  # the fit to this log fails with the reason
        if is_own_model(model.source) or thrust_of(model) or any(e.thrust_difference for e in model.effects):
            return ""
        return next((e.name for e in effects if model.accepts(e)), "")
    return ""


def _notes_on_sides(effect: str) -> list[str]:
    """Return the note on the effect that compares the thrusts of both sides; no note without it (empty text)."""
    if not effect:
        return []
    return [
        f"The model has the effect {effect}, so that the loss of thrust of one thruster does not look like larger "
        "masses and damping (--no-common-errors, in Python common_errors=False, leaves it out)."
    ]


class _ProgressOnly:
    """Reporter for the fit of the logs before, whose warnings come again with the fit of each log."""

    def __init__(self, reporter: Reporter) -> None:
        """Store the reporter that receives the progress."""
        self.reporter = reporter

    def progress(self, text: str, times: Callable[[], str] | None = None) -> None:
        """Pass the text on."""
        self.reporter.progress(text, times)

    def detail(self, text: str) -> None:
        """Pass the text on."""
        self.reporter.detail(text)

    def warning(self, text: str) -> None:
        """Ignore the text."""


def _notes_on_models(vehicle: VehicleRequest, common: Sequence[str]) -> list[str]:
    """Return the note on the common errors of the model, or on a model without them.

    The note also says how the sizes of effects depend on the model. The result is empty for fits with score tests, and
    for the model of a file.

    Parameters
    ----------
    vehicle : VehicleRequest
        Options of each fit as the user gave them.
    common : sequence of str
        Names of the common errors that a fit of the logs before has added.
    """
    if common:
        return [
            f"The model has the {counted(len(common), 'common error')} of sensors and hull form that the logs before "
            f"show: {', '.join(common)} (--no-common-errors, in Python common_errors=False, leaves them out)."
        ]
    if is_tested(vehicle) or is_saved_model(vehicle.model):
        return []
    sizes = ""
    if vehicle.effects:
        sizes = (
            f" The size of {', '.join(vehicle.effects)} can differ from that of a diagnosis, whose model has common "
            "errors and perhaps further effects."
        )
    return [
        f"The model has no common errors of sensors and hull form, which can hide changes.{sizes} To compare the "
        "campaigns with them: --model of a fit or a diagnosis of the logs before (before/model.toml)."
    ]


def _campaign_logs(rows: Sequence[Row], later: set[str]) -> tuple[CampaignLog, ...]:
    """Return the logs whose fit converged, those before first."""
    first = {r["log"]: r for r in reversed(rows) if r["converged"]}
    found = [
        CampaignLog(log=log, sha256=r["sha256"], campaign=campaign_of(r["sha256"] in later), duration=r["duration"])
        for log, r in sorted(first.items())
    ]
    return tuple(sorted(found, key=lambda x: x.campaign == "after"))


def _failed(rows: Sequence[Row]) -> tuple[FailedLog, ...]:
    """Return the logs without a fit, and those whose fit did not converge, with the reasons."""
    found = {r["log"]: r["error"] or r["message"] for r in rows if not r["converged"]}
    return tuple(FailedLog(log=log, reason=reason) for log, reason in found.items())
