"""Acceptance of an effect: support by the validation data, and change of the prediction.

This file has the whole rule by which an effect is accepted in a round or removed later. The thresholds are in
``seatrial.ident.diagnosis.policy``. Two models are compared on the same validation records by three measures:

1. The log-likelihood. Its gain, summed in blocks of time, has to be positive and significant.
2. The prediction errors of all channels over the horizon (`prediction_change_by_record`).
3. The prediction three seconds ahead by inputs alone (1.2 s for a thruster), about the time in which speed follows
   thrust. The disturbance forces are set to zero in it. Otherwise they would replace the missing effect and
   extrapolate it.

An effect with per-record parameters is compared on blocks in time of the validation runs. Each block is predicted with
the estimates of the other blocks of its run. Otherwise the data that the effect was fitted to would judge it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from seatrial.ident.diagnosis.findings import EffectImportance, Outcome, Refit, RemovedEffect, ValidationMismatch
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY, SearchPolicy
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


@dataclass(frozen=True)
class Comparison:
    """Comparison of two models on the validation records that both could be evaluated on.

    The measures are computed at their first use and cached.

    Attributes
    ----------
    before, after
        The fitted models. A gain or a fall of the errors is in favour of ``after``.
    policy
        Thresholds of the comparison: the horizon of the prediction by inputs alone, and the number of blocks.
    """

    before: FittedModel
    after: FittedModel
    policy: SearchPolicy = DEFAULT_POLICY

    @cached_property
    def gain(self) -> tuple[float, float]:
        """Gain d ln L on all validation data, and its t statistic; both are 0 without common records."""
        return validation_gain(self.before, self.after, self.policy)

    def pooled_t(self, penalty: float) -> float:
        """Return the t statistic of the gain over the blocks of all data (`pooled_t`), with its penalty d ln L."""
        return pooled_t(self.before, self.after, penalty, self.policy)

    @cached_property
    def prediction(self) -> PredictionChange:
        """Change of the prediction errors over the horizon of the model on the validation data (10 s for a boat)."""
        seconds = self.before.model.horizon
        before, after = (
            {v.record.name: horizon_errors(s.model, v.record, v.values, v.run.x_filt, seconds) for v in views}
            for s, views in self._on_common_records
        )
        return prediction_change_by_record(before, after, seconds)

    @cached_property
    def error_ratio(self) -> float:
        """Ratio of the RMS prediction error by inputs alone of the first model to that of the second.

        The prediction is ``policy.input_horizon`` blocks ahead (3 s for a boat). The ratio is the geometric mean over
        the channels of the validation data, or of the estimation data if there are no common validation records. It is
        above 1 if the second model is better.
        """
        before, after = (
            np.mean([np.log(e.rms) for e in pooled_errors(list(of.values())).values()]) for of in self._errors_by_inputs
        )
        return float(np.exp(before - after))

    @cached_property
    def by_inputs(self) -> PredictionChange:
        """Change of the prediction errors by inputs alone, from the first model to the second, with its 95 % interval.

        The data are those of ``error_ratio``.
        """
        before, after = self._errors_by_inputs
        return prediction_change_by_record(before, after, self.policy.input_horizon * self.before.model.block)

    @cached_property
    def _errors_by_inputs(self) -> list[dict[str, dict[str, PredictionErrors]]]:
        """Prediction errors by inputs alone: one dict by record and channel for each model."""
        return [
            {v.record.name: _errors_by_inputs(s.model, v, self.policy.input_horizon) for v in views or s.estimation}
            for s, views in self._on_common_records
        ]

    @property
    def _on_common_records(self) -> list[tuple[FittedModel, list[RecordEvaluation]]]:
        """Both models, each with its evaluations of the validation records that both models could be evaluated on."""
        stages = (self.before, self.after)
        common = set.intersection(*({v.record.name for v in s.validation} for s in stages))
        return [(s, [v for v in s.validation if v.record.name in common]) for s in stages]


def comparison(
    before: FittedModel, after: FittedModel, effect: Effect, policy: SearchPolicy = DEFAULT_POLICY
) -> Comparison:
    """Return the comparison of two models of which only the second has an effect.

    The comparison is on the validation records. If the effect has per-record parameters, both models are first
    evaluated on blocks in time of the validation runs.

    Parameters
    ----------
    before, after
        Fitted models without and with the effect.
    effect
        The effect.
    policy
        Thresholds that the comparison keeps.

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
    return Comparison(before, after, policy)


