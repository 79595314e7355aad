"""Nonparametric effects: a residual force or sensor error as a curve over one variable, a linear spline with rounded
corners, or harmonics of an angle.

Besides, two responses to an input that no catalogue lists: first-order lagged and second-order resonant.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np

from seatrial.ident.model import (
    Effect,
    EffectKind,
    ForceCurve,
    Input,
    Model,
    Parameter,
    Residual,
    Signals,
    State,
    ThrusterPair,
    Variable,
    curve_name,
)
from seatrial.ident.models import TIME, readings_of, residuals_of, thrust_losses_of, unit_over, variables_of
from seatrial.ident.numerics import Array

N_KNOTS, N_HARMONICS = 9, 3
ROUNDING = 0.25  # of the spacing of the knots, to either side of a corner
TIME_CONSTANTS = (0.25, 1.0, 4.0)  # s, time constants of the first-order lags
FREQUENCIES = (0.2, 0.32, 0.5, 0.8, 1.2)  # Hz, natural frequencies that are tried
DAMPING = 0.1
OF_SENSORS = ("output", "reading")  # stages of what a sensor gets wrong, which is not the boat's
FULL = 40.0  # N, full thrust of a thruster of the catalogue's boat: what an input in newtons usually is
Signal = Callable[[Signals], Any]


@dataclass(frozen=True)
class NonparametricForce:
    """A fitted nonparametric curve: the force over a grid of the variable, its pointwise standard deviation, and the
    half width of the simultaneous 95 % band."""

    force: str
    variable: str
    grid: Array
    value: Array
    sd: Array
    band: Array
    unit: str
    variable_unit: str
    reading: bool = False  # the error of a sensor, not a force


def harmonics(z: Any) -> list[Any]:
    """Sines and cosines of an angle, its double and its triple."""
    return [f(k * z) for k in range(1, N_HARMONICS + 1) for f in (np.sin, np.cos)]


def spline_basis(z: Any, angle: bool, span: tuple[float, float]) -> list[Any]:
    """Linear B-splines (hat functions) over the span, constant beyond it, their corners rounded; harmonics for an
    angle.

    At a corner the slope would jump, and the filter linearises by the slope: a sample that passes a knot would make the
    likelihood jump (by 2.4 on a boat with a steep curve), on whose edge a search stops short of the top. Each hat is
    therefore the mean of itself over ROUNDING of the spacing to either side, which leaves lines and their sum of one as
    they are.
    """
    if angle:
        return harmonics(z)
    low, high = span
    at = (z - low) / (high - low) * (N_KNOTS - 1)
    bent = [_rounded_abs(at - k) for k in range(N_KNOTS)]
    rise = [(1 + a - b) / 2 for a, b in pairwise(bent)]  # from 0 to 1 between two knots
    return [1 - rise[0], *(a - b for a, b in pairwise(rise)), rise[-1]]


def _rounded_abs(z: Any) -> Any:
    """The mean of the absolute value over ROUNDING to either side."""
    return abs(z) + (ROUNDING - abs(z)) ** 2 / (2 * ROUNDING) * (abs(z) < ROUNDING)


def _basis(residual: Residual, z: Any, angle: bool, span: tuple[float, float]) -> list[Any]:
    """The basis of the variable; of a relative residual without what it is at zero, the scale of the thrust."""
    basis = spline_basis(z, angle, span)
    if not residual.relative:
        return basis
    return [b - b0 for b, b0 in zip(basis, spline_basis(0.0, angle, span), strict=True)]


def partition(model: Model, curve: ForceCurve) -> tuple[Residual, list[Variable]]:
    """The residual and the variable, or the two of a product. Raises ValueError for what the model has not."""
    residuals = {r.name: r for r in (*residuals_of(model), *readings_of(model), *thrust_losses_of(model))}
    variables = {v.name: v for v in (*variables_of(model), TIME)}
    of = [curve.variable, curve.second] if curve.second else [curve.variable]
    wanted = [(curve.force, list(residuals)), *((v, list(variables)) for v in of)]
    for name, known in wanted:
        if name not in known:
            there = ", ".join(known)
            raise ValueError(f"model {model.name} has no {name!r} for a nonparametric curve; it has {there}")
    return residuals[curve.force], [variables[name] for name in of]


def _terms(of: Sequence[Variable]) -> list[str]:
    """The meaning of each coefficient."""
    a = of[0].name
    if len(of) == 2:
        b = of[1].name
        return [f"with {a} {b}", f"with |{a}| {b}", f"with {a} |{b}|"]
    if of[0].angle:
        return [f"with {f} {k if k > 1 else ''}{a}" for k in range(1, N_HARMONICS + 1) for f in ("sin", "cos")]
    return [f"at knot {k} of {a}" for k in range(N_KNOTS)]


def nonparametric_effect(model: Model, curve: ForceCurve, span: tuple[float, float]) -> Effect:
    """``force += sum_k t_k basis_k(variable)``, or coefficients of the products of two variables; of a thrust its
    relative change."""
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
                f"{force} {what}",
                prior=(0.0, residual.scale),
                step=0.03 * residual.scale,
                scales=residual.stage not in OF_SENSORS,
            )
            for n, what in zip(names, terms_of, strict=True)
        ),
        inputs=(Input("t", "s", "linear"),) if curve.variable == "t" else (),
        place=residual.place,
        formula=f"{force} {'*= 1 +' if residual.relative else '+='} g({variable}), a nonparametric curve",
        source="the residual itself",
        experiment=f"runs that vary {variable} slowly over its whole range, with all else held",
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
    """The fitted curve with its band, without its mean (a constant belongs to other parameters), or of a relative
    residual what it is beyond that at zero.

    None for products of two variables, and for lagged and resonant responses.
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
        curve.force, curve.variable, grid, value, sd, band, residual.unit, of[0].unit, residual.stage in OF_SENSORS
    )


