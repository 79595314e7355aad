"""Workflow of `seatrial ident vehicle`: fit of a vehicle model to logs, and its validation on other logs."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import msgspec
import numpy as np

from seatrial.daq.errors import first_names
from seatrial.ident.checks import device_faults, speed_at_full_command
from seatrial.ident.data import LoadedLog, load_all
from seatrial.ident.diagnosis import (
    COMMON_SEARCH,
    ModelAssessment,
    ModelUncertainty,
    antenna_error,
    assess_model,
    untested_uncertainty,
    with_model_uncertainty,
)
from seatrial.ident.estimation import (
    FIT_ERRORS,
    FittedModel,
    fit_nominal_model,
    homogeneity_test,
    nominal_model,
    profile,
    with_thrust_ahead,
)
from seatrial.ident.model import COMMAND, Model, ParameterOrigin, is_of_thruster, with_outlier_model
from seatrial.ident.models import is_own_model
from seatrial.ident.reporter import Reporter
from seatrial.ident.results import FitContext, ResultWarning, VehicleResult, antenna_warning, provenance, vehicle_result
from seatrial.ident.validation import evaluate
from seatrial.ident.workflows.check import check_first, require_thrust_and_length
from seatrial.ident.workflows.dynamics import dynamics_of
from seatrial.ident.workflows.full_speeds import full_speed_note, full_speed_warning
from seatrial.ident.workflows.model_inputs import unused_lines
from seatrial.ident.workflows.output import sensor_rates, validity, write_model, write_page
from seatrial.ident.workflows.vehicle_model import VehicleProblem, VehicleRequest, vehicle_problem

SMALL_SHARE_LOST = 0.015  # as LARGEST_SHARE_LOST; more gives a note
LARGEST_SHARE_LOST = 0.05  # of the thrust, by shaft speeds that differ from the commands; more gives a warning


@dataclass(frozen=True)
class VehicleFit:
    """Vehicle model that was fitted to logs, and its result.

    Attributes
    ----------
    fitted
        The fitted model with its estimation and validation records.
    result
        Content of result.json.
    uncertainty
        Uncertainty of the model that the standard errors include; None if there is none, or if it is unknown.
    effects_file
        Python file of the user-defined effects in the model; None if it has none.
    """

    fitted: FittedModel
    result: VehicleResult
    uncertainty: ModelUncertainty | None = None
    effects_file: Path | None = None


def vehicle(request: VehicleRequest, command: str, reporter: Reporter) -> VehicleResult:
    """Fit a vehicle model to logs (`fit_vehicle`), and write the results.

    The files are model.toml, result.json and report.html in the folder ``request.out``.

    Parameters
    ----------
    request : VehicleRequest
        Logs, model, options and folder.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress and warnings.

    Returns
    -------
    VehicleResult
        Content of result.json.

    Raises
    ------
    SeatrialError
        As `fit_vehicle`, or if a file cannot be written.
    """
    done = fit_vehicle(request, command, reporter)
    write_vehicle_fit(done, request.out)
    return done.result


def write_vehicle_fit(done: VehicleFit, out: Path, report: bool = True) -> None:
    """Write model.toml, result.json and, if ``report``, report.html of a fit to the folder ``out``.

    The folder is created if it does not exist. Existing files of these names are replaced.
    """
    rates = sensor_rates(done.fitted)
    write_model(out, done.result, done.fitted.fit, validity(done.fitted), done.effects_file, rates=rates)
    if report:
        write_page(out, done.result)


def fit_vehicle(request: VehicleRequest, command: str, reporter: Reporter, with_dynamics: bool = True) -> VehicleFit:
    """Fit a vehicle model to logs, and evaluate it on these and on the validation logs. No file is written.

    Parameters
    ----------
    request : VehicleRequest
        Logs, model and options. Its folder is not used.
    command : str
        Command line, for the provenance.
    reporter : Reporter
        Receives progress and warnings.
    with_dynamics : bool
        Whether the result has steady motion, poles and step responses of the model.

    Returns
    -------
    VehicleFit
        The fitted model, and the content of result.json.

    Raises
    ------
    SeatrialError
        If the logs cannot be read, lack signals that the model needs, or have faults that make a fit meaningless
        (unless ``despite_faults``), or if an option does not apply to the model.
    """
    loaded, validation_logs = load_all(request.logs, request.validation, request.window, device_faults)
    problem = vehicle_problem(request, loaded, validation_logs)
    loaded, validation_logs = check_first(loaded, validation_logs, problem.model, request.despite_faults)
    require_thrust_and_length(problem.segments, problem.model, request.despite_faults)
    if problem.thrust:
        reporter.progress(problem.thrust)
    if problem.ahead is not None:
        scaled, note = with_thrust_ahead(
            problem.model, problem.segments, request.estimation, problem.ahead, rate=request.rate, reporter=reporter
        )
        problem = replace(problem, model=scaled, notes=[*problem.notes, note])
    of_fit = [*loaded, *validation_logs]
    if note := full_speed_note(request.thruster, problem.model, of_fit):
        problem = replace(problem, notes=[*problem.notes, note])
    other_speed = full_speed_warning(request.thruster, problem.model, of_fit)
    for line in [*problem.notes, *unused_lines(problem.unused)]:
        reporter.warning(line)
    tested = _assess(request, problem, reporter)
    common = None if tested is None else tested.common_errors
    model = problem.model
    if common is not None:
        model = replace(common.fitted.fit.model, second_order=model.second_order)
    fitted = fit_nominal_model(
        model,
        problem.segments,
        problem.validation,
        request.estimation,
        rate=request.rate,
        settings=None if common is None else COMMON_SEARCH,
        start=None if tested is None or common is not None else tested.nominal.fit.start_values(nominal_model(model)),
        reporter=reporter,
    )
    uncertainty = untested_uncertainty(fitted.fit) if tested is None else tested.uncertainty
    fitted = replace(fitted, fit=with_model_uncertainty(fitted.fit, uncertainty))
    evaluation = evaluate(fitted, request.estimation.horizon)
    profiles = [profile(fitted.fit, fitted.records, name) for name in request.profiles]
    homogeneity = [homogeneity_test(fitted.fit, fitted.records, name) for name in request.homogeneity]
    result = vehicle_result(
        fitted,
        evaluation,
        provenance([*loaded, *validation_logs], command),
        profiles,
        homogeneity,
        FitContext(
            problem.model.values,
            [*filter(None, [problem.thrust]), *problem.notes, *problem.noise_notes, *fitted.outlier_notes],
            problem.unused,
            loaded[0].hull(request.mass),
            tested,
            dynamics_of(fitted) if with_dynamics else None,
            uncertainty,
            problem.added,
        ),
    )
    scale = _command_scale(fitted.fit.model, loaded)
    more = [*filter(None, [other_speed])]
    if scale is not None and scale.matters:
        more.append(ResultWarning(code="command-scale", text=scale.text))
    small = [] if scale is None or scale.matters else [scale.text]
    if tested is None and request.estimation.method == "prediction-error":
        # A fit with score tests has an estimate of the error of the antenna, if the data show one.
        more += antenna_warning(fitted.model, antenna_error(fitted))
    answer = " ".join(filter(None, [result.answer, problem.choice]))
    warnings, notes = (*result.warnings, *more), (*result.notes, *small)
    told = msgspec.structs.replace(result, answer=answer, warnings=warnings, notes=notes)
    return VehicleFit(fitted, told, uncertainty, problem.effects_file)


class _CommandScale(NamedTuple):
    """Text on the thrust at full command, and whether it differs enough from that at full speed for a warning."""

    text: str
    matters: bool


def _command_scale(model: Model, logs: Sequence[LoadedLog]) -> _CommandScale | None:
    """Return the text on a thrust that was given for full shaft speed, if full commands do not reach this speed.

    It concerns models whose inputs are commands, on logs that have the shaft speeds too. A low battery is the usual
    reason. Nothing in the logs or the options says for which of both a thrust was given. The text therefore has the
    given value and the one to give instead, for a reader who has corrected it already, and the scale in the import map
    with which commands and shaft speeds agree, so that the text does not come again. A share of the thrust below 5 % is
    for a note. None if the thrust was not given, if no log has both signals, or if the speeds are those of the
    commands.
    """
    c1 = next((p for p in model.parameters if p.name == "c1"), None)
    if c1 is None or c1.origin not in (ParameterOrigin.GIVEN, ParameterOrigin.PRIOR):
        return None
    if not any(is_of_thruster(i.tap_of or i.name, COMMAND) for i in model.inputs):
        return None
    known = {log.run.name: ratio for log in logs if (ratio := speed_at_full_command(log.run.channels)) is not None}
    share = float(np.mean([ratio**2 for ratio in known.values()])) if known else 1.0
    if abs(share - 1.0) < SMALL_SHARE_LOST:
        return None
    matters = abs(share - 1.0) >= LARGEST_SHARE_LOST
    places = 2 if matters else 3
    listed = first_names([f"{own:.{places}f} ({name})" for name, own in known.items()])
    prior = c1.prior if c1.origin is ParameterOrigin.PRIOR else None
    ratio, value = math.sqrt(share), c1.value if prior is None else prior[0]
    text = (
        f"At full command the shafts turn at {listed} times full speed, so that their thrust is {share:.{places}f} of "
        f"that at full speed. The model takes c1 = {value:.4g} N as the thrust at full command. If it was measured at "
        f"full shaft speed, all masses are {1 / share:.{places}f} times their true value: give c1 = "
        f"{share * value:.4g} N, and {share:.{places}f} of c2. If it was measured at full command, the masses are "
        f"right: divide the scale of the shaft speeds in the import map by {ratio:.{places}f} (or multiply rpm_max in "
        f"the rig file by it), and this {'warning' if matters else 'note'} ends."
    )
    return _CommandScale(text, matters)


def is_tested(request: VehicleRequest) -> bool:
    """Return whether a fit is tested by the score tests: if the request has them, and its model and method allow them.

    A user-defined model and output error have no score tests.
    """
    return request.score_tests and not is_own_model(request.model) and request.estimation.method == "prediction-error"


def _assess(request: VehicleRequest, problem: VehicleProblem, reporter: Reporter) -> ModelAssessment | None:
    """Test by score tests, before the fit, whether the vehicle model lacks effects of the catalogue.

    Return None if the request excludes the tests, for a user-defined model, for a model without disturbance forces to
    test, and for output error, which has no score tests. Return None with a warning if the tests fail: the fit is
    possible without them.
    """
    if not is_tested(request):
        return None
    model = replace(problem.model, second_order=False)  # as in a diagnosis
    if request.estimation.outlier_model:
        model = with_outlier_model(model)
    try:
        return assess_model(model, problem.segments, problem.validation, rate=request.rate, reporter=reporter)
    except FIT_ERRORS as failure:
        reporter.warning(
            "the score tests of the model failed, so the standard errors exclude the uncertainty of the model: "
            f"{failure}; --no-score-tests leaves the tests out"
        )
        return None
