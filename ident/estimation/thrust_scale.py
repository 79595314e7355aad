"""The scale of forces: where it comes from, and estimates relative to it where nobody gave it.

Motion alone tells ratios. With ``f = s (c1 n|n| + c2 n^2)`` all masses, inertia and damping are proportional to
``s``, and all of the yaw equation but its Munk moment ``(m_u - m_v) u v`` also to the arm of the thrusters. So
kilograms are as good as the thrust behind them. Where that is a built-in default, estimates are reported over the
full-ahead thrust of one thruster ``T = c1 + c2`` (and those of the yaw equation over ``T y_arm``), with errors by the
delta method:

    g = theta / (T^a y^b),     cov g = J cov(theta) J',     J_ij = (delta_ij - a g_i dT/T - b g_i dy/y) / (T^a y^b)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from seatrial.ident.estimation.maximum_likelihood import Fit
from seatrial.ident.model import Model, Parameter, ParameterOrigin
from seatrial.ident.models import SIDES, force_power, is_moment, is_own_model, symmetric_arms
from seatrial.ident.numerics import Array

BUILT_IN, ESTIMATED = ParameterOrigin.BUILT_IN, ParameterOrigin.ESTIMATED
ASYMMETRY = 0.1  # prior standard deviation of c2 / c1 where nobody gave c2: astern 0.67 to 1.5 of ahead at two of them
PRIOR_WIDTHS = 3.0  # standard deviations between the data and a prior: beyond, they contradict each other
LEAST_DATA = 0.02  # part of a parameter's information that the data gave: with less they cannot contradict anything
LEAST_GYRATION = 0.15  # radius of gyration in yaw over the hull's length: hulls have 0.2 to 0.3


@dataclass(frozen=True)
class ThrustScale:
    """Provenance of the thrust (``c1``) and of the thrusters' arms; None: the model has none, or needs none.

    ``statistical``: the thrust is taken as exact, so that no error of what stands on it has its uncertainty.
    """

    thrust: ParameterOrigin | None = None
    arm: ParameterOrigin | None = None
    statistical: bool = False

    @property
    def relative(self) -> bool:
        """Whether masses, damping and forces are known as ratios to the thrust only."""
        return self.thrust is BUILT_IN

    @property
    def relative_yaw(self) -> bool:
        """Whether those of the yaw equation are known as ratios to the arm only."""
        return self.arm in (BUILT_IN, ESTIMATED)

    @property
    def caveats(self) -> tuple[str, ...]:
        """Lines to read before numbers of the model that stand in kg and N all the same, as other programs need them;
        none where they are right."""
        thrust = (
            "Nobody gave the thrust: masses, damping and forces are right as ratios to c1 + c2 only, not in",
            "kg and N; the motion that they predict is right.",
        )
        arms = ("Nobody gave the arms: inertia and damping in yaw are right as ratios to them only.",)
        return (*(thrust if self.relative else ()), *(arms if self.relative_yaw else ()))

    def powers(self, unit: str) -> tuple[int, int]:
        """Powers of the thrust and of the arm by which what has this unit is divided."""
        power = force_power(unit)
        return power * self.relative, power * (self.relative_yaw and is_moment(unit))

    def unit(self, unit: str) -> str:
        """The unit of that ratio: ``kg/N``, ``kg m2/(N m)``."""
        powers = self.powers(unit)
        if not any(powers):
            return unit
        above, _, below = unit.partition("/")
        top, bottom = [w for w in above.split() if w != "1"], below.split()
        for word, power in zip(("N", "m"), powers, strict=True):
            ours, other = (top, bottom) if power > 0 else (bottom, top)
            for _ in range(abs(power)):
                if word in ours:
                    ours.remove(word)
                else:
                    other.append(word)
        joined = bottom[0] if len(bottom) == 1 else f"({' '.join(bottom)})"
        return f"{' '.join(top) or '1'}/{joined}" if bottom else " ".join(top)

    def name(self, name: str, unit: str) -> str:
        """``m_u/T``, ``m_r/(T y_arm)``; what is no ratio keeps its name."""
        thrust, arm = self.powers(unit)
        parts = ["T"] * (thrust > 0) + ["y_arm"] * (arm > 0)
        over = f"{name}/{parts[0]}" if len(parts) == 1 else f"{name}/({' '.join(parts)})" if parts else name
        times = ["T"] * (thrust < 0) + ["y_arm"] * (arm < 0)
        return " ".join([*times, over])


def scale_of(model: Model) -> ThrustScale:
    """Of a vehicle's model: by its thrust curve, and by its arms where it has a yaw equation."""
    values, thrust, arm = model.values, None, None
    if "c1" in values and "m_u" in values:
        thrust = model.parameter("c1").provenance
    if "m_r" in values and "y_arm" in values:
        arm = model.parameter("y_arm").provenance
    elif "m_r" in values and "y_left" in values:
        arm = model.parameter("y_left").provenance
    exact = thrust is not None and thrust is not BUILT_IN and model.parameter("c1").exact
    if any(i.unit.startswith("N") for i in model.inputs):  # forces as given, but for a calibration
        exact = "k_thrust" not in values or model.parameter("k_thrust").exact
    return ThrustScale(thrust, arm, exact)


