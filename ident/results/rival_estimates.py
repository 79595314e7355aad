"""Parameters of a diagnosed model whose estimate depends on which of several similar effects is in the model."""

from __future__ import annotations

from collections.abc import Sequence

import msgspec
import numpy as np

from seatrial.ident.diagnosis import EffectAttribution, Refit, Round
from seatrial.ident.estimation import ReportedEstimates
from seatrial.ident.model import Flag
from seatrial.ident.results.parts import FitSummary, ParameterRow
from seatrial.ident.results.tables import format_number

LEAST_DIFFERENCE = 1.0  # standard errors of an estimate; a smaller difference between the names is not stated


def with_rival_values(
    fit: FitSummary, names: Sequence[str], attributions: Sequence[EffectAttribution], rounds: Sequence[Round]
) -> FitSummary:
    """Return the fit with a flag at each parameter that depends on the name of an ambiguous effect.

    The flag has the estimate in the fit with the effect, and in the fits of the same round of the search that have an
    effect in its place which the data do not exclude. It is added if the estimates differ by more than a standard error
    of the final estimate. Nothing is fitted here.

    Parameters
    ----------
    fit
        Fit of the model with all effects, in reported units.
    names
        Names of the parameters of the model without effects that can have such a flag.
    attributions
        Attributions of the effects.
    rounds
        Rounds of the search, with their refits.
    """
    found: dict[str, Flag] = {}
    for a in attributions:
        search_round = next((r for r in rounds if r.chosen is not None and r.chosen.effect.name == a.effect), None)
        if a.attribution != "ambiguous" or search_round is None:
            continue
        assert search_round.chosen is not None
        rivals = [r for n in a.not_excluded for r in search_round.refits if r.effect.name == n]
        refits = [search_round.chosen, *(r for r in rivals if r.fitted.fit.converged)]
        for row in fit.parameters:
            if row.se and row.free and row.record is None and row.name.removesuffix("/T") in names:
                values = _values(row, refits)
                if np.ptp([*values.values()] or [0.0]) > LEAST_DIFFERENCE * row.se:
                    each = ", ".join(f"{format_number(v)} with {n}" for n, v in values.items())
                    text = f"depends on which of the similar effects is in the model: {each}"
                    found.setdefault(row.name, Flag("ambiguous", text))
    return msgspec.structs.replace(fit, parameters=tuple(_flagged(row, found.get(row.name)) for row in fit.parameters))


def _flagged(row: ParameterRow, flag: Flag | None) -> ParameterRow:
    """Return the row of a parameter with ``flag`` added to its flags. Without a flag, the row is unchanged."""
    if flag is None:
        return row
    text, codes = "; ".join(filter(None, (row.flag, flag))), (*row.flag_codes, flag.code)
    return msgspec.structs.replace(row, flag=text, flag_codes=codes)


def _values(row: ParameterRow, refits: Sequence[Refit]) -> dict[str, float]:
    """Return the reported estimate of a parameter in each refit that estimates it, by the name of its effect."""
    values = {}
    for r in refits:
        reported = ReportedEstimates(r.fitted.fit)
        for p in r.fitted.fit.model.parameters:
            if p.free and reported.scale.name(p.name, p.unit) == row.name:
                values[r.effect.name] = reported.estimate(p)[0]
    return values
