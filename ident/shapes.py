"""Unknown effects: a residual force as a drawn function of one variable, usable in a model as a table."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ident.model import Effect, Input, Signals
from ident.params import Parameter

Array = NDArray[np.float64]
N_KNOTS = 7
PRIOR = {"X": 10.0, "Y": 10.0, "N": 2.0}  # N, N, N m
UNITS = {"X": "N", "Y": "N", "N": "N m"}
VARIABLE_UNITS = {
    "u": "m/s",
    "v": "m/s",
    "r": "rad/s",
    "psi": "rad",
    "t": "s",
    "n_sum": "",
    "n_diff": "",
    "f_sum": "N",
    "f_diff": "N",
}


@dataclass(frozen=True)
class Shape:
    """A fitted unknown: the force over the variable's grid, with its standard deviation."""

    force: str
    variable: str
    grid: Array
    value: Array
    sd: Array

    @property
    def unit(self) -> str:
        return UNITS[self.force]

    @property
    def variable_unit(self) -> str:
        return VARIABLE_UNITS.get(self.variable, "")


def read_variable(s: Signals, name: str) -> Any:
    if name in ("u", "v", "r", "psi"):
        return getattr(s.x, name)
    if name == "t":
        return s.u.t
    letter, _, kind = name.partition("_")
    left, right = getattr(s.u, f"{letter}_left"), getattr(s.u, f"{letter}_right")
    return (left + right) / 2 if kind == "sum" else left - right


def basis(z: Any, variable: str, span: tuple[float, float]) -> list[Any]:
    """Hat functions over the span, constant beyond it; harmonics for the heading."""
    if variable == "psi":
        return [np.sin(z), np.cos(z), np.sin(2 * z), np.cos(2 * z)]
    low, high = span
    at = (z - low) / (high - low) * (N_KNOTS - 1)
    at = at * (at > 0)
    at = at - (at - (N_KNOTS - 1)) * (at > N_KNOTS - 1)
    return [(1 - abs(at - k)) * (abs(at - k) < 1) for k in range(N_KNOTS)]


def unknown_effect(force: str, variable: str, span: tuple[float, float]) -> Effect:
    """``force += sum_k t_k basis_k(variable)``, or coefficients of the products of two velocities ("u, r")."""
    pair = variable.split(", ")
    size = 3 if len(pair) == 2 else 4 if variable == "psi" else N_KNOTS
    names = [f"{force}_{variable.replace(', ', '')}_{k}" for k in range(size)]

    def add(s: Signals) -> None:
        if len(pair) == 2:
            a, b = (read_variable(s, name) for name in pair)
            terms = [a * b, abs(a) * b, a * abs(b)]
        else:
            terms = basis(read_variable(s, variable), variable, span)
        extra = sum(getattr(s.p, name) * term for name, term in zip(names, terms, strict=True))
        setattr(s, force, getattr(s, force) + extra)

    return Effect(
        f"unknown {force}({variable})",
        f"an unknown effect: the force {force} depends on {variable}",
        {"force": add},
        parameters=tuple(
            Parameter(n, 0.0, UNITS[force], f"{force} at knot {k}", prior=(0.0, PRIOR[force]), step=0.03 * PRIOR[force])
            for k, n in enumerate(names)
        ),
        inputs=(Input("t", "s", "linear"),) if variable == "t" else (),
        formula=f"{force} += g({variable}), a table",
        source="the residual itself",
        experiment=f"runs that vary {variable} slowly over its whole range, with all else held",
        requires=("hull",),
    )


def shape(
    effect: Effect,
    span: tuple[float, float],
    values: Mapping[str, float],
    names: Sequence[str],
    covariance: Array,
    n: int = 60,
) -> Shape | None:
    """The fitted curve with its band, without its mean (a constant belongs to other parameters); None for products."""
    force, variable = effect.name.removeprefix("unknown ").rstrip(")").split("(")
    if "," in variable:
        return None
    grid = np.linspace(-np.pi, np.pi, n) if variable == "psi" else np.linspace(*span, n)
    B = np.column_stack([b * np.ones(n) for b in basis(grid, variable, span)])
    B = B - B.mean(0)
    own = [p.name for p in effect.parameters]
    at = [list(names).index(name) for name in own]
    P = covariance[np.ix_(at, at)]
    value = B @ np.array([values[name] for name in own])
    return Shape(force, variable, grid, value, np.sqrt(np.maximum(np.einsum("ij,jk,ik->i", B, P, B), 0)))
