"""Diagnosis: forward selection of missing effects by score tests, refits and validation.

1. Fit the model with disturbance forces and sensor biases as states.
2. Compute the score tests of all candidates, parametric and nonparametric (``seatrial.ident.diagnosis.score_test``).
3. Refit with the best few candidates, all parameters free. Compare the refits by ``2 d ln L - df ln n`` (Delta BIC).
4. Validate the refits (``seatrial.ident.diagnosis.acceptance``) and add the best refit that passes. The gain in
   log-likelihood on all validation data has to be positive and significant. The prediction of all channels may not be
   worse than without the effect, nor than that of the nominal model; with a nonparametric effect it has to be better.
   Without validation runs, blocks in time of the estimation runs are predicted by the fit to the other blocks.
5. Repeat. After a nonparametric curve only parametric effects with a large gain are added.
6. Leave each effect out again (backward elimination). Remove each effect that the validation data do not support
   beside the others. After a removal, also remove the last effects as long as the prediction is worse than that of
   the nominal model.

Kristensen, Madsen and Jorgensen 2004; Engle 1984.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident.data import ORIGIN, LogSegment, Record, far_apart, make_record
from seatrial.ident.diagnosis.acceptance import Comparison, comparison, validation_mismatches
from seatrial.ident.diagnosis.adequacy import assess_alternatives
from seatrial.ident.diagnosis.candidates import normal_equations, variables, wave_peak_score
from seatrial.ident.diagnosis.importance import effect_importance, fit_without
from seatrial.ident.diagnosis.results import (
    T_VALIDATION,
    Diagnosis,
    EffectAttribution,
    EffectImportance,
    Outcome,
    Refit,
    RemovedEffect,
    Round,
    ShortData,
    UntestedCandidate,
    helps,
)
from seatrial.ident.diagnosis.score_test import (
    Score,
    fitted_parameters,
    prior_terms,
    score_test_passes,
    score_tests,
    score_threshold,
)
from seatrial.ident.effects import NonparametricForce, catalogue, input_response_effects, nonparametric_effect, shape
from seatrial.ident.engine import quick_compilation
from seatrial.ident.estimation import (
    AT_BOUND,
    FIT_ERRORS,
    ROUGH_SEARCH,
    VAGUE,
    FittedModel,
    ValidationData,
    between_runs,
    cross_validated,
    cut_into_blocks,
    fit_and_evaluate,
    fit_with_rescaling,
    missing_inputs,
    nominal_model,
    validated_in_blocks,
    validation_records,
    with_all_candidates,
    without_absent_sensors,
    without_unknown_noise,
)
from seatrial.ident.model import Effect, EffectKind, ForceCurve, Model, Parameter
from seatrial.ident.models import residuals_of, scale_priors, size_of, variables_of
from seatrial.ident.reporter import QUIET, Reporter
from seatrial.ident.validation import (
    PredictionChange,
    PredictionEvaluation,
    SmoothedForce,
    evaluate,
    prediction_changes,
    smoothed_forces,
)


@dataclass(frozen=True)
class DiagnosisEvaluation:
    """Predictions of the models of a diagnosis, computed once before any report.

    Attributes
    ----------
    before, after
        Evaluation of the model without and with the effects.
    changes
        Change of the prediction errors over the horizon, by role.
    forces_before, forces_after
        Smoothed disturbance forces of both models.
    in_blocks
        Effects with per-record parameters. If there are any, the validation runs are predicted in blocks of time, with
        the estimates of the other blocks of each run.
    """

    before: PredictionEvaluation
    after: PredictionEvaluation
    changes: Mapping[str, PredictionChange]
    forces_before: tuple[SmoothedForce, ...]
    forces_after: tuple[SmoothedForce, ...]
    in_blocks: tuple[Effect, ...] = ()


def evaluate_diagnosis(diagnosis: Diagnosis, horizon: float | None = None) -> DiagnosisEvaluation:
    """Evaluate the predictions of the models of a diagnosis.

    Parameters
    ----------
    diagnosis
        The diagnosis.
    horizon
        Prediction horizon [s], by default that of the model.
    """
    before_stage, after_stage = diagnosis.before, diagnosis.after
    per_record = tuple(r.effect for r in diagnosis.effects if any(p.per_record for p in r.effect.parameters))
    per_record = () if before_stage.cross_validated or not before_stage.validation else per_record
    # The effects were accepted on blocks too. Otherwise the data that they were fitted to would judge them.
    if per_record:
        before_stage, after_stage = validated_in_blocks(before_stage), validated_in_blocks(after_stage)
    before = evaluate(before_stage, horizon)
    after = before if after_stage is before_stage else evaluate(after_stage, horizon)
    forces = residuals_of(diagnosis.before.model)
    return DiagnosisEvaluation(
        before,
        after,
        prediction_changes(before, after),
        smoothed_forces(diagnosis.before, forces),
        smoothed_forces(diagnosis.after, forces),
        per_record,
    )


N_REFITS, N_NONPARAMETRIC = 4, 2  # parametric and nonparametric candidates that are refitted in a round
N_BATCHES = 2  # batches of parametric candidates; the second is tried if the first has no accepted refit
INDISTINGUISHABLE = 2.0  # in BIC; a smaller difference is "not worth more than a bare mention" (Kass and Raftery 1995)
MAX_LOSS = 1.0  # in 2 ln L, loss of a larger model by rounding of the search
MIN_BLOCKS = 20  # blocks of estimation data (100 s for a boat); with fewer no effect is identified
# Blocks of validation data (40 s for a boat). Two of them are one block of the gain; with fewer, t > 2 is often chance.
MIN_VALIDATION_BLOCKS = 8
MIN_SCORE_RATIO = 0.05  # of the best score: a refit gains up to ten times its score, not twenty times
# The difference between the true form of an effect and that of the catalogue resembles other, much smaller effects.
# Those are not added.
MIN_GAIN_RATIO = 0.02  # of the largest gain so far; an effect that improves the prediction enough needs no such gain
MAX_RATIO_OF_SMALL = 0.98  # ratio of the prediction errors with to without a small effect, for this exception
# The difference between a true curve and its spline gains up to a fifteenth of the curve. Most other missing effects
# gain a third or more.
MIN_GAIN_RATIO_AFTER_CURVE = 0.1  # of the largest gain so far


def diagnose(
    model: Model,
    estimation: Sequence[LogSegment],
    validation: Sequence[LogSegment],
    *,
    effects: Mapping[str, Effect] | None = None,
    max_effects: int = 3,
    rate: float = 10.0,
    reporter: Reporter = QUIET,
) -> Diagnosis:
    """Find effects that a model lacks.

    Parameters
    ----------
    model
        Model to diagnose.
    estimation
        Runs that the parameters are fitted to.
    validation
        Runs that judge the effects. If they are missing, blocks in time of the estimation runs take their place.
    effects
        Candidates by name, by default the whole catalogue.
    max_effects
        Largest number of added effects.
    rate
        Rate of the records' rows [Hz].
    reporter
        Receiver of progress messages.

    Returns
    -------
    Diagnosis
        Models without and with the effects, rounds of the search, attribution and importance.

    Raises
    ------
    ValueError
        If a run lacks a signal that the model needs, or if the model has no residual forces to test. The latter holds
        for models that are neither a hull with the forces X, Y and N nor a thruster on the bench.
    """
    if not residuals_of(model):
        raise ValueError(
            f"model {model.name} cannot be diagnosed: it lacks a hull with the forces X, Y and N; fit "
            "the horizontal model instead"
        )
    full = nominal_model(model)
    requested = catalogue() if effects is None else effects
    candidates = {n: e for n, e in requested.items() if full.accepts(e)}
    accepted = set(candidates)
    failed = validation_records(full, validation, rate)[1]
    usable = [r for r in validation if r.name not in {f.record for f in failed}]
    if _far_apart([*estimation, *usable]):
        candidates = {n: e for n, e in candidates.items() if not e.fixed_point}
    everything, candidates = with_all_candidates(full, candidates, [*estimation, *usable])
    untested = accepted - set(candidates)
    records = [make_record(everything, r, rate) for r in estimation]
    runs = [make_record(everything, r, rate) for r in usable]
    runs = without_unknown_noise(full, records, runs)
    full = without_absent_sensors(full, records)
    reporter.progress(f"fitting {full.name} with disturbance forces to {counted(len(records), 'run')}")
    before, validation_data = _first_fit(full, records, runs)
    size, in_catalogue = size_of(before.fit.model), catalogue()
    # user-defined effects keep their priors
    candidates = {n: scale_priors(e, size) if in_catalogue.get(n) is e else e for n, e in candidates.items()}
    candidates |= between_runs(before.fit)
    search = _Search(records, validation_data, candidates, reporter)
    current, passed = search.forward(before, max_effects)
    reporter.progress("computing the importance of the effects found")
    current, weights, removed = search.backward_elimination(before, current)
    if removed:  # the last scores are those of a larger model
        passed = search.scored(current)[1]
    gone = {r.effect.name for r in removed}
    kept = [r for r in search.rounds if r.chosen is None or r.chosen.effect.name not in gone]
    order = [w.effect for w in weights]
    judgements = assess_alternatives(
        kept, passed, search.n, untested, weights, _reservations(before, current), current,
        search.rounds[0].scores if search.rounds else (),
    )  # fmt: skip
    judgements = tuple(sorted(judgements, key=lambda j: order.index(j.effect)))
    shapes, undrawn = _shapes(before, kept, judgements, records)
    return Diagnosis(
        before=before,
        after=current,
        rounds=tuple(search.rounds),
        remaining=tuple(passed),
        curves=tuple(shapes),
        attributions=judgements,
        importances=weights,
        removed=tuple(removed),
        failed_runs=(*failed, *before.failed, *(f for f in current.failed if f not in before.failed)),
        mismatches=validation_mismatches(current),
        short_data=_short_data(search.scores, before),
        curve_failure=undrawn,
        untestable=_refused(full, requested, [*estimation, *usable]),
        scores=tuple(search.scores),
        untried_scores=tuple(search.untried),
    )


def _far_apart(runs: Sequence[LogSegment]) -> bool:
    """Return whether the runs are too far apart for one common origin."""
    return far_apart([run.meta.get(ORIGIN) for run in runs])


def _refused(
    model: Model, requested: Mapping[str, Effect], runs: Sequence[LogSegment]
) -> tuple[UntestedCandidate, ...]:
    """Return the candidates that cannot be tested, and why.

    User-defined candidates are always listed. Candidates of the catalogue, many of which do not concern a model, are
    listed only if they are at a fixed point and the logs have no common frame.
    """
    in_catalogue, found = catalogue(), []
    if _far_apart(runs):
        apart = "it acts at a fixed point over ground, and the logs are too far apart for one origin of x and y"
        found = [UntestedCandidate(e, apart) for e in requested.values() if e.fixed_point and model.accepts(e)]
    user_defined = [e for name, e in requested.items() if in_catalogue.get(name) is not e]
    for effect in user_defined:
        if effect in [u.effect for u in found]:
            continue
        reason = model.refusal(effect)
        lacking = ((run, missing_inputs(model, effect, run)) for run in runs if reason is None)
        reason = next((f"{run.name} lacks its input {min(names)}" for run, names in lacking if names), reason)
        if reason is not None:
            found.append(UntestedCandidate(effect, reason))
    return tuple(found)


def _short_data(scores: Sequence[Score], fitted: FittedModel) -> ShortData | None:
    """Return the number of candidates that could not pass for any size because of too few blocks of time."""
    short = [s for s in scores if s.blocks < s.least_blocks]
    if not short:
        return None
    needed = max(s.least_blocks for s in short) * fitted.model.block
    return ShortData(sum(r.duration for r in fitted.records), needed, len(short), len(scores))


def _first_fit(full: Model, records: list[Record], runs: list[Record]) -> tuple[FittedModel, ValidationData]:
    """Fit the nominal model, and return the data that validate it.

    These are the validation runs, or blocks in time of the estimation runs if no validation run can be evaluated.
    """
    fitted = fit_with_rescaling(full, records, runs)
    if fitted.validation:
        return fitted, runs
    blocks = cut_into_blocks(records, fitted.estimation, full.block)
    return cross_validated(fitted, blocks), blocks


def _reservations(before: FittedModel, after: FittedModel) -> list[str]:
    """Return the reasons why no effect can be identified on these data."""
    reasons = [
        f"the fit {which} it did not converge"
        for which, s in (("without", before), ("with", after))
        if not s.fit.converged
    ]
    seconds = sum(r.duration for r in after.records)
    if seconds < MIN_BLOCKS * after.model.block:
        reasons.append(f"the estimation data are short ({seconds:.0f} s)")
    validation_data = sum(v.record.duration for v in after.validation)
    if validation_data < MIN_VALIDATION_BLOCKS * after.model.block:
        reasons.append(f"the validation data are short ({validation_data:.0f} s)")
    return reasons


def score_all(
    fitted: FittedModel, records: Sequence[Record], candidates: Mapping[str, Effect]
) -> tuple[list[Score], list[Score]]:
    """Compute all score tests on a fitted model.

    Parameters
    ----------
    fitted
        The fitted model.
    records
        Estimation data with the inputs of all candidates.
    candidates
        Parametric candidates by name.

    Returns
    -------
    tuple of list of Score
        All scores, best first, and those that pass. Of a scanned effect only the best score is returned.
    """
    model = fitted.model
    # A parameter at its bound cannot change to explain a part of a candidate, so it is not projected out.
    stuck = {n for n, flag in fitted.fit.flags if flag in (AT_BOUND, VAGUE)}
    free_parameters = [p for p in fitted_parameters(model, len(records)) if p.full_name not in stuck]
    normal, places = normal_equations(fitted, records, list(candidates.values()), free_parameters)
    at = np.array([fitted.fit.estimate(p.name, p.segment or 0)[0] for p in free_parameters])
    scores = score_tests(normal, prior_terms(free_parameters, at), places)
    waves = wave_peak_score(fitted) if "waves" in candidates else None
    scores += [] if waves is None else [waves]
    n = sum(r.n_rows for r in records)
    scores.sort(key=lambda s: -s.criterion(n))
    first: dict[str, Score] = {}
    for s in scores:
        first.setdefault(s.name, s)
    best = [replace(s, threshold=score_threshold(s, scores)) for s in first.values()]
    return best, [s for s in best if score_test_passes(s, scores)]


class _Search:
    """Forward selection and backward elimination: their data, and the rounds so far."""

    def __init__(
        self,
        records: Sequence[Record],
        validation_data: ValidationData,
        candidates: Mapping[str, Effect],
        reporter: Reporter,
    ) -> None:
        self.records, self.validation_data, self.candidates, self.reporter = (
            records,
            validation_data,
            dict(candidates),
            reporter,
        )
        self.rounds: list[Round] = []
        self.nominal: FittedModel | None = None
        self.scores: list[Score] = []  # of all candidates on the last model
        self.untried: list[Score] = []  # scores that passed when the largest number of effects had been added
        self.n = sum(r.n_rows for r in records)

    def scored(self, fitted: FittedModel) -> tuple[list[Score], list[Score]]:
        """Return all scores on a model, and those that pass.

        Raises
        ------
        ValueError
            If the residuals of the model cannot be tested.
        """
        try:
            self.scores, passed = score_all(fitted, self.records, self.candidates)
            return self.scores, passed
        except np.linalg.LinAlgError as problem:
            names = ", ".join(r.name for r in self.records)
            message = f"the residuals of model {fitted.model.name} cannot be tested"
            raise ValueError(f"{names}: {message}: {problem}; the fit {fitted.fit.message}") from problem

    def forward(self, before: FittedModel, max_effects: int) -> tuple[FittedModel, list[Score]]:
        """Add effects one after the other; return the last model and the scores that pass on it."""
        self.nominal, current, unknown = before, before, False
        while True:
            scores, passed = self.scored(current)
            largest = max((r.chosen.criterion for r in self.rounds if r.chosen is not None), default=0.0)
            least = MIN_GAIN_RATIO_AFTER_CURVE * largest
            tried = [s for s in passed if not s.nonparametric and s.criterion(self.n) > least] if unknown else passed
            if len(self.rounds) >= max_effects or not tried:
                self.untried = tried
                return current, passed
            self.reporter.progress(
                f"round {len(self.rounds) + 1}: {len(passed)} of {len(scores)} candidates pass, best {tried[0].name}"
            )
            found = self._round(current, scores, tried)
            self.rounds.append(found)
            if found.chosen is None:
                return current, passed
            current, unknown = found.chosen.fitted, unknown or found.chosen.nonparametric
            self.candidates.pop(found.chosen.effect.name, None)

    def backward_elimination(
        self, before: FittedModel, current: FittedModel
    ) -> tuple[FittedModel, tuple[EffectImportance, ...], list[RemovedEffect]]:
        """Leave each effect out in turn and remove the least supported effect, until all effects are supported.

        If the remaining effects predict worse than the nominal model after a removal, the last effect is removed too.
        An effect is kept if the model without it cannot be fitted, because its importance is then unknown.
        """
        removed: list[RemovedEffect] = []
        stuck: dict[str, str] = {}
        while True:
            gone = {r.effect.name for r in removed}
            chosen = [r.chosen for r in self.rounds if r.chosen is not None and r.chosen.effect.name not in gone]
            weights = effect_importance(before, current, chosen, self.rounds, self.records, self.validation_data)
            weights = tuple(replace(w, untested=stuck.get(w.effect, w.untested)) for w in weights)
            tested = [w for w in weights if w.untested is None]
            curves = {c.effect.name for c in chosen if c.nonparametric}
            idle_curves = {w.effect for w in tested if not (w.improves_prediction or helps(w.prediction))} & curves
            idle = min(
                (w for w in tested if not w.supported or w.effect in idle_curves), key=lambda w: w.t, default=None
            )
            if idle is None and removed and chosen and Comparison(before, current).prediction.verdict == "rose":
                idle = next((w for w in tested if w.effect == chosen[-1].effect.name), None)
            if idle is None:
                return current, weights, removed
            assert idle.prediction is not None
            effect = next(c.effect for c in chosen if c.effect.name == idle.effect)
            self.reporter.progress(f"fitting without {effect.title}, which is not worth its parameters")
            try:
                current = fit_without(before, current, chosen, effect, self.records, self.validation_data)
            except FIT_ERRORS as problem:
                stuck[idle.effect] = str(problem)
                continue
            removed.append(RemovedEffect(effect, idle.validation_gain, idle.t, idle.prediction))
            if (
                not effect.kind.nonparametric
            ):  # the last score tests include every parametric effect that the model lacks
                self.candidates[effect.name] = effect

    def _round(self, current: FittedModel, scores: list[Score], passed: list[Score]) -> Round:
        """Refit the best candidates that passed, and choose the refit to add."""
        specific = [s for s in passed if not s.nonparametric]
        # If the best criterion is negative, no candidate is dropped: a refit can gain more than its score.
        if specific and (best := specific[0].criterion(self.n)) > 0:
            specific = [s for s in specific if s.criterion(self.n) > MIN_SCORE_RATIO * best]
        refits: list[Refit] = []
        untested: list[UntestedCandidate] = []
        for first in range(0, N_REFITS * N_BATCHES, N_REFITS):
            batch = specific[first : first + N_REFITS]
            self._refit_all(current, [(self.candidates[s.name], s) for s in batch], refits, untested)
            if any(r.accepted for r in refits):
                break
        leading = max((r for r in refits if r.accepted), key=lambda r: r.criterion, default=None)
        most, curve = (-np.inf, None) if leading is None else (leading.criterion, leading.effect.parametric_form_of)
        # A nonparametric candidate competes only if its score is high compared with the best accepted parametric
        # refit, or if that effect is one form of the same curve.
        least = max(0.5 * most, most - 50)
        generic = [(s, s.kind is EffectKind.NONPARAMETRIC and s.curve == curve) for s in passed if s.nonparametric]
        unknown = [s for s, same_curve in generic if s.criterion(self.n) > least or same_curve][:N_NONPARAMETRIC]
        self._refit_all(current, [(_unknown(s, current), s) for s in unknown], refits, untested)
        names = tuple(s.name for s in passed)
        refits, chosen = self._choose(current, refits, untested)
        return Round(tuple(scores), names, tuple(refits), chosen, tuple(untested))

    def _choose(
        self, current: FittedModel, refits: list[Refit], untested: list[UntestedCandidate]
    ) -> tuple[list[Refit], Refit | None]:
        """Return the refits with their outcomes, best first, and the best accepted refit, fitted exactly.

        A difference between runs has as many parameters as there are runs, and explains a part of any effect. So it
        comes after the other effects, unless it explains the validation data significantly better than the best of
        them. If the likelihood cannot distinguish effects, the effect with the smallest prediction errors is the best.
        """
        judged: list[Refit] = []
        chosen: Refit | None = None
        for r in sorted(refits, key=lambda r: (r.effect.kind is EffectKind.BETWEEN_RUNS, -r.criterion)):
            if not r.validated:
                r = replace(r, outcome=Outcome.NOT_SUPPORTED if r.criterion <= 0 else Outcome.NOT_VALIDATED)
            elif chosen is None or _tied(r, chosen) or (r.criterion > chosen.criterion and _explains_more(r, chosen)):
                try:
                    r = self._exact(current, r)
                except FIT_ERRORS as problem:
                    untested.append(UntestedCandidate(r.effect, str(problem)))
                    continue
                if r.outcome is not Outcome.ADDED:
                    pass  # the outcome has the reason
                elif chosen is not None and _tied(r, chosen) and not _predicts_better(r, chosen):
                    r = replace(r, outcome=Outcome.OUTRANKED)
                else:
                    judged = [replace(q, outcome=Outcome.OUTRANKED) if q is chosen else q for q in judged]
                    chosen = r
            judged.append(r)
        return sorted(judged, key=lambda r: -r.criterion), chosen

    def _exact(self, current: FittedModel, rough: Refit) -> Refit:
        """Fit a validated refit exactly and judge it by its prediction.

        Raises
        ------
        ValueError
            If the fit fails or does not converge from any initial values.
        """
        again = current.fit.model + rough.effect
        reason = ""
        for begin in (rough.fitted.fit.model, again, again.with_values(_half_values(rough.effect))):
            try:
                fitted = fit_and_evaluate(begin, self.records, self.validation_data)
                compared = comparison(current, fitted, rough.effect)
                (gain, t), prediction = compared.gain, compared.prediction
            except FIT_ERRORS as problem:
                reason = str(problem)
                continue
            if fitted.fit.converged or not current.fit.converged:
                assert self.nominal is not None
                total = prediction if current is self.nominal else Comparison(self.nominal, fitted).prediction
                exact = replace(
                    rough, fitted=fitted, validation_gain=gain, t=t, prediction=prediction, total=total,
                    by_inputs=compared.by_inputs if rough.nonparametric else None,
                )  # fmt: skip
                return replace(exact, outcome=_outcome(exact, [r.chosen for r in self.rounds if r.chosen is not None]))
            reason = f"the fit with the added effect did not converge: it {fitted.fit.message}"
        raise ValueError(reason)

    def _refit_all(
        self,
        current: FittedModel,
        tried: Sequence[tuple[Effect, Score]],
        refits: list[Refit],
        untested: list[UntestedCandidate],
    ) -> None:
        """Refit the current model with each candidate in parallel; append to ``refits`` or ``untested``."""

        def refit(pair: tuple[Effect, Score]) -> Refit | UntestedCandidate:
            return self._refit(current, *pair)

        with ThreadPoolExecutor(2) as pool, quick_compilation(self.n):
            for found in pool.map(refit, tried):
                if isinstance(found, Refit):
                    refits.append(found)
                else:
                    untested.append(found)

    def _refit(self, current: FittedModel, effect: Effect, score: Score) -> Refit | UntestedCandidate:
        """Fit the current model with an effect.

        The initial values are tried in turn until a fit loses no likelihood; otherwise the best fit is returned.

        A larger model cannot be worse than the model that it contains. A fit that is worse has stopped early.
        """
        self.reporter.progress(f"refitting with {effect.title}")
        best, reason = None, ""
        for start in _starts(effect, score):
            try:
                fitted = fit_and_evaluate(
                    current.fit.model + start, self.records, self.validation_data, settings=ROUGH_SEARCH
                )
                gain = 2 * (fitted.fit.log_posterior - current.fit.log_posterior)
                total, t = comparison(current, fitted, effect).gain
            except FIT_ERRORS as problem:
                reason = reason or str(problem)
                continue
            df = sum(_degrees(effect, p, len(self.records)) for p in effect.parameters if p.free)
            found = Refit(effect, fitted, gain, df, gain - df * float(np.log(self.n)), total, t)
            best = found if best is None or found.gain > best.gain else best
            if best.gain > -MAX_LOSS:
                break
        return UntestedCandidate(effect, reason) if best is None else best


def _outcome(exact: Refit, added: Sequence[Refit]) -> Outcome:
    """Return the outcome of an exact refit after the effects that were ``added``.

    A small effect is left out with two exceptions: the prediction needs the effect, or the effect and a strong effect
    are declared alternatives. In the latter case the strong effect may not explain all.
    """
    assert exact.prediction is not None
    if not exact.validated:
        return Outcome.NOT_VALIDATED
    if not exact.accepted:
        worse = "rose" in {p.verdict for p in (exact.prediction, exact.total) if p is not None}
        return Outcome.WORSE_PREDICTION if worse else Outcome.NO_BETTER_PREDICTION
    needed = exact.prediction.verdict == "fell" and exact.prediction.ratio < MAX_RATIO_OF_SMALL
    alternative = any(
        exact.effect.name in r.effect.alternatives or r.effect.name in exact.effect.alternatives for r in added
    )
    largest = max((r.criterion for r in added), default=0.0)
    return Outcome.ADDED if needed or alternative or exact.criterion > MIN_GAIN_RATIO * largest else Outcome.SMALL


def _tied(first: Refit, second: Refit) -> bool:
    """Return whether the likelihood cannot distinguish two effects."""
    parametric = not (first.nonparametric or second.nonparametric or first.effect.kind is EffectKind.BETWEEN_RUNS)
    return parametric and abs(first.criterion - second.criterion) < INDISTINGUISHABLE


def _predicts_better(first: Refit, second: Refit) -> bool:
    """Return whether the first exact refit has smaller prediction errors over the horizon than the second."""
    assert first.prediction is not None
    assert second.prediction is not None
    return first.prediction.ratio < second.prediction.ratio


def _explains_more(difference: Refit, other: Refit) -> bool:
    """Return whether a difference between runs explains the validation data significantly better than an effect."""
    if difference.effect.kind is not EffectKind.BETWEEN_RUNS:
        return False
    try:
        compared = comparison(other.fitted, difference.fitted, difference.effect)
        gain, t = compared.gain
    except FIT_ERRORS:
        return False
    return gain > 0 and t > T_VALIDATION and compared.prediction.verdict != "rose"


def _half_values(effect: Effect) -> dict[str, float]:
    """Halve the initial values of the shared parameters, clipped to their bounds."""
    return {p.name: min(max(0.5 * p.value, p.bounds[0]), p.bounds[1]) for p in effect.parameters if not p.per_record}


def _degrees(effect: Effect, parameter: Parameter, n_records: int) -> int:
    """Return the degrees of freedom of a parameter of an effect.

    A difference between runs has one less than there are records, because the model contains the mean.
    """
    if not parameter.per_record:
        return 1
    return n_records - 1 if effect.kind is EffectKind.BETWEEN_RUNS else n_records


def _starts(effect: Effect, score: Score) -> Iterator[Effect]:
    """Yield the effect with different initial values.

    The first are the one-step estimates of the score test. Then follow smaller values, the neighbours of a scanned
    value, and values of the opposite sign. The last is zero, from which an ascent cannot lose likelihood.
    """
    scans = [score.scan]
    for name, values in effect.scan.items():
        at = values.index(score.scan[name]) if score.scan.get(name) in values else 0
        scans += [score.scan | {name: values[k]} for k in (at - 1, at + 1) if 0 <= k < len(values)]
    for scan, share in [
        (scans[0], 1.0),
        (scans[0], 0.3),
        *((s, 1.0) for s in scans[1:]),
        (scans[0], -0.3),
        (scans[0], 0.0),
    ]:
        yield replace(effect, parameters=tuple(_start(p, score, scan, share) for p in effect.parameters))


def _start(parameter: Parameter, score: Score, scan: Mapping[str, float], share: float) -> Parameter:
    """Return a parameter with its initial value: ``share`` of the one-step estimate, limited by prior and bounds."""
    value = scan.get(parameter.name, parameter.value)
    if parameter.name in score.step:
        sd = parameter.prior[1] if parameter.prior else np.inf
        value = parameter.value + share * float(np.clip(score.step[parameter.name], -sd, sd))
        low, high = parameter.bounds
        value = min(max(value, low), high)
    return parameter.at(value)


def _unknown(score: Score, fitted: FittedModel) -> Effect:
    """Return the nonparametric effect of a score, with priors scaled to the size of the boat."""
    assert score.curve is not None
    size, tested = size_of(fitted.fit.model), (score.kind, score.curve)
    for effect in input_response_effects(fitted.model):
        if (effect.kind, effect.curve) == tested:
            return scale_priors(effect, size)
    return scale_priors(nonparametric_effect(fitted.model, score.curve, _span(fitted, score.curve)), size)


def _span(fitted: FittedModel, curve: ForceCurve) -> tuple[float, float]:
    """Return the interval of a curve's variable: 1 % to 99 % of its values, or a full turn for angles and products."""
    if curve.second or curve.variable in {v.name for v in variables_of(fitted.model) if v.angle}:
        return -np.pi, np.pi
    found = [variables(fitted.model, v.record, v.run.x_filt, v.values) for v in fitted.estimation]
    z = np.concatenate([by_name[curve.variable] for by_name in found])
    low, high = np.percentile(z, [1, 99])
    return float(low), float(high)


