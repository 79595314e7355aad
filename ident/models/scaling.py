"""Scaling of priors and step sizes with the size of the vessel, by dimensional analysis.

The priors of effects are for the boat of the catalogue, which is the boat of the thesis (37 kg). For example, a moment
of 2 N m is plausible on a boat of 37 kg and negligible on a ferry. The boat at hand is treated as a scaled copy of the
boat of the catalogue, with ``mass`` times the mass and ``length`` times the length. The boat moves by Froude's law:
accelerations are equal because gravity is equal, so times and speeds scale with the square root of the length. A
quantity of the unit kg^a m^b s^c then scales with

    mass^a length^(b + c/2),

whatever it represents. Forces scale with mass, and moments scale with mass times length. Coefficients of moments scale
by the same rule, whether their unit is kg, kg m or N m. Angles and shares do not scale. Parameters that are not
properties of the boat do not scale either (``Parameter.scales``): the lag of a sensor, link or filter, the current, and
the frequency of waves.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, replace
from math import sqrt
from typing import NamedTuple

from seatrial.ident.model import Effect, EffectPrior, Model, Parameter, ParameterOrigin, State
from seatrial.ident.models.disturbances import SIZES
from seatrial.ident.models.published_values import TABLE_1

MASS, INERTIA = TABLE_1["m_u"], TABLE_1["m_r"]  # kg, kg m2: the boat of the thesis, with added mass


class Dimension(NamedTuple):
    """Exponents of kg, m and s in a unit. All exponents of an angle are zero.

    Attributes
    ----------
    mass, length, time : float
        Exponents of kg, m and s. For example, they are (1, 1, -2) for a force.
    """

    mass: float = 0.0
    length: float = 0.0
    time: float = 0.0

    @property
    def unit(self) -> str:
        """Unit as text that `dimension` can parse, for example ``kg m2/s`` or ``1/s``.

        The exponents must be integers, which is not checked. The words come in the order kg, m, s. Several words in the
        denominator are in brackets. The text is empty if all exponents are zero.
        """
        above, below = list[str](), list[str]()
        for word, power in zip(("kg", "m", "s"), self, strict=True):
            if power:
                (above if power > 0 else below).append(word if abs(power) == 1 else f"{word}{abs(power):g}")
        under = below[0] if len(below) == 1 else f"({' '.join(below)})"
        return f"{' '.join(above) or '1'}/{under}" if below else " ".join(above)


WORDS = {"kg": Dimension(1, 0, 0), "N": Dimension(1, 1, -2), "m": Dimension(0, 1, 0), "s": Dimension(0, 0, 1),
         "Hz": Dimension(0, 0, -1)}  # fmt: skip


def dimension(unit: str) -> Dimension:
    """Return the exponents of kg, m and s in a unit such as ``kg m2/s``, ``N s2/m2`` or ``m/s/sqrt(s)``.

    Every word after the first ``/`` is in the denominator. A digit behind a word is its exponent; ``sqrt(`` halves that
    of the first word behind it only. N and Hz are converted to kg, m and s. Words that are not in ``WORDS``, such as
    ``rad``, are ignored. The exponents of an empty text are zero.
    """
    mass = length = time = 0.0
    for i, part in enumerate(unit.split("/")):
        for root, word, power in re.findall(r"(sqrt\()?([A-Za-z]+)(\d*)", part):
            base = WORDS.get(word, Dimension())
            k = (1.0 if i == 0 else -1.0) * float(power or 1) * (0.5 if root else 1.0)
            mass, length, time = mass + k * base.mass, length + k * base.length, time + k * base.time
    return Dimension(mass, length, time)


def unit_over(unit: str, *others: str) -> str:
    """Return ``unit`` divided by the units ``others``. For example, ``N m`` over ``N`` is ``m``.

    The result is a text in kg, m and s: ``N`` without ``others`` gives ``kg m/s2``. It is empty for a quotient without
    a unit, such as ``N`` over ``N``.
    """
    result = dimension(unit)
    for other in others:
        result = Dimension(*(a - b for a, b in zip(result, dimension(other), strict=True)))
    return result.unit


@dataclass(frozen=True)
class VesselScale:
    """Mass and length of a boat, relative to the boat of the catalogue (37 kg).

    Attributes
    ----------
    mass, length : float
        Ratios to the mass and length of that boat, > 0.
    """

    mass: float = 1.0
    length: float = 1.0

    def of(self, unit: str) -> float:
        """Return the ratio of a quantity of this ``unit``, for example ``N m``, to that of the catalogue's boat.

        The ratio is ``mass^a length^(b + c/2)`` for a unit kg^a m^b s^c. It is 1 without a unit.
        """
        exponents = dimension(unit)
        return float(self.mass**exponents.mass * self.length ** (exponents.length + 0.5 * exponents.time))


def force_power(unit: str) -> int:
    """Return the power of a factor on all forces and masses by which a coefficient of this ``unit`` is multiplied.

    It is the exponent of kg in the unit, rounded to an integer: 1 for ``kg/m`` or ``N``, 0 for ``m``.
    """
    return round(dimension(unit).mass)


def is_moment(unit: str) -> bool:
    """Return whether a coefficient of this ``unit`` belongs to a moment (True) or to a force (False).

    A moment has ``N m`` in the numerator, or metres with a total exponent of two or more (``kg m2/s``). Any other unit
    gives False, also one without a force.
    """
    return "N m" in unit.partition("/")[0] or _metre_exponent(unit) >= 2


def _metre_exponent(unit: str) -> int:
    """Return the exponent of metres in a ``unit``: 2 for ``kg m2/s``, -1 for ``kg/m``.

    Only the words ``m`` and ``m2`` are counted. A word ``m2`` after the ``/`` counts as one, not two.
    """
    above, _, below = unit.partition("/")
    return len(re.findall(r"\bm\b", above)) + 2 * len(re.findall(r"\bm2\b", above)) - len(re.findall(r"\bm2?\b", below))


def size_of(model: Model) -> VesselScale:
    """Return the size of the boat of a model, relative to the boat of the catalogue (37 kg).

    Parameters
    ----------
    model : Model
        Model with the values of the boat's parameters. The mass ratio follows from its surge mass ``m_u``, and the
        length ratio from the radius of gyration ``sqrt(m_r / m_u)``.

    Returns
    -------
    VesselScale
        Size, from the present values of the parameters. Without a moment of inertia ``m_r``, the length ratio is the
        cube root of the mass ratio. Without ``m_u``, both ratios are 1.
    """
    values = model.values
    if "m_u" not in values:
        return VesselScale()
    mass = values["m_u"] / MASS
    return VesselScale(mass, sqrt(values["m_r"] / INERTIA / mass) if "m_r" in values else mass ** (1 / 3))


def rescale(model: Model, size: VesselScale) -> Model:
    """Return the model with the priors of its disturbance forces on surge, sway and yaw scaled to the size of a boat.

    Parameters
    ----------
    model : Model
        Model to change. It may lack the states ``b_X``, ``b_Y`` or ``b_N`` of the disturbance forces.
    size : VesselScale
        Size of the boat relative to the boat of the catalogue.

    Returns
    -------
    Model
        The initial standard deviation of each disturbance force is that of the catalogue (`SIZES`) times the ratio of
        forces or moments. The prior of its diffusion changes by the same factor as the initial standard deviation,
        because the correlation time does not change. A diffusion that is equal to the mean of its prior moves with the
        prior. Any other diffusion has been fitted and is kept, and so is one without a prior. A disturbance state
        without a parameter ``q_X``, ``q_Y`` or ``q_N`` is not changed.
    """
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
                unfitted = q.value == q.prior[0]  # a fitted diffusion is kept
                prior = (scale * q.prior[0], scale * q.prior[1])
                new.append(replace(q, prior=prior, value=prior[0] if unfitted else q.value))
        states.append(s)
    return replace(model, states=tuple(states)).replace_parameters(*new)


def scale_priors(effect: Effect, size: VesselScale) -> Effect:
    """Return the effect with its parameters and states scaled from the boat of the catalogue to a boat of this size.

    Parameters
    ----------
    effect : Effect
        Effect for the boat of the catalogue.
    size : VesselScale
        Size of the boat relative to the boat of the catalogue.

    Returns
    -------
    Effect
        Values, priors, steps and bounds of parameters, values to scan, and initial values and diffusions of states are
        multiplied by the factors of their units. Parameters with ``scales`` False and their values to scan are
        unchanged.
    """
    factors = {p.name: size.of(p.unit) if p.scales else 1.0 for p in effect.parameters}
    return replace(
        effect,
        parameters=tuple(_scaled_parameter(p, factors[p.name]) for p in effect.parameters),
        states=tuple(_scaled_state(s, size.of(s.unit)) for s in effect.states),
        scan={name: tuple(factors.get(name, 1.0) * z for z in tried) for name, tried in effect.scan.items()},
    )


def effect_for(model: Model, effect: Effect) -> Effect:
    """Return an effect of the catalogue for the boat of a model.

    Its priors have the size of the boat (`scale_priors`). A prior that the numbers of the boat give
    (`Model.effect_priors`) replaces that of the catalogue, and its mean the values to scan. The meaning of the
    parameter then says where the number was given.
    """
    scaled = scale_priors(effect, size_of(model))
    given = {p.name: p for p in model.effect_priors}
    return replace(
        scaled,
        parameters=tuple(_with_given_prior(p, given[p.name]) if p.name in given else p for p in scaled.parameters),
        scan={name: (given[name].mean,) if name in given else tried for name, tried in scaled.scan.items()},
    )


def _with_given_prior(p: Parameter, given: EffectPrior) -> Parameter:
    """Return the parameter with a prior from the numbers of the boat, whose source its meaning names."""
    known = p.known(given.mean, given.sd, ParameterOrigin.PRIOR)
    return replace(known, meaning=f"{p.meaning} (prior: {given.source})")


def rescale_effects(model: Model, assumed: VesselScale, found: VesselScale) -> Model:
    """Return the model with the priors of its effects scaled from an assumed size of the boat to the found one.

    Only priors that are built in are scaled, with step and bounds; those that the user has given are kept. Values are
    kept inside the bounds. Disturbances and errors of sensors are unchanged (`rescale`).
    """
    ratio = VesselScale(found.mass / assumed.mass, found.length / assumed.length)
    names = [p.name for e in model.effects if not e.kind.nuisance for p in e.parameters]
    new = []
    for p in map(model.parameter, names):
        if p.scales and p.free and p.prior is not None and p.origin is ParameterOrigin.BUILT_IN:
            scaled = _scaled_parameter(p, ratio.of(p.unit))
            low, high = scaled.bounds
            new.append(replace(scaled, value=min(max(p.value, low), high)))
    return model.replace_parameters(*new)


def _scaled_parameter(p: Parameter, factor: float) -> Parameter:
    """Return the parameter with its value, prior, step and bounds multiplied by ``factor``.

    Both mean and standard deviation of the prior are multiplied. A parameter without a prior stays without one. With
    the factor 1, return the same object.
    """
    if factor == 1.0:
        return p
    prior = None if p.prior is None else (factor * p.prior[0], factor * p.prior[1])
    low, high = p.bounds
    return replace(p, value=factor * p.value, prior=prior, step=factor * p.step, bounds=(factor * low, factor * high))


def _scaled_state(s: State, factor: float) -> State:
    """Return the state with its initial mean, initial standard deviation and diffusion multiplied by ``factor``.

    An entry that is the name of a parameter instead of a number is kept; `_scaled_parameter` scales that parameter.
    With the factor 1, return the same object.
    """
    if factor == 1.0:
        return s
    noise, x0, sd0 = (z if isinstance(z, str) else factor * z for z in (s.noise, s.x0, s.sd0))
    return replace(s, noise=noise, x0=x0, sd0=sd0)
