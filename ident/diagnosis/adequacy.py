"""Attribution of selected effects (identified or ambiguous), and the recommended experiment.

An effect may improve a model a great deal and still be the wrong effect. If the true effect is not in the catalogue,
a competing effect takes its place. The remaining residual distinguishes them: the right effect leaves only the small
difference between its true form and that of the catalogue. So the score tests are repeated after the last effect. An
effect is *identified* only if all of these hold:

- the remaining tests find little compared with what the effects explain;
- no nonparametric curve was needed in addition;
- no competing model comes close, could not be tested, or is explained by the estimated parameters of the model;
- the prediction of validation data is better with the effect;
- data and fit have no other weakness.

Otherwise the effect is *ambiguous*.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from seatrial.ident.diagnosis.acceptance import improves_prediction, is_accepted, is_validated
from seatrial.ident.diagnosis.findings import Diagnosis, EffectAttribution, EffectImportance, Refit, Round
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY, SearchPolicy
from seatrial.ident.diagnosis.score_test import Score
from seatrial.ident.estimation import AT_BOUND, Fit, FittedModel, ReportedEstimates
from seatrial.ident.experiment_design import reason_without_mission
from seatrial.ident.model import Effect, EffectKind, Parameter
from seatrial.ident.models import SENSOR_ERRORS, THRUST_LOSSES


def assess_alternatives(
    rounds: Sequence[Round],
    left: Sequence[Score],
    n: int,
    untested: Collection[str] = (),
    weights: Sequence[EffectImportance] = (),
    reservations: Sequence[str] = (),
    after: FittedModel | None = None,
    nominal: Sequence[Score] = (),
    policy: SearchPolicy = DEFAULT_POLICY,
) -> tuple[EffectAttribution, ...]:
    """Attribute each selected effect: identified, ambiguous or nonparametric.

    Parameters
    ----------
    rounds
        Rounds of the search.
    left
        Scores that still pass after the last effect.
    n
        Number of rows of the estimation data.
    untested
        Names of catalogue effects that were not tested because the data lack one of their inputs.
    weights
        Importance of each effect.
    reservations
        Reasons why no effect can be identified on these data.
    after
        Last model, whose estimates are reported, by default that of each round.
    nominal
        Scores on the model without effects.

    Returns
    -------
    tuple of EffectAttribution
        Attribution of each selected effect, with the reasons if it is ambiguous.
    """
    taken_up = {s.name for s in nominal if s.tolerance < policy.min_tolerance}
    importance = {w.effect: w for w in weights}
    chosen = [r.chosen for r in rounds if r.chosen is not None]
    total = sum(max(c.criterion, 0.0) for c in chosen)
    limit = max(policy.max_remaining_criterion, policy.max_remaining_share * total)
    found = []
    for search_round in rounds:
        if search_round.chosen is None:
            continue
        if search_round.chosen.nonparametric:
            close = tuple(q.effect.name for q in _competing_refits(search_round, policy))
            found.append(EffectAttribution(search_round.chosen.effect.name, "nonparametric", (), close))
            continue
        # the remaining criterion has to be small compared with all effects and with this effect
        own_limit = max(policy.max_remaining_criterion, search_round.chosen.criterion)
        rest = [s for s in left if s.criterion(n) > min(limit, own_limit)]
        fitted = search_round.chosen.fitted if after is None else after
        reasons = [
            *_strong_remaining_test_reasons(rest, n),
            *_many_remaining_tests_reasons(left, policy),
            *_remaining_alternative_reasons(search_round.chosen.effect, left, len(chosen)),
            *_nonparametric_curve_reasons(chosen, search_round, policy),
        ]
        reasons += [
            *_form_correction_reasons(chosen, search_round.chosen, policy),
            *_competing_model_reasons(search_round, policy),
        ]
        reasons += [
            *_undetermined_size_reasons(search_round.chosen.effect, fitted, policy),
            *_undetermined_position_reasons(search_round.chosen.effect, fitted, policy),
        ]
        reasons += [
            *_untested_alternative_reasons(search_round.chosen.effect, untested),
            *_failed_candidate_reasons(search_round),
            *_explained_by_parameters_reasons(search_round.chosen.effect, taken_up),
        ]
        reasons += [
            *_no_better_prediction_reasons(importance.get(search_round.chosen.effect.name), policy),
            *reservations,
        ]
        others = [q.effect.name for q in _competing_refits(search_round, policy)]
        unexamined = {*untested, *taken_up}
        others += [
            name for name in search_round.chosen.effect.alternatives if name in unexamined and name not in others
        ]
        name = search_round.chosen.effect.name
        found.append(EffectAttribution(name, "ambiguous" if reasons else "identified", tuple(reasons), tuple(others)))
    return tuple(found)


def _strong_remaining_test_reasons(rest: Sequence[Score], n: int) -> list[str]:
    """Return the reason that a remaining score test finds much, if any does."""
    if not rest:
        return []
    best = max(rest, key=lambda s: s.criterion(n))
    return [f"with it the score tests still find {_finding_in_words(best)} ({best.criterion(n):.0f} more in 2 ln L)"]


def _many_remaining_tests_reasons(left: Sequence[Score], policy: SearchPolicy) -> list[str]:
    """Return the reason that many score tests still pass, if they do."""
    if len(left) <= policy.max_remaining_tests:
        return []
    return [f"with it {len(left)} score tests still pass; the strongest finds {_finding_in_words(left[0])}"]


def _remaining_alternative_reasons(effect: Effect, left: Sequence[Score], n_added: int) -> list[str]:
    """Return the reason that a declared alternative of this effect still passes, however small.

    It applies only if several effects were added, because one effect may then explain all of them.
    """
    alternatives = [s.name for s in left if s.name in effect.alternatives] if n_added > 1 else []
    return [f"with it the score tests still find its alternative {alternatives[0]}"] if alternatives else []


def _form_correction_reasons(chosen: Sequence[Refit], refit: Refit, policy: SearchPolicy) -> list[str]:
    """Return the reason that this effect is a small alternative of a strong effect, if it is.

    The difference between the true form of the strong effect and that of the catalogue resembles the nearest
    alternative.
    """
    strong = [c.effect for c in chosen if refit.criterion < policy.form_share * c.criterion]
    related = [e for e in strong if e.name in refit.effect.alternatives or refit.effect.name in e.alternatives]
    return [f"it may only correct the formula of {related[0].title}"] if related else []


def _undetermined_size_reasons(effect: Effect, fitted: FittedModel, policy: SearchPolicy) -> list[str]:
    """Return the reason that a parameter of the effect is at its bound, or that its size is not significant."""
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
            return [f"its parameter {name} ({p.meaning}) is at its bound, {value:.3g} {unit}".rstrip()]
    sizes = [i for i, p in of_effect.items() if p.value == 0.0 and fit.errors[i] > 0]
    if not sizes or _distance_from_zero(fit, sizes) >= policy.min_significance:
        return []
    name, value, error, unit = _reported_estimate(fit, of_effect[sizes[0]])
    return [f"the data do not determine its size: {name} = {value:.3g} ± {error:.3g} {unit}".rstrip()]


def _reported_estimate(fit: Fit, p: Parameter) -> tuple[str, float, float, str]:
    """Return name, value, standard error and unit of a parameter, over the thrust if the force scale is unknown."""
    reported = ReportedEstimates(fit)
    estimate = reported.estimate(p, p.segment or 0)
    return reported.scale.name(p.full_name, p.unit), *estimate, reported.scale.unit(p.unit)


def _undetermined_position_reasons(effect: Effect, fitted: FittedModel, policy: SearchPolicy) -> list[str]:
    """Return the reason that the position of an effect (for example the fixed end of a line) is not determined.

    A small track determines the direction to the position. The prior determines its distance, so all positions along
    that direction fit equally well.
    """
    fit, scan = fitted.fit, effect.scan
    points = [p for p in effect.parameters if p.name in scan and p.name.startswith(("x_", "y_"))]
    at = [fit.names.index(p.name) for p in points if p.name in fit.names]
    if not points or len(at) < len(points):
        return []
    axes = [p.name[0] for p in points]  # north x or east y
    track = [np.concatenate([r.y[:, r.outputs.index(axis)] for r in fitted.records]) for axis in axes]
    away = math.sqrt(sum(float(np.nanmean((y - fit.values[i]) ** 2)) for y, i in zip(track, at, strict=True)))
    if policy.position_reach * float(np.linalg.norm(fit.errors[at])) < away:
        return []
    values = ", ".join(f"{fit.names[i]} = {fit.values[i]:.3g} ± {fit.errors[i]:.2g} m" for i in at)
    return [f"the data do not determine its position, {away:.0f} m from the boat: {values}"]


def _distance_from_zero(fit: Fit, sizes: Sequence[int]) -> float:
    """Return the joint distance of correlated estimates from zero in standard errors (Wald)."""
    values = fit.values[list(sizes)]
    covariance = fit.covariance[np.ix_(sizes, sizes)]
    if not np.isfinite(covariance).all():
        return 0.0
    return math.sqrt(max(float(values @ np.linalg.pinv(covariance, hermitian=True) @ values), 0.0))


def _finding_in_words(score: Score) -> str:
    """Return the effect or dependence that a score test finds, in words."""
    curve = score.curve
    if curve is None:
        return score.name
    if score.kind is EffectKind.LAGGED:
        return f"that {curve.force} follows {curve.variable}"
    if score.kind is EffectKind.RESONANT:
        return f"that {curve.force} oscillates after {curve.variable}"
    titles = {r.name: f"the error of {r.name}" for r in SENSOR_ERRORS} | {r.name: r.title for r in THRUST_LOSSES}
    force = titles.get(curve.force, curve.force)
    return f"that {force} depends on {' and '.join(v for v in (curve.variable, curve.second) if v)}"


def _nonparametric_curve_reasons(chosen: Sequence[Refit], search_round: Round, policy: SearchPolicy) -> list[str]:
    """Return the reasons that a nonparametric curve was added beside the effect, or would gain more than the effect."""
    assert search_round.chosen is not None
    curve = search_round.chosen.effect.nonparametric_of
    beside = [c.effect for c in chosen if c.nonparametric and not c.effect.is_table_of(curve)]
    reasons = [f"{effect.title} had to be added beside it" for effect in beside]
    better = [
        q
        for q in search_round.refits
        if q.nonparametric and is_accepted(q, policy) and q.criterion > search_round.chosen.criterion
    ]
    return reasons + [f"{q.effect.title} would explain more" for q in better[:1]]


def _competing_refits(search_round: Round, policy: SearchPolicy) -> list[Refit]:
    """Return the competing models of a round, best first.

    They are the other effects whose criterion is close to that of the chosen effect.

    An effect that nests the chosen effect competes only if its further parameters increase the criterion.
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


