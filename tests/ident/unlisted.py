"""Kinds of effects outside the catalogue, by their display names."""

from __future__ import annotations

import re
from typing import Any

from seatrial.ident.model.structure import EffectKind, ForceCurve

KINDS = {"": EffectKind.NONPARAMETRIC, "past of ": EffectKind.LAGGED, "swing after ": EffectKind.RESONANT}


def kind_of(name: str) -> dict[str, Any]:
    """Return kind and curve of ``X(u)``, ``unknown N(u, r)`` or ``X(past of n_sum)``. The result is empty for a name in
    the catalogue.
    """
    found = re.fullmatch(r"(?:unknown )?(\w+)\((past of |swing after |)(\w+)(?:, (\w+))?\)", name)
    if found is None:
        return {}
    force, way, variable, second = found.groups()
    return {"kind": KINDS[way], "curve": ForceCurve(force, variable, second or "")}
