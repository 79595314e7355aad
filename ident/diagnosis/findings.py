"""Findings of a diagnosis: rounds of the search, refits, attribution and importance of the selected effects.

The classes hold data only. Whether an effect is accepted is decided in ``seatrial.ident.diagnosis.acceptance``.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import Literal

import numpy as np

from seatrial.ident.diagnosis.policy import DEFAULT_POLICY, SearchPolicy
from seatrial.ident.diagnosis.score_test import Score
from seatrial.ident.effects import NonparametricForce
from seatrial.ident.estimation import FailedRun, FittedModel, ParameterShift
from seatrial.ident.model import Effect
from seatrial.ident.numerics import Array
from seatrial.ident.validation import PredictionChange

CLEAR_CRITERION = 10.0  # of a refit, from which its data clearly support it (Kass and Raftery 1995)
CLEAR_T = 2.0  # t statistic of a gain on the validation data, from which it is reported
Attribution = Literal["identified", "ambiguous", "nonparametric"]


class Outcome(StrEnum):
    """Outcome of a refit, or of a round of the search.

    Attributes
    ----------
    ADDED
        The effect was added to the model.
    OUTRANKED
        The data support the effect, but another effect of the round was preferred. This is also the value before the
        choice.
    SMALL
        The refit is accepted, but its gain is small compared with the effects added before, and the prediction is not
        better enough.
    NOT_SUPPORTED
        The gain on the estimation data is not above the penalty of the added parameters.
    NOT_VALIDATED
        The gain on the validation data is not positive, or its t statistic is too small.
    WORSE_PREDICTION
        The prediction is significantly worse than without the effect, or than that of the nominal model.
    NO_BETTER_PREDICTION
        The effect is nonparametric, and the prediction with it is not better.
    UNTESTED
        Only of a round: there is no refit, because for each candidate the rough or the exact fit failed.
    """

    ADDED = "added"
    OUTRANKED = "outranked"
    SMALL = "small"
    NOT_SUPPORTED = "not-supported"
    NOT_VALIDATED = "not-validated"
    WORSE_PREDICTION = "worse-prediction"
    NO_BETTER_PREDICTION = "no-better-prediction"
    UNTESTED = "untested"


@dataclass(frozen=True)
class Refit:
    """Fit of the model of a round with one more effect, all parameters free.

    Attributes
    ----------
    effect
        The added effect.
    fitted
        The fitted model. It is the result of a rough search (a loose tolerance), or of an exact fit. Only the refits
        that were considered for the choice are fitted exactly.
    gain
        Gain 2 d ln L of the rough search on the estimation data, with the priors of the parameters.
    df
        Number of added parameters.
    criterion
        ``gain - df ln n``, with n rows of estimation data (Delta BIC); larger is better.
    validation_gain
        Gain d ln L in log-likelihood on all validation data; 0 without validation data. An upper limit if the effect
        has per-record parameters and the criterion is not positive (`acceptance.whole_run_comparison`).
    t
        t statistic of ``validation_gain`` over blocks of time, as the normal deviate of the same probability.
    prediction
        Change of the prediction errors over the horizon on the validation data, from the model without the effect to
        that with it. None before the exact fit.
    outcome
        Outcome of the refit in its round.
    total
        Like ``prediction``, from the nominal model (without any added effect) to this model.
    by_inputs
        Change of the prediction errors over three seconds (1.2 s on the bench) by inputs alone, that is with the
        disturbance forces set to zero. None for a parametric effect, or before the exact fit.
    pooled_t
        t statistic of the gain over the blocks of validation and estimation data (`acceptance.pooled_t`).
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
    pooled_t: float = 0.0

    @property
    def nonparametric(self) -> bool:
        """Whether the effect is nonparametric: a curve, or a lagged or resonant response, without a formula."""
        return self.effect.kind.nonparametric

    @property
    def is_near(self) -> bool:
        """Whether the data support the effect, and the validation data alone are too few to decide.

        Its criterion is positive, the log-likelihood of the validation data rises with it, and the criterion of all
        data, with twice this rise, is above 10 (`CLEAR_CRITERION`). The criterion of the estimation data alone would
        leave out an effect with many parameters that predicts the validation data better than others.
        """
        supported = self.criterion > 0 and self.validation_gain > 0
        clear = self.criterion + 2.0 * self.validation_gain > CLEAR_CRITERION
        return self.outcome is Outcome.NOT_VALIDATED and supported and clear