def pose_scale(model: Model) -> Model:
    """The model with what nobody gave of thrust and arms left to the data, as far as they can tell.

    The asymmetry c2 gets a wide prior; arms become one arm that the Munk moment tells; c1 is estimated where a mass is
    given in its stead, else it stays at its built-in value, and the estimates are ratios to it.
    """
    values = model.values
    if "c1" not in values or "m_u" not in values:
        return _with_arms(model)
    c1, c2 = model.parameter("c1"), model.parameter("c2")
    weighed = [p.name for p in model.parameters if p.name in ("m_u", "m_v") and p.provenance is not ESTIMATED]
    if c1.provenance is BUILT_IN and weighed:
        c1 = c1.freed()
    if c2.provenance is BUILT_IN:
        c2 = replace(c2.at(0.0), prior=(0.0, ASYMMETRY * c1.value), free=True)
    return _with_arms(model.replace_parameters(c1, c2))


def _with_arms(model: Model) -> Model:
    if not {"m_r", "y_left", "y_right"} <= set(model.values) or ".py:" in model.source:
        return model
    arms = [model.parameter(f"y_{side}") for side in SIDES]
    known = [p for p in arms if p.origin is not BUILT_IN]
    if not known:
        return symmetric_arms(model)
    if len(known) == 1:
        return model.replace_parameters(
            *(replace(known[0], name=p.name, value=-known[0].value) for p in arms if p is not known[0])
        )
    return model


@dataclass(frozen=True)
class ReportedUnits:
    """The units that numbers of a model are reported in; ``thrust`` [N] and ``arm`` [m]: what ratios are to."""

    scale: ThrustScale
    thrust: float = 1.0
    arm: float = 1.0

    def factor(self, unit: str) -> float:
        """By which a number in ``unit`` is multiplied."""
        thrust, arm = self.scale.powers(unit)
        return float(self.thrust**-thrust * self.arm**-arm) if thrust or arm else 1.0


def reported_units(model: Model) -> ReportedUnits:
    """Of a model with its values."""
    scale, p = scale_of(model), model.values
    thrust = p["c1"] + p["c2"] if scale.relative else 1.0
    if not scale.relative_yaw:
        return ReportedUnits(scale, thrust)
    return ReportedUnits(scale, thrust, p["y_arm"] if "y_arm" in p else 0.5 * abs(p["y_right"] - p["y_left"]))