def _competing_model_reasons(search_round: Round, policy: SearchPolicy) -> list[str]:
    """Return the reason that a competing model comes close, for the best of them."""
    assert search_round.chosen is not None
    return [
        _comparison_in_words(q, search_round.chosen.criterion - q.criterion, policy)
        for q in _competing_refits(search_round, policy)[:1]
    ]


def _comparison_in_words(competitor: Refit, behind: float, policy: SearchPolicy) -> str:
    """Return a comparison with a competing model in words; its criterion is lower by ``behind``."""
    title = competitor.effect.title
    if behind < 0:
        better = "significantly better" if is_validated(competitor, policy) else "better"
        gain = f"by {-behind:.0f} in 2 ln L"
        return f"{title} explains the estimation data better ({gain}), but not the validation data {better}"
    return f"{title} explains nearly as much ({behind:.0f} less in 2 ln L)"


def _untested_alternative_reasons(effect: Effect, untested: Collection[str]) -> list[str]:
    """Return the reasons that alternatives of the effect could not be tested."""
    lost = [name for name in effect.alternatives if name in untested]
    return [f"its alternative {name} could not be tested on these data" for name in lost]


def _explained_by_parameters_reasons(effect: Effect, taken_up: Collection[str]) -> list[str]:
    """Return the reasons that the estimated parameters explain the effect or its alternatives.

    The part of such an effect that the parameters do not explain is only a difference of form. It looks like the
    alternatives of the effect.
    """
    if effect.name in taken_up:
        return ["the model's estimated parameters explain nearly all of it"]
    names = [name for name in effect.alternatives if name in taken_up]
    return [f"the model's estimated parameters explain nearly all of its alternative {name}" for name in names]


