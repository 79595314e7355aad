"""Rates, outputs and Jacobians of a model for arrays of states and inputs."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from seatrial.ident.model import Model
from seatrial.ident.numerics import Array

ca.GlobalOptions.setNumpyMode(-1)  # plain numpy functions on symbols stay symbolic

ROWS = 32  # rows of states and inputs for which one call evaluates the Jacobian


class VectorisedModel:
    """Rates and outputs of a model for whole arrays of states and inputs.

    The functions of the model are called with columns instead of scalars. Functions that accept symbols but no columns
    are evaluated by CasADi, which is five to ten times slower.
    """

    def __init__(self, model: Model) -> None:
        self.model = model
        self.n_states, self.n_outputs = len(model.states), len(model.outputs)

    def __call__(self, x: Array, u: Array, values: Array) -> Array:
        """Return the rates, followed by the outputs, of all rows.

        Parameters
        ----------
        x : Array (n_rows, n_states)
            States.
        u : Array (n_rows, n_inputs)
            Inputs.
        values : Array (n_parameters,)
            Values of the parameters.

        Returns
        -------
        Array (n_rows, n_states + n_outputs)
            Rates and outputs.
        """
        columns = self.columns(x, u, values)
        result = np.empty((len(columns), len(x))).T  # transposed, so that every column is contiguous
        for j, column in enumerate(columns):
            result[:, j] = column
        return result

    def columns(self, x: Array, u: Array, values: Array) -> list[Array]:
        """Return the rates, followed by the outputs, as a list of columns (n_rows,)."""
        with np.errstate(all="ignore"):
            try:
                s = self.model.signals(list(x.T), list(u.T), values.tolist())
                signals = [s.rate[v.name] for v in self.model.states] + [s.y[o.name] for o in self.model.outputs]
                return [c if np.shape(c) == (len(x),) else np.full(len(x), c, dtype=np.float64) for c in signals]
            except (TypeError, ValueError):
                return list(np.asarray(self._both(x.T, u.T, values)))

    def output_jacobian(self, x: Array, u: Array, values: Array) -> Array:
        """Return the derivatives of the outputs by the states, shape (n_rows, n_outputs, n_states)."""
        return self._slopes(self._output_jacobian, self.n_outputs, x, u, values)

    def rate_jacobian(self, x: Array, u: Array, values: Array) -> Array:
        """Return the derivatives of the rates by the states, shape (n_rows, n_states, n_states)."""
        return self._slopes(self._rate_jacobian, self.n_states, x, u, values)

    def _slopes(self, function: Any, n: int, x: Array, u: Array, values: Array) -> Array:
        """Evaluate a Jacobian with n rows for all rows of states and inputs.

        The arguments are passed in buffers, because CasADi copies other arguments several times.
        """
        jacobians = np.empty((len(x), n, self.n_states))
        part_x, part_u, p = np.zeros((ROWS, x.shape[1])), np.zeros((ROWS, u.shape[1])), np.array(values, np.float64)
        slopes = np.empty((ROWS, self.n_states, n))
        buffer, evaluate = function.buffer()
        for k, argument in enumerate((part_x, part_u, p)):
            buffer.set_arg(k, argument.data)
        buffer.set_res(0, slopes.data)
        for first in range(0, len(x), ROWS):
            size = len(x[first : first + ROWS])
            part_x[:size], part_u[:size] = x[first : first + ROWS], u[first : first + ROWS]
            evaluate()
            jacobians[first : first + size] = slopes[:size].swapaxes(1, 2)
        return jacobians

    @cached_property
    def _symbols(self) -> tuple[list[Any], Any, Any]:
        """Symbols [x, u, p], expressions of the rates, expressions of the outputs."""
        sizes = (("x", self.model.states), ("u", self.model.inputs), ("p", self.model.parameters))
        x, u, p = (ca.SX.sym(n, len(k)) for n, k in sizes)
        s = self.model.signals(ca.vertsplit(x), ca.vertsplit(u) if self.model.inputs else [], ca.vertsplit(p))
        rate = ca.vertcat(*[s.rate[v.name] for v in self.model.states])
        return [x, u, p], rate, ca.vertcat(*[s.y[o.name] for o in self.model.outputs])

    @cached_property
    def _both(self) -> Any:
        symbols, rate, y = self._symbols
        return ca.Function("rates_and_outputs", symbols, [ca.densify(ca.vertcat(rate, y))])

    @cached_property
    def _output_jacobian(self) -> Any:
        symbols, _, y = self._symbols
        return _by_rows("H", symbols, ca.jacobian(y, symbols[0]))

    @cached_property
    def _rate_jacobian(self) -> Any:
        symbols, rate, _ = self._symbols
        return _by_rows("A", symbols, ca.jacobian(rate, symbols[0]))


def _by_rows(name: str, symbols: list[Any], slopes: Any) -> Any:
    """Return a function of the derivatives for ``ROWS`` rows of states and inputs. The parameters are common to all
    rows.
    """
    single_row = ca.Function(name, symbols, [ca.densify(slopes)])
    return single_row.map(f"{name}_by_rows", "serial", ROWS, [2], [])
