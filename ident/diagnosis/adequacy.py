"""Attribution of selected effects (identified or ambiguous), and the recommended experiment.

An effect may improve a model a great deal and still be the wrong effect. If the true effect is not in the catalogue,
a competing effect takes its place. The remaining residual distinguishes them: the right effect leaves only the small
difference between its true form and that of the catalogue. So the score tests are repeated after the last effect. An
effect is *identified* only if all of these hold:

- the remaining tests find little compared with what the effects explain;
- no nonparametric curve was needed in addition;
- the signs of its parameters agree with its name;
- no competing model comes close, could not be tested, or is explained by the estimated parameters of the model;
- the prediction of validation data is better with the effect;
- data and fit have no other weakness.

Otherwise the effect is *ambiguous*.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np

from seatrial.ident.diagnosis.acceptance import improves_prediction, is_accepted, is_validated
from seatrial.ident.diagnosis.common_errors import HULL_FORM
from seatrial.ident.diagnosis.findings import Diagnosis, EffectAttribution, EffectImportance, Outcome, Refit, Round
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY, SearchPolicy
from seatrial.ident.diagnosis.score_test import Score
from seatrial.ident.effects import catalogue, is_special_case, separating_experiment
from seatrial.ident.estimation import AT_BOUND, Fit, FittedModel, ReportedEstimates
from seatrial.ident.experiment_design import RELIABLE_T, reason_without_mission
from seatrial.ident.model import Effect, EffectKind, ModelKind, Parameter, ParameterOrigin
from seatrial.ident.models import SENSOR_ERRORS, THRUST_LOSSES

HEADING_ERROR, YAW_RATE = "psi", "r"  # sensor error that is a curve, and channel of another sensor
MOST_ADVISED = 3  # candidates that the advice on an experiment names
MOST_SIZES = 4  # sizes of an effect that a reason for ambiguity lists
CLEAR_SIGN = 2.0  # standard errors from zero, from which the sign of an estimate is known
LONGEST_MISSION_S = 3600.0  # s: a longer mission is not recommended
# Difference of two fits in 2 ln L that decides between them. It is twice that of a designed mission: of the present
# data, the effect that fits better was chosen, so that their difference is partly chance.
SURE_DIFFERENCE = 2.0 * RELIABLE_T
SIZE_IS_KNOWN = 1.96  # standard errors from zero, from which the 95 % interval of a size does not contain zero


class Reason(NamedTuple):
    """Reason for an ambiguous attribution.

    Attributes
    ----------
    text
        Clause for reports.
    effect
        Name of the other effect or curve that the clause is about; empty if it is about none.
    """

    text: str
    effect: str = ""


@dataclass(frozen=True)
class AttributionEvidence:
    """Evidence for the attribution of effects, beside the rounds of the search.

    Attributes
    ----------
    remaining
        Scores that still pass after the last effect, the largest criterion first.
    n
        Number of rows of the estimation data, for the penalty ``df ln n`` of a score.
    untested
        Names of effects that were not tested, because the data lack one of their inputs or have no common origin.
    importances
        Importance of each effect. For an effect without an entry, the prediction is no reason for ambiguity.
    reservations
        Reasons, as clauses, why no effect can be identified on these data.
    after
        Last fitted model, whose estimates are judged. None: the estimates of an effect are those of its own refit.
    nominal
        Scores on the model without effects. An effect with a ``Score.tolerance`` below ``policy.min_tolerance`` is
        explained by the estimated parameters: a change of them has nearly the same influence on the outputs, so that
        its score test has no power.
    unaffected, beside
        Names of the effects that keep their size if the strongest remaining candidates are fitted with them, and names
        of these candidates.
    """

    remaining: Sequence[Score]
    n: int
    untested: Collection[str] = ()
    importances: Sequence[EffectImportance] = ()
    reservations: Sequence[str] = ()
    after: FittedModel | None = None
    nominal: Sequence[Score] = ()
    unaffected: frozenset[str] = frozenset()
    beside: frozenset[str] = frozenset()


def assess_alternatives(
    rounds: Sequence[Round], evidence: AttributionEvidence, policy: SearchPolicy = DEFAULT_POLICY
) -> tuple[EffectAttribution, ...]:
    """Attribute each effect that the search added: identified, ambiguous or nonparametric.

    Parameters
    ----------
    rounds
        Rounds of the search. Rounds without a chosen effect are skipped.
    evidence
        Remaining scores, importances, and weaknesses of data and fit.
    policy
        Thresholds of the attribution.

    Returns
    -------
    tuple of EffectAttribution
        Attribution of each chosen effect, in the order of the rounds. A parametric effect is ambiguous if there is at
        least one reason. Each attribution also names the competing models that are not excluded.
    """
    found = []
    for search_round in rounds:
        if search_round.chosen is None:
            continue
        name = search_round.chosen.effect.name
        others = [q.effect.name for q in _competing_refits(search_round, policy)]
        if search_round.chosen.nonparametric:
            found.append(EffectAttribution(name, "nonparametric", (), tuple(others)))
            continue
        remaining_reasons, still_found = _remaining_test_reasons(search_round, rounds, evidence, policy)
        reasons = [*remaining_reasons, *_own_reasons(search_round, rounds, evidence, policy)]
        if reasons:
            reasons += _insignificant_prediction_reasons(name, evidence.importances, policy)
        last = search_round.chosen.fitted if evidence.after is None else evidence.after
        similar = contradicting_signs(search_round.chosen.effect, last.fit).values()
        open_names = {*evidence.untested, *_explained(evidence, policy), *still_found, *similar}
        others += [
            name for name in search_round.chosen.effect.alternatives if name in open_names and name not in others
        ]
        texts, competitor = tuple(reason.text for reason in reasons), reasons[0].effect if reasons else ""
        found.append(
            EffectAttribution(name, "ambiguous" if reasons else "identified", texts, tuple(others), competitor)
        )
    return tuple(found)


def with_excluded(diagnosis: Diagnosis, excluded: Sequence[Effect]) -> Diagnosis:
    """Return the diagnosis with the candidates that the user left out of the search (``excluded``).

    A declared alternative that was left out may be the true effect in place of an added one, and no test says whether
    it is. An effect that it competes with is ambiguous for this reason, and not identified. It does not matter which
    of both effects declares the other one as its alternative. Candidates that the model does not accept are no reason.
    """
    model = diagnosis.before.model
    possible = [e for e in excluded if model.accepts(e)]
    chosen = {r.chosen.effect.name: r.chosen.effect for r in diagnosis.rounds if r.chosen is not None}
    judged = []
    for found in diagnosis.attributions:
        effect = chosen[found.effect]
        left_out = [e for e in possible if e.name in effect.alternatives or effect.name in e.alternatives]
        if found.attribution != "nonparametric" and left_out:
            which = f"{' and '.join(e.title for e in left_out)}, which {'act' if len(left_out) > 1 else 'acts'}"
            reason = f"{which} in a similar way, {'were' if len(left_out) > 1 else 'was'} left out of the search"
            names = [e.name for e in left_out if e.name not in found.not_excluded]
            found = replace(
                found,
                attribution="ambiguous",
                reasons=(*found.reasons, f"{reason} (--exclude)"),
                not_excluded=(*found.not_excluded, *names),
            )
        judged.append(found)
    return replace(diagnosis, excluded=tuple(excluded), attributions=tuple(judged))


def depends_on_remaining_tests(
    rounds: Sequence[Round], evidence: AttributionEvidence, policy: SearchPolicy = DEFAULT_POLICY
) -> bool:
    """Return whether an effect is ambiguous only because score tests still pass on the last model.

    A fit with the strongest remaining candidates can then show that the effect is identified
    (``AttributionEvidence.unaffected``). The arguments are those of `assess_alternatives`.
    """
    names = frozenset(c.effect.name for c in _chosen(rounds))
    at_best = replace(evidence, unaffected=names, beside=frozenset(s.name for s in evidence.remaining))
    return any(
        r.chosen is not None
        and not r.chosen.nonparametric
        and not _own_reasons(r, rounds, evidence, policy)
        and bool(_remaining_test_reasons(r, rounds, evidence, policy)[0])
        and not _remaining_test_reasons(r, rounds, at_best, policy)[0]
        for r in rounds
    )


def _chosen(rounds: Sequence[Round]) -> list[Refit]:
    """Return the refit of the chosen effect of each round that has one."""
    return [r.chosen for r in rounds if r.chosen is not None]


def _explained(evidence: AttributionEvidence, policy: SearchPolicy) -> set[str]:
    """Return the names of the effects that a change of the estimated parameters explains on the nominal model."""
    return {s.name for s in evidence.nominal if s.tolerance < policy.min_tolerance}


def _remaining_test_reasons(
    search_round: Round, rounds: Sequence[Round], evidence: AttributionEvidence, policy: SearchPolicy
) -> tuple[list[Reason], list[str]]:
    """Return the reasons for ambiguity that score tests still pass, and the declared alternatives among these.

    The effect is the chosen one of ``search_round``, which is parametric. ``rounds`` are all rounds. An effect that
    keeps its size beside the strongest remaining candidates is not there in their place. Only its alternatives that
    were not among these candidates are then a reason. But an effect of little importance stays ambiguous if many tests
    pass: where so much is unexplained, several of the remaining effects together can look like it.

    An error of the measured heading is no reason against an effect that improves the prediction of the yaw rate, which
    another sensor measures (`_predicts_yaw_rate`).
    """
    refit = search_round.chosen
    assert refit is not None
    chosen = _chosen(rounds)
    total = sum(max(c.criterion, 0.0) for c in chosen)
    limit = max(policy.max_remaining_criterion, policy.max_remaining_share * total)
    # the remaining criterion has to be small compared with all effects and with this effect
    own_limit = max(policy.max_remaining_criterion, refit.criterion)
    unaffected, remaining = refit.effect.name in evidence.unaffected, evidence.remaining
    if _predicts_yaw_rate(refit.effect.name, evidence.importances, policy):
        remaining = [s for s in remaining if s.curve is None or s.curve.force != HEADING_ERROR]
    strong = [s for s in remaining if s.criterion(evidence.n) > min(limit, own_limit)]
    many = _many_remaining_tests_reasons(remaining, len(evidence.nominal), policy)
    if unaffected:
        strong = []
        remaining = [s for s in remaining if s.name in set(refit.effect.alternatives) - evidence.beside]
        if _matters_beside_many(refit.effect.name, evidence.importances, policy):
            many = _many_remaining_tests_reasons(remaining, len(evidence.nominal), policy)
    still_found = _alternatives_still_found(search_round, remaining, len(chosen))
    return [
        *_strong_remaining_test_reasons(strong, evidence.n, rounds),
        *many,
        *_remaining_alternative_reasons(still_found),
        *_nonparametric_curve_reasons(chosen, search_round, unaffected, policy),
    ], still_found


def _predicts_yaw_rate(name: str, importances: Sequence[EffectImportance], policy: SearchPolicy) -> bool:
    """Return whether the error of the yaw rate over the horizon surely falls by an amount that matters with an effect.

    The whole 95 % interval of its ratio, without the effect over with it, is above ``policy.min_ratio_beside_many``.
    """
    channels = [w.prediction.channels for w in importances if w.effect == name and w.prediction is not None]
    return any(YAW_RATE in c and c[YAW_RATE].high < 1.0 / policy.min_ratio_beside_many for c in channels)


def _matters_beside_many(name: str, importances: Sequence[EffectImportance], policy: SearchPolicy) -> bool:
    """Return whether an effect is so important that many remaining score tests are no reason against it.

    The error ratio without it has to be at least ``policy.min_ratio_beside_many``, and the t statistic of its gain on
    the validation data above ``policy.min_t``. An effect without an importance, such as one of a model without a
    prediction, is not limited.
    """
    return all(
        max(_error_ratios(w)) >= policy.min_ratio_beside_many and not w.t <= policy.min_t
        for w in importances
        if w.effect == name
    )


def _error_ratios(weight: EffectImportance) -> list[float]:
    """Return the error without an effect over that with it: by inputs alone and, if it is known, over the horizon."""
    return [weight.error_ratio, *([] if weight.prediction is None else [1.0 / weight.prediction.ratio])]


def _own_reasons(
    search_round: Round, rounds: Sequence[Round], evidence: AttributionEvidence, policy: SearchPolicy
) -> list[Reason]:
    """Return the reasons for ambiguity other than score tests that still pass; [] if there are none.

    The arguments are those of `_remaining_test_reasons`.
    """
    refit = search_round.chosen
    assert refit is not None
    chosen, effect = _chosen(rounds), refit.effect
    fitted = refit.fitted if evidence.after is None else evidence.after
    importance = {w.effect: w for w in evidence.importances}
    return [
        *_form_correction_reasons(chosen, refit, policy),
        *_competing_model_reasons(search_round, policy),
        *_undetermined_size_reasons(effect, chosen, fitted, policy),
        *_contradicting_sign_reasons(effect, fitted),
        *_undetermined_position_reasons(effect, fitted, policy),
        *_unusual_position_reasons(effect, fitted, policy),
        *_untested_alternative_reasons(effect, evidence.untested),
        *_failed_candidate_reasons(search_round),
        *_explained_by_parameters_reasons(effect, _explained(evidence, policy)),
        *_no_better_prediction_reasons(effect.name, importance, policy),
        *map(Reason, evidence.reservations),
    ]


def _strong_remaining_test_reasons(strong: Sequence[Score], n: int, rounds: Sequence[Round]) -> list[Reason]:
    """Return the reason for ambiguity that the score tests still find a large effect; empty if ``strong`` is empty.

    ``strong`` are the scores on the last model that pass and exceed the limit of the criterion. The limit is the larger
    of ``policy.max_remaining_criterion`` and the share ``policy.max_remaining_share`` of the summed criteria of all
    effects; above ``policy.max_remaining_criterion`` it is at most the effect's own criterion. The one with the largest
    criterion is named. ``n`` is the number of rows of the estimation data. If the last of the ``rounds`` fitted this
    candidate and the prediction was no better with it, the text says so.
    """
    if not strong:
        return []
    best = max(strong, key=lambda s: s.criterion(n))
    what = "which may be the true cause"
    if is_no_better_prediction(best.name, rounds):
        what = "which explains the estimation data and does not improve the prediction"
    return [
        Reason(
            f"even with it in the model, the score tests still find {_finding_in_words(best)} (expected ΔBIC "
            f"{best.criterion(n):.0f}), {what}",
            best.name,
        )
    ]


def is_no_better_prediction(name: str, rounds: Sequence[Round]) -> bool:
    """Return whether the last round fitted a candidate, and the prediction was no better with it.

    Parameters
    ----------
    name
        Name of the candidate's score, such as ``N(v, r)``; its effect is called ``unknown N(v, r)``.
    rounds
        Rounds of the search.
    """
    return any(
        q.outcome is Outcome.NO_BETTER_PREDICTION and name in (q.effect.name, q.effect.name.removeprefix("unknown "))
        for q in (rounds[-1].refits if rounds else ())
    )


def _many_remaining_tests_reasons(remaining: Sequence[Score], n_tests: int, policy: SearchPolicy) -> list[Reason]:
    """Return the reason for ambiguity that too many score tests still pass, else [].

    The limit is the larger of ``policy.max_remaining_tests`` and the share ``policy.max_remaining_test_share`` of the
    ``n_tests`` score tests of the nominal model.

    ``remaining`` are the scores that pass on the last model, the strongest first; for an effect that keeps its size
    beside the strongest of them, only those of its alternatives. The reason names the first.
    """
    if len(remaining) <= max(policy.max_remaining_tests, policy.max_remaining_test_share * n_tests):
        return []
    return [
        Reason(
            f"even with it in the model, {len(remaining)} score tests still find something, most of all "
            f"{_finding_in_words(remaining[0])}: another effect may be the true cause",
            remaining[0].name,
        )
    ]


def _alternatives_still_found(search_round: Round, remaining: Sequence[Score], n_added: int) -> list[str]:
    """Return the names of the declared alternatives of an effect that still pass their score tests, strongest first.

    A declared alternative is an effect that `Effect.alternatives` lists. The size of its score does not matter. The
    list is empty if only one effect was added (``n_added``): several may together take the place of an alternative.

    An alternative that contains the effect as a special case is left out if it was refitted in its place and was not
    better: its test shows that the effect varies a little, for example during a run, and not that it is another one.

    Parameters
    ----------
    search_round
        Round that added the effect.
    remaining
        Scores that pass on the last model.
    n_added
        Number of added effects.
    """
    chosen = search_round.chosen
    assert chosen is not None
    if n_added < 2:
        return []
    larger = {q.effect.name for q in search_round.refits if chosen.effect.name in q.effect.nests}
    better = {q.effect.name for q in search_round.refits if q.criterion > chosen.criterion}
    return [s.name for s in remaining if s.name in chosen.effect.alternatives and s.name not in larger - better]


def _remaining_alternative_reasons(alternatives: Sequence[str]) -> list[Reason]:
    """Return the reason for ambiguity that a declared alternative still passes its score test; [] without such a one.

    ``alternatives`` are the names of these alternatives (`_alternatives_still_found`). The reason names all of them.
    """
    if not alternatives:
        return []
    found, acts = " and ".join(map(_titled, alternatives)), "acts" if len(alternatives) == 1 else "act"
    text = f"even with it in the model, the score tests still find {found}, which {acts} in a similar way"
    return [Reason(text, alternatives[0])]


def _titled(name: str) -> str:
    """Return title and name of an effect of the catalogue for a sentence; the name alone if it is unknown."""
    effect = catalogue().get(name)
    return f"'{name}'" if effect is None else f"{effect.title} ('{name}')"


def _form_correction_reasons(chosen: Sequence[Refit], refit: Refit, policy: SearchPolicy) -> list[Reason]:
    """Return the reason for ambiguity that the effect of a refit may only correct the form of a much stronger effect.

    This is so if the criterion of the effect is below ``policy.form_share`` of that of the strong effect, and one of
    them declares the other one as its alternative. The difference between the true form of the strong effect and that
    of the catalogue resembles such an alternative. ``chosen`` are the refits of all chosen effects. Otherwise, return
    [].
    """
    strong = [c.effect for c in chosen if refit.criterion < policy.form_share * c.criterion]
    related = [e for e in strong if e.name in refit.effect.alternatives or refit.effect.name in e.alternatives]
    if not related:
        return []
    text = f"it is small beside {related[0].title}, and may only correct the formula of that effect"
    return [Reason(text, related[0].name)]


def _undetermined_size_reasons(
    effect: Effect, chosen: Sequence[Refit], fitted: FittedModel, policy: SearchPolicy
) -> list[Reason]:
    """Return the reason for ambiguity that a parameter of the effect is at its bound, or its size is not significant.

    The size consists of the fitted parameters whose initial value is 0. Their joint distance from zero has to be at
    least ``policy.min_significance`` standard errors. A parameter at its bound is reported first, and then the size is
    not tested. The list has at most one reason. It is empty if no parameter is at its bound and the size is
    significant, or if no parameter of the size has a standard error. The size is not tested either if a curve that
    contains the effect (`Effect.nonparametric_of`) is among ``chosen``: only their sum is determined.
    """
    fit = fitted.fit
    by_name = {p.full_name: p for p in effect.parameters if not p.per_record}
    for p in effect.parameters:
        if p.per_record:
            by_name |= {q.full_name: q for q in (replace(p, segment=run) for run in range(len(fitted.records)))}
    of_effect = {i: by_name[name] for i, name in enumerate(fit.names) if name in by_name}
    stuck = {name for name, flag in fit.flags if flag == AT_BOUND}
    for p in of_effect.values():
        if p.full_name in stuck:
            name, value, _, unit = _reported_estimate(fit, p)
            bound = f"{value:.3g} {unit}".rstrip()
            return [Reason(f"its parameter {name} ({p.meaning}) is at its bound, {bound}, and so no estimate")]
    if any(c.effect.is_table_of(effect.nonparametric_of) for c in chosen):
        return []
    sizes = [i for i, p in of_effect.items() if p.value == 0.0 and fit.errors[i] > 0]
    if not sizes or (distance := _distance_from_zero(fit, sizes)) >= policy.min_significance:
        return []
    shown = []
    for i in sizes[:MOST_SIZES]:
        name, value, error, unit = _reported_estimate(fit, of_effect[i])
        in_degrees = f" ({math.degrees(value):.2g} ± {math.degrees(error):.2g} deg)" if unit == "rad" else ""
        shown.append(f"{name} = {value:.3g} ± {error:.2g} {unit}".rstrip() + in_degrees)
    why = "the data do not determine its size"
    if distance >= SIZE_IS_KNOWN:
        size = "its size is" if len(sizes) == 1 else "its sizes together are"
        why = f"{size} {distance:.1f} standard errors from zero (a sure name needs {policy.min_significance:g})"
    return [Reason(f"{why}: {', '.join(shown)}")]


def contradicting_signs(effect: Effect, fit: Fit) -> dict[str, str]:
    """Return the parameters of an effect whose estimates contradict its title by their signs.

    They are those of `Effect.cannot_be_negative` that are negative by more than ``CLEAR_SIGN`` standard errors, by
    name, each with the name of the effect that has a similar form.
    """
    of_fit = [name for name in effect.cannot_be_negative if name in fit.names]
    estimates = {name: fit.estimate(name) for name in of_fit}
    return {n: effect.cannot_be_negative[n] for n, (value, error) in estimates.items() if value < -CLEAR_SIGN * error}


def _contradicting_sign_reasons(effect: Effect, fitted: FittedModel) -> list[Reason]:
    """Return the reasons for ambiguity that the sign of a parameter contradicts the title of the effect."""
    found = []
    for name, similar in contradicting_signs(effect, fitted.fit).items():
        p = next(p for p in effect.parameters if p.name == name)
        shown, value, error, unit = _reported_estimate(fitted.fit, p)
        size = f"{shown} = {value:.3g} ± {error:.2g} {unit}".rstrip()
        title = catalogue()[similar].title if similar in catalogue() else similar
        found.append(Reason(f"its sign contradicts this name ({size}), and {title} has a similar form", similar))
    return found


def _reported_estimate(fit: Fit, p: Parameter) -> tuple[str, float, float, str]:
    """Return name, value, standard error and unit of a fitted parameter as reports show them.

    If the scale of the forces is unknown, they are those of the ratio to the thrust (for example `m_u/T` in kg/N).
    """
    reported = ReportedEstimates(fit)
    estimate = reported.estimate(p, p.segment or 0)
    return reported.scale.name(p.full_name, p.unit), *estimate, reported.scale.unit(p.unit)


def _undetermined_position_reasons(effect: Effect, fitted: FittedModel, policy: SearchPolicy) -> list[Reason]:
    """Return the reason for ambiguity that the data do not determine the position of an effect (such as a mooring).

    The position is undetermined if ``policy.position_reach`` joint standard errors are not less than its RMS distance
    from the boat. Return [] otherwise, for an effect without a scanned position over ground (`Effect.fixed_point`), or
    if a coordinate is not fitted. A short track determines the direction to the position. The prior determines its
    distance, so all positions along that direction fit equally well.
    """
    fit, scan = fitted.fit, effect.scan
    # A position on the boat, such as that of its thrusters, has the same names, but is not over ground.
    points = [p for p in effect.parameters if p.name in scan and p.name.startswith(("x_", "y_")) and effect.fixed_point]
    at = [fit.names.index(p.name) for p in points if p.name in fit.names]
    if not points or len(at) < len(points):
        return []
    axes = [p.name[0] for p in points]  # north x or east y
    track = [np.concatenate([r.y[:, r.outputs.index(axis)] for r in fitted.records]) for axis in axes]
    away = math.sqrt(sum(float(np.nanmean((y - fit.values[i]) ** 2)) for y, i in zip(track, at, strict=True)))
    if policy.position_reach * float(np.linalg.norm(fit.errors[at])) < away:
        return []
    values = ", ".join(f"{fit.names[i]} = {fit.values[i]:.3g} ± {fit.errors[i]:.2g} m" for i in at)
    return [Reason(f"the data do not determine its position, {away:.0f} m from the boat: {values}")]


def _unusual_position_reasons(effect: Effect, fitted: FittedModel, policy: SearchPolicy) -> list[Reason]:
    """Return the reason for ambiguity that a position on the boat is far from where such positions are.

    A position on the boat is a parameter in m that describes the form of the effect, for example the position of the
    propellers. The limit is ``policy.max_position_distance`` standard deviations of the difference of the estimate and
    the mean of the parameter's prior, which is that of a boat of this size. Such an estimate shows that something else
    acts in a similar way. Return [] if no position is beyond the limit.
    """
    fit = fitted.fit
    for p in effect.parameters:
        if p.unit != "m" or p.value == 0.0 or p.prior is None or p.transform == "log" or p.name not in fit.names:
            continue
        value, error = fit.estimate(p.name)
        mean, sd = p.prior
        if abs(value - mean) > policy.max_position_distance * math.hypot(sd, error):
            given = p.origin is ParameterOrigin.PRIOR
            far = "far from the given position" if given else "unusual for a boat of this size"
            text = (
                f"its parameter {p.name} ({p.meaning}) is {value:.2f} ± {error:.2f} m, which is {far} "
                f"({mean:.2f} ± {sd:.2f} m): something else may act in a similar way"
            )
            return [Reason(text)]
    return []


def _distance_from_zero(fit: Fit, sizes: Sequence[int]) -> float:
    """Return the joint distance of some correlated estimates of a fit from zero, in standard errors (Wald statistic).

    ``sizes`` are the indices of the estimates among the fitted parameters. If their covariance is not finite, return 0.
    """
    values = fit.values[list(sizes)]
    covariance = fit.covariance[np.ix_(sizes, sizes)]
    if not np.isfinite(covariance).all():
        return 0.0
    return math.sqrt(max(float(values @ np.linalg.pinv(covariance, hermitian=True) @ values), 0.0))


def _finding_in_words(score: Score) -> str:
    """Return what a score test finds, as a text for reports.

    For a parametric effect, the text is its title with its name in brackets. For a fitted function of one or two
    variables, it is "that X depends on u" or "that X depends on u and v". It is "that X follows u" for a force with a
    first-order lag, and "that X oscillates after u" for a force with a second-order response.
    """
    curve = score.curve
    if curve is None:
        return _titled(score.name) if score.name in catalogue() else score.name
    if score.kind is EffectKind.LAGGED:
        return f"that {curve.force} follows {curve.variable}"
    if score.kind is EffectKind.RESONANT:
        return f"that {curve.force} oscillates after {curve.variable}"
    titles = {r.name: f"the error of {r.name}" for r in SENSOR_ERRORS} | {r.name: r.title for r in THRUST_LOSSES}
    force = titles.get(curve.force, curve.force)
    return f"that {force} depends on {' and '.join(v for v in (curve.variable, curve.second) if v)}"


def _nonparametric_curve_reasons(
    chosen: Sequence[Refit], search_round: Round, unaffected: bool, policy: SearchPolicy
) -> list[Reason]:
    """Return the reasons for ambiguity of the effect of a round that nonparametric effects give; [] if there are none.

    There is one reason for each nonparametric effect in ``chosen`` (refits of all chosen effects). Two kinds are no
    reason: the curve of which the effect is one form, and, if the effect keeps its size beside the remaining candidates
    (``unaffected``), a curve with a criterion below the share ``policy.max_curve_share`` of that of the effect. One
    more reason is an accepted nonparametric refit of the same round with a larger criterion.
    """
    assert search_round.chosen is not None
    curve, own = search_round.chosen.effect.nonparametric_of, search_round.chosen.criterion
    beside = [c.effect for c in chosen if c.nonparametric and not c.effect.is_table_of(curve)]
    if unaffected:  # a small curve beside an effect that keeps its size with it is no reason against that effect
        small = {c.effect.name for c in chosen if c.criterion < policy.max_curve_share * own}
        beside = [effect for effect in beside if effect.name not in small]
    reasons = [Reason(f"it is not enough alone: {e.title} had to be added too", e.name) for e in beside]
    better = [
        q
        for q in search_round.refits
        if q.nonparametric and is_accepted(q, policy) and q.criterion > search_round.chosen.criterion
    ]
    more = "would explain more of the estimation data than it"
    return reasons + [Reason(f"{q.effect.title} {more}", q.effect.name) for q in better[:1]]


def _competing_refits(search_round: Round, policy: SearchPolicy) -> list[Refit]:
    """Return the refits of a round whose effects compete with the chosen one, the largest criterion first.

    They are the other parametric effects whose criterion is close to that of the chosen effect: it is positive, and
    lower by less than the larger of ``policy.max_distance`` and the share ``policy.max_distance_share`` of it. An
    effect that contains the chosen effect as a special case competes only if its criterion is larger. The refits need
    not be accepted.
    """
    assert search_round.chosen is not None
    name, best = search_round.chosen.effect.name, search_round.chosen.criterion
    least = max(best - max(policy.max_distance, policy.max_distance_share * best), 0.0)
    others = [
        q
        for q in search_round.refits
        if q is not search_round.chosen
        and not q.nonparametric
        and q.criterion > (best if name in q.effect.nests else least)
    ]
    return sorted(others, key=lambda q: -q.criterion)


def _competing_model_reasons(search_round: Round, policy: SearchPolicy) -> list[Reason]:
    """Return the reason for ambiguity that a competing model explains about as much; [] without a competing model.

    The reason compares the competing model with the largest criterion with the chosen effect of the round.
    """
    assert search_round.chosen is not None
    closest = _competing_refits(search_round, policy)[:1]
    return [Reason(_comparison_in_words(q, search_round.chosen, policy), q.effect.name) for q in closest]


def _comparison_in_words(competitor: Refit, chosen: Refit, policy: SearchPolicy) -> str:
    """Return a clause for reports that compares a competing model with the chosen effect.

    If the criterion (ΔBIC) of the competitor is larger, it explains the estimation data better, but not the validation
    data (or not significantly better, if they support it too: `is_validated`), and the clause states both. Otherwise
    the clause states how much less it explains. A difference that would exclude it in a perfect model does not do so
    here, if it is a small share of what both explain (``max_distance_share``): the clause then says why.
    """
    title, behind = competitor.effect.title, chosen.criterion - competitor.criterion
    if behind < 0:
        no = "not significantly" if is_validated(competitor, policy) else "no"
        gain = f"its ΔBIC is {-behind:.0f} better"
        return f"{title} explains the estimation data better ({gain}), but predicts the validation data {no} better"
    if behind > policy.max_distance:
        share = 100 * competitor.criterion / chosen.criterion
        why = "the formula of the right effect may be wrong by as much"
        return f"{title} explains {share:.0f} % as much (its ΔBIC is {behind:.0f} worse), and {why}"
    return f"{title} explains the data nearly as well (its ΔBIC is {behind:.0f} worse)"


def _untested_alternative_reasons(effect: Effect, untested: Collection[str]) -> list[Reason]:
    """Return a reason for ambiguity for each declared alternative of the effect that was not tested on these data.

    A declared alternative is an effect that `Effect.alternatives` lists. ``untested`` are the names of all effects that
    were not tested. The list is empty if no alternative is among them.
    """
    lost = [name for name in effect.alternatives if name in untested]
    return [Reason(f"{_titled(n)} acts in a similar way, and could not be tested on these data", n) for n in lost]


def _explained_by_parameters_reasons(effect: Effect, explained: Collection[str]) -> list[Reason]:
    """Return the reasons for ambiguity that the estimated parameters of the model explain the effect or alternatives.

    ``explained`` are the names of the effects that the parameters explain nearly completely: a change of the parameters
    has the same influence on the outputs, so that the score test of the effect has no power (`Score.tolerance`). If the
    effect is one of them, there is one reason; otherwise there is one for each of its alternatives among them. The
    unexplained rest of such an alternative is only a difference of form, which looks like the effect.
    """
    if effect.name in explained:
        return [Reason("other parameters of the model take up nearly all of it, so that these data cannot test it")]
    names = [name for name in effect.alternatives if name in explained]
    why = "and these data cannot test it, because other parameters of the model take up nearly all of it"
    return [Reason(f"{_titled(name)} acts in a similar way, {why}", name) for name in names]


def _failed_candidate_reasons(search_round: Round) -> list[Reason]:
    """Return the reason for ambiguity that a candidate of the same round passed its score test but could not be fitted.

    Such a candidate may be the right one. Only the first is named; the list is empty if there is none.
    """
    why = "may be the true cause too: it passes the score test, but could not be fitted"
    return [Reason(f"{u.effect.title} {why} ({u.reason})", u.effect.name) for u in search_round.untested[:1]]


def _insignificant_prediction_reasons(
    name: str, importances: Sequence[EffectImportance], policy: SearchPolicy
) -> list[Reason]:
    """Return what else a reader should know of an ambiguous effect: its change of the prediction is not significant.

    Alone this is no reason for ambiguity, since an effect may improve the prediction over some seconds only. The list
    is empty if the error over the horizon falls significantly, if it was not compared or has no interval, and if the
    reasons say already that the prediction is no better (`_predicts_no_better`).
    """
    weight = next((w for w in importances if w.effect == name), None)
    found = None if weight is None else weight.prediction
    if weight is None or found is None or found.verdict == "fell":
        return []
    if weight.untested is None and _predicts_no_better(weight, policy):
        return []
    ratios = (found.ratio, found.low, found.high)
    if not all(map(math.isfinite, ratios)):
        return []
    change, low, high = (f"{100.0 * (ratio - 1.0):+.0f}" for ratio in ratios)
    interval = f"{change} %, 95 %: {low} to {high} %"
    return [Reason(f"with it the error {found.horizon:g} s ahead is not significantly smaller ({interval})")]


def _predicts_no_better(weight: EffectImportance, policy: SearchPolicy) -> bool:
    """Return whether the prediction is no better with an effect (`improves_prediction`).

    For the form of the hull beside common errors, the error over the horizon also has to fall significantly.
    """
    beside = policy.min_identified_ratio >= policy.min_identified_ratio_beside
    same = weight.prediction is not None and weight.prediction.verdict != "fell"
    return (weight.effect in HULL_FORM and beside and same) or not improves_prediction(weight, policy)


def _no_better_prediction_reasons(
    name: str, importance: Mapping[str, EffectImportance], policy: SearchPolicy
) -> list[Reason]:
    """Return the reason for ambiguity that the prediction is hardly better with an effect, or could not be tested.

    ``name`` is the name of the effect, with its importance in ``importance``. The list is empty if the prediction is
    better (`improves_prediction`) and the error without the effect is at least ``policy.min_identified_ratio`` times
    that with it, by inputs alone or over the horizon. For the form of the hull (`HULL_FORM`), which is never exactly
    that of the model, the limit is ``policy.min_identified_ratio_beside``; beside common errors (if both limits are
    equal) the error over the horizon also has to fall significantly. The list is also empty if the importance is
    missing.
    """
    weight = importance.get(name)
    if weight is not None and weight.untested is not None:
        return [Reason(f"the prediction without this effect could not be tested: {weight.untested}")]
    if weight is None:
        return []
    if _predicts_no_better(weight, policy):
        horizon = "" if weight.prediction is None else f" {weight.prediction.horizon:g} s ahead"
        return [Reason(f"the prediction{horizon} is no better with this effect")]
    ratios = _error_ratios(weight)
    least = policy.min_identified_ratio_beside if name in HULL_FORM else policy.min_identified_ratio
    if max(ratios) >= least:
        return []
    text = (
        f"without this effect the prediction error is only {100 * (max(ratios) - 1):.0f} % larger, and small "
        "imperfections of another kind may have the same effect"
    )
    return [Reason(text)]


def recommended_experiment(diagnosis: Diagnosis) -> str | None:
    """Return the experiments that would resolve the ambiguities of a diagnosis, as text for reports.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    str or None
        Sentences, joined by spaces. ``MODEL`` in a command stands for the file of the diagnosed model. None if no
        experiment is recommended.

    Notes
    -----
    - The effects of uncertain name come first, in the order of the answer.
    - An effect with competing models that were fitted, or whose score test still passes: its experiment, and the
      command that designs a mission to distinguish it from each of `competitors_of`. The command is left out if one
      of both is a nonparametric effect, a user-defined effect or a difference between runs, or if no mission can be
      designed for the model. If no mission distinguishes them (`separating_experiment`), what does. If a mission like
      the present data would take more than an hour (`is_mission_long`), what to look at, and the experiments of both.
    - An ambiguous effect or a nonparametric curve without such competing models: its experiment.
    - No effect was selected, although candidates were fitted: for each round, the experiment of the effect that
      comes nearest (`Round.nearest`), otherwise that of the best refit, if it has one.
    """
    chosen = {r.chosen.effect.name: r.chosen.effect for r in diagnosis.rounds if r.chosen is not None}
    lines = []
    for attribution in sorted(diagnosis.attributions, key=lambda j: j.attribution != "ambiguous"):
        effect = chosen.get(attribution.effect)
        if effect is None:
            continue
        competitors = competitors_of(diagnosis, attribution)
        lines += [line for name in competitors for line in _experiment_of_pair(diagnosis, effect, name)]
        if competitors:
            continue
        if attribution.attribution == "ambiguous":
            lines.append(f"To test whether it is {effect.title}: {effect.experiment}.")
        elif attribution.attribution == "nonparametric":
            lines.append(
                f"To find what the curve {effect.name.removeprefix('unknown ')} stands for: {effect.experiment}."
            )
    named = {attribution.effect for attribution in diagnosis.attributions}
    for search_round in diagnosis.rounds if not diagnosis.effects else ():
        if search_round.chosen is not None and search_round.chosen.effect.name in named:
            continue
        # the ranking of the answer; without an effect that comes near, that of the estimation data
        effects = [r.effect for r in search_round.nearest[:1]] or [r.effect for r in search_round.refits[:1]]
        which = "which comes nearest" if search_round.nearest else "which explains most of the estimation data"
        lines += [
            f"To test whether {e.title} is present, {which} and was not added: {e.experiment}."
            for e in effects
            if e.experiment
        ]
    return " ".join(dict.fromkeys(lines)) or None  # an effect can come nearest in several rounds


def competitors_of(diagnosis: Diagnosis, attribution: EffectAttribution) -> list[str]:
    """Return the names of the competing models from which the recommended experiments distinguish an effect.

    The first is the closest model that is not excluded and was fitted in place of the effect. The effect that
    the first reason against the attribution names follows, if it is one of the catalogue. If there are neither, the
    result has the first of the other models that are not excluded. A special case of the effect, or an effect that
    contains it, is no competing model here: no experiment tells them apart. The list is empty if there is none that was
    fitted, or whose score test still passes.
    """
    titles, kinds = _titles_and_kinds(diagnosis)
    name = attribution.effect
    known = [n for n in attribution.not_excluded if n in titles and n != name and not is_special_case(name, n)]
    rivals = [n for n in known if _fitted_instead(diagnosis, name, n) is not None]
    named = attribution.competitor
    is_effect = kinds.get(named) is EffectKind.CATALOGUE and named != name and not is_special_case(name, named)
    return list(dict.fromkeys([*rivals[:1], *([named] if is_effect else [])])) or known[:1]


def _fitted_instead(diagnosis: Diagnosis, effect: str, competitor: str) -> tuple[Refit, Refit] | None:
    """Return the refits of an added effect and of a competitor, by name, that were fitted in the same round.

    None if the competitor was not fitted in the round that added the effect.
    """
    for search_round in diagnosis.rounds:
        if search_round.chosen is not None and search_round.chosen.effect.name == effect:
            rivals = [q for q in search_round.refits if q.effect.name == competitor]
            return (search_round.chosen, rivals[0]) if rivals else None
    return None


def is_mission_long(diagnosis: Diagnosis, effect: str, competitor: str) -> bool:
    """Return whether a mission of thruster commands would take more than an hour to distinguish two effects.

    The effects are given by name: an added one, and a competing model. A mission like the present data is meant
    (`_mission_seconds`). The result is False if both were not fitted in the same round, so that this is not known.
    """
    return _mission_seconds(diagnosis, effect, competitor) > LONGEST_MISSION_S


def _mission_seconds(diagnosis: Diagnosis, effect: str, competitor: str) -> float:
    """Return how long [s] a mission like the estimation data has to be to distinguish two effects; 0 if not known.

    The difference of both fits in 2 ln L grows with the duration. Here the penalty of the parameters is left out,
    because it does not grow.
    """
    both = _fitted_instead(diagnosis, effect, competitor)
    if both is None:
        return 0.0
    difference = abs(both[0].gain - both[1].gain)
    seconds = sum(r.duration for r in diagnosis.before.records)
    return float(seconds * SURE_DIFFERENCE / difference) if difference > 0.0 else float("inf")


def _beside_missions(diagnosis: Diagnosis, effect: Effect, competitor: str) -> str:
    """Return sentences on what distinguishes an added effect from a fitted competitor without a long mission.

    They are the causes of both to look for on the boat, and the experiments in which both differ most.
    """
    both = _fitted_instead(diagnosis, effect.name, competitor)
    assert both is not None  # otherwise the duration of a mission is not known
    effects = (effect, both[1].effect)
    needed = _mission_seconds(diagnosis, effect.name, competitor) / LONGEST_MISSION_S
    seconds = sum(r.duration for r in diagnosis.before.records)
    longer = f"about {needed:.0f} hours" if 1.5 <= needed < 100.0 else "more than an hour"
    look = "; or ".join(e.causes for e in effects if e.causes)
    tests = "; or ".join(e.experiment for e in effects if e.experiment)
    return (
        f"{f'look for {look}. ' if look else ''}Both explain these {seconds:.0f} s of data nearly equally "
        f"well (2 ln L differs by {abs(both[0].gain - both[1].gain):.2g}), so that a run of the same kind would have "
        f"to last {longer}. They differ most in these tests: {tests}."
    )


def _experiment_of_pair(diagnosis: Diagnosis, effect: Effect, competitor: str) -> list[str]:
    """Return what distinguishes an added effect from a competing model, given by name, in sentences for reports.

    A command that designs a mission follows if there is one (`recommended_experiment`).
    """
    titles, kinds = _titles_and_kinds(diagnosis)
    begin = f"To distinguish {effect.title} from {titles[competitor]}:"
    of_catalogue = all(kinds[n] is EffectKind.CATALOGUE and n in catalogue() for n in (effect.name, competitor))
    has_command = of_catalogue and not reason_without_mission(diagnosis.before.model)
    command = f"`seatrial mission design MODEL --discriminate {effect.name},{competitor}`"
    if instead := separating_experiment(effect.name, competitor):
        return [
            f"{begin} {instead}. A mission of thruster commands may not distinguish them, however long it is, because "
            "one can imitate the other."
        ]
    if is_mission_long(diagnosis, effect.name, competitor):
        check = f"{command} only checks whether another mission distinguishes them."
        return [f"{begin} {_beside_missions(diagnosis, effect, competitor)}", *([check] if has_command else [])]
    limits = "--area, --duration and --n-max are the limits of your water"
    generate = f"{command} generates the mission; {limits}."
    return [f"{begin} {effect.experiment}.", *([generate] if has_command else [])]


def _titles_and_kinds(diagnosis: Diagnosis) -> tuple[dict[str, str], dict[str, EffectKind]]:
    """Return titles and kinds of the effects that were fitted or whose score test still passes, by name."""
    effects = [q.effect for r in diagnosis.rounds for q in r.refits]
    titles = {s.name: s.name for s in diagnosis.remaining} | {e.name: e.title for e in effects}
    return titles, {s.name: s.kind for s in diagnosis.remaining} | {e.name: e.kind for e in effects}


def _advice_on_remaining(diagnosis: Diagnosis) -> str:
    """Return what to do about the candidates that still pass beside the added effects, without the last full stop.

    ``MODEL`` in a command stands for the file of the diagnosed model.
    """
    known = catalogue()
    names = [s.name for s in diagnosis.remaining if s.name in known][:MOST_ADVISED]
    if not names:
        return (
            "What still passes the score test are curves and differences between runs, which no experiment of the "
            "catalogue tests: record longer and more varied runs, and diagnose again"
        )
    advice = f"Candidates that still pass the score test may be missing too: {', '.join(map(_titled, names))}. "
    if diagnosis.before.model.kind is ModelKind.BENCH:  # no fit of a thruster takes effects
        return f"{advice}To test them, record longer and more varied tests on the bench, and diagnose again"
    advice += (
        f"To test one, fit the model again with --effect {names[0]}, and compare both models on logs of neither fit"
    )
    pairs = [f"{a},{b}" for a, b in combinations(names, 2) if is_mission_useful(a, b)]
    if pairs and not reason_without_mission(diagnosis.before.model):
        advice += f". `seatrial mission design MODEL --discriminate {pairs[0]}` designs a mission that tells two apart"
    return advice


def is_mission_useful(first: str, second: str) -> bool:
    """Return whether a mission of thruster commands may distinguish two effects of the catalogue, given by name.

    None does if one of them is a special case of the other, or if they have a `separating_experiment`.
    """
    return not is_special_case(first, second) and not separating_experiment(first, second)


def reason_without_experiment(diagnosis: Diagnosis) -> str:
    """Return why no experiment is recommended for a diagnosis, as a clause; see `recommended_experiment`.

    Sentences on what to do may follow the clause; the last full stop is missing. The text assumes that
    `recommended_experiment` returns None.
    """
    if diagnosis.effects:
        if diagnosis.remaining:
            return f"the effects that were added have no competing effect. {_advice_on_remaining(diagnosis)}"
        return "no competing effect is left for the effects that were added"
    if any(r.refits for r in diagnosis.rounds):
        return "the catalogue has no experiment for the effects that come nearest"
    if diagnosis.untested:
        return "the candidates that passed the score tests could not be fitted"
    if diagnosis.short_data is not None:
        return "no candidate passed the score tests, and the data are too short to test all of them"
    if diagnosis.remaining:
        return "each candidate that passed the score tests explains too little to matter"
    return "no candidate passed the score tests, so that there is no effect to test"
