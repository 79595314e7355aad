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

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident.data import ORIGIN, LogSegment, Record, far_apart, make_record
from seatrial.ident.diagnosis.acceptance import (
    Comparison,
    comparison,
    is_accepted,
    is_validated,
    refit_outcome,
    removal_reason,
    should_be_removed,
    validation_mismatches,
    whole_run_comparison,
)
from seatrial.ident.diagnosis.adequacy import (
    AttributionEvidence,
    assess_alternatives,
    depends_on_remaining_tests,
)
from seatrial.ident.diagnosis.candidates import normal_equations, variables, wave_peak_score
from seatrial.ident.diagnosis.common_errors import (
    COMMON_SEARCH,
    ROUGH_COMMON_SEARCH,
    common_errors_for,
    fit_common_errors,
    given_common_errors,
    is_error_of_motion_sensor,
    nested_in,
    prior_information,
    score_common_errors,
    with_forms,
)
from seatrial.ident.diagnosis.findings import (
    CommonErrorsFit,
    Diagnosis,
    EffectAttribution,
    EffectImportance,
    ModelUncertainty,
    Outcome,
    Refit,
    RejectedCommonErrors,
    RemovedEffect,
    Round,
    ShortData,
    UntestedCandidate,
)
from seatrial.ident.diagnosis.importance import RoughFits, by_importance, effect_importance, fit_without
from seatrial.ident.diagnosis.model_uncertainty import model_uncertainty, with_model_uncertainty
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY, SearchPolicy
from seatrial.ident.diagnosis.progress import with_times, work_of
from seatrial.ident.diagnosis.score_test import (
    Score,
    ScoreEquations,
    fitted_parameters,
    prior_terms,
    score_test_passes,
    score_tests,
    score_threshold,
)
from seatrial.ident.effects import NonparametricForce, catalogue, input_response_effects, nonparametric_effect, shape
from seatrial.ident.engine import LargerModel, common_kernels, quick_compilation
from seatrial.ident.estimation import (
    AT_BOUND,
    FIT_ERRORS,
    ROUGH_SEARCH,
    VAGUE,
    FailedRun,
    Fit,
    FittedModel,
    SearchSettings,
    ValidationData,
    between_runs,
    cross_validated,
    cut_into_blocks,
    fit_and_evaluate,
    fit_with_restarts,
    missing_inputs,
    nominal_model,
    times_of_change,
    unexcited_motion,
    validated_in_blocks,
    validation_records,
    wave_sizes,
    with_all_candidates,
    without_absent_sensors,
    without_unknown_noise,
)
from seatrial.ident.model import Effect, EffectKind, ForceCurve, Model, Parameter, curve_name, segment_name
from seatrial.ident.models import effect_for, residuals_of, scale_priors, sensor_errors_of, size_of, variables_of
from seatrial.ident.reporter import QUIET, Reporter
from seatrial.ident.validation import (
    PredictionChange,
    PredictionEvaluation,
    SmoothedForce,
    evaluate,
    prediction_changes,
    smoothed_forces,
)

WAVES = "waves"
LIKELY_ROUNDS = 0.8  # share of the possible rounds that the time left assumes: most real boats lack several effects
REFITS_AT_ONCE = 2  # in threads
ROUGH_SHARE = 0.01  # of the gain that a score test predicts: tolerance of the refit of its candidate
# Tolerance of the fit beside the remaining candidates: the sizes are then within one standard error of the maximum, and
# those of sure names, of at least 4 standard errors, within the change that is looked for
BESIDE_TOLERANCE = 0.5
DRAWN = SearchSettings(tolerance=0.02)  # for a curve that only illustrates the result: exact to 0.2 standard errors


@dataclass(frozen=True)
class DiagnosisEvaluation:
    """Predictions of the models of a diagnosis, computed once and used by all reports.

    Attributes
    ----------
    before, after
        Evaluation of the model without and with the effects and the added common errors. They are the same object if
        neither an effect nor a common error was added.
    changes
        Change of the prediction errors over the horizon from ``before`` to ``after``, by role of the data
        (``estimation``, ``validation``).
    forces_before, forces_after
        Smoothed disturbance forces of both models, one for each estimation record and force, in the same order.
    in_blocks
        Selected effects with per-record parameters. If there are any, the validation runs are predicted in blocks of
        time, with the estimates of the other blocks of each run. Empty without validation runs.
    """

    before: PredictionEvaluation
    after: PredictionEvaluation
    changes: Mapping[str, PredictionChange]
    forces_before: tuple[SmoothedForce, ...]
    forces_after: tuple[SmoothedForce, ...]
    in_blocks: tuple[Effect, ...] = ()


