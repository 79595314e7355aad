"""Scale of forces: its provenance, and estimates relative to the thrust if the thrust was not given.

The provenance of a value is its origin: measured, given by the user, built into the model, or estimated.

The motion of a boat determines only ratios. With ``f = s (c1 n|n| + c2 n^2)`` all masses, inertia and damping are
proportional to ``s``. In the yaw equation all terms except the Munk moment ``(m_u - m_v) u v`` are also proportional to
the arm of the thrusters. Kilograms are therefore as accurate as the thrust. If the thrust is a built-in default,
estimates are reported over the thrust of one thruster at full forward command, ``T = c1 + c2`` (in the yaw equation
over ``T y_arm``). Their standard errors follow from the delta method:

    g = theta / (T^a y^b),     cov g = J cov(theta) J',     J_ij = (delta_ij - a g_i dT/T - b g_i dy/y) / (T^a y^b)
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from seatrial.ident.estimation.maximum_likelihood import Fit
from seatrial.ident.model import Model, Parameter, ParameterOrigin
from seatrial.ident.models import SIDES, force_power, is_moment, is_own_model, symmetric_arms
from seatrial.ident.numerics import Array

BUILT_IN, ESTIMATED = ParameterOrigin.BUILT_IN, ParameterOrigin.ESTIMATED
# Prior standard deviation of c2 / c1 if c2 was not given. At two standard deviations the reverse thrust is 0.67 or 1.5
# times the forward thrust.
ASYMMETRY = 0.1
AHEAD = "ahead"  # number of the boat: thrust of one thruster at full speed ahead [N], if that astern is not known
PRIOR_WIDTHS = 3.0  # data and prior contradict each other if they differ by more standard deviations
LEAST_SHOWN_DATA = 0.2  # the data's share of a parameter's information, from which the value of the data alone is shown
LEAST_DATA = 0.01  # lower limit of the data's share of a parameter's information, in the test against the prior
LEAST_GYRATION = 0.15  # least radius of gyration in yaw over the hull's length; real hulls have 0.2 to 0.3
# Largest plausible mass in surge over the weighed mass: the added mass of a hull at the surface is 5 to 30 % of the
# mass (Fossen 2011, section 6.3), more for a blunt one
PLAUSIBLE_MASS_RATIO = 1.5


@dataclass(frozen=True)
class ThrustScale:
    """Scale of a model's forces and moments: the provenance of the thrust and of the thrusters' arms that define it.

    The motion of a boat determines masses and damping only as ratios to the thrust. Without a known thrust, numbers are
    reported as ratios to it.

    Attributes
    ----------
    thrust
        Provenance of the thrust (``c1``); None if the model has no thrust curve or no mass.
    arm
        Provenance of the thrusters' arms (lateral positions); None if the model has no arms or no yaw inertia.
    statistical
        Whether the thrust is taken as exact. Standard errors then do not include its uncertainty.
    """

    thrust: ParameterOrigin | None = None
    arm: ParameterOrigin | None = None
    statistical: bool = False

    @property
    def relative(self) -> bool:
        """Whether masses, damping and forces are known only as ratios to the thrust, because the thrust is built in.

        False without a thrust curve.
        """
        return self.thrust is BUILT_IN

    @property
    def relative_yaw(self) -> bool:
        """Whether inertia and damping in yaw are known only as ratios to the arm: the arm is built in or estimated.

        False for a model without arms.
        """
        return self.arm in (BUILT_IN, ESTIMATED)

    @property
    def caveats(self) -> tuple[str, ...]:
        """Lines of a warning about numbers in kg and N whose scale is unknown; empty if the scale is known.

        The lines are written to files in these units, which other programs need.
        """
        thrust = (
            "The thrust was not given: masses, damping and forces are right as ratios to c1 + c2 only, not in",
            "kg and N; the motion that they predict is right.",
        )
        arms = ("The arms were not given: inertia and damping in yaw are right as ratios to the arms only.",)
        return (*(thrust if self.relative else ()), *(arms if self.relative_yaw else ()))

    def powers(self, unit: str) -> tuple[int, int]:
        """Return the powers of thrust and arm by which a number with this unit is divided when it is reported.

        The power of the thrust is that of mass in the unit: 1 for ``kg``, -1 for ``1/N``, 0 for ``m/s``. The power of
        the arm is the same for coefficients of moments, such as ``kg m2``, and 0 for those of forces. A power is 0 if
        the thrust (or the arm) is known.
        """
        power = force_power(unit)
        return power * self.relative, power * (self.relative_yaw and is_moment(unit))

    def unit(self, unit: str) -> str:
        """Return the unit in which a number with this unit is reported.

        For example, it is ``kg/N`` for ``kg`` and ``kg m2/(N m)`` for ``kg m2``. A number that is not reported as a
        ratio keeps its unit.
        """
        powers = self.powers(unit)
        if not any(powers):
            return unit
        above, _, below = unit.partition("/")
        top, bottom = [w for w in above.split() if w != "1"], below.split()
        for word, power in zip(("N", "m"), powers, strict=True):
            divided, divisor = (top, bottom) if power > 0 else (bottom, top)
            for _ in range(abs(power)):
                if word in divided:
                    divided.remove(word)
                else:
                    divisor.append(word)
        joined = bottom[0] if len(bottom) == 1 else f"({' '.join(bottom)})"
        return f"{' '.join(top) or '1'}/{joined}" if bottom else " ".join(top)

    def name(self, name: str, unit: str) -> str:
        """Return the name under which a parameter is reported; for a ratio, for example ``m_u/T`` or ``m_r/(T y_arm)``.

        T is the thrust of one thruster at full forward command. ``name`` and ``unit`` are those of the parameter in the
        model. A number that is multiplied instead, for example one in 1/N, gets ``T`` before its name. A number that is
        not reported as a ratio keeps its name.
        """
        thrust, arm = self.powers(unit)
        parts = ["T"] * (thrust > 0) + ["y_arm"] * (arm > 0)
        over = f"{name}/{parts[0]}" if len(parts) == 1 else f"{name}/({' '.join(parts)})" if parts else name
        times = ["T"] * (thrust < 0) + ["y_arm"] * (arm < 0)
        return " ".join([*times, over])


def thrust_scale_of(model: Model) -> ThrustScale:
    """Return the provenance of the force scale of a vehicle's model.

    The provenance of the thrust is that of c1, and that of the arms is that of ``y_arm``, or else of ``y_left``. The
    arms count only if the model has a yaw inertia. The thrust is taken as exact if c1 is not built in and has no
    uncertainty. If the inputs are forces, it is exact unless their calibration factor ``k_thrust`` is uncertain.
    """
    values, thrust, arm = model.values, None, None
    if "c1" in values and "m_u" in values:
        thrust = model.parameter("c1").provenance
    if "m_r" in values and "y_arm" in values:
        arm = model.parameter("y_arm").provenance
    elif "m_r" in values and "y_left" in values:
        arm = model.parameter("y_left").provenance
    exact = thrust is not None and thrust is not BUILT_IN and model.parameter("c1").exact
    if any(i.unit.startswith("N") for i in model.inputs):  # the inputs are forces; at most their calibration is unknown
        exact = "k_thrust" not in values or model.parameter("k_thrust").exact
    return ThrustScale(thrust, arm, exact)


def free_unknown_scale(model: Model) -> Model:
    """Return the model with the scale of forces free as far as the data can determine it.

    - If the asymmetric thrust coefficient c2 was not given, it is estimated. It starts at zero, with a prior around
      zero of a standard deviation of 0.1 c1.
    - If no arm (lateral position of a thruster) was given, the two arms become one symmetric arm, which the Munk moment
      determines. If one was given, the other is its negative.
    - If the thrust coefficient c1 was not given but a mass was, c1 is estimated. If neither was given, c1 keeps its
      built-in value, and the estimates are ratios to it.

    In a model without c1 or m_u only the arms are changed.
    """
    values = model.values
    if "c1" not in values or "m_u" not in values:
        return _with_both_arms(model)
    c1, c2 = model.parameter("c1"), model.parameter("c2")
    given_masses = [p.name for p in model.parameters if p.name in ("m_u", "m_v") and p.provenance is not ESTIMATED]
    if c1.provenance is BUILT_IN and given_masses:
        c1 = c1.freed()
    if c2.provenance is BUILT_IN:
        c2 = replace(c2.at(0.0), prior=(0.0, ASYMMETRY * c1.value), free=True)
    return _with_both_arms(model.replace_parameters(c1, c2))


def scaled_to_ahead(model: Model, fit: Fit, ahead: float, sd: float = 0.0) -> Model:
    """Return the model with another scale of forces: that of the given thrust ahead.

    The motion determines the ratio of the thrusts ahead (c1 + c2) and astern (c1 - c2), and a fit with any c1 finds it.

    Parameters
    ----------
    model
        Model before the fit, with an estimated c2.
    fit
        Fit of this model.
    ahead, sd
        Given thrust of one thruster at full speed ahead, and its standard uncertainty [N]. 0: the thrust is exact.

    Returns
    -------
    Model
        Model in which c1 is known, so that c1 + c2 is the given thrust with the c2 of the fit. Free parameters begin at
        their estimates. Those in units of force or mass are multiplied by the same factor as c1. The built-in prior of
        c2 follows c1; with an uncertain c1 its mean is the c2 of the fit.
    """
    (c1, _), (c2, _) = fit.estimate("c1"), fit.estimate("c2")
    factor = ahead / (c1 + c2)
    estimated = [p for p in model.parameters if p.free and not p.per_record and p.name not in ("c1", "c2")]
    new = []
    for p in estimated:
        value, (low, high) = fit.estimate(p.name)[0] * factor ** force_power(p.unit), p.bounds
        new.append(p.at(min(max(value, low), high)))
    origin = ParameterOrigin.PRIOR if sd else ParameterOrigin.GIVEN
    mean = model.parameter("c1").known(factor * c1, factor * c1 / ahead * sd, origin)
    half = model.parameter("c2").at(factor * c2)
    if half.origin is BUILT_IN:
        # With an uncertain c1, a prior around zero would pull both down: the motion fixes their ratio.
        half = replace(half, prior=(half.value if sd else 0.0, ASYMMETRY * mean.value))
    return model.replace_parameters(mean, half, *new)


def _with_both_arms(model: Model) -> Model:
    """Return the model with arms (lateral positions) for both thrusters.

    If no arm was given, both arms become one parameter, plus and minus ``y_arm``. If one arm was given, the other is
    its negative. A model whose arms are both given, a user-defined model, or one without a yaw inertia or arms, is
    returned unchanged.
    """
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
    """Units in which the numbers of a model are reported: their own, or ratios to the thrust and to the arm.

    Attributes
    ----------
    scale
        Provenance of the force scale, which decides what is reported as a ratio.
    thrust, arm
        Thrust [N] of one thruster at full forward command, and arm [m] (lateral position of a thruster), by which
        numbers are divided; 1 if no number is divided by it.
    """

    scale: ThrustScale
    thrust: float = 1.0
    arm: float = 1.0

    def factor(self, unit: str) -> float:
        """Return the factor by which a number in ``unit`` is multiplied when it is reported.

        It is 1 if the number is not reported as a ratio.
        """
        thrust, arm = self.scale.powers(unit)
        return float(self.thrust**-thrust * self.arm**-arm) if thrust or arm else 1.0


def reported_units(model: Model) -> ReportedUnits:
    """Return the units in which the values of a model are reported.

    The thrust is c1 + c2 of the model. The arm is ``y_arm``, or half the distance between the thrusters.
    """
    scale, p = thrust_scale_of(model), model.values
    thrust = p["c1"] + p["c2"] if scale.relative else 1.0
    if not scale.relative_yaw:
        return ReportedUnits(scale, thrust)
    return ReportedUnits(scale, thrust, p["y_arm"] if "y_arm" in p else 0.5 * abs(p["y_right"] - p["y_left"]))


def model_values(model: Model, reported: Mapping[str, float]) -> dict[str, float]:
    """Return values in the units of the model from reported values: the inverse of `ReportedEstimates`.

    Parameters
    ----------
    model : Model
        Model whose force scale decides which values are reported as ratios. Its thrust coefficient c1 is the scale.
    reported : mapping
        Reported values by reported name, such as ``m_u/T``. Names that the model does not have are ignored.

    Returns
    -------
    dict
        Values by the names of the model's parameters. Parameters that ``reported`` lacks are left out, and so is a c1
        that is only a scale. A value beyond a bound, such as a mean of several fits, is moved onto the bound, and one
        of a positive parameter stays positive.
    """
    scale = thrust_scale_of(model)
    known = {p.name: (p, n) for p in model.parameters if (n := scale.name(p.name, p.unit)) in reported}
    found = {n: _inside(p, reported[name]) for n, (p, name) in known.items() if not any(scale.powers(p.unit))}
    if scale.relative and "c2" in known:  # reported as c2 / (c1 + c2)
        share = reported[known["c2"][1]]
        found["c2"] = _inside(known["c2"][0], model.values["c1"] * share / (1.0 - share))
    units = reported_units(model.with_values(found))
    fixed = {"c1", "c2"} if scale.relative else set()
    left = {n: (p, name) for n, (p, name) in known.items() if n not in {*found, *fixed}}
    return found | {n: _inside(p, reported[name] / units.factor(p.unit)) for n, (p, name) in left.items()}


def _inside(p: Parameter, value: float) -> float:
    """Return a value of a parameter, moved onto its bound if it is beyond it. A positive parameter stays positive."""
    low, high = p.bounds
    least = max(low, 1e-6 * abs(p.value)) if p.transform == "log" else low
    return min(max(value, least), high)


@dataclass(frozen=True)
class ReportedEstimates:
    """Estimates of a fit as they are reported: as ratios to thrust and arm if the scale of forces is unknown.

    Attributes
    ----------
    fit : Fit
        Fit with the estimates in kg, N and m.
    """

    fit: Fit

    @cached_property
    def units(self) -> ReportedUnits:
        """Units of the reported numbers, with the thrust and the arm by which they are divided."""
        return reported_units(self.fit.model)

    @property
    def scale(self) -> ThrustScale:
        """Provenance of the thrust and of the arms of the thrusters: measured, given, built-in or estimated."""
        return self.units.scale

    def factor(self, unit: str) -> float:
        """Return the factor by which a number in ``unit`` is multiplied when it is reported.

        It is 1 if the number is not reported as a ratio.
        """
        return self.units.factor(unit)

    def estimate(self, p: Parameter, record: int = 0) -> tuple[float, float]:
        """Return the reported value and standard error of a parameter in the record with the index ``record``.

        The error of a ratio includes the error of the estimated thrust and arm. It is NaN if there is none. A fixed
        parameter that is reported as a ratio has the error of thrust and arm alone. KeyError is raised if the model
        lacks the parameter.
        """
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
        """Correlation of the reported estimates (n, n), in the order of ``fit.parameters``.

        It is NaN for parameters without a standard error.
        """
        if not (self.scale.relative or self.scale.relative_yaw):
            return self.fit.correlation
        root = np.sqrt(np.diag(self._covariance))
        return np.asarray(self._covariance / np.outer(root, root))

    def _log_gradient(self, thrust: int, arm: int) -> Array:
        """Return the derivatives (n,) of ``a ln T + b ln y`` by the n estimates of the fit.

        T is the thrust at full forward command with the power a (``thrust``), and y the arm with the power b (``arm``).
        They serve the delta method for the standard errors of ratios.
        """
        by_thrust, by_arm = thrust / self.units.thrust, arm / self.units.arm
        derivatives = {"c1": by_thrust, "c2": by_thrust, "y_arm": by_arm}
        return np.array([derivatives.get(p.name, 0.0) for p in self.fit.parameters])

    @cached_property
    def _known_covariance(self) -> Array:
        """Covariance of the estimates of the fit (n, n) in their own units.

        It is zero for parameters without a standard error.
        """
        return np.nan_to_num(self.fit.covariance, nan=0.0)

    @cached_property
    def _covariance(self) -> Array:
        """Covariance (n, n) of the estimates as they are reported, by the delta method.

        It is NaN for parameters without a standard error.
        """
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


def value_of_data(p: Parameter, estimate: float, weight: float) -> float | None:
    """Return the value of a parameter that the data alone give, in the unit of the parameter.

    The estimate is the mean of this value and of that of the prior, weighted by their informations, in the coordinate
    of the search. ``weight`` is the share of the prior in the information. None without a prior, and if the data have
    less than a fifth of the information: the value would be extrapolated from the estimate by more than four times its
    distance from the prior, where the likelihood is not quadratic.
    """
    prior = p.free_prior()
    if prior is None or 1.0 - weight < LEAST_SHOWN_DATA:
        return None
    moved = p.to_free(estimate) - prior[0]
    return p.from_free(prior[0] + moved / (1.0 - weight))


@dataclass(frozen=True)
class PriorDistance:
    """Distance between the data and the prior that was given for a parameter of this boat.

    Attributes
    ----------
    parameter
        The parameter, with its prior.
    estimate
        Estimate in the unit of the parameter.
    distance
        Distance in common standard deviations; positive if the data are above the mean of the prior.
    plain_distance
        The same if the form of the model is taken to be right.
    weight
        Share of the prior in the information on the parameter.
    """

    parameter: Parameter
    estimate: float
    distance: float
    plain_distance: float
    weight: float

    @property
    def contradicts(self) -> bool:
        """Whether data and prior contradict each other: they differ by more than 3 common standard deviations."""
        return abs(self.distance) > PRIOR_WIDTHS

    @property
    def contradicts_if_model_is_right(self) -> bool:
        """Whether data and prior would contradict each other if no effect were missing from the model."""
        return abs(self.plain_distance) > PRIOR_WIDTHS

    @property
    def data_value(self) -> float | None:
        """Value that the data alone give, in the unit of the parameter; None if they have too little information."""
        return value_of_data(self.parameter, self.estimate, self.weight)


def prior_distances(fit: Fit) -> list[PriorDistance]:
    """Return the distance between the data and each prior that was given for this boat.

    Priors from a bench test or from the user count, also those of a parameter of an effect. So do the priors that a
    user-defined model declares. Built-in priors, and the usual priors of effects, do not count: they do not describe
    this boat.

    Parameters
    ----------
    fit
        Fit of a model, with the weights of its priors.

    Returns
    -------
    list of PriorDistance
        One for each such prior, in the order of the fit's parameters.

    Notes
    -----
    An estimate is the mean of what the data determine and of the prior, weighted by their informations. With the
    prior's share w of the information, the two differ by ``(estimate - mean) / (1 - w)``. The variance of this
    difference is ``sd^2 (1 + k w / (1 - w)) + C / (1 - w)^2``. The factor k is that by which the robust variances
    exceed the plain ones, here its mean over all estimates. C is the variance of the estimate by considered parameters
    and by candidates that may be missing from the model. Without k and C, a small error of the model would look like a
    wrong prior if the data have a small share of the information.

    The prior of c1 is left out if nothing else that was given for the boat has a unit of force or mass. The motion
    determines ratios to the thrust only, so that the rest of the information on c1 is that of built-in priors, such as
    that of c2 around zero: a thrust astern that is much smaller than that ahead would contradict a correct c1.
    """
    found = []
    only_scale = _is_only_scale(fit)
    excess = fit.inflation[np.isfinite(fit.inflation)]
    inflation = float(np.mean(excess**2)) if excess.size else 1.0
    given_origins = {ParameterOrigin.MEASURED, ParameterOrigin.PRIOR}
    if is_own_model(fit.model.source):
        given_origins.add(ParameterOrigin.GIVEN)
    # The priors of effects in the catalogue describe how large an effect usually is, not this boat.
    of_effects = {p.name for e in fit.model.effects for p in e.parameters}
    by_model = np.nan_to_num(np.diag(fit.considered)).tolist()
    estimates = zip(fit.parameters, fit.values.tolist(), fit.prior_weight.tolist(), by_model, strict=True)
    for p, value, weight, model_variance in estimates:
        prior = p.free_prior()
        for_this_boat = p.origin in given_origins and not (p.name in of_effects and p.origin is ParameterOrigin.GIVEN)
        if prior is None or not for_this_boat or (p.transform == "log" and value <= 0.0):
            continue
        if p.name == "c1" and only_scale:
            continue
        by_data, moved = max(1.0 - weight, LEAST_DATA), (p.to_free(value) - prior[0]) / prior[1]
        of_model = model_variance / (p.slope(value) * prior[1] * by_data) ** 2
        plain = moved / by_data / np.sqrt(1.0 + weight / by_data)
        widened = moved / by_data / np.sqrt(1.0 + inflation * weight / by_data + of_model)
        found.append(PriorDistance(p, value, float(widened), float(plain), weight))
    return found


def _is_only_scale(fit: Fit) -> bool:
    """Return whether c1 alone sets the scale of the forces: no other given number has a unit of force or mass.

    Numbers are given by the user or by a bench test, as a prior or as a fixed value other than zero. The priors of
    effects and of the noise of the model do not count, and c1 of a user-defined model may have another meaning.
    """
    model = fit.model
    if is_own_model(model.source):
        return False
    known = (ParameterOrigin.MEASURED, ParameterOrigin.PRIOR)
    of_effects = {p.name for e in model.effects for p in e.parameters} | set(model.noise_parameters)
    priors = [p for p in fit.parameters if p.prior is not None and p.origin in known]
    fixed = [p for p in model.parameters if not p.free and p.value and p.origin in (ParameterOrigin.GIVEN, *known)]
    others = [*priors, *(p for p in fixed if p.name not in of_effects)]
    return not any(p.name != "c1" and force_power(p.unit) for p in others)


def least_yaw_inertia(fit: Fit, length: float | None = None) -> float | None:
    """Return the least moment of inertia in yaw [kg m2] that a rigid body with the estimated mass can have.

    It is the larger of two values: that of a bar that reaches from thruster to thruster, and that of a hull whose
    radius of gyration is 0.15 times its ``length`` [m]. Without a length, it is that of the bar. An estimated inertia
    below it is implausible.

    Returns
    -------
    float or None
        None if the model lacks mass, inertia or arms, or if thrust or arms were not given, so that masses or inertia
        are known as ratios only.
    """
    scale, values = thrust_scale_of(fit.model), fit.model.values
    if not {"m_u", "m_r"} <= set(values) or scale.relative or scale.relative_yaw or scale.arm is None:
        return None
    if "y_arm" in values:
        arm = fit.estimate("y_arm")[0]
    else:
        arm = 0.5 * abs(fit.estimate("y_right")[0] - fit.estimate("y_left")[0])
    across = arm / np.sqrt(3.0)
    radius = max(across, LEAST_GYRATION * (length or 0.0))
    return float(fit.estimate("m_u")[0] * radius**2)
