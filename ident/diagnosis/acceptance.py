"""Acceptance of an effect: support by the validation data, and change of the prediction.

This file has the whole rule by which an effect is accepted in a round or removed later. The thresholds are in
``seatrial.ident.diagnosis.policy``. Two models are compared on the same validation records by three measures:

1. The log-likelihood. Its gain, summed in blocks of time, has to be positive and significant.
2. The prediction errors of all channels over the horizon (`prediction_change_by_record`).
3. The prediction errors over three seconds (1.2 s for a thruster) by inputs alone. That is about the time in which
   speed follows thrust. The disturbance forces are set to zero in it. Otherwise they would replace the missing effect
   and extrapolate it.

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
    """Comparison of two fitted models on the validation records that both could be evaluated on.

    The measures are computed at their first use and cached, except ``pooled_t``, which is computed at each call.

    Attributes
    ----------
    before, after
        The fitted models. A positive gain or smaller prediction errors are in favour of ``after``.
    policy
        Thresholds, of which the horizon of the prediction by inputs alone and the smallest number of double blocks are
        used.
    """

    before: FittedModel
    after: FittedModel
    policy: SearchPolicy = DEFAULT_POLICY

    @cached_property
    def gain(self) -> tuple[float, float]:
        """Gain d ln L from ``before`` to ``after`` on the common validation records, and its t statistic.

        Both are 0 without common records. ValueError is raised if the gain is not finite.
        """
        return validation_gain(self.before, self.after, self.policy)

    def pooled_t(self, penalty: float) -> float:
        """Return the t statistic of the gain over the blocks of validation and estimation data (`pooled_t`).

        ``penalty`` is the part of the gain d ln L of the estimation data that is due to the added parameters. The
        result is 0 for fewer than two blocks, or if a gain is not finite.
        """
        return pooled_t(self.before, self.after, penalty, self.policy)

    @cached_property
    def prediction(self) -> PredictionChange:
        """Change of the prediction errors from ``before`` to ``after``, with its 95 % interval.

        The data are the common validation records; without such records all ratios are NaN. The horizon is that of the
        model (10 s for a boat, 1 s on the bench).
        """
        seconds = self.before.model.horizon
        before, after = (
            {v.record.name: horizon_errors(s.model, v.record, v.values, v.run.x_filt, seconds) for v in views}
            for s, views in self._on_common_records
        )
        return prediction_change_by_record(before, after, seconds)

    @cached_property
    def error_ratio(self) -> float:
        """RMS prediction error by inputs alone (disturbance forces zero) of ``before`` divided by that of ``after``.

        It is above 1 if ``after`` is better. The horizon is ``policy.input_horizon`` blocks (3 s for a boat). The ratio
        is the geometric mean over the channels of the common validation records, or of the estimation data without such
        records.
        """
        before, after = (
            np.mean([np.log(e.rms) for e in pooled_errors(list(of.values())).values()]) for of in self._errors_by_inputs
        )
        return float(np.exp(before - after))

    @cached_property
    def by_inputs(self) -> PredictionChange:
        """Change of the prediction errors by inputs alone from ``before`` to ``after``, with its 95 % interval.

        Data and horizon are those of ``error_ratio``. Its ratio is after over before, so below 1 if ``after`` is
        better.
        """
        before, after = self._errors_by_inputs
        return prediction_change_by_record(before, after, self.policy.input_horizon * self.before.model.block)

    @cached_property
    def _errors_by_inputs(self) -> list[dict[str, dict[str, PredictionErrors]]]:
        """Prediction errors by inputs alone of ``before`` and ``after``: one dict each, by record name and channel.

        They are those on the common validation records, or on the estimation records without common validation records.
        """
        return [
            {v.record.name: _errors_by_inputs(s.model, v, self.policy.input_horizon) for v in views or s.estimation}
            for s, views in self._on_common_records
        ]

    @property
    def _on_common_records(self) -> list[tuple[FittedModel, list[RecordEvaluation]]]:
        """Both models, each with its evaluations of the validation records that both models could be evaluated on.

        The evaluations are an empty list without such records.
        """
        stages = (self.before, self.after)
        common = set.intersection(*({v.record.name for v in s.validation} for s in stages))
        return [(s, [v for v in s.validation if v.record.name in common]) for s in stages]


def comparison(
    before: FittedModel, after: FittedModel, effect: Effect, policy: SearchPolicy = DEFAULT_POLICY
) -> Comparison:
    """Return the comparison of two fitted models, of which only the second has an effect, on the validation records.

    If the effect has per-record parameters, both models are first evaluated on blocks in time of the validation runs.

    Parameters
    ----------
    before, after
        Fitted models without and with the effect.
    effect
        The effect.
    policy
        Thresholds of the comparison.

    Raises
    ------
    ValueError
        If a validation record can be evaluated with the first model and not with the second.
    """
    if any(p.per_record for p in effect.parameters):
        before, after = validated_in_blocks(before), validated_in_blocks(after)
    return whole_run_comparison(before, after, policy)


def whole_run_comparison(before: FittedModel, after: FittedModel, policy: SearchPolicy = DEFAULT_POLICY) -> Comparison:
    """Return the comparison of two fitted models on the validation runs as they are, not in blocks.

    The per-record parameters of an effect are then estimated from the data on which they are judged, so that the gain
    is an upper limit. It serves for effects that the estimation data reject. ValueError is raised if a validation
    record can be evaluated with the first model and not with the second.
    """
    failed_before = {f.record for f in before.failed}
    lost = [f for f in after.failed if f.record not in failed_before]
    if lost:
        raise ValueError(f"{lost[0].record} cannot be predicted with the added effect: {lost[0].reason}")
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
        Gain d ln L from ``before`` to ``after``, summed over the records.
    t
        t statistic of the gain over blocks of time of 10 s (4 s on the bench), as the normal deviate of the same
        probability. The blocks are half as long if the data are shorter than ``policy.min_double_blocks`` times 10 s
        (4 s). t is 0 for fewer than two blocks.

        Both are 0 without common validation records.

    Raises
    ------
    ValueError
        If the likelihood of the validation data is not finite.
    """
    per_block = _gains_per_block(before.validation, after.validation, before.model.block, policy)
    if not np.isfinite(per_block).all():
        views = (*before.validation, *after.validation)
        names = ", ".join(dict.fromkeys(v.record.name for v in views if not np.isfinite(v.ll).all()))
        raise ValueError(
            f"{names}: the likelihood of these validation data is not finite with the added effect; check these logs "
            "with `seatrial check`"
        )
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
        Gain d ln L of the estimation data that is due to the added parameters. An equal share of this gain is
        subtracted from each block of the estimation data, and nothing from the blocks of the validation data.
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

    ``before`` and ``after`` are the evaluations of the two models, matched by record name. The blocks are 2 ``block``
    [s] long, or ``block`` if the data are shorter than ``policy.min_double_blocks`` blocks of double length. They count
    from the start of each record, and the last block of a record may be shorter. The result is empty without common
    records.
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
    """Return whether both estimation and validation data support the effect of a refit.

    The criterion of the estimation data (gain less the penalty of the parameters) is positive. The gain on the
    validation data is positive, and its t statistic exceeds ``policy.min_t``. A smaller t, above
    ``policy.min_t_if_pooled``, is enough if the t statistic over the blocks of all data exceeds
    ``policy.min_pooled_t``.

    Parameters
    ----------
    refit
        Refit of a round: the result of the rough search, or of the exact fit.
    policy
        Thresholds, of which the three of the t statistic are used.
    """
    pooled = refit.t > policy.min_t_if_pooled and refit.pooled_t > policy.min_pooled_t
    return refit.criterion > 0 and refit.validation_gain > 0 and (refit.t > policy.min_t or pooled)


