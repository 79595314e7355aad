"""Tests of the effects of past inputs: their list, and that no force remains while the input is constant."""

from __future__ import annotations

import numpy as np
import pytest

from seatrial.ident.effects.nonparametric import TIME_CONSTANTS, input_response_effects
from seatrial.ident.engine.vectorised_model import VectorisedModel
from seatrial.ident.model.structure import Effect, Model, curve_name
from seatrial.ident.models.horizontal import horizontal_model

NAMES = {"X(past of n_sum)", "X(swing after n_sum)", "N(past of n_diff)", "N(swing after n_diff)"}


def by_name(model: Model) -> dict[str, Effect]:
    return {curve_name(e.kind, e.curve): e for e in input_response_effects(model) if e.curve is not None}


def test_one_effect_of_each_kind_exists_for_each_pair_of_inputs() -> None:
    assert set(by_name(horizontal_model())) == NAMES
    assert set(by_name(horizontal_model("force"))) == {n.replace("n_", "f_") for n in NAMES}
    assert input_response_effects(horizontal_model("general")) == []
    with_one = horizontal_model() + by_name(horizontal_model())["X(swing after n_sum)"]
    assert set(by_name(with_one)) == NAMES - {"X(swing after n_sum)"}


@pytest.mark.parametrize("name", sorted(NAMES))
def test_no_force_acts_while_the_input_is_constant_and_settled(name: str) -> None:
    """The states have the steady values of a constant input. The forces then equal those without the effect."""
    base = horizontal_model()
    effect = by_name(base)[name]
    model = base + effect
    model = model.with_values({p.name: 3.0 for p in effect.parameters if p.transform != "log"})
    u = np.array([[0.6, -0.2]])
    left, right = u[0] * np.abs(u[0])
    drive = (left + right) / 2 if "sum" in name else (left - right) / 2
    rest = [drive] * len(TIME_CONSTANTS) if "past" in name else [drive, 0.0]
    x = np.zeros((1, len(base.states)))
    plain = VectorisedModel(base)(x, u[:, : len(base.inputs)], np.array(list(base.values.values())))
    full = VectorisedModel(model)(np.column_stack([x, [rest]]), u, np.array(list(model.values.values())))
    n = len(base.states)
    np.testing.assert_allclose(full[:, :n], plain[:, :n], atol=1e-9)
    np.testing.assert_allclose(full[:, n : n + len(rest)], 0.0, atol=1e-9)
    moved = VectorisedModel(model)(
        np.column_stack([x, [[drive + 1.0] + [0.0] * (len(rest) - 1)]]), u, np.array(list(model.values.values()))
    )
    at = [s.name for s in base.states].index("u" if "X" in name else "r")
    assert abs(moved[0, at] - plain[0, at]) > 0.01
