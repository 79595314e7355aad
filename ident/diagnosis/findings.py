"""Findings of a diagnosis: rounds of the search, refits, attribution and importance of the selected effects.

The classes hold data only. Whether an effect is accepted is decided in ``seatrial.ident.diagnosis.acceptance``.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

from seatrial.ident.diagnosis.policy import DEFAULT_POLICY, SearchPolicy
from seatrial.ident.diagnosis.score_test import Score
from seatrial.ident.effects import NonparametricForce
from seatrial.ident.estimation import FailedRun, FittedModel, ParameterShift
from seatrial.ident.model import Effect
from seatrial.ident.validation import PredictionChange

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
    policy
        Thresholds that the diagnosis was made with.
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
    policy: SearchPolicy = DEFAULT_POLICY

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
