"""Rates of the motion of a model in still water, and their derivatives by states, inputs and parameters."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from seatrial.ident.engine import VectorisedModel
from seatrial.ident.export.conditions import COMPUTED, POSE, moving_states
from seatrial.ident.model import Model
from seatrial.ident.numerics import Array

CURRENT = ("V_x", "V_y")
DIFFERENCE_STEP = 1e-5  # step of the central differences, in the unit of each state and input


class Rates:
    """Rates of the states of the motion of a model for many rows of states and inputs, in still water.

    States on which no velocity depends, such as the filter of a compass, are left out (`moving_states`). The current
    and the states that are held are zero. Delayed copies of an input have its value. Time, work, position and heading
    have constant values (`seatrial.ident.export.conditions`).

    Attributes
    ----------
    names : tuple of str
        Names of the n dynamic states: the velocities, and the states on which these depend.
    inputs : tuple of str
        Names of the m inputs, without their delayed copies, the time and the work.
    delayed : frozenset of str
        Inputs that have delayed copies.
    parameters : tuple of str
        Names of the parameters, without the current.
    values : Array (n_parameters,)
        Values of all parameters in the order of the model, with a current of zero.
    initial : Array (n,)
        Initial means of the dynamic states in the model.
    """

    def __init__(self, model: Model, held: tuple[str, ...] = (), conditions: Mapping[str, float] | None = None) -> None:
        """Set up the rates of a model without nuisance states. The states ``held`` are zero and have no rate.

        ``conditions`` are the values of time, work, position and heading by name; a missing one is zero.
        """
        self.names = tuple(n for n in moving_states(model) if n not in held)
        self.inputs = tuple(i.name for i in model.inputs if not i.tap and i.name not in COMPUTED)
        self.delayed = frozenset(i.tap_of for i in model.inputs if i.tap)
        self.parameters = tuple(n for n in model.values if n not in CURRENT)
        self._at = [k for k, s in enumerate(model.states) if s.name in self.names]
        fixed = conditions or {}
        self._rest = np.array([fixed.get(s.name, 0.0) if s.name in POSE else 0.0 for s in model.states])
        self._own = [j for j, i in enumerate(model.inputs) if i.name not in COMPUTED]
        own = (model.inputs[j] for j in self._own)
        self._source = [self.inputs.index(i.tap_of if i.tap else i.name) for i in own]
        self._constant = np.array([fixed.get(i.name, 0.0) if i.name in COMPUTED else 0.0 for i in model.inputs])
        self._all = list(model.values)
        self.values = np.array([0.0 if n in CURRENT else v for n, v in model.values.items()])
        self.initial = np.array([model.values[s.x0] if isinstance(s.x0, str) else s.x0 for s in model.states])[self._at]
        self._rowwise = VectorisedModel(model)

    def __call__(self, x: Array, u: Array, values: Array | None = None) -> Array:
        """Return the rates (n_rows, n) at dynamic states x (n_rows, n) and inputs u (n_rows, m).

        ``values`` replace the parameter values of the model: (n_parameters,), or (n_rows, n_parameters) with values for
        each row.
        """
        whole, inputs = np.tile(self._rest, (len(x), 1)), np.tile(self._constant, (len(x), 1))
        whole[:, self._at], inputs[:, self._own] = x, u[:, self._source]
        found = self._rowwise.rates(whole, inputs, self.values if values is None else values)
        return found[:, self._at]

    def by_states(self, x: Array, u: Array, values: Array | None = None) -> Array:
        """Return the derivatives (n_rows, n, n) of the rates by the dynamic states. ``values`` as in the call."""
        n = x.shape[1]
        rates = self(_moved_by_each_variable(x), np.tile(u, (2 * n, 1)), _repeated(values, 2 * n))
        return _central_differences(rates, len(x), n)

    def with_slopes(self, x: Array, u: Array) -> tuple[Array, Array]:
        """Return the rates (n_rows, n), and their derivatives (n_rows, n, n) by the dynamic states, in one call."""
        n = x.shape[1]
        rates = self(np.concatenate([x, _moved_by_each_variable(x)]), np.tile(u, (2 * n + 1, 1)))
        return rates[: len(x)], _central_differences(rates[len(x) :], len(x), n)

    def by_inputs(self, x: Array, u: Array, values: Array | None = None) -> Array:
        """Return the derivatives (n_rows, n, m) of the rates by the inputs. ``values`` as in the call."""
        m = u.shape[1]
        rates = self(np.tile(x, (2 * m, 1)), _moved_by_each_variable(u), _repeated(values, 2 * m))
        return _central_differences(rates, len(u), m)

    def by_parameter(self, x: Array, u: Array, name: str, size: float) -> Array:
        """Return the derivatives (n_rows, n) of the rates by one parameter: central differences with step ``size``."""
        d = np.zeros(self.values.size)
        d[self._all.index(name)] = size
        return (self(x, u, self.values + d) - self(x, u, self.values - d)) / (2.0 * size)


def _repeated(values: Array | None, times: int) -> Array | None:
    """Return the values of each row (n_rows, n_parameters) as often as the rows are; others are unchanged."""
    return values if values is None or values.ndim == 1 else np.tile(values, (times, 1))


def _moved_by_each_variable(v: Array) -> Array:
    """Return the rows of v (n_rows, n) with each variable increased, then decreased by the step: (2 n n_rows, n).

    All changes are evaluated in one call of the model, because a call takes as long for one row as for a hundred.
    """
    changes = DIFFERENCE_STEP * np.concatenate([np.eye(v.shape[1]), -np.eye(v.shape[1])])
    moved: Array = (v + changes[:, None, :]).reshape(-1, v.shape[1])
    return moved


def _central_differences(rates: Array, n_rows: int, n: int) -> Array:
    """Return the derivatives (n_rows, n_rates, n) from the rates (2 n n_rows, n_rates) at the moved rows."""
    rates = rates.reshape(2, n, n_rows, -1)
    return np.moveaxis((rates[0] - rates[1]) / (2.0 * DIFFERENCE_STEP), 0, 2)
