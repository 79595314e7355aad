"""Tests of kernels that several models share: the same numbers as with kernels of their own."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from seatrial.ident.effects.registry import catalogue
from seatrial.ident.engine import jit
from seatrial.ident.engine.common_kernels import LargerModel, common_kernels, common_model_of
from seatrial.ident.engine.filter_kernels import filter_kernels_for
from seatrial.ident.estimation.likelihood import FilterResult, Likelihood
from seatrial.ident.estimation.output_error import predict_ahead, simulate
from seatrial.ident.model.structure import Effect, Model, State
from seatrial.ident.models.disturbances import with_disturbances
from seatrial.ident.models.horizontal import horizontal_model
from tests.ident.engine.test_ekf_adjoint import record_of


def boat(inputs: str = "shaft") -> Model:
    return with_disturbances(horizontal_model(inputs))


def forget_tangent(model: Model) -> None:
    """Remove the kernel of sensitivities of a model from memory."""
    vars(filter_kernels_for(model)).pop("tangent", None)


def same_filter(found: FilterResult, wanted: FilterResult) -> None:
    """Check that the output of two filters is the same, except for rounding."""
    for name in ("x_pred", "x_filt", "e", "eps", "S", "ll", "P_pred", "P_filt", "Phi"):
        np.testing.assert_allclose(getattr(found, name), getattr(wanted, name), rtol=1e-7, atol=1e-8, err_msg=name)


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
        run, alone, starts = Likelihood(model).filter(record, values), simulate(model, record), np.arange(10)
        alone_ahead = predict_ahead(model, record, None, run.x_filt, starts, starts + 7)
        forecast = Likelihood(model).forecast(record, values, run.x_filt[3], run.P_filt[3], 3, 20)
        forget_tangent(model)
        with common_kernels() as models:
            models.append(LargerModel(larger, frozenset(e.name for e in larger.effects)))
            likelihood = Likelihood(model)
            shared = likelihood.scores(record, values, double=True)
            assert likelihood.value(record, values) == pytest.approx(value, rel=1e-10)
            np.testing.assert_allclose(likelihood.value_by_row(record, values), by_row, rtol=1e-8, atol=1e-8)
            same_filter(likelihood.filter(record, values), run)
            vars(filter_kernels_for(model, covariance=False)).pop("simulate", None)
            simulated = simulate(model, record)
            np.testing.assert_allclose(simulated.x, alone.x, rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(simulated.y, alone.y, rtol=1e-9, atol=1e-9)
            assert not filter_kernels_for(model, covariance=False).has("simulate")
            ahead = predict_ahead(model, record, None, run.x_filt, starts, starts + 7)
            np.testing.assert_allclose(ahead.x, alone_ahead.x, rtol=1e-9, atol=1e-9)
            means, spreads = likelihood.forecast(record, values, run.x_filt[3], run.P_filt[3], 3, 20)
            np.testing.assert_allclose(means, forecast[0], rtol=1e-9, atol=1e-9)
            np.testing.assert_allclose(spreads, forecast[1], rtol=1e-8, atol=1e-9)
    assert not filter_kernels_for(model).has("tangent")  # the kernel of the larger model was used
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
                models.append(LargerModel(larger, frozenset(e.name for e in larger.effects)))
                shared = Likelihood(one).scores(record, values)
            assert not filter_kernels_for(one).has("tangent")
            own = Likelihood(one).scores(record, values)
        assert filter_kernels_for(one).has("tangent")
        assert shared.value == pytest.approx(own.value, rel=1e-10)
        scale = np.sqrt(np.diag(own.information)) + 1e-6
        assert np.abs((shared.gradient - own.gradient) / scale).max() < 1e-3
        base = Likelihood(one).scores(record, np.array(list((model + catalogue()[effect.name]).values.values())))
        assert abs(base.value - own.value) > 1e-3  # the effect does change the likelihood


def test_a_model_contains_itself_without_some_effects_only() -> None:
    first, second, third = (catalogue()[name] for name in ("cubic-drag", "mismatch", "yaw-bias"))
    model = boat()
    larger = LargerModel(model + first + second, frozenset({first.name, second.name}))
    assert larger.contains(model)
    assert larger.contains(model + first)
    assert larger.contains((model + second).with_values({"m_u": 50.0}))
    assert larger.contains(larger.model)
    assert not LargerModel(model, frozenset()).contains(larger.model)
    assert not larger.contains(model + second + first)  # hooks run in the order of the effects
    assert not larger.contains(model + third)
    assert not larger.contains(model + replace(first, hooks=dict(first.hooks)))  # other functions of the same name
    assert not larger.contains(replace(model, second_order=True))
    assert not larger.contains(horizontal_model("shaft"))
    more = larger.model + replace(third, states=(State("more", noise=0.1),))
    assert not LargerModel(more, larger.null | {third.name}).contains(model)


def test_an_effect_with_a_size_is_not_left_out() -> None:
    """Only effects that are declared to change nothing at the values of the larger model may be missing."""
    first, second = (catalogue()[name] for name in ("cubic-drag", "mismatch"))
    model = boat()
    larger = LargerModel(model + strong(first) + second, frozenset({second.name}))
    assert not larger.contains(model)
    assert larger.contains(model + first)


def test_larger_models_are_used_only_in_their_context() -> None:
    model = boat()
    with common_kernels() as outer:
        outer.append(LargerModel(model + catalogue()["cubic-drag"], frozenset({"cubic-drag"})))
        with common_kernels() as inner:
            assert common_model_of(model) is outer[0].model
            inner.append(LargerModel(model + catalogue()["mismatch"], frozenset({"mismatch"})))
            assert common_model_of(model) is inner[0].model
        assert outer == [outer[0], inner[0]]  # the inner models pass to the outer context
        assert common_model_of(model) is inner[0].model
    assert common_model_of(model) is None
