"""Builder of the result of a diagnosis (`seatrial ident diagnose`): the answer in sentences, the evidence in tables."""

from __future__ import annotations

import ast
import re
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import degrees, isfinite
from typing import NamedTuple, cast

import msgspec
import numpy as np

from seatrial.daq.errors import counted
from seatrial.ident.diagnosis import (
    CLEAR_CRITERION,
    NAME_RECORDS,
    Diagnosis,
    DiagnosisEvaluation,
    EffectAttribution,
    Outcome,
    Refit,
    RemovedEffect,
    Round,
    ValidationMismatch,
    competitors_of,
    contradicting_signs,
    detectable_sizes,
    is_immaterial,
    is_mission_long,
    is_no_better_prediction,
    reason_without_experiment,
    recommended_experiment,
    removal_reason,
)
from seatrial.ident.effects import catalogue
from seatrial.ident.estimation import Fit, FittedModel, ParameterShift, ReportedEstimates, Role
from seatrial.ident.model import (
    ESTIMATED_CURVE,
    GIVEN_CURVE,
    Effect,
    EffectKind,
    Model,
    ModelKind,
    ParameterOrigin,
    ParameterRole,
)
from seatrial.ident.models import effect_for, force_power
from seatrial.ident.results import parts
from seatrial.ident.results.answers import (
    NAMES,
    calibration_notes,
    change_sentence,
    check_warnings,
    course_sentence,
    estimation_logs,
    failed_run_warnings,
    faults_first,
    frames_assumed,
    late_command_sentence,
    late_sensor_warnings,
    mass_notes,
    not_converged,
    outlier_lines,
    plus_minus,
    poor_channel,
    position_drift_notes,
    prior_notes,
    short_data_warnings,
    simulated_durations,
    sizes_undetermined,
    straight_sentence,
    warm_up_notes,
    wind_sentence,
)
from seatrial.ident.results.candidate_titles import candidate_title
from seatrial.ident.results.data_names import of_judging_data
from seatrial.ident.results.parts import DiagnosisResult, Provenance
from seatrial.ident.results.rival_estimates import with_rival_values
from seatrial.ident.results.tables import (
    LEAST_GROWTH,
    all_inputs,
    calibration_tables,
    common_errors_notes,
    common_errors_row,
    cross_correlations,
    effect_parameter_rows,
    error_tables,
    finite,
    fit_summary,
    format_number,
    inertial_curves,
    listed,
    parameter_label,
    prediction_change,
    residual_rows,
    thrust_difference_warnings,
    thrust_of_notes,
    traces,
    tracks,
)
from seatrial.ident.validation import PredictionEvaluation

MOST_CANDIDATES = 24  # best candidates of a round that are reported; others are reported if they passed
USABLE_ERROR = 0.05  # of the range of force or shaft speed, up to which the thrust curve of a bench can be used
SIGNIFICANT = 2.0  # standard errors from which a value of a curve differs from zero
OPEN_BELOW = 0.95  # ratio of the errors that matters: an interval that reaches below it leaves open if they fell
WORSE_SIMULATION = 1.2  # ratio of the errors of a simulation, from which it is called worse
# Reasons, as clauses, why candidates that still pass were not tried after the last effect.
MOST_NEAREST = 2  # effects that are named if none was added
MOST_SIZES = 2  # sizes of an effect in a sentence
MOST_REMAINING = 4  # candidates that still pass the score test and are given by name
AFTER_CURVE = "after a curve, no second curve is tried"
NOT_TRIED = "explains too little to be tried, and a larger --max-effects tries no more"
AT_BOUND = 1.001  # factor of a lower bound up to which a noise counts as at it
CHANCE_P = 1e-6  # larger p values of the best score test may occur by chance in data without a missing effect


class GivenModel(NamedTuple):
    """Model and weighed mass that were given to a diagnosis, and the file of the model that the diagnosis writes.

    Attributes
    ----------
    diagnosed
        File of the diagnosed model. It has the sizes of all effects that were fitted, which the model that was given
        lacks.
    converged
        Whether the fit of the model that was given converged.
    weighed_mass
        Weighed mass of the boat [kg]; None if it was not given.
    """

    diagnosed: str
    converged: bool = True
    weighed_mass: float | None = None


def diagnosis_result(
    diagnosis: Diagnosis,
    evaluation: DiagnosisEvaluation,
    made: Provenance,
    *,
    warnings: Sequence[parts.ResultWarning],
    notes: Sequence[str],
    given: GivenModel,
    unused: Sequence[parts.UnusedSignal] = (),
    dynamics: parts.Dynamics | None = None,
) -> DiagnosisResult:
    """Return the result of a diagnosis from its findings and its evaluation.

    If the fit without or with the effects did not converge, the answer states that, and there is no caveat. If the logs
    have faults, the answer begins with them.

    Parameters
    ----------
    diagnosis : Diagnosis
        Findings of the search for missing effects.
    evaluation : DiagnosisEvaluation
        Predictions of the models without and with the effects that were added.
    made : Provenance
        Logs, command line, time and software version.
    warnings : sequence of ResultWarning
        Warnings of the fit with the effects.
    notes : sequence of str
        Sentences that precede the other notes of the result, except those which qualify the names of the effects.
    given : GivenModel
        Model that was given to the diagnosis. The file of the diagnosed model replaces MODEL in the command of the
        recommended experiment, which takes the sizes of the effects from it.
    unused : sequence of UnusedSignal
        Signals of the logs that the model does not use.
    dynamics : Dynamics, optional
        Steady motion, poles and step responses of the model with the effects; None if it has none.
    """
    before, after = evaluation.before, evaluation.after
    with_effects, reported = after if diagnosis.effects else None, ReportedEstimates(diagnosis.after.fit)
    factors = {s.unit: reported.factor(s.unit) for s in diagnosis.curves}
    errors, role = error_tables(after, before, evaluation.changes), after.headline_set
    prediction = prediction_change(evaluation.changes[role], role) if diagnosis.effects else None
    failed = not_converged(diagnosis.before.fit) or not_converged(diagnosis.after.fit)
    calibration = calibration_tables(after)
    recommended = recommended_experiment(diagnosis)
    rows = (_round_row(r) for r in diagnosis.rounds)
    in_blocks = diagnosis.cross_validated
    rounds = of_judging_data(tuple(rows), in_blocks)
    effects = of_judging_data(_effect_rows(diagnosis, role), in_blocks)
    bench = diagnosis.after.fit.model.kind is ModelKind.BENCH
    straight = straight_sentence(dynamics, diagnosis.after, [r.effect for r in diagnosis.effects])
    answer, again = "", command_without_validation(made.command)
    if not failed:
        answer = diagnosis_answer(diagnosis, prediction, after.horizon, poor_channel(errors), bench=bench, again=again)
    stability = dynamics.course if dynamics else None
    course = course_sentence(stability, diagnosis.after.fit.model, estimation_logs(made))
    wind = wind_sentence(made, diagnosis.after.fit.model)
    worse = of_judging_data(_worse_simulation_sentence(errors) if diagnosis.effects else "", in_blocks)
    late = late_command_sentence(made) if bench else ""
    before_answer, after_answer = "", ""
    if bench and diagnosis.effects:
        doubted = bool(diagnosis.remaining)
        after_answer = _usable_thrust_sentence(errors, _measured_ranges(after), doubted=doubted, with_effects=True)
    elif bench:
        before_answer = _usable_thrust_sentence(errors, _measured_ranges(after), doubted=bool(diagnosis.rounds))
    return DiagnosisResult(
        **msgspec.structs.asdict(made),
        answer=faults_first(made)
        + (
            failed
            or late + "\n".join(filter(None, [before_answer, answer, after_answer, worse, straight, course, wind]))
        ),
        caveat=None if failed else of_judging_data(diagnosis_caveat(diagnosis, bench=bench), in_blocks),
        prediction=prediction,
        converged_before=diagnosis.before.fit.converged,
        warnings=(
            *check_warnings(made, besides=("channel-smoothed",)),  # the fit has warned; a note has the assumed noise
            *late_sensor_warnings(made, diagnosis.after.fit.model),
            *frames_assumed(diagnosis.after),
            *warnings,
            *of_judging_data(short_data_warnings(diagnosis.after, after.horizon), in_blocks),
            *thrust_difference_warnings(diagnosis.uncertainty, diagnosis.after.fit, given.weighed_mass, diagnosed=True),
            *failed_run_warnings(diagnosis.failed_runs),
            *_untested_warnings(diagnosis),
        ),
        notes=(
            *(assumed_noise_notes(diagnosis.after.fit.model) if diagnosis.effects else ()),
            *of_judging_data(alternative_notes(rounds, effects), in_blocks),
            *notes,
            *thrust_of_notes(diagnosis.after.fit),
            *prior_notes(diagnosis.after.fit),
            *(
                []
                if given.weighed_mass is None
                else mass_notes(diagnosis.after.fit, given.weighed_mass, diagnosis.uncertainty)
            ),
            *_notes(diagnosis, given),
            *refit_error_notes(rounds, effects),
            *_blocks_note(evaluation),
            *outlier_lines(after.estimation_residuals, after.model),
            *of_judging_data(calibration_notes(calibration, after.horizon), in_blocks),
            *warm_up_notes(simulated_durations(after), after.model.kind),
            *position_drift_notes(residual_rows(before, with_effects), diagnosis.after.fit.coloured),
        ),
        fit=with_rival_values(
            fit_summary(diagnosis.after.fit, diagnosis.before.model.values),
            _physical_parameters(diagnosis.before.fit.model),
            diagnosis.attributions,
            diagnosis.rounds,
        ),
        failed_runs=diagnosis.failed_runs,
        cross_validated=diagnosis.cross_validated,
        validated_in_blocks=bool(evaluation.in_blocks),
        mismatches=tuple(_mismatch_row(m) for m in reported_mismatches(diagnosis)),
        excluded_effects=tuple(e.name for e in diagnosis.excluded),
        removed_effects=tuple(
            parts.RemovedEffectRow(
                name=r.effect.name,
                title=r.effect.title,
                validation_gain=r.validation_gain,
                t=r.t,
                prediction=prediction_change(r.prediction, role),
            )
            for r in diagnosis.removed
        ),
        dynamics=dynamics,
        horizon_seconds=after.horizon,
        errors=errors,
        calibration=calibration,
        traces=traces(after, before if diagnosis.effects else None),
        track=tracks(after, before if diagnosis.effects else None),
        inputs=all_inputs(after),
        residuals=residual_rows(before, with_effects),
        cross=cross_correlations(before, with_effects),
        unused_signals=tuple(unused),
        residual_forces=_residual_force_rows(diagnosis, evaluation),
        rounds=rounds or (_quiet_round(diagnosis),),
        common_errors=common_errors_row(diagnosis.common_errors, diagnosis.after, role),
        effects=effects,
        remaining_candidates=tuple(
            parts.RemainingCandidate(name=s.name, lm=s.lm, df=s.df, p=s.p) for s in diagnosis.remaining
        ),
        detectable=_detectable_rows(diagnosis, reported),
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
            for s in diagnosis.curves
        ),
        environment_parameters=_environment_parameters(diagnosis.before.fit.model, reported),
        parameters_before_after=_parameter_change_rows(diagnosis),
        recommended_experiment=None if recommended is None else with_model_of_design(recommended, given.diagnosed),
        no_experiment=(
            with_model_of_design(reason_without_experiment(diagnosis), given.diagnosed) if recommended is None else ""
        ),
    )


