"""Scaling of priors and step sizes with vessel size, by dimensional analysis.

An effect's prior says what is plausible: a moment of 2 N m on a boat of 37 kg. On a ferry it is nothing. The boat at
hand is taken for a copy of the catalogue's with ``mass`` times the mass and ``length`` times the length, which moves by
Froude's law: with the same accelerations, since gravity is the same, so that times and speeds go with the root of the
length. What has the unit kg^a m^b s^c then goes with

    mass^a length^(b + c/2),

whatever it stands for: forces with mass, moments with mass times length, a moment's coefficient in kg or kg m as one in
N m. Angles and shares stay, and so does what says that it is not the boat's (``Parameter.scales``): the lag of a
sensor, a link or a filter, the current, the frequency of waves.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from math import sqrt
from typing import NamedTuple

from seatrial.ident.model import Effect, Model, Parameter, State
from seatrial.ident.models.disturbances import SIZES

MASS, INERTIA = 37.0, 9.69  # kg, kg m2: the thesis' boat with its added mass (Table 1)


class Dimension(NamedTuple):
    """Exponents of kg, m and s; an angle has none."""

    mass: float = 0.0
    length: float = 0.0
    time: float = 0.0

    @property
    def unit(self) -> str:
        """``kg m2/s``: in words that `dimension` reads, for whole exponents."""
        above, below = list[str](), list[str]()
        for word, power in zip(("kg", "m", "s"), self, strict=True):
            if power:
                (above if power > 0 else below).append(word if abs(power) == 1 else f"{word}{abs(power):g}")
        under = below[0] if len(below) == 1 else f"({' '.join(below)})"
        return f"{' '.join(above) or '1'}/{under}" if below else " ".join(above)


WORDS = {"kg": Dimension(1, 0, 0), "N": Dimension(1, 1, -2), "m": Dimension(0, 1, 0), "s": Dimension(0, 0, 1),
         "Hz": Dimension(0, 0, -1)}  # fmt: skip


def dimension(unit: str) -> Dimension:
    """Of a unit such as ``kg m2/s``, ``N s2/m2`` or ``m/s/sqrt(s)``; other words than those of ``WORDS`` have none."""
    mass = length = time = 0.0
    for i, part in enumerate(unit.split("/")):
        for root, word, power in re.findall(r"(sqrt\()?([A-Za-z]+)(\d*)", part):
            of = WORDS.get(word, Dimension())
            k = (1.0 if i == 0 else -1.0) * float(power or 1) * (0.5 if root else 1.0)
            mass, length, time = mass + k * of.mass, length + k * of.length, time + k * of.time
    return Dimension(mass, length, time)


def unit_over(unit: str, *others: str) -> str:
    """Unit of a coefficient that gives ``unit`` when it is multiplied by the others: ``N m`` over ``N`` is ``m``."""
    found = dimension(unit)
    for other in others:
        found = Dimension(*(a - b for a, b in zip(found, dimension(other), strict=True)))
    return found.unit


@dataclass(frozen=True)
class VesselScale:
    """Mass and length of a boat over those of the catalogue's."""

    mass: float = 1.0
    length: float = 1.0

    def of(self, unit: str) -> float:
        """Factor of what has this unit."""
        found = dimension(unit)
        return float(self.mass**found.mass * self.length ** (found.length + 0.5 * found.time))


def force_power(unit: str) -> int:
    """Power with which a coefficient of this unit goes with the scale of forces and masses."""
    return round(dimension(unit).mass)


def is_moment(unit: str) -> bool:
    """Whether a coefficient of this unit belongs to a moment, else to a force."""
    return "N m" in unit.partition("/")[0] or _lengths(unit) >= 2


def _lengths(unit: str) -> int:
    above, _, below = unit.partition("/")
    return len(re.findall(r"\bm\b", above)) + 2 * len(re.findall(r"\bm2\b", above)) - len(re.findall(r"\bm2?\b", below))


def size_of(model: Model) -> VesselScale:
    """From the masses of a fitted model, the length by the radius of gyration; the catalogue's own size where it has no
    mass, its shape where it has no moment of inertia."""
    values = model.values
    if "m_u" not in values:
        return VesselScale()
    mass = values["m_u"] / MASS
    return VesselScale(mass, sqrt(values["m_r"] / INERTIA / mass) if "m_r" in values else mass ** (1 / 3))


def rescale(model: Model, size: VesselScale) -> Model:
    """The model with disturbance forces for a boat of this size: their spread at the start, and what is plausible
    for their diffusion. Their correlation time stays, so both go by one factor."""
    factors = {"X": size.of("N"), "Y": size.of("N"), "N": size.of("N m")}
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
    """The effect with priors, steps, bounds, values to try and the start of its states for a boat of this size."""
    factors = {p.name: size.of(p.unit) if p.scales else 1.0 for p in effect.parameters}
    return replace(
        effect,
        parameters=tuple(_sized(p, factors[p.name]) for p in effect.parameters),
        states=tuple(_sized_state(s, size.of(s.unit)) for s in effect.states),
        scan={name: tuple(factors.get(name, 1.0) * z for z in tried) for name, tried in effect.scan.items()},
    )


def _sized(p: Parameter, factor: float) -> Parameter:
    if factor == 1.0:
        return p
    prior = None if p.prior is None else (factor * p.prior[0], factor * p.prior[1])
    low, high = p.bounds
    return replace(p, value=factor * p.value, prior=prior, step=factor * p.step, bounds=(factor * low, factor * high))


def _sized_state(s: State, factor: float) -> State:
    """Mean, spread and diffusion, where they are numbers; what a parameter holds is the parameter's to scale."""
    if factor == 1.0:
        return s
    noise, x0, sd0 = (z if isinstance(z, str) else factor * z for z in (s.noise, s.x0, s.sd0))
    return replace(s, noise=noise, x0=x0, sd0=sd0)
