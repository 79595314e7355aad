"""Is the effect that was added the one that is missing, or only its nearest relative in the catalogue?

An effect may improve a model a great deal and still be the wrong one: with the true one out of reach, its neighbour
takes its place. What tells them apart is what is left: the right effect leaves nothing but the small difference
between its true form and ours. So the tests are made once more after the last effect, and a name is given as sure
only if what they find is small beside what the effects explain, no table was needed beside it, and no rival comes
close. Otherwise the answer is that the effect resembles the missing one.

After a diagnosis: which experiment would settle what is still open.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence

import numpy as np

from ident.diagnosis.results import Diagnosis, EffectAttribution, Refit, Round
from ident.diagnosis.score_test import Score
from ident.estimation import AT_BOUND, Fit
from ident.model import Effect, EffectKind, ModelKind
from ident.models import READINGS

# What may be left beside a right name: its true form is not exactly ours. In units of 2 ln L after paying for the
# parameters, absolutely and of all that the effects explain (tests/recovery: leave-one-out against the full catalogue)
LEFT, LEFT_SHARE = 20.0, 0.03
MANY = 8  # tests that may still pass, however little each is worth: one small difference shows in a few of them
CLOSE, CLOSE_SHARE = 10.0, 0.05  # a rival that is no further behind than this is not excluded
TOLD = 4.0  # standard errors that an effect's size is from nothing; right names are farther even at half their size
FORM = 0.1  # a rival worth less than this share of the effect it stands beside may be that one's true form


def assess_alternatives(
    rounds: Sequence[Round], left: Sequence[Score], n: int, untested: Collection[str] = ()
) -> tuple[EffectAttribution, ...]:
    """One judgement for each effect that was added.

    left: what passes the tests after the last effect; n: rows of the estimation data; untested: effects of the
    catalogue that could not take part, since the data lack an input of theirs.
    """
    chosen = [r.chosen for r in rounds if r.chosen is not None]
    total = sum(max(c.criterion, 0.0) for c in chosen)
    rest = [s for s in left if s.criterion(n) > max(LEFT, LEFT_SHARE * total)]
    found = []
    for one in rounds:
        if one.chosen is None:
            continue
        if one.chosen.unknown:
            close = tuple(q.effect.name for q in _close(one))
            found.append(EffectAttribution(one.chosen.effect.name, "nonparametric", (), close))
            continue
        reasons = [*_left(rest, n), *_many(left), *_kin(one.chosen.effect, left, len(chosen)), *_tables(chosen, one)]
        reasons += [*_form(chosen, one.chosen), *_rivals(one)]
        reasons += [*_own(one.chosen), *_untested(one.chosen.effect, untested)]
        rivals = [q.effect.name for q in _close(one)]
        rivals += [name for name in one.chosen.effect.rivals if name in untested and name not in rivals]
        name = one.chosen.effect.name
        found.append(EffectAttribution(name, "ambiguous" if reasons else "identified", tuple(reasons), tuple(rivals)))
    return tuple(found)


def _left(rest: Sequence[Score], n: int) -> list[str]:
    if not rest:
        return []
    best = max(rest, key=lambda s: s.criterion(n))
    return [f"with it the tests still find {_worded(best)}, worth {best.criterion(n):.0f} more in 2 ln L"]


def _many(left: Sequence[Score]) -> list[str]:
    return [f"with it {len(left)} tests still pass, of {_worded(left[0])} first"] if len(left) > MANY else []


def _kin(effect: Effect, left: Sequence[Score], n_added: int) -> list[str]:
    """Where several effects were added: a rival of this one that still passes, however little it is worth, since one
    effect may then do the work of all."""
    kin = [s.name for s in left if s.name in effect.rivals] if n_added > 1 else []
    return [f"with it the tests still find its rival {kin[0]}"] if kin else []


def _form(chosen: Sequence[Refit], one: Refit) -> list[str]:
    """Where this one is a small rival of a strong one: what a true form has beyond ours looks like its nearest relative
    (a shaft that falls behind by a power of the command that is not ours, like a limit to its speed)."""
    strong = [c.effect for c in chosen if one.criterion < FORM * c.criterion]
    kin = [e for e in strong if e.name in one.effect.rivals or one.effect.name in e.rivals]
    return [f"it may be no more than what {kin[0].title} has beyond its formula"] if kin else []


def _own(one: Refit) -> list[str]:
    """What its own parameters say against it when it was added: a shape that is bent into another's place ends at a
    bound, or is so much at odds with the rest of the model that its size is anyone's guess."""
    fit = one.stage.fit
    own = {fit.names.index(p.name): p for p in one.effect.parameters if p.name in fit.names}
    stuck = {name for name, what in fit.flags if what == AT_BOUND}
    for i, p in own.items():
        if p.name in stuck:
            return [f"its parameter {p.name} ({p.meaning}) is at its bound, {fit.values[i]:.3g} {p.unit}".rstrip()]
    sizes = [i for i, p in own.items() if p.value == 0.0 and fit.errors[i] > 0]
    if not sizes or _from_nothing(fit, sizes) >= TOLD:
        return []
    at = sizes[0]
    value = f"{fit.names[at]} = {fit.values[at]:.3g} ± {fit.errors[at]:.3g} {own[at].unit}".rstrip()
    return [f"the data do not tell its size: {value}"]