def is_accepted(refit: Refit, policy: SearchPolicy = DEFAULT_POLICY) -> bool:
    """Return whether the data support the effect of a refit (`is_validated`) and the prediction with it is good enough.

    The prediction may be neither significantly worse than without the effect, nor than that of the nominal model. An
    unknown prediction change (None) counts as not worse; an unknown ``refit.prediction`` also counts as better.

    A nonparametric effect has no physical explanation, so the prediction with it has to be better. One of these is
    enough:

    - the prediction over the horizon is significantly better;
    - the prediction by inputs alone is significantly better, by an amount that matters (`falls_materially`);
    - the effects together make the prediction significantly better than that of the nominal model, and the point
      estimate of the change by this effect is a fall that matters;
    - the gain in all data is significant (``policy.min_pooled_t``), and the errors fall to less than
      ``1 / policy.min_error_ratio_beside`` by their point estimate. If a boat is directionally unstable, its errors
      grow in bursts, and their ratio has no useful interval.

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
    if prediction is not None and refit.pooled_t > policy.min_pooled_t:
        better = better or prediction.ratio < 1 / policy.min_error_ratio_beside
    return is_validated(refit, policy) and not worse and (better or not refit.nonparametric)


def refit_outcome(refit: Refit, added: Sequence[Refit], policy: SearchPolicy = DEFAULT_POLICY) -> Outcome:
    """Return the outcome of a refit, before it is compared with the other refits of its round.

    Parameters
    ----------
    refit
        The refit. If the data support it (`is_validated`), its ``prediction`` must not be None.
    added
        Refits of the effects that were added in earlier rounds; may be empty.
    policy
        Thresholds of acceptance.

    Returns
    -------
    Outcome
        The first of these that holds: ``NOT_SUPPORTED`` if the criterion is not positive, ``NOT_VALIDATED`` if the
        validation data do not support the effect, ``WORSE_PREDICTION`` or ``NO_BETTER_PREDICTION`` if the refit is not
        accepted (`is_accepted`), ``SMALL`` if its criterion is at most ``policy.min_gain_ratio`` (2 %) of the largest
        of the effects added before, otherwise ``ADDED``.

    Notes
    -----
    A small effect is ``ADDED`` in two exceptional cases: the prediction errors with it are significantly and clearly
    smaller (``policy.max_small_error_ratio``), or the effect and an effect added before are declared alternatives (one
    lists the other in `Effect.alternatives`). In the latter case the effect added before may not explain all.
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
    """Return whether the prediction errors fall by an amount that matters, by their point estimate.

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

    The 95 % interval of the change over the horizon decides: True if the errors fall significantly, False if they rise.
    If neither is significant, or if the change is unknown (None), the prediction errors over three seconds by inputs
    alone decide: without the effect they have to be more than ``policy.min_error_ratio`` times those with it. An
    unknown ratio (NaN) is no improvement.

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
    """Return whether an effect justifies its parameters beside the other effects.

    Three conditions have to hold. The validation data support the effect: the gain is positive and t exceeds
    ``policy.min_t``, or ``policy.min_t_if_predicting`` if the effect improves the prediction. If the whole 95 %
    interval of the error ratio over the horizon is below ``policy.max_ratio_without_t``, a positive gain is enough. The
    prediction over the horizon is not significantly worse with the effect. The prediction errors are smaller with it by
    an amount that matters: it improves the prediction (`improves_prediction`), or the errors over the horizon fall by
    an amount that matters (`falls_materially`), or the error ratio by inputs alone exceeds
    ``policy.material_error_ratio``. False if the importance is unknown (NaN).

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
    # A few blocks with a large gain make t small, because they also raise its standard error.
    fell_far = importance.prediction is not None and importance.prediction.high < policy.max_ratio_without_t
    supported = importance.validation_gain > 0 and (importance.t > least_t or fell_far)
    return supported and matters and not worse


