"""Acceptance of an effect: support by the validation data, and change of the prediction.

Two models are compared on the same validation records by three measures:

1. The log-likelihood. Its gain, summed in blocks of time, has to be positive and significant.
2. The prediction errors of all channels over the horizon (`prediction_change_by_record`).
3. The prediction three seconds ahead by inputs alone (1.2 s for a thruster), about the time in which speed follows
   thrust. The disturbance forces are set to zero in it. Otherwise they would replace the missing effect and
   extrapolate it.

An effect with per-record parameters is compared on blocks in time of the validation runs. Each block is predicted with
the estimates of the other blocks of its run. Otherwise the data that the effect was fitted to would judge it.
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

HORIZON = 0.6  # blocks, of a prediction by inputs alone: 3 s for a boat, 1.2 s on the bench
FEW = 12  # blocks of double length; with fewer, the gain is summed over single blocks
MISMATCH = 1.3  # ratio of actual to claimed one-step errors above which a validation run is reported


@dataclass(frozen=True)
class Comparison:
    """Comparison of two models on the validation records that both could be evaluated on.

    Attributes
    ----------
    before, after
        The fitted models.
    """

    before: FittedModel
    after: FittedModel

    @cached_property
    def gain(self) -> tuple[float, float]:
        """d ln L on all validation data, and its t statistic over blocks of time."""
        return validation_gain(self.before, self.after)

    @cached_property
    def prediction(self) -> PredictionChange:
        """Change of the prediction errors over the horizon of the model, on the validation data."""
        seconds = self.before.model.horizon
        before, after = (
            {v.record.name: horizon_errors(s.model, v.record, v.values, v.run.x_filt, seconds) for v in views}
            for s, views in self._common
        )
        return prediction_change_by_record(before, after, seconds)

    @cached_property
    def error_ratio(self) -> float:
        """Ratio of the prediction error by inputs alone of the first model to that of the second.

        The prediction is ``HORIZON`` blocks ahead. The ratio is the geometric mean over the channels of the validation
        data, or of the estimation data if there are no common validation records.
        """
        before, after = (
            np.mean([np.log(e.rms) for e in pooled_errors(list(of.values())).values()]) for of in self._errors_by_inputs
        )
        return float(np.exp(before - after))

    @cached_property
    def by_inputs(self) -> PredictionChange:
        """Change of the prediction errors by inputs alone, with its interval."""
        before, after = self._errors_by_inputs
        return prediction_change_by_record(before, after, HORIZON * self.before.model.block)

    @cached_property
    def _errors_by_inputs(self) -> list[dict[str, dict[str, PredictionErrors]]]:
        """Prediction errors by inputs alone of both models, by record."""
        return [
            {v.record.name: _errors_by_inputs(s.model, v) for v in views or s.estimation} for s, views in self._common
        ]

    @property
    def _common(self) -> list[tuple[FittedModel, list[RecordEvaluation]]]:
        """Both models with their validation records, restricted to the records that both could be evaluated on."""
        stages = (self.before, self.after)
        common = set.intersection(*({v.record.name for v in s.validation} for s in stages))
        return [(s, [v for v in s.validation if v.record.name in common]) for s in stages]


def comparison(before: FittedModel, after: FittedModel, effect: Effect) -> Comparison:
    """Compare two models of which the second has ``effect``.

    Effects with per-record parameters are compared on blocks in time of the validation runs.

    Parameters
    ----------
    before, after
        Fitted models without and with the effect.
    effect
        The effect.

    Raises
    ------
    ValueError
        If a validation record can be evaluated with the first model and not with the second.
    """
    if any(p.per_record for p in effect.parameters):
        before, after = validated_in_blocks(before), validated_in_blocks(after)
    failed_before = {f.record for f in before.failed}
    lost = [f for f in after.failed if f.record not in failed_before]
    if lost:
        raise ValueError(f"{lost[0].record} cannot be evaluated with the added effect: {lost[0].reason}")
    return Comparison(before, after)


def validation_gain(before: FittedModel, after: FittedModel) -> tuple[float, float]:
    """Return the gain in log-likelihood on the validation data, and its t statistic.

    Parameters
    ----------
    before, after
        Fitted models to compare.

    Returns
    -------
    tuple of float
        Sum of the gains, and t over blocks of ten seconds (four on the bench). The blocks are half as long if there are
        fewer than ``FEW``. Both are 0 without common validation records.

    Raises
    ------
    ValueError
        If the likelihood of the validation data is not finite.
    """
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
        raise ValueError("the likelihood of the validation data is not finite with the added effect")
    return float(per_block.sum()), _t(per_block)


def validation_mismatches(fitted: FittedModel) -> tuple[ValidationMismatch, ...]:
    """Return the validation runs whose one-step errors are larger than the model claims.

    The lower end of the 95 % interval of the ratio has to exceed ``MISMATCH``. The channel with the largest lower end
    is reported, and the parameter change that would explain the errors.
    """
    found = []
    for v in () if fitted.cross_validated else fitted.validation:
        errors = pooled_calibration([one_step_calibration(fitted.model, v.run)])
        name = max(errors, key=lambda n: errors[n].low, default=None)
        if name is not None and errors[name].low > MISMATCH:
            shift = parameter_shift(fitted.fit, v.record, v.values)
            found.append(ValidationMismatch(v.record.name, name, errors[name].scale, shift))
    return tuple(found)


def _t(x: Array) -> float:
    """Return the t statistic of the mean of x (n,), converted to the normal deviate of the same probability.

    The conversion (Wallace 1959) allows for few blocks, with which a large t occurs by chance.
    """
    if x.size < 2:
        return 0.0
    t, df = float(x.mean() / (x.std(ddof=1) / np.sqrt(x.size) + 1e-12)), x.size - 1
    return float(np.copysign((8 * df + 1) / (8 * df + 3) * np.sqrt(df * np.log1p(t * t / df)), t))


def _errors_by_inputs(model: Model, evaluation: RecordEvaluation) -> dict[str, PredictionErrors]:
    """Return the errors ``HORIZON`` blocks ahead, with the disturbance forces set to zero."""
    forces = [i for i, s in enumerate(model.states) if s.name in {r.state for r in residuals_of(model)}]
    x = evaluation.run.x_filt.copy()
    x[:, forces] = 0.0
    return horizon_errors(model, evaluation.record, evaluation.values, x, HORIZON * model.block)