def _from_nothing(fit: Fit, sizes: Sequence[int]) -> float:
    """How far the estimates are from zero together, in standard errors: each may be told of the others only."""
    values = fit.values[list(sizes)]
    squared = float(values @ np.linalg.lstsq(fit.covariance[np.ix_(sizes, sizes)], values)[0])
    return math.sqrt(max(squared, 0.0))


def _worded(score: Score) -> str:
    curve = score.curve
    if curve is None:
        return score.name
    if score.kind is EffectKind.LAGGED:
        return f"that {curve.force} follows {curve.variable}"
    if score.kind is EffectKind.RESONANT:
        return f"that {curve.force} swings after {curve.variable}"
    what = f"the error of {curve.force}" if curve.force in {r.name for r in READINGS} else curve.force
    return f"that {what} depends on {' and '.join(v for v in (curve.variable, curve.second) if v)}"


def _tables(chosen: Sequence[Refit], one: Round) -> list[str]:
    """A table that had to be added beside a name, or that gains more than the name does."""
    assert one.chosen is not None
    own = one.chosen.effect.nonparametric_of
    beside = [c.effect for c in chosen if c.unknown and not c.effect.is_table_of(own)]
    reasons = [f"{effect.title} had to be added beside it" for effect in beside]
    better = [q for q in one.refits if q.unknown and q.accepted and q.criterion > one.chosen.criterion]
    return reasons + [f"{q.effect.title} would explain more" for q in better[:1]]


def _close(one: Round) -> list[Refit]:
    """Other effects that come close to the chosen one, best first."""
    assert one.chosen is not None
    least = one.chosen.criterion - max(CLOSE, CLOSE_SHARE * one.chosen.criterion)
    others = [q for q in one.refits if q is not one.chosen and not q.unknown and q.criterion > max(least, 0.0)]
    return sorted(others, key=lambda q: -q.criterion)


def _rivals(one: Round) -> list[str]:
    assert one.chosen is not None
    return [_compared(q, one.chosen.criterion - q.criterion) for q in _close(one)[:1]]


def _compared(rival: Refit, behind: float) -> str:
    if behind < 0:
        return (
            f"{rival.effect.title} explains the fitted data better (by {-behind:.0f} in 2 ln L), "
            "though not the validation data"
        )
    return f"{rival.effect.title} explains nearly as much ({behind:.0f} less in 2 ln L)"


def _untested(effect: Effect, untested: Collection[str]) -> list[str]:
    return [f"its rival {name} could not be tested on these data" for name in effect.rivals if name in untested]


def recommended_experiment(diagnosis: Diagnosis) -> str | None:
    """What would settle what is still open; ``MODEL`` in a command stands for the model that was diagnosed.

    For an effect with rivals that the data do not exclude: the experiment that shows it, and the command that designs
    the mission to tell the two apart. For one that only resembles what is missing: its experiment. Where the tests
    passed but nothing held on the validation data: the experiment of the likeliest.
    """
    lines = []
    by_name = {j.effect: j for j in diagnosis.judgements}
    for one in diagnosis.rounds:
        if one.chosen is None:
            if not diagnosis.effects and one.refits and one.refits[0].effect.experiment:
                e = one.refits[0].effect
                lines.append(f"To see whether {e.title} is there at all: {e.experiment}.")
            continue
        effect, judged = one.chosen.effect, by_name.get(one.chosen.effect.name)
        titles = {q.effect.name: q.effect.title for q in one.refits}
        rivals = [r for r in judged.rivals if r in titles] if judged is not None else []
        for rival in rivals[:1]:
            lines.append(f"To tell {effect.title} from {titles[rival]}: {effect.experiment}.")
            if diagnosis.before.model.kind is ModelKind.VEHICLE and not one.chosen.unknown:
                lines.append(f"`seatrial mission design MODEL --discriminate {effect.name},{rival}` makes the mission.")
        if judged is not None and judged.attribution == "ambiguous" and not rivals:
            lines.append(f"To see whether it is {effect.title}: {effect.experiment}.")
    return " ".join(lines) or None