@dataclass(frozen=True)
class CommonErrorsGain:
    """Gains of a fit with the common errors (timing and mounting of sensors, hull form) over the fit without them.

    Attributes
    ----------
    gain
        Gain on the estimation data, 2 d ln L with priors.
    df
        Number of added parameters.
    criterion
        ``gain - df ln n``, with n rows of estimation data.
    validation_gain, t
        d ln L on all validation data, and its t statistic over blocks of time.
    prediction
        Change of the prediction errors over the horizon on the validation data.
    """

    gain: float
    df: int
    criterion: float
    validation_gain: float
    t: float
    prediction: PredictionChange


@dataclass(frozen=True)
class CommonErrorsFit:
    """Fit with the common errors, which every craft has: timing and mounting of sensors, form of the hull.

    The errors are estimated together with the effects, and are not effects that the search found.

    Attributes
    ----------
    effects
        The errors, in the order of their selection.
    fitted
        The fitted model with all of them.
    after
        Names of the effects that the model had before; empty if the errors came first.
    gains
        Gains over the fit without the errors. None if the model to diagnose had them already.
    """

    effects: tuple[Effect, ...]
    fitted: FittedModel
    after: tuple[str, ...] = ()
    gains: CommonErrorsGain | None = None


@dataclass(frozen=True)
class RejectedCommonErrors:
    """Common errors that the score tests selected together, and that a model does not get, with the reason.

    Attributes
    ----------
    effects
        The errors, in the order of their selection.
    reason
        Reason as a clause for reports, without a full stop.
    """

    effects: tuple[Effect, ...]
    reason: str


@dataclass(frozen=True)
class UntestedCandidate:
    """Candidate effect that could not be tested, with the reason.

    Either the candidate passed the score test, but no fit with it succeeded from any of its initial values; or it could
    not have a score test. The latter is reported only for user-defined effects, and for effects that act at a point
    fixed over ground (``Effect.fixed_point``) if the logs are too far apart for one origin of the positions.

    Attributes
    ----------
    effect
        The candidate.
    reason
        Reason as a text for reports, without a full stop.
    """

    effect: Effect
    reason: str