def with_model_of_design(text: str, path: str, old: str = "MODEL") -> str:
    """Return a recommended experiment with the file of the model, ``path``, in place of ``old`` in its commands.

    Both are the names of files, which are quoted as a shell needs it.
    """
    command = "`seatrial mission design {} --discriminate "
    return text.replace(command.format(shlex.quote(old)), command.format(shlex.quote(path)))


def diagnosis_answer(
    diagnosis: Diagnosis,
    prediction: parts.PredictionChangeRow | None,
    horizon: float,
    poor: tuple[str, float] | None = None,
    *,
    bench: bool = False,
    again: str = "",
) -> str:
    """Return the answer of a diagnosis: the missing effects, and the change of the prediction errors by them.

    If no effect was added although the model predicts a channel badly, a sentence says so. Another sentence follows if
    the diagnosis was validated by blocked cross-validation instead of separate runs. The last sentence names the
    effects that the user left out of the search.

    Parameters
    ----------
    diagnosis : Diagnosis
        Findings of the search for missing effects.
    prediction : PredictionChangeRow or None
        Change of the prediction errors by the effects. If it is None, or if no effect was added, the answer has no
        sentence on it.
    horizon : float
        Prediction horizon [s].
    poor : tuple of (str, float) or None
        Channel that the model predicts worse than by its mean value, and its fit (negative); None without one.
    bench : bool
        Whether the model is that of a thruster on a bench. No command but the diagnosis fits effects to it.
    again : str
        Command of a diagnosis of all logs together, without validation logs (`command_without_validation`). Empty if
        there is none.
    """
    sentences = [_missing_effects_sentence(diagnosis, prediction, horizon, bench, again)]
    if not diagnosis.effects and (meaning := _two_velocities_sentence(_unexplained(diagnosis))):
        sentences.append(meaning)
    if poor is not None and not diagnosis.effects and diagnosis.rounds:
        sentences.append(
            f"But the model predicts one channel {horizon:g} s ahead worse than its mean value would: {poor[0]}, fit "
            f"{100 * poor[1]:.0f} %. Something is missing that no effect of the catalogue{_or_own(diagnosis)} "
            "describes: look at the residuals in the report, and at what differs between the runs."
        )
    if diagnosis.effects and prediction is not None:
        if prediction.verdict == "unchanged" and (reason := _likelihood_sentence(diagnosis, prediction.role)):
            sentences.append(reason)
        sentences.append(change_sentence(prediction, horizon, diagnosis.cross_validated))
        # An interval without a material improvement decides: the prediction is as good without the effects.
        is_open = prediction.verdict == "unchanged" and prediction.low is not None and prediction.low < OPEN_BELOW
        if is_open and not diagnosis.cross_validated:
            sentences.append(_undecided_sentence(diagnosis, again, bench))
    if diagnosis.cross_validated:
        sentences.append(
            "Without --validate, the model is validated by blocked cross-validation: each block of time of the "
            "estimation data is predicted by a fit to the other blocks."
        )
    if not diagnosis.effects and diagnosis.untried_waves is not None:
        sentences.append(_waves_sentence(diagnosis.untried_waves))
    if diagnosis.excluded:
        effect = "this effect" if len(diagnosis.excluded) == 1 else "one of these effects"
        sentences.append(
            f"Left out of the search (--exclude): {_joined_titles([e.title for e in diagnosis.excluded])}. If the data "
            f"contain {effect}, other effects or the disturbance forces stand for it."
        )
    answer = re.sub(r" *\n *", "\n", " ".join(sentences)).strip()
    return of_judging_data(answer, diagnosis.cross_validated)


def _waves_sentence(frequency: float) -> str:
    """Return the sentence on waves that the residuals show, and that the search did not try."""
    return (
        f"The errors one step ahead have a narrow spectral peak at {format_number(frequency)} Hz, as of waves, or of a "
        "machine or a swinging sensor if only one channel has it. Beside "
        "common errors the search adds no waves, because predictions some seconds ahead are hardly better with them; "
        "`seatrial ident vehicle --effect waves` estimates them, which can improve short predictions and standard "
        "errors, and a diagnosis of that model may find more."
    )


def _measured_ranges(evaluation: PredictionEvaluation) -> dict[str, float]:
    """Return the range of each measured channel in the headline set of an evaluation, in the unit of the channel.

    It is from the 1 % to the 99 % quantile of the samples of all records, which leaves outliers out. Channels without
    samples are left out.
    """
    found: dict[str, float] = {}
    records = [p.record for p in evaluation.sets[evaluation.headline_set].records]
    for j, output in enumerate(evaluation.model.outputs):
        y = np.concatenate([r.y[:, j] for r in records]) if records else np.empty(0)
        if (y := y[np.isfinite(y)]).size:
            found[output.name] = float(np.percentile(y, 99) - np.percentile(y, 1))
    return found


def _usable_thrust_sentence(
    errors: parts.Errors, ranges: Mapping[str, float], *, doubted: bool, with_effects: bool = False
) -> str:
    """Return the sentence that a bench model predicts force and shaft speed well enough to use its thrust curve.

    The errors are those of the simulation from the command, or over the horizon without one, relative to ``ranges``
    (`_measured_ranges`). The text is empty if the force or one of the errors is unknown, or if one of them is more than
    5 % of its range. If the score tests ``doubted`` the model, a clause says that their findings are in these errors.
    ``with_effects``: whether effects were added, with which the model has these errors.
    """
    data = errors.estimation if errors.validation is None else errors.validation
    table, how = (data.simulation, "from the command alone") if data.simulation else (data.horizon, "over the horizon")
    found = []
    for name in (n for n in ("force", "n") if n in table):
        error, size = table[name].after, ranges.get(name, 0.0)
        if error is None or size <= 0.0 or error > USABLE_ERROR * size:
            return ""
        unit, share = f" {table[name].unit}" if table[name].unit else "", f"{100.0 * error / size:.2g}"
        found.append(f"the {NAMES.get(name, name)} within {format_number(error)}{unit} (rms, {share} % of its range)")
    if "force" not in table:
        return ""
    small = f"within {'these small errors' if len(found) > 1 else 'this small error'}"
    rest = f" What the score tests find is {small}." if doubted else ""
    model, its = ("The model with the added effects", "its") if with_effects else ("The model", "the")
    return f"{model} predicts {' and '.join(found)} {how}: {its} thrust curve can be used.{rest}"


def _worse_simulation_sentence(errors: parts.Errors) -> str:
    """Return the sentence that the simulation is worse with the added effects than without; "" if it is not.

    It is worse if the geometric mean of the ratios of the errors of all channels exceeds 1.2. The data are the
    validation data, or the estimation data without such data. The channel with the largest ratio is named.
    """
    role, data = ("estimation", errors.estimation) if errors.validation is None else ("validation", errors.validation)
    ratios = {n: row.after / row.before for n, row in data.simulation.items() if row.before and row.after}
    if not ratios:
        return ""
    mean = float(np.exp(np.mean(np.log(list(ratios.values())))))
    if mean < WORSE_SIMULATION:
        return ""
    name = max(ratios, key=lambda n: ratios[n])
    return (
        f"But the simulation of the {role} data by the inputs alone is worse with them: its error grows by "
        f"{100.0 * (mean - 1.0):.0f} % (mean of all channels), most in {NAMES.get(name, name)}, by "
        f"{100.0 * (ratios[name] - 1.0):.0f} %."
    )


def _likelihood_sentence(diagnosis: Diagnosis, role: str) -> str:
    """Return why effects were added that do not change the prediction over the horizon significantly.

    The sentence gives the gain in log-likelihood of the validation data by each effect. ``role`` is the name of these
    data. The text is empty if no gain is known.
    """
    known = [w for w in diagnosis.importances if isfinite(w.validation_gain) and isfinite(w.t)]
    if not known:
        return ""
    titles = {r.effect.name: r.effect.title for r in diagnosis.effects}
    gains = [f"{titles[w.effect]} by {w.validation_gain:.0f} (t = {w.t:.1f})" for w in known]
    them = "it" if len(gains) == 1 else "them"
    return f"One step ahead the {role} data support {them}: their log-likelihood rises with {_joined_titles(gains)}."


