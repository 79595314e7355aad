"""A diagnosis as a result: the answer in a sentence, and the evidence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import cast

import msgspec

from seatrial.daq.errors import counted
from seatrial.ident.diagnosis import (
    Diagnosis,
    DiagnosisEvaluation,
    Refit,
    RemovedEffect,
    Round,
    ValidationMismatch,
    recommended_experiment,
)
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation import FittedModel, ParameterShift, ReportedEstimates, run_differences
from seatrial.ident.model import EffectKind
from seatrial.ident.results import parts
from seatrial.ident.results.answers import (
    NAMES,
    calibration_notes,
    change_sentence,
    check_warnings,
    failed_run_warnings,
    faults_first,
    frames_assumed,
    late_sensor_warnings,
    not_converged,
    outlier_lines,
)
from seatrial.ident.results.parts import DiagnosisResult, Provenance
from seatrial.ident.results.tables import (
    all_inputs,
    calibration_tables,
    cross_correlations,
    error_tables,
    failed_runs,
    finite,
    fit_summary,
    prediction_change,
    residual_rows,
    traces,
    tracks,
)

MOST_CANDIDATES = 24  # of a round that are reported
HARDLY = 1e-6  # p value of a score test that a data set with nothing missing may well bring forth


def diagnosis_result(
    diagnosis: Diagnosis,
    evaluation: DiagnosisEvaluation,
    made: Provenance,
    *,
    warnings: Sequence[parts.ResultWarning],
    notes: Sequence[str],
    model_path: str,
    unused: Sequence[parts.UnusedSignal] = (),
) -> DiagnosisResult:
    """``notes``: that come first; ``unused``: signals that the model does not take;
    ``model_path``: of the model that was diagnosed, for the commands that are
    recommended."""
    before, after = evaluation.before, evaluation.after
    other, reported = after if diagnosis.effects else None, ReportedEstimates(diagnosis.after.fit)
    factors = {s.unit: reported.factor(s.unit) for s in diagnosis.shapes}
    errors, role = error_tables(after, before, evaluation.changes), after.judged
    prediction = prediction_change(evaluation.changes[role], role) if diagnosis.effects else None
    failed = not_converged(diagnosis.before.fit) or not_converged(diagnosis.after.fit)
    calibration = calibration_tables(after)
    recommended = recommended_experiment(diagnosis)
    return DiagnosisResult(
        **msgspec.structs.asdict(made),
        answer=faults_first(made) + (failed or diagnosis_answer(diagnosis, prediction, after.horizon)),
        caveat=None if failed else diagnosis_caveat(diagnosis),
        prediction=prediction,
        converged_before=diagnosis.before.fit.converged,
        warnings=(
            *check_warnings(made),
            *late_sensor_warnings(made, diagnosis.after.fit.model),
            *frames_assumed(diagnosis.after),
            *warnings,
            *failed_run_warnings(diagnosis.failed_runs),
            *_untested_warnings(diagnosis),
        ),
        notes=(
            *notes,
            *_notes(diagnosis),
            *_blocks_note(evaluation),
            *outlier_lines(after.residuals, after.model),
            *calibration_notes(calibration, after.horizon),
        ),
        fit=fit_summary(diagnosis.after.fit, diagnosis.before.model.values),
        failed_runs=failed_runs(diagnosis.failed_runs),
        cross_validated=diagnosis.cross_validated,
        mismatches=tuple(_mismatch(m) for m in reported_mismatches(diagnosis)),
        removed_effects=tuple(
            parts.RemovedEffect(
                name=r.effect.name,
                title=r.effect.title,
                validation_gain=r.validation_gain,
                t=r.t,
                prediction=prediction_change(r.prediction, role),
            )
            for r in diagnosis.removed
        ),
        horizon_seconds=after.horizon,
        errors=errors,
        calibration=calibration,
        traces=traces(after, before if diagnosis.effects else None),
        track=tracks(after, before if diagnosis.effects else None),
        inputs=all_inputs(after),
        residuals=residual_rows(before, other),
        cross=cross_correlations(before, other),
        unused_signals=tuple(unused),
        residual_forces=_forces(diagnosis, evaluation),
        rounds=tuple(_round(r) for r in diagnosis.rounds) or (_quiet_round(diagnosis),),
        effects=_effects(diagnosis),
        remaining_candidates=tuple(
            parts.RemainingCandidate(name=s.name, lm=s.lm, df=s.df, p=s.p) for s in diagnosis.left
        ),
        nonparametric_effects=tuple(
            parts.NonparametricCurve(
                force=s.force,
                sensor_error=s.reading,
                variable=s.variable,
                unit=reported.scale.unit(s.unit),
                variable_unit=s.variable_unit,
                grid=s.grid,
                value=factors[s.unit] * s.value,
                sd=factors[s.unit] * s.sd,
                band=factors[s.unit] * s.band,
            )
            for s in diagnosis.shapes
        ),
        parameters_before_after=_moved(diagnosis),
        recommended_experiment=None if recommended is None else recommended.replace("MODEL", model_path),
    )


def diagnosis_answer(diagnosis: Diagnosis, prediction: parts.PredictionChange | None, horizon: float) -> str:
    """What is missing, how the prediction over the horizon [s] changes with it, and what validated it."""
    said = [_found(diagnosis, prediction)]
    if diagnosis.effects and prediction is not None:
        said.append(change_sentence(prediction, horizon))
    if diagnosis.cross_validated:
        said.append(
            "Validated without a run of its own: blocks in time of the estimation data, each predicted by the fit to "
            "the others."
        )
    return " ".join(said)


def _found(diagnosis: Diagnosis, prediction: parts.PredictionChange | None) -> str:
    """What is missing, in a sentence or two."""
    if diagnosis.effects:
        return f"{what_is_lacking(diagnosis, fell=prediction is not None and prediction.verdict == 'fell')}."
    if diagnosis.mismatches:
        quiet = "" if diagnosis.rounds else f" {_too_short(diagnosis) or 'In the estimation data no effect is seen.'}"
        return f"{' '.join(mismatch_sentence(m) for m in reported_mismatches(diagnosis))}{quiet}"
    if not diagnosis.rounds:
        return _too_short(diagnosis) or (
            "Nothing is missing: no effect in the catalogue, and no unknown one, is seen in these data."
        )
    one = diagnosis.rounds[-1]
    if diagnosis.untested:
        titles = _listed([u.effect.title for u in diagnosis.untested])
        return f"No effect is confirmed, but what may be missing could not be fitted: {titles}."
    if seen := [r.effect.title for r in diagnosis.removed if r.immaterial]:
        do = "explains" if len(seen) == 1 else "explain"
        return (
            f"Nothing is missing that matters to the prediction: {_listed(seen)} {do} a part of the residuals one step "
            "ahead, and the prediction is as good without."
        )
    why = "what was added does not pay for itself" if one.chosen is not None else one.why  # and was removed
    if min(s.p for s in one.scores) > HARDLY:
        return f"Nothing is missing that these data can show: {_passed(one)} passed the first test, but {why}."
    return f"The residuals are not what the model predicts, but no candidate explains them: {why}."


def _too_short(diagnosis: Diagnosis) -> str:
    """What could not be tested; empty where all could."""
    short = diagnosis.short
    return (
        ""
        if short is None
        else (
            f"No effect is seen, but {short.seconds:.0f} s of estimation data are too short to test "
            f"{short.untestable} of {short.candidates} candidates: give {short.needed:.0f} s or more."
        )
    )


def reported_mismatches(diagnosis: Diagnosis) -> list[ValidationMismatch]:
    """With what would explain them in units of the thrust where its scale is unknown."""
    return [
        m if m.shift is None else replace(m, shift=_reported_shift(m.shift, ReportedEstimates(diagnosis.after.fit)))
        for m in diagnosis.mismatches
    ]


def _reported_shift(shift: ParameterShift, reported: ReportedEstimates) -> ParameterShift:
    """The run was fitted with all else kept, the thrust too: its errors are of this parameter alone."""
    k, scale = reported.factor(shift.unit), reported.scale
    return replace(
        shift, name=scale.name(shift.name, shift.unit), unit=scale.unit(shift.unit), fitted=k * shift.fitted,
        error=k * shift.error, value=k * shift.value, value_error=k * shift.value_error,
    )  # fmt: skip


def mismatch_sentence(m: ValidationMismatch) -> str:
    """Return the sentence on a validation run whose errors exceed the model's, and the shift that explains it."""
    name = NAMES.get(m.channel, m.channel)
    said = (
        f"The model does not hold in {m.record}: its errors one step ahead are {m.scale:.2g} times what the model says "
        f"({name})"
    )
    shift = m.shift
    if shift is None:
        return f"{said}."
    value = f"{shift.value:.4g} ± {shift.value_error:.2g} {shift.unit}".rstrip()
    return f"{said}; {shift.name} = {value} in that run, not {shift.fitted:.4g}, would explain it best."