@dataclass(frozen=True)
class Round:
    """Round of the search: the score tests on one model, the refits, and the choice.

    Attributes
    ----------
    scores
        Scores of all candidates on the model before the round, the largest criterion first.
    passed
        Names of the candidates that pass the score test and may be refitted. After a nonparametric effect or the common
        errors were added, only those with a large score; after a nonparametric effect, only parametric ones.
    refits
        Refits of the best candidates, the largest criterion first.
    chosen
        The refit that was added, None if no refit was added.
    untested
        Candidates that passed and could not be fitted.
    explained
        Names of those other candidates in ``passed`` that would no longer be tried with the chosen effect in the model.
        Empty if none was chosen, if it is nonparametric, or if the model with it was not tested.
    """

    scores: tuple[Score, ...]
    passed: tuple[str, ...]
    refits: tuple[Refit, ...]
    chosen: Refit | None
    untested: tuple[UntestedCandidate, ...] = ()
    explained: tuple[str, ...] = ()

    @property
    def outcome(self) -> Outcome:
        """Outcome of the round: ``ADDED`` if a refit was added, ``UNTESTED`` if there is no refit.

        Otherwise it is the outcome of the refit that came closest to being added. Refits come closer in the order
        ``NOT_SUPPORTED``, ``NOT_VALIDATED``, ``NO_BETTER_PREDICTION``, ``WORSE_PREDICTION``, ``SMALL``.
        """
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
    def nearest(self) -> tuple[Refit, ...]:
        """Refits with a formula that come nearest to being added (`Refit.is_near`), the largest ``t`` first.

        The answer and the recommended experiment use this one order. The score tests and the criterion have others:
        they use the estimation data only.
        """
        return tuple(sorted((r for r in self.refits if r.is_near and not r.nonparametric), key=lambda r: -r.t))

    @property
    def explanation(self) -> str:
        """Clause for reports, without a full stop: why the effect of the round was added, or why none was added.

        For an added effect, the clause has the gain on the validation data and its t statistic. Otherwise it states the
        ``outcome`` of the round, if possible with the best refit of this outcome. For ``NOT_SUPPORTED`` and
        ``NOT_VALIDATED`` the clause is the same and names no refit.
        """
        if self.chosen is not None:
            gain, t = self.chosen.validation_gain, self.chosen.t
            return f"the log-likelihood of the validation data rises by {gain:.0f} (t = {t:.1f})"
        # the refits are sorted, so this is the best of the refits with this outcome
        best = next((r for r in self.refits if r.outcome is self.outcome), None)
        if best is None:
            return "no candidate that passed could be fitted"
        match self.outcome:
            case Outcome.SMALL:
                return (
                    "other effects are small compared with the effects found: "
                    f"{_in_sentence(best.effect.title)} gains {best.gain:.0f} in 2 ln L"
                )
            case Outcome.WORSE_PREDICTION:
                worse = f"{_in_sentence(best.effect.title)} makes the prediction worse"
                if best.validation_gain > 0.0 and best.t > CLEAR_T:
                    worse += (
                        ", although it explains a part of the residuals one step ahead: the log-likelihood of the "
                        f"validation data rises by {best.validation_gain:.0f} (t = {best.t:.1f})"
                    )
                return worse
            case Outcome.NO_BETTER_PREDICTION:
                explained = f"{_in_sentence(best.effect.title)} explains a part of the residuals one step ahead"
                if best.validation_gain > 0.0 and best.t > CLEAR_T:
                    explained += (
                        f" (the log-likelihood of the validation data rises by {best.validation_gain:.0f}, t = "
                        f"{best.t:.1f})"
                    )
                return f"{explained}, but the prediction is no better with it"
            case _:
                return "no candidate predicts the validation data significantly better"


def _in_sentence(title: str) -> str:
    """Return the title of an effect as the subject of a sentence: that of a nonparametric effect without its colon."""
    return title.replace("a nonparametric effect: ", "a curve by which ")


@dataclass(frozen=True)
class RemovedEffect:
    """Effect that the search added and backward elimination removed.

    For example, the validation data did not support the effect beside the others, or the prediction was as good
    without it.

    Attributes
    ----------
    effect
        The effect.
    validation_gain
        Gain d ln L in log-likelihood on the validation data by adding the effect to the other effects.
    t
        t statistic of ``validation_gain`` over blocks of time.
    prediction
        Change of the prediction errors over the horizon by adding the effect to the other effects.
    """

    effect: Effect
    validation_gain: float
    t: float
    prediction: PredictionChange


@dataclass(frozen=True)
class EffectAttribution:
    """Attribution of a selected effect: whether the data determine which effect it is.

    Attributes
    ----------
    effect
        Name of the effect.
    attribution
        ``identified``: the effect explains what the model lacked, and no competing model does. ``ambiguous``: the
        effect leaves a residual that it should explain, a competing model comes close, or data and fit have another
        weakness. ``nonparametric``: a curve without a formula.
    reasons
        Reasons for an ambiguous attribution, as clauses for reports; empty for the other attributions.
    not_excluded
        Names of the competing models that the data do not exclude, closest first. Declared alternatives
        (`Effect.alternatives`) follow that could not be tested, that the estimated parameters of the model explain, so
        that their score tests have no power, whose score tests still pass beside several added effects, or that the
        user left out of the search.
    competitor
        Name of the effect or curve that the first of the ``reasons`` is about; empty if it is about none.
    """

    effect: str
    attribution: Attribution
    reasons: tuple[str, ...] = ()
    not_excluded: tuple[str, ...] = ()
    competitor: str = ""


