"""How well a fitted model predicts every record, as the content of result.json: errors, traces, tracks."""

from __future__ import annotations

from collections.abc import Sequence

from ident.estimation import FittedModel, Likelihood, RecordEvaluation, parameter_uncertainty
from ident.validation import calibration
from ident.validation.calibration import Calibration
from ident.validation.prediction_errors import PredictionErrors, ahead, free_run, one_step, pooled


class PredictionEvaluation:
    """Prediction errors of a stage on every record, computed once. ``horizon``: s that predictions go ahead between
    one step and the free run, by default the model's usual one."""

    def __init__(self, stage: FittedModel, horizon: float | None = None) -> None:
        self.stage, self.horizon = stage, horizon or stage.model.horizon
        self.likelihood = Likelihood(stage.model)
        self.free = {
            role: [
                free_run(
                    stage.model,
                    v.record,
                    v.values,
                    self.likelihood,
                    parameter_uncertainty(stage.fit, i if fitted else None),
                )
                for i, v in enumerate(views)
            ]
            for role, views, fitted in (("estimation", stage.estimation, True), ("validation", stage.validation, False))
        }

    def views(self, role: str) -> Sequence[RecordEvaluation]:
        return self.stage.estimation if role == "estimation" else self.stage.validation

    def errors(self, role: str) -> dict[str, dict[str, PredictionErrors]]:
        model, views = self.stage.model, self.views(role)
        return {
            "one_step": pooled([one_step(model, v.record, v.run) for v in views]),
            "ten_seconds": pooled([ahead(model, v.record, v.values, v.run.x_filt, self.horizon) for v in views]),
            "free_run": pooled([f.errors for f in self.free[role]]),
        }

    def calibration(self, role: str) -> dict[str, dict[str, Calibration]]:
        """Whether the errors are as large as the model says they are, by horizon and channel."""
        model, views = self.stage.model, self.views(role)
        far = [calibration.ahead(model, v.record, v.values, v.run, self.horizon, self.likelihood) for v in views]
        free = [calibration.free_run(model, v.record, f) for v, f in zip(views, self.free[role], strict=True)]
        return {
            "one_step": calibration.pooled([calibration.one_step(model, v.run) for v in views]),
            "ten_seconds": calibration.pooled(far),
            "free_run": calibration.pooled(free, together=True),
        }
