"""Output error: simulation without process noise, its likelihood, and predictions from given states.

The likelihood is that of ``seatrial.ident.estimation.likelihood`` with a certain initial state and no process noise, so
S is the variance of the measurement noise. Value, exact forward sensitivities and Gauss-Newton information (and with it
the Cramer-Rao bound) are the same calls: ``output_error(model).scores(record, values)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from seatrial.ident.data import Preparer, Record, initial_condition
from seatrial.ident.engine import Kernel, programs_for
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.model import Model, Parameter, segment_name
from seatrial.ident.numerics import Array

INPUTS = ("u", "u_next", "h")  # what a simulation takes of a record


@dataclass(frozen=True)
class Simulation:
    """t (n_rows,) s; x (n_rows, n_states); y (n_rows, n_outputs) without noise."""

    t: Array
    x: Array
    y: Array


def output_error(model: Model) -> Likelihood:
    """The likelihood of a model without process noise."""
    return Likelihood(model, process_noise=False)


def with_initial_state(model: Model, names: Sequence[str] | None = None, *, per_record: bool = True) -> Model:
    """The model with the named states' initial values (all by default) as free parameters ``x0_NAME``.

    They start from the states' own x0, and in prediction error they take the place of its uncertainty.
    """
    wanted = [s.name for s in model.states] if names is None else list(names)
    unknown = set(wanted) - {s.name for s in model.states}
    if unknown:
        raise KeyError(f"model {model.name} has no state {sorted(unknown)[0]!r}")
    states, new = [], []
    for state in model.states:
        if state.name not in wanted or isinstance(state.x0, str):
            states.append(state)
            continue
        name = f"x0_{state.name}"
        new.append(
            Parameter(name, state.x0, state.unit, f"{state.meaning or state.name} at the start", per_record=per_record)
        )
        states.append(replace(state, x0=name, sd0=0.0, from_output=""))
    return replace(model, states=tuple(states), parameters=model.parameters + tuple(new))


def free_start(model: Model, records: Sequence[Record]) -> tuple[Model, dict[str, float]]:
    """What output error estimates: the model with the start of each record free, and where to begin with it.

    Without process noise a start that is taken for exact, the noise of a first sample included, is an error that the
    whole record carries, and the dynamics bend to it. A state that starts from a measurement becomes the parameter
    ``x0_NAME`` of each record, which begins at its first sample; one that starts from a number has that as its prior,
    with ``sd0``; what is known exactly (``sd0`` zero) or is a parameter already stays. Returns ``x0_NAME@RECORD`` with
    the first samples.
    """
    spread = {s.name: model.values[s.sd0] if isinstance(s.sd0, str) else s.sd0 for s in model.states}
    unknown = [s for s in model.states if not isinstance(s.x0, str) and (s.from_output or spread[s.name] > 0)]
    extended = with_initial_state(model, [s.name for s in unknown])
    outputs, begin, given = [o.name for o in model.outputs], {}, []
    for state in unknown:
        name = f"x0_{state.name}"
        if state.from_output not in outputs:
            given.append(replace(extended.parameter(name), prior=(float(state.x0), spread[state.name])))
            continue
        for i, record in enumerate(records):
            first = Preparer(model)(record).first[outputs.index(state.from_output)]
            begin[segment_name(name, i)] = float(first) if np.isfinite(first) else float(state.x0)
    return extended.replace_parameters(*given), begin


def simulate(
    model: Model,
    record: Record,
    values: Array | None = None,
    x0: Array | None = None,
    preparer: Preparer | None = None,
) -> Simulation:
    """Run the model through a record's inputs, from ``x0`` (n_states,) or the model's own initial state.

    Measurements matter only to states that start from one (``from_output``). ``preparer``: of the model, which keeps
    what it makes of a record that is simulated many times.
    """
    values = _values(model, values)
    data = (preparer or Preparer(model))(record)
    start = initial_condition(model, values, data, covariance=False).s if x0 is None else x0
    given = {n: data.rows[n] for n in INPUTS} | {"p": values, "s": np.array(start, dtype=np.float64)}
    done = _kernel(model)(data.n_rows, None, given)
    return Simulation(record.t, done["x"], done["z"])


def predict_ahead(
    model: Model, record: Record, values: Array | None, states: Array, start: NDArray[np.int64], end: NDArray[np.int64]
) -> Simulation:
    """Predict rows from the states at earlier rows and the inputs between them.

    Parameters: states (n_rows, n_states): where to start, as the filtered states of
    ``seatrial.ident.estimation.likelihood``; start, end (n,): rows of the record, ``start < end``. Returns what is
    predicted at the n ends.
    """
    data, kernel = Preparer(model)(record), _kernel(model)
    given = {n: data.rows[n] for n in INPUTS} | {"p": _values(model, values)}
    done = kernel.segments(start.tolist(), (end + 1).tolist(), given, states[start], ("z", "x"))
    return Simulation(record.t[end], done["x"], done["z"])


def _kernel(model: Model) -> Kernel:
    return programs_for(model, covariance=False).simulate


def _values(model: Model, values: Array | None) -> Array:
    given = [p.value for p in model.parameters] if values is None else values
    return np.ascontiguousarray(given, dtype=np.float64)