@dataclass(frozen=True)
class ReportedEstimates:
    """The estimates of a fit as they can be reported: in units of the thrust where its scale is unknown."""

    fit: Fit

    @cached_property
    def units(self) -> ReportedUnits:
        return reported_units(self.fit.model)

    @property
    def scale(self) -> ThrustScale:
        return self.units.scale

    def factor(self, unit: str) -> float:
        """By which a number in ``unit`` is multiplied."""
        return self.units.factor(unit)

    def estimate(self, p: Parameter, record: int = 0) -> tuple[float, float]:
        """Value and standard error (NaN: none) of a parameter in a record."""
        value, error = self.fit.estimate(p.name, record)
        powers = self.scale.powers(p.unit)
        if not any(powers):
            return value, error
        for i, q in enumerate(self.fit.parameters):
            if q.name == p.name and q.segment in (None, record):
                return value * self.factor(p.unit), float(np.sqrt(self._covariance[i, i]))
        gradient = -value * self._log_gradient(*powers)
        variance = float(gradient @ self._known_covariance @ gradient)
        return value * self.factor(p.unit), self.factor(p.unit) * np.sqrt(variance) if variance > 0.0 else np.nan

    @cached_property
    def correlation(self) -> Array:
        """Of the estimates as reported (n, n)."""
        if not (self.scale.relative or self.scale.relative_yaw):
            return self.fit.correlation
        root = np.sqrt(np.diag(self._covariance))
        return np.asarray(self._covariance / np.outer(root, root))

    def _log_gradient(self, thrust: int, arm: int) -> Array:
        """Of ``T^a y^b`` by the estimates, over itself (n,)."""
        of_thrust, of_arm = thrust / self.units.thrust, arm / self.units.arm
        by = {"c1": of_thrust, "c2": of_thrust, "y_arm": of_arm}
        return np.array([by.get(p.name, 0.0) for p in self.fit.parameters])

    @cached_property
    def _known_covariance(self) -> Array:
        return np.nan_to_num(self.fit.covariance, nan=0.0)

    @cached_property
    def _covariance(self) -> Array:
        parameters = self.fit.parameters
        powers = [self.scale.powers(p.unit) for p in parameters]
        J = np.array(
            [
                (np.eye(len(parameters))[i] - self.fit.values[i] * self._log_gradient(*w)) * self.factor(p.unit)
                for i, (p, w) in enumerate(zip(parameters, powers, strict=True))
            ]
        )
        found = J @ self._known_covariance @ J.T
        lost = np.isnan(np.diag(self.fit.covariance))
        found[lost, :] = found[:, lost] = np.nan
        return np.asarray(found)


def against_priors(fit: Fit) -> list[tuple[Parameter, float, float]]:
    """Parameters whose data contradict the prior that was given for this boat, the estimate and the distance in
    standard deviations.

    An estimate is the mean of what the data say and of the prior, weighted by their informations; with the prior's part
    w of them, the two differ by ``(estimate - mean) / (sd sqrt(1 - w))`` of their common standard deviation.
    """
    found = []
    by_somebody = {ParameterOrigin.MEASURED, ParameterOrigin.PRIOR}
    if is_own_model(fit.model.source):
        by_somebody.add(ParameterOrigin.GIVEN)
    supposed = {p.name for e in fit.model.effects for p in e.parameters}  # how large an effect usually is
    for p, value, weight in zip(fit.parameters, fit.values.tolist(), fit.prior_weight.tolist(), strict=True):
        prior = p.free_prior()
        said = p.origin in by_somebody and not (p.name in supposed and p.origin is ParameterOrigin.GIVEN)
        if prior is None or not said or (p.transform == "log" and value <= 0.0):
            continue
        widths = (p.to_free(value) - prior[0]) / (prior[1] * np.sqrt(max(1.0 - weight, LEAST_DATA)))
        if abs(widths) > PRIOR_WIDTHS:
            found.append((p, value, float(widths)))
    return found


def least_inertia(fit: Fit, length: float | None = None) -> float | None:
    """The least moment of inertia in yaw [kg m2] that a rigid body with this mass can have: of a bar that reaches from
    thruster to thruster, or of a hull whose radius of gyration is ``LEAST_GYRATION`` of its length [m]. None where the
    arms or masses are not known."""
    scale, values = scale_of(fit.model), fit.model.values
    if not {"m_u", "m_r"} <= set(values) or scale.relative or scale.relative_yaw or scale.arm is None:
        return None
    across = 0.5 * abs(fit.estimate("y_right")[0] - fit.estimate("y_left")[0]) / np.sqrt(3.0)
    radius = max(across, LEAST_GYRATION * (length or 0.0))
    return float(fit.estimate("m_u")[0] * radius**2)
