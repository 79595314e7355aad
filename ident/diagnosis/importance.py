"""Effect importance: prediction error of the model without one effect, divided by that with all effects.

The search selects effects by the gain in likelihood, which measures one-step predictions. The sum of many small
neglected effects (for example a delay of some hundredths of a second) can gain more likelihood than an effect that
changes the motion of the boat. So the effects are ranked by the loss of predictive accuracy. Each effect is left out in
turn, the other effects are fitted again, and the prediction over three seconds by inputs alone is compared
(``Comparison.error_ratio``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial

import numpy as np

from seatrial.ident.data import Record
from seatrial.ident.diagnosis.acceptance import comparison
from seatrial.ident.diagnosis.findings import EffectImportance, Refit, Round
from seatrial.ident.diagnosis.policy import DEFAULT_POLICY, SearchPolicy
from seatrial.ident.engine import quick_compilation
from seatrial.ident.estimation import (
    FIT_ERRORS,
    ROUGH_SEARCH,
    FittedModel,
    SearchSettings,
    ValidationData,
    fit_and_evaluate,
)
from seatrial.ident.model import Effect, Model


@dataclass(frozen=True)
class RoughFits:
    """Fits of models with some of the chosen effects, by which the importance of the others is measured.

    Attributes
    ----------
    settings
        Settings of the searches.
    fits
        Fitted models by the names of their added effects.
    """

    settings: SearchSettings = ROUGH_SEARCH
    fits: dict[frozenset[str], FittedModel] = field(default_factory=dict)


def effect_importance(
    before: FittedModel,
    after: FittedModel,
    chosen: Sequence[Refit],
    rounds: Sequence[Round],
    records: Sequence[Record],
    validation_data: ValidationData,
    policy: SearchPolicy = DEFAULT_POLICY,
    rough: RoughFits | None = None,
) -> tuple[EffectImportance, ...]:
    """Compute the importance of each chosen effect; the most important comes first (`by_importance`).

    Each effect is left out in turn, and the other effects are fitted again by a rough search. If a refit of the search
    or a fit in ``rough`` has the same effects, it is used instead. A chosen nonparametric curve of which the catalogue
    declares the effect to be one form is left out together with the effect (`left_out_with`).

    Parameters
    ----------
    before, after
        Fitted models without and with all chosen effects.
    chosen
        Refits of the chosen effects, in the order of their selection.
    rounds
        Rounds of the search, whose refits are used again if they have the right effects.
    records
        Estimation data.
    validation_data
        Validation records, or blocks in time of the estimation data.
    policy
        Thresholds of the comparison.
    rough
        Rough fits of earlier calls with the same ``before`` and records, and their settings. The fits of this call are
        added in place. None: no such fits, and the settings of `RoughFits`.

    Returns
    -------
    tuple of EffectImportance
        One for each chosen effect; empty if none was chosen. If the model without the effect cannot be fitted or
        compared, its numbers are NaN and ``untested`` is the reason. A smaller model in its place would attribute the
        gain of other effects to this effect.
    """
    if not chosen:
        return ()
    shared = {e.name for e in before.fit.model.effects}
    refits = [q for r in rounds for q in r.refits if shared <= {e.name for e in q.fitted.fit.model.effects}]
    known_fits = {frozenset(_added_effect_names(before, q.fitted)): q.fitted for q in refits}
    known_fits |= {frozenset[str](): before}
    rough = rough or RoughFits()
    added = _added_effect_names(before, after)
    found = []
    for refit in chosen:
        left_out = left_out_with(refit.effect, chosen)
        kept = [c for c in chosen if c.effect.name not in left_out]
        try:
            names = frozenset(added - left_out)
            fitted = known_fits.get(names) or rough.fits.get(names)
            if fitted is None:
                fitted = _fit_with_effects(kept, after, before, records, validation_data, rough.settings)
                rough.fits[names] = fitted
            found.append(_importance(refit, fitted, after, policy, alone=len(left_out) == 1))
        except FIT_ERRORS as problem:
            unknown = float("nan")
            found.append(EffectImportance(refit.effect.name, unknown, unknown, untested=str(problem)))
    return by_importance(found, chosen)


def _importance(
    refit: Refit, without: FittedModel, after: FittedModel, policy: SearchPolicy, *, alone: bool
) -> EffectImportance:
    """Return the importance of the effect of a refit, by comparison of two fitted models.

    ``without`` is the model without the effect, and ``after`` the model with all effects. ``alone`` is True if no other
    effect is left out of ``without``. If it is True and the fitted model of the refit is ``after``, the refit contains
    the comparison on the validation data already, and this comparison is used again. ValueError is raised if the two
    models cannot be compared.
    """
    gain = 2 * (after.fit.log_posterior - without.fit.log_posterior)
    compared = comparison(without, after, refit.effect, policy)
    # if the effect was added last, the search has already compared these models
    if refit.fitted is after and alone and refit.prediction is not None:
        gain_and_t, prediction = (refit.validation_gain, refit.t), refit.prediction
    else:
        gain_and_t, prediction = compared.gain, compared.prediction
    return EffectImportance(refit.effect.name, gain, compared.error_ratio, *gain_and_t, prediction)


def left_out_with(effect: Effect, chosen: Sequence[Refit]) -> set[str]:
    """Return the names of the effects that are left out of the model to measure the importance of one effect.

    They are the effect itself, and a chosen nonparametric curve of which the catalogue declares the effect to be one
    form (`Effect.nonparametric_of` or `Effect.parametric_form_of`). The curve would take the place of the effect.

    Parameters
    ----------
    effect
        Effect whose importance is measured.
    chosen
        Refits of all chosen effects.
    """
    curve = effect.nonparametric_of or effect.parametric_form_of
    return {effect.name, *(c.effect.name for c in chosen if c.effect.is_table_of(curve))}


def fit_without(
    before: FittedModel,
    after: FittedModel,
    chosen: Sequence[Refit],
    effect: Effect,
    records: Sequence[Record],
    validation_data: ValidationData,
    settings: SearchSettings | None = None,
) -> FittedModel:
    """Fit the model with all chosen effects except one.

    Parameters
    ----------
    before, after
        Fitted models without and with all chosen effects. The search starts at the values of ``after``.
    chosen
        Refits of the chosen effects.
    effect
        Effect to leave out. It must be the object in ``chosen``; an equal copy is not recognised.
    records
        Estimation data.
    validation_data
        Validation records, or blocks in time of the estimation data.
    settings
        Settings of the search. None for the default settings, those of an exact fit.

    Returns
    -------
    FittedModel
        ``before`` itself, not fitted again, if no other effect was chosen.

    Raises
    ------
    FIT_ERRORS
        If the fit fails: ``ValueError``, ``ArithmeticError`` or ``LinAlgError``.
    """
    kept = [c for c in chosen if c.effect is not effect]
    return _fit_with_effects(kept, after, before, records, validation_data, settings) if kept else before


def by_importance(found: Sequence[EffectImportance], chosen: Sequence[Refit]) -> tuple[EffectImportance, ...]:
    """Sort effects by importance. Parametric effects are sorted by error ratio: largest first, unknown (NaN) last.

    Parameters
    ----------
    found
        Importance of each effect.
    chosen
        Refits of the effects in the order of their selection.

    Notes
    -----
    A nonparametric curve explains the part that no parametric effect explains. So a curve comes before the first less
    important effect that was selected after it, or at the end if there is none. If a parametric effect is one form of a
    curve, the curve comes directly before the effect, which is then only a part of the curve.
    """
    curves = {c.effect.name for c in chosen if c.nonparametric}
    whole = {
        table.effect.name: c.effect.name
        for c in chosen
        for table in chosen
        if table.effect.is_table_of(c.effect.parametric_form_of)
    }
    found = sorted(
        found, key=lambda w: np.inf if np.isnan(w.error_ratio) else -w.error_ratio
    )  # unknown importance last
    order = [w.effect for w in found if w.effect not in curves]
    for w in found:
        if w.effect in curves:
            order.insert(_rank_of_curve(w, found, order, [c.effect.name for c in chosen], whole), w.effect)
    return tuple(sorted(found, key=lambda w: order.index(w.effect)))


def _rank_of_curve(
    table: EffectImportance,
    found: Sequence[EffectImportance],
    order: Sequence[str],
    search: Sequence[str],
    whole: Mapping[str, str],
) -> int:
    """Return the index in ``order`` at which a nonparametric curve is inserted among the parametric effects.

    A curve of which a chosen parametric effect is one form comes directly before that effect. Another curve comes
    before the first less important effect that was selected after it, or at the end.

    Parameters
    ----------
    table
        Importance of the curve.
    found
        Importances of all effects.
    order
        Names of the effects that are ranked already, the most important first.
    search
        Names of all effects in the order of their selection.
    whole
        Name of the parametric effect that is one form of a curve, by the name of the curve.
    """
    if table.effect in whole:
        return order.index(whole[table.effect])
    behind = set(search[search.index(table.effect) + 1 :]) & set(order)
    lighter = [order.index(w.effect) for w in found if w.effect in behind and w.error_ratio < table.error_ratio]
    return min(lighter, default=len(order))


def _added_effect_names(before: FittedModel, fitted: FittedModel) -> set[str]:
    """Return the names of the effects that a model has in addition to those of ``before``."""
    return {e.name for e in fitted.fit.model.effects} - {e.name for e in before.fit.model.effects}


def _fit_with_effects(
    kept: Sequence[Refit],
    after: FittedModel,
    before: FittedModel,
    records: Sequence[Record],
    validation_data: ValidationData,
    settings: SearchSettings | None,
) -> FittedModel:
    """Fit the model of ``before`` with only the kept effects added.

    The search starts at the values of ``after``, or at those of ``before`` with the kept effects as in ``after``, or
    halfway between both, wherever the likelihood is highest.

    Parameters
    ----------
    kept
        Refits of the effects to add.
    after, before
        Fitted models with all effects, and without them.
    records
        Estimation data.
    validation_data
        Validation records, or blocks in time of the estimation data.
    settings
        Settings of the search. None for the settings of an exact fit.

    Raises
    ------
    FIT_ERRORS
        If the fit fails: ``ValueError``, ``ArithmeticError`` or ``LinAlgError``.
    """
    last = after.fit.model
    model: Model = before.fit.model
    for refit in kept:
        model = model + refit.effect
    model = model.with_values({n: last.values[n] for n in model.values if n in last.values})
    start = after.fit.start_values(model)
    without = before.fit.start_values(before.fit.model)
    # The other parameters made up for the effect that is left out, so that their values of ``after`` may be far away.
    halfway = {n: (without[n] + start[n]) / 2 for n in without if n in start}
    fit_it = partial(
        fit_and_evaluate, model, records, validation_data, settings=settings, start=start,
        other_starts=(without, halfway),
    )  # fmt: skip
    if settings is None or settings.robust_errors:
        return fit_it()
    with quick_compilation(sum(r.n_rows for r in records)):
        return fit_it()