def _missing_effects_sentence(
    diagnosis: Diagnosis, prediction: parts.PredictionChangeRow | None, horizon: float, bench: bool, again: str
) -> str:
    """Return the sentences on the missing effects, or on why no effect was added.

    Without effects, the first of these that applies is stated: there are validation runs that the model does not fit
    (and, if there was no round, a sentence that no effect was found); there was no round (perhaps because the data are
    short); candidates could not be refitted; effects were removed because the prediction is as good without them; the
    smallest p value, above 1e-6, may be by chance; no candidate explains the residuals. ``bench``: whether the model is
    that of a thruster on a bench. ``again``: command of a diagnosis of all logs together; it may be empty.
    """
    if diagnosis.effects:
        lacking = f"{what_is_lacking(diagnosis, fell=_fell_enough(diagnosis, prediction))}."
        return " ".join(filter(None, [lacking, _curves_near_zero_sentence(diagnosis)]))
    if diagnosis.mismatches:
        quiet = (
            ""
            if diagnosis.rounds
            else f" {_short_data_sentence(diagnosis) or 'No effect was found in the estimation data.'}"
        )
        return f"{' '.join(mismatch_sentence(m) for m in reported_mismatches(diagnosis))}{quiet}"
    if not diagnosis.rounds:
        return (
            _short_data_sentence(diagnosis)
            or _small_candidates_sentence(diagnosis, bench)
            or (
                f"No effect is missing: the data show neither an effect of the catalogue{_or_own(diagnosis)} nor a "
                "nonparametric one."
            )
        )
    last, removed = diagnosis.rounds[-1], diagnosis.removed
    if diagnosis.untested:
        titles = _joined_titles([u.effect.title for u in diagnosis.untested])
        return (
            f"No effect is confirmed, but candidates that may be missing could not be fitted: {titles}. The warnings "
            "give the reasons."
        )
    if immaterial := [r for r in diagnosis.removed if is_immaterial(r, diagnosis.policy)]:
        do, them = ("explains", "it") if len(immaterial) == 1 else ("explain", "them")
        titles = _joined_titles([_title_of(r.effect, diagnosis) for r in immaterial])
        sizes = _removed_sentences(diagnosis, immaterial, horizon, bench)
        return (
            f"No effect of the catalogue{_or_own(diagnosis)} improves the prediction: {titles} {do} a part of the "
            f"residuals one step ahead, but the prediction is as good without {them}. {sizes}"
            f"{_stronger_remaining_sentence(diagnosis, immaterial)}"
        )
    # An effect that was chosen in the last round, but is not in the model, was removed by backward elimination.
    why = last.explanation
    if last.chosen is not None:
        why = "; ".join(f"{r.effect.title} was added and removed again: {_removal(r, diagnosis)}" for r in removed)
    strongest = min(last.scores, key=lambda s: s.p)
    if strongest.p > CHANCE_P:
        return f"The data show no missing effect: {_passed_candidates(last)} passed the score test, but {why}."
    nearest, estimate = _nearest_effects(diagnosis, strongest.name, bench)
    failed = "improves the prediction" if last.outcome is Outcome.NO_BETTER_PREDICTION else "explains the residuals"
    return (
        f"The score tests contradict the model (the strongest one: {_score_titles(last)[strongest.name]}, "
        f"{_p_in_words(strongest.p)}), but no candidate {failed}: {why}. {nearest}A score test can "
        "find what the tests of whiteness and of the correlations with the inputs miss. "
        f"{_next_steps(diagnosis, estimate, again, bench)}"
    )


def _or_own(diagnosis: Diagnosis) -> str:
    """Return the addition to "effect of the catalogue" for a search that had user-defined candidates too; else ""."""
    return " or of your own" if diagnosis.own_effects else ""


def _title_of(effect: Effect, diagnosis: Diagnosis) -> str:
    """Return the title of an effect; a user-defined one has its name and the words "your effect" after it."""
    own = effect.name in diagnosis.own_effects
    return f"{effect.title} (your effect {effect.name})" if own else effect.title


def _effects_for_a_fit(diagnosis: Diagnosis) -> set[str]:
    """Return the names of the effects that a fit can take: those of the catalogue, and those of the user."""
    return {*catalogue(), *diagnosis.own_effects}


def _fit_command(names: Sequence[str], diagnosis: Diagnosis) -> str:
    """Return the command that fits a vehicle model with the effects ``names``. User-defined effects need their file."""
    file = "--effects FILE.py " if set(names) & set(diagnosis.own_effects) else ""
    return f"`seatrial ident vehicle {file}{' '.join(f'--effect {name}' for name in names)}`"


def _explained_by(diagnosis: Diagnosis, name: str) -> tuple[str, ...]:
    """Return the names of the candidates that are not tried any more with an added effect in the model."""
    rounds = (r for r in reversed(diagnosis.rounds) if r.chosen is not None and r.chosen.effect.name == name)
    return next((r.explained for r in rounds), ())


def _explains_sentence(diagnosis: Diagnosis, removed: RemovedEffect) -> str:
    """Return the sentence on the candidates that an effect without influence on the prediction makes superfluous.

    The text begins with a space. It is empty if the effect makes none superfluous.
    """
    names = _explained_by(diagnosis, removed.effect.name)
    if not names:
        return ""
    which, tried = ("another candidate", "which is") if len(names) == 1 else ("other candidates", "which are")
    shown = _joined_titles([candidate_title(name) for name in names[:MOST_REMAINING]])
    others = f" and {counted(len(names) - MOST_REMAINING, 'other')}" * (len(names) > MOST_REMAINING)
    return (
        f" It also explains what {which} would otherwise explain, {tried} then too weak to be tried: {shown}{others}."
    )


def _stronger_remaining_sentence(diagnosis: Diagnosis, removed: Sequence[RemovedEffect]) -> str:
    """Return the sentence that a candidate passes more strongly than effects without influence on the prediction.

    Such a candidate makes the names of these effects uncertain. The text begins with a space. It is empty if the
    strongest of the remaining candidates is one of the effects, or if one of the effects explains it.
    """
    name = _unexplained(diagnosis)
    if not name:
        return ""
    refit = _last_refit(diagnosis, name)
    why = "" if refit is None else f" ({_refit_clause(refit)})"
    its = "the name of this effect is" if len(removed) == 1 else "the names of these effects are"
    return (
        f" The strongest candidate of the score tests is another one, and is not in the model either: "
        f"{candidate_title(name)}{why}. So {its} uncertain."
    )


def _unexplained(diagnosis: Diagnosis) -> str:
    """Return the name of the strongest candidate that a diagnosis without effects leaves unexplained; "" without one.

    It is the one with the smallest p value in the last round, or, if effects were removed, the strongest candidate that
    remains. One that may pass by chance does not count, and neither does an effect that was removed although the data
    support it, or a candidate that such an effect explains.
    """
    if not diagnosis.rounds:
        return ""
    last = diagnosis.rounds[-1]
    tested = diagnosis.remaining[:1]
    if last.chosen is None and last.scores and not diagnosis.removed:
        tested = (min(last.scores, key=lambda s: s.p),)
    supported = [r.effect.name for r in diagnosis.removed if is_immaterial(r, diagnosis.policy)]
    known = {*supported, *(name for effect in supported for name in _explained_by(diagnosis, effect))}
    return next((s.name for s in tested if s.p <= CHANCE_P and s.name not in known), "")


def _command_clause(again: str) -> str:
    """Return a command after a colon; empty without one. A call of Python names the logs without their folder."""
    where = " in the folder of the logs" if again.startswith("seatrial.") else ""
    return f"{where}: `{again}`" if again else ""


def _small_candidates_sentence(diagnosis: Diagnosis, bench: bool) -> str:
    """Return the sentences on candidates that pass their score tests, but were too small to be tried; "" without any.

    They are for a search without rounds. ``bench``: whether the model is that of a thruster on a bench.
    """
    if not (small := diagnosis.remaining):
        return ""
    n, known = len(small), _effects_for_a_fit(diagnosis)
    strongest = f"{candidate_title(small[0].name)}, {_p_in_words(small[0].p_block)}"
    if n == 1:
        found = f"1 candidate passes its score test, but explains too little to be tried: {strongest}"
    else:
        found = (
            f"{n} candidates pass their score tests, but each of them explains too little to be tried; the strongest "
            f"is {strongest}"
        )
    use = ""
    if not bench and (names := [s.name for s in small if s.name in known][:1]):
        use = f" {_fit_command(names, diagnosis)} estimates {'it' if names[0] == small[0].name else names[0]}."
    return (
        f"No effect that is large enough to matter is missing: {found}. The standard errors of a fit include what such "
        f"small effects may do.{use}"
    )


def _next_steps(diagnosis: Diagnosis, estimate: str, again: str, bench: bool) -> str:
    """Return what to do after a diagnosis that added nothing: a numbered list of lines, the best step first.

    The order is that of the evidence: all logs together decide about the effects that come nearest, and a fit only
    estimates them. The last step is a longer record.

    Parameters
    ----------
    diagnosis
        Findings of the search, which added no effect.
    estimate
        Step that estimates the effects that come nearest (`_nearest_effects`); it may be empty.
    again
        Command of a diagnosis of all logs together, with those of validation; it may be empty.
    bench
        Whether the model is that of a thruster on a bench.
    """
    of, runs = ("this thruster on the bench", "tests") if bench else ("the boat", "runs")
    steps = []
    if not diagnosis.cross_validated:
        command = _command_clause(again)
        steps.append(
            f"Diagnose all logs of {of} together, without --validate{command}. An effect is then fitted to all of "
            "them, and each block of time is predicted by a fit to the others."
        )
    if estimate:
        steps.append(estimate)
    if diagnosis.untried_waves is not None and not bench:
        steps.append("Fit the model with `--effect waves`, and diagnose that model.")
    add = f"add further logs of {of} to the estimation, or " if diagnosis.cross_validated else ""
    last = f"{add}record longer {runs}, and look at the residuals in the report."
    steps.append(f"If this adds nothing: {last}" if steps else f"{last[0].upper()}{last[1:]}")
    if len(steps) == 1:
        return f"Next: {steps[0][0].lower()}{steps[0][1:]}"
    # A line break at the end, too: the sentences that follow do not belong to the last step.
    return "\n".join(["\nNext steps, in this order:", *(f"{k}. {step}" for k, step in enumerate(steps, 1)), ""])


def _undecided_sentence(diagnosis: Diagnosis, again: str, bench: bool) -> str:
    """Return the verdict and the next step if the validation logs do not decide whether the prediction is better.

    ``again`` is the command of a diagnosis of all logs together, which may be empty. ``bench``: whether the model is
    that of a thruster on a bench.
    """
    one = len(diagnosis.effects) == 1
    effects, do, they, them = ("effect", "is", "it", "it") if one else ("effects", "are", "they", "them")
    command = _command_clause(again)
    return (
        f"So the {effects} {do} found in the data, but these validation logs are too few to decide if {they} "
        f"improve{'s' * one} the prediction. Next, diagnose all logs of {'this thruster' if bench else 'the boat'} "
        f"together, without --validate{command}. Each block of time is then predicted with and without {them}."
    )


def _two_velocities_sentence(name: str) -> str:
    """Return the sentence on the meaning of a force of two velocities that is left unexplained; "" for others.

    ``name`` is that of the strongest candidate, such as ``N(v, r)``. The answer has the sentence if no effect was
    found, whatever the reason, and the caveat has it otherwise.
    """
    if re.fullmatch(r"[XYN]\([uvr], [uvr]\)", name) is None:
        return ""
    return f"What an unexplained {name} means, and what to do: documentation, Theory, Diagnosis, section 11."


