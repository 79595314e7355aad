"""What each effect that was added is worth: how much worse the model predicts without it.

The search takes the effects in the order of the likelihood that they gain, and that is made one sample ahead: the
small sums of many neglected things (a delay of some hundredths of a second) can gain more there than what sends the
boat elsewhere. So the effects are told in the order of what leaving each of them out, with all else fitted again, costs
further ahead: where the inputs alone take the boat in three seconds, in about the time in which its speed follows its
thrust (a thruster in one). The unexplained forces are left out of that prediction: they grow into the place of what is
missing, and carry it along.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ident.data import Record
from ident.diagnosis.results import EffectImportance, Refit, Round
from ident.engine import quickly
from ident.estimation import ROUGH, FittedModel, fit_and_evaluate
from ident.model import Model
from ident.models import residuals_of
from ident.validation import ahead, pooled

HORIZON = 0.6  # of the block of the score tests: 3 s for a boat, 1.2 s on the bench


def effect_importance(
    before: FittedModel, rounds: Sequence[Round], records: Sequence[Record], unseen: Sequence[Record]
) -> tuple[EffectImportance, ...]:
    """One for each effect that was added, the weightiest first (``in_order``)."""
    chosen = [r.chosen for r in rounds if r.chosen is not None]
    if not chosen:
        return ()
    after = chosen[-1].stage
    known = {frozenset(_added(before, q.stage)): q.stage for r in rounds for q in r.refits}
    known |= {frozenset[str](): before} | {frozenset(_added(before, c.stage)): c.stage for c in chosen}
    every = _added(before, after)
    found, best = [], _log_error(after)
    for one in chosen:
        # with a name goes the table of its own curve, which would take its place
        curve = one.effect.nonparametric_of or one.effect.parametric_form_of
        out = {one.effect.name, *(c.effect.name for c in chosen if c.effect.is_table_of(curve))}
        kept = [c for c in chosen if c.effect.name not in out]
        stage = known.get(frozenset(every - out)) or _with(kept, chosen, before, records, unseen)
        gain = 2 * (after.fit.log_posterior - stage.fit.log_posterior)
        found.append(EffectImportance(one.effect.name, gain, float(np.exp(_log_error(stage) - best))))
    return by_importance(found, chosen)


def by_importance(found: Sequence[EffectImportance], chosen: Sequence[Refit]) -> tuple[EffectImportance, ...]:
    """The weightiest first.

    A table takes up what no name explains: it comes behind the names that were there before it, and before the lighter
    ones that were found behind it. The table of the very curve that a name is one shape of comes before that name,
    which is then no more than a part of it.
    """
    tables = {c.effect.name for c in chosen if c.unknown}
    whole = {
        table.effect.name: c.effect.name
        for c in chosen
        for table in chosen
        if table.effect.is_table_of(c.effect.parametric_form_of)
    }
    found = sorted(found, key=lambda w: -w.error)
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
    """Where a table stands in the order of the names. ``search``: the order in which all were found."""
    if table.effect in whole:
        return order.index(whole[table.effect])
    behind = set(search[search.index(table.effect) + 1 :]) & set(order)
    lighter = [order.index(w.effect) for w in found if w.effect in behind and w.error < table.error]
    return min(lighter, default=len(order))


def _added(before: FittedModel, stage: FittedModel) -> set[str]:
    return {e.name for e in stage.fit.model.effects} - {e.name for e in before.fit.model.effects}


def _with(
    kept: Sequence[Refit],
    chosen: Sequence[Refit],
    before: FittedModel,
    records: Sequence[Record],
    unseen: Sequence[Record],
) -> FittedModel:
    """Only the effects that are kept, fitted again, roughly; ``before`` where that cannot be fitted."""
    last = chosen[-1].stage.fit.model
    model: Model = before.fit.model
    for other in kept:
        model = model + other.effect
    model = model.with_values({n: last.values[n] for n in model.values if n in last.values})
    try:
        with quickly(sum(r.n_rows for r in records)):
            return fit_and_evaluate(model, records, unseen, settings=ROUGH)
    except (ValueError, np.linalg.LinAlgError):
        return before


def _log_error(stage: FittedModel) -> float:
    """The mean over channels of the logarithm of the error ``HORIZON`` blocks ahead, without unexplained forces."""
    model = stage.model
    forces = [i for i, s in enumerate(model.states) if s.name in {r.state for r in residuals_of(model)}]
    parts = []
    for v in stage.validation or stage.estimation:
        x = v.run.x_filt.copy()
        x[:, forces] = 0.0
        parts.append(ahead(model, v.record, v.values, x, HORIZON * model.block))
    return float(np.mean([np.log(e.rms) for e in pooled(parts).values()]))
