"""Results of a diagnosis: rounds of the search, refits, attribution and importance of the selected effects."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from seatrial.ident.diagnosis.score_test import Score
from seatrial.ident.effects import NonparametricForce
from seatrial.ident.estimation import FailedRun, FittedModel, ParameterShift
from seatrial.ident.model import Effect
from seatrial.ident.validation import PredictionChange

T_VALIDATION = 2.0  # smallest t statistic of the gain on validation data
T_PREDICTING = 1.0  # the same for a selected effect that improves the prediction
# Smallest ratio of the error three seconds ahead without an effect to that with it. It decides if the interval over
# the horizon shows no change. In the recovery study one of 153 correct effects and all wrong effects are below 1.011.
MIN_ERROR_RATIO = 1.015
MATERIAL_ERROR_RATIO = 1.005  # below this ratio the prediction is as good without the effect
Attribution = Literal["identified", "ambiguous", "nonparametric"]


class Outcome(StrEnum):
    """Outcome of a refit, or of a round of the search."""

    ADDED = "added"
    OUTRANKED = "outranked"  # accepted, but another effect explains more
    SMALL = "small"  # accepted, but small compared with the effects found before, and the prediction is no better
    NOT_SUPPORTED = "not-supported"  # the gain on the estimation data is below the penalty of its parameters
    NOT_VALIDATED = "not-validated"  # the gain on the validation data is not positive, or not significant
    WORSE_PREDICTION = "worse-prediction"  # significantly worse than with the last model or the nominal model
    NO_BETTER_PREDICTION = "no-better-prediction"  # a nonparametric effect without a better prediction
    UNTESTED = "untested"  # of a round: every refit failed


@dataclass(frozen=True)
class Refit:
    """Fit of the model of a round with one more effect, all parameters free.

    Attributes
    ----------
    effect
        The added effect.
    fitted
        The fitted model.
    gain
        Gain on the estimation data, 2 d ln L with priors.
    df
        Number of added parameters.
    criterion
        ``gain - df ln n``, with n rows of estimation data.
    validation_gain
        d ln L on all validation data.
    t
        t statistic of the validation gain over blocks of time.
    prediction
        Change of the prediction errors over the horizon on the validation data, None if it was not computed.
    outcome
        Outcome of the refit in its round.
    total
        Change of the prediction errors from the nominal model, None if it was not computed.
    by_inputs
        Change of the errors three seconds ahead by inputs alone (``Comparison.by_inputs``), for a nonparametric effect.
    """

    effect: Effect
    fitted: FittedModel
    gain: float
    df: int
    criterion: float
    validation_gain: float
    t: float
    prediction: PredictionChange | None = None
    outcome: Outcome = Outcome.OUTRANKED
    total: PredictionChange | None = None
    by_inputs: PredictionChange | None = None

    @property
    def validated(self) -> bool:
        """Return whether both sets of data support the effect.

        The gain on the estimation data exceeds the penalty of the parameters, and the gain on the validation data is
        positive and significant.
        """
        return self.criterion > 0 and self.validation_gain > 0 and self.t > T_VALIDATION

    @property
    def accepted(self) -> bool:
        """Return whether the refit is validated and the prediction with it is good enough.

        The prediction may not be significantly worse than without the effect, nor than that of the nominal model. A
        nonparametric effect has no physical explanation, so the prediction with it has to be better. One of these is
        enough:

        - the prediction is significantly better over the horizon, or by inputs alone;
        - the point estimate is better, and the effects together make the prediction significantly better.
        """
        worse = any(p is not None and p.verdict == "rose" for p in (self.prediction, self.total))
        better = self.prediction is None or self.prediction.verdict == "fell"
        better = better or (self.by_inputs is not None and self.by_inputs.verdict == "fell" and helps(self.by_inputs))
        if self.total is not None and self.total.verdict == "fell":
            better = better or helps(self.prediction)
        return self.validated and not worse and (better or not self.nonparametric)

    @property
    def nonparametric(self) -> bool:
        """Return whether the effect is nonparametric."""
        return self.effect.kind.nonparametric


@dataclass(frozen=True)
class UntestedCandidate:
    """A candidate that could not be tested, and the reason.

    Either the candidate passed the score test and could not be fitted from any initial values, or it could not have a
    score test. The latter is reported for user-defined effects and for effects at a fixed point.
    """

    effect: Effect
    reason: str


@dataclass(frozen=True)
class Round:
    """One round of the search.

    Attributes
    ----------
    scores
        Scores of all candidates.
    passed
        Names of the candidates that pass the score test.
    refits
        Refits of the best candidates, sorted by their criterion.
    chosen
        The refit that was added, None if no refit was accepted.
    untested
        Candidates that could not be fitted.
    """

    scores: tuple[Score, ...]
    passed: tuple[str, ...]
    refits: tuple[Refit, ...]
    chosen: Refit | None
    untested: tuple[UntestedCandidate, ...] = ()

    @property
    def outcome(self) -> Outcome:
        """Outcome of the refit that came closest to being added."""
        if self.chosen is not None:
            return Outcome.ADDED
        found = {r.outcome for r in self.refits}
        order = (
            Outcome.SMALL,
            Outcome.WORSE_PREDICTION,
            Outcome.NO_BETTER_PREDICTION,
            Outcome.NOT_VALIDATED,
            Outcome.NOT_SUPPORTED,
        )
        return next((o for o in order if o in found), Outcome.UNTESTED)

    @property
    def explanation(self) -> str:
        """Sentence for reports: why an effect was added, or why no effect was added."""
        if self.chosen is not None:
            gain, t = self.chosen.validation_gain, self.chosen.t
            return f"the log-likelihood of the validation data rises by {gain:.0f} (t = {t:.1f})"
        # the refits are sorted, so this is the best of the refits with this outcome
        best = next((r for r in self.refits if r.outcome is self.outcome), None)
        if best is None:
            return "no candidate that passed could be fitted"
        match self.outcome:
            case Outcome.SMALL:
                return f"the rest is small compared with the effects found: {best.effect.title} gains {best.gain:.0f}"
            case Outcome.WORSE_PREDICTION:
                return f"{best.effect.title} makes the prediction worse"
            case Outcome.NO_BETTER_PREDICTION:
                return f"the prediction is no better with {best.effect.title}"
            case _:
                return "no candidate predicts the validation data significantly better"


@dataclass(frozen=True)
class RemovedEffect:
    """An effect that the search added and backward elimination removed.

    Without the effect the validation data lose no likelihood, or the prediction is better.

    Attributes
    ----------
    effect
        The effect.
    validation_gain, t
        Gain d ln L on the validation data with the effect, and its t statistic.
    prediction
        Change of the prediction errors by adding the effect.
    """

    effect: Effect
    validation_gain: float
    t: float
    prediction: PredictionChange

    @property
    def immaterial(self) -> bool:
        """Return whether the validation data support the effect, and the prediction is as good without it."""
        return self.validation_gain > 0 and self.t > T_VALIDATION and self.prediction.verdict == "unchanged"


@dataclass(frozen=True)
class EffectAttribution:
    """Attribution of a selected effect.

    Attributes
    ----------
    effect
        Name of the effect.
    attribution
        ``identified``: the effect explains what the model lacked, and no competing model does. ``ambiguous``: the
        effect leaves a residual that it should explain, or a competing model comes close. ``nonparametric``: a curve
        without a formula.
    reasons
        Reasons for an ambiguous attribution, as texts for reports.
    not_excluded
        Names of the competing models that the data do not exclude, closest first.
    """

    effect: str
    attribution: Attribution
    reasons: tuple[str, ...] = ()
    not_excluded: tuple[str, ...] = ()


@dataclass(frozen=True)
class EffectImportance:
    """Importance of a selected effect.

    Attributes
    ----------
    effect
        Name of the effect.
    gain
        2 d ln L on the estimation data if the effect is added last.
    error_ratio
        Ratio of the prediction error three seconds ahead without the effect to that with it
        (``seatrial.ident.diagnosis.importance``). It is the geometric mean over the channels of the validation data, or
        of the estimation data if there are no validation data.
    validation_gain, t
        d ln L on the validation data by adding the effect to the others, and its t statistic over blocks.
    prediction
        Change of the prediction errors over the horizon by adding the effect to the others.
    untested
        Reason why the model without the effect could not be fitted. Its importance is then unknown.
    """

    effect: str
    gain: float
    error_ratio: float
    validation_gain: float = float("nan")
    t: float = float("nan")
    prediction: PredictionChange | None = None
    untested: str | None = None

    @property
    def supported(self) -> bool:
        """Return whether the effect is worth its parameters beside the other effects.

        The validation data support the effect, either significantly or with a better prediction. The prediction is not
        worse with the effect, and its size matters.
        """
        worse = self.prediction is not None and self.prediction.verdict == "rose"
        matters = self.improves_prediction or helps(self.prediction) or self.error_ratio > MATERIAL_ERROR_RATIO
        supported = self.validation_gain > 0 and self.t > (T_PREDICTING if self.improves_prediction else T_VALIDATION)
        return supported and matters and not worse

    @property
    def improves_prediction(self) -> bool:
        """Return whether the prediction is better with the effect.

        The interval of the change over the horizon decides. If it shows no change, the error three seconds ahead by
        inputs alone decides.
        """
        return predicts(self.prediction, self.error_ratio)


def helps(prediction: PredictionChange | None) -> bool:
    """Return whether the point estimate of a change of the prediction errors is a fall that matters."""
    return prediction is not None and prediction.ratio < 1 / MIN_ERROR_RATIO


def predicts(prediction: PredictionChange | None, error: float) -> bool:
    """Return whether a prediction is better.

    Parameters
    ----------
    prediction
        Change over the horizon. Its interval decides.
    error
        Ratio of the errors three seconds ahead, before over after. It decides if the interval shows no change.
    """
    verdict = "unchanged" if prediction is None else prediction.verdict
    return verdict == "fell" or (verdict == "unchanged" and error > MIN_ERROR_RATIO)


@dataclass(frozen=True)
class ValidationMismatch:
    """A validation run with larger prediction errors than the model claims.

    Attributes
    ----------
    record
        Name of the record.
    channel
        Channel whose one-step errors exceed the claimed ones most.
    scale
        Factor between actual and claimed errors of this channel.
    shift
        Parameter change that would explain the errors, None if there is none.
    """

    record: str
    channel: str
    scale: float
    shift: ParameterShift | None


@dataclass(frozen=True)
class ShortData:
    """Estimation data too short for some score tests, which could not pass for any size of the effect.

    Attributes
    ----------
    seconds
        Length of the estimation data [s].
    needed
        Length with which all candidates could pass [s].
    untestable
        Number of candidates that cannot pass.
    candidates
        Number of all candidates.
    """

    seconds: float
    needed: float
    untestable: int
    candidates: int


@dataclass(frozen=True)
class Diagnosis:
    """Result of a diagnosis.

    Attributes
    ----------
    before, after
        Fitted model without and with the effects.
    rounds
        Rounds of the search.
    remaining
        Scores that still pass at the end, best first.
    curves
        Curves of the nonparametric effects, and of the residual in place of the first ambiguous effect.
    attributions
        Attribution of each effect, the most important first.
    importances
        Importance of each effect, the most important first.
    removed
        Effects that were added and removed again.
    failed_runs
        Validation runs that could not be evaluated.
    mismatches
        Validation runs with larger errors than the model claims.
    short_data
        Candidates that could not pass because the data are short, None if all could.
    curve_failure
        Reason why the curve of the first ambiguous effect could not be fitted, None if there is no such failure.
    untestable
        User-defined candidates and candidates at a fixed point that could not be tested.
    scores
        Last scores of all candidates.
    untried_scores
        Scores that passed when the largest number of effects had been added.
    """

    before: FittedModel
    after: FittedModel
    rounds: tuple[Round, ...]
    remaining: tuple[Score, ...]
    curves: tuple[NonparametricForce, ...]
    attributions: tuple[EffectAttribution, ...] = ()
    importances: tuple[EffectImportance, ...] = ()
    removed: tuple[RemovedEffect, ...] = ()
    failed_runs: tuple[FailedRun, ...] = ()
    mismatches: tuple[ValidationMismatch, ...] = ()
    short_data: ShortData | None = None
    curve_failure: str | None = None
    untestable: tuple[UntestedCandidate, ...] = ()
    scores: tuple[Score, ...] = ()
    untried_scores: tuple[Score, ...] = ()

    @property
    def effects(self) -> tuple[Refit, ...]:
        """Refits of the selected effects, the most important first."""
        chosen = {r.chosen.effect.name: r.chosen for r in self.rounds if r.chosen is not None}
        return tuple(chosen[w.effect] for w in self.importances)

    @property
    def untested(self) -> tuple[UntestedCandidate, ...]:
        """Candidates that could not be fitted in any round."""
        tested = {q.effect.name for r in self.rounds for q in r.refits}
        failed = {u.effect.name: u for r in self.rounds for u in r.untested}
        return tuple(u for name, u in failed.items() if name not in tested)

    @property
    def cross_validated(self) -> bool:
        """Return whether blocks in time of the estimation runs took the place of validation runs."""
        return self.after.cross_validated

    @property
    def converged(self) -> bool:
        """Return whether the fit of the last model converged."""
        return self.after.fit.converged