def command_without_validation(command: str) -> str:
    """Return the command of a diagnosis whose validation logs join the estimation, as text for reports.

    Parameters
    ----------
    command : str
        Command line of a diagnosis with ``--validate``.

    Returns
    -------
    str
        The command with the logs of ``--validate`` as further logs, and the folder ``--out`` with ``-all`` at its end
        (``diagnosis-all`` by default). Of a call of Python, the call with all logs; a fit that is its model is
        ``fit``. Empty if it is no such command or call, or if a call gives only the number of its logs.
    """
    if command.startswith("seatrial.diagnose("):
        return _call_without_validation(command)
    words = command.split(" ")
    if words[:3] != ["seatrial", "ident", "diagnose"] or not any(w.split("=")[0] == "--validate" for w in words):
        return ""
    words = [w.removeprefix("--validate=") for w in words if w != "--validate"]
    joined = " ".join(words)
    if re.search(r" --out[ =]", joined) is None:
        return f"{joined} --out diagnosis-all"
    return re.sub(r"( --out[ =])(\S+?)/?(?= |$)", r"\1\2-all", joined)


def _call_without_validation(command: str) -> str:
    """Return the call of ``seatrial.diagnose`` whose validation logs join the others; empty if it is no such call."""
    try:
        call = ast.parse(command, mode="eval").body
    except SyntaxError:  # a value without a form in code is described in words
        return ""
    if not isinstance(call, ast.Call) or len(call.args) < 2:
        return ""
    logs, further = call.args[1], next((k.value for k in call.keywords if k.arg == "validate"), None)
    # [25 logs], which is no code, was a syntax error
    if not isinstance(logs, ast.List) or not isinstance(further, ast.List):
        return ""
    model = ast.Name("fit") if isinstance(call.args[0], ast.Call) else call.args[0]
    joined = ast.List([*logs.elts, *further.elts])
    kept = [k for k in call.keywords if k.arg != "validate"]
    return ast.unparse(
        ast.fix_missing_locations(ast.Expression(ast.Call(call.func, [model, joined, *call.args[2:]], kept)))
    )


def _p_in_words(p: float) -> str:
    """Return a p value for a sentence: ``p = 4e-05``; ``p < 1e-300`` if it is too small for a number."""
    return f"p = {p:.1g}" if p > 0.0 else "p < 1e-300"


def _nearest_effects(diagnosis: Diagnosis, strongest: str, bench: bool) -> tuple[str, str]:
    """Return sentences on the effects with a formula that come nearest in a last round without an added effect.

    The second text is the step that estimates them (`_next_steps`).

    The data support them, but the validation data alone neither support nor contradict them (`Round.nearest`, which
    the recommended experiment takes too). The first `MOST_NEAREST` are given, with their sizes in the rough fits. If
    the candidate ``strongest`` of the score tests is not among them, a sentence says why. For a model of the ``bench``,
    further logs are advised, because no fit takes its effects. The first text ends with a space. Both are empty if no
    effect comes near.
    """
    search_round = diagnosis.rounds[-1]
    near = search_round.nearest[:MOST_NEAREST]
    if not near:
        return "", ""
    sizes = [", ".join(filter(None, (sizes_in_words(r.effect, r.fitted), f"t = {r.t:.1f}"))) for r in near]
    each = [f"{_title_of(r.effect, diagnosis)} ({size})" for r, size in zip(near, sizes, strict=True)]
    told = strongest in {r.effect.name for r in near} or _explains_only(search_round, strongest)
    left_out = "" if told else _why_not_near(search_round, strongest)
    them = "them" if len(near) > 1 else "it"
    advice, estimate = "", f"{_fit_command([r.effect.name for r in near], diagnosis)} estimates {them} with the model."
    if bench:
        advice = f"A diagnosis with longer or further logs of the bench decides, and adds {them} if the data agree. "
        estimate = ""
    found = (
        f"The effects that come nearest are {_joined_titles(each)}: the estimation data support them, and the "
        f"validation data are too few to decide. {advice}"
        if len(near) > 1
        else f"The effect that comes nearest is {each[0]}: the estimation data support it, and the validation data are "
        f"too few to decide. {advice}"
    )
    return found + left_out, estimate


def _explains_only(search_round: Round, name: str) -> bool:
    """Return whether `Round.explanation` is about a candidate, with which the prediction is no better.

    ``name`` is the name of the candidate's score.
    """
    no_better = Outcome.NO_BETTER_PREDICTION
    first = next((r for r in search_round.refits if r.outcome is no_better), None)
    return search_round.outcome is no_better and first is not None and first is _refit_of(search_round.refits, name)


def _removal(removed: RemovedEffect, diagnosis: Diagnosis) -> str:
    """Return a clause: why an effect was removed again, with its gain on the validation data beside the others."""
    data = f"the log-likelihood of the validation data {_rises(removed.validation_gain)} with it (t = {removed.t:.1f})"
    return f"{removal_reason(removed, diagnosis.policy)}; {data}"


def _removed_sentences(diagnosis: Diagnosis, removed: Sequence[RemovedEffect], horizon: float, bench: bool) -> str:
    """Return sentences on each effect that the validation data support and that was left out, with its size.

    A single effect has no name in them, because the sentence before names it. ``horizon`` is that of the
    prediction [s]. For a model of the ``bench``, no command is named: none fits effects to it but the diagnosis.
    """
    found = []
    for r in removed:
        refit = _last_refit(diagnosis, r.effect.name)
        size = "" if refit is None else sizes_in_words(refit.effect, refit.fitted)
        use = f"; {_fit_command([r.effect.name], diagnosis)} estimates it with the model"
        known = r.effect.name in _effects_for_a_fit(diagnosis)
        what = "it" if len(removed) == 1 else _title_of(r.effect, diagnosis)
        found.append(
            f"The validation data support {what}{f' ({size})' * bool(size)}: their log-likelihood "
            f"{_rises(r.validation_gain)} (t = {r.t:.1f}).{_explains_sentence(diagnosis, r)} It is left out because "
            f"the prediction {horizon:g} s ahead is no better with it{use * (known and not bench)}."
        )
    return " ".join(found)


def _last_refit(diagnosis: Diagnosis, name: str) -> Refit | None:
    """Return the last refit of the candidate whose score has the name ``name``; None if the search did not refit it."""
    refits = (_refit_of(search_round.refits, name) for search_round in reversed(diagnosis.rounds))
    return next(filter(None, refits), None)


def _strongest_left_out(diagnosis: Diagnosis) -> str:
    """Return the sentence why the strongest remaining candidate that was fitted is not in the model; "" without one.

    Candidates whose fit is noise (`_is_noise`) are not named. If the reason why none was added (`_why_not_added`) names
    the strongest, the text is empty too.
    """
    removed, begin = {r.effect.name: r for r in diagnosis.removed}, "Of those that were fitted"
    for s in diagnosis.remaining:
        refit, gone = _last_refit(diagnosis, s.name), removed.get(s.name)
        if refit is not None:
            if _is_noise(refit, refit.validation_gain if gone is None else gone.validation_gain):
                begin = "Of those that were fitted with a clear size and gain"
                continue
            if gone is None and _explains_only(diagnosis.rounds[-1], s.name):
                return ""  # the reason why none was added is about it
            size = sizes_in_words(refit.effect, refit.fitted)
            why = _refit_clause(refit) if gone is None else f"it was removed again: {_removal(gone, diagnosis)}"
            title = f"{candidate_title(s.name)}{f' ({size})' * bool(size)}"
            return f"{begin}, the strongest is {title}: {why}."
    return ""


def _is_noise(refit: Refit, gain: float) -> bool:
    """Return whether the fit of a candidate says nothing about it.

    Its ``gain`` in log-likelihood of the validation data then rounds to zero, or each of its sizes is smaller than its
    standard error.
    """
    if abs(gain) < 0.5:
        return True
    sizes = [p.name for p in refit.effect.parameters if p.value == 0.0 and not p.per_record]
    if not sizes:
        return False
    rows = [row for row in effect_parameter_rows(refit.effect, refit.fitted) if row.name.removesuffix("/T") in sizes]
    return bool(rows) and all(row.se is not None and abs(row.value) < row.se for row in rows)


def _why_not_near(search_round: Round, name: str) -> str:
    """Return the sentence why the strongest candidate of the score tests is not among the effects that come nearest.

    ``name`` is the name of the candidate's score. The text ends with a space.
    """
    title = _score_titles(search_round)[name]
    r = _refit_of(search_round.refits, name)
    if r is None:
        why = "it was not fitted in this round"
    elif r.is_near:
        why = f"its t is smaller, {r.t:.1f}" if not r.nonparametric else "it is a curve without a formula"
    else:
        why = _refit_clause(r)
    return f"{title[0].upper()}{title[1:]} is not among them: {why}. "


def _refit_of(refits: Iterable[Refit], name: str) -> Refit | None:
    """Return the refit of the candidate whose score has the name ``name``; None if ``refits`` does not contain it.

    A curve's effect is named "unknown", followed by the name of its score.
    """
    return next((r for r in refits if name in (r.effect.name, r.effect.name.removeprefix("unknown "))), None)


def _refit_clause(r: Refit) -> str:
    """Return a clause: why the fit with an effect did not lead to its addition, with the numbers that decided it."""
    data = f"the log-likelihood of the validation data {_rises(r.validation_gain)} (t = {r.t:.1f})"
    match r.outcome:
        case Outcome.NOT_SUPPORTED:
            return f"the estimation data support it too little for its {counted(r.df, 'parameter')}"
        case Outcome.NOT_VALIDATED if r.criterion > CLEAR_CRITERION:
            return f"the validation data do not support it sufficiently: {data}"
        case Outcome.NOT_VALIDATED:
            gained = f"its fit gains {r.gain:.0f} in 2 ln L on the estimation data"
            return f"{gained}, little for {counted(r.df, 'parameter')}, and {data}"
        case Outcome.WORSE_PREDICTION:
            return f"{data}, but the prediction is worse with it"
        case Outcome.NO_BETTER_PREDICTION:
            return f"{data}, but the prediction is no better with it"
        case Outcome.SMALL:
            return f"{data}, but its gain is small beside those of the effects found"
        case _:
            return f"{data}, but another effect of its round was preferred"


def _rises(gain: float) -> str:
    """Return how a log-likelihood changes by an effect: "rises by 44" or "falls by 3"."""
    return f"{'rises' if gain >= 0 else 'falls'} by {abs(gain):.0f}"


