"""Nonparametric effects: a residual force or a sensor error as a curve over one variable.

The curve is a linear spline with rounded corners, or a sum of harmonics of an angle. The module also contains two
responses of a force to an input that are not in the catalogue: a first-order lagged and a second-order resonant
response.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from seatrial.ident.model import (
    DisturbanceChannel,
    Effect,
    EffectKind,
    ForceCurve,
    Input,
    Model,
    Parameter,
    Signals,
    State,
    ThrusterPair,
    Variable,
    built_in,
    curve_name,
)
from seatrial.ident.models import TIME, residuals_of, sensor_errors_of, thrust_losses_of, unit_over, variables_of
from seatrial.ident.numerics import Array

N_KNOTS, N_HARMONICS = 9, 3
ZERO_KNOT = 1e-9  # of the span: a knot that is nearer to zero is zero
ROUNDING = 0.25  # half width of a rounded corner, relative to the spacing of the knots
TIME_CONSTANTS = (0.25, 1.0, 4.0)  # s, time constants of the first-order lags
FREQUENCIES_HZ = (0.2, 0.32, 0.5, 0.8, 1.2)  # natural frequencies to try for a resonant response
DAMPING = 0.1  # damping ratio of a resonant response
SENSOR_STAGES = ("output", "reading")  # stages of sensor errors, which do not scale with the size of the boat
FULL_THRUST_N = 40.0  # full thrust of a thruster on the boat of the catalogue: the scale of an input in newtons
Signal = Callable[[Signals], Any]


@dataclass(frozen=True)
class NonparametricForce:
    """Fitted nonparametric curve of a residual quantity: a residual force, change of thrust or sensor error.

    Attributes
    ----------
    force, variable : str
        Names of the residual quantity and of the variable on which it depends, for example ``X`` and ``u``.
    grid : Array (n,)
        Values of the variable [variable_unit].
    value : Array (n,)
        Residual quantity [unit], less its mean. For a relative change of the thrust: less its value at zero.
    sd : Array (n,)
        Pointwise standard deviation [unit].
    band : Array (n,)
        Half width of the simultaneous 95 % band [unit].
    unit, variable_unit : str
        Units of the quantity and of the variable.
    reading : bool
        Whether the quantity is a sensor error instead of a force.
    """

    force: str
    variable: str
    grid: Array
    value: Array
    sd: Array
    band: Array
    unit: str
    variable_unit: str
    reading: bool = False  # whether the quantity is a sensor error instead of a force


def harmonics(z: Any) -> list[Any]:
    """Return the sines and cosines of an angle z [rad] and its multiples: sin z, cos z, sin 2z, cos 2z, sin 3z, cos 3z.

    z is a number, an array or a symbol.
    """
    return [f(k * z) for k in range(1, N_HARMONICS + 1) for f in (np.sin, np.cos)]


def spline_basis(z: Any, angle: bool, span: tuple[float, float]) -> list[Any]:
    """Return the basis functions of a curve at z: linear B-splines with rounded corners, or harmonics of an angle.

    Parameters
    ----------
    z : float, Array or symbol
        Value of the variable.
    angle : bool
        Whether the variable is an angle [rad].
    span : tuple[float, float]
        First and last knot, in the unit of the variable. The knots are equally spaced. From a quarter of the spacing
        beyond them the curve is constant. It is ignored for an angle.

    Returns
    -------
    list
        Values of the nine (`N_KNOTS`) splines, or of the six harmonics, each like z.

    Notes
    -----
    The slope of a linear spline jumps at its knots, and the filter linearises by the slope. The likelihood would
    therefore jump when a sample passes a knot (by 2.4 on a boat with a steep curve), and a search would stop at the
    jump, below the maximum. Each spline is therefore replaced by its moving average over a quarter of the spacing
    (`ROUNDING`) in both directions. Straight lines, and the sum of one of all splines, are not changed by the average.
    """
    if angle:
        return harmonics(z)
    low, high = span
    at = (z - low) / (high - low) * (N_KNOTS - 1)
    distances = [_rounded_abs(at - k) for k in range(N_KNOTS)]
    rise = [(1 + a - b) / 2 for a, b in pairwise(distances)]  # from 0 to 1 between two knots
    return [1 - rise[0], *(a - b for a, b in pairwise(rise)), rise[-1]]


def _rounded_abs(z: Any) -> Any:
    """Return |z| with a rounded corner at zero: its moving average over 0.25 (ROUNDING) in both directions.

    For |z| >= 0.25, this is |z|. z is a distance from a knot, in units of the spacing of the knots.
    """
    return abs(z) + (ROUNDING - abs(z)) ** 2 / (2 * ROUNDING) * (abs(z) < ROUNDING)


def _curve_basis(residual: DisturbanceChannel, z: Any, angle: bool, span: tuple[float, float]) -> list[Any]:
    """Return the basis functions of a curve at the value z of its variable, in a list.

    Parameters
    ----------
    residual : DisturbanceChannel
        Quantity that the curve describes. If it is relative (a factor on the thrust), the values of the basis functions
        at z = 0 are subtracted: a constant factor belongs to the scale of the thrust.
    z : float, Array or symbol
        Value of the variable.
    angle : bool
        Whether the variable is an angle [rad]. The basis functions are then harmonics, otherwise splines.
    span : tuple[float, float]
        First and last knot of the splines, in the unit of the variable. It is ignored for an angle.
    """
    basis = spline_basis(z, angle, span)
    if not residual.relative:
        return basis
    return [b - b0 for b, b0 in zip(basis, spline_basis(0.0, angle, span), strict=True)]


def residual_and_variables(model: Model, curve: ForceCurve) -> tuple[DisturbanceChannel, list[Variable]]:
    """Return the residual quantity that a nonparametric curve describes, and the variables on which it depends.

    Parameters
    ----------
    model : Model
        Model with the residual quantity and the variables.
    curve : ForceCurve
        Names of the quantity and of one variable, or of the two variables of a product.

    Returns
    -------
    tuple[DisturbanceChannel, list[Variable]]
        The quantity (force, thrust or sensor output), and a list of one or two variables.

    Raises
    ------
    ValueError
        If the model lacks the residual quantity or a variable. The message lists those it has.
    """
    residuals = {r.name: r for r in (*residuals_of(model), *sensor_errors_of(model), *thrust_losses_of(model))}
    variables = {v.name: v for v in (*variables_of(model), TIME)}
    of = [curve.variable, curve.second] if curve.second else [curve.variable]
    required = [(curve.force, list(residuals)), *((v, list(variables)) for v in of)]
    for name, available in required:
        if name not in available:
            names = ", ".join(available)
            raise ValueError(f"model {model.name} has no {name!r} for a nonparametric curve; it has {names}")
    return residuals[curve.force], [variables[name] for name in of]


def _term_meanings(of: Sequence[Variable], span: tuple[float, float]) -> list[str]:
    """Return the meaning of each coefficient of a curve for reports, for example "at u = 0.6 m/s" or "with sin 2psi".

    A coefficient of a spline is the value of the curve at a knot, whose place is given; angular rates are in degrees,
    as in the figure of the curve. ``of`` contains one variable, or the two variables of a product ("with u |r|").
    ``span`` has the first and the last knot, in the unit of the variable.
    """
    a = of[0].name
    if len(of) == 2:
        b = of[1].name
        return [f"with {a} {b}", f"with |{a}| {b}", f"with {a} |{b}|"]
    if of[0].angle:
        return [f"with {f} {k if k > 1 else ''}{a}" for k in range(1, N_HARMONICS + 1) for f in ("sin", "cos")]
    angular = of[0].unit.startswith("rad")
    unit = of[0].unit.replace("rad", "deg", 1) if angular else of[0].unit
    knots = np.linspace(*span, N_KNOTS)
    knots[np.abs(knots) < ZERO_KNOT * np.ptp(knots)] = 0.0
    return [f"at {a} = {z:.3g} {unit}".rstrip() for z in (np.degrees(knots) if angular else knots)]


def _experiment_of(of: Sequence[Variable]) -> str:
    """Return the experiment that shows the curve over a variable, or over the product of two variables."""
    names = " and ".join(v.name for v in of)
    if names == TIME.name:
        return "a run that repeats the same sequence of commands from its start to its end"
    whose = "its whole range" if len(of) == 1 else "their whole ranges, each at several values of the other"
    return f"runs that vary {names} slowly over {whose}, with all other variables constant"


def nonparametric_effect(model: Model, curve: ForceCurve, span: tuple[float, float]) -> Effect:
    """Return the nonparametric effect ``force += sum_k t_k basis_k(variable)``. The t_k are its parameters.

    Each t_k has a prior with the mean 0 and the typical size of the residual quantity as standard deviation.

    Parameters
    ----------
    model : Model
        Model with the residual quantity and the variables.
    curve : ForceCurve
        Names of the residual quantity and of its variable. With two variables a and b, the terms are a b, |a| b and a
        |b|. For a relative residual, the sum is a relative change of the thrust.
    span : tuple[float, float]
        First and last knot of the splines, in the unit of the variable. It is not used for angles and products.

    Raises
    ------
    ValueError
        If the model lacks the residual quantity or a variable.
    """
    residual, of = residual_and_variables(model, curve)
    force, variable = curve.force, curve.variables
    terms_of = _term_meanings(of, span)
    unit = unit_over(residual.unit, *(v.unit for v in of)) if len(of) == 2 else residual.unit
    names = [f"{force}_{curve.variable}{curve.second}_{k}" for k in range(len(terms_of))]

    def add(s: Signals) -> None:
        """Add the value of the curve to the residual quantity, or multiply a relative one by one plus the value.

        The value is the sum of each parameter t_k times its basis function, or its product of the two variables.
        """
        if len(of) == 2:
            a, b = (v.read(s) for v in of)
            terms = [a * b, abs(a) * b, a * abs(b)]
        else:
            terms = _curve_basis(residual, of[0].read(s), of[0].angle, span)
        residual.add(s, sum(getattr(s.p, name) * term for name, term in zip(names, terms, strict=True)))

    return Effect(
        f"unknown {curve_name(EffectKind.NONPARAMETRIC, curve)}",
        f"a nonparametric effect: {residual.title} depends on {variable}",
        {residual.stage: add},
        parameters=built_in(
            Parameter(
                n,
                0.0,
                unit,
                f"{force} {term}",
                prior=(0.0, residual.scale),
                step=0.03 * residual.scale,
                scales=residual.stage not in SENSOR_STAGES,
            )
            for n, term in zip(names, terms_of, strict=True)
        ),
        inputs=(Input("t", "s", "linear"),) if curve.variable == "t" else (),
        place=residual.place,
        formula=f"{force} {'*= 1 +' if residual.relative else '+='} g({variable}), a nonparametric curve",
        source="the residuals of the fit",
        experiment=_experiment_of(of),
        requires=residual.requires,
        kind=EffectKind.NONPARAMETRIC,
        curve=curve,
        span=span,
    )


def shape(
    model: Model,
    effect: Effect,
    values: Mapping[str, float],
    names: Sequence[str],
    covariance: Array,
    n: int = 60,
) -> NonparametricForce | None:
    """Return the fitted nonparametric curve of an effect with its simultaneous 95 % band.

    Parameters
    ----------
    model : Model
        Model with the residual quantity and the variable.
    effect : Effect
        Nonparametric effect.
    values : Mapping[str, float]
        Fitted parameters by name.
    names : Sequence[str]
        Names of the parameters of `covariance`, in order. They must include those of the effect.
    covariance : Array (n_parameters, n_parameters)
        Covariance of the estimates.
    n : int
        Number of points of the curve, equally spaced from the first to the last knot, or over -pi to pi for an angle.

    Returns
    -------
    NonparametricForce or None
        The curve less its mean, because a constant belongs to other parameters. For a relative residual, the curve less
        its value at zero. The band of a spline includes a bound of the interpolation error between the knots. None for
        products of two variables, for lagged and resonant responses, and for effects without a curve.

    Raises
    ------
    ValueError
        If `names` lacks a parameter of the effect, or the model lacks the residual quantity or the variable.
    """
    span, curve = effect.span, effect.curve
    if span is None or curve is None or curve.second:
        return None
    residual, of = residual_and_variables(model, curve)
    grid = np.linspace(-np.pi, np.pi, n) if of[0].angle else np.linspace(*span, n)
    B = np.column_stack([b * np.ones(n) for b in _curve_basis(residual, grid, of[0].angle, span)])
    B = B if residual.relative else B - B.mean(0)
    own = [p.name for p in effect.parameters]
    at = [list(names).index(name) for name in own]
    P = covariance[np.ix_(at, at)]
    value = B @ np.array([values[name] for name in own])
    sd = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", B, P, B), 0))
    band = simultaneous_critical_value(B, P) * sd
    if not of[0].angle:
        band = band + between_knots(np.array([values[name] for name in own]), grid, span)
    return NonparametricForce(
        curve.force, curve.variable, grid, value, sd, band, residual.unit, of[0].unit, residual.stage in SENSOR_STAGES
    )


def simultaneous_critical_value(B: Array, P: Array, n: int = 4000) -> float:
    """Return the critical value of the simultaneous 95 % band of a curve ``B t`` with random coefficients t.

    The critical value is the number of pointwise standard deviations within which the whole curve lies with a
    probability of 95 % (Ruppert, Wand and Carroll 2003, section 6.5). It is computed by simulation.

    Parameters
    ----------
    B : Array (n_points, n_coefficients)
        Basis functions.
    P : Array (n_coefficients, n_coefficients)
        Covariance of t.
    n : int
        Number of simulated curves. The seed is fixed.

    Returns
    -------
    float
        The critical value. Points with a standard deviation of zero are ignored; 0 if all have none. Negative
        eigenvalues of P, from rounding, count as zero.
    """
    w, V = np.linalg.eigh(P)
    curves = B @ (V * np.sqrt(np.maximum(w, 0.0))) @ np.random.default_rng(0).standard_normal((len(P), n))
    sd = curves.std(axis=1, keepdims=True)
    drawn = np.abs(curves) / np.where(sd > 0, sd, np.inf)
    return float(np.quantile(drawn.max(axis=0), 0.95))


def between_knots(knots: Array, grid: Array, span: tuple[float, float]) -> Array:
    """Return a bound of the error of linear interpolation between knots, shape (n_points,), in the unit of the curve.

    The bound is a parabola in each interval: an eighth of the second difference of the knot values in the middle of the
    interval, and at least half of that everywhere. The larger second difference of both ends of an interval counts.

    Parameters
    ----------
    knots : Array (N_KNOTS,)
        Values of the curve at the knots.
    grid : Array (n_points,)
        Values of the variable. Values outside the knots get the bound at the nearest knot.
    span : tuple[float, float]
        First and last knot, in the unit of the variable.
    """
    bend = np.abs(np.diff(knots, 2))
    # second difference of each interval: the larger value of its two ends
    worst = np.concatenate([bend[:1], np.maximum(bend[:-1], bend[1:]), bend[-1:]])
    at = np.clip((grid - span[0]) / (span[1] - span[0]) * (N_KNOTS - 1), 0, N_KNOTS - 1)
    k = np.minimum(at.astype(int), N_KNOTS - 2)
    part = at - k
    # at least half of the bound everywhere, because the fitted knots do not lie on the true curve either
    return np.asarray(worst[k] / 8 * np.maximum(4 * part * (1 - part), 0.5))


def input_response_effects(model: Model) -> list[Effect]:
    """Return the lagged and the resonant response to each pair of thrusters, as effects that can be added to the model.

    The mean thrust of a pair acts on the surge force, and half the difference (left minus right) on the yaw moment; the
    thrust of a shaft speed n is n|n|. Responses that the model does not accept, for example since it has them already,
    are left out. For a model without a pair of thrusters, or without a residual force X or N, return [].
    """
    forces = {r.name: r for r in residuals_of(model)}
    effects = []
    for variable in variables_of(model):
        pair = variable.pair
        force = forces.get("N" if pair.difference else "X") if pair is not None else None
        if pair is not None and force is not None:
            drive, unit = _drive_reader(pair), variable.unit
            for effect in (
                lagged_response(force, variable.name, drive, unit),
                resonant_response(force, variable.name, drive, unit),
            ):
                if model.accepts(effect):
                    effects.append(effect)
    return effects


def _drive_reader(pair: ThrusterPair) -> Signal:
    """Return a function of the signals that returns the mean, or half the difference left minus right, of two thrusts.

    ``pair`` contains shaft speeds n or thrusts. Shaft speeds are converted to the thrust relative to full thrust, n
    |n|. Thrusts are used as they are [N].
    """

    def read(s: Signals) -> Any:
        """Return the mean thrust, or half the difference left minus right; the thrust of a shaft speed n is n |n|."""
        left, right = (s.state_or_input(f"{pair.quantity}_{side}") for side in ("left", "right"))
        if pair.quantity == "n":
            left, right = left * abs(left), right * abs(right)
        return (left - right if pair.difference else left + right) / 2

    return read


def _coefficient_scale(force: DisturbanceChannel, unit: str) -> tuple[str, float, float]:
    """Return the unit and typical size of a coefficient (force divided by drive), and the typical size of the drive.

    ``force`` is the force or moment on which the drive acts. The drive is a thrust with the ``unit`` "N" (typical size
    40 N), or relative to full thrust with an empty ``unit`` (typical size 1).
    """
    full = FULL_THRUST_N if unit else 1.0
    return unit_over(force.unit, unit), force.scale / full, full


def lagged_response(force: DisturbanceChannel, of: str, drive: Signal, unit: str) -> Effect:
    """Return the effect of a force that follows a drive w (thrust) with lags of 0.25, 1 and 4 s.

    The equations are ``F += sum_k t_k (z_k - w)`` and ``z_k' = (w - z_k) / T_k``, with the coefficients t_k as
    parameters and the z_k as states. In steady state, the response is zero.

    Parameters
    ----------
    force : DisturbanceChannel
        Force or moment F on which the drive acts.
    of : str
        Name of the variable of the drive, for example ``n_sum``.
    drive : Callable
        Function of the signals that returns w.
    unit : str
        Unit of w: empty for thrust relative to full thrust, or ``N``.
    """
    of_drive, scale, full = _coefficient_scale(force, unit)
    names = [f"{force.name}_{of}_late_{k}" for k in range(len(TIME_CONSTANTS))]
    states = [f"late_{of}_{k}" for k in range(len(TIME_CONSTANTS))]

    def add(s: Signals) -> None:
        """Add the response ``sum_k t_k (z_k - w)`` of the states z_k to the drive w to the force, in place."""
        w = drive(s)
        terms = zip(names, states, strict=True)
        force.add(s, sum(getattr(s.p, name) * (getattr(s.x, state) - w) for name, state in terms))

    def follow(s: Signals) -> None:
        """Set the rate of each state to ``(drive - state) / T``, in place, with its time constant T."""
        for state, time_constant in zip(states, TIME_CONSTANTS, strict=True):
            s.rate[state] = (drive(s) - getattr(s.x, state)) / time_constant

    curve = ForceCurve(force.name, of)
    return Effect(
        f"unknown {curve_name(EffectKind.LAGGED, curve)}",
        f"a nonparametric effect: {force.title} follows {of} with a lag",
        {force.stage: add, "rate": follow},
        parameters=built_in(
            Parameter(
                n,
                0.0,
                of_drive,
                f"{force.name} that follows {of} with a lag of {T:g} s",
                prior=(0.0, 2 * scale),
                step=0.03 * scale,
            )
            for n, T in zip(names, TIME_CONSTANTS, strict=True)
        ),
        states=tuple(
            State(n, unit, f"{of} after a lag of {T:g} s", 0.0, sd0=0.05 * full)
            for n, T in zip(states, TIME_CONSTANTS, strict=True)
        ),
        formula=f"{force.name} += sum t_k (z_k - w), z_k' = (w - z_k) / T_k, "
        f"w the {'thrust' if unit else 'thrust relative to full thrust'}",
        source="the residuals of the fit",
        experiment=f"steps of {of} from rest, each held until the motion has settled",
        requires=("hull",),
        kind=EffectKind.LAGGED,
        curve=curve,
    )


def resonant_response(force: DisturbanceChannel, of: str, drive: Signal, unit: str) -> Effect:
    """Return the effect of a force that oscillates after a change of a drive w (thrust).

    The equations are ``F += a (z - w) + b z' / omega`` and ``z'' + 0.2 omega z' = omega^2 (w - z)`` (damping ratio
    0.1). The coefficients a, b and the natural frequency are parameters. In steady state, the response is zero.

    Parameters
    ----------
    force : DisturbanceChannel
        Force or moment F on which the drive acts.
    of : str
        Name of the variable of the drive, for example ``n_sum``.
    drive : Callable
        Function of the signals that returns w.
    unit : str
        Unit of w: empty for thrust relative to full thrust, or ``N``.
    """
    of_drive, scale, full = _coefficient_scale(force, unit)
    names = (f"{force.name}_{of}_swing", f"{force.name}_{of}_swing_rate")
    states, f_name = (f"swing_{of}", f"swing_{of}_rate"), f"f_{force.name}_{of}"

    def add(s: Signals) -> None:
        """Add ``a (z - w) + b z' / omega`` to the force, in place, with the drive w and the two states."""
        z, quadrature = (getattr(s.x, n) for n in states)
        force.add(s, getattr(s.p, names[0]) * (z - drive(s)) + getattr(s.p, names[1]) * quadrature)

    def swing(s: Signals) -> None:
        """Set the rates of the two states of the second-order response, in place: z, and z' over omega."""
        omega = 2 * math.pi * getattr(s.p, f_name)
        z, quadrature = (getattr(s.x, n) for n in states)
        s.rate[states[0]] = omega * quadrature
        s.rate[states[1]] = omega * (drive(s) - z) - 2 * DAMPING * omega * quadrature

    curve = ForceCurve(force.name, of)
    return Effect(
        f"unknown {curve_name(EffectKind.RESONANT, curve)}",
        f"a nonparametric effect: {force.title} responds to {of} with a resonance",
        {force.stage: add, "rate": swing},
        parameters=built_in(
            (
                *(
                    Parameter(
                        n,
                        0.0,
                        of_drive,
                        f"resonant response of {force.name} to {of}{part}",
                        prior=(0.0, 2 * scale),
                        step=0.03 * scale,
                    )
                    for n, part in zip(names, ("", ", quadrature"), strict=True)
                ),
                # The resonating part is unknown, so the frequencies do not scale: they are those that a log can show
                Parameter(
                    f_name, 0.5, "Hz", "natural frequency", "log", prior=(0.5, 0.4), bounds=(0.1, 2.5), scales=False
                ),
            )
        ),
        states=tuple(
            State(n, unit, meaning, 0.0, sd0=0.05 * full)
            for n, meaning in zip(
                states, (f"resonant response to {of}", f"quadrature of the resonant response to {of}"), strict=True
            )
        ),
        scan={f_name: FREQUENCIES_HZ},
        formula=f"{force.name} += a (z - w) + b z'/w0, z'' + 2 zeta w0 z' = w0^2 (w - z), "
        f"w the {'thrust' if unit else 'thrust relative to full thrust'}",
        source="the residuals of the fit",
        experiment=f"a chirp of {of} through 0.1 to 1.5 Hz",
        requires=("hull",),
        kind=EffectKind.RESONANT,
        curve=curve,
    )