def whole_band(B: Array, P: Array, n: int = 4000) -> float:
    """Critical value of the simultaneous 95 % band of a curve ``B t``, t having the covariance P: the number of
    standard deviations that hold the whole curve (Ruppert, Wand and Carroll 2003, section 6.5), from n draws of a
    fixed seed."""
    w, V = np.linalg.eigh(P)
    curves = B @ (V * np.sqrt(np.maximum(w, 0.0))) @ np.random.default_rng(0).standard_normal((len(P), n))
    sd = curves.std(axis=1, keepdims=True)
    drawn = np.abs(curves) / np.where(sd > 0, sd, np.inf)
    return float(np.quantile(drawn.max(axis=0), 0.95))


def between_knots(knots: Array, grid: Array, span: tuple[float, float]) -> Array:
    """Error bound of linear interpolation between knots, (grid,): an eighth of the second difference in the middle of
    an interval, less towards the knots."""
    bend = np.abs(np.diff(knots, 2))
    worst = np.concatenate([bend[:1], np.maximum(bend[:-1], bend[1:]), bend[-1:]])  # of each interval, by its ends
    at = np.clip((grid - span[0]) / (span[1] - span[0]) * (N_KNOTS - 1), 0, N_KNOTS - 1)
    k = np.minimum(at.astype(int), N_KNOTS - 2)
    part = at - k
    return np.asarray(worst[k] / 8 * np.maximum(4 * part * (1 - part), 0.5))  # a fit puts its knots off the curve, too


def input_response_effects(model: Model) -> list[Effect]:
    """Lagged and resonant responses to each input that the model does not have; none without a pair of thrusters."""
    forces = {r.name: r for r in residuals_of(model)}
    found = []
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
                    found.append(effect)
    return found


def _thrust(pair: ThrusterPair) -> Signal:
    """Mean or half difference of the thrusts, of shafts relative to full thrust (quadratic in shaft speed), else as
    given [N]."""

    def read(s: Signals) -> Any:
        left, right = (s.state_or_input(f"{pair.quantity}_{side}") for side in ("left", "right"))
        if pair.quantity == "n":
            left, right = left * abs(left), right * abs(right)
        return (left - right if pair.difference else left + right) / 2

    return read


def _per_drive(force: Residual, unit: str) -> tuple[str, float, float]:
    """Unit and scale of a coefficient of a drive in this unit, and the drive's own scale; without a unit it is a part
    of full thrust."""
    return unit_over(force.unit, unit), force.scale / (FULL if unit else 1.0), FULL if unit else 1.0