def should_be_removed(
    importance: EffectImportance, *, nonparametric: bool, policy: SearchPolicy = DEFAULT_POLICY
) -> bool:
    """Return whether backward elimination should remove an effect.

    An effect should be removed if it does not justify its parameters (`is_worth_its_parameters`). A nonparametric
    effect should also be removed if it does not improve the prediction (`improves_prediction`), and the errors over the
    horizon do not fall by an amount that matters (`falls_materially`).

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
    """Return whether the validation data support a removed effect, but the prediction is as good without it.

    The gain on the validation data is positive and significant (``policy.min_t``), and the 95 % interval of the change
    of the prediction errors shows neither a fall nor a rise.

    Parameters
    ----------
    removed
        Effect that backward elimination removed.
    policy
        Thresholds, of which the smallest t statistic is used.
    """
    supported = removed.validation_gain > 0 and removed.t > policy.min_t
    return supported and removed.prediction.verdict == "unchanged"


def removal_reason(removed: RemovedEffect, policy: SearchPolicy = DEFAULT_POLICY) -> str:
    """Return as a clause why backward elimination removed an effect again, by the thresholds of ``policy``.

    If the validation data support the effect (a positive gain and t above ``policy.min_t``), the clause is about the
    prediction: it is as good without the effect, or worse with it. An effect that also predicts better was removed
    because the effects that remained predicted worse than none. Otherwise the validation data support the effect too
    little, or not at all.
    """
    if is_immaterial(removed, policy):
        return "the prediction is as good without it"
    if removed.validation_gain > 0 and removed.t > policy.min_t:
        if removed.prediction.verdict == "rose":
            return "the prediction is worse with it"
        return "with the effects that remained, the prediction is worse than without any"
    if removed.validation_gain > 0:
        return (
            "with the other effects in the model, the validation data support it too little for an effect that does "
            f"not clearly improve the prediction (this needs t above {policy.min_t:g})"
        )
    return "with the other effects in the model, the validation data do not support it"


def validation_mismatches(fitted: FittedModel, policy: SearchPolicy = DEFAULT_POLICY) -> tuple[ValidationMismatch, ...]:
    """Return the validation runs whose one-step prediction errors are larger than the model claims.

    A run is listed if the lower end of the 95 % interval of a channel's ratio, actual over claimed error, exceeds
    ``policy.min_mismatch``. Of its channels the one with the largest lower end is reported. The parameter whose change
    would explain the errors is estimated from the run. The result is () if the model was cross-validated, because there
    are no validation runs.

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

    The conversion (Wallace 1959) allows for few values, with which a large t occurs by chance. For fewer than two
    values, return 0.
    """
    if x.size < 2:
        return 0.0
    t, df = float(x.mean() / (x.std(ddof=1) / np.sqrt(x.size) + 1e-12)), x.size - 1
    return float(np.copysign((8 * df + 1) / (8 * df + 3) * np.sqrt(df * np.log1p(t * t / df)), t))


def _errors_by_inputs(model: Model, evaluation: RecordEvaluation, blocks: float) -> dict[str, PredictionErrors]:
    """Return the prediction errors of a fitted model on a record, by channel, with the disturbance forces set to zero.

    Each prediction starts at the filtered state with its disturbance states set to zero. The horizon is ``blocks``
    times the block of the model (5 s for a boat, 2 s on the bench).
    """
    forces = [i for i, s in enumerate(model.states) if s.name in {r.state for r in residuals_of(model)}]
    x = evaluation.run.x_filt.copy()
    x[:, forces] = 0.0
    return horizon_errors(model, evaluation.record, evaluation.values, x, blocks * model.block)