def _short_data_sentence(diagnosis: Diagnosis) -> str:
    """Return a sentence: no effect was found, but the estimation data are too short to test some candidates.

    It has the needed length [s] of the data. The text is empty if all candidates could be tested.
    """
    short = diagnosis.short_data
    return (
        ""
        if short is None
        else (
            f"No effect was found, but {short.seconds:.0f} s of estimation data are too short to test "
            f"{short.untestable} of {short.candidates} candidates: give logs of {short.needed:.0f} s or more."
        )
    )


def reported_mismatches(diagnosis: Diagnosis) -> list[ValidationMismatch]:
    """Return the validation runs with larger errors than the model predicts, with numbers in reported units.

    The numbers are those of the parameter change that explains the errors of a run. In reported units they are ratios
    to the thrust if the thrust was not given.
    """
    return [
        m if m.shift is None else replace(m, shift=_reported_shift(m.shift, ReportedEstimates(diagnosis.after.fit)))
        for m in diagnosis.mismatches
    ]


def _reported_shift(shift: ParameterShift, reported: ReportedEstimates) -> ParameterShift:
    """Convert the change of a parameter in one run, with its standard errors, to reported units.

    These are ratios to the thrust if the thrust was not given. The errors need no delta method, because the thrust was
    held while this parameter alone was fitted to the run.
    """
    k, scale = reported.factor(shift.unit), reported.scale
    return replace(
        shift, name=scale.name(shift.name, shift.unit), unit=scale.unit(shift.unit), fitted=k * shift.fitted,
        error=k * shift.error, value=k * shift.value, value_error=k * shift.value_error,
    )  # fmt: skip


def mismatch_sentence(m: ValidationMismatch) -> str:
    """Return the sentence on a validation run whose one-step errors are larger than the model predicts.

    A second sentence has the parameter change that explains the errors best; it is left out if no change does. The
    numbers of ``m`` are printed as they are (see ``reported_mismatches``).
    """
    name = NAMES.get(m.channel, m.channel)
    mismatch = (
        f"The model does not hold in {m.record}: its errors one step ahead are {m.scale:.2g} times the predicted ones "
        f"({name})"
    )
    shift = m.shift
    if shift is None:
        return f"{mismatch}. Check what was different in that run (load, wind, sensors)."
    value = f"{shift.value:.4g} ± {shift.value_error:.2g} {shift.unit}".rstrip()
    return (
        f"{mismatch}. The best explanation is {shift.name} = {value} in that run, instead of {shift.fitted:.4g}. Check "
        "what was different in that run."
    )


def _mismatch_row(m: ValidationMismatch) -> parts.ValidationMismatchRow:
    """Return the table row of a validation run whose one-step errors are larger than the model predicts.

    The numbers of ``m`` are copied. The keys of the parameter change are empty or null if no change explains the
    errors.
    """
    found = parts.ValidationMismatchRow(record=m.record, channel=m.channel, scale=m.scale)
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


def _passed_candidates(last: Round) -> str:
    """Return which candidates passed the score test of a round: the title of a single one, or ``3 candidates``.

    A single candidate without a refit has its name in place of the title.
    """
    titles = {r.effect.name: r.effect.title for r in last.refits}
    names = [titles.get(name, name) for name in last.passed]
    return names[0] if len(names) == 1 else f"{len(names)} candidates"


def _fell_enough(diagnosis: Diagnosis, prediction: parts.PredictionChangeRow | None) -> bool:
    """Return whether the error over the horizon fell significantly, and by as much as an identified effect has to.

    False without a ``prediction``. Beside the common errors, the error without the effects has to be 15 % larger
    (``policy.min_identified_ratio`` of the diagnosis).
    """
    if prediction is None or prediction.verdict != "fell":
        return False
    return 1.0 / prediction.ratio >= diagnosis.policy.min_identified_ratio


def what_is_lacking(diagnosis: Diagnosis, *, fell: bool) -> str:
    """Return the beginning of the answer, ``The model lacks ...``, with the titles of the effects, without a full stop.

    Identified effects come first, then an ambiguous effect as "an effect that resembles ...", several of them as a list
    ("effects that resemble: A; B"), then nonparametric effects. After an ambiguous effect, the text names the best of
    the effects that explain the data as well ("A or, nearly as well, B"), or better. Nonparametric effects come first
    if the most important effect is nonparametric. A curve of which no value differs significantly from zero is left
    out, unless there is no other effect (`_curves_near_zero_sentence`). If ambiguous effects come first, the text
    begins with "The missing effect resembles ...".
    The diagnosis must have at least one effect.

    Parameters
    ----------
    diagnosis : Diagnosis
        Findings of the search for missing effects.
    fell : bool
        Whether the prediction error over the horizon fell enough. If not, and if a nonparametric effect comes first,
        the text is "The missing effect resembles ...", because a better prediction is the only evidence for a curve.
    """
    titles: dict[str, list[str]] = {"identified": [], "ambiguous": [], "nonparametric": []}
    zero = {e.name for e in _curves_near_zero(diagnosis)}
    named = [
        (r, j) for r, j in zip(diagnosis.effects, diagnosis.attributions, strict=True) if r.effect.name not in zero
    ]
    for r, judged in named or zip(diagnosis.effects, diagnosis.attributions, strict=True):
        words = in_words(r.effect, diagnosis.after)
        if _is_size_undetermined(r.effect, diagnosis):
            words = "its size is not determined"
        title = f"{r.effect.title} ({words})" if words else r.effect.title
        rival = _rival_in_words(judged, diagnosis) if judged.attribution == "ambiguous" else ""
        titles[judged.attribution].append(f"{title}{rival}")
    identified, ambiguous, nonparametric = titles.values()
    first = named[0][1] if named else diagnosis.attributions[0]
    if nonparametric and first.attribution == "nonparametric":
        found = f"The model lacks {_joined_titles(nonparametric)}" if fell else _resemblance_clause(nonparametric)
        rest = [*identified, *(f"an effect that resembles {title}" for title in ambiguous)]
        return f"{found}, and also {_joined_titles(rest)}" if rest else found
    if identified and ambiguous:
        found = f"The model lacks {_joined_titles(identified)}, and {_resembling(ambiguous)}"
    elif identified:
        found = f"The model lacks {_joined_titles(identified)}"
    else:
        found = _resemblance_clause(ambiguous)
    comma = ";" if len(ambiguous) > 1 else ","  # after a list whose items are separated by semicolons
    return f"{found}{comma} and also {_joined_titles(nonparametric)}" if nonparametric else found


def _curves_near_zero(diagnosis: Diagnosis) -> list[Effect]:
    """Return the added nonparametric effects of which no value is larger than two standard errors.

    The standard errors include the shifts by other candidates that may be missing, as those of the report do.
    """
    found = []
    for r in diagnosis.effects:
        sizes = [p for p in r.effect.parameters if p.free and p.value == 0.0]
        if r.effect.kind is EffectKind.NONPARAMETRIC and sizes:
            values = (diagnosis.after.fit.estimate(p.name) for p in sizes)
            if all(isfinite(se) and abs(value) < SIGNIFICANT * se for value, se in values):
                found.append(r.effect)
    return found


def _curves_near_zero_sentence(diagnosis: Diagnosis) -> str:
    """Return the sentence on the curves that `what_is_lacking` leaves out; empty without any."""
    curves = _curves_near_zero(diagnosis)
    if not curves:
        return ""
    titles, one = _joined_titles([e.title for e in curves]), len(curves) == 1
    subject = "none of its values differs" if one else "none of their values differs"
    kept = ""
    for w in diagnosis.importances:
        if one and w.effect == curves[0].name and w.prediction is not None and w.prediction.verdict == "fell":
            kept = f", although the prediction error is {100.0 * (1.0 - w.prediction.ratio):.2g} % smaller with it"
    if len(curves) == len(diagnosis.effects):
        return f"But {subject} significantly from zero{kept}: it is not known what is missing."
    return f"The model also has {titles}, but {subject} significantly from zero{kept}."


def _rival_in_words(judged: EffectAttribution, diagnosis: Diagnosis) -> str:
    """Return words on the effect that explains the estimation data as well as an ambiguous effect, or better.

    It was refitted in the same round, is not excluded, and its criterion is not lower than that of the ambiguous effect
    by more than ``policy.max_distance``. Of several, it is the best. The words begin with a space; they are empty
    without such an effect. Effects that the diagnosis has added too do not count.
    """
    added = {r.effect.name for r in diagnosis.effects}
    rounds = (r for r in diagnosis.rounds if r.chosen is not None and r.chosen.effect.name == judged.effect)
    found = next(rounds, None)
    if found is None or found.chosen is None:
        return ""
    rivals = [q for q in found.refits if q.effect.name in judged.not_excluded and q.effect.name not in added]
    rival, distance = max(rivals, key=lambda q: q.criterion, default=None), diagnosis.policy.max_distance
    if rival is None or rival.criterion < found.chosen.criterion - distance:
        return ""
    if rival.criterion > found.chosen.criterion + distance:
        return f" or {rival.effect.title}, which explains the estimation data better"
    return f" or, nearly as well, {rival.effect.title}"


def _is_size_undetermined(effect: Effect, diagnosis: Diagnosis) -> bool:
    """Return whether the data do not determine the size of an added effect, and the prediction is not better with it.

    The sizes are the parameters that are zero without the effect. The size is undetermined if the standard error of
    each of them is more than half of its estimate. The prediction is that over the horizon.
    """
    change = next((w.prediction for w in diagnosis.importances if w.effect == effect.name), None)
    fell = change is not None and change.verdict == "fell"
    if effect.kind is EffectKind.BETWEEN_RUNS or fell:
        return False
    return sizes_undetermined(effect, diagnosis.after)


def _size_on_card(effect: Effect, diagnosis: Diagnosis) -> str | None:
    """Return the size of an added effect in words for its card, which agrees with the answer; None without words."""
    words = in_words(effect, diagnosis.after)
    if words and _is_size_undetermined(effect, diagnosis):
        return f"not determined: each part has a standard error of more than half of it; the estimate is {words}"
    return words or None


