"""Output error: simulation without process noise, its likelihood, and predictions from given states.

The likelihood is that of ``seatrial.ident.estimation.likelihood`` with an exact initial state and no process noise. S
is then the variance of the measurement noise. The value, the forward sensitivities and the Gauss-Newton information
(and with it the Cramer-Rao bound) come from the same calls: ``output_error(model).scores(record, values)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data import Record
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.estimation.model_kernels import model_kernels
from seatrial.ident.estimation.prepared_record import Preparer, initial_condition
from seatrial.ident.model import Model, Parameter, segment_name
from seatrial.ident.numerics import Array


@dataclass(frozen=True)
class SimulatedTrajectory:
    """Simulated or predicted rows of a record, without noise.

    Attributes
    ----------
    t : Array (n_rows,)
        Time [s].
    x : Array (n_rows, n_states)
        States, in the order and the units of the model.
    y : Array (n_rows, n_outputs)
        Outputs without noise, in the order and the units of the model.
    """

    t: Array
    x: Array
    y: Array


def output_error(model: Model) -> Likelihood:
    """Return the output-error likelihood of a model: no process noise, and an exactly known initial state.

    Its innovations are the differences of the measurements from a simulation.
    """
    return Likelihood(model, process_noise=False)


def with_initial_state(model: Model, names: Sequence[str] | None = None, *, per_record: bool = True) -> Model:
    """Return the model with the initial values of states as free parameters ``x0_NAME``, for output error.

    The parameters start at the initial value ``x0`` of the state, and have neither a prior nor bounds. The standard
    deviation ``sd0`` of the initial state becomes zero, and the state does not start from a measurement any more. A
    state whose ``x0`` is already a parameter is not changed.

    Parameters
    ----------
    model
        Model to extend.
    names
        Names of the states; all by default.
    per_record
        Whether each record has its own initial values.

    Raises
    ------
    KeyError
        If the model lacks one of the states. The message lists its states.
    """
    chosen = [s.name for s in model.states] if names is None else list(names)
    unknown = set(chosen) - {s.name for s in model.states}
    if unknown:
        states_of_model = ", ".join(s.name for s in model.states)
        raise KeyError(f"model {model.name} has no state {sorted(unknown)[0]!r}; it has {states_of_model}")
    states, parameters = [], []
    for state in model.states:
        if state.name not in chosen or isinstance(state.x0, str):
            states.append(state)
            continue
        name = f"x0_{state.name}"
        parameters.append(
            Parameter(name, state.x0, state.unit, f"{state.meaning or state.name} at the start", per_record=per_record)
        )
        states.append(replace(state, x0=name, sd0=0.0, from_output=""))
    return replace(model, states=tuple(states), parameters=model.parameters + tuple(parameters))


def with_free_initial_states(model: Model, records: Sequence[Record]) -> tuple[Model, dict[str, float]]:
    """Return the model that output error estimates, with the unknown initial states of each record as free parameters.

    A state that starts from a measurement gets a free parameter ``x0_NAME`` for each record, which starts at that
    record's first sample that is no outlier. A state that starts from a number (or from an output that the model lacks)
    gets a parameter with that number as prior mean and ``sd0`` as prior standard deviation. A state that starts from a
    number and is known exactly (``sd0`` zero) stays as it is. So does a state whose initial value is a parameter
    already.

    Returns
    -------
    model
        Extended model.
    begin
        Initial values of the parameters ``x0_NAME@RECORD`` of states that start from a measurement, where RECORD is the
        index of the record. Without a finite sample, the value is the ``x0`` of the state.

    Notes
    -----
    Without process noise an error of the initial state persists through the whole record and biases the
    dynamics. The noise of a first sample would be such an error.
    """
    spread = {s.name: model.values[s.sd0] if isinstance(s.sd0, str) else s.sd0 for s in model.states}
    unknown = [s for s in model.states if not isinstance(s.x0, str) and (s.from_output or spread[s.name] > 0)]
    extended = with_initial_state(model, [s.name for s in unknown])
    outputs, begin, priors = [o.name for o in model.outputs], {}, []
    for state in unknown:
        name = f"x0_{state.name}"
        if state.from_output not in outputs:
            priors.append(replace(extended.parameter(name), prior=(float(state.x0), spread[state.name])))
            continue
        for i, record in enumerate(records):
            first = Preparer(model)(record).first[outputs.index(state.from_output)]
            begin[segment_name(name, i)] = float(first) if np.isfinite(first) else float(state.x0)
    return extended.replace_parameters(*priors), begin


def simulate(
    model: Model,
    record: Record,
    values: Array | None = None,
    x0: Array | None = None,
    preparer: Preparer | None = None,
) -> SimulatedTrajectory:
    """Simulate the model over the inputs of a record, without process noise and without measurement noise.

    Measurements matter only for states that start from one (``from_output``).

    Parameters
    ----------
    model
        Model to simulate.
    record
        Record with the inputs.
    values : Array (n_parameters,), optional
        Values of the parameters, in the order of ``model.parameters``; by default those of the model.
    x0 : Array (n_states,), optional
        State in the first row; by default the initial state of the model for this record.
    preparer
        Converter of records to arrays for the model. It keeps its results, which saves time if a record is simulated
        many times. None: a new one is created.

    Returns
    -------
    SimulatedTrajectory
        States and outputs in all rows of the record. They are not finite from the row on in which the simulation
        diverges.
    """
    values = _values_or_default(model, values)
    data = (preparer or Preparer(model))(record)
    start = initial_condition(model, values, data, covariance=False).s if x0 is None else x0
    common = model_kernels(model, covariance=False)
    kernel = common.kernels.simulate
    arrays = common.arrays(kernel, data, values) | {"s": np.array(start, dtype=np.float64)}
    done = kernel(data.n_rows, None, arrays)
    return SimulatedTrajectory(record.t, done["x"], done["z"])


def predict_ahead(
    model: Model, record: Record, values: Array | None, states: Array, start: NDArray[np.int64], end: NDArray[np.int64]
) -> SimulatedTrajectory:
    """Predict rows of a record from the states at earlier rows and the inputs between them, without process noise.

    Validation compares such predictions over a horizon with the measurements.

    Parameters
    ----------
    model
        Model that predicts.
    record
        Record with the inputs.
    values : Array (n_parameters,) or None
        Values of the parameters, in the order of ``model.parameters``; None for those of the model.
    states : Array (n_rows, n_states)
        State at each row of the record, such as the filtered states of ``seatrial.ident.estimation.likelihood``.
    start, end : Array (n,) of int
        Indices of the rows at which each of the n predictions starts and ends, ``start <= end``.

    Returns
    -------
    SimulatedTrajectory
        Predictions at the n end rows, in the order of ``end``; not finite if a prediction diverges. For ``start ==
        end`` they are the given state and its outputs.
    """
    data, common = Preparer(model)(record), model_kernels(model, covariance=False)
    kernel = common.kernels.simulate
    arrays = common.arrays(kernel, data, _values_or_default(model, values))
    done = kernel.segments(start.tolist(), (end + 1).tolist(), arrays, states[start], ("z", "x"))
    return SimulatedTrajectory(record.t[end], done["x"], done["z"])


def _values_or_default(model: Model, values: Array | None) -> Array:
    """Return parameter values (n_parameters,) as a contiguous float64 array; None stands for those of the model."""
    given = [p.value for p in model.parameters] if values is None else values
    return np.ascontiguousarray(given, dtype=np.float64)
