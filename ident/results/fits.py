"""The fit of a vehicle or of a thruster as a result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import msgspec

from ident.estimation import FittedModel, HomogeneityTest, Profile, ReportedEstimates
from ident.models import residuals_of
from ident.results.answers import (
    calibration_notes,
    check_warnings,
    estimation_warnings,
    failed_run_warnings,
    faults_first,
    homogeneity_sentence,
    not_converged,
    outlier_lines,
    thruster_answer,
    vehicle_answer,
)
from ident.results.parts import Calibrations, Provenance, StaticForce, ThrusterResult, UnusedSignal, VehicleResult
from ident.results.tables import (
    all_inputs,
    calibration_tables,
    cross_correlations,
    error_tables,
    failed_runs,
    fit_summary,
    homogeneity_reported,
    homogeneity_row,
    prediction_fit,
    profile_curve,
    residual_rows,
    traces,
    tracks,
)
from ident.validation import PredictionEvaluation


@dataclass(frozen=True)
class Posed:
    """What was known and said before the fit.

    Attributes:
        start: values that the search began with.
        notes: lines that come first.
        unused: signals of the logs that the model does not take.
        length: of the hull, where the rig gives it [m].
    """

    start: Mapping[str, float]
    notes: Sequence[str] = ()
    unused: Sequence[UnusedSignal] = ()
    length: float | None = None


def vehicle_result(
    stage: FittedModel,
    evaluation: PredictionEvaluation,
    made: Provenance,
    profiles: Sequence[Profile],
    homogeneity: Sequence[HomogeneityTest],
    posed: Posed,
) -> VehicleResult:
    """The result of a vehicle's fit and its evaluation; ``posed``: what came before the fit."""
    reported = ReportedEstimates(stage.fit)
    homogeneity = [homogeneity_reported(a, reported) for a in homogeneity]
    errors, calibration = error_tables(evaluation), calibration_tables(evaluation)
    residuals, cross = residual_rows(evaluation), cross_correlations(evaluation)
    searchable = bool(residuals_of(evaluation.model))
    prediction = prediction_fit(evaluation)
    said = vehicle_answer(prediction, errors, evaluation.horizon, residuals, cross, searchable=searchable)
    answer = not_converged(stage.fit) or " ".join([said, *(homogeneity_sentence(a) for a in homogeneity)])
    return VehicleResult(
        **msgspec.structs.asdict(made),
        answer=faults_first(made) + answer,
        prediction=prediction,
        warnings=(
            *check_warnings(made),
            *estimation_warnings(stage.fit, stage.records, posed.length),
            *failed_run_warnings(stage.failed),
        ),
        notes=_notes(posed.notes, evaluation, calibration),
        fit=fit_summary(stage.fit, posed.start),
        failed_runs=failed_runs(stage.failed),
        horizon_seconds=evaluation.horizon,
        errors=errors,
        calibration=calibration,
        traces=traces(evaluation),
        track=tracks(evaluation),
        inputs=all_inputs(evaluation),
        residuals=residuals,
        cross=cross,
        unused_signals=tuple(posed.unused),
        profiles=tuple(profile_curve(p, reported) for p in profiles),
        homogeneity=tuple(homogeneity_row(a) for a in homogeneity),
    )


def thruster_result(
    stage: FittedModel,
    evaluation: PredictionEvaluation,
    made: Provenance,
    profiles: Sequence[Profile],
    static: StaticForce | None,
    posed: Posed,
    calibration: float | None,
) -> ThrusterResult:
    """``static``: None where there was no load cell; ``posed``: what came before the fit; ``calibration``: relative
    standard uncertainty of the load cell's force, None where the rig does not give it."""
    bands = calibration_tables(evaluation)
    return ThrusterResult(
        **msgspec.structs.asdict(made),
        answer=not_converged(stage.fit) or thruster_answer(stage.fit, static is not None, calibration),
        warnings=(*estimation_warnings(stage.fit, stage.records), *failed_run_warnings(stage.failed)),
        notes=_notes(posed.notes, evaluation, bands),
        fit=fit_summary(stage.fit, posed.start, calibration if static is not None else 0.0),
        failed_runs=failed_runs(stage.failed),
        horizon_seconds=evaluation.horizon,
        errors=error_tables(evaluation),
        calibration=bands,
        traces=traces(evaluation),
        track=tracks(evaluation),
        inputs=all_inputs(evaluation),
        residuals=residual_rows(evaluation),
        cross=cross_correlations(evaluation),
        static=static,
        profiles=tuple(profile_curve(p, ReportedEstimates(stage.fit)) for p in profiles),
    )


def _notes(first: Sequence[str], evaluation: PredictionEvaluation, calibration: Calibrations) -> tuple[str, ...]:
    outliers = outlier_lines(evaluation.residuals, evaluation.model)
    return (*first, *outliers, *calibration_notes(calibration, evaluation.horizon))