def in_words(effect: Effect, fitted: FittedModel) -> str:
    """Return the estimates of an effect as a clause for reports, by the effect's own function ``Effect.in_words``.

    The function gets the estimates of all parameters of the model, in their units. Of a per-record parameter, the
    estimate of the first record is used. ``Effect.in_words_of_data`` takes its place if the effect has one: it also
    gets the last inputs of the estimation records. Parameters of the effect at their bounds are named, because their
    values are no estimates, and so are signs that contradict the title (`Effect.cannot_be_negative`). The text is empty
    if the effect has no such function and no such parameter.

    Parameters
    ----------
    effect : Effect
        Effect of the fitted model.
    fitted : FittedModel
        Fitted model, whose estimates are used.
    """
    words = ""
    if effect.in_words_of_data is not None:
        words = effect.in_words_of_data(_estimates(fitted), _last_inputs(fitted))
    elif effect.in_words is not None:
        words = effect.in_words(_estimates(fitted))
    if ESTIMATED_CURVE in words and _is_curve_given(fitted.fit.model):
        words = words.replace(ESTIMATED_CURVE, GIVEN_CURVE)
    wrong = contradicting_signs(effect, fitted.fit) if effect.cannot_be_negative else {}
    if wrong:
        words = words or " and ".join(_named_size(p) for p in effect_parameter_rows(effect, fitted) if p.name in wrong)
        words += f", a sign that contradicts this name: {_joined_titles([*map(candidate_title, wrong.values())])} "
        words += "has a similar form" if len(wrong) == 1 else "have similar forms"
    if not (effect.parameters and fitted.fit.flags):
        return words
    stuck = [_named_value(p) for p in effect_parameter_rows(effect, fitted) if p.at_bound]
    if not stuck:
        return words
    limit = "is at the limit of this parameter" if len(stuck) == 1 else "are at the limits of these parameters"
    return "; ".join(filter(None, [words, f"{' and '.join(stuck)} {limit}, and so no estimate"]))


def _is_curve_given(model: Model) -> bool:
    """Return whether the thrust curve of a model, c1 and c2, is from a bench test or from the user."""
    curve = [model.parameter(name) for name in ("c1", "c2") if name in model.values]
    given = ParameterOrigin.MEASURED, ParameterOrigin.PRIOR, ParameterOrigin.GIVEN
    return bool(curve) and all(p.provenance in given for p in curve)


def _estimates(fitted: FittedModel) -> dict[str, tuple[float, float]]:
    """Return estimate and standard error of all parameters of a fitted model by name."""
    return {p.name: fitted.fit.estimate(p.name) for p in fitted.fit.model.parameters}


def _last_inputs(fitted: FittedModel) -> dict[str, list[float]]:
    """Return the last value of each input in each estimation record, by name of the input."""
    last: dict[str, list[float]] = {}
    for evaluated in fitted.estimation:
        record = evaluated.record
        for name, value in zip(record.inputs, record.u[-1], strict=True):
            last.setdefault(name, []).append(float(value))
    return last


def sizes_in_words(effect: Effect, fitted: FittedModel) -> str:
    """Return the estimates of an effect as a clause: `in_words`, or its first sizes with their standard errors.

    Sizes are the parameters that are zero without the effect. Of a parameter with a value for each run, no value is
    given. The text is empty if there is no size.
    """
    words = in_words(effect, fitted)
    sizes = [p.name for p in effect.parameters if p.value == 0.0 and not p.per_record]
    if words or not sizes:
        return words
    rows = [row for row in effect_parameter_rows(effect, fitted) if row.name.removesuffix("/T") in sizes]
    return " and ".join(_named_size(row) for row in rows[:MOST_SIZES])


def _named_size(p: parts.EffectParameter) -> str:
    """Return name, value, standard error and unit of a parameter for a sentence: ``x_g = 0.049 ± 0.007 m``."""
    factor, unit = (degrees(1.0), "deg") if p.unit == "rad" else (1.0, p.unit)
    size = plus_minus(factor * p.value, factor * p.se) if p.se else format_number(factor * p.value)
    return f"{p.name} = {size} {unit}".rstrip()


def _named_value(p: parts.EffectParameter) -> str:
    """Return name, value and unit of a parameter for a sentence, an angle in degrees: ``k_heat = 0.9``."""
    value, unit = (degrees(p.value), "deg") if p.unit == "rad" else (p.value, p.unit)
    return f"{p.name} = {value:.3g} {unit}".rstrip()


def _resemblance_clause(titles: Sequence[str]) -> str:
    """Return ``The missing effect resembles TITLE``, the beginning of an answer; for several titles, a list of them."""
    if len(titles) == 1:
        return f"The missing effect resembles {titles[0]}"
    return f"The model lacks {_resembling(titles)}"


def _resembling(titles: Sequence[str]) -> str:
    """Return ``an effect that resembles TITLE``; for several titles, a list with one effect for each of them."""
    return (
        f"an effect that resembles {titles[0]}" if len(titles) == 1 else f"effects that resemble: {'; '.join(titles)}"
    )


def diagnosis_caveat(diagnosis: Diagnosis, *, bench: bool = False) -> str | None:
    """Return the caveat of a diagnosis: uncertain names of effects, and residuals that are left unexplained.

    The text gives the first reason of each uncertain name, and names the experiment that may decide. If the search
    ended by --max-effects, the text gives the number of added effects and the candidates that were not tried. If all
    names are certain and candidates still pass the score test, it gives their number, the strongest one, the reason why
    none was added, and an advice. The result is None if none of these cases applies. ``bench``: whether the model is
    that of a thruster on a bench.
    """
    titles = {r.effect.name: r.effect.title for r in diagnosis.effects}
    doubted = [j for j in diagnosis.attributions if j.attribution == "ambiguous" and j.reasons]
    which = "the missing effect" if len(doubted) == 1 else "one of the missing effects"
    sentences = [
        f"It is not certain that {which} is {titles.get(j.effect, j.effect)}: {j.reasons[0]}." for j in doubted
    ]
    if doubted and recommended_experiment(diagnosis):
        sentences.append(_experiment_sentence(diagnosis, doubted[0]))
    if diagnosis.remaining and diagnosis.untried_scores:
        many = counted(sum(search_round.chosen is not None for search_round in diagnosis.rounds), "effect")
        gone = f", and removed {len(diagnosis.removed)} of them again" if diagnosis.removed else ""
        limit = len(diagnosis.rounds) - len(diagnosis.removed)  # a removed effect does not count
        sentences.append(
            f"The search ended when it had added {many}{gone}: it had reached the largest number of effects, "
            f"--max-effects {limit}; give a larger number to try the other candidates: {_remaining_names(diagnosis)}."
        )
    elif diagnosis.effects and diagnosis.remaining and not doubted:
        sentences += _remaining_sentences(diagnosis, bench)
    left = diagnosis.remaining[0].name if diagnosis.effects and diagnosis.remaining else ""
    if sentences and (meaning := _two_velocities_sentence(left)):
        sentences.append(meaning)
    return " ".join(sentences) or None


def _experiment_sentence(diagnosis: Diagnosis, doubted: EffectAttribution) -> str:
    """Return the sentence on the recommended experiment for the first effect of uncertain name.

    The experiment may decide which effect it is, unless the first reason against the name is a curve, from which no
    experiment distinguishes the effect. The sentence then names the effect from which the experiment distinguishes it.
    It promises nothing about a competing model from which only a mission of over an hour distinguishes the effect.
    """
    experiment = "The recommended experiment (Next experiment, in the report)"
    competitors = competitors_of(diagnosis, doubted)
    titles = {q.effect.name: q.effect.title for r in diagnosis.rounds for q in r.refits}
    long = [name for name in competitors if is_mission_long(diagnosis, doubted.effect, name)]
    others = [name for name in competitors if name not in long]
    sentences = []
    if not competitors or doubted.competitor in others or (others and not doubted.competitor):
        sentences.append(f"{experiment} may decide this.")
    elif others:
        title = titles.get(others[0]) or candidate_title(others[0])
        sentences.append(f"{experiment} distinguishes it from {title}, which the data do not exclude either.")
    sentences += [
        f"A mission of thruster commands is unlikely to distinguish it from {titles[name]} within an hour; Next "
        "experiment, in the report, says what else to look at."
        for name in long
    ]
    return " ".join(sentences)


def _physical_parameters(model: Model) -> list[str]:
    """Return the names of the masses, inertia, damping and thrust coefficients of a model without effects."""
    return [p.name for p in model.parameters if model.role(p.name) is ParameterRole.DYNAMICS and force_power(p.unit)]


def _remaining_sentences(diagnosis: Diagnosis, bench: bool) -> list[str]:
    """Return the sentences on the candidates that still pass their score tests beside the effects found.

    They list the candidates, give the reason why the search added none of them, and recommend what to do next. If the
    candidates were too small to be tried, nothing has to be done. The sentences are for a search that did not end by
    the largest number of effects. ``bench``: whether the model is that of a thruster on a bench.
    """
    n, names = len(diagnosis.remaining), _remaining_names(diagnosis)
    which = f"; the strongest are {names}" if n > MOST_REMAINING else f": {names}"
    if (reason := _why_not_added(diagnosis)) == NOT_TRIED:
        passes, each = ("pass their score tests", "each of them") if n > 1 else ("passes its score test", "it")
        included = ". The standard errors include how far such a candidate would shift an estimate"
        return [
            f"{counted(n, 'more candidate')} {passes}{which}. Nothing has to be done about this: {each} {reason}"
            f"{included if diagnosis.uncertainty is not None else ''}."
        ]
    kept = {r.effect.name for r in diagnosis.removed} & {s.name for s in diagnosis.remaining}
    none = f"The search {'kept' if kept else 'added'} none of them"
    if n == 1:
        none = f"The search did not {'keep' if kept else 'add'} it"
    if _lacks_second_curve(diagnosis) and diagnosis.rounds[-1].chosen is not None:
        advice = "To try another curve, run `seatrial ident diagnose` with the model of this diagnosis."
    elif _ended_by_removal(diagnosis):
        advice = "To try them, run `seatrial ident diagnose` with the model of this diagnosis."
    elif recommended_experiment(diagnosis):
        advice = "To find out, record the recommended experiment (Next experiment, in the report), and diagnose again."
    else:
        advice = (
            f"To find out, give all logs of {'this thruster on the bench' if bench else 'the boat'}, or record longer "
            f"and more varied {'tests' if bench else 'runs'}, and diagnose again with their logs."
        )
    use = "The model can be used: its standard errors include how far such a candidate would shift an estimate."
    return [
        "The effects found do not explain the residuals in full: beside them the score tests still find "
        f"{counted(n, 'candidate')}{which}.",
        f"{none}, because {reason}.",
        *filter(None, [_strongest_left_out(diagnosis)]),
        *([use] if diagnosis.uncertainty is not None else []),
        advice,
    ]


