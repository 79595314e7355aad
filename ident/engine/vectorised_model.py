"""Rates, outputs and Jacobians of a model for arrays of states and inputs."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from ident.model import Model
from ident.numerics import Array

ca.GlobalOptions.setNumpyMode(-1)  # plain numpy functions on symbols stay symbolic

ROWS = 1024  # of a Jacobian that are evaluated at a time


class VectorisedModel:
    """``rates`` and ``outputs`` of a model for whole arrays of states and inputs.

    The model's own functions are called with columns instead of scalars; one that takes symbols but no columns is
    evaluated by CasADi, which is five to ten times slower.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.n_states, self.n_outputs = len(model.states), len(model.outputs)

    def __call__(self, x: Array, u: Array, values: Array) -> Array:
        """Rates, then outputs: (n_rows, n_states + n_outputs) for x (n_rows, n_states), u (n_rows, n_inputs)."""
        with np.errstate(all="ignore"):
            try:
                s = self.model.signals(list(x.T), list(u.T), values.tolist())
                columns = [s.rate[v.name] for v in self.model.states] + [s.y[o.name] for o in self.model.outputs]
                found = np.empty((len(x), len(columns)))
                for j, column in enumerate(columns):
                    found[:, j] = column
            except (TypeError, ValueError):
                return np.asarray(self._both(x.T, u.T, values)).T
        return found

    def output_jacobian(self, x: Array, u: Array, values: Array) -> Array:
        """(n_rows, n_outputs, n_states)."""
        return self._slopes(self._output_jacobian, self.n_outputs, x, u, values)

    def rate_jacobian(self, x: Array, u: Array, values: Array) -> Array:
        """(n_rows, n_states, n_states)."""
        return self._slopes(self._rate_jacobian, self.n_states, x, u, values)

    def _slopes(self, function: Any, n: int, x: Array, u: Array, values: Array) -> Array:
        """CasADi copies all that it is given several times: a thousand rows at a time take half as long."""
        found = np.empty((len(x), n, self.n_states))
        for first in range(0, len(x), ROWS):
            rows = slice(first, first + ROWS)
            flat = np.asarray(function(x[rows].T, u[rows].T, values))
            found[rows] = flat.reshape(n, -1, self.n_states).swapaxes(0, 1)
        return found

    @cached_property
    def _symbols(self) -> tuple[list[Any], Any, Any]:
        """x, u, p; rates; outputs."""
        sizes = (("x", self.model.states), ("u", self.model.inputs), ("p", self.model.parameters))
        x, u, p = (ca.SX.sym(n, len(k)) for n, k in sizes)
        s = self.model.signals(ca.vertsplit(x), ca.vertsplit(u) if self.model.inputs else [], ca.vertsplit(p))
        rate = ca.vertcat(*[s.rate[v.name] for v in self.model.states])
        return [x, u, p], rate, ca.vertcat(*[s.y[o.name] for o in self.model.outputs])

    @cached_property
    def _both(self) -> Any:
        given, rate, y = self._symbols
        return ca.Function("rates_and_outputs", given, [ca.densify(ca.vertcat(rate, y))])

    @cached_property
    def _output_jacobian(self) -> Any:
        given, _, y = self._symbols
        return ca.Function("H", given, [ca.densify(ca.jacobian(y, given[0]))])

    @cached_property
    def _rate_jacobian(self) -> Any:
        given, rate, _ = self._symbols
        return ca.Function("A", given, [ca.densify(ca.jacobian(rate, given[0]))])
