"""Acceptance: do validation data support an effect, and is the prediction better with it?

Two models are compared on the same validation records: by the log-likelihood, whose gain in blocks of time has to be
significantly positive in total, and by the prediction errors over the horizon of all channels
(`prediction_change_by_record`).
A third measure is the prediction three seconds ahead by inputs alone, about the time in which speed follows thrust (1.2
s for a thruster): the disturbance forces are set to zero in it, since they would take the place of what is missing, and
extrapolate it.

An effect with parameters of its own for each run is compared on blocks in time of the validation runs, with the
estimates of each run's other blocks: else it would be judged by the data that it was fitted to.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from seatrial.ident.diagnosis.results import ValidationMismatch
from seatrial.ident.estimation import FittedModel, RecordEvaluation, parameter_shift, validated_in_blocks
from seatrial.ident.model import Effect, Model
from seatrial.ident.models import residuals_of
from seatrial.ident.numerics import Array
from seatrial.ident.validation import (
    PredictionChange,
    PredictionErrors,
    horizon_errors,
    one_step_calibration,
    pooled_calibration,
    pooled_errors,
    prediction_change_by_record,
)

HORIZON = 0.6  # of a prediction by inputs alone, relative to the block: 3 s for a boat, 1.2 s on the bench
FEW = 12  # blocks
MISMATCH = 1.3  # times that one-step errors of a validation run are larger than the model says


@dataclass(frozen=True)
class Comparison:
    """Two models on the validation records that both could be evaluated on."""

    before: FittedModel
    after: FittedModel

    @cached_property
    def gain(self) -> tuple[float, float]:
        """d ln L on all the validation data, and its t statistic over blocks of time."""
        return validation_gain(self.before, self.after)

    @cached_property
    def prediction(self) -> PredictionChange:
        """Change of the prediction errors over the model's horizon, on the validation data."""
        seconds = self.before.model.horizon
        before, after = (
            {v.record.name: horizon_errors(s.model, v.record, v.values, v.run.x_filt, seconds) for v in views}
            for s, views in self._common
        )
        return prediction_change_by_record(before, after, seconds)

    @cached_property
    def error_ratio(self) -> float:
        """Ratio of the prediction error by inputs alone of the first model to that of the second, ``HORIZON`` blocks
        ahead: geometric mean over the channels of the validation data, else of the estimation data."""
        before, after = (
            np.mean([np.log(e.rms) for e in pooled_errors(list(of.values())).values()]) for of in self._errors_by_inputs
        )
        return float(np.exp(before - after))

    @cached_property
    def by_inputs(self) -> PredictionChange:
        """Change of those errors, with its interval."""
        before, after = self._errors_by_inputs
        return prediction_change_by_record(before, after, HORIZON * self.before.model.block)

    @cached_property
    def _errors_by_inputs(self) -> list[dict[str, dict[str, PredictionErrors]]]:
        """Of both models, by record."""
        return [
            {v.record.name: _errors_by_inputs(s.model, v) for v in views or s.estimation} for s, views in self._common
        ]

    @property
    def _common(self) -> list[tuple[FittedModel, list[RecordEvaluation]]]:
        """Both models with their validation records, those that both could be evaluated on."""
        stages = (self.before, self.after)
        common = set.intersection(*({v.record.name for v in s.validation} for s in stages))
        return [(s, [v for v in s.validation if v.record.name in common]) for s in stages]


def comparison(before: FittedModel, after: FittedModel, effect: Effect) -> Comparison:
    """The fair comparison of two models of which the second has ``effect``. Raises ValueError where a validation record
    that the first could be evaluated on cannot be with the second."""
    if any(p.per_record for p in effect.parameters):
        before, after = validated_in_blocks(before), validated_in_blocks(after)
    known = {f.record for f in before.failed}
    lost = [f for f in after.failed if f.record not in known]
    if lost:
        raise ValueError(f"{lost[0].record} cannot be evaluated with it: {lost[0].reason}")
    return Comparison(before, after)


def validation_gain(before: FittedModel, after: FittedModel) -> tuple[float, float]:
    """Gain in log-likelihood on the validation data: its sum, and t over blocks of ten seconds (four on the bench), of
    half of that where there are fewer than ``FEW``."""
    gains, new = [], {v.record.name: v for v in after.validation}
    both = [v for v in before.validation if v.record.name in new]
    if not both:
        return 0.0, 0.0
    block = before.model.block
    length = block if sum(v.record.duration for v in both) < FEW * 2 * block else 2 * block
    for a in both:
        t = a.record.t - a.record.t[0]
        gains.append(np.bincount(np.floor(t / length).astype(int), new[a.record.name].ll - a.ll))
    per_block: Array = np.concatenate(gains).astype(np.float64)
    if not np.isfinite(per_block).all():
        raise ValueError("the likelihood of the validation data is not finite with it")
    return float(per_block.sum()), _t(per_block)


def validation_mismatches(stage: FittedModel) -> tuple[ValidationMismatch, ...]:
    """The validation runs whose one-step errors are larger than the model says, by more than chance and ``MISMATCH``,
    and what differs in them."""
    found = []
    for v in () if stage.cross_validated else stage.validation:
        errors = pooled_calibration([one_step_calibration(stage.model, v.run)])
        name = max(errors, key=lambda n: errors[n].low, default=None)
        if name is not None and errors[name].low > MISMATCH:
            shift = parameter_shift(stage.fit, v.record, v.values)
            found.append(ValidationMismatch(v.record.name, name, errors[name].scale, shift))
    return tuple(found)


def _t(x: Array) -> float:
    """The t statistic of the mean of x (n,), on the scale of many values: the normal deviate of the same probability
    (Wallace 1959), since few blocks give a large t by chance."""
    if x.size < 2:
        return 0.0
    t, df = float(x.mean() / (x.std(ddof=1) / np.sqrt(x.size) + 1e-12)), x.size - 1
    return float(np.copysign((8 * df + 1) / (8 * df + 3) * np.sqrt(df * np.log1p(t * t / df)), t))


def _errors_by_inputs(model: Model, of: RecordEvaluation) -> dict[str, PredictionErrors]:
    """Errors ``HORIZON`` blocks ahead, without disturbance forces."""
    forces = [i for i, s in enumerate(model.states) if s.name in {r.state for r in residuals_of(model)}]
    x = of.run.x_filt.copy()
    x[:, forces] = 0.0
    return horizon_errors(model, of.record, of.values, x, HORIZON * model.block)