def validation_gain(
    before: FittedModel, after: FittedModel, policy: SearchPolicy = DEFAULT_POLICY
) -> tuple[float, float]:
    """Return the gain in log-likelihood on the common validation records of two models, and its t statistic.

    Parameters
    ----------
    before, after
        Fitted models to compare.
    policy
        Thresholds, of which the smallest number of blocks of double length is used.

    Returns
    -------
    gain
        Sum of the gains d ln L from ``before`` to ``after``.
    t
        t statistic of the gain over blocks of time of 10 s (4 s on the bench), as the normal deviate of the same
        probability. The blocks are half as long if the data are shorter than ``policy.min_double_blocks`` of them. 0
        for fewer than two blocks.

        Both are 0 without common validation records.

    Raises
    ------
    ValueError
        If the likelihood of the validation data is not finite.
    """
    per_block = _gains_per_block(before.validation, after.validation, before.model.block, policy)
    if not np.isfinite(per_block).all():
        raise ValueError("the likelihood of the validation data is not finite with the added effect")
    return float(per_block.sum()), _t_as_normal_deviate(per_block)


def pooled_t(before: FittedModel, after: FittedModel, penalty: float, policy: SearchPolicy = DEFAULT_POLICY) -> float:
    """Return the t statistic of the gain in log-likelihood over the blocks of all data.

    The validation data alone have few blocks. If the gain comes in bursts, for example in each turn, their t statistic
    is small although the gain is large. The estimation data have more blocks, but the effect was fitted to them: their
    gains are reduced by a penalty.

    Parameters
    ----------
    before, after
        Fitted models to compare.
    penalty
        Gain d ln L of the estimation data that is due to the added parameters; each block has an equal share of it.
    policy
        Thresholds, of which the smallest number of blocks of double length is used.

    Returns
    -------
    float
        t as the normal deviate of the same probability, 0 for fewer than two blocks or a gain that is not finite.
    """
    block = before.model.block
    validation = _gains_per_block(before.validation, after.validation, block, policy)
    estimation = _gains_per_block(before.estimation, after.estimation, block, policy)
    every: Array = np.concatenate([validation, estimation - penalty / max(estimation.size, 1)])
    return _t_as_normal_deviate(every) if np.isfinite(every).all() else 0.0


def _gains_per_block(
    before: Sequence[RecordEvaluation], after: Sequence[RecordEvaluation], block: float, policy: SearchPolicy
) -> Array:
    """Return the gain d ln L in each block of time (n_blocks,) of the records that both models were evaluated on.

    The blocks have twice the length ``block`` [s], or once if there are fewer than ``policy.min_double_blocks`` of
    double length. Empty without common records.
    """
    new = {v.record.name: v for v in after}
    both = [v for v in before if v.record.name in new]
    length = block if sum(v.record.duration for v in both) < policy.min_double_blocks * 2 * block else 2 * block
    gains: list[Array] = [np.zeros(0)]
    for a in both:
        t = a.record.t - a.record.t[0]
        gains.append(np.asarray(np.bincount(np.floor(t / length).astype(int), new[a.record.name].ll - a.ll), float))
    per_block: Array = np.concatenate(gains).astype(np.float64)
    return per_block


def is_validated(refit: Refit, policy: SearchPolicy = DEFAULT_POLICY) -> bool:
    """Return whether both sets of data support the effect of a refit.

    The criterion of the estimation data (gain less the penalty of the parameters) is positive. The gain on the
    validation data is positive, and its t statistic exceeds ``policy.min_t``. A smaller t, above
    ``policy.min_t_if_pooled``, is enough if the t statistic over the blocks of all data exceeds
    ``policy.min_pooled_t``.

    Parameters
    ----------
    refit
        Refit of a round, rough or exact.
    policy
        Thresholds, of which the smallest t statistic is used.
    """
    pooled = refit.t > policy.min_t_if_pooled and refit.pooled_t > policy.min_pooled_t
    return refit.criterion > 0 and refit.validation_gain > 0 and (refit.t > policy.min_t or pooled)


