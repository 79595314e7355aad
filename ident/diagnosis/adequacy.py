"""Attribution: is a selected effect identified, or ambiguous with its alternatives? And the recommended experiment.

An effect may improve a model a great deal and still be the wrong one: where the true effect is not in the catalogue, a
competing one takes its place. The remaining residual distinguishes them: the right effect leaves only the small
difference between its true form and that of the catalogue. So the score tests are repeated after the last effect, and
an attribution is *identified* only if what they find is small compared with what the effects explain, no nonparametric
curve was needed beside it, no competing model comes close, could not be tested or is what the model estimates anyway,
the prediction of validation data is better with it, and nothing speaks against the data or the fit. Otherwise it is
*ambiguous*.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from seatrial.ident.diagnosis.results import Diagnosis, EffectAttribution, EffectImportance, Refit, Round
from seatrial.ident.diagnosis.score_test import Score
from seatrial.ident.estimation import AT_BOUND, Fit, FittedModel, ReportedEstimates
from seatrial.ident.experiment_design import not_commanded
from seatrial.ident.model import Effect, EffectKind, Parameter
from seatrial.ident.models import READINGS, THRUST_LOSSES

# Largest criterion (2 ln L less the penalty of the parameters) that a score test may still find beside an identified
# effect, whose true form is not exactly that of the catalogue: absolute, and as a share of what the effects explain
# (tests/recovery: leave-one-out against the full catalogue)
MAX_REMAINING_CRITERION, MAX_REMAINING_SHARE = 20.0, 0.03
MAX_REMAINING_TESTS = 8  # tests that may still pass: a small difference of form shows in a few of them
# a competing model is not excluded if its criterion is behind by less than this: absolute, and as a share
MAX_DISTANCE, MAX_DISTANCE_SHARE = 10.0, 0.05
MIN_SIGNIFICANCE = 4.0  # standard errors of an effect from zero; right effects exceed it even at half their size
REACH = 3.0  # standard errors of a place: where they are more than its distance from the boat, it is not known
# tolerance of a score below which the estimated parameters take the effect up: where nobody gave the thrust, they hold
# its asymmetry and leave 0.005 to 0.04 % of a loss in reverse; of other effects 0.3 % and more is left (tests/recovery)
LEAST_TOLERANCE = 1e-3
FORM_SHARE = 0.1  # a competing effect below this share of the other may be the difference of its form


def assess_alternatives(
    rounds: Sequence[Round],
    left: Sequence[Score],
    n: int,
    untested: Collection[str] = (),
    weights: Sequence[EffectImportance] = (),
    reservations: Sequence[str] = (),
    after: FittedModel | None = None,
    nominal: Sequence[Score] = (),
) -> tuple[EffectAttribution, ...]:
    """Attribution of each selected effect.

    Parameters:
        left: scores that still pass after the last effect.
        n: rows of the estimation data.
        untested: effects of the catalogue that were not tested, since the data lack one of their inputs.
        weights: what each effect is worth to the prediction.
        reservations: why no effect can be identified on these data.
        after: the last model, whose estimates are reported; by default that of each round.
        nominal: scores on the model without effects.
    """
    taken_up = {s.name for s in nominal if s.tolerance < LEAST_TOLERANCE}
    worth = {w.effect: w for w in weights}
    chosen = [r.chosen for r in rounds if r.chosen is not None]
    total = sum(max(c.criterion, 0.0) for c in chosen)
    limit = max(MAX_REMAINING_CRITERION, MAX_REMAINING_SHARE * total)
    found = []
    for one in rounds:
        if one.chosen is None:
            continue
        if one.chosen.unknown:
            close = tuple(q.effect.name for q in _close(one))
            found.append(EffectAttribution(one.chosen.effect.name, "nonparametric", (), close))
            continue
        # neither beside all effects nor beside this one may it be large
        own = max(MAX_REMAINING_CRITERION, one.chosen.criterion)
        rest = [s for s in left if s.criterion(n) > min(limit, own)]
        stage = one.chosen.stage if after is None else after
        reasons = [*_left(rest, n), *_many(left), *_kin(one.chosen.effect, left, len(chosen)), *_tables(chosen, one)]
        reasons += [*_form(chosen, one.chosen), *_competing(one)]
        reasons += [*_own(one.chosen.effect, stage), *_place(one.chosen.effect, stage)]
        reasons += [*_untested(one.chosen.effect, untested), *_not_fitted(one), *_taken_up(one.chosen.effect, taken_up)]
        reasons += [*_unpredictive(worth.get(one.chosen.effect.name)), *reservations]
        others = [q.effect.name for q in _close(one)]
        unseen = {*untested, *taken_up}
        others += [name for name in one.chosen.effect.alternatives if name in unseen and name not in others]
        name = one.chosen.effect.name
        found.append(EffectAttribution(name, "ambiguous" if reasons else "identified", tuple(reasons), tuple(others)))
    return tuple(found)


def _left(rest: Sequence[Score], n: int) -> list[str]:
    if not rest:
        return []
    best = max(rest, key=lambda s: s.criterion(n))
    return [f"with it the tests still find {_worded(best)}, worth {best.criterion(n):.0f} more in 2 ln L"]


def _many(left: Sequence[Score]) -> list[str]:
    if len(left) <= MAX_REMAINING_TESTS:
        return []
    return [f"with it {len(left)} tests still pass, of {_worded(left[0])} first"]


def _kin(effect: Effect, left: Sequence[Score], n_added: int) -> list[str]:
    """Where several effects were added: a declared alternative of this one that still passes, however small, since one
    effect may then explain all."""
    kin = [s.name for s in left if s.name in effect.alternatives] if n_added > 1 else []
    return [f"with it the tests still find its alternative {kin[0]}"] if kin else []


def _form(chosen: Sequence[Refit], one: Refit) -> list[str]:
    """Where this effect is a small alternative of a strong one: the difference between the true form of the strong one
    and
    that of the catalogue resembles its nearest alternative."""
    strong = [c.effect for c in chosen if one.criterion < FORM_SHARE * c.criterion]
    kin = [e for e in strong if e.name in one.effect.alternatives or one.effect.name in e.alternatives]
    return [f"it may be no more than what {kin[0].title} has beyond its formula"] if kin else []


def _own(effect: Effect, stage: FittedModel) -> list[str]:
    """Evidence against it by its own parameters: a parameter at its bound, or a size that is not significant."""
    fit = stage.fit
    named = {p.full_name: p for p in effect.parameters if not p.per_record}
    for p in effect.parameters:
        if p.per_record:
            named |= {q.full_name: q for q in (replace(p, segment=run) for run in range(len(stage.records)))}
    own = {i: named[name] for i, name in enumerate(fit.names) if name in named}
    stuck = {name for name, what in fit.flags if what == AT_BOUND}
    for p in own.values():
        if p.full_name in stuck:
            name, value, _, unit = _reported(fit, p)
            return [f"its parameter {name} ({p.meaning}) is at its bound, {value:.3g} {unit}".rstrip()]
    sizes = [i for i, p in own.items() if p.value == 0.0 and fit.errors[i] > 0]
    if not sizes or _from_nothing(fit, sizes) >= MIN_SIGNIFICANCE:
        return []
    name, value, error, unit = _reported(fit, own[sizes[0]])
    return [f"the data do not tell its size: {name} = {value:.3g} ± {error:.3g} {unit}".rstrip()]


def _reported(fit: Fit, p: Parameter) -> tuple[str, float, float, str]:
    """Name, value, standard error and unit, over the thrust where its scale is unknown."""
    reported = ReportedEstimates(fit)
    estimate = reported.estimate(p, p.segment or 0)
    return reported.scale.name(p.full_name, p.unit), *estimate, reported.scale.unit(p.unit)


def _place(effect: Effect, stage: FittedModel) -> list[str]:
    """Where the place of an effect (the fixed end of a line) is not known: a small track sees the direction to it, and
    a prior of its distance; all places along that direction do."""
    fit, scan = stage.fit, effect.scan
    points = [p for p in effect.parameters if p.name in scan and p.name.startswith(("x_", "y_"))]
    at = [fit.names.index(p.name) for p in points if p.name in fit.names]
    if not points or len(at) < len(points):
        return []
    axes = [p.name[0] for p in points]  # north x or east y
    track = [np.concatenate([r.y[:, r.outputs.index(axis)] for r in stage.records]) for axis in axes]
    away = math.sqrt(sum(float(np.nanmean((y - fit.values[i]) ** 2)) for y, i in zip(track, at, strict=True)))
    if REACH * float(np.linalg.norm(fit.errors[at])) < away:
        return []
    values = ", ".join(f"{fit.names[i]} = {fit.values[i]:.3g} ± {fit.errors[i]:.2g} m" for i in at)
    return [f"the data do not tell its place, {away:.0f} m from the boat: {values}"]


def _from_nothing(fit: Fit, sizes: Sequence[int]) -> float:
    """Joint distance of the estimates from zero in standard errors (Wald): each may be correlated with the others."""
    values = fit.values[list(sizes)]
    covariance = fit.covariance[np.ix_(sizes, sizes)]
    if not np.isfinite(covariance).all():
        return 0.0
    return math.sqrt(max(float(values @ np.linalg.pinv(covariance, hermitian=True) @ values), 0.0))


def _worded(score: Score) -> str:
    curve = score.curve
    if curve is None:
        return score.name
    if score.kind is EffectKind.LAGGED:
        return f"that {curve.force} follows {curve.variable}"
    if score.kind is EffectKind.RESONANT:
        return f"that {curve.force} swings after {curve.variable}"
    known = {r.name: f"the error of {r.name}" for r in READINGS} | {r.name: r.title for r in THRUST_LOSSES}
    what = known.get(curve.force, curve.force)
    return f"that {what} depends on {' and '.join(v for v in (curve.variable, curve.second) if v)}"


def _tables(chosen: Sequence[Refit], one: Round) -> list[str]:
    """A nonparametric curve that was added beside the effect, or that gains more than it."""
    assert one.chosen is not None
    own = one.chosen.effect.nonparametric_of
    beside = [c.effect for c in chosen if c.unknown and not c.effect.is_table_of(own)]
    reasons = [f"{effect.title} had to be added beside it" for effect in beside]
    better = [q for q in one.refits if q.unknown and q.accepted and q.criterion > one.chosen.criterion]
    return reasons + [f"{q.effect.title} would explain more" for q in better[:1]]


def _close(one: Round) -> list[Refit]:
    """Competing models: other effects whose criterion is close to that of the chosen one, best first. One that nests
    the chosen effect competes only if its further parameters are worth their number."""
    assert one.chosen is not None
    name, best = one.chosen.effect.name, one.chosen.criterion
    least = max(best - max(MAX_DISTANCE, MAX_DISTANCE_SHARE * best), 0.0)
    others = [
        q
        for q in one.refits
        if q is not one.chosen and not q.unknown and q.criterion > (best if name in q.effect.nests else least)
    ]
    return sorted(others, key=lambda q: -q.criterion)


def _competing(one: Round) -> list[str]:
    assert one.chosen is not None
    return [_compared(q, one.chosen.criterion - q.criterion) for q in _close(one)[:1]]


def _compared(other: Refit, behind: float) -> str:
    if behind < 0:
        said = f"{other.effect.title} explains the fitted data better (by {-behind:.0f} in 2 ln L)"
        return f"{said}, the validation data not {'significantly' if other.validated else 'so'}"
    return f"{other.effect.title} explains nearly as much ({behind:.0f} less in 2 ln L)"


def _untested(effect: Effect, untested: Collection[str]) -> list[str]:
    lost = [name for name in effect.alternatives if name in untested]
    return [f"its alternative {name} could not be tested on these data" for name in lost]


def _taken_up(effect: Effect, taken_up: Collection[str]) -> list[str]:
    """What of these effects the estimated parameters do not take up is the difference between form and form: it looks
    like their alternatives."""
    if effect.name in taken_up:
        return ["the model's estimated parameters take up nearly all of it"]
    names = [name for name in effect.alternatives if name in taken_up]
    return [f"its alternative {name} is nearly all taken up by the model's estimated parameters" for name in names]


def _not_fitted(one: Round) -> list[str]:
    """Candidates of the same round that passed the score test and could not be fitted: any may be the right one."""
    return [f"{u.effect.title} passes the test too and could not be fitted: {u.reason}" for u in one.untested[:1]]


def _unpredictive(weight: EffectImportance | None) -> list[str]:
    if weight is not None and weight.untested is not None:
        return [f"what the prediction is without it could not be tested: {weight.untested}"]
    if weight is None or weight.predicts:
        return []
    ahead = "" if weight.prediction is None else f" {weight.prediction.horizon:g} s ahead"
    return [f"the prediction{ahead} is no better with it"]


def recommended_experiment(diagnosis: Diagnosis) -> str | None:
    """Recommended experiment that would resolve an ambiguity; ``MODEL`` in a command is the diagnosed model.

    For an effect with competing models: the experiment that shows it, and the command that designs the discriminating
    mission. For an ambiguous effect without them: its experiment. Where tests passed but no candidate was confirmed on
    the validation data: the experiment of the best candidate.
    """
    lines = []
    by_name = {j.effect: j for j in diagnosis.judgements}
    for one in diagnosis.rounds:
        if one.chosen is None or one.chosen.effect.name not in by_name:
            if not diagnosis.effects and one.refits and one.refits[0].effect.experiment:
                e = one.refits[0].effect
                lines.append(f"To see whether {e.title} is there at all: {e.experiment}.")
            continue
        effect, judged = one.chosen.effect, by_name.get(one.chosen.effect.name)
        titles = {q.effect.name: q.effect.title for q in one.refits}
        others = [r for r in judged.not_excluded if r in titles] if judged is not None else []
        for other in others[:1]:
            lines.append(f"To tell {effect.title} from {titles[other]}: {effect.experiment}.")
            named = {q.effect.name for q in one.refits if q.effect.kind is EffectKind.CATALOGUE}
            if {effect.name, other} <= named and not not_commanded(diagnosis.before.model):
                lines.append(f"`seatrial mission design MODEL --discriminate {effect.name},{other}` makes the mission.")
        if judged is not None and judged.attribution == "ambiguous" and not others:
            lines.append(f"To see whether it is {effect.title}: {effect.experiment}.")
    return " ".join(lines) or None