def _joined_titles(titles: Sequence[str]) -> str:
    """Join the titles of one or more effects for a sentence, by commas (or semicolons) and a final "and"."""
    return listed(titles, "and")


def _residual_force_rows(diagnosis: Diagnosis, evaluation: DiagnosisEvaluation) -> tuple[parts.ResidualForce, ...]:
    """Return the smoothed disturbance forces without the effects and, if effects were added, with them.

    There is one row for each record and force, in reported units: ratios to the thrust if the thrust was not given. If
    no effects were added, the columns of the forces with effects are None.
    """
    before, after = (ReportedEstimates(fitted.fit) for fitted in (diagnosis.before, diagnosis.after))
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


def _quiet_round(diagnosis: Diagnosis) -> parts.RoundRow:
    """Return the table row of a search without rounds.

    It has the best 24 score tests. Its reason for the end of the search is that no candidate passes, or that those that
    pass are too small to be tried. The reason also has the number of candidates for which the data were too short, if
    there are any.
    """
    passed = tuple(s.name for s in diagnosis.remaining)
    tested = _round_row(Round(diagnosis.scores, passed, (), None))
    why = (
        "each candidate that passes explains too little to be tried"
        if passed
        else "no candidate passes the score tests"
    )
    if (short := diagnosis.short_data) is not None:
        why += f"; {short.seconds:.0f} s of data are too short to test {short.untestable} of {short.candidates}"
    return msgspec.structs.replace(tested, why=why)


def _score_titles(search_round: Round) -> dict[str, str]:
    """Return the titles of the tested candidates of a round by their names, those of curves in words."""
    titles = {r.effect.name: r.effect.title for r in search_round.refits}
    return {s.name: titles.get(s.name) or candidate_title(s.name) for s in search_round.scores}


def _round_row(search_round: Round) -> parts.RoundRow:
    """Return the table row of one round of the search: score tests, refits and the choice of the added effect.

    The score tests are those of the 24 best candidates and of all others that passed, best first. The best candidates
    have the largest statistic per degree of freedom.
    """
    titles = _score_titles(search_round)
    ranked = sorted(search_round.scores, key=lambda s: -s.lm / max(s.df, 1))
    best = [s for k, s in enumerate(ranked) if k < MOST_CANDIDATES or s.name in search_round.passed]
    return parts.RoundRow(
        candidates=tuple(
            parts.Candidate(
                name=s.name,
                title=titles[s.name],
                lm=s.lm,
                df=s.df,
                p=s.p,
                p_block=finite(s.p_block),
                generic=s.nonparametric,
                threshold=s.threshold,
                passed=s.name in search_round.passed,
            )
            for s in best
        ),
        tested=len(search_round.scores),
        passed=len(search_round.passed),
        refits=tuple(_refit_row(r) for r in search_round.refits),
        untested=tuple(
            parts.UntestedCandidateRow(name=u.effect.name, title=u.effect.title, reason=u.reason)
            for u in search_round.untested
        ),
        chosen=search_round.chosen.effect.name if search_round.chosen else None,
        why=search_round.explanation,
    )


def _refit_row(r: Refit) -> parts.RefitRow:
    """Return the table row of one refit of the search: gains, outcome, and estimates of the added effect.

    The change of the prediction errors has the role ``validation``, also if blocks of the estimation data were
    validated.
    """
    return parts.RefitRow(
        name=r.effect.name,
        title=r.effect.title,
        gain=r.gain,
        df=r.df,
        criterion=r.criterion,
        validation_gain=r.validation_gain,
        t=r.t,
        prediction=None if r.prediction is None else prediction_change(r.prediction, "validation"),
        outcome=cast(parts.RefitOutcome, r.outcome.value),
        parameters=effect_parameter_rows(r.effect, r.fitted),
    )


def _effect_rows(diagnosis: Diagnosis, role: Role) -> tuple[parts.EffectRow, ...]:
    """Return one table row for each added effect, the most important first.

    It has the attribution, the estimates in the final model, the competing models and the importance of the effect. The
    competing models are the other refits of the round that added the effect. ``role`` names the data on which the
    importance was computed: validation data, or estimation data if there are no validation data.
    """
    rows = []
    rounds = {
        search_round.chosen.effect.name: search_round
        for search_round in diagnosis.rounds
        if search_round.chosen is not None
    }
    for r, judged, weight in zip(diagnosis.effects, diagnosis.attributions, diagnosis.importances, strict=True):
        e = r.effect
        rows.append(
            parts.EffectRow(
                name=e.name,
                title=e.title,
                formula=e.formula,
                source=e.source,
                place=e.place,
                experiment=e.experiment,
                causes=e.causes,
                alternatives=tuple(
                    parts.Alternative(
                        name=q.effect.name,
                        title=q.effect.title,
                        criterion_behind=r.criterion - q.criterion,
                        why_not=_why_not_chosen(q) if q.criterion > r.criterion else "",
                    )
                    for q in rounds[e.name].refits
                    if q is not r
                ),
                attribution=judged.attribution,
                reasons=tuple(judged.reasons),
                probability=_name_probability(diagnosis, judged.attribution),
                not_excluded=tuple(judged.not_excluded),
                parameters=effect_parameter_rows(r.effect, diagnosis.after),
                in_words=_size_on_card(r.effect, diagnosis),
                prediction=None if weight.prediction is None else prediction_change(weight.prediction, role),
                error_ratio_without=finite(weight.error_ratio),
                gain_last=finite(weight.gain),
            )
        )
    return tuple(rows)


def _why_not_chosen(q: Refit) -> str:
    """Return a clause: why a refit was not chosen in its round, although its criterion is larger than the chosen one's.

    The criterion judges the estimation data only.
    """
    reasons = {
        Outcome.NOT_VALIDATED: "the validation data do not support it sufficiently",
        Outcome.WORSE_PREDICTION: "the prediction is worse with it",
        Outcome.NO_BETTER_PREDICTION: "the prediction is no better with it",
    }
    preferred = "it is a curve, and an effect with a formula is preferred"
    return reasons.get(q.outcome, preferred if q.nonparametric else "its prediction errors are larger")


def _name_probability(diagnosis: Diagnosis, attribution: str) -> float | None:
    """Return the share of names with this attribution that were right on simulated boats with known effects.

    None for a nonparametric curve, which has no name, and for models of thrusters, which the study does not have.
    """
    record = NAME_RECORDS.get(attribution) if diagnosis.after.model.kind is ModelKind.VEHICLE else None
    return None if record is None else record.probability


def _detectable_rows(diagnosis: Diagnosis, reported: ReportedEstimates) -> tuple[parts.DetectableEffect, ...]:
    """Return the smallest sizes of catalogue effects that the score tests would find, one row for each effect by name.

    The effects are those that were tested on the last model. Added effects and those outside the catalogue are left
    out. Sizes are in reported units. Of a parameter with its own value in each run, the largest of the sizes is given,
    that of the run that shows the effect worst. A parameter that could not be tested, or whose size no boat has, has no
    size.
    """
    n, effects = sum(v.record.n_rows for v in diagnosis.after.estimation), catalogue()
    added, rows = {r.effect.name for r in diagnosis.effects}, []
    scaled = [p for effect in effects.values() for p in effect_for(diagnosis.after.model, effect).parameters]
    prior_sds = {p.name: p.prior[1] for p in scaled if p.prior is not None}
    found_sizes = detectable_sizes(diagnosis.scores, n, diagnosis.policy, prior_sds)
    for found in sorted(found_sizes, key=lambda d: d.effect):
        effect = effects.get(found.effect)
        if effect is None or effect.name in added:
            continue
        sizes = []
        for p in effect.parameters:
            own = [size for name, size in found.sizes.items() if name.partition("@")[0] == p.name]
            if own:
                name, unit = reported.scale.name(p.name, p.unit), reported.scale.unit(p.unit)
                size = reported.factor(p.unit) * max(own)
                sizes.append(parts.DetectableSize(name=name, meaning=p.meaning, unit=unit, size=size))
        rows.append(parts.DetectableEffect(name=effect.name, title=effect.title, sizes=tuple(sizes)))
    return tuple(rows)


def _environment_parameters(model: Model, reported: ReportedEstimates) -> tuple[str, ...]:
    """Return the names, as in the table of the fit, of the parameters of environment effects of the given ``model``.

    These are the shared free parameters of effects such as waves. Disturbance forces are left out.
    """
    effects = [e for e in model.effects if e.place == "environment" and not e.kind.nuisance]
    own = [model.parameter(p.name) for e in effects for p in e.parameters]
    return tuple(reported.scale.name(p.name, p.unit) for p in own if p.free and not p.per_record)


def _parameter_change_rows(diagnosis: Diagnosis) -> tuple[parts.ParameterChange, ...]:
    """Return the estimates of parameters before and after the effects were added, one row for each parameter.

    The parameters are the free parameters of the model without effects that all records share; per-record parameters
    are left out. Estimates are in reported units: ratios to the thrust if the thrust was not given. A standard error
    that is not finite is None.
    """
    before, after = (ReportedEstimates(fitted.fit) for fitted in (diagnosis.before, diagnosis.after))
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
    """Return one warning for each candidate, effect or curve of a diagnosis that could not be tested or fitted.

    Candidates could not have a score test or a refit. The importance of an effect is unknown if the model without it
    could not be fitted. A nonparametric curve could not be fitted in place of an ambiguous effect.
    """
    texts = [
        f"This effect may be there, but it could not be fitted: {u.effect.title} ({u.reason}). Longer logs may help."
        for u in diagnosis.untested
    ]
    texts += [f"This effect was not tested: {u.effect.title} ({u.reason})." for u in diagnosis.untestable]
    texts += [
        f"The importance of {r.effect.title} is unknown, because the model without it could not be fitted: "
        f"{w.untested}. Its place in the order of the effects has no meaning."
        for r, w in zip(diagnosis.effects, diagnosis.importances, strict=True)
        if w.untested is not None
    ]
    found = [parts.ResultWarning(code="effect-untested", text=text) for text in texts]
    if diagnosis.curve_failure is not None:
        text = (
            f"No nonparametric curve could be fitted in place of {diagnosis.curve_failure}. The figure of this curve "
            "is missing; the other results do not depend on it."
        )
        found.append(parts.ResultWarning(code="curve-not-drawn", text=text))
    return found


