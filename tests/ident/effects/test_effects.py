"""Every effect: neutral at its given values, with the effect its formula says, and complete for people."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from ident.effects.propulsion.thrust_history import delayed, lagged
from ident.effects.registry import catalogue
from ident.engine.vectorised_model import VectorisedModel
from ident.model.structure import Model
from ident.models.horizontal import horizontal_model
from tests.ident.carriers import carrier

RNG = np.random.default_rng(7)


def points(model: Model, n: int = 40) -> tuple[np.ndarray, np.ndarray]:
    """Random states and inputs; an input's past is the input itself, so that delays change nothing."""
    x = RNG.normal(size=(n, len(model.states))) * 0.5
    u = RNG.uniform(-1, 1, size=(n, len(model.inputs)))
    names = [i.name for i in model.inputs]
    for j, signal in enumerate(model.inputs):
        if signal.tap:
            u[:, j] = u[:, names.index(signal.tap_of)]
    return x, u


def evaluate(model: Model, x: np.ndarray, u: np.ndarray) -> np.ndarray:
    return VectorisedModel(model)(x, u, np.array(list(model.values.values())))


@pytest.mark.parametrize("name", catalogue())
def test_an_effect_is_neutral_at_its_given_values(name: str) -> None:
    effect = catalogue()[name]
    base = carrier(effect)
    model = base + effect
    x, u = points(model)
    n, m = len(base.states), len(effect.states)
    with_it = np.delete(evaluate(model, x, u), np.s_[n : n + m], axis=1)
    own = [[i.name for i in model.inputs].index(i.name) for i in base.inputs]
    np.testing.assert_allclose(with_it, evaluate(base, x[:, :n], u[:, own]), rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("name", catalogue())
def test_an_effect_changes_something_and_says_what(name: str) -> None:
    effect = catalogue()[name]
    model = carrier(effect) + effect
    x, u = points(model)
    u = RNG.uniform(-1, 1, size=u.shape)  # with a past of its own
    first = effect.parameters[0]
    stepped = model.replace_parameters(first.at(first.value + first.step))
    assert first.step > 0
    assert np.abs(evaluate(stepped, x, u) - evaluate(model, x, u)).max() > 1e-6
    assert all((effect.title, effect.formula, effect.source, effect.experiment))
    for p in effect.parameters:
        assert p.prior is not None
        assert p.meaning
    for rival in effect.rivals:
        assert rival in catalogue(), f"{name} names a rival that is not there: {rival}"


def test_a_delay_interpolates_the_past_and_a_lag_integrates_it() -> None:
    past = list(np.arange(17.0)[::-1])  # rising by one a step
    assert delayed(past[:9], 0.25) == pytest.approx(16 - 2.5)
    ramp = [float(-k) for k in range(17)]  # t / 0.1 s
    for T in (0.03, 0.1, 0.15):  # a ramp is followed one time constant late
        assert lagged(ramp, T) == pytest.approx(-T / 0.1, abs=2e-3)


def test_a_dead_band_has_a_gradient_beyond_it() -> None:
    effect = catalogue()["dead-band"]
    model = carrier(effect) + replace(effect, parameters=(effect.parameters[0].at(0.1),))
    x, u = np.zeros((3, len(model.states))), np.array([[0.05, 0.05], [0.3, 0.3], [-0.3, -0.3]])
    surge = evaluate(model, x, u)[:, 3]
    thrust = 2 * (40.05 * np.sign(u[:, 0]) * np.maximum(np.abs(u[:, 0]) - 0.1, 0) ** 2
                  + 1.11 * np.maximum(np.abs(u[:, 0]) - 0.1, 0) ** 2) / 37.0
    np.testing.assert_allclose(surge, thrust, atol=1e-9)


def test_an_effect_that_the_model_cannot_carry_is_refused() -> None:
    with pytest.raises(ValueError, match="advance-ratio needs the signal"):
        horizontal_model("general") + catalogue()["advance-ratio"]