def is_accepted(refit: Refit, policy: SearchPolicy = DEFAULT_POLICY) -> bool:
    """Return whether the refit is validated and the prediction with it is good enough.

    The prediction may not be significantly worse than without the effect, nor than that of the nominal model. A
    prediction change of None counts as not worse; a ``prediction`` of None also counts as better.

    A nonparametric effect has no physical explanation, so the prediction with it has to be better. One of these is
    enough:

    - the prediction over the horizon is significantly better;
    - the prediction by inputs alone is significantly better, by an amount that matters (`falls_materially`);
    - the effects together make the prediction significantly better than that of the nominal model, and the point
      estimate of the change by this effect is a fall that matters.

    Parameters
    ----------
    refit
        Refit of a round. Before the exact fit its prediction changes are None.
    policy
        Thresholds of the validation and of a change of the prediction that matters.
    """
    prediction, by_inputs, total = refit.prediction, refit.by_inputs, refit.total
    worse = any(p is not None and p.verdict == "rose" for p in (prediction, total))
    better = prediction is None or prediction.verdict == "fell"
    better = better or (by_inputs is not None and by_inputs.verdict == "fell" and falls_materially(by_inputs, policy))
    if total is not None and total.verdict == "fell":
        better = better or falls_materially(prediction, policy)
    return is_validated(refit, policy) and not worse and (better or not refit.nonparametric)


def refit_outcome(refit: Refit, added: Sequence[Refit], policy: SearchPolicy = DEFAULT_POLICY) -> Outcome:
    """Return the outcome of a refit by its own merits, before it is compared with the other refits of its round.

    Parameters
    ----------
    refit
        The refit. If it is validated, its ``prediction`` must not be None.
    added
        Refits of the effects that were added in earlier rounds; may be empty.
    policy
        Thresholds of acceptance.

    Returns
    -------
    Outcome
        The first of these that holds: ``NOT_SUPPORTED`` if the criterion is not positive, ``NOT_VALIDATED`` if the
        refit is not validated, ``WORSE_PREDICTION`` or ``NO_BETTER_PREDICTION`` if it is not accepted, ``SMALL`` if its
        criterion is small compared with the largest of the effects added before, otherwise ``ADDED``.

    Notes
    -----
    A small effect is added with two exceptions: the prediction needs the effect, or the effect and an effect added
    before are declared alternatives. In the latter case the effect added before may not explain all.
    """
    if not is_validated(refit, policy):
        return Outcome.NOT_SUPPORTED if refit.criterion <= 0 else Outcome.NOT_VALIDATED
    assert refit.prediction is not None
    if not is_accepted(refit, policy):
        worse = "rose" in {p.verdict for p in (refit.prediction, refit.total) if p is not None}
        return Outcome.WORSE_PREDICTION if worse else Outcome.NO_BETTER_PREDICTION
    needed = refit.prediction.verdict == "fell" and refit.prediction.ratio < policy.max_small_error_ratio
    alternative = any(
        refit.effect.name in r.effect.alternatives or r.effect.name in refit.effect.alternatives for r in added
    )
    largest = max((r.criterion for r in added), default=0.0)
    large = refit.criterion > policy.min_gain_ratio * largest
    return Outcome.ADDED if needed or alternative or large else Outcome.SMALL


def falls_materially(prediction: PredictionChange | None, policy: SearchPolicy = DEFAULT_POLICY) -> bool:
    """Return whether the point estimate of a change of the prediction errors is a fall that matters.

    The fall matters if the ratio of the errors, after over before, is below ``1 / policy.min_error_ratio``. The
    interval of the change is not considered. False for None.

    Parameters
    ----------
    prediction
        Change of the prediction errors by an effect; None if it is unknown.
    policy
        Thresholds, of which the smallest error ratio that matters is used.
    """
    return prediction is not None and prediction.ratio < 1 / policy.min_error_ratio


def improves_prediction(importance: EffectImportance, policy: SearchPolicy = DEFAULT_POLICY) -> bool:
    """Return whether the prediction is better with an effect than without it.

    The 95 % interval of the change over the horizon decides. If it shows no change, or if there is no such change
    (None), the error three seconds ahead by inputs alone decides: without the effect it has to be more than
    ``policy.min_error_ratio`` times that with the effect.

    Parameters
    ----------
    importance
        Importance of the effect beside the other effects.
    policy
        Thresholds, of which the smallest error ratio that matters is used.
    """
    verdict = "unchanged" if importance.prediction is None else importance.prediction.verdict
    return verdict == "fell" or (verdict == "unchanged" and importance.error_ratio > policy.min_error_ratio)


