"""Rates, outputs and Jacobians of a model for arrays of states and inputs."""

from __future__ import annotations

from collections import deque
from functools import cached_property
from typing import Any

import casadi as ca
import numpy as np

from seatrial.ident.model import Model, RecordedEvaluation
from seatrial.ident.numerics import Array

ca.GlobalOptions.setNumpyMode(-1)  # plain numpy functions on symbols stay symbolic

ROWS = 32  # rows of states and inputs that one call of a CasADi function evaluates
_recent: deque[VectorisedModel] = deque(maxlen=4)  # results of `vectorised`


def vectorised(model: Model) -> VectorisedModel:
    """Return the `VectorisedModel` of a model. It is shared with recent calls for the same object.

    Tracing a model for its Jacobians takes as long as evaluating them for a thousand rows, and the predictions of each
    record need them.
    """
    for known in tuple(_recent):
        if known.model is model:
            return known
    _recent.append(found := VectorisedModel(model))
    return found


class VectorisedModel:
    """Rates (time derivatives of the states) and outputs of a model for whole arrays of states and inputs.

    A row is one instant with its states and inputs. The functions of the model are called with arrays (n_rows,) instead
    of scalars. If they raise TypeError or ValueError for arrays, CasADi evaluates them, which is five to ten times
    slower. Values that are not finite raise no warning.

    Attributes
    ----------
    model : Model
        Model whose functions are evaluated.
    n_states, n_outputs : int
        Number of its states and outputs.
    """

    def __init__(self, model: Model) -> None:
        """Store the model. The object compiles its functions on their first use."""
        self.model = model
        self.n_states, self.n_outputs = len(model.states), len(model.outputs)
        self._integrators: dict[tuple[int, int], Any] = {}

    def __call__(self, x: Array, u: Array, values: Array) -> Array:
        """Return the rates, followed by the outputs, of all rows.

        Parameters
        ----------
        x : Array (n_rows, n_states)
            States, in the units and the order of the model.
        u : Array (n_rows, n_inputs)
            Inputs, in the units and the order of the model.
        values : Array (n_parameters,)
            Values of the parameters, in the order of ``model.parameters``.

        Returns
        -------
        Array (n_rows, n_states + n_outputs)
            Time derivatives of the states [unit of the state per s], then outputs without noise.
        """
        columns = self.columns(x, u, values)
        result = np.empty((len(columns), len(x))).T  # transposed, so that every column is contiguous
        for j, column in enumerate(columns):
            result[:, j] = column
        return result

    def columns(self, x: Array, u: Array, values: Array, recorded: RecordedEvaluation | None = None) -> list[Array]:
        """Return the rates of the states, followed by the outputs, as a list of n_states + n_outputs arrays (n_rows,).

        The arguments are states x (n_rows, n_states), inputs u (n_rows, n_inputs) and values of the parameters
        (n_parameters,). ``recorded`` is the evaluation of the model without its last effect for the same values, which
        saves time. A rate or output that is the same for all rows is repeated. If the functions of the model raise
        TypeError or ValueError for arrays, CasADi evaluates them, which is slower. Values that are not finite raise no
        warning.
        """
        with np.errstate(all="ignore"):
            try:
                own = list(x.T), list(u.T), values.tolist()
                s = self.model.signals(*own) if recorded is None else recorded.signals(self.model, *own)
                signals = [s.rate[v.name] for v in self.model.states] + [s.y[o.name] for o in self.model.outputs]
                return [c if np.shape(c) == (len(x),) else np.full(len(x), c, dtype=np.float64) for c in signals]
            except (TypeError, ValueError):
                return list(np.asarray(self._rates_and_outputs(x.T, u.T, values)))

    def rates(self, x: Array, u: Array, values: Array, recorded: RecordedEvaluation | None = None) -> Array:
        """Return the rates of the states (n_rows, n_states) without the outputs, which takes less time than a call.

        The arguments are states x (n_rows, n_states), inputs u (n_rows, n_inputs), and values of the parameters:
        (n_parameters,), or (n_rows, n_parameters) with values for each row. ``recorded`` is as in `columns`.
        """
        if self._outputs_change_no_rate:
            try:
                return self._rates_before_outputs(x, u, values, recorded)
            except (TypeError, ValueError):
                pass
        found = np.asarray(self._rates_and_outputs(x.T, u.T, values.T), dtype=np.float64)
        return found[: self.n_states].T

    def _rates_before_outputs(
        self, x: Array, u: Array, values: Array, recorded: RecordedEvaluation | None = None
    ) -> Array:
        """Return the rates (n_rows, n_states) before the stage ``output``. The arguments are those of `rates`.

        KeyError is raised if that stage computes one of them, TypeError or ValueError if a function of the model does
        not accept arrays.
        """
        p = list(values.T) if values.ndim == 2 else values.tolist()
        with np.errstate(all="ignore"):
            own = list(x.T), list(u.T), p
            if recorded is None:
                rate = self.model.rates(*own)
            else:
                rate = recorded.signals(self.model, *own, until_output=True).rate
            found = np.empty((len(x), self.n_states))
            for j, v in enumerate(self.model.states):
                found[:, j] = rate[v.name]
        return found

    @cached_property
    def _outputs_change_no_rate(self) -> bool:
        """Whether the stage ``output`` neither computes nor changes a rate, by a test at one state.

        An effect of a user can change a rate at any place. The state and the inputs of the test are different numbers
        without meaning.
        """
        x = np.linspace(0.31, 0.57, self.n_states)[None]
        u = np.linspace(0.43, 0.71, len(self.model.inputs))[None]
        values = np.array([p.value for p in self.model.parameters])
        try:
            early = self._rates_before_outputs(x, u, values)[0]
        except (KeyError, TypeError, ValueError):
            return False
        return bool(np.array_equal(early, self(x, u, values)[0, : self.n_states], equal_nan=True))

    def output_jacobian(self, x: Array, u: Array, values: Array) -> Array:
        """Return the derivatives of the outputs by the states for all rows, shape (n_rows, n_outputs, n_states).

        The arguments are states x (n_rows, n_states), inputs u (n_rows, n_inputs) and values of the parameters
        (n_parameters,).
        """
        return self._evaluate_jacobian(self._output_jacobian, self.n_outputs, x, u, values)

    def rate_jacobian(self, x: Array, u: Array, values: Array) -> Array:
        """Return the derivatives of the rates by the states for all rows, shape (n_rows, n_states, n_states).

        Rates (time derivatives of the states) are along the second axis. The arguments are states x (n_rows, n_states),
        inputs u (n_rows, n_inputs) and values of the parameters (n_parameters,).
        """
        return self._evaluate_jacobian(self._rate_jacobian, self.n_states, x, u, values)

    def integrate_last_states(self, x: Array, u: Array, values: Array, steps: Array, begin: Array) -> Array:
        """Integrate the last states of the model along a given trajectory of the others, by Heun's method.

        Several sets of parameter values are integrated together, each from its own start.

        Parameters
        ----------
        x : Array (n_rows, n_known)
            Known trajectory of the first states, which the last states do not change.
        u : Array (n_rows, n_inputs)
            Inputs.
        values : Array (n_sets, n_parameters)
            Values of the parameters, one row for each set.
        steps : Array (n_rows - 1,)
            Time from each row to the next one [s].
        begin : Array (n_sets, n_states - n_known)
            Last states at the first row, for each set.

        Returns
        -------
        Array (n_sets, n_rows, n_states - n_known)
            The last states at each row, for each set.
        """
        n_sets, last = begin.shape
        rows = np.concatenate([x, u], axis=1)
        here, there = np.zeros((ROWS, rows.shape[1])), np.zeros((ROWS, rows.shape[1]))
        lengths, z = np.zeros(ROWS), np.ascontiguousarray(begin, dtype=np.float64)
        p = np.tile(np.asarray(values, dtype=np.float64), (ROWS, 1, 1))
        after = np.empty((ROWS, n_sets, last))
        buffer, evaluate = self._steps_of_last_states(x.shape[1], n_sets).buffer()
        for k, argument in enumerate((z, here, there, lengths, p)):
            buffer.set_arg(k, argument.data)
        buffer.set_res(0, after.data)
        found = np.empty((n_sets, len(x), last))
        found[:, 0] = z
        for first in range(0, len(x) - 1, ROWS):
            size = min(ROWS, len(x) - 1 - first)
            lengths[:] = 0.0  # the steps after the last row do not change the states
            here[:size], there[:size] = rows[first : first + size], rows[first + 1 : first + 1 + size]
            lengths[:size] = steps[first : first + size]
            evaluate()
            found[:, first + 1 : first + 1 + size] = after[:size].swapaxes(0, 1)
            z[:] = after[size - 1]
        return found

    def _steps_of_last_states(self, known: int, n_sets: int) -> Any:
        """Return the CasADi function that integrates the states after the first ``known`` over 32 steps in each call.

        Its arguments are the last states of all ``n_sets`` sets of parameter values, then the first states and inputs
        at the start and at the end of each step, the lengths of the steps, and the sets of values for each step. Its
        result has the last states after each step. The function is stored and used again.
        """
        if (known, n_sets) in self._integrators:
            return self._integrators[known, n_sets]
        symbols, _, _ = self._symbolic_model
        z, step = ca.SX.sym("z", self.n_states - known), ca.SX.sym("step")
        here, there, p = (
            ca.SX.sym("here", known + symbols[1].numel()),
            ca.SX.sym("there", known + symbols[1].numel()),
            ca.SX.sym("p", symbols[2].numel()),
        )

        def rates(state: Any, row: Any) -> Any:
            """Return the rates of the last states, from their values ``state`` and from ``row``.

            ``row`` has the known states of the row, followed by its inputs.
            """
            found = self._rates_and_outputs(ca.vertcat(row[:known], state), row[known:], p)
            return found[known : self.n_states]

        first = rates(z, here)
        after = ca.densify(z + step / 2 * (first + rates(z + step * first, there)))
        one_step = ca.Function("one_step", [z, here, there, step, p], [after])
        all_sets = one_step.map("all_sets", "serial", n_sets, [1, 2, 3], [])
        self._integrators[known, n_sets] = found = all_sets.mapaccum("all_steps", ROWS)
        return found

    def _evaluate_jacobian(self, function: Any, n: int, x: Array, u: Array, values: Array) -> Array:
        """Return a Jacobian for all rows of states and inputs, shape (n_rows, n, n_states).

        ``function`` is a CasADi function that evaluates a Jacobian with n matrix rows for 32 rows in each call. The
        arguments are states x, inputs u and values of the parameters. They are passed in buffers, because CasADi would
        copy arrays several times.
        """
        jacobians = np.empty((len(x), n, self.n_states))
        rows_x, rows_u, p = np.zeros((ROWS, x.shape[1])), np.zeros((ROWS, u.shape[1])), np.array(values, np.float64)
        slopes = np.empty((ROWS, self.n_states, n))
        buffer, evaluate = function.buffer()
        for k, argument in enumerate((rows_x, rows_u, p)):
            buffer.set_arg(k, argument.data)
        buffer.set_res(0, slopes.data)
        for first in range(0, len(x), ROWS):
            size = len(x[first : first + ROWS])
            rows_x[:size], rows_u[:size] = x[first : first + ROWS], u[first : first + ROWS]
            evaluate()
            jacobians[first : first + size] = slopes[:size].swapaxes(1, 2)
        return jacobians

    @cached_property
    def _symbolic_model(self) -> tuple[list[Any], Any, Any]:
        """Symbols [x, u, p] of states, inputs and parameters; expressions of the rates; expressions of the outputs."""
        sizes = (("x", self.model.states), ("u", self.model.inputs), ("p", self.model.parameters))
        x, u, p = (ca.SX.sym(n, len(k)) for n, k in sizes)
        s = self.model.signals(ca.vertsplit(x), ca.vertsplit(u) if self.model.inputs else [], ca.vertsplit(p))
        rate = ca.vertcat(*[s.rate[v.name] for v in self.model.states])
        return [x, u, p], rate, ca.vertcat(*[s.y[o.name] for o in self.model.outputs])

    @cached_property
    def _rates_and_outputs(self) -> Any:
        """CasADi function of (x, u, p) that returns the rates followed by the outputs, as a dense column."""
        symbols, rate, y = self._symbolic_model
        return ca.Function("rates_and_outputs", symbols, [ca.densify(ca.vertcat(rate, y))])

    @cached_property
    def _output_jacobian(self) -> Any:
        """CasADi function of the derivatives of the outputs by the states, for 32 rows (instants) in each call."""
        symbols, _, y = self._symbolic_model
        return _map_over_rows("H", symbols, ca.jacobian(y, symbols[0]))

    @cached_property
    def _rate_jacobian(self) -> Any:
        """CasADi function of the derivatives of the rates by the states, for 32 rows (instants) in each call."""
        symbols, rate, _ = self._symbolic_model
        return _map_over_rows("A", symbols, ca.jacobian(rate, symbols[0]))


def _map_over_rows(name: str, symbols: list[Any], slopes: Any) -> Any:
    """Return a CasADi function that evaluates the matrix ``slopes`` for 32 rows of states and inputs in one call.

    ``name`` is the name of the CasADi function. ``symbols`` are the symbols [x, u, p] of ``slopes``: states, inputs and
    parameters. The parameters are common to all rows.
    """
    single_row = ca.Function(name, symbols, [ca.densify(slopes)])
    return single_row.map(f"{name}_by_rows", "serial", ROWS, [2], [])
