"""Scaling of priors and step sizes with vessel size.

An effect's prior says what is plausible: a moment of 2 N m on a boat of 37 kg. On a ferry it is nothing. Speeds and
yaw rates of boats differ little, forces and moments go with mass and moment of inertia: so do these priors.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from math import sqrt

from ident.model import Effect, Model, Parameter
from ident.models.disturbances import SIZES

DRAG_AREA = "N s2/m2"  # unit of half the density of air times area times drag coefficient
MASS, INERTIA = 37.0, 9.69  # kg, kg m2: the thesis' boat with its added mass (Table 1)


@dataclass(frozen=True)
class VesselScale:
    """force, moment: factors on what is plausible as a force and as a moment."""

    force: float = 1.0
    moment: float = 1.0

    def of(self, unit: str) -> float:
        """Factor of a coefficient with this unit; 1 where no mass or force is in it."""
        if unit == DRAG_AREA:  # area goes with the square of length, mass with its cube
            return float(self.force ** (2 / 3))
        moment = is_moment(unit)
        # a coefficient in kg m may be a force or a moment
        either = _lengths(unit) == 1 and not moment
        factor = self.moment if moment else sqrt(self.force * self.moment) if either else self.force
        return float(factor ** force_power(unit))


def force_power(unit: str) -> int:
    """Power with which a coefficient of this unit goes with the scale of forces and masses."""
    above, _, below = unit.partition("/")
    return len(re.findall(r"\b(?:kg|N)\b", above)) - len(re.findall(r"\b(?:kg|N)\b", below))


def is_moment(unit: str) -> bool:
    """Whether a coefficient of this unit belongs to a moment, else to a force."""
    return "N m" in unit.partition("/")[0] or _lengths(unit) >= 2


def _lengths(unit: str) -> int:
    above, _, below = unit.partition("/")
    return (
        len(re.findall(r"\bm\b", above))
        + 2 * len(re.findall(r"\bm2\b", above))
        - len(re.findall(r"\bm2?\b", below))
    )


def size_of(model: Model) -> VesselScale:
    """From the masses of a fitted model; the catalogue's own size where it has none."""
    values = model.values
    if "m_u" not in values:
        return VesselScale()
    force = values["m_u"] / MASS
    return VesselScale(force, values["m_r"] / INERTIA if "m_r" in values else force)


def rescale(model: Model, size: VesselScale) -> Model:
    """The model with disturbance forces for a boat of this size: their spread at the start, and what is plausible
    for their diffusion."""
    factors = {"X": size.force, "Y": size.force, "N": size.moment}
    of_state = {f"b_{name}": name for name in factors}
    states, new = [], []
    for s in model.states:
        name = of_state.get(s.name)
        if name is not None and f"q_{name}" in model.values:
            q = model.parameter(f"q_{name}")
            sd0 = SIZES[name][0] * factors[name]
            scale = sd0 / float(s.sd0)
            s = replace(s, sd0=sd0)
            if q.prior is not None:
                fresh = q.value == q.prior[0]
                prior = (scale * q.prior[0], scale * q.prior[1])
                new.append(replace(q, prior=prior, value=prior[0] if fresh else q.value))
        states.append(s)
    return replace(model, states=tuple(states)).replace_parameters(*new)


def scale_priors(effect: Effect, size: VesselScale) -> Effect:
    """The effect with priors and steps for a boat of this size."""
    return replace(effect, parameters=tuple(_sized(p, size.of(p.unit)) for p in effect.parameters))


def _sized(p: Parameter, factor: float) -> Parameter:
    if factor == 1.0:
        return p
    prior = None if p.prior is None else (factor * p.prior[0], factor * p.prior[1])
    low, high = p.bounds
    return replace(p, value=factor * p.value, prior=prior, step=factor * p.step, bounds=(factor * low, factor * high))
