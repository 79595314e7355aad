"""Effect importance: leave-one-effect-out prediction error.

The search selects effects by the gain in likelihood, which is of one-step predictions: the sum of many small neglected
effects (a delay of some hundredths of a second) can gain more there than an effect that moves the boat elsewhere. So
the effects are ranked by the loss of predictive accuracy when each is left out and the rest is fitted again: three
seconds ahead by inputs alone (``Comparison.error_ratio``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from seatrial.ident.data import Record
from seatrial.ident.diagnosis.acceptance import comparison
from seatrial.ident.diagnosis.results import EffectImportance, Refit, Round
from seatrial.ident.engine import quickly
from seatrial.ident.estimation import FIT_ERRORS, ROUGH, FittedModel, Unseen, fit_and_evaluate
from seatrial.ident.model import Effect, Model


def effect_importance(
    before: FittedModel,
    after: FittedModel,
    chosen: Sequence[Refit],
    rounds: Sequence[Round],
    records: Sequence[Record],
    unseen: Unseen,
) -> tuple[EffectImportance, ...]:
    """Importance of each ``chosen`` effect of the model ``after``, largest first (``by_importance``); unknown where the
    model without the effect cannot be fitted: any smaller model in its place would give it the gain of other effects.
    """
    if not chosen:
        return ()
    known = {frozenset(_added(before, q.stage)): q.stage for r in rounds for q in r.refits}
    known |= {frozenset[str](): before}
    every = _added(before, after)
    found = []
    for one in chosen:
        out = left_out_with(one.effect, chosen)
        kept = [c for c in chosen if c.effect.name not in out]
        try:
            stage = known.get(frozenset(every - out)) or _with(kept, after, before, records, unseen)
            found.append(_importance(one, stage, after, alone=len(out) == 1))
        except FIT_ERRORS as problem:
            unknown = float("nan")
            found.append(EffectImportance(one.effect.name, unknown, unknown, untested=str(problem)))
    return by_importance(found, chosen)


def _importance(one: Refit, without: FittedModel, after: FittedModel, *, alone: bool) -> EffectImportance:
    """Of an effect, by the model ``without`` it; ``alone``: nothing was left out with it."""
    gain = 2 * (after.fit.log_posterior - without.fit.log_posterior)
    compared = comparison(without, after, one.effect)
    if one.stage is after and alone and one.prediction is not None:  # as it was accepted
        worth, prediction = (one.validation_gain, one.t), one.prediction
    else:
        worth, prediction = compared.gain, compared.prediction
    return EffectImportance(one.effect.name, gain, compared.error_ratio, *worth, prediction)


def left_out_with(effect: Effect, chosen: Sequence[Refit]) -> set[str]:
    """Names of what goes with an effect: its nonparametric curve, as that would take its place."""
    curve = effect.nonparametric_of or effect.parametric_form_of
    return {effect.name, *(c.effect.name for c in chosen if c.effect.is_table_of(curve))}


def fit_without(
    before: FittedModel,
    after: FittedModel,
    chosen: Sequence[Refit],
    effect: Effect,
    records: Sequence[Record],
    unseen: Unseen,
) -> FittedModel:
    """The model with all ``chosen`` effects but one, fitted exactly. Raises one of ``FIT_ERRORS`` where that fails."""
    kept = [c for c in chosen if c.effect is not effect]
    return _with(kept, after, before, records, unseen, exact=True) if kept else before


def by_importance(found: Sequence[EffectImportance], chosen: Sequence[Refit]) -> tuple[EffectImportance, ...]:
    """Effects by importance, largest first.

    A nonparametric curve explains what no parametric effect does: it follows the parametric effects that were selected
    before it, and precedes less important ones selected after it. The curve of which a parametric effect is one form
    precedes that effect, which is then only a part of it.
    """
    tables = {c.effect.name for c in chosen if c.unknown}
    whole = {
        table.effect.name: c.effect.name
        for c in chosen
        for table in chosen
        if table.effect.is_table_of(c.effect.parametric_form_of)
    }
    found = sorted(found, key=lambda w: np.inf if np.isnan(w.error) else -w.error)  # the unknown last
    order = [w.effect for w in found if w.effect not in tables]
    for w in found:
        if w.effect in tables:
            order.insert(_place(w, found, order, [c.effect.name for c in chosen], whole), w.effect)
    return tuple(sorted(found, key=lambda w: order.index(w.effect)))


def _place(
    table: EffectImportance,
    found: Sequence[EffectImportance],
    order: Sequence[str],
    search: Sequence[str],
    whole: Mapping[str, str],
) -> int:
    """Rank of a nonparametric curve among the parametric effects. ``search``: the order of selection."""
    if table.effect in whole:
        return order.index(whole[table.effect])
    behind = set(search[search.index(table.effect) + 1 :]) & set(order)
    lighter = [order.index(w.effect) for w in found if w.effect in behind and w.error < table.error]
    return min(lighter, default=len(order))


def _added(before: FittedModel, stage: FittedModel) -> set[str]:
    return {e.name for e in stage.fit.model.effects} - {e.name for e in before.fit.model.effects}


def _with(
    kept: Sequence[Refit],
    after: FittedModel,
    before: FittedModel,
    records: Sequence[Record],
    unseen: Unseen,
    *,
    exact: bool = False,
) -> FittedModel:
    """Refit with only the kept effects, from the values of ``after``."""
    last = after.fit.model
    model: Model = before.fit.model
    for other in kept:
        model = model + other.effect
    model = model.with_values({n: last.values[n] for n in model.values if n in last.values})
    if exact:
        return fit_and_evaluate(model, records, unseen)
    with quickly(sum(r.n_rows for r in records)):
        return fit_and_evaluate(model, records, unseen, settings=ROUGH)