@dataclass(frozen=True)
class EffectImportance:
    """Importance of a selected effect: what is lost if the effect is left out and the model is fitted again.

    A nonparametric curve of which the effect is one form is left out together with it.

    Attributes
    ----------
    effect
        Name of the effect.
    gain
        Gain 2 d ln L on the estimation data if the effect is added last, with priors. NaN if unknown.
    error_ratio
        Ratio of the RMS prediction errors over three seconds (1.2 s on the bench) by inputs alone, without the effect
        over with it; above 1 if the effect helps. By inputs alone means with the disturbance forces set to zero. The
        ratio is the geometric mean over the channels of the validation data, or of the estimation data if there are no
        validation data. NaN if unknown.
    validation_gain
        Gain d ln L on the validation data by adding the effect to the others; NaN if unknown.
    t
        t statistic of ``validation_gain`` over blocks of time; NaN if unknown.
    prediction
        Change of the prediction errors over the horizon by adding the effect to the others, None if unknown.
    untested
        Reason why the effect could not be tested: the model without it could not be fitted or compared. None if it was
        tested.
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
    """Validation run whose one-step prediction errors are larger than the model claims.

    Attributes
    ----------
    record
        Name of the run's record.
    channel
        Name of the measured channel whose errors exceed the claimed errors most.
    scale
        RMS of one-step error over claimed standard deviation of this channel; larger than 1.
    shift
        Change of one parameter in this run that would explain the errors best, None if no parameter would.
    """

    record: str
    channel: str
    scale: float
    shift: ParameterShift | None


@dataclass(frozen=True)
class ShortData:
    """Length of estimation data that are too short for some score tests, and the number of these tests.

    The block-robust statistic cannot exceed the number of blocks of time. With few blocks, a candidate with many
    parameters cannot pass at the usual significance level for any size of the effect. The weaker level for overwhelming
    evidence is not considered.

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
class ModelUncertainty:
    """Shifts of the estimates that each candidate which still passes the score tests would cause.

    Attributes
    ----------
    parameters
        Full names of the n fitted parameters.
    candidates
        Names of the m candidates that pass, without common errors, and without ``waves``, which has no score equations.
    shifts : Array (m, n)
        Change of each estimate if the candidate were added to the model, in the units of the parameters.
    common_errors : Array (n, n)
        Mean square error of the estimates because the model lacks common errors. It is zero if no candidate passes.
    thrust_difference : float
        Half the relative difference of the thrust of both sides. It is zero if the scale of the forces does not follow
        from the given thrust.
    scale_shift : Array (n,)
        Change of each estimate if only one side deviates from the given thrust, by the whole difference.
    strongest
        Name of the candidate with the largest criterion of those that pass, without common errors; empty if there is
        none.
    weaker_side
        Side with the smaller thrust, ``left`` or ``right``; empty if there is no difference, or if
        its parts disagree.
    thrust_rivals
        Names of the candidates that pass and may be the cause of the difference, the largest criterion first: the
        effect with the difference of thrust, and its alternatives. It is empty if the fitted model has the difference.
    """

    parameters: tuple[str, ...]
    candidates: tuple[str, ...]
    shifts: Array
    common_errors: Array
    thrust_difference: float
    scale_shift: Array
    strongest: str = ""
    weaker_side: str = ""
    thrust_rivals: tuple[str, ...] = ()

    @property
    def covariance(self) -> Array:
        """Part of the covariance (n, n) of the estimates that is due to the incomplete model.

        It is the mean over the candidates of the outer product of the shifts with themselves, plus ``common_errors``,
        plus the outer product of ``scale_shift`` with itself.
        """
        product: Array = self.shifts.T @ self.shifts / max(len(self.candidates), 1)
        return product + self.common_errors + np.outer(self.scale_shift, self.scale_shift)


