"""What the models before and after a diagnosis predict, and what they leave."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from ident.diagnosis.results import Diagnosis
from ident.models import residuals_of
from ident.validation import (
    PredictionChange,
    PredictionEvaluation,
    SmoothedForce,
    evaluate,
    prediction_changes,
    smoothed_forces,
)


@dataclass(frozen=True)
class DiagnosisEvaluation:
    """What the models of a diagnosis predict, and what they leave: computed once, before anything is reported.
    ``changes``: by role, of the prediction errors over the horizon; forces: disturbances, as of both models."""

    before: PredictionEvaluation
    after: PredictionEvaluation
    changes: Mapping[str, PredictionChange]
    forces_before: tuple[SmoothedForce, ...]
    forces_after: tuple[SmoothedForce, ...]


def evaluate_diagnosis(diagnosis: Diagnosis, horizon: float | None = None) -> DiagnosisEvaluation:
    """``horizon`` [s]: of ``ident.validation.evaluate``."""
    before = evaluate(diagnosis.before, horizon)
    after = before if diagnosis.after is diagnosis.before else evaluate(diagnosis.after, horizon)
    forces = residuals_of(diagnosis.before.model)
    return DiagnosisEvaluation(
        before,
        after,
        prediction_changes(before, after),
        smoothed_forces(diagnosis.before, forces),
        smoothed_forces(diagnosis.after, forces),
    )