def lagged_response(force: Residual, of: str, drive: Signal, unit: str) -> Effect:
    """First-order lagged response to w [``unit``]: ``F += sum_k t_k (z_k - w)``, ``z_k' = (w - z_k) / T_k``."""
    of_drive, scale, full = _per_drive(force, unit)
    names = [f"{force.name}_{of}_late_{k}" for k in range(len(TIME_CONSTANTS))]
    states = [f"late_{of}_{k}" for k in range(len(TIME_CONSTANTS))]

    def add(s: Signals) -> None:
        w = drive(s)
        terms = zip(names, states, strict=True)
        force.add(s, sum(getattr(s.p, name) * (getattr(s.x, state) - w) for name, state in terms))

    def follow(s: Signals) -> None:
        for state, memory in zip(states, TIME_CONSTANTS, strict=True):
            s.rate[state] = (drive(s) - getattr(s.x, state)) / memory

    curve = ForceCurve(force.name, of)
    return Effect(
        f"unknown {curve_name(EffectKind.LAGGED, curve)}",
        f"a nonparametric effect: {force.title} follows {of} with a lag",
        {force.stage: add, "rate": follow},
        parameters=tuple(
            Parameter(
                n, 0.0, of_drive, f"{force.name} behind {of} by {memory:g} s", prior=(0.0, 2 * scale), step=0.03 * scale
            )
            for n, memory in zip(names, TIME_CONSTANTS, strict=True)
        ),
        states=tuple(
            State(n, unit, f"{of} behind by {memory:g} s", 0.0, sd0=0.05 * full)
            for n, memory in zip(states, TIME_CONSTANTS, strict=True)
        ),
        formula=f"{force.name} += sum t_k (z_k - w), z_k' = (w - z_k) / T_k, "
        f"w the {'thrust' if unit else 'part of full thrust'}",
        source="the residual itself",
        experiment=f"steps of {of} from rest, each held until all has settled",
        requires=("hull",),
        kind=EffectKind.LAGGED,
        curve=curve,
    )


def resonant_response(force: Residual, of: str, drive: Signal, unit: str) -> Effect:
    """``F += a (z - w) + b z' / omega``, z a second-order mode driven by w: resonant response to w, in ``unit``."""
    of_drive, scale, full = _per_drive(force, unit)
    names = (f"{force.name}_{of}_swing", f"{force.name}_{of}_swing_rate")
    states, f_name = (f"swing_{of}", f"swing_{of}_rate"), f"f_{force.name}_{of}"

    def add(s: Signals) -> None:
        z, ahead = (getattr(s.x, n) for n in states)
        force.add(s, getattr(s.p, names[0]) * (z - drive(s)) + getattr(s.p, names[1]) * ahead)

    def swing(s: Signals) -> None:
        omega = 2 * math.pi * getattr(s.p, f_name)
        z, ahead = (getattr(s.x, n) for n in states)
        s.rate[states[0]] = omega * ahead
        s.rate[states[1]] = omega * (drive(s) - z) - 2 * DAMPING * omega * ahead

    curve = ForceCurve(force.name, of)
    return Effect(
        f"unknown {curve_name(EffectKind.RESONANT, curve)}",
        f"a nonparametric effect: {force.title} responds to {of} with a resonance",
        {force.stage: add, "rate": swing},
        parameters=(
            *(
                Parameter(
                    n, 0.0, of_drive, f"{force.name} resonant to {of}{what}", prior=(0.0, 2 * scale), step=0.03 * scale
                )
                for n, what in zip(names, ("", ", its quadrature"), strict=True)
            ),
            Parameter(
                f_name, 0.5, "Hz", "natural frequency", "log", prior=(0.5, 0.4), bounds=(0.1, 2.5), scales=False
            ),  # nobody knows what swings: the frequencies are those that a log can tell
        ),
        states=tuple(
            State(n, unit, what, 0.0, sd0=0.05 * full)
            for n, what in zip(states, (f"resonant response to {of}", "its quadrature"), strict=True)
        ),
        scan={f_name: FREQUENCIES},
        formula=f"{force.name} += a (z - w) + b z'/w0, z'' + 2 zeta w0 z' = w0^2 (w - z), "
        f"w the {'thrust' if unit else 'part of full thrust'}",
        source="the residual itself",
        experiment=f"a chirp of {of} through 0.1 to 1.5 Hz",
        requires=("hull",),
        kind=EffectKind.RESONANT,
        curve=curve,
    )