def _mismatch(m: ValidationMismatch) -> parts.ValidationMismatch:
    found = parts.ValidationMismatch(record=m.record, channel=m.channel, scale=m.scale)
    if m.shift is None:
        return found
    return msgspec.structs.replace(
        found,
        parameter=m.shift.name,
        unit=m.shift.unit,
        fitted=m.shift.fitted,
        value=m.shift.value,
        se=finite(m.shift.value_error),
    )


def _passed(one: Round) -> str:
    """Which candidates passed the score tests, in few words."""
    titles = {r.effect.name: r.effect.title for r in one.refits}
    names = [titles.get(name, name) for name in one.passed]
    return names[0] if len(names) == 1 else f"{len(names)} candidates"


def what_is_lacking(diagnosis: Diagnosis, *, fell: bool) -> str:
    """The beginning of the answer: names that are sure, then likenesses, then what has no name, unless that leads.
    ``fell``: the prediction error over the horizon did; a curve without a name, whose only story is its prediction, is
    else no more than a likeness."""
    titles: dict[str, list[str]] = {"identified": [], "ambiguous": [], "nonparametric": []}
    for r, judged in zip(diagnosis.effects, diagnosis.judgements, strict=True):
        titles[judged.attribution].append(r.effect.title)
    sure, alike, unknown = titles.values()
    if unknown and diagnosis.judgements[0].attribution == "nonparametric":
        found = f"{'The model lacks' if fell else 'What the model lacks resembles'} {_listed(unknown)}"
        rest = [*sure, *(f"something that resembles {title}" for title in alike)]
        return f"{found}, and beside it {_listed(rest)}" if rest else found
    if sure and alike:
        found = f"The model lacks {_listed(sure)}, and something that resembles {_listed(alike)}"
    elif sure:
        found = f"The model lacks {_listed(sure)}"
    else:
        found = f"What the model lacks resembles {_listed(alike)}"
    return f"{found}, and beside it {_listed(unknown)}" if unknown else found


