"""Sizes of the effects that only some models of a comparison have: those that are not significant in their own fit."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from seatrial.ident.effects import values_without
from seatrial.ident.estimation import SavedModel
from seatrial.ident.model import Effect
from seatrial.ident.numerics import normal_ppf
from seatrial.ident.results import SIZE_NOT_SIGNIFICANT, plus_minus

LEVEL = 0.05  # of all parameters of an effect together


def size_notes(models: Mapping[str, SavedModel]) -> list[str]:
    """Return the note on effects that not all models have, and whose size is not significant; empty without any.

    Effects of nuisance parameters, and those with a value for each log or without a standard error, are not judged.

    Parameters
    ----------
    models : mapping
        Saved models by their labels in the comparison.
    """
    of = [{e.name for e in saved.model.effects} for saved in models.values()]
    common = set.intersection(*of)
    found = []
    for label, saved in models.items():
        for effect in saved.model.effects:
            if effect.name not in common and not effect.kind.nuisance and (text := _insignificant(effect, saved)):
                found.append(f"({label}) {effect.name} ({text})")
    if not found:
        return []
    return [
        f"{SIZE_NOT_SIGNIFICANT}: {'; '.join(found)}. The data of its fit do not distinguish it from zero, so that a "
        "smaller error does not show that the boat has this effect."
    ]


def _insignificant(effect: Effect, saved: SavedModel) -> str:
    """Return the strongest parameter of an effect with its error, if none is significant; else empty text."""
    own = {p.name: p for p in saved.model.parameters}
    without = values_without(effect.name)
    estimated = [p for x in effect.parameters if (p := own.get(x.name)) is not None and p.free]
    if not estimated or any(p.per_record for p in estimated):
        return ""
    errors = [saved.errors.get(p.name, np.nan) for p in estimated]
    if not np.all(np.isfinite(errors)) or min(errors) <= 0.0:
        return ""
    distances = [abs(p.value - without.get(p.name, 0.0)) / e for p, e in zip(estimated, errors, strict=True)]
    if max(distances) > normal_ppf(1.0 - LEVEL / 2.0 / len(distances)):
        return ""
    k = int(np.argmax(distances))
    size = f"{plus_minus(estimated[k].value, errors[k])} {estimated[k].unit}".rstrip()
    return f"{estimated[k].name} {size}"
