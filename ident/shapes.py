"""Unknown effects: a residual force as a drawn function of one variable, usable in a model as a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ident.model import Effect, Input, Model, Residual, Signals, Variable
from ident.models.unexplained import TIME, readings_of, residuals_of, variables_of
from ident.params import Parameter

Array = NDArray[np.float64]
N_KNOTS, N_HARMONICS = 9, 3


@dataclass(frozen=True)
class Shape:
    """A fitted unknown: the force over the variable's grid, with its standard deviation and the half width of the band
    that holds the whole of the curve with 95 % probability."""

    force: str
    variable: str
    grid: Array
    value: Array
    sd: Array
    band: Array
    unit: str
    variable_unit: str
    reading: bool = False  # not a force: the error of a sensor


def harmonics(z: Any) -> list[Any]:
    """Sines and cosines of an angle, its double and its triple."""
    return [f(k * z) for k in range(1, N_HARMONICS + 1) for f in (np.sin, np.cos)]


def basis(z: Any, angle: bool, span: tuple[float, float]) -> list[Any]:
    """Hat functions over the span, constant beyond it; harmonics for an angle."""
    if angle:
        return harmonics(z)
    low, high = span
    at = (z - low) / (high - low) * (N_KNOTS - 1)
    at = at * (at > 0)
    at = at - (at - (N_KNOTS - 1)) * (at > N_KNOTS - 1)
    return [(1 - abs(at - k)) * (abs(at - k) < 1) for k in range(N_KNOTS)]


def parts(model: Model, force: str, variable: str) -> tuple[Residual, list[Variable]]:
    """The residual and the variable, or the two of a product ("u, r"). Raises ValueError for what the model has not."""
    residuals = {r.name: r for r in (*residuals_of(model), *readings_of(model))}
    variables = {v.name: v for v in (*variables_of(model), TIME)}
    wanted = [(force, list(residuals)), *((v, list(variables)) for v in variable.split(", "))]
    for name, known in wanted:
        if name not in known:
            raise ValueError(f"model {model.name} has no {name!r} for an unknown effect; it has {', '.join(known)}")
    return residuals[force], [variables[name] for name in variable.split(", ")]


def _terms(of: Sequence[Variable]) -> list[str]:
    """What each coefficient of a table belongs to, in words."""
    a = of[0].name
    if len(of) == 2:
        b = of[1].name
        return [f"with {a} {b}", f"with |{a}| {b}", f"with {a} |{b}|"]
    if of[0].angle:
        return [f"with {f} {k if k > 1 else ''}{a}" for k in range(1, N_HARMONICS + 1) for f in ("sin", "cos")]
    return [f"at knot {k} of {a}" for k in range(N_KNOTS)]


def unknown_effect(model: Model, force: str, variable: str, span: tuple[float, float]) -> Effect:
    """``force += sum_k t_k basis_k(variable)``, or coefficients of the products of two variables ("u, r")."""
    residual, of = parts(model, force, variable)
    terms_of = _terms(of)
    names = [f"{force}_{variable.replace(', ', '')}_{k}" for k in range(len(terms_of))]

    def add(s: Signals) -> None:
        if len(of) == 2:
            a, b = (v.read(s) for v in of)
            terms = [a * b, abs(a) * b, a * abs(b)]
        else:
            terms = basis(of[0].read(s), of[0].angle, span)
        residual.add(s, sum(getattr(s.p, name) * term for name, term in zip(names, terms, strict=True)))

    return Effect(
        f"unknown {force}({variable})",
        f"an unknown effect: {residual.title} depends on {variable}",
        {residual.stage: add},
        parameters=tuple(
            Parameter(
                n, 0.0, residual.unit, f"{force} {what}", prior=(0.0, residual.scale), step=0.03 * residual.scale
            )
            for n, what in zip(names, terms_of, strict=True)
        ),
        inputs=(Input("t", "s", "linear"),) if variable == "t" else (),
        place="sensor" if residual.stage == "output" else "bench" if "bench" in model.provides else "hull",
        formula=f"{force} += g({variable}), a table",
        source="the residual itself",
        experiment=f"runs that vary {variable} slowly over its whole range, with all else held",
        requires=tuple(n for n in ("hull", "bench") if n in model.provides),
        span=span,
    )


def shape(
    model: Model,
    effect: Effect,
    values: Mapping[str, float],
    names: Sequence[str],
    covariance: Array,
    n: int = 60,
) -> Shape | None:
    """The fitted curve with its band, without its mean (a constant belongs to other parameters).

    None for products, and for what depends on an input's past.
    """
    span = effect.span
    if span is None or ", " in effect.name:
        return None
    force, variable = effect.name.removeprefix("unknown ").rstrip(")").split("(")
    residual, of = parts(model, force, variable)
    grid = np.linspace(-np.pi, np.pi, n) if of[0].angle else np.linspace(*span, n)
    B = np.column_stack([b * np.ones(n) for b in basis(grid, of[0].angle, span)])
    B = B - B.mean(0)
    own = [p.name for p in effect.parameters]
    at = [list(names).index(name) for name in own]
    P = covariance[np.ix_(at, at)]
    value = B @ np.array([values[name] for name in own])
    sd = np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", B, P, B), 0))
    band = whole_band(B, P) * sd
    if not of[0].angle:
        band = band + between_knots(np.array([values[name] for name in own]), grid, span)
    return Shape(force, variable, grid, value, sd, band, residual.unit, of[0].unit, residual.stage == "output")


def whole_band(B: Array, P: Array, n: int = 4000) -> float:
    """How many standard deviations the whole of a curve ``B t`` stays within with 95 % probability, t having the
    covariance P (Ruppert, Wand and Carroll 2003, section 6.5): from n draws, always the same ones."""
    w, V = np.linalg.eigh(P)
    curves = B @ (V * np.sqrt(np.maximum(w, 0.0))) @ np.random.default_rng(0).standard_normal((len(P), n))
    sd = curves.std(axis=1, keepdims=True)
    drawn = np.abs(curves) / np.where(sd > 0, sd, np.inf)
    return float(np.quantile(drawn.max(axis=0), 0.95))


def between_knots(knots: Array, grid: Array, span: tuple[float, float]) -> Array:
    """How far a smooth curve may be from the straight lines between its knots, (grid,): an eighth of the second
    difference in the middle of an interval (the error of linear interpolation), less towards the knots."""
    bend = np.abs(np.diff(knots, 2))
    worst = np.concatenate([bend[:1], np.maximum(bend[:-1], bend[1:]), bend[-1:]])  # of each interval, by its ends
    at = np.clip((grid - span[0]) / (span[1] - span[0]) * (N_KNOTS - 1), 0, N_KNOTS - 1)
    k = np.minimum(at.astype(int), N_KNOTS - 2)
    part = at - k
    return np.asarray(worst[k] / 8 * np.maximum(4 * part * (1 - part), 0.5))  # a fit puts its knots off the curve, too