def evaluate_diagnosis(diagnosis: Diagnosis, horizon: float | None = None) -> DiagnosisEvaluation:
    """Evaluate the predictions of the models of a diagnosis: simulations, prediction errors and smoothed forces.

    If a selected effect has per-record parameters and there are validation runs, both models are first evaluated on
    blocks in time of the validation runs. A cross-validated diagnosis has no validation runs, so it is not changed. The
    smoothed forces are those of the estimation records in each case.

    Parameters
    ----------
    diagnosis
        The diagnosis.
    horizon
        Prediction horizon [s], by default that of the model (10 s, on the bench 1 s).

    Returns
    -------
    DiagnosisEvaluation
        ``after`` is the same object as ``before`` if no effect and no common error was added.
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


def diagnose(
    model: Model,
    estimation: Sequence[LogSegment],
    validation: Sequence[LogSegment],
    *,
    effects: Mapping[str, Effect] | None = None,
    max_effects: int = 3,
    rate: float = 10.0,
    reporter: Reporter = QUIET,
    policy: SearchPolicy = DEFAULT_POLICY,
) -> Diagnosis:
    """Find effects that a model lacks.

    Parameters
    ----------
    model
        Model to diagnose.
    estimation
        Runs that the parameters are fitted to.
    validation
        Runs that judge the effects. Runs that cannot be evaluated are left out and listed in the findings. If none is
        left, blocks in time of the estimation runs take their place.
    effects
        Candidates by name, by default the whole catalogue. Those that the model does not accept are not tested.
    max_effects
        Largest number of rounds, and so of added effects.
    rate
        Rate of the records' rows [Hz].
    reporter
        Receiver of progress messages. Each step has the time so far and the time left (`SearchProgress`).
    policy
        Thresholds of the score tests, the search, the acceptance and the attribution.

    Returns
    -------
    Diagnosis
        Models without and with the effects, rounds of the search, attribution and importance.

    Raises
    ------
    ValueError
        If an estimation run lacks a signal that the model needs, if the model cannot be fitted without the effects, if
        the score tests cannot be computed, or if the model has no residual forces to test: it is neither a vehicle with
        a hull, nor a Nomoto model, nor a thruster on the bench.
    """
    reporter = with_times(reporter)
    start = _prepared_search(model, estimation, validation, effects, rate, reporter, policy)
    before, records, validation_data = start.before, start.records, start.validation_data
    search = _Search(records, validation_data, start.candidates, reporter, policy, start.common)
    if given := given_common_errors(before.fit.model, policy):
        search.keep_common_errors(CommonErrorsFit(given, before))
    with common_kernels() as search.larger_models:
        base, current, passed, weights, removed = search.run(before, max_effects)
    search.work.ahead.clear()  # no further rounds and removals
    search.work.plan("evaluation", 3, 3)
    gone = {r.effect.name for r in removed}
    kept = [r for r in search.rounds if r.chosen is None or r.chosen.effect.name not in gone]
    order = [w.effect for w in weights]
    # The size of an effect is judged by standard errors that include what the model still lacks.
    uncertainty = search.uncertainty(passed, current.fit)
    widened = replace(current, fit=with_model_uncertainty(current.fit, uncertainty))
    evidence = AttributionEvidence(
        remaining=passed,
        n=search.n,
        untested=start.untested,
        importances=weights,
        reservations=_reservations(before, current, search.policy),
        after=widened,
        nominal=search.rounds[0].scores if search.rounds else (),
    )
    # This fit takes a tenth of the time of a diagnosis. It changes nothing for effects that are ambiguous anyway.
    if search.common_errors is not None and depends_on_remaining_tests(kept, evidence, search.policy):
        reporter.progress("fitting the effects found beside the strongest of the other candidates")
        with search.work.timed("evaluation"):
            unaffected, beside = search.unaffected_by(current, passed)
        evidence = replace(evidence, unaffected=unaffected, beside=beside)
    search.work.plan("evaluation", 2, 2)
    reporter.progress("comparing the effects found with their alternatives, and their curves")
    judgements = assess_alternatives(kept, evidence, search.policy)
    judgements = tuple(sorted(judgements, key=lambda j: order.index(j.effect)))
    with search.work.timed("evaluation"):
        shapes, undrawn = _reported_curves(base, kept, judgements, records, search.nonparametric_effect)
    return Diagnosis(
        before=widened if current is before else before,
        after=widened,
        rounds=tuple(search.rounds),
        remaining=tuple(passed),
        curves=tuple(shapes),
        attributions=judgements,
        importances=weights,
        removed=tuple(removed),
        failed_runs=(*start.failed, *before.failed, *(f for f in current.failed if f not in before.failed)),
        mismatches=validation_mismatches(current, search.policy),
        short_data=_short_data(search.scores, before, search.policy),
        uncertainty=uncertainty,
        curve_failure=undrawn,
        untestable=start.untestable,
        refuted=start.refuted,
        scores=tuple(search.scores),
        untried_scores=tuple(search.untried),
        policy=search.policy,
        common_errors=search.common_errors,
        rejected_common_errors=search.rejected_common_errors,
        untried_waves=_untried_waves(search, current),
        own_effects=tuple(name for name in effects or () if name not in catalogue()),
    )


def _untried_waves(search: _Search, current: FittedModel) -> float | None:
    """Return the frequency [Hz] of the waves that the innovations of the last model show and the search did not try.

    None if the innovations have no significant spectral peak, or if waves were a candidate or not requested.
    """
    score = None if search.waves is None else wave_peak_score(current, search.policy)
    return None if score is None else score.scan["f_wave"]


@dataclass(frozen=True)
class ModelAssessment:
    """Result of the score tests of a model without a search for missing effects.

    Attributes
    ----------
    nominal
        Fit of the model without common errors.
    common_errors
        Fit with the common errors (timing and mounting of sensors, hull form). None if they were not added, for example
        because the data do not need them or the model has them already.
    uncertainty
        Shifts of the estimates by the candidates that still pass; None if there is nothing to add.
    rejected_common_errors
        Common errors that the score tests selected and that were not added. None if there are none.
    """

    nominal: FittedModel
    common_errors: CommonErrorsFit | None
    uncertainty: ModelUncertainty | None
    rejected_common_errors: RejectedCommonErrors | None = None


def assess_model(
    model: Model,
    estimation: Sequence[LogSegment],
    validation: Sequence[LogSegment],
    *,
    rate: float = 10.0,
    reporter: Reporter = QUIET,
    policy: SearchPolicy = DEFAULT_POLICY,
) -> ModelAssessment | None:
    """Fit a model, add the common errors that it needs, and compute how missing effects may shift its estimates.

    The score tests of the catalogue are used, without a search for effects. Common errors are those of every craft:
    timing and mounting of sensors, and hull form. They are added together if at least ``policy.min_common_errors`` of
    them are needed, no parametric effect of the boat that passes its score test explains more than all of them, and the
    data support the fit with them.

    Parameters
    ----------
    model
        Model to fit.
    estimation, validation
        Runs that the parameters are fitted to, and runs that judge the common errors.
    rate
        Rate of the records' rows [Hz].
    reporter
        Receiver of progress messages.
    policy
        Thresholds of the score tests and the acceptance.

    Returns
    -------
    ModelAssessment or None
        None if the model has no residual forces to test: it is neither a vehicle with a hull, nor a Nomoto model, nor a
        thruster on the bench.

    Raises
    ------
    ValueError
        If an estimation run lacks a signal that the model needs, if the model cannot be fitted, or if the score tests
        cannot be computed.
    """
    if not residuals_of(model):
        return None
    start = _prepared_search(model, estimation, validation, None, rate, reporter, policy)
    search = _Search(start.records, start.validation_data, start.candidates, reporter, policy, start.common)
    passing = search.scored(start.before)[1]
    extended = search.add_common_errors(start.before, passing)
    if extended is not None:
        passing = search.scored(extended)[1]
    uncertainty = search.uncertainty(passing, (extended or start.before).fit)
    return ModelAssessment(start.before, search.common_errors, uncertainty, search.rejected_common_errors)


@dataclass(frozen=True)
class _SearchStart:
    """Data, candidates and first fit with which a search for missing effects starts.

    Attributes
    ----------
    before
        Fitted model without added effects.
    records, validation_data
        Estimation records, and validation data, with the inputs of all candidates.
    candidates
        Candidates of the score tests by name: the accepted effects that can be tested on all runs (they are not in
        ``untested``), and the differences between runs. The priors of catalogue effects follow the size of the craft.
        User-defined effects keep their priors.
    common
        Common errors (timing and mounting of sensors, hull form) by name.
    failed
        Validation runs that cannot be converted.
    untested
        Names of effects that the model accepts and that are not tested: a run lacks one of their inputs, or they act at
        a fixed point and the runs have no common origin.
    untestable
        User-defined candidates, and candidates at a fixed point, that cannot have a score test, with the reasons.
    refuted
        Candidates that signals of the estimation runs contradict, with the reasons; they are not in ``untested``.
    """

    before: FittedModel
    records: list[Record]
    validation_data: ValidationData
    candidates: dict[str, Effect]
    common: dict[str, Effect]
    failed: tuple[FailedRun, ...]
    untested: set[str]
    untestable: tuple[UntestedCandidate, ...]
    refuted: tuple[UntestedCandidate, ...]


def _prepared_search(
    model: Model,
    estimation: Sequence[LogSegment],
    validation: Sequence[LogSegment],
    effects: Mapping[str, Effect] | None,
    rate: float,
    reporter: Reporter,
    policy: SearchPolicy,
) -> _SearchStart:
    """Convert the runs to records with the inputs of all candidates, and fit the model without effects.

    The parameters are those of `diagnose`, with ``effects`` None for the whole catalogue.

    Raises
    ------
    ValueError
        If an estimation run lacks a signal that the model needs, if the model cannot be fitted, or if the model has no
        residual forces to test.
    """
    if not residuals_of(model):
        raise ValueError(
            f"model {model.name} cannot be diagnosed: it lacks a hull with the forces X, Y and N; fit the model "
            "horizontal:shaft instead"
        )
    full = nominal_model(model)
    requested = catalogue() if effects is None else effects
    candidates = {n: e for n, e in requested.items() if full.accepts(e)}
    refuted = _refuted_candidates(candidates.values(), estimation)
    candidates = {n: e for n, e in candidates.items() if n not in {r.effect.name for r in refuted}}
    accepted = set(candidates)
    failed = validation_records(full, validation, rate)[1]
    usable = [r for r in validation if r.name not in {f.record for f in failed}]
    if _lack_common_origin([*estimation, *usable]):
        candidates = {n: e for n, e in candidates.items() if not e.fixed_point}
    everything, candidates = with_all_candidates(full, candidates, [*estimation, *usable])
    common = common_errors_for(full, candidates)
    for effect in common.values():
        everything = everything if effect.name in candidates else everything + effect
    records = [make_record(everything, r, rate) for r in estimation]
    runs = [make_record(everything, r, rate) for r in usable]
    runs = without_unknown_noise(full, records, runs)
    nominal = without_absent_sensors(full, records)
    reporter.progress(f"fitting {nominal.name} with disturbance forces to {counted(len(records), 'run')}")
    settings = COMMON_SEARCH if given_common_errors(nominal, policy) else None
    with work_of(reporter).timed("start"):
        before, validation_data = _first_fit(nominal, records, runs, settings, reporter)
    in_catalogue = catalogue()
    # user-defined effects keep their priors
    scaled = {n: effect_for(before.fit.model, e) if in_catalogue.get(n) is e else e for n, e in candidates.items()}
    scaled |= between_runs(before.fit)
    return _SearchStart(
        before=before,
        records=records,
        validation_data=validation_data,
        candidates=scaled,
        common={n: scaled.get(n, e) for n, e in common.items()},
        failed=failed,
        untested=accepted - set(candidates),
        untestable=_untestable_candidates(nominal, requested, [*estimation, *usable]),
        refuted=refuted,
    )


def _refuted_candidates(candidates: Iterable[Effect], runs: Sequence[LogSegment]) -> tuple[UntestedCandidate, ...]:
    """Return the candidates that signals of the runs contradict, with the reasons (`Effect.refuted_by`)."""
    channels = [run.channels for run in runs]
    reasons = [(e, e.refuted_by(channels)) for e in candidates if e.refuted_by is not None]
    return tuple(UntestedCandidate(effect, reason) for effect, reason in reasons if reason)


def _lack_common_origin(runs: Sequence[LogSegment]) -> bool:
    """Return whether the logs of the runs are too far apart for one common origin of the positions x and y.

    Logs near each other were moved to one origin when they were loaded. So the logs are too far apart if their runs
    have two or more different origins (`far_apart`). Runs with an unknown origin are ignored.
    """
    return far_apart([run.meta.get(ORIGIN) for run in runs])


def _untestable_candidates(
    model: Model, requested: Mapping[str, Effect], runs: Sequence[LogSegment]
) -> tuple[UntestedCandidate, ...]:
    """Return the requested candidates that cannot have a score test, with the reasons.

    User-defined candidates are listed if the model does not accept them or if a run lacks an input. Candidates of the
    catalogue, many of which do not concern a model, are listed only if they act at a fixed point, the model accepts
    them, and the runs are too far apart for one origin. Each candidate is listed once; the fixed point takes precedence
    over other reasons, and only the first run that lacks an input is named. The result is empty if each candidate can
    be tested.

    Parameters
    ----------
    model
        The nominal model.
    requested
        All candidates by name.
    runs
        Runs of estimation and validation.
    """
    in_catalogue, found = catalogue(), []
    if _lack_common_origin(runs):
        apart = (
            "it acts at a fixed point over ground, and the logs are too far apart for one origin of x and y; diagnose "
            "the logs of each place separately"
        )
        found = [UntestedCandidate(e, apart) for e in requested.values() if e.fixed_point and model.accepts(e)]
    user_defined = [e for name, e in requested.items() if in_catalogue.get(name) is not e]
    for effect in user_defined:
        if effect in [u.effect for u in found]:
            continue
        reason = model.refusal(effect)
        lacking = ((run, missing_inputs(model, effect, run)) for run in runs if reason is None)
        reason = next(
            (
                f"{run.name} lacks its input {min(names)}; leave that log out, or give one with this input"
                for run, names in lacking
                if names
            ),
            reason,
        )
        if reason is not None:
            found.append(UntestedCandidate(effect, reason))
    return tuple(found)


def _short_data(
    scores: Sequence[Score], fitted: FittedModel, policy: SearchPolicy = DEFAULT_POLICY
) -> ShortData | None:
    """Return how many candidates could not pass the block-robust score test because the data are too short.

    With so few blocks of time they could not pass for any size of the effect at the level ``policy.block_level``. The
    weaker level for overwhelming evidence is not considered. None if all candidates could pass.
    ``scores`` are those of all candidates on one model, and ``fitted`` has the estimation records, whose total duration
    is reported.
    """
    short = [s for s in scores if s.blocks < s.least_blocks(policy)]
    if not short:
        return None
    needed = max(s.least_blocks(policy) for s in short) * fitted.model.block
    return ShortData(sum(r.duration for r in fitted.records), needed, len(short), len(scores))


def _first_fit(
    full: Model, records: list[Record], runs: list[Record], settings: SearchSettings | None, reporter: Reporter
) -> tuple[FittedModel, ValidationData]:
    """Fit the nominal model (without effects) to the records; return the fit, and the data that validate it.

    These data are the validation runs. If no validation run can be evaluated, they are blocks in time of the estimation
    runs, and each block is predicted with the fit to the other blocks. ``settings`` are those of the fit; None for the
    default settings. ``reporter`` receives the iterations as details of its present step.
    """
    fitted = fit_with_restarts(full, records, runs, settings=settings, reporter=reporter)
    if fitted.validation:
        return fitted, runs
    blocks = cut_into_blocks(records, fitted.estimation, full.block)
    return cross_validated(fitted, blocks), blocks


def _reservations(before: FittedModel, after: FittedModel, policy: SearchPolicy) -> list[str]:
    """Return the reasons, as clauses for reports, why no effect can be identified on these data.

    The reasons are: a fit without (``before``) or with (``after``) the effects did not converge, the data do not
    determine a mass in the fit of ``before``, the estimation data have fewer blocks than
    ``policy.min_estimation_blocks``, the validation data have fewer than ``policy.min_validation_blocks``. Each reason
    that applies is returned, in this order. The list is empty if none applies.
    """
    reasons = [
        f"the fit {which} the effects did not converge"
        for which, s in (("without", before), ("with", after))
        if not s.fit.converged
    ]
    if (lost := unexcited_motion(before.fit, before.records)) is not None:
        reasons.append(lost.clause)
    seconds = sum(r.duration for r in after.records)
    if seconds < policy.min_estimation_blocks * after.model.block:
        reasons.append(f"the estimation data are short ({seconds:.0f} s)")
    validation_data = sum(v.record.duration for v in after.validation)
    if validation_data < policy.min_validation_blocks * after.model.block:
        reasons.append(f"the validation data are short ({validation_data:.0f} s)")
    return reasons


def score_equations(fitted: FittedModel, records: Sequence[Record], effects: Mapping[str, Effect]) -> ScoreEquations:
    """Set up the score equations of a fitted model: the normal equations of its parameters and of all candidates.

    Parameters
    ----------
    fitted
        The fitted model. Parameters of the noise and parameters at a bound are taken as constant, and so are positive
        ones whose order of magnitude the data do not determine (flag VAGUE: the standard error of the logarithm is
        above 5).
    records
        Estimation data: the records of the fit, in their order, with the inputs of all candidates.
    effects
        Parametric candidates by name. Those that the model does not accept are skipped. The nonparametric ones follow
        from the model and are added: residual forces as smooth functions of one variable or products of two, sensor
        errors and thrust losses as smooth functions of one, and surge force and yaw moment as lagged or resonant
        responses to the thrusters.
    """
    # A parameter at its bound cannot change to explain a part of a candidate, so it is not projected out.
    stuck = {n for n, flag in fitted.fit.flags if flag in (AT_BOUND, VAGUE)}
    free_parameters = [p for p in fitted_parameters(fitted.model, len(records)) if p.full_name not in stuck]
    normal, indices = normal_equations(fitted, records, list(effects.values()), free_parameters)
    at = np.array([fitted.fit.estimate(p.name, p.segment or 0)[0] for p in free_parameters])
    names = tuple(p.full_name for p in free_parameters)
    return ScoreEquations(normal, prior_terms(free_parameters, at), tuple(indices), names)


def score_all(
    fitted: FittedModel,
    records: Sequence[Record],
    candidates: Mapping[str, Effect],
    policy: SearchPolicy = DEFAULT_POLICY,
    equations: ScoreEquations | None = None,
) -> tuple[list[Score], list[Score]]:
    """Compute all score tests on a fitted model.

    Parameters
    ----------
    fitted
        The fitted model.
    records
        Estimation data with the inputs of all candidates.
    candidates
        Parametric candidates by name. The nonparametric ones follow from the model and are added.
    policy
        Thresholds of the score tests.
    equations
        Score equations of the model with the columns of all candidates, None to set them up. Columns of parametric
        effects that are not in ``candidates`` are ignored.

    Returns
    -------
    scores
        One score for each candidate, the largest criterion first, with its threshold. For an effect with scanned
        parameters it is the best score of the scan; all values of the scan count as tests in the threshold. A candidate
        that cannot be tested has no score (`score_tests`). ``waves`` has one only if the innovations have a significant
        spectral peak.
    passing
        The scores that pass, in the same order.
    """
    equations = equations or score_equations(fitted, records, candidates)
    tested = [c for c in equations.indices if c.columns.kind.nonparametric or c.columns.name in candidates]
    scores = score_tests(equations.normal, equations.prior, tested)
    waves = wave_peak_score(fitted, policy) if WAVES in candidates else None
    scores += [] if waves is None else [waves]
    n = sum(r.n_rows for r in records)
    scores.sort(key=lambda s: -s.criterion(n))
    first: dict[str, Score] = {}
    for s in scores:
        first.setdefault(s.name, s)
    best = [replace(s, threshold=score_threshold(s, scores, policy)) for s in first.values()]
    return best, [s for s in best if score_test_passes(s, scores, policy)]


@dataclass(frozen=True)
class _TestedModel:
    """Score tests of a fitted model, kept in case that the search comes back to it.

    Attributes
    ----------
    fitted
        The fitted model.
    tested
        Names of the candidates, and of the common errors that were not in the model.
    policy
        Thresholds of the tests.
    equations
        Score equations.
    scores, passing
        Scores of all candidates, and those that pass; the largest criterion first.
    """

    fitted: FittedModel
    tested: tuple[frozenset[str], frozenset[str]]
    policy: SearchPolicy
    equations: ScoreEquations
    scores: list[Score]
    passing: list[Score]


class SearchOutcome(NamedTuple):
    """Outcome of a search for missing effects.

    Attributes
    ----------
    base
        Model without added effects, but with the common errors.
    model
        Model with the effects.
    passing
        Scores that pass on it, the largest criterion first.
    importances
        Importance of each effect, the most important first.
    removed
        Effects that were added and removed again.
    """

    base: FittedModel
    model: FittedModel
    passing: list[Score]
    importances: tuple[EffectImportance, ...]
    removed: list[RemovedEffect]


class _Search:
    """Forward selection and backward elimination of effects on one set of data.

    Parameters
    ----------
    records
        Estimation data.
    validation_data
        Validation records, or blocks in time of the estimation data.
    candidates
        Parametric candidates by name; copied.
    reporter
        Receiver of progress messages.
    policy
        Thresholds of the search. As soon as the common errors are added, ``policy.min_error_ratio_beside`` replaces the
        error ratios from which a change of the prediction matters.
    common
        Common errors (timing and mounting of sensors, hull form) by name that the model lacks; may be None.

    Attributes
    ----------
    candidates
        Parametric candidates that are not in the model. Effects move out when they are added, and back if removed.
    common
        Common errors that can still be added together; empty as soon as this has been tried.
    common_errors
        Fit with the common errors, None if they have not been added.
    rejected_common_errors
        Common errors that were tried together and not added, None if there are none.
    equations
        Score equations of the last tested model, None before the first.
    rounds
        Rounds so far, in their order.
    nominal
        Model without added effects, None before `forward`.
    scores
        Scores of all candidates on the last tested model, best first.
    untried
        Scores that passed when the largest number of effects had been added, and were not tried.
    removed
        Effects that were added and removed again.
    waves
        Wave forces, if they may become a candidate beside the common errors (`_refit_waves_beside`); else None.
    n
        Number of rows of the estimation data.
    work
        Parts of the search that are done and still ahead, for the time left.
    larger_models
        Models whose kernels serve the refits that they contain. The list is that of a `common_kernels` context.
    """

    def __init__(
        self,
        records: Sequence[Record],
        validation_data: ValidationData,
        candidates: Mapping[str, Effect],
        reporter: Reporter,
        policy: SearchPolicy = DEFAULT_POLICY,
        common: Mapping[str, Effect] | None = None,
    ) -> None:
        self.common = dict(common or {})
        self.common_errors: CommonErrorsFit | None = None  # of the model given, or added
        self.rejected_common_errors: RejectedCommonErrors | None = None
        self.equations: ScoreEquations | None = None
        self.records, self.validation_data, self.candidates = records, validation_data, dict(candidates)
        self.reporter, self.policy, self.work = reporter, policy, work_of(reporter)
        self.rounds: list[Round] = []
        self.nominal: FittedModel | None = None
        self.scores: list[Score] = []  # of all candidates on the last model
        self.untried: list[Score] = []  # scores that passed when the largest number of effects had been added
        self.waves: Effect | None = None
        self.removed: list[RemovedEffect] = []  # by the backward eliminations so far
        self._tested: list[_TestedModel] = []
        self._possible_rounds = 1  # with the present one
        self.larger_models: list[LargerModel] = []
        self._nonparametric: dict[tuple[str, int], tuple[Effect, FittedModel]] = {}  # by name, and id of the model
        self.n = sum(r.n_rows for r in records)

    def scored(self, fitted: FittedModel) -> tuple[list[Score], list[Score]]:
        """Compute the scores of all candidates on a fitted model.

        The scores and the score equations of the model are kept in ``scores`` and ``equations``.

        Returns
        -------
        scores
            Scores of all candidates, the largest criterion first.
        passing
            The scores that pass, in the same order.

        Raises
        ------
        ValueError
            If a matrix of the score tests cannot be factored, so that the residuals cannot be tested.
        """
        tested = frozenset(self.candidates), frozenset(self.common)
        for known in self._tested:  # a removed effect may lead back to an earlier model
            if known.fitted is fitted and known.tested == tested and known.policy == self.policy:
                self.equations, self.scores = known.equations, known.scores
                return known.scores, known.passing
        self.reporter.detail(f"score tests of {counted(len(self.candidates), 'candidate')}")
        try:
            with self.work.timed("tests" if self._tested else "start"):
                self.equations = score_equations(fitted, self.records, self.candidates | self.common)
                self.scores, passed = score_all(fitted, self.records, self.candidates, self.policy, self.equations)
            self._tested.append(_TestedModel(fitted, tested, self.policy, self.equations, self.scores, passed))
            return self.scores, passed
        except np.linalg.LinAlgError as problem:
            names = ", ".join(r.name for r in self.records)
            message = f"the residuals of model {fitted.model.name} cannot be tested"
            raise ValueError(
                f"{names}: {message}: {problem} (the fit {fitted.fit.message}); fit the model with fewer free "
                "parameters (--fix NAME=VALUE), or to longer logs"
            ) from problem

    def uncertainty(self, passing: Sequence[Score], fit: Fit) -> ModelUncertainty | None:
        """Compute how the candidates that pass would shift the estimates of the model that was scored last.

        ``passing`` are the scores that pass on that model, and ``fit`` is its fit. The result is None if there is
        nothing to add (`model_uncertainty`), or before the first call of `scored`.
        """
        if self.equations is None:
            return None
        return model_uncertainty(self.equations, passing, self.candidates, fit)

    def run(self, before: FittedModel, max_effects: int) -> SearchOutcome:
        """Add effects, remove those that are not supported, and add others in place of the removed ones.

        A removed effect does not count among the ``max_effects`` effects, and is not tried again. The search goes on
        with other effects only if the number of effects had ended it.

        Parameters
        ----------
        before
            Fitted model without added effects.
        max_effects
            Largest number of effects.
        """
        self._plan(max_effects)
        current, again = self.forward(before, max_effects), False
        while True:
            n_removed, n_rounds = len(self.removed), len(self.rounds)
            is_full = sum(r.chosen is not None for r in self.rounds) >= max_effects + n_removed
            self._plan(0)
            self.work.plan("tests", int(is_full), 1)
            self.reporter.progress("computing the importance of the effects found")
            base, current, weights, self.removed = self.weighed_effects(before, current)
            if len(self.removed) == n_removed or not is_full:
                break
            current, again = self.forward(before, max_effects + len(self.removed), current), True
            if all(r.chosen is None for r in self.rounds[n_rounds:]):
                is_full = False
                break
        # The last scores may be those of a larger model, or of one with fewer effects.
        passed = self.scored(current)[1]
        self.untried = self._to_be_tried(passed, again) if is_full else []
        return SearchOutcome(base, current, passed, weights, self.removed)

    def forward(self, before: FittedModel, max_effects: int, current: FittedModel | None = None) -> FittedModel:
        """Add effects one after the other, and return the last model.

        The search ends after ``max_effects`` rounds in all, after a round without an added effect (unless two effects
        at once are accepted then: `_look_ahead`), or if no score that passes may be tried. After a nonparametric
        effect, only parametric effects are tried, with a criterion of the score above
        ``policy.min_gain_ratio_after_curve`` of the largest criterion of an added effect. The attributes of the search
        are updated.

        Common errors are small errors that every craft has: timing and mounting of its sensors, and hull form. They are
        added together before a round, if no parametric effect of the boat that passes explains more than all of them,
        and under the other conditions of `add_common_errors`. If the model has them, an effect is tried only if the
        criterion of its score also exceeds ``policy.max_remaining_criterion``.

        In a later call, candidates whose last refit failed (`_failed_before`) are not tried again: the model with fewer
        effects is no better than the last one at judging them. The others need a criterion of the score above
        ``policy.min_trial_criterion``.

        Parameters
        ----------
        before
            Fitted model without added effects.
        max_effects
            Largest number of rounds, with those of earlier calls.
        current
            Model with the effects of earlier calls that were not removed. None in the first call, which starts with
            ``before``.

        Returns
        -------
        FittedModel
            The last model; ``current`` itself if nothing was added. It has not been scored if it has the largest number
            of effects: one of them may be removed at once, so that its score tests would be in vain.
        """
        again = current is not None
        self.nominal, current = before, current or before
        chosen = False  # whether the last step added an effect, beside which the candidates were not tested yet
        while True:
            if len(self.rounds) >= max_effects and not self.common:
                return current
            scores, passed = self.scored(current)
            if chosen:
                self.rounds[-1] = self._with_explained(self.rounds[-1], passed)
                chosen = False
            if (extended := self.add_common_errors(current, passed)) is not None:
                current = extended
                continue
            tried = self._to_be_tried(passed, again)
            if len(self.rounds) >= max_effects or not tried:
                return current
            self._possible_rounds = max_effects - len(self.rounds)
            self._report_round(scores, passed, tried)
            found = self._run_round(current, scores, tried)
            pair = self._look_ahead(current, found, max_effects) if found.chosen is None else None
            if pair is not None:
                self.rounds.extend(pair)
                found = pair[1]
            else:
                self.rounds.append(found)
            if found.chosen is None:
                return current
            current, chosen = found.chosen.fitted, True
            self.candidates.pop(found.chosen.effect.name, None)

    def _with_explained(self, found: Round, passed: Sequence[Score]) -> Round:
        """Return a round with the candidates that its chosen effect explains (`Round.explained`).

        ``passed`` are the scores that pass on the model with this effect. A nonparametric effect explains none here,
        because other curves are not tried beside a curve, whether or not it explains what they would.
        """
        if found.chosen is None or found.chosen.nonparametric:
            return found
        left = {found.chosen.effect.name, *(s.name for s in self._to_be_tried(passed, False))}
        return replace(found, explained=tuple(name for name in found.passed if name not in left))

    def _to_be_tried(self, passed: Sequence[Score], again: bool) -> list[Score]:
        """Return those of the scores that pass on a model which may be tried, under the conditions of `forward`.

        ``again``: whether it is a later call of `forward`.
        """
        gone = {r.effect.name for r in self.removed}
        added = [r.chosen for r in self.rounds if r.chosen is not None]
        tried = [s for s in passed if s.name not in gone]
        if any(c.nonparametric for c in added if c.effect.name not in gone):
            least = self.policy.min_gain_ratio_after_curve * max(c.criterion for c in added)
            tried = [s for s in tried if not s.nonparametric and s.criterion(self.n) > least]
        if again:
            failed = self._failed_before()
            strong = [s for s in tried if s.criterion(self.n) > self.policy.min_trial_criterion]
            tried = [s for s in strong if s.name not in failed]
        if self.common_errors is not None:  # what is left is the difference between a real boat and any model
            tried = [s for s in tried if s.criterion(self.n) > self.policy.max_remaining_criterion]
        return tried

    def _plan(self, after: int, here: tuple[float, float] | None = None) -> None:
        """Plan the work that is still ahead, for the time left.

        A part of the possible rounds is likely (`LIKELY_ROUNDS`): a round that adds no effect is the last. A round
        usually ends after its first batch and one nonparametric candidate, and with one exact fit.

        Parameters
        ----------
        after
            Number of rounds that are possible after the present one.
        here
            Likely and largest number of refits that are left in the present round; None outside of a round.
        """
        policy, work, present = self.policy, self.work, int(here is not None)
        few, many = here or (0.0, 0.0)
        likely = LIKELY_ROUNDS * after
        most = policy.n_refits * policy.n_batches + policy.n_nonparametric
        found = sum(r.chosen is not None for r in self.rounds) - len(self.removed) + present
        work.plan("candidate", few + likely * (policy.n_refits + 1), many + after * most)
        work.plan("tests", likely + present, after + present)
        work.plan("exact", likely + present, 2 * (after + present))
        work.plan("without", found + likely, 2 * (found + after))
        work.plan("evaluation", 3, 3)  # the fit beside other candidates, the curves, and the predictions

    def _report_round(self, scores: Sequence[Score], passed: Sequence[Score], tried: Sequence[Score]) -> None:
        """Report the number of the next round, and how many of the scored candidates pass and are tried."""
        n = len(self.rounds)
        self.reporter.progress(
            f"round {n + 1} of at most {n + self._possible_rounds}: {len(tried)} of {len(scores)} candidates pass"
            f"{f' ({len(passed) - len(tried)} others by too little to matter)' * (len(tried) < len(passed))}, "
            f"best {tried[0].name}"
        )

    def _look_ahead(self, current: FittedModel, found: Round, max_effects: int) -> tuple[Round, Round] | None:
        """Try to add two effects at once, after a round in which no effect was accepted.

        Two effects can hide each other: each alone explains much of the estimation data, but the validation data
        support neither, because the errors by the other effect dominate some of their blocks. So the best parametric
        refit that only lacks this support (a positive but not significant gain, and a criterion above
        ``policy.min_trial_criterion``) is added for a trial, and a further round searches for a second effect. Both
        effects are kept if that round adds an effect and the validation data support the pair: their gain by both is
        positive, with t above ``policy.min_t``. The backward elimination later tests each of them beside the other.

        Parameters
        ----------
        current
            Model before the round.
        found
            Round without an added effect.
        max_effects
            Largest number of rounds.

        Returns
        -------
        tuple of two Round, or None
            The round with the effect of the trial as its choice, and the next round. None if there is no such effect,
            if fewer than two rounds are left, or if the trial fails; ``candidates``, ``scores`` and ``equations`` are
            then as before. After a success they are those of the model with the effect of the trial. ``rounds`` is as
            before in each case.
        """
        trial = max(
            (
                r
                for r in found.refits
                if not r.nonparametric
                and r.outcome is Outcome.NOT_VALIDATED
                and r.validation_gain > 0
                and r.criterion > self.policy.min_trial_criterion
            ),
            key=lambda r: r.criterion,
            default=None,
        )
        if trial is None or len(self.rounds) + 2 > max_effects:
            return None
        self.reporter.progress(f"trying {trial.effect.title} together with another effect")
        before = self.scores, self.equations, dict(self.candidates), self.rounds
        try:
            with self.work.timed("exact"):
                exact = replace(self._fit_exactly(current, trial), outcome=Outcome.ADDED)
            first = replace(found, refits=tuple(exact if r is trial else r for r in found.refits), chosen=exact)
            self.candidates.pop(trial.effect.name, None)
            self.rounds = [*self.rounds, first]
            scores, passed = self.scored(exact.fitted)
            tried = [s for s in passed if not s.nonparametric]
            self._possible_rounds = max_effects - len(self.rounds)
            if tried:
                self._report_round(scores, passed, tried)
            second = self._run_round(exact.fitted, scores, tried) if tried else None
            if second is not None and second.chosen is not None:
                gain, t = Comparison(current, second.chosen.fitted, self.policy).gain
                if gain > 0 and t > self.policy.min_t:
                    self.rounds = before[3]
                    return first, second
        except FIT_ERRORS as problem:
            self.reporter.progress(f"the trial failed: {problem}")
        self.scores, self.equations, self.candidates, self.rounds = before
        return None

    def add_common_errors(self, current: FittedModel, passed: Sequence[Score]) -> FittedModel | None:
        """Add the common errors to a model if no effect of the boat explains more; return the fit with them.

        Only candidates that pass their score tests are compared, without errors of sensors and without waves, which
        every boat has and which do not change the prediction. None if ``common`` is empty or no model was scored, if
        fewer than ``policy.min_common_errors`` of them are needed, if a single effect of the boat explains more, or if
        they are rejected (`fit_common_errors`). In the last case they are in ``rejected_common_errors``, and are not
        tried again (``common`` is empty). After a success ``common``, ``common_errors``, ``candidates`` and
        ``policy`` are changed.

        Parameters
        ----------
        current
            Model before, which was scored last.
        passed
            Scores that pass on it, best first.
        """
        if not self.common or self.equations is None:
            return None
        joint = score_common_errors(self.equations, self.common, self.n)
        # `keep_common_errors` removes waves from the candidates, however much they explain. An error of a sensor does
        # not explain the motion of the boat; what the common errors leave of it is found in the next round.
        behind = {n for n, e in self.candidates.items() if is_error_of_motion_sensor(e)} | {*self.common, WAVES}
        others = [s.criterion(self.n) for s in passed if not s.nonparametric and s.name not in behind]
        if len(joint.names) < self.policy.min_common_errors or joint.criterion < max(others, default=0.0):
            return None
        common, self.common = self.common, {}
        joint = with_forms(joint, self.equations, common)
        names = ", ".join(joint.names)
        self.reporter.progress(f"fitting with {counted(len(joint.names), 'common error')}: {names}")
        before = [r.chosen.effect.name for r in self.rounds if r.chosen is not None]
        with self.work.timed("exact"):
            found = fit_common_errors(
                current, self.records, self.validation_data, joint, common, found=before, policy=self.policy,
                detail=self.reporter.detail,
            )  # fmt: skip
        if isinstance(found, RejectedCommonErrors):
            self.rejected_common_errors = found
            self.reporter.progress(f"leaving the common errors out: {found.reason}")
            return None
        self.keep_common_errors(found)
        return found.fitted

    def keep_common_errors(self, found: CommonErrorsFit) -> None:
        """Continue the search with a model that has the common errors.

        The fit ``found`` is stored in ``common_errors``, and ``common`` becomes empty, so that no others are added. The
        effects of ``found``, nested ones and waves are removed from ``candidates``; the attribute ``waves`` has the
        waves. From now on an added effect has to change the prediction by more than before
        (``policy.min_error_ratio_beside``, and ``policy.min_identified_ratio_beside`` to be identified). The function
        fits nothing.
        """
        self.common_errors, self.common = found, {}
        beside = self.policy.min_error_ratio_beside
        self.policy = replace(
            self.policy,
            min_error_ratio=beside,
            material_error_ratio=beside,
            min_identified_ratio=self.policy.min_identified_ratio_beside,
        )
        # Waves shake every boat, are not correlated with its inputs, and the prediction is as good without them.
        self.waves = self.candidates.pop(WAVES, None)
        for name in (*(e.name for e in found.effects), *nested_in(self.candidates, found.effects)):
            self.candidates.pop(name, None)

    @property
    def exact(self) -> SearchSettings | None:
        """Settings of the exact fits, whose results become the model of the search.

        None (the default settings) without the common errors, otherwise the settings of the fits with common errors.
        """
        return None if self.common_errors is None else COMMON_SEARCH

    def unaffected_by(self, current: FittedModel, remaining: Sequence[Score]) -> tuple[frozenset[str], frozenset[str]]:
        """Fit the last model with the strongest remaining candidates, and find the effects that they do not change.

        The candidates are the first ``policy.n_beside`` parametric ones in ``remaining``, and up to as many of the
        alternatives of added effects. If there is none, the model is compared with itself. All added effects then keep
        their size, except those whose size cannot be compared (`_keeps_its_size`).

        A score test that still passes has two possible reasons: a further effect, beside those found, or an effect that
        was found in place of the right one. In the first case the effects found keep their size beside it, in the
        second they lose it.

        Parameters
        ----------
        current
            Last model.
        remaining
            Scores that pass on it, best first.

        Returns
        -------
        effects
            Names of the added effects whose strongest parameter differs by less than ``policy.max_change_beside`` of
            its value between ``current`` and the fit with the candidates. Empty if the fit fails.
        beside
            Names of the candidates that they were fitted with. Empty if the fit fails.
        """
        n, found = self.policy.n_beside, [r.chosen.effect for r in self.rounds if r.chosen is not None]
        names = {e.name for e in found}
        # The size of an effect is not determined beside one that contains it as a special case.
        strongest = [
            s
            for s in remaining
            if not s.nonparametric and s.name in self.candidates and not names & set(self.candidates[s.name].nests)
        ]
        alternatives = {name for e in found for name in e.alternatives}
        beside = strongest[:n] + [s for s in strongest[n:] if s.name in alternatives][:n]
        model, fitted = current.fit.model, current
        try:
            joint = self._joint_steps(beside)
            added = [(e := self.candidates[s.name], next(_with_initial_values(e, s)), s) for s in joint]
            for _, start, _ in added:
                model = model + start
            if beside:
                model, begin = self._with_held_noise(model), self._shifted_estimates(current, added)
                with quick_compilation(self.n):
                    settings = replace(self.rough, tolerance=max(self.rough.tolerance, BESIDE_TOLERANCE))
                    fitted = fit_and_evaluate(model, self.records, (), settings=settings, start=begin)
        except FIT_ERRORS:
            return frozenset(), frozenset()
        kept = set[str]()
        for r in self.rounds:
            if r.chosen is not None and _keeps_its_size(
                r.chosen.effect, current, fitted, self.policy.max_change_beside
            ):
                kept.add(r.chosen.effect.name)
        return frozenset(kept), frozenset(s.name for s in beside)

    @property
    def rough(self) -> SearchSettings:
        """Settings of the rough fits with candidates, which are faster and less exact than the exact fits.

        Beside the common errors, the fits are rougher than without them.
        """
        return ROUGH_SEARCH if self.common_errors is None else ROUGH_COMMON_SEARCH

    def reference(self, before: FittedModel, current: FittedModel) -> FittedModel:
        """Return the fitted model without the effects found, but with the common errors of ``current`` if it has any.

        It is fitted anew if the common errors were added after an effect.

        Parameters
        ----------
        before
            Model without effects and without common errors.
        current
            Model with both.

        Raises
        ------
        FIT_ERRORS
            If the new fit fails: ``ValueError``, ``ArithmeticError`` or ``LinAlgError``.
        """
        common = self.common_errors
        if common is None:
            return before
        if not common.after:
            return common.fitted
        model = before.fit.model
        for effect in common.effects:
            model = model + effect
        last = current.fit.model.values
        model = model.with_values({n: last[n] for n in model.values if n in last})
        return fit_and_evaluate(model, self.records, self.validation_data, settings=COMMON_SEARCH)

    def weighed_effects(
        self, before: FittedModel, current: FittedModel
    ) -> tuple[FittedModel, FittedModel, tuple[EffectImportance, ...], list[RemovedEffect]]:
        """Compute the importance of each effect found, and remove the unsupported ones (`backward_elimination`).

        If the model without the effects cannot be fitted (`reference`), all effects are kept, and their importance is
        unknown.

        Parameters
        ----------
        before
            Model without effects and without common errors.
        current
            Model with all of them.

        Returns
        -------
        base
            Model without effects, but with the common errors; ``before`` if it cannot be fitted.
        model, importances, removed
            As of `backward_elimination`.
        """
        try:
            base = self.reference(before, current)
        except FIT_ERRORS as problem:
            unknown, chosen = float("nan"), [r.chosen for r in self.rounds if r.chosen is not None]
            weights = [EffectImportance(c.effect.name, unknown, unknown, untested=str(problem)) for c in chosen]
            return before, current, by_importance(weights, chosen), self.removed
        return base, *self.backward_elimination(before, base, current)

    def backward_elimination(
        self, before: FittedModel, base: FittedModel, current: FittedModel
    ) -> tuple[FittedModel, tuple[EffectImportance, ...], list[RemovedEffect]]:
        """Leave each effect out in turn and remove the least supported effect, until all effects are supported.

        The least supported effect is the one with the smallest t among those of `should_be_removed`.

        If no further effect should be removed, but after a removal the remaining effects predict significantly worse
        than the nominal model, the effect that was selected last is removed too.
        An effect is kept if the model without it cannot be fitted, because its importance is then unknown. A removed
        parametric effect becomes a candidate again.

        Parameters
        ----------
        before
            Model without added effects and without common errors.
        base
            Model without added effects, but with the common errors (`reference`).
        current
            Model with all added effects.

        Returns
        -------
        model
            Model with the remaining effects.
        importances
            Importance of each remaining effect, the most important first.
        removed
            Removed effects in the order of their removal, with those of earlier calls.
        """
        removed = [*self.removed]
        stuck: dict[str, str] = {}
        without = RoughFits(self.rough)
        while True:
            gone = {r.effect.name for r in removed}
            chosen = [r.chosen for r in self.rounds if r.chosen is not None and r.chosen.effect.name not in gone]
            self._share_reduced_kernels(current, chosen)
            with self.work.timed("without", len(chosen)):
                weights = effect_importance(
                    base, current, chosen, self.rounds, self.records, self.validation_data, self.policy, without
                )
            weights = tuple(replace(w, untested=stuck.get(w.effect, w.untested)) for w in weights)
            tested = [w for w in weights if w.untested is None]
            curves = {c.effect.name for c in chosen if c.nonparametric}
            removable = [
                w for w in tested if should_be_removed(w, nonparametric=w.effect in curves, policy=self.policy)
            ]
            idle = min(removable, key=lambda w: w.t, default=None)
            if (
                idle is None
                and removed
                and chosen
                and Comparison(before, current, self.policy).prediction.verdict == "rose"
            ):
                idle = next((w for w in tested if w.effect == chosen[-1].effect.name), None)
            if idle is None:
                return current, weights, removed
            assert idle.prediction is not None
            effect = next(c.effect for c in chosen if c.effect.name == idle.effect)
            dropped = RemovedEffect(effect, idle.validation_gain, idle.t, idle.prediction)
            self.reporter.progress(f"fitting without {effect.title}: {removal_reason(dropped, self.policy)}")
            kept = [c for c in chosen if c.effect is not effect]
            try:
                rough = without.fits.get(frozenset(c.effect.name for c in kept), current)
                with self.work.timed("exact"):
                    current = self._exact_fit_with(kept) or fit_without(
                        base, rough, chosen, effect, self.records, self.validation_data, self.exact
                    )
            except FIT_ERRORS as problem:
                stuck[idle.effect] = str(problem)
                continue
            removed.append(dropped)
            if (
                not effect.kind.nonparametric
            ):  # the last score tests include every parametric effect that the model lacks
                self.candidates[effect.name] = effect

    def _exact_fit_with(self, kept: Sequence[Refit]) -> FittedModel | None:
        """Return the exact fit with the effects of ``kept`` only, if the search passed through this model.

        None if no round ended with these effects, or if the common errors were added after an effect.
        """
        if self.common_errors is not None and self.common_errors.after:
            return None
        wanted, so_far = {c.effect.name for c in kept}, set[str]()
        for r in self.rounds:
            if r.chosen is not None:
                so_far.add(r.chosen.effect.name)
                if so_far == wanted:
                    return r.chosen.fitted
        return None

    def _run_round(self, current: FittedModel, scores: list[Score], passed: list[Score]) -> Round:
        """Refit the best candidates that passed, and choose the refit to add.

        Parametric candidates are refitted in at most ``policy.n_batches`` batches of ``policy.n_refits``, until a batch
        has an accepted refit. Those with a criterion of at most ``policy.min_score_ratio`` of the best are left out if
        the best is positive. Once the first two of a batch are refitted, those are left out that cannot win any more
        (`_can_win`). Candidates other than the best whose last refit failed in an earlier round (`_failed_before`) are
        put off: they are refitted last, only if no other refit is accepted.

        Then follow up to ``policy.n_nonparametric`` nonparametric candidates whose score is high enough compared with
        the best accepted refit (``policy.nonparametric_score_share`` and ``policy.nonparametric_score_distance``).
        There is no such limit without an accepted refit, and for the curve of which the effect of the best accepted
        refit is one form. The attributes of the search are not changed.

        Parameters
        ----------
        current
            Model before the round.
        scores
            Scores of all candidates, which the round keeps.
        passed
            Scores that pass, the largest criterion first.
        """
        specific = [s for s in passed if not s.nonparametric]
        # If the best criterion is negative, no candidate is dropped: a refit can gain more than its score.
        if specific and (best := specific[0].criterion(self.n)) > 0:
            specific = [s for s in specific if s.criterion(self.n) > self.policy.min_score_ratio * best]
        refits: list[Refit] = []
        untested: list[UntestedCandidate] = []
        failed = self._failed_before() - {s.name for s in specific[:1]}
        size = self.policy.n_refits
        batches = [specific[k : k + size] for k in range(0, size * self.policy.n_batches, size)]
        last = [s for batch in batches for s in batch if s.name in failed]
        passed_curves = [s for s in passed if s.nonparametric][: self.policy.n_nonparametric]
        curves = [self.nonparametric_effect(s, current) for s in passed_curves]
        specific_effects = [self.candidates[s.name] for batch in batches for s in batch]
        self._share_kernels(current.fit.model, [*specific_effects, *curves])
        n_generic, after = sum(s.nonparametric for s in passed), self._possible_rounds - 1
        n_most = sum(map(len, batches)) + min(n_generic, self.policy.n_nonparametric)
        self._plan(after, (len(batches[0]) + min(n_generic, 1), n_most))
        for batch in (*([s for s in batch if s.name not in failed] for batch in batches), last):
            self._refit_all(current, [(self.candidates[s.name], s) for s in batch[:REFITS_AT_ONCE]], refits, untested)
            further = [s for s in batch[REFITS_AT_ONCE:] if self._can_win(s, refits)]
            self._refit_all(current, [(self.candidates[s.name], s) for s in further], refits, untested)
            if any(is_accepted(r, self.policy) for r in refits):
                break
        self._refit_waves_beside(current, refits, untested)
        leading = self._best_accepted(refits)
        most, curve = (-np.inf, None) if leading is None else (leading.criterion, leading.effect.parametric_form_of)
        # A nonparametric candidate competes only if its score is high compared with the best accepted parametric
        # refit, or if that effect is one form of the same curve.
        least = max(self.policy.nonparametric_score_share * most, most - self.policy.nonparametric_score_distance)
        generic = [(s, s.kind is EffectKind.NONPARAMETRIC and s.curve == curve) for s in passed if s.nonparametric]
        unknown = [s for s, same_curve in generic if s.criterion(self.n) > least or same_curve][
            : self.policy.n_nonparametric
        ]
        self._plan(after, (len(unknown), len(unknown)))
        drawn = [(self.nonparametric_effect(s, current), s) for s in unknown]
        self._refit_all(current, drawn, refits, untested)
        self._plan(after, (0, 0))
        names = tuple(s.name for s in passed)
        refits, chosen = self._choose_refit(current, refits, untested)
        return Round(tuple(scores), names, tuple(refits), chosen, tuple(untested))

    def _can_win(self, score: Score, refits: Sequence[Refit]) -> bool:
        """Return whether a candidate could still have a larger criterion than the best accepted one of some refits.

        A refit may exceed its score, at most by the factor ``policy.max_refit_growth``.
        """
        best = max((r.criterion for r in refits if is_accepted(r, self.policy)), default=-np.inf)
        return self.policy.max_refit_growth * max(score.criterion(self.n), 0.0) >= best

    def _failed_before(self) -> set[str]:
        """Return the names of the candidates, as of their scores, whose last refit was not supported by the data.

        The refit did not gain enough on the estimation data, or its gain on the validation data was not significant.
        A further effect in the model seldom changes that, and each refit costs as much as a fit.
        """
        failed = set[str]()
        for r in (r for earlier in self.rounds for r in earlier.refits):
            e = r.effect
            name = curve_name(e.kind, e.curve) if e.kind.nonparametric and e.curve is not None else e.name
            if r.outcome in (Outcome.NOT_SUPPORTED, Outcome.NOT_VALIDATED):
                failed.add(name)
            else:
                failed.discard(name)
        return failed

    def _choose_refit(
        self, current: FittedModel, refits: list[Refit], untested: list[UntestedCandidate]
    ) -> tuple[list[Refit], Refit | None]:
        """Judge the refits of a round; return them with their outcomes, and the refit to add.

        The refits are returned with the largest criterion first. The refit to add is the best accepted refit, fitted
        exactly; None if none is accepted. A refit whose exact fit fails is appended to ``untested`` instead.
        ``current`` is the model before the round.

        A difference between runs (a parameter with its own value in each run) has as many parameters as there are runs,
        and explains a part of any effect. A nonparametric effect follows the data without a physical law, and its free
        form adapts to other errors of the model. So both come after the other effects, unless they explain more than
        the best of them (`_explains_more`). If the likelihood cannot distinguish effects, the effect with the smallest
        prediction errors is the best.
        """
        judged: list[Refit] = []
        chosen: Refit | None = None
        for r in sorted(refits, key=lambda r: (_adapts_to_all_errors(r), -r.criterion)):
            if not is_validated(r, self.policy):
                r = replace(r, outcome=refit_outcome(r, (), self.policy))
            elif (
                chosen is None
                or self._indistinguishable(r, chosen)
                or (r.criterion > chosen.criterion and self._explains_more(r, chosen))
            ):
                try:
                    self.reporter.progress(f"fitting exactly with {r.effect.title}, and validating it")
                    with self.work.timed("exact"):
                        r = self._fit_exactly(current, r)
                except FIT_ERRORS as problem:
                    untested.append(UntestedCandidate(r.effect, str(problem)))
                    continue
                if r.outcome is not Outcome.ADDED:
                    pass  # the outcome has the reason
                elif chosen is not None and self._indistinguishable(r, chosen) and not _predicts_better(r, chosen):
                    r = replace(r, outcome=Outcome.OUTRANKED)
                else:
                    judged = [replace(q, outcome=Outcome.OUTRANKED) if q is chosen else q for q in judged]
                    chosen = r
            judged.append(r)
        return sorted(judged, key=lambda r: -r.criterion), chosen

    def _indistinguishable(self, first: Refit, second: Refit) -> bool:
        """Return whether the likelihood cannot distinguish the effects of two refits.

        The criteria of both refits differ by less than ``policy.indistinguishable``. False if one of the effects is
        nonparametric, or if the first is a difference between runs.
        """
        parametric = not (first.nonparametric or second.nonparametric or first.effect.kind is EffectKind.BETWEEN_RUNS)
        return parametric and abs(first.criterion - second.criterion) < self.policy.indistinguishable

    def _explains_more(self, adaptable: Refit, other: Refit) -> bool:
        """Return whether an effect that adapts to all errors, with the larger criterion, explains more than another.

        ``adaptable`` is a difference between runs or a nonparametric effect. An effect of hull or thrust with a size in
        each run, such as `fouling`, contains a difference between runs, which has to gain more on the estimation data
        only. In any other case the validation data decide: the gain in log-likelihood over the model with ``other`` is
        positive, its t statistic exceeds ``policy.min_t``, and the prediction over the horizon is not significantly
        worse. False if ``adaptable`` is another kind of effect, or if the models cannot be compared.
        """
        if not _adapts_to_all_errors(adaptable):
            return False
        per_run = other.effect.place in ("hull", "actuator") and any(p.per_record for p in other.effect.parameters)
        if per_run and adaptable.effect.kind is EffectKind.BETWEEN_RUNS:
            return True
        try:
            compared = comparison(other.fitted, adaptable.fitted, adaptable.effect, self.policy)
            gain, t = compared.gain
        except FIT_ERRORS:
            return False
        return gain > 0 and t > self.policy.min_t and compared.prediction.verdict != "rose"

    def _fit_exactly(self, current: FittedModel, rough: Refit) -> Refit:
        """Fit the model of a rough refit exactly; return the refit with the new fit, prediction and outcome.

        The gain on the validation data and its t statistics are those of the new fit. The gain on the estimation data
        and the criterion stay those of the rough search.

        Three sets of initial values are tried in turn: the rough estimates, the effect's own initial values, and half
        of the effect's own initial values. A fit that did not converge is used only if the fit of ``current`` did not
        converge either.

        Raises
        ------
        ValueError
            If the fit fails or does not converge from any initial values. The message is the reason of the last trial.
        """
        again = current.fit.model + rough.effect
        reason = ""
        found = rough.fitted.fit
        released = found.model.with_free(p.name for p in again.parameters if p.free)
        for begin, values in (
            (released, found.start_values(released)),
            (again, {}),
            (again.with_values(_half_values(rough.effect)), {}),
        ):
            try:
                fitted = fit_and_evaluate(
                    begin, self.records, self.validation_data, settings=self.exact, start=values,
                    detail=self.reporter.detail,
                )  # fmt: skip
                compared = comparison(current, fitted, rough.effect, self.policy)
                (gain, t), prediction = compared.gain, compared.prediction
            except FIT_ERRORS as problem:
                reason = str(problem)
                continue
            if fitted.fit.converged or not current.fit.converged:
                assert self.nominal is not None
                total = (
                    prediction if current is self.nominal else Comparison(self.nominal, fitted, self.policy).prediction
                )
                every = compared.pooled_t((rough.gain - rough.criterion) / 2)
                exact = replace(
                    rough, fitted=fitted, validation_gain=gain, t=t, pooled_t=every, prediction=prediction, total=total,
                    by_inputs=compared.by_inputs if rough.nonparametric else None,
                )  # fmt: skip
                added = [r.chosen for r in self.rounds if r.chosen is not None]
                return replace(exact, outcome=refit_outcome(exact, added, self.policy))
            reason = f"the fit with the added effect did not converge: it {fitted.fit.message}"
        raise ValueError(reason)

    def _share_kernels(self, model: Model, effects: Sequence[Effect]) -> None:
        """Let one kernel of sensitivities serve the refits of a model with each of the effects.

        An effect with states needs a kernel of its own: its states would take time in all refits. Effects that the
        shared kernels of earlier rounds serve need no further one.
        """
        added = [r.chosen.effect for r in self.rounds if r.chosen is not None]
        null = [e for e in added if not e.states]
        # The effects found are left out in later fits. They change nothing at their own values.
        values = {p.name: p.value for e in null for p in e.parameters}
        larger = model.with_values({name: value for name, value in values.items() if name in model.values})
        for effect in effects:
            if not effect.states and larger.accepts(effect) and not self._has_shared_kernel(model + effect):
                larger, null = larger + effect, [*null, effect]
        if len(larger.effects) > len(model.effects) + 1:
            self.larger_models.append(LargerModel(larger, frozenset(e.name for e in null)))

    def _share_reduced_kernels(self, current: FittedModel, chosen: Sequence[Refit]) -> None:
        """Let one kernel serve the fits in which an effect with states is left out, for each such effect.

        Its states are left out, too, so that the kernels of the rounds do not serve these fits. With fewer than three
        effects there is only one such fit, which needs no shared kernel.
        """
        shared = next((m for m in reversed(self.larger_models) if m.contains(current.fit.model)), None)
        if shared is None or len(chosen) < 3:
            return
        for name in (c.effect.name for c in chosen if c.effect.states):
            if not self._has_shared_kernel(current.fit.model.without(name)):
                self.larger_models.append(LargerModel(shared.model.without(name), shared.null))

    def _has_shared_kernel(self, model: Model) -> bool:
        """Return whether the kernel of a larger model serves this model."""
        return any(larger.contains(model) for larger in self.larger_models)

    def nonparametric_effect(self, score: Score, fitted: FittedModel) -> Effect:
        """Return the nonparametric effect that a score tests, with priors scaled to the size of the boat.

        It is a lagged or resonant response to the thrusters, or a curve over the interval of its variable in the data.
        The score must have a ``curve``. A repeated call with the same fitted model returns the same object, so that the
        compiled kernels of the model with this effect are used again.
        """
        assert score.curve is not None
        key = score.name, id(fitted)
        if key not in self._nonparametric:
            tested = (score.kind, score.curve)
            responses = (e for e in input_response_effects(fitted.model) if (e.kind, e.curve) == tested)
            effect = next(responses, None) or nonparametric_effect(
                fitted.model, score.curve, _variable_interval(fitted, score.curve)
            )
            # The fitted model is kept as well, so that its id remains that of this object.
            self._nonparametric[key] = scale_priors(effect, size_of(fitted.fit.model)), fitted
        return self._nonparametric[key][0]

    def _best_accepted(self, refits: Sequence[Refit]) -> Refit | None:
        """Return the accepted refit with the largest criterion; None if no refit is accepted."""
        return max((r for r in refits if is_accepted(r, self.policy)), key=lambda r: r.criterion, default=None)

    def _refit_waves_beside(self, current: FittedModel, refits: list[Refit], untested: list[UntestedCandidate]) -> None:
        """Refit the model with waves if the best refit of a round is an oscillating mass with a parameter at its bound.

        Beside the common errors, waves are no candidate (`keep_common_errors`). A mass that oscillates without damping
        then takes the place of waves, which it resembles. The waves begin at its frequency. If they explain more, the
        mass is no candidate any more: it would take the place of other waves beside them.
        """
        best = self._best_accepted(refits)
        if self.waves is None or best is None or WAVES not in best.effect.alternatives:
            return
        fit, own = best.fitted.fit, {p.name for p in best.effect.parameters}
        frequency = next((fit.estimate(p.name)[0] for p in best.effect.parameters if p.unit == "Hz"), None)
        if frequency is None or not any(flag == AT_BOUND and name in own for name, flag in fit.flags):
            return
        waves, self.waves = self.waves, None
        self.candidates[WAVES] = waves
        df, lm = len(waves.parameters), max(best.gain, 0.0)
        score = Score(WAVES, lm, df, lm, wave_sizes(current.fit.model), {"f_wave": frequency})
        self._refit_all(current, [(waves, score)], refits, untested)
        if any(r.effect.name == WAVES and r.criterion > best.criterion for r in refits):
            self.candidates.pop(best.effect.name, None)

    def _refit_all(
        self,
        current: FittedModel,
        tried: Sequence[tuple[Effect, Score]],
        refits: list[Refit],
        untested: list[UntestedCandidate],
    ) -> None:
        """Refit the current model with each candidate in ``tried``, two at a time in threads.

        A refit is appended to ``refits``. A candidate that could not be fitted is appended to ``untested``. Both keep
        the order of ``tried``, which contains each candidate with its score.
        """

        def refit(pair: tuple[Effect, Score]) -> Refit | UntestedCandidate:
            """Return the refit of the current model with one candidate; an ``UntestedCandidate`` if no fit succeeds.

            ``pair`` is the candidate and its score.
            """
            return self._refit(current, *pair)

        timed = self.work.timed("candidate", len(tried))
        with timed, ThreadPoolExecutor(REFITS_AT_ONCE) as pool, quick_compilation(self.n):
            for found in pool.map(refit, tried):
                if isinstance(found, Refit):
                    refits.append(found)
                else:
                    untested.append(found)

    def _refit(self, current: FittedModel, effect: Effect, score: Score) -> Refit | UntestedCandidate:
        """Refit the current model with one effect by a rough search, in which the noise of the sensors may be held.

        If every fit fails, the result is an ``UntestedCandidate`` with the reason of the first failure. The initial
        values of `_with_initial_values`, which use the score of the effect, are tried in turn until a fit loses less
        than ``policy.max_loss`` in 2 ln L. If all lose more, the best fit is returned: a larger model cannot be worse
        than the model that it contains, so such a fit has stopped early.

        The fit ends if a further step is expected to gain less than 1 % of the gain that the score test predicts.
        """
        self.reporter.progress(f"refitting with {effect.title}")
        best, reason = None, ""
        df = sum(_degrees_of_freedom(effect, p, len(self.records)) for p in effect.parameters if p.free)
        penalty = df * float(np.log(self.n))
        settings = replace(self.rough, tolerance=max(self.rough.tolerance, ROUGH_SHARE * score.lm / 2))
        for attempt, start in enumerate(_with_initial_values(effect, score)):
            try:
                model = current.fit.model + start
                # A sensor effect that explains much makes the noise of its sensor smaller.
                model = model if effect.place == "sensor" else self._with_held_noise(model)
                of_records = _record_steps(effect, score, len(self.records)) if attempt == 0 else {}
                begin = self._shifted_estimates(current, [(effect, start, score)], of_records)
                fitted = fit_and_evaluate(
                    model,
                    self.records,
                    self.validation_data,
                    settings=settings,
                    start=begin,
                    other_starts=times_of_change([effect], self.records),
                    detail=self.reporter.detail,
                )
                gain = 2 * (fitted.fit.log_posterior - current.fit.log_posterior)
                # Blocks in time take longer than the fit, and cannot help an effect that the estimation data reject.
                compared = (
                    comparison(current, fitted, effect, self.policy)
                    if gain > penalty
                    else whole_run_comparison(current, fitted, self.policy)
                )
                total, t = compared.gain
            except FIT_ERRORS as problem:
                reason = reason or str(problem)
                continue
            every = compared.pooled_t(penalty / 2)
            found = Refit(effect, fitted, gain, df, gain - penalty, total, t, pooled_t=every)
            best = found if best is None or found.gain > best.gain else best
            if best.gain > -self.policy.max_loss:
                break
        return UntestedCandidate(effect, reason) if best is None else best

    def _with_held_noise(self, model: Model) -> Model:
        """Return a model with added effects in which the noise of all sensors keeps its values in a rough search.

        These are the measurement noise of the outputs and the walk of the biases. Without common errors, the model is
        returned as it is.

        Notes
        -----
        An effect of the boat changes the noise of its sensors by little, so that the gain is smaller by some tenths of
        a per cent (by 2 % if the effect explains most of the residual). The search takes two thirds of the time.
        """
        if self.common_errors is None:
            return model
        walks = {r.state for r in sensor_errors_of(model)}
        held = {o.noise for o in model.outputs} | {s.noise for s in model.states if s.name in walks}
        return model.with_free(p.name for p in model.parameters if p.free and p.name not in held)

    def _shifted_estimates(
        self,
        current: FittedModel,
        added: Sequence[tuple[Effect, Effect, Score]],
        of_records: Mapping[str, float] | None = None,
    ) -> dict[str, float]:
        """Return initial values, by full name, for a refit of the current model with one or more effects.

        They are the estimates of the current model, shifted as the score equations expect it for the effects with their
        initial values. Without the shift, the first step of the search would only make up for the added effects. Empty
        if no model was scored.

        Parameters
        ----------
        current
            Fitted model, which was scored last.
        added
            For each effect: the effect with its own values, the effect with its initial values, and its score.
        of_records
            Initial values, by full name, of the per-record parameters of the effect; None: those of the model.
        """
        of_records = of_records or {}
        if self.equations is None:
            return dict(of_records)
        values = current.fit.start_values(current.fit.model)
        # The likelihood is not quadratic in a parameter that has a logarithm as its coordinate.
        linear = {p.full_name: p for p in current.fit.parameters if p.transform != "log"}
        for effect, start, score in added:
            own = {p.name: p.value for p in effect.parameters}
            step = {p.name: p.value - own[p.name] for p in start.parameters if p.name in score.step}
            for name, change in self.equations.shifts(effect.name, score.scan, {**step, **of_records}).items():
                if name in values and name in linear:
                    low, high = linear[name].bounds
                    values[name] = min(max(values[name] + change, low), high)
        return {**values, **of_records}

    def _joint_steps(self, scores: Sequence[Score]) -> list[Score]:
        """Return copies of scores of parametric candidates, with one-step estimates for all of them together.

        The estimates of a single score hold for its candidate alone: candidates that explain the same residuals would
        be counted twice. A score without columns in the score equations (``waves``) is returned as it is.
        """
        if self.equations is None or len(scores) < 2:
            return list(scores)
        placed = [self.equations.columns_of(s.name, s.scan) for s in scores]
        tested = [{n: k for n, k in at.items() if n in s.step} for s, at in zip(scores, placed, strict=True)]
        weight = [prior_information(self.candidates[s.name], list(at)) for s, at in zip(scores, tested, strict=True)]
        columns = np.array([k for at in tested for k in at.values()], dtype=np.int64)
        values = iter(self.equations.one_step(columns, np.concatenate(weight)).tolist())
        joint = [{name: next(values) for name in at} for at in tested]
        return [replace(s, step=step) if step else s for s, step in zip(scores, joint, strict=True)]


def _adapts_to_all_errors(refit: Refit) -> bool:
    """Return whether the effect of a refit adapts to all errors of a model: a curve, or a difference between runs."""
    return refit.nonparametric or refit.effect.kind is EffectKind.BETWEEN_RUNS


def _predicts_better(first: Refit, second: Refit) -> bool:
    """Return whether the first refit has smaller prediction errors over the horizon than the second.

    The point estimates of the prediction change are compared. Both refits must be exact, so that they have one.
    """
    assert first.prediction is not None
    assert second.prediction is not None
    return first.prediction.ratio < second.prediction.ratio


def _keeps_its_size(effect: Effect, before: FittedModel, after: FittedModel, largest_change: float) -> bool:
    """Return whether an effect has about the same size in two fitted models.

    The strongest parameter of the effect, by standard errors from zero in ``before``, has to change by less than the
    share ``largest_change`` of its value. Only parameters that are zero without the effect count, in each record if
    they are per-record parameters. False if there is none, if a model lacks the effect, or if it is a difference
    between runs, which explains a part of any effect.
    """
    if effect.kind is EffectKind.BETWEEN_RUNS:
        return False
    sizes = {p.name for p in effect.parameters if p.value == 0.0}
    places = [(p.name, p.segment or 0) for p in before.fit.parameters if p.name in sizes]
    known = {place: before.fit.estimate(*place) for place in places}
    known = {place: (value, error) for place, (value, error) in known.items() if error > 0}
    if not known:
        return False
    strongest = max(known, key=lambda place: abs(known[place][0] / known[place][1]))
    if strongest[0] not in {p.name for p in after.fit.parameters}:
        return False
    value = known[strongest][0]
    return abs(after.fit.estimate(*strongest)[0] - value) < largest_change * abs(value)


def _half_values(effect: Effect) -> dict[str, float]:
    """Return half of the initial value of each parameter of an effect by name, limited to its bounds.

    Per-record parameters are left out.
    """
    return {p.name: min(max(0.5 * p.value, p.bounds[0]), p.bounds[1]) for p in effect.parameters if not p.per_record}


def _degrees_of_freedom(effect: Effect, parameter: Parameter, n_records: int) -> int:
    """Return the number of values that are estimated for one parameter of an effect, for the penalty of the criterion.

    It is 1 for a shared parameter and ``n_records`` for a per-record parameter. A difference between runs has one less
    than there are records, because the model contains the mean.
    """
    if not parameter.per_record:
        return 1
    return n_records - 1 if effect.kind is EffectKind.BETWEEN_RUNS else n_records


def _with_initial_values(effect: Effect, score: Score) -> Iterator[Effect]:
    """Yield an effect with different initial values for a refit, the most promising first.

    The first are the one-step estimates of the score test. Then follow smaller values, the neighbours of a scanned
    value, and values of the opposite sign. The last are the effect's own values without an estimate (zero for a size),
    from which an ascent cannot lose likelihood.
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
        yield replace(effect, parameters=tuple(_with_initial_value(p, score, scan, share) for p in effect.parameters))