def diagnosis_caveat(diagnosis: Diagnosis) -> str | None:
    """Why a name is not sure, and that the search could have gone on; None where neither is so."""
    reasons = [reason for j in diagnosis.judgements if j.attribution == "ambiguous" for reason in j.reasons]
    said = [f"The name is not sure: {reasons[0]}."] if reasons else []
    if diagnosis.left and diagnosis.untried:
        many = counted(sum(one.chosen is not None for one in diagnosis.rounds), "effect")
        said.append(f"The search ended with {many}, as many as --max-effects allows; not tried: {_left(diagnosis)}.")
    return " ".join(said) or None


def _listed(titles: Sequence[str]) -> str:
    return titles[0] if len(titles) == 1 else ", ".join(titles[:-1]) + " and " + titles[-1]


def _forces(diagnosis: Diagnosis, evaluation: DiagnosisEvaluation) -> tuple[parts.ResidualForce, ...]:
    before, after = (ReportedEstimates(stage.fit) for stage in (diagnosis.before, diagnosis.after))
    changed = bool(diagnosis.effects)
    return tuple(
        parts.ResidualForce(
            record=old.record,
            force=before.scale.name(old.name, old.unit),
            unit=before.scale.unit(old.unit),
            t=old.t,
            mean=before.factor(old.unit) * old.mean,
            sd=before.factor(old.unit) * old.sd,
            after_mean=after.factor(old.unit) * new.mean if changed else None,
            after_sd=after.factor(old.unit) * new.sd if changed else None,
        )
        for old, new in zip(evaluation.forces_before, evaluation.forces_after, strict=True)
    )


