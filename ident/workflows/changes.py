"""Workflow of `seatrial ident changes`: one vehicle model on two campaigns of logs, and what differs between them.

The model is fitted to each log separately, as by `seatrial ident fleet`, with the same table of estimates. The means of
the campaigns are compared with the scatter between logs as a random effect (docs/decisions/0049-campaigns.md). The logs
are then predicted with the values of each campaign.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import msgspec

from seatrial.daq.errors import SeatrialError
from seatrial.ident.parallel import Workers
from seatrial.ident.reporter import Reporter
from seatrial.ident.results import (
    CampaignLog,
    CampaignsResult,
    FailedLog,
    campaigns_answer,
    provenance,
    write_result,
)
from seatrial.ident.workflows.campaign_errors import prediction_errors
from seatrial.ident.workflows.campaign_fits import FALSE_DISCOVERY_RATE, Row, campaign_of, compare_fits, fitted_logs
from seatrial.ident.workflows.fleet import (
    TABLE,
    FleetRequest,
    checked_code,
    fit_logs,
    hashed_logs,
    score_test_note,
    warnings_of_logs,
)
from seatrial.ident.workflows.vehicle import is_tested
from seatrial.ident.workflows.vehicle_model import VehicleRequest, is_saved_model


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
    """

    before: Sequence[Path]
    after: Sequence[Path]
    vehicle: VehicleRequest
    out: Path | None
    workers: Workers = field(default_factory=Workers)
    force: bool = False
    false_discovery_rate: float = FALSE_DISCOVERY_RATE


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
        If a campaign has no log, or none whose fit converged, if a log is in both campaigns, or as `fit_fleet`.
    """
    if not (request.before and request.after):
        raise SeatrialError("a comparison needs logs of both campaigns; give one or more before and one or more after")
    code = checked_code(request.vehicle)
    before, after = (hashed_logs(paths, reporter) for paths in (request.before, request.after))
    twice = {x.sha256: x.name for x in before}
    for log in after:
        if log.sha256 in twice:
            raise SeatrialError(f"{log.name}: is in both campaigns (as {twice[log.sha256]}); leave it out of one")
    logs = [*before, *after]
    fits = FleetRequest((), request.vehicle, request.out, request.workers, request.force)
    table = fit_logs(logs, fits, code, reporter)
    rows = table.to_pylist()
    later = {log.sha256 for log in after}
    fitted = fitted_logs(rows, later)
    if not fitted.after.any() or fitted.after.all():
        which = "before" if fitted.after.all() else "after"
        first = _failed([r for r in rows if (r["sha256"] in later) == (which == "after")])[0]
        raise SeatrialError(f"no fit to a log {which} has converged; {first.log}: {first.reason}")
    comparison = compare_fits(fitted, request.false_discovery_rate)
    errors, horizon = prediction_errors(fitted, comparison, logs, request.vehicle, code, request.workers, reporter)
    made = provenance([], command)
    result = CampaignsResult(
        created=made.created, seatrial=made.seatrial, command=made.command, answer="",
        warnings=warnings_of_logs(rows),
        notes=(*comparison.notes, *_notes_on_models(request.vehicle), score_test_note(request.vehicle, rows)),
        model=request.vehicle.model, score_tests=is_tested(request.vehicle),
        table="" if request.out is None else str(request.out / TABLE),
        horizon=horizon, false_discovery_rate=request.false_discovery_rate,
        campaigns=_campaign_logs(rows, later), failed=_failed(rows), parameters=comparison.parameters,
        not_compared=comparison.not_compared, effects=comparison.effects, joint=comparison.joint,
        common_factor=comparison.common_factor, errors=errors,
    )  # fmt: skip
    result = msgspec.structs.replace(result, answer=campaigns_answer(result))
    if request.out is not None:
        from seatrial.ident.report import write_report

        write_result(result, request.out / "result.json")
        write_report(result, request.out / "report.html")
    return Changes(result, table)


def _notes_on_models(vehicle: VehicleRequest) -> list[str]:
    """Return the note on a model with common errors, and how the sizes of added effects depend on the model.

    The result is empty for fits with score tests, and for the model of a file.
    """
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
