"""Rows of the records of a search: 5 per second for a slow vehicle, in place of 10.

The time of a search is proportional to the number of integration steps. Steps of 0.2 s are accurate for a vehicle whose
states change slowly. The means of fast sensors are over 0.1 s in both cases (`seatrial.ident.data.record.mean_length`).

An accelerometer measures the forces themselves, which follow the thrusters at once. With half of its means, a lag of
the thrust and an error of its scale are no longer distinguished from other effects.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from itertools import product

import numpy as np

from seatrial.ident.engine import VectorisedModel
from seatrial.ident.model import Model, ModelKind
from seatrial.ident.models import COARSE_STEP_S
from seatrial.ident.numerics import Array

USUAL_STEP_S = 0.1  # s: models with shorter steps, as those driven by commands, have fast states of their own
FASTEST = 5.0  # 1/s: largest eigenvalue with which a step of 0.2 s is accurate; its Phi has an error of 3 %
DIFFERENCE = 1e-4  # of the states, in SI units, for the Jacobian


def rows_of_search(model: Model, validity: Mapping[str, tuple[float, float]], usual_rate: float) -> tuple[Model, float]:
    """Return the model with the longest steps that a search may take, and the rate of the rows [Hz].

    Parameters
    ----------
    model
        The fitted model. It is unchanged, and the rate the usual one, if it is no slow vehicle or has accelerometers.
    validity
        Range of each state and input in the data of the fit (low, high), by name. If it is empty, the rows are the
        usual ones.
    usual_rate
        Rate of the rows for this kind of model [Hz].
    """
    has_accelerometers = any(output.unit == "m/s2" for sensor in model.sensors for output in sensor.outputs)
    slow = (
        model.kind is ModelKind.VEHICLE
        and bool(validity)
        and not has_accelerometers
        and np.isclose(model.max_step, USUAL_STEP_S)
        and fastest_rate(model, validity) <= FASTEST
    )
    return (replace(model, max_step=COARSE_STEP_S), 1.0 / COARSE_STEP_S) if slow else (model, usual_rate)


def fastest_rate(model: Model, validity: Mapping[str, tuple[float, float]]) -> float:
    """Return the largest size of an eigenvalue [1/s] of the model's Jacobian within the ranges of its data.

    The Jacobian is computed by central differences at all combinations of the least, middle and largest value of the
    velocities u, v and r, with each input at zero, and at its least and largest value. Infinity is returned if one of
    its elements is not finite.
    """
    names = [s.name for s in model.states]
    moving = [n for n in ("u", "v", "r") if n in names and n in validity]
    corners = list(product(*[(low, 0.5 * (low + high), high) for low, high in map(validity.__getitem__, moving)]))
    ends = [validity.get(i.tap_of if i.tap else i.name, (0.0, 0.0)) for i in model.inputs]
    inputs = np.array([np.zeros(len(ends)), [low for low, _ in ends], [high for _, high in ends]])
    x = np.zeros((len(corners), len(names)))
    for j, name in enumerate(moving):
        x[:, names.index(name)] = [c[j] for c in corners]
    x, u = np.repeat(x, len(inputs), axis=0), np.tile(inputs, (len(corners), 1))
    evaluated, values = VectorisedModel(model), np.array([p.value for p in model.parameters])

    def rates(at: Array) -> Array:
        """Return the rates of the states (n, n_states) at states ``at`` (n, n_states)."""
        return evaluated.rates(at, u, values)

    steps = DIFFERENCE * np.eye(len(names))
    jacobian = np.stack([(rates(x + d) - rates(x - d)) / (2.0 * DIFFERENCE) for d in steps], axis=2)
    return float(np.abs(np.linalg.eigvals(jacobian)).max()) if np.isfinite(jacobian).all() else float("inf")