def is_worth_its_parameters(importance: EffectImportance, policy: SearchPolicy = DEFAULT_POLICY) -> bool:
    """Return whether an effect is worth its parameters beside the other effects.

    Three conditions have to hold. The validation data support the effect: the gain is positive and t exceeds
    ``policy.min_t``, or ``policy.min_t_if_predicting`` if the effect improves the prediction. The prediction over the
    horizon is not significantly worse with the effect. The prediction changes by an amount that matters. False if the
    importance is unknown (NaN).

    Parameters
    ----------
    importance
        Importance of the effect beside the other effects.
    policy
        Thresholds of the validation and of a change of the prediction that matters.
    """
    improves = improves_prediction(importance, policy)
    worse = importance.prediction is not None and importance.prediction.verdict == "rose"
    matters = (
        improves
        or falls_materially(importance.prediction, policy)
        or importance.error_ratio > policy.material_error_ratio
    )
    least_t = policy.min_t_if_predicting if improves else policy.min_t
    return importance.validation_gain > 0 and importance.t > least_t and matters and not worse


def should_be_removed(
    importance: EffectImportance, *, nonparametric: bool, policy: SearchPolicy = DEFAULT_POLICY
) -> bool:
    """Return whether backward elimination should remove an effect.

    An effect should be removed if it is not worth its parameters. A nonparametric effect should also be removed if the
    prediction with it is neither better nor, by the point estimate, lower by an amount that matters.

    Parameters
    ----------
    importance
        Importance of the effect beside the other effects. It must be known.
    nonparametric
        Whether the effect is a curve or a response without a formula.
    policy
        Thresholds of the validation and of a change of the prediction that matters.
    """
    helps = improves_prediction(importance, policy) or falls_materially(importance.prediction, policy)
    return not is_worth_its_parameters(importance, policy) or (nonparametric and not helps)


def is_immaterial(removed: RemovedEffect, policy: SearchPolicy = DEFAULT_POLICY) -> bool:
    """Return whether the validation data support a removed effect, and the prediction is as good without it.

    Parameters
    ----------
    removed
        Effect that backward elimination removed.
    policy
        Thresholds, of which the smallest t statistic is used.
    """
    supported = removed.validation_gain > 0 and removed.t > policy.min_t
    return supported and removed.prediction.verdict == "unchanged"


def validation_mismatches(fitted: FittedModel, policy: SearchPolicy = DEFAULT_POLICY) -> tuple[ValidationMismatch, ...]:
    """Return the validation runs whose one-step errors are larger than the model claims.

    A run is listed if the lower end of the 95 % interval of a channel's ratio, actual over claimed error, exceeds
    ``policy.min_mismatch``. Of its channels the one with the largest lower end is reported. The parameter whose change
    would explain the errors is estimated from the run. Empty if the model was cross-validated, because there are no
    validation runs.

    Parameters
    ----------
    fitted
        Last fitted model, with its evaluation of the validation runs.
    policy
        Thresholds, of which the smallest reported ratio of the errors is used.
    """
    found = []
    for v in () if fitted.cross_validated else fitted.validation:
        errors = pooled_calibration([one_step_calibration(fitted.model, v.run)])
        name = max(errors, key=lambda n: errors[n].low, default=None)
        if name is not None and errors[name].low > policy.min_mismatch:
            shift = parameter_shift(fitted.fit, v.record, v.values)
            found.append(ValidationMismatch(v.record.name, name, errors[name].scale, shift))
    return tuple(found)


def _t_as_normal_deviate(x: Array) -> float:
    """Return the t statistic of the mean of x (n,), converted to the normal deviate of the same probability.

    The conversion (Wallace 1959) allows for few blocks, with which a large t occurs by chance. 0 for fewer than two
    values.
    """
    if x.size < 2:
        return 0.0
    t, df = float(x.mean() / (x.std(ddof=1) / np.sqrt(x.size) + 1e-12)), x.size - 1
    return float(np.copysign((8 * df + 1) / (8 * df + 3) * np.sqrt(df * np.log1p(t * t / df)), t))


def _errors_by_inputs(model: Model, evaluation: RecordEvaluation, blocks: float) -> dict[str, PredictionErrors]:
    """Return the errors of a record by channel, predicted ``blocks`` blocks ahead without disturbance forces.

    The disturbance states of the filter are set to zero in a copy before each prediction.
    """
    forces = [i for i, s in enumerate(model.states) if s.name in {r.state for r in residuals_of(model)}]
    x = evaluation.run.x_filt.copy()
    x[:, forces] = 0.0
    return horizon_errors(model, evaluation.record, evaluation.values, x, blocks * model.block)
