"""A model's rates and outputs at many rows at once, by CasADi's own evaluation."""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from ident.model import Model

Array = NDArray[np.float64]
ca.GlobalOptions.setNumpyMode(-1)  # plain numpy functions on symbols stay symbolic


class Rowwise:
    """``rates`` and ``outputs`` of a model for whole arrays of states and inputs."""

    def __init__(self, model: Model) -> None:
        x, u, p = (ca.SX.sym(n, k) for n, k in _sizes(model))
        s = model.signals(ca.vertsplit(x), ca.vertsplit(u) if model.inputs else [], ca.vertsplit(p))
        rate = ca.vertcat(*[s.rate[v.name] for v in model.states])
        y = ca.vertcat(*[s.y[o.name] for o in model.outputs])
        both = ca.vertcat(rate, y)
        self.n_states, self.n_outputs = len(model.states), len(model.outputs)
        self._both: Any = ca.Function("rates_and_outputs", [x, u, p], [ca.densify(both)])
        self._output_jacobian: Any = ca.Function("H", [x, u, p], [ca.densify(ca.jacobian(y, x))])
        self._rate_jacobian: Any = ca.Function("A", [x, u, p], [ca.densify(ca.jacobian(rate, x))])

    def __call__(self, x: Array, u: Array, values: Array) -> Array:
        """Rates, then outputs: (n_rows, n_states + n_outputs) for x (n_rows, n_states), u (n_rows, n_inputs)."""
        return np.asarray(self._both(x.T, u.T, values)).T

    def output_jacobian(self, x: Array, u: Array, values: Array) -> Array:
        """(n_rows, n_outputs, n_states)."""
        flat = np.asarray(self._output_jacobian(x.T, u.T, values))
        return flat.reshape(self.n_outputs, len(x), self.n_states).swapaxes(0, 1)

    def rate_jacobian(self, x: Array, u: Array, values: Array) -> Array:
        """(n_rows, n_states, n_states)."""
        flat = np.asarray(self._rate_jacobian(x.T, u.T, values))
        return flat.reshape(self.n_states, len(x), self.n_states).swapaxes(0, 1)


def _sizes(model: Model) -> list[tuple[str, int]]:
    return [("x", len(model.states)), ("u", len(model.inputs)), ("p", len(model.parameters))]