def _shapes(
    before: FittedModel, rounds: Sequence[Round], judgements: Sequence[EffectAttribution], records: Sequence[Record]
) -> tuple[list[NonparametricForce], str | None]:
    """Return the nonparametric curves for the report, and why one of them could not be fitted.

    The curves are those of the selected nonparametric effects, and of the residual in place of the first ambiguous
    effect. The latter only illustrates the result, so a failed fit of this curve is no error.
    """
    found, current, undrawn = [], before, None
    chosen = [r for r in rounds if r.chosen is not None]
    first = next((j.effect for j in judgements if j.attribution == "ambiguous"), None)
    for search_round, r in ((s, s.chosen) for s in chosen if s.chosen is not None):
        if r.nonparametric:
            found.append(_drawn(r.effect, r.fitted))
        elif r.effect.name == first and (likely := _likely_curve(search_round)):
            try:
                effect = _unknown(likely, current)
                found.append(_drawn(effect, fit_and_evaluate(current.fit.model + effect, records, ())))
            except FIT_ERRORS as problem:
                undrawn = f"{r.effect.title}: {problem}"
        current = r.fitted
    drawn: dict[tuple[str, str], NonparametricForce] = {}
    for s in found:
        if s is not None:  # the first curve of a variable is complete; later curves lack the part of added effects
            drawn.setdefault((s.force, s.variable), s)
    return list(drawn.values()), undrawn


def _likely_curve(search_round: Round) -> Score | None:
    """Return the best score of a residual as a function of one variable, None if none passed."""
    curves = [s for s in search_round.scores if s.kind is EffectKind.NONPARAMETRIC and s.name in search_round.passed]
    return next((s for s in curves if s.curve is not None and not s.curve.second), None)


def _drawn(effect: Effect, fitted: FittedModel) -> NonparametricForce | None:
    """Return the curve of a nonparametric effect with its standard errors, None if it cannot be drawn."""
    f = fitted.fit
    return shape(f.model, effect, f.model.values, f.names, f.covariance)
