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

T_VALIDATION = 2.0
T_PREDICTING = 1.0  # of a selected effect with which the prediction is better
# least error three seconds ahead without an effect over that with it, where the interval over the horizon says nothing:
# of 153 right names in the recovery study one has less than 1.011, and all wrong ones have
MIN_ERROR_RATIO = 1.015
MATERIAL_ERROR_RATIO = 1.005  # the same, below which the prediction is as good without the effect
Attribution = Literal["identified", "ambiguous", "nonparametric"]


class Outcome(StrEnum):
    """What became of a refit, or of a round of the search."""

    ADDED = "added"
    OUTRANKED = "outranked"  # accepted, but another one explains more
    SMALL = "small"  # accepted, but small beside what was found, and the prediction is no better with it
    NOT_SUPPORTED = "not-supported"  # the estimation data do not pay for its parameters
    NOT_VALIDATED = "not-validated"  # the gain on the validation data is not positive, or not significant
    WORSE_PREDICTION = "worse-prediction"  # beyond its interval, than that of the last model or of the nominal one
    NO_BETTER_PREDICTION = "no-better-prediction"  # of a nonparametric effect
    UNTESTED = "untested"  # of a round: every refit failed


@dataclass(frozen=True)
class Refit:
    """The model of a round with one more effect, everything fitted again.

    gain: 2 d ln L (with priors); df: parameters added; criterion: gain - df ln n; validation_gain: d ln L on all the
    validation data, and t its statistic over blocks; prediction: change of the prediction errors over the horizon, on
    the validation data, None where it was not asked for; total: the same, from the nominal model; by_inputs: change of
    the errors three seconds ahead by inputs alone (``Comparison.by_inputs``), of a nonparametric effect.
    """

    effect: Effect
    stage: FittedModel
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
        """Whether both sets of data gain by it: more than its parameters cost, and significantly."""
        return self.criterion > 0 and self.validation_gain > 0 and self.t > T_VALIDATION

    @property
    def accepted(self) -> bool:
        """Whether it is validated and the prediction is not worse with it beyond its interval, neither than without it
        nor than that of the nominal model. A nonparametric effect has no story but its prediction: it has to be better
        beyond an interval, over the horizon or by inputs alone, or at least better by the point estimate beside effects
        that make it better.
        """
        worse = any(p is not None and p.verdict == "rose" for p in (self.prediction, self.total))
        earned = self.prediction is None or self.prediction.verdict == "fell"
        earned = earned or (self.by_inputs is not None and self.by_inputs.verdict == "fell" and helps(self.by_inputs))
        if self.total is not None and self.total.verdict == "fell":
            earned = earned or helps(self.prediction)
        return self.validated and not worse and (earned or not self.unknown)

    @property
    def unknown(self) -> bool:
        """Not an effect of the catalogue."""
        return self.effect.kind.unknown


@dataclass(frozen=True)
class UntestedCandidate:
    """A candidate that passed the score test and could not be fitted, from any start, and why; or one of the user's
    own, or one at a fixed point, that could not even have a score test."""

    effect: Effect
    reason: str


@dataclass(frozen=True)
class Round:
    """``scores``: of all candidates; ``passed``: names of those that pass; ``refits``: of the best of these, by their
    criterion; ``untested``: those that could not be fitted; ``chosen``: the refit that was added."""

    scores: tuple[Score, ...]
    passed: tuple[str, ...]
    refits: tuple[Refit, ...]
    chosen: Refit | None
    untested: tuple[UntestedCandidate, ...] = ()

    @property
    def outcome(self) -> Outcome:
        """How far the best refit came."""
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
    def why(self) -> str:
        """Why an effect was added, or none, for people."""
        if self.chosen is not None:
            gain, t = self.chosen.validation_gain, self.chosen.t
            return f"the log-likelihood of the validation data rises by {gain:.0f} (t = {t:.1f})"
        # of those that came so far, the one that explains the data best
        best = next((r for r in self.refits if r.outcome is self.outcome), None)
        if best is None:
            return "none of these could be fitted"
        match self.outcome:
            case Outcome.SMALL:
                return f"what is left is small beside what was found: {best.effect.title} would gain {best.gain:.0f}"
            case Outcome.WORSE_PREDICTION:
                return f"{best.effect.title} makes the prediction worse"
            case Outcome.NO_BETTER_PREDICTION:
                return f"the prediction is no better with {best.effect.title}"
            case _:
                return "no candidate predicts the validation data significantly better"


@dataclass(frozen=True)
class RemovedEffect:
    """An effect that the search added and that does not pay beside the others: without it the validation data lose
    nothing, or the prediction is better. ``validation_gain``, ``t``, ``prediction``: of having it."""

    effect: Effect
    validation_gain: float
    t: float
    prediction: PredictionChange

    @property
    def immaterial(self) -> bool:
        """Whether the validation data support it, and it went because the prediction is as good without it."""
        return self.validation_gain > 0 and self.t > T_VALIDATION and self.prediction.verdict == "unchanged"