def _failed_candidate_reasons(search_round: Round) -> list[str]:
    """Return the reason that a candidate of the same round passed the score test and could not be fitted.

    Such a candidate may be the right one.
    """
    return [
        f"{u.effect.title} passes the test too and could not be fitted: {u.reason}" for u in search_round.untested[:1]
    ]


def _no_better_prediction_reasons(weight: EffectImportance | None, policy: SearchPolicy) -> list[str]:
    """Return the reason that the prediction is no better with the effect, or that this could not be tested."""
    if weight is not None and weight.untested is not None:
        return [f"the prediction without it could not be tested: {weight.untested}"]
    if weight is None or improves_prediction(weight, policy):
        return []
    horizon = "" if weight.prediction is None else f" {weight.prediction.horizon:g} s ahead"
    return [f"the prediction{horizon} is no better with it"]


def recommended_experiment(diagnosis: Diagnosis) -> str | None:
    """Return the recommended experiments that would resolve the ambiguities, None if there are none.

    Parameters
    ----------
    diagnosis
        The diagnosis.

    Returns
    -------
    str or None
        Sentences for reports. ``MODEL`` in a command stands for the diagnosed model.

    Notes
    -----
    - An effect with competing models: its experiment, and the command that designs the discriminating mission.
    - An ambiguous effect without competing models: its experiment.
    - Tests passed and no candidate was confirmed on the validation data: the experiment of the best candidate.
    """
    lines = []
    by_name = {j.effect: j for j in diagnosis.attributions}
    for search_round in diagnosis.rounds:
        if search_round.chosen is None or search_round.chosen.effect.name not in by_name:
            if not diagnosis.effects and search_round.refits and search_round.refits[0].effect.experiment:
                e = search_round.refits[0].effect
                lines.append(f"To test whether {e.title} is present: {e.experiment}.")
            continue
        effect, attribution = search_round.chosen.effect, by_name.get(search_round.chosen.effect.name)
        titles = {q.effect.name: q.effect.title for q in search_round.refits}
        others = [r for r in attribution.not_excluded if r in titles] if attribution is not None else []
        for competitor in others[:1]:
            lines.append(f"To distinguish {effect.title} from {titles[competitor]}: {effect.experiment}.")
            named = {q.effect.name for q in search_round.refits if q.effect.kind is EffectKind.CATALOGUE}
            if {effect.name, competitor} <= named and not reason_without_mission(diagnosis.before.model):
                lines.append(
                    f"`seatrial mission design MODEL --discriminate {effect.name},{competitor}` generates the mission."
                )
        if attribution is not None and attribution.attribution == "ambiguous" and not others:
            lines.append(f"To test whether it is {effect.title}: {effect.experiment}.")
    return " ".join(lines) or None
