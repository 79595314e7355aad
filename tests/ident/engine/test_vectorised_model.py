"""Tests of the rates that `VectorisedModel` computes without the outputs."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine.vectorised_model import VectorisedModel, vectorised
from seatrial.ident.model.structure import Effect, Model, Parameter
from seatrial.ident.models.horizontal import horizontal_model

ROWS = 7


def rows(model: Model) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    random = np.random.default_rng(3)
    values = np.array(list(model.values.values()))
    return random.normal(size=(ROWS, len(model.states))), random.uniform(size=(ROWS, len(model.inputs))), values


def brake(s: Any) -> None:
    """Change a rate at the last place of all."""
    s.rate["u"] = s.rate["u"] - s.p.brake * s.y["r"]


@pytest.mark.parametrize("effects", [(), ("gnss-latency", "wind", "waves"), ("compass-filtered",)])
def test_rates_are_those_of_a_call(effects: tuple[str, ...]) -> None:
    model = horizontal_model("shaft")
    for name in effects:
        model = model + catalogue()[name]
    rowwise = VectorisedModel(model)
    x, u, values = rows(model)
    whole = rowwise(x, u, values)[:, : rowwise.n_states]
    np.testing.assert_array_equal(rowwise.rates(x, u, values), whole)
    each = values * np.linspace(0.9, 1.1, ROWS)[:, None]
    expected = np.array([rowwise(x[[k]], u[[k]], each[k])[0, : rowwise.n_states] for k in range(ROWS)])
    np.testing.assert_allclose(rowwise.rates(x, u, each), expected, rtol=1e-12, atol=1e-15)


def test_effect_that_changes_a_rate_with_an_output_is_included() -> None:
    parameter = Parameter("brake", 0.3, "m/s", "brake")
    model = horizontal_model("shaft") + Effect("brake", "brake", {"reading": brake}, (parameter,))
    rowwise = VectorisedModel(model)
    x, u, values = rows(model)
    found = rowwise.rates(x, u, values)
    np.testing.assert_allclose(found, rowwise(x, u, values)[:, : rowwise.n_states], rtol=1e-12)
    without = VectorisedModel(horizontal_model("shaft")).rates(x, u, values[:-1])
    np.testing.assert_allclose((without - found)[:, 3], 0.3 * x[:, 5], rtol=1e-9)


def test_function_that_needs_scalars_is_evaluated_by_casadi() -> None:
    def scalar_only(s: Any) -> None:
        if isinstance(s.x.u, np.ndarray):
            raise TypeError("scalars only")
        s.X = s.X - s.p.extra * s.x.u

    parameter = Parameter("extra", 2.0, "N s/m", "extra drag")
    model = horizontal_model("shaft") + Effect("extra", "extra drag", {"force": scalar_only}, (parameter,))
    rowwise = VectorisedModel(model)
    x, u, values = rows(model)
    each = np.tile(values, (ROWS, 1))
    np.testing.assert_allclose(rowwise.rates(x, u, each), rowwise(x, u, values)[:, : rowwise.n_states], rtol=1e-12)
    assert (
        np.abs(rowwise.rates(x, u, values) - VectorisedModel(horizontal_model("shaft")).rates(x, u, values[:-1])).max()
        > 0.01
    )


def test_functions_of_a_model_are_derived_once_for_the_same_object() -> None:
    model, same_values = horizontal_model("shaft"), horizontal_model("shaft")
    assert vectorised(model) is vectorised(model)
    assert vectorised(same_values) is not vectorised(model)
    assert vectorised(same_values).model is same_values
