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
    curve_name,
)
from seatrial.ident.models import TIME, residuals_of, sensor_errors_of, thrust_losses_of, unit_over, variables_of
from seatrial.ident.numerics import Array

N_KNOTS, N_HARMONICS = 9, 3
ROUNDING = 0.25  # half width of a rounded corner, relative to the spacing of the knots
TIME_CONSTANTS = (0.25, 1.0, 4.0)  # s, time constants of the first-order lags
FREQUENCIES_HZ = (0.2, 0.32, 0.5, 0.8, 1.2)  # natural frequencies to try for a resonant response
DAMPING = 0.1  # damping ratio of a resonant response
SENSOR_STAGES = ("output", "reading")  # stages of sensor errors, which do not scale with the size of the boat
FULL_THRUST_N = 40.0  # full thrust of a thruster on the boat of the catalogue: the scale of an input in newtons
Signal = Callable[[Signals], Any]


@dataclass(frozen=True)
class NonparametricForce:
    """Fitted nonparametric curve.

    Attributes
    ----------
    force, variable : str
        Residual quantity and its variable.
    grid : Array (n,)
        Values of the variable [variable_unit].
    value : Array (n,)
        Residual quantity [unit].
    sd : Array (n,)
        Pointwise standard deviation [unit].
    band : Array (n,)
        Half width of the simultaneous 95 % band [unit].
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
    """Return the sines and cosines of an angle [rad], of twice and of three times the angle."""
    return [f(k * z) for k in range(1, N_HARMONICS + 1) for f in (np.sin, np.cos)]


def spline_basis(z: Any, angle: bool, span: tuple[float, float]) -> list[Any]:
    """Return the basis functions of a curve at z: linear B-splines with rounded corners, or harmonics of an angle.

    Parameters
    ----------
    z : float, Array or symbol
        Variable.
    angle : bool
        Whether the variable is an angle [rad].
    span : tuple[float, float]
        Range of the knots. Beyond this range the curve is constant.

    Notes ----- The slope of a linear spline jumps at its knots, and the filter linearises by the slope. The likelihood
    would therefore jump when a sample passes a knot (by 2.4 on a boat with a steep curve), and a search would stop at
    the jump, below the maximum. Each spline is therefore replaced by its moving average over ROUNDING of the spacing in
    both directions. Straight lines, and the sum of one of all splines, are not changed by the average.
    """
    if angle:
        return harmonics(z)
    low, high = span
    at = (z - low) / (high - low) * (N_KNOTS - 1)
    distances = [_rounded_abs(at - k) for k in range(N_KNOTS)]
    rise = [(1 + a - b) / 2 for a, b in pairwise(distances)]  # from 0 to 1 between two knots
    return [1 - rise[0], *(a - b for a, b in pairwise(rise)), rise[-1]]


def _rounded_abs(z: Any) -> Any:
    """Return the moving average of the absolute value over ROUNDING in both directions."""
    return abs(z) + (ROUNDING - abs(z)) ** 2 / (2 * ROUNDING) * (abs(z) < ROUNDING)


def _basis(residual: DisturbanceChannel, z: Any, angle: bool, span: tuple[float, float]) -> list[Any]:
    """Return the basis functions of the variable.

    For a relative residual, their values at zero are subtracted: a constant factor belongs to the scale of the thrust.
    """
    basis = spline_basis(z, angle, span)
    if not residual.relative:
        return basis
    return [b - b0 for b, b0 in zip(basis, spline_basis(0.0, angle, span), strict=True)]


def partition(model: Model, curve: ForceCurve) -> tuple[DisturbanceChannel, list[Variable]]:
    """Return the residual of a curve and its variable, or the two variables of a product.

    Raises
    ------
    ValueError
        If the model lacks the residual or a variable.
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


def _terms(of: Sequence[Variable]) -> list[str]:
    """Return the meaning of each coefficient of a curve, by its term."""
    a = of[0].name
    if len(of) == 2:
        b = of[1].name
        return [f"with {a} {b}", f"with |{a}| {b}", f"with {a} |{b}|"]
    if of[0].angle:
        return [f"with {f} {k if k > 1 else ''}{a}" for k in range(1, N_HARMONICS + 1) for f in ("sin", "cos")]
    return [f"at knot {k} of {a}" for k in range(N_KNOTS)]