def _blocks_note(evaluation: DiagnosisEvaluation) -> list[str]:
    """Return the note that validation runs are predicted in blocks of time, because of effects with per-record values.

    Each block is predicted with the values that fit the other blocks of its run. The list is empty if no added effect
    has parameters with a separate value for each run, or if there are no validation runs.
    """
    if not evaluation.in_blocks:
        return []
    titles = [e.title for e in evaluation.in_blocks]
    have = "has" if len(titles) == 1 else "have"
    return [
        f"The validation runs are predicted in blocks of time, each with the estimates from the other blocks of its "
        f"run, because {_joined_titles(titles)} {have} separate parameters for each run."
    ]


def _remaining_names(diagnosis: Diagnosis) -> str:
    """Return the titles of the best four candidates that still pass the score test, separated by semicolons.

    They are fewer if fewer pass; the text is empty if none passes.
    """
    return "; ".join(candidate_title(s.name) for s in diagnosis.remaining[:MOST_REMAINING])


def alternative_notes(rounds: Sequence[parts.RoundRow], effects: Sequence[parts.EffectRow]) -> list[str]:
    """Return a note for each effect whose declared alternative also explains the data, but less.

    For example, a thrust mismatch and a yaw moment both turn the boat. The alternative is the one of
    `Effect.alternatives` that explains most in the round that added the effect. It has to have a positive criterion. It
    is left out if it is in the model too, or among those that are not excluded, which have a reason of their own.
    """
    catalogued, found = catalogue(), []
    added = {e.name for e in effects}
    for effect in effects:
        alternatives = catalogued[effect.name].alternatives if effect.name in catalogued else ()
        open_names = {*alternatives} - added - {*effect.not_excluded}
        for x in (x for x in rounds if x.chosen == effect.name):
            own = next(r.criterion for r in x.refits if r.name == effect.name)
            rivals = [r for r in x.refits if r.name in open_names and 0.0 < r.criterion < own]
            if rivals:
                best = max(rivals, key=lambda r: r.criterion)
                found.append(
                    f"In place of {effect.title}, the search also fitted {best.title} ('{best.name}'): its "
                    f"ΔBIC on the estimation data is {own - best.criterion:.0f} worse."
                )
    return found


def refit_error_notes(rounds: Sequence[parts.RoundRow], effects: Sequence[parts.EffectRow]) -> list[str]:
    """Return a note if a parameter of an effect has a larger standard error in the answer than in the refit, or none.

    Errors of the answer include other candidates that may be missing, those of a refit do not. The note has the
    parameter whose error differs most, if the factor is above 1.05. It is left out if no error does.
    """
    after = {(e.name, q.name): q for e in effects for q in e.parameters}
    pairs = [
        (q, after.get((r.name, q.name))) for x in rounds for r in x.refits if r.name == x.chosen for q in r.parameters
    ]
    known = [(late.se / q.se, q, late) for q, late in pairs if late and q.se and late.se]
    factor, early, late = max(known, key=lambda row: row[0], default=(0.0, None, None))
    if early is None or late is None or factor < LEAST_GROWTH:
        return []
    return [
        "The standard errors of an effect in the refits of the rounds are those of this fit alone. Those in the "
        "answer, and in model.toml, are of the model with all effects, and include the shifts by other candidates that "
        f"may be missing: of {late.name} {early.se:.2g} in the refit and {late.se:.2g} {late.unit}".rstrip()
        + " in the answer. Use those of the answer."
    ]


def assumed_noise_notes(model: Model) -> list[str]:
    """Return a note on each noise at its assumed lower bound, on which the names of effects can depend; often none.

    The log does not show the noise of a smoothed signal, so its lower bound is assumed. ``model`` has the estimates as
    its values.
    """
    named = {o.noise: o.name for o in model.outputs}
    return [
        f"The noise {p.name} of {named[p.name]} is at its assumed bound, {p.bounds[0]:.3g} {p.unit}, and the names of "
        f"the effects can depend on it. To test this, fit the model again with --fix {p.name}={0.5 * p.bounds[0]:.3g} "
        f"and with --fix {p.name}={2.0 * p.bounds[0]:.3g}, and repeat the diagnosis of each: a name that stays does "
        "not depend on it."
        for p in model.parameters
        if p.free and p.name in named and 0.0 < p.value <= AT_BOUND * p.bounds[0]
    ]


def _model_for_use(diagnosis: Diagnosis, given: GivenModel) -> str:
    """Return the sentences that name the model for use after a diagnosis without an added effect.

    A model whose fit did not converge is not for use.
    """
    if given.converged:
        return (
            "For use, take the model that was given to the diagnosis: here it is fitted again by plain maximum "
            "likelihood, and its predictions can be slightly worse."
        )
    if diagnosis.after.fit.converged:
        return (
            "Do not use the model that was given to the diagnosis: its fit did not converge. Here it is fitted again "
            "by plain maximum likelihood, and this fit converged. For use, take the model.toml of this diagnosis, and "
            "check its parameters: what kept the first fit from converging can also bias them, such as a clock step or "
            "a stuck signal (seatrial check LOG)."
        )
    return (
        "Do not use the model that was given to the diagnosis, nor that of this diagnosis: neither fit converged. "
        "First look for a fault of the logs (seatrial check LOG), then fit a model with fewer free parameters."
    )


def _notes(diagnosis: Diagnosis, given: GivenModel) -> list[str]:
    """Return the notes of a diagnosis of a given model, in this order.

    They are about the names of the effects, common errors in the model, candidates that signals contradict, candidates
    that still pass the score test, the reason why the search ended, effects that were removed again, validation runs
    that the model does not fit (without effects, the answer has them), which model to use without effects, and
    parameters with a flag. A note that does not apply is left out.
    """
    own = [r.effect.name for r in diagnosis.effects if r.effect.name in diagnosis.own_effects]
    known = [r for r in diagnosis.effects if r.effect.name in catalogue() or r.effect.name in own]
    named = [f"{r.effect.name} ({r.effect.title})" for r in known]
    file = f" ({', '.join(own)}: with --effects FILE.py, your file)" if own else ""
    notes = [f"Names for --effect: {', '.join(named)}{file}."] if named else []
    notes += common_errors_notes(diagnosis.common_errors, "the effects", diagnosis.rejected_common_errors)
    notes += [f"The data exclude {r.effect.title}, which was not tested: {r.reason}." for r in diagnosis.refuted]
    if diagnosis.effects and diagnosis.untried_waves is not None:
        notes.append(_waves_sentence(diagnosis.untried_waves))
    if diagnosis.remaining and not diagnosis.untried_scores:
        if diagnosis.effects:
            again = ""
            if _lacks_second_curve(diagnosis):
                again = (
                    f" {AFTER_CURVE[0].upper()}{AFTER_CURVE[1:]}: to try one, run `seatrial ident diagnose` with the "
                    "model of this diagnosis."
                )
            elif diagnosis.rounds[-1].chosen is not None:
                reason = _why_not_added(diagnosis)
                again = f" They were not tried beside these effects: {reason}."
                if reason == NOT_TRIED:
                    again = f" Nothing has to be done about this: each of them {NOT_TRIED}."
            notes.append(
                "These candidates still pass the score test after the last effect, but none of them is in the model: "
                f"{_remaining_names(diagnosis)}.{again}"
            )
        elif diagnosis.removed:
            notes.append(
                "These candidates pass the score test of the model without effects, but none of them is in the model: "
                f"{_remaining_names(diagnosis)}."
            )
    last = diagnosis.rounds[-1] if diagnosis.rounds else None
    # A reason for ambiguity says already that the prediction is no better with this candidate.
    doubts = [j.competitor for j in diagnosis.attributions if j.attribution == "ambiguous" and j.competitor]
    told = any(is_no_better_prediction(name, diagnosis.rounds) for name in doubts)
    if diagnosis.effects and last is not None and last.chosen is None and not told:
        why = diagnosis.rounds[-1].explanation
        notes.append(f"{why[0].upper()}{why[1:]}.")
    notes += [f"{r.effect.title} was added and removed again: {_removal(r, diagnosis)}." for r in diagnosis.removed]
    if diagnosis.effects:
        notes += [mismatch_sentence(m) for m in reported_mismatches(diagnosis)]
        notes += inertia_curve_notes([e.effect for e in diagnosis.effects])
    else:
        notes.append(f"No effect was added. {_model_for_use(diagnosis, given)}")
    return [*of_judging_data(notes, diagnosis.cross_validated), *_flag_notes(diagnosis.after.fit)]


def inertia_curve_notes(effects: Iterable[Effect]) -> list[str]:
    """Return a note for each added curve over a product of velocities that the inertia of a turning boat contains too.

    ``effects`` are the added effects. The data of a turn cannot tell the curve from an error of the mass.
    """
    notes = []
    for curve, product, masses in inertial_curves(effects):
        both = " and ".join(masses)
        notes.append(
            f"The curve {curve.force}({curve.variables}) has the form of the inertial force {product} of a turning "
            f"boat: it can stand for an error of {both}. Do not take {both} of this model as physical."
        )
    return notes


def _why_not_added(diagnosis: Diagnosis) -> str:
    """Return the reason, as a clause, why the candidates that still pass were not added to the effects found.

    The search did not end because of the largest number of effects.
    """
    last = diagnosis.rounds[-1]
    if last.chosen is None:
        return last.explanation
    if _lacks_second_curve(diagnosis):
        return AFTER_CURVE
    if _ended_by_removal(diagnosis):
        return f"it ended when it removed {_joined_titles([r.effect.title for r in diagnosis.removed])} again"
    return NOT_TRIED


def _ended_by_removal(diagnosis: Diagnosis) -> bool:
    """Return whether the search ended with a removal, so that the candidates pass on a model that was not tried."""
    return bool(diagnosis.removed) and diagnosis.rounds[-1].chosen is not None


def _lacks_second_curve(diagnosis: Diagnosis) -> bool:
    """Return whether a curve was added and another curve still passes its score test."""
    has_curve = any(e.effect.kind.nonparametric for e in diagnosis.effects)
    return has_curve and any(s.nonparametric for s in diagnosis.remaining)


def _flag_notes(fit: Fit) -> list[str]:
    """Return one note for each flag of parameters (`Fit.flags`), with the names of all parameters that have it."""
    if not fit.flags:
        return []
    labels = {p.full_name: parameter_label(p, fit) for p in fit.parameters}
    named: dict[str, list[str]] = {}
    for name, flag in fit.flags:
        named.setdefault(flag, []).append(labels.get(name, name))
    return [f"Parameter{'s' * (len(names) > 1)} {', '.join(names)}: {flag}" for flag, names in named.items()]
