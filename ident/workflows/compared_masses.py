"""Masses of the models of a comparison, and the warnings about them: a better prediction does not make a mass right."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import msgspec

from seatrial.ident.estimation import SavedModel, reported_units
from seatrial.ident.results import ComparedMass, ResultWarning, finite, implausible_mass

MASSES = ("m_u", "m_v", "m_r")
OF_MASSES = frozenset({"mass-implausible", "inertia-too-small"})  # codes of the warnings of a fit about its masses


class _Warnings(msgspec.Struct):
    """The part of a result.json with the time of the fit and its warnings."""

    created: str = ""
    warnings: tuple[ResultWarning, ...] = ()


def masses_of(saved: SavedModel) -> tuple[ComparedMass, ...]:
    """Return the masses in surge and sway and the yaw inertia of a model, with their standard errors.

    If the thrust is not known, they are ratios to it, as in the result of the fit. A model without masses has none.
    """
    units = reported_units(saved.model)
    found = []
    for p in (p for p in saved.model.parameters if p.name in MASSES):
        factor = units.factor(p.unit)
        se = saved.errors.get(p.name)
        found.append(
            ComparedMass(
                name=units.scale.name(p.name, p.unit),
                value=factor * p.value,
                se=None if se is None or not p.free else finite(factor * se),
                unit=units.scale.unit(p.unit),
            )
        )
    return tuple(found)


def mass_warnings_of(saved: SavedModel, path: Path, weighed: float | None) -> Iterator[ResultWarning]:
    """Yield the warnings about the masses of a model: those of its own fit, or one by the weighed mass.

    The warnings of the fit are those of the result.json beside its model.toml, if both were written together.

    Parameters
    ----------
    saved
        The model.
    path
        Its model.toml.
    weighed
        Weighed mass of the boat [kg] by the rig or import map of the compared logs; None: unknown.
    """
    own = [w for w in _own_warnings(saved, path) if w.code in OF_MASSES]
    yield from own
    if weighed is None or any(w.code == "mass-implausible" for w in own):
        return
    for mass in masses_of(saved):
        if mass.name == "m_u":  # a ratio to the thrust has another name
            yield from implausible_mass(mass.value, float("nan") if mass.se is None else mass.se, weighed)


def _own_warnings(saved: SavedModel, path: Path) -> tuple[ResultWarning, ...]:
    """Return the warnings of the fit of a model from the result.json beside it; empty without one of the same fit."""
    try:
        found = msgspec.json.decode(path.with_name("result.json").read_bytes(), type=_Warnings)
    except (OSError, msgspec.DecodeError):
        return ()
    return found.warnings if found.created == str(saved.provenance.get("created", "")) else ()