def _quiet_round(diagnosis: Diagnosis) -> parts.Round:
    """Of a search in which nothing passed: all that was tested."""
    tested = _round(Round(diagnosis.scores, (), (), None))
    why = "no candidate passes the score tests"
    if (short := diagnosis.short) is not None:
        why += f"; {short.seconds:.0f} s of data are too short to test {short.untestable} of {short.candidates}"
    return msgspec.structs.replace(tested, why=why)


def _round(one: Round) -> parts.Round:
    titles = {n: e.title for n, e in catalogue().items()} | {r.effect.name: r.effect.title for r in one.refits}
    ranked = sorted(one.scores, key=lambda s: -s.lm / max(s.df, 1))
    best = [s for k, s in enumerate(ranked) if k < MOST_CANDIDATES or s.name in one.passed]
    return parts.Round(
        candidates=tuple(
            parts.Candidate(
                name=s.name,
                title=titles.get(s.name, s.name),
                lm=s.lm,
                df=s.df,
                p=s.p,
                p_block=finite(s.p_block),
                generic=s.generic,
                threshold=s.threshold,
                passed=s.name in one.passed,
            )
            for s in best
        ),
        tested=len(one.scores),
        passed=len(one.passed),
        refits=tuple(_refit(r) for r in one.refits),
        untested=tuple(
            parts.UntestedCandidate(name=u.effect.name, title=u.effect.title, reason=u.reason) for u in one.untested
        ),
        chosen=one.chosen.effect.name if one.chosen else None,
        why=one.why,
    )


def _refit(r: Refit) -> parts.Refit:
    return parts.Refit(
        name=r.effect.name,
        title=r.effect.title,
        gain=r.gain,
        df=r.df,
        criterion=r.criterion,
        validation_gain=r.validation_gain,
        t=r.t,
        prediction=None if r.prediction is None else prediction_change(r.prediction, "validation"),
        outcome=cast(parts.RefitOutcome, r.outcome.value),
        parameters=_own(r, r.stage),
    )


def _own(r: Refit, stage: FittedModel) -> tuple[parts.EffectParameter, ...]:
    """The estimates of an effect's parameters; of what differs between runs, how much more than in the first run."""
    reported, rows = ReportedEstimates(stage.fit), []
    for p in r.effect.parameters:
        runs = stage.fit.records if p.per_record else ("",)
        found = [(f", in {run}" if len(runs) > 1 else "", *reported.estimate(p, i)) for i, run in enumerate(runs)]
        if r.effect.kind is EffectKind.BETWEEN_RUNS:
            k = reported.factor(p.unit)
            differences = run_differences(stage.fit, p.name)
            found = [(f", {d.record} against {runs[0]}", k * d.value, k * d.error) for d in differences]
        name, unit = reported.scale.name(p.name, p.unit), reported.scale.unit(p.unit)
        rows += [
            parts.EffectParameter(name=name, meaning=p.meaning + where, unit=unit, value=value, se=finite(error))
            for where, value, error in found
        ]
    return tuple(rows)