@dataclass(frozen=True)
class EffectAttribution:
    """Attribution of a selected effect.

    Attributes:
        effect: its name.
        attribution: ``identified``: it explains what was missing, and no competing model does; ``ambiguous``: something
            is left that it should have explained, or a competing model comes close; ``nonparametric``: a curve without
            a name.
        reasons: why it is ambiguous, for people.
        not_excluded: names of the competing models that the data do not exclude, closest first.
    """

    effect: str
    attribution: Attribution
    reasons: tuple[str, ...] = ()
    not_excluded: tuple[str, ...] = ()


@dataclass(frozen=True)
class EffectImportance:
    """Importance of a selected effect.

    Attributes:
        effect: its name.
        gain: 2 d ln L on the estimation data, when it is added last.
        error: ratio of the prediction error three seconds ahead without it to that with it
            (``seatrial.ident.diagnosis.importance``); geometric mean over the channels of the validation data, else of
            the estimation data.
        validation_gain, t: d ln L on the validation data of having it beside the others, and its statistic over blocks.
        prediction: change of the prediction errors over the horizon by having it.
        untested: why the model without it could not be fitted: then nothing is known of its importance.
    """

    effect: str
    gain: float
    error: float
    validation_gain: float = float("nan")
    t: float = float("nan")
    prediction: PredictionChange | None = None
    untested: str | None = None

    @property
    def pays(self) -> bool:
        """Whether the validation data support it beside the others, significantly or with a better prediction, and it
        matters to the prediction, which is not worse with it."""
        worse = self.prediction is not None and self.prediction.verdict == "rose"
        matters = self.predicts or helps(self.prediction) or self.error > MATERIAL_ERROR_RATIO
        supported = self.validation_gain > 0 and self.t > (T_PREDICTING if self.predicts else T_VALIDATION)
        return supported and matters and not worse

    @property
    def predicts(self) -> bool:
        """Whether the prediction is better with it: over the horizon beyond its interval, or, where that says nothing,
        three seconds ahead by inputs alone."""
        return predicts(self.prediction, self.error)


def helps(prediction: PredictionChange | None) -> bool:
    """Whether the point estimate of a change of the prediction errors is a fall that counts."""
    return prediction is not None and prediction.ratio < 1 / MIN_ERROR_RATIO


def predicts(prediction: PredictionChange | None, error: float) -> bool:
    """Whether a prediction is better: over the horizon, or, where that says nothing, three seconds ahead by the ratio
    of errors."""
    verdict = "unchanged" if prediction is None else prediction.verdict
    return verdict == "fell" or (verdict == "unchanged" and error > MIN_ERROR_RATIO)


@dataclass(frozen=True)
class ValidationMismatch:
    """A validation run, by its record's name, that is predicted worse than the model says: the channel whose errors one
    step ahead are most too large, by what factor (``scale``), and the parameter that would explain it."""

    record: str
    channel: str
    scale: float
    shift: ParameterShift | None


@dataclass(frozen=True)
class ShortData:
    """Estimation data (``seconds``) too short for ``untestable`` of the ``candidates``: their score tests could not
    pass whatever the effect's size; with ``needed`` [s] all could."""

    seconds: float
    needed: float
    untestable: int
    candidates: int


@dataclass(frozen=True)
class Diagnosis:
    """before, after: the model without and with the effects; left: what still passes the tests at the end, best
    first; shapes: the curves of nonparametric effects, and of the first ambiguous one; weights and judgements: one for
    each effect, the most important first; removed: effects that were added and did not pay; failed_runs: validation
    runs that could not be evaluated; mismatches: validation runs that are predicted worse than the model says;
    undrawn: why there is no curve of the first ambiguous effect, where it could not be fitted; refused: candidates of
    the user's own that could not be tested; scores: the last ones, of all candidates; untried: what passed when the
    search had added as many effects as it may."""

    before: FittedModel
    after: FittedModel
    rounds: tuple[Round, ...]
    left: tuple[Score, ...]
    shapes: tuple[NonparametricForce, ...]
    judgements: tuple[EffectAttribution, ...] = ()
    weights: tuple[EffectImportance, ...] = ()
    removed: tuple[RemovedEffect, ...] = ()
    failed_runs: tuple[FailedRun, ...] = ()
    mismatches: tuple[ValidationMismatch, ...] = ()
    short: ShortData | None = None
    undrawn: str | None = None
    refused: tuple[UntestedCandidate, ...] = ()
    scores: tuple[Score, ...] = ()
    untried: tuple[Score, ...] = ()

    @property
    def effects(self) -> tuple[Refit, ...]:
        """Refits of the selected effects, the most important first."""
        chosen = {r.chosen.effect.name: r.chosen for r in self.rounds if r.chosen is not None}
        return tuple(chosen[w.effect] for w in self.weights)

    @property
    def untested(self) -> tuple[UntestedCandidate, ...]:
        """Candidates that could not be fitted in any round."""
        tested = {q.effect.name for one in self.rounds for q in one.refits}
        every = {u.effect.name: u for one in self.rounds for u in one.untested}
        return tuple(u for name, u in every.items() if name not in tested)

    @property
    def cross_validated(self) -> bool:
        """Whether blocks in time of the estimation runs took the place of validation runs."""
        return self.after.cross_validated

    @property
    def converged(self) -> bool:
        """Whether the last model's fit did."""
        return self.after.fit.converged
