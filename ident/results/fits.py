"""The fit of a vehicle or of a thruster as a result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import msgspec

from ident.estimation import FittedModel, HomogeneityTest, Profile
from ident.models import residuals_of
from ident.results.answers import (
    calibration_notes,
    check_warnings,
    faults_first,
    homogeneity_sentence,
    not_converged,
    outlier_lines,
    stuck_sensors,
    thruster_answer,
    vehicle_answer,
)
from ident.results.parts import Calibrations, Provenance, StaticForce, ThrusterResult, VehicleResult
from ident.results.tables import (
    all_inputs,
    calibration_tables,
    cross_correlations,
    error_tables,
    fit_summary,
    homogeneity_row,
    prediction_fit,
    profile_curve,
    residual_rows,
    traces,
    tracks,
)
from ident.validation import PredictionEvaluation


def vehicle_result(
    stage: FittedModel,
    evaluation: PredictionEvaluation,
    made: Provenance,
    profiles: Sequence[Profile],
    homogeneity: Sequence[HomogeneityTest],
    *,
    start: Mapping[str, float],
    notes: Sequence[str],
) -> VehicleResult:
    """``start``: values that the search began with; ``notes``: that come first."""
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
        warnings=(*check_warnings(made), *stuck_sensors(stage.records)),
        notes=_notes(notes, evaluation, calibration),
        fit=fit_summary(stage.fit, start),
        horizon_seconds=evaluation.horizon,
        errors=errors,
        calibration=calibration,
        traces=traces(evaluation),
        track=tracks(evaluation),
        inputs=all_inputs(evaluation),
        residuals=residuals,
        cross=cross,
        profiles=tuple(profile_curve(p) for p in profiles),
        homogeneity=tuple(homogeneity_row(a) for a in homogeneity),
    )


def thruster_result(
    stage: FittedModel,
    evaluation: PredictionEvaluation,
    made: Provenance,
    profiles: Sequence[Profile],
    static: StaticForce | None,
    *,
    start: Mapping[str, float],
    notes: Sequence[str],
) -> ThrusterResult:
    """``static``: None where there was no load cell; ``start``: values that the search began with; ``notes``: that
    come first."""
    calibration = calibration_tables(evaluation)
    return ThrusterResult(
        **msgspec.structs.asdict(made),
        answer=not_converged(stage.fit) or thruster_answer(stage.fit, static is not None),
        warnings=tuple(stuck_sensors(stage.records)),
        notes=_notes(notes, evaluation, calibration),
        fit=fit_summary(stage.fit, start),
        horizon_seconds=evaluation.horizon,
        errors=error_tables(evaluation),
        calibration=calibration,
        traces=traces(evaluation),
        track=tracks(evaluation),
        inputs=all_inputs(evaluation),
        residuals=residual_rows(evaluation),
        cross=cross_correlations(evaluation),
        static=static,
        profiles=tuple(profile_curve(p) for p in profiles),
    )


def _notes(first: Sequence[str], evaluation: PredictionEvaluation, calibration: Calibrations) -> tuple[str, ...]:
    outliers = outlier_lines(evaluation.residuals, evaluation.model)
    return (*first, *outliers, *calibration_notes(calibration, evaluation.horizon))