def _effects(diagnosis: Diagnosis) -> tuple[parts.EffectRow, ...]:
    """Each effect with its estimate in the final model and its importance, the most important first."""
    rows = []
    rounds = {one.chosen.effect.name: one for one in diagnosis.rounds if one.chosen is not None}
    for r, judged, weight in zip(diagnosis.effects, diagnosis.judgements, diagnosis.weights, strict=True):
        e = r.effect
        rows.append(
            parts.EffectRow(
                name=e.name,
                title=e.title,
                formula=e.formula,
                source=e.source,
                place=e.place,
                experiment=e.experiment,
                alternatives=tuple(
                    parts.Alternative(
                        name=q.effect.name, title=q.effect.title, criterion_behind=r.criterion - q.criterion
                    )
                    for q in rounds[e.name].refits
                    if q is not r
                ),
                attribution=judged.attribution,
                reasons=tuple(judged.reasons),
                not_excluded=tuple(judged.not_excluded),
                parameters=_own(r, diagnosis.after),
                error_ratio_without=finite(weight.error),
                gain_last=finite(weight.gain),
            )
        )
    return tuple(rows)


def _moved(diagnosis: Diagnosis) -> tuple[parts.ParameterChange, ...]:
    before, after = (ReportedEstimates(stage.fit) for stage in (diagnosis.before, diagnosis.after))
    scale, rows = before.scale, []
    for p in before.fit.model.parameters:
        if p.free and not p.per_record:
            (a, sa), (b, sb) = before.estimate(p), after.estimate(p)
            rows.append(
                parts.ParameterChange(
                    name=scale.name(p.name, p.unit),
                    unit=scale.unit(p.unit),
                    before=a,
                    before_se=finite(sa),
                    after=b,
                    after_se=finite(sb),
                )
            )
    return tuple(rows)


def _untested_warnings(diagnosis: Diagnosis) -> list[parts.ResultWarning]:
    said = [f"Not tested, as it could not be fitted: {u.effect.title} ({u.reason})." for u in diagnosis.untested]
    said += [f"Not tested: {u.effect.title} ({u.reason})." for u in diagnosis.refused]
    said += [
        f"What {r.effect.title} is worth beside the others is not known, as the model without it could not be fitted: "
        f"{w.untested}."
        for r, w in zip(diagnosis.effects, diagnosis.weights, strict=True)
        if w.untested is not None
    ]
    found = [parts.ResultWarning(code="effect-untested", text=text) for text in said]
    if diagnosis.undrawn is not None:
        text = f"No curve in place of {diagnosis.undrawn}."
        found.append(parts.ResultWarning(code="curve-not-drawn", text=text))
    return found


def _blocks_note(evaluation: DiagnosisEvaluation) -> list[str]:
    if not evaluation.in_blocks:
        return []
    titles = [e.title for e in evaluation.in_blocks]
    have = "has parameters of its own" if len(titles) == 1 else "have parameters of their own"
    return [
        f"The validation runs are predicted in blocks of time, each with the estimates of the run's other blocks: "
        f"{_listed(titles)} {have} for each run."
    ]


def _not_paying(removed: RemovedEffect) -> str:
    if removed.immaterial:
        return "the prediction is as good without it"
    return "beside the other effects it does not pay on the validation data"


def _left(diagnosis: Diagnosis) -> str:
    return ", ".join(s.name for s in diagnosis.left[:4])


def _notes(diagnosis: Diagnosis) -> list[str]:
    notes = []
    if diagnosis.left and not diagnosis.untried:
        if diagnosis.effects:
            notes.append(f"After the last effect these tests still pass: {_left(diagnosis)}.")
        elif diagnosis.removed:
            notes.append(f"Of the model without effects these tests pass: {_left(diagnosis)}.")
    if diagnosis.effects and diagnosis.rounds[-1].chosen is None:
        why = diagnosis.rounds[-1].why
        notes.append(f"{why[0].upper()}{why[1:]}.")
    notes += [
        f"{r.effect.title} was added and removed again: {_not_paying(r)} (d ln L of the validation data "
        f"{r.validation_gain:.0f}, t = {r.t:.1f})."
        for r in diagnosis.removed
    ]
    if diagnosis.effects:
        notes += [mismatch_sentence(m) for m in reported_mismatches(diagnosis)]
    notes += [f"{name}: {what}" for name, what in diagnosis.after.fit.flags]
    return notes