def nonparametric_effect(model: Model, curve: ForceCurve, span: tuple[float, float]) -> Effect:
    """Return the nonparametric effect ``force += sum_k t_k basis_k(variable)``.

    Parameters
    ----------
    model : Model
        Model with the residual and the variables.
    curve : ForceCurve
        Residual quantity and its variable. With two variables, the terms are products of them. For a relative residual,
        the sum is a relative change of the thrust.
    span : tuple[float, float]
        Range of the variable that the knots cover.

    Raises
    ------
    ValueError
        If the model lacks the residual or a variable.
    """
    residual, of = partition(model, curve)
    force, variable = curve.force, curve.variables
    terms_of = _terms(of)
    unit = unit_over(residual.unit, *(v.unit for v in of)) if len(of) == 2 else residual.unit
    names = [f"{force}_{curve.variable}{curve.second}_{k}" for k in range(len(terms_of))]

    def add(s: Signals) -> None:
        if len(of) == 2:
            a, b = (v.read(s) for v in of)
            terms = [a * b, abs(a) * b, a * abs(b)]
        else:
            terms = _basis(residual, of[0].read(s), of[0].angle, span)
        residual.add(s, sum(getattr(s.p, name) * term for name, term in zip(names, terms, strict=True)))

    return Effect(
        f"unknown {curve_name(EffectKind.NONPARAMETRIC, curve)}",
        f"a nonparametric effect: {residual.title} depends on {variable}",
        {residual.stage: add},
        parameters=tuple(
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
        experiment=f"runs that vary {variable} slowly over its whole range, with all other variables constant",
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
        Model with the residual and the variable.
    effect : Effect
        Nonparametric effect.
    values : Mapping[str, float]
        Fitted parameters by name.
    names : Sequence[str]
        Names of the parameters of `covariance`, in order.
    covariance : Array (n_parameters, n_parameters)
        Covariance of the estimates.
    n : int
        Number of points.

    Returns
    -------
    NonparametricForce or None
        The curve less its mean, because a constant belongs to other parameters. For a relative residual, the curve less
        its value at zero. None for products of two variables, and for lagged and resonant responses.
    """
    span, curve = effect.span, effect.curve
    if span is None or curve is None or curve.second:
        return None
    residual, of = partition(model, curve)
    grid = np.linspace(-np.pi, np.pi, n) if of[0].angle else np.linspace(*span, n)
    B = np.column_stack([b * np.ones(n) for b in _basis(residual, grid, of[0].angle, span)])
    B = B if residual.relative else B - B.mean(0)
    own = [p.name for p in effect.parameters]
    at = [list(names).index(name) for name in own]
    P = covariance[np.ix_(at, at)]
    value = B @ np.array([values[name] for name in own])
    sd = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", B, P, B), 0))
    band = whole_band(B, P) * sd
    if not of[0].angle:
        band = band + between_knots(np.array([values[name] for name in own]), grid, span)
    return NonparametricForce(
        curve.force, curve.variable, grid, value, sd, band, residual.unit, of[0].unit, residual.stage in SENSOR_STAGES
    )


def whole_band(B: Array, P: Array, n: int = 4000) -> float:
    """Return the critical value of the simultaneous 95 % band of a curve ``B t``.

    The critical value is the number of pointwise standard deviations within which the whole curve lies with a
    probability of 95 % (Ruppert, Wand and Carroll 2003, section 6.5).

    Parameters
    ----------
    B : Array (n_points, n_coefficients)
        Basis functions.
    P : Array (n_coefficients, n_coefficients)
        Covariance of t.
    n : int
        Number of random curves, from a fixed seed.
    """
    w, V = np.linalg.eigh(P)
    curves = B @ (V * np.sqrt(np.maximum(w, 0.0))) @ np.random.default_rng(0).standard_normal((len(P), n))
    sd = curves.std(axis=1, keepdims=True)
    drawn = np.abs(curves) / np.where(sd > 0, sd, np.inf)
    return float(np.quantile(drawn.max(axis=0), 0.95))


def between_knots(knots: Array, grid: Array, span: tuple[float, float]) -> Array:
    """Return a bound of the error of linear interpolation between knots, shape (n_points,).

    The bound is an eighth of the second difference of the knots at the middle of an interval, and less towards the
    knots.

    Parameters
    ----------
    knots : Array (N_KNOTS,)
        Values at the knots.
    grid : Array (n_points,)
        Values of the variable.
    span : tuple[float, float]
        First and last knot.
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
    """Return the lagged and the resonant response to each pair of thrusters that the model does not have yet.

    Return [] for a model without a pair of thrusters.
    """
    forces = {r.name: r for r in residuals_of(model)}
    effects = []
    for variable in variables_of(model):
        pair = variable.pair
        force = forces.get("N" if pair.difference else "X") if pair is not None else None
        if pair is not None and force is not None:
            drive, unit = _thrust(pair), variable.unit
            for effect in (
                lagged_response(force, variable.name, drive, unit),
                resonant_response(force, variable.name, drive, unit),
            ):
                if model.accepts(effect):
                    effects.append(effect)
    return effects


def _thrust(pair: ThrusterPair) -> Signal:
    """Return the function that reads the mean or half difference of two thrusts.

    Shaft speeds are converted to thrust relative to full thrust, quadratic in the shaft speed. Thrusts are used as
    given [N].
    """

    def read(s: Signals) -> Any:
        left, right = (s.state_or_input(f"{pair.quantity}_{side}") for side in ("left", "right"))
        if pair.quantity == "n":
            left, right = left * abs(left), right * abs(right)
        return (left - right if pair.difference else left + right) / 2

    return read


def _per_drive(force: DisturbanceChannel, unit: str) -> tuple[str, float, float]:
    """Return unit and scale of a coefficient of force per drive, and the scale of the drive.

    ``unit`` is the unit of the drive. A drive without a unit is thrust relative to full thrust.
    """
    full = FULL_THRUST_N if unit else 1.0
    return unit_over(force.unit, unit), force.scale / full, full


def lagged_response(force: DisturbanceChannel, of: str, drive: Signal, unit: str) -> Effect:
    """Return the first-order lagged response to w [``unit``]: ``F += sum_k t_k (z_k - w)``,
    ``z_k' = (w - z_k) / T_k``.
    """
    of_drive, scale, full = _per_drive(force, unit)
    names = [f"{force.name}_{of}_late_{k}" for k in range(len(TIME_CONSTANTS))]
    states = [f"late_{of}_{k}" for k in range(len(TIME_CONSTANTS))]

    def add(s: Signals) -> None:
        w = drive(s)
        terms = zip(names, states, strict=True)
        force.add(s, sum(getattr(s.p, name) * (getattr(s.x, state) - w) for name, state in terms))

    def follow(s: Signals) -> None:
        for state, time_constant in zip(states, TIME_CONSTANTS, strict=True):
            s.rate[state] = (drive(s) - getattr(s.x, state)) / time_constant

    curve = ForceCurve(force.name, of)
    return Effect(
        f"unknown {curve_name(EffectKind.LAGGED, curve)}",
        f"a nonparametric effect: {force.title} follows {of} with a lag",
        {force.stage: add, "rate": follow},
        parameters=tuple(
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
    """Return the resonant response to w [``unit``]: ``F += a (z - w) + b z' / omega``, z a
    second-order mode driven by w.
    """
    of_drive, scale, full = _per_drive(force, unit)
    names = (f"{force.name}_{of}_swing", f"{force.name}_{of}_swing_rate")
    states, f_name = (f"swing_{of}", f"swing_{of}_rate"), f"f_{force.name}_{of}"

    def add(s: Signals) -> None:
        z, quadrature = (getattr(s.x, n) for n in states)
        force.add(s, getattr(s.p, names[0]) * (z - drive(s)) + getattr(s.p, names[1]) * quadrature)

    def swing(s: Signals) -> None:
        omega = 2 * math.pi * getattr(s.p, f_name)
        z, quadrature = (getattr(s.x, n) for n in states)
        s.rate[states[0]] = omega * quadrature
        s.rate[states[1]] = omega * (drive(s) - z) - 2 * DAMPING * omega * quadrature

    curve = ForceCurve(force.name, of)
    return Effect(
        f"unknown {curve_name(EffectKind.RESONANT, curve)}",
        f"a nonparametric effect: {force.title} responds to {of} with a resonance",
        {force.stage: add, "rate": swing},
        parameters=(
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
            Parameter(f_name, 0.5, "Hz", "natural frequency", "log", prior=(0.5, 0.4), bounds=(0.1, 2.5), scales=False),
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
