"""Unknown effects: a residual force as a drawn function of one variable, usable in a model as a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ident.model import Effect, Input, Model, Residual, Signals, Variable
from ident.models.unexplained import TIME, residuals_of, variables_of
from ident.params import Parameter

Array = NDArray[np.float64]
N_KNOTS, N_HARMONICS = 7, 3


@dataclass(frozen=True)
class Shape:
    """A fitted unknown: the force over the variable's grid, with its standard deviation."""

    force: str
    variable: str
    grid: Array
    value: Array
    sd: Array
    unit: str
    variable_unit: str


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
    residuals = {r.name: r for r in residuals_of(model)}
    variables = {v.name: v for v in (*variables_of(model), TIME)}
    wanted = [(force, list(residuals)), *((v, list(variables)) for v in variable.split(", "))]
    for name, known in wanted:
        if name not in known:
            raise ValueError(f"model {model.name} has no {name!r} for an unknown effect; it has {', '.join(known)}")
    return residuals[force], [variables[name] for name in variable.split(", ")]


def unknown_effect(model: Model, force: str, variable: str, span: tuple[float, float]) -> Effect:
    """``force += sum_k t_k basis_k(variable)``, or coefficients of the products of two variables ("u, r")."""
    residual, of = parts(model, force, variable)
    size = 3 if len(of) == 2 else 2 * N_HARMONICS if of[0].angle else N_KNOTS
    names = [f"{force}_{variable.replace(', ', '')}_{k}" for k in range(size)]

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
                n, 0.0, residual.unit, f"{force} at knot {k}", prior=(0.0, residual.scale), step=0.03 * residual.scale
            )
            for k, n in enumerate(names)
        ),
        inputs=(Input("t", "s", "linear"),) if variable == "t" else (),
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
    """The fitted curve with its band, without its mean (a constant belongs to other parameters); None for products."""
    force, variable = effect.name.removeprefix("unknown ").rstrip(")").split("(")
    residual, of = parts(model, force, variable)
    span = effect.span
    if len(of) == 2 or span is None:
        return None
    grid = np.linspace(-np.pi, np.pi, n) if of[0].angle else np.linspace(*span, n)
    B = np.column_stack([b * np.ones(n) for b in basis(grid, of[0].angle, span)])
    B = B - B.mean(0)
    own = [p.name for p in effect.parameters]
    at = [list(names).index(name) for name in own]
    P = covariance[np.ix_(at, at)]
    value = B @ np.array([values[name] for name in own])
    variance = np.maximum(np.einsum("ij,jk,ik->i", B, P, B), 0)
    if not of[0].angle:
        variance = variance + between_knots(np.array([values[name] for name in own]), grid, span) ** 2
    sd = np.sqrt(variance)
    return Shape(force, variable, grid, value, sd, residual.unit, of[0].unit)


def between_knots(knots: Array, grid: Array, span: tuple[float, float]) -> Array:
    """How far a smooth curve may be from the straight lines between its knots, (grid,): an eighth of the second
    difference in the middle of an interval (the error of linear interpolation), less towards the knots."""
    bend = np.abs(np.diff(knots, 2))
    worst = np.concatenate([bend[:1], np.maximum(bend[:-1], bend[1:]), bend[-1:]])  # of each interval, by its ends
    at = np.clip((grid - span[0]) / (span[1] - span[0]) * (N_KNOTS - 1), 0, N_KNOTS - 1)
    k = np.minimum(at.astype(int), N_KNOTS - 2)
    part = at - k
    return np.asarray(worst[k] / 8 * np.maximum(4 * part * (1 - part), 0.5))  # a fit puts its knots off the curve, too
