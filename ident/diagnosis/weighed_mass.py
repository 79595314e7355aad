"""Weighed mass of the boat as evidence on the names of effects.

The mass in surge is the weighed mass and the added mass of the water. An effect with the wrong name can move it away
from the weighed mass: a thrust curve of another form, for example, changes the scale of all forces at partial thrust.
"""

from __future__ import annotations

import math
from dataclasses import replace

from seatrial.ident.diagnosis.findings import Diagnosis, EffectAttribution
from seatrial.ident.estimation import PLAUSIBLE_MASS_RATIO, Fit, thrust_scale_of

MOST_MOVED = 0.1  # increase of the logarithm of the distance from this range that is still no evidence


def with_weighed_mass(diagnosis: Diagnosis, weighed: float | None) -> Diagnosis:
    """Return a diagnosis in which an implausible mass in surge makes the names of effects ambiguous.

    The mass in surge is implausible if it is below the weighed mass or above 1.5 times that mass. An effect of hull or
    thrust is ambiguous if the mass is implausible with the effects, and by at least 10 % closer to the plausible range
    without them.

    Parameters
    ----------
    diagnosis : Diagnosis
        The diagnosis.
    weighed : float or None
        Weighed mass of the boat [kg]; None: unknown, and the diagnosis is returned unchanged. So is that of a model
        without the mass in surge, or of which masses are known as ratios to the thrust only.
    """
    if weighed is None:
        return diagnosis
    masses = [_mass_in_surge(fitted.fit) for fitted in (diagnosis.before, diagnosis.after)]
    before, after = masses
    if before is None or after is None:
        return diagnosis
    if _distance(after / weighed) <= _distance(before / weighed) + MOST_MOVED:
        return diagnosis
    reason = (
        f"with the effects the mass in surge is {after:.3g} kg, and the boat weighs {weighed:.3g} kg; without them it "
        f"is {before:.3g} kg: something else may act in a similar way"
    )
    of_boat = {r.effect.name for r in diagnosis.effects if r.effect.place in ("hull", "actuator")}
    return replace(
        diagnosis,
        attributions=tuple(_doubted(a, reason) if a.effect in of_boat else a for a in diagnosis.attributions),
    )


def _doubted(found: EffectAttribution, reason: str) -> EffectAttribution:
    """Add a reason for ambiguity to the attribution of an effect. The attribution of a curve is not changed."""
    if found.attribution == "nonparametric":
        return found
    return replace(found, attribution="ambiguous", reasons=(*found.reasons, reason))


def _mass_in_surge(fit: Fit) -> float | None:
    """Return the estimated mass in surge [kg], or None if the model has no mass in surge in kilograms."""
    if "m_u" not in fit.names or thrust_scale_of(fit.model).relative:
        return None
    return fit.estimate("m_u")[0]


def _distance(ratio: float) -> float:
    """Return the distance of a ratio of masses from the plausible range, as the logarithm of a factor; 0 inside."""
    return max(0.0, math.log(ratio / PLAUSIBLE_MASS_RATIO), -math.log(ratio)) if ratio > 0.0 else math.inf
