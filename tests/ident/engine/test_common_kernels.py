"""Tests of kernels that several models share: the same numbers as with kernels of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine import jit
from seatrial.ident.engine.common_kernels import common_kernels, common_model_of, contains
from seatrial.ident.engine.filter_kernels import filter_kernels_for
from seatrial.ident.estimation.likelihood import Likelihood
from seatrial.ident.model.structure import Effect, Model, State
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from tests.ident.engine.test_ekf_adjoint import record_of


def boat(inputs: str = "shaft") -> Model:
    return with_disturbances(horizontal_model(inputs))


def forget_tangent(model: Model) -> None:
    """Remove the kernel of sensitivities of a model from memory."""
    vars(filter_kernels_for(model)).pop("tangent", None)


def with_all_effects(model: Model) -> Model:
    """Return the model with each effect of the catalogue that has no states, as far as they go together."""
    for effect in catalogue().values():
        if not effect.states and model.accepts(effect):
            model = model + effect
    return model


def strong(effect: Effect) -> Effect:
    """Return the effect with sizes that are not zero."""
    return replace(
        effect, parameters=tuple(p.at(p.value + 0.1 * abs(p.prior[1])) if p.prior else p for p in effect.parameters)
    )


@pytest.mark.parametrize("inputs", ["shaft", "command"])
def test_effects_of_a_larger_model_change_nothing(inputs: str) -> None:
    """All effects of the catalogue without states are null at their initial values, for all inputs."""
    model = boat(inputs)
    larger = with_all_effects(model)
    assert len(larger.effects) > len(model.effects) + 30
    assert len(larger.inputs) > len(model.inputs)
    record, values = record_of(model), np.array(list(model.values.values()))
    with jit.quick_compilation(0):
        own = Likelihood(model).scores(record, values, double=True)
        value, by_row = Likelihood(model).value(record, values), Likelihood(model).value_by_row(record, values)
        forget_tangent(model)
        with common_kernels() as models:
            models.append(larger)
            likelihood = Likelihood(model)
            shared = likelihood.scores(record, values, double=True)
            assert likelihood.value(record, values) == pytest.approx(value, rel=1e-10)
            np.testing.assert_allclose(likelihood.value_by_row(record, values), by_row, rtol=1e-8, atol=1e-8)
    assert not filter_kernels_for(model).has_tangent  # the kernel of the larger model was used
    scale = np.sqrt(np.diag(own.information)) + 1e-6
    assert shared.value == pytest.approx(own.value, rel=1e-10)
    assert np.abs((shared.gradient - own.gradient) / scale).max() < 1e-6
    assert np.abs((shared.information - own.information) / np.outer(scale, scale)).max() < 1e-6


def test_models_with_one_effect_each_share_a_kernel() -> None:
    effects = [strong(catalogue()[name]) for name in ("cubic-drag", "mismatch", "yaw-bias", "wind")]
    model = boat()
    larger = model
    for effect in effects:
        larger = larger + catalogue()[effect.name]
    for effect in effects:
        one = model + effect
        record, values = record_of(one), np.array(list(one.values.values()))
        forget_tangent(one)
        with jit.quick_compilation(0):
            with common_kernels() as models:
                models.append(larger)
                shared = Likelihood(one).scores(record, values)
            assert not filter_kernels_for(one).has_tangent
            own = Likelihood(one).scores(record, values)
        assert filter_kernels_for(one).has_tangent
        assert shared.value == pytest.approx(own.value, rel=1e-10)
        scale = np.sqrt(np.diag(own.information)) + 1e-6
        assert np.abs((shared.gradient - own.gradient) / scale).max() < 1e-3
        base = Likelihood(one).scores(record, np.array(list((model + catalogue()[effect.name]).values.values())))
        assert abs(base.value - own.value) > 1e-3  # the effect does change the likelihood


def test_a_model_contains_itself_without_some_effects_only() -> None:
    first, second, third = (catalogue()[name] for name in ("cubic-drag", "mismatch", "yaw-bias"))
    model = boat()
    larger = model + first + second
    assert contains(larger, model)
    assert contains(larger, model + first)
    assert contains(larger, (model + second).with_values({"m_u": 50.0}))
    assert contains(larger, larger)
    assert not contains(model, larger)
    assert not contains(larger, model + second + first)  # hooks run in the order of the effects
    assert not contains(larger, model + third)
    assert not contains(larger, model + replace(first, hooks=dict(first.hooks)))  # other functions of the same name
    assert not contains(larger, replace(model, second_order=True))
    assert not contains(larger, horizontal_model("shaft"))
    assert not contains(larger + replace(third, states=(State("more", noise=0.1),)), model)


def test_larger_models_are_used_only_in_their_context() -> None:
    model = boat()
    with common_kernels() as outer:
        outer.append(model + catalogue()["cubic-drag"])
        with common_kernels() as inner:
            assert common_model_of(model) is outer[0]
            inner.append(model + catalogue()["mismatch"])
            assert common_model_of(model) is inner[0]
        assert common_model_of(model) is outer[0]
    assert common_model_of(model) is None