def _record_steps(effect: Effect, score: Score, n_records: int) -> dict[str, float]:
    """Return the one-step estimates of the per-record parameters of an effect, by full name, within their priors.

    An estimate is limited to one standard deviation of its prior. The result is empty for an effect whose parameters
    are shared by the records, or are tested as if they were.
    """
    found = {}
    for p in effect.parameters:
        sd = p.prior[1] if p.prior else np.inf
        for name in [segment_name(p.name, i) for i in range(n_records)] if p.per_record else []:
            if name in score.step:
                found[name] = float(np.clip(score.step[name], -sd, sd))
    return found


def _with_initial_value(parameter: Parameter, score: Score, scan: Mapping[str, float], share: float) -> Parameter:
    """Return a parameter of an effect with the initial value for a refit.

    With a one-step estimate in the score, it is the parameter's own value plus ``share`` of the estimate, which is
    limited to one standard deviation of the prior; the sum is limited to the bounds. Otherwise it is the value in
    ``scan``, or the parameter's own value.
    """
    value = scan.get(parameter.name, parameter.value)
    if parameter.name in score.step:
        sd = parameter.prior[1] if parameter.prior else np.inf
        value = parameter.value + share * float(np.clip(score.step[parameter.name], -sd, sd))
        low, high = parameter.bounds
        value = min(max(value, low), high)
    return parameter.at(value)


