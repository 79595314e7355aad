"""`seatrial ident vehicle`: a vehicle model fitted to logs and validated on others."""

from __future__ import annotations

from ident.data import load_all
from ident.estimation import fit_nominal_model, homogeneity_test, profile
from ident.reporter import Reporter
from ident.results import VehicleResult, provenance, vehicle_result
from ident.validation import evaluate
from ident.workflows.output import validity, write_all
from ident.workflows.vehicle_model import VehicleRequest, vehicle_problem


def vehicle(request: VehicleRequest, command: str, reporter: Reporter) -> VehicleResult:
    """Fit a vehicle model to logs, evaluate it on them and on the validation logs, write the results.

    ``command``: what was typed. Raises SeatrialError where the logs cannot be read or lack what the model needs.
    """
    loaded, unseen = load_all(request.logs, request.validation)
    problem = vehicle_problem(request, loaded, unseen)
    if problem.thrust:
        reporter.progress(problem.thrust)
    for line in filter(None, [*problem.notes, problem.sides]):
        reporter.warning(line)
    fitted = fit_nominal_model(
        problem.model, problem.segments, problem.validation, request.estimation, rate=request.rate, reporter=reporter
    )
    evaluation = evaluate(fitted, request.estimation.horizon)
    profiles = [profile(fitted.fit, fitted.records, name) for name in request.profiles]
    homogeneity = [homogeneity_test(fitted.fit, fitted.records, name) for name in request.homogeneity]
    result = vehicle_result(
        fitted,
        evaluation,
        provenance([*loaded, *unseen], command),
        profiles,
        homogeneity,
        start=problem.model.values,
        notes=[*filter(None, [problem.thrust]), *problem.notes, *fitted.outlier_notes],
        lead=problem.sides,
    )
    write_all(request.out, result, fitted.fit, validity(fitted))
    return result