@dataclass(frozen=True)
class Diagnosis:
    """Findings of a diagnosis: models, rounds of the search, and judgement of the selected effects.

    A *selected* effect was added in a round and was not removed by the backward elimination.

    Attributes
    ----------
    before, after
        Fitted model without added effects, and with the selected effects. ``after`` also has the common errors, if they
        were added. Both are the same object if nothing was added.
    rounds
        Rounds of the search, in their order; empty if no candidate was tried.
    remaining
        Scores that pass the score test on ``after``, the largest criterion first.
    curves
        Curves of the nonparametric effects, and the curve of the residual that is fitted in place of the first
        ambiguous effect.
    attributions
        Attribution of each selected effect, the most important first.
    importances
        Importance of each selected effect, the most important first.
    removed
        Effects that were added and removed again.
    failed_runs
        Validation runs that could not be evaluated.
    mismatches
        Validation runs with larger one-step errors than the model claims.
    short_data
        Number of candidates that could not pass because the data are short, None if all could.
    curve_failure
        Title of the first ambiguous effect and the reason why no curve could be fitted in its place, None if there is
        no such failure.
    untestable
        User-defined candidates and candidates at a fixed point that could not have a score test.
    refuted
        Candidates that signals contradict which the model does not use, with the reasons. They were not tested.
    excluded
        Candidates that the user left out of the search.
    scores
        Scores of all candidates on the last model that was tested, the largest criterion first.
    untried_scores
        Scores that passed and were not tried, because the largest number of effects had been added. Empty otherwise.
    policy
        Thresholds of the diagnosis.
    common_errors
        Fit with the small errors that every craft has (timing and mounting of sensors, hull form). None if they were
        not added.
    rejected_common_errors
        Common errors that the search selected and did not add. None if it added them, or selected too few.
    uncertainty
        Shifts of the estimates of ``after`` by effects that it lacks. None if there are none.
    untried_waves
        Frequency [Hz] of a significant peak in the spectrum of the innovations of ``after``, as of waves, if the search
        did not try waves because the model has common errors. None otherwise.
    own_effects
        Names of the user-defined candidates.
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
    refuted: tuple[UntestedCandidate, ...] = ()
    excluded: tuple[Effect, ...] = ()
    scores: tuple[Score, ...] = ()
    untried_scores: tuple[Score, ...] = ()
    policy: SearchPolicy = DEFAULT_POLICY
    common_errors: CommonErrorsFit | None = None
    rejected_common_errors: RejectedCommonErrors | None = None
    uncertainty: ModelUncertainty | None = None
    untried_waves: float | None = None
    own_effects: tuple[str, ...] = ()

    @property
    def effects(self) -> tuple[Refit, ...]:
        """Refits of the selected effects, the most important first.

        They are the refits of the rounds that added the effects, so their estimates can differ from those of the last
        model. The result is empty if no effect was selected.
        """
        chosen = {r.chosen.effect.name: r.chosen for r in self.rounds if r.chosen is not None}
        return tuple(chosen[w.effect] for w in self.importances)

    @property
    def untested(self) -> tuple[UntestedCandidate, ...]:
        """Candidates that passed a score test and could not be fitted in any round, each once with its last reason."""
        tested = {q.effect.name for r in self.rounds for q in r.refits}
        failed = {u.effect.name: u for r in self.rounds for u in r.untested}
        return tuple(u for name, u in failed.items() if name not in tested)

    @property
    def cross_validated(self) -> bool:
        """Whether blocks in time of the estimation runs took the place of missing validation runs."""
        return self.after.cross_validated

    @property
    def converged(self) -> bool:
        """Whether the fit of the last model (``after``) converged. The fit of ``before`` is not considered."""
        return self.after.fit.converged