def _variable_interval(fitted: FittedModel, curve: ForceCurve) -> tuple[float, float]:
    """Return the ends of the interval over which a curve of a variable is fitted, in the unit of the variable.

    They are the 1 % and 99 % quantiles of the variable in the estimation data. For an angle, or a product of two
    variables, they are -pi and pi.
    """
    if curve.second or curve.variable in {v.name for v in variables_of(fitted.model) if v.angle}:
        return -np.pi, np.pi
    found = [variables(fitted.model, v.record, v.run.x_filt, v.values) for v in fitted.estimation]
    z = np.concatenate([by_name[curve.variable] for by_name in found])
    low, high = np.percentile(z, [1, 99])
    return float(low), float(high)


def _reported_curves(
    before: FittedModel,
    rounds: Sequence[Round],
    judgements: Sequence[EffectAttribution],
    records: Sequence[Record],
    effect_of: Callable[[Score, FittedModel], Effect],
) -> tuple[list[NonparametricForce], str | None]:
    """Return the nonparametric curves for the report, and why the illustrating curve could not be fitted.

    The curves are those of the selected nonparametric effects, and an illustrating curve: that of the residual, fitted
    in place of the first ambiguous effect. There is no illustrating curve if no effect is ambiguous, or if no curve of
    one variable passed the score test in the round of that effect. A failed fit of it is no error: the title of the
    effect and the reason are returned as one text, otherwise None. For each pair of force and variable only the first
    curve is returned. Effects that are no function of one variable have no curve.

    Parameters
    ----------
    before
        Model without added effects.
    rounds
        Rounds whose effects were not removed.
    judgements
        Attribution of each effect, the most important first.
    records
        Estimation data.
    effect_of
        Returns the nonparametric effect that a score tests on a fitted model (`_Search.nonparametric_effect`).
    """
    found, current, undrawn = [], before, None
    chosen = [r for r in rounds if r.chosen is not None]
    first = next((j.effect for j in judgements if j.attribution == "ambiguous"), None)
    for search_round, r in ((s, s.chosen) for s in chosen if s.chosen is not None):
        if r.nonparametric:
            found.append(_curve_with_errors(r.effect, r.fitted))
        elif r.effect.name == first and (likely := _best_passing_curve(search_round)):
            try:
                effect = effect_of(likely, current)
                drawn_fit = fit_and_evaluate(current.fit.model + effect, records, (), settings=DRAWN)
                found.append(_curve_with_errors(effect, drawn_fit))
            except FIT_ERRORS as problem:
                undrawn = f"{r.effect.title}: {problem}"
        current = r.fitted
    drawn: dict[tuple[str, str], NonparametricForce] = {}
    for s in found:
        if s is not None:  # the first curve of a variable is complete; later curves lack the part of added effects
            drawn.setdefault((s.force, s.variable), s)
    return list(drawn.values()), undrawn


def _best_passing_curve(search_round: Round) -> Score | None:
    """Return the best score of a round that passes and is that of a residual as a function of one variable, else None.

    The scores of a round are sorted by their criterion, so this is the first.
    """
    curves = [s for s in search_round.scores if s.kind is EffectKind.NONPARAMETRIC and s.name in search_round.passed]
    return next((s for s in curves if s.curve is not None and not s.curve.second), None)


def _curve_with_errors(effect: Effect, fitted: FittedModel) -> NonparametricForce | None:
    """Return the curve of a fitted nonparametric effect with its standard deviations and its 95 % band.

    Return None for an effect that is not a function of one variable (products, lagged and resonant responses).
    """
    f = fitted.fit
    return shape(f.model, effect, f.model.values, f.names, f.covariance)
